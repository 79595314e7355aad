"""Boat models joined with bench models of their thrusters, and boat models with thrusts as inputs.

A boat model with shaft speeds as inputs does not know how the shafts follow their commands. A bench model does: delay,
dead zone and lag of the shaft, and the thrust curve. `join` puts one bench model before each thruster input, so that
the inputs are commands. A log of the boat with commands and shaft speeds gives such a model too, without a thrust
curve. `with_thrust_input` replaces shaft speeds by thrusts, which have a slope at rest. `with_shaft_remark` names what
is missing in a file without the shafts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from seatrial.daq.errors import SeatrialError, warn
from seatrial.ident.data import TIME_INPUT, WORK_INPUT, WORK_UNIT
from seatrial.ident.estimation import SavedModel, thrust_scale_of
from seatrial.ident.export.codegen import Content, collect_content, with_model, without_nuisance
from seatrial.ident.model import (
    COMMAND,
    SHAFT_SPEED,
    THRUSTER_FORCE,
    Effect,
    EffectKind,
    Input,
    Model,
    ModelFunction,
    ModelKind,
    Parameter,
    SignalId,
    Signals,
    State,
    is_of_thruster,
    thrust_of,
)
from seatrial.ident.models import TURNS_INSIDE

BENCH_ONLY = ("bench", "sensor")  # places of effects of the tank, the rig and its sensors, which a boat does not have
SHAFT_STAGES = ("shaft", "dead_band", "thrust_lag")  # places of effects between shaft speed and thrust curve
DIFFERENT = 0.02  # of the largest thrust: a larger difference of two thrust curves gives a warning
SIGNIFICANT = 2.0  # standard errors from which on a dead zone is significant
MARGIN = 0.05  # of full speed by which a boat may exceed the range of the bench without a warning
SPEEDS = np.linspace(-1.0, 1.0, 41)  # shaft speeds at which thrust curves are compared
SMALLEST_SHARE = 1e-6  # of the thrust at full speed, below which the slope of its shaft speed is bounded (n = 0.001)


@dataclass(frozen=True)
class Drive:
    """Bench model of the thruster that drives one input of a boat model.

    Attributes
    ----------
    input : str
        Input of the boat model: ``n_left`` (shaft speed) or ``f_left`` (thrust).
    name : str
        Name of the thruster, ``left``; empty for the only thruster of a surge model.
    saved : SavedModel
        The bench model as it was saved.
    model : Model
        The bench model without its load cell, the tank and the disturbance force.
    """

    input: str
    name: str
    saved: SavedModel
    model: Model

    def own(self, name: str) -> str:
        """Return the name in the joined model of a state, parameter or input of the bench model: ``tau_left``.

        ``n_cmd_3`` becomes ``n_cmd_left_3``. The time ``t`` is common to all thrusters. If the thruster has no name,
        the names are unchanged.
        """
        if name == TIME_INPUT or not self.name:
            return name
        if name.startswith(COMMAND):
            return f"{COMMAND}_{self.name}{name.removeprefix(COMMAND)}"
        return f"{name}_{self.name}"

    def signals(self, s: Signals) -> Signals:
        """Return the signals of the bench model, given those of the joined model."""
        return self.model.signals(
            [getattr(s.x, self.own(x.name)) for x in self.model.states],
            [getattr(s.u, self.own(u.name)) for u in self.model.inputs],
            [getattr(s.p, self.own(p.name)) for p in self.model.parameters],
        )

    @property
    def gives_thrust(self) -> bool:
        """Whether the input of the boat model is a thrust, not a shaft speed."""
        return is_of_thruster(self.input, THRUSTER_FORCE)

    @property
    def has_thrust(self) -> bool:
        """Whether the bench had a load cell, so that the model has a thrust curve."""
        return "thrust" in self.model.provides

    def steady_thrust(self, n: float) -> float:
        """Return the steady thrust [N] at the shaft speed n, with the other states of the bench model at zero."""
        x = [n if state.name == "n" else 0.0 for state in self.model.states]
        values = list(self.model.values.values())
        return float(self.model.signals(x, [n if i.tap_of else 0.0 for i in self.model.inputs], values).force)


def join(boat: Content, thrusters: Mapping[str, SavedModel], *, own_curve: bool = False) -> Content:
    """Return a boat model whose inputs are the commands of its thrusters, with the shafts of bench models.

    Parameters
    ----------
    boat : Content
        Collected content of the boat model, whose inputs are shaft speeds or thrusts of thrusters.
    thrusters : mapping
        Bench models by name of the thruster (``left``); the name ``""`` stands for all thrusters that are not named.
        A model without a thrust may come from logs of the boat with commands and shaft speeds.
    own_curve : bool
        Whether to keep the thrust curve of the boat model. Otherwise that of the bench models replaces it; a bench
        without a load cell has none, and the boat keeps its own.

    Returns
    -------
    Content
        The joined model. Names of the bench models contain the name of the thruster, for example ``n_cmd_left`` and
        ``tau_left`` (`Drive.own`). Disturbances, and effects of the load cell and the tank, are left out.

    Raises
    ------
    SeatrialError
        If a model is of the wrong kind, if a thruster has no model, or if the boat model cannot be joined.

    Warns
    -----
    SeatrialWarning
        If a thrust curve that is replaced differs from that of its bench model by more than 2 % of the largest thrust,
        if a bench model has effects of the load cell or the tank, or if the shaft speeds of the boat's data exceed the
        range of the bench test by more than 5 % of full speed.
    """
    model = boat.model
    if model.kind is not ModelKind.VEHICLE:
        raise SeatrialError(
            f"model {model.name} is not that of a boat: give that of a boat, and with --thruster that of a bench"
        )
    drives = _drives(model, thrusters)
    replaced = {d.input for d in drives}
    model = _without_late_sensors(model, replaced)
    _check_past(model, replaced)
    with_curve = [d for d in drives if d.has_thrust and not own_curve]
    for d in drives:
        if d.gives_thrust and not d.has_thrust:
            raise SeatrialError(
                f"thruster {d.name}: its bench had no load cell, but the boat model has the thrust {d.input} as input; "
                "use a bench model with thrust, or a boat model with shaft speeds"
            )
    if any(not d.gives_thrust for d in with_curve):
        _check_curves(boat, with_curve)
    for d in drives:
        _check_range(boat, d, d in with_curve)
        gone = [e.name for e in d.saved.model.effects if not e.kind.nuisance and e not in d.model.effects]
        if gone:
            warn(
                f"thruster {d.name or d.input}: {', '.join(gone)} of its bench test is left out; a boat has no load "
                "cell and no tank"
            )
    joined = _joined_model(model, drives, own_curve)
    errors = dict(boat.saved.errors)
    for d in drives:
        errors |= {d.own(n): e for n, e in d.saved.errors.items()}
    benches = [collect_content(replace(d.saved, model=d.model)) for d in drives]
    extra = len(joined.states) - len(model.states) - sum(len(b.states) for b in benches)  # the state of the work
    return replace(
        with_model(boat, joined, errors),
        effects=(
            *_kept_effects(boat, model),
            *(f"{e.name} ({d.name or d.input})" for d in drives for e in d.model.effects),
        ),
        state_noise=(*boat.state_noise, *(q for b in benches for q in b.state_noise), *([0.0] * extra)),
        remarks=(*boat.remarks, *_remarks(drives, own_curve)),
    )


def _drives(model: Model, thrusters: Mapping[str, SavedModel]) -> list[Drive]:
    """Return the bench model of each thruster input of a boat model; SeatrialError if one is missing or unsuitable."""
    inputs = [i.name for i in model.inputs if not i.tap]
    found = {n: SignalId.parse(n).source for n in inputs if is_of_thruster(n, COMMAND, SHAFT_SPEED, THRUSTER_FORCE)}
    found |= {i.name: "" for i in model.inputs if i.name == "n"}
    commands = [n for n in found if n == COMMAND or is_of_thruster(n, COMMAND)]
    if commands or not found:
        given = ", ".join(i.name for i in model.inputs if not i.tap) or "none"
        raise SeatrialError(
            f"the boat model {model.source or model.name} cannot be joined with a thruster: its inputs are {given}, "
            "not shaft speeds or thrusts; fit `ident vehicle --model horizontal:shaft` or horizontal:force"
        )
    units = {i.name: i.unit for i in model.inputs}
    for n in found:
        if units[n] != (wanted := "N" if is_of_thruster(n, THRUSTER_FORCE) else ""):
            raise SeatrialError(
                f"the input {n} of the boat model has the unit {units[n] or '1'}, but a bench model gives "
                f"{wanted or '1'} (shaft speeds relative to rpm_max); scale the input of the boat model"
            )
    names = [name or "n" for name in found.values()]
    if unknown := [n for n in thrusters if n and n not in names]:
        raise SeatrialError(f"--thruster: the boat has no thruster {unknown[0]!r}; it has {', '.join(names)}")
    drives = []
    for (input_, name), shown in zip(found.items(), names, strict=True):
        saved = thrusters.get(shown, thrusters.get(""))
        if saved is None:
            raise SeatrialError(f"thruster {shown} has no model: give --thruster {shown}=FILE, or one FILE for all")
        if saved.model.kind is not ModelKind.BENCH:
            raise SeatrialError(
                f"the model of thruster {shown} is {saved.model.name}, not a bench model; give the model.toml of "
                "`ident thruster`"
            )
        drives.append(Drive(input_, name, saved, _without_bench(saved.model)))
    return _with_significant_dead_zones(drives)


def _with_significant_dead_zones(drives: Sequence[Drive]) -> list[Drive]:
    """Return the drives with a dead zone of zero where the bench test does not show one, and warn about them.

    Commands inside a dead zone have no effect, so that an optimiser that comes there stays there. The model of a
    controller therefore has only a dead zone that the data show, or one that the user has fixed.
    """
    found, zones = [], []
    for d in drives:
        if _has_unproven_dead_zone(d.saved):
            zones.append(f"{d.own('d')} = {d.model.parameter('d').value:.3g}")
            d = replace(d, model=d.model.with_values({"d": 0.0}))
        found.append(d)
    if zones:
        warn(
            f"the bench tests do not determine these dead zones (smaller than two standard errors, or the shaft turns "
            f"inside): {', '.join(zones)}. They are zero in the joined model. Fit the thrusters again with "
            "--fix d=0, so that delay and lag belong to it; with --fix d=VALUE a dead zone that you know is kept"
        )
    return found


def _has_unproven_dead_zone(saved: SavedModel) -> bool:
    """Return whether the estimated dead zone of a bench model is not significant, or contradicted by its data."""
    zone = next((p for p in saved.model.parameters if p.name == "d"), None)
    if zone is None or not zone.free or zone.value == 0.0:
        return False
    error = saved.errors.get("d", np.nan)
    return saved.flags.get("d") == TURNS_INSIDE or bool(zone.value < SIGNIFICANT * error)


def _without_bench(model: Model) -> Model:
    """Return a bench model without disturbances, and without the effects of load cell and tank."""
    smaller, _ = without_nuisance(model)
    return _without(smaller, [e for e in smaller.effects if e.kind is EffectKind.CATALOGUE and e.place in BENCH_ONLY])


def _without_late_sensors(model: Model, replaced: set[str]) -> Model:
    """Return a boat model without sensor effects that need other times of inputs, or the shaft speeds of ``replaced``.

    These are latencies of a sensor and the age of shaft telemetry. They do not act on the motion of the boat. A warning
    names them.
    """
    gone = [
        e
        for e in model.effects
        if e.place == "sensor" and (any(i.tap_of in replaced for i in e.inputs) or set(e.hooks) & set(SHAFT_STAGES))
    ]
    if gone:
        names = ", ".join(e.name for e in gone)
        warn(
            f"{names}: left out, because the export has no past shaft speeds; the motion is the same, and the outputs "
            "are those of sensors without this delay"
        )
    return _without(model, gone)


def _kept_effects(boat: Content, model: Model) -> tuple[str, ...]:
    """Return the names of the effects of a content that are not left out of ``model``."""
    gone = {e.name for e in boat.model.effects} - {e.name for e in model.effects}
    return tuple(name for name in boat.effects if name not in gone)


def _without(smaller: Model, gone: Sequence[Effect]) -> Model:
    """Return a model without some of its effects, and without the states, parameters and inputs that only they have."""
    states, parameters = ({x.name for e in gone for x in getattr(e, part)} for part in ("states", "parameters"))
    kept = [e for e in smaller.effects if e not in gone]
    inputs = {i.name for e in gone for i in e.inputs} - {i.name for e in kept for i in e.inputs}
    return replace(
        smaller,
        states=tuple(s for s in smaller.states if s.name not in states),
        parameters=tuple(p for p in smaller.parameters if p.name not in parameters),
        inputs=tuple(i for i in smaller.inputs if i.name not in inputs),
        effects=tuple(kept),
    )


def _check_past(model: Model, replaced: set[str]) -> None:
    """Raise SeatrialError if a model needs the past or the future of an input that is to be replaced."""
    past = sorted({i.tap_of for i in model.inputs if i.tap and i.tap_of in replaced})
    if past:
        names = [e.name for e in model.effects if any(i.tap_of in replaced for i in e.inputs)]
        cause = f"its effect {', '.join(names)}" if names else f"the model {model.source or model.name}"
        raise SeatrialError(
            f"the input {past[0]} cannot be replaced, because {cause} needs its past; use a model without this delay, "
            "such as horizontal:shaft"
        )


def _check_curves(boat: Content, drives: list[Drive]) -> None:
    """Compare the thrust curve of a boat model with those of the bench models that replace it.

    Raise SeatrialError if the thrust of the boat is unknown, or if the model has no thrust curve that can be replaced.
    Warn if the curves differ by more than 2 % of the largest thrust of the bench.
    """
    model = boat.model
    if "thrust" not in dict(model.stages) or "c1" not in model.values:
        raise SeatrialError(
            f"the thrust curve of {model.source or model.name} cannot be replaced; keep it with --thrust-curve boat"
        )
    if thrust_scale_of(boat.saved.model).relative:
        raise SeatrialError(
            "the thrust of the boat model was not given, so its masses are ratios to a built-in thrust and do not fit "
            "the thrust curve of the bench: fit the boat with `ident vehicle --thruster FILE`, or keep its own curve "
            "with --thrust-curve boat"
        )
    for d in drives:
        bench = np.array([d.steady_thrust(n) for n in SPEEDS])
        own = model.values["c1"] * SPEEDS * abs(SPEEDS) + model.values["c2"] * SPEEDS**2
        worst = int(np.argmax(abs(bench - own)))
        if abs(bench - own)[worst] > DIFFERENT * abs(bench).max():
            warn(
                f"thruster {d.name}: at the shaft speed {SPEEDS[worst]:.2g} its bench model has {bench[worst]:.3g} N "
                f"and the boat model {own[worst]:.3g} N; masses and damping were fitted with the latter; fit the boat "
                "again with `ident vehicle --thruster`, and compare rpm_max of both rigs"
            )


def _check_range(boat: Content, drive: Drive, with_curve: bool) -> None:
    """Warn if the boat's data exceed the range of commands, and so of shaft speeds, of its thruster's bench test.

    A difference of up to 5 % of full speed gives no warning. Boat models with thrusts as inputs are not checked.
    ``with_curve``: whether the thrust curve is that of the bench too, not the shaft alone.
    """
    covered, needed = drive.saved.validity.get("n_cmd"), boat.saved.validity.get(drive.input)
    if covered is None or needed is None or drive.gives_thrust:
        return
    if needed[0] < covered[0] - MARGIN or needed[1] > covered[1] + MARGIN:
        warn(
            f"thruster {drive.name}: the boat ran with shaft speeds from {needed[0]:.2f} to {needed[1]:.2f}, but the "
            f"commands of its own test are from {covered[0]:.2f} to {covered[1]:.2f}; beyond them "
            f"{'shaft and thrust are' if with_curve else 'the shaft is'} extrapolated"
        )


def _remarks(drives: list[Drive], own_curve: bool) -> list[str]:
    """Return header lines on the model of each thruster: the parts that it provides, and an unproven dead zone."""
    lines = ["", "Joined with thruster models; full speed (n = 1, rpm_max of the rig) must be the same in both tests:"]
    for d in drives:
        made = d.saved.provenance
        parts = "shaft dynamics" + (" and thrust curve" if d.has_thrust and not own_curve else "")
        logs = ", ".join(str(log) for log in made.get("logs", [])) or made.get("made_by", "unknown")
        lines.append(f"  {d.own('n_cmd')} drives {d.input}: {parts} fitted to {logs}")
    for d in drives:
        if _has_unproven_dead_zone(d.saved):
            lines.append(
                f"  {d.own('d')} is zero: its data do not determine the fitted {d.saved.model.parameter('d').value:.3g}"
            )
    return lines


def _joined_model(boat: Model, drives: list[Drive], own_curve: bool) -> Model:
    """Return the model of a boat with its thrusters; its only stage evaluates the bench models, then the boat model.

    The input ``work`` becomes a state, because it is an integral of shaft speeds, which are states here.
    """
    driven = {d.input for d in drives}
    work = any(i.name == WORK_INPUT for i in boat.inputs)
    inputs: dict[str, Input] = {i.name: i for i in boat.inputs if i.name not in driven | {WORK_INPUT}}
    states, parameters = list(boat.states), list(boat.parameters)
    for d in drives:
        states += [_renamed_state(d, s) for s in d.model.states]
        parameters += [_renamed_parameter(d, p) for p in d.model.parameters]
        for i in d.model.inputs:
            inputs[d.own(i.name)] = replace(i, name=d.own(i.name), tap_of=d.own(i.tap_of) if i.tap_of else "")
    if work:
        states.append(State(WORK_INPUT, "", "work of the thrusters"))

    def evaluate(s: Signals) -> None:
        """Evaluate the bench models, then the boat model, and set the rates and the outputs of the joined model."""
        benches = {d.input: d.signals(s) for d in drives}
        given: dict[str, Any] = {i.name: getattr(s.u, i.name) for i in boat.inputs if i.name in inputs}
        for d in drives:
            bench = benches[d.input]
            given[d.input] = bench.force if d.gives_thrust else bench.x.n
            s.rate.update({d.own(name): rate for name, rate in bench.rate.items()})
        if work:
            given[WORK_INPUT] = s.x.work
            s.rate[WORK_INPUT] = sum(abs(given[d.input]) ** 3 for d in drives) / WORK_UNIT
        curves = {d.name: benches[d.input] for d in drives if d.has_thrust and not own_curve}

        def thrusts(b: Signals) -> dict[str, Any]:
            """Return the thrusts by side: on the bench's curve, or as the boat model has them without one."""
            return {
                side: curves[side].again({"n": n}, {}, {}).force if side in curves else b.f[side]
                for side, n in b.n.items()
            }

        given_thrusts = any(d.gives_thrust for d in drives)
        found = (boat if given_thrusts or not curves else _with_thrust(boat, thrusts)).signals(
            [getattr(s.x, x.name) for x in boat.states],
            [given[i.name] for i in boat.inputs],
            [getattr(s.p, p.name) for p in boat.parameters],
        )
        s.rate.update(found.rate)
        s.y.update(found.y)
        for name, value in vars(found).items():  # names of the forces in the code
            if name not in ("x", "u", "p", "rate", "y", "again"):
                setattr(s, name, value)

    return Model(
        boat.name,
        tuple(states),
        tuple(inputs.values()),
        boat.sensors,
        tuple(parameters),
        (("rate", evaluate),),
        max_step=min([boat.max_step, *(d.model.max_step for d in drives)]),
    )


