"""Times of messages that have two: the stamp of their source, and when the recorder got them.

Theory of operation. The stamp is when a value was measured, and so it is the better time, but it can be wrong: a driver
that overflows, a simulation that was reset, a message from before the first fix. The receipt is late, and its clock can
step. The difference of both, receipt minus stamp, shows which one failed:

- The stamps of most topics share one clock, the reference. It is the recorder's own clock where that is possible, else
  that of the topic with most messages, as in a bag of a simulation. Its rate need not be that of the recorder: a
  simulation at half the real time has stamps that run half as fast.
- A step of the difference in all topics is of the clock whose own interval is odd across the step.
- A recorder's clock that was set back writes messages of before and after into the same receipts. In the order of their
  stamps, which stay regular, the step is plain. What was received in that time without a stamp is left out.
- A stamp that is far from the reference beside the other stamps of its topic is wrong. It is left out. A message that
  is merely late keeps its stamp: then the interval of the receipts is odd, and not that of the stamps.
- A topic whose stamps are of another clock is moved onto the reference by the shortest delay, or by a straight line
  where the clocks differ in rate.
- A topic without stamps has the receipt, turned into the reference as the other topics show it.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from seatrial.daq.errors import counted
from seatrial.daq.importers.table import Column

Mask = npt.NDArray[np.bool_]

OTHER_CLOCK = 1.0  # s; stamps that are further from the receipt are of another clock
STEP_S, STEP_RATE = 0.25, 0.5  # s, and per second between two messages: a difference that changes by more has a step
DRIFT_S = 0.2  # s, over a whole recording: more is a clock of another rate
SMOOTH = 51  # messages, over which the difference is the median
LEAST_DIFFERENT = 0.1  # share of a topic's stamps, below which they stand still
FEWEST_BACK, REGULAR = 3, 0.95  # stamps that run back; share of the intervals of stamps in order that are as usual
SHARE = 0.2  # of a topic's stamps that can be its usual ones


class MessageTimes(NamedTuple):
    """Times of the messages of one topic in the order of receipt, s since 1970, each (n,).

    ``stamp``: NaN without a header, 0 where it is empty.
    """

    receipt: Column
    stamp: Column


class EstimatedTimes(NamedTuple):
    """Times of a topic's messages ``t`` (n,) [s], NaN where a message has no time that can be trusted, and a remark.

    ``mixed``: the receipts are out of order, and the times are not.
    """

    t: Column
    remark: str
    mixed: bool = False


def message_times(topics: Mapping[str, MessageTimes]) -> dict[str, EstimatedTimes]:
    """Estimate when the messages of a recording were measured.

    Parameters
    ----------
    topics
        Receipts and stamps by topic.

    Returns
    -------
    dict
        Times by topic, on one clock.
    """
    clean = {name: _without_zeros(one) for name, one in topics.items()}
    stamped = {n: one for n, one in clean.items() if np.isfinite(one.stamp + one.receipt).sum() > 1}
    if not stamped:
        return {n: EstimatedTimes(np.where(np.isfinite(o.stamp), o.stamp, o.receipt), "") for n, o in clean.items()}
    reference = _Reference(stamped)
    return {name: reference.times(one, name in stamped) for name, one in clean.items()}


def _without_zeros(one: MessageTimes) -> MessageTimes:
    """Empty stamps and receipts as NaN: a simulation has no time before its first clock. A topic has no stamps at all
    if they are always empty, or hardly ever change."""
    receipt, stamp = one.receipt.copy(), one.stamp.copy()
    for t in (receipt, stamp):
        if np.any(t > 0.0):
            t[t == 0.0] = np.nan
    filled = stamp[stamp > 0.0]
    if len(np.unique(filled)) < LEAST_DIFFERENT * len(filled) or not len(filled):
        stamp[:] = np.nan
    return MessageTimes(receipt, stamp)


def _rate(one: MessageTimes) -> float:
    """Seconds of receipt per second of the stamp's clock: the median over pieces of a tenth, which a step or wrong
    stamps do not move."""
    known = np.isfinite(one.receipt + one.stamp)
    receipt, stamp = one.receipt[known], one.stamp[known]
    apart = max(len(stamp) // 10, 1)
    dt = stamp[apart:] - stamp[:-apart]
    good = np.abs(dt) > 0.0
    if not np.any(good):
        return 1.0
    rate = float(np.median((receipt[apart:] - receipt[:-apart])[good] / dt[good]))
    drift = abs(rate - 1.0) * float(np.median(np.abs(dt[good]))) * len(stamp) / apart
    return rate if rate > 0.0 and drift > DRIFT_S else 1.0


def _smoothed(values: Column) -> Column:
    """The running median over `SMOOTH` values, (n,)."""
    window = min(SMOOTH, len(values) - 1 + len(values) % 2)
    if window < 3:
        return values
    padded = np.pad(values, window // 2, mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, window), axis=1))


class _Reference:
    """The clock that most stamps share, beside the recorder's."""

    def __init__(self, stamped: Mapping[str, MessageTimes]) -> None:
        rates = {name: _rate(one) for name, one in stamped.items()}
        own = [n for n, one in stamped.items() if rates[n] == 1.0 and self._near(one)]
        self.is_recorder = bool(own)
        if not own:
            first = max(stamped, key=lambda n: len(stamped[n].stamp))
            own = [n for n in stamped if self._alike(stamped[first], stamped[n], rates[first])]
            self.rate = rates[first]
        else:
            self.rate = 1.0
        receipt = np.concatenate([stamped[n].receipt for n in own])
        stamp = np.concatenate([stamped[n].stamp for n in own])
        topic = np.concatenate([np.full(len(stamped[n].stamp), k) for k, n in enumerate(own)])
        known = np.isfinite(receipt + stamp)
        self.set_back = all(_is_set_back(stamped[n]) for n in own)
        order = np.flatnonzero(known)[np.argsort((stamp if self.set_back else receipt)[known], kind="stable")]
        receipt, stamp, topic = receipt[order], stamp[order], topic[order]
        level = _smoothed(receipt - self.rate * stamp)
        if self.set_back:
            self._set_branches(receipt, level)
            return
        wrong = self._stamp_steps(receipt, stamp, topic, level)
        self._receipt, self._level = receipt[~wrong], level[~wrong]
        if self.is_recorder:
            near = np.abs(self._level) < OTHER_CLOCK
            self.shift = float(np.median(self._level[near])) if near.any() else 0.0
            steady = np.ptp(self._level) < STEP_S
            self._level = np.full(len(self._level), self.shift) if steady else self._level
        else:  # the calendar begins with the recording
            delay = receipt - stamp
            self.shift = float(delay[~wrong].min()) if self.rate == 1.0 else float(delay[~wrong][0])

    def _set_branches(self, receipt: Column, level: Column) -> None:
        """Receipts and levels before and after each time that the recorder's clock was set back."""
        steps = np.flatnonzero(np.diff(level) < -STEP_S) + 1
        edges = [0, *steps.tolist(), len(level)]
        near = [k for k, (a, b) in enumerate(pairwise(edges)) if b > a and abs(np.median(level[a:b])) < OTHER_CLOCK]
        self._branches = [(receipt[a:b], level[a:b]) for a, b in pairwise(edges) if b > a]
        first = self._branches[near[0] if near else 0][1]
        self.shift = float(np.median(first)) if self.is_recorder else float(first[0])

    @staticmethod
    def _near(one: MessageTimes) -> bool:
        """Whether a good part of the stamps is of the recorder's clock."""
        delay = one.receipt - one.stamp
        delay = delay[np.isfinite(delay)]
        return bool(np.mean(np.abs(delay) < OTHER_CLOCK) >= SHARE)

    @staticmethod
    def _alike(one: MessageTimes, other: MessageTimes, rate: float) -> bool:
        levels = [np.nanmedian(o.receipt - rate * o.stamp) for o in (one, other)]
        return bool(abs(levels[0] - levels[1]) < OTHER_CLOCK * max(rate, 1.0))

    def _stamp_steps(self, receipt: Column, stamp: Column, topic: Column, level: Column) -> Mask:
        """Messages (n,) on plateaus of the level that begin with a step of the stamps, and have fewer messages than the
        plateau that is taken for right."""
        allowed = STEP_S + STEP_RATE * np.diff(receipt)
        steps = np.flatnonzero(np.abs(np.diff(level)) > allowed) + 1
        if not len(steps):
            return np.zeros(len(level), bool)
        edges = [0, *steps.tolist(), len(level)]
        pieces = list(pairwise(edges))
        # The offset of the stamps' clock on each plateau, receipt steps left out
        offsets = [0.0]
        for k in steps.tolist():
            jump = float(level[k] - level[k - 1])
            offsets.append(offsets[-1] + (jump if _stamps_jump(receipt, stamp, topic, k, jump, self.rate) else 0.0))
        size: dict[int, int] = {}
        for (a, b), offset in zip(pieces, offsets, strict=True):
            key = round(offset / STEP_S)
            size[key] = size.get(key, 0) + (b - a) * (1 + 2 * bool(self.is_recorder and abs(level[a]) < OTHER_CLOCK))
        right = max(size, key=lambda key: size[key])
        wrong = np.zeros(len(level), bool)
        for (a, b), offset in zip(pieces, offsets, strict=True):
            wrong[a:b] = abs(round(offset / STEP_S) - right) > 1
        return wrong

    def level(self, receipt: Column) -> Column:
        """Receipt minus `rate` times the stamp, as messages that were received then have it, (n,)."""
        if self.set_back:
            pause = [1.5 * float(np.quantile(np.abs(np.diff(own)), 0.99)) for own, _ in self._branches if len(own) > 1]
            edge = max(pause, default=0.0)  # next to the ends of a branch a message may be of either
            inside = np.stack([(receipt >= own[0] - edge) & (receipt <= own[-1] + edge) for own, _ in self._branches])
            levels = np.stack([np.interp(receipt, *branch) for branch in self._branches])
            nearest = np.stack([np.minimum(abs(receipt - own[0]), abs(receipt - own[-1])) for own, _ in self._branches])
            which = np.where(inside.any(axis=0), np.argmax(inside, axis=0), np.argmin(nearest, axis=0))
            one_level = levels[which, np.arange(len(receipt))]
            return np.asarray(np.where(inside.sum(axis=0) > 1, np.nan, one_level))
        found = np.asarray(np.interp(receipt, self._receipt, self._level))
        after = np.clip(np.searchsorted(self._receipt, receipt), 1, max(len(self._receipt) - 1, 1))
        if len(self._receipt) < 2:
            return found
        before = after - 1
        pause = self._receipt[after] - self._receipt[before]
        steps = np.abs(self._level[after] - self._level[before]) > STEP_S
        nearest = np.where(receipt - self._receipt[before] < 0.5 * pause, before, after)
        return np.where(steps & np.isfinite(receipt), self._level[nearest], found)

    def times(self, one: MessageTimes, is_stamped: bool) -> EstimatedTimes:
        """The times of a topic."""
        if not is_stamped:
            return self._of_receipts(one)
        if self.set_back and _is_set_back(one):
            remark = "the recorder's clock was set back; its stamps are in order"
            return EstimatedTimes(one.stamp + (0.0 if self.is_recorder else self.shift), remark, mixed=True)
        misfit = one.receipt - self.rate * one.stamp - self.level(one.receipt)
        known = np.isfinite(misfit)
        near = np.abs(misfit) < OTHER_CLOCK * max(self.rate, 1.0)
        rate = _rate(one)
        same = np.sum(near) >= SHARE * max(np.sum(known), 1) and (abs(rate - self.rate) < 0.01 or np.mean(near) > 0.5)
        if not same:
            return self._of_another_clock(one, rate)
        usual = float(np.median(misfit[near]))
        wrong = ~known | _wrong_stamps(one, misfit - usual, self.rate)
        t = np.where(wrong, np.nan, one.stamp + (0.0 if self.is_recorder else self.shift))
        remarks = [] if self.is_recorder else [self._said()]
        return EstimatedTimes(t, "; ".join([*remarks, *_said_wrong(one, wrong, misfit - usual)]))

    def _said(self) -> str:
        rate = "" if self.rate == 1.0 else f", at {1.0 / self.rate:.3g} times the rate of the recording"
        return f"its stamps are of another clock: {self.shift:+.3f} s{rate}"

    def _of_receipts(self, one: MessageTimes) -> EstimatedTimes:
        level = self.level(one.receipt)
        offset = -self.shift if self.is_recorder else 0.0
        t = (one.receipt - level - offset) / self.rate + (0.0 if self.is_recorder else self.shift)
        remark, known = "", level[np.isfinite(level)]
        if not self.is_recorder or (len(known) and np.ptp(known) > STEP_S):
            remark = "without stamps: its times follow the stamps of the other topics"
        if lost := int(np.sum(~np.isfinite(t))):
            remark = "; ".join(part for part in (remark, f"{counted(lost, 'message')} without a time left out") if part)
        return EstimatedTimes(t, remark)

    def _of_another_clock(self, one: MessageTimes, rate: float) -> EstimatedTimes:
        """Stamps of another clock than the reference, moved onto it."""
        on_reference = self._of_receipts(one).t  # of the receipts
        known = np.isfinite(on_reference + one.stamp)
        relative = rate / self.rate
        if abs(relative - 1.0) * float(np.ptp(one.stamp[known])) < DRIFT_S:
            relative = 1.0
        misfit = on_reference - relative * one.stamp
        usual = float(np.median(misfit[known]))
        wrong = ~known | _wrong_stamps(one, misfit - usual, rate)
        shift = float(np.min(misfit[~wrong])) if np.any(~wrong) else usual
        remark = f"its stamps are of another clock: {shift:+.3f} s"
        if relative != 1.0:
            remark = f"its stamps are of another clock, at {1.0 / relative:.3g} times the rate of the others"
        t = np.where(wrong, np.nan, relative * one.stamp + shift)
        return EstimatedTimes(t, "; ".join([remark, *_said_wrong(one, wrong, misfit - usual)]))


