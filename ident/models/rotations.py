"""Attitude of a boat in a model: lever arm of a GNSS antenna, and an AHRS whose axes are misaligned with the boat's.

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
    """Set the orientation of the boat, its body rates and its heave velocity in the signals of a model.

    Parameters
    ----------
    s : Signals
        Signals, changed in place: the rotation ``s.R``, the body rates ``s.p_rate``, ``s.q_rate``, ``s.r_rate``
        [rad/s], and the heave velocity ``s.w`` [m/s]. ``s.w`` follows from surge ``s.x.u`` and sway ``s.x.v``, such
        that the hull stays on the water surface (zero vertical velocity).
    R : Matrix (3, 3)
        Rotation of vectors from the body frame to NED.
    omega : Sequence (3,)
        Body rates p, q, r [rad/s].
    """
    s.R = R
    s.p_rate, s.q_rate, s.r_rate = omega
    s.w = -(R[2][0] * s.x.u + R[2][1] * s.x.v) / R[2][2]


def shift(s: Signals, arm: Sequence[Any]) -> None:
    """Move the model's outputs of position and velocity over ground from the origin to another point of the hull.

    The equations are those of Groves 2013, section 2.5. The point is, for example, the GNSS antenna.

    Parameters
    ----------
    s : Signals
        Signals with a known orientation (`set_orientation`). Their outputs ``x``, ``y`` [m] and ``vx``, ``vy`` [m/s]
        are changed in place.
    arm : Sequence (3,)
        Position of the point relative to the origin: forward, to starboard and down [m]. The height
        has an influence only while the boat rolls or pitches.
    """
    (x, y, z), (p, q, r) = arm, (s.p_rate, s.q_rate, s.r_rate)
    about = (q * z - r * y, r * x - p * z, p * y - q * x)
    for axis, row in zip("xy", rotate(s.R, arm), strict=False):
        s.y[axis] = s.y[axis] + row
    for axis, row in zip(("vx", "vy"), rotate(s.R, about), strict=False):
        s.y[axis] = s.y[axis] + row


def remove_misalignment(s: Signals, mount: Matrix) -> None:
    """Convert the attitude and body rates that a misaligned AHRS measured to those of the boat.

    Parameters
    ----------
    s : Signals
        Signals with the orientation and body rates of the AHRS (`set_orientation`). They are replaced in place by those
        of the boat.
    mount : Matrix (3, 3)
        Rotation of vectors from the axes of the AHRS to the axes of the boat.
    """
    set_orientation(s, matrix_product(s.R, transposed(mount)), rotate(mount, (s.p_rate, s.q_rate, s.r_rate)))


def add_misalignment(s: Signals, mount: Matrix) -> None:
    """Convert the outputs ``ax``, ``ay`` [m/s2] and ``r`` [rad/s] from the boat's axes to those of a misaligned AHRS.

    Parameters
    ----------
    s : Signals
        Signals with the orientation and body rates of the boat (`set_orientation`). Their outputs are changed in place.
        The output ``r`` may be absent. An error that ``r`` already has, such as a gyro offset, is kept.
    mount : Matrix (3, 3)
        Rotation of vectors from the axes of the AHRS to the axes of the boat.

    Notes
    -----
    The rotation needs the vertical specific force. It is computed for a hull without vertical acceleration.
    """
    R, ax, ay = s.R, s.y["ax"], s.y["ay"]
    az = -(G + R[2][0] * ax + R[2][1] * ay) / R[2][2]
    own = transposed(mount)
    s.y["ax"], s.y["ay"], _ = rotate(own, (ax, ay, az))
    if "r" in s.y:
        s.y["r"] = s.y["r"] - s.x.r + rotate(own, (s.p_rate, s.q_rate, s.x.r))[2]
