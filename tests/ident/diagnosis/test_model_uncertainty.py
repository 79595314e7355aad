"""Tests of the uncertainty of an incomplete model: shifts against refits, and their part in covariance and errors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from seatrial.ident.diagnosis.findings import ModelUncertainty
from seatrial.ident.diagnosis.model_uncertainty import model_uncertainty, untested_uncertainty, with_model_uncertainty
from seatrial.ident.diagnosis.score_test import (
    ColumnIndex,
    NormalEquations,
    PriorTerms,
    Score,
    ScoreEquations,
    SensitivityColumns,
)
from seatrial.ident.diagnosis.search import _Search
from seatrial.ident.effects import catalogue
from seatrial.ident.estimation import Fit
from seatrial.ident.model import Effect, EffectKind, ForceCurve, Parameter, ParameterOrigin
from seatrial.ident.models import horizontal_model, with_thrust_of
from seatrial.ident.reporter import QUIET

N = 3000


def regression(seed: int = 3) -> tuple[np.ndarray, np.ndarray, ScoreEquations]:
    """Return columns, residuals of a fit with the first two columns, and the score equations of two candidates."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((N, 5)) @ (np.eye(5) + 0.4)
    y = columns @ np.array([1.0, -0.5, 0.3, 0.0, 0.2]) + rng.standard_normal(N)
    fitted = np.linalg.lstsq(columns[:, :2], y, rcond=None)[0]
    # The innovations are e = y - G theta, so their sensitivities are -G; the score is -(-G)'e = G'e.
    normal = NormalEquations([str(k) for k in range(5)])
    normal.add(range(5), -columns, y - columns[:, :2] @ fitted, np.arange(N) // 50)
    indices = (
        ColumnIndex(SensitivityColumns("one", np.zeros((0, 0, 1)), ("a",)), (2,)),
        ColumnIndex(SensitivityColumns("two", np.zeros((0, 0, 2)), ("b", "c")), (3, 4)),
    )
    equations = ScoreEquations(normal, PriorTerms(np.zeros(2), np.zeros(2)), indices, ("m_u", "m_r"))
    return columns, y, equations


def fitted(origin: str = "given", difference: float = 0.0) -> Fit:
    """Return a fit of m_u = 40 kg and m_r = 9 kg m2, with the effect `mismatch` if ``difference`` is not zero."""
    model = horizontal_model("shaft")
    model = model.replace_parameters(replace(model.parameter("c1"), origin=ParameterOrigin(origin)))
    if difference:
        model = (model + catalogue()["mismatch"]).with_values({"eps_LR": difference})
    blank: dict[str, Any] = dict.fromkeys(Fit.__dataclass_fields__)
    estimated = {"parameters": tuple(model.parameter(n) for n in ("m_u", "m_r")), "values": np.array([40.0, 9.0])}
    return Fit(**blank | {"model": model} | estimated)


def passed(name: str) -> Score:
    return Score(name, 100.0, 1, 50.0, {}, {})


def test_shift_is_the_change_of_the_estimates_by_a_refit_with_the_candidate() -> None:
    columns, y, equations = regression()
    found = model_uncertainty(equations, [passed("two"), passed("one")], {}, fitted())
    assert found is not None
    assert found.candidates == ("one", "two")
    assert found.strongest == "two"
    without = np.linalg.lstsq(columns[:, :2], y, rcond=None)[0]
    for k, added in enumerate(([2], [3, 4])):
        refitted = np.linalg.lstsq(columns[:, [0, 1, *added]], y, rcond=None)[0][:2]
        np.testing.assert_allclose(found.shifts[k], refitted - without, rtol=1e-8)


@pytest.mark.parametrize("variable", ["r", "u"])
def test_error_of_a_sensor_over_its_own_reading_does_not_shift_its_scale(variable: str) -> None:
    """A curve r(r) contains the scale of the gyro, and a curve r(u) does not."""
    rng = np.random.default_rng(1)
    r = rng.standard_normal(N)
    columns = np.column_stack([r, rng.standard_normal(N), r + 0.02 * r**3, r**3])  # scale, another, and the curve
    normal = NormalEquations([str(k) for k in range(4)])
    normal.add(range(4), -columns, 0.1 * r**3 + rng.standard_normal(N), np.arange(N) // 50)
    at = SensitivityColumns("curve", np.zeros((0, 0, 2)), ("a", "b"), kind=EffectKind.NONPARAMETRIC)
    indices = (ColumnIndex(replace(at, curve=ForceCurve("r", variable)), (2, 3)),)
    equations = ScoreEquations(normal, PriorTerms(np.zeros(2), np.full(2, 1.0)), indices, ("k_gyro", "m_u"))
    fit = replace(fitted(), model=horizontal_model("shaft") + catalogue()["gyro-scale"])
    found = model_uncertainty(equations, [passed("curve")], {}, fit)
    assert found is not None
    assert (float(found.shifts[0, 0]) == 0.0) is (variable == "r")
    assert found.shifts[0, 1] != 0.0


def test_shifts_for_given_values_are_those_of_a_regression_with_these_values() -> None:
    columns, y, equations = regression()
    without = np.linalg.lstsq(columns[:, :2], y, rcond=None)[0]
    given = {"b": 0.7, "c": -0.4, "unknown": 5.0}
    refitted = np.linalg.lstsq(columns[:, :2], y - columns[:, 3:] @ np.array([0.7, -0.4]), rcond=None)[0]
    found = equations.shifts("two", {}, given)
    np.testing.assert_allclose([found["m_u"], found["m_r"]], refitted - without, rtol=1e-8)
    assert equations.shifts("three", {}, given) == {}
    assert equations.shifts("two", {"scanned": 1.0}, given) == {}
    assert equations.shifts("two", {}, {"unknown": 5.0}) == {}


def test_joint_steps_of_candidates_are_those_of_one_regression() -> None:
    """The candidates are correlated, so that the sum of their own estimates explains a part twice."""
    columns, y, equations = regression()
    effects = [Effect(n, n, {}, tuple(Parameter(p, 0.0) for p in of)) for n, of in (("one", "a"), ("two", "bc"))]
    search = _Search([], [], {e.name: e for e in effects}, QUIET)
    search.equations = equations
    own = [Score("one", 1.0, 1, 1.0, {"a": 9.0}, {}), Score("two", 1.0, 2, 1.0, {"b": 9.0, "c": 9.0}, {})]
    waves = Score("waves", 1.0, 1, 1.0, {"A": 2.0}, {"f_wave": 0.5})
    one, two = search._joint_steps(own)
    expected = np.linalg.lstsq(columns, y, rcond=None)[0][2:]
    np.testing.assert_allclose([one.step["a"], two.step["b"], two.step["c"]], expected, rtol=1e-8)
    search.candidates["waves"] = Effect("waves", "waves", {}, (Parameter("A", 0.0),))
    assert search._joint_steps([own[0], waves])[1] == waves
    assert search._joint_steps(own[:1]) == own[:1]


def test_prior_of_a_candidate_limits_the_shift() -> None:
    _, _, equations = regression()
    prior = Effect("one", "one", {}, (Parameter("a", 0.0, prior=(0.0, 1e-3)),))
    free = model_uncertainty(equations, [passed("one")], {}, fitted())
    held = model_uncertainty(equations, [passed("one")], {"one": prior}, fitted())
    assert free is not None
    assert held is not None
    assert np.all(np.abs(held.shifts) < 0.02 * np.abs(free.shifts))


def test_no_variance_is_added_if_no_candidate_passes() -> None:
    assert model_uncertainty(regression()[2], [], {}, fitted()) is None
    fit = cast(Fit, object())
    assert with_model_uncertainty(fit, None) is fit


def test_common_errors_add_their_posterior_to_that_of_a_model_without_them() -> None:
    """The peer is the Bayesian regression of all columns together, with the prior of the common error `lift`."""
    columns, y, equations = regression()
    lift = replace(equations.indices[1], columns=replace(equations.indices[1].columns, name="lift"))
    equations = replace(equations, indices=(equations.indices[0], lift))
    sds = (0.01, 0.02)
    priors = tuple(Parameter(n, 0.0, prior=(0.0, sd)) for n, sd in zip(("b", "c"), sds, strict=True))
    effect = Effect("lift", "lift", {}, parameters=priors)
    at = [0, 1, 3, 4]
    X = columns[:, at]
    joint = np.linalg.inv(X.T @ X + np.diag([0.0, 0.0, *(sd**-2 for sd in sds)]))
    alone = np.linalg.inv(X[:, :2].T @ X[:, :2])
    bias = (joint @ X.T @ y)[:2] - alone @ X[:, :2].T @ y
    found = model_uncertainty(equations, [passed("one")], {"lift": effect}, fitted())
    assert found is not None
    assert found.candidates == ("one",)
    np.testing.assert_allclose(found.common_errors, joint[:2, :2] - alone + np.outer(bias, bias), rtol=1e-6)
    # If nothing passes, the model is complete: simulated data show it.
    assert model_uncertainty(equations, [], {"lift": effect}, fitted()) is None


@pytest.mark.parametrize("difference", [0.2, -0.2])
def test_difference_of_the_sides_makes_the_scale_of_given_thrust_uncertain(difference: float) -> None:
    """If one side alone deviates from its curve, all masses and forces change by half the relative difference."""
    equations = regression()[2]
    found = model_uncertainty(equations, [], {}, fitted(difference=difference))
    assert found is not None
    assert found.candidates == ()
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), [8.0, 1.8])
    assert found.covariance[0, 1] == pytest.approx(8.0 * 1.8)
    untested = untested_uncertainty(fitted(difference=difference))
    assert untested is not None
    assert found.weaker_side == untested.weaker_side == ("left" if difference < 0.0 else "right")


