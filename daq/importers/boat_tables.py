"""Tables [geometry] and [scale] of an import map, which have the numbers of the boat that no source has."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from seatrial.daq.checks import MASS_ADVICE, arm_problem, mass_problem
from seatrial.daq.config import TomlTable
from seatrial.daq.errors import SeatrialError, warn

BoatTable = Mapping[str, float | Sequence[float]]
# Positions of the thrusters to starboard and forward, and length of the hull [m], and weighed mass [kg].
GEOMETRY = ("y_left", "y_right", "x_thrusters", "length", "mass")
ANTENNA = ("antenna_x", "antenna_y", "antenna_z")  # parameters of the key `lever_arm_m` of [geometry] [m]
ANTENNA_SD = "lever_arm_sd"  # standard uncertainty of each of them [m]
SCALE = ("c1", "c2")  # thrust of one thruster at n = 1 and -1: c1 + c2 and -(c1 - c2) [N]
PULLS = ("ahead", "astern")  # sizes of both thrusts [N], as of a bollard pull: the other form of `SCALE`
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
            for one, other in ((PULLS, SCALE), (SCALE, PULLS)):
                if set(_with_sd(one)) & set(numbers):
                    for key in set(_with_sd(other)) & set(table):
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


def boat_numbers_of(geometry: TomlTable | None, scale: TomlTable | None) -> dict[str, float]:
    """Return the numbers of the tables [geometry] and [scale] of an import map, by name.

    Raise SeatrialError with all mistakes of both tables in one message, if there are any.
    """
    found, problems = dict[str, float](), list[SeatrialError]()
    for read, table in ((geometry_of, geometry), (thrust_of, scale)):
        try:
            found |= read(table)
        except SeatrialError as problem:
            problems.append(problem)
    _raise_all(problems, next((table.source for table in (geometry, scale) if table is not None), ""))
    return found


def _raise_all(problems: Sequence[SeatrialError], source: str) -> None:
    """Raise the errors as one, if there are any. The name of the map, ``source``, stands at its begin only."""
    if len(problems) == 1:
        raise problems[0]
    if problems:
        first, *rest = (str(problem).removeprefix(f"{source}: ") for problem in problems)
        raise SeatrialError(f"{source}: {'; '.join([first, *rest])}")


def geometry_of(table: TomlTable | None) -> dict[str, float]:
    """Return the numbers of the table [geometry] by name; empty without the table. SeatrialError if one is wrong."""
    return _boat_numbers(table, GEOMETRY)


def thrust_of(table: TomlTable | None) -> dict[str, float]:
    """Return c1, c2 and their standard uncertainties [N] by the table [scale]; empty without the table.

    With thrusts ahead and astern, c1 is their mean and c2 half of ahead less astern. Without the thrust astern, the
    result has ``ahead`` (and ``ahead_sd``), from which a fit determines c1 and c2. Raise SeatrialError if a number is
    impossible, or if the table has both forms.
    """
    if table is None or not any(table.has(key) for key in _with_sd(PULLS)):
        return _boat_numbers(table, SCALE)
    for key in _with_sd(SCALE):
        if table.has(key):
            raise table.error(key, "follows from ahead and astern; give either these or c1 and c2")
    if not table.has("ahead"):
        raise table.error("ahead", "missing; give the thrust of one thruster at full speed ahead too")
    pulls = _boat_numbers(table, PULLS)
    if "astern" not in pulls:
        return pulls
    ahead, astern = (pulls[name] for name in PULLS)
    sds = [pulls[key] for key in ("ahead_sd", "astern_sd") if key in pulls]
    if len(sds) == 1:
        lacking = "astern_sd" if "ahead_sd" in pulls else "ahead_sd"
        raise table.error(lacking, "missing; give the standard uncertainty of both, or none")
    found = {"c1": (ahead + astern) / 2.0, "c2": (ahead - astern) / 2.0}
    return found | (dict.fromkeys(("c1_sd", "c2_sd"), math.hypot(*sds) / 2.0) if sds else {})


def _with_sd(names: Sequence[str]) -> list[str]:
    """Return the names, and those of their standard uncertainties."""
    return [*names, *(f"{name}_sd" for name in names)]


def _boat_numbers(table: TomlTable | None, names: Sequence[str]) -> dict[str, float]:
    """Return the numbers of the boat in the table [geometry] or [scale] of an import map, by name.

    `names` are the keys that the table may have. Standard uncertainties ``NAME_sd`` are included if the table has them.
    The result is empty if `table` is None. Raise SeatrialError with all mistakes if a number is impossible, a key is
    unknown, or the number of an uncertainty is missing. [geometry] may also have `lever_arm_m`, the position of the
    antenna in body axes [m], whose three numbers have the names `ANTENNA`, and its standard uncertainty `ANTENNA_SD`.
    Thrusts, length, mass and standard uncertainties must be positive, the size of c2 less than c1, y_left less than
    y_right, and both and x_thrusters at most `length` from the middle. A mass that is unusual for the length gives a
    warning. The antenna must be within one length.
    """
    if table is None:
        return {}
    problems, found = list[SeatrialError](), dict[str, float]()

    def number(name: str, positive: bool = False) -> None:
        """Read the number of a key that the table has, or note the error."""
        try:
            found[name] = table.number(name, positive=positive)
        except SeatrialError as problem:
            problems.append(problem)

    def wrong(name: str, text: str) -> None:
        """Note a mistake in the number of a key."""
        problems.append(table.error(name, text))

    for name in names:
        if table.has(name):
            number(name)
        if table.has(uncertainty := f"{name}_sd"):
            number(uncertainty, positive=True)
            if not table.has(name):
                wrong(uncertainty, f"is the standard uncertainty of {name}; give {name} too")
    for name in ("c1", *PULLS, "length", "mass"):
        if found.get(name, 1.0) <= 0.0:
            wrong(name, f"must be positive, not {found[name]:g}")
    if abs(found.get("c2", 0.0)) >= found.get("c1", math.inf) > 0.0:
        wrong(
            "c2",
            f"{found['c2']:g} N is not smaller than c1 = {found['c1']:g} N: the thrust ahead is c1 + c2 and "
            "that astern c1 - c2, and both must be positive",
        )
    for name, positive in (("y_left", "to starboard"), ("y_right", "to starboard"), ("x_thrusters", "forward")):
        if abs(found.get(name, 0.0)) > found.get("length", math.inf):
            where = f"{abs(found[name]):g} m from the middle of a hull of {found['length']:g} m"
            wrong(name, f"{where}; write positions in metres, positive {positive}")
    if {"y_left", "y_right"} <= set(found) and found["y_left"] >= found["y_right"]:
        wrong("y_left", "must be less than y_right, because positions are positive to starboard; correct one of them")
    if not problems and (problem := mass_problem(found)):
        warn(f"{table.source}: {problem}; {MASS_ADVICE}")
    if "length" in names and table.has("lever_arm_m"):
        try:
            found |= dict(zip(ANTENNA, table.numbers("lever_arm_m", length=3), strict=True))
            if problem := arm_problem(found):
                wrong("lever_arm_m", f"{problem}; write positions and length in metres")
        except SeatrialError as mistake:
            problems.append(mistake)
    if "length" in names and table.has(ANTENNA_SD):
        number(ANTENNA_SD, positive=True)
        if not table.has("lever_arm_m"):
            wrong(ANTENNA_SD, "is the standard uncertainty of lever_arm_m; give lever_arm_m too")
    try:
        table.done()
    except SeatrialError as unknown:
        problems.append(unknown)
    _raise_all(problems, table.source)
    return found
