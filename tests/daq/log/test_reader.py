"""What a log says of itself, and what the commands make of it; damage is `test_log_damage`."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from daq import cli
from daq.errors import SeatrialError
from daq.log.mcap_reader import RawLog
from daq.log.reader import open_log
from daq.log.segments import note_path
from daq.samples import Ahrs, Command, Esc, Frame, Gnss, LoadCell, PortHealth, Scalar
from tests.daq.logs import HEALTH, N_ROUNDS, T0, recorder, tables


def test_what_a_whole_log_says_of_itself(whole: Path) -> None:
    log = open_log(whole)
    assert (log.complete, log.warnings) == (True, [])
    assert log.sources(Ahrs) == ["ahrs", "imu"]
    assert log.sources(Gnss) == ["gnss"]
    assert log.sources(Esc) == log.sources(Command) == ["esc"]
    assert (log.nodes(Esc, "esc"), log.nodes(Command, "esc")) == ([1, 2], [1])
    assert log.sources(LoadCell) == ["loadcell"]
    assert log.sources(Scalar) == ["surge"]
    assert log.sources(PortHealth) == ["ahrs"]
    assert log.duration == pytest.approx(N_ROUNDS - 1 + 0.7 - 0.001, abs=1e-6)
    assert log.events()[0] == (pytest.approx(T0 + 0.6), "mark", "round 0: Trondheimsfjorden, blåsende")
    assert [health for _, health in log.health("ahrs")] == [HEALTH] * N_ROUNDS
    raw = list(log.raw("ahrs"))
    assert [(direction, len(data)) for _, direction, data in raw] == [("rx", 256), ("tx", 0)] * N_ROUNDS
    assert len(log.sha256) == 64
    assert log.table(Command, "esc")["n_cmd"].tolist() == [-0.5] * N_ROUNDS
    assert log.table(Esc, "esc", node=2)["rpm"].tolist() == [77.0] * N_ROUNDS


def test_asking_for_what_is_not_there(whole: Path) -> None:
    log = open_log(whole)
    with pytest.raises(SeatrialError, match=r"no messages on /gps/gnss; there is: .*/gnss/gnss"):
        log.table(Gnss, "gps")
    with pytest.raises(SeatrialError, match=r"esc has nodes \[1, 2\]: name one"):
        log.table(Esc, "esc")
    with pytest.raises(SeatrialError, match="no messages on /signal/sway"):
        log.unit("sway")


def test_time_never_decreases(tmp_path: Path) -> None:
    log = recorder(tmp_path / "a.mcap")
    for k, t in enumerate((0.0, 0.2, 0.1, 0.3)):
        log.write("surge", Frame(Scalar(k), T0 + 1.0, float("nan")), T0 + t)
    log.close()
    table = open_log(tmp_path / "a.mcap").table(Scalar, "surge")
    np.testing.assert_allclose(table["t"] - T0, [0.0, 0.2, 0.2, 0.3], atol=1e-6)
    assert table["value"].tolist() == [0.0, 1.0, 2.0, 3.0]


def test_salvage_makes_a_whole_file(whole: Path, tmp_path: Path) -> None:
    data = whole.read_bytes()
    killed, out = tmp_path / "killed.mcap", tmp_path / "whole.mcap"
    killed.write_bytes(data[: len(data) * 2 // 3])
    done = CliRunner().invoke(cli.recover, [str(killed), "-o", str(out)], catch_exceptions=False)
    assert done.exit_code == 0
    assert "cut off" in done.stderr
    again, before = open_log(out), open_log(killed)
    assert again.complete
    assert f"{out}: {sum(again.counts.values())} messages" in done.stdout
    assert repr(tables(again)) == repr(tables(before))
    assert (again.metadata, again.attachments) == (before.metadata, before.attachments)
    with pytest.raises(SeatrialError, match="the file exists already"):
        CliRunner().invoke(cli.recover, [str(killed), "-o", str(out)], catch_exceptions=False)
    with pytest.raises(SeatrialError, match="is the log itself, which is not changed"):
        CliRunner().invoke(cli.recover, [str(killed), "-o", str(killed), "--force"], catch_exceptions=False)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["killed.mcap", "whole.mcap"]


def test_info(whole: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(cli.info, [str(whole)], catch_exceptions=False)
    assert done.exit_code == 0
    for text in ("complete", "test rig", "Ada", "/gnss/gnss", "/dev/ttyUSB0", "mission.toml", "round 0: Trondheim"):
        assert text in done.stdout
    killed = tmp_path / "killed.mcap"
    killed.write_bytes(whole.read_bytes()[:-500])
    done = CliRunner().invoke(cli.info, [str(killed)], catch_exceptions=False)
    assert "cut off" in done.stdout
    assert "warning: the recording was cut off" in done.stdout


def test_info_of_many_events_shows_how_the_run_ended(tmp_path: Path) -> None:
    log = recorder(tmp_path / "run.mcap")
    for k in range(60):
        log.event(T0 + k, "segment", f"step {k}")
    log.event(T0 + 60.0, "stop", "force is 61.2 N, limit 60 N")
    log.close()
    out = CliRunner().invoke(cli.info, [str(tmp_path / "run.mcap")], catch_exceptions=False).stdout
    lines = out.splitlines()
    assert "step 0" in out
    assert lines[-1].endswith("stop  force is 61.2 N, limit 60 N")
    (gap,) = [line for line in lines if "left out" in line]
    shown = sum("segment  step" in line for line in lines)
    assert f"... {60 - shown} events left out" in gap


def test_info_says_a_swarm_of_events_in_one_line(tmp_path: Path) -> None:
    log = recorder(tmp_path / "run.mcap")
    for k in range(30):
        log.event(T0 + k, "skipped", f"{k + 1} set-points")
    log.event(T0 + 30.0, "mark", "operator mark 1")
    log.event(T0 + 31.0, "skipped", "7 set-points")
    log.close()
    lines = CliRunner().invoke(cli.info, [str(tmp_path / "run.mcap")], catch_exceptions=False).stdout.splitlines()
    assert [line.split("  ")[-1] for line in lines[-3:]] == [
        "1 set-points (and 29 more until 29.000 s later)",
        "operator mark 1",
        "7 set-points",
    ]


def test_info_counts_one_as_one(tmp_path: Path) -> None:
    log = recorder(tmp_path / "run.mcap", attachments={"note": b"1"})
    log.event(T0, "mark", "alone")
    log.close()
    out = CliRunner().invoke(cli.info, [str(tmp_path / "run.mcap")], catch_exceptions=False).stdout
    assert "1 message\n" in out
    assert "longest gap [s]" in " ".join(out.split())
    assert "note (1 byte)" in out


def test_the_index_is_only_believed_where_it_is_right(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    log = recorder(path)
    for i in range(20):
        log.write("surge", Frame(Scalar(i), T0, float("nan")), T0 + i)
    log.close()
    data = bytearray(path.read_bytes())
    at = RawLog(path)._chunks[0].stop
    assert data[at] == 7  # message index
    for wrong in (1, 2**40, 2**63 + 5):
        struct.pack_into("<Q", data, at + 9 + 6 + 8, wrong)
        path.write_bytes(data)
        assert open_log(path).table(Scalar, "surge")["value"].tolist() == list(range(20))


HOSTILE = "\x1b]0;owned\x07\x1b[2J [/bold] [red]x \u202egnp.exe \x9b31m"


def test_a_log_does_not_write_to_the_terminal(tmp_path: Path) -> None:
    """Escapes and markup of a foreign log are shown as they are spelled."""
    path = tmp_path / "run.mcap"
    log = recorder(path, attachments={HOSTILE: b"1"}, metadata={"operator": HOSTILE, HOSTILE: "x"})
    log.event(T0, HOSTILE, HOSTILE)
    log.write(HOSTILE.replace("/", "") + "[/]", Frame(Scalar(1.0), T0, float("nan")), T0)
    log.health(HOSTILE.replace("/", ""), replace(HEALTH, port=HOSTILE), T0)
    log.close()
    note_path(path).write_text(f"2026-05-01T12:00:00Z watchdog: {HOSTILE}")
    for words in ([str(path)],):
        out = CliRunner().invoke(cli.info, words, catch_exceptions=False).stdout
        assert "owned" in out
        assert not [c for c in out if not (c.isprintable() or c == "\n")]
    with open_log(path) as opened:
        assert not [c for _, kind, text in opened.events() for c in kind + text if not c.isprintable()]
    refused = CliRunner().invoke(cli.replay, [str(path), "--dir", str(tmp_path / "ports")])
    assert refused.exit_code == 1
