"""A sample of the fault trials, of what no other test lets fail; all of them: python -m tests.bench.fault_trials."""

from __future__ import annotations

import pytest

from tests.bench.fault_trials import KINDS, row, trials

SAMPLE = ("AHRS lost", "capsized")


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLE)
def test_thrust_is_zero_in_time_and_the_log_says_why(name: str) -> None:
    (kind,) = [kind for kind in KINDS if kind.name == name]
    (found,) = trials(kind, 1, seed=7)
    assert not found.wrong, row(kind, [found])
    assert found.said
