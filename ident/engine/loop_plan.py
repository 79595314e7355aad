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
    """Stage of a plan (step of a kernel in each row of a record) that evaluates CasADi expressions.

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
    """Stage of a plan that adds the inner products between all lanes of an array to a symmetric matrix, in each row.

    A lane holds, for example, the derivatives by one parameter. The array ``source`` holds ``entries`` numbers for each
    lane. Element (i, j) of the matrix is increased by the sum over the entries of (entry in lane i) times (entry in
    lane j). The Fisher information is such a matrix.

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
    """Element of the left matrix of a `ProductStage`: a number of an array in the current row, or twice this number.

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
    """Stage of a plan that computes the matrix product ``result = left right`` in each row of a record.

    It uses vector instructions of the processor. Other stages without arrays in lanes use scalar instructions.

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
class CombinationStage:
    """Stage of a plan that combines rows of matrices linearly, in each group of lanes if the matrices are in lanes.

    Row r of the result is the sum of two kinds of terms: an entry of ``lanes`` times a row of numbers of ``rows``, and
    a number of ``scalars`` times a row of ``matrix``. Products with matrices that have few nonzero entries, some of
    them in lanes, consist of such terms. Without lanes, there are only terms of the second kind, and ``n`` is a
    multiple of `jit.WIDTH`, so that a vector holds neighbouring entries of a row.

    Attributes
    ----------
    lanes : str
        Name of an array in lanes: the factors of the first kind of terms. Empty without such terms.
    rows : str
        Name of an array without lanes: the rows of the first kind of terms. Empty without such terms.
    scalars : str
        Name of an array without lanes: the factors of the second kind of terms.
    matrix : str
        Name of the array of a matrix (n_lines, n), by matrix rows.
    result : str
        Name of the array of the result.
    n : int
        Number of columns.
    by_lanes : tuple[tuple[tuple[int, int], ...], ...]
        For each row of the result, the terms of the first kind: index in ``lanes``, and index in ``rows`` of the first
        of n numbers.
    by_scalars : tuple[tuple[tuple[int, int], ...], ...]
        For each row of the result, the terms of the second kind: index in ``scalars``, and number of the row of
        ``matrix``.
    transposed : bool
        Whether row r of the result is written to column r of its array instead of its row r. The matrices must be in
        lanes.
    bit : int or None
        The stage runs only in rows of the record whose mask has this bit (0 to 31) set. None: in every row.
    """

    lanes: str
    rows: str
    scalars: str
    matrix: str
    result: str
    n: int
    by_lanes: Terms
    by_scalars: Terms
    transposed: bool = False
    bit: int | None = None

    @property
    def sizes(self) -> dict[str, int]:
        """Number of entries of the matrix and of the result, by name of the array."""
        lines = 1 + max((line for terms in self.by_scalars for _, line in terms), default=-1)
        return {self.matrix: lines * self.n, self.result: len(self.by_scalars) * self.n}

    @property
    def arguments(self) -> tuple[str, ...]:
        """Names of the arrays that the stage reads."""
        return (*((self.lanes, self.rows) if self.lanes else ()), self.scalars, self.matrix)

    @property
    def steps(self) -> tuple[int, int]:
        """Distance in the array of the result from a row of the result to the next, and from an entry to the next."""
        return (1, len(self.by_scalars)) if self.transposed else (self.n, 1)


@dataclass(frozen=True)
class AddProductsStage:
    """Stage of a plan that adds ``a w' + w a'`` to a symmetric matrix in each group of lanes.

    Attributes
    ----------
    lanes : str
        Name of the array in lanes of the vector a (n,).
    scalars : str
        Name of the array without lanes that has the vector w (n,).
    first : int
        Index of the first entry of w in ``scalars``.
    result : str
        Name of the array in lanes of the matrix (n, n), which is changed.
    n : int
        Number of rows of the matrix.
    bit : int or None
        The stage runs only in rows of the record whose mask has this bit (0 to 31) set. None: in every row.
    """

    lanes: str
    scalars: str
    first: int
    result: str
    n: int
    bit: int | None = None

    @property
    def sizes(self) -> dict[str, int]:
        """Number of entries of the matrix, by name of its array."""
        return {self.result: self.n * self.n}

    @property
    def arguments(self) -> tuple[str, ...]:
        """Names of the arrays that the stage reads."""
        return (self.lanes, self.scalars, self.result)