@pytest.mark.parametrize("of", ["left", "right", "both"])
def test_the_scale_is_certain_if_the_side_with_the_given_thrust_is_known(of: str) -> None:
    """Neither the difference of the model nor that of a candidate makes the scale uncertain; its shift still counts."""
    equations, unknown = regression()[2], fitted(difference=0.2)
    known = replace(unknown, model=with_thrust_of(unknown.model, of))
    effects = {
        "one": replace(catalogue()["mismatch"], name="one", thrust_difference="a", parameters=(Parameter("a", 0.0),))
    }
    assert untested_uncertainty(unknown) is not None
    assert untested_uncertainty(known) is None
    assert model_uncertainty(equations, [], {}, known) is None
    found = model_uncertainty(equations, [passed("one")], effects, known)
    assert found is not None
    assert found.thrust_difference == 0.0
    assert not found.scale_shift.any()
    assert found.shifts.any()


def test_no_scale_is_uncertain_for_ratios_to_the_thrust_or_with_a_given_mass() -> None:
    given = fitted(difference=0.2)
    mass = replace(given.model.parameter("m_u"), free=False, origin=ParameterOrigin.GIVEN)
    for fit in (fitted("built-in", 0.2), replace(given, model=given.model.replace_parameters(mass))):
        assert model_uncertainty(regression()[2], [], {}, fit) is None


