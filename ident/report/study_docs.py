"""A Monte Carlo study in Markdown: a picture and a table of each model; and its tables for a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ident.report.study_picture import picture
from ident.study import AIMS, APART, BIAS, COVERAGE, VARIANCE

Json = Mapping[str, Any]
HEAD = ("parameter", "n", "at bound", "bias, sd", "variance/reported", "variance/bound", "coverage", "")
PICTURES = "pictures"  # the folder beside a page


def write_study_docs(result: Json, path: Path) -> None:
    """The page of ``docs/study.md`` as ``path``, and its pictures in a folder beside it.

    Raises OSError where they cannot be written.
    """
    (path.parent / PICTURES).mkdir(parents=True, exist_ok=True)
    for one in result["studies"]:
        if one["parameters"]:
            drawn = picture(one, AIMS)
            (path.parent / _picture(one)).write_text(drawn, encoding="utf-8", newline="\n")
    path.write_text(page(result), encoding="utf-8", newline="\n")


def _picture(one: Json) -> str:
    return f"{PICTURES}/study-{one['model']}.svg"


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
        lines += ["", f"{one['model']}, {one['method']}: {one['about']}", f"estimator: {one['estimator']}", ""]
        lines += ["  ".join(cell.ljust(w) for cell, w in zip(row, width, strict=True)).rstrip() for row in rows]
    return "\n".join([*lines[1:], "", result["answer"], ""])


def page(result: Json) -> str:
    """The studies in Markdown: what was done, and a picture and a table each."""
    lines = [
        "# Monte Carlo study of the estimators", "",
        f"    {result['command']}", "",
        "Data of each model itself, with process noise, simulated in plain numpy by steps of Heun (`ident/euler.py`); "
        f"each fit starts within a factor {2.718281828**APART:.1f} of the truth. Errors are those of the coordinate in "
        "which the estimator moves: the logarithm of a positive parameter. `bias, sd`: mean error over the standard "
        "deviation of the estimates, with its own standard error. `variance/reported`: variance of the estimates over "
        "the mean of the variances that the fits reported; `variance/bound`: over the Cramer-Rao bound at the truth, "
        "or the least variance where parameters are near their bounds (`ident/study.py`). `coverage`: of 95 % "
        "intervals, which are one-sided for estimates `at bound`. Each title is followed by the "
        "estimator: restricted likelihood is that of `ident/restricted.py`, a filter's mean of second order that of "
        "`ident/engine/graphs.py`, and both are what the commands do. In brackets, 95 % intervals of these numbers "
        "themselves. The last column names "
        f"what is beyond the aim (|bias| < {BIAS}, variance within {100 * VARIANCE:.0f} %, coverage "
        f"{100 * COVERAGE[0]:.0f}-{100 * COVERAGE[1]:.0f} %), with `chance?` where the number's own interval reaches "
        "into the aim. In the pictures lines are these intervals, the light band is the aim, and dashes hold 95 % of "
        "what chance alone makes of an estimator that is right, with as many replicates (binomial, for the coverage).",
    ]
    for one in result["studies"]:
        head, *rows = table(one)
        lines += [
            "", f"## {one['model']}, {one['method']}", "",
            f"{one['about']}; {one['estimator']}; {one['replicates']} replicates, {one['failed']} failed, "
            f"{one['unconverged']} did not converge; {1e3 * one['cpu_fit']:.0f} ms CPU a fit, "
            f"{1e3 * one['cpu_simulation']:.0f} ms a simulation.",
            "",
            *([f"![bias, variance and coverage of every parameter]({_picture(one)})", ""] if rows else []),
            "| " + " | ".join(head) + " |", "|" + "---|" * len(head), *("| " + " | ".join(r) + " |" for r in rows),
        ]
    return "\n".join(lines) + "\n"
