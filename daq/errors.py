"""Errors and warnings for the user, and helpers for their texts."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import TypeVar

NEAR = 0.75  # similarity of two names by difflib, from which one is probably a misspelling of the other
MISTYPED = 0.9  # the same, from which two names differ by hardly a character
OWN_FRAMES = ("seatrial", "contextlib")  # packages whose calls are not shown as the place of a warning
MOST_FILES = 10_000  # of a folder that are searched for a similar name
MAX_NAMES = 12  # names that the hint about an unknown one lists
SHORTEST_STEM = 3  # characters of a name that may stand for a longer one, such as rate for rate_hz

V = TypeVar("V")


class SeatrialError(Exception):
    """Error whose cause the user can remove.

    The message is ONE clear line: what failed, where, and what to do about it. The command line prints it after
    `seatrial: ` and exits with `exit_status`, 1. A part that needs another exit status derives its own class. A fact
    that must not hide in a long message, such as the path of a log, may stand in `detail`; the command line prints it
    below the message as one line of its own.
    """

    exit_status = 1
    detail = ""


class UnknownName(SeatrialError, KeyError):
    """Error about a name that a mapping or a model lacks. It is a KeyError too, as Python's mappings need one."""

    def __str__(self) -> str:
        """Return the message without the quotes that a KeyError adds."""
        return str(self.args[0]) if self.args else ""


class UnknownAttribute(SeatrialError, AttributeError):
    """Error about an attribute that an object lacks. It is an AttributeError too, as ``hasattr`` needs one."""


class SafetyStop(SeatrialError):
    """Error of a run that was ended for safety. Zero was commanded, and the log so far is kept. Exit status: 3."""

    exit_status = 3


class SeatrialWarning(RuntimeWarning):
    """Warning that a command continues, but not as the user may expect.

    The message is ONE clear line, which the command line prints as it prints that of an error.
    """


def warn(text: str) -> None:
    """Issue a `SeatrialWarning` whose file and line are those of the user's code that called this software.

    Frames of seatrial and of `contextlib`, whose context managers stand between two functions of seatrial, are skipped.
    ``text`` is one clear line.
    """
    # `skip_file_prefixes` of `warnings.warn` would do this, but exists only from Python 3.12.
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in OWN_FRAMES:
        level, frame = level + 1, frame.f_back
    warnings.warn(text, SeatrialWarning, stacklevel=level)


def counted(number: int, word: str) -> str:
    """Return a number with its noun, as "1 fault" or "2 faults". The plural, also of 0, is `word` and an s."""
    return f"{number} {word}{'' if number == 1 else 's'}"


def closest_name(name: str, known: Iterable[str]) -> str | None:
    """Return the known name for which `name` is probably a misspelling or an abbreviation; None if there is none.

    A known name is close if one of the two begins with the other (`rate` and `rate_hz`; the shorter one has at least
    three characters), or if difflib finds them similar. Names that are nearly equal (`compassmotor` and
    `compass-motor`) are as close as those of which one begins with the other. Of several close names the most similar
    one is returned. Upper case and lower case are the same, and a dash is the same as an underscore.
    """
    from difflib import SequenceMatcher  # imported here, because only errors need it

    def likeness(a: str, b: str) -> float:
        """Return the similarity of two names, 0 to 1.

        It is above 1 if one begins with the other, of 3 characters or more, or if they differ by hardly a character.
        """
        a, b = (text.lower().replace("-", "_") for text in (a, b))
        begins = min(len(a), len(b)) >= SHORTEST_STEM and (a.startswith(b) or b.startswith(a))
        ratio = SequenceMatcher(None, a, b).ratio()
        return ratio + (begins or ratio > MISTYPED)

    best = max(((likeness(name, other), other) for other in known), key=lambda pair: pair[0], default=(0.0, ""))
    return best[1] if best[0] >= NEAR else None


def closest_file(path: Path) -> Path | None:
    """Return the file or folder beside a missing path of which its name is probably a misspelling; None without one.

    Names with the same ending come first.
    """
    try:
        entries = islice(path.parent.iterdir(), MOST_FILES)
        names = sorted(entry.name for entry in entries if not entry.name.startswith("."))
    except OSError:
        return None
    same = [name for name in names if Path(name).suffix == path.suffix]
    near = closest_name(path.name, same) or closest_name(path.name, names)
    return path.with_name(near) if near else None


def file_hint(path: Path) -> str:
    """Return a hint for a missing file, as "did you mean 'run1.mcap'? ", or an empty text without a similar name."""
    near = closest_file(path)
    return f"did you mean {str(near)!r}? " if near else ""


class NamedValues(dict[str, V]):
    """Dictionary of values by name, whose `UnknownName` for an unknown name names the most similar one.

    Without a similar name, the message has all names, or the first `MAX_NAMES` of them and the number of the others.

    Parameters
    ----------
    values
        The values by name.
    what
        The kind of value, for the message, such as "parameter".
    """

    def __init__(self, values: Mapping[str, V], what: str) -> None:
        """Copy the values, and store the kind of value."""
        super().__init__(values)
        self._what = what

    def __missing__(self, name: object) -> V:
        """Raise `UnknownName`, a KeyError, with the most similar name."""
        raise UnknownName(f"there is no {self._what} {name!r}; {names_hint(str(name), self)}")


def names_hint(name: str, known: Iterable[str]) -> str:
    """Return a hint for an unknown name: the similar one, as "did you mean 'psi'?", or else the known names.

    Of more than `MAX_NAMES` known names, it has the first ones and the number of the others.
    """
    known = [str(other) for other in known]  # such as the horizons of predictions, which are numbers
    if near := closest_name(name, known):
        return f"did you mean {near!r}?"
    return f"the names are {first_names(known)}" if known else "there are none"


def first_names(names: Sequence[str], most: int = MAX_NAMES) -> str:
    """Return names separated by commas. Of more than ``most``, the first ones are followed by "and 3 more"."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


class _EscapeTable(dict[int, str]):
    """Table for `str.translate` that replaces each unsafe character by its escape sequence; see `printable`.

    A key is the code point of a character. The table is filled on demand, and is ten times as fast as a loop.
    """

    def __missing__(self, number: int) -> str:
        """Return the safe replacement of the character with the code point `number`; a safe character stays.

        The replacement is stored in the table if the code point is below 65,536, so that the table stays small.
        """
        c = chr(number)
        replacement = c if c.isprintable() or c == "\n" else " " if c.isspace() else ascii(c)[1:-1]
        if number < 1 << 16:
            self[number] = replacement
        return replacement


_ESCAPES = _EscapeTable()


def printable(text: str) -> str:
    """Return a text from an untrusted source in a form that is safe to print on a terminal.

    Characters that are not printable, such as control characters, which could move the cursor, change colours or
    reverse the text, are replaced by their escape sequences. White space becomes a space, but line ends (LF) stay.
    """
    return text if text.isprintable() else text.translate(_ESCAPES)
