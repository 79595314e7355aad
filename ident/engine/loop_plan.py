"""Plan of a kernel: a loop over the rows of a record whose body is a list of steps, the stages.

Most stages are CasADi SX functions. A row holds the samples of one instant, and the inputs up to the next row.

Arguments and results are bound by name. The kind of an array follows from its use:

- *carried*: both an argument and a result, such as the state of a filter; its value passes from row to row.
- in ``rows``: a separate vector for each row, such as the inputs.
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
from seatrial.ident.engine.expressions import evaluate_instructions, operation
from seatrial.ident.engine.llvm_operations import SLOW


@dataclass(frozen=True)
class ExpressionStage:
    """Stage of a plan that evaluates CasADi expressions.

    Attributes
    ----------
    function : casadi.Function
        Function of SX expressions. The names of its arguments and results are names of the kernel's arrays.
    bit : int or None
        The stage runs only in rows whose mask has this bit (0 to 31) set. None: in every row.
    """

    function: Any
    bit: int | None = None


@dataclass(frozen=True)
class GramStage:
    """Stage that adds the inner products between all lanes of an array to a symmetric matrix.

    The array ``source`` holds ``entries`` numbers for each lane. Element (i, j) of the matrix is increased by the sum
    over the entries of (entry in lane i) times (entry in lane j). The Fisher information is such a matrix.

    Attributes
    ----------
    source : str
        Name of the array in lanes.
    result : str
        Name of the array of the matrix, of the shape (groups, groups, width, width). Only blocks on and above the
        diagonal are written.
    entries : int
        Number of entries of ``source``.
    bit : int or None
        The stage runs only in rows whose mask has this bit (0 to 31) set. None: in every row.
    """

    source: str
    result: str
    entries: int
    bit: int | None = None


class Factor(NamedTuple):
    """Element of the left matrix of a `ProductStage`: one number of an array in the current row.

    Attributes
    ----------
    array : str
        Name of the array.
    entry : int
        Index of the number in the array.
    twice : bool
        Whether the number is multiplied by two.
    """

    array: str
    entry: int
    twice: bool = False


@dataclass(frozen=True)
class ProductStage:
    """Stage that computes the matrix product ``result = left right`` with vector instructions of the processor.

    Other stages without lanes use scalar instructions.

    Attributes
    ----------
    left : tuple[tuple[Factor, ...], ...]
        Matrix (n, m), as a tuple of its rows.
    right : str
        Name of the array that holds the right matrix (m, stride), one matrix row after the other.
    result : str
        Name of the array that receives the product (n, stride), one matrix row after the other.
    stride : int
        Number of columns of the right matrix, a multiple of ``width``.
    width : int
        Number of doubles in one vector instruction.
    bit : int or None
        The stage runs only in rows whose mask has this bit (0 to 31) set. None: in every row.
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
    stages : tuple[ExpressionStage | GramStage | ProductStage, ...]
        Stages in the order in which they run.
    rows : frozenset[str]
        Names of the arrays with a separate vector of entries for each row.
    lanes : frozenset[str]
        Names of the arrays with ``width`` numbers for each entry, one per lane.
    width : int
        Number of lanes in one group; by default the number of doubles in a vector register (2, 4 or 8).
    backward : bool
        Whether the loop runs from the last row to the first.
    """

    stages: tuple[ExpressionStage | GramStage | ProductStage, ...]
    rows: frozenset[str] = frozenset()
    lanes: frozenset[str] = frozenset()
    width: int = jit.WIDTH
    backward: bool = False

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Number of entries of every array, by name, in the order of the kernel's arguments.

        The arrays of the `ExpressionStage` stages come first, in the order of first use, then those of the others. The
        size of a Gram matrix is ``width``.
        """
        sizes: dict[str, int] = {}
        for f in self.functions:
            sizes |= {f.name_in(i): f.nnz_in(i) for i in range(f.n_in())}
            sizes |= {f.name_out(i): f.nnz_out(i) for i in range(f.n_out())}
        for part in self.stages:
            if isinstance(part, GramStage):
                sizes[part.result] = self.width
            elif isinstance(part, ProductStage):
                sizes |= {part.right: len(part.left[0]) * part.stride, part.result: len(part.left) * part.stride}
        return sizes

    @cached_property
    def carried(self) -> frozenset[str]:
        """Names of the arrays whose values pass from row to row."""
        arguments = {name for f in self.functions for name in f.name_in()}
        arguments |= {s.source for s in self.stages if isinstance(s, GramStage)}
        results = {name for f in self.functions for name in f.name_out()}
        results |= {s.result for s in self.stages if isinstance(s, ProductStage)}
        return frozenset(arguments & results) - self.rows

    @cached_property
    def summed(self) -> tuple[str, ...]:
        """Names of the results that are summed over the rows."""
        results = {name for f in self.functions for name in f.name_out()}
        return tuple(name for name in self.sizes if name in results and name not in self.rows | self.carried)

    @property
    def functions(self) -> tuple[Any, ...]:
        """CasADi functions of those stages of the plan that compute expressions, in the order of the stages."""
        return tuple(s.function for s in self.stages if isinstance(s, ExpressionStage))

    @property
    def grams(self) -> frozenset[str]:
        """Names of the results that are sums of products of columns, which `GramStage` stages compute."""
        return frozenset(s.result for s in self.stages if isinstance(s, GramStage))

    @cached_property
    def layout(self) -> Layout:
        """Layout of the arrays: the same sizes and kinds without CasADi objects, so that it can be stored in a file."""
        return Layout(self.sizes, self.rows, self.lanes, self.carried, self.summed, self.grams, self.width)

    def shape(self, name: str, n_rows: int, groups: int, per_row: bool = False) -> tuple[int, ...]:
        """Return the shape of the array ``name`` for ``n_rows`` rows and ``groups`` groups of lanes.

        With ``per_row``, it is the shape of a result by row, of which the kernel otherwise returns the sum over the
        rows. The result is that of `Layout.shape`. KeyError is raised for an unknown name.
        """
        return self.layout.shape(name, n_rows, groups, per_row)


