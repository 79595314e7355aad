"""The result of `seatrial ident study`."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from ident.results.parts import Part, Result

APART = 0.4  # a fit starts within a factor exp(+-APART) of the truth
BIAS, COVERAGE, VARIANCE = 0.15, (0.93, 0.97), 0.1  # what is wanted
AIMS = {"bias": (-BIAS, BIAS), "ratio": (1.0 - VARIANCE, 1.0 + VARIANCE), "coverage": COVERAGE}


class ParameterStudy(Part, frozen=True, kw_only=True):
    """Bias, variance and coverage of a parameter in the coordinate in which the estimator moves; intervals are 95 %."""

    name: str
    unit: str
    truth: Annotated[float, Meta(description="the value that was simulated")]
    n: Annotated[int, Meta(description="estimates with an interval")]
    at_bound: Annotated[int, Meta(description="of them, those at their bound")]
    sd: Annotated[float, Meta(description="of the estimates")]
    bias: Annotated[float, Meta(description="in `sd`")]
    bias_error: Annotated[float, Meta(description="standard error of `bias`")]
    ratio: Annotated[float, Meta(description="variance of the estimates over the one that the fits reported")]
    ratio_low: float
    ratio_high: float
    bound_ratio: Annotated[
        float, Meta(description="variance over the Cramer-Rao bound, or over the least variance near bounds")
    ]
    bound_ratio_low: float
    bound_ratio_high: float
    coverage: Annotated[float, Meta(description="share of the 95 % intervals that hold the truth, 0..1")]
    coverage_low: float
    coverage_high: float
    misses: Annotated[
        tuple[str, ...],
        Meta(description="what is beyond the aim: `bias`, `variance`, `coverage`; `(chance?)`: perhaps by chance"),
    ]


class ModelStudy(Part, frozen=True, kw_only=True):
    """Replicates of one model: simulated, estimated, and compared with the truth."""

    model: str
    about: Annotated[str, Meta(description="the mission")]
    method: Annotated[Literal["PE", "OE"], Meta(description="prediction error or output error")]
    estimator: Annotated[str, Meta(description="in words")]
    replicates: int
    failed: int
    unconverged: int
    cpu_fit: Annotated[float | None, Meta(description="median CPU time of a fit [s]")]
    cpu_simulation: Annotated[float | None, Meta(description="mean CPU time of a simulation [s]")]
    parameters: tuple[ParameterStudy, ...]


class StudyResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="study"):
    """`seatrial ident study`: does the estimator keep its promises?"""

    seed: int
    studies: Annotated[tuple[ModelStudy, ...], Meta(description="one a model")]
