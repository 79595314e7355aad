"""Options that several ident commands share, and displays of the progress of a command."""

from __future__ import annotations

import math
import re
import sys
import time
from collections.abc import Callable, Sequence
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from seatrial.daq.console import make_console
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import LOG
from seatrial.daq.options import Choice, ExistingPath, FiniteRange, output_option, print_json
from seatrial.ident.reporter import Reporter, StepLines

if TYPE_CHECKING:
    from rich.console import Console
    from rich.status import Status
    from rich.text import Text

    from seatrial.ident.results import Result

FOLDER = click.Path(file_okay=False, path_type=Path)
FILE = click.Path(dir_okay=False, path_type=Path)
SOURCE_FILE = ExistingPath(dir_okay=False)


class ModelPath(ExistingPath):
    """Type of an argument: a fitted model, given as model.toml, as its folder, or as the result.json beside it."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path of the model.toml: the path itself, the one in a folder, or the one beside a result.json.

        A folder or result.json without a model.toml is returned unchanged, so that the reader of the model reports it.
        A path that does not exist fails with click.BadParameter. So does a log, with the order of the arguments if the
        command takes logs too.
        """
        from seatrial.daq.log import is_log
        from seatrial.ident.estimation import model_file

        path = Path(str(super().convert(value, param, ctx)))
        if is_log(path):
            words = [] if ctx is None else [p.name for p in ctx.command.params if isinstance(p, click.Argument)]
            is_first = param is not None and "logs" in words and param.name in words
            order = "; the model comes first, then the logs" if is_first else ""
            self.fail(f"{path} is a log; give a model.toml or the folder of a fit{order}", param, ctx)
        return model_file(path)


MODEL = ModelPath()


