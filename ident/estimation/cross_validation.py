"""Blocked cross-validation: each block in time of a record is predicted by the fit to the other blocks (Burman, Chow
and Nolan 1994). A block is about a minute long for a boat.

The fit without a block is approximated by one Newton step from the fit to all blocks (approximate leave-one-out;
Beirami et al. 2017), so that no model is fitted twice. A block has initial states of its own, with the spread that the
states have in its record, and sensor offsets of its own. The nominal model's per-record parameters (the current) are
then estimated from the block itself, as in a validation run. Per-record parameters of effects (a drift of the current)
come from the other blocks: otherwise the effect would be judged by its own data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from seatrial.ident.data import Record
from seatrial.ident.estimation.fisher_scoring import Bounds, Evaluation, expected_gain, solve_step
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import ROUGH_SEARCH, fit
from seatrial.ident.model import Model, Parameter
from seatrial.ident.numerics import Array

# The few per-record parameters of a block need two or three iterations. The likelihood of some effects has kinks, along
# which a search creeps.
BLOCK_SEARCH = replace(ROUGH_SEARCH, max_iterations=12)
BLOCK_LENGTH = 12  # length of a block in units of ``Model.block``: a minute for a boat
FEWEST_BLOCKS, MOST_BLOCKS = 5, 8  # number of blocks in a record
LARGE_GAIN = 10.0  # above this expected gain the likelihood may not be quadratic: the step is then checked
HALVINGS = 6  # largest number of halvings of a step that fails this check


@dataclass(frozen=True)
class TimeBlocks:
    """Blocks in time of some records, for cross-validation.

    Attributes
    ----------
    records
        Each block as a record of its own, in the order of the records and of time.
    record_indices
        For each block, the index of the record from which it was cut.
    """

    records: tuple[Record, ...]
    record_indices: tuple[int, ...]


def number_of_blocks(duration: float, block: float) -> int:
    """Return the number of blocks for cross-validation of a record, five to eight, from its duration [s].

    ``block`` is the duration [s] over which the residuals of the model may be correlated (``Model.block``).
    """
    return min(max(int(duration / (BLOCK_LENGTH * block)), FEWEST_BLOCKS), MOST_BLOCKS)


def time_blocks(
    records: Sequence[Record], block: float, starts: Sequence[Mapping[str, tuple[float, float]]]
) -> TimeBlocks:
    """Cut each record into blocks of consecutive rows, for cross-validation.

    A record gets five to eight blocks of equal duration. The number is the duration of the record divided by twelve
    times ``block``, rounded down, within these limits. Each row is in exactly one block: a row at an edge belongs to
    the later block, the last row to the last block. The name of a block has its times, as ``run[0:60]``.

    Parameters
    ----------
    records
        Records to be cut.
    block
        Duration [s] over which the residuals of the model may be correlated, 5 s for a boat (``Model.block``).
    starts
        For each record, the mean and standard deviation of each state, by name, with which its blocks start.
    """
    parts: list[Record] = []
    record_indices: list[int] = []
    for i, (record, start) in enumerate(zip(records, starts, strict=True)):
        n = number_of_blocks(record.duration, block)
        edges = np.linspace(record.t[0], np.nextafter(record.t[-1], np.inf), n + 1).tolist()
        parts += [replace(record.part(low, high), start=start) for low, high in pairwise(edges)]
        record_indices += [i] * n
    return TimeBlocks(tuple(parts), tuple(record_indices))


def leave_one_block_out(
    model: Model, blocks: TimeBlocks, values: Array, parameters: Sequence[Parameter]
) -> list[Array]:
    """Return parameter values for each block in time, from which the contribution of this block is removed.

    They are used for cross-validation. The values come from one Newton step inside the bounds from the fit to all
    blocks, with the block's contribution subtracted (approximate leave-one-out). A step that should gain more than 10
    in log-posterior is checked: while it does not raise the log-posterior of the other blocks, it is halved, at most
    six times. The sixth half is used even if it does not raise the log-posterior. Only the nominal model's per-record
    parameters (the current) are estimated from the block itself.

    Parameters
    ----------
    model
        Fitted model.
    blocks
        Blocks of the records.
    values : Array (n_records, n_parameters)
        Values fitted to the records, in the order of ``model.parameters``.
    parameters
        Estimated parameters. A per-record parameter appears once for each record, with the index of the record as its
        ``segment``.

    Returns
    -------
    list of Array (n_parameters,)
        Values for each block, in the order of ``model.parameters``.

    Raises
    ------
    ValueError
        If a block cannot be evaluated, or if the fit of its per-record parameters fails.
    """
    likelihood, index = Likelihood(model), {p.name: k for k, p in enumerate(model.parameters)}
    rows = [r.for_model(model) for r in blocks.records]
    at = np.array([values[p.segment or 0, index[p.name]] for p in parameters])
    slope = np.array([p.slope(x) for p, x in zip(parameters, at, strict=True)])
    z = np.array([p.to_free(x) for p, x in zip(parameters, at, strict=True)])
    low, high = np.array([p.free_bounds() for p in parameters]).reshape(-1, 2).T
    bounds = Bounds(low, high, np.array([p.transform == "log" for p in parameters], dtype=bool))
    priors = [p.free_prior() for p in parameters]
    weight = np.array([0.0 if g is None else 1.0 / g[1] ** 2 for g in priors])
    mean = np.array([0.0 if g is None else g[0] for g in priors])
    coordinates = [[k for k, p in enumerate(parameters) if p.segment in (None, i)] for i in blocks.record_indices]
    gradients, informations = np.zeros((len(rows), z.size)), np.zeros((len(rows), z.size, z.size))
    for b, (row, own) in enumerate(zip(rows, coordinates, strict=True)):
        score = likelihood.scores(row, values[blocks.record_indices[b]], [parameters[k].name for k in own])
        if not (np.isfinite(score.value) and np.isfinite(score.information).all()):
            raise ValueError(
                f"{row.name}: the likelihood of model {model.name} is not finite for the estimated parameters on this "
                "part of the record; check the log with `seatrial check`, or leave it out"
            )
        gradients[b, own] = slope[own] * score.gradient
        informations[b][np.ix_(own, own)] = np.outer(slope[own], slope[own]) * score.information

    def block_values(b: int, z: Array) -> Array:
        """Return the parameter values (n_parameters,) of block b for the estimator's coordinates z (n,).

        Values outside their bounds are moved onto them. Parameters that are not estimated keep their ``values``.
        """
        found: Array = values[blocks.record_indices[b]].copy()
        for k in coordinates[b]:
            found[index[parameters[k].name]] = np.clip(parameters[k].from_free(float(z[k])), *parameters[k].bounds)
        return found

    def others_log_posterior(b: int, z: Array) -> float:
        """Return the log-posterior of all blocks except b for the estimator's coordinates z (n,).

        The constants of the priors are left out. The result is NaN if the filter diverges in a block.
        """
        others = (j for j in range(len(rows)) if j != b)
        total = sum(float(likelihood.value_by_row(rows[j], block_values(j, z)).sum()) for j in others)
        return total - 0.5 * float(weight @ (z - mean) ** 2)

    found = []
    for b, row in enumerate(rows):
        gradient = gradients.sum(axis=0) - gradients[b] - weight * (z - mean)
        information = informations.sum(axis=0) - informations[b] + np.diag(weight)
        there = Evaluation(0.0, gradient, information, np.zeros(z.size))
        step = solve_step(there, information, z, bounds, 0.0)
        if expected_gain(there, information, step) > LARGE_GAIN:
            # halve the step until the log-posterior rises
            least, tried = others_log_posterior(b, z), 0
            while not others_log_posterior(b, bounds.clip(z + step)) > least and tried < HALVINGS:
                step, tried = step / 2, tried + 1
        found.append(_with_per_record_values_of_block(model, row, block_values(b, bounds.clip(z + step))))
    return found


def _with_per_record_values_of_block(model: Model, block: Record, values: Array) -> Array:
    """Estimate the nominal model's per-record parameters, such as the current, from a block; keep all other values.

    Return the values (n_parameters,), unchanged if the model has no such parameter. ValueError is raised if the fit
    fails. Per-record parameters of effects are kept, too: they must not come from the data on which the effect is
    judged.

    Parameters
    ----------
    model
        Fitted model.
    block
        The block as a record.
    values : Array (n_parameters,)
        Values for the block, in the order of ``model.parameters``.
    """
    of_effects = {p.name for e in model.effects if not e.kind.nuisance for p in e.parameters}
    own = [p.name for p in model.parameters if p.free and p.per_record and p.name not in of_effects]
    if not own:
        return values
    held = model.with_values(dict(zip(model.values, values.tolist(), strict=True)))
    return np.asarray(fit(held.with_free(own), [block], settings=BLOCK_SEARCH).record_values[0])
