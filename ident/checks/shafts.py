"""Response of each shaft to its command: delay, dead band, limit, drop-outs, sign, unit, and whether it turns at all.

The boat's response to its thrusters is checked by `seatrial.ident.checks.motion`.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks import Finding
from seatrial.ident.checks.recent_results import RecentResults
from seatrial.ident.checks.sensors import Channels
from seatrial.ident.data import Channel, sample_and_hold
from seatrial.ident.model import command_of, commanded_thrusters, shaft_speed_of
from seatrial.ident.numerics import Array, LagData, LagFit, first_order_lag, fit_first_order_lag, steady_segments

SHAFT_GRID_S = 0.05  # s, of the common grid of command and shaft, and of delays
# Values of the search for the response.
DELAYS = tuple(np.arange(0.0, 3.0 + SHAFT_GRID_S / 2, SHAFT_GRID_S).tolist())  # s
TIME_CONSTANTS = (0.0, 0.07, 0.14, 0.3, 0.6, 1.2)  # s
DEAD_BANDS = np.array([0.0, *np.arange(0.02, 0.41, 0.01)])  # of full command
MAX_DELAY, MAX_DEAD_BAND = 0.6, 0.15  # s; of full command: largest usual values of an ESC
MIN_COMMAND = 0.1  # of full command; a shaft should turn at larger commands
MIN_SPEED = 0.02  # of full speed; a shaft turns at larger speeds
MIN_HOLD_S = 4.0  # a command held for this time shows the speed at which the shaft settles
MIN_STEP = 0.05  # of full command; smaller steps are not evaluated
REVERSE = -0.05  # of the settled speed; below it the shaft turns the other way and has not dropped out
MIN_COMMANDED_S = 1.0  # a shaft that has not moved after commands of this total duration is dead
MIN_SAMPLES = 40  # of the common grid
MAX_SEARCH_SAMPLES = 36_000  # of the common grid, from the first command on; more only cost time
# A response is clearly worse than another one if its misfit is larger by this part, and by so many variances of a
# sample.
CLEARLY, CLEARLY_VARIANCES = 0.1, 30.0
MAX_RISE_TIME_S = 1.0  # until half of a step shows
# A shaft that moves in the row of its command: rows at most so far apart [s], of which so many before the step have one
# command; number of steps; least and largest share of the step, and largest spread of this share, as a part of it. With
# slow rows, or if the share varies, the command was sent at some time between two rows.
MAX_ROW_S, QUIET_ROWS, FEWEST_STEPS = 0.2, 5, 5
LEAST_SHARE, LARGEST_SHARE, LARGEST_SPREAD = 0.05, 0.9, 0.5
SAME_STAMP_S = 1e-4
RAD_PER_S = 2.0 * np.pi / 60.0  # rad/s of one revolution per minute


class Response(NamedTuple):
    """Response of a shaft to its command: n(t) = scale * lag(n_cmd(t - delay)), outside a dead band.

    Attributes
    ----------
    delay
        Pure delay [s] between command and shaft speed.
    time_constant
        Time constant [s] of the first-order lag.
    band
        Half width of the dead band, as a share of full command. Smaller commands count as zero.
    scale
        Shaft speed over command; negative if the shaft turns against its command.
    r2
        Coefficient of determination of the shaft speed, 0 to 1: explained share of its mean square, without subtraction
        of the mean.
    band_gain
        Part of the squared error without a dead band that the dead band removes, 0 to 1.
    delay_known
        False if a delay on the other side of 0.6 s fits nearly as well, or if the command does not change.
    """

    delay: float
    time_constant: float
    band: float
    scale: float
    r2: float
    band_gain: float
    delay_known: bool


class NoResponse(Enum):
    """Reason for which the response of a shaft cannot be estimated.

    Attributes
    ----------
    TOO_SHORT
        Command and shaft speed overlap for less than 5 s (the last command counts for 5 s), or the shaft did not turn
        and was commanded for less than 1 s.
    STILL
        The shaft does not turn although it is commanded.
    """

    TOO_SHORT = "too short"
    STILL = "does not turn"


def check_shafts(c: Channels) -> Iterator[Finding]:
    """Yield findings on the response of each shaft to its command.

    Parameters
    ----------
    c
        Channels (signals) of a log by name. A thruster needs both a command and a measured shaft speed; others are not
        checked.

    Yields
    ------
    Finding
        Dead shafts; delay, dead band, limit, drop-outs, sign and scale of the others.
    """
    for thruster in sorted(commanded_thrusters(c)):
        command, shaft = c[command_of(thruster)], c.get(shaft_speed_of(thruster))
        if shaft is not None and shaft.t is not command.t:
            yield from _shaft_findings(thruster, command, shaft)


def _shaft_findings(name: str, command: Channel, shaft: Channel) -> Iterator[Finding]:
    """Yield the findings on the shaft of one thruster.

    A shaft whose telemetry ended more than 3 s before a command, that does not turn, that was recorded for too short a
    time, or that hardly follows its command gets only that finding. A shaft that was never commanded above 0.1 of full
    command gets none.
    """
    silent = shaft.t[-1] + 3.0
    commanded = (np.abs(command.value) > MIN_COMMAND) & (command.t > silent)
    if commanded.any() or np.max(np.abs(command.value), initial=0.0) < MIN_COMMAND:
        if commanded.any():
            since = shaft.t[-1] - min(command.t[0], shaft.t[0])
            yield Finding(
                "fault",
                "controller-fell-silent",
                "dead",
                name,
                f"the thruster is commanded, but its controller sent no telemetry after {since:.0f} s of the log",
                "check power, bus and fuse of this controller",
            )
        return
    found = response(command, shaft)
    if found is NoResponse.TOO_SHORT:
        yield Finding(
            "warning",
            "shaft-too-short",
            "shaft",
            name,
            "command and shaft speed overlap for too short a time to estimate the response of the shaft",
            f"record command and shaft speed together for {DELAYS[-1] + 2.0 * MIN_SAMPLES * SHAFT_GRID_S:.0f} s or "
            "more",
        )
        return
    if found is NoResponse.STILL:
        yield Finding(
            "fault",
            "shaft-does-not-turn",
            "dead",
            name,
            f"the shaft does not turn at any command (largest: {np.abs(command.value).max():.2f} of full)",
            "check controller, motor and cable, and whether the controller is armed",
        )
        return
    yield from _scale_findings(name, found)
    if found.r2 < 0.5:
        return
    of_steps = list(_step_findings(name, command, shaft))
    yield from of_steps
    early = _moves_in_the_row_of_its_command(command, shaft, found.scale)
    if early is not None:
        yield Finding("warning", "command-one-row-late", "delay", name, early.text, early.advice)
    # The search has a grid, and no standard error
    follows = f"the shaft follows its command after about {found.delay:.2f} s (tried in steps of {SHAFT_GRID_S:g} s)"
    if found.delay_known and found.delay > MAX_DELAY + SHAFT_GRID_S / 2:
        yield Finding(
            "fault",
            "shaft-late",
            "delay",
            name,
            f"{follows}, later than {MAX_DELAY:g} s",
            "check the telemetry rate, the load of the bus, and the ramp of the controller",
        )
    elif found.delay_known and early is None and not any(f.check == "delay" for f in of_steps):
        yield Finding("ok", "shaft-on-time", "delay", name, follows)
    if found.band_gain > 0.2 and found.band > 0.0:
        wide = found.band > MAX_DEAD_BAND + 0.005
        advice = "check the dead band and the start-up power of the controller"
        text = f"commands below {found.band:.2f} of full do not turn the shaft"
        code = "dead-band-wide" if wide else "dead-band-narrow"
        yield Finding("fault" if wide else "ok", code, "dead band", name, text, advice if wide else "")


class EarlyShaft(NamedTuple):
    """Shaft that has moved already in the row of its command, in a log whose rows have command and speed.

    Attributes
    ----------
    share
        Median share of a step of the command by which the shaft has moved in the row of the step, 0 to 1.
    n_steps
        Number of these steps.
    row
        Time between two rows [s].
    """

    share: float
    n_steps: int
    row: float

    @property
    def text(self) -> str:
        """Text of the finding."""
        return (
            f"in the row of a step of its command the shaft has already moved by {100 * self.share:.0f} % of the step "
            f"(median of {self.n_steps} steps): the speed and the command that causes it are probably one row "
            f"({self.row:.3g} s) apart in the log, not simultaneous"
        )

    @property
    def advice(self) -> str:
        """Advice: the key of the import map that shifts the command."""
        return (
            "if the logger stores the command after the speed, or stamps rows with the end of their interval, import "
            f"the command with time_shift = {-self.row:.3g} in its [[signal]] of the import map; otherwise the fitted "
            "delay is too short"
        )


def _moves_in_the_row_of_its_command(command: Channel, shaft: Channel, scale: float) -> EarlyShaft | None:
    """Return the share by which the shaft moves in the row of a step of its command; None if it does not.

    Parameters
    ----------
    command
        Commands over full command. Only steps after five rows with the same command count, and only if they have the
        stamps of shaft speeds, as in a table with one row for both.
    shaft
        Measured shaft speed over full speed.
    scale
        Shaft speed over command when it has settled.

    Notes
    -----
    The movement is that beyond the change of the row before. The rows are at most 0.2 s apart: in a slower table a
    shaft settles between a command and the next row.
    """
    row = float(np.median(np.diff(shaft.t))) if shaft.t.size > QUIET_ROWS + 1 else np.inf
    if row > MAX_ROW_S:
        return None
    last = np.searchsorted(command.t, shaft.t + SAME_STAMP_S, "right") - 1
    u = command.value[np.maximum(last, 0)]
    change = np.append(0.0, np.diff(u))
    steps = np.flatnonzero(np.abs(change) > MIN_STEP)
    steps = steps[(steps > QUIET_ROWS) & (last[steps - QUIET_ROWS] >= 0)]
    steps = steps[[not change[k - QUIET_ROWS + 1 : k].any() for k in steps]]
    stamped = np.abs(command.t[last[steps]] - shaft.t[steps]) < SAME_STAMP_S
    even = (shaft.t[steps] - shaft.t[steps - 2]) < 3.0 * row
    if np.count_nonzero(stamped) < 0.9 * steps.size or np.count_nonzero(k := stamped & even) < FEWEST_STEPS:
        return None
    at = steps[k]
    n = shaft.value
    shares = (n[at] - 2.0 * n[at - 1] + n[at - 2]) / (scale * change[at])
    share = float(np.median(shares))
    spread = 1.4826 * float(np.median(np.abs(shares - share)))
    if not LEAST_SHARE < share < LARGEST_SHARE or spread > LARGEST_SPREAD * share:
        return None
    return EarlyShaft(share, at.size, row)


def _scale_findings(name: str, found: Response) -> Iterator[Finding]:
    """Yield at most one finding: the shaft hardly follows its command, or follows it in another unit or direction.

    The factor is shaft speed over command. Its size is its absolute value. The first finding that applies is yielded:

    - ``shaft-does-not-follow`` (warning): R2 is below 0.5.
    - ``shaft-speed-in-rad-per-s`` (fault): the size is pi / 30 (rad/s per rev/min) or its inverse, within 10 %.
    - ``shaft-speed-scale`` (fault): the size is outside 0.4 to 2.5.
    - ``shaft-sign-reversed`` (fault): the factor is negative.
    """
    size = abs(found.scale)
    if found.r2 < 0.5:
        yield Finding(
            "warning",
            "shaft-does-not-follow",
            "shaft",
            name,
            f"the shaft hardly follows its command (R2 {found.r2:.2f})",
            "plot both; look for missing samples, a speed limit, or a controller that ignores commands",
        )
    elif abs(size / RAD_PER_S - 1.0) < 0.1 or abs(size * RAD_PER_S - 1.0) < 0.1:
        yield Finding(
            "fault",
            "shaft-speed-in-rad-per-s",
            "units",
            name,
            f"the shaft speed is {size:.3g} times the command: is it in rad/s, not in rev/min?",
            "correct rpm_max in the rig file, or the unit of the shaft speed in the import map",
        )
    elif not 0.4 < size < 2.5:
        yield Finding(
            "fault",
            "shaft-speed-scale",
            "units",
            name,
            f"the shaft speed is {size:.3g} times the command, but both are fractions of full speed",
            "correct pole_pairs and rpm_max in the rig file, or the scale in the import map",
        )
    elif found.scale < 0.0:
        yield Finding(
            "fault",
            "shaft-sign-reversed",
            "sign",
            name,
            "the shaft turns in reverse at forward commands",
            "correct `reversed` in the rig file, or the direction set in the controller",
        )


_responses = RecentResults[Response | NoResponse]()


def response(commands: Channel, shaft: Channel) -> Response | NoResponse:
    """Return the response of a shaft to its commands.

    The response to the same arrays is estimated only once, because two checks of a log need it.

    Parameters
    ----------
    commands
        Commands over full command, each held until the next one.
    shaft
        Measured shaft speed over full speed.

    Returns
    -------
    Response or NoResponse
        The response with the least squared error, or the reason for which it is unknown.
    """
    arrays = commands.t, commands.value, shaft.t, shaft.value
    return _responses.get(arrays, lambda: _estimated_response(commands, shaft))


def _estimated_response(commands: Channel, shaft: Channel) -> Response | NoResponse:
    """Estimate the response of a shaft to its commands by a search over delay, time constant and dead band.

    Arguments and result are those of `response`.

    Notes
    -----
    Times without telemetry are left out, and the last command counts for 5 s. Of a log longer than 30 min only the 30
    min from the first command on are searched; R2 and scale are those of the whole log.
    """
    longest = len(DELAYS) - 1
    grid = np.arange(max(commands.t[0], shaft.t[0]), min(commands.t[-1] + 5.0, shaft.t[-1]), SHAFT_GRID_S)
    t = grid[longest:]
    if grid.size == 0:
        return NoResponse.TOO_SHORT
    command, turned = sample_and_hold(commands, grid), np.interp(grid, shaft.t, shaft.value)
    commanded = np.abs(command) > MIN_COMMAND
    answering = commanded.copy()  # extended below by the longest delay: a late shaft may still turn
    for k in range(1, min(longest, grid.size - 1) + 1):
        answering[k:] |= commanded[:-k]

    def quiet(speed: Array) -> bool:
        """Return whether the shaft stands still: 99 % of its speeds are below 0.02 of the largest command.

        A largest command above 1 counts as 1.
        """
        return bool(np.quantile(np.abs(speed), 0.99) < MIN_SPEED * min(1.0, np.abs(commands.value).max()))

    # A dead shaft needs no fit, so the first seconds count too. The second part finds a shaft that dies after them.
    for part in (slice(None), slice(longest, None)):
        if SHAFT_GRID_S * np.count_nonzero(commanded[part]) >= MIN_COMMANDED_S and quiet(turned[part][answering[part]]):
            return NoResponse.STILL
    if t.size < MIN_SAMPLES or quiet(turned[longest:]):
        return NoResponse.TOO_SHORT
    at = np.searchsorted(shaft.t, t)
    after, before = shaft.t[np.clip(at, 0, shaft.t.size - 1)] - t, t - shaft.t[np.clip(at - 1, 0, None)]
    near = np.minimum(np.abs(after), np.abs(before))
    used = near < max(0.5, 2.0 * float(np.median(np.diff(shaft.t))))  # times near a sample: no gap of the telemetry
    n = turned[longest:] if used.all() else np.where(used, turned[longest:], 0.0)

    def delayed(lagged: Array, delay: float, seen: NDArray[np.bool_]) -> Array:
        """Return the lagged command after a delay [s], at the times of ``seen``.

        The result is zero at times without telemetry (``seen`` false).
        """
        late = longest - round(delay / SHAFT_GRID_S)
        x = lagged[late : late + seen.size]
        return x if seen.all() else np.where(seen, x, 0.0)

    begin = max(int(np.argmax(commanded)) - longest, 0) if n.size > MAX_SEARCH_SAMPLES else 0
    part = slice(begin, begin + MAX_SEARCH_SAMPLES)
    command_part, n_part, used_part = command[begin : begin + MAX_SEARCH_SAMPLES + longest], n[part], used[part]
    total_part = float(n_part @ n_part)

    def fitted(at: slice, band: float) -> LagFit:
        """Return the best time constant and delay of the shaft, for a dead band and the part ``at`` of `DELAYS`."""

        def misfit(lagged: Array, delay: float) -> float:
            """Return the squared error of the delayed command, times its best factor, against the shaft speed."""
            return _scaled_misfit(delayed(lagged, delay, used_part), n_part, total_part)[0]

        data = LagData(_zero_in_dead_band(command_part, band), misfit)
        return fit_first_order_lag([data], DELAYS[at], TIME_CONSTANTS, SHAFT_GRID_S, hold="backward", start="steady")

    linear = fitted(slice(None), 0.0)
    k = DELAYS.index(linear.delay)
    best, band = linear, 0.0
    sizes = np.unique(np.abs(command_part[command_part != 0.0]))
    n_zeroed = np.searchsorted(sizes, DEAD_BANDS)  # A band that sets no further command to zero changes nothing.
    for b in DEAD_BANDS[np.diff(n_zeroed, prepend=0) > 0].tolist():
        if (with_band := fitted(slice(max(k - 3, 0), k + 4), b)).misfit < best.misfit:
            best, band = with_band, b
    lagged = first_order_lag(
        _zero_in_dead_band(command, band), best.time_constant, SHAFT_GRID_S, hold="backward", start="steady"
    )
    gain = 1.0 - best.misfit / max(linear.misfit, 1e-300)
    total = float(n @ n)
    misfit, scale = _scaled_misfit(delayed(lagged, best.delay, used), n, total)
    # A constant command shows no delay. The same holds if all its steps lie before the first time of the fit.
    limit = round(MAX_DELAY / SHAFT_GRID_S) + 1
    alternative = fitted(slice(0, limit) if DELAYS.index(best.delay) >= limit else slice(limit, None), band)
    clear = best.misfit * max(CLEARLY, CLEARLY_VARIANCES / n_part.size)
    known = bool(np.ptp(command[longest:]) > MIN_STEP) and alternative.misfit - best.misfit > clear
    return Response(best.delay, best.time_constant, band, scale, 1.0 - misfit / total, gain, known)


def _zero_in_dead_band(command: Array, band: float) -> Array:
    """Return the commands (n,), with zero for each command whose absolute value is below ``band`` (dead band)."""
    return np.where(np.abs(command) < band, 0.0, command)


def _scaled_misfit(x: Array, n: Array, total: float) -> tuple[float, float]:
    """Fit the shaft speed n (n,) by a multiple of the lagged command x (n,).

    Return the squared error and the least-squares factor of x. ``total`` is the sum of squares of n. If x is zero, they
    are ``total`` and 0.
    """
    square, product = float(x @ x), float(x @ n)
    if square == 0.0:
        return total, 0.0
    return max(total - product * product / square, 0.0), product / square


class HeldCommand(NamedTuple):
    """Time in which a command was held, with the shaft speed in this time.

    Attributes
    ----------
    t
        Start [s].
    level
        Value of the held command, -1 to 1.
    settled
        Median of the shaft speed in the second half, over full speed.
    times
        Times (n,) [s] of the samples of the shaft speed.
    values
        Shaft speeds (n,) over full speed.
    """

    t: float
    level: float
    settled: float
    times: Array
    values: Array


def held_commands(command: Channel, shaft: Channel) -> list[HeldCommand]:
    """Return the times of at least 4 s in which the command did not change, in order.

    Times with fewer than two samples of the shaft speed in their second half are left out. The last command is held
    until the last sample of command or shaft speed.

    Parameters
    ----------
    command
        Commands over full command, each held until the next one.
    shaft
        Measured shaft speed over full speed.
    """
    found = []
    for held in steady_segments(command.t, command.value, max(command.t[-1], shaft.t[-1])):
        if held.duration >= MIN_HOLD_S:
            first, last = np.searchsorted(shaft.t, [held.start, held.end]).tolist()
            late = slice(max(first, int(np.searchsorted(shaft.t, (held.start + held.end) / 2, "right"))), last)
            if late.stop - late.start >= 2:
                settled = float(np.median(shaft.value[late]))
                found.append(HeldCommand(held.start, held.level, settled, shaft.t[first:last], shaft.value[first:last]))
    return found


def _step_findings(name: str, command: Channel, shaft: Channel) -> Iterator[Finding]:
    """Yield findings of single steps that a fit to the whole log does not show: slow telemetry, a limit, drop-outs.

    ``shaft-step-late`` (fault): at least three steps between commands held for 4 s, with a median above 1 s until half
    of the step. ``shaft-speed-limited`` and ``shaft-speed-drops-out`` are warnings. ``name``: the thruster, for the
    findings.
    """
    held = held_commands(command, shaft)
    half = []
    for before, now in pairwise(held):
        change = now.settled - before.settled
        if abs(change) > MIN_STEP:
            done = np.flatnonzero((now.values - before.settled) / change > 0.5)
            half += [float(now.times[done[0]]) - now.t] if done.size else []
    if len(half) >= 3 and np.median(half) > MAX_RISE_TIME_S:
        text = (
            f"the shaft speed reaches half of a step only {np.median(half):.1f} s after the command (median of "
            f"{len(half)} steps)"
        )
        yield Finding(
            "fault",
            "shaft-step-late",
            "delay",
            name,
            text,
            "raise the telemetry rate, and remove the ramp of the controller: they hide the lag of the shaft",
        )
    yield from _saturation_findings(name, held)
    n_drop_outs = sum(_count_drop_outs(h) for h in held if abs(h.settled) > 0.5 * abs(h.level) > 0.05)
    if n_drop_outs:
        yield Finding(
            "warning",
            "shaft-speed-drops-out",
            "drop-out",
            name,
            f"the shaft speed falls to zero {'once' if n_drop_outs == 1 else f'{n_drop_outs} times'} "
            "while the command is not zero",
            "check the speed sensor and the power of the thruster; fit with --robust",
        )


def _count_drop_outs(held: HeldCommand) -> int:
    """Count how often the shaft speed falls to zero during one held command.

    The count starts when the speed has reached 80 % of its settled value. The result is 0 if the speed never reaches
    this value.

    Zero crossings of a reversal do not count: the shaft turns the other way before or after them. ``held.settled`` must
    not be zero.
    """
    speed = held.values / held.settled
    near = np.flatnonzero(speed > 0.8)
    speed = speed[near[0] :] if near.size else speed[:0]
    zero = np.abs(speed * held.settled) < 0.01 * abs(held.level)
    begins = np.flatnonzero(zero[1:] & ~zero[:-1]) + 1
    ends = [b + int(np.argmin(zero[b:])) if not zero[b:].all() else speed.size - 1 for b in begins.tolist()]
    return sum(speed[b - 1] > REVERSE and speed[e] > REVERSE for b, e in zip(begins.tolist(), ends, strict=True))


def _saturation_findings(name: str, held: list[HeldCommand]) -> Iterator[Finding]:
    """Yield a warning if the shaft settles at the same speed for all commands above some size (saturation).

    At least two held commands of different size must fall short of their speed (0.3 to 0.97 of it), all at the same
    speed within 2 %. At least one command must be followed within 3 %, and none of these beyond that speed.
    """
    followed = [abs(h.settled) for h in held if abs(h.level) > MIN_COMMAND and abs(h.settled / h.level - 1.0) < 0.03]
    short = [h for h in held if abs(h.level) > MIN_COMMAND and 0.3 < h.settled / h.level < 0.97]
    if not followed or len(short) < 2 or len({abs(h.level) for h in short}) < 2:
        return
    top = float(np.median([abs(h.settled) for h in short]))
    if max(abs(abs(h.settled) / top - 1.0) for h in short) < 0.02 and max(followed) <= 1.02 * top:
        yield Finding(
            "warning",
            "shaft-speed-limited",
            "limit",
            name,
            f"commands above {top:.2f} of full do not turn the shaft faster",
            "set n_max under [limits] in the rig file to this value, or raise the speed limit of the controller",
        )
