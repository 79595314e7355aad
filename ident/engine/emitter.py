"""A plan as LLVM IR: the loop over rows with the instructions of its stages written out.

What depends on constants only is computed before the loop. A stage that touches lanes becomes a function of
its own, called for each group of lanes, whose values are vectors where they depend on lanes and scalars where
they do not. What is carried from stage to stage and from row to row is in memory only where it has to be.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial, reduce

from ident.engine.operations import FAST, STRICT
from ident.engine.plan import Gram, Plan, Product, Stage
from ident.engine.walk import walk
from ident.engine.writer import Value, Writer

FRAME = '"frame-pointer"="all"'  # so that LLVM can align the stack for the vectors it keeps there


def _pointers(names: Iterable[str], attribute: str = "") -> str:
    return ", ".join(f"ptr {attribute} %{name}" for name in names)


class Emitter(Writer):
    def __init__(self, plan: Plan) -> None:
        super().__init__(plan)
        self.functions: list[str] = []
        self.held = {name: [Value(f"%held.{name}.{j}", False, False) for j in range(plan.sizes[name])]
                     for name in plan.sizes if name in plan.carried and not self._in_memory(name)}

    def ir(self) -> str:
        for number, part in enumerate(self.plan.stages):
            self.number = number
            self._part(part)
        steps = "".join(f", i64 %step.{name}" for name in self.plan.summed)
        row = "%last, %i" if self.plan.backward else "%i, 0"
        fetched, held, kept = self._ends()
        return "\n".join([
            *sorted(self.declared), *self.functions,
            f"define void @kernel(i64 %n, i64 %groups, ptr %mask, {_pointers(self.plan.sizes)}{steps}) {FRAME} {{",
            "entry:", *self.entry, *fetched, "%last = sub i64 %n, 1", "br label %loop",
            "loop:", f"%i = phi i64 [0, %entry], [%i.next, %end{self.number}]", *held, f"%k = sub i64 {row}",
            "%mask.p = getelementptr i32, ptr %mask, i64 %k", "%mask.k = load i32, ptr %mask.p", *self.body,
            "%i.next = add i64 %i, 1", "%more = icmp slt i64 %i.next, %n", "br i1 %more, label %loop, label %exit",
            "exit:", *kept, "ret void", "}", "",
        ])

    def _in_memory(self, name: str) -> bool:
        """Whether a function or vectors of more than one entry need an address of a carried array."""
        for part in self.plan.stages:
            if isinstance(part, Product) and name in (part.right, part.result):
                return True
            if isinstance(part, Stage):
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

    def _part(self, part: Stage | Gram | Product) -> None:
        q = self.number
        if part.bit is None:
            self._write(f"br label %do{q}")
        else:
            self._write(f"%bit{q} = and i32 %mask.k, {1 << part.bit}", f"%on{q} = icmp ne i32 %bit{q}, 0",
                        f"br i1 %on{q}, label %do{q}, label %end{q}")
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

    def _instructions(self, part: Stage) -> None:
        f = part.function
        given, names = f.name_in(), f.name_out()
        late: list[tuple[str, int, Value]] = []

        def done(i: int, j: int, value: Value) -> None:
            if names[i] in given or names[i] in self.plan.summed:
                late.append((names[i], j, value))  # what is in its place may have to be read yet
            else:
                self._store(names[i], j, value)  # at once: one value less to keep

        walk(f, lambda i, j: self._load(given[i], j), self._constant, self._apply, done)
        for result in late:
            self._store(*result)

    def _lanes(self, part: Stage) -> None:
        q, f = self.number, part.function
        used = list(dict.fromkeys([*f.name_in(), *f.name_out()]))
        steps = [name for name in used if name in self.plan.summed]
        outer, self.body, self.grouped = self.body, [], True
        self._instructions(part)
        declared = "".join(f", i64 %step.{name}" for name in steps)
        self.functions += [
            f"define internal void @stage{q}(i64 %k, i64 %g, i64 %groups, {_pointers(used, 'noalias')}{declared}) "
            f"noinline {FRAME} {{", *self.body, "ret void", "}"]
        self.body, self.grouped = outer, False
        self._group_loop(f"do{q}", f"g{q}", "0", [
            f"call void @stage{q}(i64 %k, i64 %g{q}, i64 %groups, {_pointers(used)}{declared})"], f"end{q}")

    def _group_loop(self, origin: str, index: str, first: str, body: list[str], end: str, tail: str = "") -> None:
        """Blocks that run ``body`` for ``index`` from ``first`` to the last group; ``tail``: the last block of
        the body, where it is more than one."""
        block = f"loop.{index}"
        self._write(f"br label %{block}", f"{block}:",
                    f"%{index} = phi i64 [{first}, %{origin}], [%{index}.next, %{tail or block}]", *body,
                    f"%{index}.next = add i64 %{index}, 1", f"%more.{index} = icmp slt i64 %{index}.next, %groups",
                    f"br i1 %more.{index}, label %{block}, label %{end}")

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
        lines = [f"%left = mul i64 %a, {part.entries * width}", f"%right = mul i64 %b, {part.entries}",
                 "%line = mul i64 %a, %groups", "%block = add i64 %line, %b", f"%first = mul i64 %block, {width}",
                 f"%scalars = getelementptr double, ptr %{part.source}, i64 %left",
                 f"%vectors = getelementptr {vector}, ptr %{part.source}, i64 %right",
                 f"%sums = getelementptr {vector}, ptr %{part.result}, i64 %first"]
        for e in range(part.entries):
            lines += [f"%b{e}.p = getelementptr {vector}, ptr %vectors, i64 {e}",
                      f"%b{e} = load {vector}, ptr %b{e}.p, align 8"]
        for i in range(width):
            lines += [f"%s{i}.p = getelementptr {vector}, ptr %sums, i64 {i}",
                      f"%s{i}.0 = load {vector}, ptr %s{i}.p, align 8"]
            for e in range(part.entries):
                t = f"{i}.{e}"
                lines += [f"%a{t}.p = getelementptr double, ptr %scalars, i64 {e * width + i}",
                          f"%a{t} = load double, ptr %a{t}.p, align 8",
                          f"%i{t} = insertelement {vector} poison, double %a{t}, i32 0",
                          f"%v{t} = shufflevector {vector} %i{t}, {vector} poison, <{width} x i32> zeroinitializer",
                          f"%m{t} = fmul {FAST} {vector} %v{t}, %b{e}",
                          f"%s{i}.{e + 1} = fadd {FAST} {vector} %s{i}.{e}, %m{t}"]
            lines.append(f"store {vector} %s{i}.{part.entries}, ptr %s{i}.p, align 8")
        arguments = _pointers([part.source, part.result], "noalias")
        self.functions += [f"define internal void @stage{self.number}(i64 %a, i64 %b, i64 %groups, {arguments}) "
                           f"noinline {FRAME} {{", *lines, "ret void", "}"]

    def _product(self, part: Product) -> None:
        self.width = part.width
        for i, line in enumerate(part.left):
            factors = [self._load(factor.array, factor.place) for factor in line]
            factors = [self._op("fadd {F} {T} {0}, {0}", value) if factor.twice else value
                       for factor, value in zip(line, factors, strict=True)]
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
        first, *more = [reduce(partial(self._op, "fadd {F} {T} {0}, {1}"), part)
                        for part in (terms[:half], terms[half:]) if part]
        total = self._op("fadd {F} {T} {0}, {1}", first, *more) if more else first
        self.flags = FAST
        return total
