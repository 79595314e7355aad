"""Driver of DroneCAN speed controllers. It encodes one esc.RawCommand for all controllers, and NodeStatus. No I/O."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import final

from seatrial.daq.drivers.base import DeviceDriver
from seatrial.daq.drivers.setpoints import Due
from seatrial.daq.protocol import NUMBERS, dronecan, pack_can

STATUS_S = 1.0  # s between two NodeStatus, by the specification


@final
class DronecanDriver(DeviceDriver):
    """Driver of all DroneCAN controllers on one bus.

    Each command contains the newest set-point of every controller in `nodes`, and zero for controllers without a
    set-point. Nothing is sent before the first command, so that a program that only logs sends nothing.

    Parameters
    ----------
    nodes
        Nodes (indices, 0..19) of the controllers.
    reversed_nodes
        Nodes whose commands change their sign.
    own_node
        Node of this program on the bus, 1..127.
    """

    def __init__(self, nodes: frozenset[int], reversed_nodes: frozenset[int], own_node: int) -> None:
        self._nodes, self._reversed, self._own = nodes, reversed_nodes, own_node
        self._commands = self._statuses = 0  # number of transfers so far
        self._started = self._status_at = -1.0  # wall time [s] of the first and of the last NodeStatus

    def command(self, dues: Sequence[Due], held: Mapping[int, float], now: float) -> list[tuple[bytes, list[Due]]]:
        """Encode one message with the set-points of all controllers, after a NodeStatus if it is due."""
        setpoints = {**dict.fromkeys(self._nodes, 0.0), **held, **{due.node: due.n for due in dues}}
        return [(self._node_status_if_due(now) + self._encode_command(setpoints), list(dues))]

    def zero(self, now: float) -> list[tuple[bytes, list[Due]]]:
        """Encode zero for all controllers of the bus, as one message without set-points."""
        return [(self._encode_command(dict.fromkeys(self._nodes, 0.0)), [])]

    def _encode_command(self, setpoints: Mapping[int, float]) -> bytes:
        """Encode an esc.RawCommand from commands, -1..1, by node. The sign of reversed nodes is changed."""
        signed = {node: -n if node in self._reversed else n for node, n in setpoints.items()}
        number, self._commands = self._commands % NUMBERS, self._commands + 1
        return b"".join(pack_can(*frame) for frame in dronecan.encode_command(signed, self._own, number))

    def _node_status_if_due(self, now: float) -> bytes:
        """Return the bytes of a NodeStatus if it is due at wall time `now` [s], else no bytes."""
        if self._statuses and now < self._status_at + STATUS_S:
            return b""
        self._started = now if not self._statuses else self._started
        number, self._statuses, self._status_at = self._statuses % NUMBERS, self._statuses + 1, now
        frames = dronecan.encode_node_status(now - self._started, self._own, number)
        return b"".join(pack_can(*frame) for frame in frames)
