"""Real-time priority of the threads that serve ports, send set-points and check limits.

Niceness alone is not sufficient. If Linux groups processes by session (sched_autogroup_enabled, as on most desktops),
niceness counts only within a session, and another session gets as much time as all processes of this program.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

NICENESS = -10
# Real-time priority of 1 to 99. It is above all normal threads and above the lowest real-time priority.
REAL_TIME = 2


def set_realtime_priority(behind: int = 0) -> None:
    """Raise the priority of this thread, and of threads and processes that it starts later, as far as possible.

    On Linux the thread gets real-time scheduling (SCHED_RR). The niceness -10 is set on every system, on macOS for the
    whole process. Without the right to do so, the priority stays, and no error is raised.

    Parameters
    ----------
    behind : int
        By how much the real-time priority is lower than the highest one of this program, 0 or 1. 1 is for a thread that
        may be delayed by the other threads of this program, but not by other programs. With equal priorities, threads
        on one core would take turns of 100 ms.
    """
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
    if hasattr(os, "sched_setscheduler"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(REAL_TIME - behind))


@contextlib.contextmanager
def realtime_priority() -> Iterator[None]:
    """Raise the priority of this thread for a `with` block as far as the system allows, and then restore the old one.

    The priority is the highest one of this program (`set_realtime_priority`). A missing right is no error. Threads that
    are started within the block keep the raised priority after it.
    """
    niceness = os.getpriority(os.PRIO_PROCESS, 0)
    can_schedule = hasattr(os, "sched_getscheduler")
    policy, priority = (os.sched_getscheduler(0), os.sched_getparam(0)) if can_schedule else (0, None)
    set_realtime_priority()
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            if priority is not None:
                os.sched_setscheduler(0, policy, priority)
            os.setpriority(os.PRIO_PROCESS, 0, niceness)
