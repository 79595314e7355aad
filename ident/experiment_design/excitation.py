"""Excitation signals (step sequences, PRBS, random Gaussian) and the thruster response to them.

A command is -1 to 1 for each channel (thruster). It passes the slew limit of the mission and the first-order lag of the
shaft (thesis section 4.2, ``n' = a (n_ref - n)``) before it becomes an input of the model. Arrays have the shape
(n_rows, n_channels, n): time first, experiments last.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.ident.data import TIME_INPUT, WORK_INPUT, WORK_UNIT
from seatrial.ident.model import COMMAND, SHAFT_SPEED, THRUSTER_FORCE, Model, ModelKind, SignalId, command_of
from seatrial.ident.models import ARM, TABLE_2
from seatrial.ident.numerics import Array, first_order_lag

SIDES = ("left", "right")
SHAFT_POLE = TABLE_2["a"]  # 1/s
THRUST = {name: TABLE_2[name] for name in ("c1", "c2")}  # N
# Quantities that thrusters produce: commands, shaft speeds, thrusts, their sum and its change, and their moment.
COMMANDED = {COMMAND, SHAFT_SPEED, THRUSTER_FORCE, "X", "X_n", "N"}
COMMON_MODE, DIFFERENTIAL_MODE = (("X",), ("n",)), (("N",),)  # inputs of models of surge alone, and of yaw alone


def reason_without_mission(model: Model) -> str:
    """Return the reason for which no mission can be designed for a model.

    Parameters
    ----------
    model
        The model.

    Returns
    -------
    str
        Reason as a clause without a capital letter and without a full stop, for the end of an error message. Empty if
        the model is no bench model, has inputs, and thrusters produce all of them. Delayed taps, time and work do not
        count as inputs.
    """
    if model.kind is ModelKind.BENCH:
        return "it describes a thruster on its bench, for which `seatrial bench` runs the plans"
    inputs = _input_names(model)
    others = [n for n in inputs if SignalId.parse(n).quantity not in COMMANDED]
    if others:
        return (
            f"thrusters do not produce its input {', '.join(others)}; "
            "choose a model without this input, for example horizontal:shaft"
        )
    return "" if inputs else "it has no input that thrusters produce"


def _input_names(model: Model) -> list[str]:
    """Return the names of the inputs of a model in its order, without delayed taps, the time input and the work input.

    A delayed tap is a copy of an input with its value of an earlier or later time.
    """
    return [i.name for i in model.inputs if not i.tap and i.name not in (TIME_INPUT, WORK_INPUT)]


@dataclass(frozen=True)
class ThrusterResponse:
    """Response of the thrusters: from commands to the inputs of a model.

    A command n_ref, -1 to 1, passes the slew limit and the first-order lag of the shaft. The shaft speed n, -1 to 1,
    gives the thrust ``c1 n|n| + c2 n^2`` if the model has forces as inputs.

    Attributes
    ----------
    model
        Model whose inputs are computed.
    t : Array (n_rows,)
        Times of the rows [s], evenly spaced.
    n_max
        Largest command, 0 to 1.
    slew
        Largest rate of change of a command [1/s].
    pole
        Pole of the shafts [1/s]; inf: the shaft speed equals the command.
    curve
        Thrust coefficients ``c1`` and ``c2`` of one thruster [N].
    """

    model: Model
    t: Array
    n_max: float = 1.0
    slew: float = np.inf
    pole: float = SHAFT_POLE
    curve: Mapping[str, float] = field(default_factory=lambda: THRUST)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels of a command.

        They are ``left`` and ``right`` for a model whose two inputs belong to these sides or are surge force X and yaw
        moment N. Otherwise they are the names of the inputs.
        """
        names = _input_names(self.model)
        two = len(names) == 2 and all(n in ("X", "N") or SignalId.parse(n).source in SIDES for n in names)
        return SIDES if two else tuple(names)

    @property
    def full_thrust(self) -> float:
        """Forward thrust of one thruster at full command [N]: ``c1 + c2``."""
        return self.curve["c1"] + self.curve["c2"]

    @property
    def thrusters(self) -> tuple[str, ...]:
        """Names of the thrusters that a mission commands.

        They are the channels. A model of surge or yaw alone has one channel but needs both thrusters, left and right.
        """
        return SIDES if self.channels in (*COMMON_MODE, *DIFFERENTIAL_MODE) else self.channels

    def for_thrusters(self, levels: Array) -> Array:
        """Convert commands of the channels (n_rows, n_channels) to commands of the thrusters (n_rows, n_thrusters).

        A level is a command, -1 to 1. For a model of surge alone, both thrusters have the command of the channel. For a
        model of yaw alone, the left thruster has it and the right one its negative. Else they are returned unchanged.
        """
        if self.channels in COMMON_MODE:
            return np.hstack([levels, levels])
        return np.hstack([levels, -levels]) if self.channels in DIFFERENTIAL_MODE else levels

    def limited(self, levels: Array, durations: Array) -> Array:
        """Return the commands of n step sequences on the rows, with the slew limit.

        With a finite slew limit a command starts from zero and approaches each level at the largest rate. A step may
        end before its level is reached. After the last step its level is held. A row at the end of a step belongs to
        the next step.

        Parameters
        ----------
        levels
            Level of each step (n_steps, n_channels, n), -1 to 1.
        durations
            Duration of each step (n_steps, n) [s].

        Returns
        -------
        Array (n_rows, n_channels, n)
        """
        ends = np.cumsum(durations, axis=0)
        starts = ends - durations
        n_steps, n = durations.shape
        offset = np.arange(n) * (ends[-1].max() + 1.0)  # all sequences in one search
        at = np.searchsorted((ends + offset).T.ravel(), (self.t[:, None] + 1e-9 + offset).ravel(), side="right")
        index = np.minimum(at.reshape(self.t.size, n) - np.arange(n) * n_steps, n_steps - 1)
        lane = np.arange(n)
        target = levels[index, :, lane].transpose(0, 2, 1)
        if not np.isfinite(self.slew):
            return np.ascontiguousarray(target)
        begin = np.zeros_like(levels)
        for k in range(1, n_steps):
            reach = self.slew * durations[k - 1]
            begin[k] = begin[k - 1] + np.clip(levels[k - 1] - begin[k - 1], -reach, reach)
        since = (self.t[:, None] - starts[index, lane])[:, None, :] * self.slew
        first = begin[index, :, lane].transpose(0, 2, 1)
        return np.asarray(first + np.clip(target - first, -since, since))

    @property
    def shafts_are_states(self) -> bool:
        """Whether the shaft speeds are states of the model, so that its inputs are commands.

        They are if the command of the left thruster, ``n_cmd_left``, is an input of the model.
        """
        return any(i.name == command_of("left") for i in self.model.inputs)

    def shaft(self, command: Array) -> Array:
        """Return the shaft speeds: the first-order response to commands that are held between rows, starting from zero.

        Parameters
        ----------
        command
            Commands (n_rows, n_channels, n), -1 to 1.

        Returns
        -------
        Array (n_rows, n_channels, n)
            Normalised shaft speeds, -1 to 1, exact at the rows. With an infinite pole they are the commands.
        """
        if not np.isfinite(self.pole):
            return command
        return first_order_lag(command, 1.0 / self.pole, float(self.t[1] - self.t[0]))

    def inputs(self, command: Array) -> Array:
        """Return the inputs of the model for commands.

        Parameters
        ----------
        command
            Commands (n_rows, n_channels, n), -1 to 1, with the slew limit already applied.

        Returns
        -------
        Array (n_rows, n_inputs, n)
            Inputs in the order and in the units of the model: shaft speeds, commands, forces [N] or moments [N m], and
            their delayed taps. A model that contains the lag of the shafts gets the commands.
        """
        n = dict(zip(self.channels, self.shaft(command).transpose(1, 0, 2), strict=True))
        if self.shafts_are_states:
            n = dict(zip([command_of(c) for c in self.channels], command.transpose(1, 0, 2), strict=True))
        columns = [
            self._delayed(self._column(i.tap_of, n), i.delay) if i.tap else self._column(i.name, n)
            for i in self.model.inputs
        ]
        return np.ascontiguousarray(np.stack(columns, axis=1))

    def _column(self, name: str, n: Mapping[str, Array]) -> Array:
        """Return one input (n_rows, n) of the model by its name, from the shaft speeds (n_rows, n) of the channels.

        ``n`` has the shaft speeds by channel, or the commands by name of the input if the shafts are states of
        the model. The time input is ``t``. The work input is the integral of ``|n|^3`` over time, summed over
        the channels and divided by 150 s (trapezoids), zero in the first row. An input ``n_SIDE`` is a shaft
        speed, and ``f_SIDE`` is a thrust [N]. ``X`` is the sum of both thrusts [N]. ``N`` is the moment [N m]
        of both thrusts at arms of 0.15 m, positive for more thrust on the left. A model of surge alone has the
        same speed on both sides; a model of yaw alone has opposite speeds. Any other input has the value of its
        channel in ``n``.
        """
        if name == TIME_INPUT:
            return np.broadcast_to(self.t[:, None], next(iter(n.values())).shape)
        if name == WORK_INPUT:
            power = np.sum([np.abs(v) ** 3 for v in n.values()], axis=0)
            steps = np.diff(self.t)[:, None] * (power[1:] + power[:-1]) / 2.0  # as the work of a log
            return np.concatenate([np.zeros((1, power.shape[1])), np.cumsum(steps, axis=0)]) / WORK_UNIT
        thruster, quantity, _ = SignalId.parse(name)
        if quantity == SHAFT_SPEED and thruster in n:
            return n[thruster]
        if quantity == THRUSTER_FORCE:
            return self._force(n[thruster] if thruster in n else n[name])
        if name not in ("X", "N"):
            return n[name]
        first = n.get("left", n.get(name))
        assert first is not None
        second = n.get("right", first if name == "X" else -first)
        left, right = self._force(first), self._force(second)
        return left + right if name == "X" else ARM * (left - right)

    def _force(self, n: Array) -> Array:
        """Return the thrust [N] of one thruster at normalised shaft speeds n of any shape: ``c1 n|n| + c2 n^2``."""
        return np.asarray(self.curve["c1"] * n * np.abs(n) + self.curve["c2"] * n * n)

    def _delayed(self, value: Array, seconds: float) -> Array:
        """Return a signal (n_rows, n) delayed by ``seconds``, interpolated linearly between the rows.

        Before the start the delayed signal has the initial value. A negative delay is a lead; after the end the signal
        is then extrapolated linearly.
        """
        at = np.maximum(self.t - seconds, self.t[0])
        row = np.clip(np.searchsorted(self.t, at + 1e-9, side="right") - 1, 0, self.t.size - 2)
        part = ((at - self.t[row]) / (self.t[row + 1] - self.t[row]))[:, None]
        return np.asarray(value[row] * (1 - part) + value[row + 1] * part)

    def energy(self, command: Array) -> Array:
        """Return the share of full power (n,), 0 to 1: the mean of ``|n_ref|^3`` over time and channels.

        Parameters
        ----------
        command
            Commands n_ref (n_rows, n_channels, n), -1 to 1.
        """
        return np.asarray((np.abs(command) ** 3).mean(axis=(0, 1)))


