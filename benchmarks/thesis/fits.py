"""Experiments of the tables and their estimates. The data are simulated, or read from a log of a bench run."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.thesis import printed
from benchmarks.thesis.boat import Sailed, sail
from seatrial.daq.errors import SeatrialError
from seatrial.ident.characterisation.sensor_noise import NoiseFit, estimate_noise
from seatrial.ident.data.record import Channel, LogSegment, Record, build_record
from seatrial.ident.estimation.fitted_model import fit_nominal_model
from seatrial.ident.estimation.likelihood import FilterResult, Likelihood
from seatrial.ident.estimation.maximum_likelihood import EstimationOptions, Fit, fit
from seatrial.ident.estimation.output_error import SimulatedTrajectory, simulate
from seatrial.ident.estimation.stochastic_simulation import SampledInputs, simulate_stochastic
from seatrial.ident.model.structure import Model
from seatrial.ident.models.disturbances import sensor_bias
from seatrial.ident.models.horizontal import SENSORS, horizontal_model
from seatrial.ident.models.kinematic import kinematic_model
from seatrial.ident.models.surge import surge_model
from seatrial.ident.models.thruster import DELAY_STEP, thruster_model
from seatrial.ident.models.yaw import yaw_model
from seatrial.ident.numerics.linear_algebra import Array
from seatrial.ident.reporter import QUIET
from seatrial.ident.results.parts import ThrusterResult
from seatrial.ident.studies.cases import N_DELAYS, random_levels
from seatrial.ident.studies.monte_carlo import Case, make_record
from seatrial.ident.validation.prediction_errors import simulation_run


@dataclass(frozen=True)
class Both:
    """Estimates of one record by output error and by prediction error.

    Attributes
    ----------
    record : Record
        Simulated data.
    truth : mapping of str to float
        True values of the parameters.
    oe : Fit
        Estimate by output error, without process noise.
    pe : Fit
        Estimate by prediction error, with process noise.
    """

    record: Record
    truth: Mapping[str, float]
    oe: Fit
    pe: Fit

    @property
    def simulated(self) -> SimulatedTrajectory:
        """Prediction of the output-error model from the inputs alone."""
        return simulate(self.oe.model, self.record)

    @property
    def filtered(self) -> FilterResult:
        """Prediction of the prediction-error model one sample ahead."""
        return Likelihood(self.pe.model).filter(self.record, self.pe.record_values[0])


def both(case: Case, seed: int) -> Both:
    """Simulate a record of a case from rest, and estimate its parameters by output error and by prediction error.

    The fits start at 1.3 times the true values. ``seed`` selects the noise.
    """
    model = case.model
    rng, values = np.random.default_rng([seed, 3]), np.array([list(model.values.values())])
    _, y = simulate_stochastic(model, case.inputs, values, [rng], x0=np.zeros((1, len(model.states))))
    record = make_record(case, y[0], case.name)
    start = {p.name: 1.3 * p.value for p in model.parameters if p.free and p.transform == "log"}
    methods = (EstimationOptions(method="output-error"), EstimationOptions())
    return Both(record, model.values, *(fit(model, [record], m, start=start) for m in methods))


def yaw_experiment(seed: int) -> Both:
    """Return the estimates of table 3: a yaw moment in steps for 180 s, and the yaw rate of a gyro at 20 Hz.

    The true values are the paper's PE estimate.
    """
    t = np.arange(0.0, 180.0, 0.05)
    moment = random_levels(t, lambda rng: rng.uniform(-9.0, 9.0, 1), (4.0, 10.0), seed)
    model = yaw_model().with_values(printed.TABLE_3["PE"] | {"s_r": 0.02, "e_r": 0.01})
    return both(Case("yaw", model, SampledInputs.held(t, moment), {}), seed)


def surge_experiment(seed: int) -> Both:
    """Return the estimates of table 4: a surge force in steps for 180 s, and positions at 5 Hz.

    The true values are the paper's PE estimate, in which d_u is almost zero.
    """
    t = np.arange(0.0, 180.0, 0.2)
    force = random_levels(t, lambda rng: rng.uniform(-20.0, 75.0, 1), (6.0, 15.0), seed)
    model = surge_model().with_values(printed.TABLE_4["PE"] | {"s_u": 0.02, "e_x": 0.05})
    return both(Case("surge", model, SampledInputs.held(t, force), {}), seed)


def bench_experiment(seed: int) -> Both:
    """Return the estimates of table 2: a thruster with steps of growing size, then one chirp of each sign, in 90 s.

    Command, shaft speed and force are sampled at 80 Hz. The true values are the paper's estimates and a delay of 0.1 s.
    """
    t: Array = np.asarray(np.arange(round(90.0 / DELAY_STEP)) * DELAY_STEP)
    command = np.where(t < 50, np.ceil(t % 50 / 5) / 10 * (1 - 2 * (np.floor(t / 2.5) % 2)), 0.0)
    sweep = np.maximum(t - 50, 0.0) % 20
    wave = 0.5 - 0.4 * np.cos(2 * np.pi * (0.1 * sweep + 0.9 / 20 * sweep**2 / 2))
    command = np.where(t < 50, command, np.where(t < 70, wave, -wave))
    rows = [np.searchsorted(t, t - k * DELAY_STEP + 1e-9, side="right") - 1 for k in range(N_DELAYS)]
    u = np.column_stack([command[np.maximum(at, 0)] for at in rows])
    model = thruster_model(n_delays=N_DELAYS).with_values(printed.TABLE_2 | {"tau": 0.1})
    return both(Case("thruster", model, SampledInputs.held(t, u), {}), seed)


def bench_log(path: Path) -> tuple[dict[str, tuple[float, float]], str]:
    """Return the estimates of table 2 from a log of `seatrial bench`, and the name of the log.

    The estimates are pairs of value and standard error by parameter. A missing standard error is NaN.

    Raises
    ------
    SeatrialError
        If the log cannot be read or has no shaft speed.
    """
    from seatrial.ident.workflows.thruster import ThrusterRequest, characterise

    with tempfile.TemporaryDirectory() as folder:
        result = characterise(ThrusterRequest([path], Path(folder)), "", QUIET)
    if not isinstance(result, ThrusterResult):
        raise SeatrialError(f"{path}: has no shaft speed, which table 2 needs; give another log of a bench run")
    rows = {r.name: (r.value, float("nan") if r.se is None else r.se) for r in result.fit.parameters}
    return {n: rows[n] for n in printed.TABLE_2}, path.name


@dataclass(frozen=True)
class Plane:
    """Model of table 5 with its fit and its innovations on the mission.

    Attributes
    ----------
    fit : Fit
        Fit of the model.
    record : Record
        Data of the mission.
    run : FilterResult
        Result of the Kalman filter with the fitted parameters.
    """

    fit: Fit
    record: Record
    run: FilterResult

    def innovations(self, channel: str) -> tuple[Array, Array, Array]:
        """Return the times [s], the innovations and their predicted standard deviations of a channel, each (n,).

        Rows without a sample of the channel are left out. Raises ValueError if the model lacks the channel.
        """
        j = [o.name for o in self.fit.model.outputs].index(channel)
        good = np.isfinite(self.run.eps[:, j])
        return self.run.t[good], self.run.eps[good, j], np.sqrt(self.run.S[good, j])


def plane_experiment(seed: int, seconds: float = 400.0) -> tuple[Sailed, Plane, Plane]:
    """Return the mission of table 5, and the fits of 3DOF and of 6DOF K (measured attitude).

    The true values are the paper's estimate of 6DOF K. ``seconds`` is the duration of the mission.
    """
    sailed = sail(printed.TABLE_5["6DOF K"], seconds, seed)
    return sailed, plane(horizontal_model(), sailed), plane(kinematic_model(yaw=True), sailed)


def plane(model: Model, sailed: Sailed) -> Plane:
    """Fit a model to the mission, with process noise on its velocities as in the paper, and with sensor biases.

    Return it with its record and its filter result. ``model`` is a model without biases.
    """
    biased_sensors = [s.name for s in model.sensors if s.name in SENSORS]
    full = model + sensor_bias(biased_sensors)
    record = build_record(full, sailed.channels, name="mission", rate=20.0)
    found = fit(full, [record])
    return Plane(found, record, Likelihood(found.model).filter(record, found.record_values[0]))


@dataclass(frozen=True)
class Rest:
    """Noise of a sensor at rest.

    Attributes
    ----------
    channel : Channel
        Simulated measurement.
    truth : tuple of two floats
        True standard deviation of the white noise [unit], and true diffusion of the random walk [unit/sqrt(s)].
    found : NoiseFit
        Estimate of both.
    """

    channel: Channel
    truth: tuple[float, float]
    found: NoiseFit


def at_rest(seed: int) -> dict[str, Rest]:
    """Simulate sensors at rest and estimate their noise, for figures 4.1 and 4.2. Return them by channel.

    The channels of accelerometer [m/s2] and magnetometer [uT] have white noise and a random walk, and last 20 minutes
    at 50 Hz.
    """
    true = {"ax": (0.012, 2e-4), "ay": (0.010, 3e-4), "mx": (0.25, 0.004), "my": (0.22, 0.006), "mz": (0.30, 0.003)}
    rng, t = np.random.default_rng([seed, 4]), np.arange(0.0, 1200.0, 0.02)
    found = {}
    for name, (white, walk) in true.items():
        drift = np.cumsum(walk * np.sqrt(0.02) * rng.standard_normal(t.size))
        unit = "m/s2" if name.startswith("a") else "uT"
        channel = Channel(t, drift + white * rng.standard_normal(t.size), unit, name)
        found[name] = Rest(channel, (white, walk), estimate_noise(channel, name))
    return found


def predicted(estimates: Both) -> Array:
    """Return the outputs (n_rows, n_outputs) of the prediction-error model, simulated from the inputs of its record.

    ``estimates`` has the record and the fit. No measured output is used.
    """
    return simulation_run(estimates.pe.model, estimates.record, estimates.pe.record_values[0]).y


def with_forces(sailed: Sailed) -> Fit:
    """Return the fit of 3DOF with disturbance forces to the mission of table 5, as `seatrial ident vehicle` fits it."""
    return fit_nominal_model(horizontal_model(), [LogSegment("mission", sailed.channels)], []).fit