@dataclass(frozen=True)
class AddTransposedStage:
    """Stage of a plan that computes the sum of a matrix (n, n) and its transpose in each group of lanes.

    Attributes
    ----------
    matrix, result : str
        Names of the arrays in lanes of the matrix and of the sum.
    n : int
        Number of rows of the matrix.
    bit : int or None
        The stage runs only in rows of the record whose mask has this bit (0 to 31) set. None: in every row.
    """

    matrix: str
    result: str
    n: int
    bit: int | None = None

    @property
    def sizes(self) -> dict[str, int]:
        """Number of entries of both matrices, by name of the array."""
        return {self.matrix: self.n * self.n, self.result: self.n * self.n}

    @property
    def arguments(self) -> tuple[str, ...]:
        """Names of the arrays that the stage reads."""
        return (self.matrix,)


@dataclass(frozen=True)
class AddEntriesStage:
    """Stage of a plan that adds entries of an array to entries of another one; either both are in lanes or neither.

    Attributes
    ----------
    source, result : str
        Names of the arrays. ``result`` is changed.
    entries : tuple[tuple[int, int], ...]
        Index in ``source`` and index in ``result`` of each addition.
    bit : int or None
        The stage runs only in rows of the record whose mask has this bit (0 to 31) set. None: in every row.
    """

    source: str
    result: str
    entries: tuple[tuple[int, int], ...]
    bit: int | None = None

    @property
    def sizes(self) -> dict[str, int]:
        """Empty: other stages have the sizes of both arrays."""
        return {}

    @property
    def arguments(self) -> tuple[str, ...]:
        """Names of the arrays that the stage reads."""
        return (self.source, self.result)


@dataclass(frozen=True)
class AddOuterProductStage:
    """Stage of a plan that adds the product ``a w'`` of two vectors to a matrix without lanes.

    Attributes
    ----------
    column : str
        Name of the array of the vector a (n,).
    row : str
        Name of the array of the vector w (stride,).
    result : str
        Name of the array of the matrix (n, stride), which is changed.
    n : int
        Number of rows.
    stride : int
        Number of columns, a multiple of `jit.WIDTH`.
    bit : int or None
        The stage runs only in rows of the record whose mask has this bit (0 to 31) set. None: in every row.
    """

    column: str
    row: str
    result: str
    n: int
    stride: int
    bit: int | None = None

    @property
    def sizes(self) -> dict[str, int]:
        """Number of entries of the matrix, by name of its array."""
        return {self.result: self.n * self.stride}

    @property
    def arguments(self) -> tuple[str, ...]:
        """Names of the arrays that the stage reads."""
        return (self.column, self.row, self.result)


@dataclass(frozen=True)
class TransposeStage:
    """Stage of a plan that transposes a matrix without lanes, or copies its upper triangle to the lower one.

    Attributes
    ----------
    matrix : str
        Name of the array of the matrix (n, stride), of which the first n columns are used.
    result : str
        Name of the array of the transpose. If it is that of the matrix, the upper triangle is copied.
    n, stride : int
        Number of rows, and of entries in each row.
    bit : int or None
        The stage runs only in rows of the record whose mask has this bit (0 to 31) set. None: in every row.
    """

    matrix: str
    result: str
    n: int
    stride: int
    bit: int | None = None

    @property
    def sizes(self) -> dict[str, int]:
        """Number of entries of both matrices, by name of the array."""
        return {self.matrix: self.n * self.stride, self.result: self.n * self.stride}

    @property
    def arguments(self) -> tuple[str, ...]:
        """Names of the arrays that the stage reads."""
        return (self.matrix,)


