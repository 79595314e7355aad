"""Leave one run out: fit all runs but one, predict that one from its inputs alone, and so on through all runs.

    python leave_one_out.py LOG... [--model NAME ...] [--fix NAME=VALUE ...] [--out FILE.json]

The fit is by output error (``ident.estimation.output_error``). Fit and prediction start at the first
sample of the run from the
speeds and the heading measured there, and the prediction sees nothing but the commands after it. The score is that of
compare() in MATLAB, which the data's authors use, 100 (1 - |y - y_hat| / |y - mean(y)|) per cent: for each run, and
pooled, with the squares of all runs summed and every run's own mean taken away.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import boat
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from ident.data import Channel, Record, build_record, load_run
from ident.estimation import EstimationOptions, Fit, SearchSettings, fit, simulate
from ident.model import Model

Array = NDArray[np.float64]
CHANNELS = ("u", "v", "r")
STEP = 0.05  # s; at full speed the yaw damping is too quick for steps of a tenth of a second
MODELS = ("authors", "propeller", "point", "boat")


def records_of(model: Model, logs: Sequence[Path]) -> list[Record]:
    runs = [load_run(path, "estimation").run for path in logs]
    return [build_record(model, with_drift(run.channels), name=run.name, max_step=STEP) for run in runs]


def with_drift(channels: Mapping[str, Channel]) -> dict[str, Channel]:
    """And ``drift`` [rad]: what the heading has gained on the integral of the yaw rate. Only fits see it."""
    psi, r = channels["psi"], channels["r"]
    turned = cumulative_trapezoid(r.value, r.t, initial=0.0)
    gained = psi.value - psi.value[0] - np.interp(psi.t, r.t, turned)
    return {**channels, "drift": Channel(psi.t, gained, "rad", "psi less the integral of r")}


def sums(record: Record, predicted: Array) -> Array:
    """Sums of squares (2, n_channels): of the error, and of what was measured about its mean."""
    columns = [record.outputs.index(n) for n in CHANNELS]
    seen = np.isfinite(record.y[:, columns]).all(axis=1)
    y = record.y[seen][:, columns]
    return np.array([((y - predicted[seen][:, columns]) ** 2).sum(0), ((y - y.mean(0)) ** 2).sum(0)])


def fitted_from_first_samples(model: Model, records: Sequence[Record], start: Mapping[str, float]) -> Fit:
    """Output error from the first samples, taken for exact as the prediction takes them."""
    exact = SearchSettings(initial_state="given", threads=1)
    return fit(model, records, EstimationOptions(method="output-error"), exact, start=start)


def percent(squares: Array) -> list[float]:
    error, spread = squares
    return [float(x) for x in 100.0 * (1.0 - np.sqrt(error / spread))]


def score(model: Model, records: Sequence[Record], *, left_out: bool) -> dict[str, Any]:
    """Fit in per cent per run and pooled: on the runs left out one by one, or on those that were fitted; and the
    parameters of all runs with two standard errors, that for coloured residuals and that of the jackknife over runs.
    ``unconverged``: the fits whose score is worth nothing, by the run that was left out."""
    everything = fitted_from_first_samples(model, records, {})
    start, parts, predicted, each = everything.model.values, [], [], []
    unconverged = [] if everything.converged else ["none"]
    for k, record in enumerate(records):
        others = [*records[:k], *records[k + 1 :]]
        without = fitted_from_first_samples(model, others, start) if left_out else everything
        fitted, unconverged = without.model, unconverged + [record.name] * (left_out and not without.converged)
        each.append([fitted.values[n] for n in everything.names])
        y = simulate(fitted, record).y
        predicted.append(trace(record, y))
        parts.append(sums(record, y))
    rows = {r.name: dict(zip(CHANNELS, percent(p), strict=True)) for r, p in zip(records, parts, strict=True)}
    pooled = dict(zip(CHANNELS, percent(np.sum(parts, axis=0)), strict=True))
    jackknife = np.sqrt((len(each) - 1) * np.var(each, axis=0))
    names = zip(everything.names, everything.values, everything.robust_errors, jackknife, strict=True)
    parameters = {n: [float(v), float(e), float(j)] for n, v, e, j in names}
    found = {"runs": rows, "pooled": pooled, "parameters": parameters, "traces": predicted}
    return {**found, "unconverged": unconverged}


def trace(record: Record, predicted: Array) -> dict[str, Any]:
    """Measured and predicted by channel, at the times of the samples, for figures.py."""
    rows = np.isfinite(record.y[:, record.outputs.index("u")])
    found: dict[str, Any] = {"name": record.name, "t": record.t[rows].round(3).tolist()}
    for j, name in enumerate(record.outputs):
        found[name] = {
            "measured": record.y[rows, j].round(4).tolist(),
            "predicted": predicted[rows, j].round(4).tolist(),
        }
    return found


def line(name: str, row: dict[str, float]) -> str:
    return f"{name:<26}" + "".join(f"{row[c]:8.1f}" for c in CHANNELS)


def with_fixed(model: Model, given: Sequence[str]) -> Model:
    """The model with parameters fixed at NAME=VALUE."""
    values = {name: float(value) for name, _, value in (item.partition("=") for item in given)}
    return model.replace_parameters(*[model.parameter(n).at(v).fixed() for n, v in values.items()])


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", nargs="+", type=Path, metavar="LOG")
    parser.add_argument("--model", nargs="+", choices=MODELS, default=list(MODELS))
    parser.add_argument("--fix", nargs="+", default=[], metavar="NAME=VALUE", help="give parameters other values")
    parser.add_argument("--out", type=Path, help="write everything, for people and plots, as JSON")
    given = parser.parse_args(words)
    found: dict[str, Any] = {}
    print(f"{'fit in per cent':<26}{'surge':>8}{'sway':>8}{'yaw rate':>9}")
    for name in given.model:
        model = with_fixed(getattr(boat, name)(), given.fix)
        records = records_of(model, given.logs)
        for left_out in (False, True):
            kind = f"{name}, {'left out' if left_out else 'fitted'}"
            found[kind] = score(model, records, left_out=left_out)
            failed = found[kind]["unconverged"]
            said = f"{kind}: no convergence without {', '.join(failed)}"
            print(said if failed else line(kind, found[kind]["pooled"]), flush=True)
    last = found[f"{given.model[-1]}, left out"]
    for run, row in last["runs"].items():
        print(line(f"  {run}", row))
    for name, (value, error, jackknife) in last["parameters"].items():
        print(f"  {name:<12}{value:10.3f} +- {error:.3f}, by the jackknife {jackknife:.3f}")
    if given.out:
        given.out.write_text(json.dumps(found), encoding="utf-8")
    return 1 if any(kind["unconverged"] for kind in found.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
