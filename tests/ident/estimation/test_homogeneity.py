"""Tests of the homogeneity test: its false-alarm rate, its power, and the estimated variation between logs."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from seatrial.daq.errors import SeatrialError
from seatrial.ident.data.record import Record
from seatrial.ident.engine.vectorised_model import VectorisedModel
from seatrial.ident.estimation.homogeneity import between_runs_effect, between_runs_title, homogeneity_test
from seatrial.ident.estimation.maximum_likelihood import EstimationOptions, Method, SearchSettings, fit
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Input, Model, Output, Sensor, State, plain_model
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.results.answers import homogeneity_sentence
from seatrial.ident.results.tables import homogeneity_row


def pushed() -> Model:
    """Return the model of a mass with linear drag under a known push."""
    return plain_model(
        "pushed",
        f=lambda x, u, p: {"u": (u.X - p.d * x.u) / p.m},
        h=lambda x, u, p: {"u": x.u},
        states=(State("u", "m/s", noise=0.01, sd0=0.01),),
        inputs=(Input("X", "N"),),
        sensors=(Sensor("speed", (Output("u", "m/s", "e"),)),),
        parameters=(
            Parameter("m", 40.0, "kg", transform="log"),
            Parameter("d", 8.0, "kg/s"),
            Parameter("e", 0.02, "m/s", transform="log"),
        ),
    )


def records(masses: tuple[float, ...], seed: int, process: float = 0.01) -> list[Record]:
    rng = np.random.default_rng(seed)
    made = []
    for i, m in enumerate(masses):
        t = np.arange(0.0, 30.0, 0.1)
        X = np.where((t > 3) & (t < 18), 10.0, 0.0)
        u = np.zeros(t.size)
        for k in range(t.size - 1):
            u[k + 1] = u[k] + 0.1 * (X[k] - 8.0 * u[k]) / m + process * np.sqrt(0.1) * rng.normal()
        y = (u + 0.02 * rng.normal(size=t.size))[:, None]
        made.append(Record(f"run{i}", t, X[:, None], X[:, None], y, ("X",), ("u",)))
    return made


def test_false_alarm_rate_of_equal_logs_is_the_level() -> None:
    found = []
    for seed in range(40):
        data = records((40.0, 40.0, 40.0), seed)
        found.append(homogeneity_test(fit(pushed(), data), data, "m"))
    p = np.array([a.p for a in found])
    assert stats.kstest(p, "uniform").pvalue > 0.01
    assert np.mean([a.interval[0] < 40.0 < a.interval[1] for a in found]) > 0.85
    assert all(a.df == 2 for a in found)


def test_prior_is_counted_once_and_not_once_for_each_log() -> None:
    """The data contradict the prior. Counted once for each log, it would pull equal logs away from their mean."""
    data = [replace(r, name=f"run{k}") for k, r in enumerate([*records((40.0,), 7)] * 4)]
    with_prior = pushed().replace_parameters(replace(pushed().parameter("m"), prior=(30.0, 2.0)))
    common = fit(with_prior, data)
    found = homogeneity_test(common, data, "m")
    assert common.estimate("m")[0] < fit(pushed(), data).estimate("m")[0] - 0.1
    np.testing.assert_allclose(found.values, found.value, rtol=1e-5)
    assert found.lr < 1e-4


def test_different_logs_are_found_to_differ() -> None:
    data = records((30.0, 40.0, 50.0), 0)
    common = fit(pushed(), data)
    found = homogeneity_test(common, data, "m")
    assert not found.agree
    assert found.p < 1e-6
    assert np.abs(found.values - [30.0, 40.0, 50.0]).max() < 4 * found.errors.max()
    assert found.scatter == pytest.approx(10.0, abs=3.0)
    plain_error = fit(pushed(), data, settings=SearchSettings(robust_errors=False)).estimate("m")[1]
    # The standard error of the common fit is too small, even after its inflation for autocorrelated residuals.
    assert found.mean_error > 3 * plain_error
    assert found.mean_error > 1.5 * found.error > 1.5 * plain_error
    told = homogeneity_sentence(found)
    assert "do not agree" in told
    assert " (run0), " in told
    assert re.search(r"standard errors\) is between \S.* with larger values and run0", told)
    plain = homogeneity_sentence(replace(found, unit="", value=0.17, error=0.0025))
    assert ": 0.1700 ± 0.0025 from all logs together" in plain
    assert "  " not in plain
    assert " ." not in plain
    row = homogeneity_row(found)
    assert row.records == ("run0", "run1", "run2")
    assert row.low is not None
    assert row.high is not None
    assert row.low < 40.0 < row.high


@pytest.mark.parametrize("method", ["prediction-error", "output-error"])
def test_common_and_separate_fits_use_the_same_method(method: Method) -> None:
    """Otherwise an output-error likelihood is compared with a prediction-error likelihood, and equal boats differ."""
    data = records((40.0, 40.0, 40.0), 4)
    common = fit(pushed(), data, EstimationOptions(method=method))
    found = homogeneity_test(common, data, "m")
    of_each = pushed().replace_parameters(replace(pushed().parameter("m"), per_record=True))
    each = fit(of_each, data, EstimationOptions(method=method))
    assert found.lr == pytest.approx(2.0 * (each.log_posterior - common.log_posterior), abs=1e-3)
    assert found.lr < 30.0
    outliers = fit(pushed(), data, EstimationOptions(method=method, outlier_model=True))
    assert homogeneity_test(outliers, data, "m").lr == pytest.approx(found.lr, abs=1.0)


@pytest.mark.parametrize("prior", [None, (60.0, 8.0)])
def test_log_that_does_not_inform_the_parameter_is_left_out(prior: tuple[float, float] | None) -> None:
    """At rest, the data do not inform the mass, and its error is that of the prior. Neither the test nor Student's t
    may count this log.
    """
    data, (still,) = records((40.0, 40.0), 0), records((40.0,), 1)
    still = replace(still, name="still", u=0.0 * still.u, u_next=0.0 * still.u, y=0.0 * still.y)
    model = pushed().with_free(["m"])
    model = model.replace_parameters(replace(model.parameter("m"), prior=prior))
    common = fit(model, [*data, still])
    found = homogeneity_test(common, [*data, still], "m")
    without = homogeneity_test(fit(model, data), data, "m")
    assert (found.df, found.left_out) == (1, ("still",))
    np.testing.assert_allclose([found.lr, found.p], [without.lr, without.p], atol=1e-3)
    np.testing.assert_allclose(found.interval, without.interval, rtol=1e-2)
    assert "still contains no information about it" in homogeneity_sentence(found)
    assert homogeneity_row(found).left_out == ("still",)
    lone = [data[0], still, replace(still, name="also")]
    alone = homogeneity_test(fit(model, lone), lone, "m")
    assert (alone.df, alone.left_out) == (0, ("still", "also"))
    assert homogeneity_sentence(alone) == (
        "m: the logs cannot be compared, because fewer than two contain information about it; give more logs. "
        "still, also contain no information about it."
    )
    assert homogeneity_row(alone).low is None


def test_homogeneity_test_rejects_invalid_requests() -> None:
    data = records((40.0, 40.0), 0)
    common = fit(pushed(), data)
    with pytest.raises(SeatrialError, match=r"--test-homogeneity q: not a free parameter .* choose one of m, d, e"):
        homogeneity_test(common, data, "q")
    single = fit(pushed(), data[:1])
    with pytest.raises(SeatrialError, match="give two logs or more"):
        homogeneity_test(single, data[:1], "m")
    fixed = replace(common, parameters=tuple(p for p in common.parameters if p.name != "m"))
    with pytest.raises(SeatrialError, match="not a free parameter"):
        homogeneity_test(fixed, data, "m")


def test_restricted_fit_is_compared_with_restricted_fits() -> None:
    """The errors are larger because the dynamics take degrees of freedom. The likelihood ratio uses the maxima."""
    data, model = records((40.0, 41.0), 3, 0.0), pushed()
    model = replace(model, states=(replace(model.states[0], noise=0.0),))
    fits = [fit(model, data, EstimationOptions(reml=r)) for r in (False, True)]
    plain, restricted = (homogeneity_test(common, data, "m") for common in fits)
    assert (restricted.errors > 1.0005 * plain.errors).all()
    assert restricted.lr == pytest.approx(plain.lr, abs=1e-3)


def test_candidates_of_differences_between_runs_have_words_for_readers() -> None:
    assert between_runs_title("between-runs:m_v") == "m_v differs between the runs"
    assert between_runs_title("mismatch") == "mismatch"


def test_payload_changes_masses_drag_and_inertia() -> None:
    """A boat with 8 kg more is a boat with other parameters. The share of the load is that of the surge mass."""
    plain = horizontal_model()
    effect = between_runs_effect(plain, "payload")
    loaded = (plain + effect).with_values({"m_payload": 8.0, "k_draught": 0.5, "k_inertia": 0.25})
    share = 8.0 / plain.values["m_u"]
    masses = {n: plain.values[n] + 8.0 for n in ("m_u", "m_v")} | {"m_r": plain.values["m_r"] * (1 + 0.25 * share)}
    drag = {n: plain.values[n] * (1 + 0.5 * share) for n in ("d_u", "d_v", "d_r", "d_uu", "d_vv", "d_rr")}
    heavier = plain.with_values(masses | drag)
    x, u = np.array([[0.0, 0.0, 0.3, 0.8, 0.1, 0.2]]), np.full((1, len(plain.inputs)), 0.4)
    rates = [VectorisedModel(m)(x, u, np.array(list(m.values.values()))) for m in (loaded, heavier)]
    np.testing.assert_allclose(*rates, rtol=1e-12)
