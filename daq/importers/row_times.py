"""Times of the rows of a table, from the column that a map names: numbers, dates, times of day, GPS weeks."""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks import too_many_rows_missing
from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.importers.import_map import DAY_COUNTS, GPS_UNITS, TIME_UNITS, TimeColumn
from seatrial.daq.importers.table import Column, Table
from seatrial.daq.protocol import ubx

DAY = 86400.0  # s
HOUR = 3600.0  # s
LABVIEW_EPOCH = -2_082_844_800.0  # s since 1970; 1904-01-01
_ZONE = re.compile(r"(Z|[+-]\d\d:?\d\d)$")  # at the end of an ISO time
_LONG_FRACTION = re.compile(r"([.,]\d{6})\d+")  # %f reads at most six digits
# Hours of the night and months in which daylight saving time begins or ends. Nearly all countries change on a Sunday.
_LAST_HOUR, _MONTHS, _SUNDAY = 4, (3, 4, 9, 10, 11), 6


def row_times(table: Table, time: TimeColumn | None, *, lenient: bool = False) -> Column:
    """Return the time of each row of a table, from its time column or by the rate of the rows.

    Parameters
    ----------
    table
        The rows. Its remark gets a text about rows without a time and about changes of daylight saving time.
    time
        Source of the times; None if the table has its own times. A table with its own times keeps them unless `time`
        has a rate or names one of its columns.
    lenient
        Whether a row with a cell that is not a time gets NaN. Otherwise it is an error.

    Returns
    -------
    Column
        Times [s] of the file's clock, shape (n,), before the origin of the map is added. With a rate they begin at 0.

    Raises
    ------
    SeatrialError
        If a cell has no time of this format; with ``lenient``, if too many cells have none. Also if the table lacks the
        column, or ``time`` is None and the table has no times of its own.
    """
    if time is not None and time.rate_hz:
        return np.arange(len(table)) / time.rate_hz
    if table.t is not None and (time is None or time.column not in table.names):
        return table.t
    if time is None:
        raise SeatrialError(
            f"{table.path}: the file has no times of its own; give column = ... (or rate_hz = ...) in [time] of the "
            "import map"
        )
    if not time.is_text:
        raw = table.numbers(time.column)
        t = _seconds_of_numbers(raw, table.numbers(time.date) if time.date else np.zeros(len(raw)), time.format)
        untimed = np.flatnonzero(np.isnan(t))
        if len(untimed) and not _may_leave_out_untimed_rows(untimed, t, lenient):
            problem = "there is no time; remove this line of the table"
            if lenient:  # such lines are left out, but these are too many
                n = counted(len(untimed), "row")
                problem = f"there is no time in {n} from here on; name another column in [time] of the import map"
            raise table.error(int(untimed[0]), time.column, problem)
    else:
        t = _seconds_of_text(table, time, lenient)
        untimed = np.flatnonzero(np.isnan(t))
        known = np.isfinite(t)
        if "%" in time.format:
            t[known] = _continued_after_midnight(t[known], time.format)
    if len(untimed):
        row = int(untimed[0])
        _add_remark(table, f"{counted(len(untimed), 'row')} without a time left out, the first is row {row + 1}")
    is_zoned = "%z" in time.format or time.format.endswith(("UTC", "GMT"))
    if time.format == "iso":
        is_zoned = bool(_ZONE.search(next(iter(table.text(time.column)), "").strip()))
    if time.format != "s" and time.format not in GPS_UNITS and not is_zoned:
        _take_out_clock_changes(table, t, time)
    return t


def _seconds_of_numbers(raw: Column, weeks: Column, form: str) -> Column:
    """Convert the numbers `raw` (n,) of a time column to s, shape (n,), by their format `form`.

    The format is a unit of time ("ms"), days of a spreadsheet or of MATLAB ("excel", "datenum"), "labview", "gps" or
    "gps_ms". `weeks` (n,) are the GPS weeks, which only the last two use.
    """
    if form in TIME_UNITS:
        return raw * TIME_UNITS[form]
    if form in DAY_COUNTS:
        return (raw - DAY_COUNTS[form]) * DAY
    if form == "labview":
        return raw + LABVIEW_EPOCH
    return gps_seconds(weeks, raw * GPS_UNITS[form])


