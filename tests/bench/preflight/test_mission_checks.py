"""Tests of the dry run of a mission: limits, duration, and the track of the nominal vehicle relative to the fence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from seatrial.bench.execution.actuator_test import actuator_plan
from seatrial.bench.execution.link_test import LinkTest, save_link_tests
from seatrial.bench.preflight.mission_checks import check_mission, track
from seatrial.daq.config.mission_file import Mission, Prediction, Segment
from seatrial.daq.errors import SeatrialError
from seatrial.daq.rig import Rig
from seatrial.mocks.offline_simulation import simulate
from seatrial.mocks.plant.boat import draw_boat
from tests.daq.mavlink_ends import mav_rig
from tests.missions import rig_of

BOAT = rig_of("boat")
RIG = replace(BOAT, vehicle={**BOAT.vehicle, "c1": 40.05, "c2": 1.11})


def ahead(n: float, seconds: float) -> Mission:
    return Mission(
        "ahead", "mission", ("left", "right"), (Segment("go", np.array([0.0]), np.full((1, 2), n)),), seconds
    )


def findings_of(mission: Mission, rig: Rig) -> list[tuple[str, str]]:
    return [(f.check, f.level) for f in check_mission(mission, rig)]


def test_the_predicted_track_reaches_the_steady_speed_of_the_model() -> None:
    t, x, y = track(ahead(0.5, 60.0), RIG)
    push, d, dd = 2 * (40.05 + 1.11) * 0.25, RIG.vehicle["d_u"], RIG.vehicle["d_uu"]
    steady = (-d + np.sqrt(d * d + 4 * dd * push)) / (2 * dd)
    late = (t > 50.0) & (t < 59.0)
    assert np.diff(x[late]).mean() / 0.05 == pytest.approx(steady, rel=1e-3)
    assert np.abs(y).max() < 1e-9


def test_the_predicted_track_turns_like_the_mock_boat() -> None:
    n = np.array([[0.6, 0.3]])
    mission = Mission("turn", "mission", ("left", "right"), (Segment("go", np.array([0.0]), n),), 30.0)
    _, x, y = track(mission, RIG)
    boat = draw_boat(4)
    truth = simulate(replace(boat, current=(0.0, 0.0)), [0.0], n, 30.0, disturbed=False).truth
    far = np.hypot(truth["x"] - truth["x"][0], truth["y"] - truth["y"][0]).max()
    assert np.hypot(x, y).max() == pytest.approx(far, rel=0.3)  # another hull, within 10 % of the nominal hull


def test_leaving_the_fence_is_a_fault_and_coming_close_a_warning() -> None:
    _, x, _ = track(ahead(0.5, 60.0), RIG)
    for radius, level in ((0.9 * x[-1], "fault"), (1.1 * x[-1], "warning"), (2.0 * x[-1], "ok")):
        fenced = replace(RIG, limits=replace(RIG.limits, radius_m=radius))
        assert findings_of(ahead(0.5, 60.0), fenced) == [("limits", "ok"), ("fence", level)]


def test_a_rig_without_a_thrust_curve_gets_no_prediction() -> None:
    assert findings_of(ahead(0.5, 60.0), BOAT) == [("limits", "ok"), ("fence", "warning")]
    assert findings_of(ahead(0.5, 60.0), replace(BOAT, limits=replace(BOAT.limits, radius_m=None))) == [
        ("limits", "ok")
    ]


def test_a_light_boat_with_high_damping_reaches_its_steady_speed() -> None:
    light = replace(RIG, vehicle={**RIG.vehicle, "m_u": 0.5, "d_uu": 60.0})
    t, x, _ = track(ahead(0.5, 60.0), light)
    steady = np.sqrt(2 * (40.05 + 1.11) * 0.25 / 60.0)
    assert np.diff(x[t > 5.0]).mean() / 0.05 == pytest.approx(steady, rel=0.01)
    assert findings_of(ahead(0.5, 60.0), light) == [("limits", "ok"), ("fence", "ok")]


@pytest.mark.parametrize(
    ("vehicle", "why"),
    [
        ({"m_u": 0.0}, "has m_u not above zero"),
        ({"m_u": -1.0, "m_r": 0.0}, "has m_u and m_r not above zero"),
        ({"m_r": 0.02, "d_r": 0.0, "d_rr": 0.0}, "makes it diverge"),
        ({"d_u": -740.0}, "makes it diverge"),  # multiplied by TRACK_STEP_S it equals m_u
    ],
)
def test_an_invalid_vehicle_is_not_predicted(vehicle: dict[str, float], why: str) -> None:
    turn = Mission("turn", "mission", ("left", "right"), (Segment("go", np.zeros(1), np.array([[0.9, 0.3]])),), 60.0)
    (_, fence) = check_mission(turn, replace(RIG, vehicle={**RIG.vehicle, **vehicle}))
    assert (fence.level, fence.code) == ("warning", "track-not-predicted")
    assert fence.text.endswith(f"[vehicle] of the rig {why}")


def test_the_prediction_of_the_design_is_preferred() -> None:
    t = np.array([0.0, 30.0, 60.0])
    prediction = Prediction("m", t, np.array([0.0, 250.0, 10.0]), np.zeros(3), np.array([0.0, 60.0, 60.0]))
    (_, fence) = check_mission(replace(ahead(0.1, 60.0), prediction=prediction), RIG)
    assert fence.level == "fault"
    assert "left after 30 s" in fence.text


def test_a_plan_beyond_the_limit_is_a_fault() -> None:
    limited = replace(RIG, limits=replace(RIG.limits, n_max=0.4))
    assert findings_of(ahead(0.5, 60.0), limited) == [("limits", "fault")]
    assert findings_of(ahead(np.nan, 60.0), RIG) == [("limits", "fault")]


def test_the_actuator_test_is_low_short_and_ends_at_zero() -> None:
    plan = actuator_plan(BOAT)
    t, n = plan.setpoints()
    assert np.abs(n).max() == pytest.approx(0.3)
    assert not n[-1].any()
    assert t[-1] < 60.0
    alone = [(n[:, k] != 0.0) & (n[:, 1 - k] == 0.0) for k in (0, 1)]
    assert all(rows.any() for rows in alone)
    assert np.abs(actuator_plan(replace(BOAT, limits=replace(BOAT.limits, n_max=0.1))).setpoints()[1]).max() <= 0.1
    with pytest.raises(SeatrialError, match="has none"):
        actuator_plan(replace(BOAT, thrusters=(), path=Path("dry.toml")))


def test_a_mission_that_needs_a_link_test_is_warned_of_before_the_run(tmp_path: Path) -> None:
    rig = mav_rig(tmp_path)
    segments = (Segment("steps", np.array([0.0, 5.0]), np.array([[0.6, 0.6], [0.0, 0.0]])),)
    fast = Mission("fast", "steps", ("left", "right"), segments, 6.0)

    def found(mission: Mission) -> list[tuple[str, str]]:
        return [(f.text, f.advice) for f in check_mission(mission, rig) if f.code == "link-not-tested"]

    ((text, advice),) = found(fast)
    assert text.startswith("the run will be refused: commands up to n = 0.60 need a valid test of the lost link")
    assert text.endswith(" (limits.link_test_n): it was never done")
    assert advice == "run `seatrial check rig.toml --actuators --link-test --arm`"
    low = Segment("steps", segments[0].t, rig.limits.link_test_n * segments[0].n / 0.6)
    assert found(replace(fast, segments=(low,))) == []
    passed = LinkTest(0.5, 0.1, "2026-01-01T00:00:00Z", "hash", receiver=False)
    save_link_tests(rig, {"autopilot": passed})
    assert found(fast) == []
    save_link_tests(rig, {"autopilot": msgspec.structs.replace(passed, seconds=9.0)})
    ((text, _),) = found(fast)
    assert text.endswith("on 2026-01-01T00:00:00Z thrust went on for 9.00 s")
