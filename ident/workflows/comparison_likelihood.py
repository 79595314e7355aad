"""Comparison of the likelihoods of two models: log score, AIC, BIC and likelihood ratio, where they are comparable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from seatrial.ident.data import LoadedLog, LogPart, part_of_line, part_of_log
from seatrial.ident.estimation import SavedModel
from seatrial.ident.model import Model
from seatrial.ident.numerics import chi2_sf, student_ppf
from seatrial.ident.results import ComparisonVerdict, InformationCriteria, LogScore, finite
from seatrial.ident.workflows.compared_predictions import PredictedRecord

FEWEST_BLOCKS = 4  # blocks of time that an interval of the log score needs


def log_score(
    before: Mapping[str, PredictedRecord], after: Mapping[str, PredictedRecord], block: float, held_out: bool
) -> LogScore | None:
    """Return the difference in log-likelihood of the samples between two models, ``before`` and ``after``.

    The result is None if the models do not predict the same number of samples of each channel: then the likelihoods are
    not comparable. The interval is missing with fewer than four blocks.

    Parameters
    ----------
    before, after : mapping
        Predictions of each model by record, in the same order. All records cover the same time for both models.
    block : float
        Length of a block of time [s]: twice the time over which residuals may be correlated. The last block of a record
        has up to twice this length.
    held_out : bool
        Whether neither model was fitted to any of the records.
    """
    gains: list[float] = []
    for a, b in zip(before.values(), after.values(), strict=True):
        if a.samples != b.samples:
            return None
        start = min(a.t[0], b.t[0])  # a block in time of a log begins later than its log
        last = max(int((a.t[-1] - start) / block) - 1, 0)
        blocks = (np.minimum((r.t - start) // block, last).astype(int) for r in (a, b))
        sums = [np.bincount(index, r.ll, last + 1) for index, r in zip(blocks, (a, b), strict=True)]
        gains += (sums[1] - sums[0]).tolist()
    gain, n, reach = float(np.sum(gains)), len(gains), float("nan")
    if n >= FEWEST_BLOCKS:
        reach = float(student_ppf(0.975, n - 1) * np.std(gains, ddof=1) * np.sqrt(n))
    verdict: ComparisonVerdict = "better" if gain > reach else "worse" if gain < -reach else "indistinguishable"
    low, high = finite(gain - reach), finite(gain + reach)
    if low is None or high is None:
        verdict = "no-interval"
    return LogScore(gain=gain, low=low, high=high, blocks=n, verdict=verdict, held_out=held_out)


def used_logs(
    saved: SavedModel, logs: Sequence[LoadedLog], use: Literal["logs", "validation"] = "logs"
) -> tuple[str, ...]:
    """Return the names of those of ``logs`` that the model ``saved`` was fitted to, or validated on.

    A log is recognised by its hash, which the model file lists, or by the name of its file if the model file lacks the
    hash. Of a log in parts, a part counts if it overlaps with a part in the model file.
    """
    used = _parts_in(saved, use)
    return tuple(log.run.name for log in logs if any(part_of_log(log.about).overlap(part) for part in used))


def has_selected_effects(saved: SavedModel) -> bool:
    """Return whether validation logs have accepted effects of a model.

    The model file lists these effects. Of an older file without the list, every effect of the boat counts.
    """
    selected = saved.provenance.get("selected")
    return any(not e.kind.nuisance for e in saved.model.effects) if selected is None else bool(selected)


def other_parts(saved: SavedModel, logs: Sequence[LoadedLog]) -> dict[str, str]:
    """Return the intervals of the parts that the model was fitted to, of those ``logs`` of which it used other parts.

    The keys are the names of the logs. A log that overlaps with a part that the model was fitted to is left out.
    """
    used, found = _parts_in(saved, "logs"), dict[str, str]()
    for log in logs:
        own = part_of_log(log.about)
        of_file = [part for part in used if part.same_file(own)]
        if of_file and not any(part.overlap(own) for part in of_file):
            found[log.run.name] = ", ".join(part.interval for part in of_file)
    return found


def _parts_in(saved: SavedModel, use: Literal["logs", "validation"]) -> list[LogPart]:
    """Return the logs, or the parts of logs, that the model was fitted to or validated on, by its file."""
    return [part_of_line(str(line)) for line in saved.provenance.get(use, ())]


def why_not_comparable(
    saved: tuple[SavedModel, SavedModel],
    fitted_to: tuple[Sequence[str], Sequence[str]],
    logs: Sequence[LoadedLog],
    score: LogScore | None,
) -> str:
    """Return the reason why there are no information criteria of two models; an empty text if they are valid.

    They are valid if both models were fitted to exactly the compared ``logs``, or parts of logs, by maximum likelihood
    without REML and with a first-order filter.

    Parameters
    ----------
    saved : tuple of SavedModel
        Both models.
    fitted_to : tuple of sequence of str
        Names of the compared logs that each model was fitted to (`used_logs`).
    logs : sequence of LoadedLog
        The compared logs.
    score : LogScore or None
        Difference of the models in log-likelihood; None if they do not predict the same samples.
    """
    if score is None:
        return "the models do not predict the same samples"
    parts = [part_of_log(log.about) for log in logs]
    for m, own in zip(saved, fitted_to, strict=True):
        used = _parts_in(m, "logs")
        if len(own) != len(logs) or len(used) != len(logs):
            return "not all models were fitted to exactly these logs"
        if any((a.t_from, a.t_to) not in [(b.t_from, b.t_to) for b in used if b.same_file(a)] for a in parts):
            return "a model was fitted to another part of a compared log"
    if any(m.reml for m in saved):
        return "a model was fitted with REML, whose noise is not that of the largest likelihood (fit with --no-reml)"
    if any(m.model.second_order for m in saved):
        return "a model was fitted with a second-order filter (fit with --no-second-order)"
    return ""


def information_criteria(
    first: Model, second: Model, records: Mapping[str, PredictedRecord], gain: float
) -> InformationCriteria:
    """Return the information criteria of the second of two fitted models against the first.

    Parameters
    ----------
    first, second : Model
        The models with their estimates.
    records : mapping
        Predictions of one model by record. The other model predicts the same samples.
    gain : float
        Log-likelihood of the second model less that of the first.

    Returns
    -------
    InformationCriteria
        Its p value is None unless the first model is the second one with at least one free parameter fixed or missing.
    """
    more = _n_estimates(second, len(records)) - _n_estimates(first, len(records))
    n = sum(sum(r.samples.values()) for r in records.values())
    p = float(chi2_sf(2.0 * max(gain, 0.0), more)) if more > 0 and _is_nested(first, second) else None
    aic, bic = 2.0 * (more - gain), more * float(np.log(n)) - 2.0 * gain
    return InformationCriteria(gain=gain, parameters=more, aic=aic, bic=bic, p=p)


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
