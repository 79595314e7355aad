"""What can go wrong, on a schedule: `NAME[/TARGET]@T[:SECONDS]`."""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.daq.samples import NAN, Ahrs, Esc, Gnss, LoadCell
from seatrial.mocks.world import Sample

SIGNAL = "usr1"
LATE_S = 1.0
BACK_S, SKEW = 0.6, 100e-6
NOISY = (math.radians(5.0), 0.1, 1.0, 1.0)  # rad, rad/s, m/s2, m/s2


@dataclass(frozen=True)
class Kind:
    """One kind of fault: how long it lasts by default (s), and what it does."""

    seconds: float
    text: str


KINDS = {
    "pull": Kind(5.0, "the port vanishes and returns"),
    "silence": Kind(5.0, "the device sends nothing"),
    "garbage": Kind(2.0, "random bytes in place of the device's"),
    "stuck": Kind(5.0, "the last reading over and over"),
    "spike": Kind(0.0, "a reading far off: one, or one a second for SECONDS"),
    "overload": Kind(5.0, "force and current far beyond any limit"),
    "hot": Kind(5.0, "a controller at 150 deg C"),
    "mute": Kind(5.0, "a controller on CAN that tells neither temperature nor voltage"),
    "flat": Kind(5.0, "the voltage of an empty battery"),
    "away": Kind(5.0, "a position a kilometre off"),
    "capsize": Kind(5.0, "a roll of 120 degrees"),
    "no-fix": Kind(5.0, "a receiver that sees too few satellites"),
    "clock-back": Kind(math.inf, "a device whose clock is set back by 0.6 s"),
    "clock-skew": Kind(math.inf, "a device whose clock is 100 ppm fast"),
    "esc-dead": Kind(math.inf, "a thruster's controller dies: no thrust, no word"),
    "esc-stuck": Kind(math.inf, "a thruster's controller keeps its command and ignores new ones, zero included"),
    "refuse": Kind(5.0, "a CAN adapter that answers every frame with BELL and sends none"),
    "hold": Kind(5.0, "a receiver that repeats its position while its time runs"),
    "slow": Kind(math.inf, "every other reading is lost"),
    "late": Kind(math.inf, "readings come a second late, stamped as if they were new"),
    "degrees": Kind(math.inf, "body rates in degrees a second"),
    "noisy": Kind(math.inf, "ten times the noise of an AHRS"),
}
_Source = tuple[str, type, int]  # device, kind of sample, node
_FORM = re.compile(r"(?P<kind>[a-z-]+)(?:/(?P<target>\w+))?@(?P<t>usr1|\d+(?:\.\d*)?)(?::(?P<seconds>\d+(?:\.\d*)?))?")


@dataclass(frozen=True)
class Fault:
    """One fault on the schedule."""

    kind: str
    target: str  # a device, for esc-dead and esc-stuck a thruster; empty for every one
    start: float | None  # s since the run's start; None until the signal comes
    seconds: float

    def active(self, t: float) -> bool:
        """Whether it lasts at ``t`` (s)."""
        return self.start is not None and self.start <= t < self.start + self.seconds

    def hits(self, target: str) -> bool:
        """Whether it is meant for ``target``."""
        return self.target in ("", target)


def parse_fault(text: str, devices: Sequence[str] = (), thrusters: Sequence[str] = ()) -> Fault:
    """The fault that ``text`` describes. Raises SeatrialError that names what is wrong with it."""
    found = _FORM.fullmatch(text)
    if found is None:
        raise SeatrialError(
            f"--fault {text}: must read NAME[/TARGET]@T[:SECONDS], T in run seconds or {SIGNAL}, like pull/gnss@30:5"
        )
    kind, target = found["kind"], found["target"] or ""
    if kind not in KINDS:
        raise SeatrialError(f"--fault {text}: no fault '{kind}'; there is: {', '.join(KINDS)}")
    of_thruster = kind in ("esc-dead", "esc-stuck")
    known = thrusters if of_thruster else devices
    if target and target not in known:
        what = "thruster" if of_thruster else "device"
        raise SeatrialError(f"--fault {text}: the rig has no {what} '{target}'; there is: {', '.join(known)}")
    start = None if found["t"] == SIGNAL else float(found["t"])
    return Fault(kind, target, start, float(found["seconds"] or KINDS[kind].seconds))


