"""Search for serial ports and CAN buses, and identification of their devices, for `seatrial devices`.

A device is identified by its protocol and its baud rate.
"""

from __future__ import annotations

import math
import select
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from seatrial.daq.config import default_decoder
from seatrial.daq.protocol import DEVICES, Decoder, nmea, slcan, ubx
from seatrial.daq.samples import Frame, Gnss, Transducer
from seatrial.daq.transport import PortError, SerialPort, list_serial_ports

LISTEN_S = 1.3  # s of wall time at each baud rate; a GNSS receiver sends once a second
SILENT_S = 2.0  # s; after this time without any byte, other baud rates are not tried
ENOUGH_READS = 3  # reads with samples that are sufficient for a protocol with checksums
JUDGED_BYTES = 20  # smallest number of bytes after the first sample for a score from these bytes alone
MIN_LINES = 5  # smallest number of lines without a checksum, or of frames without a sample; fewer may be chance
CAN_TYPE = 280  # ARPHRD_CAN, linux/if_arp.h
SLCAN = "slcan"  # protocol of an adapter to a CAN bus, not of a device
SLCAN_BAUDS = (115200, 1_000_000)


@dataclass(frozen=True)
class DiscoveredDevice:
    """Serial port or CAN bus of this computer, with the device that was identified at it.

    Attributes
    ----------
    port : str
        Path or address of the port.
    description : str
        Description of the port by the operating system.
    protocol : str
        Name of the protocol as in a rig file, or "slcan" for a CAN adapter; "" if no protocol was recognised.
    baud : int
        Baud rate; 0 if unknown or not needed.
    rate : float
        Rate of the samples [Hz]; NaN if unknown.
    says : str
        Text for the user: the device, or the reason why it was not identified.
    hint : str
        Advice on how to improve the settings of the port; "" without one.
    """

    port: str
    description: str  # description of the port by the operating system
    protocol: str = ""  # a name in the table of devices, or SLCAN; empty if no protocol was recognised
    baud: int = 0
    rate: float = math.nan  # samples per second
    says: str = ""  # text for the user: the device, or the reason why it was not identified
    hint: str = ""  # advice on how to improve the settings of the port


