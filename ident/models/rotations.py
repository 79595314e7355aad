"""Attitude of a boat in the signals of a model: lever arm of an antenna, and an AHRS with misaligned axes.

The functions are for models with measured roll, pitch and heading (`seatrial.ident.models.kinematic`). The matrices are
those of `seatrial.ident.numerics.rotations`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from seatrial.ident.model import Signals
from seatrial.ident.numerics import Matrix, matrix_product, rotate, transposed

G = 9.81  # m/s2


def set_orientation(s: Signals, R: Matrix, omega: Sequence[Any]) -> None:
    """Set the orientation of the boat: ``s.R``, the body rates ``s.p_rate, s.q_rate, s.r_rate``, and ``s.w``.

    Parameters
    ----------
    s : Signals
        Signals to change. The heave velocity ``s.w`` [m/s] is set such that the hull stays on the surface (z' = 0).
    R : Matrix (3, 3)
        Rotation from body axes to NED.
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
        Signals whose outputs ``x``, ``y`` [m] and ``vx``, ``vy`` [m/s] are changed. The orientation is set
        (`set_orientation`).
    arm : Sequence (3,)
        Position of the point from the origin: forward, to starboard and down [m].
    """
    (x, y, z), (p, q, r) = arm, (s.p_rate, s.q_rate, s.r_rate)
    about = (q * z - r * y, r * x - p * z, p * y - q * x)
    for axis, row in zip("xy", rotate(s.R, arm), strict=False):
        s.y[axis] = s.y[axis] + row
    for axis, row in zip(("vx", "vy"), rotate(s.R, about), strict=False):
        s.y[axis] = s.y[axis] + row


def remove_misalignment(s: Signals, mount: Matrix) -> None:
    """Convert the measured attitude and body rates of a misaligned AHRS to those of the boat.

    Parameters
    ----------
    s : Signals
        Signals with the orientation of the AHRS (`set_orientation`), which is replaced by the orientation of the boat.
    mount : Matrix (3, 3)
        Rotation of vectors from the axes of the AHRS to the axes of the boat.
    """
    set_orientation(s, matrix_product(s.R, transposed(mount)), rotate(mount, (s.p_rate, s.q_rate, s.r_rate)))


def add_misalignment(s: Signals, mount: Matrix) -> None:
    """Convert the outputs ``ax``, ``ay`` [m/s2] and ``r`` [rad/s] to what a misaligned AHRS measures.

    Parameters
    ----------
    s : Signals
        Signals with the orientation of the boat, whose outputs are changed. A model without the output ``r`` has only
        its accelerations changed. The vertical specific force, which the rotation needs, follows from zero vertical
        acceleration of the hull.
    mount : Matrix (3, 3)
        Rotation of vectors from the axes of the AHRS to the axes of the boat.
    """
    R, ax, ay = s.R, s.y["ax"], s.y["ay"]
    az = -(G + R[2][0] * ax + R[2][1] * ay) / R[2][2]
    own = transposed(mount)
    s.y["ax"], s.y["ay"], _ = rotate(own, (ax, ay, az))
    if "r" in s.y:
        s.y["r"] = s.y["r"] - s.x.r + rotate(own, (s.p_rate, s.q_rate, s.x.r))[2]
