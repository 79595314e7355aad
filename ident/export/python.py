"""Plain Python: one file that needs nothing but ``math``."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence

from seatrial.ident.export.codegen import PYTHON, Content, Program, comment, header
from seatrial.ident.export.codegen import write as write_lines

FUNCTIONS = re.compile(r"\b([a-z][a-z0-9]*)\(")
BUILT_IN = {"abs", "min", "max", "float"}
RESERVED = {"x", "u", "p", "dt", "f", "h", "step", "inf", "nan"}
STEP = '''
def step(x, u, dt, p=P):
    """The states after dt [s] with the inputs held: one step of Runge-Kutta 4; take dt no longer than 0.1 s."""
    k1 = f(x, u, p)
    k2 = f([a + dt / 2 * k for a, k in zip(x, k1)], u, p)
    k3 = f([a + dt / 2 * k for a, k in zip(x, k2)], u, p)
    k4 = f([a + dt * k for a, k in zip(x, k3)], u, p)
    return [a + dt / 6 * (b + 2 * c + 2 * d + e) for a, b, c, d, e in zip(x, k1, k2, k3, k4)]
'''


def write(c: Content) -> str:
    """The file."""
    body = "\n".join(
        [
            _function(c, "f", c.programs[0], "Rates of the states [unit/s]; x, u: sequences of numbers."),
            _function(c, "h", c.programs[1], "Outputs, as the sensors would have them without noise."),
            STEP,
        ]
    )
    needed = sorted(
        {n for n in FUNCTIONS.findall(body) if n in _known()}
        | {n for n in ("inf", "nan") if re.search(rf"\b{n}\b", body)}
    )
    parts = [*("# " + line if line else "#" for line in header(c, "Python")), ""]
    parts += [f"from math import {', '.join(needed)}", ""] if needed else []
    return "\n".join([*parts, *constants(c), "", body])


def _known() -> set[str]:
    words = {word for template, _ in PYTHON.templates.values() for word in FUNCTIONS.findall(template)}
    return words - BUILT_IN


def constants(c: Content) -> list[str]:
    """Names, units, parameters and noise, as Python."""
    rows = [
        f"    {json.dumps(n)}: {v!r},  # {comment(c, i)}"
        for i, (n, v) in enumerate(zip(c.parameters, c.values, strict=True))
    ]
    diffusion = [f"    {json.dumps(n)}: {v!r}," for n, v in zip(c.states, c.state_noise, strict=True)]
    deviation = [f"    {json.dumps(n)}: {v!r}," for n, v in zip(c.outputs, c.output_noise, strict=True)]
    valid = [f"    {json.dumps(n)}: ({low!r}, {high!r})," for n, (low, high) in c.validity.items()]
    units = (("STATE", c.model.states), ("INPUT", c.model.inputs), ("OUTPUT", c.model.outputs))
    return [
        f"STATES = {_tuple(c.states)}",
        f"INPUTS = {_tuple(c.inputs)}",
        f"OUTPUTS = {_tuple(c.outputs)}",
        *[f"{kind}_UNITS = {_tuple([one.unit for one in part])}" for kind, part in units],
        "P = {  # value [unit] +- standard error, meaning",
        *rows,
        "}",
        "STATE_NOISE = {  # diffusion of each state [unit/sqrt(s)]",
        *diffusion,
        "}",
        "OUTPUT_NOISE = {  # standard deviation of each output's white noise [unit]",
        *deviation,
        "}",
        "VALID = {  # what the fitted data covered",
        *valid,
        "}",
    ]


def _tuple(items: Sequence[str]) -> str:
    words = [json.dumps(item, ensure_ascii=False) for item in items]
    if len(words) > 8:
        return "(\n" + "".join(f"    {', '.join(words[k : k + 8])},\n" for k in range(0, len(words), 8)) + ")"
    return f"({', '.join(words)}{',' * (len(words) == 1)})"


def unpacked(c: Content, program: Program) -> list[str]:
    """Lines that give what a function needs its names."""
    xs, us, ps = c.symbols
    rows = [(s, f"x[{i}]") for i, s in enumerate(xs)] + [(s, f"u[{j}]") for j, s in enumerate(us)]
    lines = [
        f"    {', '.join(s for s, _ in group)} = {', '.join(v for _, v in group)}"
        for part in (rows[: len(xs)], rows[len(xs) :])
        for group in _grouped(part, program)
    ]
    named = dict(zip([p.name for p in c.own], c.parameters, strict=True))
    held = [(s, f'p["{named[q.name]}"]') for s, q in zip(ps, c.model.parameters, strict=True) if q.name in named]
    return lines + [
        f"    {', '.join(s for s, _ in group)} = {', '.join(v for _, v in group)}" for group in _grouped(held, program)
    ]


def _grouped(rows: list[tuple[str, str]], program: Program) -> list[list[tuple[str, str]]]:
    used = [row for row in rows if row[0] in program.used]
    return [used[i : i + 4] for i in range(0, len(used), 4)]


def _function(c: Content, name: str, program: Program, says: str) -> str:
    lines, results = write_lines(program, PYTHON, [*RESERVED, *_known(), *BUILT_IN, *program.used])
    returned = [f"        {r}," for r in results]
    return "\n".join(
        [
            "",
            f"def {name}(x, u, p=P):",
            f'    """{says}"""',
            *unpacked(c, program),
            *("    " + line for line in lines),
            "    return [",
            *returned,
            "    ]",
            "",
        ]
    )
