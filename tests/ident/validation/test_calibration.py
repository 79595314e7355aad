"""Tests of calibration: right on a simulated boat, and overconfident or underconfident models are found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import stats

from seatrial.ident.data.record import LogSegment, Record
from seatrial.ident.estimation.fitted_model import FittedModel, RecordEvaluation, fit_nominal_model
from seatrial.ident.estimation.interval_widening import RUN_SCATTER
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.parameter_covariance import parameter_uncertainty
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Input, Output, Sensor, State, plain_model
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.numerics.autocorrelation import effective_sample_size
from seatrial.ident.results.answers import calibration_notes
from seatrial.ident.results.tables import calibration_tables
from seatrial.ident.validation.calibration import (
    Calibration,
    calibration_test,
    pooled_calibration,
    simulation_calibration,
)
from seatrial.ident.validation.evaluation import ByHorizon, PredictionEvaluation, evaluate
from seatrial.ident.validation.prediction_errors import WARM_UP, simulation_run
from tests.ident.toys import turning, turning_record, values_of
from tests.missions import boat_with, channels_of, sail


@cache
def fitted() -> FittedModel:
    """Return a model of a boat without a hidden effect, fitted to one mission and validated on another."""
    runs = [
        LogSegment(name, channels_of(sail(boat_with(None, 2), 250.0, k, run=k)[0])) for k, name in enumerate("ab", 1)
    ]
    return fit_nominal_model(horizontal_model(), runs[:1], runs[1:])


def with_values(fitted: FittedModel, factors: dict[str, float]) -> FittedModel:
    """Return the fitted model with some parameters multiplied."""
    names = [p.name for p in fitted.model.parameters]

    def view(old: RecordEvaluation) -> RecordEvaluation:
        values = old.values * [factors.get(n, 1.0) for n in names]
        return replace(old, values=values)

    return replace(fitted, validation=tuple(view(v) for v in fitted.validation))


def validated(judged: PredictionEvaluation) -> ByHorizon[Mapping[str, Calibration]]:
    assert judged.validation is not None
    return judged.validation.calibration


@pytest.mark.study
def test_right_model_is_calibrated() -> None:
    judged = evaluate(fitted())
    found = validated(judged)
    for kind in (found.one_step, found.horizon):
        assert set(kind) == {"psi", "r", "ax", "ay", "x", "y", "vx", "vy"}
        for name, c in kind.items():
            assert c.verdict == "right", (name, c)
            wide = 4.0 / np.sqrt(c.n_effective)
            assert abs(c.inside_50 - 0.5) < 0.5 * wide
            assert abs(c.inside_95 - 0.95) < 0.22 * wide
            assert c.pit.sum() == pytest.approx(1.0)
    assert all(c.verdict != "overconfident" for c in found.simulation.values())
    assert found.horizon["x"].n > 100
    assert calibration_notes(calibration_tables(judged), 10.0) == []


@pytest.mark.study
def test_too_little_sensor_noise_is_overconfident_one_step_ahead() -> None:
    judged = evaluate(with_values(fitted(), {"e_xy": 0.5, "e_psi": 0.5}))
    found = validated(judged).one_step
    assert {n for n, c in found.items() if c.verdict == "overconfident"} >= {"x", "y", "psi"}
    assert found["x"].inside_95 < 0.85
    notes = calibration_notes(calibration_tables(judged), 10.0)
    assert any("errors one step ahead are larger than the model predicts" in line for line in notes)


def test_too_little_process_noise_is_overconfident_over_the_horizon() -> None:
    found = validated(evaluate(with_values(fitted(), {"q_X": 0.1, "q_Y": 0.1, "q_N": 0.1})))
    assert found.horizon["psi"].verdict == "overconfident"
    assert found.horizon["vx"].verdict == "overconfident"


def test_too_much_noise_is_underconfident() -> None:
    found = validated(evaluate(with_values(fitted(), {"e_xy": 2.0, "q_X": 3.0, "q_Y": 3.0, "q_N": 3.0})))
    assert found.one_step["x"].verdict == "underconfident"
    assert found.horizon["psi"].verdict == "underconfident"
    assert found.one_step["x"].inside_50 > 0.6


def test_forecast_equals_the_filter_without_samples() -> None:
    model, record = turning(), turning_record()
    values, likelihood = values_of(model), Likelihood(model)
    run = likelihood.filter(record, values)
    y = record.y.copy()
    y[41:] = np.nan
    blind = likelihood.filter(replace(record, y=y), values)
    mean, P = likelihood.forecast(record, values, run.x_filt[40], run.P_filt[40], 40, 70)
    np.testing.assert_allclose(mean[1:], blind.x_pred[41:71], rtol=1e-12)
    np.testing.assert_allclose(P[1:], blind.P_pred[41:71], rtol=1e-9, atol=1e-15)


def test_interval_of_the_scale_covers_for_correlated_errors() -> None:
    rng, hits, n_sets = np.random.default_rng(3), 0, 300
    for _ in range(n_sets):
        z = np.zeros(400)
        z[0] = rng.normal()
        shocks = np.sqrt(1 - 0.9**2) * rng.normal(size=400)
        for k in range(1, 400):
            z[k] = 0.9 * z[k - 1] + shocks[k]
        c = calibration_test([z])
        assert c is not None
        hits += c.low < 1.0 < c.high
    assert stats.binomtest(hits, n_sets, 0.95).pvalue > 1e-4 or hits / n_sets > 0.95
    assert hits / n_sets > 0.9
    white = rng.normal(size=4000)
    assert effective_sample_size(white) == pytest.approx(4000, rel=0.05)
    assert effective_sample_size(np.ones(100)) < 4


def test_single_experiment_has_insufficient_data() -> None:
    rng = np.random.default_rng(1)
    drift, quick = np.full(500, 1.9), 1.9 * rng.normal(size=500)
    apart = pooled_calibration([{"slow": drift, "quick": quick}])
    assert apart["quick"].verdict == "overconfident"
    together = pooled_calibration([{"slow": drift, "quick": quick}], together=True)
    assert together["quick"].verdict == together["slow"].verdict == "insufficient_data"
    assert calibration_test([np.full(5, np.nan)]) is None


def test_diverged_prediction_is_overconfident() -> None:
    z = np.random.default_rng(0).normal(size=300)
    diverged, unmeasured = (np.append(z, np.full(300, filling)) for filling in (np.inf, np.nan))
    for parts in ([{"x": diverged}], [{"x": z}, {"x": np.full(9, np.inf)}]):
        for together in (False, True):
            found = pooled_calibration(parts, together=together)["x"]
            assert (found.verdict, found.scale) == ("overconfident", np.inf)
    assert pooled_calibration([{"x": unmeasured}])["x"].verdict == "right"


def test_diverged_simulation_is_overconfident() -> None:
    """The state v' = 0.3 v^2 + u diverges in finite time. Rows without a measurement have no error."""
    model = plain_model(
        "runaway",
        f=lambda x, u, p: {"v": 0.3 * x.v * x.v + u.c},
        h=lambda x, u, p: {"y": x.v},
        states=(State("v", noise=0.05, sd0=0.1),),
        inputs=(Input("c"),),
        sensors=(Sensor("one", (Output("y", noise="e"),)),),
        parameters=(Parameter("e", 0.05, transform="log"),),
    )
    n, rng = 1500, np.random.default_rng(0)
    y, c = (0.3 + 0.05 * rng.normal(size=n))[:, None], np.full((n, 1), -0.017)
    y[::2] = np.nan
    record = Record("run", 0.1 * np.arange(n), c, c, y, ("c",), ("y",))
    run = simulation_run(model, record, np.array([0.05]))
    z = simulation_calibration(model, record, run)
    assert run.diverged
    assert np.isinf(z["y"]).sum() > 100
    measured = np.isfinite(y[record.t > WARM_UP, 0])
    assert (np.isnan(z["y"]) == ~measured).all()
    assert pooled_calibration([z], together=True)["y"].verdict == "overconfident"


