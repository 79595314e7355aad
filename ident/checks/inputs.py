"""Checks of inputs that cannot have driven the boat.

Such inputs are constant, are a shaft speed that is stuck, or are the telemetry of another thruster.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations

import numpy as np

from seatrial.daq.checks import FAULT, UNKNOWN, WARNING, Finding
from seatrial.ident.checks.sensors import SENSOR_GRID_S, Channels
from seatrial.ident.checks.shafts import Response, response
from seatrial.ident.data import Channel, sample_and_hold
from seatrial.ident.model import (
    COMMAND,
    SHAFT_SPEED,
    THRUSTER_FORCE,
    THRUSTER_QUANTITIES,
    SignalId,
    command_of,
    commanded_thrusters,
    is_of_thruster,
    shaft_speed_of,
)
from seatrial.ident.numerics import Array

INPUTS = (COMMAND, SHAFT_SPEED, THRUSTER_FORCE)  # of one thruster; X and N are forces of all thrusters together
CONSTANT_PART = 0.005  # of the largest value, or of full speed: a pulse width that flickers by 1 us is still constant
SMOOTHED_S, EVERY_S = 2.0, 0.5  # window of the moving average of the motion, and interval between its values
SPEED_RISE, TURN_RISE = 0.5, 0.15  # m/s, rad/s: larger rises of speed or yaw rate need a changing thrust
LEVEL = 0.1  # of full speed: the sizes of an input within such a range are one level
AT_LEVEL = 0.05, 0.95  # quantiles of the sizes in time, so that start and end of a run do not count
LEAST_AT_LEVEL_S = 10.0  # of a shorter log, levels say nothing
MAX_RISES = 2  # with a constant thrust: the boat gathers speed, and begins to turn
STUCK_S, STUCK_SAMPLES = 5.0, 10  # a shaft speed is stuck if it stays the same for longer than both
TURNING = 0.05  # of full speed; a shaft turns at larger speeds
AGAINST = 0.5  # command over speed; at smaller commands the shaft has to slow down
AGAINST_S = 5.0  # longer than any delay of a shaft
COMMAND_CHANGE = 0.3  # of full command; a load cell must show a change of this size
FOLLOWS = 0.95  # R2 of a shaft speed by its own command, from which on no other thruster is considered
FOLLOWS_OTHER = 0.9  # R2 by the command of the other thruster, above which the telemetry may be exchanged
BETTER = 0.2  # largest error by the other thruster's command over the error by its own command


def check_thrust_present(c: Channels) -> Iterator[Finding]:
    """Yield a finding if the log of a boat has no thruster, or only one of the sides left and right.

    Parameters
    ----------
    c
        Channels (signals) of a log by name. Without a heading, a yaw rate or a velocity there is no finding.

    Yields
    ------
    Finding
        ``no-thrust`` (unknown), or ``one-side`` (warning).
    """
    if not {"psi", "r", "u", "vx"} & set(c) or {"X", "N"} & set(c):
        return
    driven = {SignalId.parse(n).source for n in c if is_of_thruster(n, *THRUSTER_QUANTITIES)}
    if not driven:
        text = "the log has no command, shaft speed or thrust, so the thrusters are not checked"
        advice = "a model of the boat needs them: import or log them too"
        yield Finding(UNKNOWN, "no-thrust", "thrusters", "log", text, advice)
    elif driven in ({"left"}, {"right"}):
        (side,) = driven
        text = f"the log has the {side} thruster only"
        advice = "a boat with two thrusters needs the signals of both: import or log the other one too"
        yield Finding(WARNING, "one-side", "thrusters", side, text, advice)


def check_inputs(c: Channels) -> Iterator[Finding]:
    """Yield findings on constant inputs of a moving boat, and on shaft speeds that do not follow their commands.

    Parameters
    ----------
    c
        Channels (signals) of a log by name. A log without inputs gives no finding.

    Yields
    ------
    Finding
        If all inputs are constant: at most one finding, ``inputs-constant`` or ``inputs-never-change``; none if speed
        and yaw rate do not rise. Else ``shaft-speed-stuck`` for each shaft speed that stays the same against its
        command. A shaft speed without a command gives it if its hold is ``linear``, it is constant and above 0.05 of
        full speed in the whole log, and speed and yaw rate rise more than twice. ``inputs-one-level`` (warning) if none
        of these findings applies and each thruster that turns has one level, forward or in reverse.
    """
    names = sorted(n for n in c if is_of_thruster(n, *INPUTS) or n in ("X", "N"))
    if not names:
        return
    found = list(_constant_inputs(c, names) if all(_is_constant(n, c[n]) for n in names) else _stuck_shafts(c, names))
    yield from found or _one_level(c)


def _stuck_shafts(c: Channels, names: list[str]) -> Iterator[Finding]:
    """Yield ``shaft-speed-stuck`` for each shaft speed among ``names`` that stays the same, as `check_inputs` says."""
    for name in (n for n in names if is_of_thruster(n, SHAFT_SPEED)):
        command = c.get(command_of(SignalId.parse(name).source))
        held = _stuck_against_command(c[name], command) if command is not None and command.t is not c[name].t else None
        if held is not None and command is not None and _turns_against(command, c[name]):
            continue  # a wrong sign, which `seatrial.ident.checks.shafts` reports: its steady speeds are not stuck
        advice = (
            "check cable, bus and firmware of the controller; or leave this signal out of the import map, so that the "
            "fit uses the command"
        )
        if held is not None:
            value, begin, end = held
            since = f"from {begin - c[name].t[0]:.1f} s on"
            text = f"stays at {value:.3g} for {end - begin:.1f} s, {since}, although the command changes"
            yield Finding(FAULT, "shaft-speed-stuck", "stuck", name, text, advice)
        elif command is None and c[name].hold == "linear" and _is_constant(name, c[name]):
            value = float(np.median(c[name].value))
            if abs(value) > TURNING and _count_motion_rises(c) > MAX_RISES:
                text = f"is {value:.3g} in the whole log, but the boat changes its speed or yaw rate"
                yield Finding(FAULT, "shaft-speed-stuck", "stuck", name, text, advice)


def _constant_inputs(c: Channels, names: list[str]) -> Iterator[Finding]:
    """Yield at most one finding on a log in which every input of ``names`` is constant.

    Rises of speed and yaw rate are counted. With inputs that are not zero, one or two rises give a warning (a constant
    thrust explains them), and more give a fault. With inputs of (nearly) zero any rise gives a fault. Without a rise
    there is no finding.
    """
    n_rises = _count_motion_rises(c)
    values = ", ".join(dict.fromkeys(f"{np.median(c[n].value):.3g}" for n in names))
    stopped = all(abs(float(np.median(c[n].value))) < TURNING for n in names)
    advice = "give the right column or topic in the import map; check whether the autopilot drives this output"
    if n_rises > (0 if stopped else MAX_RISES):
        text = f"constant in the whole log ({values}), but the boat speeds up and turns: other commands drove it"
        yield Finding(FAULT, "inputs-constant", "stuck", ", ".join(names), text, advice)
    elif n_rises and not stopped:
        text = f"constant in the whole log ({values}): a fit cannot separate thrust and damping"
        advice = "record a run with steps of the command (seatrial mission generate)"
        yield Finding(WARNING, "inputs-never-change", "stuck", ", ".join(names), text, advice)


def _one_level(c: Channels) -> Iterator[Finding]:
    """Yield at most one finding: each thruster of a boat that turns has one level, forward or in reverse.

    The sizes of a shaft speed, or of a command without a shaft speed, are one level if 90 % of the time they are within
    0.1 of full speed. Thrust curve, dead zone and drag then have the same consequence. Logs without motion (a bench),
    and logs shorter than 10 s, give no finding.
    """
    thrusters = {SignalId.parse(n).source for n in c if is_of_thruster(n, COMMAND, SHAFT_SPEED)}
    # the shaft speed replaces the command of its thruster
    named = {s: n for s in sorted(thrusters) for n in (command_of(s), shaft_speed_of(s)) if n in c and c[n].t.size}
    if not named or not {"psi", "r", "u", "vx", "x", "speed"} & set(c):
        return
    begin, end = max(c[n].t[0] for n in named.values()), min(c[n].t[-1] for n in named.values())
    if end - begin < LEAST_AT_LEVEL_S:
        return
    grid = np.arange(begin, end, SENSOR_GRID_S)
    sizes = {n: np.abs(sample_and_hold(c[n], grid)) for n in named.values()}
    known = {n: values[np.isfinite(values)] for n, values in sizes.items()}
    ranges = {n: np.quantile(values, AT_LEVEL) for n, values in known.items() if values.size}
    turning = {n: limits for n, limits in ranges.items() if limits[1] > TURNING}
    if not turning or any(high - low > LEVEL for low, high in turning.values()):
        return
    listed = ", ".join(f"{n} {low:.2f} to {high:.2f}" for n, (low, high) in turning.items())
    text = (
        f"the thrusters turn at one speed, forward or in reverse (of full: {listed}): a fit cannot tell thrust curve, "
        "dead zone and drag apart"
    )
    advice = "record steps of several sizes (seatrial mission generate), or fit this log together with logs at others"
    yield Finding(WARNING, "inputs-one-level", "level", ", ".join(turning), text, advice)


def _is_constant(name: str, channel: Channel) -> bool:
    """Return whether the values of the channel ``name`` vary by at most 0.5 % of full speed, or of the largest force.

    Commands and shaft speeds are compared with full speed (1), forces with their own largest size. The result is false
    without samples, and true for a force that is zero throughout.
    """
    if channel.value.size == 0:
        return False
    top = 1.0 if is_of_thruster(name, COMMAND, SHAFT_SPEED) else float(np.max(np.abs(channel.value)))
    return float(np.ptp(channel.value)) <= CONSTANT_PART * top


def _count_motion_rises(c: Channels) -> int:
    """Count the rises of the speed by more than 0.5 m/s, and of the size of the yaw rate by more than 0.15 rad/s.

    Both signals are averaged over 2 s against waves. The speed comes from velocities, else positions, else ``speed``.
    The yaw rate comes from the gyro, else the heading. The rises of both are added; the result is 0 without any of
    these signals.
    """
    curves: list[tuple[Array, float]] = []
    if {"vx", "vy"} <= set(c) or {"u", "v"} <= set(c):
        first, second = (c["vx"], c["vy"]) if {"vx", "vy"} <= set(c) else (c["u"], c["v"])
        curves.append((_moving_average(speed_of_velocities(first, second)), SPEED_RISE))
    elif {"x", "y"} <= set(c):
        curves.append((_moving_average(speed_of_positions(c["x"], c["y"], SMOOTHED_S)), SPEED_RISE))
    elif "speed" in c:
        curves.append((_moving_average(c["speed"]), SPEED_RISE))
    if "r" in c:
        curves.append((np.abs(_moving_average(c["r"])), TURN_RISE))
    elif "psi" in c:
        t = np.arange(c["psi"].t[0], c["psi"].t[-1], 0.5 * SMOOTHED_S)
        psi = np.interp(t, c["psi"].t, np.unwrap(c["psi"].value))
        curves.append((np.abs(_moving_average(Channel(t[1:], np.diff(psi) / (0.5 * SMOOTHED_S)))), TURN_RISE))
    return sum(_count_rises(curve, least) for curve, least in curves)


def speed_of_velocities(first: Channel, second: Channel) -> Channel:
    """Return the size of a velocity with two perpendicular components [m/s], at the times of the first one."""
    return Channel(first.t, np.hypot(first.value, np.interp(first.t, second.t, second.value)))


def speed_of_positions(x: Channel, y: Channel, seconds: float) -> Channel:
    """Return the speed between the positions x, y [m] in intervals of ``seconds`` [m/s], at the end of each."""
    t = np.arange(x.t[0], x.t[-1], seconds)
    north, east = (np.diff(np.interp(t, c.t, c.value)) for c in (x, y))
    return Channel(t[1:], np.hypot(north, east) / seconds)


def _moving_average(channel: Channel) -> Array:
    """Return the moving average (n,) of a signal over 2 s, with one value every 0.5 s.

    The result is empty if the signal is not longer than 2 s.
    """
    if channel.t.size < 2:
        return np.empty(0)
    t = np.arange(channel.t[0], channel.t[-1], SENSOR_GRID_S)
    width = round(SMOOTHED_S / SENSOR_GRID_S)
    if t.size <= width:
        return np.empty(0)
    whole = np.append(0.0, np.cumsum(np.interp(t, channel.t, channel.value)))
    return np.asarray((whole[width:] - whole[:-width])[:: round(EVERY_S / SENSOR_GRID_S)] / width)


def _count_rises(curve: Array, least: float) -> int:
    """Count the rises of a curve (n,) by more than ``least``, in the unit of the curve.

    A rise starts at the lowest value since the last rise ended. It ends when the curve has fallen by more than
    ``least`` from its highest value in the rise. NaN is ignored.
    """
    n, low, high, rising = 0, np.inf, -np.inf, False
    for value in curve.tolist():
        if rising:
            high = max(high, value)
            if value < high - least:
                rising, low = False, value
            continue
        low = min(low, value)
        if value > low + least:
            n, rising, high = n + 1, True, value
    return n


def _stuck_against_command(shaft: Channel, command: Channel) -> tuple[float, float, float] | None:
    """Return the longest time in which a shaft speed is stuck, as (shaft speed, begin [s], end [s]).

    In this time, of 5 s or more and with at least 11 samples, the shaft speed stays exactly the same, and its size is
    0.05 of full speed or more. Its command is below half of it, or in the other direction, for at least 5 s in
    sequence. Of equally long times the first is returned. The result is None if the shaft speed is never stuck.
    """
    first = np.flatnonzero(np.diff(shaft.value, prepend=np.nan) != 0)
    last = np.append(first[1:], shaft.value.size) - 1
    found = None
    for a, b in zip(first.tolist(), last.tolist(), strict=True):
        value, begin, end = float(shaft.value[a]), float(shaft.t[a]), float(shaft.t[b])
        if abs(value) < TURNING or b - a < STUCK_SAMPLES or end - begin < STUCK_S:
            continue
        grid = np.arange(begin, end, SENSOR_GRID_S)
        against = np.sign(value) * sample_and_hold(command, grid) < AGAINST * abs(value)
        if _longest_run(against) * SENSOR_GRID_S >= AGAINST_S and (found is None or end - begin > found[2] - found[1]):
            found = value, begin, end
    return found


def _turns_against(command: Channel, shaft: Channel) -> bool:
    """Return whether a shaft speed follows its command with the wrong sign (R2 above 0.9)."""
    found = response(command, shaft)
    return isinstance(found, Response) and found.scale < 0.0 and found.r2 > FOLLOWS_OTHER


def _longest_run(mask: Array) -> int:
    """Return the largest number of consecutive true values of a logical array (n,); 0 if all are false."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return int(np.max(edges[1::2] - edges[::2], initial=0))


