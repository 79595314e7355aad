"""Tests of the loss of thrust under the common load: its equation, and its recovery by a fit."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.data.record import Channel, Record, build_record
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.maximum_likelihood import EstimationOptions, fit
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.model.structure import Model
from seatrial.ident.models.horizontal import horizontal_model

SENSORS = ("attitude", "gyro", "body_velocity")


def model(beta: float) -> Model:
    plain = horizontal_model("shaft", SENSORS, current=False)
    return (plain + catalogue()["load-sag"]).with_values({"beta_P": beta})


def test_each_thrust_falls_with_the_power_of_both() -> None:
    lossy, plain = model(0.3), model(0.0)
    values = {i.name: 0.0 for i in lossy.inputs}
    states = [0.0] * len(lossy.states)
    for left, right, kept in (
        (1.0, 1.0, 1 / 1.3),
        (1.0, 0.0, 1 / 1.15),
        (-1.0, 0.5, 1 / (1.0 + 0.3 * (1.0 + 0.125) / 2.0)),
    ):
        u = list((values | {"n_left": left, "n_right": right}).values())
        thrusts = [m.signals(states, u, list(m.values.values())).f for m in (lossy, plain)]
        for side in ("left", "right"):
            assert thrusts[0][side] == pytest.approx(kept * thrusts[1][side])


def test_loss_is_found_apart_from_the_thrust_of_each_side_alone() -> None:
    rng, t = np.random.default_rng(3), np.arange(0.0, 200.0, 0.1)
    n = [np.repeat(rng.choice([0.0, 0.5, 0.9], 25), 80)[: t.size] for _ in range(2)]
    truth = model(0.25)
    channels = {"n_left": Channel(t, n[0]), "n_right": Channel(t, n[1])}
    record: Record = build_record(truth, channels | {o.name: Channel(t, np.zeros(t.size)) for o in truth.outputs})
    y = simulate(truth, record, x0=np.zeros(len(truth.states))).y
    sd = np.array([{"psi": 0.01, "r": 0.005}.get(o.name, 0.03) for o in truth.outputs])
    measured = build_record(
        truth,
        channels | {o.name: Channel(t, y[:, j] + sd[j] * rng.normal(size=t.size)) for j, o in enumerate(truth.outputs)},
    )
    start = model(0.05).with_free(["beta_P", "m_u", "d_u", "d_uu"])
    found = fit(start, [measured], EstimationOptions(method="output-error"))
    value, error = found.estimate("beta_P")
    assert value == pytest.approx(0.25, abs=4.0 * error)
    assert error < 0.03
