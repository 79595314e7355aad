"""Tests that run the controllers of docs/how-to/control.md and compare their output."""

from __future__ import annotations

import importlib
import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import seatrial as st
from seatrial.ident.cli.commands import ident
from tests.ident.workflows.test_use_a_model import run
from tests.test_docs import ROOT, blocks, how_to

if TYPE_CHECKING:
    pass

PAGE = how_to("control")
WIND = {"F_wx": -3.0, "F_wy": 2.0, "w_x": 0.3}  # N, N, and the frontal area over the lateral one
DEVIATION = {"dev_s": 0.03, "dev_c": 0.01}  # rad, of a compass by the heading
UNSTABLE = {"m_u": 37.0, "m_v": 70.0}  # kg: with a large sway mass the Munk moment turns the boat away
pytestmark = pytest.mark.pages


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Create the models of the page, and the files that its commands write."""
    made = tmp_path_factory.mktemp("control")
    for name, text in zip(("boat", "command", "thruster"), blocks(PAGE, "toml"), strict=True):
        (made / name).mkdir()
        (made / name / "model.toml").write_text(text, encoding="utf-8")
    for line in blocks(PAGE, "sh")[0].splitlines():
        words = [str(made / w) if w.endswith((".toml", ".py")) else w for w in line.split()[2:]]
        ident.main(words, standalone_mode=False)
    return made


def output(code: str, number: int = 0) -> str:
    """Return a text block after a code block: 0 is the next one."""
    text = PAGE.read_text(encoding="utf-8")
    after = text[text.index(code) + len(code) :]
    return re.findall(r"^```text\n(.*?)^```$", after, re.MULTILINE | re.DOTALL)[number]


@pytest.mark.parametrize("block", [*range(6), 7], ids=["slope", "pid", "lqr", "shafts", "ramp", "mpc", "commands"])
def test_controller_of_the_page(block: int, folder: Path) -> None:
    code = blocks(PAGE, "python")[block]
    assert run(code, folder) == output(code)


def test_the_arm_of_the_antenna_is_its_given_position_and_the_deviation(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The boat is at the origin with its bow to north, so that the measured position is the arm."""
    assert "It is `antenna_x + l_x` and `antenna_y + l_y` of the exported `P`" in PAGE.read_text(encoding="utf-8")
    arms = {"antenna_x": -0.4, "antenna_y": 0.1, "l_x": -0.04, "l_y": 0.02}
    rows = "".join(f'[[parameter]]\nname = "{n}"\nvalue = {v}\nfree = false\n' for n, v in arms.items())
    text = blocks(PAGE, "toml")[0].replace("effects = []", 'effects = ["antenna", "lever-arm"]')
    (folder / "antenna.toml").write_text(text + rows, encoding="utf-8")
    words = ["export", folder / "antenna.toml", "--to", "python", "--name", "antenna", "-o", folder / "antenna.py"]
    ident.main([str(w) for w in words], standalone_mode=False)
    monkeypatch.syspath_prepend(folder)
    exported = importlib.import_module("antenna")
    p, y = exported.P, dict(zip(exported.OUTPUTS, exported.Simulation(0.1).outputs(), strict=True))
    assert y["x"] == pytest.approx(p["antenna_x"] + p["l_x"]) == pytest.approx(-0.44)
    assert y["y"] == pytest.approx(p["antenna_y"] + p["l_y"]) == pytest.approx(0.12)


@pytest.mark.parametrize("block", [1, 2, 3, 4], ids=["pid", "lqr", "shafts", "ramp"])
def test_controller_of_the_page_with_a_model_of_commands(block: int, folder: Path) -> None:
    """The page tells to change one line."""
    code = blocks(PAGE, "python")[block]
    old = 'MODEL, PLANT = "boat", "plant"'
    assert old in code
    assert run(code.replace(old, 'MODEL, PLANT = "command", "commanded"'), folder) == output(code, 1)


