"""Names of the data that judge a model, for texts and labels: those of validation logs, or blocks of time without them.

Texts are written for validation logs. A diagnosis without such logs predicts each block of time of the estimation logs
by a fit to the other blocks, and its texts name these blocks (`of_judging_data`).
"""

from __future__ import annotations

from typing import Any, TypeVar

import msgspec

from seatrial.ident.results import parts

BLOCKS = "blocks of time"
T = TypeVar("T")


def judged_by_blocks(result: parts.FitResult) -> bool:
    """Return whether blocks of time of the estimation logs judge the model of a result, in place of validation logs."""
    if isinstance(result, parts.DiagnosisResult):
        return result.cross_validated
    return all(log.role != "validation" for log in result.logs)


def data_name(role: str, in_blocks: bool) -> str:
    """Return the name of the data of a role: "estimation data", "validation data", or "blocks of time" for the last.

    ``in_blocks``: whether blocks of time take the place of validation logs.
    """
    return BLOCKS if in_blocks and role == "validation" else f"{role} data"


def of_judging_data(value: T, in_blocks: bool) -> T:
    """Return a text, or a row or tuple with texts, in which the validation data have the name that they should have.

    The value is unchanged unless blocks of time take the place of validation logs (``in_blocks``).
    """
    return _renamed(value) if in_blocks else value


def _renamed(value: Any) -> Any:
    """Return a value with "blocks of time" in place of "validation data" in its texts."""
    if isinstance(value, str):
        return value.replace("validation data", BLOCKS).replace("Validation data", BLOCKS.capitalize())
    if type(value) in (tuple, list):
        return type(value)(_renamed(v) for v in value)
    if isinstance(value, msgspec.Struct):
        fields = {name: getattr(value, name) for name in value.__struct_fields__}
        changed = {name: new for name, old in fields.items() if (new := _renamed(old)) is not old}
        return msgspec.structs.replace(value, **changed) if changed else value
    return value
