"""Tests of the likelihood against plain NumPy, a joint Gaussian, finite differences and its own invariances."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from seatrial.ident.data.record import Record
from seatrial.ident.estimation import likelihood as likelihood_module
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import SearchSettings, fit
from seatrial.ident.estimation.prepared_record import Preparer, initial_condition
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Input, Model, Output, Sensor, State, plain_model
from tests.ident.toys import reference_filter, turning, turning_record, values_of

FREE = ("m", "d", "dd", "bias", "q", "e_psi", "e_r", "psi0", "sd0")


REFERENCE = reference_filter()


def numpy_value(record: Record, v: np.ndarray, *, second_order: bool = False) -> float:
    """Return the log-likelihood of a record of `turning` by the reference filter."""
    p = dict(zip(FREE, v, strict=True))
    model = REFERENCE.ReferenceModel(
        f=lambda x, u: np.array([x[1], (u[0] - p["d"] * x[1] - p["dd"] * abs(x[1]) * x[1]) / p["m"]]),
        h=lambda x, u: np.array([x[0], x[1] + p["bias"], 2 * x[1] + 0.1 * u[0]]),
        Q=np.diag([0.02**2, p["q"] ** 2]),
        R=np.array([p["e_psi"], p["e_r"], p["e_r"]]) ** 2,
        sensors=[[0], [1, 2]],
        angles={0},
    )
    start = np.array([p["psi0"], 0.1]), np.diag([0.1**2, p["sd0"] ** 2])
    with pytest.MonkeyPatch.context() as patch:
        if second_order:
            patch.setattr(REFERENCE, "predict", predict_second_order)
        return float(REFERENCE.log_likelihood(model, record.t, record.u, record.y, *start))


def predict_second_order(
    model: Any,
    x: np.ndarray,
    P: np.ndarray,
    u: np.ndarray,
    u_next: np.ndarray,
    h: float,
    first: Any = REFERENCE.predict,
) -> tuple[np.ndarray, np.ndarray]:
    """Add half the trace of P times the second derivatives of the rates to the mean, in the middle of the interval."""
    middle = (u + u_next) / 2
    x_middle = x + h / 2 * model.f(x + h / 2 * model.f(x, u), middle)
    end, P_end = first(model, x, P, u, u_next, h)
    w, V = np.linalg.eigh((P + P_end) / 2)  # The differences run along the principal axes of P.
    step = 1e-3
    bent = [
        (model.f(x_middle + step * v, middle) - 2 * model.f(x_middle, middle) + model.f(x_middle - step * v, middle))
        / step**2
        for v in V.T
    ]
    return end + h * np.asarray(sum(a * b for a, b in zip(w, bent, strict=True))) / 2, P_end


def test_filter_in_the_documentation_equals_the_reference_filter() -> None:
    docs = Path(__file__).resolve().parents[3] / "docs"
    code = (docs / "examples/reference_ekf.py").read_text(encoding="utf-8")
    assert f"```python\n{code}```" in (docs / "theory/estimation.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("joseph", [False, True])
def test_value_equals_a_filter_in_plain_numpy(joseph: bool) -> None:
    record, v = turning_record(), values_of(turning())
    assert Likelihood(turning(), joseph=joseph).value(record, v) == pytest.approx(numpy_value(record, v), rel=1e-9)


def test_second_order_value_equals_a_filter_in_plain_numpy() -> None:
    record, v = turning_record(), values_of(turning())
    bent = Likelihood(replace(turning(), second_order=True)).value(record, v)
    assert bent == pytest.approx(numpy_value(record, v, second_order=True), rel=1e-8)
    assert abs(bent - Likelihood(turning()).value(record, v)) > 1e-3


def test_second_order_mean_equals_a_monte_carlo_mean() -> None:
    """Quadratic drag slows down the mean of many boats because of their spread. A first-order filter misses this."""
    model, x, P = replace(turning(), second_order=True), np.array([0.0, 1.5]), np.diag([1e-4, 0.04])
    N = np.full((11, 1), 3.0)
    record = Record("free", np.arange(11) * 0.05, N, N, np.full((11, 3), np.nan), ("N",), ("psi", "gyro", "second"))
    v = values_of(model)
    bent, plain = (Likelihood(m).forecast(record, v, x, P, 0, 10)[0][-1, 1] for m in (model, turning()))
    rng, r = np.random.default_rng(2), 1.5 + 0.2 * np.random.default_rng(1).normal(size=400_000)
    for _ in range(100):
        kick = 0.05 * math.sqrt(0.005) * rng.normal(size=r.size)
        slope = (3.0 - 4.0 * r - 6.0 * abs(r) * r) / 9.7
        ahead = r + 0.005 * slope + kick
        r = r + 0.0025 * (slope + (3.0 - 4.0 * ahead - 6.0 * abs(ahead) * ahead) / 9.7) + kick
    chance = r.std() / math.sqrt(r.size)
    assert plain - r.mean() > 20 * chance
    assert abs(bent - r.mean()) < 4 * chance + 0.1 * (plain - r.mean())


def linear() -> Model:
    """Return a model with two linear states, each measured by its own sensor.

    The system matrix is nilpotent, so the Runge-Kutta step of the mean and the Taylor series of the covariance are
    exact.
    """
    return plain_model(
        "linear",
        f=lambda x, u, p: {"a": p.k * x.b, "b": u.w},
        h=lambda x, u, p: {"y": x.a, "z": x.b + 0.3 * x.a},
        states=(State("a", noise=0.1, x0=0.4, sd0=0.5), State("b", noise="q", x0=-0.2, sd0=0.3)),
        inputs=(Input("w", hold="linear"),),
        sensors=(Sensor("one", (Output("y", noise="e"),)), Sensor("two", (Output("z", noise="e"),))),
        parameters=(Parameter("k", 2.0), Parameter("q", 0.4), Parameter("e", 0.2)),
    )


def linear_record(n_rows: int = 12) -> Record:
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.05, 0.2, n_rows))
    y = rng.normal(size=(n_rows, 2))
    y[rng.random((n_rows, 2)) < 0.3] = np.nan
    u = rng.normal(size=(n_rows, 1))
    return Record("linear", t, u, np.vstack([u[1:], u[-1:]]), y, ("w",), ("y", "z"))


def joint_gaussian(record: Record, v: np.ndarray) -> float:
    """Return the log density of all measurements, from the mean and covariance of all states at all rows."""
    k, q, e = v
    A = np.array([[0.0, k], [0.0, 0.0]])
    mean, P, identity = np.array([0.4, -0.2]), np.diag([0.25, 0.09]), np.eye(2)
    means, gains, covariances = [mean], [], [P]
    for i, h in enumerate(record.h[:-1]):
        Ah, Q = A * h, np.diag([0.01, q * q]) * h
        Phi = identity + Ah + Ah @ Ah / 2 + Ah @ Ah @ Ah / 6
        half = identity + Ah / 2 + Ah @ Ah / 8
        b0, b1 = np.array([0.0, record.u[i, 0]]), np.array([0.0, record.u_next[i, 0]])
        k1 = A @ mean + b0
        k2 = A @ (mean + h / 2 * k1) + (b0 + b1) / 2
        k3 = A @ (mean + h / 2 * k2) + (b0 + b1) / 2
        mean = mean + h / 6 * (k1 + 2 * k2 + 2 * k3 + A @ (mean + h * k3) + b1)
        P = Phi @ P @ Phi.T + (Phi @ Q @ Phi.T + 4 * half @ Q @ half.T + Q) / 6
        means.append(mean)
        gains.append(Phi)
        covariances.append(P)
    n = record.n_rows
    C = np.zeros((2 * n, 2 * n))
    for i in range(n):
        block = covariances[i]
        for j in range(i, n):
            C[2 * j : 2 * j + 2, 2 * i : 2 * i + 2] = block
            C[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = block.T
            block = gains[j] @ block if j + 1 < n else block
    H = np.kron(np.eye(n), np.array([[1.0, 0.0], [0.3, 1.0]]))
    there = np.isfinite(record.y).ravel()
    S = (H @ C @ H.T + e * e * np.eye(2 * n))[np.ix_(there, there)]
    r = (record.y.ravel() - H @ np.concatenate(means))[there]
    return -0.5 * (r @ np.linalg.solve(S, r) + np.linalg.slogdet(S)[1] + r.size * math.log(2 * math.pi))


def test_value_of_a_linear_model_equals_a_joint_gaussian() -> None:
    record, v = linear_record(), values_of(linear())
    assert Likelihood(linear()).value(record, v) == pytest.approx(joint_gaussian(record, v), rel=1e-9)


@pytest.mark.parametrize("second_order", [False, True])
def test_gradient_equals_finite_differences(second_order: bool) -> None:
    model = replace(turning(), second_order=second_order)
    likelihood, record, v = Likelihood(model), turning_record(), values_of(model)
    value, gradient = likelihood.gradient(record, v)
    assert value == pytest.approx(likelihood.value(record, v), rel=1e-13)
    for i, name in enumerate(FREE):

        def central(e: float, i: int = i) -> float:
            d = np.zeros(v.size)
            d[i] = e * max(abs(v[i]), 0.1)
            return (likelihood.value(record, v + d) - likelihood.value(record, v - d)) / (2 * d[i])

        wanted = (4 * central(1e-4) - central(2e-4)) / 3
        assert gradient[i] == pytest.approx(wanted, rel=1e-6, abs=1e-5), name


@pytest.mark.parametrize("piece", [1, 7, 64])
def test_gradient_of_a_long_record_computed_in_pieces_is_the_same(piece: int, monkeypatch: pytest.MonkeyPatch) -> None:
    likelihood, record, v = Likelihood(turning()), turning_record(), values_of(turning())
    value, gradient = likelihood.gradient(record, v)
    monkeypatch.setattr(likelihood_module, "WHOLE", 0)
    monkeypatch.setattr(likelihood_module, "PIECE", piece)
    assert likelihood.gradient(record, v)[0] == value
    np.testing.assert_array_equal(likelihood.gradient(record, v)[1], gradient)


def test_tangents_equal_the_adjoint_for_any_subset_of_parameters() -> None:
    likelihood, record, v = Likelihood(turning()), turning_record(), values_of(turning())
    gradient = dict(zip(FREE, likelihood.gradient(record, v)[1], strict=True))
    everything = likelihood.scores(record, v, FREE, double=True)
    for chosen in (FREE, ("e_r", "m"), ("psi0",), FREE[::-1]):
        scores = likelihood.scores(record, v, chosen, by_row=True, double=True)
        np.testing.assert_allclose(scores.gradient, [gradient[n] for n in chosen], rtol=1e-9, atol=1e-8)
        places = [FREE.index(n) for n in chosen]
        np.testing.assert_allclose(scores.information, everything.information[np.ix_(places, places)], rtol=1e-9)
        assert scores.by_row is not None
        assert scores.by_row.shape == (record.n_rows, len(chosen))
        np.testing.assert_allclose(scores.by_row.sum(axis=0), scores.gradient, rtol=1e-12)


@pytest.mark.parametrize(
    ("process_noise", "changed", "is_single"),
    [(True, {}, True), (True, {"sd0": 300.0}, False), (False, {}, True), (False, {"e_psi": 1e-22}, False)],
    ids=["usual", "unknown initial rate", "output error", "out of range"],
)
def test_scores_are_in_double_precision_where_single_would_be_inaccurate(
    process_noise: bool, changed: dict[str, float], is_single: bool
) -> None:
    model = turning().with_values(changed)
    record, v = turning_record(), values_of(model)
    likelihood, double = (Likelihood(model, process_noise=process_noise) for _ in range(2))
    for _ in range(2):
        found, wanted = likelihood.scores(record, v, FREE), double.scores(record, v, FREE, double=True)
        # Two kernels: a compiler may order their sums differently. In single precision, 1e-7 would be the difference.
        assert found.value == pytest.approx(wanted.value, rel=1e-13)
        assert np.isfinite(found.information).all()
        assert np.array_equal(found.information, wanted.information) != is_single


@pytest.mark.parametrize("sd0", [1.0, 10.0, 30.0, 100.0, 300.0, 1000.0])
def test_scores_have_small_rounding_errors_for_any_uncertainty_of_the_start(sd0: float) -> None:
    """In single precision alone, the error is a tenth of a standard error from 300 rad/s on."""
    model = turning().with_values({"sd0": sd0})
    likelihood, record, v = Likelihood(model), turning_record(), values_of(model)
    found, exact = (likelihood.scores(record, v, FREE, double=double) for double in (False, True))
    error = np.abs(found.gradient - exact.gradient) / np.sqrt(np.diag(exact.information))
    assert error.max() < 0.03


def test_a_smoothed_heading_needs_no_double_precision() -> None:
    """Its noise is hundreds of times smaller than the standard deviation of the heading at the start."""
    model = turning().with_values({"e_psi": 2e-4})
    likelihood, record, v = Likelihood(model), turning_record(), values_of(model)
    found, exact = (likelihood.scores(record, v, FREE, double=double) for double in (False, True))
    size = np.sqrt(np.diag(exact.information))
    np.testing.assert_allclose(found.gradient / size, exact.gradient / size, atol=0.03)
    assert not np.array_equal(found.gradient, exact.gradient)


@pytest.mark.study
def test_information_is_the_variance_of_the_score() -> None:
    """The model is linear, and 400 records are simulated."""
    model, v, rng = linear(), values_of(linear()), np.random.default_rng(0)
    likelihood, record = Likelihood(model), linear_record(40)
    run_scores, information = [], np.zeros((3, 3))
    for _ in range(400):
        drawn = replace(record, y=_drawn(record, v, rng))
        scores = likelihood.scores(drawn, v, ("k", "q", "e"))
        run_scores.append(scores.gradient)
        information += scores.information / 400
    sd = np.sqrt(np.diag(information))
    covariance = np.cov(np.array(run_scores).T) / np.outer(sd, sd)
    np.testing.assert_allclose(covariance, information / np.outer(sd, sd), atol=0.25)
    assert (np.abs(np.mean(run_scores, axis=0)) < 4 * sd / 20).all()


def _drawn(record: Record, v: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw measurements from the discrete-time distribution of the model."""
    k, q, e = v
    x, y = np.array([0.4, -0.2]) + rng.normal(size=2) * [0.5, 0.3], record.y.copy()
    A = np.array([[0.0, k], [0.0, 0.0]])
    for i, h in enumerate(record.h):
        y[i] = np.where(np.isfinite(y[i]), [x[0], x[1] + 0.3 * x[0]] + e * rng.normal(size=2), np.nan)
        for j in range(20):
            u = record.u[i, 0] + (j + 0.5) / 20 * (record.u_next[i, 0] - record.u[i, 0])
            x = x + h / 20 * (A @ x + [0.0, u]) + np.sqrt(h / 20) * rng.normal(size=2) * [0.1, q]
    return y