def _renamed_state(drive: Drive, state: State) -> State:
    """Return a state of a bench model with the names of the joined model."""
    noise = drive.own(state.noise) if isinstance(state.noise, str) else state.noise
    meaning = f"{state.meaning}, thruster {drive.name}" if drive.name else state.meaning
    return State(drive.own(state.name), state.unit, meaning, noise)


def _renamed_parameter(drive: Drive, p: Parameter) -> Parameter:
    """Return a parameter of a bench model with its name in the joined model, and the thruster in its meaning."""
    meaning = f"{p.meaning}, thruster {drive.name}" if drive.name else p.meaning
    return replace(p, name=drive.own(p.name), meaning=meaning, per_record=False)


def _with_thrust(model: Model, thrust: Any) -> Model:
    """Return a model with other thrusts: ``thrust`` is a function from the signals to the thrust [N] by side.

    The stage ``thrust`` of the model runs before; it also sets the positions of the thrusters.
    """

    def changed(stage: ModelFunction) -> ModelFunction:
        """Return the stage ``thrust`` of the model, followed by the other thrusts."""

        def run(s: Signals) -> None:
            """Run the stage ``thrust`` of the model, then replace its thrusts ``s.f`` [N] by the other thrusts."""
            stage(s)
            s.f = thrust(s)

        return run

    return replace(model, stages=tuple((name, changed(f) if name == "thrust" else f) for name, f in model.stages))


