"""Plugins: protocols, effects and models that other installed packages add by entry points.

The package of a laboratory names its objects in its own pyproject.toml:

    [project.entry-points."seatrial.protocols"]
    os5000 = "lab_boat.os5000:DEVICE"

Groups of entry points, and the objects that they name:

- `seatrial.protocols`: a `seatrial.daq.protocol.DeviceType`.
- `seatrial.effects`: a `seatrial.ident.model.Effect`, a sequence of effects, or a module with EFFECT or EFFECTS.
- `seatrial.models`: a function that returns a `seatrial.ident.model.Model`.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, TypeVar

from seatrial.daq.errors import SeatrialError, warn

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

T = TypeVar("T")


@cache
def plugins(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group, such as "seatrial.protocols", by name. They may be none.

    Only the metadata of the installed packages are read; no code of theirs is imported. A package that is found twice
    on the module path, in the same version, counts once. The result is cached: a package that is installed later is not
    found.

    Raises
    ------
    SeatrialError
        If two installed packages use the same name.
    """
    # Its import takes as long as that of all modules of a small process, such as the watchdog, which has no plugins.
    from importlib.metadata import entry_points

    found: dict[str, EntryPoint] = {}
    for point in entry_points(group=group):
        before = found.setdefault(point.name, point)
        if (before.value, _package_name(before)) != (point.value, _package_name(point)):
            raise SeatrialError(
                f"the packages {_package_name(before)} and {_package_name(point)} both add {point.name!r} to {group}; "
                "uninstall one of them"
            )
    return found


def load_plugin(point: EntryPoint, kind: type[T]) -> T:
    """Import the object that an entry point names, and return it if it is an instance of the class `kind`.

    Raises
    ------
    SeatrialError
        If the import fails, or if the object is not of this kind.
    """
    place = f"{point.name!r} of the package {_package_name(point)} ({point.value})"
    try:
        loaded = point.load()
    except Exception as error:  # code of other packages may raise any exception
        raise SeatrialError(
            f"{place} cannot be imported: {type(error).__name__}: {error}; update or uninstall this package"
        ) from error
    if not isinstance(loaded, kind):
        raise SeatrialError(
            f"{place} has the type {type(loaded).__name__}, and {point.group} needs a {kind.__name__}; update or "
            "uninstall this package"
        )
    return loaded


def load_or_warn(point: EntryPoint, kind: type[T]) -> T | None:
    """Import the object that an entry point names, and return it if it is an instance of the class `kind`.

    Otherwise, or if the import fails, a SeatrialWarning is issued and None is returned. This function is for lists of
    all protocols or effects, in which a broken package must not hide the other packages.
    """
    try:
        return load_plugin(point, kind)
    except SeatrialError as error:
        warn(f"{error}; until then it is left out")
        return None


def _package_name(point: EntryPoint) -> str:
    """Return name and version of the installed package that adds a plugin; "unknown" if it has no metadata."""
    return f"{point.dist.name} {point.dist.version}" if point.dist is not None else "unknown"
