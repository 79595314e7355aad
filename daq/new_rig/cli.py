"""Command `seatrial init`: a new rig file and the checklist of its first run."""

from __future__ import annotations

import math
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from seatrial.daq.errors import counted
from seatrial.daq.options import Choice, FiniteRange, parsed_by

if TYPE_CHECKING:
    from seatrial.daq.new_rig.draft import RigDraft
    from seatrial.daq.new_rig.questions import RigAnswers
    from seatrial.daq.tools import DiscoveredDevice

RIG, CHECKLIST = "rig.toml", "CHECKLIST.md"
_POSITIVE = FiniteRange(min=0.0, min_open=True)
_SHARE = FiniteRange(0.0, 1.0, min_open=True)
# Options for limits: key of the rig file, type, and words of the help.
_LIMIT_OPTIONS: tuple[tuple[str, click.ParamType[Any], str], ...] = (
    ("n_max", _SHARE, "largest command, 1 is full forward"),
    ("current_a", _POSITIVE, "largest current of a motor [A]"),
    ("temperature_c", _POSITIVE, "highest temperature of a speed controller [deg C]"),
    ("voltage_min_v", _POSITIVE, "lowest voltage of the supply [V]"),
    ("radius_m", _POSITIVE, "geofence, largest distance from the start [m]"),
    ("force_n", _POSITIVE, "largest force of a load cell [N]"),
    ("link_test_n", _SHARE, "largest command before the link test of an autopilot"),
)


def _limit_options(command: Any) -> Any:
    """Decorate a command with an option for each limit, which is named like the key of the rig file."""
    for key, kind, words in reversed(_LIMIT_OPTIONS):
        command = click.option(f"--{key.replace('_', '-')}", key, type=kind, help=f"Limit: {words}.")(command)
    return command


def _parse_devices(text: str) -> Any:
    """Parse the value of `--devices`; see `parse_devices`."""
    from seatrial.daq.new_rig.questions import parse_devices

    return parse_devices(text)


def _parse_position(text: str) -> tuple[float, float, float]:
    """Parse X,Y,Z in metres; see `parse_position`."""
    from seatrial.daq.new_rig.questions import parse_position

    return parse_position(text)


def _parse_named_position(text: str) -> tuple[str, tuple[float, float, float]]:
    """Parse NAME=X,Y,Z to name and position [m]. Any other text raises ValueError."""
    name, equals, position = text.partition("=")
    if not (name and equals):
        raise ValueError(f"{text!r} is not NAME=X,Y,Z, such as left=-0.4,-0.3,0.1")
    return name, _parse_position(position)


def _parse_names(text: str) -> list[str]:
    """Parse names with commas; empty names are left out."""
    return [name.strip() for name in text.split(",") if name.strip()]


def _parse_nodes(text: str) -> list[int]:
    """Parse whole numbers with commas. Any other text raises ValueError."""
    from seatrial.daq.new_rig.questions import parse_whole

    return [parse_whole(part.strip()) for part in text.split(",")]


