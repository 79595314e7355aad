"""Diagnosis: forward selection of missing effects by score tests, refits and validation.

1. Fit the model with disturbance forces and sensor biases as states.
2. Score tests of all candidates, parametric and nonparametric (``seatrial.ident.diagnosis.score_test``).
3. Refit with the best few, all parameters free; compare by ``2 d ln L - df ln n`` (Delta BIC).
4. Validation (``seatrial.ident.diagnosis.acceptance``): the gain in log-likelihood on all validation data has to be
   positive and
   significant, and the prediction of all channels not worse than without it, nor than that of the nominal model; of a
   nonparametric effect it has to be better. The best refit of which that holds is added. Without validation runs,
   blocks in time of the estimation runs are predicted by the fit to the others.
5. Repeat; after a nonparametric curve only parametric effects of large gain are added.
6. Leave each effect out again: one that does not pay beside the others is removed, and the last ones of a set with
   which the prediction is worse than that of the nominal model.

Kristensen, Madsen and Jorgensen 2004; Engle 1984.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from seatrial.daq.errors import counted
from seatrial.ident.data import ORIGIN, LogSegment, Record, far_apart, make_record
from seatrial.ident.diagnosis.acceptance import Comparison, comparison, validation_mismatches
from seatrial.ident.diagnosis.adequacy import assess_alternatives
from seatrial.ident.diagnosis.candidates import normal_equations, variables, wave_peak_score
from seatrial.ident.diagnosis.importance import effect_importance, fit_without
from seatrial.ident.diagnosis.results import (
    T_VALIDATION,
    Diagnosis,
    EffectAttribution,
    EffectImportance,
    Outcome,
    Refit,
    RemovedEffect,
    Round,
    ShortData,
    UntestedCandidate,
    helps,
)
from seatrial.ident.diagnosis.score_test import (
    Score,
    fitted_parameters,
    prior_terms,
    score_test_passes,
    score_tests,
    score_threshold,
)
from seatrial.ident.effects import NonparametricForce, catalogue, input_response_effects, nonparametric_effect, shape
from seatrial.ident.engine import quickly
from seatrial.ident.estimation import (
    AT_BOUND,
    FIT_ERRORS,
    ROUGH,
    VAGUE,
    FittedModel,
    Unseen,
    between_runs,
    blocks_of,
    cross_validated,
    fit_and_evaluate,
    fit_with_rescaling,
    lacking_inputs,
    nominal,
    superset,
    validated_in_blocks,
    validation_records,
    without_absent_sensors,
    without_untold_sensors,
)
from seatrial.ident.model import Effect, EffectKind, ForceCurve, Model, Parameter
from seatrial.ident.models import residuals_of, scale_priors, size_of, variables_of
from seatrial.ident.reporter import QUIET, Reporter
from seatrial.ident.validation import (
    PredictionChange,
    PredictionEvaluation,
    SmoothedForce,
    evaluate,
    prediction_changes,
    smoothed_forces,
)


@dataclass(frozen=True)
class DiagnosisEvaluation:
    """What the models of a diagnosis predict, and what they leave: computed once, before anything is reported.
    ``changes``: by role, of the prediction errors over the horizon; forces: disturbances, as of both models;
    ``in_blocks``: the effects with parameters of their own for each run, for whose sake the validation runs are
    predicted in blocks of time with the estimates of each run's other blocks."""

    before: PredictionEvaluation
    after: PredictionEvaluation
    changes: Mapping[str, PredictionChange]
    forces_before: tuple[SmoothedForce, ...]
    forces_after: tuple[SmoothedForce, ...]
    in_blocks: tuple[Effect, ...] = ()


