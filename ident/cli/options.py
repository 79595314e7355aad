"""Shared options of the ident commands, and displays of their progress."""

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
MODEL = click.Path(exists=True, path_type=Path)  # a folder is accepted here: reading the model raises a clearer error
FOLDER = click.Path(file_okay=False, path_type=Path)
FILE = click.Path(dir_okay=False, path_type=Path)


def _finite(text: str) -> float:
    """Parse a finite number; raise ValueError for any other text."""
    number = float(text)
    if not math.isfinite(number):
        raise ValueError
    return number


def parse_values(_context: click.Context, _parameter: click.Parameter, items: Sequence[str]) -> dict[str, float]:
    """Parse the values of a NAME=VALUE option (click callback)."""
    found = {}
    for item in items:
        name, _, value = item.partition("=")
        try:
            found[name] = _finite(value)
        except ValueError:
            raise click.BadParameter(f"{item!r} is not NAME=NUMBER") from None
    return found


def parse_rates(context: click.Context, parameter: click.Parameter, items: Sequence[str]) -> dict[str, float]:
    """Parse the values of a SENSOR=HZ option, which must be above zero (click callback)."""
    found = parse_values(context, parameter, items)
    for name, rate in found.items():
        if rate <= 0.0:
            raise click.BadParameter(f"{name}={rate:g} is not above 0 Hz")
    return found


def processes(_context: click.Context, _parameter: click.Parameter, number: int) -> int:
    """Check ``--jobs``: a number of processes, or -1 for one process for each core (click callback)."""
    if number < 1 and number != -1:
        raise click.BadParameter(f"{number} is neither a number of processes nor -1 (one for each core)")
    return number


def parse_names(_context: click.Context, _parameter: click.Parameter, text: str | None) -> tuple[str, ...]:
    """Parse the names of a NAME,NAME option (click callback)."""
    return tuple(n.strip() for n in text.split(",") if n.strip()) if text else ()


def parse_priors(
    _context: click.Context, _parameter: click.Parameter, items: Sequence[str]
) -> dict[str, tuple[float, float]]:
    """Parse the values of a NAME=MEAN:SD option (click callback)."""
    found = {}
    for item in items:
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
    """Add ``--validate``, which may be repeated, to a command."""
    return click.option(
        "--validate", multiple=True, type=LOG, help="Validation log, not used by the fit; may be repeated."
    )(f)


def window_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--from`` and ``--to`` to a command, which receives them as ``window``."""

    @wraps(f)
    def command(*args: Any, t_from: float, t_to: float | None, **rest: Any) -> Any:
        from seatrial.ident.data import TimeWindow

        t_to = math.inf if t_to is None else t_to
        if not t_from < t_to:
            raise click.BadParameter(f"{t_to:g} s is not after --from, {t_from:g} s", param_hint="--to")
        return f(*args, window=TimeWindow(t_from, t_to), **rest)

    seconds, of = FiniteRange(0.0), "[s of the log] of the interval of LOGS that is used."
    command = click.option("--to", "t_to", type=seconds, help=f"End {of}")(command)
    return click.option("--from", "t_from", type=seconds, default=0.0, help=f"Start {of}")(command)


def force_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--force`` to a command; ``check_output`` reads its value from the context."""
    help_ = "Replace existing results."
    return click.option("--force", is_flag=True, expose_value=False, is_eager=True, callback=_force, help=help_)(f)


def _force(context: click.Context, _parameter: click.Parameter, force: bool) -> None:
    context.meta["force"] = force


def check_output(context: click.Context, _parameter: click.Parameter, out: Path | None) -> Path | None:
    """Check the file or folder of ``--out`` (click callback).

    Raises
    ------
    SeatrialError
        If it exists already and ``--force`` was not given, or if it is a symbolic link.
    """
    if out is not None:
        for path in (out, *(out / name for name in ("model.toml", "result.json", "report.html"))):
            if path.is_symlink() and not path.is_dir():
                raise SeatrialError(
                    f"{path}: is a symbolic link, which outputs do not follow; remove it, or give another name"
                )
    exists = out is not None and (out.is_file() or (out / "result.json").exists())
    if exists and not context.meta["force"]:
        raise SeatrialError(f"{out}: exists already; --force replaces it, or give another name")
    return out


