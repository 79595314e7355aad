"""The front door: the command tree, and what one part does for another, which does not import it.

Each part is imported only when one of its commands runs, so `seatrial --help` is instant. What the user sees
of a failure is decided here too, once for all commands: one line on stderr and an exit status.
"""

from __future__ import annotations

import sys

try:
    import errno
    import importlib
    import os
    import threading
    import traceback
    import warnings
    from collections.abc import Callable, Sequence
    from pathlib import Path
    from typing import TYPE_CHECKING, Any, NamedTuple

    import click
    from click.shell_completion import CompletionItem

    from seatrial.daq import bounds
    from seatrial.daq.errors import SeatrialError, SeatrialWarning, printable
except KeyboardInterrupt:  # Ctrl-C before there is a command to take it
    sys.stderr.write("\nseatrial: interrupted\n")
    raise SystemExit(130) from None

# All matrices are small: threads of the linear algebra library would only wait for each other, and cost every process
# a tenth of a second. Before numpy; the processes of a command inherit it.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

if TYPE_CHECKING:
    from seatrial.bench.preflight.report import MotionChecks
    from seatrial.daq.checks.check_report import CheckReport
    from seatrial.daq.checks.findings import Finding

WAITING = "ROS 2"  # seatrial.daq.tools.ros_live
OK, FAILED, WRONG_USAGE, HUNG_UP, INTERRUPTED = 0, 1, 2, 129, 130


class Row(NamedTuple):
    """One command: where it lives (`module:attribute`) and its line in the list of commands."""

    target: str
    short_help: str


COMMANDS = {
    "demo": Row("seatrial.bench.demo:demo", "The whole loop on mock devices, to a report."),
    "devices": Row("seatrial.daq.cli:devices", "Find ports and identify the devices there."),
    "log": Row("seatrial.daq.cli:log", "Acquire until Ctrl-C, with a live table."),
    "check": Row("seatrial.bench.preflight.cli:check", "Preflight of a rig, or the same questions to a log."),
    "bench": Row("seatrial.bench.cli:bench", "Characterise thrusters: static, steps, chirp, all."),
    "mission": Row("seatrial.bench.cli:mission", "Design, make, show and run missions."),
    "import": Row("seatrial.daq.cli:import_", "Turn foreign logs into MCAP."),
    "export": Row("seatrial.daq.cli:export", "Write a log as CSV, Parquet, MATLAB, NetCDF or a bag of ROS 2."),
    "info": Row("seatrial.daq.cli:info", "Say what a log holds."),
    "recover": Row("seatrial.daq.cli:recover", "Recover the log of a killed run."),
    "replay": Row("seatrial.daq.cli:replay", "Send a log's raw bytes again, on ports."),
    "ident": Row("seatrial.ident.cli.commands:ident", "Fit and explain: noise, thruster, vehicle, diagnose, ..."),
    "mock": Row("seatrial.mocks.cli:mock", "Mock devices for a rig, until Ctrl-C: bench or boat."),
}
# The modules that an extra of the installation brings (pyproject.toml).
EXTRAS = {
    "ident": ("casadi", "jinja2", "joblib", "llvmlite", "platformdirs", "scipy"),
    "mavlink": ("pymavlink",),
}
# Commands of one part in the group of another: the parts do not import each other.
ATTACHED = {"mission": {"design": "seatrial.ident.cli.commands:design"}}


class LazyGroup(click.Group):
    """A group whose commands are imported when they are asked for, and listed without any import."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of the work, which is the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return the command, or None where the table has no such name."""
        row = COMMANDS.get(cmd_name)
        if row is None:
            return None
        command = _load(cmd_name, row.target)
        for name, target in ATTACHED.get(cmd_name, {}).items():
            if isinstance(command, click.Group) and name not in command.commands:
                command.add_command(_load(f"{cmd_name} {name}", target), name)
        return command

    def invoke(self, ctx: click.Context) -> None:
        """Run the command and drop what it returns: only `ctx.exit(status)` may set the exit status."""
        super().invoke(ctx)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Names from the table, then options: click's own way would import every part for a Tab."""
        names = [
            CompletionItem(name, help=row.short_help) for name, row in COMMANDS.items() if name.startswith(incomplete)
        ]
        return names + click.Command.shell_complete(self, ctx, incomplete)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands from the table: click's own way would import every part."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, row.short_help) for name, row in COMMANDS.items()])


def _needs(what: str, missing: str) -> str:
    """Return the line for a library that is not installed, with the extra that installs it."""
    extra = next((extra for extra, modules in EXTRAS.items() if missing.partition(".")[0] in modules), "all")
    return f"{what} needs the Python module {missing}, which is not installed: pip install 'seatrial[{extra}]'"


def _load(name: str, target: str) -> click.Command:
    """Import `module:attribute`; raises SeatrialError when this installation has no such command."""
    module_name, attribute = target.split(":")
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        missing = error.name or module_name
        if f"{module_name}.".startswith(f"{missing}."):
            raise SeatrialError(f"`{name}` is not part of this installation (no module {missing})") from error
        raise SeatrialError(_needs(f"`{name}`", missing)) from error
    command = getattr(module, attribute, None)
    if not isinstance(command, click.Command):
        raise SeatrialError(f"`{name}` is not part of this installation (no command {target})")
    return command


