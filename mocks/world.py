"""Simulated plant with its sensors and speed controllers.

Its inputs are commands, and its outputs are samples. Time is the simulated time of the plant.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from seatrial.daq.samples import Ahrs, Command, Esc, Gnss, LoadCell
from seatrial.mocks.plant import (
    Bench,
    BenchPlant,
    BenchShaft,
    Boat,
    BoatPlant,
    HiddenEffect,
    RigidBodyState,
    Shaft,
    Telemetry,
)
from seatrial.mocks.sensors import AhrsSensor, CellSpec, EscSensor, GnssSensor, LoadCellSensor

Sample = Ahrs | Gnss | Esc | LoadCell | Command


class Reading(NamedTuple):
    """Sample or command of one simulated device, with its time.

    Attributes
    ----------
    device : str
        Name of the device.
    sample : Ahrs, Gnss, Esc, LoadCell or Command
        The sample, in the units of seatrial.daq.samples.
    t : float
        Time since the start of the run [s].
    """

    device: str
    sample: Sample
    t: float


class Plant(Protocol):
    """Interface of a simulated boat or bench without sensors (`BoatPlant`, `BenchPlant`), as `World` uses it.

    Attributes
    ----------
    step_s : float
        Step of the integration [s].
    steps : int
        Number of steps since the start.
    energy : float
        Integral of ``|n|^3`` over time [s], summed over the thrusters, with normalised shaft speeds n.
    """

    step_s: float
    steps: int
    energy: float

    @property
    def shafts(self) -> Sequence[Shaft | BenchShaft]:
        """Shafts of the thrusters of the simulated boat or bench, in the order of the thrusters' indices."""
        ...

    def command(self, thruster: int, t: float, n_cmd: float) -> None:
        """Set the command ``n_cmd`` (-1 to 1, positive forward) of a thruster from time ``t`` [s] on.

        ``thruster`` is the index of the thruster.
        """
        ...

    def thrust(self, thruster: int) -> float:
        """Return the thrust [N], positive forward, of the thruster with this index at its present shaft speed."""
        ...

    def advance(self) -> None:
        """Integrate the simulated boat or bench by one step of ``step_s`` seconds."""
        ...


@dataclass(frozen=True)
class EscSpec:
    """Specification of the simulated speed controller (ESC) of one thruster.

    Attributes
    ----------
    device : str
        Name of the device (bus or autopilot) that the controller is connected to.
    node : int
        Number of the controller on the bus, or of the servo output.
    rate_hz : float
        Rate of the status messages of this controller [Hz].
    rpm_max : float
        Full shaft speed [rev/min].
    reversed : bool
        Whether a positive command on the bus drives the boat backwards.
    timeout_s : float
        Time without a command [s] after which the controller stops the motor.
    name : str
        Name of the thruster; may be empty.
    """

    device: str
    node: int
    rate_hz: float
    rpm_max: float = 4500.0
    reversed: bool = False
    timeout_s: float = math.inf
    name: str = ""


# on_change(t, node, n, why): called when the effective command changes to n (positive forward). The reason is
# "command", "timeout" or "dead".
OnChange = Callable[[float, int, float, str], None]


