"""Commands `seatrial bench` and `seatrial mission`: generate, show and run plans of set-points."""

from __future__ import annotations

import contextlib
import re
import shlex
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from seatrial.bench import mission_generators
from seatrial.bench.mission_text import describe_mission, largest_command_line, mission_content
from seatrial.daq.config import Mission, load_mission, load_rig, save_mission
from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.options import (
    Choice,
    ExistingPath,
    FiniteRange,
    json_option,
    output_option,
    parsed_by,
    print_json,
    view_option,
)
from seatrial.daq.rig import LOAD_CELLS, Rig

if TYPE_CHECKING:
    from seatrial.daq.tools import Ros2Node

FILE = click.Path(path_type=Path)
EXISTING = ExistingPath(dir_okay=False)
N_MAX_BENCH = 0.9
_N_MAX_HELP = f"Largest command [default: {N_MAX_BENCH}, or limits.n_max of RIG if that is smaller]."
ROUTER_S = 3.0  # wall seconds to wait for the router of ROS 2
_ARM = click.option("--arm", is_flag=True, help="Put an autopilot into MANUAL, arm it, and disarm it at the end.")
_RETRY = click.option(
    "--retry",
    type=click.IntRange(0, 100),
    default=0,
    show_default=True,
    help="How many invalid steps, in all, are repeated.",
)

_HOLD = click.option(
    "--hold",
    type=FiniteRange(0, min_open=True),
    default=mission_generators.HOLD_S,
    show_default=True,
    help="Time [s] for which each level is held. If no shaft speed is reported, the force has to settle in it.",
)


@click.group(epilog="Example: seatrial bench all bench-rig.toml -o bench.mcap")
def bench() -> None:
    """Characterise one thruster on the bench: record command, rpm and force. The usual plan is `all`.

    THRUSTERS TURN at once. Ctrl-C ends the run at zero thrust. Exit status 3: a safety limit ended the run.
    """


@click.group(epilog="Example: seatrial mission run mission.toml rig.toml -o run.mcap")
def mission() -> None:
    """Generate, show and run missions: sequences of thruster commands."""


def _add_bench_command(kind: str, text: str) -> None:
    """Define the command `seatrial bench KIND` and add it to the group `bench`.

    ``kind`` is a key of `mission_generators.BENCH_KINDS`, and ``text`` is the help of the command. All kinds have the
    options `--out`, `--thruster`, `--n-max`, `--arm`, `--retry`, `--view` and `--json`; `steps` also has `--hold`.
    Without `--n-max` the largest command is 0.9, or `limits.n_max` of the rig if that is smaller.
    """

    @bench.command(kind, help=text, epilog=f"Example: seatrial bench {kind} bench-rig.toml -o {kind}.mcap")
    @click.argument("rig_path", metavar="RIG", type=EXISTING)
    @output_option(FILE, "The log to write [default: by date in the rig's log directory].")
    @click.option("--thruster", help="Name of the thruster, if the rig has more than one.")
    @click.option("--n-max", type=FiniteRange(0, 1, min_open=True), help=_N_MAX_HELP)
    @_ARM
    @_RETRY
    @view_option
    @json_option()
    def command(
        rig_path: Path,
        out: Path | None,
        thruster: str | None,
        n_max: float | None,
        arm: bool,
        retry: int,
        view: bool,
        as_json: bool,
        hold: float = mission_generators.HOLD_S,
    ) -> None:
        """Run the bench plan ``kind`` on one thruster of a rig file, record it, and print a summary. THRUSTERS TURN.

        ``n_max`` is the largest command; None for 0.9, or `limits.n_max` of the rig if that is smaller. A given value
        is not reduced: beyond `limits.n_max` it is an error. ``hold`` [s] applies only to steps.
        """
        rig = load_rig(rig_path)
        largest = min(N_MAX_BENCH, rig.limits.n_max) if n_max is None else n_max
        if kind != "static":
            click.echo(_largest_command_text(kind, rig, n_max, largest), err=as_json)
        plan = mission_generators.bench_plan(kind, _bench_thruster(rig, thruster), largest, hold)
        _run_plan(plan, rig, out, arm, retry, None, view, as_json)

    if kind == "steps":
        _HOLD(command)


