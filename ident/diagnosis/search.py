"""Diagnosis: forward selection of missing effects by score tests, refits and validation.

1. Fit the model with disturbance forces and sensor biases as states.
2. Score tests of all candidates, parametric and nonparametric (``ident.diagnosis.score_test``).
3. Refit with the best few, all parameters free; compare by ``2 d ln L - df ln n`` (Delta BIC).
4. Validation: the gain in log-likelihood on validation data, block by block, has to be significant.
5. Add the effect and repeat; after a nonparametric curve only parametric effects of large gain are added.

Kristensen, Madsen and Jorgensen 2004; Engle 1984.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from daq.errors import counted
from ident.data import LogSegment, Record, make_record
from ident.diagnosis.adequacy import assess_alternatives
from ident.diagnosis.candidates import normal_equations, variables, wave_peak_score
from ident.diagnosis.importance import effect_importance
from ident.diagnosis.results import Diagnosis, EffectAttribution, Refit, Round
from ident.diagnosis.score_test import Score, fitted_parameters, score_test_passes, score_tests, score_threshold
from ident.effects import NonparametricForce, catalogue, input_response_effects, nonparametric_effect, shape
from ident.engine import quickly
from ident.estimation import (
    AT_BOUND,
    ROUGH,
    VAGUE,
    FittedModel,
    fit_and_evaluate,
    fit_with_rescaling,
    nominal,
    superset,
    without_absent_sensors,
)
from ident.model import Effect, EffectKind, ForceCurve, Model, Parameter
from ident.models import residuals_of, scale_priors, size_of, variables_of
from ident.numerics import NORMAL_MAD, Array
from ident.reporter import QUIET, Reporter

N_REFITS, N_UNKNOWN = 4, 2  # parametric and nonparametric candidates that are refitted in a round
MIN_SCORE_RATIO = 0.05  # of the best score: a refit gains up to ten times its score, not twenty times
# the difference between the true form of an effect and ours looks like other, much smaller effects: not added
MIN_GAIN_RATIO = 0.02  # of the largest gain so far
# the same holds for a curve and its spline, up to a fifteenth of the gain; other missing effects mostly have a third
MIN_GAIN_RATIO_AFTER_CURVE = 0.1  # of the largest gain so far


def diagnose(
    model: Model,
    estimation: Sequence[LogSegment],
    validation: Sequence[LogSegment],
    *,
    effects: Mapping[str, Effect] | None = None,
    max_effects: int = 3,
    rate: float = 10.0,
    reporter: Reporter = QUIET,
) -> Diagnosis:
    """Find effects that ``model`` lacks. ``effects``: the candidates, by default the whole catalogue.

    Raises ValueError, naming the run, where a run lacks a signal that the model needs; or the model, where it has no
    hull whose forces X, Y, N could lack anything, and is no thruster on the bench either.
    """
    if not residuals_of(model):
        raise ValueError(
            f"model {model.name} cannot be diagnosed: it lacks a hull with the forces X, Y and N; fit "
            "the horizontal model instead"
        )
    full = nominal(model)
    candidates = {n: e for n, e in (catalogue() if effects is None else effects).items() if full.accepts(e)}
    wanted = set(candidates)
    everything, candidates = superset(full, candidates, [*estimation, *validation])
    untested = wanted - set(candidates)
    records = [make_record(everything, r, rate) for r in estimation]
    unseen = [make_record(everything, r, rate) for r in validation]
    full = without_absent_sensors(full, records + unseen)
    reporter.progress(f"fitting {full.name} with disturbance forces to {counted(len(records), 'run')}")
    before = current = fit_with_rescaling(full, records, unseen)
    size, known = size_of(before.fit.model), catalogue()
    # user-defined effects keep their priors
    candidates = {n: scale_priors(e, size) if known.get(n) is e else e for n, e in candidates.items()}
    rounds: list[Round] = []
    unknown, n = False, sum(r.n_rows for r in records)
    while True:
        scores, passed = score_all(current, records, candidates)
        largest = max((r.chosen.criterion for r in rounds if r.chosen is not None), default=0.0)
        least = MIN_GAIN_RATIO_AFTER_CURVE * largest
        tried = [s for s in passed if not s.generic and s.criterion(n) > least] if unknown else passed
        if len(rounds) >= max_effects or not tried:
            break
        reporter.progress(
            f"round {len(rounds) + 1}: {len(passed)} of {len(scores)} candidates pass, best {tried[0].name}"
        )
        one = _round(current, records, unseen, candidates, scores, tried, largest, reporter)
        rounds.append(one)
        if one.chosen is None:
            break
        current, unknown = one.chosen.stage, unknown or one.chosen.unknown
        candidates.pop(one.chosen.effect.name, None)
    reporter.progress("weighing what was found")
    weights = effect_importance(before, rounds, records, unseen)
    order = [w.effect for w in weights]
    judgements = assess_alternatives(rounds, passed, n, untested)
    judgements = tuple(sorted(judgements, key=lambda j: order.index(j.effect)))
    shapes = _shapes(before, rounds, judgements, records)
    return Diagnosis(before, current, tuple(rounds), tuple(passed), tuple(shapes), judgements, weights)


def score_all(
    stage: FittedModel, records: Sequence[Record], candidates: Mapping[str, Effect]
) -> tuple[list[Score], list[Score]]:
    """All score tests on a fitted model, best first, and those that pass; of a scanned effect the best only."""
    model = stage.model
    # a parameter that stands at its bound cannot give way to take up what a candidate would explain
    stuck = {n for n, what in stage.fit.flags if what in (AT_BOUND, VAGUE)}
    fitted = [p for p in fitted_parameters(model, len(records)) if p.full_name not in stuck]
    normal, places = normal_equations(stage, records, list(candidates.values()), fitted)
    priors = np.array([1 / p.prior[1] ** 2 if p.prior else 0.0 for p in fitted])
    scores = score_tests(normal, len(fitted), priors, places)
    waves = wave_peak_score(stage) if "waves" in candidates else None
    scores += [] if waves is None else [waves]
    n = sum(r.n_rows for r in records)
    scores.sort(key=lambda s: -s.criterion(n))
    first: dict[str, Score] = {}
    for s in scores:
        first.setdefault(s.name, s)
    best = [replace(s, threshold=score_threshold(s, scores)) for s in first.values()]
    return best, [s for s in best if score_test_passes(s, scores)]


def _round(
    current: FittedModel,
    records: Sequence[Record],
    unseen: Sequence[Record],
    candidates: Mapping[str, Effect],
    scores: list[Score],
    passed: list[Score],
    largest: float,
    reporter: Reporter,
) -> Round:
    n = sum(r.n_rows for r in records)
    specific = [s for s in passed if not s.generic][:N_REFITS]
    specific = [s for s in specific if s.criterion(n) > MIN_SCORE_RATIO * specific[0].criterion(n)]
    refits = _refit_all(current, records, unseen, [(candidates[s.name], s) for s in specific], n, reporter)
    first = max((r for r in refits if r.accepted), key=lambda r: r.criterion, default=None)
    best, curve = (-np.inf, None) if first is None else (first.criterion, first.effect.parametric_form_of)
    # a table competes only where no name that holds comes close to what the scores promise for it, or where the name
    # is no more than one shape of the table's curve
    least = max(0.5 * best, best - 50)
    generic = [(s, s.kind is EffectKind.NONPARAMETRIC and s.curve == curve) for s in passed if s.generic]
    unknown = [s for s, whole in generic if s.criterion(n) > least or whole][:N_UNKNOWN]
    drawn = [(_unknown(s, current), s) for s in unknown]
    refits += _refit_all(current, records, unseen, drawn, n, reporter)
    refits.sort(key=lambda r: -r.criterion)
    names = tuple(s.name for s in passed)
    for r in refits[:3]:
        if r.accepted and r.criterion > max(0.25 * refits[0].criterion, MIN_GAIN_RATIO * largest):
            exact = replace(r, stage=fit_and_evaluate(r.stage.fit.model, records, unseen))
            refits[refits.index(r)] = exact
            return Round(tuple(scores), names, tuple(refits), exact, _why(r))
    why = "no candidate predicts the validation data better"
    if any(r.accepted for r in refits):
        why = f"what is left is small beside what was found: {refits[0].effect.title} would gain {refits[0].gain:.0f}"
    return Round(tuple(scores), names, tuple(refits), None, why)


def _why(r: Refit) -> str:
    if r.validation_gain > 0:
        return f"the log-likelihood of the validation data rises by {r.validation_gain:.0f} (t = {r.t:.1f})"
    return f"the log-likelihood rises in most blocks of the validation data (t = {r.t:.1f}); a few outlying ones fall"


def _refit_all(
    current: FittedModel,
    records: Sequence[Record],
    unseen: Sequence[Record],
    tried: Sequence[tuple[Effect, Score]],
    n: int,
    reporter: Reporter,
) -> list[Refit]:
    def refit(pair: tuple[Effect, Score]) -> Refit | None:
        effect, score = pair
        reporter.progress(f"refitting with {effect.title}")
        start = replace(effect, parameters=tuple(_start(p, score) for p in effect.parameters))
        larger = current.fit.model + start
        try:
            stage = fit_and_evaluate(larger, records, unseen, settings=ROUGH)
        except (ValueError, np.linalg.LinAlgError):
            return None  # a candidate that cannot be fitted is no candidate
        gain = 2 * (stage.fit.log_posterior - current.fit.log_posterior)
        df = sum(p.free for p in effect.parameters)
        total, t = validation_gain(current, stage)
        return Refit(effect, stage, gain, df, gain - df * float(np.log(n)), total, t)

    with ThreadPoolExecutor(2) as pool, quickly(n):
        return [r for r in pool.map(refit, tried) if r is not None]


def _start(parameter: Parameter, score: Score) -> Parameter:
    value = score.scan.get(parameter.name, parameter.value)
    if parameter.name in score.step:
        sd = parameter.prior[1] if parameter.prior else np.inf
        value = parameter.value + float(np.clip(score.step[parameter.name], -sd, sd))
        low, high = parameter.bounds
        value = min(max(value, low), high)
    return parameter.at(value)


def _unknown(score: Score, stage: FittedModel) -> Effect:
    assert score.curve is not None
    size, tested = size_of(stage.fit.model), (score.kind, score.curve)
    for effect in input_response_effects(stage.model):
        if (effect.kind, effect.curve) == tested:
            return scale_priors(effect, size)
    return scale_priors(nonparametric_effect(stage.model, score.curve, _span(stage, score.curve)), size)


def _span(stage: FittedModel, curve: ForceCurve) -> tuple[float, float]:
    if curve.second or curve.variable in {v.name for v in variables_of(stage.model) if v.angle}:
        return -np.pi, np.pi
    seen = [variables(stage.model, v.record, v.run.x_filt, v.values) for v in stage.estimation]
    z = np.concatenate([of[curve.variable] for of in seen])
    low, high = np.percentile(z, [1, 99])
    return float(low), float(high)


def _shapes(
    before: FittedModel, rounds: Sequence[Round], judgements: Sequence[EffectAttribution], records: Sequence[Record]
) -> list[NonparametricForce]:
    """Nonparametric curves: of selected nonparametric effects, and the residual in place of the first ambiguous
    effect."""
    found, current = [], before
    chosen = [r for r in rounds if r.chosen is not None]
    first = next((j.effect for j in judgements if j.attribution == "ambiguous"), None)
    for one, r in ((one, one.chosen) for one in chosen if one.chosen is not None):
        if r.unknown:
            found.append(_drawn(r.effect, r.stage))
        elif r.effect.name == first and (likely := _likely_table(one)):
            effect = _unknown(likely, current)
            found.append(_drawn(effect, fit_and_evaluate(current.fit.model + effect, records, ())))
        current = r.stage
    drawn: dict[tuple[str, str], NonparametricForce] = {}
    for s in found:
        if s is not None:  # of one curve the whole, not what is left of it beside a name
            drawn.setdefault((s.force, s.variable), s)
    return list(drawn.values())


def _likely_table(one: Round) -> Score | None:
    """The best of the residuals as functions of one variable."""
    tables = [s for s in one.scores if s.kind is EffectKind.NONPARAMETRIC and s.name in one.passed]
    return next((s for s in tables if s.curve is not None and not s.curve.second), None)


def _drawn(effect: Effect, stage: FittedModel) -> NonparametricForce | None:
    f = stage.fit
    return shape(f.model, effect, f.model.values, f.names, f.covariance)


def validation_gain(before: FittedModel, after: FittedModel) -> tuple[float, float]:
    """Gain in log-likelihood on the validation data: its sum, and t over blocks of ten seconds (four on the bench).

    t is the larger of the plain one, which counts evidence that sits in few blocks, and of one with the blocks
    drawn in to three robust standard deviations, so that one glitch of a clock or a sensor, which no model
    foresees, does not outvote all the rest.
    """
    gains = []
    for a, b in zip(before.validation, after.validation, strict=True):
        block = np.floor(a.record.t / (2 * before.model.block)).astype(int)
        gains.append(np.bincount(block, b.ll - a.ll))
    if not gains:
        return 0.0, 0.0
    per_block: Array = np.concatenate(gains).astype(np.float64)
    middle = np.median(per_block)
    reach = 3 * NORMAL_MAD * np.median(np.abs(per_block - middle))
    drawn_in = np.clip(per_block, middle - reach, middle + reach)
    return float(per_block.sum()), max(_t(per_block), _t(drawn_in))


def _t(x: Array) -> float:
    return float(x.mean() / (x.std(ddof=1) / np.sqrt(x.size) + 1e-12)) if x.size > 1 else 0.0