class EscController:
    """Simulated speed controller of one thruster.

    It obeys duty commands, and stops the motor if no command arrives within its time-out.

    Attributes
    ----------
    spec : EscSpec
        Specification of the controller.
    n : float
        Effective command (-1 to 1, positive forward): the last command obeyed, or 0 after a time-out or a failure.
    dead : bool
        Whether the controller has failed: it gives no thrust and sends no telemetry.
    stuck : bool
        Whether the controller ignores commands and its time-out.
    deadline : float
        Time [s] at which the time-out ends; infinite without a command.
    on_change : callable, optional
        Called with the time, the node, the new effective command and the reason ("command", "timeout" or "dead").
    """

    def __init__(self, spec: EscSpec, plant: Plant, thruster: int) -> None:
        """Set up a speed controller with zero command.

        ``thruster`` is the index of its thruster in the simulated boat or bench ``plant``.
        """
        self.spec = spec
        self.n = 0.0
        self.dead = False
        self.stuck = False
        self.on_change: OnChange | None = None
        self._plant = plant
        self._thruster = thruster
        self.deadline = math.inf

    @property
    def duty(self) -> float:
        """Effective command of the speed controller (-1 to 1), with its sign on the bus."""
        return -self.n if self.spec.reversed else self.n

    def command(self, t: float, duty: float) -> None:
        """Obey a duty command (-1 to 1, with its sign on the bus) that arrives at time ``t`` [s].

        If the time-out has ended before ``t``, the motor is first stopped at that time. The time-out then starts again.
        A dead or stuck controller ignores the command. The command is not clipped here; the simulated thruster clips
        it.
        """
        if self.dead or self.stuck:
            return
        self.check(t)
        self.deadline = t + self.spec.timeout_s
        self._set_effective_command(t, -duty if self.spec.reversed else duty, "command")

    def check(self, t: float) -> None:
        """Stop the motor if no command has arrived within the controller's time-out before ``t`` [s].

        The stop gets the time at which the time-out ended, and this time-out does not end again before the next
        command. A controller whose attribute `stuck` is true does not stop. Before the first command there is no
        time-out.
        """
        if t > self.deadline and not self.stuck:
            t_end, self.deadline = self.deadline, math.inf
            self._set_effective_command(t_end, 0.0, "timeout")

    def die(self, t: float) -> None:
        """Let the speed controller fail at ``t`` [s]: from then on it gives no thrust and sends no telemetry.

        The caller may set `dead` to False later; the controller then obeys the next command.
        """
        self.dead, self.deadline = True, math.inf
        self._set_effective_command(t, 0.0, "dead")

    def _set_effective_command(self, t: float, n: float, why: str) -> None:
        """Set the effective command ``n`` (-1 to 1, positive forward) of the motor from ``t`` [s] on.

        If it differs from the present one, it is passed to the simulated thruster and to `on_change`. ``why`` is the
        reason: "command", "timeout" or "dead".
        """
        n += 0.0  # turns -0.0 into 0.0
        if n != self.n:
            self.n = n
            self._plant.command(self._thruster, t, n)
            if self.on_change is not None:
                self.on_change(t, self.spec.node, n, why)


class SampledStream:
    """Schedule of the periodic samples of one simulated device.

    Each sample is due at the first step of the simulation at or after a multiple of the period, shifted by the phase.
    The attribute `due` is the number of the step at which the next sample is due.
    """

    def __init__(
        self, device: str, rate_hz: float, step_s: float, read: Callable[[], Sample | None], phase: float = 0.0
    ) -> None:
        """Set up the periodic samples of one device.

        Parameters
        ----------
        device : str
            Name of the device.
        rate_hz : float
            Rate of the samples [Hz].
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
        self._schedule_next()

    def _schedule_next(self) -> None:
        """Set `due` to the number of the simulation's step at which the next sample of this device is due."""
        self.due = math.ceil(self._count * self._period - 1e-6)

    def take(self) -> Sample | None:
        """Return the present sample of the device, or None if the device is silent, and schedule the next sample.

        The caller calls this when a sample is due.
        """
        self._count += 1.0
        self._schedule_next()
        return self._read()


class ThrusterState(NamedTuple):
    """State of one simulated thruster at one time, from which its telemetry is computed.

    Attributes
    ----------
    n : float
        Shaft speed (normalised), positive forward.
    force : float
        Thrust [N], positive forward.
    duty : float
        Effective command (-1 to 1) with its sign on the bus.
    energy : float
        Integral of ``|n|^3`` over time [s], summed over the thrusters.
    """

    n: float
    force: float
    duty: float
    energy: float


class TelemetryDelay:
    """Dead time from the state of a simulated thruster to the telemetry of its speed controller."""

    def __init__(self, steps: int, present: Callable[[], ThrusterState]) -> None:
        """Set up a dead time of ``steps`` steps of the simulation for the telemetry of one thruster.

        ``present`` is a function that returns the present state of the thruster. The state at this call is reported
        until the dead time has passed.
        """
        self._present = present
        self._states = deque([present()], maxlen=steps + 1)  # from the oldest to the newest

    def advance(self) -> None:
        """Store the present state of the thruster. It must be called once after each step of the simulation."""
        self._states.append(self._present())

    def state(self) -> ThrusterState:
        """Return the state of the thruster one dead time ago, which its telemetry reports at present.

        Until one dead time has passed it is the initial state.
        """
        return self._states[0]


