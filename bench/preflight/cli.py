"""Command `seatrial check`: preflight checks of a rig, or the same checks of recorded logs."""

from __future__ import annotations

import contextlib
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from seatrial.daq.bounds import bounded
from seatrial.daq.checks import (
    FAULT,
    OK,
    UNKNOWN,
    WARNING,
    CheckReport,
    Finding,
    findings_lines,
    findings_paragraphs,
    findings_summary,
    worst_first,
)
from seatrial.daq.config import load_rig
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import LOG, WHOLE, TimeWindow, window_option
from seatrial.daq.options import ExistingPath, FiniteRange, json_option, output_option, print_json
from seatrial.daq.rig import Rig

if TYPE_CHECKING:
    from seatrial.bench.preflight.report import MotionChecks

FILE = click.Path(path_type=Path)
# Colours of the levels on a terminal. Elsewhere click leaves them out; the level is also printed as a word.
STYLES: dict[str, dict[str, Any]] = {
    FAULT: {"fg": "red", "bold": True},
    WARNING: {"fg": "yellow"},
    UNKNOWN: {"fg": "cyan"},
    OK: {"fg": "green"},
}


@click.command(
    epilog="""\b
    Example:
      seatrial check rig.toml
      seatrial check rig.toml --mission mission.toml
      seatrial check run.mcap --report check.html
      seatrial check rig.toml --actuators"""
)
@click.argument("paths", metavar="RIG | LOG...", nargs=-1, required=True, type=LOG)
@click.option("--seconds", type=FiniteRange(0.5, 600.0), default=3.0, show_default=True, help="How long to listen [s].")
@click.option(
    "--mission",
    "mission_path",
    type=ExistingPath(dir_okay=False),
    help="Dry run of a mission: its limits, its duration, and whether its track leaves the fence.",
)
@click.option("--actuators", is_flag=True, help="Test each thruster at low thrust. THRUSTERS TURN.")
@click.option(
    "--link-test",
    is_flag=True,
    help="With --actuators: instead measure how soon the autopilot ends a thrust of 0.1 after a lost link.",
)
@click.option("--thrust", type=FiniteRange(0, 1, min_open=True), help="Largest command of --actuators [default: 0.3].")
@click.option("--yes", is_flag=True, help="Do not ask before thrusters turn.")
@click.option("--arm", is_flag=True, help="Put an autopilot into MANUAL, arm it, and disarm it at the end.")
@output_option(FILE, "Log of the actuator test [default: by date in the rig's log directory].")
@window_option
@json_option("Print the findings as JSON, and everything else on stderr.")
@click.option("--report", type=click.Path(dir_okay=False, path_type=Path), help="Write a page (HTML) with plots there.")
@click.pass_obj
@bounded("paths", when=lambda options: not any(_is_rig(path) for path in options["paths"]))
def check(
    motion: MotionChecks,
    paths: tuple[Path, ...],
    seconds: float,
    mission_path: Path | None,
    actuators: bool,
    link_test: bool,
    thrust: float | None,
    yes: bool,
    arm: bool,
    out: Path | None,
    as_json: bool,
    report: Path | None,
    window: TimeWindow,
) -> None:
    """Find faults that would spoil a run, and print a remedy for each.

    RIG (a .toml file): checks whether devices answer, their rates, clocks and noise, battery, link and disk, and with
    --mission the dry run of a mission. No thruster turns unless --actuators is given; the boat must be free to move
    then. LOG: the same checks of recorded data, and whether sensors and thrusters agree: sides, signs, units, delays,
    dead zones; with --from and --to in this interval only. Exit status 1: there is a fault. Exit status 3: a limit
    ended the actuator test.
    """
    _check_options(paths, mission_path, actuators, bool(arm or out or thrust or link_test), link_test, thrust)
    if window != WHOLE and _is_rig(paths[0]):
        raise click.UsageError("--from and --to apply to logs; leave them out, or give logs in place of the rig file")
    with tempfile.TemporaryDirectory(prefix="seatrial-check-") as folder:
        if _is_rig(paths[0]):
            from seatrial.bench.preflight.report import dry_run_of
            from seatrial.daq.config import load_mission

            rig = load_rig(paths[0])
            mission = None if mission_path is None else load_mission(mission_path)
            test = (
                _ConfirmedTest(_confirmed_plan(rig, thrust, yes, link_test), out, arm, link_test) if actuators else None
            )
            found, logs = _rig_findings(motion, rig, seconds, mission, test, Path(folder), as_json)
            dry = dry_run_of(mission, rig) if report and mission else None
            done = CheckReport(rig.path.name, tuple(worst_first(found)), tuple(logs), rig.name, dry)
        else:
            from seatrial.bench.preflight.log_findings import log_findings

            found = log_findings(motion.check_log, paths, motion.differences, [window] * len(paths))
            names = ", ".join(path.name + window.label for path in paths)
            done = CheckReport(names, tuple(worst_first(found)), paths, window=window)
        faults = _print_findings(found, as_json)
        if report is not None:
            report.parent.mkdir(parents=True, exist_ok=True)
            motion.write_check_page(done, report)
            click.echo(f"report: {report}", err=as_json)
    from seatrial.bench.preflight.rig_checks import ARMED

    armed = [finding.where for finding in found if finding.code == ARMED]
    loud = f"{', '.join(dict.fromkeys(armed))} IS ARMED: keep clear of the propellers, and disarm it" if armed else ""
    if loud and not faults:
        click.secho(loud, fg="red", bold=True, err=True)
    if faults:
        where = ", ".join(str(path) for path in paths)
        raise SeatrialError(
            f"{where}: {findings_summary(found)}; not as it should be: {', '.join(faults)} (see the lines above)"
            + (f"; {loud}" if loud else "")
        )


