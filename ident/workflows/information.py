"""What ``seatrial ident information`` does: which segments of logs already taken tell of which parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.ident.data import WHOLE, LoadedLog, Record, TimeWindow, load_runs, make_record
from seatrial.ident.estimation import (
    dynamic_parameters,
    fit,
    load_model,
    reported_units,
    scale_of,
    without_absent_sensors,
)
from seatrial.ident.experiment_design import (
    InformationSegment,
    characteristic_steps,
    not_commanded,
    segment_information,
)
from seatrial.ident.model import Model
from seatrial.ident.numerics import Array
from seatrial.ident.report import write_report
from seatrial.ident.reporter import Reporter
from seatrial.ident.results import (
    Information,
    InformationResult,
    InformedParameter,
    LogSpan,
    SegmentInformation,
    finite,
    format_number,
    provenance,
    record_inputs,
    scale_warnings,
    write_result,
)
from seatrial.ident.workflows.model_inputs import as_logged, completed, known_curve, saved_frame_warnings

TELLS = 1.2  # the standard error would grow by so much without a segment: it is worth naming
VAGUE = 0.5  # standard error over value from which a parameter counts as hardly known; of a value of 0,
STEPS = 5.0  # over its prior's standard deviation or so many of its characteristic steps


@dataclass(frozen=True)
class InformationRequest:
    """Logs whose information is asked for, as the options of the command say it.

    Attributes:
        model: the model.toml.
        logs: that the model was, or could be, fitted to.
        out: folder for the results.
        seconds: length of a segment [s].
        chosen: parameters; none: all dynamic ones.
        thruster: the static curve that the model was fitted with.
        rate: rows a second to which faster sensors are averaged [Hz].
        window: of the logs.
    """

    model: Path
    logs: Sequence[Path]
    out: Path
    seconds: float = 30.0
    chosen: Sequence[str] = ()
    thruster: Path | None = None
    rate: float = 10.0
    window: TimeWindow = WHOLE


def information(request: InformationRequest, command: str, reporter: Reporter) -> InformationResult:
    """Information of every segment of the logs about the model's dynamic parameters; ``command``: what was typed.

    The model's values are those of its file; the current and the offsets of each log are fitted to it. Raises
    SeatrialError where model and logs do not go together.
    """
    saved, seconds, out = load_model(request.model), request.seconds, request.out
    names = _names(saved.model, request.chosen, request.model)
    curve = known_curve(request.thruster)
    logs = load_runs(request.logs, "judged", request.window, saved.origin)
    assumed = saved_frame_warnings(saved.model, logs, saved.origin)
    loaded = [completed(one, saved.model.source, curve) for one in logs]
    model = as_logged(saved.model, loaded[0].holds)
    records = [make_record(model, one.run, request.rate) for one in loaded]
    model = without_absent_sensors(model, records)
    values = []
    for rows in records:
        reporter.progress(f"{rows.name}: its own current and offsets")
        values.append(own_values(model, rows))
    reporter.progress(f"information of {sum(r.duration for r in records):.0f} s in segments of {seconds:g} s")
    segments = segment_information(model, records, names, seconds=seconds, values=values, inflation=saved.inflation)
    found = _rows(segments, loaded, records)
    parameters = tuple(_parameter(model, name, k, segments, found) for k, name in enumerate(names))
    made = provenance(loaded, command)
    result = InformationResult(
        created=made.created,
        seatrial=made.seatrial,
        command=made.command,
        logs=made.logs,
        answer=_answer(parameters, len(found)),
        information=Information(names=names, seconds=seconds, parameters=parameters, segments=found),
        inputs=tuple(
            msgspec.structs.replace(row, t=row.t + float(r.meta["t0"]))
            for r in records
            for row in record_inputs(model, r)
        ),
        warnings=(*scale_warnings(scale_of(saved.model)), *assumed),
        notes=tuple(_notes(parameters, records, model)),
    )
    out.mkdir(parents=True, exist_ok=True)
    write_result(result, out / "result.json")
    write_report(result, out / "report.html")
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


def _rows(
    segments: Sequence[InformationSegment], loaded: Sequence[LoadedLog], records: Sequence[Record]
) -> tuple[SegmentInformation, ...]:
    """Over the times of the logs, with the steps of their missions."""
    starts = {r.name: float(r.meta["t0"]) for r in records}
    steps = {one.run.name: one.segments for one in loaded}
    found = []
    for s in segments:
        begin, end = s.t_from + starts[s.record], s.t_to + starts[s.record]
        lost = np.clip(1.0 - 1.0 / np.square(s.weight), 0.0, 1.0)
        found.append(
            SegmentInformation(
                record=s.record,
                t_from=begin,
                t_to=end,
                what=_longest(steps[s.record], begin, end),
                weight=s.weight,
                lost=lost,
                alone=s.alone,
            )
        )
    return tuple(found)


def _parameter(
    model: Model, name: str, k: int, segments: Sequence[InformationSegment], rows: Sequence[SegmentInformation]
) -> InformedParameter:
    """What all logs tell of one parameter, and the segment that it hangs on."""
    best = max(range(len(rows)), key=lambda i: float(np.nan_to_num(segments[i].weight[k], posinf=np.inf)))
    p, row, units = model.parameter(name), rows[best], reported_units(model)
    factor, se = units.factor(p.unit), float(segments[best].whole[k])
    size = abs(p.value) or (p.prior[1] if p.prior else STEPS * float(characteristic_steps(model, (name,))[0]))
    return InformedParameter(
        record=row.record,
        t_from=row.t_from,
        t_to=row.t_to,
        what=row.what,
        name=name,
        meaning=p.meaning,
        unit=units.scale.unit(p.unit),
        value=factor * p.value,
        se=finite(factor * se),
        weight=finite(segments[best].weight[k]),
        alone=finite(factor * segments[best].alone[k]),
        known=se < VAGUE * size,
    )


def _longest(segments: Sequence[tuple[float, str]], begin: float, end: float) -> str:
    """The step of the mission that takes up most of a segment; empty where the log names none."""
    length: dict[str, float] = {}
    ends = [t for t, _ in segments[1:]] + [np.inf]
    for (t, name), until in zip(segments, ends, strict=False):
        length[name] = length.get(name, 0.0) + max(min(until, end) - max(t, begin), 0.0)
    best = max(length, key=lambda name: length[name], default="")
    return best if length.get(best, 0.0) > 0 else ""


def _place(row: LogSpan) -> str:
    words = f"{row.record}, {row.t_from:.0f} to {row.t_to:.0f} s"
    return f"{words} ({row.what})" if row.what else words


def _answer(parameters: Sequence[InformedParameter], n_segments: int) -> str:
    """One sentence or two: the segment that matters most, and what is hardly known."""
    known = [p for p in parameters if p.se is not None]
    if not known:
        return "These logs tell nothing of any parameter."
    first = max(known, key=lambda p: np.inf if p.weight is None else p.weight)
    if n_segments == 1:
        words = "There is but one segment; give more logs, or shorter segments with --seconds"
    elif first.weight is None:
        words = f"Only {_place(first)} tells of {first.name}"
    elif first.weight >= TELLS:
        words = (
            f"Most hangs on {_place(first)}: without it the standard error of {first.name} would be "
            f"{format_number(first.weight)} times as large"
        )
    else:
        words = "No segment matters much more than the others: what is known is spread evenly over the logs"
    vague = [p.name for p in parameters if not p.known]
    return f"{words}. Hardly known from all of it: {', '.join(vague)}." if vague else f"{words}."


def _notes(parameters: Sequence[InformedParameter], records: Sequence[Record], model: Model) -> list[str]:
    notes = [
        f"{r.name}: not in the log, so done without: {', '.join(missing)}."
        for r in records
        if (missing := r.meta.get("missing", ()))
    ]
    notes += [f"{p.name}: nothing in these logs tells of it." for p in parameters if p.se is None]
    vague = ",".join(p.name for p in parameters if not p.known)
    if vague and not not_commanded(model):
        notes.append(
            "The mission that tells most of what is hardly known: seatrial mission design MODEL "
            f"--criterion Ds --parameters {vague}"
        )
    return notes
