"""Tests of the distribution: wheel and sdist, their content, and an installation without extras."""

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

from seatrial import command_line

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("daq", "bench", "ident", "mocks")
BESIDE = ("docs", "tests", "benchmarks")
SINGLE = ("pyproject.toml", "MANIFEST.in", "README.md", "LICENSE", "CHANGELOG.md", "Makefile")
LOCKED = ("constraints.txt", "mkdocs.yml", "CONTRIBUTING.md", "SECURITY.md", "CITATION.cff")
DATA = {".typed", ".dbc", ".msg", ".toml", ".css", ".html", ".js", ".j2", ".txt"}
BUILD = """
import sys
from setuptools import build_meta
print(getattr(build_meta, "build_" + sys.argv[1])(sys.argv[2]), file=sys.stderr)
"""


class Built(NamedTuple):
    """Paths of the two files that `make dist` makes."""

    wheel: Path
    sdist: Path


def python(words: Sequence[str], cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run this Python. If the run fails, fail with its output."""
    done = subprocess.run(
        [sys.executable, *words], cwd=cwd, env=os.environ | environment, capture_output=True, text=True, timeout=250
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    """Build the sdist from a copy of the tree, and the wheel from the unpacked sdist, as an index would."""
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
        # Python 3.11 has the filter only from 3.11.4 on, and the archive is our own
        safe: dict[str, Any] = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}
        archive.extractall(folder / "unpacked", **safe)
    (source,) = (folder / "unpacked").iterdir()
    python(["-c", BUILD, "wheel", str(folder)], source)
    (wheel,) = folder.glob("*.whl")
    return Built(wheel, sdist)


def wanted() -> set[str]:
    """Return every file that has to be in the distribution, by its place in the package."""
    parts = {path.relative_to(ROOT) for part in PARTS for path in (ROOT / part).rglob("*") if path.is_file()}
    return {
        f"seatrial/{path.as_posix()}"
        for path in parts
        if "__pycache__" not in path.parts and (path.suffix in DATA | {".py", ".pyi"} or path.name == "py.typed")
    } | {
        path.relative_to(ROOT).as_posix()
        for pattern in ("*.py", "*.pyi", "api/*.py")
        for path in (ROOT / "seatrial").glob(pattern)
    }


def test_the_wheel_contains_the_parts_only(built: Built) -> None:
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
    """Unpack the wheel into an empty folder."""
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


def extra(name: str) -> set[str]:
    """Return the libraries of an extra. Each is imported by the name it is installed by."""
    table = project()
    return names_of(table["project"]["optional-dependencies"][name])  # type: ignore[index]


def test_the_default_installation_has_no_library_of_an_extra() -> None:
    default = names_of(project()["project"]["dependencies"])  # type: ignore[index]
    assert not default & (extra("ident") | extra("mavlink"))
    assert all(importlib.util.find_spec(name) for name in extra("ident") | extra("mavlink"))


def test_an_error_line_names_the_extra_of_every_library() -> None:
    assert {name: set(modules) for name, modules in command_line.EXTRAS.items()} == {
        name: extra(name) for name in ("ident", "mavlink", "parquet")
    }


def test_the_extra_all_contains_every_extra_except_ray_and_development() -> None:
    """Ray alone would add 240 MB, for a second way to the same cluster."""
    table = project()["project"]["optional-dependencies"]  # type: ignore[index]
    (line,) = table["all"]
    assert line == f"seatrial[{','.join(sorted(set(table) - {'all', 'dev', 'docs', 'ray'}))}]"


# Blocks the libraries in argv[1], imports every module that measures and excites, then runs command lines.
LEAN = """
import importlib, json, pkgutil, sys

blocked = set(json.loads(sys.argv[1]))

class Without:
    # A finder of modules that does not find the blocked ones.

    def __init__(self, finder):
        self.finder = finder

    def find_spec(self, name, path=None, target=None):
        return None if name.partition(".")[0] in blocked else self.finder.find_spec(name, path, target)

sys.meta_path[:] = [Without(finder) for finder in sys.meta_path]
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
AUTOPILOT = """format = "seatrial-rig 1"
name = "rover"
[[device]]
name = "autopilot"
protocol = "mavlink"
port = "udpin:127.0.0.1:14550"
rate_hz = 10.0
"""
MAP = """format = "seatrial-import-csv 1"
[time]
column = "t"
[[signal]]
name = "u"
column = "u"
unit = "m/s"
"""


def test_measuring_and_exciting_work_in_the_default_installation(tmp_path: Path) -> None:
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
        ["check", "autopilot.toml"],
        ["export", "mat", "run.mcap", "--out", "run.mat"],
    ]
    (tmp_path / "autopilot.toml").write_text(AUTOPILOT, encoding="utf-8")
    blocked = extra("ident") | extra("mavlink") | extra("matlab")
    words = ["-W", "ignore", "-c", LEAN, json.dumps(sorted(blocked)), json.dumps(lines)]
    done = python(words, tmp_path, PYTHONPATH=str(ROOT))
    statuses = [line for line in done.stdout.splitlines() if line.startswith("status")]
    assert statuses == ["status 0"] * (len(lines) - 3) + ["status 1"] * 3, done.stdout + done.stderr
    assert re.search(
        r"needs the Python module \w+, which is not installed: pip install 'seatrial\[ident\]'", done.stderr
    )
    assert "protocol: mavlink needs the Python module pymavlink: pip install 'seatrial[mavlink]'" in done.stderr
    assert "MATLAB files need the package scipy: pip install 'seatrial[matlab]'" in done.stderr
    assert "Traceback" not in done.stderr


