"""Tests of output error against simulation, finite differences and the spread of its estimates."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from seatrial.ident.data.record import Record
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import EstimationOptions, SearchSettings, fit
from seatrial.ident.estimation.output_error import (
    output_error,
    predict_ahead,
    simulate,
    with_free_initial_states,
    with_initial_state,
)
from seatrial.ident.models.yaw import yaw_model
from tests.ident.toys import turning, turning_record, values_of

OUTPUT_ERROR = EstimationOptions(method="output-error")


def steps(n_rows: int = 600, seed: int = 0) -> Record:
    """Return a yaw experiment without measurements. The moment changes every three seconds."""
    t = np.arange(n_rows) * 0.1
    u = np.repeat(np.random.default_rng(seed).uniform(-8, 8, n_rows // 30 + 1), 30)[:n_rows, None]
    return Record("steps", t, u, u, np.full((n_rows, 1), np.nan), ("N",), ("r",))


def test_simulation_equals_scipy() -> None:
    record, model = turning_record(), turning()
    p = model.values
    x0 = np.array([3.0, 0.4])
    simulated = simulate(model, record, x0=x0)

    def rate(t: float, x: np.ndarray) -> list[float]:
        moment = np.interp(t, record.t, record.u[:, 0])
        return [x[1], (moment - p["d"] * x[1] - p["dd"] * abs(x[1]) * x[1]) / p["m"]]

    exact = solve_ivp(rate, record.t[[0, -1]], x0, t_eval=record.t, rtol=1e-10, atol=1e-10, max_step=0.01)
    np.testing.assert_allclose(simulated.x, exact.y.T, atol=2e-6)
    np.testing.assert_allclose(simulated.y[:, 2], 2 * simulated.x[:, 1] + 0.1 * record.u[:, 0])


def test_likelihood_equals_that_of_the_simulation_errors() -> None:
    record, model = turning_record(), turning()
    v = values_of(model)
    e = record.y - simulate(model, record, v).y
    e[:, 0] = (e[:, 0] + np.pi) % (2 * np.pi) - np.pi
    S = np.array([v[5], v[6], v[6]]) ** 2
    wanted = np.nansum(-0.5 * (e**2 / S + np.log(2 * np.pi * S)))
    assert output_error(model).value(record, v) == pytest.approx(wanted, rel=1e-10)


def test_sensitivities_to_parameters_and_initial_state_are_exact() -> None:
    model = with_initial_state(yaw_model())
    record = steps()
    simulated = simulate(model, record, x0=np.array([0.3]))
    record = replace(record, y=simulated.y + 0.01 * np.random.default_rng(0).normal(size=simulated.y.shape))
    v, likelihood = values_of(model), output_error(model)
    names = ("m_r", "d_r", "d_rr", "e_r", "x0_r")
    scores = likelihood.scores(record, v, names, double=True)
    value, gradient = likelihood.gradient(record, v)
    assert value == pytest.approx(scores.value, rel=1e-14)  # two programs, which round differently
    for i, name in enumerate(names):
        column = list(model.values).index(name)
        np.testing.assert_allclose(scores.gradient[i], gradient[column], rtol=1e-9, atol=1e-9)
        d = np.zeros(v.size)
        d[column] = 1e-5
        wanted = (likelihood.value(record, v + d) - likelihood.value(record, v - d)) / 2e-5
        assert scores.gradient[i] == pytest.approx(wanted, rel=1e-5, abs=1e-4), name
    # The information of the dynamics is the product of the output sensitivities over the noise variance.
    d = np.zeros(v.size)
    d[0] = 1e-4
    sensitivity = (simulate(model, record, v + d).y - simulate(model, record, v - d).y) / 2e-4
    assert scores.information[0, 0] == pytest.approx(float(np.sum(sensitivity**2)) / v[4] ** 2, rel=1e-6)


def test_standard_errors_equal_the_spread_of_the_estimates() -> None:
    model = yaw_model().with_values({"e_r": 0.02})
    record, rng, z = steps(), np.random.default_rng(1), []
    clean = simulate(model, record, x0=np.zeros(1)).y
    model = replace(model, states=tuple(replace(s, from_output="") for s in model.states))
    for _ in range(40):
        noisy = replace(record, y=clean + 0.02 * rng.normal(size=clean.shape))
        found = fit(model, [noisy], OUTPUT_ERROR, start={"m_r": 7.0, "d_rr": 10.0})
        assert found.converged
        assert "s_r" not in found.names  # Output error has no process noise.
        names = ("m_r", "d_r", "d_rr", "e_r")
        z.append([(found.estimate(n)[0] - model.values[n]) / found.estimate(n)[1] for n in names])
    assert (np.abs(np.mean(z, axis=0)) < 4 / np.sqrt(40)).all()
    np.testing.assert_allclose(np.std(z, axis=0), 1.0, atol=0.45)


@pytest.mark.study
def test_robust_errors_cover_coloured_residuals() -> None:
    """The data have process noise, so the plain standard errors of output error are too small. The robust ones are
    not.
    """
    model = yaw_model().with_values({"e_r": 0.005})
    model = replace(model, states=tuple(replace(s, from_output="") for s in model.states))
    record, rng, z, robust = steps(4800), np.random.default_rng(2), [], []
    p = model.values
    for _ in range(30):
        r, y = 0.0, np.empty((record.n_rows, 1))
        for k in range(record.n_rows):
            y[k] = r + 0.005 * rng.normal()
            for _ in range(5):
                r += 0.02 * (record.u[k, 0] - p["d_r"] * r - p["d_rr"] * abs(r) * r) / p["m_r"]
                r += 0.03 * np.sqrt(0.02) * rng.normal()
        found = fit(model, [replace(record, y=y)], OUTPUT_ERROR)
        i = found.names.index("m_r")
        z.append((found.values[i] - p["m_r"]) / found.errors[i])
        robust.append((found.values[i] - p["m_r"]) / found.robust_errors[i])
    assert np.std(z) > 1.5
    assert 0.6 < np.std(robust) < 1.5


def test_initial_state_is_estimated_and_not_taken_from_a_noisy_first_sample() -> None:
    """The errors then cover the truth. If the first sample were exact, its noise would affect the whole record."""
    model = turning().with_values({"e_psi": 0.05, "e_r": 0.05}).with_free(("d", "dd", "e_psi", "e_r"))
    record, rng, z = turning_record(n_rows=400), np.random.default_rng(3), []
    model = replace(
        model, states=tuple(replace(s, x0=0.0, from_output="psi" if s.name == "psi" else "") for s in model.states)
    )
    noise, seen = np.array([0.05, 0.05, 0.05]), np.isfinite(record.y)
    for _ in range(40):
        clean = simulate(model, record, x0=np.array([3.0, rng.normal(0.0, 0.3)])).y
        noisy = np.where(seen, clean + noise * rng.normal(size=clean.shape), np.nan)
        found = fit(model, [replace(record, y=noisy)], OUTPUT_ERROR, start={"d": 6.0, "dd": 3.0})
        fixed_start = fit(model, [replace(record, y=noisy)], OUTPUT_ERROR, SearchSettings(initial_state="given"))
        assert "x0_psi@0" in found.names
        assert "x0_psi@0" not in fixed_start.names
        z.append(
            [
                [(f.estimate(n)[0] - model.values[n]) / f.estimate(n)[1] for n in ("d", "dd", "e_r")]
                for f in (found, fixed_start)
            ]
        )
    spread = np.sqrt(np.mean(np.square(z), axis=0))
    np.testing.assert_allclose(spread[0], 1.0, atol=0.35)
    assert np.nanmax(spread[1]) > 2.0


@pytest.mark.parametrize("initial_state", ["free", "given"])
def test_outlier_model_works_with_free_and_given_initial_states(initial_state: Literal["free", "given"]) -> None:
    model = turning().with_free(("d", "dd", "e_psi", "e_r"))
    model = replace(
        model, states=tuple(replace(s, x0=0.0, from_output="psi" if s.name == "psi" else "") for s in model.states)
    )
    record, settings = turning_record(n_rows=200), SearchSettings(initial_state=initial_state, robust_errors=False)
    found = fit(model, [record], replace(OUTPUT_ERROR, outlier_model=True), settings)
    assert ("x0_psi@0" in found.names) == (initial_state == "free")
    assert found.converged


def test_initial_state_of_each_record_starts_at_its_first_samples() -> None:
    """The headings lie on both sides of pi. A search from one common start would be a full turn off in one record."""
    model = turning().with_free(("d",))
    model = replace(
        model, states=tuple(replace(s, x0=0.0, from_output="psi" if s.name == "psi" else "") for s in model.states)
    )
    records = [turning_record(k, name=f"run {k}") for k in range(2)]
    shifted = replace(records[1], y=records[1].y - [1.5, 0.0, 0.0])
    found = fit(model, [records[0], shifted], OUTPUT_ERROR)
    first, second = found.estimate("x0_psi", 0)[0], found.estimate("x0_psi", 1)[0]
    assert found.converged
    assert abs((first - np.nanmean(records[0].y[:4, 0]) + np.pi) % (2 * np.pi) - np.pi) < 0.3
    assert abs((second - np.nanmean(shifted.y[:4, 0]) + np.pi) % (2 * np.pi) - np.pi) < 0.3
    again = fit(model, [records[0], shifted], OUTPUT_ERROR, start={"x0_psi@0": first, "x0_psi@1": second})
    assert again.log_likelihood == pytest.approx(found.log_likelihood, abs=1e-4)


def test_known_initial_state_is_fixed_and_an_uncertain_one_becomes_a_prior() -> None:
    known = replace(turning(), states=tuple(replace(s, sd0=0.0, x0=0.2, from_output="") for s in turning().states))
    assert with_free_initial_states(known, []) == (known, {})
    guessed = replace(turning(), states=(turning().states[0], replace(turning().states[1], x0=0.2, sd0="sd0")))
    model, begin = with_free_initial_states(guessed, [])
    assert (model.parameter("x0_r").prior, begin) == ((0.2, 0.3), {})
    assert "x0_psi" not in model.values  # The initial state is already a parameter of the model.


def test_unknown_method_is_rejected() -> None:
    wrong: Any = "PE"
    with pytest.raises(ValueError, match="'PE'"):
        EstimationOptions(method=wrong)
    with pytest.raises(ValueError, match="'PE'"):
        SearchSettings(initial_state=wrong)


def test_predictions_over_several_steps_are_parts_of_a_simulation() -> None:
    model, record = turning(), turning_record()
    simulated = simulate(model, record)
    for steps in (1, 7):
        end = np.arange(steps, record.n_rows)
        ahead = predict_ahead(model, record, None, simulated.x, end - steps, end)
        np.testing.assert_array_equal(ahead.t, record.t[end])
        np.testing.assert_allclose(ahead.y, simulated.y[end], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(ahead.x, simulated.x[end], rtol=1e-12, atol=1e-12)


def test_one_step_prediction_from_filtered_states_is_that_of_the_filter() -> None:
    model, record = turning(), turning_record()
    run = Likelihood(model).filter(record, values_of(model))
    end = np.arange(1, record.n_rows)
    ahead = predict_ahead(model, record, None, run.x_filt, end - 1, end)
    np.testing.assert_allclose(ahead.x, run.x_pred[1:], rtol=1e-12, atol=1e-12)


def test_initial_states_become_parameters() -> None:
    model = with_initial_state(turning(), ["r"])
    assert model.parameter("x0_r").per_record
    assert (model.states[1].x0, model.states[1].sd0) == ("x0_r", 0.0)
    assert model.states[0].x0 == "psi0"
    with pytest.raises(KeyError, match="no state 'q'"):
        with_initial_state(turning(), ["q"])


def test_output_error_rejects_filtering() -> None:
    with pytest.raises(ValueError, match="output error has no filter"):
        output_error(turning()).filter(turning_record(), values_of(turning()))
