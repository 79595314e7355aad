"""What ``seatrial check --report`` does here: a finished check in; its page, with curves from the logs, out."""

from __future__ import annotations

from pathlib import Path

from daq.checks import CheckReport
from ident.checks import log_evidence
from ident.report import write_check_page


def write_check(report: CheckReport, command: str, out: Path) -> None:
    """Write the page of a check. Raises SeatrialError where a log of it cannot be read, OSError where ``out`` cannot be
    written."""
    name = report.subject if report.rig is not None and len(report.logs) == 1 else ""
    write_check_page(report, [log_evidence(path, name) for path in report.logs], command, out)
