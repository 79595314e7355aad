"""Homogeneity test of a parameter across logs: likelihood ratio of one value for all to one for each, and the scatter.

With values ``m`` (k,) fitted one a log and their covariance V, the logs' own scatter tau is that of

    m ~ N(mu 1, V + tau^2 I)

by restricted maximum likelihood (DerSimonian and Laird 1986 is its moment form; Viechtbauer 2005). Where the logs
disagree, the standard error of a common fit is too small, and mu with its own error is the calibrated answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize, stats

from daq.errors import SeatrialError
from ident.data import Record
from ident.estimation.maximum_likelihood import Fit, fit
from ident.estimation.options import EstimationOptions
from ident.model import segment_name
from ident.numerics import Array

LEVEL = 0.01


@dataclass(frozen=True)
class HomogeneityTest:
    """value, error, robust_error: of the fit with one value; values, errors (n_records,): of the fit with one a
    record; lr with df degrees of freedom; scatter: between the records, beyond their errors; mean, mean_error and
    interval (95 %, Student's t) with that scatter."""

    name: str
    unit: str
    records: tuple[str, ...]
    value: float
    error: float
    robust_error: float
    values: Array
    errors: Array
    lr: float
    df: int
    p: float
    scatter: float
    mean: float
    mean_error: float
    interval: tuple[float, float]

    @property
    def agree(self) -> bool:
        return self.p > LEVEL


def homogeneity_test(one: Fit, records: Sequence[Record], name: str) -> HomogeneityTest:
    """Fit again with a value of ``name`` for each record. ``one`` is the fit of the same records with one value."""
    if name not in one.names:
        free = ", ".join(p.name for p in one.parameters if p.segment is None)
        raise SeatrialError(f"--test-homogeneity {name}: no free parameter that the logs share; there are {free}")
    if len(records) < 2:
        raise SeatrialError(f"--test-homogeneity {name}: it takes two logs or more")
    model = one.model.replace_parameters(replace(one.model.parameter(name), per_record=True))
    each = fit(model, records, EstimationOptions(reml=one.options.reml))
    values, errors = np.array([each.estimate(name, i) for i in range(len(records))]).T
    lr, df = max(0.0, 2.0 * (each.log_posterior - one.log_posterior)), len(records) - 1
    at = [each.names.index(segment_name(name, i)) for i in range(len(records))]
    scatter, mean, mean_error = between_log_variance(values, each.covariance[np.ix_(at, at)])
    half = float(stats.t.ppf(0.975, df)) * mean_error
    value, error = one.estimate(name)
    return HomogeneityTest(
        name,
        model.parameter(name).unit,
        tuple(r.name for r in records),
        value,
        error,
        float(one.robust_errors[one.names.index(name)]),
        values,
        errors,
        lr,
        df,
        float(stats.chi2.sf(lr, df)),
        scatter,
        mean,
        mean_error,
        (mean - half, mean + half),
    )


def between_log_variance(values: Array, covariance: Array) -> tuple[float, float, float]:
    """Scatter between values (k,) beyond their covariance (k, k), their mean with it, and the mean's standard error.

    Values without an error are left out. Restricted maximum likelihood.
    """
    known = np.isfinite(np.diag(covariance))
    m, V = values[known], covariance[np.ix_(known, known)]
    if m.size < 2:
        return float("nan"), float("nan"), float("nan")

    def mean_of(tau: float) -> tuple[float, float, float]:
        W = np.linalg.inv(V + tau**2 * np.eye(m.size))
        information = float(W.sum())
        mean = float(W.sum(axis=0) @ m) / information
        e = m - mean
        return mean, information, float(np.linalg.slogdet(W)[1] - np.log(information) - e @ W @ e)

    top = 10.0 * float(m.std() + np.sqrt(np.diag(V)).max())
    grid = np.append(0.0, np.geomspace(1e-4 * top, top, 200))
    near = int(np.argmax([mean_of(float(tau))[2] for tau in grid]))
    low, high = grid[max(near - 1, 0)], grid[min(near + 1, grid.size - 1)]
    found = optimize.minimize_scalar(lambda tau: -mean_of(float(tau))[2], bounds=(low, high), method="bounded")
    tau = 0.0 if near == 0 else float(found.x)
    mean, information, _ = mean_of(tau)
    return tau, mean, information**-0.5
