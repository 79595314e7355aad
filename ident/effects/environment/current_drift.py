"""Ocean current that changes linearly with time during a record."""

from __future__ import annotations

from seatrial.ident.model import Effect, Estimates, Input, Parameter, Signals, directed_size


def drift(s: Signals) -> None:
    """Add an ocean current that changes linearly with time to the rates of the position north and east [m/s], in place.

    The added velocity is ``V_d (t / 600 s - 1/2)``: V_d (parameters ``V_dx``, ``V_dy``) is the change in 600 s, and t
    the time since the start of the record. At 300 s it is zero.
    """
    elapsed = s.u.t / 600.0 - 0.5  # centred, so that V_x and V_y are the current in the middle of 600 s
    s.rate["x"] = s.rate["x"] + s.p.V_dx * elapsed
    s.rate["y"] = s.rate["y"] + s.p.V_dy * elapsed


def change(estimates: Estimates) -> str:
    """Return a clause for reports: the change of the current [m/s] in 600 s to the north and to the east."""
    north = directed_size(estimates["V_dx"], "m/s", "to the north", "to the south")
    east = directed_size(estimates["V_dy"], "m/s", "to the east", "to the west")
    return f"in 600 s the current changes by {north} and {east}"


EFFECT = Effect(
    name="current-drift",
    title="a time-varying current",
    place="environment",
    hooks={"rate": drift},
    parameters=(
        Parameter(
            "V_dx",
            0.0,
            "m/s",
            "change of the current to the north in 600 s",
            prior=(0.0, 0.4),
            step=0.02,
            per_record=True,
            scales=False,
        ),
        Parameter(
            "V_dy",
            0.0,
            "m/s",
            "change of the current to the east in 600 s",
            prior=(0.0, 0.4),
            step=0.02,
            per_record=True,
            scales=False,
        ),
    ),
    inputs=(Input("t", "s", "linear"),),
    formula="V(t) = V + V_d (t / 600 s - 1/2)",
    source="tide and eddies; Fossen 2011, section 8.3",
    causes="a tide, an eddy, a current that changes in time",
    experiment="drifting without thrust at the start, in the middle and at the end",
    requires=("plane",),
    alternatives=("wind", "battery-sag", "tether"),
    in_words=change,
)
