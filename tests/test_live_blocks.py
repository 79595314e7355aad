"""Blocks of the documentation that are run on simulated devices in real time; tests/test_blocks.py lists all blocks."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.page_runner import command_lines
from tests.test_blocks import block, empty
from tests.test_docs import ROOT, blocks
from tests.test_tutorials import environment, mock, run

__all__ = ["empty", "environment"]

pytestmark = pytest.mark.pages


def test_the_rig_of_the_check_page_passes(empty: Path, environment: dict[str, str]) -> None:
    """The devices are a mock."""
    shutil.copy(ROOT / "mocks/rigs/boat.toml", empty / "rig.toml")
    run("seatrial mission generate --kind mixed --seconds 60 --seed 1 -o mission.toml", empty, environment)
    with mock("seatrial mock boat rig.toml", empty, environment):
        for line in command_lines(block("docs/how-to/check.md")):
            run(line, empty, environment)


def test_the_mocks_with_an_effect_start(empty: Path, environment: dict[str, str]) -> None:
    (copy, first), (second,) = (command_lines(text) for text in blocks(ROOT / "docs/how-to/add-an-effect.md", "sh")[:2])
    run(copy, empty, environment)
    for line in (first, second):
        with mock(line, empty, environment):
            pass
        assert json.loads((empty / "truth.json").read_text(encoding="utf-8"))["effect"] == "wind"
