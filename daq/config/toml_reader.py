"""Strict reader of TOML: an unknown key, a missing key or a wrong type is an error of one line with file and key."""

from __future__ import annotations

import math
import os
import re
import stat
import tomllib
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any, TypeVar

from seatrial.daq.errors import SeatrialError, closest_name, counted

_MISSING = object()  # default of a required key
Read = TypeVar("Read")
AT_LINE = re.compile(r"at line (\d+)")  # place of an error of the TOML parser
# A value that begins with a number and goes on as a unit, or a word without quotes, with its key
VALUE = re.compile(
    r"(?P<key>[\w.-]+)\s*=\s*(?:(?P<value>[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)(?P<space>\s*)"
    r"(?P<unit>[^\W\d_][\w/^²³·]*|[%°]\w*)|(?P<word>[^\W\d_]\w*(?:-\w+)*))\s*(?=[,}\]#]|$)"
)
HUGE = 1e15  # larger numbers are not printed, because they may have thousands of digits


def parse_toml(text: str, source: Path | str) -> TomlTable:
    """Return the root table of a TOML text.

    Parameters
    ----------
    text
        Text of a TOML file.
    source
        Path of the file, which error messages name. The file itself is not read.

    Raises
    ------
    SeatrialError
        If the text is not valid TOML, is nested too deeply, or contains a number with thousands of digits.
    """
    try:
        return TomlTable(tomllib.loads(text), str(source))
    except tomllib.TOMLDecodeError as error:
        raise SeatrialError(f"{source}: {_explained(text, error)}") from None
    except (RecursionError, ValueError):  # thousands of brackets, or a number with thousands of digits
        raise SeatrialError(
            f"{source}: cannot be read: tables are nested too deeply, or a number has too many digits; correct the text"
        ) from None


def _explained(text: str, error: tomllib.TOMLDecodeError) -> str:
    """Return what is wrong with a TOML text, and what to write: a number with a unit or a text without quotes, if so.

    The parser stops at the unit and names only its place.
    """
    place = AT_LINE.search(str(error))
    lines = text.splitlines()
    if place is not None and 0 < (number := int(place[1])) <= len(lines):
        line = lines[number - 1]
        for found in VALUE.finditer(line):
            key, value, unit = found["key"], found["value"], found["unit"]
            if unit:
                return (
                    f"line {number}: not valid TOML: {key} = {value}{found['space']}{unit} is a number with a unit; "
                    f"write the number alone, in the unit that the format states: {key} = {value}"
                )
            if (word := found["word"]) is not None and word not in ("true", "false", "inf", "nan"):
                return f'line {number}: not valid TOML: {key} = {word} is a text without quotes; write {key} = "{word}"'
    return f"not valid TOML: {error}; correct the text there"


def read_text(path: Path) -> str:
    """Return the UTF-8 text of a file.

    Raises
    ------
    SeatrialError
        If the file cannot be read, is not UTF-8 text, or is a folder, a pipe or a device.
    """
    try:
        # Opening a named pipe without O_NONBLOCK would wait for its writer.
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY), encoding="utf-8") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise SeatrialError(f"{path}: is not a file; give the path of a file")
            return file.read()
    except UnicodeDecodeError as error:
        if b"\0" in error.object:
            raise SeatrialError(f"{path}: not a text file; give a TOML file") from None
        raise SeatrialError(f"{path}: not UTF-8 text (byte {error.start}); save it as UTF-8") from None
    except OSError as error:
        raise SeatrialError(
            f"{path}: cannot be read: {error.strerror or error}; check its path and permissions"
        ) from None