def _is_rig(path: Path) -> bool:
    """Return whether ``path``, an argument of `seatrial check`, is a rig file (suffix .toml). All others are logs."""
    return path.suffix == ".toml"


def _check_options(
    paths: Sequence[Path],
    mission: Path | None,
    actuators: bool,
    test_options: bool,
    link_test: bool,
    thrust: float | None,
) -> None:
    """Check that arguments and options of `seatrial check` fit together; raise click.UsageError if they do not.

    One rig or one or more logs may be given. Only with a rig are --mission and --actuators possible. Only with
    --actuators are --link-test, --thrust, --arm and -o possible. --link-test excludes --thrust.

    Parameters
    ----------
    paths : sequence of Path
        Rig files and logs of the command line.
    mission : Path or None
        Value of --mission.
    actuators : bool
        Whether --actuators was given.
    test_options : bool
        Whether one of --link-test, --thrust, --arm and -o was given.
    link_test : bool
        Whether --link-test was given.
    thrust : float or None
        Value of --thrust.
    """
    rig = any(_is_rig(path) for path in paths)
    if rig and len(paths) > 1:
        raise click.UsageError("give one rig file (.toml), or one or more logs (.mcap)")
    if not rig and (mission or actuators or test_options):
        raise click.UsageError(
            "--mission, --actuators, --link-test, --thrust, --arm and -o need a rig file (.toml) in place of a log"
        )
    if test_options and not actuators:
        raise click.UsageError(
            "--link-test, --thrust, --arm and -o apply only with --actuators; add it, or leave them out"
        )
    if link_test and thrust is not None:
        raise click.UsageError("--link-test always commands 0.1 (a tenth of full command); leave --thrust out")


def _print_findings(found: Sequence[Finding], as_json: bool) -> list[str]:
    """Print the findings, worst first, and return the places that have a fault (such as a device or file), each once.

    If there is no fault, a summary line follows. With ``as_json`` the findings are printed as JSON, without a summary.
    """
    _print_lines(found, as_json)
    faults = list(dict.fromkeys(finding.where for finding in worst_first(found) if finding.level == FAULT))
    if not (as_json or faults):
        click.echo(findings_summary(found))
    return faults


def _print_lines(found: Sequence[Finding], as_json: bool) -> None:
    """Print the findings, worst first, without a summary.

    They are printed as JSON if ``as_json`` is true. Otherwise they are wrapped paragraphs on a terminal, and one line
    each elsewhere.
    """
    found = worst_first(found)
    if as_json:
        from seatrial.bench.preflight.report import as_json as written

        print_json(written(found))
        return
    width = shutil.get_terminal_size().columns
    for line in findings_paragraphs(found, width) if sys.stdout.isatty() else findings_lines(found):
        level = line.split(" ", 1)[0]
        click.echo(click.style(level, **STYLES[level]) + line[len(level) :] if level in STYLES else line)


