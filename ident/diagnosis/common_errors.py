"""Small errors that every craft has: the timing and mounting of its sensors, and the form of its hull.

A fix is 0.1 to 0.2 s old, shaft telemetry arrives late, a heading trails, an antenna is some centimetres away from its
given position, and no hull has exactly two drag terms for each axis. Each of these errors gains much likelihood, and
hardly changes the prediction. If the search added them one by one, they would take all its rounds, and until the last
of them is in the model they also distort the score tests of the effects that matter. So they are one group: the search
adds them together, as soon as they explain more than any single effect, and they do not count as effects found.

The members are selected by stepwise regression in the normal equations of the score tests, without a refit. The priors
of the catalogue are part of these equations, so that members of no use stay near zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seatrial.ident.diagnosis.findings import Refit
from seatrial.ident.diagnosis.score_test import ScoreEquations
from seatrial.ident.effects import catalogue
from seatrial.ident.model import Effect, Model
from seatrial.ident.models import TELEMETRY_AGE, telemetry_age
from seatrial.ident.numerics import Array

SENSOR_ERRORS = (
    TELEMETRY_AGE, "gnss-latency", "gnss-latency-command", "gnss-latency-force", "heading-lag", "compass", "gyro-scale",
    "lever-arm",
)  # fmt: skip
HULL_FORM = ("cross-flow", "lift", "sway-yaw")
COMMON_ERRORS = (*SENSOR_ERRORS, *HULL_FORM)


@dataclass(frozen=True)
class CommonErrorScore:
    """Joint score of the selected common errors.

    Attributes
    ----------
    names
        Selected members, in the order of their selection.
    criterion
        Expected gain of all of them in 2 ln L with priors, less the penalty ``df ln n`` of their parameters.
    step
        One-step estimate of each parameter by name.
    """

    names: tuple[str, ...]
    criterion: float
    step: Mapping[str, float]


def common_errors_for(model: Model, candidates: Mapping[str, Effect]) -> dict[str, Effect]:
    """Return the common errors that a model can have and does not have yet, by name.

    Parameters
    ----------
    model
        The model.
    candidates
        Candidates of a diagnosis. If a member of the catalogue is not among them, it is not a member here either. The
        age of the telemetry is no candidate, and is a member of each model with measured shaft speeds.
    """
    present = {e.name for e in model.effects}
    found = {n: candidates[n] for n in COMMON_ERRORS if n in candidates and candidates[n] is catalogue().get(n)}
    age = telemetry_age()
    if found and TELEMETRY_AGE not in present and model.accepts(age):
        found[TELEMETRY_AGE] = replace(age, parameters=tuple(p.at(0.0) for p in age.parameters))
    return found


def score_common_errors(equations: ScoreEquations, common: Mapping[str, Effect], n: int) -> CommonErrorScore:
    """Select common errors by stepwise regression on the residuals of a fitted model.

    The member with the largest criterion is selected first; the others follow as long as they increase the criterion
    of all selected members together. A member whose first parameter would get a value that it cannot have is left out.

    Parameters
    ----------
    equations
        Score equations of the fitted model, with the columns of all members.
    common
        Members by name.
    n
        Number of rows of the estimation data.

    Returns
    -------
    CommonErrorScore
        No names and a criterion of zero if no member increases the criterion.
    """
    information, score = equations.projected
    columns = {c.columns.name: np.asarray(c.at) for c in equations.indices if c.columns.name in common}
    names = {c.columns.name: c.names for c in equations.indices if c.columns.name in common}
    weight = {
        k: w
        for name in columns
        for k, w in zip(columns[name], _prior_information(common[name], names[name]), strict=True)
    }
    selected: list[str] = []
    best, step = 0.0, dict[str, float]()
    while True:
        trials = []
        for name in columns.keys() - set(selected):
            at = np.concatenate([columns[m] for m in (*selected, name)])
            values = _solution(information, score, at, np.array([weight[k] for k in at]))
            criterion = float(score[at] @ values) - at.size * float(np.log(n))
            estimates = dict(zip([p for m in (*selected, name) for p in names[m]], values.tolist(), strict=True))
            if all(_possible(common[m], estimates) for m in (*selected, name)):
                trials.append((criterion, name, estimates))
        if not trials or (top := max(trials, key=lambda t: t[0]))[0] <= best:
            return CommonErrorScore(tuple(selected), best, step)
        best, step = top[0], top[2]
        selected.append(top[1])


def with_common_errors(model: Model, common: Sequence[Effect], step: Mapping[str, float], share: float) -> Model:
    """Return a model with common errors at a ``share`` of their one-step estimates, limited by priors and bounds."""
    for effect in common:
        values = []
        for p in effect.parameters:
            sd = p.prior[1] if p.prior else np.inf
            value = p.value + share * float(np.clip(step.get(p.name, 0.0), -sd, sd))
            values.append(p.at(min(max(value, p.bounds[0]), p.bounds[1])))
        model = model + replace(effect, parameters=tuple(values))
    return model


def common_error_names(refit: Refit | None) -> frozenset[str]:
    """Return the names of the effects in the refit of the group, empty for None."""
    return frozenset() if refit is None else frozenset(e.name for e in refit.fitted.model.effects)


def _prior_information(effect: Effect, names: Sequence[str]) -> list[float]:
    """Return the information of the prior of each named parameter of an effect [1/unit²], 0 without a prior."""
    priors = {p.name: p.prior for p in effect.parameters}
    return [0.0 if (prior := priors[name]) is None else 1.0 / prior[1] ** 2 for name in names]


def _solution(information: Array, score: Array, at: Array, weight: Array) -> Array:
    """Return the one-step estimate of the columns ``at`` (n,), with the information ``weight`` (n,) of their priors."""
    own = information[np.ix_(at, at)] + np.diag(weight)
    size = np.sqrt(np.maximum(np.diag(own), 1e-300))
    solved: Array = np.linalg.lstsq(own / np.outer(size, size), score[at] / size, rcond=1e-10)[0] / size
    return solved


def _possible(effect: Effect, estimates: Mapping[str, float]) -> bool:
    """Return whether the estimate of a one-sided effect is positive; True for effects without a sign."""
    return not effect.one_sided or estimates.get(effect.parameters[0].name, 0.0) > 0.0
