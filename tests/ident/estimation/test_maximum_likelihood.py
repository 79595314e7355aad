"""Tests of maximum likelihood fits: estimates of known truths, and flags for parameters that the data do not inform."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from seatrial.ident.data.record import Record
from seatrial.ident.estimation import fisher_scoring, maximum_likelihood
from seatrial.ident.estimation.fisher_scoring import Problem
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import ROUGH_SEARCH, Fit, SearchSettings, fit
from seatrial.ident.estimation.parameter_covariance import parameter_uncertainty
from seatrial.ident.model.parameter import INF, Parameter, ParameterOrigin
from seatrial.ident.model.structure import Input, Model, Output, Sensor, State, plain_model
from tests.ident.toys import best_start, turning, turning_record, values_of

FREE = ("m", "d", "dd", "bias", "q", "e_psi", "e_r")


def records(n: int = 3) -> list[Record]:
    return [turning_record(seed, 500, f"run {seed}") for seed in range(n)]


@pytest.fixture(scope="module")
def found() -> Fit:
    return fit(turning().with_free(FREE), records(), start={"m": 15.0, "d": 2.0, "q": 0.1})


def test_truth_is_within_the_standard_errors(found: Fit) -> None:
    assert found.converged
    assert found.names == ("m", "d", "dd", "q", "e_psi", "e_r", "bias@0", "bias@1", "bias@2")
    truth = turning().values
    for name, value, error in zip(found.names, found.values, found.errors, strict=True):
        assert abs(value - truth[name.partition("@")[0]]) < 4 * error, name
    assert found.n_measured == sum(int(np.isfinite(r.y).sum()) for r in records())
    assert found.bic == pytest.approx(9 * math.log(found.n_measured) - 2 * found.log_likelihood)
    assert found.model.parameter("m").value == found.estimate("m")[0]
    assert found.record_values.shape == (3, 9)
    assert found.record_values[1, 3] == found.estimate("bias", 1)[0]
    np.testing.assert_allclose(np.diag(found.correlation), 1.0)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), found.errors)
    assert found.gradient_norm < 1e-2
    assert not found.flags


def test_diverging_search_names_its_records(monkeypatch: pytest.MonkeyPatch) -> None:
    def diverging(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(maximum_likelihood, "maximise", diverging)
    with pytest.raises(ValueError, match=r"run 0, run 1: the search .* diverged: SVD did not converge"):
        fit(turning().with_free(FREE), records(2))


def test_shared_parameter_stays_at_its_bound_for_any_number_of_records() -> None:
    """The mean of six equal values at a bound is outside the bound by rounding."""
    bounded = replace(turning().parameter("m"), bounds=(18.6, 60.0), value=30.0)
    model = turning().replace_parameters(bounded).with_free(("m",))
    for n in (2, 6):
        assert fit(model, records(n), settings=ROUGH_SEARCH).model.parameter("m").value == pytest.approx(
            18.6, rel=1e-12
        )


def test_estimate_is_a_maximum(found: Fit) -> None:
    likelihood = Likelihood(turning())
    total = sum(likelihood.value(r, v) for r, v in zip(records(), found.record_values, strict=True))
    assert total == pytest.approx(found.log_likelihood, rel=1e-12)
    for i in (0, 1, 2, 4, 5, 6):
        for sign in (-0.01, 0.01):
            moved = found.record_values.copy()
            moved[:, i] *= 1 + sign
            assert sum(likelihood.value(r, v) for r, v in zip(records(), moved, strict=True)) < total


def test_standard_errors_cover_the_truth() -> None:
    z = []
    for seed in range(24):
        fitted = fit(turning().with_free(FREE), [turning_record(100 + seed, 400)])
        z.append([(fitted.estimate(n)[0] - turning().values[n]) / fitted.estimate(n)[1] for n in FREE])
    assert 0.75 < np.std(z) < 1.25
    assert (np.abs(np.mean(z, axis=0)) < 4 / math.sqrt(24)).all()


def test_considered_parameter_changes_only_the_standard_errors() -> None:
    """The estimates depend on a considered parameter as in a fit with another value of this parameter."""
    names, sd = ("m", "d", "bias"), 0.6

    def fitted(model: Model) -> Fit:
        return fit(model, records(2))

    held = fitted(turning().with_free(names))
    dd = replace(turning().parameter("dd"), prior=(6.0, sd), free=False, considered=True)
    found = fitted(turning().with_free(names).replace_parameters(dd))
    moved = fitted(turning().with_free(names).replace_parameters(dd.known(6.0 + sd / 10, 0.0, dd.origin)))
    assert found.names == held.names == moved.names
    assert found.values == pytest.approx(held.values, rel=1e-9)
    follow = 10 * (moved.values - held.values)
    off = found.covariance - held.covariance - np.outer(follow, follow)
    assert np.abs(off / np.outer(found.errors, found.errors)).max() < 0.03
    assert found.errors[1] > 2 * held.errors[1]
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), found.errors)
    np.testing.assert_allclose(found.covariance - found.considered, held.covariance)
    roots = [parameter_uncertainty(f, 0).root for f in (found, held)]
    np.testing.assert_allclose(roots[0] @ roots[0].T, roots[1] @ roots[1].T)


def test_considered_parameter_can_be_given_and_freed() -> None:
    p = Parameter("k", 0.0, prior=(0.0, 1e-3), free=False, considered=True)
    widened = p.known(0.0, 0.01, ParameterOrigin.PRIOR)
    assert (widened.considered, widened.free, widened.prior) == (True, False, (0.0, 0.01))
    assert not p.known(0.002, 0.0, ParameterOrigin.GIVEN).considered
    model = replace(turning(), parameters=(*turning().parameters, p))
    assert model.considered == ("k",)
    assert model.replace_parameters(p.freed()).considered == ()
    assert [q.exact for q in (p, p.freed(), p.known(0.0, 0.0, ParameterOrigin.GIVEN))] == [False, False, True]
    for wrong in ({"prior": None}, {"per_record": True}):
        with pytest.raises(ValueError, match=r"parameter k: .* \(considered\), so it needs a prior"):
            replace(p, **wrong)


def test_number_of_threads_does_not_change_the_result(found: Fit) -> None:
    start = {"m": 15.0, "d": 2.0, "q": 0.1}
    alone = fit(turning().with_free(FREE), records(), settings=SearchSettings(threads=1), start=start)
    np.testing.assert_allclose(alone.values, found.values, rtol=1e-9)


def test_prior_and_data_are_weighted_by_their_information() -> None:
    model = turning().with_free(("m",))
    free = fit(model, records(1))
    value, error = free.estimate("m")
    prior = (value + error, error)
    m = replace(turning().parameter("m"), prior=prior, transform="none", free=True)
    weighed = fit(model.replace_parameters(m), records(1))
    assert weighed.estimate("m")[0] == pytest.approx(value + error / 2, abs=0.1 * error)
    assert weighed.prior_weight[0] == pytest.approx(0.5, abs=0.1)
    assert free.prior_weight[0] == 0.0
    assert weighed.log_posterior < weighed.log_likelihood < free.log_likelihood


def test_parameter_at_its_bound_has_no_standard_error() -> None:
    d = replace(turning().parameter("d"), bounds=(0.0, 1.5), value=1.0)
    bounded = fit(turning().with_free(FREE).replace_parameters(d), records(1))
    value, error = bounded.estimate("d")
    assert value == 1.5
    assert math.isnan(error)
    assert ("d", "at its bound") in bounded.flags
    assert bounded.converged


def redundant() -> Model:
    """Return a model in which only ratios of m, d and gain are identifiable and `nothing` is unused."""
    return plain_model(
        "redundant",
        f=lambda x, u, p: {"r": (p.gain * u.N - p.d * x.r) / p.m},
        h=lambda x, u, p: {"y": x.r},
        states=(State("r", noise="q", sd0=0.1),),
        inputs=(Input("N", hold="linear"),),
        sensors=(Sensor("gyro", (Output("y", noise="e"),)),),
        parameters=(
            Parameter("m", 9.7, transform="log"),
            Parameter("d", 4.0, transform="log"),
            Parameter("gain", 1.0, transform="log"),
            Parameter("nothing", 1.0),
            Parameter("q", 0.05, transform="log"),
            Parameter("e", 0.01, transform="log"),
        ),
    )


def test_unidentified_parameters_and_combinations_are_flagged() -> None:
    record = turning_record(0, 400)
    record = replace(record, y=record.y[:, 1:2], outputs=("y",))
    result = fit(redundant(), [record])
    assert result.converged
    flags = dict(result.flags)
    assert "do not depend" in flags["nothing"]
    combination = "not identified: the data do not depend on the joint change +1 ln m +1 ln d +1 ln gain"
    assert flags["m"] == flags["d"] == flags["gain"] == combination
    for name in ("m", "d", "gain", "nothing"):
        assert math.isnan(result.estimate(name)[1])
    assert result.estimate("q")[1] > 0


def test_absent_noise_goes_to_zero_and_is_flagged() -> None:
    record = turning_record(0, 400)
    quiet = replace(
        turning(),
        states=(turning().states[0], replace(turning().states[1], noise="q2")),
        parameters=(*turning().parameters, Parameter("q2", 0.05, transform="log")),
    )
    y = record.y.copy()
    y[:, 1:] = np.nan
    psi0 = 0.1 * record.t
    y[:, 0] = np.where(np.isfinite(y[:, 0]), psi0 + 0.02 * np.random.default_rng(0).normal(size=psi0.size), np.nan)
    still = plain_model(
        "still",
        f=lambda x, u, p: {"psi": p.rate},
        h=lambda x, u, p: {"psi": x.psi},
        states=(State("psi", noise="q2", sd0=0.5),),
        inputs=(),
        sensors=quiet.sensors[:1],
        parameters=(
            Parameter("rate", 0.2),
            Parameter("q2", 0.05, transform="log"),
            Parameter("e_psi", 0.05, transform="log"),
        ),
    )
    result = fit(still, [replace(record, y=y[:, :1], outputs=("psi",))])
    assert result.converged
    assert abs(result.estimate("rate")[0] - 0.1) < 4 * result.estimate("rate")[1]
    assert result.estimate("q2")[0] < 0.01


def test_joseph_form_is_accurate_for_an_uncertain_start() -> None:
    """The start is 8.5 orders of magnitude more uncertain than the sensor. The shorter form loses part of the
    difference to rounding, and 3 % of the error.

    At nine orders, Joseph's form converges on some processors only.
    """

    def slide(sd0: float) -> Model:
        return plain_model(
            "slide",
            f=lambda x, u, p: {"s": x.v, "v": -p.d * x.v},
            h=lambda x, u, p: {"y": x.s},
            states=(State("s", sd0=sd0), State("v", sd0=sd0, noise="q")),
            inputs=(),
            sensors=(Sensor("one", (Output("y", noise="e"),)),),
            parameters=(
                Parameter("d", 0.5, transform="log"),
                Parameter("q", 0.01, free=False),
                Parameter("e", 0.001, free=False),
            ),
        )

    t = 0.1 * np.arange(100)
    y = 3.0 + (1.0 - np.exp(-0.3 * t)) / 0.3 + 0.001 * np.random.default_rng(0).normal(size=100)
    record = Record("slide", t, np.zeros((100, 0)), np.zeros((100, 0)), y[:, None], (), ("y",))
    known, joseph = fit(slide(1e3), [record]), fit(slide(3e5), [record], settings=SearchSettings(joseph=True))
    assert joseph.converged
    assert joseph.estimate("d")[0] == pytest.approx(known.estimate("d")[0], rel=1e-3)
    assert joseph.estimate("d")[1] == pytest.approx(known.estimate("d")[1], rel=0.01)


def test_record_that_cannot_be_evaluated_is_named() -> None:
    model = turning().with_free(FREE)
    with pytest.raises(ValueError, match="record run 0: the likelihood of model turning cannot be evaluated"):
        fit(model, records(2), start={"m": 1e-7})
    with pytest.raises(ValueError, match="odd: no signal for the input 'N'"):
        fit(model, [records(1)[0], replace(records(1)[0], name="odd", inputs=("M",))])
    with pytest.raises(ValueError, match="there is no record"):
        fit(model, [])
    with pytest.raises(ValueError, match=r"^run 0: \d measured samples for 7 free parameters of model turning without"):
        fit(model, [turning_record(0, 2, "run 0")])
    with pytest.raises(ValueError, match="no free parameters"):
        fit(model.with_free(()), records(1))
    with pytest.raises(KeyError, match="mass"):
        fit(model, records(1), start={"mass": 1.0})


def test_progress_is_reported() -> None:
    seen: list[tuple[int, float]] = []
    fit(turning().with_free(("m", "d")), records(1), start={"m": 15.0}, progress=lambda i, v: seen.append((i, v)))
    assert [i for i, _ in seen] == list(range(len(seen)))
    assert seen[-1][1] > seen[0][1]


def test_search_begins_at_the_best_of_several_sets_of_initial_values() -> None:
    def first_value(**starts: Any) -> float:
        seen: list[float] = []
        fit(turning().with_free(("m", "d")), records(1), progress=lambda _, v: seen.append(v), **starts)
        return seen[0]

    far, near = {"m": 30.0, "d": 6.0}, {"m": 9.0, "d": 2.5}
    assert first_value(start=near) > first_value(start=far)
    others = ({"m": 25.0}, near, {"m": float("nan")}, {"unknown": 1.0})
    assert first_value(start=far, other_starts=others) == pytest.approx(first_value(start=near))
    assert first_value(start=near, other_starts=(far,)) == pytest.approx(first_value(start=near))


def test_lbfgsb_refines_a_search_in_which_scoring_stops() -> None:
    problem = Problem(Likelihood(turning()), records(1), FREE, 1)
    z = problem.initial_coordinates
    z[0] += 0.4
    start = fisher_scoring.Optimum(z, problem.evaluate(z), 0, 1, 1.0)
    top = fisher_scoring.refine_lbfgsb(problem.value_and_gradient, start, problem.bounds, problem.evaluate, 1e-6)
    best = fisher_scoring.maximise(problem.evaluate, z, problem.bounds, max_iterations=60, tolerance=1e-8)
    assert top.at.value == pytest.approx(best.at.value, abs=1e-3)


def test_posterior_gradients_of_adjoint_and_tangents_are_equal() -> None:
    m = replace(turning().parameter("m"), prior=(8.0, 1.0))
    problem = Problem(Likelihood(turning().replace_parameters(m)), records(2), FREE, 2)
    z = problem.initial_coordinates + 0.1
    value, gradient = problem.value_and_gradient(z)
    at = problem.evaluate(z)
    assert value == pytest.approx(at.value, rel=1e-12)
    assert problem.value(z) == pytest.approx(at.value, rel=1e-12)
    # The forward sensitivities are in single precision.
    assert np.abs((gradient - at.gradient) / np.sqrt(np.diag(at.hessian))).max() < 1e-4


def test_only_the_record_of_a_moved_per_record_parameter_is_evaluated_again(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []
    value = Likelihood.value

    def counted(self: Likelihood, record: Record, values: np.ndarray) -> float:
        seen.append(record.name)
        return value(self, record, values)

    monkeypatch.setattr(Likelihood, "value", counted)
    problem = Problem(Likelihood(turning()), records(3), FREE, 1)
    moved = problem.initial_coordinates.copy()
    moved[problem.names.index("bias@1")] += 0.01
    for z in (problem.initial_coordinates, moved, problem.initial_coordinates):
        assert problem.value(z) == pytest.approx(problem.evaluate(z).value, rel=1e-12)
    assert seen == ["run 0", "run 1", "run 2", "run 1", "run 1"]


def quadratic(z: np.ndarray) -> fisher_scoring.Evaluation:
    """Return the value of a concave bowl with its top at (1, -2). Values beyond 3 are NaN."""
    H = np.array([[2.0, 0.6], [0.6, 1.0]])
    d = z - np.array([1.0, -2.0])
    value = float("nan") if z[0] > 3 else -0.5 * d @ H @ d
    return fisher_scoring.Evaluation(value, -H @ d, H, np.zeros(2))


def test_scoring_stays_inside_bounds_and_avoids_nan() -> None:
    loose = fisher_scoring.Bounds(np.full(2, -INF), np.full(2, INF), np.zeros(2, dtype=bool))
    top = fisher_scoring.maximise(quadratic, np.array([2.9, 50.0]), loose, max_iterations=60, tolerance=1e-10)
    np.testing.assert_allclose(top.z, [1.0, -2.0], atol=1e-4)
    tight = replace(loose, low=np.array([-INF, -1.0]))
    top = fisher_scoring.maximise(quadratic, np.array([0.0, 5.0]), tight, max_iterations=30, tolerance=1e-12)
    np.testing.assert_allclose(top.z, [0.7, -1.0], atol=1e-5)  # This is the maximum of the bowl along the bound.


def shallow(z: np.ndarray) -> fisher_scoring.Evaluation:
    """Return the value of a function with its maximum at 10 in z[0].

    The data hardly inform the logarithm z[1], so its step would be -100000.
    """
    H = np.diag([4.0, 1e-9])
    value = -2.0 * (z[0] - 10.0) ** 2 - 1e-4 * z[1]
    return fisher_scoring.Evaluation(float(value), np.array([-4.0 * (z[0] - 10.0), -1e-4]), H, np.zeros(2))


def test_logarithm_without_information_does_not_block_the_search() -> None:
    bounds = fisher_scoring.Bounds(np.full(2, -INF), np.full(2, INF), np.array([False, True]))
    z = np.zeros(2)
    step = fisher_scoring.solve_step(shallow(z), shallow(z).hessian, z, bounds, 0.0)
    np.testing.assert_allclose(step, [10.0, -fisher_scoring.LARGEST_STEP])
    top = fisher_scoring.maximise(shallow, z, bounds, max_iterations=20, tolerance=1e-2)
    assert top.z[0] == pytest.approx(10.0, abs=1e-2)


def test_best_start_finds_the_maximum() -> None:
    assert best_start(turning(), records(1), {"m": [1.0, 4.0, 10.0, 30.0], "d": [4.0, 40.0]}) == {"m": 10.0, "d": 4.0}


def test_fit_does_not_change_the_values_of_its_model() -> None:
    model = turning()
    before = values_of(model)
    fit(model.with_free(("m",)), records(1))
    np.testing.assert_array_equal(values_of(model), before)
