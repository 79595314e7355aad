"""Checks of logs: the page of `seatrial check`, and the checks before a fit.

The checks before a fit refuse logs whose faults would make its result meaningless. They also adapt the noise model to
signals that are filtered or rounded.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from seatrial.daq.checks import OK, CheckReport, Finding
from seatrial.daq.errors import SeatrialError, counted
from seatrial.ident.checks import (
    IMPORTED,
    check_copies,
    check_signals,
    estimated,
    invalidates_fit,
    log_evidence,
    smoothed,
)
from seatrial.ident.data import Channel, LoadedLog
from seatrial.ident.model import INF, Model
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
INITIAL_FACTOR = 1.5  # initial value of a noise with a floor, relative to the floor


def write_check(report: CheckReport, command: str, out: Path) -> None:
    """Write the HTML page of `seatrial check`, with the findings and the curves of its logs.

    Parameters
    ----------
    report
        Findings and logs of the check.
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
    write_check_page(report, [part for path in report.logs for part in log_evidence(path, name)], command, out)


def check_first(
    loaded: Sequence[LoadedLog], validation_logs: Sequence[LoadedLog], model: Model, despite_faults: bool
) -> tuple[list[LoadedLog], list[LoadedLog]]:
    """Check the estimation and validation logs of a command before its fit, also for copies of each other.

    Parameters
    ----------
    loaded, validation_logs : sequence of LoadedLog
        Logs that were loaded with ``device_faults``.
    model : Model
        Its arms ``y_left`` and ``y_right`` [m] give the sides of the thrusters; without arms the rig gives them.
    despite_faults : bool
        Whether faults that make a fit meaningless are accepted.

    Returns
    -------
    tuple of list of LoadedLog
        Estimation logs and validation logs, with the findings in ``about["findings"]``.

    Raises
    ------
    SeatrialError
        At the first fault that makes a fit meaningless (frames, signs, units, sides, time, frozen signals), unless
        ``despite_faults``.
    """
    logs = [*loaded, *validation_logs]
    copies = check_copies([(x.about["path"], x.run.channels) for x in logs])
    checked = []
    for log in logs:
        its_copies = [f for f in copies if f.where == log.about["path"]]
        checked.append(with_findings(log, sides_of_model(model, log), despite_faults, its_copies))
    return checked[: len(loaded)], checked[len(loaded) :]


def with_findings(
    log: LoadedLog, sides: Mapping[str, float], despite_faults: bool, more: Sequence[Finding] = ()
) -> LoadedLog:
    """Check a log before a fit, and return a copy with the findings in ``about["findings"]``.

    Parameters
    ----------
    log : LoadedLog
        Log that was loaded with ``device_faults``.
    sides : mapping of str to float
        Position of each thruster to starboard [m]; empty for a bench.
    despite_faults : bool
        Whether a fault that makes a fit meaningless is accepted.
    more : sequence of Finding
        Findings from other checks, which are added.

    Returns
    -------
    LoadedLog
        Its findings are all except those of the level ``ok``. Each has the key ``spoils``: whether it makes a fit
        meaningless.

    Raises
    ------
    SeatrialError
        If the log has such a fault, and it is not accepted.
    """
    name = log.about["path"]
    assert log.device_faults is not None, "logs of a fit are loaded with `device_faults`"
    found = [*log.device_faults, *check_signals(log.own_channels, sides), *more]
    reported = [f for f in found if f.level != OK]
    refused = [f for f in reported if invalidates_fit(f)]
    if refused and not despite_faults:
        first, where = refused[0], "" if refused[0].where == name else f"{refused[0].where}: "
        rest = f" ({counted(len(refused) - 1, 'more fault')})" if len(refused) > 1 else ""
        raise SeatrialError(
            f"{name}: {where}{first.text} [{first.code}]{rest}; "
            f"{first.advice}. `seatrial check` lists all findings; --despite-faults fits the log unchanged"
        )
    rows = [f._asdict() | {"spoils": invalidates_fit(f)} for f in reported]
    return replace(log, about=log.about | {"findings": rows})


