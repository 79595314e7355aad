"""Figures of predictions and residuals for the Python interface."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from seatrial.api.figures import Figure
from seatrial.daq.errors import SeatrialError, names_hint
from seatrial.ident.report import (
    Panel,
    axis_limits,
    band,
    degrees_for,
    dots,
    kind_title,
    line_trace,
    overlay_panels,
    stacked,
    with_legend,
)
from seatrial.ident.results import data_name, judged_by_blocks

if TYPE_CHECKING:
    from seatrial.api.series import Series
    from seatrial.ident.numerics import Array
    from seatrial.ident.results import ComparisonResult, FitResult, PredictionKind

POINTS = 3000  # largest number of points of a line
TURN_DEG = 360.0


def prediction_figure(result: FitResult, channels: Sequence[str], record: str | None = None) -> Figure:
    """Return a figure of measured and predicted channels over the horizon, with the 95 % band of the prediction.

    It has a panel for each channel of each record, validation records first. Angles are in degrees and wrapped to half
    a turn about zero, as in the report. The vertical range is limited where a wide band would hide the curves. A
    channel without predictions has only its samples.

    Parameters
    ----------
    result
        Result of a fit.
    channels
        Names of the channels to draw; empty: all.
    record
        Name of the only record to draw; None: all.

    Raises
    ------
    SeatrialError
        If the result has no channel with one of the names, no such record, or no channel at all.
    """
    check_names(channels, [x.channel for x in result.traces], _states(result))
    records = dict.fromkeys(x.record for x in result.traces)
    if record is not None and record not in records:
        raise SeatrialError(f"record: there is no record {record!r}; {names_hint(str(record), records)}")
    panels = []
    for x in sorted(result.traces, key=lambda x: x.role != "validation"):
        if (channels and x.channel not in channels) or record not in (None, x.record):
            continue
        factor, unit = degrees_for(x.unit)
        turn = TURN_DEG if x.angle else None
        of = data_name(x.role, judged_by_blocks(result)).removesuffix(" data")
        panel = Panel(f"{x.channel} [{unit or '1'}], {x.record} ({of})")
        measured = _wrapped(factor * x.measured, turn)
        panel.traces.append(dots(x.t, measured, "measured", POINTS, turn=turn))
        if turn is not None:
            panel.y.update(range=[-turn / 2, turn / 2], tick0=0, dtick=turn / 4)
        if x.t_horizon.size:
            middle, half = _wrapped(factor * x.horizon, turn), 1.96 * factor * x.sd_horizon
            if turn is None and (limits := axis_limits([measured, middle], [middle - half, middle + half])):
                panel.y["range"] = limits  # a wide band would make the curves flat
            panel.traces.append(band(x.t_horizon, middle, half, POINTS, turn=turn))
            name = f"predicted {result.horizon_seconds:g} s ahead"
            panel.traces.append(line_trace(x.t_horizon, middle, name, POINTS, turn=turn))
        panels.append(panel)
    return _stacked(
        f"Measured (grey) and predicted {result.horizon_seconds:g} s ahead (blue, with its 95 % band)", panels
    )


def _wrapped(values: Array, turn: float | None) -> Array:
    """Return an angle wrapped to half a turn about zero; other signals (``turn`` is None) are returned unchanged."""
    return values if turn is None else np.mod(values + turn / 2, turn) - turn / 2


def comparison_figure(
    result: ComparisonResult, channels: Sequence[str], horizon: float | Literal["simulation"] | None
) -> Figure:
    """Return a figure of measured channels with the predictions of several models, each with its 95 % band.

    Parameters
    ----------
    result
        Result of a comparison.
    channels
        Names of the channels to draw; empty: all.
    horizon
        Horizon [s], ``simulation``, or None for the first horizon.

    Raises
    ------
    SeatrialError
        If the comparison has no channel with one of the names, or no such horizon.
    """
    check_names(channels, [x.channel for x in result.traces])
    seconds = result.horizons[0] if horizon is None else horizon
    if seconds != "simulation" and seconds not in result.horizons:
        known = ", ".join(f"{h:g}" for h in result.horizons)
        raise SeatrialError(f"there is no horizon {seconds}; choose {known} or 'simulation', or compare with horizon=")
    kind: tuple[PredictionKind, float | None] = (
        ("simulation", None) if seconds == "simulation" else ("horizon", float(seconds))
    )
    names = {m.label: m.name if result.is_evaluation else f"({m.label}) {m.name}" for m in result.models}
    panels: list[Panel] = []
    for x in result.traces:
        if not channels or x.channel in channels:
            found = overlay_panels(result, [x], kind, POINTS, names, first=not panels)
            panels += [replace(panel, title=f"{panel.title}, {x.record}") for panel in found]
    title = f"Measured (grey) and predicted: {kind_title(*kind)}, with 95 % bands"
    figure = _stacked(title, panels)
    shown, height = with_legend(figure.to_dict(), figure.layout["height"], 1 + len(result.models))
    return Figure(title, shown["data"], shown["layout"] | {"height": height})


def residual_figure(residuals: Mapping[str, Mapping[str, Series]], channels: Sequence[str]) -> Figure:
    """Return a figure of standardised residuals over time, by record and channel, with lines at ± 2.

    A standardised residual is an innovation divided by its predicted standard deviation.

    Parameters
    ----------
    residuals
        Standardised residuals by record and channel, each with at least one sample.
    channels
        Names of the channels to draw; empty: all.

    Raises
    ------
    SeatrialError
        If the residuals have no channel with one of the names, or no channel at all.
    """
    check_names(channels, [n for by_channel in residuals.values() for n in by_channel])
    panels = []
    for record, by_channel in residuals.items():
        for name, series in by_channel.items():
            if channels and name not in channels:
                continue
            ends = np.array([series.t[0], series.t[-1]])
            panel = Panel(f"{name}, {record}: residual / predicted standard deviation")
            panel.traces.append(dots(series.t, series.value, name, POINTS))
            for level in (-2.0, 2.0):
                panel.traces.append(line_trace(ends, np.full(2, level), f"{level:+g}", POINTS, dash="dot"))
            panels.append(panel)
    return _stacked("Standardised residuals", panels)


def check_names(asked: Sequence[str], known: Sequence[str], states: Collection[str] = ()) -> None:
    """Check that the names of channels that a user gave (`asked`) are among those of a fit (`known`).

    Raises
    ------
    SeatrialError
        For the first unknown name. The message lists the known ones. If the name is one of the ``states`` of the model,
        it says how to get their values.
    """
    for name in asked:
        if name not in known:
            words = f"there is no channel {name!r}; the channels are {', '.join(dict.fromkeys(known))}"
            if name in states:
                words += (
                    f". {name} is a state of the model, which no sensor measures: plot its estimate from the table "
                    f"st.navigate(fit, logs).to_pandas(), columns t, {name} and sd_{name}"
                )
            raise SeatrialError(words)


def _states(result: FitResult) -> set[str]:
    """Return the names of the states in the linear models of a result; they are empty for a result without any."""
    dynamics = getattr(result, "dynamics", None)
    return {name for point in (dynamics.points if dynamics else ()) for name in point.states}


def _stacked(title: str, panels: Sequence[Panel]) -> Figure:
    """Return a figure with a title and panels above each other over one time axis. Without panels raise SeatrialError.

    A panel is a diagram with its title and traces.
    """
    if not panels:
        raise SeatrialError("there is nothing to draw: the result has no channel with samples; fit logs with more data")
    figure, height = stacked(panels, "time [s]")
    return Figure(title, figure["data"], figure["layout"] | {"height": height, "showlegend": False})
