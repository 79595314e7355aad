"""Characterisation of a thruster from bench logs: its model fitted by maximum likelihood.

Initial values come from the steps of the log: delay and time constant by grid search, thrust coefficients by least
squares.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.ident.characterisation.thrust_curve import FALLS, MIN_SAMPLES, falls
from seatrial.ident.checks import check_shafts, spoils_a_fit
from seatrial.ident.data import Channel, LoadedLog, LogSegment, Record
from seatrial.ident.estimation import EstimationOptions, Fit, Likelihood, fit
from seatrial.ident.model import Model
from seatrial.ident.models import START_POLES, delay_step, delayed_channels, on_a_copy, thruster_model
from seatrial.ident.numerics import Array, LagData, fit_first_order_lag

THRUSTER_RATE = 50.0  # Hz, rows of a record with load cell and shaft speed
GRID_STEP = 0.05  # s, of the delays that are tried for initial values, and of the command meanwhile
MAX_DELAY = 4.8  # s, of those delays
DEAD_ZONES = tuple(0.0025 * k for k in range(81))  # of full command, ends of the dead zone that are tried
WAYS = (1.0, -1.0)  # of a shaft: ahead, astern
LEAST_SPEED = 0.05  # of full speed: from which a shaft has turned, and is not noise
N_SEARCHES = 3  # over the dead zone, each with what the fit before it says of all else


def fit_on_a_copy(
    model: Model, records: list[Record], again: Callable[[Model], list[Record]], options: EstimationOptions
) -> tuple[Fit, list[Record]]:
    """``fit_thruster``, and once more with the delay on one of the command's copies.

    ``again``: the records for a model with other copies. Restricted likelihood comes last, from the maximum of the
    plain one. Returns the records that belong to the fit, too.
    """
    plain = replace(options, reml=False)
    fitted = fit_thruster(model, records, plain)
    pace = on_a_copy(fitted.model.values["tau"], delay_step(model))
    if pace:
        exact = thruster_model(pace, force="thrust" in model.provides)
        records = again(exact)
        values = {n: v for n, v in fitted.model.values.items() if n in exact.values}
        kept = [fitted.model.parameter(n) for n in ("d", "c2") if n in values]  # free, and perhaps fixed
        fitted = fit(exact.with_values(values).replace_parameters(*kept), records, plain)
    fitted = _restricted(fitted, records) if options.reml else fitted
    return replace(fitted, options=options), records


def _restricted(top: Fit, records: Sequence[Record]) -> Fit:
    """From the maximum of the likelihood to that of the restricted one; what it took to get there counts."""
    found = fit(top.model, records, EstimationOptions(reml=True))
    return replace(
        found,
        iterations=top.iterations + found.iterations,
        evaluations=top.evaluations + found.evaluations,
        cpu_seconds=top.cpu_seconds + found.cpu_seconds,
        message=top.message if found.converged else found.message,
    )


def fit_thruster(model: Model, records: Sequence[Record], options: EstimationOptions) -> Fit:
    """The model fitted from least squares. The likelihood depends on the end of the dead zone only within it, so that
    is looked for on a grid, and again with what the fit then says of all else, until it stays.

    Where the shaft turned one way only, c1 and c2 are one coefficient, and c2 is fixed at 0.
    """
    if "thrust" in model.provides and len(directions(records)) < len(WAYS):
        model = model.replace_parameters(model.parameter("c2").at(0.0).fixed())
    guess = first_guess(records, model)
    guess["tau"] = min(guess["tau"], 0.95 * model.parameter("tau").bounds[1])
    fitted = fit(model, records, options, start=guess)
    at, found = [p.name for p in model.parameters].index("d"), -1.0
    for _ in range(N_SEARCHES):
        likelihood, values = Likelihood(fitted.model), fitted.record_values

        def value(d: float, likelihood: Likelihood = likelihood, values: Array = values) -> float:
            tried = values.copy()
            tried[:, at] = d
            return sum(likelihood.value(r, v) for r, v in zip(records, tried, strict=True))

        before, found = found, max(DEAD_ZONES, key=value)
        if abs(found - before) < 2 * DEAD_ZONES[1]:
            break
        fitted = fit(fitted.model.replace_parameters(fitted.model.parameter("d").at(found).freed()), records)
    return fitted


def directions(records: Sequence[Record]) -> tuple[float, ...]:
    """Which ways the shaft turned: 1 ahead, -1 astern."""
    n = np.concatenate([r.y[:, 0] for r in records])
    return tuple(way for way in WAYS if np.count_nonzero(way * n > LEAST_SPEED) >= MIN_SAMPLES)


def steady_thrust(fitted: Fit, n: Array) -> tuple[Array, Array]:
    """Thrust ``c1 n|n| + c2 n^2`` [N] at shaft speeds n (n_samples,), and its standard errors by the covariance of c1
    and c2; NaN where the data do not tell them."""
    B = np.column_stack([n * np.abs(n), n * n])
    force = B @ [fitted.estimate(c)[0] for c in ("c1", "c2")]
    free = [c for c in ("c1", "c2") if c in fitted.names]  # c2 may be fixed
    at, B = [fitted.names.index(c) for c in free], B[:, : len(free)]
    variance = np.einsum("ij,jk,ik->i", B, fitted.covariance[np.ix_(at, at)], B)
    return force, np.sqrt(np.where(variance >= 0.0, variance, np.nan))


def first_guess(records: Sequence[Record], model: Model) -> dict[str, float]:
    """Thrust coefficients by least squares of force on measured shaft speed; the shaft's delay and pole."""
    tau, a = shaft_guess(records)
    guess = {"tau": tau, "a": a}
    if "thrust" not in model.provides:
        return guess
    rows = []
    for r in records:
        seen = np.isfinite(r.y[:, 1])
        n = np.interp(r.t[seen], r.t[np.isfinite(r.y[:, 0])], r.y[np.isfinite(r.y[:, 0]), 0])
        rows.append(np.column_stack([n * np.abs(n), np.ones(n.size), n * n, r.y[seen, 1]]))
    table, told = np.concatenate(rows), 3 if model.parameter("c2").free else 2
    c1, bias, *c2 = np.linalg.lstsq(table[:, :told], table[:, 3], rcond=None)[0].tolist()
    return guess | {"c1": max(c1, 0.1), "bias": bias} | ({"c2": c2[0]} if c2 else {})