def gps_seconds(weeks: Column, seconds: Column) -> Column:
    """Convert GPS weeks and seconds of the week to UTC.

    Parameters
    ----------
    weeks, seconds
        GPS weeks, and seconds [s] in the week, each (n,).

    Returns
    -------
    Column
        UTC [s since 1970], (n,), by the leap seconds up to 2017. NaN stays NaN.
    """
    gps = ubx.GPS_EPOCH + weeks * ubx.WEEK + seconds
    return np.array([ubx.gps_to_utc(t) for t in gps.tolist()])


def _seconds_of_text(table: Table, time: TimeColumn, lenient: bool) -> Column:
    """Convert the text cells of a time column to s (n,). With `lenient`, a cell of another format becomes NaN.

    Blanks around a cell are ignored. If the map names a column of dates, the date stands before the time of day. Raise
    SeatrialError if a cell is of another format and `lenient` is False. With `lenient`, raise it if too many cells are
    of another format: all cells, or at least 5 cells and more than 5 %.
    """
    parse = _cell_parser(time)
    text = dated(table, time.date, time.column) if time.date else [cell.strip() for cell in table.text(time.column)]
    found = np.full(len(text), np.nan)
    first: ValueError | None = None
    for row, cell in enumerate(text):
        try:
            found[row] = parse(cell)
        except ValueError as error:
            first = first or error
            if not lenient:
                break
    wrong = np.flatnonzero(np.isnan(found))
    if len(wrong) and not _may_leave_out_untimed_rows(wrong, found, lenient):
        row = int(wrong[0])
        problem = f"'{text[row][:40]}' is not a time of format {time.format}"
        form = "its strptime pattern" if "%" in time.format else "its format"
        raise table.error(
            row, time.column, f"{problem}; give {form} as `format` in [time] of the import map"
        ) from first
    return found


def dated(table: Table, date: str, time: str) -> list[str]:
    """Join the date and the time of day of each row of a table, which are in two columns, by a blank.

    Parameters
    ----------
    table
        The table.
    date, time
        Names of the columns. An empty date stands for the date of the row above, and is "" in the first row.

    Returns
    -------
    list of str
        Date and time of each row.
    """
    texts, day = [], ""
    for cell, clock in zip(table.text(date), table.text(time), strict=True):
        day = cell.strip() or day
        texts.append(f"{day} {clock.strip()}")
    return texts


def _may_leave_out_untimed_rows(untimed: NDArray[np.intp], t: Column, lenient: bool) -> bool:
    """Return whether the rows without a time (indices `untimed`) may be left out of a table (times `t`, shape (n,)).

    This needs `lenient`, some row with a time, and fewer than 5 rows, or at most 5 %, without one. If more cells have
    no time, the format is probably wrong.
    """
    return lenient and len(untimed) < len(t) and not too_many_rows_missing(len(untimed), len(t))


def _continued_after_midnight(t: Column, form: str) -> Column:
    """Return times of day `t` (n,) [s] that go on beyond 24 h after midnight, instead of starting again at 0.

    A fall by more than half a day starts the next day. `form` is their strptime pattern. For a pattern without hours
    the period is one hour instead of a day. `t` is changed in place. Times that are not all within one day (or hour)
    are not changed.
    """
    period = DAY if any(part in form for part in ("%H", "%I", "%c", "%X", "%T", "%s")) else HOUR
    if len(t) and np.all(t < period):
        t[1:] += period * np.cumsum(np.diff(t) < -period / 2)
    return t


def _add_remark(table: Table, text: str) -> None:
    """Add a text to the remark of an imported table, unless the remark contains it already."""
    if text not in table.remark:
        table.remark = "; ".join(part for part in (table.remark, text) if part)


