"""Limit of the shaft speed of a boat that is known by its commands: higher commands turn the shafts no faster."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from seatrial.ident.checks import followed_command
from seatrial.ident.data import Channel
from seatrial.ident.effects.bench.speed_limit import EFFECT as SPEED_LIMIT
from seatrial.ident.effects.bench.speed_limit import limited
from seatrial.ident.model import Signals


def saturate(s: Signals) -> None:
    """Limit the magnitude of each shaft speed ``s.n`` to ``n_top``, in place, by the share ``k_top`` of the excess."""
    for side, n in s.n.items():
        s.n[side] = limited(n, s.p.n_top, s.p.k_top)


def refuted_by(runs: Sequence[Mapping[str, Channel]]) -> str:
    """Return why measured shaft speeds of the runs contradict a limit, as a clause; empty if they do not."""
    largest = followed_command(runs)
    if largest is None:
        return ""
    return f"the measured shaft speeds follow the commands up to the largest one, {largest:.2f} of full command"


# The limit is that of a shaft on the bench; only its place in the model differs.
EFFECT = replace(
    SPEED_LIMIT,
    name="shaft-limit",
    title="a limit of the shaft speed below full command",
    hooks={"thrust_lag": saturate},
    formula="n_i -> n_i / (1 + (n_i / n_top)^32)^(1/32)",
    requires=("n", "f", "n_state"),  # a measured shaft speed shows its limit
    refuted_by=refuted_by,
    alternatives=("thrust-power", "thrust-linearity", "advance-ratio", "hump"),
)
