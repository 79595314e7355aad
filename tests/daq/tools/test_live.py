"""Tests of `seatrial log`: the table at 80 and 120 columns, lines in a pipe, and Ctrl-C."""

from __future__ import annotations

import dataclasses
import math
import os
import pty
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from rich.console import Console

from seatrial.daq.acquisition.status import Latest, PortStatus, Status, from_json, to_json
from seatrial.daq.cli import log
from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import NAN, Ahrs, Esc, Gnss, LoadCell
from seatrial.daq.tools.live_table import default_log_path, describe, duration_text, line, log_summary, size_text, table
from tests.daq.ptys import RIG, TestBoat, wait_for

COMMAND = [sys.executable, "-c", "from seatrial.daq.cli import log; log()"]
HEALTHY = PortStatus("ahrs", "vectornav", "/p/ahrs", 100.0, 100.2, 0.004, 5000, 5000, 0, 0, 0, 0, 10**6, 2e-3, 1e-3, "")


def status() -> Status:
    """Return the status of a rig with four devices: one works, one has errors, one is unplugged, one was never
    connected.
    """
    ports = {
        "ahrs": HEALTHY,
        "gnss": dataclasses.replace(
            HEALTHY, name="gnss", expected=20.0, rate=12.0, checksum_errors=3, unparsed_bytes=123, latency=NAN
        ),
        "esc": dataclasses.replace(HEALTHY, name="esc", age=7.3, message="disconnected", reconnects=1),
        "cell": dataclasses.replace(
            HEALTHY, name="cell", rate=NAN, age=math.inf, samples=0, frames=0, message="is not there"
        ),
    }
    latest = {
        ("ahrs", None): Latest(Ahrs(math.pi, 0.1, -0.2, 0.0, 0.0, -0.5), 8.99),
        ("gnss", None): Latest(Gnss(1.0, 41.123456, -8.654321, fix=5, n_sat=17, vel_n=0.3, vel_e=0.4), 8.9),
        ("esc", 2): Latest(Esc(2, -1234.0, 12.0, 0.5, 15.9, NAN), 8.9),
        ("esc", 1): Latest(Esc(1, 1234.0, 12.0, 0.5, 15.9, 31.0), 8.9),
    }
    warnings = ("esc (/p/can): disconnected", "cell (/p/cell): is not there")
    return Status(9.0, ports, latest, {"left": 0.5}, 3, "/logs/run.mcap", 12_345_678, 99, 61.25, "", warnings)


def rendered(width: int) -> list[str]:
    rig = parse_rig(RIG.format(speed=1.0), "rig.toml")
    console = Console(width=width, force_terminal=True, color_system=None, highlight=False)
    with console.capture() as capture:
        console.print(table(status(), rig, width, 9.0))
    return [row.rstrip() for row in capture.get().splitlines()]


def body(rows: list[str]) -> list[str]:
    """Return the rows between the header and the warnings."""
    start = next(i for i, row in enumerate(rows) if row.startswith("device")) + 1
    return rows[start : rows.index("", start)]


def test_the_table_shows_every_device_in_80_columns() -> None:
    rows = rendered(80)
    assert all(len(row) <= 80 for row in rows)
    text = "\n".join(rows)
    assert "1:01.2" in rows[0]
    assert "12.3 MB" in rows[0]
    assert "run.mcap" in rows[0]
    ahrs, gnss, left, right, cell = body(rows)
    assert "yaw 180.0°" in ahrs
    assert "r -28.6°/s" in ahrs
    assert "3chk 123unp" in gnss
    assert "RTK fixed 17 sat" in gnss
    assert "7.3 STALE" in left
    assert "left: 1234 rpm" in left
    assert "right: -1234 rpm" in right
    assert "never" in cell
    assert "is not there" in cell
    # A sign is shown in addition to the colour.
    assert (ahrs[0], left[0], cell[0]) == ("●", "!", "!")
    assert "! esc (/p/can): disconnected" in text


def test_the_table_has_all_counters_in_120_columns() -> None:
    rows = rendered(120)
    assert all(len(row) <= 120 for row in rows)
    header = next(row for row in rows if row.startswith("device"))
    for name in ("rate/Hz", "age/s", "frames", "checksum", "unparsed", "dropped", "reopened", "late/ms"):
        assert name in header
    ahrs, gnss, *_ = body(rows)
    assert ahrs.split()[1:11] == ["ahrs", "100.2", "100", "0.00", "5000", "0", "0", "0", "0", "2.0"]
    assert "RTK fixed 17 sat 0.50 m/s 41.123456 -8" in gnss


def test_plain_lines_and_the_last_line() -> None:
    text = line(status(), parse_rig(RIG.format(speed=1.0), "rig.toml"), 9.0)
    assert "ahrs 100.2/100 Hz, " in text
    assert "gnss 12.0/20 Hz 3 checksum errors 123 unparsed bytes" in text
    assert "cell silent" in text
    assert "disconnected" in text
    assert "\n" not in text
    last = log_summary(status(), Path("run.mcap"))
    silent = "SILENT AT THE END: esc for 7.3 s (disconnected)"
    assert last == f"run.mcap: 1:01.2, 99 samples, 12.3 MB; nothing from cell; {silent}"
    assert "SILENT" not in log_summary(status(), Path("run.mcap"), speed=30.0)


