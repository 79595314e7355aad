"""A diagnosis as the content of result.json: the answer in a sentence, and the evidence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import stats

from ident.diagnosis import ALPHA, Diagnosis, Refit, Round, Score, recommended_experiment
from ident.estimation import FittedModel, RecordEvaluation
from ident.models import residuals_of
from ident.results.content import (
    Json,
    calibration_notes,
    calibration_part,
    comparison_section,
    fit_part,
    format_number,
    merge_before_after,
    parameter_row,
    residual_part,
    traces,
)
from ident.validation import PredictionEvaluation

HARDLY = 1e-6  # p value of a score test that a data set with nothing missing may well bring forth
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


def diagnosis_result(diagnosis: Diagnosis, horizon: float | None = None) -> Json:
    """All keys of result.json but those of how it was made (logs, command); ``horizon``: s, of
    ``ident.validation.evaluation``."""
    before, after = PredictionEvaluation(diagnosis.before, horizon), PredictionEvaluation(diagnosis.after, horizon)
    roles = ["estimation"] + (["validation"] if diagnosis.after.validation else [])
    table = {role: comparison_section(before, after, role) for role in roles}
    judged = table[roles[-1]]
    start = diagnosis.before.model.values
    calibrated = calibration_part(after, roles)
    return {
        "kind": "diagnosis",
        "answer": answer(diagnosis, judged, roles[-1]),
        "doubt": doubt(diagnosis),
        "fit": fit_part(diagnosis.after.fit, start),
        **traces(before, after, roles, bool(diagnosis.effects)),
        **_residuals(diagnosis),
        "rounds": [_round(r, diagnosis) for r in diagnosis.rounds] or [_quiet_round(diagnosis)],
        "effects": _effects(diagnosis),
        "left": [{"name": s.name, "lm": s.lm, "df": s.df, "p": s.p} for s in diagnosis.left],
        "shapes": [
            {
                "force": s.force,
                "reading": s.reading,
                "variable": s.variable,
                "unit": s.unit,
                "variable_unit": s.variable_unit,
                "grid": s.grid,
                "value": s.value,
                "sd": s.sd,
                "band": s.band,
            }
            for s in diagnosis.shapes
        ],
        "horizon": after.horizon,
        "before_after": table,
        "calibration": calibrated,
        "parameters_before_after": _moved(diagnosis),
        "next_experiment": recommended_experiment(diagnosis),
        "notes": _notes(diagnosis) + calibration_notes(calibrated, after.horizon),
    }


def answer(diagnosis: Diagnosis, judged: dict[str, Any], role: str) -> str:
    """What is missing, and what it changes, in one sentence."""
    if not diagnosis.effects:
        if diagnosis.rounds and min(s.p for s in diagnosis.rounds[-1].scores) > HARDLY:
            one = diagnosis.rounds[-1]
            return f"Nothing is missing that these data can show: {_passed(one)} passed the first test, but {one.why}."
        if diagnosis.rounds:
            return (
                "The residuals are not what the model predicts, but no candidate explains them: "
                + diagnosis.rounds[-1].why
                + "."
            )
        return "Nothing is missing: no effect in the catalogue, and no unknown one, is seen in these data."
    lacks = what_is_lacking(diagnosis)
    best = most_improved(judged["free_run"])
    if best is None:
        return f"{lacks}."
    row = judged["free_run"][best]
    degrees = row["unit"].startswith("rad")
    scale = 180 / np.pi if degrees else 1.0
    unit = row["unit"].replace("rad", "deg")
    return (
        f"{lacks}; with it the free-running error on {role} data falls from "
        f"{format_number(row['before'] * scale)} to {format_number(row['after'] * scale)}{unit and ' '}{unit} "
        f"({NAMES.get(best, best)})."
    )


def _passed(one: Round) -> str:
    """Which candidates passed the score tests, in few words."""
    titles = {r.effect.name: r.effect.title for r in one.refits}
    names = [titles.get(name, name) for name in one.passed]
    return names[0] if len(names) == 1 else f"{len(names)} candidates"


def what_is_lacking(diagnosis: Diagnosis) -> str:
    """The beginning of the answer: names that are sure, then likenesses, then what has no name, unless that leads."""
    titles: dict[str, list[str]] = {"named": [], "resembles": [], "unknown": []}
    for r, judged in zip(diagnosis.effects, diagnosis.judgements, strict=True):
        titles[judged.certainty].append(r.effect.title)
    sure, alike, unknown = titles.values()
    if unknown and diagnosis.judgements[0].certainty == "unknown":
        found = f"The model lacks {_listed(unknown)}"
        rest = [*sure, *(f"something that resembles {title}" for title in alike)]
        return f"{found}, and beside it {_listed(rest)}" if rest else found
    if sure and alike:
        found = f"The model lacks {_listed(sure)}, and something that resembles {_listed(alike)}"
    elif sure:
        found = f"The model lacks {_listed(sure)}"
    else:
        found = f"What the model lacks resembles {_listed(alike)}"
    return f"{found}, and beside it {_listed(unknown)}" if unknown else found


def doubt(diagnosis: Diagnosis) -> str | None:
    """Why a name is not sure, in a sentence; None where all are."""
    reasons = [reason for j in diagnosis.judgements if j.certainty == "resembles" for reason in j.reasons]
    return f"The name is not sure: {reasons[0]}." if reasons else None


def _listed(titles: Sequence[str]) -> str:
    return titles[0] if len(titles) == 1 else ", ".join(titles[:-1]) + " and " + titles[-1]


def most_improved(rows: dict[str, Any]) -> str | None:
    ratios = {n: r["after"] / r["before"] for n, r in rows.items() if r["before"] and n not in ("ax", "ay")}
    return min(ratios, key=lambda n: ratios[n]) if ratios else None


def _residuals(diagnosis: Diagnosis) -> Json:
    residuals: list[Json] = []
    cross: list[Json] = []
    forces: list[Json] = []
    for old, new in zip(diagnosis.before.estimation, diagnosis.after.estimation, strict=True):
        r0, c0 = residual_part(diagnosis.before.model, old.record, old.run.standardised)
        if diagnosis.effects:
            r1, c1 = residual_part(diagnosis.after.model, new.record, new.run.standardised)
            kept = ("e", "acf", "ljung_box_p", "periodogram_p", "cumulative", "normal_p", "white")
            r0 = merge_before_after(r0, r1, ("record", "channel"), kept)
            c0 = merge_before_after(c0, c1, ("record", "channel", "input"), ("z", "p"))
        residuals, cross = residuals + r0, cross + c0
        forces += _forces(diagnosis, old, new)
    return {"residuals": residuals, "cross": cross, "residual_forces": forces}


def _forces(diagnosis: Diagnosis, old: RecordEvaluation, new: RecordEvaluation) -> list[Json]:
    rows = []
    for residual in residuals_of(diagnosis.before.model):
        i = [s.name for s in diagnosis.before.model.states].index(residual.state)
        k = [s.name for s in diagnosis.after.model.states].index(residual.state)
        changed = bool(diagnosis.effects)
        rows.append(
            {
                "record": old.record.name,
                "force": residual.name,
                "unit": residual.unit,
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


def _own(r: Refit, stage: FittedModel) -> list[Json]:
    return [parameter_row(p, *stage.fit.estimate(p.name)) for p in r.effect.parameters]


def _effects(diagnosis: Diagnosis) -> list[Json]:
    """Each effect with its estimate in the final model and its weight, the weightiest first."""
    rows = []
    rounds = {one.chosen.effect.name: one for one in diagnosis.rounds if one.chosen is not None}
    for r, judged, weight in zip(diagnosis.effects, diagnosis.judgements, diagnosis.weights, strict=True):
        behind = [
            {"name": q.effect.name, "title": q.effect.title, "criterion_behind": r.criterion - q.criterion}
            for q in rounds[r.effect.name].refits
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
                "certainty": judged.certainty,
                "reasons": list(judged.reasons),
                "not_excluded": list(judged.rivals),
                "parameters": _own(r, diagnosis.after),
                "weight": weight.error,
                "gain_last": weight.gain,
            }
        )
    return rows


def _moved(diagnosis: Diagnosis) -> list[Json]:
    before, after = diagnosis.before.fit, diagnosis.after.fit
    rows = []
    for p in before.model.parameters:
        if p.free and not p.per_record:
            (a, sa), (b, sb) = before.estimate(p.name), after.estimate(p.name)
            rows.append({"name": p.name, "unit": p.unit, "before": a, "before_se": sa, "after": b, "after_se": sb})
    return rows


def _notes(diagnosis: Diagnosis) -> list[str]:
    notes = []
    if diagnosis.left:
        names = ", ".join(s.name for s in diagnosis.left[:4])
        notes.append(f"After the last effect these tests still pass: {names}. Something smaller remains.")
    if diagnosis.effects and diagnosis.rounds[-1].chosen is None:
        why = diagnosis.rounds[-1].why
        notes.append(f"{why[0].upper()}{why[1:]}.")
    if not diagnosis.after.validation:
        notes.append("No validation data were given: nothing here was tested on data that the fit has not seen.")
    notes += [f"{name}: {what}" for name, what in diagnosis.after.fit.flags]
    return notes