def stage(inputs: Mapping[str, Any], results: Mapping[str, Any], bit: int | None = None) -> ExpressionStage:
    """Return a stage that computes SX expressions.

    Equal subexpressions are computed once, and the results are dense.

    Parameters
    ----------
    inputs : Mapping[str, SX]
        Symbols of the arguments, by name of the array.
    results : Mapping[str, SX]
        Expressions of the results, by name of the array. A name may also be among the inputs: its array is then carried
        from row to row.
    bit : int, optional
        The stage runs only in rows whose mask has this bit (0 to 31) set. None: in every row.
    """
    expressions = [ca.densify(e) for e in ca.cse(list(results.values()))]
    function = ca.Function(
        "stage", list(inputs.values()), expressions, list(inputs), list(results), {"allow_duplicate_io_names": True}
    )
    return ExpressionStage(function, bit)


def split_by_lanes(
    inputs: Mapping[str, Any],
    results: Mapping[str, Any],
    seeds: Mapping[str, Any],
    tangents: Mapping[str, Any],
    bit: int | None,
    name: str,
) -> tuple[ExpressionStage, ExpressionStage]:
    """Return two stages: the first computes ``results`` once, and the second ``tangents`` for each group of lanes.

    Subexpressions of ``tangents`` that depend only on ``inputs`` belong to the first stage. Their values are passed to
    the second stage in the array ``name``. They are then computed once instead of once for every group of lanes.

    Parameters
    ----------
    inputs, results : Mapping[str, SX]
        Symbols and expressions of the first stage, by name of the array.
    seeds, tangents : Mapping[str, SX]
        Symbols in lanes and expressions of the second stage, by name of the array. The expressions may also contain
        symbols of ``inputs``.
    bit : int or None
        Both stages run only in rows whose mask has this bit (0 to 31) set. None: in every row.
    name : str
        Name of the array between the stages.

    Returns
    -------
    tuple[ExpressionStage, ExpressionStage]
        First and second stage, in the order in which they run.
    """
    both = ca.cse([*results.values(), *tangents.values()])
    values, rest = both[: len(results)], both[len(results) :]
    rest, symbols, needed = ca.extract_parametric(rest, ca.vertcat(*inputs.values()), {"extract_trivial": True})
    first = stage(inputs, dict(zip(results, values, strict=True)) | {name: ca.vertcat(*needed)}, bit)
    second = stage({**seeds, name: ca.vertcat(*symbols)}, dict(zip(tangents, rest, strict=True)), bit)
    return first, second


def replace_slow_operations(expression: Any, constant: Any, early: Any, late: Any) -> tuple[Any, list[Any], list[Any]]:
    """Replace slow operations (such as sin and exp) that the forward pass can compute by symbols.

    An operation is replaced if its value depends on a symbol of ``early`` and on no symbol of ``late``.

    Parameters
    ----------
    expression : SX (n, 1)
        Column to rewrite. All of its symbols are in the next three parameters.
    constant : SX (n_constant, 1)
        Symbols that are the same in all rows (the parameters of the model).
    early : SX (n_early, 1)
        Symbols that are known in the forward pass.
    late : SX (n_late, 1)
        Symbols that are known only in the backward pass.

    Returns
    -------
    tuple[SX, list[SX], list[SX]]
        The column with symbols; the new symbols; the expression, of original symbols only, that each one replaces.
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

    (ends,) = evaluate_instructions(f, lambda i, j: (arguments[i][j],) * 2, lambda x: (ca.SX(x),) * 2, apply)
    return ca.vertcat(*[replaced for _, replaced in ends]), symbols, values
