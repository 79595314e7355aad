"""Converters from fits and evaluations to the tables of a result; they copy numbers and compute none."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version

import msgspec
import numpy as np

from seatrial.daq.errors import counted
from seatrial.ident import validation
from seatrial.ident.data import LoadedLog, Record
from seatrial.ident.diagnosis import CommonErrorsFit, ModelUncertainty
from seatrial.ident.estimation import Fit, FittedModel, HomogeneityTest, Profile, ReportedEstimates, run_differences
from seatrial.ident.model import Effect, EffectKind, Model, ModelKind, segment_name
from seatrial.ident.models import force_power
from seatrial.ident.results.parts import (
    CalibrationRow,
    Calibrations,
    CalibrationTable,
    CommonErrorsRow,
    Correlation,
    CorrelationTest,
    CrossCorrelationRow,
    EffectParameter,
    ErrorComparison,
    Errors,
    ErrorTable,
    FitSummary,
    ForceScale,
    Homogeneity,
    InputTrace,
    LargestErrorsRow,
    LogSummary,
    ParameterRow,
    PredictionChangeRow,
    PredictionFit,
    ProfileCurve,
    Provenance,
    ResidualTests,
    Role,
    Trace,
    Track,
    WhitenessTests,
)
from seatrial.ident.validation import (
    Calibration,
    ChannelResiduals,
    HorizonPrediction,
    PredictionErrors,
    PredictionEvaluation,
    RecordPrediction,
    shown_inputs,
)

NO_PREDICTION = HorizonPrediction(*(np.zeros(0),) * 3)  # of a channel without a sample after the horizon


def finite(value: float | None) -> float | None:
    """Return a number for a result as a float, or None (null in result.json) for None, NaN and infinity."""
    return None if value is None or not math.isfinite(value) else float(value)


def format_number(value: float) -> str:
    """Format a number for a sentence: two significant digits, or an integer from 100 on (113, 8.4, 0.66)."""
    # From 99.5: with two digits, 99.6 would be printed with an exponent.
    return f"{value:.0f}" if abs(value) >= 99.5 else f"{value:#.2g}".rstrip(".")


def provenance(loaded: Sequence[LoadedLog], command: str) -> Provenance:
    """Return the provenance of a result: the present UTC time, software version, command line and logs.

    Parameters
    ----------
    loaded
        Logs, with their description: path, hash, role, name, duration, rig, mission.
    command
        Command line.
    """
    return Provenance(
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        seatrial=version("seatrial"),
        command=command,
        logs=tuple(msgspec.convert(x.about, LogSummary) for x in loaded),
    )


def fit_summary(fit: Fit, start: Mapping[str, float], calibration: float | None = None) -> FitSummary:
    """Return the summary of a fit: parameters with standard errors, correlation and convergence.

    Values are in reported units: ratios to the thrust if its scale is unknown. A free per-record parameter has one row
    for each record.

    Parameters
    ----------
    fit : Fit
        The fit.
    start : mapping of str to float
        Initial values of the parameters by name.
    calibration : float, optional
        On the bench: relative standard uncertainty of the measured force. It is added to the standard errors. None: not
        given, so that the standard errors are called statistical only.
    """
    flags, reported, rows = dict(fit.flags), ReportedEstimates(fit), []
    scale = reported.scale
    for p in fit.model.parameters:
        names = [segment_name(p.name, i) for i in range(len(fit.records))] if p.per_record and p.free else [p.name]
        for i, name in enumerate(names):
            value, error = reported.estimate(p, i)
            error = math.hypot(error, (calibration or 0.0) * value * force_power(p.unit))
            share = finite(fit.prior_weight[fit.names.index(name)]) if name in fit.names else None
            if p.considered_sd is not None:
                error, share = p.considered_sd * reported.factor(p.unit), 1.0
            rows.append(
                ParameterRow(
                    name=scale.name(p.name, p.unit),
                    meaning=p.meaning,
                    unit=scale.unit(p.unit),
                    value=value,
                    se=finite(error),
                    free=p.free,
                    origin=str(p.provenance),
                    prior_share=share,
                    start=finite(start[p.name] * reported.factor(p.unit)) if p.name in start else None,
                    flag=flags.get(name),
                    record=fit.records[i] if p.per_record and p.free and len(names) > 1 else None,
                )
            )
    return FitSummary(
        model=" + ".join([fit.model.name, *(e.name for e in fit.model.effects)]),
        method="PE" if fit.options.process_noise else "OE",
        restricted=fit.options.reml,
        second_order=fit.model.second_order,
        converged=fit.converged,
        message=fit.message,
        log_likelihood=finite(fit.log_likelihood),
        iterations=fit.iterations,
        cpu=fit.cpu_seconds,
        coloured=fit.coloured,
        scale=ForceScale(
            thrust=None if scale.thrust is None else str(scale.thrust),
            arm=None if scale.arm is None else str(scale.arm),
            relative=scale.relative,
            relative_yaw=scale.relative_yaw,
            statistical_only=scale.statistical or (fit.model.kind is ModelKind.BENCH and calibration is None),
        ),
        parameters=tuple(rows),
        correlation=Correlation(
            names=tuple(segment_name(scale.name(p.name, p.unit), p.segment) for p in fit.parameters),
            matrix=reported.correlation,
        ),
    )


def error_tables(
    after: PredictionEvaluation,
    before: PredictionEvaluation | None = None,
    changes: Mapping[str, validation.PredictionChange] | None = None,
) -> Errors:
    """Return the RMS prediction errors of a model for each set of data, kind of prediction and channel.

    Parameters
    ----------
    after : PredictionEvaluation
        Evaluation of the model.
    before : PredictionEvaluation, optional
        Evaluation of another model, whose errors are reported beside those of ``after``.
    changes : mapping, optional
        Changes of the errors over the horizon, by role of the data (``estimation``, ``validation``).
    """
    units = {o.name: o.unit for o in after.model.outputs}

    def table(
        new: Mapping[str, PredictionErrors],
        old: Mapping[str, PredictionErrors],
        change: validation.PredictionChange | None = None,
    ) -> dict[str, ErrorComparison]:
        """Return the table of RMS errors by channel for one kind of prediction, such as one step ahead.

        ``new`` and ``old``: errors of the two models. ``change`` gives the interval of their ratio.
        """
        spans = {} if change is None else change.channels
        return {
            name: ErrorComparison(
                before=finite(old[name].rms) if name in old else None,
                after=finite(e.rms),
                unit=units[name],
                low=finite(spans[name].low) if name in spans else None,
                high=finite(spans[name].high) if name in spans else None,
                verdict=spans[name].verdict if name in spans else None,
                spread=finite(e.spread),
            )
            for name, e in new.items()
        }

    found = {}
    for role, data in after.sets.items():
        new, old = data.errors, None if before is None else before.sets[role].errors
        found[role] = ErrorTable(
            one_step=table(new.one_step, old.one_step if old else {}),
            horizon=table(new.horizon, old.horizon if old else {}, None if changes is None else changes[role]),
            simulation=table(new.simulation, old.simulation if old else {}),
        )
    return Errors(**found)


def prediction_fit(evaluation: PredictionEvaluation) -> PredictionFit | None:
    """Return the fit over the horizon on the validation data, or on the estimation data if there are no others.

    The fit is 1 less the geometric mean of RMS error over standard deviation. None if no channel is predicted over the
    horizon.
    """
    found = evaluation.sets[evaluation.headline_set].explained
    if not found.channels:
        return None
    low, high = finite(1 - found.high), finite(1 - found.low)
    predicted = {p.record.name: p for p in evaluation.sets[evaluation.headline_set].records}
    largest = validation.largest_errors({name: p.errors for name, p in predicted.items()}, evaluation.horizon)
    where = None
    if largest is not None:
        start = float(predicted[largest.record].record.meta.get("t0", 0.0))
        where = LargestErrorsRow(
            record=largest.record, begin=start + largest.begin, end=start + largest.end, share=largest.share
        )
    return PredictionFit(role=evaluation.headline_set, fit=1 - found.ratio, low=low, high=high, largest_errors=where)


def prediction_change(found: validation.PredictionChange, role: Role) -> PredictionChangeRow | None:
    """Return the change of the errors over the horizon on the data of a role; None if no channel can be compared.

    Parameters
    ----------
    found
        Change of the errors from the model without the effects to that with them.
    role
        Role of the data, `estimation` or `validation`.
    """
    if not found.channels:
        return None
    return PredictionChangeRow(
        role=role,
        ratio=found.ratio,
        low=finite(found.low),
        high=finite(found.high),
        verdict=found.verdict,
        better=tuple(found.named("fell")),
        worse=tuple(found.named("rose")),
    )


def calibration_tables(evaluation: PredictionEvaluation) -> Calibrations:
    """Return the calibration of the prediction intervals for each set of data, kind of prediction and channel."""

    def table(found: Mapping[str, Calibration]) -> dict[str, CalibrationRow]:
        """Return the table of the calibration by channel for one kind of prediction, such as one step ahead."""
        return {
            name: CalibrationRow(
                n=c.n,
                n_effective=c.n_effective,
                inside_50=c.inside_50,
                inside_95=c.inside_95,
                scale=finite(c.scale),
                low=finite(c.low),
                high=finite(c.high),
                pit=c.pit,
                verdict=c.verdict,
            )
            for name, c in found.items()
        }

    return Calibrations(
        **{
            role: CalibrationTable(
                one_step=table(data.calibration.one_step),
                horizon=table(data.calibration.horizon),
                simulation=table(data.calibration.simulation),
            )
            for role, data in evaluation.sets.items()
        }
    )


def traces(after: PredictionEvaluation, before: PredictionEvaluation | None = None) -> tuple[Trace, ...]:
    """Return each measured channel of each record with its prediction over the horizon and its simulation.

    Rows without a measurement are left out, and so are channels without any. ``before`` is the evaluation of another
    model, whose predictions are added.

    Parameters
    ----------
    after
        Evaluation of the model.
    before
        Evaluation of another model on the same records, or None.
    """
    return tuple(
        Trace(
            record=now.record.name,
            role=role,
            channel=o.name,
            unit=o.unit,
            angle=o.angle,
            t=now.record.t[seen],
            measured=now.record.y[seen, j],
            model=now.simulation.y[seen, j],
            sd=now.simulation.sd[seen, j],
            diverged=now.simulation.diverged.get(o.name),
            before=None if then is None else then.simulation.y[seen, j],
            t_horizon=far.t,
            horizon=far.y,
            sd_horizon=far.sd,
            horizon_before=None if then is None else then.horizon.get(o.name, NO_PREDICTION).y,
        )
        for role, now, then in _predictions_of_both(after, before)
        for j, o in enumerate(after.model.outputs)
        if (seen := np.isfinite(now.record.y[:, j])).any()
        for far in [now.horizon.get(o.name, NO_PREDICTION)]
    )


def tracks(after: PredictionEvaluation, before: PredictionEvaluation | None = None) -> tuple[Track, ...]:
    """Return the measured and the simulated track of each record with positions; empty for a model without positions.

    ``before`` is the evaluation of another model, whose simulated tracks are added.

    Parameters
    ----------
    after
        Evaluation of the model.
    before
        Evaluation of another model on the same records, or None.
    """
    names = [o.name for o in after.model.outputs]
    if "x" not in names:
        return ()
    i, j = names.index("x"), names.index("y")
    return tuple(
        Track(
            record=now.record.name,
            role=role,
            x_measured=now.record.y[seen, i],
            y_measured=now.record.y[seen, j],
            x_model=now.simulation.y[seen, i],
            y_model=now.simulation.y[seen, j],
            x_before=None if then is None else then.simulation.y[seen, i],
            y_before=None if then is None else then.simulation.y[seen, j],
        )
        for role, now, then in _predictions_of_both(after, before)
        if (seen := np.isfinite(now.record.y[:, i])).any()
    )


def _predictions_of_both(
    after: PredictionEvaluation, before: PredictionEvaluation | None
) -> list[tuple[Role, RecordPrediction, RecordPrediction | None]]:
    """Return the role of each record and its predictions by both models, estimation records first.

    The second prediction is None without another model (``before``).
    """
    found: list[tuple[Role, RecordPrediction, RecordPrediction | None]] = []
    roles: tuple[Role, ...] = ("estimation", "validation")
    for role in roles:
        new, old = getattr(after, role), getattr(before, role, None)
        if new is not None:
            found += [(role, now, None if old is None else old.records[k]) for k, now in enumerate(new.records)]
    return found


def record_inputs(model: Model, record: Record) -> tuple[InputTrace, ...]:
    """Return the inputs of a record as traces of the result: those that reports show, as the model uses them."""
    return tuple(
        InputTrace(record=record.name, name=name, unit=unit, t=record.t, value=record.u[:, j])
        for j, name, unit in shown_inputs(model)
    )


def all_inputs(evaluation: PredictionEvaluation) -> tuple[InputTrace, ...]:
    """Return the inputs of all records of an evaluation as traces of the result, estimation records first."""
    return tuple(
        row
        for data in evaluation.sets.values()
        for prediction in data.records
        for row in record_inputs(evaluation.model, prediction.record)
    )


def residual_rows(before: PredictionEvaluation, after: PredictionEvaluation | None = None) -> tuple[ResidualTests, ...]:
    """Return the whiteness tests of all records and channels.

    ``after`` is the evaluation of another model, whose tests are added to those of the same record and channel.

    Parameters
    ----------
    before
        Evaluation of the model, or in a diagnosis of the model without effects.
    after
        Evaluation of the model with effects, or None.
    """
    later = {} if after is None else {(r.record, r.channel): r for r in after.residuals}
    return tuple(residual_row(r, later.get((r.record, r.channel))) for r in before.residuals)


def residual_row(r: ChannelResiduals, after: ChannelResiduals | None = None) -> ResidualTests:
    """Return the result's row of whiteness tests for one channel of a record.

    ``after``: tests of the model with added effects, which the row gets too; None if there is only one model.
    """
    return ResidualTests(
        **msgspec.structs.asdict(_whiteness_tests(r)),
        record=r.record,
        channel=r.channel,
        unit=r.unit,
        t=r.t,
        lags=r.lags,
        band=r.tests.band,
        frequency=r.tests.frequency,
        after=None if after is None else _whiteness_tests(after),
    )


def _whiteness_tests(r: ChannelResiduals) -> WhitenessTests:
    """Return the part of a row of whiteness tests that depends on the model, without record, lags and frequencies."""
    return WhitenessTests(
        e=r.e,
        acf=r.tests.acf,
        ljung_box_p=finite(r.tests.ljung_box),
        periodogram_p=finite(r.tests.periodogram),
        cumulative=r.tests.cumulative,
        normal_p=finite(r.tests.normal),
        white=bool(r.tests.white),
        outliers=r.tests.outliers,
        largest=r.tests.largest,
    )


def cross_correlations(
    before: PredictionEvaluation, after: PredictionEvaluation | None = None
) -> tuple[CrossCorrelationRow, ...]:
    """Return the correlations of the residuals with the inputs, one for each record, channel and input.

    ``after`` is the evaluation of another model, whose correlations are added.

    Parameters
    ----------
    before
        Evaluation of the model, or in a diagnosis of the model without effects.
    after
        Evaluation of the model with effects, or None.
    """
    later = {} if after is None else {(r.record, r.channel): r for r in after.residuals}
    return tuple(row for r in before.residuals for row in cross_rows(r, later.get((r.record, r.channel))))


def cross_rows(r: ChannelResiduals, after: ChannelResiduals | None = None) -> list[CrossCorrelationRow]:
    """Return the result's rows of correlations of one channel's residuals with each input.

    ``after``: correlations of the model with added effects, which the rows get too; None if there is only one model.
    """
    later = {
        c.input: CorrelationTest(z=c.z, p=finite(c.p), largest=finite(c.largest))
        for c in (() if after is None else after.inputs)
    }
    return [
        CrossCorrelationRow(
            record=r.record,
            channel=r.channel,
            input=c.input,
            lags=c.lags,
            z=c.z,
            p=finite(c.p),
            largest=finite(c.largest),
            after=later.get(c.input),
        )
        for c in r.inputs
    ]


def profile_curve(found: Profile, reported: ReportedEstimates) -> ProfileCurve:
    """Return a profile likelihood in the units in which the estimates are reported.

    Parameters
    ----------
    found
        Profile likelihood in the units of the parameters.
    reported
        Converter to reported units: ratios to the thrust if its scale is unknown.
    """
    scale, factor = reported.scale, reported.factor(found.unit)
    return ProfileCurve(
        name=scale.name(found.name, found.unit),
        unit=scale.unit(found.unit),
        value=factor * found.value,
        grid=factor * found.grid,
        drop=found.drop,
        low=finite(factor * found.low),
        high=finite(factor * found.high),
        wald_low=finite(factor * found.wald_low),
        wald_high=finite(factor * found.wald_high),
        notes=tuple(found.notes),
    )


def homogeneity_reported(a: HomogeneityTest, reported: ReportedEstimates) -> HomogeneityTest:
    """Convert a homogeneity test to the units in which the estimates are reported.

    Parameters
    ----------
    a
        Homogeneity test in the units of the parameters.
    reported
        Converter to reported units: ratios to the thrust if its scale is unknown.
    """
    k = reported.factor(a.unit)
    low, high = a.interval
    return replace(
        a,
        name=reported.scale.name(a.name, a.unit),
        unit=reported.scale.unit(a.unit),
        value=k * a.value,
        error=k * a.error,
        robust_error=k * a.robust_error,
        values=k * a.values,
        errors=k * a.errors,
        scatter=k * a.scatter,
        mean=k * a.mean,
        mean_error=k * a.mean_error,
        interval=(k * low, k * high),
    )


def homogeneity_row(a: HomogeneityTest) -> Homogeneity:
    """Return the result's row of a homogeneity test (one value for all logs?), already in reported units."""
    return Homogeneity(
        name=a.name,
        unit=a.unit,
        value=a.value,
        se=finite(a.error),
        se_robust=finite(a.robust_error),
        records=tuple(a.records),
        values=a.values,
        ses=a.errors,
        lr=a.lr,
        df=a.df,
        p=a.p,
        agree=bool(a.agree),
        scatter=finite(a.scatter),
        mean=finite(a.mean),
        se_mean=finite(a.mean_error),
        low=finite(a.interval[0]),
        high=finite(a.interval[1]),
        left_out=a.left_out,
    )


