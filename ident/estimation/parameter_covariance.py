"""Parameter covariance, and its contribution to the covariance of a prediction (delta method).

The covariance of the estimate is split into its principal directions, of one standard deviation each; the prediction is
made with the parameters moved either way along each of them, and half the differences are the columns of ``J L``:

    var y = H P H' + R + sum_k (y(theta + l_k) - y(theta - l_k))^2 / 4,   L L' = cov theta

the delta method by central differences over a standard deviation, which also sees how far the model bends within it
(as the sigma points of an unscented transform do: Julier and Uhlmann 1997). Parameters move in the estimator's
coordinates (logarithms of positive ones) and stay within their bounds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from seatrial.ident.data import Preparer, Record
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import Fit
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.model import Model
from seatrial.ident.numerics import Array, covariance_root

NULL_SPACE_TOLERANCE = 1e-12  # of the largest eigenvalue of the correlation: below it is rounding
PARAMETER_STEP = 0.05  # standard deviations of the parameters, for differences: the model is linear over it


@dataclass(frozen=True)
class ParameterUncertainty:
    """``columns`` (n,): places among ``model.parameters``; ``root`` (n, k): directions of one standard deviation, in
    the estimator's coordinates."""

    columns: tuple[int, ...]
    root: Array

    def around(self, model: Model, values: Array) -> Iterator[tuple[Array, Array]]:
        """For each direction the values (n_parameters,) moved either way along it."""
        for step in self.root.T:
            yield self._moved(model, values, step), self._moved(model, values, -step)

    def _moved(self, model: Model, values: Array, step: Array) -> Array:
        out = values.copy()
        for i, d in zip(self.columns, step.tolist(), strict=True):
            p = model.parameters[i]
            out[i] = np.clip(p.from_free(p.to_free(float(values[i])) + d), *p.bounds)
        return out


def parameter_uncertainty(fit: Fit, record: int | None = None) -> ParameterUncertainty:
    """Of a fit's parameters but for noise, which no prediction of the mean depends on.

    record: with what that record has for itself; None: for a record that the fit has not seen, whose own parameters are
    known by other means. Parameters without a standard error (at a bound, not informed) are left out, and so is what
    considered parameters add: the sensors that are off in the fit are those that a prediction is compared with.
    """
    noise, parameters = fit.model.noise_parameters, list(fit.model.parameters)
    wanted = [p.name not in noise if p.segment is None else p.segment == record for p in fit.parameters]
    at = [i for i, w in enumerate(wanted) if w and np.isfinite(fit.errors[i])]
    names = [p.name for p in parameters]
    columns = tuple(names.index(fit.parameters[i].name) for i in at)
    slopes = np.array([parameters[c].slope(float(fit.values[i])) for c, i in zip(columns, at, strict=True)])
    P = (fit.covariance - fit.considered)[np.ix_(at, at)] / np.outer(slopes, slopes)
    return ParameterUncertainty(columns, covariance_root(P, NULL_SPACE_TOLERANCE))


def prediction_variance(
    uncertainty: ParameterUncertainty, model: Model, record: Record, values: Array, known: int, likelihood: Likelihood
) -> Array:
    """Variance (n_rows, n_outputs) that this adds to predictions from the inputs after the first ``known`` rows,
    of which the filter has the measurements; before that nothing is added, since those hold the prediction. It is
    infinite where the prediction runs away within a standard deviation."""
    head, tail = record.rows(slice(0, known)), record.rows(slice(known - 1, None))
    preparer = Preparer(model)

    def outputs(v: Array) -> Array:
        return simulate(model, tail, v, likelihood.filter(head, v).x_filt[-1], preparer).y[1:]

    total = np.zeros((record.n_rows, len(model.outputs)))
    for plus, minus in uncertainty.around(model, values):
        with np.errstate(over="ignore", invalid="ignore"):  # one that runs away, either way
            total[known:] += ((outputs(plus) - outputs(minus)) / 2) ** 2
    return np.nan_to_num(total, nan=np.inf, posinf=np.inf)


@dataclass(frozen=True)
class ParameterCovariance:
    """Covariance (n, n) of the parameters ``names`` (n,), in their own units; None: not known."""

    names: tuple[str, ...] = ()
    covariance: Array | None = None


def principal_directions(model: Model, values: Array, known: ParameterCovariance | None) -> list[Array]:
    """Parameter vectors moved by `PARAMETER_STEP` along each principal direction of the covariance.

    The directions are in the estimator's coordinates. Noise parameters, which hardly move the estimate, are left alone.
    """
    if known is None or known.covariance is None:
        return []
    noise = model.noises
    keep = [i for i, n in enumerate(known.names) if n in model.values and n not in noise]
    if not keep:
        return []
    parameters = [model.parameter(known.names[i]) for i in keep]
    slopes = np.array([p.slope(p.value) for p in parameters])
    w, V = np.linalg.eigh(known.covariance[np.ix_(keep, keep)] / np.outer(slopes, slopes))
    names, moved = [p.name for p in model.parameters], []
    for size, direction in zip(np.sqrt(np.maximum(w, 0.0)), V.T, strict=True):
        point = values.copy()
        for p, d in zip(parameters, direction, strict=True):
            point[names.index(p.name)] = p.from_free(p.to_free(p.value) + PARAMETER_STEP * size * d)
        moved.append(point)
    return moved


def dynamic_parameters(model: Model) -> list[str]:
    """Free parameters that all records share, without those of noise and of disturbance forces."""
    noise = model.noise_parameters
    return [p.name for p in model.parameters if p.free and not p.per_record and p.name not in noise]
