"""The safety guard: limits on what the devices report, checked at every status. It reads no clock and drives nothing.

Its geofence is a circle around the start, within which the boat has to be able to stop. Two further safety nets work
without it: the acquisition process commands zero when the runner falls silent, and every ESC times out by itself when
the acquisition process does.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from daq.acquisition import Status
from daq.errors import SafetyStop
from daq.rig import Rig
from daq.samples import Ahrs, Battery, Esc, Gnss, LoadCell

SATURATED, SPIKE = 1, 2  # LoadCell.flags
STALE_S = 1.0  # run seconds a device may be silent, at least
STALE_PERIODS = 5.0
# Wall seconds, at least. With real devices this is the same second; against mocks at 20 run seconds a wall second,
# one run second is 50 ms, and a busy machine makes longer pauses by itself.
STALE_WALL_S = 1.0
STUCK_WALL_S = 3.0  # the log's file must grow within this; it is flushed every 0.25 s
EARTH_RADIUS_M = 6_371_008.8  # IUGG mean radius
STOPPED = 0.05  # m/s; a boat slower than this drifts and does not coast
REACTION_S = 0.1  # from the fix to zero thrust


class SafetyGuard:
    """Checks each status against the rig's limits; remembers the start position and the log's growth."""

    def __init__(self, rig: Rig, speed: float, thrusters: tuple[str, ...]) -> None:
        self._rig = rig
        self._speed = speed
        self._thrusters = [rig.thruster(name) for name in thrusters]
        self._fence = None if rig.limits.radius_m is None else Fence(rig.limits.radius_m, rig.vehicle)
        self._size = -1
        self._grown_at = math.nan
        self._saturated_at = math.nan

    def check(self, status: Status) -> None:
        """Raise SafetyStop with the reason, in one line, at the first limit that is passed."""
        for reason in self._reasons(status):
            raise SafetyStop(reason)

    def _reasons(self, status: Status) -> Iterator[str]:
        yield from self._stale(status)
        yield from self._recorder(status)
        for source, latest in status.latest.items():
            sample = latest.sample
            if isinstance(sample, Esc):
                yield from self._esc(sample)
            elif isinstance(sample, LoadCell):
                yield from self._force(sample, latest.t)
            elif isinstance(sample, Gnss):
                if self._fence is not None and (reason := self._fence.reason(source[0].partition("/")[0], sample)):
                    yield reason
            elif isinstance(sample, Ahrs):
                yield from self._attitude(source[0], sample)
            elif isinstance(sample, Battery):
                yield from self._battery(source[0].partition("/")[0], sample)

    def patience(self, device: str) -> float:
        """How long [run s] a device may be silent."""
        return self._patience(self._rig.device(device).rate_hz)

    def _patience(self, rate_hz: float) -> float:
        return max(STALE_S, STALE_PERIODS / rate_hz, STALE_WALL_S * self._speed)

    def _stale(self, status: Status) -> Iterator[str]:
        for device in self._rig.devices:
            port = status.ports.get(device.name)
            age = math.inf if port is None else port.age
            # `not <=`: an age that is NaN is no sign of life.
            if not age <= self._patience(device.rate_hz):
                yield f"{device.name} ({device.port}) is silent{_since(age)}"
        yield from self._silent_thrusters(status)

    def _silent_thrusters(self, status: Status) -> Iterator[str]:
        for thruster in self._thrusters:
            device = self._rig.device(thruster.device)
            nodes = sum(other.device == device.name for other in self._rig.thrusters)
            latest = status.latest.get((device.name, thruster.node))
            age = math.inf if latest is None else status.t - latest.t
            if not age <= self._patience(device.rate_hz / nodes):
                yield f"thruster {thruster.name} (node {thruster.node} on {device.name}) is silent{_since(age)}"

    def thrusters_answer(self, status: Status) -> bool:
        """Whether every thruster's port is in order and its controller answers, so that a zero will have reached it."""
        ports = [status.ports.get(thruster.device) for thruster in self._thrusters]
        in_order = all(port is not None and not port.message for port in ports)
        return in_order and not any(self._silent_thrusters(status))

    def _recorder(self, status: Status) -> Iterator[str]:
        if status.bytes != self._size:
            self._size, self._grown_at = status.bytes, status.t
        elif status.t - self._grown_at > STUCK_WALL_S * self._speed:
            yield f"the log {status.path} does not grow any more; is the disk full?"

    def _esc(self, esc: Esc) -> Iterator[str]:
        limits = self._rig.limits
        if limits.rpm is not None and abs(esc.rpm) > limits.rpm:
            yield f"speed of node {esc.node} is {esc.rpm:.0f} rpm, limit {limits.rpm:g}"
        if limits.current_a is not None and abs(esc.current) > limits.current_a:
            yield f"current of node {esc.node} is {esc.current:.1f} A, limit {limits.current_a:g} A"
        if limits.temperature_c is not None and esc.temperature > limits.temperature_c:
            yield f"temperature of node {esc.node} is {esc.temperature:.0f} deg C, limit {limits.temperature_c:g}"
        if limits.voltage_min_v is not None and esc.voltage < limits.voltage_min_v:
            yield f"voltage of node {esc.node} is {esc.voltage:.1f} V, least {limits.voltage_min_v:g} V"

    def _attitude(self, name: str, ahrs: Ahrs) -> Iterator[str]:
        limits = self._rig.limits
        for word, angle, limit in (("roll", ahrs.roll, limits.roll_deg), ("pitch", ahrs.pitch, limits.pitch_deg)):
            if limit is not None and abs(math.degrees(angle)) > limit:
                yield f"{word} is {math.degrees(angle):.0f} deg by {name}, limit {limit:g}"

    def _battery(self, name: str, battery: Battery) -> Iterator[str]:
        limits = self._rig.limits
        if limits.voltage_min_v is not None and battery.voltage < limits.voltage_min_v:
            yield f"battery of {name} is at {battery.voltage:.1f} V, least {limits.voltage_min_v:g} V"
        if limits.battery_min is not None and battery.remaining < limits.battery_min:
            yield f"battery of {name} has {100 * battery.remaining:.0f} % left, least {100 * limits.battery_min:g} %"

    def _force(self, cell: LoadCell, t: float) -> Iterator[str]:
        limit = self._rig.limits.force_n
        if limit is None:
            return
        if cell.flags & SATURATED:
            # One saturated reading is a glitch of the converter; the next one decides.
            if t > self._saturated_at:
                yield "the load cell is saturated, its force cannot be watched"
            self._saturated_at = t if math.isnan(self._saturated_at) else self._saturated_at
            return
        self._saturated_at = math.nan
        if not cell.flags & SPIKE and abs(cell.force) > limit:
            yield f"force is {cell.force:.1f} N, limit {limit:g} N"


def _since(age: float) -> str:
    return f" for {age:.1f} s" if math.isfinite(age) else " since the start"


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
    """Keeps the position at the start, and checks that the boat can stop within the circle around it."""

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