def with_rows_between(record: Record) -> Record:
    """Return the record with three rows without samples in each interval. Their inputs are interpolated."""
    between = [record.t[:-1] + share * np.diff(record.t) for share in (0.21, 0.5, 0.83)]
    t = np.sort(np.concatenate([record.t, *between]))
    y = np.full((t.size, record.y.shape[1]), np.nan)
    y[np.searchsorted(t, record.t)] = record.y
    u = np.column_stack([np.interp(t, record.t, column) for column in record.u.T])
    return replace(record, t=t, y=y, u=u, u_next=np.vstack([u[1:], u[-1:]]))


def test_row_without_samples_does_not_change_the_likelihood_of_a_linear_model() -> None:
    """Every step integrates the linear system exactly. The test adds rows twice; some rows have one sample of two."""
    model, record = linear(), linear_record()
    v, likelihood = values_of(model), Likelihood(model)
    once = with_rows_between(record)
    assert np.isfinite(once.y).any(axis=1).sum() == np.isfinite(record.y).any(axis=1).sum() < once.t.size / 3
    value = likelihood.value(record, v)
    for denser in (once, with_rows_between(once)):
        assert likelihood.value(denser, v) == pytest.approx(value, rel=1e-13)
        np.testing.assert_allclose(likelihood.gradient(denser, v)[1], likelihood.gradient(record, v)[1], rtol=1e-10)
    seen = likelihood.filter(once, v).x_filt[np.searchsorted(once.t, record.t)]
    np.testing.assert_allclose(seen, likelihood.filter(record, v).x_filt, rtol=1e-12)


