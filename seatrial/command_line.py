"""Command line of seatrial: the tree of commands and the handling of errors.

A part is imported only when one of its commands runs, so `seatrial --help` is fast. Errors of all commands are handled
here: the user sees one line on stderr, and the process returns an exit status.

Parts that must not import each other are connected here: commands of one part in the group of another (`ATTACHED`),
and checks of ident for `seatrial check` (`MotionChecksOfIdent`).
"""

from __future__ import annotations

import re
import sys

try:
    import errno
    import importlib
    import os
    import threading
    import traceback
    import warnings
    from collections.abc import Callable, Iterator, Sequence
    from contextlib import contextmanager
    from functools import cached_property
    from pathlib import Path
    from typing import TYPE_CHECKING, Any, NamedTuple

    import click
    from click.shell_completion import CompletionItem

    from seatrial.daq import bounds
    from seatrial.daq.errors import SeatrialError, SeatrialWarning, closest_name, first_names, printable
except KeyboardInterrupt:  # Ctrl-C during the imports, before a command can handle it
    sys.stderr.write("\nseatrial: interrupted\n")
    raise SystemExit(130) from None

# All matrices are small, so threads of the linear algebra library would only wait for each other. They would also
# delay the start of every process by 0.1 s. The variables must be set before the import of numpy. Child processes
# inherit them.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

if TYPE_CHECKING:
    from seatrial.bench.preflight.report import MotionChecks
    from seatrial.daq.checks.check_report import CheckReport
    from seatrial.daq.checks.findings import Finding
    from seatrial.daq.log import TimeWindow
    from seatrial.ident.checks.log_checks import LogChecks

WAITING = "ROS 2"  # name of a thread in seatrial.daq.tools.ros_live that may wait for a connection without an end
OK, FAILED, WRONG_USAGE, HUNG_UP, INTERRUPTED = 0, 1, 2, 129, 130


class Row(NamedTuple):
    """Command of `seatrial` in the table COMMANDS, from which the help is written without an import of the command.

    Attributes
    ----------
    target
        Place of the click command in the code, `module:attribute`.
    short_help
        Text beside the name of the command in `seatrial --help`.
    """

    target: str
    short_help: str


COMMANDS = {
    "demo": Row("seatrial.bench.demo:demo", "Run the whole workflow on simulated devices."),
    "init": Row("seatrial.daq.new_rig.cli:init", "Write a rig file and a checklist for a boat or bench."),
    "devices": Row("seatrial.daq.cli:devices", "Find ports and identify the devices there."),
    "log": Row("seatrial.daq.cli:log", "Acquire until Ctrl-C, with a live table."),
    "check": Row("seatrial.bench.preflight.cli:check", "Check a rig before a run, or check a log."),
    "bench": Row("seatrial.bench.cli:bench", "Characterise thrusters: static, steps, chirp, all."),
    "mission": Row("seatrial.bench.cli:mission", "Design, make, show and run missions."),
    "import": Row("seatrial.daq.cli:import_", "Convert logs of other software to MCAP."),
    "export": Row("seatrial.daq.cli:export", "Write a log as CSV, Parquet, MATLAB, NetCDF or a bag of ROS 2."),
    "info": Row("seatrial.daq.cli:info", "Show the content of a log."),
    "view": Row("seatrial.daq.cli:view", "Show logs as a page in the browser, and cut them."),
    "recover": Row("seatrial.daq.cli:recover", "Recover the log of a killed run."),
    "replay": Row("seatrial.daq.cli:replay", "Send the raw bytes of a log again on ports."),
    "ident": Row("seatrial.ident.cli.commands:ident", "Fit and explain: noise, thruster, vehicle, diagnose, ..."),
    "mock": Row("seatrial.mocks.cli:mock", "Simulate the devices of a rig: a boat or a bench."),
}
# Modules that belong to each extra of the installation (pyproject.toml).
EXTRAS = {
    "ident": ("casadi", "jinja2", "joblib", "llvmlite", "platformdirs", "scipy"),
    "mavlink": ("pymavlink",),
    "parquet": ("pyarrow",),
}
# Commands that belong to the group of another part. They are attached here, since the parts do not import each other.
ATTACHED = {"mission": {"design": "seatrial.ident.cli.commands:design"}}
# Commands that are groups. Only the hint about an unknown command imports them all.
GROUPS = ("bench", "mission", "import", "ident", "mock")
# Words that users try in place of a command.
SYNONYMS = {
    "fit": "ident vehicle", "identify": "ident vehicle", "diagnosis": "ident diagnose", "record": "log", "plot": "view",
    **dict.fromkeys(("evaluate", "validate", "test", "predict"), "ident compare MODEL --on LOG"),
}  # fmt: skip


