"""From fits and diagnoses to result.json: the numbers, no drawing. Keys: docs/formats/result.md."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ident.data import LoadedLog, Record
from ident.model import Model
from ident.validation import shown_inputs

Json = dict[str, Any]
APART = 0.4  # a fit starts within a factor exp(+-APART) of the truth
BIAS, COVERAGE, VARIANCE = 0.15, (0.93, 0.97), 0.1  # what is wanted
AIMS = {"bias": (-BIAS, BIAS), "ratio": (1.0 - VARIANCE, 1.0 + VARIANCE), "coverage": COVERAGE}


def input_traces(model: Model, record: Record) -> list[Json]:
    """The inputs as the model saw them."""
    return [
        {"record": record.name, "name": name, "unit": unit, "t": record.t, "value": record.u[:, j]}
        for j, name, unit in shown_inputs(model)
    ]


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


def envelope(loaded: Sequence[LoadedLog], command: str) -> Json:
    """What every result says of where it came from."""
    return {
        "format": "seatrial-result 2",
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "seatrial": version("seatrial"),
        "command": command,
        "logs": [x.about for x in loaded],
    }
