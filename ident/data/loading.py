"""Logs read into memory: their signals, their rig and mission, and the provenance that goes into results.

A log's signals by the names that models use.

| name | from |
|---|---|
| psi, phi, theta | AHRS: yaw, roll and pitch (unwrapped by whoever averages them) |
| p, q, r, ax, ay | AHRS: body rates, specific force |
| x, y, vx, vy | GNSS: metres north and east of the first fix (`share_frame`), velocity over ground |
| n_left, n_right | shaft speed over the rig's rpm_max, positive ahead |
| n_cmd_left, n_cmd_right | commands; where an autopilot is between, its output instead |
| servo_1, servo_2, ... | pulses of an autopilot's outputs (us), where no rig names thrusters |
| force | load cell, with whatever offset it has |
| speed | along the track, from velocity over ground (imported speed_x and speed_y, or vx and vy) |
| any other | imported signals, by their own names |

Where a controller reports the magnitude of the shaft speed only, as an autopilot's ESC telemetry does, `shaft_speed`
gives it the sign of the delayed and lagged command. `propulsion_input` says which of the signals a model is driven by.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from itertools import chain, count
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks import Finding, unknown_times
from seatrial.daq.config import parse_toml
from seatrial.daq.errors import SeatrialError, SeatrialWarning, counted
from seatrial.daq.log import Log, local_ned, open_log
from seatrial.daq.rig import Rig, Thruster
from seatrial.daq.samples import Ahrs, Command, Esc, Gnss, LoadCell, Scalar, Servo
from seatrial.ident.data.gaps import SHORTEST_PIECE_S, clock_of, gap_line, part_of, parts_between, seconds, silent_times
from seatrial.ident.data.outliers import sections_elsewhere, without_outliers
from seatrial.ident.data.record import Channel, LogSegment
from seatrial.ident.numerics import Array, LagData, first_order_lag, fit_first_order_lag

Table = NDArray[np.void]  # of `Log.table`, shape (n,)
TRACK_WINDOW = 20.0  # s either way, over which the direction of travel is averaged
GRID_STEP = 0.01  # s, on which the command of a shaft of unknown sign is filtered
DELAYS = tuple(np.arange(0.0, 1.01, 0.05).tolist())  # s, that are tried for it
TIME_CONSTANTS = tuple(1.0 / (1.5 * 1.5**k) for k in range(9))  # s, that are tried, from 0.67 to 0.026
TIMES = re.compile(r"\[[\d.e+]+:[\d.e+inf]+\]\Z")  # at the end of the name of a part
MARGIN_S = 60.0  # read before and after a part of a log: what an input was told last, the sample behind the end
NEAR_DELAYS = np.arange(-0.05, 0.051, 0.01)  # s, and factors on the time constant: about the best of these
NEAR_TIME_CONSTANTS = np.array([0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.4])


class PropulsionInput(StrEnum):
    """What a log says of its thrusters; the first is the best."""

    MEASURED = "measured"  # shaft speeds with their sign, when they were
    TELEMETRY = "telemetry"  # shaft speeds relayed by an autopilot: late by an unknown time, and without a sign
    COMMAND = "command"  # commands only: of the shafts nothing is known, or too seldom


class TimeWindow(NamedTuple):
    """A part of a log, ``t_from <= t < t_to`` [s from its first sample]."""

    t_from: float = 0.0
    t_to: float = inf


WHOLE = TimeWindow()
DeviceChecks = Callable[[Log], Sequence[Finding]]
SHAFTS, COMMANDS = ("n_left", "n_right"), ("n_cmd_left", "n_cmd_right")
ORIGIN = "origin"  # of a segment's `meta`: the `FrameOrigin` of its x and y, where that is known
SHARED_WITHIN = 10_000.0  # m between first fixes: farther apart, the logs are of two places on a round earth
SLOWEST_TELEMETRY = 0.15  # s between shaft speeds; from slower ones no change of the thrust can be timed


def propulsion_input(log: Log, found: Mapping[str, Channel], holds: Mapping[str, str]) -> PropulsionInput | None:
    """What drives a model of the boat, by where its signals come from, their hold and their rate; None: no such signal.

    A shaft speed that is held from one sample to the next, or is an output that was sampled, is a command: no shaft
    jumps.
    """
    if not all(n in found for n in SHAFTS):
        return PropulsionInput.COMMAND if all(n in found for n in COMMANDS) else None
    if any(found[n].sampled or holds.get(n) == "zero" for n in SHAFTS):
        return PropulsionInput.COMMAND
    if all(n in found for n in COMMANDS) and max(np.median(np.diff(found[n].t)) for n in SHAFTS) > SLOWEST_TELEMETRY:
        return PropulsionInput.COMMAND
    by_autopilot = any(t.output is not None for t in (log.rig.thrusters if log.rig else ()))
    return PropulsionInput.TELEMETRY if by_autopilot else PropulsionInput.MEASURED


def channels(log: Log) -> dict[str, Channel]:
    """Every signal of a log, times in seconds from the log's own start of time (since 1970)."""
    found: dict[str, Channel] = {}
    for source in log.sources(Scalar):
        table = log.table(Scalar, source)
        channel = _channel(table, "value", log.unit(source), source)
        if log.role(source) == "input" and log.hold(source) != "sampled":
            channel = replace(channel, hold=log.hold(source))
        found[source] = _sampled(channel) if log.hold(source) == "sampled" else channel
    rig = log.rig
    for source in log.sources(Ahrs):
        table = log.table(Ahrs, source)
        for name, column, unit in (
            ("psi", "yaw", "rad"),
            ("phi", "roll", "rad"),
            ("theta", "pitch", "rad"),
            ("p", "p", "rad/s"),
            ("q", "q", "rad/s"),
            ("r", "r", "rad/s"),
            ("ax", "ax", "m/s2"),
            ("ay", "ay", "m/s2"),
        ):
            found.setdefault(name, _channel(table, column, unit, source))
    for source in log.sources(Gnss):
        found = _gnss(log.table(Gnss, source), source) | found
    for thruster in rig.thrusters if rig else ():
        _thruster(log, thruster, found)
    if rig is None:
        for source in log.sources(Servo):
            for node in log.nodes(Servo, source):
                found.setdefault(f"servo_{node}", _channel(log.table(Servo, source, node), "pwm", "us", source))
    for source in log.sources(LoadCell):
        found.setdefault("force", _channel(_good(log.table(LoadCell, source)), "force", "N", source))
    found = without_outliers({name: c for name, c in found.items() if c.t.size > 1})
    for pair in (("speed_x", "speed_y"), ("vx", "vy")):
        if "speed" not in found and all(n in found for n in pair):
            x, y = (found[n] for n in pair)
            if np.array_equal(x.t, y.t):
                found["speed"] = Channel(x.t, along_track(x.t, x.value, y.value), x.unit, x.source)
    return found