@pytest.mark.parametrize("block", [1, 3], ids=["pid", "shafts"])
def test_controllers_of_the_page_hold_a_boat_that_is_unstable_in_yaw(block: int, folder: Path) -> None:
    """The fixed gains of an earlier page made such boats swing. Here the yaw rate doubles within two seconds."""
    (folder / "unstable").mkdir(exist_ok=True)
    rows = "".join(f'[[parameter]]\nname = "{n}"\nvalue = {v}\nfree = false\n' for n, v in UNSTABLE.items())
    text = (folder / "command/model.toml").read_text(encoding="utf-8")
    (folder / "unstable/model.toml").write_text(text + rows, encoding="utf-8")
    words = ["export", folder / "unstable/model.toml", "--to", "python", "--name", "swinging", "--force"]
    ident.main([str(w) for w in (*words, "-o", folder / "swinging.py")], standalone_mode=False)
    assert max(st.linearise(folder / "unstable", 0.8).poles.real) > 0.35
    code = blocks(PAGE, "python")[block].replace('"boat", "plant"', '"unstable", "swinging"')
    assert run(code, folder).startswith("swinging after 60 s: 0.800 m/s, heading 40.00 deg")


def test_the_integral_of_the_pid_holds_the_heading_in_wind(folder: Path) -> None:
    """Its linear model knows no wind, so that its inputs leave an error of the heading."""
    rows = "".join(f'[[parameter]]\nname = "{n}"\nvalue = {v}\nfree = false\n' for n, v in WIND.items())
    calm = (folder / "boat/model.toml").read_text(encoding="utf-8")
    (folder / "windy.toml").write_text(calm.replace("effects = []", 'effects = ["wind"]') + rows, encoding="utf-8")
    words = ["export", folder / "windy.toml", "--to", "python", "--thruster", folder / "thruster/model.toml"]
    ident.main([str(w) for w in (*words, "--name", "windy", "-o", folder / "windy.py")], standalone_mode=False)
    code = blocks(PAGE, "python")[1].replace('MODEL, PLANT = "boat", "plant"', 'MODEL, PLANT = "boat", "windy"')
    assert run(code, folder) == "windy after 60 s: 0.800 m/s, heading 40.00 deg\n"
    assert "0.2 * turn_integral" in code
    found = re.search(r"heading ([\d.]+) deg", run(code.replace("0.2 * turn_integral", "0.0"), folder))
    assert found
    assert abs(float(found[1]) - 40.0) > 0.3


@pytest.mark.parametrize("block", [1, 2], ids=["pid", "lqr"])
def test_controllers_of_the_page_feed_back_the_measured_heading(block: int, folder: Path) -> None:
    """A compass with a deviation of 1.5 deg there: a controller can hold the measured heading only."""
    rows = "".join(f'[[parameter]]\nname = "{n}"\nvalue = {v}\nfree = false\n' for n, v in DEVIATION.items())
    right = (folder / "boat/model.toml").read_text(encoding="utf-8")
    text = right.replace("effects = []", 'effects = ["compass"]') + rows
    (folder / "deviating.toml").write_text(text, encoding="utf-8")
    words = ["export", folder / "deviating.toml", "--to", "python", "--thruster", folder / "thruster/model.toml"]
    ident.main(
        [str(w) for w in (*words, "--force", "--name", "deviating", "-o", folder / "deviating.py")],
        standalone_mode=False,
    )
    code = blocks(PAGE, "python")[block].replace('MODEL, PLANT = "boat", "plant"', 'MODEL, PLANT = "boat", "deviating"')
    measured = 'print("measured", math.degrees(simulation.outputs()[0]))'
    true, heard = run(f"{code}\nimport math\n{measured}", folder).splitlines()[-2:]
    assert float(heard.split()[1]) == pytest.approx(40.0, abs=0.02)
    assert "heading 40.00" not in true


