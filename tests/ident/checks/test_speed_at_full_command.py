"""Tests of the shaft speed at full command, with and without a dead zone."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.checks import speed_at_full_command
from seatrial.ident.data.record import Channel


@pytest.mark.parametrize(("dead_zone", "gain"), [(0.0, 1.0), (0.06, 1.0), (0.0, 0.9), (0.06, 0.9)])
def test_dead_zone_is_no_wrong_scale(dead_zone: float, gain: float) -> None:
    """A shaft with a dead zone of 6 % turns at 0.9 times a command of 0.4, and at full speed at full command."""
    rng, t = np.random.default_rng(1), np.arange(0.0, 120.0, 0.1)
    command = np.repeat(rng.uniform(0.2, 1.0, 20), 60)
    speed = gain * np.clip(command - dead_zone, 0.0, None) / (1.0 - dead_zone) + 0.002 * rng.standard_normal(t.size)
    channels = {f"n_cmd_{side}": Channel(t, command) for side in ("left", "right")}
    channels |= {f"n_{side}": Channel(t.copy(), speed) for side in ("left", "right")}
    assert speed_at_full_command(channels) == pytest.approx(gain, abs=0.01)
