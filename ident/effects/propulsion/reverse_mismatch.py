"""Loss of thrust in reverse that differs between the left and the right thruster."""

from __future__ import annotations

from collections.abc import Mapping

from seatrial.ident.model import ESTIMATED_CURVE, Effect, Parameter, Signals, share_in_words


def lose(s: Signals) -> None:
    """Reduce the thrust of each thruster whose shaft turns in reverse by its own share, in place in ``s.f``."""
    s.f["left"] = s.f["left"] * (1 - s.p.rho_left * (s.n["left"] < 0))
    s.f["right"] = s.f["right"] * (1 - s.p.rho_right * (s.n["right"] < 0))


def compare_sides(estimates: Mapping[str, tuple[float, float]]) -> str:
    """Return a clause for reports: which share of the thrust astern of the estimated curve each thruster gives.

    Parameters
    ----------
    estimates : Mapping[str, tuple[float, float]]
        Estimate and standard error by parameter. Only ``rho_left`` and ``rho_right`` are used, the lost shares.
    """
    left, right = (share_in_words(1 - value, se) for value, se in (estimates["rho_left"], estimates["rho_right"]))
    return (
        f"in reverse the left thruster gives {left} % of the thrust of {ESTIMATED_CURVE} (c1 - c2), the right one "
        f"{right} %"
    )


EFFECT = Effect(
    name="reverse-mismatch",
    title="a loss of thrust in reverse that differs between the thrusters",
    place="actuator",
    hooks={"thrust_loss": lose},
    parameters=tuple(
        Parameter(f"rho_{side}", 0.0, "", f"relative loss of reverse thrust, {side}", prior=(0.0, 0.4), step=0.05)
        for side in ("left", "right")
    ),
    formula="f_i *= 1 - rho_i for n_i < 0, i the left and the right thruster",
    source="four-quadrant open-water data; wear, fouling and end points of one speed controller",
    causes="one propeller that is damaged or loose in reverse, end points of one speed controller in reverse",
    experiment="reverse steps of several levels with one thruster at a time, and turning on the spot",
    requires=("n", "f", "hull"),
    nests=("reverse-thrust",),
    alternatives=("propeller-walk", "mismatch", "thrust-angle", "dead-band"),
    in_words=compare_sides,
)
