"""Sections of the report page of a result, in their order; each is built from the result alone."""

from __future__ import annotations

from seatrial.ident.report.blocks import Canvas, Prose, Section
from seatrial.ident.report.sections import (
    answer,
    campaigns,
    comparison,
    dynamics,
    navigation,
    noise,
    parameters,
    predictions,
    residuals,
    runs,
    search,
    thruster,
)
from seatrial.ident.results import (
    CampaignsResult,
    ComparisonResult,
    DiagnosisResult,
    FitResult,
    InformationResult,
    NavigationResult,
    NoiseResult,
    Result,
    ThrustCurveResult,
    ThrusterResult,
    VehicleResult,
    judged_by_blocks,
)


def warning_texts(result: Result) -> list[str]:
    """Return the warnings of a result as they are shown on its page, each text once."""
    return list(dict.fromkeys(warning.text for warning in result.warnings))


def opening(result: Result) -> Section:
    """Return the section of the report page that follows its headline: the main numbers of the result.

    For a comparison it is its warnings and the table of its models. It is empty for any other result that is neither
    a fit nor a diagnosis. For a fit that did not converge, it has at most the caveat of a diagnosis.
    """
    if isinstance(result, ComparisonResult):
        warnings = [Prose(text, "callout warning") for text in warning_texts(result)]
        return Section("answer", "", [*warnings, *comparison.opening_blocks(result)])
    return answer.section(result)


def body(canvas: Canvas, result: Result) -> list[Section]:
    """Return the sections of the report page of a result, in their order, without the empty ones.

    Parameters
    ----------
    canvas
        Collector of the figures, to which the figures are added.
    result
        Result of a command.

    Raises
    ------
    TypeError
        If there is no page for this type of result (designs and studies have their own pages).
    """
    if isinstance(result, FitResult):
        found = _fit(canvas, result)
    elif isinstance(result, ThrustCurveResult):
        found = [answer.static_section(canvas, result.static), runs.run_section(canvas, result.logs, ())]
    elif isinstance(result, NoiseResult):
        found = [noise.section(canvas, result), runs.run_section(canvas, result.logs, ())]
    elif isinstance(result, NavigationResult):
        found = [navigation.outages_section(result), navigation.states_section(canvas, result)]
        found.append(runs.run_section(canvas, result.logs, result.inputs))
    elif isinstance(result, InformationResult):
        found = [parameters.information_section(result), parameters.segments_section(canvas, result)]
        found.append(runs.run_section(canvas, result.logs, result.inputs))
    elif isinstance(result, CampaignsResult):
        found = [campaigns.changes_section(result), campaigns.errors_section(result)]
        found += [campaigns.estimates_section(canvas, result), campaigns.logs_section(result)]
    elif isinstance(result, ComparisonResult):
        found = [comparison.errors_section(result), comparison.overlay_section(canvas, result)]
        if result.is_evaluation:
            found.append(residuals.evaluation_section(canvas, result))
        else:
            errors, overlay = found
            found = [comparison.differences_section(result), comparison.best_section(result), errors]
            found += [comparison.likelihood_section(result), overlay]
        found.append(runs.run_section(canvas, result.logs, ()))
    else:
        raise TypeError(
            f"write_report has no page for a {type(result).__name__}: use write_design_page for a design, and "
            "write_study_page for a study"
        )
    unused = result.unused_signals if isinstance(result, FitResult) else ()
    found += [predictions.notes_section(result.notes, unused), predictions.made_section(result)]
    return [section for section in found if section.blocks]


def _fit(canvas: Canvas, result: FitResult) -> list[Section]:
    """Return the sections of the page of a vehicle fit, a thruster fit or a diagnosis, including empty ones.

    Figures are added to ``canvas``.
    """
    bench = result if isinstance(result, ThrusterResult) else None
    static = None if bench is None else bench.static
    rpm_max = None if bench is None or bench.steady is None else bench.steady.rpm_max
    profiled = result.profiles if isinstance(result, VehicleResult | ThrusterResult) else ()
    diagnosis = result if isinstance(result, DiagnosisResult) else None
    changes = diagnosis.parameters_before_after if diagnosis else ()
    common = result.common_errors if isinstance(result, VehicleResult) else None
    in_blocks = judged_by_blocks(result)
    return [
        *([answer.static_section(canvas, static, rpm_max)] if static else []),
        *([thruster.steady_section(canvas, bench), thruster.shaft_section(canvas, bench)] if bench else []),
        runs.prediction_section(canvas, result),
        predictions.errors_section(
            result.errors, result.horizon_seconds, diagnosis.errors_caveat if diagnosis else "", in_blocks
        ),
        runs.traces_section(canvas, result),
        runs.run_section(canvas, result.logs, result.inputs),
        dynamics.section(canvas, result.dynamics if isinstance(result, VehicleResult | DiagnosisResult) else None),
        parameters.parameters_section(canvas, result.fit, changes, common, in_blocks),
        parameters.profiles_section(canvas, profiled),
        residuals.section(canvas, result),
        *([search.section(canvas, diagnosis)] if diagnosis else []),
        predictions.calibration_section(canvas, result.calibration, result.horizon_seconds, in_blocks),
        predictions.next_section(diagnosis.next_experiment if diagnosis else None),
    ]
