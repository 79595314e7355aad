"""The simulated bench: one thruster on a rod in a pool, its thrust measured by a load cell.

Its hidden effects act on the force (`BenchEffect`) or on the response of the shaft to commands (`ShaftEffect`).
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

STEP = 0.0025  # s
DISTURBANCE_EVERY = 4  # steps: 100 Hz
SIGMA, TAU = 0.1, 0.3  # N, s: a pool at rest
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
    """Sizes; zero is none of it."""

    late: float = 0.0  # s, a lag before the shaft's own; longer by a twentieth at rest
    brisk: float = 0.0  # fraction by which the pole is higher while the shaft speeds up
    slew: float = 0.0  # s, from rest to full speed at the highest acceleration there; at full speed a sixth longer
    droop: float = 0.0  # fraction of the speed that is missing at full command
    sag: float = 0.0  # fraction of the speed lost with an empty battery

    @property
    def any(self) -> bool:
        """Whether there is any."""
        return bool(self.late or self.brisk or self.slew or self.droop or self.sag)


NO_SHAFT_EFFECT = ShaftEffect()


@dataclass(frozen=True)
class BenchEffect:
    """One effect on the bench, or none; a size of zero switches its line in ``BenchPlant`` off."""

    name: str
    sentence: str
    flex_hz: float = 0.0  # rod: resonance of the mount
    flex_damping: float = 0.04
    flex_share: float = 1.0  # of the force that goes through what swings
    wash: float = 0.0  # recirculation: fraction of thrust lost in a pool in full motion
    wash_s: float = 4.0  # s, to set the pool in motion
    drift: float = 0.0  # N/min^1/2 of the cell
    smooth_s: float = 0.0  # s, of the cell's filter, two equal poles
    reverse: float = 0.0  # fraction of thrust lost in reverse at full speed
    slow_loss: float = 0.0  # fraction of thrust lost at the slowest speeds
    band: float = 0.0  # shaft speed below which there is next to no thrust
    shaft: ShaftEffect = NO_SHAFT_EFFECT

    @property
    def parameters(self) -> dict[str, float]:
        """The sizes that belong to this effect."""
        values = asdict(self) | asdict(self.shaft)
        return {name: float(values[name]) for name in _PARAMETERS[self.name]}


NONE = BenchEffect("none", "nothing but what the nominal model has")
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
DEMO = ("rod-flex", "recirculation", "cell-drift")


def _around(rng: np.random.Generator, size: float, *, signed: bool = False) -> float:
    return float(size * rng.uniform(0.85, 1.15)) * (1 - 2 * (signed and rng.uniform() < 0.5))


def _shaft(name: str, sentence: str, **sizes: float) -> BenchEffect:
    return BenchEffect(name, sentence, shaft=ShaftEffect(**sizes))


def make_effect(name: str, seed: int, scale: float = 1.0) -> BenchEffect:
    """The effect ``name`` (KeyError if there is none) as ``seed`` draws it, ``scale`` times its full size."""
    return EFFECTS[name](random_stream(seed, EFFECT_SIZE, index=100 + list(EFFECTS).index(name)), scale)


def draw_name(seed: int) -> str:
    """The name that ``--effect draw`` takes at this seed."""
    return DEMO[int(random_stream(seed, EFFECT_NAME, index=1).integers(len(DEMO)))]


@dataclass(frozen=True)
class Bench:
    """What stays the same from run to run."""

    thruster: ThrusterTruth
    effect: BenchEffect
    seed: int

    def truth(self) -> dict[str, float]:
        """The true parameters of the thruster (SI)."""
        return asdict(self.thruster)


def draw_bench(seed: int, effect: BenchEffect = NONE) -> Bench:
    """The bench of a seed: a thruster with c1 and c2 within 5 % of nominal."""
    return Bench(draw_thruster(seed), effect, seed)


class BenchPlant:
    """Integrates the bench in steps of ``step`` seconds."""

    def __init__(self, bench: Bench, run: int = 0, *, step: float = STEP, disturbed: bool = True) -> None:
        """``run`` names the disturbance of the pool."""
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
        """Seconds since the start."""
        return self.steps * self.step_s

    def command(self, thruster: int, t: float, n_cmd: float) -> None:
        """Command of thruster 0, the only one, from time ``t`` (s) on: -1..1, positive forward."""
        self.shafts[thruster].command(t, n_cmd)

    def advance(self) -> None:
        """One step."""
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
        """Force of the propeller on its shaft, N, positive forward."""
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
        """Force on the cell, N."""
        effect = self.bench.effect
        if effect.smooth_s:
            return self._cell[1] + effect.drift * math.sqrt(self.t / 60.0)
        return self._pushed() + effect.drift * math.sqrt(self.t / 60.0)

    def _pushed(self) -> float:
        """Force on the rod's end, N."""
        effect, force = self.bench.effect, self.thrust()
        if effect.flex_hz:
            force += effect.flex_share * (self._rod.force - force)
        return force + self._pool

    def _smooth(self) -> None:
        keep, force = math.exp(-2.0 * self.step_s / self.bench.effect.smooth_s), self._pushed()
        for k in range(2):
            force = self._cell[k] = force + (self._cell[k] - force) * keep


class _Rod:
    """A lightly damped second-order mount, solved exactly for a force held over each step."""

    def __init__(self, frequency_hz: float, damping: float, step: float) -> None:
        omega = 2.0 * math.pi * frequency_hz
        sigma, self._omega_d = damping * omega, omega * math.sqrt(1.0 - damping**2)
        decay, angle = math.exp(-sigma * step), self._omega_d * step
        self._rotate = (decay * math.cos(angle), decay * math.sin(angle), sigma)
        self.force = 0.0
        self._rate = 0.0

    def advance(self, force: float) -> None:
        """The force that reaches the cell one step later."""
        c, s, sigma = self._rotate
        x, v, w = self.force - force, self._rate, self._omega_d
        self.force = force + c * x + s * (v + sigma * x) / w
        self._rate = c * v - s * (sigma * v + (sigma**2 + w**2) * x) / w


class BenchShaft:
    """Delay and dead zone as ``Shaft``; then droop and sag, a lag, and a pole that may depend on the direction.

    Integrated over each ``dt`` (s) in exact relaxations of its parts, split where the reference changes.
    """

    def __init__(self, truth: ThrusterTruth, effect: ShaftEffect, dt: float) -> None:
        """At rest at time 0."""
        self._truth, self._effect, self._dt = truth, effect, dt
        self._steps = 0
        self._ref = self._late = 0.0
        self._pending: deque[tuple[float, float]] = deque()
        self.n = 0.0
        self.energy = 0.0

    def command(self, t: float, n_cmd: float) -> None:
        """Take the command (-1..1, positive forward) that was received at time ``t`` (s, never decreasing)."""
        ref = 0.0 if abs(n_cmd) < self._truth.dead_zone else max(-1.0, min(1.0, n_cmd))
        self._pending.append((t + self._truth.delay, ref))

    def advance(self) -> float:
        """Shaft speed (normalised) one ``dt`` later; becomes the current one."""
        t, self._steps = self._steps * self._dt, self._steps + 1
        end = self._steps * self._dt
        while self._pending and self._pending[0][0] < end:
            at, ref = self._pending.popleft()
            if at > t:
                self._relax(at - t)
                t = at
            self._ref = ref
        self._relax(end - t)
        return self.n

    def _relax(self, dt: float) -> None:
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
            most = dt / (effect.slew * (1.0 + abs(self.n) / 6.0))
            change = max(-most, min(most, change))
        self.n += change
        self.energy += dt * abs(self.n) ** 3
