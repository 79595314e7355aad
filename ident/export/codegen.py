"""Content and code generation of exported models.

``collect_content`` collects what all targets need: valid identifiers, parameter values, noise. ``header`` writes the
comment at the top of a file. ``programs`` and ``write`` turn the expression graph of a model into straight-line code:
one assignment after the other, in any language that has a ``Syntax`` (plain Python, C99, Python with CasADi).

Common subexpressions are computed once. Signals of the model (forces, thrusts) keep their names, and ``cos(psi)``
becomes ``cos_psi``; other intermediate results are numbered.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import groupby
from typing import Any
from weakref import ref

import casadi as ca
import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from seatrial.ident.data import TIME_INPUT, WORK_INPUT, WORK_UNIT
from seatrial.ident.engine import VectorisedModel
from seatrial.ident.estimation import (
    BEYOND_PRIOR,
    ReportedUnits,
    SavedModel,
    exceeded_prior,
    reported_units,
    unconverged_sentence,
)
from seatrial.ident.export.conditions import late_values
from seatrial.ident.export.history import TIME, WORK, History, history_of
from seatrial.ident.model import Input, Model, Parameter, ParameterRole, Signals, State
from seatrial.ident.models import TURNS_INSIDE
from seatrial.ident.numerics import Array

AGE = "tau_age"  # parameter of the effect `seatrial.ident.models.telemetry_age`


@dataclass(frozen=True)
class Content:
    """Content of an exported file: a fitted model with valid identifiers, parameter values and noise.

    Attributes
    ----------
    name : str
        Prefix of functions and files.
    model : Model
        Model to export, without the nuisance states unless they are kept.
    saved : SavedModel
        Saved model, with provenance and validity.
    states, inputs, outputs, parameters : tuple of str
        Valid identifiers in the order of the model. Parameters on which neither rates nor outputs depend, for example
        those of noise, are left out.
    values, errors : tuple of float
        Values and standard errors of ``parameters`` in their units; NaN without a standard error.
    state_noise : tuple of float
        Diffusion of each state [unit/sqrt(s)], with the effect of the removed states.
    output_noise : tuple of float
        Standard deviation of each output's noise [unit], with the effect of the removed states.
    removed_states : tuple of str
        Names of the removed nuisance states.
    noise_time_scale : mapping
        Integral time scale [s] of the noise that stands for removed states, by output. Outputs without such noise are
        left out.
    states_without_noise : tuple of str
        Removed states that decay but are neither in ``state_noise`` nor in ``output_noise``, because they have no
        effect at rest. Removed random walks are in neither noise and are not listed.
    effects : tuple of str
        Names of the effects in the model.
    thrust_curve : tuple of float or None
        Coefficients c1 and c2 [N] of the thrust ``c1 n|n| + c2 n^2`` if the inputs are thrusts in place of shaft
        speeds; otherwise None.
    remarks : tuple of str
        Further lines of the header.
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
    removed_states: tuple[str, ...]
    noise_time_scale: Mapping[str, float]
    states_without_noise: tuple[str, ...]
    effects: tuple[str, ...] = ()
    thrust_curve: tuple[float, float] | None = None
    remarks: tuple[str, ...] = ()

    @cached_property
    def exported_parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the model on which rates or outputs depend, in the order of ``parameters``.

        Only these are exported.
        """
        return _exported(self.model)

    @cached_property
    def history(self) -> History:
        """Physical inputs (signals that a user provides), and for each input of the equations its source and delay."""
        return history_of(self.model)

    @cached_property
    def physical_inputs(self) -> tuple[str, ...]:
        """Identifiers of the physical inputs, the signals that a user provides, in the order of ``history.inputs``."""
        return identifiers(i.name for i in self.history.inputs)

    @cached_property
    def holds(self) -> tuple[str, ...]:
        """Interpolation of each physical input between its samples: ``zero`` (held) or ``linear``."""
        return tuple("linear" if linear else "zero" for linear in self.history.linear)

    @cached_property
    def symbols(self) -> tuple[list[str], list[str], list[str]]:
        """Variable names in the exported code: of the states, of the inputs, and of all parameters of the model.

        They have the prefixes ``x_``, ``u_`` and ``p_``. A parameter that is not exported has a name ``p_unused_...``.
        """
        name_of = dict(zip([p.name for p in self.exported_parameters], self.parameters, strict=True))
        return (
            [f"x_{n}" for n in self.states],
            [f"u_{n}" for n in self.inputs],
            [f"p_{name_of.get(p.name, f'unused_{i}')}" for i, p in enumerate(self.model.parameters)],
        )

    @cached_property
    def reported(self) -> ReportedUnits:
        """Units in which results report the numbers of the saved model: ratios if thrust or arms were not given."""
        return reported_units(self.saved.model)

    def unit(self, unit: str) -> str:
        """Return the unit of a number of the file: ``unit``, or ``relative`` if its thrust or arms are not known.

        A relative number is right only as a ratio to the thrust or to the arms in the file.
        """
        return RELATIVE if any(self.reported.scale.powers(unit)) else unit

    def parameter_unit(self, i: int) -> str:
        """Return the unit of the exported parameter with index ``i``, as `unit`.

        A parameter that the saved model lacks, as one of a joined bench model, has its own unit.
        """
        p = self.exported_parameters[i]
        return self.unit(p.unit) if p.name in self.saved.model.values else p.unit

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard errors by identifier, in the units of the parameters.

        Parameters without a standard error, and those that are relative, are left out.
        """
        return {
            n: e
            for i, (n, e) in enumerate(zip(self.parameters, self.errors, strict=True))
            if math.isfinite(e) and self.parameter_unit(i) != RELATIVE
        }

    @cached_property
    def programs(self) -> tuple[Program, Program]:
        """Two programs: the first computes the rates of the states, the second the outputs. Computed once."""
        return programs(self.model, [*self.symbols, [f"out_{n}" for n in self.outputs]])

    @property
    def late(self) -> tuple[float, float]:
        """Default time [s] and work of the functions without a past: those of the end of the data, after all changes.

        Both are zero for a model that does not have them as inputs.
        """
        values, needed = late_values(self.model, self.saved.validity), {i.name for i in self.model.inputs}
        time, work = (values[n] if n in needed else 0.0 for n in (TIME_INPUT, WORK_INPUT))
        return time, work

    @property
    def angles(self) -> tuple[str, ...]:
        """Identifiers of the outputs that are angles."""
        return tuple(n for n, o in zip(self.outputs, self.model.outputs, strict=True) if o.angle)

    @property
    def validity(self) -> dict[str, tuple[float, float]]:
        """Range (minimum, maximum) of the estimation data by identifier, for the exported states and inputs.

        States and inputs without a range in the model file are left out.
        """
        names = dict(zip([s.name for s in self.model.states], self.states, strict=True))
        names |= dict(zip([i.name for i in self.model.inputs], self.inputs, strict=True))
        return {names[k]: v for k, v in self.saved.validity.items() if k in names}


