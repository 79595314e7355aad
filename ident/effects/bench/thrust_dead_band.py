"""Dead band of the thrust curve: no thrust at low shaft speed, on the bench."""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals, share_in_sentence
from seatrial.ident.models import beyond_dead_band


def cut(s: Signals) -> None:
    """Reduce the magnitude of the shaft speed ``s.n`` of the thrust curve by the dead band ``n_band``, in place.

    Inside the band the shaft speed is set to zero.
    """
    s.n = beyond_dead_band(s.n, s.p.n_band)


EFFECT = Effect(
    name="thrust-dead-band",
    title="a dead band of the thrust curve",
    place="actuator",
    hooks={"shaft": cut},
    parameters=(
        Parameter(
            "n_band",
            0.0,
            "",
            "shaft speed below which there is no thrust",
            prior=(0.0, 0.1),
            bounds=(0.0, 0.5),
            step=0.01,
        ),
    ),
    formula="f = c1 m|m| + c2 m^2, m = sgn(n) max(|n| - n_band, 0)",
    source="propellers at low Reynolds number; play and friction of the bench",
    experiment="slow ramps of both signs through zero",
    requires=("bench", "thrust"),
    one_sided=True,
    alternatives=("thrust-exponent",),
    in_words=share_in_sentence("n_band", "no thrust below {} % of full speed"),
)
