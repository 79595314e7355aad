"""The same plants and sensors without ports and clocks, as fast as they run: for studies and tests."""

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
TRUTH_HZ = 10.0

Truth = dict[str, NDArray[np.float64]]


class Recording(NamedTuple):
    """Readings in the order of time, and what was true meanwhile (at TRUTH_HZ, SI)."""

    readings: list[Reading]  # devices "ahrs", "gnss", "esc", "loadcell"
    truth: Truth  # boat: t, x, y, psi, u, v, r, n_left, n_right; bench: t, n, thrust


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
    """Run a boat through commands ``t`` (k,) s, ``n`` (k, 2) left and right, for ``duration`` s.

    A command holds until the next. ``run`` names the noise: the same boat with another run is a second mission.
    ``gear``: what is on board and how it is wired; ``faults``: those of devices and controllers. GNSS time starts
    at 0. Raises ValueError for commands of the wrong shape.
    """
    world = boat_world(boat, run, gear, utc=0.0, disturbed=disturbed)
    plant = world.plant
    assert isinstance(plant, BoatPlant)
    left, right = plant.shafts
    names = ("t", "x", "y", "psi", "u", "v", "r", "n_left", "n_right")
    readings, rows = _run(world, t, n, duration, lambda: (world.t, *plant.state[:6], left.n, right.n), faults)
    return Recording(readings, _columns(names, rows))


def simulate_bench(
    bench: Bench, t: ArrayLike, n: ArrayLike, duration: float, run: int = 0, *, disturbed: bool = True
) -> Recording:
    """Run the bench through commands ``t`` (k,) s, ``n`` (k,) or (k, 1), for ``duration`` s; else as ``simulate``."""
    world = bench_world(bench, run, BENCH, disturbed=disturbed)
    plant = world.plant
    assert isinstance(plant, BenchPlant)
    readings, rows = _run(world, t, n, duration, lambda: (world.t, plant.shafts[0].n, plant.thrust()))
    return Recording(readings, _columns(("t", "n", "thrust"), rows))


def _run(
    world: World,
    t: ArrayLike,
    n: ArrayLike,
    duration: float,
    truth: Callable[[], tuple[float, ...]],
    faults: Faults | None = None,
) -> tuple[list[Reading], list[tuple[float, ...]]]:
    """Step the world through the commands; the readings and the rows of truth."""
    schedule = _schedule(t, n, len(world.controllers))
    step = world.plant.step_s
    every = round(1.0 / (TRUTH_HZ * step))
    readings: list[Reading] = []
    rows = []
    position = 0
    for k in range(round(duration / step) + 1):
        if faults is not None:
            _kill(world, faults)
        while position < len(schedule) and schedule[position][0] < (k + 1) * step:
            t_cmd, row = schedule[position]
            position += 1
            for controller, value in zip(world.controllers, row, strict=True):
                controller.command(t_cmd, value)
                readings.append(Reading(controller.spec.device, Command(controller.spec.node, value), t_cmd))
        readings += world.readings() if faults is None else _spoilt(world.readings(), faults)
        if k % every == 0:
            rows.append(truth())
        world.advance()
    readings.sort(key=lambda reading: reading.t)
    return readings, rows


def _kill(world: World, faults: Faults) -> None:
    for controller in world.controllers:
        if not controller.dead and faults.active("esc-dead", controller.spec.name, world.t):
            controller.die(world.t)


def _spoilt(readings: Sequence[Reading], faults: Faults) -> list[Reading]:
    sent = [(r, faults.reading(r.device, r.sample, r.t)) for r in readings]
    return [Reading(r.device, sample, r.t) for r, sample in sent if sample is not None]


def _schedule(t: ArrayLike, n: ArrayLike, thrusters: int) -> list[tuple[float, list[float]]]:
    times, values = np.asarray(t, dtype=float), np.asarray(n, dtype=float)
    if values.ndim == 1 and thrusters == 1:
        values = values[:, None]
    if times.ndim != 1 or values.shape != (len(times), thrusters):
        raise ValueError(f"commands must be (k,) and (k, {thrusters}), not {times.shape} and {values.shape}")
    if np.any(np.diff(times) < 0.0):
        raise ValueError("the times of the commands must not decrease")
    return list(zip(times.tolist(), values.tolist(), strict=True))


def _columns(names: Sequence[str], rows: Sequence[Sequence[float]]) -> Truth:
    table = np.array(rows, dtype=float)
    return {name: table[:, i] for i, name in enumerate(names)}


def tables(readings: Sequence[Reading]) -> dict[str, NDArray[np.void]]:
    """Readings as structured arrays with ``t`` first and then the sample's fields.

    Keys: ``ahrs``, ``gnss``, ``loadcell``, ``esc/NODE/state`` and ``esc/NODE/command``, those that there are.
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
