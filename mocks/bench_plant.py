"""The simulated bench: one thruster on a rod in a pool, pushing on a load cell."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np

from mocks.noise import DISTURBANCE, EFFECT_NAME, EFFECT_SIZE, OrnsteinUhlenbeck, normals, stream
from mocks.thruster import Shaft, ThrusterTruth, draw_thruster, thrust

STEP = 0.0025  # s
DISTURBANCE_EVERY = 4  # steps: 100 Hz
SIGMA, TAU = 0.1, 0.3  # N, s: a pool at rest


@dataclass(frozen=True)
class BenchEffect:
    """One effect on the bench, or none; a size of zero switches its line in ``BenchPlant.advance`` off."""

    name: str
    sentence: str
    flex_hz: float = 0.0  # rod: resonance of the mount
    flex_damping: float = 0.04
    wash: float = 0.0  # recirculation: fraction of thrust lost in a pool in full motion
    wash_s: float = 4.0  # s, to set the pool in motion
    drift: float = 0.0  # N/min^1/2 of the cell
    astern: float = 0.0  # fraction of thrust lost astern at full speed
    sag: float = 0.0  # fraction of thrust lost with an empty battery

    @property
    def parameters(self) -> dict[str, float]:
        """The sizes that belong to this effect."""
        values = asdict(self)
        return {name: values[name] for name in _PARAMETERS[self.name]}


_PARAMETERS: dict[str, tuple[str, ...]] = {
    "none": (),
    "rod-flex": ("flex_hz", "flex_damping"),
    "recirculation": ("wash", "wash_s"),
    "cell-drift": ("drift",),
    "reverse-loss": ("astern",),
    "battery-sag": ("sag",),
}
NONE = BenchEffect("none", "nothing but what the nominal model has")


def _around(rng: np.random.Generator, size: float) -> float:
    return float(size * rng.uniform(0.85, 1.15))


EFFECTS: dict[str, Callable[[np.random.Generator], BenchEffect]] = {
    "rod-flex": lambda rng: BenchEffect(
        "rod-flex", "the rod swings in its mount when thrust changes", flex_hz=_around(rng, 6.0)
    ),
    "recirculation": lambda rng: BenchEffect(
        "recirculation", "the jet sets the pool in motion and loses thrust to it", wash=_around(rng, 0.12)
    ),
    "cell-drift": lambda rng: BenchEffect(
        "cell-drift", "the load cell creeps as it warms up", drift=_around(rng, 1.0) * (1 - 2 * (rng.uniform() < 0.5))
    ),
    "reverse-loss": lambda rng: BenchEffect(
        "reverse-loss", "astern the propeller is less than its coefficients say", astern=_around(rng, 0.15)
    ),
    "battery-sag": lambda rng: BenchEffect(
        "battery-sag", "thrust fades as the battery is used up", sag=_around(rng, 0.12)
    ),
}
DEMO = ("rod-flex", "recirculation", "cell-drift")


def make_effect(name: str, seed: int) -> BenchEffect:
    """The effect ``name`` (KeyError if there is none) as ``seed`` draws it."""
    return EFFECTS[name](stream(seed, EFFECT_SIZE, index=100 + list(EFFECTS).index(name)))


def draw_name(seed: int) -> str:
    """The name that ``--effect draw`` takes at this seed."""
    return DEMO[int(stream(seed, EFFECT_NAME, index=1).integers(len(DEMO)))]


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
        self.shafts = (Shaft(bench.thruster, step),)
        self._pool = 0.0
        self._disturbance: OrnsteinUhlenbeck | None = None
        if disturbed:
            draw = normals(stream(bench.seed, DISTURBANCE, run))
            self._disturbance = OrnsteinUhlenbeck(draw, DISTURBANCE_EVERY * step, SIGMA, TAU)
        self._wash = 0.0
        self._rod = _Rod(bench.effect.flex_hz, bench.effect.flex_damping, step)

    @property
    def t(self) -> float:
        """Seconds since the start."""
        return self.steps * self.step_s

    def command(self, thruster: int, t: float, n_cmd: float) -> None:
        """What thruster 0, the only one, is told from time ``t`` (s) on, -1..1, positive ahead."""
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
        self.steps += 1

    def thrust(self, thruster: int = 0) -> float:
        """Force of the propeller on its shaft, N, positive ahead."""
        effect, n = self.bench.effect, self.shafts[thruster].n
        force = thrust(self.bench.thruster, n)
        if effect.wash:
            force *= 1.0 - effect.wash * math.sqrt(self._wash)
        if effect.astern and n < 0.0:
            force *= 1.0 - effect.astern * abs(n)
        if effect.sag:
            force *= 1.0 - effect.sag * (1.0 - math.exp(-self.energy / 30.0))
        return force

    def force(self) -> float:
        """Force on the cell, N."""
        force = self._rod.force if self.bench.effect.flex_hz else self.thrust()
        return force + self._pool + self.bench.effect.drift * math.sqrt(self.t / 60.0)


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
