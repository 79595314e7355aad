"""Checks of logs: the HTML page of `seatrial check`, and the checks that run before a fit.

The checks before a fit refuse logs whose faults would make its result meaningless. They also adapt the noise model to
signals that are filtered or rounded.
"""

from __future__ import annotations

import hashlib
import math
import pickle
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from seatrial.daq.checks import FAULT, CheckReport, Finding
from seatrial.daq.errors import SeatrialError, counted
from seatrial.ident.checks import (
    ESTIMATED,
    IMPORTED,
    RecentResults,
    check_copies,
    check_signals,
    compare_headings,
    compare_shaft_gains,
    estimated,
    heading_angle,
    held_of_thrusters,
    invalidates_fit,
    log_evidence,
    smoothed,
)
from seatrial.ident.data import (
    SHORTEST_PIECE_S,
    Channel,
    LoadedLog,
    LogSegment,
    part_of_log,
    seconds,
    within_window,
)
from seatrial.ident.model import (
    COMMAND,
    INF,
    SHAFT_SPEED,
    THRUSTER_FORCE,
    Model,
    ParameterOrigin,
    SignalId,
    is_of_thruster,
)
from seatrial.ident.models import (
    ESTIMATOR_ERROR,
    NOISE,
    SENSORS_WITH_CORRELATED_ERRORS,
    estimator_error,
    navigation_errors,
)
from seatrial.ident.numerics import rounding_step
from seatrial.ident.report import write_check_page

LEAST_WHITE = 0.02  # least white noise of a navigation filter's output, relative to that of a usual sensor
TURNING = 0.05  # of full speed; a shaft turns at larger speeds
OF_COMMANDS = frozenset({"shaft-speed-drifts"})  # codes of findings that concern only models of commands
INITIAL_FACTOR = 1.5  # initial value of a noise with a floor, relative to the floor
# A fit, its diagnosis and a comparison of models check the same log each time, which takes as long as some evaluations
# of the likelihood.
_findings = RecentResults[tuple[Finding, ...]]()


def write_check(report: CheckReport, command: str, out: Path) -> None:
    """Write the HTML page of `seatrial check`: the findings, and plots of the signals of the checked logs.

    Parameters
    ----------
    report
        Findings of the check, and the paths of the checked logs. If the check has a rig file and one log, the plots are
        labelled with the subject of the check, otherwise with the name of each log.
    command
        Command line, for the provenance on the page.
    out
        File of the page.

    Raises
    ------
    SeatrialError
        If a log of the check cannot be read.
    OSError
        If ``out`` cannot be written.
    """
    name = report.subject if report.rig is not None and len(report.logs) == 1 else ""
    parts = [part for path in report.logs for part in log_evidence(path, name, report.window)]
    write_check_page(report, parts, command, out)