def evaluate_diagnosis(diagnosis: Diagnosis, horizon: float | None = None) -> DiagnosisEvaluation:
    """``horizon`` [s]: of ``seatrial.ident.validation.evaluate``."""
    one, other = diagnosis.before, diagnosis.after
    own = tuple(r.effect for r in diagnosis.effects if any(p.per_record for p in r.effect.parameters))
    own = () if one.cross_validated or not one.validation else own
    if own:  # as they were accepted: else the headline would be of data that they were fitted to
        one, other = validated_in_blocks(one), validated_in_blocks(other)
    before = evaluate(one, horizon)
    after = before if other is one else evaluate(other, horizon)
    forces = residuals_of(diagnosis.before.model)
    return DiagnosisEvaluation(
        before,
        after,
        prediction_changes(before, after),
        smoothed_forces(diagnosis.before, forces),
        smoothed_forces(diagnosis.after, forces),
        own,
    )


N_REFITS, N_UNKNOWN = 4, 2  # parametric and nonparametric candidates that are refitted in a round
N_BATCHES = 2  # of parametric ones, where none of the first is accepted
INDISTINGUISHABLE = 2.0  # of BIC: below it evidence is "not worth more than a bare mention" (Kass and Raftery 1995)
LOST = 1.0  # in 2 ln L, that a larger model may lose to rounding of the search
SHORT = 20  # blocks of estimation data (100 s for a boat): below it no name is sure
SHORT_VALIDATION = 8  # of validation data (40 s), of which two make one of the gain: below it t > 2 is often chance
MIN_SCORE_RATIO = 0.05  # of the best score: a refit gains up to ten times its score, not twenty times
# the difference between the true form of an effect and ours looks like other, much smaller effects: not added
MIN_GAIN_RATIO = 0.02  # of the largest gain so far; an effect that the prediction needs is added all the same
MAX_RATIO_OF_SMALL = 0.98  # of the prediction errors with a small effect to those without, for that
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
    given = catalogue() if effects is None else effects
    candidates = {n: e for n, e in given.items() if full.accepts(e)}
    wanted = set(candidates)
    failed = validation_records(full, validation, rate)[1]
    usable = [r for r in validation if r.name not in {f.record for f in failed}]
    if _far_apart([*estimation, *usable]):
        candidates = {n: e for n, e in candidates.items() if not e.fixed_point}
    everything, candidates = superset(full, candidates, [*estimation, *usable])
    untested = wanted - set(candidates)
    records = [make_record(everything, r, rate) for r in estimation]
    runs = [make_record(everything, r, rate) for r in usable]
    runs = without_untold_sensors(full, records, runs)
    full = without_absent_sensors(full, records)
    reporter.progress(f"fitting {full.name} with disturbance forces to {counted(len(records), 'run')}")
    before, unseen = _first_fit(full, records, runs)
    size, known = size_of(before.fit.model), catalogue()
    # user-defined effects keep their priors
    candidates = {n: scale_priors(e, size) if known.get(n) is e else e for n, e in candidates.items()}
    candidates |= between_runs(before.fit)
    search = _Search(records, unseen, candidates, reporter)
    current, passed = search.forward(before, max_effects)
    reporter.progress("weighing what was found")
    current, weights, removed = search.without_what_does_not_pay(before, current)
    if removed:
        passed = search.scored(current)[1]
    gone = {r.effect.name for r in removed}
    kept = [r for r in search.rounds if r.chosen is None or r.chosen.effect.name not in gone]
    order = [w.effect for w in weights]
    judgements = assess_alternatives(
        kept, passed, search.n, untested, weights, _reservations(before, current), current,
        search.rounds[0].scores if search.rounds else (),
    )  # fmt: skip
    judgements = tuple(sorted(judgements, key=lambda j: order.index(j.effect)))
    shapes, undrawn = _shapes(before, kept, judgements, records)
    return Diagnosis(
        before,
        current,
        tuple(search.rounds),
        tuple(passed),
        tuple(shapes),
        judgements,
        weights,
        tuple(removed),
        (*failed, *before.failed, *(f for f in current.failed if f not in before.failed)),
        validation_mismatches(current),
        _short_data(search.scores, before),
        undrawn,
        _refused(full, given, [*estimation, *usable]),
        tuple(search.scores),
        tuple(search.untried),
    )