_add_bench_command("static", "Ten seconds at rest: the load cell's zero and the sensors' noise.")
_add_bench_command("steps", "Progressively increasing steps, up and down, forward and reverse.")
_add_bench_command("chirp", "A chirp forward and a chirp in reverse.")
_add_bench_command("all", "Rest, steps, chirps of each sign, rest: about two minutes.")


def _largest_command_text(kind: str, rig: Rig, given: float | None, used: float) -> str:
    """Return the line that says before a bench run which largest command it uses, and where this comes from.

    ``kind`` is that of the bench run. ``given`` is the value of --n-max, None without it, and ``used`` the value that
    the plan gets. Raises SeatrialError if the given value is beyond `limits.n_max` of the rig.
    """
    limit = rig.limits.n_max
    if given is not None and given > limit:
        raise SeatrialError(
            f"{rig.path}: --n-max {given:g} of bench {kind} is too large, as limits.n_max is {limit:g}; give at "
            f"most {limit:g}, or leave --n-max out, or raise the limit in the rig"
        )
    source = f"the default without --n-max; limits.n_max is {limit:g}"
    if given is not None:
        source = "by --n-max"
    elif limit < N_MAX_BENCH:
        source = f"limits.n_max of {rig.path.name}, which is below the default {N_MAX_BENCH:g}"
    return f"bench {kind}: commands up to n = {used:g} ({source})"


def _bench_thruster(rig: Rig, name: str | None) -> str:
    """Return the name of the thruster of a bench run: ``name``, or that of the only thruster of the rig if it is None.

    ``name`` is the value of the option `--thruster`. Raises SeatrialError if the rig has no thruster of this name, or
    if ``name`` is None and the rig has no thruster or several.
    """
    if name is not None:
        return rig.thruster(name).name
    if len(rig.thrusters) != 1:
        names = ", ".join(thruster.name for thruster in rig.thrusters) or "none"
        raise SeatrialError(
            f"{rig.path}: a bench run drives one thruster, and the rig has: {names}; name one with --thruster"
        )
    return rig.thrusters[0].name


def _run_plan(
    plan: Mission,
    rig: Rig,
    out: Path | None,
    arm: bool,
    retry: int,
    commands: Ros2Node | None = None,
    view: bool = False,
    as_json: bool = False,
) -> None:
    """Run a plan on the devices of a rig, record it, and print a summary. THRUSTERS TURN.

    One line before the run names the thrusters, the largest command and the duration. The summary names the duration,
    the path of the log, the next command for the user, and the autopilots that are still armed.

    Parameters
    ----------
    plan : Mission
        The set-points of the thrusters and their limits.
    rig : Rig
        The rig that is driven.
    out : Path or None
        Path of the new log. If it is None, the log gets a name by date in the log directory of the rig.
    arm : bool
        Whether to put autopilots into MANUAL and arm them before the run, and to disarm them after it.
    retry : int
        Largest number of repetitions, in all, of segments with invalid data, for example lost samples.
    commands : Ros2Node, optional
        Source of external commands, which replace the set-points of the plan.
    view : bool
        Whether to serve the page of the log for the browser, by a process of its own, until the end of the run.
    as_json : bool
        Whether to print the summary as one JSON document, and everything else on standard error.

    Raises
    ------
    SeatrialError
        If the run cannot start or has to end early, as in `run_mission`. No summary is printed then.
    """
    # Imported here, so that --help starts quickly.
    from seatrial.bench.execution import make_display, new_log_file, run_mission

    stem = re.sub(r"[^A-Za-z0-9]+", "-", plan.name).strip("-").lower() or "mission"
    path = rig.log_directory / f"{time.strftime('%Y%m%dT%H%M%S')}-{stem}.mcap" if out is None else out
    start = time.monotonic()
    metadata = {"command": " ".join(["seatrial", *sys.argv[1:]])}
    with contextlib.ExitStack() as stack:
        if view:
            from seatrial.daq.view import live_page

            new_log_file(path)  # otherwise the page would show the log of an earlier run, before the error
            click.echo(f"page at {stack.enter_context(live_page(path))}", err=as_json)
        click.echo(largest_command_line(plan, external=commands is not None), err=as_json)
        result = run_mission(plan, rig, path, make_display(stderr=as_json), metadata, arm, retry, commands)
    took = time.monotonic() - start
    if as_json:
        print_json(
            {
                "format": "seatrial-run 1",
                "plan": plan.name,
                "log": path,
                "seconds": plan.end,
                "wall_seconds": took,
                "tares": [tare._asdict() for tare in result.tares],
                "still_armed": result.still_armed,
                "next": next_command(plan, rig, path),
            }
        )
    else:
        click.echo(f"done: {plan.name}; the {plan.end:g} s of the plan took {took:.1f} s; log {path}")
        click.echo(f"next: {next_command(plan, rig, path)}")
    warn_of_armed(result.still_armed)


