"""Kinds of cases of the recovery study: effects of the boat, missions, and logged signals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from seatrial.ident.data.record import Channel
from seatrial.ident.model.structure import Model
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.mocks.hidden_effects.catalogue import EFFECTS, NOISE, OUTSIDE, SITE, SMALL, make_effect
from seatrial.mocks.hidden_effects.realistic import IMPERFECTIONS, realistic_with
from seatrial.mocks.plant.boat import Boat, draw_boat

NONE = "none"
SECONDS, VALIDATION_SECONDS = 400.0, 250.0  # Durations as in the demo.
# Noise of the simulated sensors by their data sheets, for ten rows per second (seatrial.mocks.sensors).
DECLARED = {"e_psi": np.radians(0.5) / 5**0.5, "e_r": 0.01 / 5**0.5, "e_a": 0.1 / 5**0.5, "e_xy": 0.15, "e_vxy": 0.05}


def all_effects(seed: int) -> list[str]:
    """Return the effects that the catalogue should contain."""
    return list(EFFECTS)


def all_large(seed: int) -> list[str]:
    """Return the effects that are no imperfection of every realistic boat, or that are small in it."""
    large = [
        name for name in EFFECTS if name not in IMPERFECTIONS or name in ("wind", "mismatch", "waves", "dead-band")
    ]
    return [*large, *SITE]


def all_of_site(seed: int) -> list[str]:
    """Return the effects of place, mounting and telemetry."""
    return list(SITE)


def all_pairs(seed: int) -> list[str]:
    """Return pairs of effects. Each effect is used once, and each seed has other pairs."""
    names = np.random.default_rng([seed, 77]).permutation(list(EFFECTS)).tolist()
    return [f"{a}+{b}" for a, b in zip(names[::2], names[1::2], strict=False)]


def all_beside(seed: int) -> list[str]:
    """Return pairs of an effect outside the catalogue and one of the catalogue. Each seed has other pairs."""
    names = np.random.default_rng([seed, 79]).permutation(list(EFFECTS)).tolist()
    return [f"{a}+{b}" for a, b in zip(OUTSIDE, names, strict=False)]


@dataclass(frozen=True)
class Kind:
    """Kind of cases.

    ``truths`` gives the effects for a seed. ``seeds`` is the default number of seeds. ``gain`` is a factor of the
    commands. ``others`` is the size of every other effect. ``noise`` is one of
    seatrial.mocks.hidden_effects.catalogue.NOISE.
    """

    description: str
    truths: Callable[[int], list[str]]
    seeds: int
    scale: float = 1.0
    seconds: tuple[float, float] = (SECONDS, VALIDATION_SECONDS)
    gain: float = 1.0
    gaps: bool = False
    others: float = 0.0
    noise: str = ""
    left_out: bool = False  # The true effect is removed from the catalogue.
    realistic: bool = False  # The boat has the imperfections of seatrial.mocks.hidden_effects.realistic.
    logged: bool = False  # If true, the case uses logs and user commands. Otherwise it uses the Python API in memory.


def _none(seed: int) -> list[str]:
    return [NONE]


def _all_and_none(seed: int) -> list[str]:
    return [NONE, *EFFECTS]


TIMID, SHORT = 0.35, (120.0, 80.0)


KINDS: dict[str, Kind] = {
    "single": Kind("one effect at full size", all_effects, 10, logged=True),
    "site": Kind("one effect of place, mounting or telemetry at full size", all_of_site, 2),
    "half": Kind("one effect at half its size", all_effects, 5, scale=0.5, logged=True),
    "quarter": Kind("one effect at a quarter of its size", all_effects, 3, scale=0.25),
    "mixture": Kind("one effect, and every other one at 5 % of its size", all_effects, 5, others=SMALL, logged=True),
    "pair": Kind("two effects at full size", all_pairs, 4, logged=True),
    "outside": Kind("an effect that the catalogue does not list", lambda seed: list(OUTSIDE), 10, logged=True),
    "beside": Kind("an effect that the catalogue does not list, and one that it does", all_beside, 4, logged=True),
    "clean": Kind("no effect", _none, 120),
    "clean-timid": Kind("no effect, all commands at 35 %", _none, 40, gain=TIMID),
    "clean-short": Kind("no effect, 120 s to estimate, 80 s to validate", _none, 40, seconds=SHORT),
    "timid": Kind("all commands at 35 %", all_effects, 3, gain=TIMID, logged=True),
    "short": Kind("120 s to estimate, 80 s to validate", all_effects, 3, seconds=SHORT, logged=True),
    "dropout": Kind("gaps in every device, and lost samples", _all_and_none, 3, gaps=True),
    **{name: Kind(f"no effect; {make_effect(name, 1).sentence}", _none, 25, noise=name) for name in NOISE},
    "realistic": Kind("a realistic boat, one effect at full size", all_large, 2, realistic=True, logged=True),
    "realistic-double": Kind(
        "a realistic boat, one effect at twice its full size", all_large, 1, scale=2.0, realistic=True, logged=True
    ),
    "realistic-clean": Kind("a realistic boat without a large effect", _none, 20, realistic=True, logged=True),
    "leave-one-out": Kind("one effect at full size, taken out of the catalogue", all_effects, 3, left_out=True),
}


@dataclass(frozen=True)
class Case:
    """Case of the study: an effect (``none``, or two effects as ``a+b``) on the boat of a seed, in one of KINDS."""

    effect: str
    seed: int
    kind: str = "single"

    @property
    def key(self) -> str:
        """Return the key of the case in the results."""
        return f"{self.kind}/{self.effect}/{self.seed}"

    @property
    def how(self) -> Kind:
        return KINDS[self.kind]

    @property
    def truths(self) -> tuple[str, ...]:
        """Return the names of the effects that an analysis should find."""
        return () if self.effect == NONE else tuple(self.effect.split("+"))


def boat_of(case: Case) -> Boat:
    """Return the boat with all its effects, the small effects of a mixture, and misspecified noise."""
    how = case.how
    if how.realistic:
        return draw_boat(case.seed, realistic_with(case.effect, case.seed, how.scale))
    effects = [make_effect(name, case.seed, how.scale) for name in case.truths]
    if how.others:
        effects += [make_effect(name, case.seed, how.others) for name in EFFECTS if name not in case.truths]
    if how.noise:
        effects.append(make_effect(how.noise, case.seed))
    return draw_boat(case.seed, effects)


def model_of(case: Case) -> Model:
    """Return the nominal model. If the true noise differs from the data sheets, the noise of the data sheets is
    fixed.
    """
    model = horizontal_model()
    if case.kind != "noise-small-r":
        return model
    return model.replace_parameters(*(model.parameter(n).at(float(v)).fixed() for n, v in DECLARED.items()))


def with_gaps(channels: dict[str, Channel], seed: int) -> dict[str, Channel]:
    """Return channels with gaps about once a minute: GNSS up to 20 s and AHRS up to 3 s. One sample in twenty is
    lost.
    """
    rng = np.random.default_rng([seed, 78])
    found = dict(channels)
    for names, longest in (
        (("x", "y", "vx", "vy"), 20.0),
        (("psi", "r", "ax", "ay"), 3.0),
        (("n_left",), 0.5),
        (("n_right",), 0.5),
    ):
        t = channels[names[0]].t
        keep = rng.uniform(size=t.size) > 0.05
        for start in np.arange(30.0, t[-1] - longest, 60.0) + rng.uniform(0.0, 20.0):
            keep &= ~((t > start) & (t < start + rng.uniform(0.3, 1.0) * longest))
        for name in names:
            found[name] = Channel(t[keep].copy(), channels[name].value[keep].copy())
    return found
