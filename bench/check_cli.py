"""The command `seatrial check`: a preflight of a rig, or the same questions to a log."""

from __future__ import annotations

import contextlib
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from bench.findings import FAULT, OK, WARNING, Finding, from_dict, lines, summary, worst_first
from daq.errors import SeatrialError
from daq.rig import Rig, load_rig

FILE = click.Path(path_type=Path)
FORMAT = "seatrial-check 1"


@click.command(epilog="Example: seatrial check boat-rig.toml --mission mission.toml --actuators")
@click.argument("paths", metavar="RIG | LOG...", nargs=-1, required=True, type=FILE)
@click.option("--seconds", type=click.FloatRange(0.5, 600.0), default=3.0, show_default=True, help="Wall s to listen.")
@click.option(
    "--mission", "mission_path", type=FILE, help="Dry run: limits, duration, and whether it leaves the fence."
)
@click.option("--actuators", is_flag=True, help="THRUSTERS TURN: each at low thrust; which one answers, and how?")
@click.option(
    "--thrust", type=click.FloatRange(0, 1, min_open=True), help="Largest command of that test [default: 0.3]."
)
@click.option("--yes", is_flag=True, help="Do not ask before thrusters turn.")
@click.option("--arm", is_flag=True, help="Put an autopilot into MANUAL, arm it, and disarm it at the end.")
@click.option("-o", "--out", type=FILE, help="Log of the actuator test [default: by date in the rig's log directory].")
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
@click.pass_context
def check(
    context: click.Context,
    paths: tuple[Path, ...],
    seconds: float,
    mission_path: Path | None,
    actuators: bool,
    thrust: float | None,
    yes: bool,
    arm: bool,
    out: Path | None,
    as_json: bool,
) -> None:
    """Look for what would spoil a run, and say what to do about it.

    RIG (a .toml file): devices alive, at their rates, clocks, noise, battery, link, disk, and with --mission its dry
    run; nothing moves but with --actuators. LOG: the same from recorded data, and whether sensors and thrusters
    agree: sides, signs, units, delays, dead bands. Exit status 1 where there is a fault.
    """
    rigs = [path for path in paths if path.suffix == ".toml"]
    if rigs and len(paths) > 1:
        raise click.UsageError("give one RIG, or one or more LOGs")
    if not rigs and (mission_path or actuators or arm or out or thrust):
        raise click.UsageError("--mission, --actuators, --thrust, --arm and -o need a RIG")
    if not actuators and (arm or out or thrust):
        raise click.UsageError("--thrust, --arm and -o belong to --actuators")
    if rigs:
        rig = load_rig(paths[0])
        plan = _agreed(rig, thrust, yes) if actuators else None
        found = _rig(rig, seconds, mission_path)
        if plan is not None:
            # Its log answers the questions about devices once more, and about the same devices.
            tested = _actuators(context, rig, plan, found, out, arm, as_json)
            known = {(finding.check, finding.where) for finding in tested}
            found = [*(finding for finding in found if (finding.check, finding.where) not in known), *tested]
    else:
        found = _logs(context, paths)
    _tell(found, ", ".join(str(path) for path in paths), as_json)


def _tell(found: Sequence[Finding], where: str, as_json: bool) -> None:
    """Print the findings, and leave with an error where there is a fault."""
    found = worst_first(found)
    if as_json:
        click.echo(json.dumps({"format": FORMAT, "findings": [finding._asdict() for finding in found]}, indent=2))
    else:
        for line in lines(found):
            click.echo(line)
    faults = list(dict.fromkeys(finding.where for finding in found if finding.level == FAULT))
    if faults:
        raise SeatrialError(
            f"{where}: {summary(found)}; not as it should be: {', '.join(faults)} (see the lines above)"
        )
    if not as_json:
        click.echo(summary(found))


