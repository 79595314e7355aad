"""Simulated thruster: speed controller, shaft and propeller.

A command passes the dead zone, a pure delay and the first-order lag of the shaft, and becomes a force. Pole, delay and
dead zone have the values of DSOR's simulated MEDUSA (github.com/dsor-isr/farol, mred_sim.yaml). c1 and c2 have the
values of table 2 of the thesis.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

from seatrial.mocks.random_streams import THRUSTER, random_stream


@dataclass(frozen=True)
class ThrusterTruth:
    """True parameters of a thruster. The shaft speed ``n`` is divided by the full shaft speed.

    Attributes
    ----------
    c1, c2 : float
        Thrust coefficients [N]: the static thrust is ``c1 n|n| + c2 n^2``.
    pole : float
        Pole of the first-order lag from the set-point to the shaft speed [1/s].
    delay : float
        Dead time from the command to the shaft [s].
    dead_zone : float
        Smallest command that turns the shaft, as a fraction of full command. Smaller commands count as zero.
    """

    c1: float = 40.05
    c2: float = 1.11
    pole: float = 7.2115
    delay: float = 0.345
    dead_zone: float = 0.086


def draw_thruster(seed: int, spread: float = 0.05) -> ThrusterTruth:
    """Return the parameters of the simulated thruster that belongs to a seed.

    The thrust coefficients c1 and c2 are their nominal values, each times a factor that is uniform between
    ``1 - spread`` and ``1 + spread``. The other parameters are nominal. The same seed gives the same thruster.
    """
    rng = random_stream(seed, THRUSTER)
    nominal = ThrusterTruth()
    c1, c2 = (1.0 + spread * rng.uniform(-1.0, 1.0, 2)).tolist()
    return replace(nominal, c1=nominal.c1 * c1, c2=nominal.c2 * c2)


class Shaft:
    """Shaft of a simulated thruster, with delayed commands and a first-order lag.

    The equation ``n' = pole (n_ref(t - delay) - n)`` is linear, and ``n_ref`` is piecewise constant. The solution is
    therefore exact between the switching times and needs no numerical integration. The attribute `n` is the present
    shaft speed (normalised, positive forward).

    The pole may be another one while the shaft slows down. A step in which the shaft reverses is then computed with
    the pole at its start.
    """

    def __init__(self, truth: ThrusterTruth, dt: float, n: float = 0.0, *, braking: float = 1.0) -> None:
        """Set up a shaft that turns at the constant speed ``n`` (normalised, -1 to 1) at time 0.

        ``truth`` has the pole, the delay and the dead zone. ``dt`` is the step of the simulation [s]. While ``|n|``
        decreases, the pole is divided by ``braking``.
        """
        self._truth = truth
        self._dt = dt
        self._pole_braking = truth.pole / braking
        self._decay = math.exp(-truth.pole * dt)
        self._decay_braking = math.exp(-self._pole_braking * dt)
        self._steps = 0
        self._ref = n
        self._pending: deque[tuple[float, float]] = deque()
        self.n = n

    def command(self, t: float, n_cmd: float) -> None:
        """Take a command (-1 to 1, positive forward) at time ``t`` [s]; it acts after the thruster's delay.

        Values beyond -1 to 1 are clipped. Values in the thruster's dead zone count as 0. From call to call ``t`` must
        not decrease.
        """
        ref = 0.0 if abs(n_cmd) < self._truth.dead_zone else max(-1.0, min(1.0, n_cmd))
        self._pending.append((t + self._truth.delay, ref))

    def advance(self) -> float:
        """Advance the shaft by one step of the simulation, and return its speed (normalised, positive forward)."""
        self._steps += 1
        pending = self._pending
        if pending and pending[0][0] < self._steps * self._dt:
            self._advance_with_new_references()
        else:
            # as in _slows_down, written out because a call takes longer than the rest
            above = self.n - self._ref
            self.n = self._ref + above * (self._decay_braking if above * self.n > 0.0 else self._decay)
        return self.n

    def _slows_down(self) -> bool:
        """Return whether the delayed command makes the shaft turn more slowly or reverse; False for a shaft at rest."""
        return (self._ref - self.n) * self.n < 0.0

    def _advance_with_new_references(self) -> None:
        """Advance the shaft by one step of the simulation in which its delayed command changes.

        The step is split at the times of the changes.
        """
        t, t_end = (self._steps - 1) * self._dt, self._steps * self._dt
        while self._pending and self._pending[0][0] < t_end:
            t_switch, ref = self._pending.popleft()
            if t_switch > t:
                self._advance_with_constant_reference(t_switch - t)
                t = t_switch
            self._ref = ref
        self._advance_with_constant_reference(t_end - t)

    def _advance_with_constant_reference(self, dt: float) -> None:
        """Advance the shaft by ``dt`` [s] while the delayed command that it follows is constant."""
        pole = self._pole_braking if self._slows_down() else self._truth.pole
        self.n = self._ref + (self.n - self._ref) * math.exp(-pole * dt)


class Inflow:
    """Dead time and first-order lag of the thrust behind the shaft speed, which a hidden effect causes.

    The output is the shaft speed that would produce the present thrust without them.
    """

    def __init__(self, delay: float, lag: float, dt: float, n: float = 0.0) -> None:
        """Set up the dead time ``delay`` [s] and the time constant ``lag`` [s] from shaft speed to thrust.

        ``dt`` is the time between two calls of `advance` [s], and ``n`` the initial shaft speed (-1 to 1). The time
        constant is 20 % longer while the shaft slows down. The dead time is rounded to a whole number of calls. 0
        switches dead time or lag off.
        """
        self._queue = deque([n] * round(delay / dt))
        self._rise, self._fall = (math.exp(-dt / (k * lag)) if lag else 0.0 for k in (1.0, 1.2))
        self._n = n

    def advance(self, n: float) -> float:
        """Advance dead time and lag by one step, at whose end the shaft turns at ``n`` (-1 to 1).

        Return the shaft speed (-1 to 1) that produces the thrust at the end of the step.
        """
        self._queue.append(n)
        delayed = self._queue.popleft()
        decay = self._rise if abs(delayed) > abs(self._n) else self._fall
        self._n = delayed + decay * (self._n - delayed)
        return self._n


def thrust(truth: ThrusterTruth, n: float) -> float:
    """Return the static thrust [N], ``c1 n|n| + c2 n^2``, at the normalised shaft speed ``n`` (thesis, section 4.2).

    ``truth`` has the coefficients c1 and c2. Static means that the thruster does not move through the water. Positive
    is forward.
    """
    return truth.c1 * n * abs(n) + truth.c2 * n * n
