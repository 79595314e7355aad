"""Workflow of `seatrial ident compare`: comparison of the predictions of several fitted models on the same logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.errors import SeatrialError
from seatrial.ident.checks import device_faults
from seatrial.ident.data import WHOLE, LoadedLog, Record, TimeWindows, load_all, make_record
from seatrial.ident.estimation import RecordEvaluation, SavedModel, evaluate_records, load_model
from seatrial.ident.model import Model
from seatrial.ident.numerics import chi2_sf, student_ppf
from seatrial.ident.reporter import Reporter
from seatrial.ident.validation import PredictionChange, PredictionErrors, horizon_errors, prediction_change_by_record
from seatrial.ident.workflows.check import check_first
from seatrial.ident.workflows.model_inputs import check_horizon, hold_lines, in_one_frame, model_of_logs

FEWEST_BLOCKS = 4  # blocks of time that an interval of the log score needs


@dataclass(frozen=True)
class CompareRequest:
    """Options of `seatrial ident compare`.

    Attributes
    ----------
    models
        The model.toml of each model; at least two. The first one is the reference.
    logs
        Logs on which the models are compared.
    horizon
        Prediction horizon [s]; None: that of the first model.
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
    """

    models: Sequence[Path]
    logs: Sequence[Path]
    horizon: float | None = None
    rate: float | None = None
    thruster: str | None = None
    despite_faults: bool = False
    window: TimeWindows = WHOLE


@dataclass(frozen=True)
class LogScore:
    """Difference of two models in the log-likelihood of the samples, each predicted one step ahead.

    The log-likelihood is the logarithmic score of the predictions (Gneiting and Raftery 2007). It needs no correction
    for the number of parameters if neither model was fitted to these logs.

    Attributes
    ----------
    gain
        Log-likelihood of the second model less that of the first.
    low, high
        95 % interval of the gain, by Student's t over blocks of time; NaN for fewer than four blocks.
    blocks
        Number of blocks of time into which the logs are divided. The blocks are so long that their gains are nearly
        independent.
    """

    gain: float
    low: float
    high: float
    blocks: int

    @property
    def verdict(self) -> str:
        """Result for the second model: ``better`` or ``worse`` if the interval excludes zero, otherwise ``unchanged``.

        It is ``unchanged`` without an interval.
        """
        return "better" if self.low > 0.0 else "worse" if self.high < 0.0 else "unchanged"


@dataclass(frozen=True)
class InformationCriteria:
    """Criteria of two maximum likelihood fits to the same logs, the second model against the first.

    Attributes
    ----------
    gain
        Log-likelihood of the second model less that of the first.
    parameters
        Number of estimated parameters of the second model less that of the first.
    aic, bic
        Change of Akaike's and of the Bayesian information criterion; negative if the second model is better.
    p
        p value of the likelihood-ratio test of the hypothesis that the additional parameters of the second model are
        not needed. None unless the first model is the second one with some of its free parameters fixed or missing.
    """

    gain: float
    parameters: int
    aic: float
    bic: float
    p: float | None


@dataclass(frozen=True)
class ComparedModel:
    """One model of a comparison.

    Attributes
    ----------
    name
        Path of its model.toml.
    saved
        The model with its estimates.
    rms
        RMS prediction error over the horizon by channel, over all logs, in the unit of the channel; infinite if a
        prediction diverged.
    fitted_to_logs
        Names of the logs of the comparison that the model was fitted to. Its errors on them are too small.
    change
        Change of the prediction errors from the first model to this one; None for the first model.
    score
        Difference in log-likelihood of the samples from the first model to this one. None for the first model, and if
        the models do not predict the same samples.
    criteria
        Information criteria of this model against the first one. None for the first model, and if ``no_criteria`` is
        not empty.
    no_criteria
        Reason why there are no information criteria; empty for the first model, and if there are criteria.
    """

    name: str
    saved: SavedModel
    rms: Mapping[str, float]
    fitted_to_logs: tuple[str, ...]
    change: PredictionChange | None = None
    score: LogScore | None = None
    criteria: InformationCriteria | None = None
    no_criteria: str = ""

    @property
    def n_free(self) -> int:
        """Number of estimated parameters with one value for all logs; per-record parameters are not counted."""
        return sum(p.free and not p.per_record for p in self.saved.model.parameters)


@dataclass(frozen=True)
class ModelComparison:
    """Comparison of models on the same logs.

    Attributes
    ----------
    horizon
        Prediction horizon [s].
    units
        Unit of each output channel, by name of the channel.
    models
        The compared models in the order of the request. The first one is the reference.
    """

    horizon: float
    units: Mapping[str, str]
    models: tuple[ComparedModel, ...]


def compare_models(request: CompareRequest, reporter: Reporter) -> ModelComparison:
    """Predict the same logs by several fitted models, and compare the predictions with those of the first model.

    Each model keeps its estimates. Only the parameters that belong to a log, such as the current, are estimated anew
    for each log and model.

    Parameters
    ----------
    request : CompareRequest
        Models, logs and options.
    reporter : Reporter
        Receives progress.

    Returns
    -------
    ModelComparison
        Prediction errors of each model, and its differences to the first model.

    Raises
    ------
    SeatrialError
        If there are fewer than two models, if a file cannot be read, if the logs have faults that make a fit
        meaningless (unless ``despite_faults``), if no log is longer than a given horizon, or if a model cannot predict
        a log.
    """
    if len(request.models) < 2:
        raise SeatrialError("a comparison needs two models or more; give another model.toml")
    loaded, _ = load_all(request.logs, [], request.window, device_faults)
    check_horizon(request.horizon, loaded, [])
    saved = [load_model(path) for path in request.models]
    loaded, _ = check_first(loaded, [], saved[0].model, request.despite_faults)
    horizon, rate = request.horizon or saved[0].model.horizon, request.rate
    compared: list[tuple[SavedModel, list[RecordEvaluation], dict[str, dict[str, PredictionErrors]]]] = []
    for path, known in zip(request.models, saved, strict=True):
        reporter.progress(f"predicting the logs by {path}")
        for line in hold_lines(known, loaded):
            reporter.warning(f"{path}: {line}")
        # First order, so that the likelihoods of all models are comparable.
        model = replace(known.model, second_order=False)
        placed, _ = in_one_frame(model, loaded, [], known.origin)
        model, segments, _, usual = model_of_logs(model, path, placed, [], request.thruster)
        rate = rate or usual
        views, failed = evaluate_records(model, [make_record(model, s, rate) for s in segments])
        if failed:
            raise SeatrialError(
                f"{path}: this model cannot predict {failed[0].record}: {failed[0].reason}; leave out this log or model"
            )
        errors = {v.record.name: horizon_errors(v.model, v.record, v.values, v.run.x_filt, horizon) for v in views}
        compared.append((known, views, errors))
    first, rows = compared[0], list[ComparedModel]()
    for path, (known, views, errors) in zip(request.models, compared, strict=True):
        row = ComparedModel(str(path), known, _rms_by_channel(errors), _logs_of_fit(known, loaded))
        if rows:
            score = _log_score(first[1], views)
            reason = _why_not_comparable(rows[0], row, loaded, score)
            criteria = None
            if score is not None and not reason:
                criteria = _criteria(first[0].model, known.model, first[1], score.gain)
            change = prediction_change_by_record(first[2], errors, horizon)
            row = replace(row, change=change, score=score, criteria=criteria, no_criteria=reason)
        rows.append(row)
    units = {o.name: o.unit for known, _, _ in compared for o in known.model.outputs}
    return ModelComparison(horizon, units, tuple(rows))


def _logs_of_fit(saved: SavedModel, logs: Sequence[LoadedLog]) -> tuple[str, ...]:
    """Return the names of those of ``logs`` that the model ``saved`` was fitted to.

    A log is recognised by its hash, which the model file lists. A log of which only an interval was read has no hash
    and is recognised by the name of its file.
    """
    used = [str(line) for line in saved.provenance.get("logs", ())]
    found = []
    for log in logs:
        digest, name = str(log.about.get("sha256") or "")[:16], Path(str(log.about["path"])).name.partition("[")[0]
        if any(digest in line if digest else Path(line.partition(" sha256:")[0]).name == name for line in used):
            found.append(log.run.name)
    return tuple(found)


def _why_not_comparable(
    first: ComparedModel, second: ComparedModel, logs: Sequence[LoadedLog], score: LogScore | None
) -> str:
    """Return the reason why there are no information criteria of two models; an empty text if they are valid.

    They are valid if both models were fitted to exactly the compared ``logs``, each read as a whole, by maximum
    likelihood without REML and with a first-order filter. ``score``: difference of the models in log-likelihood; None
    if they do not predict the same samples.
    """
    if score is None:
        return "the models do not predict the same samples"
    if any(not log.about.get("sha256") for log in logs):
        return "only a part of a log is used, and a model file does not contain the part that it was fitted to"
    both = (first, second)
    if any(len(m.fitted_to_logs) != len(logs) or len(m.saved.provenance["logs"]) != len(logs) for m in both):
        return "not all models were fitted to exactly these logs"
    if any(m.saved.reml for m in both):
        return "a model was fitted with REML, whose noise is not that of the largest likelihood (fit with --no-reml)"
    if any(m.saved.model.second_order for m in both):
        return "a model was fitted with a second-order filter (fit with --no-second-order)"
    return ""


def _criteria(first: Model, second: Model, first_views: Sequence[RecordEvaluation], gain: float) -> InformationCriteria:
    """Return the information criteria of the second of two fitted models against the first.

    Parameters
    ----------
    first, second : Model
        The models with their estimates.
    first_views : sequence of RecordEvaluation
        Evaluation of the first model on each record. The evaluation of the second model has the same samples.
    gain : float
        Log-likelihood of the second model less that of the first.

    Returns
    -------
    InformationCriteria
        Its p value is None unless the first model is the second one with at least one free parameter fixed or missing.
    """
    more = _n_estimates(second, len(first_views)) - _n_estimates(first, len(first_views))
    n = sum(int(np.isfinite(v.record.y).sum()) for v in first_views)
    p = float(chi2_sf(2.0 * max(gain, 0.0), more)) if more > 0 and _is_nested(first, second) else None
    return InformationCriteria(gain, more, 2.0 * (more - gain), more * float(np.log(n)) - 2.0 * gain, p)


def _n_estimates(model: Model, n_records: int) -> int:
    """Return the number of estimates of a fit to ``n_records`` records; a per-record parameter has one per record."""
    return sum(n_records if p.per_record else 1 for p in model.parameters if p.free)


def _is_nested(first: Model, second: Model) -> bool:
    """Return whether the first model is the second model with some (or none) of its free parameters fixed or missing.

    Both models must have the same source (name of the structure). Each parameter of the first must exist in the second,
    and each free parameter of the first must be free there. A parameter that is fixed in the second must have the same
    value in the first, to nine digits or to 1e-8 in its unit.
    """
    free = [{p.name for p in m.parameters if p.free} for m in (first, second)]
    fixed = [p for p in second.parameters if not p.free and p.name in first.values]
    return (
        first.source == second.source
        and set(first.values) <= set(second.values)
        and free[0] <= free[1]
        and all(np.isclose(first.values[p.name], p.value, rtol=1e-9) for p in fixed)
    )


def _rms_by_channel(errors: Mapping[str, Mapping[str, PredictionErrors]]) -> dict[str, float]:
    """Return the RMS prediction error of each channel over all records, in the unit of the channel.

    ``errors`` has the prediction errors by record and channel. The mean is over the errors of all records together, not
    over the records. The RMS error is infinite if a prediction diverged.
    """
    names = dict.fromkeys(name for by_channel in errors.values() for name in by_channel)
    pooled = {n: np.concatenate([by[n].e for by in errors.values() if n in by]) for n in names}
    return {n: float(np.sqrt(np.mean(e**2))) for n, e in pooled.items()}


def _log_score(before: Sequence[RecordEvaluation], after: Sequence[RecordEvaluation]) -> LogScore | None:
    """Return the difference in log-likelihood of the samples between two models, ``before`` and ``after``.

    Each sequence has the evaluation of a model on the same logs in the same order. The blocks of time are twice as long
    as residuals may be correlated; the last one of a log has up to twice this length. Only the time that both records
    of a log cover is used. The result is None if the models do not predict the same number of samples of each channel
    in it: then the likelihoods are not comparable. The interval is NaN with fewer than four blocks.
    """
    gains: list[float] = []
    for a, b in zip(before, after, strict=True):
        # Only the time that both records cover: the inputs of the models may begin and end at different times.
        begin, end = max(a.record.t[0], b.record.t[0]), min(a.record.t[-1], b.record.t[-1])
        inside = [(v.record.t >= begin) & (v.record.t <= end) for v in (a, b)]
        if _samples_by_channel(a.record, inside[0]) != _samples_by_channel(b.record, inside[1]):
            return None
        # Blocks of twice the time over which residuals may be correlated; the last one is the longest.
        length = 2.0 * a.model.block
        last = max(int((end - begin) / length) - 1, 0)
        sums = []
        for v, rows in zip((a, b), inside, strict=True):
            block = np.minimum((v.record.t[rows] - begin) // length, last).astype(int)
            sums.append(np.bincount(block, v.ll[rows], last + 1))
        gains += (sums[1] - sums[0]).tolist()
    gain, n = float(np.sum(gains)), len(gains)
    if n < FEWEST_BLOCKS:
        return LogScore(gain, float("nan"), float("nan"), n)
    reach = float(student_ppf(0.975, n - 1) * np.std(gains, ddof=1) * np.sqrt(n))
    return LogScore(gain, gain - reach, gain + reach, n)


def _samples_by_channel(record: Record, rows: NDArray[np.bool_]) -> dict[str, int]:
    """Return the number of samples of each channel in the rows of a record for which the mask ``rows`` is true.

    Channels without samples in these rows are left out.
    """
    counts = np.isfinite(record.y[rows]).sum(axis=0).tolist()
    return {name: n for name, n in zip(record.outputs, counts, strict=True) if n}


def comparison_table(found: ModelComparison) -> dict[str, Any]:
    """Return a comparison as a mapping for JSON, with the numbers that `comparison_lines` prints and their intervals.

    The first model has no `change`, `score` and `criteria` (None), which compare a model with the first one.
    """
    models = [
        {
            "model": m.name,
            "n_free": m.n_free,
            "rms": dict(m.rms),
            "fitted_to_logs": list(m.fitted_to_logs),
            "change": m.change
            and {"ratio": m.change.ratio, "low": m.change.low, "high": m.change.high, "verdict": m.change.verdict},
            "score": m.score and {**asdict(m.score), "verdict": m.score.verdict},
            "criteria": m.criteria and asdict(m.criteria),
            "no_criteria": m.no_criteria,
        }
        for m in found.models
    ]
    return {"kind": "comparison", "horizon": found.horizon, "units": dict(found.units), "models": models}


def comparison_lines(found: ModelComparison, names: Sequence[str] | None = None) -> list[str]:
    """Return a comparison as lines of text.

    The lines are the list of models, a table of the RMS prediction errors by channel, the differences of each model to
    the first one, and warnings about models that were fitted to the compared logs. The models have the
    labels (a), (b), ... in their order. The table shows ``-`` for a channel that a model does not predict.

    Parameters
    ----------
    found : ModelComparison
        The comparison.
    names : sequence of str, optional
        Names of the models, in their order; by default the paths of their files.
    """
    names = list(names or (m.name for m in found.models))
    channels = list(dict.fromkeys(n for m in found.models for n in m.rms))
    head = ["", "unit", *(f"({chr(ord('a') + k)})" for k in range(len(names)))]
    table = [head, *([c, found.units[c], *(_error_text(m.rms.get(c)) for m in found.models)] for c in channels)]
    widths = [max(len(row[k]) for row in table) for k in range(len(head))]
    lines = [
        f"({chr(ord('a') + k)}) {name}, {m.n_free} free parameters"
        for k, (name, m) in enumerate(zip(names, found.models, strict=True))
    ]
    lines += ["", f"RMS prediction error {found.horizon:g} s ahead"]
    for row in table:
        left = [cell.ljust(w) for cell, w in zip(row[:2], widths[:2], strict=True)]
        lines.append("  ".join([*left, *(c.rjust(w) for c, w in zip(row[2:], widths[2:], strict=True))]).rstrip())
    for k, m in enumerate(found.models):
        if m.change is not None:
            lines += ["", f"({chr(ord('a') + k)}) against (a): {_change_text(m.change)}", _score_text(m.score)]
            lines.append(_criteria_text(m))
    for k, m in enumerate(found.models):
        if m.fitted_to_logs:
            lines.append(
                f"({chr(ord('a') + k)}) was fitted to {', '.join(m.fitted_to_logs)}: its errors there are smaller than "
                "on other logs. Compare on logs that no model has used."
            )
    return lines


def _error_text(error: float | None) -> str:
    """Return the text of an RMS error: a number of three digits, or ``diverged`` if it is not finite.

    The text for None, a channel that the model does not predict, is ``-``.
    """
    return "-" if error is None else f"{error:.3g}" if np.isfinite(error) else "diverged"


def _change_text(change: PredictionChange) -> str:
    """Return a sentence on the change of the prediction error of all channels, with its 95 % interval.

    Without a finite interval the sentence has no verdict, and states that the logs are too short.
    """
    by, low, high = (100.0 * (r - 1.0) for r in (change.ratio, change.low, change.high))
    if not np.isfinite(low):
        return f"the prediction error of all channels changes by {by:+.0f} %; the logs are too short for an interval."
    verdict = {"fell": "smaller", "rose": "larger", "unchanged": "not significantly different"}[change.verdict]
    return f"the prediction error of all channels is {verdict}: {by:+.0f} % (95 %: {low:+.0f} to {high:+.0f} %)."


def _score_text(score: LogScore | None) -> str:
    """Return a sentence on the difference of two models in log-likelihood, or on its absence if ``score`` is None."""
    if score is None:
        return "The models do not predict the same samples, so their likelihoods are not compared."
    interval = f" (95 %: {score.low:.1f} to {score.high:.1f})" if np.isfinite(score.low) else ""
    verdict = {"better": "better", "worse": "worse", "unchanged": "not significantly different"}[score.verdict]
    return f"One step ahead it is {verdict}: log-likelihood {score.gain:+.1f}{interval}, {score.blocks} blocks of time."


def _criteria_text(m: ComparedModel) -> str:
    """Return a sentence with the information criteria of a compared model, or with the reason why there are none."""
    c = m.criteria
    if c is None:
        return f"AIC, BIC and likelihood ratio are not given: {m.no_criteria}."
    ratio = "" if c.p is None else f"; likelihood ratio {2 * c.gain:.1f} for {c.parameters} parameters, p = {c.p:.2g}"
    return f"On the data of both fits: Delta AIC {c.aic:+.1f}, Delta BIC {c.bic:+.1f}{ratio}."
