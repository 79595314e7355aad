"""The speaking half of a port whose device answers only when it is asked: the request, again and again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import final

from daq.setpoints import Due
from daq.talker import Talker


@final
class PollTalker(Talker):
    """Sends `request` every `period` wall seconds, on time on average; what was missed is not made up for."""

    def __init__(self, request: bytes, period: float) -> None:
        self._request, self._period = request, period
        self._due = 0.0

    def command(self, dues: Sequence[Due], held: Mapping[int, float], now: float) -> list[tuple[bytes, list[Due]]]:
        """It drives nothing."""
        return []

    def opened(self, now: float) -> None:
        """Ask at once."""
        self._due = now

    def poll(self, now: float) -> bytes:
        """The request when it is time for it."""
        if now < self._due:
            return b""
        self._due += self._period
        if self._due <= now:
            self._due = now + self._period
        return self._request

    def wait(self, now: float) -> float:
        """Until the next request."""
        return max(self._due - now, 0.0)
