"""Tests of the decisions before a fit: model, sensors, known parameters and required signals of a log."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from seatrial.daq.errors import SeatrialError
from seatrial.daq.rig import Rig
from seatrial.ident.data.loading import LoadedLog, PropulsionInput, TimeWindow, load_all, load_run, load_runs
from seatrial.ident.data.record import Channel, LogSegment
from seatrial.ident.estimation.fitted_model import fit_nominal_model
from seatrial.ident.estimation.prior_knowledge import (
    apply_rig_geometry,
    fix_parameters,
    set_initial_values,
    set_priors,
    with_effects,
)
from seatrial.ident.model.parameter import Parameter, ParameterOrigin
from seatrial.ident.models.catalogue import make_model
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.nomoto import nomoto_model
from seatrial.ident.results.tables import record_inputs
from seatrial.ident.workflows.model_inputs import choose_model, thrust_from, with_derived_signals
from seatrial.ident.workflows.output import sensor_rates, validity
from seatrial.ident.workflows.vehicle import _command_scale
from tests.ident.rolling import Fitted
from tests.ident.rolling import sail as rolling_sail
from tests.missions import boat_log, boat_with, channels_of, rig_of, sail

pytestmark = pytest.mark.usefixtures("quick_compilation")

AHRS = ("psi", "r", "ax", "ay")
GNSS = ("x", "y", "vx", "vy")


def loaded(*names: str, holds: dict[str, str] | None = None) -> LoadedLog:
    t = np.arange(5.0)
    return LoadedLog(LogSegment("run", {n: Channel(t, t) for n in names}), {"path": "run.mcap"}, holds or {}, None)


@pytest.mark.parametrize(
    ("names", "inputs"),
    [
        (("n_left", "n_right"), ("n_left", "n_right")),
        (("f_left", "f_right"), ("f_left", "f_right")),
        (("X", "N"), ("X", "N")),
        (("n_left", "n_right", "f_left", "f_right"), ("n_left", "n_right")),
    ],
)
def test_model_is_chosen_by_the_inputs_and_sensors_of_the_logs(names: tuple[str, ...], inputs: tuple[str, ...]) -> None:
    model = choose_model("auto", [loaded(*names, *AHRS), loaded(*names, "x", "y")])
    assert tuple(i.name for i in model.inputs) == inputs
    assert [s.name for s in model.sensors] == ["attitude", "gyro", "accelerometer", "position"]


def test_input_keeps_the_hold_of_the_log() -> None:
    names = ("f_left", "f_right", *AHRS, *GNSS)
    holds = {"f_left": "zero", "f_right": "linear"}
    model = choose_model("auto", [loaded(*names, holds=holds)])
    assert {i.name: i.hold for i in model.inputs} == holds


@pytest.mark.parametrize(
    ("ways", "source", "aged"),
    [
        ((PropulsionInput.MEASURED, PropulsionInput.MEASURED), "horizontal:shaft", False),
        ((PropulsionInput.MEASURED, PropulsionInput.TELEMETRY), "horizontal:shaft", True),
        ((PropulsionInput.COMMAND, PropulsionInput.TELEMETRY), "horizontal:command", False),
    ],
)
def test_thrust_source_is_the_best_that_all_logs_have(
    ways: tuple[PropulsionInput, ...], source: str, aged: bool
) -> None:
    names = ("n_left", "n_right", "n_cmd_left", "n_cmd_right", *AHRS)
    logs = [replace(loaded(*names), propulsion=way) for way in ways]
    model = choose_model("auto", logs)
    assert model.source == source
    assert ("tau_age" in model.values) == aged
    assert ("T_n" in model.values) == (source == "horizontal:command")
    assert thrust_from(model, logs)
    if source == "horizontal:command":
        assert {i.hold for i in model.inputs} == {"average"}
        assert "as usual for logs without shaft speeds, or with" in thrust_from(model, logs)
        measured = [replace(log, propulsion=PropulsionInput.MEASURED) for log in logs]
        assert "as usual" not in thrust_from(model, measured)
    chosen = choose_model("horizontal:shaft", [replace(loaded(*names), propulsion=way) for way in ways])
    assert (chosen.source, "tau_age" in chosen.values) == ("horizontal:shaft", False)


@pytest.mark.parametrize(
    ("names", "way", "message"),
    [
        (("n_left", "n_right"), PropulsionInput.MEASURED, "thrust from the measured shaft speeds"),
        (("n_cmd_left", "n_cmd_right"), PropulsionInput.COMMAND, "no shaft speed is measured"),
        (("n_left", "n_right", "n_cmd_left", "n_cmd_right"), PropulsionInput.MEASURED, "the measured shaft speeds"),
    ],
)
def test_commands_are_not_called_measured_speeds(names: tuple[str, ...], way: PropulsionInput, message: str) -> None:
    log = with_derived_signals(replace(loaded(*names, *AHRS, *GNSS), propulsion=way), "nomoto", None)
    assert message in thrust_from(make_model("nomoto"), [log])
    assert thrust_from(horizontal_model("force"), [log]) == ""


@pytest.mark.parametrize(
    ("source", "hold", "hinted"), [("n_", "zero", True), ("n_", "sampled", False), ("n_cmd_", "zero", False)]
)
def test_shaft_speeds_with_a_zero_hold_are_reported(source: str, hold: str, hinted: bool) -> None:
    """This happens if the rpm of a table is an input and the map has no hold."""
    log = replace(loaded("n_left", "n_right", *AHRS, *GNSS), propulsion=PropulsionInput.COMMAND)
    found = {
        n: replace(c, source=source + n.removeprefix("n_")) if n.startswith("n_") else c
        for n, c in log.run.channels.items()
    }
    log = replace(log, run=replace(log.run, channels=found), holds={**log.holds, "n_left": hold, "n_right": hold})
    note = thrust_from(make_model("nomoto"), [with_derived_signals(log, "nomoto", None)])
    assert ('hold = "linear" in the import map' in note) == hinted


@pytest.mark.parametrize(("name", "renamed"), [("n_{}", True), ("n_cmd_{}", False)])
def test_another_name_of_the_commands_is_stated_in_one_line(name: str, renamed: bool) -> None:
    t, names = np.arange(5.0), [name.format(side) for side in ("left", "right")]
    logged = loaded(*AHRS, *GNSS, holds=dict.fromkeys(names, "zero"))
    found = {**logged.run.channels, **{n: Channel(t, t, source=n) for n in names}}
    logged = replace(logged, run=replace(logged.run, channels=found), propulsion=PropulsionInput.COMMAND)
    log = with_derived_signals(logged, "auto", None)
    model = choose_model("auto", [log])
    assert {i.name for i in model.inputs if not i.tap} >= {"n_cmd_left", "n_cmd_right"}
    line = thrust_from(model, [log])
    assert "\n" not in line
    text = "the logs have these commands as n_left and n_right, and the model calls them n_cmd_left and n_cmd_right"
    assert (text in line) == renamed


def test_inputs_that_only_some_logs_have_are_not_used() -> None:
    with pytest.raises(SeatrialError, match=r"run\.mcap: no inputs for the horizontal model .*; the log has psi, r"):
        choose_model("auto", [loaded("n_left", "n_right", "psi", "r"), loaded("psi", "r")])


def test_log_with_pulses_only_is_rejected_with_advice() -> None:
    with pytest.raises(
        SeatrialError, match=r"the log has psi, pwm_left, pwm_right, r; a pulse width is no shaft speed: import"
    ):
        choose_model("auto", [loaded("pwm_left", "pwm_right", "psi", "r")])


def test_positions_of_the_thrusters_are_no_parameters_of_nomoto() -> None:
    """In the rig they are ignored, so the message about the option says that the model does not use them."""
    model, notes = apply_rig_geometry(nomoto_model(), rig_of("boat"))
    assert (model.values, notes) == (nomoto_model().values, [])
    with pytest.raises(
        SeatrialError,
        match=r"--fix y_left: model nomoto has no such parameter; it has m_u, .*; the model does not use the positions "
        r"of the thrusters, because its steering gain K contains them: leave out --fix y_left$",
    ):
        fix_parameters(nomoto_model(), None, {"y_left": -0.2})
    with pytest.raises(SeatrialError, match=r"leave out --prior y_right$"):
        set_priors(nomoto_model(), {"y_right": (0.2, 0.01)})
    with pytest.raises(SeatrialError, match=r"--initial tau_nn: .*; did you mean 'tau_n'\?$"):
        set_initial_values(nomoto_model(), {"tau_nn": 0.1})


def test_known_parameters_are_fixed() -> None:
    model, _ = fix_parameters(apply_rig_geometry(horizontal_model(), rig_of("boat"))[0], None, {"d_uu": 30.0})
    assert (model.values["d_vv"], model.values["d_uu"]) == (20.0, 30.0)
    assert model.parameter("d_vv").free
    assert not model.parameter("d_uu").free
    assert (model.values["y_left"], model.values["y_right"]) == (-0.15, 0.15)
    with pytest.raises(
        SeatrialError,
        match=r"--fix mass: model horizontal has no such parameter; it has m_u, .*; the weighed mass is --mass=37; m_u",
    ):
        fix_parameters(horizontal_model(), None, {"mass": 37.0})
    with pytest.raises(
        SeatrialError, match=r"; it is a parameter of the effect lift: add --effect lift, and --no-score"
    ):
        fix_parameters(horizontal_model(), None, {"Y_uv": 0.0})
    with pytest.raises(SeatrialError, match=r"--fix d_uux: .*; did you mean 'd_uu'\?$"):
        fix_parameters(horizontal_model(), None, {"d_uux": 1.0})
    with pytest.raises(SeatrialError, match=r"--fix m_u=-1: parameter m_u: -1\.0 is not positive"):
        fix_parameters(horizontal_model(), None, {"m_u": -1.0})
    with pytest.raises(SeatrialError, match=r"--initial m_u=-1: parameter m_u: -1\.0 is not positive"):
        set_initial_values(horizontal_model(), {"m_u": -1.0})
    with pytest.raises(SeatrialError, match=r"the rig file or the import map gives m_u = -1: .*; correct it there"):
        apply_rig_geometry(horizontal_model(), None, {"m_u": -1.0})


def test_given_thrust_that_is_not_positive_is_rejected() -> None:
    """Only a given c2 is checked, against c1 of any source."""
    astern = "c2 = 12 N is not smaller than c1 = 6.85 N: the thrust astern, c1 - c2, would not be positive; correct"
    mapped, _ = apply_rig_geometry(horizontal_model(), None, {"c1": 6.85})
    for model, fixed in (
        (horizontal_model(), {"c1": 6.85, "c2": 12.0}),
        (mapped, {"c2": 12.0}),
        (apply_rig_geometry(horizontal_model(), None, {"c1": 6.85, "c2": 12.0})[0], {}),
        (set_priors(mapped, {"c2": (12.0, 0.5)}), {}),
    ):
        with pytest.raises(SeatrialError, match=f"^{re.escape(astern)}"):
            fix_parameters(model, None, fixed)
    with pytest.raises(SeatrialError, match=r"c2 = -9 N and c1 = 6\.85 N: the thrust ahead, c1 \+ c2, would not be"):
        fix_parameters(mapped, None, {"c2": -9.0})
    with pytest.raises(SeatrialError, match=r"c2 = 50 N is not smaller than c1 = 40\.05 N \(built in\)"):
        fix_parameters(horizontal_model(), None, {"c2": 50.0})
    with pytest.raises(SeatrialError, match=r"--fix c1=-1: parameter c1: -1\.0 is not positive"):
        fix_parameters(horizontal_model(), None, {"c1": -1.0})
    model, _ = fix_parameters(horizontal_model(), None, {"c1": 1.0})  # the built-in c2 is larger, and is estimated
    assert model.values["c1"] == 1.0


@pytest.mark.parametrize(
    ("name", "parameter"), [("thrust-angle", "x_delta"), ("propeller-walk", "x_walk"), ("swinging-mount", "x_swing")]
)
def test_position_of_the_thrusters_is_the_prior_in_the_effects_that_have_it(name: str, parameter: str) -> None:
    """The option --prior replaces it."""
    boat = {"m_u": 80.0, "x_thrusters": -0.9, "x_thrusters_sd": 0.02}
    model, notes = apply_rig_geometry(horizontal_model(), None, boat)
    assert notes == []
    p = with_effects(model, [name]).parameter(parameter)
    assert (p.value, p.prior, p.free, p.origin) == (-0.9, (-0.9, 0.02), True, ParameterOrigin.PRIOR)
    (effect,) = with_effects(model, [name]).effects
    assert effect.scan.get(parameter, (-0.9,)) == (-0.9,)
    default, _ = apply_rig_geometry(horizontal_model(), None, {"x_thrusters": 0.0})
    assert with_effects(default, [name]).parameter(parameter).prior == (0.0, 0.05)
    changed = set_priors(with_effects(model, [name]), {parameter: (-0.7, 0.1)})
    assert changed.parameter(parameter).prior == (-0.7, 0.1)
    without, _ = apply_rig_geometry(horizontal_model(), None, {})
    built_in = with_effects(without, [name]).parameter(parameter)
    assert (built_in.prior, built_in.origin) == ((-0.5, 0.3), ParameterOrigin.BUILT_IN)
    with pytest.raises(SeatrialError, match=r"^the rig file or the import map gives x_thrusters_sd = 0: a standard"):
        apply_rig_geometry(horizontal_model(), None, {"x_thrusters": -0.9, "x_thrusters_sd": 0.0})


@pytest.mark.parametrize("antenna", [{}, {"antenna_x": 0.3, "antenna_y": 0.0, "antenna_z": -0.2}])
def test_uncertainty_of_the_antennas_position_is_the_prior_of_the_lever_arm(antenna: dict[str, float]) -> None:
    model, notes = apply_rig_geometry(horizontal_model(), None, {**antenna, "lever_arm_sd": 0.02})
    assert notes == []
    arm = with_effects(model, ["lever-arm"])
    for name in ("l_x", "l_y"):
        p = arm.parameter(name)
        assert (p.prior, p.free, p.origin) == ((0.0, 0.02), True, ParameterOrigin.PRIOR)
        assert p.meaning.endswith(" (prior: lever_arm_sd)")
    without, _ = apply_rig_geometry(horizontal_model(), None, antenna)
    assert with_effects(without, ["lever-arm"]).parameter("l_x").origin is ParameterOrigin.BUILT_IN
    with pytest.raises(SeatrialError, match=r"^the rig file or the import map gives lever_arm_sd = -1: a standard"):
        apply_rig_geometry(horizontal_model(), None, {**antenna, "lever_arm_sd": -1.0})


def test_position_of_the_thrusters_of_the_rig_file_is_the_prior_and_named_as_its_source() -> None:
    rig = rig_of("boat")
    (place,) = {t.position_m[0] for t in rig.thrusters}
    assert place < 0.0

    def position(rig: Rig, boat: dict[str, float] | None = None) -> Parameter:
        return with_effects(apply_rig_geometry(horizontal_model(), rig, boat)[0], ["thrust-angle"]).parameter("x_delta")

    found = position(rig)
    assert (found.value, found.prior, found.origin) == (place, (place, 0.05), ParameterOrigin.PRIOR)
    assert found.meaning.endswith(" (prior: position_m of the thrusters in the rig file)")
    assert position(rig, {"x_thrusters_sd": 0.02}).prior == (place, 0.02)
    given = position(rig, {"x_thrusters": -0.7})
    assert (given.prior, given.meaning.endswith(" (prior: x_thrusters)")) == ((-0.7, 0.05), True)
    for places in ((0.0, 0.0), (place, place - 0.1)):  # unknown, and not shared
        moved = [replace(t, position_m=(x, *t.position_m[1:])) for t, x in zip(rig.thrusters, places, strict=True)]
        assert position(replace(rig, thrusters=tuple(moved))).origin is ParameterOrigin.BUILT_IN


def test_thrusters_at_one_place_are_rejected() -> None:
    mapped, _ = apply_rig_geometry(horizontal_model(), None, {"y_left": -0.3, "y_right": 0.285})
    with pytest.raises(
        SeatrialError, match=r"^y_left = 0\.285 m and y_right = 0\.285 m: both thrusters are at the same"
    ):
        fix_parameters(mapped, None, {"y_left": 0.285})
    model, _ = fix_parameters(mapped, None, {"y_left": 0.285, "y_right": -0.285})  # as on a boat with swapped columns
    assert model.values["y_left"] == 0.285


def test_range_of_a_state_is_not_that_of_an_input_with_the_same_name() -> None:
    """The range of the yaw rate of ``kinematic:shaft:yaw`` is 1 % to 99 % of the filtered state, not that of the
    gyro.
    """
    channels, _ = rolling_sail(Fitted(), 40.0, 4)
    fitted = fit_nominal_model(make_model("kinematic:shaft:yaw"), [LogSegment("run", channels)], [], rate=20.0)
    (view,) = fitted.estimation
    r = view.run.x_filt[:, [s.name for s in fitted.model.states].index("r")]
    ranges = validity(fitted)
    assert ranges["r"] == pytest.approx(tuple(np.percentile(r, (1, 99))))
    assert ranges["r"][1] < view.record.u[:, list(view.record.inputs).index("r")].max()
    assert {"u", "v", "n_left", "phi", "q"} <= set(ranges)


def test_sensor_rates_equal_the_rate_of_the_rows(tmp_path: Path) -> None:
    """A rate of 50 Hz is averaged to 10 Hz; 5 Hz stays. If a log lacks a sensor, the rate comes from the other log."""
    logs = [load_run(boat_log(tmp_path / f"{k}.mcap", boat_with(None, 1), 30.0, k), "estimation").run for k in (1, 2)]
    blind = replace(logs[1], channels={k: c for k, c in logs[1].channels.items() if k not in ("x", "y")})
    model = horizontal_model("shaft", ("attitude", "position")).with_free(["d_vv"])
    rates = sensor_rates(fit_nominal_model(model, [logs[0], blind], []))
    assert rates == {"attitude": pytest.approx(10.0, rel=0.05), "position": pytest.approx(5.0, rel=0.05)}


def test_sensor_rates_do_not_depend_on_the_rows_of_a_search(tmp_path: Path) -> None:
    """With 5 rows per second, means of 0.1 s have the noise of rows at 10 Hz, at which a later fit uses the sensor."""
    log = load_run(boat_log(tmp_path / "a.mcap", boat_with(None, 1), 60.0, 1), "estimation").run
    model = horizontal_model("shaft", ("attitude", "position")).with_free(["d_vv"])
    usual = fit_nominal_model(model, [log], [])
    coarse = fit_nominal_model(replace(model, max_step=0.2), [log], [], rate=5.0)
    assert np.isfinite(coarse.estimation[0].record.y[:, 0]).sum() < 0.6 * usual.estimation[0].record.y[:, 0].size
    rates = sensor_rates(coarse)
    assert rates == pytest.approx(sensor_rates(usual), rel=0.05)
    assert rates == {"attitude": pytest.approx(10.0, rel=0.05), "position": pytest.approx(5.0, rel=0.05)}
    noises = [x.model.parameter("e_psi").value for x in (coarse, usual)]
    assert noises[0] == pytest.approx(noises[1], rel=0.2)
    assert sensor_rates(fit_nominal_model(replace(model, max_step=0.5), [log], [], rate=2.0))["attitude"] < 4.5


def test_logs_with_the_same_file_name_get_different_names(tmp_path: Path) -> None:
    """Validation runs are paired by name. Two runs with the same name would be compared with each other."""
    (tmp_path / "mon").mkdir()
    first = boat_log(tmp_path / "mon" / "run.mcap", boat_with(None, 1), 20.0, 7)
    same, alone = [tmp_path / d / "run.mcap" for d in ("tue", "b/mon")], tmp_path / "tue" / "alone.mcap"
    for path in (*same, alone):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(first.read_bytes())
    loaded, unseen = load_all([first, alone], same)
    names = ["mon/run", "alone", "tue/run", "mon/run (2)"]
    assert [x.run.name for x in (*loaded, *unseen)] == [x.about["name"] for x in (*loaded, *unseen)] == names
    assert [x.about["path"] for x in unseen] == ["tue/run.mcap", "mon/run.mcap (2)"]
    assert [x.run.name for x in load_runs([alone], "judged")] == ["alone"]


def test_log_is_loaded_with_times_from_its_own_start(tmp_path: Path) -> None:
    path = boat_log(tmp_path / "a.mcap", boat_with(None, 1), 20.0, 7)
    found = load_run(path, "estimation", TimeWindow(3.0, 9.0))
    assert (found.run.t_from, found.run.t_to, found.run.name) == (3.0, 9.0, "a")
    assert min(c.t[0] for c in found.run.channels.values()) == 0.0
    about: Any = found.about
    assert (about["role"], about["rig"], about["mission"]) == ("estimation", "mock boat", "mixed, seed 7")
    assert about["duration"] == pytest.approx(6.0)
    assert load_run(path, "estimation").about["duration"] == pytest.approx(20.0, abs=0.1)
    assert about["warnings"] == []


@pytest.mark.parametrize(
    ("reached", "words"), [(0.9, "At full command the shafts turn at 0.90 (run) times full speed"), (0.995, "")]
)
def test_thrust_for_commands_that_do_not_reach_full_speed_gives_a_warning(reached: float, words: str) -> None:
    t = np.arange(0.0, 120.0, 0.1)
    command = np.repeat(np.random.default_rng(2).uniform(0.2, 0.9, 20), 60)
    c = {}
    for side in ("left", "right"):
        c |= {f"n_cmd_{side}": Channel(t, command, hold="zero"), f"n_{side}": Channel(t + 1e-3, reached * command)}
    log = LoadedLog(LogSegment("run", c), {}, {}, None)
    for inputs in ("command", "shaft"):
        model, _ = fix_parameters(horizontal_model(inputs), None, {"c1": 40.0, "c2": 0.0})
        found = _command_scale(model, [log])
        assert (found is not None) == bool(words and inputs == "command")
        assert found is None or (words in found.text and "give c1 = 32.4 N, and 0.81 of c2" in found.text)
        assert found is None or "If it was measured at full command, the masses are right" in found.text
        assert found is None or found.text.count("If ") == 2
        assert found is None or "all masses are 1.23 times their true value" in found.text
    assert _command_scale(horizontal_model("command"), [log]) is None


def test_shafts_a_little_slower_than_their_commands_have_a_note() -> None:
    """The thrust is 4 % smaller, so that all masses are 4 % larger than with the shaft speeds."""
    t = np.arange(0.0, 120.0, 0.1)
    command = np.repeat(np.random.default_rng(2).uniform(0.2, 0.9, 20), 60)
    c = {f"n_cmd_{side}": Channel(t, command, hold="zero") for side in ("left", "right")}
    c |= {f"n_{side}": Channel(t + 1e-3, 0.98 * command) for side in ("left", "right")}
    model, _ = fix_parameters(horizontal_model("command"), None, {"c2": 0.0})
    given = replace(model.parameter("c1"), value=41.5, prior=(41.2, 2.1), origin=ParameterOrigin.PRIOR)
    model = replace(model, parameters=tuple(given if p.name == "c1" else p for p in model.parameters))
    found = _command_scale(model, [LoadedLog(LogSegment("run", c), {}, {}, None)])
    assert found is not None
    assert not found.matters
    assert (
        "shafts turn at 0.980 (run) times full speed, so that their thrust is 0.960 of that at full speed" in found.text
    )
    assert "all masses are 1.041 times their true value: give c1 = 39.57 N, and 0.960 of c2" in found.text


def test_warning_of_the_scale_of_commands_ends_with_the_scale_that_it_asks_for() -> None:
    t = np.arange(0.0, 120.0, 0.1)
    command = np.repeat(np.random.default_rng(2).uniform(0.2, 0.9, 20), 60)
    model, _ = fix_parameters(horizontal_model("command"), None, {"c1": 40.0, "c2": 0.0})

    def warning(of_shaft: float = 1.0) -> str:
        logs = []
        for name, reached in (("full", 0.93), ("low", 0.87)):
            c = {}
            for side in ("left", "right"):
                c[f"n_cmd_{side}"] = Channel(t, command, hold="zero")
                c[f"n_{side}"] = Channel(t + 1e-3, of_shaft * reached * command)
            logs.append(LoadedLog(LogSegment(name, c), {}, {}, None))
        found = _command_scale(model, logs)
        return "" if found is None else found.text

    (shafts,) = re.findall(r"the scale of the shaft speeds in the import map by ([\d.]+) ", warning())
    assert not warning(of_shaft=1.0 / float(shafts))


def test_ranges_and_curves_of_commands_are_those_that_were_given() -> None:
    """Commands act by their mean in a row; the line of such a row overshoots a step of the command by up to a third."""
    channels = channels_of(sail(boat_with(None, 1), 30.0, 1)[0])
    t = channels["psi"].t
    square = {"n_cmd_left": (0.15, 1.7), "n_cmd_right": (-0.2, 2.3)}
    steps = np.arange(t[0], t[-1], 0.07)
    for name, (mean, period) in square.items():
        channels[name] = Channel(steps, mean + 0.4 * np.sign(np.sin(2.0 * np.pi * steps / period + 0.1)))
    model = horizontal_model("command", ("attitude", "position"))
    assert {i.hold for i in model.inputs} == {"average"}
    fitted = fit_nominal_model(model, [LogSegment("run", channels)], [])
    (view,) = fitted.estimation
    assert view.record.u.max() > 0.6
    ranges = validity(fitted)
    shown = {row.name: row.value for row in record_inputs(fitted.model, view.record)}
    for name, (mean, _) in square.items():
        assert ranges[name] == pytest.approx((mean - 0.4, mean + 0.4), abs=1e-9)
        assert (shown[name].min(), shown[name].max()) == pytest.approx(ranges[name])
