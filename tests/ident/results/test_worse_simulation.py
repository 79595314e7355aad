"""Tests of the sentence on a simulation that is worse with the effects of a diagnosis than without."""

from __future__ import annotations

import pytest

from seatrial.ident.results.diagnosis import _worse_simulation_sentence
from seatrial.ident.results.parts import ErrorComparison, Errors, ErrorTable


def table(**after: float | None) -> ErrorTable:
    """Return errors of a simulation that are 1 without the effects."""
    rows = {n: ErrorComparison(before=1.0, after=e, unit="", spread=1.0) for n, e in after.items()}
    return ErrorTable(one_step={}, horizon={}, simulation=rows)


@pytest.mark.parametrize("after", [{}, {"x": 1.1, "psi": 1.2}, {"x": 0.5, "psi": 2.0}, {"x": None}])
def test_nothing_is_said_of_a_simulation_that_is_not_worse(after: dict[str, float | None]) -> None:
    assert _worse_simulation_sentence(Errors(estimation=table(x=3.0), validation=table(**after))) == ""


def test_worse_simulation_is_said_with_its_worst_channel() -> None:
    found = _worse_simulation_sentence(Errors(estimation=table(), validation=table(x=1.5, psi=2.4)))
    assert found == (
        "But the simulation of the validation data by the inputs alone is worse with them: its error grows by 90 % "
        "(mean of all channels), most in heading, by 140 %."
    )
    assert "estimation data" in _worse_simulation_sentence(Errors(estimation=table(x=1.5)))
