"""Optimal input design: the step sequence with the largest information about the parameters, within limits.

The thesis (chapter 5) uses the information of output error, since that of prediction error took too long to compute.
Here both cost about the same, and prediction error is the default. Without process noise a simulation of ten minutes is
extremely sensitive to every parameter: the heading at the end depends on the whole motion before. Output error
therefore predicts standard errors of a twentieth to a hundredth of those of a fit, and optimises for them.

The module also computes baseline signals, PRBS and random Gaussian signals (RGS) of optimised bandwidth, and the
robustness of a design to the parameters (Ljung 1999, section 13.3).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Literal

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.ident.estimation import SampledInputs, simulate, simulate_stochastic
from seatrial.ident.experiment_design.criteria import SINGULAR
from seatrial.ident.experiment_design.excitation import StepInput, prbs, rgs
from seatrial.ident.experiment_design.information import (
    errors_of,
    planned_record,
    prediction_information,
    prior_information,
)
from seatrial.ident.experiment_design.task import N_TRACKS, DesignProblem
from seatrial.ident.numerics import Array, Evaluate, EvaluateAbove, PatternSearch, SearchResult

N_START, N_RESTARTS = 512, 4  # random sequences, and the best of them from which a search starts
BLOCK = 100.0  # s, shortest block of a long experiment that is designed separately
LEVEL_DIGITS = 3  # decimal digits of a level in mission.toml
N_BAND = 64  # simulated boats for the band of the track
Progress = Callable[[int, float], None]


@dataclass(frozen=True)
class Design:
    """Best design of a search."""

    task: DesignProblem
    levels: Array  # (n_steps, n_channels)
    durations: Array  # (n_steps,) [s]
    value: float  # criterion, with the prior information
    information: Array  # (q, q), about the parameters `task.free`, without the prior information
    found: SearchResult

    def command_on(self, task: DesignProblem) -> Array:
        """Return the command (n_rows, n_channels) on the rows of a task."""
        return task.actuation.limited(self.levels[:, :, None], self.durations[:, None])[:, :, 0]

    @property
    def command(self) -> Array:
        """Command (n_rows, n_channels) on the rows of the design problem."""
        return self.command_on(self.task)

    @property
    def before(self) -> dict[str, float]:
        """Standard errors before the experiment by parameter; inf if there is no information."""
        return self._by_name(self.task.prior)

    @property
    def errors(self) -> dict[str, float]:
        """Standard errors after the experiment by parameter, by the information of the design with known noise."""
        return self._by_name(self.information + self.task.prior)

    @cached_property
    def predicted(self) -> dict[str, float]:
        """Standard errors that a fit can reach after the experiment, by parameter (`predicted_errors`)."""
        return predicted_errors(self.task, self.command_on(self.task.finer))

    def _by_name(self, information: Array) -> dict[str, float]:
        """Return the standard errors of the parameters `task.learned` by an information matrix (q, q)."""
        q = len(self.task.observed_parameters)
        return dict(zip(self.task.observed_parameters, errors_of(information)[:q].tolist(), strict=True))


def predicted_errors(task: DesignProblem, command: Array) -> dict[str, float]:
    """Return the standard errors that a fit can reach after an experiment.

    Parameters
    ----------
    task
        Design problem.
    command
        Command (n_rows, n_channels) on the rows of ``task.finer``.

    Returns
    -------
    dict
        Standard errors of the parameters ``task.learned`` by name.

    Notes
    -----
    The information is that of prediction error with all sensors at their rates, and with unknown noise parameters.
    """
    fine, q = task.finer, len(task.observed_parameters)
    model = fine.observed(task.model)
    u = fine.actuation.inputs(command[:, :, None])[:, :, 0]
    record = planned_record(model, fine.t, u, fine.every)
    free = [
        *task.observed_parameters,
        *[p.name for p in model.parameters if p.free and p.name not in task.observed_parameters],
    ]
    inflation = np.array([task.inflation.get(n, 1.0) for n in free])
    F = prediction_information(model, record, free=free) / np.outer(inflation, inflation)
    F = F + prior_information([model.parameter(n) for n in free])
    F[:q, :q] = (
        F[:q, :q] - prior_information([model.parameter(n) for n in task.observed_parameters]) + task.prior[:q, :q]
    )
    return dict(zip(task.observed_parameters, errors_of(F)[:q].tolist(), strict=True))


@dataclass(frozen=True)
class Track:
    """Predicted track, from the rest before the steps to the end of the coasting after them."""

    t: Array  # (n,) [s], since the start of the mission
    x: Array  # (n,) [m] north of the start, nominal boat that starts with heading north
    y: Array  # (n,) [m] east of the start
    radius: Array  # (n,) [m], of the circle about the nominal position that holds 95 % of the sampled boats
    others: Array  # (k, n, 2) [m], positions of boats sampled from the prior, with process noise
    inside: float | None  # share of the sampled boats that stay in the area; None without an area
    corner: Array | None  # (2,) [m], south-west corner of the area relative to the start; None without an area


def predicted_track(made: Design, points: int = 61) -> Track | None:
    """Predict the track of a design by simulation.

    Parameters
    ----------
    made
        The design.
    points
        Number of points of the track.

    Returns
    -------
    Track or None
        None if the model has no position.
    """
    task = made.task
    names = [s.name for s in task.model.states]
    if not {"x", "y"} <= set(names):
        return None
    columns = [names.index("x"), names.index("y")]
    t, u = task.t_whole, task.whole_inputs(made.command[:, :, None])[:, :, 0]
    nominal = simulate(task.model, planned_record(task.model, t, u)).x[:, columns]
    rngs = [np.random.default_rng([task.seed, 20, k]) for k in range(N_BAND)]
    others = simulate_stochastic(
        task.model,
        SampledInputs.linear(t, u),
        task.boats(N_BAND, 3),
        rngs,
        x0=np.zeros((N_BAND, len(names))),
        substep=task.grid / 2,
    )[0][:, :, columns]
    inside, corner = None, task.corner(made.command)
    if corner is not None and task.limits.area is not None:
        kept = (others >= corner) & (others <= corner + np.array(task.limits.area))
        inside = float(np.mean(kept.all(axis=(1, 2))))
    at = np.unique(np.linspace(0, t.size - 1, points).round().astype(int))
    radius = np.quantile(np.hypot(*(others - nominal).transpose(2, 0, 1)), 0.95, axis=0)
    return Track(t[at], nominal[at, 0], nominal[at, 1], radius[at], others[:, at], inside, corner)


def design(
    task: DesignProblem, *, evaluations: int = 20_000, warm: Array | None = None, progress: Progress | None = None
) -> Design:
    """Search the optimal step sequence.

    Parameters
    ----------
    task
        Design problem.
    evaluations
        Number of evaluations of the criterion.
    warm
        Search points (n, size) to start from. By default the search starts from the best of many random sequences, or
        from a block that is designed first.
    progress
        Function of the number of evaluations and the best value, called during the search.

    Returns
    -------
    Design
        The same seed gives the same design.

    Raises
    ------
    SeatrialError
        If no sequence that was found keeps to the limits, or informs all parameters.
    """
    if warm is None and task.process_noise:
        warm = _block(task, evaluations, progress)
        evaluations = evaluations if warm is None else evaluations // 2
    found = _search(task, evaluations, warm, progress)
    levels, durations = (a[..., 0] for a in task.steps.unpack(found.z[None]))
    n_max = task.steps.n_max
    levels = np.clip(levels.round(LEVEL_DIGITS), -n_max, n_max)
    rounded = task.actuation.limited(levels[:, :, None], durations[:, None])
    (value,), (singular,) = task.criterion_of(rounded)
    (beyond,) = task.violation(rounded)
    if value <= SINGULAR or singular > 0:
        raise SeatrialError(_uninformative(task, float(singular)))
    if beyond > 10.0**-LEVEL_DIGITS:
        raise SeatrialError(_too_tight(task, float(beyond)))
    information = task.information(task.actuation.inputs(rounded))[0]
    return Design(task, levels, durations, float(value), information, found)


def _block(task: DesignProblem, evaluations: int, progress: Progress | None) -> Array | None:
    """Return the start of the search for a long experiment: a shorter block, designed separately and repeated.

    The information of a filter adds up over time, so that a good block remains good when it is repeated. A block has
    fewer steps and is simulated faster, so that its search is more thorough. It takes half of the evaluations. None if
    the experiment cannot be divided into equal blocks.
    """
    steps = task.steps
    parts = [
        k
        for k in range(2, 13)
        if steps.n_steps % k == 0
        and steps.n_steps // k >= 8
        and BLOCK <= steps.duration / k <= 2 * BLOCK
        and np.isclose(steps.duration / k / steps.grid, round(steps.duration / k / steps.grid))
    ]
    if not parts:
        return None
    k = min(parts, key=lambda n: abs(steps.duration / n - 1.4 * BLOCK))
    short = replace(task, steps=replace(steps, n_steps=steps.n_steps // k, duration=steps.duration / k))
    z = _search(short, evaluations * k // 2, None, progress).z
    n_levels = short.steps.n_steps * short.steps.n_channels
    return np.append(np.tile(z[:n_levels], k), np.tile(z[n_levels:], k))[None]


def _search(task: DesignProblem, evaluations: int, warm: Array | None, progress: Progress | None) -> SearchResult:
    """Search the step sequence with the largest criterion within the limits."""
    return search_design(
        task.steps,
        lambda z: task.judge(task.commands(z)),
        evaluations,
        task.seed,
        warm,
        progress,
        above=lambda z, least: task.judge_above(task.commands(z), least),
    )


def search_design(
    steps: StepInput,
    evaluate: Evaluate,
    evaluations: int,
    seed: int,
    warm: Array | None,
    progress: Progress | None,
    *,
    n_start: int = N_START,
    above: EvaluateAbove | None = None,
) -> SearchResult:
    """Search step sequences with a pattern search.

    Parameters
    ----------
    steps
        Input class.
    evaluate
        Function of search points (n, size) that returns value (n,) and violation (n,).
    evaluations
        Number of evaluations.
    seed
        Seed of the search.
    warm
        Search points (n, size) to start from. By default they are the best of ``n_start`` random points.
    progress
        Function of the number of evaluations and the best value, called during the search.
    n_start
        Number of random points.
    above
        Faster evaluation against a merit, as in `PatternSearch`.
    """
    if warm is None:
        starts = steps.random(n_start, np.random.default_rng([seed, 13]))
        value, violation = evaluate(starts)
        warm = starts[np.lexsort((-value, violation))[:N_RESTARTS]]
    k = np.arange(steps.n_steps)
    together = np.append(np.repeat(k, steps.n_channels), k)
    return PatternSearch(evaluate, steps.low, steps.high, seed, together, above).run(warm, evaluations, progress)


def _uninformative(task: DesignProblem, singular: float) -> str:
    """Return the message for a design without information about some parameters; ``singular``: share of samples."""
    names = ", ".join(task.chosen or task.observed_parameters)
    where = (
        f" in all of the {task.robust} parameter samples (singular in {100 * singular:.0f} %)" if task.robust else ""
    )
    return (
        f"no sequence of {task.steps.n_steps} steps in {task.steps.duration:g} s was found that informs all of {names}"
        f"{where}: "
        f"the sensors cannot separate them, or the simulation diverges on rows of {task.grid:g} s; give "
        "fewer --parameters, or other --steps"
    )


def _too_tight(task: DesignProblem, violation: float) -> str:
    """Return the message for limits that no sequence keeps; ``violation``: relative excess."""
    limits = task.limits
    options = [f"--area {limits.area[0]:g}x{limits.area[1]:g}"] if limits.area else []
    options += [f"--max-speed {limits.speed:g}"] if limits.speed else []
    options += [f"--energy {limits.energy:g}"] if limits.energy else []
    return (
        f"no sequence of {task.steps.n_steps} steps in {task.steps.duration:g} s was found that keeps to "
        f"{', '.join(options)} for all of {N_TRACKS} parameter samples (exceeded by {100 * violation:.0f} %); "
        "give more room, a shorter --duration, a smaller --prior-halfwidth, or a model.toml with smaller errors"
    )


CLOCK_PERIODS = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 15.0, 20.0, 30.0)  # s, of a PRBS
CORNERS = (0.004, 0.007, 0.012, 0.02, 0.035, 0.06, 0.1, 0.18, 0.3)  # Hz, corner frequencies of an RGS
AMPLITUDES = (0.35, 0.6, 1.0)  # of n_max: amplitude or standard deviation


@dataclass(frozen=True)
class BaselineSignal:
    """Best baseline signal of one kind."""

    kind: Literal["PRBS", "RGS"]
    command: Array  # (n_rows, n_channels), after the slew limit
    value: float  # criterion
    bandwidth: float  # clock period [s] of a PRBS, corner frequency [Hz] of an RGS
    values: Array  # (n_seeds,), criterion of each seed at its best bandwidth and amplitude


def baseline_signals(task: DesignProblem, n: int = 20, seed: int = 1) -> dict[str, BaselineSignal]:
    """Return the best of n sequences of each kind, each at its best bandwidth and amplitude.

    Parameters
    ----------
    task
        Design problem.
    n
        Number of sequences of each kind.
    seed
        Seed of the sequences.

    Returns
    -------
    dict
        Best signal of the kinds ``PRBS`` and ``RGS``. Limits of the track do not apply, which favours the baseline.
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
        value = _criterion(task, command).reshape(n, len(options))
        at = np.unravel_index(int(np.argmax(value)), value.shape)
        best = int(at[0]) * len(options) + int(at[1])
        found[kind] = BaselineSignal(
            "PRBS" if kind == "PRBS" else "RGS",
            command[:, :, best],
            float(value[at]),
            options[int(at[1])][0],
            value.max(axis=1),
        )
    return found