def _far_apart(runs: Sequence[LogSegment]) -> bool:
    return far_apart([run.meta.get(ORIGIN) for run in runs])


def _refused(model: Model, given: Mapping[str, Effect], runs: Sequence[LogSegment]) -> tuple[UntestedCandidate, ...]:
    """Candidates of the user's own that cannot be tested, and why; of the catalogue, where many do not concern a model,
    those at a fixed point of logs that have no common frame."""
    known, found = catalogue(), []
    if _far_apart(runs):
        apart = "it is at one place over ground, and the logs are too far apart to have x and y from one origin"
        found = [UntestedCandidate(e, apart) for e in given.values() if e.fixed_point and model.accepts(e)]
    for effect in (e for name, e in given.items() if known.get(name) is not e and e not in [u.effect for u in found]):
        reason = model.refusal(effect)
        lacking = ((run, lacking_inputs(model, effect, run)) for run in runs if reason is None)
        reason = next((f"{run.name} lacks its input {min(names)}" for run, names in lacking if names), reason)
        if reason is not None:
            found.append(UntestedCandidate(effect, reason))
    return tuple(found)


def _short_data(scores: Sequence[Score], stage: FittedModel) -> ShortData | None:
    """Which candidates no effect of any size would let pass, since there are too few blocks of time."""
    short = [s for s in scores if s.blocks < s.least_blocks]
    if not short:
        return None
    needed = max(s.least_blocks for s in short) * stage.model.block
    return ShortData(sum(r.duration for r in stage.records), needed, len(short), len(scores))


def _first_fit(full: Model, records: list[Record], runs: list[Record]) -> tuple[FittedModel, Unseen]:
    """The nominal model fitted, and what validates it: the validation runs; where none can be evaluated, blocks in time
    of the estimation runs."""
    stage = fit_with_rescaling(full, records, runs)
    if stage.validation:
        return stage, runs
    blocks = blocks_of(records, stage.estimation, full.block)
    return cross_validated(stage, blocks), blocks


def _reservations(before: FittedModel, after: FittedModel) -> list[str]:
    """Why no name can be sure on these data, whatever the effect."""
    reasons = [
        f"the fit {which} it did not converge"
        for which, s in (("without", before), ("with", after))
        if not s.fit.converged
    ]
    seconds = sum(r.duration for r in after.records)
    if seconds < SHORT * after.model.block:
        reasons.append(f"the estimation data are short ({seconds:.0f} s)")
    unseen = sum(v.record.duration for v in after.validation)
    if unseen < SHORT_VALIDATION * after.model.block:
        reasons.append(f"the validation data are short ({unseen:.0f} s)")
    return reasons


def score_all(
    stage: FittedModel, records: Sequence[Record], candidates: Mapping[str, Effect]
) -> tuple[list[Score], list[Score]]:
    """All score tests on a fitted model, best first, and those that pass; of a scanned effect the best only."""
    model = stage.model
    # a parameter that stands at its bound cannot give way to take up what a candidate would explain
    stuck = {n for n, what in stage.fit.flags if what in (AT_BOUND, VAGUE)}
    fitted = [p for p in fitted_parameters(model, len(records)) if p.full_name not in stuck]
    normal, places = normal_equations(stage, records, list(candidates.values()), fitted)
    at = np.array([stage.fit.estimate(p.name, p.segment or 0)[0] for p in fitted])
    scores = score_tests(normal, prior_terms(fitted, at), places)
    waves = wave_peak_score(stage) if "waves" in candidates else None
    scores += [] if waves is None else [waves]
    n = sum(r.n_rows for r in records)
    scores.sort(key=lambda s: -s.criterion(n))
    first: dict[str, Score] = {}
    for s in scores:
        first.setdefault(s.name, s)
    best = [replace(s, threshold=score_threshold(s, scores)) for s in first.values()]
    return best, [s for s in best if score_test_passes(s, scores)]


