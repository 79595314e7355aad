"""How much more could any experiment of the same frame tell? An upper bound on D.

log det is concave, so for the information F of every input, and M of any experiment or mixture of experiments,

    log det F <= log det M + tr(M^-1 F) - q

(Kiefer and Wolfowitz 1960; Fedorov 1972, theorem 2.2.1). What is left is a maximum over inputs of a sum over time,
which is easier to search than log det itself: each stretch counts for itself. With the input that is found mixed into M
the bound becomes tighter. It is as sure as that search, which begins at the design and at random, with finer steps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from seatrial.ident.experiment_design.excitation import StepInput
from seatrial.ident.experiment_design.optimal_design import Design, search_design
from seatrial.ident.experiment_design.task import DesignProblem
from seatrial.ident.numerics.linear_algebra import Array

FINEST = 2.0  # s per step: where every change of the command acts on the shaft at once
MIXES = np.linspace(0.0, 1.0, 101)


@dataclass(frozen=True)
class Bound:
    """value: no experiment reaches more (log det, as ``Design.value``); rounds: the bound after each round."""

    value: float
    rounds: tuple[float, ...]


def upper_bound(made: Design, *, rounds: int = 2, evaluations: int = 14_000, seed: int = 1) -> Bound:
    """The bound for a D-optimal design over all learned parameters, without limits on the track. Raises ValueError for
    another criterion, which is not log det of the whole information."""
    task = made.task
    if task.criterion != "D" or task.chosen or task.robust or task.limits.bind:
        raise ValueError("the bound is for D-optimal designs of all parameters without limits")
    finer = _finer(task)
    M, q = made.information + task.prior, len(task.free)
    reached = float(task.measure(M[None])[0])
    warm, found, rng = as_point(finer.steps, made.command, task.grid)[None], [], np.random.default_rng([seed, 23])

    def told(z: Array) -> Array:
        return finer.experiments(finer.actuation.inputs(finer.commands(z))).information + finer.prior

    for k in range(rounds):
        judge = partial(_along, told, np.asarray(np.linalg.inv(M)))
        starts = finer.steps.random(64, rng)
        starts = np.vstack([warm, starts[np.argsort(-judge(starts)[0])[:1]]])
        best = search_design(finer.steps, judge, evaluations, seed + k, starts, None)
        found.append(reached + max(best.value, float(q)) - q)  # the design itself has q
        mixed = (1 - MIXES[:, None, None]) * M + MIXES[:, None, None] * told(best.z[None])
        values = task.measure(mixed)
        M, reached = mixed[int(np.argmax(values))], float(values.max())
        warm = np.vstack([warm[:1], best.z[None]])
    return Bound(min(found), tuple(found))


def _along(told: Callable[[Array], Array], W: Array, z: Array) -> tuple[Array, Array]:
    """tr(W F) of points z (n, size); nothing is violated."""
    return np.einsum("ij,nij->n", W, told(z)), np.zeros(len(z))


def _finer(task: DesignProblem) -> DesignProblem:
    steps = task.steps
    n_steps = max(steps.n_steps, round(steps.duration / FINEST))
    return replace(task, steps=replace(steps, n_steps=n_steps, shortest=min(steps.shortest, 2 * steps.grid)))


def as_point(steps: StepInput, command: Array, grid: float) -> Array:
    """The point (size,) of steps with a command (n_rows, n_channels) on rows ``grid`` apart; long ones are split."""
    change = np.flatnonzero(np.any(np.diff(command[:-1], axis=0) != 0, axis=1)) + 1
    edges = np.concatenate([[0], change, [round(steps.duration / grid)]])
    rows, levels = np.diff(edges).tolist(), list(command[edges[:-1]])
    while len(rows) < steps.n_steps:
        k = int(np.argmax(rows))
        half = rows[k] // 2
        rows[k : k + 1], levels[k : k + 1] = [half, rows[k] - half], [levels[k], levels[k]]
    spare = np.maximum(np.array(rows[: steps.n_steps]) * grid - steps.shortest, 0.0)
    shares = np.clip(spare / max(spare.max(), grid), 0.02, 1.0)
    return np.append(np.array(levels[: steps.n_steps]).ravel(), shares)
