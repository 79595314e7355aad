"""Compass deviation: heading error as a function of heading (hard and soft iron).

The error is the measured heading less the true heading. Compass adjusters define deviation as magnetic heading less
compass heading, positive to the east. Their coefficients therefore have the opposite sign.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from seatrial.ident.model import Effect, Estimates, Parameter, Signals, directed_size, largest_of_headings


def turn_body_velocity(s: Signals, angle: Any) -> None:
    """Rotate the output of the body velocity by a heading error, in place.

    The result has the components along axes that are turned clockwise by the error: u becomes ``cos u + sin v``, and v
    becomes ``cos v - sin u``. Use this function for a body velocity that was computed from the velocity over ground and
    the erroneous heading.

    Parameters
    ----------
    s : Signals
        Signals whose outputs u, v [m/s] are changed.
    angle : float or symbol
        Measured less true heading [rad].
    """
    cos, sin = np.cos(angle), np.sin(angle)
    s.y["u"], s.y["v"] = cos * s.y["u"] + sin * s.y["v"], -sin * s.y["u"] + cos * s.y["v"]


def heading_terms(psi: Any) -> tuple[Any, Any, Any, Any]:
    """Return sin psi, cos psi, sin 2psi and cos 2psi of a heading psi [rad], a number, an array or a symbol.

    The last two follow from the first two, because trigonometric functions of arrays take most of the time here.
    """
    sin, cos = np.sin(psi), np.cos(psi)
    return sin, cos, 2 * sin * cos, 1 - 2 * sin * sin


def deviate(s: Signals) -> None:
    """Add the compass deviation to the output of the heading [rad], in place.

    Rotate the output of the body velocity by the same angle.

    The deviation is ``dev_s sin psi + dev_c cos psi + dev_2s sin 2psi + dev_2c cos 2psi`` at the true heading psi.
    """
    p = s.p
    sin, cos, sin_2, cos_2 = heading_terms(s.x.psi)
    deviation = p.dev_s * sin + p.dev_c * cos + p.dev_2s * sin_2 + p.dev_2c * cos_2
    s.y["psi"] = s.y["psi"] + deviation
    turn_body_velocity(s, deviation)


def largest(estimates: Estimates) -> str:
    """Return a clause for reports: the largest deviation of the heading [deg], and the heading at which it occurs."""
    deviation, error, heading = largest_of_headings(estimates, ("dev_s", "dev_c", "dev_2s", "dev_2c"))
    size = directed_size((math.degrees(deviation), math.degrees(error)), "deg", "too high", "too low")
    return f"the heading reads at most {size}, on heading {heading} deg"


EFFECT = Effect(
    name="compass",
    title="compass deviation",
    place="sensor",
    hooks={"axes": deviate},
    parameters=(
        Parameter("dev_s", 0.0, "rad", "amplitude of sin psi (minus coefficient B)", prior=(0.0, 0.15), step=0.01),
        Parameter("dev_c", 0.0, "rad", "amplitude of cos psi (minus coefficient C)", prior=(0.0, 0.15), step=0.01),
        Parameter("dev_2s", 0.0, "rad", "amplitude of sin 2 psi (minus coefficient D)", prior=(0.0, 0.05), step=0.01),
        Parameter("dev_2c", 0.0, "rad", "amplitude of cos 2 psi (minus coefficient E)", prior=(0.0, 0.05), step=0.01),
    ),
    formula="psi_measured = psi + dev_s sin psi + dev_c cos psi + dev_2s sin 2psi + dev_2c cos 2psi",
    source="compass adjusters' coefficients B to E, their sign reversed; Bowditch, chapter 6",
    causes="iron or magnets near the compass, a calibration that was made outside the boat",
    experiment="swinging the compass: slow turns through all headings, in both directions",
    requires=("hull",),
    alternatives=("mount", "gyro-scale", "wind", "compass-filtered"),
    in_words=largest,
)