def with_shaft_remark(content: Content) -> Content:
    """Return a content whose header says that commands are not its inputs, and how to have them as inputs.

    A content whose inputs are neither shaft speeds nor thrusts of thrusters is returned unchanged.
    """
    quantities = [SignalId.parse(i.name).quantity for i in content.history.inputs if i.name != COMMAND]
    if content.model.kind is not ModelKind.VEHICLE or not {SHAFT_SPEED, THRUSTER_FORCE} & set(quantities):
        return content
    are = "shaft speeds" if SHAFT_SPEED in quantities else "thrusts"
    of_effects = {i.name for e in content.model.effects for i in e.inputs}
    if any(i.tap and i.name not in of_effects for i in content.model.inputs):
        ways = ["For commands as inputs,"]  # `join` refuses a model that has a delay of its own (Nomoto)
    else:
        ways = [
            "For commands as inputs, either",
            "  fit the shafts (seatrial ident thruster LOG --thruster NAME: a bench log, or a log of the boat with",
            "  commands and shaft speeds), and export again with --thruster NAME=FILE for each thruster",
            "  (in Python thruster={...}), or",
        ]
    lines = [
        "",
        f"The inputs are {are}. The delay and the lag of the shafts behind their commands are not in this file,",
        "so that a loop that is closed with it is faster than that of the boat.",
        *ways,
        "  fit commands: seatrial ident vehicle LOG... --model horizontal:command.",
    ]
    return replace(content, remarks=(*content.remarks, *lines))


