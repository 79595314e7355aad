"""Samples of one table of a log in memory, one array for each column, to which a growing log is appended."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.log import LogTable
from seatrial.daq.samples import Scalar
from seatrial.daq.view.content import SignalRow, TableRow
from seatrial.daq.view.decimation import Array, longest_period

ROUNDING_S = 1e-6
RECENT_S = 10.0  # s of the log over which the recent rate of a table is counted
HIDDEN = ("t", "t_rx", "t_device", "utc", "node")  # columns that are times or names


class Columns:
    """Samples of one table of the log in memory: an array for each column, to which samples are appended.

    Columns of other times than `t`, and the column of the node, are left out.

    Attributes
    ----------
    kind, source, title, device, topic
        Class of the samples, name of device or signal, and texts of the page (`TableRow`).
    units
        Unit of each column that has one.
    held
        Whether the values stay constant until the next sample.
    gap, gap_at
        Longest time between two samples [s], and the time at which it begins [s since 1970]; NaN with fewer than two
        samples. Samples that were dropped (`drop_before`) count too.
    """

    def __init__(self, table: LogTable, title: str, device: str, topic: str) -> None:
        """Begin without samples. `table` gives the names and units of the columns; its rows are not appended.

        `title`, `device` and `topic` are texts for the page.
        """
        self.kind, self.source, self.title, self.device, self.topic = table.kind, table.source, title, device, topic
        self.units, self.held = table.units, table.held
        names = [name for name in table.rows.dtype.names or () if name not in HIDDEN]
        self._steps = {name for name in names if table.held or table.rows.dtype[name].kind in "iu"}
        self._all = {name: np.zeros(0) for name in ("t", *names)}
        self._n = 0
        self._longest: dict[str, tuple[int, float]] = {}  # by column: number of samples when it was computed, and value
        self.gap, self.gap_at = math.nan, math.nan

    def append(self, rows: NDArray[np.void]) -> None:
        """Append the next samples of the table (n,), whose times must not decrease.

        A time before that of the last sample of an earlier call is replaced by the time of that sample. `gap` and
        `gap_at` are updated.
        """
        n, before = self._n + len(rows), self.t[-1:]
        if not len(rows):
            return
        if n > len(self._all["t"]):
            for name, column in self._all.items():
                self._all[name] = np.concatenate([column, np.zeros(n + n // 2 - len(column))])
        for name, column in self._all.items():
            column[self._n : n] = rows[name]
        t = self._all["t"][self._n : n]
        if len(before):
            np.maximum(t, before[0], out=t)
        periods = np.diff(np.concatenate([before, t]))
        if len(periods) and not periods.max() <= self.gap:
            k = int(periods.argmax())
            self.gap, self.gap_at = float(periods[k]), float(np.concatenate([before, t])[k])
        self._n = n

    def drop_before(self, begin: float) -> None:
        """Forget the samples before a time [s since 1970]."""
        first = int(np.searchsorted(self.t, begin))
        self._all = {name: column[first : self._n].copy() for name, column in self._all.items()}
        self._n -= first

    @property
    def t(self) -> Array:
        """Times of the samples [s since 1970], shape (n,)."""
        return self._all["t"][: self._n]

    def values(self, name: str) -> Array:
        """Return the values of a column, shape (n,). Raise KeyError if there is no such column."""
        return self._all[name][: self._n]

    @property
    def n_bytes(self) -> int:
        """Number of bytes of all samples."""
        return 8 * self._n * len(self._all)

    def is_step(self, name: str) -> bool:
        """Return whether the value of a column stays constant until its next sample.

        This is so for all columns of a held table, and for whole numbers. The result is False for an unknown name.
        """
        return name in self._steps

    def longest(self, name: str) -> float:
        """Return the longest time between two samples of a column that is no gap [s].

        The result is infinite for a column with `is_step`, and with fewer than three finite values. Otherwise it is
        that of `longest_period`. It is computed again only when the number of samples has grown by more than a quarter.
        """
        if name in self._steps:
            return math.inf
        n, found = self._longest.get(name, (0, math.inf))
        if self._n > 1.25 * n:
            found = longest_period(self.t, self.values(name))
            self._longest[name] = self._n, found
        return found

    def signals(self) -> list[SignalRow]:
        """Return the columns that have a finite value, in their order."""
        return [
            SignalRow(
                f"{self.topic}:{name}",
                self.source if self.kind is Scalar else name,
                self.units.get(name, ""),
                self.is_step(name),
            )
            for name in self._all
            if name != "t" and bool(np.isfinite(self.values(name)).any())
        ]

    def row(self, zero: float, end: float, expected: float) -> TableRow:
        """Return the row of the page about this table.

        `zero` and `end` are time zero and the end of the log [s since 1970]. `expected` is the expected rate [Hz].
        """
        t = self.t
        span = float(t[-1] - t[0]) if len(t) else 0.0
        # A sample at the begin of the interval belongs to the one before it; stamps have rounding errors.
        recent = t[np.searchsorted(t, max(end - RECENT_S, float(t[0]) if len(t) else 0.0) + ROUNDING_S) :]
        return TableRow(
            device=self.device, topic=self.topic, title=self.title, signals=self.signals(), samples=len(t),
            expected=expected, rate=(len(t) - 1) / span if span > 0.0 else math.nan,
            recent=len(recent) / min(RECENT_S, end - float(t[0])) if len(t) and end > t[0] else math.nan,
            gap=self.gap, gap_at=self.gap_at - zero, silent=end - float(t[-1]) if len(t) else math.nan,
        )  # fmt: skip
