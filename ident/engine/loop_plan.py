"""Plan of a kernel: a loop over rows whose body is a list of CasADi SX functions, the stages.

Arguments and results are bound by name. The kind of an array follows from its use:

- *carried*: both an argument and a result; its value passes from row to row.
- in ``rows``: a separate vector for each row.
- *constant*: any other argument.
- *summed*: any other result. It is summed over all rows, or kept for each row if the call asks for it.

An array in ``lanes`` holds ``width`` numbers for each entry, one for each lane. For example, each lane holds the
derivative by one parameter. There may be any number of groups of lanes. A stage with arrays in lanes runs once for each
group.
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
    """Stage of a plan. ``function`` runs in rows whose mask has ``bit`` set, or in every row if ``bit`` is None."""

    function: Any
    bit: int | None = None


@dataclass(frozen=True)
class Gram:
    """Stage that adds ``v v'`` over all lanes to ``result``, for each of the ``entries`` vectors v in the array
    ``source``.

    ``result`` has the shape (groups, groups, width, width). Only blocks on and above the diagonal are written.
    """

    source: str
    result: str
    entries: int
    bit: int | None = None


class Factor(NamedTuple):
    """Entry ``place`` of an array, multiplied by two if ``twice``."""

    array: str
    place: int
    twice: bool = False


@dataclass(frozen=True)
class Product:
    """Stage that computes ``result = left right`` with vectors of ``width`` numbers.

    ``left`` is a matrix (n, m) of factors. ``right`` is an array (m, stride) by rows. ``result`` is (n, stride) by
    rows. Other stages without lanes use scalars.
    """

    left: tuple[tuple[Factor, ...], ...]
    right: str
    result: str
    stride: int
    width: int
    bit: int | None = None


@dataclass(frozen=True)
class Plan:
    """Plan of a kernel, before compilation.

    Attributes
    ----------
    stages : tuple[LoopSegment | Gram | Product, ...]
        Stages in the order in which they run.
    rows, lanes : frozenset[str]
        Names of the arrays in rows, and of the arrays in lanes.
    width : int
        Number of lanes in one group.
    backward : bool
        Whether the loop runs from the last row to the first.
    """

    stages: tuple[LoopSegment | Gram | Product, ...]
    rows: frozenset[str] = frozenset()
    lanes: frozenset[str] = frozenset()
    width: int = jit.WIDTH
    backward: bool = False

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Number of entries of every argument and result, in the order of first use."""
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
        """Names of the arrays whose values pass from row to row."""
        arguments = {name for f in self.functions for name in f.name_in()}
        arguments |= {s.source for s in self.stages if isinstance(s, Gram)}
        results = {name for f in self.functions for name in f.name_out()}
        results |= {s.result for s in self.stages if isinstance(s, Product)}
        return frozenset(arguments & results) - self.rows

    @cached_property
    def summed(self) -> tuple[str, ...]:
        """Names of the results that are summed over the rows."""
        results = {name for f in self.functions for name in f.name_out()}
        return tuple(name for name in self.sizes if name in results and name not in self.rows | self.carried)

    @property
    def functions(self) -> tuple[Any, ...]:
        """CasADi functions of the stages."""
        return tuple(s.function for s in self.stages if isinstance(s, LoopSegment))

    @property
    def grams(self) -> frozenset[str]:
        """Names of the results of `Gram` stages."""
        return frozenset(s.result for s in self.stages if isinstance(s, Gram))

    @cached_property
    def layout(self) -> Layout:
        """Layout of the arrays."""
        return Layout(self.sizes, self.rows, self.lanes, self.carried, self.summed, self.grams, self.width)

    def shape(self, name: str, n_rows: int, groups: int, per_row: bool = False) -> tuple[int, ...]:
        """Return the shape of an array, as `Layout.shape`."""
        return self.layout.shape(name, n_rows, groups, per_row)


def stage(inputs: Mapping[str, Any], results: Mapping[str, Any], bit: int | None = None) -> LoopSegment:
    """Return a stage that computes SX expressions.

    Parameters
    ----------
    inputs : Mapping[str, SX]
        Symbols of the arguments, by name.
    results : Mapping[str, SX]
        Expressions of the results, by name.
    bit : int, optional
        Bit of the mask. The stage runs in rows with this bit. None: in every row.
    """
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
    """Return two stages: ``results`` without lanes, and ``tangents`` with lanes.

    Values of the first stage that the second stage needs are stored in the array ``name``. They are computed once
    instead of once in every group of lanes.

    Parameters
    ----------
    inputs, results : Mapping[str, SX]
        Symbols and expressions of the first stage.
    seeds, tangents : Mapping[str, SX]
        Symbols in lanes and expressions of the second stage.
    bit : int or None
        Bit of the mask for both stages.
    name : str
        Name of the array between the stages.
    """
    both = ca.cse([*results.values(), *tangents.values()])
    values, rest = both[: len(results)], both[len(results) :]
    rest, symbols, needed = ca.extract_parametric(rest, ca.vertcat(*inputs.values()), {"extract_trivial": True})
    first = stage(inputs, dict(zip(results, values, strict=True)) | {name: ca.vertcat(*needed)}, bit)
    second = stage({**seeds, name: ca.vertcat(*symbols)}, dict(zip(tangents, rest, strict=True)), bit)
    return first, second


def without_slow(expression: Any, constant: Any, early: Any, late: Any) -> tuple[Any, list[Any], list[Any]]:
    """Replace slow operations that depend on ``early`` and not on ``late`` by symbols.

    Parameters
    ----------
    expression : SX (n, 1)
        Column to rewrite.
    constant, early, late : SX
        Symbols of the expression: constant ones, those known in the forward pass, those known only in the backward
        pass.

    Returns
    -------
    tuple[SX, list[SX], list[SX]]
        The expression with symbols, the symbols, and the expressions that they replace.
    """
    arguments = (ca.vertcat(constant, early), late)
    f = ca.Function("f", arguments, [ca.densify(ca.cse(expression))])
    symbols: list[Any] = []
    values: list[Any] = []

    def apply(code: int, *x: tuple[Any, Any]) -> tuple[Any, Any]:
        """Return the result of an operation as it was, and with symbols for slow operations."""
        original, replaced = (operation(code, *[pair[version] for pair in x]) for version in (0, 1))
        if code in SLOW and ca.depends_on(original, early) and not ca.depends_on(original, late):
            values.append(original)
            replaced = ca.SX.sym(f"slow{len(symbols)}")
            symbols.append(replaced)
        return original, replaced

    (ends,) = instructions(f, lambda i, j: (arguments[i][j],) * 2, lambda x: (ca.SX(x),) * 2, apply)
    return ca.vertcat(*[replaced for _, replaced in ends]), symbols, values
