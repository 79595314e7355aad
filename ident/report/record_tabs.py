"""Tabs of a report page: the table rows of a result, grouped by the record that they belong to."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import msgspec
import numpy as np

from seatrial.daq.errors import counted
from seatrial.ident.data import BLOCK_TIMES
from seatrial.ident.numerics import Array
from seatrial.ident.results import BLOCKS, CURVES, LogSummary, Trace

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
    blocks
        Names of the records of the tab, if they are blocks in time of the log ``name``; otherwise empty.
    """

    name: str
    role: str
    blocks: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """Label of the tab, ``ROLE · NAME``. An empty part is left out, and a name equal to the role is not repeated.

        The label is ``record`` if both are empty. The number of blocks follows, if the tab has blocks.
        """
        title = " · ".join(dict.fromkeys(part for part in (self.role, self.name) if part)) or "record"
        return f"{title}, {counted(len(self.blocks), 'block')}" if self.blocks else title


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


def log_of_block(record: str, logs: Iterable[str]) -> str | None:
    """Return the name of the log that a record is a block in time of; None if it is no block of any of the ``logs``.

    A block has the name of its log and its times in brackets, for example ``run_01[55.8:111.6]``. A part of a log that
    was fitted as a log of its own has a name of this form too, and is no block.
    """
    names = set(logs)
    log = BLOCK_TIMES.sub("", record)
    return log if log != record and record not in names and log in names else None


def run_tabs(rows: Iterable[OfRecord], roles: Mapping[str, str], logs: Sequence[LogSummary]) -> list[RecordTab]:
    """Return the tabs of `record_tabs`, with one tab in place of those of all blocks of one log.

    The role of blocks of an estimation log that take the place of validation logs is "blocks of time".

    Parameters
    ----------
    rows
        Table rows of a result, each of one record.
    roles
        Role of each record by its name. A record that is missing has an unknown role.
    logs
        Logs of the result.
    """
    names, estimated = [log.name for log in logs], {log.name for log in logs if log.role == "estimation"}
    grouped: dict[tuple[str, str], RecordTab] = {}
    for tab in record_tabs(rows, roles):
        log = log_of_block(tab.name, names)
        key = (tab.name if log is None else log, tab.role if log is None else f"{tab.role}, blocks")
        before = grouped[key].blocks if key in grouped else ()
        role = BLOCKS if log in estimated and tab.role == "validation" else tab.role
        grouped[key] = tab if log is None else RecordTab(log, role, (*before, tab.name))
    return list(grouped.values())


def of_record(rows: Iterable[R], tab: RecordTab) -> list[R]:
    """Return those table rows of a result whose record is that of the tab, or one of its blocks, in their order.

    The role of the tab is not compared.
    """
    names = tab.blocks or (tab.name,)
    return [row for row in rows if row.record in names]


def by_channel(traces: Iterable[Trace]) -> list[list[Trace]]:
    """Return the traces of each channel, in the order of the channels: one trace, or those of the blocks of a log."""
    found: dict[str, list[Trace]] = {}
    for row in traces:
        found.setdefault(row.channel, []).append(row)
    return list(found.values())


def joined(blocks: Sequence[Trace]) -> Trace:
    """Return one trace of the blocks of a log in their order, with a gap (NaN) between two blocks.

    The record of the trace is that of the first block, and ``diverged`` is None if there are several blocks. A curve
    that a block lacks is None.
    """
    if len(blocks) == 1:
        return blocks[0]
    curves: dict[str, Array | None] = {}
    for axis, names in CURVES[Trace].items():
        for name in (axis, *names):
            found = [getattr(block, name) for block in blocks]
            # the time of a gap is that of the point before it
            ends = [a[-1:] if name == axis else np.full(a[-1:].size, np.nan) for a in found if a is not None]
            whole = None if len(ends) < len(found) else [x for pair in zip(found, ends, strict=True) for x in pair]
            curves[name] = None if whole is None else np.concatenate(whole[:-1])
    return msgspec.structs.replace(blocks[0], diverged=None, **curves)
