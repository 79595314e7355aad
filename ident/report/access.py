"""Reading result.json with patience: what is missing, null or of the wrong shape is simply not there."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ident.numerics import Array
from ident.report.record_tabs import ROLES, RecordTab

Row = Mapping[str, Any]


def group(owner: Row, key: str) -> Row:
    """A nested object, or an empty one."""
    value = owner.get(key)
    return value if isinstance(value, Mapping) else {}


def rows(owner: Row, key: str) -> list[Row]:
    """A list of objects, or an empty one."""
    value = owner.get(key)
    return [row for row in value if isinstance(row, Mapping)] if isinstance(value, list | tuple) else []


def text(owner: Row, key: str) -> str:
    """A text or a number as text; empty where there is none."""
    value = owner.get(key)
    return "" if value is None or isinstance(value, Mapping | list | tuple) else str(value)


def texts(owner: Row, key: str) -> list[str]:
    """A list of texts; a lone text counts as a list of one."""
    value = owner.get(key)
    if isinstance(value, str):
        return [value]
    return [str(item) for item in value if item is not None] if isinstance(value, list | tuple) else []


def number(owner: Row, key: str) -> float | None:
    """A finite number, or None."""
    value = owner.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        return None
    return float(value) if math.isfinite(value) else None


def flag(owner: Row, key: str) -> bool | None:
    """True, False, or None where nothing is said."""
    value = owner.get(key)
    return bool(value) if isinstance(value, bool | np.bool_) else None


def array(owner: Row, key: str) -> Array | None:
    """Numbers (n,) with NaN for null; None where there is not one finite number."""
    value = owner.get(key)
    if not isinstance(value, list | tuple | np.ndarray):
        return None
    try:
        found = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        return None
    return found if found.ndim == 1 and np.isfinite(found).any() else None


def matrix(owner: Row, key: str, n: int) -> Array | None:
    """Numbers (n, n) with NaN for null, or None."""
    try:
        found = np.asarray(owner.get(key), dtype=float)
    except (TypeError, ValueError):
        return None
    return found if found.shape == (n, n) else None


def along(owner: Row, base: str, *keys: str) -> tuple[Array, list[Array | None]] | None:
    """The array ``base`` and those of ``keys`` that are as long as it; None without base or any of them."""
    x = array(owner, base)
    if x is None:
        return None
    found = [array(owner, key) for key in keys]
    same = [a if a is not None and a.size == x.size else None for a in found]
    return (x, same) if any(a is not None for a in same) else None


def takes(result: Row, key: str) -> list[RecordTab]:
    """The records that have rows under ``key``, validation before estimation, else in the file's order."""
    roles = {text(row, "name"): text(row, "role") for row in rows(result, "logs")}
    for part in ("traces", "track"):
        roles |= {text(row, "record"): text(row, "role") for row in rows(result, part) if text(row, "role")}
    names = list(dict.fromkeys(text(row, "record") for row in rows(result, key)))
    order = {role: i for i, role in enumerate(ROLES)}
    return sorted((RecordTab(n, roles.get(n, "")) for n in names), key=lambda take: order.get(take.role, len(order)))


def of_take(result: Row, key: str, take: RecordTab) -> list[Row]:
    """The rows of one record."""
    return [row for row in rows(result, key) if text(row, "record") == take.name]
