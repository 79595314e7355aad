"""Tests of dialects of text tables: units rows, repeated headers, trailing separators, dates."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.daq.importers.guess import guess_map
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.log import open_log
from seatrial.daq.samples import Scalar

START = datetime(2024, 5, 12, 9, 0, 0, tzinfo=UTC)
N = 200
RATE_HZ = 10.0
COLUMNS = ("n_left", "n_right", "x", "y", "yaw [rad]", "yaw_rate [rad/s]")
RNG = np.random.default_rng(41)
VALUES = np.column_stack(
    [RNG.uniform(-0.9, 0.9, (N, 2)), RNG.uniform(-9.0, 9.0, (N, 2)), RNG.uniform(-1.0, 1.0, (N, 2))]
)


def table(
    first: str,
    text_of_time: Callable[[datetime], str],
    delimiter: str = ",",
    decimal: str = ".",
    end: str = "",
    header_end: str = "",
) -> str:
    lines = [delimiter.join([first, *COLUMNS]) + header_end]
    for k, row in enumerate(VALUES):
        cells = [f"{value:.4f}".replace(".", decimal) for value in row]
        lines.append(delimiter.join([text_of_time(START + timedelta(seconds=k / RATE_HZ)), *cells]) + end)
    return "\n".join(lines) + "\n"


def imported(folder: Path, text: str, encoding: str = "utf-8") -> tuple[np.ndarray, np.ndarray, str]:
    """Return the times and values of x after a guess and an import, and the text of the map."""
    source = folder / "run.csv"
    source.write_bytes(text.encode(encoding))
    guess = guess_map(source)
    assert guess.problem == ""
    (folder / "map.toml").write_text(guess.text)
    (log,) = import_files(folder / "map.toml", [source], out=folder / "run.mcap")
    with open_log(log) as opened:
        rows = opened.table(Scalar, "x")
        t, x = np.array(rows["t"]), np.array(rows["value"])
    return t, x, guess.text


def ms(t: datetime, point: str = ".") -> str:
    return f"{point}{t.microsecond // 1000:03d}"


DATES: list[tuple[str, str, Callable[[datetime], str]]] = [
    ("Zeit", "%d.%m.%Y %H:%M:%S,%f", lambda t: f"{t:%d.%m.%Y %H:%M:%S}{ms(t, ',')}"),
    ("Datum", "%d.%m.%Y %H:%M:%S.%f", lambda t: f"{t:%d.%m.%Y %H:%M:%S}{ms(t)}"),
    ("Date", "%d/%m/%Y %H:%M:%S.%f", lambda t: f"{t:%d/%m/%Y %H:%M:%S}{ms(t)}"),
    ("Timestamp", "%m/%d/%Y %I:%M:%S.%f %p", lambda t: f"{t:%m/%d/%Y %I:%M:%S}{ms(t)} {t:%p}"),
    ("Messung", "%Y/%m/%d %H:%M:%S.%f", lambda t: f"{t:%Y/%m/%d %H:%M:%S}{ms(t)}"),
    ("Time", "%d-%b-%Y %H:%M:%S.%f", lambda t: f"{t:%d-%b-%Y %H:%M:%S}{ms(t)}"),
    ("utc", "iso", lambda t: t.isoformat().replace("+00:00", "Z")),
    ("Date", "excel", lambda t: f"{t.timestamp() / 86400.0 + 25569.0:.9f}"),
    ("epoch", "ms", lambda t: f"{t.timestamp() * 1e3:.0f}"),
    ("epoch", "us", lambda t: f"{t.timestamp() * 1e6:.0f}"),
    ("epoch", "ns", lambda t: f"{t.timestamp() * 1e3:.0f}000000"),
]


@pytest.mark.parametrize(("first", "form", "text_of_time"), DATES, ids=[f"{first} {form}" for first, form, _ in DATES])
def test_the_pattern_of_dates_is_found(
    tmp_path: Path, first: str, form: str, text_of_time: Callable[[datetime], str]
) -> None:
    day_is_told = START.replace(day=22)  # the number is not a month
    shift = day_is_told - START
    t, x, text = imported(tmp_path, table(first, lambda time: text_of_time(time + shift), ";", "."))
    assert f'format = "{form}"' in text
    np.testing.assert_allclose(t, day_is_told.timestamp() + np.arange(N) / RATE_HZ, atol=2e-3)
    np.testing.assert_allclose(x, VALUES[:, 2], atol=1e-4)


def test_a_day_that_may_be_a_month_has_a_caveat(tmp_path: Path) -> None:
    _, _, text = imported(tmp_path, table("Date", lambda t: f"{t:%d/%m/%Y %H:%M:%S}{ms(t)}"))
    assert 'format = "%d/%m/%Y %H:%M:%S.%f"' in text
    assert "# caveat: dates like '12/05/2024 09:00:00.000' are read with the day first" in text


def test_days_of_excel_counted_from_1904_are_read(tmp_path: Path) -> None:
    source = tmp_path / "run.csv"
    source.write_text(table("Date", lambda t: f"{t.timestamp() / 86400.0 + 24107.0:.9f}"))
    text = guess_map(source).text
    assert 'a workbook that counts from 1904 has format = "excel1904"' in text
    (tmp_path / "map.toml").write_text(text.replace('format = "excel"', 'format = "excel1904"'))
    (log,) = import_files(tmp_path / "map.toml", [source], out=tmp_path / "run.mcap")
    with open_log(log) as opened:
        t = opened.table(Scalar, "x")["t"]
    assert t[0] == pytest.approx(START.timestamp(), abs=1e-3)


@pytest.mark.parametrize(
    ("end", "header_end", "encoding"),
    [(";", ";", "utf-8-sig"), (";", "", "utf-8"), ("", ";", "utf-8"), (";", ";", "utf-16"), ("\r", "\r", "cp1252")],
)
def test_trailing_separators_and_encodings_are_read(tmp_path: Path, end: str, header_end: str, encoding: str) -> None:
    text = table("Zeit", lambda t: f"{t:%d.%m.%Y %H:%M:%S}{ms(t, ',')}", ";", ",", end, header_end)
    _, x, _ = imported(tmp_path, text, encoding)
    np.testing.assert_allclose(x, VALUES[:, 2], atol=1e-4)


def test_a_units_row_gives_the_units(tmp_path: Path) -> None:
    text = table("time", lambda t: f"{(t - START).total_seconds():.1f}").replace(" [rad]", "").replace(" [rad/s]", "")
    head, _, rows = text.partition("\n")
    t, x, guess = imported(tmp_path, f"{head}\n(ms),(-),(-),(cm),(cm),(deg),(deg/s)\n{rows}".replace("(ms)", "(s)"))
    assert 'column = "x", unit = "cm"' in guess
    assert 'column = "yaw", unit = "deg"' in guess
    assert len(t) == N
    np.testing.assert_allclose(x, 0.01 * VALUES[:, 2], atol=1e-5)


def test_repeated_headers_and_comments_are_not_rows(tmp_path: Path) -> None:
    lines = table("time", lambda t: f"{(t - START).total_seconds():.1f}").splitlines()
    lines[100:100] = ["# restarted", lines[0]]
    t, _, _ = imported(tmp_path, "\n".join(lines) + "\n")
    assert len(t) == N


def test_a_first_column_of_names_does_not_end_the_guess(tmp_path: Path) -> None:
    lines = table("elapsed", lambda t: f"{(t - START).total_seconds():.1f}").splitlines()
    text = "\n".join(["boat," + lines[0], *(f"otter,{line}" for line in lines[1:])]) + "\n"
    t, _, guess = imported(tmp_path, text)
    assert 'column = "elapsed"' in guess
    np.testing.assert_allclose(np.diff(t), 0.1, atol=1e-6)


def stepped(sign: int, step: datetime) -> str:
    """Return a table of local times that starts 10 s before a change of the clock by one hour to ``step``."""
    changed = START + timedelta(seconds=10)
    before = step - timedelta(hours=sign)
    return table(
        "time",
        lambda t: f"{before + (t - changed) + timedelta(hours=sign * (t >= changed)):%Y-%m-%d %H:%M:%S}{ms(t)}",
    )


@pytest.mark.parametrize(("sign", "step"), [(-1, "2024-10-27 02:00"), (1, "2024-03-31 03:00"), (1, "2024-03-10 03:00")])
def test_local_times_over_a_change_of_the_clock_are_even(tmp_path: Path, sign: int, step: str) -> None:
    text = stepped(sign, datetime.fromisoformat(step))
    with pytest.warns(SeatrialWarning, match="daylight saving time"):
        t, _, _ = imported(tmp_path, text)
    assert len(t) == N
    np.testing.assert_allclose(np.diff(t), 0.1, atol=1e-3)


@pytest.mark.parametrize("step", ["2024-05-12 03:00", "2024-03-30 03:00", "2024-03-31 14:00", "2024-03-31 03:20"])
def test_a_step_of_an_hour_at_another_time_is_kept(tmp_path: Path, step: str) -> None:
    with pytest.warns(SeatrialWarning, match=r"times step by \+1 h at row 101, .*: the times are kept"):
        t, _, _ = imported(tmp_path, stepped(1, datetime.fromisoformat(step)))
    assert t[100] - t[99] == pytest.approx(3600.1, abs=1e-3)


def test_a_comma_as_delimiter_and_decimal_mark_is_reported(tmp_path: Path) -> None:
    source = tmp_path / "run.csv"
    rows = table("time", lambda t: f"{(t - START).total_seconds():.1f}".replace(".", ","), ";", ",").replace(";", ",")
    source.write_text(rows)
    with pytest.raises(SeatrialError, match="both the delimiter and the decimal mark"):
        guess_map(source)


def test_an_impossible_unit_of_time_is_ignored(tmp_path: Path) -> None:
    t, _, text = imported(tmp_path, table("tow(msec)", lambda t: f"{345600 + (t - START).total_seconds():.3f}"))
    assert 'format = "s"' in text
    assert "although the name has ms" in text
    np.testing.assert_allclose(np.diff(t), 0.1, atol=1e-6)


def elapsed(time: datetime) -> str:
    return f"{(time - START).total_seconds():.1f}"


def with_cells(row: int, column: int, *texts: str) -> str:
    """Return the plain table with texts in one column from a row on."""
    lines = table("time", elapsed).splitlines()
    for k, text in enumerate(texts):
        cells = lines[row + k].split(",")
        lines[row + k] = ",".join([*cells[:column], text, *cells[column + 1 :]])
    return "\n".join(lines) + "\n"


def quoted(text: str) -> str:
    """Return a table with commas in which each cell of a semicolon table is quoted."""
    return "\n".join('"' + '","'.join(line.split(";")) + '"' for line in text.splitlines()) + "\n"


def campbell() -> str:
    """Return a file of a Campbell logger (TOA5): station, names, units, kinds of values."""
    rows = table("TIMESTAMP", lambda t: f'"{t:%Y-%m-%d %H:%M:%S}.{t.microsecond // 100000}"').splitlines()
    names = [name.partition(" ")[0] for name in rows[0].split(",")]
    head = [
        '"TOA5","boat","CR1000","12345","CR1000.Std.31","CPU:boat.CR1","4567"',
        ",".join(f'"{name}"' for name in names),
        '"TS","","","m","m","rad","rad/s"',
        '"","Smp","Smp","Smp","Smp","Smp","Smp"',
    ]
    return "\n".join([*head, *rows[1:]]) + "\n"


def two_columns(day: str, clock: Callable[[datetime], str], decimal: str = ".", start: datetime = START) -> str:
    shift = start - START
    return table("Date;Time", lambda t: f"{t + shift:{day}};{clock(t + shift)}", ";", decimal)


PLAIN = table("time", elapsed)
HEADER, *ROWS = PLAIN.splitlines()
MIDNIGHT = datetime(2024, 5, 31, 23, 59, 50, tzinfo=UTC)
AIM = "\n".join(
    [
        quoted("Format;AiM CSV File\nSample Rate;10"),
        quoted("Time;n_left;n_right;x;y;yaw;yaw_rate\ns;;;m;m;rad;rad/s"),
        quoted("\n".join(ROWS).replace(",", ";")),
    ]
)
TWO_LINES = PLAIN.replace("yaw [rad]", '"yaw\n[rad]"').replace("yaw_rate [rad/s]", '"yaw rate\n[rad/s]"')
LABVIEW_S = 2_082_844_800  # offset from 1904 to 1970
GPS_S, LEAP_S = 315_964_800, 18
# Table -> time of its first row [s since 1970], number of rows that are left out
DIALECTS: dict[str, tuple[str, float, int]] = {
    "pipes": (PLAIN.replace(",", "|"), 0.0, 0),
    "a short line": ("\n".join([HEADER, *ROWS[:50], "5.0,0.1,0.2", *ROWS[51:]]) + "\n", 0.0, 1),
    "two lines run together": ("\n".join([HEADER, *ROWS[:50], ROWS[50] + ROWS[51], *ROWS[52:]]) + "\n", 0.0, 2),
    "a last line that is cut": ("\n".join([HEADER, *ROWS])[:-30], 0.0, 1),
    "a line of text at the end": (f"{PLAIN}END OF DATA\n", 0.0, 0),
    "text in cells": (with_cells(40, 3, "OVERFLOW", "N/A", "--", "1.#QNAN", "inf"), 0.0, 5),
    "text in the first row": (with_cells(1, 5, "ERR", "ERR"), 0.0, 0),
    "text in the time": (with_cells(60, 0, "ERR", ""), 0.0, 2),
    "a header as a comment": ("# time n_left n_right x y yaw yaw_rate\n" + "\n".join(ROWS).replace(",", " "), 0.0, 0),
    "a title filled up": (f"Test run,,,,,,\nSample rate,10,,,,,\n{PLAIN}", 0.0, 0),
    "comments of others": (f"{HEADER}\n{ROWS[0]}\n% calm\n// wind\n" + "\n".join(ROWS[1:]) + "\n", 0.0, 0),
    "decimal commas in quotes": (quoted(table("time", lambda t: elapsed(t).replace(".", ","), ";", ",")), 0.0, 0),
    "minus signs of typesetters": (PLAIN.replace("-", "\u2212"), 0.0, 0),
    "thousands": (table("time", lambda t: f'"{(t - START).total_seconds() + 3000.0:,.1f}"'), 3000.0, 0),
    "thousands of whole numbers": (table("time [ms]", lambda t: f"{1e3 * float(elapsed(t)):,.0f}", ";"), 0.0, 0),
    "thousands with points": (
        table("time", lambda t: f"3.{(t - START).total_seconds():05.1f}".replace(".", "#").replace("#", ".", 1)
              .replace("#", ","), ";", ","), 3000.0, 0,
    ),
    "a unit in the cells": (table("time", lambda t: f"{elapsed(t)} s"), 0.0, 0),
    "Campbell": (campbell(), START.timestamp(), 0),
    "seconds since 1904": (table("time", lambda t: f"{t.timestamp() + LABVIEW_S:.3f}"), START.timestamp(), 0),
    "GPS weeks": (
        table("week,tow", lambda t: "{:.0f},{:.1f}".format(*divmod(t.timestamp() - GPS_S, 604800.0))),
        START.timestamp() - LEAP_S, 0,
    ),
    "GPS weeks, ms": (
        table("GPSWeek,iTOW [ms]", lambda t: "{:.0f},{:.0f}".format(*divmod(1e3 * (t.timestamp() - GPS_S), 604800e3))),
        START.timestamp() - LEAP_S, 0,
    ),
    "date and time": (
        two_columns("%d.%m.%Y", lambda t: f"{t:%H:%M:%S}{ms(t, ',')}", ","), START.timestamp(), 0,
    ),
    "date and time over midnight": (
        two_columns("%Y-%m-%d", lambda t: f"{t:%H:%M:%S}{ms(t)}", start=MIDNIGHT), MIDNIGHT.timestamp(), 0,
    ),
    "date and time of 12 hours": (
        two_columns("%m/%d/%Y", lambda t: f"{t:%I:%M:%S}{ms(t)} {t:%p}", start=MIDNIGHT), MIDNIGHT.timestamp(), 0,
    ),
    "date and time of digits": (
        two_columns("%d%m%y", lambda t: f"{t:%H%M%S}{ms(t)}", start=MIDNIGHT), MIDNIGHT.timestamp(), 0,
    ),
    "date and time of digits, the year first": (
        two_columns("%Y%m%d", lambda t: f"{t:%H%M%S}.{t.microsecond // 100000}"), START.timestamp(), 0,
    ),
    "UTC behind it": (table("time", lambda t: f"{t:%Y-%m-%d %H:%M:%S}{ms(t)} UTC"), START.timestamp(), 0),
    "a zone behind it": (
        table("time", lambda t: f"{t + timedelta(hours=2):%d.%m.%Y %H:%M:%S}{ms(t)}+02:00"), START.timestamp(), 0,
    ),
    "nanoseconds": (table("time", lambda t: f"{t:%Y/%m/%d %H:%M:%S}{ms(t)}123456"), START.timestamp(), 0),
    "milliseconds behind a colon": (table("time", lambda t: f"{t:%H:%M:%S}{ms(t, ':')}"), 32400.0, 0),
    "minutes": (table("time", lambda t: f"{t:%M:%S}.{t.microsecond // 100000}"), 0.0, 0),
    "minutes over the hour": (
        table("time", lambda t: f"{t - timedelta(seconds=9):%M:%S}.{t.microsecond // 100000}"), 3591.0, 0,
    ),
    "names of months and underscores": (
        table("time", lambda t: f"{t:%d-%b-%Y_%H-%M-%S}{ms(t)}"), START.timestamp(), 0,
    ),
    "a header of AiM": (AIM, 0.0, 0),
    "names of two lines": (TWO_LINES, 0.0, 0),
    "blocks that were never written": (
        "\n".join([HEADER, *ROWS[:80], "\0" * 700, *ROWS[80:]]) + "\n" + "\0" * 3000, 0.0, 0,
    ),
    "minutes since the start": (table("time [min]", lambda t: f"{(t - START).total_seconds() / 60.0:.8f}"), 0.0, 0),
    "hours since the start": (table("Time (h)", lambda t: f"{(t - START).total_seconds() / 3600.0:.9f}"), 0.0, 0),
    "fractions of a day": (table("Time", lambda t: f"{(t.timestamp() % 86400.0) / 86400.0:.10f}"), 32400.0, 0),
    "date and time in one number": (
        table("stamp", lambda t: f"{t:%Y%m%d%H%M%S}.{t.microsecond // 100000}"), START.timestamp(), 0,
    ),
    "date and milliseconds in one number": (
        table("stamp", lambda t: f"{t:%Y%m%d%H%M%S}{ms(t, '')}"), START.timestamp(), 0,
    ),
    "a date in the first row only": (
        two_columns("%Y-%m-%d", lambda t: f"{t:%H:%M:%S}{ms(t)}").replace("\n2024-05-12;", "\n;").replace(
            "\n;", "\n2024-05-12;", 1), START.timestamp(), 0,
    ),
    "the name of a zone": (table("time", lambda t: f"{t:%d.%m.%Y %H:%M:%S}{ms(t)} CEST"), START.timestamp(), 0),
    "days of the year": (table("time", lambda t: f"{t:%Y-%j %H:%M:%S}{ms(t)}"), START.timestamp(), 0),
    "ctime": (table("time", lambda t: f"{t:%a %b %d %H:%M:%S}{ms(t)} {t:%Y}"), START.timestamp(), 0),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::seatrial.daq.errors.SeatrialWarning")
@pytest.mark.parametrize(("text", "start", "lacks"), DIALECTS.values(), ids=DIALECTS)
def test_a_dialect_of_text_tables_is_read(tmp_path: Path, text: str, start: float, lacks: int) -> None:
    t, x, _ = imported(tmp_path, text)
    assert len(t) == N - lacks
    assert t[0] == pytest.approx(start, abs=2e-3)
    k = np.rint((t - t[0]) * RATE_HZ).astype(int)
    np.testing.assert_allclose(t - t[0], k / RATE_HZ, atol=2e-3)
    np.testing.assert_allclose(x, VALUES[k, 2], atol=1e-4)


# Table -> warning
SAID = {
    "short": (DIALECTS["a short line"][0], r"1 line left out; the first, line 52, has 3 values, but the header has 7$"),
    "cut": (DIALECTS["a last line that is cut"][0], r"line 201, the last, is cut off and left out$"),
    "cells": (
        DIALECTS["text in cells"][0],
        r"line 41, column 'x': 'OVERFLOW' is not a number; 3 such values left out$",
    ),
    "time": (DIALECTS["text in the time"][0], r"2 rows without a time left out, the first is row 60$"),
}


@pytest.mark.parametrize(("text", "message"), SAID.values(), ids=SAID)
def test_rows_and_cells_that_are_left_out_are_counted(tmp_path: Path, text: str, message: str) -> None:
    with pytest.warns(SeatrialWarning, match=message):
        imported(tmp_path, text)


def test_a_text_in_a_cell_is_an_error_if_the_map_drops_no_rows(tmp_path: Path) -> None:
    source = tmp_path / "run.csv"
    source.write_text(DIALECTS["text in cells"][0])
    text = guess_map(source).text.replace(', nan = "drop", time_order = "drop"', "")
    (tmp_path / "map.toml").write_text(text)
    with pytest.raises(SeatrialError, match="line 41, column 'x': 'OVERFLOW' is not a number"):
        import_files(tmp_path / "map.toml", [source], out=tmp_path / "run.mcap")


REFUSED = {
    "milliseconds without their zeros": (
        table("time", lambda t: f"{t:%H:%M:%S}:{t.microsecond // 1000}"), "is not a time of format",
    ),
    "a month in another language": (
        table("Zeit", lambda t: f"{t:%d}. Mai {t:%Y %H:%M:%S}"), r"its strptime pattern as `format` in \[time\]",
    ),
    "a DataFlash log as text": (
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n", "import the original .BIN",
    ),
    "a third of short lines": (
        "\n".join([HEADER, *(row if k % 3 else "1,2,3" for k, row in enumerate(ROWS))]) + "\n", "no table of numbers",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("text", "line"), REFUSED.values(), ids=REFUSED)
def test_an_unreadable_table_is_refused(tmp_path: Path, text: str, line: str) -> None:
    with pytest.raises(SeatrialError, match=line):
        imported(tmp_path, text)


def test_a_duplicate_column_name_is_reported(tmp_path: Path) -> None:
    source = tmp_path / "run.csv"
    source.write_text("\n".join([f"{HEADER},x", *(f"{row},1" for row in ROWS)]) + "\n")
    assert "# caveat: column 'x' is 2 times in the header: name the columns in the import map" in guess_map(source).text
