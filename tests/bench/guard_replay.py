"""Replay of recorded logs through the safety guard: whether it would have stopped the run, when and why.

    python -m tests.bench.guard_replay seatrial-demo
    python -m tests.bench.guard_replay run.mcap --rig rig.toml

The guard reads no clock and opens no port, so it judges a log as it judges a run. A stop in the log is printed beside
the stop of the replay. The exit status is 1 if the guard stops a run that ended by itself.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from seatrial.bench.execution.safety_guard import SafetyGuard, Stop
from seatrial.daq.acquisition import Source
from seatrial.daq.acquisition.device_loop import source_of
from seatrial.daq.acquisition.status import Latest, PortStatus, Status
from seatrial.daq.config.rig_file import load_rig
from seatrial.daq.drivers import LinkStatus
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log.reader import Log, open_log
from seatrial.daq.protocol.mavlink import mode_name
from seatrial.daq.rig import Rig
from seatrial.daq.samples import MEASURED, Autopilot, Command, Esc, Sample, Scalar, Servo

ENDS = ("zero", "stop", "end")  # kinds of events
STATUS_S = 0.05  # wall seconds from one status to the next, as in a run


@dataclass(frozen=True)
class Replay:
    """Decisions of the guard on a recorded run."""

    statuses: int
    recorded: str  # why the run was stopped, as the log states; empty if it ended by itself
    t: float  # run time of the guard's stop, from the start of the run [s]; infinity without one
    stop: Stop | None


class _Arrival(NamedTuple):
    """A sample as the acquisition process received it."""

    t_rx: float
    source: Source
    latest: Latest


def _arrivals(log: Log, rig: Rig) -> Iterator[_Arrival]:
    """Yield every sample that a device of the rig sent."""
    devices = {device.name: device for device in rig.devices}
    for kind in MEASURED:
        names = [] if kind is Scalar else [name for name in log.sources(kind) if name in devices]
        for name in names:
            nodes = log.nodes(kind, name) if kind is Esc or kind is Servo else [None]
            for node in nodes:
                for row in log.table(kind, name, node):
                    sample = _sample(kind, node, row)
                    latest = Latest(sample, float(row["t"]))
                    yield _Arrival(float(row["t_rx"]), source_of(devices[name], sample), latest)


def _sample(kind: type[Any], node: int | None, row: np.void) -> Sample:
    names = set(row.dtype.names or ())
    values = {name: row[name].item() for name in kind.__slots__ if name in names}
    made: Sample = kind(**{"node": node, **values} if node is not None else values)
    return made


def _port(rig: Rig, name: str, n: int, last: float, now: float) -> PortStatus:
    """Return the state of a port after `n` samples, the last one at `last`."""
    device = rig.device(name)
    return PortStatus(
        name, device.protocol, device.port, device.rate_hz, device.rate_hz, now - last, n, n,
        0, 0, 0, 0, 0, 0.0, 0.0, "",
    )  # fmt: skip


def replay(path: Path, rig: Rig | None = None) -> Replay:
    """Step a guard through the log of a run, from its start to its end.

    Parameters
    ----------
    path : log of a mission or of a bench run
    rig : rig that replaces the rig in the log
    """
    with open_log(path) as log:
        rig = rig or log.rig
        if rig is None:
            raise SeatrialError(f"{path} has no rig: it was not recorded by a run; give one with --rig")
        arrivals = sorted(_arrivals(log, rig), key=lambda arrival: arrival.t_rx)
        commands = {
            thruster.name: log.table(Command, thruster.device, thruster.node)
            for thruster in rig.thrusters
            if thruster.node in log.nodes(Command, thruster.device)
        }
        events = log.events()
        recorded = next((text for _, kind, text in events if kind == "stop"), "")
    if not any(len(rows) for rows in commands.values()):
        raise SeatrialError(f"{path} has no command: nothing was driven")
    # The guard of a run starts when the autopilots are armed. It is not polled after the zero that ends the mission.
    first = min(float(rows["t_rx"][0]) for rows in commands.values() if len(rows))
    start = next((t for t, kind, _ in events if kind == "start"), first)
    last = max(float(rows["t_rx"][-1]) for rows in commands.values() if len(rows))
    end = next((t for t, kind, _ in events if kind in ENDS and t > start), last)

    guard = SafetyGuard(rig, rig.speed, tuple(commands))
    guard.start()
    latest: dict[Source, Latest] = {}
    received = {device.name: (0, -math.inf) for device in rig.devices}  # number of samples and time of the last sample
    k = 0
    times = np.arange(start, end, STATUS_S * rig.speed).tolist()
    for number, now in enumerate(times, start=1):
        while k < len(arrivals) and arrivals[k].t_rx <= now:
            arrival, k = arrivals[k], k + 1
            latest[arrival.source] = arrival.latest
            name = arrival.source[0].partition("/")[0]
            received[name] = received[name][0] + 1, arrival.t_rx
        commanded = {name: _held(rows, now) for name, rows in commands.items()}
        ports = {name: _port(rig, name, n, last, now) for name, (n, last) in received.items()}
        status = Status(
            now, ports, dict(latest), commanded, 0, str(path), number, number, now - start, "", (),
            links=_links(latest),
        )  # fmt: skip
        if stop := guard.step(now, status).stop:
            return Replay(number, recorded, now - start, stop)
    return Replay(len(times), recorded, math.inf, None)


def _held(rows: np.ndarray, now: float) -> float:
    """Return the command that was last sent before `now`."""
    index = int(np.searchsorted(rows["t_rx"], now, side="right")) - 1
    return float(rows["n_cmd"][index]) if index >= 0 else 0.0


def _links(latest: dict[Source, Latest]) -> dict[str, LinkStatus]:
    found = {}
    for (name, _), newest in latest.items():
        if isinstance(newest.sample, Autopilot):
            state = newest.sample
            device = name.partition("/")[0]
            found[device] = LinkStatus(received=True, age=0.0, armed=bool(state.armed), mode=mode_name(state.mode))
    return found


def main() -> int:
    """Replay the logs of the command line and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="+", type=Path, help="logs, or folders of logs")
    parser.add_argument("--rig", type=Path, help="rig file to use instead of the one in the log")
    options = parser.parse_args()
    rig = load_rig(options.rig) if options.rig else None
    status = 0
    for path in options.paths:
        for log in sorted(path.rglob("*.mcap")) if path.is_dir() else [path]:
            try:
                found = replay(log, rig)
            except SeatrialError as error:
                print(f"{log}: not replayed: {error}")
                continue
            is_false = found.stop is not None and not found.recorded
            status |= is_false
            verdict = "no stop" if found.stop is None else f"stop after {found.t:.1f} s: {found.stop.reason}"
            print(f"{log}: {found.statuses} statuses, {verdict}; in the log: {found.recorded or 'no stop'}", flush=True)
    return status


if __name__ == "__main__":
    sys.exit(main())
