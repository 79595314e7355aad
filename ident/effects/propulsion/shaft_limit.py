"""Limit of the shaft speed of a boat that is known by its commands: higher commands turn the shafts no faster."""

from __future__ import annotations

from seatrial.ident.effects.bench.speed_limit import CAUSES, EXPERIMENT, PARAMETERS, SCAN, SOURCE, limited
from seatrial.ident.model import Effect, Signals


def saturate(s: Signals) -> None:
    """Limit the magnitude of each shaft speed ``s.n`` to ``n_top``, in place, by the share ``k_top`` of the excess."""
    for side, n in s.n.items():
        s.n[side] = limited(n, s.p.n_top, s.p.k_top)


EFFECT = Effect(
    name="shaft-limit",
    title="a limit of the shaft speed below full command",
    place="actuator",
    hooks={"thrust_lag": saturate},
    parameters=PARAMETERS,
    scan=SCAN,
    formula="n_i -> n_i / (1 + (n_i / n_top)^32)^(1/32)",
    source=SOURCE,
    causes=CAUSES,
    experiment=EXPERIMENT,
    requires=("n", "f", "n_state"),  # a measured shaft speed shows its limit
    one_sided=True,
    alternatives=("thrust-power", "thrust-linearity", "advance-ratio", "hump"),
)