def check_first(
    loaded: Sequence[LoadedLog], validation_logs: Sequence[LoadedLog], model: Model, despite_faults: bool
) -> tuple[list[LoadedLog], list[LoadedLog]]:
    """Check the estimation and validation logs of a command before its fit, also against each other.

    Parameters
    ----------
    loaded, validation_logs : sequence of LoadedLog
        Logs whose devices were checked when they were loaded (argument ``device_faults`` of the loading function).
    model : Model
        Model of the fit. Its parameters ``y_left`` and ``y_right`` [m] give the sides of the thrusters. Without them
        the rig gives the sides.
    despite_faults : bool
        Whether faults that make a fit meaningless are accepted.

    Returns
    -------
    tuple of list of LoadedLog
        Copies of the estimation logs and of the validation logs, with the findings in ``about["findings"]``.

    Raises
    ------
    SeatrialError
        If a log has a fault that makes a fit meaningless (frames, signs, units, sides, time, frozen signals, a copied
        log), and ``despite_faults`` is false.
    """
    logs = [*loaded, *validation_logs]
    copies = _overlaps(logs)
    parts = [
        (x, part_of_log(x.about)) for x in logs
    ]  # a part is read with a minute on both sides, which does not count
    copies += check_copies([(x.about["path"], within_window(x.run.channels, p.t_from, p.t_to)) for x, p in parts])
    # A model that the shaft speeds drive is right for each of them, whatever the commands were.
    driven = _has_shaft_speed(i.tap_of or i.name for i in model.inputs)
    differences = (
        [] if driven else compare_shaft_gains([(x.about["path"], held_of_thrusters(x.run.channels)) for x in logs])
    )
    if len(logs) > 1:
        differences += compare_headings([(x.about["path"], heading_angle(x.run.channels)) for x in logs])
    checked = []
    for log in logs:
        more = [f for f in copies if f.where == log.about["path"]]
        more += [finding for path, finding in differences if path == log.about["path"]]
        sides, by_shafts = sides_of_model(model, log), _uses_shaft_speeds(model)
        checked.append(
            with_findings(
                log,
                sides,
                despite_faults,
                more,
                uses_shaft_speeds=by_shafts,
                besides=OF_COMMANDS if driven else (),
                known_noise=signals_of_given_noise(model),
            )
        )
    return checked[: len(loaded)], checked[len(loaded) :]


def _overlaps(logs: Sequence[LoadedLog]) -> list[Finding]:
    """Return a fault ``log-copied`` for each part of a log that overlaps with an earlier part of the same file."""
    found = []
    parts = [part_of_log(x.about) for x in logs]
    for k, (log, part) in enumerate(zip(logs, parts, strict=True)):
        for earlier, before in zip(logs[:k], parts[:k], strict=True):
            common = part.overlap(before)
            if 0.0 < common < math.inf:
                text = f"overlaps with {earlier.about['path']} for {seconds(common)} s: they would count twice"
                advice = "choose parts of this log that do not overlap, or give a log of another run"
                found.append(Finding(FAULT, "log-copied", "log", log.about["path"], text, advice))
                break
    return found


def require_thrust_and_length(segments: Sequence[LogSegment], model: Model, despite_faults: bool) -> None:
    """Check that the estimation logs of a vehicle model are long enough for a fit, and that some of them have thrust.

    A model without inputs of thrusters passes, except for the length. One log with thrust is enough, because drifting
    without thrust beside it shows wind and current.

    Parameters
    ----------
    segments : sequence of LogSegment
        Estimation logs with the inputs of the model.
    model : Model
        Model of the boat.
    despite_faults : bool
        Whether logs are accepted that fail this check, for example those of a boat that coasts.

    Raises
    ------
    SeatrialError
        If the logs together are shorter than 10 s (`SHORTEST_PIECE_S`), or if no command or shaft speed exceeds 0.05
        of full speed and no thrust differs from zero, and ``despite_faults`` is false.
    """
    if despite_faults:
        return
    more = f" and {counted(len(segments) - 1, 'more log')}" if len(segments) > 1 else ""
    where = f"{segments[0].name}{more}"
    own = [i.name for i in model.inputs if not i.tap_of]
    driving = [n for n in own if is_of_thruster(n, COMMAND, SHAFT_SPEED, THRUSTER_FORCE) or n in ("X", "N")]
    despite = "to fit all the same, add --despite-faults"
    spans = [_span(s, model) for s in segments]
    lasts = sum(end - start for start, end in spans)
    if lasts < SHORTEST_PIECE_S:
        raise SeatrialError(
            f"{where}: {lasts:.1f} s of data, and a fit needs {SHORTEST_PIECE_S:g} s or more, because a boat takes "
            f"seconds to answer its thrusters; give longer logs, or a longer part of them; {despite}"
        )
    inputs = [
        (s.channels[n], n, *span) for s, span in zip(segments, spans, strict=True) for n in driving if n in s.channels
    ]
    if inputs and not any(_has_thrust(*signal) for signal in inputs):
        raise SeatrialError(
            f"{where}: {', '.join(driving)}: no thrust in the whole time, so that a fit finds neither masses nor "
            "damping; give a run with steps of the command (seatrial mission generate), or check that these are the "
            f"signals that drive the boat; {despite}"
        )


