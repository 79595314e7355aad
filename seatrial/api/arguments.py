"""Checks of the arguments of the Python interface, each with an error of one line."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from functools import wraps
from inspect import signature
from numbers import Real
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypedDict, TypeVar, cast

import numpy as np

from seatrial.daq.errors import SeatrialError, names_hint

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")
Role = Literal["estimation", "validation"]  # role of the data of a fit

LONGEST_VALUE = 60  # characters of a value that a message repeats
RATES = (1.0, 200.0)  # smallest and largest rate of the rows [Hz], as those of --rate
# Options that are a number above zero: what to give, and its unit
ABOVE_ZERO = {
    "horizon": ("a time", "s"),
    "duration": ("a time", "s"),
    "mass": ("a mass", "kg"),
    "inertia": ("an inertia", "kg m2"),
    "max_speed": ("a speed", "m/s"),
    "slew": ("a rate", "1/s"),
    "shortest": ("a time", "s"),
}
# Options with a range: smallest and largest value, as those of the command, and the unit in words
WITHIN = {
    "energy": (1e-6, 1.0, " (full power)"),
    "current": (0.0, 2.0, " m/s"),
    "n_max": (1e-6, 1.0, " (full command)"),
}
# Options that are a whole number: the smallest and largest value, as those of the command; None without a largest one
WHOLE: dict[str, tuple[int, int | None]] = {
    "max_effects": (1, None),
    "evaluations": (500, None),
    "steps": (2, 1000),
    "seed": (0, None),
}
PATHS = ("effects_file",)  # options that are the path of a file


def named_arguments(function: Callable[P, R]) -> Callable[P, R]:
    """Let a function without options refuse an unknown keyword argument, and name the argument that was meant.

    A SeatrialError takes the place of Python's TypeError.
    """
    known = list(signature(function).parameters)

    @wraps(function)
    def checked(*args: P.args, **kwargs: P.kwargs) -> R:
        """Call the function after a check of the names in ``kwargs``."""
        for name in kwargs:
            if name not in known:
                raise SeatrialError(f"{function.__name__} has no argument {name!r}; {names_hint(name, known)}")
        return function(*args, **kwargs)

    return checked


def shortened(value: object) -> str:
    """Return a value of the user for a message: as Python writes it, or its type if that is long or several lines."""
    text = repr(value)
    return text if len(text) <= LONGEST_VALUE and "\n" not in text else f"a {type(value).__name__}"


def as_path(value: object, name: str) -> Path:
    """Convert the argument of this name to a path.

    Raises
    ------
    SeatrialError
        If the argument is neither a str nor a Path.
    """
    if not isinstance(value, str | Path):
        raise SeatrialError(f"{name}: {shortened(value)} is no path; give the path of one file or folder as text")
    return Path(value)


def output_folder(value: object) -> Path:
    """Return the folder of a ``save`` as a path. It need not exist.

    Raises
    ------
    SeatrialError
        If it is no path, or if it is that of a file.
    """
    folder = as_path(value, "folder")
    if folder.exists() and not folder.is_dir():
        raise SeatrialError(
            f"{folder}: is a file, and save writes several files to a folder; give the path of a folder"
        )
    return folder


def check_number(name: str, value: object, unit: str) -> None:
    """Raise SeatrialError if the argument ``name`` is not a number. Infinity and NaN are numbers."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise SeatrialError(f"{name} {shortened(value)}: give a number, in {unit}")


def check_rate(rate: object) -> None:
    """Raise SeatrialError if a rate of rows is no number from 1 to 200 Hz, the limits of the command line."""
    if not isinstance(rate, Real) or not RATES[0] <= float(rate) <= RATES[1]:
        raise SeatrialError(f"rate {rate!r}: give a number from {RATES[0]:g} to {RATES[1]:g}, in Hz")


def check_above_zero(name: str, value: object) -> None:
    """Raise SeatrialError if the option ``name`` of `ABOVE_ZERO` is no finite number above zero."""
    what, unit = ABOVE_ZERO[name]
    if isinstance(value, bool) or not isinstance(value, Real) or not 0.0 < float(value) < math.inf:
        shown = f"{value:g}" if isinstance(value, int | float) else shortened(value)
        raise SeatrialError(f"{name} {shown}: give {what} above zero, in {unit}")


def check_within(name: str, value: object) -> None:
    """Raise SeatrialError if the option ``name`` of `WITHIN` is no number in its range, the limits of the command."""
    low, high, unit = WITHIN[name]
    if isinstance(value, bool) or not isinstance(value, Real) or not low <= float(value) <= high:
        raise SeatrialError(f"{name} {shortened(value)}: give a number from {low:g} to {high:g}{unit}")


