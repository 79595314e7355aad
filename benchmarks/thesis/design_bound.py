"""Upper bound of log det of the information of all experiments with the same duration and amplitude.

log det is concave. For the information F of any input, and M of any experiment or mixture of experiments,

    log det F <= log det M + tr(M^-1 F) - q

with q parameters (Kiefer and Wolfowitz 1960; Fedorov 1972, theorem 2.2.1). The bound is the maximum of the right-hand
side over all inputs. The trace is a sum over time, so its maximum is easier to find than that of log det. The input of
the maximum is then mixed into M, which makes the bound tighter.

The bound depends on the success of this search. The search starts at the design and at random inputs, with finer steps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from seatrial.ident.experiment_design.evaluator import DesignEvaluator
from seatrial.ident.experiment_design.excitation import StepInput
from seatrial.ident.experiment_design.optimal_design import Design, search_design
from seatrial.ident.experiment_design.problem import DesignProblem
from seatrial.ident.numerics.linear_algebra import Array

FINEST = 2.0  # s, mean duration of the steps in the search
MIXES = np.linspace(0.0, 1.0, 101)  # shares of the new input in the mixture that are tried


@dataclass(frozen=True)
class Bound:
    """Upper bound of log det of the information of all experiments of a problem.

    Attributes
    ----------
    value : float
        Smallest bound of all rounds, in the scale of ``Design.value`` (log det in characteristic parameter steps).
    rounds : tuple of float
        Bound of each round.
    """

    value: float
    rounds: tuple[float, ...]


def upper_bound(made: Design, *, rounds: int = 2, evaluations: int = 14_000, seed: int = 1) -> Bound:
    """Return the upper bound for the problem of a D-optimal design.

    Parameters
    ----------
    made : Design
        D-optimal design of all learned parameters, without limits on the track.
    rounds : int
        Number of searches. After each, the new input is mixed into M, the information of the mixture.
    evaluations : int
        Number of evaluated inputs in each search.
    seed : int
        Seed of the searches.

    Returns
    -------
    Bound
        The smallest bound, and that of each round.

    Raises
    ------
    ValueError
        If the criterion is not log det of the information of all parameters, or the track has limits.
    """
    problem = made.problem
    if problem.criterion != "D" or problem.chosen or problem.robust or problem.limits.bind:
        raise ValueError("the bound is for D-optimal designs of all parameters without limits")
    finer, criterion = _problem_with_finer_steps(problem), made.evaluator.criterion
    of_finer = DesignEvaluator(finer)
    M, q = made.information + made.evaluator.prior_information, len(problem.free)
    reached = float(criterion(M[None])[0])
    warm, found, rng = as_point(finer.steps, made.command, problem.grid)[None], [], np.random.default_rng([seed, 23])

    def information(z: Array) -> Array:
        """Return the information (n, q, q) of the inputs at points z (n, size) of the search space."""
        u = finer.actuation.inputs(finer.commands(z))
        return np.asarray(of_finer.experiments(u).information + of_finer.prior_information)

    for k in range(rounds):
        judge = partial(_trace_criterion, information, np.asarray(np.linalg.inv(M)))
        starts = finer.steps.random(64, rng)
        starts = np.vstack([warm, starts[np.argsort(-judge(starts)[0])[:1]]])
        best = search_design(finer.steps, judge, evaluations, seed + k, starts, None)
        found.append(reached + max(best.value, float(q)) - q)  # the trace of the design itself is q
        mixed = (1 - MIXES[:, None, None]) * M + MIXES[:, None, None] * information(best.z[None])
        values = criterion(mixed)
        M, reached = mixed[int(np.argmax(values))], float(values.max())
        warm = np.vstack([warm[:1], best.z[None]])
    return Bound(min(found), tuple(found))


def _trace_criterion(information: Callable[[Array], Array], W: Array, z: Array) -> tuple[Array, Array]:
    """Return the criterion of the search for points of the search space, and their violation of constraints.

    Parameters
    ----------
    information : callable
        Returns the information F (n, q, q) of points (n, size).
    W : Array (q, q)
        Weight of the trace: the inverse of the information of the mixture.
    z : Array (n, size)
        Points of the search space.

    Returns
    -------
    tuple of Array (n,)
        tr(W F) of each point, and zeros, because there are no constraints.
    """
    return np.einsum("ij,nij->n", W, information(z)), np.zeros(len(z))


def _problem_with_finer_steps(problem: DesignProblem) -> DesignProblem:
    """Return the problem with at least one step of the input per 2 s (FINEST) and shorter shortest steps."""
    steps = problem.steps
    n_steps = max(steps.n_steps, round(steps.duration / FINEST))
    return replace(problem, steps=replace(steps, n_steps=n_steps, shortest=min(steps.shortest, 2 * steps.grid)))


def as_point(steps: StepInput, command: Array, grid: float) -> Array:
    """Return the point of the search space that belongs to a command.

    The longest steps are split until the command has as many steps as the parametrisation.

    Parameters
    ----------
    steps : StepInput
        Parametrisation of the steps.
    command : Array (n_rows, n_channels)
        Command, constant in each row.
    grid : float
        Time between rows [s].

    Returns
    -------
    Array (size,)
        Levels of all steps, then the shares of their durations.
    """
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
