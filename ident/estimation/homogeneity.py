"""Heterogeneity of parameters between logs: tests, effects that describe it, and shifts in a validation run.

The homogeneity test is the likelihood ratio of one value for all logs to one for each, with the scatter between them.

With values ``m`` (k,) fitted one a log and their covariance V, the logs' own scatter tau is that of

    m ~ N(mu 1, V + tau^2 I)

by restricted maximum likelihood (DerSimonian and Laird 1986 is its moment form; Viechtbauer 2005). Where the logs
disagree, the standard error of a common fit is too small, and mu with its own error is the calibrated answer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize, stats

from seatrial.daq.errors import SeatrialError
from seatrial.ident.data import Record
from seatrial.ident.estimation.fitted_model import FIT_ERRORS
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import ROUGH, Fit, SearchSettings, fit
from seatrial.ident.estimation.standard_errors import AT_BOUND, VAGUE
from seatrial.ident.model import PARAMETERS, Effect, EffectKind, Model, Parameter, Signals, segment_name
from seatrial.ident.numerics import Array

LEVEL = 0.01
BETWEEN, PAYLOAD, THRUST = "between-runs:", "payload", "thrust"
SPREAD = 0.3  # relative, that a parameter may plausibly differ between runs: one standard deviation of the prior
LEAST, MOST = -0.9, 9.0  # relative differences that are tried
PAYLOAD_SHARE = 0.2  # of the surge mass, one standard deviation of the prior of a payload
TOLD = 0.95  # of the prior's width: an error above it is the prior's own, and the record says nothing
MIN_SHIFT = 5.0  # standard errors of both runs together, from which a parameter is said to be another


@dataclass(frozen=True)
class HomogeneityTest:
    """value, error, robust_error: of the fit with one value; values, errors (n_records,): of the fit with one a
    record; left_out: records that do not inform the parameter, which ``df`` does not count; lr with df degrees of
    freedom; scatter: between the records, beyond their errors; mean, mean_error and interval (95 %, Student's t by the
    records with an error) with that scatter."""

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
    left_out: tuple[str, ...] = ()

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
    shared = one.model.parameter(name)
    model = _with_one_each(one.model, shared, len(records))
    each = _again(one, model, records, range(len(records)))
    values, errors = np.array([each.estimate(name, i) for i in range(len(records))]).T
    at = [each.names.index(segment_name(name, i)) for i in range(len(records))]
    # at a bound it has no error, but the record has pushed it there
    stuck = {n for n, what in each.flags if what == AT_BOUND}
    prior = model.parameter(name).free_prior()
    widest = np.array([np.inf if prior is None else TOLD * prior[1] * shared.slope(value) for value in values])
    known = errors < widest
    informs = [i for i, k in enumerate(at) if known[i] or each.names[k] in stuck]
    lr, df = 2.0 * (each.log_posterior - one.log_posterior), len(informs) - 1
    if 0 < df < len(records) - 1:  # what the others say of noise, with a value of their own, is not of the parameter
        of_each = _again(one, _with_one_each(one.model, shared, len(informs)), records, informs)
        lr = 2.0 * (of_each.log_posterior - _again(one, one.model, records, informs).log_posterior)
    lr, df = max(lr, 0.0), max(df, 0)
    told = [k for k, is_known in zip(at, known, strict=True) if is_known]
    scatter, mean, mean_error = between_log_variance(values[known], each.covariance[np.ix_(told, told)])
    half = float(stats.t.ppf(0.975, max(int(known.sum()) - 1, 1))) * mean_error
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
        float(stats.chi2.sf(lr, df)) if df else 1.0,
        scatter,
        mean,
        mean_error,
        (mean - half, mean + half),
        tuple(r.name for i, r in enumerate(records) if i not in informs),
    )


def _with_one_each(model: Model, shared: Parameter, n: int) -> Model:
    """With a value for each of n records. What was known of the one value is known once, not once for each record:
    equal values then have the same posterior."""
    prior = None if shared.prior is None else (shared.prior[0], shared.prior[1] * np.sqrt(n))
    return model.replace_parameters(replace(shared, per_record=True, prior=prior))


def _again(one: Fit, model: Model, records: Sequence[Record], which: Sequence[int]) -> Fit:
    """Another model fitted to some of the records as ``one`` was, for only then their likelihoods compare: its model
    has the outliers and the free starts of output error already, and each record begins where it ended."""
    begin = {
        segment_name(p.name, k): float(v)
        for k, i in enumerate(which)
        for p, v in zip(one.parameters, one.values, strict=True)
        if p.segment == i
    }
    return fit(
        model,
        [records[i] for i in which],
        replace(one.options, outlier_model=False),
        SearchSettings(initial_state="given"),
        start=begin,
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


def between_runs(fitted: Fit) -> dict[str, Effect]:
    """Candidates for what differs between the records of a fit: a payload, the thrust, or one parameter alone; none
    for a single record."""
    if len(fitted.records) < 2:
        return {}
    model, stuck = fitted.model, {n for n, what in fitted.flags if what in (AT_BOUND, VAGUE)}
    names = [PAYLOAD] if {"m_u", "m_v"} <= set(model.values) else []
    names += [THRUST] if "c1" in model.values else []
    found = {p.name for p in fitted.parameters if p.segment is None} - model.noise_parameters - stuck
    of_effects = {p.name for e in model.effects for p in e.parameters}
    names += [n for n in model.values if n in found - of_effects and model.values[n] > 0]
    return {BETWEEN + n: between_runs_effect(model, n) for n in names}


def between_runs_effect(model: Model, what: str) -> Effect:
    """A payload [kg] on the masses of surge and sway, a factor on the thrust, or on one parameter, in each record its
    own."""
    if what == PAYLOAD:

        def load(s: Signals) -> None:
            s.p.m_u, s.p.m_v = s.p.m_u + s.p.m_payload, s.p.m_v + s.p.m_payload

        sd = PAYLOAD_SHARE * model.values["m_u"]
        carried = Parameter(
            "m_payload",
            0.0,
            "kg",
            "mass more than on average over the runs",
            prior=(0.0, sd),
            per_record=True,
            step=0.05 * sd,
        )
        return _between(PAYLOAD, "a payload that differs between runs", load, carried, "m_u + m, m_v + m in each run")
    names = ("c1", "c2") if what == THRUST else (what,)
    meaning = "the thrust" if what == THRUST else f"{what} ({model.parameter(what).meaning})"

    def change(s: Signals) -> None:
        factor = 1.0 + getattr(s.p, f"k_{what}")
        for name in names:
            if hasattr(s.p, name):
                setattr(s.p, name, getattr(s.p, name) * factor)

    factor = Parameter(
        f"k_{what}",
        0.0,
        "",
        f"relative difference of {meaning} from its mean over the runs",
        prior=(0.0, SPREAD),
        bounds=(LEAST, MOST),
        per_record=True,
        step=0.01,
    )
    formula = f"{', '.join(names)} (1 + k) in each run"
    return _between(what, f"a difference of {meaning} between runs", change, factor, formula)


def _between(what: str, title: str, change: Callable[[Signals], None], own: Parameter, formula: str) -> Effect:
    return Effect(
        BETWEEN + what,
        title,
        {PARAMETERS: change},
        (own,),
        place="hull",
        formula=formula,
        source="DerSimonian and Laird 1986; Viechtbauer 2005",
        experiment="the same mission with the same load, battery and trim in all runs",
        kind=EffectKind.BETWEEN_RUNS,
    )


@dataclass(frozen=True)
class RunDifference:
    """How much a record's own parameter is more than in the first record, with the standard error of that."""

    record: str
    value: float
    error: float


