"""Tests of the sentence of a bench diagnosis on whether the thrust curve can be used."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from seatrial.ident.results.diagnosis import _measured_ranges, _usable_thrust_sentence
from seatrial.ident.results.parts import ErrorComparison, Errors, ErrorTable

RANGES = {"force": 50.0, "n": 2.0}


def errors(force: float | None, n: float | None) -> Errors:
    """Return errors of a bench model on validation data, the same over the horizon and in simulation."""
    known = {"force": (force, "N"), "n": (n, "")}
    rows = {name: ErrorComparison(after=e, unit=unit) for name, (e, unit) in known.items()}
    return Errors(estimation=ErrorTable(one_step={}, horizon={}, simulation={}),
                  validation=ErrorTable(one_step={}, horizon=rows, simulation=rows))  # fmt: skip


def test_small_errors_say_that_the_thrust_curve_can_be_used() -> None:
    """A p value of 2e-22 alarmed a user whose model predicted the force within the noise of the load cell."""
    said = _usable_thrust_sentence(errors(0.5, 0.0003), RANGES, doubted=True)
    assert said == (
        "The model predicts the force within 0.50 N (rms, 1 % of its range) and the shaft speed within 0.00030 (rms, "
        "0.015 % of its range) from the command alone: the thrust curve can be used. What the score tests find is "
        "within these small errors."
    )
    assert _usable_thrust_sentence(errors(0.5, 0.0003), RANGES, doubted=False) == said.partition(" What the")[0]


@pytest.mark.parametrize(("force", "n"), [(2.6, 0.0003), (0.5, 0.11), (None, 0.0003), (0.5, None)])
def test_nothing_is_said_of_large_or_unknown_errors(force: float | None, n: float | None) -> None:
    assert _usable_thrust_sentence(errors(force, n), RANGES, doubted=True) == ""
    assert _usable_thrust_sentence(errors(0.5, 0.0003), {"n": 2.0}, doubted=True) == ""


def test_the_range_is_that_of_the_measured_samples_without_outliers() -> None:
    y = np.column_stack([np.linspace(-20.0, 30.0, 1001), np.full(1001, np.nan)])
    y[500, 0] = 900.0
    outputs = [SimpleNamespace(name="force"), SimpleNamespace(name="n")]
    records = [SimpleNamespace(record=SimpleNamespace(y=part)) for part in (y[:400], y[400:])]
    evaluation: Any = SimpleNamespace(
        headline_set="validation", sets={"validation": SimpleNamespace(records=records)},
        model=SimpleNamespace(outputs=outputs),
    )  # fmt: skip
    assert _measured_ranges(evaluation) == {"force": pytest.approx(49.0, abs=0.1)}


def test_thrust_curve_of_a_model_with_added_effects_can_be_used_too() -> None:
    """A diagnosis that added the filter of the load cell did not say it, although the errors were below 1 %."""
    said = _usable_thrust_sentence(errors(0.5, 0.0003), RANGES, doubted=False, with_effects=True)
    assert said.startswith("The model with the added effects predicts the force within ")
    assert said.endswith("from the command alone: its thrust curve can be used.")