def _gaussian(t: Array, corner: float, channels: int, size: float, n_max: float, rng: np.random.Generator) -> Array:
    """Return `rgs` with the standard deviation as a share of the largest command."""
    return rgs(t, corner, channels, size * n_max, n_max, rng)


def _slewed(command: Array, slew: float, step: float) -> Array:
    """Return commands (n_rows, n_channels, n) that change by at most ``slew`` [1/s], starting from zero."""
    if not np.isfinite(slew):
        return command
    out = np.empty_like(command)
    now = np.zeros(command.shape[1:])
    for k, row in enumerate(command):
        out[k] = now
        now = now + np.clip(row - now, -slew * step, slew * step)
    return out


def _criterion(task: DesignProblem, command: Array) -> Array:
    """Return the criterion (n,) as for a design: a mean if robust, and ``SINGULAR`` if any sample is singular."""
    value, singular = task.criterion_of(command)
    return np.where(singular > 0.0, SINGULAR, value)


@dataclass(frozen=True)
class Robustness:
    """Criteria of several inputs over the same parameter samples."""

    values: Mapping[str, Array]  # criterion (n,) of each input by name

    def share_won(self, ours: str = "design") -> float:
        """Return the share of the samples in which the input ``ours`` is better than all other inputs."""
        others = [v for name, v in self.values.items() if name != ours]
        return float(np.mean(self.values[ours] > np.max(others, axis=0))) if others else 1.0


def monte_carlo(task: DesignProblem, commands: Mapping[str, Array], n: int = 1000, seed: int = 1) -> Robustness:
    """Return the criteria of several commands at random parameters.

    Parameters
    ----------
    task
        Design problem. Its prior is the covariance of a fitted model, else a box about the nominal values.
    commands
        Commands (n_rows, n_channels) by name.
    n
        Number of parameter samples.
    seed
        Seed of the samples.
    """
    values = task.belief_or_box.sample(task.experiments.model, n, np.random.default_rng([seed, 17]))
    inputs = {name: task.actuation.inputs(c[:, :, None])[:, :, 0] for name, c in commands.items()}
    return Robustness({name: task.values(u, values) for name, u in inputs.items()})
