"""Tests that run the worked example of docs/how-to/use-a-model.md and compare its output."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from seatrial.daq.tools.ros_frames import pose_messages
from seatrial.ident.cli.commands import ident
from tests.ident.exported import KNOWN_SCALE
from tests.test_docs import ROOT, blocks, how_to

# The models of the pages have neither the thrust nor the arms, so an export warns about their scale.
pytestmark = [pytest.mark.pages, pytest.mark.filterwarnings("ignore:the scale of the model was not given")]

PAGE = how_to("use-a-model")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Create the model of docs/formats/model.md and the files that the first block of the page writes."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "diagnosis").mkdir()
    model = blocks(ROOT / "docs/formats/model.md", "toml")[0]
    (tmp_path / "diagnosis/model.toml").write_text(model, encoding="utf-8")
    export_files(0, 4)
    return tmp_path


@pytest.fixture
def command_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Create the model of commands of the page, and the files that its export writes."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "command").mkdir()
    (tmp_path / "command/model.toml").write_text(blocks(PAGE, "toml")[0], encoding="utf-8")
    export_files(3, 3)
    return tmp_path


def export_files(block: int, n: int) -> None:
    """Run the n export commands of a block of the page."""
    lines = blocks(PAGE, "sh")[block].splitlines()
    assert len(lines) == n
    for line in lines:
        words = shlex.split(line)
        assert words[:2] == ["seatrial", "ident"]
        CliRunner().invoke(ident, words[2:], catch_exceptions=False)


def after(code: str) -> str:
    """Return the text block after a code block: the output that the page promises."""
    text = PAGE.read_text(encoding="utf-8")
    found = re.search(r"^```text\n(.*?)^```$", text[text.index(code) :], re.MULTILINE | re.DOTALL)
    assert found
    return found[1]


def run(code: str, folder: Path) -> str:
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH")])),
    }
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=environment, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_simulation_snippet(folder: Path) -> None:
    code = blocks(PAGE, "python")[0]
    assert run(code, folder) == after(code)


def test_controller_snippet(folder: Path) -> None:
    (line,) = blocks(PAGE, "sh")[1].splitlines()
    assert line == "python boat_casadi.py ."
    subprocess.run([sys.executable, "boat_casadi.py", "."], cwd=folder, check=True)
    assert sorted(p.name for p in folder.glob("*.casadi")) == ["boat_f.casadi", "boat_h.casadi", "boat_step.casadi"]
    code = blocks(PAGE, "python")[1]
    assert run(code, folder) == after(code)


def compiled(code: str, block: int, folder: Path) -> str:
    """Compile a C program with the commands of a block of the page, run it, and return its output."""
    if not shutil.which("cc"):
        pytest.skip("no C compiler (cc) on PATH")
    build, start = blocks(PAGE, "sh")[block].splitlines()
    words = shlex.split(build)
    (folder / next(w for w in words if w.endswith(".c"))).write_text(code, encoding="utf-8")
    subprocess.run(words, cwd=folder, check=True)
    return subprocess.run([folder / start], capture_output=True, text=True, check=True).stdout


def test_c_program(folder: Path) -> None:
    code = blocks(PAGE, "c")[0]
    assert compiled(code, 2, folder) == after(code)


@pytest.mark.parametrize("block", [2, 3], ids=["simulation", "controller"])
def test_snippets_with_a_model_of_commands(block: int, command_folder: Path) -> None:
    code = blocks(PAGE, "python")[block]
    assert run(code, command_folder) == after(code)


def test_c_program_with_a_model_of_commands(command_folder: Path) -> None:
    code = blocks(PAGE, "c")[1]
    assert compiled(code, 4, command_folder) == after(code)


@pytest.fixture
def joined_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Create the models of docs/how-to/control.md as the files that the sections on joined models and FMUs name."""
    if not shutil.which("cc"):
        pytest.skip("no C compiler (cc) on PATH")
    monkeypatch.chdir(tmp_path)
    boat, _, thruster = blocks(how_to("control"), "toml")
    for name, text in (("boat", boat), *((n, thruster) for n in ("thruster", "t1", "t2"))):
        (tmp_path / name).mkdir()
        (tmp_path / name / "model.toml").write_text(text, encoding="utf-8")
    for block, n in ((5, 2), (6, 1), (7, 2)):
        export_files(block, n)
    return tmp_path


@pytest.mark.filterwarnings("ignore:the inertias in roll and pitch")  # of the blocks for Gazebo and VRX
def test_fmu_snippet(joined_folder: Path) -> None:
    code = blocks(PAGE, "python")[4]
    assert run(code, joined_folder) == after(code)
    assert {"plant.py", "two.fmu", "boat.sdf", "boat_vrx.sdf"} < {p.name for p in joined_folder.iterdir()}


def test_axes_of_ros(folder: Path) -> None:
    """The state equals that of the pose which the export of logs to ROS writes, at any heading."""
    code = blocks(PAGE, "python")[5]
    assert run(code, folder) == after(code)
    space: dict[str, Any] = {}
    functions = code[: code.index("# East of the origin")].replace("import boat\n", "")
    exec(compile(functions, "use-a-model.md", "exec"), space)
    types = defaultdict(lambda: SimpleNamespace)
    state = {"x": 3.0, "y": 12.0, "u": 0.8, "v": -0.05, "r": 0.1}
    for psi in np.linspace(-3.0, 3.0, 13):
        position = np.array([state["x"], state["y"], 0.0])
        twist = np.array([state["u"], state["v"], 0.0, 0.0, 0.0, state["r"]])
        angles = (float(psi), 0.05, -0.02)
        odometry = next(pose_messages(0.0, position, angles, twist, (np.zeros((6, 6)),) * 2, types)).message
        assert space["state_of"](odometry) == pytest.approx(state | {"psi": psi})
        back, sent = space["velocity_command"](0.8, -0.05, 0.1), odometry.twist.twist
        assert back == pytest.approx(
            {"linear.x": sent.linear.x, "linear.y": sent.linear.y, "angular.z": sent.angular.z}
        )


def test_ros_node_parameters(folder: Path) -> None:
    yaml = pytest.importorskip("ruamel.yaml", reason="no YAML reader here (ruamel.yaml)")
    written = yaml.YAML(typ="safe", pure=True).load((folder / "boat.yaml").read_text(encoding="utf-8"))
    text = PAGE.read_text(encoding="utf-8")
    assert "__node:=boat" in text
    for name in re.findall(r'"((?:parameters|process_noise)\.\w+)"', text):
        part, _, key = name.partition(".")
        assert isinstance(written["boat"]["ros__parameters"][part][key], float)
    model = folder / "diagnosis/model.toml"  # the page on the format shows a boat with a known scale
    model.write_text(model.read_text(encoding="utf-8") + KNOWN_SCALE, encoding="utf-8")
    words = ["export", str(model), "--to", "ros2", "-o", "known.yaml", "--name", "boat"]
    CliRunner().invoke(ident, words, catch_exceptions=False)
    written = yaml.YAML(typ="safe", pure=True).load((folder / "known.yaml").read_text(encoding="utf-8"))
    (shown,) = blocks(ROOT / "docs/formats/export.md", "yaml")
    page = yaml.YAML(typ="safe", pure=True).load(shown)["horizontal"]["ros__parameters"]
    whole = written["boat"]["ros__parameters"]
    for key, value in page.items():
        assert whole[key] == value if not isinstance(value, dict) else value.items() <= whole[key].items(), key
