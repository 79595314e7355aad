"""Test of the commands on a few foreign files. The full study is `python -m tests.daq.hostile_files`."""

from __future__ import annotations

import os
import random
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.daq import hostile_files
from tests.daq.hostile_files import MEMORY, Command, run, study
from tests.daq.hostile_sources import ATTACKS, Step
from tests.daq.logs import write_everything


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


QUICK = {"tiny_bag", "pipes", "absurd_values", "names", "foreign_hdf5", "database_beside"}
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
def test_a_violation_by_a_command_is_detected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, why: str) -> None:
    """This test shows that the test above can fail."""
    box = tmp_path / "box"
    (box / "out").mkdir(parents=True)
    (box / "outside").mkdir()

    def main(words: list[str]) -> None:
        MISDEEDS[why](box)
        sys.exit(0)

    monkeypatch.setattr(hostile_files.command_line, "main", main)
    found = run(Command(("info",), "out/x"), box, tmp_path / "cache")
    assert found.why.startswith(why)
    assert bool(found.why) == bool(why)


def test_too_much_memory_is_detected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    box = tmp_path / "box"
    (box / "home").mkdir(parents=True)
    (box / "run.mcap").write_bytes(b"nothing")
    found = run(Command(("info", "run.mcap")), box, tmp_path / "cache")
    assert (found.why, found.answered, found.limited) == ("", False, False)
    monkeypatch.setattr(hostile_files, "RESIDENT", 1_000_000)
    assert run(Command(("info", "run.mcap")), box, tmp_path / "cache").why == hostile_files.LARGE


@pytest.mark.filterwarnings("default")  # the command itself prints a line for the user
@pytest.mark.parametrize("attack", [attack for attack in dict.fromkeys(ATTACKS) if attack.__name__ in QUICK])
def test_quick_attacks_are_refused(tmp_path: Path, attack: Callable[[Path, random.Random], tuple[Step, ...]]) -> None:
    box = tmp_path / "box"
    for name in ("out", "outside", "home"):
        (box / name).mkdir(parents=True)
    (box / "outside/trap.py").write_text("")
    write_everything(tmp_path / "any.mcap", 1)  # this process asks once for the version of the code
    for step in attack(box, random.Random(5)):
        found = run(Command(*step), box, tmp_path / "cache")
        assert (found.why, found.limited) == ("", False)
