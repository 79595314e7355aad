"""The command `seatrial import mavlink`: import of a ground station's tlog or of an ArduPilot DataFlash log (BIN)."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from seatrial.daq.clock import ClockMap
from seatrial.daq.drivers import ParameterMismatch, check_parameters
from seatrial.daq.errors import SeatrialError, counted, warn
from seatrial.daq.importers.dataflash import firmware_type, read_dataflash
from seatrial.daq.importers.write_log import Timed, clock_steps, replacing, sha256_of, warn_of_early_dates
from seatrial.daq.log import LOG_FORMAT, NANO, LogWriter, cdr_layout, collect_provenance, schema
from seatrial.daq.protocol import (
    FrameHeader,
    MavlinkDecoder,
    SampleConverter,
    has_correct_checksum,
    make_sample_converter,
    parse_header,
)
from seatrial.daq.rig import Device, Rig
from seatrial.daq.samples import Ahrs, Event, Gnss

STAMP = 8  # bytes before each frame of a tlog: us since 1970, big-endian
DATAFLASH = b"\xa3\x95"  # first bytes of a DataFlash log
# Two autopilots are recognised by boot times that run back: by more than BACK_S [s], in at least FEWEST_BACK samples
# and in more than the share ALTERNATE of all samples. The times of one autopilot may run back slightly: some messages
# have ms and others us, and a radio may swap frames.
BACK_S, FEWEST_BACK, ALTERNATE = 0.05, 10, 0.2
DEVICE = "autopilot"  # name of the device in a log without a rig


def import_mavlink(
    path: Path, *, rig: Rig | None = None, system: int | None = None, out: Path | None = None, force: bool = False
) -> tuple[Path, str]:
    """Convert a tlog or DataFlash log of an autopilot to an MCAP log with its samples.

    Parameters
    ----------
    path
        A tlog or a DataFlash log.
    rig
        The rig, which names and scales the thrusters. Its MAVLink device names the topics. Without a rig (None) their
        device is "autopilot".
    system
        MAVLink system number in a tlog; None for the first autopilot that sends a heartbeat. Not used for a DataFlash
        log, which is of one autopilot.
    out
        The log to write; by default it is named after `path`, in the current folder.
    force
        Whether an existing log is replaced.

    Returns
    -------
    tuple
        The path of the new log, and a summary in one line: numbers of samples, and differences from the rig.

    Raises
    ------
    SeatrialError
        If the file cannot be read, contains no samples of the autopilot or times outside 1970 to 2038, if two
        autopilots in a tlog have the same system number, if the rig does not have exactly one MAVLink device, or if the
        log exists and `force` is not set or the log is one of the files read.
    """
    rows, summary, parameters = read_autopilot(path, rig, system)
    device = _mavlink_device(rig)
    counts = Counter(type(row.frame.sample).__name__ for row in rows)
    summary += ": " + ", ".join(f"{n} {name}" for name, n in counts.most_common())
    summary += "".join(f"; differs from the rig: {finding}" for finding in mismatches(parameters, rig))
    target = out or Path(f"{path.stem}.mcap")
    about = {"import": "mavlink", "source.1.name": path.name, "source.1.sha256": sha256_of(path)}
    name = device.name if device is not None else DEVICE
    reads = [path] if rig is None else [path, rig.path]
    with replacing(target, force, reads) as part:
        _write_log_file(target, part, name, rows, about, rig, f"{path.name}: {summary}", path)
    return target, summary


def read_autopilot(path: Path, rig: Rig | None, system: int | None) -> tuple[list[Timed], str, dict[str, float]]:
    """Read the samples in a tlog or a DataFlash log of an autopilot.

    Parameters
    ----------
    path
        The log of an autopilot.
    rig
        The rig, which names and scales the thrusters; None without one.
    system
        MAVLink system number in a tlog; None for the first autopilot that sends a heartbeat. Not used for a DataFlash
        log.

    Returns
    -------
    tuple
        The samples with their times, a summary in one line, and the parameters of the autopilot by name.

    Raises
    ------
    SeatrialError
        If the file cannot be read or contains no samples, or if the rig does not have exactly one MAVLink device.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SeatrialError(f"{path}: cannot be read: {error.strerror}; check its path and permissions") from error
    if data.startswith(DATAFLASH):
        return read_dataflash(path, rig, _mavlink_device(rig))
    return read_tlog(path, data, rig, _mavlink_device(rig), system)


