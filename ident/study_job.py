"""The study's job: replicates in parallel, a JSON line each, and from them result.json and a page of tables."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import joblib

from daq.errors import SeatrialError
from ident.outcome import Json, plain, write_result
from ident.study import APART, BIAS, COVERAGE, VARIANCE, Case, Judged, Method, Row, counts, judge, replicates
from ident.study_cases import make_case

Say = Callable[[str], None]
BATCH = 25  # replicates a task: they are simulated together
ROWS = 2  # version of what a line holds
WAVES = 4  # tasks a worker between two looks at what is done
OWN = ("euler", "study", "fit", "restricted", "scoring", "pe", "prepared", "uncertainty")  # files that results hang on
HEAD = ("parameter", "n", "at bound", "bias, sd", "variance/reported", "variance/bound", "coverage", "")


def study(case: Case, n: int, seed: int, out: Path | str, *, method: Method = "pe", jobs: int | None = None,
          say: Say = lambda line: None) -> list[Row]:
    """All replicates of a case, those of earlier runs from ``out``, a file of JSON lines.

    ``jobs`` processes, or what ``joblib.parallel_config`` says where it is None: any backend of joblib will do.
    """
    key, out = _key(case, seed, method), Path(out)
    done = {r["k"]: r for r in read(out) if r["key"] == key and r["k"] < n}
    todo = [k for k in range(n) if k not in done]
    if done:
        say(f"{case.name}: {len(done)} replicates are there already")
        if any(r["code"] != code_state() for r in done.values()):
            say(f"note: some of {out} were made by another state of the code; give another --out to begin anew")
    out.parent.mkdir(parents=True, exist_ok=True)
    with out.open("a", encoding="utf-8") as file:
        for rows in _batches(case, todo, seed, method, jobs):
            for row in rows:
                done[row["k"]] = row | {"key": key, "code": code_state()}
                file.write(json.dumps(done[row["k"]]) + "\n")
            file.flush()
            say(f"{case.name}: {len(done)} of {n} replicates")
    return [done[k] for k in sorted(done)]


def _batches(case: Case, todo: Sequence[int], seed: int, method: Method, jobs: int | None) -> Iterator[list[Row]]:
    """What each task returns; in waves, since not every backend can give results as they come."""
    tasks = [todo[i : i + BATCH] for i in range(0, len(todo), BATCH)]
    with joblib.Parallel(n_jobs=jobs) as run:
        wave = WAVES * joblib.effective_n_jobs(-1 if jobs is None else jobs)
        for i in range(0, len(tasks), wave):
            yield from run(joblib.delayed(replicates)(case, task, seed, method) for task in tasks[i : i + wave])


def read(out: Path) -> list[Row]:
    """Lines of earlier runs; one that was cut short is left out, and so is a replicate that failed."""
    rows = []
    for text in out.read_text(encoding="utf-8").splitlines() if out.exists() else ():
        try:
            row = json.loads(text)
        except json.JSONDecodeError:
            continue
        if isinstance(row, dict) and {"k", "key", "code"} <= set(row) and "error" not in row:
            rows.append(row)
    return rows


def run_studies(
    names: Sequence[str], n: int, seed: int, out: Path, *, truth: Mapping[str, float], free: Sequence[str] = (),
    seconds: float | None = None, bounded: bool = True, method: Method = "pe", jobs: int | None = None, command: str,
    say: Say,
) -> Json:
    """The studies of the named models; writes NAME.jsonl for each, result.json and study.md into ``out``."""
    cases = [make_case(name, truth, free, seconds, bounded=bounded) for name in dict.fromkeys(names)]
    if out.exists() and not out.is_dir():
        raise SeatrialError(f"{out}: is a file; give a folder")
    parts = []
    for case in cases:
        rows = study(case, n, seed, out / f"{case.name}.jsonl", method=method, jobs=jobs, say=say)
        parts.append(part(case, rows, method))
    result = {
        "format": "seatrial-result 1",
        "kind": "study",
        "answer": " ".join(answer(p) for p in parts),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "seatrial": version("seatrial"),
        "command": command,
        "logs": [],
        "seed": seed,
        "studies": parts,
    }
    write_result(plain(result), out / "result.json")
    (out / "study.md").write_text(page(result), encoding="utf-8")
    return result


def part(case: Case, rows: Sequence[Row], method: Method) -> Json:
    """One study's entry of ``studies``."""
    truth = case.model.values
    return {
        "model": case.name,
        "about": case.about,
        "method": method.upper(),
        **counts(rows),
        "parameters": [_row(j, truth[j.name], case.model.parameter(j.name).unit) for j in judge(rows)],
    }


def _row(j: Judged, truth: float, unit: str) -> Json:
    return {
        "name": j.name, "unit": unit, "truth": truth, "n": j.n, "at_bound": j.at_bound, "sd": j.sd, "bias": j.bias,
        "bias_error": j.bias_error, "ratio": j.ratio, "ratio_low": j.ratio_interval[0],
        "ratio_high": j.ratio_interval[1], "bound_ratio": j.bound_ratio, "bound_ratio_low": j.bound_interval[0],
        "bound_ratio_high": j.bound_interval[1], "coverage": j.coverage,
        "coverage_low": j.coverage_interval[0], "coverage_high": j.coverage_interval[1], "misses": list(j.misses),
    }


