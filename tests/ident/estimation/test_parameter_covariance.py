"""The errors of the parameters in the band of a simulation: by brute force, and whether the band then covers."""

from __future__ import annotations

import numpy as np

from ident.estimation.likelihood import Likelihood
from ident.estimation.maximum_likelihood import SearchSettings, fit
from ident.estimation.output_error import simulate
from ident.estimation.parameter_covariance import parameter_uncertainty, prediction_variance
from ident.validation.prediction_errors import WARM_UP, simulation_run
from tests.ident.sliders import slide, slider
from tests.ident.toys import turning, turning_record

FREE = ("m", "d", "dd", "bias", "q", "e_psi", "e_r")


def test_it_is_the_variance_over_drawn_parameters() -> None:
    """Of a nonlinear model, positive parameters by their logarithm."""
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


def test_noise_and_what_has_no_error_is_left_out() -> None:
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


def test_bands_of_a_model_from_little_data_cover_only_with_it() -> None:
    """Fitted to four seconds, shown forty others: the process noise alone is far from the errors."""
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
