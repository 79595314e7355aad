"""Test of the electrical power of a thruster: a VESC reports the current of its motor, and the supply's is smaller."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from seatrial.daq.log import open_log
from seatrial.daq.samples import Esc
from seatrial.ident.data.loading import TimeWindow, load_run
from seatrial.ident.workflows.electrical import electrical_channels
from seatrial.mocks.plant.bench import draw_bench
from tests.missions import bench_log


def test_power_of_a_vesc_is_that_of_its_supply(tmp_path: Path) -> None:
    path = bench_log(tmp_path / "bench.mcap", draw_bench(1), kind="steps")
    loaded = load_run(path, "estimation")
    (name,) = {n.removeprefix("n_cmd_") for n in loaded.run.channels if n.startswith("n_cmd_")}
    found, formula = electrical_channels(path, loaded, name)
    assert formula == "voltage × motor current × duty cycle"
    with open_log(path) as log:
        table = log.table(Esc, "esc")
    good = np.isfinite(table["voltage"]) & np.isfinite(table["current"]) & np.isfinite(table["duty"])
    expected = (table["voltage"] * np.abs(table["current"] * table["duty"]))[good]
    np.testing.assert_allclose(found["power"].value, expected)
    assert found["power"].value.max() > 10.0
    shaft = loaded.run.channels[f"n_{name}"]  # The times are those of the loaded log.
    assert abs(found["power"].t[-1] - shaft.t[-1]) < 0.2
    part = load_run(path, "estimation", TimeWindow(72.0, 79.0))
    same, _ = electrical_channels(path, part, name)
    np.testing.assert_allclose(same["power"].t, found["power"].t)
    imported = type(loaded)(loaded.run, loaded.about, loaded.holds, None)
    assert electrical_channels(path, imported, name) == ({}, "")
