"""Code generation: the graph of a model as straight-line code in any language that has a ``Syntax``.

Common subexpressions are named once. Signals of the model (forces, thrusts) keep their names, ``cos(psi)`` becomes
``cos_psi``; the rest are numbered. Syntaxes: plain Python, C99 and Python with CasADi.

Content of an export: valid identifiers, parameter values, noise, and the comment header.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from seatrial.ident.data import TIME_INPUT, WORK_INPUT, WORK_UNIT
from seatrial.ident.engine import VectorisedModel
from seatrial.ident.estimation import SavedModel, scale_of
from seatrial.ident.model import Input, Model, Parameter, ParameterRole, Signals, State
from seatrial.ident.numerics import Array


@dataclass(frozen=True)
class Content:
    """A model ready for export.

    Attributes:
        states, inputs, outputs, parameters: valid identifiers in the order of the model; parameters without those of
            noise.
        values, errors: of ``parameters`` (NaN: no standard error).
        state_noise: diffusions [unit/sqrt(s)].
        output_noise: standard deviations, with the lasting errors that are not exported.
        left_out: disturbance states that are not exported.
        lasting: for how long [s] what they add to an output lasts, by output.
        silent: those that are in neither noise, as they do nothing at rest.
    """

    name: str
    model: Model
    saved: SavedModel
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    values: tuple[float, ...]
    errors: tuple[float, ...]
    state_noise: tuple[float, ...]
    output_noise: tuple[float, ...]
    left_out: tuple[str, ...]
    lasting: Mapping[str, float]
    silent: tuple[str, ...]

    @cached_property
    def own(self) -> tuple[Parameter, ...]:
        """The parameters of ``parameters``."""
        used = parameters_of(self.model)
        return tuple(p for p in self.model.parameters if p.name in used)

    @cached_property
    def symbols(self) -> tuple[list[str], list[str], list[str]]:
        """Identifiers of states, inputs and all parameters of the model in the code."""
        name_of = dict(zip([p.name for p in self.own], self.parameters, strict=True))
        return (
            [f"x_{n}" for n in self.states],
            [f"u_{n}" for n in self.inputs],
            [f"p_{name_of.get(p.name, f'unused_{i}')}" for i, p in enumerate(self.model.parameters)],
        )

    @cached_property
    def programs(self) -> tuple[Program, Program]:
        """Programs of the rates and of the outputs."""
        return programs(self.model, [*self.symbols, [f"out_{n}" for n in self.outputs]])

    @property
    def angles(self) -> tuple[str, ...]:
        """Outputs that are angles."""
        return tuple(n for n, o in zip(self.outputs, self.model.outputs, strict=True) if o.angle)

    @property
    def validity(self) -> dict[str, tuple[float, float]]:
        """Ranges of the data, by identifier, of what is still there."""
        names = dict(zip([s.name for s in self.model.states], self.states, strict=True))
        names |= dict(zip([i.name for i in self.model.inputs], self.inputs, strict=True))
        return {names[k]: v for k, v in self.saved.validity.items() if k in names}


def content(saved: SavedModel, *, name: str | None = None, nuisance: bool = False) -> Content:
    """Everything the exporters need of a saved model."""
    model, gone = (saved.model, ()) if nuisance else without_nuisance(saved.model)
    used = parameters_of(model)
    own = [p for p in model.parameters if p.name in used]
    values = model.values
    noise = [values[s.noise] if isinstance(s.noise, str) else float(s.noise) for s in model.states]
    extra = equivalent_noise(saved.model, model)
    white = [values[o.noise] if o.noise else 0.0 for o in model.outputs]
    outputs = identifiers(o.name for o in model.outputs)
    return Content(
        prefix(name or model.name),
        model,
        saved,
        identifiers(s.name for s in model.states),
        identifiers(i.name for i in model.inputs),
        outputs,
        identifiers(p.name for p in own),
        tuple(p.value for p in own),
        tuple(saved.errors.get(p.name, math.nan) for p in own),
        tuple(math.hypot(a, b) for a, b in zip(noise, extra.process, strict=True)),
        tuple(math.hypot(a, b) for a, b in zip(white, extra.output, strict=True)),
        tuple(s.name for s in gone),
        {n: tau for n, tau in zip(outputs, extra.lasting, strict=True) if tau > 0.0},
        extra.silent,
    )


def identifiers(names: Iterable[str]) -> tuple[str, ...]:
    """Unique identifiers that are valid in any language: ``n_left~3`` becomes ``n_left_ago_3``."""
    found: list[str] = []
    for name in names:
        valid = re.sub(r"[^A-Za-z0-9_]", "_", name.replace("~", "_ago_"))
        valid = f"_{valid}" if not valid or valid[0].isdigit() else valid
        k, unique = 2, valid
        while unique in found:
            k, unique = k + 1, f"{valid}_{k}"
        found.append(unique)
    return tuple(found)


def prefix(name: str) -> str:
    """Prefix of functions and files: starts with a letter, without two underscores in a row (CasADi)."""
    valid = re.sub(r"_+", "_", re.sub(r"[^A-Za-z0-9]", "_", name)).strip("_")
    return valid if valid[:1].isalpha() else f"model_{valid}".rstrip("_")


def without_nuisance(model: Model) -> tuple[Model, tuple[State, ...]]:
    """The model without disturbance forces and random-walk sensor biases, and the removed states."""
    effects = [e for e in model.effects if e.kind.nuisance]
    states = {s.name for e in effects for s in e.states} | {s.name for s in model.states if s.nuisance}
    parameters = {p.name for e in effects for p in e.parameters}
    parameters |= {p.name for p in model.parameters if p.role is ParameterRole.DISTURBANCE}
    inputs = {i.name for e in effects for i in e.inputs} - {
        i.name for e in model.effects for i in e.inputs if not e.kind.nuisance
    }
    smaller = replace(
        model,
        states=tuple(s for s in model.states if s.name not in states),
        inputs=tuple(i for i in model.inputs if i.name not in inputs),
        parameters=tuple(p for p in model.parameters if p.name not in parameters),
        effects=tuple(e for e in model.effects if not e.kind.nuisance),
    )
    return smaller, tuple(s for s in model.states if s.name in states)


@dataclass(frozen=True)
class EquivalentNoise:
    """White noise in place of removed states: process (n_states,) [unit/sqrt(s)] and output (n_outputs,) [unit] of the
    states and outputs that are kept; lasting (n_outputs,): integral time scale of what they add to an output [s]; 0:
    nothing; silent: removed states with a noise of their own that do nothing at rest, and so are in neither."""

    process: Array
    output: Array
    lasting: Array
    silent: tuple[str, ...]


def equivalent_noise(whole: Model, kept: Model) -> EquivalentNoise:
    """Removed Gauss-Markov states, which may drive each other, as white noise, by the Jacobians at rest: of the rates
    with the same spectral density at frequencies below theirs, of the outputs with their stationary variance, by
    Lyapunov's equation; the mean over headings, which turn a sideslip. Random walks, which have no such variance, are
    left out. What they add to an output lasts for its integral time scale, the area under its autocorrelation."""
    names, left = [s.name for s in whole.states], {s.name for s in kept.states}
    values, compiled = whole.values, VectorisedModel(whole)
    angles = {o.name for o in whole.outputs if o.angle}
    turned = [0.5 * np.pi * (s.from_output in angles) for s in whole.states]
    x = np.arange(4)[:, None] * np.array(turned)
    at_rest = x, np.zeros((4, len(whole.inputs))), np.array(list(values.values()))
    A, H = compiled.rate_jacobian(*at_rest), compiled.output_jacobian(*at_rest)
    gone = [j for j, s in enumerate(whole.states) if s.name not in left and A[0, j, j] < 0]
    q = np.array([values[s.noise] if isinstance(s.noise, str) else s.noise for s in (whole.states[j] for j in gone)])
    if not gone:
        none = np.zeros(len(whole.outputs))
        return EquivalentNoise(np.zeros(len(left)), none, none, ())
    own, H = A[:, gone][:, :, gone], H[:, :, gone]
    to_rates, inverse = A[:, [names.index(s.name) for s in kept.states]][:, :, gone], np.linalg.inv(own)
    covariance = np.array([solve_continuous_lyapunov(a, -np.diag(q**2)) for a in own]).reshape(own.shape)
    rates = ((to_rates @ inverse * q) ** 2).sum(axis=2).mean(axis=0)
    outputs = np.einsum("hij,hjk,hik->hi", H, covariance, H).mean(axis=0)
    area = -np.einsum("hij,hjk,hik->hi", H, inverse @ covariance, H).mean(axis=0)
    reach = np.abs(np.concatenate([to_rates, H], axis=1) @ inverse).max(axis=(0, 1), initial=0.0)
    return EquivalentNoise(
        np.sqrt(rates),
        np.sqrt(outputs),
        np.divide(area, outputs, out=np.zeros_like(area), where=outputs > 0.0),
        tuple(names[j] for j, far in zip(gone, reach, strict=True) if far == 0.0),
    )


def header(c: Content, target: str) -> list[str]:
    """Comment header: model, provenance, meaning of the names, range of validity."""
    made = c.saved.provenance
    lines = [f"{c.model.name}: a fitted model, written for {target} by seatrial.", ""]
    lines += [f"{label}: {made[key]}" for label, key in (("made by", "made_by"), ("on", "created")) if key in made]
    lines += [f"fitted to: {log}" for log in made.get("logs", [])]
    if c.model.effects:
        lines.append("effects: " + ", ".join(e.name for e in c.model.effects))
    lines += ["", "dx/dt = f(x, u; p), y = h(x, u; p); SI units and radians. States x, inputs u, outputs y:"]
    lines += [
        f"  x[{i}] {n} {_unit(s.unit)} {s.meaning}".rstrip()
        for i, (n, s) in enumerate(zip(c.states, c.model.states, strict=True))
    ]
    lines += _inputs(c)
    lines += [
        f"  y[{i}] {n} {_unit(o.unit)}" + (", an angle" if o.angle else "")
        for i, (n, o) in enumerate(zip(c.outputs, c.model.outputs, strict=True))
    ]
    if c.validity:
        lines += ["", "Range of the fitted data (not validated beyond it):"]
        lines += [f"  {n} from {low:.4g} to {high:.4g}" for n, (low, high) in c.validity.items()]
    return [" ".join(line.splitlines()) for line in lines + _remarks(c)]


def _inputs(c: Content) -> list[str]:
    lines, past = [], [i for i in c.model.inputs if i.tap]
    for j, (n, i) in enumerate(zip(c.inputs, c.model.inputs, strict=True)):
        if i.tap:
            lines.append(f"  u[{j}] {n}: {i.tap_of}, {i.delay:g} s ago")
        else:
            lines.append(f"  u[{j}] {n} {_unit(i.unit)}{_described(i)}")
    if past:
        step = past[0].delay / past[0].tap
        lines += [
            f"  (NAME_ago_K, in seatrial NAME~K, is the input NAME of K times {step:g} s ago: keep a",
            "  buffer of it; of a held command its mean since the last step is better than its last value.)",
        ]
    return lines


def _described(signal: Input) -> str:
    if signal.name == TIME_INPUT:
        return ", the time since the start of the run"
    if signal.name == WORK_INPUT:
        return f", the integral of |n_left|^3 + |n_right|^3 over time, divided by {WORK_UNIT:g} s"
    if signal.tap_of:
        return f", the command of {signal.delay:g} s ago"
    return ""


def _remarks(c: Content) -> list[str]:
    lines = []
    if c.left_out:
        lines += [
            "",
            f"Left out, as a controller does not need them: {', '.join(c.left_out)}",
            "(disturbance forces and sensor offsets; `--with-disturbance-states` keeps them). Over times longer than",
            "their correlation time the forces are part of the process noise here.",
        ]
    if c.silent:
        lines.append(f"In no noise, since they do nothing at rest: {', '.join(c.silent)}.")
    if c.lasting:
        lasting = ", ".join(f"{n} ({tau:.2g} s)" for n, tau in c.lasting.items())
        lines += [
            f"The noise of outputs has what they add to it, with how long that lasts: {lasting}.",
            "A filter that takes it for white should use samples that far apart, or keep the states.",
        ]
    if ratios := scale_of(c.saved.model).caveats:
        lines += ["", *ratios]
    own = [n for n, p in zip(c.parameters, c.own, strict=True) if p.per_record]
    if own:
        lines += [
            "",
            f"Different in each run: {', '.join(own)}. Set them; the values here are the means of the",
            "fitted runs.",
        ]
    return lines


def _unit(unit: str) -> str:
    return f"[{unit}]" if unit else "[-]"


def comment(c: Content, i: int) -> str:
    """Comment of a parameter: unit, standard error or where its value comes from, meaning."""
    p = c.own[i]
    error = c.errors[i] if p.considered_sd is None else p.considered_sd
    known = f"+- {error:.3g}" if math.isfinite(error) else "" if p.free else f"{p.provenance},"
    return " ".join(" ".join(part for part in (_unit(p.unit), known, p.meaning) if part).split())


ATOM, UNARY, PRODUCT, SUM = 100, 30, 20, 10  # precedence of an expression
LONGEST = 50  # characters of an expression that stays inside another
NAMED = {
    ca.OP_SIN: "sin",
    ca.OP_COS: "cos",
    ca.OP_FABS: "abs",
    ca.OP_SQRT: "root",
    ca.OP_TANH: "tanh",
    ca.OP_EXP: "exp",
    ca.OP_SQ: "square",
}
# One argument or two, named alike in math (Python), math.h (C99) and CasADi.
SHARED = (
    "sin",
    "cos",
    "tan",
    "asin",
    "acos",
    "atan",
    "sinh",
    "cosh",
    "tanh",
    "asinh",
    "acosh",
    "atanh",
    "sqrt",
    "exp",
    "log",
    "log1p",
    "expm1",
    "erf",
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
        ca.OP_ADD: ("{0} + {1}", SUM),
        ca.OP_SUB: ("{0} - {1}", SUM),
        ca.OP_MUL: ("{0} * {1}", PRODUCT),
        ca.OP_DIV: ("{0} / {1}", PRODUCT),
        ca.OP_NEG: ("-{0}", UNARY),
        ca.OP_TWICE: ("2.0 * {0}", PRODUCT),
        ca.OP_INV: ("1.0 / {0}", PRODUCT),
        ca.OP_SQ: ("{0} * {0}", PRODUCT),
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
    _arithmetic()
    | _functions("")
    | _truth("float({0})", "and", "or")
    | {
        ca.OP_POW: ("pow({0}, {1})", ATOM),
        ca.OP_CONSTPOW: ("pow({0}, {1})", ATOM),
        ca.OP_FABS: ("abs({0})", ATOM),
        ca.OP_FMIN: ("min({0}, {1})", ATOM),
        ca.OP_FMAX: ("max({0}, {1})", ATOM),
        ca.OP_FLOOR: ("float(floor({0}))", ATOM),
        ca.OP_CEIL: ("float(ceil({0}))", ATOM),
        ca.OP_SIGN: ("float(({0} > 0.0) - ({0} < 0.0))", ATOM),
        ca.OP_IF_ELSE_ZERO: ("({1} if {0} else 0.0)", ATOM),
    },
    lambda value: _number(value, "inf", "nan"),
)
C = Syntax(
    _arithmetic()
    | _functions("")
    | _truth("(double)({0})", "&&", "||")
    | {
        ca.OP_POW: ("pow({0}, {1})", ATOM),
        ca.OP_CONSTPOW: ("pow({0}, {1})", ATOM),
        ca.OP_FABS: ("fabs({0})", ATOM),
        ca.OP_FMIN: ("fmin({0}, {1})", ATOM),
        ca.OP_FMAX: ("fmax({0}, {1})", ATOM),
        ca.OP_FLOOR: ("floor({0})", ATOM),
        ca.OP_CEIL: ("ceil({0})", ATOM),
        ca.OP_SIGN: ("(double)(({0} > 0.0) - ({0} < 0.0))", ATOM),
        ca.OP_IF_ELSE_ZERO: ("(({0}) != 0.0 ? ({1}) : 0.0)", ATOM),
    },
    lambda value: _number(value, "INFINITY", "NAN"),
    "const double {name} = {value};",
)
CASADI = Syntax(
    _arithmetic()
    | _functions("ca.")
    | _truth("({0})", "", "")
    | {
        ca.OP_NOT: ("ca.logic_not({0})", ATOM),
        ca.OP_AND: ("ca.logic_and({0}, {1})", ATOM),
        ca.OP_OR: ("ca.logic_or({0}, {1})", ATOM),
        ca.OP_POW: ("ca.power({0}, {1})", ATOM),
        ca.OP_CONSTPOW: ("ca.power({0}, {1})", ATOM),
        ca.OP_FABS: ("ca.fabs({0})", ATOM),
        ca.OP_FMIN: ("ca.fmin({0}, {1})", ATOM),
        ca.OP_FMAX: ("ca.fmax({0}, {1})", ATOM),
        ca.OP_FLOOR: ("ca.floor({0})", ATOM),
        ca.OP_CEIL: ("ca.ceil({0})", ATOM),
        ca.OP_SIGN: ("ca.sign({0})", ATOM),
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
    return (
        _program(symbols, rates, labels, [f"rate_{n.partition('_')[2]}" for n in names[0]]),
        _program(symbols, outputs, labels, names[3]),
    )


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


def _program(symbols: list[list[Any]], results: list[Any], labels: Mapping[str, Any], names: Sequence[str]) -> Program:
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
    for name, end in list(zip(labels, ends[len(results) :], strict=True))[::-1]:  # the first name of a thing stays
        nodes[end].label = name
    for name, end in zip(names, ends, strict=False):
        nodes[end].label = nodes[end].label or name
    return _counted(nodes, tuple(ends[: len(results)]))


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
            raise ValueError(
                f"the model uses an operation (CasADi's number {node.code}) that cannot be exported"
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
