"""Recogniser of the hold of an input, which describes the input between the rows of a table.

An input is a held command, a measured shaft speed, or a slower signal whose last value is repeated in each row.

Theory of operation. A measured shaft speed that is treated as a held command seems half a row late. A slow signal that
is treated as a signal of each row seems late by half of its slow interval. Both errors make the estimated masses too
large. The values show the kind of input:

- A command changes from one row to the next and then stays. A shaft speed lags: smaller changes follow the first one.
- A slow signal changes at a regular interval of several rows, and its values hardly ever repeat.
- Commands that change only at every k-th row may be a slow signal or steps of whole seconds. The values do not show
  which of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from seatrial.daq.checks import held_signals, is_measured
from seatrial.daq.importers.table import Column

ONSET = 0.05  # share of the largest value; a larger step is a change
QUIET = 0.05  # share of a change; the input is quiet before the change if its step is smaller
TAIL = (0.05, 0.95)  # share of a change that a shaft adds in the next row
FEWEST_ONSETS, LEAST_TAILS = 3, 0.7  # changes from rest, and share of them with a tail, of a shaft at least
FEWEST_CHANGES, SLOWEST_COMB_S = 12, 2.0  # changes at every k-th row at least, and their longest interval [s]


class InputHold(NamedTuple):
    """How an input continues between the rows of a table, as it is recognised from its values.

    Attributes
    ----------
    hold : str
        "linear" (measured shaft speed) or "sampled" (held values recorded at a rate); "" for the default of inputs: the
        last value holds.
    caveat : str
        What is uncertain in the hold, for the user; "" if the hold is certain.
    """

    hold: str  # as in a map; "" for the default
    caveat: str  # "" if the hold is certain


def input_hold(t: Column, values: Column, *, may_be_shaft: bool) -> InputHold:
    """Recognise how an input (command or shaft speed) continues between the rows of a table, by its values.

    Parameters
    ----------
    t, values
        Times [s] and values of the rows (n,), in order and without NaN.
    may_be_shaft
        Whether the name of the column allows a shaft speed.

    Returns
    -------
    InputHold
        The hold and a caveat about it. The hold is "" if the values do not show it; the caveat then remarks on changes
        only at every k-th row, if they are at most 2 s apart, and is "" otherwise.
    """
    held = held_signals(t, {"input": values}).get("input")
    if held is not None:
        interval = held.rows * float(np.median(np.diff(t)))
        if is_measured(values[held.new], interval):
            if may_be_shaft:
                return InputHold("linear", "its values are assumed to be a measured shaft speed")
            return InputHold("sampled", "its values are assumed to be a command that was recorded at this rate")
    if may_be_shaft and _lags_like_shaft(values):
        return InputHold("linear", 'its values lag like a measured shaft speed; if it is a command, give hold = "zero"')
    rows = _rows_per_change(values)
    interval = rows * float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    if rows > 1 and interval <= SLOWEST_COMB_S:
        text = f"it changes only every {interval:.3g} s, every {rows} rows"
        return InputHold("", f'{text}: if it was recorded at that rate, give hold = "sampled" and repeats = "drop"')
    return InputHold("", "")


def _lags_like_shaft(values: Column) -> bool:
    """Return whether the values of an input (n,) lag like the speed of a shaft: a change continues in the next row.

    At least 3 changes above 5 % of the largest magnitude are needed. Each must be as large as the steps before and
    after it, and the step two rows before it must be nearly zero. In at least 70 % of these changes the next row must
    add 5 % to 95 % of the change. With fewer than 5 values the result is False.
    """
    if len(values) < 5:
        return False
    steps = np.diff(values)
    size, top = np.abs(steps), float(np.max(np.abs(values)))
    now, after = steps[2:-1], steps[3:]
    # The largest step of a response. The step before may be a part of the response; the step before that is quiet.
    onset = (size[2:-1] > ONSET * top) & (size[2:-1] >= size[1:-2]) & (size[2:-1] >= size[3:])
    onset &= size[:-3] < QUIET * size[2:-1]
    if np.count_nonzero(onset) < FEWEST_ONSETS:
        return False
    share = after[onset] / now[onset]
    return bool(np.mean((share > TAIL[0]) & (share < TAIL[1])) >= LEAST_TAILS)


def _rows_per_change(values: Column) -> int:
    """Return the largest k such that the values of an input (n,) change only at every k-th row of its table.

    The result is 1 if there are fewer than 12 changes, because few changes may be regular by chance.
    """
    rows = np.flatnonzero(np.diff(values) != 0.0)
    if len(rows) < FEWEST_CHANGES:
        return 1
    return int(np.gcd.reduce(np.diff(rows)))
