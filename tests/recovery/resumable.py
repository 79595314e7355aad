"""Resumable studies: one JSON line per case, and finished cases are not run again."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

from joblib import Parallel, delayed

from tests.recovery.cases import code_state

Row = dict[str, Any]


class Keyed(Protocol):
    """A case with a key that identifies it in the results."""

    @property
    def key(self) -> str: ...


def resume(
    cases: Sequence[Keyed], run_case: Callable[[Any], Row], line: Callable[[Row], str], jobs: int, out: Path
) -> list[Row]:
    """Return the lines of all cases. Lines of earlier runs come from the file, and each new line is printed by
    ``line``.
    """
    done = read(out)
    old = sum(done[c.key]["code"] != code_state() for c in cases if c.key in done)
    if old:
        print(f"note: {old} cases in {out} were run with another state of the code; give another --out to run anew")
    todo = [c for c in cases if c.key not in done or "error" in done[c.key]]
    out.parent.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    with out.open("a", encoding="utf-8") as file:
        results = Parallel(n_jobs=jobs, return_as="generator_unordered")(delayed(run_case)(case) for case in todo)
        for k, row in enumerate(results, start=1):
            file.write(json.dumps(row) + "\n")
            file.flush()
            done[row["key"]] = row
            left = (time.monotonic() - began) / k * (len(todo) - k)
            print(f"{k}/{len(todo)}  {line(row)}  ({left / 60:.0f} min to go)", flush=True)
    return [done[c.key] for c in cases]


def read(out: Path) -> dict[str, Row]:
    """Return the last line of each key. A truncated line is left out.

    A failed case is included, because it counts in the shares until it is run again.
    """
    done: dict[str, Row] = {}
    for text in out.read_text(encoding="utf-8").splitlines() if out.exists() else ():
        try:
            row = json.loads(text)
        except json.JSONDecodeError:
            continue
        done[row["key"]] = row
    return done


def listed(word: str, known: Sequence[str]) -> Callable[[str], list[str]]:
    """Return a type for argparse: comma-separated names, each one of ``known``."""

    def parse(text: str) -> list[str]:
        names = text.split(",")
        for name in names:
            if name not in known:
                raise argparse.ArgumentTypeError(f"no {word} {name!r}; there are {', '.join(known)}")
        return names

    return parse
