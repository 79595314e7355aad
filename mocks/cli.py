"""Commands `seatrial mock boat RIG` and `seatrial mock bench RIG`: simulated devices at the ports of a rig."""

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
from seatrial.daq.options import Choice, ExistingPath
from seatrial.daq.rig import LoadCellCalibration, Rig, Thruster
from seatrial.mocks.devices import KINDS, LOOP_HZ, Faults, by_side, make_emulator, parse_fault
from seatrial.mocks.hidden_effects import bench as bench_effects
from seatrial.mocks.hidden_effects import catalogue
from seatrial.mocks.hidden_effects import realistic as realistic_boats
from seatrial.mocks.plant import ARM, NONE, Bench, Boat, draw_bench, draw_boat, draw_thruster
from seatrial.mocks.ports import NetPort, PtyPort
from seatrial.mocks.random_streams import FAULT, random_stream
from seatrial.mocks.sensors import CellSpec
from seatrial.mocks.server import Server
from seatrial.mocks.truth_file import ground_truth, write_truth
from seatrial.mocks.world import DeviceSpecs, EscSpec, World, bench_world, boat_world

GPS_HZ, ESC_HZ = 5.0, 10.0  # rates of the GNSS receiver and of the speed controllers behind an autopilot
RPM_MAX = 4500.0  # rev/min; full speed of a thruster without rpm_max in the rig
LAG_WARNING_S = 0.1  # wall s; for a longer lag the last line is a warning
PLACE_M = 1e-3  # m; larger differences of places from those of the rig are named
_FAULT_HELP = "; ".join(f"{name}: {kind.text}" for name, kind in KINDS.items())

Command = Callable[..., None]


def _open_unless_link(path: str, flags: int) -> int:
    """Open an output file with the ``flags`` of `os.open`, and return its descriptor.

    A symbolic link raises OSError, so that the link's target is not overwritten. A new file gets mode 0666 less the
    umask.
    """
    return os.open(path, flags | os.O_NOFOLLOW, 0o666)


def _shared_options(effects: Sequence[str]) -> Callable[[Command], Command]:
    """Return a decorator that adds the argument RIG and the common options to `mock boat` or `mock bench`.

    They are --seed, --run, --effect, --truth-file, --trace, --fault (several times) and --ascii.
    ``effects`` are the names of hidden effects that --effect accepts besides "none" and "draw".
    """
    choice = Choice(["none", "draw", *effects])

    def decorate(command: Command) -> Command:
        """Add the argument RIG and the shared options to ``command``, in the order in which the help shows them."""
        for option in reversed(
            (
                click.argument("rig", type=ExistingPath(dir_okay=False)),
                click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True,
                             help="Seed of parameters, current and effect."),
                click.option("--run", type=click.IntRange(min=0), default=0, show_default=True,
                             help="Number of the run: the same boat with other noise."),
                click.option("--effect", type=choice, default="none", show_default=True, metavar="NAME",
                             help=f"none, draw (chosen at random by the seed) or one of {', '.join(effects)}."),
                click.option("--truth-file", "truth_file", type=click.Path(path_type=Path), metavar="FILE",
                             help="Write the hidden effect and the true parameters to FILE. They are never printed."),
                click.option("--trace", type=click.Path(path_type=Path), metavar="FILE",
                             help="Write one JSON line to FILE for each change of a thruster's effective command."),
                click.option("--fault", "faults", multiple=True, metavar="NAME[/TARGET]@T[:SECONDS]",
                             help="Inject a fault. T: run seconds after the start of the mock, or usr1: when the mock "
                             f"receives the signal SIGUSR1. {_FAULT_HELP}."),
                click.option("--ascii", "ascii_", is_flag=True,
                             help="Let the AHRS send $VNYMR sentences instead of binary messages."),
            )
        ):  # fmt: skip
            command = option(command)
        return command

    return decorate


@click.group()
def mock() -> None:
    """Serve the devices of a simulated boat or bench at the ports of a rig, until Ctrl-C.

    \b
    Example: seatrial mock boat boat.toml --seed 7 --effect draw --truth-file truth.json
    """


