"""Signals that a model needs and a log does not have as such: thrust from a static curve, total thrust, speed ahead."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from seatrial.daq.errors import SeatrialError
from seatrial.ident.characterisation import (
    THRUSTER_RATE,
    ThrustCurve,
    load_curve,
    thrust_channels,
    thruster_runs,
    total,
)
from seatrial.ident.data import (
    COMMANDS,
    SHAFTS,
    SHARED_WITHIN,
    Channel,
    FrameOrigin,
    LoadedLog,
    LogSegment,
    PropulsionInput,
    far_apart,
    share_frame,
)
from seatrial.ident.model import Model, ModelKind, segment_name
from seatrial.ident.models import KNOWN_SIGNALS, SENSORS, TELEMETRY_AGE, make_model, telemetry_age
from seatrial.ident.results import ResultWarning, UnusedSignal, frame_warnings

CURVE_INPUTS = ("f_left", "f_right", "X", "X_n")  # what a static curve makes of commands


def known_curve(thruster: Path | None) -> ThrustCurve | None:
    """The static curve of a file. Raises SeatrialError where it holds something else."""
    curve = load_curve(thruster) if thruster is not None else None
    if thruster is not None and curve is None:
        raise SeatrialError(f"{thruster}: holds no static curve; a model on shaft speeds has its thrust in itself")
    return curve


def complete(
    channels: Mapping[str, Channel], holds: Mapping[str, str], source: str, curve: ThrustCurve | None, path: str | Path
) -> tuple[dict[str, Channel], dict[str, str]]:
    """Channels and holds of one log with what follows from them for a model ``source``.

    ``f_left``, ``f_right`` and ``X`` from commands by a curve; ``X`` from thrusts; for motion in a straight line
    ``u`` from the speed over ground; commands from shaft speeds, and the reverse, where the log has only the other.
    What is in the log stays, except that a curve's thrust goes before it.
    """
    found, held = dict(channels), dict(holds)
    for name, other in zip(SHAFTS + COMMANDS, COMMANDS + SHAFTS, strict=True):
        if name not in channels and other in channels:
            found[name], held[name] = channels[other], holds.get(other) or ("zero" if other in COMMANDS else "linear")
    if curve is not None:
        try:
            found |= thrust_channels(channels, curve)
        except ValueError as problem:
            raise SeatrialError(f"{path}: {problem}; the log has {', '.join(sorted(channels))}") from problem
        held |= dict.fromkeys(CURVE_INPUTS, "zero")
    if "X" not in found and {"f_left", "f_right"} <= set(found):
        found["X"] = total(found["f_left"], found["f_right"])
        held["X"] = "zero"
    if "u" not in found and "speed" in found and source.partition(":")[0] == "surge":
        found["u"] = found["speed"]
    return found, held


def completed(one: LoadedLog, source: str, curve: ThrustCurve | None) -> LoadedLog:
    """A log with what follows from its signals for a model ``source`` (``complete``)."""
    found, held = complete(one.run.channels, one.holds, source, curve, one.about["path"])
    return replace(one, run=replace(one.run, channels=found), holds=held)


def choose_model(source: str, loaded: Sequence[LoadedLog]) -> Model:
    """``auto`` takes the horizontal model with the inputs that the logs have, and the sensors that any log has: where
    one of them has commands only, with shafts that are states; where shaft speeds are relayed, with their age."""
    names = set.intersection(*[set(item.run.channels) for item in loaded])
    anywhere = set.union(*[set(item.run.channels) for item in loaded])
    late = False
    if source == "auto":
        options = {"shaft": {"n_left", "n_right"}, "force": {"f_left", "f_right"}, "general": {"X", "N"}}
        fitting = [kind for kind, wanted in options.items() if wanted <= names]
        if not fitting:
            hints = dict.fromkeys(h for n in sorted(names) if (h := _called_elsewhere(n)) and "shaft speed" in h)
            raise SeatrialError(
                f"{loaded[0].about['path']}: no inputs for the horizontal model (n_left and n_right, or f_left and "
                f"f_right, or X and N); the log has {', '.join(sorted(names))}{''.join(f'; {h}' for h in hints)}"
            )
        ways = {item.propulsion for item in loaded} if fitting[0] == "shaft" else set()
        late = PropulsionInput.COMMAND not in ways and PropulsionInput.TELEMETRY in ways
        source = "horizontal:command" if PropulsionInput.COMMAND in ways else f"horizontal:{fitting[0]}"
    sensors = [n for n, s in SENSORS.items() if all(o.name in anywhere for o in s.outputs)]
    model = as_logged(make_model(source, sensors), loaded[0].holds)
    return model + telemetry_age() if late else model


# Signals by what they are called elsewhere, and what to do with them
OTHER_NAMES = {
    "speed_x": "velocity over ground to the north is called vx",
    "speed_y": "velocity over ground to the east is called vy",
    "lat": "positions are x, y in metres north and east",
    "lon": "positions are x, y in metres north and east",
    "sog": "velocity over ground is called vx, vy (m/s, north and east)",
    "cog": "velocity over ground is called vx, vy (m/s, north and east)",
    "pwm": "a pulse is no shaft speed: map it to n_left, n_right (-1..1) by scale and offset",
    "servo": "a pulse is no shaft speed: map it to n_left, n_right (-1..1) by scale and offset",
    "yaw": "the heading is called psi",
    "heading": "the heading is called psi",
    "yaw_rate": "the yaw rate is called r",
}


def unused_signals(
    model: Model, estimation: Sequence[LoadedLog], validation: Sequence[LoadedLog]
) -> list[UnusedSignal]:
    """Signals of the logs that no input and no sensor of the model takes, each with the reason; and those of sensors
    that only validation logs have and whose noise nobody gave (``without_untold_sensors``)."""
    loaded = [*estimation, *validation]
    taken = {i.tap_of if i.tap else i.name for i in model.inputs} | {o.name for o in model.outputs}
    there = {n for x in loaded for n in x.run.channels}
    found = []
    made = {"speed"} if {"vx", "speed_x"} & there else set()  # of others, when the log was read
    made |= {"X", "X_n"} if "f_left" in there else set()
    for pair in zip(SHAFTS, COMMANDS, strict=True):  # two accounts of one thruster: the model takes the better one
        made |= set(pair) if taken & set(pair) else set()
    for name in sorted(there - taken - made):
        logs = tuple(x.run.name for x in loaded if name in x.run.channels)
        found.append(_unused(name, logs, model, there))
    noise = {o.name: o.noise for o in model.outputs if o.noise and model.parameter(o.noise).free}
    told = {noise.get(n) for x in estimation for n in x.run.channels}
    for name in sorted(n for n in noise.keys() & there if noise[n] not in told):
        logs = tuple(x.run.name for x in validation if name in x.run.channels)
        reason = "no estimation log has it, so that its noise is not known"
        found.append(UnusedSignal(signal=name, logs=logs, code="validation-only", reason=reason))
    return found


def _called_elsewhere(name: str) -> str | None:
    """What to do with a signal of this name; None for one that is not known."""
    return next((text for other, text in OTHER_NAMES.items() if name == other or name.startswith(f"{other}_")), None)


def _unused(name: str, logs: tuple[str, ...], model: Model, there: set[str]) -> UnusedSignal:
    known = _called_elsewhere(name)
    sensors = [[o.name for o in s.outputs] for s in SENSORS.values()]
    needs = [other for names in sensors if name in names for other in names if other not in there]
    if needs:
        reason = f"the model takes it together with {', '.join(needs)}, which no log has"
        return UnusedSignal(signal=name, logs=logs, code="incomplete-sensor", reason=reason)
    if known is not None:
        return UnusedSignal(signal=name, logs=logs, code="other-name", reason=known)
    if name in KNOWN_SIGNALS or name.partition("_")[0] in ("voltage", "n"):
        inputs = ", ".join(i.name for i in model.inputs if not i.tap)
        reason = f"model {model.name} with the inputs {inputs} has no place for it"
    else:
        reason = "no model takes this name; docs/formats/import.md lists those that are taken"
        return UnusedSignal(signal=name, logs=logs, code="unknown-name", reason=reason)
    return UnusedSignal(signal=name, logs=logs, code="not-in-model", reason=reason)


def unused_lines(found: Sequence[UnusedSignal]) -> list[str]:
    """A line for each reason, with the signals that it is for."""
    reasons = dict.fromkeys(s.reason for s in found)
    return [f"not used: {', '.join(s.signal for s in found if s.reason == r)}: {r}" for r in reasons]


def thrust_from(model: Model, loaded: Sequence[LoadedLog]) -> str:
    """A line on what the thrust of a model follows in these logs, ``completed``; empty where it is given as such."""
    if "n_state" in model.provides:
        return (
            "thrust from the commands: no shaft speed is measured in time, so the shafts are states with a dead "
            "zone, a delay and a time constant (--model horizontal:shaft takes the signals as shaft speeds)"
        )
    if any(e.name == TELEMETRY_AGE for e in model.effects):
        return (
            "thrust from the shaft speeds that the autopilot relays, of an age that is estimated, with the sign of "
            "the delayed output (--model horizontal:shaft takes them as they are, horizontal:command the outputs)"
        )
    if "n_input" not in model.provides:
        return ""
    told = [_told_only(x) for x in loaded]
    if not any(told):
        return "thrust from the measured shaft speeds"
    where = "" if all(told) else f" in {', '.join(x.run.name for x, only in zip(loaded, told, strict=True) if only)}"
    hint = ""
    if any(_held_speed(x) for x, only in zip(loaded, told, strict=True) if only):
        hint = ' (n_left and n_right have hold = "zero"; hold = "linear" of the map makes them measured shaft speeds)'
    text = "thrust from the commands, or an autopilot's outputs, followed at once: no shaft speed is measured"
    return f"{text}{where}{hint}"


def _held_speed(one: LoadedLog) -> bool:
    """Whether a map calls its signals n_left and n_right, and lets them hold as commands do."""
    return all(n in one.run.channels and one.run.channels[n].source == n and one.holds.get(n) == "zero" for n in SHAFTS)


def _told_only(one: LoadedLog) -> bool:
    """Whether commands stand for the shaft speeds that the log has not."""
    shaft, command = (one.run.channels.get(names[0]) for names in (SHAFTS, COMMANDS))
    return shaft is command and one.propulsion is PropulsionInput.COMMAND


def as_logged(model: Model, holds: Mapping[str, str]) -> Model:
    """The model with its inputs, and their delayed copies, held as in a log."""
    return replace(model, inputs=tuple(i.held(holds.get(i.tap_of or i.name, "")) for i in model.inputs))


def in_one_frame(
    model: Model, loaded: Sequence[LoadedLog], unseen: Sequence[LoadedLog], reference: FrameOrigin | None
) -> tuple[list[LoadedLog], list[LoadedLog]]:
    """The logs with x and y from the origin of a saved model, where it has one (``require_one_frame``)."""
    placed = share_frame([*loaded, *unseen], reference)
    require_one_frame(model, placed, reference)
    return placed[: len(loaded)], placed[len(loaded) :]


def require_one_frame(model: Model, logs: Sequence[LoadedLog], reference: FrameOrigin | None = None) -> None:
    """Raises SeatrialError where the model has a fixed point (a mooring, a tether), which is one for all logs, and the
    logs surely have no common frame; ``reference``: the origin of the logs that it was fitted to."""
    points = [e.name for e in model.effects if e.fixed_point]
    for one in logs if points else ():
        reference = reference or one.origin
        if reference is not None and far_apart([reference, one.origin]):
            raise SeatrialError(
                f"{one.about['path']}: it begins more than {SHARED_WITHIN / 1000:g} km from the first fix of "
                f"{reference.log or 'the logs of the model'}, and {points[0]} is at one place for all logs; take logs "
                "of one place, or a model without it"
            )


def saved_frame_warnings(model: Model, logs: Sequence[LoadedLog], reference: FrameOrigin | None) -> list[ResultWarning]:
    """What is assumed of the x and y of logs that a saved model is used on as it is (``require_one_frame``)."""
    require_one_frame(model, logs, reference)
    return frame_warnings(model, [one.run.name for one in logs if one.unplaced], saved_origin_unknown=reference is None)


def model_of_logs(
    model: Model, model_path: Path, loaded: Sequence[LoadedLog], unseen: Sequence[LoadedLog], thruster: str | None
) -> tuple[Model, list[LogSegment], list[LogSegment], float]:
    """The saved model as these logs can ask it; its runs to estimate and to validate; its usual rows a second."""
    if model.kind is ModelKind.BENCH:
        runs, others = (thruster_runs(part, model, thruster) for part in (loaded, unseen))
        return model, runs, others, THRUSTER_RATE
    curve = known_curve(_curve_path(thruster, model_path))
    loaded, unseen = ([completed(x, model.source, curve) for x in part] for part in (loaded, unseen))
    model = _sensed(_pushed(model, model_path, loaded, unseen), model_path, loaded, unseen)
    return model, [x.run for x in loaded], [x.run for x in unseen], 10.0


def _curve_path(thruster: str | None, model: Path) -> Path | None:
    if thruster is None:
        return None
    if not Path(thruster).is_file():
        raise SeatrialError(
            f"--thruster {thruster}: no such file; {model} is a boat's model, so give the static curve of its thrusters"
        )
    return Path(thruster)


def _pushed(model: Model, path: Path, loaded: Sequence[LoadedLog], unseen: Sequence[LoadedLog]) -> Model:
    """The model, whose thrust all logs have; SeatrialError where one lacks what a static curve would give."""
    thrusts = [i.name for i in model.inputs if i.name in CURVE_INPUTS]
    for one in (*loaded, *unseen):
        lost = [n for n in thrusts if n not in one.run.channels]
        if lost:
            raise SeatrialError(
                f"{one.about['path']}: no signal for the input {lost[0]!r} of {path}; where that was fitted with a "
                "static thrust curve, give it with --thruster CURVE"
            )
    return model


def _sensed(model: Model, path: Path, loaded: Sequence[LoadedLog], unseen: Sequence[LoadedLog]) -> Model:
    """A vehicle's model with its inputs held as in the logs; SeatrialError where they have none of its sensors."""
    logs = [*loaded, *unseen]
    present = [n for n, s in SENSORS.items() if any(all(o.name in x.run.channels for o in s.outputs) for x in logs)]
    lost = [s.name for s in model.sensors if s.name in SENSORS and s.name not in present]
    if len(lost) == len(model.sensors):
        raise SeatrialError(
            f"{loaded[0].about['path']}: none of the sensors of {path} is in the log: {', '.join(lost)}"
        )
    return as_logged(model, loaded[0].holds)


def check_names(model: Model, names: Sequence[str], n_logs: int) -> None:
    """Raises SeatrialError, before any fit, for a name that no fit of the model to so many logs will have estimated."""
    known = {p.name: p for p in model.parameters}
    known |= {segment_name(p.name, i): p for p in model.parameters if p.per_record for i in range(n_logs)}
    for name in names:
        if name not in known:
            raise SeatrialError(f"--profile {name}: model {model.name} has {', '.join(model.values)}")
        if not known[name].free:
            raise SeatrialError(f"--profile {name}: it is given, not estimated; estimated are {', '.join(model.free)}")


def check_ahead(horizon: float | None, loaded: Sequence[LoadedLog], unseen: Sequence[LoadedLog] = ()) -> None:
    """Raises SeatrialError where no log of those that judge is as long as predictions shall go ahead [s]."""
    longest = max(unseen or loaded, key=lambda x: float(x.about["duration"])).about
    if horizon is not None and not horizon < longest["duration"]:
        raise SeatrialError(
            f"--horizon {horizon:g}: {longest['path']}, the longest log to judge by, "
            f"lasts {longest['duration']:.1f} s; give fewer seconds"
        )
