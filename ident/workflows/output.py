"""Writer of the files of a fit: model.toml, result.json and report.html."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from seatrial.ident.data import TIME_INPUT, WORK_INPUT, given_inputs
from seatrial.ident.estimation import (
    ErrorScale,
    Fit,
    FittedData,
    FittedModel,
    IntervalCalibration,
    RefittedEffect,
    save_model,
)
from seatrial.ident.report import write_report
from seatrial.ident.results import (
    CalibrationRow,
    DiagnosisResult,
    FitResult,
    ThrusterResult,
    VehicleResult,
    write_result,
)
from seatrial.ident.validation import shown_inputs


def write_model(
    out: Path,
    result: FitResult,
    fit: Fit,
    ranges: Mapping[str, tuple[float, float]],
    effects_file: Path | None = None,
    calibration: float | None = None,
    rates: Mapping[str, float] | None = None,
    refits: Sequence[RefittedEffect] = (),
) -> None:
    """Write model.toml and result.json to a folder; existing files of these names are replaced.

    Parameters
    ----------
    out : Path
        Folder of the results; it is created if it does not exist.
    result : FitResult
        Content of result.json. Its provenance, the origin of x and y of its first estimation log that
        has one, and its calibration on validation data are also written to model.toml.
    fit : Fit
        Model and estimates for model.toml.
    ranges : mapping
        Lower and upper end of the range of each state and input in the data, by name, in the unit of the signal.
    effects_file : Path, optional
        Python file of user-defined effects, which model.toml then names.
    calibration : float, optional
        Relative standard uncertainty of the measured forces; by default unknown.
    rates : mapping, optional
        Sample rate [Hz] by name of the sensor; by default unknown.
    refits : sequence, optional
        Effects that a diagnosis tried, with their estimates, for model.toml.
    """
    out.mkdir(parents=True, exist_ok=True)
    logs, validation = (
        [f"{x.path} sha256:{x.sha256[:16]}" for x in result.logs if x.role == role]
        for role in ("estimation", "validation")
    )
    made = {"made_by": result.command, "created": result.created, "seatrial": result.seatrial, "logs": logs}
    if validation:
        made |= {"validation": validation, "selected": selected_effects(result)}
    made |= {"begins": [x.start or "" for x in result.logs if x.role == "estimation"]}
    origin = next((x.origin for x in result.logs if x.role == "estimation" and x.origin is not None), None)
    save_model(
        out / "model.toml",
        fit,
        data=FittedData(ranges, rates or {}, origin, intervals_of(result), _full_speed_of(result)),
        provenance=made,
        effects_file=effects_file,
        calibration=calibration,
        refits=refits,
    )
    write_result(result, out / "result.json")


def selected_effects(result: FitResult) -> list[str]:
    """Return the names of the effects that the validation logs of a fit have accepted.

    They are the effects that a diagnosis has found, and the common errors. Effects that the user has requested are not
    tested by validation data.
    """
    found = [e.name for e in result.effects] if isinstance(result, DiagnosisResult) else []
    common = result.common_errors if isinstance(result, (DiagnosisResult, VehicleResult)) else None
    return [*found, *(common.names if common is not None else ())]


def _full_speed_of(result: FitResult) -> float | None:
    """Return the shaft speed [rev/min] at n = 1 in the result of a thruster; None if unknown, and for other results."""
    return result.steady.rpm_max if isinstance(result, ThrusterResult) and result.steady is not None else None


def write_page(out: Path, result: FitResult) -> None:
    """Write report.html to the folder ``out``; an existing file is replaced."""
    write_report(result, out / "report.html")


def intervals_of(result: FitResult) -> IntervalCalibration | None:
    """Return the scales of the errors on the validation data, for model.toml; None without validation data.

    Parameters
    ----------
    result : FitResult
        Result of a fit. A scale that is null there is infinite, because a prediction diverged.
    """
    found = result.calibration.validation
    if found is None:
        return None

    def scales(rows: Mapping[str, CalibrationRow]) -> dict[str, ErrorScale]:
        """Return the scale by channel of one kind of prediction."""
        return {
            name: ErrorScale(np.inf if row.scale is None else row.scale, row.n_effective, row.n_records)
            for name, row in rows.items()
        }

    return IntervalCalibration(result.horizon_seconds, scales(found.horizon), scales(found.simulation))


def validity(fitted: FittedModel) -> dict[str, tuple[float, float]]:
    """Return the range of each velocity state (``u``, ``v``, ``r``) and input in the estimation data, for model.toml.

    The inputs are those that reports show (`shown_inputs`), for example without delayed taps, and the time ``t`` and
    the ``work`` of the thrusters if the model needs them. The range of a state is from the 1 % to the 99 % quantile of
    its filtered values, that of an input from its minimum to its maximum. An averaged input has its mean in each row,
    which never exceeds the values that were commanded.

    Parameters
    ----------
    fitted : FittedModel
        Fit with its estimation records.

    Returns
    -------
    dict
        Lower and upper end of each range by name, in the unit of the signal. If a name is both a state and an input,
        the range is that of the state.
    """
    found: dict[str, tuple[float, float]] = {}
    views = fitted.estimation
    for i, state in enumerate(fitted.model.states):
        if state.name in ("u", "v", "r"):
            z = np.concatenate([v.run.x_filt[:, i] for v in views])
            found[state.name] = (float(np.percentile(z, 1)), float(np.percentile(z, 99)))
    inputs = [given_inputs(fitted.model, v.record) for v in views]
    computed = [(j, i.name) for j, i in enumerate(fitted.model.inputs) if i.name in (TIME_INPUT, WORK_INPUT)]
    for j, name in [*((j, name) for j, name, _ in shown_inputs(fitted.model)), *computed]:
        z = np.concatenate([given[:, j] for given in inputs])
        # A yaw rate can be both input and state; the range of the state is kept.
        found.setdefault(name, (float(z.min()), float(z.max())))
    return found


def sensor_rates(fitted: FittedModel) -> dict[str, float]:
    """Return the sample rate [Hz] of each sensor in the estimation data, for model.toml.

    Parameters
    ----------
    fitted : FittedModel
        Fit with its estimation records.

    Returns
    -------
    dict
        Rate by name of the sensor. A sensor with fewer than two samples in each record is left out.

    Notes
    -----
    The rate is the inverse of the median interval, so gaps do not count. A sensor that is averaged has the rate of
    means of this length, because its estimated noise is that of a mean. It is the rate of the rows, unless the means
    are shorter than the distance of the rows. A search with 5 rows per second has means over 0.1 s: a fit, which has
    more rows, uses 10 of them per second.
    """
    found: dict[str, float] = {}
    for sensor in fitted.model.sensors:
        records = [v.record for v in fitted.estimation]
        seen = [r.t[np.isfinite(r.y[:, r.outputs.index(sensor.outputs[0].name)])] for r in records]
        between = np.concatenate([np.diff(t) for t in seen])
        if between.size:
            used = [r for r, t in zip(records, seen, strict=True) if t.size > 1]
            means = [r.meta.get("mean_rates", {}).get(sensor.name, 0.0) for r in used]
            found[sensor.name] = max(float(1.0 / np.median(between)), min(means))
    return found
