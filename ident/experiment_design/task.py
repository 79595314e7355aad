"""Design problem: model, parameters to estimate, input class, limits, and prior knowledge."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.ident.estimation import SavedModel, dynamic_parameters
from seatrial.ident.experiment_design.criteria import SINGULAR, Criterion, Kind, characteristic_steps
from seatrial.ident.experiment_design.excitation import StepInput, ThrusterResponse
from seatrial.ident.experiment_design.information import Experiments, prior_information
from seatrial.ident.experiment_design.track_extent import TrackExtent, in_current
from seatrial.ident.model import Model, ParameterOrigin
from seatrial.ident.numerics import Array, violates_constraint

GRID = 0.2  # s between rows of a search
REST_S = 5.0  # before the steps: the boat comes to rest, and the log shows the noise of the sensors
COAST_S = 10.0  # after the last step without thrust, until the operator takes over
RATE = 10.0  # Hz, default rate of a sensor
PRIOR_HALFWIDTH = 0.25  # relative; default prior: uniform within 0.75 to 1.25 of the nominal values (thesis)
MAX_INPUT_BYTES = 200e6  # of inputs in memory at once
N_TRACKS = 24  # parameter samples whose tracks must keep to the limits
DIVERGED = 1e6  # violation of the limits by a simulation that diverges
ESTIMATED = ParameterOrigin.ESTIMATED


@dataclass(frozen=True)
class DesignLimits:
    """Limits of a mission. None means no limit.

    Attributes
    ----------
    area
        Sides (north, east) [m] of a rectangle that holds the whole track, which starts with a heading of north. The
        start may lie anywhere in it. The track includes the rest before the steps (``REST_S``) and the coasting after
        them (``COAST_S``).
    speed
        Speed through the water [m/s].
    energy
        Mean of ``|n|^3``, the share of full power.
    current
        Largest current [m/s] from any direction for which the track must keep to the limits.
    """

    area: tuple[float, float] | None = None
    speed: float | None = None
    energy: float | None = None
    current: float = 0.0

    @property
    def bind(self) -> bool:
        """Return whether there is any limit."""
        return self.energy is not None or self.concern_the_track

    @property
    def concern_the_track(self) -> bool:
        """Return whether there is a limit of area or speed."""
        return self.area is not None or self.speed is not None


@dataclass(frozen=True)
class ParameterPrior:
    """Prior distribution of some parameters about their values in the model: uniform in a box, or normal."""

    names: tuple[str, ...]
    box: float = PRIOR_HALFWIDTH  # half-width of the uniform distribution over the value
    covariance: Array | None = None  # (k, k) of the normal distribution; None for the uniform distribution

    def sample(self, model: Model, n: int, rng: np.random.Generator) -> Array:
        """Return samples (n, n_parameters) of all parameters of the model.

        The samples are within the bounds of the parameters, and positive parameters stay positive.
        """
        index = [p.name for p in model.parameters]
        values = np.tile([p.value for p in model.parameters], (n, 1))
        columns = [index.index(name) for name in self.names]
        nominal = values[:, columns]
        if self.covariance is None:
            values[:, columns] = nominal * rng.uniform(1 - self.box, 1 + self.box, nominal.shape)
        elif columns:
            drawn = rng.multivariate_normal(nominal[0], self.covariance, n, method="eigh", check_valid="ignore")
            least = np.where(nominal > 0, 0.1 * nominal, -np.inf)
            values[:, columns] = np.maximum(drawn, least)
        bounds = np.array([model.parameter(name).bounds for name in self.names]).reshape(-1, 2).T
        values[:, columns] = np.clip(values[:, columns], *bounds)
        return values


@dataclass(frozen=True)
class DesignProblem:
    """Model, input class, criterion, limits and prior knowledge of a design.

    Attributes
    ----------
    model
        The model with nominal parameter values.
    steps
        Input class.
    criterion
        Optimality criterion.
    chosen
        Parameters to estimate. By default they are all that the sensors observe.
    rates
        Rates of sensors [Hz] that the user gives, by sensor.
    limits
        Limits of the mission.
    slew
        Largest rate of change of a command [1/s].
    prior_distribution
        Prior of the parameters. By default it is uniform within ``PRIOR_HALFWIDTH``.
    earlier : Array (k, k)
        Information of earlier logs about the parameters ``prior_distribution.names``.
    inflation
        Robust standard error over that by the information, by parameter, in earlier logs with correlated residuals.
        New logs are expected to have the same ratio.
    validity
        Range of each signal in the data of the model.
    fitted_rates
        Rates of the sensors [Hz] to which the noise parameters of the model refer.
    robust
        Number of parameter samples over which the criterion is averaged; 0 for nominal values only. With the criterion
        D the average is ELD optimality (Walter and Pronzato 1997, section 6.4).
    process_noise
        Whether the information is that of prediction error. Else it is that of output error.
    seed
        Seed of the search and of all samples.
    grid
        Interval between rows [s], at most that of ``row_spacing``. If a sensor cannot have its rate on the rows, its
        noise is scaled by the square root of the ratio.
    """

    model: Model
    steps: StepInput
    criterion: Kind = "D"
    chosen: tuple[str, ...] = ()
    rates: Mapping[str, float] = field(default_factory=dict)
    limits: DesignLimits = field(default_factory=DesignLimits)
    slew: float = np.inf
    prior_distribution: ParameterPrior | None = None
    earlier: Array | None = None
    inflation: Mapping[str, float] = field(default_factory=dict)
    validity: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    fitted_rates: Mapping[str, float] = field(default_factory=dict)
    robust: int = 0
    process_noise: bool = True
    seed: int = 1
    grid: float = GRID

    @cached_property
    def t(self) -> Array:
        """Times of the steps (n_rows,) [s]."""
        return np.asarray(np.arange(round(self.steps.duration / self.grid) + 1) * self.grid)

    @cached_property
    def t_whole(self) -> Array:
        """Times of the whole mission (n_rows,) [s]: rest, steps and coasting."""
        return np.asarray(np.arange(sum(self._around) + self.t.size) * self.grid)

    @property
    def _around(self) -> tuple[int, int]:
        """Number of rows without thrust before and after the steps."""
        return round(REST_S / self.grid), round(COAST_S / self.grid)

    def whole_inputs(self, command: Array) -> Array:
        """Return the inputs of the model over the whole mission.

        Parameters
        ----------
        command
            Commands (n_rows, n_channels, n) at the times ``t``.

        Returns
        -------
        Array (n_rows_whole, n_inputs, n)
            Inputs at the times ``t_whole``.
        """
        before, after = (np.zeros((n, *command.shape[1:])) for n in self._around)
        whole = np.concatenate([before, command[:-1], np.zeros((1, *command.shape[1:])), after])
        return replace(self.actuation, t=self.t_whole).inputs(whole)

    @cached_property
    def actuation(self) -> ThrusterResponse:
        """Response of the thrusters to commands at the times ``t``."""
        return ThrusterResponse(self.model, self.t, self.steps.n_max, self.slew)

    @property
    def every(self) -> dict[str, int]:
        """Number of rows between two samples of each sensor."""
        return {s.name: max(1, round(1.0 / (self.rate(s.name) * self.grid))) for s in self.model.sensors}

    def rate(self, sensor: str) -> float:
        """Return the rate of a sensor [Hz]: given, else that of the data of the model, else ``RATE``."""
        return self.rates.get(sensor, self.fitted_rates.get(sensor, RATE))

    def observed(self, model: Model) -> Model:
        """Return the model with its measurement noise scaled for the sample rates on the rows of this problem."""
        noise: dict[str, float] = {}
        for s in model.sensors:
            factor = np.sqrt(1.0 / (self.rate(s.name) * self.every[s.name] * self.grid))
            noise |= {o.noise: model.parameter(o.noise).value * float(factor) for o in s.outputs}
        return model.with_values(noise)

    @cached_property
    def finer(self) -> DesignProblem:
        """The same problem on rows at the rate of the fastest sensor."""
        most = max([self.rate(s.name) for s in self.model.sensors])
        return replace(self, grid=self.grid / max(1, round(most * self.grid)))

    @cached_property
    def observed_parameters(self) -> tuple[str, ...]:
        """Names of the shared dynamic parameters that the sensors observe."""
        return self._visible(dynamic_parameters(self.model))

    @cached_property
    def free(self) -> tuple[str, ...]:
        """Names of ``learned`` and of the per-record nuisance parameters that the sensors observe."""
        return (
            *self.observed_parameters,
            *self._visible([p.name for p in self.model.parameters if p.free and p.per_record]),
        )

    def _visible(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return the parameters with non-zero information, on which at least one output depends."""
        if not names:
            return ()
        u = self.actuation.inputs(self.commands(self.steps.random(4, np.random.default_rng(0))))
        information = Experiments(self.model, names, self.t, process_noise=False)(u).information
        found = np.diagonal(information, axis1=1, axis2=2) != 0  # NaN, if a simulation diverges, also counts
        return tuple(n for k, n in enumerate(names) if found[:, k].any())

    @cached_property
    def prior(self) -> Array:
        """Prior information (q, q) about the parameters ``free``.

        It has the priors of nuisance parameters, and the information of earlier logs. Without earlier logs it has the
        priors of parameters that the bench or the user gives. The information of earlier logs includes these priors.
        """
        q = len(self.observed_parameters)
        prior = np.zeros((len(self.free), len(self.free)))
        prior[q:, q:] = prior_information([self.model.parameter(n) for n in self.free[q:]])
        if self.earlier is not None and self.prior_distribution is not None:
            shared = [n for n in self.prior_distribution.names if n in self.observed_parameters]
            rows = [self.observed_parameters.index(n) for n in shared]
            earlier_rows = [self.prior_distribution.names.index(n) for n in shared]
            prior[np.ix_(rows, rows)] += self.earlier[np.ix_(earlier_rows, earlier_rows)]
        else:  # for example a thrust curve from the bench, which no mission can identify
            of_learned = [self.model.parameter(n) for n in self.observed_parameters]
            given = np.array([p.provenance is not ESTIMATED for p in of_learned], dtype=float)
            prior[:q, :q] = prior_information(of_learned) * given
        return prior

    @cached_property
    def measure(self) -> Criterion:
        """Criterion of the chosen parameters. Raises SeatrialError if one of them is not observed."""
        chosen = self.chosen or self.observed_parameters
        unobserved = [n for n in chosen if n not in self.observed_parameters]
        if unobserved:
            raise SeatrialError(
                f"{unobserved[0]!r} cannot be estimated with model {self.model.name} from these sensors; "
                f"choose from {', '.join(self.observed_parameters)}"
            )
        return Criterion(
            self.criterion, tuple(self.free.index(n) for n in chosen), characteristic_steps(self.model, self.free)
        )

    @cached_property
    def experiments(self) -> Experiments:
        """Simulated experiments with the information about ``free``."""
        return Experiments(self.observed(self.model), self.free, self.t, self.every, process_noise=self.process_noise)

    @cached_property
    def _inflations(self) -> Array:
        """Inflation of the standard errors (q,) of the parameters ``free``."""
        return np.array([self.inflation.get(n, 1.0) for n in self.free])

    def information(self, u: Array, values: Array | None = None) -> Array:
        """Return the information of inputs about ``free``, reduced by the inflation of the standard errors.

        Parameters
        ----------
        u
            Inputs (n_rows, n_inputs, n) or (n_rows, n_inputs).
        values
            Parameter values (n, n_parameters), by default nominal.

        Returns
        -------
        Array (n, q, q)
        """
        found = self.experiments(u, values).information
        return np.asarray(found / np.outer(self._inflations, self._inflations))

    @cached_property
    def belief_or_box(self) -> ParameterPrior:
        """Prior ``prior_distribution``; without it the default box of the observed parameters that are estimated."""
        known = self.model.parameter
        return self.prior_distribution or ParameterPrior(
            tuple(n for n in self.observed_parameters if known(n).provenance is ESTIMATED)
        )

    def samples(self, n: int, purpose: int) -> Array:
        """Return parameters (n, n_parameters) drawn from the prior; ``purpose`` selects the random stream."""
        rng = np.random.default_rng([self.seed, 10 + purpose])
        return self.belief_or_box.sample(self.experiments.model, n, rng)

    @cached_property
    def _robust_samples(self) -> Array:
        """Parameter samples (robust, n_parameters) over which the criterion is averaged."""
        return self.samples(self.robust, 1)

    def boats(self, n: int, purpose: int) -> Array:
        """Return parameters (n, n_parameters) drawn from the prior, each with a different current."""
        rng = np.random.default_rng([self.seed, 40 + purpose])
        return in_current(self.experiments.model, self.samples(n, purpose), self.limits.current, rng)

    @cached_property
    def track_extent(self) -> TrackExtent:
        """Track extent of the nominal boat and of sampled boats with process noise, all from the same start."""
        nominal = self.experiments.values
        return TrackExtent(self.model, self.t_whole, np.vstack([nominal, self.boats(N_TRACKS, 2)]), [self.seed, 30])

    def commands(self, z: Array) -> Array:
        """Return the commands (n_rows, n_channels, n) of search points z (n, size)."""
        return self.actuation.limited(*self.steps.unpack(z))

    def judge(self, command: Array) -> tuple[Array, Array]:
        """Return criterion (n,) and violation of the limits (n,) of commands (n_rows, n_channels, n)."""
        value, singular = self.criterion_of(command)
        return value, self.violation(command) + singular

    def judge_above(self, command: Array, least: float) -> tuple[Array, Array]:
        """Return the same as `judge` for a search that only asks whether commands are better than the merit ``least``.

        For commands that cannot be better, only the limits or only the criterion are evaluated.
        """
        if not self.limits.concern_the_track:
            return self.judge(command)
        value = np.full(command.shape[2], SINGULAR)
        if violates_constraint(least):  # every command within the limits is better
            violation = self.violation(command)
            kept = violation == 0.0
            if kept.any():
                value[kept], violation[kept] = self.criterion_of(command[:, :, kept])
            return value, violation
        value, violation = self.criterion_of(command)
        better = (value > least) & (violation == 0.0)
        if better.any():
            violation[better] = self.violation(command[:, :, better])
        return value, violation

    def criterion_of(self, command: Array) -> tuple[Array, Array]:
        """Return the criterion of commands (n_rows, n_channels, n).

        Returns
        -------
        value : Array (n,)
            Criterion, for a robust design the mean over the parameter samples with a regular information matrix.
        singular : Array (n,)
            Share of the samples with a singular information matrix.
        """
        boats = self._robust_samples if self.robust else None
        parts = []
        for some in self._slices(command, self.t.size, len(boats) if boats is not None else 1):
            u = self.actuation.inputs(some)
            if boats is None:
                parts.append((self.values(u), np.zeros(u.shape[2])))
                continue
            n, k = u.shape[2], len(boats)
            found = self.values(np.repeat(u, k, axis=2), np.tile(boats, (n, 1))).reshape(n, k)
            regular = found > SINGULAR
            mean = np.where(regular, found, 0.0).sum(axis=1) / np.maximum(regular.sum(axis=1), 1)
            parts.append((np.where(regular.any(axis=1), mean, SINGULAR), 1.0 - regular.mean(axis=1)))
        value, singular = (np.concatenate(part) for part in zip(*parts, strict=True))
        return value, singular

    def _slices(self, command: Array, rows: int, boats: int) -> Iterator[Array]:
        """Yield commands (n_rows, n_channels, n) in slices whose inputs for all boats fit `MAX_INPUT_BYTES`."""
        n_channels = max(len(self.model.inputs), command.shape[1])
        width = max(1, int(MAX_INPUT_BYTES / (8 * rows * n_channels * boats)))
        for first in range(0, command.shape[2], width):
            yield command[:, :, first : first + width]

    def values(self, u: Array, values: Array | None = None) -> Array:
        """Return the criterion (n,) of inputs, prior information included.

        Parameters
        ----------
        u
            Inputs (n_rows, n_inputs, n) or (n_rows, n_inputs).
        values
            Parameter values (n, n_parameters), by default nominal.
        """
        return self.measure(self.information(u, values) + self.prior)

    def violation(self, command: Array) -> Array:
        """Return the violation of the limits by commands (n_rows, n_channels, n).

        The violation (n,) is the sum of the relative excesses over all limits; 0 if all limits are kept.
        """
        broken = np.zeros(command.shape[2])
        if self.limits.energy is not None:
            broken = np.maximum(self.actuation.energy(command) / self.limits.energy - 1.0, 0.0)
        if not self.limits.concern_the_track:
            return broken
        return broken + self._violation(*self.extents(command))

    def extents(self, command: Array) -> tuple[Array, Array]:
        """Return minimum and maximum (n, k) of ``experiments.extremes`` over the whole mission and all boats.

        ``command``: commands (n_rows, n_channels, n).
        """
        parts = [self.track_extent(self.whole_inputs(some)) for some in self._slices(command, self.t_whole.size, 1)]
        low, high = (np.concatenate(side) for side in zip(*parts, strict=True))
        return low.min(axis=1), high.max(axis=1)

    def corner(self, command: Array) -> Array | None:
        """Return the south-west corner (2,) of the area relative to the start [m]; None without an area.

        The area is centred on the extent of the track of one command (n_rows, n_channels).
        """
        if self.limits.area is None:
            return None
        low, high = self.extents(command[:, :, None])
        at = [self.experiments.extremes.index(name) for name in ("x", "y")]
        return np.asarray((low[0, at] + high[0, at] - np.array(self.limits.area)) / 2)

    def _violation(self, low: Array, high: Array) -> Array:
        """Return the relative excess (n,) over the limits of area and speed, by minimum and maximum (n, k)."""
        total = np.zeros(len(low))
        names = self.experiments.extremes
        if self.limits.area is not None:
            for name, side in zip(("x", "y"), self.limits.area, strict=True):
                if name not in names:
                    raise SeatrialError(
                        f"model {self.model.name} has no position {name}, so --area cannot be kept; leave it out"
                    )
                i = names.index(name)
                total += np.maximum((high[:, i] - low[:, i]) / side - 1.0, 0.0)
        if self.limits.speed is not None:
            if "speed2" not in names:
                raise SeatrialError(
                    f"model {self.model.name} has no surge speed, so --max-speed cannot be kept; leave it out"
                )
            total += np.maximum(np.sqrt(high[:, names.index("speed2")]) / self.limits.speed - 1.0, 0.0)
        total[~np.isfinite(total)] = DIVERGED
        return total


def prior_from_fit(saved: SavedModel) -> ParameterPrior:
    """Return the prior from a fitted model: the covariance of its shared parameters with a standard error."""
    fitted = saved.covariance(dynamic_parameters(saved.model))
    return ParameterPrior(fitted.names, covariance=fitted.covariance)
