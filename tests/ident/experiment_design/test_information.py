"""Tests of Fisher information in batches: against the filter, finite differences, and the spread of estimates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seatrial.ident.estimation.output_error import output_error, simulate, with_initial_state
from seatrial.ident.estimation.stochastic_simulation import SampledInputs, simulate_stochastic
from seatrial.ident.experiment_design.information import (
    Experiments,
    errors_of,
    planned_record,
    prediction_information,
    prior_information,
    segment_information,
)
from seatrial.ident.model.structure import Model
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.surge import surge_model
from tests.ident.toys import turning, values_of

pytestmark = pytest.mark.usefixtures("quick_compilation")

HULL = ("m_u", "m_v", "m_r", "d_u", "d_v", "d_r", "d_uu", "d_vv", "d_rr")


def boat_inputs(seconds: float, n: int = 1, seed: int = 1, step: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Return times, and shaft speeds (n_rows, 2, n) with steps every 3 s. The rows interpolate the steps."""
    t = np.arange(round(seconds / step) + 1) * step
    levels = np.random.default_rng(seed).uniform(-0.5, 1.0, (int(seconds // 3) + 1, 2, n))
    return t, levels[(t // 3.0).astype(int)]


def predicted_measurements(model: Model, t: np.ndarray, u: np.ndarray, values: np.ndarray) -> np.ndarray:
    record = planned_record(model, t, u)
    return simulate(model, record, values).y


def test_output_error_information_equals_finite_differences() -> None:
    model = horizontal_model(sensors=("attitude", "gyro", "position"), current=False)
    t, u = boat_inputs(12.0)
    (F,) = Experiments(model, HULL, t, process_noise=False)(u).information
    at = values_of(model)
    slopes = []
    for name in HULL:
        column = list(model.values).index(name)
        h = 1e-4 * max(1.0, at[column])
        high, low = at.copy(), at.copy()
        high[column], low[column] = at[column] + h, at[column] - h
        slopes.append(
            (predicted_measurements(model, t, u[:, :, 0], high) - predicted_measurements(model, t, u[:, :, 0], low))
            / (2 * h)
        )
    noise = np.array([model.parameter(o.noise).value for o in model.outputs])
    G = (np.stack(slopes) / noise).reshape(len(HULL), -1)
    np.testing.assert_allclose(F, G @ G.T, rtol=2e-3, atol=1e-4 * np.abs(F).max() * 1e-3)


def test_prediction_error_information_equals_that_of_the_filter_without_noise_terms() -> None:
    model = horizontal_model()
    t, u = boat_inputs(40.0, 3)
    every = {"position": 2, "ground_velocity": 5}
    free = (*HULL, "V_x", "V_y")
    found = Experiments(model, free, t, every)(u)
    for k in range(3):
        record = planned_record(model, t, u[:, :, k], every)
        full = prediction_information(model, record, free=free)
        batch, whole = errors_of(found.information[k])[:9], errors_of(full)[:9]
        np.testing.assert_allclose(batch, whole, rtol=0.01)
        assert np.linalg.eigvalsh(full - found.information[k])[0] > -1e-6 * np.abs(full).max()


def test_information_with_angles_named_initial_states_and_linear_inputs() -> None:
    """The model has features that the horizontal model lacks: x0 and sd0 by name, and an output that contains the
    input.
    """
    model = turning()
    t = np.arange(0.0, 20.0, 0.1)
    u = 4.0 * np.sin(t + 0.1 * t**2)[:, None]
    free = ("m", "d", "dd", "bias", "psi0")
    record = planned_record(model, t, u, {"gyros": 2})
    no_angle = replace(model, states=tuple(replace(s, from_output="") for s in model.states))
    expected = prediction_information(no_angle, record, free=free)
    (F,) = Experiments(model, free, t, {"gyros": 2})(u).information
    np.testing.assert_allclose(errors_of(F), errors_of(expected), rtol=0.01)


def test_lanes_are_independent_and_a_shared_input_equals_copies() -> None:
    model = horizontal_model(current=False)
    t, u = boat_inputs(10.0, 11)
    rng = np.random.default_rng(2)
    values = values_of(model) * rng.uniform(0.8, 1.2, (11, len(model.parameters)))
    batch = Experiments(model, HULL, t)
    together = batch(u, values)
    alone = batch(u[:, :, 7:8], values[7:8])
    np.testing.assert_allclose(alone.information[0], together.information[7], rtol=1e-9)
    np.testing.assert_allclose(alone.high[0], together.high[7], rtol=1e-12)
    same = batch(u[:, :, 0], values)
    copied = batch(np.repeat(u[:, :, :1], 11, axis=2), values)
    np.testing.assert_allclose(same.information, copied.information, rtol=1e-12)
    low, high = Experiments(model, HULL, t, process_noise=False).extents(u, values)
    np.testing.assert_allclose(low, together.low, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(high, together.high, rtol=1e-9, atol=1e-9)
    with pytest.raises(ValueError, match="numbers of inputs and of parameter values must agree"):
        batch(u, values[:5])


def test_extremes_equal_the_extremes_of_the_simulation() -> None:
    model = horizontal_model(current=False)
    t, u = boat_inputs(15.0)
    found = Experiments(model, HULL, t)
    low, high = found.extents(u)
    x = simulate(model, planned_record(model, t, u[:, :, 0])).x
    np.testing.assert_allclose(low[0, :6], x.min(axis=0), atol=1e-9)
    np.testing.assert_allclose(high[0, :6], x.max(axis=0), atol=1e-9)
    assert high[0, found.extremes.index("speed2")] == pytest.approx((x[:, 3] ** 2 + x[:, 4] ** 2).max())


def test_zero_hold_of_a_thrust_is_kept() -> None:
    model, t = surge_model("force", "both"), np.arange(0.0, 20.0, 0.2)
    u = np.where((t // 3).astype(int) % 2 == 0, 30.0, -40.0)[:, None]
    found = Experiments(model, ("m_u", "d_uu"), t)
    low, high = found.extents(u[:, :, None])
    x = simulate(model, planned_record(model, t, u)).x
    np.testing.assert_allclose(low[0, :2], x.min(axis=0), atol=1e-9)
    np.testing.assert_allclose(high[0, :2], x.max(axis=0), atol=1e-9)


def test_diverging_boat_has_no_information() -> None:
    model = horizontal_model(current=False).with_values({"m_u": 1e-3, "d_uu": 1e3})
    t, u = boat_inputs(10.0)
    assert not np.isfinite(Experiments(model, HULL, t, process_noise=False)(u).information).all()


def test_bound_equals_the_spread_of_estimates() -> None:
    """Gauss-Newton estimates of 200 noisy records of a surge run have the covariance of the information."""
    model = surge_model("force", "both").with_values({"d_u": 5.0})
    # The initial state is known.
    model = replace(model, states=tuple(replace(s, from_output="") for s in model.states))
    t = np.arange(0.0, 40.0, 0.2)
    u = np.where((t // 8).astype(int) % 2 == 0, 60.0, -20.0)[:, None]
    free = ("m_u", "d_u", "d_uu")
    (F,) = Experiments(model, free, t, process_noise=False)(u).information
    likelihood, values = output_error(model), values_of(model)
    clean = planned_record(model, t, u)
    noise = np.array([model.parameter(o.noise).value for o in model.outputs])
    rng = np.random.default_rng(5)
    estimates = []
    for _ in range(200):
        noisy = replace(clean, y=clean.y + noise * rng.standard_normal(clean.y.shape))
        scores = likelihood.scores(noisy, values, free)
        estimates.append(np.linalg.solve(scores.information, scores.gradient))
    ratio = np.std(estimates, axis=0) / errors_of(F)
    assert np.all(np.abs(ratio - 1.0) < 0.2), ratio


def test_turning_segments_inform_yaw_parameters() -> None:
    model = horizontal_model(sensors=("attitude", "gyro", "position", "ground_velocity"))
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 60.0, 0.1)
    turn = np.where(t < 30.0, 0.0, 0.4 * np.sign(np.sin(2 * np.pi * t / 12)))
    push = 0.5 + 0.3 * np.sign(np.sin(2 * np.pi * t / 20))
    u = np.column_stack([push + turn, push - turn])
    values = values_of(model)
    _, y = simulate_stochastic(model, SampledInputs.linear(t, u), values[None], [rng], x0=np.zeros((1, 6)))
    record = replace(planned_record(model, t, u), y=y[0])
    names = ("m_u", "d_uu", "m_r", "d_rr")
    found = segment_information(model, [record, record], names, seconds=30.0)
    assert [(s.t_from, round(s.t_to)) for s in found] == [(0.0, 30), (30.0, 60)] * 2
    straight, turning_ = found[:2]
    assert straight.alone[2] > 5 * turning_.alone[2]
    assert turning_.weight[3] > 1.1 * straight.weight[3] >= 1.1
    whole = prediction_information(model, record, free=[*names, *[n for n in model.free if n not in names]])[:4, :4]
    np.testing.assert_allclose(straight.information + turning_.information, whole, rtol=1e-9)


def test_correlated_residuals_increase_the_errors_but_not_those_of_priors() -> None:
    """The information of a prior does not depend on the correlation of residuals."""
    model = surge_model("shaft", "speed")
    model = model.replace_parameters(replace(model.parameter("d_u"), prior=(5.0, 1.0)))
    t = np.arange(0.0, 20.05, 0.1)
    record = planned_record(model, t, np.sign(np.sin(t))[:, None])
    names = ("m_u", "d_u")
    (plain,) = segment_information(model, [record], names)
    (larger,) = segment_information(model, [record], names, inflation={"m_u": 1.5, "d_u": 1.5})
    np.testing.assert_allclose(larger.information, plain.information / 2.25)
    assert larger.whole[0] > 1.2 * plain.whole[0]
    assert plain.whole[1] < larger.whole[1] < 1.0  # This limit is the standard deviation of the prior.


@pytest.mark.parametrize("seconds", [19.0, 21.0, 41.0, 600.0])
def test_record_shorter_than_a_segment_is_one_segment(seconds: float) -> None:
    model = surge_model("shaft", "speed")
    t = np.arange(0.0, 20.05, 0.1)
    record = planned_record(model, t, np.sign(np.sin(t))[:, None])
    (segment,) = segment_information(model, [record], ("m_u", "d_uu"), seconds=seconds)
    assert (segment.t_from, segment.t_to) == (0.0, pytest.approx(20.0))
    assert np.isfinite(segment.whole).all()


def test_prior_information_and_errors_of_unidentified_parameters() -> None:
    model = horizontal_model()
    current = prior_information([model.parameter("V_x"), model.parameter("m_u")])
    np.testing.assert_allclose(current, np.diag([4.0, 0.0]))
    error = errors_of(np.diag([4.0, 0.0, 1e-12]))
    np.testing.assert_allclose(error, [0.5, np.inf, 1e6])
    singular = np.array([[1.0, 1.0], [1.0, 1.0]])
    assert np.isinf(errors_of(singular)).all()
    apart = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0], [0.0, 1.0, 1.0]])
    np.testing.assert_allclose(errors_of(apart), [1.0, np.inf, np.inf])
    # Only the sum of the other two is unidentified.
    through = np.array([[2.0, 1.0, 1.0], [1.0, 1.0, 1.0], [1.0, 1.0, 1.0]])
    np.testing.assert_allclose(errors_of(through), [1.0, np.inf, np.inf])


def test_initial_states_can_be_parameters() -> None:
    model = with_initial_state(surge_model("force", "position"), ["u"])
    t = np.arange(0.0, 20.0, 0.1)
    u = np.full((t.size, 1), 20.0)
    (F,) = Experiments(model, ("m_u", "x0_u"), t, process_noise=False)(u).information
    assert 0 < errors_of(F)[1] < 0.1
