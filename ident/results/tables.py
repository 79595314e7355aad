"""Converters from fits and evaluations to the tables of a result. They copy and convert numbers, and estimate none."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import msgspec
import numpy as np

from seatrial.daq.errors import counted
from seatrial.ident import validation
from seatrial.ident.data import LoadedLog, Record, given_inputs
from seatrial.ident.diagnosis import CommonErrorsFit, ModelUncertainty, RejectedCommonErrors
from seatrial.ident.effects import catalogue
from seatrial.ident.estimation import (
    AT_BOUND,
    Fit,
    FittedModel,
    HomogeneityTest,
    Profile,
    ReportedEstimates,
    Role,
    agrees_with_bench,
    given_prior_flags,
    run_differences,
)
from seatrial.ident.model import Effect, EffectKind, Flag, ForceCurve, Model, ModelKind, Parameter, segment_name
from seatrial.ident.models import ESTIMATOR_ERROR, SENSORS_WITH_CORRELATED_ERRORS, force_power, thrust_of
from seatrial.ident.results.candidate_titles import candidate_title
from seatrial.ident.results.parts import (
    CalibrationRow,
    Calibrations,
    CalibrationTable,
    CommonErrorsRow,
    Correlation,
    CorrelationTest,
    CrossCorrelationRow,
    EffectParameter,
    EffectRow,
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
    ResultWarning,
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

NO_PREDICTION = HorizonPrediction(*(np.zeros(0),) * 3)  # empty: of a channel without a sample after the first horizon
# Force and velocities of the curves that have the form of an inertial force in a turn: this force, and its masses.
INERTIAL_PRODUCTS = {
    ("X", "r", "v"): ("m_v v r", ("m_v",)),
    ("Y", "r", "u"): ("m_u u r", ("m_u", "m_v")),
    ("N", "u", "v"): ("(m_u - m_v) u v", ("m_v",)),
}


def finite(value: float | None) -> float | None:
    """Return a number as result.json has it: None in place of NaN and infinity, which JSON lacks."""
    return None if value is None or not math.isfinite(value) else float(value)


def in_degrees(unit: str) -> tuple[float, str]:
    """Return the factor from a unit to that of a sentence, and this unit: degrees for radians, otherwise the same."""
    return (math.degrees(1.0), unit.replace("rad", "deg")) if unit.startswith("rad") else (1.0, unit)


def format_number(value: float) -> str:
    """Return a number as text for a sentence: two significant digits, or an integer from 99.5 on (113, 8.4, 0.66)."""
    # From 99.5: with two digits, 99.6 would be printed with an exponent.
    return f"{value:.0f}" if abs(value) >= 99.5 else f"{value:#.2g}".rstrip(".")


def listed(items: Sequence[str], last: str = "") -> str:
    """Return items as a list for a sentence, separated by semicolons if one of them contains a comma, else by commas.

    Commas in parentheses do not count. ``last``, such as "and", stands before the last of several items.
    """
    separator = "; " if any("," in re.sub(r"\([^()]*\)", "", item) for item in items) else ", "
    if len(items) < 2 or not last:
        return separator.join(items)
    before = separator.rstrip() if separator == "; " else ""
    return f"{separator.join(items[:-1])}{before} {last} {items[-1]}"


def parameter_label(p: Parameter, fit: Fit) -> str:
    """Return the name of a parameter, of a value of one log with the name of this log as in the tables: ``V_x@LOG``."""
    return p.name if p.segment is None else f"{p.name}@{fit.records[p.segment]}"


def provenance(loaded: Sequence[LoadedLog], command: str) -> Provenance:
    """Return the provenance of a result: the present UTC time, software version, command line and logs.

    Parameters
    ----------
    loaded
        Logs, each with its description: path, hash, role, name, duration, rig, mission, findings of its checks.
    command
        Command line that made the result.
    """
    return Provenance(
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        seatrial=version("seatrial"),
        command=command,
        logs=tuple(msgspec.convert(x.about, LogSummary) for x in loaded),
    )


def fit_summary(fit: Fit, start: Mapping[str, float], calibration: float | None = None) -> FitSummary:
    """Return the summary of a fit: parameters with standard errors, their correlation, method and convergence.

    Values are in reported units: ratios to the thrust if the thrust was not given. An estimated per-record parameter
    has one row for each record. The standard error of a considered parameter, which is not estimated, is that of its
    prior. A standard error that is not finite is None.

    Parameters
    ----------
    fit : Fit
        Fit of a model.
    start : mapping of str to float
        Initial values of the parameters by name, in the units of the model. Parameters may be missing.
    calibration : float, optional
        On the bench: relative standard uncertainty of the load cell's force. It is added in quadrature to the standard
        errors of parameters that scale with the force. If it is None, the standard errors of a bench model are called
        statistical only.
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
            found = [
                *_flags(flags.get(name), p, fit.estimate(p.name, i), share, reported),
                *_beside_inertial_curve(p, fit.model.effects),
                *_without_statement(p, fit, i),
            ]
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
                    **_flag_fields(found),
                    record=fit.records[i] if p.per_record and p.free and len(names) > 1 else None,
                    positive=p.transform == "log" or p.bounds[0] >= 0.0,
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


