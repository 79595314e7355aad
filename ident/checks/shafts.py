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
from seatrial.ident.checks.sensors import Channels
from seatrial.ident.data import Channel, sample_and_hold
from seatrial.ident.numerics import Array, LagData, LagFit, first_order_lag, fit_first_order_lag, steady_segments

STEP = 0.05  # s, of the common grid of command and shaft, and of delays
DELAYS = tuple(np.arange(0.0, 3.0 + STEP / 2, STEP).tolist())  # s, that are tried
TIME_CONSTANTS = (0.0, 0.07, 0.14, 0.3, 0.6, 1.2)  # s, that are tried
DEAD_BANDS = np.array([0.0, *np.arange(0.02, 0.41, 0.01)])  # of full command, that are tried
MAX_DELAY, MAX_DEAD_BAND = 0.6, 0.15  # s; of full command: what is still usual for an ESC
MIN_COMMAND, MIN_SPEED = 0.1, 0.02  # of full command, of full speed: from which a shaft should turn, and turns
MIN_HOLD, MIN_STEP = 4.0, 0.05  # s; of full command: from which the end of a step is known, and its size
ASTERN = -0.05  # of the speed at which a shaft settles: beyond it turns the other way, and does not stand
MIN_TOLD = 1.0  # s of command, after which a shaft that has not moved is dead
FEWEST = 40  # samples of the common grid
SEARCHED = 36_000  # samples of it, from the first command on, in which delay, lag and dead band are searched
# What explains a response clearly worse: a misfit larger by this part, and by so many variances of a sample.
CLEARLY, CLEARLY_VARIANCES = 0.1, 30.0
MAX_RISE_TIME = 1.0  # s until half of a step shows
RAD_PER_S = 2.0 * np.pi / 60.0  # of one revolution a minute


class Response(NamedTuple):
    """How a shaft follows its command: n = scale lag(n_cmd(t - delay) outside the dead band); R2 of it."""

    delay: float
    time_constant: float
    band: float
    scale: float
    r2: float
    band_gain: float  # part of the error without a dead band that the dead band explains
    delay_known: bool  # no delay on the other side of MAX_DELAY explains it nearly as well


class NoResponse(Enum):
    """Why it is not known how a shaft follows its command."""

    TOO_SHORT = "too short"
    STILL = "does not turn"


def check_shafts(c: Channels) -> Iterator[Finding]:
    """Each thruster that has a command and a speed: is it alive, and how does it follow?"""
    for name in sorted(n.removeprefix("n_cmd_") for n in c if n.startswith("n_cmd_")):
        if f"n_{name}" in c and c[f"n_{name}"].t is not c[f"n_cmd_{name}"].t:
            yield from _shaft(name, c[f"n_cmd_{name}"], c[f"n_{name}"])


def _shaft(name: str, told: Channel, shaft: Channel) -> Iterator[Finding]:
    silent = shaft.t[-1] + 3.0
    commanded = (np.abs(told.value) > MIN_COMMAND) & (told.t > silent)
    if commanded.any() or np.max(np.abs(told.value), initial=0.0) < MIN_COMMAND:
        if commanded.any():
            since = shaft.t[-1] - min(told.t[0], shaft.t[0])
            yield Finding(
                "fault",
                "controller-fell-silent",
                "dead",
                name,
                f"commanded, and its controller has said nothing since {since:.0f} s",
                "power, bus and fuse of that controller",
            )
        return
    found = response(told, shaft)
    if found is NoResponse.TOO_SHORT:
        yield Finding(
            "warning",
            "shaft-too-short",
            "shaft",
            name,
            "command and shaft speed overlap for too short a time to tell how the shaft follows",
            f"both for {DELAYS[-1] + 2.0 * FEWEST * STEP:.0f} s or more",
        )
        return
    if found is NoResponse.STILL:
        yield Finding(
            "fault",
            "shaft-does-not-turn",
            "dead",
            name,
            f"told up to {np.abs(told.value).max():.2f}, and the shaft does not turn",
            "controller, motor, cable; is it armed?",
        )
        return
    yield from _scale(name, found)
    if found.r2 < 0.5:
        return
    of_steps = list(_steps(name, told, shaft))
    yield from of_steps
    if found.delay_known and found.delay > MAX_DELAY + STEP / 2:
        yield Finding(
            "fault",
            "shaft-late",
            "delay",
            name,
            f"the shaft follows {found.delay:.2f} s after its command",
            "the link's rate and queues; the controller's ramp",
        )
    elif found.delay_known and not any(f.check == "delay" for f in of_steps):
        yield Finding("ok", "shaft-on-time", "delay", name, f"the shaft follows {found.delay:.2f} s after its command")
    if found.band_gain > 0.2 and found.band > 0.0:
        wide = found.band > MAX_DEAD_BAND + 0.005
        advice = "the controller's dead band or start-up power; small commands do nothing" if wide else ""
        text = f"commands below {found.band:.2f} do not turn the shaft"
        code = "dead-band-wide" if wide else "dead-band-narrow"
        yield Finding("fault" if wide else "ok", code, "dead band", name, text, advice)


