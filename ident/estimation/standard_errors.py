"""Standard errors of an estimate, with flags for parameters that cannot have one.

- `assess`: standard errors from the inverse of the information. Combinations of parameters that the data do not
  identify get no standard error. The errors are wider if a parameter at its bound may leave it, and if the model has
  considered parameters (``seatrial.ident.model.Parameter``).
- `sandwich`: robust standard errors, valid for autocorrelated residuals (White 1982). The covariance of the score comes
  from sums over blocks of rows. The blocks are longer than the autocorrelation, even if it is long and weak.
- `flat_coordinates`: practical identifiability (Raue et al. 2009). The likelihood of such a parameter is flat at the
  estimate but falls a little further off; its standard error comes from the width of that interval.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.estimation.fisher_scoring import Bounds, Evaluation
from seatrial.ident.model import Parameter
from seatrial.ident.numerics import Array, correlation_length, scaled_eigen, scaled_inverse

# A combination of parameters is not identified if its eigenvalue of the information, scaled to unit diagonal, is below:
NULL_SPACE_TOLERANCE = 1e-10
MEMBER_WEIGHT = 0.1  # a parameter belongs to a combination if its entry in the unit eigenvector exceeds this
Z_95, DROP_95 = 1.959964, 1.9207294  # 97.5 % quantile of a normal, and half of the 95 % quantile of chi2(1)
MAX_LOG_ERROR = 5.0  # a logarithm with a larger standard error (a factor 150) counts as unknown
FLAGGED_INFLATION = 1.5  # a standard error gets a flag if a parameter at its bound makes it larger by this factor
AT_BOUND, VAGUE = "at its bound", "the data do not determine its order of magnitude"  # flags of a parameter
TRIED_STEPS = 10.0 ** np.arange(-2.0, 5.0)  # distances tried by `flat_coordinates`, in characteristic steps
N_HALVINGS = 12  # bisections of the bracket of an interval's end: a relative width of 0.02 %
Fallen = Callable[[float], bool | None]  # see `_fallen`
MAX_BLOCKS, MIN_BLOCKS = 40, 12  # numbers of blocks of rows, over all records together
# Block length in correlation lengths. Such blocks miss an eighteenth of the variance, for which it is corrected.
BLOCK_LENGTH = 9.0
MOST_MISSED = 0.5  # largest share of the variance that this correction assumes to be missing
COLOURED_P_VALUE = 0.001  # residuals are coloured below this p value of the information matrix test over all parameters
AUTOCORRELATED_TOO_LONG = (
    "its residuals are autocorrelated for too long to allow a robust standard error"  # flag of a parameter
)


@dataclass(frozen=True)
class Uncertainty:
    """Covariance of the estimates and their standard errors, with flags for parameters that lack one.

    All numbers are in the parameters' own units, except those of the estimator's coordinates (the logarithm for a
    parameter with ``transform="log"``).

    Attributes
    ----------
    errors : Array (n,)
        Standard errors. NaN for parameters at a bound and for parameters that the data do not identify.
    covariance, correlation : Array (n, n)
        Of the estimates.
    prior_weight : Array (n,)
        Share of a parameter's information that comes from its prior, 0 to 1.
    gradient_norm
        Length of the gradient in standard errors; zero at the optimum.
    flags : tuple of (name, remark)
        What a reader should know about single parameters.
    P : Array (n, n)
        Covariance of the coordinates, with those at a bound held there. NaN for coordinates without an error.
    spread : Array (n, n)
        Covariance of the coordinates that bounds (`_beside_bounds`) and considered parameters add to ``P``.
    limits : Array (n,)
        For a coordinate at its bound, the far end of its 95 % interval; NaN for all others.
    considered : Array (n, n)
        Part of ``covariance`` that comes from considered parameters.
    """

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
    """Return standard errors, covariance and flags from the information at the optimum.

    Parameters
    ----------
    at
        Objective, gradient and information at the optimum; the information includes that of the priors.
    z : Array (n,)
        The optimum, in the estimator's coordinates.
    bounds
        Bounds of the coordinates.
    names
        Names of the parameters, for the flags.
    slopes : Array (n,)
        Derivative of each parameter by its coordinate.
    prior : Array (n,)
        Information of the priors.
    considered : Array (n, k), optional
        Information between the estimates and each of k considered parameters, per standard deviation of the latter.

    Notes
    -----
    The estimates follow the considered parameters by ``-P considered``. The data do not reduce the uncertainty of the
    considered parameters themselves.
    """
    n = z.size
    at_bound = np.logical_or(*bounds.reached(z))
    flags = [(names[i], AT_BOUND) for i in np.flatnonzero(at_bound).tolist()]
    P = np.full((n, n), np.nan)
    inside: list[int] = np.flatnonzero(~at_bound).tolist()
    labels = [f"ln {names[i]}" if bounds.logarithmic[i] else names[i] for i in inside]
    unseen, remarks = _unidentified(at.information[np.ix_(inside, inside)], [names[i] for i in inside], labels)
    flags += remarks
    good = [i for i, lost in zip(inside, unseen, strict=True) if not lost]
    P[np.ix_(good, good)] = scaled_inverse(at.information[np.ix_(good, good)])
    vague = [i for i in good if bounds.logarithmic[i] and P[i, i] > MAX_LOG_ERROR**2]
    for i in vague:
        flags.append((names[i], VAGUE))
    P[vague, :] = P[:, vague] = np.nan
    spread, limits, inflated = _beside_bounds(at, z, bounds, P, names)
    flags += inflated
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
        flags.append((names[i], f"{100 * weight[i]:.0f} % of its information comes from its prior"))
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
    """Return what parameters at their bounds add to the covariance of the others.

    Parameters
    ----------
    P : Array (n, n)
        Covariance of the coordinates, with those at a bound held there.

    Returns
    -------
    spread : Array (n, n)
        Covariance to be added to ``P``.
    limits : Array (n,)
        For a coordinate at its bound, the far end of its 95 % interval; NaN for all others.
    flags : list of (name, remark)
        Parameters whose standard error becomes much larger.

    Notes
    -----
    If the parameter is held at its bound, the intervals of the others are too short: with a quadratic
    damping at zero, the 95 % interval of the linear damping held the truth in 89 % of the cases. If the bound is
    ignored, they are too long.

    The data push a parameter b against its bound with the gradient g; its profile likelihood has the curvature c. At
    the distance d from the bound the profile likelihood has dropped by

        g d + c d^2 / 2,     so that d95 = 2 * 1.92 / (g + sqrt(g^2 + 2 * 1.92 c))

    is the end of the 95 % interval of b (Pawitan 2001, section 2.6; one-sided: Self and Liang 1987). The other
    coordinates follow by ``f d95`` with ``f = -I_oo^-1 I_ob``, and their 95 % intervals have to reach as far. The
    covariance is therefore widened by ``f f' (d95 / 1.96)^2``. This term vanishes for a large g. For g = 0 it is all
    that a free b would add.
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
            flags[names[good[k]]] = f"its error is {wider[k]:.1f} times as large because {names[b]} may leave its bound"
    return spread, limits, list(flags.items())


