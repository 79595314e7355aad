"""Standard errors of an estimate, with flags for parameters that cannot have one.

The estimator's coordinates are the parameters, or their logarithms for parameters with ``transform="log"``.

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
from seatrial.ident.model import Flag, Parameter
from seatrial.ident.numerics import Array, correlation_length, scaled_eigen, scaled_inverse

# A combination of parameters is not identified if its eigenvalue of the information, scaled to unit diagonal, is below:
NULL_SPACE_TOLERANCE = 1e-10
MEMBER_WEIGHT = 0.1  # a parameter belongs to a combination if its entry in the unit eigenvector exceeds this
Z_95, DROP_95 = 1.959964, 1.9207294  # 97.5 % quantile of a normal, and half of the 95 % quantile of chi2(1)
MAX_LOG_ERROR = 5.0  # a logarithm with a larger standard error (a factor 150) counts as unknown
FLAGGED_INFLATION = 1.5  # a standard error gets a flag if a parameter at its bound makes it larger than by this factor
MOSTLY_PRIOR = 0.9  # share of the prior in the information on a parameter, above which it is flagged
AT_BOUND = Flag("at bound", "at its bound")
VAGUE = Flag("not determined", "the data do not determine its order of magnitude")
TRIED_STEPS = 10.0 ** np.arange(-2.0, 5.0)  # distances tried by `flat_coordinates`, in characteristic steps
# `_reach_in_direction` ends at this share of the quadratic approximation's distance, and halves its bracket so often
NEAREST_REACH, N_REACH_HALVINGS = 1e-4, 4
N_HALVINGS = 12  # bisections of the bracket of an interval's end: a relative width of 0.02 %
DropTest = Callable[[float], bool | None]  # whether the log-likelihood has fallen by 1.92 at a value, see `_drop_test`
MAX_BLOCKS, MIN_BLOCKS = 40, 12  # numbers of blocks of rows, over all records together
# Block length in correlation lengths. Such blocks miss an eighteenth of the variance, for which it is corrected.
BLOCK_LENGTH = 9.0
MOST_MISSED = 0.5  # largest share of the variance that this correction assumes to be missing
COLOURED_P_VALUE = 0.001  # residuals are coloured below this p value of the information matrix test over all parameters
AUTOCORRELATED_TOO_LONG = Flag(
    "no robust error", "the residuals are autocorrelated for too long to allow a robust standard error of it"
)


@dataclass(frozen=True)
class Uncertainty:
    """Covariance of the estimates and their standard errors, with flags for parameters that lack one.

    All numbers are in the parameters' own units, except ``P``, ``spread`` and ``limits``: these are in the estimator's
    coordinates (the logarithm for a parameter with ``transform="log"``).

    Attributes
    ----------
    errors : Array (n,)
        Standard errors. NaN for parameters at a bound, for those that the data do not identify, and for logarithms with
        a standard error above 5.
    covariance, correlation : Array (n, n)
        Covariance and correlation of the estimates; NaN for parameters without a standard error.
    prior_weight : Array (n,)
        Share of a parameter's information that comes from its prior, 0 to 1; 0 without a standard error.
    gradient_norm
        Length of the gradient in standard errors; zero at the optimum.
    flags : tuple of (name, Flag)
        Flags of single parameters, such as "at its bound".
    P : Array (n, n)
        Covariance of the coordinates (inverse information), with those at a bound held there. NaN for coordinates
        without a standard error.
    spread : Array (n, n)
        Covariance that is added to ``P``, from parameters at their bounds, and from considered parameters: parameters
        that are not estimated, but whose prior is uncertain.
    limits : Array (n,)
        For a coordinate at its bound, the far end of its 95 % interval, NaN without information; NaN for all others.
    considered : Array (n, n)
        Part of ``covariance`` that comes from considered parameters.
    """

    errors: Array
    covariance: Array
    correlation: Array
    prior_weight: Array
    gradient_norm: float
    flags: tuple[tuple[str, Flag], ...]
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
    value: Callable[[Array], float] | None = None,
) -> Uncertainty:
    """Return standard errors, covariance and flags of an estimate from the Fisher information at the optimum.

    Parameters
    ----------
    at
        Objective, gradient and information at the optimum; the information includes that of the priors.
    z : Array (n,)
        Estimator's coordinates of the optimum: parameters, or the logarithms of positive parameters.
    bounds
        Bounds of the coordinates.
    names
        Names of the parameters, for the flags.
    slopes : Array (n,)
        Derivative of each parameter by its coordinate: 1, or the parameter itself for a logarithm.
    prior : Array (n,)
        Information (1 / variance) of the priors, in the coordinates; 0 without a prior.
    considered : Array (n, k), optional
        Fisher information between the estimates and each of k considered parameters (not estimated, with an uncertain
        prior), multiplied by the prior standard deviation of the considered parameter. None: no considered parameters.
    value, optional
        Returns the objective (log-likelihood plus log-prior) at coordinates (n,). With it, a parameter at its bound
        widens the errors of the others only as far as the objective allows. None: its quadratic approximation is used.

    Returns
    -------
    Uncertainty
        Flags name parameters that are at a bound, are not identified, have an unknown order of magnitude, have an
        error that is much larger because of a bound, or are known from their prior to more than 90 %.

    Notes
    -----
    An error c (k,) of the considered parameters, in prior standard deviations, shifts the estimates by
    ``-P considered c``. The data do not reduce the uncertainty of the considered parameters themselves.
    """
    n = z.size
    at_bound = np.logical_or(*bounds.reached(z))
    flags = [(names[i], AT_BOUND) for i in np.flatnonzero(at_bound).tolist()]
    P = np.full((n, n), np.nan)
    inside: list[int] = np.flatnonzero(~at_bound).tolist()
    labels = [f"ln {names[i]}" if bounds.logarithmic[i] else names[i] for i in inside]
    unseen, remarks = _unidentified_parameters(
        at.information[np.ix_(inside, inside)], [names[i] for i in inside], labels
    )
    flags += remarks
    good = [i for i, lost in zip(inside, unseen, strict=True) if not lost]
    P[np.ix_(good, good)] = scaled_inverse(at.information[np.ix_(good, good)])
    vague = [i for i in good if bounds.logarithmic[i] and P[i, i] > MAX_LOG_ERROR**2]
    for i in vague:
        flags.append((names[i], VAGUE))
    P[vague, :] = P[:, vague] = np.nan
    spread, limits, inflated = _covariance_from_bounds(at, z, bounds, P, names, value)
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
    for i in np.flatnonzero(weight > MOSTLY_PRIOR).tolist():
        flags.append((names[i], Flag("prior", f"{100 * weight[i]:.0f} % of its information comes from its prior")))
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


def _covariance_from_bounds(
    at: Evaluation,
    z: Array,
    bounds: Bounds,
    P: Array,
    names: Sequence[str],
    value: Callable[[Array], float] | None,
) -> tuple[Array, Array, list[tuple[str, Flag]]]:
    """Return the covariance that parameters at their bounds add to the estimates of the other parameters.

    Parameters
    ----------
    at
        Objective, gradient and information at the optimum.
    z : Array (n,)
        Estimator's coordinates of the optimum (logarithms of positive parameters).
    bounds
        Bounds of the coordinates.
    P : Array (n, n)
        Covariance of the coordinates, with those at a bound held there. NaN for coordinates without an error.
    names
        Names of the parameters, for the flags.
    value
        Returns the objective at coordinates (n,). None: only its quadratic approximation is used.

    Returns
    -------
    spread : Array (n, n)
        Covariance to be added to ``P``.
    limits : Array (n,)
        For a coordinate at its bound, the far end of its 95 % interval, NaN without information; NaN for all others.
    flags : list of (name, Flag)
        Parameters whose standard error becomes more than 1.5 times as large.

    Notes
    -----
    If the parameter is held at its bound, the intervals of the others are too short: with a quadratic damping at zero,
    the 95 % interval of the linear damping contained the true value in 89 % of the cases. If the bound is ignored, they
    are too long.

    The data push a parameter b against its bound with the gradient g; its profile likelihood has the curvature c. At
    the distance d from the bound the profile likelihood has dropped by

        g d + c d^2 / 2,     so that d95 = 2 * 1.92 / (g + sqrt(g^2 + 2 * 1.92 c))

    is the end of the 95 % interval of b (Pawitan 2001, section 2.6; one-sided: Self and Liang 1987). The optimum of the
    other coordinates then moves by ``f d95`` with ``f = -I_oo^-1 I_ob`` (I: information; o: other coordinates), and
    their 95 % intervals have to reach as far. The covariance is therefore widened by ``f f' (d95 / 1.96)^2``. This term
    vanishes for a large g. For g = 0 it is all that a free b would add.

    Far from the bound, the objective is not quadratic. Where the term would make an error more than 1.5 times as large,
    it ends where the objective itself has fallen by 1.92 in the direction ``f``. An example is a correlation time that
    may leave its bound for values a thousand times as long.
    """
    n = z.size
    spread, limits = np.zeros((n, n)), np.full(n, np.nan)
    good = np.flatnonzero(np.isfinite(np.diag(P)))
    flags: dict[str, Flag] = {}
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
        if value is not None and np.any(np.diag(added) > (FLAGGED_INFLATION**2 - 1.0) * np.diag(P)[good]):
            direction = np.zeros(n)
            direction[b], direction[good] = inward, inward * follow
            added *= (_reach_in_direction(value, z, direction, reach, bounds) / reach) ** 2
        spread[np.ix_(good, good)] += added
        wider = np.sqrt(1.0 + np.diag(added) / np.diag(P)[good])
        for k in np.flatnonzero(wider > FLAGGED_INFLATION).tolist():
            text = f"its error is {wider[k]:.1f} times as large because {names[b]} may leave its bound"
            flags[names[good[k]]] = Flag("larger error", text)
    return spread, limits, list(flags.items())


def _reach_in_direction(
    value: Callable[[Array], float], z: Array, direction: Array, reach: float, bounds: Bounds
) -> float:
    """Return the distance at which the objective has fallen by 1.92 in a direction, at most ``reach``.

    Parameters
    ----------
    value
        Returns the objective at coordinates (n,).
    z : Array (n,)
        Coordinates of the optimum.
    direction : Array (n,)
        Change of the coordinates per distance.
    reach
        Largest distance.
    bounds
        Bounds of the coordinates. Coordinates that would leave them stay there.
    """
    top = value(z)

    def has_fallen(distance: float) -> bool:
        return not value(np.clip(z + distance * direction, bounds.low, bounds.high)) >= top - DROP_95

    if not has_fallen(reach):
        return reach
    inner, outer = 0.5 * reach, reach
    while has_fallen(inner) and inner > NEAREST_REACH * reach:
        inner, outer = 0.5 * inner, inner
    for _ in range(N_REACH_HALVINGS):
        middle = 0.5 * (inner + outer)
        inner, outer = (inner, middle) if has_fallen(middle) else (middle, outer)
    return outer


def _unidentified_parameters(
    information: Array, names: Sequence[str], labels: Sequence[str]
) -> tuple[NDArray[np.bool_], list[tuple[str, Flag]]]:
    """Find the parameters that take part in a combination of parameters that the data do not identify.

    Such a combination is an eigenvector of the information, scaled to unit diagonal, with an eigenvalue below 1e-10:
    the likelihood does not change along it.

    Parameters
    ----------
    information : Array (n, n)
        Fisher information of those n coordinates that are inside their bounds.
    names, labels
        Names of the parameters and of their coordinates (``ln m_u`` for a logarithm).

    Returns
    -------
    unseen : Array (n,) of bool
        Whether the parameter takes part in such a combination (with an entry above 0.1 in the unit vector), or the data
        do not depend on it at all.
    flags : list of (name, Flag)
        One flag or more for each of these parameters, with the combination.
    """
    unseen = np.diag(information) <= 0
    lost = Flag("not determined", "the data do not depend on it")
    flags = [(names[i], lost) for i in np.flatnonzero(unseen).tolist()]
    informed: list[int] = np.flatnonzero(~unseen).tolist()
    if not informed:
        return unseen, flags
    w, V, scale = scaled_eigen(information[np.ix_(informed, informed)])
    for direction in _sparse_basis(V[:, w < NULL_SPACE_TOLERANCE]):
        part = direction / scale  # in the coordinates themselves
        part = part / part[np.argmax(np.abs(part))]
        members: list[int] = np.flatnonzero(np.abs(direction) > MEMBER_WEIGHT).tolist()
        unseen[[informed[m] for m in members]] = True
        terms = " ".join(f"{part[m]:+.2g} {labels[informed[m]]}" for m in members)
        joint = Flag("not determined", f"not identified: the data do not depend on the joint change {terms}")
        flags += [(names[informed[m]], joint) for m in members]
    return unseen, flags


def _sparse_basis(V: Array) -> Array:
    """Return a basis of the space of unidentified directions in which each vector involves few parameters.

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


