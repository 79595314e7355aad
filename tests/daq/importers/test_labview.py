"""Tests of the import of LabVIEW measurement files (.lvm), as written by Write To Measurement File."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.guess import guess_map
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.log import open_log
from seatrial.daq.samples import Scalar

N = 200
T = 0.1 * np.arange(N)
NAMES = ("n_left", "n_right", "x", "y", "yaw", "yaw_rate")
VALUES = np.random.default_rng(5).uniform(-0.9, 0.9, (N, len(NAMES)))
START = datetime(2024, 5, 12, 13, 0, 0, 500_000, UTC).timestamp()


def clock(t: float, decimal: str) -> str:
    return f"{datetime.fromtimestamp(t, UTC):%H:%M:%S.%f}".replace(".", decimal)


def head(x_columns: str, mark: str, decimal: str) -> list[str]:
    lines = ["LabVIEW Measurement", "Writer_Version~2", f"Separator~{'Tab' if mark == chr(9) else 'Comma'}"]
    lines += [f"Decimal_Separator~{decimal}", f"X_Columns~{x_columns}", "Date~2024/05/12"]
    return [line.replace("~", mark) for line in [*lines, f"Time~{clock(START, decimal)}", "***End_of_Header***", ""]]


def segment(rows: range, x: np.ndarray, x0: float, start: float, mark: str, decimal: str) -> list[str]:
    """Return a segment of rows. A row whose x is NaN is written without x."""

    def line(key: str, cells: list[str]) -> str:
        return mark.join([key, *cells, ""])

    each = len(NAMES)
    lines = [line("Channels", [str(each)]), line("Samples", [str(len(rows))] * each)]
    lines += [line("Date", ["2024/05/12"] * each), line("Time", [clock(start, decimal)] * each)]
    lines += [line("Y_Unit_Label", ["", "", "cm", "cm", "rad", "rad/s"]), line("X_Dimension", ["Time"] * each)]
    lines += [line("X0", [f"{x0:.4E}".replace(".", decimal)] * each)]
    lines += [line("Delta_X", ["0.1".replace(".", decimal)] * each), line("***End_of_Header***", [])]
    lines += [mark.join(["X_Value", *NAMES, "Comment"])]
    for k in rows:
        cells = ["" if np.isnan(x[k]) else f"{x[k]:.6f}", *(f"{value:.6f}" for value in VALUES[k])]
        lines.append(mark.join(cell.replace(".", decimal) for cell in cells))
    return [*lines, ""]


PARTS = [range(k, k + 50) for k in range(0, N, 50)]
FILES = {
    "seconds from the start": ("One", [(range(N), T, 0.0, START)]),
    "no times": ("No", [(range(N), T * np.nan, 0.0, START)]),
    "seconds since 1904": ("One", [(range(N), T + START + 2_082_844_800, 0.0, START)]),
    "segments that go on": ("One", [(part, T, 0.0, START) for part in PARTS]),
    "segments that go on, each with its X0": ("One", [(part, T, T[part[0]], START + T[part[0]]) for part in PARTS]),
    "segments that begin anew": ("One", [(part, T - T[part[0]], 0.0, START + T[part[0]]) for part in PARTS]),
    "segments without times": ("No", [(part, T * np.nan, 0.0, START + T[part[0]]) for part in PARTS]),
}


@pytest.mark.parametrize(("mark", "decimal"), [("\t", "."), ("\t", ","), (",", ".")])
@pytest.mark.parametrize("name", FILES)
def test_a_measurement_file_of_labview_is_imported(name: str, mark: str, decimal: str, tmp_path: Path) -> None:
    x_columns, parts = FILES[name]
    lines = head(x_columns, mark, decimal)
    for rows, x, x0, start in parts:
        lines += segment(rows, x, float(x0), float(start), mark, decimal)
    source = tmp_path / "run.lvm"
    source.write_text("\n".join(lines) + "\n", encoding="utf-8")
    guess = guess_map(source)
    assert guess.problem == ""
    (tmp_path / "map.toml").write_text(guess.text)
    (log,) = import_files(tmp_path / "map.toml", [source], out=tmp_path / "run.mcap")
    with open_log(log) as opened:
        table = opened.table(Scalar, "x")
    np.testing.assert_allclose(table["t"], START + T, atol=1e-5)
    np.testing.assert_allclose(table["value"], 0.01 * VALUES[:, 2], atol=1e-6)


def test_a_file_without_rows_is_refused(tmp_path: Path) -> None:
    source = tmp_path / "run.lvm"
    source.write_text("\n".join(head("One", "\t", ".")) + "\n")
    with pytest.raises(SeatrialError, match="no lines with data below the header"):
        guess_map(source)
    source.write_text("LabVIEW Measurement\t\n")
    with pytest.raises(SeatrialError, match="header of this LabVIEW file has no end"):
        guess_map(source)
