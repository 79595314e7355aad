"""The sentence on the residuals: sure of what was tested, and of no more."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ident.data.record import Record
from ident.estimation.likelihood import Likelihood
from ident.estimation.maximum_likelihood import fit
from ident.estimation.stochastic_simulation import simulate_stochastic
from ident.results.answers import estimation_warnings, stuck, vehicle_answer
from ident.results.content import residual_part
from ident.studies.cases import make_case
from ident.studies.monte_carlo import make_record
from tests.ident.toys import turning, turning_record

WHITE = "The residuals are white and know nothing of the inputs"


def said(residuals: list[float], cross: list[tuple[str, float]], channels: str = "x") -> str:
    rows = [{"channel": "x", "ljung_box_p": p, "periodogram_p": 0.5} for p in residuals]
    with_inputs = [{"input": name, "p": p} for name, p in cross]
    errors = {"estimation": {"ten_seconds": {}, "one_step": dict.fromkeys(channels)}}
    told: dict[str, Any] = {"residuals": rows, "cross": with_inputs, "before_after": errors, "horizon": 10.0}
    return vehicle_answer(told, searchable=False)


@pytest.mark.parametrize(("horizon", "words"), [(10.0, "Ten seconds"), (1.0, "One second"), (2.5, "2.5 s")])
def test_the_horizon_is_told(horizon: float, words: str) -> None:
    errors = {"estimation": {"ten_seconds": {"x": {"after": 1.5, "unit": "m"}}}}
    answer = vehicle_answer({"residuals": [], "cross": [], "before_after": errors, "horizon": horizon}, searchable=True)
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
    for k in range(trials):
        record = make_record(case, y[k], "r")
        residuals, cross = residual_part(case.model, record, likelihood.filter(record, values[k]).standardised)
        errors = {"estimation": {"ten_seconds": {}}}
        result: dict[str, Any] = {"residuals": residuals, "cross": cross, "before_after": errors, "horizon": 10.0}
        answers.append(vehicle_answer(result, searchable=False))
    assert len(residuals) == 8
    assert sum(not a.startswith(WHITE) for a in answers) <= 4  # 1.2 expected; more have one chance in 150


def constant() -> Record:
    record = turning_record(n_rows=200)
    y = record.y.copy()
    y[:, 0] = np.where(np.isfinite(y[:, 0]), 0.5, np.nan)
    return replace(record, y=y)


def test_a_sensor_that_is_stuck_is_named() -> None:
    record = constant()
    (line,) = stuck(record)
    n = int(np.isfinite(record.y[:, 0]).sum())
    assert line == f"run: {record.outputs[0]} reads 0.5 in all of its {n} samples: a stuck sensor?"
    assert stuck(turning_record(n_rows=200)) == []


def test_channels_of_which_nothing_can_be_told_are_left_out() -> None:
    model, record = turning(), turning_record(n_rows=200)
    eps = np.random.default_rng(0).normal(size=record.y.shape)
    eps[:, 0] = 0.0
    eps[40:, 1] = np.nan
    residuals, cross = residual_part(model, record, eps)
    kept = {o.name for o in model.outputs[2:]}
    assert {r["channel"] for r in residuals} == {c["channel"] for c in cross} == kept


def test_a_fit_that_stopped_short_is_told() -> None:
    found = fit(turning().with_free(("m", "d")), [turning_record(n_rows=300)], start={"m": 15.0})
    assert estimation_warnings(found, [turning_record(n_rows=300)]) == []
    short = replace(found, converged=False, message="stopped after 60 iterations with 667 left to gain")
    first, second = estimation_warnings(short, [constant()])
    assert first.startswith("The fit did not converge: it stopped after 60 iterations with 667 left to gain. Take no")
    assert second.endswith("a stuck sensor?")
