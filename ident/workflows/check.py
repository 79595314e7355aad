"""Checks of logs: the page of a finished check, and the checks before a fit, which refuse what would mean nothing."""

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
    log_evidence,
    smoothed,
    spoils_a_fit,
)
from seatrial.ident.data import Channel, LoadedLog
from seatrial.ident.model import INF, Model
from seatrial.ident.models import ESTIMATOR_ERROR, LASTING, NOISE, estimator_error, navigation_errors
from seatrial.ident.numerics import rounding_step
from seatrial.ident.report import write_check_page

LEAST_WHITE = 0.02  # least white noise of an estimator's output, relative to a usual sensor's
BEGIN = 1.5  # where the search for a noise with a floor begins, times the floor


def write_check(report: CheckReport, command: str, out: Path) -> None:
    """Write the page of a check. Raises SeatrialError where a log of it cannot be read, OSError where ``out`` cannot be
    written."""
    name = report.subject if report.rig is not None and len(report.logs) == 1 else ""
    write_check_page(report, [part for path in report.logs for part in log_evidence(path, name)], command, out)


def check_first(
    loaded: Sequence[LoadedLog], unseen: Sequence[LoadedLog], model: Model, despite_faults: bool
) -> tuple[list[LoadedLog], list[LoadedLog]]:
    """The logs of a fit and those that judge it, with what the checks find in each (``about["findings"]``).

    The thrusters' sides are those of the model's levers, else of the rig. Raises SeatrialError at the first fault that
    makes a fit meaningless (frames, signs, units, sides, time, frozen signals), unless ``despite_faults``.
    """
    logs = [*loaded, *unseen]
    copies = check_copies([(x.about["path"], x.run.channels) for x in logs])
    checked = []
    for log in logs:
        its_copies = [f for f in copies if f.where == log.about["path"]]
        checked.append(with_findings(log, sides_of_model(model, log), despite_faults, its_copies))
    return checked[: len(loaded)], checked[len(loaded) :]


def with_findings(
    log: LoadedLog, sides: Mapping[str, float], despite_faults: bool, more: Sequence[Finding] = ()
) -> LoadedLog:
    """Return the log with what the checks find in it (``about["findings"]``).

    Parameters:
        log: loaded with ``device_faults``.
        sides: thruster -> position to starboard [m].
        despite_faults: whether a fault that makes a fit meaningless is accepted.
        more: findings from other checks.

    Raises:
        SeatrialError: the log has such a fault, and it is not accepted.
    """
    name = log.about["path"]
    assert log.device_faults is not None, "logs of a fit are loaded with `device_faults`"
    found = [*log.device_faults, *check_signals(log.own_channels, sides), *more]
    told = [f for f in found if f.level != OK]
    refused = [f for f in told if spoils_a_fit(f)]
    if refused and not despite_faults:
        first, where = refused[0], "" if refused[0].where == name else f"{refused[0].where}: "
        rest = f" ({counted(len(refused) - 1, 'more fault')})" if len(refused) > 1 else ""
        raise SeatrialError(
            f"{name}: {where}{first.text} [{first.code}]{rest}; "
            f"{first.advice}. `seatrial check` says all; --despite-faults fits it as it is"
        )
    rows = [f._asdict() | {"spoils": spoils_a_fit(f)} for f in told]
    return replace(log, about=log.about | {"findings": rows})


def sides_of_model(model: Model, log: LoadedLog) -> Mapping[str, float]:
    """Thruster -> position to starboard [m]: the model's levers, else the rig's, else what the names say."""
    levers = {side: model.values[f"y_{side}"] for side in ("left", "right") if f"y_{side}" in model.values}
    if levers:
        return levers
    return {t.name: t.position_m[1] for t in log.rig.thrusters} if log.rig else IMPORTED


def with_estimator_errors(
    model: Model, logs: Sequence[LoadedLog], given: Collection[str] = ()
) -> tuple[Model, list[str]]:
    """The model with errors of inertial navigation where the position is an estimator's, and a line that says so.

    given: parameters of which the user said something; who says what the noise of the position is, takes it for white.
    """
    position = next((o.noise for o in model.outputs if o.name == "x" and o.noise), None)
    there = ESTIMATOR_ERROR in {e.name for e in model.effects}
    if position is None or there or "heading" not in model.provides or position in given:
        return model, []
    if not any(estimated(log.run.channels) for log in logs):
        return model, []
    sensors = [s.name for s in model.sensors]
    line = (
        f"Position by an estimator (its noise is less than a receiver's): errors of its "
        f"{', '.join(e.of for e in navigation_errors(sensors))} that last are states; "
        f"--fix {position}=... gives white noise instead."
    )
    return model + estimator_error(sensors), [line]


def with_noise_floors(model: Model, logs: Sequence[LoadedLog]) -> tuple[Model, list[str]]:
    """The model with a floor under the noise of smoothed channels, and a line that names them.

    A filter's output has errors that last and no noise from sample to sample: a fit that takes it for white estimates
    next to none, and follows it everywhere. The floor is a usual sensor's noise (``seatrial.ident.models.NOISE``); a
    small part of it, and not worth a line, where errors that last are states. Nowhere is it less than what rounding
    does: of a signal in whole centimetres less is estimated, since from sample to sample rounding may change little,
    and forces follow its steps.
    """
    usual, states = {p.name: p.value for p in NOISE.values()}, ESTIMATOR_ERROR in {e.name for e in model.effects}
    lasting = {o.name for s in model.sensors if states and s.name in LASTING for o in s.outputs}
    smooth = {name for log in logs for name in smoothed(log.run.channels)} - lasting
    part = dict.fromkeys(smooth, 1.0) | dict.fromkeys(lasting, LEAST_WHITE)
    least: dict[str, float] = {}
    for o in model.outputs:
        if o.name in part and o.noise in usual:
            rounded = max((_rounding_error(log.run.channels, o.name) for log in logs), default=0.0)
            least[o.noise] = max(least.get(o.noise, 0.0), part[o.name] * usual[o.noise], rounded)
    floors = [replace(p, value=max(p.value, BEGIN * least[p.name]), bounds=(least[p.name], INF))
              for p in model.parameters if p.free and p.name in least]  # fmt: skip
    told = {o.noise for o in model.outputs if o.name in smooth}
    said = ", ".join(f"{p.name} {p.bounds[0]:g} {p.unit}" for p in floors if p.name in told)
    line = f"Smoothed signals ({', '.join(sorted(smooth))}): their noise is not estimated below {said}; --fix gives it."
    return model.replace_parameters(*floors), [line] if said else []


def _rounding_error(channels: Mapping[str, Channel], name: str) -> float:
    """Standard deviation of the error of a signal in whole steps, which is uniform (Bennett 1948); zero where it has
    none. A velocity may have them along its way, as of a receiver that tells speed and course."""
    if name not in channels:
        return 0.0
    step = rounding_step(channels[name].value)
    if name in ("vx", "vy") and {"vx", "vy"} <= channels.keys():
        north, east = channels["vx"], channels["vy"]
        if not step and np.array_equal(north.t, east.t):
            step = rounding_step(np.hypot(north.value, east.value))
    return step / math.sqrt(12.0)
