"""Profile likelihoods against closed forms, against refits, and at bounds."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import optimize

from daq.errors import SeatrialError
from ident.dataset import Record
from ident.fit import Fit, fit
from ident.model import Model, Output, Sensor, State, plain_model
from ident.oe import output_error
from ident.outcome import plain
from ident.params import Parameter
from ident.profile import DROP, Profile, check_names, profile, profile_part
from ident.report.page import render
from tests.ident.toys import turning, turning_record

FREE = ("m", "d", "dd", "bias", "q", "e_psi", "e_r")


def scatter(*, logarithmic: bool = True) -> Model:
    """A constant measured with noise: mean and standard deviation of a normal sample."""
    return plain_model(
        "scatter", f=lambda x, u, p: {"a": 0.0 * x.a}, h=lambda x, u, p: {"y": x.a},
        states=(State("a", x0="mean", sd0=0.0),), inputs=(),
        sensors=(Sensor("one", (Output("y", noise="e"),)),),
        parameters=(Parameter("mean", 0.3), Parameter("e", 1.5, transform="log" if logarithmic else "none")))


def sample(n: int = 9) -> Record:
    y = np.random.default_rng(1).normal(2.0, 1.0, (n, 1))
    return Record("few", 0.1 * np.arange(n), np.zeros((n, 0)), np.zeros((n, 0)), y, (), ("y",))


@pytest.fixture(scope="module")
def few() -> tuple[Fit, Record]:
    return fit(scatter(), [sample()]), sample()


@pytest.mark.parametrize("method", ["pe", "oe"])
def test_a_small_normal_sample_has_its_textbook_intervals(method: str) -> None:
    record = sample()
    found = fit(scatter(), [record], method="oe" if method == "oe" else "pe")
    y, n = record.y[:, 0], record.n_rows
    s = y.std()
    spread = profile(found, [record], "e")
    expected = n * (np.log(spread.grid / s) + (s / spread.grid) ** 2 / 2 - 0.5)
    np.testing.assert_allclose(spread.drop, expected, atol=1e-4)

    def excess(e: float) -> float:
        return float(n * (np.log(e / s) + (s / e) ** 2 / 2 - 0.5) - DROP)

    assert spread.low == pytest.approx(optimize.brentq(excess, 0.2 * s, s), rel=2e-3)
    assert spread.high == pytest.approx(optimize.brentq(excess, s, 5 * s), rel=2e-3)
    assert spread.wald_low == pytest.approx(s * math.exp(-1.95996 / math.sqrt(2 * n)), rel=1e-3)
    assert spread.high > 1.02 * spread.wald_high  # nine samples: the likelihood is not quadratic
    mean = profile(found, [record], "mean")
    np.testing.assert_allclose(mean.drop, n / 2 * np.log1p(((mean.grid - y.mean()) / s) ** 2), atol=1e-4)
    half = s * math.sqrt(math.exp(2 * DROP / n) - 1)
    assert (mean.low, mean.high) == pytest.approx((y.mean() - half, y.mean() + half), rel=2e-3)


def test_every_point_is_a_refit() -> None:
    records = [turning_record(seed, 400) for seed in range(2)]
    found = fit(turning().with_free(FREE), records)
    one = profile(found, records, "dd")
    assert one.drop.max() > DROP
    assert one.drop.min() == 0.0
    assert (np.diff(one.grid) > 0).all()
    assert one.grid.size <= 13
    for value, drop in list(zip(one.grid, one.drop, strict=True))[::3]:
        fixed = replace(found.model.parameter("dd"), value=float(value), free=False)
        again = fit(found.model.replace_parameters(fixed), records)
        assert found.log_posterior - again.log_posterior == pytest.approx(drop, abs=5e-3)
    assert one.low == pytest.approx(one.wald_low, abs=0.2 * found.estimate("dd")[1])
    own = profile(found, records, "bias@1")
    assert own.low < found.estimate("bias", 1)[0] < own.high


def test_a_parameter_at_its_bound_has_one_side() -> None:
    record = turning_record(0, 400)
    d = replace(turning().parameter("d"), bounds=(0.0, 1.5), value=1.0)
    found = fit(turning().with_free(FREE).replace_parameters(d), [record])
    one = profile(found, [record], "d")
    assert one.grid[-1] == one.high == one.value == 1.5
    assert 0 < one.low < 1.5
    assert math.isnan(one.wald_low)
    assert one.notes == ("upper side: at its bound",)
    near = replace(d, bounds=(3.0, 50.0), value=4.0)  # within a standard error of the estimate
    found = fit(turning().with_free(FREE).replace_parameters(near), [record])
    one = profile(found, [record], "d")
    assert one.low == one.grid[0] == 3.0
    assert 0 < one.drop[0] < DROP < one.drop[-1]
    assert one.notes == ("lower side: reaches its bound",)


def test_what_the_data_do_not_limit_is_open() -> None:
    """Process noise that is not there: its logarithm may go down for ever."""
    record = sample(60)
    walk = replace(scatter(), states=(State("a", noise="q", x0="mean", sd0=0.0),),
                   parameters=(*scatter().parameters, Parameter("q", 0.3, transform="log")))
    one = profile(fit(walk, [record]), [record], "q")
    assert math.isnan(one.low)
    assert one.high > one.value
    assert "lower side: the data set no limit" in one.notes


def test_what_was_not_estimated_is_named(few: tuple[Fit, Record]) -> None:
    found, record = few
    with pytest.raises(ValueError, match="no profile of sonar: the fit did not estimate it; it estimated mean, e"):
        profile(found, [record], "sonar")
    two = [turning_record(seed, 200) for seed in range(2)]
    with pytest.raises(ValueError, match="each run has its own: bias@0, bias@1"):
        profile(fit(turning().with_free(("m", "bias")), two), two, "bias")
    with pytest.raises(ValueError, match="give the records of the fit"):
        profile(fit(turning().with_free(("m", "bias")), two), two[:1], "m")
    check_names(turning(), ["m", "bias@1"])
    with pytest.raises(SeatrialError, match="--profile mass: model turning has m, d"):
        check_names(turning(), ["mass"])
    with pytest.raises(SeatrialError, match="--profile d: it is given, not estimated; estimated are m"):
        check_names(turning().with_free(("m",)), ["d"])


def test_one_parameter_alone(few: tuple[Fit, Record]) -> None:
    record = few[1]
    model = scatter().with_values({"e": 1.0}).with_free(("mean",))
    one = profile(fit(model, [record]), [record], "mean")
    assert (one.low, one.high) == pytest.approx((one.wald_low, one.wald_high), rel=1e-4)  # quadratic, known noise
    assert output_error(model).value(record, np.array([one.high, 1.0])) == pytest.approx(
        output_error(model).value(record, np.array([one.value, 1.0])) - DROP, abs=1e-4)


def test_the_report_draws_it(few: tuple[Fit, Record], tmp_path: Path) -> None:
    both: list[Profile] = [profile(few[0], [few[1]], n) for n in ("e", "mean")]
    both.append(replace(both[1], name="half<b>", low=float("nan"), wald_low=float("nan"), notes=("lower side: open",)))
    result = {"format": "seatrial-result 1", "kind": "vehicle", "profiles": [profile_part(p) for p in both]}
    page = render(json.loads(json.dumps(plain(result))))
    assert '<section id="profiles"' in page
    assert page.count("Profile likelihood of") >= 3
    assert "open to " in page
    assert "half<b>" not in page.replace("half&lt;b&gt;", "")
    assert '<section id="profiles"' not in render({"kind": "vehicle", "answer": "x"})
