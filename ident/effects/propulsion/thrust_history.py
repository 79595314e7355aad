"""Thrust dynamics: a pure delay, or a further first-order lag, of the measured or given input.

Both are finite impulse responses over delayed input taps (``NAME~k``: the input k steps of 0.1 s earlier), so they
need no states and have exact derivatives, also at zero: the delay interpolates linearly between the taps, the lag
integrates an exponential impulse response over each step with the input linear within it.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from ident.model import HISTORY_STEP, Effect, Input, ModelFunction, Parameter, Signals, tap_name

N_DELAY, N_LAG = 8, 16


def delayed(past: list[Any], tau: Any) -> Any:
    """Linear interpolation of the past at tau; past[k] is the value k steps ago."""
    at = tau / HISTORY_STEP
    return sum(value * _positive(1 - abs(at - k)) for k, value in enumerate(past))


def lagged(past: list[Any], time_constant: Any) -> Any:
    """First-order response to the past, linear between the steps; before the oldest tap the input is constant."""
    d = HISTORY_STEP / (time_constant + 1e-6)
    decay = np.exp(-d)
    newest = 1 - (1 - decay) / d  # weight of the newer end of a step, at whose start the response is 1
    oldest = (1 - decay) / d - decay
    total: Any = 0.0
    memory: Any = 1.0
    for newer, older in pairwise(past):
        total = total + memory * (newest * newer + oldest * older)
        memory = memory * decay
    return total + memory * past[-1]


def _positive(value: Any) -> Any:
    return value * (value > 0)


def _hook(quantity: str, parameter: str, steps: int, response: Any) -> ModelFunction:
    def respond(s: Signals) -> None:
        bag = s.n if quantity == "n" else s.f
        for side in bag:
            past = [bag[side]] + [getattr(s.u, tap_name(f"{quantity}_{side}", k)) for k in range(1, steps + 1)]
            bag[side] = response(past, getattr(s.p, parameter))

    return respond


def _effect(
    name: str, title: str, quantity: str, parameter: Parameter, steps: int, response: Any, **described: Any
) -> Effect:
    now = [Input(f"{quantity}_{side}", "", "linear") for side in ("left", "right")]
    inputs = [i.delayed(k) for i in now for k in range(1, steps + 1)]
    stage = "shaft" if quantity == "n" else "thrust"
    return Effect(
        name=name,
        title=title,
        place="actuator",
        hooks={stage: _hook(quantity, parameter.name, steps, response)},
        parameters=(parameter,),
        inputs=tuple(inputs),
        requires=("n", "f") if quantity == "n" else ("f_input",),
        one_sided=True,
        **described,
    )


TAU = Parameter("tau_delay", 0.0, "s", "delay of the thrust", prior=(0.0, 0.5), bounds=(0.0, 0.75), step=0.05)
LAG = Parameter("T_lag", 0.0, "s", "time constant of the thrust", prior=(0.0, 0.5), bounds=(0.0, 1.2), step=0.05)
DELAY = {
    "formula": "n_eff(t) = n(t - tau)",
    "source": "links and speed controllers; MEDUSA's simulator has 0.345 s",
    "experiment": "chirp of both thrusters: a delay shifts the phase without limit, a lag by at most 90 degrees",
    "rivals": ("lag", "gnss-latency"),
}
SLOW = {
    "formula": "T n_eff' = n - n_eff",
    "source": "motor and inflow dynamics; Blanke, Lindegaard and Fossen 2000",
    "experiment": DELAY["experiment"],
    "rivals": ("delay",),
}
EFFECTS = (
    _effect("delay", "a thrust delay", "n", TAU, N_DELAY, delayed, **DELAY),
    _effect("lag", "a first-order thrust lag behind the shaft", "n", LAG, N_LAG, lagged, **SLOW),
    _effect("force-delay", "a thrust delay", "f", TAU, N_DELAY, delayed, **(DELAY | {"rivals": ("force-lag",)})),
    _effect("force-lag", "a first-order thrust lag", "f", LAG, N_LAG, lagged, **(SLOW | {"rivals": ("force-delay",)})),
)
