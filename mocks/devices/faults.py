"""Faults of the mock devices on a schedule. The command line gives each as `NAME[/TARGET]@T[:SECONDS]`."""

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

SIGNAL = "usr1"  # in the place of a time: the fault starts at the signal SIGUSR1
LATE_S = 1.0  # s, delay of the fault "late"
CLOCK_BACK_S, CLOCK_SKEW = 0.6, 100e-6  # s; s per s
# Additional noise of the fault "noisy": rad, rad/s, m/s2, m/s2 of yaw, r, ax and ay
NOISE_SIGMAS = (math.radians(5.0), 0.1, 1.0, 1.0)


@dataclass(frozen=True)
class Kind:
    """Kind of fault of a mock device, such as "silence".

    Attributes
    ----------
    seconds : float
        Default duration [s]; infinite for a fault that lasts to the end of the run.
    text : str
        Description in the help of --fault.
    """

    seconds: float
    text: str


KINDS = {
    "pull": Kind(5.0, "the port disappears and returns"),
    "silence": Kind(5.0, "the device sends nothing"),
    "garbage": Kind(2.0, "random bytes in place of the device's"),
    "stuck": Kind(5.0, "the device repeats its last reading"),
    "spike": Kind(0.0, "one wrong reading, or one per second for SECONDS"),
    "overload": Kind(5.0, "force and current far beyond any limit"),
    "hot": Kind(5.0, "a controller at 150 deg C"),
    "mute": Kind(5.0, "a controller on CAN that reports neither temperature nor voltage"),
    "flat": Kind(5.0, "the voltage of an empty battery"),
    "away": Kind(5.0, "a position error of 1 km"),
    "capsize": Kind(5.0, "a roll of 120 degrees"),
    "no-fix": Kind(5.0, "a receiver with too few satellites for a fix"),
    "clock-back": Kind(math.inf, "a device whose clock is set back by 0.6 s"),
    "clock-skew": Kind(math.inf, "a device whose clock is 100 ppm fast"),
    "esc-dead": Kind(math.inf, "a thruster's controller fails: no thrust, no telemetry"),
    "esc-stuck": Kind(math.inf, "a thruster's controller keeps its command and ignores new ones, even zero"),
    "refuse": Kind(5.0, "a CAN adapter that answers every frame with BELL and sends none"),
    "hold": Kind(5.0, "a receiver that repeats its position with new time stamps"),
    "slow": Kind(math.inf, "every second reading is lost"),
    "late": Kind(math.inf, "readings arrive 1 s late, with new time stamps"),
    "degrees": Kind(math.inf, "body rates in degrees per second instead of radians"),
    "noisy": Kind(math.inf, "an AHRS with ten times its noise"),
}
_Source = tuple[str, type, int]  # name of the device, type of the sample, node on the bus (0 without a bus)
_FORM = re.compile(r"(?P<kind>[a-z-]+)(?:/(?P<target>\w+))?@(?P<t>usr1|\d+(?:\.\d*)?)(?::(?P<seconds>\d+(?:\.\d*)?))?")


@dataclass(frozen=True)
class Fault:
    """Fault of mock devices or speed controllers in an interval of run time.

    Attributes
    ----------
    kind : str
        Kind of fault, a key of KINDS such as "silence".
    target : str
        Name of the device, or of the thruster for the kinds esc-dead and esc-stuck; empty for all of them.
    start : float or None
        Start [run s since the start of the mock]; None until the signal SIGUSR1 arrives.
    seconds : float
        Duration [run s].
    """

    kind: str
    target: str
    start: float | None
    seconds: float

    def active(self, t: float) -> bool:
        """Return whether the fault is active at run time ``t`` [s]: from its start to just before its end.

        Return False if its start is None. A fault of 0 s is never active; `Faults` handles a single spike separately.
        """
        return self.start is not None and self.start <= t < self.start + self.seconds

    def hits(self, target: str) -> bool:
        """Return whether the fault concerns the device or thruster named ``target``: this one or all of them."""
        return self.target in ("", target)


