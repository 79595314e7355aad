"""Simulated plant with its sensors and speed controllers.

Its inputs are commands, and its outputs are samples. Time is the simulated time of the plant.
"""

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
    t: float  # s since the start of the run


class Plant(Protocol):
    """Interface of `BoatPlant` and `BenchPlant` to `World`."""

    step_s: float  # s, step of the integration
    steps: int  # number of steps since the start
    energy: float  # s, integral of |n|^3 over time, summed over the thrusters

    @property
    def shafts(self) -> Sequence[Shaft | BenchShaft]: ...
    def command(self, thruster: int, t: float, n_cmd: float) -> None: ...
    def thrust(self, thruster: int) -> float: ...
    def advance(self) -> None: ...


@dataclass(frozen=True)
class EscSpec:
    """Speed controller of one thruster and its place on a bus."""

    device: str  # name of the bus
    node: int
    rate_hz: float  # rate of the status frames of this node
    rpm_max: float = 4500.0  # rev/min, full speed
    reversed: bool = False  # whether a positive command on the bus drives the boat backwards
    timeout_s: float = math.inf  # s without a command after which the controller stops the motor
    name: str = ""  # of the thruster


# on_change(t, node, n, why): called when the effective command changes to n (positive forward). The reason is
# "command", "timeout" or "dead".
OnChange = Callable[[float, int, float, str], None]


class EscController:
    """Speed controller of one thruster.

    It obeys duty commands, and stops the motor if no command arrives within its time-out.
    """

    def __init__(self, spec: EscSpec, plant: Plant, thruster: int) -> None:
        self.spec = spec
        self.n = 0.0  # effective command, positive forward
        self.dead = False
        self.stuck = False  # whether the controller ignores commands and its time-out
        self.on_change: OnChange | None = None
        self._plant = plant
        self._thruster = thruster
        self.deadline = math.inf  # s, time at which the time-out ends

    @property
    def duty(self) -> float:
        """The effective command (-1 to 1) with its sign on the bus."""
        return -self.n if self.spec.reversed else self.n

    def command(self, t: float, duty: float) -> None:
        """Obey a command that arrives at time ``t`` [s]. A dead or stuck controller ignores the command."""
        if self.dead or self.stuck:
            return
        self.check(t)
        self.deadline = t + self.spec.timeout_s
        self._set(t, -duty if self.spec.reversed else duty, "command")

    def check(self, t: float) -> None:
        """Stop the motor if the time-out ended before ``t`` [s]. A stuck controller (a fault) keeps turning."""
        if t > self.deadline and not self.stuck:
            t_end, self.deadline = self.deadline, math.inf
            self._set(t_end, 0.0, "timeout")

    def die(self, t: float) -> None:
        """Let the controller fail at ``t`` [s]: from then on it gives no thrust and sends no telemetry."""
        self.dead, self.deadline = True, math.inf
        self._set(t, 0.0, "dead")

    def _set(self, t: float, n: float, why: str) -> None:
        """Pass a changed effective command to the plant and to `on_change`."""
        n += 0.0  # turns -0.0 into 0.0
        if n != self.n:
            self.n = n
            self._plant.command(self._thruster, t, n)
            if self.on_change is not None:
                self.on_change(t, self.spec.node, n, why)


class SampledStream:
    """Periodic samples of one device.

    Each sample is due at the first step of the plant at or after a multiple of the period.
    """

    def __init__(
        self, device: str, rate_hz: float, step_s: float, read: Callable[[], Sample | None], phase: float = 0.0
    ) -> None:
        """Set up a stream.

        Parameters
        ----------
        rate_hz : float
            Rate of the samples.
        step_s : float
            Step of the plant [s].
        read : callable
            Function that returns the present sample, or None if the device is silent.
        phase : float
            Time of the first sample, in periods.
        """
        self.device = device
        self._read = read
        self._period = 1.0 / (rate_hz * step_s)
        self._count = phase
        self.due = 0
        self._place()

    def _place(self) -> None:
        """Set the step of the plant at which the next sample is due."""
        self.due = math.ceil(self._count * self._period - 1e-6)

    def take(self) -> Sample | None:
        """Return the sample that is due, or None if the device is silent. Schedule the next sample."""
        self._count += 1.0
        self._place()
        return self._read()


