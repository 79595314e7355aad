"""Checks of shaft speeds against full speed and against their commands.

Shaft speeds may be wrong in one direction: zero, wrapped to 65536 - n, or without their sign. Or their scale is wrong.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks import FAULT, WARNING, Finding
from seatrial.ident.checks.sensors import Channels
from seatrial.ident.checks.signals import largest_inputs
from seatrial.ident.data import Channel, sample_and_hold
from seatrial.ident.model import (
    SHAFT_SPEED,
    SignalId,
    command_of,
    commanded_thrusters,
    is_of_thruster,
    shaft_speed_of,
)
from seatrial.ident.numerics import Array

SETTLED_S = 1.5  # a command must keep its sign and size for this time before a shaft is compared with it
MAX_YAW_RATE, MIN_YAW_RATE = 5.0, 0.02  # rad/s: the largest of a boat, and the smallest that differs from rest
MIN_COMMAND = 0.12  # of full command; a shaft turns at larger commands
MIN_SAMPLES = 10  # of each direction
# Commands that show a line of the shaft speed, as shares of full: least range, least size of the largest one, and the
# largest dead zone
LEAST_RANGE, LEAST_TOP, MAX_DEAD_ZONE = 0.3, 0.6, 0.3
# A scale is wrong if the shaft speed exceeds full speed, or the command at full command, by this factor. A propeller
# turns some 10 % faster under way than at the bollard.
MAX_OVER = 1.15
# A scale may be too small if the shaft speeds of all thrusters are below this share of the command at full command. On
# simulated boats with a sagging battery the share falls to 0.87.
LEAST_UNDER = 0.82
# A line is straight if its offset is below this share of the speed at full command, and its residuals have a smaller
# root mean square than the second share.
STRAIGHT_OFFSET, STRAIGHT_RESIDUAL = 0.05, 0.05
MAX_SPEED = 1.5  # of full speed; larger values are no shaft speed
NEAR_MAX = 0.7  # of the largest value; wrapped values lie above it
MAX_BETWEEN = 0.1  # share of the samples between real and wrapped values
TURNS, STOPPED, IMPOSSIBLE = 0.3, 0.05, 3.0  # speed over command, of a shaft that turns, stands still, cannot exist


def one_sided_shafts(c: Channels) -> dict[str, Finding]:
    """Compare each shaft speed with its command, separately for both signs of the command.

    Parameters
    ----------
    c
        Channels (signals) of a log by name. A thruster needs both a command and a measured shaft speed. A shaft speed
        with the same array of times as the command is a copy of it, and is not compared.

    Returns
    -------
    dict
        A fault for each thruster whose speed is zero in one direction only, or positive in both, by the name of the
        thruster. Empty if there is none.
    """
    found = ((n, _one_sided_fault(n, command, shaft)) for n, command, shaft in _measured_shafts(c))
    return {n: finding for n, finding in found if finding is not None}


def speed_at_full_command(c: Channels) -> float | None:
    """Return the shaft speed at full command over full speed.

    Parameters
    ----------
    c
        Channels (signals) of a log by name. A shaft speed with the same array of times as its command is a copy of it,
        and is not used.

    Returns
    -------
    float or None
        Mean of the thrusters. None if no thruster has both signals and steady forward commands.

    Notes
    -----
    It is the value at full command of the straight line through the shaft speeds at steady forward commands. Below a
    dead zone a shaft does not turn, so that its speed over the command is too small at all commands but the full one.
    The line (`speed_line`) is used if the commands differ enough. Otherwise the value is the median of shaft speed over
    command.
    """
    found = [_speed_at_full_command(command, shaft) for _, command, shaft in _measured_shafts(c)]
    known = [ratio for ratio in found if ratio is not None and TURNS < ratio < IMPOSSIBLE]
    return float(np.mean(known)) if known else None


def check_shaft_scale(c: Channels) -> Iterator[Finding]:
    """Yield a warning for each shaft speed or command whose scale seems wrong for shares of full speed.

    Parameters
    ----------
    c
        Channels (signals) of a log by name. Signals with a fault of their unit are not among them.

    Yields
    ------
    Finding
        ``above-full-speed`` for a shaft speed or command above 1.15 (99 % quantile of its size).
        ``shaft-above-command`` for any other shaft speed that is more than 1.15 times the command at full command.
        ``shaft-below-command`` for all shaft speeds, if each is less than 0.82 times the command at full command.

    Notes
    -----
    A shaft speed a little below its command is no finding: a low battery, the load of the propeller or a limit of the
    controller can be the reason. All shafts have one scale, so that one slow shaft is none either. A shaft speed that
    does not grow with the command along a straight line is not compared with it. If a controller linearises the thrust,
    for example, the speed grows with the root of the command.
    """
    over = {n: top for n, top in largest_inputs(c).items() if top > MAX_OVER}
    found = ((n, _straight_ratio(command, shaft)) for n, command, shaft in _measured_shafts(c))
    known = {shaft_speed_of(n): ratio for n, ratio in found if ratio is not None}
    ratios = {n: ratio for n, ratio in known.items() if ratio > MAX_OVER}
    for signal, top in over.items():
        # The ratio is exact; the largest speed of a log may be below full speed.
        factor, text = ratios.get(signal, top), f"reaches {top:.2f}, but 1 is full speed"
        text += f"; it is {factor:.2f} times the command at full command" if signal in ratios else ""
        advice = f"{_divide_scale(signal, factor)}; with a wrong scale, a fit changes masses and thrust to match"
        yield Finding(WARNING, "above-full-speed", "units", signal, text, advice)
    for signal in sorted(ratios.keys() - over.keys()):
        command, ratio = command_of(SignalId.parse(signal).source), ratios[signal]
        if command not in over:
            text = f"is {ratio:.2f} times the command at full command, but 1 is full speed for both"
            advice = _divide_scale(signal, ratio)
            if not any(is_of_thruster(n, SHAFT_SPEED) for n in over):  # all shafts have one scale
                advice += f"; if {command} is below 1 at full command, multiply its scale by {ratio:.2f} instead"
            yield Finding(WARNING, "shaft-above-command", "units", signal, text, advice)
    if known and not over and all(TURNS < ratio < LEAST_UNDER for ratio in known.values()):
        each = ", ".join(dict.fromkeys(f"{ratio:.2f}" for ratio in known.values()))
        text = f"only {each} times the command at full command: full speed may be a smaller number than the scale says"
        advice = (
            "set the scale in the import map to 1 / (number at full speed), or correct rpm_max in the rig file; if a "
            "low battery or a limit of the controller keeps the shafts below full speed, nothing has to be done"
        )
        yield Finding(WARNING, "shaft-below-command", "units", ", ".join(known), text, advice)


def _divide_scale(signal: str, factor: float) -> str:
    """Return the advice to divide the scale of a shaft speed or command by a factor.

    The factor is that of one log, with its noise. A bench result holds for the scale of its own log.
    """
    advice = f"divide the scale of {signal} in the import map by {factor:.2f}"
    if is_of_thruster(signal, SHAFT_SPEED):
        advice += (
            f", or multiply rpm_max in the rig file by {factor:.2f} (for a fit with --thruster, take the scale or "
        )
        advice += "the rpm_max of the bench log instead)"
    return advice


def _straight_ratio(command: Channel, shaft: Channel) -> float | None:
    """Return the shaft speed at full command over full speed, or None unless a straight line shows it well.

    The steady forward commands must cover a range of 0.3 and reach 0.6 of full command. The line may have a dead zone,
    but no positive offset, as that of a root has.
    """
    level, speed = _at_steady_commands(command, shaft, 1.0)
    if level.size < MIN_SAMPLES or np.ptp(level) < LEAST_RANGE or np.max(level) < LEAST_TOP:
        return None
    slope, offset = np.polyfit(level, speed, 1)
    full = float(slope + offset)
    straight = -MAX_DEAD_ZONE * slope < offset < STRAIGHT_OFFSET * full
    if not straight or np.std(speed - slope * level - offset) > STRAIGHT_RESIDUAL * full:
        return None
    return full


def _measured_shafts(c: Channels) -> list[tuple[str, Channel, Channel]]:
    """Return the name, command and shaft speed of each thruster that has both, sorted by name.

    A shaft speed with the same array of times as its command is a copy of it. Its thruster is left out.
    """
    names = [n for n in sorted(commanded_thrusters(c)) if shaft_speed_of(n) in c]
    both = [(n, c[command_of(n)], c[shaft_speed_of(n)]) for n in names]
    return [(n, command, shaft) for n, command, shaft in both if command.t is not shaft.t]


def wrapped(value: Array, fastest: float = MAX_SPEED, clear: float = MIN_COMMAND) -> bool:
    """Return whether negative values -n of a signal are logged as 65536 - n (unsigned 16 bits).

    Parameters
    ----------
    value
        Shaft speed over full speed, or yaw rate [rad/s] (n,).
    fastest
        Largest possible size of the value, in its unit.
    clear
        Sizes above this one differ from rest.

    Returns
    -------
    bool
        False if the largest size is below twice ``fastest``. Also false if fewer than 10 values are possible and differ
        from rest, if fewer than 10 are above 0.7 of the largest size, or if 10 % or more lie between both groups.

    Notes
    -----
    Wrapped signals have two groups of sizes: possible values, and values near one far larger number. Few samples lie
    between them, taken while the shaft changed its direction.
    """
    size = np.abs(value)
    top = float(size.max(initial=0.0))
    high, low = size > NEAR_MAX * top, size <= fastest
    if (
        top < 2.0 * fastest
        or np.count_nonzero(high) < MIN_SAMPLES
        or np.count_nonzero(low & (size > clear)) < MIN_SAMPLES
    ):
        return False
    return bool(np.mean(~(high | low)) < MAX_BETWEEN)


def check_wrapped(c: Channels) -> Iterator[Finding]:
    """Yield a fault for each shaft speed or yaw rate whose negative values -n are logged as 65536 - n.

    Parameters
    ----------
    c
        Channels (signals) of a log by name.
    """
    if "r" in c and wrapped(c["r"].value, MAX_YAW_RATE, MIN_YAW_RATE):
        text = f"goes to {np.abs(c['r'].value).max():.4g} rad/s: negative rates are wrapped to 65536 - n"
        advice = "decode it as a signed number of 16 bits, and import the log again"
        yield Finding(FAULT, "gyro-wrapped", "sign", "r", text, advice)
    for name in sorted(n for n in c if is_of_thruster(n, SHAFT_SPEED)):
        value = c[name].value
        if wrapped(value):
            text = f"goes to {np.abs(value).max():.4g} of full speed: negative speeds are wrapped to 65536 - n"
            advice = (
                "decode it as a signed number of 16 bits, or leave it out of the import map, so that the fit uses the "
                "command"
            )
            yield Finding(FAULT, "shaft-speed-wrapped", "sign", name, text, advice)


def _one_sided_fault(name: str, command: Channel, shaft: Channel) -> Finding | None:
    """Return a fault if the shaft speed of a thruster is zero in one direction only, or positive in both; else None.

    Zero in one direction is a speed below 0.05 of the command there, and above 0.3 of it in the other direction.
    Positive in both is a speed of 0.3 to 3 times the size of the command. The result is None also if the command was
    not steady for long enough in each direction (`_speed_over_command`).
    """
    forward, reverse = (_speed_over_command(command, shaft, sign) for sign in (1.0, -1.0))
    if forward is None or reverse is None:
        return None
    text = ""
    if forward > TURNS and abs(reverse) < STOPPED:
        text = f"the shaft speed is zero at reverse commands, but {forward:.2f} times the command at forward ones"
    elif reverse > TURNS and abs(forward) < STOPPED:
        text = f"the shaft speed is zero at forward commands, but {reverse:.2f} times the command at reverse ones"
    elif TURNS < forward < IMPOSSIBLE and -IMPOSSIBLE < reverse < -TURNS:
        text = "the shaft speed is positive at forward and at reverse commands: its sign is lost"
    if not text:
        return None
    advice = (
        "watch whether the shaft turns in reverse; if it does, leave the shaft speed out of the import map, so that "
        "the fit uses the command"
    )
    return Finding(FAULT, "shaft-speed-one-sided", "sign", name, text, advice)


def _speed_over_command(command: Channel, shaft: Channel, sign: float) -> float | None:
    """Return the median of shaft speed over command, at steady commands of one sign (``sign`` +1 or -1).

    A positive result means that the shaft turns in the direction of its command. The result is None for fewer than 10
    samples of the shaft speed at steady commands (`_at_steady_commands`).
    """
    level, speed = _at_steady_commands(command, shaft, sign)
    return None if level.size < MIN_SAMPLES else float(np.median(sign * speed / level))


def _speed_at_full_command(command: Channel, shaft: Channel) -> float | None:
    """Return the shaft speed at full command over full speed; None without enough steady forward commands."""
    level, speed = _at_steady_commands(command, shaft, 1.0)
    if level.size < MIN_SAMPLES:
        return None
    if np.ptp(level) >= LEAST_RANGE and np.max(level) >= LEAST_TOP:
        slope, offset = speed_line(level, speed)
        if offset > -MAX_DEAD_ZONE * slope:
            return slope + offset
    return float(np.median(speed / level))


def speed_line(command: Array, speed: Array) -> tuple[float, float]:
    """Return slope and offset of the line through the shaft speeds (n,) at commands (n,) of one direction.

    ``command`` and ``speed`` are sizes over the full ones. The line passes zero at zero command, or at a positive one,
    as of a shaft with a dead zone: a positive offset would be that of a shaft with a limit of its speed.
    """
    slope, offset = np.polyfit(command, speed, 1)
    if offset > 0.0:
        return float(np.mean(speed / command)), 0.0
    return float(slope), float(offset)


def _at_steady_commands(command: Channel, shaft: Channel, sign: float) -> tuple[Array, Array]:
    """Return the sizes of steady commands of one sign, and the shaft speeds at these times, both (n,).

    A command is steady if its size exceeds 0.12 of full command and it varied by less than 0.1 in the last 1.5 s.
    """
    at = [sample_and_hold(command, shaft.t - late) * sign for late in np.linspace(0.0, SETTLED_S, 7)]
    steady: NDArray[np.bool_] = np.min(at, axis=0) > MIN_COMMAND
    steady &= np.ptp(at, axis=0) < 0.1
    return at[0][steady], shaft.value[steady]
