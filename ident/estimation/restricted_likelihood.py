"""Restricted maximum likelihood (REML): noise estimates corrected for the degrees of freedom of the dynamic parameters.

Maximum likelihood divides the sum of squared innovations by their number. The fitted dynamics have reduced that sum, so
that the noise comes out too small: by a third of its standard error, for a mass and two dampings from five minutes of
one position. Integrated over the dynamics (Laplace's approximation), the likelihood is

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


def apply_reml(problem: Problem, top: Optimum) -> Optimum:
    """Move from the maximum of the likelihood to that of the restricted likelihood, in noise and dynamics.

    A noise parameter keeps its value if it is not estimated as a logarithm, is at a bound, or is not informed by the
    data.

    Parameters
    ----------
    problem
        The problem of the fit.
    top
        The maximum of the likelihood.

    Returns
    -------
    Optimum
        ``at`` contains the gradient of the restricted likelihood, but the value of the likelihood at its maximum. The
        result is ``top`` if there is no noise or no dynamics to estimate, or if the step is not reliable (`_errors`).
    """
    names = problem.model.noise_parameters
    inside = ~np.logical_or(*problem.bounds.reached(top.z)) & (np.diag(top.at.information) > 0)
    is_noise = np.array([p.name in names for p in problem.parameters])
    informed = problem.bounds.logarithmic & (np.diag(top.at.information) > MIN_LOG_INFORMATION)
    noise = np.flatnonzero(is_noise & inside & informed)
    # A parameter that is known from its prior, such as a thrust, takes no degree of freedom from the data. It stays.
    weight = problem.prior[1] * np.nan_to_num(_errors(top.at.hessian)) ** 2
    shared = np.array([p.segment is None for p in problem.parameters])
    prior_only = ~is_noise & shared & (weight > PRIOR_ONLY)
    dynamics = np.flatnonzero(~is_noise & inside & ~prior_only)
    if not noise.size or not dynamics.size:
        return top
    base = _log_det(problem, top.z, dynamics)
    slope = np.zeros(top.z.size)
    for k in noise.tolist():
        moved = top.z.copy()
        moved[k] += LOG_DIFFERENCE_STEP
        slope[k] = -0.5 * (_log_det(problem, moved, dynamics) - base) / LOG_DIFFERENCE_STEP
    if not np.isfinite(slope).all():
        return top
    hessian = top.at.hessian * np.outer(~prior_only, ~prior_only) + np.diag(prior_only * np.diag(top.at.hessian))
    pushed = replace(top.at, gradient=np.where(prior_only, 0.0, top.at.gradient + slope))
    step = solve_step(pushed, hessian, top.z, problem.bounds, 0.0)
    if (np.abs(step) > _errors(top.at.hessian)).any():
        return top
    z = problem.bounds.clip(top.z + step)
    at = problem.evaluate(z)
    if not at.finite or at.value < top.at.value - DROP_95:
        return top
    there = Evaluation(top.at.value, at.gradient + slope, at.information, at.curvature)
    return Optimum(z, there, top.iterations, top.evaluations + noise.size + 2, top.gain_left)


def _errors(H: Array) -> Array:
    """Return standard errors (n,), without combinations of parameters that the data do not identify.

    A reliable step ends within these errors. If a step is longer, it follows a combination that the data hardly
    identify, and is no Newton step.
    """
    w, V, scale = scaled_eigen(H, LEAST_DIAGONAL)
    identified = w > NULL_SPACE_TOLERANCE
    return np.asarray(np.sqrt((V[:, identified] ** 2 / w[identified]).sum(axis=1)) / scale)


def _log_det(problem: Problem, z: Array, which: NDArray[np.intp]) -> float:
    """Return the log-determinant of the information of the coordinates ``which``.

    Combinations that the data do not identify count with ``NULL_SPACE_TOLERANCE``. NaN if the information is not
    finite.
    """
    part = problem.information(z, which)
    if not np.isfinite(part).all():
        return float("nan")
    scaled, scale = unit_diagonal(part, LEAST_DIAGONAL)
    w = np.linalg.eigvalsh(scaled)
    return float(np.log(np.maximum(w, NULL_SPACE_TOLERANCE)).sum() + 2.0 * np.log(scale).sum())
