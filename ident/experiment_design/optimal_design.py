"""Optimal input design: the step sequence with the largest information about the parameters, within limits.

The thesis (chapter 5) uses the information of output error, since that of prediction error took too long to compute.
Here both cost about the same, and prediction error is the default. Without process noise a simulation of ten minutes is
extremely sensitive to every parameter: the heading at the end depends on the whole motion before. Output error
therefore predicts standard errors of a twentieth to a hundredth of those of a fit, and optimises for them.

The module also computes baseline signals, PRBS and random Gaussian signals (RGS) of optimised bandwidth, and the
robustness of a design to the parameters (Ljung 1999, section 13.3).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Literal

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.ident.estimation import SampledInputs, simulate, simulate_stochastic
from seatrial.ident.experiment_design.criteria import SINGULAR
from seatrial.ident.experiment_design.evaluator import N_TRACKS, DesignEvaluator
from seatrial.ident.experiment_design.excitation import StepInput, prbs, rgs
from seatrial.ident.experiment_design.information import (
    errors_of,
    planned_record,
    prediction_information,
    prior_information,
)
from seatrial.ident.experiment_design.problem import DesignProblem
from seatrial.ident.numerics import Array, Evaluate, EvaluateAbove, PatternSearch, Progress, SearchResult

N_START, N_RESTARTS = 512, 4  # random sequences, and the best of them from which a search starts
SEARCHES = N_RESTARTS + 1  # one from each start, and the continuation of the best
SHORTEST_DESIGN_BLOCK_S = 100.0  # s, shortest block of a long experiment that is designed separately and repeated
LEVEL_DIGITS = 3  # decimal digits of a level in mission.toml
N_BAND = 64  # simulated boats for the band of the track


@dataclass(frozen=True)
class Design:
    """Best step sequence that a search found, with its information.

    Attributes
    ----------
    problem
        Design problem that was searched.
    levels : Array (n_steps, n_channels)
        Level of each step on each channel, -1 to 1.
    durations : Array (n_steps,)
        Duration of each step [s].
    value
        Optimality criterion, with the prior information.
    information : Array (q, q)
        Information of the experiment about the parameters ``problem.free`` at nominal values, reduced by the inflation
        of the standard errors in earlier logs, without the prior information.
    found
        Result of the search: best point and number of evaluations.
    """

    problem: DesignProblem
    levels: Array
    durations: Array
    value: float
    information: Array
    found: SearchResult

    @cached_property
    def evaluator(self) -> DesignEvaluator:
        """Evaluator of the design problem: information, criterion and violation of the limits of commands."""
        return DesignEvaluator(self.problem)

    def command_on(self, problem: DesignProblem) -> Array:
        """Return the command (n_rows, n_channels), -1 to 1, with the slew limit, on the rows of another problem.

        The other problem differs from that of the design in the spacing of its rows only.
        """
        return problem.actuation.limited(self.levels[:, :, None], self.durations[:, None])[:, :, 0]

    @property
    def command(self) -> Array:
        """Command (n_rows, n_channels), -1 to 1, with the slew limit, on the rows of the design problem."""
        return self.command_on(self.problem)

    @property
    def before(self) -> dict[str, float]:
        """Standard errors before the experiment, from the prior information, by observed parameter.

        They are inf for a parameter without prior information, and for a parameter that the prior information does not
        separate from others.
        """
        return self._errors_by_name(self.evaluator.prior_information)

    @property
    def errors(self) -> dict[str, float]:
        """Standard errors after the experiment, by observed parameter.

        They follow from the prior information and the information in the search, which treats the noise parameters as
        known. They are inf for a parameter that cannot be separated from others.
        """
        return self._errors_by_name(self.information + self.evaluator.prior_information)

    @cached_property
    def predicted(self) -> dict[str, float]:
        """Standard errors that a fit can reach after the experiment, in the units of the parameters.

        The keys are the shared dynamic parameters on which an output of the model depends, whatever the experiment
        (``problem.observed_parameters``). A parameter that cannot be separated from others has the value inf. The
        errors follow from prediction error with all sensors at their rates and with unknown noise parameters. They
        include the prior information, and the inflation of the standard errors in earlier logs.
        """
        return predicted_errors(self.problem, self.command_on(self.problem.finer))

    def _errors_by_name(self, information: Array) -> dict[str, float]:
        """Return the standard error of each observed parameter, from information (q, q) about ``problem.free``.

        The other parameters in ``problem.free``, nuisance parameters, count as unknown. The error is inf for a
        parameter that cannot be separated from others.
        """
        q = len(self.problem.observed_parameters)
        return dict(zip(self.problem.observed_parameters, errors_of(information)[:q].tolist(), strict=True))


def predicted_errors(problem: DesignProblem, command: Array) -> dict[str, float]:
    """Return the standard errors that a fit can reach after an experiment.

    Parameters
    ----------
    problem
        Design problem.
    command
        Command (n_rows, n_channels), -1 to 1, on the rows of ``problem.finer``.

    Returns
    -------
    dict
        Standard error of each shared dynamic parameter that the sensors observe (``problem.observed_parameters``), by
        name, in the unit of the parameter. It is inf for a parameter that cannot be separated from others.

    Notes
    -----
    The information is always that of prediction error, with all sensors at their rates and with unknown noise
    parameters, also for a problem of output error. It includes the prior information, and is reduced by the inflation
    of the standard errors in earlier logs.
    """
    evaluator = DesignEvaluator(problem)
    fine, q = problem.finer, len(problem.observed_parameters)
    model = fine.observed(problem.model)
    u = fine.actuation.inputs(command[:, :, None])[:, :, 0]
    record = planned_record(model, fine.t, u, fine.every)
    free = [
        *problem.observed_parameters,
        *[p.name for p in model.parameters if p.free and p.name not in problem.observed_parameters],
    ]
    inflation = np.array([evaluator.prior.inflation.get(n, 1.0) for n in free])
    F = prediction_information(model, record, free=free) / np.outer(inflation, inflation)
    F = F + prior_information([model.parameter(n) for n in free])
    of_model = prior_information([model.parameter(n) for n in problem.observed_parameters])
    F[:q, :q] = F[:q, :q] - of_model + evaluator.prior_information[:q, :q]
    return dict(zip(problem.observed_parameters, errors_of(F)[:q].tolist(), strict=True))


@dataclass(frozen=True)
class PredictedTrack:
    """Predicted track, from the rest before the steps to the end of the coasting after them.

    Attributes
    ----------
    t : Array (n,)
        Times [s] since the start of the mission.
    x, y : Array (n,)
        Position [m] north and east of the start. The nominal boat starts with a heading of north.
    radius : Array (n,)
        Radius [m] of the circle about the nominal position that holds 95 % of the sampled boats. It is infinite at
        times at which the motion of more than 5 % of them has grown without limit.
    others : Array (k, n, 2)
        Positions (north, east) [m] of k boats sampled from the prior, with process noise.
    inside
        Share of the sampled boats that stay in the area during the whole mission; None without an area.
    corner : Array (2,)
        South-west corner (north, east) [m] of the area relative to the start; None without an area.
    """

    t: Array
    x: Array
    y: Array
    radius: Array
    others: Array
    inside: float | None
    corner: Array | None

    @property
    def is_bounded(self) -> bool:
        """Whether the nominal track and the radius are finite at all times."""
        return bool(np.isfinite([self.x, self.y, self.radius]).all())

    @property
    def share_unbounded(self) -> float:
        """Share of the sampled boats whose simulated motion grows without limit."""
        return float(np.mean(~np.isfinite(self.others).all(axis=(1, 2))))


def predicted_track(made: Design, points: int = 61) -> PredictedTrack | None:
    """Predict the track of a design by simulation of the nominal boat and of 64 sampled boats with process noise.

    Each sampled boat has its own random current, of up to ``limits.current`` of the problem.

    Parameters
    ----------
    made
        The design.
    points
        Number of points of the track, evenly spaced in time. With fewer rows in the mission there are fewer points.

    Returns
    -------
    PredictedTrack or None
        None if the model has no position ``x`` and ``y``.
    """
    problem = made.problem
    names = [s.name for s in problem.model.states]
    if not {"x", "y"} <= set(names):
        return None
    columns = [names.index("x"), names.index("y")]
    t, u = problem.t_whole, problem.whole_inputs(made.command[:, :, None])[:, :, 0]
    nominal = simulate(problem.model, planned_record(problem.model, t, u)).x[:, columns]
    rngs = [np.random.default_rng([problem.seed, 20, k]) for k in range(N_BAND)]
    with np.errstate(over="ignore", invalid="ignore"):  # of boats whose motion grows without limit
        others = simulate_stochastic(
            problem.model,
            SampledInputs.linear(t, u),
            made.evaluator.boats(N_BAND, 3),
            rngs,
            x0=np.zeros((N_BAND, len(names))),
            substep=problem.grid / 2,
        )[0][:, :, columns]
    inside, corner = None, made.evaluator.area_corner(made.command)
    if corner is not None and problem.limits.area is not None:
        kept = (others >= corner) & (others <= corner + np.array(problem.limits.area))
        inside = float(np.mean(kept.all(axis=(1, 2))))
    at = np.unique(np.linspace(0, t.size - 1, points).round().astype(int))
    away = np.hypot(*(others - nominal).transpose(2, 0, 1))
    # "higher": no interpolation between a finite and an infinite distance.
    radius = np.quantile(np.where(np.isfinite(away), away, np.inf), 0.95, axis=0, method="higher")
    return PredictedTrack(t[at], nominal[at, 0], nominal[at, 1], radius[at], others[:, at], inside, corner)


def design(
    problem: DesignProblem, *, evaluations: int = 20_000, warm: Array | None = None, progress: Progress | None = None
) -> Design:
    """Search the optimal step sequence of a design problem.

    Parameters
    ----------
    problem
        Design problem.
    evaluations
        Number of evaluations of the criterion in the search, without those of random start points. If a block is
        designed first (see ``warm``), the search of the whole experiment has half of them, and that of the block takes
        as much time as the other half.
    warm
        Search points (n, size) to start from, as `StepInput` describes them. By default the search starts from the best
        of 512 random sequences. For prediction error it starts from a shorter block that is designed first and
        repeated, if the experiment can be divided into such blocks of 100 to 200 s with at least 8 steps.
    progress
        Function that is called after each batch of points, with the number of evaluations so far, the best merit of the
        current search, its number from 1 on, and the number of searches. There is one search for each start point, and
        one that continues the best; those of a block come first. The evaluations of a block count by their time, so
        that all are ``evaluations`` at most. The merit is a large negative number if limits are violated.

    Returns
    -------
    Design
        Best sequence, with levels rounded to three decimal digits. The same seed gives the same design.

    Raises
    ------
    SeatrialError
        If the best sequence exceeds the limits by more than 0.001, or if its information matrix is singular (of a
        robust design: for any parameter sample).
    """
    if warm is None and problem.process_noise:
        warm = _repeated_block(problem, evaluations, progress)
        if warm is not None:
            progress = _counted_from(evaluations // 2, 1, progress, (SEARCHES, SEARCHES))
            evaluations //= 2
    evaluator = DesignEvaluator(problem)
    found = _search_within_limits(evaluator, evaluations, warm, progress)
    levels, durations = (a[..., 0] for a in problem.steps.unpack(found.z[None]))
    n_max = problem.steps.n_max
    levels = np.clip(levels.round(LEVEL_DIGITS), -n_max, n_max)
    rounded = problem.actuation.limited(levels[:, :, None], durations[:, None])
    (value,), (singular,) = evaluator.mean_criterion(rounded)
    (beyond,) = evaluator.violation(rounded)
    if value <= SINGULAR or singular > 0:
        raise SeatrialError(_no_information_message(problem, float(singular)))
    if beyond > 10.0**-LEVEL_DIGITS:
        raise SeatrialError(_limits_message(problem, float(beyond), evaluator.area_of(rounded[:, :, 0])))
    information = evaluator.information(problem.actuation.inputs(rounded))[0]
    return Design(problem, levels, durations, float(value), information, found)


def _repeated_block(problem: DesignProblem, evaluations: int, progress: Progress | None) -> Array | None:
    """Return the start of the search for a long experiment: a shorter experiment that is designed and then repeated.

    The shorter experiment (block) has 100 to 200 s and at least 8 steps. Its search takes as much time as half of the
    evaluations of the long experiment. The information of a filter adds up over time, so that a good block remains good
    when it is repeated. A block has fewer steps and is simulated faster, so that its search is more thorough.

    Returns
    -------
    Array (1, size) or None
        Search point of the long experiment. None if the experiment cannot be divided into 2 to 12 such blocks of equal
        length, whole rows and whole steps. If there are several ways, the length is the one closest to 140 s.
    """
    steps = problem.steps
    parts = [
        k
        for k in range(2, 13)
        if steps.n_steps % k == 0
        and steps.n_steps // k >= 8
        and SHORTEST_DESIGN_BLOCK_S <= steps.duration / k <= 2 * SHORTEST_DESIGN_BLOCK_S
        and np.isclose(steps.duration / k / steps.grid, round(steps.duration / k / steps.grid))
    ]
    if not parts:
        return None
    k = min(parts, key=lambda n: abs(steps.duration / n - 1.4 * SHORTEST_DESIGN_BLOCK_S))
    short = replace(problem, steps=replace(steps, n_steps=steps.n_steps // k, duration=steps.duration / k))
    counted = _counted_from(0, k, progress, (0, 1))
    z = _search_within_limits(DesignEvaluator(short), evaluations * k // 2, None, counted).z
    n_levels = short.steps.n_steps * short.steps.n_channels
    return np.append(np.tile(z[:n_levels], k), np.tile(z[n_levels:], k))[None]


def _counted_from(before: int, parts: int, progress: Progress | None, others: tuple[int, int]) -> Progress | None:
    """Return ``progress`` with another count: ``before`` and the evaluations of its search, divided by ``parts``.

    ``others`` are the number of searches before it, and that of all others.
    """
    if progress is None:
        return None
    earlier, more = others
    return lambda n, merit, number, of: progress(before + n // parts, merit, earlier + number, more + of)


def _search_within_limits(
    evaluator: DesignEvaluator, evaluations: int, warm: Array | None, progress: Progress | None
) -> SearchResult:
    """Search the step sequence with the largest criterion within the limits of the design problem.

    ``warm``: search points (n, size) to start from; None: the best four of 512 random points. The result violates the
    limits if no point within them was found; this is not an error here.
    """
    problem = evaluator.problem
    return search_design(
        problem.steps,
        lambda z: evaluator.evaluate(problem.commands(z)),
        evaluations,
        problem.seed,
        warm,
        progress,
        above=lambda z, least: evaluator.evaluate_above(problem.commands(z), least),
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
    """Search the step sequence with the largest value and no violation, by pattern search.

    The levels and the duration of one step move together.

    Parameters
    ----------
    steps
        Input class, which defines the search points and their bounds.
    evaluate
        Function of search points (n, size) that returns value (n,) and violation (n,); a violation above 0 means that a
        point is not admissible.
    evaluations
        Number of evaluations of points, without those of the random start points.
    seed
        Seed of the search.
    warm
        Search points (n, size) to start from. None: the best four of ``n_start`` random points, those without violation
        first.
    progress
        Function that is called after each batch of points, with the number of evaluations so far, the best merit of the
        current search, its number from 1 on, and the number of searches. The merit is the value, or a large negative
        number with a violation.
    n_start
        Number of random points.
    above
        Function of search points and a merit (the value of an admissible point) that returns value and violation. It
        may be inexact, and therefore faster, for points that are not better than the merit. None: ``evaluate``.

    Returns
    -------
    SearchResult
        Best point found. Its violation is positive if no point is admissible.
    """
    if warm is None:
        starts = steps.random(n_start, np.random.default_rng([seed, 13]))
        value, violation = evaluate(starts)
        warm = starts[np.lexsort((-value, violation))[:N_RESTARTS]]
    k = np.arange(steps.n_steps)
    together = np.append(np.repeat(k, steps.n_channels), k)
    return PatternSearch(evaluate, steps.low, steps.high, seed, together, above).run(warm, evaluations, progress)


def _no_information_message(problem: DesignProblem, singular: float) -> str:
    """Return the error message for a design that does not inform all chosen parameters.

    ``singular`` is the share of the parameter samples with a singular information matrix, 0 to 1. The message gives it
    for a robust design only.
    """
    names, steps = ", ".join(problem.chosen or problem.observed_parameters), problem.steps
    where = f" in all of the {problem.robust} parameter samples (singular in {100 * singular:.0f} %)"
    return (
        f"no sequence of {steps.n_steps} steps in {steps.duration:g} s was found that informs all of {names}"
        f"{where if problem.robust else ''}: "
        f"the sensors cannot separate them, or the simulation diverges on rows of {problem.grid:g} s; give "
        "fewer --parameters, or other --steps"
    )


def _limits_message(problem: DesignProblem, violation: float, extent: Array | None) -> str:
    """Return the error message for limits that no sequence keeps.

    It lists the limits as options of the command line. ``violation`` is the summed relative excess of the nearest
    sequence, which is shown in per cent. ``extent`` (2,) are the sides of the area [m] that this sequence needs, to the
    north and east; None without a limit of area. If a side is too small, the message proposes an area.
    """
    limits = problem.limits
    options = [f"--area {limits.area[0]:g}x{limits.area[1]:g}"] if limits.area else []
    options += [f"--max-speed {limits.speed:g}"] if limits.speed else []
    options += [f"--energy {limits.energy:g}"] if limits.energy else []
    room = "more room (weaker limits)"
    if limits.area is not None and extent is not None and (extent > limits.area).any() and np.isfinite(extent).all():
        north, east = (
            side if x <= side else rounded_up(x) for side, x in zip(limits.area, extent.tolist(), strict=True)
        )
        room = (
            f"a larger area, such as --area {north:g}x{east:g} (the nearest sequence needs {extent[0]:.3g} m north by "
            f"{extent[1]:.3g} m east at its speeds)"
        )
    # The half-width of the prior is that of a structure without a fit.
    prior = "a smaller --prior-halfwidth, " if problem.prior is None or problem.prior.covariance is None else ""
    return (
        f"no sequence of {problem.steps.n_steps} steps in {problem.steps.duration:g} s was found that keeps to "
        f"{', '.join(options)} for all of {N_TRACKS} parameter samples (exceeded by {100 * violation:.0f} %); "
        f"give {room}; a shorter --duration, a smaller --n-max, {prior}or a model.toml with smaller errors"
    )


def rounded_up(side: float) -> float:
    """Return a proposed side of an area [m]: 5 % longer, and rounded up to two digits."""
    step = 10.0 ** (math.floor(math.log10(max(side, 0.1))) - 1)
    return float(f"{step * math.ceil(1.05 * side / step):.3g}")


CLOCK_PERIODS = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 15.0, 20.0, 30.0)  # s, of a PRBS
CORNERS = (0.004, 0.007, 0.012, 0.02, 0.035, 0.06, 0.1, 0.18, 0.3)  # Hz, corner frequencies of an RGS
AMPLITUDES = (0.35, 0.6, 1.0)  # of n_max: amplitude or standard deviation


@dataclass(frozen=True)
class BaselineSignal:
    """Best baseline signal of one kind: pseudo-random binary (PRBS) or random Gaussian (RGS).

    Attributes
    ----------
    kind
        Kind of the signal.
    command : Array (n_rows, n_channels)
        Command, -1 to 1, with the slew limit.
    value
        Optimality criterion of the command, with the prior information.
    bandwidth
        Clock period [s] of a PRBS, corner frequency [Hz] of an RGS.
    values : Array (n_sequences,)
        Criterion of each random sequence at its best bandwidth and amplitude.
    sequences : Array (n_rows, n_channels, n_sequences)
        Commands of all random sequences at the bandwidth and amplitude of the best one, with the slew limit.
    """

    kind: Literal["PRBS", "RGS"]
    command: Array
    value: float
    bandwidth: float
    values: Array
    sequences: Array


def baseline_signals(problem: DesignProblem, n: int = 20, seed: int = 1) -> dict[str, BaselineSignal]:
    """Return the best of n random sequences of each kind, each at its best bandwidth and amplitude.

    These are chosen from fixed values: clock periods of 1 to 30 s, corner frequencies of 0.004 to 0.3 Hz, and
    amplitudes or standard deviations of 0.35, 0.6 and 1 of the largest command. The parameters have their nominal
    values, unless the design is robust.

    Parameters
    ----------
    problem
        Design problem. Its slew limit applies to the sequences. Its limits of area, speed and energy do not, which
        favours the baseline.
    n
        Number of sequences of each kind.
    seed
        Seed of the sequences.

    Returns
    -------
    dict
        Best signal of each kind, by the names ``PRBS`` and ``RGS``.
    """
    evaluator = DesignEvaluator(problem)
    channels, n_max = len(problem.actuation.channels), problem.steps.n_max
    makers = {
        "PRBS": [(c, s, partial(prbs, problem.t, c, channels, s * n_max)) for c in CLOCK_PERIODS for s in AMPLITUDES],
        "RGS": [(c, s, partial(_rgs_of_share, problem.t, c, channels, s, n_max)) for c in CORNERS for s in AMPLITUDES],
    }
    found: dict[str, BaselineSignal] = {}
    for k, (kind, options) in enumerate(makers.items()):
        raw = np.stack([make(rng=np.random.default_rng([seed, k, i])) for i in range(n) for _, _, make in options], 2)
        command = _with_slew_limit(raw, problem.slew, problem.grid)
        value = _baseline_criterion(evaluator, command).reshape(n, len(options))
        at = np.unravel_index(int(np.argmax(value)), value.shape)
        best = int(at[0]) * len(options) + int(at[1])
        found[kind] = BaselineSignal(
            "PRBS" if kind == "PRBS" else "RGS",
            command[:, :, best],
            float(value[at]),
            options[int(at[1])][0],
            value.max(axis=1),
            command[:, :, int(at[1]) :: len(options)],
        )
    return found


def _rgs_of_share(t: Array, corner: float, channels: int, size: float, n_max: float, rng: np.random.Generator) -> Array:
    """Return random Gaussian sequences (n_rows, n_channels) with the standard deviation ``size * n_max``.

    They are low-pass filtered at the corner frequency [Hz], scaled to that deviation, and then clipped at the largest
    command ``n_max``.
    """
    return rgs(t, corner, channels, size * n_max, n_max, rng)


def _with_slew_limit(command: Array, slew: float, step: float) -> Array:
    """Return commands (n_rows, n_channels, n) that follow the given ones at no more than ``slew`` [1/s].

    Rows are ``step`` [s] apart. The first row is zero, and each row follows the given ones before it. Without a finite
    limit the commands are returned unchanged.
    """
    if not np.isfinite(slew):
        return command
    out = np.empty_like(command)
    now = np.zeros(command.shape[1:])
    for k, row in enumerate(command):
        out[k] = now
        now = now + np.clip(row - now, -slew * step, slew * step)
    return out


def _baseline_criterion(evaluator: DesignEvaluator, command: Array) -> Array:
    """Return the criterion (n,) of commands (n_rows, n_channels, n), as for a design.

    For a robust design it is the mean over the parameter samples. It is ``SINGULAR`` (-1e9) if the information matrix
    of any sample is singular.
    """
    value, singular = evaluator.mean_criterion(command)
    return np.where(singular > 0.0, SINGULAR, value)


@dataclass(frozen=True)
class Robustness:
    """Criteria of several commands over the same parameter samples.

    Attributes
    ----------
    values
        Optimality criterion (n_samples,) of each command, by its name, with the prior information.
    """

    values: Mapping[str, Array]

    def share_won(self, ours: str = "design") -> float:
        """Return the share (0 to 1) of the samples in which the command ``ours`` is better than all others.

        A tie counts as not better. Without other commands the share is 1. Raise KeyError for an unknown name.
        """
        others = [v for name, v in self.values.items() if name != ours]
        return float(np.mean(self.values[ours] > np.max(others, axis=0))) if others else 1.0


def monte_carlo(problem: DesignProblem, commands: Mapping[str, Array], n: int = 1000, seed: int = 1) -> Robustness:
    """Return the optimality criteria of several commands at the same random parameters.

    Parameters
    ----------
    problem
        Design problem, from whose prior the parameters are drawn.
    commands
        Commands (n_rows, n_channels), -1 to 1, by name.
    n
        Number of parameter samples.
    seed
        Seed of the samples.

    Returns
    -------
    Robustness
        Criterion of each command at each sample, with the prior information. It is ``SINGULAR`` (-1e9) for a singular
        information matrix.
    """
    evaluator = DesignEvaluator(problem)
    values = evaluator.prior.sample(evaluator.experiments.model, n, np.random.default_rng([seed, 17]))
    inputs = {name: problem.actuation.inputs(c[:, :, None])[:, :, 0] for name, c in commands.items()}
    return Robustness({name: evaluator.criterion_values(u, values) for name, u in inputs.items()})
