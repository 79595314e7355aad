"""Tests of standard errors beside a parameter at its bound. They are neither conditional on the bound nor unaware of
it.
"""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.estimation.fisher_scoring import Bounds, Evaluation
from seatrial.ident.estimation.standard_errors import Uncertainty, assess

BOUNDS = Bounds(np.array([-np.inf, 0.0]), np.full(2, np.inf), np.zeros(2, dtype=bool))


def assessed(correlation: float, free: tuple[float, float]) -> tuple[np.ndarray, Uncertainty]:
    """Return the estimate and its assessed uncertainty.

    Two parameters of unit variance have their maximum of likelihood at ``free``. The second is bounded below by zero.
    """
    information = np.linalg.inv([[1.0, correlation], [correlation, 1.0]])
    z = np.array(free) if free[1] > 0 else np.array([free[0] - correlation * free[1], 0.0])
    at = Evaluation(0.0, information @ (np.array(free) - z), information, np.zeros(2))
    return z, assess(at, z, BOUNDS, ("a", "b"), np.ones(2), np.zeros(2))


def test_bound_that_is_just_reached_gives_the_error_without_the_bound() -> None:
    _, found = assessed(0.95, (3.0, 0.0))
    assert found.errors[0] == pytest.approx(1.0)
    assert np.isnan(found.errors[1])
    assert found.limits[1] == pytest.approx(1.96, abs=1e-3)
    assert found.flags == (
        ("b", "at its bound"),
        ("a", "its error is 3.2 times as large because b may leave its bound"),
    )


def test_value_at_a_bound_except_for_rounding_counts_as_at_the_bound() -> None:
    """In floating point, 3 + (0.1 - 3) is not 0.1."""
    bounds, z = Bounds(np.array([0.1, -np.inf]), np.array([np.inf, 0.7]), np.zeros(2, dtype=bool)), np.array([0.0, 0.7])
    z[0] = 3.0 + (0.1 - 3.0)
    assert z[0] > 0.1
    at = Evaluation(0.0, np.array([-1.0, 1.0]), np.eye(2), np.zeros(2))
    assert bounds.pushed_against(z, at.gradient).all()
    found = assess(at, z, bounds, ("a", "b"), np.ones(2), np.zeros(2))
    assert [flag for _, flag in found.flags] == ["at its bound", "at its bound"]
    assert np.isfinite(found.limits).all()


def test_error_widens_less_the_stronger_the_bound_is_active() -> None:
    errors, limits = zip(
        *[(f.errors[0], f.limits[1]) for f in (assessed(0.95, (3.0, b))[1] for b in (-0.5, -3, -30))], strict=True
    )
    assert 1.0 > errors[0] > errors[1] > errors[2]
    assert errors[2] == pytest.approx(np.sqrt(1 - 0.95**2), abs=0.01)
    # The drop of the profile is ((d - b)^2 - b^2) / 2 = 1.92.
    assert limits[0] == pytest.approx(-0.5 + np.sqrt(0.5**2 + 3.8415), abs=1e-3)
    assert assessed(0.95, (3.0, -30.0))[1].flags == (("b", "at its bound"),)


@pytest.mark.parametrize("free_b", [0.0, -0.5, -3.0])
def test_quadratic_objective_does_not_limit_the_widening(free_b: float) -> None:
    information = np.linalg.inv([[1.0, 0.95], [0.95, 1.0]])
    z, free = np.array([3.0 - 0.95 * free_b, 0.0]), np.array([3.0, free_b])
    at = Evaluation(0.0, information @ (free - z), information, np.zeros(2))

    def value(x: np.ndarray) -> float:
        return float(-0.5 * (x - free) @ information @ (x - free))

    plain, limited = (assess(at, z, BOUNDS, ("a", "b"), np.ones(2), np.zeros(2), value=v) for v in (None, value))
    assert limited.errors[0] == pytest.approx(plain.errors[0], rel=0.02)
    assert limited.limits[1] == plain.limits[1]


def test_objective_that_falls_far_from_the_bound_limits_the_widening() -> None:
    """The ridge of the objective is a = tanh(10 b) / 2, which leaves its tangent a = 5 b at 0.05."""
    sd, bounds = 0.01, Bounds(BOUNDS.low, np.array([np.inf, 4.0]), BOUNDS.logarithmic)
    information = np.array([[1.0, -5.0], [-5.0, 25.0]]) / sd**2
    at = Evaluation(0.0, np.zeros(2), information, np.zeros(2))

    def value(x: np.ndarray) -> float:
        return float(-0.5 * (x[0] - 0.5 * np.tanh(10.0 * x[1])) ** 2 / sd**2)

    plain, limited = (
        assess(at, np.zeros(2), bounds, ("a", "b"), np.ones(2), np.zeros(2), value=v) for v in (None, value)
    )
    assert plain.errors[0] > 5.0
    assert 0.1 < limited.errors[0] < 0.15
    assert limited.flags[1][1].startswith("its error is 1")