def test_mpc_with_shaft_speeds_stays_at_rest(folder: Path) -> None:
    """The page states that zero is a stationary point of the optimisation with shaft speeds."""
    code = blocks(PAGE, "python")[5]
    for old, new in (
        (
            "boat_casadi import DEFAULTS, STATES, THRUST_CURVE, make_step, shaft_speed",
            "shafts_casadi import DEFAULTS, STATES, make_step",
        ),
        ("c1, c2 = THRUST_CURVE\nASTERN, AHEAD = -SHARE * (c1 - c2), SHARE * (c1 + c2)", "ASTERN, AHEAD = -1.0, 1.0"),
        ("[shaft_speed(force) for force in found.value(f)[:, 0]]", "found.value(f)[:, 0]"),
        ("range(75)", "range(3)"),
        ("after 15 s", "shaft speeds"),
    ):
        assert old in code
        code = code.replace(old, new)
    assert run(code, folder) == "shaft speeds: x = 0.0 m, y = 0.0 m\n"


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")  # the slope at zero thrust
def test_mpc_takes_a_boat_with_more_states_whose_effect_needs_the_shaft_speed(folder: Path) -> None:
    """The loss of thrust with advance ratio is a common error, which most fitted boats have."""
    values = {"k_J": 4.0, "dev_f1s": 0.03, "dev_f1c": 0.02, "T_head": 2.0}
    rows = "".join(f'[[parameter]]\nname = "{n}"\nvalue = {v}\nfree = false\n' for n, v in values.items())
    text = (folder / "boat/model.toml").read_text(encoding="utf-8")
    effects = 'effects = ["compass-filtered", "advance-ratio"]'
    (folder / "losing.toml").write_text(text.replace("effects = []", effects) + rows, encoding="utf-8")
    bench = ("--thruster", folder / "thruster/model.toml", "--force")
    for name, options in (("losing", ("python", *bench)), ("losing_casadi", ("casadi", "--thrust-input"))):
        words = ["export", folder / "losing.toml", "--name", name, "-o", folder / f"{name}.py", "--to", *options]
        ident.main([str(w) for w in words], standalone_mode=False)
    code = blocks(PAGE, "python")[5]
    for old, new in (("import plant", "import losing as plant"), ("boat_casadi", "losing_casadi")):
        assert old in code
        code = code.replace(old, new)
    found = re.search(r"x = (\S+) m, y = (\S+) m", run(f"{code}\nassert len(names) == 7", folder))
    assert found
    assert float(found[1]) == pytest.approx(4.0, abs=0.2)
    assert float(found[2]) == pytest.approx(2.0, abs=0.2)


def test_mpc_of_commands_needs_a_guess_that_is_not_zero(folder: Path) -> None:
    """The page states that the boat stays at rest with a first guess of zero."""
    code = blocks(PAGE, "python")[7]
    for old, new in (("problem.set_initial(n, 0.3)", "problem.set_initial(n, 0.0)"), ("range(75)", "range(3)")):
        assert old in code
        code = code.replace(old, new)
    assert run(code, folder).startswith("after 15 s: x = 0.0 m, y = 0.0 m")


@pytest.mark.parametrize("block", [6, 8], ids=["thrusts", "commands"])
def test_mpc_with_do_mpc(block: int, folder: Path) -> None:
    pytest.importorskip("do_mpc", reason="do-mpc is not installed: it needs matplotlib, which no other test uses")
    found = re.search(r"after 15 s: x = ([\d.]+) m, y = ([\d.]+) m", run(blocks(PAGE, "python")[block], folder))
    assert found
    assert float(found[1]) == pytest.approx(4.0, abs=0.3)
    assert float(found[2]) == pytest.approx(2.0, abs=0.3)


def test_the_page_names_the_do_mpc_that_works_with_the_required_casadi() -> None:
    """CasADi 3.8 has no `casadi.tools.SX` any more, which do-mpc 5.1.1 needs; do-mpc 5.1.2 works with both."""
    required = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert "casadi>=3.8" in required["project"]["optional-dependencies"]["ident"]
    text = PAGE.read_text(encoding="utf-8")
    assert "seatrial needs CasADi 3.8" in text
    assert 'pip install "do-mpc>=5.1.2"' in text