class World:
    """Simulated plant with the sample streams of its devices and the speed controllers of its thrusters."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self.controllers: list[EscController] = []
        self.channels: list[SampledStream] = []
        self.next_due = 0  # step at which the next sample is due

    @property
    def t(self) -> float:
        """Time since the start of the run [s]."""
        return self.plant.steps * self.plant.step_s

    def add(self, device: str, rate_hz: float, read: Callable[[], Sample | None], phase: float = 0.0) -> None:
        """Add a stream of samples. See `SampledStream` for the parameters."""
        self.channels.append(SampledStream(device, rate_hz, self.plant.step_s, read, phase))

    def add_escs(self, specs: Sequence[EscSpec], seed: int, run: int) -> None:
        """Add one speed controller for each thruster, in the order of the plant's thrusters.

        The status frames of the controllers are spread evenly over one period.
        """
        for thruster, spec in enumerate(specs):
            controller = EscController(spec, self.plant, thruster)
            sensor = EscSensor(seed, run, spec.node, spec.rpm_max)
            self.controllers.append(controller)
            self.add(spec.device, spec.rate_hz, self._esc_reader(controller, sensor, thruster), thruster / len(specs))

    def _esc_reader(self, controller: EscController, sensor: EscSensor, thruster: int) -> Callable[[], Sample | None]:
        """Return the function that reads the telemetry of one speed controller."""
        plant, dt = self.plant, 1.0 / controller.spec.rate_hz
        sign = -1.0 if controller.spec.reversed else 1.0

        def read() -> Sample | None:
            if controller.dead:
                return None
            n, force = sign * plant.shafts[thruster].n, sign * plant.thrust(thruster)
            return sensor.read(n, force, controller.duty, plant.energy, dt)

        return read

    def controller(self, device: str, node: int) -> EscController | None:
        """Return the controller ``node`` on bus ``device``, or None if the bus has no such node."""
        found = (c for c in self.controllers if c.spec.device == device and c.spec.node == node)
        return next(found, None)

    def readings(self) -> list[Reading]:
        """Return the samples that are due at the present step. Each sample is returned once."""
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
        """Check the time-outs of the controllers and integrate one step of the plant."""
        t = self.t
        for controller in self.controllers:
            if t > controller.deadline:
                controller.check(t)
        self.plant.advance()


@dataclass(frozen=True)
class DeviceSpecs:
    """Specifications of the devices of a rig."""

    ahrs: Mapping[str, float]  # name -> rate in Hz
    gnss: Mapping[str, float]  # name -> rate in Hz
    cells: Sequence[CellSpec]
    escs: Sequence[EscSpec]  # in the order of the plant's thrusters: left and right on a boat


def boat_world(boat: Boat, run: int, gear: DeviceSpecs, *, utc: float = 0.0, disturbed: bool = True) -> World:
    """Return the world of a boat. A load cell on the boat measures no force.

    Parameters
    ----------
    boat : Boat
        Parameters and hidden effects of the boat.
    run : int
        Number of the run. It selects the random disturbances, the initial heading and the noise of the sensors.
    gear : DeviceSpecs
        Devices of the boat.
    utc : float
        UTC at time 0 [s since 1970], for the time stamps of the GNSS receivers.
    disturbed : bool
        Whether random disturbance forces act.
    """
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
    """Return the world of a bench. An AHRS or GNSS receiver on the bench is at rest.

    Parameters
    ----------
    bench : Bench
        Parameters and hidden effect of the bench.
    run : int
        Number of the run. It selects the random disturbance and the noise of the sensors.
    gear : DeviceSpecs
        Devices of the bench.
    utc : float
        UTC at time 0 [s since 1970], for the time stamps of the GNSS receivers.
    disturbed : bool
        Whether the random force of the moving water acts on the rod.
    """
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
