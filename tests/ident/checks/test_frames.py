"""Tests of mirrored signals, smoothed signals, frozen signals, copies, and the lower bound of noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seatrial.ident.checks.frames import Relation, _reversed_column, check_frames, mirrored_signals
from seatrial.ident.checks.log_checks import check_copies, check_signals
from seatrial.ident.checks.sensors import sensor_matches
from seatrial.ident.checks.signals import FILTER_NOISE, check_frozen, estimated, noise_floor, smoothed
from seatrial.ident.data.loading import LoadedLog
from seatrial.ident.data.record import Channel, LogSegment
from seatrial.ident.estimation.prior_knowledge import fix_parameters
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.nomoto import nomoto_model
from seatrial.ident.workflows.check import (
    check_first,
    signals_of_given_noise,
    with_estimator_errors,
    with_noise_floors,
)
from seatrial.ident.workflows.vehicle_model import VehicleRequest, vehicle_problem
from tests.missions import boat_with, channels_of, sail

SIDES = {"left": -0.15, "right": 0.15}
ALL: tuple[Relation, ...] = (
    ("position", "heading"), ("velocity", "heading"), ("position", "velocity"), ("heading", "gyro"),
    ("thrusters", "gyro"), ("thrusters", "heading"),
)  # fmt: skip


def signs(*mirrored: str, known: tuple[Relation, ...] = ALL) -> Mapping[Relation, int]:
    """Return the signs of the relations if these signals are mirrored and all others are right."""
    return {pair: 1 - 2 * (len(set(pair) & set(mirrored)) % 2) for pair in known}


@pytest.mark.parametrize("signal", ["heading", "gyro", "position", "velocity", "thrusters"])
def test_one_mirrored_signal_is_named(signal: str) -> None:
    assert mirrored_signals(signs(signal)) == (signal,)


@pytest.mark.parametrize("signal", ["psi", "r"])
def test_advice_on_a_wrong_sign_suits_a_map_with_a_sign_and_one_without(run: dict[str, Channel], signal: str) -> None:
    c = run | {signal: replace(run[signal], value=-run[signal].value)}
    (found,) = [f for f in check_signals(c, {"left": -0.3, "right": 0.3}) if f.level == "fault"]
    assert f"change the sign of {signal} in the import map (sign = -1, or remove it if it is there)" in found.advice


def test_two_mirrored_signals_of_one_device_are_named() -> None:
    assert mirrored_signals(signs()) is None
    assert mirrored_signals({}) is None
    assert mirrored_signals(signs("heading", "gyro")) == ("gyro", "heading")
    assert mirrored_signals(signs("position", "velocity")) == ("position", "velocity")


def test_signals_that_cannot_be_distinguished_are_named_together() -> None:
    assert mirrored_signals(signs("heading", known=(("position", "heading"),))) == ("heading", "position")
    known: tuple[Relation, ...] = (("position", "heading"), ("heading", "gyro"))
    assert mirrored_signals(signs("position", known=known)) == ("gyro", "heading", "position")
    assert mirrored_signals(signs("gyro", known=known)) == ("gyro",)


@pytest.fixture(scope="module")
def run() -> dict[str, Channel]:
    return channels_of(sail(boat_with(None, 3), 120.0, 5)[0])


def dashes(seed: int, heading: float = 1.4) -> dict[str, Channel]:
    """Return positions, heading and body velocities of a boat that is fast in three of fifteen blocks of 10 s only.

    It heads about east (1.4 rad), turns little, and slips to port.
    """
    rng = np.random.default_rng(seed)
    t = 0.1 * np.arange(1500)
    fast = sum(np.exp(-0.5 * ((t - at) / 3.0) ** 2) for at in (25.0, 75.0, 125.0))
    psi = heading + 0.5 * np.sin(0.11 * t)
    u, v = 0.02 + 2.0 * fast, -0.2 * fast
    track = np.cumsum((u + 1j * v) * np.exp(1j * psi)) * 0.1
    noise = 0.02 * rng.standard_normal((4, t.size))
    signals = {"x": track.real, "y": track.imag, "u": u, "v": v}
    return {n: Channel(t, x + e) for (n, x), e in zip(signals.items(), noise, strict=True)} | {"psi": Channel(t, psi)}


@pytest.mark.parametrize(
    ("wrong", "code", "text"),
    [
        ({}, None, ""),
        ({"u": ("u", 3.6), "v": ("v", 3.6)}, "velocity-unit", "are its numbers in km/h and taken as m/s?"),
        ({"u": ("u", 1 / 0.5144)}, "velocity-unit", "are its numbers in knots and taken as m/s?"),
        ({"x": ("x", 100.0), "y": ("y", 100.0)}, "velocity-unit", "is it in another unit?"),
        ({"u": ("v", 1.0), "v": ("u", 1.0)}, "body-velocity-axes", "the two are exchanged"),
        ({"x": ("y", 1.0), "y": ("x", 1.0)}, "heading-offset", "or north and east are exchanged"),
        ({"y": ("y", -1.0)}, "position-axes", "in x, y, the second sign is reversed"),
    ],
)
def test_few_fast_dashes_show_units_and_axes(wrong: dict[str, tuple[str, float]], code: str | None, text: str) -> None:
    run = dashes(4)
    c = run | {name: replace(run[of], value=scale * run[of].value) for name, (of, scale) in wrong.items()}
    found = list(check_frames(c, None, {}))
    assert [f.code for f in found] == ([] if code is None else [code])
    assert not found or found[0].text.endswith(text)


@pytest.mark.parametrize("to_port", [False, True])
def test_velocity_in_body_axes_is_no_velocity_over_ground(to_port: bool) -> None:
    """The twist of an odometry message is in body axes: forward and, in ROS, to port."""
    run = dashes(4, 0.2 if to_port else 1.4)
    psi, u, v = (run[n].value for n in ("psi", "u", "v"))
    over_ground = (u + 1j * v) * np.exp(1j * psi)
    right = {n: run[n] for n in ("x", "y", "psi")}
    for vx, vy, codes in (
        (over_ground.real, over_ground.imag, []),
        (-v if to_port else u, u if to_port else v, ["velocity-body-fixed"]),  # taken as east, north: exchanged
    ):
        c = right | {"vx": Channel(run["x"].t, vx), "vy": Channel(run["x"].t, vy)}
        assert [f.code for f in check_frames(c, None, {})] == codes


def filtered(c: Channel, samples: int = 25) -> Channel:
    """Smooth a signal by several passes of a moving mean."""
    value, kernel = np.unwrap(c.value), np.full(samples, 1.0 / samples)
    for _ in range(4):
        value = np.convolve(np.pad(value, samples // 2, mode="edge"), kernel, mode="valid")
    return Channel(c.t, value, c.unit)


def test_smoothed_signal_is_reported_and_its_noise_has_a_lower_bound(run: dict[str, Channel]) -> None:
    assert smoothed(run) == ()
    assert noise_floor(run["r"]) == pytest.approx(0.01, rel=0.2)  # This is the noise of the simulated gyro.
    ekf = run | {"r": filtered(run["r"])}
    assert smoothed(ekf) == ("r",)
    assert [f.code for f in check_signals(ekf, SIDES) if f.level == "warning"] == ["channel-smoothed"]
    log = LoadedLog(LogSegment("run", ekf), {}, {}, None)
    model, notes = with_noise_floors(horizontal_model(), [log])
    assert model.parameter("e_r").bounds[0] == 0.005
    assert model.parameter("e_r").value > 0.005
    assert model.parameter("e_psi") == horizontal_model().parameter("e_psi")
    (note,) = notes
    assert "its estimate is at least that of a usual sensor (e_r 0.005 rad/s); --fix e_r=VALUE" in note
    assert with_noise_floors(horizontal_model(), [])[1] == []


def test_advice_on_a_smoothed_signal_is_what_the_fit_does(run: dict[str, Channel]) -> None:
    """Beside the position of an estimator, the lasting errors of the heading are states, and its noise has no floor."""
    ekf = run | {"psi": filtered(run["psi"])}
    for channels, states in ((ekf, False), (ekf | {n: filtered(run[n]) for n in ("x", "y")}, True)):
        (finding,) = [f for f in check_signals(channels, SIDES) if f.code == "channel-smoothed"]
        log = LoadedLog(LogSegment("run", channels), {}, {}, None)
        model, _ = with_noise_floors(with_estimator_errors(horizontal_model(), [log])[0], [log])
        assert (model.parameter("e_psi").bounds[0] < 0.001) is states
        assert ("a fit estimates these errors as states" in finding.advice) is states
        assert ("a fit takes at least the noise of a usual sensor" in finding.advice) is not states
        wanted = "--fix e_xy=0.3 --fix e_psi=0.03 (in m, rad)" if states else "for example --fix e_psi=0.03 (in rad)"
        assert finding.advice.endswith(wanted)


@pytest.mark.parametrize(
    "sensors", ["attitude gyro position body_velocity", "attitude gyro accelerometer position ground_velocity"]
)
def test_advice_on_smoothed_signals_names_the_noises_of_the_models(sensors: str) -> None:
    model = horizontal_model(sensors=tuple(sensors.split()))
    for output in model.outputs:
        name, size, _ = FILTER_NOISE[output.name]
        assert name == output.noise
        fix_parameters(model, None, {name: size})


def test_noise_that_the_user_gave_is_not_reported_as_smoothed(run: dict[str, Channel]) -> None:
    ekf = run | {n: filtered(run[n]) for n in ("psi", "r")}
    log = LoadedLog(LogSegment("run", ekf), {"path": "run"}, {}, None, device_faults=[])
    model, _ = fix_parameters(horizontal_model(), None, {"e_psi": 0.03})
    assert signals_of_given_noise(horizontal_model()) == set()
    assert signals_of_given_noise(model) == {"psi"}
    for fitted, named in ((horizontal_model(), "psi, r"), (model, "r")):
        (checked,), _ = check_first([log], [], fitted, True)
        smooth = [f["where"] for f in checked.about["findings"] if f["code"] == "channel-smoothed"]
        assert smooth == [named]
        assert with_noise_floors(fitted, [log])[1][0].startswith(f"Smoothed signals ({named}): ")
    known, _ = fix_parameters(horizontal_model(), None, {"e_psi": 0.03, "e_r": 0.01})
    (checked,), _ = check_first([log], [], known, True)
    assert "channel-smoothed" not in {f["code"] for f in checked.about["findings"]}
    assert with_noise_floors(known, [log])[1] == []


def test_position_of_an_estimator_gets_correlated_errors(run: dict[str, Channel]) -> None:
    assert not estimated(run)
    smooth = run | {n: filtered(run[n], 5) for n in ("x", "y", "psi")}
    assert estimated(smooth)
    log = LoadedLog(LogSegment("run", smooth), {}, {}, None)
    model, notes = with_estimator_errors(horizontal_model(), [log])
    assert len(notes) == 1
    assert notes[0].startswith("The position is probably the output of a navigation filter, or of an RTK receiver: its")
    assert "noise from sample to sample is below 3 cm" in notes[0]
    assert {f"{p}_{of}" for p in ("A", "tau") for of in ("r", "psi", "axy", "vxy", "xy")} <= set(model.free)
    assert "A_psi" in with_estimator_errors(nomoto_model(), [log])[0].free
    again, floor_notes = with_noise_floors(model, [log])  # The white noise may become nearly zero, but not zero.
    assert floor_notes == []
    assert again.parameter("e_psi").bounds[0] == pytest.approx(0.02 * model.parameter("e_psi").value)
    assert again.parameter("e_xy").value == model.parameter("e_xy").value
    assert again.parameter("e_vxy").bounds[0] == 0.02 * model.parameter("e_vxy").value
    # A speed in whole cm/s has at least the error of rounding, for any course.
    speed = np.hypot(smooth["vx"].value, smooth["vy"].value)
    whole = (np.floor(100.0 * speed) + 0.5) / 100.0 / speed
    cm = smooth | {n: replace(smooth[n], value=whole * smooth[n].value) for n in ("vx", "vy")}
    rounded, _ = with_noise_floors(model, [replace(log, run=LogSegment("run", cm))])
    assert rounded.parameter("e_vxy").bounds[0] == pytest.approx(0.01 / np.sqrt(12.0), rel=1e-3)
    assert rounded.parameter("e_xy").bounds == again.parameter("e_xy").bounds
    assert with_estimator_errors(model, [log]) == (model, [])
    assert with_estimator_errors(horizontal_model(), [log], {"e_xy"}) == (horizontal_model(), [])
    assert with_estimator_errors(horizontal_model(), [replace(log, run=LogSegment("run", run))])[1] == []


def test_states_for_errors_of_a_filter_are_no_warning_of_each_fit(run: dict[str, Channel]) -> None:
    """The user heard of RTK in each fit, though nothing is to be done. The result has it as a note."""
    about = {"path": "run", "duration": 60.0, "name": "run"}
    log = LoadedLog(LogSegment("run", run | {n: filtered(run[n], 5) for n in ("x", "y")}), about, {}, None)
    problem = vehicle_problem(VehicleRequest((), (), Path()), [log], [])
    assert "RTK" in " ".join(problem.noise_notes)
    assert "RTK" not in " ".join(problem.notes)


def test_signals_of_a_boat_at_rest_are_not_frozen(run: dict[str, Channel]) -> None:
    t = run["psi"].t
    held = {n: Channel(c.t, np.where((c.t > 30.0) & (c.t < 60.0), c.value[np.searchsorted(c.t, 30.0)], c.value))
            for n, c in run.items()}  # fmt: skip
    still = Channel(t, np.where((t > 30.0) & (t < 60.0), 0.0, run["r"].value))
    assert not list(check_frozen({"psi": held["psi"], "r": still}))
    (found,) = check_frozen(run | {"r": held["r"]})
    assert found.code == "channel-frozen"
    assert "or leave the signal out of the map" in found.advice
    assert [f.code for f in check_frozen(run | {"x": held["x"], "y": held["y"]})] == ["channel-frozen"] * 2
    apart = {f"n_{side}": replace(run["n_left"], value=sign * np.abs(run["n_left"].value))
             for side, sign in (("left", 1.0), ("right", -1.0))}  # fmt: skip
    on_the_spot = run | apart | {"x": held["x"], "y": held["y"]}
    assert not list(check_frozen(on_the_spot))
    rounded = Channel(t, np.round(run["psi"].value, 1))  # A coarse compass repeats its values.
    assert not list(check_frozen(run | {"psi": rounded}))


@pytest.mark.parametrize("kind", ["n", "f", "n_cmd"])
def test_frozen_gyro_of_a_boat_with_one_thruster_is_found(run: dict[str, Channel], kind: str) -> None:
    boat = {n: run[n] for n in ("psi", "x", "y")} | {"r": hung(run["r"], 30.0, 60.0), f"{kind}_left": run["n_left"]}
    assert [f.where for f in check_frozen(boat)] == ["r"]


def test_sample_of_one_velocity_component_may_be_missing(run: dict[str, Channel]) -> None:
    whole = sensor_matches(run).position
    vx = run["vx"]
    found = sensor_matches(run | {"vx": replace(vx, t=np.delete(vx.t, 100), value=np.delete(vx.value, 100))}).position
    assert whole is not None
    assert found is not None
    assert found.scale == pytest.approx(whole.scale, rel=0.01)


def quiet_boat(left: float, right: float) -> dict[str, Channel]:
    """Simulate a boat without noise. The thrust oscillates, and has these values for 25 s.

    2 u' = 25 (n_left + n_right) - u|u| / 2, r = u (n_left - n_right). Accelerations have steps of 1 mg, speeds of 1
    mm/s.
    """
    t = np.arange(0.0, 200.0, 0.01)
    n = 0.3 + 0.2 * np.column_stack([np.sin(t), np.sin(1.3 * t)])
    n[(t > 60.0) & (t < 85.0)] = left, right
    u = np.zeros(t.size)
    for k in range(1, t.size):
        u[k] = u[k - 1] + 0.01 * (12.5 * n[k - 1].sum() - 0.25 * u[k - 1] * abs(u[k - 1]))
    r = u * (n[:, 0] - n[:, 1])
    psi = np.cumsum(r) * 0.01
    vx, vy = u * np.cos(psi), u * np.sin(psi)
    mg = 9.80665e-3
    found = {"ax": mg * np.round(np.gradient(u, 0.01) / mg), "ay": mg * np.round(u * r / mg), "psi": psi, "r": r}
    channels = {name: Channel(t[::4], value[::4]) for name, value in found.items()}
    late = {name: np.interp(t - 0.1, t, value) for name, value in (("vx", vx), ("vy", vy))}
    channels |= {name: Channel(t[::20], np.round(value, 3)[::20]) for name, value in late.items()}
    channels |= {place: Channel(t[::20], np.cumsum(late[f"v{place}"])[::20] * 0.01) for place in ("x", "y")}
    return channels | {f"n_cmd_{side}": Channel(t[::4], n[::4, i]) for i, side in enumerate(("left", "right"))}


def hung(c: Channel, begin: float, end: float) -> Channel:
    """Return the signal with its value at ``begin`` held until ``end``."""
    return replace(c, value=np.where((c.t > begin) & (c.t < end), c.value[np.searchsorted(c.t, begin)], c.value))


@pytest.mark.parametrize("sides", [(0.4, 0.4), (0.5, 0.3)])
def test_steady_motion_without_noise_is_not_frozen_but_a_stuck_sensor_is(sides: tuple[float, float]) -> None:
    boat = quiet_boat(*sides)
    assert not list(check_frozen(boat))
    for names in (("ax", "ay"), ("vx", "vy")):
        for begin in (20.0, 120.0):
            stuck = {name: hung(boat[name], begin, begin + 30.0) for name in names}
            assert [(f.where, f.code) for f in check_frozen(boat | stuck)] == [(n, "channel-frozen") for n in names]


@pytest.mark.parametrize(
    ("factor", "level", "code"),
    [
        (1.0, None, None),
        (1.9, "warning", "acceleration-larger-than-motion"),  # a boat that heels 5 deg where it turns with 1 m/s2
        (1 / 9.81, "fault", "velocity-and-acceleration-scale"),
        (3.28, "fault", "velocity-and-acceleration-scale"),  # in ft/s2
    ],
)
def test_a_boat_that_heels_is_no_wrong_unit(
    run: dict[str, Channel], factor: float, level: str | None, code: str | None
) -> None:
    c = run | {n: replace(run[n], value=factor * run[n].value) for n in ("ax", "ay")}
    found = [(f.level, f.code) for f in check_signals(c, SIDES) if f.where == "ax, ay"]
    assert found == ([] if level is None else [(level, code)])


def test_stuck_noisy_accelerometer_is_frozen_in_steady_motion() -> None:
    boat, rng = quiet_boat(0.4, 0.4), np.random.default_rng(1)
    noisy = {n: replace(boat[n], value=boat[n].value + 0.05 * rng.normal(size=boat[n].t.size)) for n in ("ax", "ay")}
    assert not list(check_frozen(boat | noisy))
    stuck = {name: hung(c, 70.0, 80.0) for name, c in noisy.items()}
    assert [f.where for f in check_frozen(boat | stuck)] == ["ax", "ay"]


def test_part_of_a_log_is_found_as_a_copy(run: dict[str, Channel]) -> None:
    later = {n: Channel(c.t[c.t > 60.0] - 60.0, c.value[c.t > 60.0]) for n, c in run.items()}
    second_run = channels_of(sail(boat_with(None, 3), 120.0, 5, run=2)[0])
    assert [f.where for f in check_copies([("a", run), ("b", second_run), ("c", later)])] == ["c"]


def test_value_with_an_infinite_square_does_not_block_the_search() -> None:
    n = 60
    rng = np.random.default_rng(1)
    columns = tuple(rng.normal(size=n) + 1j * rng.normal(size=n) for _ in range(4))
    columns[0][7] = 1e200
    assert _reversed_column(columns[1], np.repeat(np.arange(6), 10), columns) is None
