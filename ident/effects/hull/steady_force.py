"""Steady surge or sway force in the body frame."""

from __future__ import annotations

from seatrial.ident.model import Effect, Estimates, Parameter, Signals, directed_size


def add(s: Signals) -> None:
    """Add the constant forces ``X_0`` and ``Y_0`` [N] to the surge and sway forces ``s.X`` and ``s.Y``, in place."""
    s.X, s.Y = s.X + s.p.X_0, s.Y + s.p.Y_0


def force(estimates: Estimates) -> str:
    """Return a clause for reports: "3.1 ± 0.4 N forward and 0.2 ± 0.3 N to port".

    Only ``X_0`` and ``Y_0`` are used.
    """
    along = directed_size(estimates["X_0"], "N", "forward", "aft")
    across = directed_size(estimates["Y_0"], "N", "to starboard", "to port")
    return f"{along} and {across}"


EFFECT = Effect(
    name="steady-force",
    title="a steady surge or sway force",
    hooks={"force": add},
    parameters=(
        Parameter("X_0", 0.0, "N", "steady surge force", prior=(0.0, 10.0), step=0.5),
        Parameter("Y_0", 0.0, "N", "steady sway force", prior=(0.0, 10.0), step=0.5),
    ),
    formula="X += X_0, Y += Y_0",
    source="a thruster that turns at zero command, a jet of cooling water, an asymmetric hull",
    causes="a jet of cooling water, a thruster that turns at zero command",
    experiment="drifting without thrust on several headings",
    requires=("hull",),
    alternatives=("steady-pull", "coulomb", "reverse-thrust", "mount"),
    in_words=force,
)
