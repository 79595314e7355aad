"""Score tests (Lagrange multiplier tests; Engle 1984) of all candidates at once, without a refit.

The fitted filter is linearised along its predicted trajectory. Each column has the changes of rates and outputs by one
parameter: a fitted parameter, or a parameter of a candidate at zero. The columns are propagated through the gains of
the filter. Let G be the whitened sensitivities of the innovations and e the whitened innovations. The score is
``-G' e`` and its information ``G' G``. The fitted parameters are projected out of both (Schur complement), which keeps
the significance level of the test. ``LM = s' I^-1 s`` is chi-squared.

The block-robust version takes the covariance of the score from sums over blocks of five seconds (two on the bench).
It is valid also if the innovations are not white.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.data import Record
from seatrial.ident.diagnosis.policy import DEFAULT_POLICY, SearchPolicy
from seatrial.ident.engine import NOWHERE, apply_rows, padded
from seatrial.ident.estimation import FilterResult
from seatrial.ident.model import EffectKind, ForceCurve, Model, Parameter, segment_name
from seatrial.ident.numerics import Array, chi2_isf, chi2_sf, scaled_eigen

ROBUST_BLOCK_S = 5.0  # s, block length of the block-robust version
N_COLUMNS = 96  # columns propagated at once; they fit the cache of the processor
WHOLE, PART = 8192, 2048  # rows: a record longer than the first is processed in parts of at least the second


@dataclass(frozen=True)
class SensitivityColumns:
    """Sensitivities of a candidate effect along one record: d(state rates, outputs) per unit of each parameter.

    Attributes
    ----------
    name
        Name of the candidate.
    delta : Array (n_rows, n_touched, n_parameters)
        Sensitivities of the affected state rates and outputs.
    parameters
        Names of the parameters, empty for a nonparametric curve.
    scan
        Values of the scanned parameters by name.
    kind, curve
        Kind of the effect, and its force and variables for a nonparametric candidate (None otherwise).
    one_sided
        Whether the first parameter can only be positive.
    per_record
        Whether the parameters have their own value in each record.
    touched : Array (n_touched,)
        Indices of the affected state rates and outputs among all, rates first. None if all are affected.
    """

    name: str
    delta: Array
    parameters: tuple[str, ...] = ()
    scan: dict[str, float] = field(default_factory=dict)
    kind: EffectKind = EffectKind.CATALOGUE
    curve: ForceCurve | None = None
    one_sided: bool = False
    per_record: bool = False
    touched: NDArray[np.int64] | None = None


@dataclass(frozen=True)
class ColumnIndex:
    """Indices of the columns of a candidate in the normal equations. Each column belongs to one parameter.

    Attributes
    ----------
    columns
        Sensitivities of the candidate.
    at
        Indices of its columns. Per-record parameters have one set of columns for each record, record after record.
    """

    columns: SensitivityColumns
    at: tuple[int, ...]

    def of_record(self, i: int) -> tuple[int, ...]:
        """Return the indices of the columns to which record i (from 0) contributes.

        These are all columns of the candidate, or for per-record parameters only those of this record.
        """
        if not self.columns.per_record:
            return self.at
        size = self.columns.delta.shape[2]
        return self.at[i * size : (i + 1) * size]

    @property
    def names(self) -> list[str]:
        """Names of the columns: ``NAME`` of the parameter, or ``NAME@i`` for a per-record parameter in record i.

        The names of one record follow those of the record before. The columns of a nonparametric curve are called
        ``CANDIDATE[i]``, with i from 0.
        """
        c, size = self.columns, self.columns.delta.shape[2]
        names = list(c.parameters) or [f"{c.name}[{i}]" for i in range(size)]
        records = range(len(self.at) // size)
        return [segment_name(n, i) for i in records for n in names] if c.per_record else names


def assign_columns(columns: Sequence[SensitivityColumns], first: int, n_records: int) -> tuple[list[ColumnIndex], int]:
    """Assign consecutive columns of the normal equations to every candidate.

    Parameters
    ----------
    columns
        Sensitivities of the candidates.
    first
        Index of the first free column.
    n_records
        Number of records. Per-record parameters get one set of columns for each record.

    Returns
    -------
    indices
        Column indices of every candidate.
    total
        Index of the first column that is free afterwards, which is the total number of columns.
    """
    places = []
    for c in columns:
        size = c.delta.shape[2] * (n_records if c.per_record else 1)
        places.append(ColumnIndex(c, tuple(range(first, first + size))))
        first += size
    return places, first


@dataclass(frozen=True)
class Score:
    """Result of the score test of one candidate.

    Attributes
    ----------
    name
        Name of the candidate.
    lm
        Statistic (Lagrange multiplier), chi-squared without the effect.
    df
        Degrees of freedom: number of parameters that can be tested, without those that depend linearly on others. If
        none can be tested, the number of all parameters.
    lm_block
        Block-robust statistic with the same degrees of freedom.
    step
        One-step estimate of each parameter by name, in the units of the parameters. Parameters that the fitted
        parameters explain are left out. For ``waves``, initial values of the refit that are not estimates.
    scan
        Values of the scanned parameters by name.
    kind, curve
        Kind of the tested effect, and its force and variables for nonparametric candidates (None otherwise).
    threshold
        Critical value of ``lm`` among all tests of the same model, NaN until it is set.
    blocks
        Number of blocks of time, an upper limit of ``lm_block`` for any size of the effect. Infinite for ``waves``.
    tolerance
        Share of the information that the fitted parameters do not explain, without priors, 0 to 1 (1 / variance
        inflation factor). It is the largest share among the parameters of the candidate.
    information
        Information of each parameter of ``step`` that the fitted parameters do not explain, with the other parameters
        of the candidate at zero [1/unit²]. Empty for ``waves``.
    """

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
    information: dict[str, float] = field(default_factory=dict)

    def least_blocks(self, policy: SearchPolicy = DEFAULT_POLICY) -> int:
        """Return the smallest number of blocks with which the block-robust test can pass at ``policy.block_level``.

        The block-robust statistic cannot exceed the number of blocks. To pass, the statistic has to exceed the quantile
        of chi-squared with ``df`` degrees of freedom at that significance level. The weaker level for overwhelming
        evidence (`score_test_passes`) needs fewer blocks.
        """
        return int(np.ceil(chi2_isf(policy.block_level, self.df)))

    @property
    def nonparametric(self) -> bool:
        """Whether the candidate is nonparametric: a curve, or a lagged or resonant response, without a formula."""
        return self.kind.nonparametric

    @property
    def p(self) -> float:
        """Probability of a statistic of at least ``lm`` without the effect (p value)."""
        return float(chi2_sf(self.lm, self.df))

    @property
    def p_block(self) -> float:
        """Probability of a block-robust statistic of at least ``lm_block`` without the effect (p value)."""
        return float(chi2_sf(self.lm_block, self.df))

    def criterion(self, n: int) -> float:
        """Return the BIC criterion ``lm - df ln n`` for n rows of estimation data; larger is better."""
        return self.lm - self.df * float(np.log(n))


class NormalEquations:
    """Normal equations of a regression of the whitened innovations on the whitened sensitivities, summed over records.

    Parameters
    ----------
    names
        Names of the columns.

    Attributes
    ----------
    names
        Names of the columns.
    information : Array (n_columns, n_columns)
        Information ``G' G`` of the sensitivities G.
    score : Array (n_columns,)
        Score ``-G' e`` with the whitened innovations e.
    blocks
        Sums of the score over each block of time: one Array (n_blocks, n_columns) for each record or part of a record.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.names = list(names)
        n = len(self.names)
        self.information, self.score = np.zeros((n, n)), np.zeros(n)
        self.blocks: list[Array] = []

    def add(self, positions: Sequence[int], g: Array | Sequence[Array], e: Array, block: NDArray[np.int64]) -> None:
        """Add the sensitivities of one record, or of one part of it, to the sums in place.

        Parameters
        ----------
        positions
            Indices of the columns of ``g`` among all columns.
        g : Array (n_samples, n_columns), or several such arrays
            Whitened sensitivities. Several arrays are as one with all their columns. They are not joined, because the
            copy takes longer than the products.
        e : Array (n_samples,)
            Whitened innovations.
        block : Array (n_samples,)
            Index of the block of time of each sample, not decreasing.
        """
        batches, at = [g] if isinstance(g, np.ndarray) else g, np.asarray(positions)
        own = np.split(at, np.cumsum([batch.shape[1] for batch in batches])[:-1])
        for i, (rows, left) in enumerate(zip(own, batches, strict=True)):
            self.information[np.ix_(rows, rows)] += left.T @ left
            for columns, right in zip(own[i + 1 :], batches[i + 1 :], strict=True):
                product = left.T @ right
                self.information[np.ix_(rows, columns)] += product
                self.information[np.ix_(columns, rows)] += product.T
        edges = [*np.flatnonzero(np.append(True, np.diff(block) > 0)).tolist(), len(e)]
        sums = np.zeros((len(edges) - 1, len(self.names)))
        for columns, batch in zip(own, batches, strict=True):
            sums[:, columns] = [-(e[first:last] @ batch[first:last]) for first, last in pairwise(edges)]
        self.score += sums.sum(axis=0)
        self.blocks.append(sums)


