"""Tests of compass deviation behind a heading filter: the filter equation, its limit, and recovery by a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seatrial.ident.data.record import Channel, Record, build_record
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.maximum_likelihood import EstimationOptions, fit
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.model.structure import Model
from seatrial.ident.models.horizontal import horizontal_model

SENSORS = ("attitude", "gyro", "body_velocity")
TRUTH = {"dev_f1s": 0.12, "dev_f1c": -0.08, "dev_f2s": 0.03, "dev_f2c": 0.02, "T_head": 3.0}
TERMS = ("dev_f1s", "dev_f1c", "dev_f2s", "dev_f2c")


def model_with(name: str, **values: float) -> Model:
    return (horizontal_model("shaft", SENSORS, current=False) + catalogue()[name]).with_values(values)


def blank(model: Model, seed: int, seconds: float = 200.0) -> Record:
    """Return a record with steps of both thrusters at ten rows a second, without measurements."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 0.1)
    steps = int(np.ceil(t.size / 80))
    n = [np.repeat(rng.uniform(-0.3, 0.9, steps), 80)[: t.size] for _ in range(2)]
    inputs = {"n_left": Channel(t, n[0]), "n_right": Channel(t, n[1])}
    return build_record(model, inputs | {o.name: Channel(t, np.zeros(t.size)) for o in model.outputs})


def predicted(model: Model, record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Return states and outputs of a simulation from rest."""
    run = simulate(model, record, x0=np.zeros(len(model.states)))
    return run.x, run.y


def test_heading_error_is_the_deviation_behind_a_first_order_filter() -> None:
    model = model_with("compass-filtered", **TRUTH)
    record = blank(model, 1)
    x, y = predicted(model, record)
    psi = x[:, [s.name for s in model.states].index("psi")]
    deviation = sum(
        TRUTH[k] * f for k, f in zip(TERMS, (np.sin(psi), np.cos(psi), np.sin(2 * psi), np.cos(2 * psi)), strict=True)
    )
    filtered, dt = np.full(psi.size, deviation[0]), 0.1  # The filter has settled before the log starts.
    for k in range(psi.size - 1):  # This step is exact for a deviation that is linear between rows.
        decay = np.exp(-dt / TRUTH["T_head"])
        slope = (deviation[k + 1] - deviation[k]) / dt
        steady = deviation[k] - slope * TRUTH["T_head"]
        filtered[k + 1] = steady + slope * dt + (filtered[k] - steady) * decay
    error = y[:, [o.name for o in model.outputs].index("psi")] - psi
    assert np.ptp(deviation) > 0.2
    assert np.max(np.abs(deviation - filtered)) > 0.05
    np.testing.assert_allclose(error, filtered, atol=1e-3)


def test_limit_without_a_filter_is_the_compass_deviation() -> None:
    values = dict(zip(("dev_s", "dev_c", "dev_2s", "dev_2c"), (TRUTH[k] for k in TERMS), strict=True))
    plain = model_with("compass", **values)
    record = blank(plain, 2)
    exact = predicted(plain, record)[1]

    def off(T: float) -> float:
        model = model_with("compass-filtered", **(TRUTH | {"T_head": T}))
        return float(np.sqrt(np.mean((predicted(model, record)[1] - exact) ** 2)))

    assert off(0.6) < 0.02
    assert off(0.3) == pytest.approx(0.5 * off(0.6), rel=0.1)  # The difference has the order of the time constant.


def test_filtered_deviation_is_identified() -> None:
    model = model_with("compass-filtered", e_psi=0.01, e_r=0.005, e_uv=0.03)
    model = replace(model, states=tuple(replace(s, from_output="") for s in model.states))
    rng, noise = np.random.default_rng(5), {"psi": 0.01, "r": 0.005, "u": 0.03, "v": 0.03}
    records = []
    for seed in (3, 4):
        truth = model.with_values(TRUTH)
        record = blank(truth, seed)
        sd = np.array([noise[o.name] for o in truth.outputs])
        y = predicted(truth, record)[1]
        records.append(replace(record, y=y + sd * rng.normal(size=y.shape)))
    found = fit(model.with_free(list(TRUTH)), records, EstimationOptions(method="output-error"))
    assert found.converged
    for name, true in TRUTH.items():
        value, error = found.estimate(name)
        assert value == pytest.approx(true, abs=4 * error)
        assert error < 0.2 * abs(true)
