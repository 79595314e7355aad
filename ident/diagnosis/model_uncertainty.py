"""Uncertainty of the estimates because the model is incomplete.

The covariance of a fit assumes that the model is right. If candidates still pass the score tests, it is not: some
effect is missing, and the tests do not say which. Each of the passing candidates would shift the estimates by an amount
that follows from the score equations without a refit. These shifts show how much the estimates depend on the choice of
the model, and their mean square is added to the covariance: the variance between models of Draper 1995, "Assessment and
propagation of model uncertainty". If no candidate passes, nothing is added.

Common errors are small errors that every craft has (timing and mounting of sensors, form of the hull). Those that the
model lacks are taken as present, whether they pass a test or not: some data show little of them although they change
the estimates much. With the priors of the catalogue, the score equations give their mean and covariance, and thus the
bias and the covariance of the estimates without them.

A difference of the thrust of both sides makes the scale of the forces uncertain as well. The motion determines the
difference: with a half difference e, the left thrust is (1 + e) and the right thrust (1 - e) times the given curve, or
both are this times an unknown factor. If one side alone differs from its curve, because its propeller is fouled or
damaged, the factor is 1 - e or 1 + e. So a relative standard deviation of e is added to all masses and force
coefficients. If a mass has a prior too, the scale follows the given thrust only by its share in the precision of both.
Nothing is added if the user knows which side has the given thrust (`with_thrust_of`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.diagnosis.common_errors import COMMON_ERRORS, best_columns, nested_in, prior_information
from seatrial.ident.diagnosis.findings import ModelUncertainty
from seatrial.ident.diagnosis.score_test import Score, ScoreEquations
from seatrial.ident.estimation import Fit, thrust_scale_of
from seatrial.ident.model import Effect, Model, Parameter, ParameterOrigin
from seatrial.ident.models import force_power, thrust_of
from seatrial.ident.numerics import Array

CONTAINED = 9.0  # rise of the variance of a size by a curve, relative to it, from which the curve contains the size


def model_uncertainty(
    equations: ScoreEquations, passing: Sequence[Score], effects: Mapping[str, Effect], fit: Fit
) -> ModelUncertainty | None:
    """Compute how each candidate that still passes a score test would shift the estimates, without a refit.

    Parameters
    ----------
    equations
        Score equations of the fitted model.
    passing
        Scores that pass the tests on it, the largest criterion first.
    effects
        Parametric candidates by name, whose priors limit the shifts. Others have no prior.
    fit
        Fit of the model.

    Returns
    -------
    ModelUncertainty or None
        None if there is nothing to add: no candidate passes except ``waves``, which has no score equations, and the
        scale of the forces is not uncertain.
    """
    gain = equations.coefficients_on_fitted
    names, shifts, steps = [], [], {}
    common = {n: e for n, e in effects.items() if n in COMMON_ERRORS}
    # A special case of another common error counts with that one.
    covered = nested_in(common, fit.model.effects) | {m for e in common.values() for m in e.nests}
    common = {n: e for n, e in common.items() if n not in covered}
    scans = {s.name: s.scan for s in passing if s.name not in common}
    for placed in equations.indices:
        name = placed.columns.name
        if name not in scans or placed.columns.scan != scans[name]:
            continue
        at = np.asarray(placed.at)
        weight = prior_information(effects[name], placed.names) if name in effects else [0.0] * at.size
        step = equations.one_step(at, np.array(weight))
        names.append(name)
        shift = -gain[:, at] @ step
        curve = placed.columns.curve
        if curve is not None and curve.force == curve.variable:
            shift[_replaced_sizes(equations, at, fit)] = 0.0
        shifts.append(shift)
        steps[name] = dict(zip(placed.names, step.tolist(), strict=True))
    parts = _thrust_differences(passing, effects, steps, fit.model)
    difference = thrust_share(fit) * math.hypot(*parts)
    tested = {i.columns.name for i in equations.indices}
    incomplete = any(s.name in tested for s in passing)
    if not incomplete and not difference:
        return None
    parameters = equations.parameters
    shifted = np.array(shifts).reshape(len(names), len(parameters))
    of_common = _error_without(equations, common if incomplete else {})
    of_scale = difference * _force_part(parameters, fit)
    strongest = next((s.name for s in passing if s.name not in common), "")
    weaker = _weaker_side(parts) if difference else ""
    rivals = _thrust_rivals(passing, effects, fit.model) if difference else ()
    return ModelUncertainty(
        parameters, tuple(names), shifted, of_common, difference, of_scale, strongest, weaker, rivals
    )


def untested_uncertainty(fit: Fit) -> ModelUncertainty | None:
    """Return the uncertainty of a fit without score tests: that of the scale by the thrusts of both sides.

    None if the model has no difference of the sides, or if its scale does not follow from a given thrust.
    """
    parts = _thrust_differences((), {}, {}, fit.model)
    difference = thrust_share(fit) * math.hypot(*parts)
    if not difference:
        return None
    n = len(fit.names)
    return ModelUncertainty(
        tuple(fit.names),
        (),
        np.zeros((0, n)),
        np.zeros((n, n)),
        difference,
        difference * _force_part(fit.names, fit),
        weaker_side=_weaker_side(parts),
    )


def _replaced_sizes(equations: ScoreEquations, at: NDArray[np.int64], fit: Fit) -> NDArray[np.bool_]:
    """Return which estimates (n,) are parameters of added effects that the columns ``at`` of a curve contain.

    The curve is the error of a sensor over its own reading. It contains the scale factor of the sensor: with both in
    the model, their sum stays and either part is arbitrary. A shift of the size from one to the other would not show
    how well the size is known. A size is contained if the curve would raise its variance by a factor of ten.
    """
    sizes = {p.full_name for e in fit.model.effects for p in e.parameters}
    of_effect = np.array([name in sizes for name in equations.parameters])
    gain, n = equations.coefficients_on_fitted[:, at], len(equations.parameters)
    with_curve = np.linalg.pinv(equations.projected[0][np.ix_(at, at)], hermitian=True)
    alone = np.linalg.pinv(equations.normal.information[:n, :n] + np.diag(equations.prior.information), hermitian=True)
    added: Array = np.einsum("ij,jk,ik->i", gain, with_curve, gain)
    contained: NDArray[np.bool_] = np.logical_and(added > CONTAINED * np.diag(alone), of_effect)
    return contained


def _error_without(equations: ScoreEquations, common: Mapping[str, Effect]) -> Array:
    """Return the mean square error (n, n) of the estimates because the model lacks these common errors.

    With the priors, the parameters of all of them together have the mean m and the covariance P. The estimates are
    then wrong by ``G m`` on average, with the covariance ``G P G'``: G are the regression coefficients of the columns
    of the common errors on those of the fitted parameters.
    """
    placed = [*best_columns(equations, common).values()]
    if not placed:
        return np.zeros((len(equations.parameters), len(equations.parameters)))
    at = np.concatenate([np.asarray(i.at) for i in placed])
    weight = np.concatenate([prior_information(common[i.columns.name], i.names) for i in placed])
    gain = equations.coefficients_on_fitted[:, at]
    mean = gain @ equations.one_step(at, weight)
    covariance = np.linalg.pinv(equations.projected[0][np.ix_(at, at)] + np.diag(weight), hermitian=True)
    error: Array = gain @ covariance @ gain.T + np.outer(mean, mean)
    return error


def _thrust_differences(
    passing: Sequence[Score], effects: Mapping[str, Effect], steps: Mapping[str, Mapping[str, float]], model: Model
) -> list[float]:
    """Return half the relative differences of the thrust, left minus right, of the model and the candidates that pass.

    A candidate counts with its one-step estimate (``steps``, by candidate and parameter), times its score statistic
    over the largest one: if another candidate explains more, the difference may be due to it. The list is empty if
    neither the model nor a candidate that passes has such a difference, or if it is known which side has the given
    thrust: the scale of the forces then follows from it.
    """
    if thrust_of(model):
        return []
    found = [model.values[e.thrust_difference] for e in model.effects if e.thrust_difference]
    largest = max((s.lm for s in passing), default=0.0)
    for score in passing:
        name = effects[score.name].thrust_difference if score.name in effects else ""
        if name and name in steps.get(score.name, {}):
            found.append(steps[score.name][name] * score.lm / largest)
    return found


def _thrust_rivals(passing: Sequence[Score], effects: Mapping[str, Effect], model: Model) -> tuple[str, ...]:
    """Return the candidates that pass and have a difference of thrust, with their alternatives, in the order given.

    An effect is an alternative of another one if either of both names the other. The tuple is empty if the model itself
    has a difference of thrust, which the fit has estimated.
    """
    if any(e.thrust_difference for e in model.effects):
        return ()
    tested = [effects[s.name] for s in passing if s.name in effects]
    of_thrust = [e for e in tested if e.thrust_difference]
    return tuple(
        e.name
        for e in tested
        if e in of_thrust or any(e.name in d.alternatives or d.name in e.alternatives for d in of_thrust)
    )


def _weaker_side(differences: Sequence[float]) -> str:
    """Return the side with the smaller thrust, ``left`` or ``right``, given the differences, left minus right.

    The largest one decides. The text is empty without one, or if others of the opposite sign are half as large as all.
    """
    largest = max(differences, key=abs, default=0.0)
    opposite = math.hypot(*(d for d in differences if d * largest < 0.0))
    if not largest or opposite >= 0.5 * math.hypot(*differences):
        return ""
    return "left" if largest < 0.0 else "right"


def thrust_share(fit: Fit) -> float:
    """Return the share of the given thrust in what determines the scale of the forces, 0 to 1.

    It is 1 if all masses are estimated without priors from the user. It is 0 if the thrust is built in or estimated, if
    a given mass determines the scale, or in a model without thrust or mass. If both have a prior, it is the precision
    of the thrust's prior, relative to its mean, over the sum of all such precisions.
    """
    origin = thrust_scale_of(fit.model).thrust
    masses = [p for p in fit.model.parameters if p.name in ("m_u", "m_v")]
    if origin in (None, ParameterOrigin.BUILT_IN, ParameterOrigin.ESTIMATED) or not masses:
        return 0.0
    of_masses = sum(_relative_precision(p) for p in masses if p.provenance is not ParameterOrigin.ESTIMATED)
    of_thrust = _relative_precision(fit.model.parameter("c1"))
    if not of_masses:
        return 1.0
    return 0.0 if math.isinf(of_masses) else 1.0 / (1.0 + of_masses / of_thrust)


def _relative_precision(p: Parameter) -> float:
    """Return the precision of a prior relative to its mean, (mean / sd)^2; infinite for an exact value."""
    return math.inf if p.prior is None or p.exact else (p.prior[0] / p.prior[1]) ** 2


def _force_part(names: Sequence[str], fit: Fit) -> Array:
    """Return the change (n,) of the estimates with these full names, if all thrust grows by its own size.

    Masses, inertias, damping and forces grow with the thrust. The other estimates do not change.
    """
    growth = {
        p.full_name: force_power(p.unit) * value for p, value in zip(fit.parameters, fit.values.tolist(), strict=True)
    }
    return np.array([growth.get(name, 0.0) for name in names])


def with_model_uncertainty(fit: Fit, uncertainty: ModelUncertainty | None) -> Fit:
    """Return a copy of the fit whose covariance, errors and correlation include the shifts of the estimates.

    The covariance of the shifts (`ModelUncertainty.covariance`) is added to that of the estimates. The estimates
    themselves are not shifted. The covariance of the shifts is also added to ``considered``, the part of the covariance
    that is not used for predictions of the measured outputs: these are checked on validation data and do not become
    less certain. Parameters without a standard error keep none.

    Parameters
    ----------
    fit
        The fit. Parameters of the same full names get the shifts.
    uncertainty
        Shifts of the estimates. With None, the fit itself is returned.
    """
    if uncertainty is None:
        return fit
    common = [n for n in fit.names if n in uncertainty.parameters]
    at = [fit.names.index(n) for n in common]
    of = [uncertainty.parameters.index(n) for n in common]
    added = np.zeros_like(fit.covariance)
    added[np.ix_(at, at)] = uncertainty.covariance[np.ix_(of, of)]
    covariance = fit.covariance + added
    errors = np.where(np.isfinite(fit.errors), np.sqrt(fit.errors**2 + np.diag(added)), fit.errors)
    with np.errstate(invalid="ignore", divide="ignore"):
        sd = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(sd, sd)
    return replace(
        fit, covariance=covariance, errors=errors, correlation=correlation, considered=fit.considered + added
    )
