"""Types of the result of `seatrial ident compare`: prediction errors of several models on the same logs, and verdicts.

The models have the labels ``a``, ``b``, ... in their order. The first one is the reference.
"""

from __future__ import annotations

from typing import Annotated, Literal, get_args

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from seatrial.ident.numerics import Array
from seatrial.ident.results.parts import CrossCorrelationRow, Part, ResidualTests, Result, Verdict, same_length

PredictionKind = Literal["one_step", "horizon", "simulation"]
ComparisonVerdict = Literal["better", "worse", "indistinguishable", "no-interval"]
DifferenceKind = Literal["structure", "effects", "inputs", "channels", "estimated", "fixed", "priors", "logs", "method"]
LABEL = "label of the model: `a`, `b`, ..."


class ComparedRatio(Part, frozen=True, kw_only=True):
    """RMS prediction error of a model divided by that of another model at the same samples.

    The 95 % interval is by a jackknife over blocks of time. The verdict is `better` or `worse` if the interval excludes
    1 and the difference is more than half a per cent; otherwise it is `indistinguishable`. With fewer than four
    blocks there is no interval, and the verdict is `no-interval`: nothing is known about the difference.
    """

    ratio: Annotated[float, Meta(description="error / error of the other model; below 1 the model is better")]
    low: Annotated[float | None, Meta(description="95 % interval of `ratio`; null: fewer than four blocks")] = None
    high: Annotated[float | None, Meta(description="upper end of the interval")] = None
    blocks: Annotated[int | None, Meta(description="number of blocks of time; null: result of an earlier version")] = (
        None
    )
    verdict: Annotated[ComparisonVerdict, Meta(description="verdict, by the interval")]

    @property
    def inverse(self) -> ComparedRatio:
        """The error of the other model divided by that of the model."""
        low, high = (None if x is None or x <= 0.0 else 1.0 / x for x in (self.high, self.low))
        swapped: dict[ComparisonVerdict, ComparisonVerdict] = {"better": "worse", "worse": "better"}
        ratio = 1.0 / self.ratio if self.ratio > 0.0 else float("inf")
        return ComparedRatio(
            ratio=ratio, low=low, high=high, blocks=self.blocks, verdict=swapped.get(self.verdict, self.verdict)
        )


class ComparedError(Part, frozen=True, kw_only=True):
    """Prediction error of one model for one channel and one kind of prediction."""

    model: Annotated[str, Meta(description=LABEL)]
    rms: Annotated[float | None, Meta(description="RMS error in the unit of the channel; null: a prediction diverged")]
    fit: Annotated[
        float | None, Meta(description="1 - `rms` / `spread`, 1 for a perfect prediction; null: unknown")
    ] = None
    inside_95: Annotated[
        float | None,
        Meta(
            description="share of the errors inside the 95 % intervals, widened as those of `traces`; one step ahead "
            "without outliers; null: no intervals, intervals that are wider than the range of the measured values, or "
            "a result of an earlier version"
        ),
    ] = None
    intervals: Annotated[
        Verdict | None,
        Meta(
            description="verdict on these intervals that allows for correlated errors: `overconfident` (too narrow) or "
            "`underconfident` (too wide) beyond 10 %; `right`; `insufficient_data`; null: no intervals"
        ),
    ] = None
    against_reference: Annotated[
        ComparedRatio | None,
        Meta(description="against the first model; null: it is the first, or none can be computed"),
    ] = None
    against_best: Annotated[
        ComparedRatio | None, Meta(description="against the best model; null: it is the best, or there is no ratio")
    ] = None


