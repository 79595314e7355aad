"""User-defined model from two functions: a roll decay test of a boat (docs/how-to/own-model.md)."""

from __future__ import annotations

from seatrial.ident.model import INF, Output, Parameter, Sensor, State, plain_model

rolling = plain_model(
    "rolling",
    f=lambda x, u, p: {"phi": x.p, "p": -p.k * x.phi - p.d * x.p - p.dd * abs(x.p) * x.p},
    h=lambda x, u, p: {"phi": x.phi},
    states=(State("phi", "rad", "roll", from_output="phi", sd0=0.1), State("p", "rad/s", "roll rate", "s_p", sd0=0.1)),
    inputs=(),
    sensors=(Sensor("attitude", (Output("phi", "rad", "e_phi"),)),),
    parameters=(
        Parameter("k", 10.0, "1/s2", "stiffness over inertia", "log"),
        Parameter("d", 0.3, "1/s", "linear damping over inertia", bounds=(0, INF)),
        Parameter("dd", 0.3, "", "quadratic damping over inertia", bounds=(0, INF)),
        Parameter("s_p", 0.01, "rad/s/sqrt(s)", "process noise", "log"),
        Parameter("e_phi", 0.005, "rad", "noise of the measured roll", "log"),
    ),
)
