"""Run clock, which all parts share, and the map from device clocks to run time.

Run time is in seconds since 1970 and never steps: the wall clock is read once, then the raw monotonic clock is added.
With mocks the run clock may be faster than the wall clock (`speed` run seconds per wall second). With real devices
`speed` is 1.
"""

from __future__ import annotations

import math
import time

CLOCK_STEP_S = 0.5  # times of one device that run back by more come from a clock that was set, or from two clocks
Origin = tuple[float, float]  # raw monotonic time [s] and run time [s] of one instant
# The plain monotonic clock is slewed: chrony corrects half a second within six seconds. All mapped device times would
# be wrong by that amount until the map has adapted. Deadlines and watchdogs use the plain clock; the two are not mixed.
_RAW = getattr(time, "CLOCK_MONOTONIC_RAW", time.CLOCK_MONOTONIC)


class RunClock:
    """Monotonic clock of run seconds since 1970. Two processes with the same `origin` and `speed` have the same clock.

    Parameters
    ----------
    speed : float
        Run seconds per wall second.
    origin : tuple of float, optional
        Raw monotonic time [s] and run time [s] of one instant; now by default.

    Raises
    ------
    ValueError
        If `speed` is not a positive number.

    Notes
    -----
    The raw monotonic clock belongs to the machine and not to a process. It follows the machine's crystal, even if the
    wall clock is set or slewed.
    """

    def __init__(self, speed: float = 1.0, origin: Origin | None = None) -> None:
        """Start the clock at the present wall time, or at the instant `origin` of another process.

        `speed` is the number of run seconds per wall second. Raise ValueError if it is not a positive number.
        """
        if not (math.isfinite(speed) and speed > 0.0):
            raise ValueError(f"clock speed must be a positive number, not {speed}")
        self.speed = speed
        self.origin: Origin = (time.clock_gettime(_RAW), time.time()) if origin is None else (origin[0], origin[1])

    def now(self) -> float:
        """Return the present run time [s since 1970]."""
        raw, run = self.origin
        return run + (time.clock_gettime(_RAW) - raw) * self.speed

    def wall(self, dt_run: float) -> float:
        """Return the wall seconds that `dt_run` run seconds take: `dt_run` divided by the speed of the clock."""
        return dt_run / self.speed

    def sleep_until(self, t_run: float) -> None:
        """Block the thread until run time `t_run` [s since 1970]. Return at once if it has passed."""
        while (left := self.wall(t_run - self.now())) > 0.0:
            time.sleep(left)


class SuspendDetector:
    """Detector of a suspended computer. The monotonic clock stops during a suspend, the boot-time clock does not.

    Without the detector an old command would be repeated after a suspend as if no time had passed. macOS has no
    boot-time clock. There `slept` always returns 0, and the raw monotonic clock does not stop during a suspend, so that
    time-outs in run time notice the pause.
    """

    LEAST = 0.1  # s, shortest suspend that is detected

    def __init__(self) -> None:
        """Note the time that the computer was suspended so far. Earlier suspends are not reported."""
        self._ahead = self._suspended_time()

    @staticmethod
    def _suspended_time() -> float:
        """Return the time [s] that the computer was suspended since its start; 0 without a boot-time clock."""
        clock = getattr(time, "CLOCK_BOOTTIME", None)
        return 0.0 if clock is None else time.clock_gettime(clock) - time.clock_gettime(time.CLOCK_MONOTONIC)

    def slept(self) -> float:
        """Return for how long [s] the computer was suspended, and count from zero again; 0 if it was not suspended.

        The time counts from the last call that returned more than 0, at first from the creation of the detector. Up to
        0.1 s (`LEAST`) are returned as 0 and stay counted for the next call.
        """
        ahead = self._suspended_time()
        slept = ahead - self._ahead
        if slept <= self.LEAST:
            return 0.0
        self._ahead = ahead
        return slept


