"""The command `seatrial mission design`: it belongs to bench's group, but needs ident; seatrial.py puts it there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import click

from daq.errors import SeatrialError
from ident.cli_common import command_line, known, names


def _area(_context: click.Context, _parameter: click.Parameter, given: str | None) -> tuple[float, float] | None:
    if given is None:
        return None
    found = re.fullmatch(r"([\d.]+)x([\d.]+)", given)
    try:
        north, east = (float(side) for side in found.groups()) if found else (0.0, 0.0)
    except ValueError:
        north = east = 0.0
    if not (north > 0 and east > 0):
        raise click.BadParameter(f"{given!r} is not NORTHxEAST in metres, such as 40x40")
    return north, east


@click.command(short_help="Design the mission that tells most about a model.",
               epilog="Example: seatrial mission design vehicle/model.toml --duration 600 --criterion Ds --for d_v,m_v "
               "--area 60x60 --out mission.toml")
@click.argument("source", metavar="MODEL")
@click.option("--duration", type=click.FloatRange(10.0, 7200.0), default=600.0, show_default=True, help="Seconds.")
@click.option("--steps", type=click.IntRange(2, 1000), help="How many steps [default: one in 5 s].")
@click.option("--min-step", type=click.FloatRange(0.2), default=1.0, show_default=True, help="Shortest step, s.")
@click.option("--criterion", type=click.Choice(("D", "A", "E", "Ds")), default="D", show_default=True,
              help="Volume, mean variance, or worst direction of the errors; Ds: D of those of --for.")
@click.option("--for", "chosen", metavar="NAMES", callback=names, help="Parameters to learn, d_v,m_v [default: all].")
@click.option("--area", metavar="NxE", callback=_area, help="Metres north by east that the whole track must fit into.")
@click.option("--max-speed", type=click.FloatRange(0, min_open=True), help="Through the water, m/s.")
@click.option("--energy", type=click.FloatRange(0, 1, min_open=True), help="Largest mean of |n|^3, 1: full power.")
@click.option("--current", type=click.FloatRange(0, 2.0), default=0.0, show_default=True,
              help="Largest current, m/s, that the track is to be reckoned with, from anywhere.")
@click.option("--n-max", type=click.FloatRange(0, 1, min_open=True), default=1.0, show_default=True)
@click.option("--slew", type=click.FloatRange(0, min_open=True), help="Largest change of a command, 1/s.")
@click.option("--rate", "rates", multiple=True, callback=known, metavar="SENSOR=HZ",
              help="A sensor's rate, position=1 [default: 10 each]; may be repeated.")
@click.option("--robust", type=click.IntRange(0, 256), default=0, show_default=True,
              help="Average the criterion over so many samples of the parameters.")
@click.option("--spread", type=click.FloatRange(0, 0.9), default=0.25, show_default=True,
              help="Relative half-width of what is believed of the parameters, where MODEL is no model.toml.")
@click.option("--form", type=click.Choice(("pe", "oe")), default="pe", show_default=True,
              help="Information of prediction error, or of output error as in the thesis.")
@click.option("--between", metavar="EFFECTS", callback=names,
              help="Two effects, delay,lag: the mission that tells them apart (T-optimal).")
@click.option("--evaluations", type=click.IntRange(500), default=20_000, show_default=True, help="Work of the search.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Same seed, same mission.")
@click.option("--thrusters", metavar="NAMES", callback=names, help="Names in the rig, left,right by default.")
@click.option("-o", "--out", type=click.Path(dir_okay=False, path_type=Path), default=Path("mission.toml"),
              show_default=True, help="The mission to write; it must not exist. A page and its numbers go beside it.")
def design(source: str, out: Path, min_step: float, area: tuple[float, float] | None, max_speed: float | None,
           energy: float | None, current: float, form: str, slew: float | None, between: tuple[str, ...],
           **rest: Any) -> None:
    """Design the mission that tells most about MODEL: a model.toml, horizontal, surge:shaft, FILE.py:NAME.

    A model.toml brings what it knows already, so the mission is the best one to come next. `seatrial mission show`
    draws it, `seatrial mission run` runs it.
    """
    if between and len(between) != 2:
        raise click.BadParameter("names two effects, such as delay,lag", param_hint="--between")
    if rest["criterion"] == "Ds" and not rest["chosen"]:
        raise click.BadParameter("Ds needs --for: which parameters?", param_hint="--criterion")
    from ident.design_job import Wish, make_design, summary
    from ident.design_task import Limits

    wish = Wish(shortest=min_step, limits=Limits(area, max_speed, energy, current), between=between,
                process_noise=form == "pe", slew=float("inf") if slew is None else slew, **rest)
    try:
        result = _work(lambda say: make_design(source, wish, out, command_line(), say))
    except (ValueError, KeyError) as problem:
        raise SeatrialError(f"{source}: {str(problem).strip(chr(39) + chr(34))}") from problem
    for line in summary(result):
        click.echo(line)
    click.echo(f"{out}; report: {out.with_suffix('.html')}")


def _work(work: Any) -> Any:
    """Do it with a live line of what it is doing."""
    from rich.console import Console

    console = Console(highlight=False, stderr=True)
    with console.status("compiling") as status:
        return work(lambda line: status.update(line))