def test_row_without_samples_changes_a_nonlinear_model_only_by_the_integration_error() -> None:
    """The change vanishes as the steps are divided again and again."""
    model, records = turning(), [turning_record()]
    for _ in range(4):
        records.append(with_rows_between(records[-1]))
    values = [Likelihood(model).value(r, values_of(model)) for r in records]
    changes = np.abs(np.diff(values))
    assert np.all(changes[1:] < changes[:-1] / 8)
    assert changes[-1] < 1e-8 * abs(values[-1])


def test_absent_sensor_equals_a_model_without_it() -> None:
    model, record, v = turning(), turning_record(), values_of(turning())
    lone = replace(model, sensors=model.sensors[:1])
    y = record.y.copy()
    y[:, 1:] = np.nan
    alone = Likelihood(lone).value(replace(record, y=record.y[:, :1], outputs=("psi",)), v)
    assert Likelihood(model).value(replace(record, y=y), v) == pytest.approx(alone, rel=1e-13)


def test_likelihood_is_independent_of_units() -> None:
    """The gyros use milliradians instead of radians. The likelihood shifts by the Jacobian, and the score is scaled."""
    model, record, v = turning(), turning_record(), values_of(turning())

    def in_milli(s: object) -> None:
        for name in ("gyro", "second"):
            s.y[name] = 1000.0 * s.y[name]  # type: ignore[attr-defined]

    scaled = replace(model, stages=(*model.stages, ("units", in_milli)))
    y = record.y * [1.0, 1000.0, 1000.0]
    w = v.copy()
    w[FREE.index("e_r")] *= 1000.0
    a, b = Likelihood(model), Likelihood(scaled)
    n = int(np.isfinite(record.y[:, 1:]).sum())
    moved = replace(record, y=y)
    assert b.value(moved, w) == pytest.approx(a.value(record, v) - n * math.log(1000.0), rel=1e-12)
    ga, gb = a.gradient(record, v)[1], b.gradient(moved, w)[1]
    ga[FREE.index("e_r")] /= 1000.0
    np.testing.assert_allclose(gb, ga, rtol=1e-9, atol=1e-9)


