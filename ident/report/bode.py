"""Bode plots: traces of gain and phase with their bands, and the logarithmic axis of the frequency."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from seatrial.ident.numerics import Array
from seatrial.ident.report.drawing import MODEL, Z95, Trace, angle_step, axis_limits, band, line_trace

DECIBEL = 20.0 / np.log(10.0)  # of a gain, for its natural logarithm
FREQUENCY = "frequency [Hz]"


def frequency_axis() -> dict[str, Any]:
    """Return the entries of the Plotly layout of a logarithmic axis of frequencies, with ticks at its decades."""
    return {"type": "log", "dtick": 1, "minor": {"ticks": "inside"}, "hoverformat": ".3~g"}


def phase_axis(phases: Sequence[Array], errors: Sequence[Array | None] = ()) -> dict[str, Any]:
    """Return the entries of the Plotly layout of an axis of phases in degrees: at most eight ticks, at round angles.

    The distance of the ticks is 45, 90, 180 or 360 deg, or a multiple of 360 deg. Bands that are more than twice as
    high as all lines together are cut off.

    Parameters
    ----------
    phases
        Phases (n,) [rad] of the lines.
    errors
        Standard errors (n,) [rad] of the lines in the same order. None, and a missing one: the line has no band.
    """
    shown = [np.degrees(phase) for phase in phases]
    halves = [np.zeros(1) if sd is None else np.degrees(Z95 * np.nan_to_num(sd)) for sd in errors]
    ends = [middle + side * half for middle, half in zip(shown, halves, strict=False) for side in (-1.0, 1.0)]
    every = np.concatenate([*shown, *ends])
    every = every[np.isfinite(every)]
    least, most = axis_limits(shown, ends) or (every.min(initial=0.0), every.max(initial=0.0))
    span = float(most - least)
    step = angle_step((least, most))
    margin = 0.05 * max(span, step)
    return {"tick0": 0, "dtick": step, "range": [float(least) - margin, float(most) + margin]}


def gain_traces(
    frequency: Array, gain: Array, sd: Array | None, name: str, limit: int, *, color: str = MODEL, dash: str = "solid"
) -> list[Trace]:
    """Return the traces of a gain in dB over the frequency: its 95 % band, and its line above it.

    Parameters
    ----------
    frequency
        Frequencies (n,) [Hz].
    gain
        Gains (n,) above 0.
    sd
        Standard errors (n,) of the natural logarithm of the gain. Without one that is known, or with None, there is no
        band.
    name
        Text in the legend and on hover.
    limit
        Largest number of points of a trace.
    color, dash
        Colour and dash of the line, as in `line_trace`.
    """
    return _with_band(frequency, DECIBEL * np.log(gain), sd, DECIBEL, name, limit, color, dash)


def phase_traces(
    frequency: Array, phase: Array, sd: Array | None, name: str, limit: int, *, color: str = MODEL, dash: str = "solid"
) -> list[Trace]:
    """Return the traces of a phase in degrees over the frequency, as `gain_traces`; ``phase`` and ``sd`` are in rad."""
    degrees = float(np.degrees(1.0))
    return _with_band(frequency, degrees * phase, sd, degrees, name, limit, color, dash)


def _with_band(
    frequency: Array, value: Array, sd: Array | None, factor: float, name: str, limit: int, color: str, dash: str
) -> list[Trace]:
    """Return the band ``value`` ± 1.96 ``factor`` ``sd`` if there is one, and the line of ``value``."""
    line = line_trace(frequency, value, name, limit, color=color, dash=dash)
    if sd is None or not np.isfinite(sd).any():
        return [line]
    area = band(frequency, value, Z95 * factor * sd, limit, color=color)
    return [{**area, "showlegend": False}, line]
