"""Linear algebra of symmetric matrices whose entries have different units: information and covariance matrices.

The matrices are scaled to unit diagonal first. The eigenvalues of the scaled matrix do not depend on units, so that one
tolerance is valid for all models.

``Array`` is the array type of ident: float64, with time along the first axis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class ScaledEigen(NamedTuple):
    """Eigenvalues and eigenvectors of a scaled matrix: ``A = diag(scale) V diag(w) V' diag(scale)``.

    Attributes
    ----------
    w : Array (n,)
        Eigenvalues, ascending.
    V : Array (n, n)
        Eigenvectors in columns.
    scale : Array (n,)
        Square roots of the diagonal of A, of which smaller values are replaced by the floor.
    """

    w: Array
    V: Array
    scale: Array


def unit_diagonal(A: Array, floor: float = 0.0) -> tuple[Array, Array]:
    """Scale a symmetric matrix to ones on its diagonal: ``A = scaled * outer(scale, scale)``.

    Parameters
    ----------
    A : Array (n, n)
        Symmetric matrix.
    floor
        Replaces smaller values on the diagonal, which rounding may have made zero or negative. With the floor 0, a
        diagonal value of zero or less gives NaN or inf.

    Returns
    -------
    scaled : Array (n, n)
        Scaled matrix. Its diagonal is not one where the floor replaced a value.
    scale : Array (n,)
        Square roots of the diagonal, after the floor.
    """
    scale = np.sqrt(np.maximum(np.diag(A), floor))
    return A / np.outer(scale, scale), scale


def scaled_eigen(A: Array, floor: float = 0.0) -> ScaledEigen:
    """Return eigenvalues and eigenvectors of a symmetric A (n, n) scaled to unit diagonal.

    Parameters
    ----------
    A : Array (n, n)
        Symmetric matrix.
    floor
        Replaces smaller values on the diagonal before the scaling.

    Raises
    ------
    LinAlgError
        If the eigenvalues do not converge. NaN in A may raise it too, or give eigenvalues that are NaN.
    """
    scaled, scale = unit_diagonal(A, floor)
    w, V = np.linalg.eigh(scaled)
    return ScaledEigen(w, V, scale)


def scaled_inverse(A: Array) -> Array:
    """Return the inverse (n, n) of a positive definite A (n, n).

    A is scaled to unit diagonal, inverted and scaled back, so that rounding errors do not depend on units. NaN, or a
    zero on the diagonal, gives NaN.

    Raises
    ------
    LinAlgError
        If A is exactly singular, with a positive diagonal.
    """
    scaled, scale = unit_diagonal(A)
    return np.asarray(np.linalg.inv(scaled) / np.outer(scale, scale))


def scaled_pseudo_inverse(A: Array) -> Array:
    """Return the Moore-Penrose pseudo-inverse (n, n) of A scaled to unit diagonal, scaled back.

    A (n, n) is symmetric, positive semidefinite, with a positive diagonal. For a regular A the result is the inverse.
    For a singular A it is in general not the pseudo-inverse of A itself, because that depends on units.
    """
    scaled, scale = unit_diagonal(A)
    return np.asarray(np.linalg.pinv(scaled, hermitian=True) / np.outer(scale, scale))


def covariance_root(P: Array, tolerance: float) -> Array:
    """Return a square root L (n, k) of a covariance P (n, n): ``L L' = P``, a direction of one deviation per column.

    Parameters
    ----------
    P : Array (n, n)
        Covariance with a positive diagonal.
    tolerance
        Directions whose scaled eigenvalue is at most this times the largest one are left out. k is therefore at most n,
        and ``L L'`` equals P only up to these directions.
    """
    w, V, scale = scaled_eigen(P)
    kept = w > tolerance * w.max(initial=0.0)
    return np.asarray(scale[:, None] * V[:, kept] * np.sqrt(w[kept]))