def collect_content(saved: SavedModel, *, name: str | None = None, nuisance: bool = False) -> Content:
    """Collect everything that the exporters need of a saved model.

    Parameters
    ----------
    saved : SavedModel
        Fitted model.
    name : str, optional
        Prefix of functions and files; by default the model's name.
    nuisance : bool
        Whether disturbance forces and sensor biases are kept as states.

    Returns
    -------
    Content
        Model, identifiers, values and noise. Removed states that decay are replaced by equivalent white noise; removed
        random walks are not.
    """
    model, removed = (saved.model, ()) if nuisance else without_nuisance(saved.model)
    own = _exported(model)
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
        tuple(s.name for s in removed),
        {n: tau for n, tau in zip(outputs, extra.noise_time_scale, strict=True) if tau > 0.0},
        extra.states_without_noise,
        tuple(e.name for e in model.effects),
        remarks=(*_telemetry_lines(saved.model, model), *dead_zone_lines(saved)),
    )


def dead_zone_lines(saved: SavedModel, name: str = "d") -> tuple[str, ...]:
    """Return the header lines on a dead zone inside which the measured shaft turned; empty for any other model.

    ``name`` is the parameter of the dead zone in the exported model.
    """
    if saved.flags.get("d") != TURNS_INSIDE:
        return ()
    return (
        "",
        f"{name} = {saved.model.parameter('d').value:.3g} is {TURNS_INSIDE}, where this model gives",
        f"no thrust. The dead zone is not determined: {name} is the value with which the model predicts the shaft",
        "speeds best. A boat model that is joined with this one has a dead zone of zero. Set no dead zone of an",
        "autopilot to it.",
    )


def _telemetry_lines(fitted: Model, model: Model) -> tuple[str, ...]:
    """Return the header lines on the age of the telemetry of shaft speeds; empty if the fitted model has no such age.

    The exported ``model`` contains the age only if the nuisance effects are kept.
    """
    age = fitted.values.get(AGE)
    if age is None:
        return ()
    measured = (
        f"A shaft speed of the fitted logs was measured {age:.3g} s before its time stamp (telemetry age, {AGE})."
    )
    if AGE in model.values:
        advice = f"The inputs need such stamps. For shaft speeds without an age, as in a simulation, set {AGE} = 0."
    else:
        advice = "The age is left out: the inputs are present shaft speeds. Subtract it from the stamps of telemetry."
    return "", measured, advice


def _exported(model: Model) -> tuple[Parameter, ...]:
    """Return the parameters of a model on which its rates or outputs depend, in the order of the model."""
    used = parameters_of(model)
    return tuple(p for p in model.parameters if p.name in used)


def with_model(content: Content, model: Model, errors: Mapping[str, float]) -> Content:
    """Return the content with another model, and with the identifiers, values and standard errors of this model.

    ``errors`` are standard errors by parameter; a parameter without one gets NaN. Everything else stays.
    """
    own = _exported(model)
    return replace(
        content,
        model=model,
        states=identifiers(s.name for s in model.states),
        inputs=identifiers(i.name for i in model.inputs),
        parameters=identifiers(p.name for p in own),
        values=tuple(p.value for p in own),
        errors=tuple(errors.get(p.name, math.nan) for p in own),
    )


