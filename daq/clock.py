"""Run clock, shared by all parts, and the mapping of device clocks onto it.

Run time is seconds since 1970 that never step: one reading of the wall clock, then the raw monotonic clock. Against
mocks the run clock may go faster than the wall (`speed` run seconds a wall second); with real devices it is 1.
"""

from __future__ import annotations

import math
import time

CLOCK_STEP_S = 0.5  # times of one device that run back by more are of a clock that was set, or of two
Origin = tuple[float, float]
# The plain monotonic clock is slewed: chrony takes half a second off in six, and every stamp of a device clock would be
# off by as much until the map has followed. Deadlines and watchdogs keep to the plain one; the two never meet.
_RAW = getattr(time, "CLOCK_MONOTONIC_RAW", time.CLOCK_MONOTONIC)


class RunClock:
    """Run seconds since 1970, monotonic. Another process given the same `origin` and `speed` agrees with it.

    `origin` is (raw monotonic seconds, run seconds) of the same instant. The raw monotonic clock is that of the
    machine, not of the process, so a plain tuple is all that two processes need to share. It goes at the rate of the
    machine's crystal, whatever sets or slews the wall clock meanwhile.
    """

    def __init__(self, speed: float = 1.0, origin: Origin | None = None) -> None:
        if not (math.isfinite(speed) and speed > 0.0):
            raise ValueError(f"clock speed must be a positive number, not {speed}")
        self.speed = speed
        self.origin: Origin = (time.clock_gettime(_RAW), time.time()) if origin is None else (origin[0], origin[1])

    def now(self) -> float:
        """Run time now [s since 1970]."""
        raw, run = self.origin
        return run + (time.clock_gettime(_RAW) - raw) * self.speed

    def wall(self, dt_run: float) -> float:
        """Wall seconds that `dt_run` run seconds take."""
        return dt_run / self.speed

    def sleep_until(self, t_run: float) -> None:
        """Sleep until run time `t_run`; returns at once when it has passed."""
        while (left := self.wall(t_run - self.now())) > 0.0:
            time.sleep(left)


class SuspendDetector:
    """Tells when the computer was suspended: the monotonic clock stands still then, the boot-time clock does not.

    Without it a command from before would go on as if no time had passed. Where a system has no such clock (its
    monotonic clock runs on), nothing is ever detected: the timeouts see the pause themselves.
    """

    LEAST = 0.1  # s

    def __init__(self) -> None:
        self._ahead = self._difference()

    @staticmethod
    def _difference() -> float:
        clock = getattr(time, "CLOCK_BOOTTIME", None)
        return 0.0 if clock is None else time.clock_gettime(clock) - time.clock_gettime(time.CLOCK_MONOTONIC)

    def slept(self) -> float:
        """Seconds that the computer was suspended since the last call; 0 where it was not."""
        ahead = self._difference()
        slept = ahead - self._ahead
        if slept <= self.LEAST:
            return 0.0
        self._ahead = ahead
        return slept


class _Hull:
    """Lower convex hull of (device time, offset) points that arrive in the order of device time."""

    __slots__ = ("offset", "start", "x")

    def __init__(self, start: float) -> None:
        self.start = start  # device time of the first point
        self.x: list[float] = []
        self.offset: list[float] = []

    def push(self, x: float, offset: float) -> None:
        """Add the newest point; drops the points that no longer are on the lower hull. O(1) amortised."""
        xs, ys = self.x, self.offset
        while len(xs) > 1 and (ys[-1] - ys[-2]) * (x - xs[-2]) >= (offset - ys[-2]) * (xs[-1] - xs[-2]):
            xs.pop()
            ys.pop()
        xs.append(x)
        ys.append(offset)

    def slope(self) -> float:
        """Slope of the hull's segment over the middle of its window: the longest support there is."""
        xs, ys = self.x, self.offset
        middle = 0.5 * (xs[0] + xs[-1])
        for i in range(1, len(xs)):
            if xs[i] >= middle:
                return (ys[i] - ys[i - 1]) / (xs[i] - xs[i - 1])
        return 0.0


class _Kind:
    """What is known of the times of one kind of sample."""

    __slots__ = ("after", "back", "back_at", "last", "least", "newest", "since")

    def __init__(self, newest: float, least: float) -> None:
        self.newest = self.last = newest  # device time
        self.least = least  # s, the least that it was late by
        self.since = math.inf  # run time from which all of it is late
        self.back = 0.0  # s by which one that ran back was late, until one comes that is not,
        self.back_at = math.inf  # its run time,
        self.after = 0  # and those since


