"""From fits and diagnoses to result.json: the numbers, no drawing. Keys: docs/formats/result.md."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ident.dataset import Record
from ident.fit import Fit
from ident.model import Model
from ident.params import Parameter
from ident.residuals import cross_correlation, whiteness

Array = NDArray[np.float64]
Json = dict[str, Any]
FEWEST = 60  # samples of a channel whose residuals are tested


def fit_part(fit: Fit, start: Mapping[str, float]) -> Json:
    """``fit``: parameters with errors, correlation, how the estimate went."""
    flags = dict(fit.flags)
    rows = []
    for p in fit.model.parameters:
        names = [f"{p.name}@{i}" for i in range(len(fit.records))] if p.per_record and p.free else [p.name]
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
        "method": fit.method.upper(),
        "restricted": fit.restricted,
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
        if "~" in i.name or i.name in ("t", "work"):
            continue
        if "bench" not in model.provides:
            shown.append((j, i.name, i.unit))
        elif i.name == "n_cmd_0":
            shown.append((j, "n_cmd", i.unit))
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
    w = whiteness(name, t, e)
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


def join_after(before: list[Json], after: list[Json], keys: Sequence[str], kept: Sequence[str]) -> list[Json]:
    """Put what changed under ``after`` into the rows of ``before`` with the same keys."""
    later = {tuple(row[k] for k in keys): row for row in after}
    for row in before:
        match = later.get(tuple(row[k] for k in keys))
        if match is not None:
            row["after"] = {k: match[k] for k in kept}
    return before


def parameter_row(p: Parameter, value: float, error: float) -> Json:
    return {"name": p.name, "meaning": p.meaning, "unit": p.unit, "value": value, "se": error}


def said(value: float) -> str:
    """Two digits for a sentence: 113, 8.4, 0.66."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:#.2g}".rstrip(".")


def write_result(content: Json, path: Path) -> None:
    """``content``: as of ``plain``."""
    path.write_text(json.dumps(content, separators=(",", ":"), allow_nan=False), encoding="utf-8")


def plain(value: Any) -> Any:
    """Arrays to lists, NaN and infinities to null, JSON having no others; numbers keep seven significant digits."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return _rounded(value) if value.dtype.kind == "f" else plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
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