def identifiers(names: Iterable[str]) -> tuple[str, ...]:
    """Return unique identifiers that are valid in any language, in the order of the names.

    ``~`` becomes ``_ago_`` (``n_left~3`` becomes ``n_left_ago_3``), and other invalid characters become ``_``. A name
    that is empty or starts with a digit gets ``_`` in front. Repeated names get ``_2``, ``_3``, ... at the end.
    Reserved words of a language are not changed: in the code, names have a prefix such as ``x_``.
    """
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
    """Return a valid prefix of functions and files.

    Invalid characters become underscores, and underscores at both ends are removed. The prefix starts with a letter
    (``model_`` is put in front if needed; an empty name becomes ``model``) and has no two underscores in a row, as
    CasADi requires.
    """
    valid = re.sub(r"_+", "_", re.sub(r"[^A-Za-z0-9]", "_", name)).strip("_")
    return valid if valid[:1].isalpha() else f"model_{valid}".rstrip("_")


def without_nuisance(model: Model) -> tuple[Model, tuple[State, ...]]:
    """Return the model without its nuisance effects, and the removed states.

    Nuisance effects are disturbance forces and random-walk sensor biases. Their states, parameters and inputs are
    removed. So are nuisance states and parameters of disturbances that belong to no effect. An input that another
    effect also needs is kept.
    """
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
    """White noise in place of removed states.

    Attributes
    ----------
    process : Array (n_states,)
        Diffusion that the removed states add to each state that is kept [unit/sqrt(s)].
    output : Array (n_outputs,)
        Standard deviation that the removed states add to each output [unit].
    noise_time_scale : Array (n_outputs,)
        Integral time scale of the noise added to each output [s]; 0 if no noise is added.
    states_without_noise : tuple of str
        Removed states that decay but have no effect at rest, and are therefore in neither noise.
    """

    process: Array
    output: Array
    noise_time_scale: Array
    states_without_noise: tuple[str, ...]


def equivalent_noise(whole: Model, kept: Model) -> EquivalentNoise:
    """Return the white noise that stands for removed Gauss-Markov states.

    Parameters
    ----------
    whole : Model
        Model with all states.
    kept : Model
        Model without the removed states.

    Returns
    -------
    EquivalentNoise
        Noise of the states and outputs of ``kept``; zero if no removed state decays.

    Notes
    -----
    The model is linearised at rest; removed states may drive each other. Noise of the rates has the spectral density
    of the removed states at low frequencies. Noise of the outputs has their stationary variance, by Lyapunov's
    equation; its integral time scale is the area under its autocorrelation. Both are means over four headings, as
    body-fixed disturbances such as a sideslip turn with the boat. Removed random walks have no stationary variance and
    are left out.
    """
    names, kept_names = [s.name for s in whole.states], {s.name for s in kept.states}
    zeros = np.zeros(len(whole.outputs))
    if kept_names.issuperset(names):
        return EquivalentNoise(np.zeros(len(kept_names)), zeros, zeros, ())
    values, compiled = whole.values, VectorisedModel(whole)
    angles = {o.name for o in whole.outputs if o.angle}
    quarter_turns = [0.5 * np.pi * (s.from_output in angles) for s in whole.states]
    x = np.arange(4)[:, None] * np.array(quarter_turns)
    at_rest = x, np.zeros((4, len(whole.inputs))), np.array(list(values.values()))
    A, H = compiled.rate_jacobian(*at_rest), compiled.output_jacobian(*at_rest)
    # a negative diagonal element: the state decays, so it is no random walk
    removed = [j for j, s in enumerate(whole.states) if s.name not in kept_names and A[0, j, j] < 0]
    q = np.array([values[s.noise] if isinstance(s.noise, str) else s.noise for s in (whole.states[j] for j in removed)])
    if not removed:
        return EquivalentNoise(np.zeros(len(kept_names)), zeros, zeros, ())
    among_removed, H = A[:, removed][:, :, removed], H[:, :, removed]
    to_rates = A[:, [names.index(s.name) for s in kept.states]][:, :, removed]
    inverse = np.linalg.inv(among_removed)
    covariance = np.array([solve_continuous_lyapunov(a, -np.diag(q**2)) for a in among_removed])
    covariance = covariance.reshape(among_removed.shape)
    rates = ((to_rates @ inverse * q) ** 2).sum(axis=2).mean(axis=0)
    outputs = np.einsum("hij,hjk,hik->hi", H, covariance, H).mean(axis=0)
    area = -np.einsum("hij,hjk,hik->hi", H, inverse @ covariance, H).mean(axis=0)
    gain = np.abs(np.concatenate([to_rates, H], axis=1) @ inverse).max(axis=(0, 1), initial=0.0)
    return EquivalentNoise(
        np.sqrt(rates),
        np.sqrt(outputs),
        np.divide(area, outputs, out=np.zeros_like(area), where=outputs > 0.0),
        tuple(names[j] for j, g in zip(removed, gain, strict=True) if g == 0.0),
    )


