"""Tables [geometry] and [scale] of an import map, given as mappings: the numbers of the boat that no source has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.import_map import PULLS, SCALE

BoatTable = Mapping[str, float | Sequence[float]]
OF_SCALE = tuple(f"{name}{end}" for name in SCALE for end in ("", "_sd"))
EXAMPLES = "# What no file has"  # begin of the comment of a guessed map that shows both tables


def with_boat_tables(text: str, path: Path, geometry: BoatTable | None = None, scale: BoatTable | None = None) -> str:
    """Return the text of an import map with numbers of the boat in its tables [geometry] and [scale].

    Given numbers replace those of the map. The comment of a guessed map with examples of these tables is removed. Names
    and numbers are checked where the map is read (`parse_import_map`).

    Parameters
    ----------
    text
        Text of the map, in TOML.
    path
        File of the map, for error messages.
    geometry, scale
        Numbers by key of the table, for example ``mass`` or ``c1``. None, or an empty mapping, changes nothing.

    Raises
    ------
    SeatrialError
        If the map is no TOML, or a value is no number and no sequence of numbers.
    """
    given = {name: dict(table) for name, table in (("geometry", geometry), ("scale", scale)) if table}
    if not given:
        return text
    lines = text.splitlines(keepends=True)
    first = next((k for k, line in enumerate(lines) if line.startswith(EXAMPLES)), len(lines))
    last = next((k for k in range(first, len(lines)) if not lines[k].startswith("#") or "no fit:" in lines[k]), None)
    try:
        document = tomlkit.parse("".join(lines[:first] + ([] if last is None else lines[last:])))
        for name, numbers in given.items():
            table = document.setdefault(name, tomlkit.table())
            # Thrusts ahead and astern are another form of c1 and c2: the given form replaces the other one
            for one, other in ((PULLS, OF_SCALE), (OF_SCALE, PULLS)):
                if name == "scale" and set(one) & set(numbers):
                    for key in set(other) & set(table):
                        table.remove(key)
            for key, value in numbers.items():
                table[key] = _plain(value, f"{path}: {key} in [{name}]")
    except TOMLKitError as problem:
        raise SeatrialError(f"{path}: not valid TOML: {problem}") from problem
    return tomlkit.dumps(document)


def _plain(value: Any, where: str) -> float | list[float]:
    """Return a number, or a sequence of numbers, in the types of TOML. ``where`` begins the message of an error."""
    try:
        return float(value) if isinstance(value, float | int) or not hasattr(value, "__len__") else [*map(float, value)]
    except (TypeError, ValueError) as problem:
        raise SeatrialError(f"{where}: must be a number or numbers, not {value!r}") from problem
