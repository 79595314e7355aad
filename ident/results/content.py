"""From fits and diagnoses to result.json: the numbers, no drawing. Keys: docs/formats/result.md."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ident.data import TIME_INPUT, WORK_INPUT, LoadedLog, Record
from ident.estimation import Fit, FittedModel, HomogeneityTest, Profile, RecordEvaluation
from ident.model import Model, Parameter, segment_name
from ident.numerics import Array
from ident.validation import BLOCK, FreeRun, PredictionEvaluation, cross_correlation, ratio_interval, whiteness_test

Json = dict[str, Any]
FEWEST = 60  # samples of a channel whose residuals are tested
APART = 0.4  # a fit starts within a factor exp(+-APART) of the truth
BIAS, COVERAGE, VARIANCE = 0.15, (0.93, 0.97), 0.1  # what is wanted
AIMS = {"bias": (-BIAS, BIAS), "ratio": (1.0 - VARIANCE, 1.0 + VARIANCE), "coverage": COVERAGE}
KINDS = ("one_step", "ten_seconds", "free_run")  # the second is over the result's horizon, however long that is


def fit_part(fit: Fit, start: Mapping[str, float]) -> Json:
    """``fit``: parameters with errors, correlation, how the estimate went."""
    flags = dict(fit.flags)
    rows = []
    for p in fit.model.parameters:
        names = [segment_name(p.name, i) for i in range(len(fit.records))] if p.per_record and p.free else [p.name]
        for i, name in enumerate(names):
            value, error = fit.estimate(p.name, i)
            known = name in fit.names
            rows.append(
                {
                    "name": p.name,
                    "meaning": p.meaning,
                    "unit": p.unit,
                    "value": value,
                    "se": error,
                    "free": p.free,
                    "prior_share": float(fit.prior_weight[fit.names.index(name)]) if known else None,
                    "start": start.get(p.name),
                    "flag": flags.get(name),
                    "record": fit.records[i] if p.per_record and p.free and len(names) > 1 else None,
                }
            )
    return {
        "model": " + ".join([fit.model.name, *(e.name for e in fit.model.effects)]),
        "method": "PE" if fit.options.process_noise else "OE",
        "restricted": fit.options.reml,
        "second_order": fit.model.second_order,
        "converged": fit.converged,
        "message": fit.message,
        "log_likelihood": fit.log_likelihood,
        "iterations": fit.iterations,
        "cpu": fit.cpu_seconds,
        "parameters": rows,
        "correlation": {"names": list(fit.names), "matrix": fit.correlation},
    }


def shown_inputs(model: Model) -> list[tuple[int, str, str]]:
    """Column, name and unit of the inputs that people look at: not an input's own past, and of the delayed copies of a
    thruster's command the command itself."""
    shown = []
    for j, i in enumerate(model.inputs):
        label = i.name if i.label is None else i.label
        if label and i.name not in (TIME_INPUT, WORK_INPUT):
            shown.append((j, label, i.unit))
    return shown


def input_traces(model: Model, record: Record) -> list[Json]:
    """The inputs as the model saw them."""
    return [
        {"record": record.name, "name": name, "unit": unit, "t": record.t, "value": record.u[:, j]}
        for j, name, unit in shown_inputs(model)
    ]


def residual_part(model: Model, record: Record, eps: Array) -> tuple[list[Json], list[Json]]:
    """``residuals`` and ``cross`` of one record from its standardised innovations (n_rows, n_outputs). A channel of
    fewer than 60 samples, or whose innovations are all the same, is left out."""
    residuals, cross = [], []
    for j, o in enumerate(model.outputs):
        good = np.isfinite(eps[:, j])
        if good.sum() < FEWEST or not np.ptp(eps[good, j]):
            continue
        t, e = record.t[good], eps[good, j]
        residuals.append({"record": record.name, "channel": o.name, "unit": o.unit, **_whiteness_row(o.name, t, e)})
        for k, name, _ in shown_inputs(model):
            c = cross_correlation(o.name, t, e, name, record.t, record.u[:, k])
            cross.append(
                {
                    "record": record.name,
                    "channel": o.name,
                    "input": name,
                    "lags": c.lags,
                    "z": c.z,
                    "p": c.p,
                    "after": None,
                }
            )
    return residuals, cross


