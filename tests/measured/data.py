"""Location of measured data for tests, and a function that runs commands."""

from __future__ import annotations

import gzip
import os
from collections.abc import Sequence
from pathlib import Path

import pytest

from seatrial import command_line
from tests.recovery.logged import seatrial


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


def import_boat(boat: str, runs: Sequence[str], folder: Path) -> None:
    """Import runs of a boat of the realistic plant by its import map, as ``RUN.mcap`` in the folder."""
    source = realistic_boats() / boat
    for name in runs:
        (folder / f"{name}.csv").write_bytes(gzip.decompress((source / f"{name}.csv.gz").read_bytes()))
        seatrial(folder, "import", str(source / "map.toml"), f"{name}.csv", "-o", f"{name}.mcap")


def run(*words: str) -> None:
    """Run a command and check that its status is zero."""
    with pytest.raises(SystemExit) as left:
        command_line.main(words)
    assert left.value.code == 0, words
