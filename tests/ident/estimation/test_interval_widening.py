"""Tests of the factors by which validation data widen the prediction intervals for further runs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from seatrial.ident.estimation.interval_widening import (
    BOAT_SCATTER,
    RUN_SCATTER,
    ErrorScale,
    IntervalCalibration,
)

Z95 = stats.norm.ppf(0.975)


@pytest.mark.parametrize(("scale", "n", "records"), [(1.4, 40.0, 1), (1.1, 8.0, 3), (2.0, 1000.0, 2)])
def test_factor_over_a_horizon_in_closed_form(scale: float, n: float, records: int) -> None:
    freedom = 1.0 / (1.0 / n + 2.0 * RUN_SCATTER**2 * (1.0 + 1.0 / records))
    expected = scale * stats.t.ppf(0.975, freedom) / Z95
    assert ErrorScale(scale, n, records).widening == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("scale", "n"), [(1.0, 2.0), (1.5, 2.0), (3.0, 1.0), (1.5, 50.0)])
def test_factor_of_a_simulation_in_closed_form(scale: float, n: float) -> None:
    prior = 1.0 / (2.0 * BOAT_SCATTER**2)  # errors of a calibrated model
    expected = scale ** (n / (n + prior)) * stats.t.ppf(0.975, n + prior) / Z95
    assert ErrorScale(scale, n, 1).simulation_widening == pytest.approx(expected, rel=1e-9)


def test_few_errors_of_a_simulation_do_not_give_useless_intervals() -> None:
    one = ErrorScale(1.0, 1.0, 1)
    assert one.widening > 5.0
    assert 1.1 < one.simulation_widening < 2.5
    many = ErrorScale(2.0, 1e6, 1)
    assert many.simulation_widening == pytest.approx(2.0, rel=1e-3)
    assert ErrorScale(0.3, 30.0, 1).simulation_widening == 1.0
    assert math.isinf(ErrorScale(math.inf, 2.0, 1).simulation_widening)
    assert math.isinf(ErrorScale(math.inf, 2.0, 1).widening)


def test_simulations_of_boats_with_the_scatter_of_the_prior_are_inside_their_intervals() -> None:
    rng, inside, plain = np.random.default_rng(3), [], []
    for own in np.exp(BOAT_SCATTER * rng.standard_normal(20000)):
        known, further = own * rng.standard_normal((2, 4))
        factor = ErrorScale(float(np.sqrt(np.mean(known**2))), 4.0, 1).simulation_widening
        inside.append(np.mean(np.abs(further) < Z95 * factor))
        plain.append(np.mean(np.abs(further) < Z95))
    assert np.mean(plain) < 0.9
    assert 0.94 < np.mean(inside) < 0.97


def test_factors_hold_for_the_horizon_of_the_validation_and_for_any_simulation() -> None:
    known = IntervalCalibration(10.0, {"r": ErrorScale(1.4, 40.0, 1)}, {"r": ErrorScale(1.5, 2.0, 1)})
    factor = known.ahead["r"].widening
    assert known.widening(10.0) == known.widening(10.05) == known.widening(9.95) == {"r": factor}
    assert known.widening(10.2) == known.widening(5.0) == {}
    assert known.widening(None) == {"r": known.simulation["r"].simulation_widening}
