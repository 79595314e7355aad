"""ROS 2 without ROS: a node that rmw_zenoh's nodes see, on the Zenoh router that the rig names (extra `ros2`).

Key expressions, liveliness tokens and attachments are those of rmw_zenoh's design (github.com/ros2/rmw_zenoh,
docs/design.md), type hashes those of REP-2016; why Zenoh, see docs/decisions/0026-ros-2-over-zenoh.md. The node is a
client of that router: it opens no port and looks for nobody. It runs in the process that shows the table, never in the
one that records.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
import math
import struct
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any, NamedTuple

from seatrial.daq.acquisition import StreamedSample
from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.log import NANO, schema
from seatrial.daq.rig import Rig
from seatrial.daq.samples import NAN, Ahrs, Frame
from seatrial.daq.tools.ros_export import rep_103_imu, ros_topic, ros_types

NODE = "seatrial"
COMMAND = "std_msgs/msg/Float64"
QOS = "::,10:,:,:,,"  # rmw_zenoh's defaults (reliable, volatile) with ROS 2's depth of 10
THREAD = "ROS 2"  # command_line.main does not wait for a thread of this name
QUEUE = 5_000  # samples that wait to be published
FLOOD = 512  # commands of a thruster between two looks, one of which comes every 20 ms
LARGEST = 65_536  # bytes of a message that is taken
ATTACHMENT = struct.Struct("<qqB16s")  # of rmw_zenoh: sequence number, time of sending [ns], bytes of the id, the id
DRIFT = 5e-4  # s/s between two clocks at most: as fast as NTP moves one
# Wall seconds.
WAIT_S, RETRY_S, CONNECTED_S, END_S = 0.05, 1.0, 0.5, 1.0
_ROS2 = "live ROS 2 needs the packages eclipse-zenoh and rosbags: pip install 'seatrial[ros2]'"


class ReceivedCommand(NamedTuple):
    """A command of a thruster as it was received."""

    n: float  # NaN if it was no Float64
    sender: bytes  # unique id of the publisher; empty without a whole attachment
    sent: float = NAN  # s, by the sender's clock; NaN without a whole attachment
    number: int = 0  # sequence number of the publisher, from 1 on; 0 without a whole attachment


class LateCommands:
    """Finds commands that were under way for too long: a congested link delivers all of them, seconds late.

    The clocks of two computers may differ by anything, so a command is compared with the quickest of its sender.
    """

    def __init__(self, allowed_s: float) -> None:
        self._allowed = allowed_s
        self._least: dict[bytes, tuple[float, float]] = {}  # difference of the clocks and the way, and when [s]
        self.number = 0

    def is_late(self, command: ReceivedCommand, now: float) -> bool:
        """Whether it took longer than the quickest by more than is allowed; `now` of any clock that is never set."""
        if not math.isfinite(command.sent):
            return False
        took = now - command.sent
        least, at = self._least.get(command.sender, (took, now))
        least = min(took, least + DRIFT * (now - at))
        self._least[command.sender] = least, now
        late = took - least > self._allowed
        self.number += late
        return late


class Ros2Node:
    """Publishes the samples that `put` is given, and takes commands for `thrusters`, while in the `with` block.

    Without a router it tries again every second: nobody waits for it, and what cannot be published is counted.
    """

    def __init__(self, rig: Rig, thrusters: Sequence[str] = ()) -> None:
        self._ros2, self._thrusters = rig.ros2, thrusters
        self._queue: deque[StreamedSample] = deque()
        self._filled, self._ending = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name=THREAD, daemon=True)
        self._session: Any = None
        self._entities = itertools.count(1)
        self._tokens: list[Any] = []
        self._publishers: dict[str, _Publisher] = {}
        self._subscribers: dict[str, Any] = {}
        self._late = LateCommands(rig.ros2.timeout_s)
        self._lost = self._dropped_before = 0  # by us, and in the acquisition
        self.published = 0  # messages
        self.connected = False

    def __enter__(self) -> Ros2Node:
        """Start to connect. Raises SeatrialError where a package is missing."""
        try:
            import zenoh

            self._zenoh, self._types = zenoh, ros_types()
        except ModuleNotFoundError as error:
            raise SeatrialError(_ROS2) from error
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ending.set()
        self._filled.set()
        # Zenoh waits for half a minute where the router hangs or the network was cut; the program's end does not.
        self._thread.join(END_S)

    def put(self, samples: Sequence[StreamedSample], dropped: int) -> None:
        """Queue samples to be published; never waits. `dropped`: samples that were lost before, in all."""
        self._dropped_before = dropped
        room = max(QUEUE - len(self._queue), 0)
        self._queue.extend(samples[:room])
        self._lost += len(samples[room:])
        self._filled.set()

    def take(self) -> Mapping[str, Sequence[ReceivedCommand]]:
        """The commands since the last call by thruster, oldest first, the newest FLOOD at most; never waits.

        Late ones are left out, so that a link that only delivers late is silence; but a flood is told as it came.
        """
        found: dict[str, list[ReceivedCommand]] = {name: [] for name in self._thrusters}
        for name, subscriber in list(self._subscribers.items()):
            received = []
            with contextlib.suppress(self._zenoh.ZError):  # the session was closed: no command is silence
                for _ in range(FLOOD):
                    if (sample := subscriber.handler.try_recv()) is None:
                        break
                    received.append(_command(sample))
            now = time.monotonic()
            in_time = [command for command in received if not self._late.is_late(command, now)]
            found[name] = received if len(received) >= FLOOD else in_time
        return found

    def summary(self) -> str:
        """One line: where, and what was and was not published."""
        dropped = self._lost + self._dropped_before + len(self._queue)
        lost = f"; {counted(dropped, 'sample')} could not be published" if dropped else ""
        late = f"; {counted(self._late.number, 'command')} came too late to be followed" if self._late.number else ""
        where = f"ROS 2, domain {self._ros2.domain} at {self._ros2.router}"
        return f"{where}: {counted(self.published, 'message')}{lost}{late}"

    def await_router(self, seconds: float) -> str:
        """Wait for the router; one line that says whether it is there."""
        deadline = time.monotonic() + seconds
        while not self.connected and time.monotonic() < deadline:
            time.sleep(WAIT_S)
        there = "is there" if self.connected else "is not there: it is tried again every second"
        return f"ROS 2, domain {self._ros2.domain}: the router {self._ros2.router} {there}"

    # The thread ------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._ending.is_set():
            try:
                with contextlib.closing(self._zenoh.open(self._zenoh.Config.from_json5(self._config()))) as session:
                    self._session = session
                    self._declare()
                    self._discard()
                    self._publish_all()
            except self._zenoh.ZError:
                self.connected = False
                self._ending.wait(RETRY_S)

    def _config(self) -> str:
        return json.dumps({
            "mode": "client",
            "connect": {"endpoints": [self._ros2.router], "timeout_ms": 0},
            "listen": {"endpoints": []},
            "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
            "transport": {"link": {"rx": {"max_message_size": LARGEST}}},
        })  # fmt: skip

    def _declare(self) -> None:
        self._tokens, self._publishers = [], {}
        self._token("NN", 0)
        for name in self._thrusters:
            topic = self._topic(f"/thrusters/{name}/command")
            # ROS 2 Humble has no type hashes: whatever stands in their place is taken.
            key = f"{self._ros2.domain}{topic}/{_dds(COMMAND)}/*"
            self._subscribers[name] = self._session.declare_subscriber(key, self._zenoh.handlers.RingChannel(FLOOD))
            self._token("MS", next(self._entities), topic, COMMAND)

    def _token(self, kind: str, entity: int, topic: str = "", type_name: str = "") -> str:
        """Declare a node or an endpoint to the graph of ROS 2; returns its key expression."""
        space = self._ros2.namespace and f"/{self._ros2.namespace}"
        parts = ["@ros2_lv", str(self._ros2.domain), str(self._session.info.zid()), "0", str(entity), kind]
        parts += ["%", space.replace("/", "%") or "%", NODE]
        if topic:
            parts += [topic.replace("/", "%"), _dds(type_name), self._types.hash_rihs01(type_name), QOS]
        key = "/".join(parts)
        self._tokens.append(self._session.liveliness().declare_token(key))
        return key

    def _topic(self, topic: str) -> str:
        return f"/{self._ros2.namespace}{topic}" if self._ros2.namespace else topic

    def _publish_all(self) -> None:
        look_at = 0.0
        while not self._ending.is_set():
            if (now := time.monotonic()) >= look_at:
                look_at, self.connected = now + CONNECTED_S, bool(self._session.info.routers_zid())
            if not self.connected:
                self._discard()
            while self._queue and not self._ending.is_set():
                self._publish(self._queue.popleft())
            self._filled.wait(WAIT_S)
            self._filled.clear()

    def _discard(self) -> None:
        """What there is no router for is old when there is one."""
        with contextlib.suppress(IndexError):
            while True:
                self._queue.popleft()
                self._lost += 1

    def _publish(self, one: StreamedSample) -> None:
        found = schema.messages(one.device, Frame(one.sample, one.t, NAN))
        if isinstance(one.sample, Ahrs):
            found.append(rep_103_imu(one.device, one.sample))
        for message in found:
            if message.topic not in self._publishers:
                self._publishers[message.topic] = self._publisher(message.topic, message.type_name)
            self._publishers[message.topic].send(message.pack(round(one.t * NANO)))
            self.published += 1

    def _publisher(self, topic: str, type_name: str) -> _Publisher:
        name = self._topic(ros_topic(topic))
        token = self._token("MP", next(self._entities), name, type_name)
        key = f"{self._ros2.domain}{name}/{_dds(type_name)}/{self._types.hash_rihs01(type_name)}"
        # BLOCK: a router that hangs holds up this thread alone, and what is lost is lost in our queue, where it counts.
        control = self._zenoh.CongestionControl.BLOCK
        return _Publisher(self._session.declare_publisher(key, congestion_control=control), token)


class _Publisher:
    """A publisher with rmw_zenoh's attachment: sequence number, time of sending [ns], and a unique id of 16 bytes."""

    def __init__(self, publisher: Any, token: str) -> None:
        self._publisher, self._numbers = publisher, itertools.count(1)
        self._gid = hashlib.blake2b(token.encode(), digest_size=16).digest()

    def send(self, data: bytes) -> None:
        about = ATTACHMENT.pack(next(self._numbers), time.time_ns(), len(self._gid), self._gid)
        self._publisher.put(data, attachment=about)


def _dds(type_name: str) -> str:
    """The name of a type in DDS, as rosidl makes it."""
    package, _, name = type_name.split("/")
    return f"{package}::msg::dds_::{name}_"


def _command(sample: Any) -> ReceivedCommand:
    """Decode a sample: Float64 in CDR, with the attachment of rmw_zenoh."""
    data = sample.payload.to_bytes()
    about = b"" if sample.attachment is None else sample.attachment.to_bytes()
    sender, sent, number = b"", NAN, 0
    # Only a whole attachment names its sender: two senders with parts of one could not be told from each other.
    if len(about) == ATTACHMENT.size:
        number, sent_ns, length, gid = ATTACHMENT.unpack(about)
        if length == len(gid) and number > 0:
            sender, sent = gid, sent_ns / NANO
        else:
            number = 0
    if len(data) != 12 or data[0] != 0 or data[1] > 1:  # the encapsulation of CDR, either end first
        return ReceivedCommand(NAN, sender, sent, number)
    return ReceivedCommand(struct.unpack("<d" if data[1] else ">d", data[4:])[0], sender, sent, number)
