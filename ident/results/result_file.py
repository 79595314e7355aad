"""Results as files: the only functions that know JSON.

A result is a frozen ``Result``, filled once by a workflow. ``write_result`` and ``read_result`` are inverse: arrays
become lists, NaN and infinity become null, numbers keep seven significant digits; a missing, misspelt or mistyped key
is an error that names its path.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

from daq.errors import SeatrialError

FORMAT = "seatrial-result 2"
DIGITS = 7  # significant, of a number in a file


class Part(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table of a result: immutable, fields by keyword (subclasses say ``frozen=True`` again, for mypy).

    Array fields are annotated ``ident.numerics.Array`` (float64, time along the first axis); a number that may not
    exist is ``float | None``.
    """


class LogSummary(Part, frozen=True):
    """A log that a result was made from.

    ``role``: estimation, validation, navigated or judged; ``duration`` [s]; ``rig`` and ``mission``: their names.
    """

    path: str
    sha256: str
    role: str
    name: str
    duration: float
    rig: str | None = None
    mission: str | None = None
    warnings: tuple[str, ...] = ()


class Provenance(Part, frozen=True):
    """Where a result comes from: UTC time (ISO 8601), version of seatrial, the command line, the logs."""

    created: str
    seatrial: str
    command: str
    logs: tuple[LogSummary, ...] = ()


R = TypeVar("R", bound=Part)


def to_json(result: Part) -> bytes:
    """A result as JSON; UTF-8."""
    return msgspec.json.encode(_rounded(msgspec.to_builtins(result, enc_hook=_encode)))


def write_result(result: Part, path: Path) -> None:
    """Write a result as JSON. Raises SeatrialError where the file cannot be written."""
    try:
        path.write_bytes(to_json(result))
    except OSError as problem:
        raise SeatrialError(f"{path}: {problem.strerror}; the result was not saved") from problem


def read_result(path: Path, kind: type[R]) -> R:
    """Read a result of a kind. Raises SeatrialError with the path of the key that is missing, misspelt or mistyped."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind, dec_hook=_decode)
    except (msgspec.DecodeError, OSError) as problem:
        raise SeatrialError(f"{path}: {problem}") from problem


def _encode(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(f"a result cannot hold {type(value).__name__}")


def _decode(kind: Any, value: Any) -> Any:
    """Arrays: the only type that msgspec does not know; null becomes NaN."""
    if not isinstance(value, list):
        raise ValueError(f"expected a list of numbers, got {type(value).__name__}")
    return np.array(value, dtype=np.float64)


def _rounded(value: Any) -> Any:
    """Numbers to so many significant digits; NaN and infinity to None."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    if isinstance(value, list):
        return [_rounded(v) for v in value]
    if isinstance(value, dict):
        return {k: _rounded(v) for k, v in value.items()}
    return value
