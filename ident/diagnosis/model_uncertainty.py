"""Uncertainty of the estimates because the model is incomplete.

The covariance of a fit assumes that the model is right. If candidates still pass the score tests, it is not: some
effect is missing, and the tests do not say which. Each of the passing candidates would shift the estimates by an amount
that follows from the score equations without a refit. These shifts show how much the estimates depend on the choice of
the model, and their mean square is added to the covariance: the variance between models of Draper 1995, "Assessment and
propagation of model uncertainty". If no candidate passes, nothing is added.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seatrial.ident.diagnosis.common_errors import prior_information
from seatrial.ident.diagnosis.score_test import Score, ScoreEquations
from seatrial.ident.estimation import Fit
from seatrial.ident.model import Effect
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
    """

    parameters: tuple[str, ...]
    candidates: tuple[str, ...]
    shifts: Array

    @property
    def covariance(self) -> Array:
        """Mean over the candidates of the outer product of the shifts with themselves, Array (n, n).

        It is the part of the covariance of the estimates that is due to the incomplete model.
        """
        product: Array = self.shifts.T @ self.shifts / len(self.candidates)
        return product


def model_uncertainty(
    equations: ScoreEquations, passing: Sequence[Score], effects: Mapping[str, Effect]
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

    Returns
    -------
    ModelUncertainty or None
        None if no candidate passes, or if only ``waves`` passes, which has no score equations.
    """
    gain = equations.coefficients_on_fitted
    names, shifts = [], []
    scans = {s.name: s.scan for s in passing}
    for placed in equations.indices:
        name = placed.columns.name
        if name not in scans or placed.columns.scan != scans[name]:
            continue
        at = np.asarray(placed.at)
        weight = prior_information(effects[name], placed.names) if name in effects else [0.0] * at.size
        names.append(name)
        shifts.append(-gain[:, at] @ equations.one_step(at, np.array(weight)))
    return ModelUncertainty(equations.parameters, tuple(names), np.array(shifts)) if names else None


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