def test_a_full_disk_is_not_shown_as_recording() -> None:
    """An earlier version showed REC although the log was not written."""
    rig, why = parse_rig(RIG.format(speed=1.0), "rig.toml"), "/logs: the disk is full, nothing is written now"
    full = dataclasses.replace(status(), alarm=why)
    console = Console(width=120, force_terminal=True, color_system="truecolor", highlight=False)
    with console.capture() as capture:
        console.print(table(full, rig, 120, 9.0))
    first = capture.get().splitlines()[0]
    assert f"NOT RECORDING: {why}" in first
    assert "REC " not in first.replace("NOT RECORDING", "")
    assert "41m" in first  # on red
    assert " NOT RECORDING: " in line(full, rig, 9.0)
    assert "NOT RECORDING" not in line(status(), rig, 9.0)


def test_values_are_shown_with_units() -> None:
    rig = parse_rig(RIG.format(speed=1.0), "rig.toml")
    assert describe(LoadCell(2000.0, 10.0, 3), rig, "cell") == "10.00 N 2000 counts saturated spike"
    assert describe(LoadCell(2000.0), rig, "cell") == "2000 counts"
    assert describe(Gnss(1.0, NAN, NAN), rig, "gnss").strip() == "no fix"
    assert describe(Esc(9, 10.0), rig, "esc") == "9: 10 rpm"
    assert [duration_text(t) for t in (0.0, 59.99, 60.0, 3599.96, 3661.0)] == [
        "0:00.0",
        "0:59.9",
        "1:00.0",
        "59:59.9",
        "1:01:01",
    ]
    assert [size_text(n) for n in (7, 1500, 2_500_000, 3 * 10**9)] == ["7 B", "1.5 kB", "2.5 MB", "3.00 GB"]


def test_a_status_is_encoded_as_json() -> None:
    before = status()
    after = from_json(to_json(before))
    assert repr(after) == repr(before)


def test_a_new_log_gets_an_unused_name(tmp_path: Path) -> None:
    rig = parse_rig(RIG.format(speed=1.0), tmp_path / "rig.toml")
    path = default_log_path(rig)
    assert path.parent == tmp_path / "logs"
    assert path.name.startswith("test-boat-")
    path.parent.mkdir()
    path.write_text("")
    assert default_log_path(rig) != path


def test_a_log_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(RIG.format(speed=1.0))
    (tmp_path / "run.mcap").write_text("mine")
    result = CliRunner().invoke(log, [str(tmp_path / "rig.toml"), "-o", str(tmp_path / "run.mcap")])
    assert isinstance(result.exception, SeatrialError)
    assert "give another name with -o" in str(result.exception)
    assert (tmp_path / "run.mcap").read_text() == "mine"


@pytest.mark.parametrize("arguments", [["nowhere.toml"], [], ["rig.toml", "--duration", "-1"]])
def test_wrong_usage(tmp_path: Path, arguments: list[str]) -> None:
    (tmp_path / "rig.toml").write_text(RIG.format(speed=1.0))
    words = [str(tmp_path / word) if word.endswith(".toml") else word for word in arguments]
    assert CliRunner().invoke(log, words).exit_code == 2


def test_help_has_an_example() -> None:
    assert "Example: seatrial log" in CliRunner().invoke(log, ["--help"]).output


def test_log_for_a_while_in_a_pipe(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with TestBoat(tmp_path, speed=10.0) as boat:
        words = [str(boat.rig_path), "--duration", "10", "-o", str(path)]
        done = subprocess.run([*COMMAND, *words], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    *lines, last = done.stdout.splitlines()
    assert lines
    assert all("ahrs" in text for text in lines)
    assert last.startswith(f"{path}: 0:1")
    assert "samples" in last
    recorded = open_log(path)
    assert recorded.warnings == []
    assert 9.0 < recorded.duration < 14.0


@pytest.mark.parametrize("terminal", [True, False])
def test_ctrl_c_ends_cleanly_with_one_line(tmp_path: Path, terminal: bool) -> None:
    path = tmp_path / "run.mcap"
    master, slave = pty.openpty()
    out = slave if terminal else subprocess.PIPE
    with TestBoat(tmp_path) as boat:
        process = subprocess.Popen(
            [*COMMAND, str(boat.rig_path), "-o", str(path)],
            stdout=out,
            stderr=subprocess.PIPE,
            start_new_session=True,
            env={**os.environ, "TERM": "xterm-256color", "COLUMNS": "100", "LINES": "40"},
        )
        os.close(slave)
        wait_for(lambda: path.exists() and path.stat().st_size > 20_000, seconds=20.0, what="the log")
        os.killpg(process.pid, signal.SIGINT)  # as a terminal sends it
        screen = b""
        if terminal:
            while (data := read_some(master)) != b"":
                screen += data
        stdout, stderr = process.communicate(timeout=20.0)
        os.close(master)
    text = screen.decode() if terminal else stdout.decode()
    assert (process.returncode, stderr) == (0, b"")
    assert f"{path}: 0:0" in text.replace("\r\n", "")
    assert ("REC" in text) == terminal
    assert open_log(path).warnings == []


def read_some(master: int) -> bytes:
    """Return the output on a terminal, or no more bytes once the program has ended."""
    try:
        return os.read(master, 65536)
    except OSError:
        return b""


def test_a_log_without_samples_is_a_failure(tmp_path: Path) -> None:
    row = '[[device]]\nname = "gnss"\nprotocol = "nmea"\nport = "nowhere"\nrate_hz = 5.0\n'
    (tmp_path / "rig.toml").write_text(f'format = "seatrial-rig 1"\nname = "x"\n{row}')
    words = ["log", str(tmp_path / "rig.toml"), "--duration", "0.5", "-o", str(tmp_path / "run.mcap")]
    done = subprocess.run(
        [sys.executable, "-m", "seatrial", *words], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 1
    assert "no device sent any data" in done.stderr
    open_log(tmp_path / "run.mcap").close()
