"""Tests of user effects and models: loaded from files, kept by model.toml, and rejected in one line if wrong."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from seatrial import command_line
from seatrial.daq.errors import SeatrialError
from seatrial.ident.cli.commands import ident
from seatrial.ident.estimation.model_file import load_model
from seatrial.ident.models.catalogue import make_model
from seatrial.ident.models.user_code import check_user_model, load_effects, load_python
from tests.test_how_to import ROOT, blocks

OWN = """
from seatrial.ident.model import Effect
from seatrial.ident.model import Parameter

def pull(s):
    s.X = s.X - s.p.weed * s.x.u

EFFECT = Effect("weed", "weed on the hull", {"force": pull},
                (Parameter("weed", 0.0, "kg/s", "drag of the weed", prior=(0.0, 10.0), step=0.3),), requires=("hull",))
"""


def test_effects_of_a_file_are_found_by_name(tmp_path: Path) -> None:
    file = tmp_path / "own.py"
    file.write_text(OWN)
    assert load_effects(file)["weed"].title == "weed on the hull"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("EFFECT = 3\n", "neither EFFECT nor EFFECTS"),
        ("x = 1\n", "neither EFFECT"),
        ("1 / 0\n", r"own\.py:1: cannot be loaded: division"),
        ("a = 1\nb = (\n", r"own\.py:2: cannot be loaded: '\(' was never closed"),
    ],
)
def test_invalid_python_file_gives_a_one_line_error(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "own.py"
    file.write_text(text)
    with pytest.raises(SeatrialError, match=message) as caught:
        load_effects(file)
    assert "\n" not in str(caught.value)


def test_missing_python_file_gives_a_one_line_error(tmp_path: Path) -> None:
    with pytest.raises(SeatrialError, match="no such Python file"):
        load_python(tmp_path / "nowhere.py")


TANK = """import math
from seatrial.ident.model import Input, Output, Sensor, State, plain_model
from seatrial.ident.model import Parameter

def f(x, u, p):
    RATE

def h(x, u, p):
    return {"gauge": x.level}

tank = plain_model("tank", f=f, h=h, states=(State("level", "m", STATE),), inputs=(Input("pump"),),
                   sensors=(Sensor("gauge", (Output("gauge", "m", "e"),)),),
                   parameters=(Parameter("k", 1.0), Parameter("c", 0.5), Parameter("q", 0.05), Parameter("e", 0.02)))