@click.command(
    epilog="""\b
    Example:
      seatrial init our-boat
      seatrial init our-boat --yes --devices vectornav,nmea@/dev/ttyUSB1@38400@5,vesc@socketcan:can0 --rpm-max 3000
      seatrial init bench --kind bench --from-found --devices vesc@socketcan:can0 --n-max 0.9"""
)
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path), default=Path())
@click.option("--kind", type=Choice(["boat", "bench"]), help="What the rig is [default: boat].")
@click.option("--name", help="Name of the rig [default: that of FOLDER].")
@click.option(
    "--devices",
    metavar="LIST",
    callback=parsed_by(_parse_devices),
    help="Devices with commas, each PROTOCOL[@PORT[@BAUD[@HZ]]], such as vesc@socketcan:can0,nmea.",
)
@click.option(
    "--from-found", "search", is_flag=True, default=None, help="Search the ports, as `seatrial devices` does."
)
@click.option(
    "--thrusters",
    metavar="NAMES",
    callback=parsed_by(_parse_names),
    help="Names of the thrusters [default: left,right; on a bench: thruster].",
)
@click.option(
    "--nodes", metavar="LIST", callback=parsed_by(_parse_nodes), help="Ids of their controllers, such as 1,2."
)
@click.option(
    "--position-m",
    "positions",
    multiple=True,
    metavar="NAME=X,Y,Z",
    callback=parsed_by(_parse_named_position),
    help="Position of a thruster: forward, starboard, down [m]; may be repeated.",
)
@click.option("--pole-pairs", type=click.IntRange(1, 100), help="Pole pairs of the motors [default: 7].")
@click.option("--rpm-max", type=_POSITIVE, help="Shaft speed at full command [rev/min; default: 3600].")
@click.option("--timeout-s", type=_POSITIVE, help="Time-out that is set in the controllers [s; default: 1].")
@click.option(
    "--lever-arm-m",
    metavar="X,Y,Z",
    callback=parsed_by(_parse_position),
    help="GNSS antenna: forward, starboard, down [m; default: 0,0,0].",
)
@click.option("--newton-per-count", type=float, help="Gain of the load cell [N/count; default: 0.001].")
@_limit_options
@click.option(
    "--yes",
    is_flag=True,
    help="Ask nothing; needs --devices or --from-found. Other values are defaults, which the file marks.",
)
@click.option("--force", is_flag=True, help=f"Replace {RIG} and {CHECKLIST} if they exist.")
def init(folder: Path, yes: bool, force: bool, **options: Any) -> None:
    """Write a rig file and a checklist of the first run to FOLDER (default: here).

    At a terminal, the command asks for each value that no option gives. An empty line takes the default. Without a
    terminal, or with --yes, the command asks nothing. The rig file marks default values as "default, check". The
    command replaces existing files only with --force. Ctrl-C before the last answer writes nothing. The command
    commands no thrust. It sends requests for the parameters of an autopilot, and nothing else, to the devices.
    """
    from seatrial.daq.config import parse_rig
    from seatrial.daq.files import require_new, write_output
    from seatrial.daq.new_rig.checklist import checklist
    from seatrial.daq.new_rig.draft import rig_text
    from seatrial.daq.new_rig.questions import Interview, draft_rig
    from seatrial.daq.rig import UNCHECKED

    rig_path, list_path = folder / RIG, folder / CHECKLIST
    for path in (rig_path, list_path):
        require_new(path, force, "FOLDER")
    interview = Interview(not yes and sys.stdin.isatty() and sys.stderr.isatty())
    if not (interview.at_terminal or options["devices"] or options["search"]):
        raise click.UsageError("without questions, give the devices with --devices, --from-found or both")
    draft, kind = draft_rig(_answers(options), folder.absolute().name or "rig", interview, _search)
    text = rig_text(_with_head(draft, kind))
    # The parser of rig files decides what is valid. An invalid answer is found here, and nothing has been written yet.
    rig = parse_rig(text, rig_path)
    write_output(rig_path, text, force)
    write_output(list_path, checklist(rig, kind), force)
    click.echo(f"written: {rig_path} and {list_path}")
    unchecked = sum(UNCHECKED in line for line in text.splitlines())
    if unchecked:
        click.echo(f'{counted(unchecked, "line")} of {rig_path} marked "{UNCHECKED}": compare them with your devices')
    quoted = shlex.quote(str(rig_path))
    click.echo(f"next: read {list_path}, then")
    click.echo(f"  seatrial check {quoted}")
    click.echo(f"  seatrial log {quoted} --duration 60 --out {shlex.quote(str(folder / 'logs' / 'still.mcap'))}")


def _answers(options: Mapping[str, Any]) -> RigAnswers:
    """Return the options of the command as answers. Limits that are None are left out.

    Raises
    ------
    click.UsageError
        If the gain of the load cell is zero or not finite.
    """
    from seatrial.daq.new_rig.questions import RigAnswers

    gain = options["newton_per_count"]
    if gain is not None and not 0.0 < abs(gain) < math.inf:
        raise click.BadParameter("must be a finite number other than zero", param_hint="--newton-per-count")
    return RigAnswers(
        kind=options["kind"],
        name=options["name"],
        devices=options["devices"] or (),
        search=options["search"],
        thrusters=options["thrusters"] or (),
        nodes=options["nodes"] or (),
        positions=dict(options["positions"]),
        pole_pairs=options["pole_pairs"],
        rpm_max=options["rpm_max"],
        timeout_s=options["timeout_s"],
        lever_arm_m=options["lever_arm_m"],
        newton_per_count=gain,
        limits={key: options[key] for key, _, _ in _LIMIT_OPTIONS if options[key] is not None},
    )


def _search() -> Sequence[DiscoveredDevice]:
    """Find the devices at all ports, as `seatrial devices --toml` does. Lines of progress are printed to stderr."""
    from seatrial.daq.tools import discover_devices, identify_autopilot

    found = discover_devices(said=lambda text: click.echo(text, err=True))
    for device in found:
        click.echo(f"  {device.port}: {device.protocol or '-'}: {device.says}", err=True)
    return [
        identify_autopilot(device.port, device.baud, True) if device.protocol == "mavlink" else device
        for device in found
    ]


def _with_head(draft: RigDraft, kind: str) -> RigDraft:
    """Return the draft with the comment at the top of its file."""
    from seatrial.daq.rig import UNCHECKED

    head = (
        f'Rig file of a {kind}, written by `seatrial init`. Keys: page "rig.toml" of the documentation',
        f'Values that nobody has given are marked "{UNCHECKED}". {CHECKLIST} has the steps before thrusters turn.',
    )
    return replace(draft, head=head)