@dataclass(frozen=True)
class SingleCopyStage:
    """Stage of a plan that copies a matrix without lanes to an array in single precision.

    Attributes
    ----------
    matrix, result : str
        Names of the arrays of the matrix and of the copy.
    size : int
        Number of entries, a multiple of `jit.WIDTH`.
    bit : int or None
        The stage runs only in rows of the record whose mask has this bit (0 to 31) set. None: in every row.
    """

    matrix: str
    result: str
    size: int
    bit: int | None = None

    @property
    def sizes(self) -> dict[str, int]:
        """Number of entries of both arrays, by name."""
        return {self.matrix: self.size, self.result: self.size}

    @property
    def arguments(self) -> tuple[str, ...]:
        """Names of the arrays that the stage reads."""
        return (self.matrix,)


Terms = tuple[tuple[tuple[int, int], ...], ...]
# Stages on matrices. A routine that is compiled once for all models does the work of most of them (`matrix_routines`).
MatrixStage = (
    CombinationStage
    | AddProductsStage
    | AddTransposedStage
    | AddEntriesStage
    | AddOuterProductStage
    | TransposeStage
    | SingleCopyStage
)
Stage = ExpressionStage | GramStage | ProductStage | MatrixStage


@dataclass(frozen=True)
class Plan:
    """Plan of a kernel before compilation: a loop over the rows of a record, with a list of stages as its body.

    Attributes
    ----------
    stages : tuple[Stage, ...]
        Steps of the computation in each row, in the order in which they run.
    rows : frozenset[str]
        Names of the arrays with separate entries for each row, such as the inputs.
    lanes : frozenset[str]
        Names of the arrays with ``width`` numbers for each entry, one per lane. A lane holds, for example, the
        derivatives by one parameter.
    width : int
        Number of lanes in one group; by default the number of doubles in a vector register (2, 4 or 8).
    backward : bool
        Whether the loop runs from the last row to the first.
    single : frozenset[str]
        Names of the arrays in single precision. A stage in lanes that uses one of them computes in single precision.
        Its summed results are nevertheless added in double precision.
    """

    stages: tuple[Stage, ...]
    rows: frozenset[str] = frozenset()
    lanes: frozenset[str] = frozenset()
    width: int = jit.WIDTH
    backward: bool = False
    single: frozenset[str] = frozenset()

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Number of entries of every array of the kernel, by name, in the order of the kernel's arguments.

        An entry has one number, or one number for each lane. The arrays of stages of CasADi expressions come first, in
        the order of first use, then those of other stages. The result of a Gram stage has ``width`` entries.
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
            elif isinstance(part, MatrixStage):
                sizes |= {name: max(size, sizes.get(name, 0)) for name, size in part.sizes.items()}
        return sizes

    @cached_property
    def carried(self) -> frozenset[str]:
        """Names of the arrays whose values pass from row to row, such as the state of a filter.

        They are both arguments and results of stages, and have no separate entries for each row.
        """
        arguments = {name for f in self.functions for name in f.name_in()}
        arguments |= {s.source for s in self.stages if isinstance(s, GramStage)}
        results = {name for f in self.functions for name in f.name_out()}
        results |= {s.result for s in self.stages if isinstance(s, ProductStage)}
        for part in self.stages:
            if isinstance(part, MatrixStage):
                arguments |= {*part.arguments}
                results.add(part.result)
        return frozenset(arguments & results) - self.rows

    @cached_property
    def summed(self) -> tuple[str, ...]:
        """Names of the results of CasADi expressions that are summed over the rows, in the order of `sizes`.

        They neither pass from row to row nor have separate entries for each row.
        """
        results = {name for f in self.functions for name in f.name_out()}
        return tuple(name for name in self.sizes if name in results and name not in self.rows | self.carried)

    @property
    def functions(self) -> tuple[Any, ...]:
        """CasADi functions of the stages that evaluate CasADi expressions, in the order of the stages."""
        return tuple(s.function for s in self.stages if isinstance(s, ExpressionStage))

    @property
    def grams(self) -> frozenset[str]:
        """Names of the result matrices of the Gram stages, which add the inner products between all lanes.

        Gram stages are the `GramStage` among ``stages``. Their results are not in ``summed``.
        """
        return frozenset(s.result for s in self.stages if isinstance(s, GramStage))

    @cached_property
    def layout(self) -> Layout:
        """Names, sizes and kinds of the arrays, without CasADi objects, so that they can be stored in a file."""
        return Layout(self.sizes, self.rows, self.lanes, self.carried, self.summed, self.grams, self.width, self.single)

    def shape(self, name: str, n_rows: int, groups: int, per_row: bool = False) -> tuple[int, ...]:
        """Return the shape of the array ``name`` for ``n_rows`` rows and ``groups`` groups of ``width`` lanes.

        It is (n_rows, groups, entries, width), as `Layout.shape` describes it. n_rows is absent if the array is not in
        ``rows``, and groups and width if it is not in ``lanes``. ``per_row``: a result that is otherwise summed over
        the rows has separate values for each row. KeyError is raised for an unknown name.
        """
        return self.layout.shape(name, n_rows, groups, per_row)


