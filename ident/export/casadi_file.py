"""Export to CasADi: a Python file that builds ``casadi.Function``s and saves them for ``casadi.Function.load``."""

from __future__ import annotations

from seatrial.ident.export.codegen import CASADI, Content, Program, header
from seatrial.ident.export.codegen import write as write_lines
from seatrial.ident.export.python import SHAFT_SPEED, constants, unpacked
from seatrial.ident.export.python_simulation import NEEDED_FOR_PAST, PAST

RESERVED = {"x", "u", "p", "dt", "f", "h", "step", "ca"}
END = '''
_x, _u, _p, _dt = ca.SX.sym("x", len(STATES)), ca.SX.sym("u", len(INPUTS)), ca.SX.sym("p", len(P)), ca.SX.sym("dt")
f = ca.Function("NAME_f", [_x, _u, _p], [ca.SX(ca.vertcat(*_f(_x, _u, _p)))], ["x", "u", "p"], ["dx"])
h = ca.Function("NAME_h", [_x, _u, _p], [ca.SX(ca.vertcat(*_h(_x, _u, _p)))], ["x", "u", "p"], ["y"])


def _step(x, u, dt, p):
    """Return the states after dt [s], at most 0.1 s, for constant inputs: one step of Runge-Kutta 4."""
    k1 = f(x, u, p)
    k2 = f(x + dt / 2 * k1, u, p)
    k3 = f(x + dt / 2 * k2, u, p)
    k4 = f(x + dt * k3, u, p)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


step = ca.Function("NAME_step", [_x, _u, _dt, _p], [_step(_x, _u, _dt, _p)], ["x", "u", "dt", "p"], ["x_next"])
DEFAULTS = list(P.values())  # default of p


def save(folder="."):
    """Write NAME_f.casadi, NAME_h.casadi and NAME_step.casadi, for casadi.Function.load."""
    for function in (f, h, step):
        function.save(os.path.join(folder, function.name() + ".casadi"))


def make_step(dt, hold=None):
    """Return the function of a step of dt [s] with one value for each physical input, and the names of its states.

    The function is step(z, u, p) -> z_next. z are the states of the model and the past of the inputs; INPUT_past_K
    is the value of the physical input INPUT K steps ago. u are the physical inputs in this step, in the order of
    PHYSICAL_INPUTS. hold is "zero" (constant in a step) or "linear" (reached at the end of the step); by default that
    of the fit, HOLDS. The initial z is that of initial_state.
    """
    z, u, names, values, parts = _with_history(dt, hold)
    x = z[: len(STATES)]
    for duration, lines in parts:
        first, last = (ca.vertcat(*end) for end in _ends(lines, values))
        x = _step_along(x, first, last, duration, _p)
    computed = [values[source][1] for source in (-1, -2) if source in SOURCES]
    z_next = ca.vertcat(x, *computed, *(item for part in values[:-2] for item in part[:-1]))
    return ca.Function("NAME_advance", [z, u, _p], [z_next], ["z", "u", "p"], ["z_next"]), names


def inputs_from(inputs, t=TIME, work=WORK):
    """Return the inputs u of f, h and step for physical inputs that are and were constant, numbers or symbols.

    A delayed input has the present value. The defaults of t and work are those of the end of the fitted data.
    """
    values = [*(inputs[k] for k in range(len(PHYSICAL_INPUTS))), work, t]
    return ca.vertcat(*(values[source] for source in SOURCES))


def make_outputs(dt, hold=None):
    """Return the function outputs(z, u, p) -> y: the outputs at the start of a step of make_step(dt, hold)."""
    z, u, _, values, parts = _with_history(dt, hold)
    y = h(z[: len(STATES)], ca.vertcat(*_ends(parts[0][1], values)[0]), _p)
    return ca.Function("NAME_outputs", [z, u, _p], [y], ["z", "u", "p"], ["y"])


def initial_state(dt, x=None, inputs=None, hold=None, t=0.0, work=0.0):
    """Return the initial z of make_step(dt, hold), for physical inputs that were constant before; zero by default.

    t and work are zero at the start of a log. TIME and WORK are those of the end of the fitted data.
    """
    computed = [value for source, value in ((-1, t), (-2, work)) if source in SOURCES]
    before = [0.0] * len(PHYSICAL_INPUTS) if inputs is None else inputs
    past = [value for value, n in zip(before, _plan(dt, hold)[1]) for _ in range(n - 1)]
    return [*([0.0] * len(STATES) if x is None else x), *computed, *past]


def _with_history(dt, hold):
    """Return symbols of z and of the physical inputs, the names of z, the values of the inputs, and the parts."""
    linear, counts, parts = _plan(dt, hold)
    names = [*STATES, *(name for source, name in ((-1, "time"), (-2, "work")) if source in SOURCES)]
    names += [f"{name}_past_{k}" for name, n in zip(PHYSICAL_INPUTS, counts) for k in range(1, n)]
    z, u = ca.SX.sym("z", len(names)), ca.SX.sym("u", len(PHYSICAL_INPUTS))
    rest = iter([z[k] for k in range(len(STATES), len(names))])
    time, work = (next(rest) if source in SOURCES else 0.0 for source in (-1, -2))
    past = [[next(rest) for _ in range(n - 1)] for n in counts]
    values = _with_past([u[k] for k in range(len(PHYSICAL_INPUTS))], past, linear)
    values += [[work, work + dt * _power(values, linear)], [time, time + dt]]
    return z, u, names, values, parts


def _step_along(x, first, last, dt, p):
    """Return the states after dt [s], for inputs on a line from first to last: one step of Runge-Kutta 4."""
    middle = (first + last) / 2
    k1 = f(x, first, p)
    k2 = f(x + dt / 2 * k1, middle, p)
    k3 = f(x + dt / 2 * k2, middle, p)
    k4 = f(x + dt * k3, last, p)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


if __name__ == "__main__":
    save(*sys.argv[1:2])
'''


