"""Tests of a model.toml with user code or user effects that is used from another folder."""

from __future__ import annotations

import hashlib
import importlib.util
import marshal
import re
import shutil
import struct
import tomllib
from collections.abc import Sequence
from pathlib import Path

import pytest

import seatrial as st
from seatrial import command_line
from seatrial.daq.errors import SeatrialError
from seatrial.ident.estimation.model_file import load_model
from seatrial.ident.models.user_code import load_effects, trusting_code
from tests.ident.models.test_user_code import MAP, OWN, decay
from tests.missions import boat_log, boat_with
from tests.test_how_to import ROOT

Said = pytest.CaptureFixture[str]


def run(*words: object) -> int:
    with pytest.raises(SystemExit) as leaving:
        command_line.main([str(w) for w in words])
    return int(leaving.value.code or 0)


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fit the model of the how-to guide by relative paths. Return its folder, which has a sibling folder named
    elsewhere.
    """
    top = tmp_path_factory.mktemp("lab")
    folder = top / "work"
    folder.mkdir()
    (top / "elsewhere").mkdir()
    shutil.copy(ROOT / "docs/examples/rolling.py", folder)
    (folder / "map.toml").write_text(MAP)
    decay(folder / "decay.csv", 1)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert run("import", "map.toml", "decay.csv", "-o", "decay.mcap") == 0
        assert run("ident", "vehicle", "decay.mcap", "--model", "rolling.py:rolling", "--out", "out") == 0
    return folder


def copied(work: Path, to: Path) -> Path:
    """Copy the folder of the fit, so that a test can change it."""
    shutil.copytree(work.parent, to / "lab")
    return to / "lab"


def test_model_with_user_code_is_used_from_another_folder(
    work: Path, monkeypatch: pytest.MonkeyPatch, capsys: Said
) -> None:
    monkeypatch.chdir(work.parent / "elsewhere")
    assert run("ident", "export", "../work/out/model.toml", "--to", "python", "-o", "rolling_model.py") == 0
    assert "def step(x, u, dt, p=P)" in Path("rolling_model.py").read_text(encoding="utf-8")
    assert capsys.readouterr().err == ""
    table = tomllib.loads((work / "out/model.toml").read_text(encoding="utf-8"))
    assert table["source"] == "rolling.py:rolling"
    assert (work / "out/rolling.py").read_bytes() == (work / "rolling.py").read_bytes()
    assert table["source_sha256"] == hashlib.sha256((work / "rolling.py").read_bytes()).hexdigest()[:16]


def test_model_moves_with_its_python_file_and_a_changed_file_is_not_run(
    work: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = copied(work, tmp_path)
    (lab / "work/out").rename(tmp_path / "other")
    monkeypatch.chdir(tmp_path)
    assert load_model(Path("other/model.toml")).model.source == "other/rolling.py:rolling"
    file = tmp_path / "other/rolling.py"
    file.write_text(file.read_text().replace("abs(x.p) * x.p", "abs(x.p)**3"), encoding="utf-8")
    with pytest.raises(SeatrialError, match=r"has changed since it was written, so it is not run; .*--trust-code"):
        load_model(Path("other/model.toml"))
    with trusting_code():
        load_model(Path("other/model.toml"))
    file.unlink()
    with pytest.raises(SeatrialError) as caught:
        load_model(Path("other/model.toml"))
    assert str(caught.value) == (
        "other/model.toml: other/rolling.py: no such Python file; the model was made with it, so put it there"
    )


def hostile(work: Path, tmp_path: Path, source: str, digest: str | None) -> Path:
    """Write a model.toml in its own folder that names this source."""
    folder = tmp_path / "got"
    folder.mkdir(exist_ok=True)
    text = re.sub(r"(?m)^source(_sha256)? =.*\n", "", (work / "out/model.toml").read_text(encoding="utf-8"))
    named = f'source = "{source}"\n' + (f'source_sha256 = "{digest}"\n' if digest else "")
    (folder / "model.toml").write_text(text.replace("sensors =", named + "sensors =", 1), encoding="utf-8")
    return folder / "model.toml"


@pytest.mark.parametrize(
    ("source", "hashed"),
    [
        ("evil.py:rolling", False),  # The file is beside the model and has no hash, as in older model files.
        ("../evil.py:rolling", True),
        ("{tmp}/evil.py:rolling", True),
        ("link.py:rolling", True),  # A symbolic link in the folder leads to a file outside.
        ("linked/evil.py:rolling", True),
        ("evil.py:x:rolling", True),
        ("evil:rolling", True),
        ("horizontal:shaft:../evil.py", True),
        ("thruster:{tmp}/evil.py:rolling", True),
    ],
)
def test_python_file_of_a_model_is_run_only_if_it_belongs_to_the_model(
    work: Path, tmp_path: Path, source: str, hashed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    evil = f"open({str(tmp_path / 'pwned')!r}, 'w')\n" + (work / "rolling.py").read_text(encoding="utf-8")
    digest = hashlib.sha256(evil.encode()).hexdigest()[:16]
    path = hostile(work, tmp_path, source.format(tmp=tmp_path), digest if hashed else None)
    for place in (tmp_path / "evil.py", tmp_path / "evil.py:x", tmp_path / "evil", tmp_path / "got/evil.py:x"):
        place.write_text(evil, encoding="utf-8")
    if not hashed:
        (tmp_path / "got/evil.py").write_text(evil, encoding="utf-8")
    (tmp_path / "got/link.py").symlink_to(tmp_path / "evil.py")
    (tmp_path / "got/linked").symlink_to(tmp_path)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SeatrialError):
        load_model(path)
    assert run("ident", "export", path, "--to", "python") == 1
    assert not (tmp_path / "pwned").exists()


def test_effects_file_of_a_model_is_run_only_if_it_belongs_to_the_model(work: Path, tmp_path: Path) -> None:
    path = hostile(work, tmp_path, "horizontal:shaft", None)
    (tmp_path / "evil.py").write_text(f"open({str(tmp_path / 'pwned')!r}, 'w')\n", encoding="utf-8")
    digest = hashlib.sha256((tmp_path / "evil.py").read_bytes()).hexdigest()[:16]
    text = path.read_text(encoding="utf-8")
    for named in ("../evil.py", str(tmp_path / "evil.py")):
        more = f'effects_file = "{named}"\neffects_sha256 = "{digest}"\nsensors ='
        path.write_text(text.replace("sensors =", more, 1), encoding="utf-8")
        with pytest.raises(SeatrialError, match="--trust-code"):
            load_model(path)
    assert not (tmp_path / "pwned").exists()


def test_code_of_others_is_run_only_after_the_user_trusted_it(
    work: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Said
) -> None:
    """The author of a folder writes the hash in its model.toml. The list of trusted code of the user decides."""
    shutil.copytree(work / "out", tmp_path / "got")
    monkeypatch.setenv("SEATRIAL_KNOWN_CODE", str(tmp_path / "mine/known"))
    export = ("ident", "export", tmp_path / "got/model.toml", "--to", "python")
    assert run(*export) == 1
    assert "rolling.py was never run by you before, so it is not run; read it" in capsys.readouterr().err
    assert run(*export, "--trust-code") == 0
    assert run(*export) == 0
    (tmp_path / "mine/known").chmod(0o666)  # Other users can write this file.
    assert run(*export) == 1
    (tmp_path / "mine/known").chmod(0o600)
    with (tmp_path / "got/rolling.py").open("a", encoding="utf-8") as file:
        file.write("# another file\n")
    assert run(*export) == 1


def test_bytecode_beside_the_python_file_is_not_run(work: Path, tmp_path: Path) -> None:
    shutil.copytree(work / "out", tmp_path / "got")
    real = tmp_path / "got/rolling.py"
    evil = tmp_path / "evil.py"
    evil.write_text(f"open({str(tmp_path / 'pwned')!r}, 'w')\n", encoding="utf-8")
    cache = Path(importlib.util.cache_from_source(str(real)))
    cache.parent.mkdir()
    code = marshal.dumps(compile(evil.read_bytes(), str(real), "exec"))
    about = real.stat()
    head = importlib.util.MAGIC_NUMBER + struct.pack("<LLL", 0, int(about.st_mtime) & 0xFFFFFFFF, about.st_size)
    cache.write_bytes(head + code)
    assert load_model(tmp_path / "got/model.toml").model.name == "rolling"
    assert not (tmp_path / "pwned").exists()


def test_foreign_code_is_run_with_the_option_trust_code(work: Path, tmp_path: Path, capsys: Said) -> None:
    path = hostile(work, tmp_path, f"{work}/rolling.py:rolling", None)
    assert run("ident", "export", path, "--to", "python") == 1
    assert "--trust-code" in capsys.readouterr().err
    assert run("ident", "export", path, "--to", "python", "--trust-code") == 0
    assert run("ident", "export", path, "--to", "python") == 1  # The option applies to that command only.


def test_fleet_checks_the_model_once_and_its_workers_run_what_the_user_trusted(
    work: Path, tmp_path: Path, capsys: Said
) -> None:
    shutil.copytree(work / "out", tmp_path / "got")
    with (tmp_path / "got/rolling.py").open("a", encoding="utf-8") as file:
        file.write("# changed\n")
    decay(work / "other.csv", 2)
    assert run("import", work / "map.toml", work / "other.csv", "-o", tmp_path / "other.mcap") == 0
    capsys.readouterr()
    fleet = ("ident", "fleet", work / "decay.mcap", tmp_path / "other.mcap", "--model", tmp_path / "got/model.toml")
    words = (*fleet, "--jobs", 2, "--out", tmp_path / "fleet")
    assert run(*words) == 1
    shown = capsys.readouterr()
    assert shown.err.count("rolling.py has changed since it was written, so it is not run") == 1
    assert "2 of 2" not in shown.err + shown.out
    assert not (tmp_path / "fleet").exists()
    assert run(*words, "--trust-code") == 0
    assert "The model was fitted to 2 of 2 logs." in capsys.readouterr().out


def test_user_effects_are_found_from_any_folder_and_stay_with_the_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Said
) -> None:
    """A diagnosis without --effects still finds them if an earlier diagnosis had the option."""

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
    assert run("ident", "vehicle", "a.mcap", "--no-score-tests", "--out", "vehicle") == 0
    first = diagnosed("vehicle/model.toml", "one/diagnosis", ["--effects", "mine/own.py"])
    assert first["effects_file"] == "own.py"
    again = diagnosed("one/diagnosis/model.toml", "two")
    assert again["effects_file"] == "own.py"
    assert again["effects_sha256"] == first["effects_sha256"]
    monkeypatch.chdir("/")
    assert load_model(tmp_path / "two/model.toml").effects_file == tmp_path / "two/own.py"


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")  # signals that the model does not use
def test_a_fit_adds_user_effects_from_a_file_and_keeps_them_with_the_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Said
) -> None:
    """Only a diagnosis took a file of effects. A model of one's own, which a fit took, has no score tests."""
    monkeypatch.chdir(tmp_path)
    boat_log(Path("a.mcap"), boat_with(None, 3), 60.0, 7, 0)
    Path("mine").mkdir()
    Path("mine/own.py").write_text(OWN)
    (name,) = load_effects(Path("mine/own.py"))
    words = ("ident", "vehicle", "a.mcap", "--no-score-tests", "--effects", "mine/own.py", "--effect")
    assert run(*words, "gnss-latency", "--out", "all") == 0
    assert run(*words, name, "--out", "named") == 0
    assert {name, "gnss-latency"} <= {e.name for e in load_model(Path("all/model.toml")).model.effects}
    assert "gnss-latency" not in {e.name for e in load_model(Path("named/model.toml")).model.effects}
    # A fit of the saved model keeps the file, and takes no second one.
    with trusting_code():
        again = st.fit("a.mcap", model="named/model.toml", score_tests=False)
        again.save("again")
    assert load_model(Path("again/model.toml")).effects_file == Path("again/own.py")
    capsys.readouterr()
    assert run("ident", "vehicle", "a.mcap", "--model", "named/model.toml", "--effects", "mine/own.py", "--force") == 1
    assert "named/model.toml has effects of your own already" in capsys.readouterr().err
    in_python = st.fit("a.mcap", effects_file="mine/own.py", score_tests=False)
    assert name in [e.name for e in in_python.fitted.fit.model.effects]
    in_python.save("python")
    assert run("ident", "export", "python/model.toml", "--to", "python", "--out", "plant") == 0