def _flags(
    flag: Flag | None, p: Parameter, estimate: tuple[float, float], share: float | None, reported: ReportedEstimates
) -> list[Flag]:
    """Return the flag of a fit with its whole sentence, and the flags on a prior that the user gave.

    ``estimate`` is the value and its standard error in the unit of the parameter, and ``share`` that of the prior in
    the information. The flags on the prior contain the share, so that a flag with the share alone is left out.
    """
    factor, unit = reported.factor(p.unit), reported.scale.unit(p.unit)
    of_prior = given_prior_flags(p, estimate, share or 0.0, factor, unit)
    if flag is None or (flag.code == "prior" and (of_prior or agrees_with_bench(p, estimate[0]))):
        return [*of_prior]
    return [Flag(flag.code, _flag_text(flag, p, estimate[0], reported)), *of_prior]


def _flag_fields(flags: Sequence[Flag]) -> dict[str, Any]:
    """Return text and codes of the flags of an estimate, as fields of its row in the table of parameters."""
    return {"flag": "; ".join(flags) or None, "flag_codes": tuple(dict.fromkeys(flag.code for flag in flags))}


def _flag_text(flag: Flag, p: Parameter, value: float, reported: ReportedEstimates) -> str:
    """Return the text of a flag of a fit for the user. Only that of a parameter at its bound is extended.

    The sentence has the bound in reported units, what the estimate means, and what to do.

    Parameters
    ----------
    flag : Flag
        Flag of the fit (`Fit.flags`).
    p : Parameter
        The parameter.
    value : float
        Its estimate, in the unit of the parameter.
    reported : ReportedEstimates
        Units of the result.
    """
    if flag != AT_BOUND:
        return flag
    low, high = p.bounds
    at_low = abs(value - low) <= abs(value - high)
    bound = low if at_low else high
    shown = f"{reported.factor(p.unit) * bound:.3g} {reported.scale.unit(p.unit) if bound else ''}".rstrip()
    begin = f"{AT_BOUND} {shown}, the {'lowest' if at_low else 'highest'} possible value"
    if p.name in reported.fit.model.noises:
        if at_low and _has_lasting_error(reported.fit.model, p.name):
            return f"{begin}: the errors of this signal last, and are states of the model. Nothing has to be done"
        why = "the data show less noise than this" if at_low else "the data show more noise than this"
        return f"{begin}: {why}. If the noise of the sensor is known, give it (--fix {p.name}=VALUE)"
    if at_low and (taken := next((e for e in reported.fit.model.effects if p.name in e.takes_over), None)) is not None:
        return f"{begin}: the effect {taken.name} describes this in another form. Nothing has to be done"
    meanings = (e.at_lower_bound[p.name] for e in reported.fit.model.effects if p.name in e.at_lower_bound)
    if at_low and (words := next(meanings, "")):
        return f"{begin}: {words}"
    if at_low and bound == 0.0:
        return f"{begin}: the data do not show {p.meaning}. Fix it (--fix {p.name}=0), or add logs that excite it"
    return (
        f"{begin}: the best estimate is beyond it. Check the logs (`seatrial check`), or fix it if it is known (--fix "
        f"{p.name}=VALUE)"
    )


def _has_lasting_error(model: Model, noise: str) -> bool:
    """Return whether a noise is that of a sensor whose correlated errors are states of the model."""
    if ESTIMATOR_ERROR not in {e.name for e in model.effects}:
        return False
    return any(o.noise == noise for s in model.sensors if s.name in SENSORS_WITH_CORRELATED_ERRORS for o in s.outputs)


