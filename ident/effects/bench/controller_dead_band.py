"""Dead band of the speed controller, which it subtracts from every command, on the bench."""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals, share_in_sentence
from seatrial.ident.models import beyond_dead_band


def subtract(s: Signals) -> None:
    """Reduce the magnitude of the reference shaft speed ``s.n_ref`` by the dead band ``b_cmd``, in place.

    Inside the band the reference is zero. Full command still gives full speed.
    """
    s.n_ref = beyond_dead_band(s.n_ref, s.p.b_cmd) / (1.0 - s.p.b_cmd)


EFFECT = Effect(
    name="controller-dead-band",
    title="a dead band that the speed controller subtracts from the command",
    place="actuator",
    hooks={"shaft": subtract},
    parameters=(
        Parameter(
            "b_cmd",
            0.0,
            "",
            "command up to which the shaft stands still, and by which all commands are reduced",
            prior=(0.0, 0.1),
            bounds=(0.0, 0.5),
            step=0.01,
        ),
    ),
    formula="n_ref = sgn(c) max(|c| - b_cmd, 0) / (1 - b_cmd)",
    source="speed controllers of model aircraft: the throttle range begins beyond the dead band around neutral",
    causes="a dead band around neutral in the settings of the speed controller",
    experiment="slow ramps of the command of both signs through zero, and many steady levels",
    requires=("bench",),
    one_sided=True,
    alternatives=("speed-curve",),
    in_words=share_in_sentence("b_cmd", "the shaft stands still up to {} % of full command"),
)
