"""Rauch-Tung-Striebel smoother: mean and covariance of the state at each row, given all data.

    G_k = P_k|k Phi_k' P_k+1|k^-1,   x_k|N = x_k|k + G_k (x_k+1|N - x_k+1|k),
    P_k|N = P_k|k + G_k (P_k+1|N - P_k+1|k) G_k'

(Rauch, Tung and Striebel 1965; Sarkka 2013, section 9.1.) All gains at once, in units of each state's standard
deviation; the covariance as a sum of two positive parts, so that it stays one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.estimation.likelihood import FilterResult
from ident.numerics import Array

NULL_SPACE_TOLERANCE = 1e-13  # eigenvalue of a correlation matrix, for each of its rows: below it is rounding


@dataclass(frozen=True)
class SmootherResult:
    """Smoothed states: t (n_rows,) [s]; means x (n_rows, n_states) and covariances P (n_rows, n_states, n_states) given
    all data; lag_one (n_rows - 1, n_states, n_states): cross-covariance of row k + 1 with row k."""

    t: Array
    x: Array
    P: Array
    lag_one: Array

    @property
    def sd(self) -> Array:
        """Standard deviations (n_rows, n_states)."""
        return np.asarray(np.sqrt(np.maximum(np.diagonal(self.P, axis1=1, axis2=2), 0.0)))


def smooth(run: FilterResult) -> SmootherResult:
    """Smooth a filter's run. States without variance keep their values."""
    Phi, P_filt, P_next = run.Phi[:-1], run.P_filt[:-1], run.P_pred[1:]
    G = _gains(Phi, P_filt, P_next)
    x, P = run.x_filt.copy(), run.P_filt.copy()
    own = _own_part(G, Phi, P_filt, P_next)
    for k in range(len(G) - 1, -1, -1):
        x[k] += G[k] @ (x[k + 1] - run.x_pred[k + 1])
        P[k] = own[k] + G[k] @ P[k + 1] @ G[k].T
    P = (P + P.swapaxes(1, 2)) / 2
    return SmootherResult(run.t, x, P, P[1:] @ G.swapaxes(1, 2))


def smoothed_mean(run: FilterResult) -> Array:
    """The means of ``smooth`` alone (n_rows, n_states), in a third of the time."""
    G = _gains(run.Phi[:-1], run.P_filt[:-1], run.P_pred[1:])
    x, back = run.x_filt.copy(), run.x_filt[-1]
    shift = run.x_filt[:-1] - np.einsum("kij,kj->ki", G, run.x_pred[1:])
    for k in range(len(G) - 1, -1, -1):
        x[k] = back = shift[k] + G[k] @ back
    return x


def _own_part(G: Array, Phi: Array, P_filt: Array, P_next: Array) -> Array:
    """``P - G P_next G'``, the covariance that later rows cannot reduce, in Joseph's form."""
    Q = P_next - Phi @ P_filt @ Phi.swapaxes(1, 2)
    rest = np.eye(Phi.shape[1]) - G @ Phi
    return np.asarray(rest @ P_filt @ rest.swapaxes(1, 2) + G @ Q @ G.swapaxes(1, 2))


def _gains(Phi: Array, P_filt: Array, P_next: Array) -> Array:
    """(n_rows - 1, n_states, n_states)."""
    sd = np.sqrt(np.maximum(np.diagonal(P_next, axis1=1, axis2=2), 0.0))
    scale = np.divide(1.0, sd, out=np.zeros_like(sd), where=sd > 0)
    correlation = P_next * scale[:, :, None] * scale[:, None, :]
    still = np.arange(sd.shape[1])
    correlation[:, still, still] = 1.0  # also where there is no variance: such a state takes no part
    right = Phi @ P_filt * scale[:, :, None]
    return np.asarray((_solve(correlation, right) * scale[:, :, None]).swapaxes(1, 2))


def _solve(correlation: Array, right: Array) -> Array:
    """By Cholesky; rows whose matrix is singular by the pseudo-inverse."""
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
