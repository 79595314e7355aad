"""Lag of the measured heading behind the yaw rate and the position.

The heading of an AHRS or autopilot is the output of a filter and is sent later than the gyro's rate. In a turn it then
trails by the lag times the yaw rate. Without this effect in the model, the lag looks like a yaw rate that is measured
too early, like a compass deviation, or like added yaw inertia.
"""

from __future__ import annotations

from seatrial.ident.effects.sensors.compass import turn_body_velocity
from seatrial.ident.model import INF, Effect, Parameter, Signals, in_sentence


def trail(s: Signals) -> None:
    """Delay the output of the heading by its lag ``T_psi`` [s], in place.

    The heading error is ``-T_psi r``, the first order of the delay. The output of the body velocity is rotated by the
    same angle.
    """
    behind = -s.p.T_psi * s.x.r
    s.y["psi"] = s.y["psi"] + behind
    turn_body_velocity(s, behind)


EFFECT = Effect(
    name="heading-lag",
    title="the lag of the heading",
    place="sensor",
    hooks={"axes": trail},
    parameters=(
        Parameter(
            "T_psi", 0.0, "s", "lag of the heading", prior=(0.0, 0.2), bounds=(0.0, INF), step=0.02, scales=False
        ),
    ),
    formula="psi_measured = psi - T_psi r; (u, v) rotated by -T_psi r",
    source="first order of a delay and of any low-pass filter; complementary filter of an AHRS (Mahony et al. 2008)",
    experiment="turns on the spot that begin and end hard, in both directions",
    requires=("hull",),
    one_sided=True,
    alternatives=("filter-lag", "compass-filtered"),
    in_words=in_sentence("T_psi", "s", "the heading is {} late"),
)
