"""Baseline input signals, PRBS and random Gaussian (RGS) of optimised bandwidth, and robustness to parameters.

Thesis chapter 5; Ljung 1999, section 13.3.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from ident.experiment_design.excitation import prbs, rgs
from ident.experiment_design.task import PRIOR_HALFWIDTH, DesignProblem, ParameterPrior
from ident.numerics import Array

CLOCK_PERIODS = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 15.0, 20.0, 30.0)  # s, of a PRBS
CORNERS = (0.004, 0.007, 0.012, 0.02, 0.035, 0.06, 0.1, 0.18, 0.3)  # Hz, corner frequencies of an RGS
AMPLITUDES = (0.35, 0.6, 1.0)  # of n_max: amplitude or standard deviation


@dataclass(frozen=True)
class BaselineSignal:
    """The best signal of a kind.

    Attributes:
        command (n_rows, n_channels): behind the slew limit.
        value: its criterion.
        bandwidth: clock period [s] of a PRBS, corner frequency [Hz] of an RGS.
        values (n_seeds,): criterion of each seed at its best bandwidth and amplitude.
    """

    kind: Literal["PRBS", "RGS"]
    command: Array
    value: float
    bandwidth: float
    values: Array


def baseline_signals(task: DesignProblem, n: int = 20, seed: int = 1) -> dict[str, BaselineSignal]:
    """The best of n sequences of each kind, each at its best bandwidth and amplitude.

    Limits on the track do not apply to them: a sequence that ignores limits can only be better.
    """
    channels, n_max = len(task.actuation.channels), task.steps.n_max
    makers = {
        "PRBS": [(c, s, partial(prbs, task.t, c, channels, s * n_max)) for c in CLOCK_PERIODS for s in AMPLITUDES],
        "RGS": [(c, s, partial(_gaussian, task.t, c, channels, s, n_max)) for c in CORNERS for s in AMPLITUDES],
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
    """Commands with changes of at most ``slew`` [1/s], from zero."""
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
    """Criterion (n,) of each input by name, over the same n parameter samples."""

    values: Mapping[str, Array]

    def share_won(self, ours: str = "design") -> float:
        """Share of the samples in which ``ours`` is better than every baseline."""
        rest = [v for name, v in self.values.items() if name != ours]
        return float(np.mean(self.values[ours] > np.max(rest, axis=0))) if rest else 1.0


def monte_carlo(
    task: DesignProblem, commands: Mapping[str, Array], n: int = 1000, seed: int = 1, box: float = PRIOR_HALFWIDTH
) -> Robustness:
    """Criterion of commands (n_rows, n_channels) at n parameter samples, uniform in a box about the nominal values."""
    values = ParameterPrior(task.learned, box).sample(task.experiments.model, n, np.random.default_rng([seed, 17]))
    inputs = {name: task.actuation.inputs(c[:, :, None])[:, :, 0] for name, c in commands.items()}
    return Robustness({name: task.values(u, values) for name, u in inputs.items()})
