"""Simulated boat: hull, two thrusters, ocean current, disturbance forces and hidden effects."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import NamedTuple

from seatrial.mocks.plant.effect import ENERGY_UNIT, Fouling, Heating, HiddenEffect, Line, Payload
from seatrial.mocks.plant.hull import ARM, AT_REST, Hull, State, draw_current, draw_hull, make_rhs, rk4
from seatrial.mocks.plant.thruster import Inflow, Shaft, ThrusterTruth, thrust
from seatrial.mocks.plant.weather import Weather
from seatrial.mocks.random_streams import DISTURBANCE, START, OrnsteinUhlenbeck, normals, random_stream

PLANT_STEP_S = 0.005  # s
DISTURBANCE_EVERY = 4  # steps; the disturbance forces change at 50 Hz
GROWTH_EVERY_S = 2.0  # s between two steps of the growth of mass and drag
SIGMA = (0.3, 0.3, 0.03)  # N, N, N m; standard deviation of the disturbance forces in calm water
TAU = 2.0  # s, correlation time of the disturbance forces


@dataclass(frozen=True)
class Boat:
    """Parameters of a simulated boat that are the same in all its runs.

    Attributes
    ----------
    hull : Hull
        Masses and damping of the hull.
    thruster : ThrusterTruth
        Parameters of both thrusters.
    current : tuple of two floats
        Constant velocity of the ocean current [m/s], north and east.
    effects : tuple of HiddenEffect
        Hidden effects; empty if the nominal model is complete. The hooks of several effects act together, but only the
        first lever arm and the first swinging payload are used.
    seed : int
        Seed of the random numbers of the plant and the sensors.
    """

    hull: Hull
    thruster: ThrusterTruth
    current: tuple[float, float]
    effects: tuple[HiddenEffect, ...]
    seed: int

    def truth(self) -> dict[str, float]:
        """Return the true parameters of this simulated boat (SI) by name, for the ground-truth file.

        They are masses, damping, thruster, current and the arm of the thrusters. The masses of the thesis' model (m_u,
        m_v, m_r) include the added mass; ``mass`` and ``inertia`` are those of the rigid body. The parameters of hidden
        effects are not included.
        """
        rigid = {"mass": self.hull.mass, "inertia": self.hull.inertia}
        current = {"current_n": self.current[0], "current_e": self.current[1], "arm": ARM}
        return {**self.hull.lumped(), **asdict(self.thruster), **current, **rigid}


def draw_boat(seed: int, effects: Sequence[HiddenEffect] = (), thruster: ThrusterTruth | None = None) -> Boat:
    """Return the parameters of the simulated boat that belongs to a seed.

    The parameters of the hull are drawn within 10 % of their nominal values. The constant ocean current is drawn too.

    Parameters
    ----------
    seed : int
        Seed of the boat.
    effects : sequence of HiddenEffect
        Hidden effects of the boat. They are not drawn.
    thruster : ThrusterTruth, optional
        Parameters of both thrusters; the nominal ones if None.
    """
    return Boat(draw_hull(seed), thruster or ThrusterTruth(), draw_current(seed), tuple(effects), seed)


class RigidBodyState(NamedTuple):
    """True motion of the simulated boat or bench at one time, as the input of the sensor models.

    The axes are NED and body axes as in seatrial.daq.samples.

    Attributes
    ----------
    t : float
        Time since the plant's start [s].
    x, y : float
        Position of the origin of the body frame [m], north and east of the start.
    psi : float
        Heading [rad], not limited to a turn.
    r : float
        Yaw rate [rad/s].
    ax, ay : float
        Acceleration of the origin in body axes [m/s2], forward and to starboard.
    vel_n, vel_e : float
        Velocity of the origin over ground [m/s], north and east.
    fix_x, fix_y : float
        Position [m] that the GNSS receiver reports, without noise: of its antenna, and with its latency.
    fix_vel_n, fix_vel_e : float
        Velocity [m/s] that the GNSS receiver reports, without noise.
    thrust : float
        Sum of the static thrust of both thrusters at their shaft speeds [N].
    """

    t: float
    x: float
    y: float
    psi: float
    r: float
    ax: float
    ay: float
    vel_n: float
    vel_e: float
    fix_x: float
    fix_y: float
    fix_vel_n: float
    fix_vel_e: float
    thrust: float = 0.0


class BoatPlant:
    """Simulation of a boat with a fixed step. Thruster 0 is the left one, thruster 1 the right one.

    Attributes
    ----------
    boat : Boat
        Parameters and hidden effects of the boat.
    step_s : float
        Step of the integration [s].
    steps : int
        Number of steps since the start.
    energy : float
        Integral of ``|n|^3`` over time [s], summed over both thrusters. It measures the use of the battery.
    shafts : tuple of two Shaft
        Shafts of the left and the right thruster.
    state : tuple of eight floats
        Position x, y [m], heading psi [rad], velocity u, v [m/s] over ground in body axes, yaw rate r [rad/s], and
        angle [rad] and rate [rad/s] of a swinging payload.
    """

    def __init__(
        self,
        boat: Boat,
        run: int = 0,
        *,
        step: float = PLANT_STEP_S,
        state: State | None = None,
        disturbed: bool = True,
        n: float = 0.0,
    ) -> None:
        """Set up the simulation of a boat at time 0.

        Parameters
        ----------
        boat : Boat
            Parameters and hidden effects of the boat.
        run : int
            Number of the run. It selects the random disturbances and the initial heading.
        step : float
            Step of the integration [s].
        state : State, optional
            Initial state: the tuple of eight floats of the attribute `state`. If it is None, the boat drifts with the
            current from the position (0, 0), with a random heading.
        disturbed : bool
            Whether random disturbance forces act. Waves and gusts of hidden effects act in any case.
        n : float
            Initial shaft speed of both thrusters, normalised.
        """
        self.boat = boat
        self.step_s = step
        self.steps = 0
        self.energy = 0.0
        braking = math.prod(e.braking for e in boat.effects)
        self.shafts = (
            Shaft(boat.thruster, 0.5 * step, n, braking=braking),
            Shaft(boat.thruster, 0.5 * step, n, braking=braking),
        )
        self._water = list(boat.current)  # current velocity; the right-hand side reads this list at each call
        self._hot = [HotThrusters(e.heating, step, n) for e in boat.effects if e.heating is not None]
        # thrust of hot thrusters, payloads that have slid, and weed in the propellers
        self._occurred = tuple(HiddenEffect("temperature of the thrusters", "", thrust=h.thrust) for h in self._hot)
        self._rhs = make_rhs(boat.hull, boat.thruster, self._water, (*boat.effects, *self._occurred))
        self._n = (n, n)  # shaft speeds that act on the water, behind the delays of hidden effects
        self._inflows = self._make_inflows(n)
        self._drifts = [e.current for e in boat.effects if e.current is not None]
        self._streams = [e.stream for e in boat.effects if e.stream is not None]
        self._payloads = sorted((e.payload for e in boat.effects if e.payload is not None), key=lambda load: load.at)
        self._lines = [TowedLine(e.line, DISTURBANCE_EVERY * step) for e in boat.effects if e.line is not None]
        self._weeds = sorted((e.fouling for e in boat.effects if e.fouling is not None), key=lambda weed: weed.at)
        self._growths = [e.growth for e in boat.effects if e.growth is not None]
        self._grown_at = 0.0  # time of the last growth of the hull [s]
        self._weather = Weather(boat.effects, boat.seed, run, DISTURBANCE_EVERY * step)
        self.state = self._first_state(run) if state is None else state
        self._forces = (0.0, 0.0, 0.0)
        self._disturbances: list[OrnsteinUhlenbeck] = []
        if disturbed:
            draw = normals(random_stream(boat.seed, DISTURBANCE, run))
            self._disturbances = [OrnsteinUhlenbeck(draw, DISTURBANCE_EVERY * step, s, TAU) for s in SIGMA]
        arm = next((e.lever_arm for e in boat.effects if e.lever_arm is not None), (0.0, 0.0))
        self._antenna = Antenna(arm, sum(e.latency for e in boat.effects), step)

    def _make_inflows(self, n: float) -> list[Inflow]:
        """Return the delays of both thrusters from shaft speed to thrust, which hidden effects cause.

        Dead times and lags of several effects add up. ``n`` is the initial shaft speed (normalised). The list is empty
        if no effect delays the thrust.
        """
        delay, lag = (sum(e.inflow[k] for e in self.boat.effects) for k in (0, 1))
        lags = [lag + sum(e.slowness[side] for e in self.boat.effects) for side in (0, 1)]
        return [Inflow(delay, each, 0.5 * self.step_s, n) for each in lags] if delay or any(lags) else []

    def _first_state(self, run: int) -> State:
        """Return the boat's state at the start of the run with this number.

        The boat is at (0, 0), drifts with the current, does not turn, and has a heading that is random with the run.
        """
        psi = float(random_stream(self.boat.seed, START, run).uniform(-math.pi, math.pi))
        v_n, v_e = self.boat.current
        c, s = math.cos(psi), math.sin(psi)
        return (0.0, 0.0, psi, c * v_n + s * v_e, c * v_e - s * v_n, *AT_REST[5:])

    @property
    def t(self) -> float:
        """Simulated time since the start of the boat [s]."""
        return self.steps * self.step_s

    def command(self, thruster: int, t: float, n_cmd: float) -> None:
        """Set the command of thruster 0 (left) or 1 (right) from time ``t`` [s] on: -1 to 1, positive forward.

        Values beyond -1 to 1 are clipped. Values in the thruster's dead zone count as 0. From call to call ``t`` must
        not decrease.
        """
        self.shafts[thruster].command(t, n_cmd)

    def advance(self) -> None:
        """Integrate the simulated boat by one step: external forces, shafts, state, used energy and GNSS latency."""
        if self.steps % DISTURBANCE_EVERY == 0:
            self._update_external_forces()
        left, right = self.shafts
        energy = self.energy / ENERGY_UNIT
        k1 = self._rhs(self.state, *self._n, energy, *self._forces)
        n_mid = (left.advance(), right.advance())
        n_end = (left.advance(), right.advance())
        f_mid, self._n = n_mid, n_end
        if self._inflows:
            f_mid, self._n = self._delayed_shaft_speeds(n_mid), self._delayed_shaft_speeds(n_end)
        self.state = rk4(self._rhs, self.state, k1, self.step_s, (*f_mid, *self._n), energy, self._forces)
        self.energy += self.step_s * (abs(n_mid[0]) ** 3 + abs(n_mid[1]) ** 3)
        for thrusters in self._hot:
            thrusters.advance(n_mid)
        self.steps += 1
        if self._antenna.latency:
            self._antenna.push(self.state)

    def _delayed_shaft_speeds(self, n: tuple[float, float]) -> tuple[float, float]:
        """Return the shaft speeds, left and right, that produce thrust at present: ``n`` after the effects' delays.

        ``n`` has the present shaft speeds (normalised). Each call advances the delays by half a step of the simulation.
        It is called only if a hidden effect delays the thrust.
        """
        left, right = self._inflows
        return left.advance(n[0]), right.advance(n[1])

    def _update_external_forces(self) -> None:
        """Draw the random forces on the boat (disturbance, waves, gusts), and set the current, for the next few steps.

        They are constant for DISTURBANCE_EVERY steps. The pull of a towed line is added to them. Hidden effects may
        change the current with time and place. A payload whose time has come slides, at most one in each call, and so
        is weed caught. Mass and drag grow in steps of `GROWTH_EVERY_S`.
        """
        x, y, n = (d.step() for d in self._disturbances) if self._disturbances else (0.0, 0.0, 0.0)
        if self._weather:
            weather = self._weather.forces(self.t, self.state[2])
            x, y, n = x + weather[0], y + weather[1], n + weather[2]
        for line in self._lines:
            pull = line.step(self.state, self._water)
            x, y, n = x + pull[0], y + pull[1], n + pull[2]
        self._forces = (x, y, n)
        if self._payloads and self.t >= self._payloads[0].at:
            self._slide(self._payloads.pop(0))
        if self._weeds and self.t >= self._weeds[0].at:
            self._foul(self._weeds.pop(0))
        if self._growths and self.t >= self._grown_at + GROWTH_EVERY_S:
            self._grown_at = self.t
            self._replace_motion()
        if self._drifts or self._streams:
            changes = [drift(self.t) for drift in self._drifts]
            changes += [stream(self.state[0], self.state[1]) for stream in self._streams]
            self._water[:] = (v + sum(c[k] for c in changes) for k, v in enumerate(self.boat.current))

    def _slide(self, load: Payload) -> None:
        """Move the centre of gravity of the boat forward by ``load.x_g`` [m], for good, when the payload slides.

        It is called once for each payload. The equations of motion are replaced; position and velocity of the boat's
        origin do not jump.
        """
        self._occurred = (*self._occurred, HiddenEffect("payload in its new place", "", x_g=load.x_g))
        self._replace_motion()

    def _foul(self, weed: Fouling) -> None:
        """Reduce the thrust of both thrusters by their shares of ``weed``, for good, when they catch it."""

        def thrust(
            n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
        ) -> tuple[float, float]:
            """Return the thrust [N], left and right: ``f_l`` and ``f_r`` [N] less the lost shares."""
            return f_l * (1.0 - weed.left), f_r * (1.0 - weed.right)

        self._occurred = (*self._occurred, HiddenEffect("weed in the propellers", "", thrust=thrust))
        self._replace_motion()

    def _replace_motion(self) -> None:
        """Replace the equations of motion by those of the present hull, with its growth and what has occurred."""
        mass, drag = (1.0 + self._grown_at * sum(getattr(g, of) for g in self._growths) for of in ("mass", "drag"))
        hull = self.boat.hull
        grown = replace(
            hull, mass=mass * hull.mass, inertia=mass * hull.inertia, d_u=drag * hull.d_u, d_uu=drag * hull.d_uu
        )
        effects = (*self.boat.effects, *self._occurred)
        self._rhs = make_rhs(grown, self.boat.thruster, self._water, effects)

    def motion(self) -> RigidBodyState:
        """Return the true motion of the boat at the present time, as the input of the sensor models.

        The simulation does not advance.
        """
        s = self.state
        x, y, psi, u, v, r = s[:6]
        rate = self._rhs(s, *self._n, self.energy / ENERGY_UNIT, *self._forces)
        vel_n, vel_e = rate[0], rate[1]
        ax, ay = rate[3] - v * r, rate[4] + u * r
        thrust = self.thrust(0) + self.thrust(1)
        return RigidBodyState(self.t, x, y, psi, r, ax, ay, vel_n, vel_e, *self._antenna.place(s), thrust)

    def thrust(self, thruster: int) -> float:
        """Return the static thrust [N] of thruster 0 (left) or 1 (right) at its present shaft speed, positive forward.

        Hidden effects and delays of the thrust are not included. The simulated motor current depends on this thrust.
        """
        return thrust(self.boat.thruster, self.shafts[thruster].n)


class TowedLine:
    """Line that the boat tows: a point at its end is dragged through the water and follows the tow point."""

    def __init__(self, line: Line, step: float) -> None:
        """Set up a line, with the time ``step`` [s] between two calls of `step`. The first call places its end."""
        self._line, self._step = line, step
        self._end: tuple[float, float] | None = None

    def step(self, state: State, current: Sequence[float]) -> tuple[float, float, float]:
        """Move the end of the line to the next time, and return its force X, Y [N] and moment N [N m] on the boat.

        ``state`` is the state of the boat. ``current`` is the velocity of the water [m/s], north and east, with which
        the end drifts. A line that is not stretched exerts no force. The first call places the end behind the boat, at
        the length of the line.
        """
        x, y, psi = state[:3]
        c, s = math.cos(psi), math.sin(psi)
        tow = (x + c * self._line.x, y + s * self._line.x)
        if self._end is None:
            self._end = (tow[0] - c * self._line.length, tow[1] - s * self._line.length)
        north = tow[0] - self._end[0] - current[0] * self._step
        east = tow[1] - self._end[1] - current[1] * self._step
        distance = math.hypot(north, east)
        drawn = max(distance - self._line.length, 0.0)
        share = self._line.length / distance if drawn else 1.0
        self._end = (tow[0] - share * north, tow[1] - share * east)
        if not drawn:
            return 0.0, 0.0, 0.0
        tension = self._line.drag * (drawn / self._step) ** 2
        pull_n, pull_e = -tension * north / distance, -tension * east / distance
        sway = c * pull_e - s * pull_n
        return c * pull_n + s * pull_e, sway, self._line.x * sway


class HotThrusters:
    """Temperature of both thrusters of the simulated boat, and the thrust that they lose by it.

    The temperature is zero for a cold thruster and 1 at continuous full power.
    """

    def __init__(self, heating: Heating, step: float, n: float) -> None:
        """Set up two thrusters that have run at the shaft speed ``n`` (-1 to 1) for long. ``step`` is in s."""
        self._loss = heating.loss
        self._warming, self._cooling = (1.0 - math.exp(-step / (k * heating.tau)) for k in (1.0, 1.25))
        self._temperature = [abs(n) ** 2.8] * 2

    def advance(self, n: tuple[float, float]) -> None:
        """Advance the temperatures by one step, in which the shafts turn at the speeds ``n`` (-1 to 1)."""
        for side in (0, 1):
            gap = abs(n[side]) ** 2.8 - self._temperature[side]
            self._temperature[side] += gap * (self._warming if gap > 0.0 else self._cooling)

    def thrust(
        self, n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        """Return the thrust [N], left and right: ``f_l`` and ``f_r`` [N] less the parts that the heat takes."""
        left, right = self._temperature
        return f_l * (1.0 - self._loss * left), f_r * (1.0 - self._loss * right)


class Antenna:
    """GNSS antenna of the simulated boat, with a lever arm and a latency.

    60 % of the latency is dead time. 40 % is the time constant of a first-order filter. The attribute `latency` is the
    latency [s].
    """

    def __init__(self, arm: tuple[float, float], latency: float, step: float) -> None:
        """Set up a GNSS antenna: lever arm [m, m] (forward, starboard), latency [s] and step of the simulation [s]."""
        self._arm = arm
        self.latency = latency
        self._queue: deque[tuple[float, float, float, float]] = deque()
        self._queue_length = round(0.6 * latency / step)
        self._decay = math.exp(-step / (0.4 * latency)) if latency else 0.0
        self._filtered: tuple[float, float, float, float] | None = None

    def push(self, state: State) -> None:
        """Pass the state of the boat after a step through the latency of the antenna.

        It must be called after each step of the simulation if the latency is not 0, and not otherwise.
        """
        self._queue.append(self._position_and_velocity(state))
        if self._filtered is None:
            self._filtered = self._queue[0]
        if len(self._queue) > self._queue_length:
            new, old, keep = self._queue.popleft(), self._filtered, self._decay
            x, y, v_n, v_e = (b + keep * (a - b) for a, b in zip(old, new, strict=True))
            self._filtered = (x, y, v_n, v_e)

    def place(self, state: State) -> tuple[float, float, float, float]:
        """Return the position and velocity that the GNSS receiver reports: north, east [m], north, east [m/s].

        They are those of the antenna, without noise. Without a latency, or before the first `push`, they belong to
        ``state``, the present state of the boat. With a latency they follow from the states that `push` has taken.
        Until the dead time has passed, they are those of the first one.
        """
        return self._position_and_velocity(state) if self._filtered is None else self._filtered

    def _position_and_velocity(self, state: State) -> tuple[float, float, float, float]:
        """Return the position [m, m] and velocity [m/s, m/s] of the antenna, north and east, at a state of the boat."""
        x, y, psi, u, v, r = state[:6]
        c, s = math.cos(psi), math.sin(psi)
        forward, starboard = self._arm
        u_a, v_a = u - r * starboard, v + r * forward
        return (
            x + c * forward - s * starboard,
            y + s * forward + c * starboard,
            c * u_a - s * v_a,
            s * u_a + c * v_a,
        )
