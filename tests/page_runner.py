"""Runner of the code blocks of the documentation, in this process and in the current folder, as a reader would."""

from __future__ import annotations

import re
import shlex
import warnings
from glob import glob
from typing import Any

import pytest

from seatrial import command_line
from seatrial.daq.errors import SeatrialWarning


def edited(text: str, edits: dict[str, str]) -> str:
    """Return a block with replaced parts, for example with fewer replicates. Each part must be in the block."""
    for old, new in edits.items():
        assert old in text, old
        text = text.replace(old, new)
    return text


def run_python(code: str, page: str, space: dict[str, Any] | None = None) -> dict[str, Any]:
    """Run a Python block, and return its variables. Blocks of a page may share them in ``space``."""
    space = {"__name__": "page"} if space is None else space
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SeatrialWarning)
        exec(compile(code, page, "exec"), space)
    return space


def command_lines(block: str) -> list[str]:
    """Return the lines of a shell block without comments. A command over several lines becomes one line."""
    lines = [re.sub(r"\s+#.*", "", line) for line in block.replace("\\\n", " ").splitlines()]
    return [line for line in lines if line]


def run_command(line: str) -> None:
    """Run a command line of seatrial, as far as a pipe. Patterns of files are replaced by the files."""
    program, *words = shlex.split(line.partition(" | ")[0])
    assert program == "seatrial", line
    found = [w for word in words for w in ((sorted(glob(word)) or [word]) if "*" in word else [word])]
    with warnings.catch_warnings():
        warnings.simplefilter("default", SeatrialWarning)
        with pytest.raises(SystemExit) as left:
            command_line.main(found)
    assert not left.value.code, line


def run_commands(block: str) -> None:
    """Run every command line of a shell block."""
    for line in command_lines(block):
        run_command(line)
