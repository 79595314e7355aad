"""VESC speed controllers on CAN: decoder of status frames to `Esc`, and encoder of duty commands.

Source: vedderb/bldc, documentation/comm_can.md. Identifiers have 29 bits: packet << 8 | controller. The file vesc.dbc
defines the signals. The log contains CAN frames as 16-byte `struct can_frame` of SocketCAN, which `Decoder.feed` reads.
"""

from __future__ import annotations

import functools
import math
from pathlib import Path
from typing import Any

from seatrial.daq.protocol.canframe import CAN_FRAME, EXTENDED, FRAME_BYTES, FrameDecoder, pack_can, unpack_can
from seatrial.daq.samples import NAN, Esc, Frame

__all__ = ["CAN_FRAME", "EXTENDED", "FRAME_BYTES", "Decoder", "pack_can", "unpack_can"]

SET_DUTY, STATUS_1, STATUS_4, STATUS_5 = 0, 9, 16, 27  # packets: bits 8 to 15 of the identifier
STALE = 2.0  # s; temperature and voltage arrive in separate frames; older values become NaN in a sample


@functools.cache
def _dbc_messages() -> dict[int, Any]:
    """Return the definitions of the CAN messages of VESC controllers by packet number (bits 8 to 28 of the identifier).

    The definitions are objects of cantools, read from the file vesc.dbc at the first call.
    """
    import cantools  # imported here because the import is slow and only CAN needs it

    database = cantools.database.load_file(Path(__file__).with_name("vesc.dbc"))
    return {message.frame_id >> 8: message for message in database.messages}  # type: ignore[union-attr]


class Decoder(FrameDecoder):
    """Decoder of the status frames of VESC speed controllers to `Esc` samples.

    Each STATUS 1 frame gives one sample with its current, duty and rpm. Temperature (STATUS 4) and voltage (STATUS 5)
    are the newest received values, or NaN if they are older than 2 s (`STALE`). `t_device` is NaN. Status frames that
    are too short count as unparsed bytes. Other frames are ignored.

    Parameters
    ----------
    pole_pairs
        Number of pole pairs by controller id. Status frames of other controllers are counted in `other_nodes` and
        ignored.
    reversed_nodes
        Ids of the controllers whose rpm and duty change their sign, as their commands do, so that positive means
        forward.

    Attributes
    ----------
    other_nodes : dict of int to int
        Number of status frames by id of a controller that has no pole pairs; `remark` names these controllers.
    """

    def __init__(self, pole_pairs: dict[int, int], reversed_nodes: frozenset[int] = frozenset()) -> None:
        """Start without received frames.

        `pole_pairs` are the numbers of pole pairs by controller id. `reversed_nodes` are the ids of the controllers
        whose rpm and duty change their sign.
        """
        super().__init__()
        _dbc_messages()  # loads the DBC file now, because loading it at the first frame would delay the port's thread
        self.other_nodes: dict[int, int] = {}
        self._pole_pairs = dict(pole_pairs)
        self._reversed = reversed_nodes
        self._temperature: dict[int, tuple[float, float]] = {}  # node -> (value, t_rx)
        self._voltage: dict[int, tuple[float, float]] = {}

    def _decode_can_frame(self, identifier: int, extended: bool, data: bytes, t_rx: float) -> list[Frame]:
        """Decode one CAN frame. Return the sample of a STATUS 1 frame of a VESC controller.

        The list is empty for other frames. The values of STATUS 4 and 5 are stored for the next STATUS 1. A frame with
        an 11-bit identifier is ignored.
        """
        return self.feed_frame(identifier, data, t_rx) if extended else []

    def feed_frame(self, arbitration_id: int, data: bytes, t_rx: float) -> list[Frame]:
        """Decode one CAN frame with a 29-bit identifier that was received at run time `t_rx` [s].

        Return the sample of a STATUS 1 frame, in a list. Other frames give no sample; the values of STATUS 4 and 5 are
        stored. Status frames of controllers without known pole pairs are counted in `other_nodes` and ignored. A status
        frame that is too short counts as unparsed bytes.
        """
        node, packet = arbitration_id & 0xFF, arbitration_id >> 8
        if packet not in (STATUS_1, STATUS_4, STATUS_5):
            return []
        message = _dbc_messages()[packet]
        if len(data) < message.length - 2 * (packet == STATUS_5):  # STATUS 5 was 6 bytes in older firmware
            self.unparsed_bytes += FRAME_BYTES
            return []
        self.frames += 1
        if node not in self._pole_pairs:
            self.other_nodes[node] = self.other_nodes.get(node, 0) + 1
            if self.other_nodes[node] == 1:
                nodes = ", ".join(str(number) for number in sorted(self.other_nodes))
                self.remark = (
                    f"frames of node {nodes} are ignored, because no thruster of the rig has it; correct `node` if one "
                    "is yours"
                )
            return []
        values = message.decode(data.ljust(8, b"\0"), decode_choices=False)
        if packet == STATUS_4:
            self._temperature[node] = (float(values["temperature"]), t_rx)
        elif packet == STATUS_5:
            self._voltage[node] = (float(values["voltage"]), t_rx)
        else:
            return [Frame(self._esc_sample(node, values, t_rx), t_rx, NAN)]
        return []

    def _forget_state(self) -> None:
        """Discard the newest temperatures and voltages of all controllers, because the port was reopened."""
        self._temperature.clear()
        self._voltage.clear()

    def _esc_sample(self, node: int, values: dict[str, float], t_rx: float) -> Esc:
        """Return the state of controller `node` from the signals of its STATUS 1 frame (`values`, by name).

        Its newest temperature and voltage are added; they are NaN if they are older than 2 s at run time `t_rx` [s].
        The rpm of the message is divided by the pole pairs. Rpm and duty of a reversed controller change their sign.
        """
        sign = -1.0 if node in self._reversed else 1.0
        return Esc(
            node=node,
            rpm=sign * values["erpm"] / self._pole_pairs[node],
            current=float(values["current"]),
            duty=sign * values["duty"],
            voltage=_value_if_fresh(self._voltage.get(node), t_rx),
            temperature=_value_if_fresh(self._temperature.get(node), t_rx),
        )