def ahrs_channels(table: Table, source: str) -> dict[str, Channel]:
    """Every axis of an AHRS that it reported."""
    names = {"yaw": "psi", "pitch": "theta", "roll": "phi"}
    rows = (("rad", ("yaw", "pitch", "roll")), ("rad/s", ("p", "q", "r")), ("m/s2", ("ax", "ay", "az")))
    found = {names.get(c, c): _channel(table, c, unit, source) for unit, columns in rows for c in columns}
    return {name: c for name, c in found.items() if c.t.size > 1}


def _fixes(table: Table) -> Table:
    """Return the rows with a position. A receiver without a fix may report latitude and longitude zero as valid."""
    somewhere = (table["lat"] != 0.0) | (table["lon"] != 0.0)
    good: Table = table[(table["fix"] >= 2) & np.isfinite(table["lat"]) & somewhere]
    return good


def _origin_row(table: Table) -> int:
    """Return the row of the fix that is the origin: the first one after a receiver has settled."""
    x, y = local_ned(table["lat"], table["lon"])
    return int(np.argmin(sections_elsewhere(table["t"], x, y, np.ones(x.size, bool))))


def _gnss(table: Table, source: str) -> dict[str, Channel]:
    table = _fixes(table)
    if not len(table):
        return {}
    origin = _origin_row(table)
    lat, lon = (np.append(table[c][origin], table[c]) for c in ("lat", "lon"))
    x, y = (axis[1:] for axis in local_ned(lat, lon))
    t = np.ascontiguousarray(table["t"])
    found = {"x": Channel(t, x, "m", source), "y": Channel(t, y, "m", source)}
    for name, column in (("vx", "vel_n"), ("vy", "vel_e")):
        if np.isfinite(table[column]).any():
            found[name] = _channel(table, column, "m/s", source)
    if "vx" not in found and np.isfinite(table["speed"]).any():
        found["speed"] = _channel(table, "speed", "m/s", source)
    return found


