"""The result of `seatrial ident information`."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from ident.numerics import Array
from ident.results.parts import InputTrace, Part, Result


class LogSpan(Part, frozen=True, kw_only=True):
    """A part of a log."""

    record: str
    t_from: Annotated[float, Meta(description="[s of the log]")]
    t_to: Annotated[float, Meta(description="[s of the log]")]
    what: Annotated[str, Meta(description="the step of the mission that takes up most of it, or empty")]


class InformedParameter(LogSpan, frozen=True, kw_only=True):
    """What all logs tell of a parameter, and the segment that this hangs on most."""

    name: str
    meaning: str
    unit: str
    value: float
    se: Annotated[float | None, Meta(description="standard error from all logs; null: nothing tells")]
    weight: Annotated[
        float | None, Meta(description="factor by which `se` would grow without the segment; null: nothing else tells")
    ]
    alone: Annotated[float | None, Meta(description="standard error from the segment alone; null: it tells nothing")]


class SegmentInformation(LogSpan, frozen=True, kw_only=True):
    """What a segment tells of each parameter, in the order of `names`; null: no number."""

    weight: Annotated[
        Array, Meta(description="factors by which standard errors would grow without it; null: nothing else tells")
    ]
    lost: Annotated[Array, Meta(description="part of the information that would be lost without it, 0..1")]
    alone: Annotated[Array, Meta(description="standard errors from it alone; null: it tells nothing")]


class Information(Part, frozen=True, kw_only=True):
    """Which segments of logs tell of which parameter."""

    names: Annotated[tuple[str, ...], Meta(description="of the parameters")]
    seconds: Annotated[float, Meta(description="length of a segment [s]")]
    parameters: tuple[InformedParameter, ...]
    segments: tuple[SegmentInformation, ...]


class InformationResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="information"):
    """`seatrial ident information`: which segments of logs tell of which parameter of a fitted model."""

    information: Information
    inputs: tuple[InputTrace, ...]
