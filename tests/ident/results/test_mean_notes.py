"""Test of the note on rows that are means of faster sensors."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from seatrial.ident.results.commands import mean_notes


@pytest.mark.parametrize(("rates", "said"), [({"imu": 10.0, "gnss": 10.0}, True), ({}, False)])
def test_a_fit_says_that_rows_are_means_of_faster_sensors(rates: dict[str, float], said: bool) -> None:
    fitted: Any = SimpleNamespace(estimation=[SimpleNamespace(record=SimpleNamespace(meta={"mean_rates": rates}))] * 2)
    notes = mean_notes(fitted)
    assert bool(notes) is said
    assert not said or notes[0].startswith("The rows are means at 10 Hz of the faster sensors (imu, gnss): their")
