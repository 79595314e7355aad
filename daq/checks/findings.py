"""What a check found: one line each, for people and for machines."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from seatrial.daq.errors import counted

OK, WARNING, FAULT = "ok", "warning", "fault"
LEVEL = 8  # columns of the level


class Finding(NamedTuple):
    """What one question to a rig or a log was answered with.

    ``level``: ok, warning or fault; ``code``: what was found, for programs, in kebab-case, and it stays the same when
    the words change; ``check``: the question; ``where``: device, thruster or file; ``text``: the answer with its
    numbers; ``advice``: what to do about it, empty when ok.
    """

    level: str
    code: str
    check: str
    where: str
    text: str
    advice: str = ""


def worst_first(findings: Iterable[Finding]) -> list[Finding]:
    """Faults, warnings, then the rest; the order within each stays."""
    order = (FAULT, WARNING, OK)
    return sorted(findings, key=lambda f: order.index(f.level))


def findings_lines(findings: Sequence[Finding]) -> list[str]:
    """A table, one line a finding, columns as wide as they have to be."""
    both = zip(_heads(findings), findings, strict=True)
    return [f"{head}{f.text}{f': {f.advice}' if f.advice else ''}" for head, f in both]


def findings_paragraphs(findings: Sequence[Finding], width: int) -> list[str]:
    """The same for a terminal of ``width`` columns: wrapped, and what to do on a line of its own."""
    heads = _heads(findings)
    beside = len(heads[0]) <= width // 2 if heads else True
    indent = len(heads[0]) if heads and beside else LEVEL + 1
    found = []
    for head, f in zip(heads, findings, strict=True):
        texts = [f.text, *([f"→ {f.advice}"] if f.advice else [])]
        wrapped = [line for text in texts for line in textwrap.wrap(text, max(width - indent, 24))]
        rest = [" " * indent + line for line in wrapped]
        found += [head + wrapped[0], *rest[1:]] if beside else [head.rstrip(), *rest]
    return found


def _heads(findings: Sequence[Finding]) -> list[str]:
    """Level, where and check of each, all of one length."""
    wide = max((len(f.where) for f in findings), default=0)
    what = max((len(f.check) for f in findings), default=0)
    return [f"{f.level:<{LEVEL}} {f.where:<{wide}}  {f.check:<{what}}  " for f in findings]


def findings_summary(findings: Sequence[Finding]) -> str:
    """How many of each."""
    count = {level: sum(f.level == level for f in findings) for level in (FAULT, WARNING, OK)}
    return f"{counted(count[FAULT], 'fault')}, {counted(count[WARNING], 'warning')}, {count[OK]} in order"
