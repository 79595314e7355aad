"""Commands of daq: devices, replay and export."""

from __future__ import annotations

import signal
import threading
from pathlib import Path

import click

from daq.cli_log import LOG
from daq.errors import SeatrialError, counted

_FOLDER = click.Path(file_okay=False, path_type=Path)


@click.command()
@click.argument("ports", nargs=-1, metavar="[PORT]...")
@click.option("--baud", "bauds", type=click.IntRange(min=1), multiple=True, help="Try this rate only; may be repeated.")
@click.option(
    "--seconds", type=click.FloatRange(min=0.1), default=1.3, show_default=True, help="To listen at each baud rate."
)
@click.option("--toml", is_flag=True, help="Print [[device]] tables for the rig file.")
def devices(ports: tuple[str, ...], bauds: tuple[int, ...], seconds: float, toml: bool) -> None:
    """Find the serial ports and CAN buses of this machine, or look at PORTs, and recognise what speaks there.

    Only listens: nothing is sent to a port. Each is tried at one baud rate after the other.

    \b
    Example:
      seatrial devices
      seatrial devices /dev/ttyUSB0 --toml
    """
    from daq.find_devices import find, recognise
    from daq.latency import UDEV_RULE

    def say(text: str) -> None:
        click.echo(text, err=True)

    found = [recognise(port, bauds=bauds, listen=seconds) for port in ports] if ports else find(seconds, bauds, say)
    if not found:
        raise SeatrialError("there is no serial port and no CAN bus; plug the device in, or name its port")
    for k, one in enumerate(found, start=1):
        if toml and one.protocol in _rig_protocols():
            click.echo(one.toml(f"{one.protocol}{k}"))
        elif not toml:
            at = f"{one.protocol} at {one.baud} baud, {one.rate:.4g}/s" if one.protocol else "-"
            about = f" ({one.description})" if one.description and one.description != "n/a" else ""
            click.echo(f"{one.port}{about}: {at}: {one.says}")
        if one.hint:
            click.echo(f"hint: {one.port}: {one.hint}", err=True)
    if any("latency_timer" in one.hint for one in found):
        click.echo(f"hint: for good, in a file of /etc/udev/rules.d: {UDEV_RULE}", err=True)
    if not any(one.protocol or one.port.startswith("socketcan:") for one in found):
        raise SeatrialError("no device was recognised; is it powered, and is its output switched on?")


def _rig_protocols() -> tuple[str, ...]:
    from daq.device_table import DEVICES

    return tuple(DEVICES)


@click.command()
@click.argument("log", type=LOG)
@click.option("--dir", "folder", type=_FOLDER, default="ports", show_default=True, help="Where the ports are made.")
@click.option("--device", "names", multiple=True, help="Only this device; may be repeated.")
@click.option(
    "--speed", type=click.FloatRange(min=0.0, min_open=True), default=1.0, show_default=True,
    help="Recorded seconds a second.",
)  # fmt: skip
def replay(log: Path, folder: Path, names: tuple[str, ...], speed: float) -> None:
    """Send the raw bytes of LOG again, on ports DIR/DEVICE, at the times at which they came.

    Begins when every port has a reader: `seatrial log DIR/replay.toml`, which is the log's own rig with these ports,
    records the log anew. A CAN bus comes back as an slcan adapter. Ctrl-C ends it.

    \b
    Example:
      seatrial replay logs/run.mcap --dir ports --speed 2
    """
    from daq.log import open_log
    from daq.replay import replay as run

    stop = threading.Event()
    before = {number: signal.signal(number, lambda *_: stop.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        with open_log(log) as opened:
            n = run(opened, names, folder, speed=speed, said=lambda text: click.echo(text), stopped=stop.is_set)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    click.echo(f"{counted(n, 'byte')} sent")


@click.command()
@click.argument("form", type=click.Choice(["csv", "parquet"]))
@click.argument("log", type=LOG)
@click.option("-o", "--out", type=_FOLDER, required=True, help="Folder for the files; made where it is not there.")
@click.option("--force", is_flag=True, help="Replace files that exist.")
def export(form: str, log: Path, out: Path, force: bool) -> None:
    """Write the tables of LOG as files of FORM, csv or parquet: one a device and kind, and the events.

    \b
    Example:
      seatrial export csv logs/run.mcap --out run-csv
    """
    from daq.export import export as run
    from daq.log import open_log

    with open_log(log) as opened:
        for warning in opened.warnings:
            click.echo(f"warning: {warning}", err=True)
        for path in run(opened, form, out, force):
            click.echo(str(path))