class World:
    """Simulated boat or bench with the samples of its devices and the speed controllers of its thrusters.

    Attributes
    ----------
    plant : BoatPlant or BenchPlant
        Simulation of the boat or bench itself, without sensors.
    controllers : list of EscController
        Speed controllers, in the order of the thrusters' indices.
    channels : list of SampledStream
        Schedules of the samples of all devices.
    delays : list of TelemetryDelay
        Dead times of the telemetry; empty if the telemetry is not late.
    next_due : int
        Number of the simulation's step at which the next sample of any device is due.
    """

    def __init__(self, plant: Plant) -> None:
        """Set up a simulated boat or bench, at first without devices and speed controllers.

        ``plant`` simulates the boat or bench itself.
        """
        self.plant = plant
        self.controllers: list[EscController] = []
        self.channels: list[SampledStream] = []
        self.delays: list[TelemetryDelay] = []
        self.next_due = 0

    @property
    def t(self) -> float:
        """Simulated time since the start of the run [s]."""
        return self.plant.steps * self.plant.step_s

    def add(self, device: str, rate_hz: float, read: Callable[[], Sample | None], phase: float = 0.0) -> None:
        """Add a device with periodic samples to the simulated boat or bench.

        Parameters
        ----------
        device : str
            Name of the device.
        rate_hz : float
            Rate of the samples [Hz].
        read : callable
            Function that returns the present sample, or None if the device is silent.
        phase : float
            Time of the first sample, in periods.
        """
        self.channels.append(SampledStream(device, rate_hz, self.plant.step_s, read, phase))

    def add_escs(self, specs: Sequence[EscSpec], seed: int, run: int, effects: Sequence[HiddenEffect] = ()) -> None:
        """Add a speed controller with periodic telemetry for each thruster of the simulated boat or bench.

        ``specs`` are their specifications, in the order of the thrusters' indices. ``seed`` and ``run`` select the
        noise of the telemetry. The samples of the controllers are spread evenly over one period. ``effects`` are the
        hidden effects of the boat; those of the telemetry are applied. The ages of several effects add up, and the
        coarsest resolution and the lowest limit count.
        """
        errors = [e.telemetry for e in effects if e.telemetry is not None]
        telemetry = Telemetry(
            sum(e.age for e in errors),
            max((e.resolution for e in errors), default=0.0),
            min((e.ceiling for e in errors), default=math.inf),
        )
        for thruster, spec in enumerate(specs):
            controller = EscController(spec, self.plant, thruster)
            sensor = EscSensor(seed, run, spec.node, spec.rpm_max, telemetry)
            self.controllers.append(controller)
            read = self._esc_reader(controller, sensor, thruster, round(telemetry.age / self.plant.step_s))
            self.add(spec.device, spec.rate_hz, read, thruster / len(specs))

    def _esc_reader(
        self, controller: EscController, sensor: EscSensor, thruster: int, late: int
    ) -> Callable[[], Sample | None]:
        """Return a function without arguments that returns the next telemetry sample of one speed controller.

        The function returns None while the controller is dead. Shaft speed and command have their sign on the bus.
        ``sensor`` adds the noise. ``thruster`` is the index of the thruster. ``late`` is the age of the telemetry in
        steps of the simulation; if it is not 0, a dead time is added to `delays`.
        """
        plant, dt = self.plant, 1.0 / controller.spec.rate_hz
        sign = -1.0 if controller.spec.reversed else 1.0

        def present() -> ThrusterState:
            """Return the present state of the thruster: shaft speed, thrust, command and used energy."""
            return ThrusterState(plant.shafts[thruster].n, plant.thrust(thruster), controller.duty, plant.energy)

        reported = present
        if late:
            delay = TelemetryDelay(late, present)
            self.delays.append(delay)
            reported = delay.state

        def read() -> Sample | None:
            """Return the next telemetry sample of the speed controller, or None if the controller is dead."""
            if controller.dead:
                return None
            state = reported()
            return sensor.read(sign * state.n, sign * state.force, state.duty, state.energy, dt)

        return read

    def controller(self, device: str, node: int) -> EscController | None:
        """Return the speed controller with the number ``node`` on the device (bus or autopilot) named ``device``.

        Return None if there is none.
        """
        found = (c for c in self.controllers if c.spec.device == device and c.spec.node == node)
        return next(found, None)

    def readings(self) -> list[Reading]:
        """Return the samples of all devices that are due at the present step, and schedule the next ones.

        Each sample is returned once, in the order in which the devices were added. A device that is silent gives none.
        """
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
        """Advance the simulated boat or bench by one step.

        First motors are stopped whose speed controllers got no command within their time-out.
        """
        t = self.t
        for controller in self.controllers:
            if t > controller.deadline:
                controller.check(t)
        self.plant.advance()
        for delay in self.delays:
            delay.advance()


