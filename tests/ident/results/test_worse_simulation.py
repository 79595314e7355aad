"""Tests of the sentence on a simulation that is worse with the effects of a diagnosis than without."""

from __future__ import annotations

import pytest

from seatrial.ident.report.sections.predictions import horizons, unmarked_rises
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


def test_a_channel_that_rises_without_a_mark_is_named_below_the_table() -> None:
    rises = ErrorComparison(before=9.39, after=13.6, unit="m", spread=1.0)
    shown = ErrorComparison(before=1.0, after=2.0, unit="m/s", spread=1.0, verdict="rose")
    small = ErrorComparison(before=1.0, after=1.1, unit="m", spread=1.0)
    errors = ErrorTable(one_step={}, horizon={"u": shown}, simulation={"x": rises, "y": small})
    assert unmarked_rises(horizons(errors, 10.0)) == (
        "Larger after than before, but without a mark, because no interval shows whether it is chance: simulation, "
        "position north x (9.39 → 13.6 m)."
    )
    assert unmarked_rises(horizons(table(y=1.1), 10.0)) == ""
