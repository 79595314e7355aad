"""GNSS outages of a navigated record: how far off the position may be at their end, and how far off it was."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import pi

import numpy as np
from numpy.typing import NDArray

from ident.navigation.navigator import Navigation
from ident.numerics import Array

SHARE = 0.95
CHI2 = -2.0 * np.log(1.0 - SHARE)  # of two degrees of freedom
MISSED = 3.0  # usual intervals between fixes, beyond which a gap is an outage
SHORTEST = 2.0  # s
N_ANGLES = 720


@dataclass(frozen=True)
class Ellipse:
    """Holds the position with 95 %. major, minor: half axes [m]; azimuth of the major one [rad from north, 0..pi);
    radius [m] of the circle about the middle that holds as much."""

    major: float
    minor: float
    azimuth: float
    radius: float


@dataclass(frozen=True)
class OutageErrors:
    """Estimates less the fixes that were withheld: root mean square and largest distance [m], the part of them within
    the 95 % regions (with the fix's own noise), and how many fixes."""

    rms: float
    largest: float
    inside: float
    n: int


@dataclass(frozen=True)
class Outage:
    """From the last fix before (``start``) to the first one after (``end``) [s], or to the last row (``open``).

    north, east [m]: what the filter predicts for the end without GNSS, as the GNSS would have it; at_end: how sure it
    claims to be. error [m]: its distance from the fix at the end, or from the last one withheld where none came after;
    allowed [m]: the 95 % radius of that distance, the fix's own noise included; inside: within that region. widest:
    the largest 95 % radius within the outage by the best estimate. predicted, best: on the withheld fixes, by the
    filter without those to come and by the best estimate; None where nothing was withheld.
    """

    start: float
    end: float
    open: bool
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
    """Of a covariance (2, 2) [m2], north and east."""
    w, V = np.linalg.eigh(P)
    small, large = np.sqrt(np.maximum(w, 0.0))
    north, east = V[:, 1]
    major, minor = np.sqrt(CHI2) * large, np.sqrt(CHI2) * small
    return Ellipse(
        float(major), float(minor), float(np.arctan2(east, north) % pi), circular_error(float(large), float(small))
    )


def circular_error(large: float, small: float) -> float:
    """Radius that holds 95 % of a normal error in the plane with these standard deviations along its axes.

    A point of the cloud is ``rho (s1 cos(phi), s2 sin(phi))`` with rho^2 chi-squared of two degrees of freedom and phi
    uniform, so the share within r is the mean of ``1 - exp(-r^2 k / 2)``, ``1 / k = s1^2 cos^2 + s2^2 sin^2``; solved
    by bisection between the line's radius and the round cloud's.
    """
    if large <= 0.0:
        return 0.0
    phi = (np.arange(N_ANGLES) + 0.5) * (pi / N_ANGLES)
    k = 1.0 / ((large * np.cos(phi)) ** 2 + (small * np.sin(phi)) ** 2)
    low, high = 1.9 * large, 2.5 * large
    for _ in range(40):
        r = (low + high) / 2
        share = 1.0 - np.exp(-0.5 * r * r * k).mean()
        low, high = (r, high) if share < SHARE else (low, r)
    return float(high)


def gnss_outages(navigation: Navigation) -> list[Outage]:
    """Every stretch without a used position longer than three usual intervals (and two seconds), in order."""
    used = np.flatnonzero(navigation.used)
    t = navigation.t
    usual = float(np.median(np.diff(t[np.isfinite(navigation.fixes[:, 0])]))) if used.size > 1 else 0.0
    least = max(MISSED * usual, SHORTEST)
    marks = [*used.tolist(), len(t) - 1] if used[-1] < len(t) - 1 else used.tolist()
    view = _View(navigation)
    return [view.outage(a, b, b not in set(used.tolist()))
            for a, b in pairwise(marks) if t[b] - t[a] > least]


class _View:
    """Positions with their covariances, worked out once."""

    def __init__(self, navigation: Navigation) -> None:
        self.of = navigation
        self.predicted, self.best = (navigation.position(e) for e in (navigation.predicted, navigation.best))

    def outage(self, first: int, last: int, is_open: bool) -> Outage:
        """Between the rows of two fixes, or from a fix to the last row."""
        n, t = self.of, self.of.t
        lost = first + np.flatnonzero(n.withheld[first:last + 1])
        judged = last if not is_open else int(lost[-1]) if lost.size else None
        error, allowed, inside = None, None, None
        if judged is not None:
            distance, within = self._misses(self.predicted, np.array([judged]))
            error, inside = float(distance[0]), bool(within[0])
            allowed = ellipse(self.predicted[1][judged] + np.diag(n.fix_variance)).radius
        inner = self.best[1][first:last + 1]
        widest = inner[int(np.argmax(np.trace(inner, axis1=1, axis2=2)))]
        north, east = self.predicted[0][last].tolist()
        return Outage(float(t[first]), float(t[last]), is_open, bool(lost.size), north, east,
                      ellipse(self.predicted[1][last]), error, allowed, inside, ellipse(widest).radius,
                      self._summary(self.predicted, lost), self._summary(self.best, lost))

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
