"""Findings of `seatrial check` on logs: on their devices and on the motion."""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path

from seatrial.daq.checks import FAULT, OK, WARNING, Finding, check_devices
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import WHOLE, TimeWindow, bag_of_ros, open_log, part_in
from seatrial.daq.samples import MEASURED


def log_findings(
    check_motion: Callable[[Path, TimeWindow], list[Finding]],
    paths: Sequence[Path],
    differences: Callable[[], list[tuple[str, Finding]]] | None = None,
    windows: Sequence[TimeWindow] = (),
) -> list[Finding]:
    """Check logs, and return the findings on their devices and on the recorded motion.

    Parameters
    ----------
    check_motion : Callable
        Function of the path of a log and an interval of its time that returns the findings on the motion in it: whether
        sensors and thrusters agree. If it raises SeatrialError (as it does if the package ident is not installed), a
        warning is returned in place of its findings.
    paths : sequence of Path
        The logs.
    differences : Callable, optional
        Function that returns the findings on the logs that ``check_motion`` has checked together, each with the name of
        its log or the number of logs. Not called for one log, and not used if it raises SeatrialError.
    windows : sequence of TimeWindow
        Interval of time of each log that is checked. Empty: the whole logs.

    Returns
    -------
    list of Finding
        Findings in the order of the logs. A log without samples gives a fault, and its motion is not checked. A log to
        which no check applies gives one finding of level OK. If there are several logs, the place of each finding
        (`where`, mostly a device) starts with the name of the log.

    Raises
    ------
    SeatrialError
        If a file is not a log, or ends before its interval of time.
    """
    found = []
    for path, window in zip(paths, windows or [WHOLE] * len(paths), strict=True):
        with open_log(path) as log:
            here, counts = list(check_devices(part_in(log, window))), log.counts
            samples = any(log.sources(kind) for kind in MEASURED)
        if samples:
            here += _motion_findings(check_motion, path, window)
        elif (bag := bag_of_ros(path)) is not None:
            advice = f"import it with `seatrial import --guess {shlex.quote(str(bag))}`, and check the log"
            here.append(Finding(FAULT, "ros-bag", "log", path.name, "it is a bag of ROS 2, not a log", advice))
        else:
            advice = "`seatrial info` shows what it contains; if devices were connected, record it again"
            here.append(Finding(FAULT, "log-empty", "log", path.name, "it contains no sample of any device", advice))
        if not here:
            here = [
                Finding(
                    OK,
                    "nothing-to-check",
                    "log",
                    path.name,
                    f"no check applies to its content: {', '.join(counts) or 'empty'}",
                )
            ]
        prefix = f"{path.stem}{window.label}: " if len(paths) > 1 else ""
        found += [finding._replace(where=f"{prefix}{finding.where}") for finding in here]
    if differences is not None and len(paths) > 1:
        with contextlib.suppress(SeatrialError):  # without ident, each log has the warning already
            found += [f._replace(where=f"{name}: {f.where}") for name, f in differences()]
    return found


def _motion_findings(
    check_motion: Callable[[Path, TimeWindow], list[Finding]], path: Path, window: TimeWindow
) -> list[Finding]:
    """Return the findings of the function ``check_motion`` on the motion in an interval of time of the log ``path``.

    If it raises SeatrialError, for example because the package ident is not installed, return one warning with the
    reason.
    """
    try:
        return check_motion(path, window)
    except SeatrialError as error:
        text = f"sensors and thrusters were not compared: {error}"
        advice = "remove this cause, or check the log on a computer with the complete seatrial"
        return [Finding(WARNING, "motion-not-checked", "motion", path.name, text, advice)]
