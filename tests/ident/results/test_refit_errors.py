"""Test of the note that standard errors of an effect differ between a refit and the answer, with both numbers."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from seatrial.ident.results.diagnosis import refit_error_notes
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
