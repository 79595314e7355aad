"""Loss of thrust in turns: propellers in oblique inflow, ventilated or in the wake of the hull."""

from __future__ import annotations

import math
from collections.abc import Callable

from seatrial.ident.model import (
    INF,
    SPEED_WIDTH,
    YAW_RATE_WIDTH,
    Effect,
    Estimates,
    ForceCurve,
    ModelFunction,
    Parameter,
    Signals,
    share_in_words,
    smooth_modulus,
)


def _thrust_reducer(parameter: str, variable: str) -> ModelFunction:
    """Return the hook (function of the model's signals) that divides each thrust in ``s.f`` by ``1 + p |variable|``.

    ``parameter`` is the name of the parameter p, and ``variable`` that of the state: ``r`` (yaw rate) or ``v`` (sway).
    The modulus is smoothed at zero.
    """

    width = YAW_RATE_WIDTH if variable == "r" else SPEED_WIDTH

    def lose(s: Signals) -> None:
        """Divide the thrust of each thruster in ``s.f`` by one plus the parameter times the modulus, in place."""
        modulus = smooth_modulus(getattr(s.x, variable), width)
        remaining = 1 / (1 + getattr(s.p, parameter) * modulus)
        for side, f in s.f.items():
            s.f[side] = f * remaining

    return lose


def _remaining(parameter: str, at: float, words: str) -> Callable[[Estimates], str]:
    """Return a function for ``Effect.in_words``: the share of the thrust that is left at one value of the variable.

    The value is ``at`` in SI units, and ``words`` in the clause, such as "30 deg/s of yaw rate".
    """

    def describe(estimates: Estimates) -> str:
        """Return the clause with the share."""
        loss, error = estimates[parameter]
        left = 1.0 / (1.0 + loss * at)
        return f"at {words}, {share_in_words(left, error * at * left**2)} % of the thrust is left"

    return describe


def _loss_effect(
    name: str, title: str, variable: str, parameter: Parameter, requires: tuple[str, ...], alternatives: tuple[str, ...]
) -> Effect:
    """Return the effect of a loss of thrust in turns: each thrust is divided by ``1 + parameter |variable|``.

    Parameters
    ----------
    name, title : str
        Name in the catalogue, and name in reports.
    variable : str
        State on which the loss depends: ``r`` (yaw rate) or ``v`` (sway speed).
    parameter : Parameter
        Relative loss of thrust per unit of the variable.
    requires : tuple[str, ...]
        Signals that the model must provide.
    alternatives : tuple[str, ...]
        Names of competing effects.
    """
    return Effect(
        name=name,
        title=title,
        place="actuator",
        hooks={"thrust_loss": _thrust_reducer(parameter.name, variable)},
        parameters=(parameter,),
        formula=f"f_i /= 1 + {parameter.name} |{variable}|",
        source="propellers in oblique inflow and ventilation, Carlton 2018, chapters 6 and 11",
        causes="propellers that draw air in turns, the hull in front of a propeller",
        experiment="straight runs and turning circles of several radii at the same shaft speeds",
        requires=requires,
        one_sided=True,
        alternatives=alternatives,
        parametric_form_of=ForceCurve("T", variable),
        in_words=_remaining(parameter.name, *EXAMPLES[variable]),
    )


EXAMPLES = {"r": (math.radians(30.0), "30 deg/s of yaw rate"), "v": (0.5, "0.5 m/s of sway")}
BY_YAW = Parameter(
    "loss_r", 0.0, "s/rad", "relative loss of thrust per yaw rate", prior=(0.0, 0.7), bounds=(0.0, INF), step=0.01
)
BY_SWAY = Parameter(
    "loss_v", 0.0, "s/m", "relative loss of thrust per sway speed", prior=(0.0, 3.0), bounds=(0.0, INF), step=0.05
)
EFFECTS = (
    _loss_effect(
        "turn-loss",
        "the loss of thrust with yaw rate",
        "r",
        BY_YAW,
        ("f",),
        ("inflow-loss", "turning-resistance", "sideslip", "advance-ratio", "cg-offset"),
    ),
    _loss_effect(
        "inflow-loss",
        "the loss of thrust in sway inflow",
        "v",
        BY_SWAY,
        ("f", "hull"),
        ("turn-loss", "turning-resistance", "cross-flow"),
    ),
)