def is_tlog(head: bytes) -> bool:
    """Return whether the first bytes of a file are those of a tlog.

    A tlog begins with a time in us since 1970 (here 2005 to 2112) and the first byte of a MAVLink frame.
    """
    return len(head) > STAMP and head[STAMP] in (0xFD, 0xFE) and 2**50 < struct.unpack_from(">Q", head)[0] < 2**52


def _mavlink_device(rig: Rig | None) -> Device | None:
    """Return the MAVLink device (autopilot) of a rig, or None if no rig is given.

    SeatrialError is raised if the rig has no MAVLink device or more than one.
    """
    if rig is None:
        return None
    found = [device for device in rig.devices if device.protocol == "mavlink"]
    if len(found) != 1:
        raise SeatrialError(
            f"{rig.path}: this import needs a rig with exactly one device of protocol mavlink, and this rig has "
            f"{len(found)}; give another rig"
        )
    return found[0]


def read_tlog(
    path: Path, data: bytes, rig: Rig | None, device: Device | None, system: int | None
) -> tuple[list[Timed], str, dict[str, float]]:
    """Read the samples in a tlog, the log of MAVLink frames that a ground station writes.

    If `system` is None and the tlog has further autopilots, warn that they are left out.

    Parameters
    ----------
    path
        The tlog, for messages.
    data
        Its bytes.
    rig, device
        The rig and its autopilot; None without a rig.
    system
        MAVLink system number, of which only component 1 is read; None for the first autopilot that sends a heartbeat.

    Returns
    -------
    tuple
        The samples in the order of the file with their times [s since 1970], a summary in one line, and the autopilot's
        parameters by name. Device times are mapped onto the clock of the ground station by the shortest delay between
        measurement and receipt; a sample without a device time has its time of receipt.

    Raises
    ------
    SeatrialError
        If the tlog has no samples of the system, or two autopilots have the same system number, or `system` is None and
        no autopilot sends a heartbeat.
    """
    component = 1
    if system is None:
        system, component = _first_autopilot(path, data)
        others = sorted({found.system for found, _ in _heartbeats(data)} - {system})
        if others:
            names = " and ".join(str(number) for number in others)
            text = (
                f"{path}: system {system} is imported; the log also contains system {names}: choose one with "
                "--system, or with `system` in the import map"
            )
            warn(text)
    samples = make_sample_converter(device, rig) if device is not None and rig is not None else SampleConverter()
    decoder = MavlinkDecoder(samples, system, component)
    parameters: dict[str, float] = {}

    def listen(message: Any) -> None:
        """Store the value of a MAVLink message PARAM_VALUE by the parameter's name. Ignore all other messages.

        A later value of the same parameter replaces the earlier one.
        """
        if message.get_type() == "PARAM_VALUE":
            parameters[message.param_id] = float(message.param_value)

    decoder.listener = listen
    clock = ClockMap()
    rows: list[Timed] = []
    skipped, end = 0, 0
    for t_rx, at, found in _tlog_frames(data):
        skipped, end = skipped + at - STAMP - end, at + found.total
        for frame in decoder.feed(data[at:end], t_rx):
            t = clock.estimate(frame.t_device, t_rx, unordered=True, kind=type(frame.sample))
            rows.append(Timed(frame, t))
    skipped += len(data) - end
    if not rows:
        raise SeatrialError(
            f"{path}: no samples of system {system} in {decoder.frames} frames of this tlog; "
            f"{_other_systems_text(decoder)}"
        )
    _refuse_two_autopilots(path, rows, system)
    delay = f"device times {1e3 * clock.bias:.1f} ms before their arrival, spread {1e3 * clock.spread:.1f} ms"
    read = f"{counted(decoder.frames, 'frame')}, {decoder.lost} lost, {counted(skipped, 'byte')} not understood"
    return rows, f"system {system}, {read}, {delay}", parameters


