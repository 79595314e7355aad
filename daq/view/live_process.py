"""Process that serves the page of a log while it is recorded, for `--view` of the commands that record.

The process reads nothing but the file of the log. It shares no thread, queue or lock with the recording: if it hangs,
is killed or is flooded with requests, the acquisition, the safety guard and the watchdog do not notice. It has the
lowest priority, limited memory, and is the first process that Linux ends when memory runs out.

    python -P -m seatrial.daq.view.live_process DESCRIPTOR LOG

The first line of its standard input is the token. It ends when its standard input is closed, so also when the command
that started it is killed.
"""

from __future__ import annotations

import contextlib
import os
import resource
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

from seatrial.daq.child_process import module_command, module_environment
from seatrial.daq.errors import SeatrialError
from seatrial.daq.view.server import PageServer, listen, new_token, page_address
from seatrial.daq.view.viewed_log import ViewedLog

NICENESS = 19  # the lowest priority
MEMORY_BYTES = 2_000_000_000  # of address space
END_S = 2.0  # wall s in which the process ends after its standard input is closed; then it is killed


@contextlib.contextmanager
def live_page(log: Path) -> Iterator[str]:
    """Serve the page of a log that is recorded within the `with` block, by a process of its own. Yield its address.

    The log need not exist yet. The page ends with the block. A failure of the process changes nothing else.

    Parameters
    ----------
    log
        Path of the log.

    Raises
    ------
    SeatrialError
        At the beginning of the block, if the process cannot be started.
    """
    token = new_token()
    with listen(0) as listening:
        address = page_address(listening, token)
        try:
            process = subprocess.Popen(
                module_command("seatrial.daq.view.live_process", str(listening.fileno()), str(log.absolute())),
                pass_fds=[listening.fileno()],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env=module_environment(),
                start_new_session=True,  # Ctrl-C is for the command
            )
        except OSError as error:
            raise SeatrialError(f"the page cannot be served: {error.strerror}; run again without --view") from error
    assert process.stdin is not None
    try:
        with contextlib.suppress(OSError):
            process.stdin.write(f"{token}\n".encode())
            process.stdin.flush()
        yield address
    finally:
        with contextlib.suppress(OSError):
            process.stdin.close()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _yield_to_the_recording() -> None:
    """Give this process the lowest priority, limited memory, and the first place when the system runs out of memory.

    What the system does not allow is left out without an error.
    """
    if hasattr(os, "sched_setscheduler"):
        with contextlib.suppress(OSError):  # a real-time priority of the parent is inherited
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")


def _end_with_parent() -> None:
    """Wait until standard input is closed, and then end this process at once, with all its threads."""
    with contextlib.suppress(OSError):
        while sys.stdin.buffer.read(4096):
            pass
    os._exit(0)


def main() -> None:
    """Serve the page until standard input is closed."""
    _yield_to_the_recording()
    listening = socket.socket(fileno=int(sys.argv[1]))
    token = sys.stdin.buffer.readline().decode("ascii").strip()
    threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()
    PageServer([ViewedLog(Path(sys.argv[2]), wait=True)], listening, token).serve_forever()


if __name__ == "__main__":
    main()