def _whiteness_row(name: str, t: Array, e: Array) -> Json:
    w = whiteness_test(name, t, e)
    return {
        "t": t,
        "e": e,
        "lags": float(np.median(np.diff(t))) * np.arange(1, w.acf.size + 1),
        "acf": w.acf,
        "band": w.band,
        "ljung_box_p": w.ljung_box,
        "periodogram_p": w.periodogram,
        "frequency": w.frequency,
        "cumulative": w.cumulative,
        "normal_p": w.normal,
        "white": w.white,
        "after": None,
    }


def merge_before_after(before: list[Json], after: list[Json], keys: Sequence[str], kept: Sequence[str]) -> list[Json]:
    """Put what changed under ``after`` into the rows of ``before`` with the same keys."""
    later = {tuple(row[k] for k in keys): row for row in after}
    for row in before:
        match = later.get(tuple(row[k] for k in keys))
        if match is not None:
            row["after"] = {k: match[k] for k in kept}
    return before


def parameter_row(p: Parameter, value: float, error: float) -> Json:
    return {"name": p.name, "meaning": p.meaning, "unit": p.unit, "value": value, "se": error}


def format_number(value: float) -> str:
    """Two digits for a sentence: 113, 8.4, 0.66."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:#.2g}".rstrip(".")


def to_json(value: Any) -> Any:
    """Arrays to lists, NaN and infinities to null, JSON having no others; numbers keep seven significant digits."""
    if isinstance(value, Mapping):
        return {str(k): to_json(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return _rounded(value) if value.dtype.kind == "f" else to_json(value.tolist())
    if isinstance(value, (list, tuple)):
        return [to_json(v) for v in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(f"{value:.7g}") if math.isfinite(value) else None
    return value


def _rounded(value: NDArray[np.floating[Any]]) -> Any:
    """As ``plain``, all at once: traces are a million numbers."""
    finite = np.isfinite(value)
    exact = np.where(finite, value, 0.0).astype(np.float64)
    digits = 6 - np.floor(np.log10(np.where(exact != 0, np.abs(exact), 1.0)))
    far = np.abs(digits) > 22  # powers of ten are exact up to there
    digits = np.where(far, 0, digits)
    up, down = 10.0 ** np.maximum(digits, 0), 10.0 ** np.maximum(-digits, 0)
    found = np.round(exact * up / down) / up * down
    found[far] = [float(f"{v:.7g}") for v in exact[far]]
    numbers: Any = found if finite.all() else np.where(finite, found, None)
    return numbers.tolist()


def calibration_part(judged: PredictionEvaluation, roles: Sequence[str]) -> Json:
    """``calibration``: role -> horizon -> channel."""
    return {
        role: {
            kind: {name: vars(c) | {"verdict": c.verdict} for name, c in channels.items()}
            for kind, channels in judged.calibration(role).items()
        }
        for role in roles
    }


def calibration_notes(part: Json, horizon: float) -> list[str]:
    """A line for each kind of prediction whose bands are wrong, on data that the fit has not seen where there are some;
    ``horizon``: s."""
    role = "validation" if "validation" in part else "estimation"
    words = {"one_step": "one step ahead", "ten_seconds": f"{horizon:g} s ahead", "free_run": "free-running"}
    notes = []
    for verdict, what in (("too sure", "larger"), ("too cautious", "smaller")):
        for kind, channels in part[role].items():
            wrong = [f"{n} {c['scale']:.2g}" for n, c in channels.items() if c["verdict"] == verdict]
            if wrong:
                notes.append(f"On {role} data, {words[kind]}, errors are {what} than the model says, by these factors: "
                             f"{', '.join(wrong)}.")
    return notes


def evaluation_section(judged: PredictionEvaluation) -> Json:
    """Traces, errors and residuals of one fitted model, with nothing before it."""
    roles = ["estimation"] + (["validation"] if judged.stage.validation else [])
    units = {o.name: o.unit for o in judged.stage.model.outputs}
    table = {
        role: {
            kind: {
                name: {
                    "before": None,
                    "after": e.rms,
                    "unit": units[name],
                    "low": None,
                    "high": None,
                    "spread": e.spread,
                }
                for name, e in rows.items()
            }
            for kind, rows in judged.errors(role).items()
        }
        for role in roles
    }
    calibrated = calibration_part(judged, roles)
    return {
        "horizon": judged.horizon,
        "before_after": table,
        "calibration": calibrated,
        **traces(judged, judged, roles, False),
        **_residuals(judged.stage),
    }


def _residuals(stage: FittedModel) -> Json:
    parts = [residual_part(stage.model, v.record, v.run.standardised) for v in stage.estimation]
    residuals, cross = ([row for part in parts for row in part[k]] for k in (0, 1))
    return {"residuals": residuals, "cross": cross}


def comparison_section(before: PredictionEvaluation, after: PredictionEvaluation, role: str) -> Json:
    """Root mean square errors by kind and channel, with the interval of their ratio."""
    units = {o.name: o.unit for o in after.stage.model.outputs}
    old_errors, new_errors = before.errors(role), after.errors(role)
    table: Json = {}
    for kind in KINDS:
        table[kind] = {}
        # errors over a horizon hang together for as long as it lasts
        block = max(BLOCK, after.horizon) if kind == "ten_seconds" else BLOCK
        for name, old in old_errors[kind].items():
            new = new_errors[kind][name]
            low, high = ratio_interval(old, new, block=block)
            table[kind][name] = {
                "before": old.rms,
                "after": new.rms,
                "unit": units[name],
                "low": low,
                "high": high,
                "spread": old.spread,
            }
    return table


def traces(before: PredictionEvaluation, after: PredictionEvaluation, roles: Sequence[str], changed: bool) -> Json:
    """``traces``, ``track`` and ``inputs`` of every record; ``changed``: before is another model than after."""
    rows, tracks, inputs = [], [], []
    for role in roles:
        for view, old, new in zip(after.views(role), before.free[role], after.free[role], strict=True):
            model, record = after.stage.model, view.record
            inputs += input_traces(model, record)
            for j, o in enumerate(model.outputs):
                seen = np.isfinite(record.y[:, j])
                if seen.any():
                    rows.append(
                        {
                            "record": record.name,
                            "role": role,
                            "channel": o.name,
                            "unit": o.unit,
                            "angle": o.angle,
                            "t": record.t[seen],
                            "measured": record.y[seen, j],
                            "model": new.y[seen, j],
                            "sd": new.sd[seen, j],
                            "before": old.y[seen, j] if changed else None,
                        }
                    )
            tracks += _track(model, view, role, old if changed else None, new)
    return {"traces": rows, "track": tracks, "inputs": inputs}


def _track(model: Model, view: RecordEvaluation, role: str, old: FreeRun | None, new: FreeRun) -> list[Json]:
    names = [o.name for o in model.outputs]
    if "x" not in names or not np.isfinite(view.record.y[:, names.index("x")]).any():
        return []
    i, j = names.index("x"), names.index("y")
    seen = np.isfinite(view.record.y[:, i])
    return [
        {
            "record": view.record.name,
            "role": role,
            "x_measured": view.record.y[seen, i],
            "y_measured": view.record.y[seen, j],
            "x_model": new.y[seen, i],
            "y_model": new.y[seen, j],
            "x_before": old.y[seen, i] if old else None,
            "y_before": old.y[seen, j] if old else None,
        }
    ]


def profile_part(found: Profile) -> dict[str, Any]:
    """A row of ``profiles`` in result.json."""
    return {
        "name": found.name, "unit": found.unit, "value": found.value, "grid": found.grid, "drop": found.drop,
        "low": found.low, "high": found.high, "wald_low": found.wald_low, "wald_high": found.wald_high,
        "notes": list(found.notes),
    }


def agreement_part(a: HomogeneityTest) -> Json:
    """The row of ``agreement`` in result.json."""
    return {
        "name": a.name,
        "unit": a.unit,
        "value": a.value,
        "se": a.error,
        "se_robust": a.robust_error,
        "records": list(a.records),
        "values": a.values,
        "ses": a.errors,
        "lr": a.lr,
        "df": a.df,
        "p": a.p,
        "agree": a.agree,
        "scatter": a.scatter,
        "mean": a.mean,
        "se_mean": a.mean_error,
        "low": a.interval[0],
        "high": a.interval[1],
    }


def envelope(loaded: Sequence[LoadedLog], command: str) -> Json:
    """What every result says of where it came from."""
    return {
        "format": "seatrial-result 1",
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "seatrial": version("seatrial"),
        "command": command,
        "logs": [x.about for x in loaded],
    }
