"""Fouling: a thruster that loses a part of its thrust at one time in a run."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from seatrial.ident.model import INF, Effect, Input, Parameter, Signals, share_in_words

WIDTH_S = 5.0  # time in which the thrust changes [s]; the likelihood needs a derivative by the time of the change


def lose(s: Signals) -> None:
    """Reduce the thrust of each thruster by its own share after the time ``t_foul`` of the record, in place in ``s.f``.

    The change takes about 10 s around ``t_foul`` (a tanh).
    """
    fouled = (1 + np.tanh((s.u.t - s.p.t_foul) / WIDTH_S)) / 2
    s.f["left"] = s.f["left"] * (1 - s.p.foul_left * fouled)
    s.f["right"] = s.f["right"] * (1 - s.p.foul_right * fouled)


def compare_sides(estimates: Mapping[str, tuple[float, float]]) -> str:
    """Return a clause for reports: from when on each thruster gives which share of its thrust before.

    Parameters
    ----------
    estimates : Mapping[str, tuple[float, float]]
        Estimate and standard error by parameter, of the first record. Only the time ``t_foul`` [s] and the lost shares
        ``foul_left`` and ``foul_right`` are used.
    """
    left, right = (share_in_words(1 - value, se) for value, se in (estimates["foul_left"], estimates["foul_right"]))
    return (
        f"from {estimates['t_foul'][0]:.0f} s of the first log on, the left thruster gives {left} % of its thrust "
        f"before, the right one {right} %"
    )


EFFECT = Effect(
    name="fouling",
    title="a thruster that loses thrust during a run",
    place="actuator",
    hooks={"thrust_loss": lose},
    parameters=(
        *(
            Parameter(
                f"foul_{side}",
                0.0,
                "",
                f"relative loss of thrust during the run, {side}",
                prior=(0.0, 0.3),
                step=0.02,
                per_record=True,
            )
            for side in ("left", "right")
        ),
        Parameter(
            "t_foul",
            120.0,
            "s",
            "time of the loss after the start of a record",
            prior=(120.0, 120.0),
            bounds=(0.0, INF),
            step=1.0,
            per_record=True,
            scales=False,
        ),
    ),
    inputs=(Input("t", "s", "linear"),),
    scan={"t_foul": (30.0, 60.0, 90.0, 120.0, 160.0, 210.0, 280.0)},
    formula="f_i *= 1 - foul_i for t > t_foul, in each run, i the left and the right thruster",
    source="weed and lines in propellers; thermal limits of speed controllers",
    causes="weed or a line that a propeller caught during the run, a speed controller that became too hot",
    experiment="the same run again with clean propellers, and a look at both before and after it",
    requires=("f", "hull"),
    nests=("mismatch",),
    alternatives=("mismatch", "payload-shift", "growing-drag", "battery-sag"),
    in_words=compare_sides,
)
