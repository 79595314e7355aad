"""Mounting misalignment of the AHRS: in yaw alone, or in roll, pitch and yaw."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from seatrial.ident.effects.sensors.compass import turn_body_velocity
from seatrial.ident.model import Effect, Estimates, Parameter, Signals, directed_in_sentence, directed_size
from seatrial.ident.models import rotations
from seatrial.ident.numerics import Matrix, rotation_matrix


def turn(s: Signals) -> None:
    """Rotate the outputs of heading, body velocity and accelerations by the yaw misalignment of the AHRS, in place.

    The misalignment is ``psi_mount`` [rad], clockwise: the output of the heading becomes the true heading plus
    ``psi_mount``, and velocity and accelerations become those along axes that are turned by it. This is for models
    without roll and pitch.
    """
    cos, sin = np.cos(s.p.psi_mount), np.sin(s.p.psi_mount)
    s.y["psi"] = s.y["psi"] + s.p.psi_mount
    turn_body_velocity(s, s.p.psi_mount)
    s.y["ax"], s.y["ay"] = cos * s.y["ax"] + sin * s.y["ay"], -sin * s.y["ax"] + cos * s.y["ay"]


def _mounting_rotation(s: Signals) -> Matrix:
    """Return the rotation matrix (3, 3) from the axes of the AHRS to those of the boat.

    Its angles are the parameters ``phi_mount``, ``theta_mount`` and ``psi_mount``: misalignment in roll, pitch and yaw.
    """
    return rotation_matrix(s.p.phi_mount, s.p.theta_mount, s.p.psi_mount)


def correct_attitude(s: Signals) -> None:
    """Convert the measured attitude and body rates, which are inputs of the model, to those of the boat, in place.

    The axes of the AHRS are misaligned with those of the boat by ``phi_mount``, ``theta_mount`` and ``psi_mount``
    (parameters). The heave velocity is computed again.
    """
    rotations.remove_misalignment(s, _mounting_rotation(s))


def rotate_inertial(s: Signals) -> None:
    """Convert the accelerations and yaw rate of the boat to the outputs of an AHRS with misaligned axes, in place.

    The misalignment in roll, pitch and yaw is given by the parameters ``phi_mount``, ``theta_mount`` and ``psi_mount``.
    """
    rotations.add_misalignment(s, _mounting_rotation(s))


PSI = Parameter("psi_mount", 0.0, "rad", "yaw misalignment of the AHRS, clockwise", prior=(0.0, 0.15), step=0.01)
TILT = tuple(
    Parameter(f"{angle}_mount", 0.0, "rad", f"{axis} misalignment of the AHRS", prior=(0.0, 0.05), step=0.01)
    for angle, axis in (("phi", "roll"), ("theta", "pitch"))
)
COMMON: dict[str, Any] = {
    "place": "sensor",
    "source": "boresight alignment, Groves 2013, section 5.6",
    "causes": "an AHRS that is turned on its mount, magnetic in place of true north",
    "alternatives": ("compass", "wind"),
}


def angles(estimates: Estimates) -> str:
    """Return a clause for reports: how the AHRS is turned in yaw, roll and pitch [deg] from the axes of the boat."""
    directions = (
        ("psi_mount", "clockwise", "anticlockwise"),
        ("phi_mount", "in roll to starboard", "in roll to port"),
        ("theta_mount", "in pitch upwards", "in pitch downwards"),
    )
    sizes = [
        directed_size((math.degrees(estimates[n][0]), math.degrees(estimates[n][1])), "deg", *words)
        for n, *words in directions
    ]
    return f"the AHRS is mounted {sizes[0]}, {sizes[1]} and {sizes[2]}"


EFFECTS = (
    Effect(
        "mount",
        "a mounting misalignment of the AHRS in yaw",
        {"axes": turn},
        (PSI,),
        experiment="straight runs on opposite headings, with and against the current",
        in_words=directed_in_sentence("psi_mount", "deg", "the heading reads {}", "too high", "too low"),
        formula="psi_measured = psi + psi_0; accelerations rotated by psi_0",
        requires=("hull",),
        **COMMON,
    ),
    Effect(
        "mount-attitude",
        "a mounting misalignment of the AHRS",
        {"shaft": correct_attitude, "axes": rotate_inertial},
        (PSI, *TILT),
        formula="R_measured = R R_m; body rates and accelerations rotated by R_m', R_m of roll, pitch and psi_0",
        experiment="straight runs on opposite headings, with and against the current; turns while rolling and pitching",
        in_words=angles,
        requires=("attitude",),
        **COMMON,
    ),
)
