"""Leave-one-out validation: for each run, fit all other runs and predict the run from its inputs alone.

    python leave_one_out.py LOG... [--model NAME ...] [--fix NAME=VALUE ...] [--nested] [--subsets N] [--out FILE.json]

The fit is by output error (``seatrial.ident.estimation.output_error``). Fit and prediction start at the first sample of
the run, with the measured speeds and heading. The prediction uses only the commands after it. The score is that of
compare() in MATLAB, which the data's authors use: 100 (1 - |y - y_hat| / |y - mean(y)|) per cent. It is computed for
each run, and pooled over all runs. The pooled score sums the squares of all runs, each with the mean of its own run.

``--nested``: nested cross-validation (Varma and Simon 2006). For each run left out, the model and the weight of the
drift of the heading (``e_drift``) are chosen by leaving out the other runs one by one. The criterion is the geometric
mean over channels of the pooled errors. The chosen model is then fitted to the other runs and predicts the run. The run
therefore has no influence on its prediction, not even on the choice of the model.

``--subsets``: check whether the fit of ``boat`` converges on every subset of at least N runs.

Fits that do not converge are listed. They have no score and cannot be chosen, and the exit status is 1.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import boat
import joblib
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from seatrial.ident.data import Channel, Record, build_record, load_run
from seatrial.ident.estimation import EstimationOptions, Fit, SearchSettings, fit, simulate
from seatrial.ident.model import Model

Array = NDArray[np.float64]
CHANNELS = ("u", "v", "r")
ROW_STEP_S = 0.05  # s; at full speed the yaw damping is too fast for steps of 0.1 s
MODELS = ("authors", "propeller", "point", "boat")
WEIGHTS = (0.4, 0.2, 0.1)  # rad; values of e_drift of the model ``boat`` among which --nested chooses
NO_SCORE = np.full((2, len(CHANNELS)), np.nan)  # `sums` of a fit that did not converge
MOST_RESTARTS = 3  # restarts of a search that did not converge, each from the end of the previous one


def records_of(model: Model, logs: Sequence[Path]) -> list[Record]:
    """Return the records of the logs for a model, with the channel ``drift``."""
    runs = [load_run(path, "estimation").run for path in logs]
    return [build_record(model, with_drift(run.channels), name=run.name, max_step=ROW_STEP_S) for run in runs]


def with_drift(channels: Mapping[str, Channel]) -> dict[str, Channel]:
    """Return the channels and ``drift`` [rad], the heading less the integral of the yaw rate. Only fits use it."""
    psi, r = channels["psi"], channels["r"]
    integral = cumulative_trapezoid(r.value, r.t, initial=0.0)
    drift = psi.value - psi.value[0] - np.interp(psi.t, r.t, integral)
    return {**channels, "drift": Channel(psi.t, drift, "rad", "psi less the integral of r")}


def sums(record: Record, predicted: Array) -> Array:
    """Return the sums of squares (2, n_channels) of the prediction errors, and of the measurements less their mean."""
    columns = [record.outputs.index(n) for n in CHANNELS]
    sampled = np.isfinite(record.y[:, columns]).all(axis=1)
    y = record.y[sampled][:, columns]
    return np.array([((y - predicted[sampled][:, columns]) ** 2).sum(0), ((y - y.mean(0)) ** 2).sum(0)])


def fitted_from_first_samples(model: Model, records: Sequence[Record], start: Mapping[str, float]) -> Fit:
    """Fit a model by output error. The first samples are taken as exact initial states, as in the prediction."""
    exact = SearchSettings(initial_state="given", threads=1)
    for _ in range(1 + MOST_RESTARTS):
        found = fit(model, records, EstimationOptions(method="output-error"), exact, start=start)
        if found.converged:
            break
        start = dict(zip(found.names, found.values, strict=True))
    return found


def percent(squares: Array) -> list[float]:
    """Return the score of each channel in per cent from `sums`."""
    error, spread = squares
    return [float(x) for x in 100.0 * (1.0 - np.sqrt(error / spread))]


def score(model: Model, records: Sequence[Record], *, left_out: bool) -> dict[str, Any]:
    """Return the scores of a model, its parameters and its predictions.

    Parameters
    ----------
    left_out : bool
        Whether each run is predicted by a fit to the other runs. Otherwise all runs are predicted by the fit to all.

    Returns
    -------
    dict
        `runs` and `pooled`: scores in per cent. `parameters`: values of the fit to all runs, each with its standard
        error for coloured residuals and that of the jackknife over runs. `traces`: predictions. `unconverged`: fits
        that did not converge, by the run that was left out ("none" for the fit to all runs).
    """
    full_fit = fitted_from_first_samples(model, records, {})
    shared = [
        n for n in full_fit.names if n in full_fit.model.values
    ]  # parameters that each run has for itself are left out
    start, parts, predicted, each = full_fit.model.values, [], [], []
    unconverged = [] if full_fit.converged else ["none"]
    for k, record in enumerate(records):
        others = [*records[:k], *records[k + 1 :]]
        without = fitted_from_first_samples(model, others, start) if left_out else full_fit
        fitted, unconverged = without.model, unconverged + [record.name] * (left_out and not without.converged)
        each.append([fitted.values[n] for n in shared])
        y = simulate(fitted, record).y
        predicted.append(trace(record, y))
        parts.append(sums(record, y))
    jackknife = np.sqrt((len(each) - 1) * np.var(each, axis=0))
    errors = dict(zip(full_fit.names, full_fit.robust_errors, strict=True))
    parameters = {n: [start[n], float(errors[n]), float(j)] for n, j in zip(shared, jackknife, strict=True)}
    return {
        **table([r.name for r in records], parts),
        "parameters": parameters,
        "traces": predicted,
        "unconverged": unconverged,
    }


def table(names: Sequence[str], parts: Sequence[Array]) -> dict[str, Any]:
    """Return the scores in per cent, by run and pooled, from the `sums` of all runs."""
    rows = {n: dict(zip(CHANNELS, percent(p), strict=True)) for n, p in zip(names, parts, strict=True)}
    return {"runs": rows, "pooled": dict(zip(CHANNELS, percent(np.sum(parts, axis=0)), strict=True))}


def candidates(fix: Sequence[str]) -> dict[str, Model]:
    """Return the models among which --nested chooses: all models, and ``boat`` with each value of e_drift."""
    others = {name: with_fixed(getattr(boat, name)(), fix) for name in MODELS[:-1]}
    return others | {f"boat, e_drift {e:g}": with_fixed(boat.boat(), [*fix, f"e_drift={e}"]) for e in WEIGHTS}


def errors_left_out(model: Model, records: Sequence[Record], out: tuple[int, ...]) -> dict[int, Array]:
    """Return the `sums` of the runs left out, predicted by a fit to the other runs; NaN if the fit did not converge."""
    found = fitted_from_first_samples(model, [r for i, r in enumerate(records) if i not in out], {})
    return {i: sums(records[i], simulate(found.model, records[i]).y) if found.converged else NO_SCORE for i in out}


def nested(models: Mapping[str, Model], logs: Sequence[Path], jobs: int) -> dict[str, Any]:
    """Return the scores of the nested leave-one-out validation, and the chosen model of each run.

    A fit without the runs i and j is used twice: to choose the model for i by the error of j, and the reverse.
    """
    records = {name: records_of(model, logs) for name, model in models.items()}
    names, runs = [r.name for r in next(iter(records.values()))], range(len(logs))
    work = [(name, out) for name in models for out in [*((i,) for i in runs), *combinations(runs, 2)]]
    done = joblib.Parallel(n_jobs=jobs)(joblib.delayed(errors_left_out)(models[n], records[n], o) for n, o in work)
    errors = dict(zip(work, done, strict=True))

    def criterion(name: str, k: int) -> float:
        """Return the logarithm of the mean error of a model without run k; infinite if a fit did not converge.

        The mean is geometric over channels and pooled over the other runs.
        """
        pairs = [errors[name, (min(j, k), max(j, k))][j] for j in runs if j != k]
        # The first term is zero, or NaN if the fit without run k did not converge.
        squares = np.sum([errors[name, (k,)][k] * 0.0, *pairs], axis=0)
        return float(np.nan_to_num(np.log(squares[0] / squares[1]).mean(), nan=np.inf))

    chosen = [min(models, key=lambda name, k=k: criterion(name, k)) for k in runs]  # type: ignore[misc]
    failed = [f"{name} without {' and '.join(names[i] for i in out)}" for (name, out), found in errors.items()
              if np.isnan([*found.values()]).any()]  # fmt: skip
    found = table(names, [errors[name, (k,)][k] for k, name in enumerate(chosen)])
    return {**found, "chosen": dict(zip(names, chosen, strict=True)), "unconverged": failed}


def subsets(model: Model, logs: Sequence[Path], least: int, jobs: int) -> dict[str, Any]:
    """Return the number of fits to all subsets of at least ``least`` runs, and the subsets that did not converge."""
    records = records_of(model, logs)
    chosen = [subset for n in range(least, len(logs) + 1) for subset in combinations(records, n)]
    done = joblib.Parallel(n_jobs=jobs)(joblib.delayed(fitted_from_first_samples)(model, [*c], {}) for c in chosen)
    failed = [", ".join(r.name for r in c) for c, found in zip(chosen, done, strict=True) if not found.converged]
    return {"fits": len(chosen), "unconverged": failed}


def trace(record: Record, predicted: Array) -> dict[str, Any]:
    """Return the measured and predicted values of each channel at the times of the samples, for figures.py."""
    rows = np.isfinite(record.y[:, record.outputs.index("u")])
    found: dict[str, Any] = {"name": record.name, "t": record.t[rows].round(3).tolist()}
    for j, name in enumerate(record.outputs):
        found[name] = {
            "measured": record.y[rows, j].round(4).tolist(),
            "predicted": predicted[rows, j].round(4).tolist(),
        }
    return found


def line(name: str, row: dict[str, float]) -> str:
    """Return a line of the printed table."""
    return f"{name:<26}" + "".join(f"{row[c]:8.1f}" for c in CHANNELS)


def with_fixed(model: Model, assignments: Sequence[str]) -> Model:
    """Return the model with parameters fixed at values, each given as NAME=VALUE."""
    values = {name: float(value) for name, _, value in (item.partition("=") for item in assignments)}
    return model.replace_parameters(*[model.parameter(n).at(v).fixed() for n, v in values.items()])


def main(words: Sequence[str] | None = None) -> int:
    """Run the validation, print its table, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", nargs="+", type=Path, metavar="LOG")
    parser.add_argument("--model", nargs="+", choices=MODELS, default=list(MODELS))
    parser.add_argument("--fix", nargs="+", default=[], metavar="NAME=VALUE", help="fix parameters at values")
    parser.add_argument("--nested", action="store_true", help="nested cross-validation; see above")
    parser.add_argument("--subsets", type=int, metavar="N", help="fit every subset of at least N runs; see above")
    parser.add_argument("--jobs", type=int, default=2, help="number of processes of --nested and --subsets (2)")
    parser.add_argument("--out", type=Path, help="write scores, parameters and predictions as JSON")
    options = parser.parse_args(words)
    found: dict[str, Any] = {}
    if options.subsets:
        found = subsets(with_fixed(boat.boat(), options.fix), options.logs, options.subsets, options.jobs)
        print(f"{found['fits']} fits to {options.subsets} runs and more: {len(found['unconverged'])} did not converge")
        for failed_fit in found["unconverged"]:
            print(f"  no convergence: {failed_fit}")
        return finish(found, options.out, failed=bool(found["unconverged"]))
    print(f"{'fit in per cent':<26}{'surge':>8}{'sway':>8}{'yaw rate':>9}")
    if options.nested:
        found = nested(candidates(options.fix), options.logs, options.jobs)
        print(line("nested, left out", found["pooled"]))
        for run, row in found["runs"].items():
            print(f"{line(f'  {run}', row)}   {found['chosen'][run]}")
        for name, n in Counter(found["chosen"].values()).most_common():
            print(f"  {name}: chosen for {n} of {len(options.logs)} runs")
        for failed_fit in found["unconverged"]:
            print(f"  no convergence: {failed_fit}")
        return finish(found, options.out, failed=bool(found["unconverged"]))
    for name in options.model:
        model = with_fixed(getattr(boat, name)(), options.fix)
        records = records_of(model, options.logs)
        for left_out in (False, True):
            kind = f"{name}, {'left out' if left_out else 'fitted'}"
            found[kind] = score(model, records, left_out=left_out)
            failed = found[kind]["unconverged"]
            message = f"{kind}: no convergence without {', '.join(failed)}"
            print(message if failed else line(kind, found[kind]["pooled"]), flush=True)
    last = found[f"{options.model[-1]}, left out"]
    for run, row in last["runs"].items():
        print(line(f"  {run}", row))
    for name, (value, error, jackknife) in last["parameters"].items():
        print(f"  {name:<12}{value:10.3f} +- {error:.3f}, by the jackknife {jackknife:.3f}")
    return finish(found, options.out, failed=any(kind["unconverged"] for kind in found.values()))


def finish(found: dict[str, Any], out: Path | None, *, failed: bool) -> int:
    """Write the results to a file if one is given, and return the exit status."""
    if out:
        out.write_text(json.dumps(found), encoding="utf-8")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
