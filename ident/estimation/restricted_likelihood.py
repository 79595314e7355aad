"""Restricted maximum likelihood (REML): noise estimates corrected for the degrees of freedom of the dynamic parameters.

Maximum likelihood divides the squares of the innovations by their number, not by what is left of it when the dynamics
have been fitted to them, so that noise comes out too small: with a mass and two dampings from five minutes of one
position, by a third of its standard error. Integrated over the dynamics (Laplace's approximation), the likelihood is

    ln L_R(phi) = max over theta of ln L(theta, phi) - 1/2 ln det I_theta,theta(phi)

with the information of the dynamics theta at each noise phi (Cox and Reid 1987, whose orthogonality holds here: noise
does not move what is predicted; for linear models it is the REML of Patterson and Thompson 1971). The determinant
changes slowly: from the maximum of ln L it takes one Newton step, whose gradient by phi is taken by differences.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.estimation.fisher_scoring import Evaluation, Optimum, Problem, solve_step
from seatrial.ident.estimation.standard_errors import DROP_95
from seatrial.ident.numerics import Array, scaled_eigen, unit_diagonal

STEP = 0.05  # of a logarithm, for differences; the log-determinant is nearly linear in it
MIN_LOG_INFORMATION = 1.0  # on a logarithm: with less not even its order of magnitude is known
PRIOR_ONLY = 0.5  # part of a parameter's information that is its prior's, from which its value is the prior's
NULL_SPACE_TOLERANCE = 1e-9  # eigenvalue of the information scaled to unit diagonal: less is no information
LEAST_DIAGONAL = 1e-300  # of an information matrix, in place of a zero


def apply_reml(problem: Problem, top: Optimum) -> Optimum:
    """From the maximum of the likelihood to that of the restricted one: other noise, and dynamics that go with it.

    Noise that is not estimated by its logarithm, that stands at a bound or that the data do not inform stays as it is.
    ``at`` of what is returned has the gradient of the restricted likelihood, but the value of the likelihood at its
    maximum. Where there is no noise to be estimated, or the step leads nowhere (``_errors``), ``top`` is returned.
    """
    names = problem.model.noise_parameters
    inside = ~np.logical_or(*problem.bounds.reached(top.z)) & (np.diag(top.at.information) > 0)
    is_noise = np.array([p.name in names for p in problem.parameters])
    told = problem.bounds.logarithmic & (np.diag(top.at.information) > MIN_LOG_INFORMATION)
    noise = np.flatnonzero(is_noise & inside & told)
    # what is known by its prior alone, such as a thrust, takes no degree of freedom from the data, and stays
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
        moved[k] += STEP
        slope[k] = -0.5 * (_log_det(problem, moved, dynamics) - base) / STEP
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
    """Standard errors (n,), of what the data see. One step leads to a maximum that lies well within them; where it is
    longer, a combination is hardly seen, and the step is no Newton step but leads anywhere."""
    w, V, scale = scaled_eigen(H, LEAST_DIAGONAL)
    seen = w > NULL_SPACE_TOLERANCE
    return np.asarray(np.sqrt((V[:, seen] ** 2 / w[seen]).sum(axis=1)) / scale)


def _log_det(problem: Problem, z: Array, which: NDArray[np.intp]) -> float:
    """Of the information of the coordinates ``which``, without combinations that the data do not see."""
    part = problem.information(z, which)
    if not np.isfinite(part).all():
        return float("nan")
    scaled, scale = unit_diagonal(part, LEAST_DIAGONAL)
    w = np.linalg.eigvalsh(scaled)
    return float(np.log(np.maximum(w, NULL_SPACE_TOLERANCE)).sum() + 2.0 * np.log(scale).sum())