class ModelSource(click.ParamType[str]):
    """Type of an argument: a fitted model as for `ModelPath`, the name of a built-in model, or FILE.py:NAME."""

    name = "model"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the text unchanged, or the path of the model.toml if the text is a folder or a result.json of a fit.

        The name of a built-in model or case stands for itself, even if there is a folder of this name; `./NAME` is the
        folder. Raise SeatrialError for a folder without a model.toml.
        """
        text = str(value)
        if not Path(text).exists():
            return text
        from seatrial.ident.estimation import model_source
        from seatrial.ident.models import BUILT_IN
        from seatrial.ident.studies import CASES

        return model_source(text, ("auto", *BUILT_IN, *CASES))


MODEL_SOURCE = ModelSource()


def _parse_finite(text: str) -> float:
    """Parse a finite number. Raise ValueError for any other text, also for ``nan`` and ``inf``."""
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
        Value by name; empty if the option is not given. A repeated name has its last value. The names are not checked.

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
            raise click.BadParameter(f"{item!r} is not NAME=NUMBER, such as m_u=30") from None
    return found


def parse_thruster_files(context: click.Context, parameter: click.Parameter, items: Sequence[str]) -> dict[str, Path]:
    """Parse the values of a repeatable option with a file, or NAME=FILE for one thruster (click callback).

    Parameters
    ----------
    items : sequence of str
        Texts, for example ``left=bench/model.toml``. A text that is the path of an existing file or folder is a path.
        Spaces around a name are ignored.

    Returns
    -------
    dict
        Path of the model.toml by name of the thruster; the name of a file without NAME is empty.

    Raises
    ------
    click.BadParameter
        If a file does not exist, if a name is blank, or if a thruster has two files.
    """
    found: dict[str, Path] = {}
    for item in items:
        name, sign, path = item.partition("=")
        if not sign or Path(item).exists():
            name, path = "", item
        elif not name.strip():
            raise click.BadParameter(f"{item!r} has no name of a thruster; write NAME=FILE, or FILE for all")
        name, path = name.strip(), path.strip() if sign and not Path(path).exists() else path
        if name in found:
            raise click.BadParameter(f"{name or 'all thrusters'}: two files; give each thruster one, as NAME=FILE")
        found[name] = MODEL.convert(path, parameter, context)
    return found


def parse_rates(context: click.Context, parameter: click.Parameter, items: Sequence[str]) -> dict[str, float]:
    """Parse the values of a repeatable SENSOR=HZ option (click callback).

    Parameters
    ----------
    items : sequence of str
        Texts, for example ``position=1``.

    Returns
    -------
    dict
        Rate [Hz] by sensor; empty if the option is not given. A repeated sensor has its last rate. The names are not
        checked.

    Raises
    ------
    click.BadParameter
        If a text is not NAME=NUMBER, or if a rate is not above zero.
    """
    found = parse_values(context, parameter, items)
    for name, rate in found.items():
        if rate <= 0.0:
            raise click.BadParameter(f"{name}={rate:g}: the rate has to be above 0 Hz")
    return found


def check_jobs(_context: click.Context, _parameter: click.Parameter, number: int | None) -> int | None:
    """Check the value of ``--jobs``, and return it (click callback).

    The value is a number of processes, or -1 for as many as the computer has cores. None, without the option, is
    returned unchanged.

    Raises
    ------
    click.BadParameter
        If it is 0 or below -1.
    """
    if number is not None and number < 1 and number != -1:
        raise click.BadParameter(f"{number} is not a number of processes; give 1 or more, or -1 (one for each core)")
    return number


def workers_options(f: Callable[..., Any], jobs: int | None = -1) -> Callable[..., Any]:
    """Decorate a command with ``--jobs``, ``--backend`` and ``--scheduler``: the processes that run its tasks.

    The command receives them as one argument ``workers`` (`Workers`).

    Parameters
    ----------
    f : callable
        The command.
    jobs : int or None
        Value of ``--jobs`` if it is not given: -1 for one process for each core; None for this process alone, and for
        one for each core on a cluster that is started on this computer.
    """

    @wraps(f)
    def command(*args: Any, jobs: int | None, backend: Any, scheduler: str, **rest: Any) -> Any:
        """Call the decorated command with ``workers`` in place of the three options."""
        from seatrial.ident.parallel import Workers

        return f(*args, workers=Workers(jobs, backend, scheduler), **rest)

    where = (
        "Address of the scheduler of a Dask cluster, or of the head of a Ray cluster, whose workers then do the work."
    )
    command = click.option("--scheduler", default="", metavar="ADDRESS", help=where)(command)
    command = click.option(
        "--backend",
        type=Choice(("loky", "dask", "ray")),
        default="loky",
        show_default=True,
        help="Processes of this computer, or a Dask or Ray cluster.",
    )(command)
    usual = "1; -1: one for each core" if jobs is None else "-1, one for each core"
    words = f"Number of processes on this computer.  [default: {usual}]"
    return click.option("--jobs", type=int, default=jobs, callback=check_jobs, help=words)(command)


def parse_names(_context: click.Context, _parameter: click.Parameter, text: str | None) -> tuple[str, ...]:
    """Parse the value ``NAME,NAME`` of an option to a tuple of names (click callback).

    Spaces around names, and empty names, are removed. None (no option) or an empty text gives an empty tuple.
    """
    return tuple(n.strip() for n in text.split(",") if n.strip()) if text else ()


def parse_priors(
    _context: click.Context, _parameter: click.Parameter, items: Sequence[str]
) -> dict[str, tuple[float, float]]:
    """Parse the values of a repeatable NAME=MEAN:SD option (click callback).

    Parameters
    ----------
    items : sequence of str
        Texts, for example ``m_u=30:5``.

    Returns
    -------
    dict
        (Mean, standard deviation) by name; empty if the option is not given. A repeated name has its last values.

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
            raise click.BadParameter(f"{item!r} is not NAME=MEAN:SD, such as m_u=30:2") from None
        if not sd > 0:
            raise click.BadParameter(f"{item!r}: SD in NAME=MEAN:SD, the standard deviation, has to be above 0")
        found[name] = (mean, sd)
    return found


