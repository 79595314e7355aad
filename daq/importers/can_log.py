"""Logs of a CAN bus (candump, Vector's ASC and BLF, and what else python-can reads) -> tables, or a log as if recorded.

Frames become the 16 bytes of `struct can_frame` and go through the decoders that read the live bus.
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
from seatrial.daq.importers.write_log import replacing
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

ENDINGS = (".log", ".asc", ".blf", ".trc", ".db", ".mf4", ".csv")  # of python-can
BLF = b"LOGG"
_HEAD = 65536


def is_can_log(head: bytes) -> bool:
    """Return whether a file that begins so is a log of a CAN bus."""
    return head.startswith(BLF) or bool(dialect_of(head))


def read_frames(path: Path) -> list[BusFrame]:
    """Return the data frames of a log, in the order of the file. Raises SeatrialError."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError as error:
        raise SeatrialError(f"{path}: cannot be read: {error.strerror}") from error
    if dialect := dialect_of(head):
        return read_text_frames(path, dialect)
    if not head.startswith(BLF) and path.suffix.lower() not in ENDINGS:
        raise SeatrialError(f"{path}: is not a CAN log; known are candump, BusMaster, {', '.join(ENDINGS)}")
    return list(_library_frames(path, "BLFReader" if head.startswith(BLF) else "LogReader"))


def _library_frames(path: Path, name: str) -> Iterator[BusFrame]:
    import can

    try:
        with getattr(can, name)(path) as reader:
            for message in reader:
                if not (message.is_error_frame or message.is_remote_frame or message.is_fd):
                    word = message.arbitration_id | (EXTENDED if message.is_extended_id else 0)
                    yield BusFrame(message.timestamp, str(message.channel), word, bytes(message.data))
    except Exception as error:  # the readers raise whatever a damaged file makes their parsing raise
        raise SeatrialError(f"{path}: cannot be read as a CAN log: {' '.join(str(error).split())}") from error


def read_can(path: Path, options: SourceOptions) -> list[Table]:
    """Tables of a CAN log: with a DBC one for each of its messages, else the samples of our own decoders.

    They are those of the map's rig or protocol, or else of the protocol that understands most. Raises SeatrialError.
    """
    frames = read_frames(path)
    if options.dbc is not None:
        return _by_dbc(path, frames, options.dbc)
    if options.rig is not None:
        rig = load_rig(options.rig)
        rows = [(device.name, frame) for device, _, frame in _decoded(frames, rig) if frame is not None]
    else:
        tried = [_bare(frames, name) for name in ([options.protocol] if options.protocol else CAN_PROTOCOLS)]
        rows = max(tried, key=len)
    if not rows:
        raise SeatrialError(
            f"{path}: {counted(len(frames), 'frame')}, none of VESC, DroneCAN or NMEA 2000; name a DBC, by "
            '--guess --dbc boat.dbc or in the map: [can] dbc = "boat.dbc"'
        )
    return sample_tables(path, [(name, frame.t_rx, frame) for name, frame in rows])


def _bare(frames: list[BusFrame], protocol: str) -> list[tuple[str, Frame]]:
    """Samples without a rig, with their buses; a VESC's rpm is then that of the field, pole pairs times the shaft's."""
    decoders = {bus: _bare_decoder(protocol) for bus in {one.bus for one in frames}}
    return [(one.bus, frame) for one in frames for frame in decoders[one.bus].feed(_wire(one), one.t)]


def _bare_decoder(protocol: str) -> Decoder:
    if protocol == "vesc":
        return vesc.Decoder(dict.fromkeys(range(256), 1))
    return dronecan.Decoder(frozenset()) if protocol == "dronecan" else nmea2000.Decoder(0.0)


def _wire(frame: BusFrame) -> bytes:
    return CAN_FRAME.pack(frame.word, len(frame.data), frame.data)


