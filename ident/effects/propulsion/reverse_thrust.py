"""Loss of thrust in reverse on the boat."""

from __future__ import annotations

from seatrial.ident.model import ESTIMATED_CURVE, Effect, Parameter, Signals, share_in_sentence


def lose(s: Signals) -> None:
    """Multiply the thrust of each thruster whose shaft turns in reverse by ``1 - rho_rev``, in place in ``s.f``."""
    for side, n in s.n.items():
        s.f[side] = s.f[side] * (1 - s.p.rho_rev * (n < 0))


EFFECT = Effect(
    name="reverse-thrust",
    title="the loss of thrust in reverse",
    place="actuator",
    hooks={"thrust_loss": lose},
    parameters=(Parameter("rho_rev", 0.0, "", "relative loss of reverse thrust", prior=(0.0, 0.4), step=0.05),),
    formula="f_i *= 1 - rho_rev for n_i < 0",
    source="four-quadrant open-water data; the hull in the slipstream of a reversed thruster",
    causes="propellers that are weaker astern than the given curve, thrusters that blow against the hull",
    experiment="reverse steps of several levels, and turning on the spot",
    requires=("n", "f"),
    alternatives=("dead-band", "reverse-mismatch", "mismatch", "thruster-interaction"),
    in_words=share_in_sentence(
        "rho_rev", f"in reverse a thruster gives {{}} % of the thrust of {ESTIMATED_CURVE} (c1 - c2)", left=True
    ),
)
