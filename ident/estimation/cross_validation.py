"""Blocked cross-validation: each block in time is predicted with what the others tell (Burman, Chow and Nolan 1994).

The fit without a block is one Newton step away from the fit to all (approximate leave-one-out; Beirami et al. 2017), so
that no model is fitted twice. A block begins anew, anywhere where the states of its record have been, with sensor
offsets of its own; what the nominal model has for each record (the current) is then adapted to the block, as it is to a
validation run. What an effect has for each record (a drift of the current) is not: it comes from the other blocks, or
it would be judged by its own data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from seatrial.ident.data import Record
from seatrial.ident.estimation.fisher_scoring import Bounds, Evaluation, expected_gain, solve_step
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import ROUGH, fit
from seatrial.ident.model import Model, Parameter
from seatrial.ident.numerics import Array

BLOCK_LENGTH = 12  # blocks of the model's own length (``Model.block``): a minute for a boat
FEWEST_BLOCKS, MOST_BLOCKS = 5, 8  # in time, of a record
LARGE_GAIN = 10.0  # that a step promises: beyond it the likelihood may not be quadratic, and it is looked at
HALVINGS = 6  # of such a step


@dataclass(frozen=True)
class TimeBlocks:
    """Blocks in time of some records; ``of``: the index of the record that each is a part of."""

    records: tuple[Record, ...]
    of: tuple[int, ...]


def time_blocks(
    records: Sequence[Record], block: float, starts: Sequence[Mapping[str, tuple[float, float]]]
) -> TimeBlocks:
    """Records cut into blocks in time, five to eight each, of a minute or longer where there is time enough.

    Parameters:
        block: of the model (``Model.block``) [s].
        starts: for each record ``Record.start`` of its blocks.
    """
    parts: list[Record] = []
    of: list[int] = []
    for i, (record, start) in enumerate(zip(records, starts, strict=True)):
        n = min(max(int(record.duration / (BLOCK_LENGTH * block)), FEWEST_BLOCKS), MOST_BLOCKS)
        edges = np.linspace(record.t[0], np.nextafter(record.t[-1], np.inf), n + 1).tolist()
        parts += [replace(record.part(low, high), start=start) for low, high in pairwise(edges)]
        of += [i] * n
    return TimeBlocks(tuple(parts), tuple(of))


def leave_one_block_out(
    model: Model, blocks: TimeBlocks, values: Array, parameters: Sequence[Parameter]
) -> list[Array]:
    """Estimates for each block that its own data had no part in, but for the current and the like.

    Parameters:
        model: as it was fitted.
        blocks: of the records.
        values (n_records, n_parameters): as fitted to the records, over ``model.parameters`` in order.
        parameters: those that were estimated from the records, each record's own with its ``segment``.

    Returns (n_parameters,) for each block. Raises ValueError where a block cannot be evaluated.
    """
    likelihood, index = Likelihood(model), {p.name: k for k, p in enumerate(model.parameters)}
    rows = [r.for_model(model) for r in blocks.records]
    at = np.array([values[p.segment or 0, index[p.name]] for p in parameters])
    slope = np.array([p.slope(x) for p, x in zip(parameters, at, strict=True)])
    z = np.array([p.to_free(x) for p, x in zip(parameters, at, strict=True)])
    low, high = np.array([p.free_bounds() for p in parameters]).reshape(-1, 2).T
    bounds = Bounds(low, high, np.array([p.transform == "log" for p in parameters], dtype=bool))
    given = [p.free_prior() for p in parameters]
    weight = np.array([0.0 if g is None else 1.0 / g[1] ** 2 for g in given])
    mean = np.array([0.0 if g is None else g[0] for g in given])
    places = [[k for k, p in enumerate(parameters) if p.segment in (None, i)] for i in blocks.of]
    gradients, informations = np.zeros((len(rows), z.size)), np.zeros((len(rows), z.size, z.size))
    for b, (row, own) in enumerate(zip(rows, places, strict=True)):
        score = likelihood.scores(row, values[blocks.of[b]], [parameters[k].name for k in own])
        if not (np.isfinite(score.value) and np.isfinite(score.information).all()):
            raise ValueError(f"{row.name}: the likelihood of model {model.name} cannot be evaluated")
        gradients[b, own] = slope[own] * score.gradient
        informations[b][np.ix_(own, own)] = np.outer(slope[own], slope[own]) * score.information

    def of_block(b: int, z: Array) -> Array:
        """The values that belong to a block at these coordinates (n_parameters,)."""
        found: Array = values[blocks.of[b]].copy()
        for k in places[b]:
            found[index[parameters[k].name]] = np.clip(parameters[k].from_free(float(z[k])), *parameters[k].bounds)
        return found

    def of_others(b: int, z: Array) -> float:
        others = (j for j in range(len(rows)) if j != b)
        total = sum(float(likelihood.value_by_row(rows[j], of_block(j, z)).sum()) for j in others)
        return total - 0.5 * float(weight @ (z - mean) ** 2)

    found = []
    for b, row in enumerate(rows):
        gradient = gradients.sum(axis=0) - gradients[b] - weight * (z - mean)
        information = informations.sum(axis=0) - informations[b] + np.diag(weight)
        there = Evaluation(0.0, gradient, information, np.zeros(z.size))
        step = solve_step(there, information, z, bounds, 0.0)
        if expected_gain(there, information, step) > LARGE_GAIN:
            least, tried = of_others(b, z), 0
            while not of_others(b, bounds.clip(z + step)) > least and tried < HALVINGS:
                step, tried = step / 2, tried + 1
        found.append(_adapted(model, row, of_block(b, bounds.clip(z + step))))
    return found


def _adapted(model: Model, block: Record, values: Array) -> Array:
    """The nominal model's own parameters of a record (the current) estimated from the block, all others kept."""
    of_effects = {p.name for e in model.effects if not e.kind.nuisance for p in e.parameters}
    own = [p.name for p in model.parameters if p.free and p.per_record and p.name not in of_effects]
    if not own:
        return values
    held = model.with_values(dict(zip(model.values, values.tolist(), strict=True)))
    return np.asarray(fit(held.with_free(own), [block], settings=ROUGH).record_values[0])
