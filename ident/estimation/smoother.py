"""Rauch-Tung-Striebel smoother: mean and covariance of the states at each row, given all samples of the record.

    G_k = P_k|k Phi_k' P_k+1|k^-1,   x_k|N = x_k|k + G_k (x_k+1|N - x_k+1|k),
    P_k|N = P_k|k + G_k (P_k+1|N - P_k+1|k) G_k'

(Rauch, Tung and Striebel 1965; Sarkka 2013, section 9.1.) A long record is processed in pieces of consecutive rows. All
gains of a piece are computed at once, in units of each state's standard deviation. The covariance is computed as a sum
of two positive semidefinite parts, so that rounding cannot make it indefinite.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from seatrial.ident.estimation.likelihood import FilterResult
from seatrial.ident.numerics import Array

NULL_SPACE_TOLERANCE = 1e-13  # smaller eigenvalues of a correlation matrix, per row of it, are rounding


@dataclass(frozen=True)
class SmootherResult:
    """Smoothed states of a record: their distribution given all samples of the record.

    Attributes
    ----------
    t : Array (n_rows,)
        Time [s].
    x : Array (n_rows, n_states)
        Means of the states.
    P : Array (n_rows, n_states, n_states)
        Covariances of the states.
    lag_one : Array (n_rows - 1, n_states, n_states)
        Entry k is the cross-covariance of the states in row k + 1 (second axis) with those in row k (third axis).
    """

    t: Array
    x: Array
    P: Array
    lag_one: Array

    @property
    def sd(self) -> Array:
        """Standard deviations of the states (n_rows, n_states); a negative variance, from rounding, counts as zero."""
        return np.asarray(np.sqrt(np.maximum(np.diagonal(self.P, axis1=1, axis2=2), 0.0)))


class SmoothedStates(NamedTuple):
    """Smoothed states of a record: means and standard deviations, given all of its samples, also later ones.

    Attributes
    ----------
    x, sd : Array (n_rows, n_states)
        Means and standard deviations of the states, in the states' units.
    """

    x: Array
    sd: Array


def smooth(run: FilterResult) -> SmootherResult:
    """Run the Rauch-Tung-Striebel smoother over a filter run, and return means and covariances of the states.

    States without variance are not changed. In the last row the result is that of the filter.
    """
    parts = list(_smoothed_pieces(run))[::-1]
    x, P, lag_one = (np.concatenate(part) for part in zip(*[part[1:] for part in parts], strict=True))
    return SmootherResult(run.t, x, P, lag_one)


def smoothed_states(run: FilterResult) -> SmoothedStates:
    """Return means and standard deviations of the states given all samples of a record, from its filter run.

    The function needs less memory than `smooth` for a long record.
    """
    x, sd = np.empty((2, *run.x_filt.shape))
    for rows, mean, P, _ in _smoothed_pieces(run):
        x[rows], sd[rows] = mean, np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2), 0.0))
    return SmoothedStates(x, sd)


def _smoothed_pieces(run: FilterResult) -> Iterator[tuple[slice, Array, Array, Array]]:
    """Run the smoother backwards over a filter run, in pieces of consecutive rows that limit the memory.

    Yields
    ------
    tuple[slice, Array, Array, Array]
        The last piece first: rows of the piece; means (n, n_states) and covariances (n, n_states, n_states) of its n
        rows; cross-covariances of the row after each row with this row. The last row of the record has no
        cross-covariance.
    """
    after: tuple[Array, Array, Array] | None = None  # x, P and predicted P of the row that follows the piece
    for rows in reversed(run.pieces):
        P_pred, P_filt, Phi = run.covariances(rows)
        x, P, x_pred = run.x_filt[rows].copy(), P_filt.copy(), run.x_pred[rows]
        if after is None:
            Phi, P_filt, P_next = Phi[:-1], P_filt[:-1], P_pred[1:]
        else:
            P_next = np.concatenate([P_pred[1:], after[2][None]])
            x, P = np.concatenate([x, after[0][None]]), np.concatenate([P, after[1][None]])
            x_pred = run.x_pred[rows.start : rows.stop + 1]
        G = _smoother_gains(Phi, P_filt, P_next)
        own = _irreducible_covariance(G, Phi, P_filt, P_next)
        for k in range(len(G) - 1, -1, -1):
            x[k] += G[k] @ (x[k + 1] - x_pred[k + 1])
            P[k] = own[k] + G[k] @ P[k + 1] @ G[k].T
        after, n = (x[0].copy(), P[0].copy(), P_pred[0]), rows.stop - rows.start
        P = (P + P.swapaxes(1, 2)) / 2
        yield rows, x[:n], P[:n], P[1:] @ G.swapaxes(1, 2)


def smoothed_mean(run: FilterResult) -> Array:
    """Return the means of the smoothed states (n_rows, n_states) of a filter run, without their covariances.

    It takes a third of the time of `smooth`.
    """
    x = run.x_filt.copy()
    back, P_after = x[-1], run.covariances(slice(x.shape[0] - 1, None)).P_pred
    for rows in reversed(run.pieces):
        P_pred, P_filt, Phi = run.covariances(rows)
        first, last = rows.start, min(rows.stop, len(x) - 1)
        n, P_after = last - first, np.concatenate([P_pred, P_after])
        G = _smoother_gains(Phi[:n], P_filt[:n], P_after[1 : n + 1])
        shift = x[first:last] - np.einsum("kij,kj->ki", G, run.x_pred[first + 1 : last + 1])
        for k in range(n - 1, -1, -1):
            x[first + k] = back = shift[k] + G[k] @ back
        P_after = P_pred[:1]
    return x


def _irreducible_covariance(G: Array, Phi: Array, P_filt: Array, P_next: Array) -> Array:
    """Return ``P_filt - G P_next G'`` (n, n_states, n_states): the covariance that later rows cannot reduce.

    It is computed in Joseph's form, so that rounding cannot make it indefinite.

    Parameters
    ----------
    G : Array (n, n_states, n_states)
        Smoother gains of n rows.
    Phi, P_filt : Array (n, n_states, n_states)
        Transition matrix to the next row, and covariance after the samples of the row.
    P_next : Array (n, n_states, n_states)
        Covariance predicted for the next row.
    """
    Q = P_next - Phi @ P_filt @ Phi.swapaxes(1, 2)
    rest = np.eye(Phi.shape[1]) - G @ Phi
    return np.asarray(rest @ P_filt @ rest.swapaxes(1, 2) + G @ Q @ G.swapaxes(1, 2))


def _smoother_gains(Phi: Array, P_filt: Array, P_next: Array) -> Array:
    """Return the smoother gains ``P_filt Phi' P_next^-1`` of n rows (n, n_states, n_states).

    ``Phi`` is the transition matrix to the next row, ``P_filt`` the covariance after the samples of the row, and
    ``P_next`` the covariance predicted for the next row. The gain from a state without predicted variance is zero.
    """
    sd = np.sqrt(np.maximum(np.diagonal(P_next, axis1=1, axis2=2), 0.0))
    scale = np.divide(1.0, sd, out=np.zeros_like(sd), where=sd > 0)
    correlation = P_next * scale[:, :, None] * scale[:, None, :]
    diagonal = np.arange(sd.shape[1])
    correlation[:, diagonal, diagonal] = 1.0  # for a state without variance, too: its gain is zero
    right = Phi @ P_filt * scale[:, :, None]
    return np.asarray((_solve_or_pseudo_inverse(correlation, right) * scale[:, :, None]).swapaxes(1, 2))


def _solve_or_pseudo_inverse(correlation: Array, right: Array) -> Array:
    """Solve ``correlation X = right`` for each of n rows of a record, both arguments (n, n_states, n_states).

    Return X of the same shape. If the matrix of any row is not positive definite, the pseudo-inverse is used for all
    rows.
    """
    solved = np.empty_like(right)
    try:
        np.linalg.cholesky(correlation)
        return np.asarray(np.linalg.solve(correlation, right))
    except np.linalg.LinAlgError:
        pass
    w, V = np.linalg.eigh(correlation)
    inverse = np.divide(1.0, w, out=np.zeros_like(w), where=w > NULL_SPACE_TOLERANCE * w.shape[1])
    solved = V @ (inverse[:, :, None] * (V.swapaxes(1, 2) @ right))
    return np.asarray(solved)
