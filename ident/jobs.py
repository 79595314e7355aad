"""What the ident commands do: logs in; model.toml, result.json and report.html out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from daq.errors import SeatrialError
from ident import bench_runs
from ident.agreement import agreement, agreement_part, sentence
from ident.cautions import cautions
from ident.curve_file import load_curve
from ident.diagnose import diagnose
from ident.diagnosis_result import diagnosis_result
from ident.effects import catalogue
from ident.fit import Fit
from ident.given import with_effects, with_known, with_priors, with_rig, with_start
from ident.job_inputs import CURVE_INPUTS, completed, known_curve
from ident.judged import Judged, calibration_notes, judged_alone
from ident.loading import Loaded, check_ahead, envelope, load_all
from ident.model import Input, Model
from ident.modelfile import load_model, save_model
from ident.models import make_model
from ident.models.horizontal import SENSORS
from ident.outcome import Json, fit_part, plain, shown_inputs, write_result
from ident.own import own_effects, tried
from ident.profile import check_names, profile, profile_part
from ident.report import write_report
from ident.robust import robust as with_outliers
from ident.sides import check_sides, swap
from ident.stage import Run, Stage, first_stage, nominal, outliers
from ident.vehicle_answer import vehicle_answer

Say = Callable[[str], None]


def choose_model(source: str, loaded: Sequence[Loaded]) -> Model:
    """``auto`` takes the horizontal model with the inputs that the logs have, and the sensors that any log has."""
    names = set.intersection(*[set(item.run.channels) for item in loaded])
    anywhere = set.union(*[set(item.run.channels) for item in loaded])
    if source == "auto":
        options = {"shaft": {"n_left", "n_right"}, "force": {"f_left", "f_right"}, "general": {"X", "N"}}
        fitting = [kind for kind, wanted in options.items() if wanted <= names]
        if not fitting:
            raise SeatrialError(
                f"{loaded[0].about['path']}: no inputs for the horizontal model (n_left and n_right, or f_left and "
                f"f_right, or X and N); the log has {', '.join(sorted(names))}"
            )
        source = f"horizontal:{fitting[0]}"
    sensors = [n for n, s in SENSORS.items() if all(o.name in anywhere for o in s.outputs)]
    model = make_model(source, sensors)
    return replace(model, inputs=tuple(as_logged(i, loaded[0].holds.get(i.name, "")) for i in model.inputs))


def as_logged(signal: Input, hold: str) -> Input:
    if hold == "zero":
        return replace(signal, hold="zero")
    return replace(signal, hold="linear") if hold == "linear" else signal


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
    model, notes = with_rig(choose_model(source, [*loaded, *unseen]), loaded[0].rig)
    for note in notes:
        say(note)
    model = with_start(with_priors(with_effects(model, effects), prior or {}), begin)
    model = with_known(model, thruster, fix)
    model = replace(model, second_order=second_order)
    sides = check_sides([(x.run.name, x.run.channels) for x in loaded]) if "y_left" in model.values else None
    model = swap(model) if sides is not None and sides.swapped and not as_is else model
    check_names(nominal(model), profiles)
    runs, others = [x.run for x in loaded], [x.run for x in unseen]
    stage = first_stage(model, runs, others, rate=rate, robust=robust, restricted=restricted, progress=say)
    result = envelope([*loaded, *unseen], command) | judged_alone(Judged(stage, horizon))
    result |= {"kind": "vehicle", "fit": fit_part(stage.fit, model.values)}
    result["cautions"] = cautions(stage.fit, [v.record for v in stage.estimation])
    result["notes"] = notes + outliers(stage) + calibration_notes(result["calibration"], result["horizon"])
    said = [vehicle_answer(result, searchable="hull" in model.provides)]
    if sides is not None and sides.swapped:
        said.insert(0, sides.line if not as_is else sides.line.removesuffix(" Fitted with the sides swapped."))
        say(said[0])
    more, sentences = _asked(stage, profiles, agree)
    result |= more | {"answer": " ".join(said + sentences)}
    write_all(out, result, stage.fit, validity(stage))
    return result


def _asked(stage: Stage, profiles: Sequence[str], agree: Sequence[str]) -> tuple[Json, list[str]]:
    """Profile likelihoods and tests of agreement: their parts of the result, and sentences for the answer."""
    records = [v.record for v in stage.estimation]
    part: Json = {"profiles": [profile_part(profile(stage.fit, records, n)) for n in profiles]} if profiles else {}
    found = [agreement(stage.fit, records, name) for name in agree]
    if found:
        part["agreement"] = [agreement_part(a) for a in found]
    return part, [sentence(a) for a in found]


def diagnosis(
    model_path: Path,
    logs: Sequence[Path],
    validate: Sequence[Path],
    out: Path,
    *,
    rate: float | None = None,
    max_effects: int,
    effects_file: Path | None,
    thruster: str | None = None,
    robust: bool = False,
    horizon: float | None = None,
    command: str,
    say: Say,
) -> Json:
    """Find what the model lacks, and write the model that has it.

    ``effects_file``: candidates of the user's own; ``thruster``: the static curve's file that a vehicle's model was
    fitted with, or which one, where the model is a thruster's and the log has several; ``robust``: allow outliers;
    ``rate``: 10 rows a second by default, 50 on the bench; ``horizon``: s ahead that predictions are judged, 10 by
    default, 1 on the bench (the search does not look at it).
    """
    loaded, unseen = load_all(logs, validate)
    check_ahead(horizon, loaded, unseen)
    own = own_effects(effects_file) if effects_file else {}
    saved = load_model(model_path)
    # Maxima of the plain likelihood are compared, by a filter of first order: neither changes what is found, and on
    # that the blind tests were made.
    plain = replace(saved.model, second_order=False)
    model, runs, others, usual = _posed(plain, model_path, loaded, unseen, thruster)
    for effect in own.values():
        if effects_file is not None and model.accepts(effect):
            tried(model + effect, effects_file)
    found = diagnose(
        with_outliers(model) if robust else model,
        runs,
        others,
        effects=catalogue() | own,
        rate=rate or usual,
        max_effects=max_effects,
        progress=say,
    )
    result = envelope([*loaded, *unseen], command) | diagnosis_result(found, horizon)
    if result["next_experiment"]:
        result["next_experiment"] = result["next_experiment"].replace("MODEL", str(model_path))
    result["notes"] = outliers(found.after) + result["notes"]
    result["cautions"] = cautions(found.after.fit, [v.record for v in found.after.estimation])
    write_all(out, result, found.after.fit, validity(found.after), effects_file or saved.effects_file)
    return result


def _posed(
    model: Model, model_path: Path, loaded: Sequence[Loaded], unseen: Sequence[Loaded], thruster: str | None
) -> tuple[Model, list[Run], list[Run], float]:
    """The saved model as these logs can ask it; its runs to estimate and to validate; its usual rows a second."""
    if "bench" in model.provides:
        runs, others = (bench_runs.thruster_runs(part, model, thruster) for part in (loaded, unseen))
        return model, runs, others, bench_runs.RATE
    curve = known_curve(_curve_path(thruster, model_path))
    loaded, unseen = ([completed(x, model.source, curve) for x in part] for part in (loaded, unseen))
    model = _sensed(_pushed(model, model_path, loaded, unseen), model_path, loaded, unseen)
    return model, [x.run for x in loaded], [x.run for x in unseen], 10.0


def _curve_path(thruster: str | None, model: Path) -> Path | None:
    if thruster is None:
        return None
    if not Path(thruster).is_file():
        raise SeatrialError(
            f"--thruster {thruster}: no such file; {model} is a boat's model, so give the static curve of its thrusters"
        )
    return Path(thruster)


def _pushed(model: Model, path: Path, loaded: Sequence[Loaded], unseen: Sequence[Loaded]) -> Model:
    """The model, whose thrust all logs have; SeatrialError where one lacks what a static curve would give."""
    thrusts = [i.name for i in model.inputs if i.name in CURVE_INPUTS]
    for one in (*loaded, *unseen):
        lost = [n for n in thrusts if n not in one.run.channels]
        if lost:
            raise SeatrialError(
                f"{one.about['path']}: no signal for the input {lost[0]!r} of {path}; where that was fitted with a "
                "static thrust curve, give it with --thruster CURVE"
            )
    return model


def _sensed(model: Model, path: Path, loaded: Sequence[Loaded], unseen: Sequence[Loaded]) -> Model:
    """A vehicle's model with its inputs held as in the logs; SeatrialError where they have none of its sensors."""
    logs = [*loaded, *unseen]
    present = [n for n, s in SENSORS.items() if any(all(o.name in x.run.channels for o in s.outputs) for x in logs)]
    lost = [s.name for s in model.sensors if s.name in SENSORS and s.name not in present]
    if len(lost) == len(model.sensors):
        raise SeatrialError(
            f"{loaded[0].about['path']}: none of the sensors of {path} is in the log: {', '.join(lost)}"
        )
    return replace(model, inputs=tuple(as_logged(i, loaded[0].holds.get(i.name, "")) for i in model.inputs))