def write(content: Content) -> str:
    """Return the text of the Python file that builds the CasADi functions of a model, from its collected content.

    Raise ValueError if the model uses an operation that the export lacks.
    """
    head = header(content, "CasADi", "make_step")
    head += [
        "",
        "f(x, u, p), h(x, u, p) and step(x, u, dt, p) are casadi.Functions; DEFAULTS is p in the order of P.",
        f"Run this file to save them: python FILE [FOLDER] writes {content.name}_f.casadi, {content.name}_h.casadi and",
        f"{content.name}_step.casadi. casadi.Function.load reads them without this file, also in C++ and Matlab.",
        "make_step(dt) returns a step with one value for each physical input, whose states include the past inputs.",
        "inputs_from(inputs) returns u for f, h and step from one value for each physical input, without a past.",
    ]
    return "\n".join(
        [
            *("# " + line if line else "#" for line in head),
            "",
            "import os",
            "import sys",
            f"from math import {', '.join(sorted(NEEDED_FOR_PAST - {'remainder'}))}",
            *(["from warnings import warn"] if content.thrust_curve else []),
            "",
            "import casadi as ca",
            "",
            "remainder = ca.remainder",
            *constants(content),
            "",
            _function(content, "_f", content.programs[0]),
            _function(content, "_h", content.programs[1]),
            PAST,
            *([SHAFT_SPEED.replace("UNIT", content.unit("N"))] if content.thrust_curve else []),
            END.replace("NAME_", f"{content.name}_"),
        ]
    )


def _function(content: Content, name: str, program: Program) -> str:
    """Return the text of one Python function ``name`` of CasADi symbols (x, u, p) that returns the list of results.

    ``program`` computes these results. ``content`` gives the order of states in x, of inputs in u and of parameters in
    p.
    """
    lines, results = write_lines(program, CASADI, [*RESERVED, *program.used])
    named = ["    p = dict(zip(P, ca.vertsplit(p)))"] if any(s in program.used for s in content.symbols[2]) else []
    return "\n".join(
        [
            "",
            f"def {name}(x, u, p):",
            *named,
            *unpacked(content, program),
            *("    " + line for line in lines),
            "    return [",
            *(f"        {r}," for r in results),
            "    ]",
            "",
        ]
    )
