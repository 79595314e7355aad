"""LLVM IR of a plan: the loop over rows with the instructions of its stages written out.

What depends on constants only is computed before the loop. A stage that touches lanes becomes a function of its own,
called for each group of lanes, whose values are vectors where they depend on lanes and scalars where they do not. What
is carried from stage to stage and from row to row is in memory only where it has to be. Arithmetic is taken over from
CasADi operation by operation, and an instruction that was written before is not written again.
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

FRAME = '"frame-pointer"="all"'  # so that LLVM can align the stack for the vectors it keeps there


class Value(NamedTuple):
    """A number of the program. text: its name or literal in the IR; vector: one for each lane; constant: the same in
    all rows."""

    text: str
    vector: bool
    constant: bool


def _literal(x: float) -> Value:
    return Value(f"0x{struct.unpack('<Q', struct.pack('<d', float(x)))[0]:016X}", False, True)


ZERO, ONE = _literal(0.0), _literal(1.0)


def _pointers(names: Iterable[str], attribute: str = "") -> str:
    return ", ".join(f"ptr {attribute} %{name}" for name in names)


class LlvmEmitter:
    """Writes one plan. entry: what comes before the loop; body: what is in it; functions: what it calls."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.entry: list[str] = []
        self.body: list[str] = []
        self.functions: list[str] = []
        self.declared: set[str] = set()  # functions of the C library
        self.memo: dict[Any, Value] = {}  # values by the instruction that gives them
        self.count = 0
        self.flags = FAST
        self.number = 0  # of the stage being written
        self.grouped = False  # that stage is a function of its own
        self.width = plan.width  # of the vectors that are being written
        # what arrays hold that are not in memory within the loop, and what the stage being written puts into them
        self.held = {
            name: [Value(f"%held.{name}.{j}", False, False) for j in range(plan.sizes[name])]
            for name in plan.sizes
            if name in plan.carried and not self._in_memory(name)
        }
        self.fresh: dict[tuple[str, int], Value] = {}

    def ir(self) -> str:
        """The module's text, with one function ``kernel``."""
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
        """Whether a function or vectors of more than one entry need an address of a carried array."""
        for part in self.plan.stages:
            if isinstance(part, Product) and name in (part.right, part.result):
                return True
            if isinstance(part, LoopSegment):
                names = {*part.function.name_in(), *part.function.name_out()}
                if name in names and names & self.plan.lanes:
                    return True
        return name in self.plan.lanes

    def _ends(self) -> tuple[list[str], list[str], list[str]]:
        """Of arrays that are not in memory: how they get there before the loop, from row to row, and back after it."""
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
        """Arrays that are not in memory hold what the stage has put into them, or ``sometimes`` what they held."""
        q, before = self.number, f"%end{self.number - 1}" if self.number else "%loop"
        for (name, j), value in self.fresh.items():
            old = self.held[name][j]
            if sometimes:
                self._write(f"%held.{name}.{j}.{q} = phi double [{value.text}, %do{q}], [{old.text}, {before}]")
                value = Value(f"%held.{name}.{j}.{q}", False, False)
            self.held[name][j] = value
        self.fresh = {}

    def _instructions(self, part: LoopSegment) -> None:
        f = part.function
        given, names = f.name_in(), f.name_out()
        late: list[tuple[str, int, Value]] = []

        def done(i: int, j: int, value: Value) -> None:
            if names[i] in given or names[i] in self.plan.summed:
                late.append((names[i], j, value))  # what is in its place may have to be read yet
            else:
                self._store(names[i], j, value)  # at once: one value less to keep

        instructions(f, lambda i, j: self._load(given[i], j), self._constant, self._apply, done)
        for result in late:
            self._store(*result)

    def _lanes(self, part: LoopSegment) -> None:
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
        """Blocks that run ``body`` for ``index`` from ``first`` to the last group; ``tail``: the last block of
        the body, where it is more than one."""
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
        q = self.number
        self._gram_function(part)
        call = f"call void @stage{q}(i64 %a{q}, i64 %b{q}, i64 %groups, {_pointers([part.source, part.result])})"
        outer, self.body = self.body, []
        self._group_loop(f"loop.a{q}", f"b{q}", f"%a{q}", [call], f"tail{q}")
        inner, self.body = self.body, outer
        self._group_loop(f"do{q}", f"a{q}", "0", [*inner, f"tail{q}:"], f"end{q}", tail=f"tail{q}")

    def _gram_function(self, part: Gram) -> None:
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
        """In two halves, which do not wait for each other."""
        self.flags = STRICT  # or LLVM would make one chain of them
        half = (len(terms) + 1) // 2
        first, *more = [
            reduce(partial(self._op, "fadd {F} {T} {0}, {1}"), part) for part in (terms[:half], terms[half:]) if part
        ]
        total = self._op("fadd {F} {T} {0}, {1}", first, *more) if more else first
        self.flags = FAST
        return total

    # Instructions

    def _constant(self, x: float) -> Value:
        if math.isnan(x):
            raise ValueError("the model makes numbers of its symbols, as by math.sin, float() or filling np.zeros")
        return _literal(x)

    def _apply(self, code: int, *a: Value) -> Value:
        """Write one CasADi operation."""
        if code in TEMPLATES:
            return self._op(TEMPLATES[code], *a)
        if code in (ca.OP_DIV, ca.OP_INV):  # by the reciprocal, which is shared, and hoisted if it is constant
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
        raise NotImplementedError(f"the engine does not know CasADi's operation {code}")

    def _op(
        self, template: str, *args: Value, vector: bool = False, constant: bool = True, again: bool = False
    ) -> Value:
        """Write an instruction, unless the same was written before; returns its value."""
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
        """``result`` where the comparison holds, else zero."""
        c = self._op(f"fcmp {comparison} {{T}} {{0}}, {{1}}", x, y)
        test = f"<{self.plan.width} x i1>" if c.vector else "i1"
        return self._op(
            f"select {test} {c.text}, {{T}} {{0}}, {{T}} {{1}}", result, ZERO, vector=c.vector, constant=c.constant
        )

    def _call(self, name: str, *a: Value) -> Value:
        """Call the C library, lane by lane."""
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
        if a.vector:
            return a.text
        if a.text[0] != "%":
            return f"splat (double {a.text})"
        first = self._op(f"insertelement {{T}} poison, double {a.text}, i32 0", vector=True, constant=a.constant)
        zeros = f"<{self.width} x i32> zeroinitializer"
        return self._op(f"shufflevector {{T}} {{0}}, {{T}} poison, {zeros}", first).text

    # Memory

    def _address(self, name: str, j: int) -> str:
        """Pointer to entry j of the current row and group."""
        kind, size, pointer = self._type(name in self.plan.lanes), self.plan.sizes[name], f"%{name}"
        offsets: list[str] = []
        if name in self.plan.rows or name in self.plan.summed:
            row = "%k"
            if name in self.plan.summed:  # its step is 0, or 1 where every row keeps its own
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
        (self.entry if constant else self.body).extend(lines)
