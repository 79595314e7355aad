"""The result of `seatrial ident noise`."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from ident.numerics import Array
from ident.results.parts import Part, Result


class ChannelNoise(Part, frozen=True, kw_only=True):
    """White noise plus a random walk, fitted to a channel of a sensor at rest, and whether it is that."""

    channel: Annotated[str, Meta(description="with the log's name where there are several")]
    unit: str
    white: Annotated[float, Meta(description="standard deviation of a sample [unit]")]
    random_walk: Annotated[float, Meta(description="[unit/sqrt(s)]")]
    se_white: Annotated[float | None, Meta(description="standard error; null: `white` is only a bound from above")]
    se_random_walk: Annotated[
        float | None, Meta(description="standard error; null: `random_walk` is only a bound from above")
    ]
    accepted: Annotated[bool, Meta(description="whether the channel is white noise plus a random walk")]
    p: Annotated[float | None, Meta(description="p value of the Ljung-Box test of the innovations")]
    predictable: Annotated[
        float | None, Meta(description="share of the innovations' variance that could be predicted")
    ]
    reason: Annotated[str | None, Meta(description="why it is not accepted")]
    frequency: Annotated[Array, Meta(description="[Hz]")]
    psd: Annotated[Array, Meta(description="power spectral density that was measured (Welch) [unit^2/Hz]")]
    psd_model: Annotated[Array, Meta(description="that of the fit [unit^2/Hz]")]


class NoiseResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="noise"):
    """`seatrial ident noise`: the noise of sensors at rest."""

    noise: Annotated[tuple[ChannelNoise, ...], Meta(description="one a channel of each log")]