def validate_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a command with the option ``--validate``: a log to validate the model on. The option may be repeated.

    The command receives the paths as the tuple ``validate``.
    """
    return click.option(
        "--validate", multiple=True, type=LOG, help="Validation log, not used by the fit; may be repeated."
    )(f)


def force_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a command with the flag ``--force``, which allows it to replace existing results.

    The command does not receive the flag; `check_output`, the callback of its ``--out``, reads it.
    """
    help_ = "Replace existing results."
    return click.option("--force", is_flag=True, expose_value=False, is_eager=True, callback=_store_force, help=help_)(
        f
    )


def _store_force(context: click.Context, _parameter: click.Parameter, force: bool) -> None:
    """Store the value of ``--force`` in the click context, where `check_output` reads it (click callback)."""
    context.meta["force"] = force


def check_output(context: click.Context, parameter: click.Parameter, out: Path | None) -> Path | None:
    """Check the file or folder ``out`` of ``--out``, and return it unchanged, also None (click callback).

    Raises
    ------
    SeatrialError
        If ``out`` is a file, or a folder with a result.json, and ``--force`` is not given; of a command with logs, an
        input that is no log is reported first. With or without ``--force``:
        if the option takes a file and its folder is a file;
        if ``out``, or a model.toml, result.json, result.parquet or report.html in it, is a symbolic link to a file or
        to nothing.
    """
    if out is not None:
        for path in (out, *(out / name for name in ("model.toml", "result.json", "result.parquet", "report.html"))):
            if path.is_symlink() and not path.is_dir():
                raise SeatrialError(
                    f"{path}: is a symbolic link, which outputs do not follow; remove it, or give another name"
                )
    exists = out is not None and (out.is_file() or (out / "result.json").exists())
    if exists and not context.meta["force"]:
        check_logs(context)  # a file that is no log makes no result, so that nothing is in the way of it
        raise SeatrialError(f"{out}: exists already; --force replaces it, or give another name")
    if out is not None and parameter.type is FILE:  # found before a long computation
        from seatrial.daq.files import require_parent

        require_parent(out)
    return out


def check_logs(context: click.Context) -> None:
    """Check that all files that a command takes as logs are logs (`require_logs`), before it opens the first of them.

    Raises
    ------
    SeatrialError
        If files are no logs. The error names all of them.
    """
    from seatrial.daq.log import require_logs

    given = [context.params.get(p.name or "") or () for p in context.command.params if p.type is LOG]
    require_logs(Path(path) for value in given for path in ((value,) if isinstance(value, Path) else value))


def out_option(default: str) -> Callable[..., Any]:
    """Return a decorator that adds ``--out`` (folder for the results) and ``--force`` to a command.

    The path is checked by `check_output`.

    Parameters
    ----------
    default : str
        Name of the folder if ``--out`` is not given.
    """
    words = "Folder for the results."
    option = output_option(FOLDER, words, default=Path(default), show_default=True, callback=check_output)
    return lambda f: option(force_option(f))


def resumed_out_option(default: str) -> Callable[..., Any]:
    """Return a decorator that adds ``--out`` (folder in which a run continues) and ``--force`` to a command.

    The command receives both, as ``out`` and ``force``.

    Parameters
    ----------
    default : str
        Name of the folder if ``--out`` is not given.
    """
    words = "Folder for the results; a run that was interrupted continues there."
    option = output_option(FOLDER, words, default=Path(default), show_default=True)
    force = click.option("--force", is_flag=True, help="Start again: replace the results in --out.")
    return lambda f: option(force(f))


