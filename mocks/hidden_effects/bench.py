"""Catalogue of the hidden effects of the mock bench, which the nominal thruster model lacks.

The size of an effect is drawn within 15 % of the full size in this table. Effects that can act in two directions get a
random sign.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from seatrial.mocks.plant import BenchEffect, ShaftEffect
from seatrial.mocks.random_streams import EFFECT_NAME, EFFECT_SIZE, random_stream

# The position in this table selects the stream of random numbers: add new effects at the end.
EFFECTS: dict[str, Callable[[np.random.Generator, float], BenchEffect]] = {
    "rod-flex": lambda rng, scale: BenchEffect(
        "rod-flex", "the rod swings in its mount when thrust changes", flex_hz=_random_size(rng, 6.0), flex_share=scale
    ),
    "recirculation": lambda rng, scale: BenchEffect(
        "recirculation", "the jet sets the pool in motion and loses thrust to it", wash=scale * _random_size(rng, 0.12)
    ),
    "cell-drift": lambda rng, scale: BenchEffect(
        "cell-drift", "the load cell creeps as it warms up", drift=scale * _random_size(rng, 1.0, signed=True)
    ),
    "reverse-loss": lambda rng, scale: BenchEffect(
        "reverse-loss", "in reverse the propeller gives less than its coefficients",
        reverse=scale * _random_size(rng, 0.15),
    ),
    "supply-sag": lambda rng, scale: _shaft_effect(
        "supply-sag", "the shaft slows down as the battery is used up", sag=scale * _random_size(rng, 0.08)
    ),
    "second-lag": lambda rng, scale: _shaft_effect(
        "second-lag", "the speed controller smooths its commands", late=scale * _random_size(rng, 0.08)
    ),
    "spin-up": lambda rng, scale: _shaft_effect(
        "spin-up", "the shaft speeds up faster than it slows down", brisk=scale * _random_size(rng, 0.24)
    ),
    "slew-limit": lambda rng, scale: _shaft_effect(
        "slew-limit", "the motor's current is limited, and so is the acceleration of the shaft",
        slew=scale * _random_size(rng, 0.8),
    ),
    "speed-curve": lambda rng, scale: _shaft_effect(
        "speed-curve", "the larger the command, the more the shaft falls behind it",
        droop=scale * _random_size(rng, 0.08),
    ),
    "thrust-dead-band": lambda rng, scale: BenchEffect(
        "thrust-dead-band", "at slow speed the propeller gives hardly any thrust", band=scale * _random_size(rng, 0.04)
    ),
    "thrust-exponent": lambda rng, scale: BenchEffect(
        "thrust-exponent", "slow blades lose thrust to viscosity", slow_loss=scale * _random_size(rng, 0.3)
    ),
    "cell-lag": lambda rng, scale: BenchEffect(
        "cell-lag", "the amplifier of the load cell smooths", smooth_s=scale * _random_size(rng, 0.06)
    ),
    "controller-dead-band": lambda rng, scale: _shaft_effect(
        "controller-dead-band", "the speed controller ignores small commands and begins from rest beyond them",
        ignored=scale * _random_size(rng, 0.07),
    ),
}  # fmt: skip
DEMO = ("rod-flex", "recirculation", "cell-drift")  # effects that `--effect draw` chooses from


def _random_size(rng: np.random.Generator, size: float, *, signed: bool = False) -> float:
    """Return a random size of an effect: ``size`` times a factor that is uniform between 0.85 and 1.15.

    If ``signed`` is true, the sign is random too. ``rng`` draws both.
    """
    return float(size * rng.uniform(0.85, 1.15)) * (1 - 2 * (signed and rng.uniform() < 0.5))


def _shaft_effect(name: str, sentence: str, **sizes: float) -> BenchEffect:
    """Return the hidden effect of the mock bench with this ``name`` that acts only on the response of the shaft.

    ``sentence`` is its description for the user. ``sizes`` are the sizes of the effect, by field of `ShaftEffect`.
    """
    return BenchEffect(name, sentence, shaft=ShaftEffect(**sizes))


def make_effect(name: str, seed: int, scale: float = 1.0) -> BenchEffect:
    """Return a hidden effect of the mock bench with a size that is drawn at random.

    Parameters
    ----------
    name : str
        Name of the effect, a key of EFFECTS such as "rod-flex".
    seed : int
        Seed of the size and the sign. The same seed gives the same effect.
    scale : float
        Factor on the full size. For "rod-flex" it is the field `flex_share`; the frequency does not depend on it.

    Raises
    ------
    KeyError
        If no effect of the bench has this name.
    """
    return EFFECTS[name](random_stream(seed, EFFECT_SIZE, index=100 + list(EFFECTS).index(name)), scale)


def draw_name(seed: int) -> str:
    """Return the name of the hidden effect that ``--effect draw`` chooses for a mock bench of this seed.

    It is one of DEMO: "rod-flex", "recirculation" or "cell-drift".
    """
    return DEMO[int(random_stream(seed, EFFECT_NAME, index=1).integers(len(DEMO)))]
