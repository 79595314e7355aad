"""One case of the recovery study: a boat with a known truth, two missions, the diagnosis, and what came of it."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from bench.plans import make_mission
from ident.diagnose import diagnose
from ident.diagnosis_result import answer
from ident.effects import catalogue
from ident.findings import Diagnosis
from ident.judged import before_after
from ident.predict import Errors, free_run, one_step, pooled, ten_seconds
from ident.stage import Run, Stage
from mocks.offline import simulate
from tests.missions import boat_with, channels_of
from tests.recovery.kinds import Case, boat_of, model_of, with_gaps
from tests.recovery.oracle import oracle, shape_share

CHANNELS = ("x", "y", "psi", "r", "vx", "vy")
Row = dict[str, Any]
AllErrors = dict[str, dict[str, Errors]]


def truth_of(case: Case) -> dict[str, float]:
    """The true parameters under ident's names."""
    true = boat_with(None, case.seed).truth()
    return {n: v for n, v in true.items() if n[:2] in ("m_", "d_")} | {
        "V_x": true["current_n"], "V_y": true["current_e"]}


def runs_of(case: Case) -> list[Run]:
    """The estimation mission and the validation mission, sailed."""
    boat, how = boat_of(case), case.how
    runs = []
    for name, seconds, mission_seed, run in zip(("estimation", "validation"), how.seconds, (100, 200), (1, 2),
                                                strict=True):
        t, n = make_mission("mixed", seconds, mission_seed + case.seed).setpoints()
        channels = channels_of(simulate(boat, t, how.gain * np.asarray(n), seconds, run))
        runs.append(Run(name, with_gaps(channels, 10 * case.seed + run) if how.gaps else channels))
    return runs


def diagnose_case(case: Case, runs: Sequence[Run] | None = None) -> Diagnosis:
    """The diagnosis of the nominal model on both missions."""
    runs = runs_of(case) if runs is None else runs
    effects = {n: e for n, e in catalogue().items() if n != case.effect} if case.how.left_out else None
    return diagnose(model_of(case), runs[:1], runs[1:], effects=effects)


def run_case(case: Case) -> Row:
    """One line of the study; a case that fails is a line too."""
    began = time.process_time()
    row: Row = asdict(case) | {"key": case.key, "code": code_state()}
    try:
        runs = runs_of(case)
        found = diagnose_case(case, runs)
        row["cpu"] = round(time.process_time() - began, 2)
        return row | told(found) | judged(case, runs, found)
    except Exception as problem:  # the study goes on, and counts it
        return row | {"error": f"{type(problem).__name__}: {problem}"}


def told(found: Diagnosis) -> Row:
    """What the diagnosis says."""
    return {
        "found": row_names(found),
        "certainty": [j.certainty for j in found.judgements],
        "rivals": [list(j.rivals) for j in found.judgements],
        "reasons": [list(j.reasons) for j in found.judgements],
        "shapes": [f"{s.force}({s.variable})" for s in found.shapes],
        "left": [s.name for s in found.left],
        "t": [round(r.t, 2) for r in found.effects],
    }


def judged(case: Case, runs: Sequence[Run], found: Diagnosis) -> Row:
    """How good that is: errors on validation data against those of the true structure, estimates, shapes."""
    before, after = errors(found.before), errors(found.after)
    rows = before_after(before, after, found.after.model)
    row: Row = {
        "answer": answer(found, rows, "validation"),
        "z": z_scores(found.after, truth_of(case)),
        "before": rms(before),
        "after": rms(after),
    }
    # with the true structure found, the answer is the oracle
    true = found.after if set(row_names(found)) == set(case.truths) else oracle(case, runs)
    if true is not None:
        best = row["after"] if true is found.after else rms(errors(true))
        row |= {"oracle": best, "ratio": ratio(row["after"], best)}
    share = shape_share(case, found)
    return row if share is None else row | {"shape": round(share, 3)}


def row_names(found: Diagnosis) -> list[str]:
    """The effects that were added, in their order."""
    return [r.effect.name for r in found.effects]


def z_scores(stage: Stage, truth: Mapping[str, float]) -> dict[str, float]:
    """(estimate - truth) / standard error, of the parameters that have one."""
    found = {}
    for name, true in truth.items():
        value, error = stage.fit.estimate(name)
        if np.isfinite(error):
            found[name] = round((value - true) / error, 3)
    return found


def errors(stage: Stage) -> AllErrors:
    """Prediction errors on the validation data by horizon and channel."""
    model, views = stage.model, stage.validation
    return {
        "one_step": pooled([one_step(model, v.record, v.run) for v in views]),
        "ten_seconds": pooled([ten_seconds(model, v.record, v.values, v.run) for v in views]),
        "free_run": pooled([dict(free_run(model, v.record, v.values).errors) for v in views]),
    }


def rms(found: AllErrors) -> dict[str, dict[str, float]]:
    """Root mean squares of the channels that are compared, ten seconds ahead and free-running."""
    return {
        kind: {n: float(f"{e.rms:.4g}") for n, e in found[kind].items() if n in CHANNELS}
        for kind in ("ten_seconds", "free_run")
    }


def ratio(after: Mapping[str, Mapping[str, float]], best: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """By horizon, the geometric mean over channels of the error over the oracle's."""
    return {
        kind: round(float(np.exp(np.mean([np.log(after[kind][n] / e) for n, e in rows.items()]))), 4)
        for kind, rows in best.items()
    }


@cache
def code_state() -> str:
    """A hash of everything that a result depends on: results of another state are not comparable."""
    root = Path(__file__).parents[2]
    digest = hashlib.sha256()
    for folder in ("ident", "mocks", "bench", "tests/recovery"):
        for path in sorted((root / folder).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]
