"""Importer of CAN logs: candump, Vector's ASC and BLF, and the other formats of python-can.

The frames become tables for a map, or a log as if the rig had recorded them. Each frame is packed into the 16 bytes of
`struct can_frame` and passed to the same decoders that read the live bus.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from seatrial.daq.config import load_rig
from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.importers.can_text import BusFrame, dialect_of, read_text_frames
from seatrial.daq.importers.import_map import CAN_PROTOCOLS
from seatrial.daq.importers.samples import sample_tables
from seatrial.daq.importers.table import SourceOptions, Table
from seatrial.daq.importers.write_log import replacing, warn_of_early_dates
from seatrial.daq.log import Recorder
from seatrial.daq.protocol import (
    CAN,
    CAN_FRAME,
    DEVICES,
    EXTENDED,
    Decoder,
    dbc,
    dronecan,
    make_decoder,
    nmea2000,
    vesc,
)
from seatrial.daq.rig import Device, Rig
from seatrial.daq.samples import Frame

ENDINGS = (".log", ".asc", ".blf", ".trc", ".db", ".mf4", ".csv")  # endings of files that python-can reads
BLF = b"LOGG"  # first bytes of a BLF file
_HEAD_BYTES = 65536  # bytes in which the dialect is recognised


def is_can_log(head: bytes) -> bool:
    """Return whether a file is a CAN log by its first bytes: a BLF file, or a text in one of the known formats."""
    return head.startswith(BLF) or bool(dialect_of(head))


def read_frames(path: Path) -> list[BusFrame]:
    """Read the data frames of a CAN log (BLF, candump, ASC, ...), in the order of the file.

    Error frames, remote requests and CAN FD frames are left out. If a text in a known format has lines that are neither
    valid frames nor known other lines (such as headings and comments), warn of them.

    Raises
    ------
    SeatrialError
        If the file cannot be read or is not a CAN log, or if a frame of a text has no time.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError as error:
        raise SeatrialError(f"{path}: cannot be read: {error.strerror}; check its path and permissions") from error
    if dialect := dialect_of(head):
        return read_text_frames(path, dialect)
    if not head.startswith(BLF) and path.suffix.lower() not in ENDINGS:
        raise SeatrialError(
            f"{path}: is not a CAN log; give one in the format of candump or BusMaster, or {', '.join(ENDINGS)}"
        )
    return list(_library_frames(path, "BLFReader" if head.startswith(BLF) else "LogReader"))


def _library_frames(path: Path, name: str) -> Iterator[BusFrame]:
    """Yield the data frames of a CAN log that python-can reads by its class `name`, "BLFReader" or "LogReader".

    The frames are in the order of the file. Error, remote and CAN FD frames are skipped. Raise SeatrialError if
    python-can cannot read the file.
    """
    import can

    try:
        with getattr(can, name)(path) as reader:
            for message in reader:
                if not (message.is_error_frame or message.is_remote_frame or message.is_fd):
                    word = message.arbitration_id | (EXTENDED if message.is_extended_id else 0)
                    yield BusFrame(message.timestamp, str(message.channel), word, bytes(message.data))
    except Exception as error:  # a damaged file can raise any error in the readers
        raise SeatrialError(
            f"{path}: cannot be read as a CAN log: {' '.join(str(error).split())}; check that the file is complete"
        ) from error


def read_can(path: Path, options: SourceOptions) -> list[Table]:
    """Read a CAN log as tables: its frames are decoded by a DBC file, by a rig, or by a CAN protocol.

    Parameters
    ----------
    path
        The CAN log.
    options
        The first of these options that is given is used. With `dbc`, the messages are decoded by that database. With
        `rig`, the CAN devices of the rig decode the log. With `protocol`, the decoder of that protocol is used. Without
        any of them, VESC, DroneCAN and NMEA 2000 are tried, and the one with the most samples is used.

    Returns
    -------
    list of Table
        With `dbc`, one table for each decoded message, and for each bus and sender of the message if there are several.
        Otherwise one table for each kind of measured sample and each node, and for each bus or device if there are
        several.

    Raises
    ------
    SeatrialError
        If the log cannot be read, or no frame can be decoded.
    """
    frames = read_frames(path)
    if options.dbc is not None:
        return _dbc_tables(path, frames, options.dbc)
    if options.rig is not None:
        rig = load_rig(options.rig)
        rows = [(device.name, frame) for device, _, frame in _samples_of_rig(frames, rig) if frame is not None]
    else:
        tried = [
            _samples_without_rig(frames, name) for name in ([options.protocol] if options.protocol else CAN_PROTOCOLS)
        ]
        rows = max(tried, key=len)
    if not rows and options.rig is not None:
        raise SeatrialError(
            f"{path}: none of its {counted(len(frames), 'frame')} belongs to a device of {options.rig}; correct "
            f"the ports, protocols and node numbers of the CAN devices in {options.rig}"
        )
    if not rows and options.protocol:
        raise SeatrialError(
            f"{path}: none of its {counted(len(frames), 'frame')} is {options.protocol}; correct protocol in [can] of "
            "the import map, or give the DBC of the bus there"
        )
    if not rows:
        raise SeatrialError(
            f"{path}: none of its {counted(len(frames), 'frame')} is VESC, DroneCAN or NMEA 2000; give the DBC of the "
            'bus: --guess --dbc boat.dbc, or in the map [can] dbc = "boat.dbc"'
        )
    return sample_tables(path, [(name, frame.t_rx, frame) for name, frame in rows])


