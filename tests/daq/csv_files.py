"""Map and CSV file for the tests of the import, and the values that the log then contains."""

from __future__ import annotations

from pathlib import Path

from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Scalar

DOCS = Path(__file__).parents[2] / "docs"
EXAMPLES = DOCS / "examples"
MAP = """
format = "seatrial-import-csv 1"
name = "test"
[csv]
{csv}
[time]
column = "t"
{time}
[[signal]]
name = "psi"
column = "heading"
unit = "deg"
{signal}
[[signal]]
name = "n_left"
column = "cmd"
unit = "1"
role = "input"
"""
ROWS = "t,cmd,heading\n0.0,0.5,170\n0.1,0.6,-170\n0.2,0.7,-160\n"


def write(folder: Path, rows: str = ROWS, csv: str = "", time: str = "", signal: str = "") -> tuple[Path, list[Path]]:
    (folder / "map.toml").write_text(MAP.format(csv=csv, time=time, signal=signal), encoding="utf-8")
    (folder / "run.csv").write_text(rows, encoding="utf-8")
    return folder / "map.toml", [folder / "run.csv"]


def values(path: Path, name: str) -> tuple[list[float], list[float]]:
    table = open_log(path).table(Scalar, name)
    return table["t"].tolist(), table["value"].tolist()
