"""A mock in its own process, behind real ports."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def mock_process(folder: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    """Run `seatrial mock WORDS` in a folder. Yield the process after it printed `ready`, and end it with SIGTERM."""
    command = [sys.executable, "-m", "seatrial", "mock", *words]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield process
        finally:
            process.terminate()
            process.wait(timeout=10)
