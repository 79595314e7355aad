"""Tests of the error of a given antenna position, by one score test of a fit without score tests."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

import seatrial as st
from seatrial.daq.config.rig_file import parse_rig
from seatrial.ident.data import Channel, LogSegment
from seatrial.ident.diagnosis import antenna_error
from seatrial.ident.estimation import fit_nominal_model
from seatrial.ident.models import horizontal_model
from seatrial.ident.models.components import antenna_component
from seatrial.ident.results import antenna_warning
from tests.missions import boat_with, channels_of, record, sail


@cache
def behind(arm: float) -> dict[str, Channel]:
    """Return the channels of a mission of a boat whose antenna is ``arm`` [m] behind the origin."""
    c = channels_of(sail(boat_with(None, 2), 120.0, 11)[0])
    psi, r = (np.interp(c["x"].t, c[n].t, np.unwrap(c[n].value) if n == "psi" else c[n].value) for n in ("psi", "r"))
    north, east = np.cos(psi), np.sin(psi)
    moved = {"x": -arm * north, "y": -arm * east, "vx": arm * r * east, "vy": -arm * r * north}
    return c | {n: Channel(c[n].t, c[n].value + by) for n, by in moved.items()}


@pytest.mark.parametrize(("given", "warned"), [(-0.6, False), (0.6, True)])
def test_wrong_sign_of_the_lever_arm_is_found_by_one_step(given: float, warned: bool) -> None:
    plain = horizontal_model("shaft")
    fitted = fit_nominal_model(
        plain + antenna_component(plain, (given, 0.0, 0.0)), [LogSegment("run", behind(0.6))], []
    )
    away = antenna_error(fitted)
    estimate, error = away["l_x"]
    assert estimate == pytest.approx(-0.6 - given, abs=0.15)
    assert 0.0 < error < 0.3
    assert [w.code for w in antenna_warning(fitted.model, away)] == ["antenna-contradicted"] * warned


def test_model_without_a_given_position_has_no_test() -> None:
    fitted = fit_nominal_model(horizontal_model("shaft"), [LogSegment("run", behind(0.6))], [])
    assert antenna_error(fitted) == {}


def test_fit_without_score_tests_warns_of_a_wrong_lever_arm(tmp_path: Path) -> None:
    recording, _ = sail(boat_with(None, 2), 120.0, 11)
    text = files("seatrial.mocks").joinpath("rigs", "boat.toml").read_text(encoding="utf-8")
    at_bow = parse_rig(
        text.replace("lever_arm_m = [0.0, 0.0, 0.0]", "lever_arm_m = [1.0, 0.0, 0.0]"), Path("boat.toml")
    )
    path = record(tmp_path / "run.mcap", at_bow, recording.readings)
    with pytest.warns(st.SeatrialWarning):
        model = st.fit(path, model="horizontal:shaft", score_tests=False, reml=False, mean_order=1)
    assert "antenna-contradicted" in {w.code for w in model.result.warnings}