def write_all(
    out: Path,
    result: Json,
    fit: Fit,
    ranges: Mapping[str, tuple[float, float]],
    effects_file: Path | None = None,
) -> None:
    """model.toml, result.json and report.html into a folder."""
    out.mkdir(parents=True, exist_ok=True)
    logs = [f"{x['path']} sha256:{x['sha256'][:16]}" for x in result["logs"] if x["role"] == "estimation"]
    provenance = {
        "made_by": result["command"],
        "created": result["created"],
        "seatrial": result["seatrial"],
        "logs": logs,
    }
    save_model(out / "model.toml", fit, validity=ranges, provenance=provenance, effects_file=effects_file)
    content = plain(result)
    write_result(content, out / "result.json")
    write_report(content, out / "report.html")


def validity(stage: Stage) -> dict[str, tuple[float, float]]:
    """Ranges of the states and inputs that the estimation data covered (1 % to 99 %)."""
    found: dict[str, tuple[float, float]] = {}
    views = stage.estimation
    for i, state in enumerate(stage.model.states):
        if state.name in ("u", "v", "r"):
            z = np.concatenate([v.run.x_filt[:, i] for v in views])
            found[state.name] = (float(np.percentile(z, 1)), float(np.percentile(z, 99)))
    for j, name, _ in shown_inputs(stage.model):
        z = np.concatenate([v.record.u[:, j] for v in views])
        found.setdefault(name, (float(z.min()), float(z.max())))  # a yaw rate that is an input, too, is the state's
    return found
