"""Tabs of a report page: the table rows of a result, grouped by the record that they belong to."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from seatrial.ident.results import LogSummary, Trace

ROLES = ("validation", "estimation")  # order of the tabs: records that were not fitted are stronger evidence


class OfRecord(Protocol):
    """Any table row of a result that belongs to one record, and has its name in the field ``record``."""

    @property
    def record(self) -> str:
        """Name of the record that the row belongs to."""


R = TypeVar("R", bound=OfRecord)


@dataclass(frozen=True)
class RecordTab:
    """Tab of a report page for one record.

    Attributes
    ----------
    name
        Name of the record.
    role
        Role of the record: ``estimation``, ``validation``, ``navigated`` (its states were estimated by `seatrial ident
        navigate`), ``judged`` (its information was computed by `seatrial ident information`) or ``compared`` (models
        were compared on it); empty if unknown.
    """

    name: str
    role: str

    @property
    def title(self) -> str:
        """Label of the tab, ``ROLE · NAME``. An empty part is left out, and a name equal to the role is not repeated.

        The label is ``record`` if both are empty.
        """
        return " · ".join(dict.fromkeys(part for part in (self.role, self.name) if part)) or "record"


def roles_of(logs: Sequence[LogSummary], traces: Sequence[Trace] = ()) -> dict[str, str]:
    """Return the role of each record by its name, such as ``estimation``. The role of a trace replaces that of a log.

    Parameters
    ----------
    logs
        Logs of the result; each has the name of its record.
    traces
        Channels of the records over time, which have the role of their record too.
    """
    return {log.name: log.role for log in logs} | {row.record: row.role for row in traces}


def origin_words(logs: Sequence[LogSummary], record: str) -> str:
    """Return the origin of a record's x and y as the end of an axis title such as "north of its first fix".

    The text has a leading space: `` of its first fix``, or `` of the first fix of NAME`` if the origin is that of
    another log. It is empty if the log of the record has no known origin.

    Parameters
    ----------
    logs
        Logs of the result, with their origins.
    record
        Name of the record.
    """
    found = next((log.origin for log in logs if log.name == record), None)
    if found is None:
        return ""
    return " of its first fix" if found.log == record else f" of the first fix of {found.log or 'another log'}"


def origin_lines(logs: Sequence[LogSummary]) -> list[str]:
    """Return one sentence for each different origin: the latitude and longitude [deg] from which x and y count.

    A sentence names its logs only if not all logs have the same origin. The list is empty if no log has an origin.
    """
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
    """Return a tab for each record that has table rows.

    Validation records come first, then estimation records, then all others, each in the order of the rows.

    Parameters
    ----------
    rows
        Table rows of a result, each of one record.
    roles
        Role of each record by its name. A record that is missing has an unknown role.
    """
    names = list(dict.fromkeys(row.record for row in rows))
    order = {role: i for i, role in enumerate(ROLES)}
    tabs = [RecordTab(name, roles.get(name, "")) for name in names]
    return sorted(tabs, key=lambda tab: order.get(tab.role, len(order)))


def of_record(rows: Iterable[R], tab: RecordTab) -> list[R]:
    """Return those table rows of a result whose record has the name of the tab, in their order.

    The role of the tab is not compared.
    """
    return [row for row in rows if row.record == tab.name]
