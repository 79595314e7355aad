"""A plant with its sensors and speed controllers: commands in, samples out, on the plant's own time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from seatrial.daq.samples import Ahrs, Command, Esc, Gnss, LoadCell
from seatrial.mocks.plant import Bench, BenchPlant, BenchShaft, Boat, BoatPlant, RigidBodyState, Shaft
from seatrial.mocks.sensors import AhrsSensor, CellSpec, EscSensor, GnssSensor, LoadCellSensor

Sample = Ahrs | Gnss | Esc | LoadCell | Command


class Reading(NamedTuple):
    """One sample of one device."""

    device: str
    sample: Sample
    t: float  # s since the run's start


class Plant(Protocol):
    """What a world asks of a boat or a bench."""

    step_s: float
    steps: int
    energy: float

    @property
    def shafts(self) -> Sequence[Shaft | BenchShaft]: ...
    def command(self, thruster: int, t: float, n_cmd: float) -> None: ...
    def thrust(self, thruster: int) -> float: ...
    def advance(self) -> None: ...


@dataclass(frozen=True)
class EscSpec:
    """How one thruster hangs on its bus."""

    device: str
    node: int
    rate_hz: float  # status frames of this node
    rpm_max: float = 4500.0
    reversed: bool = False
    timeout_s: float = math.inf
    name: str = ""  # of the thruster


# on_change(t, node, n, why): the effective command changed; n positive forward, why "command", "timeout" or "dead"
OnChange = Callable[[float, int, float, str], None]


class EscController:
    """A speed controller: obeys duty commands, and stops by itself when none has come for its time-out."""

    def __init__(self, spec: EscSpec, plant: Plant, thruster: int) -> None:
        self.spec = spec
        self.n = 0.0  # effective command, positive forward
        self.dead = False
        self.stuck = False  # it ignores commands, and its time-out does not strike
        self.on_change: OnChange | None = None
        self._plant = plant
        self._thruster = thruster
        self.deadline = math.inf  # s, when the time-out strikes

    @property
    def duty(self) -> float:
        """The effective command with the sign it has on the wire."""
        return -self.n if self.spec.reversed else self.n

    def command(self, t: float, duty: float) -> None:
        """Obey a command that arrived at time ``t`` (s); a dead or stuck controller does not."""
        if self.dead or self.stuck:
            return
        self.check(t)
        self.deadline = t + self.spec.timeout_s
        self._set(t, -duty if self.spec.reversed else duty, "command")

    def check(self, t: float) -> None:
        """Stop if the time-out struck before ``t`` (s)."""
        if t > self.deadline and not self.stuck:
            struck, self.deadline = self.deadline, math.inf
            self._set(struck, 0.0, "timeout")

    def die(self, t: float) -> None:
        """From ``t`` (s) on no thrust and no word."""
        self.dead, self.deadline = True, math.inf
        self._set(t, 0.0, "dead")

    def _set(self, t: float, n: float, why: str) -> None:
        n += 0.0  # no minus zero
        if n != self.n:
            self.n = n
            self._plant.command(self._thruster, t, n)
            if self.on_change is not None:
                self.on_change(t, self.spec.node, n, why)


class SampledStream:
    """One stream of samples, due at the first step of the plant at or after each multiple of its period."""

    def __init__(
        self, device: str, rate_hz: float, step_s: float, read: Callable[[], Sample | None], phase: float = 0.0
    ) -> None:
        """``phase`` in periods; ``read`` returns None where the device is silent."""
        self.device = device
        self._read = read
        self._period = 1.0 / (rate_hz * step_s)
        self._count = phase
        self.due = 0
        self._place()

    def _place(self) -> None:
        self.due = math.ceil(self._count * self._period - 1e-6)

    def take(self) -> Sample | None:
        """The sample that is due."""
        self._count += 1.0
        self._place()
        return self._read()


class World:
    """Steps the plant and collects what is due."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self.controllers: list[EscController] = []
        self.channels: list[SampledStream] = []
        self.next_due = 0  # step at which the next sample is due

    @property
    def t(self) -> float:
        """Seconds since the run's start."""
        return self.plant.steps * self.plant.step_s

    def add(self, device: str, rate_hz: float, read: Callable[[], Sample | None], phase: float = 0.0) -> None:
        """Let ``device`` deliver what ``read`` returns, ``rate_hz`` times a second."""
        self.channels.append(SampledStream(device, rate_hz, self.plant.step_s, read, phase))

    def add_escs(self, specs: Sequence[EscSpec], seed: int, run: int) -> None:
        """A speed controller for each thruster, in the order of the plant's thrusters."""
        for thruster, spec in enumerate(specs):
            controller = EscController(spec, self.plant, thruster)
            sensor = EscSensor(seed, run, spec.node, spec.rpm_max)
            self.controllers.append(controller)
            self.add(spec.device, spec.rate_hz, self._esc_reader(controller, sensor, thruster), thruster / len(specs))

    def _esc_reader(self, controller: EscController, sensor: EscSensor, thruster: int) -> Callable[[], Sample | None]:
        plant, dt = self.plant, 1.0 / controller.spec.rate_hz
        sign = -1.0 if controller.spec.reversed else 1.0

        def read() -> Sample | None:
            if controller.dead:
                return None
            n, force = sign * plant.shafts[thruster].n, sign * plant.thrust(thruster)
            return sensor.read(n, force, controller.duty, plant.energy, dt)

        return read

    def controller(self, device: str, node: int) -> EscController | None:
        """The controller ``node`` on bus ``device``."""
        found = (c for c in self.controllers if c.spec.device == device and c.spec.node == node)
        return next(found, None)

    def readings(self) -> list[Reading]:
        """The samples that are due at the present step, each once."""
        steps = self.plant.steps
        if steps < self.next_due:
            return []
        out = []
        for channel in self.channels:
            if channel.due <= steps and (sample := channel.take()) is not None:
                out.append(Reading(channel.device, sample, self.t))
        self.next_due = min(channel.due for channel in self.channels)
        return out

    def advance(self) -> None:
        """One step of the plant; time-outs strike."""
        t = self.t
        for controller in self.controllers:
            if t > controller.deadline:
                controller.check(t)
        self.plant.advance()


