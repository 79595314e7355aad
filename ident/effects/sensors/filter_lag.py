"""First-order lags of a yaw rate and of body velocities: low-pass filters, estimates of an autopilot, late stamps."""

from __future__ import annotations

import numpy as np

from seatrial.ident.model import INF, Effect, Parameter, Signals, in_sentence


def lag_yaw_rate(s: Signals) -> None:
    """Delay the output of the yaw rate ``r`` by its lag ``T_r`` [s], in place.

    The lag is of first order: lag times rate of change is subtracted.
    """
    s.y["r"] = s.y["r"] - s.p.T_r * s.rate["r"]


def lag_velocity(s: Signals) -> None:
    """Delay the outputs of the body velocities ``u`` and ``v`` by their lag ``T_uv`` [s], in place.

    The lag is of first order: lag times rate of change is subtracted. ``u`` and ``v`` are over ground, so their rates
    include the rotation of the current in the body frame.
    """
    x, T = s.x, s.p.T_uv
    cos, sin = np.cos(x.psi), np.sin(x.psi)
    V_x, V_y = getattr(s.p, "V_x", 0.0), getattr(s.p, "V_y", 0.0)
    # rates of the velocity over ground: in the body frame, the current rotates as the boat turns
    du = s.rate["u"] + x.r * (-sin * V_x + cos * V_y)
    dv = s.rate["v"] - x.r * (cos * V_x + sin * V_y)
    s.y["u"], s.y["v"] = s.y["u"] - T * du, s.y["v"] - T * dv


SOURCE = "first order of a delay and of any low-pass filter; autopilot state estimators"
EXPERIMENT = "chirp of thrust and of thrust difference"
EFFECTS = (
    Effect(
        name="filter-lag",
        title="the lag of the yaw rate",
        place="sensor",
        hooks={"output": lag_yaw_rate},
        parameters=(
            Parameter(
                "T_r", 0.0, "s", "lag of the yaw rate", prior=(0.0, 0.3), bounds=(0.0, INF), step=0.02, scales=False
            ),
        ),
        formula="r_measured = r - T_r r'",
        source=SOURCE,
        experiment=EXPERIMENT,
        requires=("hull",),
        one_sided=True,
        alternatives=("lag", "delay", "heading-lag"),
        in_words=in_sentence("T_r", "s", "the yaw rate is {} late"),
    ),
    Effect(
        name="velocity-lag",
        title="the lag of the body velocities",
        place="sensor",
        hooks={"output": lag_velocity},
        parameters=(
            Parameter(
                "T_uv",
                0.0,
                "s",
                "lag of the body velocities",
                prior=(0.0, 0.3),
                bounds=(0.0, INF),
                step=0.02,
                scales=False,
            ),
        ),
        formula="u_measured = u - T_uv u', v_measured = v - T_uv v'",
        source=SOURCE,
        experiment=EXPERIMENT,
        requires=("hull", "body_velocity"),
        one_sided=True,
        alternatives=("lag", "delay", "filter-lag"),
        in_words=in_sentence("T_uv", "s", "the body velocities are {} late"),
    ),
)
