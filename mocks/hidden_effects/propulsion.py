"""Hidden effects of the propulsion: losses and delays of the thrust."""

from __future__ import annotations

import math

import numpy as np

from seatrial.mocks.plant import Heating, HiddenEffect, Maker, effect_size


def _advance_ratio(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "advance-ratio": the loss of thrust of a propeller that moves through the water.

    With the shaft speed ``n`` and the forward velocity ``a`` [m/s] of the thruster through the water, its thrust ``f``
    changes to::

        f - k |n| a / (1 + 0.35 |a|)

    ``k`` [N s/m] is drawn within 15 % of ``7 scale``.
    """
    k = scale * effect_size(rng, 7.0)  # N s/m; at n = 0.6 and 1 m/s the loss is 3 N of 14 N

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        """Return the thrust [N], left and right: ``f_l`` and ``f_r`` [N] less the loss by the motion ahead.

        ``n_l`` and ``n_r`` are the shaft speeds (-1 to 1), ``a_l`` and ``a_r`` [m/s] the forward velocities of the
        thrusters through the water, and ``energy`` is the used energy in units of ENERGY_UNIT.
        """
        loss_l = k * abs(n_l) * a_l / (1.0 + 0.35 * abs(a_l))
        loss_r = k * abs(n_r) * a_r / (1.0 + 0.35 * abs(a_r))
        return f_l - loss_l, f_r - loss_r

    return HiddenEffect(
        "advance-ratio", "the propellers lose thrust as the boat moves forward", {"k": k}, thrust=thrust
    )


def _reverse_thrust(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "reverse-thrust": the loss of thrust in reverse, where the jets strike the hull.

    For a shaft speed ``n < 0`` the thrust is multiplied by ``1 - loss (1 - exp(2.5 n))``. ``loss`` is drawn within 15 %
    of ``0.4 scale``.
    """
    loss = scale * effect_size(rng, 0.40)  # at n = -0.5 the loss is 0.29 of the thrust

    def factor(n: float) -> float:
        """Return the factor on the thrust at the shaft speed ``n``; 1 if ``n`` is not negative."""
        return 1.0 if n >= 0.0 else 1.0 - loss * (1.0 - math.exp(2.5 * n))

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        """Return the thrust [N], left and right: ``f_l`` and ``f_r`` [N], reduced if the shaft turns in reverse.

        ``n_l`` and ``n_r`` are the shaft speeds (-1 to 1), ``a_l`` and ``a_r`` [m/s] the forward velocities of the
        thrusters through the water, and ``energy`` is the used energy in units of ENERGY_UNIT.
        """
        return f_l * factor(n_l), f_r * factor(n_r)

    sentence = "in reverse the jets strike the hull and part of the thrust is lost; the bench does not show it"
    return HiddenEffect("reverse-thrust", sentence, {"loss": loss}, thrust=thrust)


def _reverse_mismatch(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "reverse-mismatch": one propeller is weak in reverse.

    For a shaft speed ``n < 0`` the thrust of the left thruster (``right`` 0) or of the right one (``right`` 1) is
    multiplied by ``1 - loss (1 - exp(6 n))``. ``loss`` is drawn within 15 % of ``0.5 scale``.
    """
    loss, is_right = scale * effect_size(rng, 0.5), rng.random() < 0.5

    def factor(n: float) -> float:
        """Return the factor on the thrust of the weak thruster at the shaft speed ``n``; 1 if ``n`` is not negative."""
        return 1.0 if n >= 0.0 else 1.0 - loss * (1.0 - math.exp(6.0 * n))

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        """Return the thrust [N], left and right: ``f_l`` and ``f_r`` [N], that of the weak side reduced in reverse."""
        return (f_l, f_r * factor(n_r)) if is_right else (f_l * factor(n_l), f_r)

    side = "right" if is_right else "left"
    sentence = f"in reverse the {side} propeller loses up to {100.0 * loss:.0f} % of its thrust"
    return HiddenEffect("reverse-mismatch", sentence, {"loss": loss, "right": float(is_right)}, thrust=thrust)


def _mismatch(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "mismatch": thrusters of different strength.

    The thrust is multiplied by ``1 + eps (0.8 + 0.3 |n|)`` on the left and ``1 - eps (0.8 + 0.3 |n|)`` on the right.
    ``eps`` is drawn within 15 % of ``0.05 scale`` with a random sign.
    """
    eps = scale * effect_size(rng, 0.05, signed=True)

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        """Return the thrust [N], left and right: one of ``f_l`` and ``f_r`` [N] is increased, the other reduced.

        ``n_l`` and ``n_r`` are the shaft speeds (-1 to 1), ``a_l`` and ``a_r`` [m/s] the forward velocities of the
        thrusters through the water, and ``energy`` is the used energy in units of ENERGY_UNIT.
        """
        return f_l * (1.0 + eps * (0.8 + 0.3 * abs(n_l))), f_r * (1.0 - eps * (0.8 + 0.3 * abs(n_r)))

    stronger = "left" if eps > 0.0 else "right"
    return HiddenEffect("mismatch", f"the {stronger} thruster is the stronger one", {"eps": eps}, thrust=thrust)


def _thruster_interaction(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "thruster-interaction": a loss of thrust in water that the other thruster accelerates.

    The thrust is multiplied by ``1 - kappa |n|^1.3``, with the shaft speed ``n`` of the opposite thruster. ``kappa`` is
    drawn within 15 % of ``0.17 scale``.
    """
    kappa = scale * effect_size(rng, 0.17)

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        """Return the thrust [N], left and right: ``f_l`` and ``f_r`` [N], reduced by the other shaft's speed.

        ``n_l`` and ``n_r`` are the shaft speeds (-1 to 1), ``a_l`` and ``a_r`` [m/s] the forward velocities of the
        thrusters through the water, and ``energy`` is the used energy in units of ENERGY_UNIT.
        """
        return f_l * (1.0 - kappa * abs(n_r) ** 1.3), f_r * (1.0 - kappa * abs(n_l) ** 1.3)

    sentence = "each thruster draws from the water that the other has set in motion"
    return HiddenEffect("thruster-interaction", sentence, {"kappa": kappa}, thrust=thrust)


def _battery_sag(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "battery-sag": the loss of thrust with a falling battery voltage.

    The thrust is multiplied by ``1 - beta (1 - exp(-1.6 energy))``. ``energy`` is the used energy: the integral of
    ``|n|^3`` over time, summed over both thrusters, divided by ENERGY_UNIT (150 s). ``beta`` is drawn within 15 % of
    ``0.2 scale``.
    """
    beta = scale * effect_size(rng, 0.20)  # after a mission of ten minutes the loss is 0.16 of the thrust

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        """Return the thrust [N], left and right: ``f_l`` and ``f_r`` [N], reduced by the used energy.

        ``n_l`` and ``n_r`` are the shaft speeds (-1 to 1), ``a_l`` and ``a_r`` [m/s] the forward velocities of the
        thrusters through the water, and ``energy`` is the used energy in units of ENERGY_UNIT.
        """
        gain = 1.0 - beta * (1.0 - math.exp(-1.6 * energy))
        return gain * f_l, gain * f_r

    return HiddenEffect("battery-sag", "thrust fades as the battery is used up", {"beta": beta}, thrust=thrust)


def _dead_band(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "dead-band": propellers with almost no thrust at low shaft speed.

    The thrust is multiplied by ``(beyond(n) / (beyond(1) |n|))^2``, which is 1 at full speed: the known thrust at full
    speed was measured with the dead band. ``beyond`` is a smooth version of ``max(|n| - band, 0)`` (softplus with the
    width ``band / 4``, shifted to zero at ``n = 0``). ``band`` is drawn within 15 % of ``0.06 scale``.
    """
    band = scale * effect_size(rng, 0.06)
    soft = 0.25 * band

    def beyond(size: float) -> float:
        """Return the part of a shaft speed of magnitude ``size`` beyond the dead band, smooth at its edge."""
        above = size - band
        return max(above, 0.0) + soft * (math.log1p(math.exp(-abs(above) / soft)) - math.log1p(math.exp(-4.0)))

    def remaining_share(n: float) -> float:
        """Return the fraction of the thrust that is left at shaft speed ``n``; 1 without an effect or at ``n = 0``."""
        return (beyond(abs(n)) / (beyond(1.0) * abs(n))) ** 2 if band and n else 1.0

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        """Return the thrust [N], left and right: ``f_l`` and ``f_r`` [N], reduced at low shaft speed.

        ``n_l`` and ``n_r`` are the shaft speeds (-1 to 1), ``a_l`` and ``a_r`` [m/s] the forward velocities of the
        thrusters through the water, and ``energy`` is the used energy in units of ENERGY_UNIT.
        """
        return f_l * remaining_share(n_l), f_r * remaining_share(n_r)

    sentence = "slow propellers slip through the water and make hardly any thrust"
    return HiddenEffect("dead-band", sentence, {"band": band}, thrust=thrust)


def _delay(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "delay": a thrust that follows the shaft speed with a delay.

    Five sixths of ``delay`` [s] are dead time. One sixth is the time constant of a first-order lag, which is 20 %
    longer while the shaft slows down. ``delay`` is drawn within 15 % of ``0.3 scale``.
    """
    delay = scale * effect_size(rng, 0.30)  # s
    sentence = "the speed controllers report the shaft speed before the water has it"
    return HiddenEffect("delay", sentence, {"delay": delay}, inflow=(delay * 5.0 / 6.0, delay / 6.0))


def _lag(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "lag": a thrust that follows the shaft speed with a first-order lag.

    The time constant ``lag`` [s] is drawn within 15 % of ``0.3 scale``. It is 20 % longer while the shaft slows down
    (``Inflow`` in seatrial.mocks.plant.thruster).
    """
    lag = scale * effect_size(rng, 0.30)  # s
    sentence = "the jets take time to build up after the shafts have changed speed"
    return HiddenEffect("lag", sentence, {"lag": lag}, inflow=(0.0, lag))


def _lag_mismatch(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "lag-mismatch": the thrust of one thruster follows its shaft late.

    The left thruster (``right`` 0) or the right one (``right`` 1) has a first-order lag with the time constant ``lag``
    [s], which is 20 % longer while the shaft slows down (``Inflow`` in seatrial.mocks.plant.thruster). ``lag`` is drawn
    within 15 % of ``0.8 scale``.
    """
    lag, is_right = scale * effect_size(rng, 0.8), rng.random() < 0.5  # s
    side = "right" if is_right else "left"
    sentence = f"the {side} thruster follows its command {lag:.1f} s later than the other one"
    slowness = (0.0, lag) if is_right else (lag, 0.0)
    return HiddenEffect("lag-mismatch", sentence, {"lag": lag, "right": float(is_right)}, slowness=slowness)


def _derating(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "derating": hot speed controllers limit the thrust, until they have cooled.

    Each thruster loses the share ``loss`` of its thrust at the temperature of continuous full power. ``loss`` is drawn
    within 15 % of ``0.45 scale``, and the time constant ``tau`` [s] of the temperature within 15 % of 45 s.
    """
    loss, tau = min(scale * effect_size(rng, 0.45), 0.9), effect_size(rng, 45.0)
    sentence = f"hot speed controllers take up to {100.0 * loss:.0f} % of the thrust, and give it back as they cool"
    return HiddenEffect("derating", sentence, {"loss": loss, "tau": tau}, heating=Heating(loss, tau))


def _wash(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "wash": a propeller that runs astern stands in the jet of the other one ahead.

    For the shaft speeds ``n < 0`` and ``m > 0`` of the other thruster, the thrust is multiplied by ``1 - loss
    (1 - exp(8 n)) (1 - exp(-8 m))``. ``loss`` is drawn within 15 % of ``0.4 scale``.
    """
    loss = min(scale * effect_size(rng, 0.4), 1.0)

    def factor(n: float, other: float) -> float:
        """Return the factor on the thrust at the shaft speed ``n``, with the speed of the ``other`` shaft."""
        if n >= 0.0 or other <= 0.0:
            return 1.0
        return 1.0 - loss * (1.0 - math.exp(8.0 * n)) * (1.0 - math.exp(-8.0 * other))

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        """Return the thrust [N], left and right: ``f_l`` and ``f_r`` [N], reduced astern if the other runs ahead."""
        return f_l * factor(n_l, n_r), f_r * factor(n_r, n_l)

    sentence = f"a propeller astern loses up to {100.0 * loss:.0f} % of its thrust in the wash of the other one ahead"
    return HiddenEffect("wash", sentence, {"loss": loss}, thrust=thrust)


def _load_sag(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "load-sag": a common supply whose voltage falls with the current of both thrusters.

    A supply with an internal resistance feeds both speed controllers. Its voltage, over that without a load, is
    ``v = 1 - k i``. The current ``i``, over that of both thrusters at full speed and full voltage, is ``v`` times the
    mean of ``|n|^3``, as the torque of the propellers falls with their thrust. So ``v`` is ``1 / (1 + k mean(|n|^3))``,
    without a delay. The thrust of each thruster is multiplied by ``v``. ``k`` is the voltage drop at full current over
    the voltage without a load, and is drawn within 15 % of ``0.3 scale``.
    """
    k = scale * effect_size(rng, 0.3)  # with both thrusters at full speed, 0.23 of the thrust is lost

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        """Return the thrust [N], left and right: ``f_l`` and ``f_r`` [N], reduced by the common load.

        ``n_l`` and ``n_r`` are the shaft speeds (-1 to 1), ``a_l`` and ``a_r`` [m/s] the forward velocities of the
        thrusters through the water, and ``energy`` is the used energy in units of ENERGY_UNIT.
        """
        voltage = 1.0 / (1.0 + 0.5 * k * (abs(n_l) ** 3 + abs(n_r) ** 3))
        return voltage * f_l, voltage * f_r

    sentence = f"both thrusters lose up to {100.0 * k / (1.0 + k):.0f} % of their thrust under their common load"
    return HiddenEffect("load-sag", sentence, {"k": k}, thrust=thrust)


MAKERS: dict[str, Maker] = {
    "advance-ratio": _advance_ratio,
    "reverse-thrust": _reverse_thrust,
    "reverse-mismatch": _reverse_mismatch,
    "mismatch": _mismatch,
    "battery-sag": _battery_sag,
    "thruster-interaction": _thruster_interaction,
    "dead-band": _dead_band,
    "delay": _delay,
    "lag": _lag,
    "lag-mismatch": _lag_mismatch,
    "derating": _derating,
    "wash": _wash,
    "load-sag": _load_sag,
}
