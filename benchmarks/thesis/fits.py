"""The experiments behind the tables: simulated or, for the bench, read from a log; and their estimates."""

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
from seatrial.ident.estimation.output_error import Simulation, simulate
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
    """One record, estimated without and with process noise."""

    record: Record
    truth: Mapping[str, float]
    oe: Fit
    pe: Fit

    @property
    def simulated(self) -> Simulation:
        """What output error predicts: from the inputs alone."""
        return simulate(self.oe.model, self.record)

    @property
    def filtered(self) -> FilterResult:
        """What prediction error predicts: one sample ahead."""
        return Likelihood(self.pe.model).filter(self.record, self.pe.record_values[0])


def both(case: Case, seed: int) -> Both:
    """A record of a case, from rest, and its two estimates."""
    model = case.model
    rng, values = np.random.default_rng([seed, 3]), np.array([list(model.values.values())])
    _, y = simulate_stochastic(model, case.inputs, values, [rng], x0=np.zeros((1, len(model.states))))
    record = make_record(case, y[0], case.name)
    start = {p.name: 1.3 * p.value for p in model.parameters if p.free and p.transform == "log"}
    methods = (EstimationOptions(method="output-error"), EstimationOptions())
    return Both(record, model.values, *(fit(model, [record], m, start=start) for m in methods))


def yaw_experiment(seed: int) -> Both:
    """Table 3: differential thrust in steps, gyro; truth: the paper's PE estimate."""
    t = np.arange(0.0, 180.0, 0.05)
    moment = random_levels(t, lambda rng: rng.uniform(-9.0, 9.0, 1), (4.0, 10.0), seed)
    model = yaw_model().with_values(printed.TABLE_3["PE"] | {"s_r": 0.02, "e_r": 0.01})
    return both(Case("yaw", model, SampledInputs.held(t, moment), {}), seed)


def surge_experiment(seed: int) -> Both:
    """Table 4: common thrust in steps, position; truth: the paper's PE estimate, whose d_u is next to nothing."""
    t = np.arange(0.0, 180.0, 0.2)
    force = random_levels(t, lambda rng: rng.uniform(-20.0, 75.0, 1), (6.0, 15.0), seed)
    model = surge_model().with_values(printed.TABLE_4["PE"] | {"s_u": 0.02, "e_x": 0.05})
    return both(Case("surge", model, SampledInputs.held(t, force), {}), seed)


def bench_experiment(seed: int) -> Both:
    """Table 2: steps that grow, then a chirp of each sign; command, shaft speed and force at 80 Hz."""
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
    """Estimates and standard errors from a log of `seatrial bench`, and the name of the log."""
    from seatrial.ident.workflows.thruster import ThrusterRequest, characterise

    with tempfile.TemporaryDirectory() as folder:
        result = characterise(ThrusterRequest([path], Path(folder)), "", QUIET)
    if not isinstance(result, ThrusterResult):
        raise SeatrialError(f"{path}: has no shaft speed, so the tables of the thruster cannot be made of it")
    rows = {r.name: (r.value, float("nan") if r.se is None else r.se) for r in result.fit.parameters}
    return {n: rows[n] for n in printed.TABLE_2}, path.name


@dataclass(frozen=True)
class Plane:
    """One model of table 5 on the mission: its estimate and innovations."""

    fit: Fit
    record: Record
    run: FilterResult

    def innovations(self, channel: str) -> tuple[Array, Array, Array]:
        """t, e and its standard deviation (n,) of a channel."""
        j = [o.name for o in self.fit.model.outputs].index(channel)
        good = np.isfinite(self.run.eps[:, j])
        return self.run.t[good], self.run.eps[good, j], np.sqrt(self.run.S[good, j])


def plane_experiment(seed: int, seconds: float = 400.0) -> tuple[Sailed, Plane, Plane]:
    """Table 5: three degrees of freedom, and measured attitude in place of yaw, roll and pitch; truth: 6DOF K."""
    sailed = sail(printed.TABLE_5["6DOF K"], seconds, seed)
    return sailed, plane(horizontal_model(), sailed), plane(kinematic_model(yaw=True), sailed)


def plane(model: Model, sailed: Sailed) -> Plane:
    """The fit of a model with process noise on its velocities, as in the paper, and offsets of the sensors."""
    known = [s.name for s in model.sensors if s.name in SENSORS]
    full = model + sensor_bias(known)
    record = build_record(full, sailed.channels, name="mission", rate=20.0)
    found = fit(full, [record])
    return Plane(found, record, Likelihood(found.model).filter(record, found.record_values[0]))


@dataclass(frozen=True)
class Rest:
    """A sensor at rest: what was measured, the truth (white, walk) and the estimate."""

    channel: Channel
    truth: tuple[float, float]
    found: NoiseFit


def at_rest(seed: int) -> dict[str, Rest]:
    """Figures 4.1 and 4.2: accelerometer [m/s2] and magnetometer [uT], 20 minutes at 50 Hz, white noise and walk."""
    true = {"ax": (0.012, 2e-4), "ay": (0.010, 3e-4), "mx": (0.25, 0.004), "my": (0.22, 0.006), "mz": (0.30, 0.003)}
    rng, t = np.random.default_rng([seed, 4]), np.arange(0.0, 1200.0, 0.02)
    found = {}
    for name, (white, walk) in true.items():
        drift = np.cumsum(walk * np.sqrt(0.02) * rng.standard_normal(t.size))
        unit = "m/s2" if name.startswith("a") else "uT"
        channel = Channel(t, drift + white * rng.standard_normal(t.size), unit, name)
        found[name] = Rest(channel, (white, walk), estimate_noise(channel, name))
    return found


def predicted(one: Both) -> Array:
    """Free prediction of a bench run from its commands (n_rows, n_outputs)."""
    return simulation_run(one.pe.model, one.record, one.pe.record_values[0]).y


def with_forces(sailed: Sailed) -> Fit:
    """Table 5 once more, three degrees of freedom as `seatrial ident vehicle` has them: with disturbance forces."""
    return fit_nominal_model(horizontal_model(), [LogSegment("mission", sailed.channels)], []).fit
