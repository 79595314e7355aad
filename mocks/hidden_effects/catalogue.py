"""Catalogue of the hidden effects of the mock boat, which the nominal model lacks.

The equations of the effects belong to the plant alone. An analysis may try other equations for the same effect.
The size of an effect is drawn within 15 % of the full size in its definition. Effects that can act in two directions
get a random sign.
"""

from __future__ import annotations

from seatrial.mocks.hidden_effects import disturbed, environment, equipment, hull, outside, propulsion, sensing, site
from seatrial.mocks.plant import ENERGY_UNIT, HiddenEffect, Maker
from seatrial.mocks.random_streams import EFFECT_NAME, EFFECT_SIZE, random_stream

__all__ = [
    "DEMO",
    "EFFECTS",
    "ENERGY_UNIT",
    "EQUIPMENT",
    "NOISE",
    "OUTSIDE",
    "SITE",
    "SMALL",
    "HiddenEffect",
    "draw_name",
    "make_effect",
    "mixture",
]

_ALL = propulsion.MAKERS | hull.MAKERS | environment.MAKERS | sensing.MAKERS
# Effects that an analysis can be expected to list. The position in this list selects the stream of random numbers:
# add new effects at the end, or all existing boats change.
_ORDER = [
    *("advance-ratio", "reverse-thrust", "mismatch", "wind", "sway-yaw", "turning-resistance", "cubic-drag"),
    *("cg-offset", "compass", "lever-arm", "gnss-latency", "battery-sag", "yaw-bias", "thruster-interaction"),
    *("pendulum", "dead-band", "delay", "lag", "cross-flow", "lift", "hump", "coulomb", "current-drift", "tether"),
    *("waves", "heading-moment", "mount", "gyro-scale", "accelerometer-tilt", "accelerometer-scale"),
]
EFFECTS: dict[str, Maker] = {name: _ALL[name] for name in _ORDER}
OUTSIDE: dict[str, Maker] = outside.MAKERS  # effects that no analysis can be expected to list
NOISE: dict[str, Maker] = disturbed.MAKERS  # noise that differs from the assumed noise, on a boat without an effect
# Effects of place, mounting and telemetry, which an analysis can be expected to list as well.
_SITE_ORDER = [
    *("thrust-angle", "propeller-walk", "current-shear", "bank", "shallow-water", "payload-shift", "shaft-clip"),
    *("towed-line", "leak", "growing-drag", "fouling", "reverse-mismatch", "lag-mismatch", "derating", "wash"),
    "load-sag",
]
SITE: dict[str, Maker] = {name: (site.MAKERS | _ALL)[name] for name in _SITE_ORDER}
EQUIPMENT: dict[str, Maker] = equipment.MAKERS  # late and rounded signals, for the realistic boat

# Effects that `--effect draw` chooses from. Each can be detected in a mixed mission of five minutes, and no two of
# them are hard to distinguish.
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


SMALL = 0.05  # fraction of the full size that the minor effects of a mixture have
# Each table with the index of its first stream of random numbers.
_TABLES = ((0, EFFECTS), (200, OUTSIDE), (300, NOISE), (400, EQUIPMENT), (600, SITE))


def make_effect(name: str, seed: int, scale: float = 1.0) -> HiddenEffect:
    """Return a hidden effect of the mock boat with a size that is drawn at random.

    Parameters
    ----------
    name : str
        Name of the effect, such as "wind": a key of EFFECTS, OUTSIDE, NOISE, EQUIPMENT or SITE.
    seed : int
        Seed of the size, the sign and the direction of the effect. The same seed gives the same effect.
    scale : float
        Factor on the full size.

    Raises
    ------
    KeyError
        If no effect has this name.
    """
    for first, table in _TABLES:
        if name in table:
            return table[name](random_stream(seed, EFFECT_SIZE, index=first + list(table).index(name)), scale)
    raise KeyError(name)


def mixture(name: str, seed: int, scale: float = 1.0, small: float = SMALL) -> tuple[HiddenEffect, ...]:
    """Return one large hidden effect of the mock boat together with all other effects of EFFECTS at a small size.

    Parameters
    ----------
    name : str
        Name of the large effect: a key of EFFECTS, OUTSIDE, NOISE, EQUIPMENT or SITE.
    seed : int
        Seed of the sizes, signs and directions of all effects.
    scale : float
        Factor on the full size of the effect ``name``.
    small : float
        Factor on the full size of each other effect.

    Returns
    -------
    tuple of HiddenEffect
        The large effect first, then the others in the order of EFFECTS.

    Raises
    ------
    KeyError
        If no effect has this name.
    """
    minor_effects = (make_effect(minor, seed, small) for minor in EFFECTS if minor != name)
    return (make_effect(name, seed, scale), *minor_effects)


def draw_name(seed: int, names: tuple[str, ...] = DEMO) -> str:
    """Return the name of a hidden effect, drawn at random from ``names`` with the seed of a mock boat.

    The same seed gives the same name. With the default names it is the effect that ``--effect draw`` chooses.
    """
    return names[int(random_stream(seed, EFFECT_NAME).integers(len(names)))]
