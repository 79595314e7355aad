"""Tests of mission.toml: a written mission is read back, and each error is named in one line."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from seatrial.daq.config.mission_file import Mission, Segment, dump_mission, load_mission, parse_mission, save_mission
from seatrial.daq.errors import SeatrialError

DOCUMENT = Path(__file__).parents[2] / "docs" / "formats" / "mission.md"


def documented() -> str:
    return DOCUMENT.read_text(encoding="utf-8").split("```toml\n")[1].split("```")[0]


def test_the_documented_example_is_a_mission() -> None:
    mission = parse_mission(documented(), "mission.md")
    assert mission.thrusters == ("left", "right")
    assert mission.seed == 1
    assert mission.slew_per_s == 4.0
    assert mission.segment_times() == [(0.0, 10.0, "static"), (10.0, 300.0, "steps up")]
    np.testing.assert_array_equal(mission.segments[1].n, [[0.3, 0.3], [0.5, 0.2], [0.0, 0.0]])


finite = st.floats(-1.0, 1.0)
# printable characters
names = st.text(st.characters(exclude_categories=["C", "Z"], include_characters=" "), max_size=12)


@st.composite
def missions(draw: st.DrawFn) -> Mission:
    n_thrusters = draw(st.integers(1, 3))
    t, segments = 0.0, []
    for _ in range(draw(st.integers(1, 4))):
        steps = draw(st.lists(st.floats(1e-3, 100.0), min_size=1, max_size=4))
        times = t + np.cumsum([0.0, *steps])
        rows = draw(
            st.lists(
                st.lists(finite, min_size=n_thrusters, max_size=n_thrusters),
                min_size=len(steps),
                max_size=len(steps),
            )
        )
        segments.append(Segment(draw(names), times[:-1], np.array(rows)))
        t = float(times[-1])
    return Mission(
        name=draw(names),
        kind="mission",
        thrusters=tuple(f"t{k}" for k in range(n_thrusters)),
        segments=tuple(segments),
        end=t,
        slew_per_s=draw(st.one_of(st.just(math.inf), st.floats(0.1, 10.0))),
        made_by=draw(names),
        seed=draw(st.one_of(st.none(), st.integers(0, 2**40))),
        predicted_errors=draw(st.dictionaries(names, st.floats(0.0, 1e6), max_size=3)),
    )


@given(missions())
def test_round_trip(mission: Mission) -> None:
    assert parse_mission(dump_mission(mission), "round trip") == mission


def test_round_trip_through_a_file(tmp_path: Path) -> None:
    mission = parse_mission(documented(), "mission.md")
    save_mission(mission, tmp_path / "mission.toml")
    assert load_mission(tmp_path / "mission.toml") == mission


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ('format = "seatrial-mission 1"', 'format = "seatrial-mission 9"', "format"),
        ('kind = "mission"', 'kind = "tour"', "kind"),
        ('hold = "zero"', 'hold = "first"', "hold"),
        ('thrusters = ["left", "right"]', 'thrusters = ["left", "left"]', "thrusters"),
        ('thrusters = ["left", "right"]', 'thrusters = ["left", 3]', "thrusters[2]"),
        ('thrusters = ["left", "right"]', "thrusters = []", "thrusters"),
        ('name = "static"', 'nome = "static"', "segment[1].name"),
        ('name = "static"', 'name = "static"\nmood = 1', "segment[1].mood"),
        ("t = [10.0, 15.0, 20.0]", "t = [10.0, 15.0]", "segment[2].n"),
        ("t = [10.0, 15.0, 20.0]", "t = [10.0, 15.0, 15.0]", "segment[2].t[3]"),
        ("t = [10.0, 15.0, 20.0]", "t = [10.0, nan, 20.0]", "segment[2].t"),
        ("t = [10.0, 15.0, 20.0]", "t = [0.0, 15.0, 20.0]", "segment[2].t[1]"),
        ("t = [0.0]", "t = [-1.0]", "segment[1].t[1]"),
        ("[0.5, 0.2]", "[0.5]", "segment[2].n[2]"),
        ("[0.5, 0.2]", '[0.5, "full"]', "segment[2].n[2]"),
        ("[0.5, 0.2]", "[0.5, -1.2]", "segment[2].n[2]"),
        ("n_max = 1.0", "n_max = 0.4", "segment[2].n[2]"),
        ("n_max = 1.0", "n_max = 1.5", "limits.n_max"),
        ("slew_per_s = 4.0", "slew_per_s = 0.0", "limits.slew_per_s"),
        ("seed = 1", 'seed = "one"', "provenance.seed"),
        ("t = 300.0", "t = 20.0", "end.t"),
        ('name = "static"', 'name = "x\\u001b]0;owned\\u0007"', "segment[1].name"),
        ('name = "steps and zigzag"', 'name = "a\\u001b[2Jb"', "name"),
        ('["left", "right"]', '["left", "right\\u202e"]', "thrusters[2]"),
        ('made_by = "seatrial', 'made_by = "\\nseatrial', "provenance.made_by"),
        ("predicted_errors = {", 'predicted_errors = {"\\u001b[2J" = 1.0', r"provenance.predicted_errors.'\x1b[2J'"),
        ("[end]", "[ende]", "end"),
    ],
)
def test_error_names_the_invalid_key(old: str, new: str, key: str) -> None:
    text = documented()
    assert text.count(old) >= 1
    with pytest.raises(SeatrialError) as caught:
        parse_mission(text.replace(old, new, 1), "m.toml")
    assert str(caught.value).startswith(f"m.toml: {key}: ")
    assert "\n" not in str(caught.value)


def test_no_segment_is_an_error() -> None:
    head = documented().split("[[segment]]")[0]
    with pytest.raises(SeatrialError, match=r"m.toml: segment: missing"):
        parse_mission(head + "[end]\nt = 1.0\n", "m.toml")


@given(st.text(max_size=200))
def test_any_text_gives_a_mission_or_an_error(text: str) -> None:
    with pytest.raises(SeatrialError):
        parse_mission(text, "m.toml")


def test_set_points_end_at_zero_at_the_end() -> None:
    mission = parse_mission(documented(), "mission.md")
    t, n = replace(mission, slew_per_s=math.inf).setpoints()
    np.testing.assert_array_equal(t, [0.0, 10.0, 15.0, 20.0, 300.0])
    np.testing.assert_array_equal(n, [[0, 0], [0.3, 0.3], [0.5, 0.2], [0, 0], [0, 0]])


@given(missions())
def test_slew_limit_holds_between_any_two_set_points_but_the_last(mission: Mission) -> None:
    limited = replace(mission, slew_per_s=2.0)
    t, n = limited.setpoints()
    assert np.all(np.diff(t) > 0)
    # A row holds until the next row, so a change at t[k] belongs to the time since t[k-1].
    change = np.abs(np.diff(n[:-1], axis=0, prepend=np.zeros((1, n.shape[1]))))
    dt = np.diff(t[:-1], prepend=t[0] - 0.04)[:, None]
    assert np.all(change <= 2.0 * np.minimum(dt, 0.04) + 1e-9)
    np.testing.assert_array_equal(n[-1], 0.0)
    assert t[-1] == mission.end


def test_slew_limit_reaches_every_level_that_is_held_long_enough() -> None:
    segment = Segment("steps", np.array([0.0, 2.0]), np.array([[1.0], [-1.0]]))
    mission = Mission("m", "steps", ("left",), (segment,), 4.0, slew_per_s=2.0)
    t, n = mission.setpoints()
    assert n[np.searchsorted(t, 2.0) - 1, 0] == 1.0
    assert n[-2, 0] == -1.0
    reached = t[np.flatnonzero(n[:, 0] == -1.0)[0]]
    assert reached == pytest.approx(3.0, abs=0.05)
