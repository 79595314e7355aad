"""Results as files: the only functions that know JSON.

A result is a frozen ``Result``, filled once by a workflow. ``write_result`` and ``read_result`` are inverse: arrays
become lists, NaN and infinity become null, numbers keep seven significant digits but where a part is ``exact``; a
missing, misspelt or mistyped key is an error that names its path.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.daq.files import write_output
from seatrial.ident.numerics import Array
from seatrial.ident.results.commands import DesignResult, InformationResult, NavigationResult, NoiseResult, StudyResult
from seatrial.ident.results.parts import DiagnosisResult, Part, ThrustCurveResult, ThrusterResult, VehicleResult

DIGITS = 7  # significant, of a number in a file
EXACT = 22  # powers of ten are exact up to there

AnyResult = (
    VehicleResult
    | ThrusterResult
    | ThrustCurveResult
    | DiagnosisResult
    | NoiseResult
    | NavigationResult
    | InformationResult
    | DesignResult
    | StudyResult
)


def to_json(result: Part) -> bytes:
    """A result as JSON; UTF-8."""
    return msgspec.json.encode(_plain(result))


def write_result(result: Part, path: Path) -> None:
    """Write a result as JSON. Raises SeatrialError where the file cannot be written."""
    try:
        write_output(path, to_json(result))
    except OSError as problem:
        raise SeatrialError(f"{path}: {problem.strerror}; the result was not saved") from problem


def from_json(content: bytes) -> AnyResult:
    """The inverse of ``to_json``, by the key ``kind``. Raises msgspec.DecodeError with the path of the key that is
    missing, misspelt or mistyped."""
    found: AnyResult = msgspec.json.decode(content, type=AnyResult, dec_hook=_decode)
    return found


def read_result(path: Path | str) -> AnyResult:
    """Read a result.json. Raises SeatrialError with the path of the key that is missing, misspelt or mistyped."""
    path = Path(path)
    try:
        return from_json(path.read_bytes())
    except (msgspec.DecodeError, OSError) as problem:
        raise SeatrialError(f"{path}: {problem}") from problem


def _decode(kind: Any, value: Any) -> Any:
    """Arrays: the only type that msgspec does not know; null becomes NaN."""
    if not isinstance(value, list):
        raise ValueError(f"expected a list of numbers, got {type(value).__name__}")
    return np.array(value, dtype=np.float64)


def _plain(value: Any) -> Any:
    """What JSON has: parts as objects, arrays as lists; numbers to so many significant digits, NaN and infinity as
    None."""
    if isinstance(value, Part) and value.exact:
        return msgspec.structs.asdict(value)
    if isinstance(value, Part):
        config = type(value).__struct_config__
        kind = {} if config.tag is None else {str(config.tag_field): config.tag}
        return kind | {name: _plain(getattr(value, name)) for name in value.__struct_fields__}
    if isinstance(value, np.ndarray):
        return msgspec.Raw(msgspec.json.encode(_rounded(value)))  # a list of Python numbers takes three times as much
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    return value


def _rounded(value: Array) -> Any:
    """As ``_plain``, all at once: traces are a million numbers."""
    finite = np.isfinite(value)
    exact = np.where(finite, value, 0.0).astype(np.float64)
    digits = DIGITS - 1 - np.floor(np.log10(np.where(exact != 0, np.abs(exact), 1.0)))
    far = np.abs(digits) > EXACT
    digits = np.where(far, 0, digits)
    up, down = 10.0 ** np.maximum(digits, 0), 10.0 ** np.maximum(-digits, 0)
    found = np.round(exact * up / down) / up * down
    found[far] = [float(f"{v:.{DIGITS}g}") for v in exact[far]]
    numbers: Any = found if finite.all() else np.where(finite, found, None)
    return numbers.tolist()
