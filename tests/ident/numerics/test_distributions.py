"""Tests of the distributions: they equal those of scipy.stats."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy import stats

from seatrial.ident.numerics.distributions import (
    chi2_isf,
    chi2_ppf,
    chi2_sf,
    fisher_sf,
    is_undetermined,
    kolmogorov_sf,
    normal_cdf,
    normal_ppf,
    normality_p,
    signed_rank_z,
    student_ppf,
)

X = np.array([1e-3, 0.4, 2.0, 11.0, 90.0, 700.0])
P = np.array([1e-12, 0.01, 0.025, 0.5, 0.975])


def test_probabilities_and_quantiles_equal_scipy() -> None:
    for df in (0.7, 1, 2, 9.5, 300):
        np.testing.assert_allclose(chi2_sf(X, df), stats.chi2.sf(X, df), rtol=1e-12)
        np.testing.assert_allclose(chi2_isf(P, df), stats.chi2.isf(P, df), rtol=1e-10)
        np.testing.assert_allclose(chi2_ppf(P[1:], df), stats.chi2.ppf(P[1:], df), rtol=1e-10)
        np.testing.assert_allclose(student_ppf(P[1:], df), stats.t.ppf(P[1:], df), rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(fisher_sf(X, df, 7), stats.f.sf(X, df, 7), rtol=1e-10)
    z = np.array([-9.0, -1.0, 0.0, 2.5])
    np.testing.assert_allclose(normal_cdf(z), stats.norm.cdf(z), rtol=1e-12)
    np.testing.assert_allclose(normal_ppf(P), stats.norm.ppf(P), rtol=1e-12)
    assert kolmogorov_sf(1.2) == pytest.approx(stats.kstwobign.sf(1.2), rel=1e-12)
    assert chi2_sf(-1.0, 3) == 1.0


@pytest.mark.parametrize("n", [20, 61, 3000])
@pytest.mark.parametrize("kind", ["normal", "skewed", "flat", "peaked"])
def test_normality_test_equals_that_of_scipy(kind: str, n: int) -> None:
    rng = np.random.default_rng(n)
    draw = {"normal": rng.normal, "skewed": rng.exponential, "flat": rng.uniform, "peaked": rng.laplace}[kind]
    x = draw(size=n)
    assert normality_p(x) == pytest.approx(stats.normaltest(x).pvalue, rel=1e-9)


@pytest.mark.parametrize("shift", [-0.5, 0.0, 0.7])
def test_signed_rank_statistic_equals_that_of_scipy(shift: float) -> None:
    x = shift + np.random.default_rng(3).laplace(size=60)
    expected = stats.wilcoxon(x, alternative="greater", method="asymptotic", correction=False).pvalue
    assert normal_cdf(-signed_rank_z(x)) == pytest.approx(expected, rel=1e-9)


def test_a_fit_does_not_import_scipy_stats() -> None:
    code = "import sys; from seatrial.ident.workflows import fleet, vehicle; print('scipy.stats' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


@pytest.mark.parametrize(
    ("value", "error", "lost"), [(58.9, 31.6, True), (-58.9, 31.6, True), (58.9, 29.0, False), (2.0, np.nan, False)]
)
def test_a_value_with_an_error_of_more_than_its_half_is_undetermined(value: float, error: float, lost: bool) -> None:
    assert is_undetermined(value, error) == lost
