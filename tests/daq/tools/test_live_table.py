"""Tests of the state of each source in the live table: kinds of samples, silent sources, a hanging acquisition."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import pytest
from rich.console import Console

from seatrial.daq.acquisition.status import Latest, PortStatus, Source, Status
from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.rig import Rig
from seatrial.daq.samples import NAN, Ahrs, Autopilot, Battery, Esc, Gnss, Sample, Servo
from seatrial.daq.tools.live_table import describe, line, table
from tests.daq.mavlink_ends import mav_rig
from tests.daq.ptys import RIG

NOW = 100.0
LEVEL = Ahrs(0.3, 0.0, 0.0, 0.0, 0.0, 0.0)


def status(device: str, *newest: tuple[Source, Sample, float]) -> Status:
    """Return the status of a device that sends now, with its newest samples and their ages."""
    port = PortStatus(device, "", "/p", 25.0, 25.0, 0.02, 5000, 5000, 0, 0, 0, 0, 10**6, NAN, NAN, "")
    latest = {source: Latest(sample, NOW - age) for source, sample, age in newest}
    return Status(NOW, {device: port}, latest, {}, 0, "run.mcap", 1, 99, 61.0, "", ())


def rows(seen: Status, rig: Rig, now: float = NOW, width: int = 120) -> list[str]:
    console = Console(width=width, force_terminal=True, color_system=None, highlight=False)
    with console.capture() as capture:
        console.print(table(seen, rig, width, now))
    return [row.rstrip() for row in capture.get().splitlines()]


def boat() -> Rig:
    return parse_rig(RIG.format(speed=1.0), Path("rig.toml"))


def test_each_kind_of_sample_has_its_own_line() -> None:
    seen = status(
        "autopilot",
        (("autopilot", None), LEVEL, 0.02),
        (("autopilot/gnss", None), Gnss(1.0, 41.0, -8.0, fix=3, n_sat=9, speed=1.37), 0.2),
        (("autopilot/battery", None), Battery(15.2, 3.0, 0.8), 0.5),
    )
    text = "\n".join(rows(seen, mav_rig()))
    for part in ("yaw 17.2°", "3D 9 sat 1.37 m/s", "battery 15.2 V 3.0 A 80 %"):
        assert part in text
    assert "STALE" not in text


def test_a_device_that_sends_only_another_kind_of_sample_delivers() -> None:
    text = "\n".join(rows(status("gnss", (("gnss/ahrs", None), Ahrs(0.3, NAN, NAN), 0.05)), boat()))
    assert "yaw 17.2°" in text
    assert "no sample yet" not in text


@pytest.mark.parametrize("width", [80, 120])
def test_a_silent_node_and_a_silent_kind_of_sample_are_stale(width: int) -> None:
    seen = status("esc", (("esc", 1), Esc(1, 1500.0, 3.0), 60.0), (("esc", 2), Esc(2, 1490.0, 3.0), 0.03))
    left, right = (row for row in rows(seen, boat(), width=width) if "rpm" in row)
    assert "STALE 60 s: left: 1500 rpm" in left
    assert "STALE" not in right
    seen = status(
        "autopilot", (("autopilot", None), LEVEL, 0.02), (("autopilot/gnss", None), Gnss(1.0, 41.0, -8.0, fix=3), 120)
    )
    (gnss,) = [row for row in rows(seen, mav_rig(), width=width) if "3D" in row]
    assert "STALE 120 s" in gnss


def test_slow_sources_of_a_working_device_are_not_stale() -> None:
    fix, compass = Gnss(1.0, 41.0, -8.0, fix=3), Ahrs(0.3, NAN, NAN)
    late = status("gnss", (("gnss", None), fix, 2.2), (("gnss/ahrs", None), compass, 0.05))  # one fix at 1 Hz is lost
    servo = status("autopilot", (("autopilot", None), LEVEL, 0.02), (("autopilot", 3), Servo(3, 1500.0), 1.2))
    assert "STALE" not in "\n".join(rows(late, boat()) + rows(servo, mav_rig()))
    bare = dataclasses.replace(boat(), thrusters=())
    many = status("esc", *[(("esc", k), Esc(k, 1500.0), 1.5) for k in range(1, 11)])  # 2.5 Hz each
    assert "STALE" not in "\n".join(rows(many, bare))


@pytest.mark.parametrize(("age", "stale"), [(0.02, False), (60.0, True)])
def test_an_autopilot_that_waits_for_a_fix_is_stale_only_when_it_is_silent(age: float, stale: bool) -> None:
    none = (("autopilot/gnss", None), Gnss(NAN, NAN, NAN, n_sat=0), 60.0)
    seen = status("autopilot", (("autopilot", None), LEVEL, age), none)
    seen = dataclasses.replace(seen, ports={"autopilot": dataclasses.replace(seen.ports["autopilot"], age=age)})
    (row,) = [row for row in rows(seen, mav_rig()) if "no fix 0 sat" in row]
    assert ("STALE 60 s" in row) == stale


def test_an_acquisition_that_hangs_is_not_recording() -> None:
    seen = status("autopilot", (("autopilot", None), LEVEL, 0.02))
    assert " REC " in rows(seen, mav_rig(), NOW + 0.2)[0]
    head, *other_rows = rows(seen, mav_rig(), NOW + 6.0)
    assert " REC " not in head
    assert "the acquisition process does not answer" in head
    (row,) = [row for row in other_rows if "autopilot" in row]
    assert row.startswith("!")
    assert "6.0 STALE" in row
    assert " 25.0 " not in row
    assert "the acquisition process does not answer" in line(seen, mav_rig(), NOW + 6.0)
    assert "the acquisition process does not answer" not in line(seen, mav_rig(), NOW + 0.2)


def test_the_state_of_an_autopilot_is_shown_in_words() -> None:
    rig = mav_rig()
    assert describe(Servo(3, 1500.0, 0.25), rig, "autopilot") == "output 3: 1500 us n 0.25"
    assert describe(Autopilot(1, 4, 4), rig, "autopilot") == "armed, mode 4"
    assert describe(Battery(15.2, math.nan, math.nan), rig, "autopilot") == "battery 15.2 V"