def effect_parameter_rows(effect: Effect, fitted: FittedModel) -> tuple[EffectParameter, ...]:
    """Return the estimates of an effect's parameters in reported units, one row for each run of a per-record parameter.

    For an effect that differs between runs, return the differences from the first run.

    Parameters
    ----------
    effect : Effect
        Effect of the model.
    fitted : FittedModel
        Model whose estimates are reported.
    """
    reported, rows = ReportedEstimates(fitted.fit), []
    for p in effect.parameters:
        runs = fitted.fit.records if p.per_record else ("",)
        found = [(f", in {run}" if len(runs) > 1 else "", *reported.estimate(p, i)) for i, run in enumerate(runs)]
        if effect.kind is EffectKind.BETWEEN_RUNS:
            k = reported.factor(p.unit)
            differences = run_differences(fitted.fit, p.name)
            found = [(f", {d.record} against {runs[0]}", k * d.value, k * d.error) for d in differences]
        name, unit = reported.scale.name(p.name, p.unit), reported.scale.unit(p.unit)
        rows += [
            EffectParameter(name=name, meaning=p.meaning + where, unit=unit, value=value, se=finite(error))
            for where, value, error in found
        ]
    return tuple(rows)


def common_errors_row(found: CommonErrorsFit | None, fitted: FittedModel, role: Role) -> CommonErrorsRow | None:
    """Return the row of the common errors with their estimates. The result is None if the model has no common errors.

    Parameters
    ----------
    found : CommonErrorsFit or None
        The common errors.
    fitted : FittedModel
        Last model, with their estimates.
    role : Role
        Role of the data that judged them.
    """
    if found is None:
        return None
    gains = found.gains
    return CommonErrorsRow(
        names=tuple(e.name for e in found.effects),
        titles=tuple(e.title for e in found.effects),
        gain=None if gains is None else gains.gain,
        df=None if gains is None else gains.df,
        validation_gain=None if gains is None else gains.validation_gain,
        t=None if gains is None else gains.t,
        prediction=None if gains is None else prediction_change(gains.prediction, role),
        parameters=tuple(row for e in found.effects for row in effect_parameter_rows(e, fitted)),
    )


