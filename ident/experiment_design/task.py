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
from seatrial.ident.numerics import Array, breaks_a_constraint

GRID = 0.2  # s between rows of a search
REST_S = 5.0  # s before the steps: noise of the sensors, and the boat comes to rest
COAST_S = 10.0  # s after the last step, without thrust, until somebody takes the boat over
RATE = 10.0  # Hz, default rate of a sensor
PRIOR_HALFWIDTH = 0.25  # relative; default prior: uniform within 0.75 to 1.25 of the nominal values (thesis)
HELD = 200e6  # bytes of inputs at once
N_TRACKS = 24  # parameter samples whose tracks must keep to the limits
DIVERGED = 1e6  # violation
ESTIMATED = ParameterOrigin.ESTIMATED


@dataclass(frozen=True)
class DesignLimits:
    """Limits of a mission; None: no limit.

    Attributes:
        area: sides (north, east) [m] of a rectangle that holds the whole track, wherever in it the boat starts,
            heading north: the rest before the steps (``REST_S``) and the coasting after them (``COAST_S``), too.
        speed: through the water [m/s].
        energy: mean of ``|n|^3``, the share of full power.
        current: largest current [m/s], from any direction, that the track must allow for.
    """

    area: tuple[float, float] | None = None
    speed: float | None = None
    energy: float | None = None
    current: float = 0.0

    @property
    def bind(self) -> bool:
        """Whether there is any limit."""
        return self.energy is not None or self.concern_the_track

    @property
    def concern_the_track(self) -> bool:
        return self.area is not None or self.speed is not None


