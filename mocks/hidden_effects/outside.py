"""Hidden effects that no analysis can be expected to list by name.

The `Answer` of each effect is the curve that an analysis should find: the force, and the variable it depends on.
"""

from __future__ import annotations

import math

import numpy as np

from seatrial.mocks.plant import Answer, HiddenEffect, Maker, ThrusterTruth, effect_size
from seatrial.mocks.plant import thrust as thrust_at_rest


def _thrust_band(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "thrust-band": a loss of thrust in a band of shaft speeds.

    Propellers that draw air lose thrust like this. With the mean shaft speed ``n`` of both thrusters, each thrust is
    multiplied by ``1 - loss / (1 + ((n - at) / 0.12)^4)``. ``loss`` is drawn within 15 % of ``0.28 scale``, and ``at``
    within 15 % of 0.55.
    """
    loss, at = scale * effect_size(rng, 0.28), effect_size(rng, 0.55)

    def lost(n: float) -> float:
        """Return the fraction of the thrust that is lost at the mean shaft speed ``n``, at most ``loss``."""
        return loss / (1.0 + ((n - at) / 0.12) ** 4)

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        """Return the thrust [N], left and right: ``f_l`` and ``f_r`` [N] less the share lost in the band.

        ``n_l`` and ``n_r`` are the shaft speeds (-1 to 1), ``a_l`` and ``a_r`` [m/s] the forward velocities of the
        thrusters through the water, and ``energy`` is the used energy in units of ENERGY_UNIT.
        """
        share = lost((n_l + n_r) / 2.0)
        return f_l * (1.0 - share), f_r * (1.0 - share)

    def curve(n: float) -> float:
        """Return the change of the surge force [N] of a boat at rest at mean shaft speed ``n``: minus the loss."""
        return -2.0 * lost(n) * thrust_at_rest(ThrusterTruth(), n)

    sentence = f"both propellers draw air in a band of shaft speeds around {at:.2f}"
    answer = Answer("X", "n_sum", curve)
    return HiddenEffect("thrust-band", sentence, {"loss": loss, "at": at}, thrust=thrust, answer=answer)


def _yaw_saddle(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "yaw-saddle": a yaw moment that changes its sign at the surge velocity ``at`` [m/s].

    With the surge velocity ``u`` through the water and ``z = (u - at) / 0.3``::

        N = 1.65 n z exp(-z^2 / 2)

    ``n`` [N m] is drawn within 15 % of ``0.7 scale`` with a random sign, and ``at`` within 15 % of 0.55.
    """
    n, at = scale * effect_size(rng, 0.7, signed=True), effect_size(rng, 0.55)  # N m, m/s

    def curve(u: float) -> float:
        """Return the yaw moment [N m] at the surge velocity ``u`` [m/s]; its sign changes at ``at``."""
        z = (u - at) / 0.3
        return n * 1.65 * z * math.exp(-0.5 * z * z)

    def force(c: float, s: float, u: float, v: float, r: float, v_n: float, v_e: float) -> tuple[float, float, float]:
        """Return X and Y [N], zero, and the yaw moment N [N m] at the surge velocity ``u``.

        ``c`` and ``s`` are cosine and sine of the heading, ``u`` and ``v`` [m/s] the velocity through the water in body
        axes, ``r`` [rad/s] the yaw rate, and ``v_n`` and ``v_e`` [m/s] the velocity over ground, north and east.
        """
        return 0.0, 0.0, curve(u)

    sentence = "a bent bow turns the boat one way at low speed and the other way at high speed"
    return HiddenEffect("yaw-saddle", sentence, {"n": n, "at": at}, force=force, answer=Answer("N", "u", curve))


def _surge_step(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "surge-step": a drag that drops above the surge velocity ``at`` [m/s].

    The additional force is ``X = relief (1 + tanh((u - at) / 0.05)) / 2``. ``relief`` [N] is drawn within 15 % of
    ``6 scale``, and ``at`` within 15 % of 0.75.
    """
    relief, at = scale * effect_size(rng, 6.0), effect_size(rng, 0.75)  # N, m/s

    def curve(u: float) -> float:
        """Return the surge force [N] at the surge velocity ``u`` [m/s]: 0 well below ``at``, ``relief`` above."""
        return relief * 0.5 * (1.0 + math.tanh((u - at) / 0.05))

    def force(c: float, s: float, u: float, v: float, r: float, v_n: float, v_e: float) -> tuple[float, float, float]:
        """Return the surge force X [N] at the surge velocity ``u``; Y [N] and N [N m] are zero.

        ``c`` and ``s`` are cosine and sine of the heading, ``u`` and ``v`` [m/s] the velocity through the water in body
        axes, ``r`` [rad/s] the yaw rate, and ``v_n`` and ``v_e`` [m/s] the velocity over ground, north and east.
        """
        return curve(u), 0.0, 0.0

    sentence = f"above {at:.2f} m/s the stern breaks free and the boat drags less"
    return HiddenEffect(
        "surge-step", sentence, {"relief": relief, "at": at}, force=force, answer=Answer("X", "u", curve)
    )


def _heading_third(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "heading-third": a yaw moment with three cycles per turn of the boat.

    The moment is ``N = n sin(3 (psi - at))``. ``n`` [N m] is drawn within 15 % of ``0.5 scale``, and the heading ``at``
    [rad] uniformly.
    """
    n, at = scale * effect_size(rng, 0.5), 2.0 * math.pi * rng.uniform()  # N m

    def curve(psi: float) -> float:
        """Return the yaw moment [N m] at the heading ``psi`` [rad]: a sine with three cycles per turn."""
        return n * math.sin(3.0 * (psi - at))

    def force(c: float, s: float, u: float, v: float, r: float, v_n: float, v_e: float) -> tuple[float, float, float]:
        """Return X and Y [N], zero, and the yaw moment N [N m] at this heading.

        ``c`` and ``s`` are cosine and sine of the heading, ``u`` and ``v`` [m/s] the velocity through the water in body
        axes, ``r`` [rad/s] the yaw rate, and ``v_n`` and ``v_e`` [m/s] the velocity over ground, north and east.
        """
        return 0.0, 0.0, curve(math.atan2(s, c))

    sentence = "waves thrown back by three quays turn the boat, by a moment of three cycles in a circle"
    return HiddenEffect("heading-third", sentence, {"n": n, "at": at}, force=force, answer=Answer("N", "psi", curve))


def _jet_on_hull(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "jet-on-hull": a sway force of a jet that strikes the keel.

    The force depends on the difference ``d = n_left - n_right`` of the shaft speeds::

        Y = y exp(-((d - 0.35) / 0.15)^2 / 2)

    ``y`` [N] is drawn within 15 % of ``5 scale`` with a random sign.
    """
    y = scale * effect_size(rng, 5.0, signed=True)  # N

    def curve(difference: float) -> float:
        """Return the sway force [N] at a difference of the shaft speeds, left minus right: a bell curve around 0.35."""
        return y * math.exp(-0.5 * ((difference - 0.35) / 0.15) ** 2)

    def jet(n_l: float, n_r: float) -> tuple[float, float]:
        """Return the sway force [N] and the yaw moment [N m], zero, at the shaft speeds of both thrusters."""
        return curve(n_l - n_r), 0.0

    sentence = "at one difference of the shaft speeds a jet strikes the keel and shoves the boat sideways"
    return HiddenEffect("jet-on-hull", sentence, {"y": y}, jet=jet, answer=Answer("Y", "n_diff", curve))


MAKERS: dict[str, Maker] = {
    "thrust-band": _thrust_band,
    "yaw-saddle": _yaw_saddle,
    "surge-step": _surge_step,
    "heading-third": _heading_third,
    "jet-on-hull": _jet_on_hull,
}
