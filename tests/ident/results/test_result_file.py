"""Tests of results as JSON: seven digits, null for values that are not finite, and a complete round trip."""

from __future__ import annotations

import json
import math
import sys
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pandas
import pytest

from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.ident.data.loading import FrameOrigin
from seatrial.ident.results.parts import InputTrace, LogSummary, ParameterRow
from seatrial.ident.results.result_file import from_json, read_result, to_json, write_result
from tests.ident import report_example, report_example_bench
from tests.ident.pages import shortened

EXAMPLES = {"diagnosis": report_example.diagnosis, "thruster": report_example_bench.thruster}


@cache
def example(kind: str) -> bytes:
    """Return the JSON of an example with all its curves."""
    return json.dumps(EXAMPLES[kind]()).encode()


def written(value: Any) -> Any:
    """Return an array as in the JSON of a result."""
    row = InputTrace(record="", name="", unit="", t=np.zeros_like(value), value=value)
    return json.loads(to_json(row))["value"]


def test_array_is_written_like_its_single_numbers() -> None:
    rng = np.random.default_rng(0)
    value = rng.normal(size=(40, 25)) * 10.0 ** rng.integers(-30, 30, (40, 25))
    value[0, :4] = [0.0, -0.0, np.nan, np.inf]
    value[1] = np.round(value[1] * 1e-3) * 1e3
    assert written(value) == [[float(f"{v:.7g}") if np.isfinite(v) else None for v in row] for row in value]
    row = InputTrace(record="", name="", unit="", t=np.zeros(1000), value=rng.uniform(0.1, 1.0, 1000))
    numbers = to_json(row).decode().partition('"value":[')[2].rstrip("]}").split(",")
    assert max(map(len, numbers)) == len("0.1234567")


def test_number_is_written_with_seven_digits_or_null() -> None:
    row = ParameterRow(name="m", meaning="", unit="kg", value=np.float64(1 / 3), se=float("nan"), free=True)
    assert json.loads(to_json(row))["value"] == 0.3333333
    assert json.loads(to_json(row))["se"] is None


def test_origin_is_written_to_the_millimetre() -> None:
    origin = FrameOrigin(latitude=37.812345678, longitude=-122.478255123, log="run")
    log = LogSummary(path="", sha256="", role="estimation", name="run", duration=1.0, origin=origin)
    assert json.loads(to_json(log))["origin"] == {"latitude": 37.812345678, "longitude": -122.478255123, "log": "run"}


@pytest.mark.parametrize("kind", EXAMPLES)
def test_result_is_read_as_written(kind: str, tmp_path: Path) -> None:
    result = from_json(example(kind))
    write_result(result, tmp_path / "result.json")
    again = read_result(tmp_path / "result.json")
    assert type(again) is type(result)
    assert_same(json.loads(to_json(again)), json.loads(to_json(result)))
    assert next(iter(json.loads(to_json(result)))) == "kind"


def assert_same(actual: Any, expected: Any) -> None:
    """Assert that two contents of JSON are equal, but for one unit of the seventh digit of a number."""
    if isinstance(actual, float) or isinstance(expected, float):
        assert math.isclose(actual, expected, rel_tol=1.1e-6, abs_tol=1e-37)
    elif isinstance(actual, dict):
        assert actual.keys() == expected.keys()
        for key in actual:
            assert_same(actual[key], expected[key])
    elif isinstance(actual, list):
        assert len(actual) == len(expected)
        for a, b in zip(actual, expected, strict=True):
            assert_same(a, b)
    else:
        assert actual == expected


def diagnosed(folder: Path) -> Path:
    """Write the files of a diagnosis to a folder, and return the result.json."""
    path = folder / "result.json"
    write_result(from_json(example("diagnosis")), path)
    return path


