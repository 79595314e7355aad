"""Tests of the SDF blocks for Gazebo and VRX: the formulae of the plugins, written out here, give the fitted model."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner

from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.ident.cli.commands import ident
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine.vectorised_model import VectorisedModel
from seatrial.ident.export.formats import export
from seatrial.ident.model.structure import Model
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.nomoto import nomoto_model
from tests.ident.export.test_joined import CURVE, LEFT, boat, files, known
from tests.ident.exported import saved

MASS, INERTIA = 30.0, 4.0
MODEL = boat(c1=41.0, c2=2.5, V_x=0.0, y_left=-0.35, y_right=0.25, d_u=3.0, d_vv=60.0)


def exported(model: Model, target: str = "gazebo", warned: str = "fill in", **options: Any) -> str:
    """Return the text of the blocks, of which at least one warning has the text `warned`."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always", SeatrialWarning)
        text = export(saved(model), target, **options)
    assert isinstance(text, str)
    lines = [str(w.message) for w in found]
    assert any(re.search(warned, line) for line in lines), lines
    return text


def blocks_of(target: str, model: Model = MODEL) -> ElementTree.Element:
    text = exported(model, target, name="boat", mass=MASS, inertia=INERTIA)
    root = ElementTree.fromstring(text)
    found = root.find("model")
    assert found is not None
    return found


def numbers(element: ElementTree.Element | None) -> dict[str, float]:
    """Return the numbers below an element by name."""
    assert element is not None
    return {x.tag: float(x.text or "") for x in element.iter() if not len(x) and x.tag not in ("link_name", "namespace")
            and not x.tag.endswith("_name")}  # fmt: skip


def model_rates(u: float, v: float, r: float, n_left: float, n_right: float) -> np.ndarray:
    """Return the rates of surge, sway and yaw of the fitted model."""
    values = np.array(list(MODEL.values.values()))
    row = VectorisedModel(MODEL)(np.array([[0.0, 0.0, 0.0, u, v, r]]), np.array([[n_left, n_right]]), values)
    return row[0, 3:6]


def to_gazebo(surge: float, sway: float, yaw: float) -> np.ndarray:
    """Return a vector of forward, starboard and down axes in those of Gazebo: forward, port, up."""
    return np.array([surge, -sway, -yaw])


def wrench(model: ElementTree.Element, n_left: float, n_right: float) -> np.ndarray:
    """Return the force and the moment of both thrusters in the axes of Gazebo, from the comments of the block."""
    places, forces = {"left": 0.35, "right": -0.25}, {"left": n_left, "right": n_right}
    plugins = [p for p in model.findall("plugin") if p.get("name") == "gz::sim::systems::Thruster"]
    assert [p.findtext("joint_name") for p in plugins] == ["left_propeller_joint", "right_propeller_joint"]
    total = np.zeros(3)
    for side, plugin in zip(places, plugins, strict=True):
        limits = numbers(plugin)
        c1, c2 = (
            (limits["max_thrust_cmd"] - limits["min_thrust_cmd"]) / 2,
            (limits["max_thrust_cmd"] + limits["min_thrust_cmd"]) / 2,
        )
        force = c1 * forces[side] * abs(forces[side]) + c2 * forces[side] ** 2
        total += np.array([force, 0.0, -places[side] * force])
    return total


STATES = [(0.9, 0.2, -0.4, 0.5, 0.3), (-0.3, -0.1, 0.6, -0.7, 0.2), (0.0, 0.0, 0.0, 1.0, -1.0)]