def _rig(rig: Rig, seconds: float, mission_path: Path | None) -> list[Finding]:
    """Listen; nothing moves."""
    from bench.check import check_computer, check_ports, listen
    from bench.check_devices import check_devices
    from bench.dry_run import check_mission
    from bench.mission import load_mission
    from daq.log import open_log

    planned = None if mission_path is None else load_mission(mission_path)
    with tempfile.TemporaryDirectory(prefix="seatrial-check-") as folder:
        path = Path(folder) / "check.mcap"
        status = listen(rig, seconds, path)
        found = list(check_ports(rig, status))
        silent = {finding.where for finding in found if finding.check == "alive"}
        with open_log(path) as log:
            found += [finding for finding in check_devices(log) if finding.where not in silent]
    found += check_computer(rig, status)
    return found if planned is None else [*found, *check_mission(planned, rig)]


def _agreed(rig: Rig, thrust: float | None, yes: bool) -> Any:
    """The plan of the actuator test, after somebody has said that nobody is in its way."""
    from bench.actuator_test import N_TEST, actuator_plan, warning

    plan = actuator_plan(rig, thrust or N_TEST)
    if not yes:
        if not sys.stdin.isatty():
            raise click.UsageError(f"--actuators: {warning(plan)}; without a terminal to ask at, say --yes")
        click.confirm(f"{warning(plan)}.\nIs everybody clear of the propellers, and the boat free to move?", abort=True)
    return plan


def _actuators(
    context: click.Context, rig: Rig, plan: Any, before: Sequence[Finding], out: Path | None, arm: bool, as_json: bool
) -> list[Finding]:
    """Run the plan as any mission is run, guard and watchdog included, then look at its log."""
    faults = [finding.where for finding in before if finding.level == FAULT]
    if faults:
        text = "not tested: there are faults already"
        return [Finding(WARNING, "actuators", rig.name, text, f"first {', '.join(dict.fromkeys(faults))}")]
    from bench.display import PlainDisplay, make_display
    from bench.run import run_mission

    for line in () if as_json else lines(worst_first(before)):  # said now: the run may end in a stop
        click.echo(line)
    path = rig.log_directory / f"{time.strftime('%Y%m%dT%H%M%S')}-actuator-test.mcap" if out is None else out
    with contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext():
        display = PlainDisplay() if as_json else make_display()
        run_mission(plan, rig, path, display, {"command": " ".join(["seatrial", *sys.argv[1:]])}, arm)
        return _logs(context, [path])


def _logs(context: click.Context, paths: Sequence[Path]) -> list[Finding]:
    """Findings of each log: of its devices here, of the motion by ident where that is installed."""
    from bench.check_devices import check_devices
    from daq.log import open_log

    found = []
    for path in paths:
        with open_log(path) as log:
            here, counts = list(check_devices(log)), log.counts
        here += _motion(context, path)
        if not here:
            here = [
                Finding(OK, "log", "all of it", f"nothing in it that a check compares: {', '.join(counts) or 'empty'}")
            ]
        prefix = f"{path.stem}: " if len(paths) > 1 else ""
        found += [finding._replace(where=f"{prefix}{finding.where}") for finding in here]
    return found


def _motion(context: click.Context, path: Path) -> list[Finding]:
    """What `seatrial ident check` says, asked through the command tree: bench imports nothing of ident."""
    root = context.find_root().command
    try:
        ident = root.get_command(context, "ident") if isinstance(root, click.Group) else None
        command = ident.get_command(context, "check") if isinstance(ident, click.Group) else None
        if command is None:
            raise SeatrialError("there is no `seatrial ident check` here")
        (found,) = context.invoke(command, logs=(path,), quiet=True)
    except (SeatrialError, ModuleNotFoundError) as error:
        text = f"sensors and thrusters were not compared: {error}"
        return [Finding(WARNING, "motion", path.name, text, "check the log where all of seatrial is installed")]
    return [from_dict(values) for values in found]
