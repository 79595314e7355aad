"""The safety guard: limits on what the devices report, checked at every status. It reads no clock and drives nothing.

A limit needs a source: something that reports the limited quantity as a number, and goes on doing so. Without one
nothing moves, and a run whose limit loses its source ends. The geofence is a circle around the start, within which the
boat has to be able to stop. Two further safety nets work without the guard: the acquisition process commands zero when
the runner falls silent, and every ESC times out by itself when the acquisition process does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from bench.execution.link_test import NEUTRAL
from daq.acquisition import Source, Status, senders
from daq.errors import SafetyStop
from daq.rig import Rig, Thruster
from daq.samples import NAN, Ahrs, Battery, Esc, Gnss, LoadCell, Sample, Servo

LOAD_CELLS = ("loadcell", "openscale", "mantracourt")  # protocols
SATURATED, SPIKE = 1, 2  # LoadCell.flags
STALE_S = 1.0  # run seconds a device may be silent, at least
STALE_PERIODS = 5.0
# Wall seconds, at least. With real devices this is the same second; against mocks at 20 run seconds a wall second,
# one run second is 50 ms, and a busy machine makes longer pauses by itself.
STALE_WALL_S = 1.0
STUCK_WALL_S = 3.0  # the log's file must grow within this; it is flushed every 0.25 s
# A limited quantity may be missing for so many times the patience with its device: longer than the device itself, so
# that a plug that was pulled is called that; position, temperature, voltage and charge come more slowly.
QUICK, SLOW = 1.5, 3.0
EARTH_RADIUS_M = 6_371_008.8  # IUGG mean radius
STOPPED = 0.05  # m/s; a boat slower than this drifts and does not coast
REACTION_S = 0.1  # from the fix to zero thrust
OFTEN_HZ = 4.0  # wall: at least two reports while zero is repeated


@dataclass(frozen=True)
class _Quantity:
    """What a limit limits: its name, who reports it, and what helps where nobody does."""

    name: str
    value: Mapping[type[Any], Callable[[Any], float]]  # by kind of sample; NaN where it does not tell
    remedy: str
    slow: bool = False


def _position(fix: Gnss) -> float:
    return fix.lat + fix.lon if fix.fix >= 2 else NAN


_STATUS = "let the controller send its status"
_QUANTITIES = {  # by key of [limits]
    "force_n": _Quantity(
        "force",
        {LoadCell: lambda cell: NAN if cell.flags else cell.force},
        "a load cell needs its [device.calibration]",
    ),
    "rpm": _Quantity("shaft speed", {Esc: lambda esc: esc.rpm}, _STATUS),
    "current_a": _Quantity("current", {Esc: lambda esc: esc.current}, _STATUS),
    "temperature_c": _Quantity("temperature", {Esc: lambda esc: esc.temperature}, f"{_STATUS} (VESC: 4)", slow=True),
    "voltage_min_v": _Quantity(
        "voltage",
        {Esc: lambda esc: esc.voltage, Battery: lambda battery: battery.voltage},
        f"{_STATUS} (VESC: 5), or an autopilot that of the battery",
        slow=True,
    ),
    "battery_min": _Quantity(
        "charge", {Battery: lambda battery: battery.remaining}, "let an autopilot send that of the battery", slow=True
    ),
    "roll_deg": _Quantity("roll", {Ahrs: lambda ahrs: ahrs.roll}, "add an AHRS to the rig"),
    "pitch_deg": _Quantity("pitch", {Ahrs: lambda ahrs: ahrs.pitch}, "add an AHRS to the rig"),
    "radius_m": _Quantity("position", {Gnss: _position}, "wait for a fix of the GNSS receiver", slow=True),
}


@dataclass
class LimitSource:
    """A limit, whom it protects, and what has last reported a number for it."""

    key: str  # of [limits]
    limit: float
    whom: str  # a thruster or a load cell; empty where any source will do
    place: str  # of the thruster
    takes: Callable[[Source, Sample], bool]
    source: str = ""  # the device
    t: float = -math.inf  # run time of that number

    @property
    def is_slow(self) -> bool:
        """Whether it may be silent for a little longer."""
        return _QUANTITIES[self.key].slow

    def observe(self, source: Source, sample: Sample, t: float) -> None:
        """Note a sample that holds the quantity."""
        value = _QUANTITIES[self.key].value.get(type(sample))
        if value is not None and t > self.t and self.takes(source, sample) and math.isfinite(value(sample)):
            self.source, self.t = source[0].partition("/")[0], t

    def silence(self, now: float) -> str:
        """Of whom nothing is heard, and for how long."""
        whom = f" of {self.whom}" if self.whom else ""
        return f"no {_QUANTITIES[self.key].name}{whom}{self.place}{_since(now - self.t)}"

    def refusal(self, now: float) -> str:
        """Why nothing may move, and what to do about it."""
        remedy = f'{_QUANTITIES[self.key].remedy}, or write unwatched = ["{self.key}"] in [limits]'
        return f"limits.{self.key} = {self.limit:g} is not watched: {self.silence(now)}; {remedy}"


def _limit_sources(rig: Rig, thrusters: list[Thruster]) -> Iterator[LimitSource]:
    """The limits of a rig that have to be watched: those of a thruster once for each, of force for each load cell."""
    cells = [device.name for device in rig.devices if device.protocol in LOAD_CELLS]
    for key, quantity in _QUANTITIES.items():
        limit = getattr(rig.limits, key)
        if limit is None or key in rig.limits.unwatched:
            continue
        if Esc in quantity.value:
            for thruster in thrusters:
                place = f" (node {thruster.node} on {thruster.device})"
                yield LimitSource(key, limit, f"thruster {thruster.name}", place, _of_thruster(thruster))
        elif key == "force_n" and cells:
            for cell in cells:
                yield LimitSource(key, limit, cell, "", _of_device(cell))
        else:
            yield LimitSource(key, limit, "", "", lambda source, sample: True)


def _of_thruster(thruster: Thruster) -> Callable[[Source, Sample], bool]:
    """A controller's own samples; those of a battery count for every thruster."""

    def takes(source: Source, sample: Sample) -> bool:
        own = (source[0].partition("/")[0], source[1]) == (thruster.device, thruster.node)
        return own or isinstance(sample, Battery)

    return takes