@mock.command(short_help="A simulated boat with two thrusters.")
@_shared_options([*catalogue.EFFECTS, *catalogue.SITE, *catalogue.OUTSIDE])
@click.option(
    "--realistic",
    is_flag=True,
    help="Add the small imperfections that every real boat has: form of the hull, wind, waves, and sensors that are "
    "late, rounded or slightly wrong.",
)
def boat(rig: Path, seed: int, run: int, effect: str, realistic: bool, truth_file: Path | None, **how: Any) -> None:
    """Serve a simulated boat with two thrusters at the ports of RIG, one thruster on each side.

    Prints `ready` when all ports are open. The thrusters are like that of `mock bench` with the same seed. The places
    of thrusters and antenna are always the same. A line says where those of RIG differ, as a fit uses those of RIG.

    \b
    Example: seatrial mock boat boat.toml --seed 7 --effect wind --fault pull/gnss@60:5
    """
    loaded = load_rig(rig)
    name = catalogue.draw_name(seed) if effect == "draw" else effect
    if realistic:
        effects = realistic_boats.realistic_with(name, seed)
    else:
        effects = () if name == "none" else (catalogue.make_effect(name, seed),)
    plant = draw_boat(seed, effects, draw_thruster(seed))  # the same thruster as on the bench of this seed
    utc = float(round(time.time()))
    sides = by_side(loaded)
    world = boat_world(plant, run, _device_specs(loaded, sides), utc=utc)
    note = _geometry_note(loaded, sides)
    if note:
        click.echo(f"mock: {note}", err=True)  # standard output is for `ready`, for which programs wait
    _serve(loaded, plant, world, run, truth_file, **how)


@mock.command(short_help="A simulated thruster on a load cell.")
@_shared_options(list(bench_effects.EFFECTS))
def bench(rig: Path, seed: int, run: int, effect: str, truth_file: Path | None, **how: Any) -> None:
    """Serve a simulated bench, one thruster on a load cell, at the ports of RIG, which has exactly one thruster.

    Prints `ready` when all ports are open.

    \b
    Example: seatrial mock bench bench.toml --seed 7 --effect rod-flex
    """
    loaded = load_rig(rig)
    if len(loaded.thrusters) != 1:
        raise SeatrialError(
            f"{rig}: a mock bench has one thruster; this rig has {len(loaded.thrusters)}: give another rig"
        )
    name = bench_effects.draw_name(seed) if effect == "draw" else effect
    plant = draw_bench(seed, NONE if name == "none" else bench_effects.make_effect(name, seed))
    world = bench_world(plant, run, _device_specs(loaded, loaded.thrusters), utc=float(round(time.time())))
    _serve(loaded, plant, world, run, truth_file, **how)


def _geometry_note(rig: Rig, sides: tuple[Thruster, Thruster]) -> str:
    """Return how the simulated boat differs from its rig in the geometry that a fit takes from the rig; "" if nowhere.

    Compared are y of the left and the right thruster (``sides``), and x and y of each antenna of a receiver, which is
    simulated at the origin of the body axes.
    """
    parts = []
    arms = [(t.name, t.position_m[1], y) for t, y in zip(sides, (-ARM, ARM), strict=True)]
    if any(abs(there - y) > PLACE_M for _, there, y in arms):
        here = " and ".join(f"{y:+g} m ({name})" for name, _, y in arms)
        parts.append(f"thrusters at y = {here}, in the rig at {' and '.join(f'{there:+g} m' for _, there, _ in arms)}")
    for device in rig.devices:
        x, y, _ = device.lever_arm_m
        if math.hypot(x, y) > PLACE_M:
            parts.append(f"antenna of {device.name} at x = 0, y = 0 m, in the rig at x = {x:+g}, y = {y:+g} m")
    if not parts:
        return ""
    return (
        f"THE SIMULATED BOAT DIFFERS FROM {rig.path.name}: {'; '.join(parts)}. A fit of its logs takes these values "
        "from the rig, so that its estimates (of the yaw inertia above all) are wrong: rehearse with a copy of the rig "
        "that has the simulated values"
    )