class ComparedChannel(Part, frozen=True, kw_only=True):
    """Prediction errors of all models for one channel and one kind of prediction, at the same samples.

    The kinds are: one step ahead (from one row to the next), over a horizon, and simulation from the inputs alone after
    15 s of filtering.
    """

    kind: Annotated[PredictionKind, Meta(description="kind of prediction")]
    seconds: Annotated[float | None, Meta(description="horizon [s]; null: one step ahead, or simulation")] = None
    channel: Annotated[str, Meta(description="name of the channel")]
    unit: Annotated[str, Meta(description="unit of the channel")]
    n: Annotated[int, Meta(description="number of samples that all models predict")]
    spread: Annotated[
        float | None,
        Meta(description="standard deviation of these samples about their mean in each record (circular for angles)"),
    ] = None
    block: Annotated[float, Meta(description="length of the blocks of time for the intervals [s]")]
    errors: Annotated[
        tuple[ComparedError, ...], Meta(description="one for each model that predicts the channel, in their order")
    ]
    best: Annotated[str | None, Meta(description="label of the model with the smallest error; null: all diverged")] = (
        None
    )

    @property
    def unproven(self) -> tuple[ComparedRatio, ...]:
        """Ratios to the best model that have no interval, in the order of the models; empty if all have one."""
        ratios = (e.against_best for e in self.errors)
        return tuple(r for r in ratios if r is not None and r.verdict == "no-interval")

    @property
    def undecided(self) -> bool:
        """Whether no other model has an interval for its ratio to the best one, so that none is known to be better."""
        others = [e.against_best for e in self.errors if e.model != self.best]
        return bool(self.unproven) and all(r is None or r.verdict == "no-interval" for r in others)

    @property
    def not_worse(self) -> tuple[str, ...]:
        """Labels of the best model and of those that are not distinguishable from it, in the order of the models.

        A model whose ratio to the best one cannot be computed, or has no interval (`unproven`), is not among them, nor
        are the `unclear` ones. The result is empty if all diverged.
        """
        return tuple(
            e.model
            for e in self.errors
            if e.model == self.best
            or (
                e.against_best is not None
                and e.against_best.verdict == "indistinguishable"
                and e.against_best.ratio < self._least_worse
            )
        )

    @property
    def unclear(self) -> tuple[str, ...]:
        """Labels of the models without a verdict against the best one, although a smaller error is significantly worse.

        Their errors vary so much between the blocks of time that they are not shown to be worse. They are not as good.
        """
        return tuple(
            e.model
            for e in self.errors
            if e.against_best is not None
            and e.against_best.verdict == "indistinguishable"
            and e.against_best.ratio >= self._least_worse
        )

    @property
    def _least_worse(self) -> float:
        """Smallest ratio to the best model of those that are significantly worse; infinite without any."""
        ratios = (e.against_best for e in self.errors)
        return min((r.ratio for r in ratios if r is not None and r.verdict == "worse"), default=float("inf"))

    @property
    def all_equal(self) -> bool:
        """Whether at least three models are compared, and no model differs significantly from the best one."""
        return len(self.not_worse) == len(self.errors) > 2


class ComparedKind(Part, frozen=True, kw_only=True):
    """Prediction errors of a model over all channels, against those of the first model, for one kind of prediction.

    The ratio is the geometric mean over all channels that both models predict.
    """

    kind: Annotated[PredictionKind, Meta(description="kind of prediction")]
    seconds: Annotated[float | None, Meta(description="horizon [s]; null: one step ahead, or simulation")] = None
    block: Annotated[float, Meta(description="length of the blocks of time for the intervals [s]")]
    against_reference: Annotated[ComparedRatio, Meta(description="all channels together")]


class ComparedPair(Part, frozen=True, kw_only=True):
    """Prediction errors over all channels of a model against those of another one than the first, over a horizon."""

    model: Annotated[str, Meta(description=LABEL)]
    other: Annotated[str, Meta(description="label of the other model")]
    seconds: Annotated[float, Meta(description="horizon [s]")]
    ratio: Annotated[ComparedRatio, Meta(description="all channels together, `model` against `other`")]


class LogScore(Part, frozen=True, kw_only=True):
    """Log score: log-likelihood of the samples one step ahead, of a model less that of the first model.

    It is the logarithmic score of the predictions (Gneiting and Raftery 2007). On logs that neither model was fitted to
    it needs no correction for the number of parameters: it is the cross-validated score. The interval is by Student's t
    over blocks of time.
    """

    gain: Annotated[float, Meta(description="log-likelihood of the model less that of the first; above 0 it is better")]
    low: Annotated[float | None, Meta(description="95 % interval of `gain`; null: fewer than four blocks")] = None
    high: Annotated[float | None, Meta(description="upper end of the interval")] = None
    blocks: Annotated[int, Meta(description="number of blocks of time")]
    verdict: Annotated[
        ComparisonVerdict, Meta(description="`indistinguishable` if the interval contains 0; `no-interval` without one")
    ]
    held_out: Annotated[bool, Meta(description="neither model was fitted to any of the logs")]


