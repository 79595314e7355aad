"""What a check looked at, as curves for its report: times between samples, signals, shafts, and motion against push."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from daq.log import Log, open_log
from daq.samples import Ahrs, Esc, Gnss, LoadCell, Scalar
from ident.checks.log_checks import sides_of
from ident.checks.motion import SURGE_LAGS, YAW_LAGS, ThrusterForces, ahead, delayed_forces, filled, forces
from ident.checks.sensors import STEP, WINDOW, Channels
from ident.data import Channel, block_mean, channels
from ident.numerics import Array

WAY = 5.0  # s over which positions are differenced, as the check does
# Signals of a log in the order of showing; whatever else an imported one holds comes after them.
SHOWN = ("psi", "r", "ax", "ay", "x", "y", "vx", "vy", "force")
MOST_SIGNALS = 12
ELSEWHERE = ("phi", "theta", "p", "q", "speed")  # said by others; thrusters have a plot of their own


def envelope(content: Mapping[str, Any], logs: Sequence[str], command: str) -> dict[str, Any]:
    """What a check's page says of where it came from; without a subject it is of the logs."""
    made = {"created": datetime.now(UTC).isoformat(timespec="seconds"), "seatrial": version("seatrial")}
    return {"subject": ", ".join(logs), "command": command, **content, **made}


def log_evidence(path: Path, rig_path: str = "") -> dict[str, Any]:
    """Curves of one log, times in s from its start. Raises SeatrialError where it is no log at all.

    Keys: name, duration, rig, pauses, shafts, push, sensors, signals; each of the last five a list of curves.
    """
    with open_log(path) as log:
        c = {name: Channel(s.t - log.start, s.value, s.unit, s.source) for name, s in channels(log).items()}
        rig = log.rig
        about = {
            "name": rig_path or path.stem,
            "duration": log.duration,
            "rig": rig.name if rig else None,
        }
        pauses = _pauses(log)
        sides = sides_of(log)
    return {**about, "pauses": pauses, "shafts": _shafts(c), "push": push(c, sides), "sensors": sensors(c),
            "signals": _signals(c)}


def _pauses(log: Log) -> list[dict[str, Any]]:
    """Seconds between neighbouring samples of each device, at the later one."""
    rig = log.rig
    expected = {d.name: 1.0 / d.rate_hz for d in rig.devices} if rig else {}
    found: list[dict[str, Any]] = []
    for kind in (Ahrs, Gnss, LoadCell, Scalar):
        for source in log.sources(kind):
            if kind is not Scalar or log.role(source) == "output":
                found.append(_pause(source, log.table(kind, source)["t"], log.start, expected.get(source)))
    for source in log.sources(Esc):
        nodes = log.nodes(Esc, source)
        t = np.sort(np.concatenate([log.table(Esc, source, node)["t"] for node in nodes]))
        found.append(_pause(source, t, log.start, expected.get(source)))
    return [row for row in found if row["t"].size]


def _pause(source: str, t: Array, start: float, expected: float | None) -> dict[str, Any]:
    return {"source": source, "t": t[1:] - start, "value": np.diff(t), "expected": expected}


def _shafts(c: Channels) -> list[dict[str, Any]]:
    """Command and shaft speed of each thruster that has both."""
    names = [n.removeprefix("n_cmd_") for n in sorted(c) if n.startswith("n_cmd_")]
    both = [(n, c[f"n_cmd_{n}"], c[f"n_{n}"]) for n in names if f"n_{n}" in c]
    return [
        {"name": n, "t": shaft.t, "n": shaft.value, "t_cmd": told.t, "n_cmd": told.value, "end": shaft.t[-1]}
        for n, told, shaft in both
        if shaft.t is not told.t
    ]


def push(c: Channels, sides: Mapping[str, float]) -> list[dict[str, Any]]:
    """Yaw rate and speed ahead, measured and as the thrusters' push would have them; ``sides``: m to starboard."""
    given = forces(c, sides)
    if given is None:
        return []
    found: list[dict[str, Any]] = []
    if given.side.any():
        r = filled(given.t, block_mean(c["r"], given.edges)[0])
        found.append(_pushed("yaw rate", "rad/s", given, r, given.f @ given.side, YAW_LAGS))
    if (u := ahead(c, given.t)) is not None:
        found.append(_pushed("speed ahead over ground", "m/s", given, u, given.f.sum(axis=1), SURGE_LAGS))
    return [row for row in found if np.isfinite(row["expected"]).any()]


def _pushed(title: str, unit: str, given: ThrusterForces, y: Array, f: Array, lags: Sequence[float]) -> dict[str, Any]:
    expected = delayed_forces(y, f, lags) if np.ptp(f) > 0.0 else np.full(y.size, np.nan)
    return {"title": title, "unit": unit, "t": given.t, "measured": y, "expected": expected}


def sensors(c: Channels) -> list[dict[str, Any]]:
    """What two sensors say of one motion: turning by heading and gyro, velocity by positions and by itself."""
    found = []
    if {"psi", "r"} <= set(c):
        in_radians = np.abs(c["psi"].value).max() < 7.0
        heading = np.unwrap(c["psi"].value, period=2.0 * np.pi if in_radians else 360.0)
        found.append(_two("yaw rate", "rad/s", ("of the heading over 1 s", "of the gyro"),
                          Channel(c["psi"].t, heading), c["r"], WINDOW))
    for where, way, speed in (("north", "x", "vx"), ("east", "y", "vy")):
        if {way, speed} <= set(c):
            names = ("of the positions over 5 s", "as the receiver says")
            found.append(_two(f"velocity {where}", "m/s", names, c[way], c[speed], WAY))
    return [row for row in found if row["t"].size > 1]


def _two(title: str, unit: str, names: tuple[str, str], whole: Channel, rate: Channel, window: float) -> dict[str, Any]:
    """The change of one signal over a window against the mean of its rate in that window, at the window's middle."""
    start, end = max(whole.t[0], rate.t[0]), min(whole.t[-1], rate.t[-1])
    t = np.arange(start, end - window, 2.0 * STEP)
    grid = np.arange(start, end, STEP)
    of_rate = np.interp(grid, rate.t, rate.value)
    integral = np.append(0.0, np.cumsum(0.5 * STEP * (of_rate[1:] + of_rate[:-1]))) if grid.size else grid
    one = (np.interp(t + window, whole.t, whole.value) - np.interp(t, whole.t, whole.value)) / window
    other = (np.interp(t + window, grid, integral) - np.interp(t, grid, integral)) / window if grid.size else t
    return {"title": title, "unit": unit, "names": list(names), "t": t + window / 2, "one": one, "other": other}


def _signals(c: Channels) -> list[dict[str, Any]]:
    """Every sensor's values as they came."""
    others = [n for n in c if n not in SHOWN and n not in ELSEWHERE and not n.startswith(("n_", "f_"))]
    names = [*(n for n in SHOWN if n in c), *others][:MOST_SIGNALS]
    return [{"channel": n, "unit": c[n].unit, "t": c[n].t, "value": c[n].value, "angle": n == "psi"} for n in names]
