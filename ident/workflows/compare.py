"""Workflow of `seatrial ident compare`: comparison of the predictions of several fitted models on the same logs.

One model alone is evaluated on logs that it has not seen.

Each prediction of a record by a model is a task, which may run on another computer. The errors of all models are
compared at the samples that all of them predict.
"""

from __future__ import annotations

import itertools
import string
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import geometric_mean

import msgspec
import numpy as np

from seatrial.daq.errors import SeatrialError, counted
from seatrial.ident.checks import device_faults
from seatrial.ident.data import WHOLE, LoadedLog, LogSegment, Record, TimeWindows, load_all, make_record
from seatrial.ident.estimation import (
    FEWEST_BLOCKS,
    SavedModel,
    effects_per_run,
    load_model,
    number_of_blocks,
    uncertainty_of,
    unconverged_sentence,
)
from seatrial.ident.model import Model
from seatrial.ident.parallel import Workers, run_many
from seatrial.ident.report import write_report
from seatrial.ident.reporter import Reporter
from seatrial.ident.results import (
    FIT_OF_ALL,
    RUNS_AWAY,
    ComparedChannel,
    ComparedKind,
    ComparedModel,
    ComparedPair,
    ComparedPrediction,
    ComparedRatio,
    ComparedTrace,
    ComparisonResult,
    ResultWarning,
    cross_rows,
    provenance,
    residual_row,
    structure_warnings,
    warm_up_notes,
    write_result,
)
from seatrial.ident.validation import (
    MAX_STARTS,
    MIN_STRIDE,
    WARM_UP,
    correlated_blocks,
    prediction_change_by_record,
)
from seatrial.ident.workflows.check import check_first
from seatrial.ident.workflows.compared_masses import mass_warnings_of, masses_of
from seatrial.ident.workflows.compared_predictions import (
    ONE_STEP,
    SIMULATION,
    Curve,
    Kind,
    PredictedRecord,
    PredictionTask,
    predict_record,
    widened,
)
from seatrial.ident.workflows.compared_sizes import size_notes
from seatrial.ident.workflows.compared_surroundings import surroundings_notes
from seatrial.ident.workflows.comparison_errors import (
    ErrorsByRecord,
    at_common_samples,
    calibration_at,
    channel_rows,
    concentration_notes,
    limited_samples,
    ratio_row,
)
from seatrial.ident.workflows.comparison_likelihood import (
    has_selected_effects,
    information_criteria,
    log_score,
    other_parts,
    used_logs,
    why_not_comparable,
)
from seatrial.ident.workflows.dynamics import course_at_speeds
from seatrial.ident.workflows.model_differences import model_differences
from seatrial.ident.workflows.model_inputs import check_horizon, hold_lines, in_one_frame, model_of_logs

BLOCK_LENGTHS = 2.0  # block length of the log score, in times over which residuals may be correlated
SAME_TIME = 1e-6  # s: records whose starts and ends differ by less cover the same time
RUNAWAY_GROWTH = float(np.log(10.0))  # growth of a yaw rate, as a logarithm, with which a simulation runs away
CHANCE = 0.05  # share of the verdicts on two equal models that are wrong

Predictions = Mapping[str, Sequence[PredictedRecord]]  # those of one model: by record, for each block or the whole

NO_FIT_IN_BLOCKS = "the logs are cut into blocks in time, whose estimates are not those of a fit to the logs"


@dataclass(frozen=True)
class CompareRequest:
    """Options of `seatrial ident compare`.

    Attributes
    ----------
    models
        The model.toml of each model. The first one is the reference. One alone is evaluated.
    logs
        Logs on which the models are compared.
    horizons
        Prediction horizons [s]; empty: that of the first model.
    rate
        Rate of the rows (instants of a record) [Hz], over which faster sensors are averaged. None: 50 Hz if the first
        model is a thruster model, 10 Hz if it is a vehicle model.
    thruster
        For vehicle models: file of the static thrust curve that they were fitted with. For thruster models: name of the
        thruster, if the logs have several. None: no curve, and the only thruster.
    despite_faults
        Whether to compare on logs with faults that make a fit meaningless.
    window
        Interval of time of the logs to use: one for all, or one for each.
    names
        Name of each model for the result; empty: the path of its file.
    out
        Folder for result.json and report.html; None: no file is written.
    workers
        Processes that predict the records.
    """

    models: Sequence[Path]
    logs: Sequence[Path]
    horizons: Sequence[float] = ()
    rate: float | None = None
    thruster: str | None = None
    despite_faults: bool = False
    window: TimeWindows = WHOLE
    names: Sequence[str] = ()
    out: Path | None = None
    workers: Workers = field(default_factory=Workers)


