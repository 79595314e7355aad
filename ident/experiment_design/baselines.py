"""What a design has to beat: pseudo-random binary and random Gaussian sequences of optimised bandwidth (thesis 5),
and how it does where the parameters are not the nominal ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from ident.experiment_design.excitation import prbs, rgs
from ident.experiment_design.task import BOX, DesignProblem, ParameterPrior
from ident.numerics import Array

CLOCKS = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 15.0, 20.0, 30.0)  # s
CORNERS = (0.004, 0.007, 0.012, 0.02, 0.035, 0.06, 0.1, 0.18, 0.3)  # Hz
SIZES = (0.35, 0.6, 1.0)  # of n_max: amplitude or standard deviation


@dataclass(frozen=True)
class BaselineSignal:
    """The best of its kind: command (n_rows, n_channels), after slew limits; value: its criterion; bandwidth: its clock
    [s] or corner [Hz]; values (n_seeds,): each seed's criterion with the bandwidth and size that suit it best."""

    kind: Literal["PRBS", "RGS"]
    command: Array
    value: float
    bandwidth: float
    values: Array


def baseline_signals(task: DesignProblem, n: int = 20, seed: int = 1) -> dict[str, BaselineSignal]:
    """The best of n sequences of each kind, every one at its own best bandwidth and size; limits on the track do not
    bind them (a sequence that ignores limits can only be better)."""
    channels, n_max = len(task.actuation.channels), task.steps.n_max
    makers = {
        "PRBS": [(c, s, partial(prbs, task.t, c, channels, s * n_max)) for c in CLOCKS for s in SIZES],
        "RGS": [(c, s, partial(_gaussian, task.t, c, channels, s, n_max)) for c in CORNERS for s in SIZES],
    }
    found: dict[str, BaselineSignal] = {}
    for k, (kind, options) in enumerate(makers.items()):
        raw = np.stack([make(rng=np.random.default_rng([seed, k, i])) for i in range(n) for _, _, make in options], 2)
        command = _slewed(raw, task.slew, task.grid)
        value = _nominal(task, command).reshape(n, len(options))
        at = np.unravel_index(int(np.argmax(value)), value.shape)
        best = int(at[0]) * len(options) + int(at[1])
        found[kind] = BaselineSignal("PRBS" if kind == "PRBS" else "RGS", command[:, :, best], float(value[at]),
                            options[int(at[1])][0], value.max(axis=1))
    return found


def _gaussian(t: Array, corner: float, channels: int, size: float, n_max: float, rng: np.random.Generator) -> Array:
    return rgs(t, corner, channels, size * n_max, n_max, rng)


def _slewed(command: Array, slew: float, step: float) -> Array:
    """The same with changes of at most ``slew`` [1/s], from zero."""
    if not np.isfinite(slew):
        return command
    out = np.empty_like(command)
    now = np.zeros(command.shape[1:])
    for k, row in enumerate(command):
        out[k] = now
        now = now + np.clip(row - now, -slew * step, slew * step)
    return out


def _nominal(task: DesignProblem, command: Array) -> Array:
    parts = [task.experiments(task.actuation.inputs(command[:, :, k:k + 64])).information
             for k in range(0, command.shape[2], 64)]
    return task.measure(np.concatenate(parts) + task.prior)


@dataclass(frozen=True)
class Robustness:
    """The criterion of each input (n,) by name over the same n parameter samples."""

    values: Mapping[str, Array]

    def share_won(self, ours: str = "design") -> float:
        """Share of the samples in which ours is better than every rival."""
        rest = [v for name, v in self.values.items() if name != ours]
        return float(np.mean(self.values[ours] > np.max(rest, axis=0))) if rest else 1.0


def monte_carlo(task: DesignProblem, commands: Mapping[str, Array], n: int = 1000, seed: int = 1, box: float = BOX
                ) -> Robustness:
    """The criterion of commands (n_rows, n_channels) at n samples of the box about the nominal parameters."""
    values = ParameterPrior(task.learned, box).sample(task.experiments.model, n, np.random.default_rng([seed, 17]))
    inputs = {name: task.actuation.inputs(c[:, :, None])[:, :, 0] for name, c in commands.items()}
    return Robustness({name: task.values(u, values) for name, u in inputs.items()})
