"""Location of measured data for tests, and a function that runs commands."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from seatrial import command_line


def measured(name: str = "") -> Path:
    """Return a file or folder of the measured data sets. Skip the test if it is absent."""
    folder = os.environ.get("SEATRIAL_DATA")
    if not folder:
        pytest.skip("SEATRIAL_DATA is not set to the folder of the measured data sets")
    path = Path(folder, name)
    if not path.exists():
        pytest.skip(f"SEATRIAL_DATA has no {name}")
    return path


def realistic_boats() -> Path:
    """Return the folder of the boats of a realistic plant, by the environment variable SEATRIAL_DATA."""
    return Path(os.environ.get("SEATRIAL_DATA", "."), "real_boats")


def run(*words: str) -> None:
    """Run a command and check that its status is zero."""
    with pytest.raises(SystemExit) as left:
        command_line.main(words)
    assert left.value.code == 0, words