def _refuse_two_autopilots(path: Path, rows: Sequence[Timed], system: int) -> None:
    """Raise SeatrialError if two autopilots send with the same MAVLink system number; otherwise return nothing.

    Two autopilots are assumed if the times since boot of attitudes or of fixes (`rows`, in the order of the file) run
    back by more than 0.05 s in more than 20 % of the samples, at least ten times.
    """
    for kind in (Ahrs, Gnss):
        boot = np.array([row.frame.t_device for row in rows if isinstance(row.frame.sample, kind)])
        known = boot[np.isfinite(boot)]
        n_back = int(np.sum(np.diff(known) < -BACK_S))
        if n_back >= FEWEST_BACK and n_back > ALTERNATE * known.size:
            raise SeatrialError(
                f"{path}: two autopilots send as system {system}: the times of two clocks alternate "
                f"({counted(n_back, 'time')}); change the number of one of them (SYSID_THISMAV, MAV_SYSID) and record "
                "again"
            )


def mismatches(p: Mapping[str, float], rig: Rig | None) -> list[ParameterMismatch]:
    """Compare the parameters of an autopilot's outputs, such as pulse widths, with the rig; return those that differ.

    Only the parameters SERVOn_... of the outputs that drive thrusters of the rig are compared.

    Parameters
    ----------
    p
        Parameters of the autopilot by name.
    rig
        The rig; None without one.

    Returns
    -------
    list of ParameterMismatch
        The differences; empty without a rig. A parameter that is not in `p` is no difference.
    """
    device = _mavlink_device(rig)
    thrusters = [] if rig is None or device is None else [t for t in rig.thrusters if t.device == device.name]
    outputs = tuple(f"SERVO{thruster.node}_" for thruster in thrusters)
    return [
        mismatch
        for mismatch in check_parameters(p, thrusters, 0)
        if mismatch.value is not None and mismatch.name.startswith(outputs)
    ]


def _other_systems_text(decoder: MavlinkDecoder) -> str:
    """Return the part of an error message that lists the other MAVLink systems which the decoder found in a tlog.

    The text advises to choose one of them. Without another system it only advises to check the message rates of the
    autopilot.
    """
    others = ", ".join(str(number) for number in sorted(decoder.foreign))
    return (
        f"it contains systems {others}: choose one with --system, or with `system` in the import map"
        if others
        else "check the message rates of the autopilot, and record again"
    )


def _tlog_frames(data: bytes) -> Iterator[tuple[float, int, FrameHeader]]:
    """Yield (time [s since 1970], offset of the frame [bytes], header) of each complete MAVLink frame of a tlog.

    `data` are the bytes of the tlog. Bytes between the frames, and frames with a wrong checksum, are skipped. An
    incomplete frame at the end yields nothing.
    """
    at = 0
    while at + STAMP < len(data):
        found = parse_header(data, at + STAMP) if data[at + STAMP] in (0xFD, 0xFE) else -1
        if found == 0:
            return
        if (
            isinstance(found, int)
            or at + STAMP + found.total > len(data)
            or not has_correct_checksum(data[at + STAMP : at + STAMP + found.total], found)
        ):
            at += 1
            continue
        yield struct.unpack_from(">Q", data, at)[0] * 1e-6, at + STAMP, found
        at += STAMP + found.total


def _first_autopilot(path: Path, data: bytes) -> tuple[int, int]:
    """Return system and component number of the first autopilot heartbeat in a tlog.

    Raise SeatrialError if no autopilot has sent one.
    """
    for found, _ in _heartbeats(data):
        return found.system, found.component
    raise SeatrialError(
        f"{path}: contains no heartbeat of an autopilot; give a tlog or a DataFlash .BIN file of an autopilot"
    )


def _heartbeats(data: bytes) -> Iterator[tuple[FrameHeader, int]]:
    """Yield header and MAV_TYPE (type of the vehicle) of each autopilot heartbeat in a tlog.

    Heartbeats of ground stations and other systems that are no autopilot are skipped.
    """
    for _, at, found in _tlog_frames(data):
        payload = at + (10 if data[at] == 0xFD else 6)
        if found.message_id == 0 and found.payload > 5 and data[payload + 5] != 8:  # 8: MAV_AUTOPILOT_INVALID
            yield found, data[payload + 4]


