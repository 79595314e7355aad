"""Standard errors beside a neighbour at its bound: conditional, and said so."""

from __future__ import annotations

import numpy as np
import pytest

from ident.scoring import Bounds, Evaluation
from ident.uncertainty import assess


def assessed(correlation: float, z: float) -> tuple[np.ndarray, tuple[tuple[str, str], ...]]:
    """Two parameters of unit variance, the second bounded by zero and estimated at z."""
    information = np.linalg.inv([[1.0, correlation], [correlation, 1.0]])
    at = Evaluation(0.0, np.zeros(2), information, np.zeros(2))
    bounds = Bounds(np.array([-np.inf, 0.0]), np.full(2, np.inf), np.zeros(2, dtype=bool))
    found = assess(at, np.array([3.0, z]), bounds, ("a", "b"), np.ones(2), np.zeros(2))
    return found.errors, found.flags


def test_an_error_that_rests_on_a_neighbours_bound_is_flagged() -> None:
    errors, flags = assessed(0.95, 0.0)
    assert errors[0] == pytest.approx(np.sqrt(1 - 0.95**2))
    assert np.isnan(errors[1])
    assert flags == (
        ("b", "at its bound"),
        ("a", "its error takes b at its bound for granted; without that it would be 1"),
    )


def test_a_neighbour_that_does_not_matter_or_is_inside_is_no_reason() -> None:
    assert assessed(0.3, 0.0)[1] == (("b", "at its bound"),)
    errors, flags = assessed(0.95, 0.5)
    assert errors == pytest.approx([1.0, 1.0])
    assert flags == ()
