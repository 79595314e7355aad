"""What the ident commands do: logs in; model.toml, result.json and report.html out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ident.characterisation import load_curve
from ident.checks import check_sides, swap_sides
from ident.data import load_all
from ident.estimation import (
    EstimationOptions,
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
from ident.models import residuals_of
from ident.reporter import Reporter
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
from ident.workflows.output import validity, write_all


@dataclass(frozen=True)
class VehicleRequest:
    """A vehicle model to be fitted, as the options of the command say it.

    Attributes:
        logs, validation: logs that the fit sees, and others that judge it.
        out: folder for the results.
        estimation: how parameters are estimated.
        model: name of the structure, or ``auto`` for the horizontal one with the inputs that the logs have.
        thruster: model.toml of the bench, or a static curve from command to thrust.
        fixed, initial: values of parameters that are known, and where the estimate of others starts.
        priors: mean and standard deviation of parameters.
        effects: of the catalogue, added with their parameters free.
        keep_thruster_sides: even where the data say that they are swapped.
        homogeneity: parameters to test for one value in all logs.
        profiles: parameters that get a profile likelihood.
        rate: rows a second to which faster sensors are averaged [Hz].
    """

    logs: Sequence[Path]
    validation: Sequence[Path]
    out: Path
    estimation: EstimationOptions = field(default_factory=lambda: EstimationOptions(reml=True, mean_order=2))
    model: str = "auto"
    thruster: Path | None = None
    fixed: Mapping[str, float] = field(default_factory=dict)
    initial: Mapping[str, float] = field(default_factory=dict)
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    effects: Sequence[str] = ()
    keep_thruster_sides: bool = False
    homogeneity: Sequence[str] = ()
    profiles: Sequence[str] = ()
    rate: float = 10.0


def vehicle(request: VehicleRequest, command: str, reporter: Reporter) -> Json:
    """Fit a vehicle model and judge it on the validation logs; ``command``: what was typed."""
    curve, source = load_curve(request.thruster) if request.thruster is not None else None, request.model
    if curve is not None and source == "auto":
        source = "horizontal:force"
    loaded, unseen = (
        [completed(x, source, curve) for x in part] for part in load_all(request.logs, request.validation)
    )
    check_ahead(request.estimation.horizon, loaded, unseen)
    model, notes = apply_rig_geometry(choose_model(source, [*loaded, *unseen]), loaded[0].rig)
    for note in notes:
        reporter.warning(note)
    model = set_initial_values(set_priors(with_effects(model, request.effects), request.priors), request.initial)
    model = fix_parameters(model, request.thruster if curve is None else None, request.fixed)
    sides = check_sides([(x.run.name, x.run.channels) for x in loaded]) if "y_left" in model.values else None
    as_is = request.keep_thruster_sides
    model = swap_sides(model) if sides is not None and sides.swapped and not as_is else model
    check_names(nominal(model), request.profiles, len(loaded))
    runs, others = [x.run for x in loaded], [x.run for x in unseen]
    stage = fit_nominal_model(model, runs, others, request.estimation, rate=request.rate, reporter=reporter)
    result = envelope([*loaded, *unseen], command)
    result |= evaluation_section(PredictionEvaluation(stage, request.estimation.horizon))
    result |= {"kind": "vehicle", "fit": fit_part(stage.fit, model.values)}
    result["cautions"] = estimation_warnings(stage.fit, [v.record for v in stage.estimation])
    result["notes"] = notes + outliers(stage) + calibration_notes(result["calibration"], result["horizon"])
    said = [vehicle_answer(result, searchable=bool(residuals_of(model)))]
    if sides is not None and sides.swapped:
        said.insert(0, sides.line if not as_is else sides.line.removesuffix(" Fitted with the sides swapped."))
        reporter.warning(said[0])
    more, sentences = _asked(stage, request.profiles, request.homogeneity)
    result |= more | {"answer": " ".join(said + sentences)}
    write_all(request.out, result, stage.fit, validity(stage))
    return result


def _asked(stage: FittedModel, profiles: Sequence[str], homogeneity: Sequence[str]) -> tuple[Json, list[str]]:
    """Profile likelihoods and tests of agreement: their parts of the result, and sentences for the answer."""
    records = [v.record for v in stage.estimation]
    part: Json = {"profiles": [profile_part(profile(stage.fit, records, n)) for n in profiles]} if profiles else {}
    found = [homogeneity_test(stage.fit, records, name) for name in homogeneity]
    if found:
        part["agreement"] = [agreement_part(a) for a in found]
    return part, [sentence(a) for a in found]