def _without_statement(p: Parameter, fit: Fit, record: int) -> list[Flag]:
    """Return a flag if the standard error of a positive parameter of a thruster is larger than its value.

    ``record``: index of the record of a per-record parameter. A vehicle fit has flags of its own for this.
    """
    value, error = fit.estimate(p.name, record)
    if fit.model.kind is not ModelKind.BENCH or p.transform != "log" or not error > abs(value):
        return []
    return [Flag("not determined", "not determined: its standard error is larger than its value")]


def _beside_inertial_curve(p: Parameter, effects: Iterable[Effect]) -> list[Flag]:
    """Return a flag if an added curve has the form of an inertial force of a mass, whose parameter is ``p``.

    The list is empty for any other parameter, and without such a curve among ``effects``.
    """
    for curve, product, masses in inertial_curves(effects):
        if p.name in masses and p.free:
            form = f"the curve {curve.force}({curve.variables}) has the form of {product}"
            return [Flag("no mass", f"{form}: this is no physical mass")]
    return []


def inertial_curves(effects: Iterable[Effect]) -> list[tuple[ForceCurve, str, tuple[str, ...]]]:
    """Return the added curves over a product of velocities that the inertia of a turning boat contains too.

    Each item has the curve, the inertial force of this form, and the names of the masses in it. ``effects`` are the
    added effects.
    """
    curves = [e.curve for e in effects if e.curve is not None and e.kind is EffectKind.NONPARAMETRIC]
    keys = [(c, (c.force, *sorted((c.variable, c.second)))) for c in curves]
    return [(c, *INERTIAL_PRODUCTS[key]) for c, key in keys if key in INERTIAL_PRODUCTS]


def error_tables(
    after: PredictionEvaluation,
    before: PredictionEvaluation | None = None,
    changes: Mapping[str, validation.PredictionChange] | None = None,
) -> Errors:
    """Return the RMS prediction errors of a model for each set of data, kind of prediction and channel.

    An error that is not finite, because the prediction diverged, is None.

    Parameters
    ----------
    after : PredictionEvaluation
        Evaluation of the model.
    before : PredictionEvaluation, optional
        Evaluation of another model on the same data, whose errors are reported beside those of ``after``.
    changes : mapping, optional
        Changes of the errors over the horizon from ``before`` to ``after``, by role of the data (``estimation``,
        ``validation``), with the 95 % intervals of their ratios. If it is None, or lacks a channel, the errors have no
        interval and no verdict.
    """
    units = {o.name: o.unit for o in after.model.outputs}
    found = {}
    for role, data in after.sets.items():
        new, old = data.errors, None if before is None else before.sets[role].errors
        found[role] = ErrorTable(
            one_step=error_rows(new.one_step, old.one_step if old else {}, units),
            horizon=error_rows(
                new.horizon, old.horizon if old else {}, units, None if changes is None else changes[role]
            ),
            simulation=error_rows(new.simulation, old.simulation if old else {}, units),
        )
    return Errors(**found)


def error_rows(
    new: Mapping[str, PredictionErrors],
    old: Mapping[str, PredictionErrors],
    units: Mapping[str, str],
    change: validation.PredictionChange | None = None,
) -> dict[str, ErrorComparison]:
    """Return the RMS errors by channel for one kind of prediction, such as one step ahead.

    Parameters
    ----------
    new, old : mapping
        Errors of the model, and of the other model, by channel. ``old`` is empty without another model.
    units : mapping
        Unit of each channel.
    change : PredictionChange, optional
        Interval and verdict of the ratio of both. If it is None, or lacks the channel, these are None.
    """
    spans = {} if change is None else change.channels
    return {
        name: ErrorComparison(
            before=finite(old[name].rms) if name in old else None,
            after=finite(e.rms),
            unit=units[name],
            low=finite(spans[name].low) if name in spans else None,
            high=finite(spans[name].high) if name in spans else None,
            # without an interval, a large change would be called unchanged
            verdict=spans[name].verdict if name in spans and math.isfinite(spans[name].low) else None,
            spread=finite(e.spread),
        )
        for name, e in new.items()
    }


def prediction_fit(evaluation: PredictionEvaluation) -> PredictionFit | None:
    """Return the fit of all channels over the horizon on the validation data, with its 95 % interval.

    It is that on the estimation data if there are no validation data. The fit is 1 minus the geometric mean over the
    channels of RMS prediction error / standard deviation of the measured output. The interval of time with the largest
    errors is added. The result is None if no channel is predicted over the horizon.
    """
    found = evaluation.sets[evaluation.headline_set].explained
    if not found.channels:
        return None
    low, high = finite(1 - found.high), finite(1 - found.low)
    predicted = {p.record.name: p for p in evaluation.sets[evaluation.headline_set].records}
    largest = validation.largest_errors({name: p.errors for name, p in predicted.items()}, evaluation.horizon)
    where = None
    if largest is not None:
        start = predicted[largest.record].record.t_from
        where = LargestErrorsRow(
            record=largest.record, begin=start + largest.begin, end=start + largest.end, share=largest.share
        )
    return PredictionFit(role=evaluation.headline_set, fit=1 - found.ratio, low=low, high=high, largest_errors=where)


