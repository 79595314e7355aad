"""Tests of the smoother against the joint Gaussian of all states, and of its own invariants."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from seatrial.ident.data.record import Record
from seatrial.ident.estimation import likelihood as likelihood_module
from seatrial.ident.estimation.likelihood import Covariances, FilterResult, Likelihood
from seatrial.ident.estimation.smoother import smooth, smoothed_mean, smoothed_states
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Input, Model, Output, Sensor, State, plain_model
from tests.ident.toys import turning, turning_record, values_of
from tests.machine import cpu_seconds


def of_rows(whole: Covariances) -> Callable[[slice], Covariances]:
    """Return a function that gives the covariances of the requested rows, as a filter result needs it."""
    return lambda rows: Covariances(*(a[rows] for a in whole))


def chain(still: bool = False) -> Model:
    """Return a linear, nilpotent model of position, velocity and offset. With ``still``, the offset is known and
    constant.
    """
    return plain_model(
        "chain",
        f=lambda x, u, p: {"a": x.b, "b": u.w, "c": 0.0},
        h=lambda x, u, p: {"y": x.a + x.c},
        states=(
            State("a", x0=0.4, sd0=0.5),
            State("b", noise=0.3, x0=-0.2, sd0=0.3),
            State("c", noise=0.0, x0=0.1, sd0=0.0 if still else 0.2),
        ),
        inputs=(Input("w", hold="linear"),),
        sensors=(Sensor("one", (Output("y", noise="e"),)),),
        parameters=(Parameter("e", 0.2),),
    )


def chain_record(n_rows: int = 15) -> Record:
    rng = np.random.default_rng(5)
    t = np.cumsum(rng.uniform(0.1, 0.4, n_rows))
    y = rng.normal(size=(n_rows, 1))
    y[rng.random(n_rows) < 0.3] = np.nan
    u = rng.normal(size=(n_rows, 1))
    return Record("chain", t, u, np.vstack([u[1:], u[-1:]]), y, ("w",), ("y",))


@pytest.mark.parametrize("still", [False, True])
def test_smoothed_states_are_the_conditional_mean_of_the_joint_gaussian(still: bool) -> None:
    model, record = chain(still), chain_record()
    run = Likelihood(model).filter(record, values_of(model))
    nothing = replace(record, y=np.full_like(record.y, np.nan))
    free = Likelihood(model).filter(nothing, values_of(model))
    n, m = record.n_rows, 3
    C = np.zeros((n * m, n * m))
    for i in range(n):
        block = free.P_pred[i]
        for j in range(i, n):
            C[m * j : m * j + m, m * i : m * i + m] = block
            C[m * i : m * i + m, m * j : m * j + m] = block.T
            block = free.Phi[j] @ block
    H = np.kron(np.eye(n), [[1.0, 0.0, 1.0]])[np.isfinite(record.y[:, 0])]
    S = H @ C @ H.T + 0.04 * np.eye(len(H))
    gain = np.linalg.solve(S, H @ C).T
    y = record.y[np.isfinite(record.y)]
    mean = free.x_pred.ravel() + gain @ (y - H @ free.x_pred.ravel())
    P = C - gain @ S @ gain.T
    found = smooth(run)
    np.testing.assert_allclose(found.x.ravel(), mean, rtol=1e-9, atol=1e-10)
    for k in range(n):
        np.testing.assert_allclose(found.P[k], P[m * k : m * k + m, m * k : m * k + m], rtol=1e-8, atol=1e-11)
    for k in range(n - 1):
        wanted = P[m * k + m : m * k + 2 * m, m * k : m * k + m]
        np.testing.assert_allclose(found.lag_one[k], wanted, rtol=1e-8, atol=1e-10)


def test_covariances_are_positive_and_not_larger_than_the_filters() -> None:
    record, model = turning_record(3, 400), turning()
    run = Likelihood(model).filter(record, values_of(model))
    found = smooth(run)
    assert (np.linalg.eigvalsh(found.P) > 0).all()
    assert (found.sd**2 <= np.diagonal(run.P_filt, axis1=1, axis2=2) * (1 + 1e-9)).all()
    np.testing.assert_array_equal(found.x[-1], run.x_filt[-1])


def test_states_without_variance_keep_their_values() -> None:
    model, record = chain(still=True), chain_record()
    found = smooth(Likelihood(model).filter(record, values_of(model)))
    np.testing.assert_array_equal(found.x[:, 2], 0.1)
    np.testing.assert_array_equal(found.sd[:, 2], 0.0)


def test_singular_covariance_is_handled() -> None:
    """Two states are identical."""
    model, record = chain(), chain_record()
    run = Likelihood(model).filter(record, values_of(model))

    def doubled(a: np.ndarray) -> np.ndarray:
        twice = np.concatenate([a, a[:, :1]], axis=1)
        return twice if a.ndim == 2 else np.concatenate([twice, twice[:, :, :1]], axis=2)

    Phi = np.zeros((record.n_rows, 4, 4))
    Phi[:, :3, :3], Phi[:, 3, 3], Phi[:, 3, 1] = run.Phi, 1.0, run.Phi[:, 0, 1]
    covariances = Covariances(doubled(run.P_pred), doubled(run.P_filt), Phi)
    twin = FilterResult(
        run.t, doubled(run.x_pred), doubled(run.x_filt), of_rows(covariances), run.e, run.R, run.eps, run.S, run.ll
    )
    found, single = smooth(twin), smooth(run)
    np.testing.assert_allclose(found.x[:, :3], single.x, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(found.x[:, 3], single.x[:, 0], rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(found.P[:, :3, :3], single.P, rtol=1e-6, atol=1e-8)


def test_six_thousand_rows_of_fifteen_states_take_less_than_a_second() -> None:
    rng = np.random.default_rng(0)
    n_rows, n = 6000, 15
    Phi = np.eye(n) + 0.05 * rng.normal(size=(n_rows, n, n)) / np.sqrt(n)
    P_filt = np.broadcast_to(np.diag(rng.uniform(0.5, 2.0, n)), (n_rows, n, n)).copy()
    P_pred = np.empty_like(P_filt)
    P_pred[0] = P_filt[0]
    P_pred[1:] = Phi[:-1] @ P_filt[:-1] @ Phi[:-1].swapaxes(1, 2) + 0.1 * np.eye(n)
    x = rng.normal(size=(n_rows, n))
    y = np.empty((n_rows, 1))
    covariances = of_rows(Covariances(P_pred, P_filt, Phi))
    run = FilterResult(np.arange(n_rows) * 0.1, x, x, covariances, y, y[0], y, y, y[:, 0])
    assert cpu_seconds(lambda: smooth(run), 1.0) < 1.0


def test_smoothed_means_alone_equal_those_of_the_full_smoother() -> None:
    model, record = turning(), turning_record()
    run = Likelihood(model).filter(record, values_of(model))
    np.testing.assert_allclose(smoothed_mean(run), smooth(run).x, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("piece", [7, 64])
def test_long_record_smoothed_in_pieces_gives_the_same_result(piece: int, monkeypatch: pytest.MonkeyPatch) -> None:
    model, record = turning(), turning_record()
    assert record.n_rows % piece
    whole = Likelihood(model).filter(record, values_of(model))
    wanted, mean = smooth(whole), smoothed_mean(whole)
    monkeypatch.setattr(likelihood_module, "WHOLE", 0)
    monkeypatch.setattr(likelihood_module, "PIECE", piece)
    run = Likelihood(model).filter(record, values_of(model))
    assert len(run.pieces) > 1
    for name in ("x_pred", "x_filt", "e", "eps", "S", "ll", "P_pred", "P_filt", "Phi"):
        np.testing.assert_array_equal(getattr(run, name), getattr(whole, name), err_msg=name)
    np.testing.assert_array_equal(run.covariances(slice(40, 90)).Phi, whole.Phi[40:90])
    H = np.ones((record.n_rows, 1, len(model.states)))
    np.testing.assert_allclose(run.output_variance(H), whole.output_variance(H), rtol=1e-12)
    found = smooth(run)
    for name in ("x", "P", "lag_one"):
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), rtol=1e-9, atol=1e-13, err_msg=name)
    np.testing.assert_allclose(smoothed_mean(run), mean, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(smoothed_states(run).sd, wanted.sd, rtol=1e-9)