def test_order_of_convergence_is_four_for_the_mean_and_two_for_the_covariance() -> None:
    """The states are compared at the end of two seconds without samples, for steps from 0.2 to 0.025 s."""
    model, v = turning(), values_of(turning())
    likelihood = Likelihood(model)

    def at_end(n: int) -> np.ndarray:
        t = np.linspace(0.0, 2.0, n + 1)
        y = np.full((n + 1, 3), np.nan)
        u = 6.0 + t[:, None]
        run = likelihood.filter(Record("r", t, u, np.vstack([u[1:], u[-1:]]), y, ("N",), ("psi", "gyro", "second")), v)
        return np.append(run.x_pred[-1], run.P_pred[-1].ravel())

    exact = at_end(20_000)
    errors = {n: np.abs(at_end(n) - exact) for n in (10, 20, 40, 80)}
    assert (np.log2(errors[10][:2] / errors[20][:2]) > 3.9).all()
    assert (np.log2(errors[40][2:] / errors[80][2:]) > 1.85).all()


def test_filter_result_contains_the_terms_of_the_likelihood() -> None:
    likelihood, record, v = Likelihood(turning()), turning_record(), values_of(turning())
    run = likelihood.filter(record, v)
    assert run.value == pytest.approx(likelihood.value(record, v), rel=1e-12)
    there = np.isfinite(record.y)
    for a in (run.e, run.eps, run.S, run.standardised):
        assert (np.isfinite(a) == there).all()
    parts = -0.5 * (run.eps**2 / run.S + np.log(2 * np.pi * run.S))
    np.testing.assert_allclose(np.nansum(parts, axis=1), run.ll, rtol=1e-10, atol=1e-12)
    # No other output corrects the first output of a single sensor.
    alone = there[:, 1] & ~there[:, 0]
    np.testing.assert_allclose(run.e[alone, 1], run.eps[alone, 1], rtol=1e-12)
    nothing = ~there.any(axis=1)
    np.testing.assert_array_equal(run.x_filt[nothing], run.x_pred[nothing])
    np.testing.assert_allclose(run.P_pred, run.P_pred.swapaxes(1, 2))
    assert (np.linalg.eigvalsh(run.P_filt) > 0).all()
    np.testing.assert_allclose(run.Phi[-1], np.eye(2), atol=1e-15)  # No row follows the last row.
    np.testing.assert_allclose(run.R, [v[5] ** 2, v[6] ** 2, v[6] ** 2])


