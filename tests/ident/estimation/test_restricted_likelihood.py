"""Tests of noise by restricted likelihood: the n - 1 of the textbook, and the removed bias of maximum likelihood."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.data.record import Record
from seatrial.ident.estimation.maximum_likelihood import EstimationOptions, SearchSettings, fit
from seatrial.ident.estimation.stochastic_simulation import simulate_stochastic
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Input, Model, Output, Sensor, State, plain_model
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.thruster import thruster_model
from seatrial.ident.studies.cases import make_case
from seatrial.ident.studies.monte_carlo import make_record
from tests.ident.toys import turning, turning_record

FREE = ("m", "d", "dd", "bias", "q", "e_psi", "e_r")


def lines() -> Model:
    """Return a model of a constant and a slope in time, measured with noise."""
    return plain_model(
        "lines",
        f=lambda x, u, p: {"t": 1.0},
        h=lambda x, u, p: {"y": p.mean + p.slope * x.t},
        states=(State("t", sd0=0.0),),
        inputs=(),
        sensors=(Sensor("one", (Output("y", noise="e"),)),),
        parameters=(Parameter("mean", 0.3), Parameter("slope", 0.0), Parameter("e", 1.5, transform="log")),
    )


def sample(n: int) -> Record:
    y = np.random.default_rng(1).normal(2.0, 1.0, (n, 1))
    return Record("few", 0.1 * np.arange(n), np.zeros((n, 0)), np.zeros((n, 0)), y, (), ("y",))


@pytest.mark.parametrize("n", [15, 150])
def test_variance_is_divided_by_the_residual_degrees_of_freedom(n: int) -> None:
    record = sample(n)
    plain, found = (fit(lines(), [record], EstimationOptions(reml=r)) for r in (False, True))
    ratio = found.estimate("e")[0] / plain.estimate("e")[0]
    assert ratio == pytest.approx(np.sqrt(n / (n - 2)), abs=3.0 / n**2)  # The estimate is one step from the maximum.
    assert found.estimate("mean")[0] == pytest.approx(plain.estimate("mean")[0], abs=1e-4)
    assert found.log_likelihood == plain.log_likelihood
    assert found.gradient_norm < 2.0 / n  # The gradient is that of the restricted likelihood.


def test_known_dynamics_take_no_degrees_of_freedom() -> None:
    known = lines().with_free(["e"])
    plain, found = (fit(known, [sample(20)], EstimationOptions(reml=r)) for r in (False, True))
    np.testing.assert_array_equal(found.values, plain.values)
    assert turning().noise_parameters >= {"q", "e_psi", "e_r"}
    assert not turning().noise_parameters & {"m", "d", "dd", "bias"}


def test_correlation_time_of_a_disturbance_is_a_noise_parameter() -> None:
    found = thruster_model(n_delays=9).noise_parameters
    assert {"tau_f", "q_f", "s_n", "e_n", "e_f"} <= found
    assert not found & {"a", "tau", "c1", "c2", "bias"}
    full = with_disturbances(horizontal_model())
    assert {"tau_b", "q_X", "q_Y", "q_N"} <= full.noise_parameters
    assert not full.noise_parameters & {"m_u", "d_u", "d_uu", "m_v", "d_v", "m_r", "d_r", "d_rr", "V_x", "V_y"}


def test_one_step_reaches_the_maximum_of_the_restricted_likelihood() -> None:
    """There are several records, each with its own bias. The gradient vanishes, also from a start on the other side."""
    records = [turning_record(seed, 300, f"run {seed}") for seed in range(2)]
    plain, found = (fit(turning().with_free(FREE), records, EstimationOptions(reml=r)) for r in (False, True))
    assert plain.gradient_norm < 1e-2
    assert found.gradient_norm < 0.03
    assert found.estimate("q")[0] > plain.estimate("q")[0]
    moved = np.abs(found.values - plain.values) / plain.errors
    dynamics = [not turning().noise_parameters & {n} for n in plain.names]
    assert moved[dynamics].max() < 0.05
    again = fit(turning().with_free(FREE), records, EstimationOptions(reml=True), start={"m": 15.0, "q": 0.1})
    np.testing.assert_allclose(again.values, found.values, rtol=1e-4)


def test_output_error_has_no_process_noise_to_restrict() -> None:
    records = [turning_record(1, 200)]
    options = [EstimationOptions(method="output-error", reml=r) for r in (False, True)]
    plain, found = (fit(turning().with_free(FREE), records, o) for o in options)
    np.testing.assert_array_equal(found.values, plain.values)


def test_process_noise_of_short_missions_is_unbiased() -> None:
    case, n = make_case("surge", seconds=80.0), 60
    truth = np.array(list(case.model.values.values()))
    rngs = [np.random.default_rng([5, k]) for k in range(n)]
    _, y = simulate_stochastic(case.model, case.inputs, np.tile(truth, (n, 1)), rngs)
    records = [make_record(case, outputs, f"run {k}") for k, outputs in enumerate(y)]
    bias = {}
    for restricted in (False, True):
        fits = [fit(case.model, [r], EstimationOptions(reml=restricted), SearchSettings(threads=1)) for r in records]
        error = np.log([f.estimate("s_u")[0] / case.model.values["s_u"] for f in fits])
        bias[restricted] = error.mean() / error.std(ddof=1)
    assert bias[False] < -0.4
    assert abs(bias[True]) < 0.35  # The bias is known to 0.13.


def scaled() -> Model:
    """Return a model whose force and mass share a scale that only a weak prior determines."""
    return plain_model(
        "scaled",
        f=lambda x, u, p: {"v": (p.c * u.n - p.d * x.v) / p.m},
        h=lambda x, u, p: {"v": x.v},
        states=(State("v", noise="q", sd0=0.1),),
        inputs=(Input("n"),),
        sensors=(Sensor("one", (Output("v", noise="e"),)),),
        parameters=(
            Parameter("m", 20.0, transform="log"),
            Parameter("d", 8.0, transform="log"),
            Parameter("c", 10.0, transform="log", prior=(10.0, 30.0)),
            Parameter("q", 0.05, transform="log"),
            Parameter("e", 0.05, transform="log"),
        ),
    )


def test_noise_is_not_restricted_along_an_unidentified_direction() -> None:
    rng, t = np.random.default_rng(2), 0.1 * np.arange(300)
    u = np.repeat(rng.uniform(-1, 1, 15), 20)[:, None]
    v = np.zeros(300)
    for k in range(299):
        v[k + 1] = v[k] + 0.1 * (10.0 * u[k, 0] - 8.0 * v[k]) / 20.0 + 0.05 * np.sqrt(0.1) * rng.standard_normal()
    record = Record("scale", t, u, u, v[:, None] + 0.05 * rng.standard_normal((300, 1)), ("n",), ("v",))
    plain, found = (fit(scaled(), [record], EstimationOptions(reml=r)) for r in (False, True))
    for name in ("m", "c"):
        value, error = plain.estimate(name)
        assert error > value  # The scale is unknown.
        assert abs(found.estimate(name)[0] - value) < 0.5 * error
    ratio, known = plain.model.values["c"] / plain.model.values["m"], found.model.values["c"] / found.model.values["m"]
    assert known == pytest.approx(ratio, rel=0.02)
