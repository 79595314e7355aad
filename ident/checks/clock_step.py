"""Steps of the delay between sensors within a log, as of a device whose clock was set while the others ran on.

Theory of operation. The motion is predicted from the thrust as in `seatrial.ident.checks.latency`: increments of the
motion are regressed on integrals of the thrust and of the motion, for each lag of a search. Here the log is divided at
each of many times, and the part before and the part after it may have different lags. The coefficients of the motion
are common to both, because the boat is the same. The division with the least squared error is the step. Two regressions
are made:

- The yaw rate follows the thrust. A step means that the attitude or the thrust changed its delay.
- The surge and sway velocities, from the velocities or positions of a GNSS, follow thrust and heading. The velocity is
  moved against both. A step means that the GNSS changed its delay, unless the first regression has a step too.

The standard error of the step is that of the jackknife over groups of blocks of time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks import Finding
from seatrial.ident.checks.latency import (
    ATTITUDE,
    EVERY,
    HEADING_HALF,
    MIN_DURATION,
    MIN_R2,
    POSITION_HALF,
    SURGE_WINDOW,
    YAW_WINDOW,
    GridMotion,
    ThrustSignals,
    first_source,
    forward_and_reverse,
    increments_without_pause,
    mean_rate,
    motion_on_grid,
    thrust_at,
    thrust_signals,
)
from seatrial.ident.checks.sensors import SENSOR_GRID_S, STUDENT, Channels, delay_interval, delay_level
from seatrial.ident.data import seconds
from seatrial.ident.numerics import Array, cumulative_integral, ned_to_body

LAG_STEP, MAX_LAG = 0.2, 2.4  # s, of the search in both directions
LAGS = np.linspace(-MAX_LAG, MAX_LAG, 2 * round(MAX_LAG / LAG_STEP) + 1)
BLOCK_S = 10.0  # s; a step is placed at the end of a block
FEWEST_BLOCKS = 4  # of either part
GROUPS = 8  # of blocks in either part, for the jackknife
LEAST_STEP = 0.3  # s; smaller steps do not matter
# Standard errors, and the share of the squared error that the step removes. In 180 logs of sound boats no step inside
# the search reaches both 3 and 0.05; steps of 1 s have 13 and 0.18 at least.
CLEAR, LEAST_GAIN = 5.0, 0.1
LONGEST_INTERVAL_S = 0.6  # of positions or velocities; slower ones do not show the delay in a part of a log


class DelayStep(NamedTuple):
    """Step of a delay within a log.

    Attributes
    ----------
    t
        Time of the step [s], to within half a block of 10 s.
    before, after
        Delay [s] of the motion in both parts.
    se
        Standard error [s] of their difference.
    gain
        Share of the squared error with one delay that the step removes.
    r2
        Coefficient of determination of the regression with the step.
    """

    t: float
    before: float
    after: float
    se: float
    gain: float
    r2: float

    @property
    def is_clear(self) -> bool:
        """Whether the step matters and is no chance, and both delays are inside the search."""
        inside = max(abs(self.before), abs(self.after)) < MAX_LAG - LAG_STEP
        size = abs(self.after - self.before)
        return inside and size > max(LEAST_STEP, CLEAR * self.se) and self.gain > LEAST_GAIN and self.r2 > MIN_R2


class _Regression(NamedTuple):
    """Regression of increments of a motion on its regressors, one for each lag of the search.

    Attributes
    ----------
    t
        Times of the increments (n,) [s].
    rows
        Regressors and motion (n, k + 1) at each lag of the search.
    """

    t: Array
    rows: Sequence[Array]

    def products(self) -> Array:
        """Return the normal equations (n_lags, n_blocks, k + 1, k + 1), of each block of 10 s."""
        block = ((self.t - self.t[0]) / BLOCK_S).astype(int)
        edges = np.searchsorted(block, np.arange(block[-1] + 2))
        return np.array(
            [[rows[first:last].T @ rows[first:last] for first, last in pairwise(edges)] for rows in self.rows]
        )


def check_clock_step(c: Channels, sides: Mapping[str, float]) -> Iterator[Finding]:
    """Yield a finding if the delay of attitude, or of velocity and position, changes within a log.

    Parameters
    ----------
    c
        Channels of a log (`seatrial.ident.data.channels`). Without a heading or a thrust there is no finding.
    sides
        Position of each thruster to starboard [m]. Only its names are used.

    Yields
    ------
    Finding
        At most one ``clock-step``. It is a fault from 0.6 s on, or if its whole interval is above 0.2 s, else a
        warning.
    """
    push = thrust_signals(c, sides)
    if push is None or "psi" not in c:
        return
    start = min(float(x.t[0]) for x in c.values())
    turned, moved = first_source(c, ("r", "psi")), first_source(c, ("vx", "x"))
    of_gnss = " and ".join(name for name, key in (("positions", "x"), ("velocities", "vx")) if key in c)
    for regressions, signals, against, device, where in (
        (_yaw_regressions, ATTITUDE, "the thrust", f"{turned} or of the device of the thrust", turned),
        (_velocity_regressions, f"the {of_gnss} of the GNSS", "heading and thrust", "the GNSS", moved),
    ):
        step = _clearest_step(regressions(c, push))
        if step is not None and step.is_clear:
            late, half = step.after - step.before, STUDENT * step.se
            text = (
                f"from about {seconds(round(step.t - start, -1))} s of the log on, {signals} come {abs(late):.2f} s "
                f"{'later' if late > 0.0 else 'earlier'} than before, compared with {against} "
                f"({delay_interval(abs(late), half)})"
            )
            advice = (
                f"look for a step of the clock or a restart of {device} at that time, and for its time "
                "synchronisation; until this is mended, fit the parts before and after it apart (--from, --to)"
            )
            yield Finding(delay_level(abs(late), half), "clock-step", "late", where, text, advice)
            return


def _yaw_regressions(c: Channels, push: ThrustSignals) -> list[_Regression]:
    """Return the regression of the yaw rate on the thrust, or an empty list. The thrust is moved by the lags."""
    if not push.turning or (m := motion_on_grid(c, push.turning)) is None or np.std(m.r) < 1e-9:
        return []
    mean = _integral_of_mean(m.t, 0.0 if "r" in c else HEADING_HALF)
    terms = [m.r, m.r * np.abs(m.r), np.ones(m.t.size)]
    if m.u is not None and m.v is not None:
        terms += [m.u * m.v, m.u * m.r, m.v, m.r * np.abs(m.u)]
    pushes = [part for thrust in push.turning for part in forward_and_reverse(thrust_at(thrust, m.t))]
    width = round(YAW_WINDOW / SENSOR_GRID_S)
    at = _starts(c, m, width)
    if not pushes or at.size == 0:
        return []
    own, late = [mean(s) for s in terms], [mean(s) for s in pushes]
    rows = []
    for k in np.rint(LAGS / SENSOR_GRID_S).astype(int):
        columns = [*(s[at + width] - s[at] for s in own), *(s[at - k + width] - s[at - k] for s in late)]
        rows.append(np.column_stack([*columns, m.r[at + width] - m.r[at]]))
    return [_Regression(m.t[at], rows)]


def _velocity_regressions(c: Channels, push: ThrustSignals) -> list[_Regression]:
    """Return the regressions of surge and sway velocity on thrust and heading, or an empty list.

    The velocity over ground is moved by the lags against thrust and heading, before it is turned to the boat's axes.
    """
    names = ("vx", "vy") if {"vx", "vy"} <= set(c) else ("x", "y")
    if not push.ahead or not set(names) <= set(c) or np.median(np.diff(c[names[0]].t)) > LONGEST_INTERVAL_S:
        return []
    m = motion_on_grid(c, push.ahead)
    if m is None or m.psi is None:
        return []
    smooth = POSITION_HALF if names == ("x", "y") else 0.0
    mean, t = _integral_of_mean(m.t, smooth), m.t
    over_ground = [np.interp(t, c[n].t, c[n].value) for n in names]
    if smooth:
        over_ground = [mean_rate(s, smooth) for s in over_ground]
    pushes = forward_and_reverse(sum((thrust_at(thrust, t) for thrust in push.ahead), np.zeros(t.size)))
    width = round(SURGE_WINDOW / SENSOR_GRID_S)
    at = _starts(c, m, width)
    if not pushes or at.size == 0:
        return []
    fixed = [np.ones(t.size), np.cos(m.psi), np.sin(m.psi)]  # the last two: a current
    fixed_of = {"surge": [*fixed, m.r * m.r, *pushes], "sway": [*fixed, m.r]}
    fixed_rows = {axis: _increments([mean(s) for s in of_axis], at, width) for axis, of_axis in fixed_of.items()}
    rows: dict[str, list[Array]] = {axis: [] for axis in fixed_rows}
    for k in np.rint(LAGS / SENSOR_GRID_S).astype(int):
        u, v = ned_to_body(m.psi, *(np.roll(s, -k) for s in over_ground))  # the ends are not among the increments
        moving = {
            "surge": (u, [u, u * np.abs(u), v * m.r]),
            "sway": (v, [v, v * np.abs(v), v * np.abs(u), u * m.r, np.abs(u) * m.r]),
        }
        for axis, (y, terms) in moving.items():
            moved = _increments([*(mean(s) for s in terms), y], at, width)
            rows[axis].append(np.column_stack([fixed_rows[axis], moved]))
    return [_Regression(t[at], of_axis) for of_axis in rows.values()]


def _integral_of_mean(t: Array, half: float) -> Callable[[Array], Array]:
    """Return a function that integrates a signal over t (n,) [s], and its moving mean over ``half`` [s]."""

    def integral(s: Array) -> Array:
        whole = cumulative_integral(t, s)
        return cumulative_integral(t, mean_rate(whole, half)) if half else whole

    return integral


def _increments(signals: Sequence[Array], at: NDArray[np.intp], width: int) -> Array:
    """Return the increments (n, n_signals) of signals over ``width`` steps, from the indices ``at`` (n,) on."""
    return np.column_stack([s[at + width] - s[at] for s in signals])


def _starts(c: Channels, m: GridMotion, width: int) -> NDArray[np.intp]:
    """Return the first indices (n,) of the increments on the grid that touch neither a pause nor the ends.

    The result is empty if they cover less than 60 s.
    """
    margin = round((MAX_LAG + POSITION_HALF) / SENSOR_GRID_S)
    every = round(EVERY / SENSOR_GRID_S)
    at = np.arange(margin, m.t.size - margin - width, every)
    at = at[increments_without_pause(c, m.t, at, width)]
    return at if at.size * EVERY >= MIN_DURATION else at[:0]


def _clearest_step(regressions: Sequence[_Regression]) -> DelayStep | None:
    """Return the step with the least squared error, if it could be clear; else None.

    ``regressions`` are those of one motion at the same times. A step needs enough blocks of time before and after it.
    The standard error is computed only of a step that would be clear with any standard error.
    """
    products = [regression.products() for regression in regressions]
    n_blocks = products[0].shape[1] if products else 0
    if n_blocks < 2 * FEWEST_BLOCKS:
        return None
    sums = [np.cumsum(p, axis=1) for p in products]
    errors = {
        split: _errors_of_lags([(s[:, split - 1], s[:, -1] - s[:, split - 1]) for s in sums])
        for split in range(FEWEST_BLOCKS, n_blocks - FEWEST_BLOCKS + 1)
    }
    split = min(errors, key=lambda k: float(errors[k].min()))
    least, same = float(errors[split].min()), float(np.diag(errors[split]).min())
    total = sum(float(s[0, -1, -1, -1]) for s in sums)
    t = float(regressions[0].t[0]) + split * BLOCK_S
    step = DelayStep(t, *_best_lags(errors[split]), 0.0, 1.0 - least / same, 1.0 - least / total)
    if not step.is_clear:
        return None
    variance = 0.0
    for begin, end in ((0, split), (split, n_blocks)):
        groups = np.array_split(np.arange(begin, end), min(GROUPS, end - begin))
        sizes = []
        for group in groups:
            without = [p[:, group].sum(axis=1) * (-1.0) for p in products]
            parts = [
                (s[:, split - 1] + (w if begin == 0 else 0.0), s[:, -1] - s[:, split - 1] + (w if begin else 0.0))
                for s, w in zip(sums, without, strict=True)
            ]
            before, after = _best_lags(_errors_of_lags(parts))
            sizes.append(after - before)
        spread = np.array(sizes) - np.mean(sizes)
        variance += (len(groups) - 1) / len(groups) * float(spread @ spread)
    return step._replace(se=float(np.sqrt(variance)))


def _errors_of_lags(parts: Sequence[tuple[Array, Array]]) -> Array:
    """Return the squared error (n_lags, n_lags) for each lag before a step (rows) and after it (columns).

    ``parts`` are the normal equations (n_lags, k + 1, k + 1) of the part before and after, for each regression. Both
    parts have the same coefficients.
    """
    n = LAGS.size
    errors = np.zeros((n, n))
    for before, after in parts:
        both = (before[:, None] + after[None]).reshape(n * n, *before.shape[1:])
        k = both.shape[1] - 1
        scale = np.sqrt(np.maximum(np.einsum("mii->mi", both[:, :k, :k]), 1e-300))
        A = both[:, :k, :k] / scale[:, :, None] / scale[:, None, :] + 1e-9 * np.eye(k)
        b = both[:, :k, k] / scale
        explained = np.sum(b * np.linalg.solve(A, b[..., None])[..., 0], axis=1)
        errors += (both[:, k, k] - explained).reshape(n, n)
    return errors


def _best_lags(errors: Array) -> tuple[float, float]:
    """Return the lags [s] before and after a step of the least squared error (n_lags, n_lags), refined."""
    i, j = (int(k) for k in np.unravel_index(int(np.argmin(errors)), errors.shape))
    return _refined(errors[:, j], i), _refined(errors[i], j)


def _refined(error: Array, k: int) -> float:
    """Return the lag [s] of the least squared error (n_lags,) near the index k, refined by a parabola."""
    if not 0 < k < error.size - 1:
        return float(LAGS[k])
    bend = float(error[k - 1] - 2.0 * error[k] + error[k + 1])
    return float(LAGS[k]) + (0.5 * LAG_STEP * float(error[k - 1] - error[k + 1]) / bend if bend > 0.0 else 0.0)
