"""Tables of a study: confusion of effects, and the quality of the estimates."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from tests.recovery.cases import Row
from tests.recovery.kinds import NONE
from tests.recovery.verdict import UNKNOWN, all_right, extra, first_answer, first_right, likened, wrong_as_sure

Lines = list[list[str]]
RIGS_HEADING = "# Other rigs"  # Heading in docs/recovery.md. All text from here on belongs to the study of rigs.


def by_effect(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the lines of each true effect, in their order. Failed cases are left out."""
    names = dict.fromkeys(r["effect"] for r in rows)
    found = {name: [r for r in rows if r["effect"] == name and "error" not in r] for name in names}
    return {name: cases for name, cases in found.items() if cases}


def rates(rows: Sequence[Row]) -> Lines:
    """Return a table with one line per effect: first, found, none found, nonparametric, ambiguous, wrong; extra
    effects; errors; CPU time.
    """
    lines = [
        [
            "truth",
            "cases",
            "first",
            "found",
            "none",
            "nonparametric",
            "ambiguous",
            "wrong",
            "extra per case",
            "10 s position error, m",
            "heading error in simulation, deg",
            "oracle ratio",
            "CPU s",
        ]
    ]
    for name, cases in by_effect(rows).items():
        answers = [first_answer(r) for r in cases]
        n = len(cases)
        ratios = [r["ratio"]["simulation"] for r in cases if "ratio" in r]
        lines.append(
            [
                name,
                str(n),
                share(sum(map(first_right, cases)), n),
                share(sum(map(all_right, cases)), n),
                share(answers.count(NONE), n),
                share(answers.count(UNKNOWN), n),
                share(sum(map(likened, cases)), n),
                share(sum(map(wrong_as_sure, cases)), n),
                f"{sum(map(extra, cases)) / n:.2f}",
                change([position(r["before"]) for r in cases], [position(r["after"]) for r in cases]),
                change([heading(r["before"]) for r in cases], [heading(r["after"]) for r in cases]),
                f"{np.median(ratios):.3f}" if ratios else "",
                f"{np.median([r['cpu'] for r in cases]):.1f}",
            ]
        )
    return lines


def confusion(rows: Sequence[Row]) -> Lines:
    """Return counts of first answers (columns) by true effect (lines), with a dot for zero."""
    table = {name: Counter(first_answer(r) for r in cases) for name, cases in by_effect(rows).items()}
    seen = {answer for counter in table.values() for answer in counter}
    columns = [n for n in (NONE, *table) if n in seen]
    columns = list(dict.fromkeys([*columns, *sorted(seen - {*columns, UNKNOWN}), *({UNKNOWN} & seen)]))
    short = [f"{k}" for k in range(1, len(columns) + 1)]
    head = ["truth", *(f"{s} {c}" for s, c in zip(short, columns, strict=True))]
    return [head, *([name, *(str(counter[c] or ".") for c in columns)] for name, counter in table.items())]


def coverage(rows: Sequence[Row]) -> Lines:
    """Return mean and spread of (estimate - truth) / standard error on clean boats, and the share within 1.96."""
    lines = [["parameter", "cases", "mean z", "sd of z", "within 1.96"]]
    clean = [r["z"] for r in rows if r["effect"] == NONE and "error" not in r]
    for name in dict.fromkeys(n for z in clean for n in z):
        z = np.array([c[name] for c in clean if name in c])
        lines.append(
            [name, str(z.size), f"{z.mean():+.2f}", f"{z.std():.2f}", share(int(np.sum(np.abs(z) < 1.96)), z.size)]
        )
    return lines


def share(count: int, n: int) -> str:
    return f"{count}/{n}"


def interval(count: int, n: int) -> str:
    """Return the 95 % interval of a share (Wilson 1927) in per cent."""
    if n == 0:
        return ""
    z = 1.959964
    middle, reach = count / n + z * z / (2 * n), z * np.sqrt(count / n * (1 - count / n) / n + z * z / (4 * n * n))
    low, high = ((middle + sign * reach) / (1 + z * z / n) for sign in (-1, 1))
    return f"{100 * max(low, 0.0):.1f}-{100 * min(high, 1.0):.1f}"


def change(before: Sequence[float], after: Sequence[float]) -> str:
    """Return the medians before and after."""
    return f"{np.median(before):.3g} -> {np.median(after):.3g}"


def position(errors: dict[str, dict[str, float]]) -> float:
    """Return the position error [m] ten seconds ahead."""
    return float(np.hypot(errors["horizon"]["x"], errors["horizon"]["y"]))


def heading(errors: dict[str, dict[str, float]]) -> float:
    """Return the heading error [deg] in simulation."""
    return float(np.degrees(errors["simulation"]["psi"]))


def as_text(lines: Lines) -> str:
    """Return the lines as text. Each column is as wide as its widest cell."""
    width = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    rows = ["  ".join(cell.ljust(w) for cell, w in zip(line, width, strict=True)).rstrip() for line in lines]
    return "\n".join(row for row in rows if row)


def as_markdown(lines: Lines) -> str:
    """Return the lines as a Markdown table. The first line is the header."""
    rows = ["| " + " | ".join(line) + " |" for line in lines]
    return "\n".join([rows[0], "|" + "---|" * len(lines[0]), *rows[1:]])
