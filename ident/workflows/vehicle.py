"""What the ident commands do: logs in; model.toml, result.json and report.html out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from ident.characterisation import load_curve
from ident.checks import check_sides, swap_sides
from ident.data import load_all
from ident.estimation import (
    EstimationOptions,
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
from ident.reporter import Reporter
from ident.results import VehicleResult, provenance, vehicle_result
from ident.validation import evaluate
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


def vehicle(request: VehicleRequest, command: str, reporter: Reporter) -> VehicleResult:
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
    evaluation = evaluate(stage, request.estimation.horizon)
    records = [v.record for v in stage.estimation]
    curves = [profile(stage.fit, records, n) for n in request.profiles]
    tests = [homogeneity_test(stage.fit, records, n) for n in request.homogeneity]
    made = provenance([*loaded, *unseen], command)
    first = [*notes, *outliers(stage)]
    result = vehicle_result(stage, evaluation, made, curves, tests, start=model.values, notes=first)
    if sides is not None and sides.swapped:
        line = sides.line if not as_is else sides.line.removesuffix(" Fitted with the sides swapped.")
        reporter.warning(line)
        result = msgspec.structs.replace(result, answer=f"{line} {result.answer}")
    write_all(request.out, result, stage.fit, validity(stage))
    return result
