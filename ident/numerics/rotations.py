"""Rotations between body axes and NED, and rotation matrices of zyx Euler angles.

Body axes are forward and to starboard (and down), NED is north, east (and down). Angles are in rad; the heading psi is
positive clockwise seen from above, and zero at north. All values may be numbers, arrays of samples or symbols.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

Matrix = list[list[Any]]


def body_to_ned(psi: Any, forward: Any, starboard: Any) -> tuple[Any, Any]:
    """Return the components north and east of a horizontal vector in body axes, at the heading psi [rad].

    ``forward`` and ``starboard`` are its components; psi is zero at north and positive clockwise. Roll and pitch do not
    count.
    """
    cos, sin = np.cos(psi), np.sin(psi)
    return cos * forward - sin * starboard, sin * forward + cos * starboard


def ned_to_body(psi: Any, north: Any, east: Any) -> tuple[Any, Any]:
    """Return the components forward and to starboard of a horizontal vector in NED, at the heading psi [rad].

    It is the inverse of `body_to_ned`; psi is zero at north and positive clockwise. Roll and pitch do not count.
    """
    cos, sin = np.cos(psi), np.sin(psi)
    return cos * north + sin * east, cos * east - sin * north


def rotation_matrix(phi: Any, theta: Any, psi: Any) -> Matrix:
    """Return the matrix R(psi) R(theta) R(phi), which rotates vectors from body axes to NED (Fossen 2011, eq. 2.18).

    Parameters
    ----------
    phi, theta, psi : float or symbol
        Roll, pitch and heading [rad], in the order zyx.

    Returns
    -------
    Matrix (3, 3)
        List of its rows.
    """
    (c_f, s_f), (c_t, s_t), (c_p, s_p) = ((np.cos(a), np.sin(a)) for a in (phi, theta, psi))
    return [
        [c_p * c_t, c_p * s_t * s_f - s_p * c_f, c_p * s_t * c_f + s_p * s_f],
        [s_p * c_t, s_p * s_t * s_f + c_p * c_f, s_p * s_t * c_f - c_p * s_f],
        [-s_t, c_t * s_f, c_t * c_f],
    ]


def rotate(R: Matrix, z: Sequence[Any]) -> list[Any]:
    """Return the product R z of a matrix (n, m) and a vector (m,), as a list (n,)."""
    return [sum(a * b for a, b in zip(row, z, strict=True)) for row in R]


def transposed(R: Matrix) -> Matrix:
    """Return the transpose of a matrix, a list of rows. The transpose of a rotation matrix is its inverse."""
    return [list(column) for column in zip(*R, strict=True)]


def matrix_product(A: Matrix, B: Matrix) -> Matrix:
    """Return the product A B (n, p) of two matrices (n, m) and (m, p), as a list of rows."""
    columns = transposed(B)
    return [rotate(columns, row) for row in A]
