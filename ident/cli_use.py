"""Commands of ident that use a fitted model: navigate, export, information."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import click

from daq.errors import SeatrialError
from ident.cli_common import LOG, command_line, names, out_option, rate_option, run


def _stretches(_context: click.Context, _parameter: click.Parameter, given: Sequence[str]) -> list[tuple[float, float]]:
    return [_stretch(text) for text in given]


def _stretch(text: str) -> tuple[float, float]:
    """``60:90`` -> (60, 90) s."""
    first, _, last = text.partition(":")
    try:
        begin, end = float(first), float(last)
    except ValueError:
        raise click.BadParameter(f"{text!r} is not T0:T1 in seconds of the log, as 60:90") from None
    if not -math.inf < begin < end < math.inf:
        raise click.BadParameter(f"{text!r}: the end is not after the beginning")
    return begin, end


@click.command(short_help="Where the boat was, and how sure that is, by a fitted model.")
@click.argument("model", type=LOG)
@click.argument("logs", nargs=-1, required=True, type=LOG)
@click.option("--smooth/--filter", "smoothed", default=True, show_default=True, help="By all samples, or those so far.")
@click.option("--without-gnss", multiple=True, callback=_stretches, metavar="T0:T1",
              help="Do as if there were no GNSS in this stretch [s]; may be repeated.")
@click.option("--from", "t_from", type=click.FloatRange(0.0), help="Begin here [s of the log].")
@click.option("--to", "t_to", type=click.FloatRange(0.0), help="End here [s of the log].")
@click.option("--thruster", type=LOG, help="The static curve from command to thrust that the model was fitted with.")
@rate_option
@out_option("navigation")
def navigate(
    model: Path, logs: tuple[Path, ...], smoothed: bool, without_gnss: list[tuple[float, float]], t_from: float | None,
    t_to: float | None, thruster: Path | None, rate: float, out: Path,
) -> None:
    """Position, heading, speeds, current and unexplained forces along LOGS, with how sure they are, by a fitted MODEL.

    GNSS outages are found, and said how far off the position may be at their end. LOGS should not be those that MODEL
    was fitted to.

    \b
    Example:
      seatrial ident navigate vehicle/model.toml validation.mcap --without-gnss 60:90 --out navigation
    """
    from ident import navigate_job

    run(
        lambda say: navigate_job.run_navigation(
            model, logs, out, smoothed=smoothed, without_gnss=without_gnss, t_from=t_from, t_to=t_to, rate=rate,
            thruster=thruster, command=command_line(), say=say,
        ),
        out,
    )


@click.command(short_help="Which stretches of logs tell of which parameter.")
@click.argument("model", type=LOG)
@click.argument("logs", nargs=-1, required=True, type=LOG)
@click.option("--seconds", type=click.FloatRange(2.0), default=30.0, show_default=True, help="Length of a stretch.")
@click.option("--for", "chosen", metavar="NAMES", callback=names, help="Only these parameters, d_v,m_v.")
@click.option("--thruster", type=LOG, help="The static curve from command to thrust that the model was fitted with.")
@rate_option
@out_option("information")
def information(
    model: Path, logs: tuple[Path, ...], seconds: float, chosen: tuple[str, ...], thruster: Path | None, rate: float,
    out: Path,
) -> None:
    """Which stretches of LOGS tell of which parameter of a fitted MODEL, and what none of them tells.

    \b
    Example:
      seatrial ident information vehicle/model.toml estimation.mcap --seconds 20 --out information
    """
    from ident import information_job

    run(
        lambda say: information_job.information(
            model, logs, out, seconds=seconds, chosen=chosen, thruster=thruster, rate=rate, command=command_line(),
            say=say,
        ),
        out,
    )


@click.command(short_help="Write a fitted model for Python, CasADi, C or ROS 2.")
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
