"""Shaft speeds that are right in one direction only: the other one is zero, wrapped to 65536 - n, or without a sign."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks import FAULT, Finding
from seatrial.ident.checks.sensors import Channels
from seatrial.ident.data import Channel, sample_and_hold
from seatrial.ident.numerics import Array

SETTLED_S = 1.5  # s for which a command has had one sign and size before a shaft is compared with it
FASTEST_TURN, CLEAR_TURN = 5.0, 0.02  # rad/s: the largest yaw rate, and one that differs from rest
CLEAR = 0.12  # of full command, from which a shaft turns
FEWEST = 10  # samples of each direction
FASTEST, NEAR_TOP, BETWEEN = 1.5, 0.7, 0.1  # of full speed; of the largest value; part of the samples
TURNS, STANDS, WRAPS = 0.3, 0.05, 3.0  # speed over command: turns, stands still, is beyond any shaft


def one_sided_shafts(c: Channels) -> dict[str, Finding]:
    """Compare each shaft speed with its command by sign, and return a finding for each thruster that is one-sided."""
    names = sorted(n.removeprefix("n_cmd_") for n in c if n.startswith("n_cmd_"))
    both = ((n, c[f"n_cmd_{n}"], c[f"n_{n}"]) for n in names if f"n_{n}" in c)
    found = ((n, _one_sided(n, command, shaft)) for n, command, shaft in both if command.t is not shaft.t)
    return {n: finding for n, finding in found if finding is not None}


def wrapped(value: Array, fastest: float = FASTEST, clear: float = CLEAR) -> bool:
    """Return whether a shaft speed, or another rate, (n,) has its negative values as 65536 - n, with any sign.

    ``fastest``: the largest size that it can have; ``clear``: from which size it differs from rest.

    Its sizes are either those of a shaft or some near one far larger value, and few lie between, of a shaft that was
    sampled on its way.
    """
    size = np.abs(value)
    top = float(size.max(initial=0.0))
    high, low = size > NEAR_TOP * top, size <= fastest
    if top < 2.0 * fastest or np.count_nonzero(high) < FEWEST or np.count_nonzero(low & (size > clear)) < FEWEST:
        return False
    return bool(np.mean(~(high | low)) < BETWEEN)


def check_wrapped(c: Channels) -> Iterator[Finding]:
    """Shaft speeds and yaw rates that wrap where they are negative."""
    if "r" in c and wrapped(c["r"].value, FASTEST_TURN, CLEAR_TURN):
        text = f"goes to {np.abs(c['r'].value).max():.4g} rad/s: negative rates are wrapped to 65536 - n"
        yield Finding(FAULT, "gyro-wrapped", "sign", "r", text, "read it as a signed number of 16 bits")
    for name in sorted(n for n in c if n.startswith("n_") and not n.startswith("n_cmd_")):
        value = c[name].value
        if wrapped(value):
            text = f"goes to {np.abs(value).max():.4g} of full speed: negative speeds are wrapped to 65536 - n"
            advice = "its telemetry sends an unsigned number: mend its firmware, or fit by the command"
            yield Finding(FAULT, "shaft-speed-wrapped", "sign", name, text, advice)


def _one_sided(name: str, command: Channel, shaft: Channel) -> Finding | None:
    ahead, astern = (_ratio(command, shaft, sign) for sign in (1.0, -1.0))
    if ahead is None or astern is None:
        return None
    text = ""
    if ahead > TURNS and abs(astern) < STANDS:
        text = f"told astern, its speed reads zero; ahead it is {ahead:.2f} of its command"
    elif astern > TURNS and abs(ahead) < STANDS:
        text = f"told ahead, its speed reads zero; astern it is {astern:.2f} of its command"
    elif TURNS < ahead < WRAPS and -WRAPS < astern < -TURNS:
        text = "its speed is positive in both directions, and has lost its sign"
    if not text:
        return None
    advice = "its telemetry has no negative speeds, or it has no reverse: watch the shaft; else fit by the command"
    return Finding(FAULT, "shaft-speed-one-sided", "sign", name, text, advice)


def _ratio(command: Channel, shaft: Channel, sign: float) -> float | None:
    """Return the median of speed over command where the command has had this sign for a while; None for few samples."""
    at = [sample_and_hold(command, shaft.t - late) * sign for late in np.linspace(0.0, SETTLED_S, 7)]
    steady: NDArray[np.bool_] = np.min(at, axis=0) > CLEAR
    steady &= np.ptp(at, axis=0) < 0.1
    if np.count_nonzero(steady) < FEWEST:
        return None
    return float(np.median(shaft.value[steady] / (sign * at[0][steady])))
