"""Hidden effects of the mock boat: effects that the nominal model lacks.

Each is physics written here for the plant alone; the forms need not equal those that an analysis tries. An effect is
drawn with its size within 15 % of the one named in its comment, and with a sign where it can have either.
"""

from __future__ import annotations

from seatrial.mocks.hidden_effects import disturbed, environment, hull, outside, propulsion, sensing
from seatrial.mocks.plant import ENERGY_UNIT, HiddenEffect, Maker
from seatrial.mocks.random_streams import EFFECT_NAME, EFFECT_SIZE, random_stream

__all__ = [
    "DEMO",
    "EFFECTS",
    "ENERGY_UNIT",
    "NOISE",
    "OUTSIDE",
    "SMALL",
    "HiddenEffect",
    "draw_name",
    "make_effect",
    "mixture",
]

_ALL = propulsion.MAKERS | hull.MAKERS | environment.MAKERS | sensing.MAKERS
# What a catalogue of effects can be expected to list. The order names the streams of random numbers: add at the end.
_ORDER = [
    *("advance-ratio", "reverse-thrust", "mismatch", "wind", "sway-yaw", "turning-resistance", "cubic-drag"),
    *("cg-offset", "compass", "lever-arm", "gnss-latency", "battery-sag", "yaw-bias", "thruster-interaction"),
    *("pendulum", "dead-band", "delay", "lag", "cross-flow", "lift", "hump", "coulomb", "current-drift", "tether"),
    *("waves", "heading-moment", "mount", "gyro-scale", "accelerometer-tilt", "accelerometer-scale"),
]
EFFECTS: dict[str, Maker] = {name: _ALL[name] for name in _ORDER}
OUTSIDE: dict[str, Maker] = outside.MAKERS  # what it cannot be expected to list
NOISE: dict[str, Maker] = disturbed.MAKERS  # noise that is not what was assumed, and nothing else

# What `--effect draw` draws from: each shows in five minutes of a mixed mission and has no near relative in the list.
DEMO = (
    "advance-ratio",
    "mismatch",
    "wind",
    "turning-resistance",
    "cubic-drag",
    "compass",
    "lever-arm",
    "gnss-latency",
    "yaw-bias",
    "pendulum",
)


SMALL = 0.05  # of its full size has every other effect in a mixture
_GROUPS = ((0, EFFECTS), (200, OUTSIDE), (300, NOISE))  # the first stream of each


def make_effect(name: str, seed: int, scale: float = 1.0) -> HiddenEffect:
    """The effect ``name`` (KeyError if there is none) as ``seed`` draws it, ``scale`` times its full size."""
    for first, group in _GROUPS:
        if name in group:
            return group[name](random_stream(seed, EFFECT_SIZE, index=first + list(group).index(name)), scale)
    raise KeyError(name)


def mixture(name: str, seed: int, scale: float = 1.0, small: float = SMALL) -> tuple[HiddenEffect, ...]:
    """The effect ``name`` and, beside it, every other one of EFFECTS at ``small`` times its full size."""
    rest = (make_effect(other, seed, small) for other in EFFECTS if other != name)
    return (make_effect(name, seed, scale), *rest)


def draw_name(seed: int, names: tuple[str, ...] = DEMO) -> str:
    """The name that ``--effect draw`` takes at this seed."""
    return names[int(random_stream(seed, EFFECT_NAME).integers(len(names)))]
