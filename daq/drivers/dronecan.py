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
    """Driver of all DroneCAN speed controllers on one CAN bus.

    Each message contains a command for every controller in `nodes`: its newest set-point, or zero if it has none.
    Nothing is sent before the first command, also no NodeStatus, so that a program that only logs sends nothing. A
    NodeStatus is sent only together with commands.

    Parameters
    ----------
    nodes
        Numbers of the controllers, 0..19.
    reversed_nodes
        Numbers of the controllers whose commands change their sign.
    own_node
        Number of this program on the bus, 1..127.
    """

    def __init__(self, nodes: frozenset[int], reversed_nodes: frozenset[int], own_node: int) -> None:
        """Store the numbers of the controllers, of the reversed ones, and of this program. Nothing is sent."""
        self._nodes, self._reversed, self._own = nodes, reversed_nodes, own_node
        self._commands = self._statuses = 0  # number of transfers so far
        self._started = self._status_at = -1.0  # wall time [s] of the first and of the last NodeStatus

    def command(self, dues: Sequence[Due], held: Mapping[int, float], now: float) -> list[tuple[bytes, list[Due]]]:
        """Encode one DroneCAN message (esc.RawCommand) with the commands of all controllers of the bus.

        A NodeStatus precedes it if one is due (each second). `dues` are the set-points to send now, `held` are the
        present commands, -1..1, by controller, and `now` is wall time [s]. A controller without a command gets zero.
        The list has one pair: the bytes of the CAN frames, and the set-points `dues` that they contain. ValueError is
        raised if a command or a number of a controller is out of its range.
        """
        setpoints = {**dict.fromkeys(self._nodes, 0.0), **held, **{due.node: due.n for due in dues}}
        return [(self._node_status_if_due(now) + self._encode_command(setpoints), list(dues))]

    def zero(self, now: float) -> list[tuple[bytes, list[Due]]]:
        """Encode the command zero for all controllers of the bus: one message, with an empty list of set-points.

        No NodeStatus precedes it. `now` is not used.
        """
        return [(self._encode_command(dict.fromkeys(self._nodes, 0.0)), [])]

    def _encode_command(self, setpoints: Mapping[int, float]) -> bytes:
        """Encode a DroneCAN esc.RawCommand, as bytes of CAN frames, from the commands, -1..1, by controller number.

        The command of a reversed controller changes its sign. Each call increases the transfer number.
        """
        signed = {node: -n if node in self._reversed else n for node, n in setpoints.items()}
        number, self._commands = self._commands % NUMBERS, self._commands + 1
        return b"".join(pack_can(*frame) for frame in dronecan.encode_command(signed, self._own, number))

    def _node_status_if_due(self, now: float) -> bytes:
        """Return the CAN frames of a NodeStatus, which this program must send each second; no bytes if it is not due.

        The first one is due at once. Its uptime counts from the first one. `now` is wall time [s].
        """
        if self._statuses and now < self._status_at + STATUS_S:
            return b""
        self._started = now if not self._statuses else self._started
        number, self._statuses, self._status_at = self._statuses % NUMBERS, self._statuses + 1, now
        frames = dronecan.encode_node_status(now - self._started, self._own, number)
        return b"".join(pack_can(*frame) for frame in frames)
