"""Loss of shaft speed as the supply voltage of the bench falls."""

from __future__ import annotations

from seatrial.ident.model import Effect, Parameter, Signals, State, share_in_sentence

WORK_UNIT_S = 30.0  # s at full power: the unit of work


def reduce_speed(s: Signals) -> None:
    """Multiply the reference shaft speed ``s.n_ref`` by ``1 - k_sag E``, in place.

    The state E is the work of the thruster since the start of the record, relative to that of 30 s at full speed.
    """
    s.n_ref = s.n_ref * (1 - s.p.k_sag * s.x.used)


def discharge(s: Signals) -> None:
    """Set the rate of the work of the thruster to ``|n|^3 / 30 s``, in place, with the normalised shaft speed n.

    The work is relative to that of 30 s at full speed.
    """
    s.rate["used"] = abs(s.x.n) * s.x.n * s.x.n / WORK_UNIT_S


EFFECT = Effect(
    name="supply-sag",
    title="the loss of shaft speed with battery discharge",
    place="actuator",
    hooks={"shaft": reduce_speed, "rate": discharge},
    parameters=(
        Parameter(
            "k_sag",
            0.0,
            "",
            "relative loss of shaft speed after 30 s at full power",
            prior=(0.0, 0.3),
            bounds=(0.0, 0.9),
            step=0.005,
        ),
    ),
    states=(State("used", "", "work done, relative to that of 30 s at full power", 0.0, sd0=1e-4),),
    formula="n_ref *= 1 - k E, E' = |n|^3 / 30 s",
    source="open-loop speed control on a sagging supply; vendors' tables of shaft speed against voltage",
    causes="a supply whose voltage falls with load",
    experiment="the same steps at the start and at the end of a long run, with the voltage logged",
    requires=("bench",),
    one_sided=True,
    alternatives=("speed-curve", "recirculation"),
    in_words=share_in_sentence("k_sag", "the shaft speed falls by {} % in 30 s of full power"),
)
