"""The geofence: a circle around the start, that a boat has to be able to stop within."""

from __future__ import annotations

import math
from collections.abc import Mapping

from daq.samples import Gnss

EARTH_RADIUS_M = 6_371_008.8  # IUGG mean radius
STOPPED = 0.05  # m/s; a boat slower than this drifts and does not coast
REACTION_S = 0.1  # from the fix to zero thrust


def stopping_distance(speed: float, vehicle: Mapping[str, float]) -> float:
    """Distance [m] that a boat coasts from `speed` [m/s] without thrust: m_u u' = -d_u u - d_uu u^2, solved.

    0 where the rig's [vehicle] does not give `m_u` and a damping.
    """
    m_u, d_u, d_uu = (max(vehicle.get(name, 0.0), 0.0) for name in ("m_u", "d_u", "d_uu"))
    if speed <= STOPPED or m_u == 0.0 or d_u + d_uu == 0.0:
        return 0.0
    if d_uu == 0.0:
        return m_u * (speed - STOPPED) / d_u
    return m_u / d_uu * math.log((d_u + d_uu * speed) / (d_u + d_uu * STOPPED))


class Fence:
    """Remembers where the run began."""

    def __init__(self, radius_m: float, vehicle: Mapping[str, float]) -> None:
        self._radius, self._vehicle = radius_m, vehicle
        self._home: tuple[float, float] | None = None  # rad

    def reason(self, name: str, fix: Gnss) -> str:
        """Why the run has to end, in one line; empty while the boat is inside and can stop inside."""
        if fix.fix < 2 or not math.isfinite(fix.lat + fix.lon):
            return ""
        lat, lon = math.radians(fix.lat), math.radians(fix.lon)
        if self._home is None:
            self._home = (lat, lon)
        north = lat - self._home[0]
        # The shorter way round, so that a start beside the date line is a start like any other.
        east = math.remainder(lon - self._home[1], 2.0 * math.pi) * math.cos(lat)
        length = math.hypot(north, east)
        distance = EARTH_RADIUS_M * length
        if distance > self._radius:
            return f"{distance:.0f} m from the start by {name}, limit {self._radius:g} m"
        outward = (north * fix.vel_n + east * fix.vel_e) / length if length > 0.0 else 0.0
        if not outward > 0.0:  # NaN too: a receiver without velocity
            return ""
        coast = outward * REACTION_S + stopping_distance(outward, self._vehicle)
        if distance + coast > self._radius:
            return (
                f"{distance:.0f} m from the start by {name} and {coast:.0f} m to stop from {outward:.1f} m/s, "
                f"limit {self._radius:g} m"
            )
        return ""
