"""Tests of long gaps: a log is cut where no sensor has a sample, and its parts need the time and memory of short
logs.
"""

from __future__ import annotations

import resource
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import seatrial as st
from seatrial import command_line
from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.daq.log import open_log, part_in
from seatrial.daq.samples import Ahrs
from seatrial.ident.checks.log_checks import LogChecks, log_evidence
from seatrial.ident.data.gaps import clock_of, parts_between, silent_times
from seatrial.ident.data.loading import TimeWindow, load_all, load_run, load_runs, usable_parts
from seatrial.ident.data.record import Channel, LeftOut, make_record
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.mocks.world import Reading
from tests.missions import boat_with, record, rig_of, sail

DAY, TEN_YEARS = 86_400.0, 10 * 365.25 * 86_400.0
SECONDS = 30.0


@cache
def missions() -> tuple[Sequence[Reading], Sequence[Reading]]:
    """Return the readings of two missions of a boat."""
    boat = boat_with(None, 4)
    return sail(boat, SECONDS, 3, 1)[0].readings, sail(boat, SECONDS, 5, 2)[0].readings


def log_with_gap(path: Path, gap: float, n_last: int | None = None) -> Path:
    """Write a log of two missions with a gap between them. The second may have few samples."""
    first, second = missions()
    late = [reading._replace(t=reading.t + SECONDS + gap) for reading in second[:n_last]]
    return record(path, rig_of("boat"), [*first, *late])


@pytest.mark.parametrize("gap", [DAY, TEN_YEARS])
def test_parts_of_a_log_with_a_gap_need_no_more_memory_than_alone(tmp_path: Path, gap: float) -> None:
    """Formerly, a gap of one day needed a minute and a gigabyte, and ten years exceeded the memory."""
    path = log_with_gap(tmp_path / "run.mcap", gap)
    end = f"{SECONDS + gap:.0f}"
    limit = resource.getrlimit(resource.RLIMIT_AS)
    in_use = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (in_use + 300_000_000, limit[1]))
    try:
        with pytest.warns(SeatrialWarning, match=rf"no sensor has a sample from 30 to {end} s: the log is cut there"):
            loaded, _ = load_all([path], [])
        records = [make_record(horizontal_model(), part.run, 10.0) for part in loaded]
        evidence = log_evidence(path)
        found = LogChecks().check(path)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limit)
    assert [part.about["name"] for part in loaded] == ["run[0:30]", f"run[{end}:{SECONDS + SECONDS + gap:.0f}]"]
    assert [r.name for r in records] == [part.about["name"] for part in loaded]
    alone = make_record(horizontal_model(), load_run(log_with_gap(tmp_path / "b.mcap", 1.0), "judged").run, 10.0)
    for part in records:
        assert part.duration == pytest.approx(SECONDS, abs=0.5)
        assert part.n_rows < 0.6 * alone.n_rows
    assert [part.name for part in evidence] == [part.about["name"] for part in loaded]
    assert all(1000 < part.intervals[0].t.size < 1600 for part in evidence)
    assert max(row.interval.max() for part in evidence for row in part.intervals) < 1.0
    assert [f for f in found if f.level == "fault"] == []


def test_finding_names_the_part_of_the_log(tmp_path: Path) -> None:
    first, second = missions()
    late = [r._replace(t=r.t + 2.0 * SECONDS + DAY) for r in second]
    late = [r._replace(sample=replace(r.sample, r=-r.sample.r)) if isinstance(r.sample, Ahrs) else r for r in late]
    found = LogChecks().check(record(tmp_path / "run.mcap", rig_of("boat"), [*first, *late]))
    (sign,) = [f for f in found if f.level == "fault"]
    assert sign.text.startswith("from 86460 to 86490 s: ")


def test_a_check_of_a_window_finds_only_what_is_in_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = missions()
    late = [r._replace(t=r.t + SECONDS + 8.0) for r in second]
    late = [r._replace(sample=replace(r.sample, r=-r.sample.r)) if isinstance(r.sample, Ahrs) else r for r in late]
    path = record(tmp_path / "run.mcap", rig_of("boat"), [*first, *late])
    healthy, faulty = st.open_log(path, end=30.0), st.open_log(path, start=38.5)
    assert "heading-sense" not in {f.code for f in st.check(healthy)}
    assert "heading-sense" in {f.code for f in st.check(faulty)}
    both = {f.where.partition(": ")[0] for f in st.check([healthy, faulty]) if f.code == "heading-sense"}
    assert both == {"run[38.5:inf]"}
    # The time of a gap counts from the start of the log, not from that of the window.
    gaps = [f.text for f in st.check(st.open_log(path, start=20.0)) if f.code == "sections-missing"]
    assert gaps
    assert all(abs(float(text.partition(" from ")[2].split()[0]) - SECONDS) < 0.5 for text in gaps), gaps
    page = tmp_path / "check.html"
    with pytest.raises(SystemExit) as left:
        command_line.main(["check", str(path), "--to", "30", "--report", str(page)])
    out = capsys.readouterr().out
    assert not left.value.code, out
    assert "heading-sense" not in out
    assert "run.mcap[0:30]" in page.read_text(encoding="utf-8")
    (evidence,) = log_evidence(path, window=TimeWindow(5.0, 25.0))
    assert evidence.name == "run[5:25]"
    assert all(s.t[0] > 4.9 and s.t[-1] < 25.1 for s in (*evidence.signals, *evidence.intervals, *evidence.shafts))
    with pytest.raises(SeatrialError, match="no data are left from 100 s on"):
        part_in(open_log(path), TimeWindow(100.0))


