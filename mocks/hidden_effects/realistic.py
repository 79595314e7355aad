"""Realistic boat: many small imperfections that every real boat has, with or without one large hidden effect.

An analysis of such a boat should find the large effect and should not take a small one for it.
"""

from __future__ import annotations

from dataclasses import replace

from seatrial.mocks.hidden_effects.catalogue import make_effect
from seatrial.mocks.plant import HiddenEffect
from seatrial.mocks.random_streams import EFFECT_SIZE, random_stream

_STREAM = 500  # index of the stream of random numbers for the fractions; beyond those of the catalogue
# Limits between which the fraction of the full size of each effect is drawn. The order selects the random numbers: add
# new effects at the end, or all existing realistic boats change.
_FRACTIONS = {
    "cross-flow": (0.2, 0.4),
    "lift": (0.2, 0.4),
    "sway-yaw": (0.2, 0.4),
    "wind": (0.2, 0.4),
    "noise-gusts": (0.2, 0.4),
    "waves": (0.2, 0.4),
    "mismatch": (0.1, 0.2),
    "dead-band": (0.2, 0.4),
    "lever-arm": (0.115, 0.165),  # 0.05 to 0.10 m
    "compass": (0.2, 0.4),
    "gyro-scale": (0.09, 0.11),  # 0.3 %
    "gnss-latency": (0.34, 0.49),  # 0.10 to 0.20 s
    "heading-lag": (1.0, 1.0),
    "telemetry-age": (1.0, 1.0),
    "velocity-resolution": (1.0, 1.0),
    "shaft-braking": (1.0, 1.0),
}
IMPERFECTIONS = tuple(_FRACTIONS)  # names of the small effects of a realistic boat


def realistic(seed: int) -> tuple[HiddenEffect, ...]:
    """Return the small hidden effects (imperfections) of the realistic mock boat of a seed.

    Parameters
    ----------
    seed : int
        Seed of the sizes, signs and directions. The same seed gives the same imperfections.

    Returns
    -------
    tuple of HiddenEffect
        One effect for each name in IMPERFECTIONS, in this order. Their attribute ``minor`` is true.

    Notes
    -----
    Forms of the hull, wind, gusts, waves, dead band and compass have 20 to 40 % of their full size, and the mismatch of
    the thrusters 10 to 20 %. The GNSS antenna is 0.05 to 0.10 m from its place, the fixes are 0.10 to 0.20 s old, and
    the scale of the gyro is wrong by about 0.3 %. The module ``equipment`` gives the sizes of the others.
    """
    limits = list(_FRACTIONS.values())
    drawn = random_stream(seed, EFFECT_SIZE, index=_STREAM).uniform(size=len(limits))
    fractions = [low + (high - low) * share for (low, high), share in zip(limits, drawn.tolist(), strict=True)]
    return tuple(
        replace(make_effect(name, seed, fraction), minor=True)
        for name, fraction in zip(IMPERFECTIONS, fractions, strict=True)
    )


def realistic_with(name: str, seed: int, scale: float = 1.0) -> tuple[HiddenEffect, ...]:
    """Return one large hidden effect, and the small ones (imperfections) of the realistic mock boat of a seed.

    Parameters
    ----------
    name : str
        Name of the large effect, as in `make_effect` of the catalogue; "none" for a boat without a large effect.
    seed : int
        Seed of the sizes, signs and directions of all effects.
    scale : float
        Factor on the full size of the large effect. The imperfections do not depend on it.

    Returns
    -------
    tuple of HiddenEffect
        The large effect first (not for "none"), then the imperfections in the order of IMPERFECTIONS. The
        imperfection with the name of the large effect is left out.

    Raises
    ------
    KeyError
        If no effect has this name.
    """
    if name == "none":
        return realistic(seed)
    return (make_effect(name, seed, scale), *(effect for effect in realistic(seed) if effect.name != name))
