"""Dead band of the thrusters: no thrust at low shaft speed."""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals, share_in_sentence
from seatrial.ident.models import beyond_dead_band


def cut(s: Signals) -> None:
    """Replace each shaft speed ``s.n`` by its part beyond the dead band ``n_dead``, as a fraction of the largest part.

    Full speed stays full speed: a given thrust at full speed was measured with the dead band.
    """
    for side, n in s.n.items():
        s.n[side] = beyond_dead_band(n, s.p.n_dead) / (1.0 - s.p.n_dead)


EFFECT = Effect(
    name="dead-band",
    title="a dead band of the thrusters",
    place="actuator",
    hooks={"dead_band": cut},
    parameters=(
        Parameter(
            "n_dead",
            0.0,
            "",
            "shaft speed below which there is no thrust",
            prior=(0.0, 0.15),
            bounds=(0.0, 0.5),
            step=0.02,
        ),
    ),
    formula="n_eff = sgn(n) max(|n| - n_dead, 0) / (1 - n_dead)",
    source="ESC data; propellers at low Reynolds number",
    causes="speed controllers or propellers that start late",
    experiment="small steps of both signs around zero",
    requires=("n", "f"),
    one_sided=True,
    alternatives=("reverse-thrust", "coulomb"),
    takes_over=("dead_zone",),
    in_words=share_in_sentence("n_dead", "no thrust below {} % of full speed"),
)
