"""Tests that a result is filled from computed values: building and writing it runs no filter, simulation or fit."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NoReturn

import pytest

from seatrial.ident.data.record import LogSegment
from seatrial.ident.diagnosis.search import diagnose, evaluate_diagnosis
from seatrial.ident.engine.vectorised_model import VectorisedModel
from seatrial.ident.estimation.fitted_model import fit_nominal_model
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.model.outlier_density import with_outlier_model
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.report.page import write_report
from seatrial.ident.results.commands import FitContext, vehicle_result
from seatrial.ident.results.diagnosis import GivenModel, diagnosis_result
from seatrial.ident.results.parts import Provenance
from seatrial.ident.results.result_file import read_result, to_json, write_result
from seatrial.ident.validation.evaluation import evaluate
from seatrial.ident.workflows.output import validity
from tests.missions import boat_with, channels_of, sail

pytestmark = pytest.mark.usefixtures("quick_compilation")

MADE = Provenance(created="2025-05-06T07:08:09+00:00", seatrial="0.1.0", command="seatrial ident")
METHODS = ("__init__", "value", "gradient", "scores", "value_by_row", "filter", "forecast")


@pytest.fixture(scope="module")
def segments() -> list[LogSegment]:
    return [LogSegment(n, channels_of(sail(boat_with(None, 2), 120.0, k, run=k)[0])) for k, n in enumerate("ab", 1)]


def no_more_computing(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> NoReturn:
        raise AssertionError("computed while a result was built")

    for name in METHODS:
        monkeypatch.setattr(Likelihood, name, refuse)
    monkeypatch.setattr(VectorisedModel, "__init__", refuse)
    for place in ("fitted_model.smoothed_states", "output_error.simulate"):
        place = f"seatrial.ident.estimation.{place}"
        monkeypatch.setattr(place, refuse)


def test_vehicle_result_needs_no_computation(
    segments: list[LogSegment], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = with_outlier_model(horizontal_model())
    fitted = fit_nominal_model(model, segments[:1], segments[1:])
    evaluation = evaluate(fitted)
    no_more_computing(monkeypatch)
    result = vehicle_result(fitted, evaluation, MADE, [], [], FitContext(model.values, fitted.outlier_notes))
    write_result(result, tmp_path / "result.json")
    write_report(result, tmp_path / "report.html")
    assert to_json(read_result(tmp_path / "result.json").fit) == to_json(result.fit)  # type: ignore[union-attr]
    assert "u" in validity(fitted)
    with pytest.raises(AssertionError, match="computed while"):
        evaluate(fitted)


def test_diagnosis_result_needs_no_computation(
    segments: list[LogSegment], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = diagnose(horizontal_model(), segments[:1], segments[1:], max_effects=1)
    evaluation = evaluate_diagnosis(found)
    no_more_computing(monkeypatch)
    notes = found.after.outlier_notes
    result = diagnosis_result(found, evaluation, MADE, warnings=(), notes=notes, given=GivenModel("model.toml"))
    write_result(result, tmp_path / "result.json")
    write_report(result, tmp_path / "report.html")
    assert to_json(read_result(tmp_path / "result.json").fit) == to_json(result.fit)  # type: ignore[union-attr]