def check_frozen_force(c: Channels) -> Iterator[Finding]:
    """Yield a fault if a measured force stays exactly the same while the command of a thruster changes.

    Parameters
    ----------
    c
        Channels (signals) of a log by name. Only the longest time in which ``force`` stays the same is examined. It
        must last for at least 5 s, with at least 11 samples, and contain a change of a command or shaft speed by more
        than 0.3 of full speed.
    """
    commands = [c[n] for n in sorted(c) if is_of_thruster(n, COMMAND, SHAFT_SPEED)]
    if "force" not in c or not commands:
        return
    force = c["force"]
    first = np.flatnonzero(np.diff(force.value, prepend=np.nan) != 0)
    last = np.append(first[1:], force.value.size) - 1
    k = int(np.argmax(force.t[last] - force.t[first]))
    begin, end = float(force.t[first[k]]), float(force.t[last[k]])
    if last[k] - first[k] < STUCK_SAMPLES or end - begin < STUCK_S:
        return
    grid = np.arange(begin, end, SENSOR_GRID_S)
    # A load cell of coarse resolution may not show the thrust of a smaller change.
    if max(float(np.ptp(sample_and_hold(command, grid))) for command in commands) > COMMAND_CHANGE:
        since = f"{end - begin:.1f} s, from {begin - force.t[0]:.1f} s on"
        text = f"stays at {force.value[first[k]]:.4g} N for {since}, although the command changes"
        advice = "check the load cell, its amplifier, and the column of force in the import map"
        yield Finding(FAULT, "channel-frozen", "stuck", "force", text, advice)


