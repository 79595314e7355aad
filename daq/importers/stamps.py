"""Times of messages that have two times: the stamp of their source and the receipt by the recorder.

Theory of operation. The stamp is the time of the measurement, so it is the better time. But a stamp can be wrong: a
driver overflows, a simulation is reset, or a message comes before the first fix. The receipt is late, and the clock of
the recorder can step. The level, receipt minus stamp, shows which of the two clocks failed:

- The stamps of most topics share one clock, the reference. The reference is the recorder's own clock if some stamps
  agree with it. Otherwise it is the clock of the topic with the most messages, as in a bag of a simulation. The
  reference may have another rate than the recorder: a simulation at half the real time has stamps that run half as
  fast.
- If the level of all topics steps, one of the clocks stepped: the clock with an unusual interval at the step.
- If the clock of the recorder is set back, messages from before and after the change have the same receipts. In the
  order of their stamps, which stay regular, the step is clear. Messages of this time without a stamp are left out.
- A stamp is wrong if its level is far from the other levels of its topic. It is left out. A message that is only late
  keeps its stamp: the interval of its receipts is unusual, but the interval of its stamps is not.
- A topic with stamps of another clock is moved onto the reference by the shortest delay, or by a straight line if the
  clocks differ in rate.
- A topic without stamps gets its receipts, converted to the reference by the level of the other topics.
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

OTHER_CLOCK = 1.0  # s; stamps that are farther from the receipt come from another clock
STEP_S, STEP_RATE = 0.25, 0.5  # s, and s per second between two messages; a larger change of the level is a step
DRIFT_S = 0.2  # s over a whole recording; a larger drift means a clock of another rate
SMOOTH = 51  # messages in the running median of the level
LEAST_DIFFERENT = 0.1  # share of different stamps of a topic; with a smaller share the stamps do not count
FEWEST_BACK = 3  # stamps that run back, in the order of receipt, if the recorder's clock was set back
REGULAR = 0.95  # share of usual intervals of the sorted stamps if the recorder's clock was set back
SHARE = 0.2  # share of a topic's stamps that must agree with a clock


class MessageTimes(NamedTuple):
    """Times of the messages of one topic in the order of receipt.

    Attributes
    ----------
    receipt : Array (n,)
        Receipts by the recorder [s since 1970].
    stamp : Array (n,)
        Stamps of the source [s since 1970]; NaN for messages without a header, 0 for empty stamps.
    """

    receipt: Column  # s since 1970, (n,)
    stamp: Column  # s since 1970, (n,); NaN for messages without a header, 0 for empty stamps


class EstimatedTimes(NamedTuple):
    """Estimated times of measurement of the messages of one topic.

    Attributes
    ----------
    t : Array (n,)
        Times [s since 1970]; NaN for a message without a reliable time.
    remark : str
        What is unusual about the times, for the user; "" if nothing is.
    mixed : bool
        Whether the receipts are out of order, but the times are not. Times that run back in the file are then no fault.
    """

    t: Column  # s since 1970, (n,); NaN for a message without a reliable time
    remark: str  # for the user, "" if all is normal
    mixed: bool = False  # whether the receipts are out of order, but the times are not


def message_times(topics: Mapping[str, MessageTimes]) -> dict[str, EstimatedTimes]:
    """Estimate the times at which the messages of a recording were measured.

    Parameters
    ----------
    topics
        Receipts by the recorder and stamps of the source, by topic.

    Returns
    -------
    dict
        Times by topic, converted to one clock. If no topic has at least two stamps, each message has its stamp or,
        without one, its receipt. A message without a reliable time has NaN.
    """
    clean = {name: _without_zeros(times) for name, times in topics.items()}
    stamped = {n: times for n, times in clean.items() if np.isfinite(times.stamp + times.receipt).sum() > 1}
    if not stamped:
        return {
            n: EstimatedTimes(np.where(np.isfinite(times.stamp), times.stamp, times.receipt), "")
            for n, times in clean.items()
        }
    reference = _ReferenceClock(stamped)
    return {name: reference.times(times, name in stamped) for name, times in clean.items()}


def _without_zeros(times: MessageTimes) -> MessageTimes:
    """Return the receipts and stamps of a topic with NaN in place of empty ones, which are 0.

    All stamps become NaN if all are empty, or if fewer than 10 % of them differ. Receipts that are all 0 are unchanged.
    """
    # Messages of a simulation are empty until its first clock message.
    receipt, stamp = times.receipt.copy(), times.stamp.copy()
    for t in (receipt, stamp):
        if np.any(t > 0.0):
            t[t == 0.0] = np.nan
    filled = stamp[stamp > 0.0]
    if len(np.unique(filled)) < LEAST_DIFFERENT * len(filled) or not len(filled):
        stamp[:] = np.nan
    return MessageTimes(receipt, stamp)


def _receipt_rate(times: MessageTimes) -> float:
    """Return how fast the recorder's clock runs by the stamps of a topic: seconds of receipt per second of stamps.

    The rate is a median over pieces of a tenth of the recording, which a step or wrong stamps do not affect. The rate
    is exactly 1 if the clocks drift by less than 0.2 s over the recording, if the rate is not positive, or without
    stamps.
    """
    known = np.isfinite(times.receipt + times.stamp)
    receipt, stamp = times.receipt[known], times.stamp[known]
    apart = max(len(stamp) // 10, 1)
    dt = stamp[apart:] - stamp[:-apart]
    good = np.abs(dt) > 0.0
    if not np.any(good):
        return 1.0
    rate = float(np.median((receipt[apart:] - receipt[:-apart])[good] / dt[good]))
    drift = abs(rate - 1.0) * float(np.median(np.abs(dt[good]))) * len(stamp) / apart
    return rate if rate > 0.0 and drift > DRIFT_S else 1.0


def _running_median(values: Column) -> Column:
    """Return the running median (n,) of the offsets (n,) [s] between message stamps and their receipts.

    The median is over 51 values, or over the largest odd number of values if there are fewer. The first and the last
    value are repeated beyond the ends. Fewer than 3 values are returned unchanged.
    """
    window = min(SMOOTH, len(values) - 1 + len(values) % 2)
    if window < 3:
        return values
    padded = np.pad(values, window // 2, mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, window), axis=1))


class _ReferenceClock:
    """The clock to which all times of a recording are converted (the reference), and its offset from the recorder's.

    The reference is the recorder's own clock, or else that of the topic with the most messages. The offset is called
    the level: the receipt minus `rate` times the stamp [s].

    Attributes
    ----------
    is_recorder : bool
        Whether the reference is the recorder's own clock.
    rate : float
        Seconds of the recorder's clock per second of the reference; 1 for clocks of equal rate.
    set_back : bool
        Whether the recorder's clock was set back during the recording.
    shift : float
        Usual level [s] if the reference is the recorder's clock. Otherwise the time that is added to the stamps [s], so
        that the recording keeps its date.
    """

    def __init__(self, stamped: Mapping[str, MessageTimes]) -> None:
        """Choose the reference clock, and measure its offset from the clock of the recorder.

        `stamped` has receipts and stamps of each topic with at least two stamps.

        Topics share the recorder's clock if their stamps have its rate, and at least 20 % of the stamps are within 1 s
        of their receipts. Without such a topic, the topic with the most messages gives the clock and its rate, and
        topics with about the same level share it. Only these topics are used. Their level is smoothed by a running
        median in the order of receipt, and wrong stamps are left out. If the recorder's clock was set back in all of
        them, the order is that of the stamps, each interval between two steps back has its own level, and no stamp is
        left out.
        """
        rates = {name: _receipt_rate(times) for name, times in stamped.items()}
        sharing = [n for n, times in stamped.items() if rates[n] == 1.0 and self._agrees_with_recorder(times)]
        self.is_recorder = bool(sharing)
        if not sharing:
            first = max(stamped, key=lambda n: len(stamped[n].stamp))
            sharing = [n for n in stamped if self._shares_clock(stamped[first], stamped[n], rates[first])]
            self.rate = rates[first]
        else:
            self.rate = 1.0
        receipt = np.concatenate([stamped[n].receipt for n in sharing])
        stamp = np.concatenate([stamped[n].stamp for n in sharing])
        topic = np.concatenate([np.full(len(stamped[n].stamp), k) for k, n in enumerate(sharing)])
        known = np.isfinite(receipt + stamp)
        self.set_back = all(_is_set_back(stamped[n]) for n in sharing)
        order = np.flatnonzero(known)[np.argsort((stamp if self.set_back else receipt)[known], kind="stable")]
        receipt, stamp, topic = receipt[order], stamp[order], topic[order]
        level = _running_median(receipt - self.rate * stamp)
        if self.set_back:
            self._store_branches(receipt, level)
            return
        wrong = self._stamp_steps(receipt, stamp, topic, level)
        self._receipt, self._level = receipt[~wrong], level[~wrong]
        if self.is_recorder:
            near = np.abs(self._level) < OTHER_CLOCK
            self.shift = float(np.median(self._level[near])) if near.any() else 0.0
            steady = np.ptp(self._level) < STEP_S
            self._level = np.full(len(self._level), self.shift) if steady else self._level
        else:  # shift the stamps so that the recording keeps its date
            delay = receipt - stamp
            self.shift = float(delay[~wrong].min()) if self.rate == 1.0 else float(delay[~wrong][0])

    def _store_branches(self, receipt: Column, level: Column) -> None:
        """Store the level separately for each interval between two steps back of the recorder's clock, and set `shift`.

        The level is the receipt minus `rate` times the stamp [s]. After a step back the same receipt may occur again
        with another level, so each interval (a branch) is interpolated on its own. `receipt` and `level` (n,) are in
        the order of the stamps; a fall of the level by more than 0.25 s is a step. `shift` is set from the first branch
        whose level is between -1 s and 1 s (near the recorder's clock), or else from the first branch. `shift` is the
        median of the levels of this branch if the reference is the recorder's clock, and otherwise the first of them.
        """
        steps = np.flatnonzero(np.diff(level) < -STEP_S) + 1
        edges = [0, *steps.tolist(), len(level)]
        near = [k for k, (a, b) in enumerate(pairwise(edges)) if b > a and abs(np.median(level[a:b])) < OTHER_CLOCK]
        self._branches = [(receipt[a:b], level[a:b]) for a, b in pairwise(edges) if b > a]
        first = self._branches[near[0] if near else 0][1]
        self.shift = float(np.median(first)) if self.is_recorder else float(first[0])

    @staticmethod
    def _agrees_with_recorder(times: MessageTimes) -> bool:
        """Return whether at least 20 % of the stamps of a topic are within 1 s of their receipt by the recorder."""
        delay = times.receipt - times.stamp
        delay = delay[np.isfinite(delay)]
        return bool(np.mean(np.abs(delay) < OTHER_CLOCK) >= SHARE)

    @staticmethod
    def _shares_clock(first: MessageTimes, second: MessageTimes, rate: float) -> bool:
        """Return whether the stamps of two topics share a clock: their medians of receipt minus stamp are about equal.

        The stamp is multiplied by `rate`, the rate of the receipts [s/s]. The medians may differ by 1 s, or by `rate`
        seconds if `rate` is above 1.
        """
        levels = [np.nanmedian(times.receipt - rate * times.stamp) for times in (first, second)]
        return bool(abs(levels[0] - levels[1]) < OTHER_CLOCK * max(rate, 1.0))

    def _stamp_steps(self, receipt: Column, stamp: Column, topic: Column, level: Column) -> Mask:
        """Return the flags (n,) of messages with wrong stamps, found by the steps of the level (receipt minus stamp).

        The messages of all topics are in the order of receipt; `topic` (n,) has the number of the topic of each.
        Between two steps (changes above 0.25 s plus half the time between the messages) the level is about constant (a
        plateau). Steps of the stamps, not those of the receipts, change the offset of their clock. The offset with the
        most messages is right, and messages with a clearly different offset are wrong. If the reference is the
        recorder's clock, plateaus within 1 s of it count three times. Without steps all flags are False.
        """
        allowed = STEP_S + STEP_RATE * np.diff(receipt)
        steps = np.flatnonzero(np.abs(np.diff(level)) > allowed) + 1
        if not len(steps):
            return np.zeros(len(level), bool)
        edges = [0, *steps.tolist(), len(level)]
        pieces = list(pairwise(edges))
        # Offset of the clock of the stamps on each plateau, without the steps of the receipts
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
        """Return the level, receipt minus `rate` times stamp [s], as it was for messages received at the given times.

        `receipt` has these times (n,) [s since 1970]. The level (n,) is interpolated, but not over a step. If the
        reference is the recorder's clock and its level varies by less than 0.25 s, the level is `shift` everywhere. If
        the recorder's clock was set back, it is NaN for receipts that occurred twice, with different levels.
        """
        if self.set_back:
            pause = [1.5 * float(np.quantile(np.abs(np.diff(own)), 0.99)) for own, _ in self._branches if len(own) > 1]
            edge = max(pause, default=0.0)  # near its end a message may belong to either branch
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

    def times(self, topic_times: MessageTimes, is_stamped: bool) -> EstimatedTimes:
        """Return the times of measurement of the messages of a topic, on the reference clock of the recording.

        Parameters
        ----------
        topic_times
            Receipts and stamps of the topic.
        is_stamped
            Whether the topic has at least two stamps.

        Returns
        -------
        EstimatedTimes
            The times, with a remark about what is unusual. Without `is_stamped` they are the converted receipts.
            Otherwise messages with a wrong or empty stamp have NaN. Right stamps are unchanged if the reference is the
            recorder's clock; otherwise `shift` is added. Stamps of another clock are converted. The stamps are taken as
            those of another clock if fewer than 20 % of them agree with the reference to about 1 s, or if their rate is
            another one and no more than half of them agree.
        """
        if not is_stamped:
            return self._times_of_receipts(topic_times)
        if self.set_back and _is_set_back(topic_times):
            remark = "the recorder's clock was set back; the stamps are in order and are used"
            return EstimatedTimes(topic_times.stamp + (0.0 if self.is_recorder else self.shift), remark, mixed=True)
        misfit = topic_times.receipt - self.rate * topic_times.stamp - self.level(topic_times.receipt)
        known = np.isfinite(misfit)
        near = np.abs(misfit) < OTHER_CLOCK * max(self.rate, 1.0)
        rate = _receipt_rate(topic_times)
        same = np.sum(near) >= SHARE * max(np.sum(known), 1) and (abs(rate - self.rate) < 0.01 or np.mean(near) > 0.5)
        if not same:
            return self._times_of_another_clock(topic_times, rate)
        usual = float(np.median(misfit[near]))
        wrong = ~known | _wrong_stamps(topic_times, misfit - usual, self.rate)
        t = np.where(wrong, np.nan, topic_times.stamp + (0.0 if self.is_recorder else self.shift))
        remarks = [] if self.is_recorder else [self._shift_remark()]
        return EstimatedTimes(t, "; ".join([*remarks, *_wrong_remarks(topic_times, wrong, misfit - usual)]))

    def _shift_remark(self) -> str:
        """Return the remark that stamps come from another clock than the recorder's, with its offset [s] and rate."""
        rate = "" if self.rate == 1.0 else f", at {1.0 / self.rate:.3g} times the rate of the recording"
        return f"its stamps are of another clock: moved by {self.shift:+.3f} s{rate}"

    def _times_of_receipts(self, topic_times: MessageTimes) -> EstimatedTimes:
        """Return the times of a topic without stamps: its receipts, converted to the reference clock.

        The stamps of the other topics give the conversion. A message for which it is unknown has NaN, and the remark
        counts these messages.
        """
        level = self.level(topic_times.receipt)
        offset = -self.shift if self.is_recorder else 0.0
        t = (topic_times.receipt - level - offset) / self.rate + (0.0 if self.is_recorder else self.shift)
        remark, known = "", level[np.isfinite(level)]
        if not self.is_recorder or (len(known) and np.ptp(known) > STEP_S):
            remark = "without stamps: its times are the receipts, corrected by the stamps of the other topics"
        if lost := int(np.sum(~np.isfinite(t))):
            remark = "; ".join(part for part in (remark, f"{counted(lost, 'message')} without a time left out") if part)
        return EstimatedTimes(t, remark)

    def _times_of_another_clock(self, topic_times: MessageTimes, rate: float) -> EstimatedTimes:
        """Return the times of a topic whose stamps are of a clock of their own, converted to the reference clock.

        The shortest delay between stamp and receipt gives the offset of the clock. `rate` is the rate of the receipts
        by the stamps [s/s]; a drift below 0.2 s over the recording is neglected. Wrong stamps become NaN, and the
        remark counts them.
        """
        on_reference = self._times_of_receipts(topic_times).t
        known = np.isfinite(on_reference + topic_times.stamp)
        relative = rate / self.rate
        if abs(relative - 1.0) * float(np.ptp(topic_times.stamp[known])) < DRIFT_S:
            relative = 1.0
        misfit = on_reference - relative * topic_times.stamp
        usual = float(np.median(misfit[known]))
        wrong = ~known | _wrong_stamps(topic_times, misfit - usual, rate)
        shift = float(np.min(misfit[~wrong])) if np.any(~wrong) else usual
        remark = f"its stamps are of another clock: moved by {shift:+.3f} s"
        if relative != 1.0:
            remark = f"its stamps are of another clock, at {1.0 / relative:.3g} times the rate of the others"
        t = np.where(wrong, np.nan, relative * topic_times.stamp + shift)
        return EstimatedTimes(t, "; ".join([remark, *_wrong_remarks(topic_times, wrong, misfit - usual)]))


def _is_set_back(times: MessageTimes) -> bool:
    """Return whether the recorder's clock was set back: stamps are out of order by receipt, but regular when sorted.

    This needs at least 3 steps back of the stamps by more than 0.25 s. Of the intervals of the sorted stamps, more than
    95 % must differ by less than half from their median.
    """
    known = np.isfinite(times.receipt + times.stamp)
    stamp = times.stamp[known]
    if np.sum(np.diff(stamp) < -STEP_S) < FEWEST_BACK:
        return False
    step = np.diff(np.sort(stamp))
    usual = float(np.median(step))
    return bool(np.mean((step > 0.5 * usual) & (step < 1.5 * usual)) > REGULAR)


def _stamps_jump(receipt: Column, stamp: Column, topic: Column, k: int, jump: float, rate: float) -> bool:
    """Return whether the stamps stepped, not the receipts, at message k, where receipt minus stamp jumps by `jump` [s].

    Each topic near message k votes for the clock whose interval at the step is more unusual, with a weight of its
    number of messages. A topic with fewer than 3 messages there has no vote, and an equal vote means the receipts.
    `receipt`, `stamp` and `topic` (number of the topic) are of all messages (n,). `rate` is the rate of the receipts by
    the stamps [s/s].
    """
    votes = 0.0
    for index in np.unique(topic[max(k - SMOOTH, 0) : k + SMOOTH]):
        of_topic = np.flatnonzero(topic == index)
        place = int(np.searchsorted(of_topic, k))
        near = of_topic[max(place - SMOOTH, 0) : place + SMOOTH]
        if len(near) < 3:
            continue
        of_receipt, of_stamp = np.diff(receipt[near]), rate * np.diff(stamp[near])
        at = int(np.argmin(np.abs(of_receipt - of_stamp - jump)))  # the step in this topic
        odd_receipt = abs(of_receipt[at] - np.median(of_receipt))
        odd_stamp = abs(of_stamp[at] - np.median(of_stamp))
        votes += len(near) * np.sign(odd_stamp - odd_receipt)
    return votes > 0.0


def _wrong_stamps(times: MessageTimes, misfit: Column, rate: float) -> Mask:
    """Return the flags (n,) of wrong stamps of a topic; a stamp of a message that is only late is not wrong.

    `misfit` (n,) is the delay from stamp to receipt beyond the usual delay [s], NaN if unknown, and `rate` the rate of
    the receipts by the stamps [s/s]. A stamp is wrong if its misfit exceeds 0.25 s plus half the usual interval of the
    receipts, and the interval of the stamps before it is clearly more unusual than that of the receipts. Successive
    stamps with about the same misfit are judged together. With fewer than 3 known misfits no stamp is wrong.
    """
    known = np.isfinite(misfit)
    receipt, stamp, late = times.receipt[known], rate * times.stamp[known], misfit[known]
    found = np.zeros(len(misfit), bool)
    if len(receipt) < 3:
        return found
    of_receipt, of_stamp = np.diff(receipt), np.diff(stamp)
    usual = float(np.median(of_receipt))
    off = np.abs(late) > STEP_S + STEP_RATE * usual
    # Neighbours with about the same misfit belong to one segment, which is judged as a whole.
    kind = np.where(off, np.rint(late / STEP_S), 0.0)
    edges = np.flatnonzero(np.diff(kind, prepend=np.nan, append=np.nan) != 0.0)
    wrong = np.zeros(len(receipt), bool)
    for a, b in pairwise(edges.tolist()):
        if not off[a]:
            continue
        # At the begin of the segment, or else at its end, the clock that failed has an unusual interval.
        at = a - 1 if a else b - 1
        if at >= len(of_receipt):
            continue
        odd_receipt, odd_stamp = abs(of_receipt[at] - usual), abs(of_stamp[at] - usual)
        wrong[a:b] = (a > 0 and wrong[a - 1] and abs(kind[a] - kind[a - 1]) <= 1.0) or (
            odd_stamp > max(odd_receipt, 0.5 * abs(late[a] - (late[a - 1] if a else 0.0)), 0.5 * STEP_S)
        )
    found[known] = wrong
    return found


def _wrong_remarks(times: MessageTimes, wrong: Mask, misfit: Column) -> list[str]:
    """Return a list with the remark about wrong stamps of a topic: number, error and first occurrence.

    `wrong` (n,) flags these stamps. The list is empty without them. `misfit` (n,) is the delay from stamp to receipt
    beyond the usual delay [s], NaN for an empty stamp.
    """
    if not np.any(wrong):
        return []
    start = float(np.nanmin(times.receipt)) if np.isfinite(times.receipt).any() else 0.0
    first = times.receipt[np.argmax(wrong)]
    since = f", the first at {first - start:.1f} s" if np.isfinite(first) else ""
    off = -misfit[wrong & np.isfinite(misfit)]
    by = f", by {float(np.median(off)):+.2f} s" if len(off) else ", which are empty"
    return [f"{int(np.sum(wrong))} of {len(wrong)} stamps are wrong{by}{since}: messages left out"]
