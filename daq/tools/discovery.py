"""`seatrial devices`: finds serial ports and CAN buses, and identifies protocol and baud rate of their devices."""

from __future__ import annotations

import math
import select
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from seatrial.daq.config import default_decoder
from seatrial.daq.protocol import DEVICES, Decoder, nmea, slcan, ubx
from seatrial.daq.samples import Frame, Gnss
from seatrial.daq.transport import PortError, SerialPort, list_serial_ports

LISTEN_S = 1.3  # wall, at each baud rate; a GNSS receiver sends once a second
SILENT_S = 2.0  # with nothing at all for so long, no baud rate will help
ENOUGH = 3  # reads with samples in them
JUDGED_BYTES = 20
LINES = 5  # of text without a checksum, or of frames without a sample; fewer may be chance
CAN_TYPE = 280  # ARPHRD_CAN, linux/if_arp.h
SLCAN = "slcan"  # not a device of its own: an adapter to a bus
SLCAN_BAUDS = (115200, 1_000_000)


@dataclass(frozen=True)
class DiscoveredDevice:
    """One port and the device identified there."""

    port: str
    description: str
    protocol: str = ""  # a name of the table of devices, or SLCAN; empty when nothing was recognised
    baud: int = 0
    rate: float = math.nan  # samples per second
    says: str = ""  # for people: what it is, or why it is not known
    hint: str = ""  # what could be better about the port

    def toml(self, name: str, alone: bool = True) -> str:
        """A [[device]] for the rig file; ``alone``: no other one there names thrusters."""
        rate = f"{self.rate:.3g}" if math.isfinite(self.rate) else "1"
        return (
            f'[[device]]\nname = "{name}"\nprotocol = "{self.protocol}"\nport = "{self.port}"\nbaud = {self.baud}\n'
            f"rate_hz = {rate if '.' in rate or 'e' in rate else rate + '.0'}\n"
        )


class _Listener:
    """One candidate protocol at one port: its decoder and the samples so far."""

    def __init__(self, protocol: str) -> None:
        self.protocol = protocol
        self.decoder: Decoder | slcan.Decoder = slcan.Decoder() if protocol == SLCAN else default_decoder(protocol)
        self.decoder.reset()
        self.samples = self.n_bytes = self.gnss = self.fixes = 0  # of `gnss` samples, so many have a fix
        self._joined: tuple[int, int] | None = None  # bytes received and unparsed at the first sample
        self.times: list[float] = []

    def feed(self, data: bytes, t: float) -> None:
        """Take the bytes that were read."""
        found = self.decoder.feed(data, t)
        self.n_bytes += len(data)
        self.samples += len(found)
        self._look_at(found)
        self.times += [t] * len(found)
        if found and self._joined is None:  # what comes before may be of another baud rate, or half a frame
            self._joined = (self.n_bytes, self.decoder.unparsed_bytes)

    def close(self) -> None:
        if isinstance(self.decoder, (nmea.Decoder, ubx.Decoder)):
            found = self.decoder.flush()
            self.samples += len(found)
            self._look_at(found)

    def _look_at(self, found: Sequence[object]) -> None:
        samples = [frame.sample for frame in found if isinstance(frame, Frame) and isinstance(frame.sample, Gnss)]
        self.gnss += len(samples)
        self.fixes += sum(sample.fix > 0 for sample in samples)

    @property
    def checked(self) -> bool:
        """Whether the protocol has checksums, so that little is enough."""
        return self.protocol not in ("loadcell", "openscale", SLCAN)

    def score(self) -> tuple[float, int]:
        """Confidence that this is the protocol, larger is better; (0, 0) where it is not."""
        if self.samples == 0 or (not self.checked and self.samples < LINES):
            return 0.0, 0
        n_bytes, unparsed = self.n_bytes, self.decoder.unparsed_bytes
        if self._joined is not None and n_bytes - self._joined[0] >= JUDGED_BYTES:
            n_bytes, unparsed = n_bytes - self._joined[0], unparsed - self._joined[1]
        share = 1.0 - unparsed / max(n_bytes, 1)
        if share < (0.2 if self.checked else 0.8):
            return 0.0, 0
        # OpenScale's lines may match a load cell's pattern by chance, never the other way round.
        return share + 0.01 * self.checked, self.decoder.frames

    @property
    def condition(self) -> str:
        """What keeps a receiver from measuring, to be shown behind its name; empty if it measures."""
        return "; alive, without a fix: open sky, antenna and its cable" if self.gnss and not self.fixes else ""

    def rate(self) -> float:
        """Samples per second, from their times of arrival."""
        if not self.times or self.times[-1] == self.times[0]:
            return math.nan
        # The first read may contain buffered bytes; it is not counted.
        return (len(self.times) - self.times.count(self.times[0])) / (self.times[-1] - self.times[0])


