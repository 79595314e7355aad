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
FACTOR = 5.0  # standard error of a logarithm beyond which nothing is known: a factor 150
LEAN = 1.5  # times that its error would be larger
N_BLOCKS = 40  # of a record, for the sandwich: more rows in one than the residuals remember

AT_BOUND, VAGUE = "at its bound", "the data do not tell its order of magnitude"  # flags of a parameter that ended low


@dataclass(frozen=True)
class Uncertainty:
    """In own units, except ``P`` (n, n): the covariance of the coordinates, NaN where nothing is known."""

    errors: Array
    covariance: Array
    correlation: Array
    prior_weight: Array
    gradient_norm: float
    flags: tuple[tuple[str, str], ...]
    P: Array


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
    flags += _leaning(at.information, good, at_bound, P, slopes, names)
    variance = np.diag(P)
    covariance = P * np.outer(slopes, slopes)
    root = np.sqrt(variance)
    gradient = np.where(np.isfinite(variance), at.gradient, 0.0)
    known = np.isfinite(variance)
    norm = float(np.sqrt(max(gradient[known] @ P[np.ix_(known, known)] @ gradient[known], 0.0)))
    weight = np.where(np.isfinite(variance), prior * np.where(np.isfinite(variance), variance, 0.0), 0.0)
    for i in np.flatnonzero(weight > 0.9).tolist():
        flags.append((names[i], f"{100 * weight[i]:.0f} % of what is known of it is its prior"))
    return Uncertainty(np.abs(slopes) * root, covariance, P / np.outer(root, root), np.minimum(weight, 1.0), norm,
                       tuple(flags), P)


def _leaning(
    information: Array, good: Sequence[int], at_bound: NDArray[np.bool_], P: Array, slopes: Array, names: Sequence[str]
) -> list[tuple[str, str]]:
    """Parameters whose error is small only because a neighbour stands at its bound: if it did not, it would be larger.

    Their intervals cover less than they say (89 % instead of 95 % in a study of sway damping, `docs/how-to/study.md`).
    """
    bound = [i for i in np.flatnonzero(at_bound).tolist() if information[i, i] > 0]
    flags: dict[str, str] = {}
    for b in bound:
        free = [*good, b]
        try:
            wider = np.sqrt(np.abs(np.diag(_inverse(information[np.ix_(free, free)]))))
        except np.linalg.LinAlgError:  # with it free, they could not be told apart at all
            continue
        for i, error in zip(good, wider[:-1].tolist(), strict=True):
            if error > LEAN * np.sqrt(P[i, i]) and np.isfinite(error):
                flags[names[i]] = (f"its error takes {names[b]} at its bound for granted; without that it would be "
                                   f"{abs(slopes[i]) * error:.2g}")
    return list(flags.items())


def _blind(
    information: Array, names: Sequence[str], labels: Sequence[str]
) -> tuple[NDArray[np.bool_], list[tuple[str, str]]]:
    """Parameters that take part in a combination the data do not see, and that combination."""
    blind = np.diag(information) <= 0
    flags = [(names[i], "the data do not depend on it") for i in np.flatnonzero(blind).tolist()]
    seen: list[int] = np.flatnonzero(~blind).tolist()
    if not seen:
        return blind, flags
    scale = np.sqrt(np.diag(information)[seen])
    w, V = np.linalg.eigh(information[np.ix_(seen, seen)] / np.outer(scale, scale))
    for k in np.flatnonzero(w < BLIND):
        part = V[:, k] / scale  # in the coordinates themselves
        part = part / part[np.argmax(np.abs(part))]
        members: list[int] = np.flatnonzero(np.abs(V[:, k]) > NAMED).tolist()
        blind[[seen[m] for m in members]] = True
        terms = " ".join(f"{part[m]:+.2g} {labels[seen[m]]}" for m in members)
        flags += [(names[seen[m]], f"not identified: the data do not see a change of {terms}") for m in members]
    return blind, flags


def _inverse(information: Array) -> Array:
    if not information.size:
        return information
    scale = np.sqrt(np.diag(information))
    return np.asarray(np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale))


def sandwich(known: Uncertainty, rows: Sequence[tuple[list[int], Array]], slopes: Array) -> Array:
    """Standard errors that stay valid when residuals are coloured (White 1982), in own units (n,).

    The covariance of the score comes from sums over blocks of each record, ``P (sum s s') P``.
    """
    P = np.nan_to_num(known.P)
    n = len(P)
    middle = np.zeros((n, n))
    for places, by_row in rows:
        starts = np.unique(np.linspace(0, len(by_row), N_BLOCKS, endpoint=False).astype(int))
        sums = np.zeros((starts.size, n))
        sums[:, places] = np.add.reduceat(by_row, starts, axis=0)
        middle += sums.T @ sums
    variance = np.diag(P @ middle @ P)
    return np.where(np.isfinite(known.errors), np.abs(slopes) * np.sqrt(np.maximum(variance, 0.0)), np.nan)