def _thruster(log: Log, thruster: Thruster, found: dict[str, Channel]) -> None:
    device, node = thruster.device, thruster.node
    shaft = None
    if node in log.nodes(Esc, device):
        state = log.table(Esc, device, node=node)
        shaft = _channel(state, "rpm", "", device)
        if node in log.nodes(Servo, device) and follows_command(state["rpm"], state["duty"]):
            # Telemetry has no sign, and the shaft follows its output late.
            output = _channel(log.table(Servo, device, node=node), "n", "", device)
            t, rpm = shaft_speed(shaft.t, shaft.value, output.t, output.value)
            shaft = Channel(t, rpm, "", device, "average")
        found[f"voltage_{thruster.name}"] = _channel(state, "voltage", "V", device)
    if shaft is not None and shaft.t.size > 1 and np.isfinite(thruster.rpm_max):
        found[f"n_{thruster.name}"] = replace(shaft, value=shaft.value / thruster.rpm_max)
    if node in log.nodes(Servo, device):
        # What the autopilot put out is what the thruster was told: between it and our command are its own delays.
        output = _channel(log.table(Servo, device, node=node), "n", "", device)
        found[f"n_cmd_{thruster.name}"] = _sampled(output)
    elif node in log.nodes(Command, device):
        found[f"n_cmd_{thruster.name}"] = _channel(log.table(Command, device, node=node), "n_cmd", "", device)


def _sampled(output: Channel) -> Channel:
    """An output that was sampled at a rate: a change came at some time since the sample before, of which the straight
    line is the mean."""
    clock = clock_of(output.t, GRID_STEP)
    mean = np.interp(clock + GRID_STEP / 2, output.t, output.value) if output.t.size else output.value
    interval = float(np.median(np.diff(output.t))) if output.t.size > 1 else 0.0
    return replace(output, t=clock, value=mean, hold="average", sampled=interval)


def _channel(table: Table, column: str, unit: str, source: str) -> Channel:
    good = np.isfinite(table[column])
    t, value = table["t"][good], table[column][good]
    return Channel(np.ascontiguousarray(t, float), np.ascontiguousarray(value, float), unit, source)


def _good(table: Table) -> Table:
    good: Table = table[table["flags"] == 0]
    return good


def along_track(t: Array, vx: Array, vy: Array) -> Array:
    """Speed [m/s] along the direction of travel (n,), negative astern.

    The direction is that of the velocity within ``TRACK_WINDOW`` seconds either way, weighted by speed: a boat that
    drifts at rest before a run has the run's direction. The magnitude alone would turn drift and noise into forward
    speed.
    """
    speed = np.hypot(vx, vy)
    a, b = np.searchsorted(t, t - TRACK_WINDOW), np.searchsorted(t, t + TRACK_WINDOW, side="right")
    sums = [np.append(0.0, np.cumsum(speed * v)) for v in (vx, vy)]
    dx, dy = (s[b] - s[a] for s in sums)
    length = np.hypot(dx, dy)
    return np.asarray(np.divide(vx * dx + vy * dy, length, out=np.zeros_like(speed), where=length > 0))


def follows_command(rpm: Array, n: Array) -> bool:
    """Whether a shaft's speeds (k,) have at each moment the sign of the command ``n`` (k,): no shaft is so quick."""
    both = (rpm != 0) & (n != 0) & np.isfinite(rpm) & np.isfinite(n)
    signs = np.sign(n[both])
    return bool(np.any(np.diff(signs)) and np.all(np.sign(rpm[both]) == signs))


