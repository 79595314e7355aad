"""Simulated bench: one thruster on a rod in a pool, whose thrust is measured by a load cell.

Hidden effects of the bench act on the force (`BenchEffect`) or on the response of the shaft (`ShaftEffect`).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np

from seatrial.mocks.plant.thruster import Shaft, ThrusterTruth, draw_thruster, thrust
from seatrial.mocks.random_streams import (
    DISTURBANCE,
    EFFECT_NAME,
    EFFECT_SIZE,
    OrnsteinUhlenbeck,
    normals,
    random_stream,
)

PLANT_STEP_S = 0.0025  # s
DISTURBANCE_EVERY = 4  # steps; the disturbance force changes at 100 Hz
SIGMA, TAU = 0.1, 0.3  # N, s; standard deviation and correlation time of the disturbance in a pool at rest
# Fields of BenchEffect and ShaftEffect that belong to each effect
_PARAMETERS: dict[str, tuple[str, ...]] = {
    "none": (),
    "rod-flex": ("flex_hz", "flex_damping", "flex_share"),
    "recirculation": ("wash", "wash_s"),
    "cell-drift": ("drift",),
    "cell-lag": ("smooth_s",),
    "reverse-loss": ("reverse",),
    "thrust-exponent": ("slow_loss",),
    "thrust-dead-band": ("band",),
    "supply-sag": ("sag",),
    "speed-curve": ("droop",),
    "second-lag": ("late",),
    "spin-up": ("brisk",),
    "slew-limit": ("slew",),
}


@dataclass(frozen=True)
class ShaftEffect:
    """Hidden effects of the shaft's response to commands. A size of zero switches the effect off."""

    late: float = 0.0  # s, time constant of a lag in front of the shaft; 5 % longer at rest than at full speed
    brisk: float = 0.0  # fraction by which the pole is higher while the shaft speeds up
    slew: float = 0.0  # s, inverse of the highest acceleration at rest; at full speed a sixth longer
    droop: float = 0.0  # fraction of the speed that is missing at full command
    sag: float = 0.0  # fraction of the speed that is lost with an empty battery

    @property
    def any(self) -> bool:
        """Return whether one of the effects is switched on."""
        return bool(self.late or self.brisk or self.slew or self.droop or self.sag)


NO_SHAFT_EFFECT = ShaftEffect()


@dataclass(frozen=True)
class BenchEffect:
    """Hidden effect of the bench, or no effect. A size of zero switches a part of the effect off."""

    name: str
    sentence: str  # description for the user
    flex_hz: float = 0.0  # Hz, resonance of the rod in its mount
    flex_damping: float = 0.04  # damping ratio of the rod
    flex_share: float = 1.0  # share of the force that passes the resonance
    wash: float = 0.0  # recirculation: fraction of the thrust that is lost if the pool is in full motion
    wash_s: float = 4.0  # s, time constant in which the pool gets into motion
    drift: float = 0.0  # N/min^1/2, drift of the load cell with the square root of time
    smooth_s: float = 0.0  # s, total time constant of the load cell's filter, which has two equal poles
    reverse: float = 0.0  # fraction of the thrust that is lost in reverse at full speed
    slow_loss: float = 0.0  # fraction of the thrust that is lost at the lowest shaft speeds
    band: float = 0.0  # shaft speed (normalised) below which there is almost no thrust
    shaft: ShaftEffect = NO_SHAFT_EFFECT

    @property
    def parameters(self) -> dict[str, float]:
        """Return the true sizes that belong to this effect (SI)."""
        values = asdict(self) | asdict(self.shaft)
        return {name: float(values[name]) for name in _PARAMETERS[self.name]}


NONE = BenchEffect("none", "no hidden effect: the nominal model is complete")
# The position in this table selects the stream of random numbers: add new effects at the end.
EFFECTS: dict[str, Callable[[np.random.Generator, float], BenchEffect]] = {
    "rod-flex": lambda rng, scale: BenchEffect(
        "rod-flex", "the rod swings in its mount when thrust changes", flex_hz=_around(rng, 6.0), flex_share=scale
    ),
    "recirculation": lambda rng, scale: BenchEffect(
        "recirculation", "the jet sets the pool in motion and loses thrust to it", wash=scale * _around(rng, 0.12)
    ),
    "cell-drift": lambda rng, scale: BenchEffect(
        "cell-drift", "the load cell creeps as it warms up", drift=scale * _around(rng, 1.0, signed=True)
    ),
    "reverse-loss": lambda rng, scale: BenchEffect(
        "reverse-loss", "in reverse the propeller gives less than its coefficients", reverse=scale * _around(rng, 0.15)
    ),
    "supply-sag": lambda rng, scale: _shaft(
        "supply-sag", "the shaft slows down as the battery is used up", sag=scale * _around(rng, 0.08)
    ),
    "second-lag": lambda rng, scale: _shaft(
        "second-lag", "the speed controller smooths its commands", late=scale * _around(rng, 0.08)
    ),
    "spin-up": lambda rng, scale: _shaft(
        "spin-up", "the shaft speeds up faster than it slows down", brisk=scale * _around(rng, 0.24)
    ),
    "slew-limit": lambda rng, scale: _shaft(
        "slew-limit", "the motor's current is limited, and so is the acceleration of the shaft",
        slew=scale * _around(rng, 0.8),
    ),
    "speed-curve": lambda rng, scale: _shaft(
        "speed-curve", "the larger the command, the more the shaft falls behind it", droop=scale * _around(rng, 0.08)
    ),
    "thrust-dead-band": lambda rng, scale: BenchEffect(
        "thrust-dead-band", "at slow speed the propeller gives hardly any thrust", band=scale * _around(rng, 0.04)
    ),
    "thrust-exponent": lambda rng, scale: BenchEffect(
        "thrust-exponent", "slow blades lose thrust to viscosity", slow_loss=scale * _around(rng, 0.3)
    ),
    "cell-lag": lambda rng, scale: BenchEffect(
        "cell-lag", "the amplifier of the load cell smooths", smooth_s=scale * _around(rng, 0.06)
    ),
}  # fmt: skip
DEMO = ("rod-flex", "recirculation", "cell-drift")  # effects that `--effect draw` chooses from


def _around(rng: np.random.Generator, size: float, *, signed: bool = False) -> float:
    """Return a random size within 15 % of ``size``; the sign is random too if ``signed`` is set."""
    return float(size * rng.uniform(0.85, 1.15)) * (1 - 2 * (signed and rng.uniform() < 0.5))


def _shaft(name: str, sentence: str, **sizes: float) -> BenchEffect:
    """Return an effect on the response of the shaft."""
    return BenchEffect(name, sentence, shaft=ShaftEffect(**sizes))


def make_effect(name: str, seed: int, scale: float = 1.0) -> BenchEffect:
    """Return the effect ``name`` with the size that ``seed`` draws, times ``scale``.

    Raises
    ------
    KeyError
        If no effect of the bench has this name.
    """
    return EFFECTS[name](random_stream(seed, EFFECT_SIZE, index=100 + list(EFFECTS).index(name)), scale)


def draw_name(seed: int) -> str:
    """Return the name of the effect that ``--effect draw`` chooses for this seed."""
    return DEMO[int(random_stream(seed, EFFECT_NAME, index=1).integers(len(DEMO)))]


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

    def __init__(self, bench: Bench, run: int = 0, *, step: float = PLANT_STEP_S, disturbed: bool = True) -> None:
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
