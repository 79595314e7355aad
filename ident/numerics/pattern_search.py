"""Pattern search without derivatives, in batches (Hooke and Jeeves 1961; Audet and Dennis 2002).

Each batch contains points of three kinds:

- Poll: single coordinates moved up and down by the mesh size, in random order.
- Search: several coordinates moved at random.
- Points ahead, after a batch with an improvement: the improvement continued once and three times more (the pattern of
  Hooke and Jeeves), and the sum of the moves of this batch that improved the merit (each coordinate by the best one).

The search moves to the best point of a batch if it is an improvement. If several batches bring none, the mesh is
halved. A point that violates a constraint is worse than any point that does not; of two such points, the larger
violation is worse (Deb 2000).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.numerics.linear_algebra import Array

Evaluate = Callable[[Array], tuple[Array, Array]]
EvaluateAbove = Callable[[Array, float], tuple[Array, Array]]
Progress = Callable[[int, float, int, int], None]  # evaluations so far, best merit, search number, of how many
VIOLATION_PENALTY = 1e12  # a point that violates a constraint has a merit of minus this, or less
FIRST_MESH, LAST_MESH = 0.25, 1e-3  # mesh size at the start and at the end, relative to the range of a coordinate
BATCH = 64  # number of points that are evaluated together
PATIENCE = 6  # least number of batches without improvement before the mesh is halved; one poll may need more


def penalised_objective(value: Array, violation: Array) -> Array:
    """Return the merit (n,) by which points are compared; larger is better.

    Parameters
    ----------
    value
        Objective (n,).
    violation
        Violation of the constraints (n,); 0 or less for none.

    Returns
    -------
    Array (n,)
        The objective, or for a violated constraint ``-VIOLATION_PENALTY (1 + violation)``.
    """
    return np.where(violation > 0, -VIOLATION_PENALTY * (1.0 + violation), value)


def violates_constraint(merit: float) -> bool:
    """Return whether a merit of `penalised_objective` is that of a point that violates a constraint.

    Such a merit is at most ``-VIOLATION_PENALTY`` (-1e12), so the objective of other points must be larger.
    """
    return merit <= -VIOLATION_PENALTY


@dataclass
class SearchState:
    """State of one running pattern search, from one start.

    Attributes
    ----------
    z : Array (size,)
        Best point so far.
    merit
        Its merit by `penalised_objective`: the objective, or a large negative number if a constraint is violated.
    mesh
        Mesh size, relative to the range of a coordinate.
    evaluations
        Number of evaluations so far.
    history
        Number of evaluations so far and best merit so far, after each batch.
    order
        Indices of the coordinates that are still to be polled (moved up and down) with this mesh, in random order.
    idle
        Number of batches since the last improvement or halving of the mesh.
    ahead
        Points (size,) to evaluate in the next batch, which continue the last improvement.
    """

    z: Array
    merit: float
    mesh: float = FIRST_MESH
    evaluations: int = 0
    history: list[tuple[int, float]] = field(default_factory=list)
    order: list[int] = field(default_factory=list)
    idle: int = 0
    ahead: list[Array] = field(default_factory=list)

    @property
    def done(self) -> bool:
        """Whether the mesh is finer than 0.001 of the range of a coordinate, at which the search ends.

        A search also ends when its evaluations are used up; ``done`` may then be False. A search that is done can be
        continued with a wider mesh, which makes ``done`` False again.
        """
        return self.mesh < LAST_MESH


@dataclass(frozen=True)
class SearchResult:
    """Result of a pattern search.

    Attributes
    ----------
    z : Array (size,)
        Best point.
    value
        Objective there.
    violation
        Violation of the constraints there; 0 or less for none.
    evaluations
        Number of evaluations of all searches, without those of the starts and of the result.
    history
        Number of evaluations so far and best merit so far of the best search, after each batch.
    merits
        Best merit of the search from each start, before the best of several searches is continued.
    """

    z: Array
    value: float
    violation: float
    evaluations: int
    history: tuple[tuple[int, float], ...]
    merits: tuple[float, ...]


class PatternSearch:
    """Maximisation of a function inside bounds by pattern search.

    Parameters
    ----------
    evaluate
        ``evaluate(z (n, size)) -> value (n,), violation (n,)``: objective, and violation of the constraints (0 or
        less for none).
    low, high : Array (size,)
        Bounds.
    seed
        Seed of the random order and moves. The same seed gives the same result.
    groups : Array (size,) of int, optional
        Label of each coordinate. Coordinates with the same label are moved together in random moves, for example the
        levels and the duration of one step. By default each coordinate has its own label.
    above
        ``above(z, least) -> value (n,), violation (n,)``: a cheaper evaluation. The merit of a point is its value, or a
        large negative number if the point violates a constraint (`penalised_objective`). For points whose merit does
        not exceed ``least``, it may return any value and violation with a merit that does not exceed ``least`` either.
        The result of the search is the same. By default ``evaluate`` is used.
    """

    def __init__(
        self,
        evaluate: Evaluate,
        low: Array,
        high: Array,
        seed: int,
        groups: NDArray[np.intp] | None = None,
        above: EvaluateAbove | None = None,
    ) -> None:
        """Store the function and its bounds, and create the random generator. Nothing is evaluated yet.

        Random numbers continue from one call of `run` to the next, so that a second call gives another result.
        """
        self.evaluate, self.low, self.high = evaluate, low, high
        self.above: EvaluateAbove = above or (lambda z, least: evaluate(z))
        self.rng = np.random.default_rng([seed, 7])
        self.groups = np.arange(low.size) if groups is None else groups

    def run(self, starts: Array, evaluations: int, progress: Progress | None = None) -> SearchResult:
        """Search from several starts, and continue from the best of them.

        Parameters
        ----------
        starts : Array (m, size)
            The starts inside the bounds, at least one. Each gets an equal part of half of the evaluations; the best
            gets the rest, and its mesh is widened to at least 1/16 of the range. A single start gets all.
        evaluations
            Total number of evaluations, without those of the starts and of the result. The last batch of each search
            may exceed it. A search ends earlier if its mesh becomes finer than 0.001 of the range of a coordinate.
        progress
            Function that is called after each batch with the number of evaluations of all searches, the best merit of
            the current search, its number from 1 on, and the number of searches: one for each start, and the
            continuation of the best if there are several starts.

        Returns
        -------
        SearchResult
            If no point satisfies the constraints, ``violation`` is positive.
        """
        value, violation = self.evaluate(starts)
        searches = [
            SearchState(z.copy(), m)
            for z, m in zip(starts, penalised_objective(value, violation).tolist(), strict=True)
        ]

        many = len(searches) + 1 if len(searches) > 1 else 1

        def report(merit: float, number: int) -> None:
            """Call ``progress`` with the evaluations so far, and the best merit and number of the current search."""
            if progress is not None:
                progress(sum(s.evaluations for s in searches), merit, number, many)

        share = evaluations // (2 * len(searches)) if len(searches) > 1 else evaluations
        for number, search in enumerate(searches, 1):
            self._continue_search(search, share, partial(report, number=number))
        merits = tuple(s.merit for s in searches)
        best = max(searches, key=lambda s: s.merit)
        if len(searches) > 1:
            best.mesh = max(best.mesh, FIRST_MESH / 4)
            until = best.evaluations + evaluations - sum(s.evaluations for s in searches)
            self._continue_search(best, until, partial(report, number=many))
        value, violation = self.evaluate(best.z[None])
        spent = sum(s.evaluations for s in searches)
        return SearchResult(best.z, float(value[0]), float(violation[0]), spent, tuple(best.history), merits)

    def _continue_search(self, search: SearchState, until: int, report: Callable[[float], None]) -> None:
        """Continue a search until it has used ``until`` evaluations in all or its mesh is below 0.001 of the range.

        It changes ``search`` in place, and appends to its ``history`` after each batch. The last batch is completed,
        so that it may exceed ``until``. After each batch it calls ``report`` with the best merit of the search.
        """
        while search.evaluations < until and not search.done:
            self._evaluate_batch(search)
            search.history.append((search.evaluations, search.merit))
            report(search.merit)

    def _evaluate_batch(self, search: SearchState) -> None:
        """Evaluate one batch of points and move to its best point if that is an improvement; else count an idle batch.

        A batch has two points for each of the next 16 coordinates (poll), 29 random moves, and the points in
        ``search.ahead``. It changes ``search`` in place. Points outside the bounds are moved onto them before the
        evaluation. After an improvement ``search.ahead`` gets three new points, which continue it; otherwise it is
        emptied. If all coordinates have been polled and at least six batches in sequence were idle (more for many
        coordinates), the mesh is halved before the batch.
        """
        if not search.order:
            if search.idle >= max(PATIENCE, -(-self.low.size // (BATCH // 4))):
                search.mesh, search.idle = search.mesh / 2.0, 0
            search.order = self.rng.permutation(self.low.size).tolist()
        chosen, search.order = search.order[: BATCH // 4], search.order[BATCH // 4 :]
        trials = np.concatenate([self._poll_points(search, chosen), self._random_moves(search, BATCH // 2 - 3)])
        trials = np.clip(np.concatenate([trials, *(z[None] for z in search.ahead)]), self.low, self.high)
        merit = penalised_objective(*self.above(trials, search.merit))
        search.evaluations += len(trials)
        at, better = int(np.argmax(merit)), np.flatnonzero(merit > search.merit)
        search.ahead, search.idle = [], search.idle + 1
        if better.size:
            moves = trials[better] - search.z
            away = moves[np.argsort(-merit[better])[:12]]
            first = np.argmax(np.abs(away) > 0, axis=0)  # for each coordinate, the best of the moves that change it
            search.ahead = [
                search.z + away[first, np.arange(self.low.size)],
                trials[at] + moves[better == at][0],
                trials[at] + 3.0 * moves[better == at][0],
            ]
            search.z, search.merit, search.idle = trials[at].copy(), float(merit[at]), 0

    def _poll_points(self, search: SearchState, chosen: list[int]) -> Array:
        """Return points (2 k, size): the best point with each of the k ``chosen`` coordinates moved by the mesh size.

        In the first k points one coordinate is moved up, in the others down. The mesh size is a share of the range
        between the bounds. The points may be outside the bounds; `_evaluate_batch` moves them onto the bounds.
        """
        step = search.mesh * (self.high - self.low)[chosen]
        trials = np.repeat(search.z[None], 2 * len(chosen), axis=0)
        trials[np.arange(len(chosen)), chosen] += step
        trials[np.arange(len(chosen)) + len(chosen), chosen] -= step
        return trials

    def _random_moves(self, search: SearchState, n: int) -> Array:
        """Return n random points (n, size) near the best point.

        A group is the coordinates with one label of ``groups``. In each fourth point the coordinates of one group are
        drawn anew between the bounds. In the others the coordinates of one to three groups are moved at random by about
        the mesh size; these points may be outside the bounds.
        """
        trials, labels = np.repeat(search.z[None], n, axis=0), np.unique(self.groups)
        for k in range(n):
            some = np.isin(self.groups, self.rng.choice(labels, int(self.rng.integers(1, 4))))
            if k % 4 == 0:
                some = self.groups == self.rng.choice(labels)
                trials[k, some] = self.rng.uniform(self.low[some], self.high[some])
            else:
                width = search.mesh * (self.high - self.low)[some]
                trials[k, some] += self.rng.normal(size=int(some.sum())) * width
        return trials
