"""Calibration of prediction intervals: errors over their predicted standard deviations, by channel and horizon.

If the intervals are right, ``z = error / sd`` is standard normal. Half of the z then lie within +-0.674, and 95 % lie
within +-1.96. The distribution function at z (the probability integral transform; Dawid 1984, Gneiting, Balabdaoui and
Raftery 2007) is then uniform. Successive errors of a long prediction are correlated. The number of independent errors
is therefore the effective sample size

    n_eff = n / (1 + 2 sum_k rho_k^2)

(Bartlett 1946: the variance of a mean of squares). With it ``n_eff mean(z^2)`` is approximately chi-squared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.data import Record
from seatrial.ident.engine import vectorised
from seatrial.ident.estimation import ErrorScale, FilterResult, Likelihood
from seatrial.ident.model import Model
from seatrial.ident.numerics import Array, chi2_ppf, effective_sample_size, normal_cdf, wrap
from seatrial.ident.validation.prediction_errors import WARM_UP, SimulationRun

STRIDE = 0.2  # of the horizon, between the starts of predictions
MOST_STARTS = 1000  # of a record; errors within one horizon are strongly correlated, so more starts add little
LATE = 0.2  # of the horizon, or one row if longer: largest time from the end of the horizon to the sample
HALF, NEARLY_ALL = 0.6744898, 1.9599640  # half-widths of the 50 % and 95 % intervals of a standard normal variable
BINS = 10  # of the probability integral transform
TOLERANCE = 1.1  # ratio of actual to claimed errors, either way, that still counts as calibrated
FEW = 8.0  # independent errors; fewer are insufficient for a verdict
Verdict = Literal["right", "overconfident", "underconfident", "insufficient_data"]


@dataclass(frozen=True)
class Calibration:
    """Calibration of the prediction intervals of one channel for one kind of prediction: one step, horizon, simulation.

    Attributes
    ----------
    n, n_effective
        Number of errors, and number of independent errors with the same information (effective sample size).
    n_records
        Number of records (runs) with errors.
    inside_50, inside_95
        Shares of the errors inside the 50 % and 95 % intervals.
    scale
        Root mean square of the standardised errors (error over predicted standard deviation). It is 1 if calibrated,
        above 1 if the intervals are too narrow, and infinite if a prediction diverged.
    low, high
        95 % interval of the scale.
    pit : Array (10,)
        Histogram of the probability integral transform: shares of the errors in each tenth of the predicted
        distribution, from its lowest tenth on. All are 0.1 if calibrated.
    """

    n: int
    n_effective: float
    n_records: int
    inside_50: float
    inside_95: float
    scale: float
    low: float
    high: float
    pit: Array

    @property
    def verdict(self) -> Verdict:
        """Verdict by the 95 % interval of the scale, the ratio of actual to predicted errors.

        ``overconfident`` if the whole interval is above 1.1, for any number of errors. Otherwise ``insufficient_data``
        with fewer than eight independent errors, ``underconfident`` if the whole interval is below 1 / 1.1, and
        ``right`` (calibrated) in all other cases.
        """
        if self.low > TOLERANCE:
            return "overconfident"
        if self.n_effective < FEW:
            return "insufficient_data"
        return "underconfident" if self.high < 1.0 / TOLERANCE else "right"

    @property
    def widening(self) -> float:
        """Factor by which 95 % intervals of a further run have to be wider: `ErrorScale.widening`."""
        return self.error_scale.widening

    @property
    def simulation_widening(self) -> float:
        """Factor for the simulation of a further run: `ErrorScale.simulation_widening`."""
        return self.error_scale.simulation_widening

    @property
    def error_scale(self) -> ErrorScale:
        """Scale with the numbers of independent errors and of records, from which both factors follow."""
        return ErrorScale(self.scale, self.n_effective, self.n_records)


def calibration_test(series: Sequence[Array], effective: float | None = None) -> Calibration | None:
    """Test the calibration of standardised errors: errors divided by their predicted standard deviations.

    Parameters
    ----------
    series : Sequence of Array (n,)
        Standardised errors in time order, one series per record. NaN (no measurement) is left out. Infinite errors
        (diverged predictions) count, and make the scale infinite.
    effective
        Number of independent errors of all series together. None: it is computed from the autocorrelation of each
        series.

    Returns
    -------
    Calibration or None
        None if no series has an error.
    """
    kept = [errors for errors in (z[~np.isnan(z)] for z in series) if errors.size]
    if not kept:
        return None
    z = np.concatenate(kept)
    effective = sum(_independent_errors(errors) for errors in kept) if effective is None else effective
    square = float(np.mean(z**2))
    low, high = (np.sqrt(square * effective / chi2_ppf(q, effective)) for q in (0.975, 0.025))
    pit = np.histogram(normal_cdf(z), BINS, (0.0, 1.0))[0] / z.size
    return Calibration(
        z.size,
        effective,
        len(kept),
        float(np.mean(np.abs(z) < HALF)),
        float(np.mean(np.abs(z) < NEARLY_ALL)),
        float(np.sqrt(square)),
        float(low),
        float(high),
        pit,
    )


def _independent_errors(z: Array) -> float:
    """Return the number of independent errors (effective sample size) among standardised errors z (n,) without NaN.

    Infinite errors are left out of the autocorrelation and of the number. If all errors are infinite, they count as
    one.
    """
    finite = z[np.isfinite(z)]
    return effective_sample_size(finite) if finite.size else 1.0


def one_step_calibration(model: Model, run: FilterResult) -> dict[str, Array]:
    """Return the standardised innovations (n_rows,) of a filter run of a model, by channel.

    They are one-step prediction errors over their standard deviations; NaN in rows without a sample, and for outliers.
    Each output of the model has an entry, also one without samples.
    """
    return {o.name: run.standardised[:, j] for j, o in enumerate(model.outputs)}


@dataclass(frozen=True)
class Forecast:
    """Predictions of one channel over a horizon.

    Attributes
    ----------
    t : Array (n,)
        Times of the predicted samples [s].
    e : Array (n,)
        Measured less predicted values, in the unit of the channel. Angles are wrapped to a half turn. NaN or infinite
        if the prediction diverged.
    sd : Array (n,)
        Predicted standard deviations of the errors, with the measurement noise, in the same unit.
    """

    t: Array
    e: Array
    sd: Array


def horizon_forecasts(
    model: Model, record: Record, values: Array, run: FilterResult, seconds: float, likelihood: Likelihood | None = None
) -> dict[str, Forecast]:
    """Predict the channels of a record over a horizon, with standard deviations.

    Predictions use the inputs alone. They start from filtered states, five times per horizon, or less often in records
    that would have more than 1000 starts. The predicted sample is the first at or after the end of the horizon. It may
    be later than that by 20 % of the horizon, or by one row if a row is longer. A start without a sample in this time
    gives no prediction of the channel.

    Parameters
    ----------
    model, record
        Model and record.
    values : Array (n_parameters,)
        Parameter values.
    run
        Filter run of the record with these parameter values.
    seconds
        Horizon [s].
    likelihood
        Likelihood of the model, by default a new one.

    Returns
    -------
    dict of str to Forecast
        Forecasts by channel, in the order of the starts. Channels without a predicted sample are left out. The result
        is empty if the record is shorter than the horizon.
    """
    likelihood = likelihood or Likelihood(model)
    t, n_rows = record.t, record.n_rows
    starts = np.unique(np.searchsorted(t, np.arange(t[0], t[-1] - seconds, STRIDE * seconds)))
    if not starts.size:
        return {}
    starts = starts[:: -(-starts.size // MOST_STARTS)]
    due = np.searchsorted(t, t[starts] + seconds - 1e-6)
    ends = np.array([_first_measured_row(np.isfinite(record.y[:, j]), due) for j in range(len(model.outputs))])
    latest = t[starts] + seconds + max(LATE * seconds, 1.01 * float(np.median(np.diff(t))))
    late = (ends >= n_rows) | (t[np.minimum(ends, n_rows - 1)] > latest)
    ends[late] = -1
    x = np.full((*ends.shape, len(model.states)), np.nan)
    P = np.full((*x.shape, len(model.states)), np.nan)
    for k, first in enumerate(starts.tolist()):
        last = int(ends[:, k].max())
        if last > first:
            P_first = run.covariances(slice(first, first + 1)).P_filt[0]
            mean, covariance = likelihood.forecast(record, values, run.x_filt[first], P_first, first, last)
            channels = np.flatnonzero(ends[:, k] > first)
            x[channels, k], P[channels, k] = mean[ends[channels, k] - first], covariance[ends[channels, k] - first]
    rowwise, found = vectorised(model), {}
    for j, o in enumerate(model.outputs):
        kept = np.flatnonzero(ends[j] >= 0)
        if kept.size:
            u, y = record.u[ends[j, kept]], record.y[ends[j, kept], j]
            predicted = rowwise(x[j, kept], u, values)[:, len(model.states) + j]
            H = rowwise.output_jacobian(x[j, kept], u, values)[:, j]
            variance = np.einsum("ki,kij,kj->k", H, P[j, kept], H) + run.R[j]
            found[o.name] = Forecast(t[ends[j, kept]], wrap(y - predicted, o.angle), np.sqrt(variance))
    return found


def horizon_calibration(forecasts: Mapping[str, Forecast]) -> dict[str, Array]:
    """Return the errors (n,) of forecasts over their standard deviations, by channel.

    An error is infinite if its prediction diverged: the error is not finite, or its standard deviation is NaN.
    """
    return {name: standardised_errors(f.e, f.sd) for name, f in forecasts.items()}


def standardised_errors(e: Array, sd: Array, measured: NDArray[np.bool_] | None = None) -> Array:
    """Return prediction errors over their predicted standard deviations; infinite where a prediction diverged.

    Parameters
    ----------
    e, sd : Array (n,)
        Errors and their standard deviations. A prediction diverged if the error is not finite or the standard deviation
        is NaN.
    measured : array of bool (n,), optional
        Samples that were measured; the result is NaN for the others. By default all were measured.

    Returns
    -------
    Array (n,)
        Standardised errors.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        z = e / sd
    # without the diverged predictions, a model would be judged only by the time before its predictions diverge
    seen = True if measured is None else measured
    return np.where(seen & ~(np.isfinite(e) & ~np.isnan(sd)), np.inf, z)


