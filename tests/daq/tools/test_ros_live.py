"""Live ROS 2 as rmw_zenoh's nodes see it: keys, graph, attachments, messages; and a router that is not there."""

from __future__ import annotations

import contextlib
import math
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from seatrial.daq.acquisition.session import Acquisition
from seatrial.daq.acquisition.status import StreamedSample
from seatrial.daq.clock import RunClock
from seatrial.daq.config.rig_file import load_rig
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log.reader import open_log
from seatrial.daq.rig import Rig, Ros2
from seatrial.daq.samples import Ahrs
from seatrial.daq.tools import ros_live
from seatrial.daq.tools.ros_live import ATTACHMENT, LateCommands, ReceivedCommand, Ros2Node, _decoded_command
from tests.daq.logs import SAMPLES, T0
from tests.daq.logs import rig as rig_of_logs
from tests.daq.ptys import TestBoat, wait_for
from tests.daq.ros_ends import FLOAT64, Commander, Router, session, zenoh

typesys = pytest.importorskip("rosbags.typesys", reason="no ROS types here (rosbags)")
ROOT = Path(__file__).parents[3]
STREAM = [StreamedSample(device, sample, T0 + 0.25) for device, sample in SAMPLES]
IMU = "sensor_msgs::msg::dds_::Imu_/RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b"


def rig(router: Router, **settings: Any) -> Rig:
    return replace(rig_of_logs(), ros2=Ros2(router=router.address, **settings))


@pytest.fixture
def router() -> Iterator[Router]:
    with Router() as started:
        yield started


@pytest.fixture
def listener(router: Router) -> Iterator[Any]:
    opened = session("client", [router.address], [])
    yield opened
    opened.close()


def test_topics_and_messages_equal_the_output_of_rmw_zenoh(router: Router, listener: Any) -> None:
    subscriber = listener.declare_subscriber("7/**", zenoh.handlers.FifoChannel(1000))
    with Ros2Node(rig(router, domain=7, namespace="boat")) as node:
        assert "is connected" in node.await_router(5.0)
        node.put(STREAM, 0)
        wait_for(lambda: node.published == 22, what="all messages")
        time.sleep(0.3)
        graph = [str(reply.ok.key_expr).split("/") for reply in listener.liveliness().get("@ros2_lv/7/**")]
    found: dict[str, list[Any]] = {}
    while (sample := subscriber.try_recv()) is not None:
        found.setdefault(str(sample.key_expr), []).append(sample)
    assert sum(map(len, found.values())) == 22
    (first, second) = found[f"7/boat/ros/ahrs/imu/{IMU}"]
    number, sent_ns, length = struct.unpack("<qqB", first.attachment.to_bytes()[:17])
    assert (number, length, len(first.attachment)) == (1, 16, 33)
    assert abs(sent_ns / 1e9 - time.time()) < 60.0
    assert struct.unpack("<q", second.attachment.to_bytes()[:8]) == (2,)
    assert second.attachment.to_bytes()[17:] == first.attachment.to_bytes()[17:]

    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    imu = store.deserialize_cdr(first.payload.to_bytes(), "sensor_msgs/msg/Imu")
    assert imu.header.frame_id == "base_link"
    assert imu.header.stamp.sec + imu.header.stamp.nanosec / 1e9 == pytest.approx(T0 + 0.25, abs=1e-6, rel=0.0)
    assert (imu.angular_velocity.x, imu.angular_velocity.y, imu.angular_velocity.z) == (0.01, -0.02, -0.03)
    fix = next(samples[0] for key, samples in found.items() if "/boat/gnss/fix/" in key)
    assert store.deserialize_cdr(fix.payload.to_bytes(), "sensor_msgs/msg/NavSatFix").latitude == 63.4

    # @ros2_lv/<domain>/<session>/<node>/<entity>/<kind>/<enclave>/<namespace>/<name>[/<topic>/<type>/<hash>/<qos>]
    (one,) = [parts for parts in graph if parts[5] == "NN"]
    assert one[6:] == ["%", "%boat", "seatrial"]
    publishers = [parts for parts in graph if parts[5] == "MP"]
    assert {f"7/{'/'.join(p[9][1:].split('%'))}/{p[10]}/{p[11]}" for p in publishers} == set(found)
    assert {parts[12] for parts in publishers} == {"::,10:,:,:,,"}
    assert len({parts[4] for parts in graph}) == len(graph)
    assert not [p[9] for p in publishers if any(part[:1].isdigit() for part in p[9].split("%"))]