def _is_set_back(one: MessageTimes) -> bool:
    """Whether the receipts of a topic mix messages whose stamps, in their own order, are as regular as ever."""
    known = np.isfinite(one.receipt + one.stamp)
    stamp = one.stamp[known]
    if np.sum(np.diff(stamp) < -STEP_S) < FEWEST_BACK:
        return False
    step = np.diff(np.sort(stamp))
    usual = float(np.median(step))
    return bool(np.mean((step > 0.5 * usual) & (step < 1.5 * usual)) > REGULAR)


def _stamps_jump(receipt: Column, stamp: Column, topic: Column, k: int, jump: float, rate: float) -> bool:
    """Whether it is the stamps whose interval is odd where the level jumps at message k: most of the topics around it
    have receipts that go on as before."""
    votes = 0.0
    for one in np.unique(topic[max(k - SMOOTH, 0) : k + SMOOTH]):
        of_one = np.flatnonzero(topic == one)
        place = int(np.searchsorted(of_one, k))
        near = of_one[max(place - SMOOTH, 0) : place + SMOOTH]
        if len(near) < 3:
            continue
        of_receipt, of_stamp = np.diff(receipt[near]), rate * np.diff(stamp[near])
        at = int(np.argmin(np.abs(of_receipt - of_stamp - jump)))  # the step in this topic
        odd_receipt = abs(of_receipt[at] - np.median(of_receipt))
        odd_stamp = abs(of_stamp[at] - np.median(of_stamp))
        votes += len(near) * np.sign(odd_stamp - odd_receipt)
    return votes > 0.0


