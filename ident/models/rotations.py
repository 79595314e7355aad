"""Rotation matrices of zyx Euler angles, for the lever arm and the misaligned AHRS of a boat with measured attitude.

Source: Fossen 2011, eq. 2.18. Entries are scalars or symbols. A matrix is a list of its rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from seatrial.ident.model import Signals

G = 9.81  # m/s2
Matrix = list[list[Any]]


def rotation(phi: Any, theta: Any, psi: Any) -> Matrix:
    """Return the rotation matrix R(psi) R(theta) R(phi) from the rotated axes to the original axes. Angles in rad."""
    (c_f, s_f), (c_t, s_t), (c_p, s_p) = ((np.cos(a), np.sin(a)) for a in (phi, theta, psi))
    return [
        [c_p * c_t, c_p * s_t * s_f - s_p * c_f, c_p * s_t * c_f + s_p * s_f],
        [s_p * c_t, s_p * s_t * s_f + c_p * c_f, s_p * s_t * c_f - c_p * s_f],
        [-s_t, c_t * s_f, c_t * c_f],
    ]


def turned(R: Matrix, z: Sequence[Any]) -> list[Any]:
    """Return the product R z."""
    return [sum(a * b for a, b in zip(row, z, strict=True)) for row in R]


def transposed(R: Matrix) -> Matrix:
    """Return the transposed matrix."""
    return [list(column) for column in zip(*R, strict=True)]


def oriented(s: Signals, R: Matrix, omega: Sequence[Any]) -> None:
    """Set the orientation of the boat.

    Parameters
    ----------
    s : Signals
        Signals whose orientation is set. The heave velocity w [m/s] is set such that the hull stays on the surface
        (z' = 0).
    R : Matrix (3, 3)
        Rotation from the body frame to NED.
    omega : Sequence (3,)
        Body rates p, q, r [rad/s].
    """
    s.R = R
    s.p_rate, s.q_rate, s.r_rate = omega
    s.w = -(R[2][0] * s.x.u + R[2][1] * s.x.v) / R[2][2]


def shift(s: Signals, arm: Sequence[Any]) -> None:
    """Move the measured position and velocity over ground to another point of the hull (Groves 2013, 2.5).

    Parameters
    ----------
    s : Signals
        Signals whose outputs are changed.
    arm : Sequence (3,)
        Position of the point from the origin: forward, to starboard and down [m].
    """
    (x, y, z), (p, q, r) = arm, (s.p_rate, s.q_rate, s.r_rate)
    about = (q * z - r * y, r * x - p * z, p * y - q * x)
    for axis, row in zip("xy", turned(s.R, arm), strict=False):
        s.y[axis] = s.y[axis] + row
    for axis, row in zip(("vx", "vy"), turned(s.R, about), strict=False):
        s.y[axis] = s.y[axis] + row


def unmount(s: Signals, mount: Matrix) -> None:
    """Convert attitude and body rates of an AHRS to those of the boat.

    ``mount`` rotates vectors from the axes of the AHRS to the axes of the boat.
    """
    oriented(s, _product(s.R, transposed(mount)), turned(mount, (s.p_rate, s.q_rate, s.r_rate)))


def mounted(s: Signals, mount: Matrix) -> None:
    """Convert specific force and yaw rate of the boat to the measurements of a misaligned AHRS.

    ``mount`` is as in `unmount`. The vertical specific force, which the rotation needs, follows from zero vertical
    acceleration of the hull.
    """
    R, ax, ay = s.R, s.y["ax"], s.y["ay"]
    az = -(G + R[2][0] * ax + R[2][1] * ay) / R[2][2]
    own = transposed(mount)
    s.y["ax"], s.y["ay"], _ = turned(own, (ax, ay, az))
    if "r" in s.y:
        s.y["r"] = s.y["r"] - s.x.r + turned(own, (s.p_rate, s.q_rate, s.x.r))[2]


def _product(A: Matrix, B: Matrix) -> Matrix:
    columns = transposed(B)
    return [turned(columns, row) for row in A]
