"""Calls of the Python interface as text, for the provenance of their results."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from inspect import Parameter, signature
from pathlib import Path
from typing import Any

import numpy as np

from seatrial.api.arguments import shortened
from seatrial.api.logs import Log, as_list

LOGS = ("logs", "validate", "before", "after")  # arguments that are logs, of which the names of the files are shown
MOST_LOGS = 20  # logs of one argument that are listed; of more, the number is shown


def python_call(function: Callable[..., Any], given: Mapping[str, Any]) -> str:
    """Return the call of a function as text, such as ``seatrial.fit(['run1.mcap'], validate=['run3.mcap'])``.

    A fitted model is the call that fitted it, and a loaded one that which loads it. Logs are the names of their files,
    whose folder and hash are beside the call in a result, and a window is that of ``seatrial.open_log``. More than 20
    logs are their number. The line repeats the run in the folder of the logs.

    Parameters
    ----------
    function : callable
        A function of `seatrial`.
    given : dict
        Its arguments by name, with those of ``**options``. An argument that equals its default is left out.
    """
    parameters = signature(function).parameters
    parts = []
    for name in (*(n for n in parameters if n in given), *(n for n in given if n not in parameters)):
        default = parameters[name].default if name in parameters else Parameter.empty
        if is_default(given[name], default):
            continue
        text = logs_as_code(given[name]) if name in LOGS else as_code(given[name])
        parts.append(text if name in parameters and default is Parameter.empty else f"{name}={text}")
    return f"seatrial.{function.__name__}({', '.join(parts)})"


def is_default(value: Any, default: Any) -> bool:
    """Return whether the value of an argument is its default. No sequence, as without logs, equals another one."""
    if value is default:
        return True
    if isinstance(default, tuple) and isinstance(value, list | tuple):
        return list(value) == list(default)
    return isinstance(value, str | int | float) and type(value) is type(default) and bool(value == default)


def logs_as_code(logs: Any) -> str:
    """Return logs as Python code: a list of the names of their files, or of calls that open a window."""
    several = as_list(logs)
    if len(several) > MOST_LOGS:
        return f"[{len(several)} logs]"
    return f"[{', '.join(map(_log_as_code, several))}]"


def _log_as_code(log: Any) -> str:
    """Return one log as Python code: the name of its file, or the call that opens its window."""
    if not isinstance(log, Log):
        return repr(Path(log).name)
    start = f", start={float(log.start)!r}" if log.start > 0.0 else ""
    end = f", end={float(log.end)!r}" if math.isfinite(log.end) else ""
    name = repr(log.path.name)
    return f"seatrial.open_log({name}{start}{end})" if start or end else name


def as_code(value: Any) -> str:
    """Return the value of an argument as Python code. A value without such a form is described by its type."""
    from seatrial.api.fits import FittedResult
    from seatrial.api.loading import Saved

    if isinstance(value, FittedResult):
        return value.result.command
    if isinstance(value, Saved):
        return f"seatrial.load({str(value.path)!r})"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key!r}: {as_code(x)}" for key, x in value.items()) + "}"
    if isinstance(value, np.ndarray | np.generic):
        return as_code(value.tolist())
    if isinstance(value, list):
        return f"[{', '.join(map(as_code, value))}]"
    if isinstance(value, tuple):
        return f"({', '.join(map(as_code, value))}{',' * (len(value) == 1)})"
    if isinstance(value, Path):
        return repr(str(value))
    return repr(value) if value is None or isinstance(value, str | int | float) else shortened(value)
