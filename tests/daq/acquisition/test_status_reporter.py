"""Tests of the status reporter: each problem reaches the parent process every time, and the log once."""

from __future__ import annotations

import socket
from pathlib import Path

from rich.console import Console

from seatrial.daq.acquisition.device_loop import DeviceLoop
from seatrial.daq.acquisition.ipc import AcquisitionChannel, StatusReport
from seatrial.daq.acquisition.log_thread import LogSink, LogThread
from seatrial.daq.acquisition.status import Status
from seatrial.daq.acquisition.status_reporter import StatusReporter
from seatrial.daq.clock import RunClock
from seatrial.daq.protocol.catalogue import make_decoder
from seatrial.daq.tools.live_table import table
from seatrial.daq.transport.serial_port import SerialPort
from tests.daq.logs import recorder, rig

HINT = (
    "the adapter delays bytes by up to 16 ms (Permission denied); to set 1 ms: echo 1 | sudo tee /sys/.../latency_timer"
)


def test_a_hint_is_in_every_status_and_once_in_the_log(tmp_path: Path) -> None:
    ours, theirs = socket.socketpair()
    link, parent = AcquisitionChannel(ours), AcquisitionChannel(theirs)
    here, clock, sink = rig(), RunClock(), LogSink()
    port = SerialPort("ports/ahrs", 115200)
    loop = DeviceLoop(here.devices[0], port, make_decoder(here.devices[0], here), clock, sink)
    log = recorder(tmp_path / "run.mcap")
    writer = LogThread(log, sink, dict, clock)
    events: list[tuple[str, str]] = []
    reporter = StatusReporter(
        link, here, "run.mcap", clock, {"ahrs": loop}, {}, writer, lambda kind, text: events.append((kind, text))
    )

    def reported(stopped: str = "") -> Status:
        reporter.report(stopped, "")
        (message,) = parent.receive()
        assert isinstance(message, StatusReport)
        return message.status

    assert reported().hints == ()
    port.hint = HINT
    line = f"ahrs ({here.devices[0].port}): {HINT}"
    statuses = [reported(), reported(), reported("the disk is full")]
    assert [status.hints for status in statuses] == [(line,)] * 3
    assert statuses[0].warnings == ()  # not a fault: a run may begin in this state
    assert statuses[2].warnings == ("the commands ended: the disk is full",)
    assert events == [("hint", line), ("warning", "the commands ended: the disk is full")]
    console = Console(width=200)
    with console.capture() as capture:
        console.print(table(statuses[0], here, 200, statuses[0].t))
    assert f"hint: {line}" in capture.get()
    log.close()
    link.close()
    parent.close()
