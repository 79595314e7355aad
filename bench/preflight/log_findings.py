"""Findings of `seatrial check` on logs: on their devices and on the motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from seatrial.daq.checks import FAULT, OK, WARNING, Finding, check_devices
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import open_log
from seatrial.daq.samples import MEASURED


def log_findings(check_motion: Callable[[Path], list[Finding]], paths: Sequence[Path]) -> list[Finding]:
    """Return the findings of all logs: on their devices, and on the motion if the package ident is installed.

    A log without samples gives a fault. A log to which no check applies gives one finding without fault. With several
    logs, the names of devices start with the name of the log.

    Parameters
    ----------
    check_motion
        Function that returns the findings on the motion in a log. It raises SeatrialError if ident is not installed.
    paths
        The logs.

    Raises
    ------
    SeatrialError
        If a file is not a log.
    """
    found = []
    for path in paths:
        with open_log(path) as log:
            here, counts = list(check_devices(log)), log.counts
            samples = any(log.sources(kind) for kind in MEASURED)
        if samples:
            here += _motion_findings(check_motion, path)
        else:
            advice = "`seatrial info` shows what is in it"
            here.append(Finding(FAULT, "log-empty", "log", "all of it", "it contains no sample of any device", advice))
        if not here:
            here = [
                Finding(
                    OK,
                    "nothing-to-check",
                    "log",
                    "all of it",
                    f"no check applies to its content: {', '.join(counts) or 'empty'}",
                )
            ]
        prefix = f"{path.stem}: " if len(paths) > 1 else ""
        found += [finding._replace(where=f"{prefix}{finding.where}") for finding in here]
    return found


def _motion_findings(check_motion: Callable[[Path], list[Finding]], path: Path) -> list[Finding]:
    """Return the findings on the motion in a log.

    If the check fails, or the package ident is not installed, return one warning with the reason.
    """
    try:
        return check_motion(path)
    except SeatrialError as error:
        text = f"sensors and thrusters were not compared: {error}"
        advice = "check the log where all of seatrial is installed"
        return [Finding(WARNING, "motion-not-checked", "motion", path.name, text, advice)]