class LazyGroup(click.Group):
    """Group of the commands of `seatrial`, which imports a command only when it is used.

    Help and completion are written from the table COMMANDS, without imports.
    """

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all commands of `seatrial`, in the order of the help. No part is imported."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the command of `seatrial` with a name, and return it; None if there is no such command.

        Sub-commands of another part (table ATTACHED) are added to it. SeatrialError is raised if the command, or a
        library that it needs, is not installed.
        """
        row = COMMANDS.get(cmd_name)
        if row is None:
            return None
        command = _load_command(cmd_name, row.target)
        for name, target in ATTACHED.get(cmd_name, {}).items():
            if isinstance(command, click.Group) and name not in command.commands:
                command.add_command(_load_command(f"{cmd_name} {name}", target), name)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return name, command and arguments for the words after `seatrial`, as the method of click does.

        Raises
        ------
        click.UsageError
            If there is no such command, with the command that was probably meant: the command of a group with this
            name, or the one that is spelt most similarly.
        """
        name = args[0]
        if name not in COMMANDS and not name.startswith("-"):
            meant = self._meant(ctx, name)
            hint = f". Did you mean {' or '.join(repr(x) for x in meant)}?" if meant else ""
            raise click.UsageError(f"No such command {name!r}{hint}", ctx)
        return super().resolve_command(ctx, args)

    def _meant(self, ctx: click.Context, name: str) -> list[str]:
        """Return the commands that a user may have meant by an unknown name; an empty list if none is similar.

        A command of a group, such as `vehicle`, is returned as ``seatrial ident vehicle``, and a command of `seatrial`
        by its name alone. The groups are imported. One that is not installed is left out.
        """
        if name in SYNONYMS:
            return [f"seatrial {SYNONYMS[name]}"]
        places: dict[str, list[str]] = {}
        for group in GROUPS:
            for path in self._commands_of(ctx, group):
                if path.count(" ") == 2:
                    places.setdefault(path.rpartition(" ")[2], []).append(path)
        if name in places:
            return places[name]
        near = closest_name(name, COMMANDS)
        return [near] if near else places.get(closest_name(name, places) or "", [])

    def _commands_of(self, ctx: click.Context, name: str) -> dict[str, click.Command]:
        """Return a command of `seatrial` by its path, such as ``seatrial ident``, and the commands below it.

        The result is empty if the command is not installed.
        """
        try:
            command = self.get_command(ctx, name)
        except SeatrialError:
            return {}
        found = {} if command is None else {f"seatrial {name}": command}
        below = command.commands if isinstance(command, click.Group) else {}
        return found | {f"seatrial {name} {sub}": c for sub, c in below.items()}

    def with_option(self, ctx: click.Context, option: str) -> list[str]:
        """Return the paths of the commands that have an option; all commands are imported.

        Parameters
        ----------
        ctx
            Context of the command line without this option. The commands of its own group come first.
        option
            The option as the user wrote it, such as ``--jobs``.
        """
        found = [
            path
            for name in COMMANDS
            for path, command in self._commands_of(ctx, name).items()
            if any(option in (*p.opts, *p.secondary_opts) for p in command.params if isinstance(p, click.Option))
        ]
        group = ctx.command_path.rpartition(" ")[0]
        return sorted(found, key=lambda path: path.rpartition(" ")[0] != group)

    def with_choice(self, ctx: click.Context, option: str, value: str) -> list[str]:
        """Return the paths of the commands of the same name that have a value among the choices of an option.

        All commands are imported.

        Parameters
        ----------
        ctx
            Context of the command, such as that of `seatrial export`. `seatrial ident export` has the same name.
        option, value
            The option and its value as the user wrote them, such as ``--to`` and ``fmu``.
        """
        name = ctx.command_path.rpartition(" ")[2]
        return [
            path
            for group in COMMANDS
            for path, command in self._commands_of(ctx, group).items()
            if path.rpartition(" ")[2] == name and path != ctx.command_path
            for p in command.params
            if option in p.opts and isinstance(p.type, click.Choice) and value in p.type.choices
        ]

    def invoke(self, ctx: click.Context) -> None:
        """Run the command and discard its return value, since only `ctx.exit(status)` may set the exit status.

        Errors of the command are passed on.
        """
        super().invoke(ctx)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Return the completions of an incomplete word in the shell: commands and options of `seatrial`.

        They are taken from the table of commands. The method of click would import every part.
        """
        names = [
            CompletionItem(name, help=row.short_help) for name, row in COMMANDS.items() if name.startswith(incomplete)
        ]
        return names + click.Command.shell_complete(self, ctx, incomplete)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands for `seatrial --help`, from the table of commands.

        The method of click would import every part.
        """
        with formatter.section("Commands"):
            formatter.write_dl([(name, row.short_help) for name, row in COMMANDS.items()])