class ErrorCollector:
    """Collector of the errors of the tables of one file, so that the user gets all of them at once."""

    def __init__(self) -> None:
        """Start without an error."""
        self._errors: list[SeatrialError] = []

    def tried(self, read: Callable[[], Read], default: Read) -> Read:
        """Call `read` and return its result. If it raises SeatrialError, store the error and return `default`.

        The caller must call `raise_all` before it uses the result.
        """
        try:
            return read()
        except SeatrialError as error:
            self._errors.append(error)
            return default

    def raise_all(self) -> None:
        """Raise one SeatrialError with all kept errors, if there are any. A single error is raised as it was."""
        if len(self._errors) == 1:
            raise self._errors[0]
        if self._errors:
            first, *others = (str(error) for error in self._errors)
            source = first.partition(": ")[0]
            more = " | ".join(text.removeprefix(f"{source}: ") for text in others)
            raise SeatrialError(f"{first} | {counted(len(others), 'more error')}: {more}") from self._errors[0]


class TomlTable:
    """TOML table whose keys are read one by one. At the end, `done` raises an error for a key that was not read.

    The methods that read a key raise SeatrialError if the key is missing and has no default, or if its value is wrong.

    Attributes
    ----------
    values
        Values by key, as the TOML parser returns them.
    source
        Path of the file, which error messages name.
    where
        Full name of the table in the file, such as `device[2].calibration`; empty for the root table.
    label
        What the table describes, such as `signal 'psi'`, for error messages behind the key; empty by default.
    """

    def __init__(self, values: Mapping[str, object], source: str, where: str = "") -> None:
        """Wrap the values of a table, of which no key counts as read.

        `source` is the path of the file and `where` the name of the table in it, both for error messages.
        """
        self.values: dict[str, Any] = dict(values)
        self.source = source
        self.where = where
        self.label = ""
        self._taken: list[str] = []  # keys that were read
        self._known: list[str] = []  # keys that were read or asked for, for messages

    def error(self, key: str, problem: str) -> SeatrialError:
        """Return an error whose message has the file, the full key and the problem. The caller raises it."""
        whose = f" ({self.label})" if self.label else ""
        return SeatrialError(f"{self.source}: {self._full_key(key)}{whose}: {problem}")

    def _full_key(self, key: str) -> str:
        """Return the name of a key with the name of its table before it, such as `limits.n_max`."""
        return f"{self.where}.{key}" if self.where else key

    def _read_value(self, key: str, default: object) -> object:
        """Return the value of a key, or `default` if the table lacks the key, and note that the key was read.

        If the key is missing and there is no default (_MISSING), SeatrialError is raised. The message suggests an
        unread key with a similar name.
        """
        self._taken.append(key)
        self._known.append(key)
        if key in self.values:
            return self.values[key]
        if default is _MISSING:
            raise self.error(key, f"missing{self.misspelling_hint(key) or '; add this required key'}")
        return default

    def misspelling_hint(self, key: str) -> str:
        """Return the end of an error message on the missing key `key`: an unread key that is spelt similarly.

        Of several the most similar one is named. The text begins with "; ". It is empty if no unread key is similar,
        or if the table has the key.
        """
        unread = [name for name in self.values if name not in self._taken]
        near = None if key in self.values else closest_name(key, unread)
        return f"; the table has {near!r}: rename it to {key!r}" if near else ""

    def has(self, key: str) -> bool:
        """Return whether the table contains the key. The key does not count as read by this, but as a known key."""
        self._known.append(key)
        return key in self.values

    def text(self, key: str, default: object = _MISSING, choices: Collection[str] = ()) -> str:
        """Return the string of a key, or `default` if the key is missing.

        Another type, a string that is not one of `choices` (unless this is empty), and a missing key without `default`
        raise SeatrialError. The default must be a string too, and is checked in the same way.
        """
        value = self._read_value(key, default)
        if not isinstance(value, str):
            raise self.error(key, f"must be text in quotes, not {_describe_value(value)}")
        if choices and value not in choices:
            named = [choice for choice in choices if choice]  # an empty text stands for a missing key
            rule = f"must be '{named[0]}'" if len(named) == 1 else f"must be one of {', '.join(named)}"
            raise self.error(key, f"{rule}, not '{value}'")
        return value

    def line(self, key: str, default: object = _MISSING) -> str:
        """Return the string of a key, or `default` if the key is missing. All its characters must be printable.

        Otherwise, and for a missing key without `default`, SeatrialError is raised. The string may be empty. A terminal
        would execute control characters, and the file may be from an unknown person.
        """
        value = self.text(key, default)
        if not value.isprintable():
            raise self.error(key, f"has characters that are not printable: {value!r}; remove them")
        return value

    def flag(self, key: str, default: object = _MISSING) -> bool:
        """Return the boolean value of a key, or `default` if the key is missing.

        Any other value, such as 0 or 1, and a missing key without `default` raise SeatrialError. The default is checked
        in the same way.
        """
        value = self._read_value(key, default)
        if not isinstance(value, bool):
            raise self.error(key, f"must be true or false, not {_describe_value(value)}")
        return value

    def integer(self, key: str, default: object = _MISSING, low: int | None = None, high: int | None = None) -> int:
        """Return the whole number of a key within [low, high], or `default` if the key is missing.

        Both bounds are allowed values. A bound that is None does not apply. Any other value, such as 1.0, and a missing
        key without `default` raise SeatrialError. The default is checked in the same way.
        """
        value = self._read_value(key, default)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(key, f"must be a whole number, not {_describe_value(value)}")
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
        """Return the finite number of a key, or `default` if the key is missing.

        It must be within [low, high], bounds included, and above zero if `positive` is true. A bound that is None does
        not apply. A whole number is returned as a float. Any other value, such as true or inf, and a missing key
        without `default` raise SeatrialError. The default is checked in the same way.
        """
        value = self._read_value(key, default)
        number = self._to_finite(key, value)
        if positive and number <= 0.0:
            raise self.error(key, f"must be above zero, not {number:g}")
        self._check_range(key, number, low, high)
        return number

    def ratio(self, key: str, default: object = _MISSING) -> float:
        """Return the finite number of a key, which may be a fraction in quotes, or `default` if the key is missing.

        ``1/2200`` and ``-1500 / 400`` are fractions. Any other text, a fraction of zero, and the values that `number`
        does not accept raise SeatrialError.
        """
        value = self._read_value(key, default)
        if not isinstance(value, str):
            return self._to_finite(key, value)
        above, _, below = value.partition("/")
        try:
            number = float(above) / float(below)
        except (ValueError, ZeroDivisionError, OverflowError):
            number = math.nan
        if not math.isfinite(number):
            raise self.error(
                key, f"must be a number, or a fraction of two numbers such as '1/2200', not {value[:40]!r}"
            )
        return number

    def scalar(self, key: str, default: object = _MISSING) -> str | float | bool:
        """Return the text, finite number or boolean of a key, or `default` if the key is missing.

        A whole number is returned as a float. Lists, tables, dates, inf and nan, and a missing key without `default`
        raise SeatrialError. The default is checked in the same way.
        """
        value = self._read_value(key, default)
        if isinstance(value, (str, bool)):
            return value
        return self._to_finite(key, value)

    def maybe_number(self, key: str, low: float | None = None, high: float | None = None) -> float | None:
        """Return the finite number of a key within [low, high], or None if the key is missing.

        Both bounds are allowed values. A bound that is None does not apply. Any other value raises SeatrialError.
        Unlike `number`, this method has no error for a missing key.
        """
        return self.number(key, low=low, high=high) if self.has(key) else None

    def numbers(self, key: str, default: object = _MISSING, length: int | None = None) -> tuple[float, ...]:
        """Return the list of finite numbers of a key, or `default` if the key is missing.

        The list must have `length` items, unless this is None; then it may be empty. Any other value, and a missing key
        without `default`, raise SeatrialError. The default is checked in the same way.
        """
        value = self._read_value(key, default)
        if not isinstance(value, (list, tuple)):
            raise self.error(key, f"must be a list of numbers, not {_describe_value(value)}")
        if length is not None and len(value) != length:
            raise self.error(key, f"must have {counted(length, 'number')}, not {len(value)}")
        return tuple(self._to_finite(key, item) for item in value)

    def named_numbers(self) -> dict[str, float]:
        """Return all values of the table by name, for tables whose keys are names that the user chooses.

        All keys count as read.

        Raises
        ------
        SeatrialError
            If a value is not a finite number, or if a name has characters that are not printable.
        """
        for key in self.values:
            if not key.isprintable():
                raise self.error(repr(key), "this name has characters that are not printable; remove them")
        return {key: self.number(key) for key in self.values}

    def texts(self, key: str, default: object = _MISSING) -> tuple[str, ...]:
        """Return the list of strings of a key, or `default` if the key is missing. The list may be empty.

        Any other value, and a missing key without `default`, raise SeatrialError. The default is checked in the same
        way.
        """
        value = self._read_value(key, default)
        if not isinstance(value, (list, tuple)) or not all(isinstance(item, str) for item in value):
            raise self.error(key, "must be a list of texts in quotes")
        return tuple(value)

    def table(self, key: str) -> TomlTable | None:
        """Return the sub-table of a key, or None if the key is missing. A value that is no table raises SeatrialError.

        The keys of the sub-table do not count as read; the caller calls its own `done`.
        """
        value = self._read_value(key, None)
        if value is None:
            return None
        if not isinstance(value, dict):
            raise self.error(key, f"must be a table, [{self._full_key(key)}], not {_describe_value(value)}")
        return TomlTable(value, self.source, self._full_key(key))

    def tables(self, key: str) -> list[TomlTable]:
        """Return the tables of a `[[key]]` list in their order; an empty list if the key is missing.

        Error messages number them from 1, such as `device[1]`. A value that is not a list of tables raises
        SeatrialError.
        """
        value = self._read_value(key, [])
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.error(key, f"must be a list of tables, [[{self._full_key(key)}]]")
        return [TomlTable(item, self.source, f"{self._full_key(key)}[{i}]") for i, item in enumerate(value, start=1)]

    def done(self) -> None:
        """Raise SeatrialError for the keys that were not read, if there are any. The message lists the known keys.

        If the table lacks a known key with a name similar to the first unread one, the message suggests that one. The
        keys of a sub-table are not checked: each table from `table` or `tables` needs its own call.
        """
        for key in self.values:
            if key not in self._taken:
                known = ", ".join(dict.fromkeys(self._known))
                near = closest_name(key, [name for name in self._known if name not in self.values])
                others = [repr(name) for name in self.values if name not in self._taken and name != key]
                also = f"; also unknown: {', '.join(others)}" if others else ""
                if near:
                    raise self.error(key, f"unknown key {key!r}; did you mean {near!r}? Known here: {known}{also}")
                raise self.error(key, f"unknown key; correct or remove it; known here: {known}{also}")

    def _to_finite(self, key: str, value: object) -> float:
        """Return a value as a finite float. For any other value raise SeatrialError with the name of `key`.

        Other values are for example booleans, texts, lists, nan, inf, and whole numbers too large for a float.
        """
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.error(key, f"must be a number, not {_describe_value(value)}")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise self.error(key, "must be a finite number, not nan or inf")
        return number

    def _check_range(self, key: str, value: float, low: float | None, high: float | None) -> None:
        """Raise SeatrialError if a value is outside [low, high]; both bounds are allowed values.

        A bound that is None does not apply. `key` is the key of the value, for the message.
        """
        if (low is not None and value < low) or (high is not None and value > high):
            rule = f"must be at least {low}" if high is None else f"must be at most {high}"
            rule = rule if low is None or high is None else f"must be within {low} .. {high}"
            raise self.error(key, f"{rule}, not {_describe_value(value)}")


def _describe_value(value: object) -> str:
    """Return a description of a wrong value for an error message: a number itself, else the kind, such as "a list".

    A boolean is returned as "true" or "false". Numbers beyond 1e15 (HUGE) are described and not printed, because they
    may have thousands of digits.
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return f"{value:g}" if not abs(value) >= HUGE else "a number this large"
    names: dict[type, str] = {str: "text", list: "a list", dict: "a table"}
    return names.get(type(value), "a date or time")