class _Search:
    """The forward selection and its check: what every step needs, and the rounds so far."""

    def __init__(
        self, records: Sequence[Record], unseen: Unseen, candidates: Mapping[str, Effect], reporter: Reporter
    ) -> None:
        self.records, self.unseen, self.candidates, self.reporter = records, unseen, dict(candidates), reporter
        self.rounds: list[Round] = []
        self.nominal: FittedModel | None = None
        self.scores: list[Score] = []  # the last ones
        self.untried: list[Score] = []  # that passed when as many effects were added as may be
        self.n = sum(r.n_rows for r in records)

    def scored(self, stage: FittedModel) -> tuple[list[Score], list[Score]]:
        """All scores on a model, and those that pass. Raises ValueError where its residuals cannot be tested."""
        try:
            self.scores, passed = score_all(stage, self.records, self.candidates)
            return self.scores, passed
        except np.linalg.LinAlgError as problem:
            names = ", ".join(r.name for r in self.records)
            what = f"the residuals of model {stage.model.name} cannot be tested"
            raise ValueError(f"{names}: {what}: {problem}; the fit {stage.fit.message}") from problem

    def forward(self, before: FittedModel, max_effects: int) -> tuple[FittedModel, list[Score]]:
        """Effects added one after the other; the last model, and the scores on it that pass."""
        self.nominal, current, unknown = before, before, False
        while True:
            scores, passed = self.scored(current)
            largest = max((r.chosen.criterion for r in self.rounds if r.chosen is not None), default=0.0)
            least = MIN_GAIN_RATIO_AFTER_CURVE * largest
            tried = [s for s in passed if not s.generic and s.criterion(self.n) > least] if unknown else passed
            if len(self.rounds) >= max_effects or not tried:
                self.untried = tried
                return current, passed
            self.reporter.progress(
                f"round {len(self.rounds) + 1}: {len(passed)} of {len(scores)} candidates pass, best {tried[0].name}"
            )
            one = self._round(current, scores, tried)
            self.rounds.append(one)
            if one.chosen is None:
                return current, passed
            current, unknown = one.chosen.stage, unknown or one.chosen.unknown
            self.candidates.pop(one.chosen.effect.name, None)

    def without_what_does_not_pay(
        self, before: FittedModel, current: FittedModel
    ) -> tuple[FittedModel, tuple[EffectImportance, ...], list[RemovedEffect]]:
        """Backward elimination: each effect is left out in turn, and the one that pays least is removed, until all pay.
        One without which the model cannot be fitted is not removed: whether it pays is not known.
        """
        removed: list[RemovedEffect] = []
        stuck: dict[str, str] = {}
        while True:
            gone = {r.effect.name for r in removed}
            chosen = [r.chosen for r in self.rounds if r.chosen is not None and r.chosen.effect.name not in gone]
            weights = effect_importance(before, current, chosen, self.rounds, self.records, self.unseen)
            weights = tuple(replace(w, untested=stuck.get(w.effect, w.untested)) for w in weights)
            tested = [w for w in weights if w.untested is None]
            tables = {c.effect.name for c in chosen if c.unknown}
            idle_tables = {w.effect for w in tested if not (w.predicts or helps(w.prediction))} & tables
            idle = min((w for w in tested if not w.pays or w.effect in idle_tables), key=lambda w: w.t, default=None)
            if idle is None and removed and chosen and Comparison(before, current).prediction.verdict == "rose":
                idle = next((w for w in tested if w.effect == chosen[-1].effect.name), None)
            if idle is None:
                return current, weights, removed
            assert idle.prediction is not None
            effect = next(c.effect for c in chosen if c.effect.name == idle.effect)
            self.reporter.progress(f"fitting without {effect.title}, which does not pay")
            try:
                current = fit_without(before, current, chosen, effect, self.records, self.unseen)
            except FIT_ERRORS as problem:
                stuck[idle.effect] = str(problem)
                continue
            removed.append(RemovedEffect(effect, idle.validation_gain, idle.t, idle.prediction))
            if not effect.kind.unknown:  # the last tests are of all that the model has not
                self.candidates[effect.name] = effect

    def _round(self, current: FittedModel, scores: list[Score], passed: list[Score]) -> Round:
        specific = [s for s in passed if not s.generic]
        if specific and (best := specific[0].criterion(self.n)) > 0:  # what does not pay by its score may by its refit
            specific = [s for s in specific if s.criterion(self.n) > MIN_SCORE_RATIO * best]
        refits: list[Refit] = []
        untested: list[UntestedCandidate] = []
        for first in range(0, N_REFITS * N_BATCHES, N_REFITS):  # the next ones where none of the best is accepted
            batch = specific[first : first + N_REFITS]
            self._refit_all(current, [(self.candidates[s.name], s) for s in batch], refits, untested)
            if any(r.accepted for r in refits):
                break
        leading = max((r for r in refits if r.accepted), key=lambda r: r.criterion, default=None)
        most, curve = (-np.inf, None) if leading is None else (leading.criterion, leading.effect.parametric_form_of)
        # a table competes only where no name that holds comes close to what the scores promise for it, or where the
        # name is no more than one shape of the table's curve
        least = max(0.5 * most, most - 50)
        generic = [(s, s.kind is EffectKind.NONPARAMETRIC and s.curve == curve) for s in passed if s.generic]
        unknown = [s for s, whole in generic if s.criterion(self.n) > least or whole][:N_UNKNOWN]
        self._refit_all(current, [(_unknown(s, current), s) for s in unknown], refits, untested)
        names = tuple(s.name for s in passed)
        refits, chosen = self._choose(current, refits, untested)
        return Round(tuple(scores), names, tuple(refits), chosen, tuple(untested))

    def _choose(
        self, current: FittedModel, refits: list[Refit], untested: list[UntestedCandidate]
    ) -> tuple[list[Refit], Refit | None]:
        """The refits with what became of them, best first, and the best that is accepted, fitted exactly.

        A difference between runs has as many parameters as there are runs, and explains some of anything: it comes
        after the effects, unless it explains the validation data significantly better than the best of them. Of effects
        that the likelihood cannot tell apart the one with which the prediction errors are least is the best.
        """
        judged: list[Refit] = []
        chosen: Refit | None = None
        for r in sorted(refits, key=lambda r: (r.effect.kind is EffectKind.BETWEEN_RUNS, -r.criterion)):
            if not r.validated:
                r = replace(r, outcome=Outcome.NOT_SUPPORTED if r.criterion <= 0 else Outcome.NOT_VALIDATED)
            elif chosen is None or _tied(r, chosen) or (r.criterion > chosen.criterion and _explains_more(r, chosen)):
                try:
                    r = self._exact(current, r)
                except FIT_ERRORS as problem:
                    untested.append(UntestedCandidate(r.effect, str(problem)))
                    continue
                if r.outcome is not Outcome.ADDED:
                    pass  # it says why
                elif chosen is not None and _tied(r, chosen) and not _predicts_better(r, chosen):
                    r = replace(r, outcome=Outcome.OUTRANKED)
                else:
                    judged = [replace(q, outcome=Outcome.OUTRANKED) if q is chosen else q for q in judged]
                    chosen = r
            judged.append(r)
        return sorted(judged, key=lambda r: -r.criterion), chosen

    def _exact(self, current: FittedModel, rough: Refit) -> Refit:
        """A validated refit fitted exactly and judged by its prediction. Raises ValueError where that fails or does not
        converge."""
        again = current.fit.model + rough.effect
        reason = ""
        for begin in (rough.stage.fit.model, again, again.with_values(_half_values(rough.effect))):
            try:
                stage = fit_and_evaluate(begin, self.records, self.unseen)
                compared = comparison(current, stage, rough.effect)
                (gain, t), prediction = compared.gain, compared.prediction
            except FIT_ERRORS as problem:
                reason = str(problem)
                continue
            if stage.fit.converged or not current.fit.converged:
                assert self.nominal is not None
                total = prediction if current is self.nominal else Comparison(self.nominal, stage).prediction
                exact = replace(
                    rough, stage=stage, validation_gain=gain, t=t, prediction=prediction, total=total,
                    by_inputs=compared.by_inputs if rough.unknown else None,
                )  # fmt: skip
                return replace(exact, outcome=_outcome(exact, [r.chosen for r in self.rounds if r.chosen is not None]))
            reason = f"the fit with it did not converge: it {stage.fit.message}"
        raise ValueError(reason)

    def _refit_all(
        self,
        current: FittedModel,
        tried: Sequence[tuple[Effect, Score]],
        refits: list[Refit],
        untested: list[UntestedCandidate],
    ) -> None:
        def refit(pair: tuple[Effect, Score]) -> Refit | UntestedCandidate:
            return self._refit(current, *pair)

        with ThreadPoolExecutor(2) as pool, quickly(self.n):
            for found in pool.map(refit, tried):
                if isinstance(found, Refit):
                    refits.append(found)
                else:
                    untested.append(found)

    def _refit(self, current: FittedModel, effect: Effect, score: Score) -> Refit | UntestedCandidate:
        """The current model and an effect, fitted from the first start that can be fitted and loses nothing: nested
        models cannot be worse, so that a fit that is has stopped short."""
        self.reporter.progress(f"refitting with {effect.title}")
        best, reason = None, ""
        for start in _starts(effect, score):
            try:
                stage = fit_and_evaluate(current.fit.model + start, self.records, self.unseen, settings=ROUGH)
                gain = 2 * (stage.fit.log_posterior - current.fit.log_posterior)
                total, t = comparison(current, stage, effect).gain
            except FIT_ERRORS as problem:
                reason = reason or str(problem)
                continue
            df = sum(_degrees(effect, p, len(self.records)) for p in effect.parameters if p.free)
            found = Refit(effect, stage, gain, df, gain - df * float(np.log(self.n)), total, t)
            best = found if best is None or found.gain > best.gain else best
            if best.gain > -LOST:
                break
        return UntestedCandidate(effect, reason) if best is None else best


