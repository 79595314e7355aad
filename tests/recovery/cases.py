"""One case of the recovery study: a boat with a known truth, two missions, the diagnosis, and what came of it."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ident.diagnose import Diagnosis, diagnose
from ident.models.horizontal import horizontal
from ident.predict import Errors, free_run, pooled, ten_seconds
from ident.stage import Run, Stage
from mocks.undeclared import EFFECTS
from tests.missions import boat_with, channels_of, sail

NONE = "none"
NAMES = (NONE, *EFFECTS)
SECONDS, VALIDATION_SECONDS = 400.0, 250.0  # as in the demo
CHANNELS = ("x", "y", "psi", "r", "vx", "vy")
Row = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """An effect (or ``none``) of a size, on the boat of a seed."""

    effect: str
    seed: int
    scale: float = 1.0

    @property
    def key(self) -> str:
        """By which a case is found again among the results."""
        return f"{self.effect}/{self.seed}/{self.scale:g}"


def truth_of(case: Case) -> dict[str, float]:
    """The true parameters under ident's names."""
    true = boat_with(None, case.seed).truth()
    return {n: v for n, v in true.items() if n[:2] in ("m_", "d_")} | {
        "V_x": true["current_n"], "V_y": true["current_e"]}


def diagnose_case(case: Case) -> Diagnosis:
    """Both missions sailed, and the diagnosis of the nominal model."""
    boat = boat_with(None if case.effect == NONE else case.effect, case.seed, case.scale)
    runs = [
        Run(name, channels_of(sail(boat, seconds, mission + case.seed, run)[0]))
        for name, seconds, mission, run in (
            ("estimation", SECONDS, 100, 1), ("validation", VALIDATION_SECONDS, 200, 2))
    ]
    return diagnose(horizontal(), runs[:1], runs[1:])


def run_case(case: Case) -> Row:
    """One line of the study; a case that fails is a line too."""
    began = time.process_time()
    row: Row = asdict(case) | {"key": case.key, "code": code_state()}
    try:
        found = diagnose_case(case)
    except Exception as problem:  # the study goes on, and counts it
        return row | {"error": f"{type(problem).__name__}: {problem}"}
    row["cpu"] = round(time.process_time() - began, 2)
    return row | {
        "found": [r.effect.name for r in found.effects],
        "left": [s.name for s in found.left],
        "t": [round(r.t, 2) for r in found.effects],
        "z": z_scores(found.after, truth_of(case)),
        "before": validation_errors(found.before),
        "after": validation_errors(found.after),
    }


def z_scores(stage: Stage, truth: Mapping[str, float]) -> dict[str, float]:
    """(estimate - truth) / standard error, of the parameters that have one."""
    found = {}
    for name, true in truth.items():
        value, error = stage.fit.estimate(name)
        if np.isfinite(error):
            found[name] = round((value - true) / error, 3)
    return found


def validation_errors(stage: Stage) -> dict[str, dict[str, float]]:
    """Root mean square errors on the validation data, ten seconds ahead and free-running, by channel."""
    model, views = stage.model, stage.validation
    parts: dict[str, Sequence[Mapping[str, Errors]]] = {
        "ten_seconds": [ten_seconds(model, v.record, v.values, v.run) for v in views],
        "free_run": [free_run(model, v.record, v.values).errors for v in views],
    }
    return {
        kind: {n: float(f"{e.rms:.4g}") for n, e in pooled(list(found)).items() if n in CHANNELS}
        for kind, found in parts.items()
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