def provenance_lines(content: Content, target: str) -> list[str]:
    """Return the first lines of a header.

    They are the target, a fit that did not converge, an unknown scale, command and logs of the fit, and effects.
    """
    made, scale = content.saved.provenance, content.reported.scale
    lines = [f"{content.model.name}: fitted model, exported to {target} by seatrial.", *scale.caveats]
    if not content.saved.converged:
        lines.insert(1, f"WARNING: {unconverged_sentence('the fit of this model')}.")
    if scale.caveats:
        terms = ["T = c1 + c2 is the full forward thrust of one thruster."] * scale.relative
        terms += ["y_arm is the arm of the thrusters."] * scale.relative_yaw
        lines += [f"A number marked `{RELATIVE}` has its ratio beside it.", " ".join(terms)]
    lines += [f"{label}: {made[key]}" for label, key in (("made by", "made_by"), ("created", "created")) if key in made]
    lines += [f"fitted to: {log}" for log in made.get("logs", [])]
    if content.effects:
        lines.append("effects: " + ", ".join(content.effects))
    return [" ".join(line.splitlines()) for line in lines]


def header(content: Content, target: str, stepper: str) -> list[str]:
    """Return the lines of the comment at the top of an exported file, without the comment signs of the language.

    They describe the model, its provenance, states, inputs, outputs, range of validity, and remarks on noise and
    parameters. ``target`` is the name of the language, for the first line, and ``stepper`` that of the function that
    keeps the past of the inputs. A line break within a text of the model becomes a space.
    """
    return [*provenance_lines(content, target), "", *description_lines(content, stepper)]


def description_lines(content: Content, stepper: str = "") -> list[str]:
    """Return the lines of a header that follow the provenance. The arguments are those of `header`.

    If ``stepper`` is empty, the lines do not name the function that makes the delayed copies.
    """
    lines = [
        "Rates dx/dt = f(x, u; p), outputs y = h(x, u; p); SI units and radians.",
    ]
    if {"u", "r"} <= {s.name for s in content.model.states}:
        lines.append(AXES)
    lines += ["States x, inputs u, outputs y:"]
    lines += [
        f"  x[{i}] {n} {_unit_text(content.unit(s.unit))} {s.meaning}".rstrip()
        for i, (n, s) in enumerate(zip(content.states, content.model.states, strict=True))
    ]
    lines += _input_lines(content, stepper)
    lines += [
        f"  y[{i}] {n} {_unit_text(content.unit(o.unit))}" + (", an angle" if o.angle else "")
        for i, (n, o) in enumerate(zip(content.outputs, content.model.outputs, strict=True))
    ]
    lines += _physical_input_lines(content)
    if content.validity:
        lines += ["", "Range of the estimation data (the model is not validated beyond this range):"]
        if {"u", "v", "r"} & set(content.validity):
            lines.append("  Velocities: 98 % of the data, between the 1 % and 99 % quantiles. Inputs: all data.")
        lines += [f"  {n} from {low:.4g} to {high:.4g}" for n, (low, high) in content.validity.items()]
    return [" ".join(line.splitlines()) for line in lines + _remark_lines(content)]


def copies_sentence(content: Content, stepper: str) -> str:
    """Return a sentence on what the function ``stepper`` takes, and on the number of delayed copies that it makes."""
    n, given = sum(bool(i.tap_of) for i in content.model.inputs), ", ".join(content.physical_inputs) or "no inputs"
    if not n:
        return f"{stepper} takes {given}."
    return f"{n} of the {len(content.inputs)} inputs are delayed copies: {stepper} makes them and takes only {given}."


def _input_lines(content: Content, stepper: str) -> list[str]:
    """Return the header lines of the inputs, one for each input of the equations.

    Three or more delayed copies of one signal, one after the other, have a common line. If there are numbered copies
    (taps), two lines explain their names. A last line says how many copies there are, and which function makes them.
    """
    lines, taps = list[str](), [i for i in content.model.inputs if i.tap]
    numbered = enumerate(zip(content.inputs, content.model.inputs, strict=True))
    for signal, group in groupby(numbered, lambda item: item[1][1].tap_of):
        copies = [(f"u[{j}] {n}", i) for j, (n, i) in group]
        if signal and len(copies) >= SHORTEST_GROUP:
            (first, i), (last, end) = copies[0], copies[-1]
            lines.append(
                f"  {first} to {last}: {signal} {_unit_text(content.unit(i.unit))}, {len(copies)} delayed copies, "
                f"{i.delay:g} to {end.delay:g} s late, made by the export"
            )
            continue
        for name, i in copies:
            if i.tap:
                lines.append(f"  {name}: {i.tap_of}, {i.delay:g} s late")
            else:
                lines.append(f"  {name} {_unit_text(content.unit(i.unit))}{_input_meaning(i)}")
    if taps:
        step = taps[0].delay / taps[0].tap
        lines.append(f"  NAME_ago_K (NAME~K in seatrial) is the input NAME delayed by K times {step:g} s,")
        lines.append("  which a delay, a lag or the age of telemetry in the model needs.")
    if stepper and any(i.tap_of for i in content.model.inputs):
        lines.append(f"  {copies_sentence(content, stepper)}")
    return lines


