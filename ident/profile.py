"""Profile likelihood: how far a parameter can move before the data object, all others refitted.

    drop(theta_i) = max ln L - max over the others of ln L at theta_i;   95 % interval: drop <= 1.92 = chi2(1) / 2

(Venzon and Moolgavkar 1988; Pawitan 2001, section 2.6.) Unlike value +- 1.96 standard errors (Wald) it needs no
quadratic likelihood, it is the same in any scale of the parameter, and it stops at bounds. With priors it is the
posterior that drops.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from daq.errors import SeatrialError
from ident.dataset import Record
from ident.fit import TOLERANCE, Fit
from ident.model import Model
from ident.pe import Likelihood
from ident.problem import Problem
from ident.scoring import Evaluation, maximise

Array = NDArray[np.float64]
DROP = 1.9207294  # half of chi2(1) at 95 %
Z95 = 1.959964
TARGETS = (0.15, 0.6, 1.3, 2.4)  # drops aimed at, each way
MORE = 10  # points each way, before a side is left open
FASTEST = 3.0  # growth of the distance from point to point, where the drop lags behind its target
LARGEST = 1.5  # in a logarithm


@dataclass(frozen=True)
class Profile:
    """A parameter's profile in its own unit; ``name`` as in ``Fit.names`` (``V_x@0``: of record 0).

    grid (n,) increasing, drop (n,) of the log-likelihood there (zero at ``value``); low, high: the 95 % interval,
    NaN where a side is open; wald_low, wald_high: value +- 1.96 standard errors (of the logarithm for a parameter
    that is estimated as one), NaN where there is none; notes: what to know.
    """

    name: str
    unit: str
    value: float
    grid: Array
    drop: Array
    low: float
    high: float
    wald_low: float
    wald_high: float
    notes: tuple[str, ...] = ()


@dataclass
class _Side:
    """Distances from the estimate on one side (positive numbers), drops there, and why it ended."""

    s: list[float] = field(default_factory=lambda: [0.0])
    drop: list[float] = field(default_factory=lambda: [0.0])
    limit: float = float("nan")
    note: str = ""


class _Line:
    """The objective with one coordinate held, the others at their best, begun from the neighbour's best."""

    def __init__(self, fit: Fit, records: Sequence[Record], name: str, threads: int) -> None:
        self.likelihood = Likelihood(fit.model, process_noise=fit.method == "pe")
        free = tuple(dict.fromkeys(n.partition("@")[0] for n in fit.names))
        self.problem = Problem(self.likelihood, [r.for_model(fit.model) for r in records], free, threads)
        if self.problem.names != fit.names:
            raise ValueError(f"the fit estimated {len(fit.names)} parameters, these records have "
                             f"{len(self.problem.names)}: give the records of the fit")
        self.k = fit.names.index(name)
        self.others = np.delete(np.arange(len(fit.names)), self.k)
        self.parameter = self.problem.parameters[self.k]
        self.bounds = self.problem.bounds
        self.z = self.bounds.clip(np.array([p.to_free(v) for p, v in zip(self.problem.parameters, fit.values,
                                                                         strict=True)]))
        at = self.problem.evaluate(self.z)
        self.top, self.gradient = at.value, float(at.gradient[self.k])
        self.se = float(fit.errors[self.k] / np.abs(self.parameter.slope(fit.values[self.k])))
        self.curvature, self.slope = self._curvature(at)

    def _curvature(self, at: Evaluation) -> tuple[float, Array]:
        """Of the profile at the top, and how the other coordinates follow (n - 1,); those at a bound do not."""
        H = at.hessian
        held = self.bounds.held(self.z, at.gradient)[self.others]
        moving = self.others[~held]
        follow = np.zeros(self.others.size)
        if moving.size:
            scale = np.sqrt(np.maximum(np.diag(H)[moving], 1e-300))
            right = H[moving, self.k] / scale
            follow[~held] = -np.linalg.lstsq(H[np.ix_(moving, moving)] / np.outer(scale, scale), right,
                                             rcond=1e-12)[0] / scale
        return float(H[self.k, self.k] + H[self.k, self.others] @ follow), follow

    def best(self, z_k: float, start: Array) -> tuple[float, Array]:
        """Objective and coordinates of the best at one value of the coordinate."""
        bounds = type(self.bounds)(self.bounds.low[self.others], self.bounds.high[self.others],
                                   self.bounds.logarithmic[self.others])

        def whole(rest: Array) -> Array:
            return np.insert(rest, self.k, z_k)

        def evaluate(rest: Array) -> Evaluation:
            at = self.problem.evaluate(whole(rest))
            return Evaluation(at.value, at.gradient[self.others],
                              at.information[np.ix_(self.others, self.others)], at.curvature[self.others])

        if not self.others.size:
            return self.problem.evaluate(whole(np.empty(0))).value, whole(np.empty(0))
        begin = bounds.clip(start[self.others])
        if not evaluate(begin).finite:
            return float("nan"), start
        found = maximise(evaluate, begin, bounds, max_iterations=40, tolerance=TOLERANCE * 100)
        return found.at.value, whole(found.z)