def next_command(plan: Mission, rig: Rig, log: Path) -> str:
    """Return the command line that identifies a model from a finished log.

    Parameters
    ----------
    plan : Mission
        The plan that was run.
    rig : Rig
        The rig that was driven.
    log : Path
        The finished log.

    Returns
    -------
    str
        "seatrial ident thruster LOG" for a plan of one thruster on a rig with a load cell. Otherwise "seatrial ident
        vehicle LOG", with "--model nomoto" at the end if a thruster of the rig is connected to an autopilot. LOG is the
        path of the log, quoted for a shell.
    """

    name = shlex.quote(str(log))
    if len(plan.thrusters) == 1 and any(device.protocol in LOAD_CELLS for device in rig.devices):
        return f"seatrial ident thruster {name}"
    by_autopilot = any(thruster.output is not None for thruster in rig.thrusters)
    # An autopilot reports its outputs but no timely shaft speed. The Nomoto model needs no shaft speed.
    return f"seatrial ident vehicle {name}{' --model nomoto' if by_autopilot else ''}"


def warn_of_armed(names: Sequence[str]) -> None:
    """Print to standard error that the autopilots ``names`` are still armed; print nothing if ``names`` is empty."""
    if names:
        click.secho(
            f"{', '.join(names)} IS STILL ARMED: keep clear of the propellers, and disarm it yourself",
            fg="red",
            bold=True,
            err=True,
        )


@mission.command(epilog="Example: seatrial mission run mission.toml rig.toml -o run.mcap")
@click.argument("mission_path", metavar="MISSION", type=EXISTING)
@click.argument("rig_path", metavar="RIG", type=EXISTING)
@output_option(FILE, "The log to write [default: by date in the rig's log directory].")
@_ARM
@_RETRY
@view_option
@json_option()
def run(mission_path: Path, rig_path: Path, out: Path | None, arm: bool, retry: int, view: bool, as_json: bool) -> None:
    """Run a mission and record it. THRUSTERS TURN at once.

    The log is written to --out, or to a file named by date. With --arm, disarmed autopilots are armed before the run,
    and disarmed after it. With --retry N, up to N steps with invalid data are repeated.

    Keys: space pauses at zero thrust; a second space resumes with the beginning of the step; r repeats the step; m
    marks the log; Ctrl-C ends the run at zero thrust. Exit status 3: a safety limit ended the run.
    """
    _run_plan(load_mission(mission_path), load_rig(rig_path), out, arm, retry, None, view, as_json)


