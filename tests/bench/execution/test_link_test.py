"""Tests of the evaluation of a link test: the time from the last frame to neutral outputs, and no result if no output
pushed.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from seatrial.bench.execution.link_test import MUTED, N_TEST, LinkTest, link_test_plan, measure_link_loss
from seatrial.daq.drivers.base import LinkStatus
from seatrial.daq.errors import SeatrialError
from tests.daq.mavlink_ends import mav_rig

SILENT, ENDED = 3.0, 3.5  # s: the sender stops here; thrust ends later


def measured(left: float, right: float = N_TEST, receiver: bool | None = None) -> LinkTest:
    """Return the result for a log in which both outputs have these values until ENDED."""
    rig, t = mav_rig(), np.arange(0.0, 10.0, 0.025)
    outputs = {1: left, 3: right}

    def table(_kind: object, _device: str, node: int) -> Any:
        rows = np.zeros(len(t), [("t", "f8"), ("n", "f8")])
        rows["t"], rows["n"] = t, np.where((t > 1.0) & (t < ENDED), outputs[node], 0.0)
        return rows

    log: Any = SimpleNamespace(
        path=Path("link.mcap"),
        rig=rig,
        table=table,
        events=lambda: [(SILENT, MUTED, "")],
        raw=lambda _device: [(at, "tx", b"") for at in np.arange(0.0, SILENT, 0.02)],
    )
    return measure_link_loss(log, rig.device("autopilot"), LinkStatus(receiver=receiver), N_TEST)


def test_the_time_from_the_last_frame_to_neutral_is_measured() -> None:
    found = measured(N_TEST)
    assert found.seconds == pytest.approx(ENDED - SILENT, abs=0.05)
    assert (found.passed, found.n, found.receiver) == (True, N_TEST, None)
    assert measured(N_TEST, receiver=False).receiver is False


@pytest.mark.parametrize("n", [0.0, 0.4 * N_TEST, np.nan])
def test_a_link_test_without_thrust_has_no_result(n: float) -> None:
    for outputs, name in (((n, N_TEST), "left"), ((N_TEST, n), "right")):
        with pytest.raises(
            SeatrialError, match=f"link.mcap: thruster {name} gave no thrust before the link was interrupted"
        ) as caught:
            measured(*outputs)
        assert "\n" not in str(caught.value)


def test_a_limit_below_the_test_command_is_reported() -> None:
    rig = mav_rig()
    assert link_test_plan(replace(rig, limits=replace(rig.limits, n_max=N_TEST))).n_max == N_TEST
    with pytest.raises(SeatrialError, match=r"commands n = 0\.1, and limits\.n_max is 0\.05"):
        link_test_plan(replace(rig, limits=replace(rig.limits, n_max=0.05)))
