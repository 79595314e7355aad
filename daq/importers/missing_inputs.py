"""Inputs without a value: a motor that is stopped, or a command that is unknown.

A sensor without a value has not measured, and that is no harm. A thruster always does something. If the last command
before a gap were held through it, a fit would believe that the thruster pushed all the time.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from seatrial.daq.errors import counted
from seatrial.daq.importers.table import Column

Mask = npt.NDArray[np.bool_]

GAP_S, GAP_ROWS = 0.5, 3  # s and rows without a value: shorter ones are noise of a link, and the last value holds
# Messages in which NaN stands for a motor that is stopped (PX4, msg/ActuatorMotors.msg: "NaN maps to disarmed")
_MOTORS = {"actuator_motors", "px4_msgs/msg/ActuatorMotors"}
_CONTROL = re.compile(r"control\[\d+\]")


def stopped_motors(kind: str, columns: dict[str, Column]) -> str:
    """Put zero where a message of this ``kind`` says that a motor is stopped, in place.

    Returns
    -------
    str
        A remark with the number of these messages; "" if there are none. Motors that never have a value stay as they
        are: they do not exist.
    """
    if kind not in _MOTORS:
        return ""
    stopped = np.zeros(0, bool)
    for name in [name for name in columns if _CONTROL.fullmatch(name)]:
        empty = np.isnan(columns[name])
        if not empty.all():
            columns[name] = np.where(empty, 0.0, columns[name])
            stopped = empty | (stopped if len(stopped) else empty)
    n = int(stopped.sum())
    return f"{counted(n, 'message')} of {len(stopped)} with a stopped motor (NaN): its command is zero" if n else ""


def input_gaps(t: Column, values: Column) -> Mask:
    """Find where an input becomes unknown.

    Parameters
    ----------
    t
        Times of the rows (n,) [s].
    values
        The input in these rows (n,), NaN where a row has no value.

    Returns
    -------
    Mask
        True in the first row of each gap (n,). A column that has a value in some rows only, because other columns have
        the other rows, has no gaps: its last value holds.
    """
    found = np.zeros(len(values), bool)
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < 3 or np.median(np.diff(known)) > 1.0:
        return found
    edges = np.append(known, len(values))
    for k in np.flatnonzero(np.diff(edges) > GAP_ROWS):
        begin, end = int(edges[k]) + 1, min(int(edges[k + 1]), len(values) - 1)
        found[begin] = t[end] - t[begin] > GAP_S
    return found


def said_gaps(gaps: Mapping[str, list[tuple[float, float]]]) -> list[str]:
    """One line for each group of inputs that are unknown at the same times."""
    groups: dict[tuple[tuple[float, float], ...], list[str]] = {}
    for name, found in gaps.items():
        groups.setdefault(tuple(found), []).append(name)
    return [
        f"{', '.join(names)}: unknown for {sum(b - a for a, b in found):.1f} s, in {counted(len(found), 'gap')}; "
        'a fit leaves these times out, and nan = "zero" of the signal says that the thruster stands'
        for found, names in groups.items()
        if found
    ]
