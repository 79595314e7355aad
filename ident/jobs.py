"""What the ident commands do: logs in; model.toml, result.json and report.html out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from daq.errors import SeatrialError
from daq.log import Log, open_log
from ident.channels import channels
from ident.dataset import Channel
from ident.diagnose import diagnose, spans
from ident.diagnosis_result import Judged, diagnosis_result, judged_alone
from ident.fit import Fit
from ident.model import Input, Model
from ident.modelfile import load_model, save_model
from ident.models import make_model
from ident.models.horizontal import SENSORS, SIDES
from ident.outcome import Json, fit_part, plain, residual_part, write_result
from ident.params import Parameter
from ident.report import write_report
from ident.sides import check_sides, swap
from ident.stage import Run, Stage, first_stage

Say = Callable[[str], None]


@dataclass(frozen=True)
class Loaded:
    """A log in memory: its signals, and what the report says of it."""

    run: Run
    about: Json
    holds: Mapping[str, str]
    rig: Any


def load_run(path: Path, role: str, t_from: float | None = None, t_to: float | None = None) -> Loaded:
    """Times ``t_from`` and ``t_to`` count from the start of the log."""
    with open_log(path) as log:
        found = channels(log)
        rig = log.rig()
        if not found:
            raise SeatrialError(f"{path}: no signal that ident knows; see what it holds with `seatrial info {path}`")
        start = min(c.t[0] for c in found.values())
        moved = {n: Channel(c.t - start, c.value, c.unit, c.source) for n, c in found.items()}
        about = {
            "path": path.name,
            "sha256": log.sha256,
            "role": role,
            "name": path.stem,
            "duration": log.duration,
            "rig": rig.name if rig else None,
            "mission": _mission_name(log),
            "warnings": list(log.warnings),
        }
        holds = {n: _hold(log, n) for n in found}
        return Loaded(Run(path.stem, moved, t_from, t_to), about, holds, rig)


def _hold(log: Log, name: str) -> str:
    try:
        return str(log.hold(name))
    except (KeyError, SeatrialError):
        return ""


def _mission_name(log: Log) -> str | None:
    import tomllib

    text = log.attachments.get("mission.toml")
    if text is None:
        return None
    try:
        return str(tomllib.loads(text.decode()).get("name"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError):
        return None


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
    return replace(model, inputs=tuple(_as_logged(i, loaded[0].holds.get(i.name, "")) for i in model.inputs))


def _as_logged(signal: Input, hold: str) -> Input:
    if hold == "zero":
        return replace(signal, hold="zero")
    return replace(signal, hold="linear") if hold == "linear" else signal


def with_known(model: Model, rig: Any, thruster: Path | None, given: Mapping[str, float]) -> Model:
    """Parameters that are known before: from the rig, from the bench, from the command line (fixed)."""
    known: dict[str, Parameter] = {}
    if rig is not None:
        values = {n: v for n, v in rig.vehicle.items() if n in model.values}
        model = model.with_values(values)
        for t in rig.thrusters:
            if f"y_{t.name}" in model.values and t.name in SIDES:
                known[f"y_{t.name}"] = model.parameter(f"y_{t.name}").at(t.position_m[1]).fixed()
    if thruster is not None:
        bench = load_model(thruster).model
        for name in ("c1", "c2"):
            if name in model.values:
                known[name] = model.parameter(name).at(bench.parameter(name).value).fixed()
    for name, value in given.items():
        if name not in model.values:
            raise SeatrialError(
                f"--fix {name}: model {model.name} has no such parameter; it has {', '.join(model.values)}"
            )
        known[name] = model.parameter(name).at(value).fixed()
    return model.replace_parameters(*known.values())


def vehicle(
    logs: Sequence[Path],
    validate: Sequence[Path],
    out: Path,
    *,
    source: str,
    thruster: Path | None,
    fix: Mapping[str, float],
    begin: Mapping[str, float],
    as_is: bool,
    rate: float,
    command: str,
    say: Say,
) -> Json:
    """Fit a vehicle model and judge it on the validation logs."""
    loaded, unseen = _load(logs, validate)
    model = choose_model(source, [*loaded, *unseen])
    unknown = set(begin) - set(model.values)
    if unknown:
        raise SeatrialError(f"--start {sorted(unknown)[0]}: model {model.name} has {', '.join(model.values)}")
    model = with_known(model.with_values(begin), loaded[0].rig, thruster, fix)
    sides = check_sides([(x.run.name, x.run.channels) for x in loaded]) if "y_left" in model.values else None
    swapped = sides is not None and sides.swapped and not as_is
    if swapped:
        model = swap(model)
    start = model.values
    stage = first_stage(model, [x.run for x in loaded], [x.run for x in unseen], rate=rate, progress=say)
    judged = Judged(stage)
    result = (
        envelope([*loaded, *unseen], command)
        | judged_alone(judged)
        | {"kind": "vehicle", "fit": fit_part(stage.fit, start)}
    )
    result |= _residuals(stage)
    result["answer"] = _vehicle_answer(result)
    if sides is not None and sides.swapped:
        line = sides.line if swapped else sides.line.removesuffix(" Fitted with the sides swapped.")
        say(line)
        result["answer"] = f"{line} {result['answer']}"
    write_all(out, result, stage.fit, validity(stage))
    return result


def diagnosis(
    model_path: Path,
    logs: Sequence[Path],
    validate: Sequence[Path],
    out: Path,
    *,
    rate: float,
    max_effects: int,
    command: str,
    say: Say,
) -> Json:
    """Find what the model lacks, and write the model that has it."""
    loaded, unseen = _load(logs, validate)
    saved = load_model(model_path)
    present = [
        n
        for n, s in SENSORS.items()
        if any(all(o.name in x.run.channels for o in s.outputs) for x in [*loaded, *unseen])
    ]
    lost = [s.name for s in saved.model.sensors if s.name in SENSORS and s.name not in present]
    if len(lost) == len(saved.model.sensors):
        raise SeatrialError(f"{logs[0]}: none of the sensors of {model_path} is in the log: {', '.join(lost)}")
    found = diagnose(
        saved.model, [x.run for x in loaded], [x.run for x in unseen], rate=rate, max_effects=max_effects, progress=say
    )
    result = envelope([*loaded, *unseen], command) | diagnosis_result(found)
    write_all(out, result, found.after.fit, validity(found.after), spans(found))
    return result


def _load(logs: Sequence[Path], validate: Sequence[Path]) -> tuple[list[Loaded], list[Loaded]]:
    same = {p.resolve() for p in logs} & {p.resolve() for p in validate}
    if same:
        raise SeatrialError(f"{sorted(same)[0].name}: the same log to fit and to validate proves nothing; give another")
    return [load_run(p, "estimation") for p in logs], [load_run(p, "validation") for p in validate]


def envelope(loaded: Sequence[Loaded], command: str) -> Json:
    """What every result says of where it came from."""
    return {
        "format": "seatrial-result 1",
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "seatrial": version("seatrial"),
        "command": command,
        "logs": [x.about for x in loaded],
    }


def _residuals(stage: Stage) -> Json:
    residuals: list[Json] = []
    cross: list[Json] = []
    for view in stage.estimation:
        r, c = residual_part(stage.model, view.record, view.run.standardised)
        residuals, cross = residuals + r, cross + c
    return {"residuals": residuals, "cross": cross}


def _vehicle_answer(result: Json) -> str:
    roles = result["before_after"]
    role = "validation" if "validation" in roles else "estimation"
    rows = roles[role]["ten_seconds"]
    words = {"x": "position", "vx": "velocity", "psi": "heading", "u": "surge speed", "r": "yaw rate"}
    said = []
    for name, word in words.items():
        if name in rows:
            degrees = rows[name]["unit"].startswith("rad")
            value, unit = rows[name]["after"], rows[name]["unit"].replace("rad", "deg")
            said.append(f"{word} {value * 180 / np.pi if degrees else value:.2g} {unit}")
    correlated = sorted({c["input"] for c in result["cross"] if c["p"] is not None and c["p"] < 1e-3})
    coloured = sorted({r["channel"] for r in result["residuals"] if not r["white"]})
    end = "The residuals are white and know nothing of the inputs"
    if correlated or coloured:
        end = "The residuals still know the inputs" if correlated else "The residuals are not white"
        end += ": run `seatrial ident diagnose` to find what is missing"
    return f"Ten seconds ahead on {role} data the model errs by {', '.join(said)} (rms). {end}."


def write_all(
    out: Path,
    result: Json,
    fit: Fit,
    ranges: Mapping[str, tuple[float, float]],
    spans: Mapping[str, tuple[float, float]] | None = None,
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
    save_model(out / "model.toml", fit, validity=ranges, provenance=provenance, spans=spans)
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
    for j, signal in enumerate(stage.model.inputs):
        if "~" not in signal.name and signal.name not in ("t", "work"):
            z = np.concatenate([v.record.u[:, j] for v in views])
            found[signal.name] = (float(z.min()), float(z.max()))
    return found
