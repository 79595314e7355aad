"""Comparison of the prediction errors of several models: errors at common samples, ratios and the best model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, reduce

import numpy as np

from seatrial.ident.numerics import Array
from seatrial.ident.results import (
    MOST_OF_ERROR,
    ComparedChannel,
    ComparedError,
    ComparedRatio,
    ComparisonVerdict,
    finite,
)
from seatrial.ident.validation import (
    Calibration,
    ErrorRatio,
    PredictionErrors,
    concentrated_errors,
    pooled_calibration,
    pooled_errors,
    prediction_change_by_record,
    without_spans,
)
from seatrial.ident.workflows.compared_predictions import SIMULATION, Kind, PredictedRecord
from seatrial.ident.workflows.dynamics import Z95

VERDICTS: Mapping[str, ComparisonVerdict] = {"fell": "better", "rose": "worse", "unchanged": "indistinguishable"}
MOST_SAMPLES_LOST = 0.1  # share of the samples of a channel that a comparison may leave out without a word
ErrorsByRecord = Mapping[str, Mapping[str, PredictionErrors]]


def at_common_samples(models: Sequence[ErrorsByRecord]) -> list[dict[str, dict[str, PredictionErrors]]]:
    """Return the errors of each model, by record and channel, at the samples that all models predict.

    A channel that a model predicts in no record does not count for this model. A channel that a model predicts only in
    some records is left out of the others for all models.

    Parameters
    ----------
    models : sequence of mapping
        Errors of each model by record and channel. All have the same records, whose times count from one instant.
    """
    predicts = [{name for by in model.values() for name in by} for model in models]
    found: list[dict[str, dict[str, PredictionErrors]]] = [{record: {} for record in model} for model in models]
    for name in dict.fromkeys(n for model in models for by in model.values() for n in by):
        owners = [k for k, names in enumerate(predicts) if name in names]
        for record in models[0]:
            if all(name in models[k][record] for k in owners):
                own = [models[k][record][name] for k in owners]
                t = reduce(np.intersect1d, [e.t for e in own])
                for k, e in zip(owners, own, strict=True):
                    at = np.searchsorted(e.t, t)
                    if t.size:
                        found[k][record][name] = PredictionErrors(t, e.e[at], e.about[at])
    return found


def limited_samples(models: Sequence[ErrorsByRecord], labels: Sequence[str]) -> list[str]:
    """Return for each channel with a loss of samples how many are compared, of how many, and which model limits them.

    A loss is at least a tenth of the samples that the model with most samples of the channel predicts. The limiting
    model is the one without which most samples would be common; of equal ones that with the fewest samples.

    Parameters
    ----------
    models : sequence of mapping
        Errors of each model by record and channel, as for `at_common_samples`.
    labels : sequence of str
        Labels of the models.
    """

    def count(some: Sequence[ErrorsByRecord], name: str) -> int:
        """Return the number of samples of a channel in all records of the first of some models that predicts it."""
        return max((sum(by[name].t.size for by in m.values() if name in by) for m in some), default=0)

    common, found = at_common_samples(models), []
    for name in dict.fromkeys(n for model in models for by in model.values() for n in by):
        owners = [k for k, m in enumerate(models) if any(name in by for by in m.values())]
        n, most = count(common, name), max(count([models[k]], name) for k in owners)
        if n > (1.0 - MOST_SAMPLES_LOST) * most:
            continue
        without = {k: count(at_common_samples([models[j] for j in owners if j != k]), name) for k in owners}
        limiting = max(owners, key=lambda k: (without[k], -count([models[k]], name)))
        found.append(f"{name} {n} of {most} samples, by ({labels[limiting]})")
    return found


def calibration_at(
    kind: Kind, errors: ErrorsByRecord, predicted: Mapping[str, PredictedRecord]
) -> dict[str, Calibration]:
    """Test the prediction intervals of one model by its errors at the given samples, for each channel.

    Parameters
    ----------
    kind : Kind
        Kind of prediction.
    errors : mapping
        Errors by record and channel, at the samples that count.
    predicted : mapping
        All predictions of the model by record.

    Returns
    -------
    dict of str to Calibration
        Calibration by channel, of all records together. Channels without standard deviations are left out. If the 95 %
        intervals of a channel are useless, its ``inside_95`` is NaN: they are wider than the range of its values, so
        that (almost) all errors are inside whatever the prediction is.
    """
    by_record = []
    widths: dict[str, list[Array]] = {}
    ranges: dict[str, float] = {}
    for record, by_name in errors.items():
        own, z = predicted[record].errors[kind], predicted[record].standardised.get(kind, {})
        by_record.append({n: z[n][np.searchsorted(own[n].t, e.t)] for n, e in by_name.items() if n in z})
        for n, curve in predicted[record].curves.get(kind, {}).items():
            if n in by_name and by_name[n].about.size:
                at = np.minimum(np.searchsorted(curve.t, by_name[n].t), curve.t.size - 1)
                widths.setdefault(n, []).append(2.0 * Z95 * curve.sd[at])
                ranges[n] = max(ranges.get(n, 0.0), float(np.ptp(by_name[n].about)))
    useless = {n for n, found in widths.items() if np.median(np.concatenate(found)) > ranges[n]}
    tested = pooled_calibration(by_record, together=kind == SIMULATION)
    return {n: replace(c, inside_95=float("nan")) if n in useless else c for n, c in tested.items()}


def channel_rows(
    kind: Kind,
    models: Sequence[ErrorsByRecord],
    labels: Sequence[str],
    units: Mapping[str, str],
    blocks: Mapping[str, float],
    calibrations: Sequence[Mapping[str, Calibration]] = (),
) -> list[ComparedChannel]:
    """Return the rows of the result for one kind of prediction: for each channel the errors of all models.

    Parameters
    ----------
    kind : Kind
        Kind of prediction.
    models : sequence of mapping
        Errors of each model by record and channel, at common samples.
    labels : sequence of str
        Label of each model.
    units : mapping
        Unit of each channel.
    blocks : mapping
        Length of the blocks of time for the intervals [s], by channel.
    calibrations : sequence of mapping
        Calibration of each model by channel; by default unknown.
    """
    tested = calibrations or [dict[str, Calibration]()] * len(models)
    pooled = [pooled_errors(list(model.values())) for model in models]

    @cache  # the first model may also be the best one
    def against(reference: int, k: int, name: str) -> ComparedRatio | None:
        """Return the ratio of the error of model ``k`` in a channel to that of the model ``reference``."""
        if reference == k:
            return None
        both = [{r: {name: by[name]} for r, by in models[i].items() if name in by} for i in (reference, k)]
        change = prediction_change_by_record(both[0], both[1], kind.seconds or 0.0, blocks[name])
        return ratio_row(change.channels.get(name))

    rows = []
    for name in dict.fromkeys(n for errors in pooled for n in errors):
        owners = [k for k, errors in enumerate(pooled) if name in errors]
        rms = {k: finite(pooled[k][name].rms) for k in owners}
        spread = finite(pooled[owners[0]][name].spread)
        valid = {k: v for k, v in rms.items() if v is not None}
        best = min(valid, key=valid.__getitem__) if valid else None
        errors = tuple(
            ComparedError(
                model=labels[k],
                rms=error,
                fit=None if error is None or not spread else 1.0 - error / spread,
                inside_95=None if (found := tested[k].get(name)) is None else finite(found.inside_95),
                intervals=None if found is None else found.verdict,
                against_reference=against(0, k, name) if 0 in rms else None,
                against_best=None if best is None else against(best, k, name),
            )
            for k, error in rms.items()
        )
        rows.append(
            ComparedChannel(
                kind=kind.kind,
                seconds=kind.seconds,
                channel=name,
                unit=units[name],
                n=pooled[owners[0]][name].t.size,
                spread=spread,
                block=blocks[name],
                errors=errors,
                best=None if best is None else labels[best],
            )
        )
    return rows


def ratio_row(found: ErrorRatio | None) -> ComparedRatio | None:
    """Return an error ratio as a row of the result; None without a ratio (no common errors other than zero)."""
    if found is None or not np.isfinite(found.ratio):
        return None
    low, high = finite(found.low), finite(found.high)
    known = low is not None and high is not None
    verdict: ComparisonVerdict = VERDICTS[found.verdict] if known else "no-interval"
    return ComparedRatio(ratio=found.ratio, low=low, high=high, blocks=found.blocks, verdict=verdict)


def concentration_notes(
    models: Sequence[ErrorsByRecord],
    labels: Sequence[str],
    horizon: float,
    undecided: Sequence[int],
    starts: Mapping[str, float],
) -> list[str]:
    """Return a note on the times that have most of the squared errors over a horizon; empty without such times.

    For each model concerned it has the channels, their share and the times. For models without a verdict against the
    first one, it has the ratio of their error to that of the first model without all these times.

    Parameters
    ----------
    models : sequence of mapping
        Errors of each model by record and channel, at common samples.
    labels : sequence of str
        Label of each model.
    horizon : float
        Prediction horizon [s].
    undecided : sequence of int
        Indices of the models that are neither better nor worse than the first one.
    starts : mapping
        Start of each record in its log [s], by name. A block in time of a record has its name and a number.
    """
    found = {k: part for k, own in enumerate(models) if (part := concentrated_errors(own, horizon)) is not None}
    if not found:
        return []
    each = []
    for k, part in found.items():
        times: dict[str, list[str]] = {}
        for span in part.spans:
            start = starts.get(span.record, starts.get(span.record.rpartition("[")[0], 0.0))
            times.setdefault(span.record, []).append(f"{start + span.begin:.4g} to {start + span.end:.4g} s")
        where = ", ".join(f"{' and '.join(spans)} of {record}" for record, spans in times.items())
        low, high = (f"{100.0 * share:.0f}" for share in (min(part.shares.values()), max(part.shares.values())))
        share = high if low == high else f"{low} to {high}"
        model = f"({labels[k]}) " if len(models) > 1 else ""
        each.append(f"{model}{share} % of that of {', '.join(part.shares)} in {where}")
    rest = [without_spans(own, {span for part in found.values() for span in part.spans}) for own in models]
    ratios = {k: prediction_change_by_record(rest[0], rest[k], horizon).ratio for k in undecided}
    words = [f"that of ({labels[k]}) is {ratio:.2g} times" for k, ratio in ratios.items() if np.isfinite(ratio)]
    without = f" Without these seconds, of the errors over all channels {' and '.join(words)} that of ({labels[0]})."
    return [
        f"{MOST_OF_ERROR} {horizon:g} s ahead: {'; '.join(each)} (since the start of the log)."
        f"{without if words else ''} These seconds decide the errors: look there for a gap, an outlier, or a motion "
        "that depends on chance, as the side to which an unstable boat turns."
    ]
