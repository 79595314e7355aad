"""Workflow of `seatrial ident fleet`: one vehicle model fitted to each of many logs, in parallel processes.

The estimates of all logs are one Parquet table with a row for each log and parameter. An interrupted run continues from
it. The summary compares the logs: the scatter of each parameter, and what its standard errors explain of it.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import resource
import socket
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from seatrial.daq.errors import SeatrialError, counted, first_names
from seatrial.daq.log import first_segments, open_log
from seatrial.ident.diagnosis import COMMON_ERRORS
from seatrial.ident.estimation import LEAST_OWN, FittedModel, ReportedEstimates, between_log_variance, load_model
from seatrial.ident.models import accepting_code, code_digest, is_own_model
from seatrial.ident.numerics import Array, chi2_sf
from seatrial.ident.parallel import ResultTable, TaskOutcome, Workers, run_many
from seatrial.ident.reporter import Reporter, TimeLeft
from seatrial.ident.results import (
    FailedLog,
    FleetParameter,
    FleetResult,
    ParameterRow,
    ResultWarning,
    WarningCode,
    provenance,
    write_result,
)
from seatrial.ident.studies import estimator_code_hash
from seatrial.ident.workflows.vehicle import VehicleFit, fit_vehicle, is_tested
from seatrial.ident.workflows.vehicle_model import VehicleRequest, is_saved_model

TABLE = "fits.parquet"
SIDES = "thrust of both sides"  # key of `prior_parts` for which side deviates from the given thrust
TYPICAL = 0.9  # quantile of a velocity of a log that counts as typical
CORRELATION_DIGITS = 9  # decimals of a correlation in the table
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")
LEVEL = 0.01  # significance level of all parameters together that the logs differ
COLUMNS: dict[str, type] = {
    "log": str,  # path as given
    "sha256": str,
    "parameter": str,  # None: the log has no fit
    "value": float,
    "se": float,
    "prior_parts": str,  # JSON: part of the standard error by name of the parameter whose prior it comes from
    "correlations": str,  # JSON: correlation with each other estimate of the log, by name; without those of one log
    "unit": str,
    "meaning": str,
    "effect": str,  # effect that the parameter belongs to; None: the model itself, a disturbance, or a sensor
    "nuisance": bool,  # of noise, of a disturbance or of an offset of a sensor: no property of the boat
    "free": bool,
    "per_log": bool,  # the true value differs from log to log, as that of the current
    "origin": str,
    "flag": str,
    "flag_codes": str,  # short codes of the flag, separated by commas
    "model": str,
    "converged": bool,
    "message": str,
    "log_likelihood": float,
    "duration": float,  # s
    "u_typical": float,  # m/s: speed ahead through the water that nine tenths of the log do not exceed
    "v_typical": float,  # m/s: as above, for the size of the sway velocity
    "r_typical": float,  # rad/s: as above, for the size of the yaw rate
    "warnings": int,
    "warning_texts": str,  # JSON: code and text of each warning of the fit
    "answer": str,
    "cpu": float,  # s
    "memory": float,  # bytes, the largest so far of the process
    "worker": str,  # host:process
    "seatrial": str,
    "error": str,  # None: the log has a fit
}
Row = dict[str, Any]


@dataclass(frozen=True)
class FleetRequest:
    """Options of `seatrial ident fleet`.

    Attributes
    ----------
    logs
        Logs, to each of which the model is fitted. A folder stands for all logs in it, and a log that occurs twice,
        also as a copy, is fitted once.
    vehicle
        Options of each fit. Its logs and its folder are not used.
    out
        Folder for the results; None: no file is written.
    workers
        Processes that run the fits.
    force
        Whether to start again if the folder has results. Otherwise the fits in it are used.
    """

    logs: Sequence[Path]
    vehicle: VehicleRequest
    out: Path | None
    workers: Workers = field(default_factory=Workers)
    force: bool = False


@dataclass(frozen=True)
class FleetFits:
    """Fits of one model to many logs.

    Attributes
    ----------
    result
        Content of result.json.
    table
        All estimates as a ``pyarrow.Table``: the rows of fits.parquet.
    """

    result: FleetResult
    table: Any


@dataclass(frozen=True)
class FleetLog:
    """Log of a fleet as a task for a worker.

    Attributes
    ----------
    name
        Path as given.
    path
        Absolute path, which the workers of a cluster must have, too.
    sha256
        Hash of the log; its path as given if it cannot be read.
    """

    name: str
    path: Path
    sha256: str


def fit_fleet(request: FleetRequest, command: str, reporter: Reporter) -> FleetFits:
    """Fit a vehicle model to each of many logs in parallel, and compare the estimates of the logs.

    With a folder ``request.out``, fits.parquet is written there while the fits are running, and result.json at the end.
    Fits that fits.parquet has already are not repeated, but failed ones are.

    Parameters
    ----------
    request : FleetRequest
        Logs, options of a fit, folder and workers.
    command : str
        Command line, for the provenance.
    reporter : Reporter
        Receives progress and warnings.

    Returns
    -------
    FleetFits
        Table of all estimates, and the differences between the logs. A log whose fit fails is in the table with the
        reason.

    Raises
    ------
    SeatrialError
        For example, if a model.toml cannot be read or is not trusted, if fits.parquet has fits with other options, if
        ``request.out`` is a file, if a library is missing, or if a cluster cannot be used.
    """
    code = checked_code(request.vehicle)
    logs = hashed_logs(with_logs_of_folders(request.logs), reporter)
    rows = fit_logs(logs, request, code, reporter)
    path = "" if request.out is None else str(request.out / TABLE)
    result = fleet_result(rows, len(logs), request.vehicle, path, command)
    if request.out is not None:
        write_result(result, request.out / "result.json")
    return FleetFits(result, rows)


def with_logs_of_folders(paths: Sequence[Path]) -> list[Path]:
    """Return the paths with the logs of each folder, sorted by name, in place of the folder.

    A folder without a log stays, so that the fit of this path names what it is.
    """
    return [log for path in paths for log in (path.is_dir() and first_segments(path)) or [path]]


def checked_code(vehicle: VehicleRequest) -> frozenset[str]:
    """Check the model.toml that the fits begin with, once for all logs, and return the hashes of its Python files.

    The workers run the files with these hashes without a further check (`seatrial.ident.models.accepting_code`). The
    set is empty for a model without Python files, and for a model that is no model.toml. SeatrialError is raised if the
    file cannot be read, or if a Python file may not be run without ``--trust-code``.
    """
    if not is_saved_model(vehicle.model):
        return frozenset()
    return frozenset(map(code_digest, load_model(Path(vehicle.model)).python_files))


def fit_logs(logs: Sequence[FleetLog], request: FleetRequest, code: frozenset[str], reporter: Reporter) -> Any:
    """Fit the model to each log in parallel, and return the rows of all estimates (``pyarrow.Table``).

    With a folder, the rows are in its fits.parquet. Fits that the file has already are not repeated, except failed
    ones.

    Parameters
    ----------
    logs : sequence of FleetLog
        Different logs. Those of the request are not used.
    request : FleetRequest
        Options of a fit, folder and workers.
    code : frozenset of str
        Hashes of the Python files that the model may run (`checked_code`).
    reporter : Reporter
        Receives progress and warnings.

    Raises
    ------
    SeatrialError
        As `fit_fleet`.
    """
    path = None if request.out is None else request.out / TABLE
    if request.out is not None and request.out.exists() and not request.out.is_dir():
        raise SeatrialError(f"{request.out}: is a file; give a folder with --out")
    if path is not None and request.force:
        path.unlink(missing_ok=True)
    vehicle = portable(request.vehicle)
    with ResultTable(path, COLUMNS, "sha256", "error", settings_of(vehicle)) as table:
        finished = table.keys
        todo = [log for log in logs if log.sha256 not in finished]
        if len(todo) < len(logs):
            reporter.progress(f"{len(logs) - len(todo)} of {len(logs)} logs have a fit already")
        left = TimeLeft(len(todo))
        for n, outcome in enumerate(run_many(todo, partial(_fit_log, vehicle, code), request.workers, reporter), 1):
            table.add(_rows_of(outcome))
            end = f"failed: {_reason(outcome)}" if outcome.error else "fitted"
            reporter.progress(f"{n} of {len(todo)}: {outcome.task.name} {end} ({left.text(n)})")
        table.sort("log")
    return _rows_of_logs(table.table(), logs)


def portable(vehicle: VehicleRequest) -> VehicleRequest:
    """Return the options of a fit with absolute paths, so that processes with another working folder find the files."""
    model = vehicle.model
    if is_own_model(model):
        file, _, name = model.rpartition(":")
        model = f"{Path(file).absolute()}:{name}"
    elif is_saved_model(model):
        model = str(Path(model).absolute())
    thruster = None if vehicle.thruster is None else vehicle.thruster.absolute()
    own = None if vehicle.effects_file is None else vehicle.effects_file.absolute()
    return replace(vehicle, model=model, thruster=thruster, effects_file=own, out=Path())


def settings_of(vehicle: VehicleRequest) -> dict[str, Any]:
    """Return what the estimates of a log depend on besides the log: options, contents of files, and code, by name.

    Values are those of JSON. Only options that differ from the defaults are included, so that a new option does not
    change the settings of older tables.
    """
    found: dict[str, Any] = {"seatrial": version("seatrial"), "code": estimator_code_hash()}
    default = VehicleRequest((), (), Path())
    for option in fields(vehicle):
        value = getattr(vehicle, option.name)
        if value != getattr(default, option.name):
            found[option.name] = msgspec.to_builtins(value, enc_hook=str)
    files = {"thruster": vehicle.thruster, "effects_file": vehicle.effects_file}
    if is_own_model(vehicle.model):
        files["model"] = Path(vehicle.model.rpartition(":")[0])
    elif is_saved_model(vehicle.model):
        files["model"] = Path(vehicle.model)
    for name, path in files.items():
        if path is not None:
            try:
                found[name] = f"{path.name} sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}"
            except OSError as problem:
                raise SeatrialError(f"{path}: {problem.strerror}; give the path of an existing file") from None
    return found


def hashed_logs(paths: Sequence[Path], reporter: Reporter) -> list[FleetLog]:
    """Return the logs with their hashes, each once. A copy of another log is left out with a warning.

    A log that cannot be read has its path as hash. Its fit fails with the reason.
    """
    reporter.progress(f"reading the hashes of {counted(len(paths), 'log')}")
    found = dict[str, FleetLog]()
    for path in dict.fromkeys(paths):
        try:
            with open_log(path) as log:
                digest = log.sha256
        except (SeatrialError, OSError):
            digest = str(path)
        if digest in found:
            reporter.warning(f"{path}: is a copy of {found[digest].name}, and is left out")
        else:
            found[digest] = FleetLog(str(path), path.absolute(), digest)
    return list(found.values())


class _Ignored:
    """Reporter for the fits of a fleet, whose messages would have no place: the warnings are in the results."""

    def progress(self, text: str, times: Callable[[], str] | None = None) -> None:
        """Ignore the text."""

    def detail(self, text: str) -> None:
        """Ignore the text."""

    def warning(self, text: str) -> None:
        """Ignore the text."""


def _fit_log(vehicle: VehicleRequest, code: frozenset[str], log: FleetLog) -> list[Row]:
    """Fit the model to one log in a worker process, and return a row of the table for each parameter.

    ``code`` has the hashes of the Python files that the model may run.
    """
    began = time.process_time()
    with accepting_code(code):
        done: VehicleFit = fit_vehicle(replace(vehicle, logs=[log.path]), "", _Ignored(), with_dynamics=False)
    result = done.result
    of_log: Row = {
        "model": result.fit.model,
        "converged": result.converged,
        "message": result.fit.message,
        "log_likelihood": result.fit.log_likelihood,
        "duration": sum(x.duration for x in result.logs),
        **_typical_velocities(done.fitted),
        "warnings": len(result.warnings),
        "warning_texts": json.dumps([[w.code, w.text] for w in result.warnings]),
        "answer": result.answer,
        "cpu": time.process_time() - began,
        "memory": _peak_memory(),
        "worker": f"{socket.gethostname()}:{os.getpid()}",
        "seatrial": result.seatrial,
    }
    parts, own = _prior_parts(done), {p.name for p in done.fitted.model.parameters if p.per_record}
    correlations, effects, nuisance = _correlations(done), _effects_by_parameter(done), _nuisance_parameters(done)
    return [
        of_log
        | {"per_log": row.name in own, "effect": effects.get(row.name), "nuisance": row.name in nuisance}
        | _row_of_parameter(row, parts.get(row.name, {}), correlations.get(row.name, {}))
        for row in result.fit.parameters
    ]


def _typical_velocities(fitted: FittedModel) -> dict[str, float]:
    """Return the columns of typical velocities: what nine tenths of the filtered states of a log do not exceed.

    The surge speed counts only ahead, sway velocity and yaw rate count by their size. A state that the model lacks has
    no column.
    """
    found = {}
    for i, state in enumerate(fitted.fit.model.states):
        if state.name in ("u", "v", "r"):
            x = np.concatenate([v.run.x_filt[:, i] for v in fitted.estimation])
            size = np.maximum(x, 0.0) if state.name == "u" else np.abs(x)
            found[f"{state.name}_typical"] = float(np.quantile(size, TYPICAL))
    return found


def _correlations(done: VehicleFit) -> dict[str, dict[str, float]]:
    """Return the correlation of each estimate with each other one, by their reported names.

    Estimates without a standard error, and those of per-record parameters such as the current, are left out.
    """
    found, matrix = dict[str, dict[str, float]](), done.result.fit.correlation.matrix
    shared = [k for k, p in enumerate(done.fitted.fit.parameters) if p.segment is None and np.isfinite(matrix[k, k])]
    names = done.result.fit.correlation.names
    for i in shared:
        found[names[i]] = {names[j]: round(float(matrix[i, j]), CORRELATION_DIGITS) for j in shared if j != i}
    return found


def _effects_by_parameter(done: VehicleFit) -> dict[str, str]:
    """Return the name of the effect of each parameter of an effect, by the reported name of the parameter.

    Disturbances and errors of sensors, which are part of the nominal model, are no effects here, except common errors:
    the user sees their names in the answer and in the model.
    """
    model, scale = done.fitted.fit.model, ReportedEstimates(done.fitted.fit).scale
    effects = [e for e in model.effects if not e.kind.nuisance or e.name in COMMON_ERRORS]
    return {scale.name(p.name, p.unit): e.name for e in effects for p in e.parameters}


def _peak_memory() -> float:
    """Return the largest resident memory of this process so far [bytes]."""
    status = Path("/proc/self/status")
    if status.exists():  # on Linux, getrusage begins with the memory of the parent process
        (line,) = (x for x in status.read_text(encoding="ascii").splitlines() if x.startswith("VmHWM:"))
        return 1024.0 * int(line.split()[1])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(peak if sys.platform == "darwin" else 1024 * peak)  # macOS alone gives bytes


def _prior_parts(done: VehicleFit) -> dict[str, dict[str, float]]:
    """Return the parts of each parameter's standard error that come from priors, by name of the prior's parameter.

    The part with the name `SIDES` comes from the scale of the forces: one of the sides deviates from the given thrust.

    A prior that is too large by one of its standard deviations changes the estimate by this part, in the parameter's
    unit and with its sign. The priors of noise, and of per-record parameters such as the current, are left out: their
    true values differ from log to log.

    Notes
    -----
    With the covariance C of the estimates and a prior of standard deviation s on parameter c, the derivative of the
    estimates with respect to the mean of the prior is C[:, c] / s**2. The share of the information of c that comes from
    the prior is C[c, c] / s**2. A standard error may also contain what the model does not explain, and then exceed s:
    the part of c itself is s times the share at most, and those of the others follow by their regression on c.
    """
    fit, summary = done.fitted.fit, done.result.fit
    reported = ReportedEstimates(fit)
    errors = np.array(
        [{r.name: r.se or 0.0 for r in summary.parameters}.get(n, 0.0) for n in summary.correlation.names]
    )
    own = {p.name for p in fit.model.parameters if p.per_record} | set(fit.model.noise_parameters)
    found: dict[str, dict[str, float]] = {}
    for k, p in enumerate(fit.parameters):
        share = float(fit.prior_weight[k])
        shared = p.segment is None and p.name not in own
        if shared and p.prior is not None and errors[k] > 0.0 and share > 0.0:
            parts = summary.correlation.matrix[:, k] * errors * min(share, 1.0) ** 0.5
            of_prior = (p.prior_deviation(float(fit.values[k])) or 0.0) * abs(reported.factor(p.unit))
            parts *= min(1.0, of_prior * min(share, 1.0) ** 0.5 / errors[k])
            for name, part in zip(summary.correlation.names, parts.tolist(), strict=True):
                if np.isfinite(part) and part != 0.0:
                    found.setdefault(name, {})[summary.correlation.names[k]] = part
    if done.uncertainty is not None:
        shifts = dict(zip(done.uncertainty.parameters, done.uncertainty.scale_shift.tolist(), strict=True))
        for own_name, name in zip(fit.names, summary.correlation.names, strict=True):
            if shift := shifts.get(own_name, 0.0):
                found.setdefault(name, {})[SIDES] = shift
    return found


def _nuisance_parameters(done: VehicleFit) -> set[str]:
    """Return the reported names of the parameters of noise, disturbances and offsets of sensors."""
    model, scale = done.fitted.fit.model, ReportedEstimates(done.fitted.fit).scale
    names = {p.name for e in model.effects if e.kind.nuisance for p in e.parameters} | set(model.noise_parameters)
    return {scale.name(p.name, p.unit) for p in model.parameters if p.name in names}


def _row_of_parameter(row: ParameterRow, prior_parts: Mapping[str, float], correlations: Mapping[str, float]) -> Row:
    """Return the columns of the table that belong to one parameter of a fit.

    A parameter with its own value in each part of a log that was cut at gaps is ``NAME@PART``.
    """
    return {
        "parameter": row.name if row.record is None else f"{row.name}@{row.record}",
        "value": row.value,
        "se": row.se,
        "prior_parts": json.dumps(prior_parts),
        "correlations": json.dumps(correlations),
        "unit": row.unit,
        "meaning": row.meaning,
        "free": row.free,
        "origin": row.origin,
        "flag": row.flag,
        "flag_codes": ", ".join(row.flag_codes) or None,
    }


def _rows_of(outcome: TaskOutcome[FleetLog, list[Row]]) -> list[Row]:
    """Return the rows of the table for the outcome of one log: those of its parameters, or one with the reason."""
    log: Row = {"log": outcome.task.name, "sha256": outcome.task.sha256}
    if outcome.value is None:
        return [log | {"error": _reason(outcome)}]
    return [log | row for row in outcome.value]


def _reason(outcome: TaskOutcome[FleetLog, list[Row]]) -> str:
    """Return the reason why the fit to a log failed, without the path of the log, which stands beside it."""
    return outcome.error.replace(str(outcome.task.path), outcome.task.name).removeprefix(f"{outcome.task.name}: ")


def _rows_of_logs(table: Any, logs: Sequence[FleetLog]) -> Any:
    """Return the rows of the table (``pyarrow.Table``) that belong to the given logs, with the paths as given now.

    The table may also have logs of earlier runs, or logs that have been moved since.
    """
    import pyarrow

    names = {log.sha256: log.name for log in logs}
    digests = table["sha256"].to_pylist()
    kept = [k for k, digest in enumerate(digests) if digest in names]
    column = pyarrow.array([names[digests[k]] for k in kept], pyarrow.string())
    chosen = table.take(pyarrow.array(kept, pyarrow.int64()))
    return chosen.set_column(chosen.schema.get_field_index("log"), "log", column)


def fleet_result(table: Any, n_logs: int, vehicle: VehicleRequest, file: str, command: str) -> FleetResult:
    """Return the summary of the fits of many logs as a result.

    Parameters
    ----------
    table : pyarrow.Table
        Rows of the fits: one for each log and parameter, and one for each failed log.
    n_logs : int
        Number of logs.
    vehicle : VehicleRequest
        Options of each fit, with the name of the model.
    file : str
        Path of the table; empty if it was not written.
    command : str
        Command line, for the provenance.
    """
    rows = table.to_pylist()
    failed = tuple(FailedLog(log=r["log"], reason=r["error"]) for r in rows if r["error"] is not None)
    bad = {r["log"]: r["message"] for r in rows if r["converged"] is False}
    fitted = {r["log"] for r in rows if r["converged"]}
    by_name: dict[str, list[Row]] = {}
    for row in rows:
        if row["converged"] and row["free"] and row["se"] is not None:
            by_name.setdefault(row["parameter"], []).append(row)
    compared = {name: found for name, found in by_name.items() if len(found) > 1}
    level = LEVEL / max(len(compared), 1)  # Bonferroni: one of twenty parameters is below 0.05 by chance
    parameters = tuple(_between_logs(name, found, level) for name, found in compared.items())
    made = provenance([], command)
    return FleetResult(
        created=made.created, seatrial=made.seatrial, command=made.command,
        answer=_answer(n_logs, len(fitted), failed, len(bad), parameters),
        warnings=warnings_of_logs(rows), notes=(score_test_note(vehicle, rows),),
        model=vehicle.model, table=file, score_tests=is_tested(vehicle),
        n_logs=n_logs, fitted=len(fitted), failed=failed,
        unconverged=tuple(FailedLog(log=log, reason=reason) for log, reason in bad.items()),
        parameters=parameters,
    )  # fmt: skip


def warnings_of_logs(rows: Sequence[Mapping[str, Any]]) -> tuple[ResultWarning, ...]:
    """Return the warnings of the fits of many logs, each once, with the names of the logs that have it.

    Warnings that differ only in numbers and in the name of the log are one warning. It has the text of its first log.

    Parameters
    ----------
    rows
        Rows of the table. Those of one log have the same warnings.
    """
    texts = {row["log"]: row["warning_texts"] for row in rows if row.get("warning_texts")}
    first: dict[tuple[str, str], tuple[WarningCode, str]] = {}
    logs: dict[tuple[str, str], list[str]] = {}
    for log, found in texts.items():
        for code, text in json.loads(found):
            kind = code, NUMBER.sub("", text.replace(Path(log).name, ""))
            first.setdefault(kind, (code, text if Path(log).name in text else f"{log}: {text}"))
            logs.setdefault(kind, []).append(log)
    warnings = []
    for kind, (code, text) in first.items():
        others = list(dict.fromkeys(logs[kind]))[1:]
        also = f" The same, with other numbers, holds for {first_names(others)}." if others else ""
        warnings.append(ResultWarning(code=code, text=f"{text.removesuffix('.')}.{also}"))
    return tuple(warnings)


def score_test_note(vehicle: VehicleRequest, rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the sentences on whether the fits of many logs were tested for missing effects, and what follows.

    ``vehicle`` has the options of each fit, and ``rows`` are the rows of the table.
    """
    if not is_tested(vehicle):
        return (
            "The fits have no score tests: all logs have the same model, and the standard error of a log excludes "
            "effects that the model may lack; the scatter between the logs contains them."
        )
    names: dict[str, set[str]] = {}
    for row in rows:
        if row["parameter"] is not None:
            names.setdefault(row["log"], set()).add(row["parameter"].partition("@")[0])
    models = len(set(map(frozenset, names.values())))  # an added effect is a model with more parameters
    return (
        "Each fit has score tests, as in `seatrial ident vehicle`: small errors of sensors and hull form are added to "
        "the model of a log that shows them, and the standard error of a log includes what remains unexplained. "
        + (f"The logs have {models} different models. " if models > 1 else "All logs have the same model. ")
        + "--no-score-tests leaves the tests out."
    )


