"""What a kernel computes: a loop over rows whose body is a list of CasADi SX functions, the stages.

Arguments and results are bound by name. A name that is both an argument and a result is *carried* from row
to row; one in ``rows`` has a line of its own for each row; other arguments are *constant*; other results are
*summed*, over all rows or, where a call asks for it, each row for itself. A name in ``lanes`` holds ``width``
numbers for each entry, one a lane (a parameter to differentiate by, for one), and there may be any number of
groups of lanes: a stage that touches lanes runs once for each group.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca

from seatrial.ident.engine import jit
from seatrial.ident.engine.array_layout import Layout
from seatrial.ident.engine.expressions import instructions, operation
from seatrial.ident.engine.llvm_operations import SLOW


@dataclass(frozen=True)
class LoopSegment:
    """``function`` runs in rows whose mask has ``bit`` set, or in every row."""

    function: Any
    bit: int | None = None


@dataclass(frozen=True)
class Gram:
    """Adds ``v v'`` over all lanes to ``result`` for each of the ``entries`` v of the lanes ``source``.

    ``result`` is (groups, groups, width, width), of which only blocks on and above the diagonal are written.
    """

    source: str
    result: str
    entries: int
    bit: int | None = None


class Factor(NamedTuple):
    """Entry ``place`` of an array, or twice that."""

    array: str
    place: int
    twice: bool = False


@dataclass(frozen=True)
class Product:
    """``result = left right``: a matrix of factors (n, m) by one that stands in the array ``right`` (m, stride) by
    rows, done with vectors of ``width`` where stages have scalars."""

    left: tuple[tuple[Factor, ...], ...]
    right: str
    result: str
    stride: int
    width: int
    bit: int | None = None


@dataclass(frozen=True)
class Plan:
    """What a kernel computes, before it is compiled."""

    stages: tuple[LoopSegment | Gram | Product, ...]
    rows: frozenset[str] = frozenset()
    lanes: frozenset[str] = frozenset()
    width: int = jit.WIDTH
    backward: bool = False

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Entries of every argument and result, in the order of first use."""
        sizes: dict[str, int] = {}
        for f in self.functions:
            sizes |= {f.name_in(i): f.nnz_in(i) for i in range(f.n_in())}
            sizes |= {f.name_out(i): f.nnz_out(i) for i in range(f.n_out())}
        for part in self.stages:
            if isinstance(part, Gram):
                sizes[part.result] = self.width
            elif isinstance(part, Product):
                sizes |= {part.right: len(part.left[0]) * part.stride, part.result: len(part.left) * part.stride}
        return sizes

    @cached_property
    def carried(self) -> frozenset[str]:
        arguments = {name for f in self.functions for name in f.name_in()}
        arguments |= {s.source for s in self.stages if isinstance(s, Gram)}
        results = {name for f in self.functions for name in f.name_out()}
        results |= {s.result for s in self.stages if isinstance(s, Product)}
        return frozenset(arguments & results) - self.rows

    @cached_property
    def summed(self) -> tuple[str, ...]:
        results = {name for f in self.functions for name in f.name_out()}
        return tuple(name for name in self.sizes if name in results and name not in self.rows | self.carried)

    @property
    def functions(self) -> tuple[Any, ...]:
        return tuple(s.function for s in self.stages if isinstance(s, LoopSegment))

    @property
    def grams(self) -> frozenset[str]:
        return frozenset(s.result for s in self.stages if isinstance(s, Gram))

    @cached_property
    def layout(self) -> Layout:
        return Layout(self.sizes, self.rows, self.lanes, self.carried, self.summed, self.grams, self.width)

    def shape(self, name: str, n_rows: int, groups: int, per_row: bool = False) -> tuple[int, ...]:
        """As ``Layout.shape``."""
        return self.layout.shape(name, n_rows, groups, per_row)


def stage(inputs: Mapping[str, Any], results: Mapping[str, Any], bit: int | None = None) -> LoopSegment:
    """A stage from SX expressions by name."""
    expressions = [ca.densify(e) for e in ca.cse(list(results.values()))]
    function = ca.Function(
        "stage", list(inputs.values()), expressions, list(inputs), list(results), {"allow_duplicate_io_names": True}
    )
    return LoopSegment(function, bit)


def split(
    inputs: Mapping[str, Any],
    results: Mapping[str, Any],
    seeds: Mapping[str, Any],
    tangents: Mapping[str, Any],
    bit: int | None,
    name: str,
) -> tuple[LoopSegment, LoopSegment]:
    """Two stages: ``results`` without lanes and ``tangents`` with; ``name`` holds what the second needs of the
    first, so that it is computed once and not in every group of lanes."""
    both = ca.cse([*results.values(), *tangents.values()])
    values, rest = both[: len(results)], both[len(results) :]
    rest, symbols, needed = ca.extract_parametric(rest, ca.vertcat(*inputs.values()), {"extract_trivial": True})
    first = stage(inputs, dict(zip(results, values, strict=True)) | {name: ca.vertcat(*needed)}, bit)
    second = stage({**seeds, name: ca.vertcat(*symbols)}, dict(zip(tangents, rest, strict=True)), bit)
    return first, second


def without_slow(expression: Any, constant: Any, early: Any, late: Any) -> tuple[Any, list[Any], list[Any]]:
    """The expression (a column) with symbols for the slow operations that depend on ``early`` and not on ``late``;
    these symbols, and their values. ``constant``: what else the expression depends on."""
    given = (ca.vertcat(constant, early), late)
    f = ca.Function("f", given, [ca.densify(ca.cse(expression))])
    symbols: list[Any] = []
    values: list[Any] = []

    def apply(code: int, *x: tuple[Any, Any]) -> tuple[Any, Any]:
        """As it was, and without slow operations."""
        was, now = (operation(code, *[pair[way] for pair in x]) for way in (0, 1))
        if code in SLOW and ca.depends_on(was, early) and not ca.depends_on(was, late):
            values.append(was)
            now = ca.SX.sym(f"slow{len(symbols)}")
            symbols.append(now)
        return was, now

    (ends,) = instructions(f, lambda i, j: (given[i][j],) * 2, lambda x: (ca.SX(x),) * 2, apply)
    return ca.vertcat(*[now for _, now in ends]), symbols, values
