"""Model discrimination: T-optimal design of the experiment that tells two models apart.

Two models of the same sensors are given, for example the boat with a delay and the boat with a lag. Both are fitted to
the same logs. If one model is true, the other is fitted to its data and explains as much as its parameters allow. Let e
be the innovations of the filter of the wrong model for the data of the true model, de their sensitivities and S their
covariance. To first order

    T = min over theta of sum e' S^-1 e = sum e' S^-1 e - g' F^-1 g,   g = sum de' S^-1 e,   F = sum de' S^-1 de + prior

T is the expected value of twice the log-likelihood ratio against the wrong model. Each model may be the true one, so
that the design maximises the smaller of the two T. Sources: Atkinson and Fedorov 1975; Uciński 2005.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.ident.estimation import dynamic_parameters
from seatrial.ident.experiment_design.criteria import SINGULAR
from seatrial.ident.experiment_design.evaluator import DesignEvaluator
from seatrial.ident.experiment_design.information import (
    in_lanes,
    interval_ends,
    parallel,
    prior_information,
    sensor_mask,
    start_in_lanes,
    symmetric_matrices,
    with_covariance,
)
from seatrial.ident.experiment_design.optimal_design import BaselineSignal, search_design
from seatrial.ident.experiment_design.problem import DesignProblem
from seatrial.ident.model import Model
from seatrial.ident.numerics import Array, Progress, SearchResult, normal_cdf

# Experiments are simulated in vector lanes: the processor computes one group of experiments at once, one per lane.
CHUNK = 2  # such groups per call; few, since delayed input taps make them large
N_START = 128  # random points from which the search starts
REFITS = 6  # Gauss-Newton steps for the reported T
RELIABLE_T = 30.0  # with a larger T a fit hardly ever prefers the wrong model


@dataclass(frozen=True)
class HypothesisPair:
    """T statistic of commands: the misfit of one model to the data of another, for a pair of models.

    A call returns T: the sum of squared normalised innovations of the filter of the model ``fitted`` on noise-free data
    of the model ``truth``, minimised over the parameters of ``fitted``. T is large if the command separates the models.

    Attributes
    ----------
    fitted
        Model whose filter is applied and whose parameters are refitted, with its nominal values and noise.
    truth
        Model that generates the data, at its own values.
    problem
        Design problem, which gives rows, sensor rates and thruster response. Its own model is not used.
    """

    fitted: Model
    truth: Model
    problem: DesignProblem

    @cached_property
    def free(self) -> tuple[str, ...]:
        """Names of the q parameters of ``fitted`` that are refitted: shared dynamic ones, then free per-record ones."""
        own = [p.name for p in self.fitted.parameters if p.free and p.per_record]
        return (*dynamic_parameters(self.fitted), *own)

    @cached_property
    def _prior(self) -> Array:
        """Prior information (q, q) about the parameters ``free``, in their units; zero for one without a prior."""
        return prior_information([self.fitted.parameter(n) for n in self.free])

    def __call__(self, command: Array, refits: int = 0) -> Array:
        """Return T (n,) of commands (n_rows, n_channels, n).

        Parameters
        ----------
        command
            Commands, -1 to 1, on the rows of the problem.
        refits
            Number of Gauss-Newton steps of the refit. With 0, the result is T to first order, from one linearisation at
            the nominal values.

        Returns
        -------
        Array (n,)
            The least sum that the steps reach, prior included; never below 0. NaN or infinite if the simulation at the
            nominal values diverges; a later step that diverges does not count.
        """
        n = command.shape[2]
        values = np.tile([p.value for p in self.fitted.parameters], (n, 1))
        columns = [list(self.fitted.values).index(name) for name in self.free]
        initial, bounds = values[:, columns].copy(), np.array([self.fitted.parameter(m).bounds for m in self.free]).T
        u, u_true = (replace(self.problem.actuation, model=m).inputs(command) for m in (self.fitted, self.truth))
        best = np.full(n, np.inf)
        for k in range(refits + 1):
            ee, g, F = self._innovation_sums(u, u_true, values)
            change = values[:, columns] - initial
            current = ee + np.einsum("ni,ij,nj->n", change, self._prior, change)
            slope = g - change @ self._prior
            step = _gauss_newton_step(F + self._prior, slope)
            best = np.fmin(best, current)
            if k == refits:
                linear = current - np.einsum("ni,ni->n", slope, step)
                return np.asarray(np.maximum(linear if refits == 0 else best, 0.0))
            values[:, columns] = np.clip(values[:, columns] + step, *bounds)
        raise AssertionError("unreachable")

    def _innovation_sums(self, u: Array, u_true: Array, values: Array) -> tuple[Array, Array, Array]:
        """Run the filter of the fitted model on data of the true model, and return the sums for a Gauss-Newton step.

        Parameters
        ----------
        u, u_true
            Inputs (n_rows, n_inputs, n) of the fitted and of the true model.
        values
            Parameters (n, n_parameters) of the fitted model.

        Returns
        -------
        tuple of Array
            The sums over time e' S^-1 e (n,), de' S^-1 e (n, q) and de' S^-1 de (n, q, q). e are the innovations, S is
            their covariance, and de are the sensitivities of the predicted outputs to the parameters ``free``.
        """
        from seatrial.ident.engine import discrimination_batch_for  # imported late, since it loads CasADi

        kernel = discrimination_batch_for(
            self.fitted, self.free, self.truth, covariance=self.problem.process_noise
        ).unexplained
        width, n, t = kernel.plan.width, u.shape[2], self.problem.t
        mask = sensor_mask(self.fitted, t.size, self.problem.every)
        h = np.append(np.diff(t), 0.0)
        truth = np.array([[p.value for p in self.truth.parameters]])
        size = kernel.plan.sizes["low"]

        def work(lanes: slice) -> tuple[Array, Array, Array]:
            """Return the three sums of a slice of the experiments, one row per experiment; matrices as upper triangles.

            The rows that fill up the last group of vector lanes are removed.
            """
            groups = -(-(lanes.stop - lanes.start) // width)
            p = in_lanes(values[lanes].T[None], groups, width)[0]
            p_true = in_lanes(np.repeat(truth, lanes.stop - lanes.start, axis=0).T[None], groups, width)[0]
            s = start_in_lanes(self.fitted, p)
            arguments = {
                "s": with_covariance(self.fitted, s, p) if self.problem.process_noise else s,
                "p": p,
                "p_true": p_true,
                "s_true": start_in_lanes(self.truth, p_true),
                "h": h,
                "low": np.full((groups, size, width), np.inf),
                "high": np.full((groups, size, width), -np.inf),
            }
            for name, model, part in (("", self.fitted, u), ("_true", self.truth, u_true)):
                arguments[f"u{name}"] = in_lanes(part[:, :, lanes], groups, width)
                arguments[f"u_next{name}"] = interval_ends(model, arguments[f"u{name}"], -2)
            results = kernel(t.size, mask, arguments, groups=groups)
            return tuple(
                a.transpose(0, 2, 1).reshape(groups * width, -1)[: lanes.stop - lanes.start]
                for a in (results["ee"], results["score"], results["fisher"])
            )  # type: ignore[return-value]

        chunks = [slice(a, min(a + width * CHUNK, n)) for a in range(0, n, width * CHUNK)]
        ee, g, triangle = (np.concatenate(c) for c in zip(*parallel(work, chunks, 2), strict=True))
        return ee[:, 0], g, symmetric_matrices(triangle, len(self.free))


def _gauss_newton_step(F: Array, g: Array) -> Array:
    """Return the Gauss-Newton step F^-1 g (n, q) of each of n experiments.

    The step is added to the parameters: g (n, q) is minus half of the gradient of the sum of squares. Each information
    matrix of F (n, q, q) is scaled to a unit diagonal and slightly regularised. The step is zero for an experiment
    whose F or g is not finite.
    """
    good = np.asarray(np.isfinite(F).all(axis=(1, 2)) & np.isfinite(g).all(axis=1))
    F, g = F.copy(), g.copy()
    F[~good], g[~good] = np.eye(F.shape[1]), 0.0
    size = np.sqrt(np.maximum(np.diagonal(F, axis1=1, axis2=2), 1e-300))
    scaled = F / (size[:, :, None] * size[:, None, :])
    x = np.linalg.solve(scaled + 1e-11 * np.eye(F.shape[1]), (g / size)[:, :, None])
    return np.asarray(x[:, :, 0] / size)


@dataclass(frozen=True)
class DiscriminationDesign:
    """Experiment that discriminates two models a and b.

    Attributes
    ----------
    problem
        Design problem that was searched.
    levels : Array (n_steps, n_channels)
        Level of each step on each channel, -1 to 1.
    durations : Array (n_steps,)
        Duration of each step [s].
    separation
        T after refits: first if b is true and a is fitted, then if a is true and b is fitted.
    found
        Result of the search: best point and number of evaluations.
    """

    problem: DesignProblem
    levels: Array
    durations: Array
    separation: tuple[float, float]
    found: SearchResult = field(repr=False)

    @property
    def command(self) -> Array:
        """Command (n_rows, n_channels), -1 to 1, with the slew limit, on the rows of the design problem."""
        return self.problem.actuation.limited(self.levels[:, :, None], self.durations[:, None])[:, :, 0]

    @property
    def clear(self) -> bool:
        """Whether a fit is expected to prefer the true model, whichever of the two it is: both T exceed 30."""
        return min(self.separation) > RELIABLE_T


def probability_of_true_model(T: float) -> float:
    """Return the probability that the true model has the larger likelihood, for a separation T of two models.

    Twice the log-likelihood ratio is normal with mean T and variance 4 T, so that the probability is Phi(sqrt(T) / 2).
    It assumes that one of the two models describes the boat completely.
    """
    return float(normal_cdf(np.sqrt(T) / 2.0))


def _both_hypotheses(model_a: Model, model_b: Model, problem: DesignProblem) -> tuple[HypothesisPair, HypothesisPair]:
    """Return two pairs of models: a fitted to data of b, and b fitted to data of a.

    The measurement noise of both models is scaled for the sample rates on the rows of the problem.
    """
    a, b = problem.observed(model_a), problem.observed(model_b)
    return HypothesisPair(a, b, problem), HypothesisPair(b, a, problem)


def separation(model_a: Model, model_b: Model, problem: DesignProblem, command: Array) -> tuple[float, float]:
    """Return the separation T of two models by a command, for each model as the true one.

    T is the expected value of twice the log-likelihood ratio against the wrong model after its refit with six
    Gauss-Newton steps.

    Parameters
    ----------
    model_a, model_b
        The models with fitted values.
    problem
        Design problem, which gives rows, sensor rates and thruster response.
    command
        Command (n_rows, n_channels), -1 to 1.

    Returns
    -------
    tuple of float
        T if b is true and a is fitted, and T if a is true and b is fitted.

    Raises
    ------
    SeatrialError
        If a simulation diverges.
    """
    first, second = (float(r(command[:, :, None], REFITS)[0]) for r in _both_hypotheses(model_a, model_b, problem))
    if not np.isfinite([first, second]).all():
        names = " and ".join(" + ".join([m.name, *(e.name for e in m.effects)]) for m in (model_a, model_b))
        raise SeatrialError(
            f"the models {names} cannot be compared: a simulation diverges with an interval of {problem.grid:g} s "
            "between rows; check their parameter values, or give a shorter `grid` of the DesignProblem in Python"
        )
    return first, second


def separation_if_repeated(
    model_a: Model, model_b: Model, problem: DesignProblem, command: Array
) -> tuple[float, float]:
    """Return the separation T of two models by a command that is run twice in a row (`separation`).

    Parameters
    ----------
    model_a, model_b
        The models with fitted values.
    problem
        Design problem of the command that is run once.
    command
        Command (n_rows, n_channels), -1 to 1, on the rows of the problem.

    Raises
    ------
    SeatrialError
        If a simulation diverges.
    """
    steps = replace(problem.steps, duration=2.0 * problem.steps.duration, n_steps=2 * problem.steps.n_steps)
    return separation(model_a, model_b, replace(problem, steps=steps), np.concatenate([command[:-1], command]))


def reliable_duration(T: float, twice: float, duration: float) -> float:
    """Return the duration [s] from which the separation T would exceed 30 (`RELIABLE_T`), at the earliest.

    Parameters
    ----------
    T
        Separation of two models by a mission.
    twice
        Separation by this mission run twice in a row.
    duration
        Duration of the mission [s].

    Returns
    -------
    float
        Duration at which T reaches 30 if each repetition adds as much as the first one. Infinite if T does not grow.

    Notes
    -----
    T of a pair in which neither model can imitate the other grows in proportion to the duration. A part of T may be the
    price of parameters far from their priors, with which one model imitates the other: this part is paid once. Later
    repetitions then add less than the first one, so that the result is a lower limit.
    """
    if T >= RELIABLE_T:
        return duration
    return duration * (1.0 + (RELIABLE_T - T) / (twice - T)) if twice > T else float("inf")


def baselines_apart(
    model_a: Model, model_b: Model, problem: DesignProblem, signals: Mapping[str, BaselineSignal]
) -> dict[str, BaselineSignal]:
    """Return the best baseline signal of each kind by the smaller separation T of two models.

    Parameters
    ----------
    model_a, model_b
        The models with fitted values.
    problem
        Design problem, which gives rows, sensor rates and thruster response.
    signals
        Baseline signals by kind. The candidates are their ``sequences``, whose bandwidth and amplitude are those with
        the most information.

    Returns
    -------
    dict
        For each kind the sequence with the largest T, and the T of all. A sequence whose simulation diverges has T 0.
    """
    pairs, found = _both_hypotheses(model_a, model_b, problem), {}
    for kind, signal in signals.items():
        T = np.minimum(*(r(signal.sequences, REFITS) for r in pairs))
        T = np.where(np.isfinite(T), T, 0.0)
        best = int(np.argmax(T))
        found[kind] = replace(signal, command=signal.sequences[:, :, best], value=float(T[best]), values=T)
    return found


def _ignore(phase: str) -> None:
    """Do nothing with the name of a phase: the caller wants no report of the progress."""


def discriminate(
    model_a: Model,
    model_b: Model,
    problem: DesignProblem,
    *,
    evaluations: int = 4000,
    progress: Progress | None = None,
    phase: Callable[[str], None] | None = None,
) -> DiscriminationDesign:
    """Search the T-optimal step sequence for two models: the one with the largest T, whichever model is true.

    The search maximises the smaller of the two T to first order. The result also has both T after refits.

    Parameters
    ----------
    model_a, model_b
        The models with fitted values, also of their effects. With both effects at zero the models would be equal.
    problem
        Design problem with input class, sensor rates and limits. Its model is used for the limits only, but must have
        the sensors of both models.
    evaluations
        Number of evaluations of T, without those of 128 random start points.
    progress
        Function that is called after each batch of points, with the number of evaluations and the best logarithm of T
        of the current search (a large negative number if limits are violated).
    phase
        Function that is called with the name of each phase before and after the search, when it begins or goes on.

    Returns
    -------
    DiscriminationDesign
        Best step sequence, with its T after six Gauss-Newton steps for each model as the true one.

    Raises
    ------
    SeatrialError
        If the models have different sensors, if no sequence that was found keeps to the limits, or if a simulation of
        the result diverges.
    """
    if [s.name for s in model_a.sensors] != [s.name for s in model_b.sensors]:
        raise SeatrialError(
            f"models {model_a.name} and {model_b.name} have different sensors, so their predictions cannot be "
            "compared; give models with the same sensors"
        )
    evaluator = DesignEvaluator(problem)
    pairs = _both_hypotheses(model_a, model_b, problem)
    report = phase or _ignore
    tried = 0  # search points so far

    def evaluate(z: Array) -> tuple[Array, Array]:
        """Return log T (n,) of the worse hypothesis and the violation (n,) of the limits, at search points z (n, size).

        Log T is that of the smaller T, to first order. Log T is ``SINGULAR`` (-1e9) if one of both T is not finite.
        """
        nonlocal tried
        command, parts = problem.commands(z), list[Array]()
        for k in range(0, command.shape[2], 32):
            if tried == 0:
                report("compiling both models")  # in the first call
            elif tried < N_START:
                report(f"random start points, {tried} of {N_START}")
            parts.append(np.minimum(*(r(command[:, :, k : k + 32]) for r in pairs)))
            tried += parts[-1].size
        T = np.concatenate(parts)
        return np.where(np.isfinite(T), np.log(np.maximum(T, 1e-12)), SINGULAR), evaluator.violation(command)

    found = search_design(problem.steps, evaluate, evaluations, problem.seed, None, progress, n_start=N_START)
    if found.violation > 0:
        raise SeatrialError(
            "no step sequence that keeps to the limits was found; give a larger --area, weaker limits or a longer "
            "--duration"
        )
    levels, durations = (a[..., 0] for a in problem.steps.unpack(found.z[None]))
    report("comparison after refits")
    made = DiscriminationDesign(problem, levels, durations, (0.0, 0.0), found)
    return replace(made, separation=separation(model_a, model_b, problem, made.command))
