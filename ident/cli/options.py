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
FOLDER = click.Path(file_okay=False, path_type=Path)
FILE = click.Path(dir_okay=False, path_type=Path)


class ModelPath(click.Path):
    """Type of a fitted model in a command line: a model.toml, or a folder that contains one.

    Another folder is returned as it is, because the error of the reader is clearer.
    """

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path of the model.toml."""
        from seatrial.ident.estimation import model_file

        return model_file(Path(str(super().convert(value, param, ctx))))


MODEL = ModelPath(exists=True, path_type=Path)


def _parse_finite(text: str) -> float:
    """Parse a finite number; raise ValueError for any other text, also for ``nan`` and ``inf``."""
    number = float(text)
    if not math.isfinite(number):
        raise ValueError
    return number


def parse_values(_context: click.Context, _parameter: click.Parameter, items: Sequence[str]) -> dict[str, float]:
    """Parse the values of a repeatable NAME=VALUE option (click callback).

    Parameters
    ----------
    items : sequence of str
        Texts, for example ``m_u=30``.

    Returns
    -------
    dict
        Value by name. A repeated name has its last value.

    Raises
    ------
    click.BadParameter
        If a text is not NAME=NUMBER with a finite number.
    """
    found = {}
    for item in items:
        name, _, value = item.partition("=")
        try:
            found[name] = _parse_finite(value)
        except ValueError:
            raise click.BadParameter(f"{item!r} is not NAME=NUMBER") from None
    return found


def parse_rates(context: click.Context, parameter: click.Parameter, items: Sequence[str]) -> dict[str, float]:
    """Parse the values of a repeatable SENSOR=HZ option (click callback).

    Returns
    -------
    dict
        Rate [Hz] by sensor.

    Raises
    ------
    click.BadParameter
        If a text is not NAME=NUMBER, or if a rate is not above zero.
    """
    found = parse_values(context, parameter, items)
    for name, rate in found.items():
        if rate <= 0.0:
            raise click.BadParameter(f"{name}={rate:g} is not above 0 Hz")
    return found


def check_jobs(_context: click.Context, _parameter: click.Parameter, number: int) -> int:
    """Check and return the value of ``--jobs``: a number of processes, or -1 for one for each core (click callback).

    Raises
    ------
    click.BadParameter
        If it is 0 or below -1.
    """
    if number < 1 and number != -1:
        raise click.BadParameter(f"{number} is neither a number of processes nor -1 (one for each core)")
    return number


def parse_names(_context: click.Context, _parameter: click.Parameter, text: str | None) -> tuple[str, ...]:
    """Parse the names of a NAME,NAME option (click callback). No text or an empty text gives an empty tuple."""
    return tuple(n.strip() for n in text.split(",") if n.strip()) if text else ()


def parse_priors(
    _context: click.Context, _parameter: click.Parameter, items: Sequence[str]
) -> dict[str, tuple[float, float]]:
    """Parse the values of a repeatable NAME=MEAN:SD option (click callback).

    Returns
    -------
    dict
        Mean and standard deviation by name. A repeated name has its last values.

    Raises
    ------
    click.BadParameter
        If a text has another form, or if a standard deviation is not positive.
    """
    found = {}
    for item in items:
        name, _, value = item.partition("=")
        try:
            mean, sd = (_parse_finite(part) for part in value.split(":"))
        except ValueError:
            raise click.BadParameter(f"{item!r} is not NAME=MEAN:SD") from None
        if not sd > 0:
            raise click.BadParameter(f"{item!r}: SD in NAME=MEAN:SD, the standard deviation, has to be above 0")
        found[name] = (mean, sd)
    return found


def validate_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--validate``, which may be repeated, to a command."""
    return click.option(
        "--validate", multiple=True, type=LOG, help="Validation log, not used by the fit; may be repeated."
    )(f)


def window_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--from`` and ``--to`` [s of the log] to a command, which receives them as one ``window`` (TimeWindow).

    By default the window is the whole log. The command raises click.BadParameter if the end is not after the start.
    """

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
    """Add the flag ``--force`` to a command, which does not receive it; `check_output` reads its value."""
    help_ = "Replace existing results."
    return click.option("--force", is_flag=True, expose_value=False, is_eager=True, callback=_store_force, help=help_)(
        f
    )


def _store_force(context: click.Context, _parameter: click.Parameter, force: bool) -> None:
    """Store the value of ``--force`` in the context for `check_output` (click callback)."""
    context.meta["force"] = force


def check_output(context: click.Context, _parameter: click.Parameter, out: Path | None) -> Path | None:
    """Check and return the file or folder of ``--out`` (click callback). None is returned unchanged.

    Raises
    ------
    SeatrialError
        If it exists already (as a file, or as a folder with a result.json) and ``--force`` was not given, or if it or a
        result file in it is a symbolic link.
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
    """Return a decorator that adds ``--out`` and ``--force`` to a command.

    Parameters
    ----------
    default : str
        Name of the default folder.
    """
    words = "Folder for the results."
    how: dict[str, Any] = {"type": FOLDER, "default": Path(default), "show_default": True, "help": words}
    return lambda f: click.option("--out", callback=check_output, **how)(force_option(f))