def _unidentified(
    information: Array, names: Sequence[str], labels: Sequence[str]
) -> tuple[NDArray[np.bool_], list[tuple[str, str]]]:
    """Return which parameters take part in a combination that the data do not identify, and flags for them.

    Parameters
    ----------
    information : Array (n, n)
        Information of the coordinates inside their bounds.
    names, labels
        Names of the parameters and of their coordinates (``ln m_u``).
    """
    unseen = np.diag(information) <= 0
    flags = [(names[i], "the data do not depend on it") for i in np.flatnonzero(unseen).tolist()]
    informed: list[int] = np.flatnonzero(~unseen).tolist()
    if not informed:
        return unseen, flags
    w, V, scale = scaled_eigen(information[np.ix_(informed, informed)])
    for direction in _apart(V[:, w < NULL_SPACE_TOLERANCE]):
        part = direction / scale  # in the coordinates themselves
        part = part / part[np.argmax(np.abs(part))]
        members: list[int] = np.flatnonzero(np.abs(direction) > MEMBER_WEIGHT).tolist()
        unseen[[informed[m] for m in members]] = True
        terms = " ".join(f"{part[m]:+.2g} {labels[informed[m]]}" for m in members)
        flags += [
            (names[informed[m]], f"not identified: the data do not depend on the joint change {terms}") for m in members
        ]
    return unseen, flags


