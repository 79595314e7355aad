"""Characterisation of a thruster from bench logs: its model fitted by maximum likelihood.

Initial values come from the steps of the command in the log. Delay and time constant are found by grid search, thrust
coefficients by least squares.

The dead zone is the range of commands around zero that do not turn the shaft. Its end is the parameter ``d``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.ident.characterisation.thrust_curve import MIN_SAMPLES, REVERSED_LOAD_CELL, clearly_falls
from seatrial.ident.checks import check_shafts, invalidates_fit
from seatrial.ident.data import Channel, LoadedLog, LogSegment, Record
from seatrial.ident.estimation import EstimationOptions, Fit, Likelihood, SearchSettings, fit
from seatrial.ident.model import (
    Model,
    Parameter,
    ParameterOrigin,
    command_of,
    commanded_thrusters,
    shaft_speed_of,
)
from seatrial.ident.models import START_POLES, delay_step, delayed_channels, pace_with_copy_at, thruster_model
from seatrial.ident.numerics import Array, LagData, fit_first_order_lag

THRUSTER_RATE = 50.0  # Hz, rows of a record with load cell and shaft speed
GRID_STEP = 0.05  # s, step of the delays in the grid search for initial values, and of the command in it
MAX_DELAY = 4.8  # s, largest delay in the grid search
DEAD_ZONES = tuple(0.0025 * k for k in range(81))  # of full command: values of d in the grid search
WAYS = (1.0, -1.0)  # directions of a shaft: forward, reverse
LEAST_SPEED = 0.05  # of full speed; smaller speeds may be noise
WITHOUT_ERRORS = SearchSettings(robust_errors=False)  # for fits that another fit follows
N_SEARCHES = 3  # searches over the dead zone, each with the other parameters of the fit before


def fit_with_delay_on_grid(
    model: Model, records: list[Record], make_records: Callable[[Model], list[Record]], options: EstimationOptions
) -> tuple[Fit, list[Record]]:
    """Fit a thruster model, then fit it again with delayed copies of the command, one of which has the fitted delay.

    A thruster model has copies of the command at fixed delays as inputs. A delay between two of them is an
    interpolation, which the second fit avoids.

    Parameters
    ----------
    model
        Thruster model.
    records
        Records of the bench runs for this model.
    make_records
        Function of a thruster model that returns the records of the same runs, with the delayed copies of that model.
    options
        Options of the estimation.

    Returns
    -------
    tuple
        The last fit, with ``options`` stored, and its records. If the fitted delay is at most half of the spacing of
        the copies, there is no second fit, and the records are the given ones.

    Notes
    -----
    Both fits maximise the plain likelihood. With restricted likelihood (REML) in the options, a last fit starts from
    its maximum.
    """
    plain = replace(options, reml=False)
    fitted = fit_thruster(model, records, plain, WITHOUT_ERRORS)
    step = pace_with_copy_at(fitted.model.values["tau"], delay_step(model))
    if step:
        exact = thruster_model(step, force="thrust" in model.provides)
        records = make_records(exact)
        values = {n: v for n, v in fitted.model.values.items() if n in exact.values}
        kept = [fitted.model.parameter(n) for n in ("d", "c2") if n in values]  # d was freed, c2 may be fixed
        kept += [p for p in fitted.model.parameters if p.name != "tau" and _is_given(p)]
        model = exact.with_values(values).replace_parameters(*kept)
        if _is_given(tau := fitted.model.parameter("tau")):  # its upper bound is that of the new copies
            model = model.replace_parameters(model.parameter("tau").known(tau.value, 0.0, tau.origin))
        fitted = fit(model, records, plain, WITHOUT_ERRORS if options.reml else None)
    fitted = _fit_restricted(fitted, records) if options.reml else fitted if step else fit(fitted.model, records, plain)
    return replace(fitted, options=options), records


def _is_given(p: Parameter) -> bool:
    """Return whether the user has fixed a parameter of a thruster model."""
    return p.origin is ParameterOrigin.GIVEN and not p.free


def _fit_restricted(plain: Fit, records: Sequence[Record]) -> Fit:
    """Fit the model by restricted likelihood (REML), from the estimates of the fit ``plain`` by plain likelihood.

    Iterations, evaluations and CPU time of the result are the sums of both fits. If the second fit did not converge,
    the message is its own; otherwise it is that of ``plain``.
    """
    found = fit(plain.model, records, EstimationOptions(reml=True))
    return replace(
        found,
        iterations=plain.iterations + found.iterations,
        evaluations=plain.evaluations + found.evaluations,
        cpu_seconds=plain.cpu_seconds + found.cpu_seconds,
        message=plain.message if found.converged else found.message,
    )


def fit_thruster(
    model: Model, records: Sequence[Record], options: EstimationOptions, settings: SearchSettings | None = None
) -> Fit:
    """Fit a thruster model from least-squares initial values, with a grid search of the end ``d`` of the dead zone.

    Only samples with commands near ``d`` inform the likelihood about it, so that a gradient search may not find it. The
    grid search and the fit of all parameters are repeated, at most three times, until ``d`` changes by less than 0.005.

    Parameters
    ----------
    model
        Thruster model. If it has a force and the shaft did not turn in both directions (`directions`), the thrust
        coefficients c1 and c2 cannot be distinguished, and c2 is fixed at 0.
    records
        Records of the bench runs.
    options
        Options of the first fit. Later fits, after a grid search, have default options (no REML).
    settings
        Settings of all fits; by default those of a single fit.

    Returns
    -------
    Fit
        The last fit. ``d`` is free in it, unless the user has fixed it.
    """
    one_way = "thrust" in model.provides and len(directions(records)) < len(WAYS)
    if one_way and not any(_is_given(model.parameter(c)) for c in ("c1", "c2")):
        model = model.replace_parameters(model.parameter("c2").at(0.0).fixed())
    guess = {n: x for n, x in first_guess(records, model).items() if model.parameter(n).free}
    if "tau" in guess:
        guess["tau"] = min(guess["tau"], 0.95 * model.parameter("tau").bounds[1])
    fitted = fit(model, records, options, settings, start=guess)
    if _is_given(model.parameter("d")):
        return fitted
    at, found = [p.name for p in model.parameters].index("d"), -1.0
    for _ in range(N_SEARCHES):
        likelihood, values = Likelihood(fitted.model), fitted.record_values

        def log_likelihood(d: float, likelihood: Likelihood = likelihood, values: Array = values) -> float:
            """Return the log-likelihood of all records with the end of the dead zone at ``d`` (share of full command).

            The other parameters have the values of the last fit.
            """
            tried = values.copy()
            tried[:, at] = d
            return sum(likelihood.value(r, v) for r, v in zip(records, tried, strict=True))

        before, found = found, max(DEAD_ZONES, key=log_likelihood)
        if abs(found - before) < 2 * DEAD_ZONES[1]:
            break
        model = fitted.model.replace_parameters(fitted.model.parameter("d").at(found).freed())
        fitted = fit(model, records, settings=settings)
    return fitted


def directions(records: Sequence[Record]) -> tuple[float, ...]:
    """Return the directions in which the shaft turned: 1 (forward) first, then -1 (reverse); empty if it was at rest.

    A direction counts if the measured shaft speed (first output of the records) has at least 20 samples above 5 % of
    full speed in it, over all records.
    """
    n = np.concatenate([r.y[:, 0] for r in records])
    return tuple(direction for direction in WAYS if np.count_nonzero(direction * n > LEAST_SPEED) >= MIN_SAMPLES)


def largest_speeds(n: Array) -> dict[float, float]:
    """Return the largest measured speed of a shaft in each direction, up to which its thrust was measured.

    Parameters
    ----------
    n : Array (n_samples,)
        Measured normalised shaft speeds.

    Returns
    -------
    dict of float
        Speed by direction: 1 (forward), -1 (reverse). It is that which 20 samples exceed or reach, so that single
        outliers do not count; 0 for a direction in which the shaft did not turn.
    """
    known = n[np.isfinite(n)]
    if known.size < MIN_SAMPLES:
        return dict.fromkeys(WAYS, 0.0)
    return {way: max(float(np.partition(way * known, -MIN_SAMPLES)[-MIN_SAMPLES]), 0.0) for way in WAYS}


def steady_thrust(fitted: Fit, n: Array) -> tuple[Array, Array]:
    """Return the steady thrust ``c1 n|n| + c2 n^2`` and its standard errors.

    Parameters
    ----------
    fitted
        Fit of a thruster model with a force.
    n : Array (n_samples,)
        Normalised shaft speeds, -1 to 1.

    Returns
    -------
    tuple of Array (n_samples,)
        Thrust [N], and its standard errors [N] from the covariance of those of c1 and c2 that were estimated. The
        errors are NaN if the data do not determine the coefficients.
    """
    B = np.column_stack([n * np.abs(n), n * n])
    force = B @ [fitted.estimate(c)[0] for c in ("c1", "c2")]
    free = [k for k, c in enumerate(("c1", "c2")) if c in fitted.names]  # each of both may be fixed
    at, B = [fitted.names.index(("c1", "c2")[k]) for k in free], B[:, free]
    variance = np.einsum("ij,jk,ik->i", B, fitted.covariance[np.ix_(at, at)], B)
    return force, np.sqrt(np.where(variance >= 0.0, variance, np.nan))


def first_guess(records: Sequence[Record], model: Model) -> dict[str, float]:
    """Return initial values of the parameters of a thruster model from the records of bench runs, by name.

    They are the delay ``tau`` [s] and the pole ``a`` [1/s] of the shaft. For a model with a force they are also the
    thrust coefficients ``c1`` (at least 0.1 N) and, if it is free, ``c2`` [N], and the offset ``bias`` [N] of the load
    cell. These follow from a linear regression of the force on functions of the measured shaft speed, interpolated to
    the times of the force.
    """
    tau, a = shaft_guess(records)
    guess = {"tau": tau, "a": a}
    if "thrust" not in model.provides:
        return guess
    rows = []
    for r in records:
        seen = np.isfinite(r.y[:, 1])
        n = np.interp(r.t[seen], r.t[np.isfinite(r.y[:, 0])], r.y[np.isfinite(r.y[:, 0]), 0])
        rows.append(np.column_stack([n * np.abs(n), np.ones(n.size), n * n, r.y[seen, 1]]))
    table, n_free = np.concatenate(rows), 3 if model.parameter("c2").free else 2
    c1, bias, *c2 = np.linalg.lstsq(table[:, :n_free], table[:, 3], rcond=None)[0].tolist()
    return guess | {"c1": max(c1, 0.1), "bias": bias} | ({"c2": c2[0]} if c2 else {})


def shaft_guess(records: Sequence[Record]) -> tuple[float, float]:
    """Return delay [s] and pole [1/s] of the best delayed first-order lag from the command to the shaft speed.

    Parameters
    ----------
    records
        Records of bench runs with command and shaft speed.

    Notes
    -----
    The best lag has the smallest sum of absolute errors of the shaft speed on a grid of delays (0 to 4.8 s) and poles.
    A search from one initial value would stop at a slow pole if the delay is long.
    """
    delays = [k * GRID_STEP for k in range(round(MAX_DELAY / GRID_STEP) + 1)]
    found = fit_first_order_lag([_lag_data(r) for r in records], delays, (1.0 / START_POLES).tolist(), GRID_STEP)
    return found.delay, 1.0 / found.time_constant


def _lag_data(r: Record) -> LagData:
    """Return the data of the record ``r`` for a search of delay and lag: the command every 0.05 s, and a function.

    The function takes the command after a first-order lag, every 0.05 s, and a delay [s]. It returns the sum of
    absolute differences from the measured shaft speeds. The shaft is assumed to be at rest before the start of the
    record.
    """
    t = np.arange(r.t[0], r.t[-1], GRID_STEP)
    command = r.u[np.clip(np.searchsorted(r.t, t, side="right") - 1, 0, None), r.inputs.index("n_cmd_0")]
    seen = np.isfinite(r.y[:, 0])
    n, row = r.y[seen, 0], np.clip(np.round((r.t[seen] - r.t[0]) / GRID_STEP).astype(int), 0, t.size - 1)

    def misfit(lagged: Array, delay: float) -> float:
        """Return the sum of absolute differences between measured shaft speeds and the lagged command (n,).

        The lagged command is shifted by ``delay`` [s], rounded to 0.05 s. It is zero before the start of the record.
        """
        past = np.maximum(row - round(delay / GRID_STEP), -1)
        return float(np.abs(n - np.append(lagged, 0.0)[past]).sum())  # index -1, before the start: shaft at rest

    return LagData(command, misfit)


def thruster_name(loaded: LoadedLog) -> str:
    """Return the name of the only thruster in a bench log with a command that changes and a measured shaft speed.

    Raises
    ------
    SeatrialError
        If the log has no such thruster, or more than one.
    """
    c = loaded.run.channels
    moved = [n for n in commanded_thrusters(c) if shaft_speed_of(n) in c and np.ptp(c[command_of(n)].value) > 0]
    if len(moved) != 1:
        found = ", ".join(moved) if moved else "none"
        raise SeatrialError(
            f"{loaded.about['path']}: exactly one thruster with a changing command and a shaft speed is needed; the "
            f"log has {found}; give one of them as --thruster"
        )
    return moved[0]


def check_signs(loaded: LoadedLog, name: str) -> None:
    """Check signs and units of a bench log before a fit: shaft speed against command, and force against shaft speed.

    ``loaded`` is the log, and ``name`` is the name of the thruster in the rig. Channels that the log lacks are not
    checked. Only findings that make a fit meaningless count, and a force that clearly falls as the shaft speed rises.

    Raises
    ------
    SeatrialError
        If a sign or unit is wrong. The message contains advice.
    """
    c, where = loaded.run.channels, loaded.about["path"]
    for f in check_shafts({n: c[n] for n in (command_of(name), shaft_speed_of(name)) if n in c}):
        if invalidates_fit(f):
            raise SeatrialError(f"{where}: {f.where}: {f.text} [{f.code}]; {f.advice}")
    if "force" in c and shaft_speed_of(name) in c:
        seen = np.isfinite(c["force"].value)
        n = np.interp(c["force"].t[seen], c[shaft_speed_of(name)].t, c[shaft_speed_of(name)].value)
        if clearly_falls(n, c["force"].value[seen]):
            raise SeatrialError(f"{where}: {REVERSED_LOAD_CELL}")


def thruster_channels(loaded: LoadedLog, model: Model, name: str) -> dict[str, Channel]:
    """Return the channels of the thruster ``name`` in a bench log, by the names that the thruster model ``model`` uses.

    They are delayed copies of the command, ``n_cmd_0``, ``n_cmd_1``, ..., with the delays of the model, the shaft speed
    ``n`` and, if the log has it, the force ``force`` [N] of the load cell.

    Parameters
    ----------
    loaded
        Bench log.
    model
        Thruster model.
    name
        Name of the thruster in the log, for example ``left``.

    Raises
    ------
    SeatrialError
        If the log lacks the command or the shaft speed.
    """
    found = loaded.run.channels
    for needed in (command_of(name), shaft_speed_of(name)):
        if needed not in found:
            raise SeatrialError(
                f"{loaded.about['path']}: no signal {needed!r}, which a fit of this thruster needs; the log has "
                f"{', '.join(sorted(found))}; record it, or name another thruster with --thruster"
            )
    channels = delayed_channels(found[command_of(name)], delay_step(model)) | {"n": found[shaft_speed_of(name)]}
    return channels | ({"force": found["force"]} if "force" in found else {})


def thruster_runs(loaded: Sequence[LoadedLog], model: Model, name: str | None) -> list[LogSegment]:
    """Return bench logs of one thruster with the channel names of a thruster model.

    Parameters
    ----------
    loaded
        Bench logs.
    model
        Thruster model.
    name
        Name of the thruster in all logs. None: the only thruster of the first log with a command that changes and a
        shaft speed.

    Returns
    -------
    list of LogSegment
        One for each log, with the channels of the model only, and the force if the log has it.

    Raises
    ------
    SeatrialError
        If a log lacks a channel of the model, or if the thruster of the first log is not unique.
    """
    runs = []
    for log in loaded:
        name = name or thruster_name(log)
        channels = thruster_channels(log, model, name)
        if "thrust" in model.provides and "force" not in channels:
            raise SeatrialError(
                f"{log.about['path']}: the log has no load cell, but the model has a force and was fitted to other "
                "logs; fit a model to these logs first with `seatrial ident thruster`"
            )
        runs.append(replace(log.run, channels=channels))
    return runs
