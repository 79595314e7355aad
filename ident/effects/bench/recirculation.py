"""Recirculation in the test basin: the jet sets the water in motion, and thrust decays."""

from __future__ import annotations

from seatrial.ident.model import Effect, Estimates, Parameter, Signals, State, share_in_words, size_in_words


def lose(s: Signals) -> None:
    """Multiply the thrust ``s.force`` by ``1 - k_wash w``, in place.

    The state w is the recirculation of the water in the basin. It is one in steady state at full speed.
    """
    s.force = s.force * (1 - s.p.k_wash * s.x.wash)


def drive_recirculation(s: Signals) -> None:
    """Set the rate of the recirculation of the water in the basin, in place.

    The recirculation follows the squared normalised shaft speed with the time constant ``T_wash``.
    """
    s.rate["wash"] = (s.x.n * s.x.n - s.x.wash) / s.p.T_wash


def loss(estimates: Estimates) -> str:
    """Return a clause for reports: the loss of thrust in steady state, and its time constant."""
    share, time = share_in_words(*estimates["k_wash"]), size_in_words(*estimates["T_wash"], "s")
    return f"at steady full speed the thrust falls by {share} %, with a time constant of {time}"


EFFECT = Effect(
    name="recirculation",
    title="the loss of thrust by recirculation in the basin",
    place="bench",
    hooks={"thrust": lose, "rate": drive_recirculation},
    parameters=(
        Parameter(
            "k_wash",
            0.0,
            "",
            "relative loss of thrust in steady state at full speed",
            prior=(0.0, 0.3),
            bounds=(0.0, 0.9),
            step=0.01,
        ),
        Parameter(
            "T_wash",
            4.0,
            "s",
            "time constant of recirculation",
            "log",
            prior=(4.0, 4.0),
            bounds=(0.5, 120.0),
            scales=False,
        ),
    ),
    states=(State("wash", "", "recirculation, relative to that at full speed", 0.0, sd0=0.01),),
    scan={"T_wash": (1.5, 3.0, 6.0, 12.0, 25.0)},
    formula="T w' = n^2 - w, f *= 1 - k w",
    source="bollard tests in basins: ITTC 7.5-02-03-02.1 requires a basin in which the jet does not return",
    causes="a basin that is too small for the jet",
    experiment="full speed held for a minute, then the same step after five minutes of rest",
    requires=("bench", "thrust"),
    one_sided=True,
    alternatives=("supply-sag", "cell-drift"),
    in_words=loss,
)