def _outcome(exact: Refit, added: Sequence[Refit]) -> Outcome:
    """What becomes of an exact refit beside what was added. A small one is left out, unless the prediction needs it or
    it is a declared alternative of a strong one, which is then not sure to be all of it."""
    assert exact.prediction is not None
    if not exact.validated:
        return Outcome.NOT_VALIDATED
    if not exact.accepted:
        worse = "rose" in {p.verdict for p in (exact.prediction, exact.total) if p is not None}
        return Outcome.WORSE_PREDICTION if worse else Outcome.NO_BETTER_PREDICTION
    needed = exact.prediction.verdict == "fell" and exact.prediction.ratio < MAX_RATIO_OF_SMALL
    kin = any(exact.effect.name in r.effect.alternatives or r.effect.name in exact.effect.alternatives for r in added)
    largest = max((r.criterion for r in added), default=0.0)
    return Outcome.ADDED if needed or kin or exact.criterion > MIN_GAIN_RATIO * largest else Outcome.SMALL


def _tied(one: Refit, other: Refit) -> bool:
    """Whether the likelihood cannot tell two effects apart."""
    named = not (one.unknown or other.unknown or one.effect.kind is EffectKind.BETWEEN_RUNS)
    return named and abs(one.criterion - other.criterion) < INDISTINGUISHABLE


