"""What an input of a table is between its rows: a command that holds, a shaft speed that was measured, or a slower
signal whose last value stands in each row.

Theory of operation. A fit that takes a measured shaft speed for a command that holds believes every change half a row
late, and one that takes a slow signal for one of each row believes it late by half of the slow interval. Both make the
masses too large. The values show which one it is:

- A command changes from one row to the next, and stays. A shaft follows: behind the first change come smaller ones.
- Values of a slow signal change at a regular pace of several rows, and hardly any of them comes back.
- Commands that change at every k-th row only may be such a slow signal, or steps of whole seconds. That cannot be told.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seatrial.daq.checks import held_signals, is_measured
from seatrial.daq.importers.table import Column

ONSET, QUIET = 0.05, 0.05  # part of the largest value: a change; part of a change: what lies before it is quiet
TAIL = (0.05, 0.95)  # share of a change by which a shaft goes on in the next row
FEWEST_ONSETS, MOST_TAILS = 3, 0.7  # changes from a rest, and the share of them with a tail, of a shaft
FEWEST_CHANGES, SLOWEST_COMB_S = 12, 2.0  # changes that lie on a comb, and its longest interval [s]


class InputHold(NamedTuple):
    """The hold of an input for a map ("" for the usual one), and a caveat about it."""

    hold: str
    caveat: str


def input_hold(t: Column, values: Column, *, may_be_shaft: bool) -> InputHold:
    """Judge what an input is between the rows of its table.

    Parameters
    ----------
    t, values
        Times [s] and values of the rows (n,), in order and without NaN.
    may_be_shaft
        Whether the name of the column allows a shaft speed.
    """
    held = held_signals(t, {"input": values}).get("input")
    if held is not None:
        interval = held.rows * float(np.median(np.diff(t)))
        if is_measured(values[held.new], interval):
            if may_be_shaft:
                return InputHold("linear", "its values are taken for a measured shaft speed")
            return InputHold("sampled", "its values are taken for a command that was recorded at this rate")
    if may_be_shaft and _follows(values):
        return InputHold("linear", 'its values lag as a measured shaft speed does; a command has hold = "zero"')
    rows = _comb(values)
    interval = rows * float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    if rows > 1 and interval <= SLOWEST_COMB_S:
        text = f"it changes only every {interval:.3g} s, at every row {rows}"
        return InputHold("", f'{text}: if it was recorded at that rate, give hold = "sampled" and repeats = "drop"')
    return InputHold("", "")


def _follows(values: Column) -> bool:
    """Whether the changes of a signal (n,) go on in the rows behind them, as those of a shaft with a lag do."""
    if len(values) < 5:
        return False
    steps = np.diff(values)
    size, top = np.abs(steps), float(np.max(np.abs(values)))
    now, after = steps[2:-1], steps[3:]
    # The largest change of a response. The row before it may have a part of it; two rows before it all is quiet.
    onset = (size[2:-1] > ONSET * top) & (size[2:-1] >= size[1:-2]) & (size[2:-1] >= size[3:])
    onset &= size[:-3] < QUIET * size[2:-1]
    if np.count_nonzero(onset) < FEWEST_ONSETS:
        return False
    share = after[onset] / now[onset]
    return bool(np.mean((share > TAIL[0]) & (share < TAIL[1])) >= MOST_TAILS)


def _comb(values: Column) -> int:
    """The largest number of rows k such that the values (n,) change at every k-th row only; 1 for few changes."""
    rows = np.flatnonzero(np.diff(values) != 0.0)
    if len(rows) < FEWEST_CHANGES:
        return 1
    return int(np.gcd.reduce(np.diff(rows)))
