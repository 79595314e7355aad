"""Motion that the data did not excite: masses and inertia that the fit does not determine, and the reason.

A fit always returns numbers. If the thrusters were never driven apart, the yaw inertia can take almost any value, and
so can the size of every effect that acts on the yaw moment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seatrial.ident.data import Record
from seatrial.ident.estimation.maximum_likelihood import Fit
from seatrial.ident.estimation.thrust_scale import ReportedEstimates
from seatrial.ident.numerics import Array

MASSES = ("m_u", "m_v", "m_r")
LARGEST_ERROR = 0.5  # standard error of a mass as a part of its estimate, above which the data do not determine it
SAME_COMMAND = 0.02  # standard deviation of a command, or of the difference of two, that counts as no change


@dataclass(frozen=True)
class UnexcitedMotion:
    """Masses and inertia that the data do not determine, and the reason in the commands: the motion was not excited.

    Attributes
    ----------
    parameters
        Names among ``m_u``, ``m_v`` and ``m_r``.
    reason
        Clause for reports about the commands. Empty if the commands changed and differed, or if the model lacks an
        input of the left or the right thruster.
    """

    parameters: tuple[str, ...]
    reason: str

    @property
    def clause(self) -> str:
        """Clause for reports: the data do not determine these parameters, followed by the reason if it is known."""
        reason = f": {self.reason}" if self.reason else ""
        return f"the data do not determine {', '.join(self.parameters)}{reason}"


def unexcited_motion(fit: Fit, records: Sequence[Record]) -> UnexcitedMotion | None:
    """Find the masses and the inertia that the data do not determine, because the commands did not excite the motion.

    The data do not determine one if its standard error exceeds half of its estimate, or if it has no standard error. If
    the thrust was not given, both are those of the ratio to the thrust.

    Parameters
    ----------
    fit
        Fit of a vehicle model.
    records
        Records of the fit, with the inputs of the thrusters.

    Returns
    -------
    UnexcitedMotion or None
        None if the data determine all that were estimated.
    """
    reported, lost = ReportedEstimates(fit), []  # ratios to the thrust if the thrust was not given
    for p in fit.parameters:
        if p.name in MASSES:
            value, error = reported.estimate(p, 0)
            if not error <= LARGEST_ERROR * abs(value):
                lost.append(p.name)
    return UnexcitedMotion(tuple(lost), _reason_in_commands(fit, records)) if lost else None


def _reason_in_commands(fit: Fit, records: Sequence[Record]) -> str:
    """Return why the motion was not excited, as a clause about the inputs of the left and the right thruster.

    The inputs are the first of the model whose names end in ``_left`` and ``_right``, over all records together. The
    reason is that neither input changed, or that the two did not differ: a standard deviation below 2 % of the largest
    absolute value of both. The first reason is given if both are true. The clause is empty if neither is true, or if
    the model lacks one of these inputs.
    """
    own = [i.name for i in fit.model.inputs if not i.tap_of]
    sides = [next((n for n in own if n.endswith(f"_{side}")), None) for side in ("left", "right")]
    if None in sides:
        return ""
    left, right = (np.concatenate([r.u[:, r.inputs.index(str(n))] for r in records]) for n in sides)
    full = max(float(np.max(np.abs([left, right]))), 1e-12)
    if all(_standard_deviation(side) < SAME_COMMAND * full for side in (left, right)):
        return "the thrusters never changed"
    if _standard_deviation(left - right) < SAME_COMMAND * full:
        return "both thrusters always did the same, so that nothing turned the boat"
    return ""


def _standard_deviation(signal: Array) -> float:
    """Return the standard deviation of a signal (n,), in its unit."""
    return float(np.std(signal))