def _trust_files(context: click.Context, _parameter: click.Parameter, trusted: bool) -> None:
    """Allow the Python files of users until the command ends, if ``--trust-code`` is given (click callback).

    The hashes of the files that are run are stored. Such a file may be run later without the option if two conditions
    are fulfilled: the model.toml contains its present hash, and the file is in the folder of this model.toml.
    """
    if trusted:
        from seatrial.ident.models import trusting_code

        context.with_resource(trusting_code())


def trust_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a command with the flag ``--trust-code``: run any Python file that a model.toml names.

    The command does not receive the flag, which takes effect while the command runs. A file that was run may be run
    later without the flag, if the model.toml contains its present hash and the file is in the folder of this
    model.toml.
    """
    words = (
        "Run the Python files that a model.toml names, even if they are new, changed or moved, and trust them later."
    )
    return click.option("--trust-code", is_flag=True, expose_value=False, callback=_trust_files, help=words)(f)


def despite_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a command with the flag ``--despite-faults``: continue although the checks of the logs find faults.

    The command receives it as ``despite_faults``.
    """
    words = "Continue if the checks of the logs find swapped sides, wrong units, frames or times (`seatrial check`)."
    return click.option("--despite-faults", is_flag=True, help=words)(f)


def rate_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a command with the option ``--rate``: rows of a record per second, 1 to 200 Hz, by default 10 Hz.

    The command receives it as ``rate``.
    """
    return click.option(
        "--rate",
        type=FiniteRange(1.0, 200.0),
        default=10.0,
        show_default=True,
        help="Rows per second; faster sensors are averaged.",
    )(f)


def horizon_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a command with the option ``--horizon``: the prediction horizon [s], 0.02 to 3600 s.

    If the option is not given, the command receives None, and uses the usual horizon of the kind of model: 10 s, or 1 s
    on the bench.
    """
    return click.option(
        "--horizon",
        "horizon",
        type=FiniteRange(0.02, 3600.0),
        metavar="SECONDS",
        help="Prediction horizon, in addition to one step and simulation.  [default: 10, on the bench 1]",
    )(f)


def robust_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a command with the flag ``--robust``: robust estimation with outliers in all sensors.

    The command receives it as ``outlier_model``, False without the flag.
    """
    words = "Robust estimation: allow outliers in all sensors, and count them."
    return click.option("--robust", "outlier_model", is_flag=True, help=words)(f)


def reml_option(default: bool | None = True) -> Callable[..., Any]:
    """Return a decorator that adds the option ``--reml/--no-reml`` to a command.

    The option selects restricted maximum likelihood for the noise parameters.

    Parameters
    ----------
    default : bool or None
        Value if the user does not give the option. If it is None, the command receives None, and uses the setting of
        the fit that it studies.
    """
    return click.option(
        "--reml/--no-reml",
        default=default,
        show_default=bool(default),
        help="Restricted maximum likelihood for noise, which corrects the bias from fitted dynamics.",
    )


def mean_order_option(default: bool | None = True) -> Callable[..., Any]:
    """Return a decorator that adds the option ``--second-order/--no-second-order`` to a command.

    The command receives the order of the Kalman filter, 2 or 1, as its parameter ``mean_order``.

    Parameters
    ----------
    default : bool or None
        Value if the user does not give the option. If it is None, ``mean_order`` is None, and the command uses the
        order of the fit that it studies.
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
    """Convert the flag ``--second-order`` to the order of the filter: True to 2, False to 1 (click callback).

    None is returned unchanged. It means that the option is not given and has no default.
    """
    return None if second is None else 2 if second else 1


