"""Export to C99: one header of static inline functions that includes only math.h."""

from __future__ import annotations

import math
from collections.abc import Sequence

from seatrial.ident.data import WORK_UNIT
from seatrial.ident.export.c_simulation import SIMULATION
from seatrial.ident.export.codegen import C, Content, Program, comment, header
from seatrial.ident.export.codegen import write as write_lines

# Names that generated variables must not have: arguments of the functions, keywords of C, names of math.h.
WORDS = """x u p y dx dt x_next at k1 k2 k3 k4 i
auto break case char const continue default do double else enum extern float for goto if inline int long register
restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh sqrt exp log log1p expm1 erf atan2 hypot fmod remainder
copysign pow fabs fmin fmax floor ceil y0 y1 yn j0 j1 jn gamma signgam NAN INFINITY HUGE_VAL"""
TAKEN = frozenset(WORDS.split())
STEP_FUNCTION = """
/* States after dt [s], at most 0.1 s, for constant inputs: one step of Runge-Kutta 4. x_next may be the array x. */
static inline void NAME_step(const double x[], const double u[], const double p[], double dt, double x_next[])
{
    double k1[NAME_NX], k2[NAME_NX], k3[NAME_NX], k4[NAME_NX], at[NAME_NX];
    int i;
    NAME_f(x, u, p, k1);
    for (i = 0; i < NAME_NX; i++) at[i] = x[i] + dt / 2.0 * k1[i];
    NAME_f(at, u, p, k2);
    for (i = 0; i < NAME_NX; i++) at[i] = x[i] + dt / 2.0 * k2[i];
    NAME_f(at, u, p, k3);
    for (i = 0; i < NAME_NX; i++) at[i] = x[i] + dt * k3[i];
    NAME_f(at, u, p, k4);
    for (i = 0; i < NAME_NX; i++) x_next[i] = x[i] + dt / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
}
"""


def write(content: Content) -> str:
    """Return the text of the C99 header file of a model, from its collected content.

    Raise ValueError if the model uses an operation that C lacks.
    """
    guard = f"{content.name.upper()}_MODEL_H"
    head = [
        *header(content, "C99", f"{content.name}_advance"),
        "",
        f"{content.name}_advance has one value for each physical input.",
    ]
    head.append(f"{content.name}_inputs gives u from one value for each physical input, without a past.")
    head = [line.replace("*/", "* /").replace("/*", "/ *") for line in head]
    return "\n".join(
        [
            "/*",
            *(f" * {line}".rstrip() for line in head),
            " */",
            f"#ifndef {guard}",
            f"#define {guard}",
            "",
            "#include <math.h>",
            "",
            *_index_enumerations(content),
            "",
            *_array_lines(
                content, "parameters", [(v, comment(content, i)) for i, v in enumerate(content.values)], "default of p"
            ),
            *_array_lines(
                content,
                "state_noise",
                [(v, n) for n, v in zip(content.states, content.state_noise, strict=True)],
                "diffusion of each state [unit/sqrt(s)]",
            ),
            *_array_lines(
                content,
                "output_noise",
                [(v, n) for n, v in zip(content.outputs, content.output_noise, strict=True)],
                "standard deviation of the noise of each output [unit]",
            ),
            _function(content, "f", "dx", content.programs[0], "Rates of the states [unit/s]."),
            _function(content, "h", "y", content.programs[1], "Sensor outputs without noise."),
            STEP_FUNCTION.replace("NAME_", f"{content.name}_"),
            *_history_lines(content),
            SIMULATION.replace("NAME_", f"{content.name}_"),
            *_shaft_speed_lines(content),
            "#endif",
            "",
        ]
    )


def _index_enumerations(content: Content) -> list[str]:
    """Return enumerations of the indices (NAME_x_STATE etc.) and of the sizes.

    The sizes are NAME_NX, NAME_NU, NAME_NY, NAME_NP, and NAME_NIN for the physical inputs.
    """
    lines = []
    for letter, names in (
        ("x", content.states),
        ("u", content.inputs),
        ("y", content.outputs),
        ("p", content.parameters),
        ("in", content.physical_inputs),
    ):
        members = [f"    {content.name}_{letter}_{n}," for n in names]
        lines += ["enum {", *members, f"    {content.name}_N{letter.upper()}", "};"]
    return lines


