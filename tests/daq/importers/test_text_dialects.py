"""Dialects of text tables: units rows, repeated headers, trailing separators, dates."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from daq.errors import SeatrialError, SeatrialWarning
from daq.importers.guess import guess_map
from daq.importers.import_files import import_files
from daq.log import open_log
from daq.samples import Scalar

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
    """The times and values of x after a guess and an import, and the text of the map."""
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
def test_dates_have_their_pattern(
    tmp_path: Path, first: str, form: str, text_of_time: Callable[[datetime], str]
) -> None:
    day_is_told = START.replace(day=22)  # no month
    shift = day_is_told - START
    t, x, text = imported(tmp_path, table(first, lambda time: text_of_time(time + shift), ";", "."))
    assert f'format = "{form}"' in text
    np.testing.assert_allclose(t, day_is_told.timestamp() + np.arange(N) / RATE_HZ, atol=2e-3)
    np.testing.assert_allclose(x, VALUES[:, 2], atol=1e-4)


def test_a_day_that_may_be_a_month_has_a_caveat(tmp_path: Path) -> None:
    _, _, text = imported(tmp_path, table("Date", lambda t: f"{t:%d/%m/%Y %H:%M:%S}{ms(t)}"))
    assert 'format = "%d/%m/%Y %H:%M:%S.%f"' in text
    assert "# caveat: dates like '12/05/2024 09:00:00.000' are taken with the day first" in text


def test_days_of_excel_from_1904(tmp_path: Path) -> None:
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
def test_separators_at_the_end_and_encodings(tmp_path: Path, end: str, header_end: str, encoding: str) -> None:
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


def test_the_header_again_and_comments_are_no_rows(tmp_path: Path) -> None:
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


@pytest.mark.parametrize("sign", [-1, 1])
def test_local_times_over_a_change_of_the_clock_are_even(tmp_path: Path, sign: int) -> None:
    changed = START + timedelta(seconds=10)
    text = table("time", lambda t: f"{t + timedelta(hours=sign * (t >= changed)):%Y-%m-%d %H:%M:%S}{ms(t)}")
    with pytest.warns(SeatrialWarning, match="daylight saving time"):
        t, _, _ = imported(tmp_path, text)
    assert len(t) == N
    np.testing.assert_allclose(np.diff(t), 0.1, atol=1e-3)


def test_a_comma_as_delimiter_and_decimal_mark_is_told(tmp_path: Path) -> None:
    source = tmp_path / "run.csv"
    rows = table("time", lambda t: f"{(t - START).total_seconds():.1f}".replace(".", ","), ";", ",").replace(";", ",")
    source.write_text(rows)
    with pytest.raises(SeatrialError, match="both its delimiter and its decimal mark"):
        guess_map(source)


def test_a_unit_of_time_that_cannot_be_is_not_taken(tmp_path: Path) -> None:
    t, _, text = imported(tmp_path, table("tow(msec)", lambda t: f"{345600 + (t - START).total_seconds():.3f}"))
    assert 'format = "s"' in text
    assert "though its name has ms" in text
    np.testing.assert_allclose(np.diff(t), 0.1, atol=1e-6)
