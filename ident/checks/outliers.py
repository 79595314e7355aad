"""Checks of impossible values: point outliers that were left out, and jumps of the position that remain."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from seatrial.daq.checks import FAULT, WARNING, Finding
from seatrial.daq.errors import counted
from seatrial.ident.checks.sensors import Channels
from seatrial.ident.data import position_jumps

SHOWN = 3  # outliers that a finding lists with value and time
MANY = 0.05  # of a signal's samples; more outliers are a fault of the sensor


def check_outliers(c: Channels) -> Iterator[Finding]:
    """Yield findings on the outliers that were left out of each signal, and on jumps of the position.

    Parameters
    ----------
    c
        Channels (signals) of a log by name, with the outliers that were left out when the log was read.

    Yields
    ------
    Finding
        ``many-outliers`` (fault) if more than 5 % of a signal's samples were left out, else ``outliers-left-out``
        (warning). A signal without outliers gives no finding. ``position-jumps`` (fault) if ``x`` and ``y``, with equal
        times, make jumps that no boat can make. There is no such finding if more than 2 % of the samples plus two are
        jumps: the cause is then a wrong unit or column, which other checks find.
    """
    for name, channel in c.items():
        left_out = channel.left_out
        if left_out is None:
            continue
        n, total = left_out.t.size, left_out.t.size + channel.t.size
        rows = list(zip(left_out.t.tolist(), left_out.value.tolist(), strict=True))
        listed = ", ".join(f"{value:.4g} at {t:.2f} s" for t, value in rows[:SHOWN])
        more = f" and {n - SHOWN} more" if n > SHOWN else ""
        text = f"{counted(n, 'outlier')} of {total} samples left out: {listed}{more}"
        level, code = (FAULT, "many-outliers") if n > MANY * total else (WARNING, "outliers-left-out")
        advice = "plot the signal at these times, and check sensor and cable"
        yield Finding(level, code, "outlier", name, text, advice)
    if {"x", "y"} <= set(c) and np.array_equal(c["x"].t, c["y"].t):
        t, x, y = c["x"].t, c["x"].value, c["y"].value
        jumps = position_jumps(t, x, y)
        # Many jumps come from a wrong unit or column, which other checks find.
        if 0 < jumps.size <= 0.02 * t.size + 2:
            k = int(jumps[0])
            far = float(np.hypot(x[k] - x[k - 1], y[k] - y[k - 1]))
            more = f" ({counted(jumps.size - 1, 'more jump')})" if jumps.size > 1 else ""
            text = (
                f"jumps by {far:.0f} m in {t[k] - t[k - 1]:.2f} s, {t[k] - t[0]:.1f} s after the start of the signal"
                f"{more}"
            )
            advice = "look for a second receiver, or cut the log there (t_from, t_to under [[log]] in the import map)"
            yield Finding(FAULT, "position-jumps", "outlier", "x, y", text, advice)