@dataclass(frozen=True)
class DeviceSpecs:
    """The devices of a rig: names and rates (Hz) of AHRS and GNSS, load cells, and the controllers of the thrusters.

    ``escs`` in the order of the plant's thrusters: left and right on a boat.
    """

    ahrs: Mapping[str, float]
    gnss: Mapping[str, float]
    cells: Sequence[CellSpec]
    escs: Sequence[EscSpec]


def boat_world(boat: Boat, run: int, gear: DeviceSpecs, *, utc: float = 0.0, disturbed: bool = True) -> World:
    """A boat with its gear, ``utc`` (s since 1970) at time 0; a load cell on it hangs free."""
    plant = BoatPlant(boat, run, disturbed=disturbed)
    world = World(plant)
    for index, (name, rate) in enumerate(gear.ahrs.items()):
        world.add(name, rate, _ahrs_reader(AhrsSensor(boat.seed, run, rate, boat.effects, index), plant.motion))
    for index, (name, rate) in enumerate(gear.gnss.items()):
        gnss = GnssSensor(boat.seed, run, rate, boat.effects, index=index)
        world.add(name, rate, _gnss_reader(gnss, plant.motion, utc))
    for index, cell in enumerate(gear.cells):
        world.add(cell.name, cell.rate_hz, _cell_reader(LoadCellSensor(boat.seed, run, cell, index), lambda: 0.0))
    world.add_escs(gear.escs, boat.seed, run)
    return world


def bench_world(bench: Bench, run: int, gear: DeviceSpecs, *, utc: float = 0.0, disturbed: bool = True) -> World:
    """A bench with its gear; AHRS and GNSS on it are at rest."""
    plant = BenchPlant(bench, run, disturbed=disturbed)
    world = World(plant)

    def at_rest() -> RigidBodyState:
        return RigidBodyState(world.t, *[0.0] * (len(RigidBodyState._fields) - 1))

    for index, (name, rate) in enumerate(gear.ahrs.items()):
        world.add(name, rate, _ahrs_reader(AhrsSensor(bench.seed, run, rate, (), index), at_rest))
    for index, (name, rate) in enumerate(gear.gnss.items()):
        world.add(name, rate, _gnss_reader(GnssSensor(bench.seed, run, rate, index=index), at_rest, utc))
    for index, cell in enumerate(gear.cells):
        world.add(cell.name, cell.rate_hz, _cell_reader(LoadCellSensor(bench.seed, run, cell, index), plant.force))
    world.add_escs(gear.escs, bench.seed, run)
    return world


def _ahrs_reader(sensor: AhrsSensor, motion: Callable[[], RigidBodyState]) -> Callable[[], Sample]:
    return lambda: sensor.read(motion())


def _gnss_reader(sensor: GnssSensor, motion: Callable[[], RigidBodyState], utc: float) -> Callable[[], Sample]:
    def read() -> Sample:
        m = motion()
        return sensor.read(m, utc + m.t)

    return read


def _cell_reader(sensor: LoadCellSensor, force: Callable[[], float]) -> Callable[[], Sample]:
    return lambda: sensor.read(force())
