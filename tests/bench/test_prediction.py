"""Tests of a design's prediction of its mission: read back, shown as text, and refused in one line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seatrial.bench.mission_generators import make_mission
from seatrial.bench.mission_text import describe_errors, describe_mission, describe_track, mission_content
from seatrial.daq.config.mission_file import OperationArea, Prediction, area_sentence, dump_mission, parse_mission
from seatrial.daq.errors import SeatrialError

T = np.linspace(5.0, 65.0, 7)
NORTH, EAST = np.array([0.0, 10, 20, 20, 10, 0, 0]), np.array([0.0, 0, 0, 15, 15, 15, 8])
SQUARE = Prediction("vehicle/model.toml", T, NORTH, EAST, np.linspace(0.0, 6.0, 7), {"m_u": 1.2})
ERRORS = {"m_u": 0.1, "d_v": 0.4}


def test_a_written_prediction_is_read_back_unchanged() -> None:
    mission = replace(make_mission("steps", 60.0, 1), prediction=SQUARE, predicted_errors=ERRORS)
    again = parse_mission(dump_mission(mission), "mission.toml")
    assert again == mission
    assert again.prediction is not None
    assert hash(again.prediction) == hash(SQUARE)
    assert replace(SQUARE, model="other") != SQUARE


def test_show_prints_the_space_of_the_track_and_the_errors_before_and_after() -> None:
    text = describe_mission(replace(make_mission("steps", 60.0, 1), prediction=SQUARE, predicted_errors=ERRORS))
    lines = text.splitlines()
    head = lines.index("predicted standard errors before and after this mission")
    assert [line.split() for line in lines[head + 1 : head + 4]] == [
        ["before", "after"],
        ["m_u", "1.2", "0.1"],
        ["d_v", "-", "0.4"],
    ]
    assert describe_errors(ERRORS, {})[1] == "predicted standard errors after this mission"
    assert [line.split() for line in describe_errors(ERRORS, {})[2:]] == [["m_u", "0.1"], ["d_v", "0.4"]]
    # north: -6 (the last radius) to 20 + 3; east: -2 (the third radius) to 15 + 5; (20, 15) and (10, 15) within 4
    assert "29 m north by 22 m east, at most 28 m from the start" in text


@pytest.mark.parametrize(
    ("size", "corner", "inside", "words"),
    [
        ((30.0, 20.0), (-5.0, -2.5), 0.81, "stays in the area of 30 m north by 20 m east, and 81 % of the boats with"),
        ((30.0, 20.0), (-5.0, 0.5), 0.81, "does not stay in the area of 30 m north by 20 m east"),
        ((30.0, 20.0), (-5.0, -2.5), 0.97, "if the start is 5 m north and 2 m east of its south-west corner."),
    ],
)
def test_show_says_whether_the_track_keeps_the_area(
    size: tuple[float, float], corner: tuple[float, float], inside: float, words: str
) -> None:
    """The band of a track takes more room than the area, and nothing said whether a boat stays in the area."""
    area = OperationArea(size, corner, inside)
    mission = replace(make_mission("steps", 60.0, 1), prediction=replace(SQUARE, area=area))
    again = parse_mission(dump_mission(mission), "mission.toml")
    assert again.prediction is not None
    assert again.prediction.area == area
    assert again != replace(mission, prediction=SQUARE)
    last = describe_mission(again).splitlines()[-1]
    assert last == area_sentence(area, NORTH, EAST)
    assert words in last
    kept = corner[1] < 0.0
    assert last.endswith("a smaller --n-max or a larger --area.") == (not kept or inside < 0.95)
    assert mission_content(again)["area"] == {
        "size": size, "corner": corner, "inside": inside, "nominal_inside": kept,
    }  # fmt: skip


def test_a_mission_without_prediction_prints_no_prediction() -> None:
    text = describe_mission(make_mission("steps", 60.0, 1))
    assert "predicted" not in text
    assert describe_errors({}, {}) == []
    empty = np.zeros(0)
    assert describe_track(Prediction("m", empty, empty, empty, empty)) == []
    assert describe_track(replace(SQUARE, radius=np.full(7, np.inf))) == []


def test_a_prediction_without_times_is_refused() -> None:
    empty = np.zeros(0)
    mission = replace(make_mission("steps", 60.0, 1), prediction=Prediction("m", empty, empty, empty, empty))
    with pytest.raises(SeatrialError, match=r"prediction.t: must have at least one time"):
        parse_mission(dump_mission(mission), "mission.toml")


def test_a_boat_at_rest_needs_no_space() -> None:
    zero = np.zeros(3)
    (_, line) = describe_track(Prediction("m", np.arange(3.0), zero, zero, zero))
    assert line.endswith("0 m north by 0 m east, at most 0 m from the start; one boat needs less")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("radius = [0.0, ", "radius = [", r"prediction.radius: must have 7 numbers, not 6"),
        ("[prediction]", "[prediction]\ncolor = 1", r"prediction.color: unknown key"),
        ("[prediction]", "[prediction]\narea = {size = [1.0]}", r"prediction.area.size: must have 2 numbers"),
        ('errors_before = {"m_u" = 1.2}', 'errors_before = {m_u = "x"}', r"errors_before.m_u: must be a number"),
    ],
)
def test_error_names_the_invalid_value(old: str, new: str, message: str) -> None:
    text = dump_mission(replace(make_mission("steps", 60.0, 1), prediction=SQUARE))
    if old not in text:
        old = old.replace('"m_u"', "m_u")
    assert old in text
    with pytest.raises(SeatrialError, match=message):
        parse_mission(text.replace(old, new), "mission.toml")