def verdict_of(scale: float, n: int) -> str:
    z = scale * stats.norm.ppf((np.arange(n) + 0.5) / n)
    found = calibration_test([np.random.default_rng(0).permutation(z)])
    assert isinstance(found, Calibration)
    return found.verdict


def test_scale_within_ten_percent_is_accepted() -> None:
    found = [verdict_of(s, 5000) for s in (0.8, 0.95, 1.05, 1.3)]
    assert found == ["underconfident", "right", "right", "overconfident"]


@pytest.mark.parametrize(("n_runs", "n_errors"), [(1, 10), (1, 100), (3, 10)])
def test_widened_intervals_contain_further_errors(n_runs: int, n_errors: int) -> None:
    """The factor is estimated from few errors of some runs, and 95 % of the errors of a further run are inside.

    Each run has a scale of its own.
    """
    rng, inside, plain = np.random.default_rng(4), [], []
    for _ in range(4000):
        scales = 1.5 * np.exp(RUN_SCATTER * rng.standard_normal(n_runs + 1))
        *known, further = scales[:, None] * rng.standard_normal((n_runs + 1, n_errors))
        calibration = calibration_test(known, float(n_runs * n_errors))
        assert calibration is not None
        inside.append(np.mean(np.abs(further) < 1.96 * calibration.widening))
        plain.append(np.mean(np.abs(further) < 1.96))
    assert np.mean(plain) < 0.82
    assert 0.945 < np.mean(inside) < 0.965