@dataclass(frozen=True)
class DeviceSpecs:
    """Specifications of the simulated devices of a rig.

    Attributes
    ----------
    ahrs : mapping of str to float
        Rate of each AHRS [Hz], by its name.
    gnss : mapping of str to float
        Rate of each GNSS receiver [Hz], by its name.
    cells : sequence of CellSpec
        Load cells.
    escs : sequence of EscSpec
        Speed controllers in the order of the plant's thrusters: left and right on a boat.
    """

    ahrs: Mapping[str, float]
    gnss: Mapping[str, float]
    cells: Sequence[CellSpec]
    escs: Sequence[EscSpec]


def boat_world(boat: Boat, run: int, gear: DeviceSpecs, *, utc: float = 0.0, disturbed: bool = True) -> World:
    """Return a simulated boat with its devices, at time 0. A load cell on the boat measures no force.

    Parameters
    ----------
    boat : Boat
        Parameters and hidden effects of the boat.
    run : int
        Number of the run. It selects the random disturbances, the initial heading and the noise of the sensors.
    gear : DeviceSpecs
        Specifications of the devices of the boat.
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
    world.add_escs(gear.escs, boat.seed, run, boat.effects)
    return world


def bench_world(bench: Bench, run: int, gear: DeviceSpecs, *, utc: float = 0.0, disturbed: bool = True) -> World:
    """Return a simulated bench with its devices, at time 0. An AHRS or GNSS receiver on it is at rest.

    Parameters
    ----------
    bench : Bench
        Parameters and hidden effect of the bench.
    run : int
        Number of the run. It selects the random disturbance and the noise of the sensors.
    gear : DeviceSpecs
        Specifications of the devices of the bench.
    utc : float
        UTC at time 0 [s since 1970], for the time stamps of the GNSS receivers.
    disturbed : bool
        Whether the random force of the moving water acts on the rod.
    """
    plant = BenchPlant(bench, run, disturbed=disturbed)
    world = World(plant)

    def at_rest() -> RigidBodyState:
        """Return the motion of a body at rest at the present time, for an AHRS or GNSS receiver on the bench."""
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
    """Return a function without arguments that returns the next AHRS sample of ``sensor``.

    ``motion`` is a function that returns the present true motion of the boat or bench.
    """
    return lambda: sensor.read(motion())


def _gnss_reader(sensor: GnssSensor, motion: Callable[[], RigidBodyState], utc: float) -> Callable[[], Sample]:
    """Return a function without arguments that returns the next GNSS sample of ``sensor``.

    ``motion`` is a function that returns the present true motion of the boat or bench. ``utc`` is the UTC at time 0 of
    the simulation [s since 1970].
    """

    def read() -> Sample:
        """Return the next GNSS sample for the present motion of the boat or bench, with the present UTC."""
        m = motion()
        return sensor.read(m, utc + m.t)

    return read


def _cell_reader(sensor: LoadCellSensor, force: Callable[[], float]) -> Callable[[], Sample]:
    """Return a function without arguments that returns the next load cell sample of ``sensor``.

    ``force`` is a function that returns the present true force on the load cell [N].
    """
    return lambda: sensor.read(force())
