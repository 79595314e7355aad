"""Tests of the steady wind: its force without a relation to the velocity of the wind."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.effects.registry import catalogue
from seatrial.ident.models.horizontal import horizontal_model

SENSORS = ("attitude", "gyro", "body_velocity")


def rates(k_air: float, u: float) -> np.ndarray:
    """Return the rates of u, v, r in m/s2 and rad/s2 of a boat without thrust that moves with speed u [m/s]."""
    plain = horizontal_model("shaft", SENSORS, current=False)
    model = (plain + catalogue()["wind"]).with_values({"F_wx": 3.0, "F_wy": -2.0})
    x = [u if s.name == "u" else 0.0 for s in model.states]
    windy = model.signals(x, [0.0] * len(model.inputs), list((model.values | {"k_air": k_air}).values()))
    still = plain.signals(x[: len(plain.states)], [0.0] * len(plain.inputs), list(plain.values.values()))
    return np.array([windy.rate[name] - still.rate[name] for name in "uvr"])


@pytest.mark.parametrize("u", [0.0, 1.5])
def test_force_without_an_air_drag_is_that_at_rest(u: float) -> None:
    """Zero is the lower end of the interval of ``k_air``: the wind is so fast that the speed of the boat is nothing."""
    found = rates(0.0, u)
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found, rates(0.2, 0.0), rtol=1e-3)
    np.testing.assert_allclose(found, rates(1e-9, u), rtol=1e-3)
