"""Tests of the tare of a load cell: zero and drift from a log with known rest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seatrial.bench.execution.tare import describe_tares, measure_tares, static_windows
from seatrial.bench.mission_generators import bench_plan
from seatrial.daq.clock import RunClock
from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.log.recorder import Recorder
from seatrial.daq.rig import LOAD_CELLS, Rig
from seatrial.daq.samples import Frame, LoadCell
from tests.bench.standin import NEWTON_PER_COUNT, RIG, ZERO_COUNTS

START = 1_763_616_000.0
DRIFT = 50.0  # counts over the run


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return parse_rig(RIG.format(speed=1.0), tmp_path / "rig.toml")


def recorded(path: Path, rig: Rig, seconds: float) -> None:
    """Record readings at 20 Hz with linear drift, noise of 10 counts, flagged spikes, and thrust in the middle."""
    rng = np.random.default_rng(1)
    recorder = Recorder(path, rig=rig, clock=RunClock(1.0, (0.0, START)), attachments={}, metadata={})
    for k, t in enumerate(np.arange(0.0, seconds, 0.05)):
        counts = ZERO_COUNTS + DRIFT * t / seconds + rng.normal(0.0, 10.0)
        counts += 20_000.0 if 10.0 < t < seconds - 10.0 else 0.0
        spike = k % 7 == 3
        sample = LoadCell(counts + (1e6 if spike else 0.0), 0.0, 2 if spike else 0)
        recorder.write("loadcell", Frame(sample, START + t, float("nan")), START + t)
    recorder.close()


@pytest.mark.parametrize("protocol", LOAD_CELLS)
def test_every_kind_of_load_cell_is_tared(tmp_path: Path, rig: Rig, protocol: str) -> None:
    devices = tuple(replace(d, protocol=protocol) if d.name == "loadcell" else d for d in rig.devices)
    plan = bench_plan("steps", "left")
    recorded(tmp_path / "run.mcap", rig, plan.end)
    tares = measure_tares(tmp_path / "run.mcap", replace(rig, devices=devices), static_windows(plan, START))
    assert [(tare.device, tare.where) for tare in tares] == [("loadcell", "start"), ("loadcell", "end")]


def test_zero_at_start_and_end_and_the_drift(tmp_path: Path, rig: Rig) -> None:
    plan = bench_plan("steps", "left")
    recorded(tmp_path / "run.mcap", rig, plan.end)
    windows = static_windows(plan, START)
    assert [where for where, _, _ in windows] == ["start", "end"]
    assert windows[0][1:] == (START, START + 10.0)
    assert windows[1][1:] == (START + plan.end - 10.0 + 3.0, START + plan.end)
    first, last = measure_tares(tmp_path / "run.mcap", rig, windows)
    assert first.counts == pytest.approx(ZERO_COUNTS + DRIFT * 5.0 / plan.end, abs=4 * first.standard_error)
    assert last.counts == pytest.approx(ZERO_COUNTS + DRIFT * (1 - 3.5 / plan.end), abs=4 * last.standard_error)
    assert first.standard_error == pytest.approx(10.2 / np.sqrt(first.n_samples), rel=0.3)
    assert 165 <= first.n_samples <= 175  # 200 readings without every seventh

    lines = describe_tares([first, last], rig)
    assert len(lines) == 3
    assert lines[0].startswith("loadcell zero at the start: ")
    drift = last.counts - first.counts
    assert f"loadcell drift: {drift:+.1f} counts = {drift * NEWTON_PER_COUNT:+.3f} N in " in lines[2]


def test_a_log_without_rest_gives_no_tare(tmp_path: Path, rig: Rig) -> None:
    recorded(tmp_path / "run.mcap", rig, 20.0)
    assert measure_tares(tmp_path / "run.mcap", rig, [("start", START - 100.0, START - 50.0)]) == []
