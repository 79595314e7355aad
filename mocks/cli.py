"""`seatrial mock boat RIG` and `seatrial mock bench RIG`: simulated devices at the ports of a rig."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from seatrial.daq.config import load_rig
from seatrial.daq.errors import SeatrialError
from seatrial.daq.rig import LoadCellCalibration, Rig, Thruster
from seatrial.mocks.devices import KINDS, LOOP_HZ, Faults, by_side, make_emulator, parse_fault
from seatrial.mocks.hidden_effects import catalogue
from seatrial.mocks.plant import Bench, Boat, draw_bench, draw_boat, draw_thruster
from seatrial.mocks.plant import bench as bench_plant
from seatrial.mocks.ports import NetPort, PtyPort
from seatrial.mocks.random_streams import FAULT, random_stream
from seatrial.mocks.sensors import CellSpec
from seatrial.mocks.server import Server
from seatrial.mocks.truth_file import ground_truth, write_truth
from seatrial.mocks.world import DeviceSpecs, EscSpec, World, bench_world, boat_world

GPS_HZ, ESC_HZ = 5.0, 10.0  # of an autopilot
RPM_MAX = 4500.0  # of a thruster whose rig does not say
LATE = 0.1  # wall s of lag from which the last line is a warning
_FAULT_HELP = "; ".join(f"{name}: {kind.text}" for name, kind in KINDS.items())

Command = Callable[..., None]


def _no_follow(path: str, flags: int) -> int:
    """Open an output, but no file that a symbolic link in its place leads to."""
    return os.open(path, flags | os.O_NOFOLLOW, 0o666)


def _options(effects: Sequence[str]) -> Callable[[Command], Command]:
    """The options of both commands; ``effects`` are the names that --effect knows."""
    choice = click.Choice(["none", "draw", *effects])

    def decorate(command: Command) -> Command:
        for option in reversed(
            (
                click.argument("rig", type=click.Path(exists=True, dir_okay=False, path_type=Path)),
                click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True,
                             help="Seed of parameters, current and effect."),
                click.option("--run", type=click.IntRange(min=0), default=0, show_default=True,
                             help="Number of the run: the same boat, other noise."),
                click.option("--effect", type=choice, default="none", show_default=True, metavar="NAME",
                             help=f"none, draw (the seed draws) or one of {', '.join(effects)}."),
                click.option("--truth-file", "truth_file", type=click.Path(path_type=Path), metavar="FILE",
                             help="Write the hidden effect and the true parameters there; they are printed nowhere."),
                click.option("--trace", type=click.Path(path_type=Path), metavar="FILE",
                             help="Write a JSON line for every change of a thruster's effective command."),
                click.option("--fault", "faults", multiple=True, metavar="NAME[/TARGET]@T[:SECONDS]",
                             help=f"T: run seconds after the mock's start, or usr1: at that signal. {_FAULT_HELP}."),
                click.option("--ascii", "ascii_", is_flag=True, help="The AHRS sends $VNYMR instead of binary."),
            )
        ):  # fmt: skip
            command = option(command)
        return command

    return decorate


@click.group()
def mock() -> None:
    """Mock devices for a rig, until Ctrl-C: a boat or a bench behind real ports.

    \b
    Example: seatrial mock boat boat.toml --seed 7 --effect draw --truth-file truth.json
    """


@mock.command(short_help="A simulated boat with two thrusters.")
@_options([*catalogue.EFFECTS, *catalogue.OUTSIDE])
def boat(rig: Path, seed: int, run: int, effect: str, truth_file: Path | None, **how: Any) -> None:
    """A simulated boat with two thrusters at the ports of RIG.

    Prints `ready` when all ports are there.

    \b
    Example: seatrial mock boat boat.toml --seed 7 --effect wind --fault pull/gnss@60:5
    """
    loaded = load_rig(rig)
    name = catalogue.draw_name(seed) if effect == "draw" else effect
    effects = [] if name == "none" else [catalogue.make_effect(name, seed)]
    plant = draw_boat(seed, effects, draw_thruster(seed))  # the thruster that the bench of this seed has
    utc = float(round(time.time()))
    world = boat_world(plant, run, _gear(loaded, by_side(loaded)), utc=utc)
    _serve(loaded, plant, world, run, truth_file, **how)


@mock.command(short_help="A simulated thruster on a load cell.")
@_options(list(bench_plant.EFFECTS))
def bench(rig: Path, seed: int, run: int, effect: str, truth_file: Path | None, **how: Any) -> None:
    """A simulated bench, one thruster on a load cell, at the ports of RIG.

    Prints `ready` when all ports are there.

    \b
    Example: seatrial mock bench bench.toml --seed 7 --effect rod-flex
    """
    loaded = load_rig(rig)
    if len(loaded.thrusters) != 1:
        raise SeatrialError(f"{rig}: a mock bench has one thruster; this rig has {len(loaded.thrusters)}")
    name = bench_plant.draw_name(seed) if effect == "draw" else effect
    plant = draw_bench(seed, bench_plant.NONE if name == "none" else bench_plant.make_effect(name, seed))
    world = bench_world(plant, run, _gear(loaded, loaded.thrusters), utc=float(round(time.time())))
    _serve(loaded, plant, world, run, truth_file, **how)


def _gear(rig: Rig, thrusters: Sequence[Thruster]) -> DeviceSpecs:
    """The devices of a rig as a world wants them; the rate of a bus is shared by its controllers."""
    rates: dict[str, dict[str, float]] = {"vectornav": {}, "nmea": {}}
    cells, escs = [], []
    for device in rig.devices:
        if device.protocol in rates:
            rates[device.protocol][device.name] = device.rate_hz
        elif device.protocol == "loadcell":
            of = device.calibration or LoadCellCalibration(0.001)
            gain, top = of.newton_per_count * of.lever_ratio, device.saturation or 8388607.0
            cells.append(CellSpec(device.name, device.rate_hz, gain, of.zero_counts, top))
        elif device.protocol == "mavlink":
            rates["vectornav"][device.name], rates["nmea"][device.name] = LOOP_HZ, GPS_HZ
    for t in thrusters:
        rate = rig.device(t.device).rate_hz / sum(other.device == t.device for other in thrusters)
        rate = rate if t.output is None else ESC_HZ
        rpm_max = RPM_MAX if math.isnan(t.rpm_max) else t.rpm_max
        escs.append(EscSpec(t.device, t.node, rate, rpm_max, t.reversed, t.timeout_s, t.name))
    return DeviceSpecs(rates["vectornav"], rates["nmea"], cells, escs)


def _serve(
    rig: Rig,
    plant: Boat | Bench,
    world: World,
    run: int,
    truth_file: Path | None,
    trace: Path | None,
    faults: Sequence[str],
    ascii_: bool,
) -> None:
    """Open the ports, say so, and serve until a signal comes."""
    names, thrusters = [d.name for d in rig.devices], [t.name for t in rig.thrusters]
    schedule = Faults([parse_fault(text, names, thrusters) for text in faults], random_stream(plant.seed, FAULT, run))
    with contextlib.ExitStack() as stack:
        speakers = {}
        for device in rig.devices:
            controllers = {c.spec.node: c for c in world.controllers if c.spec.device == device.name}
            speakers[device.name] = make_emulator(rig, device, controllers, ascii_)
        ports: dict[str, PtyPort | NetPort] = {}
        for device in rig.devices:
            ports[device.name] = _port(device.port)
            stack.callback(ports[device.name].close)
        if truth_file is not None:
            write_truth(truth_file, ground_truth(plant, run))
        file = stack.enter_context(open(trace, "w", encoding="utf-8", opener=_no_follow)) if trace is not None else None
        server = Server(world, speakers, ports, rig.speed, schedule, file)
        stack.enter_context(_signals(server))
        click.echo("ready")
        sys.stdout.flush()
        server.run()
        _report(server)


def _port(port: str) -> PtyPort | NetPort:
    if port.partition(":")[0] in ("udp", "udpin", "udpout", "tcp"):
        return NetPort(port)
    return PtyPort(Path(port.removeprefix("slcan:")))


@contextlib.contextmanager
def _signals(server: Server) -> Iterator[None]:
    """Ctrl-C and SIGTERM stop the server, SIGUSR1 triggers the faults that wait for it."""

    def stop(number: int, frame: object) -> None:
        server.stopping = True

    def trigger(number: int, frame: object) -> None:
        server.triggered = True

    wanted = {signal.SIGINT: stop, signal.SIGTERM: stop, signal.SIGUSR1: trigger}
    before = {number: signal.signal(number, handler) for number, handler in wanted.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _report(server: Server) -> None:
    """One line on how well the mock kept up with the wall clock."""
    word = "FELL BEHIND the wall clock by up to" if server.max_lag > LATE else "samples left at most"
    late = f"{1e3 * server.max_lag:.1f} ms"
    click.echo(f"mock: {server.t:.1f} s of run time, {word} {late}{'' if server.max_lag > LATE else ' late'}", err=True)
