"""Where the fit of a thruster starts: delay and pole from its steps, thrust coefficients by least squares."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from ident.dataset import Record

Array = NDArray[np.float64]
STEP = 0.05  # s
LONGEST = 4.8  # s, of the delays that are tried
POLES = np.geomspace(0.2, 20.0, 14)  # 1/s


def first_guess(records: Sequence[Record], has_force: bool) -> dict[str, float]:
    """Thrust coefficients by least squares of force on measured shaft speed; the shaft's delay and pole."""
    tau, a = shaft_guess(records)
    guess = {"tau": tau, "a": a}
    if not has_force:
        return guess
    rows = []
    for r in records:
        seen = np.isfinite(r.y[:, 1])
        n = np.interp(r.t[seen], r.t[np.isfinite(r.y[:, 0])], r.y[np.isfinite(r.y[:, 0]), 0])
        rows.append(np.column_stack([n * np.abs(n), n * n, np.ones(n.size), r.y[seen, 1]]))
    table = np.concatenate(rows)
    c1, c2, bias = np.linalg.lstsq(table[:, :3], table[:, 3], rcond=None)[0]
    return guess | {"c1": max(float(c1), 0.1), "c2": float(c2), "bias": float(bias)}


def shaft_guess(records: Sequence[Record]) -> tuple[float, float]:
    """Delay [s] and pole [1/s] of the first-order answer to the command that is least far from the measured speed.

    By mean absolute errors on a grid of both: a search from one start stops at a slow pole where the delay is long.
    """
    delays = np.arange(round(LONGEST / STEP) + 1)
    errors = np.zeros((POLES.size, delays.size))
    for r in records:
        t = np.arange(r.t[0], r.t[-1], STEP)
        command = r.u[np.clip(np.searchsorted(r.t, t, side="right") - 1, 0, None), r.inputs.index("n_cmd_0")]
        seen = np.isfinite(r.y[:, 0])
        n, row = r.y[seen, 0], np.clip(np.round((r.t[seen] - r.t[0]) / STEP).astype(int), 0, t.size - 1)
        for i, a in enumerate(POLES):
            keep = np.exp(-a * STEP)
            answer = np.append(lfilter([0.0, 1.0 - keep], [1.0, -keep], command), 0.0)  # the last: before the start
            errors[i] += [np.abs(n - answer[np.maximum(row - k, -1)]).sum() for k in delays]
    best, at = np.unravel_index(np.argmin(errors), errors.shape)
    return float(delays[at] * STEP), float(POLES[best])
