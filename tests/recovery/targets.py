"""Share of right cases of each kind, with its requirement."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from seatrial.mocks.hidden_effects.catalogue import NOISE
from tests.recovery.cases import Row
from tests.recovery.kinds import KINDS
from tests.recovery.verdict import (
    all_right,
    drawn_right,
    exactly,
    falsely_sure,
    first_right,
    identified,
    identified_or_first,
    leads,
    truths,
    wrong_as_sure,
)

Lines = list[list[str]]
CLEAN = ("clean", "clean-timid", "clean-short", "dropout")
REAL, ORDINARY = ("realistic",), ("realistic-clean",)
SMALL_SIZES = (("quarter", 0.25), ("half", 0.5), ("single", 1.0))


@dataclass(frozen=True)
class Target:
    """Required share of the cases of some kinds. If ``least``, the share must not be smaller; otherwise it must not be
    larger.
    """

    kinds: tuple[str, ...]
    description: str
    counts: Callable[[Row], bool]
    share: float
    least: bool = True
    lacking: bool = True  # If true, the target is for boats with an effect, otherwise for clean boats.
    among: Callable[[Row], bool] = lambda row: True  # The target is for these cases only.


def false_alarm(row: Row) -> bool:
    return bool(row["found"])


def is_dominant(row: Row) -> bool:
    """Return whether the 10 s error of the validation data is 1.3 times as large without the effect, or more."""
    return bool(row.get("dominance", 0.0) >= 1.3)


def masses_hold(row: Row) -> bool:
    """Return whether the masses and the inertia are within three standard errors of the truth."""
    return all(abs(row["z"].get(name, 0.0)) <= 3.0 for name in ("m_u", "m_v", "m_r"))


def shape_holds(row: Row) -> bool:
    """Return whether the band contains the true curve over at least nine tenths of the drawn curve."""
    return bool(row.get("shape", 0.0) >= 0.9)


TARGETS = (
    Target(("single",), "true effect first, identified", first_right, 0.95),
    Target(("single",), "true effect identified, and no other effect", exactly, 0.95),
    Target(("half",), "true effect first, identified", first_right, 0.85),
    Target(("half",), "wrong effect first, identified", wrong_as_sure, 0.03, least=False),
    Target(("mixture",), "true effect first, identified or not", leads, 0.85),
    Target(("mixture",), "true effect among the found effects", all_right, 0.92),
    Target(("pair",), "both effects found", all_right, 0.90),
    Target(("outside",), "curve of the right force and variable first", first_right, 0.80),
    Target(
        ("outside",),
        "curve of the right force over the right variable, and no wrong effect first and identified",
        drawn_right,
        0.80,
    ),
    Target(("outside",), "true curve within the band", shape_holds, 0.80),
    Target(("beside",), "both found, the curve and the effect", all_right, 0.80),
    Target(("beside",), "wrong effect first, identified", wrong_as_sure, 0.03, least=False),
    Target(CLEAN, "an effect found on a clean boat", false_alarm, 0.02, False, False),
    Target(tuple(NOISE), "an effect found on a clean boat with misspecified noise", false_alarm, 0.05, False, False),
    Target(REAL, "true effect identified, of those that matter", identified, 0.70, among=is_dominant),
    Target(REAL, "true effect identified or first, of those that matter", identified_or_first, 0.85, among=is_dominant),
    Target(REAL, "an effect identified that the boat does not have", falsely_sure, 0.02, least=False),
    Target(REAL, "masses and inertia within three standard errors", masses_hold, 0.97),
    Target(ORDINARY, "an effect identified that the boat does not have", falsely_sure, 0.03, False, False),
    Target(ORDINARY, "masses and inertia within three standard errors", masses_hold, 0.97, True, False),
    Target(("leave-one-out",), "wrong effect first, identified", wrong_as_sure, 0.15, least=False),
)


def good(rows: Sequence[Row], *kinds: str, lacking: bool | None = None) -> list[Row]:
    """Return the cases of some kinds that did not fail. ``lacking`` selects those with or without an effect."""
    return [
        r for r in rows if r["kind"] in kinds and "error" not in r and (lacking is None or bool(truths(r)) == lacking)
    ]


def targets(rows: Sequence[Row]) -> Lines:
    """Return a table with one line per target: requirement, result and number of cases."""
    lines = [["kind", "share", "required", "found", "cases", "met"]]
    for target in TARGETS:
        cases = [r for r in good(rows, *target.kinds, lacking=target.lacking) if target.among(r)]
        if not cases:
            continue
        count = sum(target.counts(r) for r in cases)
        share = count / len(cases)
        met = share >= target.share if target.least else share <= target.share
        sign = ">=" if target.least else "<="
        kind = ", ".join(k for k in target.kinds if good(rows, k, lacking=target.lacking))
        lines.append(
            [
                kind,
                target.description,
                f"{sign} {target.share:.0%}",
                f"{share:.1%}",
                f"{count}/{len(cases)}",
                "yes" if met else "no",
            ]
        )
    return lines + _oracle_line(rows)


def _oracle_line(rows: Sequence[Row]) -> Lines:
    ratios = [r["ratio"]["simulation"] for r in good(rows, "single") if "ratio" in r]
    if not ratios:
        return []
    middle = float(np.median(ratios))
    return [
        [
            "single",
            "validation error divided by that of the oracle, simulation, median",
            "<= 1.03",
            f"{middle:.3f}",
            f"{len(ratios)}",
            "yes" if middle <= 1.03 else "no",
        ]
    ]


def kinds(rows: Sequence[Row]) -> Lines:
    """Return a table with one line per kind: results of its cases with an effect and of its clean cases."""
    lines = [
        [
            "kind",
            "boats",
            "seeds",
            "cases",
            "first",
            "all found",
            "wrong, identified",
            "nonparametric",
            "nothing found",
            "clean cases",
            "false alarms",
        ]
    ]
    for name, kind in KINDS.items():
        some, none = good(rows, name, lacking=True), good(rows, name, lacking=False)
        if not some and not none:
            continue
        lines.append(
            [
                name,
                kind.description,
                _seeds(some + none),
                str(len(some)),
                _share(some, first_right),
                _share(some, all_right),
                _share(some, wrong_as_sure),
                _share(some, _unknown),
                _share(some, lambda r: not r["found"]),
                str(len(none)),
                _share(none, false_alarm),
            ]
        )
    return lines


def _seeds(rows: Sequence[Row]) -> str:
    """Return the seeds as ranges, for example "21, 31-40"."""
    seeds = sorted({int(r["seed"]) for r in rows})
    firsts = [s for s in seeds if s - 1 not in seeds]
    lasts = [s for s in seeds if s + 1 not in seeds]
    return ", ".join(f"{a}" if a == b else f"{a}-{b}" for a, b in zip(firsts, lasts, strict=True))


def _unknown(row: Row) -> bool:
    return bool(row["found"]) and row["attribution"][0] == "nonparametric"


def _share(rows: Sequence[Row], counts: Callable[[Row], bool]) -> str:
    return f"{sum(map(counts, rows)) / len(rows):.0%}" if rows else ""


def power(rows: Sequence[Row]) -> Lines:
    """Return the share named first by effect and size."""
    sizes = [(kind, size) for kind, size in SMALL_SIZES if good(rows, kind)]
    if len(sizes) < 2:
        return [[]]
    lines = [["truth", *(f"at {size:g}" for _, size in sizes)]]
    names = dict.fromkeys(r["effect"] for r in rows if r["kind"] in dict(sizes))
    for name in names:
        line = [str(name)]
        for kind, _ in sizes:
            cases = [r for r in good(rows, kind) if r["effect"] == name]
            line.append(f"{sum(map(first_right, cases))}/{len(cases)}" if cases else "")
        lines.append(line)
    every = ["all", *(_share(good(rows, kind), first_right) for kind, _ in sizes)]
    wrong = ["wrong, identified", *(_share(good(rows, kind), wrong_as_sure) for kind, _ in sizes)]
    return [*lines, every, wrong]


def oracles(rows: Sequence[Row]) -> Lines:
    """Return the error divided by that of the oracle (geometric mean over channels): median and 90 % quantile."""
    lines = [["kind", "cases", "10 s horizon, median", "90 %", "simulation, median", "90 %"]]
    for name in KINDS:
        found = [r["ratio"] for r in good(rows, name, lacking=True) if "ratio" in r]
        if found:
            cells = []
            for horizon in ("horizon", "simulation"):
                values = [r[horizon] for r in found]
                cells += [f"{np.median(values):.3f}", f"{np.quantile(values, 0.9):.3f}"]
            lines.append([name, str(len(found)), *cells])
    return lines


def shapes(rows: Sequence[Row]) -> Lines:
    """Return, for effects outside the catalogue, the share of the drawn curve whose 95 % band contains the true
    curve.
    """
    lines = [["truth", "cases", "right force and variable", "curves", "share of the curve in the band, median"]]
    for name in dict.fromkeys(r["effect"] for r in good(rows, "outside")):
        cases = [r for r in good(rows, "outside") if r["effect"] == name]
        held = [r["shape"] for r in cases if "shape" in r]
        lines.append(
            [
                name,
                str(len(cases)),
                f"{sum(map(first_right, cases))}/{len(cases)}",
                str(len(held)),
                f"{np.median(held):.2f}" if held else "",
            ]
        )
    return lines
