"""Value of the recommended mission: ambiguous diagnoses of realistic mock boats, before and after one more mission.

python -m tests.recovery.next_experiment --out docs/data/next-experiment.jsonl

The cases are rows of the recovery study in which the true effect is not identified, or an effect is ambiguous. For each
case, the effect and its first alternative are those that the diagnosis names. `seatrial mission design --discriminate`
designs a mission for them, and the mock boat runs it as a further estimation log. For comparison, the boat runs a mixed
mission of the same duration instead. Both logs are diagnosed like the first ones.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from seatrial.bench.mission_generators import make_mission
from seatrial.daq.config.mission_file import Mission, load_mission
from seatrial.ident.results.parts import DiagnosisResult
from seatrial.mocks.offline_simulation import simulate
from tests.missions import write_log
from tests.recovery.cases import Row, recordings_of
from tests.recovery.kinds import Case, boat_of
from tests.recovery.logged import UNCERTAIN_THRUST, diagnosed, seatrial, write_logs
from tests.recovery.verdict import answers, identified

# Diagnoses that were ambiguous, or called the true effect ambiguous, in docs/data/realistic-boats.jsonl.
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
        print(f"{case.key}: {row['verdicts']} ({time.monotonic() - began:.0f} s)", file=sys.stderr, flush=True)


def run_case(case: Case) -> Row:
    """Diagnose the boat of a case from its own missions, and with a further mission: designed, or mixed."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_logs(folder, recordings_of(case))
        first = _diagnosis(folder)
        pair = pair_to_distinguish(first)
        row: Row = {"key": case.key, "pair": pair, "diagnoses": {BEFORE: summary(first)}}
        if pair:
            words = ("--discriminate", ",".join(pair), "--duration", f"{SECONDS:g}", "--out", "next.toml")
            seatrial(folder, "mission", "design", "found/model.toml", *words)
            missions = {
                DESIGNED: load_mission(folder / "next.toml"),
                MIXED: make_mission("mixed", SECONDS, 300 + case.seed),
            }
            for kind, mission in missions.items():
                _run_mission(case, mission, folder / f"{kind}.mcap")
                row["diagnoses"][kind] = summary(_diagnosis(folder, f"{kind}.mcap", out=kind))
        row["verdicts"] = {
            when: verdict({"effect": case.effect, "seed": case.seed, "kind": case.kind} | found)
            for when, found in row["diagnoses"].items()
        }
        return row


def pair_to_distinguish(result: DiagnosisResult) -> tuple[str, str] | None:
    """Return the first ambiguous effect for which an alternative is named, and that alternative; None without one."""
    for effect in result.effects:
        if effect.attribution == "ambiguous" and effect.not_excluded:
            return effect.name, effect.not_excluded[0]
    return None


def summary(result: DiagnosisResult) -> Row:
    """Return names, attributions and alternatives of the effects of a diagnosis."""
    return {
        "found": [e.name for e in result.effects],
        "attribution": [e.attribution for e in result.effects],
        "not_excluded": [list(e.not_excluded) for e in result.effects],
        "reasons": [list(e.reasons) for e in result.effects],
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
