"""Choice of a model for logs, and preparation of its input signals.

Signals that a log lacks are derived from others: thrust from a static thrust curve, total thrust, surge speed. The
module also reports signals that the model does not use, and checks that model and logs go together.

The hold of a signal is its interpolation between samples: ``zero`` (constant), ``linear`` or ``average``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from seatrial.daq.checks import advice_on_other_name
from seatrial.daq.errors import SeatrialError, first_names
from seatrial.ident.characterisation import (
    THRUSTER_RATE,
    ThrustCurve,
    load_curve,
    sum_of_held,
    thrust_channels,
    thruster_runs,
)
from seatrial.ident.data import (
    COMMANDS,
    SHAFTS,
    SHARED_WITHIN,
    SLOWEST_TELEMETRY,
    Channel,
    FrameOrigin,
    LoadedLog,
    LogSegment,
    PropulsionInput,
    far_apart,
    share_frame,
)
from seatrial.ident.estimation import SavedModel, model_file
from seatrial.ident.model import (
    COMMAND,
    SHAFT_SPEED,
    Model,
    ModelKind,
    SignalId,
    command_of,
    is_of_thruster,
    segment_name,
)
from seatrial.ident.models import KNOWN_SIGNALS, SENSORS, TELEMETRY_AGE, make_model, telemetry_age
from seatrial.ident.results import ResultWarning, UnusedSignal, frame_warnings

COMMAND_OPTION, SHAFT_OPTION = "command", "shaft"  # options in the name of a model: what its inputs are
CURVE_INPUTS = ("f_left", "f_right", "X", "X_n")  # inputs that a static thrust curve computes from commands


def known_curve(thruster: Path | None) -> ThrustCurve | None:
    """Return the static thrust curve of the file that --thruster names; None without a file.

    Parameters
    ----------
    thruster : Path or None
        File of the curve, a model.toml of `seatrial ident thruster`.

    Raises
    ------
    SeatrialError
        If the file cannot be read, or contains something other than a thrust curve.
    """
    curve = load_curve(thruster) if thruster is not None else None
    if thruster is not None and curve is None:
        raise SeatrialError(
            f"{thruster}: contains no static thrust curve; a model with shaft speeds as inputs already contains its "
            "thrust: leave out --thruster"
        )
    return curve


def derived_signals(
    channels: Mapping[str, Channel], holds: Mapping[str, str], source: str, curve: ThrustCurve | None, path: str | Path
) -> tuple[dict[str, Channel], dict[str, str]]:
    """Return the channels and holds of one log, with the input signals that are derived from others.

    Parameters
    ----------
    channels : mapping
        Channels of the log by name.
    holds : mapping
        Hold of each channel by name (interpolation between its samples): ``zero``, ``linear``, ``average`` or empty.
    source : str
        Name of the model, such as ``horizontal:force``.
    curve : ThrustCurve or None
        Static curve from command to thrust, if one is used.
    path : str or Path
        File of the log, for messages.

    Returns
    -------
    tuple of dict
        New mappings of channels and of holds, with the logged and the derived signals.

    Raises
    ------
    SeatrialError
        If a curve is given, and the log has neither the command nor the shaft speed of a thruster.

    Notes
    -----
    A curve gives the thrusts ``f_left`` and ``f_right``, their sum ``X``, and ``X_n``, the change of ``X`` per
    unit change of both commands away from zero. Without a curve, a missing ``X`` is the sum of the thrusts. Commands
    are used as missing shaft speeds, and shaft speeds as missing commands. Surge models use ``speed``, the speed along
    the track over ground, as a missing ``u``. Signals of the log are kept, except that the thrust of a curve replaces a
    logged one.
    """
    found, held = dict(channels), dict(holds)
    for name, substitute in zip(SHAFTS + COMMANDS, COMMANDS + SHAFTS, strict=True):
        if name not in channels and substitute in channels:
            found[name] = channels[substitute]
            held[name] = holds.get(substitute) or ("zero" if substitute in COMMANDS else "linear")
    if curve is not None:
        try:
            found |= thrust_channels(channels, curve)
        except ValueError as problem:
            raise SeatrialError(f"{path}: {problem}; the log has {', '.join(sorted(channels))}") from None
        held |= dict.fromkeys(CURVE_INPUTS, "zero")
    if "X" not in found and {"f_left", "f_right"} <= set(found):
        found["X"] = sum_of_held(found["f_left"], found["f_right"])
        held["X"] = "zero"
    if "u" not in found and "speed" in found and source.partition(":")[0] == "surge":
        found["u"] = found["speed"]
    return found, held


def with_derived_signals(log: LoadedLog, source: str, curve: ThrustCurve | None) -> LoadedLog:
    """Return a log with additional input signals of a model, which are derived from logged signals.

    These are thrusts by a static curve, the total thrust, missing shaft speeds from commands, missing commands from
    shaft speeds, and for surge models a missing surge speed from the speed over ground.

    Parameters
    ----------
    log : LoadedLog
        The log, which is not changed.
    source : str
        Name of the model, such as ``horizontal:force``.
    curve : ThrustCurve or None
        Static curve from command to thrust, if one is used.

    Raises
    ------
    SeatrialError
        If a curve is given, and the log has neither the command nor the shaft speed of a thruster.
    """
    found, held = derived_signals(log.run.channels, log.holds, source, curve, log.about["path"])
    return replace(log, run=replace(log.run, channels=found), holds=held)


def choose_model(source: str, loaded: Sequence[LoadedLog]) -> Model:
    """Return the model with the given name, with the sensors and the holds of the logs of a fit.

    The model has the sensors whose signals occur in the logs. Its inputs are interpolated between samples (hold) as in
    the first log. ``auto`` selects the horizontal model with inputs that all logs have: shaft speeds, else thrusts,
    else force and moment. In place of shaft speeds, ``auto`` takes commands as inputs and the shafts as states if the
    thruster signals of a log are commands. If a log has relayed telemetry and no log has commands, it adds the age of
    the telemetry to the model.

    Parameters
    ----------
    source : str
        Name of the model, or ``auto``.
    loaded : sequence of LoadedLog
        Logs with derived signals, at least one.

    Raises
    ------
    SeatrialError
        If the name is unknown, or if ``auto`` is given and not all logs have inputs for the horizontal model.
    """
    names = set.intersection(*[set(item.run.channels) for item in loaded])
    anywhere = set.union(*[set(item.run.channels) for item in loaded])
    late = False
    if source == "auto":
        options = {"shaft": {"n_left", "n_right"}, "force": {"f_left", "f_right"}, "general": {"X", "N"}}
        fitting = [kind for kind, wanted in options.items() if wanted <= names]
        if not fitting:
            hints = dict.fromkeys(h for n in sorted(names) if (h := advice_on_other_name(n)) and "shaft speed" in h)
            advice = "; ".join(hints) or "import such signals, or give another --model"
            raise SeatrialError(
                f"{loaded[0].about['path']}: no inputs for the horizontal model (n_left and n_right, or f_left and "
                f"f_right, or X and N); the log has {', '.join(sorted(names))}; {advice}"
            )
        kinds = {item.propulsion for item in loaded} if fitting[0] == "shaft" else set()
        late = PropulsionInput.COMMAND not in kinds and PropulsionInput.TELEMETRY in kinds
        source = "horizontal:command" if PropulsionInput.COMMAND in kinds else f"horizontal:{fitting[0]}"
    sensors = [n for n, s in SENSORS.items() if all(o.name in anywhere for o in s.outputs)]
    model = with_logged_holds(make_model(source, sensors), loaded[0].holds)
    return model + telemetry_age() if late else model


def unused_signals(
    model: Model, estimation: Sequence[LoadedLog], validation: Sequence[LoadedLog]
) -> list[UnusedSignal]:
    """Return the signals of the logs that the model does not use, with the reasons.

    Signals that were derived from others, and the second signal (command or shaft speed) of a thruster of which the
    model uses the first, are left out, except measured shaft speeds of all logs beside a model of commands: their
    reason names the model that uses them. The signals are in alphabetical order. Behind them are signals of the model
    that only validation logs contain, so that their noise cannot be estimated.

    Parameters
    ----------
    model : Model
        Model of the fit.
    estimation, validation : sequence of LoadedLog
        Logs that the model is fitted to, and logs that validate it.
    """
    loaded = [*estimation, *validation]
    taken = {i.tap_of if i.tap else i.name for i in model.inputs} | {o.name for o in model.outputs}
    there = {n for x in loaded for n in x.run.channels}
    found = []
    made = {"speed"} if {"vx", "speed_x"} & there else set()  # derived from other signals while the log was read
    made |= {"X", "X_n"} if "f_left" in there else set()
    for pair in zip(SHAFTS, COMMANDS, strict=True):  # two signals of one thruster: the model uses the better one
        made |= set(pair) if taken & set(pair) else set()
    for name in sorted(there - taken - made):
        logs = tuple(x.run.name for x in loaded if name in x.run.channels)
        found.append(_unused_signal(name, logs, model, there))
    found = sorted([*found, *_unused_shaft_speeds(model, loaded)], key=lambda signal: signal.signal)
    noise = {o.name: o.noise for o in model.outputs if o.noise and model.parameter(o.noise).free}
    estimated_noise = {noise.get(n) for x in estimation for n in x.run.channels}
    for name in sorted(n for n in noise.keys() & there if noise[n] not in estimated_noise):
        logs = tuple(x.run.name for x in validation if name in x.run.channels)
        reason = "no estimation log contains it, so its noise is unknown"
        found.append(UnusedSignal(signal=name, logs=logs, code="validation-only", reason=reason))
    return found


def _unused_signal(name: str, logs: tuple[str, ...], model: Model, there: set[str]) -> UnusedSignal:
    """Return the entry of the result for one logged signal that the model does not use, with the reason.

    ``logs``: names of the logs that contain the signal ``name``. ``there``: names of all signals of all logs. The
    reason is, in this order: a missing signal of the same sensor, a name that other programs use, a signal of other
    models, or an unknown name.
    """
    advice = advice_on_other_name(name)
    sensors = [[o.name for o in s.outputs] for s in SENSORS.values()]
    needs = [missing for names in sensors if name in names for missing in names if missing not in there]
    if needs:
        reason = f"the model uses it only together with {', '.join(needs)}, which no log has"
        return UnusedSignal(signal=name, logs=logs, code="incomplete-sensor", reason=reason)
    if advice is not None:
        return UnusedSignal(signal=name, logs=logs, code="other-name", reason=advice)
    if name in KNOWN_SIGNALS or SignalId.parse(name).quantity in ("voltage", SHAFT_SPEED, COMMAND):
        inputs = ", ".join(i.name for i in model.inputs if not i.tap)
        reason = f"model {model.name} with the inputs {inputs} does not use it"
    else:
        reason = "no model uses this name; the page Import of foreign logs lists the names that models use"
        return UnusedSignal(signal=name, logs=logs, code="unknown-name", reason=reason)
    return UnusedSignal(signal=name, logs=logs, code="not-in-model", reason=reason)


def _unused_shaft_speeds(model: Model, loaded: Sequence[LoadedLog]) -> list[UnusedSignal]:
    """Return the measured shaft speeds that a model of commands does not use; the reason names the model that does.

    The list is empty for other models, and if a log lacks measured shaft speeds.
    """
    options = model.source.split(":")
    if COMMAND_OPTION not in options or not all(_has_measured_shaft_speeds(log) for log in loaded):
        return []
    name = ":".join(SHAFT_OPTION if option == COMMAND_OPTION else option for option in options)
    reason = (
        "the model computes the shaft speeds from the commands, so that a lag or a limit of the shafts has to be "
        f"explained by the model; to use the measured ones, fit again with --model {name}"
    )
    if slow := [log.run.name for log in loaded if log.propulsion is PropulsionInput.COMMAND]:
        reason += (
            f", and compare both models: samples of the shaft speeds are more than {SLOWEST_TELEMETRY:g} s apart in "
            f"{', '.join(slow)}"
        )
    logs = tuple(log.run.name for log in loaded)
    return [UnusedSignal(signal=n, logs=logs, code="not-in-model", reason=reason) for n in SHAFTS]


def inputs_sentence(model: Model, loaded: Sequence[LoadedLog]) -> str:
    """Return a sentence on an automatic choice of commands as inputs, although the logs have measured shaft speeds.

    Parameters
    ----------
    model : Model
        Model that ``auto`` has chosen.
    loaded : sequence of LoadedLog
        Logs with derived signals.

    Returns
    -------
    str
        The inputs, the reason, and the model with the other ones. Empty for other inputs, and if a log lacks measured
        shaft speeds.
    """
    slow = [log.run.name for log in loaded if log.propulsion is PropulsionInput.COMMAND]
    if not slow or not (unused := _unused_shaft_speeds(model, loaded)):
        return ""
    measured = " and ".join(signal.signal for signal in unused)
    return (
        f"The thrust is that of the commands, not of the measured {measured}, whose samples are more than "
        f"{SLOWEST_TELEMETRY:g} s apart ({first_names(slow)}): --model horizontal:shaft takes the measured ones, and a "
        "comparison shows which model predicts better."
    )


def unused_lines(found: Sequence[UnusedSignal]) -> list[str]:
    """Return lines of text on unused signals: one line for each reason, with the signals that it applies to.

    Parameters
    ----------
    found : sequence of UnusedSignal
        Signals that the model does not use. Without any, the list is empty.
    """
    reasons = dict.fromkeys(s.reason for s in found)
    return [f"signals not used: {', '.join(s.signal for s in found if s.reason == r)} ({r})" for r in reasons]


def thrust_from(model: Model, loaded: Sequence[LoadedLog]) -> str:
    """Return a line of text on the signals that the model's thrust is computed from: shaft speeds or commands.

    Parameters
    ----------
    model : Model
        Model of the fit.
    loaded : sequence of LoadedLog
        Logs with derived signals (`with_derived_signals`). The line names those in which commands are used as shaft
        speeds, unless all are such logs.

    Returns
    -------
    str
        Empty if neither shaft speeds nor commands are inputs, for example if the thrust itself is an input.
    """
    if "n_state" in model.provides:
        renamed = (
            "; the logs have these commands as n_left and n_right, and the model calls them n_cmd_left and n_cmd_right"
            if any(_has_renamed_commands(x) for x in loaded)
            else ""
        )
        # `unused_signals` names the model that uses measured shaft speeds
        other = "" if _unused_shaft_speeds(model, loaded) else " (--model horizontal:shaft takes them as shaft speeds)"
        reason = (
            ""
            if all(x.propulsion is PropulsionInput.MEASURED for x in loaded)
            else ", as usual for logs without shaft speeds, or with samples of them that are late or more than "
            f"{SLOWEST_TELEMETRY:g} s apart{other}"
        )
        return (
            "thrust from the commands: the shafts are states with a dead zone, a delay and a time constant"
            f"{reason}{renamed}"
        )
    relayed = any(x.propulsion is PropulsionInput.TELEMETRY for x in loaded)
    if relayed and any(e.name == TELEMETRY_AGE for e in model.effects):
        return (
            "thrust from the shaft speeds that the autopilot relays; their age is estimated, and their sign is that of "
            "the delayed output (--model horizontal:shaft uses them unchanged, horizontal:command uses the outputs)"
        )
    if "n_input" not in model.provides:
        return ""
    command_only = [_has_commands_for_shaft_speeds(x) for x in loaded]
    if not any(command_only):
        return "thrust from the measured shaft speeds"
    affected = [x for x, only in zip(loaded, command_only, strict=True) if only]
    where = "" if all(command_only) else f" in {', '.join(x.run.name for x in affected)}"
    hint = ""
    if any(_has_held_shaft_speeds(x) for x in affected):
        hint = (
            ' (n_left and n_right have hold = "zero"; hold = "linear" in the import map makes them measured shaft '
            "speeds)"
        )
    text = "thrust from the commands, or an autopilot's outputs, without a lag: no shaft speed is measured"
    return f"{text}{where}{hint}"


def _has_renamed_commands(log: LoadedLog) -> bool:
    """Return whether the commands of a log with derived signals are imported as ``n_left`` and ``n_right``."""
    shaft, command = (log.run.channels.get(names[0]) for names in (SHAFTS, COMMANDS))
    return command is not None and command is shaft and command.source in SHAFTS


def _has_held_shaft_speeds(log: LoadedLog) -> bool:
    """Return whether ``n_left`` and ``n_right`` were imported with the hold ``zero`` (constant between samples).

    The shaft speeds are then treated as commands. False if the log lacks one of them.
    """
    return all(n in log.run.channels and log.run.channels[n].source == n and log.holds.get(n) == "zero" for n in SHAFTS)


def _has_measured_shaft_speeds(log: LoadedLog) -> bool:
    """Return whether a log has shaft speeds of both thrusters that are neither commands nor held or sampled outputs."""
    channels = log.run.channels
    return all(
        shaft in channels
        and channels[shaft] is not channels.get(command)
        and not channels[shaft].sampled
        and log.holds.get(shaft) != "zero"
        for shaft, command in zip(SHAFTS, COMMANDS, strict=True)
    )


def _has_commands_for_shaft_speeds(log: LoadedLog) -> bool:
    """Return whether commands are used as shaft speeds, because the log has nothing else (`with_derived_signals`).

    The commands may also be signals ``n_left`` and ``n_right`` that were imported as held values. Only the signals of
    the left thruster are compared.
    """
    shaft, command = (log.run.channels.get(names[0]) for names in (SHAFTS, COMMANDS))
    return shaft is command and log.propulsion is PropulsionInput.COMMAND


def with_logged_holds(model: Model, holds: Mapping[str, str]) -> Model:
    """Return the model whose inputs are interpolated between their samples (hold) as in a log.

    Parameters
    ----------
    model : Model
        The model, which is not changed.
    holds : mapping
        Hold of each signal by name. It also applies to the delayed taps of an input (``NAME~k``). An input without an
        entry, or with an empty one, keeps the hold of the model.
    """
    return replace(model, inputs=tuple(i.held(holds.get(i.tap_of or i.name, "")) for i in model.inputs))


def in_one_frame(
    model: Model, loaded: Sequence[LoadedLog], validation_logs: Sequence[LoadedLog], reference: FrameOrigin | None
) -> tuple[list[LoadedLog], list[LoadedLog]]:
    """Return the logs with positions x and y from one origin.

    The origin is that of a saved model, or else the first fix of the first log with latitude and longitude.

    Parameters
    ----------
    model : Model
        Model that the logs are used with.
    loaded, validation_logs : sequence of LoadedLog
        Logs for the estimation and for the validation. A log that begins more than 10 km from the origin, or has an
        unknown origin, is returned unchanged.
    reference : FrameOrigin or None
        Origin of the logs that a saved model was fitted to; None if it is unknown.

    Returns
    -------
    tuple of list of LoadedLog
        Estimation logs and validation logs.

    Raises
    ------
    SeatrialError
        If the model has a fixed point (mooring, tether) and the logs are too far apart to share it.
    """
    placed = share_frame([*loaded, *validation_logs], reference)
    require_one_frame(model, placed, reference)
    return placed[: len(loaded)], placed[len(loaded) :]


def require_one_frame(model: Model, logs: Sequence[LoadedLog], reference: FrameOrigin | None = None) -> None:
    """Check that all logs of a model with a fixed point begin within 10 km of one origin.

    A fixed point is the position of a mooring or tether, which is the same for all logs. A model without a fixed point
    is accepted with any logs.

    Parameters
    ----------
    model : Model
        Model that the logs are used with.
    logs : sequence of LoadedLog
        Logs after `share_frame`: x and y have one origin in all logs that are near each other. A log with an unknown
        origin is accepted.
    reference : FrameOrigin, optional
        Origin of the logs that the model was fitted to; by default that of the first log with a known origin.

    Raises
    ------
    SeatrialError
        If a log begins farther away.
    """
    points = [e.name for e in model.effects if e.fixed_point]
    for log in logs if points else ():
        reference = reference or log.origin
        if reference is not None and far_apart([reference, log.origin]):
            raise SeatrialError(
                f"{log.about['path']}: the log begins more than {SHARED_WITHIN / 1000:g} km from the first fix of "
                f"{reference.log or 'the logs of the model'}, but {points[0]} has one position for all logs; use "
                "logs from one place, or a model without it"
            )


def saved_frame_warnings(model: Model, logs: Sequence[LoadedLog], reference: FrameOrigin | None) -> list[ResultWarning]:
    """Return warnings about unknown origins of x and y, for logs that a saved model is applied to.

    There is at most one warning: if ``reference`` is None, or if the origin of a log is unknown.

    Parameters
    ----------
    model : Model
        The saved model. Without a fixed point (mooring, tether) the list is empty.
    logs : sequence of LoadedLog
        Logs that the model is applied to.
    reference : FrameOrigin or None
        Origin of the logs that the model was fitted to; None if unknown.

    Raises
    ------
    SeatrialError
        If the model has a fixed point (mooring, tether) and the logs are too far apart to share it.
    """
    require_one_frame(model, logs, reference)
    return frame_warnings(model, [log.run.name for log in logs if log.unplaced], saved_origin_unknown=reference is None)


HOLDS = {
    "zero": "held commands",
    "average": "averaged commands",
    "linear": "measured values",
    "sampled": "commands that are sampled late",
}


def hold_lines(saved: SavedModel, logs: Sequence[LoadedLog]) -> list[str]:
    """Return one line for each log whose inputs are of another kind than those that a saved model was fitted to.

    For example, ``n_left`` is a measured shaft speed in the fitted logs and a held command in the other one. The model
    then lacks the lag between both, or has it twice. In a log that was recorded and not imported, an input has the
    usual kind of the model. Inputs that the log does not have are left out.

    Parameters
    ----------
    saved : SavedModel
        The saved model, with the kind of its inputs in the fitted data (`SavedModel.holds`).
    logs : sequence of LoadedLog
        Logs that the model is applied to.
    """
    inputs = {i.name: i for i in saved.model.inputs}
    lines: list[str] = []
    for log in logs:
        kinds: dict[str, str] = {
            n: inputs[n].held(log.holds.get(n, "")).hold or ""
            for n in saved.holds
            if n in inputs and n in log.run.channels
        }
        # Without shaft speeds, the commands of the log take their place.
        kinds |= {
            n: "zero"
            for n in saved.holds
            if n not in log.run.channels
            and is_of_thruster(n, SHAFT_SPEED)
            and command_of(SignalId.parse(n).source) in log.run.channels
        }
        other = [n for n, kind in kinds.items() if kind and kind != saved.holds[n]]
        if other:
            here, there = (HOLDS.get(h, h) for h in (kinds[other[0]], saved.holds[other[0]]))
            lines.append(
                f"{log.about['path']}: {' and '.join(other)}: {here}, but the model was fitted to {there}: its "
                "prediction of this log is wrong by the lag between both; use a log with the same signals, or fit a "
                "model to this one"
            )
    return lines


def model_of_logs(
    model: Model,
    model_path: Path,
    loaded: Sequence[LoadedLog],
    validation_logs: Sequence[LoadedLog],
    thruster: str | None,
) -> tuple[Model, list[LogSegment], list[LogSegment], float]:
    """Return a saved model adapted to the logs, and the signals of the logs.

    Parameters
    ----------
    model : Model
        The saved model.
    model_path : Path
        File of the model, for messages.
    loaded, validation_logs : sequence of LoadedLog
        Logs for the estimation and for the validation.
    thruster : str or None
        For a vehicle model: file of the static thrust curve that it was fitted with, or None without a curve. For a
        thruster model: name of the thruster, or None if the logs have only one.

    Returns
    -------
    model : Model
        A vehicle model with the holds of the first log; a thruster model unchanged.
    estimation, validation : list of LogSegment
        Signals of each log, with those derived from others.
    rate : float
        Usual rate of the rows for this kind of model: 10 Hz for a vehicle model, 50 Hz for a thruster model.

    Raises
    ------
    SeatrialError
        For a vehicle model: if a log lacks an input that a thrust curve gives (``f_left``, ``f_right``, ``X``,
        ``X_n``), if no log has a sensor of the model, or if there is no such file of a curve. Other missing inputs are
        not detected here. For a thruster model: if a log lacks a signal, or if the thruster is not unique.
    """
    if model.kind is ModelKind.BENCH:
        runs, validation_runs = (thruster_runs(part, model, thruster) for part in (loaded, validation_logs))
        return model, runs, validation_runs, THRUSTER_RATE
    curve = known_curve(_curve_path(thruster, model_path))
    loaded, validation_logs = (
        [with_derived_signals(x, model.source, curve) for x in part] for part in (loaded, validation_logs)
    )
    _check_thrust_inputs(model, model_path, loaded, validation_logs)
    model = _check_sensors_and_set_holds(model, model_path, loaded, validation_logs)
    return model, [x.run for x in loaded], [x.run for x in validation_logs], 10.0


def _curve_path(thruster: str | None, model: Path) -> Path | None:
    """Return the file of the static thrust curve. The option ``--thruster`` names it. Without the option, return None.

    SeatrialError is raised if the file does not exist. The message contains ``model``, the file of the model.
    """
    if thruster is None:
        return None
    curve = model_file(Path(thruster))
    if not curve.is_file():
        raise SeatrialError(
            f"--thruster {thruster}: no such file; {model} is a boat's model, so give the static curve of its thrusters"
        )
    return curve


def _check_thrust_inputs(
    model: Model, path: Path, loaded: Sequence[LoadedLog], validation_logs: Sequence[LoadedLog]
) -> None:
    """Raise SeatrialError if a log lacks an input of the model that a thrust curve would give, such as ``f_left``.

    ``path``: file of the model, for the message.
    """
    thrusts = [i.name for i in model.inputs if i.name in CURVE_INPUTS]
    for log in (*loaded, *validation_logs):
        lost = [n for n in thrusts if n not in log.run.channels]
        if lost:
            raise SeatrialError(
                f"{log.about['path']}: no signal for the input {lost[0]!r} of {path}; if that was fitted with a "
                "static thrust curve, give it with --thruster CURVE"
            )


def _check_sensors_and_set_holds(
    model: Model, path: Path, loaded: Sequence[LoadedLog], validation_logs: Sequence[LoadedLog]
) -> Model:
    """Return a saved vehicle model whose inputs are interpolated between samples (hold) as in the first log.

    Raise SeatrialError if no log has any sensor of the model. Sensors that only some logs lack are accepted, and so are
    missing sensors beside others. A sensor of a user-defined model that is not in ``SENSORS`` counts as present.
    ``path``: file of the model, for the message.
    """
    logs = [*loaded, *validation_logs]
    present = [s.name for s in model.sensors if any(all(o.name in x.run.channels for o in s.outputs) for x in logs)]
    lost = [s.name for s in model.sensors if s.name in SENSORS and s.name not in present]
    if len(lost) == len(model.sensors):
        raise SeatrialError(
            f"{loaded[0].about['path']}: none of the sensors of {path} is in the log: {', '.join(lost)}; give a log "
            "with one of them, or another model"
        )
    return with_logged_holds(model, loaded[0].holds)


def check_names(model: Model, names: Sequence[str], n_logs: int) -> None:
    """Check that the parameters that the option ``--profile`` names are estimated by the fit.

    Parameters
    ----------
    model : Model
        Model of the fit.
    names : sequence of str
        Names of the parameters. A per-record parameter may also be named with the number of its log: ``NAME@0``,
        ``NAME@1``, ...
    n_logs : int
        Number of estimation logs.

    Raises
    ------
    SeatrialError
        If the model has no such parameter, or if the parameter is fixed.
    """
    known = {p.name: p for p in model.parameters}
    known |= {segment_name(p.name, i): p for p in model.parameters if p.per_record for i in range(n_logs)}
    for name in names:
        if name not in known:
            raise SeatrialError(
                f"--profile {name}: model {model.name} has no such parameter; it has {', '.join(model.values)}"
            )
        if not known[name].free:
            raise SeatrialError(
                f"--profile {name}: the parameter is fixed, not estimated; the estimated ones are "
                f"{', '.join(model.free)}"
            )


def check_horizon(
    horizon: float | None, loaded: Sequence[LoadedLog], validation_logs: Sequence[LoadedLog] = ()
) -> None:
    """Check that the prediction horizon of the option ``--horizon`` is shorter than the longest log for the evaluation.

    Parameters
    ----------
    horizon : float or None
        Prediction horizon [s]; None is accepted.
    loaded, validation_logs : sequence of LoadedLog
        Logs for the estimation and for the validation. The model is evaluated on the validation logs, or on the
        estimation logs if there are no validation logs.

    Raises
    ------
    SeatrialError
        If none of these logs is longer than the horizon.
    """
    longest = max(validation_logs or loaded, key=lambda x: float(x.about["duration"])).about
    if horizon is not None and not horizon < longest["duration"]:
        raise SeatrialError(
            f"--horizon {horizon:g}: {longest['path']}, the longest log that the model is evaluated on, "
            f"lasts {longest['duration']:.1f} s; give fewer seconds"
        )
