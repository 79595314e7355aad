"""Tests of the scaling of symmetric matrices whose entries have different units."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.numerics.linear_algebra import (
    covariance_root,
    scaled_eigen,
    scaled_inverse,
    scaled_pseudo_inverse,
    unit_diagonal,
)

SCALE = np.array([1e-6, 1.0, 1e5])


@pytest.fixture
def correlation() -> np.ndarray:
    return np.array([[1.0, 0.5, 0.2], [0.5, 1.0, -0.4], [0.2, -0.4, 1.0]])


def test_scaled_matrix_is_independent_of_units(correlation: np.ndarray) -> None:
    A = correlation * np.outer(SCALE, SCALE)
    scaled, scale = unit_diagonal(A)
    np.testing.assert_allclose(scaled, correlation)
    np.testing.assert_allclose(scale, SCALE)
    w, V, scale = scaled_eigen(A)
    np.testing.assert_allclose((V * w) @ V.T * np.outer(scale, scale), A)


def test_scaled_inverses_equal_the_inverse(correlation: np.ndarray) -> None:
    A = correlation * np.outer(SCALE, SCALE)
    wanted = np.linalg.inv(correlation) / np.outer(SCALE, SCALE)
    np.testing.assert_allclose(scaled_inverse(A), wanted)
    np.testing.assert_allclose(scaled_pseudo_inverse(A), wanted)


def test_covariance_root_omits_directions_without_variance() -> None:
    P = np.outer(SCALE, SCALE)  # The matrix has rank one.
    L = covariance_root(P, 1e-12)
    assert L.shape == (3, 1)
    np.testing.assert_allclose(L @ L.T, P)