def prediction_change(found: validation.PredictionChange, role: Role) -> PredictionChangeRow | None:
    """Return the table row of a change of the prediction errors over the horizon; None if no channel can be compared.

    Parameters
    ----------
    found
        Change of the errors from the model without effects to the model with them.
    role
        Role of the data on which the errors were computed, ``estimation`` or ``validation``.
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
    """Return the calibration of the prediction intervals for each set of data, kind of prediction and channel.

    A scale (RMS of error over predicted standard deviation) or an interval that is not finite is None.
    """

    def table(found: Mapping[str, Calibration], simulated: bool = False) -> dict[str, CalibrationRow]:
        """Return the calibration by channel as table rows for one kind of prediction, such as one step ahead."""
        return {
            name: CalibrationRow(
                n=c.n,
                n_effective=c.n_effective,
                n_records=c.n_records,
                inside_50=c.inside_50,
                inside_95=c.inside_95,
                scale=finite(c.scale),
                low=finite(c.low),
                high=finite(c.high),
                pit=c.pit,
                widening=finite(c.simulation_widening if simulated else c.widening),
                verdict=c.verdict,
            )
            for name, c in found.items()
        }

    return Calibrations(
        **{
            role: CalibrationTable(
                one_step=table(data.calibration.one_step),
                horizon=table(data.calibration.horizon),
                simulation=table(data.calibration.simulation, simulated=True),
            )
            for role, data in evaluation.sets.items()
        }
    )


def traces(after: PredictionEvaluation, before: PredictionEvaluation | None = None) -> tuple[Trace, ...]:
    """Return each measured channel of each record over time, with its prediction over the horizon and its simulation.

    Instants without a measurement of the channel are left out, and so are channels without any measurement. Estimation
    records come first.

    Parameters
    ----------
    after
        Evaluation of the model.
    before
        Evaluation of another model on the same records, whose simulations and predictions are added. None: no other
        model.
    """
    return tuple(
        Trace(
            record=now.record.name,
            role=role,
            channel=o.name,
            unit=o.unit,
            angle=o.angle,
            t=now.record.t_log[seen],
            measured=now.record.y[seen, j],
            model=now.simulation.y[seen, j],
            sd=now.simulation.sd[seen, j],
            diverged=None if (end := now.simulation.diverged.get(o.name)) is None else end + now.record.t_from,
            before=None if then is None else then.simulation.y[seen, j],
            t_horizon=far.t + now.record.t_from,
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
    """Return the measured and the simulated track of each record with positions, estimation records first.

    Instants without a measured position are left out. The result is empty for a model without the output ``x``.

    Parameters
    ----------
    after
        Evaluation of the model.
    before
        Evaluation of another model on the same records, whose simulated tracks are added. None: no other model.
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
    """Return (role, prediction by the model, prediction by the other model) of each record, estimation records first.

    The role is that of the record's data, ``estimation`` or ``validation``. The last entry is None if ``before``, the
    evaluation of the other model, is None.
    """
    found: list[tuple[Role, RecordPrediction, RecordPrediction | None]] = []
    roles: tuple[Role, ...] = ("estimation", "validation")
    for role in roles:
        new, old = getattr(after, role), getattr(before, role, None)
        if new is not None:
            found += [(role, now, None if old is None else old.records[k]) for k, now in enumerate(new.records)]
    return found


def record_inputs(model: Model, record: Record) -> tuple[InputTrace, ...]:
    """Return the inputs of a record over time as rows of a result: those of the model's inputs that reports show.

    Time, the work of the thrusters and the delayed copies of an input are not shown. Times count from the start of the
    record. An averaged input has its mean in the interval after each time.

    Parameters
    ----------
    model
        Model that uses the inputs.
    record
        Record with the values of all inputs of the model.
    """
    given = given_inputs(model, record)
    return tuple(
        InputTrace(record=record.name, name=name, unit=unit, t=record.t, value=given[:, j])
        for j, name, unit in shown_inputs(model)
    )


