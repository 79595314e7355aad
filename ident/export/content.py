"""What every exporter writes: names made valid, values, noise, and the words of the header."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ident.data import TIME_INPUT, WORK_INPUT, WORK_UNIT
from ident.engine import VectorisedModel
from ident.estimation import SavedModel
from ident.export.codegen import Program, parameters_of, programs
from ident.model import HISTORY_STEP, Input, Model, Parameter, State
from ident.models import OFFSETS

SWING = "b_f"  # the unexplained force of the bench model, which is no effect


@dataclass(frozen=True)
class Content:
    """A model ready to be written. ``states``, ``inputs``, ``outputs``, ``parameters``: valid identifiers in the
    model's order, parameters without those that only noise depends on; ``values``, ``errors``: of ``parameters``
    (NaN: no standard error); state_noise: diffusions [unit/sqrt(s)]; output_noise: standard deviations."""

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

    @cached_property
    def own(self) -> tuple[Parameter, ...]:
        """The parameters themselves."""
        used = parameters_of(self.model)
        return tuple(p for p in self.model.parameters if p.name in used)

    @cached_property
    def symbols(self) -> tuple[list[str], list[str], list[str]]:
        """What states, inputs and all the model's parameters are called in the code."""
        name_of = dict(zip([p.name for p in self.own], self.parameters, strict=True))
        return ([f"x_{n}" for n in self.states], [f"u_{n}" for n in self.inputs],
                [f"p_{name_of.get(p.name, f'unused_{i}')}" for i, p in enumerate(self.model.parameters)])

    @cached_property
    def programs(self) -> tuple[Program, Program]:
        """Rates and outputs."""
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
    extra = unexplained(saved.model, model) if gone else [0.0] * len(noise)
    return Content(
        prefix(name or model.name), model, saved,
        identifiers(s.name for s in model.states), identifiers(i.name for i in model.inputs),
        identifiers(o.name for o in model.outputs), identifiers(p.name for p in own),
        tuple(p.value for p in own), tuple(saved.errors.get(p.name, math.nan) for p in own),
        tuple(math.hypot(a, b) for a, b in zip(noise, extra, strict=True)),
        tuple(values[o.noise] if o.noise else 0.0 for o in model.outputs),
        tuple(s.name for s in gone))


def identifiers(names: Iterable[str]) -> tuple[str, ...]:
    """Names that any language takes, all different: ``n_left~3`` becomes ``n_left_ago_3``."""
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
    """What functions and files are called by: begins with a letter, and no underscore follows another (CasADi)."""
    valid = re.sub(r"_+", "_", re.sub(r"[^A-Za-z0-9]", "_", name)).strip("_")
    return valid if valid[:1].isalpha() else f"model_{valid}".rstrip("_")


def without_nuisance(model: Model) -> tuple[Model, tuple[State, ...]]:
    """The boat alone: without unexplained forces and walking sensor offsets; and the states that went."""
    effects = [e for e in model.effects if e.kind.nuisance]
    swing = "bench" in model.provides
    states = {s.name for e in effects for s in e.states} | ({SWING} if swing else set())
    if "attitude" in model.provides:
        states |= {s.name for s in OFFSETS}
    parameters = {p.name for e in effects for p in e.parameters} | ({"q_f", "tau_f"} if swing else set())
    smaller = replace(
        model,
        states=tuple(s for s in model.states if s.name not in states),
        parameters=tuple(p for p in model.parameters if p.name not in parameters),
        effects=tuple(e for e in model.effects if not e.kind.nuisance))
    return smaller, tuple(s for s in model.states if s.name in states)


def unexplained(whole: Model, kept: Model) -> list[float]:
    """The unexplained forces as white noise of the rates they act on: the same variance over times longer than
    their memory, ``|d rate / d force| q tau`` at rest [unit/sqrt(s)]."""
    names = [s.name for s in whole.states]
    values = whole.values
    at_rest = np.zeros((1, len(names)))
    A = VectorisedModel(whole).rate_jacobian(
        at_rest, np.zeros((1, len(whole.inputs))), np.array(list(values.values()))
    )[0]
    found = []
    for state in kept.states:
        variance = 0.0
        for j, force in enumerate(whole.states):
            if force.name.startswith("b_") and force.name not in {s.name for s in kept.states} and A[j, j] < 0:
                diffusion = values[force.noise] if isinstance(force.noise, str) else float(force.noise)
                variance += (A[names.index(state.name), j] * diffusion / A[j, j]) ** 2
        found.append(math.sqrt(variance))
    return found


def header(c: Content, target: str) -> list[str]:
    """The lines above the code: what this is, what it came from, what its names mean, where it holds."""
    made = c.saved.provenance
    lines = [f"{c.model.name}: a fitted model, written for {target} by seatrial.", ""]
    lines += [f"{label}: {made[key]}" for label, key in (("made by", "made_by"), ("on", "created")) if key in made]
    lines += [f"fitted to: {log}" for log in made.get("logs", [])]
    if c.model.effects:
        lines.append("effects: " + ", ".join(e.name for e in c.model.effects))
    lines += ["", "dx/dt = f(x, u; p), y = h(x, u; p); SI units and radians. States x, inputs u, outputs y:"]
    lines += [f"  x[{i}] {n} {_unit(s.unit)} {s.meaning}".rstrip()
              for i, (n, s) in enumerate(zip(c.states, c.model.states, strict=True))]
    lines += _inputs(c)
    lines += [f"  y[{i}] {n} {_unit(o.unit)}" + (", an angle" if o.angle else "")
              for i, (n, o) in enumerate(zip(c.outputs, c.model.outputs, strict=True))]
    if c.validity:
        lines += ["", "Fitted where (beyond it nothing was tested):"]
        lines += [f"  {n} from {low:.4g} to {high:.4g}" for n, (low, high) in c.validity.items()]
    return [" ".join(line.splitlines()) for line in lines + _remarks(c)]


def _inputs(c: Content) -> list[str]:
    lines, past = [], [i for i in c.model.inputs if i.tap]
    for j, (n, i) in enumerate(zip(c.inputs, c.model.inputs, strict=True)):
        if i.tap:
            lines.append(f"  u[{j}] {n}: {i.tap_of}, {i.delay:.1f} s ago")
        else:
            lines.append(f"  u[{j}] {n} {_unit(i.unit)}{_said(i)}")
    if past:
        lines += [f"  (NAME_ago_K, in seatrial NAME~K, is the input NAME of K times {HISTORY_STEP:g} s ago: keep a",
                  "  buffer of it; the model weighs the past by itself.)"]
    return lines


def _said(signal: Input) -> str:
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
            f"Left out, since a controller wants the boat: {', '.join(c.left_out)}",
            "(unexplained forces and offsets of sensors; `--with-disturbance-states` keeps them). What the forces did",
            "over times longer than their memory is in the process noise here.",
        ]
    own = [n for n, p in zip(c.parameters, c.own, strict=True) if p.per_record]
    if own:
        lines += ["", f"Not the boat's own, different in each run: {', '.join(own)}. Set them; here is the mean of the",
                  "runs they were fitted to."]
    return lines


def _unit(unit: str) -> str:
    return f"[{unit}]" if unit else "[-]"


def comment(c: Content, i: int) -> str:
    """What to say of a parameter: unit, standard error, meaning."""
    p, error = c.own[i], c.errors[i]
    known = f"+- {error:.3g}" if math.isfinite(error) else "" if p.free else "given"
    return " ".join(" ".join(part for part in (_unit(p.unit), known, p.meaning) if part).split())
