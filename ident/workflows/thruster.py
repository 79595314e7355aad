"""Workflow of `seatrial ident thruster`: from bench logs to a thruster model, or to a static thrust curve.

Logs with shaft speeds give a model of shaft dynamics and thrust. Logs with only force and command give a static thrust
curve: a table of steady force against command.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import msgspec
import numpy as np

from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.files import write_output
from seatrial.ident.characterisation import (
    EXPO_BOUNDS,
    REVERSED_LOAD_CELL,
    THRUSTER_RATE,
    Curve,
    Levels,
    Quadratic,
    SteadyRow,
    ThrustCurve,
    TurningShaft,
    adequate,
    check_signs,
    clearly_falls,
    curve_left_out,
    directions,
    find_levels,
    fit_curve,
    fit_quadratic,
    fit_with_delay_on_grid,
    hold_advice,
    largest_speeds,
    measured_response,
    newtons_per_watt,
    save_curve,
    shaft_guess,
    speed_over_ground,
    steady_rows,
    steady_thrust,
    thrust_expo,
    thruster_channels,
    thruster_name,
    turning_inside_dead_zone,
    zero_drift,
)
from seatrial.ident.checks import device_faults
from seatrial.ident.data import (
    TIMES,
    WHOLE,
    Channel,
    LoadedLog,
    Record,
    TimeWindows,
    build_record,
    load_runs,
    within_window,
)
from seatrial.ident.estimation import EstimationOptions, Fit, FittedModel, RecordEvaluation, fix_parameters, profile
from seatrial.ident.model import Model, command_of, commanded_thrusters, shaft_speed_of
from seatrial.ident.models import TURNS_INSIDE, thruster_model
from seatrial.ident.numerics import Array
from seatrial.ident.report import GRAMS_PER_NEWTON, write_report
from seatrial.ident.reporter import Reporter
from seatrial.ident.results import (
    BenchTables,
    FitContext,
    ShaftResponse,
    StaticForce,
    SteadyBench,
    ThrustCurveResult,
    ThrusterResult,
    check_warnings,
    curve_notes,
    curve_warnings,
    faults_first,
    moving_boat_warnings,
    plus_minus,
    provenance,
    thruster_result,
    write_result,
)
from seatrial.ident.validation import evaluate
from seatrial.ident.workflows.check import with_findings
from seatrial.ident.workflows.electrical import electrical_channels
from seatrial.ident.workflows.model_inputs import check_horizon, check_names
from seatrial.ident.workflows.output import write_model, write_page

BODE_HZ = (0.02, 10.0)  # range of the frequency response of the shaft
BODE_POINTS = 200
SPEED_STEP = 0.005  # of full speed; a shaft speed so little beyond the measured ones is not called extrapolated
LOOKUP_ROWS = 101  # of lookup.csv


@dataclass(frozen=True)
class ThrusterRequest:
    """Options of `seatrial ident thruster`.

    Attributes
    ----------
    logs
        Bench logs of one thruster.
    out
        Folder for the results.
    name
        Name of the thruster in the rig, if the logs have several; None: the only one.
    estimation
        Options of the estimator.
    settle
        Time after each change of command that is left out from means of the force [s]: from the levels of a static
        curve, and from rests, which give the zero of the load cell.
    profiles
        Names of the parameters for the profile likelihood.
    despite_faults
        Whether to fit even if the checks find faults that make a fit meaningless.
    window
        Interval of time of the logs to fit: one for all, or one for each.
    fixed
        Values to which parameters are fixed, by name and in the parameters' units.
    """

    logs: Sequence[Path]
    out: Path
    name: str | None = None
    estimation: EstimationOptions = field(default_factory=lambda: EstimationOptions(reml=True))
    settle: float = 1.5
    profiles: Sequence[str] = ()
    despite_faults: bool = False
    window: TimeWindows = WHOLE
    fixed: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ThrusterFit:
    """Model of a thruster that was fitted to bench logs.

    Attributes
    ----------
    fitted
        The model with its records and their filter runs.
    result
        Content of result.json.
    calibration
        Largest relative standard uncertainty of the load cells' calibrations; None if unknown.
    """

    fitted: FittedModel
    result: ThrusterResult
    calibration: float | None

    def write(self, out: Path) -> None:
        """Write model.toml, result.json, report.html and the files of `write_tables` to the folder ``out``."""
        commands = np.concatenate([view.record.u[:, 0] for view in self.fitted.estimation])
        ranges = {"n_cmd": (float(commands.min()), float(commands.max()))}
        write_model(out, self.result, self.fitted.fit, ranges, calibration=self.calibration)
        write_page(out, self.result)
        write_tables(out, self.result)


@dataclass(frozen=True)
class CurveFit:
    """Static thrust curve that was fitted to a bench log without shaft speed.

    Attributes
    ----------
    measured
        The monotone curve, with the number of thrusters and the uncertainty of the load cell's calibration.
    levels
        Measured steady levels.
    quadratic
        Quadratic that was fitted to them.
    result
        Content of result.json.
    """

    measured: ThrustCurve
    levels: Levels
    quadratic: Quadratic
    result: ThrustCurveResult

    def write(self, out: Path) -> None:
        """Write model.toml, result.json and report.html to the folder ``out``, which is created if it is missing."""
        out.mkdir(parents=True, exist_ok=True)
        logs = [f"{x.path} sha256:{x.sha256[:16]}" for x in self.result.logs]
        made = {
            "made_by": self.result.command,
            "created": self.result.created,
            "seatrial": self.result.seatrial,
            "logs": logs,
        }
        save_curve(out / "model.toml", self.measured, self.levels, self.quadratic, made)
        write_result(self.result, out / "result.json")
        write_report(self.result, out / "report.html")


def characterise(request: ThrusterRequest, command: str, reporter: Reporter) -> ThrusterResult | ThrustCurveResult:
    """Fit the thruster model or a static curve (`fit_thruster`), write its files to ``request.out``, return its result.

    The files are model.toml, result.json and report.html, and for a thruster model those of `write_tables`.
    """
    found = fit_thruster(request, command, reporter)
    found.write(request.out)
    return found.result


def fit_thruster(request: ThrusterRequest, command: str, reporter: Reporter) -> ThrusterFit | CurveFit:
    """Fit the thruster model to bench logs of one thruster, or a static thrust curve if they have no shaft speed.

    The model has a thrust only if all logs have a measured force. No file is written.

    Parameters
    ----------
    request : ThrusterRequest
        Logs and options, of which the folder is not used.
    command : str
        Command line, for the provenance.
    reporter : Reporter
        Receives progress.

    Raises
    ------
    SeatrialError
        If the logs lack signals, if they have faults that make a fit meaningless (unless ``despite_faults``), if an
        option does not apply to them, or if the model lacks a fixed parameter or cannot have its value.
    """
    name, profiles = request.name, request.profiles
    loaded = load_runs(request.logs, "estimation", request.window, device_faults=device_faults)
    loaded = [_within_its_window(log) for log in loaded]
    loaded = [with_findings(log, {}, request.despite_faults) for log in loaded]  # no sides: a bench does not turn
    options, horizon = request.estimation, request.estimation.horizon
    if is_static(loaded, name):
        asked = {
            "--robust": options.outlier_model,
            "--profile": profiles,
            "--horizon": horizon is not None,
            "--fix": request.fixed,
        }
        _refuse_options(request.logs[0], [option for option, is_given in asked.items() if is_given])
        return static_curve(loaded, request, command, reporter)
    check_horizon(horizon, loaded)
    name = name or thruster_name(loaded[0])
    for x in loaded:
        check_signs(x, name)
    loaded, drifts = _without_zero_drift(loaded, command_of(name), request.settle)
    without_force = [str(x.about["path"]) for x in loaded if "force" not in x.run.channels]
    has_force = not without_force
    notes = list(drifts)
    if 0 < len(without_force) < len(loaded):
        notes.append(
            f"No thrust is fitted, because {', '.join(without_force)} has no signal 'force' of a load cell: leave this "
            "log out to fit the thrust."
        )
    model = thruster_model(force=has_force)
    check_names(model, profiles, len(loaded))
    records = [_thruster_record(model, x, name) for x in loaded]
    if request.fixed.get("tau", shaft_guess(records)[0]) > model.parameter("tau").bounds[1]:
        model = thruster_model("slow", force=has_force)
        records = [_thruster_record(model, x, name) for x in loaded]
    model, _ = fix_parameters(model, None, request.fixed)
    reporter.progress(f"fitting the thruster to {counted(len(records), 'run')}, {sum(r.n_rows for r in records)} rows")
    fit, records = fit_with_delay_on_grid(
        model, records, lambda m: [_thruster_record(m, x, name) for x in loaded], options
    )
    turning = _turning(fit, loaded, name)
    if any(turning.values()):
        fit = replace(fit, flags=(*fit.flags, ("d", TURNS_INSIDE)))
    views = tuple(RecordEvaluation(fit.model, r, v) for r, v in zip(records, fit.record_values, strict=True))
    fitted = FittedModel(fit.model, fit, views, ())
    evaluation = evaluate(fitted, horizon)
    if profiles:
        reporter.progress(f"profile likelihood of {', '.join(profiles)}")
    calibration = _calibration(loaded)
    steady = _steady_table(fit, records, loaded, request.logs, name)
    result = thruster_result(
        fitted,
        evaluation,
        provenance(loaded, command),
        [profile(fit, records, p) for p in profiles],
        BenchTables(
            _static_force(fit, records, steady) if has_force else None,
            steady,
            _shaft_response(fit, loaded, name),
            _speeds(loaded),
            turning,
        ),
        FitContext(model.values, [*notes, *fitted.outlier_notes]),
        calibration,
    )
    return ThrusterFit(fitted, result, calibration)


def _within_its_window(log: LoadedLog) -> LoadedLog:
    """Return a bench log without the signals before and after its interval of time, which `load_runs` reads too."""
    run = log.run
    begin, end = -np.inf if run.t_from is None else run.t_from, np.inf if run.t_to is None else run.t_to
    if not np.isfinite([begin, end]).any():
        return log
    return replace(log, run=replace(run, channels=within_window(run.channels, begin, end)))


def write_tables(out: Path, result: ThrusterResult) -> None:
    """Write the tables of a thruster for other programs: steady.csv, and with a force lookup.csv and ardupilot.param.

    steady.csv has a row for each steady command, with empty cells for what was not measured. Its force is the measured
    mean less the fitted offset of the load cell, which has a column of its own. lookup.csv has the command
    and the shaft speed for evenly spaced forces, by the fitted curve, and 1 as ``extrapolated`` where no such speed was
    measured; inside the dead zone the command is zero. Both have the shaft speed in rev/min if the logs show which
    speed is full.
    ardupilot.param has MOT_THST_EXPO of the steady forward commands; it is not written if this number is unknown.
    Existing files are replaced.

    Parameters
    ----------
    out : Path
        Folder, which exists.
    result : ThrusterResult
        The result. Without a steady-state table nothing is written.
    """
    table = result.steady
    if table is None:
        return
    per_watt = newtons_per_watt(table.n, table.force, table.power)
    columns = {
        "command": table.command,
        "n": table.n,
        **_in_rpm(table.n, table.rpm_max),
        "force_N": table.force,
        "force_se_N": table.force_se,
        **({} if table.offset is None else {"subtracted_offset_N": table.offset}),
        "voltage_V": table.voltage,
        "current_A": table.current,
        "power_W": table.power,
        "efficiency_N_per_W": per_watt,
        "efficiency_g_per_W": per_watt * GRAMS_PER_NEWTON,
        "torque_Nm": table.torque,
    }
    write_output(out / "steady.csv", _as_csv(columns))
    if result.static is None:
        return
    write_output(out / "lookup.csv", _as_csv(_lookup(result, table.rpm_max)))
    if table.expo is not None:
        write_output(out / "ardupilot.param", _ardupilot_parameters(result, table, table.expo))


def _ardupilot_parameters(result: ThrusterResult, table: SteadyBench, expo: float) -> str:
    """Return the text of ardupilot.param: MOT_THST_EXPO = ``expo``, with what it holds for and when to set it.

    ``table``: steady-state table of ``result``, to whose forward commands the exponent was fitted.
    """
    used = table.command[(table.command > 0.0) & np.isfinite(table.force)]
    dead = next((p.value for p in result.fit.parameters if p.name == "d"), 0.0)
    lines = [
        "# Thrust curve of the bench logs by seatrial: thrust = (1 - expo) throttle + expo throttle^2",
        "# of the forward commands; both are parts of their largest values. Copter, Sub and Rover read it.",
        "# Set it for operation. SET IT TO 0 AGAIN BEFORE SEATRIAL DRIVES THE THRUSTERS: it refuses other values.",
        f"# It was fitted to {used.size} steady commands, n = {used.min():.3g} to {used.max():.3g} of full command.",
    ]
    if round(abs(expo), 3) >= EXPO_BOUNDS[1]:
        lines.append(
            f"# It is at its limit ({expo:.3f}), so that the measured curve may be bent more than this formula can be."
        )
    if dead > 0.0:
        lines.append(
            f"# The dead zone, {100 * dead:.1f} % of full command, is not in it; MOT_THR_MIN is the parameter for it."
        )
    return "\n".join([*lines, f"MOT_THST_EXPO,{expo:.3f}"]) + "\n"


def _in_rpm(n: Array, full: float | None) -> dict[str, Array]:
    """Return the column ``rpm`` of relative shaft speeds; without the full shaft speed [rev/min], no column."""
    return {} if full is None else {"rpm": n * full}


def _lookup(result: ThrusterResult, full: float | None) -> dict[str, Array]:
    """Return command and shaft speed for zero force and evenly spaced forces [N] over the range of the fitted curve.

    ``full``: full shaft speed [rev/min]; None: unknown, and the column ``rpm`` is left out. Where the fitted curve is
    not monotone, the running maximum of the force counts. A command inside the dead zone has no thrust and is zero.
    Column ``extrapolated`` is 1 for a shaft speed beyond those that were measured, and 0 elsewhere.
    """
    assert result.static is not None
    n, force = result.static.n_model, np.maximum.accumulate(result.static.force_model)
    asked = np.union1d(np.linspace(force[0], force[-1], LOOKUP_ROWS), [0.0])
    keep = np.concatenate([[True], np.diff(force) > 0.0])
    command = np.interp(asked, force[keep], n[keep])
    dead = next((p.value for p in result.fit.parameters if p.name == "d"), 0.0)
    command = np.where((np.abs(command) < dead) | (asked == 0.0), 0.0, command)
    measured = [trace.measured for trace in result.traces if trace.channel == "n"]
    reach = largest_speeds(np.concatenate([np.empty(0), *measured]))
    beyond = (command > reach[1.0] + SPEED_STEP) | (command < -reach[-1.0] - SPEED_STEP)
    columns = {"force_N": asked, "command": command, **_in_rpm(command, full)}
    return {**columns, "extrapolated": beyond.astype(float)}


def _as_csv(columns: Mapping[str, Array]) -> str:
    """Return columns of equal length as CSV with a header. A value that is not finite is an empty cell."""
    lines = [",".join(columns)]
    for row in zip(*columns.values(), strict=True):
        lines.append(",".join(f"{v:.6g}" if np.isfinite(v) else "" for v in row))
    return "\n".join(lines) + "\n"


def _steady_table(
    fitted: Fit, records: Sequence[Record], loaded: Sequence[LoadedLog], logs: Sequence[Path], name: str
) -> SteadyBench | None:
    """Return the steady-state table of bench logs, with electrical power and torque where they were measured.

    ``fitted``: fit of the thruster model to ``records``, which belong to the logs ``loaded`` and the files ``logs``.
    ``name``: name of the thruster. The fitted offset of the load cell is subtracted from the forces. Return None if no
    command was held.
    """
    has_force = "bias" in fitted.model.values
    rows, names, offsets, formula = list[SteadyRow](), list[str](), list[float](), ""
    for i, (x, record) in enumerate(zip(loaded, records, strict=True)):
        files = [path for path in logs if path.name == TIMES.sub("", x.about["path"])]  # two may have the same name
        electrical, words = electrical_channels(files[0], x, name) if len(files) == 1 else ({}, "")
        formula = formula or words
        bias = fitted.estimate("bias", i)[0] if has_force else 0.0
        channels = {**x.run.channels, **electrical}
        found = steady_rows(channels, command_of(name), shaft_speed_of(name), bias)
        rows += found
        names += [record.name] * len(found)
        offsets += [bias] * len(found)
    if not rows:
        return None
    columns = {key: np.array([getattr(row, key) for row in rows]) for key in SteadyRow.__dataclass_fields__}
    full = {x.rpm_max.get(shaft_speed_of(name)) for x in loaded}
    expo = thrust_expo(columns["command"], columns["force"])
    return SteadyBench(
        log=tuple(names),
        power_formula=formula,
        rpm_max=full.pop() if len(full) == 1 else None,  # logs with different full speeds have no common one
        expo=expo if np.isfinite(expo) else None,
        offset=np.array(offsets) if has_force else None,
        **columns,
    )


def _shaft_response(fitted: Fit, loaded: Sequence[LoadedLog], name: str) -> ShaftResponse:
    """Return the frequency response of the shaft by the model, ``a exp(-j w tau) / (j w + a)``, and as measured.

    The measured response is that of the longest of the logs ``loaded``. ``name``: name of the thruster.
    """
    f = np.geomspace(*BODE_HZ, BODE_POINTS)
    w, (a, _), (tau, _) = 2.0 * np.pi * f, fitted.estimate("a"), fitted.estimate("tau")
    longest = max(loaded, key=lambda x: float(x.about["duration"])).run.channels
    at, gain, phase = measured_response(longest[command_of(name)], longest[shaft_speed_of(name)], THRUSTER_RATE)
    return ShaftResponse(
        frequency=f,
        gain=a / np.hypot(a, w),
        phase=-np.arctan2(w, a) - w * tau,
        frequency_measured=at,
        gain_measured=gain,
        phase_measured=phase,
    )


def _speeds(loaded: Sequence[LoadedLog]) -> dict[str, float | None]:
    """Return the speed over ground [m/s] that the boat exceeded for a tenth of each log, by name; None: unknown."""
    return {x.about["path"]: speed_over_ground(x.run.channels) for x in loaded}


def _turning(fitted: Fit, loaded: Sequence[LoadedLog], name: str) -> dict[str, TurningShaft | None]:
    """Return the held command inside the fitted dead zone at which the shaft turned fastest, for each log by name.

    The value is None if the shaft did not turn there. ``name``: name of the thruster.
    """
    d, tau, a = (fitted.estimate(parameter)[0] for parameter in ("d", "tau", "a"))
    command, shaft = command_of(name), shaft_speed_of(name)
    return {
        x.about["path"]: turning_inside_dead_zone(x.run.channels[command], x.run.channels[shaft], d, tau, 1.0 / a)
        for x in loaded
    }


def _without_zero_drift(loaded: Sequence[LoadedLog], command: str, settle: float) -> tuple[list[LoadedLog], list[str]]:
    """Subtract the drift of the load cell's zero from the force of each bench log.

    The zero is the mean force at rests, times of zero command. The drift is linear between the rests; the mean of the
    zeros stays in the force. Return the new logs, and a line of text for each drift. ``command``: name of the command
    signal. ``settle``: time [s] at the beginning of a rest that is left out. A log without force or command, or without
    a significant drift, is unchanged.
    """
    found, lines = [], []
    for x in loaded:
        channels = x.run.channels
        given, force = channels.get(command), channels.get("force")
        drift = zero_drift(given, force, settle) if given is not None and force is not None else None
        if drift is not None and force is not None:
            x = replace(x, run=replace(x.run, channels={**channels, "force": drift.without_drift(force)}))
            lines.append(drift.text if len(loaded) == 1 else f"{x.about['path']}: {drift.text}")
        found.append(x)
    return found, lines


def _calibration(loaded: Sequence[LoadedLog]) -> float | None:
    """Return the largest relative standard uncertainty of the load cells' calibrations in the rigs of the bench logs.

    None if no rig gives an uncertainty.
    """
    cells = [d.calibration for x in loaded if x.rig for d in x.rig.devices if d.calibration is not None]
    found = [sd for sd in (c.relative_sd for c in cells) if sd is not None]
    return max(found) if found else None


def _refuse_options(path: Path, options: Sequence[str]) -> None:
    """Raise SeatrialError if ``options`` is not empty: options of the command that do not apply to a static curve.

    ``options``: names of those of these options that the user gave. ``path``: file of the log, for the message.
    """
    if options:
        raise SeatrialError(
            f"{path}: has no shaft speed, so only a static curve can be fitted, which does not use "
            f"{' and '.join(options)}; leave out these options"
        )


def _thruster_record(model: Model, loaded: LoadedLog, name: str) -> Record:
    """Return the record of one bench log for the fit of a thruster model, with rows at 50 Hz.

    ``name``: name of the thruster. Raise SeatrialError if the log lacks its command or its shaft speed.
    """
    channels = thruster_channels(loaded, model, name)
    return build_record(model, channels, name=loaded.run.name, rate=THRUSTER_RATE)


def _static_force(fitted: Fit, records: Sequence[Record], steady: SteadyBench | None) -> StaticForce:
    """Return the measured steady thrust, and that of the fitted model with its standard error, for the result.

    ``fitted``: fit of the thruster model to ``records``. ``steady``: steady-state table of their logs. The model's
    thrust is given at 81 shaft speeds, from 0 to full speed in each direction in which the shaft turned.
    """
    n, force, sd = (np.empty(0),) * 3 if steady is None else (steady.n, steady.force, steady.force_se)
    good = np.isfinite(force)
    n, force, sd = n[good], force[good], sd[good]
    ends = (0.0, *directions(records))
    grid = np.linspace(min(ends), max(ends), 81)
    force_model, force_sd = steady_thrust(fitted, grid)
    return StaticForce(n=n, force=force, sd=sd, n_model=grid, force_model=force_model, force_sd=force_sd)


def static_curve(loaded: Sequence[LoadedLog], request: ThrusterRequest, command: str, reporter: Reporter) -> CurveFit:
    """Fit a static thrust curve to one bench log with force and command.

    The curve goes through steady levels: means of the force over the times in which the command is constant.

    Parameters
    ----------
    loaded : sequence of LoadedLog
        The log, as the only element.
    request : ThrusterRequest
        Options, of which the name of the thruster and the time to settle are used.
    command : str
        Command line, for the provenance.
    reporter : Reporter
        Receives progress.

    Raises
    ------
    SeatrialError
        If there are several logs, or if the log has no force, no changing command, several commands that differ, fewer
        than four steady levels, or a reversed load cell.
    """
    if len(loaded) != 1:
        raise SeatrialError(f"{loaded[1].about['path']}: a static curve is fitted to one log only; give one log")
    log = loaded[0]
    channels, where = log.run.channels, log.about["path"]
    names = _changing_commands(log, request.name)
    if "force" not in channels:
        raise SeatrialError(
            f"{where}: no signal 'force' of a load cell, which a static curve needs; the log has "
            f"{', '.join(sorted(channels))}; record the load cell, or import it by the name force"
        )
    (log,), drifts = _without_zero_drift([log], names[0], request.settle)
    channels = log.run.channels
    reporter.progress(f"steady force against {' and '.join(names)}")
    try:
        levels = find_levels(channels[names[0]], channels["force"], request.settle)
        if levels.n.size < 4:
            advice = hold_advice(channels[names[0]], channels["force"], request.settle)
            raise ValueError(f"{levels.n.size} steady commands are too few for a curve, which needs four; {advice}")
        if clearly_falls(levels.n, levels.force, float(levels.error.max())):
            raise ValueError(REVERSED_LOAD_CELL)
    except ValueError as problem:
        raise SeatrialError(f"{where}: {problem}") from None
    curve, quadratic = fit_curve(levels), fit_quadratic(levels)
    measured = ThrustCurve(curve, len(names), _calibration(loaded))
    origin = provenance(loaded, command)
    result = ThrustCurveResult(
        **msgspec.structs.asdict(origin),
        answer=faults_first(origin) + curve_answer(levels, measured, quadratic),
        warnings=(*check_warnings(origin), *moving_boat_warnings(_speeds(loaded), True), *curve_warnings(levels)),
        static=_curve_points(levels, curve, quadratic),
        notes=(*drifts, *curve_notes(levels, measured, quadratic)),
    )
    return CurveFit(measured, levels, quadratic, result)


def is_static(loaded: Sequence[LoadedLog], name: str | None) -> bool:
    """Return whether only a static curve can be fitted: the logs have force and commands, but no shaft speeds.

    Parameters
    ----------
    loaded : sequence of LoadedLog
        Bench logs, at least one. None of them may have both command and shaft speed of the thruster. The first one must
        have the force and a command, or a shaft speed in place of the command.
    name : str or None
        Name of the thruster; None: any thruster.
    """
    for log in loaded:
        names = [name] if name else commanded_thrusters(log.run.channels)
        if any({command_of(n), shaft_speed_of(n)} <= set(log.run.channels) for n in names):
            return False
    return "force" in loaded[0].run.channels and bool(_command_names(loaded[0].run.channels, name))


def _command_names(channels: Mapping[str, Channel], name: str | None) -> list[str]:
    """Return the names of the channels with the command of the thruster ``name``, or of all thrusters if it is None.

    The shaft speed of a thruster is used in place of a missing command. A thruster with neither is left out.
    """
    thrusters = [name] if name else ["left", "right", *commanded_thrusters(channels)]
    signals = [(command_of(thruster), shaft_speed_of(thruster)) for thruster in dict.fromkeys(thrusters)]
    found = [next((n for n in names if n in channels), "") for names in signals]
    return [n for n in found if n]


def _changing_commands(log: LoadedLog, name: str | None) -> list[str]:
    """Return the names of the command channels whose value changes in a bench log.

    ``name``: name of the thruster, or None for all thrusters. Raise SeatrialError if no command changes, or if the
    changing commands differ from each other: the user must then name the thruster whose force was measured.
    """
    channels = log.run.channels
    moved = [n for n in _command_names(channels, name) if np.ptp(channels[n].value) > 0]
    if not moved:
        raise SeatrialError(
            f"{log.about['path']}: no command changes, so there is no thrust curve to fit; the log has "
            f"{', '.join(sorted(channels))}; give a log of steps (seatrial bench steps)"
        )
    first = channels[moved[0]]
    for second in moved[1:]:
        c = channels[second]
        if c.t.size != first.t.size or not np.allclose(c.value, first.value):
            raise SeatrialError(
                f"{log.about['path']}: the commands {moved[0]} and {second} differ; name the thruster whose force was "
                "measured with --thruster"
            )
    return moved


def _curve_points(levels: Levels, curve: Curve, quadratic: Quadratic) -> StaticForce:
    """Return the measured levels, the monotone curve and the quadratic as arrays for the plots of the result.

    Curve and quadratic are given at 161 evenly spaced commands and at those of the levels.
    """
    grid = np.union1d(np.linspace(curve.n[0], curve.n[-1], 161), curve.n)
    return StaticForce(
        n=levels.n,
        force=levels.force,
        sd=levels.error,
        n_model=grid,
        force_model=curve(grid),
        force_sd=curve.error(grid),
        force_quadratic=quadratic(grid),
        abscissa="command n",
    )


def _format_force(force: float) -> str:
    """Format a force [N] for the answer: one decimal, or two significant digits if it is below 1 N."""
    return f"{force:.1f} N" if abs(force) >= 1.0 else f"{force:.2g} N"


def curve_answer(levels: Levels, measured: ThrustCurve, quadratic: Quadratic) -> str:
    """Return the answer of a static curve: force at the largest commands, and misfit of the quadratic to the levels.

    A direction without a level is named as not measured. If the quadratic does not describe the levels within their
    errors, the answer advises the monotone curve and compares both by levels that were left out.

    Parameters
    ----------
    levels : Levels
        Measured steady levels (mean force for each command).
    measured : ThrustCurve
        Monotone curve, number of thrusters, and uncertainty of the load cell's calibration.
    quadratic : Quadratic
        Quadratic ``c1 n|n| + c2 n^2`` fitted to the levels, with its misfit.
    """
    curve, thrusters, calibration = measured.curve, measured.thrusters, measured.calibration
    words = {1: "The thruster gives", 2: "Both thrusters together give"}
    error = np.hypot(curve.se, (calibration or 0.0) * curve.force)
    ends, lost = [], ""
    for k, direction, word in ((-1, 1.0, "forward"), (0, -1.0, "in reverse")):
        if direction * curve.n[k] > 0.0:
            ends.append(f"{plus_minus(direction * float(curve.force[k]), float(error[k]))} N {word}")
        else:
            lost = f"; {word}: not measured"
    thrust = (
        f"{words.get(thrusters, f'The {thrusters} thrusters together give')} {' and '.join(ends)} at the largest "
        f"commands ({'errors: statistical only' if calibration is None else 'errors include the calibration'}{lost}), "
        f"{levels.n.size} steady levels in all."
    )
    if adequate(quadratic):
        return (
            f"{thrust} {quadratic.formula} describes them within their errors (c1 {quadratic.c1:.4g} N, "
            f"misfit {quadratic.rms:.2g} N rms)."
        )
    largest = f"{'+' * (quadratic.largest > 0.0)}{_format_force(quadratic.largest)}"
    return (
        f"{thrust} {quadratic.formula} does not describe them: its misfit is {_format_force(quadratic.rms)} (rms); the "
        f"largest is {largest} at n = {quadratic.at:g}. Use the monotone curve (--thruster). In leave-one-out "
        f"validation, the error of the quadratic is {_format_force(quadratic.left_out)}, that of the monotone curve "
        f"{_format_force(curve_left_out(levels))}."
    )
