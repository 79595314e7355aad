"""Value of the recommended mission: ambiguous diagnoses of realistic mock boats, before and after one more mission.

python -m tests.recovery.next_experiment --out docs/data/next-experiment.jsonl

The cases are rows of the recovery study in which the true effect is not identified, or an effect is ambiguous. For each
case, the effect and its first alternative are those that the diagnosis names. `seatrial mission design --discriminate`
designs a mission for them, and the mock boat runs it as a further estimation log. For comparison, the boat runs a mixed
mission of the same duration instead. Both logs are diagnosed like the first ones. The lines have the probability of the
right name that is expected before the further mission, and that which the diagnosis states after it.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from seatrial.bench.mission_generators import make_mission
from seatrial.daq.config.mission_file import Mission, load_mission
from seatrial.ident.diagnosis.certainty import NAME_RECORDS
from seatrial.ident.diagnosis.policy import DEFAULT_POLICY
from seatrial.ident.experiment_design.discrimination import separation
from seatrial.ident.numerics import normal_cdf
from seatrial.ident.results.commands import DesignResult
from seatrial.ident.results.parts import DiagnosisResult
from seatrial.ident.results.result_file import read_result
from seatrial.ident.workflows.design import DesignRequest, make_task
from seatrial.mocks.offline_simulation import simulate
from tests.missions import write_log
from tests.recovery.cases import Row, code_state, recordings_of
from tests.recovery.kinds import SECONDS as DURATION
from tests.recovery.kinds import Case, boat_of
from tests.recovery.logged import UNCERTAIN_THRUST, diagnosed, seatrial, write_logs
from tests.recovery.verdict import answers, identified

# Diagnoses that were ambiguous, or called the true effect ambiguous, when docs/data/next-experiment.jsonl was made.
CASES = (
    Case("thrust-angle", 41, "realistic"),
    Case("current-drift", 41, "realistic"),
    Case("propeller-walk", 41, "realistic-double"),
    Case("shallow-water", 41, "realistic-double"),
    Case("yaw-bias", 41, "realistic-double"),
)
SECONDS = 250.0
BEFORE, DESIGNED, MIXED = "before", "designed", "mixed"


def main(words: Sequence[str] | None = None) -> None:
    """Run the cases that the file does not contain yet, and append one line for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, required=True, help="JSON lines; finished cases are not run again")
    options = parser.parse_args(words)
    lines = options.out.read_text().splitlines() if options.out.exists() else []
    done = {json.loads(line)["key"] for line in lines}
    for case in CASES:
        if case.key in done:
            continue
        began = time.monotonic()
        row = run_case(case)
        with options.out.open("a") as file:
            file.write(json.dumps(row) + "\n")
        print(
            f"{case.key}: {row['verdicts']}, expected {row.get('expected')} ({time.monotonic() - began:.0f} s)",
            file=sys.stderr,
            flush=True,
        )


