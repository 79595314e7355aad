"""Leave one run out: fit all runs but one, predict that one from its inputs alone, and so on through all runs.

    python leave_one_out.py LOG... [--model NAME ...] [--fix NAME=VALUE ...] [--nested] [--subsets N] [--out FILE.json]

The fit is by output error (``seatrial.ident.estimation.output_error``). Fit and prediction start at the first sample of
the run from the speeds and the heading measured there, and the prediction sees nothing but the commands after it. The
score is that of compare() in MATLAB, which the data's authors use, 100 (1 - |y - y_hat| / |y - mean(y)|) per cent: for
each run, and pooled, with the squares of all runs summed and every run's own mean taken away.

``--nested``: nested cross-validation (Varma and Simon 2006). For each run left out, the model and the weight of the
heading's gain (``e_drift``) are chosen by leaving out the other runs one by one, by the geometric mean over channels of
the pooled errors; the choice is then fitted to the others and predicts the run. So nothing about a run, not even which
model is used for it, comes from that run.

``--subsets``: whether the fit of ``boat`` converges on every choice of so many runs and more.

Fits that do not converge are named; they have no score, no choice falls on them, and the exit status is 1.
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
STEP = 0.05  # s; at full speed the yaw damping is too quick for steps of a tenth of a second
MODELS = ("authors", "propeller", "point", "boat")
WEIGHTS = (0.4, 0.2, 0.1)  # rad; e_drift of the model ``boat`` among which --nested chooses
NO_SCORE = np.full((2, len(CHANNELS)), np.nan)
MOST_RESTARTS = 3  # of a search that stopped short, from where it stopped


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
    for _ in range(1 + MOST_RESTARTS):
        found = fit(model, records, EstimationOptions(method="output-error"), exact, start=start)
        if found.converged:
            break
        start = dict(zip(found.names, found.values, strict=True))
    return found


def percent(squares: Array) -> list[float]:
    error, spread = squares
    return [float(x) for x in 100.0 * (1.0 - np.sqrt(error / spread))]


def score(model: Model, records: Sequence[Record], *, left_out: bool) -> dict[str, Any]:
    """Fit in per cent per run and pooled: on the runs left out one by one, or on those that were fitted; and the
    parameters of all runs with two standard errors, that for coloured residuals and that of the jackknife over runs.
    ``unconverged``: the fits whose score is worth nothing, by the run that was left out."""
    everything = fitted_from_first_samples(model, records, {})
    shared = [n for n in everything.names if n in everything.model.values]  # not those that each run has for itself
    start, parts, predicted, each = everything.model.values, [], [], []
    unconverged = [] if everything.converged else ["none"]
    for k, record in enumerate(records):
        others = [*records[:k], *records[k + 1 :]]
        without = fitted_from_first_samples(model, others, start) if left_out else everything
        fitted, unconverged = without.model, unconverged + [record.name] * (left_out and not without.converged)
        each.append([fitted.values[n] for n in shared])
        y = simulate(fitted, record).y
        predicted.append(trace(record, y))
        parts.append(sums(record, y))
    jackknife = np.sqrt((len(each) - 1) * np.var(each, axis=0))
    errors = dict(zip(everything.names, everything.robust_errors, strict=True))
    parameters = {n: [start[n], float(errors[n]), float(j)] for n, j in zip(shared, jackknife, strict=True)}
    return {
        **table([r.name for r in records], parts),
        "parameters": parameters,
        "traces": predicted,
        "unconverged": unconverged,
    }


def table(names: Sequence[str], parts: Sequence[Array]) -> dict[str, Any]:
    """Fit in per cent by run and pooled, of ``sums`` by run."""
    rows = {n: dict(zip(CHANNELS, percent(p), strict=True)) for n, p in zip(names, parts, strict=True)}
    return {"runs": rows, "pooled": dict(zip(CHANNELS, percent(np.sum(parts, axis=0)), strict=True))}


def candidates(fix: Sequence[str]) -> dict[str, Model]:
    """The models, and ``boat`` with each weight of the heading's gain."""
    plain = {name: with_fixed(getattr(boat, name)(), fix) for name in MODELS[:-1]}
    return plain | {f"boat, e_drift {e:g}": with_fixed(boat.boat(), [*fix, f"e_drift={e}"]) for e in WEIGHTS}