def _predicts_better(one: Refit, other: Refit) -> bool:
    """Whether the prediction errors over the horizon are less with one effect than with another; of exact refits."""
    assert one.prediction is not None
    assert other.prediction is not None
    return one.prediction.ratio < other.prediction.ratio


def _explains_more(one: Refit, other: Refit) -> bool:
    """Whether a difference between runs explains the validation data significantly better than another effect."""
    if one.effect.kind is not EffectKind.BETWEEN_RUNS:
        return False
    try:
        compared = comparison(other.stage, one.stage, one.effect)
        gain, t = compared.gain
    except FIT_ERRORS:
        return False
    return gain > 0 and t > T_VALIDATION and compared.prediction.verdict != "rose"


def _half_values(effect: Effect) -> dict[str, float]:
    """A start nearer to nothing, within the bounds: a parameter whose bounds do not hold its half begins at one."""
    return {p.name: min(max(0.5 * p.value, p.bounds[0]), p.bounds[1]) for p in effect.parameters if not p.per_record}


def _degrees(effect: Effect, parameter: Parameter, n_records: int) -> int:
    """Degrees of freedom of a parameter of an effect: what differs between the records has its mean in the model."""
    if not parameter.per_record:
        return 1
    return n_records - 1 if effect.kind is EffectKind.BETWEEN_RUNS else n_records


