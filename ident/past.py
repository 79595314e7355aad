"""What depends on an input's past and no catalogue lists: a force that follows the thrust late, or swings after it.

Innovations that are correlated with the inputs at a lag are the sign of it. Both kinds vanish when the input rests, so
neither is taken for a thrust coefficient.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from ident.model import Effect, Model, Residual, Signals, State
from ident.models.unexplained import residuals_of, variables_of
from ident.params import Parameter

MEMORIES = (0.25, 1.0, 4.0)  # s, of the first-order lags
FREQUENCIES = (0.2, 0.32, 0.5, 0.8, 1.2)  # Hz, at which a mode is looked for
DAMPING = 0.1
FULL = 40.0  # N, of a thruster: what an input in newtons is compared with
Signal = Callable[[Signals], Any]


def past_effects(model: Model) -> dict[str, Effect]:
    """By the name of the test: ``X(past of n_sum)``, ``X(swing after n_sum)``; empty without a pair of thrusters."""
    forces = {r.name: r for r in residuals_of(model)}
    found = {}
    for variable in variables_of(model):
        letter, _, kind = variable.name.partition("_")
        force = forces.get({"sum": "X", "diff": "N"}.get(kind, ""))
        if letter in ("n", "f") and force is not None:
            drive = _thrust(letter, kind == "diff")
            for effect in (lagged(force, variable.name, drive), swinging(force, variable.name, drive)):
                if model.accepts(effect):
                    found[effect.name.removeprefix("unknown ")] = effect
    return found


def _thrust(letter: str, difference: bool) -> Signal:
    """Mean or half the difference of the thrusts, as parts of full thrust; it goes as the square of the shaft speed."""

    def read(s: Signals) -> Any:
        left, right = (getattr(s.u, f"{letter}_{side}") for side in ("left", "right"))
        if letter == "n":
            left, right = left * abs(left), right * abs(right)
        return (left - right if difference else left + right) / (2 if letter == "n" else 2 * FULL)

    return read


def lagged(force: Residual, of: str, drive: Signal) -> Effect:
    """``F += sum_k t_k (z_k - w)``, ``z_k' = (w - z_k) / T_k``: what a change of w brings late, or too early."""
    names = [f"{force.name}_{of}_late_{k}" for k in range(len(MEMORIES))]
    states = [f"late_{of}_{k}" for k in range(len(MEMORIES))]

    def add(s: Signals) -> None:
        w = drive(s)
        terms = zip(names, states, strict=True)
        force.add(s, sum(getattr(s.p, name) * (getattr(s.x, state) - w) for name, state in terms))

    def follow(s: Signals) -> None:
        for state, memory in zip(states, MEMORIES, strict=True):
            s.rate[state] = (drive(s) - getattr(s.x, state)) / memory

    return Effect(
        f"unknown {force.name}(past of {of})",
        f"an unknown effect: {force.title} follows {of} with a lag",
        {force.stage: add, "rate": follow},
        parameters=tuple(
            Parameter(n, 0.0, force.unit, f"{force.name} behind {of} by {memory:g} s", prior=(0.0, 2 * force.scale),
                      step=0.03 * force.scale)
            for n, memory in zip(names, MEMORIES, strict=True)
        ),
        states=tuple(State(n, "", f"{of} behind by {memory:g} s", 0.0, sd0=0.05)
                     for n, memory in zip(states, MEMORIES, strict=True)),
        formula=f"{force.name} += sum t_k (z_k - w), z_k' = (w - z_k) / T_k, w the part of full thrust",
        source="the residual itself",
        experiment=f"steps of {of} from rest, each held until all has settled",
        requires=("hull",),
    )


def swinging(force: Residual, of: str, drive: Signal) -> Effect:
    """``F += a (z - w) + b z' / omega``, z a mode of second order behind w: what a change of w sets swinging."""
    names = (f"{force.name}_{of}_swing", f"{force.name}_{of}_swing_rate")
    states, f_name = (f"swing_{of}", f"swing_{of}_rate"), f"f_{force.name}_{of}"

    def add(s: Signals) -> None:
        z, ahead = (getattr(s.x, n) for n in states)
        force.add(s, getattr(s.p, names[0]) * (z - drive(s)) + getattr(s.p, names[1]) * ahead)

    def swing(s: Signals) -> None:
        omega = 2 * math.pi * getattr(s.p, f_name)
        z, ahead = (getattr(s.x, n) for n in states)
        s.rate[states[0]] = omega * ahead
        s.rate[states[1]] = omega * (drive(s) - z) - 2 * DAMPING * omega * ahead

    return Effect(
        f"unknown {force.name}(swing after {of})",
        f"an unknown effect: {force.title} swings after {of}",
        {force.stage: add, "rate": swing},
        parameters=(
            *(Parameter(n, 0.0, force.unit, f"{force.name} that swings after {of}{what}", prior=(0.0, 2 * force.scale),
                        step=0.03 * force.scale) for n, what in zip(names, ("", ", its quadrature"), strict=True)),
            Parameter(f_name, 0.5, "Hz", "frequency of the swing", "log", prior=(0.5, 0.4), bounds=(0.1, 2.5)),
        ),
        states=tuple(State(n, "", what, 0.0, sd0=0.05)
                     for n, what in zip(states, (f"swing after {of}", "its quadrature"), strict=True)),
        scan={f_name: FREQUENCIES},
        formula=f"{force.name} += a (z - w) + b z'/w0, z'' + 2 zeta w0 z' = w0^2 (w - z), w the part of full thrust",
        source="the residual itself",
        experiment=f"a chirp of {of} through 0.1 to 1.5 Hz",
        requires=("hull",),
    )