def test_intervals_after_many_errors_of_one_run_still_contain_the_scatter_of_runs() -> None:
    errors = np.random.default_rng(5).standard_normal((2, 4000))
    one, two = (calibration_test(list(some), float(some.size)) for some in (errors[:1], errors))
    assert one is not None
    assert two is not None
    assert (one.n_records, two.n_records) == (1, 2)
    assert 1.04 < two.widening / two.scale < one.widening / one.scale < 1.1


def test_intervals_are_never_narrowed() -> None:
    calibration = calibration_test([0.5 * np.random.default_rng(1).standard_normal(400)], 400.0)
    assert calibration is not None
    assert calibration.widening == 1.0


def test_standard_deviations_of_the_simulation_are_widened_by_the_validation_data() -> None:
    sure = with_values(fitted(), {"q_X": 0.2, "q_Y": 0.2, "q_N": 0.2})
    judged = evaluate(sure)
    assert judged.validation is not None
    (view,), (shown,) = sure.validation, judged.validation.records
    own = simulation_run(fitted().model, view.record, view.values, None, parameter_uncertainty(fitted().fit, None))
    factors = {n: c.simulation_widening for n, c in judged.validation.calibration.simulation.items()}
    assert max(factors.values()) > 1.2
    for j, name in enumerate(view.record.outputs):
        np.testing.assert_allclose(shown.simulation.sd[:, j], factors[name] * own.sd[:, j], rtol=1e-6)
    rows = calibration_tables(judged).validation
    assert rows is not None
    assert {n: row.widening for n, row in rows.simulation.items()} == factors


def test_standard_deviations_over_the_horizon_are_widened_by_the_validation_data() -> None:
    narrow = evaluate(with_values(fitted(), {"q_X": 0.2, "q_Y": 0.2, "q_N": 0.2}))
    assert narrow.validation is not None
    for name, factor in narrow.widening.items():
        assert factor == narrow.validation.calibration.horizon[name].widening
    assert max(narrow.widening.values()) > 1.2
    far = narrow.validation.records[0]
    z = {n: (far.record.y[np.searchsorted(far.record.t, p.t), far.record.outputs.index(n)] - p.y) / p.sd
         for n, p in far.horizon.items()}  # fmt: skip
    for name, factor in narrow.widening.items():
        rms = float(np.sqrt(np.nanmean(z[name] ** 2)))
        assert rms * factor == pytest.approx(narrow.validation.calibration.horizon[name].scale, rel=0.35)
