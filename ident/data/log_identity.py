"""Identity of the logs, and of the parts of logs, that a model was fitted to: file, hash and interval of time."""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

HASH_DIGITS = 16  # of the SHA-256 in a line of the provenance
# Times at the end of a path, of a part of a log. A number follows if two parts have the same path.
PART = re.compile(r"\[([\d.e+]+):([\d.e+inf]+)\](?: \(\d+\))?\Z")
# Shorter overlaps are none: limits of parts are rounded to 0.1 s, and a fit uses a sample at both limits.
MIN_OVERLAP_S = 0.5


class LogPart(NamedTuple):
    """A log, or a part of one, in the provenance of a model or in the description of a loaded log.

    Attributes
    ----------
    name
        Name of the file.
    digest
        First 16 digits of the SHA-256 of the whole file; empty if they are unknown, as in a model file of an earlier
        version.
    t_from, t_to
        Interval of time [s] from the first sample of the log: 0 and infinity for the whole log.
    """

    name: str
    digest: str
    t_from: float
    t_to: float

    def same_file(self, other: LogPart) -> bool:
        """Return whether both are of one file: by the hashes, or by the names if a hash is unknown."""
        return self.digest == other.digest if self.digest and other.digest else self.name == other.name

    def overlap(self, other: LogPart) -> float:
        """Return the time [s] that both parts have in common; 0 for parts of two files, infinite for two whole logs."""
        if not self.same_file(other):
            return 0.0
        common = min(self.t_to, other.t_to) - max(self.t_from, other.t_from)
        return common if common > MIN_OVERLAP_S else 0.0

    @property
    def interval(self) -> str:
        """Interval of time in words, such as ``10 s to 60 s``; ``from 10 s on`` if it ends with the log."""
        return f"{self.t_from:g} s to {self.t_to:g} s" if self.t_to < inf else f"from {self.t_from:g} s on"


def part_of_line(line: str) -> LogPart:
    """Return the log of a line of the provenance, ``PATH sha256:HASH`` or ``PATH[FROM:TO] sha256:HASH``."""
    path, _, digest = line.partition(" sha256:")
    return _part(path, digest)


def part_of_log(about: Mapping[str, Any]) -> LogPart:
    """Return the identity of a loaded log from its description (`LoadedLog.about`)."""
    return _part(str(about["path"]), str(about.get("sha256") or ""))


def _part(path: str, digest: str) -> LogPart:
    """Return the identity of a log from its path, with the interval of time at its end, and its hash."""
    times = PART.search(path)
    t_from, t_to = (0.0, inf) if times is None else (float(times[1]), float(times[2]))
    return LogPart(Path(path[: times.start()] if times else path).name, digest[:HASH_DIGITS], t_from, t_to)
