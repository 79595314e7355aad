"""Loss of reverse thrust that grows with shaft speed, on the bench."""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals, share_in_sentence


def lose(s: Signals) -> None:
    """Multiply the thrust ``s.force`` by ``1 - rho_astern |n|`` if the shaft speed n is negative, in place."""
    s.force = s.force * (1 - s.p.rho_astern * abs(s.n) * (s.n < 0))


EFFECT = Effect(
    name="reverse-loss",
    title="the loss of reverse thrust at high shaft speed",
    place="actuator",
    hooks={"thrust": lose},
    parameters=(
        Parameter(
            "rho_astern",
            0.0,
            "",
            "relative loss of thrust at full reverse",
            prior=(0.0, 0.3),
            bounds=(-0.9, 0.9),
            step=0.01,
        ),
    ),
    formula="f *= 1 - rho |n| for n < 0; a constant loss is part of c2",
    source="four-quadrant open-water data: blades running on their trailing edge stall",
    experiment="as many steady levels in reverse as in forward, up to full speed",
    requires=("bench", "thrust"),
    alternatives=("thrust-exponent",),
    in_words=share_in_sentence("rho_astern", "at full reverse the thrust falls by {} %"),
)
