"""The pictures of README.md from what run.sh wrote: python figures.py out/kingfisher. Needs matplotlib."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt

HERE = Path(__file__).parent
MEASURED, MODEL, POOR = "#202020", "#0072b2", "#d55e00"
SOURCE = (40.4, 82.2, 62.6)  # kg, what the source of the data got from one step at a time; a fourth gave nothing


def load(folder: Path, name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / name / "result.json").read_text(encoding="utf-8"))
    return found


def traces(result: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Measured and free-running speed by the short name of the log."""
    return {t["record"].removeprefix("surge_").removeprefix("rest_"): t for t in result["traces"]}


def curve(folder: Path) -> None:
    static = load(folder, "thruster")["static"]
    figure, axes = plt.subplots(figsize=(6.5, 3.6))
    axes.plot(static["n_model"], static["force_quadratic"], "--", color=POOR, label="c1 n|n| + c2 n²")
    axes.plot(static["n_model"], static["force_model"], color=MODEL, label="monotone curve")
    axes.errorbar(static["n"], static["force"], 2 * np.array(static["sd"]), fmt="o", ms=4, color=MEASURED,
                  label="levels, ± 2 s.e.")  # fmt: skip
    axes.set(xlabel="command", ylabel="force of both thrusters [N]")
    finish(figure, [axes], "curve.png")


def prediction(folder: Path) -> None:
    good, poor = traces(load(folder, "both")), traces(load(folder, "delayed"))
    figure, axes = plt.subplots(2, 3, figsize=(11, 5.4))
    names = {"run01": "0.1", "after2": "0.3, then none", "run05": "0.5", "run06": "0.6", "run08": "0.8", "run10": "1.0"}
    for at, (name, said) in zip(axes.flat, names.items(), strict=True):
        at.plot(good[name]["t"], good[name]["measured"], ".", ms=2, color=MEASURED, label="measured")
        for one, colour, label in ((poor[name], POOR, "delayed"), (good[name], MODEL, "both")):
            t = np.array(one["t"])
            at.plot(t[t > 15], np.array(one["model"])[t > 15], color=colour, lw=1.3, label=label)
        at.set(title=f"{name}: command {said}", xlabel="t [s]", ylabel="speed [m/s]")
    finish(figure, axes.flat, "prediction.png")


def masses(folder: Path) -> None:
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.8))
    for shift, (name, colour) in enumerate((("immediate", "#999999"), ("delayed", POOR), ("both", MODEL))):
        row = load(folder, name)["agreement"][0]
        steps = np.arange(1, 5) + 0.15 * (shift - 1)
        left.errorbar(steps, row["values"], 2 * np.array(row["ses"]), fmt="o", ms=4, color=colour, label=name)
    left.plot([5] * len(SOURCE), SOURCE, "kx", label="the source, step by step")
    left.set(ylabel="mass, one a step ± 2 s.e. [kg]", xticks=[1, 2, 3, 4, 5], ylim=(20, 105))
    left.set_xticklabels(["step 1", "step 2", "step 3", "step 4", "source"])
    result = load(folder, "both")
    inputs = {i["record"]: i for i in result["inputs"] if i["name"] == "X"}
    for trace in result["traces"]:
        thrust = inputs[trace["record"]]
        pushed = np.array(thrust["t"])[np.array(thrust["value"]) > 25.0]
        if pushed.size:
            t = np.array(trace["t"]) - pushed[-1]
            keep = (t > -8) & (t < 20)
            error = np.array(trace["measured"]) - np.array(trace["model"])
            right.plot(t[keep], error[keep], lw=0.8, label=trace["record"].removeprefix("surge_rest_"))
    right.set(xlabel="time after the last command [s]", ylabel="measured less free-running [m/s]")
    finish(figure, [left, right], "masses.png")


def finish(figure: Any, axes: Any, name: str) -> None:
    for k, at in enumerate(axes):
        at.grid(alpha=0.3)
        if k == 0 or name == "masses.png":
            at.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(HERE / name, dpi=80)


if __name__ == "__main__":
    for draw in (curve, prediction, masses):
        draw(Path(sys.argv[1]))