def answer(one: Json) -> str:
    """How many parameters keep within what is wanted."""
    rows = one["parameters"]
    if not rows:
        return f"{one['model']}: no replicate can be judged."
    sure = {r["name"]: [m for m in r["misses"] if "chance" not in m] for r in rows}
    worst = [f"{name} ({', '.join(misses)})" for name, misses in sure.items() if misses]
    lucky = sum(bool(r["misses"]) and not sure[r["name"]] for r in rows)
    held = f"{sum(not r['misses'] for r in rows)} of {len(rows)} parameters"
    parts = [f"{one['model']}, {one['replicates']} replicates: {held} are as wanted"]
    parts += [f"{lucky} miss by no more than chance"] if lucky else []
    return ", ".join([*parts, *([f"these do not hold: {', '.join(worst)}"] if worst else [])]) + "."


def table(one: Json) -> list[tuple[str, ...]]:
    """Lines of a study, the head first."""
    return [HEAD, *(_line(r) for r in one["parameters"])]


def _line(r: Json) -> tuple[str, ...]:
    return (
        r["name"], str(r["n"]), str(r["at_bound"]), f"{r['bias']:+.2f} ± {r['bias_error']:.2f}",
        f"{r['ratio']:.2f}", f"{r['bound_ratio']:.2f} ({r['bound_ratio_low']:.2f} to {r['bound_ratio_high']:.2f})",
        f"{100 * r['coverage']:.1f} % ({100 * r['coverage_low']:.1f} to {100 * r['coverage_high']:.1f})",
        ", ".join(r["misses"]),
    )


def as_text(result: Json) -> str:
    """The answer and the tables, for a terminal."""
    lines = []
    for one in result["studies"]:
        rows = table(one)
        width = [max(len(row[k]) for row in rows) for k in range(len(HEAD))]
        lines += ["", f"{one['model']}, {one['method']}: {one['about']}", ""]
        lines += ["  ".join(cell.ljust(w) for cell, w in zip(row, width, strict=True)).rstrip() for row in rows]
    return "\n".join([*lines[1:], "", result["answer"], ""])


def page(result: Json) -> str:
    """The studies in Markdown: what was done, and a table each."""
    lines = [
        "# Monte Carlo study of the estimators", "",
        f"    {result['command']}", "",
        "Data of each model itself, with process noise, simulated in plain numpy by steps of Heun (`ident/euler.py`); "
        f"each fit starts within a factor {2.718281828**APART:.1f} of the truth. Errors are those of the coordinate in "
        "which the estimator moves: the logarithm of a positive parameter. `bias, sd`: mean error over the standard "
        "deviation of the estimates, with its own standard error. `variance/reported`: variance of the estimates over "
        "the mean of the variances that the fits reported; `variance/bound`: over the Cramer-Rao bound at the truth, "
        "or the least variance where parameters are near their bounds (`ident/study.py`). `coverage`: of 95 % "
        "intervals, which are one-sided for estimates `at bound`. Noise is estimated by restricted likelihood "
        "(`ident/restricted.py`), and the filter's mean is of second order (`ident/engine/graphs.py`). In brackets, "
        "95 % intervals of these numbers themselves. The last column names "
        f"what is beyond the aim (|bias| < {BIAS}, variance within {100 * VARIANCE:.0f} %, coverage "
        f"{100 * COVERAGE[0]:.0f}-{100 * COVERAGE[1]:.0f} %), with `chance?` where the number's own interval reaches "
        "into the aim.",
    ]
    for one in result["studies"]:
        head, *rows = table(one)
        lines += [
            "", f"## {one['model']}, {one['method']}", "",
            f"{one['about']}; {one['replicates']} replicates, {one['failed']} failed, {one['unconverged']} did not "
            f"converge; {1e3 * one['cpu_fit']:.0f} ms CPU a fit, {1e3 * one['cpu_simulation']:.0f} ms a simulation.",
            "",
            "| " + " | ".join(head) + " |", "|" + "---|" * len(head), *("| " + " | ".join(r) + " |" for r in rows),
        ]
    return "\n".join(lines) + "\n"


def _key(case: Case, seed: int, method: Method) -> str:
    """Replicates with the same key are of the same study: mission, model, truth, seed and method."""
    parameters = [(p.name, p.value, p.bounds, p.free) for p in case.model.parameters]
    values: Any = (case.name, parameters, sorted(case.every.items()), seed, method, case.model.source, ROWS)
    inputs = case.inputs
    digest = hashlib.sha256(repr(values).encode())
    for array in (inputs.t, inputs.u, inputs.u_next):
        digest.update(array.tobytes())
    return digest.hexdigest()[:12]


@cache
def code_state() -> str:
    """A hash of what a result depends on."""
    digest, root = hashlib.sha256(), Path(__file__).parent
    own = [root / f"{name}.py" for name in OWN]
    for path in sorted([*own, *(root / "engine").glob("*.py"), *(root / "models").glob("*.py")]):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]
