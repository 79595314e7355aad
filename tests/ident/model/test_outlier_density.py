"""Tests of sensors with outliers: the density, the filter update, and estimates with and without outliers."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy import integrate

from seatrial.ident.data.record import Channel, LogSegment, Record
from seatrial.ident.estimation.fitted_model import fit_nominal_model
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import EstimationOptions, Fit, fit
from seatrial.ident.estimation.output_error import output_error
from seatrial.ident.estimation.prepared_record import Preparer, _first_inlier
from seatrial.ident.model import outlier_density
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Model, Output, Sensor, State, plain_model
from seatrial.ident.models.horizontal import horizontal_model
from tests.ident.toys import turning, turning_record, values_of
from tests.missions import boat_with, channels_of, sail

FREE = ("m", "d", "dd", "bias", "q", "e_psi", "e_r")
EDGES = (-1e5, -100.0, -6.0, 0.0, 6.0, 100.0, 1e5)
ROBUST = EstimationOptions(outlier_model=True)


def mean_of(g: object, density: object) -> float:
    return sum(
        integrate.quad(lambda z: float(g(z) * density(z)), a, b, epsabs=1e-13)[0]  # type: ignore[operator]
        for a, b in pairwise(EDGES)
    )


def density(z: float) -> float:
    return float(np.exp(outlier_density.log_density(z)))


def normal(z: float) -> float:
    return float(np.exp(-z * z / 2) / np.sqrt(2 * np.pi))


def test_density_is_normalised_and_its_information_is_right() -> None:
    # This is the probability of the Cauchy part beyond the last edge.
    beyond = outlier_density.SHARE * 2 / np.pi * np.arctan(outlier_density.WIDTH / EDGES[-1])
    assert mean_of(lambda z: 1.0, density) + beyond == pytest.approx(1.0, abs=1e-9)
    assert mean_of(lambda z: outlier_density.score(z) ** 2, density) == pytest.approx(
        outlier_density.INFORMATION[0], abs=1e-6
    )
    scale = mean_of(lambda z: (z * outlier_density.score(z) - 1) ** 2, density) + beyond
    assert scale / 2 == pytest.approx(outlier_density.INFORMATION[1], abs=1e-6)


def test_score_and_its_slope_are_derivatives() -> None:
    z = np.concatenate([np.linspace(-8, 8, 81), [12.0, 35.0, -400.0, 1e7]])
    e = 1e-5 * np.maximum(1.0, np.abs(z))
    first = -(outlier_density.log_density(z + e) - outlier_density.log_density(z - e)) / (2 * e)
    np.testing.assert_allclose(outlier_density.score(z), first, atol=2e-8)
    second = (outlier_density.score(z + e) - outlier_density.score(z - e)) / (2 * e)
    np.testing.assert_allclose(outlier_density.score_slope(z), second, atol=2e-8)
    assert outlier_density.score_slope(np.linspace(-50, 50, 10001)).max() <= 1.0
    assert abs(outlier_density.score(1e7)) < 1e-6


def test_efficiency_on_normal_noise_is_high() -> None:
    """The reference is the asymptotic efficiency A^2 / (B I) of an M-estimator of the mean and of the scale."""
    slope, square = (
        mean_of(outlier_density.score_slope, normal),
        mean_of(lambda z: outlier_density.score(z) ** 2, normal),
    )
    assert slope**2 / square > 0.99
    by_scale = mean_of(lambda z: z * outlier_density.score(z) + z * z * outlier_density.score_slope(z), normal)
    assert by_scale**2 / mean_of(lambda z: (z * outlier_density.score(z) - 1) ** 2, normal) / 2 > 0.98
    # The scale is right to half of that.
    assert mean_of(lambda z: z * outlier_density.score(z), normal) == pytest.approx(1.0, abs=0.01)


def level() -> Model:
    """Return a model of a measured constant."""
    return plain_model(
        "level",
        f=lambda x, u, p: {"a": 0.0 * x.a},
        h=lambda x, u, p: {"y": x.a},
        states=(State("a", x0=0.5, sd0=0.7),),
        inputs=(),
        sensors=(Sensor("one", (Output("y", noise="e"),)),),
        parameters=(Parameter("e", 0.3, transform="log"),),
    )


@pytest.mark.parametrize("y", [0.6, 2.5, 3.4, 4.0, 9.0, -30.0])
def test_update_is_the_posterior_of_the_mixture(y: float) -> None:
    """The reference is the mean and variance of the state after one sample, by quadrature over the noise mixture."""
    model = outlier_density.with_outlier_model(level())
    nothing = np.zeros((2, 0))
    record = Record("one", np.array([0.0, 0.1]), nothing, nothing, np.array([[y], [np.nan]]), (), ("y",))
    run = Likelihood(model).filter(record, np.array([0.3]))
    S = 0.7**2 + 0.3**2
    z = (y - 0.5) / np.sqrt(S)
    share = outlier_density.SHARE / (np.pi * outlier_density.WIDTH) / (1 + (z / outlier_density.WIDTH) ** 2)
    good = (1 - outlier_density.SHARE) * normal(z) / ((1 - outlier_density.SHARE) * normal(z) + share)
    K = 0.7**2 / S
    kept = 2 * z / (outlier_density.WIDTH**2 + z * z)  # An outlier gives almost no information.
    means = np.array([K * np.sqrt(S) * z, K * np.sqrt(S) * kept])
    within = 0.7**2 - K * 0.7**2 * np.array(
        [1.0, 2 * (outlier_density.WIDTH**2 - z * z) / (outlier_density.WIDTH**2 + z * z) ** 2]
    )
    mean = good * means[0] + (1 - good) * means[1]
    variance = good * (within[0] + means[0] ** 2) + (1 - good) * (within[1] + means[1] ** 2) - mean**2
    assert run.x_filt[0, 0] == pytest.approx(0.5 + mean, rel=1e-12)
    assert run.P_filt[0, 0, 0] == pytest.approx(variance, rel=1e-10)
    assert run.ll[0] == pytest.approx(np.log(density(z)) - np.log(S) / 2, rel=1e-12)
    assert bool(run.outliers[0, 0]) == (good < 0.5)


def spoiled(record: Record, seed: int, share: float = 0.01, column: int = 0, noise: float = 0.02) -> Record:
    """Move a share of the samples of one output by 10 to 60 standard deviations.

    The first ten samples stay, because the filter is not initialised yet.
    """
    rng, y = np.random.default_rng(seed), record.y.copy()
    there = np.flatnonzero(np.isfinite(y[:, column]))
    hit = rng.choice(there[10:], max(int(share * there.size), 1), replace=False)
    y[hit, column] += rng.choice([-1, 1], hit.size) * rng.uniform(10, 60, hit.size) * noise
    return replace(record, y=y)


@pytest.mark.parametrize("process_noise", [True, False])
def test_gradient_and_tangents_are_exact(process_noise: bool) -> None:
    model = outlier_density.with_outlier_model(turning(), ["compass"])
    assert outlier_density.robust_sensors(model) == ("compass",)
    likelihood = Likelihood(model) if process_noise else output_error(model)
    record, v = spoiled(turning_record(), 1, 0.1), values_of(model)
    value, gradient = likelihood.gradient(record, v)
    assert value == pytest.approx(likelihood.value(record, v), rel=1e-13)
    scores = likelihood.scores(record, v, list(model.values), double=True)
    np.testing.assert_allclose(scores.gradient, gradient, rtol=1e-9, atol=1e-8)
    assert (np.linalg.eigvalsh(scores.information) > -1e-6).all()
    for i in range(v.size):

        def central(e: float, i: int = i) -> float:
            d = np.zeros(v.size)
            d[i] = e * max(abs(v[i]), 0.1)
            return (likelihood.value(record, v + d) - likelihood.value(record, v - d)) / (2 * d[i])

        assert gradient[i] == pytest.approx((4 * central(1e-4) - central(2e-4)) / 3, rel=1e-5, abs=1e-4)


def test_both_covariance_updates_give_the_same_value() -> None:
    model, record = outlier_density.with_outlier_model(turning()), spoiled(turning_record(), 2, 0.05)
    short, joseph = (Likelihood(model, joseph=j).value(record, values_of(model)) for j in (False, True))
    assert short == pytest.approx(joseph, rel=1e-11)


@pytest.fixture(scope="module")
def pairs() -> list[tuple[Fit, Fit]]:
    """Return plain and robust fits of the same clean data."""
    model = turning().with_free(FREE)
    found = []
    for seed in range(10):
        record = turning_record(300 + seed, 600)
        found.append((fit(model, [record]), fit(model, [record], ROBUST)))
    return found


def test_robust_fit_is_efficient_without_outliers(pairs: list[tuple[Fit, Fit]]) -> None:
    """The difference to an efficient estimate has the variance that the robust estimate lost (Hausman 1978)."""
    z = np.array([(robust_.values - plain.values) / plain.errors for plain, robust_ in pairs])
    assert (z**2).mean() < 0.05
    ratio = np.array([robust_.errors / plain.errors for plain, robust_ in pairs])
    assert 0.97 < ratio.mean() < 1.05


def test_outliers_are_ignored_and_counted() -> None:
    truth, model = turning().values, turning().with_free(FREE)
    inside, broken = [], 0
    for seed in range(6):
        record = spoiled(turning_record(400 + seed, 900), seed)
        found = fit(model, [record], ROBUST)
        assert found.converged
        z = [(found.estimate(n)[0] - truth[n]) / found.estimate(n)[1] for n in FREE]
        assert np.abs(z).max() < 4, dict(zip(FREE, z, strict=True))
        inside += [abs(score) < 3 for score in z]
        plain = fit(model, [record])
        broken += abs(plain.estimate("e_psi")[0] - truth["e_psi"]) > 3 * plain.estimate("e_psi")[1]
        run = Likelihood(found.model).filter(record, found.record_values[0])
        wild = np.flatnonzero(record.y[:, 0] != turning_record(400 + seed, 900).y[:, 0])
        wild = wild[np.isfinite(record.y[wild, 0])]
        assert run.outliers[wild, 0].all()
        assert run.outliers[:, 0].sum() <= wild.size + 1
        assert np.isnan(run.standardised[wild, 0]).all()
        [line, *_] = outlier_density.outlier_notes(found.model, [run.outliers], [np.isfinite(record.y)])
        total = int(np.isfinite(record.y[:, 0]).sum())
        assert line.startswith(f"psi: {run.outliers[:, 0].sum()} of {total} samples were treated as outliers")
        assert "too many" not in line
        many = np.isfinite(record.y) & (np.arange(len(record.y)) % 5 == 0)[:, None]
        [line, *_] = outlier_density.outlier_notes(found.model, [many], [np.isfinite(record.y)])
        assert "too many for outliers: the model lacks an effect" in line
    assert np.mean(inside) > 0.97
    assert broken == 6  # Without the outlier model the outliers bias the fit, so this test can fail.


def test_single_outlier_of_any_size_has_no_influence() -> None:
    model = turning().with_free(FREE)
    record = turning_record(7, 600)
    at = np.flatnonzero(np.isfinite(record.y[:, 1]))[40]
    y = record.y.copy()
    y[at, 1] += 1e6
    robust_, hit = fit(model, [record], ROBUST), fit(model, [replace(record, y=y)], ROBUST)
    z = (hit.values - robust_.values) / robust_.errors
    assert np.abs(z).max() < 0.5


def test_initial_state_is_not_taken_from_an_outlier() -> None:
    """States that start from a measurement take the first sample that agrees with its neighbours."""
    heading = replace(turning().states[0], from_output="psi")
    model = replace(turning(), states=(heading, turning().states[1]))
    y = np.full((8, 3), np.nan)
    y[:, 0] = [0.1, 3.10, 3.12, 3.14, -3.12, -3.10, -3.08, -3.06]  # One outlier, then a turn through pi.
    t = 0.1 * np.arange(8)
    record = Record("start", t, np.zeros((8, 1)), np.zeros((8, 1)), y, ("N",), ("psi", "gyro", "second"))
    assert Preparer(model)(record).first[0] == 0.1
    assert Preparer(outlier_density.with_outlier_model(model))(record).first[0] == 3.10
    steady = replace(record, y=np.where(np.isfinite(y), y[::-1].copy(), y))
    assert Preparer(outlier_density.with_outlier_model(model))(steady).first[0] == -3.06


@pytest.fixture(scope="module")
def uncertain() -> tuple[Model, Record, Fit]:
    """Return a model with an uncertain initial heading from the compass, a record, and its fit."""
    heading = replace(turning().states[0], from_output="psi", sd0=1.0)
    model = replace(turning(), states=(heading, turning().states[1])).with_free(FREE)
    record = turning_record(11, 600)
    return model, record, fit(model, [record], ROBUST)


@pytest.mark.parametrize("hit", [(0,), (1,), (2,), (3,), (4,), (0, 1), (0, 2), (0, 4)])
def test_outliers_among_the_first_samples_have_no_influence(
    uncertain: tuple[Model, Record, Fit], hit: tuple[int, ...]
) -> None:
    """While the state is uncertain, an outlier looks likely. If it were used, good samples would look like outliers."""
    model, record, clean = uncertain
    y, rows = record.y.copy(), np.flatnonzero(np.isfinite(record.y[:, 0]))[list(hit)]
    y[rows, 0] += 0.5 * np.array([1.0, 1.7])[: len(hit)]
    spoilt = replace(record, y=y)
    found = fit(model, [spoilt], ROBUST)
    assert np.abs((found.values - clean.values) / clean.errors).max() < 0.3
    run = Likelihood(found.model).filter(spoilt, found.record_values[0])
    assert np.flatnonzero(run.outliers[:, 0]).tolist() == rows.tolist()
    assert np.isnan(run.standardised[rows, 0]).all()
    notes = outlier_density.outlier_notes(found.model, [run.outliers], [np.isfinite(y)])
    assert notes[0].startswith(f"psi: {len(hit)} of ")
    assert found.n_measured == int(np.isfinite(y).sum()) - (hit[0] == 0) * (2 if hit == (0, 1) else 1)


def test_sample_with_an_outlier_at_the_start_is_left_out_completely() -> None:
    """If one output of two is an outlier, the complete sample is dropped. A sensor without an outlier model is used."""
    record = turning_record(11, 600)
    first = np.flatnonzero(np.isfinite(record.y[:, 1]))[0]
    y = record.y.copy()
    y[first, 2] += 3.0
    spoilt = replace(record, y=y)
    wild = Preparer(outlier_density.with_outlier_model(turning()))(spoilt).outliers
    assert np.argwhere(wild).tolist() == [[first, 1], [first, 2]]
    assert not Preparer(turning())(spoilt).outliers.any()
    model = outlier_density.with_outlier_model(turning())
    gone = replace(spoilt, y=np.where(wild, np.nan, y))
    assert Likelihood(model).value(spoilt, values_of(model)) == Likelihood(model).value(gone, values_of(model))


def test_good_samples_at_the_start_are_kept() -> None:
    """The cases are noise, steady and accelerated motion, coarse resolution, a turn through pi, and too few samples."""
    rng, t = np.random.default_rng(3), 0.1 * np.arange(200)
    noise = rng.standard_normal((300, 200))
    for moved in (0.0 * t, 50.0 * t, 20.0 * t**2, 20.0 * np.sin(2.0 * t), np.cumsum(noise[0])):
        assert not any(_first_inlier(t, moved + sample, False) for sample in noise)
    assert not any(_first_inlier(t, 3.0 * np.sin(3.0 * t + k) + 0.05 * sample, False) for k, sample in enumerate(noise))
    assert not any(_first_inlier(t, np.round(0.3 * sample), False) for sample in noise)
    angle = 3.1 + 2.0 * t + np.pi
    assert not any(_first_inlier(t, np.mod(angle + 0.02 * sample, 2 * np.pi) - np.pi, True) for sample in noise)
    assert _first_inlier(t[:2], np.array([0.0, 9.0]), False) == 0
    assert _first_inlier(t, np.append(9.0, np.round(0.3 * noise[0][1:])), False) == 1


def test_unknown_sensor_is_rejected() -> None:
    with pytest.raises(KeyError, match="no sensor 'sonar'; it has compass, gyros"):
        outlier_density.with_outlier_model(turning(), ["sonar"])


@pytest.mark.study
def test_gnss_with_one_percent_of_gross_outliers() -> None:
    """On a simulated boat, outliers in position change only their count. Without --robust, they increase the noise
    estimate.
    """
    recording, _ = sail(boat_with(None, 3), 200, 1)
    clean = channels_of(recording)
    rng, spoilt = np.random.default_rng(1), dict(clean)
    n = clean["x"].t.size
    # The very first position is an outlier, too.
    hit = np.append(0, rng.choice(np.arange(5, n), n // 100, replace=False))
    for name in ("x", "y"):
        value = clean[name].value.copy()
        value[hit] += rng.choice([-1, 1], hit.size) * rng.uniform(10, 60, hit.size) * 0.15
        spoilt[name] = Channel(clean[name].t, value)
    model = horizontal_model("shaft")
    plain = fit_nominal_model(model, [LogSegment("run", clean)], [])
    fitted = fit_nominal_model(model, [LogSegment("run", spoilt)], [], ROBUST)
    known = np.isfinite(plain.fit.errors)
    moved = (fitted.fit.values - plain.fit.values)[known] / plain.fit.errors[known]
    assert np.abs(moved).max() < 1.0
    notes = dict(line.split(": ", 1) for line in fitted.outlier_notes)
    for name in ("x", "y"):
        counted = int(notes[name].split()[0])
        assert hit.size - 2 <= counted <= hit.size + 1  # The first outlier is before the start of the record.
    assert int(notes["psi"].split()[0]) <= 3
    harmed = fit_nominal_model(model, [LogSegment("run", spoilt)], [])
    assert harmed.fit.estimate("e_xy")[0] > 3 * plain.fit.estimate("e_xy")[0]
    assert harmed.outlier_notes == []