class MotionChecksOfIdent:
    """What `seatrial check` asks of ident, imported when it asks."""

    def check_log(self, path: Path) -> list[Finding]:
        """Findings about sensors and thrusters from the motion in a log; raises SeatrialError without ident."""
        try:
            from seatrial.ident.checks.log_checks import check_log
        except ModuleNotFoundError as error:
            raise SeatrialError(_needs("that", error.name or "ident")) from error
        return check_log(path)

    def write_check_page(self, report: CheckReport, out: Path) -> None:
        """Write the page of a check; raises SeatrialError without ident."""
        try:
            from seatrial.ident.workflows.check import write_check
        except ModuleNotFoundError as error:
            raise SeatrialError(_needs("--report", error.name or "ident")) from error
        write_check(report, " ".join(["seatrial", *sys.argv[1:]]), out)


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="seatrial", message="seatrial %(version)s")
@click.option("--debug", is_flag=True, help="Show the traceback of an error; may stand anywhere in the line.")
@click.pass_context
def cli(context: click.Context, debug: bool) -> None:
    """Measure a boat and its thrusters, excite them, and explain what was measured."""
    motion: MotionChecks = MotionChecksOfIdent()
    context.obj = motion


def _explain(error: BaseException) -> tuple[str, int]:
    """The one line for stderr and the exit status of a failure that is no matter of usage."""
    if limit := bounds.exceeded(error):
        line, status = limit, FAILED
    elif isinstance(error, SeatrialError):
        line, status = str(error), error.exit_status
    elif isinstance(error, (KeyboardInterrupt, click.Abort)):
        line, status = "interrupted", INTERRUPTED
    elif isinstance(error, OSError) and error.errno == errno.EIO and error.filename is None:
        line, status = "the terminal was closed", HUNG_UP
    elif isinstance(error, OSError) and error.filename is not None:
        line, status = f"{error.filename}: {error.strerror}", FAILED
    elif isinstance(error, ModuleNotFoundError) and error.name:
        line, status = _needs("this command", error.name), FAILED
    elif isinstance(error, MemoryError):
        line, status = "the memory of this computer is not enough: give fewer or shorter logs", FAILED
    else:
        line = f"internal error ({type(error).__name__}: {error}); run again with --debug to see where"
        status = FAILED
    return printable(" ".join(line.split())), status


def _usage(error: click.UsageError) -> str:
    """The one line for words that make no command."""
    path = "seatrial" if error.ctx is None else error.ctx.command_path
    text = printable(" ".join(error.format_message().split()).rstrip("."))
    return f"{path}: {text}{'' if text.endswith(('?', ')')) else ';'} `{path} --help` shows how"


def _shown(otherwise: Callable[..., None]) -> Callable[..., None]:
    """Our own warnings as one line, without the place in the code that all others have."""

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, SeatrialWarning):
            print(f"seatrial: {printable(str(message))}", file=sys.stderr)
        else:
            otherwise(message, category, *where, **more)

    return show


def _run(args: Sequence[str]) -> int:
    """Run one command line and return its exit status; raises whatever the command raises."""
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _shown(warnings.showwarning)
            result = cli.main(args=list(args), prog_name="seatrial", standalone_mode=False)
        sys.stdout.flush()
    except click.ClickException as error:  # UsageError is 2, the rest of click's own errors 1
        if isinstance(error, click.exceptions.NoArgsIsHelpError):
            error.show()
            return WRONG_USAGE
        if isinstance(error, click.UsageError):
            print(_usage(error), file=sys.stderr)
            return WRONG_USAGE
        raise SeatrialError(error.format_message()) from error
    return OK if result is None else int(result)  # a number here is the status of `ctx.exit(status)`


def main(args: Sequence[str] | None = None) -> None:
    """Run the command line and leave with its status: 0 done, 1 failed, 2 wrong usage, 3 safety stop."""
    words = list(sys.argv[1:] if args is None else args)
    if args is None:
        bounds.enable()
        # Child processes that a library starts (joblib) import no module from the working folder, as our own (`-P`) do
        # not. A program that calls this function keeps its own environment.
        os.environ.setdefault("PYTHONSAFEPATH", "1")
    # People add --debug to the end of the line that failed, so it is taken from anywhere before a `--`.
    own = words[: words.index("--")] if "--" in words else words
    debug = "--debug" in own
    words = [word for word in own if word != "--debug"] + words[len(own) :]
    try:
        status = _run(words)
    except BrokenPipeError:
        # The reader left (`| head`): no message can be printed, not even at the interpreter's last flush.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = FAILED
    except (Exception, KeyboardInterrupt) as error:
        if debug:
            traceback.print_exc()
        line, status = _explain(error)
        try:
            print(f"seatrial: {line}", file=sys.stderr)
        except OSError:  # the terminal was closed
            _mute()
    if any(thread.name == WAITING for thread in threading.enumerate()):
        sys.stdout.flush()
        os._exit(status)  # all is closed but a connection that nobody answers on
    sys.exit(status)


def _mute() -> None:
    """Send what is still to be printed nowhere: not even the interpreter's last flush can be read by anybody."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        os.dup2(nowhere, stream.fileno())