def _device_specs(rig: Rig, thrusters: Sequence[Thruster]) -> DeviceSpecs:
    """Return the specifications from which the devices of a rig are simulated: names, rates and calibrations.

    The speed controllers on one bus share the rate of the bus. An autopilot has an AHRS (50 Hz), a GNSS receiver (5 Hz)
    and speed controllers (10 Hz). A load cell without calibration has 0.001 N per count, and without ``saturation`` the
    range of a converter with 24 bits. The lever ratio is included in the force per count. A thruster without
    ``rpm_max`` has a full shaft speed of 4500 rev/min. Devices of other kinds are left out.

    Parameters
    ----------
    rig : Rig
        The rig.
    thrusters : sequence of Thruster
        Thrusters of the rig, in the order in which the simulated boat or bench numbers them.
    """
    rates: dict[str, dict[str, float]] = {"vectornav": {}, "nmea": {}}
    cells, escs = [], []
    for device in rig.devices:
        if device.protocol in rates:
            rates[device.protocol][device.name] = device.rate_hz
        elif device.protocol == "loadcell":
            calibration = device.calibration or LoadCellCalibration(0.001)
            # The default is the full scale of a converter with 24 bits.
            gain, saturation = calibration.newton_per_count * calibration.lever_ratio, device.saturation or 8388607.0
            cells.append(CellSpec(device.name, device.rate_hz, gain, calibration.zero_counts, saturation))
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
    """Open the ports of a rig, print `ready`, and serve its simulated devices there until Ctrl-C or SIGTERM.

    At the end one line with the largest delay of a sample is printed to standard error.

    Parameters
    ----------
    rig : Rig
        The rig whose devices are simulated.
    plant : Boat or Bench
        Parameters of the simulated boat or bench, for the ground truth.
    world : World
        The simulated boat or bench with its devices.
    run : int
        Number of the run. The random numbers of faults depend on it.
    truth_file : Path or None
        Ground-truth file, which is written before `ready`; None for no file.
    trace : Path or None
        File that gets a line for each change of a thruster's effective command; None for no file.
    faults : sequence of str
        Faults as on the command line: NAME[/TARGET]@T[:SECONDS].
    ascii_ : bool
        Whether an AHRS sends $VNYMR sentences instead of binary messages.

    Raises
    ------
    SeatrialError
        If a fault is invalid, a device cannot be simulated, or a port cannot be opened.
    OSError
        If the file ``trace`` or ``truth_file`` cannot be written, for example because ``trace`` is a symbolic link.
    """
    names, thrusters = [d.name for d in rig.devices], [t.name for t in rig.thrusters]
    schedule = Faults([parse_fault(text, names, thrusters) for text in faults], random_stream(plant.seed, FAULT, run))
    with contextlib.ExitStack() as stack:
        emulators = {}
        for device in rig.devices:
            controllers = {c.spec.node: c for c in world.controllers if c.spec.device == device.name}
            emulators[device.name] = make_emulator(rig, device, controllers, ascii_)
        ports: dict[str, PtyPort | NetPort] = {}
        for device in rig.devices:
            ports[device.name] = _open_port(device.port)
            stack.callback(ports[device.name].close)
        if truth_file is not None:
            write_truth(truth_file, ground_truth(plant, run))
        file = (
            stack.enter_context(open(trace, "w", encoding="utf-8", opener=_open_unless_link))
            if trace is not None
            else None
        )
        server = Server(world, emulators, ports, rig.speed, schedule, file)
        stack.enter_context(_signal_handlers(server))
        click.echo("ready")
        sys.stdout.flush()
        server.run()
        _print_timing(server)


def _open_port(port: str) -> PtyPort | NetPort:
    """Open the mock's end of ``port``, the text in the rig file: a socket for `udp:`, `udpin:`, `udpout:` and `tcp:`.

    For any other text it is a pty, whose link gets this path without the prefix `slcan:`. Raises SeatrialError if the
    port cannot be opened.
    """
    if port.partition(":")[0] in ("udp", "udpin", "udpout", "tcp"):
        return NetPort(port)
    return PtyPort(Path(port.removeprefix("slcan:")))


@contextlib.contextmanager
def _signal_handlers(server: Server) -> Iterator[None]:
    """Handle signals for a ``server`` of simulated devices while the context lasts; then restore the earlier handlers.

    Ctrl-C and SIGTERM stop the server. SIGUSR1 starts the faults whose start time on the command line is `usr1`.
    """

    def stop(number: int, frame: object) -> None:
        """Let the server of the simulated devices end after its present round (handler of Ctrl-C and SIGTERM)."""
        server.stopping = True

    def trigger(number: int, frame: object) -> None:
        """Let the server start the faults that wait for this signal (handler of SIGUSR1; time `usr1` of a fault)."""
        server.triggered = True

    handlers = {signal.SIGINT: stop, signal.SIGTERM: stop, signal.SIGUSR1: trigger}
    previous = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _print_timing(server: Server) -> None:
    """Print one line to standard error: the run time of a mock, and the largest delay with which it sent a sample.

    The delay is that against the wall clock. Above 0.1 s (LAG_WARNING_S) the line is a warning.
    """
    lag = f"{1e3 * server.max_lag:.1f} ms"
    if server.max_lag > LAG_WARNING_S:
        message = f"FELL BEHIND real time by up to {lag}; give a smaller speed in the rig file, or end other programs"
    else:
        message = f"samples were sent at most {lag} late"
    click.echo(f"mock: {server.t:.1f} s of run time, {message}", err=True)
