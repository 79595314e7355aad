"""Standard errors of an estimate, and what must not be given one.

- `assess`: from the inverse of the information, without combinations that the data do not identify, and wider where a
  parameter at its bound may leave it, and by what is considered (``seatrial.ident.model.Parameter``);
- `sandwich`: valid where residuals are autocorrelated (White 1982): the covariance of the score is taken from sums over
  blocks of rows, which are longer than the autocorrelation, also where that is long and weak;
- `flat_coordinates`: practical identifiability: parameters whose likelihood is flat around the estimate but falls a
  little further off get the width of that interval (Raue et al. 2009).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.estimation.fisher_scoring import Bounds, Evaluation
from seatrial.ident.model import Parameter
from seatrial.ident.numerics import Array, correlation_length, scaled_eigen, scaled_inverse

NULL_SPACE_TOLERANCE = 1e-10  # eigenvalue of the information scaled to unit diagonal: below it nothing is identified
MEMBER_WEIGHT = 0.1  # in an eigenvector of unit length: from it a parameter is part of the combination
Z_95, DROP_95 = 1.959964, 1.9207294  # 97.5 % quantile of a normal, and half of the 95 % quantile of chi2(1)
MAX_LOG_ERROR = 5.0  # standard error of a logarithm beyond which nothing is known: a factor 150
FLAGGED_INFLATION = 1.5  # of a standard error by a neighbour that may leave its bound: from it there is a flag
AT_BOUND, VAGUE = "at its bound", "the data do not tell its order of magnitude"  # flags of a parameter
TRIED_STEPS = 10.0 ** np.arange(-2.0, 5.0)  # times the parameter's characteristic step
N_HALVINGS = 12  # of the bracket of an interval's end: to 0.02 %
Fallen = Callable[[float], bool | None]
MAX_BLOCKS, MIN_BLOCKS = 40, 12  # of all records, over which the contributions of rows are summed
BLOCK_LENGTH = 9.0  # times the correlation length: blocks that miss an eighteenth of the variance, which is given back
MOST_MISSED = 0.5  # of the variance, that is given back where no blocks are long enough
COLOURED = 0.001  # p value, over all parameters, from which the errors of the information are too small
TOO_LONG = "its residuals remember too long for an error that allows for it"


@dataclass(frozen=True)
class Uncertainty:
    """In own units, except of the coordinates: ``P`` (n, n), their covariance with those at a bound held there, NaN
    where nothing is known; ``spread`` (n, n), what these (``_beside_bounds``) and considered parameters add to it;
    ``limits`` (n,): of a coordinate at its bound, the far end of its 95 % interval, NaN for all others; ``considered``
    (n, n): what of the covariance comes from considered parameters."""

    errors: Array
    covariance: Array
    correlation: Array
    prior_weight: Array
    gradient_norm: float
    flags: tuple[tuple[str, str], ...]
    P: Array
    spread: Array
    limits: Array
    considered: Array


def assess(
    at: Evaluation,
    z: Array,
    bounds: Bounds,
    names: Sequence[str],
    slopes: Array,
    prior: Array,
    considered: Array | None = None,
) -> Uncertainty:
    """From the information with the priors'; ``prior`` (n,) is the latter's diagonal.

    considered (n, k): information between the estimates and each considered parameter, per its standard deviation: by
    this the estimates follow it, ``-P considered``, and no data are asked what it is.
    gradient_norm: the length of the gradient in standard errors, zero at the optimum.
    """
    n = z.size
    at_bound = np.logical_or(*bounds.reached(z))
    flags = [(names[i], AT_BOUND) for i in np.flatnonzero(at_bound).tolist()]
    P = np.full((n, n), np.nan)
    inside: list[int] = np.flatnonzero(~at_bound).tolist()
    labels = [f"ln {names[i]}" if bounds.logarithmic[i] else names[i] for i in inside]
    blind, said = _blind(at.information[np.ix_(inside, inside)], [names[i] for i in inside], labels)
    flags += said
    good = [i for i, lost in zip(inside, blind, strict=True) if not lost]
    P[np.ix_(good, good)] = scaled_inverse(at.information[np.ix_(good, good)])
    vague = [i for i in good if bounds.logarithmic[i] and P[i, i] > MAX_LOG_ERROR**2]
    for i in vague:
        flags.append((names[i], VAGUE))
    P[vague, :] = P[:, vague] = np.nan
    spread, limits, leaning = _beside_bounds(at, z, bounds, P, names)
    flags += leaning
    follow = np.zeros((n, 1)) if considered is None else -np.nan_to_num(P) @ considered
    by_considered = follow @ follow.T
    spread = spread + by_considered
    variance = np.diag(P + spread)
    covariance = (P + spread) * np.outer(slopes, slopes)
    root = np.sqrt(variance)
    known = np.isfinite(variance)
    norm = float(np.sqrt(max(at.gradient[known] @ P[np.ix_(known, known)] @ at.gradient[known], 0.0)))
    weight = np.where(known, prior * np.nan_to_num(np.diag(P)), 0.0)
    for i in np.flatnonzero(weight > 0.9).tolist():
        flags.append((names[i], f"{100 * weight[i]:.0f} % of what is known of it is its prior"))
    correlation = (P + spread) / np.outer(root, root)
    return Uncertainty(
        np.abs(slopes) * root,
        covariance,
        correlation,
        np.minimum(weight, 1.0),
        norm,
        tuple(flags),
        P,
        spread,
        limits,
        by_considered * np.outer(slopes, slopes),
    )


def _beside_bounds(
    at: Evaluation, z: Array, bounds: Bounds, P: Array, names: Sequence[str]
) -> tuple[Array, Array, list[tuple[str, str]]]:
    """What a parameter at its bound adds to its neighbours' covariance, the far end of its own interval, and flags.

    To take the bound for granted makes the neighbours' intervals too short (a quadratic damping at zero: 89 % of those
    of the linear one held); to leave it out, as if it could be crossed, makes them too long. The profile likelihood of
    a parameter b that the data push against its bound with the gradient g, of curvature c, drops by

        g d + c d^2 / 2     at the distance d from it,     so that d95 = 2 * 1.92 / (g + sqrt(g^2 + 2 * 1.92 c))

    is the end of its 95 % interval (Pawitan 2001, section 2.6; one-sided: Self and Liang 1987). Over d95 the others
    follow by ``f d95``, ``f = -I_oo^-1 I_ob``, and their 95 % intervals have to reach as far: the covariance is widened
    by ``f f' (d95 / 1.96)^2``, nothing if the bound is pushed against hard, and all that a free b would add if hardly.
    """
    n = z.size
    spread, limits = np.zeros((n, n)), np.full(n, np.nan)
    good = np.flatnonzero(np.isfinite(np.diag(P)))
    flags: dict[str, str] = {}
    below, above = bounds.reached(z)
    for b in np.flatnonzero((below | above) & (np.diag(at.information) > 0)).tolist():
        inward, room = (1.0, bounds.high[b] - z[b]) if below[b] else (-1.0, z[b] - bounds.low[b])
        follow = -P[np.ix_(good, good)] @ at.information[good, b]
        alone = at.information[b, b]
        curvature = max(alone + at.information[b, good] @ follow, NULL_SPACE_TOLERANCE * alone)
        push = max(-inward * at.gradient[b], 0.0)
        reach = min(2 * DROP_95 / (push + np.sqrt(push**2 + 2 * DROP_95 * curvature)), room)
        limits[b] = z[b] + inward * reach
        added = np.outer(follow, follow) * (reach / Z_95) ** 2
        spread[np.ix_(good, good)] += added
        wider = np.sqrt(1.0 + np.diag(added) / np.diag(P)[good])
        for k in np.flatnonzero(wider > FLAGGED_INFLATION).tolist():
            flags[names[good[k]]] = f"its error allows for {names[b]} off its bound: {wider[k]:.1f} times that at it"
    return spread, limits, list(flags.items())


def _blind(
    information: Array, names: Sequence[str], labels: Sequence[str]
) -> tuple[NDArray[np.bool_], list[tuple[str, str]]]:
    """Parameters that take part in a combination the data do not see, and each such combination."""
    blind = np.diag(information) <= 0
    flags = [(names[i], "the data do not depend on it") for i in np.flatnonzero(blind).tolist()]
    seen: list[int] = np.flatnonzero(~blind).tolist()
    if not seen:
        return blind, flags
    w, V, scale = scaled_eigen(information[np.ix_(seen, seen)])
    for direction in _apart(V[:, w < NULL_SPACE_TOLERANCE]):
        part = direction / scale  # in the coordinates themselves
        part = part / part[np.argmax(np.abs(part))]
        members: list[int] = np.flatnonzero(np.abs(direction) > MEMBER_WEIGHT).tolist()
        blind[[seen[m] for m in members]] = True
        terms = " ".join(f"{part[m]:+.2g} {labels[seen[m]]}" for m in members)
        flags += [(names[seen[m]], f"not identified: the data do not see a change of {terms}") for m in members]
    return blind, flags


def _apart(V: Array) -> Array:
    """A basis (n_null, n) of what the columns of V (n, n_null) span, each of unit length and of few parameters:
    eigenvectors of equal eigenvalues are any mixture. By Gauss and Jordan, the largest pivot first."""
    rows = V.T.copy()
    for i in range(len(rows)):
        row, pivot = divmod(int(np.argmax(np.abs(rows[i:]))), V.shape[0])
        rows[[i, i + row]] = rows[[i + row, i]]
        rows[i] /= rows[i, pivot]
        others = np.arange(len(rows)) != i
        rows[others] -= np.outer(rows[others, pivot], rows[i])
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


LEAST_BY_DATA = 1e-3  # of a variance: where the prior gives all the rest, the residuals say nothing about it


@dataclass(frozen=True)
class Sandwich:
    """errors (n,): standard errors in own units, NaN where there is none, or where the residuals are correlated for too
    long; least (n,): the same, but then by the longest blocks that there are, which miss a part of it; p (n,): of a
    variance as large by chance where the information holds (White's information matrix test, 1982, for each variance
    alone)."""

    errors: Array
    least: Array
    p: Array


def sandwich(known: Uncertainty, rows: Sequence[tuple[list[int], Array]], slopes: Array, prior: Array) -> Sandwich:
    """Standard errors and their test against those of the information.

    rows: for each record its coordinates, and what each row adds to their gradient (n_rows, n_places); prior (n,): the
    information of the priors, whose uncertainty goes through to the estimates as it is, P Lambda P. What parameters at
    their bounds add to the errors is added to these, too.
    """
    from scipy import special  # a fifth of a second: not before there is an estimate

    P = np.nan_to_num(known.P)
    parts = [by_row @ P[places] for places, by_row in rows]  # (n_rows, n): what each row moves the estimate by
    found = [_variance([part[:, i] for part in parts], len(P)) for i in range(len(P))]
    variance, freedom, whole = np.array(found).T
    seen = np.isfinite(known.errors)
    by_prior = P**2 @ prior
    least = np.where(seen, np.abs(slopes) * np.sqrt(variance + by_prior + np.diag(known.spread)), np.nan)
    by_data = np.diag(P) - by_prior
    ratio = variance / np.where(by_data > LEAST_BY_DATA * np.diag(P), by_data, np.nan)
    p = np.where(seen, special.chdtrc(freedom, freedom * ratio), np.nan)
    return Sandwich(np.where(whole > 0.0, least, np.nan), least, p)


def widened(known: Uncertainty, robust: Array) -> Uncertainty:
    """With the larger of both errors, all correlations as they were."""
    factor = np.fmax(robust / known.errors, 1.0)
    factor = np.where(np.isfinite(factor), factor, 1.0)
    wider = np.outer(factor, factor)
    return replace(
        known, errors=known.errors * factor, covariance=known.covariance * wider, considered=known.considered * wider
    )


def _variance(parts: Sequence[Array], n_parameters: int) -> tuple[float, float, bool]:
    """Of the sum of all rows of all records, its degrees of freedom, and whether blocks are as long as they should be;
    what as many parameters have taken of it is given back."""
    n = sum(part.size for part in parts)
    if n < MIN_BLOCKS:
        return np.nan, np.nan, False
    correlated = correlation_length(parts)
    length = max(BLOCK_LENGTH * correlated, n / max(MAX_BLOCKS, 4 * n_parameters))
    counts = [max(int(part.size / length), 1) for part in parts]
    whole = sum(counts) >= MIN_BLOCKS
    if not whole:
        length = n / MIN_BLOCKS
        counts = [max(round(part.size / length), 1) for part in parts]
    n_blocks = sum(counts)
    total = 0.0
    for part, count in zip(parts, counts, strict=True):
        starts = np.linspace(0, part.size, count, endpoint=False).astype(int)
        total += float(np.sum(np.add.reduceat(part, starts) ** 2))
    missed = min(0.5 * correlated / length, MOST_MISSED)
    taken = min(n_parameters, n_blocks // 2)  # as if each had fitted a block: a little too careful
    return total * n_blocks / (n_blocks - taken) / (1.0 - missed), float(n_blocks - taken), whole


@dataclass(frozen=True)
class LikelihoodInterval:
    """Coordinate ``at`` can be moved to ``low`` and to ``high`` until the log-likelihood has fallen by 1.92."""

    at: int
    low: float
    high: float

    @property
    def remark(self) -> str:
        """For a flag."""
        return (
            f"flat here: the likelihood falls at {self.low:.4g} and at {self.high:.4g}, and its error is by that, "
            "all else held"
        )

    @property
    def information(self) -> float:
        """Of a normal with this as its 95 % interval."""
        return float((2.0 * Z_95 / (self.high - self.low)) ** 2)


def flat_coordinates(
    value: Callable[[Array], float], z: Array, parameters: Sequence[Parameter], information: Array, bounds: Bounds
) -> list[LikelihoodInterval]:
    """Coordinates inside their bounds whose error by the ``information`` (n, n) alone is beyond the step that matters,
    though the log-likelihood ``value`` falls within half of it. Logarithms have none: what they stand for is smooth."""
    found = []
    for i, p in enumerate(parameters):
        error = 1.0 / np.sqrt(information[i, i]) if information[i, i] > 0.0 else np.inf
        step = p.step or 0.01 * abs(p.value) or 1.0
        if bounds.logarithmic[i] or not bounds.low[i] < z[i] < bounds.high[i] or error < step:
            continue
        tried, fallen = np.unique(np.minimum(step * TRIED_STEPS, Z_95 * error)), _fallen(value, z, i)
        sides = [
            _bracket(fallen, np.clip(z[i] + sign * tried, bounds.low[i], bounds.high[i]), float(z[i]))
            for sign in (-1.0, 1.0)
        ]
        if not any(np.isfinite(outer) for _, outer in sides) or sides[1][0] - sides[0][0] > Z_95 * error:
            continue
        low, high = (_narrowed(fallen, *side) for side in sides)
        low, high = max(low, bounds.low[i]), min(high, bounds.high[i])
        if high - low < Z_95 * error:
            found.append(LikelihoodInterval(i, float(low), float(high)))
    return found


def _fallen(value: Callable[[Array], float], z: Array, i: int) -> Fallen:
    """Whether the likelihood has fallen where coordinate i has another value; None where it is no number."""
    top = value(z)

    def fallen(x: float) -> bool | None:
        moved = z.copy()
        moved[i] = x
        there = value(moved)
        return bool(there < top - DROP_95) if np.isfinite(there) else None

    return fallen


def _bracket(fallen: Fallen, tried: Array, z: float) -> tuple[float, float]:
    """The last of the tried that has not fallen and the first that has; infinite where none has."""
    inner = z
    for outer in tried.tolist():
        if fallen(outer) is not False:
            return inner, outer
        inner = outer
    return inner, float(np.copysign(np.inf, tried[-1] - z))


def _narrowed(fallen: Fallen, inner: float, outer: float) -> float:
    """Where in between it falls; infinite where it ends before it has fallen."""
    if not np.isfinite(outer):
        return outer
    side = outer - inner
    for _ in range(N_HALVINGS):
        middle = 0.5 * (inner + outer)
        inner, outer = (inner, middle) if fallen(middle) is not False else (middle, outer)
    return outer if fallen(outer) else float(np.copysign(np.inf, side))


def with_interval_information(at: Evaluation, found: Sequence[LikelihoodInterval]) -> Evaluation:
    """With the plateaus' information, and nothing of what else there was of these coordinates."""
    information = at.information.copy()
    for p in found:
        information[p.at, :] = information[:, p.at] = 0.0
        information[p.at, p.at] = p.information
    return replace(at, information=information)
