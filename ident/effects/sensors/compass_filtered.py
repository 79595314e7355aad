"""Compass deviation behind the heading filter of an AHRS or autopilot.

The filter integrates its gyro, and the compass corrects it with a time constant. The estimated heading therefore has
the mean deviation of the headings of the last seconds. In a turn, this deviation is delayed. Without the filter in the
model, the delay looks like magnetic interference of the motors, because the motors run while the boat turns.
"""

from __future__ import annotations

import math

from seatrial.ident.effects.sensors.compass import heading_terms, turn_body_velocity
from seatrial.ident.model import Effect, Estimates, Parameter, Signals, State, directed_size, largest_of_headings

TERMS = (("1s", "sin psi", 0.15), ("1c", "cos psi", 0.15), ("2s", "sin 2 psi", 0.05), ("2c", "cos 2 psi", 0.05))


def _set_filter_rate(s: Signals) -> None:
    """Set the rate of the filter state of the compass deviation [rad/s], in place.

    The deviation D is a sum of sin psi, cos psi, sin 2psi and cos 2psi, and passes a first-order filter with the time
    constant ``T_head``. The state is D less D after the filter. On a constant heading it decays to zero.
    """
    p = s.p
    sin, cos, sin_2, cos_2 = heading_terms(s.x.psi)
    slope = p.dev_f1s * cos - p.dev_f1c * sin + 2.0 * (p.dev_f2s * cos_2 - p.dev_f2c * sin_2)
    s.rate["dev_behind"] = slope * s.x.r - s.x.dev_behind / p.T_head


def _add_deviation(s: Signals) -> None:
    """Add the error of the filtered heading, which the compass deviation causes, to the heading output [rad], in place.

    The error is the output of the heading filter if its input is the compass deviation: the deviation less the state
    ``dev_behind`` (`_set_filter_rate`). The output of the body velocity is rotated by the same angle, because it was
    computed with the erroneous heading.
    """
    p = s.p
    sin, cos, sin_2, cos_2 = heading_terms(s.x.psi)
    deviation = p.dev_f1s * sin + p.dev_f1c * cos + p.dev_f2s * sin_2 + p.dev_f2c * cos_2 - s.x.dev_behind
    s.y["psi"] = s.y["psi"] + deviation
    turn_body_velocity(s, deviation)


def largest(estimates: Estimates) -> str:
    """Return a clause for reports: the largest deviation of the heading [deg], and the heading at which it occurs."""
    deviation, error, heading = largest_of_headings(estimates, [f"dev_f{name}" for name, *_ in TERMS])
    size = directed_size((math.degrees(deviation), math.degrees(error)), "deg", "too high", "too low")
    return f"the heading reads at most {size}, on heading {heading} deg"


EFFECT = Effect(
    name="compass-filtered",
    title="compass deviation behind a heading filter",
    place="sensor",
    hooks={"rate": _set_filter_rate, "axes": _add_deviation},
    parameters=(
        *(
            Parameter(f"dev_f{name}", 0.0, "rad", f"amplitude of {f}", prior=(0.0, sd), step=0.01)
            for name, f, sd in TERMS
        ),
        Parameter(
            "T_head",
            3.0,
            "s",
            "time constant of the heading filter",
            "log",
            prior=(3.0, 3.0),
            bounds=(0.3, 100.0),
            scales=False,
        ),
    ),
    states=(State("dev_behind", "rad", "compass deviation less its value after the heading filter", 0.0, sd0=0.01),),
    formula="psi_measured = psi + delta, T delta' = dev_f1s sin psi + dev_f1c cos psi + dev_f2s sin 2psi "
    "+ dev_f2c cos 2psi - delta; (u, v) rotated by delta",
    source="compass adjusters' coefficients B to E behind a complementary filter (Mahony, Hamel and Pflimlin 2008)",
    causes="iron or magnets near the compass, a calibration that was made outside the boat",
    experiment="swinging the compass: slow turns through all headings, in both directions, and the same fast",
    requires=("hull",),
    scan={"T_head": (1.0, 3.0, 8.0)},
    nests=("compass",),
    alternatives=("compass", "compass-motor"),
    in_words=largest,
)
