"""Derating: thrust that falls as the motors or speed controllers heat up, and that comes back as they cool."""

from __future__ import annotations

from collections.abc import Mapping

from seatrial.ident.model import Effect, Parameter, Signals, State, share_in_words
from seatrial.ident.models import SIDES

# A thruster that becomes hot over most of a run and does not cool in it looks like a battery that sags: with a time
# constant of 280 s, a discharging battery of the mock boat was called derating for certain.
LONGEST_S = 120.0


def derate(s: Signals) -> None:
    """Multiply each thrust in ``s.f`` by ``1 - k_heat H`` and set the rate of the heat ``H`` of its thruster.

    The heat is the temperature above that of a cold thruster, in units of the one at continuous full power. Its power
    is ``|n|^3``, the shaft power of a propeller, over that at full speed.
    """
    for side in SIDES:
        heat, n = getattr(s.x, f"heat_{side}"), abs(s.n[side])
        s.rate[f"heat_{side}"] = (n * n * n - heat) / s.p.tau_heat
        s.f[side] = s.f[side] * (1 - s.p.k_heat * heat)


def describe(estimates: Mapping[str, tuple[float, float]]) -> str:
    """Return a clause for reports: the lost share of the thrust at continuous full power, and the time it takes.

    Parameters
    ----------
    estimates : Mapping[str, tuple[float, float]]
        Estimate and standard error by parameter: the lost share ``k_heat`` and the time constant ``tau_heat`` [s].
    """
    return (
        f"at continuous full power the thrust falls by {share_in_words(*estimates['k_heat'])} %, with a time constant "
        f"of {estimates['tau_heat'][0]:.0f} s, and at rest it comes back in the same time"
    )


EFFECT = Effect(
    name="derating",
    title="thrust that falls as motors or speed controllers heat up",
    place="actuator",
    hooks={"thrust_loss": derate},
    parameters=(
        Parameter(
            "k_heat",
            0.0,
            "",
            "share of the thrust that is lost at continuous full power",
            prior=(0.0, 0.4),
            bounds=(0.0, 0.9),  # below 1, so that the thrust keeps its sign
            step=0.02,
        ),
        Parameter(
            "tau_heat",
            60.0,
            "s",
            "thermal time constant",
            "log",
            prior=(60.0, 60.0),
            bounds=(5.0, LONGEST_S),
            scales=False,
        ),
    ),
    states=tuple(
        State(f"heat_{side}", "", f"temperature of the {side} thruster over that at full power", 0.0, sd0=0.1)
        for side in SIDES
    ),
    scan={"tau_heat": (20.0, 40.0, 80.0)},
    formula="H_i' = (|n_i|^3 - H_i) / tau_heat, f_i *= 1 - k_heat H_i",
    source="lumped thermal model of a motor, Hughes and Drury 2013, chapter 11; thermal limits of speed controllers",
    causes="speed controllers without cooling, their temperature limit, motors that become hot",
    experiment="full power for several minutes, a pause of several minutes, and full power again",
    requires=("n", "f"),
    one_sided=True,
    alternatives=("battery-sag", "fouling", "advance-ratio", "growing-drag"),
    in_words=describe,
)
