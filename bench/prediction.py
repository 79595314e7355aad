"""What a design expects of its mission: the track with its band, and what the parameters will be known to.

Written by `seatrial mission design` into the table `[prediction]` of mission.toml, shown by `seatrial mission show`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import tomlkit

from daq.toml_table import Table

FloatArray = npt.NDArray[np.float64]
ASPECT = 2.1  # a character's height over its width


@dataclass(frozen=True, eq=False)
class Prediction:
    """Track: t (K,) s, x north and y east (K,) m from where it begins, heading north; radius (K,) m, within which 95 %
    of the simulated boats were. errors_before: standard errors before the mission, for those that were known."""

    model: str
    t: FloatArray
    x: FloatArray
    y: FloatArray
    radius: FloatArray
    errors_before: Mapping[str, float] = field(default_factory=dict)

    def __eq__(self, other: object) -> bool:
        """Equal names and numbers."""
        return isinstance(other, Prediction) and self._content() == other._content()

    def __hash__(self) -> int:
        """Hash of the model's name and of the track."""
        return hash((self.model, self.x.tobytes(), self.y.tobytes()))

    def _content(self) -> tuple[object, ...]:
        arrays = (self.t.tolist(), self.x.tolist(), self.y.tolist(), self.radius.tolist())
        return (self.model, *arrays, dict(self.errors_before))


def parse_prediction(table: Table | None) -> Prediction | None:
    """The table [prediction] of a mission.toml, or None; raises SeatrialError in one line that names the key."""
    if table is None:
        return None
    t = np.array(table.numbers("t"), dtype=np.float64)
    x, y, radius = (np.array(table.numbers(key, length=len(t)), dtype=np.float64) for key in ("x", "y", "radius"))
    before = table.table("errors_before")
    errors = {} if before is None else {key: before.number(key) for key in before.values}
    found = Prediction(table.text("model"), t, x, y, radius, errors)
    table.done()
    return found


def dump_prediction(one: Prediction) -> list[str]:
    """Its lines in a mission.toml."""
    rows = {"t": one.t, "x": one.x, "y": one.y, "radius": one.radius}
    known = ", ".join(f"{tomlkit.item(k).as_string()} = {float(v)!r}" for k, v in one.errors_before.items())
    lines = ["", "[prediction]", f"model = {tomlkit.item(one.model).as_string()}"]
    lines += [f"{key} = [{', '.join(repr(v) for v in values.tolist())}]" for key, values in rows.items()]
    return [*lines, f"errors_before = {{{known}}}"]


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