def profile(fit: Fit, records: Sequence[Record], name: str, *, threads: int = 2) -> Profile:
    """The profile of one estimated parameter, on a grid that finds its own range.

    ``records``: those of the fit. A parameter that every record has for itself is named ``NAME@K``; ``NAME`` will do
    where there is one record. Raises ValueError where the fit did not estimate it.
    """
    full = name if name in fit.names else f"{name}@0" if len(fit.records) == 1 else name
    if full not in fit.names:
        each = [n for n in fit.names if n.startswith(f"{name}@")]
        hint = f"each run has its own: {', '.join(each)}" if each else f"it estimated {', '.join(fit.names)}"
        raise ValueError(f"no profile of {name}: the fit did not estimate it; {hint}")
    line = _Line(fit, records, full, threads)
    sides = {sign: _walk(line, sign) for sign in (-1, 1)}
    return _gathered(line, full, sides)


def _walk(line: _Line, sign: int) -> _Side:
    """Outwards from the estimate until the likelihood has dropped enough, or a bound or the patience is reached."""
    side, z_best = _Side(), line.z
    low, high = float(line.bounds.low[line.k]), float(line.bounds.high[line.k])
    room = (high - line.z[line.k]) if sign > 0 else (line.z[line.k] - low)
    if room <= 0:
        side.note, side.limit = "at its bound", 0.0
        return side
    logarithmic = bool(line.bounds.logarithmic[line.k])
    for step in range(MORE):
        s = min(_distance(line, side, sign, TARGETS[min(step, len(TARGETS) - 1)], logarithmic), room)
        moved = s - side.s[-1]
        start = z_best.copy()
        start[line.others] += sign * moved * line.slope
        value, z = line.best(line.z[line.k] + sign * s, start)
        if not np.isfinite(value):
            side.note = "the likelihood cannot be evaluated beyond"
            break
        side.s.append(s)
        side.drop.append(line.top - value)
        z_best = z
        if side.drop[-1] > TARGETS[-1] * 0.9 or (side.drop[-1] > DROP and step >= len(TARGETS) - 1):
            break
        if s >= room:
            side.note = "reaches its bound"
            break
    if max(side.drop) >= DROP:
        side.limit = _crossing(side)
        side.note = ""
    elif side.note == "reaches its bound":
        side.limit = room
    elif not side.note:
        side.note = "the data set no limit"
    return side


def _distance(line: _Line, side: _Side, sign: int, target: float, logarithmic: bool) -> float:
    """Where the drop should reach the target: from the curvature at first, then from the points so far."""
    last, drop = side.s[-1], side.drop[-1]
    if last == 0.0:
        # g s + c s^2 / 2 = target; g is zero but for a parameter that is pushed against its bound
        g, c = max(-sign * line.gradient, 0.0), max(line.curvature, 1e-12)
        s = 2.0 * target / (g + np.sqrt(g * g + 2.0 * c * target))
    else:
        s = last * float(np.clip(np.sqrt(target / max(drop, 1e-3)), 1.25, FASTEST))
    return min(s, last + LARGEST) if logarithmic else float(s)


def _crossing(side: _Side) -> float:
    """The distance at which the drop is 1.92; the root of the drop is nearly a straight line in it."""
    root = np.sqrt(np.maximum(side.drop, 0.0))
    n = int(np.argmax(root >= np.sqrt(DROP))) + 1
    rising = np.maximum.accumulate(root[:n]) + 1e-12 * np.arange(n)
    return float(PchipInterpolator(rising, np.asarray(side.s[:n]))(np.sqrt(DROP)))


def _gathered(line: _Line, name: str, sides: dict[int, _Side]) -> Profile:
    p, centre = line.parameter, float(line.z[line.k])
    below, above = sides[-1], sides[1]

    def own(z: float) -> float:
        return float(np.clip(p.from_free(z), *p.bounds))

    z = [centre - s for s in below.s[:0:-1]] + [centre + s for s in above.s]
    drop = np.array([*below.drop[:0:-1], *above.drop])
    notes = [f"{word} side: {side.note}" for word, side in (("lower", below), ("upper", above)) if side.note]
    if drop.min() < -0.01:
        notes.append(f"a better fit was found on the way, by {-drop.min():.2g}: fit again from there")
    return Profile(
        name, p.unit, own(centre), np.array([own(v) for v in z]), drop,
        own(centre - below.limit) if np.isfinite(below.limit) else float("nan"),
        own(centre + above.limit) if np.isfinite(above.limit) else float("nan"),
        own(centre - Z95 * line.se) if np.isfinite(line.se) else float("nan"),
        own(centre + Z95 * line.se) if np.isfinite(line.se) else float("nan"), tuple(notes))


def check_names(model: Model, names: Sequence[str]) -> None:
    """Raises SeatrialError, before any fit, for a name that no fit of the model will have estimated."""
    for name in names:
        base = name.partition("@")[0]
        if base not in model.values:
            raise SeatrialError(f"--profile {name}: model {model.name} has {', '.join(model.values)}")
        if not model.parameter(base).free:
            raise SeatrialError(f"--profile {name}: it is given, not estimated; estimated are {', '.join(model.free)}")


def profile_part(found: Profile) -> dict[str, Any]:
    """A row of ``profiles`` in result.json."""
    return {
        "name": found.name, "unit": found.unit, "value": found.value, "grid": found.grid, "drop": found.drop,
        "low": found.low, "high": found.high, "wald_low": found.wald_low, "wald_high": found.wald_high,
        "notes": list(found.notes),
    }
