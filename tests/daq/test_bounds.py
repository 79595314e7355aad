"""Tests of commands that read foreign files in a bounded child process: limits, signals, and remaining files."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

COMMAND = """
import os, sys, tempfile, time
from pathlib import Path
import click
from seatrial import command_line
from seatrial.daq import bounds
from seatrial.daq.files import new_file

bounds.MEMORY_BYTES, bounds.CPU_S, bounds.DISK_BYTES, bounds.GRACE_S = 1 << 30, 1.0, 4 << 20, 1
bounds.enable()

command_line.COMMANDS["work"] = command_line.Row("__main__:work", "")

@click.command()
@click.argument("log", type=click.Path(path_type=Path))
@bounds.bounded("log")
def work(log):
    click.echo("began")
    sys.stdout.flush()
    with new_file(Path("out")) as part:
        part.write_text("half")
        {does}
    click.echo("done")

command_line.main(["work", *sys.argv[1:]])
"""
NAMED = "the file is damaged or malicious; if you trust it, --trust-file reads it without limits"
FULL = "while True: Path(tempfile.mkdtemp(), 'x').write_bytes(bytes(1 << 20)); time.sleep(0.01)"


def start(folder: Path, does: str, *words: str) -> subprocess.Popen[str]:
    (folder / "run.mcap").write_bytes(b"x")
    return subprocess.Popen(
        [sys.executable, "-P", "-c", COMMAND.replace("{does}", does), "run.mcap", *words], cwd=folder, text=True,
        env={**os.environ, "TMPDIR": str(folder)}, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("does", "line"),
    [
        ("bytes(2 << 30)", "took more than 1.1 GB of memory"),
        ("while True: pass", "took more than 1 s of processor time"),
        # an operation in C, during which Python does not handle the signal
        ("sum(range(10**12))", "took more than 1 s of processor time"),
        ("part.write_bytes(bytes(8 << 20))", "wrote more than 4 MB to the disk"),
        (FULL, "wrote more than 4 MB to the disk"),
        ("os.kill(os.getpid(), 11)", "the process that read the file was ended by SIGSEGV"),
    ],
)
def test_a_limit_ends_the_command_in_one_line_and_leaves_no_file(tmp_path: Path, does: str, line: str) -> None:
    process = start(tmp_path, does)
    out, err = process.communicate(timeout=60.0)
    assert (process.returncode, out) == (1, "began\n")
    assert err.startswith("seatrial: run.mcap: ")
    assert line in err
    assert NAMED in err
    assert err.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.mcap"]


def test_a_good_file_and_a_trusted_one_are_read(tmp_path: Path) -> None:
    for does, words in (("pass", ()), ("bytes(2 << 30)", ("--trust-file",))):
        process = start(tmp_path, does, *words)
        assert process.communicate(timeout=60.0) == ("began\ndone\n", "")
        assert process.returncode == 0
        assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "run.mcap"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_both_processes(tmp_path: Path, number: signal.Signals) -> None:
    with start(tmp_path, "time.sleep(60)") as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "began\n"
        before = time.monotonic()
        process.send_signal(number)  # sent to the parent alone; its pipes end with the child
        _, err = process.communicate(timeout=30.0)
    assert time.monotonic() - before < 20.0
    assert process.returncode != 0
    assert "Traceback" not in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.mcap"]