def shaft_speed(t: Array, speed: Array, t_told: Array, told: Array) -> tuple[Array, Array]:
    """The speed of a shaft with its sign, from its magnitude ``speed`` (k,) at times ``t`` (k,) s and what it was told,
    ``told`` (m,) from ``t_told`` (m,) s on, each held until the next.

    What the command explains, by the delay and the first-order lag that fit best, and the rest, which is small and
    smooth, interpolated: a straight line from one sample of slow telemetry to the next would round off every step.
    Returns: times (n,) s, ``GRID_STEP`` apart, and speeds (n,), each held until the next.
    """
    speed = np.abs(speed)
    clock = clock_of(t, GRID_STEP, before=DELAYS[-1])
    held = told[np.maximum(np.searchsorted(t_told, clock, side="right") - 1, 0)]

    def scale(size: Array) -> float:
        return float(size @ speed) / max(float(size @ size), 1e-12)

    def misfit(lagged: Array, delay: float) -> float:
        size = np.abs(np.interp(t - delay, clock, lagged))
        return float(np.sum((speed - scale(size) * size) ** 2))

    delays, time_constants = np.array(DELAYS), np.array(TIME_CONSTANTS)
    for near in (1.0, 0.2, 0.0):  # each time closer about the best
        best = fit_first_order_lag(
            [LagData(held, misfit)], delays.tolist(), time_constants.tolist(), GRID_STEP, hold="backward"
        )
        delays, time_constants = best.delay + near * NEAR_DELAYS, best.time_constant * NEAR_TIME_CONSTANTS**near
    delay, lagged = 0.0, held
    if np.isfinite(best.misfit):
        delay, lagged = best.delay, first_order_lag(held, best.time_constant, GRID_STEP, hold="backward")
    then = np.interp(t - delay, clock, lagged)
    gain = scale(np.abs(then))
    rest = np.convolve(np.pad(np.copysign(speed, then) - gain * then, 1, mode="edge"), np.full(3, 1 / 3), mode="valid")
    own = clock[clock >= t[0]]
    return own - GRID_STEP / 2, gain * np.interp(own - delay, clock, lagged) + np.interp(own, t, rest)


@dataclass(frozen=True)
class FrameOrigin:
    """Where x = y = 0 is: latitude and longitude (deg), and the log whose first fix that is."""

    latitude: float
    longitude: float
    log: str = ""

    def offset(self, other: FrameOrigin) -> tuple[float, float]:
        """Metres that ``other`` lies north and east of here, by the ellipsoid's radii half way between."""
        east = (other.longitude - self.longitude + 180.0) % 360.0 - 180.0
        middle = (0.5 * (self.latitude + other.latitude), self.longitude + 0.5 * east)
        lat, lon = zip(middle, *((o.latitude, o.longitude) for o in (self, other)), strict=True)
        x, y = local_ned(np.array(lat), np.array(lon))
        return float(x[2] - x[1]), float(y[2] - y[1])


@dataclass(frozen=True)
class LoadedLog:
    """A log in memory: its signals, and what the report says of it.

    Attributes:
        propulsion: what it says of its thrusters.
        origin: of x and y; None: the log has none, or gives x and y without latitude and longitude.
        shift: by which x and y were moved there from the log's own first fix (m north, m east).
    """

    run: LogSegment
    about: dict[str, Any]
    holds: Mapping[str, str]
    rig: Rig | None
    propulsion: PropulsionInput | None = None
    segments: tuple[tuple[float, str], ...] = ()  # steps of its mission: when each began [s of the log], and its name
    vehicle: Mapping[str, float] = field(default_factory=dict)  # what rig or map know of the boat, parameters by name
    device_faults: tuple[Finding, ...] | None = None  # None: nobody looked for them
    origin: FrameOrigin | None = None
    shift: tuple[float, float] = (0.0, 0.0)
    unknown: tuple[tuple[float, float], ...] = ()  # from when to when [s of the log] an input has no value

    @property
    def own_channels(self) -> Mapping[str, Channel]:
        """The signals with x and y from the log's own first fix."""
        return _moved(self.run.channels, -self.shift[0], -self.shift[1])

    @property
    def unplaced(self) -> bool:
        """Whether it has positions, and nobody knows from where they count."""
        return self.origin is None and "x" in self.run.channels


def _moved(found: Mapping[str, Channel], north: float, east: float) -> Mapping[str, Channel]:
    if not (north or east):
        return found
    return {**found, **{n: replace(found[n], value=found[n].value + by) for n, by in (("x", north), ("y", east))}}