def check_exchanged_telemetry(c: Channels) -> Iterator[Finding]:
    """Yield a fault for two thrusters whose shaft speeds each follow the command of the other thruster.

    Parameters
    ----------
    c
        Channels (signals) of a log by name. At least two thrusters with command and measured shaft speed are needed.
        Each speed must be explained by the command of the other thruster with an R2 above 0.9, by its own command with
        an R2 below 0.95, and with less than a fifth of the error by its own command.
    """
    names = [n for n in sorted(commanded_thrusters(c)) if shaft_speed_of(n) in c]
    names = [n for n in names if c[shaft_speed_of(n)].t is not c[command_of(n)].t]
    if len(names) < 2:
        return
    own = {n: _r2_of_command(c, n, n) for n in names}
    unexplained = [n for n in names if own[n] < FOLLOWS]
    cross = {(a, b): _r2_of_command(c, a, b) for a, b in permutations(unexplained, 2)}
    for a, b in cross:
        both = ((a, b), (b, a))
        clear = all(cross[p] > FOLLOWS_OTHER and 1.0 - cross[p] < BETTER * (1.0 - own[p[1]]) for p in both)
        if a < b and clear:
            text = (
                f"their telemetry is exchanged: the shaft speed of {a} follows the command of {b}, and that of {b} "
                f"the command of {a}"
            )
            advice = (
                "exchange the nodes of both controllers in the rig file, or the shaft-speed columns in the import map"
            )
            yield Finding(FAULT, "telemetry-exchanged", "thrusters", f"{a} and {b}", text, advice)


def _r2_of_command(c: Channels, command: str, shaft: str) -> float:
    """Return R2 (0 to 1) of the speed of the thruster ``shaft`` explained by the command of the thruster ``command``.

    The result is 0 if the response cannot be estimated, or if the shaft turns against the command.
    """
    found = response(c[command_of(command)], c[shaft_speed_of(shaft)])
    return found.r2 if isinstance(found, Response) and found.scale > 0.0 else 0.0