def test_curves_are_in_a_table_of_named_rows_and_not_in_the_json(tmp_path: Path) -> None:
    path = diagnosed(tmp_path)
    content = json.loads(path.read_text())
    whole = json.loads(example("diagnosis"))
    assert content["traces"][0]["measured"] == {"parquet": len(whole["traces"][0]["measured"])}
    assert path.stat().st_size < 0.1 * len(example("diagnosis"))
    table = pandas.read_parquet(tmp_path / content["curves_file"]["file"])
    for row in whole["traces"]:
        mine = table[(table.table == "traces") & (table.record == row["record"]) & (table.name == row["channel"])]
        over_time = mine[mine.axis == "t"]
        assert over_time["at"].to_list() == pytest.approx(row["t"])
        expected = np.array(row["measured"], dtype=float)
        np.testing.assert_allclose(over_time["measured"].to_numpy(), expected, rtol=2e-7)
    assert set(table[table.table == "residuals.after"].axis) == {"t", "frequency"}


def test_without_pyarrow_the_json_has_the_curves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    path = diagnosed(tmp_path)
    assert not (tmp_path / "result.parquet").exists()
    whole, found = json.loads(example("diagnosis")), read_result(path)
    assert found.traces[0].measured == pytest.approx(whole["traces"][0]["measured"], nan_ok=True)  # type: ignore[union-attr]


def test_curves_of_format_2_are_read_from_the_json(tmp_path: Path) -> None:
    content = json.loads(example("diagnosis")) | {"format": "seatrial-result 2"}
    (tmp_path / "result.json").write_text(json.dumps(content), encoding="utf-8")
    found = read_result(tmp_path / "result.json")
    assert found.format == "seatrial-result 3"
    assert found.traces[0].measured.size == len(content["traces"][0]["measured"])  # type: ignore[union-attr]


def test_result_without_its_curves_keeps_the_estimates_and_warns(tmp_path: Path) -> None:
    path = diagnosed(tmp_path)
    (tmp_path / "result.parquet").unlink()
    with pytest.warns(SeatrialWarning, match=r"result\.parquet: is missing, so the result has no curves"):
        found = read_result(path)
    assert found.fit.parameters  # type: ignore[union-attr]
    assert found.traces[0].measured.size == 0  # type: ignore[union-attr]


def test_curves_of_another_result_are_refused(tmp_path: Path) -> None:
    path = diagnosed(tmp_path)
    (tmp_path / "result.parquet").write_bytes(b"other")
    with pytest.raises(SeatrialError, match=r"result\.parquet: is not the file that was written with the result"):
        read_result(path)


def test_result_names_no_file_outside_its_folder(tmp_path: Path) -> None:
    path = diagnosed(tmp_path)
    content = json.loads(path.read_text())
    content["curves_file"]["file"] = "../elsewhere/result.parquet"
    path.write_text(json.dumps(content), encoding="utf-8")
    assert read_result(path).traces[0].measured.size  # type: ignore[union-attr]


@pytest.mark.parametrize("kind", EXAMPLES)
def test_a_result_without_traces_keeps_all_but_its_curves(kind: str) -> None:
    result = from_json(example(kind))
    whole, short = json.loads(to_json(result)), json.loads(to_json(result, traces=False))
    assert list(short) == list(whole)
    for key in ("answer", "warnings", "logs"):
        assert short[key] == whole[key]
    # The correlation matrix stays: it is a table of the estimates, not a curve.
    assert short["fit"] == whole["fit"]
    for before, after in zip(whole["traces"], short["traces"], strict=True):
        assert after == {k: v for k, v in before.items() if not isinstance(v, list)}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"anwser": "Done."}, "unknown field `anwser`"),
        ({"answer": 3}, "Expected `str`, got `int` - at `$.answer`"),
        ({"format": "seatrial-result 1"}, "Invalid enum value"),
        ({"kind": "thurster"}, "Invalid value 'thurster' - at `$.kind`"),
    ],
)
def test_invalid_content_is_named(change: dict[str, Any], words: str, tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text(json.dumps(shortened(report_example_bench.thruster()) | change), encoding="utf-8")
    with pytest.raises(SeatrialError) as caught:
        read_result(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert words in str(caught.value)


def test_curves_of_one_figure_must_have_one_length() -> None:
    result = shortened(report_example_bench.thruster())
    result["traces"][0]["t"].pop()
    with pytest.raises(msgspec.ValidationError, match=r"must be of one length.*traces"):
        from_json(json.dumps(result).encode())


def test_missing_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(SeatrialError, match="No such file"):
        read_result(tmp_path / "no.json")