class InformationCriteria(Part, frozen=True, kw_only=True):
    """Information criteria of two maximum likelihood fits to the same logs, of a model against the first one."""

    gain: Annotated[float, Meta(description="log-likelihood of the model less that of the first")]
    parameters: Annotated[int, Meta(description="number of estimated parameters less that of the first model")]
    aic: Annotated[float, Meta(description="change of Akaike's information criterion; negative: better")]
    bic: Annotated[float, Meta(description="change of the Bayesian information criterion; negative: better")]
    p: Annotated[
        float | None,
        Meta(
            description="p value of the likelihood-ratio test that the additional parameters are not needed; null: the "
            "first model is not this one with free parameters fixed or missing"
        ),
    ] = None


class ModelDifference(Part, frozen=True, kw_only=True):
    """One kind of difference between a model and the first model: the entries that only one of them has."""

    kind: Annotated[
        DifferenceKind,
        Meta(
            description="`structure` of the equations; `effects`; `inputs`; measured `channels`; `estimated` "
            "parameters; `fixed` parameters with value; `priors` with mean and standard deviation; `logs` of the fit; "
            "`method` of the fit"
        ),
    ]
    here: Annotated[tuple[str, ...], Meta(description="texts of this model that the first model lacks")] = ()
    in_reference: Annotated[tuple[str, ...], Meta(description="texts of the first model that this one lacks")] = ()


class ComparedMass(Part, frozen=True, kw_only=True):
    """Mass in surge or sway, or yaw inertia, of a compared model, with the added mass of the water."""

    name: Annotated[str, Meta(description="`m_u`, `m_v` or `m_r`; a ratio to the unknown thrust is `m_u/T`")]
    value: Annotated[float, Meta(description="value of the model")]
    se: Annotated[float | None, Meta(description="standard error; null: fixed, or unknown")] = None
    unit: Annotated[str, Meta(description="unit of both, SI")]


class ComparedModel(Part, frozen=True, kw_only=True):
    """One model of a comparison. The first one, with the label `a`, is the reference."""

    label: Annotated[str, Meta(description=LABEL)]
    name: Annotated[str, Meta(description="path of its model.toml, or name in Python")]
    model: Annotated[str, Meta(description="names of the model and of its effects")]
    n_free: Annotated[int, Meta(description="number of estimated parameters with one value for all logs")]
    per_log: Annotated[
        tuple[str, ...],
        Meta(description="parameters that are estimated anew for each compared log, such as the current"),
    ] = ()
    fitted_to: Annotated[
        tuple[str, ...],
        Meta(description="compared logs that it was fitted to: its errors there are too small"),
    ] = ()
    selected_by: Annotated[
        tuple[str, ...],
        Meta(description="compared logs by which a fit or diagnosis was validated: its effects were selected by them"),
    ] = ()
    widened_horizons: Annotated[
        tuple[float, ...],
        Meta(
            description="horizons [s] over which its 95 % intervals and standard deviations are widened by its "
            "validation data (`intervals` of model.toml); over others they are its own"
        ),
    ] = ()
    widened_by: Annotated[
        tuple[str, ...],
        Meta(
            description="compared logs whose errors widened its 95 % intervals: the share of their errors inside is no "
            "test of these intervals"
        ),
    ] = ()
    widened_simulation: Annotated[
        bool, Meta(description="whether those of its simulation are widened by its validation data")
    ] = False
    masses: Annotated[
        tuple[ComparedMass, ...], Meta(description="its masses; empty: none, or a result of an earlier version")
    ] = ()
    differences: Annotated[
        tuple[ModelDifference, ...] | None,
        Meta(
            description="what differs from the first model; empty: only the values of the estimates; null: the first "
            "model, or a result of an earlier version"
        ),
    ] = None
    changes: Annotated[
        tuple[ComparedKind, ...], Meta(description="one for each kind of prediction; empty for the first model")
    ] = ()
    score: Annotated[
        LogScore | None, Meta(description="null: the first model, or the models do not predict the same samples")
    ] = None
    criteria: Annotated[
        InformationCriteria | None, Meta(description="null: the first model, or as `no_criteria` says")
    ] = None
    no_criteria: Annotated[str, Meta(description="reason why there are no information criteria; may be empty")] = ""
    residuals: Annotated[
        tuple[ResidualTests, ...],
        Meta(
            description="its residuals one step ahead on the compared logs, by a filter of first order, with their "
            "tests; empty: the logs are cut into blocks, or a result of an earlier version"
        ),
    ] = ()
    cross: Annotated[
        tuple[CrossCorrelationRow, ...], Meta(description="correlation of these residuals with the inputs")
    ] = ()

    def ahead(self, seconds: float) -> ComparedRatio | None:
        """Return the error over a horizon of ``seconds`` [s] against the first model; None for the first model itself.

        The result is also None if the logs have no prediction over this horizon.
        """
        return next((c.against_reference for c in self.changes if c.seconds == seconds), None)


