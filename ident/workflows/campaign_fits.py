"""Fits of two campaigns of logs, and the differences of their parameters and effects."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np

from seatrial.daq.errors import counted
from seatrial.ident.effects import catalogue, values_without
from seatrial.ident.estimation import (
    AT_BOUND,
    VAGUE,
    CampaignDifference,
    Contrast,
    campaign_difference,
    joint_difference,
    mean_of_logs,
)
from seatrial.ident.models import force_power
from seatrial.ident.numerics import Array, chi2_sf, student_ppf
from seatrial.ident.results import (
    CampaignMean,
    CombinationDifference,
    CommonFactor,
    Difference,
    EffectDifference,
    Evidence,
    Family,
    JointTest,
    LogEstimate,
    NotCompared,
    NotComparedCode,
    ParameterDifference,
    finite,
)
from seatrial.ident.workflows.campaign_combinations import Combination, combinations_of
from seatrial.ident.workflows.campaign_logs import MOST_PRIOR, FittedLogs, Row, campaign_of
from seatrial.ident.workflows.fleet import SIDES, common_errors, own_variances

FALSE_DISCOVERY_RATE = 0.05
FAR_FROM_ZERO = 3.0  # standard errors: relative changes and factors need a mean that is farther from zero
LEVEL = 0.05  # of the presence of an effect, and of the test of a common factor
NOT_SIGNIFICANT = 2.0  # standard errors: an estimate of a log that is as close to zero shows no effect
LEAST_FACTOR = 3  # parameters that a common factor needs
FEW_LOGS = 6  # with up to so many logs of both campaigns, intervals by Student's t are at least 1.4 times as wide
MOST_NAMED = 4  # parameters that the note on few logs names
NOMINAL = ("c1", "c2", "k_thrust", "c1/T", "c2/T")  # the thrust itself, to which the other parameters are proportional
# Parameters whose change is a change of the boat as it is: masses, inertia and thrust
MAIN = ("m_u", "m_v", "m_r", "c1", "c2")
Values = dict[str, float]


@dataclass(frozen=True)
class Comparison:
    """Differences between the parameters of two campaigns, as the tables of the result.

    Attributes
    ----------
    parameters, combinations, not_compared, effects, joint, common_factor
        As in `CampaignsResult`.
    scatter
        Scatter between the logs by parameter, in its unit; 0 if it is unknown.
    notes
        Remarks for the reader.
    """

    parameters: tuple[ParameterDifference, ...]
    combinations: tuple[CombinationDifference, ...]
    not_compared: tuple[NotCompared, ...]
    effects: tuple[EffectDifference, ...]
    joint: JointTest | None
    common_factor: CommonFactor | None
    scatter: Values
    notes: tuple[str, ...]


def compare_fits(fitted: FittedLogs, false_discovery_rate: float = FALSE_DISCOVERY_RATE) -> Comparison:
    """Compare the parameters of two campaigns, and combinations of them, by the estimates of their logs.

    Parameters
    ----------
    fitted : FittedLogs
        Estimates of one log or more of each campaign.
    false_discovery_rate : float
        Largest expected share of false ones among the changed parameters and combinations.
    """
    reasons = {name: _why_not_compared(fitted, name) for name in fitted.names}
    names = [name for name, reason in reasons.items() if reason is None]
    found, without = combinations_of(fitted, reasons)
    every = _with_combinations(fitted, found)
    differences = {name: _difference(every, name) for name in (*names, *(c.name for c in found))}
    tests = _tests(differences, {n: _family(n, fitted.rows[0][n]) for n in names}, false_discovery_rate)
    parameters = tuple(_parameter(fitted, n, differences[n], tests[n]) for n in names)
    effects = _effects(fitted, parameters, differences)
    combinations = tuple(
        CombinationDifference(parameters=c.parameters, **_compared(every, c.name, differences[c.name], tests[c.name]))
        for c in found
    )
    dynamic = [p.name for p in parameters if not p.nuisance and fitted.known(p.name).all()]
    scatter = {n: float(np.nan_to_num(d.scatter)) for n, d in differences.items()}
    joint = None
    if dynamic and len(fitted.logs) > 2:
        p, directions = joint_difference(
            fitted.values(dynamic), fitted.own_covariances(dynamic), fitted.common(dynamic), fitted.after
        )
        joint = JointTest(p=finite(p), directions=directions, parameters=tuple(dynamic))
    not_compared = tuple(
        NotCompared(name=n, meaning=next(r[n]["meaning"] for r in fitted.rows if n in r), code=why[0], reason=why[1])
        for n, why in reasons.items()
        if why is not None
    )
    return Comparison(
        parameters, combinations, (*not_compared, *without), effects, joint,
        _common_factor(fitted, parameters, scatter), scatter, _notes(fitted, parameters, combinations, effects),
    )  # fmt: skip


def _why_not_compared(fitted: FittedLogs, name: str) -> tuple[NotComparedCode, str] | None:
    """Return the reason why a parameter cannot be compared between the campaigns, as code and words; None if it can."""
    found, n = [r[name] for r in fitted.rows if name in r], len(fitted.rows)
    if any(r["per_log"] for r in found):
        return "per-log", "has its own value in each log"
    if not any(r["free"] for r in found):
        return "fixed", f"held at its {found[0]['origin']} value"
    if len(found) < n:
        return "in-some-models", f"is in the model of {len(found)} of {n} logs"
    effect = catalogue().get(found[0]["effect"] or "")
    if effect is not None and effect.fixed_point:
        return "position", "a position, whose origin differs from log to log"
    flags: tuple[tuple[NotComparedCode, str], ...] = (("at-bound", AT_BOUND), ("vague", VAGUE))
    for code, flag in flags:
        # A value at a bound has no error. The mean of the other logs would be too far from the bound.
        flagged = np.array([(r[name]["flag"] or "").startswith(flag) for r in fitted.rows])
        if flagged.any():
            parts = (("before", ~fitted.after), ("after", fitted.after))
            where = [
                f"{int(flagged[part].sum())} of {int(part.sum())} logs {when}"
                for when, part in parts
                if flagged[part].any()
            ]
            return code, f"{flag} in {' and '.join(where)}"
    known = fitted.known(name)
    for after in (False, True):
        if not known[fitted.after == after].any():
            return "undetermined", f"no log {campaign_of(after)} determines it"
    shares = [(json.loads(r["prior_parts"]).get(name, 0.0) / r["se"]) ** 2 for r in found if r["se"]]
    if shares and np.mean(shares) > MOST_PRIOR:
        return "mainly-prior", f"known mainly from its prior ({100 * np.mean(shares):.0f} % of the information)"
    return None


def _difference(fitted: FittedLogs, name: str) -> CampaignDifference:
    """Return the difference of one parameter, from the logs that have a standard error of it."""
    part = fitted.part(fitted.known(name))
    rows = [r[name] for r in part.rows]
    values, common = np.array([r["value"] for r in rows], dtype=float), common_errors(rows)
    return campaign_difference(values, own_variances(rows, common), common, part.after)


@dataclass(frozen=True)
class _Test:
    """Test of the difference of one parameter, adjusted for the number of parameters.

    Attributes
    ----------
    q
        Smallest false discovery rate at which the parameter has changed; NaN if there is no p value.
    changed
        Whether q is at most the false discovery rate.
    detectable
        Size of the difference from which on it would have changed, with the p values of the other parameters; NaN as q.
    """

    q: float = float("nan")
    changed: bool = False
    detectable: float = float("nan")


def _with_combinations(fitted: FittedLogs, combinations: Sequence[Combination]) -> FittedLogs:
    """Return the logs with a row for each combination, as if it were a parameter."""
    rows = [
        {**own, **{c.name: row for c in combinations if (row := c.rows[k]) is not None}}
        for k, own in enumerate(fitted.rows)
    ]
    return FittedLogs(fitted.logs, fitted.after, tuple(rows))


def _family(name: str, row: Row) -> Family:
    """Return the family of a parameter, from its name and its row of one log."""
    effect = catalogue().get(row["effect"] or "")
    if row["nuisance"]:
        return "noise"
    if effect is not None and effect.place in ("sensor", "environment"):
        return "surroundings"
    if effect is not None and effect.thrust_difference == name:
        return "boat"
    is_main = row["effect"] is None and name.partition("/")[0] in MAIN
    return "boat" if is_main else "coefficients"


def _tests(
    differences: Mapping[str, CampaignDifference], families: Mapping[str, Family], false_discovery_rate: float
) -> dict[str, _Test]:
    """Return the test of each parameter and combination (Benjamini and Hochberg 1995).

    ``families`` has the family of each parameter; combinations are of the boat. The parameters of a family are adjusted
    among themselves, so that a boat with many sensors shows a change as well as one with few.
    """
    found = dict.fromkeys(differences, _Test())
    for kind in get_args(Family):
        family = {
            n: d.difference.p
            for n, d in differences.items()
            if families.get(n, "boat") == kind and np.isfinite(d.difference.p)
        }
        if not family:
            continue
        p = np.array(list(family.values()))
        for k, (name, q) in enumerate(zip(family, _q_values(p).tolist(), strict=True)):
            level, contrast = _level(np.delete(p, k), false_discovery_rate), differences[name].difference
            detectable = contrast.error * float(student_ppf(1.0 - level / 2.0, contrast.df))
            found[name] = _Test(q, q <= false_discovery_rate, detectable)
    return found


def _level(rest: Array, false_discovery_rate: float) -> float:
    """Return the largest p value with which a parameter has changed, from the p values of the others, ``rest`` (n,).

    It is k / (n + 1) of the false discovery rate, with the largest k for which k - 1 of the others are as small.
    """
    levels = false_discovery_rate * np.arange(1, rest.size + 2) / (rest.size + 1)
    enough = (rest[:, None] <= levels).sum(axis=0) >= np.arange(rest.size + 1)
    return float(levels[np.flatnonzero(enough)[-1]])


def _q_values(p: Array) -> Array:
    """Return the q values (n,) of the p values (n,) of independent tests: the smallest false discovery rate of each.

    `scipy.stats.false_discovery_control` gives the same numbers, but its import takes a second of processor time.
    """
    order, n = np.argsort(p), p.size
    scaled = p[order] * (n / np.arange(1, n + 1))
    q = np.empty(n)
    q[order] = np.minimum.accumulate(scaled[::-1])[::-1]
    return np.clip(q, 0.0, 1.0)


def _parameter(fitted: FittedLogs, name: str, found: CampaignDifference, test: _Test) -> ParameterDifference:
    """Return the entry of the result for one compared parameter."""
    row = next(r[name] for r in fitted.part(fitted.known(name)).rows)
    return ParameterDifference(
        effect=row["effect"], nuisance=row["nuisance"], family=_family(name, row),
        **_compared(fitted, name, found, test),
    )  # fmt: skip


def _compared(fitted: FittedLogs, name: str, found: CampaignDifference, test: _Test) -> dict[str, Any]:
    """Return what the entries of the result for a parameter and for a combination have in common, by field."""
    part = fitted.part(fitted.known(name))
    rows = [r[name] for r in part.rows]
    own = own_variances(rows, common_errors(rows))
    estimates = zip(part.logs, part.after.tolist(), rows, np.sqrt(own).tolist(), strict=True)
    difference, mean = found.difference, found.before
    # Per cent of a negative value would have the wrong sign, or hide that its size falls.
    far = mean.value > FAR_FROM_ZERO * mean.error
    return {
        "name": name,
        "meaning": rows[0]["meaning"],
        "unit": rows[0]["unit"],
        "before": CampaignMean(n=int((~part.after).sum()), mean=mean.value, se=mean.error),
        "after": CampaignMean(n=int(part.after.sum()), mean=found.after.value, se=found.after.error),
        "difference": difference.value,
        "se": difference.error,
        "low": finite(difference.low),
        "high": finite(difference.high),
        "relative": difference.value / mean.value if far else None,
        "scatter": finite(found.scatter),
        "p": finite(difference.p),
        "q": finite(test.q),
        "changed": test.changed,
        "detectable": finite(test.detectable),
        "logs": tuple(
            LogEstimate(log=log, campaign=campaign_of(after), value=r["value"], se=se)
            for log, after, r, se in estimates
        ),
    }


def _effects(
    fitted: FittedLogs, parameters: Sequence[ParameterDifference], differences: Mapping[str, CampaignDifference]
) -> tuple[EffectDifference, ...]:
    """Return for each effect of the model whether it is present in each campaign, and whether it has changed.

    Effects without a fitted parameter, such as an antenna at its given position, are left out.
    """
    names = dict.fromkeys(r["effect"] for rows in fitted.rows for r in rows.values() if r["effect"] and r["free"])
    found = []
    for effect in names:
        own = [p for p in parameters if p.effect == effect]
        of_own = [differences[p.name] for p in own]
        before, after = (_evidence(effect, of_own, own, x) for x in (False, True))
        found.append(
            EffectDifference(
                name=effect,
                before=_is_present(fitted, effect, before, False),
                after=_is_present(fitted, effect, after, True),
                changed=any(p.changed for p in own),
                evidence_before=before,
                evidence_after=after,
            )
        )
    return tuple(found)


def _evidence(
    effect: str,
    differences: Sequence[CampaignDifference],
    parameters: Sequence[ParameterDifference],
    after: bool,
) -> Evidence | None:
    """Return the parameter of an effect that is farthest from its value without the effect, in one campaign.

    The distance counts in multiples of that at which it is significant. None if no parameter can be tested.

    ``differences`` and ``parameters`` are those of the compared parameters of the effect.
    """
    defaults = values_without(effect)
    found = []
    for parameter, difference in zip(parameters, differences, strict=True):
        mean: Contrast = difference.after if after else difference.before
        if difference.df > 0 and mean.error > 0.0:
            distance = abs(mean.value - defaults.get(parameter.name, 0.0)) / mean.error
            needed = float(student_ppf(1 - LEVEL / 2 / len(parameters), mean.df))
            found.append(Evidence(name=parameter.name, distance=float(distance), needed=needed))
    return max(found, key=lambda e: e.distance / e.needed, default=None)


def _is_present(fitted: FittedLogs, effect: str, evidence: Evidence | None, after: bool) -> bool | None:
    """Return whether an effect is present in one campaign; None if no parameter of it can tell.

    If no parameter could be tested, because each is at its bound in a log of either campaign, the effect is absent if
    all its parameters have the values without the effect in all logs of the campaign: at the bound, or within two
    standard errors.
    """
    if evidence is not None:
        return evidence.distance > evidence.needed
    defaults = values_without(effect)
    own, of_campaign = (
        [r for rows in part.rows for r in rows.values() if r["effect"] == effect and r["free"]]
        for part in (fitted, fitted.part(fitted.after == after))
    )
    bounded = {r["parameter"] for r in own if (r["flag"] or "").startswith(AT_BOUND)}
    if of_campaign and all(
        r["parameter"] in bounded and _is_without_effect(r, defaults.get(r["parameter"], 0.0)) for r in of_campaign
    ):
        return False
    return None


def _is_without_effect(row: Row, null: float) -> bool:
    """Return whether an estimate of a log does not differ from the value without the effect (``null``)."""
    flag = row["flag"] or ""
    if flag.startswith(AT_BOUND):
        return bool(row["value"] == null)
    return not flag.startswith(VAGUE) and bool(row["se"]) and abs(row["value"] - null) <= NOT_SIGNIFICANT * row["se"]


def _common_factor(
    fitted: FittedLogs, parameters: Sequence[ParameterDifference], scatter: Mapping[str, float]
) -> CommonFactor | None:
    """Return the common factor of the parameters that are proportional to the thrust; None with fewer than three.

    Only parameters that each log determines, and whose means are farther than three standard errors from zero, with the
    same sign in both campaigns, are used. The factor is the weighted mean of the logarithms of their ratios.
    """
    names = [
        p.name
        for p in parameters
        if not p.nuisance
        and p.name not in NOMINAL
        and (force_power(p.unit) == 1 or "/T" in p.name or "/(T" in p.name)
        and fitted.known(p.name).all()
        and all(abs(m.mean) > FAR_FROM_ZERO * m.se for m in (p.before, p.after))
        and p.before.mean * p.after.mean > 0.0
    ]
    df = len(fitted.logs) - 2
    if len(names) < LEAST_FACTOR or df < 1:
        return None
    tau = np.array([scatter[n] for n in names])
    means, covariances = [], []
    for part in (fitted.part(~fitted.after), fitted.part(fitted.after)):
        mean, covariance = mean_of_logs(part.values(names), part.own_covariances(names), tau)
        means.append(mean)
        covariances.append(covariance / np.outer(mean, mean))
    if (means[1] / means[0] <= 0.0).any():
        return None
    ratios, weights = np.log(means[1] / means[0]), np.linalg.inv(covariances[0] + covariances[1])
    information = float(weights.sum())
    log_factor = float(weights.sum(axis=0) @ ratios) / information
    left = ratios - log_factor
    rest = float(left @ weights @ left)
    p = float(chi2_sf(rest, len(names) - 1))
    reach = float(student_ppf(0.975, df) * np.sqrt(max(1.0, rest / (len(names) - 1)) / information))
    low, high = np.exp([log_factor - reach, log_factor + reach]).tolist()
    return CommonFactor(
        factor=float(np.exp(log_factor)), low=low, high=high, p=p, parameters=tuple(names),
        explains=p > LEVEL and not low <= 1.0 <= high,
    )  # fmt: skip


def _notes(
    fitted: FittedLogs,
    parameters: Sequence[ParameterDifference],
    combinations: Sequence[CombinationDifference],
    effects: Sequence[EffectDifference],
) -> tuple[str, ...]:
    """Return remarks on what the comparison assumes, and on logs that were left out of single parameters.

    A difference of the thrusts of both sides in some logs is left out if an effect for it is in neither campaign.
    """
    priors = {p for rows in fitted.rows for r in rows.values() for p in json.loads(r["prior_parts"] or "{}")}
    held = sorted(priors - {p.name for p in parameters} - {SIDES})
    notes = []
    known = catalogue()
    of_sides = [e for e in effects if e.name in known and known[e.name].thrust_difference]
    if SIDES in priors and (not of_sides or any(e.before or e.after for e in of_sides)):
        notes.append(
            "The thrusts of both sides differ in some logs. The standard errors of masses, damping and forces include "
            "that the motion does not show which side deviates from the given thrust. `seatrial ident vehicle` on the "
            "logs after compares the mass in surge with the weighed mass for either side; a measurement of the thrust "
            "of both sides as they are now (seatrial bench) decides."
        )
    if held:
        notes.append(
            f"The priors of {', '.join(held)} are the same for both campaigns. If one of these has changed, the change "
            "appears in other parameters."
        )
    weather = {e for p in parameters if (e := p.effect or "") in known and known[e].place == "environment"}
    if weather:
        notes.append(
            f"Effects of the surroundings, with values of their own in each log: {', '.join(sorted(weather))}. A "
            "difference between the campaigns is one of the weather or the place, not of the boat. The logs after are "
            "predicted with the means of the logs before, so that the error with the values before contains it too."
        )
    for after in (False, True):
        if int((fitted.after == after).sum()) == 1:
            notes.append(
                f"There is only one log {campaign_of(after)}: its scatter is taken from the logs of the other campaign."
                if len(fitted.logs) > 2
                else f"There is only one log {campaign_of(after)}."
            )
    notes += [
        f"{p.name} is determined by {p.before.n} of {int((~fitted.after).sum())} logs before and {p.after.n} of "
        f"{int(fitted.after.sum())} after."
        for p in parameters
        if p.before.n + p.after.n < len(fitted.logs)
    ]
    return (*notes, *_few_logs_notes(fitted, [*combinations, *(p for p in parameters if not p.nuisance)]))


def _few_logs_notes(fitted: FittedLogs, compared: Sequence[Difference]) -> list[str]:
    """Return the note on differences that are no changes only because few logs make the intervals wide.

    They are larger than their standard error. The note says from which size on they would be changes, and how far more
    logs narrow the intervals. It is left out with more than `FEW_LOGS` logs. ``compared`` has the parameters of the
    boat, its surroundings and the combinations.
    """
    n, n_after = len(fitted.logs), int(fitted.after.sum())
    missed = [p for p in compared if not p.changed and p.detectable and abs(p.difference) > p.se]
    if n > FEW_LOGS or n < 3 or not missed:
        return []
    missed.sort(key=lambda p: -abs(p.difference) / p.se)
    more = f", and {len(missed) - MOST_NAMED} more" if len(missed) > MOST_NAMED else ""
    quantile, normal, twice = (float(student_ppf(0.975, df)) for df in (n - 2, 1e9, 2 * n - 2))
    return [
        f"Few logs make the intervals wide: with {n - n_after} before and {n_after} after, Student's t has "
        f"{counted(n - 2, 'degree')} of freedom, and the 95 % intervals are {quantile / normal:.1f} times as wide as "
        f"with many logs. Twice as many logs would make them about {twice / quantile / 2.0**0.5:.1f} times as wide as "
        "now. Differences that are not significant, and the size from which on each would be: "
        f"{', '.join(map(_missed_text, missed[:MOST_NAMED]))}{more}."
    ]


def _missed_text(p: Difference) -> str:
    """Return a difference and the size from which on it would be a change: ``d_u +52 % (from 180 % on)``."""
    detectable = p.detectable or 0.0
    if p.relative is None:
        return f"{p.name} {p.difference:+.2g} (from {detectable:.2g} {p.unit}".rstrip() + " on)"
    return f"{p.name} {100.0 * p.relative:+.0f} % (from {100.0 * detectable / p.before.mean:.0f} % on)"
