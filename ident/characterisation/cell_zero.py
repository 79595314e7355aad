"""Drift of a load cell's zero between the rests of a bench run.

The force at each rest, where the command is zero and the first seconds are left out, is the zero of the cell there. If
the zeros differ by more than their errors, the cell has drifted: warmth, creep, or a mount that moves. The drift is
taken off as straight lines between the middles of the rests, and is constant before the first and after the last one.
The mean zero stays in the force, for the fit that estimates it.

The correction assumes that a thruster gives no force at rest. Water that is still moving does, so a rest needs a few
seconds, and small differences are no drift.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from seatrial.daq.errors import counted
from seatrial.ident.data import Channel
from seatrial.ident.numerics import Array, mean_error, steady_segments

REST = 1e-3  # of full command, below which a thruster is at rest
FEWEST_READINGS, SHORTEST_REST_S = 10, 1.0  # of a rest behind the time that it needs to settle
BEYOND_ERRORS = 4.0  # standard errors of a difference between two zeros
LEAST_PART = 0.02  # of the range of the force, below which a difference is no drift: water that moves


class ZeroDrift(NamedTuple):
    """Zeros of a load cell at its rests: the times t (n_rests,) [s], and the force there (n_rests,) [N]."""

    t: Array
    force: Array

    @property
    def text(self) -> str:
        """The drift in words."""
        first, last = float(self.force[0]), float(self.force[-1])
        return (
            f"The load cell's zero drifts: {first:.3g} N at {self.t[0]:.0f} s, {last:.3g} N at {self.t[-1]:.0f} s, in "
            f"all {np.ptp(self.force):.3g} N in {counted(self.t.size, 'rest')}. The drift is taken off, linear between "
            "the rests."
        )

    def taken_off(self, force: Channel) -> Channel:
        """The force without the drift, and with the mean of the zeros."""
        drift = np.interp(force.t, self.t, self.force - self.force.mean())
        return replace(force, value=force.value - drift)


def zero_drift(command: Channel, force: Channel, settle: float) -> ZeroDrift | None:
    """Find the drift of a load cell's zero.

    Parameters
    ----------
    command, force
        Channels of a bench run; the force in N.
    settle
        Time at the beginning of each rest that is left out [s].

    Returns
    -------
    ZeroDrift or None
        None if there are fewer than two rests, or if their zeros differ by no more than errors and moving water.
    """
    rests = []
    for steady in steady_segments(command.t, command.value, float(force.t[-1])):
        inside = (force.t >= steady.start + settle) & (force.t < steady.end) & np.isfinite(force.value)
        enough = np.count_nonzero(inside) >= FEWEST_READINGS and np.ptp(force.t[inside]) >= SHORTEST_REST_S
        if abs(steady.level) < REST and enough:
            value = force.value[inside]
            rests.append((float(force.t[inside].mean()), float(value.mean()), mean_error(value)[0]))
    if len(rests) < 2:
        return None
    t, zero, se = np.array(rests).T
    low, high = int(np.argmin(zero)), int(np.argmax(zero))
    size = float(zero[high] - zero[low])
    span = float(np.ptp(np.quantile(force.value[np.isfinite(force.value)], [0.01, 0.99])))
    if size < max(BEYOND_ERRORS * float(np.hypot(se[low], se[high])), LEAST_PART * span):
        return None
    return ZeroDrift(t, zero)
