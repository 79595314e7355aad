"""Tests of `seatrial recover` and `info` on logs of several segments, on folders and on complete logs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from mcap.reader import make_reader

from seatrial.daq import cli
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log.reader import open_log
from seatrial.daq.log.recorder import Recorder
from seatrial.daq.rig import Segments
from seatrial.daq.samples import Ahrs, Frame
from tests.daq.logs import T0, StoppedClock, rig, tables, write_everything


@pytest.fixture
def killed_set(tmp_path: Path) -> Path:
    """Record a run of 35 s in segments of 10 s, killed in the fourth. Return the first segment."""
    path = tmp_path / "logs/run.mcap"
    log = Recorder(path, rig=replace(rig(), segments=Segments(seconds=10.0)), clock=StoppedClock())
    for k in range(350):
        t = T0 + 0.1 * k
        log.write("ahrs", Frame(Ahrs(0.001 * k, 0.0, 0.0), t, float(k)), t)
        log.tick()
        if k % 20 == 0:
            log._writer.flush()
    log.close()
    last = path.with_name("run.3.mcap")
    last.write_bytes(last.read_bytes()[: last.stat().st_size // 2])
    return path


def run(command: str, *words: object) -> Result:
    return CliRunner().invoke(getattr(cli, command), list(map(str, words)), catch_exceptions=False)


def test_all_segments_of_a_killed_run_are_joined_to_one_complete_file(killed_set: Path) -> None:
    with open_log(killed_set) as log:
        yaw = log.table(Ahrs, "ahrs")["yaw"]
    assert 300 < len(yaw) < 350
    done = run("recover", killed_set)
    out = killed_set.with_name("run-recovered.mcap")
    assert f"{out}: {2 * len(yaw)} messages of 4 segments\n" == done.stdout
    assert "run.mcap: run.3.mcap: the recording was cut off" in done.stderr
    with out.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 2 * len(yaw)
    with open_log(out) as log:
        assert (log.complete, log.warnings) == (True, [])
        np.testing.assert_array_equal(log.table(Ahrs, "ahrs")["yaw"], yaw)
    with pytest.raises(SeatrialError, match=r"run\.3\.mcap: belongs to the log itself"):
        run("recover", killed_set, "-o", killed_set.with_name("run.3.mcap"), "--force")


def test_recover_reports_a_complete_log_as_undamaged(whole: Path, tmp_path: Path) -> None:
    done = run("recover", whole, "-o", tmp_path / "new/copy.mcap")
    assert done.stdout.endswith("messages; nothing was wrong with it\n")
    assert done.stderr == ""
    with open_log(tmp_path / "new/copy.mcap") as copy, open_log(whole) as log:
        assert repr(tables(copy)) == repr(tables(log))


def test_a_folder_with_a_single_log_is_accepted_as_this_log(killed_set: Path) -> None:
    folder = killed_set.parent
    output = run("info", folder).stdout
    assert output == run("info", killed_set).stdout
    assert "in 4 segments, cut off" in output
    write_everything(folder / "other.mcap")
    done = run("info", folder)
    assert done.exit_code == 2
    assert "is a folder of 2 logs: name one of other.mcap, run.mcap" in done.stderr
    empty = folder / "empty"
    empty.mkdir()
    assert "is a folder without a log (*.mcap) in it" in run("info", empty).stderr
    assert "does not exist" in run("info", folder / "nothing").stderr


def test_info_of_a_later_segment_names_its_first_file(killed_set: Path) -> None:
    output = run("info", killed_set.with_name("run.2.mcap")).stdout
    assert "segment 2 of run.mcap; open that file for the whole log" in output
    killed_set.rename(killed_set.with_name("away.mcap"))
    assert "segment 2" not in run("info", killed_set.with_name("run.2.mcap")).stdout


def test_info_reports_a_log_without_messages(killed_set: Path) -> None:
    data = killed_set.read_bytes()
    alone = killed_set.with_name("beginning.mcap")
    alone.write_bytes(data[: data.index(b"rig.toml") - 40])
    output = run("info", alone).stdout
    assert "no messages" in output
    assert "1970" not in output


def test_a_missing_segment_gives_a_warning(killed_set: Path) -> None:
    killed_set.with_name("run.1.mcap").unlink()
    with open_log(killed_set) as log:
        assert log.warnings[-1].startswith("a segment is missing: run.1.mcap; copy it into the folder of ")


def test_a_lost_first_segment_gives_an_error_that_names_the_other_segments(killed_set: Path) -> None:
    killed_set.write_bytes(b"")
    with pytest.raises(
        SeatrialError, match=r"empty.*open its possible later segments one by one: run\.1\.mcap, run\.2\.mcap, run\.3"
    ):
        run("recover", killed_set)


def test_recovery_and_content_as_json(killed_set: Path) -> None:
    done = run("recover", killed_set, "--json")
    shown = json.loads(done.stdout)
    out = killed_set.with_name("run-recovered.mcap")
    assert (shown["format"], shown["log"], shown["out"]) == ("seatrial-recover 1", str(killed_set), str(out))
    assert shown["files"] > 1
    with open_log(out) as log:
        assert shown["messages"] == sum(log.counts.values())
        content = json.loads(run("info", out, "--json").stdout)
        assert content["format"] == "seatrial-info 1"
        assert (content["complete"], content["messages"]) == (True, shown["messages"])
        assert {row["topic"]: row["messages"] for row in content["topics"]} == log.counts
        assert content["start"] == log.start
        assert [event["kind"] for event in content["events"]] == [kind for _, kind, _ in log.events()]