@dataclass(frozen=True)
class _Candidate:
    """One model of a comparison with its data.

    Attributes
    ----------
    name
        Name for the result.
    path
        Its model.toml.
    saved
        The model as saved.
    model
        The model as it predicts the logs: with the holds of the logs, and with a first-order filter.
    segments
        Signals of the logs for this model.
    """

    name: str
    path: Path
    saved: SavedModel
    model: Model
    segments: Sequence[LogSegment]

    @property
    def n_free(self) -> int:
        """Number of estimated parameters with one value for all logs; per-record parameters are not counted."""
        return sum(p.free and not p.per_record for p in self.saved.model.parameters)

    @property
    def per_log(self) -> tuple[str, ...]:
        """Names of the parameters that are estimated anew for each compared log, such as the current."""
        return tuple(p.name for p in self.model.parameters if p.free and p.per_record)

    def widens(self, seconds: float | None) -> bool:
        """Return whether validation data widen the prediction intervals of one kind of prediction.

        The kind is the prediction over the horizon ``seconds`` [s], or the simulation if ``seconds`` is None.
        """
        return self.saved.intervals is not None and bool(self.saved.intervals.widening(seconds))


def compare_models(request: CompareRequest, command: str, reporter: Reporter) -> ComparisonResult:
    """Predict the same logs by several fitted models, and compare the predictions with those of the first model.

    One model alone is evaluated: the result has its errors, and the shares of them inside its 95 % intervals.

    Each model keeps its estimates. Only the parameters that belong to a log, such as the current, are estimated anew
    for each log and model. All models predict the same interval of time of each log, and their errors are compared at
    the samples that all of them predict.

    If an effect of a model has parameters of its own for each log, and all logs are long enough, all models are
    compared on the same blocks in time of the logs, as in a diagnosis: such parameters are estimated from the other
    blocks of the log. Otherwise they are estimated from the samples that are predicted, with a warning.

    With a folder ``request.out``, result.json and report.html are written there.

    Parameters
    ----------
    request : CompareRequest
        Models, logs and options.
    command : str
        Command line, for the provenance.
    reporter : Reporter
        Receives progress and warnings.

    Returns
    -------
    ComparisonResult
        Prediction errors of each model, and its differences to the first model and to the best one.

    Raises
    ------
    SeatrialError
        If there is no model, if a model or a log is given twice, if a file cannot be read, if the logs have faults that
        make a fit meaningless (unless ``despite_faults``), if no log is longer than a given horizon, if a model cannot
        predict a log, or if a cluster cannot be used.
    """
    if not request.models:
        raise SeatrialError("there is no model; give the model.toml of a fit, or several to compare them")
    _require_different(request.models, request.names or [str(path) for path in request.models])
    loaded, _ = load_all(request.logs, [], request.window, device_faults)
    for horizon in request.horizons:
        check_horizon(horizon, loaded, [])
    saved = [load_model(path) for path in request.models]
    loaded, _ = check_first(loaded, [], saved[0].model, request.despite_faults)
    loaded = [replace(log, about={**log.about, "role": "compared"}) for log in loaded]
    notes: list[str] = []
    models_by_line: dict[str, list[str]] = {}  # so that a line which holds for several models is said once
    for path, known in zip(request.models, saved, strict=True):
        for line in hold_lines(known, loaded):
            models_by_line.setdefault(line, []).append(str(path))
    for line, paths in models_by_line.items():
        notes.append(f"{', '.join(paths)}: {line}")
        reporter.warning(notes[-1])
    rate, compared = request.rate, list[_Candidate]()
    for path, name, known in zip(request.models, request.names or map(str, request.models), saved, strict=True):
        # First order, so that the likelihoods of all models are comparable.
        model = replace(known.model, second_order=False)
        placed, _ = in_one_frame(model, loaded, [], known.origin)
        model, segments, _, usual = model_of_logs(model, path, placed, [], request.thruster)
        rate = rate or usual
        compared.append(_Candidate(name, path, known, model, segments))
    rate = rate or 10.0
    horizons = tuple(dict.fromkeys(request.horizons)) or (saved[0].model.horizon,)
    models = with_equal_averages([c.model for c in compared])
    records = records_of_same_time([(m, c.segments) for m, c in zip(models, compared, strict=True)], rate)
    block = block_of_comparison([c.model for c in compared], records, horizons)
    predicted = _predicted(compared, records, horizons, rate, block, request.workers, reporter)
    result = _result(compared, records, predicted, horizons, loaded, command, notes)
    if request.out is not None:
        write_comparison(result, request.out)
    return result


def _require_different(models: Sequence[Path], names: Sequence[str]) -> None:
    """Raise SeatrialError if two of the model files are the same file, or have the same content.

    A verdict on two equal models would be one on rounding errors.
    """
    seen: dict[bytes, str] = {}
    for path, name in zip(models, names, strict=True):
        try:
            content = path.read_bytes()
        except OSError:  # the reader of the model reports it
            continue
        if content in seen:
            if name == seen[content]:
                raise SeatrialError(f"{name} is given twice; give another model to compare it with")
            raise SeatrialError(f"{name} is the same model as {seen[content]}; give another model to compare it with")
        seen[content] = name


def write_comparison(result: ComparisonResult, out: Path) -> Path:
    """Write result.json and report.html of a comparison to a folder, and return it.

    The folder is created if it does not exist. Existing files of these names are replaced.
    """
    out.mkdir(parents=True, exist_ok=True)
    write_result(result, out / "result.json")
    write_report(result, out / "report.html")
    return out


