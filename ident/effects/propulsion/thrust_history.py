"""Thrust dynamics: a pure delay, or a further first-order lag, of the measured or given input.

The delay works on delayed copies of the input (``NAME~k``: the input k steps of 0.1 s earlier, held as the input is),
between which it is cubic (``seatrial.ident.models.horizontal.shift_in_time``). The lag is a state of each thruster.
Both have their own place in the thruster's chain, so that it does not matter which was added first, and a derivative at
zero.

Of a Nomoto model, which is integrated back to a late fix and a late gyro, the lag is approximate while thrust changes:
what its thrust and steering were then differs from now by what the inputs alone would make of it, at once. Over a fix
of ``tau_gnss`` that is as if the lag had no memory; where inputs are steady it is exact.
"""

from __future__ import annotations

from typing import Any, Literal

from seatrial.ident.model import Effect, Input, Parameter, Signals, State
from seatrial.ident.models import SIDES, first_order, shift_in_time

N_DELAY = 8
FULL = {"n": 1.0, "f": 40.0}  # of an input
Quantity = Literal["n", "f"]


def _delay(name: str, quantity: Quantity, requires: tuple[str, ...], **described: Any) -> Effect:
    def late(s: Signals) -> None:
        shift_in_time(s, quantity)

    now = [Input(f"{quantity}_{side}", "", "linear") for side in SIDES]
    return Effect(
        name,
        "a thrust delay",
        {"shaft": late},
        (
            Parameter(
                "tau_delay",
                0.0,
                "s",
                "delay of the thrust",
                prior=(0.0, 0.5),
                bounds=(0.0, 0.75),
                step=0.05,
                scales=False,
            ),
        ),
        inputs=tuple(i.delayed(k) for i in now for k in range(1, N_DELAY + 1)),
        place="actuator",
        formula="n_eff(t) = n(t - tau)",
        source="links and speed controllers; MEDUSA's simulator has 0.345 s",
        experiment=EXPERIMENT,
        requires=requires,
        one_sided=True,
        **described,
    )


def _lag(name: str, title: str, quantity: Quantity, requires: tuple[str, ...], **described: Any) -> Effect:
    def lagged(s: Signals) -> None:
        bag = s.n if quantity == "n" else s.f
        for side in bag:
            bag[side] = first_order(s, f"late_{side}", bag[side], s.p.T_lag)

    full, unit = FULL[quantity], "N" if quantity == "f" else ""
    return Effect(
        name,
        title,
        {"thrust_lag": lagged},
        (
            Parameter(
                "T_lag",
                0.0,
                "s",
                "time constant of the thrust",
                prior=(0.0, 0.5),
                bounds=(0.0, 1.2),
                step=0.05,
                scales=False,
            ),
        ),
        states=tuple(
            State(f"late_{side}", unit, f"{side}, behind its lag", 1e-3 * full, sd0=0.1 * full) for side in SIDES
        ),
        place="actuator",
        formula="T n_eff' = n - n_eff",
        source="motor and inflow dynamics; Blanke, Lindegaard and Fossen 2000",
        experiment=EXPERIMENT,
        requires=requires,
        one_sided=True,
        **described,
    )


EXPERIMENT = "chirp of both thrusters: a delay shifts the phase without limit, a lag by at most 90 degrees"
MEASURED, GIVEN = ("n", "f", "n_input"), ("f_input",)
EFFECTS = (
    # with a hull: a Nomoto model has a delay of its own
    _delay("delay", "n", (*MEASURED, "hull"), alternatives=("lag", "gnss-latency")),
    _lag("lag", "a first-order thrust lag behind the shaft", "n", MEASURED, alternatives=("delay",)),
    _delay("force-delay", "f", GIVEN, alternatives=("force-lag",)),
    _lag("force-lag", "a first-order thrust lag", "f", GIVEN, alternatives=("force-delay",)),
)
