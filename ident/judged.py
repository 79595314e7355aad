"""How well a fitted model predicts every record, as the content of result.json: errors, traces, tracks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident import calibration
from ident.calibration import Calibration
from ident.doubt import doubt_of
from ident.model import Model
from ident.outcome import Json, input_traces, residual_part
from ident.pe import Likelihood
from ident.predict import BLOCK, Errors, FreeRun, ahead, free_run, one_step, pooled, ratio_interval, usual_horizon
from ident.stage import Stage, View

KINDS = ("one_step", "ten_seconds", "free_run")  # the second is over the result's horizon, however long that is


class Judged:
    """Prediction errors of a stage on every record, computed once. ``horizon``: s that predictions go ahead between
    one step and the free run, by default the model's usual one."""

    def __init__(self, stage: Stage, horizon: float | None = None) -> None:
        self.stage, self.horizon = stage, horizon or usual_horizon(stage.model)
        self.likelihood = Likelihood(stage.model)
        self.free = {
            role: [
                free_run(stage.model, v.record, v.values, self.likelihood, doubt_of(stage.fit, i if fitted else None))
                for i, v in enumerate(views)
            ]
            for role, views, fitted in (("estimation", stage.estimation, True), ("validation", stage.validation, False))
        }

    def views(self, role: str) -> Sequence[View]:
        return self.stage.estimation if role == "estimation" else self.stage.validation

    def errors(self, role: str) -> dict[str, dict[str, Errors]]:
        model, views = self.stage.model, self.views(role)
        return {
            "one_step": pooled([one_step(model, v.record, v.run) for v in views]),
            "ten_seconds": pooled([ahead(model, v.record, v.values, v.run.x_filt, self.horizon) for v in views]),
            "free_run": pooled([f.errors for f in self.free[role]]),
        }

    def calibration(self, role: str) -> dict[str, dict[str, Calibration]]:
        """Whether the errors are as large as the model says they are, by horizon and channel."""
        model, views = self.stage.model, self.views(role)
        far = [calibration.ahead(model, v.record, v.values, v.run, self.horizon, self.likelihood) for v in views]
        free = [calibration.free_run(model, v.record, f) for v, f in zip(views, self.free[role], strict=True)]
        return {
            "one_step": calibration.pooled([calibration.one_step(model, v.run) for v in views]),
            "ten_seconds": calibration.pooled(far),
            "free_run": calibration.pooled(free, together=True),
        }


def calibration_part(judged: Judged, roles: Sequence[str]) -> Json:
    """``calibration``: role -> horizon -> channel."""
    return {
        role: {
            kind: {name: vars(c) | {"verdict": c.verdict} for name, c in channels.items()}
            for kind, channels in judged.calibration(role).items()
        }
        for role in roles
    }


def calibration_notes(part: Json, horizon: float) -> list[str]:
    """A line for each kind of prediction whose bands are wrong, on data that the fit has not seen where there are some;
    ``horizon``: s."""
    role = "validation" if "validation" in part else "estimation"
    words = {"one_step": "one step ahead", "ten_seconds": f"{horizon:g} s ahead", "free_run": "free-running"}
    notes = []
    for verdict, what in (("too sure", "larger"), ("too cautious", "smaller")):
        for kind, channels in part[role].items():
            wrong = [f"{n} {c['scale']:.2g}" for n, c in channels.items() if c["verdict"] == verdict]
            if wrong:
                notes.append(f"On {role} data, {words[kind]}, errors are {what} than the model says, by these factors: "
                             f"{', '.join(wrong)}.")
    return notes


def judged_alone(judged: Judged) -> Json:
    """Traces, errors and residuals of one fitted model, with nothing before it."""
    roles = ["estimation"] + (["validation"] if judged.stage.validation else [])
    units = {o.name: o.unit for o in judged.stage.model.outputs}
    table = {
        role: {
            kind: {
                name: {
                    "before": None,
                    "after": e.rms,
                    "unit": units[name],
                    "low": None,
                    "high": None,
                    "spread": e.spread,
                }
                for name, e in rows.items()
            }
            for kind, rows in judged.errors(role).items()
        }
        for role in roles
    }
    calibrated = calibration_part(judged, roles)
    return {
        "horizon": judged.horizon,
        "before_after": table,
        "calibration": calibrated,
        **traces(judged, judged, roles, False),
        **_residuals(judged.stage),
    }


def _residuals(stage: Stage) -> Json:
    parts = [residual_part(stage.model, v.record, v.run.standardised) for v in stage.estimation]
    residuals, cross = ([row for part in parts for row in part[k]] for k in (0, 1))
    return {"residuals": residuals, "cross": cross}


def before_after(before: Judged, after: Judged, role: str) -> Json:
    """Root mean square errors by kind and channel, with the interval of their ratio."""
    units = {o.name: o.unit for o in after.stage.model.outputs}
    old_errors, new_errors = before.errors(role), after.errors(role)
    table: Json = {}
    for kind in KINDS:
        table[kind] = {}
        # errors over a horizon hang together for as long as it lasts
        block = max(BLOCK, after.horizon) if kind == "ten_seconds" else BLOCK
        for name, old in old_errors[kind].items():
            new = new_errors[kind][name]
            low, high = ratio_interval(old, new, block=block)
            table[kind][name] = {
                "before": old.rms,
                "after": new.rms,
                "unit": units[name],
                "low": low,
                "high": high,
                "spread": old.spread,
            }
    return table


def traces(before: Judged, after: Judged, roles: Sequence[str], changed: bool) -> Json:
    """``traces``, ``track`` and ``inputs`` of every record; ``changed``: before is another model than after."""
    rows, tracks, inputs = [], [], []
    for role in roles:
        for view, old, new in zip(after.views(role), before.free[role], after.free[role], strict=True):
            model, record = after.stage.model, view.record
            inputs += input_traces(model, record)
            for j, o in enumerate(model.outputs):
                seen = np.isfinite(record.y[:, j])
                if seen.any():
                    rows.append(
                        {
                            "record": record.name,
                            "role": role,
                            "channel": o.name,
                            "unit": o.unit,
                            "angle": o.angle,
                            "t": record.t[seen],
                            "measured": record.y[seen, j],
                            "model": new.y[seen, j],
                            "sd": new.sd[seen, j],
                            "before": old.y[seen, j] if changed else None,
                        }
                    )
            tracks += _track(model, view, role, old if changed else None, new)
    return {"traces": rows, "track": tracks, "inputs": inputs}


def _track(model: Model, view: View, role: str, old: FreeRun | None, new: FreeRun) -> list[Json]:
    names = [o.name for o in model.outputs]
    if "x" not in names or not np.isfinite(view.record.y[:, names.index("x")]).any():
        return []
    i, j = names.index("x"), names.index("y")
    seen = np.isfinite(view.record.y[:, i])
    return [
        {
            "record": view.record.name,
            "role": role,
            "x_measured": view.record.y[seen, i],
            "y_measured": view.record.y[seen, j],
            "x_model": new.y[seen, i],
            "y_model": new.y[seen, j],
            "x_before": old.y[seen, i] if old else None,
            "y_before": old.y[seen, j] if old else None,
        }
    ]
