"""GNSS outages along a record: predicted position error at their end, and the error against withheld fixes."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import pi

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.navigation.navigator import Navigation
from seatrial.ident.numerics import Array

CONFIDENCE = 0.95
CHI2 = -2.0 * np.log(1.0 - CONFIDENCE)  # quantile of two degrees of freedom
MIN_INTERVALS = 3.0  # usual intervals between fixes: a longer gap is an outage
MIN_DURATION = 2.0  # s of an outage
N_ANGLES = 720


@dataclass(frozen=True)
class Ellipse:
    """95 % confidence ellipse of a position.

    Attributes:
        major, minor: semi-axes [m].
        azimuth: of the major axis [rad from north, 0..pi).
        radius: [m] of the 95 % circle about the centre.
    """

    major: float
    minor: float
    azimuth: float
    radius: float


@dataclass(frozen=True)
class OutageErrors:
    """Errors of the estimates against the withheld fixes.

    Attributes:
        rms, largest: root mean square and largest distance [m].
        inside: empirical coverage of the 95 % regions (measurement noise of the fix included).
        n: number of fixes.
    """

    rms: float
    largest: float
    inside: float
    n: int


@dataclass(frozen=True)
class Outage:
    """One outage, from the last fix before it, or the first row, to the first fix after it, or to the last row
    (``open``).

    Attributes:
        start, end: s.
        leading: no fix came before it, so that what is predicted for its end is a guess.
        withheld: fixes were withheld on purpose.
        north, east: position [m] that the filter predicts for the end without GNSS.
        at_end: confidence ellipse of that prediction.
        error: distance [m] of the prediction from the fix at the end, or from the last withheld fix where none follows.
        allowed: 95 % radius [m] of that distance, measurement noise of the fix included.
        inside: whether the fix is inside that region.
        widest: largest 95 % radius [m] within the outage, by the best estimate.
        predicted, best: errors on the withheld fixes, of the filter prediction and of the best estimate; None where
            nothing was withheld.
    """

    start: float
    end: float
    open: bool
    leading: bool
    withheld: bool
    north: float
    east: float
    at_end: Ellipse
    error: float | None
    allowed: float | None
    inside: bool | None
    widest: float
    predicted: OutageErrors | None
    best: OutageErrors | None

    @property
    def duration(self) -> float:
        return self.end - self.start


def ellipse(P: Array) -> Ellipse:
    """Confidence ellipse of a covariance (2, 2) [m2], north and east."""
    w, V = np.linalg.eigh(P)
    small, large = np.sqrt(np.maximum(w, 0.0))
    north, east = V[:, 1]
    major, minor = np.sqrt(CHI2) * large, np.sqrt(CHI2) * small
    return Ellipse(
        float(major), float(minor), float(np.arctan2(east, north) % pi), circular_error(float(large), float(small))
    )


def circular_error(large: float, small: float) -> float:
    """Radius of the circle that holds 95 % of a bivariate normal error with these standard deviations along its axes.

    A sample is ``rho (s1 cos(phi), s2 sin(phi))`` with rho^2 chi-squared of two degrees of freedom and phi
    uniform, so the share within r is the mean of ``1 - exp(-r^2 k / 2)``, ``1 / k = s1^2 cos^2 + s2^2 sin^2``; solved
    by bisection between the radii of a degenerate and of a circular distribution.
    """
    if large <= 0.0:
        return 0.0
    phi = (np.arange(N_ANGLES) + 0.5) * (pi / N_ANGLES)
    k = 1.0 / ((large * np.cos(phi)) ** 2 + (small * np.sin(phi)) ** 2)
    low, high = 1.9 * large, 2.5 * large
    for _ in range(40):
        r = (low + high) / 2
        share = 1.0 - np.exp(-0.5 * r * r * k).mean()
        low, high = (r, high) if share < CONFIDENCE else (low, r)
    return float(high)


def gnss_outages(navigation: Navigation) -> list[Outage]:
    """Every interval without a used position longer than three usual intervals (and two seconds), in order."""
    used = np.flatnonzero(navigation.used)
    t = navigation.t
    usual = float(np.median(np.diff(t[np.isfinite(navigation.fixes[:, 0])]))) if used.size > 1 else 0.0
    least = max(MIN_INTERVALS * usual, MIN_DURATION)
    marks = np.unique([0, *used, len(t) - 1])
    view = _View(navigation)
    return [view.outage(int(a), int(b), not navigation.used[b]) for a, b in pairwise(marks) if t[b] - t[a] > least]


class _View:
    """Positions with their covariances, computed once."""

    def __init__(self, navigation: Navigation) -> None:
        self.of = navigation
        self.predicted, self.best = (navigation.position(e) for e in (navigation.predicted, navigation.best))

    def outage(self, first: int, last: int, is_open: bool) -> Outage:
        """Between the rows of two fixes, from the first row to a fix, or from a fix to the last row."""
        n, t = self.of, self.of.t
        lost = first + np.flatnonzero(n.withheld[first : last + 1])
        judged = last if not is_open else int(lost[-1]) if lost.size else None
        error, allowed, inside = None, None, None
        if judged is not None:
            distance, within = self._misses(self.predicted, np.array([judged]))
            error, inside = float(distance[0]), bool(within[0])
            allowed = ellipse(self.predicted[1][judged] + np.diag(n.fix_variance)).radius
        inner = self.best[1][first : last + 1]
        widest = inner[int(np.argmax(np.trace(inner, axis1=1, axis2=2)))]
        north, east = self.predicted[0][last].tolist()
        leading = not n.used[first]
        return Outage(
            float(t[first]),
            float(t[last]),
            is_open,
            leading,
            bool(lost.size),
            north,
            east,
            ellipse(self.predicted[1][last]),
            error,
            allowed,
            inside,
            ellipse(widest).radius,
            self._summary(self.predicted, lost),
            self._summary(self.best, lost),
        )

    def _misses(self, estimate: tuple[Array, Array], rows: NDArray[np.intp]) -> tuple[Array, NDArray[np.bool_]]:
        e = estimate[0][rows] - self.of.fixes[rows]
        S = estimate[1][rows] + np.diag(self.of.fix_variance)
        distance = np.einsum("ki,ki->k", e, np.linalg.solve(S, e[:, :, None])[:, :, 0])
        return np.hypot(e[:, 0], e[:, 1]), distance <= CHI2

    def _summary(self, estimate: tuple[Array, Array], rows: NDArray[np.intp]) -> OutageErrors | None:
        if not rows.size:
            return None
        distance, within = self._misses(estimate, rows)
        return OutageErrors(
            float(np.sqrt(np.mean(distance**2))), float(distance.max()), float(within.mean()), rows.size
        )
