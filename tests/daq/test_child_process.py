"""Tests of child processes: they run modules of this program, and no file of the working folder instead."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from seatrial.bench.demo import DemoSteps
from seatrial.daq.acquisition.session import Acquisition
from seatrial.daq.child_process import module_environment
from seatrial.daq.clock import RunClock
from seatrial.daq.config.rig_file import load_rig
from tests.daq.ptys import TestBoat

ROOT = Path(__file__).parents[2]


def plant(folder: Path) -> Path:
    """Put modules named like Python's and our own into a folder. Each writes a file there when it is executed."""
    for name in ("socket", "selectors", "struct", "daq", "numpy", "joblib"):
        (folder / f"{name}.py").write_text("open('executed', 'w').close()\n", encoding="ascii")
    return folder / "executed"


def test_acquisition_and_watchdog_execute_nothing_of_the_working_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    executed = plant(tmp_path)
    monkeypatch.setenv("PYTHONPATH", f"{os.pathsep}.")  # an empty entry also means the working folder
    with TestBoat(tmp_path) as boat:
        monkeypatch.chdir(tmp_path)
        rig = load_rig(boat.rig_path)
        with Acquisition(rig, tmp_path / "run.mcap", clock=RunClock(rig.speed), drive=True) as acquisition:
            acquisition.status()
    assert not executed.exists()


def test_modules_of_the_package_are_no_top_level_names_in_a_child_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In an installation, the folder of `daq` is inside the package seatrial."""
    monkeypatch.setattr(sys.modules["seatrial"], "__path__", [str(tmp_path / "seatrial")])
    assert module_environment()["PYTHONPATH"].split(os.pathsep)[0] == str(tmp_path.resolve())


def test_a_command_of_the_demo_executes_nothing_of_its_folder(tmp_path: Path) -> None:
    executed = plant(tmp_path)
    assert DemoSteps(tmp_path).has("mission", "show")
    assert not executed.exists()


def test_processes_of_a_library_execute_nothing_of_the_working_folder(tmp_path: Path) -> None:
    """joblib starts its own processes, as in a study of recovery, after the command's own start."""
    executed = plant(tmp_path)
    code = """
import contextlib, io, sys
from seatrial import command_line
sys.argv = ["seatrial", "--version"]
with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()):
    command_line.main()
import joblib
print(joblib.Parallel(2)(joblib.delayed(abs)(-k) for k in (1, 2)))
"""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout == "[1, 2]\n"
    assert not executed.exists()