def parse_fault(text: str, devices: Sequence[str] = (), thrusters: Sequence[str] = ()) -> Fault:
    """Parse a fault of the command line.

    Parameters
    ----------
    text : str
        `NAME[/TARGET]@T[:SECONDS]`, for example `pull/gnss@30:5`.
    devices, thrusters : sequence of str
        Names of all devices and of all thrusters of the rig. Without names every TARGET is refused.

    Returns
    -------
    Fault
        The fault. Its start is None if T is `usr1`. Without SECONDS it has the default duration of its kind.

    Raises
    ------
    SeatrialError
        If the text has another form, the fault is unknown, or the rig has no such device or thruster.
    """
    found = _FORM.fullmatch(text)
    if found is None:
        raise SeatrialError(
            f"--fault {text}: write it as NAME[/TARGET]@T[:SECONDS], T in run seconds or {SIGNAL}, such as "
            "pull/gnss@30:5"
        )
    kind, target = found["kind"], found["target"] or ""
    if kind not in KINDS:
        raise SeatrialError(f"--fault {text}: no fault '{kind}'; use one of {', '.join(KINDS)}")
    of_thruster = kind in ("esc-dead", "esc-stuck")
    names = thrusters if of_thruster else devices
    if target and target not in names:
        noun = "thruster" if of_thruster else "device"
        raise SeatrialError(f"--fault {text}: the rig has no {noun} '{target}'; use one of {', '.join(names)}")
    start = None if found["t"] == SIGNAL else float(found["t"])
    return Fault(kind, target, start, float(found["seconds"] or KINDS[kind].seconds))


