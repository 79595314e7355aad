"""The vehicle model of a fit: structure, rig geometry, bench results, prior knowledge, noise floors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from seatrial.ident.characterisation import ThrustCurve, load_curve
from seatrial.ident.data import SHAFTS, WHOLE, LoadedLog, LogSegment, TimeWindow
from seatrial.ident.estimation import (
    EstimationOptions,
    apply_rig_geometry,
    fix_parameters,
    nominal,
    pose_scale,
    set_initial_values,
    set_priors,
    with_effects,
)
from seatrial.ident.model import Model, ParameterOrigin
from seatrial.ident.models import is_own_model, thrust_calibration
from seatrial.ident.results import UnusedSignal
from seatrial.ident.workflows.check import with_estimator_errors, with_noise_floors
from seatrial.ident.workflows.model_inputs import (
    check_ahead,
    check_names,
    choose_model,
    completed,
    require_one_frame,
    thrust_from,
    unused_signals,
)

SLOW_INPUT_S = 0.015  # s between samples of an output from which its changes are uncertain in time


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
        despite_faults: fit also where the checks of the logs find what makes a fit meaningless.
        homogeneity: parameters to test for one value in all logs.
        profiles: parameters that get a profile likelihood.
        rate: rows a second to which faster sensors are averaged [Hz].
        window: of the logs; those for validation are whole.
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
    despite_faults: bool = False
    homogeneity: Sequence[str] = ()
    profiles: Sequence[str] = ()
    rate: float = 10.0
    window: TimeWindow = WHOLE


@dataclass(frozen=True)
class VehicleProblem:
    """What is fitted to what: a model with its prior knowledge, segments to estimate and to validate.

    ``notes``: what the rig's geometry says, and which noises have a floor; ``thrust``: what the thrust follows;
    ``unused``: signals of the logs that the model does not take.
    """

    model: Model
    segments: list[LogSegment]
    validation: list[LogSegment]
    notes: list[str]
    thrust: str
    unused: list[UnusedSignal]


def with_calibration(model: Model, curve: ThrustCurve, own: bool) -> tuple[Model, list[str]]:
    """The model with the calibration of its thrust curve as a parameter that has a prior, and a line that says so.

    ``own``: the model is the user's, of which nobody knows where its thrust is.
    """
    if curve.calibration is None:
        return model, ["Thrust by a curve without the error of its calibration: the errors below do not have it."]
    known = f"Thrust by a curve that is calibrated to ± {100 * curve.calibration:.2g} %"
    if own:
        return model, [f"{known}, which is not in the errors of a model of your own."]
    return model + thrust_calibration(model, curve.calibration), [f"{known}: its factor k_thrust is in the errors."]


def with_sampled_inputs(source: str, loaded: Sequence[LoadedLog]) -> tuple[str, list[str]]:
    """The model that takes inputs for uncertain in time, where there is one and they are known from slow samples, and a
    line that says so: without it errors from 10 Hz are too small by a factor of two or three, and what 40 Hz leave open
    makes a damping of four standard errors where there is none (docs/examples/ardurover)."""
    name, *options = source.split(":")
    slowest = max((x.run.channels[n].sampled for x in loaded for n in SHAFTS if n in x.run.channels), default=0.0)
    if name != "nomoto" or "sampled" in options or slowest < SLOW_INPUT_S:
        return source, []
    chosen = ":".join((name, "sampled", *options))
    return chosen, [f"Outputs are known every {slowest:.2g} s: they are uncertain in time (--model {chosen})."]


def considered_notes(model: Model) -> list[str]:
    """A line that says what is in the errors beside what the logs tell."""
    held = [p for p in model.parameters if p.considered_sd is not None]
    if not held:
        return []
    words = [
        f"{p.meaning} {p.name} ± {f'{p.considered_sd:g} {p.unit}'.strip()}"
        f"{' (built in)' * (p.origin is ParameterOrigin.BUILT_IN)}"
        for p in held
    ]
    return [
        f"The standard errors have in them what no log tells of its own sensors: {', '.join(words)}. "
        f"`ident vehicle --prior {held[0].name}={held[0].value:g}:SD` gives yours."
    ]


def vehicle_problem(
    request: VehicleRequest, loaded: Sequence[LoadedLog], unseen: Sequence[LoadedLog]
) -> VehicleProblem:
    """The model that a request asks for, for these logs. Raises SeatrialError where they lack what it needs."""
    curve, source = load_curve(request.thruster) if request.thruster is not None else None, request.model
    if curve is not None and source == "auto":
        source = "horizontal:force"
    loaded, unseen = ([completed(x, source, curve) for x in part] for part in (loaded, unseen))
    check_ahead(request.estimation.horizon, loaded, unseen)
    source, sampled = with_sampled_inputs(source, loaded)
    model = choose_model(source, [*loaded, *unseen])
    model, notes = apply_rig_geometry(model, loaded[0].rig, loaded[0].vehicle)
    notes = [*sampled, *notes]
    if not is_own_model(source):
        model, lasting = with_estimator_errors(model, loaded, {*request.fixed, *request.priors})
        notes += lasting
    if curve is not None:
        model, told = with_calibration(model, curve, own=is_own_model(source))
        notes += told
    model = with_effects(model, request.effects)
    require_one_frame(model, [*loaded, *unseen])
    model = set_initial_values(set_priors(model, request.priors), request.initial)
    model, untold = fix_parameters(model, request.thruster if curve is None else None, request.fixed)
    model = pose_scale(model)
    model, floors = with_noise_floors(model, loaded)
    notes += considered_notes(model)
    check_names(nominal(model), request.profiles, len(loaded))
    segments, validation = ([x.run for x in part] for part in (loaded, unseen))
    unused = unused_signals(model, loaded, unseen)
    return VehicleProblem(model, segments, validation, [*notes, *untold, *floors], thrust_from(model, loaded), unused)
