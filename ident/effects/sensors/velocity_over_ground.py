"""Errors of the velocity over ground relative to the positions of the same receiver: scale factor and course."""

from __future__ import annotations

from typing import Any

from seatrial.ident.model import Effect, Parameter, Signals, directed_in_sentence
from seatrial.ident.numerics import body_to_ned


def scale(s: Signals) -> None:
    """Multiply the outputs ``vx``, ``vy`` (velocity over ground) by ``1 + k_V``, in place.

    ``k_V`` is the relative scale error.
    """
    s.y["vx"], s.y["vy"] = s.y["vx"] * (1 + s.p.k_V), s.y["vy"] * (1 + s.p.k_V)


def turn(s: Signals) -> None:
    """Rotate the outputs ``vx``, ``vy`` clockwise by ``chi_0`` [rad], the offset of the course, in place."""
    s.y["vx"], s.y["vy"] = body_to_ned(s.p.chi_0, s.y["vx"], s.y["vy"])


COMMON: dict[str, Any] = {
    "place": "sensor",
    "experiment": "long straight runs at full speed, on opposite courses",
    "requires": ("hull", "ground_velocity"),
}
EFFECTS = (
    Effect(
        "velocity-scale",
        "a scale-factor error of the velocity over ground",
        {"axes": scale},
        (Parameter("k_V", 0.0, "", "relative scale-factor error of the velocity", prior=(0.0, 0.1), step=0.005),),
        formula="v_measured = (1 + k) v",
        source="units (knots for m/s, a nautical mile of 1.85 km), filters of slow receivers",
        causes="a unit in the import map (knots)",
        alternatives=("accelerometer-scale", "gnss-latency"),
        in_words=directed_in_sentence("k_V", "%", "the velocity over ground reads {}", "too high", "too low"),
        **COMMON,
    ),
    Effect(
        "velocity-course",
        "an offset of the course over ground",
        {"axes": turn},
        (Parameter("chi_0", 0.0, "rad", "offset of the course, clockwise", prior=(0.0, 0.1), step=0.01),),
        formula="course_measured = course + chi_0",
        source="a course relative to magnetic or grid north, with positions relative to true north",
        causes="velocities relative to magnetic or grid north",
        alternatives=("mount", "compass", "lever-arm"),
        in_words=directed_in_sentence("chi_0", "deg", "the course over ground reads {}", "too high", "too low"),
        **COMMON,
    ),
)
