"""Where a run stands in its mission. Run time in, set-points out; reads no clock."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from bench.mission import Mission
from bench.tare import windows_of

Row = tuple[float, dict[str, float]]  # run time, n_cmd by thruster


class Span(NamedTuple):
    """A segment's place on the run clock [s]."""

    begin: float
    end: float
    segment: int
    name: str


class Timeline:
    """A mission on the run clock; it can be taken up again at any of its segments."""

    def __init__(self, mission: Mission, start: float) -> None:
        """The mission's time 0 is run time `start`."""
        self._mission = mission
        self._done: list[Span] = []
        self._lay(0, start)

    def _lay(self, segment: int, start: float) -> None:
        """Lay the segments from this one on, their own time running from `start`."""
        self._start = start
        rest = replace(self._mission, segments=self._mission.segments[segment:])
        t, n = rest.setpoints()  # the slew limit begins at zero again
        self._t, self._n, self._sent = t + start, n, 0
        self._spans = [Span(start + a, start + b, segment + k, name) for k, (a, b, name) in enumerate(rest.starts())]

    def restart(self, segment: int, start: float) -> None:
        """Zero was commanded: take the mission up again with the first row of `segment` at `start`."""
        self._done += [span for span in self._spans if span.segment < segment]
        self._lay(segment, start - float(self._mission.segments[segment].t[0]))

    @property
    def end(self) -> float:
        """Run time from which thrust is zero."""
        return self._spans[-1].end

    def rows(self, until: float) -> list[Row]:
        """The set-points before run time `until` that were not asked for before."""
        rows: list[Row] = []
        while self._sent < len(self._t) and self._t[self._sent] < until:
            values = dict(zip(self._mission.thrusters, self._n[self._sent].tolist(), strict=True))
            rows.append((float(self._t[self._sent]), values))
            self._sent += 1
        return rows

    def begun(self, now: float) -> list[Span]:
        """The segments that have begun since the start or the restart."""
        return [span for span in self._spans if span.begin <= now]

    def elapsed(self, now: float) -> float:
        """The mission's own time at `now`."""
        return now - self._start

    def static_windows(self) -> list[tuple[str, float, float]]:
        """The rest at the start and at the end, as it came to be."""
        return windows_of([(span.begin, span.end, span.name) for span in [*self._done, *self._spans]])