class SensitivityFilter:
    """Extended Kalman filter of one record, applied to sensitivities instead of samples.

    It gives the sensitivities of the whitened innovations. Samples that are missing or outliers are left out.

    Parameters
    ----------
    run
        Filter result of the record.
    record
        The record.
    jacobian : Array (n_rows or n_rows + 1, n_outputs, n_states)
        Derivatives of the outputs by the states, at the predicted states.
    rows
        Consecutive rows of the record to process, by default all.

    Attributes
    ----------
    e, t : Array (n_samples,)
        Whitened innovations and their times [s], row by row.
    end : Array (n_states, n_columns)
        Sensitivities of the state after the rows, from the last call.
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
        # operators from state, rates and outputs to the next state and to the whitened innovations
        self.operators = np.zeros((len(Phi), n_states + n_outputs, 2 * n_states + n_outputs))
        self.operators[:, :n_states, :n_states] = Phi - Phi_gain @ H  # from one predicted state to the next
        self.operators[:, :n_states, n_states : 2 * n_states] = self.half[:, None, None] * Phi
        self.operators[:, :n_states, 2 * n_states :] = -Phi_gain
        self.operators[:, n_states:, :n_states] = -whiten @ H
        self.operators[:, n_states:, 2 * n_states :] = -whiten
        number = np.cumsum(self.seen).reshape(self.seen.shape) - 1
        self.at = np.where(self.seen, number, NOWHERE)
        self.n_states = n_states
        self.end = np.zeros((n_states, 0))
        self._drive = np.zeros(0)  # memory for the joined sensitivities of a batch

    def __call__(self, columns: Sequence[SensitivityColumns], begin: Array | None = None) -> Array:
        """Return the whitened sensitivities of the innovations, Array (n_samples, n_columns), and set ``end``.

        Parameters
        ----------
        columns
            Sensitivities of the candidates. They may have one row more, at which the last interval ends.
        begin : Array (n_states, n_columns)
            Sensitivities of the state before the rows, None (zero) at the start of a record.
        """
        drive, touched, width = self._joined_sensitivities(columns)
        first = np.zeros((self.n_states, drive.shape[2]))
        if begin is not None:
            first[:, :width] = begin
        found = np.empty((self.e.size, drive.shape[2]))
        rates = touched[touched < self.n_states]
        end = apply_rows(self.operators, drive, touched, self.half, rates, first, self.at, found)
        self.end = end[:, :width].copy()
        return found[:, :width]

    def _joined_sensitivities(self, columns: Sequence[SensitivityColumns]) -> tuple[Array, NDArray[np.int64], int]:
        """Join the sensitivities of all candidates in one array, which the next call overwrites.

        Returns
        -------
        drive : Array (n_rows + 1, n_touched, n_padded)
            Sensitivities, zero after the last row of a candidate. Columns of zeros are appended so that the columns
            fill whole vectors of the processor.
        touched : Array (n_touched,)
            Indices of the affected state rates and outputs among all.
        width
            Number of columns without the appended ones.
        """
        every = np.arange(self.n_states + self.seen.shape[1])
        each = [every if c.touched is None else c.touched for c in columns]
        touched = np.unique(np.concatenate(each))
        width, n = sum(c.delta.shape[2] for c in columns), len(self.seen)
        shape = n + 1, touched.size, padded(width)
        if self._drive.size < math.prod(shape):
            self._drive = np.zeros(math.prod(shape))
        drive, first = self._drive[: math.prod(shape)].reshape(shape), 0
        drive.fill(0.0)  # faster than new memory for each batch
        for c, indices in zip(columns, each, strict=True):
            last = first + c.delta.shape[2]
            drive[: len(c.delta), np.searchsorted(touched, indices), first:last] = c.delta[: n + 1]
            first = last
        return drive, touched, width


def propagate_sensitivities(
    carrier: SensitivityFilter, fitted: Array, columns: Iterable[SensitivityColumns], carried: list[Array]
) -> tuple[list[Array], list[SensitivityColumns]]:
    """Return the whitened sensitivities of the innovations to the fitted parameters, and then to every candidate.

    They are computed in batches of at most 96 columns, unless a single candidate, or the fitted parameters, have more.

    Parameters
    ----------
    carrier
        Filter of the record.
    fitted : Array (n_rows, n_states + n_outputs, n_fitted)
        Sensitivities of rates and outputs to the fitted parameters.
    columns
        Sensitivities of the candidates.
    carried
        Sensitivities of the state before the rows, batch by batch; empty at the start of a record. The list is replaced
        in place by those after the rows.

    Returns
    -------
    g : list of Array (n_samples, n_columns)
        Whitened sensitivities, batch by batch.
    candidates
        The candidates with an empty ``delta``. The sensitivities of the whole catalogue would fill the memory.
    """
    parts, slim, ends = [], [], list[Array]()
    waiting, width = [SensitivityColumns("fitted", fitted)], fitted.shape[2]

    def done() -> None:
        """Propagate the waiting columns as one batch; append the results to ``parts`` and ``ends``."""
        parts.append(carrier(waiting, carried[len(ends)] if carried else None))
        ends.append(carrier.end)

    for c in columns:
        if width + c.delta.shape[2] > N_COLUMNS:  # columns are padded to whole vectors, so a batch is not exceeded
            done()
            waiting, width = [], 0
        waiting.append(c)
        width += c.delta.shape[2]
        slim.append(replace(c, delta=c.delta[:0].copy()))
    done()
    carried[:] = ends
    return parts, slim


@dataclass(frozen=True)
class PriorTerms:
    """Contribution of the priors of the fitted parameters to the normal equations. Both terms are 0 without a prior.

    Attributes
    ----------
    gradient : Array (n_fitted,)
        Gradient of the log density of the priors at the estimate [1/unit of the parameter].
    information : Array (n_fitted,)
        Information of the priors, 1 / variance [1/unit²].
    """

    gradient: Array
    information: Array


def prior_terms(parameters: Sequence[Parameter], values: Array) -> PriorTerms:
    """Return the gradient and the information of the priors of fitted parameters at their estimates.

    Both are in the units of the parameters, also for a prior on a log scale, and 0 for a parameter without a prior.

    Parameters
    ----------
    parameters
        Fitted parameters, of which some have a prior.
    values : Array (n_parameters,)
        Estimate of each parameter.
    """
    gradient, information = np.zeros(len(parameters)), np.zeros(len(parameters))
    for k, (p, value) in enumerate(zip(parameters, values.tolist(), strict=True)):
        if (prior := p.free_prior()) is not None:
            mean, sd = prior
            slope = p.slope(value)
            gradient[k] = (mean - p.to_free(value)) / (sd**2 * slope)
            information[k] = 1.0 / (sd * slope) ** 2
    return PriorTerms(gradient, information)


@dataclass(frozen=True)
class ScoreEquations:
    """Normal equations from which the score tests of all candidates on one fitted model are computed.

    Attributes
    ----------
    normal
        Normal equations. The first columns are the fitted parameters.
    prior
        Prior terms of the fitted parameters.
    indices
        Columns of the candidates.
    parameters
        Full names of the fitted parameters.
    """

    normal: NormalEquations
    prior: PriorTerms
    indices: tuple[ColumnIndex, ...]
    parameters: tuple[str, ...]

    @cached_property
    def coefficients_on_fitted(self) -> Array:
        """Coefficients (n_fitted, n_columns) of the regression of all columns on those of the fitted parameters.

        They are the change of each estimate, with opposite sign, per unit of the parameter of a column.
        """
        return _coefficients_on_fitted(self.normal.information, self.prior.information)

    @cached_property
    def projected(self) -> tuple[Array, Array]:
        """Information (n_columns, n_columns) and score (n_columns,), with the fitted parameters projected out.

        The part of each column that the fitted parameters explain is thus removed.
        """
        n_fitted, gain = self.prior.gradient.size, self.coefficients_on_fitted
        information = self.normal.information - self.normal.information[:n_fitted].T @ gain
        return information, self.normal.score - gain.T @ (self.normal.score[:n_fitted] + self.prior.gradient)

    def columns_of(self, name: str, scan: Mapping[str, float]) -> dict[str, int]:
        """Return the index of each column of a candidate by the name of the column; empty if it has none.

        ``scan`` are the values of its scanned parameters by name.
        """
        placed = next((i for i in self.indices if i.columns.name == name and i.columns.scan == scan), None)
        return {} if placed is None else dict(zip(placed.names, placed.at, strict=True))

    def shifts(self, name: str, scan: Mapping[str, float], step: Mapping[str, float]) -> dict[str, float]:
        """Return the change of each estimate, by full name, if a candidate enters the model with the given values.

        Empty if the equations have no columns of this candidate.

        Parameters
        ----------
        name, scan
            Name of the candidate, and the values of its scanned parameters by name.
        step
            Values of its parameters by the name of their column, as changes from those of the candidate. Names without
            a column are ignored.
        """
        placed = self.columns_of(name, scan)
        at = [k for n, k in placed.items() if n in step]
        change = -self.coefficients_on_fitted[:, at] @ np.array([step[n] for n in placed if n in step])
        return dict(zip(self.parameters, change.tolist(), strict=True)) if at else {}

    def one_step(self, at: NDArray[np.int64], weight: Array) -> Array:
        """Return the estimates of some parameters of candidates after one Newton step from zero, without a refit.

        Parameters
        ----------
        at : Array (n,)
            Columns of the parameters. Linearly dependent columns share an estimate (least squares).
        weight : Array (n,)
            Information of their priors [1/unit²], 0 without a prior.

        Returns
        -------
        Array (n,)
            Estimates in the units of the parameters. All fitted parameters are estimated anew at the same time.
        """
        information, score = self.projected
        own = information[np.ix_(at, at)] + np.diag(weight)
        size = np.sqrt(np.maximum(np.diag(own), 1e-300))
        step: Array = np.linalg.lstsq(own / np.outer(size, size), score[at] / size, rcond=1e-10)[0] / size
        return step


def score_tests(normal: NormalEquations, prior: PriorTerms, candidates: Sequence[ColumnIndex]) -> list[Score]:
    """Compute the score test of each candidate.

    Parameters
    ----------
    normal
        Normal equations. The first columns are the fitted parameters.
    prior
        Prior terms of the fitted parameters.
    candidates
        Columns of the candidates.

    Returns
    -------
    list of Score
        One score for each candidate that can be tested, in the order of the candidates. If the fitted parameters
        explain every column of a candidate, it has a score of zero if it is a named effect that acts on the data,
        and is left out otherwise. The critical values (``threshold``) are not set.

    Notes
    -----
    At the estimate the gradients of likelihood and prior cancel. Only their sum shows how far the fit is from its
    maximum.
    """
    n_fitted = prior.gradient.size
    gain = _coefficients_on_fitted(normal.information, prior.information)
    information = normal.information - normal.information[:n_fitted].T @ gain
    by_data = _coefficients_on_fitted(normal.information, np.zeros(n_fitted))
    before = np.diag(normal.information)
    left = before - np.einsum("ij,ij->j", normal.information[:n_fitted], by_data)
    tolerance = np.divide(left, before, out=np.ones_like(left), where=before > 0)
    score = normal.score - gain.T @ (normal.score[:n_fitted] + prior.gradient)
    blocks = np.concatenate(normal.blocks)
    blocks = blocks - blocks[:, :n_fitted] @ gain
    scores = [_candidate_score(c, information, score, blocks, before) for c in candidates]
    return [
        replace(s, tolerance=float(np.max(tolerance[list(c.at)])))
        for s, c in zip(scores, candidates, strict=True)
        if s is not None
    ]


def _coefficients_on_fitted(information: Array, prior: Array) -> Array:
    """Return the coefficients (n_fitted, n_columns) of the regression of all columns on the fitted parameters.

    The fitted parameters are the first n_fitted columns of ``information`` (n_columns, n_columns). ``prior``
    (n_fitted,) is added to the diagonal of their information. Linearly dependent parameters share a coefficient (least
    squares).
    """
    n_fitted = prior.size
    fitted = information[:n_fitted, :n_fitted] + np.diag(prior)
    scale = np.sqrt(np.maximum(np.diag(fitted), 1e-300))
    scaled = np.linalg.lstsq(fitted / np.outer(scale, scale), information[:n_fitted] / scale[:, None], rcond=1e-12)[0]
    gain: Array = scaled / scale[:, None]
    return gain


def _candidate_score(
    placed: ColumnIndex, information: Array, score: Array, blocks: Array, before: Array
) -> Score | None:
    """Return the score of one candidate, without tolerance and threshold.

    Parameters
    ----------
    placed
        Candidate with its column indices.
    information : Array (n_columns, n_columns)
        Information with the fitted parameters projected out.
    score : Array (n_columns,)
        Score with the fitted parameters projected out.
    blocks : Array (n_blocks, n_columns)
        Sums of that score over the blocks of time.
    before : Array (n_columns,)
        Information of each column before the projection.

    Returns
    -------
    Score or None
        If the fitted parameters explain every column of the candidate: zero statistics for a named effect that acts on
        the data, None otherwise. The statistics are also zero if a one-sided candidate has a negative estimate of
        its first parameter that can be tested. A column that is explained to 1e-8 is left out; so are combinations of
        columns that depend on others. For a difference between runs, only deviations from the mean are tested.
    """
    candidate, names, index = placed.columns, np.array(placed.names), np.asarray(placed.at)
    # a column that the fitted parameters explain to 1e-8 cannot be tested
    alive = np.diag(information)[index] > 1e-8 * before[index]
    is_difference = candidate.kind is EffectKind.BETWEEN_RUNS
    if alive.sum() < 1 + is_difference:
        # a catalogue effect gets a score of zero, so that it can be reported as explained by the fitted parameters
        report = candidate.kind is EffectKind.CATALOGUE and bool(np.any(before[index] > 0))
        return Score(candidate.name, 0.0, index.size, 0.0, {}, candidate.scan, blocks=len(blocks)) if report else None
    index, names = index[alive], names[alive]
    info, s, by_block = information[np.ix_(index, index)], score[index], blocks[:, index]
    center = np.eye(index.size)
    if is_difference:  # it has one parameter
        # A change of all runs together is no difference between them. For the thrust it would be the scale of all
        # forces, which filter gains that are held fixed describe badly: its statistic was 289, its refit gained 1.
        shared = info.sum(axis=0)
        if shared.sum() > 1e-9 * np.trace(info):
            gain = shared / shared.sum()
            info, s = info - np.outer(shared, gain), s - gain * s.sum()
            by_block = by_block - np.outer(by_block.sum(axis=1), gain)
        center -= 1.0 / index.size
    # Of a difference, one run can have all information: its rest has none, and must not be divided by its size.
    floor = 1e-12 * float(np.trace(info)) if is_difference else 0.0
    if is_difference and not floor > 0.0:
        return None
    w, V, size = scaled_eigen(info, floor)
    keep = w > 1e-6
    z = (V.T @ (s / size))[keep]
    lm, df = float(np.sum(z * z / w[keep])), int(keep.sum())
    step = center @ ((V[:, keep] @ (z / w[keep])) / size)
    B = by_block / size @ V[:, keep]
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
        information=dict(zip(names.tolist(), np.diag(info).tolist(), strict=True)),
    )


def whole_blocks(t: Array, block: float) -> list[slice]:
    """Split the rows of a record into consecutive parts that do not divide a block of time.

    Parameters
    ----------
    t : Array (n_rows,)
        Times of the rows [s].
    block
        Length of a block of time [s].

    Returns
    -------
    list of slice
        The parts from the first row to the last. A record of up to 8192 rows is one part. Otherwise each part has at
        least 2048 rows, and each later part begins with the first row of a block.
    """
    if t.size <= WHOLE:
        return [slice(0, t.size)]
    starts = np.flatnonzero(np.diff(block_index(t, block))) + 1
    edges = [0]
    for start in starts.tolist():
        if start - edges[-1] >= PART and t.size - start >= PART:
            edges.append(start)
    return [slice(*pair) for pair in pairwise([*edges, t.size])]


def block_index(t: Array, block: float = ROBUST_BLOCK_S) -> NDArray[np.int64]:
    """Return the index of the block of time of each time t (n,) [s]: t / block, rounded down. ``block`` is in s."""
    return np.floor(t / block).astype(np.int64)


def fitted_parameters(model: Model, n_records: int) -> list[Parameter]:
    """Return the estimated parameters of a model except those of the noise: the shared ones, then those of each record.

    A per-record parameter is listed once for each record, with the index of the record as its ``segment``.

    Parameters
    ----------
    model
        Fitted model.
    n_records
        Number of estimation records.
    """
    noise = model.noises  # their score is uncorrelated with that of the other parameters
    mean = [p for p in model.parameters if p.free and p.name not in noise]
    shared = [p for p in mean if not p.per_record]
    return shared + [replace(p, segment=i) for i in range(n_records) for p in mean if p.per_record]


def score_threshold(score: Score, among: Sequence[Score], policy: SearchPolicy = DEFAULT_POLICY) -> float:
    """Return the critical value of a score test: the quantile of chi-squared with ``score.df`` degrees of freedom.

    Parameters
    ----------
    score
        Score of the candidate.
    among
        All scores of the same model, with ``score``. One half of ``policy.false_alarm_probability`` is for the
        parametric candidates and one half for the nonparametric ones. All tests of one half share it equally
        (Bonferroni).
    policy
        Thresholds of the score tests.
    """
    own = score.nonparametric
    n_tests = sum(s.nonparametric == own for s in among)
    return float(chi2_isf(policy.false_alarm_probability / 2 / n_tests, score.df))


def score_test_passes(score: Score, among: Sequence[Score], policy: SearchPolicy = DEFAULT_POLICY) -> bool:
    """Return whether a candidate passes its score test.

    Both of these have to hold: the statistic exceeds `score_threshold`, and the p value of the block-robust statistic
    is below ``policy.block_level``. Overwhelming evidence (a p value below ``policy.overwhelming_p``) passes with the
    weaker level ``policy.overwhelming_block_level``.

    Parameters
    ----------
    score
        Score of the candidate.
    among
        All scores of the same model, with ``score``.
    policy
        Thresholds of the score tests.
    """
    if score.p < policy.overwhelming_p and score.p_block < policy.overwhelming_block_level:
        return True
    return score.lm > score_threshold(score, among, policy) and score.p_block < policy.block_level
