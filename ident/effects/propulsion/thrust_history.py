"""Thrust dynamics: a pure delay, or an additional first-order lag, of the measured or given input.

The delay uses delayed copies of the input (``NAME~k``: the input k steps of 0.1 s earlier, with the same hold). It
interpolates them by cubic convolution (``seatrial.ident.models.horizontal.shift_in_time``). The lag is a state of each
thruster. Delay and lag have separate stages in the chain of the thruster, so that the order in which the effects are
added does not matter. Both effects have a derivative at zero.

A Nomoto model is integrated back to the times of a GNSS fix and a gyro sample. In such a model the lag is approximate
while the thrust changes: the earlier thrust and steering differ from the present ones only by the direct influence of
the inputs. Over the age ``tau_gnss`` of a fix, the lag is thus ignored. The result is exact for constant inputs.
"""

from __future__ import annotations

from typing import Any, Literal

from seatrial.ident.model import Effect, Input, Parameter, Signals, State, in_sentence
from seatrial.ident.models import SIDES, first_order, shift_in_time

N_DELAY = 8
FULL = {"n": 1.0, "f": 40.0}  # full shaft speed (normalised) and typical full thrust [N]
Quantity = Literal["n", "f"]


def _delay_effect(name: str, quantity: Quantity, requires: tuple[str, ...], **described: Any) -> Effect:
    """Return the effect of a delay of 0 to 0.75 s of the shaft speeds or thrusts, which are inputs of the model.

    Parameters
    ----------
    name : str
        Name in the catalogue.
    quantity : "n" or "f"
        Input that is delayed: shaft speeds or thrusts.
    requires : tuple[str, ...]
        Signals that the model must provide.
    described
        Further fields of the `Effect`.
    """

    def late(s: Signals) -> None:
        """Replace the shaft speeds ``s.n`` or thrusts ``s.f`` by their values of ``tau_delay`` ago, in place.

        A model with the age ``tau_age`` of telemetry is shifted by it in the other direction too.
        """
        shift_in_time(s, quantity)

    now = [Input(f"{quantity}_{side}", "", "linear") for side in SIDES]
    return Effect(
        name,
        "a thrust delay" if quantity == "n" else "a thrust delay, in a model driven by forces",
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
        causes="the link to the speed controllers, a filter or a ramp in them",
        experiment=EXPERIMENT,
        requires=requires,
        one_sided=True,
        in_words=in_sentence("tau_delay", "s", "the thrust is {} late"),
        **described,
    )


def _lag_effect(name: str, title: str, quantity: Quantity, requires: tuple[str, ...], **described: Any) -> Effect:
    """Return the effect of a first-order lag of the shaft speeds or thrusts, with a time constant of 0 to 1.2 s.

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
        """Replace the shaft speeds ``s.n`` or thrusts ``s.f`` by their values after the lag ``T_lag``, in place.

        Set the rates of the states ``late_SIDE`` of the lag. With a time constant of zero nothing is replaced.
        """
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
            State(f"late_{side}", unit, f"{side} thruster, after its lag", 1e-3 * full, sd0=0.1 * full)
            for side in SIDES
        ),
        place="actuator",
        formula="T n_eff' = n - n_eff",
        source="motor and inflow dynamics; Blanke, Lindegaard and Fossen 2000",
        causes="speed controllers and motors that reach their speed late",
        experiment=EXPERIMENT,
        requires=requires,
        one_sided=True,
        in_words=in_sentence("T_lag", "s", "with a time constant of {}"),
        **described,
    )


EXPERIMENT = "chirp of both thrusters: a delay shifts the phase without limit, a lag by at most 90 degrees"
MEASURED, GIVEN = ("n", "f", "n_input"), ("f_input",)
EFFECTS = (
    # only with a hull, because a Nomoto model already has a delay
    _delay_effect("delay", "n", (*MEASURED, "hull"), alternatives=("lag", "gnss-latency")),
    _lag_effect("lag", "a first-order thrust lag behind the shaft", "n", MEASURED, alternatives=("delay",)),
    _delay_effect("force-delay", "f", GIVEN, alternatives=("force-lag",)),
    _lag_effect("force-lag", "a first-order thrust lag", "f", GIVEN, alternatives=("force-delay",)),
)
