"""What a design expects of a mission: read back, drawn, and refused in one line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.mission_generators import make_mission
from bench.mission_text import describe, describe_errors, describe_track
from daq.config.mission_file import Prediction, dump_mission, parse_mission
from daq.errors import SeatrialError

T = np.linspace(5.0, 65.0, 7)
NORTH, EAST = np.array([0.0, 10, 20, 20, 10, 0, 0]), np.array([0.0, 0, 0, 15, 15, 15, 8])
SQUARE = Prediction("vehicle/model.toml", T, NORTH, EAST, np.linspace(0.0, 6.0, 7), {"m_u": 1.2})
ERRORS = {"m_u": 0.1, "d_v": 0.4}


def test_it_is_read_back_as_it_was_written() -> None:
    mission = replace(make_mission("steps", 60.0, 1), prediction=SQUARE, predicted_errors=ERRORS)
    again = parse_mission(dump_mission(mission), "mission.toml")
    assert again == mission
    assert again.prediction is not None
    assert hash(again.prediction) == hash(SQUARE)
    assert replace(SQUARE, model="other") != SQUARE


def test_show_draws_the_track_and_the_errors_before_and_after() -> None:
    text = describe(replace(make_mission("steps", 60.0, 1), prediction=SQUARE, predicted_errors=ERRORS))
    lines = text.splitlines()
    assert any(line.split() == ["m_u", "0.1", "(1.2)"] for line in lines)
    assert any(line.split() == ["d_v", "0.4"] for line in lines)
    rows = [line[3:-1] for line in describe_track(SQUARE, 60)[2:]]
    start = next((i, r.index("S")) for i, r in enumerate(rows) if "S" in r)
    end = next(r.index("E") for r in rows if "E" in r)
    assert start[1] < end  # the end is east of the start
    first = next(i for i, r in enumerate(rows) if "o" in r)
    assert first < start[0]  # and the boat was north of both
    assert all(len(r) <= 61 for r in rows)
    assert "·" in "".join(rows)
    assert "32 m north by 27 m east" in text


def test_without_prediction_nothing_is_drawn() -> None:
    text = describe(make_mission("steps", 60.0, 1))
    assert "predicted" not in text
    assert describe_errors({}, {}) == []
    empty = np.zeros(0)
    assert describe_track(Prediction("m", empty, empty, empty, empty)) == []


def test_a_still_boat_is_one_point() -> None:
    zero = np.zeros(3)
    drawn = describe_track(Prediction("m", np.arange(3.0), zero, zero, zero), 40)
    assert "E" in "".join(drawn[2:])


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("radius = [0.0, ", "radius = [", r"prediction.radius: must have 7 numbers, not 6"),
        ("[prediction]", "[prediction]\ncolor = 1", r"prediction.color: unknown key"),
        ('errors_before = {"m_u" = 1.2}', 'errors_before = {m_u = "x"}', r"errors_before.m_u: must be a number"),
    ],
)
def test_what_is_wrong_is_named(old: str, new: str, says: str) -> None:
    text = dump_mission(replace(make_mission("steps", 60.0, 1), prediction=SQUARE))
    if old not in text:
        old = old.replace('"m_u"', "m_u")
    assert old in text
    with pytest.raises(SeatrialError, match=says):
        parse_mission(text.replace(old, new), "mission.toml")
