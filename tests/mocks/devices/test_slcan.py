"""Tests of the mock slcan adapter: against the manual, and with python-can's bus through a real pty."""

from __future__ import annotations

import contextlib
import select
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import SimpleQueue

import can
import pytest

from seatrial.mocks.devices.slcan_adapter import Adapter, CanFrame
from seatrial.mocks.ports.pty import PtyPort


def test_answers_by_the_manual() -> None:
    adapter = Adapter()
    script = [
        (b"\r\r", b"\r\r"),
        (b"C\r", b"\a"),  # the channel is closed
        (b"F\r", b"\a"),
        (b"T000000010\r", b"\a"),
        (b"S6\r", b"\r"),
        (b"O\r", b"\r"),
        (b"S6\r", b"\a"),  # not allowed while the channel is open
        (b"O\r", b"\a"),
        (b"V\r", b"V1013\r"),
        (b"v\r", b"v1013\r"),
        (b"N\r", b"NA001\r"),
        (b"F\r", b"F00\r"),
        (b"t1232AABB\r", b"z\r"),
        (b"T000000010\r", b"Z\r"),
        (b"r1230\r", b"z\r"),
        (b"q\r", b"\a"),
        (b"C\r", b"\r"),
        (b"L\r", b"\r"),
        (b"T000000010\r", b"\a"),  # listen-only mode
    ]
    for sent, expected in script:
        assert adapter.feed(sent)[0] == expected, sent


@pytest.mark.parametrize(
    "line", [b"T0000000", b"T000000012AA", b"T0000000190", b"t9991AA", b"TFFFFFFFF0", b"t12G0", b"t1231\xff\xff"]
)
def test_a_malformed_frame_is_refused(line: bytes) -> None:
    adapter = Adapter()
    adapter.feed(b"O\r")
    assert adapter.feed(line + b"\r") == (b"\a", [])
    assert adapter.feed(b"t0010\r")[1] == [CanFrame(1, b"", False)]


def test_bytes_in_any_pieces_and_a_line_without_end() -> None:
    adapter = Adapter()
    frames: list[CanFrame] = []
    for byte in b"O\rT00000901812345678AABBCCDD\rt0010\r":
        frames += adapter.feed(bytes([byte]))[1]
    assert frames == [CanFrame(0x901, bytes.fromhex("12345678AABBCCDD")), CanFrame(1, b"", False)]
    assert adapter.feed(b"x" * 1000)[0].count(b"\a") == 15
    adapter.feed(b"\r")
    assert adapter.feed(b"t0010\r")[1] == [CanFrame(1, b"", False)]


class Far:
    """Adapter on a port, served by a thread until the block ends."""

    def __init__(self, path: Path) -> None:
        self.port = PtyPort(path)
        self.adapter = Adapter()
        self.frames: list[CanFrame] = []
        self.outbox: SimpleQueue[bytes] = SimpleQueue()
        self.heard = threading.Condition()
        self._ending = False
        self._thread = threading.Thread(target=self._serve)

    def _serve(self) -> None:
        while not self._ending:
            while not self.outbox.empty():
                self.port.write(self.outbox.get(), time.monotonic())
            if select.select([self.port], [], [], 0.02)[0]:
                answer, frames = self.adapter.feed(self.port.read())
                with self.heard:
                    self.frames += frames
                    self.heard.notify_all()
                self.port.write(answer, time.monotonic())

    def __enter__(self) -> Far:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending = True
        self._thread.join()
        self.port.close()


@pytest.fixture
def far(tmp_path: Path) -> Iterator[Far]:
    with Far(tmp_path / "can") as far:
        yield far


@contextlib.contextmanager
def opened(far: Far) -> Iterator[can.BusABC]:
    bus = can.Bus(interface="slcan", channel=str(far.port.path), bitrate=500_000, sleep_after_open=0)
    try:
        yield bus
    finally:
        bus.shutdown()


def test_python_can_opens_sends_and_receives(far: Far) -> None:
    sent = [
        can.Message(arbitration_id=0x1B02, data=bytes(range(8)), is_extended_id=True),
        can.Message(arbitration_id=0x123, data=b"\x01\x02", is_extended_id=False),
        can.Message(arbitration_id=0x1, data=b"", is_extended_id=True),
    ]
    with opened(far) as bus:
        assert bus.get_version(5.0) == (10, 13)
        assert bus.get_serial_number(5.0) == "A001"
        for message in sent:
            bus.send(message)
        with far.heard:
            assert far.heard.wait_for(lambda: len(far.frames) == 3, timeout=5.0)
        assert [(f.arbitration_id, f.data, f.extended) for f in far.frames] == [
            (m.arbitration_id, bytes(m.data), m.is_extended_id) for m in sent
        ]
        for frame in far.frames:
            far.outbox.put(far.adapter.encode(frame))
        received: list[can.Message] = []
        deadline = time.monotonic() + 5.0
        while len(received) < 3 and time.monotonic() < deadline:
            message = bus.recv(0.2)
            received += [message] if message is not None else []
        assert [(m.arbitration_id, bytes(m.data), m.is_extended_id) for m in received] == [
            (m.arbitration_id, bytes(m.data), m.is_extended_id) for m in sent
        ]


def test_a_closed_channel_does_not_send_frames(far: Far) -> None:
    assert far.adapter.encode(CanFrame(1, b"\x01")) == b""
    with opened(far) as bus:
        assert bus.get_version(5.0) == (10, 13)
        assert far.adapter.encode(CanFrame(1, b"\x01")) == b"T00000001101\r"
    _await(lambda: not far.adapter.open)
    assert far.adapter.encode(CanFrame(1, b"\x01")) == b""


def _await(condition: Callable[[], bool], seconds: float = 5.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.001)
