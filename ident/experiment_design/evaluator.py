"""Evaluation of candidate commands of a design problem: information, criterion, and violation of the limits."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.ident.experiment_design.criteria import SINGULAR, Criterion, characteristic_steps
from seatrial.ident.experiment_design.information import Experiments
from seatrial.ident.experiment_design.prior import ParameterPrior, default_prior, prior_matrix
from seatrial.ident.experiment_design.problem import DesignProblem
from seatrial.ident.experiment_design.track_extent import TrackExtent, in_current
from seatrial.ident.numerics import Array, violates_constraint

MAX_INPUT_BYTES = 200e6  # of inputs in memory at once
N_TRACKS = 24  # parameter samples whose tracks must keep to the limits
AT_BOUND = 1e-6  # of a standard deviation of its prior: a parameter that is nearer to a bound is at it
DIVERGED = 1e6  # violation of the limits by a simulation that diverges


class DesignEvaluator:
    """Evaluator of commands for one design problem.

    It simulates experiments with the commands. Simulators, samples and prior matrices are computed at first use and
    kept. Commands are arrays (n_rows, n_channels, n) of n candidates on the rows of the problem.

    Parameters
    ----------
    problem
        The design problem.

    Attributes
    ----------
    problem
        The design problem.
    """

    def __init__(self, problem: DesignProblem) -> None:
        """Store the design problem. Each property is computed at its first access."""
        self.problem = problem

    @cached_property
    def prior(self) -> ParameterPrior:
        """Prior of the problem; without one, the default: uniform within 0.75 to 1.25 of the nominal values."""
        return self.problem.prior or default_prior(self.problem.model, self.problem.observed_parameters)

    @cached_property
    def prior_information(self) -> Array:
        """Prior information (q, q) about the parameters ``problem.free``, in their units.

        It holds the priors of nuisance parameters and the information of earlier logs. Without earlier logs it holds
        the priors of parameters whose value the bench or the user gave.
        """
        problem = self.problem
        nuisances = problem.free[len(problem.observed_parameters) :]
        return prior_matrix(problem.model, problem.observed_parameters, nuisances, self.prior)

    @cached_property
    def criterion(self) -> Criterion:
        """Optimality criterion of the parameters ``problem.chosen``, or of all observed parameters.

        Raises
        ------
        SeatrialError
            If the sensors do not observe one of the chosen parameters. The message names the reason if the value of the
            parameter is at a bound.
        """
        problem = self.problem
        chosen = problem.chosen or problem.observed_parameters
        for name in chosen:
            if name not in problem.observed_parameters:
                raise _unobserved_error(problem, name)
        return Criterion(
            problem.criterion,
            tuple(problem.free.index(n) for n in chosen),
            characteristic_steps(problem.model, problem.free),
        )

    @cached_property
    def experiments(self) -> Experiments:
        """Simulator of experiments, with the information about the parameters ``problem.free``.

        It has the model with its measurement noise scaled for the sample rates on the rows of the problem.
        """
        problem = self.problem
        model = problem.observed(problem.model)
        return Experiments(model, problem.free, problem.t, problem.every, process_noise=problem.process_noise)

    @cached_property
    def _inflations(self) -> Array:
        """Factors (q,) by which standard errors of fits exceed those by the information, for ``problem.free``.

        They are those of earlier logs; 1 for a parameter without one.
        """
        return np.array([self.prior.inflation.get(n, 1.0) for n in self.problem.free])

    def information(self, u: Array, values: Array | None = None) -> Array:
        """Return the information about the parameters ``problem.free`` that experiments give.

        The information is reduced by the inflation of the standard errors in earlier logs. Prior information is not
        included.

        Parameters
        ----------
        u
            Inputs of the model (n_rows, n_inputs, n), or (n_rows, n_inputs) for the same inputs in all experiments.
        values
            Parameter values (n, n_parameters), by default nominal.

        Returns
        -------
        Array (n, q, q)
            In the units of the parameters; NaN for an experiment that diverges.
        """
        found = self.experiments(u, values).information
        return np.asarray(found / np.outer(self._inflations, self._inflations))

    def samples(self, n: int, purpose: int) -> Array:
        """Return n parameter samples (n, n_parameters) from the prior.

        ``purpose`` selects the random stream: the same number gives the same samples for the same seed of the problem.
        """
        rng = np.random.default_rng([self.problem.seed, 10 + purpose])
        return self.prior.sample(self.experiments.model, n, rng)

    @cached_property
    def _robust_samples(self) -> Array:
        """Parameter samples (problem.robust, n_parameters) over which the criterion is averaged."""
        return self.samples(self.problem.robust, 1)

    def boats(self, n: int, purpose: int) -> Array:
        """Return n parameter samples (n, n_parameters) from the prior, each with its own random current.

        The currents are uniform in a disc with the radius ``problem.limits.current`` [m/s]. ``purpose`` selects the
        random stream. With a radius of 0 the samples keep the current of the model.

        Raises
        ------
        SeatrialError
            If the radius is not zero and the model has no current.
        """
        rng = np.random.default_rng([self.problem.seed, 40 + purpose])
        return in_current(self.experiments.model, self.samples(n, purpose), self.problem.limits.current, rng)

    @cached_property
    def track_extent(self) -> TrackExtent:
        """Simulator of the extent of tracks: the nominal boat, and 24 sampled boats with process noise.

        All boats start at the same place. The nominal boat has the current of the model, each sampled boat its own
        random current as in ``boats``.
        """
        boats = np.vstack([self.experiments.values, self.boats(N_TRACKS, 2)])
        return TrackExtent(self.problem.model, self.problem.t_whole, boats, [self.problem.seed, 30])

    def evaluate(self, command: Array) -> tuple[Array, Array]:
        """Return the criterion (n,) and the violation (n,) of commands (n_rows, n_channels, n).

        The violation is the relative excess over the limits, plus for a robust design the share of the parameter
        samples with a singular information matrix. It is 0 for an admissible command. At nominal values a singular
        information matrix adds nothing to it; the criterion is then ``SINGULAR`` (-1e9).
        """
        value, singular = self.mean_criterion(command)
        return value, self.violation(command) + singular

    def evaluate_above(self, command: Array, least: float) -> tuple[Array, Array]:
        """Return criterion (n,) and violation (n,) of commands, exact only for commands better than a merit.

        Parameters
        ----------
        command
            Commands (n_rows, n_channels, n).
        least
            Merit of the search: the criterion of an admissible command, or a large negative number that decreases with
            the violation. The caller only asks which commands exceed it.

        Returns
        -------
        tuple of Array
            As from ``evaluate``. Commands that cannot exceed the merit are not fully evaluated. If ``least`` is the
            merit of a violation, a command that violates a limit has the criterion ``SINGULAR`` (-1e9). Otherwise a
            command whose criterion does not exceed ``least``, or with singular samples, has a violation without that of
            the limits. Without a limit of area or speed, all commands are fully evaluated.
        """
        if not self.problem.limits.concern_the_track:
            return self.evaluate(command)
        value = np.full(command.shape[2], SINGULAR)
        if violates_constraint(least):  # every command within the limits is better
            violation = self.violation(command)
            kept = violation == 0.0
            if kept.any():
                value[kept], violation[kept] = self.mean_criterion(command[:, :, kept])
            return value, violation
        value, violation = self.mean_criterion(command)
        better = (value > least) & (violation == 0.0)
        if better.any():
            violation[better] = self.violation(command[:, :, better])
        return value, violation

    def mean_criterion(self, command: Array) -> tuple[Array, Array]:
        """Return the criterion of commands, for a robust design as a mean over the parameter samples.

        Parameters
        ----------
        command
            Commands (n_rows, n_channels, n).

        Returns
        -------
        value : Array (n,)
            Criterion at nominal values. For a robust design it is the mean over the samples with a regular information
            matrix. It is ``SINGULAR`` (-1e9) if no information matrix is regular.
        singular : Array (n,)
            Share of the samples with a singular information matrix, 0 to 1. It is always 0 for nominal values.
        """
        problem, boats = self.problem, self._robust_samples if self.problem.robust else None
        parts = []
        for some in self._slices(command, problem.t.size, len(boats) if boats is not None else 1):
            u = problem.actuation.inputs(some)
            if boats is None:
                parts.append((self.criterion_values(u), np.zeros(u.shape[2])))
                continue
            n, k = u.shape[2], len(boats)
            found = self.criterion_values(np.repeat(u, k, axis=2), np.tile(boats, (n, 1))).reshape(n, k)
            regular = found > SINGULAR
            mean = np.where(regular, found, 0.0).sum(axis=1) / np.maximum(regular.sum(axis=1), 1)
            parts.append((np.where(regular.any(axis=1), mean, SINGULAR), 1.0 - regular.mean(axis=1)))
        value, singular = (np.concatenate(part) for part in zip(*parts, strict=True))
        return value, singular

    def _slices(self, command: Array, n_rows: int, n_boats: int) -> Iterator[Array]:
        """Yield the commands (n_rows, n_channels, n) in slices along the last axis that fit into memory.

        The inputs of one slice for all ``n_boats`` boats have at most 200 MB (``MAX_INPUT_BYTES``), unless the slice
        has only one command. ``n_rows`` is the number of rows of the inputs.
        """
        n_channels = max(len(self.problem.model.inputs), command.shape[1])
        width = max(1, int(MAX_INPUT_BYTES / (8 * n_rows * n_channels * n_boats)))
        for first in range(0, command.shape[2], width):
            yield command[:, :, first : first + width]

    def criterion_values(self, u: Array, values: Array | None = None) -> Array:
        """Return the criterion (n,) of inputs, prior information included; ``SINGULAR`` (-1e9) if it is not finite.

        Parameters
        ----------
        u
            Inputs (n_rows, n_inputs, n) or (n_rows, n_inputs).
        values
            Parameter values (n, n_parameters), by default nominal.
        """
        return self.criterion(self.information(u, values) + self.prior_information)

    def violation(self, command: Array) -> Array:
        """Return the violation of the limits by commands (n_rows, n_channels, n).

        The violation (n,) is the sum of the relative excesses over both sides of the area, speed and energy: 0.1 means
        10 % too much of one of them. It is 0 if all limits are kept, and 1e6 (``DIVERGED``) or more if a simulation of
        the track diverges. Without a limit of area or speed, no track is simulated.
        """
        broken = np.zeros(command.shape[2])
        if self.problem.limits.energy is not None:
            broken = np.maximum(self.problem.actuation.energy(command) / self.problem.limits.energy - 1.0, 0.0)
        if not self.problem.limits.concern_the_track:
            return broken
        return broken + self._track_violation(*self.extents(command))

    def extents(self, command: Array) -> tuple[Array, Array]:
        """Return the minimum and the maximum (n, k) of k quantities over the whole mission and all boats.

        The quantities are ``experiments.extremes``: the states, and ``speed2``, the squared speed through the water
        [m2/s2], if the model has a speed. ``command``: commands (n_rows, n_channels, n).
        """
        problem = self.problem
        slices = self._slices(command, problem.t_whole.size, 1)
        parts = [self.track_extent(problem.whole_inputs(some)) for some in slices]
        low, high = (np.concatenate(side) for side in zip(*parts, strict=True))
        return low.min(axis=1), high.max(axis=1)

    def area_of(self, command: Array) -> Array | None:
        """Return the sides (north, east) [m] of the area that one command (n_rows, n_channels) needs.

        It holds the tracks of all sampled boats. None without a limit of area.
        """
        if self.problem.limits.area is None:
            return None
        low, high = self.extents(command[:, :, None])
        at = [self.experiments.extremes.index(name) for name in ("x", "y")]
        return np.asarray(high[0, at] - low[0, at])

    def area_corner(self, command: Array) -> Array | None:
        """Return the south-west corner (north, east) [m] of the area, relative to the start; None without an area.

        The area is centred on the extent of the tracks of one command (n_rows, n_channels), over all sampled boats.
        """
        if self.problem.limits.area is None:
            return None
        low, high = self.extents(command[:, :, None])
        at = [self.experiments.extremes.index(name) for name in ("x", "y")]
        return np.asarray((low[0, at] + high[0, at] - np.array(self.problem.limits.area)) / 2)

    def _track_violation(self, low: Array, high: Array) -> Array:
        """Return the summed relative excess (n,) over the limits of area and speed; ``DIVERGED`` if it is not finite.

        It is 0 within the limits, and a missing limit adds nothing. The extent to the north and east counts, not the
        place of the area. ``low`` and ``high`` are the minima and maxima (n, k) from ``extents``.

        Raises
        ------
        SeatrialError
            If the model has no position for a limit of area, or no speed for a limit of speed.
        """
        total = np.zeros(len(low))
        names, limits, model = self.experiments.extremes, self.problem.limits, self.problem.model
        if limits.area is not None:
            for name, side in zip(("x", "y"), limits.area, strict=True):
                if name not in names:
                    raise SeatrialError(
                        f"model {model.name} has no position {name}, so the limit --area cannot be checked; "
                        "leave it out"
                    )
                i = names.index(name)
                total += np.maximum((high[:, i] - low[:, i]) / side - 1.0, 0.0)
        if limits.speed is not None:
            if "speed2" not in names:
                raise SeatrialError(
                    f"model {model.name} has no surge speed, so the limit --max-speed cannot be checked; leave it out"
                )
            total += np.maximum(np.sqrt(high[:, names.index("speed2")]) / limits.speed - 1.0, 0.0)
        total[~np.isfinite(total)] = DIVERGED
        return total


def _unobserved_error(problem: DesignProblem, name: str) -> SeatrialError:
    """Return the error for a chosen parameter on which no output depends, or which the model does not have.

    At a bound, such as a dead zone of zero, the outputs do not depend on a parameter, although they do beside it.
    """
    model, choices = problem.model, ", ".join(problem.observed_parameters)
    parameter = next((p for p in model.parameters if p.name == name and p.free), None)
    if parameter is not None:
        size = parameter.prior[1] if parameter.prior is not None else 1.0
        for which, bound in zip(("lowest", "highest"), parameter.bounds, strict=True):
            if abs(parameter.value - bound) <= AT_BOUND * size:
                return SeatrialError(
                    f"{name!r} has its {which} possible value, {bound:g}, in model {model.name}: the outputs do not "
                    "depend on it there, so no mission can be designed for it; write the value that you expect in a "
                    f"copy of the model.toml (value of {name}), take a fit that found one, or choose from {choices}"
                )
    return SeatrialError(
        f"{name!r} cannot be estimated with model {model.name} from these sensors; choose from {choices}"
    )