class _ConfirmedTest(NamedTuple):
    """Actuator test or link test that the operator has confirmed.

    Attributes
    ----------
    plan : Mission
        Set-points of the test.
    out : Path or None
        Path of the new log; None for a name by date in the rig's log directory.
    arm : bool
        Whether to put autopilots into MANUAL and arm them before the test, and to disarm them after it.
    of_link : bool
        Whether it is a link test; else it is an actuator test.
    """

    plan: Any
    out: Path | None
    arm: bool
    of_link: bool


def _rig_findings(
    motion: MotionChecks,
    rig: Rig,
    seconds: float,
    mission: Any,
    test: _ConfirmedTest | None,
    folder: Path,
    as_json: bool,
) -> tuple[list[Finding], list[Path]]:
    """Check a rig: record its devices at rest, then run the actuator test or link test if there is one.

    Parameters
    ----------
    motion : MotionChecks
        Checks of the recorded motion, which are applied to the log of an actuator test.
    rig : Rig
        The rig.
    seconds : float
        Duration of the recording at rest [wall s].
    mission : Mission or None
        Mission whose commands and track are checked too; None without one. It is not run.
    test : _ConfirmedTest or None
        Test to run. If it is None, no thruster turns.
    folder : Path
        Folder for the log of the recording at rest.
    as_json : bool
        Whether standard output is reserved for JSON, so that other lines go to standard error.

    Returns
    -------
    list of Finding
        Findings at rest, and those of the test, which replace findings of the same check of the same device.
    list of Path
        One log for the report: that of the test if it exists, else that of the recording at rest.

    Raises
    ------
    SeatrialError
        If the recording or the test fails, or the safety guard ends the test.
    """
    path = folder / "check.mcap"
    found = _findings_at_rest(rig, seconds, mission, path)
    if test is None:
        return found, [path]
    kind = "link" if test.of_link else "actuator"
    out = test.out or rig.log_directory / f"{time.strftime('%Y%m%dT%H%M%S')}-{kind}-test.mcap"
    tested = _findings_of_test(motion, rig, test._replace(out=out), found, as_json)
    # The log of the test repeats checks of the same devices. Its findings replace the earlier ones.
    repeated = {(finding.check, finding.where) for finding in tested}
    return [*(f for f in found if (f.check, f.where) not in repeated), *tested], [out if out.exists() else path]


def _findings_at_rest(rig: Rig, seconds: float, mission: Any, path: Path) -> list[Finding]:
    """Record all devices of a rig at rest, without a command to thrusters, and return the findings on them.

    The recording lasts ``seconds`` (wall) and is the new log ``path``. The findings concern ports, devices, space on
    the disk and limits, and also the commands and the track of ``mission`` unless it is None. If a port has a finding
    (silent, error or remark), the other findings on the samples of its device are left out.
    """
    from seatrial.bench.execution import SafetyGuard
    from seatrial.bench.preflight.mission_checks import check_mission
    from seatrial.bench.preflight.rig_checks import (
        check_computer,
        check_defaults,
        check_limits,
        check_ports,
        listen,
        other_protocols,
    )
    from seatrial.daq.checks import check_devices
    from seatrial.daq.log import open_log

    guard = SafetyGuard(rig, rig.speed, tuple(thruster.name for thruster in rig.thrusters))
    status = listen(rig, seconds, path, guard)
    with open_log(path) as log:
        found = list(check_ports(rig, status, other_protocols(rig, status, log)))
        silent = {finding.where for finding in found if finding.check == "alive"}
        found += [finding for finding in check_devices(log) if finding.where not in silent]
    found += [*check_computer(rig, status), *check_limits(rig, guard, status), *check_defaults(rig)]
    return found if mission is None else [*found, *check_mission(mission, rig)]


