"""Recovery study on other rigs than the default rig of the mocks, and on independent plants.

    python -m tests.recovery.rigs [--rigs vesc,ekf] [--effects none,wind] [--seeds N] [--seed S] [--jobs 2]
                                  [--out FILE] [--report] [--docs] [--again N]

Each case is another boat with one effect or none, logged by the rig (`rig_logs`). Two user commands analyse it:
`seatrial ident vehicle` and `seatrial ident diagnose`. Only their result files are evaluated. Each finished case is
written as a line to the out file. An interrupted study is resumed.

The study of all effects takes many hours. Its cases are kept in `docs/data/rigs-effects.jsonl`, those of clean boats in
`rigs-clean.jsonl` and those of plants in `rigs-plants.jsonl` in the same folder. --out resumes from such a file. --docs
writes the sections that have cases and keeps the others. Some kept cases are of an older code state: --again N draws N
cases of the out file, repeats them into a file beside it (`rigs-effects-again.jsonl`), and reports changed verdicts.
"""

from __future__ import annotations

import argparse
import os
import random
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from zlib import crc32

import numpy as np

from seatrial.ident.effects import catalogue
from seatrial.ident.results.parts import DiagnosisResult, VehicleResult
from seatrial.ident.results.result_file import read_result
from seatrial.mocks.hidden_effects.catalogue import DEMO, EFFECTS, OUTSIDE
from seatrial.mocks.plant.boat import Boat
from tests.recovery import tables
from tests.recovery.cases import Row, code_state, named_truth, z_scores
from tests.recovery.kinds import NONE
from tests.recovery.logged import seatrial, spent
from tests.recovery.resumable import listed, read, resume
from tests.recovery.rig_logs import PLANTS, RIGS, Plant

OUT = Path("build/rigs.jsonl")
DOCS = Path(__file__).parents[2] / "docs" / "recovery.md"
CHOSEN = (NONE, *DEMO, "tether", "delay", "lag", "reverse-thrust")


@dataclass(frozen=True)
class RigCase:
    """Case of the study: an effect (or ``none``) on the boat of a seed, logged by one of RIGS, or one of PLANTS.

    A plant has no seed.
    """

    rig: str
    effect: str
    seed: int

    @property
    def key(self) -> str:
        """Return the key of the case in the results."""
        return f"{self.rig}/{self.effect}/{self.seed}"

    @property
    def boat_seed(self) -> int:
        """Return the seed of the boat and its noise. No two cases share a boat, so their verdicts are independent."""
        return 100_000 * self.seed + crc32(f"{self.rig}/{self.effect}".encode()) % 100_000


def cases_of(rigs: Sequence[str], effects: Sequence[str], seed: int, seeds: int) -> list[RigCase]:
    """Return the cases ordered by seed and mixed within each seed, so that a stopped study covers all kinds.

    Effects that a rig cannot measure are left out.
    """
    found = [
        RigCase(rig, effect, s)
        for s in range(seed, seed + seeds)
        for effect in effects
        for rig in rigs
        if rig in RIGS and effect not in RIGS[rig].blind
    ]
    found.sort(key=lambda case: (case.seed, crc32(case.key.encode())))
    return [*(RigCase(name, PLANTS[name].effect, 0) for name in rigs if name in PLANTS), *found]


def run_case(case: RigCase) -> Row:
    """Run a case and return its line of the study. A failed case also gives a line."""
    row: Row = {"key": case.key, "rig": case.rig, "effect": case.effect, "seed": case.seed, "code": code_state()}
    row |= {"boat": case.boat_seed}
    before, began = spent(), time.monotonic()
    try:
        with TemporaryDirectory() as folder:
            row |= _plant(PLANTS[case.rig], Path(folder)) if case.rig in PLANTS else _boat(case, Path(folder))
    except Exception as problem:  # The study continues and counts the failure.
        row |= {"error": f"{type(problem).__name__}: {problem}"}
    return row | {"cpu": round(spent() - before, 1), "seconds": round(time.monotonic() - began, 1)}