class Faults:
    """Schedule of the faults of a run, which changes samples and bytes of the devices while faults are active."""

    def __init__(self, faults: Sequence[Fault], rng: np.random.Generator) -> None:
        """Set up the schedule of ``faults``. ``rng`` is the generator of random bytes and noise.

        Faults whose start is None wait for `trigger`.
        """
        self._faults = list(faults)
        self._on_signal = [index for index, fault in enumerate(faults) if fault.start is None]
        self._rng = rng
        self._last: dict[_Source, Sample] = {}
        self._spikes: dict[tuple[int, str], int] = {}  # (index of the fault, device) -> number of spikes so far
        self._count: dict[_Source, int] = {}  # readings during a fault "slow"
        self._past: dict[_Source, deque[tuple[float, Sample]]] = {}  # readings of the last LATE_S, for "late"

    def trigger(self, t: float) -> None:
        """Start, at run time ``t`` [s], the faults whose start on the command line is `usr1` (the signal SIGUSR1).

        A fault that has ended starts again, and its spikes are counted from zero. An active fault goes on unchanged.
        """
        for index in self._on_signal:
            if not self._faults[index].active(t):
                self._faults[index] = replace(self._faults[index], start=t)
                self._spikes = {key: count for key, count in self._spikes.items() if key[0] != index}

    def active(self, kind: str, target: str, t: float) -> bool:
        """Return whether a fault of ``kind`` (a key of KINDS) is active for the device or thruster ``target``.

        ``t`` is the run time [s].
        """
        return any(f.kind == kind and f.hits(target) and f.active(t) for f in self._faults)

    def reading(self, device: str, sample: Sample, t: float) -> Sample | None:
        """Return the sample that a device really sends while faults are active, or None if it sends no sample.

        It sends none during a fault "silence", and every second one not during "slow". Of "silence", "stuck" and "hold"
        (for a GNSS receiver), the first active one excludes all other faults; these are otherwise applied together.
        During "stuck" the device repeats its last sample before the fault, or the first one in the fault if there is
        none before. During "hold" it repeats only the position. During "late" it sends the sample of 1 s ago; until the
        fault has lasted 1 s, this is the first sample in the fault.

        Parameters
        ----------
        device : str
            Name of the device.
        sample : Sample
            The sample without a fault.
        t : float
            Run time [s]. It must not decrease from call to call.

        Notes
        -----
        Call it once for each sample, because each call stores the sample and counts spikes: some faults repeat or
        delay earlier samples.
        """
        if not self._faults:
            return sample
        key = (device, type(sample), getattr(sample, "node", 0))  # one device may send several types of samples
        if not self.active("late", device, t):
            self._past.pop(key, None)  # otherwise the fault would send them if it starts again
        if self.active("silence", device, t):
            return None
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
            sample = self._with_noise(sample)
        for kind, change in _CHANGES.items():
            if self.active(kind, device, t):
                sample = change(sample)
        return _with_spike(sample) if self._spike_due(device, t) else sample

    def clock_error(self, device: str, t: float) -> float:
        """Return the time [s] by which the clock of a device is fast at run time ``t`` [s]; negative if it is slow.

        An active fault "clock-back" gives -0.6 s, and "clock-skew" 1e-4 times the time since its start. The errors of
        all active faults add up. Without an active fault, also after its end, the error is 0.
        """
        starts = [(f.kind, f.start) for f in self._faults if f.start is not None and f.hits(device) and f.active(t)]
        return sum(
            {"clock-back": -CLOCK_BACK_S, "clock-skew": CLOCK_SKEW * (t - start)}.get(kind, 0.0)
            for kind, start in starts
        )

    def bytes(self, device: str, data: bytes, t: float) -> bytes:
        """Return the bytes that arrive at the host when a device sends ``data`` at run time ``t`` [s].

        They are ``data`` itself, or during a fault "garbage" of this device the same number of random bytes.
        """
        return self._rng.bytes(len(data)) if self._faults and self.active("garbage", device, t) else data

    def _with_noise(self, sample: Sample) -> Sample:
        """Return an AHRS sample with noise added to heading, yaw rate, and acceleration along x and y.

        The standard deviations are 5 degrees, 0.1 rad/s and 1 m/s2. Other samples are returned unchanged.
        """
        if not isinstance(sample, Ahrs):
            return sample
        yaw, r, ax, ay = self._rng.normal(0.0, NOISE_SIGMAS).tolist()
        return replace(sample, yaw=sample.yaw + yaw, r=sample.r + r, ax=sample.ax + ax, ay=sample.ay + ay)

    def _spike_due(self, device: str, t: float) -> bool:
        """Return whether a fault "spike" changes the sample of a device at run time ``t`` [s], and count the spike.

        Such a fault has one spike at its start, and one more in each further second of its duration. The first sample
        of the device that is due for a spike uses it up, even if its kind has no spike (telemetry of an autopilot).
        """
        for index, fault in enumerate(self._faults):
            if fault.kind == "spike" and fault.hits(device) and fault.start is not None and t >= fault.start:
                done = self._spikes.get((index, device), 0)
                if done <= fault.seconds and t >= fault.start + done:
                    self._spikes[index, device] = done + 1
                    return True
        return False


def _overloaded(sample: Sample) -> Sample:
    """Return a load cell sample with 500,000 more counts, or ESC telemetry with 200 A more; other samples unchanged."""
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
    """Return an AHRS sample whose body rates are in degrees per second, a fault, instead of radians per second."""
    return replace(sample, p=math.degrees(sample.p), q=math.degrees(sample.q), r=math.degrees(sample.r))


def _with_spike(sample: Sample) -> Sample:
    """Return the sample with a spike that is typical of its device; samples of other devices unchanged.

    A load cell reads 2^22 - 1 counts. An AHRS has 5 rad/s more yaw rate and 30 m/s2 more forward acceleration. A GNSS
    fix lies about 1 km further north.
    """
    if isinstance(sample, LoadCell):  # an HX711 whose data line was read high
        return replace(sample, counts=float(2**22 - 1))
    if isinstance(sample, Ahrs):
        return replace(sample, r=sample.r + 5.0, ax=sample.ax + 30.0)
    if isinstance(sample, Gnss):  # an outlier of about 1 km
        return replace(sample, lat=sample.lat + 0.01)
    return sample