class _ProtocolCandidate:
    """Protocol that the device at a port may speak, with its decoder and the counts of the samples so far.

    Attributes
    ----------
    protocol : str
        Name of the protocol.
    decoder : Decoder
        Decoder of the protocol with default settings.
    samples, n_bytes : int
        Numbers of samples and of bytes so far.
    gnss, fixes : int
        Numbers of GNSS samples, and of GNSS samples with a fix.
    times : list of float
        Time of arrival of each sample [s of a monotonic clock].
    """

    def __init__(self, protocol: str) -> None:
        """Prepare the decoder of a protocol, such as "nmea", with all counts at zero."""
        self.protocol = protocol
        self.decoder: Decoder | slcan.Decoder = slcan.Decoder() if protocol == SLCAN else default_decoder(protocol)
        self.decoder.reset()
        self.samples = self.n_bytes = 0
        self.gnss = self.fixes = 0  # number of GNSS samples, and of GNSS samples with a fix
        self._joined: tuple[int, int] | None = None  # bytes received and unparsed at the first sample
        self.times: list[float] = []  # time of arrival of each sample [s]

    def feed(self, data: bytes, t: float) -> None:
        """Decode bytes of the port by this protocol, and count bytes, samples and GNSS fixes.

        Samples of transducers do not count, because they would change the rate of the receiver that sends them.
        The bytes were read at time t [s of a monotonic clock].
        """
        frames = self.decoder.feed(data, t)
        # A transducer beside a receiver does not change the rate of the receiver.
        found = [frame for frame in frames if not (isinstance(frame, Frame) and isinstance(frame.sample, Transducer))]
        self.n_bytes += len(data)
        self.samples += len(found)
        self._count_fixes(found)
        self.times += [t] * len(found)
        if found and self._joined is None:  # bytes before may be from another baud rate, or the end of a frame
            self._joined = (self.n_bytes, self.decoder.unparsed_bytes)

    def close(self) -> None:
        """Count the last samples, after all bytes of the port were fed. The port is not closed here.

        A decoder of a GNSS receiver keeps its last sample until the next epoch begins. Other decoders keep none. These
        samples do not change the `rate`.
        """
        if isinstance(self.decoder, (nmea.Decoder, ubx.Decoder)):
            found = self.decoder.flush()
            self.samples += len(found)
            self._count_fixes(found)

    def _count_fixes(self, found: Sequence[object]) -> None:
        """Count the GNSS samples, and those with a fix, among the decoded samples `found`."""
        samples = [frame.sample for frame in found if isinstance(frame, Frame) and isinstance(frame.sample, Gnss)]
        self.gnss += len(samples)
        self.fixes += sum(sample.fix > 0 for sample in samples)

    @property
    def checked(self) -> bool:
        """Whether the protocol has checksums, so that a few samples are sufficient to recognise it.

        Protocols of load cells in text lines and slcan have none.
        """
        return self.protocol not in ("loadcell", "openscale", SLCAN)

    def score(self) -> tuple[float, int]:
        """Return how well the bytes of a port fit this protocol: (share of the bytes in frames, number of frames).

        A larger result is better; a share with checksums counts 0.01 more, so that such a protocol wins ties. The
        result is (0, 0), which excludes the protocol, without samples, with fewer than 5 samples without checksums, or
        if the share is below 0.2 (0.8 without checksums). Bytes up to the read with the first sample do not count if 20
        bytes or more follow.
        """
        if self.samples == 0 or (not self.checked and self.samples < MIN_LINES):
            return 0.0, 0
        n_bytes, unparsed = self.n_bytes, self.decoder.unparsed_bytes
        if self._joined is not None and n_bytes - self._joined[0] >= JUDGED_BYTES:
            n_bytes, unparsed = n_bytes - self._joined[0], unparsed - self._joined[1]
        share = 1.0 - unparsed / max(n_bytes, 1)
        if share < (0.2 if self.checked else 0.8):
            return 0.0, 0
        # Protocols with checksums win ties: text lines without a checksum may match a pattern by chance.
        return share + 0.01 * self.checked, self.decoder.frames

    @property
    def condition(self) -> str:
        """Advice for the user if the device is a GNSS receiver and all its samples lack a fix; "" otherwise."""
        return (
            "; it sends data, but has no fix: check view of the sky, antenna and cable"
            if self.gnss and not self.fixes
            else ""
        )

    def rate(self) -> float:
        """Return the rate of the samples of the device [Hz] by their times of arrival.

        The rate is NaN if there is no sample, or if all arrived with one read. The samples of the first read are not
        counted, because they may have waited in a buffer.
        """
        if not self.times or self.times[-1] == self.times[0]:
            return math.nan
        # The first read is not counted, because it may contain buffered bytes.
        return (len(self.times) - self.times.count(self.times[0])) / (self.times[-1] - self.times[0])


def discover_devices(
    listen: float = LISTEN_S, bauds: Sequence[int] = (), said: Callable[[str], None] = lambda text: None
) -> list[DiscoveredDevice]:
    """Find all serial ports and CAN buses of this computer, and identify the devices at the serial ports.

    No byte is sent. CAN buses are only listed.

    Parameters
    ----------
    listen
        Time to listen at each baud rate [s].
    bauds
        Baud rates to try; by default the usual ones of all protocols.
    said
        Function that receives progress messages.

    Returns
    -------
    list
        All ports: the serial ports first, then the CAN buses. The field `protocol` is empty if no device was
        identified, and always for a CAN bus. The field `says` then has the reason. A port that cannot be opened raises
        no error.
    """
    found = []
    for path, description in list_serial_ports():
        said(f"listening on {path}")
        found.append(identify_protocol(path, description, bauds=bauds, listen=listen))
    for folder in sorted(Path("/sys/class/net").glob("*")) if Path("/sys/class/net").is_dir() else []:
        kind = folder / "type"
        if kind.is_file() and kind.read_text().strip() == str(CAN_TYPE):
            says = "CAN bus of unknown protocol: name it in the rig (vesc, dronecan, nmea2000 or dbc)"
            found.append(DiscoveredDevice(f"socketcan:{folder.name}", "CAN interface", says=says))
    return found


def baud_rates(wanted: Sequence[int] = ()) -> list[int]:
    """Return the baud rates at which `seatrial devices` listens, in this order.

    They are the `wanted` ones in their order. If `wanted` is empty, they are those of all installed protocols and of
    slcan adapters, each once. A rate is the earlier, the more protocols have it and the earlier it is in their lists.
    """
    if wanted:
        return list(wanted)
    rows = [row.bauds for row in DEVICES.usable().values() if row.bauds] + [SLCAN_BAUDS]
    places: dict[int, float] = {}
    for bauds in rows:
        for k, baud in enumerate(bauds):
            places[baud] = places.get(baud, 0.0) + 1.0 / (1 + k)
    return sorted(places, key=lambda baud: -places[baud])


