"""Meta-analysis of separate fits: random effects between logs, differences between campaigns, and their joint test.

Each log i has an estimate m_i of its own, and its true value scatters about the value of its campaign:

    m ~ N(X beta, V + tau^2 I)

V is the covariance of the estimates, tau the scatter between the logs, and beta the values of the campaigns. tau is
estimated by restricted maximum likelihood (Viechtbauer 2005; DerSimonian and Laird 1986 give the moment form). With few
logs, tau is uncertain itself. The covariance of beta is therefore multiplied by

    q = max(1, r' (V + tau^2 I)^-1 r / df)

with the residuals r, and its intervals are those of Student's t with ``df`` degrees of freedom (Hartung and Knapp 2001;
Knapp and Hartung 2003 for a design matrix X). The lower limit 1 prevents intervals that are narrower than the errors of
the logs allow (Roever, Knapp and Friede 2015). An error that all logs share, as that of a prior, has a known size: its
variance is added, and it raises the degrees of freedom of the sum (Satterthwaite 1946).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.numerics import Array, fisher_sf, scaled_eigen, student_ppf

LEAST_DIRECTION = 1e-9  # directions with smaller eigenvalues of the scaled covariance are left out of a joint test
MOST_DF = 1e9  # degrees of freedom from which on Student's t is a normal distribution
LEAST_OWN = 1e-6  # least share of the variance of an estimate that does not come from priors, against rounding


@dataclass(frozen=True)
class RandomEffects:
    """Random-effects model of estimates of several logs.

    Attributes
    ----------
    scatter : float
        Standard deviation of the true values between the logs about the model; 0 if the covariance of the estimates
        explains their differences.
    coefficients : Array (p,)
        Estimates beta, one for each column of the design matrix.
    covariance : Array (p, p)
        Covariance of the coefficients with this scatter, without the factor ``inflation``.
    inflation : float
        Factor q of Hartung and Knapp on the covariance, at least 1; NaN if ``df`` is 0.
    df : int
        Degrees of freedom: number of logs minus number of coefficients.
    """

    scatter: float
    coefficients: Array
    covariance: Array
    inflation: float
    df: int

    def contrast(self, weights: Array, shared: Array | None = None) -> Contrast:
        """Return a weighted sum of the coefficients, with its interval and its test against zero.

        Parameters
        ----------
        weights : Array (p,)
            Weights of the coefficients.
        shared : Array (p, p), optional
            Covariance of the coefficients by errors that all logs share. Its size is known, unlike that of the scatter.
            None: there are no such errors.

        Notes
        -----
        The variance is a sum of one with ``df`` degrees of freedom and of a known one. Its degrees of freedom are those
        of Welch (1947) and Satterthwaite (1946).
        """
        value = float(weights @ self.coefficients)
        own = float(weights @ self.covariance @ weights)
        known = 0.0 if shared is None else float(weights @ shared @ weights)
        if self.df < 1:
            return Contrast(value, (own + known) ** 0.5, float("nan"), float("nan"), float("nan"), float("nan"))
        own *= self.inflation
        error = (own + known) ** 0.5
        df = min(self.df * (1.0 + known / own) ** 2, MOST_DF) if own > 0.0 else MOST_DF
        reach = float(student_ppf(0.975, df)) * error
        p = float(fisher_sf((value / error) ** 2, 1, df)) if error > 0.0 else float("nan")
        return Contrast(value, error, value - reach, value + reach, p, df)


@dataclass(frozen=True)
class Contrast:
    """Weighted sum of coefficients of a random-effects model.

    Attributes
    ----------
    value, error
        Value and standard error.
    low, high
        95 % interval by Student's t; NaN without degrees of freedom.
    p
        p value of the value zero; NaN without degrees of freedom.
    df
        Degrees of freedom of the standard error, also with a fraction; NaN without any.
    """

    value: float
    error: float
    low: float
    high: float
    p: float
    df: float


def random_effects(values: Array, covariance: Array, design: Array) -> RandomEffects:
    """Estimate a random-effects model of the estimates of several logs, by restricted maximum likelihood.

    Parameters
    ----------
    values : Array (k,)
        Estimate of one parameter from each log.
    covariance : Array (k, k) or (k,)
        Covariance of these estimates, or their variances if they are independent; finite and positive.
    design : Array (k, p)
        Design matrix X of rank p, with p at most k. With p = k there is no information about the scatter: it is 0.

    Returns
    -------
    RandomEffects
        Scatter and coefficients.

    Notes
    -----
    The restricted likelihood may have several maxima. It is therefore evaluated on a grid of scatters, and the search
    begins at the best one.
    """
    # In the axes of V, all matrices below are diagonal.
    eigenvalues, m, X = covariance, values, design
    if covariance.ndim == 2:
        eigenvalues, axes = np.linalg.eigh(covariance)
        m, X = axes.T @ values, axes.T @ design
    df = values.size - design.shape[1]

    def solved(tau: Array) -> tuple[Array, Array, Array, Array]:
        """Return beta, its covariance, residual sum and twice the restricted log-likelihood for each scatter (n,)."""
        w = 1.0 / (eigenvalues + tau[:, None] ** 2)
        information = np.einsum("nk,kp,kq->npq", w, X, X)
        inverse: Array = np.linalg.inv(information).astype(np.float64)
        beta = (inverse @ ((w * m) @ X)[:, :, None])[:, :, 0]
        left = np.einsum("nk,nk->n", w, (m - beta @ X.T) ** 2)
        return beta, inverse, left, np.log(w).sum(axis=1) - np.linalg.slogdet(information)[1] - left

    tau = 0.0
    if df > 0:
        variances = covariance if covariance.ndim == 1 else np.diag(covariance)
        top = 10.0 * float(values.std() + np.sqrt(variances.max()))
        grid = np.append(0.0, np.geomspace(1e-4 * top, top, 200))
        from scipy import optimize  # imported here: it takes half a second, and few commands need it

        near = int(np.argmax(solved(grid)[3]))
        low, high = grid[max(near - 1, 0)], grid[min(near + 1, grid.size - 1)]
        found = optimize.minimize_scalar(
            lambda t: -float(solved(np.array([t]))[3][0]), bounds=(low, high), method="bounded"
        )
        tau = 0.0 if near == 0 else float(found.x)
    beta, inverse, left, _ = solved(np.array([tau]))
    return RandomEffects(tau, beta[0], inverse[0], max(1.0, float(left[0]) / df) if df > 0 else float("nan"), df)


def between_log_variance(values: Array, covariance: Array) -> tuple[float, float, float]:
    """Estimate the scatter between values beyond their covariance, by restricted maximum likelihood.

    It is a random-effects model: each log has its own true value, and these are normal with the scatter as standard
    deviation.

    Parameters
    ----------
    values : Array (k,)
        Estimate of one parameter from each log.
    covariance : Array (k, k) or (k,)
        Covariance of these estimates, or their variances if they are independent. Values with a NaN variance are left
        out.

    Returns
    -------
    scatter, mean, mean_error
        Standard deviation between the logs (0 if the covariance explains the differences), the mean with that scatter,
        and the standard error of the mean. All are NaN if fewer than two values remain.
    """
    variances = covariance if covariance.ndim == 1 else np.diag(covariance)
    known = np.isfinite(variances)
    if known.sum() < 2:
        return float("nan"), float("nan"), float("nan")
    kept = covariance[known] if covariance.ndim == 1 else covariance[np.ix_(known, known)]
    found = random_effects(values[known], kept, np.ones((int(known.sum()), 1)))
    return found.scatter, float(found.coefficients[0]), float(np.sqrt(found.covariance[0, 0]))


@dataclass(frozen=True)
class CampaignDifference:
    """Difference of one parameter between two campaigns of logs.

    Attributes
    ----------
    before, after
        Mean of each campaign, with its interval and its test against zero.
    difference
        Mean after minus mean before. Its test has no p value if each campaign has a single log.
    scatter
        Standard deviation of the true values between the logs of a campaign, the same in both; NaN if ``df`` is 0.
    df
        Number of logs minus two.
    """

    before: Contrast
    after: Contrast
    difference: Contrast
    scatter: float
    df: int


def campaign_difference(values: Array, own: Array, common: Array, after: NDArray[np.bool_]) -> CampaignDifference:
    """Estimate the difference of one parameter between two campaigns.

    Parameters
    ----------
    values : Array (k,)
        Estimate from each log.
    own : Array (k,)
        Variance of each estimate without the errors from priors, positive.
    common : Array (k, n_priors)
        Part of the error of each estimate by each prior. These errors are the same in all logs, so they cancel in the
        difference as far as the parts are equal.
    after : Array of bool (k,)
        Whether the log belongs to the second campaign. Both campaigns have logs.

    Notes
    -----
    The common errors are in the errors of the means, and not in their weights. A common error that is proportional to
    the estimates, such as that of a given thrust, would otherwise move the mean outside the range of the logs (Peelle's
    pertinent puzzle: Froehner 1997).
    """
    design = np.column_stack([~after, after]).astype(float)
    found = random_effects(values, own, design)
    weights = design.T / (own + found.scatter**2)
    parts = np.linalg.solve(weights @ design, weights @ common)  # of the errors of both means
    # Factor and degrees of freedom are those of the scatter, so that they do not apply to the common errors.
    before, later, difference = (
        found.contrast(np.array(w), parts @ parts.T) for w in ((1.0, 0.0), (0.0, 1.0), (-1.0, 1.0))
    )
    return CampaignDifference(before, later, difference, found.scatter if found.df else float("nan"), found.df)


def joint_difference(values: Array, own: Array, common: Array, after: NDArray[np.bool_]) -> tuple[float, int]:
    """Test whether any of several parameters differs between two campaigns.

    Parameters
    ----------
    values : Array (k, n)
        Estimates of the n parameters from each of the k logs.
    own : Array (k, n, n)
        Covariance of the estimates of each log without the errors from priors.
    common : Array (k, n, n_priors)
        Part of the error of each estimate by each prior, which is the same in all logs.
    after : Array of bool (k,)
        Whether the log belongs to the second campaign.

    Returns
    -------
    p, directions
        p value of no difference in any parameter, NaN if there are fewer than three logs, and the number of independent
        directions that were tested.

    Notes
    -----
    The parameters are rotated to the principal directions of the mean covariance of a log, along which the errors of
    the estimates are independent. The difference in each direction has a Wald test with a scatter and degrees of
    freedom of its own, as for a single parameter. The p values are combined by the Cauchy distribution (Liu and Xie
    2020), which allows that the true values of a log scatter in several directions at once. A chi-squared test of all
    differences together would need a covariance of the scatter between the parameters, which few logs do not determine.
    """
    w, V, scale = scaled_eigen(own.mean(axis=0), 1e-300)
    kept = w > LEAST_DIRECTION
    turn = (V[:, kept] / np.sqrt(w[kept])).T / scale
    rotated, parts = values @ turn.T, np.einsum("dn,knp->kdp", turn, common)
    variances = np.maximum(np.einsum("dn,knm,dm->kd", turn, own, turn), LEAST_OWN)
    p = np.array(
        [
            campaign_difference(rotated[:, d], variances[:, d], parts[:, d], after).difference.p
            for d in range(rotated.shape[1])
        ]
    )
    if not p.size or np.isnan(p).any():
        return float("nan"), p.size
    statistic = float(np.tan((0.5 - np.clip(p, 1e-15, 1.0 - 1e-15)) * np.pi).mean())
    return float(0.5 - np.arctan(statistic) / np.pi), p.size


def mean_of_logs(values: Array, covariances: Array, scatter: Array) -> tuple[Array, Array]:
    """Return the mean of the estimates of several logs, weighted with their covariances, and its covariance.

    Parameters
    ----------
    values : Array (k, n)
        Estimates of the n parameters from each log.
    covariances : Array (k, n, n)
        Covariance of the estimates of each log.
    scatter : Array (n,)
        Standard deviation of the true value of each parameter between the logs.

    Returns
    -------
    mean, covariance : Array (n,), Array (n, n)
        Unlike the means of the single parameters, this mean respects their correlations: a model with it predicts well.
    """
    weights = np.linalg.inv(covariances + np.diag(scatter**2))
    covariance = np.linalg.inv(weights.sum(axis=0))
    return covariance @ np.einsum("knm,km->n", weights, values), covariance


def conditional_mean(mean: Array, covariance: Array, known: NDArray[np.bool_], values: Array) -> Array:
    """Return the mean of normal variables (n,) given the values of those with ``known``; the others follow them.

    ``values`` (n,) has the given values; its other entries are not used.
    """
    found: Array = np.where(known, values, mean)
    if known.any() and not known.all():
        weights = np.linalg.solve(covariance[np.ix_(known, known)], covariance[np.ix_(known, ~known)])
        found[~known] += (values - mean)[known] @ weights
    return found
