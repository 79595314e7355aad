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
    """Set-point that has to be sent now.

    Attributes
    ----------
    node
        Number of the speed controller on the bus, or of the autopilot's servo output.
    n
        Command, -1..1.
    fresh
        Whether the set-point is new; False for the repetition of an earlier one.
    """

    node: int
    n: float
    fresh: bool


class Setpoints:
    """Schedule of the set-points of one port, and the present command of each node (controller or servo output).

    A row of the schedule is a run time [s] and the commands, -1..1, by node. Any thread may call the methods.

    Attributes
    ----------
    skipped
        Number of set-points that were never sent, because a later set-point was due before they could be sent.
    """

    def __init__(self) -> None:
        """Make an empty schedule. No node has a command."""
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
        """Add set-points to the schedule, as rows of run time [s] and command, -1..1, by node, in any order of time.

        Rows that wait already stay in the schedule. Of two rows with equal times, the later added one counts for the
        nodes that it contains.
        """
        with self._lock:
            merged = [*self._rows, *((t, dict(row)) for t, row in rows)]
            merged.sort(key=lambda item: item[0])  # stable sort: the last appended of two rows with equal times counts
            self._rows = deque(merged)

    def zero(self, now_wall: float) -> None:
        """Discard all scheduled set-points, and command zero to each node that has had a command.

        Zero is due at once, and is repeated for ZERO_FOR_S (0.5 s). Nodes without an earlier command get none.
        `now_wall` is wall time [s].
        """
        with self._lock:
            self._rows.clear()
            self._held = dict.fromkeys(self._held, 0.0)
            self._zeroed = set(self._held)
            self._repeat_until = now_wall + ZERO_FOR_S

    @property
    def active(self) -> bool:
        """Whether a command other than zero holds at present, or any set-point is scheduled."""
        with self._lock:
            return self._is_active()

    def is_settled(self, now_wall: float) -> bool:
        """Return whether thrust has ended: the last zero was written to the port and repeated for 0.5 s (ZERO_FOR_S).

        The result is False while a command other than zero holds or a set-point is scheduled. It is True if no node
        ever had a command and no set-point is scheduled. `now_wall` is wall time [s].
        """
        with self._lock:
            waiting = bool(self._zeroed) or self._unwritten or now_wall < self._repeat_until
            return not self._is_active() and not (self._held and waiting)

    @property
    def pending(self) -> int:
        """Number of rows (a run time and the commands of that time) of the schedule that have not been sent yet."""
        return len(self._rows)

    @property
    def held(self) -> dict[int, float]:
        """Present command, -1..1, of each node that has had a command; the caller gets a copy."""
        with self._lock:
            return dict(self._held)

    def due(self, now_run: float, now_wall: float) -> list[Due]:
        """Return the set-points that the port has to send now, and remove them from the schedule.

        The present command of each node is repeated every 20 ms (REPEAT_S) while thrust is commanded or scheduled, and
        for 0.5 s (ZERO_FOR_S) after this or after any new set-point. If several set-points of a node are due, only the
        newest one is returned; the others count as skipped, except one with the same time. The list is empty if nothing
        is due.

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
        """Record that the set-points of the last call of `due` have been written to the port, for `is_settled`."""
        with self._lock:
            self._unwritten = False

    def wait(self, now_run: float, now_wall: float, speed: float) -> float:
        """Return the wall time [s] until the next set-point or repetition is due; infinite if there is none.

        `now_run` is run time [s], `now_wall` is wall time [s], and `speed` is the number of run seconds per wall
        second. The result is 0 if one is due now.
        """
        with self._lock:
            if self._zeroed:
                return 0.0
            row = (self._rows[0][0] - now_run) / speed if self._rows else math.inf
            repeat = self._next_repeat - now_wall if self._held and now_wall < self._repeat_until else math.inf
            return max(min(row, repeat), 0.0)

    def _is_active(self) -> bool:
        """Return whether a command other than zero holds, or a set-point is scheduled. The caller holds the lock."""
        return bool(self._rows) or any(n != 0.0 for n in self._held.values())
