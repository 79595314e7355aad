"""Inputs without a value: a stopped motor, or an unknown command.

A sensor without a value has not measured, which does no harm to a fit. A thruster always has some thrust. If the last
command before a gap were held through the gap, a fit would assume this thrust for the whole gap.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from seatrial.daq.errors import counted
from seatrial.daq.importers.table import Column

Mask = npt.NDArray[np.bool_]

GAP_S, GAP_ROWS = 0.5, 3  # s and rows; a shorter gap is a lost message, in which the last value holds
# Messages in which NaN means a stopped motor (PX4, msg/ActuatorMotors.msg: "NaN maps to disarmed")
_MOTORS = {"actuator_motors", "px4_msgs/msg/ActuatorMotors"}
_CONTROL = re.compile(r"control\[\d+\]")


def stopped_motors(kind: str, columns: dict[str, Column]) -> str:
    """Replace NaN by zero in the commands of stopped motors of PX4 (topic or message ActuatorMotors), in place.

    Parameters
    ----------
    kind
        Type of the messages. Columns of other types than ActuatorMotors are not changed.
    columns
        Columns of the topic by name, each (n,). The commands are control[0], control[1], ... A motor that never has a
        value does not exist and is not changed.

    Returns
    -------
    str
        A remark with the number of messages in which at least one motor is stopped; "" without such messages.
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
    """Find the rows in which an input (a command or shaft speed) becomes unknown, as after a lost connection.

    Parameters
    ----------
    t
        Times of the rows (n,) [s].
    values
        The input in these rows (n,), NaN where a row has no value.

    Returns
    -------
    Mask
        True in the first row of each gap of at least 3 rows and more than 0.5 s (n,). A column whose values are usually
        more than a row apart has no gaps: the other rows belong to other columns, and its last value holds. A column
        with fewer than 3 values has no gaps either. Rows before the first value are no gap; rows after the last value
        may be one.
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


def gap_lines(gaps: Mapping[str, list[tuple[float, float]]]) -> list[str]:
    """Return a line for the user for each group of inputs that are unknown at the same times.

    Parameters
    ----------
    gaps
        Begin and end [s] of the gaps of each input, by the name of the input.

    Returns
    -------
    list of str
        The lines, with the total time and the number of the gaps. Inputs without gaps are not in them.
    """
    groups: dict[tuple[tuple[float, float], ...], list[str]] = {}
    for name, found in gaps.items():
        groups.setdefault(tuple(found), []).append(name)
    return [
        f"{', '.join(names)}: unknown for {sum(b - a for a, b in found):.1f} s, in {counted(len(found), 'gap')}; "
        'a fit leaves these times out; if the thruster is stopped then, give the signal nan = "zero" in the import map'
        for found, names in groups.items()
        if found
    ]
