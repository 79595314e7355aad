"""GNSS outages along a record: predicted position error at the end of each, and errors against withheld fixes."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import pi

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.navigation.navigator import Navigation
from seatrial.ident.numerics import Array

CONFIDENCE = 0.95
CHI2 = -2.0 * np.log(1.0 - CONFIDENCE)  # chi-squared quantile of two degrees of freedom
MIN_INTERVALS = 3.0  # median intervals between fixes; an outage is longer
MIN_DURATION = 2.0  # s; an outage is longer
N_ANGLES = 720  # quadrature points over half a turn


@dataclass(frozen=True)
class Ellipse:
    """95 % confidence ellipse of a position.

    Attributes
    ----------
    major, minor : float
        Semi-axes [m].
    azimuth : float
        Direction of the major axis [rad clockwise from north, 0..pi).
    radius : float
        Radius [m] of the circle about the same centre that contains the position with a probability of 95 %.
    """

    major: float
    minor: float
    azimuth: float
    radius: float


@dataclass(frozen=True)
class OutageErrors:
    """Errors of the estimated positions against the GNSS fixes that were withheld from the filter during an outage.

    Attributes
    ----------
    rms, largest : float
        Root mean square and largest distance from the fixes [m].
    inside : float
        Share of the fixes inside the 95 % ellipses, 0..1; the ellipses include the measurement noise of a fix.
    n : int
        Number of fixes.
    """

    rms: float
    largest: float
    inside: float
    n: int


@dataclass(frozen=True)
class Outage:
    """One GNSS outage, from the last position fix before it to the first fix after it, with the errors of the position.

    The outage starts at the first row of the record if no fix precedes it, and ends at the last row if no fix follows.

    Attributes
    ----------
    start, end : float
        Times [s].
    open : bool
        Whether no fix follows.
    leading : bool
        Whether no fix precedes; the position predicted for the end then depends on the initial state alone.
    withheld : bool
        Whether fixes within the outage exist but were withheld from the filter on purpose.
    north, east : float
        Position at the end [m], predicted by the filter without GNSS.
    at_end : Ellipse
        95 % confidence ellipse of this position.
    error : float or None
        Distance of the predicted position from the fix at the end [m], or from the last withheld fix if no fix
        follows. None without either.
    allowed : float or None
        95 % radius of this distance [m], with the measurement noise of the fix; None without such a fix.
    inside : bool or None
        Whether ``error`` is at most ``allowed``; None without such a fix.
    widest : float
        95 % radius of the best estimate [m] at the row within the outage at which its variance is largest.
    predicted, best : OutageErrors or None
        Errors of the filter's prediction and of the best estimate against the withheld fixes; None without any.
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
        """Duration of the outage [s], from its start to its end."""
        return self.end - self.start


def ellipse(P: Array) -> Ellipse:
    """Return the 95 % confidence ellipse of a position with the covariance ``P`` (2, 2) [m2] of north and east.

    The semi-axes are the principal standard deviations times 2.45. Negative eigenvalues, from rounding, count as zero.
    """
    w, V = np.linalg.eigh(P)
    small, large = np.sqrt(np.maximum(w, 0.0))
    north, east = V[:, 1]
    major, minor = np.sqrt(CHI2) * large, np.sqrt(CHI2) * small
    return Ellipse(
        float(major), float(minor), float(np.arctan2(east, north) % pi), circular_error(float(large), float(small))
    )


def circular_error(large: float, small: float) -> float:
    """Return the radius of the circle that contains 95 % of a bivariate normal error.

    Parameters
    ----------
    large, small : float
        Standard deviations along the principal axes [m]; ``large`` is not smaller than ``small``.

    Returns
    -------
    float
        Radius [m], 1.96 to 2.45 times ``large``; 0 if ``large`` is not positive.

    Notes
    -----
    An error is ``rho (s1 cos(phi), s2 sin(phi))``, with rho^2 chi-squared of two degrees of freedom and phi uniform.
    The probability inside a radius r is the mean over phi of ``1 - exp(-r^2 k / 2)`` with
    ``1 / k = s1^2 cos^2(phi) + s2^2 sin^2(phi)``. Bisection solves this for r.
    """
    if large <= 0.0:
        return 0.0
    phi = (np.arange(N_ANGLES) + 0.5) * (pi / N_ANGLES)
    k = 1.0 / ((large * np.cos(phi)) ** 2 + (small * np.sin(phi)) ** 2)
    low, high = 1.9 * large, 2.5 * large  # beyond the radii for small = 0 (1.96) and small = large (2.45)
    for _ in range(40):
        r = (low + high) / 2
        share = 1.0 - np.exp(-0.5 * r * r * k).mean()
        low, high = (r, high) if share < CONFIDENCE else (low, r)
    return float(high)


