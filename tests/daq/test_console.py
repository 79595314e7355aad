"""Tests of the console: tables in a pipe are never cut, and have the width of COLUMNS if it is set."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console
from rich.table import Table

from seatrial.daq.console import print_table
from seatrial.daq.importers.write_log import SignalRow, write_frames
from seatrial.daq.samples import Esc, Frame

LONG = "a_long_name_of_a_signal_" * 8


def table() -> Table:
    """Return a table like those of results: numbers that do not wrap, and a word that is cut on a terminal."""
    found = Table()
    found.add_column("name", overflow="ellipsis", max_width=20, no_wrap=True)
    found.add_column("value", no_wrap=True)
    found.add_row(LONG, "0.123 ± 0.004")
    return found


def test_a_terminal_cuts_cells_and_a_file_does_not(capsys: pytest.CaptureFixture[str]) -> None:
    print_table(Console(force_terminal=True, width=60), table())
    assert "…" in capsys.readouterr().out
    console = Console(width=60)
    assert not console.is_terminal
    print_table(console, table())
    lines = capsys.readouterr().out.splitlines()
    assert "".join(line.split("│")[1].strip() for line in lines if line.startswith("│")) == LONG
    assert max(map(len, lines)) <= 60


def info(log: Path, columns: str | None) -> str:
    """Return the output of `seatrial info` in a pipe."""
    environment = {k: v for k, v in os.environ.items() if k != "COLUMNS"}
    environment |= {} if columns is None else {"COLUMNS": columns}
    words = [sys.executable, "-m", "seatrial", "info", str(log)]
    return subprocess.run(words, env=environment, capture_output=True, text=True, timeout=60, check=True).stdout


def test_info_in_a_pipe_shows_complete_rows(tmp_path: Path) -> None:
    rows = [SignalRow(1.0 + k, LONG, Frame(Esc(1, 10.0 * k), 1.0 + k, 1.0)) for k in range(5)]
    write_frames(tmp_path / "run.mcap", rows, metadata={}, note="test")
    wide = info(tmp_path / "run.mcap", None)
    assert "…" not in wide
    (row,) = (line for line in wide.splitlines() if f"/{LONG}/1/" in line)
    assert " 5 " in row
    narrow = info(tmp_path / "run.mcap", "70")
    assert "…" not in narrow
    lines = narrow.splitlines()
    start = next(k for k, line in enumerate(lines) if "──" in line)
    body = lines[start + 1 : next(k for k, line in enumerate(lines) if "/event" in line)]
    assert max(map(len, body)) <= 70
    assert "".join(line.split()[0] for line in body) == f"/{LONG}/1/state"