def _confirmed_plan(rig: Rig, thrust: float | None, yes: bool, of_link: bool) -> Any:
    """Return the set-points (Mission) of the actuator test or link test, after the operator has confirmed the test.

    The operator is asked at the terminal whether the propellers are clear and the boat is free to move.

    Parameters
    ----------
    rig : Rig
        The rig.
    thrust : float or None
        Largest command of the actuator test, as a fraction of full command; 0.3 if None.
    yes : bool
        Whether to leave out the question.
    of_link : bool
        Whether to return the set-points of the link test, else those of the actuator test.

    Raises
    ------
    click.UsageError
        If standard input is not a terminal, so that the question cannot be asked; not with ``yes``.
    click.Abort
        If the operator presses Ctrl-C at the question.
    SeatrialError
        If the operator does not confirm, if the rig has no thruster for the test, or if its `limits.n_max` does not
        permit the link test.
    """
    from seatrial.bench.execution import N_ACTUATOR_TEST, actuator_plan, link_test_plan, turning_warning

    plan = link_test_plan(rig) if of_link else actuator_plan(rig, thrust or N_ACTUATOR_TEST)
    if thrust is not None and not of_link and thrust > plan.n_max:
        click.echo(
            f"--thrust {thrust:g} is beyond limits.n_max = {rig.limits.n_max:g} of {rig.path.name}: the test runs at "
            f"up to n = {plan.n_max:g}",
            err=True,
        )
    if not yes:
        if not sys.stdin.isatty():
            raise click.UsageError(
                f"--actuators: {turning_warning(plan)}; keep clear of the propellers, and give --yes, as there is no "
                "terminal at which to confirm"
            )
        if not click.confirm(
            f"{turning_warning(plan)}.\nIs everybody clear of the propellers, and the boat free to move?"
        ):
            raise SeatrialError("not started, nothing was moved; repeat the command when everybody is clear")
    return plan


def _findings_of_test(
    motion: MotionChecks, rig: Rig, test: _ConfirmedTest, before: Sequence[Finding], as_json: bool
) -> list[Finding]:
    """Run the actuator test or link test as a mission, with safety guard and watchdog, and return its findings.

    THRUSTERS TURN. The findings of an actuator test are those of its log, and a warning for each autopilot that is
    still armed. The findings of a link test are whether each autopilot ended thrust in time.

    Parameters
    ----------
    motion : MotionChecks
        Checks of the recorded motion, for the log of an actuator test.
    rig : Rig
        The rig.
    test : _ConfirmedTest
        The test. Its `out` must be a path.
    before : sequence of Finding
        Findings at rest. They are printed before the test, except with ``as_json``. If one of them is a fault, no
        thruster is commanded, and the only finding is a warning that the test was not done.
    as_json : bool
        Whether standard output is reserved for JSON, so that lines of the test go to standard error.

    Raises
    ------
    SeatrialError
        If the test cannot start, or has to end early.
    """
    faults = [finding.where for finding in before if finding.level == FAULT]
    if faults:
        # A test would turn the thrusters of a faulty rig.
        text = "the thrusters were not tested, because there are faults already"
        return [
            Finding(
                WARNING,
                "actuators-not-tested",
                "actuators",
                rig.name,
                text,
                f"repair what has a fault ({', '.join(dict.fromkeys(faults))}), and check again",
            )
        ]
    from seatrial.bench.execution import make_display, run_link_test, run_mission
    from seatrial.bench.preflight.rig_checks import armed_finding

    assert test.out is not None
    if not as_json:
        _print_lines(before, False)  # printed before the run, which may end with an error
    with contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext():
        display = make_display(stderr=as_json)
        metadata = {"command": " ".join(["seatrial", *sys.argv[1:]])}
        if test.of_link:
            tests = run_link_test(rig, test.out, display, metadata, test.arm)
            return [_link_test_finding(name, found.seconds, found.passed) for name, found in tests.items()]
        result = run_mission(test.plan, rig, test.out, display, metadata, test.arm)
        from seatrial.bench.preflight.log_findings import log_findings

        found = log_findings(motion.check_log, [test.out])
        return [*found, *(armed_finding(name) for name in result.still_armed)]


def _link_test_finding(name: str, seconds: float, passed: bool) -> Finding:
    """Return the finding on the link test of the autopilot ``name``: OK if it is passed, else a fault with remedy.

    ``seconds`` is the time (wall) from our last frame to neutral outputs, and ``passed`` is whether it was short enough
    (at most 2 s).
    """
    from seatrial.bench.execution import ALLOWED_S

    text = f"thrust ended {seconds:.2f} s after the last frame of seatrial, allowed {ALLOWED_S:g} s"
    if passed:
        return Finding(OK, "link-loss-ends-thrust", "link test", name, text)
    return Finding(
        FAULT,
        "link-loss-goes-on",
        "link test",
        name,
        text,
        "correct its parameters RC_OVERRIDE_TIME, FS_THR_ENABLE and FS_ACTION, and repeat the test",
    )
