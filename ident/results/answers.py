"""Sentences of the results: answers, warnings and notes of fits, thruster tests and designs.

Reports and the terminal print these sentences. Warnings are about what must be known before an estimate is used: a fit
that did not converge, a stuck sensor, an unknown scale.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from seatrial.daq.checks import FAULT
from seatrial.ident.characterisation import Levels, Quadratic, ThrustCurve, steady_thrust
from seatrial.ident.data import ORIGIN, Record
from seatrial.ident.estimation import (
    FailedRun,
    Fit,
    FittedModel,
    HomogeneityTest,
    ThrustScale,
    contradicted_priors,
    least_yaw_inertia,
    thrust_scale_of,
    unexcited_motion,
)
from seatrial.ident.model import Model
from seatrial.ident.results.parts import (
    Calibrations,
    CrossCorrelationRow,
    Errors,
    PredictionChangeRow,
    PredictionFit,
    Provenance,
    ResidualTests,
    ResultWarning,
)
from seatrial.ident.results.tables import format_number
from seatrial.ident.validation import FEWEST, OUTLIER_SDS, ChannelResiduals

NAMES = {
    "x": "north",
    "y": "east",
    "psi": "heading",
    "r": "yaw rate",
    "u": "surge speed",
    "v": "sway speed",
    "vx": "velocity north",
    "vy": "velocity east",
    "ax": "surge specific force",
    "ay": "sway specific force",
    "speed": "speed over ground",
    "n": "shaft speed",
}
LATE_CODES = frozenset({"sensor-late", "thrust-late", "motion-late"})  # findings of `seatrial check`
DELAY_BIASED = frozenset({"m", "d", "T", "K"})  # first letters of masses, damping, time constants and gains
MOST_NAMES = 4  # channels or logs that a sentence lists by name
FINE_SHIFT_PERCENT = 2.0  # smaller changes are printed with one decimal
FACTOR_FROM = 3.0  # larger ratios of errors are printed as a factor, not in per cent
LEVEL = 0.01  # significance level of the whiteness tests
MEASURED_INPUTS = {"phi", "theta", "psi", "p", "q", "r"}  # inputs that are sensor outputs and contain sensor noise
WIDE_INTERVAL = 0.5  # a wider 95 % interval of the fit is replaced by the interval of time that causes it
NO_DEAD_ZONE = 5e-4  # of full command: a smaller dead zone would be printed as 0.0 %
RAMP_SHARE = 0.05  # share of the rows, smallest commands first, that may belong to a ramp
FEWEST_SAMPLES = 10  # equal samples from which a sensor is called stuck


def change_sentence(change: PredictionChangeRow, horizon: float) -> str:
    """Return the sentence of a result on how added effects changed the prediction errors over the horizon [s].

    The sentence claims a fall or a rise only if ``change.verdict`` does, and a rise by three times or more is a factor
    instead of per cent. Up to four better channels and all worse channels are named. Without an interval the sentence
    says that the data are too short.

    Parameters
    ----------
    change
        Change of the errors over the horizon, with its 95 % interval and verdict.
    horizon
        Prediction horizon [s].
    """
    begin = f"{horizon:g} s ahead on {change.role} data, all channels: "
    if change.low is None or change.high is None:
        return f"{begin}the data are too short to tell whether the prediction error changes."
    shift, low, high = (100 * (r - 1) for r in (change.ratio, change.low, change.high))
    places = 0 if abs(shift) >= FINE_SHIFT_PERCENT else 1
    rounded = [round(r, places) + 0.0 for r in (shift, low, high)]  # + 0.0 turns -0 into 0
    by, least, most = (f"{abs(r):.{places}f}" for r in rounded)
    if change.verdict == "unchanged":
        by, least, most = (f"{r:+.{places}f}" for r in rounded)
        effect = f"no significant change of the prediction error ({by} %; 95 %: {least} to {most} %)"
    elif change.verdict == "fell":
        effect = f"prediction error falls by {by} % (95 %: {most} to {least} %)"
    elif change.ratio < FACTOR_FROM:
        effect = f"prediction error rises by {by} % (95 %: {least} to {most} %)"
    else:
        effect = f"prediction error is {format_number(change.ratio)} times as large "
        effect += f"(95 %: {format_number(change.low)} to {format_number(change.high)})"
    named = [("better", change.better, MOST_NAMES), ("worse", change.worse, len(change.worse))]
    parts = [effect, *(f"{word}: {_first_names(names, most)}" for word, names, most in named if names)]
    return f"{begin}{'; '.join(parts)}."


def _first_names(channels: Sequence[str], most: int = MOST_NAMES) -> str:
    """Return the first ``most`` of some names for a sentence, separated by commas, and the number of the others.

    ``channels``: names of channels or logs. Known channels are written out: ``psi`` as heading.
    """
    names = [NAMES.get(name, name) for name in channels]
    more = len(names) - most
    return ", ".join(names) if more <= 0 else f"{', '.join(names[:most])} and {more} more"


def _percent(share: float) -> str:
    """Return a share (1: all) in whole per cent for a sentence: 0.34 -> ``34 %``."""
    return f"{100 * share:.0f} %"


def vehicle_answer(
    prediction: PredictionFit | None,
    errors: Errors,
    horizon: float,
    residuals: Sequence[ResidualTests],
    cross: Sequence[CrossCorrelationRow],
    *,
    searchable: bool,
) -> str:
    """Return the answer of a vehicle fit: the fit over the horizon and the whiteness of the residuals.

    Parameters
    ----------
    prediction : PredictionFit or None
        Fit of all channels over the horizon. Without it the answer has only the sentence on the residuals.
    errors : Errors
        RMS prediction errors by channel.
    horizon : float
        Prediction horizon [s].
    residuals : sequence of ResidualTests
        Whiteness tests of each record and channel.
    cross : sequence of CrossCorrelationRow
        Correlations of the residuals with each input.
    searchable : bool
        Whether `seatrial ident diagnose` can search this model for missing effects.
    """
    fit_sentence = "" if prediction is None else f"{_fit_sentence(prediction, errors, horizon)} "
    return f"{fit_sentence}{_whiteness_sentence(errors, residuals, cross, searchable)}"


def _fit_sentence(prediction: PredictionFit, errors: Errors, horizon: float) -> str:
    """Return the sentence on the fit of all channels over the horizon [s], with the best and the worst channel.

    The channels are those of the validation data, or of the estimation data if there are no others. If the prediction
    of some channels diverges, the sentence names only them.
    """
    begin = f"{horizon:g} s ahead on {prediction.role} data, all channels: "
    table = errors.estimation if errors.validation is None else errors.validation
    lost = [n for n, row in table.horizon.items() if row.after is None]
    if lost:
        return f"{begin}the prediction diverges ({_first_names(lost)})."
    each = {n: 1 - (row.after or 0.0) / row.spread for n, row in table.horizon.items() if row.spread}
    low, high, largest = prediction.low, prediction.high, prediction.largest_errors
    interval = "" if low is None or high is None else f" (95 %: {100 * low:.0f} to {100 * high:.0f} %)"
    if low is not None and high is not None and high - low > WIDE_INTERVAL and largest is not None:
        interval = (
            f" (without a useful interval: {_percent(largest.share)} of the squared errors are from "
            f"{largest.begin:.0f} to {largest.end:.0f} s of {largest.record})"
        )
    ends = [f"{_percent(each[n])} ({NAMES.get(n, n)})" for n in sorted(each, key=lambda n: -each[n])]
    span = f", from {ends[0]} to {ends[-1]}" if len(ends) > 1 else ""
    return f"{begin}fit {_percent(prediction.fit)}{interval}{span}."


def _whiteness_sentence(
    errors: Errors, residuals: Sequence[ResidualTests], cross: Sequence[CrossCorrelationRow], searchable: bool
) -> str:
    """Return the sentence on the residuals: whether they are white and uncorrelated with the inputs.

    Each is tested at 1 % over all channels; the level is divided by the number of tests (Bonferroni). Without tests the
    sentence says that there are too few samples. ``searchable`` adds the advice to run `seatrial ident diagnose`.
    """
    tests = [p for r in residuals for p in (r.ljung_box_p, r.periodogram_p)]
    pairs = [c for c in cross if c.p is not None]
    significant = [c for c in pairs if c.p is not None and c.p * len(pairs) < LEVEL]
    correlated_inputs = {c.input for c in significant}
    coloured = any(p is not None and p * len(tests) < LEVEL for p in tests)
    if not tests:
        least = f"the test takes {FEWEST} samples of a channel"
        return f"There are too few samples to test whether the residuals are white: {least}."
    if not correlated_inputs and not coloured:
        hidden = ". Disturbance forces can still hide an effect: `seatrial ident diagnose` tests for it"
        untested = _untested_channels(errors, residuals)
        return f"The residuals are white and uncorrelated with the inputs{hidden if searchable else ''}{untested}."
    if correlated_inputs and correlated_inputs <= MEASURED_INPUTS:
        named = " and ".join(sorted(correlated_inputs))
        return (
            f"The residuals are correlated with {named}, which the model takes as measured: the cause can be the noise "
            f"of these measurements rather than a missing effect{'. They are not white' if coloured else ''}."
        )
    end = f"The residuals are correlated with the inputs{_largest_correlation(significant)}"
    if not correlated_inputs:
        end = "The residuals are not white"
    either = ": an effect is missing, or the noise of a sensor is autocorrelated"
    how = ": run `seatrial ident diagnose` to see whether an effect is missing" if searchable else either
    return f"{end}{how}."


def _largest_correlation(significant: Sequence[CrossCorrelationRow]) -> str:
    """Return the largest of the significant correlations of residuals with inputs, with its channel in brackets.

    Empty if there is none. The size matters, because in a long record even negligible correlations are significant.
    """
    most = max((c for c in significant if c.largest is not None), key=lambda c: c.largest or 0.0, default=None)
    return "" if most is None else f" (correlation up to {most.largest:.2g}, {NAMES.get(most.channel, most.channel)})"


def _untested_channels(errors: Errors, residuals: Sequence[ResidualTests]) -> str:
    """Return, in brackets for a sentence, the channels of the estimation data with too few samples for residual tests.

    Empty if there are none.
    """
    tested = {r.channel for r in residuals}
    left = [n for n in errors.estimation.one_step if n not in tested]
    return f" (too few samples to test: {', '.join(left)})" if left else ""


def calibration_notes(calibration: Calibrations, horizon: float) -> list[str]:
    """Return one sentence for each kind of prediction whose intervals are too narrow or too wide, with the channels.

    The kinds are one step ahead, over the horizon [s] and simulated. The sentences are about the validation data, or
    about the estimation data if there are no validation data. Empty if all intervals are right.

    Parameters
    ----------
    calibration
        Calibration of each channel by set of data and kind of prediction.
    horizon
        Prediction horizon [s].
    """
    role, table = ("validation", calibration.validation)
    if table is None:
        role, table = "estimation", calibration.estimation
    kinds = (
        ("one step ahead", table.one_step),
        (f"{horizon:g} s ahead", table.horizon),
        ("simulated", table.simulation),
    )
    notes = []
    for verdict, size in (("overconfident", "larger"), ("underconfident", "smaller")):
        for words, channels in kinds:
            wrong = [
                f"{n} {'diverged' if c.scale is None else format(c.scale, '.2g')}"
                for n, c in channels.items()
                if c.verdict == verdict
            ]
            if wrong:
                notes.append(
                    f"On {role} data, {words}, errors are {size} than the model predicts, by these factors: "
                    f"{', '.join(wrong)}."
                )
    return notes


def estimation_warnings(fit: Fit, records: Sequence[Record], length: float | None = None) -> list[ResultWarning]:
    """Return the warnings of a fit, those about its scale first.

    Further warnings are about declared noise or priors that the data contradict, masses that the data do not determine,
    a yaw inertia that is too small for the mass, records that were cut, and stuck sensors.

    Parameters
    ----------
    fit : Fit
        The fit.
    records : sequence of Record
        Records that the parameters were fitted to.
    length : float, optional
        Length of the hull [m]; without it the least yaw inertia follows from the thrusters' arms alone.
    """
    warnings = scale_warnings(thrust_scale_of(fit.model))
    for p, value, widths in contradicted_priors(fit):
        mean, sd = p.prior or (math.nan, math.nan)
        if p.name in fit.model.noises:
            text = (
                f"The residuals contradict the declared {p.meaning}: {p.name} = {mean:.3g} {p.unit} was given, the "
                f"estimate is {value:.3g} {p.unit}. The fit uses the estimate; the given value is only its prior."
            )
            warnings.append(ResultWarning(code="noise-contradicted", text=text))
            continue
        text = (
            f"The data contradict the prior of {p.full_name}: {mean:.4g} ± {sd:.2g} {p.unit} was given, the estimate "
            f"is {value:.4g} {p.unit}, {abs(widths):.1f} standard deviations away. Check the prior and the other given "
            "values (thrust, arms, units)."
        )
        warnings.append(ResultWarning(code="prior-contradicted", text=text))
    if fit.converged and (left := fit.distance_left) is not None:
        text = (
            f"The fit stopped close to its maximum: its estimates can still move by {left:.2g} standard errors. Use "
            "--initial with these estimates to continue, or a model with fewer free parameters."
        )
        warnings.append(ResultWarning(code="nearly-converged", text=text))
    if (lost := unexcited_motion(fit, records)) is not None:
        text = (
            f"T{lost.clause[1:]}. The standard error is more than half of "
            "the estimate. Record a mission with turns, stops and "
            "changes of speed (seatrial mission generate --kind mixed)."
        )
        warnings.append(ResultWarning(code="motion-not-excited", text=text))
    least = least_yaw_inertia(fit, length)
    if least is not None and fit.estimate("m_r")[0] < least:
        text = (
            f"m_r is {fit.estimate('m_r')[0]:.3g} kg m2, but a rigid body with this mass has at least {least:.2g} "
            "kg m2. Check the thrust, the arms and the unit of the yaw rate."
        )
        warnings.append(ResultWarning(code="inertia-too-small", text=text))
    return warnings + cut_records(records) + stuck_sensors(records)


def design_warnings(model: Model, thrust: float, pole: float | None) -> list[ResultWarning]:
    """Return warnings about the built-in values that an experiment design assumes.

    Parameters
    ----------
    model : Model
        The model that is designed for.
    thrust : float
        Assumed thrust of one thruster at full speed [N], if the inputs of the model are forces.
    pole : float or None
        Assumed pole of the shafts between command and model [1/s]; None if the model contains the shafts.
    """
    warnings = scale_warnings(thrust_scale_of(model))
    forces = [i.name for i in model.inputs if i.unit in ("N", "N m")]
    if forces:
        text = (
            f"The model takes {', '.join(forces)} as input, not commands: the design assumes thrusters with a "
            f"built-in thrust of {thrust:.0f} N at full speed on built-in arms. The standard errors hold for such "
            "thrusters."
        )
        warnings.append(ResultWarning(code="thrust-scale-unknown", text=text))
    if pole is not None:
        text = (
            f"The design assumes a built-in time constant of the shafts of {1e3 / pole:.0f} ms, even if a bench test "
            "found another. With slower shafts the standard errors of a fit will be larger."
        )
        warnings.append(ResultWarning(code="shaft-lag-built-in", text=text))
    return warnings


def scale_warnings(scale: ThrustScale) -> list[ResultWarning]:
    """Return one warning each if the thrust or the thrusters' arms were not given.

    Masses and inertias are then ratios to the thrust or to the arm.
    """
    warnings = []
    if scale.relative:
        text = (
            "The thrust was not given, and motion alone determines only ratios. Masses, damping and forces are divided "
            "by T, the full forward thrust of one thruster (c1 + c2); multiply them by T. Give --thruster MODEL, "
            "--fix c1=..., --prior c1=MEAN:SD, or [scale] in the import map."
        )
        warnings.append(ResultWarning(code="thrust-scale-unknown", text=text))
    if scale.relative_yaw:
        text = (
            "The thrusters' arms were not given: inertia and damping in yaw are divided by the arm y_arm. The Munk "
            "moment (m_u - m_v) u v determines y_arm only roughly, and wrongly if the hull has other moments of that "
            "form. Give the rig's [[thruster]] position_m, --fix y_left=... --fix y_right=..., or [geometry] in the "
            "import map."
        )
        warnings.append(ResultWarning(code="arm-unknown", text=text))
    return warnings


def outlier_lines(residuals: Sequence[ChannelResiduals], model: Model) -> list[str]:
    """Return one sentence with advice for each record and channel that has outliers among its innovations.

    Channels that are already estimated robustly have no sentence.

    Parameters
    ----------
    residuals
        Innovations of each record and channel, with their tests.
    model
        Model, of which the outputs that are estimated robustly are left out.
    """
    robust = {o.name for o in model.outputs if o.robust}
    lines = []
    for r in residuals:
        if r.tests.outliers and r.channel not in robust:
            lines.append(
                f"{r.record}: {r.tests.outliers} of {r.e.size} innovations of {r.channel} are beyond {OUTLIER_SDS:g} "
                f"standard deviations, the largest at {r.tests.largest:.2g}: outliers, or an event that the model "
                "lacks. --robust gives outliers little weight."
            )
    return lines


def faults_first(made: Provenance) -> str:
    """Return the beginning of an answer that was fitted to logs with faults (`--despite-faults`).

    Empty if no log has a fault that makes a fit meaningless.
    """
    faults = [f"{log.path}: {f.where}: {f.text}" for log in made.logs for f in log.findings if f.spoils]
    return f"The logs have faults that can make this result meaningless ({'; '.join(faults)}). " * bool(faults)


def check_warnings(made: Provenance) -> list[ResultWarning]:
    """Return one warning for each finding of the checks before a fit, with up to four of the logs that have it."""
    logs: dict[str, list[str]] = {}
    for log in made.logs:
        for f in log.findings:
            logs.setdefault(f"{f.where}: {f.text} [{f.code}]{': ' * bool(f.advice)}{f.advice}.", []).append(log.path)
    return [ResultWarning(code="log-check", text=f"{_first_names(paths)}: {text}") for text, paths in logs.items()]


def late_sensor_warnings(made: Provenance, model: Model) -> list[ResultWarning]:
    """Return a warning if a log has a late sensor or thrust signal, with the parameters that the delay biases.

    Only delays that `seatrial check` calls a fault count. Empty if no free parameter is a mass, damping, time constant
    or gain.

    Parameters
    ----------
    made
        Provenance of the result, with the findings of `seatrial check` for each log.
    model
        Fitted model, whose free parameters may be biased.
    """
    logs = [log.path for log in made.logs if any(f.code in LATE_CODES and f.level == FAULT for f in log.findings)]
    biased = [p.name for p in model.parameters if p.free and p.name.partition("_")[0] in DELAY_BIASED]
    if not logs or not biased:
        return []
    text = (
        f"{_first_names(logs)}: a signal is late, but the fit assumes that it is on time: {', '.join(biased)} are "
        "biased, by more than their standard errors. Correct its time stamps; for a late GNSS receiver, --effect "
        "gnss-latency estimates the latency."
    )
    return [ResultWarning(code="late-sensor-bias", text=text)]


def frame_warnings(model: Model, unplaced: Sequence[str], *, saved_origin_unknown: bool = False) -> list[ResultWarning]:
    """Return a warning if a fixed point of the model is shared by logs whose x and y may have different origins.

    Parameters
    ----------
    model : Model
        Model with its effects. Without an effect at a fixed point there is no warning.
    unplaced : sequence of str
        Logs without latitude and longitude, so that the origin of their x and y is unknown.
    saved_origin_unknown : bool
        Whether the model file lacks the origin of the x and y that the model was fitted to.
    """
    points = [e.name for e in model.effects if e.fixed_point]
    if not points or not (unplaced or saved_origin_unknown):
        return []
    why = (
        "the model file does not contain the origin of its x and y"
        if saved_origin_unknown
        else (
            f"{_first_names(list(unplaced))} {'gives' if len(unplaced) == 1 else 'give'} x and y "
            "without latitude and longitude"
        )
    )
    text = (
        f"The fixed point of {_first_names(points)} is the same for all logs, but {why}: all x and y are "
        "assumed to have one origin. If they do not, the point and its force are wrong."
    )
    return [ResultWarning(code="frame-assumed", text=text)]


def frames_assumed(fitted: FittedModel) -> list[ResultWarning]:
    """Return warnings that records of a fit may have different origins of x and y; none for a single record."""
    records = {
        r.name: r for r in (*fitted.records, *(v.record for v in fitted.validation if not fitted.cross_validated))
    }
    unplaced = [name for name, r in records.items() if "x" in r.outputs and r.meta.get(ORIGIN) is None]
    return frame_warnings(fitted.fit.model, unplaced if len(records) > 1 else ())


def not_converged(fit: Fit) -> str | None:
    """Return the sentence that replaces the answer of a fit that did not converge; None if it converged."""
    if fit.converged:
        return None
    return (
        f"The fit did not converge: it {fit.message}. Do not use its estimates or errors. First look for a stuck or "
        "missing signal; then give --initial or --prior, or use a model with fewer free parameters."
    )


def failed_run_warnings(failed: Sequence[FailedRun]) -> list[ResultWarning]:
    """Return one warning for each validation run that could not be evaluated."""
    text = "Left out of the validation: {0.record}, which cannot be evaluated: {0.reason}."
    return [ResultWarning(code="validation-run-failed", text=text.format(f)) for f in failed]


def cut_records(records: Sequence[Record]) -> list[ResultWarning]:
    """Return one warning for each record that was cut at its end because one of its signals ends early."""
    cuts = ((r, *r.meta["cut"]) for r in records if "cut" in r.meta)
    return [
        ResultWarning(
            code="record-cut",
            text=f"{r.name}: {name} ends {lost:.0f} s before the other signals; the data after its end are not used.",
        )
        for r, name, lost in cuts
    ]


def stuck_sensors(records: Sequence[Record]) -> list[ResultWarning]:
    """Return one warning for each channel of any record with at least ten samples that are all equal."""
    return [line for record in records for line in _stuck_channel_warnings(record)]


def _stuck_channel_warnings(record: Record) -> list[ResultWarning]:
    """Return one warning for each channel of a record with at least ten samples that are all equal (stuck sensor)."""
    lines = []
    for j, name in enumerate(record.outputs):
        y = record.y[:, j]
        y = y[np.isfinite(y)]
        if y.size >= FEWEST_SAMPLES and np.ptp(y) == 0.0:
            text = (
                f"{record.name}: {name} reads {y[0]:.6g} in all of its {y.size} samples: the sensor may be stuck. "
                "Check it, or leave this signal out."
            )
            lines.append(ResultWarning(code="stuck-sensor", text=text))
    return lines


def smallest_command(records: Sequence[Record]) -> float:
    """Return the smallest command that was held on a thruster bench, as a part of full command.

    It is the 5 % quantile of the absolute commands that are not zero, because a ramp may only pass through the
    smallest. 1.0 if all commands are zero.
    """
    size = np.abs(np.concatenate([r.u[:, r.inputs.index("n_cmd_0")] for r in records]))
    return float(np.quantile(size[size > 0.0], RAMP_SHARE)) if size.any() else 1.0


def plus_minus(value: float, error: float) -> str:
    """Format a value and its standard error to two digits of the error, for a sentence: ``40.783 ± 0.029``.

    At most nine decimals are printed, and one decimal if the error is not positive.
    """
    decimals = min(max(1 - math.floor(math.log10(error)), 0), 9) if error > 0.0 else 1
    return f"{round(value, decimals) + 0.0:.{decimals}f} ± {error:.{decimals}f}"  # + 0.0 turns -0 into 0


def thruster_answer(
    fitted: Fit,
    has_force: bool,
    directions: Sequence[float] = (1.0, -1.0),
    calibration: float | None = None,
    smallest: float = 0.0,
) -> str:
    """Return the answer of a thruster fit: thrust at full speed, delay, time constant and dead zone.

    Parameters
    ----------
    fitted : Fit
        Fit of the thruster model.
    has_force : bool
        Whether the bench has a load cell. Without it the answer has no thrust.
    directions : sequence of float
        Directions in which the shaft turned: 1 forward, -1 reverse. Other directions are called not measured.
    calibration : float, optional
        Relative standard uncertainty of the measured force; None if it was not given.
    smallest : float
        Smallest command that was tried, as a part of full command. The dead zone below it is unknown.
    """
    a, tau, d = (fitted.estimate(n) for n in ("a", "tau", "d"))
    shaft = (
        f"the shaft follows its command with a delay of {1e3 * tau[0]:.0f} ms and a time constant of "
        f"{1e3 / a[0]:.0f} ms "
    ) + (
        f"and does not turn below {100 * d[0]:.1f} % of full command"
        if d[0] >= NO_DEAD_ZONE
        else f"and has no dead zone above the smallest command tried, {format_number(100 * smallest)} %"
    )
    if not has_force:
        return shaft[0].upper() + shaft[1:] + "; its thrust is unknown without a load cell."
    included = "statistical only" if calibration is None else "with the load cell's calibration"
    ends, lost = [], []
    for direction, word in ((1.0, "forward"), (-1.0, "in reverse")):
        force, error = (float(z[0]) for z in steady_thrust(fitted, np.array([direction])))
        if direction in directions and math.isfinite(error):
            ends.append(f"{plus_minus(direction * force, math.hypot(error, (calibration or 0.0) * force))} N {word}")
        else:
            lost.append(f"{word}: not {'identifiable' if direction in directions else 'measured'}")
    if not ends:
        return f"The logs do not determine the thrust ({', '.join(lost)}); {shaft}."
    also = "".join(f"; {line}" for line in lost)
    return f"The thruster gives {' and '.join(ends)} at full speed ({included}{also}); {shaft}."


def thruster_warnings(directions: Sequence[float]) -> list[ResultWarning]:
    """Return a warning if the shaft turned in one direction only on the bench.

    ``directions``: 1 for forward, -1 for reverse; the thrust in the other direction is then unknown.
    """
    if len(directions) != 1:
        return []
    measured, unmeasured = ("forward", "in reverse") if directions[0] > 0 else ("in reverse", "forward")
    text = (
        f"The shaft turned {measured} only: c2 is fixed at 0, so the model has the same thrust {unmeasured} as "
        f"{measured}, which was not measured. Add a log with steps {unmeasured}."
    )
    return [ResultWarning(code="one-direction", text=text)]


def curve_warnings(levels: Levels) -> list[ResultWarning]:
    """Return a warning if the zero of the load cell is unknown because the command was never held at zero."""
    if levels.offset is not None:
        return []
    text = (
        "The command is never held at zero: the load cell's zero is unknown, and all forces contain its offset. Hold "
        "zero command before and after the steps."
    )
    return [ResultWarning(code="zero-unknown", text=text)]


def curve_notes(levels: Levels, measured: ThrustCurve, quadratic: Quadratic) -> list[str]:
    """Return the notes of a static thrust curve: zero, quadratic fit, standard errors, calibration, pooled levels.

    Parameters
    ----------
    levels
        Levels of held command with their mean forces [N].
    measured
        Thrust curve through the levels, and the uncertainty of the load cell's calibration.
    quadratic
        Quadratic fit c1 n|n| + c2 n^2 to the levels.
    """
    curve, calibration = measured.curve, measured.calibration
    errors = np.sqrt(np.diag(quadratic.covariance))
    c2 = (
        "c2 not determined by commands of one sign"
        if quadratic.c2 is None
        else f"c2 = {plus_minus(quadratic.c2, errors[1])} N"
    )
    test = f"F with {quadratic.df} and {levels.dof}" if levels.dof else f"chi-squared with {quadratic.df}"
    between = (
        f"and a scatter between visits to one level of {levels.scatter:.2g} N ({levels.dof} degrees of freedom)"
        if levels.dof
        else "but not the scatter between visits, since no level was visited twice"
    )
    zero = (
        f"The load cell's reading at rest, {plus_minus(levels.offset, levels.offset_se)} N, is subtracted from all "
        "levels."
        if levels.offset is not None
        else ""
    )
    notes = [
        *filter(None, [zero]),
        f"Quadratic: c1 = {plus_minus(quadratic.c1, errors[0])} N, {c2}; misfit against the levels' own errors: "
        f"p = {quadratic.p:.2g} ({test} degrees of freedom).",
        f"Standard errors of levels include the autocorrelation of the readings {between}. They do not include "
        "friction in the rig, the charge of the battery, or differences between days.",
        "The error of the load cell's calibration was not given (newton_per_count_sd, lever_ratio_sd of the rig, or "
        "`calibration` in model.toml): masses and forces by this curve have statistical errors only."
        if calibration is None
        else f"The errors of fits with this curve include the load cell's calibration, ± {100 * calibration:.2g} %.",
    ]
    moved = np.abs(curve.force - levels.force) > 1e-9
    if moved.any():
        pooled = zip(levels.n[moved], levels.force[moved], levels.error[moved], strict=True)
        shown = ", ".join(f"{plus_minus(f, s)} N at {n:g}" for n, f, s in pooled)
        notes.append(f"Levels that do not rise with the command were averaged with their neighbours: {shown}.")
    return notes


def homogeneity_sentence(a: HomogeneityTest) -> str:
    """Return the sentence on a homogeneity test: shared value, value of each log, verdict and scatter.

    If fewer than two logs inform the parameter, the sentence says only that.
    """
    each = ", ".join(f"{v:.3g} ± {e:.2g}" for v, e in zip(a.values, a.errors, strict=True))
    low, high = a.interval
    verdict = "agree" if a.agree else "do not agree"
    silent = f" {', '.join(a.left_out)} do{'es' if len(a.left_out) == 1 else ''} not inform it." if a.left_out else ""
    if a.df == 0:
        return f"{a.name}: the logs cannot be compared, as fewer than two inform it.{silent}"
    return (
        f"{a.name}: {a.value:.3g} ± {a.error:.2g} {a.unit} from all logs together (robust error {a.robust_error:.2g}); "
        f"one by one {each}: they {verdict} (likelihood ratio {a.lr:.1f}, chi-square with {a.df} "
        f"degree{'s' if a.df > 1 else ''} of freedom: p = {a.p:.2g}). "
        f"Scatter between logs {a.scatter:.2g}; with it {a.mean:.3g} ± {a.mean_error:.2g}, "
        f"95 % interval {low:.3g} to {high:.3g} {a.unit}.{silent}"
    )
