"""The LOG of a command line: a file, or the folder of the one log that it holds."""

from __future__ import annotations

from pathlib import Path
from typing import final

import click

MAX_NAMED = 8


@final
class LogPath(click.Path):
    """A log that is there; of a folder the log in it, where there is only one (its segments count as one)."""

    def __init__(self) -> None:
        super().__init__(exists=True, path_type=Path)

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The file to open. Fails, as wrong usage, where there is none or more than one."""
        path = Path(super().convert(value, param, ctx))  # type: ignore[arg-type]
        if not path.is_dir():
            return path
        from daq.mcap_set import first_segments  # takes numpy along, which --help can do without

        found = first_segments(path)
        if not found:
            self.fail(f"{path} is a folder without a log (*.mcap) in it", param, ctx)
        if len(found) > 1:
            names = ", ".join(one.name for one in found[:MAX_NAMED]) + (", ..." if len(found) > MAX_NAMED else "")
            self.fail(f"{path} is a folder of {len(found)} logs: name one of {names}", param, ctx)
        return found[0]


LOG = LogPath()
