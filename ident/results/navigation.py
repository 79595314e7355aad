"""The result of `seatrial ident navigate`."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from ident.numerics import Array
from ident.results.parts import InputTrace, Part, Result


class StateTrace(Part, frozen=True, kw_only=True):
    """A state over time, by the model and all sensors."""

    name: str
    unit: str
    meaning: str
    angle: Annotated[bool, Meta(description="an angle, known but for whole turns")]
    value: Array
    sd: Annotated[Array, Meta(description="standard deviation, the parameters' own errors included")]
    measured: Annotated[Array | None, Meta(description="the channel of that name, where there is one")] = None


class GnssFixes(Part, frozen=True, kw_only=True):
    """The positions that were measured."""

    t: Annotated[Array, Meta(description="[s of the log]")]
    x: Annotated[Array, Meta(description="north [m]")]
    y: Annotated[Array, Meta(description="east [m]")]
    used: Annotated[Array, Meta(description="1: used; 0: withheld on purpose")]


class NavigatedRecord(Part, frozen=True, kw_only=True):
    """Where the boat was, in one log."""

    record: str
    kind: Annotated[Literal["smoothed", "filtered"], Meta(description="by all samples, or by those so far")]
    t: Annotated[Array, Meta(description="[s of the log]")]
    states: tuple[StateTrace, ...]
    fixes: GnssFixes


class PositionEllipse(Part, frozen=True, kw_only=True):
    """The region that holds the position with 95 %."""

    major: Annotated[float, Meta(description="half axis [m]")]
    minor: Annotated[float, Meta(description="half axis [m]")]
    azimuth: Annotated[float, Meta(description="of the major axis [rad from north]")]
    radius: Annotated[float, Meta(description="of the circle that holds as much [m]")]


class WithheldErrors(Part, frozen=True, kw_only=True):
    """Estimates less the fixes that were withheld."""

    rms: Annotated[float, Meta(description="[m]")]
    largest: Annotated[float, Meta(description="[m]")]
    inside: Annotated[float, Meta(description="share inside the 95 % regions, the noise of the fix included")]
    n: Annotated[int, Meta(description="number of fixes")]


class GnssOutage(Part, frozen=True, kw_only=True):
    """A time without GNSS: what was claimed for its end, and what came true."""

    record: str
    start: Annotated[float, Meta(description="[s of the log]")]
    end: Annotated[float, Meta(description="[s of the log]")]
    duration: Annotated[float, Meta(description="[s]")]
    open: Annotated[bool, Meta(description="no fix came after it")]
    withheld: Annotated[bool, Meta(description="on purpose (`--gnss-outage`)")]
    north: Annotated[float, Meta(description="predicted for the end without GNSS [m]")]
    east: Annotated[float, Meta(description="[m]")]
    at_end: Annotated[PositionEllipse, Meta(description="of that prediction")]
    error: Annotated[float | None, Meta(description="distance of the fix at the end from it [m]")]
    allowed: Annotated[float | None, Meta(description="95 % radius of that distance, with the noise of the fix [m]")]
    inside: Annotated[bool | None, Meta(description="whether the fix is inside that region")]
    widest: Annotated[float, Meta(description="largest 95 % radius by the best estimate [m]")]
    predicted: Annotated[WithheldErrors | None, Meta(description="on withheld fixes, without those to come")]
    best: Annotated[WithheldErrors | None, Meta(description="on withheld fixes, by the best estimate")]


class NavigationResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="navigation"):
    """`seatrial ident navigate`: where the boat was, by a fitted model."""

    navigation: Annotated[tuple[NavigatedRecord, ...], Meta(description="one a log")]
    outages: Annotated[tuple[GnssOutage, ...], Meta(description="one an outage")]
    inputs: tuple[InputTrace, ...]