def _scale(name: str, found: Response) -> Iterator[Finding]:
    size = abs(found.scale)
    if found.r2 < 0.5:
        yield Finding(
            "warning",
            "shaft-does-not-follow",
            "shaft",
            name,
            f"the shaft follows its command only to R2 {found.r2:.2f}",
            "drop-outs of either, a limit, or a controller that does not obey",
        )
    elif abs(size / RAD_PER_S - 1.0) < 0.1 or abs(size * RAD_PER_S - 1.0) < 0.1:
        yield Finding(
            "fault",
            "shaft-speed-in-rad-per-s",
            "units",
            name,
            f"speed is {size:.3g} of the command: rad/s for rev/min?",
            "rpm_max of the rig or the unit in the import's map",
        )
    elif not 0.4 < size < 2.5:
        yield Finding(
            "fault",
            "shaft-speed-scale",
            "units",
            name,
            f"speed is {size:.3g} of the command",
            "pole_pairs and rpm_max of the rig",
        )
    elif found.scale < 0.0:
        yield Finding(
            "fault",
            "shaft-sign-reversed",
            "sign",
            name,
            "the shaft turns against its command",
            "`reversed` of the rig or the controller's direction",
        )


def response(told: Channel, shaft: Channel) -> Response | NoResponse:
    """The shaft's answer by a search over delay, time constant and dead band."""
    longest = len(DELAYS) - 1
    grid = np.arange(max(told.t[0], shaft.t[0]), min(told.t[-1] + 5.0, shaft.t[-1]), STEP)
    t = grid[longest:]
    if grid.size == 0:
        return NoResponse.TOO_SHORT
    command, turned = sample_and_hold(told, grid), np.interp(grid, shaft.t, shaft.value)
    commanded = np.abs(command) > MIN_COMMAND
    answering = commanded.copy()  # and for as long as a late shaft may still turn
    for k in range(1, min(longest, grid.size - 1) + 1):
        answering[k:] |= commanded[:-k]

    def quiet(speed: Array) -> bool:
        return bool(np.quantile(np.abs(speed), 0.99) < MIN_SPEED * min(1.0, np.abs(told.value).max()))

    # A dead shaft needs no fit, so the first seconds count too; a shaft may also die after them.
    for part in (slice(None), slice(longest, None)):
        if STEP * np.count_nonzero(commanded[part]) >= MIN_TOLD and quiet(turned[part][answering[part]]):
            return NoResponse.STILL
    if t.size < FEWEST or quiet(turned[longest:]):
        return NoResponse.TOO_SHORT
    at = np.searchsorted(shaft.t, t)
    after, before = shaft.t[np.clip(at, 0, shaft.t.size - 1)] - t, t - shaft.t[np.clip(at - 1, 0, None)]
    near = np.minimum(np.abs(after), np.abs(before))
    used = near < max(0.5, 2.0 * float(np.median(np.diff(shaft.t))))
    n = turned[longest:] if used.all() else np.where(used, turned[longest:], 0.0)

    def delayed(lagged: Array, delay: float, seen: NDArray[np.bool_]) -> Array:
        late = longest - round(delay / STEP)
        x = lagged[late : late + seen.size]
        return x if seen.all() else np.where(seen, x, 0.0)

    begin = max(int(np.argmax(commanded)) - longest, 0) if n.size > SEARCHED else 0
    part = slice(begin, begin + SEARCHED)
    told_part, n_part, used_part = command[begin : begin + SEARCHED + longest], n[part], used[part]
    total_part = float(n_part @ n_part)

    def fitted(at: slice, band: float) -> LagFit:
        def misfit(lagged: Array, delay: float) -> float:
            return _misfit(delayed(lagged, delay, used_part), n_part, total_part)[0]

        data = LagData(_outside(told_part, band), misfit)
        return fit_first_order_lag([data], DELAYS[at], TIME_CONSTANTS, STEP, hold="backward", start="steady")

    linear = fitted(slice(None), 0.0)
    k = DELAYS.index(linear.delay)
    best, band = linear, 0.0
    for b in DEAD_BANDS.tolist():
        if (one := fitted(slice(max(k - 3, 0), k + 4), b)).misfit < best.misfit:
            best, band = one, b
    lagged = first_order_lag(_outside(command, band), best.time_constant, STEP, hold="backward", start="steady")
    gain = 1.0 - best.misfit / max(linear.misfit, 1e-300)
    total = float(n @ n)
    misfit, scale = _misfit(delayed(lagged, best.delay, used), n, total)
    # A command that stays the same shows no delay, nor does one whose steps all lie before the first time of the fit.
    limit = round(MAX_DELAY / STEP) + 1
    other = fitted(slice(0, limit) if DELAYS.index(best.delay) >= limit else slice(limit, None), band)
    clear = best.misfit * max(CLEARLY, CLEARLY_VARIANCES / n_part.size)
    known = bool(np.ptp(command[longest:]) > MIN_STEP) and other.misfit - best.misfit > clear
    return Response(best.delay, best.time_constant, band, scale, 1.0 - misfit / total, gain, known)