def find(
    listen: float = LISTEN_S, bauds: Sequence[int] = (), said: Callable[[str], None] = lambda text: None
) -> list[DiscoveredDevice]:
    """Every port of this machine, with its protocol where identified."""
    found = []
    for path, description in list_serial_ports():
        said(f"listening on {path}")
        found.append(identify_protocol(path, description, bauds=bauds, listen=listen))
    for folder in sorted(Path("/sys/class/net").glob("*")) if Path("/sys/class/net").is_dir() else []:
        kind = folder / "type"
        if kind.is_file() and kind.read_text().strip() == str(CAN_TYPE):
            says = "CAN bus: vesc, dronecan, nmea2000 or dbc"
            found.append(DiscoveredDevice(f"socketcan:{folder.name}", "CAN interface", says=says))
    return found


def baud_rates(wanted: Sequence[int] = ()) -> list[int]:
    """The baud rates to try, the likeliest first."""
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
    """Listen on a port at one baud rate after the other. Nothing is ever sent: the device is unknown."""
    types = DEVICES.usable()
    answered_at: list[int] = []
    framed: list[str] = []  # protocols whose checksums were right, without one sample
    hint = ""
    for baud in baud_rates(bauds):
        # A rate that the user names is tried with every protocol: devices are set to other rates than their usual ones.
        candidates = [_Listener(name) for name, row in types.items() if baud in row.bauds or (bauds and row.bauds)]
        candidates += [_Listener(SLCAN)] if baud in SLCAN_BAUDS or bauds else []
        port = SerialPort(path, baud)
        try:
            n_bytes = _listen(port, candidates, listen, silent=SILENT_S if not answered_at else listen)
        except PortError as error:
            return DiscoveredDevice(path, description, says=str(error))
        hint = port.hint
        if n_bytes == 0 and not answered_at:
            return DiscoveredDevice(
                path, description, says="silent; what speaks only when asked is not found", hint=hint
            )
        answered_at.append(baud)
        framed += [f"{c.protocol} at {baud} baud" for c in candidates if c.checked and c.decoder.frames >= LINES]
        best = max(candidates, key=_Listener.score, default=None)
        if best is not None and best.score() > (0.0, 0):
            says = "CAN adapter (slcan), its channel open" if best.protocol == SLCAN else types[best.protocol].says
            says += best.condition
            return DiscoveredDevice(path, description, best.protocol, baud, best.rate(), says, hint)
    if framed:
        says = f"frames of {' or '.join(framed)}, none with a measurement: is the right output switched on?"
        return DiscoveredDevice(path, description, says=says, hint=hint)
    tried = ", ".join(map(str, answered_at))
    return DiscoveredDevice(path, description, says=f"bytes that no protocol explains at {tried} baud", hint=hint)


def _listen(port: SerialPort, candidates: Sequence[_Listener], seconds: float, silent: float) -> int:
    """Feed the candidates for `seconds` from the first byte, or until one is certain; returns the number of bytes."""
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
            if t - start > 0.3 * seconds and any(c.checked and len(set(c.times)) >= ENOUGH for c in candidates):
                break
    finally:
        port.close()
    for candidate in candidates:
        candidate.close()
    return n_bytes