def _physical_input_lines(content: Content) -> list[str]:
    """Return the header lines of the physical inputs, from which the inputs of the equations are computed.

    They state the interpolation of each physical input, whether time and work are computed, and how a negative delay is
    handled. The list is empty if there are neither physical inputs nor computed ones.
    """
    lines = ["", "Physical inputs: only these have to be given. The inputs u are computed from them:"]
    for name, signal, hold in zip(content.physical_inputs, content.history.inputs, content.holds, strict=True):
        between = "linear between its samples" if hold == "linear" else "each value is held until the next one"
        lines.append(f"  {name} {_unit_text(content.unit(signal.unit))}, {between}")
    computed = [n for n, s in (("the time", TIME), ("the work", WORK)) if s in content.history.sources]
    if computed:
        lines.append(f"  {' and '.join(computed)} since the start {'are' if len(computed) > 1 else 'is'} computed, too")
        time, work = content.late
        known = [f"{time:.6g} s"] * (TIME in content.history.sources)
        known += [f"a work of {work:.6g}"] * (WORK in content.history.sources)
        lines.append(
            f"  (from zero in a simulation; without a past the default is the end of the data, {known[0]}"
            f"{' and ' + known[1] if len(known) > 1 else ''})"
        )
    if min(content.history.delays, default=0.0) < 0.0:
        lines.append("  a later value (a negative delay) is not known, and is taken as equal to the present value")
    return lines if len(lines) > 2 else []


def _input_meaning(signal: Input) -> str:
    """Return the meaning of a time input, a work input or a delayed command, with a comma in front.

    The text is empty for any other input, which is a plain sensor signal or command.
    """
    if signal.name == TIME_INPUT:
        return ", the time since the start of the run"
    if signal.name == WORK_INPUT:
        return f", the integral of |n_left|^3 + |n_right|^3 over time, divided by {WORK_UNIT:g} s"
    if signal.tap_of:
        return f", the command of {signal.delay:g} s ago"
    return ""


def _remark_lines(content: Content) -> list[str]:
    """Return the last lines of a header: the remarks of the content, removed states, parameters to be set.

    After ``content.remarks`` follow lines about removed states, their noise, standard errors larger than those of the
    priors, and per-record parameters. The list is empty for a content without any of these.
    """
    lines = list(content.remarks)
    if content.removed_states:
        lines += [
            "",
            f"Left out, as a controller does not need them: {', '.join(content.removed_states)}",
            "(disturbance forces and sensor offsets; the option `--with-disturbance-states` keeps them).",
            "The process noise includes the effect of the forces over times longer than their correlation time.",
        ]
    if content.states_without_noise:
        lines.append(
            f"Included in no noise, because they have no effect at rest: {', '.join(content.states_without_noise)}."
        )
    if content.noise_time_scale:
        lasting = ", ".join(f"{n} ({tau:.2g} s)" for n, tau in content.noise_time_scale.items())
        lines += [
            f"The output noise includes their variance. It is correlated over these times: {lasting}.",
            "A filter that assumes white noise should use samples that far apart, or keep the states.",
        ]
    lines += _wider_lines(content)
    per_record = [n for n, p in zip(content.parameters, content.exported_parameters, strict=True) if p.per_record]
    if per_record:
        lines += [
            "",
            f"Parameters that differ from run to run: {', '.join(per_record)}. Set them for your run; the values here",
            "are the means over the fitted runs.",
        ]
    return lines


def _wider_lines(content: Content) -> list[str]:
    """Return header lines on the parameters whose standard error is larger than that of their prior; often empty.

    Parameters whose scale is not known are left out: they are exported without a standard error.
    """
    found = []
    for i, (name, p) in enumerate(zip(content.parameters, content.exported_parameters, strict=True)):
        of_prior = exceeded_prior(p, p.value, content.errors[i])
        if of_prior is not None and content.parameter_unit(i) != RELATIVE:
            found.append(f"{name} ({content.errors[i]:.3g} > {of_prior:.3g})")
    if not found:
        return []
    text = f"Standard error larger than that of the prior: {', '.join(found)}, because {BEYOND_PRIOR}."
    return ["", *textwrap.wrap(text, HEADER_WIDTH)]


def _unit_text(unit: str) -> str:
    """Return a unit in brackets; ``[-]`` for an empty unit."""
    return f"[{unit}]" if unit else "[-]"


def comment(content: Content, i: int) -> str:
    """Return the comment beside the exported parameter with index ``i``: unit, standard error and meaning, in one line.

    A considered parameter (not estimated, with an uncertain prior) shows the standard deviation of its prior as the
    error. A fixed parameter shows the origin of its value instead, and a free one without a standard error neither.
    A parameter whose scale is not known has its ratio to the thrust or arm in place of unit and error.
    """
    p = content.exported_parameters[i]
    if content.parameter_unit(i) == RELATIVE:
        scale = content.reported.scale
        ratio = f"{p.value * content.reported.factor(p.unit):.4g} {scale.unit(p.unit)}".strip()
        origin = "" if p.free else f"{p.provenance},"
        words = f"[{RELATIVE}: {scale.name(p.name, p.unit)} = {ratio}] {origin} {p.meaning}"
        return " ".join(words.split())
    error = content.errors[i] if p.considered_sd is None else p.considered_sd
    origin = f"+- {error:.3g}" if math.isfinite(error) else "" if p.free else f"{p.provenance},"
    return " ".join(" ".join(part for part in (_unit_text(p.unit), origin, p.meaning) if part).split())


