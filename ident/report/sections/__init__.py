"""The page's sections in their order, each built from result.json's content alone."""

from __future__ import annotations

from ident.report.blocks import Canvas, Section
from ident.report.sections import (
    answer,
    calibration,
    errors,
    information,
    navigation,
    parameters,
    profiles,
    residuals,
    runs,
    search,
)


def opening(canvas: Canvas) -> Section:
    """What stands under the answer."""
    return answer.section(canvas)


def body(canvas: Canvas) -> list[Section]:
    """The sections that have something to show."""
    makers = (
        answer.static_section,
        answer.noise_section,
        information.parameters_section,
        information.stretches_section,
        navigation.outages_section,
        navigation.section,
        runs.run_section,
        runs.traces_section,
        parameters.section,
        profiles.section,
        residuals.section,
        search.section,
        errors.section,
        calibration.section,
        errors.next_section,
        errors.notes_section,
        errors.made_section,
    )
    return [section for make in makers if (section := make(canvas)).blocks]
