"""How well a model predicts: one step, over a horizon and free-running, per channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.data import Record
from ident.engine import VectorisedModel
from ident.estimation import FilterResult, Likelihood, ParameterUncertainty, predict_ahead, prediction_variance
from ident.model import Model
from ident.numerics import Array, wrap

THIN = 2  # predictions over the horizon start from every second row,
MOST = 4000  # or, where a sensor is fast, from about so many
WARM_UP = 15.0  # s of measurements that a free run starts from
BLOCK = 10.0  # s of errors that are drawn together for the interval of a ratio


@dataclass(frozen=True)
class PredictionErrors:
    """Errors of one channel: their times (n,) and measured less predicted (n,); ``spread``: the standard deviation
    of what was measured then, about its mean in each record (NaN where it was not asked for)."""

    t: Array
    e: Array
    spread: float = float("nan")

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(self.e**2))) if self.e.size else float("nan")


@dataclass(frozen=True)
class SimulationRun:
    """Predicted from the inputs alone after the first 15 s: y, sd (n_rows, n_outputs), errors per channel."""

    y: Array
    sd: Array
    errors: Mapping[str, PredictionErrors]


def one_step_errors(model: Model, record: Record, run: FilterResult) -> dict[str, PredictionErrors]:
    """Innovations, in the unit of each channel."""
    found = {o.name: _errors(record.t, run.e[:, j]) for j, o in enumerate(model.outputs)}
    return {name: e for name, e in found.items() if e.e.size}


def horizon_errors(
    model: Model, record: Record, values: Array, x: Array, seconds: float
) -> dict[str, PredictionErrors]:
    """Errors of predictions from the states x (n_rows, n_states), such as the filtered ones, and the inputs alone, by
    channel; the unexplained forces decay."""
    rows = np.arange(0, record.n_rows, max(THIN, record.n_rows // MOST))
    found = predict_ahead(model, record, values, x, seconds=seconds, rows=rows)
    t = record.t[found.end]
    errors = {o.name: _errors(t, wrap(record.y[found.end, j] - found.y[:, j], o.angle))
              for j, o in enumerate(model.outputs)}
    return {name: e for name, e in errors.items() if e.e.size}


def simulation_run(
    model: Model,
    record: Record,
    values: Array,
    likelihood: Likelihood | None = None,
    doubt: ParameterUncertainty | None = None,
) -> SimulationRun:
    """The filter gets 15 s of measurements and then the inputs only; its covariance is the prediction's own band, and
    its mean is of first order.

    ``doubt``: of the parameters (``ident.estimation.parameter_covariance``), which widens the band; None takes them
    for known.
    """
    if model.second_order:  # far ahead a heading is spread too widely for a series of second order in it
        model, likelihood = replace(model, second_order=False), None
    likelihood = likelihood or Likelihood(model)
    blind = record.t > record.t[0] + WARM_UP
    y = record.y.copy()
    y[blind] = np.nan
    run = likelihood.filter(replace(record, y=y), values)
    rowwise = VectorisedModel(model)
    n = len(model.states)
    predicted = rowwise(run.x_pred, record.u, values)[:, n:]
    H = rowwise.output_jacobian(run.x_pred, record.u, values)
    variance = run.output_variance(H)
    if doubt is not None and blind.any():
        variance += prediction_variance(doubt, model, record, values, int(np.argmax(blind)), likelihood)
    errors = {}
    for j, o in enumerate(model.outputs):
        e = _errors(record.t[blind], wrap(record.y[blind, j] - predicted[blind, j], o.angle))
        if e.e.size:
            seen = record.y[blind, j][np.isfinite(record.y[blind, j])]
            errors[o.name] = replace(e, spread=float((np.unwrap(seen) if o.angle else seen).std()))
    return SimulationRun(predicted, np.sqrt(np.maximum(variance, 0)), errors)


def pooled_errors(parts: Sequence[Mapping[str, PredictionErrors]]) -> dict[str, PredictionErrors]:
    """Errors of several records as one, their times one after the other."""
    found: dict[str, PredictionErrors] = {}
    for name in dict.fromkeys(n for p in parts for n in p):
        t, e, spread, offset = [], [], 0.0, 0.0
        for p in parts:
            if name in p:
                t.append(p[name].t + offset)
                e.append(p[name].e)
                spread += p[name].spread ** 2 * p[name].e.size
                offset = float(t[-1][-1]) + 1e3
        errors = np.concatenate(e)
        found[name] = PredictionErrors(np.concatenate(t), errors, float(np.sqrt(spread / errors.size)))
    return found


def ratio_interval(
    before: PredictionErrors, after: PredictionErrors, *, block: float = BLOCK, n: int = 400, seed: int = 0
) -> tuple[float, float]:
    """95 % interval of rms(after) / rms(before) by a block bootstrap over the same blocks of time."""
    index = np.unique(np.floor(before.t / block), return_inverse=True)[1]
    n_blocks = int(index.max(initial=-1)) + 1
    if n_blocks < 4 or before.e.size != after.e.size:
        return float("nan"), float("nan")
    sums = np.array([np.bincount(index, e**2, n_blocks) for e in (before.e, after.e)])
    pick = np.random.default_rng(seed).integers(0, n_blocks, (n, n_blocks))
    ratio = np.sqrt(sums[1][pick].sum(1) / np.maximum(sums[0][pick].sum(1), 1e-300))
    low, high = np.percentile(ratio, [2.5, 97.5])
    return float(low), float(high)


def _errors(t: Array, e: Array) -> PredictionErrors:
    good = np.isfinite(e)
    return PredictionErrors(t[good], e[good])
