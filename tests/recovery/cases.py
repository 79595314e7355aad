"""Cases of the recovery study: a boat with known truth, two missions, the diagnosis, and its evaluation."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from seatrial.bench.mission_generators import make_mission
from seatrial.ident.data.record import LogSegment
from seatrial.ident.diagnosis.findings import Diagnosis
from seatrial.ident.diagnosis.search import diagnose, evaluate_diagnosis
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.fitted_model import FittedModel
from seatrial.ident.results.diagnosis import GivenModel, diagnosis_result
from seatrial.ident.results.parts import DiagnosisResult, ParameterRow
from seatrial.ident.results.tables import provenance
from seatrial.ident.validation.prediction_errors import (
    PredictionErrors,
    horizon_errors,
    one_step_errors,
    pooled_errors,
    simulation_run,
)
from seatrial.mocks.offline_simulation import Recording, simulate
from tests.missions import boat_with, channels_of
from tests.recovery.kinds import Case, boat_of, model_of, with_gaps
from tests.recovery.logged import THRUST, UNCERTAIN_THRUST, diagnosed, write_logs
from tests.recovery.oracle import dominance, oracle, shape_share

CHANNELS = ("x", "y", "psi", "r", "vx", "vy")
Row = dict[str, Any]
AllErrors = dict[str, dict[str, PredictionErrors]]


def truth_of(case: Case) -> dict[str, float]:
    """Return the true parameters by the names of ident."""
    return named_truth(boat_with(None, case.seed).truth())


def named_truth(true: Mapping[str, float]) -> dict[str, float]:
    """Return the true parameters of a simulated boat by the names of ident, and as ratios to its full forward thrust
    and arm.
    """
    hull = {n: v for n, v in true.items() if n[:2] in ("m_", "d_")}
    thrust = true["c1"] + true["c2"]
    ratios = {f"{n}/T": v / thrust for n, v in hull.items()}
    ratios |= {f"{n}/(T y_arm)": v / (thrust * true["arm"]) for n, v in hull.items()}
    return hull | ratios | {"V_x": true["current_n"], "V_y": true["current_e"]}


def recordings_of(case: Case, seconds: tuple[float, float] | None = None) -> list[Recording]:
    """Simulate the estimation mission and the validation mission. Their duration is that of the kind, or `seconds`."""
    boat, how = boat_of(case), case.how
    found = []
    for lasts, mission_seed, run in zip(seconds or how.seconds, (100, 200), (1, 2), strict=True):
        t, n = make_mission("mixed", lasts, mission_seed + case.seed).setpoints()
        found.append(simulate(boat, t, how.gain * np.asarray(n), lasts, run))
    return found


def runs_of(case: Case, seconds: tuple[float, float] | None = None) -> list[LogSegment]:
    """Return both missions as log segments in memory."""
    runs = []
    recordings = recordings_of(case, seconds)
    for name, run, recording in zip(("estimation", "validation"), (1, 2), recordings, strict=True):
        channels = channels_of(recording)
        runs.append(LogSegment(name, with_gaps(channels, 10 * case.seed + run) if case.how.gaps else channels))
    return runs


def diagnose_case(case: Case, runs: Sequence[LogSegment] | None = None) -> Diagnosis:
    """Return the diagnosis of the nominal model on both missions."""
    runs = runs_of(case) if runs is None else runs
    effects = {n: e for n, e in catalogue().items() if n != case.effect} if case.how.left_out else None
    return diagnose(model_of(case), runs[:1], runs[1:], effects=effects)


def run_case(case: Case) -> Row:
    """Run a case and return its line of the study. A failed case also gives a line."""
    row: Row = asdict(case) | {"key": case.key, "code": code_state()}
    try:
        if not case.how.logged:
            began = time.process_time()
            runs = runs_of(case)
            result = result_of(diagnose_case(case, runs))
            return row | {"cpu": round(time.process_time() - began, 2)} | recorded(result) | judged(case, runs, result)
        with TemporaryDirectory() as folder:
            runs = write_logs(Path(folder), recordings_of(case))
            read, cpu = diagnosed(Path(folder), UNCERTAIN_THRUST if case.how.realistic else THRUST)
            assert isinstance(read, DiagnosisResult)
            return row | {"cpu": round(cpu, 2)} | recorded(read) | judged(case, runs, read)
    except Exception as problem:  # The study continues and counts the failure.
        return row | {"error": f"{type(problem).__name__}: {problem}"}


def result_of(found: Diagnosis) -> DiagnosisResult:
    """Return the result as `seatrial ident diagnose` reports it."""
    made = provenance([], "")
    return diagnosis_result(found, evaluate_diagnosis(found), made, warnings=(), notes=(), given=GivenModel("MODEL"))


def recorded(result: DiagnosisResult) -> Row:
    """Return the contents of the diagnosis that the study records."""
    effects = result.effects
    t = {q.name: q.t for search_round in result.rounds for q in search_round.refits if q.name == search_round.chosen}
    return {
        "found": [e.name for e in effects],
        "attribution": [e.attribution for e in effects],
        "not_excluded": [list(e.not_excluded) for e in effects],
        "reasons": [list(e.reasons) for e in effects],
        "error_ratio_without": [round(e.error_ratio_without or math.nan, 3) for e in effects],
        "t": [round(t[e.name], 2) for e in effects],
        "nonparametric_effects": [f"{s.force}({s.variable})" for s in result.nonparametric_effects],
        "remaining_candidates": [s.name for s in result.remaining_candidates],
        "answer": result.answer,
    }


def judged(case: Case, runs: Sequence[LogSegment], result: DiagnosisResult) -> Row:
    """Return the quality of a diagnosis: errors on validation data against those of the true structure, estimates, and
    curves.
    """
    table = result.errors.validation
    assert table is not None
    both = {"horizon": table.horizon, "simulation": table.simulation}
    row: Row = {
        "z": z_scores(result.fit.parameters, truth_of(case)),
        "before": rms(both, lambda cell: cell.before),
        "after": rms(both, lambda cell: cell.after),
    }
    best = None
    if {e.name for e in result.effects} == set(case.truths):
        best = row["after"]  # If the true structure was found, the result equals the oracle.
    elif not case.how.realistic:  # The true structure of a realistic boat has effects that the catalogue lacks.
        true = oracle(case, runs)
        best = None if true is None else rms(errors(true), lambda e: e.rms)
    if best is not None:
        row |= {"oracle": best, "ratio": ratio(row["after"], best)}
    if case.how.realistic and (large := dominance(case, runs)) is not None:
        without, fitted = (rms(errors(model), lambda e: e.rms) for model in large)
        row["dominance"] = ratio(without, fitted)["horizon"]
    share = shape_share(case, result.nonparametric_effects)
    return row if share is None else row | {"shape": round(share, 3)}


def z_scores(parameters: Sequence[ParameterRow], truth: Mapping[str, float]) -> dict[str, float]:
    """Return (estimate - truth) / standard error of the parameters of the estimation log that have an error."""
    found: dict[str, float] = {}
    for p in parameters:
        if p.name in truth and p.se is not None:
            found.setdefault(p.name.partition("/")[0], round((p.value - truth[p.name]) / p.se, 3))
    return found


def errors(fitted: FittedModel) -> AllErrors:
    """Return prediction errors on the validation data by horizon and channel."""
    model, views = fitted.model, fitted.validation
    return {
        "one_step": pooled_errors([one_step_errors(model, v.record, v.run) for v in views]),
        "horizon": pooled_errors(
            [horizon_errors(model, v.record, v.values, v.run.x_filt, model.horizon) for v in views]
        ),
        "simulation": pooled_errors([dict(simulation_run(model, v.record, v.values).errors) for v in views]),
    }


def rms(table: Mapping[str, Mapping[str, Any]], of: Callable[[Any], float]) -> dict[str, dict[str, float]]:
    """Return root mean squares of the compared channels, over the horizon and in simulation. ``of`` selects the value
    of a table cell.
    """
    return {
        kind: {n: float(f"{of(cell):.4g}") for n, cell in table[kind].items() if n in CHANNELS}
        for kind in ("horizon", "simulation")
    }


def ratio(after: Mapping[str, Mapping[str, float]], best: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Return, by horizon, the geometric mean over channels of the error divided by that of the oracle."""
    return {
        kind: round(float(np.exp(np.mean([np.log(after[kind][n] / e) for n, e in rows.items()]))), 4)
        for kind, rows in best.items()
    }


@cache
def code_state() -> str:
    """Return a hash of all code that a result depends on. Results with different hashes are not comparable."""
    root = Path(__file__).parents[2]
    digest = hashlib.sha256()
    for folder in ("ident", "mocks", "bench", "tests/recovery"):
        for path in sorted((root / folder).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]
