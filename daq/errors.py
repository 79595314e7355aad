"""The errors and warnings that a user is meant to read, and how a line counts."""

from __future__ import annotations


class SeatrialError(Exception):
    """The work failed for a reason that the user can act on.

    The message is ONE clear line: what failed, where, and what to do about it. The front door prints it after
    `seatrial: ` and leaves with `exit_status`; a part that reports more derives its own class.
    """

    exit_status = 1


class SafetyStop(SeatrialError):
    """A safety limit ended the run: the thrusters are at zero and the log so far is kept."""

    exit_status = 3


class SeatrialWarning(RuntimeWarning):
    """The work goes on, but not as the user may expect. ONE clear line, which the front door prints like an error's."""


def counted(number: int, word: str) -> str:
    """1 fault, 2 faults."""
    return f"{number} {word}{'' if number == 1 else 's'}"


class _Spelled(dict[int, str]):
    """What `printable` makes of each character, by its number. `str.translate` is ten times as fast as a loop."""

    def __missing__(self, number: int) -> str:
        c = chr(number)
        found = c if c.isprintable() or c == "\n" else " " if c.isspace() else ascii(c)[1:-1]
        if number < 1 << 16:
            self[number] = found
        return found


_SPELLED = _Spelled()


def printable(text: str) -> str:
    """A text of somebody else's, for a terminal: what would move its cursor, colour it or turn it around is spelled.
    Lines stay lines."""
    return text if text.isprintable() else text.translate(_SPELLED)