@pytest.mark.parametrize(("thrust_sd", "mass_sd", "share"), [(0.04, 4.0, 0.5), (0.0, 4.0, 1.0), (0.4, 4.0, 1 / 101)])
def test_a_prior_of_a_mass_takes_its_share_of_the_scale(thrust_sd: float, mass_sd: float, share: float) -> None:
    """The difference of the sides makes the scale uncertain only as far as the scale follows from the given thrust."""
    fit = fitted(difference=0.2)
    c1, m_u = fit.model.parameter("c1"), fit.model.parameter("m_u")
    c1 = (
        replace(c1, prior=(c1.value, thrust_sd * c1.value), free=True, origin=ParameterOrigin.PRIOR)
        if thrust_sd
        else c1
    )
    m_u = replace(m_u, prior=(100.0, mass_sd), free=True, origin=ParameterOrigin.PRIOR)
    found = untested_uncertainty(replace(fit, model=fit.model.replace_parameters(c1, m_u)))
    assert found is not None
    assert found.thrust_difference == pytest.approx(0.2 * share)


def test_difference_of_a_candidate_counts_by_its_share_of_the_largest_score() -> None:
    equations = regression()[2]
    effects = {
        "one": replace(catalogue()["mismatch"], name="one", thrust_difference="a", parameters=(Parameter("a", 0.0),))
    }
    step = equations.one_step(np.array([2]), np.zeros(1))[0]
    first = model_uncertainty(equations, [passed("one")], effects, fitted())
    second = model_uncertainty(equations, [passed("one"), replace(passed("two"), lm=400.0)], effects, fitted())
    assert first is not None
    assert second is not None
    assert first.thrust_difference == pytest.approx(abs(step))
    assert second.thrust_difference == pytest.approx(abs(step) / 4)
    np.testing.assert_allclose(np.abs(first.scale_shift), np.abs(step) * np.array([40.0, 9.0]))
    assert first.weaker_side == ("left" if step < 0.0 else "right")


