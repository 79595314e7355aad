"""Types of the argument LOG of a command: a log, as a file or as the folder of exactly one log; or a bag of ROS too."""

from __future__ import annotations

from pathlib import Path
from typing import final

import click

from seatrial.daq.errors import SeatrialError
from seatrial.daq.options import ExistingPath


@final
class LogPath(ExistingPath):
    """Type of an argument that is an existing log: a file, or a folder with one log, whose segments count as one."""

    def __init__(self, *, bags: bool = False) -> None:
        """Make the type. With `bags`, a bag of ROS (`is_bag`) is accepted too, as a file or a folder."""
        super().__init__()
        self._bags = bags

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path of the log file to open, from the text of an argument LOG.

        For a file this is the file itself, for a folder the first segment of the only log in it. A path that does not
        exist, and a folder without a log or with more than one log, are usage errors.
        """
        path = Path(super().convert(value, param, ctx))
        if not path.is_dir():
            return path
        # imported here, because it imports numpy and --help needs none
        from seatrial.daq.log.segments import is_bag, log_file

        if self._bags and is_bag(path):
            return path
        try:
            return log_file(path)
        except SeatrialError as error:
            self.fail(str(error), param, ctx)


LOG = LogPath()
LOG_OR_BAG = LogPath(bags=True)
