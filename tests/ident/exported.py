"""Models to export, and functions that run an exported model in Python, CasADi and C."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from seatrial.ident.effects.nonparametric import nonparametric_effect
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine.vectorised_model import VectorisedModel
from seatrial.ident.estimation.model_file import SavedModel
from seatrial.ident.export.codegen import without_nuisance
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import ForceCurve, Input, Model, Output, Sensor, State, plain_model
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.kinematic import kinematic_model
from seatrial.ident.models.nomoto import nomoto_model
from seatrial.ident.models.surge import surge_model
from seatrial.ident.models.thruster import thruster_model
from seatrial.ident.models.yaw import yaw_model
from tests.ident.carriers import vehicle_for

CLOSE = 1e-12
# Rows of model.toml with the thrust and the arms of the thrusters as given values
KNOWN_SCALE = "".join(
    f'\n[[parameter]]\nname = "{name}"\nvalue = {value}\nfree = false\norigin = "given"\n'
    for name, value in (("c1", 40.0), ("y_left", -0.2), ("y_right", 0.2))
)
# f(x, u, p), h(x, u, p), step(x, u, dt, p)
Functions = tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any]]


def moved(model: Model, seed: int) -> Model:
    """Return the model with random parameter values. No value is one at which its effect is neutral."""
    rng = np.random.default_rng(seed)
    values = {}
    for p in model.parameters:
        away = p.value * rng.uniform(0.8, 1.25) + (3 * p.step * rng.uniform(0.3, 1) if p.value == 0 else 0.0)
        values[p.name] = float(np.clip(away, *p.bounds))
    return model.with_values(values)


def with_effects(propulsion: Any) -> Model:
    """Return the horizontal model with every effect that it accepts, and a nonparametric curve of each kind."""
    model = horizontal_model(propulsion)
    for effect in catalogue().values():
        if model.accepts(effect):
            model = model + effect
    for curve in (ForceCurve("X", "u"), ForceCurve("N", "psi"), ForceCurve("Y", "u", "r"), ForceCurve("X", "t")):
        model = model + nonparametric_effect(model, curve, (-1.0, 1.5))
    return model


def odd() -> Model:
    """Return a model with invalid or reserved names and every kind of operation."""

    def f(x: Any, u: Any, p: Any) -> dict[str, Any]:
        a, lam = x.a, getattr(p, "lambda")
        wild = np.sign(a) * np.minimum(a * a, 2.0) - np.maximum(np.floor(3 * a), -5.0) + np.arctan2(a, 2.0) / (1 + a)
        logic = ca.logic_and(a > 0, x.x > 0) + ca.logic_or(a > 0, x.x > 0) + ca.logic_not(a > 0) + (a == 0) + (a != 0)
        return {
            "a": lam - (a - (u.N - lam)) + (a <= 0.3) * wild - (-a) / (a * a + 1) - 1 / (2 + a * a),
            "x": np.sqrt(1 + abs(a)) ** 1.5 + np.hypot(a, x.x) + np.log1p(a * a) + np.tanh(x.x) * np.cosh(0.1 * a),
            "k1": (a * a + 0.1) ** p.int + np.fmod(a, 0.7) + ca.if_else(a > 0.1, a * a, -a) + logic,
        }

    return plain_model(
        "odd boat 2!",
        f=f,
        h=lambda x, u, p: {"y 1": 2.0, "y~1": x.a * getattr(u, "N~2"), "y-1": u.N},
        states=(State("a"), State("x"), State("k1")),
        inputs=(Input("N"), Input("N").delayed(2)),
        sensors=(Sensor("s", (Output("y 1", noise="e"), Output("y~1", noise="e"), Output("y-1", noise="e"))),),
        parameters=(
            Parameter("lambda", 0.7, meaning='odd */ /* "name"\nin C'),
            Parameter("int", 1.3),
            Parameter("e", 0.1),
        ),
    )


MODELS = {
    "shaft with every effect": with_effects("shaft"),
    "force with every effect": with_effects("force"),
    "general": horizontal_model("general"),
    "as fitted": with_disturbances(horizontal_model("shaft")) + catalogue()["pendulum"],
    "measured attitude": with_disturbances(kinematic_model(yaw=True)),
    "without sway": with_disturbances(nomoto_model(sampled=True)) + catalogue()["sideslip"],
    "thruster": thruster_model(),
    "surge": surge_model("shaft", "both"),
    "yaw": yaw_model("both"),
    "odd": odd(),
}
ALONE = {n: vehicle_for(e) + e for n, e in catalogue().items() if "bench" not in e.requires}


def saved(model: Model) -> SavedModel:
    return SavedModel(
        model,
        {p.name: 0.1 for p in model.parameters[:2]},
        {"u": (-0.5, 1.2), "gone": (0.0, 1.0)},
        {"made_by": "seatrial ident vehicle a.mcap\n--x", "created": "2026-05-01", "logs": ["a.mcap sha256:12"]},
    )


def points(model: Model, n: int = 12) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    x, u = rng.normal(0.0, 0.8, (n, len(model.states))), rng.uniform(-1, 1, (n, len(model.inputs)))
    x[0], u[0] = 0.0, 0.0
    return x, u


def compare(model: Model, functions: Functions, values: list[float], nuisance: bool) -> None:
    """Compare exported functions with the evaluation of the model by CasADi and with an independent Runge-Kutta
    step.
    """
    f, h, step = functions
    kept = model if nuisance else without_nuisance(model)[0]
    p = np.array(list(kept.values.values()))
    rowwise, n = VectorisedModel(kept), len(kept.states)
    for x, u in zip(*points(kept), strict=True):

        def rate(z: np.ndarray, u: np.ndarray = u) -> np.ndarray:
            return rowwise(z[None], u[None], p)[0, :n]

        both = rowwise(x[None], u[None], p)[0]
        close(f(x, u, values), both[:n])
        close(h(x, u, values), both[n:])
        dt = 0.07
        k1 = rate(x)
        k2 = rate(x + dt / 2 * k1)
        k3 = rate(x + dt / 2 * k2)
        close(step(x, u, dt, values), x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + dt * k3)))


def close(got: Any, wanted: np.ndarray) -> None:
    np.testing.assert_allclose(np.asarray(got, dtype=float).ravel(), wanted, rtol=CLOSE, atol=CLOSE)


def run_python(text: str, folder: Path) -> tuple[Functions, dict[str, Any]]:
    space: dict[str, Any] = {"__name__": "boat"}
    exec(compile(text, "boat.py", "exec"), space)

    def named(values: list[float]) -> dict[str, float]:
        return dict(zip(space["P"], values, strict=True))

    return (
        lambda x, u, p: space["f"](x.tolist(), u.tolist(), named(p)),
        lambda x, u, p: space["h"](x.tolist(), u.tolist(), named(p)),
        lambda x, u, dt, p: space["step"](x.tolist(), u.tolist(), dt, named(p)),
    ), space


def run_casadi(text: str, folder: Path) -> tuple[Functions, dict[str, Any]]:
    """Run the functions after CasADi has saved and loaded them."""
    space: dict[str, Any] = {"__name__": "boat"}
    exec(compile(text, "boat.py", "exec"), space)
    space["save"](str(folder))
    f, h, step = (ca.Function.load(str(folder / f"{space[n].name()}.casadi")) for n in ("f", "h", "step"))
    assert (f.name_in(), f.name_out()) == (["x", "u", "p"], ["dx"])
    assert step.name_in() == ["x", "u", "dt", "p"]
    return (f, h, step), space


MAIN = """
#include <stdio.h>
#include "boat.h"
int main(void)
{
    double x[NAME_NX + 1], u[NAME_NU + 1], p[NAME_NP + 1], dt, out[NAME_NX + NAME_NY];
    int i, kind;
    while (scanf("%d", &kind) == 1) {
        for (i = 0; i < NAME_NX; i++) if (scanf("%lf", &x[i]) != 1) return 1;
        for (i = 0; i < NAME_NU; i++) if (scanf("%lf", &u[i]) != 1) return 1;
        for (i = 0; i < NAME_NP; i++) if (scanf("%lf", &p[i]) != 1) return 1;
        if (scanf("%lf", &dt) != 1) return 1;
        if (kind == 0) NAME_f(x, u, p, out);
        if (kind == 1) NAME_h(x, u, p, out);
        if (kind == 2) { NAME_step(x, u, p, dt, x); for (i = 0; i < NAME_NX; i++) out[i] = x[i]; }
        for (i = 0; i < (kind == 1 ? NAME_NY : NAME_NX); i++) printf("%.17g ", out[i]);
        printf("\\n");
    }
    for (i = 0; i < NAME_NP; i++) fprintf(stderr, "%.17g ", NAME_parameters[i]);
    return NAME_state_noise[0] < 0.0 || NAME_output_noise[0] < 0.0;
}
"""
SIMULATE = """
#include <stdio.h>
#include "boat.h"
static NAME_simulation sim;
int main(void)
{
    double dt, x[NAME_NX], in[NAME_NIN + 1], y[NAME_NY + 1];
    int i, hold, code;
    if (scanf("%d", &hold) != 1) return 1;
    for (i = 0; i < NAME_NX; i++) if (scanf("%lf", &x[i]) != 1) return 1;
    for (i = 0; i < NAME_NIN; i++) if (scanf("%lf", &in[i]) != 1) return 1;
    NAME_init(&sim, x, in, 0);
    for (i = 0; i < NAME_NIN; i++) if (hold >= 0) sim.linear[i] = hold;
    while (scanf("%lf", &dt) == 1) {
        for (i = 0; i < NAME_NIN; i++) if (scanf("%lf", &in[i]) != 1) return 1;
        code = NAME_outputs(&sim, in, dt, y);
        if (code == NAME_OK) for (i = 0; i < NAME_NY; i++) printf("%.17g ", y[i]);
        if (NAME_advance(&sim, in, dt) != code) return 2;
        for (i = 0; i < NAME_NX; i++) printf("%.17g ", sim.x[i]);
        printf("%d\\n", code);
    }
    return 0;
}
"""
HOLDS = {None: -1, "zero": 0, "linear": 1}
Steps = tuple[np.ndarray, np.ndarray]  # states after each step, and outputs before it


def compiler() -> str:
    found = shutil.which("gcc") or shutil.which("cc")
    if not found:
        pytest.skip("no C compiler on PATH")
    return found


def run_c(text: str, folder: Path, name: str) -> tuple[Functions, list[float]]:
    (folder / "boat.h").write_text(text, encoding="utf-8")
    (folder / "main.c").write_text(MAIN.replace("NAME", name), encoding="utf-8")
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O0"]
    command = [compiler(), *flags, "main.c", "-o", "boat", "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr

    def call(kind: int, x: Any, u: Any, p: Any, dt: float = 0.0) -> list[float]:
        line = " ".join([str(kind), *(repr(float(v)) for v in [*x, *u, *p, dt])])
        ran = subprocess.run([folder / "boat"], input=line, capture_output=True, text=True, check=True)
        return [float(word) for word in ran.stdout.split()]

    defaults = subprocess.run([folder / "boat"], input="", capture_output=True, text=True, check=True).stderr.split()
    return (
        lambda x, u, p: call(0, x, u, p),
        lambda x, u, p: call(1, x, u, p),
        lambda x, u, dt, p: call(2, x, u, p, dt),
    ), [float(word) for word in defaults]


def simulate_python(text: str, x: Any, before: Any, inputs: np.ndarray, dt: float, hold: str | None = None) -> Steps:
    """Simulate steps of dt [s] by the class of the Python export, from the states x and constant inputs before."""
    space: dict[str, Any] = {"__name__": "boat"}
    exec(compile(text, "boat.py", "exec"), space)
    sim = space["Simulation"](dt, x, inputs=before, hold=hold)
    outputs, states = zip(*((sim.outputs(now), sim.step(now)) for now in inputs.tolist()), strict=True)
    return np.array(states), np.array(outputs)


def simulate_casadi(text: str, x: Any, before: Any, inputs: np.ndarray, dt: float, hold: str | None = None) -> Steps:
    """Simulate the same by the functions of the CasADi export."""
    space: dict[str, Any] = {"__name__": "boat"}
    exec(compile(text, "boat.py", "exec"), space)
    (step, names), y = space["make_step"](dt, hold), space["make_outputs"](dt, hold)
    z, rows = ca.DM(space["initial_state"](dt, x, before, hold)), []
    assert z.shape == (len(names), 1)
    for now in inputs.tolist():
        output = y(z, now, space["DEFAULTS"])
        z = step(z, now, space["DEFAULTS"])
        rows.append((np.array(z).ravel()[: len(space["STATES"])], np.array(output).ravel()))
    states, outputs = zip(*rows, strict=True)
    return np.array(states), np.array(outputs)


def build_c_simulation(text: str, folder: Path, name: str, *flags: str) -> Callable[..., list[list[float]]]:
    """Compile a program with the C export that simulates steps.

    The result is a function of the states, the inputs before, rows of dt and inputs, and the hold. It returns a row for
    each step: outputs before, states after, and the return code; after an error there are no outputs.
    """
    (folder / "boat.h").write_text(text, encoding="utf-8")
    (folder / "simulate.c").write_text(SIMULATE.replace("NAME", name), encoding="utf-8")
    words = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", *(flags or ("-O0",))]
    command = [compiler(), *words, "simulate.c", "-o", "simulate", "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr

    def run(x: Any, before: Any, rows: Any, hold: str | None = None) -> list[list[float]]:
        numbers = [*x, *before, *(v for row in rows for v in row)]
        line = " ".join([str(HOLDS[hold]), *(repr(float(v)) for v in numbers)])
        ran = subprocess.run([folder / "simulate"], input=line, capture_output=True, text=True, check=True)
        return [[float(word) for word in row.split()] for row in ran.stdout.splitlines()]

    return run