def test_initial_state_from_the_first_measurement() -> None:
    model, record, v = turning(), turning_record(), values_of(turning())
    measured = replace(model, states=(replace(model.states[0], from_output="psi"), model.states[1]))
    first = record.y[np.isfinite(record.y[:, 0]), 0][0]
    w = v.copy()
    w[FREE.index("psi0")] = first
    assert Likelihood(measured).value(record, v) == pytest.approx(Likelihood(model).value(record, w), rel=1e-13)
    assert Likelihood(measured).gradient(record, v)[1][FREE.index("psi0")] == 0.0


def drifting(unit: float, sd0: float) -> Model:
    """Return a position that moves at an unknown speed, in metres divided by ``unit``."""
    return plain_model(
        "drift",
        f=lambda x, u, p: {"x": p.V},
        h=lambda x, u, p: {"y": x.x},
        states=(State("x", sd0=sd0, from_output="y"),),
        inputs=(),
        sensors=(Sensor("gnss", (Output("y", noise="e"),)),),
        parameters=(Parameter("V", 0.0), Parameter("e", 3.0 / unit, transform="log", free=False)),
    )


@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_first_measurement_is_not_used_twice(unit: float) -> None:
    """The start has a noise of 3 m. The error of the drift must be that of a straight line with its own offset."""
    t, rng, z = 1.0 * np.arange(60), np.random.default_rng(0), []
    empty = np.zeros((t.size, 0))
    line = 3.0 / unit / np.sqrt(np.sum((t - t.mean()) ** 2))
    for _ in range(40):
        y = (0.2 * t + 3.0 * rng.normal(size=t.size)) / unit
        record = Record("run", t, empty, empty, y[:, None], (), ("y",))
        value, error = fit(drifting(unit, 1.0), [record], settings=SearchSettings(robust_errors=False)).estimate("V")
        assert error == pytest.approx(line, rel=0.03)
        z.append((value - 0.2 / unit) / error)
    assert np.std(z) == pytest.approx(1.0, abs=0.25)