def _apart(V: Array) -> Array:
    """Return a basis of unidentified directions in which each vector involves few parameters.

    Eigenvectors of equal eigenvalues are an arbitrary mixture. Gauss-Jordan elimination, largest pivot first, separates
    them.

    Parameters
    ----------
    V : Array (n, n_null)
        Unidentified directions in columns.

    Returns
    -------
    Array (n_null, n)
        Basis of the same space in rows of unit length.
    """
    rows = V.T.copy()
    for i in range(len(rows)):
        row, pivot = divmod(int(np.argmax(np.abs(rows[i:]))), V.shape[0])
        rows[[i, i + row]] = rows[[i + row, i]]
        rows[i] /= rows[i, pivot]
        others = np.arange(len(rows)) != i
        rows[others] -= np.outer(rows[others, pivot], rows[i])
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


LEAST_BY_DATA = 1e-3  # no test of a variance of which the data determine a smaller share than this; the prior rules it


@dataclass(frozen=True)
class Sandwich:
    """Robust standard errors and their test against the errors from the information.

    Attributes
    ----------
    errors : Array (n,)
        Robust standard errors in the parameters' own units. NaN if the parameter has no standard error, or if its
        residuals are autocorrelated for too long.
    least : Array (n,)
        The same, but in the latter case computed from the longest possible blocks, which miss a part of the variance.
    p : Array (n,)
        p value of the information matrix test (White 1982), for each variance alone: the probability of a variance at
        least as large if the information is right.
    """

    errors: Array
    least: Array
    p: Array


def sandwich(known: Uncertainty, rows: Sequence[tuple[list[int], Array]], slopes: Array, prior: Array) -> Sandwich:
    """Return robust standard errors, with a test against those of the information.

    Parameters
    ----------
    known
        Result of `assess`.
    rows : sequence of (places, by_row)
        For each record the indices of its coordinates, and what each row adds to their gradient (n_rows, n_places).
    slopes : Array (n,)
        Derivative of each parameter by its coordinate.
    prior : Array (n,)
        Information of the priors.

    Returns
    -------
    Sandwich
        Robust standard errors. They include what parameters at their bounds and considered parameters add.

    Notes
    -----
    Priors have no rows. Their uncertainty enters the covariance of the estimates unchanged, as ``P Lambda P``.
    """
    from scipy import special  # imported here: it takes a fifth of a second, and only an estimate needs it

    P = np.nan_to_num(known.P)
    parts = [by_row @ P[places] for places, by_row in rows]  # (n_rows, n): shift of the estimate by each row
    found = [_variance([part[:, i] for part in parts], len(P)) for i in range(len(P))]
    variance, df, long_enough = np.array(found).T
    seen = np.isfinite(known.errors)
    by_prior = P**2 @ prior
    least = np.where(seen, np.abs(slopes) * np.sqrt(variance + by_prior + np.diag(known.spread)), np.nan)
    by_data = np.diag(P) - by_prior
    ratio = variance / np.where(by_data > LEAST_BY_DATA * np.diag(P), by_data, np.nan)
    p = np.where(seen, special.chdtrc(df, df * ratio), np.nan)
    return Sandwich(np.where(long_enough > 0.0, least, np.nan), least, p)


def widened(known: Uncertainty, robust: Array) -> Uncertainty:
    """Return the uncertainty with standard errors that are at least the ``robust`` ones (n,).

    The correlations stay as they are.
    """
    factor = np.fmax(robust / known.errors, 1.0)
    factor = np.where(np.isfinite(factor), factor, 1.0)
    wider = np.outer(factor, factor)
    return replace(
        known, errors=known.errors * factor, covariance=known.covariance * wider, considered=known.considered * wider
    )