def _span(segment: LogSegment, model: Model) -> tuple[float, float]:
    """Return the start and the end [s] of the time in which a segment has all inputs and any sensor of a model.

    The end equals the start if the segment has no such time.
    """
    inputs, sensors = (
        [c for s in signals if (c := segment.channels.get(s.name)) is not None and c.t.size]
        for signals in (model.inputs, model.outputs)
    )
    start = max([min((float(c.t[0]) for c in sensors), default=0.0), *(float(c.t[0]) for c in inputs)])
    end = max((float(c.t[-1]) for c in sensors), default=start)
    start = start if segment.t_from is None else max(start, segment.t_from)
    end = end if segment.t_to is None else min(end, segment.t_to)
    return start, max(start, end)


def _has_thrust(channel: Channel, name: str, start: float, end: float) -> bool:
    """Return whether an input differs from zero between two times [s]: a shaft by more than 0.05 of full speed."""
    first = max(int(np.searchsorted(channel.t, start, side="right")) - 1, 0)  # the value that is held at the start
    sizes = np.abs(channel.value[first : int(np.searchsorted(channel.t, end, side="right"))])
    return bool(np.nanmax(sizes, initial=0.0) > (TURNING if is_of_thruster(name, COMMAND, SHAFT_SPEED) else 0.0))


def signals_of_given_noise(model: Model) -> set[str]:
    """Return the names of the outputs whose noise the user has fixed, for example by ``--fix e_psi=0.03``."""
    given = {p.name for p in model.parameters if not p.free and p.origin is ParameterOrigin.GIVEN}
    return {o.name for o in model.outputs if o.noise in given}


def _uses_shaft_speeds(model: Model) -> bool:
    """Return whether an input or an output of the model is a shaft speed, so that the fit uses those of the log."""
    return _has_shaft_speed([*(i.tap_of or i.name for i in model.inputs), *(o.name for o in model.outputs)])


def _has_shaft_speed(names: Iterable[str]) -> bool:
    """Return whether a signal of these names is a shaft speed."""
    return any(SignalId.parse(name).quantity == SHAFT_SPEED for name in names)


def with_findings(
    log: LoadedLog,
    sides: Mapping[str, float],
    despite_faults: bool,
    more: Sequence[Finding] = (),
    *,
    uses_shaft_speeds: bool = True,
    besides: Collection[str] = (),
    known_noise: Collection[str] = (),
) -> LoadedLog:
    """Check a log before a fit, and return a copy with the findings in ``about["findings"]``.

    Parameters
    ----------
    log : LoadedLog
        Log whose devices were checked when it was loaded (argument ``device_faults`` of the loading function).
    sides : mapping of str to float
        Position of each thruster to starboard [m], by name of the thruster; empty for a bench.
    despite_faults : bool
        Whether faults that make a fit meaningless are accepted.
    more : sequence of Finding
        Findings of other checks of this log.
    uses_shaft_speeds : bool
        Whether the fit uses the shaft speeds of the log. False: faults of their telemetry do not refuse the log.
    besides : collection of str
        Codes of findings that are left out, because they are of no concern for the fit.
    known_noise : collection of str
        Signals whose noise the user has given to the fit. They are not reported as smoothed.

    Returns
    -------
    LoadedLog
        Copy of the log. Its findings are those on the devices, on the signals, and ``more``, each as a dictionary;
        only warnings and faults are kept. Its key ``spoils`` is true if the finding makes a fit meaningless.

    Raises
    ------
    SeatrialError
        If the log has a fault that makes a fit meaningless, and ``despite_faults`` is false.
    """
    name = log.about["path"]
    assert log.device_faults is not None, "logs of a fit are loaded with `device_faults`"
    found = [*log.device_faults, *_signal_findings(log.own_channels, sides, known_noise), *more]
    reported = [f for f in found if f.is_problem and f.code not in besides]
    refused = [f for f in reported if invalidates_fit(f, uses_shaft_speeds)]
    if refused and not despite_faults:
        first, where = refused[0], "" if refused[0].where == name else f"{refused[0].where}: "
        rest = f" ({counted(len(refused) - 1, 'more fault')})" if len(refused) > 1 else ""
        raise SeatrialError(
            f"{name}: {where}{first.text} [{first.code}]{rest}; "
            f"{first.advice}. `seatrial check` lists all findings; to fit the log with its faults, add --despite-faults"
        )
    rows = [f._asdict() | {"spoils": invalidates_fit(f, uses_shaft_speeds)} for f in reported]
    return replace(log, about=log.about | {"findings": rows})


