"""Live ROS 2 node without an installation of ROS, over the Zenoh router of the rig file (extra `ros2`).

ROS 2 nodes with rmw_zenoh can see this node. Key expressions, liveliness tokens and attachments follow the design of
rmw_zenoh (github.com/ros2/rmw_zenoh, docs/design.md); type hashes follow REP-2016. The reason for Zenoh is in
docs/decisions/0026-ros-2-over-zenoh.md. The node is a client of the router: it opens no port and searches for no other
nodes. It runs in the process that shows the live table, never in the process that records.
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

NODE_NAME = "seatrial"
COMMAND_TYPE = "std_msgs/msg/Float64"
QOS = "::,10:,:,:,,"  # defaults of rmw_zenoh (reliable, volatile) with the depth 10 of ROS 2
THREAD_NAME = "ROS 2"  # command_line.main does not wait for a thread of this name
QUEUE_SAMPLES = 5_000  # largest number of samples that wait for publication
FLOOD = 512  # largest number of commands of a thruster between two calls of `take`, which happen every 20 ms
MAX_MESSAGE_BYTES = 65_536  # bytes; larger messages are not received
ATTACHMENT = struct.Struct("<qqB16s")  # of rmw_zenoh: sequence number, time of sending [ns], bytes of the id, the id
MAX_CLOCK_DRIFT = 5e-4  # s/s, largest drift between two clocks: NTP changes the rate of a clock at most so much
# s of wall time: waiting for samples, between two connections, between two checks of the router, for the end.
WAIT_S, RETRY_S, CONNECTED_S, END_S = 0.05, 1.0, 0.5, 1.0
_ROS2 = "live ROS 2 needs the packages eclipse-zenoh and rosbags: pip install 'seatrial[ros2]'"


class ReceivedCommand(NamedTuple):
    """Command of a thruster that was received by ROS 2, with the attachment that rmw_zenoh adds to a message.

    Attributes
    ----------
    n : float
        Normalised shaft speed (-1 to 1) as it was sent, also if it is out of range; NaN if the message was not a
        Float64.
    sender : bytes
        Unique id of the publisher; empty without a whole attachment.
    sent : float
        Time of sending by the clock of the sender [s]; NaN without a whole attachment.
    number : int
        Sequence number of the publisher, from 1 on; 0 without a whole attachment.
    """

    n: float  # normalised shaft speed; NaN if the message was not a Float64
    sender: bytes  # unique id of the publisher; empty without a whole attachment
    sent: float = NAN  # time of sending by the clock of the sender [s]; NaN without a whole attachment
    number: int = 0  # sequence number of the publisher, from 1 on; 0 without a whole attachment


class LateCommands:
    """Detector of ROS 2 commands that arrive too late. A congested link delivers all commands, but seconds late.

    The clocks of two computers may differ by any value. Therefore each command is compared with the fastest command of
    the same sender.

    Parameters
    ----------
    allowed_s
        Largest allowed delay after the fastest command [s].

    Attributes
    ----------
    number : int
        Number of late commands so far.
    """

    def __init__(self, allowed_s: float) -> None:
        """Begin without any command; `allowed_s` is the largest allowed delay after the fastest command [s]."""
        self._allowed = allowed_s
        # By sender: smallest difference of time of receipt and time of sending, which contains the difference of the
        # clocks; and the time of the last update [s].
        self._least: dict[bytes, tuple[float, float]] = {}
        self.number = 0  # of late commands

    def is_late(self, command: ReceivedCommand, now: float) -> bool:
        """Return whether a command of a thruster arrived too late, and count late commands in `number`.

        A command is late if its delay exceeds that of the fastest earlier command of the same sender by more than the
        allowed delay. The first command of a sender, and a command without a time of sending, are never late. The
        clocks of sender and receiver may drift by 0.05 %: the delay of the fastest command, with which others are
        compared, grows by this part of the time.

        Parameters
        ----------
        command
            The command.
        now
            Time of receipt [s] of a monotonic clock.
        """
        if not math.isfinite(command.sent):
            return False
        difference = now - command.sent
        least, at = self._least.get(command.sender, (difference, now))
        least = min(difference, least + MAX_CLOCK_DRIFT * (now - at))
        self._least[command.sender] = least, now
        late = difference - least > self._allowed
        self.number += late
        return late


class Ros2Node:
    """ROS 2 node that publishes live samples and receives commands of thrusters, within a `with` block.

    `put` adds samples and `take` returns commands. Without a router the node tries to connect every second. Callers
    never wait for the router. Samples that cannot be published are counted.

    Parameters
    ----------
    rig
        Rig with the address of the router, the domain and the namespace.
    thrusters
        Names of the thrusters whose commands are received.

    Attributes
    ----------
    published : int
        Number of messages published so far.
    connected : bool
        Whether the node is connected to the router.
    """

    def __init__(self, rig: Rig, thrusters: Sequence[str] = ()) -> None:
        """Prepare the ROS 2 node. It connects to the router at the beginning of the `with` block."""
        self._ros2, self._thrusters = rig.ros2, thrusters
        self._queue: deque[StreamedSample] = deque()
        self._filled, self._ending = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._connect_and_publish, name=THREAD_NAME, daemon=True)
        self._session: Any = None
        self._entities = itertools.count(1)
        self._tokens: list[Any] = []
        self._publishers: dict[str, _Publisher] = {}
        self._subscribers: dict[str, Any] = {}
        self._late = LateCommands(rig.ros2.timeout_s)
        self._lost = self._dropped_before = 0  # number of samples lost here, and in the acquisition
        self.published = 0  # number of messages
        self.connected = False

    def __enter__(self) -> Ros2Node:
        """Start the thread of the node that connects to the router.

        Raise SeatrialError if a package is not installed.
        """
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
        """End the thread of the ROS 2 node. Wait for it 1 s at most, because the router may hang."""
        self._ending.set()
        self._filled.set()
        # If the router hangs or the network is cut, Zenoh waits for half a minute. The program must not wait for it.
        self._thread.join(END_S)

    def put(self, samples: Sequence[StreamedSample], dropped: int) -> None:
        """Queue samples for publication by ROS 2. This never waits.

        Parameters
        ----------
        samples
            New samples. If the queue (at most 5000 samples) has no room for all, the last ones of them are lost.
        dropped
            Total number of samples that were lost before this queue, so far.
        """
        self._dropped_before = dropped
        room = max(QUEUE_SAMPLES - len(self._queue), 0)
        self._queue.extend(samples[:room])
        self._lost += len(samples[room:])
        self._filled.set()

    def take(self) -> Mapping[str, Sequence[ReceivedCommand]]:
        """Return the thruster commands received by ROS 2 since the last call, by thruster, in the order of receipt.

        This never waits. At most the newest `FLOOD` (512) commands of a thruster are returned. Late commands are left
        out: a link that delivers only late commands then counts as silent. If a thruster has `FLOOD` commands, however,
        its late commands are included, so that the caller can detect the flood. A thruster without a command has an
        empty list.
        """
        found: dict[str, list[ReceivedCommand]] = {name: [] for name in self._thrusters}
        for name, subscriber in list(self._subscribers.items()):
            received = []
            with contextlib.suppress(self._zenoh.ZError):  # the session is closed: the same as no command
                for _ in range(FLOOD):
                    if (sample := subscriber.handler.try_recv()) is None:
                        break
                    received.append(_decoded_command(sample))
            now = time.monotonic()
            in_time = [command for command in received if not self._late.is_late(command, now)]
            found[name] = received if len(received) >= FLOOD else in_time
        return found

    def summary(self) -> str:
        """Return one line about the ROS 2 node: its address, published messages, lost samples and late commands.

        Samples that were lost in the acquisition or in the queue, and those that still wait in it, count as lost. Lost
        samples and late commands are left out if there are none.
        """
        dropped = self._lost + self._dropped_before + len(self._queue)
        lost = f"; {counted(dropped, 'sample')} could not be published" if dropped else ""
        late = f"; {counted(self._late.number, 'command')} ignored because of late arrival" if self._late.number else ""
        where = f"ROS 2, domain {self._ros2.domain} at {self._ros2.router}"
        return f"{where}: {counted(self.published, 'message')}{lost}{late}"

    def await_router(self, seconds: float) -> str:
        """Wait for the connection of the ROS 2 node to its router, at most for `seconds` of wall time.

        Return one line for the user about whether the router is connected. A time-out is not an error.
        """
        deadline = time.monotonic() + seconds
        while not self.connected and time.monotonic() < deadline:
            time.sleep(WAIT_S)
        result = (
            "is connected"
            if self.connected
            else "does not answer; start it (the connection is tried again every second)"
        )
        return f"ROS 2, domain {self._ros2.domain}: the router {self._ros2.router} {result}"

    # Methods of the thread -------------------------------------------------------------------------------------

    def _connect_and_publish(self) -> None:
        """Connect to the router, declare the ROS 2 node and publish samples until the `with` block ends.

        After an error of Zenoh connect again, one second later.
        """
        while not self._ending.is_set():
            try:
                with contextlib.closing(
                    self._zenoh.open(self._zenoh.Config.from_json5(self._zenoh_config()))
                ) as session:
                    self._session = session
                    self._declare_node()
                    self._discard_queue()
                    self._publish_all()
            except self._zenoh.ZError:
                self.connected = False
                self._ending.wait(RETRY_S)

    def _zenoh_config(self) -> str:
        """Return the configuration of Zenoh as JSON: a client of one router, without open ports and without discovery.

        The router is that of the rig file. Messages of more than 65,536 bytes are not received.
        """
        return json.dumps({
            "mode": "client",
            "connect": {"endpoints": [self._ros2.router], "timeout_ms": 0},
            "listen": {"endpoints": []},
            "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
            "transport": {"link": {"rx": {"max_message_size": MAX_MESSAGE_BYTES}}},
        })  # fmt: skip

    def _declare_node(self) -> None:
        """Declare the node to ROS 2 in a new session, and subscribe to the commands of the thrusters.

        The topic of a command is /thrusters/NAME/command (Float64), after the namespace of the rig.
        """
        self._tokens, self._publishers = [], {}
        self._declare_token("NN", 0)
        for name in self._thrusters:
            topic = self._namespaced_topic(f"/thrusters/{name}/command")
            # ROS 2 Humble has no type hashes: accept any text in the place of the hash.
            key = f"{self._ros2.domain}{topic}/{_dds_type_name(COMMAND_TYPE)}/*"
            self._subscribers[name] = self._session.declare_subscriber(key, self._zenoh.handlers.RingChannel(FLOOD))
            self._declare_token("MS", next(self._entities), topic, COMMAND_TYPE)

    def _declare_token(self, kind: str, entity: int, topic: str = "", type_name: str = "") -> str:
        """Announce the node or an endpoint to the other ROS 2 nodes, and return its key expression of Zenoh.

        Parameters
        ----------
        kind
            NN for a node, MP for a publisher and MS for a subscription.
        entity
            Number of the endpoint in the node; 0 for the node.
        topic, type_name
            Topic and message type of an endpoint; empty for a node.
        """
        space = self._ros2.namespace and f"/{self._ros2.namespace}"
        parts = ["@ros2_lv", str(self._ros2.domain), str(self._session.info.zid()), "0", str(entity), kind]
        parts += ["%", space.replace("/", "%") or "%", NODE_NAME]
        if topic:
            parts += [topic.replace("/", "%"), _dds_type_name(type_name), self._types.hash_rihs01(type_name), QOS]
        key = "/".join(parts)
        self._tokens.append(self._session.liveliness().declare_token(key))
        return key

    def _namespaced_topic(self, topic: str) -> str:
        """Return the ROS 2 name of `topic`: the namespace of the rig file, if it has one, and then the topic."""
        return f"/{self._ros2.namespace}{topic}" if self._ros2.namespace else topic

    def _publish_all(self) -> None:
        """Publish queued samples to ROS 2 until the `with` block ends. Every 0.5 s check whether there is a router.

        While there is no router, queued samples are discarded and counted as lost.
        """
        check_at = 0.0
        while not self._ending.is_set():
            if (now := time.monotonic()) >= check_at:
                check_at, self.connected = now + CONNECTED_S, bool(self._session.info.routers_zid())
            if not self.connected:
                self._discard_queue()
            while self._queue and not self._ending.is_set():
                self._publish_sample(self._queue.popleft())
            self._filled.wait(WAIT_S)
            self._filled.clear()

    def _discard_queue(self) -> None:
        """Discard the samples that wait for ROS 2, and count them as lost: they are old when a router is connected."""
        with contextlib.suppress(IndexError):
            while True:
                self._queue.popleft()
                self._lost += 1

    def _publish_sample(self, streamed: StreamedSample) -> None:
        """Publish the messages of a sample to ROS 2; for an AHRS also the Imu message in the axes of REP-103.

        A publisher is declared at the first message of each topic, and used again for later ones.
        """
        messages = schema.messages(streamed.device, Frame(streamed.sample, streamed.t, NAN))
        if isinstance(streamed.sample, Ahrs):
            messages.append(rep_103_imu(streamed.device, streamed.sample))
        for message in messages:
            if message.topic not in self._publishers:
                self._publishers[message.topic] = self._publisher_of_topic(message.topic, message.type_name)
            self._publishers[message.topic].send(message.pack(round(streamed.t * NANO)))
            self.published += 1

    def _publisher_of_topic(self, topic: str, type_name: str) -> _Publisher:
        """Declare a ROS 2 publisher for a topic of the log and messages of a type, and return it.

        Its name in ROS 2 has the namespace of the rig file in front, and "node_" before each part that begins with a
        digit. If the router hangs, a message that is sent waits and is not dropped.
        """
        name = self._namespaced_topic(ros_topic(topic))
        token = self._declare_token("MP", next(self._entities), name, type_name)
        key = f"{self._ros2.domain}{name}/{_dds_type_name(type_name)}/{self._types.hash_rihs01(type_name)}"
        # BLOCK: a hanging router blocks only this thread. Samples are then lost in our queue, where they are counted.
        control = self._zenoh.CongestionControl.BLOCK
        return _Publisher(self._session.declare_publisher(key, congestion_control=control), token)


class _Publisher:
    """Publisher of one ROS 2 topic over Zenoh.

    It adds the attachment of rmw_zenoh to each message: sequence number, time of sending [ns], unique id of 16 bytes.
    """

    def __init__(self, publisher: Any, token: str) -> None:
        """Store the Zenoh publisher, and derive its unique id (a hash of 16 bytes) from its key expression `token`.

        The same token gives the same id. Sequence numbers start at 1.
        """
        self._publisher, self._numbers = publisher, itertools.count(1)
        self._gid = hashlib.blake2b(token.encode(), digest_size=16).digest()

    def send(self, data: bytes) -> None:
        """Publish a message, encoded in CDR, on the topic.

        Its attachment has the next sequence number, which starts at 1, and the present wall time.
        """
        attachment = ATTACHMENT.pack(next(self._numbers), time.time_ns(), len(self._gid), self._gid)
        self._publisher.put(data, attachment=attachment)


def _dds_type_name(type_name: str) -> str:
    """Return the DDS name of a ROS 2 message type, by the rule of rosidl.

    The name of "std_msgs/msg/Float64" is "std_msgs::msg::dds_::Float64_".
    """
    package, _, name = type_name.split("/")
    return f"{package}::msg::dds_::{name}_"


def _decoded_command(sample: Any) -> ReceivedCommand:
    """Decode a thruster command received by ROS 2: a Float64 in CDR, with the attachment of rmw_zenoh.

    A message of another form gives the value NaN. Without a whole attachment the sender is empty, the time of sending
    NaN and the number 0.
    """
    data = sample.payload.to_bytes()
    attachment = b"" if sample.attachment is None else sample.attachment.to_bytes()
    sender, sent, number = b"", NAN, 0
    # Only a whole attachment is used: partial ids of two senders could be equal.
    if len(attachment) == ATTACHMENT.size:
        number, sent_ns, length, gid = ATTACHMENT.unpack(attachment)
        if length == len(gid) and number > 0:
            sender, sent = gid, sent_ns / NANO
        else:
            number = 0
    if len(data) != 12 or data[0] != 0 or data[1] > 1:  # encapsulation of CDR: byte 1 is the byte order
        return ReceivedCommand(NAN, sender, sent, number)
    return ReceivedCommand(struct.unpack("<d" if data[1] else ">d", data[4:])[0], sender, sent, number)
