"""Tests of tables of thrust stands (RCbenchmark, Tyto): guessed map, import and characterisation of the thruster."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.errors import SeatrialWarning
from seatrial.daq.importers.guess import guess_map
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.importers.recognise import read_name
from seatrial.daq.log import open_log
from seatrial.daq.samples import Scalar
from seatrial.ident.data import load_runs
from seatrial.ident.reporter import QUIET
from seatrial.ident.results import ThrustCurveResult
from seatrial.ident.workflows.thruster import ThrusterRequest, characterise, is_static

HEADER = (
    "Time (s),ESC signal (µs),Servo 1 (µs),AccX (g),AccY (g),AccZ (g),Torque (N·m),Thrust (kgf),Voltage (V),"
    "Current (A),Motor Electrical Speed (RPM),Motor Optical Speed (RPM),Electrical Power (W),Motor Efficiency (%),"
    "Overall Efficiency (kgf/W),Vibration (g),App message"
)
NEWTONS = {"kgf": 9.80665, "gf": 9.80665e-3, "N": 1.0, "lbf": 4.4482216152605}
AHEAD = (0.0, 0.2, 0.0, 0.4, 0.6, 0.8, 1.0, 0.5, 0.0)
BOTH = (0.0, 0.2, -0.2, 0.4, -0.4, 0.6, -0.6, 0.8, -0.8, 1.0, -1.0, 0.0)
FULL_N, FULL_RPM, HOLD_S = 30.0, 3000.0, 4.0


def stand(
    levels: tuple[float, ...], rest: float, span: float, unit: str = "kgf", dt: float = 0.05, sign: int = 1
) -> str:
    """Return a table of a thrust stand with a quadratic thruster. The shaft follows within one row, and its speed has
    no sign.
    """
    rng = np.random.default_rng(3)
    t = np.arange(0.0, HOLD_S * len(levels), dt)
    n = np.repeat(levels, len(t) // len(levels))
    force = sign * (FULL_N * n * np.abs(n) + rng.normal(0.0, 0.02, n.size)) / NEWTONS[unit]
    lines = [HEADER.replace("kgf", unit)]
    for k, level in enumerate(n):
        rpm = f"{abs(level) * FULL_RPM:.0f}" if level else ""  # The stand writes no speed while the shaft is at rest.
        lines.append(
            f"{t[k] + 3.2:.4f},{rest + span * level:.0f},,0.01,0.02,-1.0,0.01,{force[k]:.6f},14.8,3.2,{rpm},,40,55,4,0,"
        )
    return "\n".join(lines) + "\n"


def imported(folder: Path, text: str, encoding: str = "utf-8") -> tuple[Path, str]:
    source = folder / "stand.csv"
    source.write_bytes(text.encode(encoding))
    guess = guess_map(source)
    assert guess.problem == ""
    (folder / "map.toml").write_text(guess.text, encoding="utf-8")
    (log,) = import_files(folder / "map.toml", [source], out=folder / "stand.mcap")
    return log, guess.text


@pytest.mark.parametrize("unit", NEWTONS)
@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_table_with_forward_thrust_only(unit: str, encoding: str, tmp_path: Path) -> None:
    path, text = imported(tmp_path, stand(AHEAD, 1000.0, 1000.0, unit), encoding)
    assert "# caveat: 1000 us is assumed to be rest, 2000 us full command" in text
    with open_log(path) as log:
        assert set(log.sources(Scalar)) == {"force", "n_cmd_thruster", "n_thruster", "voltage", "current", "power"}
        names = ("force", "n_cmd_thruster", "n_thruster")
        force, command, speed = (log.table(Scalar, name)["value"] for name in names)
        assert (log.unit("force"), log.role("n_cmd_thruster"), log.role("n_thruster")) == ("N", "input", "output")
    assert np.max(force) == pytest.approx(FULL_N, abs=0.1)
    assert (np.min(command), np.max(command)) == pytest.approx((0.0, 1.0))
    assert np.max(speed) == pytest.approx(1.0)
    assert not is_static(load_runs([path], "estimation"), None)


def test_static_curve_from_a_table_with_both_directions(tmp_path: Path) -> None:
    """The speed has no sign, so the result is a static curve."""
    path, text = imported(tmp_path, stand(BOTH, 1500.0, 400.0))
    assert "1500 us is assumed to be rest, 1900 us full command" in text
    assert "the speed has no sign, but the thrust has" in text
    result = characterise(ThrusterRequest([path], tmp_path / "out"), "test", QUIET)
    assert isinstance(result, ThrustCurveResult)
    ends = result.static.force_model[0], result.static.force_model[-1]
    assert ends == pytest.approx((-FULL_N, FULL_N), abs=0.1)


def test_negative_load_cell_and_slow_rows(tmp_path: Path) -> None:
    path, text = imported(tmp_path, stand(AHEAD, 1000.0, 1000.0, dt=0.5, sign=-1))
    assert "the thrust is negative throughout: its sign is changed" in text
    assert "rows 0.5 s apart are too slow for a time constant" in text
    assert "steady.csv" not in text  # a static curve has no table of the power
    with open_log(path) as log:
        assert set(log.sources(Scalar)) == {"force", "n_cmd_thruster", "voltage", "current", "power"}
        assert np.max(log.table(Scalar, "force")["value"]) == pytest.approx(FULL_N, abs=0.1)


def test_table_of_a_boat_is_not_read_as_a_thrust_stand(tmp_path: Path) -> None:
    lines = stand(AHEAD, 1000.0, 1000.0).splitlines()
    (tmp_path / "boat.csv").write_text(
        "\n".join([f"yaw [deg],{lines[0]}", *(f"{k % 90},{x}" for k, x in enumerate(lines[1:]))])
    )
    assert '"force"' not in guess_map(tmp_path / "boat.csv").text


VOLTS, OHMS = 25.2, 0.03  # of the battery without load, and its inner resistance
POOL = "t_s,command_pct,rpm,force_N,voltage_V,current_A"


def pool(path: Path, header: str = POOL) -> Path:
    """Write a bench log of a thruster with the voltage and the current of its supply: 14 A at full speed."""
    rng = np.random.default_rng(4)
    n = np.repeat([0.0, 0.3, 0.6, 1.0, 0.0, -0.4, -0.8, -1.0, 0.0], 80)
    amperes = 0.2 + 13.8 * np.abs(n) ** 3
    rows = [0.05 * np.arange(n.size), 100.0 * n, FULL_RPM * np.roll(n, 3) + rng.normal(0.0, 2.0, n.size)]
    rows += [FULL_N * n * np.abs(n) + rng.normal(0.0, 0.05, n.size), VOLTS - OHMS * amperes, amperes]
    np.savetxt(path, np.column_stack(rows), "%.3f", ",", header=header, comments="")
    return path


@pytest.mark.parametrize(
    ("column", "unit"),
    [("force_N", "N"), ("Force [N]", "N"), ("thrust (N)", "N"), ("thrust_gf", "gf"), ("thrust_g", "gf")],
)
def test_a_unit_in_the_name_of_the_force_is_no_assumption(tmp_path: Path, column: str, unit: str) -> None:
    text = guess_map(pool(tmp_path / "pool.csv", POOL.replace("force_N", column))).text
    assert f'{{ name = "force", column = "{column}", unit = "{unit}" }}' in text
    assert "no unit" not in text
    text = guess_map(pool(tmp_path / "pool.csv", POOL.replace("force_N", "force"))).text
    assert "# caveat: 'force' has no unit; newtons are assumed\n" in text


@pytest.mark.parametrize(
    ("column", "unit"),
    [("supply_voltage_V", "V"), ("current_mA", "mA"), ("motor_power_W", "W"), ("n_V", ""), ("left_n", ""), ("x_a", "")],
)
def test_a_letter_at_the_end_of_a_name_is_a_unit_beside_its_quantity(column: str, unit: str) -> None:
    assert read_name(column).unit == unit


@pytest.mark.parametrize(
    "header", [POOL, "Time (s),ESC signal (%),Motor Speed (RPM),Thrust (N),Voltage (V),Current (A)"]
)
def test_the_efficiency_of_an_imported_bench_log(tmp_path: Path, header: str, recwarn: pytest.WarningsRecorder) -> None:
    source = pool(tmp_path / "pool.csv", header)
    guess = guess_map(source)
    assert not guess.unrecognised
    line = (
        "# voltage, current: `seatrial ident thruster` writes the electrical power and the efficiency into steady.csv"
    )
    assert f"{line}, with power = voltage * current\n" in guess.text
    (map_path := tmp_path / "map.toml").write_text(guess.text)
    (log,) = import_files(map_path, [source], out_dir=tmp_path)
    assert not [w for w in recwarn if "model" in str(w.message)]
    characterise(ThrusterRequest([log], tmp_path / "out"), "test", QUIET)
    table = np.genfromtxt(tmp_path / "out/steady.csv", delimiter=",", names=True)
    full = table[table["command"] == 1.0]
    watts = 14.0 * (VOLTS - OHMS * 14.0)
    assert full["power_W"] == pytest.approx(watts, rel=1e-3)
    assert full["efficiency_N_per_W"] == pytest.approx(FULL_N / watts, rel=0.02)
    assert "voltage × current of the supply" in (tmp_path / "out/report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("names", "use"),
    [
        (("voltage", "current"), "voltage, current: .*, with power = voltage \\* current$"),
        (("voltage_thruster", "current_thruster"), "voltage_thruster, current_thruster: .* = voltage \\* current$"),
        (("power", "current"), "current, power: .* efficiency into steady.csv$"),
        (("voltage", "amperes"), "voltage: .* if the map has the current too, or the power$"),
    ],
)
def test_the_import_says_what_electrical_signals_are_for(tmp_path: Path, names: tuple[str, str], use: str) -> None:
    source = pool(tmp_path / "pool.csv")
    text = guess_map(source).text.replace(', role = "output"', "")
    for before, after in zip(("voltage", "current"), names, strict=True):
        text = text.replace(f'name = "{before}"', f'name = "{after}"')
    (map_path := tmp_path / "map.toml").write_text(text)
    with pytest.warns(SeatrialWarning) as warned:
        import_files(map_path, [source], out_dir=tmp_path)
    lines = [str(w.message).removeprefix(f"{map_path}: ") for w in warned]
    assert any(re.match(use, line) for line in lines)
    unknown = [line.partition(":")[0] for line in lines if "no model uses" in line]
    assert unknown == [name for name in names if name == "amperes"]


@pytest.mark.parametrize(
    ("column", "unit", "scale", "rpm"),
    [
        ("rpm", "1", 1.0 / FULL_RPM, FULL_RPM),
        ("rpm", "rev/min", 1.0 / FULL_RPM, FULL_RPM),
        ("Speed [rad/s]", "1", 1.0 / FULL_RPM, FULL_RPM * 30.0 / np.pi),
        ("shaft", "1", 1.0 / FULL_RPM, None),
        ("rpm", "1", 1.0 / 2500.0, 2500.0),
    ],
)
def test_the_shaft_speed_in_rpm_follows_from_the_scale_of_the_map(
    tmp_path: Path, column: str, unit: str, scale: float, rpm: float | None
) -> None:
    source = pool(tmp_path / "pool.csv")
    signal = f'column = "{column}", unit = "{unit}", scale = {scale}, hold = "linear" '
    text = re.sub(r'column = "rpm".*?hold = "linear" ', signal, guess_map(source).text)
    source.write_text(source.read_text().replace("rpm", column, 1))
    (map_path := tmp_path / "map.toml").write_text(text)
    (log,) = import_files(map_path, [source], out_dir=tmp_path)
    with open_log(log) as opened:
        assert opened.rpm_max("n_thruster") == (None if rpm is None else pytest.approx(rpm))
        assert opened.rpm_max("force") is None
    characterise(ThrusterRequest([log], tmp_path / "out"), "test", QUIET)
    for name, speed in (("steady", "n"), ("lookup", "command")):
        table = np.genfromtxt(tmp_path / f"out/{name}.csv", delimiter=",", names=True)
        if rpm is None:
            assert "rpm" not in table.dtype.names
        else:
            np.testing.assert_allclose(table["rpm"], rpm * table[speed], rtol=1e-4, atol=1e-2)
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    assert ("shaft speed [rev/min]" in page) == (rpm is not None)