def _of_device(name: str) -> Callable[[Source, Sample], bool]:
    return lambda source, sample: source[0].partition("/")[0] == name


class SafetyGuard:
    """Checks each status against the rig's limits; remembers the start position and the log's growth."""

    def __init__(self, rig: Rig, speed: float, thrusters: tuple[str, ...]) -> None:
        self._rig = rig
        self._speed = speed
        self._thrusters = [rig.thruster(name) for name in thrusters]
        self._fence = None if rig.limits.radius_m is None else Fence(rig.limits.radius_m, rig.vehicle)
        self._size = -1
        self._grown_at = math.nan
        self._saturated_at: dict[str, float] = {}  # by load cell
        self.limits = list(_limit_sources(rig, self._thrusters))

    def unwatched(self, status: Status) -> list[LimitSource]:
        """The limits without a source that still speaks at this status; thrust is for when there are none."""
        for source, latest in status.latest.items():
            if not _is_dead(source, latest.sample, status):  # it watches nothing, whatever its value
                for limit in self.limits:
                    limit.observe(source, latest.sample, latest.t)
        return [limit for limit in self.limits if not status.t - limit.t <= self._limit_patience(limit)]

    def _limit_patience(self, limit: LimitSource) -> float:
        if not limit.source:
            return 0.0
        device = self._rig.device(limit.source)
        nodes = sum(thruster.device == device.name for thruster in self._rig.thrusters)
        return self._patience(device.rate_hz / max(nodes, 1)) * (SLOW if limit.is_slow else QUICK)

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
                yield from self._force(source[0], sample, latest.t)
            elif isinstance(sample, Gnss):
                if self._fence is not None and (reason := self._fence.reason(source[0].partition("/")[0], sample)):
                    yield reason
            elif isinstance(sample, Ahrs):
                yield from self._attitude(source[0], sample)
            elif isinstance(sample, Battery):
                yield from self._battery(source[0].partition("/")[0], sample)
        for limit in self.unwatched(status):
            yield f"limits.{limit.key} is not watched any more: {limit.silence(status.t)}"

    def patience(self, device: str) -> float:
        """How long [run s] a device may be silent."""
        return self._patience(self._rig.device(device).rate_hz)

    def _patience(self, rate_hz: float) -> float:
        return max(STALE_S, STALE_PERIODS / rate_hz, STALE_WALL_S * self._speed)

    def is_outdated(self, source: Source, status: Status) -> bool:
        """Whether a source has been silent for so long that its newest sample no longer says how things are. For the
        display: no limit depends on it."""
        name = source[0].partition("/")[0]
        kinds, nodes = senders(status, name)
        rate_hz = self._rig.device(name).rate_hz / (1 if source[1] is None else nodes)
        # The rate is that of one kind, or of all together: others come more slowly.
        slow = SLOW if kinds > 1 or name != source[0] else QUICK
        return not status.t - status.latest[source].t <= slow * self._patience(rate_hz)

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
            latest = status.latest.get((thruster.device, thruster.node))
            age = math.inf if latest is None else status.t - latest.t
            if not age <= self._patience(self._report_rate(thruster)):
                yield f"thruster {thruster.name} (node {thruster.node} on {thruster.device}) is silent{_since(age)}"

    def thrusters_answer(self, status: Status, since: float) -> bool:
        """Whether every thruster's controller was heard after run time `since`, so that a zero of then reached it; one
        that reports too seldom for that counts while it is not silent."""
        for thruster in self._thrusters:
            latest = status.latest.get((thruster.device, thruster.node))
            seldom = self._report_rate(thruster) < OFTEN_HZ * self._speed
            if latest is None or not (latest.t > since or seldom):
                return False
        return not any(self._silent_thrusters(status))

    def pushing(self, status: Status, since: float) -> list[str]:
        """Thrusters that an autopilot makes push after run time `since`, whatever it was told."""
        heard = ((t.name, status.latest.get((t.device, t.node))) for t in self._thrusters)
        return [
            name
            for name, latest in heard
            if latest is not None
            and latest.t > since
            and isinstance(latest.sample, Servo)
            and abs(latest.sample.n) > NEUTRAL
        ]

    def _report_rate(self, thruster: Thruster) -> float:
        """Samples a run second that a thruster's controller sends."""
        device = self._rig.device(thruster.device)
        return device.rate_hz / sum(other.device == device.name for other in self._rig.thrusters)

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

    def _force(self, name: str, cell: LoadCell, t: float) -> Iterator[str]:
        limit = self._rig.limits.force_n
        if limit is None:
            return
        if cell.flags & SATURATED:
            # One saturated reading is a glitch of the converter; the next one decides.
            if t > self._saturated_at.setdefault(name, t):
                yield f"{name} is saturated, its force cannot be watched"
            return
        self._saturated_at.pop(name, None)
        if not cell.flags & SPIKE and abs(cell.force) > limit:
            yield f"force is {cell.force:.1f} N, limit {limit:g} N"


def _is_dead(source: Source, sample: Sample, status: Status) -> bool:
    """Whether a device repeats its samples as a dead sensor does. A load cell may, at rest: converters are coarse."""
    port = status.ports.get(source[0].partition("/")[0])
    rests = isinstance(sample, LoadCell) and not any(status.commanded.values())
    return port is not None and type(sample).__name__ in port.stuck and not rests


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
        if math.isnan(outward):  # a speed without a course may be straight outward
            outward = fix.speed
        if not outward > 0.0:  # NaN too: a receiver that says neither
            return ""
        coast = outward * REACTION_S + stopping_distance(outward, self._vehicle)
        if distance + coast > self._radius:
            return (
                f"{distance:.0f} m from the start by {name} and {coast:.0f} m to stop from {outward:.1f} m/s, "
                f"limit {self._radius:g} m"
            )
        return ""
