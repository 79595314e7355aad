"""Tests of the diagnosis of a thruster model: its residuals, its effects, and logs given to the command."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seatrial import command_line
from seatrial.daq.errors import SeatrialError
from seatrial.ident.characterisation import thruster
from seatrial.ident.characterisation.thruster import shaft_guess
from seatrial.ident.data.loading import LoadedLog
from seatrial.ident.data.record import Channel, LogSegment, build_record
from seatrial.ident.diagnosis.candidates import TrajectoryLinearisation as Along
from seatrial.ident.diagnosis.candidates import variables
from seatrial.ident.effects.nonparametric import nonparametric_effect
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine.vectorised_model import VectorisedModel
from seatrial.ident.estimation.fitted_model import reset_collapsed_noise
from seatrial.ident.model.structure import ForceCurve, Model
from seatrial.ident.models.catalogue import make_model
from seatrial.ident.models.disturbances import residuals_of, variables_of, with_disturbances
from seatrial.ident.models.thruster import delayed_channels, thruster_model
from seatrial.mocks.hidden_effects.bench import make_effect
from seatrial.mocks.plant.bench import draw_bench
from tests.missions import bench_log

BENCH = [name for name, effect in catalogue().items() if "bench" in effect.requires]


def rates(model: Model, values: dict[str, float], n: float, command: float, **states: float) -> dict[str, float]:
    """Return rates and outputs of one row. All delayed taps of the command have the same value."""
    model = model.with_values(values)
    x = np.array([[{"n": n, **states}.get(s.name, 0.0) for s in model.states]])
    u = np.array([[command if i.name.startswith("n_cmd") else 30.0 for i in model.inputs]])
    row = VectorisedModel(model)(x, u, np.array(list(model.values.values())))[0]
    return dict(zip([f"{s.name}'" for s in model.states] + [o.name for o in model.outputs], row.tolist(), strict=True))


def with_effect(name: str) -> Model:
    return with_disturbances(thruster_model(n_delays=9)) + catalogue()[name]


def test_bench_model_lists_its_residuals_and_variables() -> None:
    model = with_disturbances(thruster_model(n_delays=9))
    assert [(r.name, r.state, r.unit) for r in residuals_of(model)] == [("F", "b_f", "N"), ("n_dot", "b_n", "1/s")]
    assert [v.name for v in variables_of(model)] == ["n", "n_ref", "slip", "t"]
    assert [r.name for r in residuals_of(thruster_model(force=False))] == ["n_dot"]
    assert model.parameter("s_n").value == 1e-4  # The disturbance b_n replaces this noise.
    assert len(BENCH) == 14
    assert not [e for e in BENCH if "hull" in catalogue()[e].requires]
    hull = [e for n, e in catalogue().items() if n not in BENCH]
    assert not [e.name for e in hull if model.accepts(e)]


def test_nonparametric_residuals_act_like_their_disturbance_states() -> None:
    model = with_disturbances(thruster_model(n_delays=9))
    for force, variable in (("F", "n"), ("n_dot", "slip")):
        effect = nonparametric_effect(model, ForceCurve(force, variable), (-1.0, 1.0))
        flat = {p.name: 0.25 for p in effect.parameters}  # A curve with the same value everywhere.
        state = next(r.state for r in residuals_of(model) if r.name == force)
        table, moved = rates(model + effect, flat, 0.5, 0.6), rates(model, {}, 0.5, 0.6, **{state: 0.25})
        assert table["force"] == pytest.approx(moved["force"])
        assert table["n'"] == pytest.approx(moved["n'"])
        assert (table["force"], table["n'"]) != (rates(model, {}, 0.5, 0.6)["force"], rates(model, {}, 0.5, 0.6)["n'"])


def test_thruster_effects_follow_their_formulas() -> None:
    base = rates(with_disturbances(thruster_model(n_delays=9)), {}, 0.5, 0.9)
    a, c1, c2 = 2.794, 40.05, 1.11
    late = rates(with_effect("second-lag"), {"k_lag": 1.0, "T_late": 0.1}, 0.5, 0.9, n_late=0.7)
    assert late["n'"] == pytest.approx(a * (0.7 - 0.5))
    assert late["n_late'"] == pytest.approx((0.9 - 0.7) / 0.1)
    assert rates(with_effect("spin-up"), {"k_up": 0.2}, 0.5, 0.9)["n'"] == pytest.approx(1.2 * base["n'"])
    assert rates(with_effect("spin-up"), {"k_up": 0.2}, 0.5, 0.1)["n'"] == pytest.approx(0.8 * a * (0.1 - 0.5))
    slewed = rates(with_effect("slew-limit"), {"k_slew": 1.0, "n_slew": 0.3}, 0.5, 0.9)
    assert slewed["n'"] == pytest.approx(0.3, rel=0.01)
    capped = rates(with_effect("speed-limit"), {"k_top": 1.0, "n_top": 0.6}, 0.5, 0.9)
    assert capped["n'"] == pytest.approx(a * (0.6 - 0.5), rel=0.01)
    sagged = rates(with_effect("supply-sag"), {"k_sag": 0.1}, 0.5, 0.9, used=0.5)
    assert sagged["n'"] == pytest.approx(a * (0.9 * 0.95 - 0.5))
    assert sagged["used'"] == pytest.approx(0.5**3 / 30.0)
    band = rates(with_effect("thrust-dead-band"), {"n_band": 0.1}, -0.5, 0.0)["force"]
    assert band == pytest.approx(-c1 * 0.4**2 + c2 * 0.4**2)
    bent = rates(with_effect("thrust-exponent"), {"p_n": 0.3}, 0.5, 0.9)["force"]
    assert bent == pytest.approx(base["force"] * 0.5**0.3, rel=1e-4)
    washed = rates(with_effect("recirculation"), {"k_wash": 0.2}, 0.5, 0.9, wash=0.25)
    assert washed["force"] == pytest.approx(0.95 * base["force"])
    assert washed["wash'"] == pytest.approx(0.0)
    drifted = rates(with_effect("cell-drift"), {"F_creep": 2.0, "T_creep": 30.0}, 0.5, 0.9)["force"]
    assert drifted - base["force"] == pytest.approx(2.0 * (1 - np.exp(-1.0)))
    flexed = rates(with_effect("rod-flex"), {"g_rod": 1.0}, 0.5, 0.9, rod=3.0)
    assert flexed["force"] == pytest.approx(3.0)
    assert flexed["rod_rate'"] == pytest.approx(2 * np.pi * 6.0 * (base["force"] - 3.0))


def test_variables_of_a_row_use_the_parameters_of_the_model() -> None:
    model = with_disturbances(thruster_model()).with_values({"tau": 0.2, "d": 0.1})
    t = np.arange(0.0, 6.0, 0.02)
    command = Channel(t, np.where(t > 1.0, 0.6, np.where(t > 0.5, 0.05, 0.0)))
    n = Channel(t, np.clip(t - 1.2, 0.0, 0.6))
    record = build_record(model, delayed_channels(command) | {"n": n, "force": n}, rate=50.0)
    x = np.zeros((record.n_rows, len(model.states)))
    x[:, 0] = np.interp(record.t, t, n.value)
    path = Along(model, np.array(list(model.values.values())), record, x)
    found = variables(model, path.own, x, path.values)
    late = record.t > 1.02 + 0.2 + 0.02
    np.testing.assert_allclose(found["n_ref"][late], 0.6)
    np.testing.assert_allclose(found["n_ref"][record.t < 1.0], 0.0, atol=1e-12)  # The command is in the dead zone.
    np.testing.assert_allclose(found["slip"], found["n_ref"] - x[:, 0])


@pytest.mark.parametrize(("delay", "pole"), [(0.345, 7.2), (2.6, 1.1)])
def test_initial_delay_and_pole_are_near_the_truth(delay: float, pole: float) -> None:
    t = np.arange(0.0, 60.0, 0.02)
    command = np.where((t % 12.0) < 6.0, 0.2 + 0.1 * np.floor(t / 12.0), -0.3)
    n = np.zeros(t.size)
    for k in range(1, t.size):
        n[k] = n[k - 1] + 0.02 * pole * (np.interp(t[k] - delay, t, command, left=0.0) - n[k - 1])
    channels = delayed_channels(Channel(t, command)) | {"n": Channel(t, n)}
    tau, a = shaft_guess([build_record(thruster_model(force=False), channels, rate=50.0)])
    assert tau == pytest.approx(delay, abs=0.11)
    assert a == pytest.approx(pole, rel=0.5)


def test_slow_thruster_model_is_restored_from_its_file() -> None:
    slow = thruster_model("slow", force=False)
    assert slow.parameter("tau").bounds[1] == pytest.approx(4.8)
    again = make_model(slow.source, ["rpm"])
    assert [p.name for p in again.parameters] == [p.name for p in slow.parameters]
    assert again.parameter("tau").bounds == slow.parameter("tau").bounds
    with pytest.raises(SeatrialError, match="thruster has no option 'fast' at this place; choose slow"):
        make_model("thruster:fast", ["rpm"])


def test_noise_that_collapsed_to_zero_is_reset() -> None:
    model = thruster_model(force=False).with_values({"e_n": 1e-9})
    t = np.arange(0.0, 20.0, 0.02)
    noise = 0.01 * np.random.default_rng(1).normal(size=t.size)
    record = build_record(model, delayed_channels(Channel(t, 0.0 * t)) | {"n": Channel(t, 0.3 + noise)}, rate=50.0)
    assert reset_collapsed_noise(model, [record]).parameter("e_n").value == pytest.approx(0.01, rel=0.15)
    kept = model.with_values({"e_n": 2e-3})
    assert reset_collapsed_noise(kept, [record]) == kept
    floor = model.replace_parameters(replace(model.parameter("e_n"), value=1e-9, bounds=(1e-9, np.inf)))
    # The log has a smoothed signal, so its differences are motion and not noise.
    assert reset_collapsed_noise(floor, [record]) == floor


def loaded(**channels: Channel) -> LoadedLog:
    return LoadedLog(LogSegment("bench", channels), {"path": "bench.mcap"}, {}, None)


def test_log_gives_the_thruster_name_and_errors_name_missing_signals() -> None:
    t = np.arange(0.0, 5.0, 0.1)
    moved, still = Channel(t, np.sin(t)), Channel(t, 0.0 * t)
    log = loaded(n_cmd_port=moved, n_port=moved, n_cmd_stern=still, n_stern=still)
    assert thruster.thruster_name(log) == "port"
    with pytest.raises(SeatrialError, match=r"bench.mcap: exactly one thruster .* the log has none; give one"):
        thruster.thruster_name(loaded(n_cmd_port=still, n_port=still))
    with pytest.raises(SeatrialError, match=r"bench.mcap: the log has no load cell, but the model has a force"):
        thruster.thruster_runs([log], thruster_model(), None)
    runs = thruster.thruster_runs([log, replace(log)], thruster_model(force=False), None)
    assert {"n", "n_cmd_0", "n_cmd_48"} <= set(runs[1].channels)
    with pytest.raises(SeatrialError, match=r"bench.mcap: no signal 'n_cmd_bow', .*; the log has n_cmd_port"):
        thruster.thruster_runs([log], thruster_model(force=False), "bow")


@pytest.mark.slow
def test_diagnosis_of_a_complete_bench_model_says_that_its_thrust_curve_can_be_used(tmp_path: Path) -> None:
    log = str(bench_log(tmp_path / "bench.mcap", draw_bench(3), 1))
    model, out = str(tmp_path / "thruster/model.toml"), tmp_path / "diagnosis"
    for words in (
        ("ident", "thruster", log, "--out", str(tmp_path / "thruster")),
        ("ident", "diagnose", model, log, "--out", str(out)),
    ):
        with pytest.raises(SystemExit) as left:
            command_line.main(words)
        assert left.value.code == 0
    result = json.loads((out / "result.json").read_text())
    assert not result["effects"]
    assert result["answer"].startswith("The model predicts the force within ")
    assert "from the command alone: the thrust curve can be used." in result["answer"]
    assert "boat" not in result["answer"] + " ".join(result["notes"])


@pytest.mark.study
@pytest.mark.slow
def test_diagnose_command_finds_a_hidden_bench_effect(tmp_path: Path) -> None:
    bench = draw_bench(3, make_effect("recirculation", 3))
    logs = [str(bench_log(tmp_path / f"bench{k}.mcap", bench, k)) for k in (1, 2)]
    model, out = str(tmp_path / "thruster/model.toml"), tmp_path / "diagnosis"
    for words in (
        ("ident", "thruster", logs[0], "--out", str(tmp_path / "thruster")),
        ("ident", "diagnose", model, logs[0], "--validate", logs[1], "--out", str(out)),
    ):
        with pytest.raises(SystemExit) as left:
            command_line.main(words)
        assert left.value.code == 0
    result = json.loads((out / "result.json").read_text())
    assert result["kind"] == "diagnosis"
    assert result["answer"].startswith(
        "The model lacks the loss of thrust by recirculation in the basin (at steady full"
    )
    assert "). Prediction 1 s ahead on" in result["answer"]
    assert "The model with the added effects predicts the force within " in result["answer"]
    assert "from the command alone: its thrust curve can be used." in result["answer"]
    assert (result["prediction"]["verdict"] == "fell") == ("error falls by" in result["answer"])
    assert {(f["force"], f["unit"]) for f in result["residual_forces"]} == {("F", "N"), ("n_dot", "1/s")}
    assert {i["name"] for i in result["inputs"]} == {"n_cmd"}
    assert result["horizon_seconds"] == 1.0
    assert [e["name"] for e in result["effects"]] == ["recirculation"]
    simulation = result["errors"]["validation"]["simulation"]["force"]
    assert simulation["after"] < 0.9 * simulation["before"]
    assert set(result["calibration"]["validation"]["horizon"]) == {"n", "force"}
    assert 'effects = ["disturbance", "recirculation"]' in (out / "model.toml").read_text()
