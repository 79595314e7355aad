"""Point outliers of a signal: values that contradict the samples before and after them.

A sample, or a burst (a few samples in succession), is an outlier if three things hold together:

1. The samples on both sides agree with each other, so that no step lies between them.
2. The value differs from the straight line between the two sides by several times more than any neighbouring sample
   differs from the next one. Waves, impacts and reversals of a propeller also change the neighbours.
3. The difference is larger than what a small craft can do within the time of the burst (`LEAST`).

Positions get a second test. A jump that no craft can make starts a section at another place. If the positions jump
back, the section is left out. A short section at the start of a log, before the receiver has settled, is left out too.
A jump without a return is kept, and a check reports it (`position_jumps`).

Notes
-----
The first test is a Hampel filter (Hampel 1974) with the largest neighbouring step instead of the median absolute
deviation, since the deviation of a shaft speed is zero between its steps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.data.record import Channel, LeftOut
from seatrial.ident.model import COMMAND, SHAFT_SPEED, THRUSTER_FORCE, SignalId, command_of, is_of_thruster
from seatrial.ident.numerics import Array, wrap

Mask = NDArray[np.bool_]
LONGEST = 3  # samples of a burst that is searched at every sample; longer bursts are searched between two jumps
MAX_JUMPS = 0.02  # share of the samples that jump; more jumps are noise, or another unit
NEIGHBOURS = 6  # samples on each side of a burst, which show the usual step between samples
FEWEST_STEPS = 4  # between neighbours that are no suspects; with fewer, their usual size is unknown
TIMES_STEP = 5.0  # least ratio of an outlier's difference to the largest step of its neighbours
TIMES_SIDES = 3.0  # least ratio of an outlier's difference to the difference between both sides
# Least difference of an outlier, in the units of the signal, and the longest time [s] from the sample before a burst to
# the one after it. Beyond that time the craft itself may have moved there and back.
LEAST: dict[str, tuple[float, float]] = {
    "x": (5.0, 5.0), "y": (5.0, 5.0), "vx": (3.0, 2.5), "vy": (3.0, 2.5), "u": (3.0, 2.5), "v": (3.0, 2.5),
    "speed": (3.0, 2.5), "psi": (0.6, 0.7), "phi": (0.6, 0.5), "theta": (0.6, 0.5), "p": (2.0, 0.5), "q": (2.0, 0.5),
    "r": (1.0, 0.5), "ax": (30.0, 0.3), "ay": (30.0, 0.3), "az": (30.0, 0.3),
}  # fmt: skip
HEADING_SPAN = 5.0  # s, longest burst of headings that a gyro contradicts
SHAFT = (0.1, 0.35)  # the same two limits for shaft speeds: relative to full speed, and in s
# Other signals, for example a force, have no physical scale. Their limit is a multiple of the range of the middle 98 %.
TIMES_RANGE, OTHER_SPAN_S = 1.0, 0.35
IMPOSSIBLE = 1e6  # SI units; no sensor of a small craft reports such a number in one of these signals
ANGLES = ("psi", "phi", "theta")
# A single step has neighbouring changes smaller than this part of the step. A signal with so many single steps is a
# command.
ALONE, FEWEST_COMMAND_STEPS = 0.05, 3
COMMANDED_S = 1.0  # before a burst, in which a change of the command may have caused it
JUMP, FASTEST = 30.0, 40.0  # m, m/s; a change of position beyond both is not a motion
AWAY, START = 60.0, 60.0  # s, longest section at another place, in the middle and at the start of a log


def without_outliers(found: Mapping[str, Channel]) -> dict[str, Channel]:
    """Remove point outliers from the signals of a log.

    Parameters
    ----------
    found
        The signals by name.

    Returns
    -------
    dict
        The signals without outliers, which are kept in `Channel.left_out`. A signal without an outlier is the same
        object. So is a signal of which all samples are outliers.

    Notes
    -----
    Commands and signals with the hold ``zero`` are not tested, since they may have any value at any time (`outliers`
    lists further exceptions). If x and y have the same sample times, an outlier of one coordinate removes the fix from
    both, and short sections of fixes at another place are removed as well.
    """
    masks = {name: outliers(name, c, found) for name, c in found.items() if c.hold != "zero"}
    pair = [found[n] for n in ("x", "y") if n in found]
    if len(pair) == 2 and np.array_equal(pair[0].t, pair[1].t):
        both = masks.get("x", np.zeros(pair[0].t.size, bool)) | masks.get("y", np.zeros(pair[0].t.size, bool))
        both |= sections_elsewhere(pair[0].t, pair[0].value, pair[1].value, ~both)
        masks["x"] = masks["y"] = both
    return {
        name: _remove_samples(c, masks[name]) if name in masks and masks[name].any() else c for name, c in found.items()
    }


def _remove_samples(c: Channel, bad: Mask) -> Channel:
    """Return the signal ``c`` without the samples for which ``bad`` (n,) is True; they become its `Channel.left_out`.

    Outliers that the signal had there before are replaced. If all samples are marked, return the signal unchanged.
    """
    if bad.all():
        return c  # the checks of ranges and units name a signal that is wrong throughout
    left_out = LeftOut(c.t[bad] - c.t[0], c.value[bad], float(c.t[0]))
    return replace(c, t=c.t[~bad], value=c.value[~bad], left_out=left_out)


def outliers(name: str, c: Channel, found: Mapping[str, Channel]) -> Mask:
    """Return which samples of a signal are point outliers.

    Parameters
    ----------
    name, c
        Name and samples (n,) of the signal. The name determines the limits (`LEAST`).
    found
        All signals by name. With a yaw rate ``r``, longer bursts of a heading are found. A change of a thruster's
        command explains a change of its shaft speed, which is then no outlier.

    Returns
    -------
    Array (n,)
        True for an outlier. All False for a command, a given force, a servo output, a sampled or averaged signal, a
        signal without limits of its own whose middle 98 % are constant, and a signal with fewer than 12 samples. All
        False also for a signal that is stepped like a command (`is_stepped`), except signals in `LEAST` and shaft
        speeds whose command is in ``found``. NaN, and values of `IMPOSSIBLE` (1e6) or more, are outliers of shaft
        speeds and of signals in `LEAST`, unless they are more than 5 % of the samples (a wrong unit).
    """
    none = np.zeros(c.t.size, bool)
    least, span = _outlier_limits(name, c)
    if not np.isfinite(least) or c.t.size < 2 * NEIGHBOURS:
        return none
    limited = name in LEAST or is_of_thruster(name, COMMAND, SHAFT_SPEED)
    impossible = ~(np.abs(c.value) < IMPOSSIBLE) if limited else none
    if impossible.mean() > 0.05:
        impossible = none  # so many large values are a wrong unit, not outliers
    kept = np.flatnonzero(~impossible)
    bad = impossible.copy()
    value = c.value
    if name == "psi" and "r" in found and found["r"].t.size > 1:
        # The gyro excludes that the craft turned there and back, so that a longer burst can be detected.
        value, span = np.unwrap(value) - _heading_change(found["r"], c.t), HEADING_SPAN
    bad[kept] = _burst_mask(name, c.t[kept], value[kept], least, span)
    if is_of_thruster(name, SHAFT_SPEED) and (command := command_of(SignalId.parse(name).source)) in found:
        bad &= ~_explained_by_command(c, bad, found[command])
    elif name not in LEAST and bad.any() and is_stepped(c.value, least, int(bad.sum())):
        return none
    return bad


def is_stepped(value: Array, least: float, n_bad: int) -> bool:
    """Return whether a signal changes in single steps from one constant value to another, as a command does.

    Parameters
    ----------
    value
        The signal (n,).
    least
        Smallest step that counts, in the unit of the signal.
    n_bad
        Number of suspected outliers. At least half as many single steps are required, and at least
        `FEWEST_COMMAND_STEPS` (3).

    Notes
    -----
    A step is single if the changes just before and after it are less than 5 % of it. A short pulse of a joystick in
    such a signal is real. A measured shaft speed follows with a lag, so that a large change takes several samples.
    """
    steps = np.abs(np.diff(value))
    inside = steps[1:-1]
    alone = (inside > least) & (steps[:-2] < ALONE * inside) & (steps[2:] < ALONE * inside)
    n_steps = int(alone.sum())
    return n_steps >= FEWEST_COMMAND_STEPS and n_steps >= 0.5 * n_bad


def _outlier_limits(name: str, c: Channel) -> tuple[float, float]:
    """Return the smallest difference of an outlier from its neighbours, and the longest duration of a burst.

    The difference is in the unit of the signal ``c``. The duration [s] is the time from the sample before the burst to
    the one after it. Both depend on the ``name`` of the signal. For signals that may jump (commands, given forces,
    servo outputs, sampled and averaged signals) they are infinite and zero, so that no sample is an outlier. For a
    signal without a physical scale, the difference is the range of its middle 98 % of samples, or infinite if these are
    constant.
    """
    if is_of_thruster(name, COMMAND, THRUSTER_FORCE, "servo", "pwm") or c.sampled or c.hold == "average":
        return np.inf, 0.0
    if is_of_thruster(name, SHAFT_SPEED):
        return SHAFT
    if name in LEAST:
        return LEAST[name]
    low, high = np.quantile(c.value, [0.01, 0.99]) if c.value.size else (0.0, 0.0)
    return (TIMES_RANGE * float(high - low) if high > low else np.inf), OTHER_SPAN_S


def _burst_mask(name: str, t: Array, value: Array, least: float, span: float) -> Mask:
    """Return which samples (n,) of a signal belong to a burst of outliers (one sample, or a few in succession).

    The difference of a burst from the straight line must also exceed five times the largest step between its
    neighbours, of which at least four steps must be free of suspects.

    Parameters
    ----------
    name
        Name of the signal. Differences of headings and attitudes are wrapped.
    t, value
        Times [s] and values of the samples (n,).
    least
        Least difference of an outlier from the straight line between both sides, in the unit of the signal.
    span
        Longest time [s] from the sample before a burst to the sample after it.

    Returns
    -------
    Array (n,)
        True for outliers. All False if more than 20 % of the samples are suspects, which are then noise.
    """
    bad = np.zeros(t.size, bool)
    candidates = [_burst_candidates(name, t, value, length, least, span) for length in range(1, LONGEST + 1)]
    long_bursts = _long_bursts(name, t, value, least, span)
    suspect = np.zeros(t.size, bool)
    for length, (starts, _) in enumerate(candidates, start=1):
        for k in range(length):
            suspect[starts + k] = True
    for first, length, _ in long_bursts:
        suspect[first : first + length] = True
    if suspect.mean() > 0.2:
        return bad  # so many suspects are noise, not outliers
    steps = np.abs(_wrapped_difference(name, value[1:], value[:-1]))
    regular = ~(suspect[1:] | suspect[:-1])
    short = [
        (first, length, size)
        for length, (starts, sizes) in enumerate(candidates, start=1)
        for first, size in zip(starts.tolist(), sizes.tolist(), strict=True)
    ]
    for first, length, size in (*short, *long_bursts):
        around = slice(max(first - NEIGHBOURS, 0), first + length + NEIGHBOURS - 1)
        near = steps[around][regular[around]]
        if near.size >= FEWEST_STEPS and size > TIMES_STEP * float(near.max()):
            bad[first : first + length] = True
    return bad


def _heading_change(rate: Channel, t: Array) -> Array:
    """Return the integral [rad] of a yaw rate [rad/s] from its first sample to each of the times ``t`` (n,) [s].

    The trapezoidal rule is used. Before the first and after the last sample, the integral is constant.
    """
    steps = 0.5 * (rate.value[1:] + rate.value[:-1]) * np.diff(rate.t)
    return np.asarray(np.interp(t, rate.t, np.append(0.0, np.cumsum(steps))))


def _long_bursts(name: str, t: Array, value: Array, least: float, span: float) -> list[tuple[int, int, float]]:
    """Return first sample, length and size of each burst of more than 3 samples, from a jump to the jump back.

    Parameters
    ----------
    name
        Name of the signal. Differences of headings and attitudes are wrapped.
    t, value
        Times [s] and values of the samples (n,).
    least
        Least difference of an outlier from the straight line between both sides, in the unit of the signal. A jump is a
        step between two samples that is larger.
    span
        Longest time [s] from the sample before a burst to the sample after it.

    Returns
    -------
    list
        Index of the first sample, number of samples, and smallest difference from the straight line between both sides
        in the unit of the signal, which exceeds ``least`` and three times the difference between both sides. Empty if
        the number of jumps exceeds 2 % of the samples plus two.
    """
    jumps = np.flatnonzero(np.abs(_wrapped_difference(name, value[1:], value[:-1])) > least) + 1
    if jumps.size > MAX_JUMPS * t.size + 2:
        return []
    found, end = [], 0
    # Jumps beyond the span need no look: a long log has thousands. The slack leaves equality to the test below.
    lasts = np.searchsorted(t[jumps], t[jumps - 1] + span + 1e-6, side="right")
    for i, first in enumerate(jumps.tolist()):
        if first < end:
            continue
        for after in reversed(jumps[i + 1 : int(lasts[i])].tolist()):
            if after - first <= LONGEST or t[after] - t[first - 1] > span:
                continue
            sides = _wrapped_difference(name, value[after : after + 1], value[first - 1 : first])
            part = (t[first:after] - t[first - 1]) / (t[after] - t[first - 1])
            size = float(np.min(np.abs(_wrapped_difference(name, value[first:after], value[first - 1] + part * sides))))
            if size > max(least, TIMES_SIDES * abs(float(sides[0]))):
                found.append((first, after - first, size))
                end = after
                break
    return found


def _burst_candidates(
    name: str, t: Array, value: Array, length: int, least: float, span: float
) -> tuple[NDArray[np.intp], Array]:
    """Return the possible bursts of ``length`` samples, before their comparison with the steps of neighbouring samples.

    Parameters
    ----------
    name
        Name of the signal. Differences of headings and attitudes are wrapped.
    t, value
        Times [s] and values of the samples (n,).
    length
        Number of samples of a burst.
    least
        Least difference of an outlier from the straight line between both sides, in the unit of the signal.
    span
        Longest time [s] from the sample before a burst to the sample after it.

    Returns
    -------
    first : Array (m,)
        Index of the first sample of each possible burst.
    size : Array (m,)
        Least difference of its samples from the straight line between both sides, in the unit of the signal. It exceeds
        ``least`` and three times the difference between both sides.
    """
    before, after = value[: -length - 1], value[length + 1 :]
    duration = t[length + 1 :] - t[: -length - 1]
    sides = _wrapped_difference(name, after, before)
    size = np.full(before.size, np.inf)
    for k in range(1, length + 1):
        inside = slice(k, k + before.size)
        part = (t[inside] - t[: -length - 1]) / np.maximum(duration, 1e-9)
        size = np.minimum(size, np.abs(_wrapped_difference(name, value[inside], before + part * sides)))
    there = (size > least) & (size > TIMES_SIDES * np.abs(sides)) & (duration <= span)
    starts = np.flatnonzero(there)
    return starts + 1, size[starts]


def _wrapped_difference(name: str, a: Array, b: Array) -> Array:
    """Return ``a - b`` (n,), wrapped to -pi..pi if ``name`` is that of an angle: ``psi``, ``phi`` or ``theta``.

    Any other name gives the plain difference.
    """
    return wrap(a - b, angle=name in ANGLES)


def _explained_by_command(c: Channel, bad: Mask, command: Channel) -> Mask:
    """Return which outliers of a shaft speed are explained by a change of its command in the second before, (n,).

    Parameters
    ----------
    c
        The shaft speed.
    bad
        True (n,) for its outliers.
    command
        Command of the same thruster.

    Returns
    -------
    Array (n,)
        True for outliers that differ from the interpolated good samples by less than twice the range of the command
        within `COMMANDED_S` (1 s) before them. False for all other samples.
    """
    explained = np.zeros(bad.size, bool)
    typical = np.interp(c.t, c.t[~bad], c.value[~bad]) if not bad.all() else c.value
    for k in np.flatnonzero(bad).tolist():
        inside = (command.t >= c.t[k] - COMMANDED_S) & (command.t <= c.t[k])
        change = float(np.ptp(command.value[inside])) if inside.any() else 0.0
        explained[k] = change > 0.5 * abs(float(c.value[k] - typical[k]))
    return explained


def position_jumps(t: Array, x: Array, y: Array) -> NDArray[np.intp]:
    """Return the samples at which the position jumps: moves by more than 30 m and faster than 40 m/s.

    Parameters
    ----------
    t
        Times (n,) [s].
    x, y
        Position north and east (n,) [m].

    Returns
    -------
    Array (n_jumps,)
        Index of the first sample after each jump, in ascending order. Empty without a jump.
    """
    moved = np.hypot(np.diff(x), np.diff(y))
    return np.flatnonzero((moved > JUMP) & (moved > FASTEST * np.diff(t))) + 1


def sections_elsewhere(t: Array, x: Array, y: Array, regular: Mask) -> Mask:
    """Return which fixes of a GNSS receiver belong to a short section at another place, from a jump to the jump back.

    Parameters
    ----------
    t
        Times (n,) [s].
    x, y
        Position north and east (n,) [m].
    regular
        True (n,) for fixes to consider, False for outliers that are already known.

    Returns
    -------
    Array (n,)
        True for fixes between a jump and the jump back to a reachable place within 60 s, and for fixes at the start
        before the receiver has settled: before the last unpaired jump in the first 60 s, or the first fifth of the log
        if this is shorter. All False if the number of jumps exceeds 2 % of the fixes plus two, since the unit or the
        column is then wrong.
    """
    bad = np.zeros(t.size, bool)
    rows = np.flatnonzero(regular)
    t, x, y = t[rows], x[rows], y[rows]
    jumps = position_jumps(t, x, y).tolist()
    if len(jumps) > 0.02 * t.size + 2:
        return bad  # another unit or another column
    k = 0
    while k < len(jumps):
        first = jumps[k]
        back = next(
            (j for j in jumps[k + 1 :] if t[j] - t[first - 1] <= AWAY and _is_reachable(t, x, y, first - 1, j)), None
        )
        if back is not None:
            bad[rows[first:back]] = True
            k = jumps.index(back) + 1
            continue
        k += 1
    left = [j for j in jumps if not bad[rows[j]] and not bad[rows[j - 1]]]
    # A receiver whose first fixes are far away settles within the first part of the log.
    start = [j for j in left if t[j] - t[0] <= min(START, 0.2 * (t[-1] - t[0]))]
    if start:
        bad[rows[: max(start)]] = True
    return bad


def _is_reachable(t: Array, x: Array, y: Array, i: int, j: int) -> bool:
    """Return whether a craft can move from the fix with index ``i`` to that with index ``j``.

    It can move less than 30 m in any time, and farther with less than 5 m/s on average. ``t`` (n,) [s], ``x``, ``y``
    (n,) [m] are the times and positions of the fixes.
    """
    return bool(np.hypot(x[j] - x[i], y[j] - y[i]) < max(JUMP, 5.0 * (t[j] - t[i])))
