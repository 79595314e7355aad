"""Table of docs/real-boats.md: boats of a realistic plant of other authorship, through the commands of a user.

    python -m tests.measured.real_boats [--boats a,b] [--jobs 2] [--out FILE] [--report] [--docs]

The data are under SEATRIAL_DATA/real_boats: for each boat four runs, an import map and the truth. Two runs are for
estimation, and one is for validation. Each finished boat is written as a line to the out file. An interrupted table is
resumed.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from seatrial.ident.diagnosis.certainty import NAME_RECORDS
from seatrial.ident.results.parts import DiagnosisResult, VehicleResult
from seatrial.ident.results.result_file import AnyResult, read_result
from tests.machine import slowness
from tests.measured import prediction_intervals
from tests.measured.data import import_boat, realistic_boats
from tests.recovery.cases import code_state
from tests.recovery.logged import seatrial, spent
from tests.recovery.resumable import listed, read, resume
from tests.recovery.tables import as_markdown, as_text, interval

ROOT = Path(__file__).parents[2]
OUT, DOCS = ROOT / "docs/data/real-boats.jsonl", ROOT / "docs/real-boats.md"
MASSES = ("m_u", "m_v", "m_r")
RUNS = ("run1", "run2", "run3")  # The last one is for validation.
Row = dict[str, Any]
# By the truth of the boats: effects of the catalogue in every boat, and those of each hidden effect.
# No import map has the position of the antenna, which is 3 to 27 cm from the origin.
IN_EVERY_BOAT = {"wind", "mismatch", "waves", "advance-ratio", "thrust-angle", "battery-sag", "lever-arm"}
HIDDEN = {
    "fouled_prop": {"mismatch"},
    "bent_skeg": {"yaw-bias"},
    "payload_shift": {"payload-shift"},
    "umbilical": {"towed-line"},
    "gyro_scale": {"gyro-scale"},
    "antenna_moved": {"lever-arm"},
}


TEXT = """\
# Boats with the imperfections of real boats

The boats are simulated by a plant of other authorship with the imperfections of real boats: added mass of all
directions, a skeg, a battery, gusts, waves and a turning current; fixes that are 0.13 to 0.20 s old, a compass behind
the filter of an AHRS, late and rounded telemetry, and time stamps with jitter. Most have one large effect beside these,
which no file declares; the boats `none` have only the small ones. Each boat goes through `seatrial import`,
`seatrial ident vehicle` and `seatrial ident diagnose` with two runs to estimate and one to validate.

    python -m tests.measured.real_boats --docs

{table}

*Ambiguous* means that the data do not distinguish several effects. The columns of
the masses have the error of `ident vehicle` in per cent, and in standard errors in parentheses. {held} of {kept} are
within three standard errors. *CPU s* has the CPU seconds of `ident vehicle` and `ident diagnose`, with the
compilation of models that were not in the cache. *Again* has those of a second `ident diagnose`, which finds all
models in the cache. The machine needs {slowness} times as long as the reference machine for the yardstick of
`tests/machine.py`.

## How certain a name is

seatrial states a probability with each name: the share of names with this attribution that were right on the boats of
this page and on [realistic mock boats](realistic-boats.md) together.

{certainty}

## Prediction intervals on a run that was not used

`st.fit` fits the model to two runs and validates it on the third, which widens the 95 % intervals of predictions 10 s
ahead. The table has the share of the samples of the fourth run inside them, as the mean over the boats. Each boat is
fitted with the shaft speeds of its logs, and with its commands only.

    python -m tests.measured.prediction_intervals

{intervals}

## What a diagnosis does not see here

- Wind, a small difference of the thrusters, waves and a dependence of thrust on speed are in every one of these boats.
  Where they are large enough they are found beside the effect in question, and they are no false alarm.
- A fouled propeller gives less thrust than the curve that was given. `ident vehicle` then puts the loss into the
  masses, which come out too large. The data show the difference of the sides, but not which side has lost thrust:
  the standard errors include that.
