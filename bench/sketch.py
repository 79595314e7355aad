"""A mission as text: its segments, a sketch of each thruster's command over time, and what a design predicted."""

from __future__ import annotations

import numpy as np

from bench.mission import FloatArray, Mission
from bench.prediction import describe_errors, describe_track

HEIGHT = 9  # rows of a sketch, odd so that zero has one


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