class ComparedPrediction(Part, frozen=True, kw_only=True):
    """Prediction of a channel of one record by one model, over a horizon or in simulation."""

    model: Annotated[str, Meta(description=LABEL)]
    kind: Annotated[PredictionKind, Meta(description="kind of prediction: `horizon` or `simulation`")]
    seconds: Annotated[float | None, Meta(description="horizon [s]; null: simulation")] = None
    t: Annotated[Array, Meta(description="times [s] since the start of the log")]
    predicted: Annotated[Array, Meta(description="predicted values; NaN from the time on at which it diverged")]
    sd: Annotated[
        Array,
        Meta(
            description="standard deviation of the prediction errors: that of the model, widened by its validation "
            "data if the model says so (`widened_horizons`, `widened_simulation`)"
        ),
    ]
    filtered: Annotated[
        tuple[tuple[float, float], ...],
        Meta(
            description="intervals of time [s] in which a simulation is filtered, so that `predicted` has seen the "
            "samples; the errors leave them out. Empty: a horizon, or a result of an earlier version"
        ),
    ] = ()

    @property
    def unseen(self) -> NDArray[np.bool_]:
        """Whether each value (n,) is a prediction without the samples of its time: those in `filtered` are not."""
        seen = np.zeros(self.t.size, dtype=bool)
        for begin, end in self.filtered:
            seen |= (self.t >= begin) & (self.t <= end)
        return ~seen

    def __post_init__(self) -> None:
        """Raise ValueError if the arrays differ in length."""
        same_length(self, "t", "predicted", "sd")


class ComparedTrace(Part, frozen=True, kw_only=True):
    """Measured channel of a record over time, with its predictions by all models."""

    record: Annotated[str, Meta(description="name of the record")]
    channel: Annotated[str, Meta(description="name of the measured channel")]
    unit: Annotated[str, Meta(description="unit of the values, SI and radians; empty: none")]
    angle: Annotated[bool, Meta(description="whether the channel is an angle, which is known except for whole turns")]
    t: Annotated[Array, Meta(description="times [s] since the start of the log")]
    measured: Annotated[Array, Meta(description="measured values")]
    predictions: Annotated[
        tuple[ComparedPrediction, ...],
        Meta(
            description="one for each model, horizon and simulation; none one step ahead, which would hide the samples"
        ),
    ]

    def __post_init__(self) -> None:
        """Raise ValueError if the arrays differ in length."""
        same_length(self, "t", "measured")


