"""Change of the shaft speed at equal commands, within a log and between logs, as that of a battery that empties.

The steady shaft speed is a quadratic of the command with an offset for each direction (dead zone, limit, sag under
load), which is common to all times. Only its slope differs between two groups of held commands: the first and the last
third of a log, or two logs. The relative difference of the slopes is the change.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks import WARNING, Finding
from seatrial.ident.checks.sensors import Channels
from seatrial.ident.checks.shaft_sign import IMPOSSIBLE, TURNS, speed_line
from seatrial.ident.checks.shafts import held_commands
from seatrial.ident.model import command_of, commanded_thrusters, shaft_speed_of
from seatrial.ident.numerics import Array

LEAST_CHANGE = 0.03  # of the shaft speed, which is 6 % of the thrust; smaller changes do not matter
CLEAR = 4.0  # standard errors; a change is reported above them
LEAST_COMMAND = 0.2  # of full command; at smaller ones the dead zone matters more than the slope
ALIKE = 1.0 / 3.0  # of a change; a battery slows two shafts alike, but not exactly
FEWEST = 3  # held commands of a group
# A shaft without a limit: its speed at the highest commands over that expected from the middle ones, and these commands
# as shares of the largest one.
FOLLOWS, TOP, MIDDLE = 0.97, 0.9, (0.4, 0.8)
FEWEST_TOP = 2  # held commands at the top
FEWEST_DOF = 5  # held commands beyond the coefficients, for a standard error


class Change(NamedTuple):
    """Relative change of the shaft speed at equal commands, with its standard error."""

    change: float
    error: float

    @property
    def is_clear(self) -> bool:
        """Whether the change matters and is no chance: it is above 3 % and above four standard errors."""
        return abs(self.change) > max(LEAST_CHANGE, CLEAR * self.error)

    def is_like(self, other: Change) -> bool:
        """Return whether two changes are equal within four standard errors of their difference, or within a third."""
        apart = abs(self.change - other.change)
        alike = max(CLEAR * float(np.hypot(self.error, other.error)), ALIKE * abs(self.change))
        return self.change * other.change > 0.0 and apart <= alike

    @property
    def text(self) -> str:
        """Size of the change in per cent, with its standard error: ``5.1 % (standard error 0.6 %) lower``."""
        way = "lower" if self.change < 0.0 else "higher"
        return f"{100 * abs(self.change):.1f} % (standard error {100 * self.error:.1g} %) {way}"


class Held(NamedTuple):
    """Commands that were held for at least 4 s, and the shaft speeds that they reached.

    Attributes
    ----------
    t
        Start of each command [s] (n,).
    command
        Commands over full command (n,), all above 0.2 in size.
    speed
        Shaft speeds over full speed (n,).
    begin, end
        Times [s] of the first and the last sample of the shaft speed.
    """

    t: Array
    command: Array
    speed: Array
    begin: float
    end: float


def check_shaft_gain(c: Channels) -> Iterator[Finding]:
    """Yield a warning for each shaft whose speed at equal commands differs between the thirds of a log.

    Parameters
    ----------
    c
        Channels (signals) of a log by name. A thruster needs both a command and a measured shaft speed.

    Yields
    ------
    Finding
        Warning ``shaft-speed-drifts``, with the change from the first to the last third of the log.
    """
    changes: dict[str, Change | None] = {}
    for name, held in held_of_thrusters(c).items():
        third = (held.end - held.begin) / 3.0
        first, last = held.t < held.begin + third, held.t >= held.end - third
        used = first | last
        changes[name] = _change(held.command[used], held.speed[used], last[used])
    for name, change in changes.items():
        if change is not None and change.is_clear:
            text = f"in the last third of the log the shaft speed at equal commands is {change.text} than in the first"
            others = [other for key, other in changes.items() if key != name]
            yield _finding("shaft-speed-drifts", name, text, change, others)


def compare_shaft_gains(logs: Sequence[tuple[str, Mapping[str, Held]]]) -> list[tuple[str, Finding]]:
    """Return a warning for each shaft whose speed at equal commands differs between logs.

    Parameters
    ----------
    logs
        Name of each log, and its held commands by thruster (`held_of_thrusters`).

    Returns
    -------
    list of tuple
        Name of a log, and its finding ``shaft-speed-differs``: the log that differs most from the first log of the same
        thruster. At most one for each thruster.
    """
    of_logs: dict[str, list[tuple[str, Held]]] = {}
    for log, of_thrusters in logs:
        for thruster, held in of_thrusters.items():
            of_logs.setdefault(thruster, []).append((log, held))
    changes: dict[str, dict[str, Change | None]] = {}  # by thruster and log
    for thruster, ((_, first), *others) in of_logs.items():
        changes[thruster] = {}
        for log, held in others:
            of_second = np.repeat([False, True], [first.t.size, held.t.size])
            command, speed = (np.concatenate([getattr(x, key) for x in (first, held)]) for key in ("command", "speed"))
            changes[thruster][log] = _change(command, speed, of_second)
    found = []
    for thruster, of_thruster in changes.items():
        clear = {log: change for log, change in of_thruster.items() if change is not None and change.is_clear}
        if clear:
            log = max(clear, key=lambda name: abs(clear[name].change))
            text = f"the shaft speed at equal commands is {clear[log].text} than in {of_logs[thruster][0][0]}"
            beside = [of_other.get(log) for name, of_other in changes.items() if name != thruster]
            found.append((log, _finding("shaft-speed-differs", thruster, text, clear[log], beside)))
    return found


def _finding(code: str, thruster: str, text: str, change: Change, others: Sequence[Change | None]) -> Finding:
    """Return the warning of a change of the shaft speed of a thruster.

    ``others`` are the changes of the other thrusters; None if they are unknown. A change of all thrusters by the same
    part points to their common supply, one of a single thruster to this thruster.
    """
    known = [other for other in others if other is not None]
    if known and len(known) == len(others) and all(change.is_like(other) for other in known):
        look = "all shafts changed alike, which points to their supply: look at the voltage of the battery"
    elif known and not any(other.is_clear for other in known):
        part = (
            "weed, ice or a line around the propeller"
            if change.change < 0.0
            else "a propeller that slips or has lost a blade"
        )
        look = (
            f"only this shaft changed, so the cause is hardly the battery: look for {part}, and at its speed controller"
        )
    else:
        look = "look at the voltage of the battery, and for weed or a slipping propeller"
    advice = (
        f"{look}; a model with the shaft speeds as inputs is not affected, but one of commands alone takes their ratio "
        "as constant"
    )
    return Finding(WARNING, code, "shaft", thruster, text, advice)


def held_of_thrusters(c: Channels) -> Mapping[str, Held]:
    """Return the held commands of each thruster by name, in which the shaft turned with its command.

    A shaft speed with the same array of times as its command is a copy of it. Its thruster is left out.
    """
    found = {}
    for name in sorted(commanded_thrusters(c)):
        command, shaft = c[command_of(name)], c.get(shaft_speed_of(name))
        if shaft is None or shaft.t is command.t:
            continue
        all_held = [h for h in held_commands(command, shaft) if abs(h.level) > LEAST_COMMAND]
        turning = [h for h in all_held if TURNS < h.settled / h.level < IMPOSSIBLE]
        t, level, speed = (np.array([getattr(h, key) for h in turning]) for key in ("t", "level", "settled"))
        found[name] = Held(t, level, speed, float(shaft.t[0]), float(shaft.t[-1]))
    return found


def followed_command(runs: Sequence[Channels]) -> float | None:
    """Return the largest command of runs, if the measured shaft speeds of all thrusters follow the commands up to it.

    So no shaft has a limit of its speed below it.

    Parameters
    ----------
    runs
        Channels (signals) of each run by name.

    Returns
    -------
    float or None
        Size of the command over full command, the smallest of all thrusters. None if a shaft speed is not measured, is
        an exact copy of the command, falls short of it, or if too few commands were held to tell.
    """
    largest = []
    held = [held_of_thrusters(c) for c in runs]
    for name in sorted({name for c in runs for name in commanded_thrusters(c)}):
        of_thruster = [of_run[name] for of_run in held if name in of_run]
        commands = np.concatenate([c[command_of(name)].value for c in runs if command_of(name) in c])
        top = float(commands[np.argmax(np.abs(commands))])
        if not of_thruster or not top:
            return None
        command, speed = (np.concatenate([getattr(h, key) for h in of_thruster]) for key in ("command", "speed"))
        same_way = command * top > 0.0
        if not _follows_to(abs(top), np.abs(command[same_way]), np.abs(speed[same_way])):
            return None
        largest.append(abs(top))
    return min(largest, default=None)


def _follows_to(top: float, size: Array, speed: Array) -> bool:
    """Return whether the shaft speed grows with held commands of one direction up to the largest command ``top``.

    ``size`` and ``speed`` are the sizes of the commands and of the settled shaft speeds (n,). The speeds at the highest
    commands are compared with the line through those at the middle ones (`speed_line`).
    """
    high, middle = size >= TOP * top, (size >= MIDDLE[0] * top) & (size <= MIDDLE[1] * top)
    if np.count_nonzero(high) < FEWEST_TOP or np.count_nonzero(middle) < FEWEST or size.max() < FOLLOWS * top:
        return False
    if np.array_equal(size, speed):
        return False
    slope, offset = speed_line(size[middle], speed[middle])
    return bool(np.min(speed[high] / (offset + slope * size[high])) >= FOLLOWS)


def _change(command: Array, speed: Array, second: NDArray[np.bool_]) -> Change | None:
    """Return the relative change of the shaft speed at equal commands from the first to the second group.

    ``command`` and ``speed`` are held commands and their shaft speeds (n,), and ``second`` is true for those of the
    second group (n,). None if a group is too small for a comparison.
    """
    if min(np.count_nonzero(second), np.count_nonzero(~second)) < FEWEST:
        return None
    size, ways = np.abs(command), [way for way in (command > 0.0, command < 0.0) if way.any()]
    design = np.column_stack([size, size * second, size**2, *ways])
    dof = command.size - design.shape[1]
    if dof < FEWEST_DOF or np.linalg.matrix_rank(design) < design.shape[1]:
        return None
    coefficients = np.linalg.lstsq(design, np.abs(speed), rcond=None)[0]
    misfit = np.abs(speed) - design @ coefficients
    variance = float(misfit @ misfit) / dof * float(np.linalg.inv(design.T @ design)[1, 1])
    # Relative to the mean shaft speed of the first group per command.
    mean = float(np.mean(np.abs(speed[~second])) / np.mean(size[~second]))
    return Change(float(coefficients[1]) / mean, float(np.sqrt(variance)) / mean)