def _boat(case: RigCase, folder: Path) -> Row:
    rig = RIGS[case.rig]
    boat = rig.boat(None if case.effect == NONE else case.effect, case.boat_seed)
    with_effects = bool(rig.there or rig.payload)
    row = _identified(folder, *rig.sail(boat, folder), rig.options(boat), judged_with_effects=with_effects)
    # The payload of each run is relative to the mean.
    load = float(np.mean(rig.payload[: len(rig.estimation)])) if rig.payload else 0.0
    truth = truth_of(replace(boat, hull=replace(boat.hull, mass=boat.hull.mass + load)))
    return row | {"z": z_scores(row.pop("fit").parameters, truth)}


def _plant(plant: Plant, folder: Path) -> Row:
    estimation, validation = plant.logs(folder)
    row = _identified(folder, estimation, validation, plant.options, diagnose=plant.diagnosed)
    return row | {"z": z_scores(row.pop("fit").parameters, plant.truth())}


def _identified(
    folder: Path,
    estimation: Sequence[Path],
    validation: Sequence[Path],
    options: Sequence[str],
    diagnose: bool = True,
    judged_with_effects: bool = False,
) -> Row:
    """Return the outputs of the two commands and the fit of the first.

    If every log has an effect that the catalogue of the first command lacks, return the fit of the second.
    """
    logs = [p.name for p in estimation] + [w for p in validation for w in ("--validate", p.name)]
    seatrial(folder, "ident", "vehicle", *logs, *options, "--out", "vehicle")
    vehicle = read_result(folder / "vehicle" / "result.json")
    assert isinstance(vehicle, VehicleResult)
    row: Row = {"vehicle": vehicle.answer, "warnings": [w.text for w in vehicle.warnings], "fit": vehicle.fit}
    row["converged"] = vehicle.fit.converged
    if not diagnose:
        return row | {"found": [], "attribution": [], "not_excluded": [], "answer": vehicle.answer}
    seatrial(folder, "ident", "diagnose", "vehicle/model.toml", *logs, "--out", "found")
    found = read_result(folder / "found" / "result.json")
    assert isinstance(found, DiagnosisResult)
    return (
        row
        | ({"fit": found.fit} if judged_with_effects else {})
        | {
            "found": [e.name for e in found.effects],
            "attribution": [e.attribution for e in found.effects],
            "not_excluded": [list(e.not_excluded) for e in found.effects],
            "answer": found.answer,
        }
    )


def truth_of(boat: Boat) -> dict[str, float]:
    """Return the true parameters by the names of ident."""
    return named_truth(boat.truth())


# Verdicts of a line.

RIGHT, FALSE_ALARM = "no effect, correctly", "false alarm"
NAMED, LIKENED, DRAWN = "identified", "ambiguous", "nonparametric"
MISSED, OTHER, WRONG, FAILED = "missed", "other effects, ambiguous", "wrong, identified", "failed"
LACK_WORDS = (NAMED, LIKENED, DRAWN, MISSED, OTHER, WRONG, FAILED)


@cache
def _own_names() -> dict[str, str]:
    """Return a map from the names of the catalogue to the shortest name of the same effect.

    Some models have another form of an effect. Both forms have the same first parameter.
    """
    by_length = sorted((e for e in catalogue().values() if e.parameters), key=lambda e: len(e.name))
    shortest: dict[str, str] = {}
    return {e.name: shortest.setdefault(e.parameters[0].name, e.name) for e in by_length}


def verdict(row: Row) -> str:
    """Return one of the verdicts above. A clean boat is right only if no effect is found, whatever its attribution."""
    if "error" in row:
        return FAILED
    rig = RIGS.get(row["rig"])
    own = _own_names() | dict(rig.called if rig else {})
    row = row | {"found": [own.get(n, n) for n in row["found"]]}
    row["not_excluded"] = [[own.get(n, n) for n in names] for names in row["not_excluded"]]
    there = {row["effect"], *(rig.brings.get(row["effect"], ()) if rig else PLANTS[row["rig"]].there)}
    found = [name for name in row["found"] if not _expected(row, name)]
    if row["effect"] == NONE:
        return RIGHT if not set(found) - there else FALSE_ALARM
    if not found:
        return MISSED
    sure = [n for n, how in zip(row["found"], row["attribution"], strict=True) if how == "identified"]
    if set(sure) - there - {n for n in sure if _expected(row, n)}:
        return WRONG
    if row["effect"] in sure:
        return NAMED
    like = {row["found"][k] for k, how in enumerate(row["attribution"]) if how == "ambiguous"}
    like |= {name for k, how in enumerate(row["attribution"]) if how == "ambiguous" for name in row["not_excluded"][k]}
    if row["effect"] in like:
        return LIKENED
    return DRAWN if row["attribution"][0] == "nonparametric" else OTHER