def test_uncorrelated_bound_or_interior_neighbour_does_not_change_the_error() -> None:
    assert assessed(0.3, (3.0, 0.0))[1].flags == (("b", "at its bound"),)
    _, found = assessed(0.95, (3.0, 0.5))
    assert found.errors == pytest.approx([1.0, 1.0])
    assert found.flags == ()
    assert np.isnan(found.limits).all()


@pytest.mark.parametrize("correlation", [-0.97, -0.6])
@pytest.mark.parametrize("true_b", [0.0, 0.5, 1.3, 3.0])
def test_intervals_cover_for_any_position_of_the_truth(correlation: float, true_b: float) -> None:
    """Conditional on the bound, the intervals of the other parameter would cover 82 % in the worst case."""
    rng, n, hits = np.random.default_rng(7), 600, np.zeros(2)
    root = np.linalg.cholesky([[1.0, correlation], [correlation, 1.0]])
    for _ in range(n):
        a, b = root @ rng.standard_normal(2) + [0.0, true_b]
        z, found = assessed(correlation, (float(a), float(b)))
        hits[0] += abs(z[0]) < 1.96 * found.errors[0]
        hits[1] += abs(z[1] - true_b) < 1.96 * found.errors[1] if z[1] > 0 else true_b <= found.limits[1]
    assert (hits / n > 0.925).all()
    assert (hits / n < 0.99).all()


@pytest.mark.parametrize("size", [np.ones(6), np.array([1.0, 2.0, 0.5, 3.0, 1.0, 0.01])])
@pytest.mark.parametrize(
    ("unseen", "flagged_with"),
    [
        (
            [[1, -1, 0, 0, 0, 0], [0, 0, 1, 2, 0, 0]],
            {"a": {"a", "b"}, "b": {"a", "b"}, "c": {"c", "d"}, "d": {"c", "d"}},
        ),
        ([[1, 1, 1, 0, 0, 0], [0, 0, 0, 0, 1, -1], [0, 0, 0, 0, 0, 1]], {n: {"a", "b", "c"} for n in "abc"}),
    ],
)
def test_each_unidentified_combination_is_named_separately(
    unseen: list[list[int]], flagged_with: dict[str, set[str]], size: np.ndarray
) -> None:
    """Eigenvectors of a null space with several dimensions are arbitrary mixtures. The flags must not depend on
    them.
    """
    rng = np.random.default_rng(5)
    # Only the unidentified directions give J z = 0.
    J = np.linalg.svd(np.array(unseen) * size)[2][len(unseen) :] * size
    J = rng.standard_normal((9, len(J))) @ J
    information = J.T @ J
    free = Bounds(np.full(6, -np.inf), np.full(6, np.inf), np.zeros(6, dtype=bool))
    information[np.abs(information) < 1e-12 * np.abs(information).max()] = 0.0
    found = assess(
        Evaluation(0.0, np.zeros(6), information, np.zeros(6)),
        np.zeros(6),
        free,
        tuple("abcdef"),
        np.ones(6),
        np.zeros(6),
    )
    combinations = {
        name: set(text.rpartition(" the joint change ")[2].split()[1::2])
        for name, text in found.flags
        if text.startswith("not identified")
    }
    assert combinations == flagged_with
    lost = {name for name, _ in found.flags}
    assert np.isnan(found.errors).tolist() == [name in lost for name in "abcdef"]
    if "d" in flagged_with:
        assert dict(found.flags)["d"].endswith("the joint change +0.5 c +1 d")


def test_prior_weight_is_relative_to_the_information_of_the_data() -> None:
    """A considered parameter makes the errors larger, but no prior stronger."""
    at = Evaluation(0.0, np.zeros(2), np.diag([100.0, 1.0]), np.zeros(2))
    prior, considered = np.array([10.0, 0.0]), np.array([[30.0], [0.0]])
    found = assess(at, np.ones(2), BOUNDS, ("a", "b"), np.ones(2), prior, considered)
    assert found.prior_weight == pytest.approx([0.1, 0.0])
    assert found.errors == pytest.approx([np.hypot(0.1, 0.3), 1.0])
    assert found.considered == pytest.approx(np.diag([0.09, 0.0]))
    assert not found.flags
