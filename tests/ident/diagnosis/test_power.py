"""Tests of the smallest sizes that score tests find: the power at these sizes, by simulation of a linear model."""

from __future__ import annotations

from math import log

import numpy as np
import pytest

from seatrial.ident.diagnosis.power import POWER, detectable_sizes
from seatrial.ident.diagnosis.score_test import (
    NormalEquations,
    PriorTerms,
    Score,
    SensitivityColumns,
    assign_columns,
    score_tests,
    score_threshold,
)
from seatrial.ident.model.structure import EffectKind
from seatrial.ident.numerics import Array, noncentrality

N = 600  # rows


def scores_of(e: Array, G: Array, n_fitted: int) -> list[Score]:
    """Return the score tests of two candidates, of one column and of two, after ``n_fitted`` fitted columns."""
    columns = [
        SensitivityColumns("one", np.zeros((0, 1, 1)), ("a",)),
        SensitivityColumns("two", np.zeros((0, 1, 2)), ("b", "c")),
        SensitivityColumns("N(u)", np.zeros((0, 1, 1)), kind=EffectKind.NONPARAMETRIC),
    ]
    places, total = assign_columns(columns, n_fitted, 1)
    normal = NormalEquations([str(k) for k in range(total)])
    normal.add(np.arange(total).tolist(), G, e, np.arange(N) // 20)
    none = np.zeros(n_fitted)
    return score_tests(normal, PriorTerms(none, none), places)


def test_noncentrality_gives_the_power() -> None:
    rng, lam = np.random.default_rng(1), noncentrality(12.0, 3, 0.8)
    found = (rng.standard_normal((40_000, 3)) + np.array([lam**0.5, 0.0, 0.0])) ** 2
    assert np.mean(found.sum(axis=1) > 12.0) == pytest.approx(0.8, abs=0.01)


@pytest.mark.parametrize(("effect", "parameter", "column"), [("one", "a", 3), ("two", "b", 4), ("two", "c", 5)])
def test_an_effect_of_the_stated_size_is_found_in_four_of_five_trials(effect: str, parameter: str, column: int) -> None:
    """The columns are correlated with the fitted ones and with each other; the fitted parameters are estimated anew."""
    rng = np.random.default_rng(2)
    G = rng.standard_normal((N, 7)) @ rng.uniform(-1.0, 1.0, (7, 7))
    fitted, found, trials = G[:, :3], 0, 600
    sizes = {d.effect: d.sizes for d in detectable_sizes(scores_of(rng.standard_normal(N), G, 3), N)}
    assert set(sizes) == {"one", "two"}
    for _ in range(trials):
        y = sizes[effect][parameter] * G[:, column] + rng.standard_normal(N)
        residual = y - fitted @ np.linalg.lstsq(fitted, y, rcond=None)[0]
        scores = scores_of(residual, -G, 3)
        score = next(s for s in scores if s.name == effect)
        found += score.lm > max(score_threshold(score, scores), score.df * log(N))
    assert found / trials == pytest.approx(POWER, abs=0.05)


def test_an_effect_that_the_fitted_parameters_explain_has_no_size() -> None:
    rng = np.random.default_rng(3)
    G = rng.standard_normal((N, 4))
    G[:, 0] = G[:, 1] + 1e-6 * rng.standard_normal(N)
    one, two = detectable_sizes(scores_of(rng.standard_normal(N), np.column_stack([G, G[:, 3]]), 1), N)
    assert one.sizes == {}
    assert set(two.sizes) == {"b", "c"}


def test_a_size_that_no_boat_has_is_left_out() -> None:
    """A lever arm, for example, has no effect at zero force: its column has rounding errors only."""
    rng = np.random.default_rng(4)
    G = rng.standard_normal((N, 5))
    G[:, 2] *= 1e-9
    scores = scores_of(rng.standard_normal(N), G, 1)
    _, two = detectable_sizes(scores, N)
    assert two.sizes["c"] < 1.0 < 1e6 < two.sizes["b"]
    one, two = detectable_sizes(scores, N, prior_sds={"b": 0.3, "c": 0.3})
    assert set(one.sizes) == {"a"}
    assert set(two.sizes) == {"c"}
    (two,) = detectable_sizes(scores, N, prior_sds={"a": 1e-6, "b": 0.3})
    assert two.effect == "two"


def test_an_effect_without_information_is_left_out() -> None:
    """The test of waves is one of a spectral peak, so that its score has no information of a size."""
    assert detectable_sizes([Score("waves", 20.0, 2, 10.0, {}, {})], N) == ()
