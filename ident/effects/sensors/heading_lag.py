"""Lag of the measured heading behind the yaw rate and the position.

The heading of an AHRS or autopilot is the output of a filter and is sent later than the gyro's rate. In a turn it then
trails by the lag times the yaw rate. Without this effect in the model, the lag looks like a yaw rate that is measured
too early, like a compass deviation, or like added yaw inertia.

While a turn begins or ends, the second order of the lag matters. It is ``kappa T_psi^2 r'``, with kappa 1/2 for a pure
delay and 1 for a filter of first order: 0.3 to 0.7 deg for a lag of 0.12 s and a yaw acceleration of 0.8 rad/s^2. Most
lags are a filter and a delay together, so that `CURVATURE`, their mean, is taken. Without this order, the error looks
like a heading that depends on the difference of the thrusters.
"""

from __future__ import annotations

from seatrial.ident.effects.sensors.compass import turn_body_velocity
from seatrial.ident.model import INF, Effect, Parameter, Signals, in_sentence

CURVATURE = 0.75  # factor of T_psi^2 r' in the heading error: between that of a delay and that of a filter


def trail(s: Signals) -> None:
    """Delay the output of the heading by its lag ``T_psi`` [s], in place.

    The heading error is ``-T_psi r + CURVATURE T_psi^2 r'``, the first two orders of the lag. The output of the body
    velocity is rotated by the same angle.
    """
    T = s.p.T_psi
    behind = T * (CURVATURE * T * s.rate["r"] - s.x.r)
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
    formula="psi_measured = psi - T_psi r + 3/4 T_psi^2 r'; (u, v) rotated by the same angle",
    source="second order between that of a delay (1/2) and of a low-pass filter of first order (1); complementary "
    "filter of an AHRS (Mahony et al. 2008)",
    experiment="turns on the spot that begin and end hard, in both directions",
    requires=("hull",),
    one_sided=True,
    alternatives=("filter-lag", "compass-filtered"),
    in_words=in_sentence("T_psi", "s", "the heading is {} late"),
)
