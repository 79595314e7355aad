"""Tests of plans: duration, range, rest, repeatability, and their description as text."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.bench import mission_generators
from seatrial.bench.mission_text import command_range, describe_mission
from seatrial.daq.config.mission_file import STATIC, Mission, dump_mission, parse_mission


def every_plan() -> list[Mission]:
    bench = [mission_generators.bench_plan(kind, "left") for kind in mission_generators.BENCH_KINDS]
    return bench + [mission_generators.make_mission(kind, 300.0, 7) for kind in mission_generators.MISSION_KINDS]


@pytest.mark.parametrize("plan", every_plan(), ids=lambda plan: plan.name)
def test_every_plan_is_a_valid_file_and_rests_before_and_after(plan: Mission) -> None:
    assert parse_mission(dump_mission(plan), plan.name) == plan
    assert plan.segments[0].name == plan.segments[-1].name == STATIC
    assert not plan.segments[0].n.any()
    assert not plan.segments[-1].n.any()
    assert plan.end - plan.segments[-1].t[0] >= 5.0 - 1e-9


def held(plan: Mission, dt: float = 0.01) -> np.ndarray:
    t, n = plan.setpoints()
    return n[np.searchsorted(t, np.arange(0.0, plan.end, dt), side="right") - 1]


def test_bench_steps_climb_and_fall_on_both_sides() -> None:
    plan = mission_generators.bench_plan("steps", "left", n_max=0.6)
    ahead, astern = plan.segments[1].n[:, 0], plan.segments[3].n[:, 0]
    low = [1 / 3, 2 / 3]  # at the edge of a dead band
    np.testing.assert_allclose(ahead, np.array([*low, 1, 2, 3, 4, 5, 6, 5, 4, 3, 2, 1, *low[::-1]]) * 0.1, atol=1e-6)
    np.testing.assert_array_equal(astern, -ahead)


def test_bench_chirps_are_of_one_sign_each_and_sweep_up() -> None:
    plan = mission_generators.bench_plan("chirp", "left", n_max=0.8)
    ahead, astern = plan.segments[1], plan.segments[3]
    assert ahead.n.min() == 0.0
    assert ahead.n.max() == pytest.approx(0.8, abs=1e-3)
    np.testing.assert_array_equal(astern.n, -ahead.n)
    assert np.max(np.diff(ahead.t)) == pytest.approx(0.04, abs=1e-3)
    peaks = np.flatnonzero((ahead.n[1:-1, 0] > ahead.n[:-2, 0]) & (ahead.n[1:-1, 0] >= ahead.n[2:, 0]))
    periods = np.diff(ahead.t[peaks + 1])
    assert periods[0] > 2.5 * periods[-1]
    assert len(peaks) == pytest.approx(20.0 * (0.05 + 1.5) / 2, abs=2)


def test_bench_all_takes_about_two_minutes() -> None:
    assert 100.0 <= mission_generators.bench_plan("all", "left").end <= 130.0


@pytest.mark.parametrize("kind", mission_generators.MISSION_KINDS)
def test_missions_repeat_with_their_seed_only(kind: str) -> None:
    assert mission_generators.make_mission(kind, 200.0, 3) == mission_generators.make_mission(kind, 200.0, 3)
    assert (
        mission_generators.make_mission(kind, 200.0, 3).segments
        != mission_generators.make_mission(kind, 200.0, 4).segments
    )


@pytest.mark.parametrize("kind", mission_generators.MISSION_KINDS)
@pytest.mark.parametrize("seconds", [30.0, 61.7, 400.0])
def test_missions_last_the_requested_time_and_keep_the_limit(kind: str, seconds: float) -> None:
    plan = mission_generators.make_mission(kind, seconds, 1, n_max=0.6)
    assert plan.end == pytest.approx(seconds, abs=0.01)
    assert max(np.abs(segment.n).max() for segment in plan.segments) <= 0.6


@pytest.mark.parametrize("seed", range(20))
def test_mixed_missions_contain_all_excitations_that_a_diagnosis_needs(seed: int) -> None:
    n = held(mission_generators.make_mission("mixed", 400.0, seed))
    mean, difference = n.mean(axis=1), n[:, 0] - n[:, 1]
    assert np.mean(mean > 0.6) > 0.04  # fast
    assert np.mean(mean < -0.2) > 0.03  # astern
    assert np.mean(difference > 0.2) > 0.1
    assert np.mean(difference < -0.2) > 0.1
    assert np.mean((n[:, 0] < -0.1) & (n[:, 1] > 0.1)) > 0.01  # apart
    assert np.mean((n[:, 0] > 0.1) & (n[:, 1] < -0.1)) > 0.01


def test_unknown_kinds_are_refused() -> None:
    with pytest.raises(ValueError, match="tour"):
        mission_generators.make_mission("tour", 100.0, 1)
    with pytest.raises(ValueError, match="tour"):
        mission_generators.bench_plan("tour", "left")


def test_the_range_of_a_command_covers_the_held_values() -> None:
    t, n = np.array([1.0, 5.0]), np.array([1.0, -0.5])
    assert command_range(t, n, 0.0, 10.0) == (-0.5, 1.0)
    assert command_range(t, n, 2.0, 5.0) == (1.0, 1.0)  # it was held from before, and the next value comes at the end
    assert command_range(t, n, 6.0, 9.0) == (-0.5, -0.5)
    assert command_range(t, n, 0.0, 1.0) == (0.0, 0.0)  # zero holds before the first row
    assert command_range(t, n, 0.5, 2.0) == (0.0, 1.0)


def test_a_description_names_segments_and_thrusters() -> None:
    text = describe_mission(mission_generators.make_mission("mixed", 120.0, 1))
    for word in ("surge steps", "zigzag", "random steps", "n_cmd_left", "n_cmd_right", "--seed 1", "120 s"):
        assert word in text
