"""Pattern search without derivatives, in batches (Hooke and Jeeves 1961; Audet and Dennis 2002).

Poll: single coordinates up and down by the mesh size, in random order, a batch at a time; a batch that gains moves at
once. Search: moves of several coordinates, the last gain once and three times more (the pattern of Hooke and Jeeves),
and the sum of all moves that gained in a batch, which is often better still. When a whole poll has gained nothing the
mesh is halved. What breaks a constraint loses to what breaks it less, and everything that breaks one to what breaks
none (Deb 2000).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.numerics.linear_algebra import Array

Evaluate = Callable[[Array], tuple[Array, Array]]
EvaluateAbove = Callable[[Array, float], tuple[Array, Array]]
VIOLATION_PENALTY = 1e12  # of the merit, by any violation of a constraint
FIRST_MESH, LAST_MESH = 0.25, 1e-3  # of the range of a coordinate: mesh size at the start and at the end
BATCH = 64  # points that are evaluated together
PATIENCE = 6  # batches without gain before the mesh is halved, where a poll is a single batch


def penalised_objective(value: Array, violation: Array) -> Array:
    """One number to compare by: the value where no constraint is broken."""
    return np.where(violation > 0, -VIOLATION_PENALTY * (1.0 + violation), value)


def breaks_a_constraint(merit: float) -> bool:
    """Whether a `penalised_objective` is that of a point that breaks a constraint."""
    return merit <= -VIOLATION_PENALTY


@dataclass
class SearchState:
    """One running search: where it is, what that is worth, and its mesh. order: coordinates still to be polled; idle:
    batches since the last gain."""

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
        return self.mesh < LAST_MESH


@dataclass(frozen=True)
class SearchResult:
    """z (n,); value; violation (0: none); evaluations spent; history: evaluations and merit of the best search."""

    z: Array
    value: float
    violation: float
    evaluations: int
    history: tuple[tuple[int, float], ...]
    merits: tuple[float, ...]  # of the restarts


class PatternSearch:
    """``evaluate(z (n, size)) -> value (n,), violation (n,)`` within low, high (size,).

    ``above(z, least)``, where it is given, evaluates what is compared with a merit ``least``: of points that are not
    better it may return any value and violation that are not better, which may cost less. The search is the same.
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
        self.evaluate, self.low, self.high = evaluate, low, high
        self.above: EvaluateAbove = above or (lambda z, least: evaluate(z))
        self.rng = np.random.default_rng([seed, 7])
        self.groups = np.arange(low.size) if groups is None else groups  # coordinates that move together in a search

    def run(
        self, starts: Array, evaluations: int, progress: Callable[[int, float], None] | None = None
    ) -> SearchResult:
        """From each of ``starts`` (m, size) with half of the evaluations, then from the best with the rest."""
        value, violation = self.evaluate(starts)
        searches = [
            SearchState(z.copy(), m)
            for z, m in zip(starts, penalised_objective(value, violation).tolist(), strict=True)
        ]
        share = evaluations // (2 * len(searches)) if len(searches) > 1 else evaluations
        for search in searches:
            self._advance(search, share, progress)
        merits = tuple(s.merit for s in searches)
        best = max(searches, key=lambda s: s.merit)
        if len(searches) > 1:
            best.mesh = max(best.mesh, FIRST_MESH / 4)
            self._advance(best, best.evaluations + evaluations - sum(s.evaluations for s in searches), progress)
        value, violation = self.evaluate(best.z[None])
        spent = sum(s.evaluations for s in searches)
        return SearchResult(best.z, float(value[0]), float(violation[0]), spent, tuple(best.history), merits)

    def _advance(self, search: SearchState, until: int, progress: Callable[[int, float], None] | None) -> None:
        while search.evaluations < until and not search.done:
            self._batch(search)
            search.history.append((search.evaluations, search.merit))
            if progress is not None:
                progress(search.evaluations, search.merit)

    def _batch(self, search: SearchState) -> None:
        if not search.order:
            if search.idle >= max(PATIENCE, -(-self.low.size // (BATCH // 4))):
                search.mesh, search.idle = search.mesh / 2.0, 0
            search.order = self.rng.permutation(self.low.size).tolist()
        chosen, search.order = search.order[: BATCH // 4], search.order[BATCH // 4 :]
        trials = np.concatenate([self._poll(search, chosen), self._moves(search, BATCH // 2 - 3)])
        trials = np.clip(np.concatenate([trials, *(z[None] for z in search.ahead)]), self.low, self.high)
        merit = penalised_objective(*self.above(trials, search.merit))
        search.evaluations += len(trials)
        at, better = int(np.argmax(merit)), np.flatnonzero(merit > search.merit)
        search.ahead, search.idle = [], search.idle + 1
        if better.size:
            moves = trials[better] - search.z
            away = moves[np.argsort(-merit[better])[:12]]
            first = np.argmax(np.abs(away) > 0, axis=0)  # the best move decides on each coordinate
            search.ahead = [
                search.z + away[first, np.arange(self.low.size)],
                trials[at] + moves[better == at][0],
                trials[at] + 3.0 * moves[better == at][0],
            ]
            search.z, search.merit, search.idle = trials[at].copy(), float(merit[at]), 0

    def _poll(self, search: SearchState, chosen: list[int]) -> Array:
        step = search.mesh * (self.high - self.low)[chosen]
        trials = np.repeat(search.z[None], 2 * len(chosen), axis=0)
        trials[np.arange(len(chosen)), chosen] += step
        trials[np.arange(len(chosen)) + len(chosen), chosen] -= step
        return trials

    def _moves(self, search: SearchState, n: int) -> Array:
        """One to three groups of coordinates moved by the mesh size at random, or one of them drawn anew."""
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
