"""What every source of an import yields: a table for each topic, with named columns and the times of its rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.clock import CLOCK_STEP_S
from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.samples import Event

Column = NDArray[np.float64]


@dataclass
class Table:
    """Rows of one topic. A file that is a single table has the topic ""."""

    path: Path
    topic: str
    columns: Mapping[str, Column]  # by name, each (n,); NaN where a row has no value
    t: Column | None = None  # s since 1970 or since the start, (n,), in order; None: the map says where time comes from
    kind: str = ""  # type of its messages: sensor_msgs/msg/Imu, vehicle_attitude (PX4), Ahrs
    frame_id: str = ""  # of ROS: the frame that the header names
    remark: str = ""  # what was odd about it
    clock: str = ""  # what was odd about its times, which a fit has to know
    vehicle: int | None = None  # MAV_TYPE, of logs of autopilots that say it
    parameters: Mapping[str, float] = field(default_factory=dict)  # of the autopilot, where its log has them
    events: Sequence[tuple[float, Event]] = ()  # of the whole source, s since 1970; its first table has them
    units: Mapping[str, str] = field(default_factory=dict)  # of columns, where the source says them
    texts: Mapping[str, Sequence[str]] = field(default_factory=dict)  # columns of text, by name, which have no numbers
    seconds: frozenset[str] = frozenset()  # columns that the source calls times or durations: they are in s
    n_left_out: int = 0  # rows that the source had and the table has not, because their times are wrong
    strict = False  # text: rows out of order and cells without a number are errors unless the map says otherwise

    @property
    def names(self) -> Sequence[str]:
        """Names of the columns."""
        return [*self.columns, *self.texts]

    @property
    def said(self) -> str:
        """The remarks with its topic."""
        remarks = "; ".join(part for part in (self.remark, self.clock) if part)
        return f"{self.topic}: {remarks}" if self.topic and remarks else remarks

    def __len__(self) -> int:
        return len(next(iter((*self.columns.values(), *self.texts.values())), ()))

    def numbers(self, column: str) -> Column:
        """A column (n,). Raises SeatrialError where there is no such column, or a cell is no number."""
        if column in self.texts:
            raise self.error(0, column, f"{''.join(self.texts[column][:1])[:40]!r} is text, no number")
        if column not in self.columns:
            there = ", ".join(self.names) or "none"
            raise SeatrialError(f"{self.path}: {self.topic or 'the table'} has no '{column}'; there is: {there}")
        return self.columns[column]

    def text(self, column: str) -> list[str]:
        """A column as text, for times that are no numbers."""
        return list(self.texts.get(column, ())) or [repr(value) for value in self.numbers(column).tolist()]

    def error(self, row: int, column: str, problem: str) -> SeatrialError:
        """The error of one cell, to be raised."""
        place = f"{self.topic}, '{column}'" if self.topic else f"'{column}'"
        return SeatrialError(f"{self.path}: {place}, row {row + 1}: {problem}")


def ran_back(t: Column) -> str:
    """What is odd about times (n,) [s] in the order of a file: a clock that was set, or two of them; "" nothing."""
    back = -np.diff(t)
    far = back > CLOCK_STEP_S
    return f"its times ran back {counted(int(far.sum()), 'time')}, by up to {back.max():.1f} s" if far.any() else ""


@dataclass(frozen=True)
class TextStyle:
    """How text is cut into cells, and what to do about gaps; the gaps of other sources too."""

    delimiter: str = ","  # one character, or "blank": any number of blanks and tabs
    decimal: str = "."
    encoding: str = "utf-8-sig"
    skip_rows: int = 0  # lines in front of the header
    columns: tuple[str, ...] = ()  # names, where the file has no header of its own
    nan: str = ""  # error (default of text) | drop (default of all others) | keep
    time_order: str = ""  # likewise error | drop
    repeats: str = ""  # keep | drop: rows whose signals all repeat the row before; "": values that are held, by signal


@dataclass(frozen=True)
class SourceOptions:
    """What the map says about reading a source, beside its columns."""

    style: TextStyle = field(default_factory=TextStyle)
    dbc: Path | None = None  # of a CAN log
    protocol: str = ""  # of a CAN log: vesc | dronecan | nmea2000
    rig: Path | None = None  # names and scales the outputs of an autopilot
    system: int | None = None  # MAVLink system, where a tlog has several
    topics: frozenset[str] = frozenset()  # those wanted; none: all