def _value_if_fresh(latest: tuple[float, float] | None, t_rx: float) -> float:
    """Return the value of a pair (value, run time [s]), unless it is older than 2 s (STALE) at run time `t_rx` [s].

    NaN is returned for an older value and for None.
    """
    return latest[0] if latest is not None and t_rx - latest[1] <= STALE else NAN


def encode_status(esc: Esc, pole_pairs: int) -> list[tuple[int, bytes]]:
    """Encode the state of a VESC controller as CAN frames.

    Parameters
    ----------
    esc
        State of the controller.
    pole_pairs
        Number of pole pairs, by which the rpm is multiplied. No sign is changed for a reversed thruster.

    Returns
    -------
    list of tuple of int and bytes
        Identifier (29 bits) and data of each frame. STATUS 1 is always included, with 0 for NaN. STATUS 4 is included
        if the temperature is not NaN, and STATUS 5 if the voltage is not NaN.
    """
    frames = [
        _encode_packet(STATUS_1, esc.node, erpm=_or_zero(esc.rpm) * pole_pairs, current=esc.current, duty=esc.duty)
    ]
    if not math.isnan(esc.temperature):
        frames.append(
            _encode_packet(
                STATUS_4,
                esc.node,
                temperature=esc.temperature,
                temperature_motor=-38.0,
                current_in=0.0,
                pid_position=0.0,
            )
        )
    if not math.isnan(esc.voltage):
        frames.append(_encode_packet(STATUS_5, esc.node, tachometer=0.0, voltage=esc.voltage))
    return frames


def encode_duty(node: int, n: float) -> tuple[int, bytes]:
    """Encode the command of duty `n`, -1..1, to the controller with id `node` as a CAN frame (identifier, data).

    Raises
    ------
    ValueError
        If `n` is outside -1..1, or NaN.
    """
    if not -1.0 <= n <= 1.0:
        raise ValueError(f"a duty is between -1 and 1, not {n}")
    return _encode_packet(SET_DUTY, node, duty=n)


def decode_command(arbitration_id: int, data: bytes) -> tuple[int, float] | None:
    """Return controller id and duty, -1..1, of a CAN frame that commands a VESC controller.

    Only commands of duty (SET_DUTY) count. The duty is not clipped to -1..1. Return None for other frames, and for one
    with fewer than 4 bytes of data.
    """
    if arbitration_id >> 8 != SET_DUTY or len(data) < 4:
        return None
    return arbitration_id & 0xFF, float(_dbc_messages()[SET_DUTY].decode(data[:4])["duty"])


def _encode_packet(packet: int, node: int, **values: float) -> tuple[int, bytes]:
    """Encode one packet of the VESC controller `node` as a CAN frame (identifier, data).

    `packet` is its number, for example STATUS_1. `values` are those of all its signals, by name. They are clipped to
    the range of their signals; NaN becomes 0.
    """
    message = _dbc_messages()[packet]
    clipped = {}
    for signal in message.signals:
        limit = (1 << signal.length - 1) - 1
        clipped[signal.name] = min(max(_or_zero(values[signal.name]), -limit * signal.scale), limit * signal.scale)
    return packet << 8 | node, bytes(message.encode(clipped, strict=False)).ljust(message.length, b"\0")


def _or_zero(value: float) -> float:
    """Return a number unchanged, and 0 for NaN."""
    return 0.0 if math.isnan(value) else value