RELATIVE = "relative"  # in place of the unit of a number that is right only as a ratio to thrust or arms
AXES = "Axes: x north, y east; u forward, v to starboard; psi and r clockwise seen from above (not those of REP-103)."
HEADER_WIDTH = 100  # columns of a sentence in the header
SHORTEST_GROUP = 3  # smallest number of delayed copies of a signal that have a common line in the header
ATOM, UNARY, PRODUCT, SUM = 100, 30, 20, 10  # precedence of an expression: a higher number binds more tightly
MAX_INLINE = 50  # characters; a longer expression becomes a variable of its own
NAMED = {  # prefix of the variable that holds such a function of a named quantity: cos(psi) is cos_psi
    ca.OP_SIN: "sin",
    ca.OP_COS: "cos",
    ca.OP_FABS: "abs",
    ca.OP_SQRT: "root",
    ca.OP_TANH: "tanh",
    ca.OP_EXP: "exp",
    ca.OP_SQ: "square",
}
# Functions of one and of two arguments that have the same name in math (Python), math.h (C99) and CasADi.
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
    """Syntax of a target language.

    Attributes
    ----------
    templates : mapping
        By CasADi's code of an operation: its text, with ``{0}`` and ``{1}`` for the operands, and its precedence.
        Operands of a template with precedence ``ATOM`` (a function call) need no parentheses; others get parentheses
        according to the precedences.
    number : callable
        Function that returns the text of a constant in the language.
    assign : str
        Template of an assignment, with ``{name}`` and ``{value}``.
    """

    templates: Mapping[int, tuple[str, int]]
    number: Callable[[float], str]
    assign: str = "{name} = {value}"


def _arithmetic_templates() -> Templates:
    """Return the templates of the arithmetic operations, which all targets share, by CasADi's code of the operation."""
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


def _function_templates(prefix: str) -> Templates:
    """Return the templates of the functions that all targets share, by CasADi's code of the operation.

    ``prefix``, such as ``ca.`` or an empty text, is put before the name of each function.
    """
    unary = {getattr(ca, "OP_" + n.upper()): (f"{prefix}{n}({{0}})", ATOM) for n in SHARED}
    return unary | {getattr(ca, "OP_" + n.upper()): (f"{prefix}{n}({{0}}, {{1}})", ATOM) for n in SHARED_TWO}


def _logic_templates(template: str, both: str, either: str) -> Templates:
    """Return the templates of comparisons and logical operations, whose values are 0 and 1.

    ``template`` converts a condition ``{0}`` to a number. ``both`` and ``either`` are the operators "and" and "or" of
    the language.
    """
    relations = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}
    table = {code: (template.format(f"{{0}} {sign} {{1}}"), ATOM) for code, sign in relations.items()}
    return table | {
        ca.OP_NOT: (template.format("{0} == 0.0"), ATOM),
        ca.OP_AND: (template.format(f"{{0}} != 0.0 {both} {{1}} != 0.0"), ATOM),
        ca.OP_OR: (template.format(f"{{0}} != 0.0 {either} {{1}} != 0.0"), ATOM),
    }


PYTHON = Syntax(
    _arithmetic_templates()
    | _function_templates("")
    | _logic_templates("float({0})", "and", "or")
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
    lambda value: _number_text(value, "inf", "nan"),
)
C = Syntax(
    _arithmetic_templates()
    | _function_templates("")
    | _logic_templates("(double)({0})", "&&", "||")
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
    lambda value: _number_text(value, "INFINITY", "NAN"),
    "const double {name} = {value};",
)
CASADI = Syntax(
    _arithmetic_templates()
    | _function_templates("ca.")
    | _logic_templates("({0})", "", "")
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
    lambda value: _number_text(value, "ca.inf", "ca.nan"),
)
ca.GlobalOptions.setNumpyMode(-1)  # plain numpy functions on symbols stay symbolic


SYMBOL, CONSTANT = -1, -2  # codes of nodes that are no operation


@dataclass
class Node:
    """Node of an expression graph: a symbol, a constant, or an operation on other nodes.

    Attributes
    ----------
    code
        CasADi's code of the operation; -1 (``SYMBOL``) for a symbol, -2 (``CONSTANT``) for a constant.
    operands
        Indices of the nodes that the operation takes.
    symbol
        Identifier of a symbol; otherwise empty.
    value
        Value of a constant; otherwise 0.
    label
        Preferred name of the variable that holds the result; empty if there is none.
    uses
        Number of nodes and results that need the node.
    """

    code: int
    operands: tuple[int, ...] = ()
    symbol: str = ""
    value: float = 0.0
    label: str = ""
    uses: int = 0


@dataclass(frozen=True)
class Program:
    """Straight-line program (without branches and loops) that computes the rates or the outputs of a model.

    Attributes
    ----------
    nodes
        Nodes in the order of computation.
    results
        Index of the node of each result.
    used
        Identifiers of the symbols (states, inputs, parameters) that the results depend on.
    """

    nodes: list[Node]
    results: tuple[int, ...]
    used: frozenset[str] = field(default=frozenset())


