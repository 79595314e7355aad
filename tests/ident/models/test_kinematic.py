"""Tests of the kinematic model with measured attitude: against the horizontal model, plain kinematics, and a rolling
boat.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.thesis import printed
from benchmarks.thesis.boat import sail
from seatrial import command_line
from seatrial.ident.data.record import Channel, LogSegment, build_record
from seatrial.ident.diagnosis.search import diagnose
from seatrial.ident.estimation.fitted_model import fit_nominal_model, nominal_model
from seatrial.ident.estimation.model_file import load_model
from seatrial.ident.model.structure import Model
from seatrial.ident.models.catalogue import make_model
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.kinematic import kinematic_model
from seatrial.ident.models.rotations import G
from tests.missions import boat_log, boat_with

pytestmark = pytest.mark.usefixtures("quick_compilation")

HULL = ("m_u", "m_v", "m_r", "d_u", "d_v", "d_r", "d_uu", "d_rr")
OFFSETS = {"bias_psi": 0.0, "bias_r": 0.0}


def evaluated(model: Model, x: dict[str, float], u: dict[str, float]) -> tuple[dict[str, float], dict[str, float]]:
    """Return rates and outputs by name, for states and inputs by name."""
    values = [x[s.name] for s in model.states], [u[i.name] for i in model.inputs], list(model.values.values())
    signals = model.signals(*values)
    return signals.rate, signals.y


def test_kinematic_model_of_a_level_boat_equals_the_horizontal_model() -> None:
    rng = np.random.default_rng(1)
    for yaw in (False, True):
        six, three = kinematic_model(yaw=yaw), horizontal_model()
        three = three.with_values({"V_x": 0.2, "V_y": -0.1})
        six = six.with_values({"V_x": 0.2, "V_y": -0.1})
        for _ in range(5):
            x = dict(zip(("x", "y", "psi", "u", "v", "r"), rng.normal(size=6), strict=True))
            n = dict(zip(("n_left", "n_right"), rng.uniform(-1, 1, 2), strict=True))
            attitude = {"phi": 0.0, "theta": 0.0, "psi": x["psi"], "p": 0.0, "q": 0.0, "r": x["r"]}
            rate, y = evaluated(six, x | OFFSETS, n | attitude)
            wanted, seen = evaluated(three, x, n)
            for name in ("x", "y", "u", "v", *(["r"] if yaw else [])):
                assert rate[name] == pytest.approx(wanted[name], abs=1e-12), name
            for o in six.outputs:
                assert y[o.name] == pytest.approx(seen[o.name], abs=1e-12), o.name


def rotation(phi: float, theta: float, psi: float) -> np.ndarray:
    """Return the rotation from body to NED as a product of three rotations."""

    def turn(axis: int, a: float) -> np.ndarray:
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        out = np.eye(3)
        out[i, i] = out[j, j] = np.cos(a)
        out[i, j], out[j, i] = -np.sin(a), np.sin(a)
        return out

    return turn(2, psi) @ turn(1, theta) @ turn(0, phi)


def test_accelerometers_measure_the_motion_on_the_surface_and_gravity() -> None:
    """The reference is the specific force from finite differences of the NED velocity, with moving angles."""
    model = kinematic_model()
    x = {"x": 0.0, "y": 0.0, "u": 0.8, "v": -0.15} | OFFSETS
    n = {"n_left": 0.7, "n_right": -0.2}
    # The angles phi, theta, psi and their rates.
    angles, rates = np.array([0.12, -0.07, 2.1]), np.array([0.3, -0.2, 0.4])
    omega = body_rates(angles, rates)

    def ned(h: float, du: float = 0.0, dv: float = 0.0) -> tuple[np.ndarray, float]:
        R = rotation(*(angles + h * rates))
        u, v = x["u"] + h * du, x["v"] + h * dv
        w = -(R[2, 0] * u + R[2, 1] * v) / R[2, 2]  # The boat stays on the surface.
        return R @ [u, v, w], w

    u_in = n | dict(zip(("phi", "theta", "psi"), angles, strict=True)) | dict(zip("pqr", omega, strict=True))
    rate, y = evaluated(model, x, u_in)
    h = 1e-5
    a = (ned(h, rate["u"], rate["v"])[0] - ned(-h, rate["u"], rate["v"])[0]) / (2 * h)
    force = rotation(*angles).T @ (a - [0.0, 0.0, G])
    assert y["ax"] == pytest.approx(force[0], abs=1e-6)
    assert y["ay"] == pytest.approx(force[1], abs=1e-6)
    assert [y["vx"], y["vy"], 0.0] == pytest.approx(ned(0.0)[0], abs=1e-12)


def body_rates(angles: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return p, q, r from R' dR/dt, by finite differences."""
    h = 1e-6
    R = rotation(*angles)
    S = R.T @ (rotation(*(angles + h * rates)) - rotation(*(angles - h * rates))) / (2 * h)
    return np.array([S[2, 1], S[0, 2], S[1, 0]])


