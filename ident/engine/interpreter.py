"""Interpreter of plans, the reference for compiled kernels.

CasADi evaluates every stage, row by row, which is slow.
"""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Set as AbstractSet

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.engine.loop_plan import Gram, LoopSegment, Plan, Product
from seatrial.ident.numerics import Array

Mask = NDArray[np.uint32]


def interpret(
    plan: Plan, n_rows: int, groups: int, mask: Mask, arrays: Mapping[str, Array], per_row: AbstractSet[str]
) -> None:
    """Run a plan in place, as the compiled kernel does.

    Parameters
    ----------
    plan : Plan
        Plan to run.
    n_rows, groups : int
        Number of rows, and number of groups of lanes.
    mask : Array (n_rows,)
        Bits of the stages that run in each row.
    arrays : Mapping[str, Array]
        Arguments and results by name; results are overwritten.
    per_row : Set[str]
        Summed results that are kept for each row.
    """
    shaped = {name: a.reshape(plan.shape(name, n_rows, groups, name in per_row)) for name, a in arrays.items()}
    order = range(n_rows - 1, -1, -1) if plan.backward else range(n_rows)
    for row in order:
        now = {name: a[row] if name in plan.rows or name in per_row else a for name, a in shaped.items()}
        for part in plan.stages:
            if part.bit is not None and not int(mask[row]) >> part.bit & 1:
                continue
            if isinstance(part, Gram):
                _gram(part, now, groups)
            elif isinstance(part, Product):
                _product(part, now)
            else:
                _stage(plan, part, now, groups)


def _stage(plan: Plan, part: LoopSegment, now: Mapping[str, Array], groups: int) -> None:
    """Evaluate one stage in one row: once, or for each lane if the stage has arrays in lanes."""
    f = part.function
    names_in, names_out = f.name_in(), f.name_out()
    if plan.lanes.isdisjoint([*names_in, *names_out]):
        for name, value in zip(names_out, f.call([now[name] for name in names_in]), strict=True):
            _store(plan, name, now[name], np.array(value).ravel())
        return
    for group in range(groups):
        for lane in range(plan.width):
            spot = {name: now[name][group, :, lane] if name in plan.lanes else now[name] for name in now}
            for name, value in zip(names_out, f.call([spot[name] for name in names_in]), strict=True):
                _store(plan, name, spot[name], np.array(value).ravel())


def _store(plan: Plan, name: str, target: Array, value: Array) -> None:
    if name in plan.summed:
        target += value
    else:
        target[...] = value


def _gram(part: Gram, now: Mapping[str, Array], groups: int) -> None:
    """Add the products of all pairs of lanes to the blocks on and above the diagonal."""
    v = now[part.source]
    for first in range(groups):
        for second in range(first, groups):
            now[part.result][first, second] += v[first].T @ v[second]


def _product(part: Product, now: Mapping[str, Array]) -> None:
    left = [[(1 + factor.twice) * now[factor.array][factor.place] for factor in line] for line in part.left]
    now[part.result][:] = (np.array(left) @ now[part.right].reshape(-1, part.stride)).ravel()