"""
RATE, STATE = 'return {"level": p.k * u.pump - p.c * x.level}', '"", "q"'


def refusal(folder: Path, text: str) -> str:
    """Return the error message for a tank model, without its folder."""
    file = folder / "tank.py"
    file.write_text(text)
    with pytest.raises(SeatrialError) as caught:
        make_model(f"{file}:tank")
    message = str(caught.value)
    assert "\n" not in message
    return message.removeprefix(f"{folder}/")


@pytest.mark.parametrize(
    ("rate", "message"),
    [
        ('return {"level": p.k * u.pump - p.cc * x.level}', "tank.py:6: no parameter 'cc'; there is k, c, q, e"),
        ('return {"level": p.k * u.pmp}', "tank.py:6: no input 'pmp'; there is pump"),
        ('return {"level": p.k * x.lvl}', "tank.py:6: no state 'lvl'; there is level"),
        ('return {"level": 1.0 if x.level > 0 else 0.0}', "tank.py:6: `if`, `and`, `or`, `max` and"),
        ('return {"level": max(p.k * u.pump, 0.0)}', "tank.py:6: `if`, `and`, `or`, `max` and"),
        ("return [p.k * u.pump]", "tank.py:5: f returns a list, not a dictionary {state: rate}"),
        ("pass", "tank.py:5: f returns a NoneType, not a dictionary {state: rate}"),
        (
            'return {"lvl": p.k}',
            "tank.py:5: model tank returns no rate of the state level; it returns lvl; correct the name, or "
            "add the entry",
        ),
        ('return {"level": [1.0, 2.0]}', "tank.py:5: model tank: the rate of the state level is not a scalar"),
        ('return {"level": "full"}', "tank.py:5: one of the returned rates or outputs is not a number"),
        ('return {"level": math.sin(x.level)}', "tank.py:5: model tank: the rate of the state level is a number and"),
        (
            'return {"level": (1, 2)[x.level]}',
            "tank.py:6: tuple indices must be integers or slices, not SX (the function is called with symbols",
        ),
        ('return {"level": {}["a"]}', "tank.py:6: KeyError: 'a'"),
    ],
)
def test_error_in_a_user_function_is_reported_with_its_line(tmp_path: Path, rate: str, message: str) -> None:
    found = refusal(tmp_path, TANK.replace("RATE", rate).replace("STATE", STATE))
    assert found.startswith(message)


@pytest.mark.parametrize(
    ("state", "message"),
    [
        (
            '"", "q", x0="lv0"',
            "x0 of the state level is 'lv0', which is not a parameter of the model; correct the name, "
            "or define the parameter",
        ),
        (
            '"", "q", sd0="sv0"',
            "sd0 of the state level is 'sv0', which is not a parameter of the model; correct the name, "
            "or define the parameter",
        ),
        (
            '"", "qq"',
            "the noise of level is 'qq', which is not a parameter of the model; correct the name, "
            "or define the parameter",
        ),
        (
            '"", "q", from_output="gage"',
            "from_output of the state level is 'gage', which is not an output of the model; there is gauge",
        ),
    ],
)
def test_misspelt_name_in_a_state_is_reported(tmp_path: Path, state: str, message: str) -> None:
    found = refusal(tmp_path, TANK.replace("RATE", RATE).replace("STATE", state))
    assert found == f"tank.py:11: cannot be loaded: model tank: {message}"


def test_recommended_numpy_functions_work(tmp_path: Path) -> None:
    file = tmp_path / "tank.py"
    for rate in (
        "np.where(x.level > 0, p.k, p.c)",
        "np.maximum(x.level, 0.0)",
        "x.level * (x.level > 0)",
        "np.floor(x.level)",
    ):
        text = TANK.replace("import math", "import numpy as np").replace("STATE", STATE)
        file.write_text(text.replace("RATE", f'return {{"level": {rate}}}'))
        assert make_model(f"{file}:tank").name == "tank"


def test_error_in_a_user_effect_is_reported_with_its_line(tmp_path: Path) -> None:
    file = tmp_path / "own.py"
    file.write_text(OWN.replace("s.p.weed *", "s.p.wed *"))
    (effect,) = load_effects(file).values()
    with pytest.raises(SeatrialError, match=r"own\.py:6: no parameter 'wed'; there is m_u"):
        check_user_model(make_model("horizontal:shaft") + effect, file)


MAP = """format = "seatrial-import-csv 1"
[time]
column = "t"
[[signal]]
name = "phi"
column = "phi"
unit = "rad"
role = "output"
"""


def decay(path: Path, seed: int) -> dict[str, float]:
    """Write a noisy roll decay from its equation as CSV. Return its true parameters."""
    truth, step = {"k": 14.0, "d": 0.25, "dd": 0.4}, 1e-3
    phi, p, rows = 0.5, 0.0, []
    rng = np.random.default_rng(seed)
    for i in range(15000):
        if i % 50 == 0:
            rows.append((i * step, phi + 0.003 * rng.normal()))
        p += step * (-truth["k"] * phi - truth["d"] * p - truth["dd"] * abs(p) * p)
        phi += step * p
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([("t", "phi"), *rows])
    return truth


def block_with(text: str, language: str) -> str:
    """Return the first block of code of the page on own models that contains a text."""
    return next(block for block in blocks("own-model", language) if text in block)


def test_decay_test_of_the_how_to_is_fitted_by_its_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs/examples/rolling.py").read_text(encoding="utf-8")
    Path("rolling.py").write_text(text, encoding="utf-8")
    Path("map.toml").write_text(MAP)
    truth = decay(Path("decay.csv"), 1)
    with pytest.raises(SystemExit):
        command_line.main(["import", "map.toml", "decay.csv", "-o", "decay.mcap"])
    words = block_with("rolling.py", "sh").split()
    assert words[:3] == ["seatrial", "ident", "vehicle"]
    CliRunner().invoke(ident, [*words[2:], "--rate", "20"], catch_exceptions=False)
    saved = load_model(Path("rolling/model.toml"))
    for name, true in truth.items():
        error = saved.errors[name]
        assert abs(saved.model.parameter(name).value - true) < 4 * error < 0.4 * true, name
    capsys.readouterr()
    block = block_with("p.dd * abs", "python")
    Path("rolling.py").write_text(block.replace("p.dd * abs", "p.dq * abs"), encoding="utf-8")
    with pytest.raises(SystemExit):
        command_line.main([*words[1:], "--force"])
    Path("rolling.py").write_text(block.replace("abs(x.p)", "max(x.p, -x.p)"), encoding="utf-8")
    with pytest.raises(SystemExit):
        command_line.main([*words[1:], "--force"])
    assert [line for line in capsys.readouterr().err.splitlines() if line.startswith("seatrial:")] == block_with(
        "rolling.py", "text"
    ).splitlines()


def test_a_missing_import_says_where_python_does_not_look(tmp_path: Path) -> None:
    (tmp_path / "neighbour_of_weed.py").write_text("EFFECT = 1\n")
    file = tmp_path / "own.py"
    file.write_text("from neighbour_of_weed import EFFECT\n")
    said = f"No module named 'neighbour_of_weed'; neighbour_of_weed is beside this file, .* set PYTHONPATH={tmp_path}"
    with pytest.raises(SeatrialError, match=said):
        load_effects(file)
    file.write_text("import no_such_package.part\n")
    with pytest.raises(SeatrialError, match=r"'no_such_package'; install this package, or add the folder that has"):
        load_effects(file)


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("own:boat", "give the file with its ending, own.py:boat"),
        ("own.boat", "give the file with its ending, own.py:boat"),
        ("own", "give the file with its ending, and the name of the model in it, own.py:NAME"),
        ("own.py", "give the name of the model in the file too, own.py:NAME"),
        ("other:boat", "choose horizontal, "),
        ("own.py:EFFECT", "an effect is given with --effects FILE.py"),
    ],
)
def test_the_bare_name_of_a_model_of_ones_own_is_corrected(
    source: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.py").write_text(OWN)
    with pytest.raises(SeatrialError, match=re.escape(said)):
        make_model(source)