class _Hull:
    """Lower convex hull of points (device time [s], offset [s]) of a clock map. Points are added in the order of time.

    The offset of a message is its receive time minus its device time. The hull is the lower edge of all points. Device
    times and offsets are relative to those of the first point of the clock map.

    Parameters
    ----------
    start : float
        Device time of the first point of this hull [s].
    """

    __slots__ = ("offset", "start", "x")

    def __init__(self, start: float) -> None:
        """Make a hull without points. `start` is the device time [s] of the point that will be added first."""
        self.start = start
        self.x: list[float] = []
        self.offset: list[float] = []

    def push(self, x: float, offset: float) -> None:
        """Add the newest point: device time `x` [s], which is larger than all before, and offset [s].

        Points that are no longer on the lower hull are dropped. The cost is O(1), averaged over the calls.
        """
        xs, ys = self.x, self.offset
        while len(xs) > 1 and (ys[-1] - ys[-2]) * (x - xs[-2]) >= (offset - ys[-2]) * (xs[-1] - xs[-2]):
            xs.pop()
            ys.pop()
        xs.append(x)
        ys.append(offset)

    def slope(self) -> float:
        """Return the slope [s/s] of the hull in the middle of its device times: the skew of the device clock.

        It is the gain of the run clock on the device clock per second, negative if the device clock is fast. It is 0
        for a single point. There must be a point.
        """
        xs, ys = self.x, self.offset
        middle = 0.5 * (xs[0] + xs[-1])
        for i in range(1, len(xs)):
            if xs[i] >= middle:
                return (ys[i] - ys[i - 1]) / (xs[i] - xs[i - 1])
        return 0.0


class _SampleKindTimes:
    """Device times and delays of one kind of sample of a device, to detect that its clock was set or has stopped.

    The delay of a sample is its receive time minus its device time, mapped to run time by the clock map.

    Attributes
    ----------
    newest, last
        Device times [s]: the largest one, and that of the last sample.
    least
        Smallest delay [s].
    since
        Run time [s] since which all samples are late, by 0.5 s or more in excess of `least`; infinite if the last one
        was not.
    back, back_at
        Delay [s] in excess of `least`, and run time [s], of a sample whose device time ran back and that is more than
        0.05 s late. `back` is 0 without one, and again after a sample whose excess is smaller by more than 0.05 s or by
        more than half.
    after
        Number of samples since then that are about as late.
    """

    __slots__ = ("after", "back", "back_at", "last", "least", "newest", "since")

    def __init__(self, newest: float, least: float) -> None:
        """Store the device time `newest` [s] of the first sample of a kind, and its delay `least` [s].

        No sample counts as late yet, and no device time as one that ran back.
        """
        self.newest = self.last = newest  # device times [s]: the largest one, and that of the last sample
        self.least = least  # s, smallest delay
        self.since = math.inf  # run time [s] since which all samples are late
        # Delay [s], in excess of `least`, of a sample whose time ran back. A sample with a much smaller delay resets it
        # to 0.
        self.back = 0.0
        self.back_at = math.inf  # run time [s] of that sample
        self.after = 0  # number of later samples that are about as late


