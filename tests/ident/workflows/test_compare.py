"""Tests of the comparison of models: log score on common samples, information criteria only where they hold."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any, cast

import msgspec
import numpy as np
import pytest

from seatrial.ident.data.loading import LoadedLog
from seatrial.ident.data.record import LogSegment
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.model_file import SavedModel
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.workflows.compare import (
    ComparedModel,
    InformationCriteria,
    LogScore,
    ModelComparison,
    _is_nested,
    _log_score,
    _n_estimates,
    _why_not_comparable,
    comparison_table,
)

SCORE = LogScore(10.0, 5.0, 15.0, 8)


def evaluation(t: np.ndarray, ll: np.ndarray, outputs: tuple[str, ...] = ("r",), every: int = 1) -> Any:
    """Return a stand-in for the evaluation of a model on a record, with a sample in each `every`-th row."""
    y = np.full((t.size, len(outputs)), np.nan)
    y[::every] = 0.0
    record = type("Record", (), {"t": t, "y": y, "outputs": outputs})()
    return cast(Any, type("Evaluation", (), {"record": record, "ll": ll, "model": type("M", (), {"block": 5.0})()})())


def test_log_score_counts_only_the_time_that_both_records_cover() -> None:
    t = 0.1 * np.arange(1000)
    before = evaluation(t[:900], np.zeros(900))
    after = evaluation(t[100:], np.ones(900) * 0.5 + 1e6 * (t[100:] > 89.95))
    found = _log_score([before], [after])
    assert found is not None
    assert found.gain == pytest.approx(0.5 * 800)
    assert found.blocks == 7
    assert found.low < found.gain < found.high or found.verdict == "better"


@pytest.mark.parametrize(("outputs", "every"), [(("r", "psi"), 1), (("r",), 2)])
def test_models_with_other_samples_have_no_log_score(outputs: tuple[str, ...], every: int) -> None:
    t = 0.1 * np.arange(1000)
    assert _log_score([evaluation(t, 0 * t)], [evaluation(t, 0 * t, outputs, every)]) is None


def test_short_logs_have_a_gain_without_an_interval() -> None:
    t = 0.1 * np.arange(300)
    found = _log_score([evaluation(t, 0 * t)], [evaluation(t, 0 * t + 1.0)])
    assert found is not None
    assert (found.gain, found.blocks) == (pytest.approx(300.0), 2)
    assert np.isnan(found.low)
    assert found.verdict == "unchanged"


def log(sha256: str | None) -> LoadedLog:
    return LoadedLog(LogSegment("run1", {}), {"path": "run1.mcap", "sha256": sha256}, {}, None)


@pytest.mark.parametrize(
    ("change", "sha256", "score", "reason"),
    [
        ({}, "ab" * 32, SCORE, ""),
        ({}, "ab" * 32, None, "do not predict the same samples"),
        ({}, None, SCORE, "only a part of a log is used"),
        (
            {"provenance": {"logs": ["a.mcap sha256:abab", "b.mcap sha256:cdcd"]}},
            "ab" * 32,
            SCORE,
            "exactly these logs",
        ),
        ({"reml": True}, "ab" * 32, SCORE, "fit with --no-reml"),
        ({"second": True}, "ab" * 32, SCORE, "fit with --no-second-order"),
    ],
)
def test_reason_for_no_information_criteria(
    change: dict[str, Any], sha256: str | None, score: LogScore | None, reason: str
) -> None:
    model = horizontal_model("shaft")
    saved = SavedModel(model, {}, {}, provenance={"logs": ["run1.mcap sha256:abababababababab"]})
    first = ComparedModel("a", saved, {}, ("run1",))
    changed = replace(saved, model=replace(model, second_order=change.get("second", False)))
    changed = replace(changed, **{n: v for n, v in change.items() if n != "second"})
    found = _why_not_comparable(first, replace(first, saved=changed), [log(sha256)], score)
    assert reason in found
    assert bool(found) is bool(reason)


def test_comparison_as_a_table_for_json() -> None:
    saved = SavedModel(horizontal_model("shaft"), {}, {})
    first = ComparedModel("a", saved, {"psi": 0.1, "x": float("nan")}, ("run1",))
    criteria = InformationCriteria(3.0, 1, -4.0, -1.0, 0.02)
    second = replace(first, name="b", fitted_to_logs=(), score=SCORE, criteria=criteria)
    table = comparison_table(ModelComparison(10.0, {"psi": "rad", "x": "m"}, (first, second)))
    a, b = json.loads(msgspec.json.encode(table))["models"]
    assert (a["model"], a["rms"], a["fitted_to_logs"], a["score"]) == ("a", {"psi": 0.1, "x": None}, ["run1"], None)
    assert b["score"] == {"gain": 10.0, "low": 5.0, "high": 15.0, "blocks": 8, "verdict": "better"}
    assert b["criteria"]["p"] == 0.02
    assert b["n_free"] == first.n_free


def test_nested_models() -> None:
    small = horizontal_model("shaft")
    large = small + catalogue()["mismatch"]
    assert _is_nested(small, large)
    assert not _is_nested(large, small)
    assert not _is_nested(small, horizontal_model("command"))
    # The same structure with another arm is another model.
    arm: Parameter = large.parameter("y_left")
    assert not arm.free
    assert not _is_nested(small, large.replace_parameters(replace(arm, value=2 * arm.value)))
    assert _is_nested(small.with_free([n for n in small.free if n != "c2"]), small)
    assert _n_estimates(large, 1) == _n_estimates(small, 1) + 1
    own = sum(p.per_record and p.free for p in small.parameters)
    assert own > 0
    assert _n_estimates(small, 3) == _n_estimates(small, 1) + 2 * own
