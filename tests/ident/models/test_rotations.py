"""Tests of lever arm, mounting and wandering current with measured attitude, on a boat that rolls
(``tests.ident.rolling``).

A component that a model cannot include is reported.
"""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.import_map import parse_import_map
from seatrial.ident.cli.commands import ident
from seatrial.ident.data.record import LogSegment
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.fitted_model import FittedModel, fit_nominal_model
from seatrial.ident.estimation.model_file import load_model
from seatrial.ident.estimation.prior_knowledge import apply_rig_geometry, with_effects
from seatrial.ident.model.structure import Model
from seatrial.ident.models.catalogue import make_model
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.kinematic import kinematic_model
from tests.ident.rolling import TRUTH, Fitted, sail
from tests.missions import boat_log, boat_with

ARM, MOUNT = (0.5, -0.3, -0.8), (0.06, -0.08, 0.1)


def fit_to_simulation(model: Model, boat: Fitted, seconds: float, seed: int) -> FittedModel:
    channels, _ = sail(boat, seconds, seed)
    return fit_nominal_model(model, [LogSegment("mission", channels)], [], rate=20.0)


@pytest.mark.study
def test_lever_arm_and_mounting_are_identified_with_the_hull() -> None:
    model = with_effects(make_model("kinematic:shaft:yaw"), ["lever-arm", "mount"])
    assert [e.name for e in model.effects] == ["lever-arm-attitude", "mount-attitude"]
    found = fit_to_simulation(model, Fitted(ARM, MOUNT), 150.0, 1).fit
    assert found.converged
    angles = dict(zip(("phi_mount", "theta_mount", "psi_mount"), MOUNT, strict=True))
    truth = TRUTH | dict(zip(("l_x", "l_y", "l_z"), ARM, strict=True)) | angles
    for name, true in truth.items():
        value, error = found.estimate(name)
        assert abs(value - true) < 4 * error, name
        assert error < 0.05 * abs(true), name


@pytest.mark.study
def test_lever_arm_of_the_rig_file_explains_the_data() -> None:
    """The height of the antenna matters, because the boat rolls."""
    boat, fits = Fitted(ARM), {}
    for name, arm in (("whole", ARM), ("no height", (*ARM[:2], 0.0)), ("none", (0.0, 0.0, 0.0))):
        model, notes = apply_rig_geometry(kinematic_model(yaw=True), rig_with(arm))
        assert not notes
        fits[name] = fit_to_simulation(model, boat, 60.0, 2).fit
    assert fits["whole"].log_likelihood > fits["no height"].log_likelihood + 1000.0
    assert fits["no height"].log_likelihood > fits["none"].log_likelihood + 1000.0
    assert "antenna_x" not in fits["whole"].model.free
    for name in ("m_u", "m_v", "m_r"):
        value, error = fits["whole"].estimate(name)
        assert abs(value - TRUTH[name]) < 4 * error < 0.05 * value, name


@pytest.mark.study
def test_wandering_current_is_estimated() -> None:
    boat = Fitted(wander=0.01)
    channels, current = sail(boat, 300.0, 3)
    fitted = fit_nominal_model(
        make_model("kinematic:shaft:yaw:random-walk-current"), [LogSegment("mission", channels)], [], rate=20.0
    )
    value, error = fitted.fit.estimate("q_V")
    assert abs(value - boat.wander) < 4 * error < 0.4 * boat.wander
    for name in ("m_u", "m_v", "m_r", "d_v"):
        value, error = fitted.fit.estimate(name)
        assert abs(value - TRUTH[name]) < 4 * error, name
    (view,) = fitted.estimation
    names = [s.name for s in fitted.model.states]
    values = dict(zip(fitted.fit.model.values, view.values, strict=True))
    for axis, true in zip("xy", current.T, strict=True):
        smooth = view.smoothed.x[:, names.index(f"drift_{axis}")] + values[f"V_{axis}"]
        at = np.interp(view.record.t, channels["x"].t, true)
        assert np.std(smooth - at) < 0.25 * np.std(at)


