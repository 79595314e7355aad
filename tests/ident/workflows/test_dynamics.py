"""Test of a vehicle's dynamics in its result: they agree with each other and with the simulated boat's data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seatrial.ident.data.record import LogSegment
from seatrial.ident.estimation.fitted_model import FittedModel, fit_nominal_model
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.workflows.dynamics import dynamics_of
from tests.missions import boat_with, channels_of, sail


@pytest.fixture(scope="module")
def fitted() -> FittedModel:
    run = LogSegment("a", channels_of(sail(boat_with(None, 2), 120.0, 1, run=1)[0]))
    return fit_nominal_model(horizontal_model(), [run], [])


def test_curves_poles_and_steps_agree(fitted: FittedModel) -> None:
    found = dynamics_of(fitted)
    assert found is not None
    straight, *turns = found.steady
    assert (straight.motion, straight.quantity) == ("straight", "u")
    assert np.all(np.diff(straight.value) > 0.0)
    assert np.all((straight.sd > 0.0) | (straight.command == 0.0))
    assert -1.0 <= straight.command[0] < straight.command[-1] <= 1.0
    assert [t.mean for t in turns] == pytest.approx([0.0, 0.5 * straight.command[-1]])
    spin = turns[0]  # a larger left thrust turns to starboard
    assert np.nanmax(spin.value) > 0.1
    assert spin.value[-1] == pytest.approx(-spin.value[0], rel=1e-3)
    assert len(found.points) >= 3
    for point in found.points:
        at = np.interp(np.mean(list(point.inputs.values())), straight.command, straight.value)
        assert at == pytest.approx(point.speed, rel=0.02)
        assert point.stable == bool((point.real < 0.0).all())
    rise = next(s for s in found.steps if s.quantity == "u")
    slope = np.interp(rise.speed, straight.value[1:], np.diff(straight.value) / np.diff(straight.command))
    settled = rise.value[-1] / rise.step
    assert settled <= 1.05 * slope
    assert {s.quantity for s in found.steps} == {"u", "r", "v"}
    speed, turn = found.responses
    assert (speed.quantity, turn.quantity) == ("u", "r")
    # Slow commands have the gain of the steady curve; its band is that of the parameters.
    assert speed.gain[0] == pytest.approx(slope, rel=0.1)
    assert np.all((speed.gain_sd > 0.0) & (speed.gain_sd < 0.2))
    assert np.all(speed.phase_sd > 0.0)
    assert speed.bandwidth is not None
    decibel = 20 * np.log10(speed.gain / speed.gain[0])
    assert np.interp(speed.bandwidth, speed.frequency, decibel) == pytest.approx(-3.01, abs=0.05)
    # The boat is nearly unstable on course, so that the gain of slow turns, and with it the bandwidth, is unknown.
    assert turn.gain_sd[0] > 0.35
    assert turn.bandwidth is None


def test_fit_that_did_not_converge_has_none(fitted: FittedModel) -> None:
    failed = replace(fitted, fit=replace(fitted.fit, message="stopped", converged=False))
    assert dynamics_of(failed) is None