@dataclass(frozen=True)
class ParameterPrior:
    """Prior distribution of the parameters ``names``: uniform in a box about the values of the model (relative
    half-width
    ``box``), or normal with a covariance (k, k)."""

    names: tuple[str, ...]
    box: float = PRIOR_HALFWIDTH
    covariance: Array | None = None

    def sample(self, model: Model, n: int, rng: np.random.Generator) -> Array:
        """Samples (n, n_parameters), within the bounds of the parameters; positive parameters stay positive."""
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

    Attributes:
        chosen: parameters to estimate, of those that the sensors observe (default: all).
        rates: of the sensors [Hz], where they are given.
        belief: prior of the parameters; None: the default box.
        earlier: information (k, k) of earlier logs, by ``belief.names``.
        inflation: by parameter, factor by which the residuals of the earlier logs, being correlated, made its standard
            error larger than by the information; those of new logs will, too.
        validity: by signal, what the data of the model covered.
        fitted_rates: of the sensors [Hz], in the data of the model: of its rows, whose noise the model has.
        robust: parameter samples over which the criterion is averaged (0: nominal only; with D this is ELD optimality,
            Walter and Pronzato 1997, section 6.4).
        process_noise: information of prediction error, else of output error.
        grid: s between rows, no more than ``row_spacing`` allows; where a sensor's rate is another than its rows have,
            its noise is larger or smaller by the root of the ratio.
    """

    model: Model
    steps: StepInput
    criterion: Kind = "D"
    chosen: tuple[str, ...] = ()
    rates: Mapping[str, float] = field(default_factory=dict)
    limits: DesignLimits = field(default_factory=DesignLimits)
    slew: float = np.inf
    belief: ParameterPrior | None = None
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
        return np.asarray(np.arange(round(self.steps.duration / self.grid) + 1) * self.grid)

    @cached_property
    def t_whole(self) -> Array:
        """Times [s] of the whole mission: the rest before the steps, these, and the coasting after them."""
        return np.asarray(np.arange(sum(self._around) + self.t.size) * self.grid)

    @property
    def _around(self) -> tuple[int, int]:
        """Rows without thrust, before and after."""
        return round(REST_S / self.grid), round(COAST_S / self.grid)

    def whole_inputs(self, command: Array) -> Array:
        """The model's inputs (n_rows, n_inputs, n) at ``t_whole`` under commands (n_rows, n_channels, n) at ``t``."""
        before, after = (np.zeros((n, *command.shape[1:])) for n in self._around)
        whole = np.concatenate([before, command[:-1], np.zeros((1, *command.shape[1:])), after])
        return replace(self.actuation, t=self.t_whole).inputs(whole)

    @cached_property
    def actuation(self) -> ThrusterResponse:
        return ThrusterResponse(self.model, self.t, self.steps.n_max, self.slew)

    @property
    def every(self) -> dict[str, int]:
        """Rows between the samples of each sensor."""
        return {s.name: max(1, round(1.0 / (self.rate(s.name) * self.grid))) for s in self.model.sensors}

    def rate(self, sensor: str) -> float:
        return self.rates.get(sensor, self.fitted_rates.get(sensor, RATE))

    def observed(self, model: Model) -> Model:
        """The model with the measurement noise that its sensors have on the rows of this problem."""
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
    def learned(self) -> tuple[str, ...]:
        """Shared dynamic parameters that the sensors observe."""
        return self._visible(dynamic_parameters(self.model))

    @cached_property
    def free(self) -> tuple[str, ...]:
        """``learned`` and the observed per-record nuisance parameters."""
        return (*self.learned, *self._visible([p.name for p in self.model.parameters if p.free and p.per_record]))

    def _visible(self, names: Sequence[str]) -> tuple[str, ...]:
        """Parameters with non-zero information: those that some output depends on."""
        if not names:
            return ()
        u = self.actuation.inputs(self.commands(self.steps.random(4, np.random.default_rng(0))))
        information = Experiments(self.model, names, self.t, process_noise=False)(u).information
        found = np.diagonal(information, axis1=1, axis2=2) != 0  # NaN of what diverged is not zero either
        return tuple(n for k, n in enumerate(names) if found[:, k].any())

    @cached_property
    def prior(self) -> Array:
        """Prior information (q, q) by ``free``: priors of nuisance parameters and of what the bench or the user knows,
        or the information of earlier logs, which has these in it."""
        q = len(self.learned)
        prior = np.zeros((len(self.free), len(self.free)))
        prior[q:, q:] = prior_information([self.model.parameter(n) for n in self.free[q:]])
        if self.earlier is not None and self.belief is not None:
            known = [n for n in self.belief.names if n in self.learned]
            here = [self.learned.index(n) for n in known]
            there = [self.belief.names.index(n) for n in known]
            prior[np.ix_(here, here)] += self.earlier[np.ix_(there, there)]
        else:  # a thrust is known from the bench; no mission tells it
            of_learned = [self.model.parameter(n) for n in self.learned]
            given = np.array([p.provenance is not ESTIMATED for p in of_learned], dtype=float)
            prior[:q, :q] = prior_information(of_learned) * given
        return prior

    @cached_property
    def measure(self) -> Criterion:
        wanted = self.chosen or self.learned
        lost = [n for n in wanted if n not in self.learned]
        if lost:
            raise SeatrialError(
                f"{lost[0]!r} cannot be learned with model {self.model.name} from these sensors; "
                f"there is {', '.join(self.learned)}"
            )
        return Criterion(
            self.criterion, tuple(self.free.index(n) for n in wanted), characteristic_steps(self.model, self.free)
        )

    @cached_property
    def experiments(self) -> Experiments:
        return Experiments(self.observed(self.model), self.free, self.t, self.every, process_noise=self.process_noise)

    @cached_property
    def _inflations(self) -> Array:
        """By ``free``, those of the standard errors."""
        return np.array([self.inflation.get(n, 1.0) for n in self.free])

    def information(self, u: Array, values: Array | None = None) -> Array:
        """Information (n, q, q) by ``free`` that inputs give, as far as a fit may take it for such: divided by the
        inflation of the errors."""
        found = self.experiments(u, values).information
        return np.asarray(found / np.outer(self._inflations, self._inflations))

    @cached_property
    def belief_or_box(self) -> ParameterPrior:
        known = self.model.parameter
        return self.belief or ParameterPrior(tuple(n for n in self.learned if known(n).provenance is ESTIMATED))

    def samples(self, n: int, purpose: int) -> Array:
        """Parameters (n, n_parameters) drawn from what is believed."""
        rng = np.random.default_rng([self.seed, 10 + purpose])
        return self.belief_or_box.sample(self.experiments.model, n, rng)

    @cached_property
    def _robust_samples(self) -> Array:
        return self.samples(self.robust, 1)

    def boats(self, n: int, purpose: int) -> Array:
        """Parameter samples, each in a current of its own."""
        rng = np.random.default_rng([self.seed, 40 + purpose])
        return in_current(self.experiments.model, self.samples(n, purpose), self.limits.current, rng)

    @cached_property
    def reach(self) -> TrackExtent:
        """Extent of the track of the nominal boat and of sampled ones with process noise, all from the same start."""
        nominal = self.experiments.values
        return TrackExtent(self.model, self.t_whole, np.vstack([nominal, self.boats(N_TRACKS, 2)]), [self.seed, 30])

    def commands(self, z: Array) -> Array:
        """Commands (n_rows, n_channels, n) of search points."""
        return self.actuation.limited(*self.steps.unpack(z))

    def judge(self, command: Array) -> tuple[Array, Array]:
        """Criterion (n,) and violation (n,) of commands (n_rows, n_channels, n)."""
        value, singular = self.criterion_of(command)
        return value, self.broken(command) + singular

    def judge_above(self, command: Array, least: float) -> tuple[Array, Array]:
        """``judge`` for a search that compares with the merit ``least``: commands that cannot be better are judged by
        the limits alone or by the criterion alone."""
        if not self.limits.concern_the_track:
            return self.judge(command)
        value = np.full(command.shape[2], SINGULAR)
        if breaks_a_constraint(least):  # anything that keeps the limits is better, whatever its criterion
            violation = self.broken(command)
            kept = violation == 0.0
            if kept.any():
                value[kept], violation[kept] = self.criterion_of(command[:, :, kept])
            return value, violation
        value, violation = self.criterion_of(command)
        better = (value > least) & (violation == 0.0)
        if better.any():
            violation[better] = self.broken(command[:, :, better])
        return value, violation

    def criterion_of(self, command: Array) -> tuple[Array, Array]:
        """Criterion (n,) of commands (n_rows, n_channels, n), averaged over the samples of a robust design in which it
        is finite, and the share (n,) of the samples in which it is not."""
        boats = self._robust_samples if self.robust else None
        parts = []
        for some in self._slices(command, self.t.size, len(boats) if boats is not None else 1):
            u = self.actuation.inputs(some)
            if boats is None:
                parts.append((self.values(u), np.zeros(u.shape[2])))
                continue
            n, k = u.shape[2], len(boats)
            found = self.values(np.repeat(u, k, axis=2), np.tile(boats, (n, 1))).reshape(n, k)
            told = found > SINGULAR
            mean = np.where(told, found, 0.0).sum(axis=1) / np.maximum(told.sum(axis=1), 1)
            parts.append((np.where(told.any(axis=1), mean, SINGULAR), 1.0 - told.mean(axis=1)))
        value, singular = (np.concatenate(part) for part in zip(*parts, strict=True))
        return value, singular

    def _slices(self, command: Array, rows: int, boats: int) -> Iterator[Array]:
        """Commands (n_rows, n_channels, n) a few at a time: their inputs, for so many boats, stay below ``HELD``."""
        n_channels = max(len(self.model.inputs), command.shape[1])
        width = max(1, int(HELD / (8 * rows * n_channels * boats)))
        for first in range(0, command.shape[2], width):
            yield command[:, :, first : first + width]

    def values(self, u: Array, values: Array | None = None) -> Array:
        """The criterion (n,) of inputs (n_rows, n_inputs, n) or (n_rows, n_inputs), at parameter values (n,
        n_parameters) or the nominal ones."""
        return self.measure(self.information(u, values) + self.prior)

    def broken(self, command: Array) -> Array:
        """Violation (n,) of the limits: sum of the relative excesses; 0: all limits are kept."""
        broken = np.zeros(command.shape[2])
        if self.limits.energy is not None:
            broken = np.maximum(self.actuation.energy(command) / self.limits.energy - 1.0, 0.0)
        if not self.limits.concern_the_track:
            return broken
        return broken + self._violation(*self.extents(command))

    def extents(self, command: Array) -> tuple[Array, Array]:
        """Minimum and maximum (n, k) of ``experiments.extremes`` over all boats in the whole mission of commands
        (n_rows, n_channels, n)."""
        parts = [self.reach(self.whole_inputs(some)) for some in self._slices(command, self.t_whole.size, 1)]
        low, high = (np.concatenate(side) for side in zip(*parts, strict=True))
        return low.min(axis=1), high.max(axis=1)

    def corner(self, command: Array) -> Array | None:
        """South-west corner (2,) of the area relative to the start [m] that centres the extent of one command (n_rows,
        n_channels); None without an area."""
        if self.limits.area is None:
            return None
        low, high = self.extents(command[:, :, None])
        at = [self.experiments.extremes.index(name) for name in ("x", "y")]
        return np.asarray((low[0, at] + high[0, at] - np.array(self.limits.area)) / 2)

    def _violation(self, low: Array, high: Array) -> Array:
        """Relative excess (n,) over the limits of area and speed."""
        total = np.zeros(len(low))
        names = self.experiments.extremes
        if self.limits.area is not None:
            for name, side in zip(("x", "y"), self.limits.area, strict=True):
                if name not in names:
                    raise SeatrialError(f"model {self.model.name} has no position {name}: --area does not apply to it")
                i = names.index(name)
                total += np.maximum((high[:, i] - low[:, i]) / side - 1.0, 0.0)
        if self.limits.speed is not None:
            if "speed2" not in names:
                raise SeatrialError(f"model {self.model.name} has no surge speed: --max-speed does not apply to it")
            total += np.maximum(np.sqrt(high[:, names.index("speed2")]) / self.limits.speed - 1.0, 0.0)
        total[~np.isfinite(total)] = DIVERGED
        return total


def believed(saved: SavedModel) -> ParameterPrior:
    """Prior from a fitted model: its shared parameters with a standard error, with their correlation."""
    known = saved.covariance(dynamic_parameters(saved.model))
    return ParameterPrior(known.names, covariance=known.covariance)
