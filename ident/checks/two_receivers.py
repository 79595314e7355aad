"""Check for two receivers of unequal rate in one signal: some fixes, at regular intervals, lie beside the others.

The fixes of a short window are explained by two parallel curves, a cubic polynomial in time and the same with an
offset. Two receivers are there if the curves are clearly apart, and if the fixes of each curve come at regular times.
Receivers of equal rate are found by `seatrial.ident.checks.signals.check_alternating`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.numerics import Array

WINDOWS = (24, 48, 96)  # fixes in a window; a rare second receiver needs a long one, a turning craft a short one
MOST_WINDOWS = 60  # of one length, spread over the log
LONGEST_WINDOW = 3.0  # in the usual duration of so many fixes; a longer window contains a pause
FEWEST_OF_EACH = 3  # fixes of each receiver in a window
# Least distance of the curves, in standard deviations of the fixes around them. Noise reaches 3.5, a sawtooth 5.1.
APART = 5.5
LEAST_OFFSET = 0.1  # m, least distance of the curves
STEPS_OF_RESOLUTION = 3.0  # least distance of the curves in steps of the resolution
REGULAR = 0.4  # largest standard deviation of the intervals of one receiver over their mean; random intervals have 1
ALONE = 0.8  # least share of the rarer fixes that follow a fix of the other receiver
ON_CHORDS = 0.3  # of the distance of the curves; fixes nearer to the chords of the others are interpolated
SIDEWAYS = 0.3  # share of the offset across the track, below which a wrong time may explain it
LEAST_SHARE = 0.5  # of the windows that show two receivers
POLYNOMIAL = 3  # degree of the track within a window
N_REFINED = 10  # repetitions of the robust fit and of the assignment


class SecondReceiver(NamedTuple):
    """Second receiver in a signal.

    Attributes
    ----------
    share : float
        Part of the fixes that are of the rarer receiver, above 0 and at most 0.5.
    offset : float
        Median distance [m] of the tracks of both receivers.
    """

    share: float
    offset: float


def second_receiver(t: Array, x: Array, y: Array) -> SecondReceiver | None:
    """Return the second, rarer receiver whose fixes are among those of another one; None if there is none.

    Parameters
    ----------
    t
        Times of the fixes (n,) [s], never decreasing.
    x, y
        Position (n,) [m]. A fix that repeats the position before is ignored.

    Notes
    -----
    The fixes are examined in windows of 24, 48 and 96 fixes, at most 60 of each length. A second receiver is reported
    if, for one of these lengths, at least three windows and half of the examined windows show two receivers.
    """
    new = np.append(True, (np.diff(x) != 0.0) | (np.diff(y) != 0.0))
    t, place = t[new], np.column_stack([x[new], y[new]])
    resolution = max(_resolution(place[:, 0]), _resolution(place[:, 1]))
    for length in WINDOWS:
        starts = np.arange(0, t.size - length + 1, length)
        if starts.size > MOST_WINDOWS:
            starts = starts[np.linspace(0, starts.size - 1, MOST_WINDOWS).astype(int)]
        usual = float(np.median(np.diff(t))) * length if t.size > 1 else 0.0
        windows = [slice(k, k + length) for k in starts.tolist()]
        windows = [w for w in windows if 0.0 < t[w][-1] - t[w][0] < LONGEST_WINDOW * usual]
        both: list[SecondReceiver] = []
        for n_left, w in zip(range(len(windows) - 1, -1, -1), windows, strict=True):
            if (row := _second_receiver_in_window(t[w], place[w], resolution)) is not None:
                both.append(row)
            if len(both) + n_left < LEAST_SHARE * len(windows):  # too few, whatever the other windows show
                break
        if len(both) >= FEWEST_OF_EACH and len(both) >= LEAST_SHARE * len(windows):
            return SecondReceiver(*(float(v) for v in np.median(np.array(both), axis=0)))
    return None


def _resolution(value: Array) -> float:
    """Return the least difference between two different values of a signal (n,); 0 for fewer than two.

    Differences up to 1e-6 are rounding errors and do not count.
    """
    steps = np.diff(np.unique(value))
    steps = steps[steps > 1e-6]  # smaller ones are rounding errors
    return float(steps.min()) if steps.size else 0.0


def _second_receiver_in_window(t: Array, place: Array, resolution: float) -> SecondReceiver | None:
    """Return the second receiver in one window of fixes; None if the fixes do not show two receivers.

    ``t``: times (n,) [s]. ``place``: positions (n, 2) [m]. ``resolution``: step [m] of the positions, 0 if unknown.
    """
    tau = 2.0 * (t - t[0]) / (t[-1] - t[0]) - 1.0
    track = np.vander(tau, POLYNOMIAL + 1)
    second = _two_clusters(_robust_residuals(track, place))
    for _ in range(N_REFINED):
        if not FEWEST_OF_EACH <= second.sum() <= second.size - FEWEST_OF_EACH:
            return None
        on = second[:, None].astype(float)
        # The offset of two antennas turns with the craft, so it changes over the window.
        rows = np.hstack([track, on, on * tau[:, None]])
        fitted = np.linalg.lstsq(rows, place, rcond=None)[0]
        first_track = track @ fitted[:-2]
        offset = fitted[-2] + np.outer(tau, fitted[-1])
        nearer = np.hypot(*(place - first_track - offset).T) < np.hypot(*(place - first_track).T)
        if np.array_equal(nearer, second):
            break
        second = nearer
    rarer = second if 2 * second.sum() <= second.size else ~second
    if rarer.sum() < FEWEST_OF_EACH:
        return None
    size = float(np.median(np.hypot(*offset.T)))
    around = place - rows @ fitted
    sigma = float(np.sqrt(np.sum(around**2) / (2 * (t.size - rows.shape[1]))))
    if size < max(LEAST_OFFSET, APART * sigma, STEPS_OF_RESOLUTION * resolution):
        return None
    # The fixes of the rarer receiver stand alone among those of the other one, and all over the window.
    n_groups = int(np.sum(rarer[1:] & ~rarer[:-1])) + int(rarer[0])
    if n_groups < ALONE * rarer.sum() or np.ptp(t[rarer]) < 0.5 * (t[-1] - t[0]):
        return None
    if not (_is_regular(t[rarer]) and _is_regular(t[~rarer])):
        return None
    if _is_resampled_track(t, place, rarer, size) or _explained_by_delay(t, fitted, tau, offset, size):
        return None
    return SecondReceiver(float(rarer.mean()), size)


def _robust_residuals(track: Array, place: Array) -> Array:
    """Return the residuals (n, 2) [m] of fixes from the polynomial in time with the least sum of distances.

    The polynomial follows the more frequent receiver. ``track`` (n, m): powers of time, ``place`` (n, 2) [m]: fixes.
    """
    weight = np.ones(len(place))
    for _ in range(2 * N_REFINED):
        root = np.sqrt(weight)[:, None]
        residuals: Array = place - track @ np.linalg.lstsq(root * track, root * place, rcond=None)[0]
        size = np.hypot(*residuals.T)
        weight = 1.0 / np.maximum(size, 1e-3 * float(size.max()) + 1e-9)
    return residuals


def _two_clusters(residuals: Array) -> NDArray[np.bool_]:
    """Divide residuals (n, 2) into two clusters at the widest gap along their main direction.

    Each cluster has at least three, of at least six residuals. The result (n,) is true for one cluster, which may be
    the larger one.
    """
    main = np.linalg.svd(residuals, full_matrices=False)[2][0]
    along = residuals @ main
    ordered = np.sort(along)
    inside = slice(FEWEST_OF_EACH - 1, ordered.size - FEWEST_OF_EACH)
    k = int(np.argmax(np.diff(ordered)[inside])) + FEWEST_OF_EACH - 1
    return np.asarray(along > 0.5 * (ordered[k] + ordered[k + 1]))


def _is_regular(t: Array) -> bool:
    """Return whether the standard deviation of the intervals of times (n,) [s] is at most 0.4 of their mean."""
    steps = np.diff(t)
    return bool(np.std(steps) <= REGULAR * np.mean(steps))


def _is_resampled_track(t: Array, place: Array, rarer: NDArray[np.bool_], size: float) -> bool:
    """Return whether the frequent fixes lie on the chords between the rarer ones: a resampled track of one receiver.

    ``t`` (n,) [s], ``place`` (n, 2) [m]: fixes. ``rarer`` (n,): true for the rarer ones. ``size``: distance [m] of the
    two curves. The result is false if no frequent fix lies between two rarer ones.
    """
    first, last = np.flatnonzero(rarer)[[0, -1]]
    between = ~rarer
    between[:first] = between[last:] = False
    if not between.any():
        return False
    chords = np.column_stack([np.interp(t[between], t[rarer], place[rarer, k]) for k in (0, 1)])
    return bool(np.median(np.hypot(*(place[between] - chords).T)) < ON_CHORDS * size)


def _explained_by_delay(t: Array, fitted: Array, tau: Array, offset: Array, size: float) -> bool:
    """Return whether a delay of some fixes explains the offset: along the track, and less than two intervals long.

    The fix of an epoch with more messages is often received later. ``t`` (n,): times [s]. ``tau`` (n,): the same times
    scaled to -1 to 1. ``fitted`` (m, 2): coefficients of the track, a cubic polynomial in tau, in its first four rows.
    ``offset`` (n, 2) [m]: distance of the two curves. ``size``: its median length [m].
    """
    powers = np.column_stack([3.0 * tau**2, 2.0 * tau, np.ones(tau.size)])
    velocity = powers @ fitted[:POLYNOMIAL] * 2.0 / (t[-1] - t[0])
    speed = np.maximum(np.hypot(*velocity.T), 1e-9)
    across = np.abs(offset[:, 0] * velocity[:, 1] - offset[:, 1] * velocity[:, 0]) / speed
    interval = (t[-1] - t[0]) / (t.size - 1)
    return bool(np.median(across) < SIDEWAYS * size and size < 2.0 * interval * float(np.median(speed)))