def _between_logs(name: str, rows: Sequence[Mapping[str, Any]], level: float) -> FleetParameter:
    """Return the summary of one parameter from its rows of two logs or more, each with a standard error.

    The errors from a prior are the same in all logs, so they are a common part of the covariance: they do not hide
    differences between the logs, and they do not become smaller in the mean. The p value is that of Cochran's Q with
    this covariance, by chi-squared. The logs agree if it is above ``level``.
    """
    values, errors = (np.array([r[key] for r in rows], dtype=float) for key in ("value", "se"))
    common = common_errors(rows)
    own = own_variances(rows, common)
    covariance = np.diag(own) + common @ common.T
    scatter, mean, error = between_log_variance(values, covariance if common.size else own)
    p = float(chi2_sf(_cochran_q(values, covariance), len(rows) - 1))
    return FleetParameter(
        name=name,
        meaning=rows[0]["meaning"],
        unit=rows[0]["unit"],
        n=len(rows),
        mean=mean,
        se_mean=error,
        sd=float(values.std(ddof=1)),
        se=float(np.sqrt((errors**2).mean())),
        se_own=float(np.sqrt(own.mean())),
        scatter=scatter,
        p=p,
        agree=p > level,
        per_log=rows[0]["per_log"],
    )


def common_errors(rows: Sequence[Mapping[str, Any]]) -> Array:
    """Return the parts of the errors of one parameter by the priors of the fits (k, n_priors), for its rows of k logs.

    A prior is the same in all logs, and so is its error. Without priors, n_priors is 0.
    """
    parts = [json.loads(r["prior_parts"]) for r in rows]
    priors = sorted({n for p in parts for n in p})
    return np.array([[p.get(prior, 0.0) for prior in priors] for p in parts]).reshape(len(rows), len(priors))


