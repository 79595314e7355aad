"""Content of an export: valid identifiers, parameter values, noise, and the comment header."""

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
from ident.model import Input, Model, Parameter, ParameterRole, State


@dataclass(frozen=True)
class Content:
    """A model ready for export.

    Attributes:
        states, inputs, outputs, parameters: valid identifiers in the order of the model; parameters without those of
            noise.
        values, errors: of ``parameters`` (NaN: no standard error).
        state_noise: diffusions [unit/sqrt(s)].
        output_noise: standard deviations.
        left_out: disturbance states that are not exported.
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

    @cached_property
    def own(self) -> tuple[Parameter, ...]:
        """The parameters of ``parameters``."""
        used = parameters_of(self.model)
        return tuple(p for p in self.model.parameters if p.name in used)

    @cached_property
    def symbols(self) -> tuple[list[str], list[str], list[str]]:
        """Identifiers of states, inputs and all parameters of the model in the code."""
        name_of = dict(zip([p.name for p in self.own], self.parameters, strict=True))
        return ([f"x_{n}" for n in self.states], [f"u_{n}" for n in self.inputs],
                [f"p_{name_of.get(p.name, f'unused_{i}')}" for i, p in enumerate(self.model.parameters)])

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
    extra = equivalent_process_noise(saved.model, model) if gone else [0.0] * len(noise)
    return Content(
        prefix(name or model.name), model, saved,
        identifiers(s.name for s in model.states), identifiers(i.name for i in model.inputs),
        identifiers(o.name for o in model.outputs), identifiers(p.name for p in own),
        tuple(p.value for p in own), tuple(saved.errors.get(p.name, math.nan) for p in own),
        tuple(math.hypot(a, b) for a, b in zip(noise, extra, strict=True)),
        tuple(values[o.noise] if o.noise else 0.0 for o in model.outputs),
        tuple(s.name for s in gone))


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
    inputs = {i.name for e in effects for i in e.inputs} - {i.name for e in model.effects for i in e.inputs
                                                            if not e.kind.nuisance}
    smaller = replace(
        model,
        states=tuple(s for s in model.states if s.name not in states),
        inputs=tuple(i for i in model.inputs if i.name not in inputs),
        parameters=tuple(p for p in model.parameters if p.name not in parameters),
        effects=tuple(e for e in model.effects if not e.kind.nuisance))
    return smaller, tuple(s for s in model.states if s.name in states)


def equivalent_process_noise(whole: Model, kept: Model) -> list[float]:
    """Removed disturbance forces as white process noise of the rates: the same variance over times longer than their
    correlation time, ``|d rate / d force| q tau`` at rest [unit/sqrt(s)]."""
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
            if force.name not in {s.name for s in kept.states} and A[j, j] < 0:
                diffusion = values[force.noise] if isinstance(force.noise, str) else float(force.noise)
                variance += (A[names.index(state.name), j] * diffusion / A[j, j]) ** 2
        found.append(math.sqrt(variance))
    return found


def header(c: Content, target: str) -> list[str]:
    """Comment header: model, provenance, meaning of the names, range of validity."""
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
        lines += [f"  (NAME_ago_K, in seatrial NAME~K, is the input NAME of K times {step:g} s ago: keep a",
                  "  buffer of it; of a held command its mean since the last step is better than its last value.)"]
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
    own = [n for n, p in zip(c.parameters, c.own, strict=True) if p.per_record]
    if own:
        lines += ["", f"Different in each run: {', '.join(own)}. Set them; the values here are the means of the",
                  "fitted runs."]
    return lines


def _unit(unit: str) -> str:
    return f"[{unit}]" if unit else "[-]"


def comment(c: Content, i: int) -> str:
    """Comment of a parameter: unit, standard error, meaning."""
    p, error = c.own[i], c.errors[i]
    known = f"+- {error:.3g}" if math.isfinite(error) else "" if p.free else "given"
    return " ".join(" ".join(part for part in (_unit(p.unit), known, p.meaning) if part).split())