class ClockMap:
    """Online map from the clock of a device to run time, by the lower convex hull of (device time, delay).

    If a device restarts or its clock jumps, a new map begins. `resets` counts these events. The skew of the map is
    limited to 300 ppm (SKEW_MAX).

    Parameters
    ----------
    window : float
        Largest length [s] of the data that determine the map. The older hull spans between half of it and all of it,
        less only at the beginning of a map.

    Notes
    -----
    A byte can arrive late but never early. The true offset between both clocks is therefore the lower edge of the
    points (receive time minus device time). An average or least squares would keep the mean delay as a bias.

    Two hulls of different age follow a slow change of the skew; the older one gives the map. This is the switching
    convex hull filter of Sikarwar and de Kok ("Convex hull filter" in cuckoo_time_translator, ETH Zurich). The smallest
    delay cannot be distinguished from an offset, so that it remains in the estimate.
    """

    SKEW_MAX = 300e-6  # the skew of two crystals is smaller; it limits the slope of a short hull
    JUMP = 0.5  # s; a device time that is ahead of the map by more means that the clock was set
    # s; an unordered device time that is behind the newest by more means that the clock was set back, or a restart. If
    # the times are ordered, each device time that runs back means this.
    LATE = 1.0
    # s; if all samples of a kind exceed the smallest delay of this kind by more, for LATER_FOR, the clock was set back
    # or has stopped. A smaller excess may come from a queue in the link.
    LATER = 0.5
    LATER_FOR = 10.0  # s
    # s; a sample whose time runs back and that is later by more was overtaken on the link. If all samples are as late
    # for AGAIN_FOR, the clock was set back.
    AGAIN = 0.05
    AGAIN_FOR, AGAIN_N = 1.0, 3  # s, and number of samples

    def __init__(self, window: float = 100.0) -> None:
        """Make a map without data. `window` is the largest length [s] of the data that determine it."""
        self.window = window
        self.resets = 0
        self._old: _Hull | None = None
        self._young: _Hull | None = None
        self._last_device = -math.inf
        self._last_run = -math.inf
        self._kinds: dict[object, _SampleKindTimes] = {}
        self._skew = 0.0
        self._base = 0.0  # offset of the line at device time zero of the map
        self._zero = 0.0  # device time of the map's first point
        self._first_offset = 0.0
        self._count = 0
        self._mean = 0.0
        self._m2 = 0.0

    def update(self, t_device: float, t_rx: float) -> float:
        """Update the map from device time to run time by one message, and return the run time [s] at which it was sent.

        The estimate is never later than `t_rx`. It decreases only after a message whose device time was not finite. It
        is `t_rx` for the first message of a map. A message with the device time of the message before does not change
        the map.

        Parameters
        ----------
        t_device : float
            Device time of the message [s]. A new map begins if it is smaller than that of the message before, or after
            another jump of the clock (`_has_jumped`). If it is not finite, `t_rx` is returned and the map does not
            change.
        t_rx : float
            Run time of receipt [s].
        """
        return self.estimate(t_device, t_rx)

    def estimate(self, t_device: float, t_rx: float, unordered: bool = False, kind: object = None) -> float:
        """Update the map by one sample of a device that may send several kinds of samples, and return its run time [s].

        Parameters
        ----------
        t_device : float
            Device time of the sample [s]. If it is not finite, `t_rx` is returned and the map does not change.
        t_rx : float
            Run time of receipt [s].
        unordered : bool
            Whether device times may run back by up to 1 s (`LATE`), as an older fix may follow a newer attitude. Such a
            sample is mapped, but does not change the map. If false, a device time that runs back begins a new map.
        kind : object
            Kind of the sample, such as its class. Times of one kind ascend. If they run back and the samples stay late,
            the clock was set back, and a new map begins. It also begins after the other jumps of `_has_jumped`.

        Returns
        -------
        float
            Run time of the measurement [s], never later than `t_rx`. It decreases only if `unordered` is true and
            `t_device` runs back, or after a sample whose device time was not finite. It is `t_rx` for the first
            sample of a map. A sample with the device time of the sample before does not change the map.
        """
        if not math.isfinite(t_device):
            return t_rx
        if self._old is not None and self._has_jumped(t_device, t_rx, unordered, kind):
            self._old = self._young = None
            self._kinds.clear()
            self.resets += 1
        if self._old is None:
            self._add_point(t_device, t_rx)
            self._kinds[kind] = _SampleKindTimes(t_device, 0.0)
        elif t_device < self._last_device:
            return min(self._to_run_time(t_device), t_rx)
        elif t_device > self._last_device:
            before = self._to_run_time(t_device)
            self._add_point(t_device, t_rx)
            # A message with a smaller delay lowers the map, so that all earlier samples were later by that amount.
            if (fell := before - self._to_run_time(t_device)) > 0.0:
                for times in self._kinds.values():
                    times.least += fell
        self._last_device = t_device
        t = min(max(self._to_run_time(t_device), self._last_run), t_rx)
        self._last_run = t
        self._update_delay_statistics(t_rx - t)
        return t

    @property
    def bias(self) -> float:
        """Mean delay [s] since the last `forget_statistics`: receive time minus estimated run time; NaN without one.

        Samples without a finite device time, and samples whose device time runs back in an old map, are not counted. A
        new map does not reset the mean.
        """
        return self._mean if self._count else math.nan

    @property
    def spread(self) -> float:
        """Standard deviation of the delays whose mean is `bias` [s]; NaN with fewer than two samples."""
        return math.sqrt(self._m2 / (self._count - 1)) if self._count > 1 else math.nan

    def forget_statistics(self) -> None:
        """Discard the statistics of the delays, `bias` and `spread`. The clock map itself does not change."""
        self._count, self._mean, self._m2 = 0, 0.0, 0.0

    def _to_run_time(self, t_device: float) -> float:
        """Convert a device time [s] to run time [s] by the present clock map, which must have at least one point."""
        return t_device + self._base + self._skew * (t_device - self._zero)

    def _has_jumped(self, t_device: float, t_rx: float, unordered: bool, kind: object) -> bool:
        """Return whether the device clock has jumped or the device has restarted, by the times of a new sample.

        The parameters are those of `estimate`. A jump is a device time more than 0.5 s ahead of the map (`JUMP`), or a
        device time that runs back (with `unordered` by more than 1 s). It is also a jump if all samples of a kind are
        at least 0.5 s later than the quickest for 10 s (`LATER`), or, after a device time of the kind ran back in a
        sample more than 0.05 s late, stay as late for 1 s and 3 samples (`AGAIN`). Without a jump, the stored times of
        this kind of sample (`_kinds`) are updated. There must be a map.
        """
        late = t_rx - self._to_run_time(t_device)
        if late < -self.JUMP or self._last_device - t_device > (self.LATE if unordered else 0.0):
            return True
        if (seen := self._kinds.get(kind)) is None:
            self._kinds[kind] = _SampleKindTimes(t_device, late)
            return False
        excess = late - seen.least
        if t_device == seen.last:
            pass  # mostly another sample of the same message
        elif seen.back and excess < max(0.5 * seen.back, seen.back - self.AGAIN):
            seen.back = 0.0  # the earlier sample was overtaken on the link: this one is as quick as before
        elif seen.back:
            seen.after += 1
            if seen.after >= self.AGAIN_N and t_rx - seen.back_at >= self.AGAIN_FOR:
                return True
        elif t_device < seen.newest and excess > self.AGAIN:
            seen.back, seen.back_at, seen.after = excess, t_rx, 0
        if excess < self.LATER:
            seen.since = math.inf
        elif t_rx - seen.since > self.LATER_FOR:
            return True
        else:
            seen.since = min(seen.since, t_rx)
        seen.last = t_device
        seen.newest, seen.least = max(seen.newest, t_device), min(seen.least, late)
        return False

    def _add_point(self, t_device: float, t_rx: float) -> None:
        """Add the device time and the receive time [s] of a message to the clock map, and compute its skew and offset.

        If there is no map, it begins with this point. Both hulls get the point. The younger hull takes the place of the
        older one when it covers half of the window.
        """
        if self._old is None or self._young is None:
            # Offsets are relative to the first point, which keeps the precision of doubles.
            self._zero, self._first_offset = t_device, t_rx - t_device
            self._old, self._young = _Hull(0.0), _Hull(0.0)
        x, offset = t_device - self._zero, t_rx - t_device - self._first_offset
        if x - self._young.start > 0.5 * self.window:
            self._old, self._young = self._young, _Hull(x)
        self._old.push(x, offset)
        self._young.push(x, offset)
        skew = min(max(self._old.slope(), -self.SKEW_MAX), self.SKEW_MAX)
        lowest = min(y - skew * x for x, y in zip(self._old.x, self._old.offset, strict=True))
        self._skew, self._base = skew, lowest + self._first_offset

    def _update_delay_statistics(self, delay: float) -> None:
        """Update mean and variance of the delay [s] (receive time minus estimated time) by Welford's algorithm."""
        self._count += 1
        step = delay - self._mean
        self._mean += step / self._count
        self._m2 += step * (delay - self._mean)
