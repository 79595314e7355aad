"""Tests of the likelihood in use: threads, a machine without llvmlite, invalid records and diverging parameters."""

from __future__ import annotations

import math
from dataclasses import replace
from threading import Thread

import numpy as np
import pytest

from seatrial.ident.data.record import Record
from seatrial.ident.engine import filter_kernels, jit, kernel
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Input, Output, Sensor, State, plain_model
from tests.ident.toys import turning, turning_record, values_of

FREE = ("m", "d", "dd", "bias", "q", "e_psi", "e_r", "psi0", "sd0")


def test_full_turns_in_headings_do_not_change_the_likelihood() -> None:
    likelihood, record, v = Likelihood(turning()), turning_record(), values_of(turning())
    turned = record.y + [[2 * np.pi, 0.0, 0.0]] * np.random.default_rng(0).integers(-3, 4, (record.n_rows, 1))
    assert likelihood.value(replace(record, y=turned), v) == pytest.approx(likelihood.value(record, v), rel=1e-9)


def test_diverging_parameter_gives_nan() -> None:
    likelihood, record, v = Likelihood(turning()), turning_record(), values_of(turning())
    v[0] = 1e-6
    assert not math.isfinite(likelihood.value(record, v))
    assert not np.isfinite(likelihood.gradient(record, v)[1]).all()
    assert not np.isfinite(likelihood.scores(record, v, FREE).gradient).all()


def test_parallel_threads_give_the_results_of_one_thread() -> None:
    likelihood, v = Likelihood(turning()), values_of(turning())
    records = [turning_record(seed, 400) for seed in range(4)]
    alone = [likelihood.scores(r, v, FREE).gradient for r in records]
    wrong: list[int] = []

    def work(i: int) -> None:
        for _ in range(50):
            if not np.array_equal(likelihood.scores(records[i], v, FREE).gradient, alone[i]):
                wrong.append(i)

    threads = [Thread(target=work, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_without_llvmlite_the_results_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    record, v = turning_record(n_rows=25), values_of(turning())
    likelihood = Likelihood(turning())
    wanted = likelihood.value(record, v), likelihood.gradient(record, v)[1]
    information = likelihood.scores(record, v, FREE).information
    monkeypatch.setattr(jit, "AVAILABLE", False)
    monkeypatch.setattr(kernel, "_warned", [])
    monkeypatch.setattr(filter_kernels, "_known", {})
    slow = Likelihood(turning())
    with pytest.warns(RuntimeWarning, match="llvmlite is not installed"):
        assert slow.value(record, v) == pytest.approx(wanted[0], rel=1e-12)
    np.testing.assert_allclose(slow.gradient(record, v)[1], wanted[1], rtol=1e-9, atol=1e-9)
    size = np.sqrt(np.diag(information))  # of each parameter
    difference = (slow.scores(record, v, FREE).information - information) / np.outer(size, size)
    assert np.abs(difference).max() < 1e-5  # the derivatives are in single precision


def test_invalid_records_are_named_in_errors() -> None:
    likelihood, record, v = Likelihood(turning()), turning_record(), values_of(turning())
    partly = record.y.copy()
    partly[5] = [np.nan, 0.1, np.nan]
    gap = record.u.copy()
    gap[7] = np.nan
    for bad, words in (
        (replace(record, y=partly), "record run: the sample of the sensor gyros at .* has only some of its outputs"),
        (replace(record, u=gap), "record run: the input N has no value"),
        (replace(record, t=record.t[::-1].copy()), "record run: its times t do not increase"),
        (replace(record, inputs=("M",)), "no signal for the input 'N'"),
        (replace(record, y=record.y[:-1]), r"record run: y is \(119, 3\)"),
    ):
        with pytest.raises(ValueError, match=words):
            likelihood.value(bad, v)
    with pytest.raises(ValueError, match="has 9 parameters"):
        likelihood.value(record, v[:-1])


def test_outputs_are_found_by_name_in_any_order() -> None:
    likelihood, record, v = Likelihood(turning()), turning_record(), values_of(turning())
    permuted = replace(record, y=record.y[:, [2, 0, 1]], outputs=("second", "psi", "gyro"))
    assert likelihood.value(permuted, v) == likelihood.value(record, v)


@pytest.mark.parametrize("process_noise", [True, False])
def test_gradient_of_a_model_whose_rates_do_not_depend_on_its_state(process_noise: bool) -> None:
    """The adjoint of this step stores no state."""
    model = plain_model(
        "integrator",
        f=lambda x, u, p: {"a": p.k * u.w},
        h=lambda x, u, p: {"y": x.a},
        states=(State("a", noise="q", x0=0.1),),
        inputs=(Input("w"),),
        sensors=(Sensor("s", (Output("y", noise="e"),)),),
        parameters=(Parameter("k", 1.0), Parameter("q", 0.1), Parameter("e", 0.2)),
    )
    rng = np.random.default_rng(3)
    w, t = rng.normal(size=(29, 1)), 0.1 * np.arange(29.0)
    record = Record("record", t, w, w, rng.normal(size=(29, 1)), ("w",), ("y",))
    likelihood, v = Likelihood(model, process_noise=process_noise), np.array([1.1, 0.1, 0.2])
    gradient = likelihood.gradient(record, v)[1]
    for i in range(v.size):
        d = 1e-5 * np.eye(v.size)[i]
        wanted = (likelihood.value(record, v + d) - likelihood.value(record, v - d)) / 2e-5
        assert gradient[i] == pytest.approx(wanted, rel=1e-6, abs=1e-6)