def _wrong_stamps(one: MessageTimes, misfit: Column, rate: float) -> Mask:
    """Stamps that are far from the usual ones of their topic, (n,): ahead of them, or behind them though the message
    was not late. ``misfit``: by which the receipt is later than usual [s]."""
    known = np.isfinite(misfit)
    receipt, stamp, late = one.receipt[known], rate * one.stamp[known], misfit[known]
    found = np.zeros(len(misfit), bool)
    if len(receipt) < 3:
        return found
    of_receipt, of_stamp = np.diff(receipt), np.diff(stamp)
    usual = float(np.median(of_receipt))
    off = np.abs(late) > STEP_S + STEP_RATE * usual
    # Neighbours that are off by as much are of one kind: a stretch begins and ends where that changes.
    kind = np.where(off, np.rint(late / STEP_S), 0.0)
    edges = np.flatnonzero(np.diff(kind, prepend=np.nan, append=np.nan) != 0.0)
    wrong = np.zeros(len(receipt), bool)
    for a, b in pairwise(edges.tolist()):
        if not off[a]:
            continue
        # At its begin, or else at its end, the interval of the clock that failed is odd.
        at = a - 1 if a else b - 1
        if at >= len(of_receipt):
            continue
        odd_receipt, odd_stamp = abs(of_receipt[at] - usual), abs(of_stamp[at] - usual)
        wrong[a:b] = (a > 0 and wrong[a - 1] and abs(kind[a] - kind[a - 1]) <= 1.0) or (
            odd_stamp > max(odd_receipt, 0.5 * abs(late[a] - (late[a - 1] if a else 0.0)), 0.5 * STEP_S)
        )
    found[known] = wrong
    return found


def _said_wrong(one: MessageTimes, wrong: Mask, misfit: Column) -> list[str]:
    """What is said of wrong stamps, if there are any."""
    if not np.any(wrong):
        return []
    start = float(np.nanmin(one.receipt)) if np.isfinite(one.receipt).any() else 0.0
    first = one.receipt[np.argmax(wrong)]
    since = f", the first at {first - start:.1f} s" if np.isfinite(first) else ""
    off = -misfit[wrong & np.isfinite(misfit)]
    by = f", by {float(np.median(off)):+.2f} s" if len(off) else ", which are empty"
    return [f"{int(np.sum(wrong))} of {len(wrong)} stamps are wrong{by}{since}: left out"]
