"""The thruster's job: a bench log in; its model, static curve and report out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.errors import SeatrialError, counted
from ident.bench_runs import RATE, thruster_channels, thruster_name
from ident.bench_start import first_guess, shaft_guess
from ident.cautions import cautions
from ident.curve_job import is_static, static_curve
from ident.dataset import Record, build_record
from ident.fit import Fit, fit
from ident.jobs import Say, write_all
from ident.judged import Judged, calibration_notes, judged_alone
from ident.loading import Loaded, check_ahead, envelope, load_run
from ident.model import Model
from ident.models.thruster import delay_step, on_a_copy, thruster
from ident.outcome import Json, fit_part
from ident.pe import Likelihood
from ident.profile import check_names, profile, profile_part
from ident.stage import Stage, View, outliers

Array = NDArray[np.float64]
DEAD_ZONES = tuple(0.0025 * k for k in range(81))  # up to a fifth of full command
N_SEARCHES = 3
SETTLED, AVERAGED = 1.0, 0.6  # s that a command must have lasted, and over which it is then averaged


def bench(
    logs: Sequence[Path],
    out: Path,
    *,
    name: str | None,
    settle: float = 1.5,
    profiles: Sequence[str] = (),
    robust: bool = False,
    restricted: bool = True,
    horizon: float | None = None,
    command: str,
    say: Say,
) -> Json:
    """Fit the thruster model to bench logs of one thruster, or a static curve where nobody measured the shaft.

    ``profiles``: parameters that get a profile likelihood; ``robust``: allow outliers; ``restricted``:
    noise by restricted likelihood; ``horizon``: s ahead that predictions are judged, one by default.
    """
    loaded = [load_run(path, "estimation") for path in logs]
    if is_static(loaded, name):
        asked = {"--robust": robust, "--profile": profiles, "--ahead": horizon is not None}
        _refuse(logs[0], [option for option, given in asked.items() if given])
        return static_curve(loaded, out, name=name, settle=settle, command=command, say=say)
    check_ahead(horizon, loaded)
    name = name or thruster_name(loaded[0])
    has_force = all("force" in x.run.channels for x in loaded)
    model = thruster(force=has_force)
    check_names(model, profiles)
    records = [_record(model, x, name) for x in loaded]
    if shaft_guess(records)[0] > model.parameter("tau").bounds[1]:
        model = thruster("slow", force=has_force)
        records = [_record(model, x, name) for x in loaded]
    say(f"fitting the thruster to {counted(len(records), 'run')}, {sum(r.n_rows for r in records)} rows")
    fitted, records = fit_on_a_copy(model, records, lambda m: [_record(m, x, name) for x in loaded],
                                    robust=robust, restricted=restricted)
    result = envelope(loaded, command) | {"kind": "thruster", "fit": fit_part(fitted, model.values)}
    views = tuple(View(fitted.model, r, v) for r, v in zip(records, fitted.record_values, strict=True))
    stage = Stage(fitted.model, fitted, views, ())
    result |= judged_alone(Judged(stage, horizon)) | {"cautions": cautions(fitted, records)}
    result["notes"] = outliers(stage) + calibration_notes(result["calibration"], result["horizon"])
    if has_force:
        result["static"] = _static(fitted, loaded, name)
    if profiles:
        say(f"profile likelihood of {', '.join(profiles)}")
        result["profiles"] = [profile_part(profile(fitted, records, p)) for p in profiles]
    result["answer"] = _answer(fitted, has_force)
    ranges = {"n_cmd": _range(np.concatenate([r.u[:, 0] for r in records]))}
    write_all(out, result, fitted, ranges)
    return result


def _refuse(path: Path, options: Sequence[str]) -> None:
    """Options that a static curve does not know; raises SeatrialError where there is one."""
    if options:
        raise SeatrialError(
            f"{path}: has no shaft speed, so there is a static curve alone, which {' and '.join(options)} cannot "
            "change; leave it out"
        )


def fit_on_a_copy(
    model: Model, records: list[Record], again: Callable[[Model], list[Record]], *, robust: bool = False,
    restricted: bool = False,
) -> tuple[Fit, list[Record]]:
    """``fit_thruster``, and once more with the delay on one of the command's copies.

    ``again``: the records for a model with other copies; ``restricted``: noise by restricted likelihood. Returns the
    records that belong to the fit, too.
    """
    fitted = fit_thruster(model, records, robust=robust)
    pace = on_a_copy(fitted.model.values["tau"], delay_step(model))
    if pace:
        exact = thruster(pace, force="thrust" in model.provides)
        records = again(exact)
        values = {n: v for n, v in fitted.model.values.items() if n in exact.values}
        start = exact.with_values(values).replace_parameters(exact.parameter("d").at(values["d"]).freed())
        fitted = fit(start, records, robust=robust)
    return _restricted(fitted, records) if restricted else fitted, records


def _restricted(top: Fit, records: Sequence[Record]) -> Fit:
    """From the maximum of the likelihood to that of the restricted one; what it took to get there counts."""
    found = fit(top.model, records, restricted=True)
    return replace(found, iterations=top.iterations + found.iterations, evaluations=top.evaluations + found.evaluations,
                   cpu_seconds=top.cpu_seconds + found.cpu_seconds,
                   message=top.message if found.converged else found.message)


def fit_thruster(model: Model, records: Sequence[Record], *, robust: bool = False) -> Fit:
    """The model fitted from least squares. The end of the dead zone is felt only within it, so it is looked for on a
    grid, and again with what the fit then says of all else, until it stays. ``robust``: allow outliers."""
    guess = first_guess(records, "thrust" in model.provides)
    guess["tau"] = min(guess["tau"], 0.95 * model.parameter("tau").bounds[1])
    fitted = fit(model, records, start=guess, robust=robust)
    at, found = [p.name for p in model.parameters].index("d"), -1.0
    for _ in range(N_SEARCHES):
        likelihood, values = Likelihood(fitted.model), fitted.record_values

        def value(d: float, likelihood: Likelihood = likelihood, values: Array = values) -> float:
            tried = values.copy()
            tried[:, at] = d
            return sum(likelihood.value(r, v) for r, v in zip(records, tried, strict=True))

        before, found = found, max(DEAD_ZONES, key=value)
        if abs(found - before) < 2 * DEAD_ZONES[1]:
            break
        fitted = fit(fitted.model.replace_parameters(fitted.model.parameter("d").at(found).freed()), records)
    return fitted


def _record(model: Model, loaded: Loaded, name: str) -> Record:
    channels = thruster_channels(loaded, model, name)
    return build_record(model, channels, name=loaded.run.name, rate=RATE)


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
