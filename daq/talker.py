"""What a port's thread says of its own accord, beside listening: set-points, requests, signs of life. Does no I/O."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import final

from daq.protocol import vesc
from daq.samples import Event
from daq.setpoints import Due
from daq.status import LinkStatus


class Talker(ABC):
    """The speaking half of one port. `now` is wall time of any origin; called from the port's thread alone."""

    @abstractmethod
    def command(self, dues: Sequence[Due], held: Mapping[int, float], now: float) -> list[tuple[bytes, list[Due]]]:
        """The bytes of set-points, with those that they carry; `held` is what every node holds now."""

    def opened(self, now: float) -> None:
        """The port was opened, for the first time or again."""
        return

    def poll(self, now: float) -> bytes:
        """What is to be sent now beside set-points."""
        return b""

    def wait(self, now: float) -> float:
        """Seconds until `poll` may have something."""
        return math.inf

    def request(self, wish: str, value: float) -> None:
        """A wish of whoever runs the experiment: `arm`, `disarm`, `mode`. Called from another thread."""
        return

    def farewell(self, now: float) -> bytes:
        """The last bytes before the port is closed for good, behind the last zero."""
        return b""

    def zero(self, now: float) -> list[tuple[bytes, list[Due]]]:
        """Zero to everything on the link, whatever was said before: the last resort."""
        return []

    def events(self) -> list[Event]:
        """What happened since the last call, for the log."""
        return []

    def link_at(self, now: float) -> LinkStatus | None:
        """What the other end is known to be; None where there is nobody to talk with."""
        return None

    def message(self) -> str:
        """What is wrong with the link, in one line; empty when nothing is."""
        return ""


@final
class VescTalker(Talker):
    """Duty commands, one frame a controller."""

    def __init__(self, reversed_nodes: frozenset[int]) -> None:
        self._reversed = reversed_nodes

    def command(self, dues: Sequence[Due], held: Mapping[int, float], now: float) -> list[tuple[bytes, list[Due]]]:
        """A frame for each."""
        out = []
        for due in dues:
            n = -due.n if due.node in self._reversed else due.n
            out.append((vesc.pack_can(*vesc.encode_duty(due.node, n)), [due]))
        return out