def shaft_guess(records: Sequence[Record]) -> tuple[float, float]:
    """Delay [s] and pole [1/s] of the first-order answer to the command that is least far from the measured speed.

    By mean absolute errors on a grid of both: a search from one start stops at a slow pole where the delay is long.
    """
    delays = [k * GRID_STEP for k in range(round(MAX_DELAY / GRID_STEP) + 1)]
    found = fit_first_order_lag([_lag_data(r) for r in records], delays, (1.0 / START_POLES).tolist(), GRID_STEP)
    return found.delay, 1.0 / found.time_constant


def _lag_data(r: Record) -> LagData:
    """The command on the grid, and the mean absolute error of the delayed lag at the measured shaft speeds."""
    t = np.arange(r.t[0], r.t[-1], GRID_STEP)
    command = r.u[np.clip(np.searchsorted(r.t, t, side="right") - 1, 0, None), r.inputs.index("n_cmd_0")]
    seen = np.isfinite(r.y[:, 0])
    n, row = r.y[seen, 0], np.clip(np.round((r.t[seen] - r.t[0]) / GRID_STEP).astype(int), 0, t.size - 1)

    def misfit(lagged: Array, delay: float) -> float:
        past = np.maximum(row - round(delay / GRID_STEP), -1)
        return float(np.abs(n - np.append(lagged, 0.0)[past]).sum())  # the last: before the start

    return LagData(command, misfit)


def thruster_name(loaded: LoadedLog) -> str:
    """The one thruster of a log that was commanded and whose shaft was measured.

    Raises SeatrialError where there is none, or more than one.
    """
    names = [n.removeprefix("n_cmd_") for n in loaded.run.channels if n.startswith("n_cmd_")]
    moved = [
        n for n in names if f"n_{n}" in loaded.run.channels and np.ptp(loaded.run.channels[f"n_cmd_{n}"].value) > 0
    ]
    if len(moved) != 1:
        said = ", ".join(moved) if moved else "none"
        raise SeatrialError(
            f"{loaded.about['path']}: thrusters with commands and shaft speed: {said}; name one with --thruster"
        )
    return moved[0]


def check_signs(loaded: LoadedLog, name: str) -> None:
    """Check of sign and unit before a fit: the shaft's response to its command, the force's to the shaft.

    Raises SeatrialError with what is wrong and what to do.
    """
    c, where = loaded.run.channels, loaded.about["path"]
    for f in check_shafts({n: c[n] for n in (f"n_cmd_{name}", f"n_{name}") if n in c}):
        if spoils_a_fit(f):
            raise SeatrialError(f"{where}: {f.where}: {f.text} [{f.code}]; {f.advice}")
    if "force" in c and f"n_{name}" in c:
        seen = np.isfinite(c["force"].value)
        n = np.interp(c["force"].t[seen], c[f"n_{name}"].t, c[f"n_{name}"].value)
        if falls(n, c["force"].value[seen]):
            raise SeatrialError(f"{where}: {FALLS}")


def thruster_channels(loaded: LoadedLog, model: Model, name: str) -> dict[str, Channel]:
    """``n_cmd_0`` ..., ``n`` and, with a load cell, ``force``. Raises SeatrialError for what is not there."""
    found = loaded.run.channels
    for needed in (f"n_cmd_{name}", f"n_{name}"):
        if needed not in found:
            raise SeatrialError(f"{loaded.about['path']}: no signal {needed!r}; it has {', '.join(sorted(found))}")
    channels = delayed_channels(found[f"n_cmd_{name}"], delay_step(model)) | {"n": found[f"n_{name}"]}
    return channels | ({"force": found["force"]} if "force" in found else {})


def thruster_runs(loaded: Sequence[LoadedLog], model: Model, name: str | None) -> list[LogSegment]:
    """The logs as runs for a bench model, all of one thruster.

    Raises SeatrialError where a log lacks the force that the model has.
    """
    runs = []
    for x in loaded:
        name = name or thruster_name(x)
        channels = thruster_channels(x, model, name)
        if "thrust" in model.provides and "force" not in channels:
            raise SeatrialError(
                f"{x.about['path']}: no load cell in the log, but the model has its force; it "
                "was fitted to other logs: fit these with `seatrial ident thruster` first"
            )
        runs.append(replace(x.run, channels=channels))
    return runs
