"""Workflow of `seatrial ident navigate`: estimation of the boat's states in logs by a fitted model.

The results are CSV files of the states, result.json and report.html.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np

from seatrial.daq.errors import SeatrialError, first_names
from seatrial.daq.files import new_file
from seatrial.ident.data import (
    WHOLE,
    LoadedLog,
    Record,
    TimeWindows,
    load_run,
    make_record,
    parts_with_sensors,
    share_frame,
    window_of_each,
)
from seatrial.ident.estimation import ParameterCovariance, SavedModel, load_model, reported_units
from seatrial.ident.model import Model
from seatrial.ident.models import estimator_error_units
from seatrial.ident.navigation import CURRENT, POSITION, Navigation, Outage, OutageErrors, gnss_outages, navigate
from seatrial.ident.numerics import Array
from seatrial.ident.report import write_report
from seatrial.ident.reporter import Reporter
from seatrial.ident.results import (
    GnssFixes,
    GnssOutage,
    InputTrace,
    NavigatedRecord,
    NavigationResult,
    PositionEllipse,
    ResultWarning,
    StateTrace,
    WithheldErrors,
    finite,
    format_number,
    provenance,
    record_inputs,
    write_result,
)
from seatrial.ident.workflows.comparison_likelihood import used_logs
from seatrial.ident.workflows.model_inputs import (
    hold_lines,
    known_curve,
    saved_frame_warnings,
    with_derived_signals,
    with_logged_holds,
)

Columns = list[tuple[str, str, Array]]  # name, unit, values


@dataclass(frozen=True)
class NavigationRequest:
    """Options of `seatrial ident navigate`; all times [s] count from the start of a log.

    Attributes
    ----------
    model
        The model.toml.
    logs
        Logs, whose file names without folder and ending must differ.
    out
        Folder for the results.
    smoothed
        True: states are estimated from all samples of a log (smoother). False: from the samples up to each time
        (filter).
    gnss_outages
        Intervals (from, to) in which GNSS is withheld from the filter; the end does not belong to the interval.
    window
        Interval of time of the logs to use: one for all, or one for each.
    rate
        Rate of the rows [Hz] over which faster sensors are averaged.
    thruster
        File of the static thrust curve that the model was fitted with; None: no curve.
    """

    model: Path
    logs: Sequence[Path]
    out: Path
    smoothed: bool = True
    gnss_outages: Sequence[tuple[float, float]] = ()
    window: TimeWindows = WHOLE
    rate: float = 10.0
    thruster: Path | None = None


def navigate_logs(request: NavigationRequest, command: str, reporter: Reporter) -> NavigationResult:
    """Estimate the states of the boat in each log, and write the results.

    A log is cut into segments at long times without a sample. The files in the folder ``request.out`` are a CSV file of
    the states for each log or segment, named after it, and result.json and report.html. The filter is of first order,
    also if the model was fitted with one of second order.

    Parameters
    ----------
    request : NavigationRequest
        Model, logs and options.
    command : str
        Command line, for the provenance.
    reporter : Reporter
        Receives progress.

    Returns
    -------
    NavigationResult
        Content of result.json.

    Raises
    ------
    SeatrialError
        If two logs have the same file name without ending, if a file cannot be read, if a log has no GNSS position, or
        none in an interval to withhold, or if the model has no position.
    """
    logs, saved = request.logs, load_model(request.model)
    # First order: in a long outage the heading may be too uncertain for a second-order expansion.
    model = replace(saved.model, second_order=False)
    curve = known_curve(request.thruster)
    known = saved.covariance()
    names = [p.stem for p in logs]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise SeatrialError(
            f"two logs are named {twice[0]}, so their results would overwrite each other; navigate them one by one, "
            "each with its own --out"
        )
    loaded, parts, tables, reference = list[LoadedLog](), [], [], saved.origin
    for path, window in zip(logs, window_of_each(request.window, len(logs)), strict=True):
        reporter.progress(f"navigating {path.name}")
        own = share_frame(parts_with_sensors(load_run(path, "navigated", window)), reference)
        reference = reference or own[0].origin
        for log, outages in zip(own, _outages_by_segment(own, request.gnss_outages), strict=True):
            loaded.append(with_derived_signals(log, saved.model.source, curve))
            done, t0 = _navigate_log(model, loaded[-1], known, request, outages)
            parts.append((done, t0, gnss_outages(done)))
            tables.append(_csv_columns(done, t0))
    for line in hold_lines(saved, loaded):
        reporter.warning(line)
    assumed = saved_frame_warnings(model, loaded, saved.origin)
    made = provenance(loaded, command)
    result = NavigationResult(
        created=made.created,
        seatrial=made.seatrial,
        command=made.command,
        logs=made.logs,
        answer=navigation_answer([o for _, _, found in parts for o in found], [d for d, _, _ in parts]),
        navigation=tuple(_navigated_record(d, t0, table) for (d, t0, _), table in zip(parts, tables, strict=True)),
        outages=tuple(_outage_row(o, d.record.name, t0) for d, t0, found in parts for o in found),
        inputs=tuple(row for d, t0, _ in parts for row in _input_traces(d, t0)),
        warnings=(*assumed, *_counted_twice(saved, loaded)),
        notes=tuple(_navigation_notes(parts, known)),
    )
    _write_results(request.out, result, dict(zip((log.run.name for log in loaded), tables, strict=True)))
    return result


def _write_results(out: Path, result: NavigationResult, tables: Mapping[str, Columns]) -> None:
    """Write NAME.csv for each table, result.json and report.html to the folder ``out``.

    The folder is created if it does not exist. Existing files of these names are replaced.
    """
    out.mkdir(parents=True, exist_ok=True)
    for name, table in tables.items():
        write_csv(out / f"{name}.csv", table)
    write_result(result, out / "result.json")
    write_report(result, out / "report.html")


def _counted_twice(saved: SavedModel, loaded: Sequence[LoadedLog]) -> list[ResultWarning]:
    """Return a warning if the model was fitted to logs that are navigated, or an empty list.

    The parameters are then correlated with the samples, which the covariance of the states does not include.
    """
    if not (used := used_logs(saved, loaded)):
        return []
    text = (
        f"the model was fitted to {first_names(used)}: these data are counted twice, so that the standard deviations "
        "of the states are too small. Navigate logs that the fit has not used."
    )
    return [ResultWarning(code="navigated-fitted-log", text=text)]


def _outages_by_segment(
    parts: Sequence[LoadedLog], outages: Sequence[tuple[float, float]]
) -> list[list[tuple[float, float]]]:
    """Return, for each segment of one log, those intervals of the option --gnss-outage that begin in it.

    ``outages``: intervals (from, to) [s] from the start of the log. ``parts``: segments of the log in order of time. An
    interval that begins at the last sample of a segment belongs to it. An interval that begins between two segments
    belongs to the later one, and one that begins after all segments to the last one. Intervals are not cut.
    """
    ends = [max(float(c.t[-1]) for c in log.run.channels.values()) for log in parts[:-1]]
    own: list[list[tuple[float, float]]] = [[] for _ in parts]
    for begin, end in outages:
        own[int(np.searchsorted(ends, begin))].append((begin, end))
    return own


def _navigate_log(
    model: Model,
    log: LoadedLog,
    known: ParameterCovariance,
    request: NavigationRequest,
    without: Sequence[tuple[float, float]],
) -> tuple[Navigation, float]:
    """Estimate the states of one log or segment; return the navigation and the time [s] of its first row in the log.

    ``known``: covariance of the model's parameters. ``without``: intervals (from, to) [s of the log] in which GNSS is
    withheld. Raise SeatrialError if the log has no position, or none in such an interval.
    """
    rate = request.rate
    model = with_logged_holds(model, log.holds)
    rows = make_record(model, log.run, rate)
    t0 = float(rows.meta["t0"])
    _check_fixes(rows, t0, without, log.about["path"])
    segments = [(a - t0, b - t0) for a, b in without]
    return navigate(model, rows, smoothed=request.smoothed, without_gnss=segments, known=known), t0


def _check_fixes(rows: Record, t0: float, without: Sequence[tuple[float, float]], path: str) -> None:
    """Raise SeatrialError if a log has no position, or no position in an interval that is to be withheld.

    ``t0``: log time [s] of the first row. ``without``: intervals [s of the log], from the first time to before the
    second. ``path``: file of the log, for the message. A model without a position is accepted here.
    """
    if POSITION[0] not in rows.outputs:  # the model has no position; ``navigate`` raises the error
        return
    fixes = rows.t[np.isfinite(rows.y[:, rows.outputs.index(POSITION[0])])] + t0
    if not fixes.size:
        raise SeatrialError(
            f"{path}: the log has no GNSS position; navigation needs at least one fix: give a log with GNSS, or other "
            "--from and --to"
        )
    for begin, end in without:
        if not ((fixes >= begin) & (fixes < end)).any():
            raise SeatrialError(
                f"{path}: no GNSS position between {begin:g} s and {end:g} s to withhold; it "
                f"has them from {fixes[0]:.0f} s to {fixes[-1]:.0f} s: give an interval in this time to --gnss-outage"
            )


def _csv_columns(done: Navigation, t0: float) -> Columns:
    """Return the columns of the CSV file of a navigated log.

    They are the time, the states and their standard deviations, the current with its standard deviations (if it is a
    state), the covariance ``cov_x_y`` [m2] of north and east, and ``gnss``: 1 for a fix that was used, -1 for one that
    was withheld, 0 without a fix. ``t0``: log time [s] of the first row. States are in reported units: forces are
    ratios to the thrust if the scale of the forces is unknown, and errors of a sensor are in its unit.
    """
    states, best = done.model.states, done.best
    drift = set(CURRENT.values()) if done.current() is not None else set()
    columns: Columns = [("t", "s", done.t + t0)]
    units, errors = reported_units(done.model), estimator_error_units(done.model)
    kept = [
        (i, s.name, *errors.get(s.name, (units.factor(s.unit), units.scale.unit(s.unit))))
        for i, s in enumerate(states)
        if s.name not in drift
    ]
    columns += [(name, unit, factor * best.x[:, i]) for i, name, factor, unit in kept]
    columns += [(f"sd_{name}", unit, factor * best.sd[:, i]) for i, name, factor, unit in kept]
    current = done.current()
    if current is not None:
        names = [*CURRENT, *(f"sd_{n}" for n in CURRENT)]
        columns += [(n, "m/s", current[:, i]) for i, n in enumerate(names)]
    i, j = (done.states.index(n) for n in POSITION)
    gnss = np.where(done.used, 1.0, np.where(done.withheld, -1.0, 0.0))
    return [*columns, ("cov_x_y", "m2", best.P[:, i, j]), ("gnss", "", gnss)]


def write_csv(path: Path, columns: Columns) -> None:
    """Write a CSV file: a line of names, then one line for each row.

    Times are rounded to 0.1 ms, other numbers to seven significant digits.

    Parameters
    ----------
    path : Path
        File, which is replaced if it exists.
    columns : list
        Name, unit and values (n,) of each column; the first is the time [s]. The units are not written.
    """
    table = np.column_stack([values for _, _, values in columns])
    layout = ["%.4f", *["%.7g"] * (len(columns) - 1)]
    with new_file(path) as scratch:
        np.savetxt(scratch, table, fmt=layout, delimiter=",", header=",".join(n for n, _, _ in columns), comments="")


def _input_traces(done: Navigation, t0: float) -> list[InputTrace]:
    """Return the inputs of a navigated record as traces of the result, over the time of the log.

    ``t0``: log time [s] of the first row.
    """
    return [msgspec.structs.replace(row, t=row.t + t0) for row in record_inputs(done.model, done.record)]


def _navigated_record(done: Navigation, t0: float, table: Columns) -> NavigatedRecord:
    """Return the navigation of one record as an entry of the result.

    The entry has the estimated states with their standard deviations, beside measurements with the same name, and the
    GNSS fixes. ``t0``: log time [s] of the first row. ``table``: columns of the CSV file, which give the states.
    """
    values = {name: value for name, _, value in table}
    meaning = {s.name: s.meaning for s in done.model.states} | {
        "V_x": "current to the north",
        "V_y": "current to the east",
    }
    angles = {o.name for o in done.model.outputs if o.angle}
    units = {name: unit for name, unit, _ in table}
    measured = {o.name: j for j, o in enumerate(done.model.outputs)}
    names = [n for n in values if f"sd_{n}" in values]
    seen = np.isfinite(done.fixes[:, 0])
    return NavigatedRecord(
        record=done.record.name,
        kind="smoothed" if done.kind == "smoothed" else "filtered",
        t=done.t + t0,
        states=tuple(
            StateTrace(
                name=n,
                unit=units[n],
                meaning=meaning[n].removesuffix(", scaled"),
                angle=n in angles,
                value=values[n],
                sd=values[f"sd_{n}"],
                measured=done.record.y[:, measured[n]] if n in measured else None,
            )
            for n in names
        ),
        fixes=GnssFixes(
            t=done.t[seen] + t0,
            x=done.fixes[seen, 0],
            y=done.fixes[seen, 1],
            used=done.used[seen].astype(float),
        ),
    )


def _outage_row(o: Outage, name: str, t0: float) -> GnssOutage:
    """Return the row of the result for one GNSS outage ``o``, with the times of the log.

    ``name``: name of the record. ``t0``: log time [s] of its first row.
    """
    e = o.at_end
    return GnssOutage(
        record=name,
        start=o.start + t0,
        end=o.end + t0,
        duration=o.duration,
        open=o.open,
        leading=o.leading,
        withheld=o.withheld,
        north=o.north,
        east=o.east,
        at_end=PositionEllipse(major=e.major, minor=e.minor, azimuth=e.azimuth, radius=e.radius),
        error=finite(o.error),
        allowed=finite(o.allowed),
        inside=o.inside,
        widest=o.widest,
        predicted=_withheld_errors(o.predicted),
        best=_withheld_errors(o.best),
    )


def _withheld_errors(found: OutageErrors | None) -> WithheldErrors | None:
    """Return the position errors at withheld fixes as an entry of the result; None if no fix was withheld."""
    if found is None:
        return None
    return WithheldErrors(rms=found.rms, largest=found.largest, inside=found.inside, n=found.n)


def navigation_answer(found: Sequence[Outage], done: Sequence[Navigation]) -> str:
    """Return the answer of `seatrial ident navigate`: the GNSS outages, or else the accuracy of the position.

    The accuracy is the median over time of the standard deviation of the position, for the record in which it is
    largest.

    The most uncertain outage is the one with the largest predicted position error at its end. The outage that was
    farthest off is named too if it is another one. The time before the first fix of a record has a sentence of its own.

    Parameters
    ----------
    found : sequence of Outage
        Outages of all records, with the times before first fixes.
    done : sequence of Navigation
        Navigations of all records, at least one.
    """
    if not found:
        radius = max(float(np.median(np.hypot(*n.best.sd[:, [n.states.index(p) for p in POSITION]].T))) for n in done)
        return f"No GNSS outage; the {done[0].kind} position has a standard deviation of {format_number(radius)} m."
    late = [
        f"Before the first fix, {o.duration:.0f} s after the start, the {done[0].kind} position may be "
        f"{format_number(o.widest)} m off (95 %)"
        for o in found
        if o.leading
    ]
    found = [o for o in found if not o.leading]
    if not found:
        return "; ".join(late) + "."
    uncertain = max(found, key=lambda o: o.at_end.radius)
    words = (
        f"1 GNSS outage, of {uncertain.duration:.0f} s: at its end"
        if len(found) == 1
        else f"{len(found)} GNSS outages; at the end of the most uncertain one, {uncertain.duration:.0f} s long,"
    )
    words += f" the position may be {format_number(uncertain.at_end.radius)} m off (95 %)"
    judged = [o for o in found if o.error is not None]
    if uncertain.error is not None:
        # An outage without an end is compared with its last withheld fix, which may be long before its end.
        words += f"; compared with the {'last withheld fix' if uncertain.open else 'first fix after it'}, it was "
        words += f"{format_number(uncertain.error)} m off"
        if len(judged) == 1:
            words += f", {'within' if uncertain.inside else 'beyond'} the 95 % radius of position and fix"
    if len(judged) > 1:
        farthest = max(judged, key=lambda o: o.error or 0.0)
        if farthest is not uncertain:
            off, allowed = (format_number(x or 0.0) for x in (farthest.error, farthest.allowed))
            words += f". Farthest off was another one, {farthest.duration:.0f} s long: {off} m, allowed {allowed} m"
        inside = sum(bool(o.inside) for o in judged)
        words += f". At {inside} of {len(judged)} outages the fix is within the 95 % radius"
    return ". ".join([words, *late]) + "."


def _navigation_notes(parts: Sequence[tuple[Navigation, float, list[Outage]]], known: ParameterCovariance) -> list[str]:
    """Return the notes of the result of `seatrial ident navigate`.

    They are about missing sensors, innovations that are larger than the model predicts (over 30 samples of a channel
    with a standard deviation above 1.5 times the predicted one), fixes beyond the 95 % radius at the end of an outage,
    and missing standard errors of the parameters. ``parts``: navigation, log time [s] of its first row, and outages of
    each record. ``known``: covariance of the parameters.
    """
    notes = []
    for done, t0, found in parts:
        name = done.record.name
        missing = done.record.meta.get("missing", ())
        if missing:
            notes.append(f"{name}: the log lacks these sensors of the model, which are not used: {', '.join(missing)}.")
        e = done.run.standardised
        loud = [
            o.name
            for j, o in enumerate(done.model.outputs)
            if np.isfinite(e[:, j]).sum() > 30 and np.nanstd(e[:, j]) > 1.5
        ]
        if loud:
            notes.append(
                f"{name}: the innovations of {', '.join(loud)} are larger than the model predicts, so the standard "
                "deviations of position and states are too small: the model was fitted to other conditions, or lacks "
                "an effect. Fit it to this log too, or run `seatrial ident diagnose`."
            )
        outside = [o for o in found if o.inside is False]
        notes += [
            f"{name}: at the end of the outage, at {o.end + t0:.0f} s, the prediction is "
            f"{format_number(float(o.error or 0.0))} m off, more than the 95 % radius of "
            f"{format_number(float(o.allowed or 0.0))} m. Check wind, current and load of this run."
            for o in outside
        ]
    if not known.names:
        notes.append(
            "The model contains no standard errors, so its parameters are taken as exact. Fit it with `seatrial ident "
            "vehicle` to have them."
        )
    return notes
