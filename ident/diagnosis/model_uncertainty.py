"""Uncertainty of the estimates because the model is incomplete.

The covariance of a fit assumes that the model is right. If candidates still pass the score tests, it is not: some
effect is missing, and the tests do not say which. Each of the passing candidates would shift the estimates by an amount
that follows from the score equations without a refit. These shifts show how much the estimates depend on the choice of
the model, and their mean square is added to the covariance: the variance between models of Draper 1995, "Assessment and
propagation of model uncertainty". If no candidate passes, nothing is added.

A difference of the thrust of both sides makes the scale of the forces uncertain as well. The motion determines the
difference: with a half difference e, the left thrust is (1 + e) and the right thrust (1 - e) times the given curve, or
both are this times an unknown factor. If one side alone differs from its curve, because its propeller is fouled or
damaged, the factor is 1 - e or 1 + e. So a relative standard deviation of e is added to all masses and force
coefficients.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seatrial.ident.diagnosis.common_errors import prior_information
from seatrial.ident.diagnosis.score_test import Score, ScoreEquations
from seatrial.ident.estimation import Fit, thrust_scale_of
from seatrial.ident.model import Effect, Model, ParameterOrigin
from seatrial.ident.models import force_power
from seatrial.ident.numerics import Array


@dataclass(frozen=True)
class ModelUncertainty:
    """Shifts of the estimates that each candidate which still passes the score tests would cause.

    Attributes
    ----------
    parameters
        Full names of the n fitted parameters.
    candidates
        Names of the m candidates that pass, without ``waves``, which has no score equations.
    shifts : Array (m, n)
        Change of each estimate if the candidate were added to the model, in the units of the parameters.
    thrust_difference : float
        Half the relative difference of the thrust of both sides. It is zero if the scale of the forces does not follow
        from the given thrust.
    scale_shift : Array (n,)
        Change of each estimate if only one side deviates from the given thrust, by the whole difference.
    """

    parameters: tuple[str, ...]
    candidates: tuple[str, ...]
    shifts: Array
    thrust_difference: float
    scale_shift: Array

    @property
    def covariance(self) -> Array:
        """Part of the covariance (n, n) of the estimates that is due to the incomplete model.

        It is the mean over the candidates of the outer product of the shifts with themselves, plus the outer product of
        ``scale_shift`` with itself.
        """
        product: Array = self.shifts.T @ self.shifts / max(len(self.candidates), 1)
        return product + np.outer(self.scale_shift, self.scale_shift)


def model_uncertainty(
    equations: ScoreEquations, passing: Sequence[Score], effects: Mapping[str, Effect], fit: Fit
) -> ModelUncertainty | None:
    """Compute how each candidate that still passes a score test would shift the estimates, without a refit.

    Parameters
    ----------
    equations
        Score equations of the fitted model.
    passing
        Scores that pass the tests on it.
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
    scans = {s.name: s.scan for s in passing}
    for placed in equations.indices:
        name = placed.columns.name
        if name not in scans or placed.columns.scan != scans[name]:
            continue
        at = np.asarray(placed.at)
        weight = prior_information(effects[name], placed.names) if name in effects else [0.0] * at.size
        step = equations.one_step(at, np.array(weight))
        names.append(name)
        shifts.append(-gain[:, at] @ step)
        steps[name] = dict(zip(placed.names, step.tolist(), strict=True))
    given = has_given_thrust(fit)
    difference = _thrust_difference(passing, effects, steps, fit.model) if given else 0.0
    if not names and not difference:
        return None
    parameters = equations.parameters
    shifted = np.array(shifts).reshape(len(names), len(parameters))
    return ModelUncertainty(parameters, tuple(names), shifted, difference, difference * _force_part(parameters, fit))


def _thrust_difference(
    passing: Sequence[Score], effects: Mapping[str, Effect], steps: Mapping[str, Mapping[str, float]], model: Model
) -> float:
    """Return half the relative difference of the thrust of both sides, by the model or by the candidates that pass.

    A candidate counts with its one-step estimate (``steps``, by candidate and parameter), times its score statistic
    over the largest one: if another candidate explains more, the difference may be due to it. It is 0 if neither the
    model nor a candidate that passes has such a difference.
    """
    found = [model.values[e.thrust_difference] for e in model.effects if e.thrust_difference]
    largest = max((s.lm for s in passing), default=0.0)
    for score in passing:
        name = effects[score.name].thrust_difference if score.name in effects else ""
        if name and name in steps.get(score.name, {}):
            found.append(steps[score.name][name] * score.lm / largest)
    return math.hypot(*found)


def has_given_thrust(fit: Fit) -> bool:
    """Return whether the scale of the forces follows from a given thrust, exact or with a standard deviation.

    It does not if the thrust is built in, if a given mass determines it, or in a model without thrust or mass.
    """
    scale = thrust_scale_of(fit.model)
    masses = [p for p in fit.model.parameters if p.name in ("m_u", "m_v")]
    return (
        scale.thrust not in (None, ParameterOrigin.BUILT_IN, ParameterOrigin.ESTIMATED)
        and bool(masses)
        and all(p.provenance is ParameterOrigin.ESTIMATED for p in masses)
    )


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
