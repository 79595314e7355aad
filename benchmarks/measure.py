"""How things are timed here, and what a result looks like."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """One number of the table; ``peer``: what another program reached on the same data, where there is one."""

    group: str
    name: str
    value: float
    unit: str
    peer: float | None = None
    note: str = ""


def best_ms(call: Callable[[], object], repeats: int = 10) -> float:
    """The least time of a call, ms: what else the machine does only adds to it. The first call is not counted."""
    call()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return 1e3 * min(times)


def table(figures: list[Figure]) -> str:
    """Lines for people, a heading a group."""
    lines, group = [], ""
    for f in figures:
        if f.group != group:
            group = f.group
            lines += ["", group]
        peer = "" if f.peer is None else f"   peer {f.peer:.9g} {f.unit}"
        note = f"   {f.note}" if f.note else ""
        lines.append(f"  {f.name:<42} {_number(f.value):>14} {f.unit:<12}{peer}{note}".rstrip())
    return "\n".join(lines[1:])


def _number(value: float) -> str:
    if abs(value) < 10_000:
        return f"{value:.4g}"
    return f"{value:.4f}" if value < 0 else f"{value:,.0f}"  # a likelihood to its last digit, a rate in round numbers
