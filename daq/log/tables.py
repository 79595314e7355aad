"""Tables of a log with their units, and resampling of all tables to one time grid."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.errors import SeatrialError
from seatrial.daq.log.schema import NODE_TOPICS
from seatrial.daq.samples import Ahrs, Autopilot, Battery, Command, Esc, Gnss, LoadCell, Scalar, Servo

UNITS = {  # unit of each column; daq/samples.py explains the columns
    "t": "s", "t_rx": "s", "t_device": "s", "utc": "s",
    "yaw": "rad", "pitch": "rad", "roll": "rad", "p": "rad/s", "q": "rad/s", "r": "rad/s",
    "ax": "m/s2", "ay": "m/s2", "az": "m/s2", "mx": "T", "my": "T", "mz": "T",
    "lat": "deg", "lon": "deg", "alt": "m", "vel_n": "m/s", "vel_e": "m/s", "vel_d": "m/s", "speed": "m/s",
    "sigma_h": "m", "rpm": "rev/min", "current": "A", "voltage": "V", "temperature": "degC", "force": "N", "pwm": "us",
}  # fmt: skip
KINDS: tuple[type[Any], ...] = (Ahrs, Gnss, Esc, Command, Servo, LoadCell, Battery, Autopilot, Scalar)
HELD_KINDS = (Command, Servo, Autopilot)  # kinds whose values stay constant until the next sample
TIME_COLUMNS = ("t", "t_rx", "t_device", "utc")  # columns that are times; they are not resampled
GAP_S = 2.0  # s; over a gap longer than this and than five usual intervals no value is interpolated
MAX_ROWS = 50_000_000

Array = NDArray[np.float64]


class Log(Protocol):
    """Interface to `seatrial.daq.log.Log` with the parts that resampling needs."""

    path: Path

    def sources(self, kind: type[Any]) -> list[str]:
        """Return the names of the devices (signals, for `Scalar`) of the log that have samples of the class `kind`.

        The list is empty if there are none.
        """

    def nodes(self, kind: type[Any], source: str) -> list[int]:
        """Return the ids of the motor controllers (or servo outputs) of a device that have samples of the class `kind`.

        `source` is the name of the device. The ids ascend. The list is empty if there are none.
        """

    def table(self, kind: type[Any], source: str, node: int | None = None) -> NDArray[np.void]:
        """Return the samples of a device or signal of the log as a structured array, shape (n,), in order of time.

        `node` is the id of the controller or servo output, for `Esc`, `Command` and `Servo`; None for other classes.
        """

    def unit(self, signal: str) -> str:
        """Return the unit of an imported signal of the log, for example "m/s"; empty if it is unknown."""

    def hold(self, signal: str) -> str:
        """Return the hold of an imported signal, which describes its values between two samples.

        "zero": the last value stays constant. "linear": values are interpolated. "sampled": a held output that is
        sampled at a rate.
        """


class LogTable(NamedTuple):
    """Table of the samples of one device or signal of a log, with the units of its columns.

    Attributes
    ----------
    name
        Name of device, controller (if any) and class in lower case, such as "esc_1_command"; a signal has its own name.
    kind
        Class of the samples.
    rows
        Samples, shape (n,), with the columns t, t_rx, t_device and the fields of the class.
    units
        Unit of each column that has one, by name of the column.
    held
        Whether a value stays constant until the next sample.
    source
        Name of the device, or of the signal; empty for a table that was joined from several.
    node
        Id of the controller or servo output; None for other kinds.
    """

    name: str
    kind: type[Any]
    rows: NDArray[np.void]
    units: dict[str, str]
    held: bool
    source: str = ""
    node: int | None = None


class Resampled(NamedTuple):
    """All numbers of a log on one time grid.

    Attributes
    ----------
    t
        Times of the grid [s since 1970], shape (n,).
    columns
        Values (n,) of each column by its name; NaN for unknown values.
    units
        Unit of each column, by its name; the text is empty if the column has no unit.
    """

    t: Array
    columns: dict[str, Array]
    units: dict[str, str]


def log_tables(log: Log, unreadable: Callable[[SeatrialError], None] | None = None) -> Iterator[LogTable]:
    """Yield the table of samples of each device, controller and signal of a log, in the order of `KINDS`.

    `Esc`, `Command` and `Servo` have a table for each controller or servo output, other classes one for each device or
    signal. A device with samples of several classes has a table for each class. Each table is read when it is yielded.
    A table that cannot be read raises SeatrialError. With the function `unreadable`, the table is left out and the
    error is passed to this function.
    """
    for kind in KINDS:
        for source in log.sources(kind):
            for node in log.nodes(kind, source) if kind in NODE_TOPICS else [None]:
                try:
                    rows = log.table(kind, source, node)
                except SeatrialError as error:
                    if unreadable is None:
                        raise
                    unreadable(error)
                    continue
                middle = "" if node is None else f"_{node}"
                name = source if kind is Scalar else f"{source}{middle}_{kind.__name__.lower()}"
                units = {column: UNITS[column] for column in rows.dtype.names or () if column in UNITS}
                held = kind in HELD_KINDS
                if kind is Scalar:
                    units["value"], held = log.unit(source), log.hold(source) in ("zero", "sampled")
                yield LogTable(name, kind, rows, units, held, source, node)


def resample(log: Log, rate: float) -> Resampled:
    """Resample all numbers of a log to one time grid, from the first sample to the last.

    Parameters
    ----------
    log
        The log.
    rate
        Rate of the grid [Hz].

    Returns
    -------
    Resampled
        Columns have the name TABLE_COLUMN; the column of a signal has the name of the signal. An underscore is added to
        a name that an earlier column has. Columns of times, and columns without a finite number, are left out.

    Raises
    ------
    SeatrialError
        If the rate is not positive or not finite, if the log has no samples, or if the grid has more than 50 million
        rows (MAX_ROWS).

    Notes
    -----
    Held quantities keep the value of the last sample, also over gaps and after the last one: commands, servo outputs,
    states of the autopilot, whole numbers, and signals with hold "zero" or "sampled". Other quantities are averaged
    over the samples nearest to each time of the grid. The averages, each at the mean time of its samples, are
    interpolated linearly to the grid. The result is NaN in gaps between averages that are longer than 2 s and than five
    times their median distance, and after the last sample. Before its first sample each column is NaN. Values that are
    NaN or infinite are left out before. Angles [rad] and longitudes within one turn are averaged and interpolated over
    the shortest way.
    """
    if not (math.isfinite(rate) and rate > 0.0):
        raise SeatrialError(f"{log.path}: the rate of the table must be positive, not {rate:g} Hz; give another rate")
    tables = [table for table in log_tables(log) if len(table.rows)]
    if not tables:
        raise SeatrialError(f"{log.path}: the log has no samples to export; `seatrial info` shows its content")
    begin, end = min(table.rows["t"][0] for table in tables), max(table.rows["t"][-1] for table in tables)
    if (end - begin) * rate > MAX_ROWS:
        raise SeatrialError(f"{log.path}: {end - begin:.0f} s at {rate:g} Hz are too many rows; give a lower rate")
    grid = begin + np.arange(int((end - begin) * rate + 1e-6) + 1) / rate
    columns: dict[str, Array] = {}
    units: dict[str, str] = {}
    for table in tables:
        for column in table.rows.dtype.names or ():
            if column in TIME_COLUMNS:
                continue
            name = unused_name(table.name if table.kind is Scalar else f"{table.name}_{column}", columns)
            values = table.rows[column].astype(np.float64)
            good = np.isfinite(values)
            if not good.any():
                continue
            t, values = table.rows["t"][good], values[good]
            unit = table.units.get(column, "")
            if table.held or table.rows.dtype[column].kind in "iu":
                columns[name] = _hold_last_value(grid, t, values)
            else:
                period = 2.0 * np.pi if unit == "rad" else 360.0 if column == "lon" else 0.0
                columns[name] = _average_and_interpolate(grid, t, values, 1.0 / rate, period)
            units[name] = unit
    return Resampled(grid, columns, units)


def unused_name(name: str, used: Collection[str]) -> str:
    """Return the name of a column, with as many underscores at its end as it needs to differ from the `used` names."""
    while name in used:
        name += "_"
    return name


def _hold_last_value(grid: Array, t: Array, values: Array) -> Array:
    """Return the value of the last sample at each time of a grid, shape (n,); NaN before the first sample.

    A sample at the time of the grid, or up to 1 ns after it, counts. After the last sample its value is kept. `grid`
    are the times of the grid [s], shape (n,). `t` (ascending) and `values` are the times [s] and values of the samples,
    shape (m,), at least one.
    """
    newest = np.searchsorted(t, grid + 1e-9, side="right") - 1
    return np.where(newest >= 0, values[np.maximum(newest, 0)], np.nan)


def _average_and_interpolate(grid: Array, t: Array, values: Array, step: float, period: float) -> Array:
    """Average the samples nearest to each time of the grid, and interpolate the averages linearly to the grid.

    An average stands at the mean time of its samples, which may differ from the time of the grid. At times from the
    first sample to the first average, the result is the first average. At times from the last average to the last
    sample, the result is the last average.

    Parameters
    ----------
    grid
        Times of the grid [s], shape (n,).
    t, values
        Times [s] and values of the samples, shape (m,), without NaN.
    step
        Step of the grid [s].
    period
        Period of an angle, such as 2 pi; 0 for other quantities. Samples within one turn (0 to `period`, or half of it
        to both sides of 0) are taken as wrapped, and the result is wrapped to this range. Other samples are taken as
        unwrapped.

    Returns
    -------
    Array (n,)
        NaN before the first sample, after the last one, and in gaps between averages that are longer than 2 s (GAP_S)
        and than five times the median distance of two averages.
    """
    within = (-0.5 * period, 0.5 * period), (0.0, period)  # the possible ranges of a wrapped angle
    turn = next(((low, high) for low, high in within if low <= values.min() and values.max() <= high + 1e-9), None)
    values = np.unwrap(values, period=period) if period and turn is not None else values
    cell = np.rint((t - grid[0]) / step).astype(np.int64)
    _, cell_number, count = np.unique(cell, return_inverse=True, return_counts=True)
    mean_t, mean = (np.bincount(cell_number, weights) / count for weights in (t, values))
    resampled = np.interp(grid, mean_t, mean)
    resampled[(grid < t[0] - 1e-9) | (grid > t[-1] + 1e-9)] = np.nan
    if len(mean_t) > 1:
        gap = np.diff(mean_t)
        after = np.clip(np.searchsorted(mean_t, grid), 1, len(mean_t) - 1)
        inside = (grid > mean_t[after - 1]) & (grid < mean_t[after])
        resampled[inside & (gap[after - 1] > max(GAP_S, 5.0 * float(np.median(gap))))] = np.nan
    if not period or turn is None:
        return resampled
    # Wrap the angle to the range of the samples: [0, period) or (-period/2, period/2].
    return np.asarray(np.mod(resampled, period) if turn[0] == 0.0 else turn[1] - np.mod(turn[1] - resampled, period))
