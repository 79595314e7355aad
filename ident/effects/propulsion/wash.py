"""Wash: a propeller that runs astern loses thrust in the water that the other one, running ahead, sets in motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from seatrial.ident.model import Effect, Parameter, Signals, share_in_words

WIDTH = 0.15  # shaft speed at which half of the loss is reached, so that the thrust has a derivative at zero


def _running_ahead(n: Any) -> Any:
    """Return 0 for a shaft that stands or runs astern, and a value that rises smoothly to 1 for one that runs ahead."""
    ahead = np.maximum(n, 0.0)
    return ahead * ahead / (ahead * ahead + WIDTH * WIDTH)


def lose(s: Signals) -> None:
    """Multiply the thrust of a thruster that runs astern by ``1 - k_wash`` if the other one runs ahead, in ``s.f``.

    Nothing changes if both run in the same direction, or if one of them stands.
    """
    left, right = s.n["left"], s.n["right"]
    s.f["left"] = s.f["left"] * (1 - s.p.k_wash * _running_ahead(-left) * _running_ahead(right))
    s.f["right"] = s.f["right"] * (1 - s.p.k_wash * _running_ahead(-right) * _running_ahead(left))


def describe(estimates: Mapping[str, tuple[float, float]]) -> str:
    """Return a clause for reports: which share of its thrust a propeller in the wash gives.

    Parameters
    ----------
    estimates : Mapping[str, tuple[float, float]]
        Estimate and standard error by parameter. Only ``k_wash`` is used, the lost share.
    """
    lost, error = estimates["k_wash"]
    return f"astern a propeller gives {share_in_words(1 - lost, error)} % of its thrust while the other one runs ahead"


EFFECT = Effect(
    name="wash",
    title="a propeller astern in the wash of the other one ahead",
    place="actuator",
    hooks={"thrust_loss": lose},
    parameters=(
        Parameter(
            "k_wash",
            0.0,
            "",
            "relative loss of the thrust astern while the other thruster runs ahead",
            prior=(0.0, 0.4),
            bounds=(0.0, 1.0),
            step=0.05,
        ),
    ),
    formula=(
        "f_i *= 1 - k_wash P(-n_i) P(n_j), P(n) = max(n, 0)^2 / (n^2 + 0.15^2), i one thruster and j the other one"
    ),
    source="a propeller in the jet of another one: thruster-thruster interaction, Faltinsen 1990, section 8.4",
    causes="propellers close to each other, a hull or a tunnel that leads the wash of one propeller into the other",
    experiment="turning on the spot with opposite commands at several levels, and each thruster alone astern",
    requires=("n", "f"),
    one_sided=True,
    alternatives=("thruster-interaction", "reverse-thrust", "turning-resistance"),
    in_words=describe,
)
