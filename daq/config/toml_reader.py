"""Strict reading of TOML: an unknown or missing key or a wrong type is one line that names file and key."""

from __future__ import annotations

import difflib
import math
import os
import stat
import tomllib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from seatrial.daq.errors import SeatrialError, counted

_MISSING = object()
NEAR = 0.75  # likeness of two keys, by difflib, of which one is a slip of the other
HUGE = 1e15  # numbers beyond are not written out: they may have thousands of digits


def parse_toml(text: str, source: Path | str) -> TomlTable:
    """The root table of `text`, read from `source`. Raises SeatrialError where it is not TOML."""
    try:
        return TomlTable(tomllib.loads(text), str(source))
    except tomllib.TOMLDecodeError as error:
        raise SeatrialError(f"{source}: not valid TOML: {error}") from error
    except (RecursionError, ValueError) as error:  # brackets in thousands, or a number of thousands of digits
        raise SeatrialError(f"{source}: not read: nested too deeply, or a number with too many digits") from error


def read_text(path: Path) -> str:
    """Return the UTF-8 text of a file. Raises SeatrialError in one line if it cannot be read, as a pipe or a device."""
    try:
        # Opening a named pipe in the usual way would wait for its writer.
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY), encoding="utf-8") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise SeatrialError(f"{path}: is not a file")
            return file.read()
    except UnicodeDecodeError as error:
        if b"\0" in error.object:
            raise SeatrialError(f"{path}: not a text file; a TOML file is expected") from error
        raise SeatrialError(f"{path}: not UTF-8 text (byte {error.start}); save it as UTF-8") from error
    except OSError as error:
        raise SeatrialError(f"{path}: {error.strerror or error}") from error


