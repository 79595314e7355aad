"""Tests of child processes: they run modules of this program, and no file of the working folder instead."""

from __future__ import annotations

import os
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from seatrial.bench.demo import DemoSteps
from seatrial.daq.acquisition.session import Acquisition
from seatrial.daq.child_process import module_environment
from seatrial.daq.clock import RunClock
from seatrial.daq.config.rig_file import load_rig
from seatrial.daq.view.live_process import live_page
from tests.daq.logs import write_everything
from tests.daq.ptys import TestBoat, wait_for

ROOT = Path(__file__).parents[2]
PLANTED = ("socket", "selectors", "struct", "serial", "can", "webbrowser", "daq", "numpy", "joblib", "distributed")


def plant(folder: Path) -> Path:
    """Put modules named like Python's and our own into a folder. Each writes a file there when it is executed."""
    for name in PLANTED:
        (folder / f"{name}.py").write_text("open('executed', 'w').close()\n", encoding="ascii")
    return folder / "executed"


def test_acquisition_and_watchdog_do_not_execute_files_of_the_working_folder(
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


def test_the_processes_of_a_page_do_not_execute_files_of_the_working_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The test checks the process that serves the page of a recording, and the process that opens a browser."""
    executed = plant(tmp_path)
    write_everything(tmp_path / "run.mcap", 2)
    browser = tmp_path / "browser"
    browser.write_text(f"#!/bin/sh\necho $1 > {tmp_path}/opened\n", encoding="ascii")
    browser.chmod(0o755)
    monkeypatch.setenv("PYTHONPATH", f"{os.pathsep}.")
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setenv("BROWSER", str(browser))
    monkeypatch.chdir(tmp_path)
    with live_page(tmp_path / "run.mcap") as address:
        opening = f"from seatrial.daq.view.browser import prepare_browser; prepare_browser()({address!r})"
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        subprocess.run([sys.executable, "-P", "-c", opening], env=environment, check=True)
        wait_for((tmp_path / "opened").exists, 20.0, what="the browser")
        with urllib.request.urlopen(address, timeout=20.0) as answer:  # after all imports of the process
            assert answer.status == 200
    assert not executed.exists()


def test_modules_of_the_package_cannot_be_imported_as_top_level_modules(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In an installation, the folder of `daq` is inside the package seatrial."""
    monkeypatch.setattr(sys.modules["seatrial"], "__path__", [str(tmp_path / "seatrial")])
    assert module_environment()["PYTHONPATH"].split(os.pathsep)[0] == str(tmp_path.resolve())


def test_a_command_of_the_demo_does_not_execute_files_of_its_folder(tmp_path: Path) -> None:
    executed = plant(tmp_path)
    assert DemoSteps(tmp_path).has("mission", "show")
    assert not executed.exists()


@pytest.mark.parametrize("backend", ["loky", pytest.param("dask", marks=pytest.mark.slow)])
def test_processes_of_a_library_do_not_execute_files_of_the_working_folder(tmp_path: Path, backend: str) -> None:
    """joblib and Dask start their own processes, as in a study of recovery, after the command's own start."""
    executed = plant(tmp_path)
    code = """
import contextlib, io, sys
from seatrial import command_line
sys.argv = ["seatrial", "--version", *sys.argv[1:]]
with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()):
    command_line.main()
from seatrial.ident.parallel import Workers, run_many
print(sorted(outcome.value for outcome in run_many([-1, -2], abs, Workers(2, sys.argv[-1]))))
"""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-P", "-c", code, backend],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "[1, 2]\n"
    assert not executed.exists()
