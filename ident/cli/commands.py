"""Commands of `seatrial ident`, and `seatrial mission design`, which is part of the command group of bench."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from seatrial.daq.console import make_console
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import LOG, window_option
from seatrial.daq.options import Choice, FiniteRange, json_option, output_option
from seatrial.ident.cli.options import (
    FILE,
    FOLDER,
    MODEL,
    MODEL_SOURCE,
    SOURCE_FILE,
    GatheringCommand,
    InputsFirst,
    InputsFirstGroup,
    LineReporter,
    LiveLine,
    SpacedLines,
    check_output,
    command_line,
    despite_option,
    fix_option,
    force_option,
    horizon_option,
    mass_option,
    mean_order_option,
    model_options,
    out_option,
    parse_names,
    parse_rates,
    parse_thruster_files,
    parse_values,
    print_result_json,
    rate_option,
    reml_option,
    resumed_out_option,
    robust_option,
    run_workflow,
    thrust_of_option,
    trust_option,
    validate_option,
    with_estimation_options,
    workers_options,
)
from seatrial.ident.export import FORMATS_OF_PROGRAMS


@click.group(cls=InputsFirstGroup)
def ident() -> None:
    """Identify models from logs, and find effects that they lack."""


@ident.command(short_help="Fit shaft dynamics and thrust curve to bench logs.")
@click.argument("logs", nargs=-1, required=True, type=LOG)
@click.option("--thruster", "name", help="Name of the thruster in the rig file, if the log has several.")
@click.option(
    "--settle",
    type=FiniteRange(0.0),
    default=1.5,
    show_default=True,
    help="Time left out after each change of command [s]: from the levels of a static curve, and from the rests that "
    "give the zero of the load cell.",
)
@click.option("--profile", "profiles", multiple=True, metavar="NAME", help="Profile likelihood of this parameter.")
@fix_option
@horizon_option
@robust_option
@reml_option()
@despite_option
@window_option
@out_option("thruster")
@json_option()
def thruster(logs: tuple[Path, ...], out: Path, as_json: bool, **how: Any) -> None:
    """Fit shaft dynamics and thrust curve to bench LOGS of one thruster.

    A log of force and command without shaft speed gives only the static thrust curve, as a table. The results are
    model.toml, result.json and report.html in the folder --out. With a shaft speed there are also steady.csv (steady
    states, with the electrical power if it was logged), and with a force lookup.csv (command for each force) and
    ardupilot.param (MOT_THST_EXPO).

    \b
    Example:
      seatrial ident thruster bench.mcap --out thruster
    """
    from seatrial.ident.workflows.thruster import ThrusterRequest, characterise

    request = ThrusterRequest(logs, out, **with_estimation_options(how))
    run_workflow(lambda reporter: characterise(request, command_line(), reporter), out, as_json)


def _parse_intervals(
    _context: click.Context, _parameter: click.Parameter, texts: Sequence[str]
) -> list[tuple[float, float]]:
    """Parse the repeated values ``T0:T1`` [s of the log] of ``--gnss-outage`` to (start, end) each (click callback).

    Raise click.BadParameter for a text of another form (`_parse_interval`).
    """
    return [_parse_interval(text) for text in texts]


@ident.command(short_help="Evaluate a fitted model on unseen logs, or compare several.")
@click.argument("models", nargs=-1, required=True, type=MODEL)
@click.option("--on", "logs", multiple=True, required=True, type=LOG, help="Log to predict; may be repeated.")
@click.option(
    "--horizon",
    "horizons",
    multiple=True,
    type=FiniteRange(0.02, 3600.0),
    metavar="SECONDS",
    help="Prediction horizon, beside one step ahead and simulation; may be repeated.  [default: that of the first "
    "model: 10, on the bench 1]",
)
@click.option(
    "--rate", type=FiniteRange(0.0, min_open=True), help="Rate of the rows [Hz].  [default: 10, on the bench 50]"
)
@click.option("--thruster", help="The static curve that the models were fitted with, or the name of the thruster.")
@despite_option
@window_option
@partial(workers_options, jobs=None)
@trust_option
@output_option(
    FOLDER, "Folder for result.json and report.html; without it, the result is only printed.", callback=check_output
)
@force_option
@json_option()
def compare(models: tuple[Path, ...], logs: tuple[Path, ...], out: Path | None, as_json: bool, **how: Any) -> None:
    """Evaluate a fitted model on logs that it has not seen, or compare several MODELS with the first one.

    Each model predicts one step ahead, over each horizon, and in simulation from the inputs alone. For each channel the
    result has the error and the fit of each model, and the share of the errors inside its 95 % intervals, which
    validation data of the fit have widened. Several models are compared, with a verdict by a 95 % interval. Give logs
    that no model was fitted to.

    \b
    Example:
      seatrial ident compare vehicle --on run4.mcap
      seatrial ident compare vehicle/model.toml diagnosis/model.toml --on run4.mcap --out comparison
      seatrial ident compare vehicle diagnosis --on run4.mcap --horizon 2 --horizon 10
    """
    from seatrial.ident.report import print_result
    from seatrial.ident.workflows.compare import CompareRequest, compare_models

    request = CompareRequest(models, logs, out=out, **how)
    try:
        result = compare_models(request, command_line(), LineReporter(err=True))
    except (ValueError, KeyError) as problem:
        raise SeatrialError(str(problem).strip("'\"")) from problem
    if as_json:
        print_result_json(result)
    else:
        print_result(result, make_console())
    if out is not None:
        click.echo(f"report: {out / 'report.html'}", err=as_json)


@click.command(cls=InputsFirst, short_help="Estimate position, speeds and current with a fitted model.")
@click.argument("model", type=MODEL)
@click.argument("logs", nargs=-1, required=True, type=LOG)
@click.option(
    "--smooth/--filter",
    "smoothed",
    default=True,
    show_default=True,
    help="Smoothed (all samples) or filtered (samples so far).",
)
@click.option(
    "--gnss-outage",
    "gnss_outages",
    multiple=True,
    callback=_parse_intervals,
    metavar="T0:T1",
    help="Withhold GNSS in this interval [s of the log]; may be repeated.",
)
@window_option
@click.option("--thruster", type=MODEL, help="The static curve from command to thrust that the model was fitted with.")
@rate_option
@trust_option
@out_option("navigation")
@json_option()
def navigate(model: Path, logs: tuple[Path, ...], out: Path, as_json: bool, **how: Any) -> None:
    """Estimate position, heading, speeds, current and disturbance forces along LOGS with a fitted MODEL.

    GNSS outages are listed with the 95 % radius of the position at their end. LOGS should not be those that MODEL was
    fitted to. The results are a CSV file of the estimates for each log, result.json and report.html in the folder
    --out.

    \b
    Example:
      seatrial ident navigate vehicle/model.toml validation.mcap --gnss-outage 60:90 --out navigation
    """
    from seatrial.ident.workflows.navigate import NavigationRequest, navigate_logs

    request = NavigationRequest(model, logs, out, **how)
    run_workflow(lambda reporter: navigate_logs(request, command_line(), reporter), out, as_json)


ident.add_command(navigate)


@click.command(
    cls=InputsFirst, short_help="Write a fitted model for Python, CasADi, C, ROS 2, Simulink (FMU), Gazebo or VRX."
)
@click.argument("model", type=MODEL)
@click.option(
    "--to",
    "--format",
    "target",
    type=Choice(("python", "casadi", "c", "ros2", "fmu", "gazebo", "vrx"), FORMATS_OF_PROGRAMS),
    required=True,
    help="Target language or format. fmu: FMI 2.0 co-simulation, for Simulink, OpenModelica and others.",
)
@output_option(FILE, "File to write; without it, the text is printed. An FMU needs it.", callback=check_output)
@force_option
@click.option("--name", help="Prefix of the functions, or name of the node or FMU; default: name of the model.")
@click.option(
    "--with-disturbance-states",
    is_flag=True,
    help="Keep disturbance forces and sensor biases as states.",
)
@click.option(
    "--thruster",
    "thrusters",
    multiple=True,
    callback=parse_thruster_files,
    metavar="[NAME=]FILE",
    help="model.toml of `seatrial ident thruster`, from a bench test or a log of the boat: the inputs become commands. "
    "FILE for all thrusters, or NAME=FILE (left, right), repeated.",
)
@click.option(
    "--thrust-curve",
    type=Choice(("bench", "boat")),
    default="bench",
    show_default=True,
    help="Thrust curve of a model with --thruster.",
)
@click.option("--thrust-input", is_flag=True, help="Thrusts [N] as inputs in place of shaft speeds, for optimisation.")
@click.option("--source-only", is_flag=True, help="FMU without a binary, which needs no compiler here.")
@click.option("--mass", type=FiniteRange(0.0), help="Mass of the boat without added mass [kg], for gazebo and vrx.")
@click.option(
    "--inertia",
    type=FiniteRange(0.0),
    help="Moment of inertia about the vertical axis without added inertia [kg m2], for gazebo and vrx.",
)
@trust_option
def export(out: Path | None, **how: Any) -> None:
    """Export the fitted MODEL for other programs: equations, parameters, noise, names and units.

    The text is printed, or written to the file --out, which must not exist without --force.

    \b
    Examples:
      seatrial ident export diagnosis/model.toml --to c -o boat.h
      seatrial ident export boat/model.toml --to fmu --thruster thruster/model.toml -o boat.fmu
    """
    from seatrial.daq.errors import printable
    from seatrial.daq.files import write_output
    from seatrial.ident.workflows.export import ExportRequest, export_model, warn_of_module_name

    request = ExportRequest(**how)
    if out is None and request.target == "fmu":
        raise SeatrialError("an FMU is a binary file: name it with -o, for example -o boat.fmu")
    exported = export_model(request)
    if out is None:
        click.echo(exported.content, nl=False)
    else:
        write_output(out, exported.content)
        click.echo(f"wrote {printable(str(out))}")
        warn_of_module_name(out, request.target)


ident.add_command(export)


@click.command(cls=InputsFirst, short_help="Fisher information per log segment and parameter.")
@click.argument("model", type=MODEL)
@click.argument("logs", nargs=-1, required=True, type=LOG)
@click.option("--seconds", type=FiniteRange(2.0), default=30.0, show_default=True, help="Length of a segment [s].")
@click.option("--parameters", "chosen", metavar="NAMES", callback=parse_names, help="Only these parameters: d_v,m_v.")
@window_option
@click.option("--thruster", type=MODEL, help="The static curve from command to thrust that the model was fitted with.")
@rate_option
@trust_option
@out_option("information")
@json_option()
def information(model: Path, logs: tuple[Path, ...], out: Path, as_json: bool, **how: Any) -> None:
    """Compute the Fisher information of each segment of LOGS about each parameter of a fitted MODEL.

    It shows which segment a parameter depends on, and about which parameters the logs contain no information. The
    results are result.json and report.html in the folder --out.

    \b
    Example:
      seatrial ident information vehicle/model.toml estimation.mcap --seconds 20 --out information
    """
    from seatrial.ident.workflows import information

    request = information.InformationRequest(model, logs, out, **how)
    run_workflow(lambda reporter: information.information(request, command_line(), reporter), out, as_json)


ident.add_command(information)


@ident.command(short_help="White noise and random walk of sensors at rest.")
@click.argument("logs", nargs=-1, required=True, type=LOG)
@click.option("--signal", "signals", multiple=True, metavar="NAME", help="Only this signal; may be repeated.")
@out_option("noise")
@json_option()
def noise(logs: tuple[Path, ...], signals: tuple[str, ...], out: Path, as_json: bool) -> None:
    """Estimate white noise and random walk of each channel from LOGS of sensors at rest.

    The report has them in units of data sheets too, with the Allan deviation and the bias instability. The results are
    noise.toml, result.json and report.html in the folder --out.

    \b
    Example:
      seatrial ident noise standing_still.mcap --signal psi --signal r --out noise
    """
    from seatrial.ident.workflows import noise

    run_workflow(
        lambda reporter: noise.noise(logs, out, signals=signals, command=command_line(), reporter=reporter),
        out,
        as_json,
    )


@ident.command(short_help="Fit a model of the boat to logs and validate it on others.")
@click.argument("logs", nargs=-1, required=True, type=LOG)
@model_options()
@click.option(
    "--per-log",
    multiple=True,
    metavar="NAME",
    help="Estimate this parameter of an --effect in each log: --effect wind --per-log F_wx --per-log F_wy.",
)
@click.option(
    "--test-homogeneity",
    "homogeneity",
    multiple=True,
    metavar="NAME",
    help="Likelihood-ratio test: do the logs agree on this parameter? For two groups of logs and all parameters, "
    "use `seatrial ident changes`.",
)
@click.option("--profile", "profiles", multiple=True, metavar="NAME", help="Profile likelihood of this parameter.")
@robust_option
@reml_option()
@mean_order_option()
@despite_option
@validate_option
@window_option
@horizon_option
@rate_option
@trust_option
@out_option("vehicle")
@json_option()
def vehicle(logs: tuple[Path, ...], validate: tuple[Path, ...], out: Path, as_json: bool, **how: Any) -> None:
    """Fit a model of the boat to LOGS and validate it on others.

    The results are model.toml, result.json and report.html in the folder --out. The exit status is 1 if the fit did not
    converge.

    \b
    Example:
      seatrial ident vehicle estimation.mcap --thruster thruster/model.toml --validate validation.mcap --out vehicle
    """
    from seatrial.ident.workflows.vehicle import vehicle
    from seatrial.ident.workflows.vehicle_model import VehicleRequest

    request = VehicleRequest(logs, validate, out, **with_estimation_options(how))
    run_workflow(lambda reporter: vehicle(request, command_line(), reporter), out, as_json)


@ident.command(short_help="Fit a model of the boat to each of many logs.")
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path))
@model_options(
    why="On, as for a single log, because each row of the table stands for itself. The logs may then have different "
    "models; `ident changes` leaves the tests out by default."
)
@robust_option
@reml_option()
@mean_order_option()
@despite_option
@window_option
@horizon_option
@rate_option
@workers_options
@trust_option
@resumed_out_option("fleet")
@json_option()
def fleet(logs: tuple[Path, ...], out: Path, workers: Any, force: bool, as_json: bool, **how: Any) -> None:
    """Fit one model of the boat to each of LOGS separately, and compare the estimates of the logs.

    A folder stands for all logs in it. A log that fails, also one that is missing or cannot be read, does not end the
    others. The results in the folder --out are fits.parquet, with a row for each log and parameter, and result.json,
    with the differences between the logs. An interrupted run continues there, and only logs without a fit are fitted.
    The exit status is 1 if a log has no fit or its fit did not converge.

    \b
    Example:
      seatrial ident fleet logs/*.mcap --thruster thruster/model.toml --out fleet
      seatrial ident fleet logs/*.mcap --backend dask --scheduler tcp://192.168.1.5:8786 --out fleet
    """
    from seatrial.ident.report import print_result
    from seatrial.ident.workflows.fleet import FleetRequest, fit_fleet
    from seatrial.ident.workflows.vehicle_model import VehicleRequest

    request = FleetRequest(logs, VehicleRequest((), (), out, **with_estimation_options(how)), out, workers, force)
    result = fit_fleet(request, command_line(), LineReporter(err=True)).result
    if as_json:
        print_result_json(result)
    else:
        print_result(result, make_console())
    click.echo(f"table: {result.table}", err=as_json)
    if result.fitted < result.n_logs:
        click.echo(f"{result.n_logs - result.fitted} of {result.n_logs} logs have no fit", err=True)
        raise click.exceptions.Exit(1)


@ident.command(
    cls=GatheringCommand, short_help="Find what changed between two campaigns of logs.", options_metavar="[OPTIONS]"
)
@click.option(
    "--before", multiple=True, required=True, type=LOG, metavar="LOG...", help="Logs of the campaign before the change."
)
@click.option(
    "--after", multiple=True, required=True, type=LOG, metavar="LOG...", help="Logs of the campaign after the change."
)
@click.option(
    "--false-discovery-rate",
    type=FiniteRange(0.0, 0.5, min_open=True),
    default=0.05,
    show_default=True,
    help="Largest expected share of false ones among the changed parameters.",
)
@click.option(
    "--common-errors/--no-common-errors",
    default=True,
    show_default=True,
    help="Fit the first four logs before together, and add the small errors of sensors and hull form that they show to "
    "the model of all logs, with a difference of the thrusts of both sides. A model.toml gets this difference only, "
    "and a model of your own nothing.",
)
@model_options(
    score_tests=False,
    why="Off, because effects would be added in some logs and not in others; the scatter between the logs contains "
    "what the model lacks. `ident fleet` has the tests on by default.",
    sides=False,
)
@robust_option
@reml_option()
@mean_order_option()
@despite_option
@window_option
@horizon_option
@rate_option
@workers_options
@trust_option
@resumed_out_option("changes")
@json_option()
def changes(
    before: tuple[Path, ...],
    after: tuple[Path, ...],
    false_discovery_rate: float,
    common_errors: bool,
    out: Path,
    workers: Any,
    as_json: bool,
    **how: Any,
) -> None:
    """Fit one model to the logs of two campaigns, and find which parameters and effects differ between them.

    For example, what has a year of fouling changed? The model is fitted to each log separately. The scatter between
    logs is a random effect, and the false discovery rate of all changes together is held. The logs after are predicted
    with and without the changes. Two logs of a campaign are the least, three of each are better. The results in the
    folder --out are fits.parquet, with a row for each log and parameter, result.json and report.html. The question is
    whether the means of two groups of logs differ; `seatrial ident vehicle --test-homogeneity NAME` asks whether one
    parameter is the same in all logs of one fit.

    \b
    Example:
      seatrial ident changes --before may/*.mcap --after june/*.mcap --thruster thruster/model.toml --out changes
      seatrial ident changes --before may/*.mcap --after june/*.mcap --model diagnosis/model.toml
    """
    from seatrial.ident.workflows.changes import ChangesRequest, find_changes
    from seatrial.ident.workflows.vehicle_model import VehicleRequest

    force = how.pop("force")
    vehicle = VehicleRequest((), (), out, **with_estimation_options(how))
    request = ChangesRequest(before, after, vehicle, out, workers, force, false_discovery_rate, common_errors)
    run_workflow(lambda reporter: find_changes(request, command_line(), reporter).result, out, as_json)


@ident.command(short_help="Find effects that a model lacks; errors before and after.")
@click.argument("model", type=MODEL)
@click.argument("logs", nargs=-1, required=True, type=LOG)
@validate_option
@window_option
@horizon_option
@click.option(
    "--effects", "effects_file", type=SOURCE_FILE, help="FILE.py with EFFECT or EFFECTS: user-defined candidates."
)
@click.option(
    "--max-effects",
    type=click.IntRange(1, 6),
    default=3,
    show_default=True,
    help="Largest number of effects to add.",
)
@click.option(
    "--exclude",
    multiple=True,
    metavar="EFFECT",
    help="Leave an effect out of the search (wind, yaw-bias, ...); may be repeated.",
)
@click.option(
    "--thruster",
    metavar="CURVE|NAME",
    help="The static curve (model.toml) that the boat's MODEL was fitted with; if MODEL is a thruster's and the logs "
    "have several thrusters, its name in the rig.",
)
@thrust_of_option
@fix_option
@mass_option
@robust_option
@despite_option
@click.option(
    "--rate",
    type=FiniteRange(1.0, 200.0),
    help="Rows per second; faster sensors are averaged.  [default: 5 for a slow boat without accelerometers, 10 for "
    "others, on the bench 50]",
)
@trust_option
@out_option("diagnosis")
@json_option()
def diagnose(
    model: Path, logs: tuple[Path, ...], validate: tuple[Path, ...], out: Path, as_json: bool, **how: Any
) -> None:
    """Find effects that MODEL lacks to explain LOGS, add them, and compare prediction errors before and after.

    MODEL is that of a boat, or that of a thruster, with bench logs. The results are model.toml with the found effects,
    result.json and report.html in the folder --out.

    \b
    Example:
      seatrial ident diagnose vehicle/model.toml estimation.mcap --validate validation.mcap --out diagnosis
      seatrial ident diagnose vehicle/model.toml one.mcap --thruster curve/model.toml --validate two.mcap
      seatrial ident diagnose thruster/model.toml bench1.mcap --validate bench2.mcap --out diagnosis
    """
    from seatrial.ident.workflows.diagnose import DiagnosisRequest, diagnosis

    request = DiagnosisRequest(model, logs, validate, out, **with_estimation_options(how))
    run_workflow(lambda reporter: diagnosis(request, command_line(), reporter), out, as_json)


@ident.command(short_help="Monte Carlo of the estimator: bias, variance, coverage.")
@click.argument("models", metavar="MODEL...", nargs=-1, required=True, type=MODEL_SOURCE)
@click.option(
    "--replicates",
    type=click.IntRange(3),
    default=100,
    show_default=True,
    help="Number of simulated missions.",
)
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=1,
    show_default=True,
    help="Seed; the same seed gives the same missions and noise.",
)
@workers_options
@click.option(
    "--method",
    type=Choice(("pe", "oe")),
    default="pe",
    show_default=True,
    help="Prediction error or output error.",
)
@click.option(
    "--truth", multiple=True, callback=parse_values, help="NAME=VALUE: true value of a parameter; may be repeated."
)
@click.option("--free", multiple=True, metavar="NAME", help="Estimate only this parameter; may be repeated.")
@click.option("--seconds", type=FiniteRange(10.0), help="Length of the mission [s].")
@click.option("--unbounded", is_flag=True, help="Allow negative estimates of damping.")
@reml_option(None)
@mean_order_option(None)
@click.option("--docs", type=FILE, help="Also write the page of tables to this file, with its pictures.")
@trust_option
@output_option(
    FOLDER,
    "Folder for the results; a study that was interrupted continues there.",
    default=Path("study"),
    show_default=True,
)
@json_option()
def study(
    models: tuple[str, ...], method: str, unbounded: bool, docs: Path | None, out: Path, as_json: bool, **how: Any
) -> None:
    """Test the estimator by Monte Carlo: simulate missions of each MODEL, fit them, and compare with the true values.

    MODEL is surge, yaw, horizontal, kinematic, thruster, noise or designed; a fitted model.toml; or FILE.py:NAME, a
    user-defined Case. The study reports bias, variance and coverage of the intervals. The estimator is that of the
    other commands, or of the model.toml, unless an option changes it. The results, with report.html, are in the folder
    --out, and all replicates are one Parquet file there. An interrupted study continues there.

    \b
    Example:
      seatrial ident study surge yaw --replicates 500 --out study
    """
    from seatrial.ident.report import study_as_text, write_study_docs, write_study_page
    from seatrial.ident.results import AIMS
    from seatrial.ident.workflows.study import StudyRequest, run_studies

    estimator: Any = {"pe": "prediction-error", "oe": "output-error"}[method]
    request = StudyRequest(models, out=out, method=estimator, bounded=not unbounded, **how)
    result = run_studies(request, command_line(), LineReporter(err=True))
    write_study_page(result, AIMS, out / "report.html")
    if as_json:
        print_result_json(result)
    else:
        click.echo(study_as_text(result), nl=False)
    if docs is not None:
        write_study_docs(result, docs)
        click.echo(f"written: {docs}", err=as_json)
    click.echo(f"report: {out / 'report.html'}", err=as_json)


def _parse_area(_context: click.Context, _parameter: click.Parameter, text: str | None) -> tuple[float, float] | None:
    """Parse the size of an area: ``40x30`` to (40, 30), north and east [m] (click callback of ``--area``).

    None, if the option is not given, is returned unchanged. Raise click.BadParameter if the text has another form, or
    if a side is not positive.
    """
    if text is None:
        return None
    found = re.fullmatch(r"([\d.]+)x([\d.]+)", text)
    try:
        north, east = (float(side) for side in found.groups()) if found else (0.0, 0.0)
    except ValueError:
        north = east = 0.0
    if not (north > 0 and east > 0):
        raise click.BadParameter(f"{text!r} is not NORTHxEAST in metres, such as 40x40")
    return north, east


@click.command(
    short_help="Design the most informative mission for a model.",
    epilog="Example: seatrial mission design vehicle/model.toml --duration 600 --criterion Ds --parameters d_v,m_v "
    "--area 60x60 --out mission.toml",
)
@click.argument("source", metavar="MODEL", type=MODEL_SOURCE)
@click.option(
    "--duration",
    type=FiniteRange(10.0, 7200.0),
    default=600.0,
    show_default=True,
    help="Length of the mission [s].",
)
@click.option("--steps", type=click.IntRange(2, 1000), help="Number of steps [default: one per 5 s or --min-step].")
@click.option("--min-step", type=FiniteRange(0.2), default=1.0, show_default=True, help="Shortest step [s].")
@click.option(
    "--criterion",
    type=Choice(("D", "A", "E", "Ds")),
    default="D",
    show_default=True,
    help="Determinant, mean variance, or largest variance of the errors; Ds: D of --parameters.",
)
@click.option(
    "--parameters",
    "chosen",
    metavar="NAMES",
    callback=parse_names,
    help="Parameters to estimate, for example d_v,m_v [default: all].",
)
@click.option(
    "--area",
    metavar="NxE",
    callback=_parse_area,
    help="Area for the whole track, north by east [m]. The tracks of 24 boats of the prior keep to it; your boat may "
    "leave it, with the probability that the result gives.",
)
@click.option("--max-speed", type=FiniteRange(0, min_open=True), help="Largest speed through the water [m/s].")
@click.option("--energy", type=FiniteRange(0, 1, min_open=True), help="Largest mean of |n|^3, 1: full power.")
@click.option(
    "--current",
    type=FiniteRange(0, 2.0),
    default=0.0,
    show_default=True,
    help="Largest current [m/s], from any direction, that the track must allow for.",
)
@click.option(
    "--n-max",
    type=FiniteRange(0, 1, min_open=True),
    default=1.0,
    show_default=True,
    help="Largest size of a command; 1: full command.",
)
@click.option("--slew", type=FiniteRange(0, min_open=True), help="Slew limit of a command [1/s].")
@click.option(
    "--thruster",
    type=click.Path(path_type=Path),
    help="Bench model (folder or model.toml) whose time constant the shafts have [default: 358 ms].",
)
@click.option(
    "--rate",
    "rates",
    multiple=True,
    callback=parse_rates,
    metavar="SENSOR=HZ",
    help="Rate of a sensor, for example position=1 [default: that of the fitted data, else 10]; may be repeated.",
)
@click.option(
    "--average-over",
    "robust",
    type=click.IntRange(0, 256),
    default=0,
    show_default=True,
    help="Robust design: average the criterion over this number of parameter samples.",
)
@click.option(
    "--prior-halfwidth",
    "spread",
    type=FiniteRange(0, 0.9),
    default=0.25,
    show_default=True,
    help="Relative half-width of the prior of the parameters, if MODEL is not a model.toml.",
)
@click.option(
    "--information",
    "form",
    type=Choice(("pe", "oe")),
    default="pe",
    show_default=True,
    help="Fisher information of prediction error, or of output error as in the thesis.",
)
@click.option(
    "--discriminate",
    "between",
    metavar="EFFECTS",
    callback=parse_names,
    help="Two effects, such as delay,lag: T-optimal mission that distinguishes them. It usually takes 2 to 10 minutes; "
    "fewer --evaluations take less.",
)
@click.option(
    "--evaluations",
    type=click.IntRange(500),
    default=20_000,
    show_default=True,
    help="Evaluations of the search.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    help="Seed; the same seed gives the same mission.",
)
@click.option(
    "--thrusters", metavar="NAMES", callback=parse_names, help="Names in the rig file, by default left,right."
)
@output_option(
    FILE,
    "The mission to write. A page and its numbers are written beside it.",
    default=Path("mission.toml"),
    show_default=True,
)
@click.option("--force", is_flag=True, help="Replace the mission and the files beside it if they exist.")
@trust_option
@json_option()
def design(
    source: str,
    out: Path,
    force: bool,
    as_json: bool,
    min_step: float,
    area: tuple[float, float] | None,
    max_speed: float | None,
    energy: float | None,
    current: float,
    form: str,
    slew: float | None,
    between: tuple[str, ...],
    **rest: Any,
) -> None:
    """Design the most informative mission for MODEL: a model.toml, horizontal, surge:shaft, FILE.py:NAME.

    The standard errors of a model.toml are the prior, so the mission is the best next one. `seatrial mission show`
    draws it, `seatrial mission run` runs it. The mission, and a .json and an .html file beside it, are written. They
    are replaced only with --force.
    """
    if between and len(between) != 2:
        raise click.BadParameter("give exactly two effects, such as delay,lag", param_hint="--discriminate")
    if between and rest["robust"]:
        raise click.BadParameter(
            "cannot be used with --discriminate, whose criterion is not averaged over parameter samples; leave out one "
            "of the two options",
            param_hint="--average-over",
        )
    if rest["criterion"] == "Ds" and not rest["chosen"]:
        raise click.BadParameter(
            "Ds needs the parameters to estimate; give them by --parameters, such as d_v,m_v", param_hint="--criterion"
        )
    from seatrial.ident.experiment_design import DesignLimits
    from seatrial.ident.workflows.design import DesignRequest, design_summary, make_design

    request = DesignRequest(
        shortest=min_step,
        limits=DesignLimits(area, max_speed, energy, current),
        between=between,
        process_noise=form == "pe",
        slew=float("inf") if slew is None else slew,
        **rest,
    )
    if between:
        text = "  design: --discriminate usually takes 2 to 10 minutes; fewer --evaluations take less. Ctrl-C ends it."
        click.echo(text, err=True)
    try:
        result = _with_live_progress(
            lambda reporter: make_design(source, request, out, command_line(), reporter, force)
        )
    except (ValueError, KeyError) as problem:
        raise SeatrialError(f"{source}: {str(problem).strip(chr(39) + chr(34))}") from problem
    if as_json:
        print_result_json(result)
    else:
        for line in design_summary(result):
            click.echo(line)
    click.echo(f"{out}; report: {out.with_suffix('.html')}", err=as_json)


def _with_live_progress(work: Any) -> Any:
    """Run a computation while a live line on standard error shows its progress, and return its result.

    If standard error is no terminal, lines of progress are printed there, at most one of a kind in two seconds.
    ``work`` is a function of a reporter, which receives the lines of progress and the warnings. Its errors are not
    caught.
    """
    console = make_console(stderr=True)
    if not console.is_terminal:
        return work(SpacedLines())
    with console.status("compiling") as status:
        return work(LiveLine(console, status))


def _parse_interval(text: str) -> tuple[float, float]:
    """Parse an interval of time of a log: ``60:90`` to (60, 90) [s].

    Raise click.BadParameter if the text has another form, if the end is not after the start, or if one is not finite.
    """
    first, _, last = text.partition(":")
    try:
        begin, end = float(first), float(last)
    except ValueError:
        raise click.BadParameter(f"{text!r} is not T0:T1 in seconds of the log, such as 60:90") from None
    if not -math.inf < begin < end < math.inf:
        raise click.BadParameter(f"{text!r}: the end is not after the beginning; write T0:T1, such as 60:90")
    return begin, end
