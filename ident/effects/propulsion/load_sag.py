"""Loss of thrust under the common load of the thrusters: the supply voltage sags with the current of both."""

from __future__ import annotations

from seatrial.ident.model import Effect, Estimates, Parameter, Signals, share_in_words


def sag(s: Signals) -> None:
    """Divide the thrust of each thruster by ``1 + beta_P P``, in place in ``s.f``.

    P is the power of both thrusters relative to both at full speed, ``(|n_left|^3 + |n_right|^3) / 2``. The current
    falls with the voltage, so that the loss grows more slowly than the load. In contrast to the discharge of a battery,
    the loss ends with the load.
    """
    power = sum(abs(n) ** 3 for n in s.n.values()) / len(s.n)
    for side, f in s.f.items():
        s.f[side] = f / (1 + s.p.beta_P * power)


def remaining(estimates: Estimates) -> str:
    """Return a clause for reports: the share of the thrust that is left with all thrusters at full speed."""
    lost, error = estimates["beta_P"]
    left = 1.0 / (1.0 + lost)
    return f"with all thrusters at full speed, {share_in_words(left, error * left**2)} % of the thrust is left"


EFFECT = Effect(
    name="load-sag",
    title="the loss of thrust under the common load of the thrusters",
    place="actuator",
    hooks={"thrust_loss": sag},
    parameters=(
        Parameter(
            "beta_P",
            0.0,
            "",
            "lost over remaining thrust with all thrusters at full speed",
            prior=(0.0, 0.4),
            bounds=(0.0, 3.0),
            step=0.02,
        ),
    ),
    formula="f_i /= 1 + beta_P (|n_L|^3 + |n_R|^3) / 2",
    source="voltage drop at the internal resistance of a common battery and its cables, with a propeller's power law "
    "n^3; vendor's tables of thrust against voltage",
    causes="thrusters on one battery or one thin cable, and speed controllers without a speed sensor",
    experiment="each thruster alone, then both together, at the same commands",
    requires=("n", "f"),
    one_sided=True,
    alternatives=("thruster-interaction", "battery-sag", "thrust-power", "advance-ratio"),
    in_words=remaining,
)
