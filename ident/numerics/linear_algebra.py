"""Symmetric matrices whose entries have different units: information and covariance, scaled to unit diagonal first.

Eigenvalues of the scaled matrix do not depend on units, so that one cut-off holds for every model.

The array type of ident: float64, time along the first axis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class ScaledEigen(NamedTuple):
    """``A = diag(scale) V diag(w) V' diag(scale)``: w (n,) ascending, V (n, n) in columns, scale (n,)."""

    w: Array
    V: Array
    scale: Array


def unit_diagonal(A: Array, floor: float = 0.0) -> tuple[Array, Array]:
    """Scale a symmetric matrix to ones on its diagonal: ``A = scaled * outer(scale, scale)``.

    Parameters: A (n, n); floor: of the diagonal, where rounding may have made it zero or negative.
    Returns: scaled (n, n), scale (n,).
    """
    scale = np.sqrt(np.maximum(np.diag(A), floor))
    return A / np.outer(scale, scale), scale


def scaled_eigen(A: Array, floor: float = 0.0) -> ScaledEigen:
    """Eigenvalues and eigenvectors of A (n, n) scaled to unit diagonal; ``floor`` as in `unit_diagonal`."""
    scaled, scale = unit_diagonal(A, floor)
    w, V = np.linalg.eigh(scaled)
    return ScaledEigen(w, V, scale)


def scaled_inverse(A: Array) -> Array:
    """Inverse of A (n, n), positive definite, by way of unit diagonal. Raises LinAlgError where it is singular."""
    scaled, scale = unit_diagonal(A)
    return np.asarray(np.linalg.inv(scaled) / np.outer(scale, scale))


def scaled_pseudo_inverse(A: Array) -> Array:
    """Pseudo-inverse (Moore and Penrose) of A (n, n), positive semidefinite, by way of unit diagonal."""
    scaled, scale = unit_diagonal(A)
    return np.asarray(np.linalg.pinv(scaled, hermitian=True) / np.outer(scale, scale))


def covariance_root(P: Array, tolerance: float) -> Array:
    """Directions of one standard deviation L (n, k) of a covariance P (n, n): ``L L' = P``, without those whose scaled
    eigenvalue is below ``tolerance`` times the largest."""
    w, V, scale = scaled_eigen(P)
    kept = w > tolerance * w.max(initial=0.0)
    return np.asarray(scale[:, None] * V[:, kept] * np.sqrt(w[kept]))
