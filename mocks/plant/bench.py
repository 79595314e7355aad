"""Simulated bench: one thruster on a rod in a pool, whose thrust is measured by a load cell.

Hidden effects of the bench act on the force (`BenchEffect`) or on the response of the shaft (`ShaftEffect`), both in
seatrial.mocks.plant.bench_effect.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import asdict, dataclass

from seatrial.mocks.plant.bench_effect import NONE, BenchEffect, ShaftEffect
from seatrial.mocks.plant.thruster import Shaft, ThrusterTruth, draw_thruster, thrust
from seatrial.mocks.random_streams import (
    DISTURBANCE,
    OrnsteinUhlenbeck,
    normals,
    random_stream,
)

PLANT_STEP_S = 0.0025  # s
DISTURBANCE_EVERY = 4  # steps; the disturbance force changes at 100 Hz
SIGMA, TAU = 0.1, 0.3  # N, s; standard deviation and correlation time of the disturbance in a pool at rest


@dataclass(frozen=True)
class Bench:
    """Parameters of a simulated bench that are the same in all its runs.

    Attributes
    ----------
    thruster : ThrusterTruth
        True parameters of the thruster.
    effect : BenchEffect
        Hidden effect of the bench.
    seed : int
        Seed of the random numbers of the plant and the sensors.
    """

    thruster: ThrusterTruth
    effect: BenchEffect
    seed: int

    def truth(self) -> dict[str, float]:
        """Return the true parameters of the bench's thruster (SI), by the names of the fields of `ThrusterTruth`."""
        return asdict(self.thruster)


def draw_bench(seed: int, effect: BenchEffect = NONE) -> Bench:
    """Return the parameters of the simulated bench that belongs to ``seed``, with the hidden effect ``effect``.

    The thrust coefficients c1 and c2 of its thruster are drawn within 5 % of their nominal values. The effect is not
    drawn here. The same seed gives the same thruster.
    """
    return Bench(draw_thruster(seed), effect, seed)