def _signal_findings(
    c: Mapping[str, Channel], sides: Mapping[str, float], known_noise: Collection[str]
) -> tuple[Finding, ...]:
    """Return the findings of `check_signals`, from memory if signals with the same samples were checked recently."""
    # A log that is opened again has other arrays with the same samples, so that a hash of the samples is the key.
    key = hashlib.sha256(pickle.dumps((dict(c), dict(sides), sorted(known_noise)))).digest()
    return _findings.get((), lambda: tuple(check_signals(c, sides, known_noise)), key)


def sides_of_model(model: Model, log: LoadedLog) -> Mapping[str, float]:
    """Return the position of each thruster to starboard [m] by name of the thruster, for the checks before a fit.

    The positions are the values of the parameters ``y_left`` and ``y_right`` of the model; a thruster whose parameter
    the model lacks is then left out. If the model has neither, they are those in the rig of the log. Without a rig they
    are -1 m for ``left`` and +1 m for ``right``.

    Parameters
    ----------
    model : Model
        Model of the boat.
    log : LoadedLog
        Log with or without a rig.
    """
    arms = {side: model.values[f"y_{side}"] for side in ("left", "right") if f"y_{side}" in model.values}
    if arms:
        return arms
    return {t.name: t.position_m[1] for t in log.rig.thrusters} if log.rig else IMPORTED


def with_estimator_errors(
    model: Model, logs: Sequence[LoadedLog], user_given: Collection[str] = ()
) -> tuple[Model, list[str]]:
    """Add states for correlated navigation errors if the position of a log is probably that of a navigation filter.

    Such a position has less white noise (below 3 cm) than a GNSS receiver without fixed ambiguities.

    Parameters
    ----------
    model : Model
        Model of the boat.
    logs : sequence of LoadedLog
        Estimation logs. One log with such a position is enough.
    user_given : collection of str
        Names of the parameters that the user fixed or gave a prior. If they include the noise of the position, this
        noise is taken as white and no states are added.

    Returns
    -------
    tuple of Model and list of str
        The model, and a list with one line of text about the added states. If no states are added, the unchanged model
        and an empty list. This is also so if the model has no position noise or no heading, or has these states
        already.
    """
    position = next((o.noise for o in model.outputs if o.name == "x" and o.noise), None)
    there = ESTIMATOR_ERROR in {e.name for e in model.effects}
    if position is None or there or "heading" not in model.provides or position in user_given:
        return model, []
    if not any(estimated(log.run.channels) for log in logs):
        return model, []
    sensors = [s.name for s in model.sensors]
    errors = ", ".join(e.of for e in navigation_errors(sensors))
    line = (
        "The position is probably the output of a navigation filter, or of an RTK receiver: its noise from sample to "
        f"sample is below {100 * ESTIMATED:g} cm, which is less than that of other receivers. Correlated errors of its "
        f"{errors} are therefore states of the model. For an RTK receiver whose errors do not last, give its white "
        f"noise instead, such as --fix {position}=0.02 (m)."
    )
    return model + estimator_error(sensors), [line]


