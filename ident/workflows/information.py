"""What ``seatrial ident information`` does: which stretches of logs already taken tell of which parameter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from daq.errors import SeatrialError
from ident.data import LoadedLog, Record, load_run, make_record
from ident.estimation import dynamic_parameters, fit, load_model, without_absent_sensors
from ident.experiment_design import InformationSegment, segment_information
from ident.model import Model
from ident.numerics import Array
from ident.report import write_report
from ident.reporter import Reporter
from ident.results import Json, envelope, format_number, input_traces, to_json
from ident.workflows.model_inputs import as_logged, completed, known_curve
from ident.workflows.output import write_result

TELLS = 1.2  # the standard error would grow by so much without a stretch: it is worth naming
VAGUE = 0.5  # standard error over value from which a parameter counts as hardly known


@dataclass(frozen=True)
class InformationRequest:
    """Logs whose information is asked for, as the options of the command say it.

    Attributes:
        model: the model.toml.
        logs: that the model was, or could be, fitted to.
        out: folder for the results.
        seconds: length of a stretch [s].
        chosen: parameters; none: all dynamic ones.
        thruster: the static curve that the model was fitted with.
        rate: rows a second to which faster sensors are averaged [Hz].
    """

    model: Path
    logs: Sequence[Path]
    out: Path
    seconds: float = 30.0
    chosen: Sequence[str] = ()
    thruster: Path | None = None
    rate: float = 10.0


def information(request: InformationRequest, command: str, reporter: Reporter) -> Json:
    """Information of every stretch of the logs about the model's dynamic parameters; ``command``: what was typed.

    The model's values are those of its file; the current and the offsets of each log are fitted to it. Raises
    SeatrialError where model and logs do not go together.
    """
    saved, seconds, out = load_model(request.model), request.seconds, request.out
    names = _names(saved.model, request.chosen, request.model)
    curve = known_curve(request.thruster)
    loaded = [completed(load_run(path, "judged"), saved.model.source, curve) for path in request.logs]
    holds = loaded[0].holds
    model = replace(saved.model, inputs=tuple(as_logged(i, holds.get(i.name, "")) for i in saved.model.inputs))
    records = [make_record(model, one.run, request.rate) for one in loaded]
    model = without_absent_sensors(model, records)
    values = []
    for rows in records:
        reporter.progress(f"{rows.name}: its own current and offsets")
        values.append(own_values(model, rows))
    reporter.progress(f"information of {sum(r.duration for r in records):.0f} s in stretches of {seconds:g} s")
    stretches = segment_information(model, records, names, seconds=seconds, values=values)
    result = envelope(loaded, command) | _content(model, names, stretches, loaded, records, seconds)
    out.mkdir(parents=True, exist_ok=True)
    content = to_json(result)
    write_result(content, out / "result.json")
    write_report(content, out / "report.html")
    return result


def _names(model: Model, chosen: Sequence[str], path: Path) -> tuple[str, ...]:
    known = dynamic_parameters(model)
    lost = [n for n in chosen if n not in known]
    if lost or not known:
        what = f"no free parameter {lost[0]!r}" if lost else "no free parameters"
        raise SeatrialError(f"{path}: {what}; there is {', '.join(known) or 'none'}")
    return tuple(chosen) or tuple(known)


def own_values(model: Model, rows: Record) -> Array:
    """The parameters (n_parameters,) in one record: those of the record alone are fitted, all others as they are."""
    own = [p.name for p in model.parameters if p.free and p.per_record]
    if not own:
        return np.array([p.value for p in model.parameters])
    return np.asarray(fit(model.with_free(own), [rows]).record_values[0])


def _content(
    model: Model, names: Sequence[str], stretches: Sequence[InformationSegment], loaded: Sequence[LoadedLog],
    records: Sequence[Record], seconds: float,
) -> Json:
    """``information`` and what goes with it; keys: docs/formats/result.md."""
    starts = {r.name: float(r.meta["t0"]) for r in records}
    segments = {one.run.name: one.segments for one in loaded}
    rows = [
        {
            "record": s.record,
            "from": s.t_from + starts[s.record],
            "to": s.t_to + starts[s.record],
            "what": _longest(segments[s.record], s.t_from + starts[s.record], s.t_to + starts[s.record]),
            "weight": s.weight,
            "lost": np.clip(1.0 - 1.0 / np.square(s.weight), 0.0, 1.0),
            "alone": s.alone,
        }
        for s in stretches
    ]
    parameters = [_parameter(model, name, k, stretches, rows) for k, name in enumerate(names)]
    return {
        "kind": "information",
        "answer": _answer(parameters, rows),
        "information": {"names": list(names), "seconds": seconds, "parameters": parameters, "stretches": rows},
        "inputs": [row | {"t": row["t"] + starts[r.name]} for r in records for row in input_traces(model, r)],
        "notes": _notes(parameters, records),
    }


def _parameter(model: Model, name: str, k: int, stretches: Sequence[InformationSegment], rows: Sequence[Json]) -> Json:
    """What all logs tell of one parameter, and the stretch that it hangs on."""
    best = max(range(len(rows)), key=lambda i: float(np.nan_to_num(stretches[i].weight[k], posinf=np.inf)))
    p = model.parameter(name)
    return {
        "name": name, "meaning": p.meaning, "unit": p.unit, "value": p.value, "se": stretches[best].whole[k],
        "record": rows[best]["record"], "from": rows[best]["from"], "to": rows[best]["to"], "what": rows[best]["what"],
        "weight": float(stretches[best].weight[k]), "alone": float(stretches[best].alone[k]),
    }  # fmt: skip


def _longest(segments: Sequence[tuple[float, str]], begin: float, end: float) -> str:
    """The step of the mission that takes up most of a stretch; empty where the log names none."""
    length: dict[str, float] = {}
    ends = [t for t, _ in segments[1:]] + [np.inf]
    for (t, name), until in zip(segments, ends, strict=False):
        length[name] = length.get(name, 0.0) + max(min(until, end) - max(t, begin), 0.0)
    best = max(length, key=lambda name: length[name], default="")
    return best if length.get(best, 0.0) > 0 else ""


def _place(row: Mapping[str, object]) -> str:
    words = f"{row['record']}, {row['from']:.0f} to {row['to']:.0f} s"
    return f"{words} ({row['what']})" if row["what"] else words


def _answer(parameters: Sequence[Json], rows: Sequence[Json]) -> str:
    """One sentence or two: the stretch that matters most, and what is hardly known."""
    known = [p for p in parameters if np.isfinite(p["se"])]
    if not known:
        return "These logs tell nothing of any parameter."
    first = max(known, key=lambda p: float(p["weight"]))
    if len(rows) == 1:
        words = "There is but one stretch; give more logs, or shorter stretches with --seconds"
    elif not np.isfinite(first["weight"]):
        words = f"Only {_place(first)} tells of {first['name']}"
    elif first["weight"] >= TELLS:
        words = (f"Most hangs on {_place(first)}: without it the standard error of {first['name']} would be "
                 f"{format_number(first['weight'])} times as large")
    else:
        words = "No stretch matters much more than the others: what is known is spread evenly over the logs"
    vague = [p["name"] for p in parameters if not _is_known(p)]
    return f"{words}. Hardly known from all of it: {', '.join(vague)}." if vague else f"{words}."


def _is_known(p: Json) -> bool:
    return bool(np.isfinite(p["se"]) and (p["value"] == 0 or abs(p["se"]) < VAGUE * abs(p["value"])))


def _notes(parameters: Sequence[Json], records: Sequence[Record]) -> list[str]:
    notes = [f"{r.name}: not in the log, so done without: {', '.join(missing)}." for r in records
             if (missing := r.meta.get("missing", ()))]
    notes += [f"{p['name']}: nothing in these logs tells of it." for p in parameters if not np.isfinite(p["se"])]
    vague = ",".join(p["name"] for p in parameters if not _is_known(p))
    if vague:
        notes.append(f"The mission that tells most of what is hardly known: seatrial mission design MODEL "
                     f"--criterion Ds --parameters {vague}")
    return notes
