"""Commands of daq: info, salvage, import (log is in daq.live)."""

from __future__ import annotations

from pathlib import Path

import click

from daq.cli_log import LOG
from daq.device_table import SERIAL_PROTOCOLS
from daq.errors import counted

_EXISTING = click.Path(exists=True, dir_okay=False, path_type=Path)
_NEW = click.Path(dir_okay=False, path_type=Path)
_FOLDER = click.Path(file_okay=False, path_type=Path)


@click.command()
@click.argument("log", type=LOG)
def info(log: Path) -> None:
    """Say what a LOG holds, all its segments: topics and rates, health counters, events, warnings.

    LOG may be the folder of a single log, too.

    \b
    Example:
      seatrial info logs/run.mcap
    """
    from rich.console import Console

    from daq.info import show
    from daq.log import open_log

    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = 140  # a pipe has no width of its own
    with open_log(log) as opened:
        show(opened, console)


@click.command()
@click.argument("log", type=LOG)
@click.option("-o", "--out", type=_NEW, help="The whole log to write (default: LOG with -salvaged in its name).")
@click.option("--force", is_flag=True, help="Replace OUT where it exists.")
def salvage(log: Path, out: Path | None, force: bool) -> None:
    """Recover the LOG of a killed run or a damaged disk, all its segments, into one whole file.

    Every other command opens a killed log as it is; this is for tools that do not. LOG itself is left alone.

    \b
    Example:
      seatrial salvage logs/run.mcap -o logs/run-whole.mcap
    """
    from daq.salvage import salvage as run

    target = out or log.with_name(f"{log.stem}-salvaged.mcap")
    done = run(log, target, force)
    for warning in done.warnings:
        click.echo(f"warning: {warning}", err=True)
    pieces = f" of {done.files} segments" if done.files > 1 else ""
    fine = "" if done.warnings else "; nothing was wrong with it"
    click.echo(f"{target}: {counted(done.messages, 'message')}{pieces}{fine}")


@click.group("import")
def import_() -> None:
    """Turn foreign logs into MCAP.

    \b
    Example:
      seatrial import csv map.toml run.csv -o run.mcap
    """


@import_.command("csv", short_help="CSV files, by a map that says which column is what.")
@click.argument("map_", metavar="MAP", type=_EXISTING)
@click.argument("files", metavar="FILE...", type=_EXISTING, nargs=-1, required=True)
@click.option("-o", "--out", type=_NEW, help="The log to write, where it is a single one.")
@click.option("--out-dir", type=_FOLDER, help="Folder for the logs, named after the files (default: here).")
@click.option("--force", is_flag=True, help="Replace logs that exist.")
def import_csv(map_: Path, files: tuple[Path, ...], out: Path | None, out_dir: Path | None, force: bool) -> None:
    """Turn CSV files into logs by a MAP that says which column is which signal.

    The map is described in docs/formats/import-csv.md.

    \b
    Example:
      seatrial import csv docs/examples/blueboat/blueboat.toml runs/*.csv --out-dir logs
    """
    from daq.imports.csv_import import import_csv as run

    if out is not None and out_dir is not None:
        raise click.UsageError("give -o or --out-dir, not both")
    for path in run(map_, files, out=out, out_dir=out_dir, force=force):
        click.echo(str(path))


@import_.command("mavlink", short_help="A tlog of a ground station or a DataFlash log of ArduPilot.")
@click.argument("file", type=_EXISTING)
@click.option("--rig", "rig_path", type=_EXISTING, help="Names the thrusters and scales their outputs.")
@click.option("--system", type=click.IntRange(1, 255), help="Which system (default: the first autopilot).")
@click.option("-o", "--out", type=_NEW, help="The log to write (default: named after FILE, here).")
@click.option("--force", is_flag=True, help="Replace the log where it exists.")
def import_mavlink(file: Path, rig_path: Path | None, system: int | None, out: Path | None, force: bool) -> None:
    """Turn FILE, a ground station's tlog or an ArduPilot DataFlash log (BIN), into a log.

    With --rig the outputs become the thrusters' n; without it they stay pulses in us, servo_1, servo_2, ...

    \b
    Example:
      seatrial import mavlink steps.tlog --rig boat.toml -o steps.mcap
    """
    from daq.imports.mavlink_import import import_mavlink as run
    from daq.rig import load_rig

    rig = None if rig_path is None else load_rig(rig_path)
    path, said = run(file, rig=rig, system=system, out=out, force=force)
    click.echo(f"{path}: {said}")


@import_.command("raw", short_help="Bytes that a device once sent, decoded by its protocol.")
@click.argument("protocol", type=click.Choice(SERIAL_PROTOCOLS))
@click.argument("file", type=_EXISTING)
@click.option("--rate", type=click.FloatRange(min=0.0, min_open=True), help="Samples a second, for the times.")
@click.option("-o", "--out", type=_NEW, help="The log to write (default: named after FILE, here).")
@click.option("--force", is_flag=True, help="Replace the log where it exists.")
def import_raw(protocol: str, file: Path, rate: float | None, out: Path | None, force: bool) -> None:
    """Decode FILE, the bytes that a device once sent, as PROTOCOL.

    A capture says nothing of when its bytes came: with --rate the samples are put evenly apart; without it they
    get the times that the device itself sends, where it sends any.

    \b
    Example:
      seatrial import raw vectornav standing_still.txt --rate 40 -o still.mcap
    """
    from daq.imports.raw_import import import_raw as run

    path, said = run(protocol, file, rate=rate, out=out, force=force)
    click.echo(f"{path}: {said}")


@import_.command("ros2", short_help="A ROS 2 bag, a file or a folder, MCAP or sqlite3.")
@click.argument("bag", type=click.Path(exists=True, path_type=Path))
@click.option("--topic", "topics", multiple=True, metavar="TOPIC[=NAME]", help="Take this one only; may be repeated.")
@click.option(
    "--axes", type=click.Choice(["ros", "ned"]), default="ros", show_default=True,
    help="ros: forward, left, up and east, north, up (REP-103); ned: ours.",
)  # fmt: skip
@click.option("-o", "--out", type=_NEW, help="The log to write (default: named after BAG, here).")
@click.option("--force", is_flag=True, help="Replace the log where it exists.")
def import_ros2(bag: Path, topics: tuple[str, ...], axes: str, out: Path | None, force: bool) -> None:
    """Turn BAG, a ROS 2 bag (a file or a folder, MCAP or sqlite3), into a log.

    Imu becomes attitude and rates, NavSatFix positions; of all else every number becomes a signal.

    \b
    Example:
      seatrial import ros2 run1 --topic /imu/data=ahrs --topic /fix=gnss -o run1.mcap
    """
    from daq.imports.ros2_import import import_ros2 as run

    wanted = dict(word.partition("=")[::2] for word in topics)
    path, said = run(bag, topics=wanted or None, axes=axes, out=out, force=force)
    click.echo(f"{path}: {said}")


@import_.command("ulog", short_help="A flight log of PX4 (.ulg).")
@click.argument("file", type=_EXISTING)
@click.option("-o", "--out", type=_NEW, help="The log to write (default: named after FILE, here).")
@click.option("--force", is_flag=True, help="Replace the log where it exists.")
def import_ulog(file: Path, out: Path | None, force: bool) -> None:
    """Turn FILE, a flight log of PX4 (.ulg), into a log.

    \b
    Example:
      seatrial import ulog log_5.ulg -o run5.mcap
    """
    from daq.imports.ulog_import import import_ulog as run

    path, said = run(file, out=out, force=force)
    click.echo(f"{path}: {said}")
