"""Rows of a result by record: one tab each."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from seatrial.ident.results import LogSummary, Trace

ROLES = ("validation", "estimation")  # the order of showing: what was not fitted convinces more


class OfRecord(Protocol):
    """A row that belongs to a record."""

    @property
    def record(self) -> str: ...


R = TypeVar("R", bound=OfRecord)


@dataclass(frozen=True)
class RecordTab:
    """One record as the page shows it: a tab."""

    name: str
    role: str

    @property
    def title(self) -> str:
        """What stands on the tab."""
        return " · ".join(dict.fromkeys(part for part in (self.role, self.name) if part)) or "record"


def roles_of(logs: Sequence[LogSummary], traces: Sequence[Trace] = ()) -> dict[str, str]:
    """The role of each record, by name."""
    return {log.name: log.role for log in logs} | {row.record: row.role for row in traces}


def origin_words(logs: Sequence[LogSummary], record: str) -> str:
    """`` of its first fix`` or `` of the first fix of NAME`` where a record's x and y count from there; else empty."""
    found = next((log.origin for log in logs if log.name == record), None)
    if found is None:
        return ""
    return " of its first fix" if found.log == record else f" of the first fix of {found.log or 'another log'}"


def origin_lines(logs: Sequence[LogSummary]) -> list[str]:
    """Where x and y of the logs count from, a line for each place."""
    origins: dict[tuple[float, float, str], list[str]] = {}
    for log in logs:
        if log.origin is not None:
            origins.setdefault((log.origin.latitude, log.origin.longitude, log.origin.log), []).append(log.name)
    lines = []
    for (latitude, longitude, first), names in origins.items():
        of = ", ".join(names) if len(origins) > 1 or len(names) < len(logs) else ""
        lines.append(
            f"x and y{' of ' * bool(of)}{of} count from {latitude:.7f}, {longitude:.7f} (latitude, longitude)"
            f"{', the first fix of ' * bool(first)}{first}"
        )
    return lines


def record_tabs(rows: Iterable[OfRecord], roles: Mapping[str, str]) -> list[RecordTab]:
    """The records that have rows, validation before estimation, else in the file's order."""
    names = list(dict.fromkeys(row.record for row in rows))
    order = {role: i for i, role in enumerate(ROLES)}
    tabs = [RecordTab(name, roles.get(name, "")) for name in names]
    return sorted(tabs, key=lambda tab: order.get(tab.role, len(order)))


def of_record(rows: Iterable[R], tab: RecordTab) -> list[R]:
    """The rows of one record."""
    return [row for row in rows if row.record == tab.name]
