"""Test of four devices with 5,000 frames a second for a short time: every frame is in the log or counted as lost.

`python -m benchmarks.acquisition --seconds 600 --days 7` measures the same for ten minutes, and a week in segments.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.acquisition import LOSS_RATE, record, soak
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Ahrs, PortHealth

SECONDS = 1.0


def test_every_frame_is_logged_or_counted_as_lost(tmp_path: Path) -> None:
    counts, dropped = record(tmp_path, 4, LOSS_RATE, SECONDS, busy=False)
    assert counts["sent"] == 4 * LOSS_RATE * SECONDS
    with open_log(tmp_path / "log.mcap") as log:
        tables = [log.table(Ahrs, f"d{k}") for k in range(4)]
        last = [log.health(f"d{k}")[-1][1] for k in range(4)]
        assert sorted(log.sources(PortHealth)) == ["d0", "d1", "d2", "d3"]
    assert sum(map(len, tables)) + dropped == counts["sent"] - counts["refused"]
    assert sum(health.dropped for health in last) == dropped
    assert [health.checksum_errors for health in last] == [0] * 4
    for table in tables:  # the roll rate is the number of the message
        assert np.all(np.diff(table["p"]) >= 1)


def test_segments_under_a_disk_budget_lose_and_double_no_sample() -> None:
    found = {figure.name: figure.value for figure in soak(100.0, 1)}
    assert found["samples"] > 10_000
    assert found["written, but not in order"] == 0
    assert found["missing or twice within what is kept"] == 0
    assert found["segments kept"] in range(3, 15)  # of 16
    assert found["largest size"] < 1.1