def check_whole(name: str, value: object) -> None:
    """Raise SeatrialError if the option ``name`` of `WHOLE` is no whole number in its range."""
    low, high = WHOLE[name]
    whole = not isinstance(value, bool) and isinstance(value, int | np.integer)
    if not whole or not low <= int(cast(Any, value)) <= (high or math.inf):
        form = f"of at least {low}" if high is None else f"from {low} to {high}"
        raise SeatrialError(f"{name} {shortened(value)}: give a whole number {form}")


def as_sides(name: str, value: object) -> tuple[float, float]:
    """Return the argument ``name`` as the sides (north, east) [m] of an area.

    SeatrialError is raised for anything but two finite numbers above zero.
    """
    sides = _items(value) or []
    if len(sides) != 2 or not all(_is_number(side) and 0.0 < float(side) < math.inf for side in sides):
        raise SeatrialError(f"{name} {shortened(value)}: give its sides to north and east in m, such as (60.0, 40.0)")
    return float(sides[0]), float(sides[1])


def as_intervals(name: str, value: object) -> tuple[tuple[float, float], ...]:
    """Return the argument ``name`` as intervals of time (from, to) [s]. One pair of numbers is one interval.

    Raises
    ------
    SeatrialError
        If the argument is neither a pair nor a sequence of pairs of numbers, if a number is not finite, or if the end
        of an interval is not after its beginning.
    """
    advice = f"give pairs (from, to) in s, such as {name}=[(60.0, 90.0)]"
    several = _items(value)
    if several is None:
        raise SeatrialError(f"{name} {shortened(value)}: {advice}")
    found = []
    for interval in [value] if len(several) == 2 and all(map(_is_number, several)) else several:
        ends = _items(interval)
        if ends is None or len(ends) != 2 or not all(map(_is_number, ends)):
            raise SeatrialError(f"{name} {shortened(interval)}: is no pair of numbers; {advice}")
        begin, end = float(ends[0]), float(ends[1])
        if not -math.inf < begin < end < math.inf:
            raise SeatrialError(f"{name} ({begin:g}, {end:g}): the end is not a time after the beginning; {advice}")
        found.append((begin, end))
    return tuple(found)


class _OptionsType(type(TypedDict("_Options", {}))):  # type: ignore[misc]
    """Type of the option classes, whose help lists no attributes: their docstring has all options."""

    def __dir__(cls) -> list[str]:
        """Return no names: those of the base class dict would hide the options in `help`."""
        return []


def with_short_help(options: type[T]) -> type[T]:
    """Return a `TypedDict` with options after removing the methods of dict from its help.

    ``help`` then shows the docstring alone, with the options, their types and their defaults. Nothing else changes: the
    class is a `TypedDict` all the same.
    """
    options.__class__ = _OptionsType  # type: ignore[method-assign]
    return options


def check_switches(given: Mapping[str, Any], options: type) -> None:
    """Raise SeatrialError if an option that switches something on or off is neither True nor False.

    Python would count any text as true, also ``"no"``. ``options`` is the `TypedDict` with the types of the options.
    """
    for name, value in given.items():
        kind = options.__annotations__[name]
        if getattr(kind, "__forward_arg__", kind) in ("bool", bool) and not isinstance(value, bool | np.bool_):
            raise SeatrialError(f"{name} {shortened(value)}: give True or False")


def _items(value: object) -> list[Any] | None:
    """Return the items of a sequence or an array as a list. The result is None for any other value, text and dict."""
    if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
        return None
    try:
        return list(value)
    except TypeError:  # an array without a dimension
        return None


def _is_number(value: object) -> bool:
    """Return whether a value is a real number. True and False do not count as numbers."""
    return isinstance(value, Real) and not isinstance(value, bool)


def check_values(given: Mapping[str, Any]) -> None:
    """Check the values of the options in ``given`` that are a number, a number of effects, or a path. None is kept.

    Raises
    ------
    SeatrialError
        If an option of `ABOVE_ZERO` is no number above zero, if one of `WITHIN` or ``rate`` is no number in its range,
        one of `WHOLE` no whole number in its range, or a path neither text nor a Path.
    """
    for name, value in given.items():
        if value is None:
            continue
        if name in ABOVE_ZERO:
            check_above_zero(name, value)
        elif name in WITHIN:
            check_within(name, value)
        elif name == "rate":
            check_rate(value)
        elif name in PATHS:
            as_path(value, name)
        elif name in WHOLE:
            check_whole(name, value)
