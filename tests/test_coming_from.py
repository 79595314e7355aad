"""Tests that run the page for users of other programs, section by section, on files as those programs write them."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import seatrial as st
from seatrial.ident.estimation.model_file import load_model
from tests import foreign_runs
from tests.daq.importers.test_mavlink import tlog
from tests.own_boats import HULL
from tests.page_runner import edited, run_commands, run_python

# two dozen fits
pytestmark = [
    pytest.mark.pages,
    pytest.mark.slow,
    pytest.mark.timeout(900),
    pytest.mark.usefixtures("quick_compilation"),
]

PAGE = Path(__file__).resolve().parents[1] / "docs/how-to/coming-from.md"
MATLAB, CTSM, ROS, PLOTJUGGLER, ARDUPILOT = "MATLAB", "ctsmTMB", "ROS 2", "PlotJuggler", "ArduPilot"
# Commands that need a device, a browser or a user; tests/test_docs.py parses them.
NOT_RUN = (
    "log ",
    "view ",
    "replay ",
    "mission follow",
    "check autopilot.toml",
    "mock ",
    "import --guess`",
    "ident diagnose`",
)
# Score tests of a fit that no assertion needs. The sections on MATLAB and PlotJuggler keep them.
QUICK = {"--out vehicle": "--no-score-tests --out vehicle"}
OU = {"theta": 2.0, "mu": 1.0, "sigma_x": 0.5, "sigma_y": 0.05}


def section(title: str) -> str:
    """Return the text of a section of the page."""
    (found,) = [part for part in PAGE.read_text(encoding="utf-8").split("\n## ") if part.startswith(title)]
    return found


def steps(text: str) -> Iterator[tuple[str, str]]:
    """Return (language, content) of the fenced blocks, and of the commands and Python calls in the tables, in order."""
    fence = r"^```(\w+)\n(.*?)^```$"
    yield from re.findall(fence, text, re.MULTILINE | re.DOTALL)
    for row in [line for line in text.splitlines() if line.startswith("| ")]:
        for code in re.findall(r"`([^`]+)`", row.split(" | ")[1]):
            if code.startswith("seatrial ") and not f"{code}`".startswith(tuple(f"seatrial {c}" for c in NOT_RUN)):
                yield "sh", code
            elif re.match(r"(st|fit)\..*[)\]]$|fit\.\w+$", code):
                yield "python", code


def follow(title: str, space: dict[str, Any], edits: dict[str, str] | None = None) -> int:
    """Run all steps of a section in the current folder and return their number. Blocks with a file name are written.

    ``edits`` replaces parts of the section.
    """
    done = 0
    for language, text in steps(edited(section(title), edits or {})):
        name = re.match(r"# ([\w.]+)\n", text)
        if name:
            Path(name[1]).write_text(text, encoding="utf-8")
        elif language == "sh":
            run_commands(text)
        elif language == "python":
            run_python(text, PAGE.name, space)
        else:
            continue
        done += 1
    return done


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def check_hull(path: Path) -> None:
    """Compare the parameters of a fit with those of the simulated boat."""
    saved = load_model(path)
    for name in ("m_u", "m_v", "d_u", "d_v", "d_uu", "d_vv"):
        error = saved.errors[name]
        assert 0.0 < error < 0.1 * HULL[name], name
        assert abs(saved.model.parameter(name).value - HULL[name]) < 4.0 * error, name


def test_the_section_on_matlab_runs(folder: Path) -> None:
    for k in (1, 2):
        foreign_runs.write_mat(folder / f"run{k}.mat", foreign_runs.run(k))
    assert follow(MATLAB, {}) > 15
    check_hull(folder / "vehicle/model.toml")
    assert (folder / "exported_files/horizontal.fmu").is_file()


def test_the_section_on_ctsm_runs(folder: Path) -> None:
    rng, step, dt = np.random.default_rng(4), 0.01, 0.1
    t = np.arange(0.0, 100.0, step)
    inflow = np.repeat(rng.uniform(-1.0, 1.0, 20), t.size // 20)
    x = np.ones(t.size)
    kicks = OU["sigma_x"] * np.sqrt(step) * rng.normal(size=t.size)
    for k in range(t.size - 1):
        x[k + 1] = x[k] + OU["theta"] * (OU["mu"] + inflow[k] - x[k]) * step + kicks[k]
    rows = slice(None, None, round(dt / step))
    level = x[rows] + OU["sigma_y"] * rng.normal(size=t[rows].size)
    with (folder / "ou.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t", "inflow", "level"])
        writer.writerows(np.column_stack([t[rows], inflow[rows], level]).tolist())
    assert follow(CTSM, {"st": st}) > 8
    for fit in ("ou", "ou-ml"):
        saved = load_model(folder / fit / "model.toml")
        for name, truth in OU.items():
            error = saved.errors[name]
            assert 0.0 < error < 0.3 * truth, name
            assert abs(saved.model.parameter(name).value - truth) < 3.0 * error, name


def test_the_section_on_ros_runs(folder: Path) -> None:
    for k in (1, 2):
        foreign_runs.write_bag(folder / f"bag{k}", foreign_runs.run(k))
    edits = {
        "validate=logs[1])\nprint": "validate=logs[1], score_tests=False)\nprint",
        # the command line replaces the files of the same steps in Python
        "-o map.toml": "--force -o map.toml",
        "--out-dir logs": "--force --out-dir logs",
        "--out vehicle": "--no-score-tests --force --out vehicle",
    }
    assert follow(ROS, {"st": st}, edits) > 8
    check_hull(folder / "vehicle/model.toml")


def test_the_section_on_plotjuggler_runs(folder: Path) -> None:
    for k in (1, 2):
        foreign_runs.write_plotjuggler(folder / f"run{k}.csv", foreign_runs.run(k))
    assert follow(PLOTJUGGLER, {"st": st}) > 5
    check_hull(folder / "vehicle/model.toml")
    assert (folder / "run1-ros/plotjuggler.xml").is_file()


def test_the_section_on_ardupilot_runs(folder: Path) -> None:
    for k in (1, 2):
        foreign_runs.write_dataflash(folder / f"0000000{k}.BIN", foreign_runs.run(k))
    tlog(folder / "flight.tlog")
    foreign_runs.write_stand(folder / "stand.csv")
    edits = QUICK | {"--out diagnosis": "--max-effects 1 --out diagnosis"}
    assert follow(ARDUPILOT, {"st": st}, edits) >= 12
    expo = re.search(r"^MOT_THST_EXPO,([\d.]+)$", (folder / "thruster/ardupilot.param").read_text(), re.MULTILINE)
    assert expo is not None
    assert float(expo[1]) == pytest.approx(1.0, abs=0.02)  # the thrust of this stand is quadratic in the command
    for fit in ("compass", "diagnosis"):
        saved = load_model(folder / fit / "model.toml")
        assert abs(saved.model.parameter("dev_s").value - foreign_runs.DEVIATION) < 3.0 * saved.errors["dev_s"] < 0.01
    check_hull(folder / "diagnosis/model.toml")
