"""Loss of thrust as the battery voltage falls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from seatrial.ident.model import INF, Effect, Estimates, Input, Parameter, Signals, share_in_words


def sag(s: Signals) -> None:
    """Multiply the thrust of each thruster by ``1 - beta_E E``, in place in ``s.f``.

    E is the work of both thrusters since the start of the record: the integral of ``|n_left|^3 + |n_right|^3`` over
    time, divided by 150 s.
    """
    for side, f in s.f.items():
        s.f[side] = f * (1 - s.p.beta_E * s.u.work)


FULL_POWER = 75.0  # s, of two thrusters at full power for one unit of work


def loss(estimates: Estimates) -> str:
    """Return a clause for reports: the loss of thrust ``beta_E`` in one unit of work, which is 75 s at full power."""
    return f"the thrust falls by {share_in_words(*estimates['beta_E'])} % in {FULL_POWER:g} s of full power"


def loss_in_data(estimates: Estimates, at_end: Mapping[str, Sequence[float]]) -> str:
    """Return a clause for reports: the loss of thrust at the end of a run, the one with the most work of several."""
    value, error = estimates["beta_E"]
    work = max(at_end["work"])
    run = "the run" if len(at_end["work"]) == 1 else "the run with the most work"
    return (
        f"at the end of {run}, after the work of {FULL_POWER * work:.0f} s at full power, the thrust is "
        f"{share_in_words(value * work, error * work)} % smaller than at its start"
    )


EFFECT = Effect(
    name="battery-sag",
    title="the loss of thrust with battery discharge",
    place="actuator",
    hooks={"thrust_loss": sag},
    parameters=(
        Parameter(
            "beta_E",
            0.0,
            "",
            "relative loss of thrust per unit of work",
            prior=(0.0, 0.4),
            bounds=(0.0, INF),
            step=0.02,
        ),
    ),
    inputs=(Input("work", "", "linear"),),
    formula="f_i *= 1 - beta E(t), E the integral of |n_L|^3 + |n_R|^3 over 150 s",
    source="open-loop speed control on a sagging supply; vendor's tables of thrust against voltage",
    causes="a battery whose voltage falls as it empties, and speed controllers without a speed sensor",
    experiment="the same steps at the start and at the end of a long run",
    requires=("n", "f"),
    one_sided=True,
    alternatives=("derating", "load-sag", "current-drift", "tether", "advance-ratio"),
    in_words=loss,
    in_words_of_data=loss_in_data,
)
