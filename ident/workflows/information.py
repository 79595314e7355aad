"""Workflow of `seatrial ident information`: Fisher information of log segments about the parameters of a model."""

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
    thrust_scale_of,
    without_absent_sensors,
)
from seatrial.ident.experiment_design import (
    InformationSegment,
    characteristic_steps,
    reason_without_mission,
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
from seatrial.ident.workflows.model_inputs import as_logged, known_curve, saved_frame_warnings, with_derived_signals

NOTABLE_GROWTH = 1.2  # the answer names a segment if a standard error would grow by this factor without it
LARGE_ERROR = 0.5  # standard error / value from which a parameter is poorly known
# If the value is 0, the divisor is the standard deviation of the prior. Without a prior, it is so many characteristic
# steps:
ZERO_VALUE_STEPS = 5.0


@dataclass(frozen=True)
class InformationRequest:
    """Options of an information analysis.

    Attributes
    ----------
    model
        The model.toml.
    logs
        Logs that the model was, or could be, fitted to.
    out
        Folder for the results.
    seconds
        Length of a segment [s].
    chosen
        Parameters to analyse; empty: all dynamic parameters.
    thruster
        Static curve that the model was fitted with.
    rate
        Rate of the rows [Hz] over which faster sensors are averaged.
    window
        Interval of the logs to use.
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
    """Compute the information of each segment of the logs about the model's parameters, and write the results.

    The parameters have the values of the model file, except that per-record parameters (current, biases) are fitted to
    each log.

    Parameters
    ----------
    command : str
        Command line, for the provenance.

    Raises
    ------
    SeatrialError
        If model and logs do not go together.
    """
    saved, seconds, out = load_model(request.model), request.seconds, request.out
    names = _names(saved.model, request.chosen, request.model)
    curve = known_curve(request.thruster)
    logs = load_runs(request.logs, "judged", request.window, saved.origin)
    assumed = saved_frame_warnings(saved.model, logs, saved.origin)
    loaded = [with_derived_signals(log, saved.model.source, curve) for log in logs]
    model = as_logged(saved.model, loaded[0].holds)
    records = [make_record(model, log.run, request.rate) for log in loaded]
    model = without_absent_sensors(model, records)
    values = []
    for rows in records:
        reporter.progress(f"{rows.name}: fitting its current and biases")
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
        warnings=(*scale_warnings(thrust_scale_of(saved.model)), *assumed),
        notes=tuple(_notes(parameters, records, model)),
    )
    out.mkdir(parents=True, exist_ok=True)
    write_result(result, out / "result.json")
    write_report(result, out / "report.html")
    return result


def _names(model: Model, chosen: Sequence[str], path: Path) -> tuple[str, ...]:
    """Return the parameters to analyse. Raise SeatrialError if one of them is not free in the model."""
    free = dynamic_parameters(model)
    lost = [n for n in chosen if n not in free]
    if lost or not free:
        missing = f"no free parameter {lost[0]!r}" if lost else "no free parameters"
        raise SeatrialError(f"{path}: {missing}; there is {', '.join(free) or 'none'}")
    return tuple(chosen) or tuple(free)


def own_values(model: Model, rows: Record) -> Array:
    """Return the parameters (n_parameters,) of a record: per-record parameters are fitted, the others are unchanged."""
    own = [p.name for p in model.parameters if p.free and p.per_record]
    if not own:
        return np.array([p.value for p in model.parameters])
    return np.asarray(fit(model.with_free(own), [rows]).record_values[0])


def _rows(
    segments: Sequence[InformationSegment], loaded: Sequence[LoadedLog], records: Sequence[Record]
) -> tuple[SegmentInformation, ...]:
    """Return the table of segments, with times of the logs and the steps of their missions."""
    starts = {r.name: float(r.meta["t0"]) for r in records}
    steps = {log.run.name: log.segments for log in loaded}
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
    """Return the information about one parameter, with the segment that contributes most."""
    best = max(range(len(rows)), key=lambda i: float(np.nan_to_num(segments[i].weight[k], posinf=np.inf)))
    p, row, units = model.parameter(name), rows[best], reported_units(model)
    factor, se = units.factor(p.unit), float(segments[best].whole[k])
    size = abs(p.value) or (
        p.prior[1] if p.prior else ZERO_VALUE_STEPS * float(characteristic_steps(model, (name,))[0])
    )
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
        known=se < LARGE_ERROR * size,
    )


def _longest(segments: Sequence[tuple[float, str]], begin: float, end: float) -> str:
    """Return the step of the mission that takes up most of a segment; empty if the log has no steps."""
    length: dict[str, float] = {}
    ends = [t for t, _ in segments[1:]] + [np.inf]
    for (t, name), until in zip(segments, ends, strict=False):
        length[name] = length.get(name, 0.0) + max(min(until, end) - max(t, begin), 0.0)
    best = max(length, key=lambda name: length[name], default="")
    return best if length.get(best, 0.0) > 0 else ""


def _place(row: LogSpan) -> str:
    """Return log, time and step of a segment, for a sentence."""
    words = f"{row.record}, {row.t_from:.0f} to {row.t_to:.0f} s"
    return f"{words} ({row.what})" if row.what else words


def _answer(parameters: Sequence[InformedParameter], n_segments: int) -> str:
    """Return one or two sentences: the most informative segment, and the poorly known parameters."""
    known = [p for p in parameters if p.se is not None]
    if not known:
        return "These logs contain no information about any parameter."
    first = max(known, key=lambda p: np.inf if p.weight is None else p.weight)
    if n_segments == 1:
        words = "There is only one segment; give more logs, or shorter segments with --seconds"
    elif first.weight is None:
        words = f"Only {_place(first)} informs {first.name}"
    elif first.weight >= NOTABLE_GROWTH:
        words = (
            f"The most informative segment is {_place(first)}: without it the standard error of {first.name} would be "
            f"{format_number(first.weight)} times as large"
        )
    else:
        words = "No segment matters much more than the others: the information is spread evenly over the logs"
    poor = [p.name for p in parameters if not p.known]
    return f"{words}. Poorly known from all logs together: {', '.join(poor)}." if poor else f"{words}."


def _notes(parameters: Sequence[InformedParameter], records: Sequence[Record], model: Model) -> list[str]:
    """Return notes on missing sensors, parameters without information, and the mission that would inform them."""
    notes = [
        f"{r.name}: not in the log and therefore not used: {', '.join(missing)}."
        for r in records
        if (missing := r.meta.get("missing", ()))
    ]
    notes += [f"{p.name}: these logs contain no information about it." for p in parameters if p.se is None]
    poor = ",".join(p.name for p in parameters if not p.known)
    if poor and not reason_without_mission(model):
        notes.append(
            "To design the most informative mission for the poorly known parameters: seatrial mission design MODEL "
            f"--criterion Ds --parameters {poor}"
        )
    return notes