def out_option(default: str) -> Callable[..., Any]:
    """Add ``--out``, with this default folder, and ``--force`` to a command."""
    words = "Folder for the results."
    how: dict[str, Any] = {"type": FOLDER, "default": Path(default), "show_default": True, "help": words}
    return lambda f: click.option("--out", callback=check_output, **how)(force_option(f))


def _trust(context: click.Context, _parameter: click.Parameter, trusted: bool) -> None:
    """Trust Python files until the command ends (click callback)."""
    if trusted:
        from seatrial.ident.models import trusting_code

        context.with_resource(trusting_code())


def trust_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--trust-code`` to a command."""
    words = (
        "Run the Python files that a model.toml names, even if they are new, changed or moved, and trust them later."
    )
    return click.option("--trust-code", is_flag=True, expose_value=False, callback=_trust, help=words)(f)


def despite_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--despite-faults`` to a command."""
    words = "Continue if the checks of the logs find swapped sides, wrong units, frames or times (`seatrial check`)."
    return click.option("--despite-faults", is_flag=True, help=words)(f)


def rate_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--rate`` [Hz] to a command, 10 by default."""
    return click.option(
        "--rate",
        type=FiniteRange(1.0, 200.0),
        default=10.0,
        show_default=True,
        help="Rows per second; faster sensors are averaged.",
    )(f)


def horizon_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--horizon`` [s] to a command; None is the default of the model."""
    return click.option(
        "--horizon",
        "horizon",
        type=FiniteRange(0.02, 3600.0),
        metavar="SECONDS",
        help="Prediction horizon, in addition to one step and simulation.  [default: 10, on the bench 1]",
    )(f)


def robust_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--robust`` to a command."""
    words = "Robust estimation: allow outliers in all sensors, and count them."
    return click.option("--robust", "outlier_model", is_flag=True, help=words)(f)


def reml_option(default: bool | None = True) -> Callable[..., Any]:
    """Return the option ``--reml/--no-reml``; default None: as the studied model was fitted."""
    return click.option(
        "--reml/--no-reml",
        default=default,
        show_default=bool(default),
        help="Restricted maximum likelihood for noise, which corrects the bias from fitted dynamics.",
    )


def mean_order_option(default: bool | None = True) -> Callable[..., Any]:
    """Return the option ``--second-order/--no-second-order``; default None: as the studied model was fitted."""
    return click.option(
        "--second-order/--no-second-order",
        "mean_order",
        default=default,
        callback=_order,
        show_default=bool(default),
        help="Second-order EKF: the mean includes the curvature of drag, with less bias.",
    )


def _order(_context: click.Context, _parameter: click.Parameter, second: bool | None) -> Literal[1, 2] | None:
    """Convert the flag to the order of the filter's mean; None stays None (click callback)."""
    return None if second is None else 2 if second else 1


ESTIMATION = ("outlier_model", "reml", "mean_order", "method", "horizon")  # options of ``EstimationOptions``


def estimation_of(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options of a command, with those of the estimator combined as ``estimation``."""
    from seatrial.ident.estimation import EstimationOptions

    shared = {n: v for n, v in options.items() if n in ESTIMATION}
    return {n: v for n, v in options.items() if n not in ESTIMATION} | {"estimation": EstimationOptions(**shared)}


class Lines:
    """Reporter that prints each line of progress and each warning."""

    def __init__(self, err: bool = False) -> None:
        self.err = err

    def progress(self, text: str) -> None:
        click.echo(f"  {text}", err=self.err)

    def warning(self, text: str) -> None:
        click.echo(f"  {text}", err=self.err)


class LiveLine:
    """Reporter that shows progress in one live line of a terminal, and prints warnings above it."""

    def __init__(self, console: Console, status: Status) -> None:
        self.console, self.status = console, status

    def progress(self, text: str) -> None:
        self.status.update(text)

    def warning(self, text: str) -> None:
        self.console.print(f"  {text}", markup=False)


def run_workflow(work: Callable[[Reporter], Result], out: Path) -> None:
    """Run a workflow with a display of its progress, then print the result and the path of the report.

    The exit status is 1 if the result is a fit that did not converge.

    Raises
    ------
    SeatrialError
        If the workflow raises ValueError or KeyError.
    """
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
    """Return the command line of this process, for the provenance of a result."""
    return " ".join(["seatrial", *sys.argv[1:]])
