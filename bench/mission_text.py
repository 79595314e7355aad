"""What a design expects of its mission: the track with its band, and what the parameters will be known to.

Written by `seatrial mission design` into the table `[prediction]` of mission.toml, shown by `seatrial mission show`.

A mission as text: its segments, a sketch of each thruster's command over time, and what a design predicted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from daq.config import FloatArray, Mission, Prediction

ASPECT = 2.1  # a character's height over its width
HEIGHT = 9  # rows of a sketch, odd so that zero has one


def describe_errors(after: Mapping[str, float], before: Mapping[str, float]) -> list[str]:
    """A line for each parameter."""
    if not after:
        return []
    lines = ["", "predicted standard errors" + (" (before this mission)" if before else "")]
    for name, error in after.items():
        known = f"  ({before[name]:.3g})" if name in before else ""
        lines.append(f"  {name:<10} {error:.3g}{known}")
    return lines


def describe_track(one: Prediction, width: int = 60) -> list[str]:
    """The track as characters, north up: its start S, its end E, the band dotted."""
    if len(one.t) == 0:
        return []
    margin = float(one.radius.max())
    low = np.array([one.x.min(), one.y.min()]) - margin
    high = np.array([one.x.max(), one.y.max()]) + margin
    span = np.maximum(high - low, 1e-3)
    scale = max(span[1] / width, span[0] / (0.6 * width) / ASPECT)  # m a column
    columns, lines = max(1, math.ceil(span[1] / scale)), max(1, math.ceil(span[0] / scale / ASPECT))
    cell_x = high[0] - (np.arange(lines) + 0.5) * scale * ASPECT
    cell_y = low[1] + (np.arange(columns) + 0.5) * scale
    grid = np.full((lines, columns), " ")
    for x, y, radius in zip(one.x, one.y, one.radius, strict=True):
        grid[np.hypot(cell_x[:, None] - x, cell_y - y) <= radius] = "·"
    fine = np.linspace(one.t[0], one.t[-1], 40 * len(one.t))
    for x, y in zip(np.interp(fine, one.t, one.x), np.interp(fine, one.t, one.y), strict=True):
        grid[_cell(x, y, high[0], low[1], scale, grid.shape)] = "o"
    grid[_cell(one.x[0], one.y[0], high[0], low[1], scale, grid.shape)] = "S"
    grid[_cell(one.x[-1], one.y[-1], high[0], low[1], scale, grid.shape)] = "E"
    head = f"predicted track, {span[0]:.0f} m north by {span[1]:.0f} m east with its band (95 %); S start, E end"
    return ["", head, *("  |" + "".join(row) + "|" for row in grid)]


def _cell(x: float, y: float, top: float, left: float, scale: float, shape: tuple[int, ...]) -> tuple[int, int]:
    row, column = int((top - x) / scale / ASPECT), int((y - left) / scale)
    return min(max(row, 0), shape[0] - 1), min(max(column, 0), shape[1] - 1)


def describe(mission: Mission, width: int = 96) -> str:
    """Name, limits, segments, a sketch a thruster, what was predicted; lines of at most about `width` characters."""
    slew = f", slew at most {mission.slew_per_s:g} 1/s" if np.isfinite(mission.slew_per_s) else ""
    lines = [
        f"{mission.name} ({mission.kind}), {mission.end:g} s, n_max {mission.n_max:g}{slew}",
        f"made by: {mission.made_by or 'unknown'}",
    ]
    lines += [f"  {t0:7.1f} - {t1:7.1f} s  {name}" for t0, t1, name in mission.starts()]
    t, n = mission.setpoints()
    for column, thruster in enumerate(mission.thrusters):
        lines += ["", f"n_cmd {thruster}", *sketch(t, n[:, column], mission.end, width - 6)]
    expected = mission.prediction
    lines += describe_errors(mission.predicted_errors, expected.errors_before if expected else {})
    lines += describe_track(expected, width - 6) if expected else []
    return "\n".join(lines)


def sketch(t: FloatArray, n: FloatArray, end: float, width: int) -> list[str]:
    """Draw held values `n` (K,) from `t` (K,) [s]; a column spans the least to the greatest value in it."""
    edges = np.linspace(0.0, end, width + 1)
    half = HEIGHT // 2
    grid = [["·" if row == half else " "] * width for row in range(HEIGHT)]
    for column in range(width):
        low, high = _extent(t, n, edges[column], edges[column + 1])
        top, bottom = half - round(high * half), half - round(low * half)
        for row in range(top, bottom + 1):
            grid[row][column] = "█" if (high, low) != (0.0, 0.0) else "─"
    labels = {0: "+1", half: " 0", HEIGHT - 1: "-1"}
    lines = [f"{labels.get(row, ''):>3} |{''.join(cells)}" for row, cells in enumerate(grid)]
    return [*lines, f"    {'0 s':<{max(4, width + 1 - len(f'{end:g} s'))}}{end:g} s"]


def _extent(t: FloatArray, n: FloatArray, start: float, stop: float) -> tuple[float, float]:
    """Least and greatest of the held value within [start, stop)."""
    first, last = np.searchsorted(t, start, side="right") - 1, np.searchsorted(t, stop, side="left")
    held = n[max(first, 0) : max(last, 1)]
    if first < 0:
        held = np.append(held if t[0] < stop else held[:0], 0.0)
    return float(held.min()), float(held.max())
