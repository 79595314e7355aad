"""What the ident commands do: logs in; model.toml, result.json and report.html out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from ident.characterisation import load_curve
from ident.checks import check_sides, swap_sides
from ident.data import load_all
from ident.estimation import (
    FittedModel,
    apply_rig_geometry,
    fit_nominal_model,
    fix_parameters,
    homogeneity_test,
    nominal,
    outliers,
    profile,
    set_initial_values,
    set_priors,
    with_effects,
)
from ident.results import (
    Json,
    agreement_part,
    calibration_notes,
    envelope,
    estimation_warnings,
    evaluation_section,
    fit_part,
    profile_part,
    sentence,
    vehicle_answer,
)
from ident.validation import PredictionEvaluation
from ident.workflows.model_inputs import check_ahead, check_names, choose_model, completed
from ident.workflows.output import Say, validity, write_all


def vehicle(
    logs: Sequence[Path],
    validate: Sequence[Path],
    out: Path,
    *,
    source: str,
    thruster: Path | None,
    fix: Mapping[str, float],
    begin: Mapping[str, float],
    prior: Mapping[str, tuple[float, float]] | None = None,
    as_is: bool,
    agree: Sequence[str] = (),
    profiles: Sequence[str] = (),
    robust: bool = False,
    restricted: bool = True,
    second_order: bool = True,
    effects: Sequence[str] = (),
    horizon: float | None = None,
    rate: float,
    command: str,
    say: Say,
) -> Json:
    """Fit a vehicle model and judge it on the validation logs. ``prior``: mean and standard deviation of parameters;
    ``agree``: parameters to test for one value in all; ``profiles``: parameters that get a profile likelihood;
    ``robust``: allow outliers; ``restricted``: noise by restricted likelihood; ``second_order``: the
    filter's mean goes with the curvature of the rates; ``effects``: added by name, their parameters free;
    ``horizon``: s ahead that predictions are judged, ten by default."""
    curve = load_curve(thruster) if thruster is not None else None
    if curve is not None:
        thruster, source = None, "horizontal:force" if source == "auto" else source
    loaded, unseen = ([completed(x, source, curve) for x in part] for part in load_all(logs, validate))
    check_ahead(horizon, loaded, unseen)
    model, notes = apply_rig_geometry(choose_model(source, [*loaded, *unseen]), loaded[0].rig)
    for note in notes:
        say(note)
    model = set_initial_values(set_priors(with_effects(model, effects), prior or {}), begin)
    model = fix_parameters(model, thruster, fix)
    model = replace(model, second_order=second_order)
    sides = check_sides([(x.run.name, x.run.channels) for x in loaded]) if "y_left" in model.values else None
    model = swap_sides(model) if sides is not None and sides.swapped and not as_is else model
    check_names(nominal(model), profiles)
    runs, others = [x.run for x in loaded], [x.run for x in unseen]
    stage = fit_nominal_model(model, runs, others, rate=rate, robust=robust, restricted=restricted, progress=say)
    result = envelope([*loaded, *unseen], command) | evaluation_section(PredictionEvaluation(stage, horizon))
    result |= {"kind": "vehicle", "fit": fit_part(stage.fit, model.values)}
    result["cautions"] = estimation_warnings(stage.fit, [v.record for v in stage.estimation])
    result["notes"] = notes + outliers(stage) + calibration_notes(result["calibration"], result["horizon"])
    said = [vehicle_answer(result, searchable="hull" in model.provides)]
    if sides is not None and sides.swapped:
        said.insert(0, sides.line if not as_is else sides.line.removesuffix(" Fitted with the sides swapped."))
        say(said[0])
    more, sentences = _asked(stage, profiles, agree)
    result |= more | {"answer": " ".join(said + sentences)}
    write_all(out, result, stage.fit, validity(stage))
    return result


def _asked(stage: FittedModel, profiles: Sequence[str], agree: Sequence[str]) -> tuple[Json, list[str]]:
    """Profile likelihoods and tests of agreement: their parts of the result, and sentences for the answer."""
    records = [v.record for v in stage.estimation]
    part: Json = {"profiles": [profile_part(profile(stage.fit, records, n)) for n in profiles]} if profiles else {}
    found = [homogeneity_test(stage.fit, records, name) for name in agree]
    if found:
        part["agreement"] = [agreement_part(a) for a in found]
    return part, [sentence(a) for a in found]
