"""The result of `seatrial mission design`, as MISSION.json holds it."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from ident.numerics import Array
from ident.results.parts import Part, Result


class DesignedParameter(Part, frozen=True, kw_only=True):
    """Standard errors of a parameter before and after the mission; null: nothing is known of it."""

    name: str
    meaning: str
    unit: str
    value: Annotated[float, Meta(description="nominal")]
    before: Annotated[float | None, Meta(description="by earlier logs")]
    after: Annotated[float | None, Meta(description="with this mission, by prediction error")]
    form: Annotated[float | None, Meta(description="with this mission, by the form of the design")]
    baseline: Annotated[float | None, Meta(description="with the best baseline signal instead, by prediction error")]
    chosen: Annotated[bool, Meta(description="the criterion is of it")]


class Baseline(Part, frozen=True, kw_only=True):
    """A random sequence at its best, which the design is compared with."""

    name: Annotated[str, Meta(description="`PRBS` or `RGS`")]
    value: Annotated[float, Meta(description="its criterion")]
    bandwidth: Annotated[float, Meta(description="PRBS: clock [s]; RGS: corner [Hz]")]
    seeds: Annotated[Array, Meta(description="each seed's best")]


class CommandTrace(Part, frozen=True, kw_only=True):
    """What an input is commanded."""

    name: str
    t: Annotated[Array, Meta(description="time since the first step [s]")]
    value: Annotated[Array, Meta(description="-1..1")]


class DesignTrack(Part, frozen=True, kw_only=True):
    """Where the boat is expected to go, from rest, heading north."""

    t: Annotated[Array, Meta(description="[s]")]
    x: Annotated[Array, Meta(description="north of the start [m]")]
    y: Annotated[Array, Meta(description="east of the start [m]")]
    radius: Annotated[Array, Meta(description="95 % of the sampled boats are within it [m]")]
    others: Annotated[tuple[Array, ...], Meta(description="tracks (n, 2) of sampled boats: north, east [m]")]
    inside: Annotated[float | None, Meta(description="share of them that kept to the area; null without one")]
    corner: Annotated[tuple[float, float] | None, Meta(description="south-west corner of the area from the start [m]")]
    area: Annotated[tuple[float, float] | None, Meta(description="north by east [m]")]
    current: Annotated[float, Meta(description="the largest that they meet [m/s]")]


class Discrimination(Part, frozen=True, kw_only=True):
    """How far apart the mission puts two effects (`--discriminate`)."""

    effects: tuple[str, str]
    if_second: Annotated[float, Meta(description="T if the second is true")]
    if_first: Annotated[float, Meta(description="T if the first is true")]
    clear: Annotated[bool, Meta(description="both are large enough to tell them apart")]
    random: Annotated[Array, Meta(description="T of random missions")]


class DesignResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="design"):
    """`seatrial mission design`: the mission that tells most about a model."""

    model: Annotated[str, Meta(description="file or name of the model")]
    criterion: Annotated[str, Meta(description="`D`, `A`, `E` or `Ds`")]
    chosen: Annotated[tuple[str, ...], Meta(description="parameters that the criterion is of")]
    form: Annotated[str, Meta(description="of the information: `prediction error` or `output error`")]
    value: Annotated[float, Meta(description="of the criterion")]
    evaluations: Annotated[int, Meta(description="simulations that the search took")]
    parameters: tuple[DesignedParameter, ...]
    baselines: tuple[Baseline, ...]
    baseline: Annotated[str, Meta(description="the best of the baseline signals")]
    limited: Annotated[bool, Meta(description="the design had to keep to limits, which baseline signals do not")]
    samples: Annotated[dict[str, Array], Meta(description="by input, the criterion at 1000 samples of the parameters")]
    share_won: Annotated[float, Meta(description="share of the samples in which the design is best")]
    inputs: tuple[CommandTrace, ...]
    track: Annotated[DesignTrack | None, Meta(description="null: the model has no position")]
    apart: Annotated[Discrimination | None, Meta(description="null: two effects were not named")] = None

    @property
    def margin(self) -> float:
        """Criterion of the design less that of the best baseline signal; negative: the design is worse."""
        return self.value - max(b.value for b in self.baselines)
