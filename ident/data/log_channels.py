"""A log's signals by the names that models use.

| name | from |
|---|---|
| psi, phi, theta | AHRS: yaw, roll and pitch (unwrapped by whoever averages them) |
| p, q, r, ax, ay | AHRS: body rates, specific force |
| x, y, vx, vy | GNSS: metres north and east of the first fix, velocity over ground |
| n_left, n_right | shaft speed over the rig's rpm_max, positive ahead; else what the autopilot's output said |
| n_cmd_left, n_cmd_right | commands; where an autopilot is between, its output instead |
| servo_1, servo_2, ... | pulses of an autopilot's outputs (us), where no rig names thrusters |
| force | load cell, tared by the static segments of the plan |
| speed | along the track, from velocity over ground (imported speed_x and speed_y, or vx and vy) |
| any other | imported signals, by their own names |

Where a controller reports the magnitude of the shaft speed only, as an autopilot's ESC telemetry does, `with_sign`
gives it the sign of the delayed and lagged command.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daq.log import Log
from daq.rig import Thruster
from daq.samples import WGS84_ECCENTRICITY_2, WGS84_SEMI_MAJOR_AXIS, Ahrs, Command, Esc, Gnss, LoadCell, Scalar, Servo
from ident.data.record import Channel
from ident.numerics import Array, LagData, first_order_lag, fit_first_order_lag

Table = NDArray[np.void]  # of `Log.table`, shape (n,)
TRACK_WINDOW = 20.0  # s either way, over which the direction of travel is averaged
GRID_STEP = 0.02  # s, on which the command of a shaft of unknown sign is filtered
DELAYS = tuple(np.arange(0.0, 1.01, 0.05).tolist())  # s, that are tried for it
TIME_CONSTANTS = tuple(1.0 / (1.5 * 1.5**k) for k in range(9))  # s, that are tried, from 0.67 to 0.026


def channels(log: Log) -> dict[str, Channel]:
    """Every signal of a log, times in seconds from the log's own start of time (since 1970)."""
    found: dict[str, Channel] = {}
    for source in log.sources(Scalar):
        table = log.table(Scalar, source)
        found[source] = _channel(table, "value", log.unit(source), source)
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
    found = {name: c for name, c in found.items() if c.t.size > 1}
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


def _gnss(table: Table, source: str) -> dict[str, Channel]:
    table = table[(table["fix"] >= 2) & np.isfinite(table["lat"])]
    if not len(table):
        return {}
    x, y = local_ned(table["lat"], table["lon"])
    t = np.ascontiguousarray(table["t"])
    found = {"x": Channel(t, x, "m", source), "y": Channel(t, y, "m", source)}
    for name, column in (("vx", "vel_n"), ("vy", "vel_e")):
        if np.isfinite(table[column]).any():
            found[name] = _channel(table, column, "m/s", source)
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
            shaft = Channel(shaft.t, with_sign(shaft.t, shaft.value, output.t, output.value), "", device)
        found[f"voltage_{thruster.name}"] = _channel(state, "voltage", "V", device)
    if shaft is not None and shaft.t.size > 1 and np.isfinite(thruster.rpm_max):
        found[f"n_{thruster.name}"] = Channel(shaft.t, shaft.value / thruster.rpm_max, "", device)
    if node in log.nodes(Servo, device):
        # What the autopilot put out is what the thruster was told: between it and our command are its own delays.
        output = _channel(log.table(Servo, device, node=node), "n", "", device)
        found[f"n_cmd_{thruster.name}"] = output
        found.setdefault(f"n_{thruster.name}", output)
    elif node in log.nodes(Command, device):
        found[f"n_cmd_{thruster.name}"] = _channel(log.table(Command, device, node=node), "n_cmd", "", device)


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


def local_ned(lat: Array, lon: Array) -> tuple[Array, Array]:
    """Degrees -> metres north and east of the first point, on the ellipsoid's radii there (Groves 2013, 2.4.2)."""
    phi = np.radians(lat[0])
    w = 1 - WGS84_ECCENTRICITY_2 * np.sin(phi) ** 2
    meridian = WGS84_SEMI_MAJOR_AXIS * (1 - WGS84_ECCENTRICITY_2) / w**1.5
    normal = WGS84_SEMI_MAJOR_AXIS / np.sqrt(w)
    east = np.radians(np.mod(lon - lon[0] + 180, 360) - 180)
    return meridian * np.radians(lat - lat[0]), normal * np.cos(phi) * east


def follows_command(rpm: Array, n: Array) -> bool:
    """Whether a shaft's speeds (k,) have at each moment the sign of the command ``n`` (k,): no shaft is so quick."""
    both = (rpm != 0) & (n != 0) & np.isfinite(rpm) & np.isfinite(n)
    signs = np.sign(n[both])
    return bool(np.any(np.diff(signs)) and np.all(np.sign(rpm[both]) == signs))


def with_sign(t: Array, speed: Array, t_told: Array, told: Array) -> Array:
    """Speeds (k,) at times ``t`` (k,) s with the sign that their shaft had, told ``told`` (m,) from ``t_told`` (m,) s
    on, each held until the next."""
    speed = np.abs(speed)
    clock = np.arange(t[0] - DELAYS[-1], t[-1] + GRID_STEP, GRID_STEP)
    held = told[np.maximum(np.searchsorted(t_told, clock, side="right") - 1, 0)]

    def misfit(lagged: Array, delay: float) -> float:
        size = np.abs(np.interp(t - delay, clock, lagged))
        scale = float(size @ speed) / max(float(size @ size), 1e-12)
        return float(np.sum((speed - scale * size) ** 2))

    best = fit_first_order_lag([LagData(held, misfit)], DELAYS, TIME_CONSTANTS, GRID_STEP, hold="backward")
    if not np.isfinite(best.misfit):
        return np.copysign(speed, np.interp(t, clock, held))
    lagged = first_order_lag(held, best.time_constant, GRID_STEP, hold="backward")
    return np.copysign(speed, np.interp(t - best.delay, clock, lagged))
