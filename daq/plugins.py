"""Protocols, effects and models that other installed packages add by entry points.

A package of a lab names its objects in its own pyproject.toml:

    [project.entry-points."seatrial.protocols"]
    os5000 = "lab_boat.os5000:DEVICE"

Groups: `seatrial.protocols` (`seatrial.daq.protocol.DeviceType`), `seatrial.effects` (`seatrial.ident.model.Effect`,
a sequence of them, or a module that defines EFFECT or EFFECTS) and `seatrial.models` (a function that returns a
`seatrial.ident.model.Model`).
"""

from __future__ import annotations

import warnings
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TypeVar

from seatrial.daq.errors import SeatrialError, SeatrialWarning

T = TypeVar("T")


@cache
def plugins(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group by name; no code of the other packages is imported.

    Raises
    ------
    SeatrialError
        If two installed packages use the same name.
    """
    found: dict[str, EntryPoint] = {}
    for point in entry_points(group=group):
        before = found.setdefault(point.name, point)
        if (before.value, _package(before)) != (point.value, _package(point)):
            raise SeatrialError(
                f"the packages {_package(before)} and {_package(point)} both add {point.name!r} to {group}; "
                "uninstall one of them"
            )
    return found


def load_plugin(point: EntryPoint, kind: type[T]) -> T:
    """Import the object that an entry point names.

    Raises
    ------
    SeatrialError
        If the import fails, or if the object is not of this kind.
    """
    place = f"{point.name!r} of the package {_package(point)} ({point.value})"
    try:
        loaded = point.load()
    except Exception as error:  # code of others may raise anything
        raise SeatrialError(f"{place} cannot be imported: {type(error).__name__}: {error}") from error
    if not isinstance(loaded, kind):
        raise SeatrialError(f"{place} has the type {type(loaded).__name__}; {point.group} needs a {kind.__name__}")
    return loaded


def load_or_warn(point: EntryPoint, kind: type[T]) -> T | None:
    """Import the object that an entry point names, or warn and return None if that fails.

    For lists of all protocols or effects: one broken package must not hide the others.
    """
    try:
        return load_plugin(point, kind)
    except SeatrialError as error:
        warnings.warn(f"{error}; it is left out", SeatrialWarning, stacklevel=2)
        return None


def _package(point: EntryPoint) -> str:
    """Return name and version of the package that an entry point belongs to."""
    return f"{point.dist.name} {point.dist.version}" if point.dist is not None else "unknown"