AHEAD_S = 3600.0  # the sender's clock before ours


def late(ways: list[tuple[float, float]], sender: bytes = b"a", allowed_s: float = 0.3) -> list[bool]:
    """Return whether commands with these send times and delays are late."""
    found = LateCommands(allowed_s)
    return [found.is_late(ReceivedCommand(0.1, sender, at + AHEAD_S), at + took) for at, took in ways]


def test_lateness_of_a_command_is_relative_to_the_fastest_command_of_its_sender() -> None:
    assert late([(0.0, 0.02), (0.1, 0.3), (0.2, 0.35), (0.3, 2.0), (0.4, 0.02)]) == [False, False, True, True, False]
    assert late([(0.05 * k, 0.05 * k) for k in range(10)]) == [False] * 7 + [True] * 3  # a queue that grows
    found = LateCommands(0.3)
    assert not found.is_late(ReceivedCommand(0.1, b"a", 100.0), 7.0)
    assert not found.is_late(ReceivedCommand(0.1, b"b", 0.0), 7.0)  # each has its own clock
    assert not found.is_late(ReceivedCommand(0.1, b""), 9.0)  # who does not say when it sent has no age
    assert found.is_late(ReceivedCommand(0.1, b"a", 100.1), 9.0)
    assert found.number == 1


def test_clocks_that_drift_apart_make_no_command_late() -> None:
    assert not any(late([(at, 0.02 + 1e-4 * at) for at in np.arange(0.0, 36_000.0, 0.5)]))


def test_a_command_that_was_held_up_is_not_taken(router: Router) -> None:
    with Ros2Node(rig(router), ["left"]) as node, Commander(router, 1e-3) as commander:
        node.await_router(5.0)
        time.sleep(0.3)
        commander.send(0.25)
        commander.send(0.5, ago_s=1.0)
        time.sleep(0.3)
        assert [command.n for command in node.take()["left"]] == [0.25]
        assert "1 command ignored because of late arrival" in node.summary()


def test_commands_with_any_type_hash_are_accepted(router: Router, listener: Any) -> None:
    with Ros2Node(rig(router), ["left"]) as node, Commander(router, 1e-3) as commander:
        node.await_router(5.0)
        time.sleep(0.3)
        commander.send(0.25)
        commander.send(b"nonsense")
        time.sleep(0.5)  # there is no order between two senders
        listener.put("0/thrusters/left/command/std_msgs::msg::dds_::Float64_/TypeHashNotSupported",
                     b"\x00\x00\x00\x00" + struct.pack(">d", -0.5))  # fmt: skip
        listener.put(f"0/thrusters/left/command/{FLOAT64}", b"x" * 200_000)  # more than is taken
        time.sleep(0.3)
        commands = node.take()["left"]
        assert [command.n for command in commands] == pytest.approx([0.25, np.nan, -0.5], nan_ok=True)
        assert len(commands[0].sender) == 16
        assert commands[0].sender == commands[1].sender
        assert commands[2].sender == b""
        assert node.take() == {"left": []}


def test_a_router_may_start_late_and_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    router = Router()
    with Ros2Node(rig(router)) as node:
        assert "does not answer" in node.await_router(0.2)
        before = time.monotonic()
        node.put(STREAM, 0)
        assert time.monotonic() - before < 0.05
        wait_for(lambda: "11 samples could not" in node.summary(), what="what was lost")
        with router:
            wait_for(lambda: node.connected, what="the router")
            node.put(STREAM, 3)
            wait_for(lambda: node.published == 22, what="all messages")
        wait_for(lambda: not node.connected, what="its end")
        node.put(STREAM, 3)
        wait_for(lambda: "25 samples could not" in node.summary(), what="what was lost")
        with router:
            wait_for(lambda: node.connected, what="the router again")
            node.put(STREAM, 3)
            wait_for(lambda: node.published == 44, what="all messages")
    monkeypatch.setattr(ros_live, "QUEUE_SAMPLES", 20)
    node.put(STREAM, 3)  # its thread has ended: nothing is taken out any more
    node.put(STREAM, 3)
    assert "47 samples could not be published" in node.summary()


def test_error_without_the_package_names_the_package_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zenoh", None)
    with pytest.raises(SeatrialError, match=r"seatrial\[ros2\]"), Ros2Node(rig_of_logs()):
        pass


