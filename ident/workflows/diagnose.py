"""Workflow of `seatrial ident diagnose`: search for the effects that a model lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from seatrial.daq.errors import SeatrialError, closest_name
from seatrial.ident.checks import device_faults
from seatrial.ident.data import WHOLE, TimeWindows, load_all
from seatrial.ident.diagnosis import (
    Diagnosis,
    diagnose,
    evaluate_diagnosis,
    rows_of_search,
    with_excluded,
    with_times,
    with_weighed_mass,
)
from seatrial.ident.effects import catalogue
from seatrial.ident.engine import common_kernels
from seatrial.ident.estimation import (
    EstimationOptions,
    RefittedEffect,
    fix_parameters,
    load_model,
    with_effect_priors,
)
from seatrial.ident.model import Effect, EffectKind, Model, ModelKind
from seatrial.ident.model import with_outlier_model as with_outliers
from seatrial.ident.models import effects_for, with_thrust_of
from seatrial.ident.reporter import Reporter
from seatrial.ident.results import (
    DiagnosisResult,
    GivenModel,
    diagnosis_result,
    estimation_warnings,
    provenance,
)
from seatrial.ident.workflows.check import check_first, require_thrust_and_length, with_noise_floors
from seatrial.ident.workflows.dynamics import dynamics_of
from seatrial.ident.workflows.model_inputs import (
    check_horizon,
    hold_lines,
    in_one_frame,
    model_of_logs,
    unused_lines,
    unused_signals,
)
from seatrial.ident.workflows.output import sensor_rates, validity, write_model, write_page
from seatrial.ident.workflows.vehicle_model import considered_notes


@dataclass(frozen=True)
class DiagnosisRequest:
    """Options of `seatrial ident diagnose`.

    Attributes
    ----------
    model
        The model.toml to diagnose.
    logs, validation
        Logs for the search, and other logs on which each found effect is validated.
    out
        Folder for the results.
    estimation
        Options of the estimator, of which only the outlier model and the horizon are used. The search compares maxima
        of the plain likelihood of a first-order filter.
    max_effects
        Largest number of effects to add.
    exclude
        Names of effects of the catalogue, or of ``effects_file``, that the search leaves out.
    effects_file
        Python file of user-defined effects, which the search tests too; None: no such effects.
    thruster
        For a vehicle model: file of the static thrust curve that it was fitted with. For a thruster model: name of the
        thruster, if the logs have several. None: no curve, and the only thruster.
    thrust_of
        Side with the given thrust, ``left`` or ``right``, if the thrusts of both sides differ; ``both``: the given
        thrust is their mean; ``unknown``. None: what the model says.
    rate
        Rate of the rows [Hz] over which faster sensors are averaged. None: 5 Hz for a slow vehicle without
        accelerometers (`rows_of_search`), 10 Hz for others, 50 Hz for a thruster model.
    despite_faults
        Whether to search even if the checks find faults that make a fit meaningless.
    window
        Interval of time of ``logs`` to use: one for all, or one for each; validation logs are used as a whole.
    mass
        Weighed mass of the boat without water around it [kg], with which the estimated mass in surge is compared. It is
        no prior. None: that of the rig file or import map, if they have one.
    fixed
        Values of parameters of the model that are held in all fits of the diagnosis, by name, in SI units and radians.
    """

    model: Path
    logs: Sequence[Path]
    validation: Sequence[Path]
    out: Path
    estimation: EstimationOptions = field(default_factory=EstimationOptions)
    max_effects: int = 3
    exclude: Sequence[str] = ()
    effects_file: Path | None = None
    thruster: str | None = None
    thrust_of: str | None = None
    rate: float | None = None
    despite_faults: bool = False
    window: TimeWindows = WHOLE
    mass: float | None = None
    fixed: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class DiagnosedModel:
    """Diagnosis of a model on logs, and its result.

    Attributes
    ----------
    found
        Findings, with the model before and after the missing effects were added.
    result
        Content of result.json.
    effects_file
        Python file of user-defined effects, from the request or else from the model.toml; None if neither names one.
    """

    found: Diagnosis
    result: DiagnosisResult
    effects_file: Path | None


def diagnosis(request: DiagnosisRequest, command: str, reporter: Reporter) -> DiagnosisResult:
    """Find the effects that a model lacks (`diagnose_model`), and write the results.

    The files are model.toml with the found effects, result.json and report.html in the folder ``request.out``.

    Parameters
    ----------
    request : DiagnosisRequest
        Model, logs, options and folder.
    command : str
        Command line, for the provenance.
    reporter : Reporter
        Receives progress and warnings.

    Returns
    -------
    DiagnosisResult
        Content of result.json.

    Raises
    ------
    SeatrialError
        As `diagnose_model`, or if a file cannot be written.
    """
    done = diagnose_model(request, command, reporter)
    reporter.progress("writing the report")
    write_diagnosed_model(done, request.out)
    return done.result


def write_diagnosed_model(done: DiagnosedModel, out: Path, report: bool = True) -> None:
    """Write model.toml with the found effects, result.json and, if ``report``, report.html to the folder ``out``.

    The folder is created if it does not exist. Existing files of these names are replaced.
    """
    after = done.found.after
    refits, rates = refitted_effects(done.found), sensor_rates(after)
    write_model(out, done.result, after.fit, validity(after), done.effects_file, rates=rates, refits=refits)
    if report:
        write_page(out, done.result)


def refitted_effects(found: Diagnosis) -> tuple[RefittedEffect, ...]:
    """Return the effects of the catalogue that a diagnosis tried, with their estimates, in the order of the rounds.

    `seatrial mission design --discriminate` takes the sizes of competing effects from them. Nonparametric candidates
    and differences between runs are left out.
    """
    tried = []
    for refit in (r for search_round in found.rounds for r in search_round.refits):
        if refit.effect.kind is not EffectKind.CATALOGUE:
            continue
        fit, name = refit.fitted.fit, refit.effect.name
        beside = (e.name for e in fit.model.effects if e.kind is EffectKind.CATALOGUE and e.name != name)
        names = [p.name for p in refit.effect.parameters]
        errors = {n: fit.estimate(n)[1] for n in names}
        known = {n: error for n, error in errors.items() if np.isfinite(error)}
        tried.append(RefittedEffect(name, tuple(beside), {n: fit.model.values[n] for n in names}, known))
    return tuple(tried)


@common_kernels()  # the kernels of the search also serve the evaluation of the model that it finds
def diagnose_model(request: DiagnosisRequest, command: str, reporter: Reporter) -> DiagnosedModel:
    """Find the effects that a model lacks. No file is written.

    Parameters
    ----------
    request : DiagnosisRequest
        Model, logs and options. Its folder is not used.
    command : str
        Command line, for the provenance.
    reporter : Reporter
        Receives progress and warnings.

    Returns
    -------
    DiagnosedModel
        The findings, and the content of result.json.

    Raises
    ------
    SeatrialError
        If model or logs cannot be used, if no validation log (without any: no log) is longer than a given horizon, if
        there is no effect of an excluded name or the model contains it, if a parameter cannot be held at its given
        value, or if the logs have faults that make a fit meaningless (unless ``despite_faults``).
    """
    loaded, validation_logs = load_all(request.logs, request.validation, request.window, device_faults)
    horizon, effects_file = request.estimation.horizon, request.effects_file
    saved = load_model(request.model)
    # The search compares maxima of the plain likelihood of a first-order filter. REML and a second-order filter do not
    # change what is found, and the blind tests were made without them.
    plain = replace(saved.model, second_order=False)
    if request.thrust_of is not None:
        plain = with_thrust_of(plain, request.thrust_of)
    check_horizon(horizon, loaded, validation_logs)
    loaded, validation_logs = in_one_frame(plain, loaded, validation_logs, saved.origin)
    model, runs, validation_runs, usual_rate = model_of_logs(
        plain, request.model, loaded, validation_logs, request.thruster
    )
    unused = unused_signals(model, loaded, validation_logs)
    lines = [
        *(unused_lines(unused) if model.kind is ModelKind.VEHICLE else []),
        *hold_lines(saved, [*loaded, *validation_logs]),
    ]
    if request.rate is None:
        model, usual_rate = rows_of_search(model, saved.validity, usual_rate)
    # model.toml has no priors of effects that it does not contain
    model = with_effect_priors(model, loaded[0].vehicle, loaded[0].rig)
    model, fixed_notes = fix_parameters(model, None, request.fixed, diagnosed=True)
    loaded, validation_logs = check_first(loaded, validation_logs, model, request.despite_faults)
    if model.kind is ModelKind.VEHICLE:
        require_thrust_and_length(runs, model, request.despite_faults)
    for line in lines:
        reporter.warning(line)
    model, floors = with_noise_floors(model, loaded)
    candidates = {**catalogue(), **(effects_for(model, effects_file) if effects_file else {})}
    excluded = excluded_effects(request.exclude, candidates, model)
    hull = loaded[0].hull(request.mass)
    progress = with_times(reporter)
    found = diagnose(
        with_outliers(model) if request.estimation.outlier_model else model,
        runs,
        validation_runs,
        effects={n: e for n, e in candidates.items() if n not in excluded},
        rate=request.rate or usual_rate,
        max_effects=request.max_effects,
        reporter=progress,
    )
    progress.progress("validation: predicting the runs without and with the effects found")
    with progress.work.timed("evaluation"):
        evaluation = evaluate_diagnosis(found, horizon)
    progress.progress("computing the result")
    found = with_weighed_mass(with_excluded(found, tuple(excluded.values())), hull.get("mass"))
    result = diagnosis_result(
        found,
        evaluation,
        provenance([*loaded, *validation_logs], command),
        warnings=estimation_warnings(found.after.fit, found.after.records, hull),
        notes=[
            *fixed_notes,
            *floors,
            *considered_notes(found.after.fit.model),
            *found.after.outlier_notes,
        ],
        unused=unused,
        dynamics=dynamics_of(found.after),
        given=GivenModel(str(request.out / "model.toml"), saved.converged, hull.get("mass")),
    )
    return DiagnosedModel(found, result, effects_file or saved.effects_file)


def excluded_effects(names: Sequence[str], candidates: Mapping[str, Effect], model: Model) -> dict[str, Effect]:
    """Return the candidates that a search leaves out, by name, each once.

    Parameters
    ----------
    names
        Names of `--exclude`.
    candidates
        All candidates by name.
    model
        The model to diagnose.

    Raises
    ------
    SeatrialError
        If there is no candidate of a name, or if the model contains the effect.
    """
    contained = {e.name for e in model.effects}
    for name in names:
        if name in contained:
            raise SeatrialError(
                f"--exclude {name}: the model to diagnose contains this effect, and a diagnosis removes none; fit a "
                "model without it, and diagnose that"
            )
        if "(" in name:
            raise SeatrialError(
                f"--exclude {name}: this is a curve that is fitted without a formula, and curves cannot be left out; "
                "only effects of the catalogue can"
            )
        if name not in candidates:
            near = closest_name(str(name), candidates)
            hint = f"did you mean {near!r}?" if near else f"the effects are {', '.join(candidates)}"
            raise SeatrialError(f"--exclude {name}: there is no effect of this name; {hint}")
    return {name: candidates[name] for name in names}
