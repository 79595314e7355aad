"""Which way a shaft turned whose controller said only how fast, as an autopilot's ESC telemetry does.

A shaft follows its command late. For some tenths of a second after each reversal it still turns the old way, so that
the sign of the command is wrong by twice the speed just then; masses that are fitted to such a signal come out several
times too large. Here a delay and a lag are sought that make the command's magnitude that of the shaft, and what they
make of the command has the sign.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]
STEP = 0.02  # s
DELAYS = np.arange(0.0, 1.01, 0.05)  # s
POLES = 1.5 * 1.5 ** np.arange(9)  # 1/s, up to 38


def follows_command(rpm: Array, n: Array) -> bool:
    """Whether a shaft's speeds (k,) have at each moment the sign of the command ``n`` (k,): no shaft is so quick."""
    both = (rpm != 0) & (n != 0) & np.isfinite(rpm) & np.isfinite(n)
    signs = np.sign(n[both])
    return bool(np.any(np.diff(signs)) and np.all(np.sign(rpm[both]) == signs))


def with_sign(t: Array, speed: Array, t_told: Array, told: Array) -> Array:
    """Speeds (k,) at times ``t`` (k,) s with the sign that their shaft had, told ``told`` (m,) from ``t_told`` (m,) s
    on, each held until the next."""
    speed = np.abs(speed)
    clock = np.arange(t[0] - DELAYS[-1], t[-1] + STEP, STEP)
    held = told[np.maximum(np.searchsorted(t_told, clock, side="right") - 1, 0)]
    best, found = np.inf, np.copysign(speed, np.interp(t, clock, held))
    for pole in POLES:
        keep = np.exp(-pole * STEP)
        lagged = lfilter([1.0 - keep], [1.0, -keep], held)
        for delay in DELAYS:
            shaft = np.interp(t - delay, clock, lagged)
            size = np.abs(shaft)
            scale = float(size @ speed / max(size @ size, 1e-12))
            error = float(np.sum((speed - scale * size) ** 2))
            if error < best:
                best, found = error, np.copysign(speed, shaft)
    return np.asarray(found)
