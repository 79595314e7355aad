"""A model.toml of one's own model or effects, used from another folder than it was made in."""

from __future__ import annotations

import hashlib
import re
import shutil
import tomllib
from collections.abc import Sequence
from pathlib import Path

import pytest

import seatrial
from daq.errors import SeatrialError
from ident.estimation.model_file import load_model
from tests.ident.models.test_user_code import MAP, OWN, decay
from tests.missions import boat_log, boat_with
from tests.test_how_to import ROOT

Said = pytest.CaptureFixture[str]


def run(*words: object) -> int:
    with pytest.raises(SystemExit) as leaving:
        seatrial.main([str(w) for w in words])
    return int(leaving.value.code or 0)


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the model of the how-to was fitted, by relative paths; elsewhere beside it."""
    top = tmp_path_factory.mktemp("lab")
    folder = top / "work"
    folder.mkdir()
    (top / "elsewhere").mkdir()
    shutil.copy(ROOT / "docs/examples/rolling.py", folder)
    (folder / "map.toml").write_text(MAP)
    decay(folder / "decay.csv", 1)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert run("import", "csv", "map.toml", "decay.csv", "-o", "decay.mcap") == 0
        assert run("ident", "vehicle", "decay.mcap", "--model", "rolling.py:rolling", "--out", "out") == 0
    return folder


def copied(work: Path, to: Path) -> Path:
    """The folder of the fit where the test may spoil it."""
    shutil.copytree(work.parent, to / "lab")
    return to / "lab"


def test_it_is_used_from_another_folder(work: Path, monkeypatch: pytest.MonkeyPatch, capsys: Said) -> None:
    monkeypatch.chdir(work.parent / "elsewhere")
    assert run("ident", "export", "../work/out/model.toml", "--to", "python", "-o", "rolling_model.py") == 0
    assert "def step(x, u, dt, p=P)" in Path("rolling_model.py").read_text(encoding="utf-8")
    assert capsys.readouterr().err == ""
    table = tomllib.loads((work / "out/model.toml").read_text(encoding="utf-8"))
    assert table["source"] == "../rolling.py:rolling"
    assert table["source_sha256"] == hashlib.sha256((work / "rolling.py").read_bytes()).hexdigest()[:16]


def test_it_moves_with_its_file_and_says_when_that_has_changed(
    work: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Said
) -> None:
    lab = copied(work, tmp_path)
    monkeypatch.chdir(tmp_path)
    assert load_model(Path("lab/work/out/model.toml")).model.source == "lab/work/rolling.py:rolling"
    assert capsys.readouterr().err == ""
    file = lab / "work/rolling.py"
    file.write_text(file.read_text().replace("abs(x.p) * x.p", "abs(x.p)**3"), encoding="utf-8")
    load_model(Path("lab/work/out/model.toml"))
    assert capsys.readouterr().err == ("seatrial: lab/work/rolling.py has changed since lab/work/out/model.toml was "
                                       "written; fit again where that matters\n")
    file.unlink()
    with pytest.raises(SeatrialError) as caught:
        load_model(Path("lab/work/out/model.toml"))
    assert str(caught.value) == ("lab/work/out/model.toml: lab/work/rolling.py: no such Python file; the model was "
                                 "made with it, so put it there")


@pytest.mark.parametrize("here", ["work", "work/out", "elsewhere"])
def test_a_file_of_before_is_still_found(
    work: Path, tmp_path: Path, here: str, monkeypatch: pytest.MonkeyPatch, capsys: Said
) -> None:
    """Which names the Python file as it was typed, without a hash."""
    lab = copied(work, tmp_path)
    path = lab / "work/out/model.toml"
    text = re.sub(r"(?m)^source_sha256.*\n", "", path.read_text(encoding="utf-8"))
    path.write_text(text.replace("../rolling.py", "rolling.py"), encoding="utf-8")
    monkeypatch.chdir(lab / here)
    assert load_model(path).model.name == "rolling"
    assert capsys.readouterr().err == ""


def test_effects_of_ones_own_are_found_from_anywhere_and_stay_with_the_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Said
) -> None:
    """Also by a diagnosis that is told of no file, after one that was."""
    def diagnosed(model: str, out: str, more: Sequence[str] = ()) -> dict[str, object]:
        words = ("ident", "diagnose", model, "a.mcap", "--validate", "b.mcap", "--max-effects", 1, "--out", out)
        assert run(*words, *more) == 0
        return tomllib.loads(Path(out, "model.toml").read_text(encoding="utf-8"))

    monkeypatch.chdir(tmp_path)
    boat = boat_with(None, 3)
    for k, name in enumerate("ab"):
        boat_log(Path(f"{name}.mcap"), boat, 60.0, 7 + k, k)
    Path("mine").mkdir()
    Path("mine/own.py").write_text(OWN)
    assert run("ident", "vehicle", "a.mcap", "--out", "vehicle") == 0
    first = diagnosed("vehicle/model.toml", "one/diagnosis", ["--effects", "mine/own.py"])
    assert first["effects_file"] == "../../mine/own.py"
    again = diagnosed("one/diagnosis/model.toml", "two")
    assert again["effects_file"] == "../mine/own.py"
    assert again["effects_sha256"] == first["effects_sha256"]
    monkeypatch.chdir("/")
    assert load_model(tmp_path / "two/model.toml").effects_file == tmp_path / "mine/own.py"