def model_options(score_tests: bool = True, why: str = "", sides: bool = True) -> Callable[..., Any]:
    """Return a decorator that adds the options of the model of a boat and of its fit to a command.

    The command receives ``model``, ``thruster``, ``thrust_of``, ``fixed``, ``initial``, ``priors``, ``effects``,
    ``effects_file``, ``mass`` and ``score_tests``.

    Parameters
    ----------
    score_tests : bool
        Default of ``--score-tests``.
    why : str
        Reason for this default, which the help adds to the description; empty: none.
    sides : bool
        Whether the command has the option ``--thrust-of``.
    """
    words = f"{SCORE_TESTS} {why}".rstrip()

    def decorated(f: Callable[..., Any]) -> Callable[..., Any]:
        """Add the options to the command, so that its help lists them in their order."""
        f = click.option("--score-tests/--no-score-tests", default=score_tests, show_default=True, help=words)(f)
        for option in reversed(MODEL_OPTIONS):
            f = option(f) if sides or option is not thrust_of_option else f
        return f

    return decorated


SCORE_TESTS = (
    "Test the fit for missing effects: add the small errors of sensors and hull form if the logs show at least four, "
    "and widen the standard errors by what remains unexplained."
)


mass_option = click.option(
    "--mass",
    type=FiniteRange(0.0, min_open=True),
    help="Weighed mass of the boat in kg. A warning tells if the estimated mass in surge is below it or above 1.3 "
    "times it, both by more than two standard errors, or above twice it. It is no prior.  "
    "[default: `mass` in [vehicle] of the rig file, or in [geometry] of the import map]",
)


thrust_of_option = click.option(
    "--thrust-of",
    type=Choice(("left", "right", "both", "unknown")),
    help="Thruster that has the given thrust, if the thrusts of both sides differ; both: their mean has it. Masses, "
    "damping and their standard errors follow from it.  [default: unknown, or that of a model.toml]",
)


fix_option = click.option(
    "--fix",
    "fixed",
    multiple=True,
    callback=parse_values,
    help="NAME=VALUE: fix a known parameter, in SI units and radians; may be repeated. The thrust of one thruster "
    "at full command is c1 [N], the mean of ahead and astern; if only the thrust ahead is known, give it as c1 and "
    "leave c2 out.",
)
MODEL_OPTIONS = (
    click.option(
        "--model",
        type=MODEL_SOURCE,
        default="auto",
        show_default=True,
        help="horizontal:shaft, horizontal:command (held commands; shafts are states), horizontal:force, "
        "horizontal:general (each also with :no-current, or :random-walk-current), nomoto (no sideslip; the yaw rate "
        "follows the difference of the sides, without a lag unless --prior T=0.5:0.5 frees it; :sampled if the times "
        "of the outputs are uncertain, which is chosen automatically for an autopilot's outputs; and the same two "
        "options for the current), kinematic:shaft|force (measured attitude; :yaw adds the yaw equation; and the same "
        "two options for the current), surge:force|shaft:position|speed|both, yaw:rate|both, FILE.py:NAME for your "
        "own, or a model.toml (or the folder of a fit), whose structure and effects are fitted again.",
    ),
    click.option(
        "--thruster",
        type=MODEL,
        help="model.toml of the bench, or its folder: c1 and c2, or the static curve from command to thrust.",
    ),
    thrust_of_option,
    fix_option,
    click.option(
        "--initial",
        multiple=True,
        callback=parse_values,
        help="NAME=VALUE: initial value of a parameter, in SI units and radians; may be repeated.",
    ),
    click.option(
        "--prior",
        "priors",
        multiple=True,
        callback=parse_priors,
        help="NAME=MEAN:SD: prior of a parameter (mean, standard deviation), in SI units and radians; may be repeated.",
    ),
    click.option(
        "--effect",
        "effects",
        multiple=True,
        metavar="EFFECT",
        help="Add an effect of the catalogue, or of --effects, with free parameters (lever-arm, mount, ...); may be "
        "repeated.",
    ),
    click.option(
        "--effects",
        "effects_file",
        type=SOURCE_FILE,
        help="FILE.py with EFFECT or EFFECTS: add user-defined effects; all of them, or those that --effect names.",
    ),
    mass_option,
)
ESTIMATION = ("outlier_model", "reml", "mean_order", "method", "horizon")  # options of ``EstimationOptions``


