"""Schedule of the set-points on one bus: which are due, and which to repeat. Reads no clock.

Thread-safe: the control thread appends and zeroes, the port's thread takes those that are due.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

REPEAT_S = 0.020  # wall
ZERO_FOR_S = 0.5  # wall; zero is repeated for so long, since one frame may be lost


class Due(NamedTuple):
    """One frame to send. `fresh` is False for a repetition."""

    node: int
    n: float
    fresh: bool


class Setpoints:
    """A schedule of rows (run time, {node: n}) and the set-points that hold now."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._rows: deque[tuple[float, dict[int, float]]] = deque()
        self._held: dict[int, float] = {}
        self._zeroed: set[int] = set()  # nodes to command zero at once
        self._next_repeat = -math.inf
        self._repeat_until = -math.inf
        self._unwritten = False  # what `due` gave last may be on its way still
        # Set-points that were overtaken by a later one before they could be sent: this thread was held up, and an old
        # command must never follow a newer one. It is counted and reported.
        self.skipped = 0

    def append(self, rows: Iterable[tuple[float, dict[int, float]]]) -> None:
        """Add set-points; rows may come in any order of time."""
        with self._lock:
            merged = [*self._rows, *((t, dict(row)) for t, row in rows)]
            merged.sort(key=lambda item: item[0])  # stable: of two rows at one time the later appended one counts
            self._rows = deque(merged)

    def zero(self, now_wall: float) -> None:
        """Clear the schedule; zero is sent at once, and for a while, to every thruster that ever had a command."""
        with self._lock:
            self._rows.clear()
            self._held = dict.fromkeys(self._held, 0.0)
            self._zeroed = set(self._held)
            self._repeat_until = now_wall + ZERO_FOR_S

    @property
    def active(self) -> bool:
        """Whether thrust is commanded, or will be."""
        with self._lock:
            return self._active()

    def is_settled(self, now_wall: float) -> bool:
        """Whether no thrust is commanded, and zero has been written and repeated for as long as it should."""
        with self._lock:
            waiting = bool(self._zeroed) or self._unwritten or now_wall < self._repeat_until
            return not self._active() and not (self._held and waiting)

    @property
    def pending(self) -> int:
        """Rows that have not been sent."""
        return len(self._rows)

    @property
    def held(self) -> dict[int, float]:
        """The last command of each node."""
        with self._lock:
            return dict(self._held)

    def due(self, now_run: float, now_wall: float) -> list[Due]:
        """What to send now; the schedule moves on."""
        with self._lock:
            fresh: dict[int, float] = dict.fromkeys(self._zeroed, 0.0)
            self._zeroed = set()
            due_at: dict[int, float] = {}
            while self._rows and self._rows[0][0] <= now_run:
                t, row = self._rows.popleft()
                self.skipped += sum(due_at.get(node, t) < t for node in row)  # of equal times the later one replaces
                due_at |= dict.fromkeys(row, t)
                fresh |= row
            self._held |= fresh
            if fresh or self._active():
                self._repeat_until = now_wall + ZERO_FOR_S
            out = [Due(node, n, True) for node, n in fresh.items()]
            if now_wall >= self._next_repeat and now_wall < self._repeat_until:
                out += [Due(node, n, False) for node, n in self._held.items() if node not in fresh]
                self._next_repeat = now_wall + REPEAT_S
            self._unwritten = bool(out)
            return out

    def written(self) -> None:
        """What `due` gave last has left this process."""
        with self._lock:
            self._unwritten = False

    def wait(self, now_run: float, now_wall: float, speed: float) -> float:
        """Wall seconds until something may be due; infinite when nothing is."""
        with self._lock:
            if self._zeroed:
                return 0.0
            row = (self._rows[0][0] - now_run) / speed if self._rows else math.inf
            repeat = self._next_repeat - now_wall if self._held and now_wall < self._repeat_until else math.inf
            return max(min(row, repeat), 0.0)

    def _active(self) -> bool:
        return bool(self._rows) or any(n != 0.0 for n in self._held.values())
