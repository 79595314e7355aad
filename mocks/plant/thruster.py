"""One simulated thruster: speed controller, shaft and propeller.

Command -> dead zone -> pure delay -> first-order shaft -> force. The numbers are those of DSOR's simulated MEDUSA
(pole, delay, dead zone; github.com/dsor-isr/farol, mred_sim.yaml) and of the thesis, table 2 (c1, c2).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

from seatrial.mocks.random_streams import THRUSTER, random_stream


@dataclass(frozen=True)
class ThrusterTruth:
    """True parameters of a thruster; shaft speed ``n`` is normalised by ``rpm_max``."""

    c1: float = 40.05  # N, f = c1 n|n| + c2 n^2
    c2: float = 1.11  # N
    pole: float = 7.2115  # 1/s
    delay: float = 0.345  # s, between the command and the shaft
    dead_zone: float = 0.086  # below it the motor does not spin, above it n_ref = n_cmd


def draw_thruster(seed: int, spread: float = 0.05) -> ThrusterTruth:
    """A thruster whose thrust coefficients lie within ``spread`` (a fraction) of the nominal ones."""
    rng = random_stream(seed, THRUSTER)
    nominal = ThrusterTruth()
    c1, c2 = (1.0 + spread * rng.uniform(-1.0, 1.0, 2)).tolist()
    return replace(nominal, c1=nominal.c1 * c1, c2=nominal.c2 * c2)


class Shaft:
    """Shaft speed after delayed commands, solved exactly between the switching times.

    ``n' = pole (n_ref(t - delay) - n)`` is linear and ``n_ref`` piecewise constant, so no integrator is involved.
    """

    def __init__(self, truth: ThrusterTruth, dt: float, n: float = 0.0) -> None:
        """At rest in speed ``n`` at time 0; advances by ``dt`` (s)."""
        self._truth = truth
        self._dt = dt
        self._decay = math.exp(-truth.pole * dt)
        self._steps = 0
        self._ref = n
        self._pending: deque[tuple[float, float]] = deque()
        self.n = n

    def command(self, t: float, n_cmd: float) -> None:
        """Take the command (-1..1, positive forward) that was received at time ``t`` (s, never decreasing)."""
        ref = 0.0 if abs(n_cmd) < self._truth.dead_zone else max(-1.0, min(1.0, n_cmd))
        self._pending.append((t + self._truth.delay, ref))

    def advance(self) -> float:
        """Shaft speed (normalised) one ``dt`` later; becomes the current one."""
        self._steps += 1
        pending = self._pending
        if pending and pending[0][0] < self._steps * self._dt:
            self._switch()
        else:
            self.n = self._ref + (self.n - self._ref) * self._decay
        return self.n

    def _switch(self) -> None:
        """One step during which the reference changes, once or more."""
        t, t_end = (self._steps - 1) * self._dt, self._steps * self._dt
        while self._pending and self._pending[0][0] < t_end:
            t_switch, ref = self._pending.popleft()
            if t_switch > t:
                self._relax(t_switch - t)
                t = t_switch
            self._ref = ref
        self._relax(t_end - t)

    def _relax(self, dt: float) -> None:
        self.n = self._ref + (self.n - self._ref) * math.exp(-self._truth.pole * dt)


class Inflow:
    """Shaft speed as the water answers to it: some time later, and a first-order lag behind."""

    def __init__(self, delay: float, lag: float, dt: float, n: float = 0.0) -> None:
        """``delay`` and ``lag`` in s; the lag is a fifth longer where the shaft slows down. Advances by ``dt`` (s)."""
        self._queue = deque([n] * round(delay / dt))
        self._rise, self._fall = (math.exp(-dt / (k * lag)) if lag else 0.0 for k in (1.0, 1.2))
        self._n = n

    def advance(self, n: float) -> float:
        """What the water has, one ``dt`` later, of a shaft that then turns at ``n``."""
        self._queue.append(n)
        late = self._queue.popleft()
        keep = self._rise if abs(late) > abs(self._n) else self._fall
        self._n = late + keep * (self._n - late)
        return self._n


def thrust(truth: ThrusterTruth, n: float) -> float:
    """Force (N) of a thruster at rest without current (thesis, section 4.2)."""
    return truth.c1 * n * abs(n) + truth.c2 * n * n