def _first_measured_row(measured: NDArray[np.bool_], due: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the index of the first measured row at or after each row index of ``due`` (n,).

    It is n_rows where no measured row follows. ``measured`` (n_rows,) is true for rows with a sample.
    """
    rows = np.append(np.flatnonzero(measured), measured.size)
    return np.asarray(rows[np.searchsorted(rows, due)])


def simulation_calibration(model: Model, record: Record, run: SimulationRun) -> dict[str, Array]:
    """Return the standardised errors of the simulation ``run`` of a record after its first 15 s, by channel.

    Each array has one element per row after these 15 s: NaN without a measurement, infinite for a diverged prediction.
    """
    blind = record.t > record.t[0] + WARM_UP
    with np.errstate(invalid="ignore"):  # wrapping an infinite angle
        e = [wrap(record.y[blind, j] - run.y[blind, j], o.angle) for j, o in enumerate(model.outputs)]
    return {
        o.name: standardised_errors(e[j], run.sd[blind, j], np.isfinite(record.y[blind, j]))
        for j, o in enumerate(model.outputs)
    }


def pooled_calibration(by_record: Sequence[Mapping[str, Array]], *, together: bool = False) -> dict[str, Calibration]:
    """Test the calibration of every channel over several records.

    Parameters
    ----------
    by_record
        Standardised errors of each record, by channel. NaN (no measurement) is left out.
    together
        Whether the errors of all channels are correlated with each other. Each record then counts with the smallest
        effective sample size of its channels, for every channel. A simulation is such a case: the error of the heading
        rotates every velocity over ground.

    Returns
    -------
    dict of str to Calibration
        Calibration by channel. Channels without an error are left out.
    """
    kept = [[z[~np.isnan(z)] for z in p.values()] for p in by_record]
    counts = [[_independent_errors(z) for z in series if z.size] for series in kept]
    least = float(sum(min(c) for c in counts if c)) if together else None
    found = {}
    for name in dict.fromkeys(n for p in by_record for n in p):
        calibration = calibration_test([p[name] for p in by_record if name in p], least)
        if calibration is not None:
            found[name] = calibration
    return found
