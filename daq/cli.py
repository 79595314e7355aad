"""Commands of daq: log, view, info, recover, import, devices, replay, export.

The argument LOG of a command is a file, or a folder that contains exactly one log.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import math
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from seatrial.daq.bounds import bounded
from seatrial.daq.console import make_console
from seatrial.daq.errors import SeatrialError, closest_file, closest_name, counted, printable
from seatrial.daq.log import LOG, LOG_OR_BAG
from seatrial.daq.options import Choice, ExistingPath, FiniteRange, json_option, output_option, print_json, view_option

if TYPE_CHECKING:
    from seatrial.daq.tools import DiscoveredDevice

_EXISTING = ExistingPath(dir_okay=False)
_SOURCE = ExistingPath()  # a file, or the folder of a ROS 2 bag or of the files of a run
_NEW = click.Path(dir_okay=False, path_type=Path)
_FOLDER = click.Path(file_okay=False, path_type=Path)
ROUTER_S = 1.0  # wall seconds to wait for the router of ROS 2


@contextlib.contextmanager
def _stop_signal() -> Iterator[threading.Event]:
    """Yield an event that SIGINT, SIGTERM and SIGHUP set within the `with` block, instead of their usual effect.

    The earlier handlers of these signals are restored after the block.
    """
    stop = threading.Event()
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, lambda *_: stop.set()) for number in numbers}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@click.command(epilog="Example: seatrial log rig.toml --duration 60 -o still.mcap")
@click.argument("rig", type=_EXISTING)
@click.option(
    "--duration",
    type=FiniteRange(min=0.0, min_open=True),
    metavar="S",
    help="Duration in run seconds [default: until Ctrl-C].",
)
@output_option(_NEW, "The log to write [default: named after rig and date].", metavar="FILE")
@click.option(
    "--request-rates",
    "ask",
    is_flag=True,
    help="Request the rates of RIG from autopilots. Without it no message is sent to them.",
)
@click.option("--live", "serve", is_flag=True, help="Also serve the samples to Foxglove (see [live] in the rig).")
@click.option("--ros2", is_flag=True, help="Also publish the samples to ROS 2 (see [ros2] in the rig).")
@view_option
def log(rig: Path, duration: float | None, out: Path | None, ask: bool, serve: bool, ros2: bool, view: bool) -> None:
    """Record every device of RIG until Ctrl-C, with a live table.

    Devices may be plugged in and out meanwhile; missing and silent devices are reported. The command commands no thrust
    and sends no heartbeat to an autopilot, so that the failsafes still depend on its own ground station. A log that
    exists is never overwritten. Exit status 1: no device has sent any data.

    With --request-rates, message rates and parameters are requested from autopilots; without it nothing is sent to
    them. --live also serves the samples to Foxglove, --ros2 publishes them to ROS 2, and --view serves the log as a
    page in the browser.
    """
    from seatrial.daq.acquisition import Acquisition
    from seatrial.daq.clock import RunClock
    from seatrial.daq.config import load_rig
    from seatrial.daq.tools import default_log_path, log_summary, watch

    loaded = load_rig(rig)
    path = out or default_log_path(loaded)
    if path.exists():
        raise SeatrialError(f"{path} exists, and a log is never overwritten; give another name with -o")
    clock = RunClock(loaded.speed)
    console = make_console()
    with (
        _stop_signal() as stop,
        contextlib.ExitStack() as outer,  # for what may end slowly, after the log is closed
        Acquisition(loaded, path, clock=clock, ask=ask) as acquisition,
        contextlib.ExitStack() as stack,
    ):
        if serve:
            from seatrial.daq.tools import LiveServer

            server = stack.enter_context(LiveServer(loaded, acquisition.status))
            console.print(f"live at {server.address}", markup=False)
        if view:
            from seatrial.daq.view import live_page

            console.print(f"page at {outer.enter_context(live_page(path))}", markup=False)
        if ros2:
            from seatrial.daq.tools import Ros2Node

            node = outer.enter_context(Ros2Node(loaded))
            console.print(node.await_router(ROUTER_S), markup=False)
            acquisition.stream(node.put)
            outer.callback(lambda: console.print(node.summary(), markup=False))
        deadline = math.inf if duration is None else clock.now() + duration
        watch(acquisition, loaded, clock, deadline, stop, console)
        if not stop.is_set():
            acquisition.end_reason = f"the duration of {duration:g} s has ended"
    last = acquisition.status()
    console.print(log_summary(last, path, loaded.speed), soft_wrap=True, markup=False)
    if not any(port.samples for port in last.ports.values()):
        raise SeatrialError(
            f"{path}: no device sent any data; check power and cables, and compare ports and baud rates in {rig} with "
            "`seatrial devices`"
        )


def _with_browser(command: Callable[..., None]) -> Callable[..., None]:
    """Decorate a command with `--browser/--no-browser`. It receives `show`, a function that opens an address.

    The process that opens the browser is started before the limits of `bounded`, which a browser would inherit.
    """

    @functools.wraps(command)
    def run(browser: bool, **options: Any) -> None:
        """Run the command with a function that opens an address, or does nothing with `--no-browser`."""
        from seatrial.daq.view import prepare_browser

        command(show=prepare_browser() if browser else lambda address: None, **options)

    return click.option("--browser/--no-browser", default=True, help="Whether to open the page in a browser.")(run)


@click.command()
@click.argument("logs", nargs=-1, required=True, type=LOG)
@click.option(
    "--port",
    type=click.IntRange(0, 65_535),
    default=0,
    show_default=True,
    help="Port of this computer; 0: any free one.",
)
@_with_browser
@bounded("logs", serves=True)
def view(logs: tuple[Path, ...], port: int, show: Callable[[str], None]) -> None:
    """Show LOGS as a page in the browser of this computer, until Ctrl-C: signals, track, events and health.

    Intervals that are selected on the page become --from and --to of `seatrial ident`, or [[log]] tables of an import
    map. A log that is still being written is read on. The page only reads, and needs the token in its address.

    \b
    Example:
      seatrial view logs/run.mcap
    """
    from seatrial.daq.view import PageServer, ViewedLog, listen, new_token

    listening = listen(port)
    with _stop_signal() as stop, PageServer([ViewedLog(log) for log in logs], listening, new_token()) as server:
        thread = threading.Thread(target=server.serve_forever, name="page", daemon=True)
        thread.start()
        click.echo(f"{server.address}  (Ctrl-C ends it)")
        show(server.address)
        stop.wait()
        server.shutdown()


@click.command()
@click.argument("log", type=LOG_OR_BAG)
@json_option()
@bounded("log")
def info(log: Path, as_json: bool) -> None:
    """Show the content of a LOG with all its segments: topics and rates, health counters, events, warnings.

    LOG may also be the folder of a single log, or a bag of ROS 1 or ROS 2, whose topics are listed with their types,
    numbers of messages and rates. A bag needs an import before other commands. The longest gap of a topic has no lower
    limit. `seatrial check` judges gaps: longer than 1 s and 10 sample intervals, they are missing sections.

    \b
    Example:
      seatrial info logs/run.mcap
      seatrial info bag_folder
    """
    from seatrial.daq.log import is_bag, open_log
    from seatrial.daq.tools import bag_content, log_content, show_log

    if is_bag(log):
        from seatrial.daq.importers.ros import bag_receipts

        content = bag_content(log, *bag_receipts(log))
    else:
        with open_log(log) as opened:
            content = log_content(opened)
    if as_json:
        print_json(content)
    else:
        show_log(content, make_console())


@click.command()
@click.argument("log", type=LOG)
@output_option(_NEW, "The log to write (default: LOG with -recovered in its name).")
@click.option("--force", is_flag=True, help="Replace OUT if it exists.")
@json_option()
@bounded("log")
def recover(log: Path, out: Path | None, force: bool, as_json: bool) -> None:
    """Recover the LOG of a killed run or a damaged disk, with all its segments, into one complete file.

    All other commands can open an incomplete log; this command is for tools that cannot. LOG itself is not changed.
    Faults of LOG are printed as warnings.

    \b
    Example:
      seatrial recover logs/run.mcap -o logs/run-whole.mcap
    """
    from seatrial.daq.log import recover_log as run

    target = out or log.with_name(f"{log.stem}-recovered.mcap")
    done = run(log, target, force)
    for warning in done.warnings:
        click.echo(f"warning: {log}: {warning}", err=True)
    if as_json:
        print_json({"format": "seatrial-recover 1", "log": log, "out": target, **done._asdict()})
        return
    pieces = f" of {done.files} segments" if done.files > 1 else ""
    condition = "" if done.warnings else "; nothing was wrong with it"
    click.echo(f"{target}: {counted(done.messages, 'message')}{pieces}{condition}")


class _ImportGroup(click.Group):
    """Command group `seatrial import`. If its first argument is not a sub-command, the sub-command `map` is meant."""

    default = "map"

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments, after `map` was put before them if the first one is no sub-command and no help option.

        Return the arguments that are left for the sub-command, as the method of click does. Without arguments the help
        text is printed. It is a usage error if the first argument is no existing file or folder, does not look like a
        file, and is probably a misspelling or an abbreviation of a sub-command (`closest_name`).
        """
        if args and args[0] not in (*self.commands, "-h", "--help"):
            near = closest_name(args[0], self.commands)
            # A name with an ending, or with a similar file beside it, is a misspelt file.
            is_file = bool(Path(args[0]).suffix) or closest_file(Path(args[0])) is not None
            if near and not is_file and not Path(args[0]).exists():
                raise click.UsageError(f"No such file or command {args[0]!r}. Did you mean {near!r}?", ctx)
            args = [self.default, *args]
        return super().parse_args(ctx, args)


