"""LLVM IR (intermediate code of the compiler) of a plan: a loop over rows with the instructions of all stages.

A stage is one step of the loop body. It runs in rows whose mask has the bit of the stage set. A lane is one element of
the processor's vector registers, and an array in lanes has a vector of numbers for each entry.

Values that depend on constants only are computed before the loop. A stage with arrays in lanes becomes a separate
function, called for each group of lanes (each vector). In this function, values that depend on lanes are vectors, and
all other values are scalars. Carried values, which pass from row to row, are kept in registers, unless a function needs
their address. The arithmetic follows the instructions of CasADi, and equal instructions are written only once.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from functools import partial, reduce
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from seatrial.ident.engine import jit, matrix_routines
from seatrial.ident.engine.expressions import evaluate_instructions
from seatrial.ident.engine.llvm_operations import (
    COMPARISONS,
    FAST,
    FLUSH_TO_ZERO,
    LIBRARY,
    STRICT,
    TEMPLATES,
    rewritten,
)
from seatrial.ident.engine.loop_plan import (
    AddEntriesStage,
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
    Stage,
    TransposeStage,
)


class Value(NamedTuple):
    """Number in the generated LLVM IR: a scalar, or a vector of several numbers that one instruction processes.

    Attributes
    ----------
    text : str
        Name (such as ``%.12``) or literal in the IR.
    vector : bool
        Whether the number is a vector.
    constant : bool
        Whether the number is the same in all rows, so that it is computed before the loop.
    """

    text: str
    vector: bool
    constant: bool


def _hexadecimal_literal(x: float) -> Value:
    """Return the number x as a constant scalar in LLVM IR, written as a hexadecimal literal without rounding.

    A literal of single precision has the same form; x must then be a number of this precision.
    """
    return Value(f"0x{struct.unpack('<Q', struct.pack('<d', float(x)))[0]:016X}", False, True)


QUOTIENT = "fdiv {F} {T} {0}, {1}"
ZERO, ONE = _hexadecimal_literal(0.0), _hexadecimal_literal(1.0)
# Lines of a basic block of a stage. Stages have thousands of instructions. Quick code generation selects the
# instructions of a block together: all uses of a number then share one load instruction, and the number is moved
# between registers and the stack in the meantime. In a new block it is loaded again from its array. A shorter block
# moves more intermediate results to the stack.
BLOCK_LINES = 500


def _pointer_arguments(names: Iterable[str], attribute: str = "") -> str:
    """Return the text of arguments in LLVM IR, ``ptr %name`` for each of the arrays ``names``, separated by commas.

    ``attribute`` is an LLVM attribute of each argument, such as ``noalias``; empty: none.
    """
    return ", ".join(f"ptr {attribute} %{name}" for name in names)


class LlvmEmitter:
    """Writer of the LLVM IR of one plan: the text of a program that runs over all rows of a record.

    A writer is used once: `ir` writes the module. A stage is one step of the computation in each row.

    Attributes
    ----------
    plan : Plan
        Plan of the kernel.
    entry_lines : list[str]
        Lines of IR before the loop over the rows.
    loop_lines : list[str]
        Lines in the loop; while a stage that is a separate function is written, lines of this function.
    function_lines : list[str]
        Lines of the functions that the loop calls.
    declarations : set[str]
        Declarations of the functions of the C library, and of the routines, that are called.
    routines : set[str]
        Names of the routines (`matrix_routines`) that are called. The machine code is linked with them.
    values_by_instruction : dict[Any, Value]
        Result of each instruction that was written. Equal instructions are written once: if they are constant, once in
        the module, otherwise once in a stage; loads and addresses once in a basic block.
    entry_of_value : dict[str, tuple[str, int, int]]
        Array, index and basic block of each number that was loaded from memory, by name of the number.
    loaded_values : dict[tuple[str, int, int, str], Value]
        The number by its array, index, basic block and type.
    quotients : dict[str, tuple[Value, ...]]
        Numerator and denominator of each quotient that was written as a product with the reciprocal, by its name.
    block, block_label, block_start : int, str, int
        Number of the current basic block, its label, and the number of lines before it in ``loop_lines``.
    is_storing : bool
        Whether the results of a stage are being stored, so that arguments in memory may have changed.
    instruction_forms : dict[tuple[str, bool, int, str], str]
        Template with types and flags inserted, by template, whether the result is a vector, width and flags.
    n_values : int
        Number of named values so far.
    flags : str
        Floating-point flags of the next instructions.
    stage_index : int
        Index of the current stage in the plan.
    in_lane_function : bool
        Whether the current stage is written as a separate function, because it has arrays in lanes.
    width : int
        Numbers in the current vectors.
    number : str
        LLVM's name of the present type of numbers, ``double`` or ``float``.
    register_values : dict[str, list[Value]]
        Present value of each entry of the carried arrays that are kept in registers, by name of the array.
    new_values : dict[tuple[str, int], Value]
        Values that the current stage has computed for such entries, by name of the array and index of the entry.
    """

    def __init__(self, plan: Plan) -> None:
        """Prepare the writer for the plan. `ir` writes the module."""
        self.plan = plan
        self.entry_lines: list[str] = []
        self.loop_lines: list[str] = []
        self.function_lines: list[str] = []
        self.declarations: set[str] = set()
        self.routines: set[str] = set()
        self.values_by_instruction: dict[Any, Value] = {}
        self.entry_of_value: dict[str, tuple[str, int, int]] = {}
        self.loaded_values: dict[tuple[str, int, int, str], Value] = {}
        self.quotients: dict[str, tuple[Value, ...]] = {}
        self.block, self.block_label, self.block_start, self.is_storing = 0, "loop", 0, False
        self.instruction_forms: dict[tuple[str, bool, int, str, str], str] = {}
        self.n_values = 0
        self.flags = FAST
        self.stage_index = 0
        self.in_lane_function = False
        self.width, self.number = plan.width, "double"
        self.register_values = {
            name: [Value(f"%held.{name}.{j}", False, False) for j in range(plan.sizes[name])]
            for name in plan.sizes
            if name in plan.carried and not self._in_memory(name)
        }
        self.new_values: dict[tuple[str, int], Value] = {}

    def ir(self) -> str:
        """Write and return the text of the module, which defines one public function, ``kernel``.

        The arguments of this function are the number of rows, the number of groups of lanes (vectors), the address of
        the mask, the addresses of all arrays in the order of ``plan.sizes``, and for each summed result 0 (sum) or 1
        (separate results in each row).
        """
        for number, stage in enumerate(self.plan.stages):
            self.stage_index = number
            self._write_stage(stage)
        steps = "".join(f", i64 %step.{name}" for name in self.plan.summed)
        row = "%last, %i" if self.plan.backward else "%i, 0"
        fetched, held, kept = self._register_array_lines()
        return "\n".join(
            [
                *FLUSH_TO_ZERO.declared,
                *sorted(self.declarations),
                *self.function_lines,
                f"define void @kernel(i64 %n, i64 %groups, ptr %mask, "
                f"{_pointer_arguments(self.plan.sizes)}{steps}) {jit.FRAME} {{",
                "entry:",
                *FLUSH_TO_ZERO.first,
                *self.entry_lines,
                *fetched,
                "%last = sub i64 %n, 1",
                "br label %loop",
                "loop:",
                f"%i = phi i64 [0, %entry], [%i.next, %end{self.stage_index}]",
                *held,
                f"%k = sub i64 {row}",
                "%mask.p = getelementptr i32, ptr %mask, i64 %k",
                "%mask.k = load i32, ptr %mask.p",
                *self.loop_lines,
                "%i.next = add i64 %i, 1",
                "%more = icmp slt i64 %i.next, %n",
                "br i1 %more, label %loop, label %exit",
                "exit:",
                *kept,
                *FLUSH_TO_ZERO.last,
                "ret void",
                "}",
                "",
            ]
        )

    def _in_memory(self, name: str) -> bool:
        """Return whether the array ``name``, which passes from row to row, stays in memory instead of registers.

        It does if it has lanes (vectors of numbers), if a stage that is a separate function or calls a routine uses it,
        or if it is the right matrix or the result of a matrix product.
        """
        for stage in self.plan.stages:
            if isinstance(stage, ProductStage) and name in (stage.right, stage.result):
                return True
            if isinstance(stage, MatrixStage) and name in (*stage.arguments, stage.result):
                return True
            if isinstance(stage, ExpressionStage):
                names = {*stage.function.name_in(), *stage.function.name_out()}
                if name in names and names & self.plan.lanes:
                    return True
        return name in self.plan.lanes

    def _register_array_lines(self) -> tuple[list[str], list[str], list[str]]:
        """Return the lines of IR for arrays that pass from row to row in registers.

        Returns
        -------
        tuple[list[str], list[str], list[str]]
            Lines that load the arrays before the loop, pass them to the next row, and store them after the loop.
        """
        fetched, held, kept = [], [], []
        for name, values in self.register_values.items():
            for j, value in enumerate(values):
                at, first = f"%held.{name}.{j}.p", f"%held.{name}.{j}.first"
                fetched += [f"{at} = getelementptr double, ptr %{name}, i64 {j}", f"{first} = load double, ptr {at}"]
                held.append(f"%held.{name}.{j} = phi double [{first}, %entry], [{value.text}, %end{self.stage_index}]")
                kept.append(f"store double {value.text}, ptr {at}")
        return fetched, held, kept

    # Stages

    def _write_stage(self, stage: Stage) -> None:
        """Write the IR of one stage (step in each row), with a branch that skips it if its bit of the mask is 0.

        A stage whose ``bit`` is None has no such branch: it runs in every row.
        """
        q = self.stage_index
        if stage.bit is None:
            self._append_lines(f"br label %do{q}")
        else:
            self._append_lines(
                f"%bit{q} = and i32 %mask.k, {1 << stage.bit}",
                f"%on{q} = icmp ne i32 %bit{q}, 0",
                f"br i1 %on{q}, label %do{q}, label %end{q}",
            )
        self._append_lines(f"do{q}:")
        self._enter_block(f"do{q}")
        if isinstance(stage, GramStage):
            self._write_gram(stage)
        elif isinstance(stage, ProductStage):
            self._write_product(stage)
            self._append_lines(f"br label %end{q}")
        elif isinstance(stage, MatrixStage):
            self._write_matrix_stage(stage)
        elif self.plan.lanes.isdisjoint([*stage.function.name_in(), *stage.function.name_out()]):
            self._write_instructions(stage)
            self._append_lines(f"br label %end{q}")
        else:
            self._write_lane_function(stage)
        self._append_lines(f"end{q}:")
        self._assign_new_values(stage.bit is not None)

    def _assign_new_values(self, is_conditional: bool) -> None:
        """Assign the new values of the current stage to the arrays that pass from row to row in registers.

        ``is_conditional``: whether the stage may be skipped in a row, in which the arrays keep their old values. After
        the call, the attribute ``new_values`` is empty.
        """
        q, before = self.stage_index, f"%end{self.stage_index - 1}" if self.stage_index else "%loop"
        for (name, j), value in self.new_values.items():
            old = self.register_values[name][j]
            if is_conditional:
                here = f"%{self.block_label}"
                self._append_lines(f"%held.{name}.{j}.{q} = phi double [{value.text}, {here}], [{old.text}, {before}]")
                value = Value(f"%held.{name}.{j}.{q}", False, False)
            self.register_values[name][j] = value
        self.new_values = {}

    def _write_instructions(self, stage: ExpressionStage) -> None:
        """Write the instructions of a stage of CasADi expressions.

        Results that are also arguments, and summed results, are stored last, because the stage may still read them.
        """
        f = stage.function
        arguments, names = f.name_in(), f.name_out()
        deferred: list[tuple[str, int, Value]] = []

        def done(i: int, j: int, value: Value) -> None:
            """Write the store of entry j of result i, or defer it if the stage may still read the array."""
            if names[i] in arguments or names[i] in self.plan.summed:
                deferred.append((names[i], j, value))  # the stage may still have to read the old value
            else:
                self._store_entry(names[i], j, value)  # a value stored at once needs no register any more

        evaluate_instructions(
            f, lambda i, j: self._load_entry(arguments[i], j), self._constant_literal, self._write_operation, done
        )
        self.is_storing = True
        for result in deferred:
            self._store_entry(*result)
        self.is_storing = False

    def _write_lane_function(self, stage: ExpressionStage) -> None:
        """Write a stage with arrays in lanes as a separate function, and its call for each group of lanes (vector)."""
        q, f = self.stage_index, stage.function
        used = list(dict.fromkeys([*f.name_in(), *f.name_out()]))
        steps = [name for name in used if name in self.plan.summed]
        outer, self.loop_lines, self.in_lane_function = self.loop_lines, [], True
        self._enter_block("")
        self.number = "double" if self.plan.single.isdisjoint(used) else "float"
        self._write_instructions(stage)
        self.number = "double"
        declared = "".join(f", i64 %step.{name}" for name in steps)
        self.function_lines += [
            f"define internal void @stage{q}(i64 %k, i64 %g, i64 %groups, "
            f"{_pointer_arguments(used, 'noalias')}{declared}) noinline {jit.FRAME} {{",
            *self.loop_lines,
            "ret void",
            "}",
        ]
        self.loop_lines, self.in_lane_function = outer, False
        self._write_group_loop(
            f"do{q}",
            f"g{q}",
            "0",
            [f"call void @stage{q}(i64 %k, i64 %g{q}, i64 %groups, {_pointer_arguments(used)}{declared})"],
            f"end{q}",
        )

    def _write_group_loop(self, origin: str, index: str, first: str, body: list[str], end: str, tail: str = "") -> None:
        """Write a loop over groups of lanes (vectors), with an index from ``first`` to the last group.

        Parameters
        ----------
        origin : str
            Label of the basic block before the loop.
        index : str
            Name of the index, without the percent sign.
        first : str
            First value of the index: a literal or a name.
        body : list[str]
            Lines of IR of the loop body.
        end : str
            Label of the basic block after the loop.
        tail : str
            Label of the last basic block of the body, if the body has several. Empty if it has one.
        """
        block = f"loop.{index}"
        self._append_lines(
            f"br label %{block}",
            f"{block}:",
            f"%{index} = phi i64 [{first}, %{origin}], [%{index}.next, %{tail or block}]",
            *body,
            f"%{index}.next = add i64 %{index}, 1",
            f"%more.{index} = icmp slt i64 %{index}.next, %groups",
            f"br i1 %more.{index}, label %{block}, label %{end}",
        )

    def _write_gram(self, stage: GramStage) -> None:
        """Write a Gram stage, which adds the inner products between all lanes of an array to a matrix.

        It is the call of a routine for all pairs (a, b) of groups of lanes on and above the diagonal.
        """
        q, width, kind = self.stage_index, self.plan.width, matrix_routines.ADD_GRAM
        name = matrix_routines.routine_name(kind, stage.entries, width, self._number_of(stage.source))
        self.declarations.add(matrix_routines.declaration(kind, name))
        self.routines.add(name)
        source, block = self._array_type(stage.source), f"[{width * width} x double]"
        body = [
            f"%left{q}.first = mul i64 %a{q}, {stage.entries}",
            f"%left{q} = getelementptr {source}, ptr %{stage.source}, i64 %left{q}.first",
            f"%right{q}.first = mul i64 %b{q}, {stage.entries}",
            f"%right{q} = getelementptr {source}, ptr %{stage.source}, i64 %right{q}.first",
            f"%line{q} = mul i64 %a{q}, %groups",
            f"%block{q}.first = add i64 %line{q}, %b{q}",
            f"%block{q} = getelementptr {block}, ptr %{stage.result}, i64 %block{q}.first",
            f"call void @{name}(ptr %left{q}, ptr %right{q}, ptr %block{q})",
        ]
        outer, self.loop_lines = self.loop_lines, []
        self._write_group_loop(f"loop.a{q}", f"b{q}", f"%a{q}", body, f"tail{q}")
        inner, self.loop_lines = self.loop_lines, outer
        self._write_group_loop(f"do{q}", f"a{q}", "0", [*inner, f"tail{q}:"], f"end{q}", tail=f"tail{q}")

    def _write_matrix_stage(self, stage: MatrixStage) -> None:
        """Write a stage on matrices: the call of a routine, or additions of entries.

        If the matrices are in lanes, it is written for each group of lanes.
        """
        q, body = self.stage_index, list[str]()
        if isinstance(stage, AddEntriesStage):
            self._write_added_entries(stage, body)
        else:
            name, arguments = self._routine_call(stage, body)
            self.routines.add(name)
            body.append(f"call void @{name}({', '.join(arguments)})")
        if stage.result in self.plan.lanes:
            self._write_group_loop(f"do{q}", f"g{q}", "0", body, f"end{q}")
        else:
            self._append_lines(*body, f"br label %end{q}")

    def _routine_call(self, stage: MatrixStage, body: list[str]) -> tuple[str, list[str]]:
        """Return the name of the routine that computes a stage on matrices, and its arguments.

        The computation of addresses is appended to ``body``, and the routine is declared. Other stages than those with
        a routine are not allowed.
        """
        q, n, width = self.stage_index, getattr(stage, "n", 0), self.plan.width
        here = partial(self._part_address, body)
        if isinstance(stage, CombinationStage):
            if stage.result not in self.plan.lanes:
                n, width = n // jit.WIDTH, jit.WIDTH
            table = [
                number
                for first, second in zip(stage.by_lanes, stage.by_scalars, strict=True)
                for number in (len(first), len(second), *sum((*first, *second), ()))
            ]
            content, (by_row, by_entry) = ", ".join(f"i32 {number}" for number in table), stage.steps
            self.function_lines.append(f"@table{q} = internal constant [{len(table)} x i32] [{content}]")
            # without lanes, a row of the result is n vectors
            by_row = by_row if stage.result in self.plan.lanes else n
            arrays = (
                stage.lanes or stage.matrix,
                stage.rows or stage.scalars,
                stage.scalars,
                stage.matrix,
                stage.result,
            )
            kind, arguments = matrix_routines.COMBINE, [here(name, str(k)) for k, name in enumerate(arrays)]
            arguments += [f"i64 {by_row}", f"i64 {by_entry}", f"ptr @table{q}", f"i64 {len(stage.by_scalars)}"]
        elif isinstance(stage, AddProductsStage):
            kind, arguments = matrix_routines.ADD_PRODUCTS, [here(stage.result), here(stage.lanes)]
            arguments.append(here(stage.scalars, first=stage.first))
        elif isinstance(stage, AddTransposedStage):
            kind, arguments = matrix_routines.ADD_TRANSPOSED, [here(stage.result), here(stage.matrix)]
        elif isinstance(stage, AddOuterProductStage):
            kind, n, width = matrix_routines.ADD_OUTER_PRODUCT, stage.stride // jit.WIDTH, jit.WIDTH
            arguments = [here(stage.result), here(stage.column), here(stage.row), f"i64 {stage.n}"]
        elif isinstance(stage, SingleCopyStage):
            kind, n, width = matrix_routines.COPY_TO_SINGLE, stage.size // jit.WIDTH, jit.WIDTH
            arguments = [here(stage.result), here(stage.matrix)]
        else:
            assert isinstance(stage, TransposeStage)
            kind, width = matrix_routines.MIRROR, stage.stride
            arguments = [here(stage.result)]
            if stage.result != stage.matrix:
                kind, arguments = matrix_routines.TRANSPOSE, [*arguments, here(stage.matrix)]
        name = matrix_routines.routine_name(kind, n, width, self._number_of(stage.arguments[-1]))
        self.declarations.add(matrix_routines.declaration(kind, name))
        return name, arguments

    def _write_added_entries(self, stage: AddEntriesStage, body: list[str]) -> None:
        """Append the lines to ``body`` that add entries of an array to entries of another one."""
        q, kind, align = self.stage_index, self._array_type(stage.result), self._alignment(stage.result)
        source, target = self._part_address(body, stage.source), self._part_address(body, stage.result)
        for k, (i, j) in enumerate(stage.entries):
            a, b = f"%a{q}.{k}", f"%b{q}.{k}"
            body += [
                f"{a}.p = getelementptr {kind}, {source}, i64 {i}",
                f"{a} = load {kind}, ptr {a}.p, align {align}",
                f"{b}.p = getelementptr {kind}, {target}, i64 {j}",
                f"{b} = load {kind}, ptr {b}.p, align {align}",
                f"{b}.sum = fadd {FAST} {kind} {a}, {b}",
                f"store {kind} {b}.sum, ptr {b}.p, align {align}",
            ]

    def _part_address(self, body: list[str], name: str, label: str = "", first: int = 0) -> str:
        """Append the computation of an address to ``body``, and return the pointer as an argument of a call.

        It is that of the array's part in the current group if the array ``name`` is in lanes, else of its entry
        ``first``. ``label`` distinguishes pointers to the same array in a stage.
        """
        pointer, entry = f"%{name}.at{self.stage_index}.{label}", str(first)
        if name in self.plan.lanes:
            entry = f"{pointer}.first"
            body.append(f"{entry} = mul i64 %g{self.stage_index}, {self.plan.sizes[name]}")
        body.append(f"{pointer} = getelementptr {self._array_type(name)}, ptr %{name}, i64 {entry}")
        return f"ptr {pointer}"

    def _write_product(self, stage: ProductStage) -> None:
        """Write the IR of a stage that is a matrix product.

        A vector holds ``stage.width`` neighbouring numbers of a row of the right matrix.
        """
        self.width = stage.width
        for i, line in enumerate(stage.left):
            factors = [self._load_entry(factor.array, factor.entry) for factor in line]
            factors = [
                self._write_instruction("fadd {F} {T} {0}, {0}", value) if factor.twice else value
                for factor, value in zip(line, factors, strict=True)
            ]
            for first in range(0, stage.stride, stage.width):
                terms = []
                for j, value in enumerate(factors):
                    at = self._write_address(stage.right, j * stage.stride + first)
                    right = self._write_instruction(f"load {{T}}, ptr {at}, align 8", vector=True, constant=False)
                    terms.append(self._write_instruction("fmul {F} {T} {0}, {1}", value, right))
                at = self._write_address(stage.result, i * stage.stride + first)
                self._append_lines(f"store {self._type_text(True)} {self._write_sum(terms).text}, ptr {at}, align 8")
        self.width = self.plan.width

    def _write_sum(self, terms: list[Value]) -> Value:
        """Write the instructions that add the terms, at least one, and return their sum.

        The two halves of the terms are added independently, so that the processor can compute them at the same time.
        Each half is added from left to right, in this order (flags STRICT).
        """
        self.flags = STRICT  # with FAST, LLVM would reorder the additions into one chain
        half = (len(terms) + 1) // 2
        first, *more = [
            reduce(partial(self._write_instruction, "fadd {F} {T} {0}, {1}"), part)
            for part in (terms[:half], terms[half:])
            if part
        ]
        total = self._write_instruction("fadd {F} {T} {0}, {1}", first, *more) if more else first
        self.flags = FAST
        return total

    # Instructions

    def _constant_literal(self, x: float) -> Value:
        """Return the number x as a literal of LLVM IR.

        ValueError is raised for NaN, which CasADi inserts for a symbol that the model has converted to a number.
        """
        if math.isnan(x):
            raise ValueError(
                "the model converts its symbols to numbers (math.sin, float(), np.zeros); use numpy's functions"
            )
        return _hexadecimal_literal(x if self.number == "double" else float(np.float32(x)))

    def _write_operation(self, code: int, *a: Value) -> Value:
        """Write the IR of one CasADi operation on the one or two operands ``a``, and return its result.

        ``code`` is CasADi's code of the operation, such as ``casadi.OP_ADD``. Most operations are instructions or
        intrinsics of LLVM, or functions of the C library. Others are composed: for example quotients, sin, cos, sign,
        not, and, or (`rewritten`), and the selection of a value or zero. NotImplementedError is raised for an operation
        without any of these forms.
        """
        if len(self.loop_lines) - self.block_start > BLOCK_LINES:
            label = f"part{self.block}"
            self._append_lines(f"br label %{label}", f"{label}:")
            self._enter_block(label)
        if code in (ca.OP_FLOOR, ca.OP_CEIL) and (pair := self.quotients.get(a[0].text)):
            # A product with the reciprocal of y is below 1 for some x = y, and x mod y would be y.
            before, self.flags = self.flags, "contract"
            a = (self._write_instruction(QUOTIENT, *pair),)
            self.flags = before
        if code in TEMPLATES:
            return self._write_instruction(TEMPLATES[code], *a)
        if code in (ca.OP_DIV, ca.OP_INV):  # the reciprocal is shared, and moves before the loop if it is constant
            r = self._write_instruction(QUOTIENT, ONE, a[-1])
            if code == ca.OP_INV:
                return r
            result = self._write_operation(ca.OP_MUL, a[0], r)
            self.quotients[result.text] = a
            return result
        if code in rewritten():
            self.flags = STRICT  # the range reduction of sin and cos relies on the order of its operations
            result = evaluate_instructions(
                rewritten()[code], lambda i, j: a[i], self._constant_literal, self._write_operation
            )[0][0]
            self.flags = FAST
            return result
        if code in COMPARISONS:
            return self._write_select(COMPARISONS[code], a[0], a[1], ONE)
        if code == ca.OP_IF_ELSE_ZERO:
            return self._write_select("une", a[0], ZERO, a[1])
        if code in LIBRARY:
            return self._write_library_call(LIBRARY[code], *a)
        name = next((n for n in dir(ca) if n.startswith("OP_") and getattr(ca, n) == code), str(code))
        raise NotImplementedError(
            f"the model uses CasADi's operation {name}, which cannot be compiled; write it with numpy's functions"
        )

    def _write_instruction(
        self,
        template: str,
        *args: Value,
        vector: bool = False,
        constant: bool = True,
        again: bool = False,
        local: bool = False,
    ) -> Value:
        """Write an LLVM instruction, unless the same instruction was written before. Return its result.

        Before means in the same stage; for a constant result, anywhere in the module. A constant instruction is placed
        before the loop over the rows, any other one in the loop. The earlier result is returned if there is one.

        Parameters
        ----------
        template : str
            Instruction, in which ``{0}`` and ``{1}`` are the operands, ``{T}`` is the type, ``{S}`` the type's name in
            intrinsics and ``{F}`` the floating-point flags.
        *args : Value
            Operands. Scalars are repeated in all lanes if another operand is a vector.
        vector : bool
            Whether the result is a vector although no operand is.
        constant : bool
            False: the result varies from row to row although its operands do not.
        again : bool
            Whether to write the instruction even if it was written before.
        local : bool
            Whether to write the instruction again in each basic block, because it is as cheap as to keep its result.
        """
        constant = constant and not self.in_lane_function
        for a in args:  # loops, not any() and all(): this method is called a hundred thousand times for a kernel
            vector = vector or a.vector
            constant = constant and a.constant
        if not args:
            code = self._with_types(template, vector) if "{" in template else template
        else:
            if not constant and not self.is_storing:
                args = tuple([self._in_block(a) if a.text in self.entry_of_value else a for a in args])
            operands = [a.text if a.vector or not vector else self._vector_text(a) for a in args]
            code = self._instruction_form(template, vector).format(*operands)
        key = code if constant else (code, self.block) if local else (code, self.stage_index, "stage")
        known = self.values_by_instruction.get(key)
        if again or known is None:
            self.n_values += 1
            name = f"%.{self.n_values}"
            self.values_by_instruction[key] = known = Value(name, vector, constant)
            (self.entry_lines if constant else self.loop_lines).append(f"{name} = {code}")
        return known

    def _enter_block(self, label: str) -> None:
        """Begin a basic block, which has the label ``label``; its lines follow."""
        self.block, self.block_label, self.block_start = self.block + 1, label, len(self.loop_lines)

    def _in_block(self, value: Value) -> Value:
        """Return a number that was loaded from memory, for use in the current basic block: it is loaded in each."""
        name, j, block = self.entry_of_value[value.text]
        return value if block == self.block else self._load_entry(name, j)

    def _instruction_form(self, template: str, vector: bool) -> str:
        """Return a template of an instruction with its types and flags, in which only the operands are missing."""
        key = template, vector, self.width, self.number, self.flags
        if (form := self.instruction_forms.get(key)) is None:
            form = self.instruction_forms[key] = self._with_types(template, vector)
        return form

    def _with_types(self, template: str, vector: bool) -> str:
        """Return a template with its types (``{T}``, ``{S}``) and flags (``{F}``) inserted."""
        bits = "f64" if self.number == "double" else "f32"
        kind, suffix = self._type_text(vector), f"v{self.width}{bits}" if vector else bits
        return template.replace("{T}", kind).replace("{S}", suffix).replace("{F}", self.flags)

    def _write_select(self, comparison: str, x: Value, y: Value, result: Value) -> Value:
        """Write the instructions that select ``result`` if the comparison of x and y is true, else zero.

        Return the selected value.

        ``comparison`` is LLVM's name of a floating-point comparison: ``olt``, ``ole``, ``oeq`` or ``une``.
        """
        c = self._write_instruction(f"fcmp {comparison} {{T}} {{0}}, {{1}}", x, y)
        test = f"<{self.plan.width} x i1>" if c.vector else "i1"
        return self._write_instruction(
            f"select {test} {c.text}, {{T}} {{0}}, {{T}} {{1}}", result, ZERO, vector=c.vector, constant=c.constant
        )

    def _write_library_call(self, name: str, *a: Value) -> Value:
        """Write the call of the function ``name`` of the C library on the operands ``a``, and return its result.

        If an operand is a vector, the function is called for each of its elements (lanes) separately.
        """
        if not any(x.vector for x in a):
            self.declarations.add(f"declare double @{name}({', '.join(['double'] * len(a))}) memory(none)")
            return self._write_instruction(
                f"call double @{name}({', '.join(f'double {{{i}}}' for i in range(len(a)))})", *a
            )
        result = Value("poison", True, True)
        for i in range(self.plan.width):
            parts = [
                self._write_instruction(f"extractelement {{T}} {{0}}, i32 {i}", x)._replace(vector=False)
                if x.vector
                else x
                for x in a
            ]
            part = self._write_library_call(name, *parts)
            result = self._write_instruction(
                f"insertelement {{T}} {{0}}, double {part.text}, i32 {i}", result, constant=part.constant
            )
        return result

    def _vector_text(self, a: Value) -> str:
        """Return the name or literal of a value as a vector. A scalar is repeated in all elements of the vector.

        The instructions that repeat it are written; a literal needs none.
        """
        if a.vector:
            return a.text
        if a.text[0] != "%":
            return f"splat ({self.number} {a.text})"
        first = self._write_instruction(
            f"insertelement {{T}} poison, {self.number} {a.text}, i32 0",
            vector=True,
            constant=a.constant,
            local=True,
        )
        zeros = f"<{self.width} x i32> zeroinitializer"
        return self._write_instruction(f"shufflevector {{T}} {{0}}, {{T}} poison, {zeros}", first, local=True).text

    # Memory

    def _write_address(self, name: str, j: int, constant: bool = False) -> str:
        """Write the computation of the address of entry j of the array ``name``. Return the name of the pointer.

        The address is that of the current row if the array has entries for each row or is a summed result, and that of
        the current group of lanes (vector) if the array is in lanes. ``constant``: whether it is used before the loop.
        """
        kind, size, pointer = self._array_type(name), self.plan.sizes[name], f"%{name}"
        offsets: list[str] = []
        if name in self.plan.rows or name in self.plan.summed:
            row = "%k"
            if name in self.plan.summed:  # the step is 0 for a sum over rows and 1 for separate results in each row
                row = self._write_instruction(f"mul i64 %k, %step.{name}", constant=False, local=True).text
            if name in self.plan.lanes:
                row = self._write_instruction(f"mul i64 {row}, %groups", constant=False, local=True).text
            offsets.append(row)
        if name in self.plan.lanes:
            offsets.append("%g")
        for offset in offsets:
            entries = self._write_instruction(f"mul i64 {offset}, {size}", constant=False, local=True).text
            pointer = self._write_instruction(
                f"getelementptr {kind}, ptr {pointer}, i64 {entries}", constant=False, local=True
            ).text
        # in the block of its use, a constant offset is a part of the load or store instruction
        return self._write_instruction(
            f"getelementptr {kind}, ptr {pointer}, i64 {j}", constant=constant, local=True
        ).text

    def _load_entry(self, name: str, j: int, again: bool = False) -> Value:
        """Return entry j of the array ``name`` in the current row and group of lanes, as a value of the program.

        It comes from its register, or from memory by a load instruction that is written. ``again``: whether to load it
        from memory even if it was loaded before.
        """
        if name in self.register_values:
            return self.register_values[name][j]
        key = name, j, self.block, self.number
        if not again and key in self.loaded_values:
            return self.loaded_values[key]
        varies = name in self.plan.rows or name in self.plan.carried or again
        constant = not varies and not self.in_lane_function
        stored = self._write_instruction(
            f"load {self._array_type(name)}, ptr {self._write_address(name, j, constant)}, "
            f"align {self._alignment(name)}",
            vector=name in self.plan.lanes,
            constant=constant,
            again=again,
            local=True,
        )
        value = self._converted(stored, self._number_of(name), self.number, local=True)
        if not again:
            self.loaded_values[key] = value
            if not constant:
                self.entry_of_value[value.text] = name, j, self.block
        return value

    def _store_entry(self, name: str, j: int, value: Value) -> None:
        """Write the assignment of a value to entry j of the array ``name``, or its addition if the array is summed.

        For an array that passes from row to row in registers, nothing is written: the value is kept in ``new_values``.
        """
        if name in self.register_values:
            # A later block must not load it again: its array in memory may have changed by then.
            self.entry_of_value.pop(value.text, None)
            self.new_values[name, j] = value
            return
        number = self.number
        value, self.number = self._converted(value, number, self._number_of(name)), self._number_of(name)
        if name in self.plan.summed:
            value = self._write_operation(ca.OP_ADD, value, self._load_entry(name, j, again=True))
        text = self._vector_text(value) if name in self.plan.lanes else value.text
        self._append_lines(
            f"store {self._array_type(name)} {text}, ptr {self._write_address(name, j)}, align {self._alignment(name)}"
        )
        self.number = number

    def _converted(self, value: Value, number: str, wanted: str, local: bool = False) -> Value:
        """Return a value of the type ``number`` (double or float) as a value of the type ``wanted``.

        The instruction that converts it is written, unless the types are the same. ``local``: as for
        `_write_instruction`.
        """
        if number == wanted:
            return value
        vector = f"<{self.width} x {{}}>" if value.vector else "{}"
        operation = "fptrunc" if wanted == "float" else "fpext"
        return self._write_instruction(
            f"{operation} {vector.format(number)} {value.text} to {vector.format(wanted)}",
            vector=value.vector,
            constant=value.constant,
            local=local,
        )

    def _number_of(self, name: str) -> str:
        """Return LLVM's name of the type of the numbers of the array ``name``: ``double`` or ``float``."""
        return "float" if name in self.plan.single else "double"

    def _array_type(self, name: str) -> str:
        """Return LLVM's name of the type of an entry of the array ``name``: a number, or a vector of one per lane."""
        number = self._number_of(name)
        return f"<{self.width} x {number}>" if name in self.plan.lanes else number

    def _alignment(self, name: str) -> int:
        """Return the bytes of which the address of an entry of the array ``name`` is a multiple."""
        return 4 if name in self.plan.single else 8

    def _type_text(self, vector: bool) -> str:
        """Return LLVM's name of the type: a vector of ``width`` doubles if ``vector`` is true, else ``double``."""
        return f"<{self.width} x {self.number}>" if vector else self.number

    def _append_lines(self, *lines: str) -> None:
        """Append lines of IR to the loop over the rows.

        While a stage is written as a separate function, the loop's lines are those of this function.
        """
        self.loop_lines.extend(lines)
