"""Shared options of the ident commands, and the display of progress."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from seatrial.daq.errors import SeatrialError
from seatrial.daq.options import FiniteRange
from seatrial.ident.reporter import Reporter

if TYPE_CHECKING:
    from rich.console import Console
    from rich.status import Status

    from seatrial.ident.results import Result

LOG = click.Path(exists=True, dir_okay=False, path_type=Path)
MODEL = click.Path(exists=True, path_type=Path)  # a folder gets its line where the model is read
FOLDER = click.Path(file_okay=False, path_type=Path)
FILE = click.Path(dir_okay=False, path_type=Path)


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError
    return number


def parse_values(_context: click.Context, _parameter: click.Parameter, given: Sequence[str]) -> dict[str, float]:
    """Callback of options NAME=VALUE."""
    found = {}
    for item in given:
        name, _, value = item.partition("=")
        try:
            found[name] = _finite(value)
        except ValueError:
            raise click.BadParameter(f"{item!r} is not NAME=NUMBER") from None
    return found


def parse_rates(context: click.Context, parameter: click.Parameter, given: Sequence[str]) -> dict[str, float]:
    """Callback of options SENSOR=HZ, above zero."""
    found = parse_values(context, parameter, given)
    for name, rate in found.items():
        if rate <= 0.0:
            raise click.BadParameter(f"{name}={rate:g} is not above 0 Hz")
    return found


def processes(_context: click.Context, _parameter: click.Parameter, given: int) -> int:
    """Callback of ``--jobs``: a number of processes, or -1 for one a core."""
    if given < 1 and given != -1:
        raise click.BadParameter(f"{given} is neither a number of processes nor -1, for one a core")
    return given


def parse_names(_context: click.Context, _parameter: click.Parameter, given: str | None) -> tuple[str, ...]:
    """Callback of options NAME,NAME."""
    return tuple(n.strip() for n in given.split(",") if n.strip()) if given else ()


def parse_priors(
    _context: click.Context, _parameter: click.Parameter, given: Sequence[str]
) -> dict[str, tuple[float, float]]:
    """Callback of options NAME=MEAN:SD."""
    found = {}
    for item in given:
        name, _, value = item.partition("=")
        try:
            mean, sd = (_finite(part) for part in value.split(":"))
        except ValueError:
            raise click.BadParameter(f"{item!r} is not NAME=MEAN:SD") from None
        if not sd > 0:
            raise click.BadParameter(f"{item!r}: the standard deviation is not positive")
        found[name] = (mean, sd)
    return found


def validate_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """``--validate``, any number of times."""
    return click.option(
        "--validate", multiple=True, type=LOG, help="Validation log, not used by the fit; may be repeated."
    )(f)


def window_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """``--from`` and ``--to``, which the command gets as ``window``."""

    @wraps(f)
    def command(*args: Any, t_from: float, t_to: float | None, **rest: Any) -> Any:
        from seatrial.ident.data import TimeWindow

        t_to = math.inf if t_to is None else t_to
        if not t_from < t_to:
            raise click.BadParameter(f"{t_to:g} s is not after --from, {t_from:g} s", param_hint="--to")
        return f(*args, window=TimeWindow(t_from, t_to), **rest)

    seconds, of = FiniteRange(0.0), "[s of the log]; of LOGS, whose rest is not read."
    command = click.option("--to", "t_to", type=seconds, help=f"End {of}")(command)
    return click.option("--from", "t_from", type=seconds, default=0.0, help=f"Start {of}")(command)


def force_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """``--force``, which `not_there` looks at."""
    help_ = "Replace results that are there."
    return click.option("--force", is_flag=True, expose_value=False, is_eager=True, callback=_force, help=help_)(f)


def _force(context: click.Context, _parameter: click.Parameter, given: bool) -> None:
    context.meta["force"] = given


def not_there(context: click.Context, _parameter: click.Parameter, out: Path | None) -> Path | None:
    """The file, or folder for results, to write. Raises SeatrialError where it is there already, without --force."""
    if out is not None:
        for path in (out, *(out / name for name in ("model.toml", "result.json", "report.html"))):
            if path.is_symlink() and not path.is_dir():
                raise SeatrialError(f"{path}: is a symbolic link, and outputs follow none; remove it, or name another")
    there = out is not None and (out.is_file() or (out / "result.json").exists())
    if there and not context.meta["force"]:
        raise SeatrialError(f"{out}: is there already; --force replaces it, or give another name")
    return out


def out_option(default: str) -> Callable[..., Any]:
    """``--out`` with its default, and ``--force``."""
    words = "Folder for the results."
    how: dict[str, Any] = {"type": FOLDER, "default": Path(default), "show_default": True, "help": words}
    return lambda f: click.option("--out", callback=not_there, **how)(force_option(f))


def _trust(context: click.Context, _parameter: click.Parameter, given: bool) -> None:
    if given:
        from seatrial.ident.models import trusting_code

        context.with_resource(trusting_code())


def trust_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """``--trust-code``; for the whole of the command."""
    words = "Run the Python files that a model.toml names, even new, changed or elsewhere, and remember them."
    return click.option("--trust-code", is_flag=True, expose_value=False, callback=_trust, help=words)(f)


def despite_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """``--despite-faults``."""
    words = "Go on where the checks of the logs find swapped sides, wrong units, frames or times (`seatrial check`)."
    return click.option("--despite-faults", is_flag=True, help=words)(f)


def rate_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """``--rate``, 10 by default."""
    return click.option(
        "--rate",
        type=FiniteRange(1.0, 200.0),
        default=10.0,
        show_default=True,
        help="Rows per second; faster sensors are averaged.",
    )(f)


def horizon_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """``--horizon``; None: the default of the model."""
    return click.option(
        "--horizon",
        "horizon",
        type=FiniteRange(0.02, 3600.0),
        metavar="SECONDS",
        help="Prediction horizon, beside one step and simulation.  [default: 10, on the bench 1]",
    )(f)


def robust_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """``--robust``."""
    words = "Robust estimation: allow outliers in all sensors, and count them."
    return click.option("--robust", "outlier_model", is_flag=True, help=words)(f)


def reml_option(default: bool | None = True) -> Callable[..., Any]:
    """``--reml/--no-reml``; None: as the studied model was fitted."""
    return click.option(
        "--reml/--no-reml",
        default=default,
        show_default=bool(default),
        help="Restricted maximum likelihood for noise: without the bias by fitted dynamics.",
    )


def mean_order_option(default: bool | None = True) -> Callable[..., Any]:
    """``--second-order/--no-second-order``; None: as the studied model was fitted."""
    return click.option(
        "--second-order/--no-second-order",
        "mean_order",
        default=default,
        callback=_order,
        show_default=bool(default),
        help="Second-order EKF: the mean includes the curvature of drag, with less bias.",
    )


def _order(_context: click.Context, _parameter: click.Parameter, given: bool | None) -> Literal[1, 2] | None:
    return None if given is None else 2 if given else 1


ESTIMATION = ("outlier_model", "reml", "mean_order", "method", "horizon")  # options that every estimate shares


def estimation_of(options: dict[str, Any]) -> dict[str, Any]:
    """The options of a command with those of the estimate as one, ``estimation``."""
    from seatrial.ident.estimation import EstimationOptions

    shared = {n: v for n, v in options.items() if n in ESTIMATION}
    return {n: v for n, v in options.items() if n not in ESTIMATION} | {"estimation": EstimationOptions(**shared)}


class Lines:
    """Each line of progress, and each warning, is printed."""

    def __init__(self, err: bool = False) -> None:
        self.err = err

    def progress(self, text: str) -> None:
        click.echo(f"  {text}", err=self.err)

    def warning(self, text: str) -> None:
        click.echo(f"  {text}", err=self.err)


class LiveLine:
    """Progress is one live line of a terminal; warnings stay above it."""

    def __init__(self, console: Console, status: Status) -> None:
        self.console, self.status = console, status

    def progress(self, text: str) -> None:
        self.status.update(text)

    def warning(self, text: str) -> None:
        self.console.print(f"  {text}", markup=False)


def run_workflow(work: Callable[[Reporter], Result], out: Path) -> None:
    """Do the work with a live line of what it is doing; then show the result and where it is."""
    from rich.console import Console

    console = Console(highlight=False)
    try:
        if console.is_terminal:
            with console.status("reading logs") as status:
                result = work(LiveLine(console, status))
        else:
            result = work(Lines())
    except (ValueError, KeyError) as problem:
        raise SeatrialError(str(problem).strip("'\"")) from problem
    from seatrial.ident.report import print_result
    from seatrial.ident.results import FitResult

    print_result(result, console)
    click.echo(f"report: {out / 'report.html'}")
    if isinstance(result, FitResult) and not result.converged:
        raise click.exceptions.Exit(1)


def command_line() -> str:
    """What was typed, for the result's ``command``."""
    return " ".join(["seatrial", *sys.argv[1:]])