def _take_out_clock_changes(table: Table, t: Column, time: TimeColumn) -> None:
    """Remove the hour of a change between standard and daylight saving time from local times t (n,) [s], in place.

    The change is a step of one hour, forward or back, added to the usual step. It is at a full hour of a Sunday night
    in spring or autumn. The rows after it are moved, with a remark of the table. A step of an hour at any other time is
    a pause of the logger, or a clock that was set. It is kept, with a remark. Steps forward and steps back are judged
    separately. If several steps of one direction have this size, or a step back is larger, the steps of this direction
    are kept without a remark. Nothing is done for fewer than 11 rows with a time, or rows 60 s or more apart. `time`
    has the origin of the times.
    """
    known = np.flatnonzero(np.isfinite(t))
    steps = np.diff(t[known])
    if len(steps) < 10:
        return
    usual = float(np.median(steps))
    if not 0.0 < usual < 60.0:
        return
    for sign, change in ((-1.0, "ends"), (1.0, "begins")):
        rows = np.flatnonzero(np.abs(steps - usual - sign * HOUR) <= 2.0 * usual)
        # More than one such step, or larger steps back, do not come from daylight saving time.
        if len(rows) != 1 or (sign < 0.0 and np.any(steps < -2.0 * usual - HOUR)):
            continue
        before, row = int(known[rows[0]]), int(known[rows[0] + 1])
        is_full_hour = t[row] % HOUR <= max(2.0 * usual, 1.0)
        if not (is_full_hour and all(_may_daylight_time_change(t[k] + time.origin) for k in (before, row))):
            _add_remark(
                table,
                f"times step by {sign:+.0f} h at row {row + 1}, which is not a change of daylight saving time: the "
                "times are kept; check the clock of the logger",
            )
            continue
        t[row:] -= sign * HOUR
        _add_remark(table, f"daylight saving time {change} at row {row + 1}: later times are moved by {-sign:+.0f} h")


def _may_daylight_time_change(t: float) -> bool:
    """Return whether daylight saving time may begin or end at the local time of a row, `t` [s since 1970].

    This is between 0 and 5 o'clock on a Sunday in March, April, September, October or November. For a time without a
    date, below 2 days, every day may be the day of the change.
    """
    moment = datetime(1970, 1, 1) + timedelta(seconds=float(t))
    is_night = moment.hour <= _LAST_HOUR
    has_date = t > 2 * DAY  # a smaller time is a time of day without a date
    return is_night and (not has_date or (moment.weekday() == _SUNDAY and moment.month in _MONTHS))


def read_date(text: str, pattern: str) -> datetime:
    """Read the date and time in a cell of a table by a strptime pattern.

    Parameters
    ----------
    text
        Date and time. The fraction of a second may be missing, as many loggers write whole seconds. Digits after the
        sixth are cut off.
    pattern
        The strptime pattern.

    Returns
    -------
    datetime
        Date and time.

    Raises
    ------
    ValueError
        If the text does not match the pattern.
    """
    try:
        return datetime.strptime(text, pattern)
    except ValueError:
        if "%f" not in pattern:
            raise
    shorter = _LONG_FRACTION.sub(r"\1", text)
    if shorter != text:
        return datetime.strptime(shorter, pattern)
    return datetime.strptime(text, re.sub(r"[.,:]%f", "", pattern))


def _cell_parser(time: TimeColumn) -> Callable[[str], float]:
    """Return a function that converts a text cell of a time column to s. The function raises ValueError.

    `time` has the format, and how digits behind the last point are read. ValueError means a text of another format. A
    date without a zone is UTC, one without a year is in 1970, and a time of day is on 1970-01-01.
    """

    def whole(text: str) -> float:
        """Convert a cell of a time column to s by its format alone: a number, an ISO date, or a strptime pattern.

        A date without a year is in 1970. A date without a zone is UTC. Raise ValueError for another format.
        """
        if time.format == "s":
            return float(text)
        iso = time.format == "iso"
        moment = datetime.fromisoformat(text) if iso else read_date(text, time.format)
        if moment.year == 1900 and not iso and "%Y" not in time.format:  # strptime's default year
            moment = moment.replace(year=1970)
        return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()

    def split(text: str) -> float:
        """Convert the text before the last point of a time cell to s, and add the digits behind the point.

        They are a decimal fraction, or a number of ns if `fraction` of the time column is "unpadded-ns". After a minus
        sign they are subtracted. A text without a point is converted by its format alone. Raise ValueError if the
        digits are not one to nine.
        """
        head, point, tail = text.rpartition(".")
        if not point:
            return whole(text)
        if not (tail.isascii() and tail.isdigit()) or len(tail) > 9:
            raise ValueError(text)
        # unpadded-ns: the logger wrote seconds, a point, and the nanoseconds as a number without leading zeros
        part = int(tail) * 1e-9 if time.fraction == "unpadded-ns" else float(f"0.{tail}")
        return whole(head) + (-part if head.lstrip().startswith("-") else part)

    return split if time.fraction else whole
