"""Tests of the sign of a shaft speed that is measured without a sign, on simulated thrusters that reverse often."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from seatrial.ident.data.loading import GRID_STEP, follows_command, shaft_speed

DT = 1e-3  # Unit: s
Array = NDArray[np.float64]


def shaft(command: Array, delay: float, pole: float, dead: float = 0.086) -> Array:
    """Return a shaft speed that follows its command with a delay and a lag, and stays at rest in its dead zone."""
    late = round(delay / DT)
    delayed = np.concatenate([np.zeros(late), command])[: command.size]
    delayed = np.where(np.abs(delayed) < dead, 0.0, delayed)
    n = np.zeros_like(command)
    for k in range(1, n.size):
        n[k] = n[k - 1] + DT * pole * (delayed[k - 1] - n[k - 1])
    return n


@pytest.mark.parametrize(("delay", "pole"), [(0.345, 7.2), (0.07, 25.0), (0.5, 3.0)])
def test_sign_is_that_of_the_shaft_and_not_of_the_command(delay: float, pole: float) -> None:
    rng = np.random.default_rng(1)
    levels = rng.uniform(-1.0, 1.0, 60)
    held = rng.uniform(1.0, 4.0, levels.size)
    command = np.repeat(levels, np.round(held / DT).astype(int))
    n, t = shaft(command, delay, pole), DT * np.arange(command.size)
    truth, commanded = n[::100], command[::100]  # The telemetry has 10 Hz.
    speed = np.abs(truth + rng.normal(0.0, 0.003, truth.size))
    at = np.searchsorted(t, np.concatenate([[0.0], np.cumsum(held)[:-1]]))
    own, found = shaft_speed(t[::100], speed, t[np.minimum(at, t.size - 1)], levels)
    own = own + GRID_STEP / 2  # This is the middle of the time for which the value is held.
    error = np.sqrt(np.mean((np.interp(t[::100], own, found) - truth) ** 2))
    own = own[own < t[-1]]
    rounded = np.interp(own, t[::100], np.copysign(speed, truth))  # Linear interpolation between samples.
    between, smooth = (np.mean(np.abs(x[: own.size] - np.interp(own, t, n))) for x in (found, rounded))
    by_command = np.sqrt(np.mean((np.copysign(speed, commanded) - truth) ** 2))
    assert by_command > 0.1  # As a share of full speed.
    assert error < 0.02 + 0.06 * by_command
    assert between < 0.8 * smooth
    assert follows_command(np.copysign(speed, commanded), commanded)
    assert not follows_command(truth, commanded)


def test_shaft_speed_without_reversals_does_not_follow_the_command() -> None:
    assert not follows_command(np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.2, 0.3]))
    assert not follows_command(np.zeros(3), np.array([0.1, -0.2, 0.3]))
