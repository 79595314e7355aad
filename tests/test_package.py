"""What is installed: wheel and sdist, what is in them, and an installation that only logs and runs."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("daq", "bench", "ident", "mocks")
BESIDE = ("docs", "tests", "benchmarks")
SINGLE = ("pyproject.toml", "MANIFEST.in", "README.md", "LICENSE", "CHANGELOG.md", "Makefile")
LOCKED = ("constraints.txt", "mkdocs.yml")
DATA = {".typed", ".dbc", ".msg", ".toml", ".css", ".js", ".j2"}
BUILD = """
import sys
from setuptools import build_meta
print(getattr(build_meta, "build_" + sys.argv[1])(sys.argv[2]), file=sys.stderr)
"""


class Built(NamedTuple):
    """The two files that `make dist` makes."""

    wheel: Path
    sdist: Path


def python(words: Sequence[str], cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run this Python; what fails shows what it said."""
    done = subprocess.run(
        [sys.executable, *words], cwd=cwd, env=os.environ | environment, capture_output=True, text=True, timeout=250
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    """The sdist of a copy of the tree, and the wheel that is built from the unpacked sdist, as an index would."""
    folder = tmp_path_factory.mktemp("dist")
    tree = folder / "tree"
    leave_out = shutil.ignore_patterns("__pycache__", "*.pyc")
    for name in (*PARTS, *BESIDE, "seatrial"):
        shutil.copytree(ROOT / name, tree / name, ignore=leave_out, symlinks=True)
    for name in (*SINGLE, *LOCKED):
        shutil.copy(ROOT / name, tree / name)
    python(["-W", "error::DeprecationWarning:setuptools", "-c", BUILD, "sdist", str(folder)], tree)
    (sdist,) = folder.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        # Python 3.11 has the filter from 3.11.4 on; the archive is our own
        safe: dict[str, Any] = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}
        archive.extractall(folder / "unpacked", **safe)
    (source,) = (folder / "unpacked").iterdir()
    python(["-c", BUILD, "wheel", str(folder)], source)
    (wheel,) = folder.glob("*.whl")
    return Built(wheel, sdist)


def wanted() -> set[str]:
    """Every file that has to travel, by its place in the one package."""
    parts = {path.relative_to(ROOT) for part in PARTS for path in (ROOT / part).rglob("*") if path.is_file()}
    return {
        f"seatrial/{path.as_posix()}"
        for path in parts
        if "__pycache__" not in path.parts and (path.suffix in DATA | {".py", ".pyi"} or path.name == "py.typed")
    } | {path.relative_to(ROOT).as_posix() for path in (ROOT / "seatrial").glob("*.py")}