def test_lever_arm_and_mounting_of_a_level_boat_equal_those_of_the_horizontal_model() -> None:
    rng = np.random.default_rng(1)
    values_of_both = {"l_x": 0.4, "l_y": -0.2, "psi_mount": 0.3}
    both = (kinematic_model(yaw=True), horizontal_model())
    six, three = (with_effects(m, ["lever-arm", "mount"]).with_values(values_of_both) for m in both)
    six = six.with_values({"l_z": -0.7, "phi_mount": 0.0, "theta_mount": 0.0})
    for _ in range(5):
        x = dict(zip(("x", "y", "psi", "u", "v", "r"), rng.normal(size=6), strict=True))
        n = dict(zip(("n_left", "n_right"), rng.uniform(-1, 1, 2), strict=True))
        still = dict.fromkeys(("phi", "theta", "p", "q", "bias_psi", "bias_r"), 0.0)
        y3 = signals(three, x, n)
        y6 = signals(six, x | still, n | still | {"psi": x["psi"] + 0.3, "r": x["r"]})
        for o in six.outputs:
            assert y6[o.name] == pytest.approx(y3[o.name], abs=1e-12), o.name


def signals(model: Model, x: dict[str, float], u: dict[str, float]) -> dict[str, float]:
    values = [x[s.name] for s in model.states], [u[i.name] for i in model.inputs], list(model.values.values())
    return model.signals(*values).y


def rig_with(arm: tuple[float, float, float]) -> SimpleNamespace:
    return SimpleNamespace(vehicle={}, thrusters=(), devices=(SimpleNamespace(lever_arm_m=arm),))


@pytest.mark.parametrize(
    ("source", "parts", "message"),
    [
        ("kinematic:shaft", ["antenna_x", "antenna_y", "antenna_z"], ""),
        ("horizontal:shaft", ["antenna_x", "antenna_y"], ""),
        (
            "surge:shaft",
            [],
            "model surge cannot include the lever arm of the rig's antenna (0.5 m ahead, -0.3 m to starboard, "
            "-0.8 m down): it takes x as measured at the origin; use a horizontal or kinematic model if the boat turns",
        ),
        ("yaw:both", [], ""),  # The yaw model has no GNSS outputs.
    ],
)
def test_antenna_of_the_rig_is_included_or_reported(source: str, parts: list[str], message: str) -> None:
    model, lines = apply_rig_geometry(make_model(source), rig_with(ARM))
    assert [n for n in model.values if n.startswith("antenna")] == parts
    assert [model.values[n] for n in parts] == list(ARM[: len(parts)])
    assert lines == ([message] if message else [])


def test_antenna_of_an_import_map_is_included_as_that_of_a_rig() -> None:
    text = 'format = "seatrial-import 1"\nsignal = [{ name = "r", column = "r", unit = "rad/s" }]\n[geometry]\n'
    vehicle = parse_import_map(text + "lever_arm_m = [0.5, -0.3, -0.8]\n", Path("map.toml")).vehicle
    for source, n in (("kinematic:shaft", 3), ("horizontal:shaft", 2)):
        mapped, lines = apply_rig_geometry(make_model(source), None, vehicle)
        assert [mapped.values[f"antenna_{axis}"] for axis in "xyz"[:n]] == [0.5, -0.3, -0.8][:n]
        assert mapped.values == apply_rig_geometry(make_model(source), rig_with((0.5, -0.3, -0.8)))[0].values
        assert lines == []
    assert "the import map's antenna" in apply_rig_geometry(make_model("surge:shaft"), None, vehicle)[1][0]
    with pytest.raises(SeatrialError, match="lever_arm_m"):
        parse_import_map(text + "lever_arm_m = [0.5]\n", Path("map.toml"))