@mission.command(epilog="Example: seatrial mission follow rig.toml --seconds 300 -o run.mcap")
@click.argument("rig_path", metavar="RIG", type=EXISTING)
@click.option("--seconds", type=FiniteRange(1.0, 7200.0), default=300.0, show_default=True, help="Run seconds.")
@click.option(
    "--n-max", type=FiniteRange(0, 1, min_open=True), help="Largest command followed [default: limits.n_max]."
)
@click.option("--slew", type=FiniteRange(0, min_open=True), default=1.0, show_default=True, help="Largest change, 1/s.")
@output_option(FILE, "The log to write [default: by date in the rig's log directory].")
@_ARM
@view_option
def follow(
    rig_path: Path, seconds: float, n_max: float | None, slew: float, out: Path | None, arm: bool, view: bool
) -> None:
    """Let a ROS 2 node command the thrusters through the safety guard, and record the run.

    RIG must allow this by `commands = true` in [ros2]. THRUSTERS TURN AS OTHERS COMMAND. Ctrl-C ends the run at zero
    thrust.
    """
    from seatrial.bench.execution import follow_plan
    from seatrial.daq.tools import Ros2Node

    rig = load_rig(rig_path)
    plan = follow_plan(rig, seconds, n_max, slew)
    with Ros2Node(rig, plan.thrusters) as node:
        click.echo(node.await_router(ROUTER_S))
        names = ", ".join(plan.thrusters)
        click.echo(f"any node that reaches this router can command {names} up to n = {plan.n_max:g}")
        _run_plan(plan, rig, out, arm, 0, node, view)
        click.echo(node.summary())


@mission.command(
    short_help="Show the segments and the range of each thruster's command.",
    epilog="Example: seatrial mission show mission.toml",
)
@click.argument("mission_path", metavar="MISSION", type=EXISTING)
@json_option("Print the mission as JSON.")
def show(mission_path: Path, as_json: bool) -> None:
    """Show a mission as text: its segments, the range of each command, and the predictions of its design."""
    plan = load_mission(mission_path)
    if as_json:
        print_json({"format": "seatrial-plan 1", "path": mission_path, **mission_content(plan)})
    else:
        click.echo(describe_mission(plan))


def _parse_thruster_names(text: str) -> tuple[str, str]:
    """Return the names of the left and the right thruster from ``text``, the value "LEFT,RIGHT" of `--thrusters`.

    Spaces around a name are removed. Raise ValueError if there are not exactly two names, or if one is empty.
    """
    names = [name.strip() for name in text.split(",")]
    if len(names) != 2 or not all(names):
        raise ValueError(f"give two names with a comma between them, such as left,right, not '{text}'")
    return names[0], names[1]


@mission.command(
    short_help="Generate a random mission with the excitation that a diagnosis needs.",
    epilog="Example: seatrial mission generate --kind mixed --seconds 300 --seed 1 -o mission.toml",
)
@click.option("--kind", type=Choice(mission_generators.MISSION_KINDS), default="mixed", show_default=True)
@click.option("--seconds", type=FiniteRange(30.0, 7200.0), default=300.0, show_default=True)
@click.option("--seed", type=click.IntRange(min=0), required=True, help="The same seed makes the same mission.")
@click.option("--n-max", type=FiniteRange(0, 1, min_open=True), default=1.0, show_default=True)
@click.option("--slew", type=FiniteRange(0, min_open=True), help="Largest change of a command, 1/s.")
@click.option(
    "--thrusters",
    metavar="LEFT,RIGHT",
    default="left,right",
    show_default=True,
    callback=parsed_by(_parse_thruster_names),
    help="Names in the rig of the left and the right thruster.",
)
@output_option(FILE, "The mission file to write.", required=True)
@click.option("--force", is_flag=True, help="Replace the mission file if it exists.")
@json_option("Print the mission as JSON, and everything else on stderr.")
def generate(
    kind: str,
    seconds: float,
    seed: int,
    n_max: float,
    slew: float | None,
    thrusters: tuple[str, str],
    out: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Generate a random mission with the excitation that a diagnosis needs; `show` prints its segments.

    The kind mixed consists of four equal parts: surge steps, zigzag, random steps of both thrusters, and chirps.
    """
    plan = mission_generators.make_mission(kind, seconds, seed, thrusters, n_max)
    if slew is not None:
        plan = replace(plan, slew_per_s=slew, made_by=f"{plan.made_by} --slew {slew:g}")
    save_mission(plan, out, force)
    if as_json:
        print_json({"format": "seatrial-plan 1", "path": out, **mission_content(plan)})
    click.echo(f"{out}: {plan.name}, {counted(len(plan.segments), 'segment')}, {plan.end:g} s", err=as_json)