class TomlTable:
    """One TOML table whose keys are read one by one; `done` raises for a key that was not read."""

    def __init__(self, values: Mapping[str, object], source: str, where: str = "") -> None:
        self.values: dict[str, Any] = dict(values)
        self.source = source
        self.where = where
        self._taken: list[str] = []

    def error(self, key: str, problem: str) -> SeatrialError:
        """The error of one key, to be raised: file, full key, problem."""
        return SeatrialError(f"{self.source}: {self._name(key)}: {problem}")

    def _name(self, key: str) -> str:
        return f"{self.where}.{key}" if self.where else key

    def _take(self, key: str, default: object) -> object:
        self._taken.append(key)
        if key in self.values:
            return self.values[key]
        if default is _MISSING:
            raise self.error(key, f"missing; this key is required{self.misspelt(key)}")
        return default

    def misspelt(self, key: str) -> str:
        """Return the end of an error line that names a key like a missing one, "" if there is none."""
        others = [name for name in self.values if name not in self._taken]
        near = difflib.get_close_matches(key, others, 1, NEAR)
        return f"; {near[0]!r} is there: is it meant?" if near else ""

    def has(self, key: str) -> bool:
        """Whether the file gives the key at all."""
        return key in self.values

    def text(self, key: str, default: object = _MISSING, choices: Collection[str] = ()) -> str:
        """A string; one of `choices` where those are given."""
        value = self._take(key, default)
        if not isinstance(value, str):
            raise self.error(key, f"must be text in quotes, not {_kind(value)}")
        if choices and value not in choices:
            one = f"must be '{next(iter(choices))}'" if len(choices) == 1 else f"must be one of {', '.join(choices)}"
            raise self.error(key, f"{one}, not '{value}'")
        return value

    def line(self, key: str, default: object = _MISSING) -> str:
        """A string for a terminal, which obeys what is not printable: the file may be somebody else's."""
        value = self.text(key, default)
        if not value.isprintable():
            raise self.error(key, f"has characters that are not printable: {value!r}")
        return value

    def flag(self, key: str, default: object = _MISSING) -> bool:
        """true or false."""
        value = self._take(key, default)
        if not isinstance(value, bool):
            raise self.error(key, f"must be true or false, not {_kind(value)}")
        return value

    def integer(self, key: str, default: object = _MISSING, low: int | None = None, high: int | None = None) -> int:
        """A whole number within [low, high]."""
        value = self._take(key, default)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(key, f"must be a whole number, not {_kind(value)}")
        self._check_range(key, value, low, high)
        return value

    def number(
        self,
        key: str,
        default: object = _MISSING,
        low: float | None = None,
        high: float | None = None,
        positive: bool = False,
    ) -> float:
        """A finite number within [low, high], above zero where `positive`."""
        value = self._take(key, default)
        number = self._finite(key, value)
        if positive and number <= 0.0:
            raise self.error(key, f"must be above zero, not {number:g}")
        self._check_range(key, number, low, high)
        return number

    def scalar(self, key: str, default: object = _MISSING) -> str | float | bool:
        """Return a text, a finite number, true or false."""
        value = self._take(key, default)
        if isinstance(value, (str, bool)):
            return value
        return self._finite(key, value)

    def maybe_number(self, key: str, low: float | None = None, high: float | None = None) -> float | None:
        """As `number`, or None where the key is absent."""
        return self.number(key, low=low, high=high) if key in self.values else None

    def numbers(self, key: str, default: object = _MISSING, length: int | None = None) -> tuple[float, ...]:
        """A list of finite numbers, of the given length where one is given."""
        value = self._take(key, default)
        if not isinstance(value, (list, tuple)):
            raise self.error(key, f"must be a list of numbers, not {_kind(value)}")
        if length is not None and len(value) != length:
            raise self.error(key, f"must have {counted(length, 'number')}, not {len(value)}")
        return tuple(self._finite(key, item) for item in value)

    def named_numbers(self) -> dict[str, float]:
        """Every number of the table by its name, which is printable."""
        for key in self.values:
            if not key.isprintable():
                raise self.error(repr(key), "a name with characters that are not printable")
        return {key: self.number(key) for key in self.values}

    def texts(self, key: str, default: object = _MISSING) -> tuple[str, ...]:
        """A list of strings."""
        value = self._take(key, default)
        if not isinstance(value, (list, tuple)) or not all(isinstance(item, str) for item in value):
            raise self.error(key, "must be a list of texts in quotes")
        return tuple(value)

    def table(self, key: str) -> TomlTable | None:
        """The sub-table, or None where it is absent."""
        value = self._take(key, None)
        if value is None:
            return None
        if not isinstance(value, dict):
            raise self.error(key, f"must be a table, [{self._name(key)}], not {_kind(value)}")
        return TomlTable(value, self.source, self._name(key))

    def tables(self, key: str) -> list[TomlTable]:
        """The tables of a `[[key]]` list, in order; empty where it is absent."""
        value = self._take(key, [])
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.error(key, f"must be a list of tables, [[{self._name(key)}]]")
        return [TomlTable(item, self.source, f"{self._name(key)}[{i}]") for i, item in enumerate(value, start=1)]

    def done(self) -> None:
        """Raise for the first key that was not read, with the known ones in the text."""
        for key in self.values:
            if key not in self._taken:
                known = ", ".join(dict.fromkeys(self._taken))
                raise self.error(key, f"unknown key; known here: {known}")

    def _finite(self, key: str, value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.error(key, f"must be a number, not {_kind(value)}")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise self.error(key, "must be a finite number")
        return number

    def _check_range(self, key: str, value: float, low: float | None, high: float | None) -> None:
        if (low is not None and value < low) or (high is not None and value > high):
            bounds = f"{'' if low is None else low} .. {'' if high is None else high}".strip()
            raise self.error(key, f"must be within {bounds}, not {_kind(value)}")


def _kind(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return f"{value:g}" if not abs(value) >= HUGE else "so large a number"
    names: dict[type, str] = {str: "text", list: "a list", dict: "a table"}
    return names.get(type(value), "a date or time")
