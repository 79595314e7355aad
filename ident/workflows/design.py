"""Workflow of `seatrial mission design`: from a model to a mission file, a result file (.json) and a page (.html)."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from seatrial.daq.config import (
    ENOUGH_INSIDE,
    Mission,
    OperationArea,
    Prediction,
    Segment,
    area_sentence,
    dump_mission,
    parse_mission,
    save_mission,
)
from seatrial.daq.errors import SeatrialError, closest_name
from seatrial.daq.files import require_new, require_parent
from seatrial.ident.data import TIME_INPUT, WORK_INPUT
from seatrial.ident.effects import catalogue, is_special_case, separating_experiment
from seatrial.ident.estimation import (
    RefittedEffect,
    SavedModel,
    dynamic_parameters,
    leaves_validity,
    load_model,
    model_file,
    reported_units,
    simulate,
    thrust_scale_of,
)
from seatrial.ident.experiment_design import (
    COAST_S,
    GRID,
    N_TRACKS,
    PRIOR_HALFWIDTH,
    RATE,
    RELIABLE_T,
    REST_S,
    SHAFT_POLE,
    SINGULAR,
    BaselineSignal,
    Design,
    DesignEvaluator,
    DesignLimits,
    DesignProblem,
    DiscriminationDesign,
    Kind,
    ParameterPrior,
    PredictedTrack,
    StepInput,
    ThrusterResponse,
    baseline_signals,
    baselines_apart,
    design,
    discriminate,
    monte_carlo,
    planned_record,
    predicted_errors,
    predicted_track,
    prior_from_fit,
    probability_of_true_model,
    reason_without_mission,
    reliable_duration,
    rounded_up,
    row_spacing,
    separation_if_repeated,
)
from seatrial.ident.model import Effect, Model, ModelKind, Parameter, ParameterOrigin
from seatrial.ident.models import effect_for, make_model
from seatrial.ident.numerics import Array, violates_constraint
from seatrial.ident.report import typeset_unit, write_design_page
from seatrial.ident.reporter import QUIET, PhasedReporter, Reporter, TimeLeft
from seatrial.ident.results import (
    Baseline,
    CommandTrace,
    DesignedParameter,
    DesignResult,
    DesignTrack,
    Discrimination,
    EffectParameter,
    HypothesisSize,
    ResultWarning,
    design_warnings,
    finite,
    format_number,
    listed,
    provenance,
    write_result,
)

N_SHOWN = 24  # sampled tracks on the page
# Words of the phases of a design, and of one that distinguishes two effects, as their progress has them
PHASES = (
    *("reading the model", "time constants", "compiling the model", "simulations"),
    *("with random sequences", "Monte Carlo", "track"),
)
APART_PHASES = (
    *("reading the model", "time constants", "compiling the model", "compiling both models", "search", "refits"),
    *("run twice", "with random sequences", "track"),
)
LONGEST_S = 3600.0  # s: a mission to distinguish two effects that would have to be longer is not recommended
THRUST_KEPT = 0.9  # error of the thrust scale after a mission over that before: the mission hardly changes it
THRUST_SHARE = 0.8  # share of the thrust scale in the error of a parameter, from which it sets the limit
NAMED = 3  # parameters in the answer
STEP_S = 5.0  # s: mean length of a step, unless --steps gives their number
NEGLIGIBLE = 0.02  # of the standard deviation of a prior: a fitted effect below it is taken as not found


@dataclass(frozen=True)
class DesignRequest:
    """Options of `seatrial mission design`.

    Attributes
    ----------
    duration
        Length of the mission [s].
    steps
        Number of steps; None: one for each 5 s, but at least 8, and no more than the shortest step allows.
    criterion
        Scalar of the information matrix that is maximised: D, A, E or Ds.
    chosen
        Names of the parameters of the criterion; empty: all that the sensors observe.
    limits
        Limits on area, speed and energy, and the largest current in which the boat must keep to them.
    shortest
        Length of the shortest step [s].
    n_max
        Largest size of a command, 0 to 1 (full command).
    slew
        Slew limit of a command [1/s].
    rates
        Sample rates [Hz] by name of the sensor. Other sensors have the rate of the data that the model was fitted to,
        or 10 Hz if it is unknown.
    robust
        Number of parameter samples that the criterion is averaged over; 0: nominal values only.
    spread
        Half-width of the uniform prior of each parameter, relative to its value. It is not used with a model.toml,
        whose covariance is the prior.
    process_noise
        True: information of prediction error. False: of output error.
    seed
        Seed of all random draws.
    evaluations
        Number of simulations of the search.
    between
        Names of two effects to discriminate; empty: the mission is designed for the criterion.
    thrusters
        Names of the thrusters in the rig; empty: those of the model.
    thruster
        Bench model (a folder or a model.toml) whose time constant the shafts have; None: a built-in one. A model with
        commands as inputs has its own shafts.
    """

    duration: float = 600.0
    steps: int | None = None
    criterion: Kind = "D"
    chosen: tuple[str, ...] = ()
    limits: DesignLimits = field(default_factory=DesignLimits)
    shortest: float = 1.0
    n_max: float = 1.0
    slew: float = np.inf
    rates: Mapping[str, float] = field(default_factory=dict)
    robust: int = 0
    spread: float = PRIOR_HALFWIDTH
    process_noise: bool = True
    seed: int = 1
    evaluations: int = 20_000
    between: tuple[str, ...] = ()
    thrusters: tuple[str, ...] = ()
    thruster: Path | None = None


def make_design(
    source: str, request: DesignRequest, out: Path, command: str, reporter: Reporter, force: bool = False
) -> DesignResult:
    """Design a mission, compare it with baseline signals, and write the mission, its result and its page.

    The mission maximises the criterion, or discriminates the two effects of ``request.between``.

    Parameters
    ----------
    source : str
        A file model.toml, the name of a built-in model, or FILE.py:NAME for a user-defined model.
    request : DesignRequest
        Options of the design.
    out : Path
        The mission.toml. A .json file (the result) and an .html page are written beside it.
    command : str
        Command line, for the provenance.
    reporter : Reporter
        Receives progress.
    force : bool
        Whether existing files are replaced.

    Returns
    -------
    DesignResult
        Content of the .json file.

    Raises
    ------
    SeatrialError
        If the model or an option cannot be used, or if one of the files exists and ``force`` is false. No file is
        written then.
    """
    reporter = PhasedReporter(reporter, APART_PHASES if request.between else PHASES)
    beside = _paths_beside_mission(out, force)
    task, compared = make_task(source, request, reporter)
    if beyond := warn_beyond_commands(task):
        reporter.warning(beyond)
    model_thrusters = task.actuation.thrusters
    thrusters = request.thrusters or model_thrusters
    if len(thrusters) != len(model_thrusters):
        raise SeatrialError(
            f"a mission for model {task.model.name} commands {len(model_thrusters)} thrusters "
            f"({', '.join(model_thrusters)}); "
            f"--thrusters names {len(thrusters)}: name one for each"
        )
    idle = Segment("static", np.zeros(1), np.zeros((1, len(thrusters))))
    parse_mission(dump_mission(Mission("names", "mission", tuple(thrusters), (idle,), 1.0)), "--thrusters")
    reporter.progress("design: compiling the model")
    DesignEvaluator(task).criterion  # noqa: B018  # raises the error of a wrong --parameters before the search
    reporter.progress(
        f"design: {task.steps.n_steps} steps in {task.steps.duration:g} s for {', '.join(_criterion_parameters(task))}"
    )
    apart: Discrimination | None = None
    if request.between:
        made, apart = _discrimination_design(task, compared, request, reporter)
    else:
        left = TimeLeft(request.evaluations, "in this phase")
        made = design(
            task,
            evaluations=request.evaluations,
            progress=lambda n, merit, number, of: reporter.progress(
                f"design: {n} of about {request.evaluations} simulations, search {number} of {of}, "
                f"{search_state(merit, f'{request.criterion} {merit:.2f}')} ({left.text(n, n * of / number)})"
            ),
        )
    reporter.progress("design: comparison with random sequences")
    found = baseline_signals(task, seed=request.seed)
    samples = None
    if apart is None:
        reporter.progress("design: Monte Carlo of the parameters")
        commands = {"design": made.command} | {k: r.command for k, r in found.items()}
        samples = monte_carlo(task, commands, seed=request.seed)
    else:  # by the criterion of the search
        first, second = compared
        found = baselines_apart(first.model, second.model, task, found)
        apart = msgspec.structs.replace(apart, random=np.concatenate([signal.values for signal in found.values()]))
    reporter.progress("design: track")
    track, unbounded = _bounded_track(made)
    best = max(found, key=lambda k: found[k].value)
    fine = found[best].command[np.minimum(_rows_of_finer_grid(task), len(task.t) - 1)]
    parameters = _parameter_table(made, predicted_errors(task, fine))
    here = provenance([], command)
    result = DesignResult(
        created=here.created, seatrial=here.seatrial, command=here.command,
        answer=_with_full_stop(
            _design_answer(made, parameters, apart, found[best]) + _area_end(track, task.limits)
        ),
        model=source, criterion=task.criterion if apart is None else "T", chosen=tuple(_criterion_parameters(task)),
        form="prediction error" if task.process_noise else "output error",
        value=made.value if apart is None else min(apart.if_first, apart.if_second),
        evaluations=made.found.evaluations, parameters=parameters,
        baselines=tuple(Baseline(name=k, value=r.value, bandwidth=r.bandwidth, seeds=r.values)
                     for k, r in found.items()),
        baseline=best, limited=task.limits.bind, samples={} if samples is None else dict(samples.values),
        share_won=None if samples is None else samples.share_won(),
        inputs=tuple(CommandTrace(name=c, t=task.t, value=made.command[:, k])
                     for k, c in enumerate(task.actuation.channels)),
        track=None if track is None else _track_table(track, task.limits), apart=apart,
        rates={s.name: task.rate(s.name) for s in task.model.sensors},
        warnings=(*_design_warnings(made), *unbounded),
    )  # fmt: skip
    title = (
        " against ".join(request.between) or f"{request.criterion}-optimal for {', '.join(_criterion_parameters(task))}"
    )
    mission = designed_mission(f"steps, {title}", thrusters, made, track, request, source, command)
    parse_mission(dump_mission(mission), out)
    save_mission(mission, out, force)
    write_result(result, beside[".json"])
    write_design_page(result, beside[".html"])
    return result


def _paths_beside_mission(out: Path, force: bool) -> dict[str, Path]:
    """Return the paths of the .json and .html files beside the mission file ``out``, by suffix. No file is written.

    Raise SeatrialError if one of the three files may not be created: it exists and ``force`` is false, or it is no
    regular file. Raise it too if ``out`` has one of these suffixes, or if its folder cannot be created.
    """
    if out.suffix in (".json", ".html"):
        raise SeatrialError(
            f"{out}: a mission cannot end in .json or .html, since files with these endings are written beside it; "
            "give a name that ends in .toml"
        )
    require_parent(out)
    beside = {kind: out.with_suffix(kind) for kind in (".json", ".html")}
    for path in (out, *beside.values()):
        require_new(path, force, "--out")
    return beside


def _bounded_track(made: Design) -> tuple[PredictedTrack | None, list[ResultWarning]]:
    """Return the predicted track of a design, and the warnings about it.

    The track is None if the model has no position. It is None too, with a warning, if the tracks of too many sampled
    boats grow without limit.
    """
    track = predicted_track(made)
    if track is None or track.is_bounded:
        return track, []
    text = (
        f"No track is predicted: with parameters within the standard errors of the model, "
        f"{100 * track.share_unbounded:.0f} % of the simulated boats move faster without limit. The model is too "
        "uncertain for this mission. Run it only where the water is free on all sides, or reduce --n-max, or fit the "
        "model to more data."
    )
    return None, [ResultWarning(code="track-not-predicted", text=text)]


def _design_warnings(made: Design) -> list[ResultWarning]:
    """Return the warnings of a designed mission, for its result.

    They are about thruster data that the model lacks and the design assumes, about sensor rates that are assumed or are
    more than 5 % above those of the data that the model was fitted to, and about inputs and states that leave the range
    of these data.
    """
    task = made.problem
    built_in = not task.actuation.shafts_are_states and task.pole == SHAFT_POLE
    pole = task.pole if built_in else None
    warnings = design_warnings(task.model, task.actuation.full_thrust, pole)
    given_rates = {**task.fitted_rates, **task.rates}
    if assumed := [s.name for s in task.model.sensors if s.name not in given_rates]:
        text = (
            f"The design assumes {RATE:g} Hz for sensors whose rate neither --rate nor the model.toml gives: "
            f"{', '.join(assumed)}. With slower sensors the standard errors of a fit will be larger: give their rates "
            "by --rate."
        )
        warnings.append(ResultWarning(code="rates-assumed", text=text))
    fitted = {n: task.fitted_rates[n] for n, hz in task.rates.items() if hz > 1.05 * task.fitted_rates.get(n, hz)}
    if fitted:
        rows = ", ".join(f"{n} {hz:.3g} Hz" for n, hz in fitted.items())
        text = (
            f"--rate is above the rate of the data that the model was fitted to ({rows}), and the model has the noise "
            "of these data. If the fit averaged the samples of a faster sensor, its single samples have more noise: "
            "leave out --rate for this sensor."
        )
        warnings.append(ResultWarning(code="rates-assumed", text=text))
    if beyond := beyond_validity(made):
        text = (
            f"The mission goes beyond the data that the model was fitted to: {'; '.join(beyond)}. The model is not "
            "tested there: the boat may move faster and farther than predicted, and the promised numbers may not hold. "
            f"{options_within_validity(made)}, or leave more room around the track."
        )
        warnings.append(ResultWarning(code="beyond-validity", text=text))
    return warnings


def beyond_validity(made: Design) -> list[str]:
    """Return a text for each input and state of a designed mission that leaves the range of the fitted data.

    Parameters
    ----------
    made : Design
        Design whose commands are simulated.

    Returns
    -------
    list of str
        Name, reached range and range in the fitted data of each such signal. Empty if no signal leaves its range, or if
        the model file has no ranges.

    Notes
    -----
    A signal leaves its range if it exceeds an end by more than 10 % of the width of the range. As in the fitted data,
    the reached range of an input is from its minimum to its maximum, that of a state from its 1 % to its 99 % quantile.
    """
    task = made.problem
    if not task.validity:
        return []
    t, u = task.t_whole, task.whole_inputs(made.command[:, :, None])[:, :, 0]
    x = simulate(task.model, planned_record(task.model, t, u)).x
    reached = {i.name: (float(u[:, j].min()), float(u[:, j].max())) for j, i in enumerate(task.model.inputs)}
    ends = np.percentile(x, (1.0, 99.0), axis=0)
    reached |= {s.name: (float(ends[0, j]), float(ends[1, j])) for j, s in enumerate(task.model.states)}
    units = {i.name: f" {i.unit}".rstrip() for i in task.model.inputs}
    units |= {s.name: f" {s.unit}".rstrip() for s in task.model.states}
    found = []
    for name, (low, high) in task.validity.items():
        if name not in reached or name in (TIME_INPUT, WORK_INPUT):
            continue  # a mission may be longer than the fitted logs
        least, most = reached[name]
        if leaves_validity(least, most, (low, high)):
            there = f"{low:.2g} to {high:.2g}{units[name]}"
            found.append(f"{name} from {least:.2g} to {most:.2g}{units[name]} (data: {there})")
    return found


def options_within_validity(made: Design) -> str:
    """Return the advice for a mission closer to the fitted data, without a full stop: ``... give --n-max 0.78``.

    The largest command is that of the data (`largest_fitted_command`), the speed is the largest surge speed in the
    data, rounded down to two digits. The command is left out if `warn_beyond_commands` has nothing to say, because a
    command that is hardly smaller changes little, and the speed if the mission is not faster than the data, or if the
    given limit is as strict already. If none is left, the advice is a smaller largest command than the given one.
    """
    model, known = made.problem.model, made.problem.validity
    fitted = largest_fitted_command(made.problem)
    speeds = [max(map(abs, known[s.name])) for s in model.states if s.name == "u" and s.name in known]
    largest = made.problem.steps.n_max
    limits = [f"--n-max {fitted:g}"] if fitted is not None and warn_beyond_commands(made.problem) else []
    if any(beyond.startswith("u from ") for beyond in beyond_validity(made)):
        given = made.problem.limits.speed
        limits += [f"--max-speed {v:g}" for v in _rounded_down(speeds) if given is None or v < given]
    smaller = "a smaller --n-max" if fitted is None else f"a smaller --n-max than {largest:.2g}"
    return f"To stay nearer to the data, give {' or '.join(limits or [smaller])}"


def _fitted_commands(task: DesignProblem) -> dict[str, tuple[float, float]]:
    """Return the range of each command, or shaft speed, in the data that the model was fitted to, by its name."""
    commanded = [i.name for i in task.model.inputs if i.name.endswith(task.actuation.channels) and not i.unit]
    return {name: task.validity[name] for name in commanded if name in task.validity}


def largest_fitted_command(task: DesignProblem) -> float | None:
    """Return the largest command in the data that the model was fitted to; None if the model has no ranges of them.

    It is that of the thruster with the smallest range of its commands or shaft speeds, rounded down to two digits after
    the point.
    """
    return next(iter(_rounded_down([max(map(abs, ends)) for ends in _fitted_commands(task).values()])), None)


def warn_beyond_commands(task: DesignProblem) -> str:
    """Return the warning that ``--n-max`` is beyond the commands of the data that the model was fitted to; often "".

    It is known before the search. A command is beyond its range if it leaves it by more than a tenth
    (`leaves_validity`).
    """
    largest = task.steps.n_max
    fitted = largest_fitted_command(task)
    beyond = [
        f"{name} from {low:.2g} to {high:.2g}"
        for name, (low, high) in _fitted_commands(task).items()
        if leaves_validity(-largest, largest, (low, high))
    ]
    if not beyond or not fitted or fitted >= largest:
        return ""
    return (
        f"The largest command of the mission, --n-max {largest:g}, is beyond the data that the model was fitted to "
        f"({'; '.join(beyond)}). The model is not tested there. For a mission within these commands, stop this design "
        f"and give --n-max {fitted:g}."
    )


def _rounded_down(limits: Sequence[float]) -> list[float]:
    """Return the smallest limit, rounded down to two digits after the point; no number without a limit."""
    return [float(np.floor(100.0 * min(limits)) / 100.0)] if limits else []


def designed_mission(
    name: str,
    thrusters: Sequence[str],
    made: Design,
    track: PredictedTrack | None,
    request: DesignRequest,
    source: str,
    command: str,
) -> Mission:
    """Return a designed mission: a segment at rest of 5 s, then the steps of the design.

    Numbers are rounded: times to 1 ms or to six digits, whichever is coarser, levels to six digits, positions to 1 cm,
    standard errors to four digits. The standard errors are in reported units (ratios to the thrust if the scale of the
    forces is unknown); infinite ones are left out. Levels are limited to ``n_max``. The mission ends with the last
    step: the coasting after it is part of the predicted track only.

    Parameters
    ----------
    name : str
        Name of the mission.
    thrusters : sequence of str
        Names of the thrusters in the rig, in the order of the design.
    made : Design
        Design with the levels and durations of the steps, and with the expected standard errors.
    track : PredictedTrack or None
        Predicted track; None if the model has no position. The mission then has no prediction of the track.
    request : DesignRequest
        Options of the design: limits of the commands and seed.
    source : str
        Model of the design, as named on the command line.
    command : str
        Command line, for the provenance.
    """
    levels = made.problem.actuation.for_thrusters(made.levels)
    edges = np.round(REST_S + np.concatenate([[0.0], np.cumsum(made.durations)]), 3)
    segments = (
        Segment("static", np.zeros(1), np.zeros((1, len(thrusters)))),
        Segment(
            "designed steps",
            round_to_digits(edges[:-1], 6),
            round_to_digits(levels, 6).clip(-request.n_max, request.n_max),
        ),
    )
    units, model = reported_units(made.problem.model), made.problem.model
    factors = {name: units.factor(model.parameter(name).unit) for name in made.problem.observed_parameters}
    predicted, before = (
        {k: float(f"{v * factors[k]:.4g}") for k, v in errors.items() if np.isfinite(v)}
        for errors in (made.predicted, made.before)
    )
    prediction = None
    if track is not None:
        t, x, y, radius = (
            round_to_digits(v, 6) for v in (track.t, track.x.round(2), track.y.round(2), track.radius.round(2))
        )
        prediction = Prediction(source, t, x, y, radius, before, operation_area(track, made.problem.limits))
    return Mission(
        name,
        "mission",
        tuple(thrusters),
        segments,
        float(edges[-1]),
        n_max=request.n_max,
        slew_per_s=request.slew,
        made_by=command,
        seed=request.seed,
        predicted_errors=predicted,
        prediction=prediction,
    )


def operation_area(track: PredictedTrack, limits: DesignLimits) -> OperationArea | None:
    """Return the area of operation of a design for its mission file, with the corner in cm; None without an area.

    Parameters
    ----------
    track : PredictedTrack
        Predicted track of the design.
    limits : DesignLimits
        Limits of the design.
    """
    if limits.area is None or track.corner is None or track.inside is None:
        return None
    south, west = (round(float(v), 2) for v in track.corner)
    return OperationArea((float(limits.area[0]), float(limits.area[1])), (south, west), round(track.inside, 4))


def round_to_digits(values: Array, digits: int) -> Array:
    """Round an array to a number of significant digits, and return it as a new array of the same shape.

    NaN and infinity stay unchanged.

    Parameters
    ----------
    values : Array (...)
        Numbers.
    digits : int
        Number of significant digits.
    """
    return np.array([float(f"{v:.{digits}g}") for v in values.ravel()]).reshape(values.shape)


def make_task(
    source: str, request: DesignRequest, reporter: Reporter = QUIET
) -> tuple[DesignProblem, tuple[EffectHypothesis, ...]]:
    """Return the design problem that the options of `seatrial mission design` define, and the effects to discriminate.

    The problem has the model, the number of steps, the criterion, the limits, the prior and the spacing of the rows in
    time. The effects are two (`hypotheses`), or none if ``request.between`` is empty.

    Parameters
    ----------
    source : str
        A file model.toml, the name of a built-in model, or FILE.py:NAME for a user-defined model. A model.toml gives
        the prior (the covariance of its estimates), the ranges of its signals and its sensor rates.
    request : DesignRequest
        Options of the design.
    reporter : Reporter
        Receives progress.

    Raises
    ------
    SeatrialError
        If the model cannot be read, lacks a sensor that ``request.rates`` names, has no free parameters of the
        dynamics, has inputs that no mission commands, or has no current although the limits have one. Also if the steps
        do not fit into the duration, or if the two effects of ``request.between`` cannot be compared (`hypotheses`).
    """
    is_path = source.endswith((".toml", ".json")) or ("/" in source and Path(source).is_dir())
    reporter.progress("design: reading the model")
    saved = load_model(Path(source)) if is_path else None
    model = saved.model if saved is not None else make_model(source)
    if why := reason_without_mission(model):
        raise SeatrialError(f"no mission can be designed for model {model.name}: {why}")
    unknown = set(request.rates) - {s.name for s in model.sensors}
    if unknown:
        raise SeatrialError(
            f"--rate {sorted(unknown)[0]}: model {model.name} has no such sensor; it has "
            f"{', '.join(s.name for s in model.sensors)}"
        )
    n_channels = len(ThrusterResponse(model, np.array([0.0, 1.0])).channels)
    steps = StepInput(1, n_channels, request.duration, request.shortest, GRID, request.n_max)
    n_steps = request.steps or min(max(8, round(request.duration / STEP_S)), max(steps.n_rows // steps.least_rows, 1))
    task = DesignProblem(
        model,
        replace(steps, n_steps=n_steps),
        request.criterion,
        request.chosen,
        request.rates,
        request.limits,
        request.slew,
        robust=request.robust,
        process_noise=request.process_noise,
        seed=request.seed,
    )
    if request.thruster is not None:
        task = replace(task, pole=_shaft_pole(request.thruster, task.actuation.shafts_are_states))
    if not dynamic_parameters(model):
        raise SeatrialError(
            f"model {model.name} has no free parameters, so no mission can inform any; choose a model with free "
            "parameters"
        )
    if saved is None:
        task = replace(task, prior=ParameterPrior(task.observed_parameters, request.spread))
    else:
        task = replace(task, prior=prior_from_fit(saved), validity=saved.validity, fitted_rates=saved.rates)
    compared = hypotheses(model if saved is None else saved, request.between) if request.between else ()
    reporter.progress("design: time constants of the sampled boats, for the spacing of the rows")
    members = [
        (model, DesignEvaluator(task).boats(N_TRACKS, 2)),
        *((h.model, np.array([list(h.model.values.values())])) for h in compared),
    ]
    return replace(task, grid=row_spacing(members, GRID, request.n_max)), compared


def _shaft_pole(path: Path, shafts_are_states: bool) -> float:
    """Return the pole [1/s] of the shaft of a bench model, for a model whose inputs are no commands.

    Raise SeatrialError for a model with commands, which has its own shafts, and for a file without a pole.
    """
    if shafts_are_states:
        raise SeatrialError(
            "--thruster: the inputs of this model are commands, so that it has its own shafts; leave it out"
        )
    saved = load_model(model_file(path))
    pole = saved.model.values.get("a", 0.0) if saved.model.kind is ModelKind.BENCH else 0.0
    if pole <= 0.0:
        raise SeatrialError(
            f"--thruster {path}: this is no model of a thruster with a time constant; give the folder of "
            "`seatrial ident thruster`"
        )
    return float(pole)


def search_state(merit: float, value: str) -> str:
    """Return ``value``, the criterion of the best mission of a search as text, or why there is none so far.

    ``merit`` is that of the best mission, a large negative number if it violates a limit.
    """
    if violates_constraint(merit):
        return "no mission within the limits so far"
    return "no mission so far that informs all parameters" if merit <= SINGULAR else value


def _separation_text(merit: float) -> str:
    """Return the criterion T with three digits, from its logarithm; 0 for the large negative number of a violation."""
    return f"{float(f'{np.exp(merit):.3g}'):g}"


def _criterion_parameters(task: DesignProblem) -> tuple[str, ...]:
    """Return the names of the parameters of the design criterion: the chosen ones, or all that the sensors observe.

    A parameter is observed if at least one output depends on it.
    """
    return task.chosen or task.observed_parameters


def _discrimination_design(
    task: DesignProblem, compared: Sequence[EffectHypothesis], request: DesignRequest, reporter: Reporter
) -> tuple[Design, Discrimination]:
    """Search the mission that discriminates two effects, ``compared``.

    The search has an eighth of the ``evaluations`` of the request, but at least 500. The first result is the mission as
    a design. Its value is the criterion of the parameters, so that its page is that of any design. The second result
    has the separation T of the two effects by this mission, with either effect as the true one, and, if one of both is
    too small, the smaller T of the mission run twice. T is the expected value of twice the log-likelihood ratio of the
    true model against the wrong model. The T of random sequences are missing.
    """
    a, b = (h.model for h in compared)
    total = max(request.evaluations // 8, 500)
    left = TimeLeft(total, "in this phase")
    made: DiscriminationDesign = discriminate(
        a,
        b,
        task,
        evaluations=total,
        progress=lambda n, merit, number, of: reporter.progress(
            f"design: {n} of about {total} comparisons, search {number} of {of}, "
            f"{search_state(merit, f'separation of the two effects (T) {_separation_text(merit)}')} "
            f"({left.text(n, n * of / number)}, then random sequences for comparison)"
        ),
        phase=lambda words: reporter.progress(f"design: {words}"),
    )
    reporter.progress("design: information of the mission")
    evaluator = DesignEvaluator(task)
    information = evaluator.information(task.actuation.inputs(made.command[:, :, None]))
    value = float(evaluator.criterion(information + evaluator.prior_information)[0])
    twice: float | None = None
    if not made.clear:
        reporter.progress("design: the mission run twice")
        twice = min(separation_if_repeated(a, b, task, made.command))
    first, second = (h.effect for h in compared)
    row = Discrimination(
        effects=(first, second),
        if_second=made.separation[0],
        if_first=made.separation[1],
        clear=made.clear,
        random=np.empty(0),
        probability=float(np.mean([probability_of_true_model(T) for T in made.separation])),
        sizes=tuple(_size_row(h) for h in compared),
        twice=twice,
    )
    return Design(task, made.levels, made.durations, value, information[0], made.found), row


@dataclass(frozen=True)
class EffectHypothesis:
    """Model with one of the two effects that a mission is to discriminate, and the origin of its size.

    Attributes
    ----------
    effect
        Name of the effect.
    model
        Model with this effect and without the other one.
    errors
        Standard errors of its fitted parameters by name, as far as they are known. None: the size is a typical one.
    beside
        Name of the other effect if the fit of the size has it too; empty otherwise.
    """

    effect: str
    model: Model
    errors: Mapping[str, float] | None = None
    beside: str = ""

    @property
    def fitted(self) -> bool:
        """Whether the size of the effect was fitted. Otherwise it is a typical size."""
        return self.errors is not None


def hypotheses(known: SavedModel | Model, names: Sequence[str]) -> tuple[EffectHypothesis, EffectHypothesis]:
    """Return the two hypotheses that a mission is to discriminate: the first effect, or the second one.

    The other effect is removed if the model has it, because a model with both effects would predict well whichever is
    true. An effect has its fitted size: that of the model, or else that of the last refit of the diagnosis without the
    other effect, or else that of the last refit beside it. The other parameters are those of the model in both
    hypotheses. An effect without a fit, or with a negligible fitted size, has a typical size: the initial value of each
    parameter plus half of the standard deviation of its prior, or plus five characteristic steps if it has no prior,
    limited to its bounds. A fitted size is negligible if each parameter that is zero without the effect is below 2 % of
    the standard deviation of its prior, or below one characteristic step if it has no prior. Of a one-sided effect only
    the first parameter counts.

    Parameters
    ----------
    known : SavedModel or Model
        Model with or without the effects; a saved one has the refits of its diagnosis.
    names : sequence of str
        Names of the two effects.

    Raises
    ------
    SeatrialError
        If an effect does not exist, if it does not apply to the model, or if one effect is a special case of the other.
    """
    first, second = names
    if is_special_case(first, second):
        is_first_general = first in catalogue() and second in catalogue()[first].nests
        general, special = (first, second) if is_first_general else (second, first)
        raise SeatrialError(
            f"--discriminate: {special} is a special case of {general}: no mission tells them apart; "
            "name two other effects"
        )
    return _hypothesis(known, first, second), _hypothesis(known, second, first)


def _hypothesis(known: SavedModel | Model, name: str, other: str) -> EffectHypothesis:
    """Return the hypothesis of an effect without the effect ``other``, with the size of `hypotheses`.

    SeatrialError is raised if there is no effect of this name, or if it does not apply to the model.
    """
    saved = known if isinstance(known, SavedModel) else None
    model = (known.model if isinstance(known, SavedModel) else known).without(other)
    own = next((e for e in model.effects if e.name == name), None)
    effect = _effect_for(model, name) if own is None else own
    with_it = model + effect if own is None else model
    typical = EffectHypothesis(name, with_it.with_values(_typical_sizes(effect)))
    beside = ""
    values: Mapping[str, float] = with_it.values
    errors: Mapping[str, float] = {} if saved is None else saved.errors
    if own is None:
        refit = None if saved is None else refit_of(saved.refits, name, other)
        if refit is None or set(refit.values) != {p.name for p in effect.parameters}:
            return typical
        values, errors = refit.values, refit.errors
        beside = other if other in refit.beside else ""
    # Only these parameters are sizes. Others are places or shapes: they are not zero without the effect, or follow the
    # amplitude of a one-sided effect.
    sizing = [p for p in (effect.parameters[:1] if effect.one_sided else effect.parameters) if p.value == 0.0]
    least = {p.name: NEGLIGIBLE * p.prior[1] if p.prior is not None else p.step for p in sizing}
    if not any(abs(values[n]) >= size for n, size in least.items()):
        return typical
    kept = {p.name: values[p.name] for p in effect.parameters}
    known_errors = {n: float(errors[n]) for n in kept if np.isfinite(errors.get(n, np.nan))}
    return EffectHypothesis(name, with_it.with_values(kept), known_errors, beside)


def refit_of(refits: Sequence[RefittedEffect], name: str, other: str) -> RefittedEffect | None:
    """Return the last refit of the effect ``name`` in a model without the effect ``other``.

    If it is missing, the last refit beside the other effect takes its place; None if there is no refit.
    """
    own = [r for r in reversed(refits) if r.name == name]
    return next((r for r in own if other not in r.beside), own[0] if own else None)


def _effect_for(model: Model, name: str) -> Effect:
    """Return an effect of the catalogue whose priors have the size of the boat of a model.

    SeatrialError is raised if there is no effect of this name, or if it does not apply to the model.
    """
    if name not in catalogue():
        near = closest_name(name, catalogue())
        hint = f"did you mean {near!r}?" if near else f"the effects are {', '.join(catalogue())}"
        if "(" in name:
            hint = "this is a curve that is fitted without a formula, and has no size to design for; give an effect"
        raise SeatrialError(f"--discriminate: there is no effect {name!r}; {hint}")
    effect = catalogue()[name]
    if not model.accepts(effect):
        raise SeatrialError(
            f"--discriminate: effect {name!r} does not apply to model {model.name}; use another effect or model"
        )
    return effect_for(model, effect)


def _typical_sizes(effect: Effect) -> dict[str, float]:
    """Return a typical value of each parameter of an effect by name (`hypotheses`)."""
    sizes = {}
    for p in effect.parameters:
        size = 0.5 * p.prior[1] if p.prior is not None else 5.0 * p.step
        sizes[p.name] = float(np.clip(p.value + size, *p.bounds))
    return sizes


def _size_row(hypothesis: EffectHypothesis) -> HypothesisSize:
    """Return the size of the effect of a hypothesis, and its origin, as a row of the result, in reported units."""
    model, errors = hypothesis.model, hypothesis.errors or {}
    units = reported_units(model)
    effect = next(e for e in model.effects if e.name == hypothesis.effect)
    rows = []
    for p in (model.parameter(q.name) for q in effect.parameters):
        factor, error = units.factor(p.unit), errors.get(p.name)
        rows.append(
            EffectParameter(
                name=units.scale.name(p.name, p.unit), meaning=p.meaning, unit=units.scale.unit(p.unit),
                value=factor * p.value, se=None if error is None else factor * error,
            )
        )  # fmt: skip
    return HypothesisSize(
        effect=hypothesis.effect, origin="fitted" if hypothesis.fitted else "typical", parameters=tuple(rows),
        beside=hypothesis.beside,
    )  # fmt: skip


def _track_table(track: PredictedTrack, limits: DesignLimits) -> DesignTrack:
    """Return the predicted track of the boat, with the area and the current of the limits, as a table of the result.

    The first 24 finite tracks of sampled boats are kept; the radius and the share inside are those of all.
    """
    corner = None if track.corner is None else (float(track.corner[0]), float(track.corner[1]))
    return DesignTrack(
        t=track.t,
        x=track.x,
        y=track.y,
        radius=track.radius,
        others=tuple(track.others[np.isfinite(track.others).all(axis=(1, 2))][:N_SHOWN]),
        inside=track.inside,
        corner=corner,
        area=limits.area,
        current=limits.current,
        rest=REST_S,
        coasting=COAST_S,
    )


def _rows_of_finer_grid(task: DesignProblem) -> NDArray[np.intp]:
    """Return, for each time of the finer time grid of a design problem, the index of the last row at or before it.

    The rows are those of the design problem, between which commands are constant. The finer grid, that of
    ``task.finer``, is about as fast as the fastest sensor, or faster. The result has the shape (n_rows_finer,).
    """
    return np.asarray(np.searchsorted(task.t, task.finer.t + 1e-9, side="right") - 1)


def _parameter_table(made: Design, baseline: Mapping[str, float]) -> tuple[DesignedParameter, ...]:
    """Return the table of standard errors in the result of a design, one row for each observed parameter.

    A row has the errors before the mission, after it by prediction error, after it by the information that the design
    uses (``form``), and after the best baseline signal. They are in reported units (ratios to the thrust if the scale
    of the forces is unknown), and None if infinite. ``baseline``: standard error after the best baseline signal in the
    parameter's own unit, by name of the parameter; it is converted here.
    """
    model, before, after = made.problem.model, made.before, made.predicted
    chosen, units = _criterion_parameters(made.problem), reported_units(model)

    def reported(errors: Mapping[str, float], p: Parameter) -> float | None:
        """Return the standard error of a parameter in reported units. The result is None if the error is infinite."""
        return finite(errors[p.name] * units.factor(p.unit))

    return tuple(
        DesignedParameter(
            name=p.name, meaning=p.meaning, unit=units.scale.unit(p.unit),
            value=p.value * units.factor(p.unit), before=reported(before, p), after=reported(after, p),
            form=reported(made.errors, p), baseline=reported(baseline, p), chosen=p.name in chosen,
        )
        for p in (model.parameter(name) for name in made.problem.observed_parameters)
    )  # fmt: skip


def _design_answer(
    made: Design, parameters: Sequence[DesignedParameter], apart: Discrimination | None, baseline: BaselineSignal
) -> str:
    """Return the answer of a design: its expected standard errors, or how well it discriminates two effects.

    ``parameters``: rows of the table of standard errors; the answer names the first three chosen ones. ``apart``:
    discrimination of two effects, or None. If random missions distinguish them too, a second sentence states it.
    ``baseline``: best baseline signal by the criterion of the design. If it is better than the design, a warning says
    so: first, or after the answer on two effects.
    """
    if apart is not None:
        first, second = apart.effects
        least = min(apart.if_second, apart.if_first)
        verdict = "distinguishes" if apart.clear else "may not distinguish"
        answer = (
            f"This mission {verdict} {first} from {second}: criterion T is at least {format_number(least)} (best of "
            f"{apart.random.size} random sequences: {format_number(baseline.value)})"
            f"{'' if apart.clear else longer_mission_advice(apart, made.problem.steps.duration)}"
            f"{_random_sequences_sentence(apart, made.problem.limits.bind)}"
        )
        worse = is_larger(baseline.value, least)
        if not worse:
            return answer
        warning = warn_worse_than_baseline(baseline, made.problem, "T", least)
        return f"{answer}. {warning.removesuffix('.') if made.problem.limits.bind else warning}"
    parts = []
    rows = [p for p in parameters if p.chosen]
    for p in rows[:NAMED]:
        after = np.inf if p.after is None else p.after
        share = abs(after / p.value) if p.value else np.inf
        of_value = f" ({100 * share:.2g} %)" if share < 1 else ""
        parts.append(f"{p.name} ±{format_number(after)} {typeset_unit(p.unit)}{of_value}")
    more = f", and {len(rows) - NAMED} more" if len(rows) > NAMED else ""
    duration = made.problem.steps.duration
    errors = f"After this mission of {duration:g} s the expected standard errors are {', '.join(parts)}{more}"
    errors += thrust_limit_sentence(parameters, thrust_scale_of(made.problem.model).thrust)
    if not is_larger(baseline.value, made.value):
        return errors
    warning = warn_worse_than_baseline(baseline, made.problem, made.problem.criterion, made.value)
    # A mission that keeps limits is no failure if it informs less than one that ignores them.
    return f"{errors}. {warning.removesuffix('.')}" if made.problem.limits.bind else f"{warning} {errors}"


def thrust_limit_sentence(parameters: Sequence[DesignedParameter], origin: ParameterOrigin | None) -> str:
    """Return the sentence that the error of the thrust limits those of masses and damping after a mission; often empty.

    The motion determines a mass only as a ratio to the thrust. Its relative error is then nearly that of the thrust
    scale c1, which no mission reduces. The sentence names the chosen parameters in kg of which this error is at least
    `THRUST_SHARE` of the whole one. It begins with a full stop and has none at its end. ``parameters`` are the rows of
    the result, and ``origin`` is the provenance of the thrust: a measured one has to be measured better.
    """
    scale = next((p for p in parameters if p.name == "c1" and p.value), None)
    if scale is None or not scale.after or not scale.before or scale.after < THRUST_KEPT * scale.before:
        return ""
    share = scale.after / abs(scale.value)
    limited = [
        p.name
        for p in parameters
        if p.chosen and p.unit.startswith("kg") and p.after and share * abs(p.value) >= THRUST_SHARE * p.after
    ]
    if not limited:
        return ""
    return (
        f". The thrust scale (c1 ± {100.0 * share:.2g} %) sets this limit for {listed(limited, 'and')}, so that no "
        f"mission helps much more: measure the bollard pull{' better' if origin is ParameterOrigin.MEASURED else ''}"
    )


def is_larger(criterion: float, than: float) -> bool:
    """Return whether a criterion is larger than another one as the answer prints both: equal numbers are not."""
    return criterion > than and format_number(criterion) != format_number(than)


def _with_full_stop(answer: str) -> str:
    """Return an answer that ends with a full stop if it has several sentences; one alone is a headline without it."""
    return f"{answer.removesuffix('.')}." if re.search(r"[.!?] (?=[A-Z`])", answer) else answer


def _area_end(track: PredictedTrack | None, limits: DesignLimits) -> str:
    """Return the end of the answer on the area of operation, after its last full stop; "" without an area or a track.

    It says whether the nominal boat and the sampled boats stay in the area. If they do not, it says which area this
    mission needs, and with which smaller ``--area`` the boats probably stay in the given one.
    """
    area = None if track is None else operation_area(track, limits)
    if track is None or area is None:
        return ""
    text = area_sentence(area, track.x, track.y)
    enough = None if area.is_kept(track.x, track.y) else _enough_area(track, area)
    if enough is None:
        return f". {text}"
    north, east = (math.floor(side * min(side / needed, 1.0)) for side, needed in zip(area.size, enough, strict=True))
    text += (
        f" An area of {enough[0]:g} m by {enough[1]:g} m is large enough for this mission: the nominal boat and "
        f"{100 * ENOUGH_INSIDE:.0f} % of the others stay in it."
    )
    if min(north, east) > 0:
        text += (
            f" If you have no more room than now, design with `--area {north}x{east}`: boats that leave that area by "
            "the same proportion stay in yours."
        )
    return f". {text}"


def _enough_area(track: PredictedTrack, area: OperationArea) -> tuple[float, float] | None:
    """Return the sides (north, east) [m] of an area about the same centre that the mission needs.

    The nominal boat and the share `ENOUGH_INSIDE` of the sampled boats stay in it. None if their motion grows without
    limit.
    """
    size = np.array(area.size)
    centre = np.array(area.corner) + size / 2.0
    nominal = np.stack([track.x, track.y], axis=1)
    away = np.abs(track.others - centre).max(axis=1)  # of each boat, to the north and east
    order = np.argsort(np.nan_to_num((away / size).max(axis=1), nan=np.inf), kind="stable")
    kept = away[order[: math.ceil(ENOUGH_INSIDE * len(order))]]
    half = np.vstack([kept, np.abs(nominal - centre).max(axis=0)]).max(axis=0)
    if not np.isfinite(half).all():
        return None
    north, east = (
        side if 2.0 * x <= side else rounded_up(2.0 * x) for side, x in zip(area.size, half.tolist(), strict=True)
    )
    return north, east


def longer_mission_advice(apart: Discrimination, duration: float) -> str:
    """Return what to do if a mission may not distinguish two effects, as a clause after a semicolon, without full stop.

    The advice is the least duration of a mission that distinguishes them, if it is at most an hour (`LONGEST_S`).
    Otherwise the text says that no mission does, and what else may.

    Parameters
    ----------
    apart : Discrimination
        Discrimination of the two effects, with the criterion T of the mission run once and twice.
    duration : float
        Duration of the mission [s].
    """
    first, second = apart.effects
    least = min(apart.if_second, apart.if_first)
    begin = f"; T should be above {RELIABLE_T:g}"
    if apart.twice is None:
        return f"{begin}: give a longer --duration"
    grown = f"the same mission run twice has a T of {format_number(apart.twice)}"
    needed, instead = reliable_duration(least, apart.twice, duration), separating_experiment(first, second)
    if needed <= LONGEST_S:
        longer = 10.0 * np.ceil(needed / 10.0)
        long = f"{begin}, and {grown}: give --duration {longer:.0f} ({longer / 60.0:.0f} min) or more"
        return f"{long}. A diagnosis recommends no mission for this pair, but this: {instead}" if instead else long
    instead = f"What distinguishes them is this: {instead}" if instead else (
        "Other conditions may: a day on which one of them is larger or absent, or a measurement of one of them"
    )  # fmt: skip
    return f"{begin}, but {grown}, so that even an hour of such missions is not enough. {instead}"


def _random_sequences_sentence(apart: Discrimination, limited: bool) -> str:
    """Return a sentence that random sequences distinguish the two effects already, with a full stop and a space before.

    It is stated if both the designed mission and the median random sequence have a reliable T. Otherwise the text is
    empty. ``limited``: whether the design had limits, which random sequences ignore.
    """
    median = float(np.median(apart.random))
    if not apart.clear or not median > RELIABLE_T:
        return ""
    ignoring = " (which ignore the limits)" if limited else ""
    return (
        f". Random sequences of the same length{ignoring} already distinguish them: T is above {RELIABLE_T:g} in "
        f"{int(np.sum(apart.random > RELIABLE_T))} of {len(apart.random)}, so that any mission with varied commands is "
        "likely to be enough"
    )


def _discrimination_lines(apart: Discrimination) -> list[str]:
    """Return a line for the size of each effect of a discrimination, and one for the probability of a wrong choice.

    A line of a size has the origin of the size.
    """
    lines = []
    for row in apart.sizes:
        errors = ["" if p.se is None else f" ± {p.se:.2g}" for p in row.parameters]
        values = [
            f"{p.name} = {format_number(p.value)}{error} {typeset_unit(p.unit)}".rstrip()
            for p, error in zip(row.parameters, errors, strict=True)
        ]
        beside = f" beside {row.beside}" * bool(row.beside)
        origin = f"fitted size{beside}" if row.origin == "fitted" else "typical size, since no fit has one"
        lines.append(f"  {row.effect} ({origin}): {', '.join(values)}")
    if apart.probability is not None:
        lines.append(f"  {apart.wrong_choice}")
    return lines


def warn_worse_than_baseline(baseline: BaselineSignal, problem: DesignProblem, criterion: str, value: float) -> str:
    """Return the sentences of a warning that a baseline signal (random sequence) is better than the design.

    The criterion of the baseline signal is larger than that of the design. The warning ends with advice.

    Parameters
    ----------
    baseline : BaselineSignal
        Best of the random sequences.
    problem : DesignProblem
        The design problem, whose limits the advice names.
    criterion : str
        Name of the criterion.
    value : float
        Criterion of the design.
    """
    limits = problem.limits
    begin = (
        "The limits cost information: a random sequence that ignores them is better than the designed mission, which "
        "keeps them"
        if limits.bind
        else "The designed mission is worse than a random sequence"
    )
    given = {"--area": limits.area, "--max-speed": limits.speed, "--energy": limits.energy}
    wider = [name for name, value in given.items() if value is not None]
    keep = (
        f" If that changes little and you need more information, give a larger {' or '.join(wider)}, or a longer "
        "--duration."
        if wider
        else " If that changes little, give other --steps or a longer --duration."
    )
    return (
        f"{begin}: the {criterion} criterion of the mission is {format_number(value)}, that of the best random "
        f"sequence (a {baseline.kind}) {format_number(baseline.value)}. "
        f"Repeat the design with twice the --evaluations.{keep}"
    )


def design_summary(result: DesignResult) -> Sequence[str]:
    """Return the lines that `seatrial mission design` prints.

    They are the warnings, the answer, a line for each parameter (value, and standard errors before and after the
    mission), the criterion beside that of the best baseline signal, and the share of simulated boats that stay inside
    the area. If two effects were discriminated, their sizes are printed, and the criterion is T. The share is left out
    if there is no limit of area.

    Parameters
    ----------
    result : DesignResult
        Result of `make_design`.
    """
    lines = [*(f"⚠ {warning.text}" for warning in result.warnings), result.answer, ""]
    if result.apart is not None:
        lines += [*_discrimination_lines(result.apart), ""]
    if result.parameters:
        lines.append("  value ± standard error before -> after this mission (after the best random sequence)")
    for p in result.parameters:
        before, after, baseline = ("–" if v is None else f"{v:.3g}" for v in (p.before, p.after, p.baseline))
        lines.append(f"  {p.name:<8} {p.value:10.4g} {typeset_unit(p.unit):<8} ± {before:>8} -> {after}   ({baseline})")
    lines.append("")
    if result.other_parameters:
        lines += [result.other_parameters, ""]
    free = ", which ignore the limits" if result.limited else ""
    best = result.value - result.margin
    gain = f"best of {result.random_sequences}{free}: {best:.1f}"
    won = ""
    if result.share_won is not None:
        share = f"{100 * result.share_won:.1f} % of 1000 parameter samples"
        won = f"; the design is better than the best PRBS and RGS{free.replace(',', '')} in {share}"
    lines.append(f"{result.criterion} {result.value:.1f}; {gain}{won}")
    track = result.track
    if track is not None and track.inside is not None:
        water = f"in a current of up to {track.current:g} m/s" if track.current else "no current assumed"
        lines.append(
            f"{100 * track.inside:.0f} % of the simulated boats stay inside the area, including {track.coasting:g} s "
            f"of coasting after the end; {water}"
        )
    return lines
