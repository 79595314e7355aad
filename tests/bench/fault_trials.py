"""Study of every fault that can end a run, with many trials each on the mock boat.

    python -m tests.bench.fault_trials --n 100 --jobs 2 --out docs/data/fault-trials.jsonl --docs docs/safety.md

Each trial runs a mission on the mock boat behind real ports, waits until it turns and causes one fault at a random
moment. It then checks in the mock's own trace that thrust was zero in time, and that the log names the reason. The
program prints a table. The exit status is 1 if one trial failed.

`--out` keeps the trials, one line of JSON each, and kept trials are not run again. `--docs` writes the table between
its marks in a page.

Jobs wait most of the time, but their deadlines are in real time: with more jobs than idle cores, the trials measure the
machine. The judged processes and the measuring mock raise their own priority. Processes that only start or end do not,
because two jobs would delay each other.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from tests.bench.fault_kinds import AFTER_DECISION_S, KINDS, RIGS, Kind
from tests.bench.fault_runs import Trial, trials

PART = 10  # trials with the same mock boat
SHOWN = 60  # length in characters
MARKS = ("<!-- python -m tests.bench.fault_trials -->", "<!-- end of the trials -->")
NOT_TRIED = "not tried"
INTERRUPTED_S = 2.0  # Ctrl-C also ends the mock boats of this terminal, perhaps before this program receives it
NO_DISK = "not tried: no small file system can be mounted here"
Results = dict[str, dict[int, Trial]]  # by kind and seed


class Store:
    """Trials done so far, in memory and, if a path is given, in a file."""

    def __init__(self, path: Path | None) -> None:
        self.results: Results = {kind.name: {} for kind in KINDS}
        self.spoilt = 0
        self._path, self._lock = path, threading.Lock()
        if path is not None and path.exists():
            for line in path.read_text(encoding="utf-8").splitlines():
                row = json.loads(line)
                self._take(row.pop("kind"), row.pop("seed"), Trial(**row))

    def put(self, kind: Kind, seed: int, found: Trial) -> None:
        """Keep one more trial."""
        with self._lock:
            self._take(kind.name, seed, found)
            if self._path is not None:
                row = {"kind": kind.name, "seed": seed, **found.as_row()}
                with self._path.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")

    def _take(self, kind: str, seed: int, found: Trial) -> None:
        """Take one trial. A run that had ended before the fault is counted as spoilt, and its seed stays open."""
        if found.spoilt:
            self.spoilt += 1
        else:
            self.results.setdefault(kind, {})[seed] = found


def parts(kinds: Sequence[Kind], n: int, seed: int, done: Results) -> list[tuple[Kind, list[int]]]:
    """Return the missing trials in parts of a few trials of one kind, the kinds in turn."""
    found = []
    for first in range(0, n, PART):
        for kind in kinds:
            seeds = [seed + k for k in range(first, min(first + PART, n)) if seed + k not in done[kind.name]]
            found += [(kind, seeds)] if seeds else []
    return found


def run_all(kinds: Sequence[Kind], n: int, seed: int, jobs: int, store: Store, say: Callable[[str], None]) -> None:
    """Run the missing trials, `jobs` at once, each with its own ports and folder."""
    todo = parts(kinds, n, seed, store.results)
    stopping = threading.Event()

    def work(part: tuple[Kind, list[int]]) -> None:
        kind, seeds = part
        left = list(seeds)
        try:
            for found in trials(kind, seeds):  # an empty list if this machine cannot run the kind
                if stopping.wait(INTERRUPTED_S if found.wrong or found.spoilt else 0.0):
                    return
                store.put(kind, left[0], found)
                for problem in [*found.wrong, *filter(None, [found.spoilt and f"spoilt: {found.spoilt}"])]:
                    say(f"{kind.name}, seed {left[0]}: {problem}")
                del left[0]
        except Exception as error:  # this trial has failed; the others are still worth running
            if stopping.wait(INTERRUPTED_S):
                return
            problem = f"{type(error).__name__}: {error}"
            store.put(kind, left[0], Trial(wrong=[problem]))
            say(f"{kind.name}, seed {left[0]}: {problem}")

    with ThreadPoolExecutor(jobs) as pool:
        try:
            for done, _ in enumerate(pool.map(work, todo), start=1):
                say(f"{done} of {len(todo)} parts")
        except BaseException:  # after Ctrl-C the current trials finish and clean up
            stopping.set()
            pool.shutdown(cancel_futures=True)
            raise


def numbers(kind: Kind, found: Sequence[Trial]) -> tuple[str, str, str, str, str]:
    """Return the number of good trials and four times [ms].

    The times are the median and the largest time from the fault to zero, its limit, and the largest time from the
    decision.
    """
    zero = np.array([t.zero_s for t in found]) * 1e3
    # thrust may be zero before the decision is written to the log
    after = np.maximum([t.decided_s for t in found], 0.0) * 1e3
    good = f"{sum(not t.wrong for t in found)}/{len(found)}"
    median, largest = (f"{f(zero):.0f}" if np.isfinite(zero).any() else "-" for f in (np.nanmedian, np.nanmax))
    decided = f"{np.nanmax(after):.0f}" if np.isfinite(after).any() else "-"
    return good, median, largest, f"{1e3 * (kind.within_s + AFTER_DECISION_S):.0f}", decided


def row(kind: Kind, found: Sequence[Trial]) -> str:
    """Return one line of the table."""
    if not found:
        return f"{kind.name:<30} {NO_DISK if kind.full else NOT_TRIED}"
    good, median, largest, limit, decided = numbers(kind, found)
    return f"{kind.name:<30} {good:>9} {median:>6} {largest:>6}  {limit:>5} {decided:>8}   {found[0].evidence[:SHOWN]}"


def table(results: Results, kinds: Sequence[Kind]) -> str:
    """Return the table for the terminal."""
    head = f"{'what fails':<30} {'good':>9} {'median':>6} {'max':>6}  {'limit':>5} {'decided':>8}   reason"
    lines = [head, f"{'':<30} {'':>9} {'from fault to zero, ms':>22}"]
    return "\n".join(lines + [row(kind, list(results[kind.name].values())) for kind in kinds])


def page(results: Results, kinds: Sequence[Kind]) -> str:
    """Return the Markdown table of docs/safety.md: one row per fault, one column per rig."""
    rows = [trial for kind in kinds for trial in results[kind.name].values()]
    lines = [f"{sum(not row.wrong for row in rows)} of {len(rows)} trials were correct.", ""]
    lines += ["| what fails | allowed | " + " | ".join(RIGS) + " |", "|---|---:|" + "---:|" * len(RIGS)]
    for what in dict.fromkeys(kind.what for kind in kinds):
        cells, limits = dict.fromkeys(RIGS, "-"), []
        for kind in (kind for kind in kinds if kind.what == what):
            found = list(results[kind.name].values())
            if found:
                good, median, largest, limit, decided = numbers(kind, found)
                decided = "" if kind.cut_off or decided == "-" else f" ({decided})"
                limits.append(limit)
                cells[kind.rig] = f"{good}: {median}, {largest}{decided}"
        if set(cells.values()) != {"-"}:
            lines.append(f"| {what} | {', '.join(dict.fromkeys(limits))} ms | " + " | ".join(cells.values()) + " |")
    return "\n".join(lines)


def into(path: Path, marks: tuple[str, str], text: str) -> None:
    """Replace the text between the marks of a page."""
    before, _, rest = path.read_text(encoding="utf-8").partition(marks[0])
    _, mark, after = rest.partition(marks[1])
    if not mark:
        raise SystemExit(f"{path}: no '{marks[0]}' ... '{marks[1]}' in it")
    path.write_text(f"{before}{marks[0]}\n{text}\n{marks[1]}{after}", encoding="utf-8")


def main() -> None:
    """Run the requested trials and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=int, default=20, help="trials of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", default=[""], help="kinds whose name contains one of these")
    parser.add_argument("--jobs", type=int, default=1, help="trials at once")
    parser.add_argument("--out", type=Path, help="file of JSON lines to keep trials in and to go on from")
    parser.add_argument("--docs", type=Path, help="page that gets the table")
    options = parser.parse_args()
    kinds = [kind for kind in KINDS if any(part in kind.name for part in options.only)]
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    store = Store(options.out)
    try:
        run_all(kinds, options.n, options.seed, options.jobs, store, lambda s: print(s, file=sys.stderr, flush=True))
    except KeyboardInterrupt:
        goes_on = f"; the same command goes on from {options.out}" if options.out else ""
        print(f"interrupted{goes_on}", file=sys.stderr)
        sys.exit(130)
    print(table(store.results, kinds))
    if options.docs:
        into(options.docs, MARKS, f"\n{page(store.results, kinds)}\n")
    bad = sum(bool(t.wrong) for kind in kinds for t in store.results[kind.name].values())
    if store.spoilt:
        print(f"{store.spoilt} runs had ended before anything failed: the machine was too busy", file=sys.stderr)
    print("all trials were correct" if not bad else f"{bad} trials were not correct", file=sys.stderr)
    sys.exit(bool(bad))


if __name__ == "__main__":
    main()