def _by_dbc(path: Path, frames: list[BusFrame], database: Path) -> list[Table]:
    """A table for each message of the DBC that came, as MESSAGE, or MESSAGE_SENDER where a PGN has several senders;
    where several buses have such messages, with the bus in front: can0_MESSAGE."""
    messages = dbc.load_dbc(str(database)).messages
    messages_by_name = {m.name: m for m in messages}
    exact = {m.frame_id | (EXTENDED if m.is_extended_frame else 0): m for m in messages if not dbc.is_j1939(m)}
    by_pgn = {dbc.pgn_bits(m.frame_id): m for m in messages if dbc.is_j1939(m)}
    found: dict[tuple[str, str, int], tuple[list[float], list[dict[str, float]]]] = {}
    refused: Counter[tuple[str, str, int]] = Counter()
    for one in frames:
        message, sender = exact.get(one.word), 0
        if message is None and one.word & EXTENDED:
            message, sender = by_pgn.get(dbc.pgn_bits(one.word & ~EXTENDED)), one.word & 0xFF
        if message is None:
            continue
        key = one.bus, message.name, sender
        try:
            raw = message.decode(one.data, decode_choices=False, scaling=False)
        except Exception:  # too short, or a multiplexer that the DBC does not know
            refused[key] += 1
            continue
        t, rows = found.setdefault(key, ([], []))
        t.append(one.t)
        rows.append({name: dbc.number(message, name, value) for name, value in raw.items()})
    if not found:
        raise SeatrialError(f"{path}: {counted(len(frames), 'frame')}, none of them as {database} has it")
    tables = []
    buses = {bus for bus, _, _ in found}
    for key, (t, rows) in found.items():
        bus, name, sender = key
        topic = f"{bus}_{name}" if len(buses) > 1 else name
        topic += f"_{sender}" if sum(other[:2] == key[:2] for other in found) > 1 else ""
        columns = {k: np.array([row.get(k, np.nan) for row in rows]) for k in dict.fromkeys(k for r in rows for k in r)}
        remark = f"{counted(refused[key], 'frame')} left out that the DBC does not fit" if refused[key] else ""
        units = {s.name: s.unit for s in messages_by_name[name].signals if s.unit}
        tables.append(Table(path, topic, columns, np.array(t), "dbc", remark=remark, units=units))
    return tables


def _decoded(frames: list[BusFrame], rig: Rig) -> Iterator[tuple[Device, BusFrame, Frame | None]]:
    """Each frame of each CAN device of the rig, and the samples that it completes; None first, for the frame itself."""
    devices = [device for device in rig.devices if DEVICES[device.protocol].bus == CAN]
    if not devices:
        raise SeatrialError(f"{rig.path}: has no device on a CAN bus")
    there = {frame.bus for frame in frames}
    decoders = {device.name: make_decoder(device, rig) for device in devices}
    for one in frames:
        for device in devices:
            bus = device.port.rpartition(":")[2]
            if bus in there and one.bus != bus:  # the log knows the buses of the rig by name
                continue
            yield device, one, None
            for frame in decoders[device.name].feed(_wire(one), one.t):
                yield device, one, frame


class _Start(NamedTuple):
    """The clock of a recorder that writes what was."""

    t: float
    speed: float = 1.0
    origin: object = None

    def now(self) -> float:
        return self.t


def import_can(path: Path, rig_path: Path, *, out: Path | None = None, force: bool = False) -> tuple[Path, str]:
    """A log of the frames as if they had been recorded by the rig: raw bytes and samples. Returns its path and a
    summary in one line. Raises SeatrialError."""
    rig = load_rig(rig_path)
    frames = sorted(read_frames(path), key=lambda frame: frame.t)
    if not frames:
        raise SeatrialError(f"{path}: holds no CAN frames")
    target, n_samples = out or Path(f"{path.stem}.mcap"), 0
    with replacing(target, force, [path, rig_path]) as part:
        recorder = Recorder(part, rig=rig, clock=_Start(frames[0].t), metadata={"import": "can"})
        try:
            recorder.event(frames[0].t, "import", path.name)
            for device, one, frame in _decoded(frames, rig):
                if frame is None:
                    recorder.write_raw(device.name, "rx", _wire(one), one.t)
                else:
                    recorder.write(device.name, frame, one.t)
                    n_samples += 1
                recorder.tick()
        finally:
            recorder.close()
        if not n_samples:  # before what stood there is replaced
            raise SeatrialError(f"{path}: {counted(len(frames), 'frame')}, none of a device of {rig_path}")
    return target, f"{counted(n_samples, 'sample')} of {counted(len(frames), 'frame')}"
