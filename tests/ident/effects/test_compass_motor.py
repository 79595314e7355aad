"""Tests of compass deviation by motor currents and of velocities of another point: signs, sizes, and recovery by a
fit.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seatrial.ident.data.record import Channel, Record, build_record
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine.vectorised_model import VectorisedModel
from seatrial.ident.estimation.maximum_likelihood import EstimationOptions, fit
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.model.structure import Model
from seatrial.ident.models.horizontal import horizontal_model

SENSORS = ("attitude", "gyro", "body_velocity")
TRUTH = {"dev_ms": -0.1, "dev_mc": 0.2, "T_dev": 6.0, "b_x": 0.3, "b_y": -0.2}


def model_with(*names: str) -> Model:
    model = horizontal_model("shaft", SENSORS, current=False)
    for name in names:
        model = model + catalogue()[name]
    return model


def at(model: Model, n: tuple[float, float] = (0.0, 0.0), **states: float) -> dict[str, float]:
    """Return rates of the states and outputs by name."""
    x = np.array([[states.get(s.name, 0.0) for s in model.states]])
    row = VectorisedModel(model)(x, np.array([n]), np.array(list(model.values.values())))[0]
    names = [f"{s.name}'" for s in model.states] + [o.name for o in model.outputs]
    return dict(zip(names, row, strict=True))


def test_motors_deflect_the_heading_with_a_lag() -> None:
    model = model_with("compass-motor").with_values({"dev_mc": 0.1, "T_dev": 5.0})
    north = at(model, (1.0, -0.5))  # Both directions of rotation deflect the heading.
    assert (north["drawn_c'"], north["drawn_s'"]) == pytest.approx((1.5 / 5.0, 0.0))
    assert at(model, (1.0, -0.5), psi=np.pi / 2)["drawn_c'"] == pytest.approx(0.0)
    assert at(model, drawn_c=1.0)["drawn_c'"] == pytest.approx(-0.2)  # The heading returns after the motors stop.


def test_surge_appears_as_sway_if_the_heading_is_wrong() -> None:
    model = model_with("compass-motor").with_values({"dev_mc": 0.1})
    seen = at(model, u=2.0, psi=0.3, drawn_c=1.0)
    assert seen["psi"] == pytest.approx(0.4)
    assert (seen["u"], seen["v"]) == pytest.approx((2.0 * np.cos(0.1), -2.0 * np.sin(0.1)))


def test_yaw_rate_adds_to_the_velocity_of_the_measured_point() -> None:
    model = model_with("velocity-point").with_values({"b_x": 0.5, "b_y": 0.2})
    seen = at(model, u=1.0, r=0.4)
    assert (seen["u"], seen["v"], seen["r"]) == pytest.approx((1.0 - 0.4 * 0.2, 0.4 * 0.5, 0.4))


def test_heading_errors_need_no_body_velocity() -> None:
    """Most logs have a heading and the velocity over ground, which the error of the heading does not change."""
    plain = horizontal_model("shaft", ("attitude", "gyro", "position", "ground_velocity"))
    assert not plain.accepts(catalogue()["velocity-point"])
    for name, state, change in (("compass-motor", "drawn_c", 0.1), ("compass-filtered", "dev_behind", 1.0)):
        assert plain.accepts(catalogue()[name])
        model = (plain + catalogue()[name]).with_values({p: 0.1 for p in ("dev_mc", "dev_f1c") if p in name_of(name)})
        changed, unchanged = (at(model, u=2.0, psi=0.3, **{state: s}) for s in (1.0, 0.0))
        assert abs(changed["psi"] - unchanged["psi"]) == pytest.approx(change)
        assert (changed["vx"], changed["vy"]) == pytest.approx((unchanged["vx"], unchanged["vy"]))


def name_of(effect: str) -> set[str]:
    return {p.name for p in catalogue()[effect].parameters}


def sailed(truth: Model, seed: int) -> Record:
    """Return two minutes of steps with white noise."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 120.0, 0.1)
    n = [np.repeat(rng.uniform(-0.4, 0.9, 15), 80) for _ in range(2)]
    inputs = {"n_left": Channel(t, n[0]), "n_right": Channel(t, n[1])}
    blank = {o.name: Channel(t, np.zeros(t.size)) for o in truth.outputs}
    y = simulate(truth, build_record(truth, inputs | blank), x0=np.zeros(len(truth.states))).y
    noise = {"psi": 0.02, "r": 0.01, "u": 0.03, "v": 0.03}
    seen = {o.name: Channel(t, y[:, j] + noise[o.name] * rng.normal(size=t.size)) for j, o in enumerate(truth.outputs)}
    return build_record(truth, inputs | seen)


def test_both_effects_are_identified() -> None:
    model = model_with("compass-motor", "velocity-point").with_values({"e_psi": 0.02, "e_r": 0.01, "e_uv": 0.03})
    model = replace(model, states=tuple(replace(s, from_output="") for s in model.states))
    records = [sailed(model.with_values(TRUTH), seed) for seed in (1, 2)]
    found = fit(model.with_free(list(TRUTH)), records, EstimationOptions(method="output-error"))
    assert found.converged
    for name, true in TRUTH.items():
        value, error = found.estimate(name)
        assert abs(value - true) < 4 * error
        assert error < 0.2 * abs(true)