def share_frame(logs: Sequence[LoadedLog], reference: FrameOrigin | None = None) -> list[LoadedLog]:
    """The logs with x and y from one origin: ``reference``, else the first fix of the first log that has latitude and
    longitude. What is at one place for all logs, such as a mooring, is at one place in x and y then.

    Each log keeps the metres of its own first fix and is moved as a whole: its motion is the same to rounding. A log
    that begins farther than ``SHARED_WITHIN`` from the reference keeps its own origin, and so does one that gives x and
    y alone, of which nobody knows from where they count.
    """
    reference = reference or next((one.origin for one in logs if one.origin is not None), None)
    return [one if one.origin is None or reference is None else _placed(one, reference) for one in logs]


def _placed(one: LoadedLog, reference: FrameOrigin) -> LoadedLog:
    assert one.origin is not None
    north, east = reference.offset(one.origin)
    if np.hypot(north, east) > SHARED_WITHIN:
        return one
    run = replace(one.run, channels=_moved(one.run.channels, north, east))
    return _at(replace(one, run=run, shift=(one.shift[0] + north, one.shift[1] + east)), reference)


def _at(one: LoadedLog, origin: FrameOrigin) -> LoadedLog:
    """With this origin of x and y, also where results and records look for it."""
    run = replace(one.run, meta={**one.run.meta, ORIGIN: origin})
    return replace(one, origin=origin, run=run, about=one.about | {ORIGIN: asdict(origin)})


def far_apart(origins: Sequence[object]) -> bool:
    """Whether the logs have different origins (`FrameOrigin`). An origin that is None is unknown and is ignored."""
    return len({o for o in origins if o is not None}) > 1


def load_all(
    logs: Sequence[Path],
    validate: Sequence[Path],
    window: TimeWindow = WHOLE,
    device_faults: DeviceChecks | None = None,
) -> tuple[list[LoadedLog], list[LoadedLog]]:
    """The logs to fit, of each this window, and those to judge by, with x and y from one origin (``share_frame``); the
    same log in both is an error."""
    same = {p.resolve() for p in logs} & {p.resolve() for p in validate}
    if same:
        raise SeatrialError(f"{sorted(same)[0].name}: the same log to fit and to validate proves nothing; give another")
    own = [(p, one) for p in logs for one in known_pieces(load_run(p, "estimation", window, device_faults))]
    others = [(p, one) for p in validate for one in known_pieces(load_run(p, "validation", WHOLE, device_faults))]
    files = [p for p, _ in (*own, *others)]
    named = share_frame(told_apart([one for _, one in (*own, *others)], files))
    return named[: len(own)], named[len(own) :]


def known_pieces(one: LoadedLog) -> list[LoadedLog]:
    """Cut a log where no sensor has a sample and where an input is unknown.

    Parameters
    ----------
    one
        The log.

    Returns
    -------
    list
        Its parts in order of time, each as a log of its own. A log without such gaps is returned as it is. Parts
        shorter than `SHORTEST_PIECE_S` are left out.

    Raises
    ------
    SeatrialError
        All parts are too short.

    Notes
    -----
    One warning says where the log was cut for the sensors. With the last value before a gap of the inputs, a fit would
    use a thrust that nobody knows.
    """
    return [piece for part in parts_with_sensors(one) for piece in _parts_with_inputs(part)]


def parts_with_sensors(one: LoadedLog) -> list[LoadedLog]:
    """Cut a log where no sensor has a sample, as `known_pieces` does."""
    gaps = silent_times(one.run.channels)
    if not gaps:
        return [one]
    edges = [-inf, *(t for gap in gaps for t in gap), inf]
    found, n_short = list[LoadedLog](), 0
    for begin, end, signals in zip(edges[::2], edges[1::2], parts_between(one.run.channels, gaps), strict=True):
        a = max(begin, one.run.t_from or 0.0, min((float(c.t[0]) for c in signals.values()), default=0.0))
        last = max((float(c.t[-1]) for c in signals.values()), default=-inf)
        b = min(end, inf if one.run.t_to is None else one.run.t_to, last)
        if b - a < SHORTEST_PIECE_S:
            n_short += 1
            continue
        # Without limits of its own a record begins where all signals are known.
        t_from = one.run.t_from if one.run.t_from is not None and one.run.t_from > begin else None
        t_to = one.run.t_to if one.run.t_to is not None and one.run.t_to < end else None
        unknown = tuple((max(x, a), min(y, b)) for x, y in one.unknown if x < b and y > a)
        found.append(_as_part(one, replace(one.run, channels=signals, t_from=t_from, t_to=t_to), (a, b), unknown))
    path, short = one.about["path"], counted(n_short, "part") + f" shorter than {SHORTEST_PIECE_S:g} s"
    if not found:
        raise SeatrialError(f"{path}: has no {SHORTEST_PIECE_S:g} s on end with samples; {gap_line(gaps)}")
    rest = f"; {short} {'is' if n_short == 1 else 'are'} left out" if n_short else ""
    warnings.warn(f"{path}: {gap_line(gaps)}{rest}", SeatrialWarning, stacklevel=2)
    return [replace(part, device_faults=one.device_faults if k == 0 else ()) for k, part in enumerate(found)]


