"""Narrow peak in the spectra of innovations, for example of waves or of an oscillation that a model lacks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from seatrial.ident.numerics.distributions import chi2_isf, chi2_sf
from seatrial.ident.numerics.linear_algebra import Array
from seatrial.ident.numerics.signal_processing import NORMAL_MAD, welch_spectrum

SEGMENT = 256  # samples of a segment in Welch's method
FIRST_BIN = 3  # first bin of the periodogram that is tested: a mean and a slow drift leak into lower bins


class SpectralPeak(NamedTuple):
    """The most significant narrow peak in a spectrum.

    Attributes
    ----------
    frequency
        Frequency of the peak [Hz].
    p
        p value over all frequencies and channels.
    channel
        Name of the channel with the peak.
    """

    frequency: float
    p: float
    channel: str


def spectral_peak(innovations: Mapping[str, Array], dt: float) -> SpectralPeak | None:
    """Find the most significant narrow peak in the spectra of standardised innovations, for example of waves.

    Parameters
    ----------
    innovations : Mapping of str to Array (n,)
        Standardised innovations by channel, evenly sampled, NaN for missing samples.
    dt
        Sample interval [s].

    Returns
    -------
    SpectralPeak or None
        The peak with the smallest p value. None if no channel has at least 640 samples, of which more than half are not
        NaN.

    Notes
    -----
    A first-order autoregression is removed from the innovations. Each bin of Welch's spectrum is then divided by
    a smooth spectrum, so that coloured innovations without a peak do not give a peak. The ratio is chi-squared with the
    degrees of freedom of half-overlapping Hann segments (Percival and Walden 1993, section 6.17). The p value is
    corrected for the number of bins and channels (Bonferroni). Of 2000 simulations of coloured noise without a peak,
    1 % have a p value below 0.001, and none below 1e-6. Use the latter as the limit.
    """
    found: list[SpectralPeak] = []
    seen = {name: _gaps_as_zeros(e) for name, e in innovations.items()}
    long_enough = {name: e for name, e in seen.items() if e.size >= 5 * SEGMENT // 2}
    for name, e in long_enough.items():
        x = e - e.mean()
        x = x[1:] - (x[1:] @ x[:-1]) / (x @ x) * x[:-1]
        frequency = np.fft.rfftfreq(SEGMENT, dt)[FIRST_BIN:-1]
        power = welch_spectrum(x, SEGMENT)[FIRST_BIN:-1]
        segments = 2 * x.size // SEGMENT - 1
        dof = 36 * segments**2 / (19 * segments - 1)
        over = power / _smooth_spectrum(power) * (chi2_isf(0.5, dof) / dof)
        at = int(np.argmax(over))
        p = float(chi2_sf(over[at] * dof, dof)) * power.size * len(long_enough)
        found.append(SpectralPeak(float(frequency[at]), min(1.0, p), name))
    return min(found, key=lambda peak: peak.p, default=None)


def _gaps_as_zeros(e: Array) -> Array:
    """Return innovations e (n,) with zero, their expectation, in place of missing ones (NaN).

    The result is empty if half or more are missing.
    """
    measured = np.isfinite(e)
    return np.where(measured, e, 0.0) if measured.mean() > 0.5 else np.zeros(0)


def _smooth_spectrum(power: Array) -> Array:
    """Return a smooth spectrum (n_bins,) through a power spectrum (n_bins,) that starts at the fourth bin.

    A cubic polynomial in the logarithms of power and frequency is fitted with Huber's weights, so that a peak does not
    raise the polynomial. The smooth spectrum is scaled so that the median ratio of the bins to it is one.
    """
    z = np.log(np.arange(FIRST_BIN, FIRST_BIN + power.size))
    basis, y = np.vander(z - z.mean(), 4), np.log(power)
    weight = np.ones(y.size)
    fitted = y
    for _ in range(15):
        fitted = basis @ np.linalg.lstsq(basis * weight[:, None], y * weight, rcond=None)[0]
        sigma = NORMAL_MAD * float(np.median(np.abs(y - fitted))) + 1e-12
        weight = np.sqrt(1.0 / np.maximum(1.0, (y - fitted) / sigma))
    return np.asarray(np.exp(fitted) * np.median(power / np.exp(fitted)))