def sides_of_model(model: Model, log: LoadedLog) -> Mapping[str, float]:
    """Return the position of each thruster to starboard [m], for the checks before a fit.

    The positions are those of the model's arms ``y_left`` and ``y_right``, else those of the rig, else -1 for ``left``
    and +1 for ``right``.

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
    """Add states for navigation errors if the position of a log is the output of a navigation filter.

    Parameters
    ----------
    model : Model
        Model of the boat.
    logs : sequence of LoadedLog
        Estimation logs. One with such a position is enough.
    user_given : collection of str
        Names of the parameters that the user fixed or gave a prior. If they include the noise of the position, this
        noise is taken as white and no states are added.

    Returns
    -------
    tuple of Model and list of str
        The model, and a line about the added states. The unchanged model and an empty list if none are added: also if
        the model has no position or heading, or has these states already.
    """
    position = next((o.noise for o in model.outputs if o.name == "x" and o.noise), None)
    there = ESTIMATOR_ERROR in {e.name for e in model.effects}
    if position is None or there or "heading" not in model.provides or position in user_given:
        return model, []
    if not any(estimated(log.run.channels) for log in logs):
        return model, []
    sensors = [s.name for s in model.sensors]
    line = (
        f"The position is the output of a navigation filter (its noise is less than a receiver's): correlated errors "
        f"of its {', '.join(e.of for e in navigation_errors(sensors))} are states of the model; "
        f"--fix {position}=... gives white noise instead."
    )
    return model + estimator_error(sensors), [line]


def with_noise_floors(model: Model, logs: Sequence[LoadedLog]) -> tuple[Model, list[str]]:
    """Set lower bounds for the free noise parameters of smoothed channels, and raise their values above the bounds.

    Parameters
    ----------
    model : Model
        Model of the boat.
    logs : sequence of LoadedLog
        Estimation logs. A channel is smoothed if it is so in any of them.

    Returns
    -------
    tuple of Model and list of str
        The model, and a line with the smoothed channels and their bounds; an empty list if there are none.

    Notes
    -----
    The output of a filter has correlated errors and almost no noise from sample to sample. A fit that takes the noise
    as white estimates it near zero, and the states then follow the filter. The bound is the noise of a usual sensor
    (``seatrial.ident.models.NOISE``). If correlated errors are states of the model, the bound is a small part of that
    noise, and no line is returned. The bound is never less than the rounding error of the signal: consecutive rounded
    samples may be equal, so the noise would be underestimated, and the forces would follow the rounding steps.
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
    listed = {o.noise for o in model.outputs if o.name in smooth}
    bounds = ", ".join(f"{p.name} {p.bounds[0]:g} {p.unit}" for p in floors if p.name in listed)
    signals = ", ".join(sorted(smooth))
    line = f"Smoothed signals ({signals}): lower bounds of their estimated noise are {bounds}; --fix sets the noise."
    return model.replace_parameters(*floors), [line] if bounds else []


def _rounding_error(channels: Mapping[str, Channel], name: str) -> float:
    """Return the standard deviation of the rounding error of a logged signal, for the lower bound of its noise.

    It is zero if the signal ``name`` is not rounded or not logged. The error is uniform over one step (Bennett 1948). A
    receiver that reports speed and course rounds the speed, so the steps of a velocity are looked for in its magnitude
    too.
    """
    if name not in channels:
        return 0.0
    step = rounding_step(channels[name].value)
    if name in ("vx", "vy") and {"vx", "vy"} <= channels.keys():
        north, east = channels["vx"], channels["vy"]
        if not step and np.array_equal(north.t, east.t):
            step = rounding_step(np.hypot(north.value, east.value))
    return step / math.sqrt(12.0)
