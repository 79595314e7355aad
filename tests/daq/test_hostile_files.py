"""A few files of others over the commands that read them; `python -m tests.daq.hostile_files` is the study."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.daq import hostile_files
from tests.daq.hostile_files import MEMORY, Command, run, study


def test_hostile_files_are_answered_or_refused_in_one_line(tmp_path: Path) -> None:
    summary = study(8, 3, 0, tmp_path / "few", fits=False)
    assert summary.failures == []
    assert summary.runs.total() > 15
    assert len(summary.runs) >= 5


def crash() -> None:
    print("seatrial: internal error (x)", file=sys.stderr)


def too_much() -> None:
    try:
        bytearray(MEMORY)
    except MemoryError:
        os._exit(9)


MISDEEDS: dict[str, Callable[[Path], object]] = {
    "traceback: seatrial: internal error (x)": lambda box: crash(),
    "prints '\\x1b'": lambda box: print("\x1b[2J"),
    "wrote or removed outside/x": lambda box: (box / "outside/x").write_text("x"),
    "os.system": lambda box: os.system("true"),
    "wrote ": lambda box: Path(f"{box}-x").write_text("x"),
    "executed ": lambda box: exec(compile("1", str(box / "outside/trap.py"), "exec")),
    "status 7": lambda box: os._exit(7),
    "status 9": lambda box: too_much(),
    "signal 11": lambda box: os.kill(os.getpid(), signal.SIGSEGV),
    "no line of an error": lambda box: sys.exit(1),
    "": lambda box: (box / "out/x").write_text("x"),
}


@pytest.mark.parametrize("why", list(MISDEEDS))
def test_what_a_command_may_not_do_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, why: str) -> None:
    """Else the test above could not fail."""
    box = tmp_path / "box"
    (box / "out").mkdir(parents=True)
    (box / "outside").mkdir()

    def main(words: list[str]) -> None:
        MISDEEDS[why](box)
        sys.exit(0)

    monkeypatch.setattr(hostile_files.seatrial, "main", main)
    found = run(Command(("info",), "out/x"), box, tmp_path / "cache")
    assert found.why.startswith(why)
    assert bool(found.why) == bool(why)
