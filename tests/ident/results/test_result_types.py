"""Tests of the result types: a complete round trip, and errors for misspelt, missing or mistyped keys."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from seatrial.daq.errors import SeatrialError
from seatrial.ident.results.parts import Result
from seatrial.ident.results.result_file import from_json, read_result, to_json
from tests.ident import navigation_example, page_examples, report_example_bench

EXAMPLES: dict[str, Callable[[], Result]] = {
    "noise": report_example_bench.noise,
    "navigation": navigation_example.navigation,
    "design": page_examples.design,
    "study": page_examples.study,
}


@pytest.mark.parametrize("kind", EXAMPLES)
def test_a_printed_result_is_its_answer(kind: str) -> None:
    result = EXAMPLES[kind]()
    assert repr(result) == f"<{type(result).__name__}: {result.answer}>"


@pytest.mark.parametrize("kind", EXAMPLES)
def test_result_is_read_as_written(kind: str) -> None:
    written = to_json(EXAMPLES[kind]())
    assert json.loads(written)["kind"] == kind
    found = from_json(written)
    assert type(found) is type(EXAMPLES[kind]())
    assert to_json(found) == written


@pytest.mark.parametrize(
    ("change", "path"),
    [
        (lambda row: row.pop("white"), "white"),
        (lambda row: row.update(walk=row.pop("random_walk")), "walk"),
        (lambda row: row.update(more=1), "more"),
        (lambda row: row.update(accepted="yes"), "accepted"),
        (lambda row: row.update(psd=3.0), "psd"),
    ],
)
def test_invalid_key_is_an_error_with_its_path(
    tmp_path: Path, change: Callable[[dict[str, Any]], None], path: str
) -> None:
    content = json.loads(to_json(report_example_bench.noise()))
    change(content["noise"][1])
    (tmp_path / "result.json").write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(SeatrialError, match=path) as error:
        read_result(tmp_path / "result.json")
    assert "noise" in str(error.value)


def test_result_cannot_be_changed() -> None:
    result = report_example_bench.noise()
    with pytest.raises(AttributeError):
        result.answer = "another"  # type: ignore[misc]


def test_value_that_is_not_finite_is_null_and_seven_digits_are_kept() -> None:
    whole = report_example_bench.noise()
    psd = np.array([np.nan, np.inf, 1.0 / 3.0])
    row = msgspec.structs.replace(whole.noise[0], psd=psd, white=2.0 / 3.0)
    found = json.loads(to_json(msgspec.structs.replace(whole, noise=(row,))))["noise"][0]
    assert found["psd"] == [None, None, 0.3333333]
    assert found["white"] == 0.6666667
