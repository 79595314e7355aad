"""Signal processing for any field: angles, first-order lags and their fit, steady segments, noise from differences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.numerics.linear_algebra import Array

Hold = Literal["forward", "backward"]
Start = Literal["zero", "steady"]
NORMAL_MAD = 1.4826  # ratio of standard deviation to median absolute deviation of a normal variable
SECOND_DIFFERENCE = np.sqrt(6.0)  # ratio of the standard deviation of y[k] - 2 y[k+1] + y[k+2] to that of white y


def first_order_lag(f: Array, tau: float, dt: float, *, hold: Hold = "forward", start: Start = "zero") -> Array:
    """Apply the first-order low-pass filter x' = (f - x) / tau, exactly for inputs that are held over each step.

    Parameters
    ----------
    f : Array (n, ...)
        Input, time along the first axis.
    tau
        Time constant [s], zero or more. For zero, x[k] is the input that is held over the step before row k.
    dt
        Step [s].
    hold
        ``forward``: f[k] is held from row k to the next, so that x[k] depends on f up to row k - 1. ``backward``: f[k]
        is held over the step that ends in row k.
    start
        ``zero``: the filter is at zero before the first input acts: x[0] = 0 for ``forward``, and one step before row 0
        for ``backward``. ``steady``: x[0] = f[0].

    Returns
    -------
    Array (n, ...)
        Output x.
    """
    # scipy.signal.lfilter does the same, but its import takes a second of processor time in each command.
    from scipy.linalg.lapack import dtbtrs

    keep = np.exp(-dt / tau) if tau > 0.0 else 0.0
    right = (1.0 - keep) * np.asarray(f, dtype=np.float64)
    if hold == "forward":
        right = np.concatenate([np.zeros_like(right[:1]), right[:-1]])
    if start == "steady":
        right[:1] = f[:1]
    # x[k] - keep x[k - 1] = right[k]
    bands = np.ones((2, len(right)))
    bands[1] = -keep
    if right.size == 0:
        return right
    solution, _ = dtbtrs(bands, right.reshape(len(right), -1), uplo="L")
    return np.asarray(solution).reshape(right.shape)


def welch_spectrum(x: Array, segment: int, y: Array | None = None) -> Array:
    """Return the one-sided power spectrum of x, or cross spectrum of x and y, by Welch's method.

    Parameters
    ----------
    x : Array (n,)
        Evenly sampled signal with at least ``segment`` samples.
    segment
        Number of samples of a segment. Segments overlap by half and have a Hann window.
    y : Array (n,), optional
        Second signal. The cross spectrum is the mean of ``conj(X) Y``, complex. None: the power spectrum of x, real.

    Returns
    -------
    Array (segment // 2 + 1,)
        Mean over the segments, without their means, per unit of the frequency in cycles per sample.

    Notes
    -----
    `scipy.signal.welch` and `csd` give the same numbers, but their import takes a second of processor time in each
    command.
    """
    window = np.sin(np.pi * np.arange(segment) / segment) ** 2

    def transformed(signal: Array) -> NDArray[np.complex128]:
        parts = np.lib.stride_tricks.sliding_window_view(signal, segment)[:: segment - segment // 2]
        return np.fft.rfft(window * (parts - parts.mean(axis=1, keepdims=True)), axis=1)

    first = transformed(x)
    product = np.abs(first) ** 2 if y is None else first.conj() * transformed(y)
    density = np.mean(product, axis=0) / np.sum(window**2)
    # Positive and negative frequencies together; the mean, and the highest frequency of an even segment, exist once.
    density[1 : (segment + 1) // 2] *= 2.0
    return np.asarray(density)


class LagData(NamedTuple):
    """One recording in the fit of a delay and a lag.

    Attributes
    ----------
    f : Array (n,)
        Input, evenly sampled.
    misfit
        Function of the lagged input (n,), which is not delayed yet, and a delay [s]. It delays the input and returns
        its misfit to the recording, for example the sum of squared errors.
    """

    f: Array
    misfit: Callable[[Array, float], float]


class LagFit(NamedTuple):
    """Fitted first-order response of all recordings together.

    Attributes
    ----------
    delay
        Pure delay [s].
    time_constant
        Time constant of the lag [s].
    misfit
        Sum of the misfits of all recordings.
    """

    delay: float
    time_constant: float
    misfit: float


def fit_first_order_lag(
    data: Sequence[LagData],
    delays: Sequence[float],
    time_constants: Sequence[float],
    dt: float,
    *,
    hold: Hold = "forward",
    start: Start = "zero",
) -> LagFit:
    """Fit delay and time constant of a first-order response by grid search.

    Parameters
    ----------
    data
        Recordings whose misfits are added.
    delays, time_constants
        The grid [s].
    dt
        Step of the inputs [s].
    hold
        ``forward``: an input is held from its row to the next. ``backward``: over the step that ends in its row.
    start
        ``zero``: the lag starts at zero. ``steady``: it starts at the first value of the input (`first_order_lag`).

    Returns
    -------
    LagFit
        The point with the least misfit; of equal ones, the first time constant, then the first delay. NaN with the
        misfit inf if no misfit is finite.

    Notes
    -----
    A search from a single start may end at a slow lag although the delay is long.
    """
    best = LagFit(float("nan"), float("nan"), np.inf)
    for tau in time_constants:
        lagged = [first_order_lag(d.f, tau, dt, hold=hold, start=start) for d in data]
        for delay in delays:
            total = sum(d.misfit(x, delay) for d, x in zip(data, lagged, strict=True))
            if total < best.misfit:
                best = LagFit(delay, tau, total)
    return best


class SteadySegment(NamedTuple):
    """A segment of time over which a signal is constant. The end is not part of it.

    Attributes
    ----------
    start, end
        Begin and end [s].
    level
        Value of the signal, in its unit.
    """

    start: float
    end: float
    level: float

    @property
    def duration(self) -> float:
        """Length of the segment [s]."""
        return self.end - self.start


def steady_segments(t: Array, value: Array, end: float) -> list[SteadySegment]:
    """Return the segments of time over which a signal that is held between its samples does not change, in order.

    Parameters
    ----------
    t : Array (n,)
        Times of the samples [s].
    value : Array (n,)
        The samples.
    end
        Time until which the last sample is held [s].

    Returns
    -------
    list
        Each segment ends where the next begins, the last one at ``end``. A NaN sample is a segment of its own. Empty
        without samples.
    """
    first = np.flatnonzero(np.diff(value, prepend=np.nan) != 0)
    limits = [*t[first].tolist(), end]
    return [SteadySegment(a, b, level) for (a, b), level in zip(pairwise(limits), value[first].tolist(), strict=True)]


def noise_from_differences(second_differences: Array) -> float:
    """Return the standard deviation of white noise from second differences of a smooth signal.

    It comes from their median absolute value and is robust against outliers.

    Parameters
    ----------
    second_differences : Array (n,)
        ``y[k] - 2 y[k+1] + y[k+2]`` of the signal.

    Returns
    -------
    float
        In the unit of the signal. Zero if there are no differences or if more than half of them are zero, NaN if one of
        them is NaN.
    """
    if not second_differences.size:
        return 0.0
    return float(NORMAL_MAD * float(np.median(np.abs(second_differences))) / SECOND_DIFFERENCE)


# Values are on a grid if there are at least so many differences, and each is a multiple of the step within this share.
GRID_FEWEST, GRID_NEAR = 12, 0.05


def rounding_step(value: Array) -> float:
    """Return the step of the grid on which all values except zero lie; zero if there is no grid.

    Parameters
    ----------
    value : Array (n,)
        The signal. NaN and inf are ignored, and so are zeros.

    Returns
    -------
    float
        In the unit of the signal. Zero also for fewer than 13 different values.

    Notes
    -----
    A message that transmits integers gives such values. A decoder may place values that were truncated towards zero in
    the middle of their step, but zero at zero; zeros are therefore ignored. Values without a grid pass by chance with a
    probability of ``(2 GRID_NEAR)^GRID_FEWEST``.
    """
    steps = np.diff(np.unique(value[np.isfinite(value) & (value != 0.0)]))
    steps = steps[steps > 1e-6 * steps.sum()]  # values that differ only by rounding are equal
    if steps.size < GRID_FEWEST:
        return 0.0
    whole = np.round(steps / steps.min())
    step = float(steps.sum() / whole.sum())
    return step if np.all(np.abs(steps / step - np.round(steps / step)) < GRID_NEAR) else 0.0


def wrap(e: Array, angle: bool) -> Array:
    """Return differences wrapped to -pi (included) to pi (excluded) if they are angles; others unchanged, uncopied.

    Parameters
    ----------
    e : Array (...)
        Differences; angles in rad.
    angle
        Whether they are angles.
    """
    return np.mod(e + np.pi, 2 * np.pi) - np.pi if angle else e


def cumulative_integral(t: Array, rate: NDArray[Any]) -> NDArray[Any]:
    """Return the integral of a rate over time from the first sample, by the trapezoidal rule.

    Parameters
    ----------
    t : Array (n,)
        Times [s], not necessarily evenly spaced.
    rate : array (n,), real or complex
        The rate.

    Returns
    -------
    array (n,)
        Integral from the first sample to each sample; 0 at the first. A NaN makes all later values NaN.
    """
    return np.append(np.zeros(1, rate.dtype), np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t)))