def _shaft_speed(thrust: Any, ahead: Any, astern: Any) -> Any:
    """Return the shaft speed of a thrust [N], with the thrusts ahead and astern at full speed [N].

    It is ``q / sqrt(|q|)`` of the thrust as a signed share q of that at full speed. The square roots of ``max(q, 0)``
    and ``max(-q, 0)`` would give the same value. One of them is always at zero, where its slope is infinite, so that
    automatic differentiation finds inf * 0 = NaN at each thrust. `SMALLEST_SHARE` keeps the slope finite at zero.
    """
    share_ahead, share_astern = np.maximum(thrust, 0.0) / ahead, np.maximum(-thrust, 0.0) / astern
    return (share_ahead - share_astern) / np.sqrt(share_ahead + share_astern + SMALLEST_SHARE)


def with_thrust_input(boat: Content) -> Content:
    """Return a boat model with the thrusts ``f_left``, ``f_right`` [N] as inputs in place of the shaft speeds.

    The motion is the same, but it has a slope at rest: the thrust ``c1 n|n| + c2 n^2`` has none at n = 0. The shaft
    speed of a thrust is the inverse of this curve, which the exported file contains (`Content.thrust_curve`).

    Raises
    ------
    SeatrialError
        If the inputs are no shaft speeds, if the model has no thrust curve, if an effect acts between shaft speed and
        thrust, or if the past or the work of the shafts is needed.

    Warns
    -----
    SeatrialWarning
        If an effect needs the shaft speed, whose slope by the thrust is infinite at zero thrust.
    """
    model = boat.model
    shafts = {i.name: thrust_of(SignalId.parse(i.name).source) for i in model.inputs if i.name in ("n_left", "n_right")}
    if not shafts or "thrust" not in dict(model.stages) or "c1" not in model.values:
        inputs_now = [i.name for i in model.inputs if not i.tap]
        instead = "leave it out"
        if any(name.startswith(COMMAND) for name in inputs_now):
            instead += (
                ", and give an optimiser make_step of the CasADi file and nonzero commands as its first guess "
                "(documentation: Controllers from a fitted model, MPC for a model of commands)"
            )
        raise SeatrialError(
            "--thrust-input needs a model with the shaft speeds n_left, n_right as inputs, such as horizontal:shaft; "
            f"the inputs of {model.source or model.name} are {', '.join(inputs_now)}: {instead}"
        )
    model = _without_late_sensors(model, set(shafts))
    _check_past(model, set(shafts))
    between = [e.name for e in model.effects if set(e.hooks) & set(SHAFT_STAGES)]
    if between:
        raise SeatrialError(
            f"--thrust-input: the effect {', '.join(between)} acts on the shaft speed; use a model without it"
        )
    c1, c2 = model.values["c1"], model.values["c2"]
    inputs = tuple(
        replace(i, name=shafts[i.name], unit="N", label=None) if i.name in shafts else i for i in model.inputs
    )

    def thrusts(s: Signals) -> dict[str, Any]:
        """Return the thrusts [N] among the inputs by side."""
        return {SignalId.parse(name).source: getattr(s.u, name) for name in shafts.values()}

    def speeds(s: Signals) -> None:
        """Set the shaft speeds ``s.n`` by side to those that have the given thrusts."""
        s.n = {side: _shaft_speed(f, s.p.c1 + s.p.c2, s.p.c1 - s.p.c2) for side, f in thrusts(s).items()}

    changed = _with_thrust(model, thrusts)
    stages = tuple((name, speeds if name == "shaft" else f) for name, f in changed.stages)
    if WORK_INPUT in {i.name for i in inputs}:
        names = " and ".join(e.name for e in model.effects if WORK_INPUT in {i.name for i in e.inputs})
        raise SeatrialError(
            f"--thrust-input: the effect {names} depends on the energy that the shafts have used, which the thrusts do "
            f"not give; leave out --thrust-input, or fit the boat without {names}"
        )
    changed = replace(changed, inputs=inputs, stages=stages)
    found = with_model(boat, changed, boat.saved.errors)
    if {"c1", "c2"} & {p.name for p in found.exported_parameters}:
        warn(
            "an effect of the model needs the shaft speed, whose slope by the thrust is infinite at zero thrust; it is "
            "bounded below a millionth of the full thrust. An optimiser that changes the direction of a thrust needs a "
            "limit of its iterations (documentation: Controllers from a fitted model, MPC with CasADi)"
        )
    validity = dict(boat.saved.validity)
    for shaft, force in shafts.items():
        if shaft in validity:
            low, high = (c1 * n * abs(n) + c2 * n * n for n in validity.pop(shaft))
            validity[force] = (low, high)
    return replace(
        found,
        saved=replace(boat.saved, validity=validity),
        effects=_kept_effects(boat, model),
        thrust_curve=(c1, c2),
        remarks=(
            *boat.remarks,
            "",
            "The inputs are thrusts. shaft_speed gives the shaft speed of a thrust, which is the set-point:",
            f"  the inverse of {c1!r} n|n| + {c2!r} n^2.",
        ),
    )
