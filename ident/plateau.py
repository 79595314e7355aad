"""How well a parameter is known whose likelihood is flat where it stands, but falls a little further off.

The end of a dead zone between two set-points, a limit that no sample touches, or a parameter that acts by its square
and is best at zero: the gradient's outer product, which is the expected information, sees nothing of it, and a standard
error from that says that nothing is known. What is known is how far the parameter can be moved, all else held, until
the likelihood has fallen; with all else refitted, a profile (``ident.profile``) says how far.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ident.params import Parameter
from ident.scoring import Bounds, Evaluation
from ident.uncertainty import DROP, Z95

Array = NDArray[np.float64]
TRIED = 10.0 ** np.arange(-2.0, 5.0)  # times a step of the parameter that is small but felt
N_HALVINGS = 12
Fallen = Callable[[float], bool | None]


@dataclass(frozen=True)
class Plateau:
    """Coordinate ``at`` can be moved to ``low`` and to ``high`` until the log-likelihood has fallen by 1.92."""

    at: int
    low: float
    high: float

    @property
    def remark(self) -> str:
        """For a flag."""
        return (f"flat here: the likelihood falls at {self.low:.4g} and at {self.high:.4g}, and its error is by that, "
                "all else held")

    @property
    def information(self) -> float:
        """Of a normal with this as its 95 % interval."""
        return float((2.0 * Z95 / (self.high - self.low)) ** 2)


def plateaus(value: Callable[[Array], float], z: Array, parameters: Sequence[Parameter], information: Array,
             bounds: Bounds) -> list[Plateau]:
    """Coordinates inside their bounds whose error by the ``information`` (n, n) alone is beyond their felt step, though
    the log-likelihood ``value`` falls within half of it. Logarithms have none: what they stand for is smooth."""
    found = []
    for i, p in enumerate(parameters):
        error = 1.0 / np.sqrt(information[i, i]) if information[i, i] > 0.0 else np.inf
        step = p.step or 0.01 * abs(p.value) or 1.0
        if bounds.logarithmic[i] or not bounds.low[i] < z[i] < bounds.high[i] or error < step:
            continue
        tried, fallen = np.unique(np.minimum(step * TRIED, Z95 * error)), _fallen(value, z, i)
        sides = [_bracket(fallen, np.clip(z[i] + sign * tried, bounds.low[i], bounds.high[i]), float(z[i]))
                 for sign in (-1.0, 1.0)]
        if not any(np.isfinite(outer) for _, outer in sides) or sides[1][0] - sides[0][0] > Z95 * error:
            continue
        low, high = (_narrowed(fallen, *side) for side in sides)
        low, high = max(low, bounds.low[i]), min(high, bounds.high[i])
        if high - low < Z95 * error:
            found.append(Plateau(i, float(low), float(high)))
    return found


def _fallen(value: Callable[[Array], float], z: Array, i: int) -> Fallen:
    """Whether the likelihood has fallen where coordinate i has another value; None where it is no number."""
    top = value(z)

    def fallen(x: float) -> bool | None:
        moved = z.copy()
        moved[i] = x
        there = value(moved)
        return bool(there < top - DROP) if np.isfinite(there) else None

    return fallen


def _bracket(fallen: Fallen, tried: Array, z: float) -> tuple[float, float]:
    """The last of the tried that has not fallen and the first that has; infinite where none has."""
    inner = z
    for outer in tried.tolist():
        if fallen(outer) is not False:
            return inner, outer
        inner = outer
    return inner, float(np.copysign(np.inf, tried[-1] - z))


def _narrowed(fallen: Fallen, inner: float, outer: float) -> float:
    """Where in between it falls; infinite where it ends before it has fallen."""
    if not np.isfinite(outer):
        return outer
    side = outer - inner
    for _ in range(N_HALVINGS):
        middle = 0.5 * (inner + outer)
        inner, outer = (inner, middle) if fallen(middle) is not False else (middle, outer)
    return outer if fallen(outer) else float(np.copysign(np.inf, side))


def informed(at: Evaluation, found: Sequence[Plateau]) -> Evaluation:
    """With the plateaus' information, and nothing of what else there was of these coordinates."""
    information = at.information.copy()
    for p in found:
        information[p.at, :] = information[:, p.at] = 0.0
        information[p.at, p.at] = p.information
    return replace(at, information=information)
