"""Workflow of `seatrial ident information`: Fisher information about the parameters of a model in segments of logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.ident.data import WHOLE, LoadedLog, Record, TimeWindows, load_runs, make_record
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
from seatrial.ident.workflows.model_inputs import (
    known_curve,
    saved_frame_warnings,
    with_derived_signals,
    with_logged_holds,
)

NOTABLE_GROWTH = 1.2  # the answer names a segment if a standard error would grow by this factor without it
LARGE_ERROR = 0.5  # standard error / value from which a parameter is poorly known
# If the value is 0, the divisor is the standard deviation of the prior. Without a prior, it is so many characteristic
# steps:
ZERO_VALUE_STEPS = 5.0


@dataclass(frozen=True)
class InformationRequest:
    """Options of `seatrial ident information`.

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
        Names of the parameters to analyse; empty: all free parameters of the dynamics.
    thruster
        File of the static thrust curve that the model was fitted with; None: no curve.
    rate
        Rate of the rows [Hz] over which faster sensors are averaged.
    window
        Interval of time of the logs to use: one for all, or one for each.
    """

    model: Path
    logs: Sequence[Path]
    out: Path
    seconds: float = 30.0
    chosen: Sequence[str] = ()
    thruster: Path | None = None
    rate: float = 10.0
    window: TimeWindows = WHOLE


def information(request: InformationRequest, command: str, reporter: Reporter) -> InformationResult:
    """Compute the Fisher information in each segment of the logs about the model's parameters, and write the results.

    The parameters have the values of the model file, except that per-record parameters (current, biases) are fitted to
    each log. The files are result.json and report.html in the folder ``request.out``.

    Parameters
    ----------
    request : InformationRequest
        Model, logs and options.
    command : str
        Command line, for the provenance.
    reporter : Reporter
        Receives progress.

    Returns
    -------
    InformationResult
        Content of result.json.

    Raises
    ------
    SeatrialError
        If a file cannot be read, if a parameter to analyse is not free in the model, or if model and logs do not go
        together (missing commands for a thrust curve, places too far apart for a fixed point).
    """
    saved, seconds, out = load_model(request.model), request.seconds, request.out
    names = _parameters_to_analyse(saved.model, request.chosen, request.model)
    curve = known_curve(request.thruster)
    logs = load_runs(request.logs, "judged", request.window, saved.origin)
    assumed = saved_frame_warnings(saved.model, logs, saved.origin)
    loaded = [with_derived_signals(log, saved.model.source, curve) for log in logs]
    model = with_logged_holds(saved.model, loaded[0].holds)
    records = [make_record(model, log.run, request.rate) for log in loaded]
    model = without_absent_sensors(model, records)
    values = []
    for rows in records:
        reporter.progress(f"{rows.name}: fitting its current and biases")
        values.append(record_parameters(model, rows))
    reporter.progress(f"information of {sum(r.duration for r in records):.0f} s in segments of {seconds:g} s")
    segments = segment_information(model, records, names, seconds=seconds, values=values, inflation=saved.inflation)
    units = reported_units(model)
    factors = np.array([units.factor(model.parameter(name).unit) for name in names])
    found = _segment_table(segments, loaded, records, factors)
    parameters = tuple(_informed_parameter(model, name, k, segments, found) for k, name in enumerate(names))
    made = provenance(loaded, command)
    result = InformationResult(
        created=made.created,
        seatrial=made.seatrial,
        command=made.command,
        logs=made.logs,
        answer=_information_answer(parameters, len(found)),
        information=Information(names=names, seconds=seconds, parameters=parameters, segments=found),
        inputs=tuple(
            msgspec.structs.replace(row, t=row.t + float(r.meta["t0"]))
            for r in records
            for row in record_inputs(model, r)
        ),
        warnings=(*scale_warnings(thrust_scale_of(saved.model)), *assumed),
        notes=tuple(_information_notes(parameters, records, model)),
    )
    out.mkdir(parents=True, exist_ok=True)
    write_result(result, out / "result.json")
    write_report(result, out / "report.html")
    return result


def _parameters_to_analyse(model: Model, chosen: Sequence[str], path: Path) -> tuple[str, ...]:
    """Return the names of the parameters to analyse: those in ``chosen``, or all free dynamic ones if it is empty.

    Raise SeatrialError if one of them is not free in the model, or if the model has no free dynamic parameter.
    ``path``: file of the model, for the message.
    """
    free = dynamic_parameters(model)
    lost = [n for n in chosen if n not in free]
    if not free:
        raise SeatrialError(f"{path}: the model has no free parameters; give a model that was fitted to logs")
    if lost:
        raise SeatrialError(
            f"{path}: the model has no free parameter {lost[0]!r}; its free parameters are {', '.join(free)}: give "
            "some of these to --parameters"
        )
    return tuple(chosen) or tuple(free)


def record_parameters(model: Model, rows: Record) -> Array:
    """Return the parameter values of a record: per-record parameters are fitted to it, the others are unchanged.

    Parameters
    ----------
    model : Model
        Fitted model.
    rows : Record
        Record of one log.

    Returns
    -------
    Array (n_parameters,)
        In the order and units of the model's parameters.
    """
    own = [p.name for p in model.parameters if p.free and p.per_record]
    if not own:
        return np.array([p.value for p in model.parameters])
    return np.asarray(fit(model.with_free(own), [rows]).record_values[0])


def _segment_table(
    segments: Sequence[InformationSegment], loaded: Sequence[LoadedLog], records: Sequence[Record], factors: Array
) -> tuple[SegmentInformation, ...]:
    """Return the table of log segments in the result: the information of each segment about every parameter.

    The times count from the start of the log [s]. Each row names the mission step that takes up most of the segment.
    ``loaded`` and ``records``: the logs, and the records of the same names. ``lost`` of a row is the share of each
    parameter's information that would be lost without the segment, 0 to 1. ``factors`` (n_parameters,) convert standard
    errors from the units of the model to the reported units.
    """
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
                what=_longest_mission_step(steps[s.record], begin, end),
                weight=s.weight,
                lost=lost,
                alone=factors * s.alone,
            )
        )
    return tuple(found)


def _informed_parameter(
    model: Model, name: str, k: int, segments: Sequence[InformationSegment], rows: Sequence[SegmentInformation]
) -> InformedParameter:
    """Return the table row of one parameter: standard error from all logs, and the segment that contributes most.

    This is the segment without which the standard error would grow most, the first of equal ones. ``k``: index of the
    parameter ``name`` in the arrays of ``segments``. ``segments``: information of each segment of the logs. ``rows``:
    table rows of the same segments. ``known`` of the result is true if the standard error is below half of the size of
    the value. The size of a zero value is the standard deviation of its prior, or five characteristic steps if it has
    no prior.
    """
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


def _longest_mission_step(segments: Sequence[tuple[float, str]], begin: float, end: float) -> str:
    """Return the name of the mission step that takes up most of the time from ``begin`` to ``end`` [s].

    Steps with the same name count together. ``segments``: start [s] and name of each step, in order of time; the last
    one has no end. An empty text if the log has no step in that time.
    """
    length: dict[str, float] = {}
    ends = [t for t, _ in segments[1:]] + [np.inf]
    for (t, name), until in zip(segments, ends, strict=False):
        length[name] = length.get(name, 0.0) + max(min(until, end) - max(t, begin), 0.0)
    best = max(length, key=lambda name: length[name], default="")
    return best if length.get(best, 0.0) > 0 else ""


def _segment_text(row: LogSpan) -> str:
    """Return a segment of a log as a text for the answer: ``run, 30 to 60 s (zigzag)``.

    The mission step in brackets is left out if it is unknown.
    """
    words = f"{row.record}, {row.t_from:.0f} to {row.t_to:.0f} s"
    return f"{words} ({row.what})" if row.what else words


def _information_answer(parameters: Sequence[InformedParameter], n_segments: int) -> str:
    """Return the answer of `seatrial ident information`: the most informative segment, and poorly known parameters.

    ``parameters``: rows of the result. ``n_segments``: number of segments of all logs. If it is 1, the answer asks for
    more logs or shorter segments. If no parameter has a finite standard error, the answer is that there is no
    information. If only one segment informs a parameter, it is named. If no standard error would grow by a factor of
    1.2 or more without a segment, the answer is that the information is spread evenly.
    """
    known = [p for p in parameters if p.se is not None]
    if not known:
        return "These logs contain no information about any parameter; record runs in which the commands change."
    first = max(known, key=lambda p: np.inf if p.weight is None else p.weight)
    if n_segments == 1:
        words = "There is only one segment, so nothing can be compared; give more logs, or a smaller --seconds"
    elif first.weight is None:
        words = f"Only {_segment_text(first)} contains information about {first.name}"
    elif first.weight >= NOTABLE_GROWTH:
        words = (
            f"The most informative segment is {_segment_text(first)}: without it the standard error of {first.name} "
            f"would be {format_number(first.weight)} times as large"
        )
    else:
        words = "No segment matters much more than the others: the information is spread evenly over the logs"
    poor = [p.name for p in parameters if not p.known]
    return f"{words}. Poorly known from all logs together: {', '.join(poor)}." if poor else f"{words}."


def _information_notes(parameters: Sequence[InformedParameter], records: Sequence[Record], model: Model) -> list[str]:
    """Return the notes of the result of `seatrial ident information`.

    They are about sensors that a log lacks, parameters without information, and the command that designs a mission for
    the poorly known parameters.
    """
    notes = [
        f"{r.name}: the log lacks these sensors of the model, which are not used: {', '.join(missing)}."
        for r in records
        if (missing := r.meta.get("missing", ()))
    ]
    notes += [f"These logs contain no information about the parameter {p.name}." for p in parameters if p.se is None]
    poor = ",".join(p.name for p in parameters if not p.known)
    if poor and not reason_without_mission(model):
        notes.append(
            "To design the most informative mission for the poorly known parameters: seatrial mission design MODEL "
            f"--criterion Ds --parameters {poor}"
        )
    return notes
