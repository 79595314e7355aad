"""Cases of ``seatrial ident study`` (Monte Carlo studies of the estimator): missions and true parameter values.

Built-in cases have step sequences as in section 5 of the paper (docs/thesis.md), and the boat of its Table 5.
User-defined cases are a fitted model.toml, or a ``Case`` of a Python file. This module also repeats a designed mission,
and compares the estimation errors with those that the design predicted.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.ident.characterisation import noise_model
from seatrial.ident.data import TIME_INPUT
from seatrial.ident.estimation import EstimationOptions, SampledInputs, SavedModel, load_model
from seatrial.ident.experiment_design import (
    GRID,
    SHAFT_POLE,
    Design,
    DesignProblem,
    StepInput,
    copy_spacing,
    design,
    divided_spacing,
)
from seatrial.ident.model import INF, Model
from seatrial.ident.models import (
    DELAY_STEP,
    TABLE_5_3DOF,
    check_user_model,
    horizontal_model,
    kinematic_model,
    load_object,
    surge_model,
    thruster_model,
    yaw_model,
)
from seatrial.ident.numerics import Array, chi2_ppf, first_order_lag, normal_ppf
from seatrial.ident.studies.monte_carlo import Case, run_replicates

MISSION_SEED = 20  # the mission is the same for all replicates
# Table 5, 3 DOF: the identified boat. The estimates of d_u and d_vv of Table 1 would be at their bound of zero.
HULL = TABLE_5_3DOF
N_DELAYS = round(0.2 / DELAY_STEP) + 1  # up to twice the true delay


def random_levels(
    t: Array, levels: Callable[[np.random.Generator], Array], hold: tuple[float, float], seed: int
) -> Array:
    """Return a random step sequence for the inputs of a mission (n_rows, n_inputs).

    All inputs change their levels at the same times.

    Parameters
    ----------
    t : Array (n_rows,)
        Times of the rows [s].
    levels
        Function of a random generator that draws one level of each input (n_inputs,).
    hold
        Shortest and longest time for which levels are held [s]; a time is drawn uniformly between them.
    seed
        Seed of the sequence.
    """
    rng = np.random.default_rng(seed)
    u, until = np.zeros((t.size, len(levels(np.random.default_rng(0))))), 0.0
    while until < t[-1]:
        u[t >= until - 1e-9] = levels(rng)
        until += rng.uniform(*hold)
    return u


def _shaft_speeds(command: Array, step: float) -> Array:
    """Return the normalised shaft speeds (n_rows, n) that follow from commands (n_rows, n), from rest.

    A command is held from one row to the next, ``step`` [s] later. The shaft is a first-order lag.
    """
    return first_order_lag(command, 1.0 / SHAFT_POLE, step)


def surge_case(seconds: float = 300.0) -> Case:
    """Return the study case (mission and model) of straight motion: forward and reverse thrust in steps.

    The mission lasts ``seconds`` [s], and the position is sampled at 10 Hz. The true values are those of the boat of
    Table 5 of the paper (docs/thesis.md).
    """
    t = _row_times(seconds, 0.1)
    force = random_levels(t, lambda rng: rng.uniform(-30.0, 80.0, 1), (5.0, 15.0), MISSION_SEED)
    model = _model_at(surge_model(), HULL | {"s_u": 0.02, "e_x": 0.05})
    return Case(
        "surge", model, SampledInputs.held(t, force), {}, f"{seconds:g} s, thrust in steps of 5-15 s, position 10 Hz"
    )


def yaw_case(seconds: float = 300.0) -> Case:
    """Return the study case (mission and model) of pure rotation: yaw moment in steps, gyro at 20 Hz.

    The mission lasts ``seconds`` [s]. The true values are those of the boat of Table 5 of the paper (docs/thesis.md).
    """
    t = _row_times(seconds, 0.05)
    moment = random_levels(t, lambda rng: rng.uniform(-12.0, 12.0, 1), (2.0, 8.0), MISSION_SEED)
    model = _model_at(yaw_model(), HULL | {"s_r": 0.02, "e_r": 0.01})
    return Case("yaw", model, SampledInputs.held(t, moment), {}, f"{seconds:g} s, moment in steps of 2-8 s, gyro 20 Hz")


def horizontal_case(seconds: float = 400.0) -> Case:
    """Return the study case (mission and model) of surge, sway and yaw: both thrusters in steps, for ``seconds`` [s].

    Heading, gyro and accelerometers are sampled at 10 Hz, position and velocity at 5 Hz. The current is unknown. The
    true values are those of the boat of Table 5 of the paper (docs/thesis.md).
    """
    t = _row_times(seconds, 0.1)
    n = _shaft_speeds(random_levels(t, lambda rng: rng.uniform(-0.5, 1.0, 2), (3.0, 10.0), MISSION_SEED), 0.1)
    model = _model_at(horizontal_model(), HULL | {"s_u": 0.02, "s_v": 0.02, "s_r": 0.01})
    return Case(
        "horizontal",
        model,
        SampledInputs.linear(t, n),
        {"position": 2, "ground_velocity": 2},
        f"{seconds:g} s, both thrusters in steps of 3-10 s, AHRS 10 Hz, GNSS 5 Hz, unknown current",
    )


def thruster_case(seconds: float = 100.0) -> Case:
    """Return the study case (mission and model) of a thruster on its bench: random steps for ``seconds`` [s].

    Command, shaft speed and force are sampled at 80 Hz. The delay from command to shaft is 0.1 s.
    """
    t = _row_times(seconds, DELAY_STEP)  # with this step the delayed commands change at rows
    command = random_levels(t, lambda rng: rng.uniform(-1.0, 1.0, 1), (1.0, 4.0), MISSION_SEED)[:, 0]
    whole = [np.searchsorted(t, t - k * DELAY_STEP + 1e-9, side="right") - 1 for k in range(N_DELAYS)]
    u = np.column_stack([command[np.maximum(at, 0)] for at in whole])
    model = thruster_model(n_delays=N_DELAYS).with_values({"tau": 0.1, "s_n": 0.02, "e_n": 0.005})
    return Case(
        "thruster", model, SampledInputs.held(t, u), {}, f"{seconds:g} s, command in steps of 1-4 s, all at 80 Hz"
    )


def kinematic_case(seconds: float = 400.0) -> Case:
    """Return the study case of surge and sway, with measured attitude and body rates as inputs (`kinematic_model`).

    The model has no yaw equation, because the heading and the yaw rate are among these inputs. The mission lasts
    ``seconds`` [s], with both thrusters in steps. The boat rolls by 3 and pitches by 2 degrees (amplitudes).
    Accelerometers are sampled at 10 Hz, position and velocity at 5 Hz.
    """
    t = _row_times(seconds, 0.1)
    n = _shaft_speeds(random_levels(t, lambda rng: rng.uniform(-0.5, 1.0, 2), (3.0, 10.0), MISSION_SEED), 0.1)
    model = _model_at(kinematic_model(), HULL | {"s_u": 0.02, "s_v": 0.02})
    inputs = SampledInputs.linear(t, np.column_stack([n, simulated_attitude(t, heading_under_thrust(t, n))]))
    return Case(
        "kinematic",
        model,
        inputs,
        {"position": 2, "ground_velocity": 2},
        f"{seconds:g} s, both thrusters in steps of 3-10 s, attitude and accelerometers 10 Hz, GNSS 5 Hz, "
        "unknown current",
    )


def heading_under_thrust(t: Array, n: Array) -> Array:
    """Simulate the heading (n_rows,) [rad] of the boat of the built-in cases under thrust, from heading 0 and rest.

    It is the yaw equation without noise, integrated by Euler's method. It only provides a plausible measured heading.

    Parameters
    ----------
    t : Array (n_rows,)
        Times [s].
    n : Array (n_rows, 2)
        Normalised shaft speeds of the left and the right thruster, -1 to 1.
    """
    model = horizontal_model()
    force = model.values["c1"] * n * np.abs(n) + model.values["c2"] * n**2
    moment = force @ [-model.values["y_left"], -model.values["y_right"]]
    psi, r = np.zeros(t.size), 0.0
    for k, step in enumerate(np.diff(t)):
        psi[k + 1] = psi[k] + step * r
        r += step * (moment[k] - HULL["d_r"] * r - HULL["d_rr"] * abs(r) * r) / HULL["m_r"]
    return psi


def simulated_attitude(t: Array, psi: Array) -> Array:
    """Return roll, pitch, heading [rad] and body rates p, q, r [rad/s] of a rolling boat, Array (n_rows, 6).

    Roll is a sine of amplitude 0.052 rad and period 2.3 s, pitch one of 0.035 rad and 3.1 s. The body rates follow from
    the angles by Fossen 2011, eq. 2.27.

    Parameters
    ----------
    t : Array (n_rows,)
        Times [s].
    psi : Array (n_rows,)
        Heading [rad].
    """
    phi, theta = 0.052 * np.sin(2 * np.pi * t / 2.3), 0.035 * np.sin(2 * np.pi * t / 3.1)
    d_phi, d_theta, d_psi = (np.gradient(angle, t) for angle in (phi, theta, psi))
    rates = (
        d_phi - np.sin(theta) * d_psi,
        np.cos(phi) * d_theta + np.sin(phi) * np.cos(theta) * d_psi,
        np.cos(phi) * np.cos(theta) * d_psi - np.sin(phi) * d_theta,
    )
    return np.column_stack([phi, theta, psi, *rates])


def noise_case(seconds: float = 300.0) -> Case:
    """Return the study case of a sensor at rest: one axis at 20 Hz for ``seconds`` [s].

    Its noise is white noise plus a random walk. `seatrial ident noise` fits the same model. Restricted maximum
    likelihood is not used.
    """
    t = _row_times(seconds, 0.05)
    model = noise_model(1e-3).with_values({"white": 1.0, "walk": 0.3})
    return Case(
        "noise", model, SampledInputs.held(t, np.empty((t.size, 0))), {}, f"{seconds:g} s at rest, 20 Hz", reml=False
    )


def optimal_design_case(seconds: float = 300.0) -> Case:
    """Design an optimal mission of ``seconds`` [s] for the nine parameters of the hull, and return it as a case.

    The boat is that of Table 1 of the paper (docs/thesis.md), without current: masses, moment of inertia and damping.
    The case tests whether fits reach the standard errors that the design predicts.
    """
    rates = {"position": 5.0, "ground_velocity": 5.0}
    problem = DesignProblem(
        horizontal_model(current=False), StepInput(round(seconds / 5.0), 2, seconds, 1.0, GRID), rates=rates
    )
    case = designed_case(design(problem, evaluations=2000))
    return replace(case, about=f"{seconds:g} s, designed steps of at least 1 s, AHRS 10 Hz, GNSS 5 Hz, no current")


def _row_times(seconds: float, step: float) -> Array:
    """Return the times of the rows (n_rows,) [s], from 0 to ``seconds`` in steps of ``step`` [s].

    The last time is the whole multiple of ``step`` nearest to ``seconds``.
    """
    return np.asarray(np.arange(round(seconds / step) + 1) * step)


def _model_at(model: Model, values: Mapping[str, float]) -> Model:
    """Return the model at given parameter values, with the second-order filter mean that `ident vehicle` uses.

    Values of parameters that the model lacks are ignored. Parameters without a value keep that of the model.
    """
    return replace(model.with_values({n: v for n, v in values.items() if n in model.values}), second_order=True)


CASES: dict[str, Callable[..., Case]] = {
    "surge": surge_case,
    "yaw": yaw_case,
    "horizontal": horizontal_case,
    "kinematic": kinematic_case,
    "thruster": thruster_case,
    "noise": noise_case,
    "designed": optimal_design_case,
}
SENSOR_INTERVAL_S = 0.1  # s, default sample interval of sensors if the file has no rate; that of GNSS is twice as long
HOLD = (3.0, 10.0)  # s, shortest and longest time of a level
GNSS = ("position", "ground_velocity")
SECONDS = 400.0  # default length of a mission
BATCH = 25  # replicates simulated at once
MAX_ERROR = 8.0  # predicted standard errors from the truth; a fit with a larger error stopped at another maximum


def make_case(
    name: str,
    truth: Mapping[str, float] | None = None,
    free: Sequence[str] = (),
    seconds: float | None = None,
    *,
    bounded: bool = True,
    reml: bool | None = None,
    mean_order: Literal[1, 2] | None = None,
) -> Case:
    """Return a case of a Monte Carlo study (mission, and model at the true values) from the options of the command.

    Parameters
    ----------
    name
        Name of a built-in case, or a file (``model.toml`` or ``FILE.py:NAME``).
    truth
        True values that replace those of the case, by name of the parameter.
    free
        Names of the parameters to estimate. Empty: all free parameters of the model.
    seconds
        Length of the mission [s], by default that of the case.
    bounded
        Whether parameters keep their bounds. With False, parameters that are not estimated as logarithms have none, so
        that damping may be estimated below zero.
    reml
        Whether to use restricted maximum likelihood. None: as the commands do, or as the file was fitted.
    mean_order
        Order of the filter mean: 1, or 2 with the curvature of the model. None: as the commands use it, or as the file
        was fitted.

    Returns
    -------
    Case
        Mission, and model at the true values.

    Raises
    ------
    SeatrialError
        If there is no such case or no such parameter, if a true value is outside the bounds of its parameter, or as
        `case_from_file`.
    """
    if is_file(name):
        case = case_from_file(name, seconds, MISSION_SEED)
    elif name not in CASES:
        names = ", ".join(CASES)
        raise SeatrialError(f"no study of {name!r}: there are {names}, a model.toml, or FILE.py:NAME of a Case")
    else:
        case = CASES[name](**({} if seconds is None else {"seconds": seconds}))
    try:
        case = case.with_truth(truth or {})
        case = replace(case, model=case.model.with_free(free)) if free else case
    except (KeyError, ValueError) as problem:
        raise SeatrialError(f"{name}: {problem.args[0]}; correct --truth or --free") from problem
    if reml is not None:
        case = replace(case, reml=reml)
    case = replace(case, model=EstimationOptions(mean_order=mean_order).with_mean_order(case.model))
    if bounded:
        return case
    unbounded = [replace(p, bounds=(-INF, INF)) for p in case.model.parameters if p.transform == "none"]
    return replace(case, model=case.model.replace_parameters(*unbounded))


def is_file(source: str) -> bool:
    """Return whether ``source``, the argument MODEL of the command, names a file: ``NAME.toml`` or ``FILE.py:NAME``.

    Any text that ends in ``.toml`` or contains a colon does. The file need not exist.
    """
    return source.endswith(".toml") or ":" in source


def case_from_file(source: str, seconds: float | None, seed: int) -> Case:
    """Return a user-defined case from a file: a fitted model, or a ``Case`` object in a Python file.

    Parameters
    ----------
    source
        ``model.toml``: the inputs are random levels within the ranges that the data of the fit covered, and the case is
        estimated as the model was fitted. ``FILE.py:NAME``: a ``Case``, which is estimated as `ident vehicle` does. The
        Python file is run.
    seconds
        Length of the mission [s], only for a model.toml. None or 0: 400 s.
    seed
        Seed of the mission, only for a model.toml.

    Raises
    ------
    SeatrialError
        If there is no such file, if the object is no ``Case``, if no mission can be made from the model, or if
        ``seconds`` is given for a ``Case``.
    """
    if source.endswith(".toml"):
        path = Path(source)
        if not path.is_file():
            raise SeatrialError(f"{source}: no such file; correct the path of the model")
        saved = load_model(path)
        case = _case_of_fitted_model(saved, source, seconds or SECONDS, seed)
        return _with_file_hash(replace(case, reml=saved.reml), path)
    file, _, name = source.rpartition(":")
    case = load_object(source)
    if isinstance(case, Model):
        raise SeatrialError(
            f"{file}: {name} is a Model without a mission; "
            "give a seatrial.ident.studies.monte_carlo.Case, which has both"
        )
    if not isinstance(case, Case):
        raise SeatrialError(
            f"{file}: {name} is a {type(case).__name__}, not a seatrial.ident.studies.monte_carlo.Case; name a Case"
        )
    if seconds is not None:
        raise SeatrialError(f"--seconds: the length of {name} is set in {file}; leave the option out")
    check_user_model(case.model, Path(file))
    return _with_file_hash(
        replace(case, model=replace(case.model, second_order=True)), Path(file)
    )  # as `ident vehicle` does


def _with_file_hash(case: Case, path: Path) -> Case:
    """Return the case with a hash of the file at ``path`` in the source of its model.

    The source is part of the identity of a study, so that a changed file starts a new study.
    """
    digest = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    return replace(case, model=replace(case.model, source=f"{case.model.source} {digest}"))


def _case_of_fitted_model(saved: SavedModel, source: str, seconds: float, seed: int) -> Case:
    """Return a case of a fitted model, with a mission of random input levels within the ranges of its estimation data.

    Sensors have the rates of the file, or 10 Hz (GNSS 5 Hz) if it has none. Inputs that are linear between rows are
    lagged as a shaft would be. Delayed copies of an input follow from this input. The time input is the time since the
    start.

    Parameters
    ----------
    saved, source
        Fitted model, and its file for messages.
    seconds
        Length of the mission [s].
    seed
        Seed of the levels.

    Raises
    ------
    SeatrialError
        If the file has no range for an input.
    """
    model, ranges = saved.model, saved.validity
    default = {s.name: (0.5 if s.name in GNSS else 1.0) / SENSOR_INTERVAL_S for s in model.sensors}
    rates = {name: saved.rates.get(name, hz) for name, hz in default.items()}
    step = _row_interval(model, max(rates.values()))
    t = _row_times(seconds, step)
    rng = np.random.default_rng(seed)
    u = np.empty((t.size, len(model.inputs)))
    for j, signal in enumerate(model.inputs):
        if signal.name == TIME_INPUT:
            u[:, j] = t
        elif signal.tap:
            continue
        elif signal.name not in ranges:
            raise SeatrialError(
                f"{source}: no range of the input {signal.name!r} under [validity], so no mission can be generated; "
                "write a Case in a Python file instead (page Run a Monte Carlo study of the documentation)"
            )
        else:
            levels = _held_random_levels(t, *ranges[signal.name], rng)
            u[:, j] = _lagged_levels(levels, step) if signal.hold == "linear" else levels
    names = [i.name for i in model.inputs]
    for j, signal in enumerate(model.inputs):
        if signal.tap:  # delayed copy; before the start it has the first value
            then = np.clip(np.arange(t.size) - round(signal.delay / step), 0, t.size - 1)
            u[:, j] = u[then, names.index(signal.tap_of)]
    u_next = u.copy()
    for j, signal in enumerate(model.inputs):
        if signal.hold == "linear":
            u_next[:-1, j] = u[1:, j]
    every = {name: max(round(1.0 / (hz * step)), 1) for name, hz in rates.items()}
    sampled = ", ".join(f"{name} {1.0 / (k * step):.3g} Hz" for name, k in every.items())
    about = f"{seconds:g} s, inputs in steps of 3-10 s within the fitted ranges, {sampled}"
    return Case(f"{model.name}-{Path(source).parent.name or 'own'}", model, SampledInputs(t, u, u_next), every, about)


def _held_random_levels(t: Array, low: float, high: float, rng: np.random.Generator) -> Array:
    """Return one input (n_rows,) of random levels between ``low`` and ``high``, each held for 3 to 10 s.

    ``t`` (n_rows,) are the times of the rows [s].
    """
    out, until = np.empty(t.size), 0.0
    while until <= t[-1]:
        out[t >= until - 1e-9] = rng.uniform(low, high)
        until += rng.uniform(*HOLD)
    return out


def _row_interval(model: Model, fastest: float) -> float:
    """Return the time between the rows of a simulated mission [s], at most 0.1 s.

    It is short enough for the model and for the fastest sensor, whose rate is ``fastest`` [Hz]. A whole number of
    intervals makes up the smallest delay of the model's delayed inputs; otherwise rounding would hide the delay.
    """
    return divided_spacing(copy_spacing(model, SENSOR_INTERVAL_S), min(model.max_step, 1.05 / fastest))


def _lagged_levels(levels: Array, step: float) -> Array:
    """Return shaft speeds or thrusts (n_rows,) that follow levels (n_rows,) with the first-order lag of a shaft.

    They start in steady state at the first level. ``step`` is the time between rows [s].
    """
    return first_order_lag(levels, 1.0 / SHAFT_POLE, step, start="steady")


@dataclass(frozen=True)
class RepeatStatistics:
    """Errors of one parameter over simulated repeats of a designed mission, against those that the design predicted.

    Attributes
    ----------
    name
        Name of the parameter.
    predicted
        Standard error that the design predicted, in the unit of the parameter.
    n
        Number of converged fits.
    ratio, interval
        Standard deviation of the estimates over the predicted one, and its 95 % interval under normality.
    coverage
        Share of the estimates within 1.96 predicted standard errors of the truth.
    outliers
        Number of estimates at least 8 predicted standard errors from the truth: those fits stopped at another maximum.
        They are left out of the ratio and included in the coverage.
    """

    name: str
    predicted: float
    n: int
    ratio: float
    interval: tuple[float, float]
    coverage: float
    outliers: int


def designed_case(designed: Design, name: str = "designed") -> Case:
    """Return a designed mission as a case of a Monte Carlo study with this name, estimated as `ident vehicle` does.

    The rows are those of ``designed.problem.finer``, about as frequent as the samples of the fastest sensor, or more
    frequent. No parameter without a transform is bounded, because a bound, for example zero for damping, makes the
    errors one-sided.
    """
    fine = designed.problem.finer
    unbounded = [replace(p, bounds=(-INF, INF)) for p in fine.model.parameters if p.transform == "none"]
    u = fine.actuation.inputs(designed.command_on(fine)[:, :, None])[:, :, 0]
    model = replace(fine.observed(fine.model.replace_parameters(*unbounded)), second_order=True)
    return Case(name, model, SampledInputs.linear(fine.t, u), fine.every)


def repeat_design(made: Design, n: int, seed: int) -> list[RepeatStatistics]:
    """Simulate a designed mission with process and measurement noise and fit it, n times.

    The result shows whether fits reach the standard errors that the design predicted.

    Parameters
    ----------
    made
        The design; its inputs must be linear between rows.
    n
        Number of repeats.
    seed
        Seed of the repeats.

    Returns
    -------
    list of RepeatStatistics
        Errors of each parameter that the sensors observe. Fits that failed or did not converge are left out.
    """
    case = designed_case(made)
    rows = [row for k in range(0, n, BATCH) for row in run_replicates(case, range(k, min(k + BATCH, n)), seed)]
    good = [row for row in rows if row.get("converged")]
    return [
        _repeat_statistics(made, name, np.array([row["d"][name] for row in good]))
        for name in made.problem.observed_parameters
    ]


def _repeat_statistics(made: Design, name: str, d: Array) -> RepeatStatistics:
    """Compare the errors of one parameter over the repeats of a design with the error that the design predicted.

    Parameters
    ----------
    made
        The design.
    name
        Name of the parameter.
    d : Array (n,)
        Errors (estimate minus truth) in the coordinate of the estimator, for example the logarithm of a positive
        parameter. With fewer than two regular ones (below 8 predicted standard errors) the ratio is NaN.
    """
    p, predicted = made.problem.model.parameter(name), made.predicted[name]
    z = d * p.slope(p.value) / predicted  # d is in the estimator's coordinate
    regular = np.abs(z) < MAX_ERROR
    n = int(regular.sum())
    low, high = np.sqrt(chi2_ppf([0.025, 0.975], n - 1) / (n - 1))
    ratio = float(np.std(z[regular], ddof=1))
    return RepeatStatistics(
        name,
        predicted,
        len(z),
        ratio,
        (ratio / float(high), ratio / float(low)),
        float(np.mean(np.abs(z) < normal_ppf(0.975))),
        int((~regular).sum()),
    )
