"""Fixtures that several tests of the log share."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.daq.logs import N_ROUNDS, write_everything


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a closed log that contains some samples of every kind."""
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    write_everything(path, N_ROUNDS)
    return path
