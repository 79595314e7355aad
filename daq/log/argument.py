"""Type of the argument LOG of a command: a log as a file, or as a folder that contains exactly one log."""

from __future__ import annotations

from pathlib import Path
from typing import final

import click

from seatrial.daq.errors import SeatrialError
from seatrial.daq.options import ExistingPath


@final
class LogPath(ExistingPath):
    """Type of an argument that is an existing log: a file, or a folder with one log, whose segments count as one."""

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path of the log file to open, from the text of an argument LOG.

        For a file this is the file itself, for a folder the first segment of the only log in it. A path that does not
        exist, and a folder without a log or with more than one log, are usage errors.
        """
        path = Path(super().convert(value, param, ctx))
        if not path.is_dir():
            return path
        from seatrial.daq.log.segments import log_file  # imported here, because it imports numpy and --help needs none

        try:
            return log_file(path)
        except SeatrialError as error:
            self.fail(str(error), param, ctx)


LOG = LogPath()
