"""Tests of the messages between the processes of an acquisition: each type survives its line of JSON, whole and in
pieces.
"""

from __future__ import annotations

import math
import socket

import pytest

from seatrial.daq.acquisition import ipc
from seatrial.daq.acquisition.status import Latest, PortStatus, Status, StreamedSample
from seatrial.daq.drivers.base import LinkStatus
from seatrial.daq.samples import Ahrs, Esc

PORT = PortStatus("ahrs", "vectornav", "/p/ahrs", 40.0, math.inf, 0.1, 5, 5, 0, 0, 0, 0, 100, 1e-3, 1e-3, "")
LATEST = {("ahrs", None): Latest(Ahrs(1.0, 0.1, 0.2, 0.0, 0.0, 0.0), 1.0), ("can", 2): Latest(Esc(2, 10.0, 1.0), 2.0)}
STATUS = Status(
    9.0, {"ahrs": PORT}, LATEST, {"left": 0.5}, 3, "/run.mcap", 10, 9, 8.0, "", ("a warning",),
    links={"fcu": LinkStatus(received=True, refused=("ATTITUDE",))}, hints=("a hint",),
)  # fmt: skip
MESSAGES: list[ipc.Message] = [
    ipc.Configuration("text", "/rig.toml", "/run.mcap", 2.0, [1.0, 2.0], "ask", {"m.toml": b"\x00\xff"}, {"a": "b"}),
    ipc.ParentAlive(runner=True),
    ipc.ScheduleSetpoints([[1.0, {"left": 0.5}]]),  # type: ignore[list-item]
    ipc.ZeroThrust("end"),
    ipc.LogEvent("step", "1"),
    ipc.DriverRequest("fcu", "mode", 4.0),
    ipc.StreamSamples(),
    ipc.Stop("the duration has ended"),
    ipc.StatusReport(STATUS),
    ipc.SampleBatch([StreamedSample("ahrs", Ahrs(1.0, math.nan, 0.2), 1.5)], 3),
    ipc.Failed("the disk is full"),
    ipc.Closed("closed on request"),
    ipc.WatchdogConfiguration("text", "/rig.toml", 7, "/run.mcap"),
    ipc.WatchdogReady(),
]


def test_there_is_an_example_of_each_message() -> None:
    assert {type(message) for message in MESSAGES} == set(ipc.Message.__args__)


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
def test_a_decoded_message_equals_the_encoded_message(message: ipc.Message) -> None:
    line = ipc.encode_message(message)
    assert line.count(b"\n") == 1
    assert repr(ipc.decode_message(line)) == repr(message)  # NaN is equal only as text


def test_a_message_may_arrive_in_pieces() -> None:
    ours, theirs = socket.socketpair()
    channel = ipc.AcquisitionChannel(theirs)
    line = ipc.encode_message(ipc.ZeroThrust("end")) + ipc.encode_message(ipc.Stop())
    ours.sendall(line[:20])
    assert channel.receive() == []
    ours.sendall(line[20:])
    assert channel.receive() == [ipc.ZeroThrust("end"), ipc.Stop()]
    ours.close()
    with pytest.raises(EOFError):
        channel.receive_first()
    channel.close()
