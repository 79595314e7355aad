"""Recovery study: does the diagnosis find the known truth of simulated boats?

    python -m tests.recovery.study [--kinds single,mixture] [--seeds N] [--seed S] [--jobs 2] [--effects a,b]
                                   [--out FILE] [--docs]

The boats have one, two or all effects of the mocks, effects outside the catalogue, misspecified noise, or no effect.
Each kind has its own number of seeds, or N. Each finished case is written as a line to the out file. An interrupted
study is resumed. --report runs no case.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from seatrial.mocks.hidden_effects.catalogue import EFFECTS, OUTSIDE, SITE
from tests.recovery import tables, targets
from tests.recovery.cases import Row, run_case
from tests.recovery.kinds import KINDS, NONE, Case
from tests.recovery.resumable import listed, read, resume
from tests.recovery.verdict import all_right, first_right, likened, wrong_as_sure

OUT = Path("build/recovery.jsonl")
DOCS = Path(__file__).parents[2] / "docs" / "recovery.md"
NAMES = (NONE, *EFFECTS, *SITE, *OUTSIDE)
Form = Callable[[tables.Lines], str]


def main(words: Sequence[str] | None = None) -> int:
    """Run the missing cases, then print the tables."""
    arguments = _parser().parse_args(words)
    cases = cases_of(arguments.kinds, arguments.seed, arguments.seeds, arguments.effects)
    try:
        if arguments.report:
            rows = [r for r in read(arguments.out).values() if r.get("kind") in arguments.kinds]
        else:
            rows = resume(cases, run_case, line, arguments.jobs, arguments.out)
    except KeyboardInterrupt:
        print(f"interrupted; run the same again to go on ({arguments.out})", file=sys.stderr)
        return 130
    print(report(rows, tables.as_text))
    if arguments.docs:
        # The text of the study of other rigs is kept.
        _, heading, rigs = DOCS.read_text(encoding="utf-8").partition(f"\n{tables.RIGS_HEADING}\n")
        DOCS.write_text(document(rows, arguments) + heading + rigs, encoding="utf-8")
        print(f"written: {DOCS.name}")
    return 1 if any("error" in r for r in rows) else 0


def cases_of(kinds: Sequence[str], seed: int, seeds: int | None, effects: Sequence[str]) -> list[Case]:
    """Return the cases ordered by seed, so that a stopped study covers all kinds."""
    numbers = {kind: seeds if seeds is not None else KINDS[kind].seeds for kind in kinds}
    return [
        Case(truth, s, kind)
        for s in range(seed, seed + max(numbers.values()))
        for kind in kinds
        if s < seed + numbers[kind]
        for truth in KINDS[kind].truths(s)
        if not effects or set(truth.split("+")) & set(effects)
    ]


def line(row: Row) -> str:
    """Return a short description of a case."""
    if "error" in row:
        return f"{row['key']}: failed: {row['error']}"
    if first_right(row):
        verdict = "right" if all_right(row) else "right, not all"
    else:
        verdict = "wrong" if wrong_as_sure(row) else "resembles" if likened(row) else "not found"
    return f"{row['key']}: {', '.join(row['found']) or 'nothing'} ({verdict}, {row['cpu']:.0f} s)"


def report(rows: Sequence[Row], form: Form) -> str:
    """Return all tables."""
    some = {kind: [r for r in rows if r["kind"] == kind] for kind in KINDS}
    parts = [
        ("Requirements", targets.targets(rows)),
        ("By kind", targets.kinds(rows)),
        ("Power: true effect first and identified, by size of the effect", targets.power(rows)),
        ("Validation error divided by that of the model with the true structure", targets.oracles(rows)),
        ("Outside the catalogue", targets.shapes(rows)),
        ("By effect, full size (errors: medians on validation data, before -> after)", tables.rates(some["single"])),
        ("By effect, in mixtures", tables.rates(some["mixture"])),
        ("By effect, taken out of the catalogue", tables.rates(some["leave-one-out"])),
        ("Confusion: true effect by row, first answer by column", tables.confusion(some["single"])),
        ("Confusion in mixtures", tables.confusion(some["mixture"])),
        ("Confusion with the truth taken out of the catalogue", tables.confusion(some["leave-one-out"])),
        ("Estimates on clean boats", tables.coverage(some["clean"])),
    ]
    head = "## " if form is tables.as_markdown else ""
    failed = sum("error" in r for r in rows)
    end = f"\n\n{failed} of {len(rows)} cases failed." if failed else ""
    return "\n\n".join(f"{head}{title}\n\n{form(lines)}" for title, lines in parts if len(lines) > 1) + end


def document(rows: Sequence[Row], arguments: argparse.Namespace) -> str:
    """Return the text of docs/recovery.md."""
    seeds = f" --seeds {arguments.seeds}" if arguments.seeds is not None else ""
    chosen = "" if set(arguments.kinds) == set(KINDS) else f" --kinds {','.join(arguments.kinds)}"
    kept = "" if arguments.out == OUT else f" --out {arguments.out}"
    states = sorted({str(r["code"]) for r in rows})
    its = {case.key for case in cases_of(arguments.kinds, arguments.seed, arguments.seeds, arguments.effects)}
    own = sum(r["key"] in its for r in rows)
    ran = f"{own} cases were run" if own == len(its) else f"{own} of its {len(its)} cases have been run so far"
    ran += f", and {len(rows) - own} in earlier runs with other seeds, which the second table lists" * (own < len(rows))
    return (
        "# Recovery study\n\n"
        "Each mock boat has hidden effects (`mocks/hidden_effects/`, in other forms than in the catalogue of `ident`), "
        "or no hidden effect (a clean boat). Each boat runs two missions: the first is for estimation, the second for "
        "validation. Every boat has its own parameters, current and noise. If a boat has an effect, and if the "
        "catalogue is complete and the data have no gaps, the missions are recorded as logs, and `seatrial ident "
        "vehicle` and `seatrial ident diagnose` run on them. An effect counts as right only if its attribution is "
        "*identified*. The oracle is the model with the true effect of the catalogue, fitted to the same data. "
        "[Blind tests](how-to/blind-tests.md) describes the kinds of boats and the columns of the tables."
        "\n\n"
        f"    python -m tests.recovery.study --seed {arguments.seed}{seeds}{chosen}{kept} --docs\n\n"
        f"{ran}. The code had these states (hashes): {', '.join(states)}.\n\n" + report(rows, tables.as_markdown) + "\n"
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "python -m tests.recovery.study",
        description="Known truth in, same truth out?",
        epilog="Example: python -m tests.recovery.study --kinds single,mixture --seeds 2 --out build/try.jsonl",
    )
    parser.add_argument("--kinds", type=listed("kind", list(KINDS)), default=list(KINDS), help=", ".join(KINDS))
    parser.add_argument("--seed", type=int, default=1, help="the first boat's")
    parser.add_argument("--seeds", type=int, help="how many boats for each effect, in every kind")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--effects", type=listed("effect", NAMES), default=[], help="only these; `none` among them")
    parser.add_argument("--out", type=Path, default=OUT, help="results, a JSON line a case")
    parser.add_argument("--report", action="store_true", help="run nothing, show what the out file holds")
    parser.add_argument("--docs", action="store_true", help="write docs/recovery.md")
    return parser


if __name__ == "__main__":
    sys.exit(main())