def own_variances(rows: Sequence[Mapping[str, Any]], common: Array) -> Array:
    """Return the variance (k,) of each estimate without its errors from priors ``common`` (k, n_priors).

    It is positive. ``rows`` are those of one parameter, each with a standard error.
    """
    variances = np.array([r["se"] for r in rows], dtype=float) ** 2
    own: Array = np.maximum(variances - (common**2).sum(axis=1), LEAST_OWN * variances)
    return own


def _cochran_q(values: Array, covariance: Array) -> float:
    """Return Cochran's Q of values (k,) with their covariance (k, k): the weighted sum of squares about their mean."""
    weighted, weights = np.linalg.solve(covariance, np.column_stack([values, np.ones(values.size)])).T
    mean = weighted.sum() / weights.sum()
    return float((values - mean) @ (weighted - mean * weights))


def _answer(
    n_logs: int, fitted: int, failed: Sequence[FailedLog], unconverged: int, parameters: Sequence[FleetParameter]
) -> str:
    """Return the conclusion of a fleet in two sentences: numbers of fits, and parameters that differ.

    The second sentence states that a comparison needs two fits if there are no parameters to compare.
    """
    words = [f"The model was fitted to {fitted} of {n_logs} logs"]
    words += [f"{len(failed)} failed"] if failed else []
    words += [f"{unconverged} did not converge"] if unconverged else []
    first = ", ".join(words) + "."
    if not parameters:
        return f"{first} A comparison needs two fits."
    differ = [p.name for p in parameters if not p.agree and not p.per_log]
    if not differ:
        return f"{first} The logs agree in all parameters within the standard errors."
    return f"{first} The logs differ by more than the standard errors in {', '.join(differ)}."
