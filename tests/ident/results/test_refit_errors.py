"""Tests of notes on the refits of a diagnosis: their standard errors, and an alternative that explains less."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from seatrial.ident.effects.registry import catalogue
from seatrial.ident.results.diagnosis import alternative_notes, refit_error_notes
from seatrial.ident.results.parts import EffectParameter


def parameter(name: str, se: float | None) -> EffectParameter:
    return EffectParameter(name=name, meaning="", unit="N", value=-11.3, se=se)


@pytest.mark.parametrize(
    ("chosen", "late", "noted"),
    [("wind", 7.68, True), (None, 7.68, False), ("wind", 2.7, False), ("wind", None, False)],
)
def test_a_larger_error_in_the_answer_is_explained(chosen: str | None, late: float | None, noted: bool) -> None:
    early = (parameter("F_wx", 2.653), parameter("F_wy", 2.2))
    refits = [SimpleNamespace(name="wind", parameters=early), SimpleNamespace(name="other", parameters=early)]
    rounds: Any = [SimpleNamespace(chosen=chosen, refits=refits)]
    effects: Any = [SimpleNamespace(name="wind", parameters=(parameter("F_wx", late), parameter("F_wy", 2.2)))]
    notes = refit_error_notes(rounds, effects)
    assert len(notes) == noted
    if noted:
        assert "of F_wx 2.7 in the refit and 7.7 N in the answer. Use those of the answer." in notes[0]


@pytest.mark.parametrize(
    ("effect", "rival", "criterion", "not_excluded", "noted"),
    [
        ("mismatch", "yaw-bias", 98.5, (), True),
        ("yaw-bias", "mismatch", 22.1, (), True),
        ("mismatch", "yaw-bias", -3.0, (), False),  # it explains nothing
        ("mismatch", "yaw-bias", 151.0, ("yaw-bias",), False),  # the answer names it
        ("mismatch", "propeller-walk", 100.0, (), False),  # not declared as an alternative
    ],
)
def test_an_alternative_that_explains_less_is_named(
    effect: str, rival: str, criterion: float, not_excluded: tuple[str, ...], noted: bool
) -> None:
    refits = [
        SimpleNamespace(name=effect, title="the one", criterion=152.4),
        SimpleNamespace(name=rival, title="the other", criterion=criterion),
    ]
    rounds: Any = [SimpleNamespace(chosen=effect, refits=refits), SimpleNamespace(chosen=None, refits=refits)]
    found = SimpleNamespace(name=effect, title="the one", not_excluded=not_excluded)
    notes = alternative_notes(rounds, [found])  # type: ignore[list-item]
    expected = (
        f"In place of the one, the search also fitted the other ('{rival}'): its ΔBIC on the estimation data "
        f"is {152.4 - criterion:.0f} worse."
    )
    assert notes == ([expected] if noted else [])
    both: Any = [found, SimpleNamespace(name=rival, title="the other", not_excluded=())]
    assert alternative_notes(rounds, both) == []  # the model has both


def test_mismatch_and_yaw_bias_are_alternatives_of_each_other() -> None:
    assert "yaw-bias" in catalogue()["mismatch"].alternatives
    assert "mismatch" in catalogue()["yaw-bias"].alternatives
