"""Tests of fits with one wind for all logs or one for each log, and of the start times of logs."""

from __future__ import annotations

import warnings
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import seatrial as st
from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.daq.log.reader import open_log
from seatrial.ident.data.loading import TimeWindow, load_all
from seatrial.ident.estimation.model_file import load_model
from seatrial.ident.results import answers
from seatrial.ident.results.answers import wind_sentence
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


@pytest.fixture(scope="module")
def windy(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Record a boat in opposite winds."""
    folder, found = tmp_path_factory.mktemp("windy"), []
    for k, scale in ((1, 1.0), (2, -1.0)):
        found.append(boat_log(folder / f"run{k}.mcap", boat_with("wind", 5, scale), 150.0, 100 + k, k))
    return found


THRUST = {"c1": 40.0, "c2": 1.1}


@pytest.mark.pages
def test_each_log_has_its_own_wind(windy: list[Path], tmp_path: Path) -> None:
    how: dict[str, Any] = {"fixed": THRUST, "effects": ["wind"], "score_tests": False, "reml": False, "mean_order": 1}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SeatrialWarning)
        one, two = st.fit(windy, **how), st.fit(windy, per_log=["F_wx", "F_wy"], **how)
    force = [np.array([two.params[f"{name}@run{k}"] for name in ("F_wx", "F_wy")]) for k in (1, 2)]
    opposite = force[0] @ force[1] / np.linalg.norm(force[0]) / np.linalg.norm(force[1])
    assert opposite < -0.9
    assert min(map(np.linalg.norm, force)) > 2.0 * np.hypot(one.params["F_wx"], one.params["F_wy"])
    assert two.log_likelihood > one.log_likelihood + 20.0
    saved = load_model(two.save(tmp_path / "two") / "model.toml")
    assert {p.name for p in saved.model.parameters if p.per_record and p.name.startswith(("F_", "w_", "k_"))} == {
        "F_wx", "F_wy"
    }  # fmt: skip
    assert wind_sentence(two.result, saved.model) == ""
    with pytest.warns(SeatrialWarning, match="wind: its parameters differ between the fitted runs"):
        st.linearise(tmp_path / "two", speed=0.5)


@pytest.mark.parametrize(
    ("name", "error"),
    [
        ("m_u", "^per_log m_u: only estimated parameters of effects can have a value for each log, here: eps_LR. "),
        ("F_wx", "^per_log F_wx: model horizontal.* it is a parameter of the effect wind"),
    ],
)
def test_other_parameters_have_no_value_for_each_log(name: str, error: str, logs: list[Path]) -> None:
    with pytest.raises(SeatrialError, match=error):
        st.fit(logs, fixed=THRUST, effects=["mismatch"], per_log=name, score_tests=False)


def test_a_fit_of_each_log_needs_no_parameter_for_each_log(logs: list[Path], tmp_path: Path) -> None:
    with pytest.raises(SeatrialError, match=r"^per_log: each log has a fit of its own here"):
        st.fit_many(logs, tmp_path / "fleet", effects=["wind"], per_log=["F_wx"])