def programs(model: Model, names: Sequence[Sequence[str]]) -> tuple[Program, Program]:
    """Return the programs that compute the rates and the outputs of a model.

    Parameters
    ----------
    model : Model
        Model.
    names : sequence of four sequences of str
        Identifiers of states, inputs, parameters and outputs in the code. Those of the states have a prefix such as
        ``x_``, which ``rate_`` replaces for the rates.

    Returns
    -------
    tuple of Program
        Program of the rates of all states, and program of all outputs.
    """
    found = _symbolic_model(model)
    of_symbols = [name for part in names[:3] for name in part]
    of_rates = [f"rate_{n.partition('_')[2]}" for n in names[0]]
    return (
        _program(found.symbols, of_symbols, found.rates, found.signals, of_rates),
        _program(found.symbols, of_symbols, found.outputs, found.signals, names[3]),
    )


def parameters_of(model: Model) -> set[str]:
    """Return the names of the parameters of a model that rates of states or outputs depend on.

    Parameters that only determine noise are not among them.
    """
    found = _symbolic_model(model)
    first = len(model.states) + len(model.inputs)
    results = ca.densify(ca.vertcat(*found.rates, *found.outputs))
    used = ca.which_depends(results, ca.vertcat(*found.symbols[first:]), 1, False) if model.parameters else []
    return {p.name for p, needed in zip(model.parameters, used, strict=True) if needed}


@dataclass(frozen=True)
class _SymbolicModel:
    """Expressions of a model.

    Attributes
    ----------
    symbols
        Symbols of the states, then those of the inputs, then those of the parameters.
    rates, outputs
        Expressions of the rates of the states, and of the outputs.
    signals
        Expressions of the signals that the model names (`_named_signals`).
    """

    symbols: list[Any]
    rates: list[Any]
    outputs: list[Any]
    signals: dict[str, Any]


# by the id of the model, so that the model is evaluated once for all parts of an exported file
_symbolic: dict[int, tuple[ref[Model], _SymbolicModel]] = {}


def _symbolic_model(model: Model) -> _SymbolicModel:
    """Return the expressions of a model. They are computed once, and kept as long as the model is in memory."""
    at = id(model)
    of_model, found = _symbolic.get(at, (None, None))
    if found is None or of_model is None or of_model() is not model:
        parts = (("x", model.states), ("u", model.inputs), ("p", model.parameters))
        symbols = [[ca.SX.sym(f"{kind}{i}") for i in range(len(part))] for kind, part in parts]
        s = model.signals(*symbols)
        found = _SymbolicModel(
            [symbol for part in symbols for symbol in part],
            [ca.SX(s.rate[v.name]) for v in model.states],
            [ca.SX(s.y[o.name]) for o in model.outputs],
            dict(_named_signals(s)),
        )
        _symbolic[at] = ref(model, lambda _: _symbolic.pop(at, None)), found
    return found


def _named_signals(s: Signals) -> Iterator[tuple[str, Any]]:
    """Yield name and symbolic expression of the signals that a model names: forces, and quantities of each thruster.

    Rates and outputs are left out.
    """
    for name, value in vars(s).items():
        if isinstance(value, ca.SX) and value.is_scalar():
            yield _as_identifier(name), value
        elif isinstance(value, dict) and name not in ("rate", "y"):
            yield from (
                (_as_identifier(f"{name}_{key}"), item) for key, item in value.items() if isinstance(item, ca.SX)
            )