@click.group("import", cls=_ImportGroup)
def import_() -> None:
    """Turn foreign logs into MCAP.

    `seatrial import MAP.toml SOURCE...` reads signals, which a map selects, from CSV and other text, bags of ROS 1 and
    2, PX4 (.ulg), ArduPilot (tlog, BIN), MATLAB (.mat), LabVIEW (.lvm), FlySight 2, Parquet and CAN logs. `seatrial
    import --guess SOURCE` writes the map. The sub-commands decode recorded bytes of a supported device, as if this
    program had recorded them.

    \b
    Example:
      seatrial import --guess run.bag > map.toml
      seatrial import map.toml run.bag -o run.mcap
    """


@import_.command("map", short_help="MAP SOURCE...: signals by a map; the word map may be left out.")
@click.argument("sources", metavar="MAP SOURCE...", type=_SOURCE, nargs=-1, required=True)
@click.option(
    "--guess",
    is_flag=True,
    help="Write a map of SOURCE, to the screen or to -o, with its caveats. Give all files that will share the map.",
)
@click.option("--dbc", type=_EXISTING, help="With --guess: the DBC file that describes the frames of a CAN log.")
@output_option(_NEW, "The log (or the map) to write, if it is a single one.")
@click.option("--out-dir", type=_FOLDER, help="Folder for the logs, named after the sources (default: here).")
@click.option("--force", is_flag=True, help="Replace files that exist.")
@json_option("Print the paths of the logs, or the guessed map, as JSON, and everything else on stderr.")
@bounded("sources", "dbc")
def import_map(
    sources: tuple[Path, ...],
    guess: bool,
    dbc: Path | None,
    out: Path | None,
    out_dir: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Turn SOURCEs (files, folders of ROS 2 bags, or folders of the files of a run) into logs by a MAP to signals.

    The first argument is the MAP, which the page "Import of foreign logs" of the documentation describes. With --guess
    there is no MAP: a guessed map of the first SOURCE is written, with one scale of the thrusters for all. Of a folder,
    or of files of different columns at the same time, the map has a [[file]] for each kind of file. A file that exists
    is replaced only with --force.

    \b
    Example:
      seatrial import map boat.toml runs/*.csv --out-dir logs
      seatrial import --guess run2.ulg -o px4.toml
      seatrial import --guess data/run1 data/run2 -o map.toml
      seatrial import map.toml data/run1 data/run2 --out-dir logs
      seatrial import --guess candump.log --dbc boat.dbc -o can.toml
    """
    if guess:
        _write_guessed_map(sources, dbc, out, force, as_json)
        return
    if dbc is not None:
        raise click.UsageError("--dbc applies only with --guess; in an import map, write the file as dbc in [can]")
    from seatrial.daq.importers.import_files import import_files as run

    if out is not None and out_dir is not None:
        raise click.UsageError("give -o or --out-dir, not both")
    if len(sources) < 2:
        raise click.UsageError(
            "give an import map and one or more source files; --guess writes an import map of a source file"
        )
    if sources[0].suffix != ".toml" and (maps := [s for s in sources if s.suffix == ".toml"]):
        raise click.UsageError(f"{sources[0]}: the import map {maps[0]} comes first, then its source files")
    written = run(sources[0], sources[1:], out=out, out_dir=out_dir, force=force)
    if as_json:
        print_json({"format": "seatrial-import 1", "map": sources[0], "sources": sources[1:], "logs": written})
        return
    for path in written:
        click.echo(printable(str(path)))


def _write_guessed_map(
    sources: tuple[Path, ...], dbc: Path | None, out: Path | None, force: bool, as_json: bool
) -> None:
    """Write the guessed import map of source files to the file `out`, or to the screen if `out` is None.

    An import map selects columns or topics of the source and names their signals. `dbc` is the file that describes the
    frames of a CAN log. An existing file is replaced if `force` is true; otherwise it is an error. Of several runs, the
    map is that of the first, and a scale that is guessed from numbers is that of all. If the first run does not suffice
    for a fit, a warning is printed, and so is each assumption on the runs. `as_json` is the flag `--json`.
    """
    from seatrial.daq.files import write_output
    from seatrial.daq.importers.guess import guess_maps
    from seatrial.daq.importers.write_log import replacing

    if not sources:
        raise click.UsageError("--guess takes one source file or folder, or several that share a map")
    found = guess_maps(sources, dbc, None if out is None else out.parent)[0]
    if out is not None:
        with replacing(out, force, [*sources, *found.run.paths]) as part:
            write_output(part, found.text)
    for line in found.assumed:
        click.echo(printable(f"warning: {line}"), err=True)
    if as_json:
        content = {"source": sources[0], "map": out, "text": found.text, "problem": found.problem}
        print_json({"format": "seatrial-import-guess 1", **content})
    elif out is None:
        click.echo(found.text, nl=False)
    else:
        click.echo(printable(str(out)))
    if found.problem:
        click.echo(f"warning: {sources[0]}: no model can be fitted to these signals: {found.problem}", err=True)


def _print_import(source: Path, log: Path, content: str, as_json: bool) -> None:
    """Print the path of the log of an imported file and its content in words, with `as_json` as a JSON document."""
    if as_json:
        print_json({"format": "seatrial-import 1", "sources": [source], "logs": [log], "content": content})
    else:
        click.echo(f"{log}: {content}")


@import_.command("can", short_help="A CAN log (candump, .asc, .blf), decoded as if the rig had recorded it.")
@click.argument("rig", type=_EXISTING)
@click.argument("file", type=_EXISTING)
@output_option(_NEW, "The log to write (default: named after FILE, here).")
@click.option("--force", is_flag=True, help="Replace the log if it exists.")
@json_option("Print path and content of the log as JSON, and everything else on stderr.")
@bounded("rig", "file")
def import_can(rig: Path, file: Path, out: Path | None, force: bool, as_json: bool) -> None:
    """Turn FILE, a CAN log, into the log that RIG would have recorded: raw frames and samples of its CAN devices.

    For signals that a DBC file describes, or without a rig, import by a map: `seatrial import --guess FILE`.

    \b
    Example:
      seatrial import can boat.toml candump.log -o run.mcap
    """
    from seatrial.daq.importers.can_log import import_can as run

    path, summary = run(file, rig, out=out, force=force)
    _print_import(file, path, summary, as_json)


@import_.command("mavlink", short_help="A tlog of a ground station or a DataFlash log of ArduPilot.")
@click.argument("file", type=_EXISTING)
@click.option("--rig", "rig_path", type=_EXISTING, help="Names the thrusters and scales their outputs.")
@click.option("--system", type=click.IntRange(1, 255), help="System id of the autopilot (default: the first one).")
@output_option(_NEW, "The log to write (default: named after FILE, here).")
@click.option("--force", is_flag=True, help="Replace the log if it exists.")
@json_option("Print path and content of the log as JSON, and everything else on stderr.")
@bounded("file", "rig_path")
def import_mavlink(
    file: Path, rig_path: Path | None, system: int | None, out: Path | None, force: bool, as_json: bool
) -> None:
    """Turn FILE, a ground station's tlog or an ArduPilot DataFlash log (BIN), into a log.

    With --rig the outputs become the thrusters' n; without it they stay pulses in us, servo_1, servo_2, ... With
    --system the autopilot with this system id is read from a tlog; without it the first one with a heartbeat. Without
    -o the log gets the name of FILE, in the current folder. A log that exists is replaced only with --force.

    \b
    Example:
      seatrial import mavlink steps.tlog --rig boat.toml -o steps.mcap
    """
    from seatrial.daq.config import load_rig
    from seatrial.daq.importers.mavlink import import_mavlink as run

    rig = None if rig_path is None else load_rig(rig_path)
    path, summary = run(file, rig=rig, system=system, out=out, force=force)
    _print_import(file, path, summary, as_json)


def _serial_protocol(context: click.Context, parameter: click.Parameter, name: str) -> str:
    """Return the argument `name` unchanged if it is the name of a serial protocol. An unknown name is a usage error.

    The known names are listed at run time, because other packages may add some.
    """
    from seatrial.daq.protocol import serial_protocols

    return str(Choice(serial_protocols()).convert(name, parameter, context))


@import_.command("raw", short_help="Recorded bytes of a device, decoded by its protocol.")
@click.argument("protocol", callback=_serial_protocol)
@click.argument("file", type=_EXISTING)
@click.option(
    "--rate", type=FiniteRange(min=0.0, min_open=True), help="Samples per second, from which the times are computed."
)
@output_option(_NEW, "The log to write (default: named after FILE, here).")
@click.option("--force", is_flag=True, help="Replace the log if it exists.")
@json_option("Print path and content of the log as JSON, and everything else on stderr.")
@bounded("file")
def import_raw(protocol: str, file: Path, rate: float | None, out: Path | None, force: bool, as_json: bool) -> None:
    """Decode FILE, recorded bytes of a device, as PROTOCOL: vectornav, mip, nmea, ubx, loadcell, openscale,
    mantracourt, or a serial protocol that another installed package adds.

    Recorded bytes have no times of receipt. With --rate the samples are evenly spaced. Without it they get the times
    that the device sends, if any.

    \b
    Example:
      seatrial import raw vectornav standing_still.txt --rate 40 -o still.mcap
    """
    from seatrial.daq.importers.raw import import_raw as run

    path, summary = run(protocol, file, rate=rate, out=out, force=force)
    _print_import(file, path, summary, as_json)


def _check_addresses(_context: click.Context, _parameter: click.Parameter, ports: tuple[str, ...]) -> tuple[str, ...]:
    """Return the arguments `ports` unchanged, after a check of those that are network addresses, such as udp:HOST:PORT.

    A wrong address is a usage error. Device files and CAN buses are not checked.
    """
    from seatrial.daq.rig import NET_KINDS, parse_address

    for port in ports:
        if port.partition(":")[0] in NET_KINDS:
            try:
                parse_address(port)
            except ValueError as error:
                raise click.BadParameter(str(error)) from None
    return ports


@click.command()
@click.argument("ports", nargs=-1, metavar="[PORT]...", callback=_check_addresses)
@click.option(
    "--baud",
    "bauds",
    type=click.IntRange(min=1),
    multiple=True,
    help="Try this rate only, with every protocol; may be repeated.",
)
@click.option(
    "--seconds",
    type=FiniteRange(min=0.1),
    default=1.3,
    show_default=True,
    help="How long to listen at each baud rate [s].",
)
@click.option("--toml", is_flag=True, help="Print a rig file with its [[device]] tables.")
@json_option()
def devices(ports: tuple[str, ...], bauds: tuple[int, ...], seconds: float, toml: bool, as_json: bool) -> None:
    """Find the serial ports and CAN buses of this machine, or of PORTs, and identify the protocol of each device.

    The command only listens, at one baud rate after the other. PORT may be the address of an autopilot on a network, as
    udp:HOST:PORT or tcp:HOST:PORT. With --toml the parameters of an autopilot at a given PORT are requested; no
    parameter is changed. The rig file then also contains its thrusters. Comments that begin with "caveat" also mark
    values that you have to measure.

    \b
    Example:
      seatrial devices
      seatrial devices /dev/ttyUSB0 --toml
      seatrial devices udp:127.0.0.1:14550 --toml > autopilot.toml
    """
    if toml and as_json:
        raise click.UsageError("give --toml or --json, not both")
    from seatrial.daq.rig import NET_KINDS
    from seatrial.daq.tools import discover_devices, identify_autopilot, identify_protocol
    from seatrial.daq.transport import UDEV_RULE

    def print_progress(text: str) -> None:
        """Print a line of progress to stderr."""
        click.echo(text, err=True)

    def identify(port: str) -> DiscoveredDevice:
        """Return the device at a device file, CAN bus or network address, with its protocol.

        An address on a network is taken as that of an autopilot. An autopilot is also asked for its parameters if a rig
        file is printed (--toml). A port without a known device, or that cannot be opened, gives a device with an empty
        protocol and the reason in `says`.
        """
        if port.partition(":")[0] in NET_KINDS:
            return identify_autopilot(port, 0, toml)
        device = identify_protocol(port, bauds=bauds, listen=seconds)
        return identify_autopilot(port, device.baud, True) if toml and device.protocol == "mavlink" else device

    found = [identify(port) for port in ports] if ports else discover_devices(seconds, bauds, print_progress)
    if not found:
        raise SeatrialError("this computer has no serial port and no CAN bus; plug the device in, or name its port")
    is_known = any(device.protocol or device.port.startswith("socketcan:") for device in found)
    if toml and is_known:  # a rig file without devices would be used
        click.echo(_rig_of(found), nl=False)
    if as_json:
        print_json({"format": "seatrial-devices 1", "devices": [dataclasses.asdict(device) for device in found]})
    for device in found:
        if not (toml or as_json):
            speed = f" at {device.baud} baud" * bool(device.baud)
            rate = f", {device.rate:.4g}/s" if math.isfinite(device.rate) else ""
            protocol = f"{device.protocol}{speed}{rate}" if device.protocol else "-"
            about = f" ({device.description})" if device.description and device.description != "n/a" else ""
            click.echo(f"{device.port}{about}: {protocol}: {device.says}")
        if device.hint:
            click.echo(f"hint: {device.port}: {device.hint}", err=True)
    if any("latency_timer" in device.hint for device in found):
        click.echo(f"hint: to make it permanent, put this into a file in /etc/udev/rules.d: {UDEV_RULE}", err=True)
    if not is_known and all(device.port.partition(":")[0] in NET_KINDS for device in found):
        raise SeatrialError(
            f"no device was recognised at {', '.join(device.port for device in found)}; check host and port of the "
            "address, that the autopilot is powered, and that it sends there"
        )
    if not is_known:
        raise SeatrialError(
            f"no device was recognised at {', '.join(device.port for device in found)}; check that it is powered and "
            "that its output is switched on, or give its baud rate with --baud"
        )


def _rig_of(found: Sequence[DiscoveredDevice]) -> str:
    """Return the text of a rig file with the discovered devices that have a protocol of a rig file."""
    from seatrial.daq.new_rig import RigDraft, Value, drafts_of, rig_text

    return rig_text(RigDraft(Value("boat", False), drafts_of(found)))


@click.command()
@click.argument("log", type=LOG)
@click.option(
    "--dir", "folder", type=_FOLDER, default="ports", show_default=True, help="Folder in which the ports are made."
)
@click.option("--device", "names", multiple=True, help="Only this device; may be repeated.")
@click.option(
    "--speed", type=FiniteRange(min=0.0, min_open=True), default=1.0, show_default=True,
    help="Recorded seconds per second.",
)  # fmt: skip
def replay(log: Path, folder: Path, names: tuple[str, ...], speed: float) -> None:
    """Send the raw bytes of LOG again, on ports DIR/DEVICE, at their times of receipt.

    The replay begins when every port has a reader. `seatrial log DIR/replay.toml` records the log again; that file is
    the rig of the log with these ports. With --device only the named devices are replayed, otherwise all with raw
    bytes. A CAN bus is replayed as an slcan adapter. Ctrl-C ends the replay. At the end the ports and the file are
    deleted.

    \b
    Example:
      seatrial replay logs/run.mcap --dir ports --speed 2
    """
    from seatrial.daq.log import open_log
    from seatrial.daq.tools import replay_log as run

    with _stop_signal() as stop, open_log(log) as opened:
        n = run(opened, names, folder, speed=speed, said=click.echo, stopped=stop.is_set)
    click.echo(f"{counted(n, 'byte')} sent")


@click.command()
@click.argument("form", type=Choice(["csv", "parquet", "mat", "netcdf", "ros"]))
@click.argument("log", type=LOG)
@output_option(_FOLDER, "Folder for the files; made if it does not exist.", required=True)
@click.option("--force", is_flag=True, help="Replace files that exist.")
@click.option(
    "--rate",
    type=FiniteRange(min=0.0, min_open=True),
    help="One table of all signals at this rate, Hz (default of mat and netcdf: 10).",
)
@click.option("--from", "t_from", type=FiniteRange(0.0), default=0.0, help="Start [s of the log].")
@click.option("--to", "t_to", type=FiniteRange(0.0), help="End [s of the log].")
@click.option(
    "--relative",
    is_flag=True,
    help="Times in s from the first sample of the log, as --from and --to have them; without it in s since 1970.",
)
@click.option(
    "--noise",
    type=_EXISTING,
    help="With ros: noise.toml of `seatrial ident noise`, for the covariances of imported signals.",
)
def export(
    form: str,
    log: Path,
    out: Path,
    force: bool,
    rate: float | None,
    t_from: float,
    t_to: float | None,
    relative: bool,
    noise: Path | None,
) -> None:
    """Write LOG as files of FORM.

    csv and parquet: a table for each device and kind of sample, and the events; with --rate one table of all signals.
    mat and netcdf: always one table. ros: a bag of ROS 2 with the logged messages and with messages in the axes and
    frames of REP-103 and REP-105, the package seatrial_msgs for colcon, and layouts for Foxglove and PlotJuggler. With
    --from and --to only a part of the log is read. Times are in s since 1970, and with --relative in s of the log.

    \b
    Examples:
      seatrial export csv logs/run.mcap --out run-csv
      seatrial export mat logs/run.mcap --rate 20 --from 600 --to 1200 --out run-mat
      seatrial export ros logs/run.mcap --out run-ros
      seatrial export ros imported.mcap --noise noise/noise.toml --out imported-ros
    """
    from seatrial.daq.log import first_sample, open_log
    from seatrial.daq.tools import declared_noise, export_log, export_resampled, export_ros

    if form == "ros" and rate is not None:
        raise click.UsageError(
            "--rate does not apply to ros, which exports the messages as they were logged; leave it out"
        )
    if form == "ros" and relative:
        raise click.UsageError("--relative does not apply to ros, whose messages have the time of ROS; leave it out")
    if form != "ros" and noise is not None:
        raise click.UsageError("--noise applies only to ros, whose messages have covariances; leave it out")
    deviations = {} if noise is None else declared_noise(noise)
    t_to = math.inf if t_to is None else t_to
    with open_log(log) as opened:
        first = first_sample(opened)
        part, zero = opened, first if relative else 0.0
        if t_from > 0.0 or t_to < math.inf:
            part = opened.part(first + t_from, first + t_to)
        if not t_from < t_to:
            raise SeatrialError(f"--to {t_to:g} s is not after --from {t_from:g} s; give a later end")
        if part.start > opened.end:
            until = f" to {t_to:g} s" if t_to < math.inf else " s on"
            raise SeatrialError(
                f"{log}: no data from {t_from:g}{until}; it has {opened.duration:.0f} s: give other --from and --to"
            )
        for warning in part.warnings:
            click.echo(f"warning: {log}: {warning}", err=True)
        if rate is not None:
            written = [export_resampled(part, form, out, rate, force, zero)]
        else:
            ros = form == "ros"
            written = export_ros(part, out, force, deviations) if ros else export_log(part, form, out, force, zero)
        for path in written:
            click.echo(printable(str(path)))