def run_case(case: Case) -> Row:
    """Diagnose the boat of a case from its own missions, and with a further mission: designed, or mixed."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_logs(folder, recordings_of(case))
        first = _diagnosis(folder)
        pair = pair_to_distinguish(first)
        row: Row = {"key": case.key, "code": code_state(), "pair": pair, "diagnoses": {BEFORE: summary(first)}}
        if pair:
            words = ("--discriminate", ",".join(pair), "--duration", f"{SECONDS:g}", "--out", "next.toml")
            seatrial(folder, "mission", "design", "found/model.toml", *words)
            design = read_result(folder / "next.json")
            assert isinstance(design, DesignResult)
            assert design.apart is not None
            row["sizes"] = {size.effect: size.origin for size in design.apart.sizes}
            missions = {
                DESIGNED: load_mission(folder / "next.toml"),
                MIXED: make_mission("mixed", SECONDS, 300 + case.seed),
            }
            row["T"] = {DESIGNED: design.apart.if_first, MIXED: separation_of(folder, pair, missions[MIXED])}
            row["expected"] = {kind: expected_probability(first, pair, T) for kind, T in row["T"].items()}
            for kind, mission in missions.items():
                _run_mission(case, mission, folder / f"{kind}.mcap")
                row["diagnoses"][kind] = summary(_diagnosis(folder, f"{kind}.mcap", out=kind))
        row["verdicts"] = {
            when: verdict({"effect": case.effect, "seed": case.seed, "kind": case.kind} | found)
            for when, found in row["diagnoses"].items()
        }
        return row


def separation_of(folder: Path, pair: tuple[str, str], mission: Mission) -> float:
    """Return the criterion T of a mission, if the first effect of the pair is true and the second is fitted."""
    task, (a, b) = make_task(str(folder / "found/model.toml"), DesignRequest(duration=SECONDS, between=pair))
    t, n = mission.setpoints()
    rows = np.maximum(np.searchsorted(t, task.t + 1e-9, side="right") - 1, 0)
    return separation(a.model, b.model, task, np.asarray(n)[rows])[1]


def expected_probability(result: DiagnosisResult, pair: tuple[str, str], T: float) -> float:
    """Return the expected probability of the name of the first effect after a mission, if the effect is in the boat.

    Twice the log-likelihood ratio against the second effect is normal with mean T and variance 4 T. The name becomes
    identified if the lead in the criterion, that of the diagnosis included, exceeds the limit of the diagnosis. The
    probability of a name is that which the diagnosis states, for an identified or an ambiguous one. Differences between
    the models and the boat are left out.
    """
    lead, limit = lead_of(result, pair), competitor_limit(result, pair[0])
    share = float(normal_cdf((lead + T - limit) / (2.0 * math.sqrt(T))))
    sure, unsure = (NAME_RECORDS[how].probability for how in ("identified", "ambiguous"))
    return round(unsure + (sure - unsure) * share, 4)


def lead_of(result: DiagnosisResult, pair: tuple[str, str]) -> float:
    """Return the criterion of the first effect less that of the second one; 0 if no round has refits of both."""
    for search_round in result.rounds:
        criteria = {r.name: r.criterion for r in search_round.refits}
        if set(pair) <= set(criteria) and search_round.chosen == pair[0]:
            return criteria[pair[0]] - criteria[pair[1]]
    return 0.0


def competitor_limit(result: DiagnosisResult, name: str) -> float:
    """Return the lead in the criterion from which a competing model is excluded, with a further mission of 250 s.

    The gain of the effect is taken as proportional to the length of the data.
    """
    criteria = [r.criterion for rounds in result.rounds for r in rounds.refits if r.name == name == rounds.chosen]
    longer = (DURATION + SECONDS) / DURATION
    return max(DEFAULT_POLICY.max_distance, DEFAULT_POLICY.max_distance_share * longer * max(criteria, default=0.0))


def pair_to_distinguish(result: DiagnosisResult) -> tuple[str, str] | None:
    """Return the first ambiguous effect for which an alternative is named, and that alternative; None without one."""
    for effect in result.effects:
        if effect.attribution == "ambiguous" and effect.not_excluded:
            return effect.name, effect.not_excluded[0]
    return None


def summary(result: DiagnosisResult) -> Row:
    """Return names, attributions, stated probabilities and alternatives of the found effects, and the warnings."""
    return {
        "found": [e.name for e in result.effects],
        "attribution": [e.attribution for e in result.effects],
        "probability": [e.probability for e in result.effects],
        "not_excluded": [list(e.not_excluded) for e in result.effects],
        "reasons": [list(e.reasons) for e in result.effects],
        "warnings": [w.code for w in result.warnings],
    }


def verdict(row: Row) -> str:
    """Return whether the true effect is identified, ambiguous or not found."""
    if identified(row):
        return "identified"
    return "ambiguous" if set(answers(row)) & set(row["found"]) else "not found"


def _diagnosis(folder: Path, *further: str, out: str = "found") -> DiagnosisResult:
    """Return the diagnosis of the logs of the folder, with further estimation logs."""
    result, _ = diagnosed(folder, UNCERTAIN_THRUST, further, out)
    assert isinstance(result, DiagnosisResult)
    return result


def _run_mission(case: Case, mission: Mission, path: Path) -> None:
    """Simulate the boat of a case on a mission, and write its log. The run has noise and gusts of its own."""
    t, n = mission.setpoints()
    write_log(path, "boat", simulate(boat_of(case), t, np.asarray(n), mission.end, 3).readings)


if __name__ == "__main__":
    main()
