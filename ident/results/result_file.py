"""Reader and writer of result.json, and of the Parquet file of its curves.

A result is a frozen ``Result`` that a workflow fills once. ``read_result`` inverts ``write_result``, except for the
rounding. Arrays become lists, and NaN and infinity become null. Numbers keep seven significant digits; the origin of
the NED frame keeps all. A required key that is missing, and a key that is misspelt or of a wrong type, is an error that
contains the path of the key.
"""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from seatrial.daq.errors import SeatrialError, warn
from seatrial.daq.files import write_output
from seatrial.ident.data import FrameOrigin
from seatrial.ident.numerics import Array
from seatrial.ident.results.campaigns import CampaignsResult
from seatrial.ident.results.commands import (
    DesignResult,
    FleetResult,
    InformationResult,
    NavigationResult,
    NoiseResult,
    SegmentInformation,
    StudyResult,
)
from seatrial.ident.results.comparison import ComparisonResult
from seatrial.ident.results.curves import moved_fields, read_parquet, stub, to_parquet, with_curves
from seatrial.ident.results.parts import (
    FORMAT,
    Correlation,
    CurvesFile,
    DiagnosisResult,
    Homogeneity,
    Part,
    Result,
    StaticForce,
    ThrustCurveResult,
    ThrusterResult,
    VehicleResult,
)

READABLE = ("seatrial-result 2",)  # earlier formats that are still read
DIGITS = 7  # significant digits of a number in a file
EXACT = (FrameOrigin,)  # types whose numbers keep all digits: seven digits of a latitude are 10 m
TABLES = (Correlation, Homogeneity, SegmentInformation, StaticForce)  # types whose arrays are small tables, not traces
EXACT_POWER = 22  # powers of ten up to this exponent are exact in float64

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
    | FleetResult
    | CampaignsResult
    | ComparisonResult
)


def to_json(result: Part, traces: bool = True) -> bytes:
    """Return a result, or a table of a result, as JSON in UTF-8.

    Keys are in the order of the fields; that of the type, ``kind``, is the first. NaN and infinity become null. Numbers
    keep seven significant digits; an origin of the NED frame (latitude and longitude) keeps all.

    Parameters
    ----------
    result
        Result of a command, or a table of a result.
    traces
        Whether to include traces: all arrays except those of the small tables in ``TABLES``, for example samples over
        time, frequency or another variable, which the figures of a report show. Without them a result is much shorter,
        and ``from_json`` does not read it if a required array is missing.
    """
    return msgspec.json.encode(_as_json_types(result if traces else _without_traces(result)))


def _without_traces(value: Any) -> Any:
    """Return a result, or any value in it, as dicts and lists without arrays.

    A table of a type in EXACT or TABLES is returned unchanged, with its arrays.
    """
    if isinstance(value, (*EXACT, *TABLES)):
        return value
    if isinstance(value, msgspec.Struct):
        config = type(value).__struct_config__
        kind = {} if config.tag is None else {str(config.tag_field): config.tag}
        fields = {name: getattr(value, name) for name in value.__struct_fields__}
        return kind | _without_traces(fields)
    if isinstance(value, dict):
        return {k: _without_traces(v) for k, v in value.items() if not isinstance(v, np.ndarray)}
    if isinstance(value, list | tuple):
        return [_without_traces(v) for v in value if not isinstance(v, np.ndarray)]
    return value


def write_result(result: Result, path: Path) -> None:
    """Write a result to a JSON file (result.json), and its curves to a Parquet file beside it (result.parquet).

    Existing files are replaced. There is no Parquet file for a result without curves. If the package pyarrow is not
    installed, there is none either, and the JSON has the curves. A Parquet file of an earlier result is deleted then.

    Parameters
    ----------
    result
        Result of a command.
    path
        File to write, in a folder that exists. The Parquet file has its name with the ending ``.parquet``.

    Raises
    ------
    SeatrialError
        If a file cannot be written.
    """
    beside = path.with_suffix(".parquet")
    try:
        curves = to_parquet(result)
        if curves is None:
            beside.unlink(missing_ok=True)  # otherwise the curves of an earlier result would remain
        else:
            write_output(beside, curves)
            name = CurvesFile(file=beside.name, sha256=hashlib.sha256(curves).hexdigest())
            result = msgspec.structs.replace(result, curves_file=name)
        write_output(path, msgspec.json.encode(_as_json_types(result, stubs=curves is not None)))
    except OSError as problem:
        raise SeatrialError(
            f"{path}: {problem.strerror}; the result was not saved, check that the folder exists and is writable"
        ) from problem


