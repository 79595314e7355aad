"""Tests of the answer of a fit with one wind for logs of different times, and of the start times of logs."""

from __future__ import annotations

import warnings
from datetime import datetime, timedelta
from pathlib import Path

import pytest

import seatrial as st
from seatrial.daq.errors import SeatrialWarning
from seatrial.daq.log.reader import open_log
from seatrial.ident.data.loading import TimeWindow, load_all
from seatrial.ident.results import answers
from tests.missions import boat_log, boat_with

pytestmark = pytest.mark.usefixtures("quick_compilation")


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder, boat = tmp_path_factory.mktemp("wind"), boat_with(None, 5)
    return [boat_log(folder / f"run{k}.mcap", boat, 60.0, 100 + k, k) for k in (1, 2)]


def test_a_loaded_log_has_its_start(logs: list[Path]) -> None:
    with open_log(logs[0]) as log:
        start = log.start
    for begin in (0.0, 20.0):
        (loaded,), _ = load_all([logs[0]], [], TimeWindow(begin))
        found = datetime.fromisoformat(loaded.about["start"])
        assert found.timestamp() == pytest.approx(start + begin, abs=1.5)


def test_the_answer_of_a_fit_says_that_its_wind_is_one_value(logs: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(answers, "SAME_WEATHER", timedelta(-1))  # as if the logs were days apart
    monkeypatch.setattr(answers, "NO_DATE", 1969)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SeatrialWarning)
        fit = st.fit(logs, fixed={"c1": 40.0, "c2": 1.1}, effects=["wind"], score_tests=False)
    assert "The wind is one value for all logs" in fit.answer