def test_accurate_sensor_keeps_the_initial_standard_deviation_of_the_model() -> None:
    """The same holds for an exactly known start, whatever the sensor.

    The noise estimate ignores the wrap of an angle and the irregular samples of a moving boat.
    """
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.choice([0.1, 0.2, 1.0], 400))
    empty = np.zeros((t.size, 0))

    def start(noise: float, sd0: float, sensor: Output) -> float:
        y = 0.7 * t + noise * rng.normal(size=t.size)
        y = np.mod(y, 2 * np.pi) if sensor.angle else y
        model = replace(drifting(1.0, sd0), sensors=(Sensor("gnss", (sensor,)),))
        record = Record("run", t, empty, empty, y[:, None], (), ("y",))
        data = Preparer(model)(record)
        assert data.noise[0] == pytest.approx(noise, rel=0.2)
        return float(initial_condition(model, values_of(model), data, True).s[1]) ** 0.5

    position, heading = Output("y", noise="e"), Output("y", noise="e", angle=True)
    assert start(0.15, 1.0, position) == 1.0
    assert start(3.0, 0.0, position) == 0.0
    assert start(3.0, 1.0, position) == pytest.approx(15.0, rel=0.2)
    assert start(0.05, 0.1, heading) == pytest.approx(0.25, rel=0.2)


def test_late_first_measurement_informs_the_start_less() -> None:
    """The variance grows by the motion of the output meanwhile. The derivative to sd0 stays correct."""
    record, v, at = turning_record(), values_of(turning()), FREE.index("sd0")
    psi, r = turning().states
    measured = replace(turning(), states=(psi, replace(r, from_output="gyro")))
    assert not Preparer(measured)(record).moved.any()
    y = record.y.copy()
    y[record.t < record.t[0] + 3.0, 1:] = np.nan
    late = replace(record, y=y)
    prepared = Preparer(measured)(late)
    gyro = y[np.isfinite(y[:, 1]), 1]
    assert prepared.moved[0] == 0.0
    assert 0.2 < prepared.moved[1] < 3.0 * np.abs(np.diff(gyro)).max() / 0.02
    by_hand = replace(r, x0=float(gyro[0]), sd0=float(np.hypot(v[at], prepared.moved[1])))
    value = Likelihood(replace(turning(), states=(psi, by_hand))).value(late, v)
    assert Likelihood(measured).value(late, v) == pytest.approx(value, rel=1e-12)
    step = np.zeros(v.size)
    step[at] = 1e-4 * v[at]
    plus, minus = (Likelihood(measured).value(late, v + s) for s in (step, -step))
    slope = Likelihood(measured).gradient(late, v)[1][at]
    assert slope == pytest.approx((plus - minus) / (2 * step[at]), rel=1e-4)