def all_inputs(evaluation: PredictionEvaluation) -> tuple[InputTrace, ...]:
    """Return the inputs of all records of an evaluation over time as rows of a result, estimation records first.

    They are the inputs that reports show (`record_inputs`). Times count from the start of the log.
    """
    return tuple(
        msgspec.structs.replace(row, t=row.t + prediction.record.t_from)
        for data in evaluation.sets.values()
        for prediction in data.records
        for row in record_inputs(evaluation.model, prediction.record)
    )


def residual_rows(before: PredictionEvaluation, after: PredictionEvaluation | None = None) -> tuple[ResidualTests, ...]:
    """Return the whiteness tests of the residuals, one row for each estimation record and channel.

    Parameters
    ----------
    before
        Evaluation of the model; in a diagnosis, of the model without effects.
    after
        Evaluation of the model with effects, whose tests are added to the rows of the same record and channel. A
        channel that was tested with this model only has no row. None: no second model.
    """
    later = {} if after is None else {(r.record, r.channel): r for r in after.residuals}
    return tuple(residual_row(r, later.get((r.record, r.channel))) for r in before.residuals)


def residual_row(r: ChannelResiduals, after: ChannelResiduals | None = None) -> ResidualTests:
    """Return the table row of whiteness tests of one channel of a record.

    Parameters
    ----------
    r
        Residuals of the channel with their tests.
    after
        Residuals of the model with added effects, whose tests the row gets too. None: no second model.
    """
    return ResidualTests(
        **msgspec.structs.asdict(_whiteness_tests(r)),
        role=r.role,
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
    """Return the residuals of a channel and their whiteness tests, without names, times, lags and frequencies.

    A row has these other entries only once, those of the model without effects. A p value that is not finite is None.
    """
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
    """Return the correlations of the residuals with the inputs, one row for each estimation record, channel and input.

    Parameters
    ----------
    before
        Evaluation of the model; in a diagnosis, of the model without effects.
    after
        Evaluation of the model with effects, whose correlations are added to the rows of the same record, channel and
        input. A correlation that only this model has gets no row. None: no second model.
    """
    later = {} if after is None else {(r.record, r.channel): r for r in after.residuals}
    return tuple(row for r in before.residuals for row in cross_rows(r, later.get((r.record, r.channel))))


def cross_rows(r: ChannelResiduals, after: ChannelResiduals | None = None) -> list[CrossCorrelationRow]:
    """Return the table rows of the correlations of one channel's residuals with the inputs, one row for each input.

    Parameters
    ----------
    r
        Residuals of the channel with their correlations.
    after
        Residuals of the model with added effects, whose correlations the rows get too. None: no second model.
    """
    later = {
        c.input: CorrelationTest(z=c.z, p=finite(c.p), largest=finite(c.largest))
        for c in (() if after is None else after.inputs)
    }
    return [
        CrossCorrelationRow(
            role=r.role,
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
    """Return the table row of a profile likelihood, in the units in which the estimates are reported.

    An end of an interval that is not finite is None.

    Parameters
    ----------
    found
        Profile likelihood of a parameter, in the unit of the parameter.
    reported
        Converter to reported units: ratios to the thrust if the thrust was not given.
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
        Homogeneity test of a parameter, in the unit of the parameter.
    reported
        Converter to reported units: ratios to the thrust if the thrust was not given.
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
    """Return the table row of a homogeneity test: one value of a parameter for all logs against one for each log.

    The numbers of ``a`` are copied, so that it must already be in reported units (``homogeneity_reported``). The
    scatter, the mean with its interval, and the standard errors of the mean and of the common value become None if they
    are not finite.
    """
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
    """Return the estimates of an effect's parameters, one row for each parameter, in reported units.

    A parameter with its own value in each run (per-record parameter) has one row for each run. For an effect of the
    kind "differs between runs", the rows are the differences from the first run instead.

    Parameters
    ----------
    effect : Effect
        Effect of the fitted model.
    fitted : FittedModel
        Fitted model, whose estimates are reported: as ratios to the thrust if the thrust was not given.
    """
    reported, rows = ReportedEstimates(fitted.fit), []
    stuck = {name for name, flag in fitted.fit.flags if flag == AT_BOUND}
    for p in effect.parameters:
        runs = fitted.fit.records if p.per_record else ("",)
        own = [replace(p, segment=i).full_name if p.per_record else p.full_name for i in range(len(runs))]
        found = [
            (f", in {run}" if len(runs) > 1 else "", *reported.estimate(p, i), own[i] in stuck)
            for i, run in enumerate(runs)
        ]
        if effect.kind is EffectKind.BETWEEN_RUNS and p.per_record:
            k = reported.factor(p.unit)
            differences = run_differences(fitted.fit, p.name)
            found = [(f", {d.record} against {runs[0]}", k * d.value, k * d.error, False) for d in differences]
        name, unit = reported.scale.name(p.name, p.unit), reported.scale.unit(p.unit)
        rows += [
            EffectParameter(
                name=name, meaning=p.meaning + where, unit=unit, value=value, se=finite(error), at_bound=at_bound
            )
            for where, value, error, at_bound in found
        ]
    return tuple(rows)


def common_errors_row(found: CommonErrorsFit | None, fitted: FittedModel, role: Role) -> CommonErrorsRow | None:
    """Return the table row of the common errors with their gain and their estimates.

    Common errors are the small errors that every craft has. They concern the timing and mounting of sensors, and the
    form of the hull.

    Parameters
    ----------
    found : CommonErrorsFit or None
        Fit with the common errors. None if the model has no common errors; the result is then None.
    fitted : FittedModel
        Last fitted model, with the estimates of the common errors.
    role : Role
        Role of the data on which the change of the prediction errors was computed.

    Returns
    -------
    CommonErrorsRow or None
        The keys of the gains are None if the common errors were in the model that was given.
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


def common_errors_notes(
    found: CommonErrorsFit | None, beside: str, rejected: RejectedCommonErrors | None = None
) -> list[str]:
    """Return a note that names the common errors in the model and states their gain on the validation data.

    Common errors are small errors that every craft has: sensor timing, mounting, hull form. If they were in the model
    that was given, their gain is unknown, and the note says this.

    Parameters
    ----------
    found : CommonErrorsFit or None
        Fit with the common errors. None if the model has none.
    rejected : RejectedCommonErrors or None
        Common errors that were tried and not added. If ``found`` is None, the note names them and the reason. If both
        are None, the list is empty.
    beside : str
        What they are estimated together with, for example "the effects".
    """
    if found is None:
        return [] if rejected is None else [_rejected_sentence(rejected, beside)]
    titles = listed([e.title for e in found.effects])
    gains = found.gains
    support = (
        "they were in the model that was given"
        if gains is None
        else f"their gain in log-likelihood of the validation data is {gains.validation_gain:.0f}, t = {gains.t:.1f}"
    )
    return [f"Small errors that every craft has are estimated together with {beside}: {titles} ({support})."]


def _rejected_sentence(rejected: RejectedCommonErrors, beside: str) -> str:
    """Return the sentence about common errors that the score tests ask for and that a model does not get."""
    return (
        f"Small errors that every craft has are not estimated together with {beside}, although the score tests ask for "
        f"them ({listed([e.title for e in rejected.effects])}), because {rejected.reason}. Without them, masses and "
        "damping may be biased, and the score tests may find other effects in their place."
    )


SCORES_PASS = "By the score tests"  # begins the note on effects that may be missing
LEAST_GROWTH = 1.05  # smallest factor of a standard error that a note lists
# Mass in surge over the weighed mass, of most boats: the added mass of a slender hull is 5 to 30 % of the mass
LIKELY_MASS = (1.0, 1.35)
RIVALS_NAMED = 3  # most effects that a warning on the thrusts names as other causes
LEAST_DIFFERENCE = 0.05  # smallest relative deviation of the thrust of each side for a warning


def model_uncertainty_notes(found: ModelUncertainty | None, fit: Fit) -> list[str]:
    """Return a note on standard errors that include the uncertainty of the model.

    Missing effects (candidates) that still pass the score tests would shift the estimates. The note ends with up to
    three parameters whose standard errors this increases most, by 5 % or more, with the factors. If there is none, it
    states so.

    Parameters
    ----------
    found : ModelUncertainty or None
        Shifts of the estimates by these candidates. If it is None, has no candidate or increases no standard error, the
        list is empty.
    fit : Fit
        Fit whose standard errors include the shifts.
    """
    if found is None or not found.candidates or not (grown := _error_growth(found, fit)):
        return []
    most = sorted((name for name, factor in grown.items() if factor >= LEAST_GROWTH), key=lambda n: -grown[n])
    labels = {name: parameter_label(p, fit) for name, p in zip(fit.names, fit.parameters, strict=True)}
    factors = ", ".join(f"{labels[name]} {grown[name]:.2g}" for name in most[:3])
    return [
        f"{SCORES_PASS} {counted(len(found.candidates), 'effect')} may be missing, each of which would shift the "
        "estimates: `seatrial ident diagnose` searches for missing effects. The standard errors include this "
        "uncertainty of the model"
        + (
            f"; it increases them most by these factors: {factors}."
            if factors
            else ", which adds less than 5 % to them."
        )
    ]


def thrust_difference_warnings(
    found: ModelUncertainty | None, fit: Fit, weighed: float | None, *, diagnosed: bool = False
) -> list[ResultWarning]:
    """Return a list with a warning if both sides differ in thrust by so much that masses and forces are uncertain.

    If the fit has not estimated the difference, but a candidate that passes the score tests has one, the warning names
    the other candidates that act like it, and which of them the tests prefer.

    Parameters
    ----------
    found : ModelUncertainty or None
        Uncertainty of the model. The list is empty for None, and if each side deviates by less than 5 %.
    fit : Fit
        Fit whose standard errors include this uncertainty.
    weighed : float or None
        Weighed mass of the boat [kg]; None: unknown.
    diagnosed : bool
        Whether the fit is that of a diagnosis, which has tested the candidates against each other.
    """
    if found is None or found.thrust_difference < LEAST_DIFFERENCE:
        return []
    share, whole = (f"{100 * part * found.thrust_difference:.0f} %" for part in (1, 2))
    weaker, stronger = _sides(found)
    if found.thrust_rivals:
        begin = f"{_possible_difference(found, whole, diagnosed=diagnosed)} If the thrusts differ, the"
    else:
        less = f"The {weaker} thruster gives less thrust than the {stronger} one: the" if found.weaker_side else "The"
        begin = f"{less} thrusts of both sides differ by {whole} of their mean. The"
    text = (
        f"{begin} motion does not show which side deviates from the given thrust. So all masses, damping and forces "
        f"may be {share} too large or too small, and their standard errors include this. "
        f"{_side_by_weighed_mass(found, fit, weighed)}If you know which side has the given thrust, name it with "
        "--thrust-of (left or right). Otherwise measure the thrust of both sides as they are now (seatrial bench)."
    )
    return [ResultWarning(code="thrust-sides-differ", text=text)]


def _possible_difference(found: ModelUncertainty, whole: str, *, diagnosed: bool) -> str:
    """Return sentences on a difference of thrust that the model lacks, and on the effects that act like it.

    Parameters
    ----------
    found : ModelUncertainty
        Uncertainty of a model without a difference of thrust, with the candidates that may be the cause.
    whole : str
        Difference of thrust, in per cent of the mean of both sides.
    diagnosed : bool
        Whether the result is that of a diagnosis, which has tested the candidates against each other.
    """
    weaker, stronger = _sides(found)
    known = catalogue()
    others = [n for n in found.thrust_rivals if not (n in known and known[n].thrust_difference)]
    first = found.thrust_rivals[0]
    less = f"the {weaker} thruster would give less than the {stronger} one, " if found.weaker_side else ""
    by = f"{less}by {whole} of their mean"
    text = f"The model lacks a force or moment that acts like a difference of the thrusts ({by})."
    if others:
        names = listed([f"{candidate_title(n)} ({n})" for n in others[:RIVALS_NAMED]], "and")
        rest = len(others) - RIVALS_NAMED
        more = f", as do {counted(rest, 'other effect')}" if rest > 0 else ""
        text += (
            f" It is not proved that the thrusts differ: {names} explain{'s' * (len(others) == 1)} similar data{more}"
        )
        text += f"; the score tests prefer {first}." if first in others else "."
    if not diagnosed:
        text += " `seatrial ident diagnose` tests the causes against each other."
    return text


THRUST_KNOWN = "By --thrust-of, the given thrust is that of"  # begins a note that the terminal shows


def thrust_of_notes(fit: Fit) -> list[str]:
    """Return a note on the side that has the given thrust, if the user knows it (`with_thrust_of`); else no note."""
    of = thrust_of(fit.model)
    if not of:
        return []
    begin = f"{THRUST_KNOWN} {'the mean of both thrusters' if of == 'both' else f'the {of} thruster'}"
    names = [e.thrust_difference for e in fit.model.effects if e.thrust_difference]
    if not names:
        return [f"{begin}. The model has no difference of the sides (effect mismatch), so that both have this thrust."]
    eps = fit.estimate(names[0])[0]
    factors = {"left": 1.0 + eps, "right": 1.0 - eps}
    share = {side: f"{100.0 * factor / factors.get(of, 1.0):.0f} %" for side, factor in factors.items()}
    rest = " and ".join(f"the {side} one has {words}" for side, words in share.items() if side != of)
    return [
        f"{begin}; {rest} of it. Masses, damping and forces follow from it, and their standard errors have no part for "
        "the side that deviates."
    ]


def sides_compare_mass(found: ModelUncertainty | None, fit: Fit, weighed: float | None) -> bool:
    """Return whether `thrust_difference_warnings` compare the mass in surge with the weighed mass [kg]."""
    if found is None or found.thrust_difference < LEAST_DIFFERENCE:
        return False
    return bool(_side_by_weighed_mass(found, fit, weighed))


def _sides(found: ModelUncertainty) -> tuple[str, str]:
    """Return the words for the side with the smaller and with the larger thrust: left and right, if it is known."""
    return {"left": ("left", "right"), "right": ("right", "left")}.get(found.weaker_side, ("weaker", "stronger"))


def _side_by_weighed_mass(found: ModelUncertainty, fit: Fit, weighed: float | None) -> str:
    """Return a sentence on the side for which the weighed mass [kg] speaks, with a space at its end, or empty text.

    The stronger or the weaker side may have the given thrust. Each of both gives a mass in surge. The text is empty
    unless one of them is 1 to 1.35 times the weighed mass, and the other one outside by more than two standard errors.
    """
    if weighed is None or "m_u" not in fit.names or "m_u" not in found.parameters:
        return ""
    mass, error = fit.estimate("m_u")
    of_scale = float(found.scale_shift[found.parameters.index("m_u")])
    # The scale is what the two cases decide: its part of the standard error does not count.
    own = (math.sqrt(error**2 - of_scale**2) if error > abs(of_scale) else error) / weighed
    strong, weak = (1.0 + way * found.thrust_difference for way in (1.0, -1.0))
    if not weak > 0.0 or not math.isfinite(own):
        return ""
    low, high = LIKELY_MASS
    ratio = {scale: mass / weighed / scale for scale in (strong, weak)}
    likely = [scale for scale in ratio if low <= ratio[scale] <= high]
    outside = [s for s in ratio if ratio[s] - 2.0 * own / s > high or ratio[s] + 2.0 * own / s < low]
    if len(likely) != 1 or len(outside) != 1:
        return ""
    of_strong = likely == [strong]
    weaker, stronger = _sides(found)
    side, other = (stronger, weaker) if of_strong else (weaker, stronger)
    change = "has lost thrust" if of_strong else "gives more thrust"
    return (
        f"The weighed mass is evidence, though no proof, that the {side} side has the given thrust and the {other} one "
        f"{change}: m_u is then {ratio[likely[0]]:.2f} times the weighed {weighed:g} kg, otherwise "
        f"{ratio[outside[0]]:.2f} times, and 1.05 to 1.3 times is usual. "
    )


def _error_growth(found: ModelUncertainty, fit: Fit) -> dict[str, float]:
    """Return the factor by which the uncertainty of the model increases each standard error, by full name.

    Parameters whose standard error it does not increase are left out.
    """
    variance = dict(zip(found.parameters, np.diag(found.covariance), strict=True))
    return {
        name: float(error / np.sqrt(error**2 - variance[name]))
        for name, error in zip(fit.names, fit.errors, strict=True)
        if name in variance and error**2 > variance[name] > 0.0
    }


def name_probabilities(effects: Sequence[EffectRow]) -> str:
    """Return sentences with the attribution of each added effect, and the share of such names that were right.

    The share is that of simulated boats with known effects, so it is no probability for the boat of the logs. Effects
    without a known share are left out. The text is empty if none is left.
    """
    titles, shares = dict[str, list[str]](), dict[str, float]()
    for e in effects:
        if e.probability is not None:
            titles.setdefault(e.attribution, []).append(e.title)
            shares[e.attribution] = e.probability
    if not titles:
        return ""
    names = "; ".join(f"{attribution}: {', '.join(found)}" for attribution, found in titles.items())
    right = [f"{100.0 * p:.0f} % of the names that were {attribution}" for attribution, p in shares.items()]
    return (
        f"Names of the effects: {names}. On simulated boats with known effects, {' and '.join(right)} were right; this "
        "is no probability for your boat."
    )


def causes_sentence(effects: Sequence[EffectRow]) -> str:
    """Return a sentence that names the usual physical causes of each effect.

    The text is empty if the catalogue has no causes for these effects.
    """
    known = [f"{e.title}: {e.causes}" for e in effects if e.causes]
    return f"Look for the cause of {'; of '.join(known)}." if known else ""