def test_choice_between_two_antennas_is_reported() -> None:
    rig = rig_with(ARM)
    rig.devices += rig_with((1.0, 0.0, 0.0)).devices
    model, lines = apply_rig_geometry(horizontal_model(), rig)
    assert model.values["antenna_x"] == 0.5
    assert lines == [
        "the rig has 2 antennas; model horizontal uses the first of them (0.5 m ahead, -0.3 m to "
        "starboard, -0.8 m down) for all GNSS"
    ]


@pytest.mark.parametrize(
    ("source", "name", "message"),
    [
        (
            "kinematic:shaft",
            "wind",
            "--effect wind: model kinematic has no place for this effect; it can have current-drift",
        ),
        (
            "horizontal:shaft",
            "sail",
            "--effect sail: there is no such effect; model horizontal can have accelerometer-scale",
        ),
        (
            "horizontal:shaft",
            "winds",
            "--effect winds: there is no such effect; did you mean wind (steady wind)?",
        ),
        (
            "horizontal:shaft",
            "Dead-Zone",
            "--effect Dead-Zone: there is no such effect; did you mean dead-band (a dead band of the thrusters)?",
        ),
        (
            "horizontal:shaft",
            "fouled",
            "--effect fouled: there is no such effect; did you mean mismatch (a thrust mismatch of the left and right",
        ),
        (
            "horizontal:shaft",
            "toe-in",
            "--effect toe-in: there is no such effect; did you mean thrust-angle (thrusters that do not push",
        ),
        (
            "horizontal:shaft",
            "parallel",
            "--effect parallel: there is no such effect; did you mean thrust-angle (thrusters that do not push",
        ),
        ("surge", "mount", "--effect mount: model surge has no place for this effect; it can have none"),
        (
            "horizontal:shaft:random-walk-current",
            "random-walk-current",
            "--effect random-walk-current: model horizontal has it already",
        ),
        ("kinematic:shaft", "mount mount", "--effect mount: model kinematic has it already"),
    ],
)
def test_impossible_effect_gives_a_one_line_error(source: str, name: str, message: str) -> None:
    with pytest.raises(SeatrialError) as caught:
        with_effects(make_model(source), name.split())
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_every_accepted_effect_can_be_added_and_starts_away_from_zero() -> None:
    for model in (horizontal_model(), kinematic_model(yaw=True)):
        for name, effect in catalogue().items():
            if model.accepts(effect):
                (added,) = with_effects(model, [name]).effects
                assert all(p.value != 0.0 for p in added.parameters if p.free)


@pytest.mark.study
def test_effect_option_frees_an_effect_and_the_model_file_keeps_it(tmp_path: Path) -> None:
    boat = boat_with("lever-arm", 3)
    log = boat_log(tmp_path / "a.mcap", boat, 120.0, 7, 1)
    (effect,) = boat.effects
    for model, name in (("auto", "lever-arm"), ("kinematic:shaft:yaw", "lever-arm-attitude")):
        out = tmp_path / name
        words = [
            "vehicle",
            str(log),
            "--no-score-tests",
            "--model",
            model,
            "--effect",
            "lever-arm",
            "--effect",
            "mount",
            "--out",
            str(out),
        ]
        CliRunner().invoke(ident, words, catch_exceptions=False)
        saved = load_model(out / "model.toml")
        assert [e.name for e in saved.model.effects][:2] == [name, name.replace("lever-arm", "mount")]
        for arm, true in effect.parameters.items():
            assert saved.model.parameter(arm).free
            assert abs(saved.model.parameter(arm).value - true) < 4 * saved.errors[arm] < 0.5
        assert "psi_mount" in saved.errors
        rows = json.loads((out / "result.json").read_text(encoding="utf-8"))["fit"]["parameters"]
        assert {"l_x", "l_y", "psi_mount"} <= {p["name"] for p in rows}
