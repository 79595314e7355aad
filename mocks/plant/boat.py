"""Simulated boat: hull, two thrusters, ocean current, disturbance forces and hidden effects."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import NamedTuple

from seatrial.mocks.plant.effect import ENERGY_UNIT, HiddenEffect
from seatrial.mocks.plant.hull import ARM, AT_REST, Hull, State, draw_current, draw_hull, make_rhs, rk4
from seatrial.mocks.plant.thruster import Inflow, Shaft, ThrusterTruth, thrust
from seatrial.mocks.plant.weather import Weather
from seatrial.mocks.random_streams import DISTURBANCE, START, OrnsteinUhlenbeck, normals, random_stream

PLANT_STEP_S = 0.005  # s
DISTURBANCE_EVERY = 4  # steps; the disturbance forces change at 50 Hz
SIGMA = (0.3, 0.3, 0.03)  # N, N, N m; standard deviation of the disturbance forces in calm water
TAU = 2.0  # s, correlation time of the disturbance forces


@dataclass(frozen=True)
class Boat:
    """Boat parameters that are the same in all runs. The same seed and effects give the same boat."""

    hull: Hull
    thruster: ThrusterTruth  # of both thrusters
    current: tuple[float, float]  # m/s, north and east
    effects: tuple[HiddenEffect, ...]
    seed: int

    def truth(self) -> dict[str, float]:
        """Return the true parameters of this boat (SI), with the names of the thesis' model."""
        rigid = {"mass": self.hull.mass, "inertia": self.hull.inertia}
        current = {"current_n": self.current[0], "current_e": self.current[1], "arm": ARM}
        return {**self.hull.lumped(), **asdict(self.thruster), **current, **rigid}


def draw_boat(seed: int, effects: Sequence[HiddenEffect] = (), thruster: ThrusterTruth | None = None) -> Boat:
    """Return the boat of a seed.

    The parameters of the hull are within 10 % of their nominal values. The current is constant.

    Parameters
    ----------
    thruster : ThrusterTruth, optional
        Parameters of both thrusters; without it the nominal ones.
    """
    return Boat(draw_hull(seed), thruster or ThrusterTruth(), draw_current(seed), tuple(effects), seed)


class RigidBodyState(NamedTuple):
    """True motion of the plant at one time, as the input of the sensors.

    The axes are NED and body axes as in seatrial.daq.samples.
    """

    t: float  # s since the plant's start
    x: float  # m, north
    y: float  # m, east
    psi: float  # rad
    r: float  # rad/s
    ax: float  # m/s2, acceleration of the origin in body axes
    ay: float  # m/s2
    vel_n: float  # m/s
    vel_e: float  # m/s
    fix_x: float  # m, position and velocity that the GNSS receiver reports, without noise
    fix_y: float  # m
    fix_vel_n: float  # m/s
    fix_vel_e: float  # m/s
    thrust: float = 0.0  # N, static thrust of both thrusters at their shaft speeds


