"""Tests of profile likelihoods against closed forms, against refits, and at bounds."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from scipy import optimize

from seatrial.daq.errors import SeatrialError
from seatrial.ident.data.record import Record
from seatrial.ident.estimation.maximum_likelihood import EstimationOptions, Fit, fit
from seatrial.ident.estimation.output_error import output_error
from seatrial.ident.estimation.profile_likelihood import Profile, profile
from seatrial.ident.estimation.standard_errors import DROP_95
from seatrial.ident.estimation.thrust_scale import ReportedEstimates
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Model, Output, Sensor, State, plain_model
from seatrial.ident.report.page import render
from seatrial.ident.results.result_file import from_json
from seatrial.ident.results.tables import profile_curve
from seatrial.ident.workflows.model_inputs import check_names
from tests.ident.pages import shortened
from tests.ident.report_example_bench import thruster
from tests.ident.stepped import stepped_record, steps
from tests.ident.toys import turning, turning_record

FREE = ("m", "d", "dd", "bias", "q", "e_psi", "e_r")


def scatter(*, logarithmic: bool = True) -> Model:
    """Return a model of a constant measured with noise: the mean and standard deviation of a normal sample."""
    return plain_model(
        "scatter",
        f=lambda x, u, p: {"a": 0.0 * x.a},
        h=lambda x, u, p: {"y": x.a},
        states=(State("a", x0="mean", sd0=0.0),),
        inputs=(),
        sensors=(Sensor("one", (Output("y", noise="e"),)),),
        parameters=(Parameter("mean", 0.3), Parameter("e", 1.5, transform="log" if logarithmic else "none")),
    )


def sample(n: int = 9) -> Record:
    y = np.random.default_rng(1).normal(2.0, 1.0, (n, 1))
    return Record("few", 0.1 * np.arange(n), np.zeros((n, 0)), np.zeros((n, 0)), y, (), ("y",))


@pytest.fixture(scope="module")
def few() -> tuple[Fit, Record]:
    return fit(scatter(), [sample()]), sample()


@pytest.mark.parametrize("method", ["prediction-error", "output-error"])
def test_profile_of_a_small_normal_sample_equals_the_closed_form(method: str) -> None:
    record = sample()
    found = fit(scatter(), [record], EstimationOptions(method=method))
    y, n = record.y[:, 0], record.n_rows
    s = y.std()
    spread = profile(found, [record], "e")
    expected = n * (np.log(spread.grid / s) + (s / spread.grid) ** 2 / 2 - 0.5)
    np.testing.assert_allclose(spread.drop, expected, atol=1e-4)

    def excess(e: float) -> float:
        return float(n * (np.log(e / s) + (s / e) ** 2 / 2 - 0.5) - DROP_95)

    assert spread.low == pytest.approx(optimize.brentq(excess, 0.2 * s, s), rel=2e-3)
    assert spread.high == pytest.approx(optimize.brentq(excess, s, 5 * s), rel=2e-3)
    assert spread.wald_low == pytest.approx(s * math.exp(-1.95996 / math.sqrt(2 * n)), rel=1e-3)
    assert spread.high > 1.02 * spread.wald_high  # With nine samples, the likelihood is not quadratic.
    mean = profile(found, [record], "mean")
    np.testing.assert_allclose(mean.drop, n / 2 * np.log1p(((mean.grid - y.mean()) / s) ** 2), atol=1e-4)
    half = s * math.sqrt(math.exp(2 * DROP_95 / n) - 1)
    assert (mean.low, mean.high) == pytest.approx((y.mean() - half, y.mean() + half), rel=2e-3)


def test_every_point_of_a_profile_is_a_refit() -> None:
    records = [turning_record(seed, 400) for seed in range(2)]
    found = fit(turning().with_free(FREE), records)
    curve_dd = profile(found, records, "dd")
    assert curve_dd.drop.max() > DROP_95
    assert curve_dd.drop.min() == 0.0
    assert (np.diff(curve_dd.grid) > 0).all()
    assert curve_dd.grid.size <= 13
    for value, drop in list(zip(curve_dd.grid, curve_dd.drop, strict=True))[::3]:
        fixed = replace(found.model.parameter("dd"), value=float(value), free=False)
        again = fit(found.model.replace_parameters(fixed), records)
        assert found.log_posterior - again.log_posterior == pytest.approx(drop, abs=5e-3)
    assert curve_dd.low == pytest.approx(curve_dd.wald_low, abs=0.2 * found.estimate("dd")[1])
    own = profile(found, records, "bias@1")
    assert own.low < found.estimate("bias", 1)[0] < own.high


def test_profile_of_a_parameter_at_its_bound_has_one_side() -> None:
    record = turning_record(0, 400)
    d = replace(turning().parameter("d"), bounds=(0.0, 1.5), value=1.0)
    found = fit(turning().with_free(FREE).replace_parameters(d), [record])
    profiled = profile(found, [record], "d")
    assert profiled.grid[-1] == profiled.high == profiled.value == 1.5
    assert 0 < profiled.low < 1.5
    assert math.isnan(profiled.wald_low)
    assert profiled.notes == ("upper side: at its bound",)
    near = replace(d, bounds=(3.0, 50.0), value=4.0)  # The bound is within a standard error of the estimate.
    found = fit(turning().with_free(FREE).replace_parameters(near), [record])
    profiled = profile(found, [record], "d")
    assert profiled.low == profiled.grid[0] == 3.0
    assert 0 < profiled.drop[0] < DROP_95 < profiled.drop[-1]
    assert profiled.notes == ("lower side: reaches its bound",)


def test_profile_is_open_if_the_data_set_no_limit() -> None:
    """The process noise is zero, so its logarithm has no lower limit."""
    record = sample(60)
    walk = replace(
        scatter(),
        states=(State("a", noise="q", x0="mean", sd0=0.0),),
        parameters=(*scatter().parameters, Parameter("q", 0.3, transform="log")),
    )
    profiled = profile(fit(walk, [record]), [record], "q")
    assert math.isnan(profiled.low)
    assert profiled.high > profiled.value
    (note,) = profiled.notes
    assert note.startswith("lower side: the data set no limit; the search ended at ")
    assert float(note.rpartition(" ")[2]) == pytest.approx(profiled.grid[0], rel=1e-3)


def curve(mean: Callable[[Any], Any], *parameters: Parameter) -> Model:
    """Return a model of a constant that is a function of parameters, measured with noise."""
    return plain_model(
        "curve",
        f=lambda x, u, p: {"a": 0.0 * x.a},
        h=lambda x, u, p: {"y": x.a + mean(p)},
        states=(State("a", x0=0.0, sd0=0.0),),
        inputs=(),
        sensors=(Sensor("one", (Output("y", noise="e"),)),),
        parameters=(*parameters, Parameter("e", 1.5, transform="log")),
    )


def scattered(mean: float, s: float, n: int = 9) -> tuple[Record, float]:
    """Return samples with the given mean and standard deviation, and the half width of the profile interval of the
    mean.
    """
    y = np.random.default_rng(1).normal(0.0, 1.0, n)
    y = (mean + s * (y - y.mean()) / y.std())[:, None]
    record = Record("few", 0.1 * np.arange(n), np.zeros((n, 0)), np.zeros((n, 0)), y, (), ("y",))
    return record, s * math.sqrt(math.exp(2 * DROP_95 / n) - 1)


@pytest.mark.parametrize(("power", "start"), [(2, 0.01), (2, 3.0), (6, 0.2)])
def test_parameter_without_slope_at_its_estimate_has_an_interval(power: int, start: float) -> None:
    """The output is an even power with its optimum at zero, where gradient and information are zero."""
    record, half = scattered(0.0, 1.0)
    found = fit(curve(lambda p: p.b**power, Parameter("b", start)), [record])
    profiled = profile(found, [record], "b")
    end = half ** (1 / power)
    assert (profiled.low, profiled.high) == (pytest.approx(-end, rel=0.01), pytest.approx(end, rel=0.01))
    assert profiled.notes == ()
    assert profiled.grid.size <= 33


def test_interval_of_one_term_of_an_identified_sum_is_limited_by_the_bounds_of_the_other() -> None:
    record, half = scattered(0.7, 0.02)
    model = curve(lambda p: p.b1 + p.b2, Parameter("b1", 0.5), Parameter("b2", 0.3, bounds=(0.0, 5.0)))
    found = fit(model, [record])
    first = profile(found, [record], "b1")
    assert (first.low, first.high) == (pytest.approx(-4.3 - half, rel=1e-3), pytest.approx(0.7 + half, abs=0.004))
    assert first.drop.max() < 4 * DROP_95  # Points that only closed a bracket are not drawn.
    second = profile(found, [record], "b2")
    assert (second.low, second.high) == (0.0, 5.0)
    assert second.notes == ("lower side: reaches its bound", "upper side: reaches its bound")


def test_profile_reports_where_the_likelihood_is_not_a_number() -> None:
    record, half = scattered(0.2, 1.0)
    profiled = profile(fit(curve(lambda p: np.sqrt(p.b), Parameter("b", 0.5)), [record]), [record], "b")
    assert math.isnan(profiled.low)
    assert profiled.high == pytest.approx((0.2 + half) ** 2, rel=0.01)
    (note,) = profiled.notes
    assert note.startswith("lower side: the likelihood cannot be evaluated beyond ")
    assert float(note.rpartition(" ")[2]) == pytest.approx(0.0, abs=0.02)


# The second case jumps over the maximum.
@pytest.mark.parametrize(("y", "z", "s"), [(-1.0, -0.3, 1.5), (-0.8, -0.3, 1.2)])
def test_better_optimum_found_by_the_profile_replaces_the_estimate(y: float, z: float, s: float) -> None:
    """The likelihood has two maxima, and the fit is at the lower one. Between them it drops by less than 1.92."""
    model = plain_model(
        "summits",
        f=lambda x, u, p: {"a": 0.0 * x.a},
        h=lambda x, u, p: {"y": x.a + 0.6 * np.cos(3 * p.b), "z": x.a + p.b},
        states=(State("a", x0=0.0, sd0=0.0),),
        inputs=(),
        sensors=(Sensor("one", (Output("y", noise="e"), Output("z", noise="e"))),),
        parameters=(Parameter("b", 0.9), Parameter("e", 1.5, transform="log")),
    )
    few, _ = scattered(y, s)
    record = replace(few, y=np.hstack([few.y, few.y[::-1] - y + z]), outputs=("y", "z"))
    found, global_fit = (fit(model, [record], start={"b": b}) for b in (0.9, -0.9))
    assert found.converged
    assert global_fit.converged
    assert found.estimate("b")[0] > 0.6 > -0.7 > global_fit.estimate("b")[0]
    profiled, same = (profile(f, [record], "b") for f in (found, global_fit))
    assert profiled.value == pytest.approx(same.value, abs=1e-3)
    assert (profiled.low, profiled.high) == pytest.approx((same.low, same.high), rel=0.02)
    assert profiled.drop.min() == 0.0
    gain = global_fit.log_likelihood - found.log_likelihood
    assert profiled.notes == (
        f"the profile found a fit with a log-likelihood larger by {gain:.2g}, and belongs to that fit: fit again with "
        f"--initial b={profiled.value:.6g}",
    )
    assert same.notes == ()


@pytest.mark.parametrize("name", ["c2", *(pytest.param(name, marks=pytest.mark.study) for name in ("c1", "d"))])
def test_profiles_beside_and_along_a_flat_interval(name: str) -> None:
    """The end of the dead zone lies between two set-points. The data do not locate it, so no other parameter may depend
    on it.
    """
    found, record = steps(0.07), stepped_record(0.07)
    profiled = profile(found, [record], name)
    value, error = found.estimate(name)
    assert profiled.low == pytest.approx(value - 1.96 * error, abs=0.2 * error)
    assert profiled.high == pytest.approx(value + 1.96 * error, abs=0.2 * error)


def test_parameter_that_was_not_estimated_is_rejected(few: tuple[Fit, Record]) -> None:
    found, record = few
    with pytest.raises(ValueError, match="no profile of sonar: the fit did not estimate it; it estimated mean, e"):
        profile(found, [record], "sonar")
    two = [turning_record(seed, 200) for seed in range(2)]
    with pytest.raises(ValueError, match="each run has its own: bias@0, bias@1"):
        profile(fit(turning().with_free(("m", "bias")), two), two, "bias")
    with pytest.raises(ValueError, match="give the records to which the model was fitted"):
        profile(fit(turning().with_free(("m", "bias")), two), two[:1], "m")
    check_names(turning(), ["m", "bias@1"], 2)
    with pytest.raises(SeatrialError, match="--profile mass: model turning has no such parameter; it has m, d"):
        check_names(turning(), ["mass"], 1)
    with pytest.raises(
        SeatrialError, match="--profile d: the parameter is fixed, not estimated; the estimated ones are m"
    ):
        check_names(turning().with_free(("m",)), ["d"], 1)


def test_profile_of_the_only_parameter(few: tuple[Fit, Record]) -> None:
    record = few[1]
    model = scatter().with_values({"e": 1.0}).with_free(("mean",))
    profiled = profile(fit(model, [record]), [record], "mean")
    # The noise is known, so the likelihood is quadratic.
    assert (profiled.low, profiled.high) == pytest.approx((profiled.wald_low, profiled.wald_high), rel=1e-4)
    assert output_error(model).value(record, np.array([profiled.high, 1.0])) == pytest.approx(
        output_error(model).value(record, np.array([profiled.value, 1.0])) - DROP_95, abs=1e-4
    )


def test_report_draws_profiles(few: tuple[Fit, Record], tmp_path: Path) -> None:
    both: list[Profile] = [profile(few[0], [few[1]], n) for n in ("e", "mean")]
    both.append(replace(both[1], name="half<b>", low=float("nan"), wald_low=float("nan"), notes=("lower side: open",)))
    bare = from_json(json.dumps(shortened(thruster())).encode())
    curves = tuple(profile_curve(p, ReportedEstimates(few[0])) for p in both)
    page = render(msgspec.structs.replace(bare, profiles=curves))
    assert '<section id="profiles"' in page
    assert page.count("Profile likelihood of") >= 3
    assert "open to " in page
    assert "half<b>" not in page.replace("half&lt;b&gt;", "")
    assert '<section id="profiles"' not in render(bare)