def _expected(row: Row, name: str) -> bool:
    """Return whether an effect is expected: a difference between runs if the payload differs, or an effect of the rig
    itself.
    """
    own = RIGS[row["rig"]].there if row["rig"] in RIGS else frozenset[str]()
    return name in own or (row["rig"] == "payload" and name.startswith("between-runs:"))


# Tables.

WIDTH, IN_INTERVAL = 1.96, "truth in the 95 % interval"  # Half of a 95 % interval in standard errors.
CLEAN, LACKING, OTHERS = "Clean boats", "Boats with one effect", "Plants by other authors"


def sections(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the cases of each section that has cases."""
    found: dict[str, list[Row]] = {CLEAN: [], LACKING: [], OTHERS: []}
    for r in rows:
        found[OTHERS if r["rig"] in PLANTS else CLEAN if r["effect"] == NONE else LACKING].append(r)
    return {title: own for title, own in found.items() if own}


def report(rows: Sequence[Row], form: Callable[[tables.Lines], str]) -> str:
    """Return the tables of one section: the requirements, then by rig and by effect, and the failures."""
    head = "### " if form is tables.as_markdown else ""
    boats, others = [r for r in rows if r["rig"] in RIGS], [r for r in rows if r["rig"] in PLANTS]
    parts = [
        ("Requirements", asked(boats)),
        ("By rig", by_rig(boats)),
        ("By effect, over all rigs that can measure it", by_effect(boats)),
        ("Parameters", parameters(boats)),
        ("What was found", plants(others)),
        ("What failed", failures(rows)),
    ]
    return "\n\n".join(f"{head}{title}\n\n{form(lines)}" for title, lines in parts if len(lines) > 1)


def asked(rows: Sequence[Row]) -> tables.Lines:
    """Return shares over all rigs with 95 % intervals and requirements. A failed case counts as a miss."""
    clean = [verdict(r) for r in rows if r["effect"] == NONE]
    lacking = [verdict(r) for r in rows if r["effect"] != NONE]
    z = _z(rows)
    lines = [
        ("false alarms on clean boats", sum(w != RIGHT for w in clean), len(clean), "<=", 0.02),
        ("true effects identified or ambiguous", sum(w in (NAMED, LIKENED) for w in lacking), len(lacking), ">=", 0.90),
        ("a wrong effect identified", lacking.count(WRONG), len(lacking), "<=", 0.02),
        ("clean estimates within three standard errors", int(np.sum(np.abs(z) <= 3)), z.size, ">=", 0.99),
        (
            "95 % intervals of clean estimates that contain the truth",
            int(np.sum(np.abs(z) <= WIDTH)),
            z.size,
            ">=",
            0.93,
        ),
    ]
    table = [["share", "required", "found", "95 % interval", "cases", "met"]]
    lines += _worst_rigs(rows)
    for description, k, n, sign, limit in lines:
        if n:
            met = k / n >= limit if sign == ">=" else k / n <= limit
            table.append(
                [
                    description,
                    f"{sign} {limit:.0%}",
                    f"{k / n:.1%}",
                    tables.interval(k, n),
                    f"{k}/{n}",
                    "yes" if met else "no",
                ]
            )
    return table


def _worst_rigs(rows: Sequence[Row]) -> list[tuple[str, int, int, str, float]]:
    """Return the same shares of clean boats on the worst rig of each."""
    alarms, within = list[tuple[str, int, int]](), list[tuple[str, int, int]]()
    for rig in dict.fromkeys(r["rig"] for r in rows if r["effect"] == NONE):
        own = [r for r in rows if r["rig"] == rig and r["effect"] == NONE]
        alarms.append((rig, sum(verdict(r) != RIGHT for r in own), len(own)))
        z = _z(own)
        within += [(rig, int(np.sum(np.abs(z) <= 3)), z.size)] if z.size else []
    lines = []
    if alarms:
        rig, k, n = max(alarms, key=lambda found: found[1] / found[2])
        lines.append((f"false alarms on the worst rig ({rig})", k, n, "<=", 0.05))
    if within:
        rig, k, n = min(within, key=lambda found: found[1] / found[2])
        lines.append((f"clean estimates within three standard errors on the worst rig ({rig})", k, n, ">=", 0.99))
    return lines


def by_rig(rows: Sequence[Row]) -> tables.Lines:
    """Return a table with one line per rig, of its clean boats or of those with an effect."""
    clean = any(r["effect"] == NONE for r in rows)
    of_clean = ["false alarms", "95 %", "within 3 s.e.", IN_INTERVAL]
    own_columns = of_clean if clean else [*LACK_WORDS, "95 % of wrong, identified"]
    lines = [["rig", "what is logged", "cases", *own_columns, "CPU s"]]
    for name, rig in RIGS.items():
        own = [r for r in rows if r["rig"] == name]
        if not own:
            continue
        count, n, z = Counter(verdict(r) for r in own), len(own), _z(own)
        cells = [str(count[w]) for w in LACK_WORDS]
        cells.append(tables.interval(count[WRONG], n))
        if clean:
            within = f"{int(np.sum(np.abs(z) <= 3))}/{z.size}" if z.size else ""
            cells = [str(count[FALSE_ALARM]), tables.interval(count[FALSE_ALARM], n), within, _in_interval(z)]
        lines.append([name, rig.description, str(n), *cells, f"{np.median([r['cpu'] for r in own]):.0f}"])
    return lines


def by_effect(rows: Sequence[Row]) -> tables.Lines:
    """Return a table with one line per effect, over all rigs."""
    lines = [["truth", "cases", *LACK_WORDS, "identified or ambiguous, 95 %"]]
    for effect in dict.fromkeys(r["effect"] for r in rows if r["effect"] != NONE):
        own = [r for r in rows if r["effect"] == effect]
        count = Counter(verdict(r) for r in own)
        lines.append(
            [
                effect,
                str(len(own)),
                *(str(count[w]) for w in LACK_WORDS),
                tables.interval(count[NAMED] + count[LIKENED], len(own)),
            ]
        )
    return lines


def parameters(rows: Sequence[Row]) -> tables.Lines:
    """Return (estimate - truth) / standard error of the clean boats by parameter, the share of 95 % intervals that
    contain the truth, and the rigs with values beyond three.
    """
    clean = [r for r in rows if r["effect"] == NONE and r.get("z")]
    lines = [["parameter", "estimates", "mean z", "sd of z", IN_INTERVAL, "within 3", "rigs with estimates beyond 3"]]
    for name in dict.fromkeys(n for r in clean for n in r["z"]):
        own = [(r["rig"], r["z"][name]) for r in clean if name in r["z"]]
        z, beyond = np.array([v for _, v in own]), Counter(rig for rig, v in own if abs(v) > 3)
        within = f"{z.size - beyond.total()}/{z.size}"
        lines.append(
            [
                name,
                str(z.size),
                f"{z.mean():+.2f}",
                f"{z.std():.2f}",
                _in_interval(z),
                within,
                ", ".join(f"{rig} {n}" for rig, n in beyond.most_common()),
            ]
        )
    return lines


def plants(rows: Sequence[Row]) -> tables.Lines:
    """Return a table with one line per plant: its effects and the findings."""
    lines = [
        [
            "plant",
            "effect switched on",
            "effects always in its equations",
            "found",
            "attribution",
            "verdict",
            "beyond 3 s.e.",
        ]
    ]
    for r in (r for r in rows if "error" not in r):
        beyond = ", ".join(f"{n} {z:+.1f}" for n, z in r["z"].items() if abs(z) > 3)
        plant = PLANTS[r["rig"]]
        findings = (
            [", ".join(r["found"]) or NONE, ", ".join(r["attribution"]), verdict(r)] if plant.diagnosed else [""] * 3
        )
        lines.append([plant.name, r["effect"], ", ".join(sorted(plant.there)), *findings, beyond])
    return lines


def failures(rows: Sequence[Row]) -> tables.Lines:
    """Return the cases that ended in an error, by rig and message."""
    counts = Counter((r["rig"], r["error"]) for r in rows if "error" in r)
    return [["rig", "cases", "error"], *([rig, str(n), text] for (rig, text), n in counts.most_common())]


def _in_interval(z: Any) -> str:
    return f"{np.mean(np.abs(z) <= WIDTH):.1%}" if z.size else ""


def _z(rows: Sequence[Row]) -> Any:
    return np.array([z for r in rows if r["effect"] == NONE for z in r.get("z", {}).values()])


# Repeated cases.


def again(out: Path) -> Path:
    """Return the file of repeated cases, beside that of the kept cases."""
    return out.with_stem(f"{out.stem}-again")


def drawn(rows: Sequence[Row], n: int) -> list[RigCase]:
    """Return ``n`` of the cases. The choice is the same each time."""
    chosen = random.Random(n).sample(sorted(rows, key=lambda r: str(r["key"])), min(n, len(rows)))
    return [RigCase(r["rig"], r["effect"], r["seed"]) for r in chosen]


def latest(rows: Sequence[Row]) -> str:
    """Return one line with the shares of the cases of the latest code state, in file order. It is empty without other
    states.
    """
    words = [verdict(r) for r in rows if r["code"] == rows[-1]["code"]]
    if len(words) in (0, len(rows)):
        return ""
    clean = rows[-1]["effect"] == NONE
    of_effects = {
        "the true effect was identified or ambiguous": (NAMED, LIKENED),
        "a wrong effect was identified": (WRONG,),
    }
    outcomes = {"no effect was found": (RIGHT,)} if clean else of_effects
    counts = {description: sum(w in own for w in words) for description, own in outcomes.items()}
    shares = ", ".join(
        f"{description} in {k} ({tables.interval(k, len(words))} %)" for description, k in counts.items()
    )
    return f"{len(words)} of them were computed with the latest state ({rows[-1]['code']}): {shares}."


def held(rows: Sequence[Row], anew: Sequence[Row]) -> str:
    """Return one line with the number of equal verdicts of repeated cases, and the changed verdicts."""
    kept = {r["key"]: verdict(r) for r in rows}
    both = [(r["key"], kept[r["key"]], verdict(r)) for r in anew if r["key"] in kept]
    if not both:
        return ""
    changed = [f"{key} was {before} and is now {now}" for key, before, now in both if before != now]
    same = len(both) - len(changed)
    states = ", ".join(sorted({str(r["code"]) for r in anew}))
    which = f": {'; '.join(changed)}" if changed else ""
    return (
        f"{len(both)} of them, selected at random, were repeated with another state of the code ({states}; `--again "
        f"{len(both)}`): the verdict is the same in {same} ({tables.interval(same, len(both))} %){which}."
    )


# The command.


def line(row: Row) -> str:
    """Return a short description of a case."""
    if "error" in row:
        return f"{row['key']}: failed: {row['error']}"
    z = max((abs(v) for v in row["z"].values()), default=0.0)
    return f"{row['key']}: {', '.join(row['found']) or 'nothing'} ({verdict(row)}; z {z:.1f}, {row['cpu']:.0f} s)"


def main(words: Sequence[str] | None = None) -> int:
    """Run the missing cases, then print the tables."""
    arguments = _parser().parse_args(words)
    wanted = cases_of(arguments.rigs, arguments.effects, arguments.seed, arguments.seeds)
    try:
        if arguments.again:
            resume(
                drawn([*read(arguments.out).values()], arguments.again),
                run_case,
                line,
                arguments.jobs,
                again(arguments.out),
            )
        only_shown = arguments.report or arguments.again
        rows = (
            list(read(arguments.out).values())
            if only_shown
            else resume(wanted, run_case, line, arguments.jobs, arguments.out)
        )
    except KeyboardInterrupt:
        print(f"interrupted; run the same again to go on ({arguments.out})", file=sys.stderr)
        return 130
    anew = list(read(again(arguments.out)).values())
    for title, own in sections(rows).items():
        print(f"{title}\n\n{report(own, tables.as_text)}\n\n{latest(own)}\n{held(own, anew)}\n")
    if arguments.docs:
        page = DOCS.read_text(encoding="utf-8")
        for title, own in sections(rows).items():
            page = with_section(page, title, section(own, arguments.seeds, anew))
        DOCS.write_text(page, encoding="utf-8")
        print(f"written: {DOCS.name}")
    return 1 if any("error" in r for r in rows) else 0


def with_section(page: str, title: str, text: str) -> str:
    """Return the page with new text below a heading of the second level. A missing heading is added at the end."""
    heading = f"\n## {title}\n"
    before, _, rest = page.partition(heading)
    _, following, after = rest.partition("\n## ")
    return f"{before}{heading}\n{text}\n{following}{after}"


def section(rows: Sequence[Row], seeds: int, anew: Sequence[Row] = ()) -> str:
    """Return the text of a section: how the cases are made, their progress, repeated verdicts, and the tables."""
    states = ", ".join(sorted({str(r["code"]) for r in rows}))
    made = " ".join(filter(None, [f"{how_made(rows, seeds)} The code had these states (hashes): {states}.",
                                  latest(rows), held(rows, anew)]))  # fmt: skip
    return f"{made}\n\n{report(rows, tables.as_markdown)}"


def how_made(rows: Sequence[Row], seeds: int) -> str:
    """Return the command that makes these cases, and their progress. ``seeds`` is the required number of each."""
    own = [r for r in rows if r["rig"] in RIGS]
    if not own:
        names = ",".join(n for n in PLANTS if any(r["rig"] == n for r in rows))
        return (
            f"    python -m tests.recovery.rigs --rigs {names}\n\n{len(rows)} cases were run. The estimates are those "
            "of `ident vehicle`, whose model lacks the effects that are always in the plant's equations."
        )
    rigs, effects = (
        [n for n in every if any(r[key] == n for r in own)]
        for key, every in (("rig", RIGS), ("effect", (NONE, *EFFECTS, *OUTSIDE)))
    )
    blocks = list[list[int]]()  # Blocks of consecutive seeds.
    for seed in sorted({r["seed"] for r in own}):
        if not blocks or seed != blocks[-1][-1] + 1:
            blocks.append([])
        blocks[-1].append(seed)
    sizes = [len(b) for b in blocks] if len(blocks) > 1 else [max(seeds, len(blocks[0]))]
    there = [[n for n in rigs if any(r["rig"] == n and r["seed"] in b for r in own)] for b in blocks]
    wanted = {
        c.key for names, b, n in zip(there, blocks, sizes, strict=True) for c in cases_of(names, effects, b[0], n)
    }
    done = len({r["key"] for r in own} & wanted)
    far = f"{done} cases were run" if done == len(wanted) else f"{done} of its {len(wanted)} cases have been run so far"
    far += ", each with its own boat" if len({r.get("boat", r["seed"]) for r in own}) == len(own) else ""
    words = ([] if names == [*RIGS] else ["--rigs", ",".join(names)] for names in there)
    commands = (
        " ".join([*own_words, "--effects", ",".join(effects), "--seed", str(b[0]), "--seeds", str(n)])
        for own_words, b, n in zip(words, blocks, sizes, strict=True)
    )
    return "\n".join(f"    python -m tests.recovery.rigs {command}" for command in commands) + f"\n\n{far}."


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("python -m tests.recovery.rigs", description="The study on other rigs.")
    every = [*RIGS, *PLANTS]
    parser.add_argument("--rigs", type=listed("rig", every), default=every, help=", ".join(every))
    parser.add_argument(
        "--effects",
        type=listed("effect", (NONE, *EFFECTS, *OUTSIDE)),
        default=list(CHOSEN),
        help=f"by default {','.join(CHOSEN)}",
    )
    parser.add_argument("--seed", type=int, default=1, help="the first boat's")
    parser.add_argument("--seeds", type=int, default=10, help="boats in each cell")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--out", type=Path, default=OUT, help="results, a JSON line a case")
    parser.add_argument("--report", action="store_true", help="run nothing, show what the out file holds")
    parser.add_argument(
        "--again",
        type=int,
        metavar="N",
        help="run N of its cases anew, drawn at random, and say which verdicts changed",
    )
    parser.add_argument("--docs", action="store_true", help="write its part of docs/recovery.md")
    return parser


if __name__ == "__main__":
    sys.exit(main())