def labels(n: int) -> list[str]:
    """Return the labels of n models: ``a`` to ``z``, then ``a1``, ``b1``, ..."""
    letters = string.ascii_lowercase
    return [letters[k % len(letters)] + (str(k // len(letters)) if k >= len(letters) else "") for k in range(n)]


def with_equal_averages(models: Sequence[Model]) -> list[Model]:
    """Return the models for their records, in which a sensor is averaged for all models if it is for one of them.

    A sensor that one model averages and another one does not (`Sensor.averaged`, of the model ``nomoto``) would have
    samples at other instants in each, and no sample that both predict.
    """
    averaged = {s.name for model in models for s in model.sensors if s.averaged}
    return [
        replace(model, sensors=tuple(replace(s, averaged=s.name in averaged) for s in model.sensors))
        for model in models
    ]


def records_of_same_time(models: Sequence[tuple[Model, Sequence[LogSegment]]], rate: float) -> list[list[Record]]:
    """Return the records of each model, all of which cover the same interval of time of a log.

    A record begins where all signals of its model are known, which differs between models with other inputs. The
    records of a log are therefore cut to the time that all of them cover, so that their times count from one instant.

    Parameters
    ----------
    models : sequence of (Model, sequence of LogSegment)
        Models, and for each the signals of the logs, in the same order.
    rate : float
        Rate of the rows [Hz].

    Raises
    ------
    ValueError
        If a log lacks signals of a model, or if the signals of the models do not overlap.
    """
    records = [[make_record(model, s, rate) for s in segments] for model, segments in models]
    for k in range(len(records[0])):
        starts = [float(own[k].meta["t0"]) for own in records]
        ends = [start + float(own[k].t[-1]) for start, own in zip(starts, records, strict=True)]
        if max(starts) - min(starts) > SAME_TIME or max(ends) - min(ends) > SAME_TIME:
            for own, (model, segments) in zip(records, models, strict=True):
                own[k] = make_record(model, replace(segments[k], t_from=max(starts), t_to=min(ends)), rate)
    return records


def block_of_comparison(
    models: Sequence[Model], records: Sequence[Sequence[Record]], horizons: Sequence[float]
) -> float | None:
    """Return the duration [s] from which the blocks in time of a comparison follow; None: the logs are not cut.

    It is the longest ``Model.block`` of the models. The logs are cut if an effect of a model has parameters of its own
    for each log. Each block must be longer than the filtering before a simulation and the longest horizon together.

    Parameters
    ----------
    models
        Models to compare.
    records
        Records of each model.
    horizons
        Prediction horizons [s].
    """
    if not any(map(effects_per_run, models)):
        return None
    block = max(m.block for m in models)
    shortest = min(r.duration / number_of_blocks(r.duration, block) for own in records for r in own)
    return block if shortest > WARM_UP + max(horizons) else None


def _predicted(
    compared: Sequence[_Candidate],
    records: Sequence[Sequence[Record]],
    horizons: tuple[float, ...],
    rate: float,
    block: float | None,
    workers: Workers,
    reporter: Reporter,
) -> list[dict[str, list[PredictedRecord]]]:
    """Predict each record by each model in parallel tasks, and return the predictions of each model by record.

    ``block`` is the duration [s] from which the blocks in time of a record follow; with None, a record is predicted as
    a whole. SeatrialError is raised if a model cannot predict a record.
    """
    longest = max(own.duration for own in records[0])
    interval = max(MIN_STRIDE / rate, longest / MAX_STARTS)
    tasks = [
        PredictionTask(i, c.model, record, horizons, interval, uncertainty_of(c.saved.covariance(), c.model), block)
        for i, (c, own) in enumerate(zip(compared, records, strict=True))
        for record in own
    ]
    found = [dict[str, list[PredictedRecord]]() for _ in compared]
    for n, outcome in enumerate(run_many(tasks, predict_record, workers, reporter), 1):
        path, record = compared[outcome.task.index].path, outcome.task.record.name
        if outcome.value is None:
            raise SeatrialError(
                f"{path}: this model cannot predict {record}: {outcome.error}; leave out this log or model"
            )
        known = compared[outcome.task.index].saved.intervals
        found[outcome.task.index][record] = [widened(part, known) for part in outcome.value]
        reporter.progress(f"{n} of {len(tasks)}: {record} predicted by {path}")
    return [{record.name: by[record.name] for record in records[0]} for by in found]


def _result(
    compared: Sequence[_Candidate],
    records: Sequence[Sequence[Record]],
    by_record: Sequence[Predictions],
    horizons: tuple[float, ...],
    loaded: Sequence[LoadedLog],
    command: str,
    notes: Sequence[str],
) -> ComparisonResult:
    """Return the result of a comparison from the predictions of each model by record.

    ``records`` has the records of each model in the order of ``loaded``, and ``notes`` the remarks on the logs.
    """
    predicted = [_by_part(by) for by in by_record]
    in_blocks = len(predicted[0]) > len(by_record[0])
    letters = labels(len(compared))
    block = BLOCK_LENGTHS * max(c.model.block for c in compared)
    kinds = [ONE_STEP, *(Kind("horizon", s) for s in horizons), SIMULATION]
    units = {o.name: o.unit for c in compared for o in c.model.outputs}
    channels = list[ComparedChannel]()
    changes: list[list[ComparedKind]] = [[] for _ in compared]
    pairs, events = list[ComparedPair](), list[str]()
    for kind in kinds:
        errors = at_common_samples([{r: p.errors[kind] for r, p in by.items()} for by in predicted])
        lengths = dict.fromkeys(units, max(block, BLOCK_LENGTHS * (kind.seconds or 0.0)))
        if kind == SIMULATION:
            for name, length in (item for other in errors[1:] for item in correlated_blocks(errors[0], other).items()):
                lengths[name] = max(lengths[name], length)
        tested = [calibration_at(kind, own, by) for own, by in zip(errors, predicted, strict=True)]
        channels += channel_rows(kind, errors, letters, units, lengths, tested)
        length = max(lengths.values())
        for own, other in zip(changes[1:], errors[1:], strict=True):
            found = prediction_change_by_record(errors[0], other, kind.seconds or 0.0, length)
            if (ratio := ratio_row(found)) is not None:
                own.append(ComparedKind(kind=kind.kind, seconds=kind.seconds, block=length, against_reference=ratio))
        if kind.seconds is not None:
            pairs += _pairs(errors, letters, kind.seconds, length)
        if kind.seconds == horizons[0]:
            at = [(k, c) for k, own in enumerate(changes) for c in own if c.seconds == kind.seconds]
            undecided = [k for k, c in at if c.against_reference.verdict not in ("better", "worse")]
            starts = {r.name: r.t_from for r in records[0]}
            events = concentration_notes(errors, letters, horizons[0], undecided, starts)
    models = list[ComparedModel]()
    for label, c, by, own in zip(letters, compared, predicted, changes, strict=True):
        row = ComparedModel(
            label=label,
            name=c.name,
            model=c.model.name,
            n_free=c.n_free,
            per_log=c.per_log,
            fitted_to=used_logs(c.saved, loaded),
            selected_by=used_logs(c.saved, loaded, "validation") if has_selected_effects(c.saved) else (),
            widened_horizons=tuple(s for s in horizons if c.widens(s)),
            widened_simulation=c.widens(None),
            widened_by=() if c.saved.intervals is None else used_logs(c.saved, loaded, "validation"),
            masses=masses_of(c.saved),
            differences=model_differences(compared[0].saved, c.saved) if models else None,
            changes=tuple(own),
            residuals=tuple(residual_row(r) for part in by.values() for r in part.residuals),
            cross=tuple(row for part in by.values() for r in part.residuals for row in cross_rows(r)),
        )
        if models:
            pair = ((models[0], compared[0]), (row, c))
            adapted = not in_blocks and any(effects_per_run(of.model) for _, of in pair)
            held_out = not adapted and not any(m.fitted_to or m.selected_by for m, _ in pair)
            score = log_score(predicted[0], by, block, held_out)
            saved, fitted_to = (compared[0].saved, c.saved), (models[0].fitted_to, row.fitted_to)
            reason = why_not_comparable(saved, fitted_to, loaded, score)
            reason = reason or (NO_FIT_IN_BLOCKS if in_blocks else "")
            criteria = None
            if score is not None and not reason:
                criteria = information_criteria(compared[0].saved.model, c.saved.model, by, score.gain)
            row = msgspec.structs.replace(row, score=score, criteria=criteria, no_criteria=reason)
        models.append(row)
    made, weighed = provenance(loaded, command), loaded[0].hull().get("mass")
    verdicts = sum(e.against_reference is not None for row in channels for e in row.errors)
    chance = (
        f"Each verdict is at the level of 95 %: of {counted(verdicts, 'verdict')} on equal models, about "
        f"{CHANCE * verdicts:.1g} would be wrong by chance."
    )
    simulated_parts = ((name, float(part.t[-1] - part.t[0])) for by in predicted for name, part in by.items())
    short = warm_up_notes(simulated_parts, compared[0].saved.model.kind)
    simulated = max(float(part.t[-1] - part.t[0]) for part in predicted[0].values()) - WARM_UP
    result = ComparisonResult(
        created=made.created,
        seatrial=made.seatrial,
        command=made.command,
        logs=made.logs,
        answer="",
        warnings=(
            *_unconverged_warnings(compared, models),
            *_mass_warnings(compared, models, weighed),
            *_structure_warnings(compared, models),
            *_limited_warnings(predicted, letters),
            *_warnings(models),
            *_warnings_of_effects(compared, letters, by_record[0]),
        ),
        notes=(
            *notes,
            *events,
            *_runaway_notes(compared, simulated, horizons[0]),
            *_notes_on_logs(models),
            *_notes_on_parts(compared, letters, loaded),
            *size_notes({label: c.saved for label, c in zip(letters, compared, strict=True)}),
            *surroundings_notes(
                {label if len(compared) > 1 else "": c.saved for label, c in zip(letters, compared, strict=True)},
                loaded,
            ),
            *short,
            *([chance] if verdicts else []),
        ),
        horizons=horizons,
        models=tuple(models),
        weighed_mass=weighed,
        channels=tuple(channels),
        traces=tuple(_traces(compared, records, by_record, letters)),
        pairs=tuple(pairs),
    )
    return msgspec.structs.replace(result, answer=comparison_answer(result))


def _pairs(
    errors: Sequence[ErrorsByRecord], letters: Sequence[str], seconds: float, length: float
) -> Iterator[ComparedPair]:
    """Yield the error ratios over a horizon [s] between the models other than the first, each pair once.

    ``errors`` are those of each model at common samples; ``length`` is that of the blocks of time [s].
    """
    for (j, other), (k, model) in itertools.combinations(list(enumerate(letters))[1:], 2):
        if (ratio := ratio_row(prediction_change_by_record(errors[j], errors[k], seconds, length))) is not None:
            yield ComparedPair(model=model, other=other, seconds=seconds, ratio=ratio)


def _unconverged_warnings(compared: Sequence[_Candidate], models: Sequence[ComparedModel]) -> Iterator[ResultWarning]:
    """Yield a warning for each compared model whose fit did not converge. ``models`` are their rows, in this order."""
    for c, m in zip(compared, models, strict=True):
        if not c.saved.converged:
            subject = f"the fit of {_subject(m, models)}" if len(models) > 1 else "the fit of the model"
            yield ResultWarning(code="model-not-converged", text=f"{unconverged_sentence(subject)}.")


def _mass_warnings(
    compared: Sequence[_Candidate], models: Sequence[ComparedModel], weighed: float | None
) -> Iterator[ResultWarning]:
    """Yield the warnings about the masses of each compared model, which begin with its label.

    ``models`` are their rows, in this order, and ``weighed`` is the weighed mass [kg] of the compared logs.
    """
    for c, m in zip(compared, models, strict=True):
        for warning in mass_warnings_of(c.saved, c.path, weighed):
            label = f"({m.label}): " if len(models) > 1 else ""
            yield msgspec.structs.replace(warning, text=label + warning.text)


def _structure_warnings(compared: Sequence[_Candidate], models: Sequence[ComparedModel]) -> Iterator[ResultWarning]:
    """Yield a warning for each compared model whose structure the residuals on these logs contradict."""
    for c, m in zip(compared, models, strict=True):
        for warning in structure_warnings(c.saved.model, m.cross, "validation"):
            label = f"({m.label}): " if len(models) > 1 else ""
            yield msgspec.structs.replace(warning, text=label + warning.text)


def _limited_warnings(
    predicted: Sequence[Mapping[str, PredictedRecord]], letters: Sequence[str]
) -> Iterator[ResultWarning]:
    """Yield a warning if a model predicts so few samples that the comparison leaves out many of the others."""
    one_step = [{record: part.errors[ONE_STEP] for record, part in by.items()} for by in predicted]
    if len(predicted) > 1 and (limited := limited_samples(one_step, letters)):
        yield ResultWarning(
            code="compared-samples-limited",
            text="Only samples that all models predict are compared, so that another model changes the numbers of the "
            f"others. One step ahead they are limited: {'; '.join(limited)}.",
        )


def _warnings(models: Sequence[ComparedModel]) -> Iterator[ResultWarning]:
    """Yield warnings for models that were fitted to a compared log, or validated on one: one for models alike."""
    unused = _unused_logs(models)
    for logs, alike in _by_logs(models, lambda m: m.fitted_to):
        were, its = ("was", "its") if len(alike) == 1 else ("were", "their")
        yield ResultWarning(
            code="compared-on-fitted-log",
            text=f"{_subjects(alike, models)} {were} fitted to {logs}: {its} errors there are smaller than on other "
            f"logs. {unused}",
        )
    for logs, alike in _by_logs(models, lambda m: m.selected_by):
        its = "its" if len(alike) == 1 else "their"
        yield ResultWarning(
            code="compared-on-validation-log",
            text=f"effects of {_subjects(alike, models).lower()}, also those of the timing and mounting of sensors and "
            f"of the hull form, were accepted by {logs}: {its} errors there may be smaller than on other logs. "
            f"{unused}",
        )
    for logs, alike in _by_logs(models, lambda m: m.widened_by):
        yield ResultWarning(
            code="intervals-from-compared-log",
            text=f"the errors on {logs} have widened the intervals of {_subjects(alike, models).lower()}, so that the "
            f"share of the errors inside is no test of the intervals. {unused}",
        )


def _by_logs(
    models: Sequence[ComparedModel], logs_of: Callable[[ComparedModel], Sequence[str]]
) -> Iterator[tuple[str, list[ComparedModel]]]:
    """Yield the models with the same logs by ``logs_of``, after the names of these logs; not those without a log."""
    groups: dict[tuple[str, ...], list[ComparedModel]] = {}
    for m in models:
        if logs := tuple(logs_of(m)):
            groups.setdefault(logs, []).append(m)
    for logs, alike in groups.items():
        yield ", ".join(logs), alike


def _subjects(alike: Sequence[ComparedModel], models: Sequence[ComparedModel]) -> str:
    """Return the labels of some models as the subject of a sentence, such as ``(a) and (b)``."""
    *first, last = (_subject(m, models) for m in alike)
    return f"{', '.join(first)} and {last}" if first else last


def _subject(m: ComparedModel, models: Sequence[ComparedModel]) -> str:
    """Return the subject of a sentence on one of the models: its label, or ``The model`` if it is the only one."""
    return f"({m.label})" if len(models) > 1 else "The model"


def _unused_logs(models: Sequence[ComparedModel]) -> str:
    """Return the advice to use other logs, in a sentence."""
    return "Compare on logs that no model has used." if len(models) > 1 else "Evaluate it on logs that it has not used."


def _by_part(predicted: Predictions) -> dict[str, PredictedRecord]:
    """Return the predictions of one model by the name of the record; of a block, by that with its number: ``run[2]``.

    The numbers count from 1 in the order of time.
    """
    found = {}
    for name, parts in predicted.items():
        for n, part in enumerate(parts, 1):
            found[name if len(parts) == 1 else f"{name}[{n}]"] = part
    return found


def _warnings_of_effects(
    compared: Sequence[_Candidate], letters: Sequence[str], predicted: Predictions
) -> Iterator[ResultWarning]:
    """Yield a warning for each model that has an effect with parameters of its own for each log.

    If the logs are cut into blocks, there is one warning for all models. ``predicted`` has the predictions of one
    model.
    """
    found = {}
    for label, c in zip(letters, compared, strict=True):
        if effects := effects_per_run(c.model):
            found[label] = "; ".join(f"{', '.join(own)} of {effect}" for effect, own in effects.items())
    numbers = [len(parts) for parts in predicted.values()]
    if found and max(numbers) > 1:
        each = " and ".join(dict.fromkeys(str(n) for n in (min(numbers), max(numbers))))
        if len(compared) == 1:
            yield ResultWarning(
                code="compared-in-blocks",
                text=f"Effects have parameters of their own for each log: {found[letters[0]]}. The model is therefore "
                f"evaluated on {each} blocks in time of each log, with the estimates of these parameters from the "
                "other blocks. The simulation starts anew in each block.",
            )
            return
        of = ", ".join(f"({label}) {names}" for label, names in found.items())
        yield ResultWarning(
            code="compared-in-blocks",
            text=f"Effects have parameters of their own for each log: {of}. All models are therefore compared on "
            f"{each} blocks in time of each log, with the estimates of these parameters from the other blocks. The "
            "simulation starts anew in each block. Errors and verdicts therefore differ from those on whole logs, also "
            f"between other models; {_how_to_compare_whole_logs(list(found), len(compared))}.",
        )
        return
    for label, names in found.items():
        yield ResultWarning(
            code="effect-estimated-on-compared-log",
            text=f"{f'({label})' if len(compared) > 1 else 'The model'} estimates parameters of an effect anew on each "
            f"compared log ({names}): its errors are "
            "those of a fit to these logs, and smaller than those of the saved model on a new log. Give longer logs or "
            f"a shorter horizon: {FEWEST_BLOCKS} blocks in time, each longer than {WARM_UP:g} s and the horizon, could "
            "be predicted with the estimates from one another.",
        )


def _how_to_compare_whole_logs(per_log: Sequence[str], n_models: int) -> str:
    """Return the advice how to compare on whole logs: without the models ``per_log``, of ``n_models`` in all."""
    others = n_models - len(per_log)
    models = " and ".join(f"({label})" for label in per_log)
    if others < 2:
        return "whole logs are possible only between models without such effects"
    return f"compare without {models} for those"


def _notes_on_logs(models: Sequence[ComparedModel]) -> list[str]:
    """Return the note that lists the parameters that are estimated anew for each log; empty if no model has any."""
    own = [f"({m.label}) {', '.join(m.per_log)}" if len(models) > 1 else ", ".join(m.per_log) for m in models
           if m.per_log]  # fmt: skip
    return [f"Estimated anew for each {'compared ' * (len(models) > 1)}log: {'; '.join(own)}."] if own else []


def _notes_on_parts(
    compared: Sequence[_Candidate], letters: Sequence[str], loaded: Sequence[LoadedLog]
) -> Iterator[str]:
    """Yield a note for each compared log of which a model was fitted to another part, without an overlap."""
    for letter, c in zip(letters, compared, strict=True):
        subject = f"({letter})" if len(compared) > 1 else "The model"
        for name, interval in other_parts(c.saved, loaded).items():
            yield (
                f"{subject} was fitted to another part of {name} ({interval}) than the compared one. Wind, current and "
                "load were probably the same: the errors on another day may be larger."
            )


def _runaway_notes(compared: Sequence[_Candidate], simulated: float, horizon: float) -> list[str]:
    """Return the note that names the unstable models, whose simulation runs away; empty without any.

    A small yaw rate of these models grows at least tenfold in ``simulated`` [s], the time of the longest simulation.
    """
    courses = [
        (label, course_at_speeds(c.saved.model, c.saved.validity))
        for label, c in zip(labels(len(compared)), compared, strict=True)
    ]
    found = [
        f"{f'({label}) at' if len(compared) > 1 else 'at'} {course.speed:.3g} m/s in {1.0 / course.pole:.2g} s"
        for label, course in courses
        if course is not None and course.pole * simulated > RUNAWAY_GROWTH
    ]
    return [
        f"{RUNS_AWAY}, as no controller holds the heading; without one a small yaw rate grows by a factor of e: "
        f"{', '.join(found)}. The errors {horizon:g} s ahead are those to compare models by."
    ] if found else []  # fmt: skip


def _traces(
    compared: Sequence[_Candidate],
    records: Sequence[Sequence[Record]],
    predicted: Sequence[Predictions],
    letters: Sequence[str],
) -> list[ComparedTrace]:
    """Return the measured channels of each record with the predictions of all models, joined over the blocks of time.

    The samples are those of the first model that predicts the channel. Instants without a sample are left out, and so
    are channels without any sample.
    """
    found = []
    for k in range(len(records[0])):
        outputs = {
            o.name: (o, own[k])
            for c, own in reversed(list(zip(compared, records, strict=True)))
            for o in c.model.outputs
        }
        for name in dict.fromkeys(o.name for c in compared for o in c.model.outputs):
            output, record = outputs[name]
            y = record.y[:, record.outputs.index(name)]
            seen = np.isfinite(y)
            if not seen.any():
                continue
            predictions = tuple(
                ComparedPrediction(
                    model=letter,
                    kind=kind.kind,
                    seconds=kind.seconds,
                    t=curve.t + record.t_from,
                    predicted=curve.y,
                    sd=curve.sd,
                    filtered=_warm_ups(by[record.name], record.t_from) if kind == SIMULATION else (),
                )
                for letter, by in zip(letters, predicted, strict=True)
                for kind in by[record.name][0].curves
                if (curve := _joined(by[record.name], kind, name)) is not None
            )
            found.append(
                ComparedTrace(
                    record=record.name,
                    channel=name,
                    unit=output.unit,
                    angle=output.angle,
                    t=record.t_log[seen],
                    measured=y[seen],
                    predictions=predictions,
                )
            )
    return found


def _warm_ups(parts: Sequence[PredictedRecord], start: float) -> tuple[tuple[float, float], ...]:
    """Return the interval of time of each block of a record in which the simulation is filtered.

    It is in the time of the log [s], in which the record begins at ``start``.
    """
    begins = [start + float(part.t[0]) for part in parts]
    return tuple((begin, begin + WARM_UP) for begin in begins)


def _joined(parts: Sequence[PredictedRecord], kind: Kind, channel: str) -> Curve | None:
    """Join the curves of a channel over all blocks of a record. Return None if no block has a prediction of it."""
    curves = [c for part in parts if (c := part.curves[kind].get(channel)) is not None]
    return Curve(*map(np.concatenate, zip(*curves, strict=True))) if curves else None


def comparison_answer(result: ComparisonResult) -> str:
    """Return the conclusion of a comparison: the best model over the first horizon, and its error over all channels.

    For one model alone, it is its fit over the first horizon, and the share of the errors inside its 95 % intervals.

    Parameters
    ----------
    result : ComparisonResult
        The comparison; its field ``answer`` is not used.
    """
    if result.is_evaluation:
        return _evaluation_answer(result)
    seconds = result.horizons[0]
    first, *others = result.models
    shown = [(m, ratio) for m in others if (ratio := m.ahead(seconds)) is not None]
    if not shown:
        return f"The logs have no prediction {seconds:g} s ahead that can be compared."
    by_label = {m.label: m for m in result.models}
    chosen = result.significantly_best
    if chosen is not None:
        best = by_label[chosen]
        words = f"Best {seconds:g} s ahead: ({best.label}) {best.name}"
        beside = [(m, r) for m in result.models if (r := result.ratio(m.label, chosen, seconds)) is not None]
        equal = [m for m, r in beside if r.verdict == "indistinguishable" and r.ratio >= 1.0]
        smaller = [(m, r) for m, r in beside if r.verdict == "indistinguishable" and r.ratio < 1.0]
        worse = [(m, r) for m, r in beside if r.verdict == "worse"]
        if equal:
            words += f", without a clear difference over all channels from {_listed(equal)}"
        # The first model is the one that the user compares with. If it is not worse, the nearest one that is.
        against = next((m for m, _ in worse if m is first), None) or min(worse, key=lambda row: row[1].ratio)[0]
        of, reference = (against, best) if best is first else (best, against)
        words += "." + _change_sentence(result, of, reference, seconds)
        words += "".join(
            f" The error of ({m.label}) {m.name} is smaller still, but differs too much between the blocks of time for "
            f"a verdict.{_change_sentence(result, m, best, seconds)}"
            for m, _ in smaller
        )
        if others_worse := [(m, r) for m, r in worse if m is not against]:
            words += f" {_worse_words(others_worse, best)}"
        words += _simplest([best, *equal, *(m for m, _ in smaller)])
        return words + _other_horizons(result, of, reference)
    if all(ratio.verdict == "no-interval" for _, ratio in shown):
        blocks = f" (no interval: {counted(n, 'block')})" if (n := shown[0][1].blocks) is not None else ""
        words = f"The logs are too short for a verdict {seconds:g} s ahead{blocks}."
        if len(shown) > 1:
            return words
        words += f" {_change_words(*shown[0], first)}"
    elif len(shown) == 1:
        words = f"No clear difference between {_listed([first, shown[0][0]])} {seconds:g} s ahead."
        words += f" {_change_words(*shown[0], first)}{_simplest([first, shown[0][0]])}"
    else:
        least, compared = by_label[result.best], [first, *(m for m, _ in shown)]
        words = f"No model is significantly better than another one {seconds:g} s ahead. The smallest error over all "
        return words + f"channels is that of ({least.label}) {least.name}.{_simplest(compared)}"
    return words + _other_horizons(result, shown[0][0], first)


def _listed(models: Sequence[ComparedModel]) -> str:
    """Return the labels and names of models, joined by commas and "and"."""
    *before, last = (f"({m.label}) {m.name}" for m in models)
    return f"{', '.join(before)} and {last}" if before else last


def _simplest(models: Sequence[ComparedModel]) -> str:
    """Return a sentence, after a space, that names the model with the fewest estimated parameters.

    It is empty for one model, and if several models have as few parameters. ``models`` have no clear difference.
    """
    ordered = sorted(models, key=lambda m: m.n_free)
    if len(ordered) < 2 or ordered[0].n_free == ordered[1].n_free:
        return ""
    least = ordered[0]
    beside = " and ".join(str(n) for n in sorted({m.n_free for m in ordered[1:]}))
    return (
        f" The simple{'r' if len(ordered) == 2 else 'st'} of these without a clear difference is ({least.label}) "
        f"{least.name}: it has {least.n_free} estimated parameters, and not {beside}."
    )


def _change_sentence(result: ComparisonResult, model: ComparedModel, reference: ComparedModel, seconds: float) -> str:
    """Return, after a space, the sentence on the error of a model against another one; empty without their ratio."""
    ratio = result.ratio(model.label, reference.label, seconds)
    return "" if ratio is None else f" {_change_words(model, ratio, reference)}"


def _worse_words(worse: Sequence[tuple[ComparedModel, ComparedRatio]], reference: ComparedModel) -> str:
    """Return a sentence that names the models whose error is significantly larger than that of the reference.

    The models with the smallest error come first.
    """
    ordered = sorted(worse, key=lambda row: row[1].ratio)
    names = ", ".join(f"({m.label}) {m.name} (error {ratio.ratio:.3g} times as large)" for m, ratio in ordered)
    return f"Significantly worse than ({reference.label}): {names}."


def _evaluation_answer(result: ComparisonResult) -> str:
    """Return the conclusion of the evaluation of one model: fit and coverage over the first horizon.

    The fit of all channels is that of the answer of `seatrial ident vehicle` (`PredictionFit`). The coverage is of the
    errors of all channels together. Channels whose intervals are too narrow or too wide by the test of
    calibration are named.
    """
    seconds, label = result.horizons[0], result.models[0].label
    rows = [(row, e) for row in result.channels if row.seconds == seconds for e in row.errors if e.model == label]
    errors = [1.0 - e.fit for _, e in rows if e.fit is not None]
    if not errors:
        return f"The logs have no prediction {seconds:g} s ahead."
    fit = 1.0 - geometric_mean(errors)
    words = f"{seconds:g} s ahead the fit of all channels is {100.0 * fit:.0f} %"
    if len(errors) > 1:
        words += f" ({FIT_OF_ALL} of {len(errors)} channels)"
    if (inside := result.inside_95("horizon", seconds, label)) is not None:
        words += f"; {100.0 * inside:.0f} % of the errors of all channels lie inside the 95 % intervals"
    words += "."
    for verdict, width in (("overconfident", "narrow"), ("underconfident", "wide")):
        if names := [row.channel for row, e in rows if e.intervals == verdict]:
            words += f" The intervals of {', '.join(names)} are too {width}."
    return words


def _change_words(model: ComparedModel, ratio: ComparedRatio, reference: ComparedModel) -> str:
    """Return a sentence on the error of a model over all channels against that of the reference."""
    return (
        f"The error of ({model.label}) over all channels is {_size_of_change(ratio, 'than that of')} "
        f"({reference.label}){_interval_of_change(ratio)}."
    )


def _other_horizons(result: ComparisonResult, model: ComparedModel, reference: ComparedModel) -> str:
    """Return a sentence, after a space, on the error of a model against another one over the further horizons.

    It is empty without any.
    """
    ratios = ((s, result.ratio(model.label, reference.label, s)) for s in result.horizons[1:])
    changes = [(s, ratio) for s, ratio in ratios if ratio is not None]
    if not changes:
        return ""
    words = ", ".join(f"{_size_of_change(r)} {s:g} s ahead{_interval_of_change(r)}" for s, r in changes)
    subject = "It" if len(result.models) == 2 else f"Against ({reference.label}), that of ({model.label})"
    return f" {subject} is {words}."


def _size_of_change(ratio: ComparedRatio, than: str = "") -> str:
    """Return by how much an error is smaller or larger, as text, such as ``14 % smaller``, with ``than`` after it."""
    by = 100.0 * (ratio.ratio - 1.0)
    return f"{abs(by):.0f} % {'smaller' if by < 0.0 else 'larger'} {than}".rstrip()


def _interval_of_change(ratio: ComparedRatio) -> str:
    """Return the 95 % interval of a change in per cent, as text behind its size."""
    if ratio.low is None or ratio.high is None:
        return ", without an interval"
    low, high = (f"{100.0 * (r - 1.0):+.0f}".replace("-", "−") for r in (ratio.low, ratio.high))
    return f" (95 %: {low} to {high} %)"
