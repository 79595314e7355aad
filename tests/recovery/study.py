"""The recovery study: known truth in, same truth out?

    python -m tests.recovery.study [--seed S] [--seeds N] [--jobs 2] [--effects a,b] [--scale 1.0] [--out FILE] [--docs]

Every effect of the mocks, and none, on boats of N seeds: 400 s for estimation, 250 s for validation. Each case is a
line in the out file as soon as it is done; a study that was interrupted goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from joblib import Parallel, delayed

from tests.recovery import tables
from tests.recovery.cases import NAMES, SECONDS, VALIDATION_SECONDS, Case, Row, code_state, run_case

OUT = Path("build/recovery.jsonl")
DOCS = Path(__file__).parents[2] / "docs" / "recovery.md"


def main(words: Sequence[str] | None = None) -> int:
    """Run what is not yet there, then print the tables."""
    given = _parser().parse_args(words)
    cases = [Case(e, s, given.scale) for s in range(given.seed, given.seed + given.seeds) for e in given.effects]
    try:
        rows = study(cases, given.jobs, given.out)
    except KeyboardInterrupt:
        print(f"interrupted; run the same again to go on ({given.out})", file=sys.stderr)
        return 130
    print(report(rows, tables.as_text))
    if given.docs:
        DOCS.write_text(document(rows, given), encoding="utf-8")
        print(f"written: {DOCS.name}")
    return 1 if any("error" in r for r in rows) else 0


def study(cases: Sequence[Case], jobs: int, out: Path) -> list[Row]:
    """The lines of all cases, those of earlier runs from the file."""
    done = read(out)
    old = sum(done[c.key]["code"] != code_state() for c in cases if c.key in done)
    if old:
        print(f"note: {old} cases in {out} were run with another state of the code; give another --out to run anew")
    todo = [c for c in cases if c.key not in done]
    out.parent.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    with out.open("a", encoding="utf-8") as file:
        run = Parallel(n_jobs=jobs, return_as="generator_unordered")
        results = run(delayed(run_case)(case) for case in todo)
        for k, row in enumerate(results, start=1):
            file.write(json.dumps(row) + "\n")
            file.flush()
            done[row["key"]] = row
            left = (time.monotonic() - began) / k * (len(todo) - k)
            print(f"{k}/{len(todo)}  {line(row)}  ({left / 60:.0f} min to go)", flush=True)
    return [done[c.key] for c in cases]


def read(out: Path) -> dict[str, Row]:
    """Lines of earlier runs by key; a line that was cut short is left out, and so is a case that failed."""
    done: dict[str, Row] = {}
    for text in out.read_text(encoding="utf-8").splitlines() if out.exists() else ():
        try:
            row = json.loads(text)
        except json.JSONDecodeError:
            continue
        if "error" not in row:
            done[row["key"]] = row
    return done


def line(row: Row) -> str:
    """A case in a few words."""
    if "error" in row:
        return f"{row['key']}: failed: {row['error']}"
    verdict = "right" if tables.right(row) and tables.first_answer(row) == row["effect"] else "other"
    return f"{row['key']}: {', '.join(row['found']) or 'none'} ({verdict}, {row['cpu']:.0f} s)"


def report(rows: Sequence[Row], form: object) -> str:
    """All tables."""
    assert callable(form)
    parts = [
        ("Together", tables.summary(rows)),
        ("By effect (errors: medians on validation data, before -> after)", tables.rates(rows)),
        ("Confusion: truth by line, first answer by column", tables.confusion(rows)),
        ("Estimates on clean boats", tables.coverage(rows)),
    ]
    head = "## " if form is tables.as_markdown else ""
    return "\n\n".join(f"{head}{title}\n\n{form(lines)}" for title, lines in parts if len(lines) > 1)


def document(rows: Sequence[Row], given: argparse.Namespace) -> str:
    """docs/recovery.md."""
    command = f"python -m tests.recovery.study --seed {given.seed} --seeds {given.seeds} --scale {given.scale:g}"
    return (
        "# Recovery study\n\n"
        "Mock boats with one undeclared effect each (`mocks/undeclared.py`, written in other forms than the catalogue "
        f"of `ident`), and clean ones: {SECONDS:g} s of mission to estimate, {VALIDATION_SECONDS:g} s to validate. "
        f"Every boat has its own parameters, current and noise.\n\n    {command}\n\n"
        + report(rows, tables.as_markdown) + "\n"
    )


def _effects(text: str) -> list[str]:
    names = text.split(",")
    for name in names:
        if name not in NAMES:
            raise argparse.ArgumentTypeError(f"no effect {name!r}; there are {', '.join(NAMES)}")
    return names


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("python -m tests.recovery.study", description="Known truth in, same truth out?")
    parser.add_argument("--seed", type=int, default=1, help="the first boat's")
    parser.add_argument("--seeds", type=int, default=3, help="how many boats for each effect")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--effects", type=_effects, default=list(NAMES), help="comma-separated, `none` among them")
    parser.add_argument("--scale", type=float, default=1.0, help="size of the effects")
    parser.add_argument("--out", type=Path, default=OUT, help="results, a JSON line a case")
    parser.add_argument("--docs", action="store_true", help="write docs/recovery.md")
    return parser


if __name__ == "__main__":
    sys.exit(main())