@pytest.mark.parametrize("state", STATES)
def test_gazebo_blocks_give_the_accelerations_of_the_model(state: tuple[float, ...]) -> None:
    """The equations of gz-sim are (M + A) a + C(v) v = wrench - D(v) v, with D = -xU - xUabsU |u| of the plugin."""
    model = blocks_of("gazebo")
    inertial = numbers(model.find("link/inertial"))
    assert (inertial["mass"], inertial["izz"]) == (MASS, INERTIA)
    drag = numbers(model.find("plugin[@name='gz::sim::systems::Hydrodynamics']"))
    assert all(value <= 0.0 for value in drag.values())
    u, v, r = to_gazebo(*state[:3])
    masses = np.array([MASS + inertial["xx"], MASS + inertial["yy"], INERTIA + inertial["rr"]])
    damping = np.array(
        [
            -drag["xU"] - drag["xUabsU"] * abs(u),
            -drag["yV"] - drag["yVabsV"] * abs(v),
            -drag["nR"] - drag["nRabsR"] * abs(r),
        ]
    )
    # Coriolis matrix of a diagonal mass matrix (Fossen 2011, eq. 6.43)
    coriolis = np.array([-masses[1] * v * r, masses[0] * u * r, (masses[1] - masses[0]) * u * v])
    acceleration = (wrench(model, *state[3:]) - damping * [u, v, r] - coriolis) / masses
    np.testing.assert_allclose(acceleration, to_gazebo(*model_rates(*state)), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("state", [(0.9, 0.0, 0.0, 0.5, 0.5), (-0.3, 0.0, 0.0, -0.7, -0.7), (0.0, 0.0, 0.5, 0.4, -0.4)])
def test_vrx_blocks_give_the_accelerations_of_the_model_in_one_direction(state: tuple[float, ...]) -> None:
    """Equation of SimpleHydrodynamics: force = -(A a) - (xU + xUU |u|) u, without the Coriolis forces of A."""
    model = blocks_of("vrx")
    inertial = numbers(model.find("link/inertial"))
    plugin = numbers(model.find("plugin[@name='vrx::SimpleHydrodynamics']"))
    assert all(value >= 0.0 for value in plugin.values())
    u, v, r = to_gazebo(*state[:3])
    added = np.array([plugin["xDotU"], plugin["yDotV"], plugin["nDotR"]])
    damping = np.array(
        [
            plugin["xU"] + plugin["xUU"] * abs(u),
            plugin["yV"] + plugin["yVV"] * abs(v),
            plugin["nR"] + plugin["nRR"] * abs(r),
        ]
    )
    own = np.array([inertial["mass"], inertial["mass"], inertial["izz"]])
    rigid = own * np.array([-v * r, u * r, 0.0])
    acceleration = (wrench(model, *state[3:]) - damping * [u, v, r] - rigid) / (own + added)
    np.testing.assert_allclose(acceleration, to_gazebo(*model_rates(*state)), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("target", ["gazebo", "vrx"])
def test_file_states_what_the_blocks_lack(target: str) -> None:
    model = (MODEL + catalogue()["cubic-drag"]).with_values({})
    text = exported(model, target, "cannot have these parts of the model: cubic-drag$", mass=MASS, inertia=INERTIA)
    assert "Not in these blocks: cubic-drag, current." in text
    assert "made by: seatrial ident vehicle a.mcap" in text
    assert "- -x" in text  # two hyphens would end the comment
    assert "left: its joint lies 0.35 m to port" in text
    joined = exported(
        boat(),
        target,
        "shaft n_left, shaft n_right, delay of n_cmd_left, delay of n_cmd_right, parameters",
        mass=MASS,
        inertia=INERTIA,
        thrusters={"": saved(LEFT)},
    )
    assert "shaft n_left, shaft n_right" in joined
    assert "<max_thrust_cmd>41.5</max_thrust_cmd>" in joined


@pytest.mark.parametrize("target", ["gazebo", "vrx"])
def test_blocks_have_a_possible_inertia_and_ask_for_that_of_the_boat(target: str) -> None:
    """Gazebo refuses a link whose largest moment of inertia exceeds the sum of the others; a missing one is 1."""
    text = exported(MODEL, target, r"roll and pitch \(ixx, iyy\) .* fill in those of your boat", mass=30.0, inertia=9.0)
    found = numbers(ElementTree.fromstring(text).find("model/link/inertial/inertia"))
    assert set(found) == {"ixx", "iyy", "izz"}
    assert found["izz"] == 9.0 <= found["ixx"] + found["iyy"]
    assert "FILL IN ixx (roll) and iyy (pitch)" in text


def test_delay_and_disturbances_are_named_in_the_warning() -> None:
    commanded = known(horizontal_model("command"), **CURVE, y_left=-0.3, y_right=0.3)
    words = "shaft n_left, shaft n_right, delay of n_cmd_left, delay of n_cmd_right, parameters T_n tau_n dead_zone$"
    exported(commanded, warned=words, mass=30.0, inertia=4.0)
    exported(with_disturbances(MODEL), warned="model: state b_X, state b_Y, state b_N, ", mass=30.0, inertia=4.0)


def test_mass_equal_to_the_printed_sum_means_no_added_mass() -> None:
    """The refusal without --mass prints the sums with four digits, which may be above the fitted ones."""
    model = boat(m_u=36.998, m_v=47.0, m_r=9.6849, c1=41.0)
    with pytest.raises(SeatrialError, match=r"surge 37 kg, sway 47 kg, yaw 9\.685 kg m2"):
        export(saved(model), "gazebo")
    text = exported(model, warned=r"added mass in surge and yaw is zero.*weigh it", mass=37.0, inertia=9.685)
    found = numbers(ElementTree.fromstring(text).find("model/link/inertial/fluid_added_mass"))
    assert found == {"xx": 0.0, "yy": 10.0, "rr": 0.0}
    with pytest.raises(SeatrialError, match=r"--mass 37.5 kg .* sum with added mass, 37 kg, .* would be -0.502 kg;"):
        export(saved(model), "gazebo", mass=37.5, inertia=4.0)


def test_missing_and_impossible_values_are_reported() -> None:
    def refuse(words: str, model: Model = MODEL, **options: float) -> None:
        with pytest.raises(SeatrialError, match=words):
            export(saved(model), "gazebo", **options)

    refuse(r"give --mass and --inertia: a fit finds only the sums with added mass \(surge 37 kg, sway 47 kg")
    refuse("give --inertia: ", mass=30.0)
    refuse("--mass 38 kg is more than the fitted sum with added mass", mass=38.0, inertia=4.0)
    refuse("--inertia 50 kg m2 is more than the fitted sum", mass=30.0, inertia=50.0)
    refuse("--mass 0: give a positive number, in kg", mass=0.0, inertia=4.0)
    refuse("the model nomoto has no m_v", nomoto_model(), mass=30.0, inertia=4.0)
    refuse("the thrust of the model was not given", horizontal_model(), mass=30.0, inertia=4.0)
    exported(known(horizontal_model(), **CURVE), "vrx", "the arms of the thrusters were not", mass=30.0, inertia=4.0)
    forces = known(horizontal_model("force"), y_left=-0.3, y_right=0.3)
    assert "The model has no thrust curve" in exported(forces, mass=30.0, inertia=4.0)


def test_export_command_writes_blocks(tmp_path: Path) -> None:
    hull, _ = files(tmp_path)
    words = [
        "export",
        str(hull),
        "--format",
        "gazebo",
        "--mass",
        "30",
        "--inertia",
        "4",
        "-o",
        str(tmp_path / "boat.sdf"),
    ]
    with pytest.warns(SeatrialWarning, match="fill in those of your boat"):
        done = CliRunner().invoke(ident, words, catch_exceptions=False)
    assert done.exit_code == 0
    found = numbers(ElementTree.parse(tmp_path / "boat.sdf").getroot().find("model/link/inertial"))
    assert found["mass"] == 30.0
