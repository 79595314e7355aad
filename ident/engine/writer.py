"""LLVM instructions one by one: arithmetic as CasADi names it, and what lies in memory.

The same instruction is written once in a stage, and before the loop where its operands are the same in all rows.
"""

from __future__ import annotations

import math
import struct
from typing import Any, NamedTuple

import casadi as ca

from ident.engine.operations import COMPARISONS, FAST, LIBRARY, STRICT, TEMPLATES, rewritten
from ident.engine.plan import Plan
from ident.engine.walk import walk


class Value(NamedTuple):
    text: str  # name or literal in the IR
    vector: bool
    constant: bool  # the same in all rows


def _literal(x: float) -> Value:
    return Value(f"0x{struct.unpack('<Q', struct.pack('<d', float(x)))[0]:016X}", False, True)


ZERO, ONE = _literal(0.0), _literal(1.0)


class Writer:
    """``entry`` is what comes before the loop, ``body`` what is in it."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.entry: list[str] = []
        self.body: list[str] = []
        self.declared: set[str] = set()
        self.memo: dict[Any, Value] = {}
        self.count = 0
        self.flags = FAST
        self.number = 0  # of the stage being written
        self.grouped = False  # that stage is a function of its own
        self.width = plan.width  # of the vectors that are being written
        self.held: dict[str, list[Value]] = {}  # what arrays hold that are not in memory within the loop
        self.fresh: dict[tuple[str, int], Value] = {}  # and what the stage being written puts into them

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
            result = walk(rewritten()[code], lambda i, j: a[i], self._constant, self._apply)[0][0]
            self.flags = FAST
            return result
        if code in COMPARISONS:
            return self._select(COMPARISONS[code], a[0], a[1], ONE)
        if code == ca.OP_IF_ELSE_ZERO:
            return self._select("une", a[0], ZERO, a[1])
        if code in LIBRARY:
            return self._call(LIBRARY[code], *a)
        raise NotImplementedError(f"the engine does not know CasADi's operation {code}")

    def _op(self, template: str, *args: Value, vector: bool = False, constant: bool = True,
            again: bool = False) -> Value:
        """Write an instruction, unless the same was written before; returns its value."""
        vector = vector or any(a.vector for a in args)
        constant = constant and not self.grouped and all(a.constant for a in args)
        operands = [self._splat(a) if vector else a.text for a in args]
        code = template.format(*operands, T=self._type(vector), S=f"v{self.width}f64" if vector else "f64",
                               F=self.flags)
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
        return self._op(f"select {test} {c.text}, {{T}} {{0}}, {{T}} {{1}}", result, ZERO,
                        vector=c.vector, constant=c.constant)

    def _call(self, name: str, *a: Value) -> Value:
        """Call the C library, lane by lane."""
        if not any(x.vector for x in a):
            self.declared.add(f'declare double @{name}({", ".join(["double"] * len(a))}) memory(none)')
            return self._op(f'call double @{name}({", ".join(f"double {{{i}}}" for i in range(len(a)))})', *a)
        result = Value("poison", True, True)
        for i in range(self.plan.width):
            parts = [self._op(f"extractelement {{T}} {{0}}, i32 {i}", x)._replace(vector=False) if x.vector else x
                     for x in a]
            part = self._call(name, *parts)
            result = self._op(f"insertelement {{T}} {{0}}, double {part.text}, i32 {i}", result,
                              constant=part.constant)
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
        return self._op(f"load {{T}}, ptr {self._address(name, j)}, align 8", vector=name in self.plan.lanes,
                        constant=not varies, again=again)

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
