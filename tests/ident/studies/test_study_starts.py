"""Test that every start within a factor of two reaches the same optimum, on simulated missions of the study models."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.estimation.maximum_likelihood import SearchSettings, fit
from seatrial.ident.estimation.stochastic_simulation import simulate_stochastic
from seatrial.ident.studies.cases import make_case
from seatrial.ident.studies.monte_carlo import make_record

CLOSE = 1e-3  # Difference of the log-likelihood.
CASES = (("surge", 300), ("thruster", 50), ("yaw", 300), ("horizontal", 200))
LONG = [pytest.param(*case, 50, marks=pytest.mark.study) for case in CASES]


@pytest.mark.parametrize(("name", "seconds", "n_starts"), [("surge", 300, 15), *LONG])
def test_any_start_within_a_factor_of_two_reaches_the_same_optimum(name: str, seconds: float, n_starts: int) -> None:
    case = make_case(name, seconds=seconds)
    model = case.model
    truth = np.array([list(model.values.values())])
    record = make_record(case, simulate_stochastic(model, case.inputs, truth, [np.random.default_rng(5)])[1][0], name)
    shared = [p for p in model.parameters if p.free and not p.per_record]
    reached = []
    for seed in range(n_starts):
        rng = np.random.default_rng(seed)
        factors = np.exp(rng.uniform(-np.log(2.0), np.log(2.0), len(shared)))
        start = {p.name: float(np.clip(p.value * k, *p.bounds)) for p, k in zip(shared, factors, strict=True)}
        found = fit(model, [record], settings=SearchSettings(robust_errors=False, threads=1), start=start)
        assert found.converged, seed
        reached.append(found.log_likelihood)
    assert np.ptp(reached) < CLOSE, np.argsort(reached)[:5]
