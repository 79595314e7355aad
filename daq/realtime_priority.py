"""Real-time priority for the control path on a busy machine: ports, set-points, limits.

Niceness alone is not enough: where Linux groups processes by session (sched_autogroup_enabled, as on most desktops) it
counts within a session only, and every program that others started weighs as much as all of ours.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

NICENESS = -10
REAL_TIME = 2  # of 99: before all that is not real-time, and before what has the least of it


def set_realtime_priority(behind: int = 0) -> None:
    """Raise the priority of this thread and those it starts, as far as allowed: real-time scheduling on Linux.

    ``behind`` 1: before other programs still, but behind those of us that must not wait (they share a core in turns of
    100 ms otherwise).
    """
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
    if hasattr(os, "sched_setscheduler"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(REAL_TIME - behind))


@contextlib.contextmanager
def realtime_priority() -> Iterator[None]:
    """The same for as long as the context lasts."""
    niceness = os.getpriority(os.PRIO_PROCESS, 0)
    policy = os.sched_getscheduler(0) if hasattr(os, "sched_getscheduler") else 0
    set_realtime_priority()
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            if hasattr(os, "sched_setscheduler"):
                of_it = REAL_TIME if policy in (os.SCHED_FIFO, os.SCHED_RR) else 0
                os.sched_setscheduler(0, policy, os.sched_param(of_it))
            os.setpriority(os.PRIO_PROCESS, 0, niceness)
