"""Export to CasADi: a Python file that builds ``casadi.Function``s and saves them for ``casadi.Function.load``."""

from __future__ import annotations

from seatrial.ident.export.codegen import CASADI, Content, Program, header
from seatrial.ident.export.codegen import write as write_lines
from seatrial.ident.export.python import constants, unpacked

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


if __name__ == "__main__":
    save(*sys.argv[1:2])
'''


def write(content: Content) -> str:
    """Return the text of the Python file that builds the CasADi functions of a model, from its collected content."""
    head = header(content, "CasADi")
    head += [
        "",
        "f(x, u, p), h(x, u, p) and step(x, u, dt, p) are casadi.Functions; DEFAULTS is p in the order of P.",
        f"Run this file to save them: python FILE [FOLDER] writes {content.name}_f.casadi, {content.name}_h.casadi and",
        f"{content.name}_step.casadi. casadi.Function.load reads them without this file, also in C++ and Matlab.",
    ]
    return "\n".join(
        [
            *("# " + line if line else "#" for line in head),
            "",
            "import os",
            "import sys",
            "",
            "import casadi as ca",
            "",
            *constants(content),
            "",
            _function(content, "_f", content.programs[0]),
            _function(content, "_h", content.programs[1]),
            END.replace("NAME", content.name),
        ]
    )


def _function(content: Content, name: str, program: Program) -> str:
    """Return the text of one Python function ``name`` of CasADi symbols (x, u, p) that returns the list of results."""
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