class Environment:
    """Virtual environment that contains only pip."""

    def __init__(self, folder: Path) -> None:
        venv.create(folder, with_pip=True)
        self.bin = folder / "bin"
        lock = (ROOT / "constraints.txt").read_text(encoding="utf-8")
        versions = [line.removesuffix("\\").strip() for line in lock.splitlines() if re.match(r"\w", line)]
        self.versions = folder / "versions.txt"
        self.versions.write_text("\n".join(versions) + "\n", encoding="utf-8")

    def pip(self, *words: str) -> None:
        """Run `pip install` with the locked versions. Skip the test if there is no network."""
        options = ["--quiet", "install", "-c", str(self.versions)]
        done = subprocess.run([str(self.bin / "pip"), *options, *words], capture_output=True, text=True, check=False)
        if re.search("connection broken|name resolution|unreachable", done.stderr):
            pytest.skip("pip has no network here")
        assert done.returncode == 0, done.stderr

    def pip_uninstall(self, name: str) -> None:
        """Uninstall a package."""
        subprocess.run([str(self.bin / "pip"), "--quiet", "uninstall", "--yes", name], check=True)

    @property
    def packages(self) -> Path:
        """Return the folder with the installed packages."""
        (folder,) = (self.bin.parent / "lib").glob("python3*/site-packages")
        return folder

    def seatrial(self, cwd: Path, *words: str) -> subprocess.CompletedProcess[str]:
        """Run the command as a user does, in a folder outside the project."""
        command = [str(self.bin / "seatrial"), *words]
        return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=1500, check=False)


@pytest.mark.study
@pytest.mark.timeout(1800)
def test_the_wheel_in_an_empty_environment_runs_the_demo(built: Built, tmp_path: Path) -> None:
    environment = Environment(tmp_path / "environment")
    environment.pip(f"{built.wheel}[ident]")
    ran = environment.seatrial(tmp_path, "demo", "--seed", "1", "--speed", "8", "--out", "demo")
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert (tmp_path / "demo/diagnosis/report.html").is_file()
    assert "ground truth: the plant's hidden effect was lever-arm" in ran.stdout.splitlines()[-1]


@pytest.mark.study
@pytest.mark.timeout(900)
def test_the_default_installation_runs_the_commands_of_the_docs(built: Built, tmp_path: Path) -> None:
    environment = Environment(tmp_path / "environment")
    environment.pip(str(built.wheel))
    assert environment.seatrial(tmp_path, "mission", "generate", "--seed", "1", "-o", "m.toml").returncode == 0
    shutil.copy(ROOT / "mocks/rigs/boat.toml", tmp_path)
    checked = environment.seatrial(tmp_path, "check", "boat.toml", "--seconds", "0.5")
    assert checked.returncode == 1  # no boat is connected
    faults = [line.split()[:2] for line in checked.stdout.splitlines() if line.startswith("fault")]
    assert faults == [["fault", device] for device in ("ahrs", "gnss", "esc")]
    refused = environment.seatrial(tmp_path, "mission", "design", "horizontal:shaft", "--out", "designed.toml")
    assert refused.returncode == 1
    assert "which is not installed: pip install 'seatrial[ident]'" in refused.stderr


@pytest.mark.study
@pytest.mark.timeout(300)
def test_nothing_is_lost_beside_a_package_with_a_folder_of_the_same_name(built: Built, tmp_path: Path) -> None:
    """Install seatrial over frappe-bench, which has a top-level package `bench`, and uninstall each of them."""
    environment = Environment(tmp_path / "environment")

    def files_of_frappe_bench() -> dict[str, bytes]:
        return contents(environment.packages, "bench", "frappe_bench-*.dist-info")

    environment.pip("--no-deps", "--no-compile", "frappe-bench")
    before = files_of_frappe_bench()
    assert "bench/__init__.py" in before

    environment.pip("--no-deps", "--no-compile", str(built.wheel))
    ours = contents(environment.packages, "seatrial")
    assert wanted() - set(ours) == set()
    assert files_of_frappe_bench() == before

    environment.pip_uninstall("seatrial")
    assert files_of_frappe_bench() == before
    assert contents(environment.packages, "seatrial", "seatrial-*.dist-info") == {}

    environment.pip("--no-deps", "--no-compile", str(built.wheel))
    environment.pip_uninstall("frappe-bench")
    assert contents(environment.packages, "seatrial") == ours
    assert files_of_frappe_bench() == {}


def contents(folder: Path, *patterns: str) -> dict[str, bytes]:
    """Return the content of all files below the matching folders, by path; compiled files are left out."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for pattern in patterns
        for place in folder.glob(pattern)
        for path in place.rglob("*")
        if path.is_file() and path.suffix != ".pyc"
    }
