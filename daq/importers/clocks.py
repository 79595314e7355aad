"""Recogniser of the clock of a table: the column with the times of its rows, their format, and a caveat about it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from datetime import datetime
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.import_map import TIME_UNITS, TimeColumn
from seatrial.daq.importers.recognise import Name, drive_words, read_name
from seatrial.daq.importers.row_times import LABVIEW_EPOCH, dated, read_date, row_times
from seatrial.daq.importers.table import Column, Table

_TIME = re.compile(
    r"(^|_)(t|time|stamp|timestamp|datetime|date|utc|seconds|secs|epoch|tow|zeit|datum|uhrzeit|zeitstempel|heure|hora|"
    r"fecha|tijd|x_value)($|_)"
)
_TOW = {"tow", "gps_tow", "gpstow", "itow", "i_tow", "time_of_week", "gps_time_of_week", "gps_ms", "gms", "gps_seconds"}
_WEEK = {"week", "gps_week", "gpsweek", "wn", "gwk", "week_number", "gps_week_number", "wno"}
_WEEKS_OF_EPOCH = 1024  # old receivers count the GPS weeks modulo this number
DATES = (1e9, 3e9)  # s since 1970: the years 2001 to 2065
FASTEST, SLOWEST = 5e-4, 60.0  # s between rows of the loggers of boats
ODD = 2.0  # s between rows; a longer step is more likely to be in milliseconds
DATENUM = (7e5, 8e5)  # days of MATLAB: the years 1916 to 2190
LEAST_RISING = 0.005  # share of rising steps that a column named "time" needs at least
COARSE_ROWS, FEWEST_STAMPS, EVEN = 2, 5, 0.9  # rows per stamp; stamps; share of stamps with the mean number of rows
EXCEL = (36892.0, 71700.0)  # days of Excel: the years 2001 to 2096
TRIED = 400  # texts of a column with which the patterns of dates are tried
_DAYS: tuple[str, ...] = (
    "%d.%m.%Y",
    "%d.%m.%y",
    "%d/%m/%Y",
    "%m/%d/%Y",
    "%d/%m/%y",
    "%m/%d/%y",
    "%Y/%m/%d",
    "%Y.%m.%d",
    "%d-%m-%Y",
)
_DAYS += ("%m-%d-%Y", "%d-%b-%Y", "%d %b %Y", "%b %d %Y", "%Y%m%d", "%Y:%m:%d", "%Y-%m-%d")
_DAYS += ("%d-%b-%y", "%d-%m-%y", "%d.%b.%Y", "%d/%b/%Y", "%d %B %Y", "%B %d %Y", "%Y-%j", "%Y/%j")
_CLOCKS = (
    "%H:%M:%S",
    "%H:%M:%S.%f",
    "%H:%M:%S,%f",
    "%H:%M:%S:%f",
    "%I:%M:%S %p",
    "%I:%M:%S.%f %p",
    "%H:%M",
    "%I:%M %p",
)
# Times of day behind a date. Some of these patterns would match a number or a date if no date stood in front.
_BEHIND_DAYS = (*_CLOCKS, "%H%M%S", "%H%M%S.%f", "%H-%M-%S", "%H-%M-%S.%f")
_MINUTES = ("%M:%S.%f", "%M:%S,%f", "%M:%S")  # minutes and seconds of an hour
_DIGITS = re.compile(
    r"20\d\d(0[1-9]|1[0-2])([0-2]\d|3[01])([01]\d|2[0-3])([0-5]\d){2}(\.?\d{1,6})?"
)  # 20240512130000.1
MOST_DAYS = 3.0  # days; longest time that is recognised as fractions of a day
_COMPACT = {6: "%d%m%y", 8: "%Y%m%d"}  # dates of digits only, by the number of digits
_WHOLE = ("%a %b %d %H:%M:%S %Y", "%a %b %d %H:%M:%S.%f %Y", "%a, %d %b %Y %H:%M:%S", "%a, %d %b %Y %H:%M:%S.%f")
_BOTH = tuple(f"{day}{blank}{clock}" for day in _DAYS for clock in _BEHIND_DAYS for blank in (" ", "T", ", ", "_", "-"))
_ZONE = re.compile(r"( ?)(?:((?!AM|PM)[A-Z]{3,5})|Z|[+-]\d\d:?\d\d)$")
FEW = 0.05  # share of the texts of a column; a rarer shape of text is not a time
_COUNTS = {"index", "row", "id"}  # names of columns that rise evenly but are not times
_ZONES = {"utc", "gmt", "local"}  # words that stand in the place of the unit of a time


class Clock(NamedTuple):
    """Column with the times of a table's rows, and the format of these times.

    Attributes
    ----------
    column : str
        Column of the times; "" if the table has its own times, or if no column of times was found.
    form : str
        Format of the times, as in the table [time] of an import map: a unit, "iso", "gps", ... or a strptime pattern.
    caveat : str
        What is uncertain in the format, for a comment in the map; "" if there is none.
    rate : float
        Rate of the rows [Hz] if it replaces stamps that several rows share, else 0.
    start : float
        Time of the first row [s] if `rate` is not 0.
    date : str
        Column of the dates or of the GPS weeks; "" if the times need none.
    """

    column: str = ""  # "" if the table has its own times, or no times
    form: str = "s"  # format as in [time] of a map
    caveat: str = ""
    rate: float = 0.0  # Hz; rate of the rows if several rows share each stamp, else 0
    start: float = 0.0  # s; time of the first row, if `rate` is not 0
    date: str = ""  # column of the dates or GPS weeks, as in [time] of a map


def clock_of(table: Table) -> Clock:
    """Find the column with the times of a table's rows, and their format, by the names and values of the columns.

    The first column whose name or type is that of a time, and whose values may be times, is taken. The order is:
    exactly "t", "time" or "timestamp" (or the German words); seconds by the type in the source; times of a GPS week;
    names that contain such a word. A column with dates but without a time of day is skipped in this search. If no
    column is found, one of the first two columns is taken if it contains dates or times as text or rises evenly, and
    its name is not that of a signal, a thruster or a row number. Columns without a name, or with a name that appears
    more than once, are never taken.

    Parameters
    ----------
    table
        The table of a source file.

    Returns
    -------
    Clock
        The column and its format. The column is "" if the table has its own times, or if no column is recognised.
    """
    if table.t is not None:
        return Clock()
    names = [name for name in table.names if name and table.names.count(name) == 1]
    plain = {name: read_name(name).plain for name in names}
    strict = [name for name in names if plain[name] in ("t", "time", "timestamp", "uhrzeit", "zeit")]
    loose = [name for name in names if _TIME.search(plain[name])]
    dates = [name for name in loose if _is_text(table, name) and _day_format(table.text(name))]
    in_week = [name for name in names if plain[name] in _TOW]
    weeks = [name for name in names if plain[name] in _WEEK]
    # If date and time of day have a column each, the date is the same in all rows and cannot be the time.
    for name in (*strict, *(name for name in names if name in table.seconds), *in_week, *loose):
        if name not in dates and _may_be_time(table, name):
            return _named_clock(table, name, dates, weeks if name in in_week else ())
    for name in strict:  # stamps coarser than the rows, or rows out of order: the name is clear enough
        if name not in dates and _may_be_time(table, name, LEAST_RISING):
            return _named_clock(table, name, dates, ())
    # No column has the name of a time: accept a first column that rises evenly and does not have the name of a signal.
    for name in names[:2]:  # the first column may contain the name of a boat or of a run
        column_name = read_name(name)
        if column_name.meaning or drive_words(column_name.words) or column_name.words & _COUNTS:
            continue
        try:
            values = table.numbers(name)
        except SeatrialError:  # text
            if form := format_of_text(table.text(name))[0]:
                return Clock(name, form, f"{name!r} has dates and is assumed to be the time")
            continue
        if _may_be_time(table, name) and _rises_evenly(values):
            form, _ = _time_format(table, name)
            place = "first" if name == table.names[0] else "second"
            return Clock(name, form, f"its {place} column rises evenly and is assumed to be the time")
    return Clock()


def has_named_times(table: Table) -> bool:
    """Return whether a table has a column of times that its name shows (`clock_of`)."""
    return bool(_TIME.search(read_name(clock_of(table).column).plain))


def _named_clock(table: Table, name: str, dates: Sequence[str], weeks: Sequence[str]) -> Clock:
    """Return the clock of a table whose time column is `name`: its format, and its column of dates or GPS weeks.

    `dates` and `weeks` are names of columns of dates and GPS weeks; the first of each is used. A GPS week completes
    times in s or ms, with a caveat if it counts modulo 1024. A date completes times of day, if both together are
    readable. Times and dates of digits only (hhmmss, ddmmyy) are recognised too. If several rows share each stamp, the
    clock may get the rate of the rows (`_with_row_rate`).
    """
    form, caveat = _time_format(table, name)
    clock = Clock(name, form, caveat)
    if weeks and form in ("s", "ms"):
        clock = Clock(name, "gps" if form == "s" else "gps_ms", date=weeks[0])
        if float(np.nanmax(table.numbers(weeks[0]), initial=0.0)) < _WEEKS_OF_EPOCH:
            caveat = f"{weeks[0]!r} is counted modulo 1024: add 1024 or 2048 weeks by origin of [time]"
            clock = clock._replace(caveat=caveat)
    elif dates and form.startswith(("%H", "%I")):
        form, caveat = format_of_text(dated(table, dates[0], name))
        if form == "iso" or "%d" in form or "%j" in form:
            clock = Clock(name, form, caveat, date=dates[0])
    elif form == "s" and (compact := _digits_only_clock(table, name)) is not None:
        clock = compact
    return _with_row_rate(table, clock)


def _digits_only_clock(table: Table, name: str) -> Clock | None:
    """Return the clock of a table whose times and dates are digits only, as 130000.5 (hhmmss) and 120524 (ddmmyy).

    `name` is the column of the times. The column of the dates is found by its name; a date of 8 digits is yyyymmdd, one
    of 6 digits ddmmyy. The first column that fits is taken. Return None if the times are not of this form, or no column
    of dates fits.
    """
    times = _typical_texts(table.text(name))
    if not times or not all(re.fullmatch(r"([01]\d|2[0-3])([0-5]\d){2}(\.\d+)?", text) for text in times):
        return None
    clock = "%H%M%S.%f" if any("." in text for text in times) else "%H%M%S"
    for date in (
        column for column in table.names if column and read_name(column).words & {"date", "datum", "day", "utcdate"}
    ):
        days = _typical_texts(table.text(date)) if table.names.count(date) == 1 else []
        pattern = _COMPACT.get(len(days[0]) if days else 0)
        if pattern is None or any(len(day) != len(days[0]) for day in days):
            continue
        if _reads_all(partial(read_date, pattern=pattern), days):
            return Clock(name, f"{pattern} {clock}", "", date=date)
    return None


def _is_text(table: Table, name: str) -> bool:
    """Return whether a column of a table is text, so that it cannot be read as numbers."""
    try:
        table.numbers(name)
    except SeatrialError:
        return True
    return False


def row_seconds(table: Table, clock: Clock) -> Column | None:
    """Return the times of a table's rows [s], shape (n,), from the column in `clock`; None if they cannot be read.

    A row without a time has NaN, and a remark of the table counts these rows. Stamps that several rows share are not
    spread: `clock.rate` is not used. If `clock` names no column, return the table's own times, which may be None.
    """
    if not clock.column:
        return table.t
    try:
        return row_times(table, TimeColumn(clock.column, clock.form, clock.date), lenient=True)
    except SeatrialError:
        return None


def _rises_evenly(values: Column) -> bool:
    """Return whether the values of a column (n,) rise evenly, as the times of rows at a fixed rate do.

    This is so if there are more than 10 steps, all are positive, and the largest step exceeds the smallest by less than
    half the mean.
    """
    steps = np.diff(values)
    return bool(len(steps) > 10 and np.all(steps > 0.0) and np.ptp(steps) < 0.5 * np.mean(steps))


def _with_row_rate(table: Table, clock: Clock) -> Clock:
    """Add the rate of the rows [Hz] to a clock whose time stamps are coarser than the rows, as whole seconds at 10 Hz.

    The rate, and the time of the first row in `start`, are set, with a caveat that replaces that of the clock, if the
    stamps are even, and if more than 90 % of them (without the first and the last) have about the same number of rows.
    Otherwise the clock only gets a caveat, which also replaces its own. The clock is returned unchanged if times fall
    or are missing, if most stamps have a single row, or if there are fewer than 7 stamps.
    """
    t = row_seconds(table, clock)
    if t is None or not np.all(np.diff(t) >= 0.0):  # also for NaN
        return clock
    _, count = np.unique(t, return_counts=True)
    inner = count[1:-1]
    if len(inner) < FEWEST_STAMPS or np.median(inner) < COARSE_ROWS:
        return clock
    seconds = np.unique(t)
    rate = float(inner.sum() / (seconds[-1] - seconds[1]))
    even = float(np.mean(np.abs(inner - inner.mean()) <= 1.0)) > EVEN
    steady = float(np.ptp(np.diff(seconds))) < 0.5 * float(np.median(np.diff(seconds)))
    caveat = f"the stamps of {clock.column!r} are coarser than the rows: "
    if even and steady:
        start = float(seconds[1]) - float(count[0]) / rate
        caveat += "they are replaced by even times at the rate of the rows"
        return clock._replace(rate=rate, start=start, caveat=caveat)
    return clock._replace(caveat=f"{caveat}rows are left out; to keep them, write rate_hz = {rate:.4g}, the mean rate")


def _may_be_time(table: Table, name: str, rising: float = 0.5) -> bool:
    """Return whether a column may be the time of the rows, by its values.

    More than the share `rising` (0 to 1) of the steps between its numbers must be positive; fewer than two numbers give
    False. Texts must have a digit in the first 20 rows, at least two different texts, and more than one different text
    per 1000 rows.
    """
    try:
        values = table.numbers(name)
    except SeatrialError:  # dates are text
        texts = table.text(name)
        return any(c.isdigit() for text in texts[:20] for c in text) and len(set(texts)) > max(1, len(texts) // 1000)
    good = values[np.isfinite(values)]
    return len(good) > 1 and float(np.mean(np.diff(good) > 0.0)) > rising


def _time_format(table: Table, column: str) -> tuple[str, str]:
    """Return the format of a column of times, for example "ms", "iso" or "%H:%M:%S", and the caveat about it.

    The caveat is "" if the format is certain. A column that the file declares as seconds has the format "s". A unit in
    the name counts, unless only steps in seconds fit a logger. Numbers of 14 digits or more that begin with a year, as
    20240512130000, are dates. Without a unit the size of the numbers decides. Texts that are not recognised have the
    format "%d.%m.%Y %H:%M:%S" with a caveat.
    """
    if column in table.seconds:
        return "s", ""
    try:
        values = table.numbers(column)
    except SeatrialError:
        form, caveat = format_of_text(table.text(column))
        shown = next((text.strip() for text in table.text(column) if text.strip()), "")[:40]
        return form or "%d.%m.%Y %H:%M:%S", caveat or "" if form else (
            f"times like {shown!r} are not recognised: write their strptime pattern as format, and fraction if needed"
        )
    if _DIGITS.fullmatch(next((text.strip() for text in table.text(column) if text.strip()), "")):
        patterns = ("%Y%m%d%H%M%S", "%Y%m%d%H%M%S.%f", "%Y%m%d%H%M%S%f")
        if fitting := [
            pattern
            for pattern in patterns
            if _reads_all(partial(read_date, pattern=pattern), _typical_texts(table.text(column)))
        ]:
            return fitting[0], ""
    name = read_name(f"{column} [{table.units[column]}]" if column in table.units else column)
    values = values[np.isfinite(values)]
    if name.unit in TIME_UNITS:
        step = float(np.median(np.diff(values)))
        if TIME_UNITS[name.unit] * step < FASTEST <= step < SLOWEST:
            return "s", f"steps of {step:.4g} are assumed to be seconds, although the name has {name.unit}"
        return name.unit, ""
    form, caveat = _format_of_numbers(values, name)
    no_unit = name.no_unit or name.unit
    if no_unit and no_unit.lower() not in _ZONES:
        odd = f"{no_unit!r} in {column!r} is not a unit of time; the units are {', '.join(TIME_UNITS)}"
        caveat = "; ".join(part for part in (odd, caveat) if part)
    return form, caveat


def format_of_text(texts: Sequence[str]) -> tuple[str, str]:
    """Return the format of dates or times of day in text form, and the caveat about it.

    If patterns with the day first and with the month first both fit, as for 05/06/2024, the day comes first, or the
    month if the times have AM or PM; the caveat reports the order. Texts of a rare shape (at most 5 %) do not count.
    Times of day without a date have a caveat too.

    Parameters
    ----------
    texts
        The cells of the column.

    Returns
    -------
    tuple of str
        ``iso`` or a strptime pattern, "" if no pattern fits or all cells are blank; and the caveat, "" if the format is
        certain or "".
    """
    tried = _typical_texts(texts)
    if not tried:
        return "", ""
    if not tried[0].replace(".", "").isdigit() and _reads_all(datetime.fromisoformat, tried):
        return "iso", ""
    fitting = [
        pattern for pattern in _fitting_patterns(tried, (*_CLOCKS, *_WHOLE, *_BOTH)) if not _is_unpadded(pattern, tried)
    ]
    fitting = fitting or _fitting_patterns(tried, _MINUTES)
    fitting = [pattern for pattern in fitting if "%f" in pattern] or fitting
    if not fitting:
        return "", ""
    found, caveat = fitting[0], ""
    orders = {pattern.index("%d") < pattern.index("%m") for pattern in fitting if "%m" in pattern and "%d" in pattern}
    if found in _MINUTES:
        caveat = f"times like {tried[0]!r} are assumed to be minutes and seconds that start again each hour"
    elif found.startswith(("%H", "%I")):
        caveat = 'times of day without a date: give the date, origin = "2025-05-01"; otherwise it is 1970-01-01'
    elif len(orders) == 2:
        if "%p" in found:  # countries that write AM and PM put the month first
            found = next(pattern for pattern in fitting if pattern.startswith("%m"))
        order = "month" if found.startswith("%m") else "day"
        caveat = f"dates like {tried[0]!r} are read with the {order} first"
    return found, caveat


def _fitting_patterns(texts: Sequence[str], patterns: Sequence[str]) -> list[str]:
    """Return the strptime patterns, out of `patterns` and in their order, that read all texts.

    If the first text ends with a time zone, patterns with this zone are tried too and come last. The list is empty if
    no pattern reads all texts.
    """
    fitting = []
    zone = _ZONE.search(texts[0])
    for end in ("", zone[1] + (zone[2] or "%z")) if zone else ("",):
        shapes = {_text_shape(_ZONE.sub("", text) if end else text) for text in texts}
        for pattern in patterns:
            if shapes <= _pattern_shapes(pattern) and _reads_all(partial(read_date, pattern=pattern + end), texts):
                fitting.append(pattern + end)
    return fitting


def _text_shape(text: str) -> str:
    """Return the shape of a text in a time column: each number becomes 0 and each word a.

    The text "12 May 2024" has the shape "0 a 0".
    """
    return re.sub(r"[^\W\d_]+", "a", re.sub(r"\d+", "0", text))


@cache
def _pattern_shapes(pattern: str) -> frozenset[str]:
    """Return the shapes of the texts that a strptime pattern reads, with and without the fraction of a second.

    In a shape each number is 0 and each word is a: "%d %b %Y" has the shape "0 a 0". The result is stored for the next
    call.
    """
    shapes = [
        re.sub("%[bBpa]", "a", re.sub("%[dmYyHIMSfj]", "0", p)) for p in (pattern, re.sub("[.,:]%f", "", pattern))
    ]
    return frozenset(_text_shape(shape) for shape in shapes)


def _is_unpadded(pattern: str, texts: Sequence[str]) -> bool:
    """Return whether a pattern has milliseconds behind a colon that some texts do not write with exactly 3 digits.

    Such a logger leaves out leading zeros, so that 12:00:00:5 means 5 ms. The pattern would read half a second.
    """
    return ":%f" in pattern and not all(re.search(r":\d{3}(\D|$)", text) for text in texts)


def _typical_texts(texts: Sequence[str]) -> list[str]:
    """Return at most 800 different texts of a column of times, taken evenly over the file, without blank texts.

    Texts whose shape (the places of numbers and words) at most 5 % of them have are left out, because they are not
    times: ERR, OVERFLOW.
    """
    # Over the whole file a day above 12 is likely; only such a day shows the order of day and month.
    filled = [text.strip() for text in texts if text.strip()]
    tried = list(dict.fromkeys(filled[:: max(1, len(filled) // TRIED)] + filled[-1:]))
    shapes = [_text_shape(text) for text in tried]
    number = Counter(shapes)
    return [text for text, shape in zip(tried, shapes, strict=True) if number[shape] > FEW * len(tried)]


def _day_format(texts: Sequence[str]) -> str:
    """Return the first strptime pattern that reads texts as dates without a time of day; "" if none does.

    Only the typical texts of the column are tried; rare other texts do not count.
    """
    tried = _typical_texts(texts)
    return next(iter(_fitting_patterns(tried, _DAYS)), "") if tried else ""


def _reads_all(read: Callable[[str], object], texts: Sequence[str]) -> bool:
    """Return whether a parser of times, the function `read`, reads all texts without a ValueError.

    The result is True without texts. Other errors than ValueError are not caught.
    """
    try:
        for text in texts:
            read(text)
    except ValueError:
        return False
    return True


def _format_of_numbers(values: Column, name: Name) -> tuple[str, str]:
    """Return the format of times that are numbers (n,), by their size and their median step, and the caveat about it.

    The numbers must be finite, and at least two. The format is a unit ("s", "ms", "us", "ns", "day"), "labview",
    "datenum" or "excel". Seconds, ms, us or ns since 1970 are tried first, then LabVIEW, MATLAB and Excel, then
    fractions of a day, and then the size of the steps: from 2e6 on they are ns, from 2000 on us, from 2 on ms. The
    default is "s". The caveat is "" if size and step are clear. `name` has the unit and the words in the name of the
    column.
    """
    top, steps = float(np.max(np.abs(values))), np.diff(values)
    step = float(np.median(steps))
    for unit, size in ((name_of_unit, TIME_UNITS[name_of_unit]) for name_of_unit in ("s", "ms", "us", "ns")):
        if DATES[0] < size * top < DATES[1] and size * step < SLOWEST:
            odd = size * step >= ODD
            caveat = f'{top:.6g} is assumed to be seconds since 1970; a time since the start may be in "ms"'
            return unit, caveat if odd else ""
    if DATES[0] < top + LABVIEW_EPOCH < DATES[1] and step < SLOWEST:
        return "labview", ""
    if DATENUM[0] < top < DATENUM[1] and ("date" in name.words or 0.0 < step < FASTEST):
        return "datenum", ""
    if EXCEL[0] < top < EXCEL[1] and 0.0 < step < FASTEST:
        return (
            "excel",
            'days of Excel since 1900 are assumed; a workbook that counts from 1904 has format = "excel1904"',
        )
    if FASTEST < step * TIME_UNITS["day"] < ODD and step < FASTEST and top < MOST_DAYS and not name.unit:
        return "day", f"steps of {step:.4g} are assumed to be fractions of a day"
    for unit, usual, word in (("ns", 2e6, "nano"), ("us", 2e3, "micro"), ("ms", 2.0, "milli")):
        if step >= usual:
            return unit, f"steps of {step:.4g} are assumed to be {word}seconds"
    # Hours, minutes and seconds in one number, 120059, 120100: no part is above 59, and at the end of a minute the
    # number steps by 40 more.
    parts = values >= 0.0, values < 240000.0, values % 100.0 < 60.0, values // 100.0 % 100.0 < 60.0
    if np.all(parts) and (values[0] >= 1e4 or np.any(np.abs(steps - step - 40.0) < 0.5)):
        return "s", f'{values[0]:.6g} is assumed to be seconds; a time of day, hhmmss, has format = "%H%M%S"'
    if step < FASTEST or (step >= 1.0 and not np.any(values % 1.0)):
        return "s", f"steps of {step:.4g} are assumed to be seconds"
    return "s", ""
