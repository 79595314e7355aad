"""Rows of a result by record: one tab each."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from ident.results import LogSummary, Trace

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


def record_tabs(rows: Iterable[OfRecord], roles: Mapping[str, str]) -> list[RecordTab]:
    """The records that have rows, validation before estimation, else in the file's order."""
    names = list(dict.fromkeys(row.record for row in rows))
    order = {role: i for i, role in enumerate(ROLES)}
    tabs = [RecordTab(name, roles.get(name, "")) for name in names]
    return sorted(tabs, key=lambda tab: order.get(tab.role, len(order)))


def of_record(rows: Iterable[R], tab: RecordTab) -> list[R]:
    """The rows of one record."""
    return [row for row in rows if row.record == tab.name]
