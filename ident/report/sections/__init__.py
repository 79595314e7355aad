"""The page's sections in their order, each built from a result alone."""

from __future__ import annotations

import msgspec
import numpy as np

from ident.report.access import Row, text, texts
from ident.report.blocks import Canvas, Prose, Section
from ident.report.sections import (
    answer,
    calibration,
    errors,
    information,
    navigation,
    noise,
    parameters,
    profiles,
    residuals,
    runs,
    search,
)
from ident.results import (
    DiagnosisResult,
    FitResult,
    InputTrace,
    LogSummary,
    Provenance,
    Result,
    ThrustCurveResult,
    ThrusterResult,
    VehicleResult,
)


def opening(result: Result | Row) -> Section:
    """What stands under the answer."""
    if isinstance(result, Result):
        return answer.section(result)
    return Section("answer", "", [Prose(line, "callout") for line in texts(result, "cautions")])


def body(canvas: Canvas, result: Result | Row) -> list[Section]:
    """The sections that have something to show."""
    if isinstance(result, FitResult):
        found = _fit(canvas, result)
    elif isinstance(result, ThrustCurveResult):
        found = [answer.static_section(canvas, result.static), runs.run_section(canvas, result.logs, ())]
    elif isinstance(result, Result):
        raise TypeError(f"no page for a {type(result).__name__}")
    else:
        return [section for section in _untyped(canvas, result) if section.blocks]
    found += [errors.notes_section(result.notes), errors.made_section(result)]
    return [section for section in found if section.blocks]


def _fit(canvas: Canvas, result: FitResult) -> list[Section]:
    static = result.static if isinstance(result, ThrusterResult) else None
    profiled = result.profiles if isinstance(result, VehicleResult | ThrusterResult) else ()
    diagnosis = result if isinstance(result, DiagnosisResult) else None
    changes = diagnosis.parameters_before_after if diagnosis else ()
    return [
        *([answer.static_section(canvas, static)] if static else []),
        runs.run_section(canvas, result.logs, result.inputs),
        runs.traces_section(canvas, result),
        parameters.section(canvas, result.fit, changes),
        profiles.section(canvas, profiled),
        residuals.section(canvas, result),
        *([search.section(canvas, diagnosis)] if diagnosis else []),
        errors.section(result.errors, result.horizon_seconds),
        calibration.section(canvas, result.calibration, result.horizon_seconds),
        errors.next_section(diagnosis.recommended_experiment if diagnosis else None),
    ]


def _untyped(canvas: Canvas, content: Row) -> list[Section]:
    """Of results that are not types yet."""
    logs = msgspec.convert(content.get("logs", ()), tuple[LogSummary, ...])
    inputs = tuple(
        InputTrace(record=i["record"], name=i["name"], unit=i["unit"], t=np.array(i["t"]), value=np.array(i["value"]))
        for i in content.get("inputs", ())
    )
    made = Provenance(created=text(content, "created"), seatrial=text(content, "seatrial"),
                      command=text(content, "command"))
    return [
        noise.section(canvas),
        information.parameters_section(canvas),
        information.stretches_section(canvas),
        navigation.outages_section(canvas),
        navigation.section(canvas),
        runs.run_section(canvas, logs, inputs),
        errors.notes_section(texts(content, "notes")),
        errors.made_section(made),
    ]
