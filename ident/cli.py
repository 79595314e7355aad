"""Commands of ident: noise, thruster, vehicle, diagnose, export."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from daq.errors import SeatrialError

# All matrices here are small: threads of the linear algebra library would only wait for each other. Before numpy.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

LOG = click.Path(exists=True, dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)


@click.group()
def ident() -> None:
    """Fit models to logs, and find what they lack."""


def _known(_context: click.Context, _parameter: click.Parameter, given: Sequence[str]) -> dict[str, float]:
    found = {}
    for item in given:
        name, _, value = item.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            raise click.BadParameter(f"{item!r} is not NAME=NUMBER") from None
    return found


def _validate(f: Callable[..., Any]) -> Callable[..., Any]:
    return click.option(
        "--validate", multiple=True, type=LOG, help="A log that the fit does not see; may be repeated."
    )(f)


def _out(default: str) -> Callable[..., Any]:
    return click.option("--out", type=FOLDER, default=Path(default), show_default=True, help="Folder for the results.")


def _rate(f: Callable[..., Any]) -> Callable[..., Any]:
    return click.option(
        "--rate",
        type=click.FloatRange(1.0, 200.0),
        default=10.0,
        show_default=True,
        help="Faster sensors are averaged to this many rows a second.",
    )(f)


def _robust(f: Callable[..., Any]) -> Callable[..., Any]:
    return click.option("--robust", is_flag=True, help="Allow outliers in all sensors, and count them.")(f)


@ident.command()
@click.argument("logs", nargs=-1, required=True, type=LOG)
@click.option("--signal", "signals", multiple=True, metavar="NAME", help="Only this signal; may be repeated.")
@_out("noise")
def noise(logs: tuple[Path, ...], signals: tuple[str, ...], out: Path) -> None:
    """Estimate white noise and random walk of each channel from LOGS of sensors at rest.

    \b
    Example:
      seatrial ident noise standing_still.mcap --signal psi --signal r --out noise
    """
    from ident import noise_job

    _run(lambda say: noise_job.noise(logs, out, signals=signals, command=_command(), say=say), out)


@ident.command()
@click.argument("logs", nargs=-1, required=True, type=LOG)
@click.option(
    "--model",
    "source",
    default="auto",
    show_default=True,
    help="horizontal:shaft, horizontal:force, horizontal:general (each also with :still for no current, "
    ":walk for one that wanders), "
    "kinematic:shaft|force (measured attitude; :yaw with the yaw equation), "
    "surge:force|shaft:position|speed|both, yaw:rate|both, or FILE.py:NAME for your own.",
)
@click.option(
    "--thruster", type=LOG, help="model.toml of the bench: c1 and c2, or the static curve from command to thrust."
)
@click.option("--fix", multiple=True, callback=_known, help="NAME=VALUE: a parameter that is known; may be repeated.")
@click.option("--start", "begin", multiple=True, callback=_known, help="NAME=VALUE: where the estimate starts.")
@click.option("--agree", multiple=True, metavar="NAME", help="Test whether the logs agree on this parameter.")
@click.option("--profile", "profiles", multiple=True, metavar="NAME", help="Profile likelihood of this parameter.")
@_robust
@click.option("--as-is", is_flag=True, help="Do not swap the sides of the thrusters where the data say they are.")
@_validate
@_rate
@_out("vehicle")
def vehicle(
    logs: tuple[Path, ...],
    source: str,
    thruster: Path | None,
    fix: dict[str, float],
    begin: dict[str, float],
    agree: tuple[str, ...],
    profiles: tuple[str, ...],
    robust: bool,
    as_is: bool,
    validate: tuple[Path, ...],
    rate: float,
    out: Path,
) -> None:
    """Fit a model of the boat to LOGS and judge it on others.

    \b
    Example:
      seatrial ident vehicle estimation.mcap --thruster thruster/model.toml --validate validation.mcap --out vehicle
    """
    from ident import jobs

    _run(
        lambda say: jobs.vehicle(
            logs,
            validate,
            out,
            source=source,
            thruster=thruster,
            fix=fix,
            begin=begin,
            as_is=as_is,
            agree=agree,
            profiles=profiles,
            robust=robust,
            rate=rate,
            command=_command(),
            say=say,
        ),
        out,
    )


@ident.command()
@click.argument("logs", nargs=-1, required=True, type=LOG)
@click.option("--thruster", "name", help="The thruster's name in the rig file, where the log has several.")
@click.option(
    "--settle",
    type=click.FloatRange(0.0),
    default=1.5,
    show_default=True,
    help="Seconds left out after each change of command, where only force and command were logged.",
)
@_out("thruster")
def thruster(logs: tuple[Path, ...], name: str | None, settle: float, out: Path) -> None:
    """Fit shaft response and thrust curve to bench LOGS of one thruster.

    A log of force and command without shaft speed gives the static curve alone, as a table.

    \b
    Example:
      seatrial ident thruster bench.mcap --out thruster
    """
    from ident import bench_job

    _run(lambda say: bench_job.bench(logs, out, name=name, settle=settle, command=_command(), say=say), out)


@ident.command()
@click.argument("model", type=LOG)
@click.argument("logs", nargs=-1, required=True, type=LOG)
@_validate
@click.option("--effects", "effects_file", type=LOG, help="FILE.py with EFFECT or EFFECTS: candidates of your own.")
@click.option("--max-effects", type=click.IntRange(1, 6), default=3, show_default=True, help="Stop after so many.")
@_robust
@_rate
@_out("diagnosis")
def diagnose(
    model: Path,
    logs: tuple[Path, ...],
    validate: tuple[Path, ...],
    effects_file: Path | None,
    max_effects: int,
    robust: bool,
    rate: float,
    out: Path,
) -> None:
    """Find what MODEL lacks to explain LOGS, add it, and show the error before and after.

    \b
    Example:
      seatrial ident diagnose vehicle/model.toml estimation.mcap --validate validation.mcap --out diagnosis
    """
    from ident import jobs

    _run(
        lambda say: jobs.diagnosis(
            model,
            logs,
            validate,
            out,
            rate=rate,
            max_effects=max_effects,
            effects_file=effects_file,
            robust=robust,
            command=_command(),
            say=say,
        ),
        out,
    )


@ident.command()
@click.argument("model", type=LOG)
@click.option("--to", "target", type=click.Choice(("python", "casadi", "c", "ros2")), required=True, help="For what.")
@click.option("-o", "--output", type=click.Path(dir_okay=False, path_type=Path), help="File to write; else the screen.")
@click.option("--name", help="Prefix of the functions, or name of the node, in place of the model's own name.")
@click.option("--with-nuisance", is_flag=True, help="Keep unexplained forces and sensor offsets as states.")
def export(model: Path, target: str, output: Path | None, name: str | None, with_nuisance: bool) -> None:
    """Write the fitted MODEL for other programs: equations, parameters, noise, names and units.

    \b
    Example:
      seatrial ident export diagnosis/model.toml --to c -o boat.h
    """
    from ident.export import export as written
    from ident.modelfile import load_model

    try:
        text = written(load_model(model), target, name=name, nuisance=with_nuisance)
    except ValueError as problem:
        raise SeatrialError(f"{model}: {problem}") from problem
    if output is None:
        click.echo(text, nl=False)
    else:
        output.write_text(text, encoding="utf-8")
        click.echo(f"wrote {output}")


@ident.command()
@click.argument("models", metavar="MODEL...", nargs=-1, required=True)
@click.option("--replicates", type=click.IntRange(3), default=100, show_default=True, help="Missions to simulate.")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True)
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Processes.")
@click.option("--method", type=click.Choice(("pe", "oe")), default="pe", show_default=True, help="The estimator.")
@click.option("--truth", multiple=True, callback=_known, help="NAME=VALUE: another true value; may be repeated.")
@click.option("--free", multiple=True, metavar="NAME", help="Estimate only this parameter; may be repeated.")
@click.option("--seconds", type=click.FloatRange(10.0), help="Length of the mission.")
@click.option("--unbounded", is_flag=True, help="Let damping be estimated below zero.")
@click.option("--docs", is_flag=True, help="Print the page of docs/study.md instead of the table.")
@_out("study")
def study(
    models: tuple[str, ...], replicates: int, seed: int, jobs: int, method: Any, truth: dict[str, float],
    free: tuple[str, ...], seconds: float | None, unbounded: bool, docs: bool, out: Path,
) -> None:
    """Monte Carlo of the estimator on simulated missions of MODELs: surge, yaw, horizontal, thruster.

    Bias, variance and coverage of the intervals. What was interrupted goes on where it was.

    \b
    Example:
      seatrial ident study surge yaw --replicates 500 --jobs 2 --out study
    """
    from ident import study_job

    result = study_job.run_studies(
        models, replicates, seed, out, truth=truth, free=free, seconds=seconds, bounded=not unbounded, method=method,
        jobs=jobs, command=_command(), say=lambda line: click.echo(f"  {line}", err=True),
    )
    click.echo(study_job.page(result) if docs else study_job.as_text(result), nl=False)


def _run(work: Callable[[Callable[[str], None]], dict[str, Any]], out: Path) -> None:
    """Do the work with a live line of what it is doing; then show the result and where it is."""
    from rich.console import Console

    console = Console(highlight=False)
    try:
        if console.is_terminal:
            with console.status("reading logs") as status:
                result = work(lambda line: status.update(line))
        else:
            result = work(lambda line: click.echo(f"  {line}"))
    except (ValueError, KeyError) as problem:
        raise SeatrialError(str(problem).strip("'\"")) from problem
    from ident.report import print_result

    print_result(result, console)
    click.echo(f"report: {out / 'report.html'}")


def _command() -> str:
    return " ".join(["seatrial", *sys.argv[1:]])
