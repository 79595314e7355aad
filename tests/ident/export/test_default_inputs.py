"""Tests of the defaults of exported inputs: a user gives only the physical inputs, and the others follow."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.model_file import SavedModel
from seatrial.ident.export.formats import export
from seatrial.ident.model.structure import Model
from seatrial.ident.models.horizontal import horizontal_model
from tests.ident.export.test_simulation import with_effects
from tests.ident.exported import compiler, run_casadi, run_python, saved

END_S, WORK = 240.0, 1.5
MODEL = with_effects(horizontal_model("command"), "payload-shift", "battery-sag").with_values(
    {"t_shift": 120.0, "beta_E": 0.1}
)
COMMANDS = [0.6, 0.4]


def diagnosed(model: Model = MODEL) -> SavedModel:
    made = saved(model)
    return replace(made, validity={**made.validity, "t": (0.0, END_S), "work": (0.0, WORK)})


def wanted(inputs: list[str]) -> list[float]:
    """Return the inputs of the equations for constant commands at the end of the data."""
    values = {"t": END_S, "work": WORK, "n_cmd_left": COMMANDS[0], "n_cmd_right": COMMANDS[1]}
    return [values[n.partition("_ago_")[0]] for n in inputs]


def test_python_and_casadi_need_only_the_commands(tmp_path: Path) -> None:
    text = export(diagnosed(), "python")
    assert isinstance(text, str)
    assert "without a past the default is the end of the data, 240 s and a work of 1.5" in text
    _, space = run_python(text, tmp_path)
    assert len(space["INPUTS"]) == 36
    assert space["PHYSICAL_INPUTS"] == ("n_cmd_left", "n_cmd_right")
    u = space["inputs_from"](COMMANDS)
    assert u == wanted(space["INPUTS"])
    early = space["inputs_from"](COMMANDS, t=0.0, work=0.0)
    assert early[space["INPUTS"].index("t")] == 0.0
    with pytest.raises(ValueError, match=r"n_cmd_left is 2\.0: give -1 to 1"):
        space["inputs_from"]([2, 0.4])
    other = export(diagnosed(), "casadi")
    assert isinstance(other, str)
    (f, _, _), loaded = run_casadi(other, tmp_path)
    x = np.linspace(0.1, 0.4, len(space["STATES"]))
    rates = np.array(f(x, loaded["inputs_from"](COMMANDS), loaded["DEFAULTS"])).ravel()
    np.testing.assert_allclose(rates, space["f"](list(x), u), rtol=1e-12, atol=1e-12)
    assert loaded["initial_state"](0.1, t=END_S)[len(space["STATES"])] == END_S


def test_simulation_may_start_after_the_change(tmp_path: Path) -> None:
    """The payload has moved at the time of the end of the data, and the motion shows it."""
    text = export(diagnosed(MODEL.with_values({"y_shift": 0.3})), "python")
    assert isinstance(text, str)
    _, space = run_python(text, tmp_path)

    def heading(**start: float) -> float:
        simulation = space["Simulation"](0.1, **start)
        for _ in range(100):
            x = simulation.step([0.5, 0.5])
        return float(x[space["STATES"].index("psi")])

    before, after = heading(), heading(t=space["TIME"])
    assert abs(after - before) > 0.02
    simulation = space["Simulation"](0.1, t=END_S, work=WORK)
    assert (simulation.t, simulation.work) == (END_S, WORK)
    assert simulation.inputs_now(COMMANDS)[space["INPUTS"].index("t")] == END_S
    simulation.reset()
    assert (simulation.t, simulation.work) == (0.0, 0.0)


PROGRAM = """
#include <stdio.h>
#include "boat.h"
int main(void)
{
    const double in[] = {0.6, 0.4};
    double u[horizontal_NU];
    int i;
    horizontal_inputs(in, u);
    for (i = 0; i < horizontal_NU; i++) printf("%.17g ", u[i]);
    return 0;
}
"""


def test_c_needs_only_the_commands(tmp_path: Path) -> None:
    text = export(diagnosed(), "c")
    assert isinstance(text, str)
    (tmp_path / "boat.h").write_text(text, encoding="utf-8")
    (tmp_path / "main.c").write_text(PROGRAM, encoding="utf-8")
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    subprocess.run([compiler(), *flags, "main.c", "-o", "main", "-lm"], cwd=tmp_path, check=True)
    ran = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True)
    _, space = run_python(str(export(diagnosed(), "python")), tmp_path)
    assert [float(word) for word in ran.stdout.split()] == wanted(space["INPUTS"])


def test_ros2_file_says_what_a_node_gives() -> None:
    yaml = pytest.importorskip("ruamel.yaml", reason="no YAML reader here (ruamel.yaml)")
    text = export(diagnosed(), "ros2")
    assert isinstance(text, str)
    assert text.index("physical_inputs:") < text.index("    inputs:")
    table: dict[str, Any] = yaml.YAML(typ="safe", pure=True).load(text)["horizontal"]["ros__parameters"]
    assert table["physical_inputs"] == ["n_cmd_left", "n_cmd_right"]
    assert len(table["inputs"]) == len(table["input_units"]) == len(table["input_delays"]) == 36
    assert (table["default_t"], table["default_work"]) == (END_S, WORK)
    plain = export(saved(horizontal_model()), "ros2")
    assert "default_" not in str(plain)


def test_fmu_takes_the_time_of_the_experiment(tmp_path: Path) -> None:
    """A simulation from the end of the data on has the payload where it is then."""
    compiler()
    content = export(diagnosed(MODEL.with_values({"y_shift": 0.3})), "fmu")
    assert isinstance(content, bytes)
    (tmp_path / "boat.fmu").write_bytes(content)
    inputs = [v for v in fmpy.read_model_description(tmp_path / "boat.fmu").modelVariables if v.causality == "input"]
    assert {v.name: float(v.start) for v in inputs} == {"n_cmd_left": 0.0, "n_cmd_right": 0.0}
    _, space = run_python(str(export(diagnosed(MODEL.with_values({"y_shift": 0.3})), "python")), tmp_path)
    for start in (0.0, END_S):
        values = {"n_cmd_left": 0.5, "n_cmd_right": 0.5, "before.n_cmd_left": 0.5, "before.n_cmd_right": 0.5}
        ran = fmpy.simulate_fmu(
            str(tmp_path / "boat.fmu"), start_time=start, stop_time=start + 10.0, step_size=0.1, start_values=values
        )
        simulation = space["Simulation"](0.1, inputs=[0.5, 0.5], hold="zero", t=start)
        for _ in range(100):
            x = simulation.step([0.5, 0.5])
        assert ran["psi"][-1] == pytest.approx(x[space["STATES"].index("psi")], rel=1e-6)


def test_a_model_file_without_the_range_of_time_is_taken_after_its_change(tmp_path: Path) -> None:
    _, space = run_python(str(export(saved(MODEL), "python")), tmp_path)
    assert (space["TIME"], space["WORK"]) == (130.0, 0.0)
    _, space = run_python(str(export(saved(horizontal_model() + catalogue()["current-drift"]), "python")), tmp_path)
    assert (space["TIME"], space["WORK"]) == (0.0, 0.0)
