"""MAVLink, one autopilot on a link: bytes -> AHRS, GNSS, outputs, ESCs, battery, state and texts."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from daq.protocol.framing import StreamDecoder
from daq.protocol.mavlink_samples import Samples
from daq.protocol.mavlink_wire import ESC_STATUS, Codec, dialect, head, is_known, is_whole
from daq.samples import Frame

if TYPE_CHECKING:
    from daq.rig import Device, Rig

# Beside what becomes a sample: what whoever runs the link has to hear.
SERVICE = (
    *("HEARTBEAT", "COMMAND_ACK", "PARAM_VALUE", "STATUSTEXT", "EKF_STATUS_REPORT"),
    *("RC_CHANNELS_OVERRIDE", "COMMAND_LONG", "PARAM_REQUEST_READ", "PARAM_REQUEST_LIST", "PARAM_SET"),
)


class Decoder(StreamDecoder[Frame]):
    """Frames of one system and component -> samples; `listener` gets every decoded message of it.

    Messages of any other system are counted in `foreign` and left alone, as are unsigned and wrongly signed ones
    (`unsigned`) where there is a key. Frames of messages that are not in the dialect count as frames.
    """

    sync = re.compile(rb"[\xfd\xfe]")
    between = b""
    unordered = True  # a fix is older than the attitude sent before it: device times of all kinds need not ascend

    def __init__(self, samples: Samples, system: int = 1, component: int = 1, codec: Codec | None = None) -> None:
        super().__init__()
        self.foreign: dict[int, int] = {}  # frames of other systems
        self.unsigned = 0
        self.listener: Callable[[Any], None] | None = None
        self._samples, self._who = samples, (system, component)
        self._codec = codec or Codec(255, 190)
        self._ids: dict[int, bool] = {}  # whether a message is of use

    def secure(self, codec: Codec) -> None:
        """Decode, and check signatures, by this codec from now on."""
        self._codec = codec

    def reset(self) -> None:
        """Forget a half-read frame and what was heard (the port was reopened). Counters stay."""
        super().reset()
        self._samples.forget()

    def _take(self, buffer: bytearray, start: int, t_rx: float) -> int:
        found = head(buffer, start)
        if isinstance(found, int):
            return found
        if len(buffer) < start + found.total:
            return 0
        frame = bytes(buffer[start : start + found.total])
        if not is_whole(frame, found):
            self.checksum_errors += is_known(found.message_id)
            return -1
        self.frames += 1
        if (found.system, found.component) != self._who:
            if found.system != self._who[0]:
                self.foreign[found.system] = self.foreign.get(found.system, 0) + 1
        elif self._is_of_use(found.message_id):
            self._decode(frame, t_rx)
        return found.total

    def _is_of_use(self, message_id: int) -> bool:
        use = self._ids.get(message_id)
        if use is None:
            use = self._ids[message_id] = message_name(message_id) in {*self._samples.wanted, *SERVICE}
        return use

    def _decode(self, frame: bytes, t_rx: float) -> None:
        message = self._codec.decode(frame)
        if message is None:
            self.unsigned += 1
            return
        self._out += [Frame(sample, t_rx, t) for sample, t in self._samples.take(message)]
        if self.listener is not None:
            self.listener(message)


def message_name(message_id: int) -> str:
    """The name of a message; empty for one that is not in the dialect."""
    if message_id == ESC_STATUS:
        return "ESC_STATUS"
    kind = dialect().mavlink_map.get(message_id)
    return "" if kind is None else str(kind.msgname)


def make_samples(device: Device, rig: Rig) -> Samples:
    """The sample maker for a device of the rig."""
    here = [thruster for thruster in rig.thrusters if thruster.device == device.name]
    outputs = {thruster.node: thruster.output for thruster in here if thruster.output is not None}
    reversed_nodes = frozenset(thruster.node for thruster in here if thruster.reversed)
    gnss = device.mavlink.gnss if device.mavlink is not None else "raw"
    return Samples(outputs or None, reversed_nodes, gnss)


def make_decoder(device: Device, rig: Rig) -> Decoder:
    """The decoder for a device of the rig, without a key: whoever runs the link gives it one by `secure`."""
    assert device.mavlink is not None
    return Decoder(make_samples(device, rig), device.mavlink.system_id, device.mavlink.component_id)
