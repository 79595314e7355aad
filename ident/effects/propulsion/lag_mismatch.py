"""Lag of the thrust that differs between the left and the right thruster.

With measured shaft speeds or given thrusts, each thruster has a first-order lag with a time constant of its own. With
commands as inputs, the shafts of the model have a lag already, with the time constant ``T_n``. The effect then makes
``T_n`` the mean of both sides. Its parameter is the difference. Two further lags could not be told from ``T_n``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from seatrial.ident.effects.propulsion.thrust_history import FULL, GIVEN, MEASURED
from seatrial.ident.model import Effect, Parameter, Signals, State, size_in_words
from seatrial.ident.models import SHORTEST_LAG, SIDES, first_order

# A score test sees the slope at a time constant of zero. The response of a lag of 0.05 s has little in common with that
# of a lag of a second: for a true lag of 0.9 s, the slope promised 0.09 s and a tenth of the gain. Below this value the
# response is a weighted mean of the signal and its lag of 0.4 s, with the right mean delay (`first_order`).
SHORTEST_OWN_LAG = 0.4  # s
# A small lead is possible where telemetry is later than the thrust. It also keeps the estimate for a thruster without a
# lag away from a bound, at which it would have no standard error and the effect no sure name.
LARGEST_LEAD = 0.2  # s
SIGNS = (-1, 1)  # left, right
EXPERIMENT = "steps of equal commands ahead and astern: the boat turns towards the slower side while the thrust changes"
CAUSES = (
    "a speed controller with a ramp or another setting than the other one, a weak or damaged motor, a rubbing shaft, "
    "a line around it"
)
SOURCE = "motor and inflow dynamics, Blanke, Lindegaard and Fossen 2000; ramps of speed controllers"


def compare_sides(estimates: Mapping[str, tuple[float, float]]) -> str:
    """Return a clause for reports: the time constant with which each thruster follows.

    Parameters
    ----------
    estimates : Mapping[str, tuple[float, float]]
        Estimate and standard error by parameter. Only ``T_lag_left`` and ``T_lag_right`` [s] are used.
    """
    left, right = (size_in_words(*estimates[f"T_lag_{side}"], "s") for side in SIDES)
    return f"the left thruster follows with {left}, the right one with {right}"


def compare_shafts(estimates: Mapping[str, tuple[float, float]]) -> str:
    """Return a clause for reports: the time constant with which each shaft follows its command.

    Parameters
    ----------
    estimates : Mapping[str, tuple[float, float]]
        Estimate and standard error by parameter. Only ``T_n`` and ``dT_n`` [s] are used: the mean of both time
        constants, and that of the right shaft less that of the left one.
    """
    (mean, _), (difference, error) = estimates["T_n"], estimates["dT_n"]
    left, right = (max(mean + sign * difference / 2, 0.0) for sign in SIGNS)
    return (
        f"the left thruster follows its command with {left:.2f} s, the right one with {right:.2f} s, a difference "
        f"of {size_in_words(abs(difference), error, 's')}"
    )


def spread(s: Signals) -> None:
    """Let each shaft follow its command with its own time constant: ``T_n`` less half ``dT_n`` left, plus half right.

    Replace the shaft speeds ``s.n`` and the rates of their states. A time constant below zero counts as zero.
    """
    for side, sign in zip(SIDES, SIGNS, strict=True):
        name = f"n_{side}"
        # the signal before the lag, from the rate with the common time constant (`first_order`)
        reference = getattr(s.x, name) + s.rate[name] * np.maximum(s.p.T_n, SHORTEST_LAG)
        s.n[side] = first_order(s, name, reference, np.maximum(s.p.T_n + sign * s.p.dT_n / 2, 0.0))


def _lag_effect(
    name: str, title: str, quantity: Literal["n", "f"], requires: tuple[str, ...], **described: Any
) -> Effect:
    """Return the effect of a first-order lag of each shaft speed or thrust, with its own time constant of up to 3 s.

    Parameters
    ----------
    name, title : str
        Name in the catalogue, and name in reports.
    quantity : "n" or "f"
        Signal that passes the lag: shaft speeds or thrusts.
    requires : tuple[str, ...]
        Signals that the model must provide.
    described
        Further fields of the `Effect`.
    """

    def lagged(s: Signals) -> None:
        """Replace the shaft speeds ``s.n`` or thrusts ``s.f`` by their values after the lags, in place.

        Set the rates of the states ``slow_SIDE``. With a time constant of zero nothing is replaced.
        """
        bag = s.n if quantity == "n" else s.f
        for side in SIDES:
            own = getattr(s.p, f"T_lag_{side}")
            bag[side] = first_order(s, f"slow_{side}", bag[side], own, SHORTEST_OWN_LAG)

    full, unit = FULL[quantity], "N" if quantity == "f" else ""
    return Effect(
        name,
        title,
        {"side_lag": lagged},
        tuple(
            Parameter(
                f"T_lag_{side}",
                0.0,
                "s",
                f"time constant of the thrust, {side}",
                prior=(0.0, 0.7),
                bounds=(-LARGEST_LEAD, 3.0),
                step=0.05,
                scales=False,
            )
            for side in SIDES
        ),
        states=tuple(
            State(f"slow_{side}", unit, f"{side} thruster, after its own lag", 1e-3 * full, sd0=0.1 * full)
            for side in SIDES
        ),
        place="actuator",
        source=SOURCE,
        causes=CAUSES,
        experiment=EXPERIMENT,
        requires=requires,
        in_words=compare_sides,
        **described,
    )


TITLE = "one thruster that follows its command more slowly than the other"
EFFECTS = (
    _lag_effect(
        "lag-mismatch",
        TITLE,
        "n",
        MEASURED,
        formula="T_i n_eff' = n_i - n_eff, i the left and the right thruster",
        alternatives=("delay", "mismatch"),
        nests=("lag",),
    ),
    _lag_effect(
        "force-lag-mismatch",
        f"{TITLE}, in a model driven by forces",
        "f",
        GIVEN,
        formula="T_i f_eff' = f_i - f_eff, i the left and the right thruster",
        alternatives=("force-delay", "mismatch"),
        nests=("force-lag",),
    ),
    Effect(
        "shaft-lag-mismatch",
        f"{TITLE}, in a model driven by commands",
        {"shaft": spread},
        (
            Parameter(
                "dT_n",
                0.0,
                "s",
                "time constant of the right shaft less that of the left one",
                prior=(0.0, 0.7),
                bounds=(-3.0, 3.0),
                step=0.05,
                scales=False,
            ),
        ),
        place="actuator",
        formula="T_L = T_n - dT_n / 2, T_R = T_n + dT_n / 2",
        source=SOURCE,
        causes=CAUSES,
        experiment=EXPERIMENT,
        requires=("n_state",),
        alternatives=("mismatch", "yaw-bias"),
        in_words=compare_shafts,
    ),
)