- Each thruster of these boats is turned by a degree or two, so that `thrust-angle` competes with `mismatch`. A
  difference of a few per cent is then ambiguous.
- An error of a sensor (a gyro scale, an antenna at another place) is estimated with the common errors. It is listed
  there with its size, and not as a missing effect.
"""


@dataclass(frozen=True)
class BoatCase:
    """A boat by the name of its folder.

    Attributes
    ----------
    boat
        Name of the folder.
    again
        Whether to run the diagnosis a second time, whose CPU time then contains no compilation.
    """

    boat: str
    again: bool = False

    @property
    def key(self) -> str:
        """Return the key of the boat in the results."""
        return self.boat


def run_boat(case: BoatCase) -> Row:
    """Import the logs of a boat, run `ident vehicle` and `ident diagnose`, and return its line."""
    truth = json.loads((realistic_boats() / case.boat / "truth.json").read_text(encoding="utf-8"))
    row: Row = {"key": case.boat, "hidden": truth["effect"], "code": code_state()}
    try:
        with TemporaryDirectory() as name:
            work = Path(name)
            import_boat(case.boat, RUNS, work)
            logs = (f"{RUNS[0]}.mcap", f"{RUNS[1]}.mcap", "--validate", f"{RUNS[2]}.mcap")
            begun, before = spent(), slowness()
            seatrial(work, "ident", "vehicle", *logs, "--out", "vehicle")
            fitted = spent()
            seatrial(work, "ident", "diagnose", "vehicle/model.toml", *logs, "--out", "found")
            diagnosed = spent()
            if case.again:
                seatrial(work, "ident", "diagnose", "vehicle/model.toml", *logs, "--out", "again")
                row["cpu_again"] = round(spent() - diagnosed, 1)
            vehicle, found = (read_result(work / n / "result.json") for n in ("vehicle", "found"))
            return row | {
                "vehicle": estimates(vehicle, truth["physical"]),
                "diagnosis": estimates(found, truth["physical"]),
                **answer(found),
                "cpu": [round(fitted - begun, 1), round(diagnosed - fitted, 1)],
                "slowness": round((before + slowness()) / 2, 2),
            }
    except Exception as problem:  # The table continues and counts the failure.
        return row | {"error": f"{type(problem).__name__}: {problem}"}


def estimates(result: AnyResult, truth: dict[str, float]) -> Row:
    """Return, for each mass, the error in per cent and in standard errors, and the names of the common errors."""
    assert isinstance(result, VehicleResult | DiagnosisResult)
    rows = {p.name: p for p in result.fit.parameters if p.name in MASSES}
    common = result.common_errors
    return {
        "converged": result.converged,
        "common": [] if common is None else list(common.names),
        "masses": {
            n: [round(100 * (p.value / truth[n] - 1), 1), round((p.value - truth[n]) / p.se, 2) if p.se else None]
            for n, p in rows.items()
        },
    }


def answer(result: AnyResult) -> Row:
    """Return the effects that a diagnosis found, and the change of the 10 s error on validation data."""
    assert isinstance(result, DiagnosisResult)
    change = result.prediction
    return {
        "found": [[e.name, e.attribution] for e in result.effects],
        "curves": [f"{c.force}({c.variable})" for c in result.nonparametric_effects],
        "ratio": None if change is None or change.ratio is None else [change.ratio, change.low, change.high],
        "warnings": [w.code for w in result.warnings],
    }


def table(rows: Sequence[Row]) -> list[list[str]]:
    """Return the table of all boats."""
    lines = [["boat", "hidden effect", "answer", "10 s error, after / before", *MASSES, "CPU s", "again"]]
    for row in rows:
        if "error" in row:
            lines.append([row["key"], row["hidden"], f"failed: {row['error']}", *[""] * 6])
            continue
        found = ", ".join(f"{name} ({attribution})" for name, attribution in row["found"]) or "nothing"
        ratio = "" if row["ratio"] is None else "{:.2f} ({:.2f} to {:.2f})".format(*row["ratio"])
        masses = [_error(row["vehicle"]["masses"].get(name)) for name in MASSES]
        cpu = " + ".join(f"{s:.0f}" for s in row["cpu"]), f"{row['cpu_again']:.0f}" if "cpu_again" in row else ""
        lines.append([row["key"], row["hidden"], found, ratio, *masses, *cpu])
    return lines


def _error(pair: Sequence[float | None] | None) -> str:
    """Return the error of an estimate in per cent, and in standard errors."""
    if pair is None or pair[0] is None:
        return ""
    return f"{pair[0]:+.0f} % ({pair[1]:+.1f})" if pair[1] is not None else f"{pair[0]:+.0f} %"


def certainty(rows: Sequence[Row]) -> list[list[str]]:
    """Return the table of the stated probability of names, and of the share of right names on these boats."""
    lines = [["attribution", "stated probability", "effects", "in the boat", "share", "95 % interval"]]
    for how, record in NAME_RECORDS.items():
        n, k = named(rows, how)
        shares = (f"{100 * k / n:.0f} %", interval(k, n)) if n else ("", "")
        lines.append([how, f"{100 * record.probability:.0f} %", str(n), str(k), *shares])
    return lines


def named(rows: Sequence[Row], how: str) -> tuple[int, int]:
    """Return how many effects have an attribution, and how many of these are in their boats."""
    right = [
        name in IN_EVERY_BOAT | HIDDEN.get(r["hidden"], set())
        for r in rows
        if "error" not in r
        for name, attribution in r["found"]
        if attribution == how
    ]
    return len(right), sum(right)


def document(rows: Sequence[Row]) -> str:
    """Return the text of docs/real-boats.md."""
    kept = [z for r in rows if "error" not in r for _, z in r["vehicle"]["masses"].values() if z is not None]
    held = sum(abs(z) <= 3 for z in kept)
    intervals = prediction_intervals.table([*read(prediction_intervals.OUT).values()])
    tables = {"table": table(rows), "certainty": certainty(rows), "intervals": intervals}
    slow = [r["slowness"] for r in rows if "error" not in r]
    ends = f"{min(slow):.2g} to {max(slow):.2g}"
    return TEXT.format(
        held=held, kept=len(kept), slowness=ends, **{name: as_markdown(lines) for name, lines in tables.items()}
    )


def main(words: Sequence[str] | None = None) -> int:
    """Run the missing boats, then print the table."""
    known = sorted(p.name for p in realistic_boats().glob("*") if p.is_dir())
    parser = argparse.ArgumentParser(
        "python -m tests.measured.real_boats",
        description="Boats of a realistic plant, through the commands of a user.",
        epilog="Example: python -m tests.measured.real_boats --boats asv12-fouled_prop --out build/try.jsonl",
    )
    parser.add_argument("--boats", type=listed("boat", known), default=known, help="only these")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, default=OUT, help="results, a JSON line for each boat")
    parser.add_argument("--report", action="store_true", help="run nothing, show what the out file contains")
    parser.add_argument("--docs", action="store_true", help="write docs/real-boats.md")
    arguments = parser.parse_args(words)
    if not arguments.boats and not arguments.report:
        print("there are no boats; set SEATRIAL_DATA to the folder of the measured data", file=sys.stderr)
        return 2
    if arguments.report:
        rows = [*read(arguments.out).values()]
    else:
        rows = resume([BoatCase(b, again=True) for b in arguments.boats], run_boat, line, arguments.jobs, arguments.out)
    print(as_text(table(rows)))
    if arguments.docs:
        DOCS.write_text(document(rows), encoding="utf-8")
        print(f"written: {DOCS.name}")
    return 1 if any("error" in r for r in rows) else 0


def line(row: Row) -> str:
    """Return a short description of a finished boat."""
    if "error" in row:
        return f"{row['key']}: failed: {row['error']}"
    return f"{row['key']}: {', '.join(' '.join(pair) for pair in row['found']) or 'nothing'} ({sum(row['cpu']):.0f} s)"


if __name__ == "__main__":
    sys.exit(main())
