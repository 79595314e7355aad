"""Tests of the parameter uncertainty in the band of a simulation: Monte Carlo variance and coverage of the band."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seatrial.ident.data.record import Record
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import SearchSettings, fit
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.estimation.parameter_covariance import (
    ParameterCovariance,
    ParameterUncertainty,
    parameter_uncertainty,
    prediction_variance,
    uncertainty_of,
)
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Output, Sensor, State, plain_model
from seatrial.ident.validation.prediction_errors import WARM_UP, simulation_run
from tests.ident.sliders import slide, slider
from tests.ident.toys import turning, turning_record

FREE = ("m", "d", "dd", "bias", "q", "e_psi", "e_r")


def test_prediction_variance_equals_that_over_drawn_parameters() -> None:
    """The model is nonlinear. Positive parameters are drawn by their logarithms."""
    record = turning_record(3, 400)
    found = fit(turning().with_free(FREE), [record])
    likelihood, known = Likelihood(found.model), 150
    values = found.record_values[0]
    added = prediction_variance(parameter_uncertainty(found, 0), found.model, record, values, known, likelihood)
    assert (added[:known] == 0.0).all()
    rng, names = np.random.default_rng(0), [p.name for p in found.model.parameters]
    at = [names.index(n.partition("@")[0]) for n in found.names]
    log = np.array([found.model.parameters[i].transform == "log" for i in at])
    scale = np.where(log, values[at], 1.0)
    steps = rng.multivariate_normal(np.zeros(len(at)), found.covariance / np.outer(scale, scale), 400)
    start, tracks = likelihood.filter(record, values).x_filt[known - 1], []
    for step in steps:
        moved = values.copy()
        moved[at] = np.where(log, moved[at] * np.exp(step), moved[at] + step)
        tracks.append(simulate(found.model, record.part(record.t[known - 1], 1e9), moved, start).y[1:])
    drawn = np.std(tracks, axis=0)[-100:]
    np.testing.assert_allclose(np.sqrt(added[-100:]) / drawn, 1.0, atol=0.2)


def test_block_starts_with_its_own_initial_state() -> None:
    """An unmeasured state starts in a block from the middle of a run."""
    model = plain_model(
        "behind",
        f=lambda x, u, p: {"n": 0.02 * (1.0 - x.n), "v": p.k * x.n - x.v},
        h=lambda x, u, p: {"y": x.v},
        states=(State("n", sd0=1e-3), State("v", noise=1e-3, sd0=1.0)),
        inputs=(),
        sensors=(Sensor("one", (Output("y", noise="e"),)),),
        parameters=(Parameter("k", 1.0), Parameter("e", 0.02, transform="log")),
    )
    t = 0.1 * np.arange(600)
    n = 1.0 - np.exp(-0.02 * t)
    y = (n + 0.02 * np.random.default_rng(0).normal(size=t.size))[:, None]
    empty = np.zeros((t.size, 0))
    run = Record("run", t, empty, empty, y, (), ("y",))
    found, values, likelihood = fit(model, [run]), np.array([1.0, 0.02]), Likelihood(model)
    block = replace(run.part(30.0, 60.0), start={"n": (float(n[300]), 1e-3), "v": (float(n[300]), 0.1)})
    added = prediction_variance(parameter_uncertainty(found), model, block, values, 150, likelihood)
    # The output is k n / 1. Its sensitivity is n, about one half at the end.
    assert np.sqrt(added[-1, 0]) == pytest.approx(found.errors[0] * n[-1], rel=0.1)


def test_variance_is_infinite_if_a_prediction_diverges_within_the_parameter_error() -> None:
    """No numerical warning may appear, because pytest treats warnings as errors."""
    model = plain_model(
        "grows",
        f=lambda x, u, p: {"v": p.k * x.v},
        h=lambda x, u, p: {"y": x.v},
        states=(State("v", sd0=1.0),),
        inputs=(),
        sensors=(Sensor("one", (Output("y", noise="e"),)),),
        parameters=(Parameter("k", -0.05), Parameter("e", 0.02, transform="log")),
    )
    t = 0.1 * np.arange(2000)
    empty, y = np.zeros((t.size, 0)), np.exp(-0.05 * t)[:, None]
    run = Record("run", t, empty, empty, y, (), ("y",))
    far, values = ParameterUncertainty((0,), np.array([[3.0]])), np.array([-0.05, 0.02])
    added = prediction_variance(far, model, run, values, 100, Likelihood(model))[:, 0]
    assert (added[:100] == 0.0).all()
    assert 0.0 < added[105] < np.inf
    assert not np.isnan(added).any()
    assert (added[-100:] == np.inf).all()


def test_noise_parameters_and_parameters_without_errors_are_left_out() -> None:
    model = turning().with_free(FREE)
    records = [turning_record(seed, 200, f"run {seed}") for seed in range(2)]
    found = fit(model, records)
    names = [p.name for p in model.parameters]
    assert [names[c] for c in parameter_uncertainty(found).columns] == ["m", "d", "dd"]
    assert [names[c] for c in parameter_uncertainty(found, 1).columns] == ["m", "d", "dd", "bias"]
    nothing = fit(turning().with_free(["q"]), records)
    none, values = parameter_uncertainty(nothing), nothing.record_values[0]
    free = simulation_run(nothing.model, records[0], values, uncertainty=none)
    np.testing.assert_array_equal(free.sd, simulation_run(nothing.model, records[0], values).sd)


def test_bands_of_a_model_from_little_data_cover_only_with_parameter_uncertainty() -> None:
    """The models are fitted to four seconds and predict forty other records. The process noise alone is far too
    small.
    """
    inside: dict[bool, list[np.ndarray]] = {False: [], True: []}
    for seed in range(40):
        found = fit(slider(), [slide(500 + seed, 40)], settings=SearchSettings(threads=1))
        record = slide(100 + seed, 400)
        rows = np.flatnonzero((record.t > WARM_UP) & np.isfinite(record.y[:, 1]))
        for doubtful in inside:
            doubt = parameter_uncertainty(found) if doubtful else None
            free = simulation_run(found.model, record, found.record_values[0], uncertainty=doubt)
            inside[doubtful].append(np.abs(record.y[rows] - free.y[rows]) < 1.96 * free.sd[rows])
    assert np.mean(inside[False]) < 0.85
    assert 0.9 < np.mean(inside[True]) < 0.985


def test_saved_covariance_gives_the_uncertainty_of_the_fit() -> None:
    found = fit(turning().with_free(FREE), [turning_record(3, 400)])
    saved = ParameterCovariance(tuple(found.names), found.covariance)
    by_fit, by_file = parameter_uncertainty(found, 0), uncertainty_of(saved, found.model)
    assert by_file is not None
    shared = [by_file.columns.index(c) for c in by_fit.columns if c in by_file.columns]
    assert len(shared) >= 3
    at = [by_fit.columns.index(by_file.columns[k]) for k in shared]
    here, there = (u.root @ u.root.T for u in (by_file, by_fit))
    np.testing.assert_allclose(here[np.ix_(shared, shared)], there[np.ix_(at, at)], rtol=1e-6)
    noise = {found.model.parameters[c].name for c in by_file.columns} & set(found.model.noise_parameters)
    assert not noise
    assert uncertainty_of(ParameterCovariance(), found.model) is None
