"""Decimation of a signal for the screen: the smallest and the largest sample in each of a number of intervals of time.

No peak is lost, and every point that is shown is a sample of the log. Pauses of a sensor stay visible as gaps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# A pause is a gap if it is longer than 5 times the sample period that 9 of 10 periods do not exceed.
GAP_PERIODS, USUAL = 5.0, 0.9

Array = NDArray[np.float64]


class Curve(NamedTuple):
    """Points of a signal to draw.

    Attributes
    ----------
    t
        Times [s], shape (n,), ascending.
    value
        Values, shape (n,). NaN is a gap: the points on its two sides are not joined by a line.
    """

    t: Array
    value: Array


def longest_period(t: Array, values: Array) -> float:
    """Return the longest time [s] between two samples of a signal that is no gap.

    The result is five times the period that nine of ten periods do not exceed. The pauses between bursts of samples are
    therefore mostly no gaps. `t` are the times of the samples [s] and `values` their values, both of shape (n,).
    Samples without a finite value do not count. The result is infinite with fewer than three finite samples.
    """
    periods = np.diff(t[np.isfinite(values)])
    return GAP_PERIODS * float(np.quantile(periods, USUAL)) if len(periods) > 1 else np.inf


def decimate(t: Array, values: Array, begin: float, end: float, n_intervals: int, longest: float) -> Curve:
    """Return the points of a signal that represent it between two times on a screen.

    Parameters
    ----------
    t
        Times of the samples [s], shape (n,), not decreasing.
    values
        Values of the samples, shape (n,). Samples without a finite value are left out.
    begin, end
        Shown interval [s], both ends included. The nearest sample on each side of it is added, if its value is finite,
        so that a line reaches the edge of the screen.
    n_intervals
        Number of equal intervals of time, at least 1: about one for each pixel.
    longest
        Longest time between two samples that is no gap [s]; infinite for a signal without gaps.

    Returns
    -------
    Curve
        All samples, if there are at most 2 * `n_intervals` in all. Otherwise the first smallest and the first largest
        sample in each interval that has samples. An interval is also divided at a gap. Each gap is one point with the
        value NaN in its middle. With decimation, a gap shorter than an interval is not shown.
    """
    first = max(int(np.searchsorted(t, begin)) - 1, 0)
    last = int(np.searchsorted(t, end, side="right")) + 1
    t, values = t[first:last], values[first:last]
    finite = np.isfinite(values)
    if not finite.all():
        t, values = t[finite], values[finite]
    period = np.diff(t)
    if len(t) <= 2 * n_intervals:
        return _with_gaps(t, values, np.arange(len(t)), np.flatnonzero(period > longest) + 1)
    width = (end - begin) / n_intervals
    gaps = np.flatnonzero(period > max(longest, width)) + 1
    edges = np.searchsorted(t, begin + width * np.arange(n_intervals + 1))
    starts = np.unique(np.concatenate([[0], edges[edges < len(t)], gaps]))
    chosen = np.union1d(_first_equal(values, starts, np.minimum), _first_equal(values, starts, np.maximum))
    return _with_gaps(t, values, chosen, gaps)


def _first_equal(values: Array, starts: NDArray[np.intp], extreme: np.ufunc) -> NDArray[np.intp]:
    """Return the position of the first extreme value in each group of consecutive values, shape (n_groups,).

    `starts` are the positions at which the groups begin, in order, from 0 on. `extreme` is np.minimum or np.maximum.
    """
    sizes = np.diff(np.append(starts, len(values)))
    equal = np.flatnonzero(values == np.repeat(extreme.reduceat(values, starts), sizes))
    group = np.searchsorted(starts, equal, side="right")
    return equal[np.flatnonzero(np.diff(group, prepend=-1))]


def _with_gaps(t: Array, values: Array, chosen: NDArray[np.intp], gaps: NDArray[np.intp]) -> Curve:
    """Return the chosen samples as a curve, with a point of NaN in the middle of each gap.

    `chosen` are positions of samples, and `gaps` those of the first sample after each gap; both are in order.
    """
    places = np.searchsorted(chosen, gaps)
    gaps, places = gaps[places < len(chosen)], places[places < len(chosen)]
    middles = 0.5 * (t[gaps - 1] + t[gaps])
    return Curve(np.insert(t[chosen], places, middles), np.insert(values[chosen], places, np.nan))
