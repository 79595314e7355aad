"""Simulation of the mock boat and bench without ports and clocks, for studies and tests.

The simulation uses the same plants and sensors as the mocks at the ports and runs as fast as possible.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from seatrial.daq.samples import Command, Esc
from seatrial.mocks.devices import Faults
from seatrial.mocks.plant import Bench, BenchPlant, Boat, BoatPlant
from seatrial.mocks.sensors import CellSpec
from seatrial.mocks.world import DeviceSpecs, EscSpec, Reading, World, bench_world, boat_world

BOAT = DeviceSpecs(
    {"ahrs": 50.0},
    {"gnss": 5.0},
    (),
    tuple(EscSpec("esc", k, 25.0, name=side) for k, side in ((1, "left"), (2, "right"))),
)
BENCH = DeviceSpecs({}, {}, (CellSpec("loadcell", 80.0),), (EscSpec("esc", 1, 50.0),))
TRUTH_HZ = 10.0  # rate of the recorded true states

Truth = dict[str, NDArray[np.float64]]


class Recording(NamedTuple):
    """Result of a simulation of the mock boat or bench: the samples of its devices and the true states.

    Attributes
    ----------
    readings : list of Reading
        Samples of the devices and commands, in the order of time. The default devices are "ahrs", "gnss" and "esc" on a
        boat, "loadcell" and "esc" on a bench.
    truth : dict of arrays (n_samples,)
        True states by name, at 10 Hz (TRUTH_HZ) and in SI units. Boat: t, x, y, psi, u, v, r, n_left, n_right. Bench:
        t, n, thrust.
    """

    readings: list[Reading]
    truth: Truth


def simulate(
    boat: Boat,
    t: ArrayLike,
    n: ArrayLike,
    duration: float,
    run: int = 0,
    *,
    disturbed: bool = True,
    gear: DeviceSpecs = BOAT,
    faults: Faults | None = None,
) -> Recording:
    """Simulate a boat and its devices under given commands, as fast as possible. The GNSS time starts at 0.

    Parameters
    ----------
    boat : Boat
        Parameters and hidden effects of the boat.
    t : Array (n_commands,)
        Times of the commands [s]. Each command holds until the next one; before the first one it is zero. Commands
        after the end of the simulation are left out.
    n : Array (n_commands, 2)
        Commands of the left and the right thruster (-1 to 1).
    duration : float
        Duration of the simulation [s], rounded to a whole number of steps. Samples at its end are included.
    run : int
        Number of the run. The same boat with another number is a second mission with other noise.
    disturbed : bool
        Whether random disturbance forces act.
    gear : DeviceSpecs
        Specifications of the devices of the boat; by default an AHRS, a GNSS receiver and two speed controllers.
    faults : Faults, optional
        Faults. Those that change or suppress samples act, and `esc-dead`, which lasts to the end of the simulation.
        `esc-stuck` and faults of bytes, clocks and ports have no effect.

    Returns
    -------
    Recording
        Samples and commands, and true states.

    Raises
    ------
    ValueError
        If the commands have the wrong shape or their times decrease.
    """
    world = boat_world(boat, run, gear, utc=0.0, disturbed=disturbed)
    plant = world.plant
    assert isinstance(plant, BoatPlant)
    left, right = plant.shafts
    names = ("t", "x", "y", "psi", "u", "v", "r", "n_left", "n_right")
    readings, rows = _simulate(world, t, n, duration, lambda: (world.t, *plant.state[:6], left.n, right.n), faults)
    return Recording(readings, _columns_by_name(names, rows))


def simulate_bench(
    bench: Bench, t: ArrayLike, n: ArrayLike, duration: float, run: int = 0, *, disturbed: bool = True
) -> Recording:
    """Simulate a bench with one thruster and one load cell under given commands, as fast as possible.

    Parameters
    ----------
    bench : Bench
        Parameters and hidden effect of the bench.
    t : Array (n_commands,)
        Times of the commands [s]. Each command holds until the next one; before the first one it is zero. Commands
        after the end of the simulation are left out.
    n : Array (n_commands,) or (n_commands, 1)
        Commands (-1 to 1, positive forward).
    duration : float
        Duration of the simulation [s], rounded to a whole number of steps. Samples at its end are included.
    run : int
        Number of the run. It selects the noise.
    disturbed : bool
        Whether the random force of the moving water acts on the rod.

    Returns
    -------
    Recording
        Samples of the devices "loadcell" and "esc" with the commands, and true states t [s], n and thrust [N].

    Raises
    ------
    ValueError
        If the commands have the wrong shape or their times decrease.
    """
    world = bench_world(bench, run, BENCH, disturbed=disturbed)
    plant = world.plant
    assert isinstance(plant, BenchPlant)
    readings, rows = _simulate(world, t, n, duration, lambda: (world.t, plant.shafts[0].n, plant.thrust()))
    return Recording(readings, _columns_by_name(("t", "n", "thrust"), rows))


def _simulate(
    world: World,
    t: ArrayLike,
    n: ArrayLike,
    duration: float,
    truth: Callable[[], tuple[float, ...]],
    faults: Faults | None = None,
) -> tuple[list[Reading], list[tuple[float, ...]]]:
    """Simulate a boat or bench with its devices under given commands.

    Parameters
    ----------
    world : World
        The simulated boat or bench with its devices, at time 0. It is advanced to the end of the simulation.
    t : array_like (n_commands,)
        Times of the commands [s], which must not decrease. Each command holds until the next one; before the first one
        it is zero. Commands after the end of the simulation are left out.
    n : array_like (n_commands, n_thrusters)
        Commands of the thrusters (-1 to 1); for one thruster also (n_commands,).
    duration : float
        Duration of the simulation [s], rounded to a whole number of steps. Samples at its end are included.
    truth : callable
        Function without arguments that returns the present true states. It is called 10 times per simulated second
        (TRUTH_HZ), from time 0 on.
    faults : Faults, optional
        Faults of devices and speed controllers.

    Returns
    -------
    list of Reading
        Commands and samples in the order of time. A command to a dead controller is listed too; a sample that a fault
        suppresses is not.
    list of tuple
        The results of ``truth``, oldest first.

    Raises
    ------
    ValueError
        If the commands have the wrong shape or their times decrease.
    """
    schedule = _command_rows(t, n, len(world.controllers))
    step = world.plant.step_s
    every = round(1.0 / (TRUTH_HZ * step))
    readings: list[Reading] = []
    rows = []
    position = 0
    for k in range(round(duration / step) + 1):
        if faults is not None:
            _apply_controller_faults(world, faults)
        while position < len(schedule) and schedule[position][0] < (k + 1) * step:
            t_cmd, row = schedule[position]
            position += 1
            for controller, value in zip(world.controllers, row, strict=True):
                controller.command(t_cmd, value)
                readings.append(Reading(controller.spec.device, Command(controller.spec.node, value), t_cmd))
        readings += world.readings() if faults is None else _readings_after_faults(world.readings(), faults)
        if k % every == 0:
            rows.append(truth())
        world.advance()
    readings.sort(key=lambda reading: reading.t)
    return readings, rows


def _apply_controller_faults(world: World, faults: Faults) -> None:
    """Let each speed controller fail for which a fault `esc-dead` is active at the present time of ``world``.

    It stays dead, also when the fault ends. The fault `esc-stuck` is ignored.
    """
    for controller in world.controllers:
        if not controller.dead and faults.active("esc-dead", controller.spec.name, world.t):
            controller.die(world.t)


def _readings_after_faults(readings: Sequence[Reading], faults: Faults) -> list[Reading]:
    """Return samples of devices as changed by the faults that are active at their times.

    Samples that a fault suppresses are left out.
    """
    sent = [(r, faults.reading(r.device, r.sample, r.t)) for r in readings]
    return [Reading(r.device, sample, r.t) for r, sample in sent if sample is not None]


def _command_rows(t: ArrayLike, n: ArrayLike, thrusters: int) -> list[tuple[float, list[float]]]:
    """Check commands, and return them as a list of (time [s], list with the command of each thruster).

    ``t`` must have the shape (k,), and ``n`` the shape (k, ``thrusters``), or also (k,) for one thruster. Raises
    ValueError for other shapes and for decreasing times.
    """
    times, values = np.asarray(t, dtype=float), np.asarray(n, dtype=float)
    if values.ndim == 1 and thrusters == 1:
        values = values[:, None]
    if times.ndim != 1 or values.shape != (len(times), thrusters):
        raise ValueError(
            f"t and n must have the shapes (k,) and (k, {thrusters}), not {times.shape} and {values.shape}"
        )
    if np.any(np.diff(times) < 0.0):
        raise ValueError("the times of the commands must not decrease; sort the commands by time")
    return list(zip(times.tolist(), values.tolist(), strict=True))


def _columns_by_name(names: Sequence[str], rows: Sequence[Sequence[float]]) -> Truth:
    """Return the columns of ``rows`` (n_rows, n_columns) as arrays (n_rows,), by their ``names`` in the same order."""
    table = np.array(rows, dtype=float)
    return {name: table[:, i] for i, name in enumerate(names)}


def tables(readings: Sequence[Reading]) -> dict[str, NDArray[np.void]]:
    """Convert samples and commands of a simulation to structured arrays.

    Parameters
    ----------
    readings : sequence of Reading
        Samples and commands, for example of `simulate`.

    Returns
    -------
    dict of structured arrays (n_samples,)
        One array for each device with samples. Its fields are ``t`` [s] and the fields of the sample. The key is the
        name of the device. Telemetry and commands of a speed controller have the keys ``DEVICE/NODE/state`` and
        ``DEVICE/NODE/command``. The samples keep their order.
    """
    rows: dict[str, list[tuple[float, ...]]] = {}
    names: dict[str, list[str]] = {}
    for device, sample, t in readings:
        key = device
        if isinstance(sample, (Esc, Command)):
            key = f"{device}/{sample.node}/{'state' if isinstance(sample, Esc) else 'command'}"
        if key not in rows:
            rows[key], names[key] = [], [f.name for f in fields(sample)]
        rows[key].append((t, *(getattr(sample, name) for name in names[key])))
    return {key: np.array(table, dtype=[(name, "f8") for name in ("t", *names[key])]) for key, table in rows.items()}