@dataclass(frozen=True)
class StepInput:
    """Input class of the search: steps with free levels and durations in a fixed total time (thesis chapter 5).

    A search point z (n_steps (n_channels + 1),) contains the levels (commands, -1 to 1) of all steps and then their
    relative durations between 0.02 and 1. Each step has the least duration. The remaining time is shared in proportion
    to the relative durations.

    Attributes
    ----------
    n_steps
        Number of steps.
    n_channels
        Number of channels of a command.
    duration
        Duration of all steps together [s].
    shortest
        Least duration of a step [s].
    grid
        Interval between rows [s]. Durations are whole multiples of it.
    n_max
        Largest size of a level, 0 to 1.

    Raises
    ------
    SeatrialError
        If steps of the least duration do not fit into the total duration.
    """

    n_steps: int
    n_channels: int
    duration: float
    shortest: float
    grid: float
    n_max: float = 1.0

    def __post_init__(self) -> None:
        """Raise SeatrialError if steps of the least duration do not fit into the total duration."""
        if self.n_steps * self.least_rows > self.n_rows:
            least = f"{self.least_rows * self.grid:g} s" + (  # rounded up to whole rows
                f" ({self.shortest:g} s in steps of {self.grid:g} s)"
                if abs(self.least_rows * self.grid - self.shortest) > 1e-6
                else ""
            )
            raise SeatrialError(
                f"{self.n_steps} steps of at least {least} do not fit into {self.duration:g} s; give fewer steps, "
                "a shorter --min-step or a longer --duration"
            )

    @property
    def n_rows(self) -> int:
        """Total duration of the steps, in rows of the grid."""
        return round(self.duration / self.grid)

    @property
    def least_rows(self) -> int:
        """Least duration of a step in rows of the grid, rounded up."""
        return max(int(np.ceil(self.shortest / self.grid - 1e-9)), 1)

    @property
    def size(self) -> int:
        """Number of coordinates of a search point: the levels of all steps and channels, and the relative durations."""
        return self.n_steps * (self.n_channels + 1)

    @property
    def low(self) -> Array:
        """Lower bounds of a search point (size,): ``-n_max`` for levels, 0.02 for relative durations."""
        return np.append(np.full(self.n_steps * self.n_channels, -self.n_max), np.full(self.n_steps, 0.02))

    @property
    def high(self) -> Array:
        """Upper bounds of a search point (size,): ``n_max`` for levels, 1 for relative durations."""
        return np.append(np.full(self.n_steps * self.n_channels, self.n_max), np.ones(self.n_steps))

    def unpack(self, z: Array) -> tuple[Array, Array]:
        """Return levels (n_steps, n_channels, n) and durations (n_steps, n) [s] of search points z (n, size).

        The durations are rounded to whole rows, and their sum is the total duration. No step is shorter than the least
        duration.
        """
        n_levels = self.n_steps * self.n_channels
        levels = z[:, :n_levels].reshape(-1, self.n_steps, self.n_channels).transpose(1, 2, 0)
        shares = z[:, n_levels:].T
        spare = self.n_rows - self.n_steps * self.least_rows  # rows beyond the least durations, divided by the shares
        shared = np.round(np.cumsum(shares / shares.sum(axis=0), axis=0) * spare)
        whole = shared + self.least_rows * np.arange(1, self.n_steps + 1)[:, None]
        return levels, np.diff(whole, axis=0, prepend=0.0) * self.grid

    def random(self, n: int, rng: np.random.Generator) -> Array:
        """Draw random search points (n, size) within the bounds with a random generator ``rng``.

        The levels of a point are drawn in one of four ways with equal chance: uniform, near full thrust (0.6 to 1 of
        ``n_max``), similar on all channels (straight with small turns), or uniform with a reduced range. The relative
        durations are log-normal with a random spread.
        """
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
    """Return pseudo-random binary sequences, independent for each channel (Ljung 1999, section 13.3).

    Parameters
    ----------
    t
        Times (n_rows,) [s].
    clock
        Interval [s] after which a new sign is drawn, from time 0 on. It may be the same sign.
    n_channels
        Number of channels.
    amplitude
        Size of the signal, which is ``amplitude`` or ``-amplitude`` with equal chance.
    rng
        Random generator.

    Returns
    -------
    Array (n_rows, n_channels)
    """
    index = (t / clock + 1e-9).astype(int)
    return np.asarray(amplitude * rng.choice([-1.0, 1.0], (index[-1] + 1, n_channels))[index])


