"""Excitation signals (step sequences, PRBS, random Gaussian) and the thruster response to them.

A command is -1..1 for each channel (thruster). On its way to the model it passes the mission's slew limit and the
shaft's first-order lag (thesis section 4.2, ``n' = a (n_ref - n)``). Arrays are (n_rows, n_channels, n): time first,
experiments last.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy import signal

from seatrial.daq.errors import SeatrialError
from seatrial.ident.data import TIME_INPUT, WORK_INPUT, WORK_UNIT
from seatrial.ident.model import Model, ModelKind
from seatrial.ident.numerics import Array, first_order_lag

SIDES = ("left", "right")
SHAFT_POLE = 2.794  # 1/s, thesis Table 2
THRUST = {"c1": 40.05, "c2": 1.11}  # N, thesis Table 2
ARM = 0.15  # m, thesis section 4
COMMANDED = {"n", "f", "X", "N"}  # what thrusters make: shaft speeds and commands, forces, their sums
COMMON_MODE, DIFFERENTIAL_MODE = (("X",), ("n",)), (("N",),)  # the input of models that have only one


def not_commanded(model: Model) -> str:
    """Why no mission can be designed for a model, as the end of a sentence: thrusters do not make all of its inputs.
    Empty where they do."""
    if model.kind is ModelKind.BENCH:
        return "it is of a thruster on its bench, whose plans `seatrial bench` runs"
    inputs = _commanded(model)
    others = [n for n in inputs if n.partition("_")[0] not in COMMANDED]
    if others:
        return f"thrusters do not make its input {', '.join(others)}; take a model without, such as horizontal:shaft"
    return "" if inputs else "it has no input that thrusters make"


def _commanded(model: Model) -> list[str]:
    return [i.name for i in model.inputs if not i.tap and i.name not in (TIME_INPUT, WORK_INPUT)]


@dataclass(frozen=True)
class ThrusterResponse:
    """Response from commands to the inputs of a model: largest command, slew limit [1/s], shaft pole [1/s], thrust
    curve [N]."""

    model: Model
    t: Array
    n_max: float = 1.0
    slew: float = np.inf
    pole: float = SHAFT_POLE
    curve: Mapping[str, float] = field(default_factory=lambda: THRUST)

    @property
    def channels(self) -> tuple[str, ...]:
        """The two thrusters, or the inputs of the model where it has other ones."""
        names = _commanded(self.model)
        two = len(names) == 2 and all(n in ("X", "N") or n.rpartition("_")[2] in SIDES for n in names)
        return SIDES if two else tuple(names)

    @property
    def full_thrust(self) -> float:
        """Of one thruster, full ahead [N]; of models that take forces."""
        return self.curve["c1"] + self.curve["c2"]

    @property
    def thrusters(self) -> tuple[str, ...]:
        """Thrusters that a mission commands; surge or yaw alone takes both thrusters, too."""
        return SIDES if self.channels in (*COMMON_MODE, *DIFFERENTIAL_MODE) else self.channels

    def for_thrusters(self, levels: Array) -> Array:
        """Levels of the thrusters from those of the channels (n_rows, n_channels)."""
        if self.channels in COMMON_MODE:
            return np.hstack([levels, levels])
        return np.hstack([levels, -levels]) if self.channels in DIFFERENTIAL_MODE else levels

    def limited(self, levels: Array, durations: Array) -> Array:
        """Commands (n_rows, n_channels, n) of step sequences: levels (n_steps, n_channels, n) held for durations
        (n_steps, n) [s] with the slew limit on every change, from zero."""
        ends = np.cumsum(durations, axis=0)
        starts = ends - durations
        n_steps, n = durations.shape
        offset = np.arange(n) * (ends[-1].max() + 1.0)  # all sequences in one search
        at = np.searchsorted((ends + offset).T.ravel(), (self.t[:, None] + 1e-9 + offset).ravel(), side="right")
        index = np.minimum(at.reshape(self.t.size, n) - np.arange(n) * n_steps, n_steps - 1)
        lane = np.arange(n)
        wanted = levels[index, :, lane].transpose(0, 2, 1)
        if not np.isfinite(self.slew):
            return np.ascontiguousarray(wanted)
        begin = np.zeros_like(levels)
        for k in range(1, n_steps):
            reach = self.slew * durations[k - 1]
            begin[k] = begin[k - 1] + np.clip(levels[k - 1] - begin[k - 1], -reach, reach)
        since = (self.t[:, None] - starts[index, lane])[:, None, :] * self.slew
        first = begin[index, :, lane].transpose(0, 2, 1)
        return np.asarray(first + np.clip(wanted - first, -since, since))

    @property
    def shafts_are_states(self) -> bool:
        """The model takes commands and has the shafts' lag itself."""
        return any(i.name == "n_cmd_left" for i in self.model.inputs)

    def shaft(self, command: Array) -> Array:
        """Shaft speeds: first-order response to held commands, exact at the equidistant rows."""
        if not np.isfinite(self.pole):
            return command
        return first_order_lag(command, 1.0 / self.pole, float(self.t[1] - self.t[0]))

    def inputs(self, command: Array) -> Array:
        """The model's inputs (n_rows, n_inputs, n) under commands (n_rows, n_channels, n)."""
        n = dict(zip(self.channels, self.shaft(command).transpose(1, 0, 2), strict=True))
        if self.shafts_are_states:
            n = dict(zip([f"n_cmd_{c}" for c in self.channels], command.transpose(1, 0, 2), strict=True))
        columns = [
            self._earlier(self._column(i.tap_of, n), i.delay) if i.tap else self._column(i.name, n)
            for i in self.model.inputs
        ]
        return np.ascontiguousarray(np.stack(columns, axis=1))

    def _column(self, name: str, n: Mapping[str, Array]) -> Array:
        if name == TIME_INPUT:
            return np.broadcast_to(self.t[:, None], next(iter(n.values())).shape)
        if name == WORK_INPUT:
            power = np.sum([np.abs(v) ** 3 for v in n.values()], axis=0)
            return np.cumsum(power * np.append(np.diff(self.t), 0.0)[:, None], axis=0) / WORK_UNIT
        kind, _, side = name.partition("_")
        if kind == "n" and side in n:
            return n[side]
        if kind == "f":
            return self._force(n[side] if side in n else n[name])
        if name not in ("X", "N"):
            return n[name]
        first = n.get("left", n.get(name))
        assert first is not None
        second = n.get("right", first if name == "X" else -first)
        left, right = self._force(first), self._force(second)
        return left + right if name == "X" else ARM * (left - right)

    def _force(self, n: Array) -> Array:
        return np.asarray(self.curve["c1"] * n * np.abs(n) + self.curve["c2"] * n * n)

    def _earlier(self, value: Array, seconds: float) -> Array:
        """The signal ``seconds`` earlier; before the start its initial value."""
        at = np.maximum(self.t - seconds, self.t[0])
        row = np.clip(np.searchsorted(self.t, at + 1e-9, side="right") - 1, 0, self.t.size - 2)
        part = ((at - self.t[row]) / (self.t[row + 1] - self.t[row]))[:, None]
        return np.asarray(value[row] * (1 - part) + value[row + 1] * part)

    def energy(self, command: Array) -> Array:
        """Mean of ``|n|^3`` over time and channels (n,): the share of full power."""
        return np.asarray((np.abs(command) ** 3).mean(axis=(0, 1)))


