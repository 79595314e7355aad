"""Heterogeneity of parameters between logs: homogeneity test, between-run effects, and shifts in a validation run.

The homogeneity test is the likelihood ratio of a model with one value of a parameter for each log to the model with one
value for all logs. It also estimates the standard deviation between the logs (the scatter).

The scatter is that of the meta-analysis (`meta_analysis`) of the values fitted one for each log. If the logs disagree,
the standard error of a common fit is too small; the mean of the meta-analysis and its standard error are then
calibrated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.ident.data import Record
from seatrial.ident.estimation.fitted_model import FIT_ERRORS
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import ROUGH_SEARCH, Fit, SearchSettings, fit
from seatrial.ident.estimation.meta_analysis import between_log_variance
from seatrial.ident.estimation.standard_errors import AT_BOUND, VAGUE
from seatrial.ident.model import (
    PARAMETERS,
    Effect,
    EffectKind,
    Model,
    Parameter,
    ParameterOrigin,
    Signals,
    segment_name,
)
from seatrial.ident.numerics import Array, chi2_sf, student_ppf

LEVEL = 0.01  # significance level of the homogeneity test
BETWEEN, PAYLOAD, THRUST = "between-runs:", "payload", "thrust"  # name of an effect: BETWEEN + target
CAUSES = {  # what to look for on the boat if a quantity differs between runs
    PAYLOAD: "another load, water in the hull, a swapped battery",
    THRUST: "the load of the boat (a heavier one resembles less thrust), the battery voltage, a fouled propeller",
    "c1": "the load of the boat (a heavier one resembles less thrust), the battery voltage, a fouled propeller",
}
RELATIVE_SD = 0.3  # prior standard deviation of a parameter's relative difference between runs
MIN_DIFFERENCE, MAX_DIFFERENCE = -0.9, 9.0  # bounds of that relative difference
PAYLOAD_SHARE = 0.2  # prior standard deviation of a payload, as a share of the surge mass
# Mean and standard deviation of the relative increase of drag and yaw inertia per relative increase of the mass. A hull
# with vertical sides sinks in proportion to its load: its wetted surface grows by half to all of this share. A load
# amidships does not change the yaw inertia, and a load at bow and stern changes it by more than its share.
DRAG_BY_LOAD, INERTIA_BY_LOAD = (0.7, 0.4), (0.5, 0.5)
DRAGS = ("d_u", "d_v", "d_r", "d_uu", "d_vv", "d_rr")
# A record informs a parameter if its standard error is below this share of the prior's standard deviation.
INFORMED_SHARE = 0.95
MIN_SHIFT = 5.0  # a parameter has shifted if it differs by this many standard errors of both runs together


@dataclass(frozen=True)
class HomogeneityTest:
    """Result of the test whether one parameter has the same value in several logs. Values are in the parameter's unit.

    Attributes
    ----------
    name, unit
        Name and unit of the parameter.
    records
        Names of the records, one for each log.
    value, error, robust_error
        Estimate, standard error and robust standard error of the fit with one value for all records.
    values, errors : Array (n_records,)
        Estimates and standard errors of the fit with one value for each record; NaN errors for records whose value is
        at its bound or not identified.
    lr, df, p
        Likelihood ratio statistic (twice the gain in log-posterior, at least 0), its degrees of freedom and its p value
        by chi-squared; p is 1 if df is 0.
    scatter
        Standard deviation between the records, beyond their standard errors. Only records whose standard error shows
        information from the data count (`homogeneity_test`), so that a record whose value is at its bound does not
        count. NaN with fewer than two such records.
    mean, mean_error, interval
        Mean of the values of these records with that scatter, its standard error, and its 95 % interval. The interval
        uses Student's t, with the number of these records minus one.
    left_out
        Names of the records without enough information about the parameter. A record whose value is at its bound is
        informative and not left out. ``df`` is the number of the other records minus one, at least 0.
    """

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
        """Whether the test does not reject one common value for all records: p is above 0.01."""
        return self.p > LEVEL


def homogeneity_test(common: Fit, records: Sequence[Record], name: str) -> HomogeneityTest:
    """Test whether one value of a parameter holds for all records, by a fit with one value for each record.

    In that fit the prior of each value is ``sqrt(n_records)`` times as wide. A record is informative about the
    parameter if its standard error is below 0.95 of the standard deviation of this prior (without a prior: if there is
    a standard error), or if its value is at a bound. If some records are not, and at least two are, both models are
    fitted again to the informative ones for the likelihood ratio.

    Parameters
    ----------
    common
        Fit of the same records with one value for all of them.
    records
        Records of ``common``, in the same order.
    name
        Name of a free parameter that the records share.

    Returns
    -------
    HomogeneityTest
        Likelihood ratio test, values of the single records, and the standard deviation between them.

    Raises
    ------
    SeatrialError
        If ``name`` is not such a parameter, or if there are fewer than two records.
    ValueError
        If a model cannot be fitted.
    """
    if name not in common.names:
        free = ", ".join(p.name for p in common.parameters if p.segment is None)
        raise SeatrialError(
            f"--test-homogeneity {name}: not a free parameter that all logs share; choose one of {free}"
        )
    if len(records) < 2:
        raise SeatrialError(
            f"--test-homogeneity {name}: the test compares logs, and there is only one; give two logs or more"
        )
    shared = common.model.parameter(name)
    model = _with_value_per_record(common.model, shared, len(records))
    each = _refit_subset(common, model, records, range(len(records)))
    values, errors = np.array([each.estimate(name, i) for i in range(len(records))]).T
    at = [each.names.index(segment_name(name, i)) for i in range(len(records))]
    # a value at a bound has no standard error, but the record does inform it: its data pushed the value there
    stuck = {n for n, flag in each.flags if flag == AT_BOUND}
    prior = model.parameter(name).free_prior()
    widest = np.array(
        [np.inf if prior is None else INFORMED_SHARE * prior[1] * shared.slope(value) for value in values]
    )
    known = errors < widest
    informs = [i for i, k in enumerate(at) if known[i] or each.names[k] in stuck]
    lr, df = 2.0 * (each.log_posterior - common.log_posterior), len(informs) - 1
    if 0 < df < len(records) - 1:
        # Fit both models again to the informing records alone: otherwise the likelihood ratio would include the
        # information of the other records about the noise.
        of_each = _refit_subset(common, _with_value_per_record(common.model, shared, len(informs)), records, informs)
        lr = 2.0 * (of_each.log_posterior - _refit_subset(common, common.model, records, informs).log_posterior)
    lr, df = max(lr, 0.0), max(df, 0)
    informed_at = [k for k, is_known in zip(at, known, strict=True) if is_known]
    scatter, mean, mean_error = between_log_variance(values[known], each.covariance[np.ix_(informed_at, informed_at)])
    half = float(student_ppf(0.975, max(int(known.sum()) - 1, 1))) * mean_error
    value, error = common.estimate(name)
    return HomogeneityTest(
        name,
        model.parameter(name).unit,
        tuple(r.name for r in records),
        value,
        error,
        float(common.robust_errors[common.names.index(name)]),
        values,
        errors,
        lr,
        df,
        float(chi2_sf(lr, df)) if df else 1.0,
        scatter,
        mean,
        mean_error,
        (mean - half, mean + half),
        tuple(r.name for i, r in enumerate(records) if i not in informs),
    )


def _with_value_per_record(model: Model, parameter: Parameter, n: int) -> Model:
    """Return a copy of the model in which a shared parameter has a separate value in each of n records.

    The standard deviation of its prior becomes ``sqrt(n)`` times as large: n equal values then have the same posterior
    as the one common value.
    """
    prior = None if parameter.prior is None else (parameter.prior[0], parameter.prior[1] * np.sqrt(n))
    return model.replace_parameters(replace(parameter, per_record=True, prior=prior))


def _refit_subset(previous: Fit, model: Model, records: Sequence[Record], which: Sequence[int]) -> Fit:
    """Fit another model to some of the records with the options of a previous fit, so that their likelihoods compare.

    The previous model already has the outlier model and the free initial states of output error, so that neither is
    added again. The per-record parameters start from their previous values.

    Parameters
    ----------
    previous
        Fit to all records.
    model
        Model to be fitted. Its shared parameters start at its values.
    records
        All records of the previous fit.
    which
        Indices of the records to which the model is fitted.
    """
    begin = {
        segment_name(p.name, k): float(v)
        for k, i in enumerate(which)
        for p, v in zip(previous.parameters, previous.values, strict=True)
        if p.segment == i
    }
    return fit(
        model,
        [records[i] for i in which],
        replace(previous.options, outlier_model=False),
        SearchSettings(initial_state="given"),
        start=begin,
    )


def between_runs(fitted: Fit) -> dict[str, Effect]:
    """Return candidate effects by name, each of which lets one quantity differ between the records of a fit.

    A diagnosis tests them, to find whether the boat changed between runs. The quantities are a payload (if the model
    has the masses m_u and m_v), the thrust (if it has the thrust coefficient c1), and each estimated parameter that is
    positive and shared by the records. Parameters of noise and of effects are left out, and so are parameters at a
    bound or of unknown order of magnitude. Each name starts with ``between-runs:``. The result is empty for a single
    record.
    """
    if len(fitted.records) < 2:
        return {}
    model, stuck = fitted.model, {n for n, flag in fitted.flags if flag in (AT_BOUND, VAGUE)}
    names = [PAYLOAD] if {"m_u", "m_v"} <= set(model.values) else []
    names += [THRUST] if "c1" in model.values else []
    found = {p.name for p in fitted.parameters if p.segment is None} - model.noise_parameters - stuck
    of_effects = {p.name for e in model.effects for p in e.parameters}
    names += [n for n in model.values if n in found - of_effects and model.values[n] > 0]
    return {BETWEEN + n: between_runs_effect(model, n) for n in names}


def between_runs_effect(model: Model, target: str) -> Effect:
    """Return the effect by which one quantity differs between records: each record has its own added mass or factor.

    Parameters
    ----------
    model
        Model to which the effect is added.
    target
        ``payload``: a mass [kg] added to the masses in surge and sway, with a prior of 0 +- 20 % of the surge mass;
        drag and yaw inertia grow with it, since the boat lies deeper.
        ``thrust``: a factor 1 + k on the thrust coefficients c1 and c2. Otherwise the name of a parameter that gets
        this factor; KeyError is raised if the model lacks it. The prior of k is 0 +- 0.3.
    """
    if target == PAYLOAD:

        def load(s: Signals) -> None:
            """Add the payload of the record to the masses in surge and sway, and change drag and inertia, in place."""
            p = s.p
            share = p.m_payload / p.m_u
            for names, factor in ((DRAGS, 1.0 + p.k_draught * share), (("m_r",), 1.0 + p.k_inertia * share)):
                for name in names:
                    if hasattr(p, name):
                        setattr(p, name, getattr(p, name) * factor)
            p.m_u, p.m_v = p.m_u + p.m_payload, p.m_v + p.m_payload

        sd = PAYLOAD_SHARE * model.values["m_u"]
        carried = Parameter(
            "m_payload",
            0.0,
            "kg",
            "mass above the average over the runs",
            prior=(0.0, sd),
            per_record=True,
            step=0.05 * sd,
            origin=ParameterOrigin.BUILT_IN,
        )
        deeper = Parameter(
            "k_draught",
            DRAG_BY_LOAD[0],
            "",
            "relative increase of the drag per relative increase of the mass",
            prior=DRAG_BY_LOAD,
            step=0.05,
            origin=ParameterOrigin.BUILT_IN,
        )
        wider = Parameter(
            "k_inertia",
            INERTIA_BY_LOAD[0],
            "",
            "relative increase of the yaw inertia per relative increase of the mass",
            prior=INERTIA_BY_LOAD,
            step=0.05,
            origin=ParameterOrigin.BUILT_IN,
        )
        return _build_between_runs_effect(
            PAYLOAD,
            "a payload that differs between runs",
            load,
            (carried, deeper, wider),
            "m_u + m, m_v + m; drag (1 + k_draught m / m_u), m_r (1 + k_inertia m / m_u) in each run",
        )
    names = ("c1", "c2") if target == THRUST else (target,)
    meaning = "the thrust" if target == THRUST else f"{target} ({model.parameter(target).meaning})"

    def change(s: Signals) -> None:
        """Multiply the parameters by the factor 1 + k of the record, in place; skip those that the model lacks."""
        factor = 1.0 + getattr(s.p, f"k_{target}")
        for name in names:
            if hasattr(s.p, name):
                setattr(s.p, name, getattr(s.p, name) * factor)

    factor = Parameter(
        f"k_{target}",
        0.0,
        "",
        f"relative difference of {meaning} from its mean over the runs",
        prior=(0.0, RELATIVE_SD),
        bounds=(MIN_DIFFERENCE, MAX_DIFFERENCE),
        per_record=True,
        step=0.01,
        origin=ParameterOrigin.BUILT_IN,
    )
    formula = f"{', '.join(names)} (1 + k) in each run"
    return _build_between_runs_effect(target, f"a difference of {meaning} between runs", change, (factor,), formula)


def between_runs_title(name: str) -> str:
    """Return the title of a candidate for readers: ``between-runs:m_v`` becomes ``m_v differs between the runs``.

    The name of any other candidate is returned unchanged.
    """
    return f"{name.removeprefix(BETWEEN)} differs between the runs" if name.startswith(BETWEEN) else name


def _build_between_runs_effect(
    target: str, title: str, change: Callable[[Signals], None], own: tuple[Parameter, ...], formula: str
) -> Effect:
    """Return an effect by which one quantity differs between the runs (heterogeneity), from its parts.

    Parameters
    ----------
    target
        Name of the quantity that differs between the runs. The name of the effect is ``between-runs:`` and this name.
    title
        Title of the effect in reports.
    change
        Function that changes the model's parameters in place, for the record that is evaluated.
    own
        Parameters of the effect: first the per-record one, which is the additional mass or the relative difference.
    formula
        Formula of the effect for reports.
    """
    return Effect(
        BETWEEN + target,
        title,
        {PARAMETERS: change},
        own,
        place="hull",
        formula=formula,
        causes=CAUSES.get(target, "another load, trim, battery, propeller or weather"),
        source="DerSimonian and Laird 1986; Viechtbauer 2005",
        experiment="the same mission with the same load, battery and trim in all runs",
        kind=EffectKind.BETWEEN_RUNS,
    )


@dataclass(frozen=True)
class RunDifference:
    """Difference of a per-record parameter from its value in the first record.

    Attributes
    ----------
    record
        Name of the record.
    value, error
        Value in this record minus that in the first record, and the standard error of the difference, in the
        parameter's unit. The error is NaN if it is unknown.
    """

    record: str
    value: float
    error: float


def run_differences(fitted: Fit, name: str) -> tuple[RunDifference, ...]:
    """Return the differences of a per-record parameter from its value in the first record, one for each other record.

    ``name`` is the name of an estimated per-record parameter, without the index of the record. The standard errors take
    account of the covariance of the two values. An error is NaN if the variance of the difference is not positive or
    unknown.
    """
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
    """Parameter, or payload, whose change explains best how one run differs from the runs of a fit.

    Attributes
    ----------
    name, unit
        Name (``m_payload`` for a payload) and unit of the parameter.
    fitted, error
        Estimate of the fit and its standard error; zero for a payload.
    value, value_error
        Estimate from that run alone with all other shared parameters kept, and its standard error.
    gain
        Increase of the log-likelihood of that run by the change.
    """

    name: str
    unit: str
    fitted: float
    error: float
    value: float
    value_error: float
    gain: float


def parameter_shift(fitted: Fit, record: Record, values: Array) -> ParameterShift | None:
    """Return the parameter whose change explains best how a run, for example a validation run, differs from a fit.

    Each estimated shared parameter except noise is fitted in turn to the run alone, together with the run's per-record
    parameters; and so is a payload, with its shares of drag and yaw inertia, if the model has ``m_u`` and ``m_v``. The
    shared parameter has no prior; those of the payload keep their priors. A candidate that cannot be fitted, or of
    which either fit has no standard error, is skipped. Of the parameters that differ by more than 5 standard errors,
    the one with the largest log-likelihood is returned.

    Parameters
    ----------
    fitted
        Fit to other runs.
    record
        Run that differs.
    values : Array (n_parameters,)
        Values of the fit for this run, in the order of ``model.parameters``.

    Returns
    -------
    ParameterShift or None
        None if no parameter differs by more than 5 standard errors of both runs together.
    """
    model = fitted.model.with_values(dict(zip(fitted.model.values, values.tolist(), strict=True)))
    own = [p.name for p in model.parameters if p.free and p.per_record]
    shared = {p.name for p in fitted.parameters if p.segment is None} - model.noise_parameters
    tried = [(n, [n], model.replace_parameters(replace(model.parameter(n), prior=None))) for n in shared]
    if {"m_u", "m_v"} <= set(model.values):
        load = between_runs_effect(model, PAYLOAD)
        tried.append(("m_payload", [p.name for p in load.parameters], model + load))
    found: list[ParameterShift] = []
    for name, free, larger in tried:
        try:
            alone = fit(larger.with_free({*free, *own}), [record.for_model(larger)], settings=ROUGH_SEARCH)
        except FIT_ERRORS:
            continue
        unit, (value, value_error) = larger.parameter(name).unit, alone.estimate(name)
        before, error = fitted.estimate(name) if name in model.values else (0.0, 0.0)
        if abs(value - before) > MIN_SHIFT * float(np.hypot(error, value_error)):  # false if an error is NaN
            found.append(ParameterShift(name, unit, before, error, value, value_error, alone.log_likelihood))
    if not found:
        return None
    initial = float(Likelihood(model).value_by_row(record.for_model(model), values).sum())
    best = max(found, key=lambda s: s.gain)
    return replace(best, gain=best.gain - initial)
