"""Logs of mock boats, healthy or with one fault each, and the finding that a preflight check has to report."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from seatrial.bench.execution.actuator_test import actuator_plan
from seatrial.bench.mission_generators import make_mission
from seatrial.daq.checks.device_checks import check_devices
from seatrial.daq.checks.findings import Finding
from seatrial.daq.config.mission_file import Mission
from seatrial.daq.log.reader import open_log
from seatrial.ident.checks.log_checks import LogChecks
from seatrial.mocks.devices.faults import Faults, parse_fault
from seatrial.mocks.offline_simulation import BOAT, Recording, simulate
from seatrial.mocks.plant.boat import draw_boat
from seatrial.mocks.plant.thruster import ThrusterTruth
from seatrial.mocks.random_streams import FAULT, random_stream
from tests.missions import rig_of, write_log

SECONDS = 120.0
DEVICES, THRUSTERS = ("ahrs", "gnss", "esc"), ("left", "right")


class Case(NamedTuple):
    """Fault: its options for the mocks, and its expected finding (code, where)."""

    name: str
    code: str
    where: str
    fault: str = ""  # for seatrial.mocks.devices.faults
    thruster: ThrusterTruth | None = None
    swapped: bool = False
    reversed: bool = False


CASES = (
    Case("swapped sides", "thruster-sides-swapped", "left and right", swapped=True),
    Case("reversed sign", "thruster-sign-reversed", "left", reversed=True),
    Case("dead thruster", "controller-fell-silent", "right", "esc-dead/right@20"),
    Case("stuck sensor", "sensor-stuck", "ahrs", "stuck/ahrs@25:5"),
    Case("wrong rate", "rate-off", "gnss", "slow/gnss@0"),
    Case("late sensor", "sensor-late", "gnss", "late/gnss@0"),
    Case("wrong units", "angle-in-degrees", "ahrs", "degrees/ahrs@0"),
    Case("dead zone", "dead-band-wide", "left", thruster=ThrusterTruth(dead_zone=0.25)),
    Case("delay", "shaft-late", "left", thruster=ThrusterTruth(delay=1.0)),
    Case("noisy AHRS", "sensor-noisy", "ahrs", "noisy/ahrs@0"),
)


def mission(seed: int, actuators: bool = False) -> Mission:
    """Return the mission of a seed, or the actuator test of the packaged boat."""
    return actuator_plan(rig_of("boat")) if actuators else make_mission("mixed", SECONDS, seed)


@lru_cache(maxsize=2)
def sailed(seed: int, case: Case | None = None, actuators: bool = False) -> Recording:
    """Return the recording of a boat that sails the mission of a seed, with the fault of `case` or without a fault."""
    plan, boat = mission(seed, actuators), draw_boat(seed, (), case.thruster if case else None)
    t, n = plan.setpoints()
    gear, faults = BOAT, None
    if case is not None and case.swapped:  # the two plugs are swapped
        gear, n = replace(BOAT, escs=tuple(reversed(BOAT.escs))), n[:, ::-1]
    if case is not None and case.reversed:
        left, right = BOAT.escs
        gear = replace(BOAT, escs=(replace(left, reversed=True), right))
    if case is not None and case.fault:
        faults = Faults([parse_fault(case.fault, DEVICES, THRUSTERS)], random_stream(seed, FAULT))
    return simulate(boat, t, n, plan.end, seed, gear=gear, faults=faults)


def logged(path: Path, seed: int, case: Case | None = None, actuators: bool = False) -> Path:
    """Write the same recording as a log of the packaged rig."""
    return write_log(path, "boat", sailed(seed, case, actuators).readings, mission(seed, actuators))


def findings(path: Path) -> list[Finding]:
    """Return the findings of `seatrial check LOG`."""
    with open_log(path) as log:
        of_devices = list(check_devices(log))
    return [*of_devices, *LogChecks().check(path)]


def named(case: Case, found: list[Finding]) -> bool:
    """Return whether the expected code is among the findings at the expected place."""
    return any(f.level == "fault" and f.code == case.code and case.where in f.where for f in found)


def alarms(found: list[Finding]) -> list[Finding]:
    """Return every finding that is a fault or a warning."""
    return [f for f in found if f.is_problem]
