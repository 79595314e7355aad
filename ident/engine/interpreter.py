"""Interpreter of plans, the reference for compiled kernels.

A plan describes a kernel, a program that runs over all rows of a record, as a list of stages (steps in each row).
CasADi evaluates every stage, row by row, which is slow.
"""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Set as AbstractSet

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.engine.loop_plan import (
    AddOuterProductStage,
    AddProductsStage,
    AddTransposedStage,
    CombinationStage,
    ExpressionStage,
    GramStage,
    MatrixStage,
    Plan,
    ProductStage,
    SingleCopyStage,
    TransposeStage,
)
from seatrial.ident.numerics import Array

Mask = NDArray[np.uint32]


def interpret(
    plan: Plan, n_rows: int, groups: int, mask: Mask, arrays: Mapping[str, Array], per_row: AbstractSet[str]
) -> None:
    """Run a plan over all rows of a record with CasADi's own evaluation, without compilation.

    The results are those of the compiled kernel, except for rounding.

    Parameters
    ----------
    plan : Plan
        Stages (steps in each row) of the computation, and kinds of the arrays.
    n_rows, groups : int
        Number of rows, and number of groups of ``plan.width`` lanes. A lane is one element of an array that has several
        numbers for each entry, for example the derivative by one parameter.
    mask : Array (n_rows,) of uint32
        Bits of the stages that run in each row. A stage with ``bit`` None runs in every row.
    arrays : Mapping[str, Array]
        Contiguous arrays of all arguments and results by name, with the number of items of ``plan.shape``. Results are
        written in place: sums are added to the present values, other results are overwritten.
    per_row : Set[str]
        Names of summed results of which the contribution of each row is wanted instead of the sum. Their arrays have
        entries for each row, to which the contributions are added.
    """
    shaped = {name: a.reshape(plan.shape(name, n_rows, groups, name in per_row)) for name, a in arrays.items()}
    order = range(n_rows - 1, -1, -1) if plan.backward else range(n_rows)
    for row in order:
        now = {name: a[row] if name in plan.rows or name in per_row else a for name, a in shaped.items()}
        for stage in plan.stages:
            if stage.bit is not None and not int(mask[row]) >> stage.bit & 1:
                continue
            if isinstance(stage, GramStage):
                _run_gram_stage(stage, now, groups)
            elif isinstance(stage, ProductStage):
                _run_product_stage(stage, now)
            elif isinstance(stage, MatrixStage):
                _run_matrix_stage(stage, now)
            else:
                _run_expression_stage(plan, stage, now, groups)


def _run_expression_stage(plan: Plan, stage: ExpressionStage, now: Mapping[str, Array], groups: int) -> None:
    """Evaluate one stage of CasADi expressions in one row, and write its results into the arrays ``now`` of this row.

    The stage is evaluated once. If it has arrays in lanes (``plan.width`` numbers for each entry), it is evaluated for
    each lane of all ``groups``. A summed result is added to its array, another result overwrites it.
    """
    f = stage.function
    names_in, names_out = f.name_in(), f.name_out()
    if plan.lanes.isdisjoint([*names_in, *names_out]):
        for name, value in zip(names_out, f.call([now[name] for name in names_in]), strict=True):
            _store_result(plan, name, now[name], np.array(value).ravel())
        return
    for group in range(groups):
        for lane in range(plan.width):
            lane_arrays = {name: now[name][group, :, lane] if name in plan.lanes else now[name] for name in now}
            for name, value in zip(
                names_out, f.call([lane_arrays[name].astype(float) for name in names_in]), strict=True
            ):
                _store_result(plan, name, lane_arrays[name], np.array(value).ravel())


def _store_result(plan: Plan, name: str, target: Array, value: Array) -> None:
    """Add ``value`` to the array ``target`` in place if the result ``name`` is summed; otherwise overwrite it.

    Both arrays have the shape (entries,). Results that the caller wants for each row are added, too.
    """
    if name in plan.summed:
        target += value
    else:
        target[...] = value


def _run_gram_stage(stage: GramStage, now: Mapping[str, Array], groups: int) -> None:
    """Add the inner products of all pairs of lanes in one row to the result matrix of a Gram stage, in place.

    ``now`` has the arrays of the row by name. ``groups`` is the number of groups of ``plan.width`` lanes. The result
    has the shape (groups, groups, width, width); only its blocks on and above the diagonal are written.
    """
    v = now[stage.source]
    for first in range(groups):
        for second in range(first, groups):
            now[stage.result][first, second] += v[first].T @ v[second]


def _run_product_stage(stage: ProductStage, now: Mapping[str, Array]) -> None:
    """Compute the matrix product of a stage in one row, and write it into its result array among the arrays ``now``.

    The old values of the result are overwritten.
    """
    left = [[(1 + factor.twice) * now[factor.array][factor.entry] for factor in row] for row in stage.left]
    now[stage.result][:] = (np.array(left) @ now[stage.right].reshape(-1, stage.stride)).ravel()


def _run_matrix_stage(stage: MatrixStage, now: Mapping[str, Array]) -> None:
    """Compute a stage on matrices in one row, for all groups of lanes, and write its result among the arrays ``now``.

    An array in lanes has the shape (groups, entries, width), another array (entries,).
    """
    into = now[stage.result]
    if isinstance(stage, CombinationStage):
        _run_combination_stage(stage, now)
    elif isinstance(stage, AddProductsStage):
        n, a, w = stage.n, now[stage.lanes], now[stage.scalars][stage.first : stage.first + stage.n]
        product = a[:, :, None] * w[None, None, :, None]
        into[:] += (product + product.swapaxes(1, 2)).reshape(len(a), n * n, -1)
    elif isinstance(stage, AddTransposedStage):
        square = now[stage.matrix].reshape(len(into), stage.n, stage.n, -1)
        into[:] = (square + square.swapaxes(1, 2)).reshape(into.shape)
    elif isinstance(stage, AddOuterProductStage):
        into += np.outer(now[stage.column], now[stage.row]).ravel()
    elif isinstance(stage, SingleCopyStage):
        into[:] = now[stage.matrix]
    elif isinstance(stage, TransposeStage):
        n, square = stage.n, now[stage.matrix].reshape(stage.n, stage.stride)[:, : stage.n]
        mirrored = np.triu(square) + np.triu(square, 1).T if stage.result == stage.matrix else square.T
        into.reshape(n, stage.stride)[:, :n] = mirrored
    else:
        in_lanes = into.ndim == 3
        for source, target in stage.entries:
            if in_lanes:
                into[:, target] += now[stage.source][:, source]
            else:
                into[target] += now[stage.source][source]


def _run_combination_stage(stage: CombinationStage, now: Mapping[str, Array]) -> None:
    """Combine rows of matrices linearly in one row of the record, for all groups, as `CombinationStage` describes it.

    An array in lanes has the shape (groups, entries, width), another array (entries,).
    """
    n, scalars, matrix, into = stage.n, now[stage.scalars], now[stage.matrix], now[stage.result]
    matrix = matrix if matrix.ndim == 3 else matrix[None, :, None]
    found = np.zeros((len(matrix), len(stage.by_scalars), n, matrix.shape[2]))
    for r, (first, second) in enumerate(zip(stage.by_lanes, stage.by_scalars, strict=True)):
        for factor, at in first:
            found[:, r] += now[stage.lanes][:, factor, None] * now[stage.rows][None, at : at + n, None]
        for factor, line in second:
            found[:, r] += scalars[factor] * matrix[:, line * n : (line + 1) * n]
    into[...] = (found.swapaxes(1, 2) if stage.transposed else found).reshape(into.shape)
