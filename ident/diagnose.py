"""From the residual to the effect that the model lacks.

1. Fit the model with unexplained forces and sensor offsets as states.
2. Score tests of every candidate at once, specific and generic (``ident.score``).
3. Refit with the best few, everything free; compare by ``2 d ln L - df ln n``.
4. Validation data decide: the gain in log-likelihood there, block by block, has to be significant.
5. Add the effect and go round again.

Kristensen, Madsen and Jorgensen 2004; Engle 1984.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ident.candidates import Path, all_columns, variables
from ident.dataset import Record
from ident.effects import catalogue
from ident.model import Effect, Model
from ident.params import Parameter
from ident.score import Columns, Normal, Score, block_index, fitted_names, score_tests, whitened_sensitivities
from ident.shapes import Shape, shape, unknown_effect
from ident.stage import Progress, Run, Stage, make_stage, nominal, superset, validation_gain, without_absent_sensors
from ident.stage import record as make_record

Array = NDArray[np.float64]
ALPHA = 0.05  # chance that anything passes the score tests in a clean data set
P_BLOCK = 0.01  # of the version that holds for coloured innovations
# evidence that sits in few blocks caps that version; overwhelming evidence may then pass, and validation decides
P_OVERWHELMING, P_BLOCK_OVERWHELMING = 1e-12, 0.1
T_VALIDATION = 2.0
N_REFITS, N_UNKNOWN = 4, 2
# what an effect's true form has beyond ours looks like other effects, smaller by orders; those are not added
SMALL = 0.02  # of the largest gain so far


@dataclass(frozen=True)
class Refit:
    effect: Effect
    stage: Stage
    gain: float  # 2 d ln L (with priors)
    df: int
    criterion: float
    validation_gain: float  # d ln L
    t: float

    @property
    def accepted(self) -> bool:
        return self.criterion > 0 and self.t > T_VALIDATION


@dataclass(frozen=True)
class Round:
    scores: tuple[Score, ...]
    passed: tuple[str, ...]
    refits: tuple[Refit, ...]
    chosen: Refit | None
    why: str


@dataclass(frozen=True)
class Diagnosis:
    before: Stage
    after: Stage
    rounds: tuple[Round, ...]
    left: tuple[Score, ...]  # what still passes the tests at the end
    shapes: tuple[Shape, ...]

    @property
    def effects(self) -> tuple[Refit, ...]:
        return tuple(r.chosen for r in self.rounds if r.chosen is not None)


def diagnose(
    model: Model,
    estimation: Sequence[Run],
    validation: Sequence[Run],
    *,
    effects: Mapping[str, Effect] | None = None,
    max_effects: int = 3,
    rate: float = 10.0,
    progress: Progress = lambda line: None,
) -> Diagnosis:
    """What does ``model`` lack to explain the runs? ``effects``: the candidates, by default the whole catalogue.

    Raises ValueError, naming the run, where a run lacks a signal that the model needs; or the model, where it has no
    hull whose forces X, Y, N could lack anything.
    """
    if "hull" not in model.provides:
        raise ValueError(
            f"model {model.name} cannot be diagnosed: it lacks a hull with the forces X, Y and N; fit "
            "the horizontal model instead"
        )
    full = nominal(model)
    candidates = {n: e for n, e in (catalogue() if effects is None else effects).items() if full.accepts(e)}
    everything, candidates = superset(full, candidates, [*estimation, *validation])
    records = [make_record(everything, r, rate) for r in estimation]
    unseen = [make_record(everything, r, rate) for r in validation]
    full = without_absent_sensors(full, records + unseen)
    progress(f"fitting {full.name} with unexplained forces to {len(records)} run(s)")
    before = current = make_stage(full, records, unseen)
    rounds: list[Round] = []
    unknown = False
    while True:
        scores, passed = score_all(current, records, candidates)
        done = len(rounds) >= max_effects or unknown
        if done or not passed:
            break
        progress(f"round {len(rounds) + 1}: {len(passed)} of {len(scores)} candidates pass, best {passed[0].name}")
        largest = max((r.chosen.criterion for r in rounds if r.chosen is not None), default=0.0)
        one = _round(current, records, unseen, candidates, scores, passed, largest, progress)
        rounds.append(one)
        if one.chosen is None:
            break
        current, unknown = one.chosen.stage, one.chosen.effect.name.startswith("unknown")
        candidates.pop(one.chosen.effect.name, None)
    return Diagnosis(before, current, tuple(rounds), tuple(passed), tuple(_shapes(rounds)))


def score_all(
    stage: Stage, records: Sequence[Record], candidates: Mapping[str, Effect]
) -> tuple[list[Score], list[Score]]:
    """All score tests on a fitted model, best first, and those that pass; of a scanned effect the best only."""
    model = stage.model
    names = fitted_names(model, len(records))
    paths = [Path(model, v.values, r, v.run.x_pred) for r, v in zip(records, stage.estimation, strict=True)]
    seen = [variables(model, p.own, p.x) for p in paths]
    among = {name: np.concatenate([v[name] for v in seen]) for name in seen[0]}
    normal: Normal | None = None
    placed: list[tuple[Columns, list[int]]] = []
    for i, (path, view) in enumerate(zip(paths, stage.estimation, strict=True)):
        columns = all_columns(path, candidates.values(), among)
        if normal is None:
            at = len(names)
            for c in columns:
                placed.append((c, list(range(at, at + c.delta.shape[2]))))
                at += c.delta.shape[2]
            normal = Normal([str(k) for k in range(at)])
        own = [j for j, n in enumerate(names) if "@" not in n or n.endswith(f"@{i}")]
        fitted = [path.parameter(names[j].split("@")[0]) for j in own]
        delta = np.concatenate([np.stack(fitted, 2)] + [c.delta for c in columns], axis=2)
        g, e, t = whitened_sensitivities(view.run, path.own, path.jacobian, delta)
        normal.add(own + list(range(len(names), len(normal.names))), g, e, block_index(t))
    assert normal is not None
    priors = [model.parameter(n.split("@")[0]).prior for n in names]
    scores = score_tests(normal, len(names), np.array([1 / p[1] ** 2 if p else 0.0 for p in priors]), placed)
    n = sum(r.n_rows for r in records)
    scores.sort(key=lambda s: -s.criterion(n))
    first: dict[str, Score] = {}
    for s in scores:
        first.setdefault(s.name, s)
    best = list(first.values())
    n_tests = {g: sum(s.generic == g for s in scores) for g in (False, True)}
    return best, [s for s in best if _passes(s, n_tests[s.generic])]


def _passes(s: Score, n_tests: int) -> bool:
    if s.p < P_OVERWHELMING and s.p_block < P_BLOCK_OVERWHELMING:
        return True
    return s.p < ALPHA / 2 / n_tests and s.p_block < P_BLOCK


def _round(
    current: Stage,
    records: Sequence[Record],
    unseen: Sequence[Record],
    candidates: Mapping[str, Effect],
    scores: list[Score],
    passed: list[Score],
    largest: float,
    progress: Progress,
) -> Round:
    n = sum(r.n_rows for r in records)
    specific = [s for s in passed if not s.generic][:N_REFITS]
    refits = _refit_all(current, records, unseen, [(candidates[s.name], s) for s in specific], n, progress)
    best = max((r.criterion for r in refits), default=-np.inf)
    # a table competes only where no named effect comes close to what the scores promise for it
    unknown = [s for s in passed if s.generic and s.criterion(n) > max(0.5 * best, best - 50)][:N_UNKNOWN]
    drawn = [(_unknown(s, current, records), s) for s in unknown]
    refits += _refit_all(current, records, unseen, drawn, n, progress)
    refits.sort(key=lambda r: -r.criterion)
    names = tuple(s.name for s in passed)
    for r in refits[:3]:
        if r.accepted and r.criterion > max(0.25 * refits[0].criterion, SMALL * largest):
            return Round(tuple(scores), names, tuple(refits), r, _why(r))
    why = "no candidate predicts the validation data better"
    if any(r.accepted for r in refits):
        why = f"what is left is small beside what was found: {refits[0].effect.title} would gain {refits[0].gain:.0f}"
    return Round(tuple(scores), names, tuple(refits), None, why)


def _why(r: Refit) -> str:
    if r.validation_gain > 0:
        return f"the log-likelihood of the validation data rises by {r.validation_gain:.0f} (t = {r.t:.1f})"
    return f"the log-likelihood rises in most blocks of the validation data (t = {r.t:.1f}); a few outlying ones fall"


def _refit_all(
    current: Stage,
    records: Sequence[Record],
    unseen: Sequence[Record],
    tried: Sequence[tuple[Effect, Score]],
    n: int,
    progress: Progress,
) -> list[Refit]:
    def refit(pair: tuple[Effect, Score]) -> Refit | None:
        effect, score = pair
        progress(f"refitting with {effect.title}")
        start = replace(effect, parameters=tuple(_start(p, score) for p in effect.parameters))
        larger = current.fit.model + start
        try:
            stage = make_stage(larger, records, unseen)
        except (ValueError, np.linalg.LinAlgError):
            return None  # a candidate that cannot be fitted is no candidate
        gain = 2 * (stage.fit.log_posterior - current.fit.log_posterior)
        df = sum(p.free for p in effect.parameters)
        total, t = validation_gain(current, stage)
        return Refit(effect, stage, gain, df, gain - df * float(np.log(n)), total, t)

    with ThreadPoolExecutor(2) as pool:
        return [r for r in pool.map(refit, tried) if r is not None]


def _start(parameter: Parameter, score: Score) -> Parameter:
    value = score.scan.get(parameter.name, parameter.value)
    if parameter.name in score.step:
        sd = parameter.prior[1] if parameter.prior else np.inf
        value = parameter.value + float(np.clip(score.step[parameter.name], -sd, sd))
        low, high = parameter.bounds
        value = min(max(value, low), high)
    return parameter.at(value)


def _unknown(score: Score, stage: Stage, records: Sequence[Record]) -> Effect:
    force, variable = score.name.rstrip(")").split("(")
    return unknown_effect(force, variable, _span(stage, records, variable))


def _span(stage: Stage, records: Sequence[Record], variable: str) -> tuple[float, float]:
    if variable == "psi" or ", " in variable:
        return -np.pi, np.pi
    z = np.concatenate([variables(stage.model, v.record, v.run.x_filt)[variable] for v in stage.estimation])
    low, high = np.percentile(z, [1, 99])
    return float(low), float(high)


def _shapes(rounds: Sequence[Round]) -> list[Shape]:
    found = []
    for r in rounds:
        if r.chosen is not None and r.chosen.effect.name.startswith("unknown"):
            effect, stage = r.chosen.effect, r.chosen.stage
            variable = effect.name.rstrip(")").split("(")[1]
            f = stage.fit
            drawn = shape(effect, _span(stage, [], variable), f.model.values, f.names, f.covariance)
            if drawn is not None:
                found.append(drawn)
    return found


def spans(diagnosis: Diagnosis) -> dict[str, tuple[float, float]]:
    """For each unknown effect that was added, the range of its variable."""
    found = {}
    for r in diagnosis.effects:
        if r.effect.name.startswith("unknown"):
            found[r.effect.name] = _span(r.stage, [], r.effect.name.rstrip(")").split("(")[1])
    return found
