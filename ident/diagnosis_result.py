"""A diagnosis as the content of result.json: the answer in a sentence, and the evidence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import stats

from ident.diagnose import ALPHA, Diagnosis, Refit, Round
from ident.model import Model
from ident.outcome import FORCE_UNITS, Json, fit_part, input_traces, join_after, parameter_row, residual_part
from ident.pe import Likelihood
from ident.predict import Errors, FreeRun, free_run, one_step, pooled, ratio_interval, ten_seconds
from ident.score import Score
from ident.stage import Stage, View

KINDS = ("one_step", "ten_seconds", "free_run")
NAMES = {
    "x": "north",
    "y": "east",
    "psi": "heading",
    "r": "yaw rate",
    "u": "surge speed",
    "v": "sway speed",
    "vx": "velocity north",
    "vy": "velocity east",
    "ax": "surge acceleration",
    "ay": "sway acceleration",
}


class Judged:
    """Prediction errors of a stage on every record, computed once."""

    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        likelihood = Likelihood(stage.model)
        self.free = {
            role: [free_run(stage.model, v.record, v.values, likelihood) for v in views]
            for role, views in (("estimation", stage.estimation), ("validation", stage.validation))
        }

    def views(self, role: str) -> Sequence[View]:
        return self.stage.estimation if role == "estimation" else self.stage.validation

    def errors(self, role: str) -> dict[str, dict[str, Errors]]:
        model, views = self.stage.model, self.views(role)
        return {
            "one_step": pooled([one_step(model, v.record, v.run) for v in views]),
            "ten_seconds": pooled([ten_seconds(model, v.record, v.values, v.run) for v in views]),
            "free_run": pooled([f.errors for f in self.free[role]]),
        }


def diagnosis_result(diagnosis: Diagnosis) -> Json:
    """All keys of result.json but those of how it was made (logs, command)."""
    before, after = Judged(diagnosis.before), Judged(diagnosis.after)
    roles = ["estimation"] + (["validation"] if diagnosis.after.validation else [])
    table = {role: _before_after(before.errors(role), after.errors(role), diagnosis.after.model) for role in roles}
    judged = table[roles[-1]]
    start = diagnosis.before.model.values
    return {
        "kind": "diagnosis",
        "answer": answer(diagnosis, judged, roles[-1]),
        "fit": fit_part(diagnosis.after.fit, start),
        **_traces(before, after, roles, bool(diagnosis.effects)),
        **_residuals(diagnosis),
        "rounds": [_round(r, diagnosis) for r in diagnosis.rounds] or [_quiet_round(diagnosis)],
        "effects": _effects(diagnosis, before, roles[-1]),
        "shapes": [
            {
                "force": s.force,
                "variable": s.variable,
                "unit": s.unit,
                "variable_unit": s.variable_unit,
                "grid": s.grid,
                "value": s.value,
                "sd": s.sd,
            }
            for s in diagnosis.shapes
        ],
        "before_after": table,
        "parameters_before_after": _moved(diagnosis),
        "next_experiment": next_experiment(diagnosis),
        "notes": _notes(diagnosis),
    }


def judged_alone(judged: Judged) -> Json:
    """Traces and errors of one fitted model, with nothing before it."""
    roles = ["estimation"] + (["validation"] if judged.stage.validation else [])
    units = {o.name: o.unit for o in judged.stage.model.outputs}
    table = {
        role: {
            kind: {
                name: {"before": None, "after": e.rms, "unit": units[name], "low": None, "high": None}
                for name, e in rows.items()
            }
            for kind, rows in judged.errors(role).items()
        }
        for role in roles
    }
    return {"before_after": table, **_traces(judged, judged, roles, False)}


def answer(diagnosis: Diagnosis, judged: dict[str, Any], role: str) -> str:
    """What is missing, and what it changes, in one sentence."""
    if not diagnosis.effects:
        if diagnosis.rounds:
            return (
                "The residuals are not what the model predicts, but no candidate explains them: "
                + diagnosis.rounds[-1].why
                + "."
            )
        return "Nothing is missing: no effect in the catalogue, and no unknown one, is seen in these data."
    titles = [r.effect.title for r in diagnosis.effects]
    lacks = titles[0] if len(titles) == 1 else ", ".join(titles[:-1]) + " and " + titles[-1]
    best = most_improved(judged["free_run"])
    if best is None:
        return f"The model lacks {lacks}."
    row = judged["free_run"][best]
    degrees = row["unit"].startswith("rad")
    scale = 180 / np.pi if degrees else 1.0
    unit = row["unit"].replace("rad", "deg")
    return (
        f"The model lacks {lacks}; with it the free-running error on {role} data falls from "
        f"{row['before'] * scale:.2g} to {row['after'] * scale:.2g} {unit} ({NAMES.get(best, best)})."
    )


def most_improved(rows: dict[str, Any]) -> str | None:
    ratios = {n: r["after"] / r["before"] for n, r in rows.items() if r["before"] and n not in ("ax", "ay")}
    return min(ratios, key=lambda n: ratios[n]) if ratios else None


def _before_after(before: dict[str, dict[str, Errors]], after: dict[str, dict[str, Errors]], model: Model) -> Json:
    units = {o.name: o.unit for o in model.outputs}
    table: Json = {}
    for kind in KINDS:
        table[kind] = {}
        for name, old in before[kind].items():
            new = after[kind][name]
            low, high = ratio_interval(old, new)
            table[kind][name] = {"before": old.rms, "after": new.rms, "unit": units[name], "low": low, "high": high}
    return table


def _traces(before: Judged, after: Judged, roles: Sequence[str], changed: bool) -> Json:
    traces, tracks, inputs = [], [], []
    for role in roles:
        for view, old, new in zip(after.views(role), before.free[role], after.free[role], strict=True):
            model, record = after.stage.model, view.record
            inputs += input_traces(model, record)
            for j, o in enumerate(model.outputs):
                seen = np.isfinite(record.y[:, j])
                if seen.any():
                    traces.append(
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
    return {"traces": traces, "track": tracks, "inputs": inputs}


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


def _residuals(diagnosis: Diagnosis) -> Json:
    residuals: list[Json] = []
    cross: list[Json] = []
    forces: list[Json] = []
    for old, new in zip(diagnosis.before.estimation, diagnosis.after.estimation, strict=True):
        r0, c0 = residual_part(diagnosis.before.model, old.record, old.run.standardised)
        if diagnosis.effects:
            r1, c1 = residual_part(diagnosis.after.model, new.record, new.run.standardised)
            kept = ("e", "acf", "ljung_box_p", "periodogram_p", "cumulative", "normal_p", "white")
            r0 = join_after(r0, r1, ("record", "channel"), kept)
            c0 = join_after(c0, c1, ("record", "channel", "input"), ("z", "p"))
        residuals, cross = residuals + r0, cross + c0
        forces += _forces(diagnosis, old, new)
    return {"residuals": residuals, "cross": cross, "residual_forces": forces}


def _forces(diagnosis: Diagnosis, old: View, new: View) -> list[Json]:
    rows = []
    for force, unit in FORCE_UNITS.items():
        i = [s.name for s in diagnosis.before.model.states].index(f"b_{force}")
        k = [s.name for s in diagnosis.after.model.states].index(f"b_{force}")
        changed = bool(diagnosis.effects)
        rows.append(
            {
                "record": old.record.name,
                "force": force,
                "unit": unit,
                "t": old.record.t,
                "mean": old.smoothed.x[:, i],
                "sd": old.smoothed.sd[:, i],
                "after_mean": new.smoothed.x[:, k] if changed else None,
                "after_sd": new.smoothed.sd[:, k] if changed else None,
            }
        )
    return rows


def _round(one: Round, diagnosis: Diagnosis) -> Json:
    titles = {r.effect.name: r.effect.title for r in one.refits}
    return {
        "candidates": [
            {
                "name": s.name,
                "title": titles.get(s.name, s.name),
                "lm": s.lm,
                "df": s.df,
                "p": s.p,
                "p_block": s.p_block,
                "generic": s.generic,
                "threshold": threshold(s, one.scores),
                "passed": s.name in one.passed,
            }
            for s in sorted(one.scores, key=lambda s: -s.lm / max(s.df, 1))[:24]
        ],
        "refits": [_refit(r) for r in one.refits],
        "chosen": one.chosen.effect.name if one.chosen else None,
        "why": one.why,
    }


def threshold(score: Score, among: Sequence[Score]) -> float:
    """What the score must exceed, with as many tests as there are of its kind."""
    return float(stats.chi2.isf(ALPHA / 2 / sum(s.generic == score.generic for s in among), score.df))


def _quiet_round(diagnosis: Diagnosis) -> Json:
    return {"candidates": [], "refits": [], "chosen": None, "why": "no candidate passes the score tests"}


def _refit(r: Refit) -> Json:
    return {
        "name": r.effect.name,
        "title": r.effect.title,
        "gain": r.gain,
        "df": r.df,
        "criterion": r.criterion,
        "validation_gain": r.validation_gain,
        "t": r.t,
        "parameters": _own(r, r.stage),
    }


def _own(r: Refit, stage: Stage) -> list[Json]:
    return [parameter_row(p, *stage.fit.estimate(p.name)) for p in r.effect.parameters]


def _effects(diagnosis: Diagnosis, before: Judged, role: str) -> list[Json]:
    """Each effect with its estimate in the final model, and the part of the free-run error that it removes."""
    rows, last = [], _free_size(before, role)
    first = last
    for one in diagnosis.rounds:
        if one.chosen is None:
            continue
        r = one.chosen
        now = _free_size(Judged(r.stage), role)
        behind = [
            {"name": q.effect.name, "title": q.effect.title, "criterion_behind": r.criterion - q.criterion}
            for q in one.refits
            if q is not r
        ]
        e = r.effect
        rows.append(
            {
                "name": e.name,
                "title": e.title,
                "formula": e.formula,
                "source": e.source,
                "place": e.place,
                "experiment": e.experiment,
                "rivals": behind,
                "parameters": _own(r, diagnosis.after),
                "share": float((last - now) / first),
            }
        )
        last = now
    return rows


def _free_size(judged: Judged, role: str) -> float:
    """One number for the free-run error: the mean over channels of the error over the channel's noise."""
    parts = pooled([f.errors for f in judged.free[role]])
    views = judged.views(role)
    noise = {o.name: float(views[0].run.R[j]) ** 0.5 for j, o in enumerate(judged.stage.model.outputs)}
    return float(np.mean([e.rms / noise[name] for name, e in parts.items()]))


