"""Design problem: model, input class, optimality criterion, limits of the mission, and prior of the parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from seatrial.ident.estimation import dynamic_parameters
from seatrial.ident.experiment_design.criteria import Kind
from seatrial.ident.experiment_design.excitation import SHAFT_POLE, StepInput, ThrusterResponse
from seatrial.ident.experiment_design.information import Experiments
from seatrial.ident.experiment_design.prior import ParameterPrior
from seatrial.ident.model import Model
from seatrial.ident.numerics import Array

GRID = 0.2  # s between rows of a search
REST_S = 5.0  # before the steps: the boat comes to rest, and the log shows the noise of the sensors
COAST_S = 10.0  # after the last step without thrust, until the operator takes over
RATE = 10.0  # Hz, default rate of a sensor


@dataclass(frozen=True)
class DesignLimits:
    """Limits of a mission. None means no limit.

    Attributes
    ----------
    area
        Sides (north, east) [m] of a rectangle that holds the whole track, which starts with a heading of north. The
        start may lie anywhere in it. The track includes the rest of 5 s before the steps (``REST_S``) and the coasting
        of 10 s after them (``COAST_S``).
    speed
        Speed through the water [m/s].
    energy
        Mean of ``|n|^3`` over time and thrusters, with commands n from -1 to 1. It is the share of full power.
    current
        Largest current [m/s] from any direction for which the track must keep to the limits; 0: no current.
    """

    area: tuple[float, float] | None = None
    speed: float | None = None
    energy: float | None = None
    current: float = 0.0

    @property
    def bind(self) -> bool:
        """Whether at least one limit (area, speed or energy) is set, so that commands must be checked."""
        return self.energy is not None or self.concern_the_track

    @property
    def concern_the_track(self) -> bool:
        """Whether there is a limit of area or speed, which only a simulation of the tracks can check."""
        return self.area is not None or self.speed is not None


@dataclass(frozen=True)
class DesignProblem:
    """Model, input class, criterion, limits and prior of an experiment design.

    Arrays of commands and inputs have one row per time of ``t``: the rows are ``grid`` seconds apart, from the start of
    the steps to their end.

    Attributes
    ----------
    model
        The model with nominal parameter values.
    steps
        Input class: number of steps, of channels, and the durations.
    criterion
        Kind of the optimality criterion: D, A, E or Ds.
    chosen
        Names of the parameters of the criterion. Empty: all shared dynamic parameters that the sensors observe.
    rates
        Rates of sensors [Hz] that the user gives, by sensor.
    limits
        Limits of the mission.
    slew
        Largest rate of change of a command [1/s].
    prior
        Prior of the parameters. None: uniform within 0.75 to 1.25 of the nominal values, without earlier logs; given
        values (such as a thrust from the bench) stay fixed.
    validity
        Range (minimum, maximum) of each input and state in the logs to which the model was fitted, by name; empty if
        unknown.
    fitted_rates
        Rates of the sensors [Hz] to which the noise parameters of the model refer, by sensor; empty if unknown.
    robust
        Number of parameter samples over which the criterion is averaged; 0 for nominal values only. With the criterion
        D the average is ELD optimality (Walter and Pronzato 1997, section 6.4).
    process_noise
        Whether the information is that of prediction error: of the innovations of a filter, with process noise. Else it
        is that of output error: of a simulation without process noise.
    seed
        Seed of the search and of all samples.
    grid
        Interval between rows [s]. It must be short enough for the fastest state of the model (`row_spacing`). If a
        sensor cannot have its rate on the rows, its noise is scaled by the square root of the ratio of its rate on the
        rows to its rate.
    pole
        Pole of the lag between command and shaft speed [1/s]; not used if the model has the shafts.
    """

    model: Model
    steps: StepInput
    criterion: Kind = "D"
    chosen: tuple[str, ...] = ()
    rates: Mapping[str, float] = field(default_factory=dict)
    limits: DesignLimits = field(default_factory=DesignLimits)
    slew: float = np.inf
    prior: ParameterPrior | None = None
    validity: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    fitted_rates: Mapping[str, float] = field(default_factory=dict)
    robust: int = 0
    process_noise: bool = True
    seed: int = 1
    grid: float = GRID
    pole: float = SHAFT_POLE

    @cached_property
    def t(self) -> Array:
        """Times of the rows of the steps (n_rows,) [s]; 0 is the start of the first step."""
        return np.asarray(np.arange(round(self.steps.duration / self.grid) + 1) * self.grid)

    @cached_property
    def t_whole(self) -> Array:
        """Times of the whole mission (n_rows_whole,) [s]; 0 is the start of the rest before the steps.

        The mission is rest (5 s), steps and coasting (10 s).
        """
        return np.asarray(np.arange(sum(self._rest_and_coasting_rows) + self.t.size) * self.grid)

    @property
    def _rest_and_coasting_rows(self) -> tuple[int, int]:
        """Number of rows at rest before the steps, and number of rows of coasting after them."""
        return round(REST_S / self.grid), round(COAST_S / self.grid)

    def whole_inputs(self, command: Array) -> Array:
        """Return the inputs of the model over the whole mission: rest, steps and coasting.

        Parameters
        ----------
        command
            Commands (n_rows, n_channels, n) of n missions at the times ``t``. Commands at rest and in coasting are
            zero. The last row, at which the coasting starts, is replaced by zero too.

        Returns
        -------
        Array (n_rows_whole, n_inputs, n)
            Inputs of the n missions at the times ``t_whole``, with the lag of the shafts. If the model has the shaft
            speeds as states, the inputs are the commands, without a lag.
        """
        before, after = (np.zeros((n, *command.shape[1:])) for n in self._rest_and_coasting_rows)
        whole = np.concatenate([before, command[:-1], np.zeros((1, *command.shape[1:])), after])
        return replace(self.actuation, t=self.t_whole).inputs(whole)

    @cached_property
    def actuation(self) -> ThrusterResponse:
        """Response of the thrusters to commands at the times ``t``."""
        return ThrusterResponse(self.model, self.t, self.steps.n_max, self.slew, self.pole)

    def commands(self, z: Array) -> Array:
        """Return the commands (n_rows, n_channels, n) of search points z (n, size), with the slew limit.

        A search point holds the levels (commands, -1 to 1) and the relative durations of the steps, as `StepInput`
        describes.
        """
        return self.actuation.limited(*self.steps.unpack(z))

    @property
    def every(self) -> dict[str, int]:
        """Number of rows from one sample of a sensor to its next sample, by sensor name.

        It is the interval of the sensor over that of the rows, rounded to a whole number, and at least 1.
        """
        return {s.name: max(1, round(1.0 / (self.rate(s.name) * self.grid))) for s in self.model.sensors}

    def rate(self, sensor: str) -> float:
        """Return the rate of a sensor [Hz].

        It is the rate that the user gives, else the rate in the data of the model, else 10 Hz (``RATE``).
        """
        return self.rates.get(sensor, self.fitted_rates.get(sensor, RATE))

    def observed(self, model: Model) -> Model:
        """Return a model with its measurement noise scaled for the sample rates on the rows of this problem.

        A sensor whose interval is not a whole number of rows is simulated at another rate. Its noise standard deviation
        is multiplied by the square root of the simulated rate over the rate of the sensor, so that it gives the same
        information in a second.
        """
        noise: dict[str, float] = {}
        for s in model.sensors:
            factor = np.sqrt(1.0 / (self.rate(s.name) * self.every[s.name] * self.grid))
            noise |= {o.noise: model.parameter(o.noise).value * float(factor) for o in s.outputs}
        return model.with_values(noise)

    @cached_property
    def finer(self) -> DesignProblem:
        """The same problem on rows about as frequent as the samples of the fastest sensor, or more frequent.

        The new ``grid`` is the old one divided by the rate of the fastest sensor times the old one, rounded to a whole
        number of at least 1. The grid of ``steps`` is unchanged.
        """
        most = max([self.rate(s.name) for s in self.model.sensors])
        return replace(self, grid=self.grid / max(1, round(most * self.grid)))

    @cached_property
    def observed_parameters(self) -> tuple[str, ...]:
        """Names of the shared dynamic parameters that the sensors observe, in the order of the model."""
        return self._observed_among(dynamic_parameters(self.model))

    @cached_property
    def free(self) -> tuple[str, ...]:
        """Names of the q parameters of information matrices.

        They are ``observed_parameters``, and then the free per-record nuisance parameters that the sensors observe.
        """
        return (
            *self.observed_parameters,
            *self._observed_among([p.name for p in self.model.parameters if p.free and p.per_record]),
        )

    def _observed_among(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return those of the parameters on which at least one output depends, in the order of ``names``.

        Four random step sequences, always the same, are simulated without process noise. A parameter is observed if its
        information is not zero in at least one of them. Information that is NaN, because a simulation diverges, counts
        as not zero.
        """
        if not names:
            return ()
        u = self.actuation.inputs(self.commands(self.steps.random(4, np.random.default_rng(0))))
        information = Experiments(self.model, names, self.t, process_noise=False)(u).information
        found = np.diagonal(information, axis1=1, axis2=2) != 0  # NaN, if a simulation diverges, also counts
        return tuple(n for k, n in enumerate(names) if found[:, k].any())