def _samples_without_rig(frames: list[BusFrame], protocol: str) -> list[tuple[str, Frame]]:
    """Decode CAN frames by one protocol ("vesc", "dronecan", "nmea2000") without a rig file.

    Return (name of the bus, decoded sample with its times) for each sample; the list is empty if no frame belongs to
    the protocol. The samples are in the order of the frames, and each bus has a decoder of its own. The decoder of NMEA
    2000 gives no samples in the first 1.2 s of a kind of message. The speed of a VESC is electrical: the number of pole
    pairs is unknown, so it is taken as one.
    """
    decoders = {bus: _decoder_without_rig(protocol) for bus in {bus_frame.bus for bus_frame in frames}}
    return [
        (bus_frame.bus, frame)
        for bus_frame in frames
        for frame in decoders[bus_frame.bus].feed(_can_frame_bytes(bus_frame), bus_frame.t)
    ]


def _decoder_without_rig(protocol: str) -> Decoder:
    """Return a new decoder for all nodes of a CAN bus: VESC, DroneCAN, or NMEA 2000 for any other `protocol`.

    No node is reversed. Magnetic headings on NMEA 2000 are not corrected (declination 0).
    """
    if protocol == "vesc":
        return vesc.Decoder(dict.fromkeys(range(256), 1))  # one pole pair for every possible node
    return dronecan.Decoder(frozenset()) if protocol == "dronecan" else nmea2000.Decoder(0.0)


def _can_frame_bytes(frame: BusFrame) -> bytes:
    """Return a CAN frame as the 16 bytes of Linux's `struct can_frame`, the form that the protocol decoders read.

    `frame` has at most 8 bytes of data.
    """
    return CAN_FRAME.pack(frame.word, len(frame.data), frame.data)


def _dbc_tables(path: Path, frames: list[BusFrame], database: Path) -> list[Table]:
    """Decode CAN frames by a DBC file (`database`): one table for each message, with columns of its signals.

    A signal that no frame of the message has gets no column. A signal that a frame lacks is NaN in its row. The topic
    of a table is MESSAGE, or MESSAGE_SENDER if several senders on one bus send the same J1939 or NMEA 2000 message. The
    topic begins with the bus, can0_MESSAGE, if the decoded messages come from several buses. Frames that the DBC file
    does not define are ignored; frames that it cannot decode are counted in the remark of their table. A message of
    which no frame can be decoded gets no table. Raise SeatrialError if no frame can be decoded, or the DBC file cannot
    be read.
    """
    messages = dbc.load_dbc(str(database)).messages
    messages_by_name = {m.name: m for m in messages}
    exact = {m.frame_id | (EXTENDED if m.is_extended_frame else 0): m for m in messages if not dbc.is_j1939(m)}
    by_pgn = {dbc.pgn_bits(m.frame_id): m for m in messages if dbc.is_j1939(m)}
    found: dict[tuple[str, str, int], tuple[list[float], list[dict[str, float]]]] = {}
    refused: Counter[tuple[str, str, int]] = Counter()
    for bus_frame in frames:
        message, sender = exact.get(bus_frame.word), 0
        if message is None and bus_frame.word & EXTENDED:
            message, sender = by_pgn.get(dbc.pgn_bits(bus_frame.word & ~EXTENDED)), bus_frame.word & 0xFF
        if message is None:
            continue
        key = bus_frame.bus, message.name, sender
        try:
            raw = message.decode(bus_frame.data, decode_choices=False, scaling=False)
        except Exception:  # the frame is too short, or the DBC does not define this value of its multiplexer
            refused[key] += 1
            continue
        t, rows = found.setdefault(key, ([], []))
        t.append(bus_frame.t)
        rows.append({name: dbc.number(message, name, value) for name, value in raw.items()})
    if not found:
        raise SeatrialError(
            f"{path}: none of its {counted(len(frames), 'frame')} is defined in {database}; give the DBC of this bus"
        )
    tables = []
    buses = {bus for bus, _, _ in found}
    for key, (t, rows) in found.items():
        bus, name, sender = key
        topic = f"{bus}_{name}" if len(buses) > 1 else name
        topic += f"_{sender}" if sum(found_key[:2] == key[:2] for found_key in found) > 1 else ""
        columns = {k: np.array([row.get(k, np.nan) for row in rows]) for k in dict.fromkeys(k for r in rows for k in r)}
        fault = "left out: the DBC cannot decode them; give the DBC of this firmware"
        remark = f"{counted(refused[key], 'frame')} {fault}" if refused[key] else ""
        units = {s.name: s.unit for s in messages_by_name[name].signals if s.unit}
        tables.append(Table(path, topic, columns, np.array(t), "dbc", remark=remark, units=units))
    return tables