def errors_left_out(model: Model, records: Sequence[Record], out: tuple[int, ...]) -> dict[int, Array]:
    """``sums`` of each run left out, predicted by one fit to all runs but those; not a number without convergence."""
    found = fitted_from_first_samples(model, [r for i, r in enumerate(records) if i not in out], {})
    return {i: sums(records[i], simulate(found.model, records[i]).y) if found.converged else NO_SCORE for i in out}


def nested(models: Mapping[str, Model], logs: Sequence[Path], jobs: int) -> dict[str, Any]:
    """Nested leave-one-out: fit in per cent by run and pooled, and what was chosen for each run.

    A fit without the runs i and j serves i left out with j to choose by, and j left out with i to choose by.
    """
    records = {name: records_of(model, logs) for name, model in models.items()}
    names, runs = [r.name for r in next(iter(records.values()))], range(len(logs))
    work = [(name, out) for name in models for out in [*((i,) for i in runs), *combinations(runs, 2)]]
    done = joblib.Parallel(n_jobs=jobs)(joblib.delayed(errors_left_out)(models[n], records[n], o) for n, o in work)
    errors = dict(zip(work, done, strict=True))

    def criterion(name: str, k: int) -> float:
        """Logarithm of the geometric mean over channels of the errors without run k; infinite without convergence."""
        pairs = [errors[name, (min(j, k), max(j, k))][j] for j in runs if j != k]
        squares = np.sum([errors[name, (k,)][k] * 0.0, *pairs], axis=0)  # not a number if the last fit did not converge
        return float(np.nan_to_num(np.log(squares[0] / squares[1]).mean(), nan=np.inf))

    chosen = [min(models, key=lambda name, k=k: criterion(name, k)) for k in runs]  # type: ignore[misc]
    failed = [f"{name} without {' and '.join(names[i] for i in out)}" for (name, out), found in errors.items()
              if np.isnan([*found.values()]).any()]  # fmt: skip
    found = table(names, [errors[name, (k,)][k] for k, name in enumerate(chosen)])
    return {**found, "chosen": dict(zip(names, chosen, strict=True)), "unconverged": failed}


def subsets(model: Model, logs: Sequence[Path], least: int, jobs: int) -> dict[str, Any]:
    """How many fits to ``least`` and more of the runs there are, and which of them did not converge."""
    records = records_of(model, logs)
    chosen = [some for n in range(least, len(logs) + 1) for some in combinations(records, n)]
    done = joblib.Parallel(n_jobs=jobs)(joblib.delayed(fitted_from_first_samples)(model, [*c], {}) for c in chosen)
    failed = [", ".join(r.name for r in c) for c, found in zip(chosen, done, strict=True) if not found.converged]
    return {"fits": len(chosen), "unconverged": failed}


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
    parser.add_argument("--nested", action="store_true", help="choose the model inside each run left out; see above")
    parser.add_argument("--subsets", type=int, metavar="N", help="fit every choice of N runs and more; see above")
    parser.add_argument("--jobs", type=int, default=2, help="processes of --nested (2)")
    parser.add_argument("--out", type=Path, help="write everything, for people and plots, as JSON")
    given = parser.parse_args(words)
    found: dict[str, Any] = {}
    if given.subsets:
        found = subsets(with_fixed(boat.boat(), given.fix), given.logs, given.subsets, given.jobs)
        print(f"{found['fits']} fits to {given.subsets} runs and more: {len(found['unconverged'])} did not converge")
        for which in found["unconverged"]:
            print(f"  no convergence: {which}")
        return finish(found, given.out, failed=bool(found["unconverged"]))
    print(f"{'fit in per cent':<26}{'surge':>8}{'sway':>8}{'yaw rate':>9}")
    if given.nested:
        found = nested(candidates(given.fix), given.logs, given.jobs)
        print(line("nested, left out", found["pooled"]))
        for run, row in found["runs"].items():
            print(f"{line(f'  {run}', row)}   {found['chosen'][run]}")
        for name, n in Counter(found["chosen"].values()).most_common():
            print(f"  {name}: chosen for {n} of {len(given.logs)} runs")
        for which in found["unconverged"]:
            print(f"  no convergence: {which}")
        return finish(found, given.out, failed=bool(found["unconverged"]))
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
    return finish(found, given.out, failed=any(kind["unconverged"] for kind in found.values()))


def finish(found: dict[str, Any], out: Path | None, *, failed: bool) -> int:
    """Writes what was found; the exit status."""
    if out:
        out.write_text(json.dumps(found), encoding="utf-8")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
