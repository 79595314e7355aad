"""Difference of the thrust of the left and the right thruster."""

from __future__ import annotations

from collections.abc import Mapping

from seatrial.ident.model import Effect, Parameter, Signals, share_in_words


def scale(s: Signals) -> None:
    """Multiply the thrust of the left thruster by ``1 + eps_LR`` and that of the right by ``1 - eps_LR``, in place.

    If one side has the given thrust (``s.thrust_of``), both factors are divided by that of this side: its thrust is
    unchanged, and ``eps_LR`` is still half the difference over the mean.
    """
    factors = {"left": 1 + s.p.eps_LR, "right": 1 - s.p.eps_LR}
    given = getattr(s, "thrust_of", "")
    for side, factor in factors.items():
        if not given:
            s.f[side] = s.f[side] * factor
        elif side != given:
            s.f[side] = s.f[side] * (factor / factors[given])


def compare_sides(estimates: Mapping[str, tuple[float, float]]) -> str:
    """Return a clause for reports: "the left thruster gives 90 ± 2 % of the thrust of the right one".

    Parameters
    ----------
    estimates : Mapping[str, tuple[float, float]]
        Estimate and standard error by parameter. Only ``eps_LR`` is used: half the relative difference, left minus
        right.

    Returns
    -------
    str
        The thrust of the weaker thruster in per cent of that of the stronger one, with its standard error. At an
        estimate of zero, the right thruster is named as the weaker one.
    """
    eps, se = estimates["eps_LR"]
    weaker, stronger = ("left", "right") if eps < 0 else ("right", "left")
    share = (1 - abs(eps)) / (1 + abs(eps))
    error = 2 * se / (1 + abs(eps)) ** 2  # first-order error of the share
    return f"the {weaker} thruster gives {share_in_words(share, error)} % of the thrust of the {stronger} one"


EFFECT = Effect(
    name="mismatch",
    title="a thrust mismatch of the left and right thrusters",
    place="actuator",
    hooks={"thrust_loss": scale},
    parameters=(
        Parameter("eps_LR", 0.0, "", "half the relative difference, left minus right", prior=(0.0, 0.2), step=0.01),
    ),
    formula="f_L *= 1 + eps, f_R *= 1 - eps",
    source="propeller wear, fouling, ESC end points",
    causes="a fouled or damaged propeller, a propeller of another pitch, end points of one speed controller",
    experiment="equal commands in forward and reverse, at several levels: the yaw rate follows the thrust",
    requires=("f", "hull"),
    alternatives=("yaw-bias", "sway-yaw", "fouling"),
    in_words=compare_sides,
    thrust_difference="eps_LR",
)
