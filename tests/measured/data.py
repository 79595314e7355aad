"""Where measured data are, for every test that wants some; and the commands that are run on them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from seatrial import command_line


def measured(name: str = "") -> Path:
    """A file or folder of the measured data sets; skips the test where there is none."""
    folder = os.environ.get("SEATRIAL_DATA")
    if not folder:
        pytest.skip("SEATRIAL_DATA does not say where the measured data sets are")
    path = Path(folder, name)
    if not path.exists():
        pytest.skip(f"SEATRIAL_DATA has no {name}")
    return path


def run(*words: str) -> None:
    """A command that ends well."""
    with pytest.raises(SystemExit) as left:
        command_line.main(words)
    assert left.value.code == 0, words