def _variance(parts: Sequence[Array], n_parameters: int) -> tuple[float, float, bool]:
    """Return the variance of the sum of all rows, its degrees of freedom, and whether the blocks are long enough.

    The variance comes from block sums. It is corrected for what blocks of finite length miss, and for the degrees of
    freedom that ``n_parameters`` fitted parameters take.

    Parameters
    ----------
    parts : sequence of Array (n_rows,)
        Contributions of the rows of each record.

    Returns
    -------
    variance
        NaN if there are fewer rows than ``MIN_BLOCKS``.
    df
        Number of blocks less the degrees of freedom taken by the parameters.
    long_enough
        Whether the blocks have the length that the autocorrelation requires.
    """
    n = sum(part.size for part in parts)
    if n < MIN_BLOCKS:
        return np.nan, np.nan, False
    correlated = correlation_length(parts)
    length = max(BLOCK_LENGTH * correlated, n / max(MAX_BLOCKS, 4 * n_parameters))
    counts = [max(int(part.size / length), 1) for part in parts]
    long_enough = sum(counts) >= MIN_BLOCKS
    if not long_enough:
        length = n / MIN_BLOCKS
        counts = [max(round(part.size / length), 1) for part in parts]
    n_blocks = sum(counts)
    total = 0.0
    for part, count in zip(parts, counts, strict=True):
        starts = np.linspace(0, part.size, count, endpoint=False).astype(int)
        total += float(np.sum(np.add.reduceat(part, starts) ** 2))
    missed = min(0.5 * correlated / length, MOST_MISSED)
    taken = min(n_parameters, n_blocks // 2)  # one block for each parameter: errors become slightly too large
    return total * n_blocks / (n_blocks - taken) / (1.0 - missed), float(n_blocks - taken), long_enough


@dataclass(frozen=True)
class LikelihoodInterval:
    """Interval of a coordinate over which the log-likelihood has fallen by 1.92, with all others held.

    Attributes
    ----------
    at
        Index of the coordinate.
    low, high
        Ends of the interval; infinite if the log-likelihood does not fall on that side.
    """

    at: int
    low: float
    high: float

    @property
    def remark(self) -> str:
        """Flag of the parameter."""
        return (
            f"the likelihood is flat here and falls at {self.low:.4g} and at {self.high:.4g}: the standard error is "
            "from this interval, all other parameters held"
        )

    @property
    def information(self) -> float:
        """Information of a normal distribution with this interval as its 95 % interval."""
        return float((2.0 * Z_95 / (self.high - self.low)) ** 2)


def flat_coordinates(
    value: Callable[[Array], float], z: Array, parameters: Sequence[Parameter], information: Array, bounds: Bounds
) -> list[LikelihoodInterval]:
    """Return coordinates whose likelihood is flat around the estimate and falls further away, each with its interval.

    An example is the end of a dead zone that lies between two commands of the log: all values in between fit equally
    well. The curvature at the estimate is then no measure of the error. Such a coordinate is inside its bounds, and its
    standard error from the information exceeds its characteristic step. The log-likelihood has fallen by 1.92 (the
    limit of a 95 % interval) on both sides, within half of the 95 % interval that this standard error gives.
    Coordinates that are logarithms are skipped, because the likelihood is smooth in them.

    Parameters
    ----------
    value
        Log-likelihood of the coordinates (n,).
    z : Array (n,)
        The estimate.
    parameters
        With their characteristic steps.
    information : Array (n, n)
        Information at the estimate.
    bounds
        Bounds of the coordinates.
    """
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
    """Return a function that checks whether the likelihood has fallen by 1.92 at another value of coordinate i.

    That function returns None if the likelihood is not finite there.
    """
    top = value(z)

    def fallen(x: float) -> bool | None:
        moved = z.copy()
        moved[i] = x
        there = value(moved)
        return bool(there < top - DROP_95) if np.isfinite(there) else None

    return fallen


def _bracket(fallen: Fallen, tried: Array, z: float) -> tuple[float, float]:
    """Return the last of the values ``tried`` at which the likelihood has not fallen, and the first at which it has.

    The second is infinite if the likelihood falls at none of them.
    """
    inner = z
    for outer in tried.tolist():
        if fallen(outer) is not False:
            return inner, outer
        inner = outer
    return inner, float(np.copysign(np.inf, tried[-1] - z))


def _narrowed(fallen: Fallen, inner: float, outer: float) -> float:
    """Return the value between ``inner`` and ``outer`` at which the likelihood has fallen, by bisection.

    Infinite if ``outer`` is infinite, or if the likelihood stops being finite before it has fallen.
    """
    if not np.isfinite(outer):
        return outer
    side = outer - inner
    for _ in range(N_HALVINGS):
        middle = 0.5 * (inner + outer)
        inner, outer = (inner, middle) if fallen(middle) is not False else (middle, outer)
    return outer if fallen(outer) else float(np.copysign(np.inf, side))


def with_interval_information(at: Evaluation, found: Sequence[LikelihoodInterval]) -> Evaluation:
    """Return the evaluation with the information of flat coordinates replaced by that of their intervals.

    Their information with other coordinates becomes zero.
    """
    information = at.information.copy()
    for p in found:
        information[p.at, :] = information[:, p.at] = 0.0
        information[p.at, p.at] = p.information
    return replace(at, information=information)
