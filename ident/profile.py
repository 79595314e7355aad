"""Profile likelihood: how far a parameter can move before the data object, all others refitted.

    drop(theta_i) = max ln L - max over the others of ln L at theta_i;   95 % interval: drop <= 1.92 = chi2(1) / 2

(Venzon and Moolgavkar 1988; Pawitan 2001, section 2.6.) Unlike value +- 1.96 standard errors (Wald) it needs no
quadratic likelihood, it is the same in any scale of the parameter, and it stops at bounds. With priors it is the
posterior that drops.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.errors import SeatrialError
from ident.dataset import Record
from ident.fit import Fit
from ident.model import Model
from ident.pe import Likelihood
from ident.problem import Problem
from ident.profile_walk import BETTER, Line, Side, walk
from ident.uncertainty import Z95

Array = NDArray[np.float64]
N_RESTARTS = 4  # from better optima


@dataclass(frozen=True)
class Profile:
    """A parameter's profile in its own unit; ``name`` as in ``Fit.names`` (``V_x@0``: of record 0).

    value: the estimate (where noise was restricted, that of the likelihood's own maximum), or that of a better fit met
    on the way, which a note then tells; grid (n,) increasing, drop
    (n,) of the log-likelihood there (zero at ``value``); low, high: the 95 % interval, to about a hundredth, NaN where
    a side is open; wald_low, wald_high: the fit's value +- 1.96 standard errors (of the logarithm for a parameter that
    is estimated as one), NaN where there is none; notes: what to know.
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
    problem = _problem(fit, records, threads)
    estimate = problem.bounds.clip(np.array([p.to_free(v) for p, v in zip(problem.parameters, fit.values,
                                                                          strict=True)]))
    line = Line(problem, fit.names.index(full), estimate)
    if fit.restricted:  # its noise is not that of the maximum, and the profile is of the likelihood
        line.release(estimate)
        line.restart()
    before, sides = line.top, _sides(line)
    for _ in range(N_RESTARTS):
        if not line.restart():
            break
        sides = _sides(line)
    notes = [f"{word} side: {side.note}" for word, side in zip(("lower", "upper"), sides, strict=True) if side.note]
    if line.found[0] > before + BETTER:
        notes.append(f"a better fit was found on the way, by {line.found[0] - before:.2g}, and the profile is of that: "
                     "fit again from there")
    error = fit.errors[line.k] / np.abs(line.parameter.slope(fit.values[line.k]))
    return _gathered(line, full, sides, [estimate[line.k] + sign * Z95 * error for sign in (-1, 1)], notes)


def _sides(line: Line) -> list[Side]:
    return [walk(line, sign) for sign in (-1, 1)]


def _problem(fit: Fit, records: Sequence[Record], threads: int) -> Problem:
    """The fit's objective; raises ValueError where it cannot be of these records."""
    likelihood = Likelihood(fit.model, process_noise=fit.method == "pe")
    free = tuple(dict.fromkeys(n.partition("@")[0] for n in fit.names))
    problem = Problem(likelihood, [r.for_model(fit.model) for r in records], free, threads)
    if problem.names != fit.names:
        raise ValueError(f"the fit estimated {len(fit.names)} parameters, these records have "
                         f"{len(problem.names)}: give the records of the fit")
    return problem


def _gathered(line: Line, name: str, sides: Sequence[Side], wald: Sequence[float], notes: Sequence[str]) -> Profile:
    p, centre = line.parameter, float(line.z[line.k])

    def own(z: float) -> float:
        return float(np.clip(p.from_free(z), *p.bounds)) if np.isfinite(z) else float("nan")

    below, above = (side.shown for side in sides)
    z = [centre - q.s for q in below[::-1]] + [centre] + [centre + q.s for q in above]
    drop = np.array([*[q.drop for q in below[::-1]], 0.0, *[q.drop for q in above]])
    return Profile(
        name, p.unit, own(centre), np.array([own(v) for v in z]), drop, own(centre - sides[0].limit),
        own(centre + sides[1].limit), own(wald[0]), own(wald[1]), tuple(notes))


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
