"""Tests of the weighed mass as evidence on the names of effects."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import pytest

from seatrial.ident.diagnosis.findings import Diagnosis, EffectAttribution, EffectImportance, Refit, Round
from seatrial.ident.diagnosis.weighed_mass import with_weighed_mass
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.model.parameter import ParameterOrigin
from seatrial.ident.models.horizontal import horizontal_model

NAMES = ("thrust-power", "wind")
CERTAIN = tuple(EffectAttribution(name, "identified") for name in NAMES)
UNKNOWN = horizontal_model()  # with the thrust of another boat
MODEL = UNKNOWN.replace_parameters(
    *(replace(UNKNOWN.parameter(name), origin=ParameterOrigin.MEASURED) for name in ("c1", "c2"))
)


@dataclass(frozen=True)
class Fitted:
    """Stand-in for a fit whose mass in surge is ``m_u`` [kg]."""

    m_u: float
    model: Any = MODEL
    names: tuple[str, ...] = ("m_u",)

    def estimate(self, _name: str) -> tuple[float, float]:
        return self.m_u, 0.1 * self.m_u


def diagnosis(before: Any, after: Any) -> Diagnosis:
    """Return a diagnosis that has identified a thrust curve and wind, from its fits without and with them."""

    def fitted(fit: Any) -> Any:
        return cast(Any, type("Fitted", (), {"fit": fit}))

    rounds = []
    for name in NAMES:
        chosen = Refit(catalogue()[name], fitted(after), 100.0, 1, 92.0, 50.0, 5.0)
        rounds.append(Round((), (), (chosen,), chosen))
    importances = tuple(EffectImportance(name, 100.0, 1.5) for name in NAMES)
    return Diagnosis(
        fitted(before), fitted(after), tuple(rounds), (), (), attributions=CERTAIN, importances=importances
    )


@pytest.mark.parametrize(
    ("before", "after", "weighed", "certain"),
    [
        (18.2, 24.2, 11.4, ["wind"]),  # A ventilating propeller that was called an exponent of the thrust curve.
        (13.0, 16.0, 11.4, [*NAMES]),  # plausible with the effects
        (24.2, 18.2, 11.4, [*NAMES]),  # better with the effects
        (24.2, 25.0, 11.4, [*NAMES]),  # The scale of the forces is wrong with and without the effects.
        (12.0, 8.0, 11.4, ["wind"]),  # The mass is below the weighed one.
        (18.2, 24.2, None, [*NAMES]),
    ],
)
def test_effect_that_makes_the_mass_implausible_is_ambiguous(
    before: float, after: float, weighed: float | None, certain: list[str]
) -> None:
    found = with_weighed_mass(diagnosis(Fitted(before), Fitted(after)), weighed)
    assert [a.effect for a in found.attributions if a.attribution == "identified"] == certain
    for a in found.attributions:
        if a.attribution == "ambiguous":
            assert (
                f"mass in surge is {after:g} kg, and the boat weighs 11.4 kg; without them it is {before:g} kg"
                in (a.reasons[-1])
            )


def test_masses_without_a_scale_say_nothing_about_names() -> None:
    """Without a given thrust, masses are known as ratios to it only."""
    for fit in (Fitted(12.0, UNKNOWN), Fitted(12.0, names=("K_u",))):
        assert with_weighed_mass(diagnosis(fit, replace(fit, m_u=90.0)), 11.4).attributions == CERTAIN