def _history_lines(content: Content) -> list[str]:
    """Return the constants that `SIMULATION` needs: arrays over the inputs and over the physical inputs, and limits."""
    past, name = content.history, content.name
    physical, n = past.inputs, len(past.inputs)

    def array(kind: str, name: str, values: Sequence[float | bool], description: str) -> str:
        """Return the line of the C array NAME_``name`` of type ``kind``, with ``description`` as its comment.

        Truth values become 0 and 1. C has no arrays without elements, so an empty array gets one zero.
        """
        numbers = ", ".join(repr(v) if isinstance(v, float) else str(int(v)) for v in values) or "0"
        return f"static const {kind} {content.name}_{name}[] = {{{numbers}}}; /* {description} */"

    return [
        array("int", "source", past.sources, "index of the physical input of each input; -1: time, -2: work"),
        array("double", "delay", past.delays, "delay of each input behind its source [s]"),
        array("int", "linear", past.linear, "1: a physical input is linear between its samples, 0: held"),
        array("int", "angle", [i.angle for i in physical], "1: a physical input is an angle"),
        array("int", "keeps_mean", [i.prefilter for i in physical], "1: the line of a linear input keeps its mean"),
        array("int", "shaft", [k in past.shafts for k in range(n)], "1: the input work depends on a physical input"),
        f"#define {name}_MAX_STEP {past.max_step!r} /* longest step of the integration [s]; longer ones are divided */",
        f"#define {name}_WORK_UNIT {WORK_UNIT!r} /* s */",
        f"#define {name}_TIME {content.late[0]!r} /* default of the input t: the end of the fitted data [s] */",
        f"#define {name}_WORK {content.late[1]!r} /* default of the input work: the end of the fitted data */",
        f"#define {name}_LONGEST_DELAY_US {math.ceil(max(past.longest, default=0.0) * 1e6 - 1e-3)} /* microseconds */",
    ]


def _shaft_speed_lines(content: Content) -> list[str]:
    """Return the lines of the function from thrust to shaft speed; none if the inputs of the model are no thrusts."""
    if content.thrust_curve is None:
        return []
    c1, c2 = (C.number(v) for v in content.thrust_curve)
    return [
        f"/* Shaft speed at which a thruster has this thrust [{content.unit('N')}], limited to full speed, -1 to 1. */",
        f"static inline double {content.name}_shaft_speed(double thrust)",
        "{",
        f"    const double c1 = {c1}, c2 = {c2};",
        "    return thrust >= 0.0 ? fmin(sqrt(thrust / (c1 + c2)), 1.0) : fmax(-sqrt(-thrust / (c1 - c2)), -1.0);",
        "}",
    ]


def _array_lines(content: Content, name: str, rows: Sequence[tuple[float, str]], description: str) -> list[str]:
    """Return the lines of a C array NAME_``name`` of values, with a comment beside each.

    ``rows`` are pairs of value and comment. ``description`` is the comment above the array. C has no arrays without
    elements, so an empty array gets one zero.
    """
    values = [f"    {C.number(v)}, /* {text.replace('*/', '* /').replace('/*', '/ *')} */" for v, text in rows]
    return [f"/* {description} */", f"static const double {content.name}_{name}[] = {{", *(values or ["    0.0"]), "};"]


def _function(content: Content, name: str, result: str, program: Program, description: str) -> str:
    """Return the text of one C function of states, inputs and parameters (x, u, p) that writes to an array argument.

    ``result`` is the name of that argument, and ``program`` has the assignments that compute its elements.
    ``name`` is ``f`` for the rates of the states or ``h`` for the outputs. Arguments that the program does not use are
    cast to void, which avoids a compiler warning. ``description`` is the comment above the function.
    """
    lines, ends = write_lines(program, C, [*TAKEN, *program.used])
    arguments = [(s, f"x[{content.name}_x_{n}]") for s, n in zip(content.symbols[0], content.states, strict=True)]
    arguments += [(s, f"u[{content.name}_u_{n}]") for s, n in zip(content.symbols[1], content.inputs, strict=True)]
    ids = dict(zip([p.name for p in content.exported_parameters], content.parameters, strict=True))
    arguments += [
        (s, f"p[{content.name}_p_{ids[p.name]}]")
        for s, p in zip(content.symbols[2], content.model.parameters, strict=True)
        if p.name in ids
    ]
    used = [f"    const double {s} = {value};" for s, value in arguments if s in program.used]
    unused = [  # avoids the compiler's warning about an unused argument
        f"    (void){letter};"
        for letter in "xup"
        if not any(v.startswith(f"{letter}[") and s in program.used for s, v in arguments)
    ]
    letter, names = ("x", content.states) if name == "f" else ("y", content.outputs)
    out = [f"    {result}[{content.name}_{letter}_{n}] = {end};" for n, end in zip(names, ends, strict=True)]
    return "\n".join(
        [
            "",
            f"/* {description} */",
            f"static inline void {content.name}_{name}(const double x[], const double u[], const double p[], "
            f"double {result}[])",
            "{",
            *used,
            *unused,
            *("    " + line for line in lines),
            *out,
            "}",
        ]
    )