def identify_protocol(
    path: str, description: str = "", *, bauds: Sequence[int] = (), listen: float = LISTEN_S
) -> DiscoveredDevice:
    """Identify the device at a serial port by listening at one baud rate after the other.

    The search ends at the first baud rate at which a protocol fits; the best protocol there is returned. The search
    also ends if no byte arrives at the first baud rate, or if the port fails. No byte is sent, because the device is
    unknown and may react to it.

    Parameters
    ----------
    path
        The port.
    description
        Description of the port, for the result.
    bauds
        Baud rates to try; by default the usual ones of all protocols.
    listen
        Time to listen at each baud rate [s].

    Returns
    -------
    DiscoveredDevice
        The device. If no device was identified, `protocol` is empty and `says` has the reason. An error of the port is
        such a reason too; it is not raised.
    """
    types = DEVICES.usable()
    answered_at: list[int] = []
    framed: list[str] = []  # protocols with right checksums but without any sample
    hint = ""
    for baud in baud_rates(bauds):
        # A rate from the user is tried with every protocol: a device may be set to a rate that is unusual for it.
        candidates = [
            _ProtocolCandidate(name) for name, row in types.items() if baud in row.bauds or (bauds and row.bauds)
        ]
        candidates += [_ProtocolCandidate(SLCAN)] if baud in SLCAN_BAUDS or bauds else []
        port = SerialPort(path, baud)
        try:
            n_bytes = _feed_candidates(port, candidates, listen, silent=SILENT_S if not answered_at else listen)
        except PortError as error:
            return DiscoveredDevice(path, description, says=str(error))
        hint = port.hint
        if n_bytes == 0 and not answered_at:
            return DiscoveredDevice(
                path,
                description,
                says="silent: check power and cable; devices that send only on request cannot be found",
                hint=hint,
            )
        answered_at.append(baud)
        framed += [f"{c.protocol} at {baud} baud" for c in candidates if c.checked and c.decoder.frames >= MIN_LINES]
        best = max(candidates, key=_ProtocolCandidate.score, default=None)
        if best is not None and best.score() > (0.0, 0):
            says = (
                "CAN adapter (slcan) with open channel" if best.protocol == SLCAN else types[best.protocol].description
            )
            says += best.condition
            return DiscoveredDevice(path, description, best.protocol, baud, best.rate(), says, hint)
    if framed:
        says = f"frames of {' or '.join(framed)}, but without measurements: check which outputs are switched on"
        return DiscoveredDevice(path, description, says=says, hint=hint)
    tried = ", ".join(map(str, answered_at))
    says = f"bytes of no known protocol at {tried} baud: check the output settings of the device, or give --baud"
    return DiscoveredDevice(path, description, says=says, hint=hint)


def recognise_protocol(reads: Iterable[tuple[float, bytes]]) -> str:
    """Return the name of the protocol that fits bytes of a port, received at one baud rate; "" if none fits.

    Only protocols that `seatrial devices` recognises are tried, with default settings.

    Parameters
    ----------
    reads
        Time [s] and bytes of each read, in order.
    """
    candidates = [_ProtocolCandidate(name) for name, row in DEVICES.usable().items() if row.bauds]
    for t, data in reads:
        for candidate in candidates:
            candidate.feed(data, t)
    for candidate in candidates:
        candidate.close()
    best = max(candidates, key=_ProtocolCandidate.score, default=None)
    return best.protocol if best is not None and best.score() > (0.0, 0) else ""


def _feed_candidates(port: SerialPort, candidates: Sequence[_ProtocolCandidate], seconds: float, silent: float) -> int:
    """Listen at a serial port and pass its bytes to each candidate protocol. Return the number of bytes.

    Listening ends `silent` seconds after its start if no byte has come, otherwise `seconds` after the first byte, or
    earlier, but not before 0.3 `seconds`, if a protocol with checksums has samples from three reads.
    This function opens and closes the port. Raise PortError if it cannot be opened or read.
    """
    n_bytes, start = 0, time.monotonic()
    end = start + silent
    port.open()
    try:
        while (left := end - time.monotonic()) > 0.0:
            if not select.select([port.fileno()], [], [], left)[0]:
                break
            data, t = port.read(), time.monotonic()
            end = end if n_bytes or not data else t + seconds
            n_bytes += len(data)
            for candidate in candidates:
                candidate.feed(data, t)
            if t - start > 0.3 * seconds and any(c.checked and len(set(c.times)) >= ENOUGH_READS for c in candidates):
                break
    finally:
        port.close()
    for candidate in candidates:
        candidate.close()
    return n_bytes
