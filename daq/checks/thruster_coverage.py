"""Coverage of thrusters: whether each controller of the rig is heard, at which rate, and which nodes are unknown."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from daq.checks.findings import FAULT, OK, WARNING, Finding
from daq.log import Log
from daq.samples import Command, Esc

SLOW = 0.5  # of the rate of the fastest controller on the same bus
LONGEST_PAUSE_S = 60.0  # s; a longer time between two speeds is a gap of the log and tells nothing of their rate
FEWEST = 10  # samples of the fastest one


def check_thruster_coverage(log: Log) -> Iterator[Finding]:
    """Compare the nodes of each bus of speed controllers with the thrusters of the rig.

    Thrusters behind an autopilot are left out, and so are buses without any telemetry.
    """
    rig = log.rig
    if rig is None:
        return
    for device in log.sources(Esc):
        names = {t.node: t.name for t in rig.thrusters if t.device == device and t.output is None}
        heard = log.nodes(Esc, device)
        if not names or not heard:
            continue
        unknown = [node for node in heard if node not in names]
        listed = ", ".join(str(node) for node in unknown)
        for node in unknown:
            text = f"node {node} reports a speed, and no thruster of the rig has it"
            advice = "`node` of the rig's thrusters, or another controller on the bus"
            yield Finding(WARNING, "node-unknown", "thrusters", device, text, advice)
        for node, name in names.items():
            # One that was commanded is a fault of its own (ident.checks.log_checks).
            if node not in heard and node not in log.nodes(Command, device):
                text = f"its controller, node {node} of {device}, is not in the log"
                advice = "its power and cable"
                advice += f"; node {listed} is unknown: does it count from one?" if unknown else ""
                yield Finding(FAULT, "thruster-not-heard", "thrusters", name, text, advice)
        counts = {node: len(log.table(Esc, device, node)) for node in names if node in heard}
        most = max(counts.values(), default=0)
        for node, n in counts.items():
            if most < FEWEST:
                continue
            t = np.sort(log.table(Esc, device, node)["t"])
            steps = np.diff(t)
            steps = steps[steps < LONGEST_PAUSE_S]
            rate = steps.size / float(steps.sum()) if steps.sum() > 0.0 else 0.0
            if n < SLOW * most:
                text = f"{n} speeds ({rate:.3g} Hz), and {most} of the other controllers on {device}"
                advice = "bus load, its cable, its power"
                yield Finding(WARNING, "thruster-rate-low", "thrusters", names[node], text, advice)
            else:
                yield Finding(OK, "thruster-rate-measured", "thrusters", names[node], f"{rate:.3g} Hz, node {node}")