class BoatPlant:
    """Simulation of a boat with a fixed step. Thruster 0 is the left one, thruster 1 the right one."""

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
        """Set up the boat at time 0.

        Parameters
        ----------
        run : int
            Number of the run. It selects the random disturbances and the initial heading.
        step : float
            Step of the integration [s].
        state : State, optional
            Initial state. Without it the boat drifts with the current.
        disturbed : bool
            Whether random disturbance forces act.
        n : float
            Initial shaft speed of both thrusters, normalised.
        """
        self.boat = boat
        self.step_s = step
        self.steps = 0
        self.energy = 0.0
        self.shafts = (Shaft(boat.thruster, 0.5 * step, n), Shaft(boat.thruster, 0.5 * step, n))
        self._water = list(boat.current)  # current velocity; the right-hand side reads this list at each call
        self._rhs = make_rhs(boat.hull, boat.thruster, self._water, boat.effects)
        self._n = (n, n)  # shaft speeds that act on the water, behind the delays of hidden effects
        self._inflows = self._make_inflows(n)
        self._drifts = [e.current for e in boat.effects if e.current is not None]
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
        """Return the delay from shaft speed to thrust of each thruster; empty if no effect delays the thrust."""
        delay, lag = (sum(e.inflow[k] for e in self.boat.effects) for k in (0, 1))
        return [Inflow(delay, lag, 0.5 * self.step_s, n) for _ in range(2)] if delay or lag else []

    def _first_state(self, run: int) -> State:
        """Return a state that drifts with the current, with a random heading."""
        psi = float(random_stream(self.boat.seed, START, run).uniform(-math.pi, math.pi))
        v_n, v_e = self.boat.current
        c, s = math.cos(psi), math.sin(psi)
        return (0.0, 0.0, psi, c * v_n + s * v_e, c * v_e - s * v_n, *AT_REST[5:])

    @property
    def t(self) -> float:
        """Time since the start [s]."""
        return self.steps * self.step_s

    def command(self, thruster: int, t: float, n_cmd: float) -> None:
        """Set the command of thruster 0 (left) or 1 (right) from time ``t`` [s] on: -1 to 1, positive forward."""
        self.shafts[thruster].command(t, n_cmd)

    def advance(self) -> None:
        """Integrate one step."""
        if self.steps % DISTURBANCE_EVERY == 0:
            self._disturb()
        left, right = self.shafts
        energy = self.energy / ENERGY_UNIT
        k1 = self._rhs(self.state, *self._n, energy, *self._forces)
        n_mid = (left.advance(), right.advance())
        n_end = (left.advance(), right.advance())
        f_mid, self._n = self._delayed(n_mid), self._delayed(n_end)
        self.state = rk4(self._rhs, self.state, k1, self.step_s, (*f_mid, *self._n), energy, self._forces)
        self.energy += self.step_s * (abs(n_mid[0]) ** 3 + abs(n_mid[1]) ** 3)
        self.steps += 1
        if self._antenna.latency:
            self._antenna.push(self.state)

    def _delayed(self, n: tuple[float, float]) -> tuple[float, float]:
        """Return the delayed shaft speeds that produce thrust. Call it once for each half step."""
        if not self._inflows:
            return n
        left, right = self._inflows
        return left.advance(n[0]), right.advance(n[1])

    def _disturb(self) -> None:
        """Update the external forces and the current for the next DISTURBANCE_EVERY steps."""
        x, y, n = (d.step() for d in self._disturbances) if self._disturbances else (0.0, 0.0, 0.0)
        if self._weather:
            weather = self._weather.forces(self.t, self.state[2])
            x, y, n = x + weather[0], y + weather[1], n + weather[2]
        self._forces = (x, y, n)
        if self._drifts:
            changes = [drift(self.t) for drift in self._drifts]
            self._water[:] = (v + sum(c[k] for c in changes) for k, v in enumerate(self.boat.current))

    def motion(self) -> RigidBodyState:
        """Return the true motion at the present time, as the input of the sensors."""
        s = self.state
        x, y, psi, u, v, r = s[:6]
        rate = self._rhs(s, *self._n, self.energy / ENERGY_UNIT, *self._forces)
        vel_n, vel_e = rate[0], rate[1]
        ax, ay = rate[3] - v * r, rate[4] + u * r
        thrust = self.thrust(0) + self.thrust(1)
        return RigidBodyState(self.t, x, y, psi, r, ax, ay, vel_n, vel_e, *self._antenna.place(s), thrust)

    def thrust(self, thruster: int) -> float:
        """Return the static thrust [N] at the shaft speed of a thruster. Its motor current depends on this thrust."""
        return thrust(self.boat.thruster, self.shafts[thruster].n)


class Antenna:
    """GNSS antenna with a lever arm and a latency.

    60 % of the latency is dead time. 40 % is the time constant of a first-order filter.
    """

    def __init__(self, arm: tuple[float, float], latency: float, step: float) -> None:
        """Set the lever arm [m, m] (forward, starboard), the latency [s] and the step of the simulation [s]."""
        self._arm = arm
        self.latency = latency
        self._queue: deque[tuple[float, float, float, float]] = deque()
        self._length = round(0.6 * latency / step)
        self._keep = math.exp(-step / (0.4 * latency)) if latency else 0.0
        self._filtered: tuple[float, float, float, float] | None = None

    def push(self, state: State) -> None:
        """Add the state after a step. Only an antenna with a latency needs these calls."""
        self._queue.append(self._at(state))
        if self._filtered is None:
            self._filtered = self._queue[0]
        if len(self._queue) > self._length:
            new, old, keep = self._queue.popleft(), self._filtered, self._keep
            x, y, v_n, v_e = (b + keep * (a - b) for a, b in zip(old, new, strict=True))
            self._filtered = (x, y, v_n, v_e)

    def place(self, state: State) -> tuple[float, float, float, float]:
        """Return the reported position [m, m] and velocity [m/s, m/s], each north and east.

        Without a latency they belong to ``state``; with one, to the states that `push` has added.
        """
        return self._at(state) if self._filtered is None else self._filtered

    def _at(self, state: State) -> tuple[float, float, float, float]:
        """Return position and velocity of the antenna, without a latency."""
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