def _trust_files(context: click.Context, _parameter: click.Parameter, trusted: bool) -> None:
    """Trust user-defined Python files until the command ends, if ``--trust-code`` is given (click callback)."""
    if trusted:
        from seatrial.ident.models import trusting_code

        context.with_resource(trusting_code())


def trust_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Add the flag ``--trust-code`` to a command, which does not receive it."""
    words = (
        "Run the Python files that a model.toml names, even if they are new, changed or moved, and trust them later."
    )
    return click.option("--trust-code", is_flag=True, expose_value=False, callback=_trust_files, help=words)(f)


def despite_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Add the flag ``--despite-faults`` to a command, which receives it as ``despite_faults``."""
    words = "Continue if the checks of the logs find swapped sides, wrong units, frames or times (`seatrial check`)."
    return click.option("--despite-faults", is_flag=True, help=words)(f)


def rate_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--rate`` [Hz] to a command: rows of a record per second, 1 to 200, by default 10."""
    return click.option(
        "--rate",
        type=FiniteRange(1.0, 200.0),
        default=10.0,
        show_default=True,
        help="Rows per second; faster sensors are averaged.",
    )(f)


def horizon_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Add the option ``--horizon`` [s] to a command.

    A command without the option receives None and uses the horizon of the model.
    """
    return click.option(
        "--horizon",
        "horizon",
        type=FiniteRange(0.02, 3600.0),
        metavar="SECONDS",
        help="Prediction horizon, in addition to one step and simulation.  [default: 10, on the bench 1]",
    )(f)


def robust_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Add the flag ``--robust`` to a command, which receives it as ``outlier_model``."""
    words = "Robust estimation: allow outliers in all sensors, and count them."
    return click.option("--robust", "outlier_model", is_flag=True, help=words)(f)


def reml_option(default: bool | None = True) -> Callable[..., Any]:
    """Return the option ``--reml/--no-reml`` as a decorator.

    Parameters
    ----------
    default : bool or None
        Value if the option is not given. None: the command uses the setting of the fit that it studies.
    """
    return click.option(
        "--reml/--no-reml",
        default=default,
        show_default=bool(default),
        help="Restricted maximum likelihood for noise, which corrects the bias from fitted dynamics.",
    )


def mean_order_option(default: bool | None = True) -> Callable[..., Any]:
    """Return the option ``--second-order/--no-second-order`` as a decorator.

    The command receives ``mean_order``: 2 for a second-order filter, 1 for a first-order filter.

    Parameters
    ----------
    default : bool or None
        Value if the option is not given. With None the command receives None, and uses the setting of the fit that it
        studies.
    """
    return click.option(
        "--second-order/--no-second-order",
        "mean_order",
        default=default,
        callback=_parse_mean_order,
        show_default=bool(default),
        help="Second-order EKF: the mean includes the curvature of drag, with less bias.",
    )


def _parse_mean_order(
    _context: click.Context, _parameter: click.Parameter, second: bool | None
) -> Literal[1, 2] | None:
    """Convert the flag ``--second-order`` to the order of the filter, 2 or 1 (click callback).

    If the flag was not given and has no default, ``second`` is None, and the function returns None.
    """
    return None if second is None else 2 if second else 1


ESTIMATION = ("outlier_model", "reml", "mean_order", "method", "horizon")  # options of ``EstimationOptions``


def with_estimation_options(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options of a command, with those of the estimator combined as ``estimation``.

    Parameters
    ----------
    options : dict
        Value of each option by name, as the command received it. It is not changed.
    """
    from seatrial.ident.estimation import EstimationOptions

    shared = {n: v for n, v in options.items() if n in ESTIMATION}
    return {n: v for n, v in options.items() if n not in ESTIMATION} | {"estimation": EstimationOptions(**shared)}


class Lines:
    """Reporter that prints each line of progress and each warning.

    Parameters
    ----------
    err
        Whether to print to standard error, not to standard output.
    """

    def __init__(self, err: bool = False) -> None:
        self.err = err

    def progress(self, text: str) -> None:
        click.echo(f"  {text}", err=self.err)

    def warning(self, text: str) -> None:
        click.echo(f"  {text}", err=self.err)


class LiveLine:
    """Reporter that shows progress in one live line of a terminal, and prints warnings above it.

    Parameters
    ----------
    console
        Console of the terminal.
    status
        Its live line.
    """

    def __init__(self, console: Console, status: Status) -> None:
        self.console, self.status = console, status

    def progress(self, text: str) -> None:
        self.status.update(text)

    def warning(self, text: str) -> None:
        self.console.print(f"  {text}", markup=False)


def run_workflow(work: Callable[[Reporter], Result], out: Path) -> None:
    """Run a workflow with a display of its progress, then print the result and the path of the report.

    The exit status is 1 if the result is a fit that did not converge.

    Parameters
    ----------
    work : callable
        Workflow: receives a reporter, returns the result and writes its files.
    out : Path
        Folder with the report, for the message.

    Raises
    ------
    SeatrialError
        If the workflow raises it, or raises ValueError or KeyError.
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
