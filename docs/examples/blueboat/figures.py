"""Plots of the README from the results of leave_one_out.py: python figures.py leave_one_out.json FOLDER.

The script writes sway.html and heading.html. The pictures are screenshots of these pages.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

MEASURED, MODEL, POOR = "#202020", "#0072b2", "#d55e00"  # colours of Okabe and Ito
RUNS = ("218", "221", "224", "228", "232", "233")
MOVING = 0.3  # m/s; below this speed the angle between heading and track is too uncertain


def traces(found: dict[str, Any], model: str) -> dict[str, dict[str, Any]]:
    """Return the predictions of a model on the runs left out, by the number of the run."""
    return {t["name"][-3:]: t for t in found[f"{model}, left out"]["traces"]}


def add(figure: go.Figure, place: tuple[int, int], t: Any, y: Any, name: str, colour: str, dash: str = "solid") -> None:
    """Add a curve to the panel at ``place`` (row, column)."""
    line = {"color": colour, "width": 1.6, "dash": dash}
    figure.add_trace(
        go.Scatter(x=t, y=y, name=name, line=line, legendgroup=name, showlegend=place == (1, 1)),
        row=place[0],
        col=place[1],
    )


def page(figure: go.Figure, y_title: str, path: Path) -> None:
    """Write a plot to a self-contained HTML file."""
    figure.update_xaxes(title_text="t [s]")
    figure.update_yaxes(title_text=y_title, col=1)
    figure.update_layout(template="plotly_white", width=1150, height=620, margin={"l": 70, "r": 20, "t": 60, "b": 50},
                         legend={"orientation": "h", "y": 1.13})  # fmt: skip
    figure.write_html(path, include_plotlyjs=True, config={"displayModeBar": False})


def sway(found: dict[str, Any], path: Path) -> None:
    """Plot the sway on the runs left out: measured, by the model ``authors`` and by the model ``boat``."""
    boat, authors = traces(found, "boat"), traces(found, "authors")
    figure = make_subplots(2, 3, subplot_titles=[f"run {r}" for r in RUNS], vertical_spacing=0.16)
    for k, run in enumerate(RUNS):
        place = (1 + k // 3, 1 + k % 3)
        add(figure, place, boat[run]["t"], boat[run]["v"]["measured"], "measured", MEASURED)
        add(figure, place, authors[run]["t"], authors[run]["v"]["predicted"], "authors' structure", POOR, "dot")
        add(figure, place, boat[run]["t"], boat[run]["v"]["predicted"], "boat", MODEL)
    page(figure, "sway [m/s]", path)


def heading(found: dict[str, Any], path: Path) -> None:
    """Plot two independent measurements of the heading error: against the gyro, and against the direction of travel."""
    boat = traces(found, "boat")
    figure = make_subplots(2, 3, subplot_titles=[f"run {r}" for r in RUNS], vertical_spacing=0.16)
    for k, run in enumerate(RUNS):
        place, t = (1 + k // 3, 1 + k % 3), np.array(boat[run]["t"])
        u, v = (np.array(boat[run][c]["measured"]) for c in ("u", "v"))
        fast = np.abs(u) > MOVING
        angle = np.full(u.size, np.nan)
        angle[fast] = np.degrees(-np.arctan(v[fast] / u[fast]))
        add(
            figure, place, t, np.degrees(boat[run]["drift"]["measured"]), "heading less the integral of the gyro", MODEL
        )
        add(figure, place, t, angle, "heading less the direction of travel, from u and v", POOR, "dash")
    page(figure, "angle [deg]", path)


def main() -> None:
    """Write both plots."""
    found, folder = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")), Path(sys.argv[2])
    sway(found, folder / "sway.html")
    heading(found, folder / "heading.html")


if __name__ == "__main__":
    main()
