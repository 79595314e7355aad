"""Tests of a tlog of the simulator of ArduPilot Rover, by public commands, against the true values of the simulator."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Ahrs, Autopilot, Gnss, Servo
from tests.measured.data import measured, run

pytestmark = [pytest.mark.measured, pytest.mark.slow]

HERE = Path(__file__).resolve().parents[2] / "docs/examples/ardurover"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("ardurover") / "steps.mcap"
    tlog = str(measured("ardurover/steps_boat.tlog"))
    run("import", "mavlink", tlog, "--rig", str(HERE / "rig.toml"), "-o", str(out))
    return out


def test_every_message_is_decoded_and_each_fix_is_kept_once(log: Path) -> None:
    with open_log(log) as opened:
        # Counts by pymavlink's own reader: 7249 ATTITUDE, and 1449 GPS_RAW_INT with every fix sent about twice.
        assert np.isfinite(opened.table(Ahrs, "autopilot")["yaw"]).sum() == 7249
        fixes = opened.table(Gnss, "autopilot")
        assert np.isfinite(fixes["lat"]).sum() == 687
        assert len(fixes) == 689  # Two messages report no fix: no receiver, then three satellites.
        assert np.all(np.diff(fixes["t_device"][2:]) > 0)
        assert "0 bytes not understood" in opened.events()[0][2]
        texts = [text for _, kind, text in opened.events() if kind == "statustext"]
        assert "info: Throttle armed" in texts
        armed = opened.table(Autopilot, "autopilot")["armed"]
        assert set(armed) == {0, 1}


def test_outputs_follow_the_commands_by_a_few_milliseconds(log: Path) -> None:
    with measured("ardurover/steps_boat_cmd.csv").open() as file:
        rows = [(float(row["t_cmd"]), int(row["left"]), int(row["right"])) for row in csv.DictReader(file)]
    delays = []
    with open_log(log) as opened:
        outputs = {side: opened.table(Servo, "autopilot", node) for side, node in (("left", 1), ("right", 3))}
        for t, left, right in rows[1:]:
            for side, pwm in (("left", left), ("right", right)):
                table = outputs[side]
                reached = (table["t"] > t) & (np.abs(table["pwm"] - pwm) < 2.0)
                assert reached.any(), (t, side, pwm)
                delays.append(float(table["t"][np.argmax(reached)] - t))
                n = table["n"][np.argmax(reached)]
                assert n == pytest.approx((pwm - 1500) / 400, abs=0.005)
    assert max(delays) < 0.03


def test_surge_and_yaw_parameters_equal_the_parameters_of_the_simulator(log: Path, tmp_path: Path) -> None:
    model = f"{HERE / 'steered_boat.py'}:boat"
    run("ident", "vehicle", str(log), "--model", model, "--rate", "25", "--out", str(tmp_path))
    fit = json.loads((tmp_path / "result.json").read_text())["fit"]
    found = {row["name"]: (row["value"], row["se"]) for row in fit["parameters"]}
    m_u, se = found["m_u"]
    assert m_u == pytest.approx(2.0, rel=0.03)
    assert se < 0.03
    d_uu, se = found["d_uu"]
    assert d_uu == pytest.approx(0.5, rel=0.015)
    assert se < 0.005
    assert found["T"][0] < 0.1  # The simulator has no inertia in yaw.
    assert found["tau"][0] == pytest.approx(0.07, abs=0.03)
