"""What a check found: one line each, for people and for machines."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

OK, WARNING, FAULT = "ok", "warning", "fault"


class Finding(NamedTuple):
    """``level`` is ok, warning or fault; what was found where, and what to do about it (empty when ok)."""

    level: str
    check: str
    where: str
    text: str
    advice: str = ""


def from_dict(values: Mapping[str, str]) -> Finding:
    """A finding of another part; its keys are the fields."""
    return Finding(*(str(values[name]) for name in Finding._fields))


def worst_first(findings: Iterable[Finding]) -> list[Finding]:
    """Faults, warnings, then what is in order; the order within each stays."""
    order = (FAULT, WARNING, OK)
    return sorted(findings, key=lambda f: order.index(f.level))


def lines(findings: Sequence[Finding]) -> list[str]:
    """A table, one line a finding, columns as wide as they have to be."""
    wide = max((len(f.where) for f in findings), default=0)
    what = max((len(f.check) for f in findings), default=0)
    return [
        f"{f.level:<8} {f.where:<{wide}}  {f.check:<{what}}  {f.text}{f': {f.advice}' if f.advice else ''}"
        for f in findings
    ]


def summary(findings: Sequence[Finding]) -> str:
    """How many of each."""
    count = {level: sum(f.level == level for f in findings) for level in (FAULT, WARNING, OK)}
    return f"{counted(count[FAULT], 'fault')}, {counted(count[WARNING], 'warning')}, {count[OK]} in order"


def counted(number: int, word: str) -> str:
    """1 fault, 2 faults."""
    return f"{number} {word}{'' if number == 1 else 's'}"
