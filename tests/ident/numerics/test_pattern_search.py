"""Tests of the pattern search and of the design criteria on known optima."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.experiment_design.criteria import SINGULAR, Criterion
from seatrial.ident.numerics.pattern_search import PatternSearch, violates_constraint


def bowl(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the value of a narrow valley in four dimensions with its optimum at (0.3, 0.3, 0.3, 0.3)."""
    d = z - 0.3
    return -(d**2).sum(axis=1) - 20.0 * (np.diff(d, axis=1) ** 2).sum(axis=1), np.zeros(len(z))


def test_search_finds_the_optimum_of_a_valley() -> None:
    start = np.array([[0.9, 0.1, 0.8, 0.0], [0.0, 1.0, 0.0, 1.0]])
    found = PatternSearch(bowl, np.zeros(4), np.ones(4), seed=1).run(start, 20_000)
    np.testing.assert_allclose(found.z, 0.3, atol=5e-3)
    merits = [m for _, m in found.history]
    assert merits == sorted(merits)
    assert len(found.merits) == 2


def test_search_respects_constraints_and_bounds() -> None:
    def limited(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return z.sum(axis=1), np.maximum(np.hypot(z[:, 0], z[:, 1]) - 1.0, 0.0)

    found = PatternSearch(limited, -2.0 * np.ones(2), 2.0 * np.ones(2), seed=3).run(np.array([[2.0, -1.5]]), 8000)
    assert found.violation == 0.0
    assert found.value == pytest.approx(np.sqrt(2.0), abs=5e-3)


def test_skipping_candidates_that_cannot_be_better_does_not_change_the_search() -> None:
    def limited(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return z.sum(axis=1), np.maximum(np.hypot(z[:, 0], z[:, 1]) - 1.0, 0.0)

    def above(z: np.ndarray, least: float) -> tuple[np.ndarray, np.ndarray]:
        value, violation = limited(z)
        if violates_constraint(least):
            return np.where(violation > 0.0, np.nan, value), violation
        return value, np.where(value > least, violation, 0.0)

    start, bounds = np.array([[2.0, -1.5]]), (-2.0 * np.ones(2), 2.0 * np.ones(2))
    complete = PatternSearch(limited, *bounds, seed=3).run(start, 4000)
    skipping = PatternSearch(limited, *bounds, seed=3, above=above).run(start, 4000)
    np.testing.assert_array_equal(complete.z, skipping.z)
    assert complete.history == skipping.history
    assert violates_constraint(complete.history[0][1])
    assert not violates_constraint(complete.history[-1][1])


def test_search_is_reproducible() -> None:
    start = np.array([[0.9, 0.1, 0.8, 0.0]])
    first, second = (PatternSearch(bowl, np.zeros(4), np.ones(4), seed=4).run(start, 1000) for _ in range(2))
    np.testing.assert_array_equal(first.z, second.z)


def test_criteria_equal_their_definitions() -> None:
    rng = np.random.default_rng(1)
    A = rng.normal(size=(5, 4, 4))
    F = A @ A.swapaxes(1, 2) + 0.1 * np.eye(4)
    scale = np.array([1.0, 10.0, 0.1, 1e-3])
    C = np.linalg.inv(F * np.outer(scale, scale))
    every = (0, 1, 2, 3)
    np.testing.assert_allclose(Criterion("D", every, scale)(F), -np.linalg.slogdet(C)[1], rtol=1e-8)
    np.testing.assert_allclose(Criterion("A", every, scale)(F), -np.log(np.trace(C, axis1=1, axis2=2) / 4), rtol=1e-8)
    np.testing.assert_allclose(Criterion("E", every, scale)(F), -np.log(np.linalg.eigvalsh(C)[:, -1]), rtol=1e-8)
    some = C[:, [1, 3]][:, :, [1, 3]]
    np.testing.assert_allclose(Criterion("Ds", (1, 3), scale)(F), -np.linalg.slogdet(some)[1], rtol=1e-8)


def test_singular_information_is_the_worst() -> None:
    measure = Criterion("D", (0, 1), np.ones(2))
    bad = np.array([[[1.0, 1.0], [1.0, 1.0]], [[np.nan, 0.0], [0.0, 1.0]], [[0.0, 0.0], [0.0, 1.0]], np.eye(2)])
    np.testing.assert_array_equal(measure(bad), [SINGULAR, SINGULAR, SINGULAR, 0.0])
