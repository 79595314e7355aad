"""The thruster's job: a bench log in; its model, static curve and report out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.errors import SeatrialError
from ident.curve_job import is_static, static_curve
from ident.dataset import Record, build_record
from ident.fit import Fit, fit
from ident.jobs import Say, write_all
from ident.loading import Loaded, envelope, load_run
from ident.model import Model
from ident.models.thruster import delayed_channels, thruster
from ident.outcome import Json, fit_part, residual_part
from ident.pe import FilterRun, Likelihood
from ident.predict import FreeRun, free_run, one_step

Array = NDArray[np.float64]
DEAD_ZONES = tuple(0.0025 * k for k in range(81))  # up to a fifth of full command
RATE = 50.0  # rows a second for the load cell and the shaft speed
SETTLED, AVERAGED = 1.0, 0.6  # s that a command must have lasted, and over which it is then averaged


def bench(logs: Sequence[Path], out: Path, *, name: str | None, settle: float = 1.5, command: str, say: Say) -> Json:
    """Fit the thruster model to bench logs of one thruster, or a static curve where nobody measured the shaft."""
    loaded = [load_run(path, "estimation") for path in logs]
    if is_static(loaded, name):
        return static_curve(loaded, out, name=name, settle=settle, command=command, say=say)
    name = name or _thruster_name(loaded[0])
    has_force = all("force" in x.run.channels for x in loaded)
    model = thruster(force=has_force)
    records = [_record(model, x, name) for x in loaded]
    say(f"fitting the thruster to {len(records)} run(s), {sum(r.n_rows for r in records)} rows")
    fitted = _fit(model, records, first_guess(records, has_force))
    likelihood = Likelihood(fitted.model)
    runs = [likelihood.filter(r, v) for r, v in zip(records, fitted.record_values, strict=True)]
    frees = [free_run(fitted.model, r, v, likelihood) for r, v in zip(records, fitted.record_values, strict=True)]
    result = envelope(loaded, command) | {"kind": "thruster", "fit": fit_part(fitted, model.values)}
    result |= _evidence(fitted.model, records, runs, frees)
    if has_force:
        result["static"] = _static(fitted, loaded, name)
    result["answer"] = _answer(fitted, has_force)
    ranges = {"n_cmd": _range(np.concatenate([r.u[:, 0] for r in records]))}
    write_all(out, result, fitted, ranges)
    return result


def _fit(model: Model, records: Sequence[Record], guess: Mapping[str, float]) -> Fit:
    """The end of the dead zone is felt only within it, so it is looked for on a grid before it is estimated."""
    first = fit(model, records, start=guess)
    likelihood, at = Likelihood(first.model), [p.name for p in model.parameters].index("d")

    def value(d: float) -> float:
        tried = first.record_values.copy()
        tried[:, at] = d
        return sum(likelihood.value(r, v) for r, v in zip(records, tried, strict=True))

    d = max(DEAD_ZONES, key=value)
    return fit(first.model.replace_parameters(model.parameter("d").at(d).freed()), records)


def _thruster_name(loaded: Loaded) -> str:
    names = [n.removeprefix("n_cmd_") for n in loaded.run.channels if n.startswith("n_cmd_")]
    moved = [
        n for n in names if f"n_{n}" in loaded.run.channels and np.ptp(loaded.run.channels[f"n_cmd_{n}"].value) > 0
    ]
    if len(moved) != 1:
        said = ", ".join(moved) if moved else "none"
        raise SeatrialError(
            f"{loaded.about['path']}: thrusters with commands and shaft speed: {said}; name one with --thruster"
        )
    return moved[0]


def _record(model: Model, loaded: Loaded, name: str) -> Record:
    found = loaded.run.channels
    for needed in (f"n_cmd_{name}", f"n_{name}"):
        if needed not in found:
            raise SeatrialError(f"{loaded.about['path']}: no signal {needed!r}; it has {', '.join(sorted(found))}")
    channels = delayed_channels(found[f"n_cmd_{name}"]) | {"n": found[f"n_{name}"]}
    if "force" in found:
        channels["force"] = found["force"]
    return build_record(model, channels, name=loaded.run.name, rate=RATE)


def first_guess(records: Sequence[Record], has_force: bool) -> dict[str, float]:
    """Thrust coefficients by least squares of force on measured shaft speed; the shaft's pole from its steps."""
    if not has_force:
        return {}
    rows = []
    for r in records:
        seen = np.isfinite(r.y[:, 1])
        n = np.interp(r.t[seen], r.t[np.isfinite(r.y[:, 0])], r.y[np.isfinite(r.y[:, 0]), 0])
        rows.append(np.column_stack([n * np.abs(n), n * n, np.ones(n.size), r.y[seen, 1]]))
    table = np.concatenate(rows)
    c1, c2, bias = np.linalg.lstsq(table[:, :3], table[:, 3], rcond=None)[0]
    return {"c1": max(float(c1), 0.1), "c2": float(c2), "bias": float(bias)}


