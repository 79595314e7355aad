"""Score tests (Lagrange multiplier tests; Engle 1984) of all candidates at once, without refitting any.

The fitted filter is linearised along its predicted trajectory: a column of changes of rates and outputs, one for each
fitted parameter and each parameter of a candidate at zero, is propagated through the same gains. With G the whitened
sensitivities of the innovations and e the whitened innovations, the score is ``-G' e`` and its information ``G' G``;
the fitted parameters are projected out of both (Schur complement), which keeps the size of the test. ``LM = s' I^-1 s``
is chi-squared. The block-robust version takes the covariance of the score from sums over blocks of five seconds (two on
the bench), and stays valid where the innovations are not white.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from seatrial.ident.data import Record
from seatrial.ident.engine import NOWHERE, apply_rows, padded
from seatrial.ident.estimation import FilterResult
from seatrial.ident.model import EffectKind, ForceCurve, Model, Parameter, segment_name
from seatrial.ident.numerics import Array, scaled_eigen

BLOCK = 5.0  # s, of the block-robust version
N_COLUMNS = 96  # propagated through the filter at a time: a size that fits the cache of the processor
WHOLE, PART = 8192, 2048  # rows; a longer record than the first is done in parts of the second
ALPHA = 0.05  # family-wise false-alarm probability of the score tests
P_BLOCK = 0.01  # level of the block-robust version
# evidence in few blocks limits the block-robust version; overwhelming evidence may pass, and validation decides
P_OVERWHELMING, P_BLOCK_OVERWHELMING = 1e-12, 0.1


@dataclass(frozen=True)
class SensitivityColumns:
    """Sensitivities of a candidate along one record: d(rates, outputs) per unit of each of its parameters.

    delta (n_rows, n_touched, n_parameters) of those of the model's rates and then outputs that it touches;
    touched (n_touched,): which these are, in order, None: all.
    """

    name: str
    delta: Array
    parameters: tuple[str, ...] = ()
    scan: dict[str, float] = field(default_factory=dict)
    kind: EffectKind = EffectKind.CATALOGUE
    curve: ForceCurve | None = None
    one_sided: bool = False
    per_record: bool = False  # the parameters have their own value in each record
    touched: NDArray[np.int64] | None = None


@dataclass(frozen=True)
class ColumnIndex:
    """Indices ``at`` of the columns of a candidate among all; those of per-record parameters one record after
    another."""

    columns: SensitivityColumns
    at: tuple[int, ...]

    def of_record(self, i: int) -> tuple[int, ...]:
        """Indices of the columns of record i."""
        if not self.columns.per_record:
            return self.at
        size = self.columns.delta.shape[2]
        return self.at[i * size : (i + 1) * size]

    @property
    def names(self) -> list[str]:
        """Of the parameters; ``NAME@i`` where each record has its own."""
        c, size = self.columns, self.columns.delta.shape[2]
        names = list(c.parameters) or [f"{c.name}[{i}]" for i in range(size)]
        records = range(len(self.at) // size)
        return [segment_name(n, i) for i in records for n in names] if c.per_record else names


def place(columns: Sequence[SensitivityColumns], first: int, n_records: int) -> tuple[list[ColumnIndex], int]:
    """Indices for every candidate, from ``first`` on, and the total number of columns."""
    places = []
    for c in columns:
        size = c.delta.shape[2] * (n_records if c.per_record else 1)
        places.append(ColumnIndex(c, tuple(range(first, first + size))))
        first += size
    return places, first


@dataclass(frozen=True)
class Score:
    """``step``: the one-step estimate of each parameter; ``lm_block``: the version from blocks; ``kind`` and ``curve``:
    of the effect that is tested; ``threshold``: critical value of ``lm`` among the tests that were made with it;
    ``blocks``: of time, of which ``lm_block`` cannot exceed the number, whatever the effect; ``tolerance``: the part of
    its information that the fitted parameters do not take up (one over the variance inflation factor), priors left out,
    of that parameter of which most is left."""

    name: str
    lm: float
    df: int
    lm_block: float
    step: dict[str, float]
    scan: dict[str, float]
    kind: EffectKind = EffectKind.CATALOGUE
    curve: ForceCurve | None = None
    threshold: float = float("nan")
    blocks: float = float("inf")
    tolerance: float = 1.0

    @property
    def least_blocks(self) -> int:
        """So many blocks of time are needed for the version from blocks to pass at all."""
        return int(np.ceil(stats.chi2.isf(P_BLOCK, self.df)))

    @property
    def generic(self) -> bool:
        """Whether no catalogue lists it."""
        return self.kind.unknown

    @property
    def p(self) -> float:
        return float(stats.chi2.sf(self.lm, self.df))

    @property
    def p_block(self) -> float:
        return float(stats.chi2.sf(self.lm_block, self.df))

    def criterion(self, n: int) -> float:
        """BIC criterion: LM less ``df ln n``; larger is better."""
        return self.lm - self.df * float(np.log(n))


class NormalEquations:
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
        edges = [*np.flatnonzero(np.append(True, np.diff(block) > 0)).tolist(), len(e)]
        sums = np.zeros((len(edges) - 1, len(self.names)))
        sums[:, at] = [-(e[first:last] @ g[first:last]) for first, last in pairwise(edges)]
        self.score += sums.sum(axis=0)
        self.blocks.append(sums)


class SensitivityFilter:
    """Propagates columns of sensitivities through the filter of one record.

    run: filter result of the record; rows: those to propagate through; jacobian (n_rows or one more, n_outputs,
    n_states): of the outputs at their predicted states. ``e``, ``t`` (n_samples,): whitened innovations and their
    times; ``end`` (n_states, n_columns): sensitivities of the state after the rows, of the last call.
    """

    def __init__(self, run: FilterResult, record: Record, jacobian: Array, rows: slice = slice(None)) -> None:
        P_pred, _, Phi = run.covariances(rows)
        self.half = np.ascontiguousarray(record.h[rows] / 2)
        self.seen = np.isfinite(record.y[rows]) & ~run.outliers[rows]
        H = np.where(self.seen[:, :, None], jacobian[: len(P_pred)], 0.0)
        cross = P_pred @ H.swapaxes(1, 2)
        S = H @ cross
        n_outputs, n_states = H.shape[1:]
        each = np.arange(n_outputs)
        S[:, each, each] += np.where(self.seen, run.R, 1.0)  # missing outputs are decoupled, with a gain of zero
        Phi = np.where(self.half[:, None, None] > 0, Phi, np.eye(n_states))
        whiten = np.linalg.inv(np.linalg.cholesky(S))
        Phi_gain = Phi @ (cross @ whiten.swapaxes(1, 2) @ whiten)
        self.e = (whiten @ np.where(self.seen, run.e[rows], 0.0)[:, :, None])[self.seen][:, 0]
        self.t = np.repeat(record.t[rows], self.seen.sum(axis=1))
        # From state, rates and outputs to the next state and to the whitened innovations.
        self.operators = np.zeros((len(Phi), n_states + n_outputs, 2 * n_states + n_outputs))
        self.operators[:, :n_states, :n_states] = Phi - Phi_gain @ H  # from one prediction to the next
        self.operators[:, :n_states, n_states : 2 * n_states] = self.half[:, None, None] * Phi
        self.operators[:, :n_states, 2 * n_states :] = -Phi_gain
        self.operators[:, n_states:, :n_states] = -whiten @ H
        self.operators[:, n_states:, 2 * n_states :] = -whiten
        number = np.cumsum(self.seen).reshape(self.seen.shape) - 1
        self.at = np.where(self.seen, number, NOWHERE)
        self.n_states = n_states
        self.end = np.zeros((n_states, 0))

    def __call__(self, columns: Sequence[SensitivityColumns], begin: Array | None = None) -> Array:
        """Whitened sensitivities of the innovations (n_samples, n_columns), of all the candidates' parameters.

        The columns may have one row more, at which the last interval ends; ``begin`` (n_states, n_columns):
        sensitivities of the state before the rows, none at the start of a record.
        """
        drive, touched, width = self._together(columns)
        first = np.zeros((self.n_states, drive.shape[2]))
        if begin is not None:
            first[:, :width] = begin
        found = np.empty((self.e.size, drive.shape[2]))
        rates = touched[touched < self.n_states]
        end = apply_rows(self.operators, drive, touched, self.half, rates, first, self.at, found)
        self.end = end[:, :width].copy()
        return found[:, :width]

    def _together(self, columns: Sequence[SensitivityColumns]) -> tuple[Array, NDArray[np.int64], int]:
        """Sensitivities of all candidates (n_rows + 1, n_touched, at least n_columns), zero where they end, the rates
        and outputs that they touch, and n_columns."""
        every = np.arange(self.n_states + self.seen.shape[1])
        each = [every if c.touched is None else c.touched for c in columns]
        touched = np.unique(np.concatenate(each))
        width, n = sum(c.delta.shape[2] for c in columns), len(self.seen)
        drive, first = np.zeros((n + 1, touched.size, padded(width))), 0
        for c, own in zip(columns, each, strict=True):
            last = first + c.delta.shape[2]
            drive[: len(c.delta), np.searchsorted(touched, own), first:last] = c.delta[: n + 1]
            first = last
        return drive, touched, width


def propagate_sensitivities(
    carrier: SensitivityFilter, fitted: Array, columns: Iterable[SensitivityColumns], carried: list[Array]
) -> tuple[Array, list[SensitivityColumns]]:
    """Whitened sensitivities of the fitted parameters and then of every candidate (n_samples, n_columns), in batches.

    ``carried``: those of the state before the rows, batch by batch, empty at the start of a record; then those after.
    The candidates are returned without their columns: those of the whole catalogue would fill the memory.
    """
    parts, slim, ends = [], [], list[Array]()
    waiting, width = [SensitivityColumns("fitted", fitted)], fitted.shape[2]

    def done() -> None:
        parts.append(carrier(waiting, carried[len(ends)] if carried else None))
        ends.append(carrier.end)

    for c in columns:
        if width + c.delta.shape[2] > N_COLUMNS:  # one more would be worked on as a whole vector of them
            done()
            waiting, width = [], 0
        waiting.append(c)
        width += c.delta.shape[2]
        slim.append(replace(c, delta=c.delta[:0].copy()))
    done()
    carried[:] = ends
    return np.concatenate(parts, axis=1), slim


@dataclass(frozen=True)
class PriorTerms:
    """What the priors of the fitted parameters add to the normal equations (n_fitted,): the gradient of their log
    density at the estimate, and their information."""

    gradient: Array
    information: Array


def prior_terms(parameters: Sequence[Parameter], values: Array) -> PriorTerms:
    """Of the parameters, at their values (n_parameters,), in their own units."""
    gradient, information = np.zeros(len(parameters)), np.zeros(len(parameters))
    for k, (p, value) in enumerate(zip(parameters, values.tolist(), strict=True)):
        if (given := p.free_prior()) is not None:
            mean, sd = given
            slope = p.slope(value)
            gradient[k] = (mean - p.to_free(value)) / (sd**2 * slope)
            information[k] = 1.0 / (sd * slope) ** 2
    return PriorTerms(gradient, information)


def score_tests(normal: NormalEquations, prior: PriorTerms, candidates: Sequence[ColumnIndex]) -> list[Score]:
    """One score for each candidate; the first columns are the fitted parameters, of which there are as many as
    ``prior`` has. At their estimate the gradients of likelihood and prior cancel: only their sum says how far the fit
    is from its maximum.
    """
    n_fitted = prior.gradient.size
    gain = _gain(normal.information, prior.information)
    information = normal.information - normal.information[:n_fitted].T @ gain
    by_data = _gain(normal.information, np.zeros(n_fitted))
    before = np.diag(normal.information)
    left = before - np.einsum("ij,ij->j", normal.information[:n_fitted], by_data)
    tolerance = np.divide(left, before, out=np.ones_like(left), where=before > 0)
    score = normal.score - gain.T @ (normal.score[:n_fitted] + prior.gradient)
    blocks = np.concatenate(normal.blocks)
    blocks = blocks - blocks[:, :n_fitted] @ gain
    scores = [_one(c, information, score, blocks, before) for c in candidates]
    return [
        replace(s, tolerance=float(np.max(tolerance[list(c.at)])))
        for s, c in zip(scores, candidates, strict=True)
        if s is not None
    ]


def _gain(information: Array, prior: Array) -> Array:
    """Regression (n_fitted, n_columns) of all columns on the first ones, which are the fitted parameters and have
    ``prior`` information besides."""
    n_fitted = prior.size
    fitted = information[:n_fitted, :n_fitted] + np.diag(prior)
    scale = np.sqrt(np.maximum(np.diag(fitted), 1e-300))
    scaled = np.linalg.lstsq(fitted / np.outer(scale, scale), information[:n_fitted] / scale[:, None], rcond=1e-12)[0]
    gain: Array = scaled / scale[:, None]
    return gain


def _one(placed: ColumnIndex, information: Array, score: Array, blocks: Array, before: Array) -> Score | None:
    candidate, names, index = placed.columns, np.array(placed.names), np.asarray(placed.at)
    # a column that the fitted parameters explain to 1e-8 cannot be tested
    alive = np.diag(information)[index] > 1e-8 * before[index]
    if not alive.any():
        there = candidate.kind is EffectKind.CATALOGUE and bool(np.any(before[index] > 0))
        return Score(candidate.name, 0.0, index.size, 0.0, {}, candidate.scan, blocks=len(blocks)) if there else None
    index, names = index[alive], names[alive]
    info, s = information[np.ix_(index, index)], score[index]
    w, V, size = scaled_eigen(info)
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
        candidate.kind,
        candidate.curve,
        blocks=len(blocks),
    )


def whole_blocks(t: Array, block: float) -> list[slice]:
    """Rows (n_rows,) of a record in parts of some thousands, each of whole blocks of time; a short one is one part."""
    if t.size <= WHOLE:
        return [slice(0, t.size)]
    starts = np.flatnonzero(np.diff(block_index(t, block))) + 1
    edges = [0]
    for start in starts.tolist():
        if start - edges[-1] >= PART and t.size - start >= PART:
            edges.append(start)
    return [slice(*pair) for pair in pairwise([*edges, t.size])]


def block_index(t: Array, block: float = BLOCK) -> NDArray[np.int64]:
    return np.floor(t / block).astype(np.int64)


def fitted_parameters(model: Model, n_records: int) -> list[Parameter]:
    """The fitted dynamic parameters: shared, then those of each record."""
    noise = model.noises  # their score is uncorrelated with that of the mean
    mean = [p for p in model.parameters if p.free and p.name not in noise]
    shared = [p for p in mean if not p.per_record]
    return shared + [replace(p, segment=i) for i in range(n_records) for p in mean if p.per_record]


def score_threshold(score: Score, among: Sequence[Score]) -> float:
    """Critical value of the statistic, chi-squared: `ALPHA` is shared by the parametric and the nonparametric effects,
    and by the tests of either kind ``among`` all (Bonferroni)."""
    n_tests = sum(s.generic == score.generic for s in among)
    return float(stats.chi2.isf(ALPHA / 2 / n_tests, score.df))


def score_test_passes(score: Score, among: Sequence[Score]) -> bool:
    """Whether the statistic exceeds its `threshold`, and the version from blocks agrees."""
    if score.p < P_OVERWHELMING and score.p_block < P_BLOCK_OVERWHELMING:
        return True
    return score.lm > score_threshold(score, among) and score.p_block < P_BLOCK
