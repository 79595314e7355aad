"""Tests of the value of a parameter and its bounds."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.model.parameter import Parameter, ParameterOrigin

MEMORY = Parameter("tau_b", 1.5, "s", transform="log", bounds=(0.2, 60.0))


@pytest.mark.parametrize("n", range(1, 65))
def test_mean_of_values_at_a_bound_is_at_the_bound(n: int) -> None:
    """The floating-point mean of six times 0.2 is 0.19999999999999998."""
    low, high = MEMORY.bounds
    for bound in (low, high):
        value = MEMORY.at(np.full(n, bound).mean()).value
        assert low <= value <= high
        assert value == pytest.approx(bound, rel=1e-12)


@pytest.mark.parametrize("value", [0.2 - 1e-6, 60.1, -1e-12])
def test_value_outside_its_bounds_is_an_error(value: float) -> None:
    with pytest.raises(ValueError, match="tau_b"):
        MEMORY.at(value)


def test_bound_of_zero_allows_no_rounding() -> None:
    with pytest.raises(ValueError, match="outside its bounds"):
        Parameter("d_u", -1e-300, bounds=(0.0, np.inf))


@pytest.mark.parametrize("sd", [-0.1, np.nan, np.inf])
def test_an_impossible_standard_deviation_is_an_error(sd: float) -> None:
    with pytest.raises(ValueError, match=f"^tau_b: a standard deviation of {sd:g} is impossible"):
        MEMORY.known(1.0, sd, ParameterOrigin.GIVEN)
    assert MEMORY.known(1.0, 0.2, ParameterOrigin.GIVEN).prior == (1.0, 0.2)