def _evidence(model: Model, records: Sequence[Record], runs: Sequence[FilterRun], frees: Sequence[FreeRun]) -> Json:
    part: Json = {"traces": [], "inputs": [], "residuals": [], "cross": []}
    errors: Json = {"one_step": {}, "free_run": {}}
    for record, run, free in zip(records, runs, frees, strict=True):
        part["inputs"].append(
            {"record": record.name, "name": "n_cmd", "unit": "", "t": record.t, "value": record.u[:, 0]}
        )
        for j, o in enumerate(model.outputs):
            seen = np.isfinite(record.y[:, j])
            part["traces"].append(
                {
                    "record": record.name,
                    "role": "estimation",
                    "channel": o.name,
                    "unit": o.unit,
                    "angle": False,
                    "t": record.t[seen],
                    "measured": record.y[seen, j],
                    "model": free.y[seen, j],
                    "sd": free.sd[seen, j],
                    "before": None,
                }
            )
        residuals, cross = residual_part(model, record, run.standardised)
        part["residuals"] += residuals
        part["cross"] += [c for c in cross if c["input"] == "n_cmd_0"]
        for kind, found in (("one_step", one_step(model, record, run)), ("free_run", free.errors)):
            for name, e in found.items():
                unit = next(o.unit for o in model.outputs if o.name == name)
                errors[kind][name] = {"before": None, "after": e.rms, "unit": unit, "low": None, "high": None}
    part["before_after"] = {"estimation": errors}
    return part


def _static(fitted: Fit, loaded: Sequence[Loaded], name: str) -> Json:
    """Steady points: the last second of every command that lasted, and the fitted curve with its band."""
    points = [p for i, x in enumerate(loaded) for p in _steady(x, name, fitted.estimate("bias", i)[0])]
    grid = np.linspace(-1, 1, 81)
    B = np.column_stack([grid * np.abs(grid), grid**2])
    value = {c: fitted.estimate(c)[0] for c in ("c1", "c2")}
    at = [fitted.names.index(c) for c in ("c1", "c2")]
    P = fitted.covariance[np.ix_(at, at)]
    return {
        "n": [p[0] for p in points],
        "force": [p[1] for p in points],
        "sd": [p[2] for p in points],
        "n_model": grid,
        "force_model": B @ [value["c1"], value["c2"]],
        "force_sd": np.sqrt(np.einsum("ij,jk,ik->i", B, P, B)),
    }


def _steady(loaded: Loaded, name: str, bias: float) -> list[tuple[float, float, float]]:
    command, n, f = (loaded.run.channels[c] for c in (f"n_cmd_{name}", f"n_{name}", "force"))
    changes = np.append(np.flatnonzero(np.diff(command.value, prepend=np.nan) != 0), command.t.size - 1)
    points = []
    for a, b in pairwise(changes):
        end = command.t[b]
        if end - command.t[a] < SETTLED + AVERAGED:
            continue
        speed, force = ((c.value[(c.t > end - AVERAGED) & (c.t <= end)]) for c in (n, f))
        if speed.size > 3 and force.size > 3:
            points.append((float(speed.mean()), float(force.mean() - bias), float(force.std() / np.sqrt(force.size))))
    return points


def _range(z: Array) -> tuple[float, float]:
    return float(z.min()), float(z.max())


def _answer(fitted: Fit, has_force: bool) -> str:
    a, tau, d = (fitted.estimate(n) for n in ("a", "tau", "d"))
    shaft = (
        f"the shaft follows its command {1e3 * tau[0]:.0f} ms late with a time constant of {1e3 / a[0]:.0f} ms "
        f"and does not turn below {100 * d[0]:.1f} % of full command"
    )
    if not has_force:
        return shaft[0].upper() + shaft[1:] + "; without a load cell nothing is known of its thrust."
    (c1, s1), (c2, s2) = fitted.estimate("c1"), fitted.estimate("c2")
    s = float(np.hypot(s1, s2))
    return f"The thruster gives {c1 + c2:.1f} N ahead and {c1 - c2:.1f} N astern at full speed (± {s:.2g} N); {shaft}."
