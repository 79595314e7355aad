"""Tests of the log of a page: signals, tracks, health and cut intervals, also of growing, damaged and empty logs."""

from __future__ import annotations

import contextlib
import os
import shlex
import time
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import click
import numpy as np
import pytest

from seatrial import command_line
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.importers.import_map import parse_import_map
from seatrial.daq.log.reader import open_log
from seatrial.daq.log.recorder import Recorder
from seatrial.daq.log.tables import LogTable
from seatrial.daq.samples import Ahrs, Command, Frame, Gnss, LoadCell, Scalar
from seatrial.daq.view import viewed_log
from seatrial.daq.view.columns import Columns
from seatrial.daq.view.content import CUT, LIVE, WAITING, WHOLE
from seatrial.daq.view.viewed_log import ViewedLog
from seatrial.ident.data.loading import TimeWindow, load_run
from tests.daq.logs import N_ROUNDS, NAN, T0, recorder, write_everything


@pytest.fixture(autouse=True)
def _look_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewed_log, "REFRESH_S", 0.0)


def old(path: Path) -> Path:
    """Set the time of a file to one minute ago, as if it were no longer written."""
    os.utime(path, (time.time() - 60.0,) * 2)
    return path


def write_run(log: Recorder, seconds: float, begin: float = 0.0, gnss: bool = True) -> None:
    """Write a circle of a boat, with a gap of the AHRS from 4 to 6 s."""
    for k in range(round(begin * 50), round((begin + seconds) * 50)):
        t, angle = T0 + k / 50, k / 500
        if not 4.0 < k / 50 < 6.0:
            log.write("ahrs", Frame(Ahrs(angle % 3.0, 0.0, 0.0, 0.0, 0.0, 0.1), t + 0.01, NAN), t)
        if gnss and k % 10 == 0:
            lat, lon = 60.0 + 1e-4 * np.sin(angle), 10.0 + 2e-4 * (1.0 - np.cos(angle))
            log.write("gnss", Frame(Gnss(t, lat, lon, vel_n=1.0, vel_e=0.5, fix=3), t + 0.05, NAN), t)
        if k % 50 == 0:
            log.write("esc", Frame(Command(1, 0.1 * (k // 50 % 5)), t, NAN), t)
    log._writer.flush()


def test_signals_are_listed_by_topic_and_unit(tmp_path: Path) -> None:
    write_everything(tmp_path / "a.mcap", N_ROUNDS)
    content = ViewedLog(old(tmp_path / "a.mcap")).content()
    assert content.state == WHOLE
    signals = {signal.id: (signal.name, signal.unit) for table in content.tables for signal in table.signals}
    assert signals["/ahrs/imu:r"] == ("r", "rad/s")
    assert signals["/esc/1/state:rpm"] == ("rpm", "rev/min")
    assert signals["/loadcell/counts:force"] == ("force", "N")
    assert signals["/signal/surge:value"] == ("surge", "")
    assert "/imu/imu:yaw" not in signals  # it has no finite value
    assert [event.kind for event in content.events] == ["mark"] * N_ROUNDS
    assert {port.device: port.checksum_errors for port in content.ports} == {"ahrs": 8}


def test_a_curve_has_the_samples_of_the_log(tmp_path: Path) -> None:
    with contextlib.closing(recorder(tmp_path / "a.mcap")) as log:
        write_run(log, 20.0)
    viewed = ViewedLog(old(tmp_path / "a.mcap"))
    raw = open_log(tmp_path / "a.mcap").table(Ahrs, "ahrs")
    curve = viewed.curve("/ahrs/imu:yaw", 0.0, 20.0, 4000)
    shown = np.isfinite(curve.value)
    np.testing.assert_allclose(curve.t[shown], raw["t"] - T0, atol=1e-6)
    np.testing.assert_array_equal(curve.value[shown], raw["yaw"])
    assert curve.t[~shown] == pytest.approx([5.0], abs=0.03)  # the gap
    command = viewed.curve("/esc/1/command:n_cmd", 10.5, 10.8, 100)
    assert (command.t[0], command.value[0], command.value[-1]) == pytest.approx((10.0, 0.0, 0.1), abs=1e-6)
    last = viewed.curve("/esc/1/command:n_cmd", 0.0, 30.0, 100)
    assert last.t[-1] == pytest.approx(19.98, abs=0.03)  # a command holds to the end of the log
    (row,) = [row for row in viewed.content().tables if row.topic == "/ahrs/imu"]
    assert (row.gap, row.gap_at, row.expected) == pytest.approx((2.0, 4.0, 50.0), abs=0.05)


@pytest.mark.parametrize("seconds", [30.0, 4.0])
def test_the_recent_rate_does_not_count_both_ends(seconds: float) -> None:
    t = T0 + 0.1 * np.arange(round(10 * seconds) + 1)
    rows = np.zeros(t.size, [("t", "f8"), ("value", "f8")])
    rows["t"] = t
    table = SimpleNamespace(kind=Scalar, source="n", units={}, held=False, rows=rows)
    columns = Columns(cast(LogTable, table), "", "signals", "/signal/n")
    columns.append(rows)
    row = columns.row(T0, float(t[-1]), np.nan)
    assert row.recent == pytest.approx(10.0, rel=1e-3)
    assert columns.row(T0, float(t[-1]) + 5.0, np.nan).recent == pytest.approx(5.0 if seconds > 10.0 else 40 / 9.0)


def test_the_track_is_in_metres(tmp_path: Path) -> None:
    with contextlib.closing(recorder(tmp_path / "a.mcap")) as log:
        write_run(log, 30.0)
    viewed = ViewedLog(old(tmp_path / "a.mcap"))
    track = viewed.track("/gnss/gnss", 0.0, 30.0, 1000)
    assert len(track.t) == 150
    assert max(track.north) == pytest.approx(11.14, abs=0.1)  # 1e-4 degrees
    assert max(track.east) == pytest.approx(2e-4 * 111_400 * 0.5 * (1.0 - np.cos(2.98)), abs=0.3)
    part = viewed.track("/gnss/gnss", 10.0, 20.0, 10)
    assert len(part.t) <= 10
    assert min(part.t) >= 10.0
    with pytest.raises(KeyError):
        viewed.track("/other/gnss", 0.0, 1.0, 10)


def test_a_log_without_gnss_has_no_track(tmp_path: Path) -> None:
    with contextlib.closing(recorder(tmp_path / "a.mcap")) as log:
        write_run(log, 3.0, gnss=False)
    assert ViewedLog(old(tmp_path / "a.mcap")).content().tracks == []


def test_a_log_without_messages(tmp_path: Path) -> None:
    recorder(tmp_path / "a.mcap").close()
    viewed = ViewedLog(old(tmp_path / "a.mcap"))
    content = viewed.content()
    assert (content.state, content.tables, content.tracks, content.end) == (WHOLE, [], [], 0.0)
    assert viewed.findings() is not None


@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_a_truncated_log_shows_its_readable_samples(tmp_path: Path, share: float) -> None:
    write_everything(tmp_path / "a.mcap", N_ROUNDS)
    data = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "b.mcap").write_bytes(data[: int(share * len(data))])
    viewed = ViewedLog(old(tmp_path / "b.mcap"))
    content = viewed.content()
    assert content.state == CUT
    assert "cut off" in content.warnings[0]
    with open_log(tmp_path / "b.mcap") as log:
        expected = log.table(LoadCell, "loadcell")["counts"]
    np.testing.assert_array_equal(viewed.curve("/loadcell/counts:counts", 0.0, 99.0, 4000).value, expected)
    assert any("cut off" in finding.text for finding in viewed.findings() or [])


def test_a_log_with_a_damaged_chunk_shows_the_rest(tmp_path: Path) -> None:
    write_everything(tmp_path / "a.mcap", N_ROUNDS)
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    data[len(data) // 2] ^= 0xFF
    (tmp_path / "a.mcap").write_bytes(data)
    content = ViewedLog(old(tmp_path / "a.mcap")).content()
    assert content.warnings
    assert content.tables


def test_a_growing_log_is_read_on(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    viewed = ViewedLog(path, wait=True)
    assert viewed.content().state == WAITING
    log = recorder(path)
    log._writer.flush()
    assert viewed.content().state == LIVE  # the log has no message yet
    log.event(T0 - 1.0, "mark", "before the first sample")
    log._writer.flush()
    assert viewed.content().state == LIVE
    write_run(log, 2.0)
    content = viewed.content()
    assert content.state == LIVE
    assert content.utc == pytest.approx(T0, abs=1e-6)
    assert viewed.findings() is None
    for begin in (2.0, 4.0, 6.0):
        write_run(log, 2.0, begin)
        assert viewed.content().end == pytest.approx(begin + 2.0, abs=0.2)
    log.event(T0 + 8.0, "warning", "gnss (/dev/gnss): disconnected")
    log.close()
    content = viewed.content()
    assert content.state == WHOLE
    assert content.events[-1].text == "gnss (/dev/gnss): disconnected"
    # What was read in parts is what is read at once.
    at_once = ViewedLog(old(path))
    for signal in ("/ahrs/imu:yaw", "/gnss/gnss:lat", "/esc/1/command:n_cmd"):
        for mine, other in zip(viewed.curve(signal, 0, 9, 4000), at_once.curve(signal, 0, 9, 4000), strict=True):
            np.testing.assert_array_equal(mine, other)


def test_the_next_segment_of_a_recording_is_followed(tmp_path: Path) -> None:
    viewed = ViewedLog(tmp_path / "a.mcap", wait=True)
    with contextlib.closing(recorder(tmp_path / "a.mcap")) as log:
        write_run(log, 2.0)
        assert viewed.content().state == LIVE
    assert viewed.content().state == WHOLE
    with contextlib.closing(recorder(tmp_path / "a.1.mcap")) as log:
        write_run(log, 2.0, 2.0)
        assert viewed.content().state == LIVE
        write_run(log, 2.0, 6.0)
        content = viewed.content()
        assert (content.state, content.end) == (LIVE, pytest.approx(8.0, abs=0.2))
    assert viewed.content().state == WHOLE
    times = viewed.curve("/gnss/gnss:lat", 0.0, 9.0, 4000).t
    assert (times[0], times[-1]) == pytest.approx((0.0, 7.8), abs=0.01)


def test_growing_in_parts_misses_no_sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The samples are those of the whole log before the last look, which reads everything again."""
    path = tmp_path / "a.mcap"
    viewed = ViewedLog(path, wait=True)
    log = recorder(path)
    for k in range(12):
        write_run(log, 0.5, 0.5 * k)
        viewed.content()
    log.event(T0 + 6.0, "mark", "the last message is read when one follows")
    log._writer.flush()
    viewed.content()
    curve = viewed.curve("/ahrs/imu:yaw", 0, 9, 4000)
    raw = open_log(path).table(Ahrs, "ahrs")
    np.testing.assert_array_equal(curve.value[np.isfinite(curve.value)], raw["yaw"])
    log.close()


def test_a_recording_that_stops_without_its_end_is_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.mcap"
    log = recorder(path)
    write_run(log, 2.0)
    viewed = ViewedLog(path)
    assert viewed.content().state == LIVE
    monkeypatch.setattr(viewed_log, "STOPPED_S", 0.0)
    time.sleep(0.01)
    assert viewed.content().state == CUT
    log.close()


def test_a_long_recording_shows_its_latest_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewed_log, "MAX_LIVE_BYTES", 100_000)
    path = tmp_path / "a.mcap"
    viewed, log = ViewedLog(path, wait=True), recorder(path)
    for k in range(40):
        write_run(log, 1.0, float(k))
        content = viewed.content()
        assert sum(table.n_bytes for table in viewed._tables.values()) < 110_000
    assert 5.0 < content.shown_from < 38.0
    curve = viewed.curve("/ahrs/imu:yaw", 0.0, 60.0, 4000)
    assert curve.t[0] >= content.shown_from - 1e-6
    log.close()
    assert viewed.content().shown_from == 0.0  # the complete log is read whole


MAP = """format = "seatrial-import 1"
[time]
column = "t"
origin = "2025-05-01T12:00:00Z"
"""
SIGNALS = """
[[signal]]
name = "psi"
column = "psi"
unit = "rad"
[[signal]]
name = "n_left"
column = "n"
unit = "1"
role = "input"
"""


def imported(tmp_path: Path, head: str = MAP) -> tuple[Path, Path, Path]:
    """Import a table of 60 s at 10 Hz that begins at 178.9 s of its clock. Return the map, the table and the log."""
    rows = "".join(f"{178.9 + k / 10:.1f},{np.sin(k / 50):.6f},{0.1 * (k // 100):.1f}\n" for k in range(600))
    map_path, table = tmp_path / "map.toml", tmp_path / "run.csv"
    map_path.write_text(head + SIGNALS)
    table.write_text("t,psi,n\n" + rows)
    (log,) = import_files(map_path, [table], out_dir=tmp_path)
    return map_path, table, log


@pytest.mark.parametrize("head", [MAP, MAP.replace('origin = "2025-05-01T12:00:00Z"\n', "")], ids=["origin", "none"])
def test_log_tables_of_cut_intervals_import_these_intervals(tmp_path: Path, head: str) -> None:
    map_path, table, log = imported(tmp_path, head)
    viewed = ViewedLog(old(log))
    assert viewed.content().imported
    text = viewed.cut([(5.0, 12.5), (30.0, 41.0)])
    pieces = parse_import_map(map_path.read_text() + text.toml, map_path).pieces
    limits = [t for piece in pieces for t in (piece.t_from, piece.t_to)]
    assert limits == pytest.approx([183.9, 191.4, 208.9, 219.9])
    assert [piece.match for piece in pieces] == ["run", "run"]
    map_path.write_text(map_path.read_text() + text.toml)
    parts = import_files(map_path, [table], out_dir=tmp_path)
    whole = open_log(log).table(Scalar, "psi")
    for part, (begin, end) in zip(parts, [(5.0, 12.5), (30.0, 41.0)], strict=True):
        t = open_log(part).table(Scalar, "psi")["t"] - whole["t"][0]
        assert (t[0], t[-1]) == pytest.approx((begin, end), abs=1e-3)


def ident_vehicle(words: list[str]) -> dict[str, object]:
    """Return the parameters that the parser of `seatrial ident vehicle` makes of a command line."""
    context: click.Context = click.Context(command_line.cli, info_name="seatrial")
    command: click.Command = command_line.cli
    assert words[:3] == ["seatrial", "ident", "vehicle"]
    for name in words[1:3]:
        assert isinstance(command, click.Group)
        found = command.get_command(context, name)
        assert found is not None
        command = found
    return command.make_context("vehicle", words[3:]).params


def test_commands_of_cut_intervals_are_accepted_and_select_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "with space"
    folder.mkdir()
    path = folder / "it's a run.mcap"
    with contextlib.closing(recorder(path)) as log:
        log.write("esc", Frame(Command(1, 0.0), T0 - 2.0, NAN), T0 - 2.0)  # no signal of a rig without thrusters
        write_run(log, 40.0)
    viewed = ViewedLog(old(path))
    intervals = [(3.0, 12.25), (20.5, 33.0)]
    text = viewed.cut(intervals)
    for line, options, (begin, end) in zip(
        text.commands.splitlines(), text.options.splitlines(), intervals, strict=True
    ):
        params = ident_vehicle(shlex.split(line))
        assert (params["logs"], params["t_from"], params["t_to"]) == ((path,), begin, end)
        assert options == f"--from {begin:.3f} --to {end:.3f}"
    assert len({ident_vehicle(shlex.split(line))["out"] for line in text.commands.splitlines()}) == 2
    assert text.toml == ""  # it was recorded


def test_the_page_counts_time_as_a_fit_does(tmp_path: Path) -> None:
    """A fit counts from the first sample of its signals, and so does the page, not from the first event or health."""
    path = tmp_path / "a.mcap"
    with contextlib.closing(recorder(path)) as log:
        log.event(T0 - 3.0, "mark", "before any sample")
        write_run(log, 40.0)
    viewed = ViewedLog(old(path))
    loaded = load_run(path, "estimation", TimeWindow(10.0, 20.0))
    psi = loaded.run.channels["psi"]
    yaw = open_log(path).table(Ahrs, "ahrs")
    zero = float(yaw["t"][np.flatnonzero(yaw["yaw"] == psi.value[100])[0]] - psi.t[100])
    assert viewed.content().utc == pytest.approx(zero, abs=1e-6)
    assert viewed.content().events[0].t == pytest.approx(-3.0, abs=1e-6)


@pytest.mark.parametrize("interval", [(2.0, 2.0), (3.0, 2.0), (-1.0, 2.0), (1.0, 1.0001)])
def test_an_empty_interval_is_refused(tmp_path: Path, interval: tuple[float, float]) -> None:
    write_everything(tmp_path / "a.mcap")
    with pytest.raises(ValueError, match="interval"):
        ViewedLog(tmp_path / "a.mcap").cut([interval])
