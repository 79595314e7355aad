"""Schedule of the set-points on one bus. It returns the set-points that are due and those to repeat. It reads no clock.

The schedule is thread-safe. The control thread appends set-points and sets zero. The thread of the port reads the
set-points that are due.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

REPEAT_S = 0.020  # wall s between repetitions of the commands
ZERO_FOR_S = 0.5  # wall s in which zero is repeated, because a single frame may be lost


class Due(NamedTuple):
    """Set-point to send.

    Attributes
    ----------
    node
        Controller, or output of an autopilot.
    n
        Command, -1..1.
    fresh
        Whether the set-point is new; False for a repetition.
    """

    node: int
    n: float
    fresh: bool


class Setpoints:
    """Schedule of set-points, and the present command of each node.

    A row of the schedule is a run time [s] and the commands, -1..1, by node.

    Attributes
    ----------
    skipped
        Number of set-points that a later one replaced before they were sent.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._rows: deque[tuple[float, dict[int, float]]] = deque()
        self._held: dict[int, float] = {}  # node -> present command
        self._zeroed: set[int] = set()  # nodes that get zero at once
        self._next_repeat = -math.inf  # wall time [s]
        self._repeat_until = -math.inf  # wall time [s]
        self._unwritten = False  # whether the last result of `due` may not have been written yet
        # Number of set-points that were replaced by a later one before they were sent. This happens if the thread of
        # the port is delayed: an old command must never follow a newer one. The number is reported.
        self.skipped = 0

    def append(self, rows: Iterable[tuple[float, dict[int, float]]]) -> None:
        """Add rows (run time [s], command by node) to the schedule, in any order of time."""
        with self._lock:
            merged = [*self._rows, *((t, dict(row)) for t, row in rows)]
            merged.sort(key=lambda item: item[0])  # stable sort: the last appended of two rows with equal times counts
            self._rows = deque(merged)

    def zero(self, now_wall: float) -> None:
        """Clear the schedule. Zero is sent at once, and repeated for ZERO_FOR_S, to each node that had a command."""
        with self._lock:
            self._rows.clear()
            self._held = dict.fromkeys(self._held, 0.0)
            self._zeroed = set(self._held)
            self._repeat_until = now_wall + ZERO_FOR_S

    @property
    def active(self) -> bool:
        """Whether thrust is commanded now or scheduled."""
        with self._lock:
            return self._is_active()

    def is_settled(self, now_wall: float) -> bool:
        """Return whether no thrust is commanded and the last zero has been written and repeated for ZERO_FOR_S."""
        with self._lock:
            waiting = bool(self._zeroed) or self._unwritten or now_wall < self._repeat_until
            return not self._is_active() and not (self._held and waiting)

    @property
    def pending(self) -> int:
        """Number of rows that have not been sent."""
        return len(self._rows)

    @property
    def held(self) -> dict[int, float]:
        """Present command, -1..1, of each node."""
        with self._lock:
            return dict(self._held)

    def due(self, now_run: float, now_wall: float) -> list[Due]:
        """Return the set-points to send now, and remove them from the schedule.

        All commands are repeated every REPEAT_S while thrust is commanded, and for ZERO_FOR_S afterwards. Of several
        rows that are due, only the newest command of a node is returned; the others count as skipped.

        Parameters
        ----------
        now_run
            Run time [s].
        now_wall
            Wall time [s].
        """
        with self._lock:
            fresh: dict[int, float] = dict.fromkeys(self._zeroed, 0.0)
            self._zeroed = set()
            due_at: dict[int, float] = {}
            while self._rows and self._rows[0][0] <= now_run:
                t, row = self._rows.popleft()
                # A row with an equal time replaces the earlier one on purpose and does not count.
                self.skipped += sum(due_at.get(node, t) < t for node in row)
                due_at |= dict.fromkeys(row, t)
                fresh |= row
            self._held |= fresh
            if fresh or self._is_active():
                self._repeat_until = now_wall + ZERO_FOR_S
            out = [Due(node, n, True) for node, n in fresh.items()]
            if now_wall >= self._next_repeat and now_wall < self._repeat_until:
                out += [Due(node, n, False) for node, n in self._held.items() if node not in fresh]
                self._next_repeat = now_wall + REPEAT_S
            self._unwritten = bool(out)
            return out

    def written(self) -> None:
        """Record that the last result of `due` has been written to the port."""
        with self._lock:
            self._unwritten = False

    def wait(self, now_run: float, now_wall: float, speed: float) -> float:
        """Return the wall time [s] until a set-point may be due, infinite if there is none.

        `speed` is the run time per wall time.
        """
        with self._lock:
            if self._zeroed:
                return 0.0
            row = (self._rows[0][0] - now_run) / speed if self._rows else math.inf
            repeat = self._next_repeat - now_wall if self._held and now_wall < self._repeat_until else math.inf
            return max(min(row, repeat), 0.0)

    def _is_active(self) -> bool:
        """Return whether thrust is commanded now or scheduled. The caller holds the lock."""
        return bool(self._rows) or any(n != 0.0 for n in self._held.values())
