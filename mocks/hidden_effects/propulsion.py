"""What takes thrust away, or makes it late."""

from __future__ import annotations

import math

import numpy as np

from seatrial.mocks.plant import HiddenEffect, Maker, effect_size


def _advance_ratio(rng: np.random.Generator, scale: float) -> HiddenEffect:
    k = scale * effect_size(rng, 7.0)  # N s/m: at n = 0.6 and 1 m/s 3 of 14 N are lost

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        loss_l = k * abs(n_l) * a_l / (1.0 + 0.35 * abs(a_l))
        loss_r = k * abs(n_r) * a_r / (1.0 + 0.35 * abs(a_r))
        return f_l - loss_l, f_r - loss_r

    return HiddenEffect(
        "advance-ratio", "the propellers lose thrust as the boat moves forward", {"k": k}, thrust=thrust
    )


def _reverse_thrust(rng: np.random.Generator, scale: float) -> HiddenEffect:
    loss = scale * effect_size(rng, 0.40)  # 0.29 of the thrust at n = -0.5

    def factor(n: float) -> float:
        return 1.0 if n >= 0.0 else 1.0 - loss * (1.0 - math.exp(2.5 * n))

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        return f_l * factor(n_l), f_r * factor(n_r)

    sentence = "in reverse the jets strike the hull and part of the thrust is lost; the bench does not show it"
    return HiddenEffect("reverse-thrust", sentence, {"loss": loss}, thrust=thrust)


def _mismatch(rng: np.random.Generator, scale: float) -> HiddenEffect:
    eps = scale * effect_size(rng, 0.05, signed=True)

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        return f_l * (1.0 + eps * (0.8 + 0.3 * abs(n_l))), f_r * (1.0 - eps * (0.8 + 0.3 * abs(n_r)))

    stronger = "left" if eps > 0.0 else "right"
    return HiddenEffect("mismatch", f"the {stronger} thruster is the stronger one", {"eps": eps}, thrust=thrust)


def _thruster_interaction(rng: np.random.Generator, scale: float) -> HiddenEffect:
    kappa = scale * effect_size(rng, 0.17)

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        return f_l * (1.0 - kappa * abs(n_r) ** 1.3), f_r * (1.0 - kappa * abs(n_l) ** 1.3)

    sentence = "each thruster draws from the water that the other has set in motion"
    return HiddenEffect("thruster-interaction", sentence, {"kappa": kappa}, thrust=thrust)


def _battery_sag(rng: np.random.Generator, scale: float) -> HiddenEffect:
    beta = scale * effect_size(rng, 0.20)  # 0.16 of the thrust after a mission of ten minutes

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        gain = 1.0 - beta * (1.0 - math.exp(-1.6 * energy))
        return gain * f_l, gain * f_r

    return HiddenEffect("battery-sag", "thrust fades as the battery is used up", {"beta": beta}, thrust=thrust)


def _dead_band(rng: np.random.Generator, scale: float) -> HiddenEffect:
    band = scale * effect_size(rng, 0.06)
    soft = 0.25 * band

    def part(n: float) -> float:
        """Thrust goes with the square of the speed beyond a soft band."""
        if not band or not n:
            return 1.0
        above = abs(n) - band
        beyond = max(above, 0.0) + soft * (math.log1p(math.exp(-abs(above) / soft)) - math.log1p(math.exp(-4.0)))
        return (beyond / abs(n)) ** 2

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        return f_l * part(n_l), f_r * part(n_r)

    sentence = "slow propellers slip through the water and make hardly any thrust"
    return HiddenEffect("dead-band", sentence, {"band": band}, thrust=thrust)


def _delay(rng: np.random.Generator, scale: float) -> HiddenEffect:
    delay = scale * effect_size(rng, 0.30)  # s, a sixth of it a lag
    sentence = "the speed controllers report the shaft speed before the water has it"
    return HiddenEffect("delay", sentence, {"delay": delay}, inflow=(delay * 5.0 / 6.0, delay / 6.0))


def _lag(rng: np.random.Generator, scale: float) -> HiddenEffect:
    lag = scale * effect_size(rng, 0.30)  # s, longer by a fifth where the shaft slows down
    sentence = "the jets take time to build up after the shafts have changed speed"
    return HiddenEffect("lag", sentence, {"lag": lag}, inflow=(0.0, lag))


MAKERS: dict[str, Maker] = {
    "advance-ratio": _advance_ratio,
    "reverse-thrust": _reverse_thrust,
    "mismatch": _mismatch,
    "battery-sag": _battery_sag,
    "thruster-interaction": _thruster_interaction,
    "dead-band": _dead_band,
    "delay": _delay,
    "lag": _lag,
}
