"""Small errors that every craft has: the timing and mounting of its sensors, and the form of its hull.

A fix is 0.1 to 0.2 s old, shaft telemetry arrives late, a heading trails, an antenna is some centimetres away from its
given position, and no hull has exactly two drag terms for each axis. Each of these errors gains much likelihood, and
hardly changes the prediction. If the search added them one by one, they would take all its rounds, and until the last
of them is in the model they also distort the score tests of the effects that matter. So they are one group: the search
adds them together if several are needed and no effect of the boat (parametric, waves left out) that passes its score
test explains more. They do not count as effects found.

The members are selected by stepwise regression in the normal equations of the score tests, without a refit. The forms
of hull and thrust are then added in any case. The priors of the catalogue are part of these equations, so that members
of no use stay near zero.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from seatrial.daq.errors import counted
from seatrial.ident.data import Record
from seatrial.ident.diagnosis.acceptance import Comparison
from seatrial.ident.diagnosis.findings import CommonErrorsFit, CommonErrorsGain, RejectedCommonErrors
from seatrial.ident.diagnosis.policy import DEFAULT_POLICY, SearchPolicy
from seatrial.ident.diagnosis.score_test import ColumnIndex, ScoreEquations
from seatrial.ident.effects import catalogue
from seatrial.ident.estimation import FIT_ERRORS, FittedModel, SearchSettings, ValidationData, fit_and_evaluate
from seatrial.ident.model import Effect, Model
from seatrial.ident.models import TELEMETRY_AGE, telemetry_age

SENSOR_ERRORS = (
    TELEMETRY_AGE, "gnss-latency", "gnss-latency-command", "gnss-latency-force", "heading-lag", "filter-lag",
    "velocity-lag", "compass", "compass-filtered", "gyro-scale", "lever-arm",
)  # fmt: skip
HULL_FORM = ("cross-flow", "lift", "sway-yaw")
THRUST_FORM = ("advance-ratio",)  # every propeller loses thrust with its inflow
# A propeller that brakes loses another thrust with its inflow. Only score tests add it: few missions show it
COMMON_ERRORS = (*SENSOR_ERRORS, *HULL_FORM, *THRUST_FORM, "reverse-advance")
# For the fits with the common errors: fifteen more parameters, of which some are nearly zero, need no exact maximum
COMMON_SEARCH = SearchSettings(tolerance=0.05)
ROUGH_COMMON_SEARCH = SearchSettings(tolerance=0.2, max_iterations=15, robust_errors=False, refine=False)


@dataclass(frozen=True)
class CommonErrorScore:
    """Result of the selection of common errors by the score tests: the selected errors and their joint score.

    Common errors are the small errors that every craft has: timing and mounting of its sensors, and form of its hull.

    Attributes
    ----------
    names
        Names of the selected errors, in the order of their selection.
    criterion
        Expected gain of all of them in 2 ln L with priors, less the penalty ``df ln n`` of their parameters. Scanned
        parameters count.
    step
        One-step estimate of each parameter by name, in the unit of the parameter.
    scan
        Values of the scanned parameters of the selected errors by name.
    """

    names: tuple[str, ...]
    criterion: float
    step: Mapping[str, float]
    scan: Mapping[str, float] = field(default_factory=dict)


def common_errors_for(model: Model, candidates: Mapping[str, Effect]) -> dict[str, Effect]:
    """Return the common errors (timing, mounting, hull form) that can be added to a model, by name.

    Parameters
    ----------
    model
        The model. Errors that it has already are left out.
    candidates
        Candidates of the diagnosis, which the model accepts. A common error of the catalogue that is not among them is
        left out. A user-defined effect with the name of a common error is left out too. The age of the telemetry is not
        in the catalogue. It is added, with an initial value of zero, if the model has measured shaft speeds and at
        least one other common error was found.
    """
    present = {e.name for e in model.effects}
    found = {n: candidates[n] for n in COMMON_ERRORS if n in candidates and candidates[n] is catalogue().get(n)}
    age = telemetry_age()
    if found and TELEMETRY_AGE not in present and model.accepts(age):
        found[TELEMETRY_AGE] = replace(age, parameters=tuple(p.at(0.0) for p in age.parameters))
    return found


def given_common_errors(model: Model, policy: SearchPolicy = DEFAULT_POLICY) -> tuple[Effect, ...]:
    """Return the common errors (timing, mounting, hull form) that a model has already, in the order of its effects.

    Return () if the model has fewer than ``policy.min_common_errors`` of them.
    """
    given = tuple(e for e in model.effects if e.name in COMMON_ERRORS)
    return given if len(given) >= policy.min_common_errors else ()


def score_common_errors(equations: ScoreEquations, common: Mapping[str, Effect], n: int) -> CommonErrorScore:
    """Select common errors by stepwise regression on the residuals of a fitted model, without a refit.

    The error with the largest criterion is selected first; the others follow as long as they increase the criterion of
    all selected errors together. Selections in which a one-sided error would get an estimate that is not positive are
    left out.

    Parameters
    ----------
    equations
        Score equations of the fitted model, with the columns of all common errors.
    common
        Common errors by name.
    n
        Number of rows of the estimation data.

    Returns
    -------
    CommonErrorScore
        No names and a criterion of zero if no error increases the criterion.
    """
    score = equations.projected[1]
    placed = best_columns(equations, common)
    columns = {name: np.asarray(c.at) for name, c in placed.items()}
    names = {name: c.names for name, c in placed.items()}
    weight = {
        k: w
        for name in columns
        for k, w in zip(columns[name], prior_information(common[name], names[name]), strict=True)
    }
    selected: list[str] = []
    best, step = 0.0, dict[str, float]()
    while True:
        trials = []
        for name in columns.keys() - set(selected) - nested_in(common, [common[m] for m in selected]):
            at = np.concatenate([columns[m] for m in (*selected, name)])
            values = equations.one_step(at, np.array([weight[k] for k in at]))
            df = at.size + sum(len(placed[m].columns.scan) for m in (*selected, name))
            criterion = float(score[at] @ values) - df * float(np.log(n))
            estimates = dict(zip([p for m in (*selected, name) for p in names[m]], values.tolist(), strict=True))
            if all(_has_possible_sign(common[m], estimates) for m in (*selected, name)):
                trials.append((criterion, name, estimates))
        if not trials or (top := max(trials, key=lambda t: t[0]))[0] <= best:
            scan = {p: value for m in selected for p, value in placed[m].columns.scan.items()}
            return CommonErrorScore(tuple(selected), best, step, scan)
        best, step = top[0], top[2]
        selected.append(top[1])


def with_forms(selected: CommonErrorScore, equations: ScoreEquations, common: Mapping[str, Effect]) -> CommonErrorScore:
    """Add the forms of hull and thrust to selected common errors, and return all of them with their joint estimates.

    No hull has exactly two drag terms for each axis, and every propeller loses thrust with its inflow. Their priors
    shrink what the data do not show. Without them a large missing effect would be distorted, and a form would be
    called an effect as soon as that effect is in the model. A one-sided form whose estimate is not positive is left
    out, and so is one that is nested in a selected error or contains it.

    Parameters
    ----------
    selected
        Result of `score_common_errors`. Its criterion is kept.
    equations, common
        Score equations and common errors by name, as for that function.
    """
    placed = best_columns(equations, common)
    for name in (*HULL_FORM, *THRUST_FORM):
        if name not in placed or name in {*selected.names, *nested_in(common, [common[m] for m in selected.names])}:
            continue
        names = (*selected.names, name)
        at = np.concatenate([np.asarray(placed[m].at) for m in names])
        weight = [w for m in names for w in prior_information(common[m], placed[m].names)]
        parameters = [p for m in names for p in placed[m].names]
        step = dict(zip(parameters, equations.one_step(at, np.array(weight)).tolist(), strict=True))
        if all(_has_possible_sign(common[m], step) for m in names):
            selected = replace(selected, names=names, step=step)
    return selected


def best_columns(equations: ScoreEquations, effects: Mapping[str, Effect]) -> dict[str, ColumnIndex]:
    """Return the columns of each of the effects by name; of an effect with scanned parameters those of the best scan.

    The best scan explains most: its one-step estimates have the largest gain in likelihood. Effects without columns are
    left out.
    """
    found: dict[str, tuple[float, ColumnIndex]] = {}
    for placed in equations.indices:
        name = placed.columns.name
        if name not in effects:
            continue
        gain = _gain_of(equations, placed, effects[name])
        if name not in found or gain > found[name][0]:
            found[name] = gain, placed
    return {name: placed for name, (_, placed) in found.items()}


def _gain_of(equations: ScoreEquations, placed: ColumnIndex, effect: Effect) -> float:
    """Return the expected gain in 2 ln L of an effect alone, with its priors."""
    at, weight = np.asarray(placed.at), np.array(prior_information(effect, placed.names))
    return float(equations.projected[1][at] @ equations.one_step(at, weight))


def nested_in(candidates: Mapping[str, Effect], chosen: Iterable[Effect]) -> set[str]:
    """Return the names of the candidates that a chosen effect contains as a special case, or that contain one.

    A chosen effect need not be among the candidates.
    """
    chosen = [*chosen]
    names, inner = {e.name for e in chosen}, {m for e in chosen for m in e.nests}
    return {n for n, e in candidates.items() if n in inner or names & set(e.nests)}


def is_error_of_motion_sensor(effect: Effect) -> bool:
    """Return whether an effect is an error of a sensor that measures the motion, so that it does not change the motion.

    An error of the measured shaft speeds, such as ``shaft-clip``, is none: the thrust follows from these speeds.
    """
    return effect.place == "sensor" and "thrust_loss" not in effect.hooks


def with_common_errors(
    model: Model,
    common: Sequence[Effect],
    step: Mapping[str, float],
    share: float,
    scan: Mapping[str, float] | None = None,
) -> Model:
    """Return a model with common errors added, at initial values from the score tests.

    Parameters
    ----------
    model
        Model without them.
    common
        Common errors to add.
    step
        One-step estimate of each parameter by name, 0 for missing ones. Each estimate is limited to one standard
        deviation of the prior, before ``share`` is applied.
    share
        Factor of these estimates, 0 to 1. An initial value is the parameter's own value plus this share of the
        estimate, limited to the bounds.
    scan
        Values of scanned parameters by name, which are their initial values.
    """
    for effect in common:
        values = []
        for p in effect.parameters:
            if scan and p.name in scan:
                values.append(p.at(scan[p.name]))
                continue
            sd = p.prior[1] if p.prior else np.inf
            value = p.value + share * float(np.clip(step.get(p.name, 0.0), -sd, sd))
            values.append(p.at(min(max(value, p.bounds[0]), p.bounds[1])))
        model = model + replace(effect, parameters=tuple(values))
    return model


def fit_common_errors(
    current: FittedModel,
    records: Sequence[Record],
    validation_data: ValidationData,
    members: CommonErrorScore,
    common: Mapping[str, Effect],
    *,
    found: Sequence[str] = (),
    policy: SearchPolicy = DEFAULT_POLICY,
    detail: Callable[[str], None] | None = None,
) -> CommonErrorsFit | RejectedCommonErrors:
    """Fit a model together with the selected common errors, and accept the fit if the data support it.

    The fit starts at the one-step estimates, then at 30 % of them, then at zero, until it succeeds. A fit has failed,
    too, if the likelihood of the validation data is not finite with it. ``current`` is not changed.

    Common errors hardly change the prediction. A significantly larger prediction error rejects them only if it is
    larger by a factor above ``policy.min_error_ratio_beside``, below which a change does not matter beside them, or if
    their gain on the validation data is not significant. The prediction of an unstable boat over 10 s depends on
    chance, and few blocks of it say less than the likelihood of all samples.

    Parameters
    ----------
    current
        Fitted model without the common errors.
    records, validation_data
        Estimation data, and validation data.
    members
        Selected common errors with their one-step estimates, a result of `score_common_errors`.
    common
        Common errors by name.
    found
        Names of the effects that ``current`` has already.
    policy
        Thresholds of the comparison.
    detail
        Called with a text in each iteration of the fits.

    Returns
    -------
    CommonErrorsFit or RejectedCommonErrors
        The reason of a rejection: no fit succeeds, the criterion of the estimation data or the gain on the validation
        data is not positive, or the prediction is worse as described.
    """
    effects, problem = tuple(common[name] for name in members.names), ""
    for share in (1.0, 0.3, 0.0):
        try:
            model = with_common_errors(current.fit.model, effects, members.step, share, members.scan)
            fitted = fit_and_evaluate(model, records, validation_data, settings=COMMON_SEARCH, detail=detail)
            compared = Comparison(current, fitted, policy)
            validated, t = compared.gain
            break
        except FIT_ERRORS as error:
            problem = str(error)
    else:
        return RejectedCommonErrors(effects, f"no fit with them succeeds: {problem}")
    gain = 2 * (fitted.fit.log_posterior - current.fit.log_posterior)
    df = sum(p.free for e in effects for p in e.parameters)
    criterion = gain - df * float(np.log(sum(r.n_rows for r in records)))
    prediction = compared.prediction
    worse = prediction.verdict == "rose" and (prediction.ratio > policy.min_error_ratio_beside or t <= policy.min_t)
    if criterion <= 0:
        reason = f"the fit gains too little by them for {counted(df, 'parameter')} (2 Δ ln L = {gain:.3g})"
    elif validated <= 0:
        reason = f"the log-likelihood of the validation data falls by {-validated:.2g} with them"
    elif worse:
        reason = (
            f"the prediction error {prediction.horizon:g} s ahead is significantly larger with them on the validation "
            f"data, by {100 * (prediction.ratio - 1):.2g} %"
        )
    else:
        reason = ""
    if reason:
        return RejectedCommonErrors(effects, reason)
    gains = CommonErrorsGain(gain, df, criterion, validated, t, compared.prediction)
    return CommonErrorsFit(effects, fitted, tuple(found), gains)


def prior_information(effect: Effect, names: Sequence[str]) -> list[float]:
    """Return the information of the prior of each named parameter of an effect: 1 / variance, or 0 without a prior.

    The result has the order of ``names``, in 1 / squared unit of the parameter. A name may end in the index of a record
    (``NAME@i``), which is ignored. A name that is no parameter of the effect raises KeyError.
    """
    priors = {p.name: p.prior for p in effect.parameters}
    found = [priors[name.partition("@")[0]] for name in names]
    return [0.0 if prior is None else 1.0 / prior[1] ** 2 for prior in found]


def _has_possible_sign(effect: Effect, estimates: Mapping[str, float]) -> bool:
    """Return whether an effect has a possible sign: True if it is not one-sided or its first estimate is positive.

    ``estimates`` are by parameter name. A missing estimate of the first parameter counts as zero, which is not
    possible.
    """
    return not effect.one_sided or estimates.get(effect.parameters[0].name, 0.0) > 0.0