def test_the_wheel_holds_the_parts_and_nothing_else(built: Built) -> None:
    assert built.wheel.name.endswith("-py3-none-any.whl")
    with zipfile.ZipFile(built.wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
        (licence,) = [name for name in archive.namelist() if name.endswith("licenses/LICENSE")]
        assert archive.read(licence) == (ROOT / "LICENSE").read_bytes()
    assert wanted() - names == set()
    assert names - wanted() == set()
    assert {name.partition("/")[0] for name in names} == {"seatrial"}


def test_the_sdist_can_be_tested_and_its_pages_built(built: Built) -> None:
    with tarfile.open(built.sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert wanted() - names == set()
    assert {"tests/test_package.py", "docs/index.md", "benchmarks/__main__.py", *SINGLE, *LOCKED} - names == set()


@pytest.fixture(scope="module")
def installed(built: Built) -> Path:
    """The wheel's files in a folder that nothing else is in."""
    folder = built.wheel.with_name("installed")
    with zipfile.ZipFile(built.wheel) as archive:
        archive.extractall(folder)
    return folder


def test_the_wheel_runs_from_any_folder(installed: Path, tmp_path: Path) -> None:
    code = "import sys; from seatrial import command_line as c; print(c.__file__); c.main(sys.argv[1:])"

    def run(*words: str) -> str:
        return python(["-P", "-c", code, *words], tmp_path, PYTHONPATH=str(installed)).stdout

    assert run("--version").splitlines() == [str(installed / "seatrial/command_line.py"), "seatrial 0.2.0"]
    run("mission", "generate", "--seed", "1", "-o", "mission.toml")
    assert "surge steps" in run("mission", "show", "mission.toml")
    assert "--seed" in run("demo", "--help")
    assert "--validate" in run("ident", "diagnose", "--help")


def project() -> dict[str, object]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def names_of(requirements: Sequence[str]) -> set[str]:
    found = {re.match(r"[\w-]+", line) for line in requirements}
    return {match.group() for match in found if match}


def needed_to_explain() -> set[str]:
    """The dependencies that logging and running do without; each is imported by the name it is installed by."""
    table = project()
    whole, core = table["project"]["dependencies"], table["dependency-groups"]["core"]  # type: ignore[index]
    assert set(core) <= set(whole), "the group core repeats lines of the dependencies"
    return names_of(whole) - names_of(core)


def test_the_lean_group_leaves_out_what_only_explains() -> None:
    extra = needed_to_explain()
    assert {"scipy", "casadi", "plotly", "llvmlite"} <= extra
    assert all(importlib.util.find_spec(name) for name in extra)


# Blocks the libraries in argv[1], imports every module of what measures and excites, then runs command lines.
LEAN = """
import importlib, json, pkgutil, sys

blocked = set(json.loads(sys.argv[1]))

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in blocked:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Missing())
from seatrial import command_line

for part in ("daq", "bench", "mocks"):
    for module in pkgutil.walk_packages(importlib.import_module(f"seatrial.{part}").__path__, f"seatrial.{part}."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
for line in json.loads(sys.argv[2]):
    try:
        command_line.main(line)
    except SystemExit as left:
        print("status", left.code, flush=True)
"""
MAP = """format = "seatrial-import-csv 1"
[time]
column = "t"
[[signal]]
name = "u"
column = "u"
unit = "m/s"
"""


def test_measuring_and_exciting_work_without_the_libraries_of_explaining(tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(MAP, encoding="utf-8")
    (tmp_path / "run.csv").write_text("t,u\n" + "".join(f"{k},{0.1 * k}\n" for k in range(9)), encoding="utf-8")
    lines = [
        ["import", "map.toml", "run.csv", "-o", "run.mcap"],
        ["info", "run.mcap"],
        ["export", "csv", "run.mcap", "--out", "tables"],
        ["mission", "generate", "--seed", "1", "-o", "mission.toml"],
        ["mission", "show", "mission.toml"],
        *([*words, "--help"] for words in (["log"], ["check"], ["bench", "all"], ["mission", "run"], ["mock", "boat"])),
        ["ident", "vehicle", "run.mcap", "--out", "vehicle"],
    ]
    words = ["-W", "ignore", "-c", LEAN, json.dumps(sorted(needed_to_explain())), json.dumps(lines)]
    done = python(words, tmp_path, PYTHONPATH=str(ROOT))
    statuses = [line for line in done.stdout.splitlines() if line.startswith("status")]
    assert statuses == ["status 0"] * (len(lines) - 1) + ["status 1"], done.stdout + done.stderr
    assert re.search(r"needs the Python module \w+, which is not installed; a lean installation", done.stderr)
    assert "Traceback" not in done.stderr


class Environment:
    """A virtual environment with nothing in it but pip."""

    def __init__(self, folder: Path) -> None:
        venv.create(folder, with_pip=True)
        self.bin = folder / "bin"
        lock = (ROOT / "constraints.txt").read_text(encoding="utf-8")
        versions = [line.removesuffix("\\").strip() for line in lock.splitlines() if re.match(r"\w", line)]
        self.versions = folder / "versions.txt"
        self.versions.write_text("\n".join(versions) + "\n", encoding="utf-8")

    def pip(self, *words: str) -> None:
        """`pip install`, at the locked versions; skips the test where there is no network."""
        options = ["--quiet", "install", "-c", str(self.versions)]
        done = subprocess.run([str(self.bin / "pip"), *options, *words], capture_output=True, text=True, check=False)
        if re.search("connection broken|name resolution|unreachable", done.stderr):
            pytest.skip("pip has no network here")
        assert done.returncode == 0, done.stderr

    def seatrial(self, cwd: Path, *words: str) -> subprocess.CompletedProcess[str]:
        """Run the command as a user does, in a folder that is not the project's."""
        command = [str(self.bin / "seatrial"), *words]
        return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=1500, check=False)


@pytest.mark.study
@pytest.mark.timeout(1800)
def test_the_wheel_in_an_empty_environment_runs_the_demo(built: Built, tmp_path: Path) -> None:
    environment = Environment(tmp_path / "environment")
    environment.pip(str(built.wheel))
    ran = environment.seatrial(tmp_path, "demo", "--seed", "1", "--speed", "8", "--out", "demo")
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert (tmp_path / "demo/diagnosis/report.html").is_file()
    assert "ground truth: the plant's hidden effect was lever-arm" in ran.stdout.splitlines()[-1]


@pytest.mark.study
@pytest.mark.timeout(900)
def test_the_lean_installation_of_the_docs_runs_what_it_says(built: Built, tmp_path: Path) -> None:
    environment = Environment(tmp_path / "environment")
    (source,) = (built.wheel.parent / "unpacked").iterdir()
    environment.pip("--upgrade", "pip")  # groups are known since 25.1
    environment.pip("--group", f"{source / 'pyproject.toml'}:core")
    environment.pip("--no-deps", str(built.wheel))
    assert environment.seatrial(tmp_path, "mission", "generate", "--seed", "1", "-o", "m.toml").returncode == 0
    shutil.copy(ROOT / "mocks/rigs/boat.toml", tmp_path)
    checked = environment.seatrial(tmp_path, "check", "boat.toml", "--seconds", "0.5")
    assert checked.returncode == 1  # there is no boat
    faults = [line.split()[:2] for line in checked.stdout.splitlines() if line.startswith("fault")]
    assert faults == [["fault", device] for device in ("ahrs", "gnss", "esc")]
    refused = environment.seatrial(tmp_path, "mission", "design", "horizontal:shaft", "--out", "designed.toml")
    assert refused.returncode == 1
    assert "is not installed; a lean installation only logs and runs" in refused.stderr
