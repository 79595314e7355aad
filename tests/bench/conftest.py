"""Fixture of the stand-in bench for tests that drive a thruster."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.bench.runs import SPEED
from tests.bench.standin import StandIn


@pytest.fixture
def standin(tmp_path: Path) -> Iterator[StandIn]:
    with StandIn(tmp_path, SPEED) as devices:
        yield devices
