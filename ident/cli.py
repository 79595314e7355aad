"""Commands of ident: noise, thruster, vehicle, diagnose."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from daq.errors import SeatrialError

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


@ident.command()
@click.argument("logs", nargs=-1, required=True, type=LOG)
@click.option(
    "--model",
    "source",
    default="auto",
    show_default=True,
    help="horizontal:shaft, horizontal:force, horizontal:general (each also with :still for no current), "
    "or FILE.py:NAME for your own.",
)
@click.option("--thruster", type=LOG, help="model.toml of the bench: thrust coefficients c1, c2 are taken from it.")
@click.option("--fix", multiple=True, callback=_known, help="NAME=VALUE: a parameter that is known; may be repeated.")
@click.option("--start", "begin", multiple=True, callback=_known, help="NAME=VALUE: where the estimate starts.")
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
            rate=rate,
            command=_command(),
            say=say,
        ),
        out,
    )


@ident.command()
@click.argument("logs", nargs=-1, required=True, type=LOG)
@click.option("--thruster", "name", help="The thruster's name in the rig file, where the log has several.")
@_out("thruster")
def thruster(logs: tuple[Path, ...], name: str | None, out: Path) -> None:
    """Fit shaft response and thrust curve to bench LOGS of one thruster.

    \b
    Example:
      seatrial ident thruster bench.mcap --out thruster
    """
    from ident import bench_job

    _run(lambda say: bench_job.bench(logs, out, name=name, command=_command(), say=say), out)


@ident.command()
@click.argument("model", type=LOG)
@click.argument("logs", nargs=-1, required=True, type=LOG)
@_validate
@click.option("--max-effects", type=click.IntRange(1, 6), default=3, show_default=True, help="Stop after so many.")
@_rate
@_out("diagnosis")
def diagnose(
    model: Path, logs: tuple[Path, ...], validate: tuple[Path, ...], max_effects: int, rate: float, out: Path
) -> None:
    """Find what MODEL lacks to explain LOGS, add it, and show the error before and after.

    \b
    Example:
      seatrial ident diagnose vehicle/model.toml estimation.mcap --validate validation.mcap --out diagnosis
    """
    from ident import jobs

    _run(
        lambda say: jobs.diagnosis(
            model, logs, validate, out, rate=rate, max_effects=max_effects, command=_command(), say=say
        ),
        out,
    )


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
