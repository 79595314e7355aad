"""Tests from log to channels: signals of the simulated devices, written by the recorder, get the names of ident."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seatrial.bench.mission_generators import make_mission
from seatrial.daq.errors import SeatrialError
from seatrial.daq.geometry import local_ned
from seatrial.daq.log.reader import Log, open_log
from seatrial.daq.samples import NAN, Command, Esc, Gnss, Servo
from seatrial.ident.checks.log_checks import device_faults
from seatrial.ident.data import loading
from seatrial.ident.data.loading import SHAFTS, PropulsionInput, TimeWindow, channels, load_run, propulsion_input
from seatrial.ident.data.record import Channel, make_record
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.mocks.offline_simulation import Recording, simulate
from seatrial.mocks.plant.bench import draw_bench
from seatrial.mocks.sensors import geodetic
from tests.missions import T0, bench_channels_of, boat_log, boat_with, channels_of, push, sail, write_log
from tests.recovery.rig_logs import AUTOPILOT, autopilot_log

NANOSECOND = 2.5e-7  # Resolution of a time in seconds since 1970.


def assert_same(found: dict[str, Channel], wanted: dict[str, Channel]) -> None:
    for name, c in wanted.items():
        np.testing.assert_allclose(found[name].t - T0, c.t, atol=NANOSECOND, err_msg=name)
        np.testing.assert_allclose(found[name].value, c.value, rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.fixture(scope="module")
def boat() -> Recording:
    return sail(boat_with(None, 4), 40.0, 3)[0]


def test_log_of_a_boat_has_every_channel_of_the_model(tmp_path: Path, boat: Recording) -> None:
    with open_log(write_log(tmp_path / "a.mcap", "boat", boat.readings)) as log:
        found = channels(log)
    assert_same(found, channels_of(boat))
    units = {"psi": "rad", "r": "rad/s", "ax": "m/s2", "x": "m", "vx": "m/s", "voltage_left": "V", "n_left": ""}
    assert {n: found[n].unit for n in units} == units
    assert found["psi"].source == "ahrs"
    commands = [
        (r.t, r.sample.n_cmd) for r in boat.readings if type(r.sample).__name__ == "Command" and r.sample.node == 2
    ]
    np.testing.assert_allclose(found["n_cmd_right"].value, [n for _, n in commands], atol=1e-6)
    np.testing.assert_allclose(found["n_cmd_right"].t - T0, [t for t, _ in commands], atol=NANOSECOND)
    truth = boat.truth
    x = np.interp(found["x"].t - T0, truth["t"], truth["x"])
    assert (found["x"].value - x + x[0]).std() < 0.25  # The position is in metres from the first fix.
    n = np.interp(found["n_left"].t - T0, truth["t"], truth["n_left"])
    assert np.abs(np.median(found["n_left"].value - n)) < 0.01


def test_receiver_without_a_course_gives_a_speed(tmp_path: Path, boat: Recording) -> None:
    still = [
        r._replace(sample=replace(r.sample, vel_n=NAN, vel_e=NAN)) if isinstance(r.sample, Gnss) else r
        for r in boat.readings
    ]
    with open_log(write_log(tmp_path / "a.mcap", "boat", still)) as log:
        found = channels(log)
    wanted = channels_of(boat)
    assert not {"vx", "vy"} & found.keys()
    np.testing.assert_allclose(found["speed"].value, np.hypot(wanted["vx"].value, wanted["vy"].value))


def test_log_of_a_bench_has_command_shaft_speed_and_force(tmp_path: Path) -> None:
    run = push(draw_bench(2), kind="steps")[0]
    with open_log(write_log(tmp_path / "b.mcap", "bench", run.readings)) as log:
        found = channels(log)
    assert_same(found, bench_channels_of(run))
    thrust = np.interp(found["force"].t - T0, run.truth["t"], run.truth["thrust"])
    assert np.corrcoef(thrust, found["force"].value)[0, 1] > 0.98


def test_saturated_readings_and_lost_fixes_are_left_out(tmp_path: Path, boat: Recording) -> None:
    run = push(draw_bench(2), kind="steps")[0]
    cells = [r for r in run.readings if r.device == "loadcell"]
    bad = {id(r) for r in cells[10:20]}
    readings = [r._replace(sample=replace(r.sample, flags=1)) if id(r) in bad else r for r in run.readings]
    with open_log(write_log(tmp_path / "b.mcap", "bench", readings)) as log:
        assert channels(log)["force"].t.size == len(cells) - 10
    fixes = [r for r in boat.readings if r.device == "gnss"]
    lost = {id(r) for r in fixes[5:25]}
    readings = [r._replace(sample=replace(r.sample, fix=0)) if id(r) in lost else r for r in boat.readings]
    with open_log(write_log(tmp_path / "c.mcap", "boat", readings)) as log:
        found = channels(log)
    assert found["x"].t.size == found["vy"].t.size == len(fixes) - 20
    assert np.diff(found["x"].t).max() == pytest.approx(21 * 0.2)


def test_unsigned_telemetry_gets_the_sign_of_the_shaft_and_not_of_the_output(tmp_path: Path) -> None:
    """An autopilot logs outputs, and rev/min with the sign of the output at that moment."""
    run = sail(boat_with(None, 4), 120.0, 3)[0]
    commands, readings = {1: 0.0, 2: 0.0}, []
    for r in run.readings:
        if isinstance(r.sample, Command):
            commands[r.sample.node] = r.sample.n_cmd
            readings.append(r._replace(sample=Servo(r.sample.node, 1500.0, r.sample.n_cmd)))
        elif isinstance(r.sample, Esc):
            n = commands[r.sample.node]
            rpm = math.copysign(r.sample.rpm, n) if n else abs(r.sample.rpm)
            r = r._replace(sample=replace(r.sample, rpm=rpm, duty=n))
        readings.append(r)
    with open_log(write_log(tmp_path / "a.mcap", "boat", readings)) as log:
        found = channels(log)
    for side in ("left", "right"):
        c = found[f"n_{side}"]
        truth = np.interp(c.t - T0, run.truth["t"], run.truth[f"n_{side}"])
        naive = np.copysign(c.value, np.interp(c.t, found[f"n_cmd_{side}"].t, found[f"n_cmd_{side}"].value))
        assert np.sqrt(np.mean((naive - truth) ** 2)) > 0.1
        assert np.sqrt(np.mean((c.value - truth) ** 2)) < 0.03


def test_sampled_output_changes_midway_between_its_samples_on_average(tmp_path: Path) -> None:
    boat = sail(boat_with(None, 4), 20.0, 3)[0]
    readings = [r for r in boat.readings if not isinstance(r.sample, Command | Esc)]
    first_command = next(r for r in boat.readings if isinstance(r.sample, Command) and r.sample.node == 1)
    begin = min(r.t for r in readings)
    outputs = [first_command._replace(t=begin + 0.1 * k, sample=Servo(1, 1500.0, 0.5 * (k >= 100))) for k in range(200)]
    readings = sorted(readings + outputs, key=lambda r: r.t)
    with open_log(write_log(tmp_path / "o.mcap", "boat", readings)) as log:
        found = channels(log)["n_cmd_left"]
    assert found.hold == "average"
    assert found.sampled == pytest.approx(0.1)
    middle = found.t[np.argmax(found.value >= 0.25)] - found.t[0]
    assert middle == pytest.approx(9.95, abs=0.011)


def test_local_ned_is_in_metres_on_the_ellipsoid() -> None:
    """The references are the projection of the simulator and a published series of the length of a degree."""
    north, east = np.array([0.0, 120.0, -80.0]), np.array([0.0, -60.0, 200.0])
    lat, lon = np.array([geodetic(n, e) for n, e in zip(north, east, strict=True)]).T
    x, y = local_ned(lat, lon)
    np.testing.assert_allclose(x, north, atol=1e-3)
    np.testing.assert_allclose(y, east, atol=5e-3)
    for degrees in (-70.0, 0.0, 45.0):
        phi = math.radians(degrees)
        per_lat = 111132.92 - 559.82 * math.cos(2 * phi) + 1.175 * math.cos(4 * phi)
        per_lon = 111412.84 * math.cos(phi) - 93.5 * math.cos(3 * phi) + 0.118 * math.cos(5 * phi)
        # The track crosses the date line.
        x, y = local_ned(np.array([degrees, degrees + 1e-3]), np.array([179.9995, -179.9995]))
        assert x[1] == pytest.approx(1e-3 * per_lat, rel=1e-4)
        assert y[1] == pytest.approx(1e-3 * per_lon, rel=1e-4)


def test_propulsion_input_follows_signals_holds_and_rates(tmp_path: Path) -> None:
    run = sail(boat_with(None, 4), 20.0, 3)[0]
    commands = [r for r in run.readings if not isinstance(r.sample, Esc)]
    with open_log(write_log(tmp_path / "a.mcap", "boat", run.readings)) as log:
        found = channels(log)
        assert propulsion_input(log, found, {}) is PropulsionInput.MEASURED
        # A shaft speed does not jump.
        assert propulsion_input(log, found, dict.fromkeys(SHAFTS, "zero")) is PropulsionInput.COMMAND
        slow = found | {n: Channel(found[n].t[::6], found[n].value[::6]) for n in SHAFTS}
        assert propulsion_input(log, slow, {}) is PropulsionInput.COMMAND
        assert propulsion_input(log, {}, {}) is None
    with open_log(write_log(tmp_path / "b.mcap", "boat", commands)) as log:
        assert not set(SHAFTS) & set(channels(log))
        assert propulsion_input(log, channels(log), {}) is PropulsionInput.COMMAND


def test_log_is_read_once_for_signals_and_device_checks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = boat_log(tmp_path / "a.mcap", boat_with(None, 4), 30.0, 3)
    read: list[str] = []
    every = Log._read_tables
    monkeypatch.setattr(Log, "_read_table", lambda log, kind, topic, *rest: pytest.fail(f"{topic} by itself"))
    monkeypatch.setattr(Log, "_read_tables", lambda log, span: read.append("all") or every(log, span))  # type: ignore[func-returns-value]
    with open_log(path) as log, log.keeping_tables():
        source = log.sources(Gnss)[0]
        with pytest.raises(ValueError, match="read-only"):
            log.table(Gnss, source)["lat"][0] = 0.0
    read.clear()
    loaded = load_run(path, "estimation", device_faults=device_faults)
    assert loaded.device_faults == ()
    assert read == ["all"]
    monkeypatch.undo()
    with open_log(path) as log:
        assert log.table(Gnss, source).flags.writeable


def test_time_window_gives_the_same_rows_and_the_rest_is_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = boat_log(tmp_path / "a.mcap", boat_with(None, 4), 120.0, 3)
    monkeypatch.setattr(loading, "MARGIN_S", 8.0)  # The margin fits this short log.
    whole = load_run(path, "estimation")
    read: list[int] = []
    pread = os.pread
    monkeypatch.setattr(os, "pread", lambda fd, n, at: read.append(n) or pread(fd, n, at))  # type: ignore[func-returns-value]
    window = TimeWindow(60.0, 90.0)
    part = load_run(path, "estimation", window, device_faults)
    assert part.device_faults == ()
    assert sum(read) < 0.6 * path.stat().st_size
    assert part.about["duration"] == pytest.approx(30.0)
    assert (part.about["path"], part.about["sha256"]) == ("a.mcap[60:90]", whole.about["sha256"])
    rows, wanted = (
        make_record(horizontal_model(), replace(loaded.run, t_from=60.0, t_to=90.0), 10.0) for loaded in (part, whole)
    )
    assert rows.t.tolist() == wanted.t.tolist()
    np.testing.assert_allclose(rows.u, wanted.u, atol=1e-11)  # Cumulative sums start later in the shorter log.
    for name, found, y in zip(rows.outputs, rows.y.T, wanted.y.T, strict=True):
        # The track begins at the first fix that is read, and the heading within half a turn of north.
        begin = np.nanmean(found - y) if name in ("x", "y", "psi") else 0.0
        np.testing.assert_allclose(found, y + begin, rtol=0.0, atol=1e-3 if begin else 0.0, err_msg=name)
    with pytest.raises(SeatrialError, match="120 s long, so no data are left from 300 s on"):
        load_run(path, "estimation", TimeWindow(300.0))


@pytest.mark.parametrize("signed", [True, False])
def test_shaft_speeds_relayed_by_an_autopilot_have_an_age(tmp_path: Path, signed: bool) -> None:
    boat = boat_with(None, 4)
    t, n = make_mission("mixed", 60.0, 3).setpoints()
    run = simulate(boat, t, n, 60.0, 1, gear=AUTOPILOT)
    loaded = load_run(autopilot_log(tmp_path / "a.mcap", run.readings, signed=signed), "estimation")
    assert loaded.propulsion is PropulsionInput.TELEMETRY
    assert loaded.holds["n_left"] == ("" if signed else "average")