def _missing_module_message(subject: str, missing: str) -> str:
    """Return the message about a library that is not installed, with the extra that installs it.

    `subject` is the command or function that needs it, in words, and `missing` is the full name of the module. A module
    of no known extra gives the extra "all".
    """
    extra = next((extra for extra, modules in EXTRAS.items() if missing.partition(".")[0] in modules), "all")
    return f"{subject} needs the Python module {missing}, which is not installed: pip install 'seatrial[{extra}]'"


def _load_command(name: str, target: str) -> click.Command:
    """Import the command at `target`, which is `module:attribute`, and return it.

    `name` is the command as the user writes it, for the message. SeatrialError is raised if this installation does not
    have the command or a library that it needs.
    """
    module_name, attribute = target.split(":")
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        missing = error.name or module_name
        if f"{module_name}.".startswith(f"{missing}."):
            raise SeatrialError(
                f"`{name}` is not part of this installation (no module {missing}); uninstall seatrial, and install it "
                "again"
            ) from error
        raise SeatrialError(_missing_module_message(f"`{name}`", missing)) from error
    command = getattr(module, attribute, None)
    if not isinstance(command, click.Command):
        raise SeatrialError(
            f"`{name}` is not part of this installation (no command {target}); uninstall seatrial, and install it again"
        )
    return command