def _parts_with_inputs(one: LoadedLog) -> list[LoadedLog]:
    """Cut a log where an input is unknown."""
    if not one.unknown:
        return [one]
    first = min(float(c.t[0]) for c in one.run.channels.values()) if one.run.t_from is None else one.run.t_from
    last = max(float(c.t[-1]) for c in one.run.channels.values()) if one.run.t_to is None else one.run.t_to
    edges = [first, *(t for gap in one.unknown for t in gap), last]
    spans = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= SHORTEST_PIECE_S]
    if not spans:
        raise SeatrialError(f"{one.about['path']}: its inputs are known for less than {SHORTEST_PIECE_S:g} s on end")
    found = []
    for k, (a, b) in enumerate(spans):
        parts = {name: part for name, c in one.run.channels.items() if (part := _piece(c, a, b)).t.size > 1}
        piece = _as_part(one, replace(one.run, channels=parts, t_from=a, t_to=b), (a, b), ())
        found.append(replace(piece, device_faults=one.device_faults if k == 0 else ()))
    return found


def _as_part(
    one: LoadedLog, run: LogSegment, span: tuple[float, float], unknown: tuple[tuple[float, float], ...]
) -> LoadedLog:
    """A part of a log, with its times [s] in its name."""
    a, b = span
    file, log = (TIMES.sub("", str(one.about[key])) for key in ("path", "name"))
    times = f"[{seconds(a)}:{seconds(b)}]"
    about = one.about | {"path": f"{file}{times}", "name": f"{log}{times}", "duration": b - a}
    return replace(one, run=replace(run, name=f"{log}{times}"), about=about, unknown=unknown)


def _piece(channel: Channel, begin: float, end: float) -> Channel:
    """A signal from begin to end [s], with its last value before, which holds if it is a command."""
    a = max(int(np.searchsorted(channel.t, begin, side="right")) - 1, 0)
    b = int(np.searchsorted(channel.t, end, side="right"))
    return part_of(channel, a, b)


def load_runs(
    logs: Sequence[Path],
    role: str,
    window: TimeWindow = WHOLE,
    reference: FrameOrigin | None = None,
    device_faults: DeviceChecks | None = None,
    *,
    cut: bool = True,
) -> list[LoadedLog]:
    """Logs of one role (``load_run``), told apart, with x and y from one origin (``share_frame``); ``cut``: as the
    parts between their gaps (``known_pieces``)."""
    whole = [(p, load_run(p, role, window, device_faults)) for p in logs]
    loaded = [(p, part) for p, one in whole for part in (known_pieces(one) if cut else [one])]
    return share_frame(told_apart([one for _, one in loaded], [p for p, _ in loaded]), reference)


def told_apart(loaded: Sequence[LoadedLog], files: Sequence[Path]) -> list[LoadedLog]:
    """The logs of these files with a name each. Runs are compared, paired and shown by name, so that two of one name
    would be taken for each other: they get the folder's name before their own (``mon/run``)."""
    names = _unique([one.run.name for one in loaded], files)
    paths = _unique([one.about["path"] for one in loaded], files)
    named = (
        replace(one, run=replace(one.run, name=name), about=one.about | {"name": name, "path": path})
        for one, name, path in zip(loaded, names, paths, strict=True)
    )
    return [
        one if one.origin is None or one.origin.log != was.run.name else _at(one, replace(one.origin, log=one.run.name))
        for one, was in zip(named, loaded, strict=True)
    ]


def _unique(labels: Sequence[str], files: Sequence[Path]) -> list[str]:
    """Labels of files; those that several have with the folder, and with a number where that is the same, too."""
    found: list[str] = []
    for label, file in zip(labels, files, strict=True):
        name = f"{file.resolve().parent.name}/{label}" if labels.count(label) > 1 else label
        numbered = (f"{name} ({k})" for k in count(2))
        found.append(next(one for one in chain([name], numbered) if one not in found))
    return found


