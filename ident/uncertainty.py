"""Standard errors from the information at an estimate, and what must not be given one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ident.scoring import Bounds, Evaluation

Array = NDArray[np.float64]
BLIND = 1e-10  # eigenvalue of the scaled information below which a combination is not identified
NAMED = 0.1  # weight with which a parameter is part of that combination
Z95, DROP = 1.959964, 1.9207294  # quantile of a normal, and half of chi2(1), at 95 %
FACTOR = 5.0  # standard error of a logarithm beyond which nothing is known: a factor 150
LEAN = 1.5  # times that its error would be larger

AT_BOUND, VAGUE = "at its bound", "the data do not tell its order of magnitude"  # flags of a parameter that ended low


@dataclass(frozen=True)
class Uncertainty:
    """In own units, except of the coordinates: ``P`` (n, n), their covariance with those at a bound held there, NaN
    where nothing is known; ``spread`` (n, n), what these add to it (``_beside_bounds``); ``limits`` (n,): of a
    coordinate at its bound, the far end of its 95 % interval, NaN for all others."""

    errors: Array
    covariance: Array
    correlation: Array
    prior_weight: Array
    gradient_norm: float
    flags: tuple[tuple[str, str], ...]
    P: Array
    spread: Array
    limits: Array


def assess(at: Evaluation, z: Array, bounds: Bounds, names: Sequence[str], slopes: Array, prior: Array
           ) -> Uncertainty:
    """From the information with the priors'; ``prior`` (n,) is the latter's diagonal.

    gradient_norm: the length of the gradient in standard errors, zero at the optimum.
    """
    n = z.size
    at_bound = (z <= bounds.low) | (z >= bounds.high)
    flags = [(names[i], AT_BOUND) for i in np.flatnonzero(at_bound).tolist()]
    P = np.full((n, n), np.nan)
    inside: list[int] = np.flatnonzero(~at_bound).tolist()
    labels = [f"ln {names[i]}" if bounds.logarithmic[i] else names[i] for i in inside]
    blind, said = _blind(at.information[np.ix_(inside, inside)], [names[i] for i in inside], labels)
    flags += said
    good = [i for i, lost in zip(inside, blind, strict=True) if not lost]
    P[np.ix_(good, good)] = _inverse(at.information[np.ix_(good, good)])
    vague = [i for i in good if bounds.logarithmic[i] and P[i, i] > FACTOR**2]
    for i in vague:
        flags.append((names[i], VAGUE))
    P[vague, :] = P[:, vague] = np.nan
    spread, limits, leaning = _beside_bounds(at, z, bounds, P, names)
    flags += leaning
    variance = np.diag(P + spread)
    covariance = (P + spread) * np.outer(slopes, slopes)
    root = np.sqrt(variance)
    known = np.isfinite(variance)
    norm = float(np.sqrt(max(at.gradient[known] @ P[np.ix_(known, known)] @ at.gradient[known], 0.0)))
    weight = np.where(known, prior * np.where(known, variance, 0.0), 0.0)
    for i in np.flatnonzero(weight > 0.9).tolist():
        flags.append((names[i], f"{100 * weight[i]:.0f} % of what is known of it is its prior"))
    correlation = (P + spread) / np.outer(root, root)
    return Uncertainty(np.abs(slopes) * root, covariance, correlation, np.minimum(weight, 1.0), norm, tuple(flags), P,
                       spread, limits)


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
    for b in np.flatnonzero(((z <= bounds.low) | (z >= bounds.high)) & (np.diag(at.information) > 0)).tolist():
        inward, room = (1.0, bounds.high[b] - z[b]) if z[b] <= bounds.low[b] else (-1.0, z[b] - bounds.low[b])
        follow = -P[np.ix_(good, good)] @ at.information[good, b]
        curvature = max(at.information[b, b] + at.information[b, good] @ follow, BLIND * at.information[b, b])
        push = max(-inward * at.gradient[b], 0.0)
        reach = min(2 * DROP / (push + np.sqrt(push**2 + 2 * DROP * curvature)), room)
        limits[b] = z[b] + inward * reach
        added = np.outer(follow, follow) * (reach / Z95) ** 2
        spread[np.ix_(good, good)] += added
        wider = np.sqrt(1.0 + np.diag(added) / np.diag(P)[good])
        for k in np.flatnonzero(wider > LEAN).tolist():
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
    scale = np.sqrt(np.diag(information)[seen])
    w, V = np.linalg.eigh(information[np.ix_(seen, seen)] / np.outer(scale, scale))
    for direction in _apart(V[:, w < BLIND]):
        part = direction / scale  # in the coordinates themselves
        part = part / part[np.argmax(np.abs(part))]
        members: list[int] = np.flatnonzero(np.abs(direction) > NAMED).tolist()
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


def _inverse(information: Array) -> Array:
    if not information.size:
        return information
    scale = np.sqrt(np.diag(information))
    return np.asarray(np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale))