def test_heading_that_passes_south_is_unwrapped() -> None:
    t = np.arange(0.0, 20.0, 0.1)
    heading = 0.5 * t
    channels = {i.name: Channel(t, np.zeros(t.size)) for i in kinematic_model().inputs}
    channels["psi"] = Channel(t, np.mod(heading + np.pi, 2 * np.pi) - np.pi)
    channels |= {o.name: Channel(t + 0.05, np.zeros(t.size)) for o in kinematic_model().outputs}
    record = build_record(kinematic_model(), channels)
    j = record.inputs.index("psi")
    np.testing.assert_allclose(np.diff(record.u[:, j]), 0.5 * np.diff(record.t), atol=1e-9)


@pytest.mark.study
def test_kinematic_model_fits_a_rolling_boat_better_than_the_horizontal_model() -> None:
    sailed = sail(printed.TABLE_5["6DOF K"], 240.0, 2)
    names = [n for n in HULL if n not in ("d_u", "d_uu")]  # The short mission hardly informs these two parameters.
    worst = {}
    for model in (kinematic_model(yaw=True), horizontal_model()):
        found = fit_nominal_model(model, [LogSegment("mission", sailed.channels)], [], rate=20.0).fit
        assert found.converged
        worst[model.name] = max(abs(v - sailed.truth[n]) / e for n in names for v, e in [found.estimate(n)])
    assert worst["kinematic"] < 3.5
    assert worst["horizontal"] > worst["kinematic"]


def test_disturbances_act_on_the_states_of_the_kinematic_model() -> None:
    names = {s.name for s in nominal_model(kinematic_model()).states}
    assert {"b_X", "b_Y", "bias_psi", "bias_r", "bias_ax", "bias_ay"} <= names
    assert "b_N" not in names
    assert "q_N" not in nominal_model(kinematic_model()).values
    assert "b_N" in {s.name for s in nominal_model(kinematic_model(yaw=True)).states}


@pytest.mark.parametrize("source", ["kinematic:shaft", "kinematic:force:yaw:no-current"])
def test_source_name_creates_the_same_model(source: str) -> None:
    model = make_model(source, ["attitude", "gyro", "position", "ground_velocity"])
    assert model.source == source
    wanted = ["position", "ground_velocity"] + (["turn_rate"] if "yaw" in source else [])
    assert [s.name for s in model.sensors] == wanted
    assert ("V_x" in model.values) == ("no-current" not in source)
    assert ("m_r" in model.values) == ("yaw" in source)


def run(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str]:
    with pytest.raises(SystemExit) as leaving:
        command_line.main([str(w) for w in words])
    return int(leaving.value.code or 0), capsys.readouterr().err


def test_vehicle_command_fits_the_kinematic_model_and_its_file_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    boat = boat_with(None, 3)
    log = boat_log(tmp_path / "a.mcap", boat, 120.0, 7, 1)
    words = ("ident", "vehicle", log, "--no-score-tests", "--model", "kinematic:shaft:yaw", "--out", tmp_path)
    assert run(capsys, *words) == (0, "")
    saved, truth = load_model(tmp_path / "model.toml"), boat.truth()
    assert [e.name for e in saved.model.effects] == ["disturbance", "sensor-bias"]
    for name in ("m_u", "m_v", "m_r"):
        assert abs(saved.model.parameter(name).value - truth[name]) < 4 * saved.errors[name], name
    status, error = run(capsys, "ident", "diagnose", tmp_path / "model.toml", log, "--out", tmp_path / "d")
    assert status == 1
    assert error.startswith("seatrial: model kinematic cannot be diagnosed")
    status, error = run(capsys, "ident", "vehicle", log, "--model", "kinematic:shaft:pitch", "--out", tmp_path / "p")
    assert (status, error.count("\n")) == (1, 1)
    assert "kinematic:shaft or kinematic:force" in error


def test_model_without_a_hull_cannot_be_diagnosed() -> None:
    with pytest.raises(ValueError, match="lacks a hull"):
        diagnose(kinematic_model(), [], [])
