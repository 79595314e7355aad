"""Tests of the thruster controllers in a log: silent ones, unknown ones, and telemetry with another index."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from seatrial.daq.checks import Finding
from seatrial.daq.checks.thruster_coverage import _check_rpm_max, check_thruster_coverage
from seatrial.daq.config.rig_file import load_rig
from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.can_log import import_can
from seatrial.daq.importers.write_log import SignalRow, write_frames
from seatrial.daq.log import open_log
from seatrial.daq.protocol import dronecan
from seatrial.daq.samples import NAN, Esc, Frame
from tests.daq.mavlink_ends import mav_rig

RIG = """format = "seatrial-rig 1"
name = "boat"
[[device]]
name = "esc"
protocol = "dronecan"
port = "socketcan:can0"
rate_hz = 10.0
index_offset = {offset}
[[thruster]]
name = "left"
device = "esc"
node = 0
position_m = [0.0, -0.3, 0.0]
rpm_max = 3000.0
[[thruster]]
name = "right"
device = "esc"
node = 1
position_m = [0.0, 0.3, 0.0]
rpm_max = 3000.0
"""


def findings(folder: Path, telemetry: dict[int, int], offset: int = 0) -> list[Finding]:
    """Return the findings for ten seconds of a bus.

    ``telemetry`` is the report interval of each index in tenths of a second.
    """
    (folder / "rig.toml").write_text(RIG.format(offset=offset))
    lines = []
    for k in range(100):
        for index, every in telemetry.items():
            if k % every == 0:
                esc = Esc(index, 1000.0 + 100.0 * index, 2.0, 0.0, 14.8, 30.0)
                for identifier, data in dronecan.encode(esc, 20 + index, k % 32):
                    lines.append(f"({1.7e9 + 0.1 * k + 0.001 * index:.6f}) can0 {identifier:08X}#{data.hex().upper()}")
    (folder / "run.log").write_text("\n".join(lines) + "\n")
    import_can(folder / "run.log", folder / "rig.toml", out=folder / "run.mcap", force=True)
    with open_log(folder / "run.mcap") as log:
        return list(check_thruster_coverage(log))


def codes(found: Sequence[Finding]) -> list[tuple[str, str]]:
    return [(f.code, f.where) for f in found]


def test_controllers_at_their_rates_have_no_findings(tmp_path: Path) -> None:
    found = findings(tmp_path, {0: 1, 1: 1})
    assert codes(found) == [("thruster-rate-measured", "left"), ("thruster-rate-measured", "right")]
    assert all(f.level == "ok" and "10 Hz" in f.text for f in found)


def test_telemetry_with_an_index_from_one_is_named_and_can_be_shifted(tmp_path: Path) -> None:
    found = findings(tmp_path, {1: 1, 2: 1})
    assert codes(found)[:2] == [("node-unknown", "esc"), ("thruster-not-heard", "left")]
    assert found[1].level == "fault"
    assert "index_offset = 1" in found[1].advice
    assert not [f for f in findings(tmp_path, {1: 1, 2: 1}, offset=1) if f.level != "ok"]
    with open_log(tmp_path / "run.mcap") as log:
        assert log.table(Esc, "esc", 0)["rpm"][0] == 1100.0


def test_a_silent_and_a_slow_controller_are_reported(tmp_path: Path) -> None:
    (silent,) = [f for f in findings(tmp_path, {1: 1}) if f.level == "fault"]
    assert (silent.code, silent.where) == ("thruster-not-heard", "left")
    assert "index_offset" not in silent.advice
    (slow,) = [f for f in findings(tmp_path, {0: 1, 1: 5}) if f.level == "warning"]
    assert (slow.code, slow.where) == ("thruster-rate-low", "right")
    assert "2 Hz" in slow.text


@pytest.mark.parametrize(("speed", "n_named"), [(1200.0, 1), (0.0, 0)])
def test_a_speed_check_rpm_max_is_named(tmp_path: Path, speed: float, n_named: int) -> None:
    """Behind an autopilot rpm_max may be missing. A fit then has no shaft speed."""
    rig = mav_rig()
    rows = [
        SignalRow(1.7e9 + 0.1 * k, "autopilot", Frame(Esc(node, speed, 2.0, 0.0, 14.8, 30.0), 1.7e9 + 0.1 * k, NAN))
        for k in range(20)
        for node in (1, 3)
    ]
    write_frames(tmp_path / "run.mcap", rows, metadata={}, note="made for a test")
    with open_log(tmp_path / "run.mcap") as log:
        found = list(_check_rpm_max(log, rig))
    assert codes(found) == [("rpm-max-missing", "right")] * n_named
    assert all("1200 rev/min" in f.advice for f in found)


@pytest.mark.parametrize("offset", [20, -20, "1.5"])
def test_an_invalid_index_offset_is_refused(tmp_path: Path, offset: object) -> None:
    (tmp_path / "rig.toml").write_text(RIG.format(offset=offset))
    with pytest.raises(SeatrialError, match="index_offset"):
        load_rig(tmp_path / "rig.toml")
