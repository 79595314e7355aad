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

STEP = 0.0025  # s
DISTURBANCE_EVERY = 4  # steps; the disturbance force changes at 100 Hz
SIGMA, TAU = 0.1, 0.3  # N, s; standard deviation and correlation time of the disturbance in a pool at rest


@dataclass(frozen=True)
class Bench:
    """Bench parameters that are the same in all runs."""

    thruster: ThrusterTruth
    effect: BenchEffect
    seed: int

    def truth(self) -> dict[str, float]:
        """Return the true parameters of the thruster (SI)."""
        return asdict(self.thruster)


def draw_bench(seed: int, effect: BenchEffect = NONE) -> Bench:
    """Return the bench of a seed. The thrust coefficients of its thruster are within 5 % of their nominal values."""
    return Bench(draw_thruster(seed), effect, seed)


class BenchPlant:
    """Simulation of a bench with a fixed step."""

    def __init__(self, bench: Bench, run: int = 0, *, step: float = STEP, disturbed: bool = True) -> None:
        """Set up the bench at time 0.

        Parameters
        ----------
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
        self._pool = 0.0
        self._disturbance: OrnsteinUhlenbeck | None = None
        if disturbed:
            draw = normals(random_stream(bench.seed, DISTURBANCE, run))
            self._disturbance = OrnsteinUhlenbeck(draw, DISTURBANCE_EVERY * step, SIGMA, TAU)
        self._wash = 0.0
        self._rod = _Rod(bench.effect.flex_hz, bench.effect.flex_damping, step)
        self._cell = [0.0, 0.0]

    @property
    def t(self) -> float:
        """Time since the start [s]."""
        return self.steps * self.step_s

    def command(self, thruster: int, t: float, n_cmd: float) -> None:
        """Set the command from time ``t`` [s] on: -1 to 1, positive forward. ``thruster`` is always 0."""
        self.shafts[thruster].command(t, n_cmd)

    def advance(self) -> None:
        """Integrate one step."""
        if self._disturbance is not None and self.steps % DISTURBANCE_EVERY == 0:
            self._pool = self._disturbance.step()
        n = self.shafts[0].advance()
        self.energy += self.step_s * abs(n) ** 3
        if self.bench.effect.wash:
            self._wash += self.step_s / self.bench.effect.wash_s * (n * n - self._wash)
        if self.bench.effect.flex_hz:
            self._rod.advance(self.thrust())
        if self.bench.effect.smooth_s:
            self._smooth()
        self.steps += 1

    def thrust(self, thruster: int = 0) -> float:
        """Return the force [N] of the propeller on its shaft, positive forward."""
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
        """Return the force [N] that the load cell measures, without noise."""
        effect = self.bench.effect
        if effect.smooth_s:
            return self._cell[1] + effect.drift * math.sqrt(self.t / 60.0)
        return self._rod_force() + effect.drift * math.sqrt(self.t / 60.0)

    def _rod_force(self) -> float:
        """Return the force [N] at the end of the rod: the thrust behind the rod's resonance, and the disturbance."""
        effect, force = self.bench.effect, self.thrust()
        if effect.flex_hz:
            force += effect.flex_share * (self._rod.force - force)
        return force + self._pool

    def _smooth(self) -> None:
        """Advance the filter of the load cell by one step."""
        decay, force = math.exp(-2.0 * self.step_s / self.bench.effect.smooth_s), self._rod_force()
        for k in range(2):
            force = self._cell[k] = force + (self._cell[k] - force) * decay


class _Rod:
    """Rod in its mount: a second-order system with little damping.

    The solution is exact for a force that is constant in each step.
    """

    def __init__(self, frequency_hz: float, damping: float, step: float) -> None:
        """Set the natural frequency [Hz], the damping ratio and the step [s]."""
        omega = 2.0 * math.pi * frequency_hz
        sigma, self._omega_d = damping * omega, omega * math.sqrt(1.0 - damping**2)
        decay, angle = math.exp(-sigma * step), self._omega_d * step
        self._rotate = (decay * math.cos(angle), decay * math.sin(angle), sigma)
        self.force = 0.0
        self._rate = 0.0

    def advance(self, force: float) -> None:
        """Advance by one step under ``force`` [N]. The force at the load cell is then `self.force`."""
        c, s, sigma = self._rotate
        x, v, w = self.force - force, self._rate, self._omega_d
        self.force = force + c * x + s * (v + sigma * x) / w
        self._rate = c * v - s * (sigma * v + (sigma**2 + w**2) * x) / w


class BenchShaft:
    """Shaft of a thruster with a hidden effect.

    Delay and dead zone are those of ``Shaft``. The reference is then reduced by droop and sag, and passes an additional
    lag. The pole of the shaft may depend on the direction of the change, and the acceleration may be limited.

    Each step is split at the times at which the reference changes. Lag and shaft are solved exactly one after the
    other.
    """

    def __init__(self, truth: ThrusterTruth, effect: ShaftEffect, dt: float) -> None:
        """Start at rest at time 0. ``dt`` is the step [s]."""
        self._truth, self._effect, self._dt = truth, effect, dt
        self._steps = 0
        self._ref = self._late = 0.0
        self._pending: deque[tuple[float, float]] = deque()
        self.n = 0.0
        self.energy = 0.0

    def command(self, t: float, n_cmd: float) -> None:
        """Queue a command (-1 to 1, positive forward) that was received at time ``t`` [s]; ``t`` never decreases."""
        ref = 0.0 if abs(n_cmd) < self._truth.dead_zone else max(-1.0, min(1.0, n_cmd))
        self._pending.append((t + self._truth.delay, ref))

    def advance(self) -> float:
        """Advance the shaft by one step and return its speed (normalised)."""
        t, self._steps = self._steps * self._dt, self._steps + 1
        end = self._steps * self._dt
        while self._pending and self._pending[0][0] < end:
            t_switch, ref = self._pending.popleft()
            if t_switch > t:
                self._relax(t_switch - t)
                t = t_switch
            self._ref = ref
        self._relax(end - t)
        return self.n

    def _relax(self, dt: float) -> None:
        """Advance by ``dt`` [s] with a constant reference."""
        effect = self._effect
        target = self._ref * (1.0 - effect.droop * abs(self._ref) ** 1.3)
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