def with_estimation_options(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options of a command, with those of the estimator collected in one entry ``estimation``.

    Parameters
    ----------
    options : dict
        Value of each option by name, as the command received it. It is not changed. The options of the estimator are
        those of `ESTIMATION`; any of them may be absent and then has its default.

    Returns
    -------
    dict
        All other options, and ``estimation`` (`EstimationOptions`).
    """
    from seatrial.ident.estimation import EstimationOptions

    shared = {n: v for n, v in options.items() if n in ESTIMATION}
    return {n: v for n, v in options.items() if n not in ESTIMATION} | {"estimation": EstimationOptions(**shared)}


class InputsFirst(click.Command):
    """Command that checks its output last, so that a wrong input is reported first, wherever ``--out`` stands.

    Files that are no logs are an error before the command runs (`check_logs`).
    """

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the words of the command line, and check that the logs among them are logs."""
        rest = super().parse_args(ctx, args)
        if not ctx.resilient_parsing:  # of the completion of a shell
            check_logs(ctx)
        return rest

    def make_parser(self, ctx: click.Context) -> Any:
        """Return the parser of click, whose order of the given parameters lacks the output."""
        parser = super().make_parser(ctx)
        parse = parser.parse_args

        def parse_inputs_first(args: list[str]) -> Any:
            """Return values, remaining words, and given parameters in order. A parameter not in it is checked last."""
            values, rest, order = parse(args=args)
            return values, rest, [parameter for parameter in order if parameter.name != "out"]

        vars(parser)["parse_args"] = parse_inputs_first
        return parser


# Words for the evaluation of a model on unseen logs, which users try in place of `seatrial ident compare`.
EVALUATE = ("evaluate", "evaluation", "validate", "validation", "test", "predict", "prediction")
EVALUATION_HINT = "To evaluate a model on a log: `seatrial ident compare MODEL --on LOG`"


class InputsFirstGroup(click.Group):
    """Group whose commands check their output last."""

    command_class = InputsFirst

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return name, command and arguments for the words after the group's name, as the method of click does.

        It is a usage error if there is no such command. The message for a word that means an evaluation (`EVALUATE`)
        says how to evaluate a model.
        """
        if args[0] in EVALUATE and args[0] not in self.commands:
            raise click.UsageError(f"No such command {args[0]!r}. {EVALUATION_HINT}", ctx)
        return super().resolve_command(ctx, args)


class GatheringCommand(InputsFirst):
    """Command whose options in `GATHERED` take all words up to the next option, so that a shell may expand ``*.mcap``.

    The command has no arguments: every word belongs to an option.
    """

    GATHERED = ("--before", "--after")

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the words of the command line, after the option's name is repeated before each of its words."""
        spread, gathering = list[str](), ""
        for word in args:
            if word.startswith("-"):
                name, sign, _ = word.partition("=")
                gathering = name if name in self.GATHERED else ""
                if not gathering or sign:
                    spread.append(word)
            else:
                spread += [gathering, word] if gathering else [word]
        return super().parse_args(ctx, spread)


class LineReporter:
    """Reporter that prints progress and warnings of a computation, one line each, without a live display.

    Parameters
    ----------
    err
        Whether to print to standard error instead of standard output.
    """

    def __init__(self, err: bool = False) -> None:
        """Choose the stream: standard error if ``err``, otherwise standard output."""
        self.err, self._lines = err, StepLines()

    def progress(self, text: str, times: Callable[[], str] | None = None) -> None:
        """Print the text on a line, indented by two spaces, after the time so far if ``times`` returns it."""
        click.echo(f"  {self._lines.start(text, times)}", err=self.err)

    def detail(self, text: str) -> None:
        """Print the step and the text on a line, if the last line of progress was printed at least 30 s ago."""
        if line := self._lines.detail(text):
            click.echo(f"  {line}", err=self.err)

    def warning(self, text: str) -> None:
        """Print the text on a line, indented by two spaces."""
        click.echo(f"  {text}", err=self.err)


class SpacedLines(LineReporter):
    """Reporter that prints progress to standard error: at most one line of a kind in two seconds.

    Lines are of one kind if they differ in their numbers only. A search reports hundreds of them.
    """

    SPACING_S = 2.0

    def __init__(self) -> None:
        """Begin without a line."""
        super().__init__(err=True)
        self._kind, self._printed = "", -math.inf

    def progress(self, text: str, times: Callable[[], str] | None = None) -> None:
        """Print the text, unless a line of its kind was printed in the last two seconds."""
        kind, now = re.sub(r"\d[\d.e+-]*", "0", text), time.monotonic()
        if kind != self._kind or now - self._printed >= self.SPACING_S:
            self._kind, self._printed = kind, now
            super().progress(text, times)


class LiveLine:
    """Reporter that shows progress in one live line of a terminal, and prints warnings above it.

    Parameters
    ----------
    console
        Console of the terminal.
    status
        Live line of this console.
    """

    def __init__(self, console: Console, status: Status) -> None:
        """Store the console and its live line, which the caller starts and stops."""
        self.console, self.status, self._lines = console, status, StepLines()

    def progress(self, text: str, times: Callable[[], str] | None = None) -> None:
        """Replace the text of the live line. The times before it go on while the step lasts."""
        self._lines.start(text, times)
        self.status.update(self)

    def detail(self, text: str) -> None:
        """Show the text in the live line, after that of the present step."""
        self._lines.detail(text)
        self.status.update(self)

    def __rich__(self) -> Text:
        """Return the present text, cut to one line, since a line that wraps cannot be rewritten in place."""
        from rich.text import Text

        return Text(self._lines.line(), no_wrap=True, overflow="ellipsis")

    def warning(self, text: str) -> None:
        """Print the text above the live line, where it stays."""
        self.console.print(f"  {text}", markup=False)


def run_workflow(work: Callable[[Reporter], Result], out: Path, as_json: bool) -> None:
    """Run the computation of a command with a display of its progress, then print its result.

    The progress is a live line on a terminal, and otherwise one line per step on standard output. The path of the
    report is printed after the result.

    Parameters
    ----------
    work : callable
        Function of a reporter that computes, writes the files of the result, and returns the result.
    out : Path
        Folder with report.html, for the message.
    as_json : bool
        Whether to print the result as JSON without its traces, and progress and message on standard error.

    Raises
    ------
    SeatrialError
        If ``work`` raises it, or raises ValueError or KeyError. Other errors are not caught.
    click.exceptions.Exit
        With the exit status 1, after printing, if the result is a fit that did not converge.
    """
    console = make_console(stderr=as_json)
    try:
        if console.is_terminal:
            with console.status("reading logs") as status:
                result = work(LiveLine(console, status))
        else:
            result = work(LineReporter(err=as_json))
    except (ValueError, KeyError) as problem:
        raise SeatrialError(str(problem).strip("'\"")) from problem
    from seatrial.ident.results import FitResult

    if as_json:
        print_result_json(result)
    else:
        from seatrial.ident.report import print_result

        print_result(result, console)
    click.echo(f"report: {out / 'report.html'}", err=as_json)
    if isinstance(result, FitResult) and not result.converged:
        raise click.exceptions.Exit(1)


def print_result_json(result: Result) -> None:
    """Print a result as JSON on standard output: the document of result.json without its traces."""
    from seatrial.ident.results import to_json

    print_json(to_json(result, traces=False))


def command_line() -> str:
    """Return the command line of this process as text that begins with ``seatrial``, for the provenance of a result.

    The arguments are those of ``sys.argv`` after the first, joined by spaces, without quotes.
    """
    return " ".join(["seatrial", *sys.argv[1:]])
