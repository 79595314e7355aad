"""The sentence on the residuals: sure of what was tested, and of no more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.data.record import Record
from ident.estimation.likelihood import Likelihood
from ident.estimation.maximum_likelihood import fit
from ident.estimation.stochastic_simulation import simulate_stochastic
from ident.results.answers import estimation_warnings, stuck_sensors, vehicle_answer
from ident.results.parts import CrossCorrelation, ErrorComparison, Errors, ErrorTable, ResidualTests
from ident.results.tables import cross_rows, residual_row
from ident.studies.cases import make_case
from ident.studies.monte_carlo import make_record
from ident.validation.evaluation import residual_tests
from tests.ident.toys import turning, turning_record

WHITE = "The residuals are white and know nothing of the inputs"


def said(residuals: list[float], cross: list[tuple[str, float]], channels: str = "x") -> str:
    none = np.empty(0)
    rows = [
        ResidualTests(record="r", channel="x", unit="m", t=none, e=none, lags=none, acf=none, band=0.1, ljung_box_p=p,
                      periodogram_p=0.5, frequency=none, cumulative=none, normal_p=0.5, white=p > 0.01)
        for p in residuals
    ]
    with_inputs = [
        CrossCorrelation(record="r", channel="x", input=name, lags=none, z=none, p=p) for name, p in cross
    ]
    one_step = dict.fromkeys(channels, ErrorComparison(after=1.0, unit="m"))
    errors = Errors(estimation=ErrorTable(one_step=one_step, horizon={}, free_run={}))
    return vehicle_answer(errors, 10.0, rows, with_inputs, searchable=False)


@pytest.mark.parametrize(("horizon", "words"), [(10.0, "Ten seconds"), (1.0, "One second"), (2.5, "2.5 s")])
def test_the_horizon_is_told(horizon: float, words: str) -> None:
    far = {"x": ErrorComparison(after=1.5, unit="m")}
    errors = Errors(estimation=ErrorTable(one_step={}, horizon=far, free_run={}))
    answer = vehicle_answer(errors, horizon, [], [], searchable=True)
    assert answer.startswith(f"{words} ahead on estimation data the model errs by position 1.5 m (rms).")


def test_nothing_tested_is_not_white() -> None:
    assert said([], []) == (
        "Too little was measured to tell whether the residuals are white: that takes 60 samples of a channel."
    )
    assert said([0.4], [], "xy") == f"{WHITE} (of y there are too few to tell)."


def test_many_tests_are_weighed_together() -> None:
    assert said([0.004] + [0.5] * 7, [("n", 0.002)] + [("n", 0.5)] * 15) == f"{WHITE}."
    assert said([0.004], []).startswith("The residuals are not white")
    assert said([0.5], [("n", 0.002)]).startswith("The residuals still know the inputs")
    assert said([1e-5] + [0.5] * 7, []).startswith("The residuals are not white")


def test_an_input_that_is_a_measurement_is_no_proof() -> None:
    assert "know phi and theta, which the model takes as measured" in said([0.5], [("theta", 1e-9), ("phi", 1e-9)])
    assert said([0.5], [("theta", 1e-9), ("n_left", 1e-9)]).startswith("The residuals still know the inputs")


def test_the_right_model_is_called_so() -> None:
    """At the truth, eight channels with two inputs: each sentence may be wrong in 1 %."""
    case, trials = make_case("horizontal"), 60
    values = np.tile(list(case.model.values.values()), (trials, 1))
    _, y = simulate_stochastic(case.model, case.inputs, values, [np.random.default_rng([9, k]) for k in range(trials)])
    likelihood, answers = Likelihood(case.model), []
    errors = Errors(estimation=ErrorTable(one_step={}, horizon={}, free_run={}))
    for k in range(trials):
        record = make_record(case, y[k], "r")
        found = residual_tests(case.model, record, likelihood.filter(record, values[k]).standardised)
        residuals = [residual_row(r) for r in found]
        cross = [row for r in found for row in cross_rows(r)]
        answers.append(vehicle_answer(errors, 10.0, residuals, cross, searchable=False))
    assert len(residuals) == 8
    assert sum(not a.startswith(WHITE) for a in answers) <= 4  # 1.2 expected; more have one chance in 150


def constant() -> Record:
    record = turning_record(n_rows=200)
    y = record.y.copy()
    y[:, 0] = np.where(np.isfinite(y[:, 0]), 0.5, np.nan)
    return replace(record, y=y)


def test_a_sensor_that_is_stuck_is_named() -> None:
    record = constant()
    (line,) = stuck_sensors(record)
    n = int(np.isfinite(record.y[:, 0]).sum())
    assert line.code == "stuck-sensor"
    assert line.text == f"run: {record.outputs[0]} reads 0.5 in all of its {n} samples: a stuck sensor?"
    assert stuck_sensors(turning_record(n_rows=200)) == []


def test_channels_of_which_nothing_can_be_told_are_left_out() -> None:
    model, record = turning(), turning_record(n_rows=200)
    eps = np.random.default_rng(0).normal(size=record.y.shape)
    eps[:, 0] = 0.0
    eps[40:, 1] = np.nan
    found = residual_tests(model, record, eps)
    kept = {o.name for o in model.outputs[2:]}
    assert {r.channel for r in found} == {c.channel for r in found for c in r.inputs} == kept


def test_a_fit_that_stopped_short_is_told() -> None:
    found = fit(turning().with_free(("m", "d")), [turning_record(n_rows=300)], start={"m": 15.0})
    assert estimation_warnings(found, [turning_record(n_rows=300)]) == []
    short = replace(found, converged=False, message="stopped after 60 iterations with 667 left to gain")
    first, second = estimation_warnings(short, [constant()])
    assert (first.code, second.code) == ("not-converged", "stuck-sensor")
    assert "stopped after 60 iterations with 667 left to gain" in first.text