def run_differences(fitted: Fit, name: str) -> tuple[RunDifference, ...]:
    """Differences of a parameter that each record has for itself, from its value in the first record."""
    at = [fitted.names.index(segment_name(name, i)) for i in range(len(fitted.records))]
    found = []
    for record, k in zip(fitted.records[1:], at[1:], strict=True):
        (a, b), (_, d) = fitted.covariance[np.ix_([at[0], k], [at[0], k])]
        variance = a - 2 * b + d
        error = float(np.sqrt(variance)) if variance > 0 else float("nan")
        found.append(RunDifference(record, float(fitted.values[k] - fitted.values[at[0]]), error))
    return tuple(found)


@dataclass(frozen=True)
class ParameterShift:
    """A parameter, or a payload, that explains best how a run differs from those of a fit: fitted and error of the fit,
    value and value_error of that run alone, all other parameters kept; gain: d ln L in that run."""

    name: str
    unit: str
    fitted: float
    error: float
    value: float
    value_error: float
    gain: float


def parameter_shift(fitted: Fit, record: Record, values: Array) -> ParameterShift | None:
    """What explains best how a run differs from those of a fit, if anything does by ``MIN_SHIFT`` standard errors.

    values (n_parameters,): as the fit has them for this record.
    """
    model = fitted.model.with_values(dict(zip(fitted.model.values, values.tolist(), strict=True)))
    own = [p.name for p in model.parameters if p.free and p.per_record]
    shared = {p.name for p in fitted.parameters if p.segment is None} - model.noise_parameters
    tried = [(n, model.replace_parameters(replace(model.parameter(n), prior=None))) for n in shared]
    if {"m_u", "m_v"} <= set(model.values):
        tried.append(("m_payload", model + between_runs_effect(model, PAYLOAD)))
    found: list[ParameterShift] = []
    for name, larger in tried:
        try:
            alone = fit(larger.with_free({name, *own}), [record.for_model(larger)], settings=ROUGH)
        except FIT_ERRORS:
            continue
        unit, (value, value_error) = larger.parameter(name).unit, alone.estimate(name)
        was, error = fitted.estimate(name) if name in model.values else (0.0, 0.0)
        if abs(value - was) > MIN_SHIFT * float(np.hypot(error, value_error)):  # not where an error is not known
            found.append(ParameterShift(name, unit, was, error, value, value_error, alone.log_likelihood))
    if not found:
        return None
    begun = float(Likelihood(model).value_by_row(record.for_model(model), values).sum())
    best = max(found, key=lambda s: s.gain)
    return replace(best, gain=best.gain - begun)
