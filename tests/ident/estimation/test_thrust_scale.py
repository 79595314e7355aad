"""Tests of the scale of forces: units of ratios, their errors, and warnings about contradicting priors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seatrial.ident.data.record import LogSegment, make_record
from seatrial.ident.estimation.maximum_likelihood import Fit, fit
from seatrial.ident.estimation.thrust_scale import (
    PriorDistance,
    ReportedEstimates,
    ThrustScale,
    free_unknown_scale,
    least_yaw_inertia,
    model_values,
    prior_distances,
    scaled_to_ahead,
    thrust_scale_of,
)
from seatrial.ident.model.parameter import Parameter, ParameterOrigin
from seatrial.ident.models.horizontal import horizontal_model
from tests.missions import boat_with, channels_of, sail

BUILT_IN, GIVEN, PRIOR = ParameterOrigin.BUILT_IN, ParameterOrigin.GIVEN, ParameterOrigin.PRIOR


@pytest.mark.parametrize(
    ("unit", "thrust", "both"),
    [
        ("kg", "kg/N", "kg/N"),
        ("kg/s", "kg/(s N)", "kg/(s N)"),
        ("N", "1", "1"),
        ("N/sqrt(s)", "1/sqrt(s)", "1/sqrt(s)"),
        ("kg m2/s", "kg m2/(s N)", "kg m2/(s N m)"),
        ("N m", "m", "1"),
        ("kg m", "kg m/N", "kg m/N"),
        ("rad/N", "rad", "rad"),
        ("m/s", "m/s", "m/s"),
        ("", "", ""),
    ],
)
def test_units_of_ratios(unit: str, thrust: str, both: str) -> None:
    assert (ThrustScale(BUILT_IN, GIVEN).unit(unit) or "1") == (thrust or "1")
    assert (ThrustScale(BUILT_IN, BUILT_IN).unit(unit) or "1") == (both or "1")
    assert ThrustScale(GIVEN, GIVEN).unit(unit) == unit


def test_unknown_thrust_and_arms_are_free_parameters() -> None:
    posed = free_unknown_scale(horizontal_model())
    assert [posed.parameter(n).free for n in ("c1", "c2", "y_arm")] == [False, True, True]
    assert posed.parameter("c2").prior == (0.0, pytest.approx(4.005))
    assert "y_left" not in posed.values
    scale = thrust_scale_of(posed)
    assert (scale.relative, scale.relative_yaw, scale.statistical) == (True, True, False)

    model = horizontal_model()
    known = [model.parameter(n).known(v, 0.0, GIVEN) for n, v in (("c1", 12.0), ("c2", 0.0), ("y_left", -0.2))]
    posed = free_unknown_scale(model.replace_parameters(*known))
    assert posed.values["y_right"] == 0.2
    assert thrust_scale_of(posed) == ThrustScale(GIVEN, GIVEN, True)
    uncertain = replace(known[0], prior=(12.0, 1.0), considered=True)
    assert thrust_scale_of(model.replace_parameters(uncertain)).statistical is False

    weighed = model.replace_parameters(model.parameter("m_u").known(12.0, 1.0, PRIOR))
    assert thrust_scale_of(free_unknown_scale(weighed)).thrust is ParameterOrigin.ESTIMATED


@pytest.fixture(scope="module")
def fitted() -> Fit:
    recording, _ = sail(boat_with(None, 3), 60.0, 3)
    model = horizontal_model().with_free(("m_u", "m_v", "m_r", "d_uu", "d_v", "d_r", "c2"))
    record = make_record(model, LogSegment("run", channels_of(recording)), 10.0)
    return fit(model, [record])


@pytest.mark.parametrize("sd", [0.0, 2.0])
def test_forces_are_scaled_to_the_given_thrust_ahead(fitted: Fit, sd: float) -> None:
    """The prior is that of the thrust ahead: its standard uncertainty is the same share of c1."""
    estimate = {p.name: value for p, value in zip(fitted.parameters, fitted.values.tolist(), strict=True)}
    c1, c2 = fitted.model.values["c1"], estimate["c2"]
    model = scaled_to_ahead(fitted.model, fitted, 50.0, sd)
    factor = 50.0 / (c1 + c2)
    assert model.values["c1"] + model.values["c2"] == pytest.approx(50.0)
    assert model.values["c2"] / model.values["c1"] == pytest.approx(c2 / c1)
    for name in ("m_u", "m_r", "d_uu", "d_r"):
        assert model.values[name] == pytest.approx(factor * estimate[name])
    known, c1_now = model.parameter("c1"), model.values["c1"]
    assert (known.free, known.origin) == ((True, PRIOR) if sd else (False, GIVEN))
    assert known.prior == (pytest.approx((c1_now, 0.04 * c1_now)) if sd else None)
    # The motion fixes c2 / c1: with an uncertain c1, a prior of c2 around zero would pull both down, and all masses.
    assert model.parameter("c2").prior == pytest.approx((model.values["c2"] if sd else 0.0, 0.1 * c1_now))


def test_error_of_a_ratio_includes_the_error_of_the_thrust(fitted: Fit) -> None:
    """The reference is a set of draws of the estimates from their distribution."""
    reported = ReportedEstimates(fitted)
    draws = np.random.default_rng(0).multivariate_normal(fitted.values, fitted.covariance, 200_000)
    thrust = fitted.estimate("c1")[0] + draws[:, fitted.names.index("c2")]
    for name, over in (("m_u", thrust), ("m_r", thrust * 0.15)):
        p = fitted.model.parameter(name)
        ratio = draws[:, fitted.names.index(name)] / over
        value, error = reported.estimate(p)
        assert value == pytest.approx(ratio.mean(), rel=1e-3)
        assert error == pytest.approx(ratio.std(), rel=0.02)
    value, error = reported.estimate(fitted.model.parameter("c1"))  # The parameter c1 is fixed, but its ratio is not.
    ratio = fitted.estimate("c1")[0] / thrust
    assert (value, error) == (pytest.approx(ratio.mean(), rel=1e-3), pytest.approx(ratio.std(), rel=0.02))
    np.testing.assert_allclose(np.diag(reported.correlation), 1.0)


def test_model_values_invert_the_reported_values(fitted: Fit) -> None:
    reported = ReportedEstimates(fitted)
    names = {p.name: reported.scale.name(p.name, p.unit) for p in fitted.model.parameters}
    values = {names[p.name]: reported.estimate(p)[0] for p in fitted.model.parameters}
    assert {"m_u/T", "c2/T"} <= set(values)
    assert set(values) != set(fitted.model.values)
    # The model may have another c2: the thrust follows from c1 and the reported share of c2.
    other = fitted.model.with_values({"c2": 5.0, "m_u": 1.0})
    found = model_values(other, values | {"unknown": 1.0})
    assert found == pytest.approx({n: v for n, v in fitted.model.values.items() if n != "c1"})


def test_model_values_are_inside_the_bounds(fitted: Fit) -> None:
    """Rounding makes the mean of estimates at a bound of zero negative, which no model accepts."""
    reported = {"d_u/T": -1e-17, "d_uu/T": -3.0, "m_u/T": -1.0, "k_gyro": 0.1}
    found = model_values(fitted.model, reported)
    assert found["d_u"] == found["d_uu"] == 0.0
    assert found["m_u"] > 0.0
    shafts = replace(
        fitted.model, parameters=(*fitted.model.parameters, Parameter("dead_zone", 0.1, bounds=(0.0, 0.5)))
    )
    found = model_values(shafts, {"dead_zone": -1.3e-17})
    assert shafts.with_values(found).values["dead_zone"] == 0.0


def contradicted_priors(fit: Fit) -> list[PriorDistance]:
    """Return the distances of the priors that the data contradict."""
    return [d for d in prior_distances(fit) if d.contradicts]


def test_estimate_far_from_its_prior_is_reported(fitted: Fit) -> None:
    assert contradicted_priors(fitted) == []
    i = fitted.names.index("m_u")
    value, _ = fitted.estimate("m_u")
    # The distance of a positive parameter is measured in its logarithm.
    usual = replace(fitted.parameters[i], prior=(0.7 * value, 0.06 * value))
    parameters = tuple(usual if k == i else p for k, p in enumerate(fitted.parameters))
    # A built-in prior is not reported. Only a prior of the user is.
    assert contradicted_priors(replace(fitted, parameters=parameters)) == []
    user_prior = replace(usual, origin=ParameterOrigin.PRIOR)
    parameters = tuple(user_prior if k == i else p for k, p in enumerate(fitted.parameters))
    (found,) = contradicted_priors(replace(fitted, parameters=parameters))
    assert (found.parameter.name, found.distance) == ("m_u", pytest.approx(np.log(1 / 0.7) * 0.7 / 0.06, rel=0.2))
    # With an uncertainty of the model that is twice the prior's, the distance is divided by about sqrt(1 + 2^2).
    by_model = np.zeros_like(fitted.considered)
    by_model[i, i] = (2 * value * 0.06 / 0.7) ** 2
    unsure = replace(fitted, parameters=parameters, considered=by_model)
    assert contradicted_priors(unsure) == []
    assert [d.contradicts_if_model_is_right for d in prior_distances(unsure) if d.parameter.name == "m_u"] == [True]
    by_model[i, i] /= 16
    (less,) = contradicted_priors(replace(fitted, parameters=parameters, considered=by_model))
    assert less.distance == pytest.approx(found.distance / np.sqrt(1.25), rel=0.05)


def test_data_cannot_contradict_a_thrust_that_alone_sets_the_scale() -> None:
    """The motion determines c2 / c1, and the built-in prior of c2 around zero would move c1."""
    recording, _ = sail(boat_with(None, 3), 60.0, 3)
    thrust = Parameter("c1", 40.0, "N", prior=(40.0, 0.5), origin=PRIOR)
    far = Parameter("c2", 0.0, "N", prior=(8.0, 0.01), origin=ParameterOrigin.BUILT_IN)
    model = horizontal_model().with_free(("m_u", "m_v", "m_r", "d_uu", "d_v", "d_r"))
    shapes = {p.name: p for p in model.parameters}
    known = [replace(shapes[p.name], value=p.value, prior=p.prior, origin=p.origin, free=True) for p in (thrust, far)]
    found = fit(model.replace_parameters(*known), [make_record(model, LogSegment("run", channels_of(recording)), 10.0)])
    assert [d.parameter.name for d in prior_distances(found)] == []
    given = {"c2": replace(known[1], origin=PRIOR)}
    both = replace(found, parameters=tuple(given.get(p.name, p) for p in found.parameters))
    assert "c1" in [d.parameter.name for d in contradicted_priors(both)]


def test_yaw_inertia_has_a_lower_limit_from_the_thruster_positions(fitted: Fit) -> None:
    assert least_yaw_inertia(fitted) is None  # Thrust and arms are unknown.
    names = ("c1", "c2", "y_left", "y_right")
    known = [replace(fitted.model.parameter(n), origin=GIVEN, free=False) for n in names]
    sure = replace(fitted, model=fitted.model.replace_parameters(*known))
    mass = sure.estimate("m_u")[0]
    assert least_yaw_inertia(sure) == pytest.approx(mass * 0.15**2 / 3)
    assert least_yaw_inertia(sure, 10.0) == pytest.approx(mass * 1.5**2)
