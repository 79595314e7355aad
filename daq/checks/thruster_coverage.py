"""Coverage of thrusters in a log: controllers without samples, their rates, and unknown nodes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from seatrial.daq.checks.findings import FAULT, OK, WARNING, Finding
from seatrial.daq.log import Log
from seatrial.daq.rig import Rig
from seatrial.daq.samples import Command, Esc

SLOW = 0.5  # part of the samples of the fastest controller on the same bus; fewer are too few
LONGEST_PAUSE_S = 60.0  # s; a longer time between two speeds is a gap of the log, which does not count for the rate
FEWEST = 10  # smallest number of samples of the fastest controller from which rates are compared


def _check_rpm_max(log: Log, rig: Rig) -> Iterator[Finding]:
    """Yield a warning for each thruster whose logged shaft speed cannot be normalised, because the rig lacks `rpm_max`.

    `rpm_max` is the shaft speed at full command [rev/min]. The advice contains the largest speed of all these thrusters
    in the log, so that equal thrusters get one value. Thrusters without a shaft speed other than zero in the log are
    left out.
    """
    largest: dict[str, float] = {}
    for thruster in rig.thrusters:
        if np.isfinite(thruster.rpm_max) or thruster.node not in log.nodes(Esc, thruster.device):
            continue
        rpm = np.abs(log.table(Esc, thruster.device, thruster.node)["rpm"])
        if (top := float(np.nanmax(rpm, initial=0.0))) > 0.0:
            largest[thruster.name] = top
    for name in largest:
        text = "the log contains its speed, but a fit uses its commands: the rig lacks its rpm_max"
        advice = (
            "give the speed at full command as rpm_max in the rig's [[thruster]], the same for equal thrusters; the "
            f"log goes up to {max(largest.values()):.0f} rev/min"
        )
        yield Finding(WARNING, "rpm-max-missing", "thrusters", name, text, advice)


def _numbering_advice(rig: Rig, device: str, nodes: set[int], logged: set[int]) -> str:
    """Return the advice for the user if the log has other numbers (nodes) of speed controllers than the rig.

    On a DroneCAN bus whose logged numbers differ from those of the rig by one constant, the advice is to set this
    constant as `index_offset`. Otherwise the advice is to check `node` of the thrusters.

    Parameters
    ----------
    rig : Rig
        The rig.
    device : str
        Name of the bus.
    nodes : set of int
        Numbers of the controllers in the rig, at least one.
    logged : set of int
        Numbers of the controllers in the log, at least one.
    """
    offset = min(logged) - min(nodes)
    of_dronecan = any(d.name == device and d.protocol == "dronecan" for d in rig.devices)
    if of_dronecan and offset and {node + offset for node in nodes} == logged:
        return f"give the device index_offset = {offset}, if telemetry and commands count from different numbers"
    return "check `node` of the thrusters in the rig"


def check_thruster_coverage(log: Log) -> Iterator[Finding]:
    """Compare the speed controllers of each bus in a log with the thrusters of its rig, and yield the findings.

    A controller without a thruster in the rig, and a thruster without `rpm_max`, give a warning. A thruster whose
    controller has no sample and got no command gives a fault. The rate of each thruster's controller is reported,
    without pauses of 60 s or more. A controller with fewer than half of the samples of the most frequent controller on
    its bus gives a warning. Rates are not reported if the most frequent controller has fewer than 10 samples. Thrusters
    behind an autopilot are left out, except for `rpm_max`. Buses without any telemetry, or without a thruster in the
    rig, are left out too. `rpm_max` may be missing if the log has no other speed than zero. A log without a rig has no
    finding.
    """
    rig = log.rig
    if rig is None:
        return
    yield from _check_rpm_max(log, rig)
    for device in log.sources(Esc):
        names = {t.node: t.name for t in rig.thrusters if t.device == device and t.output is None}
        logged = log.nodes(Esc, device)
        if not names or not logged:
            continue
        unknown = [node for node in logged if node not in names]
        listed = ", ".join(str(node) for node in unknown)
        for node in unknown:
            text = f"node {node} reports a speed, and no thruster of the rig has it"
            advice = "check `node` of the rig's thrusters; it may be another controller on the bus"
            yield Finding(WARNING, "node-unknown", "thrusters", device, text, advice)
        for node, name in names.items():
            # A silent node that was commanded is reported by another check (seatrial.ident.checks.log_checks).
            if node not in logged and node not in log.nodes(Command, device):
                text = f"its controller, node {node} of {device}, is not in the log"
                advice = "check its power and cable"
                if unknown:
                    advice += f"; node {listed} is unknown: {_numbering_advice(rig, device, set(names), set(logged))}"
                yield Finding(FAULT, "thruster-not-heard", "thrusters", name, text, advice)
        counts = {node: len(log.table(Esc, device, node)) for node in names if node in logged}
        most_samples = max(counts.values(), default=0)
        for node, n in counts.items():
            if most_samples < FEWEST:
                continue
            t = np.sort(log.table(Esc, device, node)["t"])
            steps = np.diff(t)
            steps = steps[steps < LONGEST_PAUSE_S]
            rate = steps.size / float(steps.sum()) if steps.sum() > 0.0 else 0.0
            if n < SLOW * most_samples:
                text = f"{n} shaft speeds ({rate:.3g} Hz); another controller on {device} has {most_samples}"
                advice = "check the load of the bus, and cable and power of the controller"
                yield Finding(WARNING, "thruster-rate-low", "thrusters", names[node], text, advice)
            else:
                yield Finding(OK, "thruster-rate-measured", "thrusters", names[node], f"{rate:.3g} Hz, node {node}")
