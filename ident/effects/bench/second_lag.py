"""Second first-order lag of the shaft: a set-point filter in the speed controller, or the electrical motor dynamics."""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals, State


def filter_command(s: Signals) -> None:
    """Replace the share ``k_lag`` of the reference shaft speed ``s.n_ref`` by its value after the lag, in place.

    ``s.n_commanded`` is set to the reference before, which drives the lag.
    """
    s.n_commanded = s.n_ref
    s.n_ref = s.n_ref + s.p.k_lag * (s.x.n_late - s.n_ref)


def follow(s: Signals) -> None:
    """Set the rate of the lagged reference: ``(s.n_commanded - n_late) / T_late`` [1/s], with the state ``n_late``."""
    s.rate["n_late"] = (s.n_commanded - s.x.n_late) / s.p.T_late


EFFECT = Effect(
    name="second-lag",
    title="a second first-order lag of the shaft",
    place="actuator",
    hooks={"shaft": filter_command, "rate": follow},
    parameters=(
        Parameter(
            "k_lag", 0.0, "", "share of the command that passes the lag", prior=(1.0, 0.5), bounds=(0.0, 1.5), step=0.02
        ),
        Parameter(
            "T_late", 0.05, "s", "time constant of the lag", "log", prior=(0.05, 0.05), bounds=(0.01, 2.0), scales=False
        ),
    ),
    states=(State("n_late", "", "command after the lag", 0.0, sd0=0.01),),
    scan={"T_late": (0.02, 0.04, 0.08, 0.15, 0.3)},
    formula="T z' = n_ref - z, n_ref -> n_ref + k (z - n_ref)",
    source="electric motor and speed controller in series; Blanke, Lindegaard and Fossen 2000",
    experiment="steps of one size with the shaft speed sampled ten times within its rise, then a chirp",
    requires=("bench",),
    one_sided=True,
    alternatives=("slew-limit", "spin-up"),
)
