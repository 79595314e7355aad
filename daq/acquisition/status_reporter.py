"""Reporter of the acquisition process: it sends the status to the parent, and writes new warnings to the log."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from seatrial.daq.acquisition.device_loop import DeviceLoop
from seatrial.daq.acquisition.ipc import AcquisitionChannel, StatusReport
from seatrial.daq.acquisition.log_thread import LogThread
from seatrial.daq.acquisition.status import Status
from seatrial.daq.clock import RunClock
from seatrial.daq.drivers import Setpoints
from seatrial.daq.errors import counted
from seatrial.daq.rig import Rig


class StatusReporter:
    """Reporter of the acquisition process: it sends the status to the parent, and logs warnings, hints and losses.

    Each warning and hint is logged once, and each loss of set-points.

    Parameters
    ----------
    link : AcquisitionChannel
        Socket to the parent.
    rig : Rig
        The rig.
    path : str
        Path of the log.
    clock : RunClock
        The run clock.
    loops : Mapping
        Threads of the ports, by name of the device.
    setpoints : Mapping
        Schedules of set-points, by name of the device; only devices that drive thrusters have one.
    writer : LogThread
        Thread that writes the log.
    event : Callable
        Function `event(kind, text)` that writes an event to the log.
    """

    def __init__(
        self,
        link: AcquisitionChannel,
        rig: Rig,
        path: str,
        clock: RunClock,
        loops: Mapping[str, DeviceLoop],
        setpoints: Mapping[str, Setpoints],
        writer: LogThread,
        event: Callable[[str, str], None],
    ) -> None:
        """Store the objects of the acquisition process whose state is reported. Nothing is sent.

        `link` is the socket to the parent, and `path` the path of the log. `loops` are the threads of the ports, and
        `setpoints` the schedules of thrusters, both by name of the device. `writer` is the log thread, and `event` a
        function of a kind and a text that writes an event to the log.
        """
        self._link, self._rig, self._path, self._clock = link, rig, path, clock
        self._loops, self._setpoints, self._writer, self._event = loops, setpoints, writer, event
        self._started = clock.now()
        self._reported: set[str] = set()
        self._skipped = 0  # set-points whose loss is in the log

    def report(self, stopped: str, ended: str) -> None:
        """Send the status to the parent, and write new warnings, hints and losses of set-points to the log.

        A warning or hint is logged only the first time that its text occurs, also if its cause ends and comes back.

        Parameters
        ----------
        stopped : str
            Why the process has stopped thrust by itself; empty if it has not.
        ended : str
            Why the process ends without a request of the parent; else empty.

        Raises
        ------
        OSError
            If the parent is gone.
        """
        status = self._status(stopped, ended)
        for kind, lines in (("warning", status.warnings), ("hint", status.hints)):
            for text in lines:
                if text not in self._reported:
                    self._reported.add(text)
                    self._event(kind, text)
        self.note_skipped()
        self._link.send(StatusReport(status))

    def note_skipped(self) -> None:
        """Write an event to the log with the number of set-points that were skipped since the last call, if any.

        A set-point is skipped if a later one is due before the earlier one could be sent.
        """
        total = self._count_skipped()
        if total > self._skipped:
            lost = counted(total - self._skipped, "set-point")
            self._event("skipped", f"{lost}: overtaken by later ones before they could be sent")
            self._skipped = total

    def _count_skipped(self) -> int:
        """Return the number of set-points of all devices that were skipped (never sent) since the start."""
        return sum(setpoints.skipped for setpoints in self._setpoints.values())

    def _status(self, stopped: str, ended: str) -> Status:
        """Return the present status of all ports, set-points and the log.

        `stopped` is why the process has stopped thrust, and `ended` why it ends without a request; both are empty
        otherwise. The status has only one of them, and `stopped` takes precedence. The warnings begin with that of the
        log, if there is one; the faults of the ports and the stop of thrust follow.
        """
        now = self._clock.now()
        ports = {name: loop.status(now) for name, loop in self._loops.items()}
        warnings = [f"{port.name} ({port.port}): {port.message}" for port in ports.values() if port.message]
        if self._writer.alarm:
            warnings.insert(0, self._writer.alarm)
        if stopped:
            warnings.append(f"the commands ended: {stopped}")
        held = {name: setpoints.held for name, setpoints in self._setpoints.items()}
        return Status(
            t=now,
            ports=ports,
            latest={source: latest for loop in self._loops.values() for source, latest in loop.latest().items()},
            commanded={t.name: held[t.device].get(t.node, 0.0) for t in self._rig.thrusters},
            pending=sum(setpoints.pending for setpoints in self._setpoints.values()),
            path=self._path,
            bytes=self._writer.size,
            messages=self._writer.messages,
            duration=now - self._started,
            stopped=stopped or ended,
            warnings=tuple(warnings),
            alarm=self._writer.alarm,
            hints=tuple(f"{name} ({ports[name].port}): {loop.hint}" for name, loop in self._loops.items() if loop.hint),
            skipped=self._count_skipped(),
            zeroed={name: loop.zeroed for name, loop in self._loops.items() if not math.isnan(loop.zeroed)},
            links={name: link for name, loop in self._loops.items() if (link := loop.link()) is not None},
        )
