"""Waves as a candidate: what no sensitivity shows, a narrow peak in the spectrum of the innovations.

The likelihood is even in the size of the waves, so at zero their score vanishes. The peak stands in for it: its p value
is that of the candidate, and the refit starts at its frequency with forces of some size.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from ident.effects.waves import EFFECT, FORCES
from ident.model import Model
from ident.residuals import SpectralPeak, spectral_peak
from ident.score import Score
from ident.stage import Stage, View

Array = NDArray[np.float64]
SURE = 1e-6  # what merely coloured innovations do not reach (tests/ident/test_spectral_peak.py)
SLOWEST = 0.25  # s between samples; a slower channel does not see waves
SMALLEST_P = 1e-300
SIZE = 0.4  # of the usual forces, at which the refit starts


def wave_score(stage: Stage) -> Score | None:
    """The candidate ``waves`` for a fitted model, None where no peak is beyond doubt.

    ``step`` and ``scan`` give the refit its start. The peak's p value serves as the block version's too: it is one of
    averages over blocks, and neighbouring bins keep it valid for coloured innovations.
    """
    peaks = [peak for view in stage.estimation for peak in _peak(stage.model, view)]
    low, high = next(p.bounds for p in EFFECT.parameters if p.name == "f_wave")
    # a peak beyond the waves' band, as resampled channels have at 5 Hz, is no wave
    best = min((peak for peak in peaks if low <= peak.frequency <= high), key=lambda peak: peak.p, default=None)
    if best is None or best.p * len(peaks) > SURE:
        return None
    df = len(EFFECT.parameters)
    lm = float(stats.chi2.isf(max(best.p * len(peaks), SMALLEST_P), df))
    step = {f"A_{force}": SIZE * usual for force, (_, usual) in FORCES.items()}
    return Score(EFFECT.name, lm, df, lm, step, {"f_wave": best.frequency}, generic=False)


def _peak(model: Model, view: View) -> list[SpectralPeak]:
    """At most one for each record: of its rates and accelerations, not of what drifts."""
    by_step: dict[float, dict[str, Array]] = {}
    for j, output in enumerate(model.outputs):
        there = np.isfinite(view.run.standardised[:, j])
        if "/s" in output.unit and there.sum() > 2:
            t = view.record.t[there]
            step = round(float(np.median(np.diff(t))), 4)
            if 0.0 < step <= SLOWEST:
                by_step.setdefault(step, {})[output.name] = _even(t, view.run.standardised[there, j], step)
    peaks = [spectral_peak(channels, step) for step, channels in by_step.items()]
    return [peak for peak in peaks if peak is not None]


def _even(t: Array, e: Array, step: float) -> Array:
    """On an even grid, NaN where a sample is missing."""
    at = np.round((t - t[0]) / step).astype(int)
    grid = np.full(at[-1] + 1, np.nan)
    grid[at] = e
    return grid
