"""Thruster-thruster interaction: each thruster reduces the thrust of the other."""

from __future__ import annotations

from seatrial.ident.model import INF, Effect, Parameter, Signals, share_in_sentence


def lose(s: Signals) -> None:
    """Multiply the thrust of each thruster by ``1 - kappa |n|``, in place; n is the shaft speed of the other one."""
    left, right = s.f["left"], s.f["right"]
    s.f["left"] = left * (1 - s.p.kappa * abs(s.n["right"]))
    s.f["right"] = right * (1 - s.p.kappa * abs(s.n["left"]))


EFFECT = Effect(
    name="thruster-interaction",
    title="thruster-thruster interaction",
    place="actuator",
    hooks={"thrust_loss": lose},
    parameters=(
        Parameter(
            "kappa",
            0.0,
            "",
            "relative loss of thrust while the other thruster runs at full speed",
            prior=(0.0, 0.4),
            bounds=(0.0, INF),
            step=0.02,
        ),
    ),
    formula="f_L *= 1 - kappa |n_R| and vice versa",
    source="thruster-thruster and thruster-hull interaction, Faltinsen 1990, section 8.4",
    experiment="one thruster alone, then both, at the same shaft speeds",
    requires=("n", "f"),
    one_sided=True,
    alternatives=("load-sag", "wash", "advance-ratio", "reverse-thrust"),
    in_words=share_in_sentence("kappa", "a thruster loses {} % of its thrust while the other one runs at full speed"),
)
