"""Findings of a check, and their presentation as text."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from seatrial.daq.errors import counted

OK, UNKNOWN, WARNING, FAULT = "ok", "unknown", "warning", "fault"
LEVEL = 8  # width of the column of the level, in characters


class Finding(NamedTuple):
    """Result of one check of a rig or a log.

    Attributes
    ----------
    level : str
        Severity: `OK`, `UNKNOWN` (the data do not decide), `WARNING` (needs attention) or `FAULT` (makes a run or a fit
        meaningless).
    code : str
        Kind of the finding in kebab-case, such as "clock-jumps", for programs. It stays the same if the text changes.
    check : str
        Name of the check, such as "rate" or "clock".
    where : str
        Name of the device, thruster, signal or file that was checked.
    text : str
        The finding with its numbers.
    advice : str
        What to do about it; empty if no action is needed.
    """

    level: str
    code: str
    check: str
    where: str
    text: str
    advice: str = ""

    @property
    def is_problem(self) -> bool:
        """Whether the finding is a warning or a fault."""
        return self.level in (WARNING, FAULT)


def worst_first(findings: Iterable[Finding]) -> list[Finding]:
    """Return the findings of a check sorted by severity: faults, warnings, unknown, and those in order (`OK`).

    Findings of the same severity keep their order. The result is a new list.
    """
    order = (FAULT, WARNING, UNKNOWN, OK)
    return sorted(findings, key=lambda f: order.index(f.level))


def joined(findings: Iterable[Finding]) -> list[Finding]:
    """Join the findings that differ in nothing but the device or signal, such as a pause in all columns of a file.

    The names in ``where`` of a joined finding are separated by commas. The order is that of the first ones.
    """
    names: dict[Finding, list[str]] = {}
    for f in findings:
        names.setdefault(f._replace(where=""), []).append(f.where)
    return [f._replace(where=", ".join(where)) for f, where in names.items()]


def findings_lines(findings: Sequence[Finding]) -> list[str]:
    """Return each finding of a check as one line: severity, device or file, name of the check, text and advice.

    The first three are padded to columns. The advice follows the text after a colon. The order is kept.
    """
    rows = zip(_line_beginnings(findings), findings, strict=True)
    return [f"{head}{f.text}{f': {f.advice}' if f.advice else ''}" for head, f in rows]


def findings_paragraphs(findings: Sequence[Finding], width: int) -> list[str]:
    """Return the findings of a check as wrapped lines for a terminal.

    If severity, device or file, and name of the check need more than half of the width, the text of each finding begins
    on the next line.

    Parameters
    ----------
    findings : sequence of Finding
        The findings.
    width : int
        Width of the terminal in characters. Longer texts are wrapped, but each part of a text has room for 24
        characters at least.

    Returns
    -------
    list of str
        The lines. The advice of each finding starts on a new line.
    """
    heads = _line_beginnings(findings)
    beside = len(heads[0]) <= width // 2 if heads else True
    indent = len(heads[0]) if heads and beside else LEVEL + 1
    lines = []
    for head, f in zip(heads, findings, strict=True):
        texts = [f.text, *([f"→ {f.advice}"] if f.advice else [])]
        wrapped = [line for text in texts for line in textwrap.wrap(text, max(width - indent, 24))]
        rest = [" " * indent + line for line in wrapped]
        lines += [head + wrapped[0], *rest[1:]] if beside else [head.rstrip(), *rest]
    return lines


def _line_beginnings(findings: Sequence[Finding]) -> list[str]:
    """Return the beginning of the line of each finding: severity, device or file, and check, padded to one length.

    Each beginning ends with two spaces.
    """
    where_width = max((len(f.where) for f in findings), default=0)
    check_width = max((len(f.check) for f in findings), default=0)
    return [f"{f.level:<{LEVEL}} {f.where:<{where_width}}  {f.check:<{check_width}}  " for f in findings]


def findings_summary(findings: Sequence[Finding]) -> str:
    """Return the numbers of findings in words, such as "1 fault, 2 warnings, 5 in order".

    These three numbers are in the text, also if they are 0. A number of unknown findings, such as "1 unknown", is in
    the text only if there are any.
    """
    count = {level: sum(f.level == level for f in findings) for level in (FAULT, WARNING, OK, UNKNOWN)}
    unknown = f", {count[UNKNOWN]} unknown" if count[UNKNOWN] else ""
    return f"{counted(count[FAULT], 'fault')}, {counted(count[WARNING], 'warning')}, {count[OK]} in order{unknown}"
