"""Tests that run the tutorials as written: quick commands in every run of the suite, all commands in `make study`."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.test_docs import blocks

ROOT = Path(__file__).resolve().parents[1]
TUTORIALS = ROOT / "docs/tutorials"
QUICK = ("cp ", "sed ", "seatrial mission generate", "seatrial mission show")


def lines(title: str) -> list[str]:
    """Return every command line of a tutorial, in order."""
    return lines_of(blocks(TUTORIALS / f"{title}.md", "sh"))


def lines_of(found: list[str]) -> list[str]:
    return [line for line in "".join(found).replace("\\\n", " ").splitlines() if line]


@pytest.fixture
def environment() -> dict[str, str]:
    """Return the reader's shell environment, in which `seatrial` and `python` are those of this environment."""
    home = Path(sys.executable).parent
    return os.environ | {"PATH": f"{home}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}


def run(line: str, folder: Path, environment: dict[str, str]) -> str:
    """Run one line in a shell, and return its output."""
    done = subprocess.run(
        ["sh", "-c", line], cwd=folder, env=environment, capture_output=True, text=True, timeout=900, check=False
    )
    assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
    return done.stdout


@pytest.mark.parametrize("title", ["bench-run", "mission"])
def test_the_quick_commands_run(title: str, tmp_path: Path, environment: dict[str, str]) -> None:
    quick = [line for line in lines(title) if line.startswith(QUICK)]
    assert quick
    for line in quick:
        run(line, tmp_path, environment)
    rigs = list(tmp_path.glob("*.toml"))
    assert any("speed = 4.0" in rig.read_text(encoding="utf-8") for rig in rigs), "the sed of the tutorial does nothing"


def test_the_first_hour_makes_a_rig(tmp_path: Path, environment: dict[str, str]) -> None:
    (init,) = (line for line in lines("first-hour") if line.startswith("seatrial init"))
    run(init, tmp_path, environment)
    assert (tmp_path / "simulated/CHECKLIST.md").is_file()
    mock_line = next(line for line in lines("first-hour") if "seatrial mock" in line).partition("&& ")[2]
    with mock(mock_line, tmp_path / "simulated", environment):
        for line in lines("first-hour"):
            if line.startswith(("seatrial check", "seatrial log", "seatrial info")):
                run(line.replace("--duration 60", "--duration 2"), tmp_path / "simulated", environment)


@contextmanager
def mock(line: str, folder: Path, environment: dict[str, str]) -> Iterator[None]:
    """Run the mock in the tutorial's second terminal, from its message `ready` to its Ctrl-C."""
    words = line.split()
    with subprocess.Popen(words, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "ready\n"
            yield
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(30)


def follow(every: list[str], folder: Path, environment: dict[str, str]) -> str:
    """Run every line, with one mock after the other in the background, and return the output."""
    starts = [k for k, line in enumerate(every) if line.startswith("seatrial mock ")]
    printed = [run(line, folder, environment) for line in every[: starts[0]]]
    for start, end in zip(starts, [*starts[1:], len(every)], strict=True):
        with mock(every[start], folder, environment):
            printed += [run(line, folder, environment) for line in every[start + 1 : end]]
    return " ".join("".join(printed).split())


@pytest.mark.study
@pytest.mark.timeout(1800)
def test_the_tutorials_give_the_results_that_they_show(tmp_path: Path, environment: dict[str, str]) -> None:
    """All tutorials use one folder, as for the reader: the mission uses the thrust curve of the bench run."""
    printed = follow(lines("bench-run"), tmp_path, environment)
    assert re.search(r"The thruster gives \d\d\.\d+ ± 0\.\d+ N forward and \d\d\.\d+ ± 0\.\d+ N in reverse", printed)
    truth = json.loads((tmp_path / "truth.json").read_text(encoding="utf-8"))["true_parameters"]
    fitted = json.loads((tmp_path / "thruster/result.json").read_text(encoding="utf-8"))
    values = {row["name"]: row["value"] for row in fitted["fit"]["parameters"]}
    assert abs(values["c1"] - truth["c1"]) < 0.5
    assert abs(values["a"] - truth["pole"]) < 0.3
    assert 0.0 < values["tau"] - truth["delay"] < 0.04  # the ports are still opening, at a quarter of the speed
    printed = follow(lines("mission"), tmp_path, environment)
    assert "The model lacks a GNSS antenna lever arm" in printed
    truth = json.loads((tmp_path / "truth.json").read_text(encoding="utf-8"))
    assert truth["effect"] == "lever-arm"


@pytest.mark.study
@pytest.mark.timeout(1800)
def test_the_commands_of_the_readme_lead_to_a_report(tmp_path: Path, environment: dict[str, str]) -> None:
    """The commands run at a speed that a busy machine can follow."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    _, _, section = text.partition("## The whole way, on mocks")
    page = tmp_path / "way.md"
    page.write_text(section.partition("## The same on hardware")[0], encoding="utf-8")
    copy, *others = lines_of(blocks(page, "sh"))
    slower = "sed -i.bak 's/^speed = 20.0/speed = 5.0/' boat.toml bench.toml"
    assert len(others) < 13
    printed = follow([copy, slower, *others], tmp_path, environment)
    truth = json.loads((tmp_path / "truth.json").read_text(encoding="utf-8"))
    assert truth["effect"] == "wind"
    assert "The model lacks steady wind" in printed
    assert (tmp_path / "diagnosis/report.html").is_file()
    fitted = json.loads((tmp_path / "diagnosis/result.json").read_text(encoding="utf-8"))["fit"]
    rows, true = {row["name"]: row for row in fitted["parameters"]}, truth["true_parameters"]
    assert fitted["scale"]["thrust"] == "measured"
    for name in ("m_u", "m_v", "m_r"):
        assert abs(rows[name]["value"] - true[name]) < 3 * rows[name]["se"], name


@pytest.mark.study
@pytest.mark.timeout(1800)
def test_the_tutorial_over_mavlink_leads_to_the_model_of_the_boat(tmp_path: Path, environment: dict[str, str]) -> None:
    """The boat has an autopilot whose ESCs report unsigned speeds. The thrust is unknown, so masses are ratios."""
    page = blocks(ROOT / "docs/how-to/mavlink.md", "sh")
    follow(lines_of([block for block in page if "seatrial import" not in block]), tmp_path, environment)
    truth = json.loads((tmp_path / "truth.json").read_text(encoding="utf-8"))["true_parameters"]
    fitted = json.loads((tmp_path / "vehicle/result.json").read_text(encoding="utf-8"))
    values = {row["name"]: row["value"] for row in fitted["fit"]["parameters"]}
    for name in ("m_u", "m_v", "d_v"):
        assert values[f"{name}/T"] == pytest.approx(truth[name] / (truth["c1"] + truth["c2"]), rel=0.1), name