def test_a_router_that_hangs_holds_up_neither_log_nor_end(tmp_path: Path) -> None:
    router = Router()
    text = (
        f"import time; from tests.daq.ros_ends import Router; r = Router({router.address!r}); r.start(); time.sleep(99)"
    )
    with TestBoat(tmp_path) as boat, subprocess.Popen([sys.executable, "-c", text], cwd=ROOT) as process:
        with boat.rig_path.open("a", encoding="utf-8") as rig_file:
            rig_file.write(f'[ros2]\nrouter = "{router.address}"\n')
        listener = None
        while listener is None:
            with contextlib.suppress(zenoh.ZError):
                listener = session("client", [router.address], [])
        heard = listener.declare_subscriber("0/ahrs/imu/**", zenoh.handlers.RingChannel(1))
        words = ["-m", "seatrial", "log", str(boat.rig_path), "--ros2", "-o", str(tmp_path / "run.mcap")]
        with subprocess.Popen([sys.executable, *words], cwd=ROOT, stdout=subprocess.PIPE, text=True) as run:
            wait_for(lambda: heard.handler.try_recv() is not None, 60.0, what="a message")
            process.send_signal(signal.SIGSTOP)
            stopped = time.time()
            time.sleep(2.0)
            begun = time.monotonic()
            run.send_signal(signal.SIGINT)
            out, _ = run.communicate(timeout=60.0)
            assert time.monotonic() - begun < 15.0  # Zenoh alone waits for 20 to 40
        process.kill()
        listener.close()
    assert run.returncode == 0
    assert "messages" in out
    with open_log(tmp_path / "run.mcap") as log:
        t = log.table(Ahrs, "ahrs")["t"]
    assert t[-1] > stopped + 1.9
    assert np.diff(t).max() < 0.5


def test_every_sample_that_is_logged_is_streamed(tmp_path: Path) -> None:
    """The samples come from real ports through the acquisition process."""
    taken: list[StreamedSample] = []
    with TestBoat(tmp_path) as boat:
        loaded = load_rig(boat.rig_path)
        with Acquisition(loaded, tmp_path / "run.mcap", clock=RunClock(loaded.speed)) as acquisition:
            acquisition.stream(lambda samples, dropped: taken.extend(samples) or (dropped and pytest.fail("dropped")))
            wait_for(lambda: len(taken) > 300, what="samples")
            newest = max(sample.t for sample in taken)
    with open_log(tmp_path / "run.mcap") as log:
        rows = log.table(Ahrs, "ahrs")
    streamed = [sample for sample in taken if sample.device == "ahrs"]
    t = np.array([sample.t for sample in streamed])
    logged = rows[(rows["t"] >= t[0] - 1e-6) & (rows["t"] <= newest)][: len(t)]
    np.testing.assert_allclose(t, logged["t"], atol=1e-6)
    np.testing.assert_array_equal([sample.sample.r for sample in streamed], logged["r"])  # type: ignore[union-attr]


class _Sample:
    """A sample of Zenoh with this payload and this attachment."""

    def __init__(self, payload: bytes, attachment: bytes | None) -> None:
        self.payload = _Bytes(payload)
        self.attachment = None if attachment is None else _Bytes(attachment)


class _Bytes(bytes):
    def to_bytes(self) -> bytes:  # type: ignore[override]
        return bytes(self)


def test_only_a_complete_attachment_names_its_sender() -> None:
    number = b"\0\1\0\0" + struct.pack("<d", 0.25)
    whole = ATTACHMENT.pack(7, 2_000_000_000, 16, b"g" * 16)
    assert _decoded_command(_Sample(number, whole)) == ReceivedCommand(0.25, b"g" * 16, 2.0, 7)
    unnumbered, short = ATTACHMENT.pack(0, 2, 16, b"g" * 16), ATTACHMENT.pack(7, 2, 9, b"g" * 16)
    broken = [None, b"", whole[:-1], whole + b"x", unnumbered, short]
    for attachment in broken:
        command = _decoded_command(_Sample(number, attachment))
        assert (command.n, command.sender, command.number) == (0.25, b"", 0)
        assert math.isnan(command.sent)
    for payload in (b"", number[:-1], number + b"x", b"\1\1\0\0" + number[4:], b"\0\2\0\0" + number[4:]):
        assert math.isnan(_decoded_command(_Sample(payload, whole)).n)
