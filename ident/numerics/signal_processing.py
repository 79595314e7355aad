"""Signal processing without domain: angles, first-order lags and their fit, steady segments, noise from differences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from seatrial.ident.numerics.linear_algebra import Array

Hold = Literal["forward", "backward"]
Start = Literal["zero", "steady"]
NORMAL_MAD = 1.4826  # standard deviation of a normal variable over its median absolute deviation
SECOND_DIFFERENCE = np.sqrt(6.0)  # standard deviation of y[k] - 2 y[k+1] + y[k+2] over that of white y: 1 + 4 + 1


def first_order_lag(f: Array, tau: float, dt: float, *, hold: Hold = "forward", start: Start = "zero") -> Array:
    """First-order low-pass x' = (f - x) / tau, exact for inputs that are held over each step.

    Parameters: f (n, ...) input, time along the first axis; tau [s] time constant, zero or more; dt [s] step; hold:
    ``forward``, f[k] is held from row k to the next, so that x[k] depends on f up to row k - 1, or ``backward``, f[k]
    is held over the step that ends in row k; start: at rest at ``zero``, or ``steady``, with x[0] = f[0].
    Returns: x (n, ...).
    """
    from scipy.signal import lfilter  # a second of import, which an estimate can do without

    keep = np.exp(-dt / tau) if tau > 0.0 else 0.0
    b = [0.0, 1.0 - keep] if hold == "forward" else [1.0 - keep]
    if start == "zero":
        return np.asarray(lfilter(b, [1.0, -keep], f, axis=0))
    initial = f[:1] if hold == "forward" else keep * f[:1]
    return np.asarray(lfilter(b, [1.0, -keep], f, axis=0, zi=initial)[0])


class LagData(NamedTuple):
    """What one recording says of a delay and a lag.

    f (n,): input, evenly sampled; misfit: of the lagged input (n,) and the delay [s] at which it is to be sampled.
    """

    f: Array
    misfit: Callable[[Array, float], float]


class LagFit(NamedTuple):
    """delay [s], time_constant [s], and the misfit there, of all recordings together."""

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
    """Delay and time constant of a first-order response, by grid search: a search from one start stops at a slow lag
    where the delay is long.

    Parameters: data: recordings whose misfits add up; delays, time_constants [s]: the grid; dt [s]: step of the inputs;
    hold, start: as in `first_order_lag`.
    Returns: the least misfit; of equal ones the first time constant, then the first delay.
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
    """A signal is ``level`` from ``start`` to ``end`` [s]."""

    start: float
    end: float
    level: float

    @property
    def duration(self) -> float:
        """[s]"""
        return self.end - self.start


def steady_segments(t: Array, value: Array, end: float) -> list[SteadySegment]:
    """The segments over which a signal that is held between its samples does not change.

    Parameters: t (n,) [s], value (n,): the samples; end [s]: until when the last one is held.
    """
    first = np.flatnonzero(np.diff(value, prepend=np.nan) != 0)
    limits = [*t[first].tolist(), end]
    return [SteadySegment(a, b, level) for (a, b), level in zip(pairwise(limits), value[first].tolist(), strict=True)]


def noise_from_differences(second_differences: Array) -> float:
    """Standard deviation of white noise from the second differences (n,) of a smooth signal, robust against outliers:
    their median absolute value as it is of a normal variable; zero where there are none."""
    if not second_differences.size:
        return 0.0
    return float(NORMAL_MAD * float(np.median(np.abs(second_differences))) / SECOND_DIFFERENCE)


GRID_FEWEST, GRID_NEAR = 12, 0.05  # steps that tell a grid, and how near to whole ones each is, relative to one


def rounding_step(value: Array) -> float:
    """Step of the grid that all values (n,) but zero are on, as a message of integers has them; zero where there is
    none. (What was cut towards zero is told as the middle of its step, and zero as it is.)

    Values on no grid pass by chance with a probability of ``(2 GRID_NEAR)^GRID_FEWEST``.
    """
    steps = np.diff(np.unique(value[np.isfinite(value) & (value != 0.0)]))
    steps = steps[steps > 1e-6 * steps.sum()]  # what is the same but for the last digits
    if steps.size < GRID_FEWEST:
        return 0.0
    whole = np.round(steps / steps.min())
    step = float(steps.sum() / whole.sum())
    return step if np.all(np.abs(steps / step - np.round(steps / step)) < GRID_NEAR) else 0.0


def wrap(e: Array, angle: bool) -> Array:
    """Differences e (...) of an ``angle`` [rad] within -pi and pi; other differences as they are."""
    return np.mod(e + np.pi, 2 * np.pi) - np.pi if angle else e
