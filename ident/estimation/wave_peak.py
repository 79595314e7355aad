"""Frequency of waves, from a peak in the spectrum of the innovations of a fitted model.

The likelihood of a model with waves has several maxima in the frequency of the waves. A search ends at the one nearest
to its initial frequency. If waves remain in the innovations of a fit that has the effect `waves`, the fit found another
maximum than that of the waves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from seatrial.ident.effects import FORCES, WAVES
from seatrial.ident.estimation.likelihood import FilterResult
from seatrial.ident.model import Model
from seatrial.ident.models import size_of
from seatrial.ident.numerics import Array, SpectralPeak, spectral_peak

MAX_PEAK_P = 1e-6  # largest p value of a peak, times the number of peaks (`spectral_peak`)
MAX_SAMPLE_INTERVAL = 0.25  # s: slower channels do not resolve waves
INITIAL_WAVE_SIZE = 0.4  # initial wave forces of a fit, relative to typical wave forces
# Ratio from which the frequency of a peak is another one than that of the fit. A bin of the spectrum has 0.04 Hz.
OTHER_FREQUENCY = 1.25


def wave_peak(
    model: Model,
    runs: Sequence[FilterResult],
    max_p: float = MAX_PEAK_P,
    max_interval: float = MAX_SAMPLE_INTERVAL,
) -> SpectralPeak | None:
    """Return the most significant peak in the band of waves, in the innovations of a fitted model.

    Parameters
    ----------
    model
        Fitted model.
    runs
        Output of its filter on each record.
    max_p
        Largest p value of the peak, times the number of peaks (Bonferroni).
    max_interval
        Longest sample interval [s] of a channel that is searched.

    Returns
    -------
    SpectralPeak or None
        Peak, with the p value for all peaks together. None if none is significant, or if no channel can be searched.
    """
    peaks = [peak for run in runs for peak in _spectral_peaks(model, run, max_interval)]
    low, high = next(p.bounds for p in WAVES.parameters if p.name == "f_wave")
    # resampled channels have a peak at 5 Hz, which is outside the band of waves
    best = min((peak for peak in peaks if low <= peak.frequency <= high), key=lambda peak: peak.p, default=None)
    return None if best is None or best.p * len(peaks) > max_p else best._replace(p=best.p * len(peaks))


def wave_sizes(model: Model) -> dict[str, float]:
    """Return initial standard deviations of the wave forces of a fit, by parameter, for the size of the boat."""
    size = size_of(model)
    return {f"A_{force}": INITIAL_WAVE_SIZE * usual * size.of(unit) for force, (unit, usual) in FORCES.items()}


def other_wave_start(model: Model, runs: Sequence[FilterResult]) -> dict[str, float]:
    """Return initial values with which a fit may find the waves that it missed, by parameter.

    They are the frequency of the peak in the innovations, and the usual sizes and width of waves. Empty if the model
    has no effect `waves` whose frequency is estimated, if no peak is left, or if it has the frequency of the fit.
    """
    if WAVES.name not in {e.name for e in model.effects} or "f_wave" not in model.free:
        return {}
    peak = wave_peak(model, runs)
    if peak is None or abs(np.log(peak.frequency / model.values["f_wave"])) < np.log(OTHER_FREQUENCY):
        return {}
    width = next(p.value for p in WAVES.parameters if p.name == "zeta_wave")
    return {
        k: v for k, v in (wave_sizes(model) | {"f_wave": peak.frequency, "zeta_wave": width}).items() if k in model.free
    }


def _spectral_peaks(model: Model, run: FilterResult, max_interval: float) -> list[SpectralPeak]:
    """Return the spectral peaks of the innovations of a record, at most one for each sample interval.

    Only velocities, rates and accelerations are searched (outputs whose unit has "/s"). Outputs with the same median
    sample interval are searched together. Outputs slower than ``max_interval`` [s], or with fewer than three samples,
    are left out.
    """
    by_step: dict[float, dict[str, Array]] = {}
    for j, output in enumerate(model.outputs):
        measured = np.isfinite(run.standardised[:, j])
        if "/s" in output.unit and measured.sum() > 2:
            t = run.t[measured]
            step = round(float(np.median(np.diff(t))), 4)
            if 0.0 < step <= max_interval:
                by_step.setdefault(step, {})[output.name] = _on_regular_grid(t, run.standardised[measured, j], step)
    peaks = [spectral_peak(channels, step) for step, channels in by_step.items()]
    return [peak for peak in peaks if peak is not None]


def _on_regular_grid(t: Array, e: Array, step: float) -> Array:
    """Return samples e (n,) at times t (n,) [s] on a regular grid of times with this step [s]; missing samples are NaN.

    The grid begins at the first time. Each sample goes to the nearest grid time; the last of several at one time is
    used.
    """
    at = np.round((t - t[0]) / step).astype(int)
    grid = np.full(at[-1] + 1, np.nan)
    grid[at] = e
    return grid
