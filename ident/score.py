"""Score tests of all candidates at once (Lagrange multiplier tests; Engle 1984), without refitting any.

The fitted filter is linearised along its own path: a column of small changes of rates and outputs, one for
each fitted parameter and each candidate's parameter at zero, is carried through the same gains. With G the
whitened sensitivities of the innovations and e the whitened innovations, the score is ``-G' e`` and its
information ``G' G``; the fitted parameters are projected out of both (Schur complement), which is what
keeps a clean data set clean. ``LM = s' I^-1 s`` is chi-squared. A second version takes the covariance of the
score from sums over blocks of five seconds, and stays valid when the innovations are not white.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from ident.dataset import Record
from ident.model import Model
from ident.pe import FilterRun

Array = NDArray[np.float64]
BLOCK = 5.0  # s


@dataclass(frozen=True)
class Columns:
    """A candidate's small changes along one record: d(rates, outputs) per unit of each of its parameters,
    (n_rows, n_states + n_outputs, n_parameters), zero for what it does not touch."""

    name: str
    delta: Array
    parameters: tuple[str, ...] = ()
    scan: dict[str, float] = field(default_factory=dict)
    generic: bool = False
    one_sided: bool = False


@dataclass(frozen=True)
class Score:
    """``step``: the one-step estimate of each parameter; ``lm_block``: the version from blocks."""

    name: str
    lm: float
    df: int
    lm_block: float
    step: dict[str, float]
    scan: dict[str, float]
    generic: bool

    @property
    def p(self) -> float:
        return float(stats.chi2.sf(self.lm, self.df))

    @property
    def p_block(self) -> float:
        return float(stats.chi2.sf(self.lm_block, self.df))

    def criterion(self, n: int) -> float:
        """Gain after paying for its parameters (BIC); larger is better."""
        return self.lm - self.df * float(np.log(n))


class Normal:
    """Normal equations of the whitened sensitivities, summed over records."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = list(names)
        n = len(self.names)
        self.information, self.score = np.zeros((n, n)), np.zeros(n)
        self.blocks: list[Array] = []

    def add(self, positions: Sequence[int], g: Array, e: Array, block: NDArray[np.int64]) -> None:
        """g (n_samples, n_columns) whitened, e (n_samples,) whitened, block (n_samples,) its block's index."""
        at = np.asarray(positions)
        self.information[np.ix_(at, at)] += g.T @ g
        product = -g * e[:, None]
        self.score[at] += product.sum(0)
        starts = np.flatnonzero(np.append(True, np.diff(block) > 0))
        sums = np.zeros((starts.size, len(self.names)))
        sums[:, at] = np.add.reduceat(product, starts, axis=0)
        self.blocks.append(sums)


def whitened_sensitivities(run: FilterRun, record: Record, jacobian: Array, delta: Array) -> tuple[Array, Array, Array]:
    """Carry the columns through the filter.

    jacobian (n_rows, n_outputs, n_states): of the outputs at the predicted states; delta (n_rows, n_states +
    n_outputs, n_columns). Returns whitened sensitivities of the innovations (n_samples, n_columns), whitened
    innovations (n_samples,) and the time of each (n_samples,).
    """
    n_states, n_columns, h = run.x_pred.shape[1], delta.shape[2], record.h
    dx = np.zeros((n_states, n_columns))
    g, e, t = [], [], []
    wild = run.outliers
    for k in range(record.n_rows):
        seen = np.flatnonzero(np.isfinite(record.y[k]) & ~wild[k])
        if seen.size:
            H = jacobian[k][seen]
            cross = run.P_pred[k] @ H.T
            S = H @ cross
            S[np.diag_indices_from(S)] += run.R[seen]
            root = np.linalg.cholesky(S)
            d_innovation = -(delta[k, n_states + seen] + H @ dx)
            white = np.linalg.solve(root, np.column_stack([d_innovation, run.e[k, seen]]))
            g.append(white[:, :-1])
            e.append(white[:, -1])
            t.append(np.full(seen.size, record.t[k]))
            dx += cross @ np.linalg.solve(root.T, white[:, :-1])
        if h[k] > 0:
            dx = run.Phi[k] @ (dx + h[k] / 2 * delta[k, :n_states]) + h[k] / 2 * delta[k + 1, :n_states]
    return np.concatenate(g), np.concatenate(e), np.concatenate(t)


def score_tests(
    normal: Normal, n_fitted: int, prior: Array, candidates: Sequence[tuple[Columns, list[int]]]
) -> list[Score]:
    """One score for each candidate; the first ``n_fitted`` columns are the fitted parameters.

    prior (n_fitted,): the information of the priors, on the diagonal.
    """
    fitted = normal.information[:n_fitted, :n_fitted] + np.diag(prior)
    scale = np.sqrt(np.maximum(np.diag(fitted), 1e-300))
    gain = np.linalg.lstsq(
        fitted / np.outer(scale, scale), normal.information[:n_fitted] / scale[:, None], rcond=1e-12
    )[0]
    gain = gain / scale[:, None]
    information = normal.information - normal.information[:n_fitted].T @ gain
    score = normal.score - gain.T @ normal.score[:n_fitted]
    blocks = np.concatenate(normal.blocks)
    blocks = blocks - blocks[:, :n_fitted] @ gain
    scores = [_one(c, at, information, score, blocks, normal.information) for c, at in candidates]
    return [s for s in scores if s is not None]


def _one(
    candidate: Columns, at: list[int], information: Array, score: Array, blocks: Array, before: Array
) -> Score | None:
    names = np.array(candidate.parameters or [f"{candidate.name}[{i}]" for i in range(len(at))])
    index = np.asarray(at)
    # what the fitted parameters can imitate to 1e-8 cannot be tested
    alive = np.diag(information)[index] > 1e-8 * np.diag(before)[index]
    if not alive.any():
        return None
    index, names = index[alive], names[alive]
    info, s = information[np.ix_(index, index)], score[index]
    size = np.sqrt(np.diag(info))
    w, V = np.linalg.eigh(info / np.outer(size, size))
    keep = w > 1e-6
    z = (V.T @ (s / size))[keep]
    lm, df = float(np.sum(z * z / w[keep])), int(keep.sum())
    step = (V[:, keep] @ (z / w[keep])) / size
    B = blocks[:, index] / size @ V[:, keep]
    C = B.T @ B
    lm_block = float(z @ np.linalg.solve(C + 1e-9 * np.trace(C) * np.eye(df), z))
    if candidate.one_sided and step[0] < 0:
        lm = lm_block = 0.0
    return Score(
        candidate.name,
        lm,
        df,
        lm_block,
        dict(zip(names.tolist(), step.tolist(), strict=True)),
        candidate.scan,
        candidate.generic,
    )


def block_index(t: Array) -> NDArray[np.int64]:
    return np.floor(t / BLOCK).astype(np.int64)


def fitted_names(model: Model, n_records: int) -> list[str]:
    """Names of the fitted dynamic parameters: shared, then ``name@record`` for those per record."""
    mean = [p for p in model.parameters if p.free and p.name not in noise_names(model)]
    return [p.name for p in mean if not p.per_record] + [
        f"{p.name}@{i}" for i in range(n_records) for p in mean if p.per_record
    ]


def noise_names(model: Model) -> set[str]:
    """Parameters that only set covariances: their score does not mix with that of the mean."""
    named = [s.noise for s in model.states] + [o.noise for o in model.outputs]
    named += [s.sd0 for s in model.states]
    return {n for n in named if isinstance(n, str)}
