"""Result of the comparison of two campaigns of logs: changes of parameters and effects, and prediction errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import geometric_mean, median
from typing import Annotated, Literal

from msgspec import Meta

from seatrial.daq.errors import counted, first_names
from seatrial.ident.effects import catalogue
from seatrial.ident.results.commands import SCORE_TESTED, FailedLog
from seatrial.ident.results.parts import Change, ErrorComparison, Part, Result
from seatrial.ident.results.tables import format_number, in_degrees

Campaign = Literal["before", "after"]
FEW_LOGS = 4  # with up to so many logs of both campaigns, intervals by Student's t are wide
MOST_NAMES = 4  # changed parameters that the answer has with their sizes
# Error of the logs after over that of those before, each with values of their own, from which an effect is missing
MUCH_WORSE = 1.5
# The same if the changed parameters do not help: their number then says little, as another cause has to be looked for
WORSE = 1.25
POSITIONS = ("x", "y")
NEAR = 0.2  # q value up to which an answer without a change begins with the difference that is nearest to one
SCATTERED = 2.0  # scatter between the logs of a campaign, in standard errors of a log, that the answer names
JOINT_LEVEL = 0.05  # significance level of the joint test
AGREE, DIFFER = 2.0, 3.0  # standard errors up to which two sizes agree, and from which they differ
# Parameters whose q values are adjusted together: masses, thrust and combinations; single coefficients of the hull;
# those of sensors, wind and other surroundings; those of noise and disturbances
Family = Literal["boat", "coefficients", "surroundings", "noise"]
NotComparedCode = Literal[
    "fixed", "per-log", "in-some-models", "position", "at-bound", "vague", "undetermined", "mainly-prior", "other"
]


class LogEstimate(Part, frozen=True, kw_only=True):
    """Estimate of one parameter from one log."""

    log: Annotated[str, Meta(description="path of the log")]
    campaign: Annotated[Campaign, Meta(description="`before` or `after`")]
    value: Annotated[float, Meta(description="estimate")]
    se: Annotated[float, Meta(description="standard error without the errors from priors, which all logs share")]


class CampaignMean(Part, frozen=True, kw_only=True):
    """Mean of one parameter over the logs of one campaign, weighted with the scatter and the standard errors."""

    n: Annotated[int, Meta(description="number of logs")]
    mean: Annotated[float, Meta(description="mean")]
    se: Annotated[float, Meta(description="standard error of the mean, with the errors from priors")]


class Difference(Part, frozen=True, kw_only=True):
    """Difference of one parameter, or of a combination of parameters, between two campaigns.

    The test and the interval are those of Student's t with the number of logs minus two degrees of freedom for the
    scatter; errors from priors add with their known size. If each campaign has a single log, the scatter between logs
    is unknown, and there is neither a test nor an interval.
    """

    name: Annotated[str, Meta(description="name of the parameter; a ratio to the thrust is `NAME/T`")]
    meaning: Annotated[str, Meta(description="meaning in words")]
    unit: Annotated[str, Meta(description="unit of the values, SI and radians; empty: none")]
    before: Annotated[CampaignMean, Meta(description="mean of the campaign before")]
    after: Annotated[CampaignMean, Meta(description="mean of the campaign after")]
    difference: Annotated[float, Meta(description="mean after minus mean before")]
    se: Annotated[float, Meta(description="standard error of the difference; errors from priors cancel in it")]
    low: Annotated[float | None, Meta(description="95 % interval of the difference; null: two logs only")]
    high: Annotated[float | None, Meta(description="upper end of the interval")]
    relative: Annotated[
        float | None,
        Meta(description="difference / mean before; null: that is negative, or within 3 standard errors of zero"),
    ]
    scatter: Annotated[
        float | None,
        Meta(description="standard deviation between the logs of a campaign beyond their standard errors"),
    ]
    p: Annotated[float | None, Meta(description="p value of no difference; null: two logs only")]
    q: Annotated[
        float | None,
        Meta(
            description="p value adjusted for the number of parameters and combinations of its family (Benjamini and "
            "Hochberg); null as `p`"
        ),
    ]
    changed: Annotated[bool, Meta(description="verdict: `q` is at most the false discovery rate")]
    detectable: Annotated[
        float | None,
        Meta(
            description="size of the difference from which on the verdict would be a change, with this standard error "
            "and the p values of the other parameters; null as `p`, and in a result of an earlier version"
        ),
    ] = None
    logs: Annotated[tuple[LogEstimate, ...], Meta(description="estimate from each log")]


class ParameterDifference(Difference, frozen=True, kw_only=True):
    """Difference of one parameter between two campaigns."""

    effect: Annotated[str | None, Meta(description="effect of the parameter; null: the model itself")]
    nuisance: Annotated[
        bool,
        Meta(description="parameter of noise, of a disturbance or of an offset of a sensor, not of the boat"),
    ]
    family: Annotated[
        Family,
        Meta(
            description="parameters with which the q value is adjusted: `boat` (masses, inertia, thrust and "
            "combinations), `coefficients` (single coefficients of the hull), `surroundings` (effects of sensors, wind "
            "and other surroundings), or `noise` (noise, disturbances and offsets of sensors); `boat` in a result of "
            "an earlier version"
        ),
    ] = "boat"


class CombinationDifference(Difference, frozen=True, kw_only=True):
    """Difference of a combination of parameters that belong together, such as the drag at a speed.

    The estimates of its parameters are correlated, so that it may be known much better than any of them.
    """

    parameters: Annotated[tuple[str, ...], Meta(description="estimated parameters that it consists of")]


class NotCompared(Part, frozen=True, kw_only=True):
    """Parameter of the model that cannot be compared between the campaigns."""

    name: Annotated[str, Meta(description="name of the parameter")]
    meaning: Annotated[str, Meta(description="meaning in words")]
    code: Annotated[
        NotComparedCode,
        Meta(
            description="kind of reason: `fixed`; `per-log`, its true value differs from log to log; `in-some-models`, "
            "not all logs have it; `position`, its origin differs; `at-bound` or `vague` in a log; `undetermined` by a "
            "campaign; `mainly-prior`, known from its prior; `other`: in a result of an earlier version"
        ),
    ] = "other"
    reason: Annotated[str, Meta(description="reason in words")]


class JointTest(Part, frozen=True, kw_only=True):
    """Test whether anything differs between the campaigns: all parameters together, with their correlations."""

    p: Annotated[float | None, Meta(description="p value of no difference in any parameter; null: two logs only")]
    directions: Annotated[int, Meta(description="number of independent directions that were tested")]
    parameters: Annotated[tuple[str, ...], Meta(description="tested parameters: those that each log determines")]


class CommonFactor(Part, frozen=True, kw_only=True):
    """Common factor of the parameters that are proportional to the thrust: masses, inertia and damping.

    The motion of a boat determines these parameters only as ratios to the thrust. If the thrust has become F times as
    large and the fits do not know it, all of them become 1 / F times as large.
    """

    factor: Annotated[float, Meta(description="common factor, after / before")]
    low: Annotated[float, Meta(description="95 % interval of the factor")]
    high: Annotated[float, Meta(description="upper end of the interval")]
    p: Annotated[float, Meta(description="p value of one factor for all these parameters")]
    parameters: Annotated[tuple[str, ...], Meta(description="the parameters")]
    explains: Annotated[
        bool, Meta(description="verdict: the factor differs from 1, and `p` does not reject that it is common")
    ]


class Evidence(Part, frozen=True, kw_only=True):
    """Parameter of an effect that differs most from its value without the effect, in the logs of one campaign."""

    name: Annotated[str, Meta(description="name of the parameter")]
    distance: Annotated[
        float, Meta(description="distance of its mean from the value without the effect, in standard errors")
    ]
    needed: Annotated[
        float,
        Meta(
            description="distance from which on the effect is present: Student's t at 5 %, adjusted for the number of "
            "parameters of the effect; it is large with few logs"
        ),
    ]


class EffectDifference(Part, frozen=True, kw_only=True):
    """Effect of the model in the two campaigns.

    An effect is present in a campaign if the mean of one of its parameters differs from that without the effect, at the
    level of 5 % for all its parameters together.
    """

    name: Annotated[str, Meta(description="name of the effect")]
    before: Annotated[bool | None, Meta(description="present in the campaign before; null: unknown")]
    after: Annotated[bool | None, Meta(description="present in the campaign after; null: unknown")]
    changed: Annotated[bool, Meta(description="a parameter of the effect has changed")]
    evidence_before: Annotated[
        Evidence | None, Meta(description="strongest parameter in the campaign before; null: none could be tested")
    ] = None
    evidence_after: Annotated[
        Evidence | None, Meta(description="strongest parameter in the campaign after; null: none could be tested")
    ] = None


class CampaignErrors(Part, frozen=True, kw_only=True):
    """RMS prediction errors over the horizon on the logs of one campaign, with the values of one model.

    The values of a campaign are means over its logs without the log that is predicted.
    """

    logs: Annotated[Campaign, Meta(description="campaign whose logs are predicted")]
    values: Annotated[
        Literal["before", "changed", "after"],
        Meta(
            description="values of the model: those before, those before with the changed parameters of after, or "
            "those after"
        ),
    ]
    channels: Annotated[
        dict[str, ErrorComparison],
        Meta(description="errors by channel; `before`: with the values before, on the same logs"),
    ]
    ratio: Annotated[
        float | None, Meta(description="error over all channels / error with the values before; null for these")
    ] = None
    low: Annotated[float | None, Meta(description="95 % interval of `ratio`; null: the data are too short")] = None
    high: Annotated[float | None, Meta(description="upper end of the interval")] = None
    verdict: Annotated[Change | None, Meta(description="verdict on the ratio, by the interval")] = None


class CampaignLog(Part, frozen=True, kw_only=True):
    """Log of a campaign that was fitted."""

    log: Annotated[str, Meta(description="path of the log")]
    sha256: Annotated[str, Meta(description="SHA-256 of the log")]
    campaign: Annotated[Campaign, Meta(description="`before` or `after`")]
    duration: Annotated[float, Meta(description="[s]")]


class CampaignsResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="campaigns"):
    """Result of `seatrial ident changes`: one model on two campaigns of logs, and what differs between them."""

    model: Annotated[str, Meta(description="name of the model as given; `auto`: chosen for each log")]
    table: Annotated[str, Meta(description="file of all estimates; empty: no file was written")]
    score_tests: Annotated[bool | None, Meta(description=SCORE_TESTED)] = None
    common_errors: Annotated[
        tuple[str, ...],
        Meta(description="effects of the model: common errors that a fit of the first logs before has added"),
    ] = ()
    horizon: Annotated[float, Meta(description="prediction horizon [s]")]
    false_discovery_rate: Annotated[
        float, Meta(description="largest expected share of false ones among the changed parameters")
    ]
    campaigns: Annotated[tuple[CampaignLog, ...], Meta(description="logs whose fit converged")]
    failed: Annotated[tuple[FailedLog, ...], Meta(description="logs without a fit, or whose fit did not converge")]
    parameters: Annotated[tuple[ParameterDifference, ...], Meta(description="compared parameters")]
    combinations: Annotated[
        tuple[CombinationDifference, ...],
        Meta(description="compared combinations of parameters; empty in a result of an earlier version"),
    ] = ()
    not_compared: Annotated[tuple[NotCompared, ...], Meta(description="other parameters, with the reason")]
    effects: Annotated[tuple[EffectDifference, ...], Meta(description="effects of the model")]
    joint: Annotated[JointTest | None, Meta(description="test of all parameters together; null: none was possible")]
    common_factor: Annotated[
        CommonFactor | None, Meta(description="null: fewer than three such parameters, or fewer than three logs")
    ]
    errors: Annotated[tuple[CampaignErrors, ...], Meta(description="prediction errors")]
    unpredicted: Annotated[
        tuple[FailedLog, ...],
        Meta(description="logs without a prediction, with the reasons; empty in a result of an earlier version"),
    ] = ()

    @property
    def expected_to_differ(self) -> tuple[NotCompared, ...]:
        """Parameters that cannot be compared by their nature: they are fixed, or they have a value for each log."""
        return tuple(p for p in self.not_compared if p.code in ("fixed", "per-log"))

    @property
    def changed(self) -> tuple[ParameterDifference, ...]:
        """Parameters that have changed, without those of noise, disturbances and sensors."""
        return tuple(p for p in self.parameters if p.changed and not p.nuisance)

    @property
    def changed_combinations(self) -> tuple[CombinationDifference, ...]:
        """Combinations of parameters that have changed, those with the smallest p value first."""
        return tuple(sorted((c for c in self.combinations if c.changed), key=lambda c: c.p or 0.0))

    @property
    def changed_first(self) -> tuple[ParameterDifference, ...]:
        """All compared parameters, those that have changed first; otherwise in the order of `parameters`."""
        return tuple(sorted(self.parameters, key=lambda p: not p.changed))


def campaigns_answer(result: CampaignsResult) -> str:
    """Return the answer of a comparison of campaigns: what has changed, common factor, and prediction errors."""
    tested = [p for p in result.parameters if not p.nuisance and p.q is not None]
    changed = [p for p in result.changed if p in tested]
    level = result.false_discovery_rate
    rate = f"at a false discovery rate of {100.0 * level:g} %"
    nearest = None  # the difference that is nearest to a change, if there is no change
    if not tested and result.parameters:
        sentences = [
            "The scatter between logs is unknown with one log before and one after, so no change can be claimed; give "
            "two or more logs of a campaign."
        ]
    elif not tested:
        sentences = ["No parameter could be compared."]
    elif changed or result.changed_combinations:
        found = [_combination_text(c) for c in result.changed_combinations]
        # The coefficient alone misleads if a log has put its part of the sum into the other one.
        split = _undetermined_splits(result, changed)
        found = [
            *(
                f"{_combination_text(c)}, which is not significant (q = {q_beside(c.q or 0.0, level)})"
                for c in split
                if not c.changed
            ),
            *found,
        ]
        found += [_change_text(p) for p in sorted(changed, key=lambda p: (not _is_of_sides(p), p.p or 0.0))]
        more = f" and {len(found) - MOST_NAMES} more" if len(found) > MOST_NAMES else ""
        words = "; ".join(found[:MOST_NAMES])
        words = f"T{words[1:]}" if words.startswith("the ") else words  # the name of a parameter keeps its letters
        sentences = [f"{words}{more}.", _counts_sentence(len(changed), len(tested), result, rate)]
        sentences += [_split_sentence(c, result, changed) for c in split]
    else:
        n = len(result.combinations)
        rest = f", nor has {'a combination' if n == 1 else f'any of {n} combinations'} of them" if n else ""
        sentences = [f"None of {counted(len(tested), 'parameter')} has changed {rate}{rest}."]
        nearest = _nearest(tested, result.combinations)
        if (nearest.q or 0.0) <= NEAR:
            sentences.insert(0, _nearest_text(nearest, result))
        if (n := len(result.campaigns)) <= FEW_LOGS:
            sentences.append(f"With {n} logs in all, only large changes are seen; take three or more of each campaign.")
        if result.joint is not None and result.joint.p is not None and result.joint.p < JOINT_LEVEL:
            sentences.append(
                f"All parameters together differ (p = {result.joint.p:.2g}), but the logs do not determine which."
            )
        sentences += filter(None, [_scatter_sentence(tested)])
    factor = result.common_factor
    if factor is not None and factor.explains and changed:
        sentences.append(_factor_sentence(factor, result.parameters, changed))
    sentences += filter(None, (_load_sentence(changed, tested), *(_sides_sentence(p, factor) for p in changed)))
    one = [e for e in result.effects if e.changed and {e.before, e.after} == {True, False}]
    only = [f"{e.name} (only {'after' if e.after else 'before'})" for e in one]
    if only:
        sentences.append(f"Effects of one campaign: {', '.join(only)}.")
    own = [e.verdict for e in result.errors if e.logs == "after" and e.values == "after"]
    sentences += filter(None, (_errors_sentence(result), _unexplained_sentence(result), _model_sentence(result)))
    sentences += filter(None, [_unpredicted_sentence(result)])
    if nearest is not None and "fell" in own:
        sentences.append("So something has changed that these logs do not assign to a parameter.")
        sentences += [] if (nearest.q or 0.0) <= NEAR else [_nearest_text(nearest, result)]
        sentences.append("Take more logs of each campaign.")
    # The changes of a model that lacks an effect may stand for this effect, so that this sentence comes first. It comes
    # last if the changes improve the prediction: they are then at least a part of the truth.
    worse = _worse_predicted_sentence(result)
    helps = any(e.values == "changed" and e.verdict == "fell" for e in result.errors)
    return " ".join(filter(None, (*sentences, worse) if helps else (worse, *sentences)))


def _unpredicted_sentence(result: CampaignsResult) -> str:
    """Return a sentence on the logs that could not be predicted, with the reason of the first; empty without one."""
    if not result.unpredicted:
        return ""
    first = result.unpredicted[0]
    return (
        f"{counted(len(result.unpredicted), 'log')} could not be predicted, so that the check of the changes by their "
        f"prediction is incomplete: {first_names([x.log for x in result.unpredicted])} ({first.reason})."
    )


def _counts_sentence(n_changed: int, n_tested: int, result: CampaignsResult, rate: str) -> str:
    """Return how many have changed: ``1 of 24 parameters and 1 of 3 combinations of them have changed at a ...``."""
    parts = [f"{n_changed} of {counted(n_tested, 'parameter')}"] if n_changed else []
    n = len(result.changed_combinations)
    if n:
        parts.append(f"{n} of {counted(len(result.combinations), 'combination')} of parameters")
    return f"{' and '.join(parts)} {'has' if n_changed + n == 1 else 'have'} changed {rate}."


def _undetermined_splits(
    result: CampaignsResult, changed: Sequence[ParameterDifference]
) -> list[CombinationDifference]:
    """Return the combinations of which one parameter has changed while another one is at its bound in a log."""
    bounded, names = _bounded(result), {p.name for p in changed}
    return [c for c in result.combinations if bounded.keys() & set(c.parameters) and names & set(c.parameters)]


def _bounded(result: CampaignsResult) -> dict[str, str]:
    """Return the reasons of the parameters that are not compared because they are at a bound in a log, by name."""
    return {p.name: p.reason for p in result.not_compared if p.code == "at-bound"}


def _split_sentence(c: CombinationDifference, result: CampaignsResult, changed: Sequence[ParameterDifference]) -> str:
    """Return the sentence that the logs determine a combination, and not how its parameters share the change."""
    bounded = {n: reason for n, reason in _bounded(result).items() if n in c.parameters}
    reasons = "; ".join(f"{n} is {reason}" for n, reason in bounded.items())
    names = " and ".join(p.name for p in changed if p.name in c.parameters)
    return (
        f"How the {c.meaning} is split between {' and '.join(c.parameters)} is not determined: {reasons}. The change "
        f"of {names} may contain that of {' and '.join(bounded)}; use the {c.meaning}."
    )


def _combination_text(c: Difference) -> str:
    """Return a changed combination in words, with its 95 % interval, and with the change in its unit at the end.

    An example: ``the drag at 1 m/s has grown by 51 % (95 %: 41 to 61 %), 12.5 N``.
    """
    low, high, sign = c.low or 0.0, c.high or 0.0, math.copysign(1.0, c.difference)
    verb = "grown" if sign > 0.0 else "fallen"
    ends = sorted((sign * low, sign * high))
    if c.relative is None:
        size, (least, most) = f"{format_number(abs(c.difference))} {c.unit}".strip(), map(format_number, ends)
        return f"the {c.meaning} has {verb} by {size} (95 %: {least} to {most})"
    scale = 100.0 / c.before.mean
    least, most = (f"{scale * end:.0f}" for end in ends)
    absolute = f"{_with_decimals(abs(c.difference), c.se)[1:]} {c.unit}".strip()
    return f"the {c.meaning} has {verb} by {100.0 * abs(c.relative):.0f} % (95 %: {least} to {most} %), {absolute}"


def _nearest(tested: Sequence[ParameterDifference], combinations: Sequence[CombinationDifference]) -> Difference:
    """Return the difference that is nearest to a change: that with the smallest q value, then the smallest p value.

    A single coefficient is replaced by the combination that it belongs to, such as the drag at a speed, if the data
    determine the change of the combination better: its relative interval is the narrower one.
    """
    together = [c for c in combinations if c.q is not None]
    nearest = min((*tested, *together), key=lambda d: (d.q or 0.0, d.p or 0.0))
    if isinstance(nearest, CombinationDifference):
        return nearest
    sums = [c for c in together if nearest.name in c.parameters and _relative_width(c) < _relative_width(nearest)]
    return min(sums, key=lambda c: c.p or 0.0, default=nearest)


def _scatter_sentence(tested: Sequence[ParameterDifference]) -> str:
    """Return the sentence on the parameter in which the logs of a campaign scatter most; empty if they agree.

    The scatter counts from `SCATTERED` times the typical standard error of a log on.
    """
    ratios = [(p.scatter / e, p) for p in tested if p.scatter and (e := _typical_error(p))]
    ratio, p = max(ratios, key=lambda pair: pair[0], default=(0.0, None))
    if p is None or ratio < SCATTERED:
        return ""
    return (
        f"The logs of one campaign differ in {p.name}: their scatter is {ratio:.1f} times the standard error of a log. "
        f"To see which logs differ: `seatrial ident vehicle LOGS --test-homogeneity {p.name.partition('/')[0]}`."
    )


def _typical_error(p: Difference) -> float:
    """Return the median of the standard errors of the logs; 0 without any."""
    return float(median([x.se for x in p.logs])) if p.logs else 0.0


def _relative_width(d: Difference) -> float:
    """Return the width of the 95 % interval of a difference, as a part of the mean before; inf if it is unknown."""
    if d.relative is None or d.low is None or d.high is None:
        return math.inf
    return (d.high - d.low) / d.before.mean


def _nearest_text(d: Difference, result: CampaignsResult) -> str:
    """Return a difference that is no change, with the correction that it does not pass.

    For example, ``Nearest to a change, but not significant after the correction for 8 comparisons: d_uu +31 %
    (95 %: -4 to +66 %), p = 0.01, q = 0.08.`` The comparisons are those of the family of the difference.
    """
    own = d.family if isinstance(d, ParameterDifference) else "boat"
    n = sum(p.family == own and p.q is not None for p in result.parameters)
    n += len(result.combinations) if own == "boat" else 0
    if isinstance(d, ParameterDifference):
        words = _change_text(d)
    else:
        scale, unit, form = (1.0, d.unit, "+.3g") if d.relative is None else (100.0 / d.before.mean, "%", "+.0f")
        change, low, high = (f"{scale * (x or 0.0):{form}}" for x in (d.difference, d.low, d.high))
        words = f"{d.meaning} {change} {unit} (95 %: {low} to {high} {unit})"
    correction = f"after the correction for {counted(n, 'comparison')}" if n > 1 else f"(p = {d.p or 0.0:.2g})"
    numbers = f", p = {d.p or 0.0:.2g}, q = {q_beside(d.q or 0.0, result.false_discovery_rate)}" if n > 1 else ""
    return f"Nearest to a change, but not significant {correction}: {words}{numbers}."


def q_beside(q: float, rate: float) -> str:
    """Return a q value with two digits, or with as many as show on which side of the false discovery rate it is.

    For example, 0.05012 beside a rate of 0.05 is ``0.0501``, and 0.0949 is ``0.095``.
    """
    for digits in range(2, 16):
        text = f"{q:.{digits}g}"
        if (float(text) <= rate) == (q <= rate):
            return text
    return repr(q)


def _load_sentence(changed: Sequence[ParameterDifference], tested: Sequence[ParameterDifference]) -> str:
    """Return a sentence if the masses in surge and sway have changed by the same mass, as of another load; else "".

    A load adds the same mass to both, also if its size is only known as well as the scale of the thrust. Another thrust
    multiplies both by the same factor. The first is stated only if the second is excluded. The differences have to
    agree within 2 standard errors. The relative ones have to differ by more than 3, or the relative change of both
    has to differ by more than 3 from that of the inertia m_r, which another thrust would change too. An inertia that
    has not changed shows that the load is near the centre of gravity. ``tested`` are all tested parameters.
    """
    masses = [p for p in changed if p.name in ("m_u", "m_v") and p.before.mean > 0.0 and p.se > 0.0]
    if len(masses) < 2:
        return ""
    (du, su), (dv, sv) = ((p.difference, p.se) for p in masses)
    shares = [p.difference / p.before.mean for p in masses]
    errors = [p.se / p.before.mean for p in masses]
    same_share = abs(shares[0] - shares[1]) < DIFFER * math.hypot(*errors)
    inertia = next((p for p in tested if p.name == "m_r" and p.before.mean > 0.0 and p.se > 0.0), None)
    if inertia is not None and same_share:
        precision = [error**-2.0 for error in errors]
        share = sum(s * w for s, w in zip(shares, precision, strict=True)) / sum(precision)
        apart = abs(share - inertia.difference / inertia.before.mean)
        same_share = apart < DIFFER * math.hypot(sum(precision) ** -0.5, inertia.se / inertia.before.mean)
    if abs(du - dv) > AGREE * math.hypot(su, sv) or same_share:
        return ""
    weights = 1.0 / su**2, 1.0 / sv**2
    size = (weights[0] * du + weights[1] * dv) / sum(weights)
    verb = "grown" if size > 0.0 else "fallen"
    cause = "as of another load; another thrust would change both by the same share."
    if inertia is not None and not inertia.changed:
        load = "a load" if size > 0.0 else "a load that was taken away"
        cause = (
            f"and m_r has not changed: as {load} of about {abs(size):.3g} kg near the centre of gravity would. Another "
            "thrust would change all three by the same share."
        )
    return (
        f"m_u and m_v have {verb} by about the same mass ({abs(size):.3g} ± {sum(weights) ** -0.5:.2g} kg, beside the "
        f"error of the scale of the thrust), {cause}"
    )


def _model_sentence(result: CampaignsResult) -> str:
    """Return a sentence on a model with common errors, if the changed parameters do not help the prediction; else "".

    It is left out if the fits have score tests or common errors, or the model of a file, which may have them already.
    """
    verdicts = [e.verdict for e in result.errors if e.logs == "after" and e.values == "changed"]
    has_them = result.score_tests or result.common_errors or result.model.endswith(".toml")
    if has_them or not verdicts or "fell" in verdicts:
        return ""
    return (
        "The changes do not help this model to predict, so that it may lack small errors of sensors and hull form. Fit "
        "the logs before with them (`seatrial ident vehicle LOGS --out before`), and compare with that model: --model "
        "before/model.toml."
    )


def _factor_sentence(
    factor: CommonFactor, parameters: Sequence[ParameterDifference], changed: Sequence[ParameterDifference]
) -> str:
    """Return the sentence on the common factor of masses and damping, and on the thrust that has the same effect.

    If the thrusts of both sides were compared and have not changed to each other, the thrust is that of both sides.
    """
    size = _with_interval(factor.factor, factor.low, factor.high)
    of_sides = [p for p in parameters if _is_of_sides(p)]
    if not of_sides:
        whose = "a thrust that has become"
    elif of_sides[0].changed:
        whose = "a mean thrust of both sides that has become"
    else:
        whose = "a thrust of both sides that has become"
    same = f"{whose} {format_number(1.0 / factor.factor)} times as large does the same."
    if any(p.name in factor.parameters for p in changed):
        return f"One factor of {size} on masses and damping explains these changes; {same}"
    # None of them alone, as the scale of the forces is uncertain.
    return f"Masses and damping together have changed by one factor of {size}; {same}"


def _with_interval(value: float, low: float, high: float) -> str:
    """Return a number with its 95 % interval, with as many decimals as it needs: ``1.14 (95 %: 1.08 to 1.20)``.

    The last digit is at most half of the half width.
    """
    half = 0.5 * (high - low)
    digits = max(0, -math.floor(math.log10(0.5 * half))) if half > 0.0 else 2
    return "{:.{n}f} (95 %: {:.{n}f} to {:.{n}f})".format(value, low, high, n=digits)


def _sides_sentence(p: ParameterDifference, factor: CommonFactor | None) -> str:
    """Return a sentence on the lost thrust of each side, for the parameter of its difference; else empty text.

    A side that has kept its thrust within the interval of the factor makes the other one the only cause. Without a
    common factor of masses and damping only the ratio of the sides is known, which the headline has.
    """
    if not _is_of_sides(p) or factor is None or not factor.explains:
        return ""
    before, after = p.before.mean, p.after.mean
    changes = {side: (1.0 + s * after) / (1.0 + s * before) for side, s in (("left", 1.0), ("right", -1.0))}
    shares = {side: f"{100.0 * x / factor.factor:.0f} %" for side, x in changes.items()}
    kept = [side for side, x in changes.items() if x / factor.high <= 1.0 <= x / factor.low]
    if len(kept) == 1:
        (stayed,) = kept
        ends = (100.0 * changes[stayed] / f for f in (factor.high, factor.low))
        other = "left" if stayed == "right" else "right"
        return (
            f"One cause explains both: the {other} thruster gives {shares[other]} of its thrust of before, and the "
            f"{stayed} one all of it ({shares[stayed]}, 95 %: {' to '.join(f'{x:.0f}' for x in ends)} %). Masses and "
            "damping have then stayed."
        )
    return (
        f"If masses and damping have stayed, the left thruster gives {shares['left']} of its thrust of before, "
        f"and the right one {shares['right']}."
    )


def _is_of_sides(p: ParameterDifference) -> bool:
    """Return whether a parameter is half the relative difference of the thrusts of both sides, left minus right."""
    effect = catalogue().get(p.effect or "")
    is_share = max(abs(p.before.mean), abs(p.after.mean)) < 1.0
    return effect is not None and effect.thrust_difference == p.name and is_share


def _unexplained_sentence(result: CampaignsResult) -> str:
    """Return a sentence if the changes alone predict the logs after much worse than all values of after; else "".

    The channel with the largest ratio of both errors decides.
    """
    rows = {e.values: e.channels for e in result.errors if e.logs == "after"}
    changed, own = (rows.get(kind, {}) for kind in ("changed", "after"))
    pairs = {n: (c.after, o.after, c.unit) for n, c in changed.items() if (o := own.get(n)) and c.after and o.after}
    if not pairs:
        return ""
    worst = max(pairs, key=lambda n: pairs[n][0] / pairs[n][1])
    with_changes, with_all, unit = pairs[worst]
    if with_changes < MUCH_WORSE * with_all:
        return ""
    scale, shown = in_degrees(unit)
    return (
        f"These changes do not explain all: the error of {worst} {result.horizon:g} s ahead is "
        f"{format_number(scale * with_changes)} {shown} with them, and {format_number(scale * with_all)} {shown} with "
        "all values of after. Something else has changed that these logs do not determine. Take more logs of each "
        "campaign, hold what cannot have changed (--fix NAME=VALUE), or add an effect that may be new (--effect NAME); "
        "`seatrial ident diagnose` on the logs after looks for it."
    )


def _worse_predicted_sentence(result: CampaignsResult) -> str:
    """Return a sentence if no values predict the logs after as well as those before are predicted; else empty text.

    The errors of the logs before are those with their own values, and those of the logs after with the changed
    parameters or with all values of after, whichever are smaller. The limit is `MUCH_WORSE`, or `WORSE` if the changed
    parameters do not improve the prediction. The text is also empty if the logs were not predicted.
    """
    rows = {(e.logs, e.values): e for e in result.errors}
    before, own, changed = (rows.get(k) for k in (("before", "before"), ("after", "after"), ("after", "changed")))
    if before is None or own is None:
        return ""
    compared = [r for e in (own, changed) if e is not None and (r := _error_ratios(before, e))]
    if not compared:
        return ""
    ratios = min(compared, key=lambda r: geometric_mean(r.values()))
    ratio = geometric_mean(ratios.values())
    no_help = changed is not None and changed.verdict in ("unchanged", "rose")
    if ratio < (WORSE if no_help else MUCH_WORSE):
        return ""
    worst = max(ratios, key=lambda n: ratios[n])
    lacks = (
        f"(most of all {worst}: its error is {ratios[worst]:.1f} times as large), so the model lacks an effect that is "
        "new in them. Run `seatrial ident diagnose` on the logs after, and compare the campaigns with the effect that "
        "it finds (--effect NAME). Until then a change of a parameter may stand for the missing effect."
    )
    if ratio < MUCH_WORSE:
        return (
            "Neither the changed parameters nor values of their own bring the prediction error of the logs after back "
            f"to that of the logs before {lacks}"
        )
    return f"With values of their own, the logs after are predicted much worse than those before {lacks}"


def _error_ratios(before: CampaignErrors, after: CampaignErrors) -> dict[str, float]:
    """Return the errors of the logs after over those of the logs before, by channel.

    The ratio is that of the errors, or of the errors over the spread of the channel if this is smaller: less motion
    makes the errors smaller, but not those by noise. Positions are left out, whose spread is the size of the area.
    """
    return {
        n: a.after / b.after * min(1.0, b.spread / a.spread)
        for n, a in after.channels.items()
        if n not in POSITIONS
        and (b := before.channels.get(n)) is not None
        and a.spread
        and b.spread
        and a.after
        and b.after
    }


def _change_text(p: ParameterDifference) -> str:
    """Return a changed parameter with its change and the 95 % interval: ``m_u +14.4 kg (95 %: +9.2 to +19.6), +21 %``.

    A difference of the sides is in the words of
    a diagnosis, with the parameter in brackets.
    """
    low, high = p.low or 0.0, p.high or 0.0
    if _is_of_sides(p):
        in_words = catalogue()[p.effect or ""].in_words
        words = in_words({p.name: (p.after.mean, p.after.se)}) if in_words is not None else p.meaning
        lead = math.copysign(1.0, p.after.mean) * p.before.mean  # of the side that is the stronger one after
        before = 100.0 * (1.0 - lead) / (1.0 + lead)
        return f"{words}, before {before:.0f} % ({p.name} {p.difference:+.3g}, 95 %: {low:+.3g} to {high:+.3g})"
    if p.relative is None:
        return f"{p.name} {p.difference:+.3g} {p.unit}".strip() + f" (95 %: {low:+.3g} to {high:+.3g})"
    change, *ends = (_with_decimals(v, p.se) for v in (p.difference, low, high))
    size = f"{p.name} {change} {p.unit}".rstrip()
    return f"{size} (95 %: {' to '.join(ends)}), {100.0 * p.relative:+.0f} %"


def _with_decimals(value: float, error: float) -> str:
    """Return a number with its sign, and with the decimals of the second digit of its standard error: ``+14.4``."""
    digits = max(0, 1 - math.floor(math.log10(error))) if 0.0 < error < math.inf else 2
    return f"{value:+z.{digits}f}"


def _percent_interval(*ratios: float) -> list[str]:
    """Return changes of ratios of errors in per cent: with one decimal if one of them is below 1 %, two below 0.1 %."""
    changes = [100.0 * (ratio - 1.0) for ratio in ratios]
    least = min(map(abs, changes))
    places = 0 if least >= 1.0 else 1 if least >= 0.1 else 2
    return [f"{change:+z.{places}f}" for change in changes]


def _errors_sentence(result: CampaignsResult) -> str | None:
    """Return the sentence on the prediction errors on the logs after, with the changes if there are any.

    None if these logs were not predicted by both models.
    """
    rows = {e.values: e for e in result.errors if e.logs == "after"}
    kind, row = next(((k, rows[k]) for k in ("changed", "after") if k in rows), ("", None))
    if row is None or row.ratio is None:
        return None
    words = "with the changed parameters" if kind == "changed" else "with all values of after"
    begin = f"On the logs after, the prediction error {result.horizon:g} s ahead"
    if row.low is None or row.high is None:
        return f"{begin} changes by {100 * row.ratio - 100:+.0f} % {words}; the logs are too short for an interval."
    change, low, high = _percent_interval(row.ratio, row.low, row.high)
    verdict = {"fell": "falls", "rose": "rises", "unchanged": "does not change significantly"}[
        row.verdict or "unchanged"
    ]
    return f"{begin} {verdict} {words}: {change} % (95 %: {low} to {high} %)."
