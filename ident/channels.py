"""A log's signals by the names that models use.

| name | from |
|---|---|
| psi, r, ax, ay | AHRS (heading unwrapped by whoever averages it) |
| x, y, vx, vy | GNSS: metres north and east of the first fix, velocity over ground |
| n_left, n_right | shaft speed over the rig's rpm_max, positive ahead |
| n_cmd_left, n_cmd_right | commands |
| force | load cell, tared by the static segments of the plan |
| any other | imported signals, by their own names |
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.log import Log
from daq.samples import Ahrs, Command, Esc, Gnss, LoadCell, Scalar
from ident.dataset import Channel

Array = NDArray[np.float64]
# WGS 84
SEMI_MAJOR, ECCENTRICITY_2 = 6378137.0, 6.69437999014e-3


def channels(log: Log) -> dict[str, Channel]:
    """Every signal of a log, times in seconds from the log's own start of time (since 1970)."""
    found: dict[str, Channel] = {}
    for source in log.sources(Scalar):
        table = log.table(Scalar, source)
        found[source] = _channel(table, "value", log.unit(source), source)
    rig = log.rig()
    for source in log.sources(Ahrs):
        table = log.table(Ahrs, source)
        for name, column, unit in (
            ("psi", "yaw", "rad"),
            ("r", "r", "rad/s"),
            ("ax", "ax", "m/s2"),
            ("ay", "ay", "m/s2"),
        ):
            found.setdefault(name, _channel(table, column, unit, source))
    for source in log.sources(Gnss):
        found = _gnss(log.table(Gnss, source), source) | found
    for thruster in rig.thrusters if rig else ():
        _thruster(log, thruster, found)
    for source in log.sources(LoadCell):
        found.setdefault("force", _channel(_good(log.table(LoadCell, source)), "force", "N", source))
    return {name: c for name, c in found.items() if c.t.size > 1}


def _thruster(log: Log, thruster: Any, found: dict[str, Channel]) -> None:
    state = log.table(Esc, thruster.device, node=thruster.node)
    if len(state):
        shaft = _channel(state, "rpm", "", thruster.device)
        found[f"n_{thruster.name}"] = Channel(shaft.t, shaft.value / thruster.rpm_max, "", thruster.device)
        found[f"voltage_{thruster.name}"] = _channel(state, "voltage", "V", thruster.device)
    command = log.table(Command, thruster.device, node=thruster.node)
    if len(command):
        found[f"n_cmd_{thruster.name}"] = _channel(command, "n_cmd", "", thruster.device)


def _gnss(table: Any, source: str) -> dict[str, Channel]:
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


def local_ned(lat: Array, lon: Array) -> tuple[Array, Array]:
    """Degrees -> metres north and east of the first point, on the ellipsoid's radii there (Groves 2013, 2.4.2)."""
    phi = np.radians(lat[0])
    w = 1 - ECCENTRICITY_2 * np.sin(phi) ** 2
    meridian, normal = SEMI_MAJOR * (1 - ECCENTRICITY_2) / w**1.5, SEMI_MAJOR / np.sqrt(w)
    east = np.radians(np.mod(lon - lon[0] + 180, 360) - 180)
    return meridian * np.radians(lat - lat[0]), normal * np.cos(phi) * east


def _channel(table: Any, column: str, unit: str, source: str) -> Channel:
    good = np.isfinite(table[column])
    t, value = table["t"][good], table[column][good]
    return Channel(np.ascontiguousarray(t, float), np.ascontiguousarray(value, float), unit, source)


def _good(table: Any) -> Any:
    return table[table["flags"] == 0]