def from_json(content: bytes, folder: Path | None = None) -> AnyResult:
    """Return the result whose JSON `write_result` or ``to_json`` wrote. Its key ``kind`` selects the type.

    Parameters
    ----------
    content
        JSON in UTF-8, of format 3 or 2.
    folder
        Folder of the Parquet file with the curves. None, or a folder without this file: the curves are empty.

    Raises
    ------
    msgspec.DecodeError
        If the content is not JSON, if a required key is missing, or if a key is misspelt or of a wrong type. The
        message contains the path of the key.
    SeatrialError
        If the Parquet file belongs to another result, or if it is there and the package pyarrow is missing.
    """
    raw = msgspec.json.decode(content)
    if isinstance(raw, dict):
        named = raw.get("curves_file")
        if isinstance(named, dict) and isinstance(named.get("file"), str):
            # Only the name is used: a result from elsewhere must not name a file in another folder.
            beside = None if folder is None else folder / Path(named["file"]).name
            raw = with_curves(raw, _curves_beside(beside, str(named.get("sha256", "")))) | {"curves_file": None}
        if raw.get("format") in READABLE:  # the formats differ only in the place of the curves
            raw["format"] = FORMAT
    found: AnyResult = msgspec.convert(raw, type=AnyResult, dec_hook=_decode_array)
    return found


def _curves_beside(path: Path | None, sha256: str) -> dict[str, Array]:
    """Return the curves in the Parquet file of a result. If the file is missing, warn and return an empty dict.

    ``path`` is None if the folder of the file is unknown; the dict is then empty too, without a warning. ``sha256`` is
    that of the file of the result.
    """
    if path is None:
        return {}
    try:
        return read_parquet(path, sha256)
    except FileNotFoundError:
        warn(f"{path}: is missing, so the result has no curves over time; copy this file beside the result.json")
        return {}


def read_result(path: Path | str) -> AnyResult:
    """Read a result.json with the Parquet file of its curves, and return the result.

    Its key ``kind`` selects the type, for example ``vehicle``. Files of format 2, which have their curves in the JSON,
    are read too. Without the Parquet file, the curves are empty and a `SeatrialWarning` names it.

    Raises
    ------
    SeatrialError
        If a file cannot be read or is not JSON, if the Parquet file belongs to another result, if a required key is
        missing, or if a key is misspelt or of a wrong type. The message contains the file and the path of the key.
    """
    path = Path(path)
    try:
        return from_json(path.read_bytes(), path.parent)
    except (msgspec.DecodeError, OSError) as problem:
        raise SeatrialError(
            f"{path}: {problem}; give a result.json that this version of seatrial has written"
        ) from problem


def _decode_array(kind: Any, value: Any) -> Any:
    """Convert a list of numbers from result.json to a float64 array, in which null becomes NaN.

    msgspec calls this function for the type of arrays, the only type that it does not decode itself; ``kind`` is this
    type and is not used. An array, from the Parquet file, is returned unchanged. Raise ValueError if the value is not a
    list, or if it contains, for example, text that is no number or lists of different lengths.
    """
    if isinstance(value, np.ndarray):
        return value
    if not isinstance(value, list):
        raise ValueError(f"expected a list of numbers, got {type(value).__name__}")
    return np.array(value, dtype=np.float64)


def _as_json_types(value: Any, stubs: bool = False) -> Any:
    """Convert a result, or any value in it, to the types of JSON, recursively.

    ``stubs``: whether the arrays of the curves become stubs, as their numbers are in the Parquet file.

    A table becomes a dict of its fields; a type of result has its ``kind`` first. An array becomes a list, already
    encoded. Numbers are rounded to seven significant digits, except those of the types in ``EXACT``. NaN and infinity
    become None. Values that JSON has (text, integer, bool, None) are returned unchanged.
    """
    if isinstance(value, EXACT):
        return msgspec.structs.asdict(value)
    if isinstance(value, msgspec.Struct):
        config = type(value).__struct_config__
        kind = {} if config.tag is None else {str(config.tag_field): config.tag}
        moved = moved_fields(value) if stubs and isinstance(value, Part) else frozenset()
        return kind | {
            name: stub(item) if name in moved and item is not None else _as_json_types(item, stubs)
            for name in value.__struct_fields__
            for item in (getattr(value, name),)
        }
    if isinstance(value, np.ndarray):
        # Encoded here, because a list of Python numbers takes three times the memory.
        return msgspec.Raw(msgspec.json.encode(_rounded(value)))
    if isinstance(value, dict):
        return {k: _as_json_types(v, stubs) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_as_json_types(v, stubs) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    return value


def _rounded(value: Array) -> Any:
    """Round an array of a result to seven significant digits and convert it to nested lists for JSON.

    NaN and infinity become None. The rounding is vectorised, because the curves of a result may contain a million
    numbers.
    """
    finite = np.isfinite(value)
    exact = np.where(finite, value, 0.0).astype(np.float64)
    digits = DIGITS - 1 - np.floor(np.log10(np.where(exact != 0, np.abs(exact), 1.0)))
    far = np.abs(digits) > EXACT_POWER
    digits = np.where(far, 0, digits)
    up, down = 10.0 ** np.maximum(digits, 0), 10.0 ** np.maximum(-digits, 0)
    found = np.round(exact * up / down) / up * down
    found[far] = [float(f"{v:.{DIGITS}g}") for v in exact[far]]
    numbers: Any = found if finite.all() else np.where(finite, found, None)
    return numbers.tolist()