def _samples_of_rig(frames: list[BusFrame], rig: Rig) -> Iterator[tuple[Device, BusFrame, Frame | None]]:
    """Decode CAN frames, in the given order, as the CAN devices of a rig would have received them.

    Yield (device, CAN frame, None) for each frame that a device receives, then (device, CAN frame, sample) for each
    sample that this frame completes. If the log has the bus name of the device's port, the device receives the frames
    of this bus only; otherwise it receives all frames. Raise SeatrialError if the rig has no CAN device.
    """
    devices = [device for device in rig.devices if DEVICES[device.protocol].bus == CAN]
    if not devices:
        raise SeatrialError(
            f"{rig.path}: the rig has no device on a CAN bus; give the rig file of the boat that was recorded"
        )
    buses = {frame.bus for frame in frames}
    decoders = {device.name: make_decoder(device, rig) for device in devices}
    for bus_frame in frames:
        for device in devices:
            bus = device.port.rpartition(":")[2]
            # A log may number its buses in its own way. Only if it has the rig's name, the device reads this bus alone.
            if bus in buses and bus_frame.bus != bus:
                continue
            yield device, bus_frame, None
            for frame in decoders[device.name].feed(_can_frame_bytes(bus_frame), bus_frame.t):
                yield device, bus_frame, frame


class _FixedClock(NamedTuple):
    """Clock for a recorder that converts an old log: its time is always that of the log's first frame.

    The recorder reads it for the time at which the new log begins; each sample is written with the time of its frame.

    Attributes
    ----------
    t : float
        Time of the first frame [s since 1970].
    speed : float
        Seconds of this clock in one second of wall time, always 1.
    origin : object
        Always None: no other process has to rebuild this clock.
    """

    t: float
    speed: float = 1.0
    origin: object = None

    def now(self) -> float:
        """Return the time of the first frame of the CAN log [s since 1970], at every call."""
        return self.t


def import_can(path: Path, rig_path: Path, *, out: Path | None = None, force: bool = False) -> tuple[Path, str]:
    """Convert a CAN log to an MCAP log with the raw bytes and samples that a live recording with the rig would have.

    Parameters
    ----------
    path
        The CAN log.
    rig_path
        The rig file, whose CAN devices decode the frames in the order of their times.
    out
        The log to write; by default it is named after `path`, in the current folder.
    force
        Whether an existing log is replaced.

    Returns
    -------
    tuple
        The path of the new log, and the numbers of samples and CAN frames as a text.

    Raises
    ------
    SeatrialError
        If a file cannot be read, the CAN log is empty, the rig has no CAN device, no sample results for a device of the
        rig, or the new log exists and `force` is not set or `out` is one of the files read.
    """
    rig = load_rig(rig_path)
    frames = sorted(read_frames(path), key=lambda frame: frame.t)
    if not frames:
        raise SeatrialError(f"{path}: contains no CAN frames; record the bus again")
    target, n_samples = out or Path(f"{path.stem}.mcap"), 0
    with replacing(target, force, [path, rig_path]) as part:
        recorder = Recorder(part, rig=rig, clock=_FixedClock(frames[0].t), metadata={"import": "can"})
        try:
            recorder.event(frames[0].t, "import", path.name)
            if early := warn_of_early_dates(target, frames[0].t, frames[-1].t, [path]):
                recorder.event(frames[0].t, "clock", early)
            for device, bus_frame, frame in _samples_of_rig(frames, rig):
                if frame is None:
                    recorder.write_raw(device.name, "rx", _can_frame_bytes(bus_frame), bus_frame.t)
                else:
                    recorder.write(device.name, frame, bus_frame.t)
                    n_samples += 1
                recorder.tick()
        finally:
            recorder.close()
        if not n_samples:  # raised inside the block: an existing log is then not replaced
            raise SeatrialError(
                f"{path}: none of its {counted(len(frames), 'frame')} belongs to a device of {rig_path}; correct "
                f"the ports, protocols and node numbers of the CAN devices in {rig_path}"
            )
    return target, f"{counted(n_samples, 'sample')} of {counted(len(frames), 'frame')}"