def gnss_outages(navigation: Navigation) -> list[Outage]:
    """Return the GNSS outages of a record in order of time, with the position error of each.

    An outage is an interval between two fixes that the filter used. It is longer than three median intervals between
    all fixes, withheld ones included (with fewer than two used fixes this limit is zero), and longer than 2 s. The
    intervals before the first and after the last used fix count as outages if they are as long. Withheld fixes are not
    used, so that an interval in which all fixes are withheld is an outage.
    """
    used = np.flatnonzero(navigation.used)
    t = navigation.t
    median = float(np.median(np.diff(t[np.isfinite(navigation.fixes[:, 0])]))) if used.size > 1 else 0.0
    least = max(MIN_INTERVALS * median, MIN_DURATION)
    marks = np.unique([0, *used, len(t) - 1])
    evaluation = _OutageEvaluator(navigation)
    return [
        evaluation.outage(int(a), int(b), not navigation.used[b]) for a, b in pairwise(marks) if t[b] - t[a] > least
    ]


class _OutageEvaluator:
    """Evaluator of the outages of one record, which computes the antenna positions once for all outages.

    Attributes
    ----------
    navigation
        Result of the navigation along the record.
    predicted, best
        Positions (n_rows, 2) [m] and their covariances (n_rows, 2, 2) [m2]: one-step predictions, and best estimates
        (smoothed or filtered).
    """

    def __init__(self, navigation: Navigation) -> None:
        """Compute the antenna positions of the prediction and of the best estimate for all rows of the record."""
        self.navigation = navigation
        self.predicted, self.best = (navigation.position(e) for e in (navigation.predicted, navigation.best))

    def outage(self, first: int, last: int, is_open: bool) -> Outage:
        """Evaluate the outage between two rows of the record: its ellipse, and its errors where fixes exist.

        The position predicted for the row ``last`` is compared with the fix in this row. In an open outage it is
        the prediction for the last withheld fix that is compared, or none if no fix was withheld. Withheld fixes count
        from ``first`` to ``last``, both included. The outage is leading (without a fix before it) if the row ``first``
        has no used fix.

        Parameters
        ----------
        first, last
            Indices of the rows at the start and at the end of the outage.
        is_open
            Whether no fix follows the outage: the row ``last`` has no used fix.
        """
        n, t = self.navigation, self.navigation.t
        withheld = first + np.flatnonzero(n.withheld[first : last + 1])
        # row of the fix that the prediction is compared with
        compared = last if not is_open else int(withheld[-1]) if withheld.size else None
        error, allowed, inside = None, None, None
        if compared is not None:
            error = float(np.hypot(*(self.predicted[0][compared] - n.fixes[compared])))
            allowed = ellipse(self.predicted[1][compared] + np.diag(n.fix_variance)).radius
            inside = error <= allowed
        inner = self.best[1][first : last + 1]
        widest = inner[int(np.argmax(np.trace(inner, axis1=1, axis2=2)))]
        north, east = self.predicted[0][last].tolist()
        leading = not n.used[first]
        return Outage(
            float(t[first]),
            float(t[last]),
            is_open,
            leading,
            bool(withheld.size),
            north,
            east,
            ellipse(self.predicted[1][last]),
            error,
            allowed,
            inside,
            ellipse(widest).radius,
            self._errors_at_fixes(self.predicted, withheld),
            self._errors_at_fixes(self.best, withheld),
        )

    def _distances_from_fixes(
        self, estimate: tuple[Array, Array], rows: NDArray[np.intp]
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Compare estimated positions with the fixes of some rows.

        Parameters
        ----------
        estimate
            Positions (n_rows, 2) [m] and their covariances (n_rows, 2, 2) [m2].
        rows
            Indices (n,) of rows with a fix.

        Returns
        -------
        tuple of Array (n,)
            Distances from the fixes [m], and whether the fixes are inside or on the 95 % ellipses. The ellipses include
            the measurement noise of a fix. The order is that of ``rows``.
        """
        e = estimate[0][rows] - self.navigation.fixes[rows]
        S = estimate[1][rows] + np.diag(self.navigation.fix_variance)
        mahalanobis = np.einsum("ki,ki->k", e, np.linalg.solve(S, e[:, :, None])[:, :, 0])  # squared distance
        return np.hypot(e[:, 0], e[:, 1]), mahalanobis <= CHI2

    def _errors_at_fixes(self, estimate: tuple[Array, Array], rows: NDArray[np.intp]) -> OutageErrors | None:
        """Return the errors of the estimated positions against the fixes of some rows; None without rows.

        ``estimate``: positions (n_rows, 2) [m] and their covariances (n_rows, 2, 2) [m2]. ``rows``: indices (n,) of
        rows with a fix.
        """
        if not rows.size:
            return None
        distance, within = self._distances_from_fixes(estimate, rows)
        return OutageErrors(
            float(np.sqrt(np.mean(distance**2))), float(distance.max()), float(within.mean()), rows.size
        )
