"""LLVM IR of a plan: a loop over rows that contains the instructions of all stages.

Values that depend on constants only are computed before the loop. A stage with arrays in lanes becomes a separate
function, called for each group of lanes. In this function, values that depend on lanes are vectors, and all other
values are scalars. Carried values are kept in registers, unless a function needs their address. The arithmetic follows
the instructions of CasADi, and equal instructions are written only once.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from functools import partial, reduce
from typing import Any, NamedTuple

import casadi as ca

from seatrial.ident.engine.expressions import instructions
from seatrial.ident.engine.llvm_operations import (
    COMPARISONS,
    FAST,
    FLUSH_TO_ZERO,
    LIBRARY,
    STRICT,
    TEMPLATES,
    rewritten,
)
from seatrial.ident.engine.loop_plan import Gram, LoopSegment, Plan, Product

FRAME = '"frame-pointer"="all"'  # function attribute with which LLVM can align the stack for spilled vectors


class Value(NamedTuple):
    """Number in the generated program.

    Attributes
    ----------
    text : str
        Name or literal in the IR.
    vector : bool
        Whether the number has one value for each lane.
    constant : bool
        Whether the number is the same in all rows.
    """

    text: str
    vector: bool
    constant: bool


def _literal(x: float) -> Value:
    """Return a number as a hexadecimal literal of LLVM."""
    return Value(f"0x{struct.unpack('<Q', struct.pack('<d', float(x)))[0]:016X}", False, True)


ZERO, ONE = _literal(0.0), _literal(1.0)


def _pointers(names: Iterable[str], attribute: str = "") -> str:
    """Return the pointer arguments of these arrays, separated by commas."""
    return ", ".join(f"ptr {attribute} %{name}" for name in names)


class LlvmEmitter:
    """Writer of the LLVM IR of one plan.

    Attributes
    ----------
    entry : list[str]
        Lines before the loop.
    body : list[str]
        Lines in the loop.
    functions : list[str]
        Lines of the functions that the loop calls.
    """

    def __init__(self, plan: Plan) -> None:
        """Prepare the writer; `ir` writes the module."""
        self.plan = plan
        self.entry: list[str] = []
        self.body: list[str] = []
        self.functions: list[str] = []
        self.declared: set[str] = set()  # functions of the C library
        self.memo: dict[Any, Value] = {}  # values by the instruction that computes them
        self.count = 0  # number of named values so far
        self.flags = FAST
        self.number = 0  # index of the current stage
        self.grouped = False  # whether the current stage is a separate function
        self.width = plan.width  # width of the current vectors
        # values of the arrays in registers, and the new values that the current stage computes
        self.held = {
            name: [Value(f"%held.{name}.{j}", False, False) for j in range(plan.sizes[name])]
            for name in plan.sizes
            if name in plan.carried and not self._in_memory(name)
        }
        self.fresh: dict[tuple[str, int], Value] = {}

    def ir(self) -> str:
        """Return the text of the module, which defines one public function, ``kernel``."""
        for number, part in enumerate(self.plan.stages):
            self.number = number
            self._part(part)
        steps = "".join(f", i64 %step.{name}" for name in self.plan.summed)
        row = "%last, %i" if self.plan.backward else "%i, 0"
        fetched, held, kept = self._ends()
        return "\n".join(
            [
                *FLUSH_TO_ZERO.declared,
                *sorted(self.declared),
                *self.functions,
                f"define void @kernel(i64 %n, i64 %groups, ptr %mask, {_pointers(self.plan.sizes)}{steps}) {FRAME} {{",
                "entry:",
                *FLUSH_TO_ZERO.first,
                *self.entry,
                *fetched,
                "%last = sub i64 %n, 1",
                "br label %loop",
                "loop:",
                f"%i = phi i64 [0, %entry], [%i.next, %end{self.number}]",
                *held,
                f"%k = sub i64 {row}",
                "%mask.p = getelementptr i32, ptr %mask, i64 %k",
                "%mask.k = load i32, ptr %mask.p",
                *self.body,
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
        """Return whether a carried array needs an address, for a function or for vectors of several entries."""
        for part in self.plan.stages:
            if isinstance(part, Product) and name in (part.right, part.result):
                return True
            if isinstance(part, LoopSegment):
                names = {*part.function.name_in(), *part.function.name_out()}
                if name in names and names & self.plan.lanes:
                    return True
        return name in self.plan.lanes

    def _ends(self) -> tuple[list[str], list[str], list[str]]:
        """Return the lines that move arrays in registers: load before the loop, pass to the next row, store after the
        loop.
        """
        fetched, held, kept = [], [], []
        for name, values in self.held.items():
            for j, value in enumerate(values):
                at, first = f"%held.{name}.{j}.p", f"%held.{name}.{j}.first"
                fetched += [f"{at} = getelementptr double, ptr %{name}, i64 {j}", f"{first} = load double, ptr {at}"]
                held.append(f"%held.{name}.{j} = phi double [{first}, %entry], [{value.text}, %end{self.number}]")
                kept.append(f"store double {value.text}, ptr {at}")
        return fetched, held, kept

    # Stages

    def _part(self, part: LoopSegment | Gram | Product) -> None:
        """Write one stage. Skip the stage in rows whose mask lacks its bit."""
        q = self.number
        if part.bit is None:
            self._write(f"br label %do{q}")
        else:
            self._write(
                f"%bit{q} = and i32 %mask.k, {1 << part.bit}",
                f"%on{q} = icmp ne i32 %bit{q}, 0",
                f"br i1 %on{q}, label %do{q}, label %end{q}",
            )
        self._write(f"do{q}:")
        if isinstance(part, Gram):
            self._gram(part)
        elif isinstance(part, Product):
            self._product(part)
            self._write(f"br label %end{q}")
        elif self.plan.lanes.isdisjoint([*part.function.name_in(), *part.function.name_out()]):
            self._instructions(part)
            self._write(f"br label %end{q}")
        else:
            self._lanes(part)
        self._write(f"end{q}:")
        self._settle(part.bit is not None)

    def _settle(self, sometimes: bool) -> None:
        """Assign the new values of the current stage to the arrays in registers.

        ``sometimes``: the stage is skipped in some rows, where the arrays keep their old values.
        """
        q, before = self.number, f"%end{self.number - 1}" if self.number else "%loop"
        for (name, j), value in self.fresh.items():
            old = self.held[name][j]
            if sometimes:
                self._write(f"%held.{name}.{j}.{q} = phi double [{value.text}, %do{q}], [{old.text}, {before}]")
                value = Value(f"%held.{name}.{j}.{q}", False, False)
            self.held[name][j] = value
        self.fresh = {}

    def _instructions(self, part: LoopSegment) -> None:
        """Write the instructions of one stage."""
        f = part.function
        arguments, names = f.name_in(), f.name_out()
        late: list[tuple[str, int, Value]] = []

        def done(i: int, j: int, value: Value) -> None:
            if names[i] in arguments or names[i] in self.plan.summed:
                late.append((names[i], j, value))  # the stage may still have to read the old value
            else:
                self._store(names[i], j, value)  # a value stored at once needs no register any more

        instructions(f, lambda i, j: self._load(arguments[i], j), self._constant, self._apply, done)
        for result in late:
            self._store(*result)

    def _lanes(self, part: LoopSegment) -> None:
        """Write a stage with arrays in lanes as a function, and its call for each group of lanes."""
        q, f = self.number, part.function
        used = list(dict.fromkeys([*f.name_in(), *f.name_out()]))
        steps = [name for name in used if name in self.plan.summed]
        outer, self.body, self.grouped = self.body, [], True
        self._instructions(part)
        declared = "".join(f", i64 %step.{name}" for name in steps)
        self.functions += [
            f"define internal void @stage{q}(i64 %k, i64 %g, i64 %groups, {_pointers(used, 'noalias')}{declared}) "
            f"noinline {FRAME} {{",
            *self.body,
            "ret void",
            "}",
        ]
        self.body, self.grouped = outer, False
        self._group_loop(
            f"do{q}",
            f"g{q}",
            "0",
            [f"call void @stage{q}(i64 %k, i64 %g{q}, i64 %groups, {_pointers(used)}{declared})"],
            f"end{q}",
        )

    def _group_loop(self, origin: str, index: str, first: str, body: list[str], end: str, tail: str = "") -> None:
        """Write a loop of ``index`` from ``first`` to the last group.

        ``origin`` is the block before the loop, ``end`` the block after it. ``tail`` is the last block of the body, if
        the body has several blocks.
        """
        block = f"loop.{index}"
        self._write(
            f"br label %{block}",
            f"{block}:",
            f"%{index} = phi i64 [{first}, %{origin}], [%{index}.next, %{tail or block}]",
            *body,
            f"%{index}.next = add i64 %{index}, 1",
            f"%more.{index} = icmp slt i64 %{index}.next, %groups",
            f"br i1 %more.{index}, label %{block}, label %{end}",
        )

    def _gram(self, part: Gram) -> None:
        """Write the loops over all pairs of groups on and above the diagonal."""
        q = self.number
        self._gram_function(part)
        call = f"call void @stage{q}(i64 %a{q}, i64 %b{q}, i64 %groups, {_pointers([part.source, part.result])})"
        outer, self.body = self.body, []
        self._group_loop(f"loop.a{q}", f"b{q}", f"%a{q}", [call], f"tail{q}")
        inner, self.body = self.body, outer
        self._group_loop(f"do{q}", f"a{q}", "0", [*inner, f"tail{q}:"], f"end{q}", tail=f"tail{q}")

    def _gram_function(self, part: Gram) -> None:
        """Write the function that adds the products of all lanes of two groups."""
        width, vector = self.plan.width, self._type(True)
        lines = [
            f"%left = mul i64 %a, {part.entries * width}",
            f"%right = mul i64 %b, {part.entries}",
            "%line = mul i64 %a, %groups",
            "%block = add i64 %line, %b",
            f"%first = mul i64 %block, {width}",
            f"%scalars = getelementptr double, ptr %{part.source}, i64 %left",
            f"%vectors = getelementptr {vector}, ptr %{part.source}, i64 %right",
            f"%sums = getelementptr {vector}, ptr %{part.result}, i64 %first",
        ]
        for e in range(part.entries):
            lines += [
                f"%b{e}.p = getelementptr {vector}, ptr %vectors, i64 {e}",
                f"%b{e} = load {vector}, ptr %b{e}.p, align 8",
            ]
        for i in range(width):
            lines += [
                f"%s{i}.p = getelementptr {vector}, ptr %sums, i64 {i}",
                f"%s{i}.0 = load {vector}, ptr %s{i}.p, align 8",
            ]
            for e in range(part.entries):
                t = f"{i}.{e}"
                lines += [
                    f"%a{t}.p = getelementptr double, ptr %scalars, i64 {e * width + i}",
                    f"%a{t} = load double, ptr %a{t}.p, align 8",
                    f"%i{t} = insertelement {vector} poison, double %a{t}, i32 0",
                    f"%v{t} = shufflevector {vector} %i{t}, {vector} poison, <{width} x i32> zeroinitializer",
                    f"%m{t} = fmul {FAST} {vector} %v{t}, %b{e}",
                    f"%s{i}.{e + 1} = fadd {FAST} {vector} %s{i}.{e}, %m{t}",
                ]
            lines.append(f"store {vector} %s{i}.{part.entries}, ptr %s{i}.p, align 8")
        arguments = _pointers([part.source, part.result], "noalias")
        self.functions += [
            f"define internal void @stage{self.number}(i64 %a, i64 %b, i64 %groups, {arguments}) noinline {FRAME} {{",
            *lines,
            "ret void",
            "}",
        ]

    def _product(self, part: Product) -> None:
        """Write a matrix product with vectors along the rows of the right matrix."""
        self.width = part.width
        for i, line in enumerate(part.left):
            factors = [self._load(factor.array, factor.place) for factor in line]
            factors = [
                self._op("fadd {F} {T} {0}, {0}", value) if factor.twice else value
                for factor, value in zip(line, factors, strict=True)
            ]
            for first in range(0, part.stride, part.width):
                terms = []
                for j, value in enumerate(factors):
                    at = self._address(part.right, j * part.stride + first)
                    right = self._op(f"load {{T}}, ptr {at}, align 8", vector=True, constant=False)
                    terms.append(self._op("fmul {F} {T} {0}, {1}", value, right))
                at = self._address(part.result, i * part.stride + first)
                self._write(f"store {self._type(True)} {self._sum(terms).text}, ptr {at}, align 8")
        self.width = self.plan.width

    def _sum(self, terms: list[Value]) -> Value:
        """Add the terms in two independent halves, which the processor can compute at the same time."""
        self.flags = STRICT  # with FAST, LLVM would reorder the additions into one chain
        half = (len(terms) + 1) // 2
        first, *more = [
            reduce(partial(self._op, "fadd {F} {T} {0}, {1}"), part) for part in (terms[:half], terms[half:]) if part
        ]
        total = self._op("fadd {F} {T} {0}, {1}", first, *more) if more else first
        self.flags = FAST
        return total

    # Instructions

    def _constant(self, x: float) -> Value:
        """Return the literal of a number. Raise ValueError for NaN, which CasADi inserts for a lost symbol."""
        if math.isnan(x):
            raise ValueError(
                "the model converts its symbols to numbers (math.sin, float(), np.zeros); use numpy's functions"
            )
        return _literal(x)

    def _apply(self, code: int, *a: Value) -> Value:
        """Write one CasADi operation."""
        if code in TEMPLATES:
            return self._op(TEMPLATES[code], *a)
        if code in (ca.OP_DIV, ca.OP_INV):  # the reciprocal is shared, and moves before the loop if it is constant
            r = self._op("fdiv {F} {T} {0}, {1}", ONE, a[-1])
            return self._apply(ca.OP_MUL, a[0], r) if code == ca.OP_DIV else r
        if code in rewritten():
            self.flags = STRICT  # the range reduction of sin and cos relies on the order of its operations
            result = instructions(rewritten()[code], lambda i, j: a[i], self._constant, self._apply)[0][0]
            self.flags = FAST
            return result
        if code in COMPARISONS:
            return self._select(COMPARISONS[code], a[0], a[1], ONE)
        if code == ca.OP_IF_ELSE_ZERO:
            return self._select("une", a[0], ZERO, a[1])
        if code in LIBRARY:
            return self._call(LIBRARY[code], *a)
        raise NotImplementedError(f"the engine does not support CasADi's operation {code}")

    def _op(
        self, template: str, *args: Value, vector: bool = False, constant: bool = True, again: bool = False
    ) -> Value:
        """Write an instruction, unless it was written before. Return its value.

        In the template, ``{T}`` is the type, ``{S}`` its name in intrinsics, ``{F}`` the floating-point flags.
        ``again``: write the instruction in any case.
        """
        vector = vector or any(a.vector for a in args)
        constant = constant and not self.grouped and all(a.constant for a in args)
        operands = [self._splat(a) if vector else a.text for a in args]
        code = template.format(
            *operands, T=self._type(vector), S=f"v{self.width}f64" if vector else "f64", F=self.flags
        )
        key = code if constant else (code, self.number)
        if again or key not in self.memo:
            self.count += 1
            self.memo[key] = Value(f"%.{self.count}", vector, constant)
            self._write(f"%.{self.count} = {code}", constant=constant)
        return self.memo[key]

    def _select(self, comparison: str, x: Value, y: Value, result: Value) -> Value:
        """Return ``result`` if the comparison holds, otherwise zero."""
        c = self._op(f"fcmp {comparison} {{T}} {{0}}, {{1}}", x, y)
        test = f"<{self.plan.width} x i1>" if c.vector else "i1"
        return self._op(
            f"select {test} {c.text}, {{T}} {{0}}, {{T}} {{1}}", result, ZERO, vector=c.vector, constant=c.constant
        )

    def _call(self, name: str, *a: Value) -> Value:
        """Call a function of the C library, for each lane separately."""
        if not any(x.vector for x in a):
            self.declared.add(f"declare double @{name}({', '.join(['double'] * len(a))}) memory(none)")
            return self._op(f"call double @{name}({', '.join(f'double {{{i}}}' for i in range(len(a)))})", *a)
        result = Value("poison", True, True)
        for i in range(self.plan.width):
            parts = [
                self._op(f"extractelement {{T}} {{0}}, i32 {i}", x)._replace(vector=False) if x.vector else x for x in a
            ]
            part = self._call(name, *parts)
            result = self._op(f"insertelement {{T}} {{0}}, double {part.text}, i32 {i}", result, constant=part.constant)
        return result

    def _splat(self, a: Value) -> str:
        """Return the text of a value as a vector, with scalars repeated in all lanes."""
        if a.vector:
            return a.text
        if a.text[0] != "%":
            return f"splat (double {a.text})"
        first = self._op(f"insertelement {{T}} poison, double {a.text}, i32 0", vector=True, constant=a.constant)
        zeros = f"<{self.width} x i32> zeroinitializer"
        return self._op(f"shufflevector {{T}} {{0}}, {{T}} poison, {zeros}", first).text

    # Memory

    def _address(self, name: str, j: int) -> str:
        """Return the pointer to entry j of an array in the current row and group."""
        kind, size, pointer = self._type(name in self.plan.lanes), self.plan.sizes[name], f"%{name}"
        offsets: list[str] = []
        if name in self.plan.rows or name in self.plan.summed:
            row = "%k"
            if name in self.plan.summed:  # the step is 0 for a sum over rows and 1 for separate results in each row
                row = self._op(f"mul i64 %k, %step.{name}", constant=False).text
            if name in self.plan.lanes:
                row = self._op(f"mul i64 {row}, %groups", constant=False).text
            offsets.append(row)
        if name in self.plan.lanes:
            offsets.append("%g")
        for offset in offsets:
            entries = self._op(f"mul i64 {offset}, {size}", constant=False).text
            pointer = self._op(f"getelementptr {kind}, ptr {pointer}, i64 {entries}", constant=False).text
        return self._op(f"getelementptr {kind}, ptr {pointer}, i64 {j}", constant=not offsets).text

    def _load(self, name: str, j: int, again: bool = False) -> Value:
        """Return entry j of an array. ``again``: load the entry even if it was loaded before."""
        if name in self.held:
            return self.held[name][j]
        varies = name in self.plan.rows or name in self.plan.carried or again
        return self._op(
            f"load {{T}}, ptr {self._address(name, j)}, align 8",
            vector=name in self.plan.lanes,
            constant=not varies,
            again=again,
        )

    def _store(self, name: str, j: int, value: Value) -> None:
        """Write entry j of an array, or add to the entry if the array is summed."""
        if name in self.held:
            self.fresh[name, j] = value
            return
        lane = name in self.plan.lanes
        if name in self.plan.summed:
            value = self._apply(ca.OP_ADD, value, self._load(name, j, again=True))
        text = self._splat(value) if lane else value.text
        self._write(f"store {self._type(lane)} {text}, ptr {self._address(name, j)}, align 8")

    def _type(self, vector: bool) -> str:
        return f"<{self.width} x double>" if vector else "double"

    def _write(self, *lines: str, constant: bool = False) -> None:
        """Append lines to the loop, or before the loop if they are constant."""
        (self.entry if constant else self.body).extend(lines)
