"""Standard errors that stay valid when residuals are coloured: from what each row has a part in, by blocks of rows.

The estimate is off by ``P sum_k s_k``, s_k the rows' part in the gradient. Where residuals remember, neighbouring parts
go together, and the variance is that of the sums over blocks which are long beside that memory (White 1982; Künsch
1989). Of a record that is hardly longer than the memory itself there are too few blocks, and nothing is said.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ident.uncertainty import Uncertainty

Array = NDArray[np.float64]
MOST, FEWEST = 40, 12  # blocks of all records
LONG = 9.0  # times the memory: blocks that miss a twentieth of the variance, which is given back
WINDOW = 5.0  # times the memory, over which it is summed (Sokal 1997, section 3)
TOO_LONG = "its residuals remember too long for an error that allows for it"


def sandwich(known: Uncertainty, rows: Sequence[tuple[list[int], Array]], slopes: Array) -> Array:
    """Standard errors in own units (n,); NaN where there is none, or where the residuals remember too long.

    rows: for each record its coordinates, and what each row adds to their gradient (n_rows, n_places). What parameters
    at their bounds add to the errors is added to these, too.
    """
    P = np.nan_to_num(known.P)
    parts = [by_row @ P[places] for places, by_row in rows]  # (n_rows, n): what each row moves the estimate by
    variance = np.array([_variance([part[:, i] for part in parts], len(P)) for i in range(len(P))])
    return np.where(np.isfinite(known.errors), np.abs(slopes) * np.sqrt(variance + np.diag(known.spread)), np.nan)


def _variance(parts: Sequence[Array], n_parameters: int) -> float:
    """Of the sum of all rows of all records; what as many parameters have taken of it is given back."""
    n = sum(part.size for part in parts)
    remembered = memory(parts)
    length = max(LONG * remembered, n / max(MOST, 4 * n_parameters))
    counts = [max(int(part.size / length), 1) for part in parts]
    n_blocks = sum(counts)
    if n_blocks < FEWEST:
        return np.nan
    total = 0.0
    for part, count in zip(parts, counts, strict=True):
        starts = np.linspace(0, part.size, count, endpoint=False).astype(int)
        total += float(np.sum(np.add.reduceat(part, starts) ** 2))
    missed = 0.5 * (remembered - 1.0) / length  # by blocks that cut an exponential memory
    taken = min(n_parameters, n_blocks // 2)  # as if each had fitted a block: a little too careful
    return total * n_blocks / (n_blocks - taken) / (1.0 - missed)


def memory(parts: Sequence[Array]) -> float:
    """Rows that series (n,) of one kind remember: the sum of their autocorrelations, both sides; 1 for white noise."""
    longest = max(part.size for part in parts)
    covariance = np.zeros(longest)
    for part in parts:
        covariance[: part.size] += autocovariance(part - part.mean())
    if not covariance[0] > 0.0:
        return 1.0
    tau = 2.0 * np.cumsum(covariance / covariance[0]) - 1.0
    enough = np.flatnonzero(np.arange(longest) >= WINDOW * tau)
    return float(max(tau[enough[0]] if enough.size else longest, 1.0))


def autocovariance(x: Array) -> Array:
    """Sums of x_k x_k+lag for lags 0 to n - 1 (n,), of a series (n,) whose mean is zero."""
    size = 1 << (2 * x.size - 1).bit_length()
    return np.asarray(np.fft.irfft(np.abs(np.fft.rfft(x, size)) ** 2, size)[: x.size])
