"""Lag of the measured heading: its first two orders against the exact response of a filter and a delay."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.effects import catalogue
from seatrial.ident.models import horizontal_model

LAG, RATE = 0.12, 0.2  # s, rad/s


@pytest.mark.parametrize("delay", [0.0, 0.03, 0.06, 0.12])
def test_error_at_a_yaw_acceleration_is_that_of_a_filter_and_a_delay(delay: float) -> None:
    """In a turn with r = RATE + a t, a filter with time constant F and a delay D, F + D = LAG, give this error."""
    model = horizontal_model("shaft") + catalogue()["heading-lag"]
    x = {s.name: 0.0 for s in model.states} | {"u": 0.5, "r": RATE}
    u = [{"n_left": 1.0, "n_right": -1.0}.get(i.name, 0.0) for i in model.inputs]
    values = model.values | {"T_psi": LAG}
    s = model.signals(list(x.values()), u, list(values.values()))
    acceleration = float(s.rate["r"])
    assert abs(acceleration) > 0.2
    filtered = LAG - delay
    exact = -LAG * RATE + (filtered**2 + filtered * delay + delay**2 / 2.0) * acceleration
    first_order = -LAG * RATE
    found = float(s.y["psi"])
    assert abs(found - exact) <= 0.2501 * LAG**2 * abs(acceleration)
    assert abs(found - exact) < 0.51 * abs(first_order - exact)
    assert found == pytest.approx(np.mean([-LAG * RATE + k * LAG**2 * acceleration for k in (0.5, 1.0)]))
