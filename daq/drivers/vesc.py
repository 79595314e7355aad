"""Driver of VESC speed controllers on CAN. No I/O."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import final

from seatrial.daq.drivers.base import DeviceDriver
from seatrial.daq.drivers.setpoints import Due
from seatrial.daq.protocol import pack_can, vesc


@final
class VescDriver(DeviceDriver):
    """Driver of VESC speed controllers on a CAN bus. It encodes duty commands, one frame per controller.

    Parameters
    ----------
    reversed_nodes
        Numbers of the controllers on the bus whose commands change their sign.
    """

    def __init__(self, reversed_nodes: frozenset[int]) -> None:
        """Store the numbers of the controllers whose commands change their sign."""
        self._reversed = reversed_nodes

    def command(self, dues: Sequence[Due], held: Mapping[int, float], now: float) -> list[tuple[bytes, list[Due]]]:
        """Encode each set-point of `dues` as one CAN frame with a duty command, for one VESC controller.

        The sign changes for reversed controllers. `held` and `now` are not used. Each frame is returned with a list of
        its set-point, in the order of `dues`. ValueError is raised if a command is NaN or outside -1..1.
        """
        out = []
        for due in dues:
            n = -due.n if due.node in self._reversed else due.n
            out.append((pack_can(*vesc.encode_duty(due.node, n)), [due]))
        return out