@contextmanager
def _installed_for(subject: str) -> Iterator[None]:
    """Context of an import that raises SeatrialError if a module is not installed, with the extra that installs it.

    `subject` is the function that needs it, in words.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise SeatrialError(_missing_module_message(subject, error.name or "ident")) from error


class MotionChecksOfIdent:
    """The steps of `seatrial check` that need `seatrial.ident`, which is imported when one of them is called.

    The command is in `seatrial.bench`, which must not import `seatrial.ident`; it gets this object instead.
    Its methods raise SeatrialError if ident or one of its libraries is not installed.
    """

    @cached_property
    def _checks(self) -> LogChecks:
        """Checks of the logs of this command."""
        with _installed_for("the check of the motion"):
            from seatrial.ident.checks.log_checks import LogChecks
        return LogChecks()

    def check_log(self, path: Path, window: TimeWindow) -> list[Finding]:
        """Return findings about sensors and thrusters from the motion in an interval of time of the log `path`."""
        return self._checks.check(path, window)

    def differences(self) -> list[tuple[str, Finding]]:
        """Return findings on the checked logs together, each with the name of its log or the number of logs."""
        return self._checks.differences()

    def write_check_page(self, report: CheckReport, out: Path) -> None:
        """Write the HTML page of a check to the file ``out``. The page contains the command line of this process."""
        with _installed_for("--report"):
            from seatrial.ident.workflows.check import write_check
        write_check(report, " ".join(["seatrial", *sys.argv[1:]]), out)


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="seatrial", message="seatrial %(version)s")
@click.option(
    "--debug", is_flag=True, help="Show the traceback of an error. The option may be anywhere in the command line."
)
@click.pass_context
def cli(context: click.Context, debug: bool) -> None:
    """Measure a boat and its thrusters, excite them, and explain what was measured."""
    # `debug` is not used: `main` removes --debug from the command line, and the option here is only for the help.
    motion: MotionChecks = MotionChecksOfIdent()
    context.obj = motion


def _line_and_status(error: BaseException) -> tuple[str, int]:
    """Return the line for stderr and the exit status of the process, for an error that has ended a command.

    A SeatrialError gives its own message and status, Ctrl-C gives 130, and a closed terminal 129. A passed limit of a
    bounded command comes before all of these; it gives 1, as do an OSError with the name of a file, a missing module
    and a MemoryError, each with a message of its own. Any other exception is an internal error with status 1. The line
    contains no line end and no control characters. Nothing is printed here. Errors of wrong usage are not handled here
    but by `_usage_line`.
    """
    if limit := bounds.limit_message(error):
        line, status = limit, FAILED
    elif isinstance(error, SeatrialError):
        line, status = str(error), error.exit_status
    elif isinstance(error, (KeyboardInterrupt, click.Abort)):
        line, status = "interrupted", INTERRUPTED
    elif isinstance(error, OSError) and error.errno == errno.EIO and error.filename is None:
        line, status = "the terminal was closed", HUNG_UP
    elif isinstance(error, OSError) and error.filename is not None:
        advice = "check its path, its permissions and the space on the disk"
        line, status = f"{error.filename}: {error.strerror}; {advice}", FAILED
    elif isinstance(error, ModuleNotFoundError) and error.name:
        line, status = _missing_module_message("this command", error.name), FAILED
    elif isinstance(error, MemoryError):
        line, status = "the memory of this computer is not enough: give fewer or shorter logs", FAILED
    else:
        line = f"internal error ({type(error).__name__}: {error}); run again with --debug to see where, and report it"
        status = FAILED
    return printable(" ".join(line.split())), status


def _usage_line(error: click.UsageError) -> str:
    """Return the line for stderr about a wrong command line: the command, the problem, and the command for its help.

    An unknown option that other commands have comes with their names, in place of options that are spelt similarly. So
    does an invalid value of an option that a command of the same name in another group has.
    Line ends become spaces, and control characters become escape sequences. Nothing is printed here.
    """
    path = "seatrial" if error.ctx is None else error.ctx.command_path
    text = printable(" ".join(error.format_message().split()).rstrip("."))
    if isinstance(error, click.NoSuchOption) and error.ctx is not None:
        others = [f"`{other}`" for other in cli.with_option(error.ctx, error.option_name)]
        if others:
            verb = "has" if len(others) == 1 else "have"
            text = f"No such option {printable(error.option_name)!r}; {first_names(others, 3)} {verb} it"
    refused = re.match(r"Invalid value for '(--[\w-]+)'[^:]*: '(.*)' is not ", text)
    if refused and error.ctx is not None and (meant := cli.with_choice(error.ctx, *refused.groups())):
        text += f"; `{meant[0]} {refused[1]} {refused[2]}` has it"
    return f"{path}: {text}{'' if text.endswith('?') else ';'} `{path} --help` shows how"


def _warning_printer(default: Callable[..., None]) -> Callable[..., None]:
    """Return a function for `warnings.showwarning` that prints a SeatrialWarning as one line on stderr.

    The line does not contain the position of the warning in the code. All other warnings are passed to ``default``, the
    function of Python that prints them.
    """

    def show(message: Warning | str, category: type[Warning], *args: Any, **kwargs: Any) -> None:
        """Print a SeatrialWarning as one line on stderr; pass any other warning to the default of Python."""
        if issubclass(category, SeatrialWarning):
            print(f"seatrial: {printable(str(message))}", file=sys.stderr)
        else:
            default(message, category, *args, **kwargs)

    return show


def _run_command_line(args: Sequence[str]) -> int:
    """Run one command line, such as ["info", "run.mcap"], and return its exit status.

    The status is 0 unless the command sets another. Wrong usage is reported on stderr and gives status 2. Other errors
    of click become SeatrialError. All other exceptions of the command are passed on.
    """
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warning_printer(warnings.showwarning)
            result = cli.main(args=list(args), prog_name="seatrial", standalone_mode=False)
        sys.stdout.flush()
    except click.ClickException as error:  # the status is 2 for a UsageError and 1 for other errors of click
        if isinstance(error, click.exceptions.NoArgsIsHelpError):
            error.show()
            return WRONG_USAGE
        if isinstance(error, click.UsageError):
            print(_usage_line(error), file=sys.stderr)
            return WRONG_USAGE
        raise SeatrialError(error.format_message()) from error
    return OK if result is None else int(result)  # a number here is the status of `ctx.exit(status)`


def main(args: Sequence[str] | None = None) -> None:
    """Run the command line and exit the process with its status. This function does not return.

    The status is 0 if the command succeeds, 1 if it fails, 2 for wrong usage, 3 for a stop by a safety limit, 129 if
    the terminal was closed and 130 after Ctrl-C. An error is printed to stderr as one line; with `--debug` anywhere
    before `--` its traceback comes first. If the reader of stdout has ended (`| head`), the status is 1 and nothing is
    printed.

    Parameters
    ----------
    args : sequence of str, optional
        Words of the command line after `seatrial`; without it those of this process. The limits for files
        (`seatrial.daq.bounds`) apply only without it.
    """
    words = list(sys.argv[1:] if args is None else args)
    if args is None:
        bounds.enable()
        # Child processes that a library starts (joblib) must not import modules from the working folder. The child
        # processes of seatrial get the option `-P` for this. A program that calls this function keeps its environment.
        os.environ.setdefault("PYTHONSAFEPATH", "1")
    # Users add --debug at the end of a command line that failed, so it is accepted anywhere before a `--`.
    own = words[: words.index("--")] if "--" in words else words
    debug = "--debug" in own
    words = [word for word in own if word != "--debug"] + words[len(own) :]
    try:
        status = _run_command_line(words)
    except BrokenPipeError:
        # The reader of stdout has ended (`| head`). Without the redirection the last flush of the interpreter would
        # print an error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = FAILED
    except (Exception, KeyboardInterrupt) as error:
        if debug:
            traceback.print_exc()
        line, status = _line_and_status(error)
        try:
            print(f"seatrial: {line}", file=sys.stderr)
            if detail := getattr(error, "detail", ""):
                print(f"seatrial: {printable(' '.join(str(detail).split()))}", file=sys.stderr)
        except OSError:  # the terminal was closed
            _silence_output()
    if any(thread.name == WAITING for thread in threading.enumerate()):
        sys.stdout.flush()
        os._exit(status)  # a normal exit would wait for the thread, which waits for an answer that may never come
    sys.exit(status)


def _silence_output() -> None:
    """Redirect stdout and stderr to the null device, so that the last flush of the interpreter cannot fail."""
    null_device = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        os.dup2(null_device, stream.fileno())
