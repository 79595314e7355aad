"""Tests of the meta-analysis of separate fits: published numbers, coverage, false alarms and power by simulation."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.estimation.meta_analysis import (
    between_log_variance,
    campaign_difference,
    conditional_mean,
    joint_difference,
    mean_of_logs,
    random_effects,
)
from seatrial.ident.numerics import Array

# Thirteen trials of the BCG vaccine (Colditz et al. 1994): cases and others among vaccinated and controls, latitude
BCG = (
    (4, 119, 11, 128, 44), (6, 300, 29, 274, 55), (3, 228, 11, 209, 42), (62, 13536, 248, 12619, 52),
    (33, 5036, 47, 5761, 13), (180, 1361, 372, 1079, 44), (8, 2537, 10, 619, 19), (505, 87886, 499, 87892, 13),
    (29, 7470, 45, 7232, 27), (17, 1699, 65, 1600, 42), (186, 50448, 141, 27197, 18), (5, 2493, 3, 2338, 33),
    (27, 16886, 29, 17825, 33),
)  # fmt: skip


def bcg() -> tuple[Array, Array, Array]:
    """Return logarithms of relative risks, their variances and the latitude of each trial."""
    a, b, c, d, latitude = np.array(BCG, dtype=float).T
    return np.log(a / (a + b) / (c / (c + d))), 1 / a - 1 / (a + b) + 1 / c - 1 / (c + d), latitude


def test_random_effects_of_a_published_example() -> None:
    """The numbers are those of the R package metafor (Viechtbauer 2010, J. Stat. Softw. 36(3)), method REML."""
    values, variances, latitude = bcg()
    found = random_effects(values, variances, np.ones((13, 1)))
    assert found.scatter**2 == pytest.approx(0.3132, abs=5e-5)
    assert found.coefficients == pytest.approx([-0.7145], abs=5e-5)
    assert found.covariance[0, 0] ** 0.5 == pytest.approx(0.1798, abs=5e-5)
    mean = found.contrast(np.ones(1))  # test = "knha"
    assert (mean.error, mean.low, mean.high) == pytest.approx((0.1808, -1.1084, -0.3206), abs=5e-5)
    regression = random_effects(values, variances, np.column_stack([np.ones(13), latitude]))
    assert regression.scatter**2 == pytest.approx(0.0764, abs=1e-4)
    assert regression.coefficients == pytest.approx([0.2515, -0.0291], abs=5e-5)
    assert np.sqrt(np.diag(regression.covariance)) == pytest.approx([0.2491, 0.0072], abs=5e-5)


def test_between_log_variance_of_known_values() -> None:
    rng = np.random.default_rng(0)
    found = []
    for _ in range(200):
        V = np.diag(rng.uniform(0.5, 2.0, 8) ** 2)
        found.append(
            between_log_variance(10.0 + 3.0 * rng.normal(size=8) + np.sqrt(np.diag(V)) * rng.normal(size=8), V)
        )
    scatter, mean, error = np.array(found).T
    assert np.median(scatter) == pytest.approx(3.0, rel=0.15)
    assert np.std((mean - 10.0) / error) == pytest.approx(1.0, abs=0.2)
    tau, mean0, error0 = between_log_variance(np.array([5.0, 5.1, 4.9]), np.eye(3))
    assert tau == 0.0
    assert (mean0, error0) == pytest.approx((5.0, 3**-0.5))


def test_value_without_a_standard_error_is_ignored() -> None:
    V = np.diag([1.0, np.nan, 1.0])
    assert between_log_variance(np.array([1.0, 99.0, 3.0]), V)[1] == pytest.approx(2.0)
    assert np.isnan(between_log_variance(np.array([1.0, 99.0]), np.diag([1.0, np.nan]))[1])


def drawn(
    rng: np.random.Generator, n: int, scatter: float, change: float = 0.0, common: float = 0.0
) -> tuple[Array, Array, Array, Array]:
    """Return estimates of n logs of each campaign, their own variances, common errors, and the campaign of each."""
    after = np.repeat([False, True], n)
    own = rng.uniform(0.5, 1.5, 2 * n)
    values = 10.0 + change * after + np.sqrt(own + scatter**2) * rng.normal(size=2 * n) + common * rng.normal()
    return values, own, np.full((2 * n, 1), common), after


@pytest.mark.parametrize("n", [2, 3, 8])
@pytest.mark.parametrize("scatter", [0.0, 2.0])
def test_interval_of_a_difference_contains_it(n: int, scatter: float) -> None:
    """The error of a common prior is five times that of a log, and cancels."""
    rng = np.random.default_rng(1)
    found = [campaign_difference(*drawn(rng, n, scatter, 3.0, 5.0)).difference for _ in range(300)]
    inside = np.mean([d.low < 3.0 < d.high for d in found])
    assert inside > 0.915  # two standard deviations below 0.95, with 0.01 for the approximation
    if n == 8:
        assert np.std([d.value for d in found]) == pytest.approx(np.mean([d.error for d in found]), rel=0.2)


def test_error_of_a_prior_counts_in_the_means_only() -> None:
    after = np.array([False, False, True, True])
    found = campaign_difference(np.array([1.0, 1.1, 2.0, 2.1]), np.full(4, 0.01), np.full((4, 1), 3.0), after)
    assert found.before.error == pytest.approx(3.0, rel=0.01)
    assert found.difference.value == pytest.approx(1.0)
    assert found.difference.error == pytest.approx(0.1, rel=0.01)


def test_mean_stays_among_logs_whose_common_error_is_in_proportion_to_their_estimates() -> None:
    """Weights with the common errors would give a mean below all logs (Peelle's pertinent puzzle)."""
    values, after = np.array([37.0, 36.0, 42.0, 43.0, 44.0]), np.array([False, False, True, True, True])
    common = 0.19 * values[:, None] * after[:, None]
    found = campaign_difference(values, np.full(5, 0.5**2), common, after)
    assert 42.0 <= found.after.value <= 44.0
    assert found.after.error == pytest.approx(0.19 * 43.0, rel=0.02)
    assert found.difference.error == pytest.approx(0.19 * 43.0, rel=0.02)  # no such error before, so nothing cancels
    assert found.scatter < 2.0


def test_one_log_of_each_campaign_has_no_test() -> None:
    found = campaign_difference(np.array([1.0, 9.0]), np.full(2, 0.01), np.zeros((2, 0)), np.array([False, True]))
    assert found.difference.value == pytest.approx(8.0)
    assert np.isnan([found.difference.p, found.difference.low, found.scatter]).all()
    assert found.df == 0
    p, _ = joint_difference(
        np.array([[1.0], [9.0]]), np.full((2, 1, 1), 0.01), np.zeros((2, 1, 0)), np.array([False, True])
    )
    assert np.isnan(p)


def together(rng: np.random.Generator, scatter: float, change: float, n: int = 3) -> tuple[Array, Array, Array, Array]:
    """Return estimates of two parameters with a correlation of -0.98, whose weighted sum is well determined."""
    own = np.array([[1.0, -0.98], [-0.98, 1.0]])
    after, root = np.repeat([False, True], n), np.linalg.cholesky(own)
    values = (
        rng.normal(size=(2 * n, 2)) @ root.T + scatter * rng.normal(size=(2 * n, 1)) + 0.5 * change * after[:, None]
    )
    return values, np.repeat(own[None], 2 * n, axis=0), np.zeros((2 * n, 2, 0)), after


@pytest.mark.parametrize("scatter", [0.0, 1.0])
def test_false_alarms_of_the_joint_test(scatter: float) -> None:
    """Both true values scatter together, which a chi-squared test of diagonal scatter would take for a change."""
    rng = np.random.default_rng(2)
    alarms = sum(joint_difference(*together(rng, scatter, 0.0))[0] < 0.05 for _ in range(300))
    assert alarms <= 25  # 15 are expected


def test_joint_test_finds_a_change_that_no_parameter_shows() -> None:
    rng = np.random.default_rng(3)
    joint = single = 0
    for _ in range(50):
        values, own, common, after = together(rng, 0.0, 2.0)
        joint += joint_difference(values, own, common, after)[0] < 0.05
        single += any(
            campaign_difference(values[:, j], own[:, j, j], common[:, j], after).difference.p < 0.05 for j in range(2)
        )
    assert joint >= 45
    assert single <= 15


def test_mean_of_logs_is_that_of_a_common_fit() -> None:
    """The estimates of linear regressions on parts of data, weighted, are that of all data."""
    rng = np.random.default_rng(4)
    X = np.column_stack([np.ones(60), rng.normal(3.0, 1.0, 60)])
    y = X @ [1.0, 2.0] + rng.normal(size=60)
    parts = [slice(0, 10), slice(10, 25), slice(25, 60)]
    information = [X[s].T @ X[s] for s in parts]
    values = np.array([np.linalg.solve(part, X[s].T @ y[s]) for part, s in zip(information, parts, strict=True)])
    mean, covariance = mean_of_logs(values, np.linalg.inv(np.array(information)), np.zeros(2))
    assert mean == pytest.approx(np.linalg.lstsq(X, y, rcond=None)[0])
    assert covariance == pytest.approx(np.linalg.inv(X.T @ X))
    # With the slope given, the intercept is that of a regression with this slope.
    given = conditional_mean(mean, covariance, np.array([False, True]), np.array([0.0, 2.5]))
    assert given == pytest.approx([np.mean(y - 2.5 * X[:, 1]), 2.5])


@pytest.mark.parametrize(("n", "known"), [(2, 1.0), (3, 0.3), (3, 3.0)])
def test_a_known_error_of_one_campaign_adds_with_its_size(n: int, known: float) -> None:
    """An error that the logs after share, as of a given thrust, has no part in Student's t of the scatter."""
    rng, hits, widths = np.random.default_rng(n), 0, []
    after = np.repeat([False, True], n)
    for _ in range(400):
        values = rng.normal(size=2 * n) + known * rng.normal() * after
        found = campaign_difference(values, np.ones(2 * n), known * after[:, None].astype(float), after).difference
        hits += found.low <= 0.0 <= found.high
        widths.append((found.high - found.low) / 2.0 / found.error)
        own = found.error**2 - known**2
        assert found.df == pytest.approx((2 * n - 2) * (1.0 + known**2 / own) ** 2)
    assert hits >= 0.92 * 400
    if known > 1.0:  # the interval is that of a normal distribution
        assert np.median(widths) == pytest.approx(1.96, abs=0.03)
