"""Yaw bias: a steady yaw moment, and a moment that grows with the square of speed, for example of a bent keel."""

from __future__ import annotations

from seatrial.ident.model import Effect, Estimates, Parameter, Signals, directed_size, size_in_words


def add(s: Signals) -> None:
    """Add ``N_0 + N_uu u|u|`` to the yaw moment ``s.N`` [N m], in place; u is the surge speed [m/s]."""
    s.N = s.N + s.p.N_0 + s.p.N_uu * s.x.u * abs(s.x.u)


def moment(estimates: Estimates) -> str:
    """Return a clause for reports: "10.2 ± 0.5 N m to port at 1 m/s ahead, growing with the squared speed, and ...".

    Only ``N_uu`` and ``N_0`` are used, positive to starboard. Their sum has no error here, because they are correlated.
    A constant moment below its standard error has no side.
    """
    by_speed = directed_size(estimates["N_uu"], "N m", "to starboard", "to port")
    value, error = estimates["N_0"]
    constant = directed_size((value, error), "N m", "to starboard", "to port")
    if abs(value) < error:
        constant = size_in_words(value, error, "N m")
    return f"{by_speed} at 1 m/s ahead, growing with the squared speed, and {constant} at any speed"


EFFECT = Effect(
    name="yaw-bias",
    title="a constant or speed-dependent yaw moment",
    hooks={"force": add},
    parameters=(
        Parameter("N_0", 0.0, "N m", "constant yaw moment", prior=(0.0, 2.0), step=0.05),
        Parameter("N_uu", 0.0, "kg", "yaw moment per squared surge speed", prior=(0.0, 2.0), step=0.05),
    ),
    formula="N += N_0 + N_uu u|u|",
    source="an asymmetric or fouled hull, a bent keel, a trailing line",
    causes="a bent skeg, keel or rudder, growth on one side, a line that trails on one side",
    experiment="coasting without thrust, and runs on opposite headings",
    requires=("hull",),
    alternatives=("mismatch", "heading-moment", "sway-yaw"),
    in_words=moment,
)