# If the data determine a smaller share of a variance than this, the variance is not tested: the prior determines it.
LEAST_BY_DATA = 1e-3


@dataclass(frozen=True)
class Sandwich:
    """Robust standard errors (from the sandwich covariance) and their test against the errors from the information.

    They are valid if the residuals are autocorrelated, where the errors from the information are too small.

    Attributes
    ----------
    errors : Array (n,)
        Robust standard errors in the parameters' own units. NaN if the parameter has no standard error, or if its
        residuals are autocorrelated over such a long time that the record has too few independent blocks.
    least : Array (n,)
        Lower bound of the robust standard errors. It equals `errors` where these are known. For residuals that are
        autocorrelated for too long it comes from the longest possible blocks, which miss a part of the variance.
    p : Array (n,)
        p value of the information matrix test (White 1982), for each variance alone: the probability of a variance at
        least as large if the information is right. NaN if the parameter has no standard error, or if the data determine
        less than a thousandth of its variance.
    """

    errors: Array
    least: Array
    p: Array


def sandwich(known: Uncertainty, rows: Sequence[tuple[list[int], Array]], slopes: Array, prior: Array) -> Sandwich:
    """Return robust standard errors from the sandwich covariance, with a test against those of the information.

    The covariance of the score (gradient of the log-likelihood) is estimated from its sums over blocks of rows, so that
    autocorrelated residuals are accounted for.

    Parameters
    ----------
    known
        Uncertainty from the information, a result of `assess`.
    rows : sequence of (coordinates, contributions)
        For each record the indices of its coordinates, and the contribution of each row (instant of the record) to
        their gradient (n_rows, n_coordinates).
    slopes : Array (n,)
        Derivative of each parameter by its coordinate: 1, or the parameter itself for a logarithm.
    prior : Array (n,)
        Information (1 / variance) of the priors, in the coordinates.

    Returns
    -------
    Sandwich
        Robust standard errors. They include the variance that parameters at their bounds and considered parameters add.

    Notes
    -----
    Priors have no rows. Their uncertainty enters the covariance of the estimates unchanged, as ``P Lambda P``, with the
    covariance P from the information and the diagonal matrix Lambda of ``prior``.
    """
    from scipy import special  # imported here: it takes a fifth of a second, and only an estimate needs it

    P = np.nan_to_num(known.P)
    parts = [by_row @ P[places] for places, by_row in rows]  # (n_rows, n): shift of the estimate by each row
    found = [_variance_from_block_sums([part[:, i] for part in parts], len(P)) for i in range(len(P))]
    variance, df, long_enough = np.array(found).T
    seen = np.isfinite(known.errors)
    by_prior = P**2 @ prior
    least = np.where(seen, np.abs(slopes) * np.sqrt(variance + by_prior + np.diag(known.spread)), np.nan)
    by_data = np.diag(P) - by_prior
    ratio = variance / np.where(by_data > LEAST_BY_DATA * np.diag(P), by_data, np.nan)
    p = np.where(seen, special.chdtrc(df, df * ratio), np.nan)
    return Sandwich(np.where(long_enough > 0.0, least, np.nan), least, p)