def load_run(path: Path, role: str, window: TimeWindow = WHOLE, device_faults: DeviceChecks | None = None) -> LoadedLog:
    """A log, or a window of it: the rest is not read, and so it has no ``sha256``. Times count from the first sample of
    the whole log. ``device_faults``: checks of the open log, which read what is read here. Raises SeatrialError where
    nothing is there that can be identified."""
    with open_log(path) as whole:
        log, start = whole, None
        if window != WHOLE:
            head = channels(whole.part(0.0, whole.start + MARGIN_S))
            start = min((c.t[0] for c in head.values()), default=whole.start)
            if start + window.t_from >= whole.end:
                begin = f"nothing is left from {window.t_from:g} s on"
                raise SeatrialError(f"{path}: is {whole.end - start:.0f} s long, so {begin}")
            log = whole.part(start + window.t_from - MARGIN_S, start + window.t_to + MARGIN_S)
        with log.keeping_tables():
            found = channels(log)
            origin = _first_fix(log, found, path.stem)
            unknown = _unknown_inputs(log)
            faults = tuple(device_faults(log)) if device_faults is not None and found else None
        if not found:
            raise SeatrialError(f"{path}: no signal that ident knows; see what it holds with `seatrial info {path}`")
        start = min(c.t[0] for c in found.values()) if start is None else start
        moved = {n: replace(c, t=c.t - start) for n, c in found.items()}
        last = float(max(c.t[-1] for c in moved.values()))
        about = {
            "path": path.name if window == WHOLE else f"{path.name}[{window.t_from:g}:{window.t_to:g}]",
            "sha256": log.sha256 if window == WHOLE else "",
            "role": role,
            "name": path.stem,
            "duration": log.duration if window == WHOLE else min(window.t_to, last) - window.t_from,
            "rig": log.rig.name if log.rig else None,
            "mission": _mission_name(log),
            "warnings": list(log.warnings),
        }
        holds = {n: c.hold or _hold(log, n) for n, c in found.items()}
        segments = tuple((t - start, text) for t, kind, text in log.events() if kind == "segment")
        propulsion = propulsion_input(log, moved, holds)
        t_to = min(window.t_to, last) if window.t_to < inf else None
        run = LogSegment(path.stem, moved, window.t_from or None, t_to)
        gaps = tuple((float(a - start), float(b - start)) for a, b in unknown)
        one = LoadedLog(run, about, holds, log.rig, propulsion, segments, log.vehicle, faults, unknown=gaps)
        return one if origin is None else _at(one, origin)


def _unknown_inputs(log: Log) -> list[tuple[float, float]]:
    """From when to when [s since 1970] any imported input of a thruster has no value, in order and without overlap."""
    found: list[tuple[float, float]] = []
    for source in log.sources(Scalar):
        if log.role(source) == "input":
            table = log.table(Scalar, source)
            found += unknown_times(table["t"], table["value"])
    joined: list[tuple[float, float]] = []
    for a, b in sorted(found):
        if joined and a <= joined[-1][1]:
            joined[-1] = joined[-1][0], max(joined[-1][1], b)
        else:
            joined.append((a, b))
    return joined


def _first_fix(log: Log, found: Mapping[str, Channel], name: str) -> FrameOrigin | None:
    """The origin of x and y, where they are of a receiver's latitude and longitude; else None."""
    if "x" not in found or found["x"].source not in log.sources(Gnss):
        return None
    table = _fixes(log.table(Gnss, found["x"].source))
    first = table[_origin_row(table)]
    return FrameOrigin(float(first["lat"]), float(first["lon"]), name)


def _hold(log: Log, name: str) -> str:
    try:
        return str(log.hold(name))
    except (KeyError, SeatrialError):
        return ""


def _mission_name(log: Log) -> str | None:
    text = log.attachments.get("mission.toml")
    if text is None:
        return None
    try:  # what is before the first table: the samples of a long mission take seconds to read
        return str(parse_toml(text.partition(b"\n[")[0].decode(), "mission.toml").values.get("name"))
    except (SeatrialError, UnicodeDecodeError):
        return None
