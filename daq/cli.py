"""Commands of daq: info, salvage, import (log is in daq.live)."""

from __future__ import annotations

from pathlib import Path

import click

_EXISTING = click.Path(exists=True, dir_okay=False, path_type=Path)
_NEW = click.Path(dir_okay=False, path_type=Path)
_FOLDER = click.Path(file_okay=False, path_type=Path)


@click.command()
@click.argument("log", type=_EXISTING)
def info(log: Path) -> None:
    """Say what a LOG holds: topics and rates, health counters, events, warnings.

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
@click.argument("log", type=_EXISTING)
@click.option("-o", "--out", type=_NEW, help="The whole log to write (default: LOG with -salvaged in its name).")
@click.option("--force", is_flag=True, help="Replace OUT where it exists.")
def salvage(log: Path, out: Path | None, force: bool) -> None:
    """Recover the LOG of a killed run or a damaged disk into a whole file.

    Every other command opens a killed log as it is; this is for tools that do not. LOG itself is left alone.

    \b
    Example:
      seatrial salvage logs/run.mcap -o logs/run-whole.mcap
    """
    from daq.salvage import salvage as run

    target = out or log.with_name(f"{log.stem}-salvaged.mcap")
    n_messages, warnings = run(log, target, force)
    for warning in warnings:
        click.echo(f"warning: {warning}", err=True)
    click.echo(f"{target}: {n_messages} messages")


@click.group("import")
def import_() -> None:
    """Turn foreign logs into MCAP.

    \b
    Example:
      seatrial import csv map.toml run.csv -o run.mcap
    """


@import_.command("csv")
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


@import_.command("raw")
@click.argument("protocol", type=click.Choice(["vectornav", "nmea", "loadcell"]))
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