def widened(known: Uncertainty, robust: Array) -> Uncertainty:
    """Return a copy of the uncertainty whose standard errors are at least the ``robust`` ones (n,).

    The covariance and its considered part are scaled accordingly; the correlations and the limits do not change. A
    robust error that is NaN or smaller has no effect. It is applied if the residuals are coloured.
    """
    factor = np.fmax(robust / known.errors, 1.0)
    factor = np.where(np.isfinite(factor), factor, 1.0)
    wider = np.outer(factor, factor)
    return replace(
        known, errors=known.errors * factor, covariance=known.covariance * wider, considered=known.considered * wider
    )


def _variance_from_block_sums(parts: Sequence[Array], n_parameters: int) -> tuple[float, float, bool]:
    """Return the variance of the sum of an autocorrelated quantity over all rows, from its sums over blocks of rows.

    A block is as long as nine correlation lengths (`correlation_length`), or longer if there would be more than 40
    blocks in all (or four for each parameter, if that is more). The variance is corrected for the covariance between
    neighbouring blocks, and for the degrees of freedom that the fitted parameters take.

    Parameters
    ----------
    parts : sequence of Array (n_rows,)
        For each record, the contributions of its rows to the sum.
    n_parameters
        Number of fitted parameters.

    Returns
    -------
    variance
        NaN if there are fewer than 12 rows in all records.
    df
        Degrees of freedom: number of blocks less those taken by the parameters; NaN with fewer than 12 rows.
    long_enough
        Whether at least 12 blocks have the length that the autocorrelation requires. If not, shorter blocks were used.
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
    """Interval of a coordinate over which the log-likelihood has fallen by 1.92, with all other coordinates held.

    It replaces the standard error of a parameter whose likelihood is flat around its estimate. Coordinates are the
    variables of the search; here the coordinate is the parameter itself, not its logarithm.

    Attributes
    ----------
    coordinate : int
        Index of the coordinate.
    low, high : float
        Ends of the interval, in the parameter's unit.
    """

    coordinate: int
    low: float
    high: float

    @property
    def flag(self) -> Flag:
        """Flag of the parameter: its standard error comes from this interval."""
        return Flag(
            "flat",
            f"the likelihood is flat here and falls at {self.low:.4g} and at {self.high:.4g}: the standard error is "
            "from this interval, all other parameters held",
        )

    @property
    def information(self) -> float:
        """Fisher information (1 / variance) of a normal distribution that has this interval as its 95 % interval."""
        return float((2.0 * Z_95 / (self.high - self.low)) ** 2)


def flat_coordinates(
    value: Callable[[Array], float], z: Array, parameters: Sequence[Parameter], information: Array, bounds: Bounds
) -> list[LikelihoodInterval]:
    """Find parameters whose likelihood is flat around the estimate and falls further away, each with its interval.

    An example is the end of a dead zone that lies between two commands of the log: all values in between fit equally
    well. The curvature at the estimate is then no measure of the error, and the interval replaces it.

    Such a parameter is inside its bounds. Its standard error from the information, all other parameters held, is not
    smaller than its characteristic step; without information it is infinite. The log-likelihood falls by 1.92 (the
    limit of a 95 % interval) on one side at least. A side without such a fall ends at the bound. The interval is
    shorter than half of the 95 % interval that the standard error gives. Parameters that are estimated as logarithms
    are skipped, because the likelihood is smooth in them.

    Parameters
    ----------
    value
        Returns the objective (log-likelihood plus log-prior) at coordinates (n,).
    z : Array (n,)
        Coordinates of the estimate: parameters, or the logarithms of positive parameters.
    parameters
        Parameters of the coordinates. The characteristic step of a parameter is its ``step``, or else a hundredth of
        its value, or else 1.
    information : Array (n, n)
        Information at the estimate.
    bounds
        Bounds of the coordinates.

    Returns
    -------
    list of LikelihoodInterval
        One interval for each such parameter; empty if there is none.
    """
    found, top = [], value(z)
    for i, p in enumerate(parameters):
        error = 1.0 / np.sqrt(information[i, i]) if information[i, i] > 0.0 else np.inf
        step = p.step or 0.01 * abs(p.value) or 1.0
        if bounds.logarithmic[i] or not bounds.low[i] < z[i] < bounds.high[i] or error < step:
            continue
        fallen = _drop_test(value, top, z, i)
        if not _one_side_is_short(fallen, z[i], 0.5 * Z_95 * error, bounds.low[i], bounds.high[i]):
            continue
        tried = np.unique(np.minimum(step * TRIED_STEPS, Z_95 * error))
        sides = [
            _bracket_drop(fallen, np.clip(z[i] + sign * tried, bounds.low[i], bounds.high[i]), float(z[i]))
            for sign in (-1.0, 1.0)
        ]
        if not any(np.isfinite(outer) for _, outer in sides) or sides[1][0] - sides[0][0] > Z_95 * error:
            continue
        low, high = (_bisect_drop(fallen, *side) for side in sides)
        low, high = max(low, bounds.low[i]), min(high, bounds.high[i])
        if high - low < Z_95 * error:
            found.append(LikelihoodInterval(i, float(low), float(high)))
    return found


def _one_side_is_short(fallen: DropTest, z: float, distance: float, low: float, high: float) -> bool:
    """Return whether the interval of a flat coordinate may end within ``distance`` of the estimate ``z`` on one side.

    The log-likelihood has then fallen there, is not finite there, or there is a bound (``low``, ``high``). If neither
    side is short, the interval is longer than twice the distance. Most coordinates are smooth and need no more than
    these two evaluations.
    """
    return any(not low < x < high or fallen(x) is not False for x in (z - distance, z + distance))


def _drop_test(value: Callable[[Array], float], top: float, z: Array, i: int) -> DropTest:
    """Return a function that tests whether the log-likelihood has fallen by 1.92 if coordinate i takes another value.

    All other coordinates keep their values in z (n,). The function returns None if the log-likelihood is not finite.

    Parameters
    ----------
    value
        Returns the log-likelihood at coordinates (n,).
    top
        Log-likelihood of the estimate.
    z : Array (n,)
        Coordinates of the estimate.
    i
        Index of the tested coordinate.
    """

    def fallen(x: float) -> bool | None:
        """Return whether the log-likelihood is more than 1.92 below that of the estimate if coordinate i is x.

        The other coordinates keep the values of the estimate. Return None if the log-likelihood is not finite.
        """
        moved = z.copy()
        moved[i] = x
        there = value(moved)
        return bool(there < top - DROP_95) if np.isfinite(there) else None

    return fallen


def _bracket_drop(fallen: DropTest, tried: Array, z: float) -> tuple[float, float]:
    """Find the first of the values ``tried`` at which the log-likelihood has fallen by 1.92 or is not finite.

    Parameters
    ----------
    fallen
        Returns whether the log-likelihood has fallen by 1.92 at a value of the coordinate; None if it is not finite.
    tried : Array
        Values of the coordinate, at increasing distances from the estimate on one side.
    z
        Value of the coordinate at the estimate.

    Returns
    -------
    inner, outer
        The value before this one (z if there is none), and this value. ``outer`` is infinite, with the sign of the
        side, if there is no such value.
    """
    inner = z
    for outer in tried.tolist():
        if fallen(outer) is not False:
            return inner, outer
        inner = outer
    return inner, float(np.copysign(np.inf, tried[-1] - z))


def _bisect_drop(fallen: DropTest, inner: float, outer: float) -> float:
    """Find by bisection the value of a coordinate at which the log-likelihood has fallen by 1.92.

    It lies between ``inner``, where the log-likelihood has not fallen, and ``outer``. The result is infinite, with the
    sign of the side, if ``outer`` is infinite or if the log-likelihood stops being finite before it has fallen.
    ``fallen`` returns whether the log-likelihood has fallen by 1.92 at a value; None if it is not finite there.
    """
    if not np.isfinite(outer):
        return outer
    side = outer - inner
    for _ in range(N_HALVINGS):
        middle = 0.5 * (inner + outer)
        inner, outer = (inner, middle) if fallen(middle) is not False else (middle, outer)
    return outer if fallen(outer) else float(np.copysign(np.inf, side))


def with_interval_information(at: Evaluation, found: Sequence[LikelihoodInterval]) -> Evaluation:
    """Return a copy of the evaluation in which parameters with a flat likelihood get the information of an interval.

    Each interval in ``found`` is that over which the log-likelihood falls by 1.92; its information replaces the one
    from the curvature at the optimum. The information between such a parameter and the others becomes zero. Standard
    errors then follow from the copy as usual.
    """
    information = at.information.copy()
    for p in found:
        information[p.coordinate, :] = information[:, p.coordinate] = 0.0
        information[p.coordinate, p.coordinate] = p.information
    return replace(at, information=information)