def vehicle_type(path: Path, rows: Sequence[Timed], system: int | None) -> int | None:
    """Return the MAV_TYPE (type of the vehicle) of a tlog or a DataFlash log.

    Parameters
    ----------
    path
        The log of the autopilot.
    rows
        Its samples.
    system
        MAVLink system number in a tlog; None for the first autopilot. Not used for a DataFlash log.

    Returns
    -------
    int or None
        MAV_TYPE by the heartbeats of a tlog, or by the texts of a DataFlash log; None if unknown.
    """
    data = path.read_bytes()
    if data.startswith(DATAFLASH):
        texts = [row.frame.sample.text for row in rows if isinstance(row.frame.sample, Event)]
        return firmware_type(texts)
    return next((kind for found, kind in _heartbeats(data) if system in (None, found.system)), None)


def _write_log_file(
    out: Path,
    part: Path,
    device: str,
    rows: Sequence[Timed],
    about: dict[str, str],
    rig: Rig | None,
    note: str,
    source: Path,
) -> None:
    """Write the samples of an autopilot in the order of receipt to `part`, the temporary file of the log `out`.

    `device` is the name of the autopilot in the topics, `about` has metadata of the log, `note` becomes an event, and
    the text of `rig` is attached, unless it is None. Warn of clocks that run back and of dates that are 1024 weeks too
    early by the date of the file `source`, and add these lines as events. Raise SeatrialError if a time is not between
    1970 and 2038.
    """
    in_file_order = rows
    rows = sorted(rows, key=lambda row: row.frame.t_rx)
    if not all(0.0 <= t < 2**31 for row in rows for t in (row.frame.t_rx, row.t)):
        raise SeatrialError(
            f"{source}: its times are not between 1970 and 2038; record again with a GNSS fix, which sets the clock"
        )
    samples = ((device, row.frame, row.frame.t_rx) for row in in_file_order if not isinstance(row.frame.sample, Event))
    steps = clock_steps(out, samples)
    if early := warn_of_early_dates(out, rows[0].frame.t_rx, rows[-1].frame.t_rx, [source]):
        steps.append(early)
    first = round(rows[0].frame.t_rx * NANO)
    metadata = {**collect_provenance(imported=True), "format": LOG_FORMAT, "speed": "1.0", **about}
    attachments = {} if rig is None else {"rig.toml": rig.text.encode()}
    writer = LogWriter(part, metadata=metadata, attachments=attachments, time_ns=first)
    try:
        _add_events_and_samples(writer, device, rows, first, [("import", note), *(("clock", text) for text in steps)])
    finally:
        writer.close()


def _add_events_and_samples(
    writer: LogWriter, device: str, rows: Sequence[Timed], first: int, events: Sequence[tuple[str, str]]
) -> None:
    """Write events (kind and text) at the time `first` [ns since 1970], then the samples of a device, to a log.

    Samples are written at their time of receipt, in the given order, each to the topics of its kind, with the estimated
    time as their stamp. Events among the samples are written to /event, as the first ones are.
    """
    event = writer.channel("/event", schema.EVENT)
    about = cdr_layout(schema.EVENT, b"")
    for kind, text in events:
        writer.add(event, first, first, 0, about.pack(first, tail=(kind.encode(), text.encode())))
    channels: dict[str, int] = {}
    for sequence, (frame, t) in enumerate(rows, start=1):
        log_ns, stamp_ns = round(frame.t_rx * NANO), round(t * NANO)
        if isinstance(frame.sample, Event):
            tail = (frame.sample.kind.encode(), frame.sample.text.encode())
            writer.add(event, log_ns, stamp_ns, 0, about.pack(stamp_ns, tail=tail))
            continue
        for message in schema.messages(device, frame):
            if message.topic not in channels:
                channels[message.topic] = writer.channel(message.topic, message.type_name)
            data = cdr_layout(message.type_name, message.frame_id.encode()).pack(stamp_ns, *message.values)
            writer.add(channels[message.topic], log_ns, stamp_ns, sequence, data)