def test_short_gap_does_not_cut_and_short_part_is_left_out(tmp_path: Path) -> None:
    whole = load_run(log_with_gap(tmp_path / "short.mcap", 50.0), "judged")
    assert usable_parts(whole) == [whole]
    path = log_with_gap(tmp_path / "run.mcap", DAY, n_last=400)
    with pytest.warns(
        SeatrialWarning, match="its parts are used as separate runs; 1 part shorter than 10 s is left out"
    ):
        (part,) = load_runs([path], "judged")
    assert part.about["name"] == "run[0:30]"
    with pytest.warns(SeatrialWarning):
        (late,) = load_runs([log_with_gap(tmp_path / "b.mcap", DAY)], "judged", TimeWindow(40.0))
    assert late.about["name"] == "b[86430:86460]"


def test_log_without_a_part_of_ten_seconds_is_rejected(tmp_path: Path) -> None:
    boat = boat_with(None, 4)
    readings = [r._replace(t=r.t + 100.0 * int(r.t / 5.0)) for r in sail(boat, SECONDS, 3)[0].readings]
    with pytest.raises(
        SeatrialError,
        match=r"run\.mcap: no segment of the log between two gaps is as long as 10 s.*the log is cut at 6 gaps",
    ):
        load_all([record(tmp_path / "run.mcap", rig_of("boat"), readings)], [])


def of(t: list[float], hold: str = "") -> Channel:
    return Channel(np.array(t), np.arange(len(t), dtype=float), hold=hold)


def test_silent_times_are_times_without_any_motion_sensor() -> None:
    """A GNSS outage with a running gyro is not a gap. Shaft speeds alone are not motion data. A slow sensor is not a
    gap.
    """
    steady = Channel(np.arange(0.0, 1000.0, 0.5), np.zeros(2000))
    outage = Channel(np.append(np.arange(100.0), np.arange(900.0, 1000.0)), np.zeros(200))
    assert silent_times({"r": steady, "x": outage}) == []
    assert silent_times({"n_left": steady, "x": outage}) == [(99.0, 900.0)]
    assert silent_times({"xdr_OIL": steady, "x": outage}) == [(99.0, 900.0)]
    assert silent_times({"n_cmd_left": steady, "n_left": outage}) == [(99.0, 900.0)]
    bench = {"force": outage, "n_cmd_left": outage, "n_left": outage}
    assert silent_times(bench | {"voltage": steady, "current_left": steady}) == [(99.0, 900.0)]
    assert silent_times({"x": Channel(np.arange(0.0, 90_000.0, 300.0), np.zeros(300))}) == []
    assert silent_times({"n_cmd_left": steady}) == []
    assert silent_times({}) == []


def test_command_recorded_on_change_holds_across_a_gap() -> None:
    gaps = [(100.0, 1000.0)]
    sensor = Channel(np.append(np.arange(101.0), np.arange(1000.0, 1101.0)), np.zeros(202))
    every_second = Channel(sensor.t + 0.25, np.arange(202.0))
    first, second = parts_between(
        {"x": sensor, "n_cmd_left": of([3.0, 90.0, 1050.0]), "n_left": every_second, "f": of([5.0, 9.0])}, gaps
    )
    assert first["n_cmd_left"].t.tolist() == [3.0, 90.0]
    assert (second["n_cmd_left"].t.tolist(), second["n_cmd_left"].value.tolist()) == ([1000.0, 1050.0], [1.0, 2.0])
    assert second["n_left"].t[0] == 1000.25
    assert set(second) == {"x", "n_cmd_left", "n_left"}
    regular = Channel(sensor.t + 0.125, np.arange(202.0), hold="zero")
    regular = replace(regular, t=np.repeat(regular.t, 2) + np.tile([0.0, 0.5], 202), value=np.arange(404.0))
    assert parts_between({"x": sensor, "n_cmd_left": regular}, gaps)[1]["n_cmd_left"].t[0] == 1000.125


def test_outliers_stay_with_their_part() -> None:
    t = np.append(np.arange(101.0), np.arange(1000.0, 1101.0))
    left_out = LeftOut(np.array([7.5, 1003.5]), np.array([1e7, 1e8]), 0.0)
    first, second = parts_between({"x": Channel(t, np.zeros(202), left_out=left_out)}, [(100.0, 1000.0)])
    assert first["x"].left_out is not None
    assert second["x"].left_out is not None
    assert (first["x"].left_out.t.tolist(), first["x"].left_out.value.tolist()) == ([7.5], [1e7])
    assert (second["x"].left_out.t.tolist(), second["x"].left_out.value.tolist()) == ([3.5], [1e8])


def test_fine_clock_has_no_times_in_a_gap() -> None:
    t = np.append(np.arange(0.0, 10.0, 0.1), np.arange(3e8, 3e8 + 10.0, 0.1))
    clock = clock_of(t, 0.01, before=1.0)
    assert clock.size < 2300
    assert np.all(np.diff(clock) > 0.0)
    np.testing.assert_array_equal(clock_of(t[:100], 0.01), np.arange(0.0, t[99] + 0.01, 0.01))
    assert clock_of(np.array([]), 0.01).size == 0
