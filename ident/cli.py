"""Commands of ident: noise, thruster, vehicle, diagnose, navigate, export, study."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ident.check_cli import check, check_page
from ident.cli_common import (
    FILE,
    LOG,
    ahead_option,
    command_line,
    known,
    out_option,
    priors,
    processes,
    rate_option,
    restricted_option,
    robust_option,
    run,
    second_order_option,
    validate_option,
)
from ident.cli_use import export, information, navigate


@click.group()
def ident() -> None:
    """Fit models to logs, and find what they lack."""


ident.add_command(check)
ident.add_command(check_page)
ident.add_command(navigate)
ident.add_command(export)
ident.add_command(information)


@ident.command(short_help="White noise and random walk of sensors at rest.")
@click.argument("logs", nargs=-1, required=True, type=LOG)
@click.option("--signal", "signals", multiple=True, metavar="NAME", help="Only this signal; may be repeated.")
@out_option("noise")
def noise(logs: tuple[Path, ...], signals: tuple[str, ...], out: Path) -> None:
    """Estimate white noise and random walk of each channel from LOGS of sensors at rest.

    \b
    Example:
      seatrial ident noise standing_still.mcap --signal psi --signal r --out noise
    """
    from ident import noise_job

    run(lambda say: noise_job.noise(logs, out, signals=signals, command=command_line(), say=say), out)


@ident.command(short_help="Fit a model of the boat to logs and judge it on others.")
@click.argument("logs", nargs=-1, required=True, type=LOG)
@click.option(
    "--model",
    "source",
    default="auto",
    show_default=True,
    help="horizontal:shaft, horizontal:force, horizontal:general (each also with :still for no current, "
    ":walk for one that wanders), "
    "kinematic:shaft|force (measured attitude; :yaw with the yaw equation, :still and :walk), "
    "surge:force|shaft:position|speed|both, yaw:rate|both, or FILE.py:NAME for your own.",
)
@click.option(
    "--thruster", type=LOG, help="model.toml of the bench: c1 and c2, or the static curve from command to thrust."
)
@click.option("--fix", multiple=True, callback=known, help="NAME=VALUE: a parameter that is known; may be repeated.")
@click.option("--start", "begin", multiple=True, callback=known, help="NAME=VALUE: where the estimate starts.")
@click.option(
    "--prior",
    multiple=True,
    callback=priors,
    help="NAME=MEAN:SD: what is known of a parameter before, in this fit; may be repeated.",
)
@click.option("--agree", multiple=True, metavar="NAME", help="Test whether the logs agree on this parameter.")
@click.option("--profile", "profiles", multiple=True, metavar="NAME", help="Profile likelihood of this parameter.")
@click.option(
    "--with", "effects", multiple=True, metavar="EFFECT",
    help="Add an effect of the catalogue, its parameters free (lever-arm, mount, ...); may be repeated.",
)
@robust_option
@restricted_option()
@second_order_option()
@click.option("--as-is", is_flag=True, help="Do not swap the sides of the thrusters where the data say they are.")
@validate_option
@ahead_option
@rate_option
@out_option("vehicle")
def vehicle(logs: tuple[Path, ...], validate: tuple[Path, ...], out: Path, **how: Any) -> None:
    """Fit a model of the boat to LOGS and judge it on others.

    \b
    Example:
      seatrial ident vehicle estimation.mcap --thruster thruster/model.toml --validate validation.mcap --out vehicle
    """
    from ident import jobs

    run(lambda say: jobs.vehicle(logs, validate, out, command=command_line(), say=say, **how), out)


@ident.command(short_help="Fit shaft response and thrust curve to logs of the bench.")
@click.argument("logs", nargs=-1, required=True, type=LOG)
@click.option("--thruster", "name", help="The thruster's name in the rig file, where the log has several.")
@click.option(
    "--settle",
    type=click.FloatRange(0.0),
    default=1.5,
    show_default=True,
    help="Seconds left out after each change of command, where only force and command were logged.",
)
@click.option("--profile", "profiles", multiple=True, metavar="NAME", help="Profile likelihood of this parameter.")
@ahead_option
@robust_option
@restricted_option()
@out_option("thruster")
def thruster(logs: tuple[Path, ...], out: Path, **how: Any) -> None:
    """Fit shaft response and thrust curve to bench LOGS of one thruster.

    A log of force and command without shaft speed gives the static curve alone, as a table.

    \b
    Example:
      seatrial ident thruster bench.mcap --out thruster
    """
    from ident import bench_job

    run(lambda say: bench_job.bench(logs, out, command=command_line(), say=say, **how), out)


@ident.command(short_help="Find what a model lacks, add it, and show before and after.")
@click.argument("model", type=LOG)
@click.argument("logs", nargs=-1, required=True, type=LOG)
@validate_option
@ahead_option
@click.option("--effects", "effects_file", type=LOG, help="FILE.py with EFFECT or EFFECTS: candidates of your own.")
@click.option("--max-effects", type=click.IntRange(1, 6), default=3, show_default=True, help="Stop after so many.")
@click.option(
    "--thruster",
    metavar="CURVE|NAME",
    help="The static curve (model.toml) that the boat's MODEL was fitted with; where MODEL is a thruster's and the "
    "logs have several, its name in the rig.",
)
@robust_option
@click.option(
    "--rate",
    type=click.FloatRange(1.0, 200.0),
    help="Faster sensors are averaged to this many rows a second.  [default: 10, on the bench 50]",
)
@out_option("diagnosis")
def diagnose(model: Path, logs: tuple[Path, ...], validate: tuple[Path, ...], out: Path, **how: Any) -> None:
    """Find what MODEL lacks to explain LOGS, add it, and show the error before and after.

    MODEL is a boat's, or a thruster's with logs from the bench.

    \b
    Example:
      seatrial ident diagnose vehicle/model.toml estimation.mcap --validate validation.mcap --out diagnosis
      seatrial ident diagnose vehicle/model.toml one.mcap --thruster curve/model.toml --validate two.mcap
      seatrial ident diagnose thruster/model.toml bench1.mcap --validate bench2.mcap --out diagnosis
    """
    from ident import jobs

    run(lambda say: jobs.diagnosis(model, logs, validate, out, command=command_line(), say=say, **how), out)


@ident.command(short_help="Monte Carlo of the estimator: bias, variance, coverage.")
@click.argument("models", metavar="MODEL...", nargs=-1, required=True)
@click.option("--replicates", type=click.IntRange(3), default=100, show_default=True, help="Missions to simulate.")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True)
@click.option("--jobs", type=int, default=-1, callback=processes, help="Processes.  [default: one a core, -1]")
@click.option("--method", type=click.Choice(("pe", "oe")), default="pe", show_default=True, help="The estimator.")
@click.option("--truth", multiple=True, callback=known, help="NAME=VALUE: another true value; may be repeated.")
@click.option("--free", multiple=True, metavar="NAME", help="Estimate only this parameter; may be repeated.")
@click.option("--seconds", type=click.FloatRange(10.0), help="Length of the mission.")
@click.option("--unbounded", is_flag=True, help="Let damping be estimated below zero.")
@restricted_option(None)
@second_order_option(None)
@click.option("--docs", type=FILE, help="Write the page of tables as this file, too, its pictures beside it.")
@out_option("study")
def study(
    models: tuple[str, ...], replicates: int, unbounded: bool, docs: Path | None, out: Path, **how: Any
) -> None:
    """Monte Carlo of the estimator on simulated missions of MODELs: surge, yaw, horizontal, kinematic, thruster,
    noise, designed; a fitted model.toml; or FILE.py:NAME, a Case of your own.

    Bias, variance and coverage of the intervals. The estimator is that of the commands, or what made the model.toml,
    unless told otherwise. What was interrupted goes on where it was.

    \b
    Example:
      seatrial ident study surge yaw --replicates 500 --out study
    """
    from ident import study_job
    from ident.report.study_docs import as_text, write_study_docs
    from ident.report.study_page import write_study_page
    from ident.study import AIMS

    result = study_job.run_studies(models, replicates, out=out, bounded=not unbounded, command=command_line(),
                                   say=lambda line: click.echo(f"  {line}", err=True), **how)
    write_study_page(result, AIMS, out / "report.html")
    click.echo(as_text(result), nl=False)
    if docs is not None:
        write_study_docs(result, docs)
        click.echo(f"written: {docs}")
    click.echo(f"report: {out / 'report.html'}")
