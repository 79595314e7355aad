"""The shaft of a thruster on the bench that nobody has told all about: how it may answer a command otherwise.

``mocks.thruster.Shaft`` with more between the command and the shaft speed. Nothing of it is in the declared model.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from mocks.thruster import ThrusterTruth


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
        """Is there any?"""
        return bool(self.late or self.brisk or self.slew or self.droop or self.sag)


AS_TOLD = ShaftEffect()


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
        """Take the command (-1..1, positive ahead) that was received at time ``t`` (s, never decreasing)."""
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
