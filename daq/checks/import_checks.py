"""Checks of imported logs: rows that were left out because of their times, and inputs without a value."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import numpy.typing as npt

from seatrial.daq.checks.findings import FAULT, WARNING, Finding
from seatrial.daq.errors import counted
from seatrial.daq.log import Log
from seatrial.daq.samples import Scalar

MOST_LEFT_OUT, FEWEST_LEFT_OUT = 0.05, 5  # share of a source's rows, and number of rows, above which it is a fault
SHORTEST_GAP_S = 0.5  # s without a value of an input; in a shorter gap the last value holds


def check_rows_left_out(metadata: Mapping[str, str]) -> Iterator[Finding]:
    """Yield a finding for each group of rows that an import left out because of their times.

    Their times ran back, repeated, are empty, or are far from the time of receipt. It is a fault if these are 5 rows or
    more, and more than 5 % of the rows of the source; otherwise it is a warning, also in a log of an older version,
    which did not note the number of all rows.

    Parameters
    ----------
    metadata
        Metadata of the imported log, in which the import has noted these rows (`source.1.name`, `source.1.left_out`,
        and so on for each source file). Other logs have none, and no finding.
    """
    k = 1
    while (name := metadata.get(f"source.{k}.name")) is not None:
        lines = metadata.get(f"source.{k}.left_out")
        n_old = int(metadata.get(f"source.{k}.disordered", "0"))
        k += 1
        if lines is None and n_old:  # a log of an earlier version lacks the number of all rows
            text = f"{counted(n_old, 'row')} left out: times that ran back or repeated"
            yield Finding(WARNING, "rows-left-out", "time", name, text, _ADVICE["back"])
        for line in (lines or "").splitlines():
            n, n_rows, why, rate, topic = line.split(" ", 4)
            level = FAULT if too_many_rows_missing(int(n), int(n_rows)) else WARNING
            rows = f"{counted(int(n), 'row')} of {n_rows}"
            code, text = "rows-left-out", f"{rows} left out: times that ran back or repeated"
            if why == "stamps":
                code, text = "stamps-wrong", f"{rows} left out: stamps that are empty or far from their receipt"
            yield Finding(level, code, "time", topic or name, text, _ADVICE[why].format(rate=rate))


def check_missing_inputs(log: Log) -> Iterator[Finding]:
    """Yield a warning for each imported input of a log that is unknown (NaN) for longer than 0.5 s at a time.

    Imported outputs, and signals that seatrial recorded, are not checked.
    """
    for source in log.sources(Scalar):
        if log.role(source) != "input":
            continue
        table = log.table(Scalar, source)
        gaps = unknown_times(table["t"], table["value"])
        if not gaps:
            continue
        first, longest = gaps[0][0] - log.start + log.skipped, max(end - begin for begin, end in gaps)
        text = f"unknown for {sum(end - begin for begin, end in gaps):.1f} s, in {counted(len(gaps), 'gap')}, from "
        text += f"{first:.1f} s on, the longest of {longest:.1f} s: a fit leaves these times out"
        advice = 'give the signal nan = "zero" in the import map, if the thruster stands still then'
        yield Finding(WARNING, "input-missing", "input", source, text, advice)


def unknown_times(t: npt.NDArray[np.float64], values: npt.NDArray[np.float64]) -> list[tuple[float, float]]:
    """Find the intervals of time in which a signal is unknown.

    Parameters
    ----------
    t
        Times of the samples (n,) [s].
    values
        The signal (n,), NaN from where it is unknown.

    Returns
    -------
    list
        Begin and end [s] of each gap longer than 0.5 s (SHORTEST_GAP_S), from its first NaN to the next value, or to
        the last sample. The list is empty without such a gap.
    """
    unknown = np.isnan(values).astype(np.int8)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], unknown, [0]])))
    gaps = [(float(t[a]), float(t[min(int(b), len(t) - 1)])) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [(begin, end) for begin, end in gaps if end - begin > SHORTEST_GAP_S]


def too_many_rows_missing(n: int, n_rows: int) -> bool:
    """Return whether a log lacks too many rows to represent the recording: 5 rows or more, and more than 5 %.

    Parameters
    ----------
    n
        Number of rows of a source that were left out.
    n_rows
        Number of all rows of the source.
    """
    return n >= FEWEST_LEFT_OUT and n > MOST_LEFT_OUT * n_rows


_ADVICE = {
    "repeats": "the stamps are coarser than the rows, as whole seconds are: "
    "write time = {{ rate_hz = {rate} }} into the import map",
    "pairs": "two receivers or sensors of unequal rate write into one table: import each from its own file or topic",
    "back": "sort the rows by their time; if a clock was set, or two clocks are mixed, import the data of each clock "
    "separately; if zeros are lost in the times, write `fraction` in [time] of the import map",
    "stamps": "the log lacks these samples: check the clock of the driver, or whether a simulation was set back",
}
