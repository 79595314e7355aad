"""Tests of the thruster model and the models of surge and yaw, on independently simulated data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seatrial.ident.data.record import Channel, Record, build_record
from seatrial.ident.estimation.maximum_likelihood import Fit, fit
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.model.delayed_inputs import delay_weights
from seatrial.ident.model.structure import Model
from seatrial.ident.models.dead_zone import outside_dead_zone
from seatrial.ident.models.surge import surge_model
from seatrial.ident.models.thruster import (
    DEAD_ZONE_EDGE,
    DELAY_STEP,
    N_DELAYS,
    delayed_channels,
    thruster_model,
)
from seatrial.ident.models.yaw import yaw_model
from tests.ident.toys import best_start

pytestmark = pytest.mark.usefixtures("quick_compilation")

A, C1, C2, BIAS = 2.794, 40.05, 1.11, 0.3
DT = 1e-3  # Step [s] of the simulation. Delays and command times are multiples of it.


def bench(seed: int, tau: float, *, dead_zone: float = 0.0, chirp: bool = False) -> dict[str, Channel]:
    """Return a bench run of a minute: random steps with command times at 50 Hz, then a chirp; RPM at 25 Hz, force at 80
    Hz.

    The shaft is solved exactly between switches. The load cell has an Ornstein-Uhlenbeck force.
    """
    rng = np.random.default_rng(seed)
    n_samples = 60_000
    t = np.arange(n_samples) * DT
    t_cmd = np.append(0.0, np.round(np.cumsum(rng.uniform(1.0, 3.0, 60)) / 0.02) * 0.02)
    value = np.append(0.0, rng.uniform(-1, 1, 60))
    if chirp:
        t_sine = 30.0 + 0.02 * np.arange(1500)
        sine = 0.8 * np.sin(2 * np.pi * (0.05 * (t_sine - 30) + 0.01 * (t_sine - 30) ** 2))
        early = t_cmd < 30.0
        t_cmd, value = np.append(t_cmd[early], t_sine), np.append(value[early], sine)
    index = np.searchsorted(np.round(t_cmd / DT), np.arange(n_samples) - round(tau / DT), side="right") - 1
    command = value[np.clip(index, 0, None)]
    command = np.where(np.abs(command) > dead_zone, command, 0.0)
    n, b = np.zeros(n_samples), np.zeros(n_samples)
    keep, swing = np.exp(-A * DT), 0.5 * np.sqrt(DT) * rng.normal(size=n_samples)
    for k in range(n_samples - 1):
        n[k + 1] = command[k] + (n[k] - command[k]) * keep
        b[k + 1] = b[k] * (1 - DT / 0.5) + swing[k]
    force = C1 * n * np.abs(n) + C2 * n * n + BIAS + b
    rpm, cell = np.arange(0, n_samples, 40), np.arange(3, n_samples, 12)
    return delayed_channels(Channel(t_cmd, value)) | {
        "n": Channel(t[rpm], n[rpm] + 0.005 * rng.normal(size=rpm.size)),
        "force": Channel(t[cell], force[cell] + 0.5 * rng.normal(size=cell.size)),
    }


def estimated(channels: dict[str, Channel], free: tuple[str, ...] = (), **grid: np.ndarray) -> Fit:
    model = thruster_model()
    model = model.with_free([*model.free, *free])
    record = build_record(model, channels, rate=100.0, max_step=0.05)
    start = best_start(model, [record], {"tau": np.arange(0.01, 0.6, 0.05), **grid})
    return fit(model, [record], start={**start, "a": 2.0, "c1": 30.0})


@pytest.mark.parametrize(("seed", "tau"), [(1, 0.184), (2, 0.267), (4, 0.345), (5, 0.018)])
def test_thruster_and_its_delay_are_identified(seed: int, tau: float) -> None:
    assert tau / DELAY_STEP % 1 > 0.05  # The delay is not a multiple of the grid.
    found = estimated(bench(seed, tau))
    assert found.converged
    assert abs(found.estimate("tau")[0] - tau) < 0.002
    for name, truth in {"tau": tau, "a": A, "c1": C1, "c2": C2}.items():
        value, error = found.estimate(name)
        assert abs(value - truth) < 3 * error, name


def test_dead_zone_is_identified_from_a_chirp() -> None:
    found = estimated(bench(3, 0.184, dead_zone=0.086, chirp=True), ("d",), d=np.arange(0.0, 0.15, 0.01))
    for name, truth in {"tau": 0.184, "a": A, "c1": C1, "d": 0.086}.items():
        value, error = found.estimate(name)
        assert abs(value - truth) < 4 * error, name


def test_delayed_taps_stay_steps() -> None:
    copies = delayed_channels(Channel(np.array([0.0, 1.0, 1.02]), np.array([0.2, 0.7, -0.4])), 0.05, 3)
    assert list(copies) == ["n_cmd_0", "n_cmd_1", "n_cmd_2"]
    model_times = np.array([0.0, 0.04, 1.0, 1.0499, 1.0501, 1.0699, 1.0701])
    held = [copies["n_cmd_1"].value[np.searchsorted(copies["n_cmd_1"].t, s, side="right") - 1] for s in model_times]
    assert held == [0.2, 0.2, 0.2, 0.2, 0.7, 0.7, -0.4]


@pytest.mark.parametrize("position", [0.0, 0.3, 1.0, 5.5, 11.7, 12.0])
def test_delay_weights_preserve_mean_and_variance(position: float) -> None:
    weights, at = np.array([float(w) for w in delay_weights(position, 13)]), np.arange(13)
    assert weights.tolist() == [float(w[0]) for w in delay_weights(np.array([position]), 13)]
    assert weights.sum() == pytest.approx(1.0)
    assert weights @ at == pytest.approx(position)
    if 1.0 <= position <= 11.0:
        assert weights @ (at - position) ** 2 == pytest.approx(0.0, abs=1e-12)


def test_dead_zone_is_a_smooth_step() -> None:
    for command, d, passed in ((0.05, 0.086, 0.0), (-0.2, 0.086, -0.2), (0.086, 0.086, 0.043), (0.0, 0.0, 0.0)):
        assert float(outside_dead_zone(command, d, DEAD_ZONE_EDGE)) == pytest.approx(passed)


def test_thruster_without_a_load_cell() -> None:
    model = thruster_model(force=False)
    assert [s.name for s in model.sensors] == ["rpm"]
    assert "c1" not in model.values
    channels = bench(1, 0.184)
    record = build_record(model, {k: c for k, c in channels.items() if k != "force"}, rate=100.0, max_step=0.05)
    found = fit(model, [record], start={"tau": 0.2})
    assert abs(found.estimate("a")[0] - A) < 4 * found.estimate("a")[1]
    assert len(model.inputs) == N_DELAYS


def noisy(model: Model, record: Record, x0: np.ndarray, sd: list[float], seed: int) -> Record:
    y = simulate(model, record, x0=x0).y
    return replace(record, y=y + np.array(sd) * np.random.default_rng(seed).normal(size=y.shape))


@pytest.mark.parametrize(("propulsion", "measured"), [("force", "position"), ("force", "both"), ("shaft", "speed")])
def test_surge_is_identified(propulsion: str, measured: str) -> None:
    model = surge_model(propulsion, measured)  # type: ignore[arg-type]
    t = np.arange(2000) * 0.1
    level = np.repeat(np.random.default_rng(0).uniform(0.0, 0.9, 40), 50)[:, None]
    u = level if propulsion == "shaft" else 40.0 * level
    names = tuple(o.name for o in model.outputs)
    record = Record("surge", t, u, u, np.zeros((2000, len(names))), tuple(i.name for i in model.inputs), names)
    sd = {"x": 0.05, "u": 0.03}
    record = noisy(model, record, np.zeros(2), [sd[n] for n in names], 1)
    found = fit(model, [record], start={"m_u": 60.0, "d_uu": 12.0})
    assert found.converged
    for name, truth in {"m_u": 37.0, "d_uu": 25.0}.items():
        value, error = found.estimate(name)
        assert abs(value - truth) < 4 * error, name
        assert error < 0.1 * truth, name


@pytest.mark.parametrize("measured", ["rate", "both"])
def test_yaw_is_identified(measured: str) -> None:
    model = yaw_model(measured)  # type: ignore[arg-type]
    t = np.arange(2000) * 0.05
    u = np.repeat(np.random.default_rng(0).uniform(-8, 8, 50), 40)[:, None]
    names = tuple(o.name for o in model.outputs)
    record = Record("yaw", t, u, u, np.zeros((2000, len(names))), ("N",), names)
    record = noisy(model, record, np.zeros(len(model.states)), [{"r": 0.005, "psi": 0.01}[n] for n in names], 1)
    found = fit(model, [record], start={"m_r": 15.0, "d_rr": 3.0})
    assert found.converged
    for name in ("m_r", "d_r", "d_rr"):
        value, error = found.estimate(name)
        assert abs(value - model.values[name]) < 4 * error, name


def test_nominal_values_equal_the_values_of_the_thesis() -> None:
    table = {"m_u": 37.0, "d_u": 0.2, "d_uu": 25.0, "m_r": 9.69, "d_r": 4.14, "d_rr": 6.23, "a": A, "c1": C1, "c2": C2}
    known = surge_model().values | yaw_model().values | thruster_model().values
    for name, value in table.items():
        assert known[name] == value
