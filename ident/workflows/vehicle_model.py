"""Choice of the vehicle model for a fit: structure, geometry of the rig, bench results, priors and noise bounds."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from seatrial.daq.errors import SeatrialError
from seatrial.ident.characterisation import ThrustCurve, load_curve
from seatrial.ident.data import SHAFTS, WHOLE, LoadedLog, LogSegment, TimeWindows
from seatrial.ident.estimation import (
    AHEAD,
    EstimationOptions,
    apply_rig_geometry,
    fix_parameters,
    free_unknown_scale,
    load_model,
    nominal_model,
    parameters_of_effects,
    set_initial_values,
    set_priors,
    with_effect_priors,
    with_effects,
    with_values_per_log,
)
from seatrial.ident.model import Model, ModelKind, ParameterOrigin
from seatrial.ident.models import effects_for, is_own_model, thrust_calibration, with_thrust_of
from seatrial.ident.results import NOMOTO, NOMOTO_LAG, UnusedSignal
from seatrial.ident.workflows.check import with_estimator_errors, with_noise_floors
from seatrial.ident.workflows.model_inputs import (
    check_horizon,
    check_names,
    choose_model,
    hold_lines,
    in_one_frame,
    inputs_sentence,
    model_of_logs,
    require_one_frame,
    thrust_from,
    unused_signals,
    with_derived_signals,
)

SLOW_INPUT_S = 0.015  # s: if samples of an autopilot's output are farther apart, times of its changes are uncertain


@dataclass(frozen=True)
class VehicleRequest:
    """Options of `seatrial ident vehicle`.

    Attributes
    ----------
    logs, validation
        Logs that the model is fitted to, and other logs that validate it.
    out
        Folder for the results.
    estimation
        Options of the estimator.
    model
        Name of the structure, FILE.py:NAME for a user-defined model, the path of a model.toml, or ``auto`` for the
        horizontal model with the inputs that the logs have.
    thruster
        File of the thrust from a bench test: the model.toml of a thruster model, or of a static curve from command to
        thrust. None: no bench test.
    thrust_of
        Side with the given thrust, ``left`` or ``right``, if the thrusts of both sides differ; ``both``: the given
        thrust is their mean; ``unknown``. None: unknown, or what a model.toml says.
    fixed, initial
        Values of fixed parameters, and initial values of estimated parameters, by name.
    priors
        Mean and standard deviation of the prior of each parameter, by name.
    effects
        Names of effects of the catalogue, or of ``effects_file``, that are added with free parameters.
    effects_file
        Python file of user-defined effects. Without one of their names in ``effects``, all of them are added. None: no
        such effects.
    per_log
        Names of parameters of these effects that have a value of their own in each log.
    score_tests
        Whether to test the model by the score tests of the catalogue. The common errors of sensors and hull form are
        then added if the data need them, and the standard errors include what remains unexplained.
    despite_faults
        Whether to fit even if the checks find faults that make a fit meaningless.
    homogeneity
        Names of the parameters for the homogeneity test.
    profiles
        Names of the parameters for the profile likelihood.
    rate
        Rate of the rows [Hz] over which faster sensors are averaged.
    window
        Interval of time of ``logs`` to use: one for all, or one for each; validation logs are used as a whole.
    mass
        Weighed mass of the boat without water around it [kg], with which the estimated mass in surge is compared. It is
        no prior. None: that of the rig file or import map, if they have one.
    """

    logs: Sequence[Path]
    validation: Sequence[Path]
    out: Path
    estimation: EstimationOptions = field(default_factory=lambda: EstimationOptions(reml=True, mean_order=2))
    model: str = "auto"
    thruster: Path | None = None
    thrust_of: str | None = None
    fixed: Mapping[str, float] = field(default_factory=dict)
    initial: Mapping[str, float] = field(default_factory=dict)
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    effects: Sequence[str] = ()
    effects_file: Path | None = None
    per_log: Sequence[str] = ()
    score_tests: bool = True
    despite_faults: bool = False
    homogeneity: Sequence[str] = ()
    profiles: Sequence[str] = ()
    rate: float = 10.0
    window: TimeWindows = WHOLE
    mass: float | None = None


@dataclass(frozen=True)
class VehicleProblem:
    """Vehicle model with its priors, and the logged signals for its estimation and validation.

    Attributes
    ----------
    model
        Model with free and fixed parameters, ready for the fit.
    segments, validation
        Signals of each log for the estimation, and of each log for the validation.
    notes
        Lines of text on geometry of the rig, calibration and priors.
    noise_notes
        Lines of text on the noise that the model assumes: states for the errors of a navigation filter, and lower
        bounds of the noise of smoothed signals. They are no warnings: each fit to the logs would repeat them, and the
        checks of the logs warn of signals that this can spoil.
    thrust
        Line of text on the signals that the thrust is computed from; empty if the thrust itself is an input.
    unused
        Signals of the logs that the model does not use.
    choice
        Sentence on commands that were chosen as inputs although the logs have measured shaft speeds; empty otherwise.
    ahead
        Given thrust of one thruster at full speed ahead, and its standard uncertainty [N], if that astern is not known:
        c1 is then this thrust before a first fit (`scaled_to_ahead`). None if c1 needs no such fit.
    added
        Names of the parameters of the effects that the user has added.
    effects_file
        Python file of the user-defined effects in the model; None if it has none.
    """

    model: Model
    segments: list[LogSegment]
    validation: list[LogSegment]
    notes: list[str]
    noise_notes: list[str]
    thrust: str
    unused: list[UnusedSignal]
    choice: str = ""
    ahead: tuple[float, float] | None = None
    added: tuple[str, ...] = ()
    effects_file: Path | None = None


def with_calibration(model: Model, curve: ThrustCurve, user_defined: bool) -> tuple[Model, list[str]]:
    """Add the calibration factor ``k_thrust`` of a thrust curve to the model, with a prior.

    The factor is the true thrust divided by the thrust of the curve.

    Parameters
    ----------
    model : Model
        Model of the boat, with thrust as an input.
    curve : ThrustCurve
        Thrust curve. The relative standard uncertainty of its forces is the standard deviation of the prior.
    user_defined : bool
        Whether the model is user-defined. Its thrust terms are unknown, so the factor cannot be added.

    Returns
    -------
    tuple of Model and list of str
        The model, and a list with one line of text about the calibration. The model is unchanged if it is user-defined,
        or if the uncertainty of the curve is unknown.
    """
    if curve.calibration is None:
        return model, [
            "The thrust curve has no calibration error, so the standard errors exclude it; add `calibration` (relative "
            "standard uncertainty of the load cell, such as 0.02) to the file of the curve."
        ]
    calibrated = f"The thrust curve is calibrated to ± {100 * curve.calibration:.2g} %"
    if user_defined:
        return model, [f"{calibrated}; the standard errors of a user-defined model exclude this error."]
    return model + thrust_calibration(model, curve.calibration), [
        f"{calibrated}; its factor k_thrust is included in the standard errors."
    ]


def with_sampled_inputs(source: str, loaded: Sequence[LoadedLog]) -> tuple[str, list[str]]:
    """Choose the variant ``sampled`` of a Nomoto model if its inputs are sampled slowly.

    The times at which these inputs change are uncertain, and the variant includes this uncertainty.

    Parameters
    ----------
    source : str
        Name of the model, with its options after colons.
    loaded : sequence of LoadedLog
        Estimation logs. The largest median sample interval of shaft speeds that are sampled outputs of an autopilot
        counts; measured shaft speeds do not.

    Returns
    -------
    tuple of str and list of str
        Name of the model, and a list with one line of text about the choice. The name is unchanged and the list empty
        for other structures, for a name with this variant, or for samples less than 15 ms apart.

    Notes
    -----
    Without this variant, standard errors from inputs at 10 Hz are too small by a factor of two or three. Inputs at 40
    Hz then yield a damping of four standard errors although the true damping is zero (docs/examples/ardurover).
    """
    name, *options = source.split(":")
    slowest = max((x.run.channels[n].sampled for x in loaded for n in SHAFTS if n in x.run.channels), default=0.0)
    if name != NOMOTO or "sampled" in options or slowest < SLOW_INPUT_S:
        return source, []
    chosen = ":".join((name, "sampled", *options))
    return chosen, [
        f"The thruster outputs are sampled every {slowest:.2g} s, so the times of their changes are uncertain; the "
        f"model {chosen} includes this, and is used."
    ]


def considered_notes(model: Model) -> list[str]:
    """Return a line of text on the considered parameters of a model.

    They are not estimated, but the standard errors of the estimates include the uncertainty of their priors.

    Parameters
    ----------
    model : Model
        Model before or after a fit.

    Returns
    -------
    list of str
        One line; an empty list if the model has no considered parameter.
    """
    held = [p for p in model.parameters if p.considered_sd is not None]
    if not held:
        return []
    words = [
        f"{p.meaning} {p.name} ± {f'{p.considered_sd:g} {p.unit}'.strip()}"
        f"{' (built in)' * (p.origin is ParameterOrigin.BUILT_IN)}"
        for p in held
    ]
    return [
        f"The standard errors include sensor errors that no log determines: {', '.join(words)}. "
        f"--prior {held[0].name}={held[0].value:g}:SD of a fit sets your own value."
    ]


def _held_lag_notes(source: str, model: Model, fixed: Collection[str]) -> list[str]:
    """Return the note that the time constant of Nomoto's model is not estimated, and how to estimate it.

    The list is empty for another model, and if the user gave the time constant a prior or a value.

    Parameters
    ----------
    source
        Name of the model, such as ``nomoto:sampled``.
    model
        The model with the priors and fixed parameters of the user.
    fixed
        Names of the parameters that the user fixed.
    """
    if source.partition(":")[0] != NOMOTO or model.parameter(NOMOTO_LAG).free or NOMOTO_LAG in fixed:
        return []
    return [
        f"{NOMOTO}: the time constant of the yaw rate, {NOMOTO_LAG}, is held at 0 s and not estimated, because without "
        "a prior it cannot be told from the delays of the inputs and the gyro. To estimate it, give the value that you "
        f"expect and its standard deviation, such as --prior {NOMOTO_LAG}=0.5:0.5 (s). For a vehicle that turns at "
        f"once, --fix {NOMOTO_LAG}=0 ends this warning."
    ]


def is_saved_model(source: str) -> bool:
    """Return whether the name of a model is the path of a model.toml, whose structure and effects a fit then uses."""
    return source.endswith(".toml")


def vehicle_problem(
    request: VehicleRequest, loaded: Sequence[LoadedLog], validation_logs: Sequence[LoadedLog]
) -> VehicleProblem:
    """Return the model and the data of a vehicle fit, from the options of the command and the loaded logs.

    Parameters
    ----------
    request : VehicleRequest
        Model and options. With the model ``auto`` and a thrust curve, the model is ``horizontal:force``. A model.toml
        gives the structure with its effects, priors and fixed parameters; its estimates are initial values.
    loaded, validation_logs : sequence of LoadedLog
        Logs for the estimation and for the validation, as loaded. Missing input signals are derived from others.

    Raises
    ------
    SeatrialError
        If the logs lack signals that the model needs, or if an option does not fit the model.
    """
    if is_saved_model(request.model):
        return _saved_problem(request, loaded, validation_logs)
    curve, source = load_curve(request.thruster) if request.thruster is not None else None, request.model
    if curve is not None and source == "auto":
        source = "horizontal:force"
    loaded, validation_logs = (
        [with_derived_signals(x, source, curve) for x in part] for part in (loaded, validation_logs)
    )
    check_horizon(request.estimation.horizon, loaded, validation_logs)
    source, sampled = with_sampled_inputs(source, loaded)
    model = choose_model(source, [*loaded, *validation_logs])
    model, notes = apply_rig_geometry(model, loaded[0].rig, loaded[0].vehicle)
    notes, noise_notes = [*sampled, *notes], list[str]()
    if not is_own_model(source):
        model, noise_notes = with_estimator_errors(model, loaded, {*request.fixed, *request.priors})
    if curve is not None:
        model, calibration_notes = with_calibration(model, curve, user_defined=is_own_model(source))
        notes += calibration_notes
    model, added = _with_requested_effects(_with_given_side(model, request), request)
    require_one_frame(model, [*loaded, *validation_logs])
    model = set_initial_values(set_priors(model, request.priors), request.initial)
    model, fixed_notes = fix_parameters(model, request.thruster if curve is None else None, request.fixed)
    notes += _held_lag_notes(source, model, request.fixed)
    model = with_values_per_log(model, request.per_log)
    model, ahead = _with_thrust_ahead(free_unknown_scale(model), request, loaded[0].vehicle)
    model, floors = with_noise_floors(model, loaded)
    notes += considered_notes(model)
    check_names(nominal_model(model), request.profiles, len(loaded))
    segments, validation = ([x.run for x in part] for part in (loaded, validation_logs))
    unused = unused_signals(model, loaded, validation_logs)
    choice = inputs_sentence(model, [*loaded, *validation_logs]) if source == "auto" else ""
    notes, noise_notes, thrust = [*notes, *fixed_notes], [*noise_notes, *floors], thrust_from(model, loaded)
    return VehicleProblem(
        model, segments, validation, notes, noise_notes, thrust, unused, choice, ahead, added, request.effects_file
    )


def _with_requested_effects(model: Model, request: VehicleRequest) -> tuple[Model, tuple[str, ...]]:
    """Return the model with the effects of the request, and the names of their parameters.

    The user-defined effects are called once with symbols. SeatrialError is raised as by `effects_for` and
    `with_effects`.
    """
    own = {} if request.effects_file is None else effects_for(model, request.effects_file)
    model = with_effects(model, request.effects, own)
    return model, parameters_of_effects(model, request.effects, own)


def _with_given_side(model: Model, request: VehicleRequest) -> Model:
    """Return the model with the given thrust for the side of the request (`with_thrust_of`); unchanged without one."""
    return model if request.thrust_of is None else with_thrust_of(model, request.thrust_of)


def _with_thrust_ahead(
    model: Model, request: VehicleRequest, vehicle: Mapping[str, float]
) -> tuple[Model, tuple[float, float] | None]:
    """Return the model, and the given thrust ahead with its standard uncertainty [N], if a first fit must scale c1.

    With a c2 that is not estimated, c1 follows from the thrust ahead at once. The second result is then None. It is
    also None if the numbers of the boat (``vehicle``) lack this thrust, or if c1 or a bench test was given.
    """
    given = AHEAD in vehicle and "c1" not in vehicle and {"c1", "c2"} <= set(model.values)
    if not given or request.thruster is not None or "c1" in {*request.fixed, *request.priors}:
        return model, None
    ahead, sd, c1, c2 = vehicle[AHEAD], vehicle.get(f"{AHEAD}_sd", 0.0), model.parameter("c1"), model.parameter("c2")
    if c1.origin not in (ParameterOrigin.GIVEN, ParameterOrigin.PRIOR):
        return model, None
    if c2.free:
        return model, (ahead, sd)
    return model.replace_parameters(c1.known(ahead - c2.value, sd * (1.0 - c2.value / ahead), c1.origin)), None


def _saved_problem(
    request: VehicleRequest, loaded: Sequence[LoadedLog], validation_logs: Sequence[LoadedLog]
) -> VehicleProblem:
    """Return the model of a model.toml and the data of its fit to other logs. The arguments are as above.

    Positions x and y of all logs are moved to the origin of the saved model. SeatrialError is raised for the model of a
    thruster, if the logs lack signals of the model, or if an option does not fit the model.
    """
    path = Path(request.model)
    saved = load_model(path)
    if saved.model.kind is not ModelKind.VEHICLE:
        raise SeatrialError(f"--model {path}: is no model of a boat; give the model.toml of ident vehicle or diagnose")
    check_horizon(request.estimation.horizon, loaded, validation_logs)
    loaded, validation_logs = in_one_frame(saved.model, loaded, validation_logs, saved.origin)
    curve = load_curve(request.thruster) if request.thruster is not None else None
    file = None if curve is None else str(request.thruster)
    model, segments, validation, _ = model_of_logs(saved.model, path, loaded, validation_logs, file)
    model = with_effect_priors(model, loaded[0].vehicle, loaded[0].rig)
    if saved.effects_file is not None and request.effects_file is not None:
        raise SeatrialError(
            f"--effects {request.effects_file}: {path} has effects of your own already ({saved.effects_file}); put all "
            "of them into one Python file, and fit without the model.toml"
        )
    model, added = _with_requested_effects(_with_given_side(model, request), request)
    model = set_initial_values(set_priors(model, request.priors), request.initial)
    model, notes = fix_parameters(model, request.thruster if curve is None else None, request.fixed)
    model = with_values_per_log(model, request.per_log)
    model, floors = with_noise_floors(model, loaded)
    check_names(nominal_model(model), request.profiles, len(loaded))
    notes = [*hold_lines(saved, [*loaded, *validation_logs]), *considered_notes(model), *notes]
    unused = unused_signals(model, loaded, validation_logs)
    return VehicleProblem(
        model,
        segments,
        validation,
        notes,
        floors,
        thrust_from(model, loaded),
        unused,
        added=added,
        effects_file=request.effects_file or saved.effects_file,
    )
