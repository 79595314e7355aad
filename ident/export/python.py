"""Export to plain Python: one file that imports only the standard library."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from itertools import groupby

from seatrial.ident.data import WORK_UNIT
from seatrial.ident.export.codegen import (
    PYTHON,
    SHORTEST_GROUP,
    Content,
    Program,
    comment,
    copies_sentence,
    description_lines,
    provenance_lines,
)
from seatrial.ident.export.codegen import write as write_lines
from seatrial.ident.export.python_simulation import NEEDED_FOR_PAST, PAST, SIMULATION

FUNCTION_CALL = re.compile(r"\b([a-z][a-z0-9]*)\(")
BUILT_IN = {"abs", "min", "max", "float"}
MARGIN = 0.05  # by which a measured shaft speed may exceed full speed, or the data of the fit
RESERVED = {"x", "u", "p", "dt", "f", "h", "step", "inf", "nan"}
STEP_FUNCTION = '''
def step(x, u, dt, p=P):
    """Return the states after dt [s], at most 0.1 s, for constant inputs: one step of Runge-Kutta 4."""
    k1 = f(x, u, p)
    k2 = f([a + dt / 2 * k for a, k in zip(x, k1)], u, p)
    k3 = f([a + dt / 2 * k for a, k in zip(x, k2)], u, p)
    k4 = f([a + dt * k for a, k in zip(x, k3)], u, p)
    return [a + dt / 6 * (b + 2 * c + 2 * d + e) for a, b, c, d, e in zip(x, k1, k2, k3, k4)]
'''

SHAFT_SPEED = '''

def shaft_speed(thrust):
    """Return the shaft speed at which a thruster has this thrust [UNIT], -1 to 1.

    The thrust is limited to that of full speed, c1 + c2 ahead and c1 - c2 astern of THRUST_CURVE. A thrust more than
    5 % beyond it gives a warning.
    """
    c1, c2 = THRUST_CURVE
    n = (thrust / (c1 + c2)) ** 0.5 if thrust >= 0 else -((-thrust / (c1 - c2)) ** 0.5)
    if abs(n) > 1.05**0.5:
        limits = f"{c2 - c1:.4g} to {c1 + c2:.4g} UNIT"
        warn(f"the thrust {thrust:.4g} UNIT is beyond full speed, {limits}: full speed is used", stacklevel=2)
    return min(max(n, -1.0), 1.0)
'''


def write(content: Content) -> str:
    """Return the text of the Python file of a model, from its collected content. It imports only the standard library.

    Raise ValueError if the model uses an operation that the export lacks.
    """
    body = "\n".join(
        [
            _function(
                content,
                "f",
                content.programs[0],
                "Return the rates of the states [unit/s]; x and u are sequences of numbers.",
            ),
            _function(content, "h", content.programs[1], "Return the sensor outputs without noise."),
            STEP_FUNCTION,
            PAST,
            SIMULATION,
            *([SHAFT_SPEED.replace("UNIT", content.unit("N"))] if content.thrust_curve else []),
        ]
    )
    limits = _limits(content)
    imported = sorted(
        NEEDED_FOR_PAST
        | {n for n in FUNCTION_CALL.findall(body) if n in _math_functions()}
        | {n for n in ("inf", "nan") if re.search(rf"\b{n}\b", limits + body)}
    )
    about = ["inputs_from gives u from one value for each physical input, without a past."]
    if content.inputs != content.physical_inputs:
        about.append("PHYSICAL_INPUTS has their names. INPUTS has those of the inputs of f and h, with delayed copies.")
    head = [*description_lines(content), "", *about]
    parts = [*_docstring(content), *("# " + line if line else "#" for line in head), ""]
    parts += ["from difflib import get_close_matches", f"from math import {', '.join(imported)}"]
    parts += [*(["from warnings import warn"] if content.thrust_curve else []), ""]
    return "\n".join([*parts, *constants(content), limits, "", body])


def _docstring(content: Content) -> list[str]:
    """Return the lines of the docstring of the file: the provenance of the model, and an example of a simulation."""
    example = ", ".join(["0.5"] * len(content.physical_inputs))
    lines = [
        *provenance_lines(content, "Python"),
        "",
        copies_sentence(content, "Simulation.step"),
        "    simulation = Simulation(0.1)  # step [s]",
        f"    x = simulation.step([{example}])  # states after the step",
    ]
    escaped = [line.replace("\\", "\\\\").replace('"', '\\"') for line in lines]
    return ['"""' + escaped[0], *escaped[1:], '"""', ""]


def _limits(content: Content) -> str:
    """Return the line of the largest allowed size of each physical input of a `Simulation`.

    A shaft speed or command is relative to full speed, so 1.05 is the limit. Data of the fit that exceed 1 raise it.
    All other inputs have none.
    """
    limits = []
    for name, signal in zip(content.physical_inputs, content.history.inputs, strict=True):
        relative = not signal.unit and re.fullmatch(r"n(_.*)?", name)
        covered = max([1.0, *map(abs, content.validity.get(name, ()))])
        limits.append(round((1.0 + MARGIN) * covered, 4) if relative else math.inf)
    return f"LIMITS = {_tuple_text(limits)}  # largest size of each physical input: 1 is full speed, with a margin"


def _math_functions() -> set[str]:
    """Return the names of the functions of ``math`` that exported Python code may call."""
    words = {word for template, _ in PYTHON.templates.values() for word in FUNCTION_CALL.findall(template)}
    return words - BUILT_IN


def constants(content: Content) -> list[str]:
    """Return lines of Python that define names, units, parameters, noise and range of validity.

    ``content`` is the collected content of the model. The export to CasADi uses the same lines.
    """
    rows = [
        f"    {json.dumps(n)}: {v!r},  # {comment(content, i)}"
        for i, (n, v) in enumerate(zip(content.parameters, content.values, strict=True))
    ]
    diffusion = [f"    {json.dumps(n)}: {v!r}," for n, v in zip(content.states, content.state_noise, strict=True)]
    deviation = [f"    {json.dumps(n)}: {v!r}," for n, v in zip(content.outputs, content.output_noise, strict=True)]
    valid = [f"    {json.dumps(n)}: ({low!r}, {high!r})," for n, (low, high) in content.validity.items()]
    past = content.history
    units = (
        ("STATE", content.model.states),
        ("INPUT", content.model.inputs),
        ("OUTPUT", content.model.outputs),
        ("PHYSICAL_INPUT", past.inputs),
    )
    return [
        f"STATES = {_tuple_text(content.states)}",
        f"INPUTS = {_inputs_text(content.inputs)}",
        f"OUTPUTS = {_tuple_text(content.outputs)}",
        f"PHYSICAL_INPUTS = {_tuple_text(content.physical_inputs)}",
        *[f"{kind}_UNITS = {_tuple_text([content.unit(signal.unit) for signal in part])}" for kind, part in units],
        "P = {  # value [unit] +- standard error, meaning",
        *rows,
        "}",
        "STATE_NOISE = {  # diffusion of each state [unit/sqrt(s)]",
        *diffusion,
        "}",
        "OUTPUT_NOISE = {  # standard deviation of the noise of each output [unit]",
        *deviation,
        "}",
        "VALID = {  # range of the estimation data: 98 % of the velocities u, v, r, and all inputs",
        *valid,
        "}",
        f"HOLDS = {_tuple_text(content.holds)}  # physical inputs between their samples, as in the fit",
        "# For each input its index in PHYSICAL_INPUTS (-1: time, -2: work), and its delay [s]",
        f"SOURCES = {_tuple_text(past.sources)}",
        f"DELAYS = {_delays_text(content.inputs, past.delays)}",
        f"MAX_STEP = {past.max_step!r}  # longest step of the integration [s]; longer steps are divided",
        "_KEEPS_MEAN, _ANGLES = (",
        f"    {_tuple_text([i.prefilter for i in past.inputs])},",
        f"    {_tuple_text([i.angle for i in past.inputs])},",
        ")",
        f"TIME, WORK = {content.late!r}  # defaults of the inputs t [s] and work of inputs_from: the end of the data",
        *([f"THRUST_CURVE = {content.thrust_curve!r}  # c1, c2 [{content.unit('N')}]"] if content.thrust_curve else []),
        f"_SHAFTS, WORK_UNIT = {_tuple_text(past.shafts)}, {WORK_UNIT!r}  # work is the integral of |n|^3 / WORK_UNIT",
    ]


def _tuple_text(items: Sequence[str | float]) -> str:
    """Return a tuple of texts or numbers as Python code; with more than eight items there are eight in each line.

    A long tuple of few different items, one group after the other, is a sum: ``(0,) * 49 + (1,) * 49``.
    """
    words = [json.dumps(item, ensure_ascii=False) if isinstance(item, str) else repr(item) for item in items]
    groups = [(word, len(list(group))) for word, group in groupby(words)]
    if len(words) > 8 and len(groups) <= 4:
        return " + ".join(f"({word},) * {n}" for word, n in groups)
    if len(words) > 8:
        return "(\n" + "".join(f"    {', '.join(words[k : k + 8])},\n" for k in range(0, len(words), 8)) + ")"
    return f"({', '.join(words)}{',' * (len(words) == 1)})"


def _inputs_text(names: Sequence[str]) -> str:
    """Return the tuple of the names of inputs as Python code, with one line for the numbered copies of an input."""
    runs = _numbered_runs(names)
    if not any(prefix for prefix, _ in runs):
        return _tuple_text(names)
    parts = [
        f"*({json.dumps(prefix)} + str(k) for k in range({numbers.start}, {numbers.stop})),"
        if prefix
        else "".join(f"{json.dumps(names[i])}, " for i in numbers).rstrip()
        for prefix, numbers in runs
    ]
    return "(\n" + "".join(f"    {part}\n" for part in parts) + ")"


def _delays_text(names: Sequence[str], delays: Sequence[float]) -> str:
    """Return the tuple of the delays of inputs [s] as Python code, with one line for the numbered copies of an input.

    If the delays of numbered copies are no multiples of a step, all delays are listed.
    """
    parts, i = list[str](), 0
    for prefix, numbers in _numbered_runs(names):
        of_run = delays[i : i + len(numbers)]
        i += len(numbers)
        step = of_run[-1] / numbers[-1] if prefix else 0.0
        if not prefix:
            parts.append("".join(f"{delay!r}, " for delay in of_run).rstrip())
        elif [step * k for k in numbers] == list(of_run):
            parts.append(f"*({step!r} * k for k in range({numbers.start}, {numbers.stop})),")
        else:
            return _tuple_text(delays)
    if all(part[0] != "*" for part in parts):
        return _tuple_text(delays)
    return "(\n" + "".join(f"    {part}\n" for part in parts) + ")"


def _numbered_runs(names: Sequence[str]) -> list[tuple[str, range]]:
    """Return consecutive runs of names: numbered ones as prefix and numbers, others as an empty prefix and indices.

    A run of numbered names has at least `SHORTEST_GROUP` names with numbers one after the other.
    """
    runs = list[tuple[str, range]]()
    split = [(m[1], int(m[2])) if (m := re.fullmatch(r"(\w*?)(0|[1-9]\d*)", n)) else (n, 0) for n in names]
    for _, group in groupby(enumerate(split), lambda item: (item[1][0], item[1][1] - item[0])):
        (i, (prefix, first)), *rest = group
        n = 1 + len(rest)
        if n >= SHORTEST_GROUP:
            runs.append((prefix, range(first, first + n)))
        elif runs and not runs[-1][0]:
            runs[-1] = ("", range(runs[-1][1].start, i + n))
        else:
            runs.append(("", range(i, i + n)))
    return runs


def unpacked(content: Content, program: Program) -> list[str]:
    """Return indented lines of Python that unpack the arguments x, u and p into the symbols of a program.

    States and inputs are taken by index, parameters by name. Symbols that the program does not use are left out.
    """
    xs, us, ps = content.symbols
    rows = [(s, f"x[{i}]") for i, s in enumerate(xs)] + [(s, f"u[{j}]") for j, s in enumerate(us)]
    lines = [
        f"    {', '.join(s for s, _ in group)} = {', '.join(v for _, v in group)}"
        for part in (rows[: len(xs)], rows[len(xs) :])
        for group in _groups_of_four(part, program)
    ]
    key_of = dict(zip([p.name for p in content.exported_parameters], content.parameters, strict=True))
    parameters = [
        (s, f'p["{key_of[q.name]}"]') for s, q in zip(ps, content.model.parameters, strict=True) if q.name in key_of
    ]
    return lines + [
        f"    {', '.join(s for s, _ in group)} = {', '.join(v for _, v in group)}"
        for group in _groups_of_four(parameters, program)
    ]


def _groups_of_four(rows: list[tuple[str, str]], program: Program) -> list[list[tuple[str, str]]]:
    """Return the pairs (symbol, value) that a program uses, in groups of at most four, in their order."""
    used = [row for row in rows if row[0] in program.used]
    return [used[i : i + 4] for i in range(0, len(used), 4)]


def _function(content: Content, name: str, program: Program, docstring: str) -> str:
    """Return the text of a Python function ``name`` of (x, u, p=P) that returns the list of results of a program.

    ``content`` of the exported file gives the order of states in x and of inputs in u, and the keys of parameters in p.
    """
    lines, results = write_lines(program, PYTHON, [*RESERVED, *_math_functions(), *BUILT_IN, *program.used])
    returned = [f"        {r}," for r in results]
    return "\n".join(
        [
            "",
            f"def {name}(x, u, p=P):",
            f'    """{docstring}"""',
            *unpacked(content, program),
            *("    " + line for line in lines),
            "    return [",
            *returned,
            "    ]",
            "",
        ]
    )