class ClockMap:
    """Maps a device's clock to run time, online, by the lower convex hull of (device time, delay).

    A byte can arrive late, never early, so the true offset between both clocks runs along the lower edge of the
    cloud of (receive time minus device time); averaging or least squares would keep the mean delay as a bias.
    Two hulls of staggered age follow a slow change of skew; the older one answers (the switching convex hull
    filter of Sikarwar and de Kok, "Convex hull filter" in cuckoo_time_translator, ETH Zurich). The smallest delay
    itself cannot be told from an offset: it stays in the estimate.

    A device that restarts, or whose clock jumps, starts a new map (`resets` counts them).
    """

    SKEW_MAX = 300e-6  # two crystals are closer than this; bounds the slope of a short hull
    JUMP = 0.5  # s, device time ahead of the map by more: its clock was set
    LATE = 1.0  # s, behind the newest by more: its clock was set back, or it restarted
    LATER = 0.5  # s later than its kind ever was, for LATER_FOR: set back, or stopped; less is a link with a queue
    LATER_FOR = 10.0
    AGAIN = 0.05  # s late where a time runs back: of a packet that was overtaken, unless all are as late for AGAIN_FOR
    AGAIN_FOR, AGAIN_N = 1.0, 3  # s, and samples

    def __init__(self, window: float = 100.0) -> None:
        self.window = window
        self.resets = 0
        self._old: _Hull | None = None
        self._young: _Hull | None = None
        self._last_device = -math.inf
        self._last_run = -math.inf
        self._kinds: dict[object, _Kind] = {}
        self._skew = 0.0
        self._base = 0.0  # offset of the line at device time zero of the map
        self._zero = 0.0  # device time of the map's first point
        self._first_offset = 0.0
        self._count = 0
        self._mean = 0.0
        self._m2 = 0.0

    def update(self, t_device: float, t_rx: float) -> float:
        """Take one message's times [s] and return its estimated run time, never above `t_rx`, never decreasing.

        A device time that is not finite gives `t_rx` and leaves the map alone.
        """
        return self.estimate(t_device, t_rx)

    def estimate(self, t_device: float, t_rx: float, unordered: bool = False, kind: object = None) -> float:
        """As `update`; of an `unordered` device, a time up to `LATE` behind the newest only asks the map.

        Such a device sends things of different age over one link: an attitude of now, then a fix of a while ago. The
        times of one `kind` ascend: where they run back, and stay late, its clock was set back.
        """
        if not math.isfinite(t_device):
            return t_rx
        if self._old is not None and self._jumped(t_device, t_rx, unordered, kind):
            self._old = self._young = None
            self._kinds.clear()
            self.resets += 1
        if self._old is None:
            self._push(t_device, t_rx)
            self._kinds[kind] = _Kind(t_device, 0.0)
        elif t_device < self._last_device:
            return min(self._mapped(t_device), t_rx)
        elif t_device > self._last_device:
            before = self._mapped(t_device)
            self._push(t_device, t_rx)
            if (fell := before - self._mapped(t_device)) > 0.0:  # by a message that came sooner: all others are later
                for each in self._kinds.values():
                    each.least += fell
        self._last_device = t_device
        t = min(max(self._mapped(t_device), self._last_run), t_rx)
        self._last_run = t
        self._note(t_rx - t)
        return t

    @property
    def bias(self) -> float:
        """Mean of receive time minus estimated time [s] since the last `forget_statistics`."""
        return self._mean if self._count else math.nan

    @property
    def spread(self) -> float:
        """Standard deviation of receive time minus estimated time [s]."""
        return math.sqrt(self._m2 / (self._count - 1)) if self._count > 1 else math.nan

    def forget_statistics(self) -> None:
        """Reset `bias` and `spread`; the map stays."""
        self._count, self._mean, self._m2 = 0, 0.0, 0.0

    def _mapped(self, t_device: float) -> float:
        return t_device + self._base + self._skew * (t_device - self._zero)

    def _jumped(self, t_device: float, t_rx: float, unordered: bool, kind: object) -> bool:
        late = t_rx - self._mapped(t_device)
        if late < -self.JUMP or self._last_device - t_device > (self.LATE if unordered else 0.0):
            return True
        if (seen := self._kinds.get(kind)) is None:
            self._kinds[kind] = _Kind(t_device, late)
            return False
        excess = late - seen.least
        if t_device == seen.last:
            pass  # another sample of the same message, mostly
        elif seen.back and excess < max(0.5 * seen.back, seen.back - self.AGAIN):
            seen.back = 0.0  # it was overtaken: the link is as quick as before
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

    def _push(self, t_device: float, t_rx: float) -> None:
        if self._old is None or self._young is None:
            # Offsets are taken relative to the first point, so that doubles keep their digits.
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

    def _note(self, delay: float) -> None:
        self._count += 1
        step = delay - self._mean
        self._mean += step / self._count
        self._m2 += step * (delay - self._mean)
