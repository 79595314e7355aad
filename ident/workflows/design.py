"""`seatrial mission design`: from a model to mission.toml, its numbers (JSON) and its page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.config import Mission, Prediction, Segment, dump_mission, parse_mission, save_new_mission
from seatrial.daq.errors import SeatrialError
from seatrial.ident.effects import catalogue
from seatrial.ident.estimation import dynamic_parameters, load_model, reported_units, simulate
from seatrial.ident.experiment_design import (
    COAST_S,
    GRID,
    N_TRACKS,
    PRIOR_HALFWIDTH,
    RATE,
    REST_S,
    BaselineSignal,
    Design,
    DesignLimits,
    DesignProblem,
    DiscriminationDesign,
    Kind,
    ParameterPrior,
    StepInput,
    ThrusterResponse,
    Track,
    baseline_signals,
    believed,
    design,
    discriminate,
    monte_carlo,
    not_commanded,
    planned_record,
    predicted_errors,
    predicted_track,
    row_spacing,
    separation,
)
from seatrial.ident.model import Model, Parameter
from seatrial.ident.models import make_model
from seatrial.ident.numerics import Array, scaled_pseudo_inverse
from seatrial.ident.report import tidy, write_design_page
from seatrial.ident.reporter import Reporter
from seatrial.ident.results import (
    Baseline,
    CommandTrace,
    DesignedParameter,
    DesignResult,
    DesignTrack,
    Discrimination,
    ResultWarning,
    design_warnings,
    finite,
    format_number,
    provenance,
    write_result,
)

N_SHOWN = 24  # sampled tracks on the page
NAMED = 3  # parameters in the answer
STEP_S = 5.0  # s, mean length of a step where --steps does not say else
BEYOND = 0.1  # of the width of a range of validity
SOME = 0.02  # of the standard deviation of a prior: an effect of less has no size that matters


@dataclass(frozen=True)
class DesignRequest:
    """What the user asks for, as the options of the command say it."""

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


def make_design(source: str, wish: DesignRequest, out: Path, command: str, reporter: Reporter) -> DesignResult:
    """Search, compare, and write ``out`` (mission.toml) with .json and .html beside it; returns what the JSON holds.

    Raises SeatrialError where the model or the wish cannot be used, before anything is written.
    """
    beside = _free_names(out)
    task = make_task(source, wish)
    own = task.actuation.thrusters
    thrusters = wish.thrusters or own
    if len(thrusters) != len(own):
        raise SeatrialError(
            f"a mission for model {task.model.name} commands {len(own)} thrusters ({', '.join(own)}); "
            f"--thrusters names {len(thrusters)}"
        )
    idle = Segment("static", np.zeros(1), np.zeros((1, len(thrusters))))
    parse_mission(dump_mission(Mission("names", "mission", tuple(thrusters), (idle,), 1.0)), "--thrusters")
    task.measure  # noqa: B018  # a wrong --parameters is said before the search
    reporter.progress(f"design: {task.steps.n_steps} steps in {task.steps.duration:g} s for {', '.join(_chosen(task))}")
    apart: Discrimination | None = None
    if wish.between:
        made, apart = _between(task, wish, reporter)
    else:
        made = design(
            task,
            evaluations=wish.evaluations,
            progress=lambda n, merit: reporter.progress(f"design: {n} simulations, {wish.criterion} {merit:.2f}"),
        )
    reporter.progress("baseline signals, Monte Carlo, track")
    found = baseline_signals(task, seed=wish.seed)
    samples = monte_carlo(task, {"design": made.command} | {k: r.command for k, r in found.items()}, seed=wish.seed)
    track = predicted_track(made)
    best = max(found, key=lambda k: found[k].value)
    fine = found[best].command[np.minimum(_rows(task), len(task.t) - 1)]
    parameters = _parameters(made, predicted_errors(task, fine))
    here = provenance([], command)
    result = DesignResult(
        created=here.created, seatrial=here.seatrial, command=here.command,
        answer=_answer(made, parameters, apart, found[best]),
        model=source, criterion=task.criterion, chosen=tuple(_chosen(task)),
        form="prediction error" if task.process_noise else "output error",
        value=made.value, evaluations=made.found.evaluations, parameters=parameters,
        baselines=tuple(Baseline(name=k, value=r.value, bandwidth=r.bandwidth, seeds=r.values)
                     for k, r in found.items()),
        baseline=best, limited=task.limits.bind, samples=dict(samples.values), share_won=samples.share_won(),
        inputs=tuple(CommandTrace(name=c, t=task.t, value=made.command[:, k])
                     for k, c in enumerate(task.actuation.channels)),
        track=None if track is None else _track(track, task.limits), apart=apart,
        rates={s.name: task.rate(s.name) for s in task.model.sensors},
        warnings=tuple(_warnings(made)),
    )  # fmt: skip
    title = " against ".join(wish.between) or f"{wish.criterion}-optimal for {', '.join(_chosen(task))}"
    mission = designed_mission(f"steps, {title}", thrusters, made, track, wish, source, command)
    parse_mission(dump_mission(mission), out)
    save_new_mission(mission, out)
    write_result(result, beside[".json"])
    write_design_page(result, beside[".html"])
    return result


def _free_names(out: Path) -> dict[str, Path]:
    """The files beside the mission, by suffix. Raises SeatrialError where one of them, or the mission, has no place."""
    if out.suffix in (".json", ".html"):
        raise SeatrialError(f"{out}: is the name of the numbers or of the page beside the mission; give a .toml")
    if not out.parent.is_dir():
        raise SeatrialError(f"{out.parent}: no such folder; the mission cannot be saved there")
    beside = {kind: out.with_suffix(kind) for kind in (".json", ".html")}
    for path in (out, *beside.values()):
        if path.exists():
            raise SeatrialError(f"{path} exists; give another name with --out")
    return beside


def _warnings(made: Design) -> list[ResultWarning]:
    """What a design rests on that nobody gave, and where it goes beyond what the model was fitted on."""
    task = made.task
    pole = None if task.actuation.shafts_are_states else task.actuation.pole
    said = design_warnings(task.model, task.actuation.full_thrust, pole)
    known = {**task.fitted_rates, **task.rates}
    if assumed := [s.name for s in task.model.sensors if s.name not in known]:
        text = (
            f"Sensors are taken to measure at {RATE:g} Hz where neither --rate nor the model.toml says else: "
            f"{', '.join(assumed)}. "
            "With slower ones a fit will know less."
        )
        said.append(ResultWarning(code="rates-assumed", text=text))
    fitted = {n: task.fitted_rates[n] for n, hz in task.rates.items() if hz > 1.05 * task.fitted_rates.get(n, hz)}
    if fitted:
        rows = ", ".join(f"{n} {hz:.3g} Hz" for n, hz in fitted.items())
        text = (
            f"--rate is above that of the rows that the model was fitted to ({rows}), whose noise it has. Of a sensor "
            "that was averaged to them each sample would count as an average: leave its --rate out."
        )
        said.append(ResultWarning(code="rates-assumed", text=text))
    if beyond := beyond_validity(made):
        text = (
            f"The mission goes beyond what the model was fitted on: {'; '.join(beyond)}. There the track and the "
            "errors are extrapolated. --n-max or --max-speed keeps it closer."
        )
        said.append(ResultWarning(code="beyond-validity", text=text))
    return said


def beyond_validity(made: Design) -> list[str]:
    """Signals of the model (inputs and states of the nominal boat) that leave the range that its data covered by more
    than ``BEYOND`` of its width, with both ranges: as those of the data, of inputs from end to end, of states without
    1 % at each end."""
    task = made.task
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
        if name not in reached:
            continue
        least, most = reached[name]
        room = BEYOND * (high - low)
        if least < low - room or most > high + room:
            there = f"{low:.2g} to {high:.2g}{units[name]}"
            found.append(f"{name} {least:.2g} to {most:.2g}{units[name]} (fitted on {there})")
    return found


def designed_mission(
    name: str,
    thrusters: Sequence[str],
    made: Design,
    track: Track | None,
    wish: DesignRequest,
    source: str,
    command: str,
) -> Mission:
    """The designed steps as a mission, after a segment at rest; numbers to the digits that a person reads."""
    levels = made.task.actuation.for_thrusters(made.levels)
    edges = np.round(REST_S + np.concatenate([[0.0], np.cumsum(made.durations)]), 3)
    segments = (
        Segment("static", np.zeros(1), np.zeros((1, len(thrusters)))),
        Segment("designed steps", significant(edges[:-1], 6), significant(levels, 6).clip(-wish.n_max, wish.n_max)),
    )
    units, model = reported_units(made.task.model), made.task.model
    factors = {name: units.factor(model.parameter(name).unit) for name in made.task.learned}
    predicted, before = (
        {k: float(f"{v * factors[k]:.4g}") for k, v in errors.items() if np.isfinite(v)}
        for errors in (made.predicted, made.before)
    )
    prediction = None
    if track is not None:
        t, x, y, radius = (
            significant(v, 6) for v in (track.t, track.x.round(2), track.y.round(2), track.radius.round(2))
        )
        prediction = Prediction(source, t, x, y, radius, before)
    return Mission(
        name,
        "mission",
        tuple(thrusters),
        segments,
        float(edges[-1]),
        n_max=wish.n_max,
        slew_per_s=wish.slew,
        made_by=command,
        seed=wish.seed,
        predicted_errors=predicted,
        prediction=prediction,
    )


def significant(values: Array, digits: int) -> Array:
    """Rounded to so many significant digits."""
    return np.array([float(f"{v:.{digits}g}") for v in values.ravel()]).reshape(values.shape)


def make_task(source: str, wish: DesignRequest) -> DesignProblem:
    """The frame of the design. ``source``: a model.toml, a name, or FILE.py:NAME.

    Raises SeatrialError where the model has no such sensor, nothing to learn, or inputs that no mission commands.
    """
    is_path = source.endswith((".toml", ".json")) or ("/" in source and Path(source).is_dir())
    saved = load_model(Path(source)) if is_path else None
    model = saved.model if saved is not None else make_model(source)
    if why := not_commanded(model):
        raise SeatrialError(f"no mission can be designed for model {model.name}: {why}")
    unknown = set(wish.rates) - {s.name for s in model.sensors}
    if unknown:
        raise SeatrialError(
            f"model {model.name} has no sensor {sorted(unknown)[0]!r}; it has "
            f"{', '.join(s.name for s in model.sensors)}"
        )
    n_channels = len(ThrusterResponse(model, np.array([0.0, 1.0])).channels)
    steps = StepInput(1, n_channels, wish.duration, wish.shortest, GRID, wish.n_max)
    n_steps = wish.steps or min(max(8, round(wish.duration / STEP_S)), max(steps.rows // steps.least, 1))
    task = DesignProblem(
        model,
        replace(steps, n_steps=n_steps),
        wish.criterion,
        wish.chosen,
        wish.rates,
        wish.limits,
        wish.slew,
        robust=wish.robust,
        process_noise=wish.process_noise,
        seed=wish.seed,
    )
    if not dynamic_parameters(model):
        raise SeatrialError(f"model {model.name} has no free parameters to learn")
    if saved is None:
        task = replace(task, belief=ParameterPrior(task.learned, wish.spread))
    else:
        belief = believed(saved)
        earlier = None if belief.covariance is None else scaled_pseudo_inverse(belief.covariance)
        task = replace(
            task, belief=belief, earlier=earlier, inflation=saved.inflation, validity=saved.validity,
            fitted_rates=saved.rates,
        )  # fmt: skip
    compared = hypotheses(model, wish.between) if wish.between else ()
    members = [(model, task.boats(N_TRACKS, 2)), *((m, np.array([list(m.values.values())])) for m in compared)]
    return replace(task, grid=row_spacing(members, GRID, wish.n_max))


def _chosen(task: DesignProblem) -> tuple[str, ...]:
    return task.chosen or task.learned


def _between(task: DesignProblem, wish: DesignRequest, reporter: Reporter) -> tuple[Design, Discrimination]:
    """The design that tells two effects apart, judged as any other, and how far apart it puts them."""
    a, b = hypotheses(task.model, wish.between)
    made: DiscriminationDesign = discriminate(
        a,
        b,
        task,
        evaluations=max(wish.evaluations // 8, 500),
        progress=lambda n, merit: reporter.progress(f"design: {n} comparisons, T {np.exp(merit):.3g}"),
    )
    told = task.information(task.actuation.inputs(made.command[:, :, None]))
    value = float(task.measure(told + task.prior)[0])
    rng = np.random.default_rng([wish.seed, 31])
    random = [task.commands(z)[:, :, 0] for z in task.steps.random(8, rng)[:, None]]
    others = [min(separation(a, b, task, c)) for c in random]
    first, second = wish.between
    row = Discrimination(
        effects=(first, second),
        if_second=made.apart[0],
        if_first=made.apart[1],
        clear=made.clear,
        random=np.array(others),
    )
    return Design(task, made.levels, made.durations, value, told[0], made.found), row


def hypotheses(model: Model, names: Sequence[str]) -> tuple[Model, Model]:
    """The two models that a discrimination compares: each has its own effect and lacks the other's, which the model may
    have. With both in one, that one would be nearly as right whichever is true.

    Raises SeatrialError where there is no such effect, or one of them can be all that the other is.
    """
    first, second = names
    for one, other in ((first, second), (second, first)):
        if one == other or (one in catalogue() and other in catalogue()[one].nests):
            raise SeatrialError(f"--discriminate: {one} can be all that {other} is: no mission tells them apart")
    return with_effect(model.without(second), first), with_effect(model.without(first), second)


def with_effect(model: Model, name: str) -> Model:
    """The model with an effect of a size that matters: as fitted where the model has it and the fit found some of it
    (``SOME`` of a prior), else half of its prior, or five characteristic steps."""
    own = next((e for e in model.effects if e.name == name), None)
    if own is None and name not in catalogue():
        raise SeatrialError(f"there is no effect {name!r}; there is {', '.join(catalogue())}")
    effect = own or catalogue()[name]
    if own is None and not model.accepts(effect):
        raise SeatrialError(f"effect {name!r} does not apply to model {model.name}")
    with_it = model if own is not None else model + effect
    # Parameters that are not zero without the effect, and the further ones of an amplitude, say where or of what shape.
    sizing = [p for p in (effect.parameters[:1] if effect.one_sided else effect.parameters) if p.value == 0.0]
    least = {p.name: SOME * p.prior[1] if p.prior is not None else p.step for p in sizing}
    if own is not None and any(abs(with_it.values[name]) >= size for name, size in least.items()):
        return with_it
    sizes = {}
    for p in effect.parameters:
        size = 0.5 * p.prior[1] if p.prior is not None else 5.0 * p.step
        sizes[p.name] = float(np.clip(p.value + size, *p.bounds))
    return with_it.with_values(sizes)


def _track(track: Track, limits: DesignLimits) -> DesignTrack:
    corner = None if track.corner is None else (float(track.corner[0]), float(track.corner[1]))
    return DesignTrack(
        t=track.t,
        x=track.x,
        y=track.y,
        radius=track.radius,
        others=tuple(track.others[:N_SHOWN]),
        inside=track.inside,
        corner=corner,
        area=limits.area,
        current=limits.current,
        rest=REST_S,
        coasting=COAST_S,
    )


def _rows(task: DesignProblem) -> NDArray[np.intp]:
    """For each row of the finer task, the row of the task that holds."""
    return np.asarray(np.searchsorted(task.t, task.finer.t + 1e-9, side="right") - 1)


def _parameters(made: Design, baseline: Mapping[str, float]) -> tuple[DesignedParameter, ...]:
    model, before, after = made.task.model, made.before, made.predicted
    chosen, units = _chosen(made.task), reported_units(model)

    def told(errors: Mapping[str, float], p: Parameter) -> float | None:
        return finite(errors[p.name] * units.factor(p.unit))

    return tuple(
        DesignedParameter(
            name=p.name, meaning=p.meaning, unit=units.scale.unit(p.unit),
            value=p.value * units.factor(p.unit), before=told(before, p), after=told(after, p),
            form=told(made.errors, p), baseline=told(baseline, p), chosen=p.name in chosen,
        )
        for p in (model.parameter(name) for name in made.task.learned)
    )  # fmt: skip


def _answer(
    made: Design, parameters: Sequence[DesignedParameter], apart: Discrimination | None, baseline: BaselineSignal
) -> str:
    """First that the design is worse than a random sequence, where it is; then what will be known."""
    if apart is not None:
        first, second = apart.effects
        least = min(apart.if_second, apart.if_first)
        verdict = "tells them apart" if apart.clear else "may not tell them apart: T should be above 30"
        return (
            f"This mission {verdict}: {first} against {second} differ by at least T = {format_number(least)} "
            f"(random missions: {format_number(float(np.median(apart.random)))})"
        )
    parts = []
    rows = [p for p in parameters if p.chosen]
    for p in rows[:NAMED]:
        after = np.inf if p.after is None else p.after
        share = abs(after / p.value) if p.value else np.inf
        of_value = f" ({100 * share:.2g} %)" if share < 1 else ""
        parts.append(f"{p.name} ±{format_number(after)} {tidy(p.unit)}{of_value}")
    more = f", and {len(rows) - NAMED} more" if len(rows) > NAMED else ""
    known = f"After this mission of {made.task.steps.duration:g} s a fit should know {', '.join(parts)}{more}"
    return known if made.value >= baseline.value else f"{worse_than(baseline, made)} {known}"


def worse_than(baseline: BaselineSignal, made: Design) -> str:
    """Return the warning that a random sequence is more informative than the design, with advice."""
    free = ", which keeps to no limits," if made.task.limits.bind else ""
    return (
        f"Worse than {baseline.kind}: its {made.task.criterion} criterion is {format_number(made.value)}, the best of "
        f"20 {baseline.kind}{free} has {format_number(baseline.value)}. Give the search more --evaluations or other "
        "--steps, a longer mission or wider limits."
    )


def design_summary(result: DesignResult) -> Sequence[str]:
    """Lines for the terminal: the answer, and a line for each parameter."""
    lines = [*(f"⚠ {warning.text}" for warning in result.warnings), result.answer, ""]
    for p in result.parameters:
        before, after, baseline = ("–" if v is None else f"{v:.3g}" for v in (p.before, p.after, p.baseline))
        lines.append(
            f"  {p.name:<8} {p.value:10.4g} {tidy(p.unit):<8} ± {before:>8} -> {after}"
            f"   ({result.baseline}: {baseline})"
        )
    lines.append("")
    if result.apart is None:
        free = " (which keep to no limits)" if result.limited else ""
        gain = f"{result.margin:+.1f} against the best of 20 {result.baseline}{free}"
        lines.append(
            f"{result.criterion} {result.value:.1f}, {gain}; better than all of them in "
            f"{100 * result.share_won:.1f} % of 1000 parameter samples"
        )
    track = result.track
    if track is not None and track.inside is not None:
        water = f"in a current of up to {track.current:g} m/s" if track.current else "no current assumed"
        lines.append(
            f"{100 * track.inside:.0f} % of disturbed boats stay inside the area, coasting for {track.coasting:g} s "
            f"after the end included; {water}"
        )
    return lines
