"""Tables of an import: each source is read as one table for each topic, with named columns and times of the rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.clock import CLOCK_STEP_S
from seatrial.daq.errors import SeatrialError, closest_name, counted, first_names
from seatrial.daq.samples import Event

Column = NDArray[np.float64]
MAX_NAMED = 10  # columns that an error message lists


@dataclass
class Table:
    """Rows of one topic of a source file, or of the whole file, as columns of numbers and texts.

    Attributes
    ----------
    path : Path
        Source file.
    topic : str
        Topic of the rows; "" without one, for example in a file that is a single table.
    columns : dict
        Columns of numbers by name, each (n,); NaN for a row without a value.
    t : Array (n,) or None
        Times in order [s since 1970 or since the start]; None if the import map names the column or rate of the times.
    kind : str
        Type of the messages, for example "sensor_msgs/msg/Imu" or "vehicle_attitude" (PX4); "" for other tables.
    frame_id : str
        Frame in the header of ROS messages.
    remark : str
        What is unusual about the rows, for the user.
    clock : str
        What is unusual about the times, for the user. It is also stored in the log.
    vehicle : int or None
        MAV_TYPE in the log of an autopilot; None if unknown.
    parameters : dict
        Parameters of the autopilot by name, if its log has them.
    events : sequence
        Events of the whole source with their times [s since 1970]; only its first table has them.
    units : dict
        Units by column, as far as the source has them.
    texts : dict
        Columns of text by name.
    seconds : frozenset of str
        Columns with times or durations [s], by their type in the source.
    n_left_out : int
        Number of rows of the source that are not in the table because their times are wrong.
    lengths : dict
        Numbers of values of columns that have the same topic but another number of values, by name.
    strict : bool
        Whether rows out of order and cells without a number are errors unless the map allows them, as for text.
    """

    path: Path
    topic: str  # "" for a file that is a single table
    columns: Mapping[str, Column]  # by name, each (n,); NaN for a row without a value
    t: Column | None = None  # s since 1970 or since the start, (n,), in order; None: the map names the source of times
    kind: str = ""  # type of the messages: sensor_msgs/msg/Imu, vehicle_attitude (PX4), Ahrs
    frame_id: str = ""  # frame in the header of ROS messages
    remark: str = ""  # unusual things about the rows, for the user
    clock: str = ""  # unusual things about the times, for the user; also stored in the log, for a fit
    vehicle: int | None = None  # MAV_TYPE in the log of an autopilot; None: unknown
    parameters: Mapping[str, float] = field(default_factory=dict)  # of the autopilot, if its log has them
    events: Sequence[tuple[float, Event]] = ()  # of the whole source, s since 1970; only its first table has them
    units: Mapping[str, str] = field(default_factory=dict)  # by column, as far as the source has them
    texts: Mapping[str, Sequence[str]] = field(default_factory=dict)  # columns of text by name
    seconds: frozenset[str] = frozenset()  # columns with times or durations in s, by the type in the source
    n_left_out: int = 0  # rows of the source that are not in the table because their times are wrong
    lengths: Mapping[str, int] = field(default_factory=dict)  # of columns of the topic with another number of rows
    strict = False  # for text: rows out of order and cells without a number are errors unless the map allows them

    @property
    def names(self) -> Sequence[str]:
        """Names of the columns of the table: columns of numbers, then columns of text."""
        return [*self.columns, *self.texts]

    @property
    def full_remark(self) -> str:
        """Topic and remarks on its rows and times in one line, or "" without remarks."""
        remarks = "; ".join(part for part in (self.remark, self.clock) if part)
        return f"{self.topic}: {remarks}" if self.topic and remarks else remarks

    def __len__(self) -> int:
        """Return the number of rows of the table, n.

        A table without columns has 0 rows.
        """
        return len(next(iter((*self.columns.values(), *self.texts.values())), ()))

    def numbers(self, column: str) -> Column:
        """Return the values of a column of numbers of the table.

        Parameters
        ----------
        column
            Name of the column.

        Returns
        -------
        Column
            The numbers (n,), NaN for a cell without a value.

        Raises
        ------
        SeatrialError
            If the table has no such column, or the column is not numeric.
        """
        if column in self.texts:
            shown = "".join(self.texts[column][:1])[:40]
            raise self.error(0, column, f"{shown!r} is text, not a number; name another column in the import map")
        if column in self.lengths:
            here = f" of {self.topic}" if self.topic else ""
            raise SeatrialError(
                f"{self.path}: '{column}'{here} has {self.lengths[column]} values, but {first_names(self.names, 3)} "
                f"{'have' if len(self.names) > 1 else 'has'} {len(self)}; save them with the same number of values"
            )
        if column not in self.columns:
            what = "field" if self.topic else "column"
            raise SeatrialError(
                f"{self.path}: {self.topic or 'the table'} has no {what} '{column}'; {self._names_hint(column)}"
            )
        return self.columns[column]

    def _names_hint(self, column: str) -> str:
        """Return advice for an unknown column: the most similar one, or the columns of the table.

        Of many columns, the first ones and the number of the others. Elements of covariances are left out.
        """
        names = [name for name in self.names if "covariance" not in name.lower()]
        names += self.lengths
        # A field of ROS is more often given without the messages that contain it than misspelt: x for pose.position.x.
        ends = [name for name in names if name.lower().endswith(f".{column.lower()}")]
        if near := ends[0] if ends else closest_name(column, names):
            return f"did you mean '{near}'? Name a {'field' if self.topic else 'column'} of the file in the import map"
        return f"name one of these in the import map: {first_names(names, MAX_NAMED) or 'none'}"

    def text(self, column: str) -> list[str]:
        """Return the cells of a column of the table as texts (n,), for times that are not numbers.

        A column of numbers gives the shortest texts with the same values, "nan" for a cell without a value. Raise
        SeatrialError if the table lacks the column. The list is a copy.
        """
        return list(self.texts.get(column, ())) or [repr(value) for value in self.numbers(column).tolist()]

    def error(self, row: int, column: str, problem: str) -> SeatrialError:
        """Return an error that names the file, topic, column and row of a cell. The caller raises the error.

        `row` is counted from 0, but the message counts from 1. `problem` is the text of the error.
        """
        place = f"{self.topic}, '{column}'" if self.topic else f"'{column}'"
        return SeatrialError(f"{self.path}: {place}, row {row + 1}: {problem}")


def clock_remark(t: Column) -> str:
    """Return a remark if times run back in the order of a file, because a clock was set or there are two clocks.

    Parameters
    ----------
    t
        Times (n,) [s] in the order of the file.

    Returns
    -------
    str
        The remark, with the number of steps back and the largest one [s]; "" if no time runs back by more than 0.5 s
        (`CLOCK_STEP_S`).
    """
    back = -np.diff(t)
    far = back > CLOCK_STEP_S
    return f"its times ran back {counted(int(far.sum()), 'time')}, by up to {back.max():.1f} s" if far.any() else ""


@dataclass(frozen=True)
class TextStyle:
    """Style of a text table, and the handling of missing numbers, times and repeats for all kinds of sources.

    Attributes
    ----------
    delimiter : str
        One character between the cells, or "blank" for any number of blanks and tabs.
    decimal : str
        Decimal mark, "." or ",".
    encoding : str
        Encoding of the text.
    skip_rows : int
        Number of lines before the header.
    columns : tuple of str
        Names of the columns of a file without a header; empty if it has one.
    nan : str
        Treatment of a cell without a number: "error" (default for text), "drop" (default for other sources) or "keep".
    time_order : str
        Treatment of a row out of order: "error" (default for text) or "drop" (default for other sources).
    repeats : str
        "keep" or "drop" rows whose signals all repeat the row before; "" to drop held values, signal by signal.
    """

    delimiter: str = ","  # one character, or "blank": any number of blanks and tabs
    decimal: str = "."
    encoding: str = "utf-8-sig"
    skip_rows: int = 0  # lines before the header
    columns: tuple[str, ...] = ()  # names of the columns of a file without a header
    nan: str = ""  # cell without a number: error (default for text) | drop (default for other sources) | keep
    time_order: str = ""  # row out of order: error (default for text) | drop (default for other sources)
    repeats: str = ""  # keep | drop: rows whose signals all repeat the row before; "": drop held values, by signal


@dataclass(frozen=True)
class SourceOptions:
    """Options of an import map for reading a source file.

    Attributes
    ----------
    style : TextStyle
        Style of a text table.
    dbc : Path or None
        Database of the messages of a CAN log; None without one.
    protocol : str
        Protocol of a CAN log: "vesc", "dronecan" or "nmea2000"; "" to try all.
    rig : Path or None
        Rig file that names and scales the outputs of an autopilot, or whose CAN devices decode a CAN log; None without
        one.
    system : int or None
        MAVLink system number, for a tlog of several systems; None for the first autopilot.
    topics : frozenset of str
        Topics to read; empty for all.
    """

    style: TextStyle = field(default_factory=TextStyle)
    dbc: Path | None = None  # database of the messages of a CAN log
    protocol: str = ""  # of a CAN log: vesc | dronecan | nmea2000
    rig: Path | None = None  # rig that names and scales the outputs of an autopilot
    system: int | None = None  # MAVLink system number, for a tlog of several systems
    topics: frozenset[str] = frozenset()  # topics to read; empty: all