def _moved(diagnosis: Diagnosis) -> list[Json]:
    before, after = diagnosis.before.fit, diagnosis.after.fit
    rows = []
    for p in before.model.parameters:
        if p.free and not p.per_record:
            (a, sa), (b, sb) = before.estimate(p.name), after.estimate(p.name)
            rows.append({"name": p.name, "unit": p.unit, "before": a, "before_se": sa, "after": b, "after_se": sb})
    return rows


def next_experiment(diagnosis: Diagnosis) -> str | None:
    """What would settle what is still open: for the closest rival of each effect, the experiment that shows it."""
    lines = []
    for one in diagnosis.rounds:
        if one.chosen is None:
            continue
        close = [q for q in one.refits if q is not one.chosen and q.criterion > one.chosen.criterion - 10]
        lines += [
            f"To tell {one.chosen.effect.title} from {q.effect.title}: {one.chosen.effect.experiment}." for q in close
        ]
    return " ".join(lines) or None


def _notes(diagnosis: Diagnosis) -> list[str]:
    notes = []
    if diagnosis.left:
        names = ", ".join(s.name for s in diagnosis.left[:4])
        notes.append(f"After the last effect these tests still pass: {names}. Something smaller remains.")
    if not diagnosis.after.validation:
        notes.append("No validation data were given: nothing here was tested on data that the fit has not seen.")
    notes += [f"{name}: {what}" for name, what in diagnosis.after.fit.flags]
    return notes
