"""Tables of thrust stands (RCbenchmark, Tyto): thrust, the signal of the ESC and the speed of one motor."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.recognise import SIDES, Candidate, Taken, read_name
from seatrial.daq.importers.table import Column, Table

COMMAND, SHAFT = "n_cmd_thruster", "n_thruster"
_FORCE = {"N": "N", "kgf": "kgf", "kg": "kgf", "gf": "gf", "g": "gf", "lbf": "lbf", "lb": "lbf", "": "N"}
_COMMANDS = {"esc", "pwm", "throttle", "cmd", "command"}
_NOT = {"efficiency", "servo", "power", "torque", "current", "voltage", "temperature", "vibration", "min", "max"}
STILL = 0.03  # share of the greatest speed or thrust: less is rest
MOST_REVERSED = 0.05  # share of the greatest thrust that a load cell at rest may show astern
SLOWEST_SHAFT_S = 0.2  # s between rows: of slower ones no time constant of a shaft can be told
USUAL_REST = (1000.0, 1500.0)  # us: ESCs of one direction and of two


class _Columns(NamedTuple):
    thrust: str
    command: str
    speed: str  # "" for none


def bench_candidates(table: Table, t: Column | None) -> list[Candidate]:
    """Return the signals of a table of a thrust stand; none if it is another table.

    Parameters
    ----------
    table
        The table.
    t
        Times of its rows, shape (n,) [s]; None if it has none.

    Returns
    -------
    list of Candidate
        ``force``, ``n_cmd_thruster`` and, if the speed of the shaft has a sign and is sampled often enough,
        ``n_thruster``.
    """
    numbers = dict(_numbers(table))
    found = _columns(table, numbers)
    if found is None:
        return []
    thrust, command = numbers[found.thrust], numbers[found.command]
    unit = _force_unit(table, found.thrust) or "N"
    caveats = [] if _unit(table, found.thrust) else [f"{found.thrust!r} has no unit and is taken for newtons"]
    most = MOST_REVERSED * float(np.nanmax(np.abs(thrust)))
    is_ahead, is_astern = bool(np.nanmax(thrust) > most), bool(np.nanmin(thrust) < -most)
    caveats += ["the thrust is negative throughout: its sign is turned"] * (not is_ahead)
    force = Taken("force", (found.thrust,), unit, "", "" if is_ahead else "sign = -1")
    signals = [Candidate("force", 0, table, (force,), "; ".join(caveats))]
    is_reversed = is_ahead and is_astern
    speed = numbers.get(found.speed)
    extra, caveat = _scale(command, thrust if speed is None else speed, is_reversed)
    signals.append(Candidate("command", 0, table, (Taken(COMMAND, (found.command,), "1", "", extra),), caveat))
    if speed is None:
        return signals
    top = float(np.nanmax(np.abs(speed)))
    step = float(np.nanmedian(np.diff(t))) if t is not None and len(t) > 1 else 0.0
    why, rank = f"{top:.5g} rev/min is taken for full speed", 0
    if is_reversed and np.nanmin(speed) >= 0.0:
        why, rank = "a speed without a sign, though the thrust has one: without it there is a static thrust curve", 5
    elif step > SLOWEST_SHAFT_S:
        why, rank = f"rows {step:.2g} s apart tell no time constant: without it there is a static thrust curve", 5
    shaft = Taken(SHAFT, (found.speed,), "1", "", f'scale = {1.0 / top:.9g}, hold = "linear"')
    return [*signals, Candidate("shaft", rank, table, (shaft,), why)]


def _numbers(table: Table) -> Iterator[tuple[str, Column]]:
    for name in table.names:
        if name and table.names.count(name) == 1:
            try:
                values = table.numbers(name)
            except SeatrialError:  # text
                continue
            if np.isfinite(values).any():
                yield name, values


def _columns(table: Table, numbers: Mapping[str, Column]) -> _Columns | None:
    """The columns of thrust, command and speed; None if the table is of a boat, or lacks the first two."""
    words = {name: read_name(name).words for name in numbers}
    if any(words[name] & SIDES or read_name(name).meaning not in ("", "ax", "ay") for name in numbers):
        return None
    usable = [name for name in numbers if not words[name] & _NOT]
    thrusts = [n for n in usable if words[n] & {"thrust", "force"} and _force_unit(table, n)]
    commands = [n for n in usable if words[n] & _COMMANDS and _unit(table, n) in ("us", "%", "", "1")]
    commands = [n for n in commands if np.nanmax(numbers[n]) > np.nanmin(numbers[n])]
    speeds = [n for n in usable if _unit(table, n) == "rev/min" or "rpm" in words[n]]
    speeds = [n for n in speeds if np.nanmax(np.abs(numbers[n])) > 0.0]
    if len(thrusts) != 1 or not commands:
        return None
    best = max(speeds, key=lambda n: int(np.count_nonzero(np.nan_to_num(numbers[n]))), default="")  # or the optical one
    return _Columns(thrusts[0], commands[0], best)


def _unit(table: Table, column: str) -> str:
    """The unit of a column as maps have it, or as the column has it."""
    name = read_name(f"{column} [{table.units[column]}]" if column in table.units else column)
    return name.unit or name.no_unit


def _force_unit(table: Table, column: str) -> str:
    """The unit of a thrust; "" if the unit of the column is none. On a thrust stand grams are a force."""
    return _FORCE.get(_unit(table, column), "")


def _scale(command: Column, response: Column, is_reversed: bool) -> tuple[str, str]:
    """Scale and offset of the command, -1 to 1, and the caveat about it. Rest is where speed or thrust is zero."""
    known = np.isfinite(command) & np.isfinite(response)
    still = known & (np.abs(response) <= STILL * np.nanmax(np.abs(response)))
    good = command[np.isfinite(command)]
    is_pulse = float(np.max(good)) > 700.0
    if still.any():
        values, number = np.unique(command[still], return_counts=True)
        rest = float(values[np.argmax(number)])
    else:
        rest = USUAL_REST[is_reversed] if is_pulse else 0.0
    full = float(good[np.argmax(np.abs(good - rest))])
    scale = 1.0 / abs(full - rest)
    unit = " us" if is_pulse else ""
    extra = f'scale = {scale:.9g}, offset = {-scale * rest:.9g}, role = "input"'
    return extra, f"{rest:.6g}{unit} is taken for rest, {full:.6g}{unit} for full"