@pytest.mark.parametrize(
    ("of_step", "side"), [(-0.2, "candidate"), (-0.9, ""), (-1.1, ""), (-5.0, "model"), (0.9, "candidate")]
)
def test_the_weaker_side_is_not_named_if_model_and_candidate_disagree(of_step: float, side: str) -> None:
    equations = regression()[2]
    effects = {
        "one": replace(catalogue()["mismatch"], name="one", thrust_difference="a", parameters=(Parameter("a", 0.0),))
    }
    step = equations.one_step(np.array([2]), np.zeros(1))[0]
    found = model_uncertainty(equations, [passed("one")], effects, fitted(difference=of_step * step))
    assert found is not None
    candidate, other = ("left", "right") if step < 0.0 else ("right", "left")
    assert found.weaker_side == {"candidate": candidate, "model": other, "": ""}[side]


def test_candidates_that_act_like_a_difference_of_thrust_are_its_rivals() -> None:
    """The largest criterion is first. A difference that the model has is estimated beside no rivals."""
    equations = regression()[2]
    one = replace(catalogue()["mismatch"], name="one", thrust_difference="a", parameters=(Parameter("a", 0.0),))
    two = Effect("two", "two", {}, parameters=(Parameter("b", 0.0), Parameter("c", 0.0)), alternatives=("one",))
    passing = [passed("two"), passed("one")]
    unrelated = replace(two, alternatives=())
    for effects, rivals in (({"one": one, "two": two}, ("two", "one")), ({"one": one, "two": unrelated}, ("one",))):
        found = model_uncertainty(equations, passing, effects, fitted())
        assert found is not None
        assert found.thrust_rivals == rivals
    estimated = model_uncertainty(equations, passing, {"one": one, "two": two}, fitted(difference=0.2))
    assert estimated is not None
    assert estimated.thrust_rivals == ()


def test_mean_square_of_the_shifts_is_added_to_the_covariance() -> None:
    blank: dict[str, Any] = dict.fromkeys(Fit.__dataclass_fields__)
    covariance = np.array([[4.0, 1.0, np.nan], [1.0, 9.0, np.nan], [np.nan] * 3])
    parameters = tuple(Parameter(n, 1.0) for n in ("m_u", "m_r", "d_r"))
    fit = Fit(
        **blank
        | {
            "parameters": parameters,
            "covariance": covariance,
            "considered": np.zeros((3, 3)),
            "errors": np.array([2.0, 3.0, np.nan]),  # d_r is at its bound
        }
    )
    shifts = np.array([[3.0, 0.0, 1.0], [1.0, 2.0, 1.0]])
    names = ("m_u", "d_r", "m_r")
    found = ModelUncertainty(names, ("a", "b"), shifts[:, [0, 2, 1]], np.zeros((3, 3)), 0.0, np.zeros(3))
    wider = with_model_uncertainty(fit, found)
    added = np.array([[5.0, 1.0], [1.0, 2.0]])  # means of 9 and 1, of 0 and 2, of 0 and 4
    np.testing.assert_allclose(wider.covariance[:2, :2], covariance[:2, :2] + added)
    np.testing.assert_allclose(wider.considered[:2, :2], added)
    np.testing.assert_allclose(wider.errors, [3.0, 11.0**0.5, np.nan])
    assert wider.correlation[0, 1] == pytest.approx(2.0 / (9.0 * 11.0) ** 0.5)