def with_noise_floors(model: Model, logs: Sequence[LoadedLog]) -> tuple[Model, list[str]]:
    """Set lower bounds for the free noise parameters of smoothed channels, and raise their values above the bounds.

    A channel is smoothed if it has less white noise than any sensor, for example the output of a filter. Values below
    1.5 times the bound are set to 1.5 times the bound. Upper bounds of these parameters are removed.

    Parameters
    ----------
    model : Model
        Model of the boat.
    logs : sequence of LoadedLog
        Estimation logs. A channel counts as smoothed if it is so in at least one of them.

    Returns
    -------
    tuple of Model and list of str
        The model, and a list with one line of text: the smoothed channels and their bounds. The list is empty if there
        is no such channel with a free noise parameter.

    Notes
    -----
    The output of a filter has correlated errors and almost no noise from sample to sample. A fit that takes the noise
    as white estimates it near zero, and the states then follow the filter. The bound is the noise of a usual sensor
    (``seatrial.ident.models.NOISE``). Channels whose correlated errors are states of the model have a bound too, even
    if they are not smoothed. It is 2 % of that noise, and the line does not list it. No bound is less than the rounding
    error of the signal: consecutive rounded samples may be equal, so the noise would be underestimated, and the forces
    would follow the rounding steps.
    """
    usual, states = {p.name: p.value for p in NOISE.values()}, ESTIMATOR_ERROR in {e.name for e in model.effects}
    lasting = {o.name for s in model.sensors if states and s.name in SENSORS_WITH_CORRELATED_ERRORS for o in s.outputs}
    smooth = {name for log in logs for name in smoothed(log.run.channels)} - lasting
    part = dict.fromkeys(smooth, 1.0) | dict.fromkeys(lasting, LEAST_WHITE)
    least: dict[str, float] = {}
    for o in model.outputs:
        if o.name in part and o.noise in usual:
            rounded = max((_rounding_error(log.run.channels, o.name) for log in logs), default=0.0)
            least[o.noise] = max(least.get(o.noise, 0.0), part[o.name] * usual[o.noise], rounded)
    floors = [replace(p, value=max(p.value, INITIAL_FACTOR * least[p.name]), bounds=(least[p.name], INF))
              for p in model.parameters if p.free and p.name in least]  # fmt: skip
    estimated_noise = {p.name for p in floors}
    listed = {o.name: o.noise for o in model.outputs if o.name in smooth and o.noise in estimated_noise}
    bounds = ", ".join(
        f"{p.name} {p.bounds[0]:g} {p.unit}{' by its rounding' * (p.bounds[0] > usual[p.name])}"
        for p in floors
        if p.name in listed.values()
    )
    signals = ", ".join(sorted(listed))
    first = next(iter(listed.values()), "")
    line = (
        f"Smoothed signals ({signals}): the log does not show their noise, so that its estimate is at least that of a "
        f"usual sensor ({bounds}); --fix {first}=VALUE sets a noise that you know."
    )
    return model.replace_parameters(*floors), [line] if bounds else []


def _rounding_error(channels: Mapping[str, Channel], name: str) -> float:
    """Return the standard deviation of the rounding error of the signal ``name``, in the unit of the signal.

    ``channels`` are the signals of a log by name. The result is zero if the signal is not rounded or not in the log.
    The error is uniform over one rounding step (Bennett 1948), so that it is the step / sqrt(12). A receiver that
    reports speed and course rounds the speed. If ``vx`` or ``vy`` has no steps of its own, the steps of the magnitude
    of the velocity are therefore used, provided that both have the same sample times.
    """
    if name not in channels:
        return 0.0
    step = rounding_step(channels[name].value)
    if name in ("vx", "vy") and {"vx", "vy"} <= channels.keys():
        north, east = channels["vx"], channels["vy"]
        if not step and np.array_equal(north.t, east.t):
            step = rounding_step(np.hypot(north.value, east.value))
    return step / math.sqrt(12.0)