class Faults:
    """The schedule, and what it makes of readings and bytes."""

    def __init__(self, faults: Sequence[Fault], rng: np.random.Generator) -> None:
        self._faults = list(faults)
        self._on_signal = [index for index, fault in enumerate(faults) if fault.start is None]
        self._rng = rng
        self._last: dict[_Source, Sample] = {}
        self._spikes: dict[tuple[int, str], int] = {}  # (fault, device) -> spikes so far
        self._count: dict[_Source, int] = {}
        self._past: dict[_Source, deque[tuple[float, Sample]]] = {}

    def trigger(self, t: float) -> None:
        """The signal came at ``t`` (s): what waits for it starts, or starts again when it is over."""
        for index in self._on_signal:
            if not self._faults[index].active(t):
                self._faults[index] = replace(self._faults[index], start=t)
                self._spikes = {key: count for key, count in self._spikes.items() if key[0] != index}

    def active(self, kind: str, target: str, t: float) -> bool:
        """Whether a fault of that kind lasts at ``t`` (s) for a device or thruster."""
        return any(f.kind == kind and f.hits(target) and f.active(t) for f in self._faults)

    def reading(self, device: str, sample: Sample, t: float) -> Sample | None:
        """What the device makes of its sample: the same, a stuck or a spiked one, or None."""
        if not self._faults:
            return sample
        if self.active("silence", device, t):
            return None
        key = (device, type(sample), getattr(sample, "node", 0))  # a device may send several kinds
        if self.active("stuck", device, t):
            return self._last.setdefault(key, sample)
        if isinstance(sample, Gnss) and self.active("hold", device, t):
            held = self._last.setdefault(key, sample)
            assert isinstance(held, Gnss)
            return replace(sample, lat=held.lat, lon=held.lon)
        self._last[key] = sample
        if self.active("slow", device, t):
            self._count[key] = self._count.get(key, 0) + 1
            if self._count[key] % 2 == 0:
                return None
        if self.active("late", device, t):
            past = self._past.setdefault(key, deque())
            past.append((t, sample))
            while len(past) > 1 and past[1][0] <= t - LATE_S:
                past.popleft()
            sample = past[0][1]
        if self.active("noisy", device, t):
            sample = self._noisy(sample)
        for kind, change in _CHANGES.items():
            if self.active(kind, device, t):
                sample = change(sample)
        return _spiked(sample) if self._spike_due(device, t) else sample

    def clock_error(self, device: str, t: float) -> float:
        """Seconds by which the device's clock is ahead at ``t`` (s)."""
        starts = [(f.kind, f.start) for f in self._faults if f.start is not None and f.hits(device) and f.active(t)]
        return sum({"clock-back": -BACK_S, "clock-skew": SKEW * (t - at)}.get(kind, 0.0) for kind, at in starts)

    def bytes(self, device: str, data: bytes, t: float) -> bytes:
        """What the wire makes of the device's bytes."""
        return self._rng.bytes(len(data)) if self._faults and self.active("garbage", device, t) else data

    def _noisy(self, sample: Sample) -> Sample:
        if not isinstance(sample, Ahrs):
            return sample
        yaw, r, ax, ay = self._rng.normal(0.0, NOISY).tolist()
        return replace(sample, yaw=sample.yaw + yaw, r=sample.r + r, ax=sample.ax + ax, ay=sample.ay + ay)

    def _spike_due(self, device: str, t: float) -> bool:
        for index, fault in enumerate(self._faults):
            if fault.kind == "spike" and fault.hits(device) and fault.start is not None and t >= fault.start:
                done = self._spikes.get((index, device), 0)
                if done <= fault.seconds and t >= fault.start + done:
                    self._spikes[index, device] = done + 1
                    return True
        return False


def _overloaded(sample: Sample) -> Sample:
    if isinstance(sample, LoadCell):
        return replace(sample, counts=sample.counts + 500_000.0)
    return replace(sample, current=sample.current + 200.0) if isinstance(sample, Esc) else sample


_CHANGES: dict[str, Callable[[Sample], Sample]] = {
    "overload": _overloaded,
    "hot": lambda s: replace(s, temperature=150.0) if isinstance(s, Esc) else s,
    "mute": lambda s: replace(s, temperature=NAN, voltage=NAN) if isinstance(s, Esc) else s,
    "flat": lambda s: replace(s, voltage=6.0) if isinstance(s, Esc) else s,
    "away": lambda s: replace(s, lat=s.lat + 0.009) if isinstance(s, Gnss) else s,
    "no-fix": lambda s: Gnss(s.utc, NAN, NAN, n_sat=3) if isinstance(s, Gnss) else s,
    "degrees": lambda s: _in_degrees(s) if isinstance(s, Ahrs) else s,
    "capsize": lambda s: replace(s, roll=math.radians(120.0)) if isinstance(s, Ahrs) else s,
}


def _in_degrees(sample: Ahrs) -> Ahrs:
    return replace(sample, p=math.degrees(sample.p), q=math.degrees(sample.q), r=math.degrees(sample.r))


def _spiked(sample: Sample) -> Sample:
    """The sample with one value far off, as such devices fail: HX711 with ones shifted in, a jump, a slip of 1 km."""
    if isinstance(sample, LoadCell):
        return replace(sample, counts=float(2**22 - 1))
    if isinstance(sample, Ahrs):
        return replace(sample, r=sample.r + 5.0, ax=sample.ax + 30.0)
    if isinstance(sample, Gnss):
        return replace(sample, lat=sample.lat + 0.01)
    return sample
