"""Tests of the rows of a search: few for a slow vehicle, the usual ones for quick vehicles and fast states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from seatrial.ident.diagnosis.search_rows import fastest_rate, rows_of_search
from seatrial.ident.effects import catalogue
from seatrial.ident.model import Model
from seatrial.ident.models import first_order, horizontal_model, surge_model

RANGES = {"u": (-0.5, 1.0), "v": (-0.2, 0.2), "r": (-0.4, 0.4), "n_left": (-1.0, 1.0), "n_right": (-1.0, 1.0)}


SENSORS = ("attitude", "gyro", "position")


def boat(m_r: float = 6.0, sensors: Sequence[str] = SENSORS) -> Model:
    """Return a shaft model with a moment of inertia in yaw [kg m2] and sensors."""
    model = horizontal_model("shaft", sensors)
    return model.replace_parameters(replace(model.parameter("m_r"), value=m_r))


def test_rows_of_a_slow_vehicle_are_0_2_s_apart() -> None:
    model, rate = rows_of_search(boat(), RANGES, 10.0)
    assert (model.max_step, rate) == (0.2, 5.0)


def test_quick_vehicle_and_unknown_ranges_keep_the_usual_rows() -> None:
    assert fastest_rate(boat(0.1), RANGES) > 5.0
    for model, ranges in ((boat(0.1), RANGES), (boat(), {}), (horizontal_model("command"), RANGES)):
        assert rows_of_search(model, ranges, 10.0) == (model, 10.0)


def test_model_with_accelerometers_keeps_the_usual_rows() -> None:
    model = boat(sensors=(*SENSORS, "accelerometer"))
    assert rows_of_search(model, RANGES, 10.0) == (model, 10.0)


def test_fastest_rate_is_that_of_the_drag_at_the_largest_speed() -> None:
    """The derivative of -(d_u u + d_uu u |u|) / m_u at u = -2 m/s has the larger size of both ends."""
    model = surge_model("shaft", "speed")
    p = model.values
    expected = (p["d_u"] + 2.0 * 2.0 * p["d_uu"]) / p["m_u"]
    assert fastest_rate(model, {"u": (-2.0, 1.0)}) == pytest.approx(expected, rel=1e-3)


def test_frequency_of_an_oscillation_is_bounded_by_the_steps() -> None:
    waves = catalogue()["waves"]
    bounds = {step: (replace(boat(), max_step=step) + waves).parameter("f_wave").bounds for step in (0.1, 0.2)}
    assert bounds == {0.1: (0.1, 2.5), 0.2: (0.1, 1.25)}


@pytest.mark.parametrize(("step", "shortest"), [(0.05, 0.05), (0.1, 0.05), (0.2, 0.1)])
def test_state_of_a_lag_is_no_faster_than_the_steps_allow(step: float, shortest: float) -> None:
    model = replace(boat(), max_step=step) + catalogue()["lag"]
    s = model.bag(np.zeros(len(model.states)), np.zeros(len(model.inputs)), [p.value for p in model.parameters])
    first_order(s, "late_left", 1.0, 0.0)
    assert s.rate["late_left"] == pytest.approx(1.0 / shortest)
