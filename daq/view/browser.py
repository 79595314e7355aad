"""Opening of the page in the browser of the user, by a process that is started before any limits of resources.

python -P -m seatrial.daq.view.browser < ADDRESS
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import webbrowser
from collections.abc import Callable

from seatrial.daq.child_process import module_command, module_environment


def prepare_browser() -> Callable[[str], None]:
    """Return a function that opens an address in the browser of the user.

    On a computer without a screen the function does nothing. Otherwise a process that starts the browser is started
    here. This process waits for the address and ends then, or when the command ends. The function may therefore be
    called in a child process with limits. It may be called only once. A failure to open the browser is not reported.
    """
    has_screen = sys.platform == "darwin" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if not has_screen:  # a browser in the terminal would take over the terminal of the command
        return lambda address: None
    process = subprocess.Popen(
        module_command("seatrial.daq.view.browser"),
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=module_environment(),
        start_new_session=True,
    )

    def show(address: str) -> None:
        """Send an address to the process that opens it in the browser. No error is reported. Call this only once."""
        assert process.stdin is not None
        with contextlib.suppress(OSError):
            process.stdin.write(f"{address}\n".encode())
            process.stdin.close()

    return show


if __name__ == "__main__":
    if line := sys.stdin.readline().strip():
        with contextlib.suppress(webbrowser.Error, OSError):
            webbrowser.open(line)