def rgs(t: Array, corner: float, n_channels: int, sd: float, n_max: float, rng: np.random.Generator) -> Array:
    """Return low-pass filtered random Gaussian sequences, independent for each channel (Ljung 1999, section 13.3).

    Parameters
    ----------
    t
        Times (n_rows,) [s], evenly spaced.
    corner
        Corner frequency of the second-order Butterworth low-pass filter [Hz]. It is reduced to 0.99 of the Nyquist
        frequency if it is higher.
    n_channels
        Number of channels.
    sd
        Standard deviation of each sequence over the times ``t``, after the filter and before clipping.
    n_max
        Largest size; larger values are clipped.
    rng
        Random generator.

    Returns
    -------
    Array (n_rows, n_channels)
    """
    step = t[1] - t[0]
    from scipy import signal  # imported here: it takes more than a second, and only baselines need it

    settle = round(min(3.0 / corner, 300.0) / step)
    raw = signal.sosfilt(
        _low_pass(min(corner * 2 * step, 0.99)), rng.standard_normal((t.size + settle, n_channels)), axis=0
    )[settle:]
    return np.asarray(np.clip(sd * raw / raw.std(axis=0), -n_max, n_max))


@lru_cache  # baselines have hundreds of sequences with a few corner frequencies
def _low_pass(corner: float) -> Array:
    """Return the second-order sections of a Butterworth filter with this corner, a part of the Nyquist frequency."""
    from scipy import signal

    return np.asarray(signal.butter(2, corner, output="sos"))
