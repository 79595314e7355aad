"""Does a designed mission deliver? Simulated repeats, each fitted, against the errors that the design predicted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from ident.design import Design
from ident.euler import Inputs
from ident.params import INF
from ident.study import Case, replicates

Array = NDArray[np.float64]
BATCH = 25  # repeats that are simulated together
WILD = 8.0  # predicted standard errors from the truth: the fit has stopped in another optimum


@dataclass(frozen=True)
class Delivered:
    """One parameter over the repeats. predicted: standard error of the design; ratio: spread of the estimates over it,
    with its 95 % interval under normality; coverage: share within 1.96 predicted standard errors; wild: how many are
    far outside (not in ratio, but in coverage)."""

    name: str
    predicted: float
    n: int
    ratio: float
    interval: tuple[float, float]
    coverage: float
    wild: int


def designed_case(made: Design, name: str = "designed") -> Case:
    """The mission as a case of ``ident.study``, estimated as `ident vehicle` does, with damping not bounded at zero (a
    bound makes errors one-sided)."""
    fine = made.task.finer
    apart = [replace(p, bounds=(-INF, INF)) for p in fine.model.parameters if p.transform == "none"]
    u = fine.actuation.inputs(made.command_on(fine)[:, :, None])[:, :, 0]
    model = replace(fine.model.replace_parameters(*apart), second_order=True)
    return Case(name, model, Inputs.linear(fine.t, u), fine.every)


def repeats(made: Design, n: int, seed: int) -> list[Delivered]:
    """Simulate with process and measurement noise, and fit, n times; inputs must be held linearly."""
    case = designed_case(made)
    rows = [row for k in range(0, n, BATCH) for row in replicates(case, range(k, min(k + BATCH, n)), seed)]
    good = [row for row in rows if row.get("converged")]
    return [_delivered(made, name, np.array([row["d"][name] for row in good])) for name in made.task.learned]


def _delivered(made: Design, name: str, d: Array) -> Delivered:
    p, predicted = made.task.model.parameter(name), made.predicted[name]
    z = d * p.slope(p.value) / predicted  # d is in the estimator's coordinate
    tame = np.abs(z) < WILD
    n = int(tame.sum())
    low, high = np.sqrt(stats.chi2.ppf([0.025, 0.975], n - 1) / (n - 1))
    ratio = float(np.std(z[tame], ddof=1))
    return Delivered(name, predicted, len(z), ratio, (ratio / float(high), ratio / float(low)),
                     float(np.mean(np.abs(z) < stats.norm.ppf(0.975))), int((~tame).sum()))
