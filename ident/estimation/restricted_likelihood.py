"""Restricted maximum likelihood (REML): noise estimates corrected for the degrees of freedom of the dynamic parameters.

Maximum likelihood divides the sum of squared innovations by their number. The fitted dynamics have reduced that sum, so
that the estimate of the noise is too small. An example is the fit of a mass and two damping coefficients to five
minutes of one position: the noise is too small by a third of its standard error. Integrated over the dynamics by
Laplace's approximation, the likelihood is

    ln L_R(phi) = max over theta of ln L(theta, phi) - 1/2 ln det I_theta,theta(phi)

with the information of the dynamics theta at each noise phi (Cox and Reid 1987). Their orthogonality condition holds:
the noise does not change the mean of the predictions. For linear models this is the REML of Patterson and Thompson
(1971). The determinant changes slowly, so that one Newton step from the maximum of ln L is enough. Its gradient by phi
is computed by finite differences.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.estimation.fisher_scoring import Evaluation, Optimum, Problem, solve_step
from seatrial.ident.estimation.standard_errors import DROP_95
from seatrial.ident.numerics import Array, scaled_eigen, unit_diagonal

LOG_DIFFERENCE_STEP = 0.05  # step of a logarithm in finite differences; the log-determinant is nearly linear over it
MIN_LOG_INFORMATION = 1.0  # with less information on its logarithm, a noise is not even known in order of magnitude
PRIOR_ONLY = 0.5  # a parameter is known from its prior if the prior has a larger share of the information
NULL_SPACE_TOLERANCE = 1e-9  # smaller eigenvalues of the information scaled to unit diagonal contain no information
LEAST_DIAGONAL = 1e-300  # replaces a zero on the diagonal of an information matrix


def apply_reml(problem: Problem, maximum: Optimum) -> Optimum:
    """Take one Newton step from the maximum of the likelihood to that of the restricted likelihood (REML).

    Maximum likelihood underestimates the noise, because the fitted dynamics reduce the innovations; the step corrects
    this. It moves noise parameters and dynamic parameters. A noise parameter is not corrected itself, and only follows
    the others, if it is not estimated as a logarithm, is at a bound, or if the data do not determine its order of
    magnitude (an information of at most 1 on its logarithm). A dynamic parameter that all records share and of which
    the prior has more than half of the information keeps its value.

    Parameters
    ----------
    problem
        Objective of the fit.
    maximum
        Maximum of the likelihood (with priors), the end point of the search.

    Returns
    -------
    Optimum
        Point after the step. ``at`` contains the gradient of the restricted likelihood, but the value of the likelihood
        at its maximum. The result is ``maximum`` itself in these cases: there is no noise to correct, or no dynamic
        parameter inside its bounds that the data determine; the information is not finite; the step of a coordinate
        exceeds its standard error; the likelihood falls by more than 1.92 or cannot be evaluated.
    """
    names = problem.model.noise_parameters
    inside = ~np.logical_or(*problem.bounds.reached(maximum.z)) & (np.diag(maximum.at.information) > 0)
    is_noise = np.array([p.name in names for p in problem.parameters])
    informed = problem.bounds.logarithmic & (np.diag(maximum.at.information) > MIN_LOG_INFORMATION)
    noise = np.flatnonzero(is_noise & inside & informed)
    # A parameter that is known from its prior, such as a thrust, takes no degree of freedom from the data. It stays.
    weight = problem.prior[1] * np.nan_to_num(_identified_standard_errors(maximum.at.hessian)) ** 2
    shared = np.array([p.segment is None for p in problem.parameters])
    prior_only = ~is_noise & shared & (weight > PRIOR_ONLY)
    dynamics = np.flatnonzero(~is_noise & inside & ~prior_only)
    if not noise.size or not dynamics.size:
        return maximum
    base = _information_log_det(problem, maximum.z, dynamics)
    slope = np.zeros(maximum.z.size)
    for k in noise.tolist():
        moved = maximum.z.copy()
        moved[k] += LOG_DIFFERENCE_STEP
        slope[k] = -0.5 * (_information_log_det(problem, moved, dynamics) - base) / LOG_DIFFERENCE_STEP
    if not np.isfinite(slope).all():
        return maximum
    hessian = maximum.at.hessian * np.outer(~prior_only, ~prior_only) + np.diag(
        prior_only * np.diag(maximum.at.hessian)
    )
    pushed = replace(maximum.at, gradient=np.where(prior_only, 0.0, maximum.at.gradient + slope))
    step = solve_step(pushed, hessian, maximum.z, problem.bounds, 0.0)
    if (np.abs(step) > _identified_standard_errors(maximum.at.hessian)).any():
        return maximum
    z = problem.bounds.clip(maximum.z + step)
    at = problem.evaluate(z)
    if not at.finite or at.value < maximum.at.value - DROP_95:
        return maximum
    there = Evaluation(maximum.at.value, at.gradient + slope, at.information, at.curvature)
    return Optimum(z, there, maximum.iterations, maximum.evaluations + noise.size + 2, maximum.gain_left)


def _identified_standard_errors(H: Array) -> Array:
    """Return the standard errors (n,) that a negative Hessian H (n, n) implies, in the estimator's coordinates.

    Combinations of parameters that the data do not identify are left out. A reliable step ends within these errors. If
    a step is longer, it follows a combination that the data hardly identify, and is no Newton step.
    """
    w, V, scale = scaled_eigen(H, LEAST_DIAGONAL)
    identified = w > NULL_SPACE_TOLERANCE
    return np.asarray(np.sqrt((V[:, identified] ** 2 / w[identified]).sum(axis=1)) / scale)


def _information_log_det(problem: Problem, z: Array, which: NDArray[np.intp]) -> float:
    """Return the natural logarithm of the determinant of the Fisher information of some coordinates of a fit.

    Coordinates are parameters, or the logarithms of positive parameters.

    Parameters
    ----------
    problem
        Objective of the fit. The information includes that of the priors.
    z : Array (n,)
        Coordinates at which the information is computed.
    which : Array of int
        Indices of the coordinates whose information is taken.

    Returns
    -------
    float
        NaN if the information is not finite. Eigenvalues below 1e-9 of the information, scaled to unit diagonal, are
        replaced by 1e-9, so that combinations that the data do not identify do not dominate.
    """
    part = problem.information(z, which)
    if not np.isfinite(part).all():
        return float("nan")
    scaled, scale = unit_diagonal(part, LEAST_DIAGONAL)
    w = np.linalg.eigvalsh(scaled)
    return float(np.log(np.maximum(w, NULL_SPACE_TOLERANCE)).sum() + 2.0 * np.log(scale).sum())