def common_errors_notes(found: CommonErrorsFit | None, beside: str) -> list[str]:
    """Return a note that names the common errors in the model; no note if it has none.

    ``beside`` names what they are estimated with, for example "the effects".
    """
    if found is None:
        return []
    titles = ", ".join(e.title for e in found.effects)
    gains = found.gains
    support = (
        "they were in the model that was given"
        if gains is None
        else f"d ln L of the validation data {gains.validation_gain:.0f}, t = {gains.t:.1f}"
    )
    return [f"Small errors that every craft has are estimated together with {beside}: {titles} ({support})."]


def model_uncertainty_notes(found: ModelUncertainty | None, fit: Fit) -> list[str]:
    """Return a note on the shifts that the standard errors include; no note if there is none.

    The note names the first three parameters of the model, which are those of the hull.

    Parameters
    ----------
    found : ModelUncertainty or None
        Shifts of the estimates by candidates that still pass the score tests.
    fit : Fit
        Fit whose standard errors include them.
    """
    if found is None:
        return []
    variance = dict(zip(found.parameters, np.diag(found.covariance), strict=True))
    grown = [
        f"{name} {error / np.sqrt(error**2 - variance[name]):.2g}"
        for name, error in zip(fit.names, fit.errors, strict=True)
        if name in variance and error**2 > variance[name]
    ]
    if not grown:
        return []
    return [
        f"The standard errors include the uncertainty of the model: {counted(len(found.candidates), 'candidate')} "
        f"still pass the score tests, and each would shift the estimates. This multiplies the standard errors: "
        f"{', '.join(grown[:3])}."
    ]