class BenchPlant:
    """Simulation of a bench, one thruster on a rod with a load cell, with a fixed step.

    Attributes
    ----------
    bench : Bench
        Parameters of the bench.
    step_s : float
        Step of the integration [s].
    steps : int
        Number of steps since the start.
    energy : float
        Integral of ``|n|^3`` over time [s], with the normalised shaft speed n. It measures the use of the battery.
    shafts : tuple of one Shaft or BenchShaft
        The shaft. `BenchShaft` is used only if a hidden effect acts on it.
    """

    def __init__(self, bench: Bench, run: int = 0, *, step: float = PLANT_STEP_S, disturbed: bool = True) -> None:
        """Set up the bench at time 0, with the shaft and the water at rest.

        Parameters
        ----------
        bench : Bench
            Parameters and hidden effect of the bench.
        run : int
            Number of the run. It selects the random disturbance.
        step : float
            Step of the integration [s].
        disturbed : bool
            Whether the random force of the moving water acts on the rod.
        """
        self.bench = bench
        self.step_s = step
        self.steps = 0
        self.energy = 0.0
        effect = bench.effect.shaft
        self.shafts: tuple[Shaft | BenchShaft] = (
            BenchShaft(bench.thruster, effect, step) if effect.any else Shaft(bench.thruster, step),
        )
        self._water_force = 0.0
        self._disturbance: OrnsteinUhlenbeck | None = None
        if disturbed:
            draw = normals(random_stream(bench.seed, DISTURBANCE, run))
            self._disturbance = OrnsteinUhlenbeck(draw, DISTURBANCE_EVERY * step, SIGMA, TAU)
        self._wash = 0.0
        self._rod = _Rod(bench.effect.flex_hz, bench.effect.flex_damping, step)
        self._cell = [0.0, 0.0]

    @property
    def t(self) -> float:
        """Simulated time since the start of the bench [s]."""
        return self.steps * self.step_s

    def command(self, thruster: int, t: float, n_cmd: float) -> None:
        """Set the command ``n_cmd`` of the thruster from time ``t`` [s] on: -1 to 1, positive forward.

        ``thruster`` must be 0, the only one. Values beyond -1 to 1 are clipped. Values in the thruster's dead zone
        count as 0. From call to call ``t`` must not decrease.
        """
        self.shafts[thruster].command(t, n_cmd)

    def advance(self) -> None:
        """Integrate the simulated bench by one step ``step_s``.

        This advances disturbance, shaft, used energy, motion of the pool, rod and filter of the load cell.
        """
        if self._disturbance is not None and self.steps % DISTURBANCE_EVERY == 0:
            self._water_force = self._disturbance.step()
        n = self.shafts[0].advance()
        self.energy += self.step_s * abs(n) ** 3
        if self.bench.effect.wash:
            self._wash += self.step_s / self.bench.effect.wash_s * (n * n - self._wash)
        if self.bench.effect.flex_hz:
            self._rod.advance(self.thrust())
        if self.bench.effect.smooth_s:
            self._advance_cell_filter()
        self.steps += 1

    def thrust(self, thruster: int = 0) -> float:
        """Return the thrust [N] of the bench's propeller at its present shaft speed, positive forward.

        ``thruster`` must be 0. The losses of thrust by hidden effects are included. The rod, the load cell and the
        random force of the water are not.
        """
        effect, n = self.bench.effect, self.shafts[thruster].n
        if effect.band:
            n -= effect.band * math.tanh(n / effect.band)
        force = thrust(self.bench.thruster, n)
        if effect.wash:
            force *= 1.0 - effect.wash * math.sqrt(self._wash)
        if effect.reverse and n < 0.0:
            force *= 1.0 - effect.reverse * abs(n) ** 1.4
        if effect.slow_loss:
            force *= 1.0 - effect.slow_loss * math.exp(-2.5 * abs(n))
        return force

    def force(self) -> float:
        """Return the force [N] that the load cell measures, positive forward.

        It includes the resonance of the rod, the random force of the water, and the filter and drift of the load cell,
        but no sensor noise.
        """
        effect = self.bench.effect
        if effect.smooth_s:
            return self._cell[1] + effect.drift * math.sqrt(self.t / 60.0)
        return self._rod_force() + effect.drift * math.sqrt(self.t / 60.0)

    def _rod_force(self) -> float:
        """Return the force [N] on the load cell: the thrust, plus the force of the water.

        The share `flex_share` of the thrust passes the rod's resonance, unless the rod is rigid.
        """
        effect, force = self.bench.effect, self.thrust()
        if effect.flex_hz:
            force += effect.flex_share * (self._rod.force - force)
        return force + self._water_force

    def _advance_cell_filter(self) -> None:
        """Advance the two equal first-order lags of the load cell's filter by one step.

        It must be called only if the hidden effect has such a filter (``smooth_s`` is not 0).
        """
        decay, force = math.exp(-2.0 * self.step_s / self.bench.effect.smooth_s), self._rod_force()
        for k in range(2):
            force = self._cell[k] = force + (self._cell[k] - force) * decay


class _Rod:
    """Rod of the bench in its mount: a second-order system from the thrust to the force on the load cell.

    Its static gain is one, and its damping ratio is below 1. The solution is exact for a thrust that is constant in
    each step. The attribute `force` is the present force on the load cell [N].
    """

    def __init__(self, frequency_hz: float, damping: float, step: float) -> None:
        """Set up a rod at rest with its natural frequency [Hz] and damping ratio (below 1).

        ``step`` is the step of the simulation [s]. With the frequency 0 (a rigid rod) `advance` must not be called.
        """
        omega = 2.0 * math.pi * frequency_hz
        sigma, self._omega_d = damping * omega, omega * math.sqrt(1.0 - damping**2)
        decay, angle = math.exp(-sigma * step), self._omega_d * step
        self._rotate = (decay * math.cos(angle), decay * math.sin(angle), sigma)
        self.force = 0.0
        self._rate = 0.0

    def advance(self, force: float) -> None:
        """Advance the rod by one step under the constant thrust ``force`` [N]; `self.force` is then its new output."""
        c, s, sigma = self._rotate
        x, v, w = self.force - force, self._rate, self._omega_d
        self.force = force + c * x + s * (v + sigma * x) / w
        self._rate = c * v - s * (sigma * v + (sigma**2 + w**2) * x) / w


