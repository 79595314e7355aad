"""Tests of coarse positions and velocities: they are quantised and not stuck, and a frozen receiver stays a fault."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seatrial.ident.checks.log_checks import check_signals
from seatrial.ident.checks.signals import check_frozen
from seatrial.ident.data import Channel
from tests.ident.checks.test_latency import ATTITUDE, SHAFTS, SIDES, sailed

MINUTE, KNOT = 1.855, 0.514444  # Length [m] of 0.001 minutes of latitude; one knot in m/s.


def log(minutes: float = 0.0, knots: float = 0.0) -> dict[str, Channel]:
    """Return a run with positions in steps of ``minutes`` times 0.001 minutes and a speed over ground in steps of
    ``knots``.
    """
    c = {name: sailed(3)[name] for name in (*ATTITUDE, *SHAFTS, "x", "y", "vx", "vy")}
    if minutes:
        for name in ("x", "y"):
            c[name] = replace(c[name], value=minutes * MINUTE * np.round(c[name].value / (minutes * MINUTE)))
    if knots:
        vx, vy = c["vx"].value, c["vy"].value
        speed = knots * KNOT * np.round(np.hypot(vx, vy) / (knots * KNOT))
        course = np.radians(np.round(np.degrees(np.arctan2(vy, vx))))
        c["vx"] = replace(c["vx"], value=speed * np.cos(course))
        c["vy"] = replace(c["vy"], value=speed * np.sin(course))
    return c


@pytest.mark.parametrize(("minutes", "knots"), [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
def test_coarse_receiver_is_quantised_and_not_stuck(minutes: float, knots: float) -> None:
    found = [f for f in check_signals(log(minutes, knots), SIDES) if f.is_problem]
    quantised = [f.where for f in found if f.code == "channel-quantised"]
    assert quantised == ["x, y"] * bool(minutes) + ["vx, vy"] * bool(knots)
    assert not [f for f in found if f.check == "stuck"]


def test_fine_receiver_is_not_quantised() -> None:
    assert not [f for f in check_signals(log(0.05), SIDES) if f.code == "channel-quantised"]


def test_coarse_receiver_that_freezes_is_a_fault() -> None:
    c = log()
    for name in ("x", "y"):
        value = MINUTE * np.round(8.0 * c[name].value / MINUTE)
        value[581:781] = value[581]  # The boat moves by 28 m north and by 28 m east meanwhile.
        c[name] = replace(c[name], value=value)
    assert [f.where for f in check_frozen(c) if f.code == "channel-frozen"] == ["x", "y"]
