"""Plots of the README from the results of run.sh: python figures.py out/kingfisher FOLDER.

The script writes curve.html, prediction.html and masses.html. The pictures are screenshots of these pages.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from seatrial.ident.results import read_result, to_json

MEASURED, MODEL, POOR, PLAIN = "#202020", "#0072b2", "#d55e00", "#8a93a0"  # colours of Okabe and Ito, and grey
SOURCE = (40.4, 82.2, 62.6)  # kg, estimates of the data's authors from single steps; their fit of the fourth failed
STEPS = ("step 1", "step 2", "step 3", "step 4")
RUNS = {"run01": "0.1", "after2": "0.3, then none", "run05": "0.5", "run06": "0.6", "run08": "0.8", "run10": "1.0"}


def load(folder: Path, name: str) -> dict[str, Any]:
    """Return the content of a result file with its curves."""
    found: dict[str, Any] = json.loads(to_json(read_result(folder / name / "result.json")))
    return found


def traces(result: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return measured and simulated speed by the short name of the log."""
    return {t["record"].removeprefix("surge_").removeprefix("rest_"): t for t in result["traces"]}


def line(x: Any, y: Any, name: str, colour: str, dash: str = "solid", **more: Any) -> go.Scatter:
    """Return a line of a plot."""
    return go.Scatter(x=x, y=y, name=name, mode="lines", line={"color": colour, "width": 1.8, "dash": dash}, **more)


def dots(x: Any, y: Any, name: str, colour: str, symbol: str = "circle", size: float = 7, **more: Any) -> go.Scatter:
    """Return points of a plot."""
    marker = {"color": colour, "symbol": symbol, "size": size}
    return go.Scatter(x=x, y=y, name=name, mode="markers", marker=marker, **more)


def page(figure: go.Figure, path: Path, width: int, height: int) -> None:
    """Write a plot to a self-contained HTML file. Width and height are in pixels."""
    legend = {"orientation": "h", "yanchor": "bottom", "y": 1.07}
    figure.update_layout(
        template="plotly_white",
        width=width,
        height=height,
        font={"size": 13},
        legend=legend,
        margin={"l": 70, "r": 20, "t": 70, "b": 55},
    )
    figure.write_html(path, include_plotlyjs=True, config={"displayModeBar": False})


def curve(folder: Path, path: Path) -> None:
    """Plot the force as a function of the command: load cell levels, quadratic curve and monotone curve."""
    static = load(folder, "thruster")["static"]
    bars = {"type": "data", "array": 2 * np.array(static["sd"]), "thickness": 1.2, "width": 0}
    figure = go.Figure(
        [
            line(static["n_model"], static["force_quadratic"], "c1 n|n| + c2 n²", POOR, "dash"),
            line(static["n_model"], static["force_model"], "monotone curve", MODEL),
            dots(static["n"], static["force"], "levels, ± 2 s.e.", MEASURED, error_y=bars),
        ]
    )
    figure.update_xaxes(title_text="command, part of full")
    figure.update_yaxes(title_text="force of both thrusters [N]")
    page(figure, path, 720, 420)


def prediction(folder: Path, path: Path) -> None:
    """Plot the speed on validation runs: measured, and by two models.

    The models have a delay alone, and a delay with loss of thrust and cubic drag.
    """
    good, poor = traces(load(folder, "both")), traces(load(folder, "delayed"))
    figure = make_subplots(
        2,
        3,
        subplot_titles=[f"{run}: command {command}" for run, command in RUNS.items()],
        vertical_spacing=0.2,
        horizontal_spacing=0.07,
    )
    for k, run in enumerate(RUNS):
        trace, first = good[run], k == 0
        found = [dots(trace["t"], trace["measured"], "measured", MEASURED, size=2.5, showlegend=first)]
        for trace, colour, dash, label in ((poor[run], POOR, "dash", "delayed"), (good[run], MODEL, "solid", "both")):
            t = np.array(trace["t"])
            after = t > 15  # the first 15 s are filtered, not simulated
            found.append(line(t[after], np.array(trace["model"])[after], label, colour, dash, showlegend=first))
        figure.add_traces(found, rows=1 + k // 3, cols=1 + k % 3)
    figure.update_xaxes(title_text="time [s]")
    figure.update_yaxes(title_text="speed [m/s]", col=1)
    page(figure, path, 1100, 600)


def masses(folder: Path, path: Path) -> None:
    """Plot the estimated mass of each step, and the residual speed after the end of the thrust for all runs."""
    figure = make_subplots(1, 2, horizontal_spacing=0.1)
    looks = {"immediate": (PLAIN, "square"), "delayed": (POOR, "diamond"), "both": (MODEL, "circle")}
    for shift, (name, (colour, symbol)) in enumerate(looks.items()):
        row = load(folder, name)["homogeneity"][0]
        bars = {"type": "data", "array": 2 * np.array(row["ses"]), "thickness": 1.6, "width": 0}
        at = np.arange(1, 5) + 0.15 * (shift - 1)
        figure.add_trace(dots(at, row["values"], f"{name}, ± 2 s.e.", colour, symbol, error_y=bars), 1, 1)
    figure.add_trace(dots([5] * len(SOURCE), SOURCE, "the source, step by step", MEASURED, "x"), 1, 1)
    figure.update_xaxes(tickvals=[1, 2, 3, 4, 5], ticktext=[*STEPS, "source"], col=1)
    figure.update_yaxes(title_text="mass [kg]", range=[20, 105], col=1)
    grid = np.arange(-8.0, 20.0, 0.1)
    residuals = _residuals_after_thrust(load(folder, "both"), grid)
    for k, (_, error) in enumerate(residuals):
        label = f"each of {len(residuals)} runs"
        figure.add_trace(line(grid, error, label, PLAIN, opacity=0.45, showlegend=k == 0), 1, 2)
    figure.add_trace(line(grid, np.nanmean([error for _, error in residuals], axis=0), "their mean", MODEL), 1, 2)
    figure.update_xaxes(title_text="time after the last command [s]", col=2)
    figure.update_yaxes(title_text="measured less simulated [m/s]", col=2)
    page(figure, path, 1100, 460)


def _residuals_after_thrust(result: dict[str, Any], grid: Any) -> list[tuple[str, Any]]:
    """Return the measured less the simulated speed around the end of the thrust, for runs with more than 25 N.

    ``grid`` has the times [s] after the end of the thrust.
    """
    inputs = {i["record"]: i for i in result["inputs"] if i["name"] == "X"}
    found = []
    for trace in result["traces"]:
        thrust = inputs[trace["record"]]
        t_thrust = np.array(thrust["t"])[np.array(thrust["value"]) > 25.0]
        if t_thrust.size:
            t, measured = np.array(trace["t"]) - t_thrust[-1], np.array(trace["measured"], float)
            error, finite = measured - np.array(trace["model"], float), np.isfinite(measured)
            found.append((trace["record"], np.interp(grid, t[finite], error[finite], left=np.nan, right=np.nan)))
    return found


if __name__ == "__main__":
    results, pictures = Path(sys.argv[1]), Path(sys.argv[2])
    for draw in (curve, prediction, masses):
        draw(results, pictures / f"{draw.__name__}.html")