def _outside(command: Array, band: float) -> Array:
    """Commands (...) with those inside a dead band as zero."""
    return np.where(np.abs(command) < band, 0.0, command)


def _misfit(x: Array, n: Array, total: float) -> tuple[float, float]:
    """Squared error of n, whose own square is ``total``, by a multiple of x, and that multiple."""
    size, both = float(x @ x), float(x @ n)
    if size == 0.0:
        return total, 0.0
    return max(total - both * both / size, 0.0), both / size


class Hold(NamedTuple):
    """A command that was held: from when, what, the shaft's median at its end, and the shaft's samples meanwhile."""

    t: float
    level: float
    settled: float
    times: Array
    values: Array


def holds(told: Channel, shaft: Channel) -> list[Hold]:
    """The commands that were held for some seconds, with what the shaft made of them."""
    found = []
    for held in steady_segments(told.t, told.value, max(told.t[-1], shaft.t[-1])):
        if held.duration >= MIN_HOLD:
            first, last = np.searchsorted(shaft.t, [held.start, held.end]).tolist()
            late = slice(max(first, int(np.searchsorted(shaft.t, (held.start + held.end) / 2, "right"))), last)
            if late.stop - late.start >= 2:
                settled = float(np.median(shaft.value[late]))
                found.append(Hold(held.start, held.level, settled, shaft.t[first:last], shaft.value[first:last]))
    return found


def _steps(name: str, told: Channel, shaft: Channel) -> Iterator[Finding]:
    """What single steps show and a fit over everything does not: slow telemetry, a limit, drop-outs."""
    there = holds(told, shaft)
    half = []
    for before, now in pairwise(there):
        change = now.settled - before.settled
        if abs(change) > MIN_STEP:
            done = np.flatnonzero((now.values - before.settled) / change > 0.5)
            half += [float(now.times[done[0]]) - now.t] if done.size else []
    if len(half) >= 3 and np.median(half) > MAX_RISE_TIME:
        text = f"half of a step shows {np.median(half):.1f} s after its command (median of {len(half)})"
        yield Finding(
            "fault",
            "shaft-step-late",
            "delay",
            name,
            text,
            "slow telemetry or a ramp: a shorter lag cannot be known from this log",
        )
    yield from _limit(name, there)
    gone = sum(_drop_outs(h) for h in there if abs(h.settled) > 0.5 * abs(h.level) > 0.05)
    if gone:
        yield Finding(
            "warning",
            "shaft-speed-drops-out",
            "drop-out",
            name,
            f"its speed falls to nothing {'once' if gone == 1 else f'{gone} times'} while it is told to turn",
            "its sensor or its power; fit with --robust",
        )


def _drop_outs(held: Hold) -> int:
    """How often the shaft's speed falls to nothing after it has come near to where it settles, and not on its way to
    the other side of nothing, where the command before sent it."""
    speed = held.values / held.settled
    near = np.flatnonzero(speed > 0.8)
    speed = speed[near[0] :] if near.size else speed[:0]
    gone = np.abs(speed * held.settled) < 0.01 * abs(held.level)
    begins = np.flatnonzero(gone[1:] & ~gone[:-1]) + 1
    ends = [b + int(np.argmin(gone[b:])) if not gone[b:].all() else speed.size - 1 for b in begins.tolist()]
    return sum(speed[b - 1] > ASTERN and speed[e] > ASTERN for b, e in zip(begins.tolist(), ends, strict=True))


def _limit(name: str, there: list[Hold]) -> Iterator[Finding]:
    """Commands beyond some size that change nothing: at the top of the range what a dead band is at its bottom."""
    followed = [abs(h.settled) for h in there if abs(h.level) > MIN_COMMAND and abs(h.settled / h.level - 1.0) < 0.03]
    short = [h for h in there if abs(h.level) > MIN_COMMAND and 0.3 < h.settled / h.level < 0.97]
    if not followed or len(short) < 2 or len({abs(h.level) for h in short}) < 2:
        return
    top = float(np.median([abs(h.settled) for h in short]))
    if max(abs(abs(h.settled) / top - 1.0) for h in short) < 0.02 and max(followed) <= 1.02 * top:
        yield Finding(
            "warning",
            "shaft-speed-limited",
            "limit",
            name,
            f"commands beyond {top:.2f} do not turn it faster",
            "limits.n_max of the rig, or the controller's own limit",
        )
