"""The tables of a log with their units, and all of them on one grid of times."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.errors import SeatrialError
from seatrial.daq.log.schema import NODE_TOPICS
from seatrial.daq.samples import Ahrs, Autopilot, Battery, Command, Esc, Gnss, LoadCell, Scalar, Servo

UNITS = {  # of daq/samples.py, where they are explained
    "t": "s", "t_rx": "s", "t_device": "s", "utc": "s",
    "yaw": "rad", "pitch": "rad", "roll": "rad", "p": "rad/s", "q": "rad/s", "r": "rad/s",
    "ax": "m/s2", "ay": "m/s2", "az": "m/s2", "mx": "T", "my": "T", "mz": "T",
    "lat": "deg", "lon": "deg", "alt": "m", "vel_n": "m/s", "vel_e": "m/s", "vel_d": "m/s", "speed": "m/s",
    "sigma_h": "m", "rpm": "rev/min", "current": "A", "voltage": "V", "temperature": "degC", "force": "N", "pwm": "us",
}  # fmt: skip
KINDS: tuple[type[Any], ...] = (Ahrs, Gnss, Esc, Command, Servo, LoadCell, Battery, Autopilot, Scalar)
HELD = (Command, Servo, Autopilot)  # kinds that stay as they are until the next sample
CLOCKS = ("t", "t_rx", "t_device", "utc")
GAP_S = 2.0  # s without a sample, and five usual intervals: nothing is made up in between
MAX_ROWS = 50_000_000

Array = NDArray[np.float64]


class Log(Protocol):
    """What is needed of `seatrial.daq.log.Log`."""

    path: Path

    def sources(self, kind: type[Any]) -> list[str]:
        """Devices or signals that have samples of this kind."""

    def nodes(self, kind: type[Any], source: str) -> list[int]:
        """Controller ids of a device."""

    def table(self, kind: type[Any], source: str, node: int | None = None) -> NDArray[np.void]:
        """The samples."""

    def unit(self, signal: str) -> str:
        """Of an imported signal."""

    def hold(self, signal: str) -> str:
        """Of an imported signal."""


class LogTable(NamedTuple):
    """One table of a log: its name, its kind, its rows, its units by column, and whether its values are held."""

    name: str
    kind: type[Any]
    rows: NDArray[np.void]
    units: dict[str, str]
    held: bool


class Resampled(NamedTuple):
    """A log on one grid: times (n,) in s since 1970, columns (n,) by name, NaN where nothing is known, their units."""

    t: Array
    columns: dict[str, Array]
    units: dict[str, str]


def log_tables(log: Log) -> Iterator[LogTable]:
    """Every table of samples, in the order of the kinds."""
    for kind in KINDS:
        for source in log.sources(kind):
            for node in log.nodes(kind, source) if kind in NODE_TOPICS else [None]:
                rows = log.table(kind, source, node)
                middle = "" if node is None else f"_{node}"
                name = source if kind is Scalar else f"{source}{middle}_{kind.__name__.lower()}"
                units = {column: UNITS[column] for column in rows.dtype.names or () if column in UNITS}
                held = kind in HELD
                if kind is Scalar:
                    units["value"], held = log.unit(source), log.hold(source) in ("zero", "sampled")
                yield LogTable(name, kind, rows, units, held)


def resample(log: Log, rate: float) -> Resampled:
    """Every number of a log at `rate` [Hz], from the first sample to the last.

    What is held (commands, outputs, whole numbers, signals with hold "zero" or
    "sampled") keeps its last value; of anything else the
    samples of an interval about each time are averaged where there are several, and interpolated where there are none;
    angles [rad] and longitudes over the shortest way. Columns are named TABLE_COLUMN, signals by themselves. Raises
    SeatrialError.
    """
    tables = [table for table in log_tables(log) if len(table.rows)]
    if not tables:
        raise SeatrialError(f"{log.path}: holds no samples to export")
    begin, end = min(table.rows["t"][0] for table in tables), max(table.rows["t"][-1] for table in tables)
    if (end - begin) * rate > MAX_ROWS:
        raise SeatrialError(f"{log.path}: {end - begin:.0f} s at {rate:g} Hz are too many rows; take a lower rate")
    grid = begin + np.arange(int((end - begin) * rate + 1e-6) + 1) / rate
    columns: dict[str, Array] = {}
    units: dict[str, str] = {}
    for table in tables:
        for column in table.rows.dtype.names or ():
            if column in CLOCKS:
                continue
            name = table.name if table.kind is Scalar else f"{table.name}_{column}"
            values = table.rows[column].astype(np.float64)
            good = np.isfinite(values)
            if not good.any():
                continue
            t, values = table.rows["t"][good], values[good]
            unit = table.units.get(column, "")
            if table.held or table.rows.dtype[column].kind in "iu":
                columns[name] = _held(grid, t, values)
            else:
                period = 2.0 * np.pi if unit == "rad" else 360.0 if column == "lon" else 0.0
                columns[name] = _smooth(grid, t, values, 1.0 / rate, period)
            units[name] = unit
    return Resampled(grid, columns, units)


def _held(grid: Array, t: Array, values: Array) -> Array:
    newest = np.searchsorted(t, grid + 1e-9, side="right") - 1
    return np.where(newest >= 0, values[np.maximum(newest, 0)], np.nan)


def _smooth(grid: Array, t: Array, values: Array, step: float, period: float) -> Array:
    """Straight lines between the samples, or between the means of those about each time of the grid. ``period``: of an
    angle, 0 of what is none; one that was unwrapped before stays so."""
    within = (-0.5 * period, 0.5 * period), (0.0, period)  # the turn that it is written in
    turn = next(((low, high) for low, high in within if low <= values.min() and values.max() <= high + 1e-9), None)
    values = np.unwrap(values, period=period) if period and turn is not None else values
    cell = np.rint((t - grid[0]) / step).astype(np.int64)
    _, which, count = np.unique(cell, return_inverse=True, return_counts=True)
    at, mean = (np.bincount(which, of) / count for of in (t, values))
    found = np.interp(grid, at, mean)
    found[(grid < t[0] - 1e-9) | (grid > t[-1] + 1e-9)] = np.nan
    if len(at) > 1:
        gap = np.diff(at)
        behind = np.clip(np.searchsorted(at, grid), 1, len(at) - 1)
        inside = (grid > at[behind - 1]) & (grid < at[behind])
        found[inside & (gap[behind - 1] > max(GAP_S, 5.0 * float(np.median(gap))))] = np.nan
    if not period or turn is None:
        return found
    return np.asarray(np.mod(found, period) if turn[0] == 0.0 else turn[1] - np.mod(turn[1] - found, period))