@dataclass(frozen=True)
class StepInput:
    """Input class of the search (thesis chapter 5): ``n_steps`` steps of free levels and durations at a fixed total
    duration. A search point z (n_steps (n_channels + 1),) has the levels, then the shares of time, each in 0..1."""

    n_steps: int
    n_channels: int
    duration: float
    shortest: float
    grid: float  # s; durations are whole multiples of it
    n_max: float = 1.0

    def __post_init__(self) -> None:
        if self.n_steps * self.least > self.rows:
            least = f"{self.least * self.grid:g} s" + (  # of whole rows
                f" ({self.shortest:g} s in steps of {self.grid:g} s)"
                if abs(self.least * self.grid - self.shortest) > 1e-6
                else ""
            )
            raise SeatrialError(
                f"{self.n_steps} steps of at least {least} do not fit into {self.duration:g} s; fewer steps, a shorter "
                "--min-step or a longer --duration"
            )

    @property
    def rows(self) -> int:
        """The duration in whole multiples of the grid."""
        return round(self.duration / self.grid)

    @property
    def least(self) -> int:
        """The shortest step in whole multiples of the grid, none below ``shortest``."""
        return max(int(np.ceil(self.shortest / self.grid - 1e-9)), 1)

    @property
    def size(self) -> int:
        return self.n_steps * (self.n_channels + 1)

    @property
    def low(self) -> Array:
        return np.append(np.full(self.n_steps * self.n_channels, -self.n_max), np.full(self.n_steps, 0.02))

    @property
    def high(self) -> Array:
        return np.append(np.full(self.n_steps * self.n_channels, self.n_max), np.ones(self.n_steps))

    def unpack(self, z: Array) -> tuple[Array, Array]:
        """Levels (n_steps, n_channels, n) and durations (n_steps, n) [s] of points z (n, size)."""
        n_levels = self.n_steps * self.n_channels
        levels = z[:, :n_levels].reshape(-1, self.n_steps, self.n_channels).transpose(1, 2, 0)
        shares = z[:, n_levels:].T
        spare = self.rows - self.n_steps * self.least  # rows; what is left is shared out, and none is shorter
        shared = np.round(np.cumsum(shares / shares.sum(axis=0), axis=0) * spare)
        whole = shared + self.least * np.arange(1, self.n_steps + 1)[:, None]
        return levels, np.diff(whole, axis=0, prepend=0.0) * self.grid

    def random(self, n: int, rng: np.random.Generator) -> Array:
        """Random search points (n, size) of four kinds: full and partial thrust, turning and straight."""
        kind = rng.integers(4, size=(n, 1, 1))
        shape = (n, self.n_steps, self.n_channels)
        levels = rng.uniform(-1.0, 1.0, shape)
        extreme = np.sign(levels) * rng.uniform(0.6, 1.0, shape)
        turning = rng.uniform(-0.3, 1.0, (n, self.n_steps, 1)) + rng.uniform(-0.5, 0.5, shape)
        scaled = levels * rng.uniform(0.3, 1.0, (n, 1, 1))
        levels = np.select([kind == 0, kind == 1, kind == 2], [levels, extreme, turning], scaled).clip(-1.0, 1.0)
        shares = np.exp(rng.normal(size=(n, self.n_steps)) * rng.uniform(0.0, 1.0, (n, 1)) - 1.5).clip(0.02, 1.0)
        return np.hstack([self.n_max * levels.reshape(n, -1), shares])


def prbs(t: Array, clock: float, n_channels: int, amplitude: float, rng: np.random.Generator) -> Array:
    """Pseudo-random binary sequences (n_rows, n_channels): +-amplitude, drawn every ``clock`` [s] (Ljung 1999,
    13.3)."""
    index = (t / clock + 1e-9).astype(int)
    return np.asarray(amplitude * rng.choice([-1.0, 1.0], (index[-1] + 1, n_channels))[index])


def rgs(t: Array, corner: float, n_channels: int, sd: float, n_max: float, rng: np.random.Generator) -> Array:
    """Random Gaussian sequences (n_rows, n_channels) of standard deviation ``sd`` behind a second-order low-pass filter
    of corner frequency ``corner`` [Hz], clipped at n_max (Ljung 1999, 13.3)."""
    step = t[1] - t[0]
    sos = signal.butter(2, min(corner * 2 * step, 0.99), output="sos")
    settle = round(min(3.0 / corner, 300.0) / step)
    raw = signal.sosfilt(sos, rng.standard_normal((t.size + settle, n_channels)), axis=0)[settle:]
    return np.asarray(np.clip(sd * raw / raw.std(axis=0), -n_max, n_max))