class BenchShaft:
    """Shaft of a simulated thruster whose response to commands has a hidden effect (`ShaftEffect`).

    Delay and dead zone are those of ``Shaft``. The delayed command is then reduced by dead band, droop and sag, and
    passes an additional lag. The pole of the shaft may depend on the direction of the change, and the acceleration may
    be limited.

    Each step is split at the times at which the delayed command changes. Lag and shaft are computed one after the
    other. The attribute `n` is the present shaft speed (normalised, positive forward), and `energy` is the integral of
    ``|n|^3`` over time [s].
    """

    def __init__(self, truth: ThrusterTruth, effect: ShaftEffect, dt: float) -> None:
        """Set up a shaft at rest at time 0.

        Parameters
        ----------
        truth : ThrusterTruth
            True parameters of the thruster.
        effect : ShaftEffect
            Hidden effects of the shaft's response.
        dt : float
            Step of the simulation [s].
        """
        self._truth, self._effect, self._dt = truth, effect, dt
        self._steps = 0
        self._ref = self._late = 0.0
        self._pending: deque[tuple[float, float]] = deque()
        self.n = 0.0
        self.energy = 0.0

    def command(self, t: float, n_cmd: float) -> None:
        """Take a command (-1 to 1, positive forward) at time ``t`` [s]; it acts after the thruster's delay.

        Values beyond -1 to 1 are clipped. Values in the thruster's dead zone count as 0. From call to call ``t`` must
        not decrease.
        """
        ref = 0.0 if abs(n_cmd) < self._truth.dead_zone else max(-1.0, min(1.0, n_cmd))
        self._pending.append((t + self._truth.delay, ref))

    def advance(self) -> float:
        """Advance the shaft by one step of the simulation, and return its speed (normalised, positive forward)."""
        t, self._steps = self._steps * self._dt, self._steps + 1
        end = self._steps * self._dt
        while self._pending and self._pending[0][0] < end:
            t_switch, ref = self._pending.popleft()
            if t_switch > t:
                self._advance_with_constant_reference(t_switch - t)
                t = t_switch
            self._ref = ref
        self._advance_with_constant_reference(end - t)
        return self.n

    def _advance_with_constant_reference(self, dt: float) -> None:
        """Advance the additional lag and the shaft by ``dt`` [s] while the delayed command is constant.

        The integral of ``|n|^3`` (`energy`) is advanced too.
        """
        effect = self._effect
        target = math.copysign(max(abs(self._ref) - effect.ignored, 0.0) / (1.0 - effect.ignored), self._ref)
        target *= 1.0 - effect.droop * abs(target) ** 1.3
        target *= 1.0 - effect.sag * (1.0 - math.exp(-self.energy / 30.0))
        if effect.late:
            time_constant = effect.late * (1.05 - 0.05 * abs(self.n))
            before = self._late
            self._late = target + (before - target) * math.exp(-dt / time_constant)
            target = (before + self._late) / 2.0
        pole = self._truth.pole * (1.0 + effect.brisk * (abs(target) > abs(self.n)))
        change = (target - self.n) * -math.expm1(-pole * dt)
        if effect.slew:
            limit = dt / (effect.slew * (1.0 + abs(self.n) / 6.0))
            change = max(-limit, min(limit, change))
        self.n += change
        self.energy += dt * abs(self.n) ** 3
