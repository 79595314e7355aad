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
        tried = np.unique(np.minimum(step * TRIED, Z95 * error))  # beyond that, a fall is no news
        low, high = (_fall(value, z, i, sign * tried, bounds) for sign in (-1.0, 1.0))
        if np.isfinite([low, high]).any():
            low, high = max(low, bounds.low[i]), min(high, bounds.high[i])
            if high - low < Z95 * error:
                found.append(Plateau(i, float(low), float(high)))
    return found


def _fall(value: Callable[[Array], float], z: Array, i: int, tried: Array, bounds: Bounds) -> float:
    """Where along coordinate i the likelihood has fallen, looked for at the distances ``tried`` (either sign);
    infinite where it does not, or where it ends before it has."""
    top = value(z)

    def there(x: float) -> float:
        moved = z.copy()
        moved[i] = x
        return value(moved)

    def fallen(x: float) -> bool:
        return not there(x) > top - DROP

    inner = float(z[i])
    for outer in np.clip(z[i] + tried, bounds.low[i], bounds.high[i]).tolist():
        if fallen(outer):
            for _ in range(N_HALVINGS):
                middle = 0.5 * (inner + outer)
                inner, outer = (inner, middle) if fallen(middle) else (middle, outer)
            return float(outer if np.isfinite(there(outer)) else np.copysign(np.inf, tried[0]))
        inner = outer
    return float(np.copysign(np.inf, tried[0]))


def informed(at: Evaluation, found: Sequence[Plateau]) -> Evaluation:
    """With the plateaus' information, and nothing of what else there was of these coordinates."""
    information = at.information.copy()
    for p in found:
        information[p.at, :] = information[:, p.at] = 0.0
        information[p.at, p.at] = p.information
    return replace(at, information=information)
