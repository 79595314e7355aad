"""Recogniser of tables of thrust stands (RCbenchmark, Tyto): thrust, ESC signal, shaft speed and supply of a motor."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from seatrial.daq.checks import SUPPLY
from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.recognise import SIDES, Candidate, MapSignal, read_name
from seatrial.daq.importers.table import Column, Table

COMMAND, SHAFT = "n_cmd_thruster", "n_thruster"
_FORCE = {"N": "N", "kgf": "kgf", "kg": "kgf", "gf": "gf", "g": "gf", "lbf": "lbf", "lb": "lbf", "": "N"}
_COMMANDS = {"esc", "pwm", "throttle", "cmd", "command"}
_NOT = {"efficiency", "servo", "power", "torque", "current", "voltage", "temperature", "vibration", "min", "max"}
# Words of a voltage, a current or a power that is not that of the supply: of the phases of the motor, of its shaft, ...
_NOT_OF_SUPPLY = {
    "efficiency",
    "factor",
    "limit",
    "max",
    "mech",
    "mechanical",
    "min",
    "peak",
    "phase",
    "servo",
    "shaft",
}
_NOT_OF_SUPPLY |= {"cell", "cmd", "command", "setpoint", "target", "temperature", "water"}
_UNITS_OF_SUPPLY = {"voltage": ("V", "mV"), "current": ("A", "mA"), "power": ("W",)}
REST_SHARE = 0.03  # share of the greatest speed or thrust; the motor is at rest below it
REVERSE_SHARE = 0.05  # share of the greatest thrust; a load cell at rest may show so much reverse thrust
SLOWEST_SHAFT_S = 0.2  # s between rows; a longer step does not resolve the time constant of a shaft
USUAL_REST_US = (1000.0, 1500.0)  # us; rest of an ESC for one direction, and of an ESC for both directions


class _StandColumns(NamedTuple):
    """Names of the columns with thrust, command and shaft speed in the table of a thrust stand with one motor.

    Attributes
    ----------
    thrust : str
        Name of the column of the thrust.
    command : str
        Name of the column of the command of the motor, for example a pulse width.
    speed : str
        Name of the column of the shaft speed; "" if the table has no speed other than zero.
    """

    thrust: str
    command: str
    speed: str  # "" if the table has no speed


def bench_candidates(table: Table, t: Column | None) -> list[Candidate]:
    """Find thrust, command and shaft speed in a table of a thrust stand, as candidates for a guessed import map.

    An import map assigns columns of a source file to signals of a log.

    Parameters
    ----------
    table
        Table of a source file.
    t
        Times of the rows, shape (n,) [s]; None if the table has no times.

    Returns
    -------
    list of Candidate
        One candidate for each signal, with a caveat about what is assumed ("" if nothing is): ``force`` (the thrust;
        its sign is changed if it is never above 5 % of its largest magnitude; without a unit it is in newtons),
        ``n_cmd_thruster`` (the command, scaled to -1 to 1) and, if the table has a shaft speed other than zero,
        ``n_thruster`` (the speed divided by its largest magnitude). Voltage, current and electrical power of the supply
        follow as ``voltage``, ``current`` and ``power``, if the table has them. The map will not contain the shaft
        speed (its candidate has rank 5, which is never chosen) in two cases. In the first, the thrust is above 5 % of
        its largest magnitude in both directions, and no speed is negative. In the second, the rows are more than 0.2 s
        apart (median); without times (`t` None) this is not checked. The list is empty for any other table.
    """
    numbers = dict(_number_columns(table))
    found = _stand_columns(table, numbers)
    if found is None:
        return []
    thrust, command = numbers[found.thrust], numbers[found.command]
    unit = _force_unit(table, found.thrust) or "N"
    caveats = [] if _column_unit(table, found.thrust) else [f"{found.thrust!r} has no unit; newtons are assumed"]
    threshold = REVERSE_SHARE * float(np.nanmax(np.abs(thrust)))
    is_forward, is_reverse = bool(np.nanmax(thrust) > threshold), bool(np.nanmin(thrust) < -threshold)
    caveats += ["the thrust is negative throughout: its sign is changed"] * (not is_forward)
    force = MapSignal("force", (found.thrust,), unit, "", "" if is_forward else "sign = -1")
    signals = [Candidate("force", 0, table, (force,), "; ".join(caveats))]
    is_reversed = is_forward and is_reverse
    speed = numbers.get(found.speed)
    extra, caveat = _command_scale(command, thrust if speed is None else speed, is_reversed)
    signals.append(Candidate("command", 0, table, (MapSignal(COMMAND, (found.command,), "1", "", extra),), caveat))
    signals += _supply_candidates(table, numbers)
    if speed is None:
        return signals
    top = float(np.nanmax(np.abs(speed)))
    step = float(np.nanmedian(np.diff(t))) if t is not None and len(t) > 1 else 0.0
    caveat, rank = "", 0
    if is_reversed and np.nanmin(speed) >= 0.0:
        caveat, rank = "the speed has no sign, but the thrust has; only a static thrust curve can be fitted", 5
    elif step > SLOWEST_SHAFT_S:
        caveat = f"rows {step:.2g} s apart are too slow for a time constant; only a static thrust curve can be fitted"
        rank = 5
    shaft = MapSignal(SHAFT, (found.speed,), "1", "", 'hold = "linear"', top)
    return [*signals, Candidate("shaft", rank, table, (shaft,), caveat)]


def _supply_candidates(table: Table, numbers: Mapping[str, Column]) -> Iterator[Candidate]:
    """Yield voltage, current and electrical power of the supply of a thrust stand, as far as the table has them.

    `numbers` has the values (n,) of the columns of numbers, by name. The name of a column must have the quantity as a
    word, and no other unit. Of several columns of a quantity the first counts. A current of the motor is that of its
    phases, and is left out: it is larger than the current of the supply.
    """
    for quantity in SUPPLY:
        units = _UNITS_OF_SUPPLY[quantity]
        others = _NOT_OF_SUPPLY | ({"motor"} if quantity == "current" else set())
        for column in numbers:
            words, unit = read_name(column).words, _column_unit(table, column)
            if quantity in words and not words & others and unit in ("", *units):
                caveat = "" if unit else f"{column!r} has no unit; {units[0]} is assumed"
                signal = MapSignal(quantity, (column,), unit or units[0], "", 'role = "output"')
                yield Candidate("supply", 0, table, (signal,), caveat)
                break


def _number_columns(table: Table) -> Iterator[tuple[str, Column]]:
    """Yield the name and the values (n,) of each column of a table that contains numbers; NaN for an empty cell.

    Columns without a name, of text, without any finite number, or with a name that appears more than once are skipped.
    """
    for name in table.names:
        if name and table.names.count(name) == 1:
            try:
                values = table.numbers(name)
            except SeatrialError:  # text
                continue
            if np.isfinite(values).any():
                yield name, values


def _stand_columns(table: Table, numbers: Mapping[str, Column]) -> _StandColumns | None:
    """Find the columns of thrust, command and shaft speed of a thrust stand by their names; None without them.

    `numbers` has the values (n,) of the columns of numbers, by name. The result is None if one of these names has a
    side (left, right) or a signal of motion other than an acceleration, because the table is then from a boat. It is
    also None if there is no command that changes, or not exactly one thrust. A thrust or a command with the unit of
    another quantity does not count. Of several commands the first is taken, and of several speeds the one with the most
    values other than zero. Columns such as power, current, torque or efficiency are not used. The speed is "" if no
    column of speeds has a value other than zero.
    """
    # A name of a side or of a signal of motion means that the table is from a boat. A stand may have an accelerometer.
    words = {name: read_name(name).words for name in numbers}
    if any(words[name] & SIDES or read_name(name).meaning not in ("", "ax", "ay") for name in numbers):
        return None
    usable = [name for name in numbers if not words[name] & _NOT]
    thrusts = [n for n in usable if words[n] & {"thrust", "force"} and _force_unit(table, n)]
    commands = [n for n in usable if words[n] & _COMMANDS and _column_unit(table, n) in ("us", "%", "", "1")]
    commands = [n for n in commands if np.nanmax(numbers[n]) > np.nanmin(numbers[n])]
    speeds = [n for n in usable if _column_unit(table, n) == "rev/min" or "rpm" in words[n]]
    speeds = [n for n in speeds if np.nanmax(np.abs(numbers[n])) > 0.0]
    if len(thrusts) != 1 or not commands:
        return None
    # A stand may have an electrical and an optical speed sensor: take the sensor with more values other than zero.
    best = max(speeds, key=lambda n: int(np.count_nonzero(np.nan_to_num(numbers[n]))), default="")
    return _StandColumns(thrusts[0], commands[0], best)


def _column_unit(table: Table, column: str) -> str:
    """Return the unit of a column as an import map writes it, for example "rev/min"; "" if the column has no unit.

    The unit is stated by the source file or stands in the name of the column. An unknown unit is returned unchanged.
    """
    name = read_name(f"{column} [{table.units[column]}]" if column in table.units else column)
    return name.unit or name.no_unit


def _force_unit(table: Table, column: str) -> str:
    """Return the unit of a thrust column as an import map writes it: "N", "kgf", "gf" or "lbf"; "" for any other unit.

    Grams, kilograms and pounds are forces on a thrust stand. A column without a unit gets "N".
    """
    return _FORCE.get(_column_unit(table, column), "")


def _command_scale(command: Column, response: Column, is_reversed: bool) -> tuple[str, str]:
    """Return the keys of an import map that scale a command (n,) to -1 .. 1, as text, and the caveat about this scale.

    The keys are "scale", "offset" and "role": signal = scale * command + offset. The caveat has rest and full command.

    Rest becomes 0, and the command farthest from rest becomes 1 or -1. Rest is the most frequent command (the smallest
    of several) at which the `response` (n,), a speed or a thrust, is at most 3 % of its largest magnitude. Without such
    a row, rest of a pulse width is 1000 us, or 1500 us if `is_reversed` (both directions); rest of another command is
    0. A command is a pulse width if its maximum is above 700.
    """
    known = np.isfinite(command) & np.isfinite(response)
    at_rest = known & (np.abs(response) <= REST_SHARE * np.nanmax(np.abs(response)))
    good = command[np.isfinite(command)]
    is_pulse = float(np.max(good)) > 700.0
    if at_rest.any():
        values, number = np.unique(command[at_rest], return_counts=True)
        rest = float(values[np.argmax(number)])
    else:
        rest = USUAL_REST_US[is_reversed] if is_pulse else 0.0
    full = float(good[np.argmax(np.abs(good - rest))])
    scale = 1.0 / abs(full - rest)
    unit = " us" if is_pulse else ""
    extra = f'scale = {scale:.9g}, offset = {0.0 - scale * rest:.9g}, role = "input"'
    return extra, f"{rest:.6g}{unit} is assumed to be rest, {full:.6g}{unit} full command"
