"""Drift of a load cell's zero between the rests of a bench run.

A rest is an interval of time in which the command of the thruster is zero. The mean force at a rest, without its first
seconds, is the zero of the load cell at that time. If the zeros differ by more than their errors, the cell has drifted,
for example by temperature, creep, or a mount that moves. The drift is removed as straight lines between the middles of
the rests. It is constant before the first and after the last rest. The mean of the zeros stays in the force, for the
fit that estimates it.

The correction assumes that a thruster gives no force at rest. Water that is still moving gives a force. So a rest needs
a few seconds, and small differences are not treated as drift.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from seatrial.daq.errors import counted
from seatrial.ident.data import Channel
from seatrial.ident.numerics import Array, mean_error, steady_segments

REST = 1e-3  # of full command; a thruster with a smaller command is at rest
FEWEST_READINGS, SHORTEST_REST_S = 10, 1.0  # samples and s of a rest, after the time to settle
BEYOND_ERRORS = 4.0  # a difference of two zeros below so many of its standard errors may be chance
LEAST_PART = 0.02  # of the range of the force; a smaller difference of zeros may come from moving water


class ZeroDrift(NamedTuple):
    """Zeros of a load cell at the rests of a bench run: mean forces at zero command.

    Attributes
    ----------
    t : Array (n_rests,)
        Mean times of the rests [s], increasing.
    force : Array (n_rests,)
        Mean force at each rest [N].
    """

    t: Array
    force: Array

    @property
    def text(self) -> str:
        """Description of the drift for reports, in two sentences.

        It has the first and the last zero with their times, the range of the zeros, and the correction that is made.
        """
        first, last = float(self.force[0]), float(self.force[-1])
        return (
            f"The load cell's zero drifts: {first:.3g} N at {self.t[0]:.0f} s, {last:.3g} N at {self.t[-1]:.0f} s; its "
            f"range over {counted(self.t.size, 'rest')} is {np.ptp(self.force):.3g} N. The drift is subtracted, "
            "linear between the rests."
        )

    def without_drift(self, force: Channel) -> Channel:
        """Return the channel ``force`` [N] less the drift: the zero at each time less the mean of the zeros.

        The zero is linear between the rests, and constant before the first and after the last one. The mean of the
        zeros stays in the force, because the fit estimates it.
        """
        drift = np.interp(force.t, self.t, self.force - self.force.mean())
        return replace(force, value=force.value - drift)


def zero_drift(command: Channel, force: Channel, settle: float) -> ZeroDrift | None:
    """Find the drift of a load cell's zero between the rests of a bench run.

    A rest is an interval of time in which the command is constant and its size is below 0.001.

    Parameters
    ----------
    command, force
        Channels of a bench run: command of the thruster, -1 to 1, and force of the load cell [N].
    settle
        Time at the beginning of each rest that is left out [s].

    Returns
    -------
    ZeroDrift or None
        Zeros (mean forces) at the rests, in order of time. Rests with fewer than ten samples of the force, or less than
        1 s of samples, after ``settle`` are left out. None if there are fewer than two rests. None also if the largest
        difference of the zeros is below four times its standard error, or below 2 % of the range of the force (1 % to
        99 % quantile).
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
