"""Low-pass filter of the load-cell amplifier."""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals, State


def smooth(s: Signals) -> None:
    """Replace the share ``k_cell`` of the thrust in the output ``force`` by the low-pass-filtered thrust, in place.

    The offset and the disturbance force in this output are not filtered.
    """
    s.y["force"] = s.y["force"] + s.p.k_cell * (s.x.cell - s.force)


def follow(s: Signals) -> None:
    """Set the rate of the filtered thrust [N/s]: ``(s.force - cell) / T_cell``, with the state ``cell`` [N]."""
    s.rate["cell"] = (s.force - s.x.cell) / s.p.T_cell


EFFECT = Effect(
    name="cell-lag",
    title="the lag of the load cell's low-pass filter",
    place="sensor",
    hooks={"rate": follow, "output": smooth},
    parameters=(
        Parameter(
            "k_cell",
            0.0,
            "",
            "share of the force that passes the filter",
            prior=(1.0, 0.5),
            bounds=(0.0, 1.5),
            step=0.02,
        ),
        Parameter(
            "T_cell",
            0.05,
            "s",
            "time constant of the filter",
            "log",
            prior=(0.05, 0.05),
            bounds=(0.01, 2.0),
            scales=False,
        ),
    ),
    states=(State("cell", "N", "filtered force", 0.0, sd0=0.1),),
    scan={"T_cell": (0.02, 0.05, 0.1, 0.2)},
    formula="T z' = f - z, F_measured = f + k (z - f)",
    source="digital filters of load cell amplifiers; an HX711 takes four conversions to settle",
    experiment="a weight dropped from a thread; chirps with the shaft speed measured",
    requires=("bench", "thrust"),
    one_sided=True,
    alternatives=("rod-flex",),
)