class ComparisonResult(Result, frozen=True, kw_only=True, tag_field="kind", tag="comparison"):
    """Result of `seatrial ident compare`: predictions of one fitted model, or of several, on the same logs."""

    horizons: Annotated[tuple[float, ...], Meta(description="prediction horizons [s]; the first one is in `answer`")]
    models: Annotated[tuple[ComparedModel, ...], Meta(description="the models; the first one is the reference")]
    weighed_mass: Annotated[
        float | None,
        Meta(description="weighed mass of the boat [kg] by the rig or import map of the first log; null: unknown"),
    ] = None
    channels: Annotated[
        tuple[ComparedChannel, ...], Meta(description="errors by kind of prediction and channel, of all models")
    ]
    traces: Annotated[tuple[ComparedTrace, ...], Meta(description="one for each record and channel")]
    pairs: Annotated[
        tuple[ComparedPair, ...],
        Meta(
            description="models against each other; those against the first model are in its `changes`; empty also of "
            "an earlier version"
        ),
    ] = ()

    @property
    def is_evaluation(self) -> bool:
        """Whether there is one model only, which is evaluated and not compared."""
        return len(self.models) == 1

    @property
    def kinds(self) -> tuple[tuple[PredictionKind, float | None], ...]:
        """Kinds of prediction in the order of ``channels``, with their horizons [s]: None for a simulation."""
        return tuple(dict.fromkeys((row.kind, row.seconds) for row in self.channels))

    def inside_95(self, kind: PredictionKind, seconds: float | None, label: str) -> float | None:
        """Return the share of the errors of a model that lie inside its 95 % intervals, over all channels.

        Channels with useless intervals (``inside_95`` is None) are left out. The result is None if most channels are
        left out, and if the model has no intervals.

        Parameters
        ----------
        kind, seconds
            Kind of prediction, and its horizon [s] (None: no horizon).
        label
            Label of the model.
        """
        tested = [
            (row.n, e.inside_95)
            for row in self.channels
            for e in row.errors
            if (row.kind, row.seconds, e.model) == (kind, seconds, label) and e.intervals is not None
        ]
        found = [(n, share) for n, share in tested if share is not None]
        if 2 * len(found) < len(tested):
            return None
        total = sum(n for n, _ in found)
        return sum(n * share for n, share in found) / total if total else None

    @property
    def best(self) -> str:
        """Label of the best model over the first horizon, which does not depend on the order of the models.

        It is `significantly_best`, or else the model with the smallest error of all channels.
        """
        return self.significantly_best or min(self._sizes, key=self._sizes.__getitem__)

    @property
    def significantly_best(self) -> str | None:
        """Label of the model with the smallest error of all channels over the first horizon, of those that are better.

        Only models are considered that are significantly better than another one, and than which no other one is
        significantly better. None without any.
        """
        found = {label: self.verdicts(label) for label in self._sizes}
        good = [n for n, own in found.items() if "better" in own.values() and "worse" not in own.values()]
        return min(good, key=self._sizes.__getitem__) if good else None

    def verdicts(self, label: str) -> dict[str, ComparisonVerdict]:
        """Return the verdicts on a model over the first horizon, by the label of the other model."""
        against = ((m.label, self.ratio(label, m.label, self.horizons[0])) for m in self.models)
        return {other: r.verdict for other, r in against if r is not None}

    def ratio(self, label: str, other: str, seconds: float) -> ComparedRatio | None:
        """Return the error of all channels of a model over a horizon [s] against that of another one.

        It is None if the logs have no such predictions of both, or for a result of an earlier version.
        """
        first = self.models[0].label
        by_label = {m.label: m for m in self.models}
        if label == other:
            return None
        if other == first:
            return by_label[label].ahead(seconds)
        if label == first:
            found = by_label[other].ahead(seconds)
            return None if found is None else found.inverse
        for pair in self.pairs:
            if pair.seconds == seconds and {pair.model, pair.other} == {label, other}:
                return pair.ratio if pair.model == label else pair.ratio.inverse
        return None

    @property
    def _sizes(self) -> dict[str, float]:
        """Errors of all channels over the first horizon against the first model, by label, of those that have one."""
        ahead = {m.label: m.ahead(self.horizons[0]) for m in self.models[1:]}
        return {self.models[0].label: 1.0} | {label: r.ratio for label, r in ahead.items() if r is not None}

    def counts(self, label: str) -> dict[ComparisonVerdict, int]:
        """Return the number of channels and kinds of prediction by the verdict on a model against the first one.

        Parameters
        ----------
        label
            Label of the model. All numbers are zero for the first model and for an unknown label.
        """
        found = [
            e.against_reference.verdict
            for row in self.channels
            for e in row.errors
            if e.model == label and e.against_reference is not None
        ]
        return {verdict: found.count(verdict) for verdict in get_args(ComparisonVerdict)}