def _as_identifier(name: str) -> str:
    """Return a name with underscores in place of characters that are no letter, digit or underscore."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name)


def _program(
    symbols: list[Any], of_symbols: Sequence[str], results: list[Any], labels: Mapping[str, Any], names: Sequence[str]
) -> Program:
    """Convert CasADi expressions to a straight-line program, whose nodes are single operations.

    Parameters
    ----------
    symbols
        CasADi symbols of states, inputs and parameters.
    of_symbols
        Identifiers of the symbols.
    results
        CasADi expressions to be computed. Common subexpressions are computed once.
    labels
        Intermediate expressions by name; they keep their names. An expression with several names keeps the first one.
        Those that no result needs are in the program, but count as unused.
    names
        Names of the results. A result that is also a named intermediate expression keeps that name.
    """
    expressions = ca.cse([ca.densify(e) for e in [*results, *labels.values()]])
    f = ca.Function("lines", symbols, expressions, {"allow_free": False})
    nodes: list[Node] = []
    slot: dict[int, int] = {}  # index in CasADi's work vector -> index of the node whose value is there now
    ends = [0] * f.n_out()
    for k in range(f.n_instructions()):
        code, operands = f.instruction_id(k), f.instruction_input(k)
        if code == ca.OP_OUTPUT:
            ends[f.instruction_output(k)[0]] = slot[operands[0]]
            continue
        if code == ca.OP_INPUT:
            node = Node(SYMBOL, symbol=of_symbols[operands[0]])
        elif code == ca.OP_CONST:
            node = Node(CONSTANT, value=f.instruction_constant(k))
        else:
            node = Node(code, tuple(slot[i] for i in operands))
        slot[f.instruction_output(k)[0]] = len(nodes)
        nodes.append(node)
    # in reverse order, so that a node with several labels keeps the first one
    for name, end in list(zip(labels, ends[len(results) :], strict=True))[::-1]:
        nodes[end].label = name
    for name, end in zip(names, ends, strict=False):
        nodes[end].label = nodes[end].label or name
    return _with_use_counts(nodes, tuple(ends[: len(results)]))


def _with_use_counts(nodes: list[Node], results: tuple[int, ...]) -> Program:
    """Return the program of the nodes, with the number of uses of each node.

    A use is an operation that has the node as operand, or a result. Nodes that no result needs have zero uses. The
    nodes are changed in place. ``results`` are the indices of the nodes of the results.
    """
    for end in results:
        nodes[end].uses += 1
    used = set()
    for node in reversed(nodes):
        if node.uses:
            for operand in node.operands:
                nodes[operand].uses += 1
            if node.code == SYMBOL:
                used.add(node.symbol)
    return Program(nodes, results, frozenset(used))


def write(program: Program, syntax: Syntax, taken: Iterable[str]) -> tuple[list[str], list[str]]:
    """Write a program as the text of a language.

    Parameters
    ----------
    program : Program
        Program to write.
    syntax : Syntax
        Language.
    taken : iterable of str
        Names that variables must not have.

    Returns
    -------
    lines : list of str
        Assignments, one a line.
    results : list of str
        Expression of each result after the assignments.

    Raises
    ------
    ValueError
        If the language lacks an operation of the program.
    """
    writer = _Writer(program, syntax, set(taken))
    return writer.run(), [writer.text[end][0] for end in program.results]


class _Writer:
    """Writer of a program: decides which nodes become variables, and puts the others into expressions.

    An operation becomes a variable if it is used more than once, has a label, or is longer than 50 characters. So does
    the operand of an operation whose template repeats it, for example a square. Symbols and constants never do.

    Attributes
    ----------
    nodes, syntax
        Nodes of the program, and syntax of the language.
    taken
        Names that new variables must not have. Each new variable is added.
    count
        Number of the last numbered variable (``t1``, ``t2``, ...).
    text
        Expression or variable of each node that has been written, and its precedence, by index of the node.
    named
        Indices of the nodes that become variables, whatever their length.
    """

    def __init__(self, program: Program, syntax: Syntax, taken: set[str]) -> None:
        """Set up the writer, and select the nodes that become variables (``named``). Nothing is written yet.

        ``taken`` are the names that variables must not have; the set is changed later. Raise ValueError if the language
        lacks an operation that the results need.
        """
        self.nodes, self.syntax, self.taken, self.count = program.nodes, syntax, taken, 0
        self.text: dict[int, tuple[str, int]] = {}  # by node: its expression or variable, and the precedence
        repeated = {n.operands[0] for n in self.nodes if n.uses and n.code >= 0 and self._repeats(n)}
        self.named = {k for k, n in enumerate(self.nodes) if n.code >= 0 and (n.uses > 1 or n.label or k in repeated)}

    def _repeats(self, node: Node) -> bool:
        """Return whether the template of an operation contains its first operand more than once."""
        return self._template(node)[0].count("{0}") > 1

    def _template(self, node: Node) -> tuple[str, int]:
        """Return the template and the precedence of the operation of a node.

        Raises
        ------
        ValueError
            If the language lacks the operation.
        """
        try:
            return self.syntax.templates[node.code]
        except KeyError:
            raise ValueError(
                f"the model uses an operation (CasADi operation code {node.code}) that cannot be exported, for example "
                "a table or a solver; write it with functions of numpy"
            ) from None

    def run(self) -> list[str]:
        """Return the assignments of the program in order, and fill ``text``. Unused nodes are left out."""
        lines = []
        for k, node in enumerate(self.nodes):
            if not node.uses:
                continue
            text, precedence = self._expression(node)
            if node.code >= 0 and (k in self.named or len(text) > MAX_INLINE):
                name = self._name(node)
                lines.append(self.syntax.assign.format(name=name, value=text))
                text, precedence = name, ATOM
            self.text[k] = (text, precedence)
        return lines

    def _expression(self, node: Node) -> tuple[str, int]:
        """Return the expression of a node as text, and the precedence of its operator.

        Operands get parentheses as needed. They must have been written to ``text`` before.
        """
        if node.code == SYMBOL:
            return node.symbol, ATOM
        if node.code == CONSTANT:
            return self.syntax.number(node.value), UNARY if math.copysign(1.0, node.value) < 0 else ATOM
        template, precedence = self._template(node)
        operands = []
        for position, operand in enumerate(node.operands):
            text, operand_precedence = self.text[operand]
            # a - (b - c) needs its parentheses; a + (b + c) keeps them, so that the rounding does not change
            right = position > 0 or node.code in (ca.OP_NEG, ca.OP_INV)
            loose = operand_precedence < precedence or (operand_precedence == precedence and right)
            operands.append(f"({text})" if loose and precedence < ATOM else text)
        return template.format(*operands), precedence

    def _name(self, node: Node) -> str:
        """Return a new variable name for a node, and add it to ``taken``.

        The name is the label of the node or, without a label, a name such as ``cos_psi`` for a function of a named
        quantity. If there is no such name, or if it is taken, the name is ``t`` and a number.
        """
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


def _number_text(value: float, infinite: str, nan: str) -> str:
    """Return a constant as text with all digits; ``infinite`` and ``nan`` are the texts of these values.

    Minus infinity is ``infinite`` with a minus sign in front.
    """
    if math.isnan(value):
        return nan
    return repr(value) if math.isfinite(value) else infinite if value > 0 else f"-{infinite}"
