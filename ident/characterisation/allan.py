"""Allan deviation of a sensor at rest, and the numbers of data sheets: noise density, bias instability, random walk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from seatrial.ident.characterisation.sensor_noise import longest_part
from seatrial.ident.data import Channel
from seatrial.ident.numerics import Array

PER_DECADE = 10  # averaging times in a decade
LEAST_PARTS = 5  # of the record at the longest averaging time: with fewer its deviation is hardly known
FLICKER = 0.664  # minimum of the Allan deviation of flicker noise over its bias instability: sqrt(2 ln 2 / pi)


@dataclass(frozen=True)
class AllanDeviation:
    """Allan deviation of a channel over the averaging time, with its bias instability.

    Attributes
    ----------
    tau, deviation, error : Array (n,)
        Averaging times [s], Allan deviations [unit], and their standard errors [unit].
    bias_instability : float
        Smallest deviation / 0.664 [unit]. If it is that of the longest averaging time, it is an upper limit.
    bias_tau : float
        Averaging time of the smallest deviation [s].
    is_limit : bool
        Whether the deviation still falls at the longest averaging time.
    """

    tau: Array
    deviation: Array
    error: Array
    bias_instability: float
    bias_tau: float
    is_limit: bool


def allan_deviation(channel: Channel) -> AllanDeviation | None:
    """Return the overlapping Allan deviation of a channel at rest.

    Of a channel with gaps, the longest part is used. Its samples count as evenly spaced.

    Parameters
    ----------
    channel : Channel
        Samples of the channel.

    Returns
    -------
    AllanDeviation or None
        None for a part with fewer than ten samples, or with equal values.

    Notes
    -----
    IEEE Std 952-2020, annex C. The standard error is that for white noise, ``deviation / sqrt(2 (n / m - 1))`` with m
    samples in the averaging time. It does not count that the averages overlap, so it is rather too large.
    """
    part = longest_part(channel)
    y, n = part.value, part.value.size
    if n < 2 * LEAST_PARTS or not np.ptp(y) > 0.0:
        return None
    dt = float(np.median(np.diff(part.t)))
    largest = n // LEAST_PARTS
    m = np.unique(np.geomspace(1, largest, int(PER_DECADE * np.log10(largest)) + 2).round().astype(int))
    angle = np.concatenate([[0.0], np.cumsum(y - y.mean())])
    deviation = np.array([_deviation(angle, int(k)) for k in m])
    k = int(np.argmin(deviation))
    return AllanDeviation(
        tau=dt * m,
        deviation=deviation,
        error=deviation / np.sqrt(2.0 * (n / m - 1.0)),
        bias_instability=float(deviation[k]) / FLICKER,
        bias_tau=float(dt * m[k]),
        is_limit=k == m.size - 1,
    )


def _deviation(total: Array, m: int) -> float:
    """Return the overlapping Allan deviation for averages of m samples, from the sums (n + 1,) of the samples."""
    second = total[2 * m :] - 2.0 * total[m:-m] + total[: -2 * m]
    return float(np.sqrt(0.5 * np.mean(second**2)) / m)
