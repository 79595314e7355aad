"""Code generation: the graph of a model as straight-line code in any language that has a ``Syntax``.

Common subexpressions are named once. Signals of the model (forces, thrusts) keep their names, ``cos(psi)`` becomes
``cos_psi``; the rest are numbered. Syntaxes: plain Python, C99 and Python with CasADi.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from ident.model import Model, Signals

ATOM, UNARY, PRODUCT, SUM = 100, 30, 20, 10  # precedence of an expression
LONGEST = 50  # characters of an expression that stays inside another
NAMED = {ca.OP_SIN: "sin", ca.OP_COS: "cos", ca.OP_FABS: "abs", ca.OP_SQRT: "root", ca.OP_TANH: "tanh",
         ca.OP_EXP: "exp", ca.OP_SQ: "square"}
# One argument or two, named alike in math (Python), math.h (C99) and CasADi.
SHARED = (
    "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "sqrt", "exp",
    "log", "log1p", "expm1", "erf",
)
SHARED_TWO = ["atan2", "hypot", "fmod", "remainder", "copysign"]
Templates = dict[int, tuple[str, int]]


@dataclass(frozen=True)
class Syntax:
    """How a language writes operations.

    templates: by CasADi's operation, a text with ``{0}`` and ``{1}`` for the operands, and how tightly it binds;
    operands of a function's template stand alone, others are put into parentheses as needed. ``number`` writes a
    constant.
    """

    templates: Mapping[int, tuple[str, int]]
    number: Callable[[float], str]
    assign: str = "{name} = {value}"


def _arithmetic() -> Templates:
    return {
        ca.OP_ADD: ("{0} + {1}", SUM), ca.OP_SUB: ("{0} - {1}", SUM), ca.OP_MUL: ("{0} * {1}", PRODUCT),
        ca.OP_DIV: ("{0} / {1}", PRODUCT), ca.OP_NEG: ("-{0}", UNARY), ca.OP_TWICE: ("2.0 * {0}", PRODUCT),
        ca.OP_INV: ("1.0 / {0}", PRODUCT), ca.OP_SQ: ("{0} * {0}", PRODUCT),
    }


def _functions(prefix: str) -> Templates:
    one = {getattr(ca, "OP_" + n.upper()): (f"{prefix}{n}({{0}})", ATOM) for n in SHARED}
    return one | {getattr(ca, "OP_" + n.upper()): (f"{prefix}{n}({{0}}, {{1}})", ATOM) for n in SHARED_TWO}


def _truth(template: str, both: str, either: str) -> Templates:
    """Comparisons, whose values are 0 and 1; ``template`` makes a number of a condition."""
    relations = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}
    table = {code: (template.format(f"{{0}} {sign} {{1}}"), ATOM) for code, sign in relations.items()}
    return table | {
        ca.OP_NOT: (template.format("{0} == 0.0"), ATOM),
        ca.OP_AND: (template.format(f"{{0}} != 0.0 {both} {{1}} != 0.0"), ATOM),
        ca.OP_OR: (template.format(f"{{0}} != 0.0 {either} {{1}} != 0.0"), ATOM),
    }


PYTHON = Syntax(
    _arithmetic() | _functions("") | _truth("float({0})", "and", "or") | {
        ca.OP_POW: ("pow({0}, {1})", ATOM), ca.OP_CONSTPOW: ("pow({0}, {1})", ATOM),
        ca.OP_FABS: ("abs({0})", ATOM), ca.OP_FMIN: ("min({0}, {1})", ATOM), ca.OP_FMAX: ("max({0}, {1})", ATOM),
        ca.OP_FLOOR: ("float(floor({0}))", ATOM), ca.OP_CEIL: ("float(ceil({0}))", ATOM),
        ca.OP_SIGN: ("float(({0} > 0.0) - ({0} < 0.0))", ATOM), ca.OP_IF_ELSE_ZERO: ("({1} if {0} else 0.0)", ATOM),
    },
    lambda value: _number(value, "inf", "nan"),
)
C = Syntax(
    _arithmetic() | _functions("") | _truth("(double)({0})", "&&", "||") | {
        ca.OP_POW: ("pow({0}, {1})", ATOM), ca.OP_CONSTPOW: ("pow({0}, {1})", ATOM),
        ca.OP_FABS: ("fabs({0})", ATOM), ca.OP_FMIN: ("fmin({0}, {1})", ATOM), ca.OP_FMAX: ("fmax({0}, {1})", ATOM),
        ca.OP_FLOOR: ("floor({0})", ATOM), ca.OP_CEIL: ("ceil({0})", ATOM),
        ca.OP_SIGN: ("(double)(({0} > 0.0) - ({0} < 0.0))", ATOM),
        ca.OP_IF_ELSE_ZERO: ("(({0}) != 0.0 ? ({1}) : 0.0)", ATOM),
    },
    lambda value: _number(value, "INFINITY", "NAN"),
    "const double {name} = {value};",
)
CASADI = Syntax(
    _arithmetic() | _functions("ca.") | _truth("({0})", "", "") | {
        ca.OP_NOT: ("ca.logic_not({0})", ATOM), ca.OP_AND: ("ca.logic_and({0}, {1})", ATOM),
        ca.OP_OR: ("ca.logic_or({0}, {1})", ATOM),
        ca.OP_POW: ("ca.power({0}, {1})", ATOM), ca.OP_CONSTPOW: ("ca.power({0}, {1})", ATOM),
        ca.OP_FABS: ("ca.fabs({0})", ATOM), ca.OP_FMIN: ("ca.fmin({0}, {1})", ATOM),
        ca.OP_FMAX: ("ca.fmax({0}, {1})", ATOM), ca.OP_FLOOR: ("ca.floor({0})", ATOM),
        ca.OP_CEIL: ("ca.ceil({0})", ATOM), ca.OP_SIGN: ("ca.sign({0})", ATOM),
        ca.OP_IF_ELSE_ZERO: ("ca.if_else({0}, {1}, 0.0)", ATOM),
    },
    lambda value: _number(value, "ca.inf", "ca.nan"),
)
ca.GlobalOptions.setNumpyMode(-1)  # plain numpy functions on symbols stay symbolic


@dataclass
class Node:
    """An operation on other nodes; ``code`` -1: a symbol, -2: a number (``text``: its name or value)."""

    code: int
    operands: tuple[int, ...] = ()
    symbol: str = ""
    value: float = 0.0
    label: str = ""
    uses: int = 0


@dataclass(frozen=True)
class Program:
    """Nodes in the order of computing; ``results``: which node is which result; ``used``: symbols that matter."""

    nodes: list[Node]
    results: tuple[int, ...]
    used: frozenset[str] = field(default=frozenset())


def programs(model: Model, names: Sequence[Sequence[str]]) -> tuple[Program, Program]:
    """Rates and outputs of a model; ``names``: what states, inputs, parameters and outputs are called in the code."""
    symbols = [[ca.SX.sym(n) for n in part] for part in names[:3]]
    s = model.signals(*symbols)
    labels = dict(_signals(s))
    rates = [ca.SX(s.rate[v.name]) for v in model.states]
    outputs = [ca.SX(s.y[o.name]) for o in model.outputs]
    return (_program(symbols, rates, labels, [f"rate_{n.partition('_')[2]}" for n in names[0]]),
            _program(symbols, outputs, labels, names[3]))


def parameters_of(model: Model) -> set[str]:
    """Names of the parameters that rates or outputs depend on."""
    parts = (("x", model.states), ("u", model.inputs), ("p", model.parameters), ("y", model.outputs))
    names = [[f"{kind}{i}" for i in range(len(part))] for kind, part in parts]
    used = {symbol for program in programs(model, names) for symbol in program.used}
    return {p.name for name, p in zip(names[2], model.parameters, strict=True) if name in used}


def _signals(s: Signals) -> Iterator[tuple[str, Any]]:
    """The quantities that a model names itself: forces, and those of each thruster."""
    for name, value in vars(s).items():
        if isinstance(value, ca.SX) and value.is_scalar():
            yield _word(name), value
        elif isinstance(value, dict) and name not in ("rate", "y"):
            yield from ((_word(f"{name}_{key}"), one) for key, one in value.items() if isinstance(one, ca.SX))


def _word(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_]", "_", name)


def _program(symbols: list[list[Any]], results: list[Any], labels: Mapping[str, Any], names: Sequence[str]
             ) -> Program:
    known = ca.cse([ca.densify(e) for e in [*results, *labels.values()]])
    flat = [one for part in symbols for one in part]
    f = ca.Function("lines", flat, known, {"allow_free": False})
    nodes: list[Node] = []
    slot: dict[int, int] = {}
    ends = [0] * f.n_out()
    for k in range(f.n_instructions()):
        code, given = f.instruction_id(k), f.instruction_input(k)
        if code == ca.OP_OUTPUT:
            ends[f.instruction_output(k)[0]] = slot[given[0]]
            continue
        if code == ca.OP_INPUT:
            node = Node(-1, symbol=str(flat[given[0]]))
        elif code == ca.OP_CONST:
            node = Node(-2, value=f.instruction_constant(k))
        else:
            node = Node(code, tuple(slot[i] for i in given))
        slot[f.instruction_output(k)[0]] = len(nodes)
        nodes.append(node)
    for name, end in list(zip(labels, ends[len(results):], strict=True))[::-1]:  # the first name of a thing stays
        nodes[end].label = name
    for name, end in zip(names, ends, strict=False):
        nodes[end].label = nodes[end].label or name
    return _counted(nodes, tuple(ends[:len(results)]))


def _counted(nodes: list[Node], results: tuple[int, ...]) -> Program:
    """How often each node is used by the results; what they do not need is used zero times."""
    for end in results:
        nodes[end].uses += 1
    used = set()
    for node in reversed(nodes):
        if node.uses:
            for operand in node.operands:
                nodes[operand].uses += 1
            if node.code == -1:
                used.add(node.symbol)
    return Program(nodes, results, frozenset(used))


def write(program: Program, syntax: Syntax, taken: Iterable[str]) -> tuple[list[str], list[str]]:
    """Lines of code, and what each result is called after them (an expression). ``taken``: names not to be used."""
    writer = _Writer(program, syntax, set(taken))
    return writer.run(), [writer.text[end][0] for end in program.results]


class _Writer:
    def __init__(self, program: Program, syntax: Syntax, taken: set[str]) -> None:
        self.nodes, self.syntax, self.taken, self.count = program.nodes, syntax, taken, 0
        self.text: dict[int, tuple[str, int]] = {}
        twice = {n.operands[0] for n in self.nodes if n.uses and n.code >= 0 and self._repeats(n)}
        self.named = {k for k, n in enumerate(self.nodes) if n.code >= 0 and (n.uses > 1 or n.label or k in twice)}

    def _repeats(self, node: Node) -> bool:
        return self._template(node)[0].count("{0}") > 1

    def _template(self, node: Node) -> tuple[str, int]:
        try:
            return self.syntax.templates[node.code]
        except KeyError:
            raise ValueError(f"the model uses an operation (CasADi's number {node.code}) that cannot be exported"
                             ) from None

    def run(self) -> list[str]:
        lines = []
        for k, node in enumerate(self.nodes):
            if not node.uses:
                continue
            text, tight = self._expression(node)
            if node.code >= 0 and (k in self.named or len(text) > LONGEST):
                name = self._name(node)
                lines.append(self.syntax.assign.format(name=name, value=text))
                text, tight = name, ATOM
            self.text[k] = (text, tight)
        return lines

    def _expression(self, node: Node) -> tuple[str, int]:
        if node.code == -1:
            return node.symbol, ATOM
        if node.code == -2:
            return self.syntax.number(node.value), UNARY if math.copysign(1.0, node.value) < 0 else ATOM
        template, tight = self._template(node)
        operands = []
        for position, operand in enumerate(node.operands):
            text, own = self.text[operand]
            # a - (b - c) keeps its parentheses, and a + (b + c) too: rounding is to stay what it was
            last = position > 0 or node.code in (ca.OP_NEG, ca.OP_INV)
            loose = own < tight or (own == tight and last)
            operands.append(f"({text})" if loose and tight < ATOM else text)
        return template.format(*operands), tight

    def _name(self, node: Node) -> str:
        name = node.label
        if not name and len(node.operands) == 1:
            (operand,) = node.operands
            leaf, function = self.nodes[operand], NAMED.get(node.code)
            if function and (leaf.code == -1 or operand in self.named):
                name = f"{function}_{self.text[operand][0].partition('_')[2] or self.text[operand][0]}"
        if not name or name in self.taken:
            self.count += 1
            while f"t{self.count}" in self.taken:
                self.count += 1
            name = f"t{self.count}"
        self.taken.add(name)
        return name


def _number(value: float, infinite: str, nan: str) -> str:
    if math.isnan(value):
        return nan
    return repr(value) if math.isfinite(value) else infinite if value > 0 else f"-{infinite}"
