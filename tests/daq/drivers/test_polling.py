"""Tests of a device that answers only when polled: with a simulated clock, and on a real port."""

from __future__ import annotations

import os
import threading
import tty
from pathlib import Path

import pytest

from seatrial.daq.acquisition.session import Acquisition
from seatrial.daq.clock import RunClock
from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.drivers.base import PollingDriver
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import LoadCell
from tests.daq.ptys import wait_for

RIG = """
format = "seatrial-rig 1"
name = "asked"

[[device]]
name = "cell"
protocol = "mantracourt"
port = "cell"
rate_hz = 50.0
query = "!002:SYS?"
[device.calibration]
newton_per_count = 2.0
"""


def test_polls_have_the_rate_and_missed_polls_are_not_repeated() -> None:
    driver = PollingDriver(b"?", 0.1)
    driver.opened(5.0)
    assert [driver.poll(5.0), driver.poll(5.05), driver.poll(5.11), driver.poll(5.12)] == [b"?", b"", b"?", b""]
    assert driver.wait(5.12) == pytest.approx(0.08)
    assert [driver.poll(9.0), driver.poll(9.05), driver.poll(9.1)] == [b"?", b"", b"?"]


def test_a_converter_is_polled_and_its_answers_are_logged(tmp_path: Path) -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    (tmp_path / "cell").symlink_to(os.ttyname(slave))
    asked: list[bytes] = []

    def answer() -> None:
        while (line := os.read(master, 64)) != b"end":
            asked.append(line)
            os.write(master, b"%.3f\r" % (10.0 + len(asked)))

    converter = threading.Thread(target=answer, daemon=True)
    converter.start()
    rig = parse_rig(RIG, tmp_path / "rig.toml")
    with Acquisition(rig, tmp_path / "log.mcap", clock=RunClock()) as acquisition:
        wait_for(lambda: acquisition.status().ports["cell"].samples >= 10, what="ten answers")
    os.write(slave, b"end")
    converter.join(5.0)
    with open_log(tmp_path / "log.mcap") as log:
        table = log.table(LoadCell, "cell")
        assert table["counts"][:5].tolist() == [11.0, 12.0, 13.0, 14.0, 15.0]
        assert table["force"][0] == 22.0
        sent = [data for _, direction, data in log.raw("cell") if direction == "tx"]
    assert set(sent) == {b"!002:SYS?\r"}
    assert b"".join(asked).startswith(b"!002:SYS?\r")
    os.close(master)
    os.close(slave)
