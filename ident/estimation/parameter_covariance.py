"""Parameter covariance, and its contribution to the variance of a prediction (delta method).

The covariance of the estimates is split into directions of one standard deviation each: the eigenvectors of their
correlation, times the standard deviations. The prediction is computed with the parameters moved either way along each
direction. Half the differences are the columns of ``J L``:

    var y = H P H' + R + sum_k (y(theta + l_k) - y(theta - l_k))^2 / 4,   L L' = cov theta

This is the delta method with central differences over one standard deviation. Unlike derivatives, the differences
include the nonlinearity of the model over that distance (as do the sigma points of an unscented transform: Julier and
Uhlmann 1997). Parameters move in the estimator's coordinates (logarithms of positive ones) and stay inside their
bounds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from seatrial.ident.data import Record
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import Fit
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.estimation.prepared_record import Preparer
from seatrial.ident.model import Model, Parameter
from seatrial.ident.numerics import Array, covariance_root

NULL_SPACE_TOLERANCE = 1e-12  # smaller eigenvalues of the correlation, relative to the largest, are rounding
PARAMETER_STEP = 0.05  # step of finite differences [standard deviations]; models are linear over it


@dataclass(frozen=True)
class ParameterUncertainty:
    """Uncertainty of a fit's parameters: k directions, one standard deviation long, that make up their covariance.

    They are the eigenvectors of the correlation, times the standard deviations. In general they are not orthogonal.

    Attributes
    ----------
    columns
        Indices of the n uncertain parameters in ``model.parameters``.
    root : Array (n, k)
        Square root of their covariance (``root root'`` is the covariance): column j is direction j with a length of one
        standard deviation, in the estimator's coordinates (logarithms of positive parameters).
    """

    columns: tuple[int, ...]
    root: Array

    def values_one_deviation_away(self, model: Model, values: Array) -> Iterator[tuple[Array, Array]]:
        """Yield two copies of parameter values for each direction (column of ``root``), one standard deviation away.

        The first copy is moved in the direction, the second one against it. Predictions with both give the variance by
        the parameters.

        Parameters
        ----------
        model : Model
            Model whose parameters have the transforms and bounds.
        values : Array (n_parameters,)
            Values in the order of ``model.parameters``, in their own units.
        """
        for step in self.root.T:
            yield self._values_moved_by(model, values, step), self._values_moved_by(model, values, -step)

    def _values_moved_by(self, model: Model, values: Array, step: Array) -> Array:
        """Return a copy of parameter values with the n uncertain ones moved by a step and clipped to their bounds.

        The ``step`` (n,) is in the estimator's coordinates (logarithms of positive parameters). ``values``
        (n_parameters,) and the result are in the parameters' own units. All other values are copied unchanged.
        """
        out = values.copy()
        for i, d in zip(self.columns, step.tolist(), strict=True):
            p = model.parameters[i]
            out[i] = np.clip(p.from_free(p.to_free(float(values[i])) + d), *p.bounds)
        return out


def parameter_uncertainty(fit: Fit, record: int | None = None) -> ParameterUncertainty:
    """Return the uncertainty of a fit's parameters for predictions, as a square root of their covariance.

    Noise parameters are left out, because the mean of a prediction does not depend on them. So are parameters without a
    standard error (at a bound, not identified). The part of the covariance from considered parameters (not estimated,
    such as the calibration of a sensor) is subtracted: a prediction is compared with the same sensors that were wrong
    in the fit.

    Parameters
    ----------
    fit
        Fit whose parameters are uncertain.
    record
        Index of a record of the fit, to include its per-record parameters. None: no per-record parameter is included,
        for a record that is not in the fit.
    """
    noise, parameters = fit.model.noise_parameters, list(fit.model.parameters)
    selected = [p.name not in noise if p.segment is None else p.segment == record for p in fit.parameters]
    at = [i for i, w in enumerate(selected) if w and np.isfinite(fit.errors[i])]
    names = [p.name for p in parameters]
    columns = tuple(names.index(fit.parameters[i].name) for i in at)
    slopes = np.array([parameters[c].slope(float(fit.values[i])) for c, i in zip(columns, at, strict=True)])
    P = (fit.covariance - fit.considered)[np.ix_(at, at)] / np.outer(slopes, slopes)
    return ParameterUncertainty(columns, covariance_root(P, NULL_SPACE_TOLERANCE))


def prediction_variance(
    uncertainty: ParameterUncertainty, model: Model, record: Record, values: Array, known: int, likelihood: Likelihood
) -> Array:
    """Return the variance that the uncertainty of the parameters adds to predictions.

    The filter uses the measurements of the first ``known`` rows. From there the prediction uses the inputs only.

    Parameters
    ----------
    uncertainty
        Directions in which the parameters are moved.
    model
        Model that predicts.
    record
        Record with the measurements and inputs.
    values : Array (n_parameters,)
        Values of the parameters, in the order of ``model.parameters``.
    known
        Number of rows whose measurements are used, at least 1.
    likelihood
        Likelihood of the model, with process noise.

    Returns
    -------
    Array (n_rows, n_outputs)
        Variances in squared units of the outputs. They are zero in the first ``known`` rows, where measurements correct
        the prediction. They are infinite if the prediction diverges within one standard deviation of the parameters.
    """
    head, tail = record.rows(slice(0, known)), record.rows(slice(known - 1, None))
    preparer = Preparer(model)

    def outputs(v: Array) -> Array:
        """Return the outputs (n_rows - known, n_outputs) predicted after the known rows.

        ``v`` (n_parameters,) are the parameter values, both of the filter over the known rows and of the simulation
        that starts from its last state.
        """
        return simulate(model, tail, v, likelihood.filter(head, v).x_filt[-1], preparer).y[1:]

    total = np.zeros((record.n_rows, len(model.outputs)))
    for plus, minus in uncertainty.values_one_deviation_away(model, values):
        with np.errstate(over="ignore", invalid="ignore"):  # a prediction may diverge
            total[known:] += ((outputs(plus) - outputs(minus)) / 2) ** 2
    return np.nan_to_num(total, nan=np.inf, posinf=np.inf)


@dataclass(frozen=True)
class ParameterCovariance:
    """Covariance matrix of named parameters in their own units, as it is read from a model file.

    Attributes
    ----------
    names
        Names of the n parameters.
    covariance : Array (n, n) or None
        Covariance of the parameters in the order of `names`; None if unknown.
    """

    names: tuple[str, ...] = ()
    covariance: Array | None = None


def uncertainty_of(known: ParameterCovariance, model: Model) -> ParameterUncertainty | None:
    """Return the uncertainty of the parameters of a saved model for predictions, as a square root of their covariance.

    Noise parameters are left out, because the mean of a prediction does not depend on them.

    Parameters
    ----------
    known
        Covariance of the parameters in their own units.
    model
        Model at whose values the covariance holds.

    Returns
    -------
    ParameterUncertainty or None
        None if the covariance is unknown or contains no parameter of the model except noise.
    """
    names = [p.name for p in model.parameters]
    keep = [i for i, n in enumerate(known.names) if n in names and n not in model.noise_parameters]
    if known.covariance is None or not keep:
        return None
    columns = tuple(names.index(known.names[i]) for i in keep)
    slopes = np.array([p.slope(p.value) for p in (model.parameters[c] for c in columns)])
    P = known.covariance[np.ix_(keep, keep)] / np.outer(slopes, slopes)
    return ParameterUncertainty(columns, covariance_root(P, NULL_SPACE_TOLERANCE))


@dataclass(frozen=True)
class PrincipalAxes:
    """Principal axes of the parameter covariance, in the estimator's coordinates (logarithms of positive parameters).

    Noise parameters are left out: a state estimate hardly depends on them.

    Attributes
    ----------
    parameters
        The n parameters that have a covariance and are no noise.
    at
        Their indices in the parameters of the model.
    axes : Array (n, n)
        Each column is one axis, as long as one standard deviation.
    """

    parameters: tuple[Parameter, ...]
    at: tuple[int, ...]
    axes: Array

    def moved(self, values: Array, along: Array) -> Array:
        """Return the parameter vector that is ``along`` (n,) standard deviations along each axis from the estimates.

        ``values`` (n_parameters,) has the other entries. The result is not clipped to the bounds of the parameters.
        """
        point = values.copy()
        for p, i, step in zip(self.parameters, self.at, self.axes @ along, strict=True):
            point[i] = p.from_free(p.to_free(p.value) + step)
        return point


def principal_axes(model: Model, known: ParameterCovariance | None) -> PrincipalAxes:
    """Return the principal axes of the covariance of a model's parameters; without axes if the covariance is unknown.

    Parameters
    ----------
    model
        Model whose values are the estimates.
    known
        Covariance of the parameters in their own units; None if unknown.
    """
    places = {p.name: i for i, p in enumerate(model.parameters)}
    keep: list[int] = []
    if known is not None and known.covariance is not None:
        keep = [i for i, n in enumerate(known.names) if n in places and n not in model.noises]
    if known is None or known.covariance is None or not keep:
        return PrincipalAxes((), (), np.zeros((0, 0)))
    parameters = tuple(model.parameter(known.names[i]) for i in keep)
    slopes = np.array([p.slope(p.value) for p in parameters])
    w, V = np.linalg.eigh(known.covariance[np.ix_(keep, keep)] / np.outer(slopes, slopes))
    return PrincipalAxes(parameters, tuple(places[p.name] for p in parameters), V * np.sqrt(np.maximum(w, 0.0)))


def principal_directions(model: Model, values: Array, known: ParameterCovariance | None) -> list[Array]:
    """Return parameter vectors moved by 0.05 standard deviations along each principal axis of their covariance.

    Finite differences between these vectors give the effect of the parameter errors on a result.

    Parameters
    ----------
    model
        Model at whose values the axes are computed.
    values : Array (n_parameters,)
        Vector of which moved copies are returned, in the order of ``model.parameters``.
    known
        Covariance of the parameters in their own units; None if unknown.

    Returns
    -------
    list of Array (n_parameters,)
        One vector for each axis. In it, each moved parameter has the value of the model plus the step, in one direction
        only and not clipped to its bounds; the other entries are those of ``values``. The list is empty if the
        covariance is unknown or contains no parameter of the model except noise.
    """
    found = principal_axes(model, known)
    return [found.moved(values, PARAMETER_STEP * unit) for unit in np.eye(len(found.at))]


def dynamic_parameters(model: Model) -> list[str]:
    """Return the names of the free parameters of the dynamics, in the order of the model.

    They are those that all records share, except those of noise (standard deviations, diffusions) and of zero-mean
    disturbances.
    """
    noise = model.noise_parameters
    return [p.name for p in model.parameters if p.free and not p.per_record and p.name not in noise]