def stage(inputs: Mapping[str, Any], results: Mapping[str, Any], bit: int | None = None) -> ExpressionStage:
    """Return a stage of a plan (step of a kernel in each row) that computes SX expressions.

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
    return _stage_as_written(inputs, dict(zip(results, ca.cse(list(results.values())), strict=True)), bit)


def _stage_as_written(inputs: Mapping[str, Any], results: Mapping[str, Any], bit: int | None) -> ExpressionStage:
    """Return a stage like `stage`, but without a search for equal subexpressions. The caller has joined these."""
    expressions = [ca.densify(e) for e in results.values()]
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
    """Return two stages of a plan, of which the second computes derivatives (tangents) for each group of lanes.

    A lane holds the derivatives by one parameter. The first stage computes ``results`` once in a row. Subexpressions of
    ``tangents`` that depend only on ``inputs`` belong to the first stage. Their values are passed to the second stage
    in the array ``name``. They are then computed once in a row instead of once for every group.

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
    first = _stage_as_written(inputs, dict(zip(results, values, strict=True)) | {name: ca.vertcat(*needed)}, bit)
    second = _stage_as_written({**seeds, name: ca.vertcat(*symbols)}, dict(zip(tangents, rest, strict=True)), bit)
    return first, second


def replace_slow_operations(expression: Any, constant: Any, early: Any, late: Any) -> tuple[Any, list[Any], list[Any]]:
    """Replace slow operations (such as sin and exp) in an expression of a backward pass by symbols.

    The forward pass then computes and stores their values. An operation is replaced if its value depends on a symbol of
    ``early`` and on no symbol of ``late``. Operations on ``constant`` symbols alone are not replaced, because they are
    computed once for all rows.

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
        The column with new symbols in place of slow operations; the list of the new symbols; for each of them, the
        operation that it replaces, as an expression of the original symbols.
    """
    arguments = (ca.vertcat(constant, early), late)
    f = ca.Function("f", arguments, [ca.densify(ca.cse(expression))])
    symbols: list[Any] = []
    values: list[Any] = []

    def apply(code: int, *x: tuple[Any, Any]) -> tuple[Any, Any]:
        """Return a pair: the result of the operation ``code``, and this result with symbols for slow operations.

        Each of the operands ``x`` is such a pair, too.
        """
        original, replaced = (operation(code, *[pair[version] for pair in x]) for version in (0, 1))
        if code in SLOW and ca.depends_on(original, early) and not ca.depends_on(original, late):
            values.append(original)
            replaced = ca.SX.sym(f"slow{len(symbols)}")
            symbols.append(replaced)
        return original, replaced

    (ends,) = evaluate_instructions(f, lambda i, j: (arguments[i][j],) * 2, lambda x: (ca.SX(x),) * 2, apply)
    return ca.vertcat(*[replaced for _, replaced in ends]), symbols, values