def _starts(effect: Effect, score: Score) -> Iterator[Effect]:
    """The effect at the one-step estimate of the score test; then nearer to nothing, at the neighbours of a scanned
    value, and on the other side; at last at nothing, from where a search that only climbs loses nothing."""
    scans = [score.scan]
    for name, tried in effect.scan.items():
        at = tried.index(score.scan[name]) if score.scan.get(name) in tried else 0
        scans += [score.scan | {name: tried[k]} for k in (at - 1, at + 1) if 0 <= k < len(tried)]
    for scan, share in [
        (scans[0], 1.0),
        (scans[0], 0.3),
        *((s, 1.0) for s in scans[1:]),
        (scans[0], -0.3),
        (scans[0], 0.0),
    ]:
        yield replace(effect, parameters=tuple(_start(p, score, scan, share) for p in effect.parameters))


def _start(parameter: Parameter, score: Score, scan: Mapping[str, float], share: float) -> Parameter:
    value = scan.get(parameter.name, parameter.value)
    if parameter.name in score.step:
        sd = parameter.prior[1] if parameter.prior else np.inf
        value = parameter.value + share * float(np.clip(score.step[parameter.name], -sd, sd))
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
) -> tuple[list[NonparametricForce], str | None]:
    """Nonparametric curves: of selected nonparametric effects, and the residual in place of the first ambiguous
    effect; why that one could not be fitted: it is a picture beside the result, which does without it."""
    found, current, undrawn = [], before, None
    chosen = [r for r in rounds if r.chosen is not None]
    first = next((j.effect for j in judgements if j.attribution == "ambiguous"), None)
    for one, r in ((one, one.chosen) for one in chosen if one.chosen is not None):
        if r.unknown:
            found.append(_drawn(r.effect, r.stage))
        elif r.effect.name == first and (likely := _likely_table(one)):
            try:
                effect = _unknown(likely, current)
                found.append(_drawn(effect, fit_and_evaluate(current.fit.model + effect, records, ())))
            except FIT_ERRORS as problem:
                undrawn = f"{r.effect.title}: {problem}"
        current = r.stage
    drawn: dict[tuple[str, str], NonparametricForce] = {}
    for s in found:
        if s is not None:  # of one curve the whole, not what is left of it beside a name
            drawn.setdefault((s.force, s.variable), s)
    return list(drawn.values()), undrawn


def _likely_table(one: Round) -> Score | None:
    """The best of the residuals as functions of one variable."""
    tables = [s for s in one.scores if s.kind is EffectKind.NONPARAMETRIC and s.name in one.passed]
    return next((s for s in tables if s.curve is not None and not s.curve.second), None)


def _drawn(effect: Effect, stage: FittedModel) -> NonparametricForce | None:
    f = stage.fit
    return shape(f.model, effect, f.model.values, f.names, f.covariance)
