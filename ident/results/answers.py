"""Sentences of the results: answers, warnings and notes of fits, thruster tests and designs.

Reports and the terminal print these sentences. Warnings are about what must be known before an estimate is used: a
prior that the data contradict, a stuck sensor, an unknown scale of forces.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from datetime import datetime, timedelta
from itertools import pairwise
from statistics import geometric_mean
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from seatrial.daq.checks import FAULT
from seatrial.daq.errors import first_names
from seatrial.ident.characterisation import MOVING, Levels, Quadratic, ThrustCurve, TurningShaft, steady_thrust
from seatrial.ident.checks import FILTER_NOISE, filter_noise_options
from seatrial.ident.data import BLOCK_TIMES, ORIGIN, Record
from seatrial.ident.diagnosis import ModelUncertainty
from seatrial.ident.effects import catalogue
from seatrial.ident.estimation import (
    PLAUSIBLE_MASS_RATIO,
    FailedRun,
    Fit,
    FittedModel,
    HomogeneityTest,
    PriorDistance,
    Role,
    ThrustScale,
    agrees_with_bench,
    exceeded_prior,
    least_yaw_inertia,
    prior_distances,
    thrust_scale_of,
    unexcited_motion,
)
from seatrial.ident.model import Effect, Model, ModelKind, Parameter, ParameterOrigin, drive_word
from seatrial.ident.models import ESTIMATOR_ERROR
from seatrial.ident.numerics import NOT_SHOWN, UNSTABLE, is_undetermined
from seatrial.ident.results.candidate_titles import candidate_title
from seatrial.ident.results.parts import (
    Calibrations,
    CourseStability,
    CrossCorrelationRow,
    DiagnosisResult,
    Dynamics,
    Errors,
    FitResult,
    HeadingPoint,
    PredictionChangeRow,
    PredictionFit,
    Provenance,
    ResidualTests,
    ResultWarning,
)
from seatrial.ident.results.tables import SCORES_PASS, format_number, in_degrees, parameter_label, sides_compare_mass
from seatrial.ident.validation import FEWEST, OUTLIER_SDS, WARM_UP, ChannelResiduals, PredictionEvaluation

NAMES = {
    "x": "position north",
    "y": "position east",
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
LATE_CODES = frozenset({"sensor-late", "thrust-late", "motion-late", "clock-step"})  # findings of `seatrial check`
DELAY_BIASED = frozenset({"m", "d", "T", "K"})  # masses, damping, time constants, gains: their names before a "_"
MOST_NAMES = 4  # channels or logs that a sentence lists by name; the others are counted
FINE_SHIFT_PERCENT = 2.0  # smaller changes are printed with one decimal
FACTOR_FROM = 3.0  # larger ratios of errors are printed as a factor, not in per cent
LEVEL = 0.01  # significance level of the whiteness tests
DRIFTING = 0.2  # autocorrelation of the residuals of a position, from which a drift of its error is reported
MEASURED_INPUTS = {"phi", "theta", "psi", "p", "q", "r"}  # inputs that are sensor outputs and contain sensor noise
LEAST_USEFUL_SCALE = 0.1  # ratio of actual to predicted errors, below which an interval does not tell the error
MUCH_WORSE_SIMULATION = 2.5  # ratio of the errors of a simulation to those over the horizon, from which it is stated
WIDE_INTERVAL = 0.5  # a wider 95 % interval of the fit is replaced by the interval of time that causes it
JUST_INCLUDED = 0.05  # upper end of the interval of a ratio above 1, up to which it only just includes no change
NO_DEAD_ZONE = 5e-4  # of full command: a smaller dead zone would be printed as 0.0 %
RAMP_SHARE = 0.05  # share of the rows, smallest commands first, that may belong to a ramp
FAR_FROM_MAXIMUM = 0.5  # standard errors by which a fit can still move; less does not matter beside the errors
# Error of a given antenna position that is reported: m, and standard errors. A tape measure errs by less.
LARGEST_AWAY, FAR_AWAY = 0.25, 4.0
ALIKE = 0.9  # size of the correlation of two estimates, above which the data hardly tell one from the other
# Standard errors above zero, below which an unstable pole is not sure: a pole of zero exceeds them in 0.1 % of the fits
SURE_POLE = 3.0
Z95 = 1.959964  # half the width of a 95 % interval, in standard errors
TURNS_FOR_STABILITY = (
    "short turns to both sides at this speed, and equal inputs of both sides for some seconds after each"
)
UNUSUAL = 3.0  # standard deviations of its prior, from which an estimate is far from its usual size
LARGEST_ASYMMETRY = 0.5  # of c2 over c1: one direction then has a third of the other's thrust
UNEQUAL_THRUST = 0.05  # difference of the thrust ahead from the given mean, relative to it, from which it is reported
USUAL_ADDED = 1.3  # usual largest mass in surge of a slender hull, as a multiple of the weighed mass
LEAST_ADDED = 0.9  # smallest multiple for a thrust in a wrong unit, which may be a little too small besides
UNITS_OF_THRUST = {"kgf": 9.81, "lbf": 4.448, "gf": 0.00981}  # N, of data sheets and scales
MOST_ADDED = 2.0  # largest plausible mass in surge, as a multiple of the weighed mass, whatever its standard error is
FULL_SPEED = 0.95  # of full speed; a thrust that was measured up to this speed is not called extrapolated
SHORT_BENCH_S = 20.0  # as SHORT_DATA_S, of a thruster: some held commands of 4 s, forward and in reverse
NOMOTO = "nomoto"  # name of Nomoto's model
UNFIT = 0.2  # correlation of residuals with an input, from which on the structure of Nomoto's model is called unfit
NOMOTO_LAG = "T"  # time constant of the yaw rate in Nomoto's model, fixed at zero without a prior
NOT_WEIGHED = (
    "The mass in surge, m_u, was not compared with a weighed mass, because none was given: give --mass, or mass in "
    "[geometry] of the import map. With it, a wrong thrust is found."
)
PASSED_TESTS = (
    "The residuals one step ahead are white and uncorrelated with the inputs, by Ljung-Box, periodogram and "
    "cross-correlation tests"
)
SHORT_FOR_SIMULATION = 4.0  # warm-ups: of a shorter record, the errors of a simulation leave out a large part
SIMULATION_COVERS = f"The errors of the simulation leave out the {WARM_UP:g} s of filtering before it: they cover"
OTHER_SURROUNDINGS = "Effects of the surroundings of another day"  # begins the note of a comparison
FIT_OF_ALL = "1 - geometric mean of error / standard deviation"  # of the channels: `PredictionFit`
MOST_OF_ERROR = "A small part of the time has most of the squared error"  # begins the note of a comparison
# Begins the note of a comparison on effects of some models
SIZE_NOT_SIGNIFICANT = "Effects whose size is not significant in their own fit"
RUNS_AWAY = "The simulation of a directionally unstable model can run away from the measured motion"  # begins a note
LIFT = "Y_uv"  # parameter of the hull lift: damping of sway per forward speed
LEAST_PULL = 0.03  # difference of the inputs of both sides on a straight course, relative to their mean, to report
SAME_WEATHER = timedelta(hours=3)  # between the starts of logs, up to which one value of the wind is plausible
NO_DATE = 1970  # year of the times of a log that has no date
SHORT_DATA_S = 60.0  # of all estimation data; shorter data hardly contain a turn and a stop
FEWEST_SAMPLES = 10  # equal samples from which a sensor is called stuck


def standard_error_sentence(*texts: str | None) -> str:
    """Return the sentence that explains ± as one standard error, if one of the texts has it; otherwise it is empty."""
    return "± is one standard error." if any(text and "±" in text for text in texts) else ""


def change_sentence(change: PredictionChangeRow, horizon: float, cross_validated: bool = False) -> str:
    """Return the sentence of a result on how added effects changed the prediction errors over the horizon.

    The sentence claims a fall or a rise only if ``change.verdict`` does. The change is in per cent; a rise to three
    times the error or more is a factor instead. Up to four better channels and all worse channels are named. If the
    interval only just includes no change, a further sentence says what decides. Without a 95 % interval the sentence
    only states that the data are too short.

    Parameters
    ----------
    change
        Change of the errors over the horizon, with its 95 % interval, its verdict, and the channels that changed.
    horizon
        Prediction horizon [s].
    cross_validated
        Whether the validation data are blocks of the estimation runs.
    """
    blocks = cross_validated and change.role == "validation"
    data = "blocks of the logs that were left out of the fit" if blocks else f"{change.role} data"
    begin = f"Prediction {horizon:g} s ahead on {data}, all channels: "
    if change.low is None or change.high is None:
        return (
            f"{begin}the data are too short to tell whether the added effects change the error; give longer "
            f"{change.role} logs."
        )
    shift, low, high = (100 * (r - 1) for r in (change.ratio, change.low, change.high))
    places = 0 if abs(shift) >= FINE_SHIFT_PERCENT else 1
    rounded = [round(r, places) + 0.0 for r in (shift, low, high)]  # + 0.0 turns -0 into 0
    by, least, most = (f"{abs(r):.{places}f}" for r in rounded)
    if change.verdict == "unchanged":
        by, least, most = (f"{r:+.{places}f}" for r in rounded)
        effect = (
            f"no significant change of the error with the added effects ({by} %; 95 % interval: {least} to {most} %)"
        )
    elif change.verdict == "fell":
        effect = f"with the added effects the error falls by {by} % (95 % interval: {most} to {least} %)"
    elif change.ratio < FACTOR_FROM:
        effect = f"with the added effects the error rises by {by} % (95 % interval: {least} to {most} %)"
    else:
        effect = f"with the added effects the error is {format_number(change.ratio)} times as large "
        effect += f"(95 % interval: {format_number(change.low)} to {format_number(change.high)})"
    named = [("better", change.better, MOST_NAMES), ("worse", change.worse, len(change.worse))]
    parts = [effect, *(f"{word}: {_first_names(names, most)}" for word, names, most in named if names)]
    return f"{begin}{'; '.join(parts)}.{_nearly_fell(change, horizon)}"


def _nearly_fell(change: PredictionChangeRow, horizon: float) -> str:
    """Return the sentence that an error probably fell, with what decides; empty unless its interval just includes 1.

    The upper end is then at most 5 % above 1, and at most a quarter as far from it as the estimate. The text begins
    with a space.
    """
    if change.verdict != "unchanged" or change.high is None or change.high < 1.0:
        return ""
    if change.high - 1.0 > min(JUST_INCLUDED, 0.25 * (1.0 - change.ratio)):
        return ""
    return (
        f" The error is probably smaller with the effects: a shorter horizon (--horizon {0.5 * horizon:g}) or more "
        "logs can decide."
    )


def _first_names(channels: Sequence[str], most: int = MOST_NAMES) -> str:
    """Return names of channels or logs for a sentence, separated by commas: ``heading, north and 2 more``.

    Names in ``NAMES`` are written out (``psi`` as heading). Of more than ``most`` names, the first ``most`` are
    returned with the number of the others.
    """
    return first_names([NAMES.get(name, name) for name in channels], most)


def _percent(share: float) -> str:
    """Return a share (1: all) as text in whole per cent: 0.34 -> ``34 %``. It may be negative: ``-5 %``."""
    return f"{100 * share:z.0f} %"


def vehicle_answer(
    prediction: PredictionFit | None,
    errors: Errors,
    horizon: float,
    residuals: Sequence[ResidualTests],
    cross: Sequence[CrossCorrelationRow],
    *,
    searchable: bool,
) -> str:
    """Return the answer of a vehicle fit: its fit in per cent over the horizon, and the whiteness of its residuals.

    Parameters
    ----------
    prediction : PredictionFit or None
        Fit of all channels over the horizon. If it is None, the answer has only the sentence on the residuals.
    errors : Errors
        RMS prediction errors by channel.
    horizon : float
        Prediction horizon [s].
    residuals : sequence of ResidualTests
        Whiteness tests of each record and channel. If there are none, the answer states that the samples are too few.
    cross : sequence of CrossCorrelationRow
        Correlations of the residuals with each input.
    searchable : bool
        Whether `seatrial ident diagnose` can search this model for missing effects. If it can, the answer advises it,
        unless there are too few samples or only measured inputs are correlated.
    """
    of_prediction = ""
    if prediction is not None:
        of_prediction = f"{_fit_sentence(prediction, errors, horizon)} {_simulation_sentence(errors, horizon)}".strip()
    return "\n".join(filter(None, [of_prediction, _whiteness_sentence(errors, residuals, cross, searchable)]))


def _fit_sentence(prediction: PredictionFit, errors: Errors, horizon: float) -> str:
    """Return sentences on the fit (per cent) over the horizon [s]: of all channels, and of the best and the worst one.

    The fits of the channels are those on the validation data, or on the estimation data if there are no others. The
    definition of the fit of all channels, and the best and worst channel, are left out if fewer than two channels have
    a fit. If the prediction of some channels diverges, the sentence names only them. A 95 % interval wider than 50 per
    cent points is left out, and a further sentence gives the interval of time with the largest errors, if that is
    known.
    """
    begin = f"Prediction {horizon:g} s ahead on {prediction.role} data, all channels: "
    table = errors.estimation if errors.validation is None else errors.validation
    lost = [n for n, row in table.horizon.items() if row.after is None]
    if lost:
        return (
            f"{begin}it diverges ({_first_names(lost)}). Check the signals with `seatrial check`, and the estimates; "
            "do not use this model for predictions."
        )
    each = {n: 1 - (row.after or 0.0) / row.spread for n, row in table.horizon.items() if row.spread}
    low, high, largest = prediction.low, prediction.high, prediction.largest_errors
    interval = "" if low is None or high is None else f" (95 % interval: {100 * low:z.0f} to {100 * high:z.0f} %)"
    cause = ""
    if low is not None and high is not None and high - low > WIDE_INTERVAL and largest is not None:
        interval = " (without a useful 95 % interval)"
        cause = (
            f" {_percent(largest.share)} of the squared errors are from {largest.begin:.0f} to {largest.end:.0f} s of "
            f"{largest.record}; look there for outliers, gaps, or a motion that the other logs lack (a higher speed)."
        )
    ends = [f"{_percent(each[n])} ({NAMES.get(n, n)})" for n in sorted(each, key=lambda n: -each[n])]
    span = ""
    if len(ends) > 1:
        span = f" It is {FIT_OF_ALL} of {len(ends)} channels. Best channel: {ends[0]}; worst: {ends[-1]}."
    return f"{begin}fit {_percent(prediction.fit)}{interval}.{cause}{span}"


def _simulation_sentence(errors: Errors, horizon: float) -> str:
    """Return the sentence that the simulation by the inputs alone is much worse than the prediction over the horizon.

    It is much worse if the geometric mean over the channels of the ratio of the errors is at least
    `MUCH_WORSE_SIMULATION`, or if a channel diverges. The channel with the largest ratio is named with both errors. The
    text ends with a space. It is empty if the simulation is not much worse, or if the prediction diverges already.
    """
    table = errors.estimation if errors.validation is None else errors.validation
    if any(row.after is None for row in table.horizon.values()):
        return ""
    begin = "The simulation of the whole runs by the inputs alone"
    if lost := [n for n, row in table.simulation.items() if row.after is None]:
        return f"{begin} diverges ({_first_names(lost)}): do not use this model without measurements. "
    pairs = {
        n: (row.after or 0.0, table.simulation[n].after or 0.0)
        for n, row in table.horizon.items()
        if n in table.simulation
    }
    ratios = {n: simulated / predicted for n, (predicted, simulated) in pairs.items() if predicted and simulated}
    mean = geometric_mean(ratios.values()) if ratios else 1.0
    if mean < MUCH_WORSE_SIMULATION:
        return ""
    worst = max(ratios, key=lambda n: ratios[n])
    factor, unit = in_degrees(table.horizon[worst].unit)
    predicted, simulated = (factor * error for error in pairs[worst])
    unit = f" {unit}".rstrip()
    return (
        f"{begin} is much worse: its errors are {mean:.2g} times those {horizon:g} s ahead (geometric mean of all "
        f"channels), most in {NAMES.get(worst, worst)}, {format_number(simulated)}{unit} in place of "
        f"{format_number(predicted)}{unit} (rms). "
    )


def poor_channel(errors: Errors) -> tuple[str, float] | None:
    """Return the name in reports and the fit of the channel with the smallest fit over the horizon, if it is negative.

    With a negative fit, the prediction is worse than the mean value of the channel. The fits are those on the
    validation data, or on the estimation data if there are no others. None if no fit is negative.
    """
    table = errors.estimation if errors.validation is None else errors.validation
    fits = {n: 1 - row.after / row.spread for n, row in table.horizon.items() if row.spread and row.after is not None}
    worst = min(fits, key=lambda n: fits[n], default=None)
    return (NAMES.get(worst, worst), fits[worst]) if worst is not None and fits[worst] < 0.0 else None


def _whiteness_sentence(
    errors: Errors, residuals: Sequence[ResidualTests], cross: Sequence[CrossCorrelationRow], searchable: bool
) -> str:
    """Return the sentence on the residuals: whether they are white, and whether they are uncorrelated with the inputs.

    Only the residuals of the estimation data count. Each of both is tested at 1 % over all channels: the significance
    level is divided by the number of tests (Bonferroni). If only measured inputs such as the heading are correlated,
    the sentence names sensor noise as a possible cause. Without ``residuals`` it states that there are too few samples.
    In these two cases ``searchable`` has no effect. Otherwise it adds the advice to run `seatrial ident diagnose`: for
    hidden effects if both tests pass, for missing effects if one fails. Channels with too few samples for the tests are
    named only if both tests pass.
    """
    residuals = [r for r in residuals if r.role == "estimation"]
    coloured, significant = _failed_tests(residuals, cross)
    correlated_inputs = {c.input for c in significant}
    if not residuals:
        return (
            "There are too few samples to test whether the residuals are white; record at least "
            f"{FEWEST} samples of a channel."
        )
    if not correlated_inputs and not coloured:
        hidden = ". Disturbance forces can still hide an effect: `seatrial ident diagnose` tests for it"
        untested = _untested_channels(errors, residuals)
        return f"{PASSED_TESTS}{untested}{hidden if searchable else ''}."
    if correlated_inputs and correlated_inputs <= MEASURED_INPUTS:
        named = " and ".join(sorted(correlated_inputs))
        return (
            f"The residuals are correlated with {named}, which the model uses as measured inputs: the cause can be "
            f"the noise of these sensors rather than a missing effect{'. They are not white' if coloured else ''}. If "
            "the prediction error is too large, use a model that predicts these signals."
        )
    end = f"The residuals are correlated with the inputs{_largest_correlation(significant)}"
    if not correlated_inputs:
        end = "The residuals are not white"
    either = (
        ": an effect is missing, or the noise of a sensor is autocorrelated. Look at the residuals in the report, or "
        "try another --model"
    )
    how = ": run `seatrial ident diagnose` to see whether an effect is missing" if searchable else either
    return f"{end}{how}."


def coloured_sentence(
    errors: Errors, residuals: Sequence[ResidualTests], cross: Sequence[CrossCorrelationRow], searchable: bool
) -> str:
    """Return the sentence on residuals that are not white or are correlated with the inputs; "" if they pass the tests.

    The arguments and the tests are those of the answer of a vehicle fit.
    """
    coloured, significant = _failed_tests(residuals, cross)
    return _whiteness_sentence(errors, residuals, cross, searchable) if coloured or significant else ""


def _failed_tests(
    residuals: Sequence[ResidualTests], cross: Sequence[CrossCorrelationRow]
) -> tuple[bool, list[CrossCorrelationRow]]:
    """Return whether residuals of the estimation data are not white, and the rows of their significant correlations.

    Both are tested as in `_whiteness_sentence`. Of a diagnosis the tests are those of the model with the effects.
    """
    tests = [
        p
        for r in residuals
        if r.role == "estimation"
        for t in (r.after or r,)
        for p in (t.ljung_box_p, t.periodogram_p)
    ]
    pairs = [(c, p) for c in cross if c.role == "estimation" and (p := (c.after or c).p) is not None]
    coloured = any(p is not None and p * len(tests) < LEVEL for p in tests)
    return coloured, [c for c, p in pairs if p * len(pairs) < LEVEL]


def position_drift_notes(residuals: Sequence[ResidualTests], coloured: bool) -> list[str]:
    """Return the note that the error of the measured position is autocorrelated, and not the motion; often none.

    A missing effect of the boat acts on the velocity. The note is returned if the residuals of a position on the
    estimation data are not white, with an autocorrelation of at least `DRIFTING`, and if those of each measured
    velocity over ground have at most half of that autocorrelation. Without such a velocity there is no note, because
    the position alone cannot tell both causes.

    Parameters
    ----------
    residuals : sequence of ResidualTests
        Whiteness tests of each record and channel. In a diagnosis those of the model with the effects count.
    coloured : bool
        Whether the standard errors are the robust ones, because of autocorrelated residuals (`FitSummary.coloured`).
    """
    largest: dict[str, float] = {}
    for row in residuals:
        tests = row.after or row
        if row.role == "estimation" and len(tests.acf):
            size = 0.0 if tests.white else float(np.max(np.abs(tests.acf)))
            largest[row.channel] = max(size, largest.get(row.channel, 0.0))
    position, velocity = ([largest[n] for n in names if n in largest] for names in (("x", "y"), ("vx", "vy")))
    if not position or not velocity or max(position) < DRIFTING or max(velocity) > 0.5 * max(position):
        return []
    errors = (
        "the standard errors are the robust ones where these are larger, which allow for it"
        if coloured
        else "the test of the standard errors does not find that it makes them wrong"
    )
    less = f"less (up to {max(velocity):.2g})" if max(velocity) else "not"
    return [
        f"The errors of the position one step ahead are autocorrelated (up to {max(position):.2g}), those of the "
        f"velocity {less}. This is probably the error of the position itself, which in GNSS receivers drifts for "
        "seconds to minutes, and not a missing effect of the boat, which the velocity would show too. The model takes "
        f"the position noise as white; {errors}."
    ]


def disturbance_reason(result: FitResult) -> str:
    """Return why the prediction interval of a speed or of a turn rate is wide, and what to do.

    The causes are disturbance forces and a missing effect. The missing effect comes first if the result has evidence
    of one: candidates that pass the score tests, or else residuals that are not white or are correlated with inputs.
    A correlation with measured inputs alone is no evidence, because the noise of their sensors can be its cause.

    Parameters
    ----------
    result : FitResult
        Fit or diagnosis with its notes and its tests of the residuals.

    Returns
    -------
    str
        A clause and a sentence with the advice, without the last full stop.
    """
    forces = "disturbance forces of that time cannot be known in advance"
    if not isinstance(result, DiagnosisResult):
        advice = "Run `seatrial ident diagnose` to search for missing effects"
    elif result.recommended_experiment:
        advice = "Record the experiment that the diagnosis recommends, and diagnose again with its log"
    else:
        advice = "Record longer and more varied runs, and diagnose again with their logs"
    if evidence := _evidence_of_missing_effect(result):
        return (
            f"an effect is probably missing from the model ({evidence}), and acts like disturbance forces. Real "
            f"{forces} either. {advice}"
        )
    return f"the {forces}, or an effect is missing from the model and acts like such forces. {advice}"


def _evidence_of_missing_effect(result: FitResult) -> str:
    """Return the evidence that an effect is missing from a model (`disturbance_reason`); empty without any."""
    remaining = isinstance(result, DiagnosisResult) and result.remaining_candidates
    if remaining or any(note.startswith(SCORES_PASS) for note in result.notes):
        return "candidates pass the score tests"
    coloured, significant = _failed_tests(result.residuals, result.cross)
    if not {c.input for c in significant} <= MEASURED_INPUTS:
        return "the residuals are correlated with the inputs"
    return "the residuals are not white" if coloured and not significant else ""


def _largest_correlation(significant: Sequence[CrossCorrelationRow]) -> str:
    """Return the largest correlation of residuals with an input and its channel, in brackets, as the end of a sentence.

    ``significant`` has the correlations that are significant. The text is empty without correlations. The size matters,
    because in a long record even negligible correlations are significant.
    """
    most = max((c for c in significant if c.largest is not None), key=lambda c: c.largest or 0.0, default=None)
    return "" if most is None else f" (correlation up to {most.largest:.2g}, {NAMES.get(most.channel, most.channel)})"


def _untested_channels(errors: Errors, residuals: Sequence[ResidualTests]) -> str:
    """Return the channels of the estimation data without residual tests, in brackets, as the end of a sentence.

    They have too few samples, or constant innovations, in every record. The channels are those that have one-step
    errors. The text is empty if all of them were tested.
    """
    tested = {r.channel for r in residuals}
    left = [n for n in errors.estimation.one_step if n not in tested]
    return f" (too few samples to test: {', '.join(left)})" if left else ""


def calibration_notes(calibration: Calibrations, horizon: float) -> list[str]:
    """Return sentences on prediction intervals that are too narrow or too wide, with the channels concerned.

    There is at most one text on narrow and one on wide intervals for each kind of prediction: one step ahead, over the
    horizon, simulated. The factor of each channel is its RMS error over the predicted one, or the word diverged. The
    text advises to multiply the predicted standard deviations by the factors, except for those over the horizon and in
    simulation on validation data: narrow intervals are widened already, and wide ones are never narrowed. If a channel
    diverged, the text also advises against such predictions. The texts are about the validation data, or about the
    estimation data if there are no validation data. The list is empty if no channel is overconfident or underconfident.

    Parameters
    ----------
    calibration
        Calibration of each channel by set of data (estimation, validation) and kind of prediction.
    horizon
        Prediction horizon [s].
    """
    role, table = ("validation", calibration.validation)
    if table is None:
        role, table = "estimation", calibration.estimation
    kinds = (
        ("errors one step ahead", table.one_step),
        (f"errors {horizon:g} s ahead", table.horizon),
        ("errors of the simulation", table.simulation),
    )
    notes = []
    for verdict, size in (("overconfident", "larger"), ("underconfident", "smaller")):
        for words, channels in kinds:
            wrong = [
                f"{NAMES.get(n, n)} {'diverged' if c.scale is None else format(c.scale, '.2g')}"
                for n, c in channels.items()
                if c.verdict == verdict
            ]
            if wrong:
                diverged = any(c.scale is None for c in channels.values() if c.verdict == verdict)
                advice = "Multiply the predicted standard deviations of these channels by them."
                if role == "validation" and channels is not table.one_step and verdict == "overconfident":
                    call = "predict" if channels is table.horizon else "simulate"
                    advice = f"The intervals of this result and of `{call}` in Python are already widened for this."
                elif role == "validation" and channels is not table.one_step:
                    call = "predict" if channels is table.horizon else "simulate"
                    advice = (
                        f"The intervals of this result and of `{call}` in Python are too wide by these factors: they "
                        "are never narrowed."
                    )
                factors = [c.scale for c in channels.values() if c.verdict == verdict and c.scale is not None]
                if min(factors, default=1.0) < LEAST_USEFUL_SCALE:
                    advice += (
                        " An interval more than ten times too wide does not tell the error: use the table of errors "
                        "for these channels."
                    )
                notes.append(
                    f"On {role} data, the {words} are {size} than the model predicts, by these factors: "
                    f"{', '.join(wrong)}. {advice}"
                    f"{' Do not use such predictions of a channel that diverged.' * diverged}"
                )
    return notes


def estimation_warnings(
    fit: Fit, records: Sequence[Record], hull: Mapping[str, float] = MappingProxyType({})
) -> list[ResultWarning]:
    """Return the warnings of a fit, those about an unknown scale of forces first.

    Further warnings are about declared noise or priors that the data contradict, a search that stopped close to the
    maximum, masses that the data do not determine, a yaw inertia that is too small for the mass, a mass in surge that
    contradicts the weighed one, records that were cut, and stuck sensors. The list is empty if none of these applies.

    Parameters
    ----------
    fit : Fit
        Fit of a vehicle or thruster model.
    records : sequence of Record
        Records that the parameters were fitted to.
    hull : mapping
        What is known of the boat. Without its ``length`` [m], the least plausible yaw inertia follows from the
        thrusters' arms alone. Without its weighed ``mass`` [kg], the mass in surge is not checked. With ``ahead`` [N],
        the thrust of one thruster ahead, c1 is not taken for a thrust that may be that ahead.
    """
    warnings = [
        *scale_warnings(thrust_scale_of(fit.model)),
        *thrust_ahead_warnings(fit, hull.get("ahead")),
        *thrust_astern_warnings(fit),
        *antenna_warnings(fit),
        *unusual_estimates(fit),
    ]
    for away in (d for d in prior_distances(fit) if d.contradicts):
        p, value = away.parameter, away.estimate
        label = parameter_label(p, fit)
        mean, sd = p.prior or (math.nan, math.nan)
        if p.name in fit.model.noises:
            text = (
                f"The residuals contradict the given {p.meaning}: {p.name} = {mean:.3g} {p.unit} was given, the "
                f"estimate is {value:.3g} {p.unit}. The fit uses the estimate, and the given value as its prior only; "
                "check the given value."
            )
            warnings.append(ResultWarning(code="noise-contradicted", text=text))
            continue
        text = (
            f"The data contradict the prior of {label}: {mean:.4g} ± {sd:.2g} {p.unit} was given, the estimate "
            f"is {value:.4g} {p.unit}. {_data_alone(away)}, {abs(away.distance):.1f} standard deviations of both away. "
            f"{_acting_alike(fit, p)}Check the prior and the other given values (thrust, arms, units)."
        )
        warnings.append(ResultWarning(code="prior-contradicted", text=text))
    if fit.converged and (left := fit.distance_left) is not None and left > FAR_FROM_MAXIMUM:
        text = (
            f"The fit stopped close to its maximum: its estimates can still move by {left:.2g} standard errors. If "
            "this matters to you, use a model with fewer free parameters, or more data."
        )
        warnings.append(ResultWarning(code="nearly-converged", text=text))
    if (lost := unexcited_motion(fit, records)) is not None:
        text = (
            f"T{lost.clause[1:]}. The standard error is more than half of "
            "the estimate. Record a mission with turns, stops and "
            "changes of speed (seatrial mission generate --kind mixed)."
        )
        if ESTIMATOR_ERROR in {effect.name for effect in fit.model.effects}:
            noises = {o.name: o.noise for o in fit.model.outputs if o.noise and o.name in FILTER_NOISE}
            text += (
                " Or the errors of the navigation filter, which are states of this fit, explain the motion in place of "
                "the boat: give the accuracy of the filter's output as white noise, by its data sheet or by "
                f"experience, for example {filter_noise_options([*noises], noises)}."
            )
        warnings.append(ResultWarning(code="motion-not-excited", text=text))
    least = least_yaw_inertia(fit, hull.get("length"))
    if least is not None and fit.estimate("m_r")[0] < least:
        text = (
            f"The estimated moment of inertia in yaw, m_r, is {fit.estimate('m_r')[0]:.3g} kg m2, but a rigid body "
            f"with the mass of this boat has at least {least:.2g} kg m2. Check the thrust, the arms of the thrusters "
            "and the unit of the yaw rate."
        )
        warnings.append(ResultWarning(code="inertia-too-small", text=text))
    return warnings + mass_warnings(fit, hull.get("mass")) + cut_records(records) + stuck_sensors(records)


def _acting_alike(fit: Fit, p: Parameter) -> str:
    """Return a sentence on added effects whose parameters act like a change of a parameter, with a space at its end.

    They do if the size of their correlation is above 0.9. The text is empty without such an effect, and for a parameter
    ``p`` that the fit has not estimated.
    """
    if p.name not in fit.names:
        return ""
    row = dict(zip(fit.names, np.abs(fit.correlation[fit.names.index(p.name)]), strict=True))
    of_effects = [q.name for e in fit.model.effects for q in e.parameters if q.name != p.name]
    alike = [name for name in of_effects if row.get(name, 0.0) > ALIKE]
    if not alike:
        return ""
    given = (p.prior or (p.value,))[0]
    return (
        f"The data hardly tell a change of {p.name} from one of {' and '.join(alike)}, of an added effect: to hold the "
        f"given value, fit and diagnose again with --fix {p.name}={given:.4g}. "
    )


def mass_warnings(fit: Fit, weighed: float | None) -> list[ResultWarning]:
    """Return a warning if the estimated mass in surge contradicts the weighed mass of the boat [kg].

    The mass in surge is the weighed mass and the added mass of the water. A mass below the weighed one or above 1.3
    times it, both by more than two standard errors, or above twice the weighed one is implausible. The list is empty
    without a weighed mass, if the model has no mass in surge, and if the thrust was not given, so that masses are known
    as ratios only.
    """
    if weighed is None or not _has_mass_to_weigh(fit):
        return []
    return implausible_mass(*fit.estimate("m_u"), weighed)


def implausible_mass(mass: float, error: float, weighed: float) -> list[ResultWarning]:
    """Return a warning if a mass in surge contradicts the weighed mass, as `mass_warnings`; else an empty list.

    Parameters
    ----------
    mass, error
        Estimate [kg], and its standard error [kg]; NaN: unknown.
    weighed
        Weighed mass of the boat [kg].
    """
    least = mass - 2.0 * error if np.isfinite(error) else -np.inf
    found = f"The estimated mass in surge, m_u, is {plus_minus(mass, error)} kg, and the boat weighs {weighed:g} kg"
    cause = (
        "Check the weighed mass (kilograms of the whole boat as it ran), and the given thrust, to which all masses are "
        "in proportion (its unit, the thrust at full speed, and the scale of the shaft speeds"
        f"{_as_if_in_unit(mass / weighed)})"
    )
    if mass + 2.0 * np.nan_to_num(error) < weighed:
        text = f"{found}: m_u contains the added mass of the water too and cannot be smaller. {cause}."
    elif mass > MOST_ADDED * weighed or least > USUAL_ADDED * weighed:
        text = (
            f"{found}: the added mass of the water would be {mass / weighed - 1.0:.2f} times that mass, but in surge "
            f"it is usually 0.05 to 0.3 times, and more of a blunt hull only. {cause}, then water in the hull, loads "
            "that were not weighed, and whether the thrusters have lost thrust since it was measured (a fouled "
            "propeller, a sagging supply)."
        )
    else:
        return []
    return [ResultWarning(code="mass-implausible", text=text)]


def _as_if_in_unit(ratio: float) -> str:
    """Return the end of a sentence if the thrust may be in another unit than newtons; empty if none explains the mass.

    ``ratio`` is the estimated mass in surge over the weighed one. With the right unit it is plausible.
    """
    for unit, newtons in UNITS_OF_THRUST.items():
        if LEAST_ADDED <= ratio * newtons <= PLAUSIBLE_MASS_RATIO:
            return f"; the mass is as if the thrust were given in {unit}, 1 {unit} = {newtons:g} N"
    return ""


def prior_notes(fit: Fit) -> list[str]:
    """Return a note for each given prior that the data contradict only if no effect is missing from the model.

    Priors that the data contradict in any case have a warning (`estimation_warnings`). Priors of the noise have none.
    Another note names the parameters that keep their value of a bench test, but with a larger standard error.
    """
    notes = []
    for away in prior_distances(fit):
        p = away.parameter
        if away.contradicts or not away.contradicts_if_model_is_right or p.name in fit.model.noises:
            continue
        mean, sd = p.prior or (math.nan, math.nan)
        label = parameter_label(p, fit)
        notes.append(
            f"The estimate of {label} is {away.estimate:.4g} {p.unit}, where {mean:.4g} ± {sd:.2g} {p.unit} was "
            f"given. {_data_alone(away)}: {abs(away.plain_distance):.1f} standard deviations of both away if no effect "
            f"is missing from the model, and {abs(away.distance):.1f} if the effects that may be missing count. Check "
            "the given value. If it is right, an effect is missing that acts like a change of it."
        )
    estimated = ((p, *fit.estimate(p.name)) for p in fit.model.parameters if p.free and not p.per_record)
    wider = [p.name for p, x, se in estimated if agrees_with_bench(p, x) and exceeded_prior(p, x, se) is not None]
    if wider:
        errors, have = ("error", "is") if len(wider) == 1 else ("errors", "are")
        notes.append(
            f"The standard {errors} of {' and '.join(wider)} {have} larger than on the bench: what the model does not "
            "explain is included."
        )
    return notes


def _data_alone(away: PriorDistance) -> str:
    """Return the beginning of a sentence on the value of a parameter that the data alone give.

    The estimate lies between this value and the prior. Its direction only is stated if the value is not known.
    """
    p, value = away.parameter, away.data_value
    if value is not None:
        return f"The data alone give about {value:.3g} {p.unit}".rstrip()
    direction = "larger" if away.distance > 0.0 else "smaller"
    return (
        f"The prior has {100.0 * away.weight:.0f} % of the information and holds the estimate near the given value. "
        f"The data alone give a {direction} value"
    )


def _has_mass_to_weigh(fit: Fit) -> bool:
    """Return whether the fit has a mass in surge in kilograms, which it has not without a given thrust."""
    return "m_u" in fit.model.values and not thrust_scale_of(fit.model).relative


def mass_notes(fit: Fit, weighed: float | None, uncertainty: ModelUncertainty | None = None) -> list[str]:
    """Return a note that compares the estimated mass in surge with the weighed mass of the boat [kg], or an empty list.

    Without a weighed mass, the note says that nothing was compared. The list is empty where `mass_warnings` warns, and
    if the fit has no mass in surge in kilograms. It is also empty where the warning of different thrusts compares the
    masses for the thrust of either side, which the `uncertainty` of the model determines: the estimate lies between.
    """
    if not _has_mass_to_weigh(fit) or mass_warnings(fit, weighed) or sides_compare_mass(uncertainty, fit, weighed):
        return []
    if weighed is None:
        return [NOT_WEIGHED]
    mass, error = fit.estimate("m_u")
    ratio = f"The mass in surge, m_u, is {mass / weighed:.2f} times the weighed mass of {weighed:g} kg"
    if mass < weighed:
        return [
            f"{ratio}. With the added mass of the water, for a slender hull 5 to 30 % of the mass, it must be larger: "
            f"its standard error is {error:.2g} kg, or the given thrust is too small. Check the thrust, the scale of "
            "the shaft speeds (full speed) and the load."
        ]
    found = (
        f"{ratio}. If the boat weighed this during the logs and the thrust is right, the excess is the added mass of "
        "the water, for a slender hull usually 5 to 30 % of the mass. A load that was not weighed, and a given thrust "
        "that is too large, look the same."
    )
    if mass <= USUAL_ADDED * weighed:
        return [found]
    doubt = f", by less than two standard errors ({error:.2g} kg)" if np.isfinite(error) else ""
    found += (
        f" The excess is more here{doubt}. If the hull is slender, check the given thrust, the scale of the shaft "
        "speeds (full speed), the load, and whether the thrusters have lost thrust since it was measured (a fouled "
        "propeller, a sagging supply)."
    )
    return [found]


def design_warnings(model: Model, thrust: float, pole: float | None) -> list[ResultWarning]:
    """Return warnings about the built-in values that an experiment design assumes in place of measured ones.

    The values are the thrust and the thrusters' arms of the model, the thrust behind inputs that are forces, and the
    time constant of the shafts.

    Parameters
    ----------
    model : Model
        Model for which the mission is designed.
    thrust : float
        Assumed thrust of one thruster at full speed [N]. It is used only if inputs of the model are forces.
    pole : float or None
        Assumed pole of the shafts' lag between command and shaft speed [1/s]. If it is None, because the model contains
        the shafts, there is no such warning.
    """
    warnings = scale_warnings(thrust_scale_of(model))
    forces = [i.name for i in model.inputs if i.unit in ("N", "N m")]
    if forces:
        text = (
            f"The model has the inputs {', '.join(forces)}, not commands: the design assumes thrusters with a "
            f"built-in thrust of {thrust:.0f} N at full speed on built-in arms, and the standard errors hold for such "
            "thrusters. For your own thrusters, use a model with shaft speeds as inputs (horizontal:shaft)."
        )
        warnings.append(ResultWarning(code="thrust-scale-unknown", text=text))
    if pole is not None:
        text = (
            f"The design assumes a built-in time constant of the shafts of {1e3 / pole:.0f} ms. With slower shafts the "
            "standard errors of a fit will be larger: give the folder of a bench test by --thruster. A model with "
            "commands as inputs (horizontal:command) uses its own time constant."
        )
        warnings.append(ResultWarning(code="shaft-lag-built-in", text=text))
    return warnings


def scale_warnings(scale: ThrustScale) -> list[ResultWarning]:
    """Return a warning if the thrust was not given, and another if the thrusters' arms were not given.

    Masses and damping are then ratios to the thrust, or inertia and damping in yaw ratios to the arm. The list is empty
    if both were given or are not needed.
    """
    warnings = []
    if scale.relative:
        text = (
            "The thrust was not given, and motion alone determines only ratios: masses, damping and forces are divided "
            "by T, the full forward thrust of one thruster (c1 + c2). For values in kg and N, multiply them by T, or "
            "give --thruster MODEL, --fix c1=..., --prior c1=MEAN:SD, or [scale] in the import map; c1 is the mean of "
            "the thrust ahead and astern at full command; if only the thrust ahead is known, give it as c1 and leave "
            "c2 out."
        )
        warnings.append(ResultWarning(code="thrust-scale-unknown", text=text))
    if scale.relative_yaw:
        text = (
            "The thrusters' arms were not given: inertia and damping in yaw are divided by the arm y_arm. The Munk "
            "moment (m_u - m_v) u v determines y_arm only roughly, and wrongly if the hull has other moments of that "
            "form. Give position_m under [[thruster]] in the rig file, --fix y_left=... --fix y_right=..., or "
            "[geometry] in the import map."
        )
        warnings.append(ResultWarning(code="arm-unknown", text=text))
    return warnings


def thrust_ahead_warnings(fit: Fit, ahead: float | None = None) -> list[ResultWarning]:
    """Return a warning if c1 was given, and the thrust ahead (c1 + c2) differs from it by more than 5 % by the data.

    Many data sheets have the thrust ahead only. Given as c1, it makes all masses wrong. The list is empty if c2 was
    given too, or if its difference from zero is not significant (two standard errors). If the thrust ``ahead`` [N] was
    given, that of the fit is compared with it instead of c1.
    """
    known, given = {p.name: p for p in fit.model.parameters}, {ParameterOrigin.GIVEN, ParameterOrigin.PRIOR}
    if not {"c1", "c2"} <= set(known) or known["c1"].origin not in given or known["c2"].origin in given:
        return []
    (c1, _), (c2, error) = fit.estimate("c1"), fit.estimate("c2")
    if ahead is not None:
        if not abs(c1 + c2 - ahead) > max(UNEQUAL_THRUST * ahead, 2.0 * error):
            return []
        text = (
            f"The thrust ahead was given as {ahead:.4g} N, and this fit has {c1 + c2:.3g} N (c1 + c2): masses, damping "
            f"and forces are {(c1 + c2) / ahead:.2f} times as large as with the given thrust. If c1 or c2 were not "
            f"given on purpose, give both thrusts (`ahead = {ahead:.4g}` and `astern = "
            f"{ahead * (c1 - c2) / (c1 + c2):.3g}` in [scale] of the import map), and fit again."
        )
        return [ResultWarning(code="thrust-ahead", text=text)]
    if not abs(c2) > max(UNEQUAL_THRUST * c1, 2.0 * error):
        return []
    prior = known["c1"].prior
    given_c1 = known["c1"].value if prior is None else prior[0]
    ahead, astern = given_c1, given_c1 * (c1 - c2) / (c1 + c2)
    mean, half = (ahead + astern) / 2.0, (ahead - astern) / 2.0
    sd = mean * (0.05 if prior is None else prior[1] / prior[0])
    sd_half = max(error * ahead / (c1 + c2), 0.1 * abs(half))
    text = (
        f"At full speed the thrust is {c1 + c2:.3g} N ahead and {c1 - c2:.3g} N astern by this fit; c1, which was "
        f"given as {given_c1:.3g} N, is the mean of both. If {given_c1:.3g} N was measured ahead only, the thrust "
        f"astern is about {astern:.3g} N by these data: give both (`ahead = {ahead:.4g}` and `astern = {astern:.3g}` "
        f"in [scale] of the import map, or --prior c1={mean:.3g}:{sd:.2g} --prior c2={half:.3g}:{sd_half:.2g}), and "
        "fit again. If it is the mean, give the half difference too "
        f"(--prior c2={c2:.3g}:{max(error, 0.1 * abs(c2)):.2g}). With either, this warning ends."
    )
    return [ResultWarning(code="thrust-ahead", text=text)]


def thrust_astern_warnings(fit: Fit) -> list[ResultWarning]:
    """Return a warning if the given c2 makes the thrust of one direction less than a third of that of the other.

    This is so if c2 is more than half of c1. The thrust astern was then probably given as c2. The list is empty if c1
    or c2 was not given.
    """
    known, given = {p.name: p for p in fit.model.parameters}, {ParameterOrigin.GIVEN, ParameterOrigin.PRIOR}
    if any(n not in known or known[n].origin not in given for n in ("c1", "c2")):
        return []
    c1, c2 = (known[n].value for n in ("c1", "c2"))
    if not abs(c2) > LARGEST_ASYMMETRY * c1:
        return []
    text = (
        f"The given c1 = {c1:.4g} N and c2 = {c2:.4g} N are {c1 + c2:.4g} N ahead (c1 + c2) and {c1 - c2:.4g} N astern "
        "(c1 - c2): one is less than a third of the other. From two measured thrusts, c1 = (ahead + astern) / 2 and c2 "
        f"= (ahead - astern) / 2. If {c1:.4g} N is the thrust ahead and {abs(c2):.4g} N that astern, give c1 = "
        f"{0.5 * (c1 + abs(c2)):.4g} and c2 = {0.5 * (c1 - abs(c2)):.4g}."
    )
    return [ResultWarning(code="thrust-astern", text=text)]


def antenna_warnings(fit: Fit) -> list[ResultWarning]:
    """Return a warning if the fit puts the GNSS antenna far from the position that was given (`antenna_warning`).

    The list is empty if no position was given, or if the model has no estimate of its error (effect ``lever-arm``).
    """
    return antenna_warning(fit.model, {n: fit.estimate(n) for n in ("l_x", "l_y") if n in fit.names})


def antenna_warning(model: Model, away: Mapping[str, tuple[float, float]]) -> list[ResultWarning]:
    """Return a warning if the data put the GNSS antenna far from the position that was given.

    Parameters
    ----------
    model
        Model. Its values ``antenna_x`` and ``antenna_y`` [m] are the given position.
    away
        Estimate and standard error [m] of ``l_x`` and ``l_y``, the distances from it forward and to starboard.

    Returns
    -------
    list
        One warning if a distance is more than 0.25 m and more than four standard errors. Empty otherwise, and if no
        position was given or a distance is missing.
    """
    given, places = model.values, []
    for axis, way in (("x", "forward"), ("y", "to starboard")):
        if f"antenna_{axis}" not in given or f"l_{axis}" not in away:
            return []
        places.append((way, given[f"antenna_{axis}"], *away[f"l_{axis}"]))
    if not any(abs(off) > LARGEST_AWAY and abs(off) > FAR_AWAY * error for _, _, off, error in places):
        return []
    found = " and ".join(f"{at + off:.2f} ± {error:.1g} m {way}" for way, at, off, error in places)
    there = " and ".join(f"{at:.2f} m {way}" for way, at, _, _ in places)
    text = (
        f"The data put the GNSS antenna {found} of the origin, but {there} were given. Check its lever arm "
        "(lever_arm_m): the signs (forward and to starboard are positive), the unit, and that it is measured from the "
        "centre of gravity."
    )
    return [ResultWarning(code="antenna-contradicted", text=text)]


def unusual_estimates(fit: Fit) -> list[ResultWarning]:
    """Return a warning for each parameter of an effect whose estimate is far from its usual size.

    Only positive parameters with a prior on a log scale are tested, because a usual size of zero has no factor. The
    limit is three standard deviations of the prior.
    """
    of_effects = {p.name for e in fit.model.effects for p in e.parameters if p.transform == "log"}
    warnings = []
    for p, value in zip(fit.parameters, fit.values.tolist(), strict=True):
        prior = p.free_prior()
        if p.name not in of_effects or prior is None or p.origin is ParameterOrigin.PRIOR or value <= 0.0:
            continue
        if abs(p.to_free(value) - prior[0]) > UNUSUAL * prior[1]:
            usual, factor = math.exp(prior[0]), math.exp(prior[1])
            label = parameter_label(p, fit)
            text = (
                f"{label} = {value:.2g} {p.unit} ({p.meaning}) is far from its usual size, {usual:.2g} {p.unit} "
                f"within a factor of {factor:.2g}: the effect may stand for another one. Give --prior {p.name}=MEAN:SD "
                "if you know it."
            )
            warnings.append(ResultWarning(code="unusual-estimate", text=text))
    return warnings


def outlier_lines(residuals: Sequence[ChannelResiduals], model: Model) -> list[str]:
    """Return a note with the channels of each record that have outliers among their innovations, and advice.

    An outlier is beyond six standard deviations. Channels that are already estimated robustly, with outliers as part of
    their density, are left out. The list is empty if no channel is left.

    Parameters
    ----------
    residuals
        Standardised innovations of each record and channel, with their tests.
    model
        Model; each of its outputs is marked as estimated robustly or not.
    """
    robust = {o.name for o in model.outputs if o.robust}
    by_record: dict[str, list[str]] = {}
    for r in residuals:
        if r.tests.outliers and r.channel not in robust:
            words = f"{r.channel} {r.tests.outliers} of {r.e.size} (the largest at {r.tests.largest:.2g})"
            by_record.setdefault(r.record, []).append(words)
    if not by_record:
        return []
    places = "; ".join(f"{record}: {', '.join(words)}" for record, words in by_record.items())
    return [
        f"Some innovations are beyond {OUTLIER_SDS:g} standard deviations: outliers, or an event that the model lacks. "
        f"Look at them in the report; --robust gives outliers little weight. {places}."
    ]


def estimation_logs(made: Provenance) -> int:
    """Return the number of different estimation logs of a result."""
    return len({log.name for log in made.logs if log.role == "estimation"})


def faults_first(made: Provenance) -> str:
    """Return the beginning of the answer of a fit to logs with faults (`--despite-faults`), which lists the faults.

    They are listed by log, device and code; `check_warnings` has their texts. The beginning ends with a space. It is
    empty if no log has a fault that makes a fit meaningless.

    Parameters
    ----------
    made
        Provenance of the result, with the findings of the checks of each log.
    """
    faults = [f"{log.path}: {f.where} [{f.code}]" for log in made.logs for f in log.findings if f.spoils]
    return (
        f"The logs have faults that can make this result meaningless ({'; '.join(faults)}; the warnings have their "
        "texts). Correct them and fit again. "
    ) * bool(faults)


def late_command_sentence(made: Provenance) -> str:
    """Return the beginning of the answer of a thruster whose logs store the command one row late; "" for other logs.

    Delay and lag of the shaft, and effects like them, then describe the time of the command. The beginning ends with a
    space. ``made`` has the findings of the checks of each log.
    """
    late = [log.path for log in made.logs if any(f.code == "command-one-row-late" for f in log.findings)]
    return (
        f"In {_first_names(late, MOST_NAMES)} command and shaft speed are probably one row apart (see the warning): "
        "correct this first, because delay and lag of the shaft, and effects like them, have no meaning before. "
    ) * bool(late)


def check_warnings(made: Provenance, besides: Collection[str] = ()) -> list[ResultWarning]:
    """Return one warning for each different finding of the checks of the logs before a fit.

    Findings are different if their text, code or advice differs. A warning names the devices or signals with the
    finding, and up to four of the logs in which they have it, with the number of the others. The warnings have the
    order in which the findings first occur.

    Parameters
    ----------
    made
        Provenance of the result, with the findings of the checks of each log.
    besides
        Codes of findings that are left out.
    """
    devices: dict[str, dict[str, list[str]]] = {}  # by text and log
    for log in made.logs:
        for f in (f for f in log.findings if f.code not in besides):
            text = f"{f.text} [{f.code}]{': ' * bool(f.advice)}{f.advice}."
            devices.setdefault(text, {}).setdefault(log.path, []).append(f.where)
    return [ResultWarning(code="log-check", text=f"{_places(by_log)}: {text}") for text, by_log in devices.items()]


def _places(devices: Mapping[str, Sequence[str]]) -> str:
    """Return the logs and the devices of a finding as text, such as ``run1, run2: psi, r; run3: r``.

    ``devices`` are its devices by log. Logs with the same devices are listed together.
    """
    logs: dict[str, list[str]] = {}
    for log, names in devices.items():
        logs.setdefault(", ".join(dict.fromkeys(names)), []).append(log)
    return "; ".join(f"{_first_names(paths)}: {names}" for names, paths in logs.items())


def late_sensor_warnings(made: Provenance, model: Model) -> list[ResultWarning]:
    """Return a warning if a sensor or thrust signal of a log is late, with the parameters that the delay biases.

    Only a delay that `seatrial check` calls a fault counts. The biased parameters are the free masses, damping
    coefficients, time constants and gains. The list is empty if no signal is late or the model has no such parameter.

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
        f"{_first_names(logs)}: a signal is late (`seatrial check` names it), but the fit assumes that it is on time: "
        f"{', '.join(biased)} are biased by more than their standard errors. Correct its time stamps; for a late GNSS "
        "receiver, --effect gnss-latency estimates the latency."
    )
    return [ResultWarning(code="late-sensor-bias", text=text)]


def structure_warnings(model: Model, cross: Sequence[CrossCorrelationRow], role: Role) -> list[ResultWarning]:
    """Return a warning if the residuals show that Nomoto's structure does not fit the vehicle: what to take instead.

    They show it if a channel is significantly correlated with a shaft speed or command (at 1 % over all channels and
    inputs, by Bonferroni), and by `UNFIT` or more. The list is empty for any other structure.

    Parameters
    ----------
    model : Model
        Model of the fit.
    cross : sequence of CrossCorrelationRow
        Correlations of its residuals with each input.
    role : str
        Role of the records whose residuals count, ``estimation`` or ``validation``.
    """
    if model.source.partition(":")[0] != NOMOTO:
        return []
    tests = [(c, c.p) for c in cross if c.role == role and c.p is not None]
    large = [
        c for c, p in tests if p * len(tests) < LEVEL and (c.largest or 0.0) >= UNFIT and c.input not in MEASURED_INPUTS
    ]
    if not large:
        return []
    most: dict[str, CrossCorrelationRow] = {}
    for c in sorted(large, key=lambda c: -(c.largest or 0.0)):
        most.setdefault(c.channel, c)
    found = [f"{NAMES.get(n, n)} with {c.input} by {c.largest:.2g}" for n, c in most.items()]
    lag = "; for a vehicle that does not slide sideways, free the time constant of the yaw rate (--prior T=0.5:0.5)"
    text = (
        f"{NOMOTO}: its residuals are correlated with the inputs ({', '.join(found)}), so that this structure does not "
        "explain how the motion follows them: use --model horizontal, which has sway and a yaw moment with an inertia"
        f"{'' if model.parameter(NOMOTO_LAG).free else lag}."
    )
    return [ResultWarning(code="structure-unfit", text=text)]


def frame_warnings(model: Model, unplaced: Sequence[str], *, saved_origin_unknown: bool = False) -> list[ResultWarning]:
    """Return a warning if the model has an effect at a fixed point, and the x and y of logs may have different origins.

    A fixed point, for example of a mooring, has the same x and y in all logs. The list is empty if the model has no
    effect at a fixed point, or if all origins are known.

    Parameters
    ----------
    model : Model
        Model with its effects.
    unplaced : sequence of str
        Names of the logs without latitude and longitude, so that the origin of their x and y is unknown.
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
        "assumed to have one origin. If they do not, the point and its force are wrong: fit the model to logs with "
        "latitude and longitude."
    )
    return [ResultWarning(code="frame-assumed", text=text)]


def frames_assumed(fitted: FittedModel) -> list[ResultWarning]:
    """Return the warning of ``frame_warnings`` for the records of a fit: their x and y may have different origins.

    The records are those of the estimation data and of separate validation runs; only those with the output ``x``
    count. The list is empty for a single record, if the origin of each record is known, or if the model has no effect
    at a fixed point.
    """
    records = {
        r.name: r for r in (*fitted.records, *(v.record for v in fitted.validation if not fitted.cross_validated))
    }
    unplaced = [name for name, r in records.items() if "x" in r.outputs and r.meta.get(ORIGIN) is None]
    return frame_warnings(fitted.fit.model, unplaced if len(records) > 1 else ())


def not_converged(fit: Fit) -> str | None:
    """Return the sentences that replace the answer of a fit that did not converge: the reason and advice.

    The result is None if the fit converged.
    """
    if fit.converged:
        return None
    begin = f"The fit did not converge: it {fit.message}. Do not use its estimates or errors. "
    if NOMOTO_LAG in fit.model.values and not fit.model.parameter(NOMOTO_LAG).free:
        return (
            f"{begin}The yaw rate of this model has no time constant, since T is fixed at zero: free it by --prior "
            "T=0.5:0.5. If that does not help, look for a stuck or missing signal (seatrial check LOG), and give "
            "--initial or --prior."
        )
    simpler = ", such as --model nomoto for a boat that does not slide sideways" if "m_v" in fit.model.values else ""
    return (
        f"{begin}First look for a stuck or missing signal (seatrial check LOG); then give --initial or --prior, or use "
        f"a model with fewer free parameters{simpler}."
    )


def failed_run_warnings(failed: Sequence[FailedRun]) -> list[ResultWarning]:
    """Return one warning for each validation run that could not be evaluated, with the reason; empty without any."""
    text = (
        "{0.record} is left out of the validation, because the model cannot be evaluated on it: {0.reason}. Check this "
        "log with `seatrial check`."
    )
    return [ResultWarning(code="validation-run-failed", text=text.format(f)) for f in failed]


def short_data_warnings(fitted: FittedModel, horizon: float) -> list[ResultWarning]:
    """Return warnings about estimation data of less than 60 s (bench: 20 s), and about data shorter than the horizon.

    The second one names the validation logs (of a fit without them: the estimation logs) that are not longer than the
    horizon, so that they contain no prediction over it. The list is empty if neither applies.

    Parameters
    ----------
    fitted
        Fit with its estimation records and its evaluation on the validation records.
    horizon
        Prediction horizon [s].
    """
    found, total = [], sum(r.duration for r in fitted.records)
    bench = fitted.model.kind is ModelKind.BENCH
    if round(total) < (SHORT_BENCH_S if bench else SHORT_DATA_S):  # the rows of a minute end a sample before it
        logs = "log has" if len(fitted.records) == 1 else "logs have"
        what, how = (
            ("the steps of a bench run", "a minute or more with steps at several levels, forward and in reverse")
            if bench
            else ("the slow motions of a boat", "some minutes with steps of the speed and turns")
        )
        text = (
            f"The {logs} {total:.3g} s in all: this is too short for {what}, and the estimates and their standard "
            f"errors may be far off. Record {how}."
        )
        found.append(ResultWarning(code="short-data", text=text))
    separate = fitted.validation and not fitted.cross_validated
    evaluated = [v.record for v in fitted.validation] if separate else fitted.records
    short = {r.name: r.duration for r in evaluated if r.duration <= horizon}
    if short:
        where = f"{'validation' if separate else 'estimation'} data"
        text = (
            f"Too short for the horizon of {horizon:g} s, and without predictions over it: {_first_names(list(short))} "
            f"({where}, at most {max(short.values()):.3g} s). Give longer logs or a shorter --horizon."
        )
        found.append(ResultWarning(code="short-data", text=text))
    return found


def warm_up_notes(durations: Iterable[tuple[str, float]], kind: ModelKind = ModelKind.VEHICLE) -> list[str]:
    """Return a note on the seconds that the errors of a simulation cover, if records are shorter than four warm-ups.

    The warm-up is the time in which the filter sees the measurements. The errors leave it out, and thus a large part of
    a short record. The list is empty if no record is that short.

    Parameters
    ----------
    durations
        Name and duration [s] of each simulated record, or of each block in time of one. Of equal names the shortest
        counts. Blocks of one record are counted, and the shortest of them is named.
    kind
        Kind of the modelled object, which the note names: the boat, or the thruster of a bench.
    """
    short: dict[str, float] = {}
    for name, duration in durations:
        if round(duration) < SHORT_FOR_SIMULATION * WARM_UP:  # the rows of a minute end a sample before it
            short[name] = min(duration, short.get(name, duration))
    if not short:
        return []
    by_run: dict[str, list[str]] = {}
    for name in short:
        by_run.setdefault(BLOCK_TIMES.sub("", name), []).append(name)
    parts = []
    for run, names in by_run.items():
        d = min(short[name] for name in names)
        of = names[0] if len(names) == 1 else f"each of {len(names)} blocks of {run}"
        parts.append(f"{max(d - WARM_UP, 0.0):.0f} of {d:.0f} s of {of}")
    covered = first_names(parts)
    thing = "boat" if kind is ModelKind.VEHICLE else "thruster"
    return [f"{SIMULATION_COVERS} {covered}. What the {thing} does before is not in them."]


def simulated_durations(evaluation: PredictionEvaluation) -> Iterator[tuple[str, float]]:
    """Yield name and duration [s] of each record, or block in time of one, that an evaluation simulates."""
    for evaluated in evaluation.sets.values():
        for predicted in evaluated.records:
            yield predicted.record.name, predicted.record.duration


def cut_records(records: Sequence[Record]) -> list[ResultWarning]:
    """Return one warning for each record whose end was cut off because one of its signals ends early.

    It has the name of that signal and the length of the lost data [s]. The list is empty if no record was cut.
    """
    cuts = ((r, *r.meta["cut"]) for r in records if "cut" in r.meta)
    return [
        ResultWarning(
            code="record-cut",
            text=f"{r.name}: the signal {name} ends {lost:.0f} s before the others, and the data after its end are not "
            "used. Check its sensor, or leave this signal out of the rig file or import map.",
        )
        for r, name, lost in cuts
    ]


def stuck_sensors(records: Sequence[Record]) -> list[ResultWarning]:
    """Return one warning for each channel of any record with at least ten samples that are all equal (stuck sensor)."""
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
                "Check it, or leave this signal out of the rig file or import map."
            )
            lines.append(ResultWarning(code="stuck-sensor", text=text))
    return lines


def smallest_command(records: Sequence[Record]) -> float:
    """Return the smallest command that was held on a thruster bench, as a part of full command (0 to 1).

    It is the 5 % quantile of the absolute commands that are not zero, because a ramp passes through smaller commands
    without holding them. It is 1.0 if all commands are zero. Each record must have the input ``n_cmd_0``.
    """
    size = np.abs(np.concatenate([r.u[:, r.inputs.index("n_cmd_0")] for r in records]))
    return float(np.quantile(size[size > 0.0], RAMP_SHARE)) if size.any() else 1.0


def plus_minus(value: float, error: float) -> str:
    """Return a value and its standard error as text to two digits of the error: ``40.783 ± 0.029``.

    Both have the same number of decimals, at most nine; an error of 10 or more has none. If the error is not positive
    or not finite, both have one decimal.
    """
    decimals = min(max(1 - math.floor(math.log10(error)), 0), 9) if 0.0 < error < math.inf else 1
    return f"{round(value, decimals) + 0.0:.{decimals}f} ± {error:.{decimals}f}"  # + 0.0 turns -0 into 0


def thruster_answer(
    fitted: Fit,
    has_force: bool,
    directions: Sequence[float] = (1.0, -1.0),
    calibration: float | None = None,
    smallest: float = 0.0,
    contradicted: bool = False,
    reach: Mapping[float, float] | None = None,
) -> str:
    """Return the answer of a thruster fit: thrust at full shaft speed, delay, time constant and dead zone.

    If the thrust of neither direction is known, the answer states that the logs do not determine it.

    Parameters
    ----------
    fitted : Fit
        Fit of the thruster model.
    has_force : bool
        Whether the bench has a load cell. Without it the answer states that the thrust is unknown.
    directions : sequence of float
        Directions in which the shaft turned: 1 forward, -1 reverse. A direction that is missing is called not measured.
        A direction without a finite standard error is called not identifiable, and one with a standard error above half
        of the thrust not determined.
    calibration : float, optional
        Relative standard uncertainty of the load cell's force, which is added in quadrature to the standard errors of
        the thrust. If it is None, the errors are called statistical only.
    smallest : float
        Smallest command that was tried, as a part of full command. If the fitted dead zone is below 0.05 % of full
        command, the answer states that there is none above this command.
    contradicted : bool
        Whether the shaft turns at commands inside the fitted dead zone. The answer then states that the dead zone is
        not determined.
    reach : mapping, optional
        Largest measured shaft speed, as a part of full speed, by direction. The answer states it where it is below
        0.95, and that the thrust at full speed is extrapolated. None: full speed.
    """
    a, tau, d = (fitted.estimate(n) for n in ("a", "tau", "d"))
    constant = "that is not determined" if is_undetermined(*a) else f"of {1e3 / a[0]:.0f} ms"
    if contradicted:
        zone = "; its dead zone is not determined"
    elif d[0] >= NO_DEAD_ZONE:
        zone = f" and does not turn below {100 * d[0]:.1f} % of full command"
    else:
        zone = f" and has no dead zone above the smallest command tried, {format_number(100 * smallest)} %"
    shaft = f"the shaft follows its command with a delay of {1e3 * tau[0]:.0f} ms and a time constant {constant}{zone}"
    if not has_force:
        return shaft[0].upper() + shaft[1:] + "; its thrust is unknown without a load cell."
    included = "errors: statistical only" if calibration is None else "errors include the load cell's calibration"
    ends, lost = [], []
    for direction, word in ((1.0, "forward"), (-1.0, "in reverse")):
        force, error = (float(z[0]) for z in steady_thrust(fitted, np.array([direction])))
        if error == 0.0:  # both coefficients are fixed
            ends.append(f"{direction * force:.4g} N {word}, as given,")
        elif direction in directions and is_undetermined(force, error):
            lost.append(f"{word}: not determined")
        elif direction in directions and math.isfinite(error):
            ends.append(f"{plus_minus(direction * force, math.hypot(error, (calibration or 0.0) * force))} N {word}")
        else:
            lost.append(f"{word}: not {'identifiable' if direction in directions else 'measured'}")
    if not ends:
        return (
            f"The logs do not determine the thrust ({', '.join(lost)}); add a log with the load cell and steps forward "
            f"and in reverse. {shaft[0].upper()}{shaft[1:]}."
        )
    also = "".join(f"; {line}" for line in lost)
    return (
        f"The thruster gives {' and '.join(ends)} at full speed ({included}{_extrapolation(reach or {})}{also}); "
        f"{shaft}."
    )


def _extrapolation(reach: Mapping[float, float]) -> str:
    """Return up to which part of full speed the thrust was measured, for the answer of a thruster; "" at full speed.

    ``reach``: largest measured shaft speed by direction (1, -1). A direction with speed 0 was not measured.
    """
    words = {1.0: "forward", -1.0: "in reverse"}
    short = {way: f"{100 * n:.0f} %" for way, n in reach.items() if 0.0 < n < FULL_SPEED}
    if not short:
        return ""
    measured = [way for way, n in reach.items() if n > 0.0]
    if len(set(short.values())) == 1 and len(short) == len(measured):
        speeds = f"{next(iter(short.values()))} of full speed"
    else:
        speeds = " and ".join(f"{percent} of full speed {words[way]}" for way, percent in short.items())
    return f"; extrapolated, as it was measured only up to {speeds}"


def thruster_warnings(directions: Sequence[float]) -> list[ResultWarning]:
    """Return a warning if the shaft turned in one direction only on the bench: the other thrust is assumed to be equal.

    ``directions`` has the directions in which the shaft turned: 1 for forward, -1 for reverse. The list is empty for
    two directions, and if the shaft did not turn.
    """
    if len(directions) != 1:
        return []
    measured, unmeasured = ("forward", "in reverse") if directions[0] > 0 else ("in reverse", "forward")
    text = (
        f"The shaft turned {measured} only: c2 is fixed at 0, so the model has the same thrust {unmeasured} as "
        f"{measured}, which was not measured. Add a log with steps {unmeasured}."
    )
    return [ResultWarning(code="one-direction", text=text)]


def moving_boat_warnings(speeds: Mapping[str, float | None], has_force: bool) -> list[ResultWarning]:
    """Return a warning if a log of a thruster is that of a moving boat, not of a bench.

    Parameters
    ----------
    speeds
        Speed over ground [m/s] that the boat exceeded for a tenth of each log, by name of the log; None: unknown.
    has_force
        Whether the logs have the force of a load cell.
    """
    moving = {name: speed for name, speed in speeds.items() if speed is not None and speed > MOVING}
    if not moving:
        return []
    fastest = max(moving, key=lambda name: moving[name])
    usable = (
        "The thrust is that of the moving boat, less than at rest, and mixed with its drag and inertia"
        if has_force
        else "The delay and the time constant of the shaft are those of the boat under way: with them, a boat model of "
        "shaft speeds is exported with commands as inputs (`seatrial ident export BOAT --to python --thruster FILE`)"
    )
    text = (
        f"{_first_names(list(moving), MOST_NAMES)}: the boat moves (more than {moving[fastest]:.2g} m/s over ground in "
        f"a tenth of {fastest}), so this is no bench run. {usable}; the dead zone depends on the few small commands of "
        "a voyage. To characterise the thruster, moor the boat and hold each command for some seconds, small ones too "
        "(seatrial bench steps). For a model of the boat, use seatrial ident vehicle."
    )
    return [ResultWarning(code="boat-moves", text=text)]


def dead_zone_warnings(turning: Mapping[str, TurningShaft | None], dead_zone: float) -> list[ResultWarning]:
    """Return a warning if a shaft turned at a command inside its fitted dead zone.

    Parameters
    ----------
    turning
        Held command inside the dead zone at which the shaft turned fastest, by name of the log; None: it did not turn.
    dead_zone
        End of the fitted dead zone, as a part of full command.
    """
    found = {name: x for name, x in turning.items() if x is not None}
    if not found:
        return []
    name, held = max(found.items(), key=lambda item: abs(item[1].speed))
    text = (
        f"{name}: the data contradict the fitted dead zone of {100 * dead_zone:.1f} % of full command: at a command of "
        f"{100 * held.command:.1f} % the shaft turns at {100 * held.speed:.1f} % of full speed (from {held.start:.1f} "
        f"to {held.end:.1f} s). The model has a shaft that follows the whole command outside its dead zone; a "
        "controller that subtracts its dead zone, or a low battery, gives less. The dead zone is therefore not "
        "determined: d is only the value with which this model predicts the shaft speeds best. An export of this model "
        "alone keeps d, and an export of a boat model that is joined with it has a dead zone of zero. Set no dead zone "
        "of an autopilot to d. Hold more small commands (seatrial bench steps), and let a diagnosis test the effect "
        "controller-dead-band."
    )
    return [ResultWarning(code="dead-zone-contradicted", text=text)]


def curve_warnings(levels: Levels) -> list[ResultWarning]:
    """Return a warning if the zero of the load cell is unknown, because the command was never held at zero.

    The list is empty if the zero is known. ``levels`` has the held commands with their mean forces.
    """
    if levels.offset is not None:
        return []
    text = (
        "The command is never held at zero: the load cell's zero is unknown, and all forces contain its offset. Hold "
        "zero command before and after the steps."
    )
    return [ResultWarning(code="zero-unknown", text=text)]


def curve_notes(levels: Levels, measured: ThrustCurve, quadratic: Quadratic) -> list[str]:
    """Return the notes of a static thrust curve, one text each on the following.

    - The load cell's reading at rest, which was subtracted; left out if the command was never held at zero.
    - The quadratic fit, and what the standard errors include.
    - The error of the load cell's calibration.
    - The commands whose forces were averaged so that the force rises with the command; left out if there are none.

    Parameters
    ----------
    levels
        Held commands (levels) with their mean forces [N].
    measured
        Thrust curve through the levels, and the uncertainty of the load cell's calibration.
    quadratic
        Quadratic fit ``c1 n|n| + c2 n^2`` [N] to the levels.
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
        f"and the scatter of {levels.scatter:.2g} N between repetitions of a level ({levels.dof} degrees of freedom)"
        if levels.dof
        else "but not the scatter between repetitions, since no level was repeated"
    )
    zero = (
        f"The force on the load cell at rest, {plus_minus(levels.offset, levels.offset_se)} N, is subtracted from all "
        "levels."
        if levels.offset is not None
        else ""
    )
    notes = [
        *filter(None, [zero]),
        f"Quadratic curve: c1 = {plus_minus(quadratic.c1, errors[0])} N, {c2}; test of its misfit against the errors "
        f"of the levels: p = {quadratic.p:.2g} ({test} degrees of freedom).",
        f"The standard errors of the levels include the autocorrelation of the force {between}. They do not include "
        "friction of the bench, the charge of the battery, or differences between days.",
        "The error of the load cell's calibration was not given, so masses and forces by this curve have statistical "
        "errors only. Give newton_per_count_sd and lever_ratio_sd in the rig file, or `calibration` in model.toml."
        if calibration is None
        else f"The errors of fits with this curve include the load cell's calibration, ± {100 * calibration:.2g} %.",
    ]
    moved = np.abs(curve.force - levels.force) > 1e-9
    if moved.any():
        pooled = zip(levels.n[moved], levels.force[moved], levels.error[moved], strict=True)
        shown = ", ".join(f"{plus_minus(f, s)} N at {n:g}" for n, f, s in pooled)
        notes.append(
            "At some levels the measured force does not rise with the command; they were averaged with their "
            f"neighbours: {shown}. Repeat these levels if this matters."
        )
    return notes


def straight_sentence(
    dynamics: Dynamics | None, fitted: FittedModel | None = None, causes: Iterable[Effect] = ()
) -> str:
    """Return the sentence on a boat that turns although both sides have the same input: what a straight course needs.

    It has the inputs of the linear model in the middle of the speeds; in wind, or under a similar force, those of the
    two headings on which the sides differ most (`_straight_by_heading`). The text is empty for None, for a model
    without an input for each side, and if the inputs differ by less than 3 % of their mean. It is also empty if
    the data do not determine the size of one of the effects ``causes`` of the model ``fitted``: the inputs are then no
    fact.
    """
    rough = fitted is not None and any(sizes_undetermined(e, fitted) for e in causes)
    if dynamics is None or not dynamics.points or rough:
        return ""
    if dynamics.headings:
        return _straight_by_heading(dynamics.headings)
    point = dynamics.points[(len(dynamics.points) - 1) // 2]
    pull = _pull(point.inputs)
    if pull is None or not pull.matters:
        return ""
    return (
        f"With equal {drive_word(point.inputs)}s the boat turns to {pull.side}: to go straight at {point.speed:.3g} "
        f"m/s, it needs {pull.text}."
    )


def sizes_undetermined(effect: Effect, fitted: FittedModel) -> bool:
    """Return whether the data determine no size of an effect: each standard error is more than half of the estimate.

    The sizes are the free parameters that are zero without the effect, and have one value for all runs.
    """
    sizes = [p for p in effect.parameters if p.free and p.value == 0.0 and not p.per_record]
    return bool(sizes) and all(is_undetermined(*fitted.fit.estimate(p.name)) for p in sizes)


class _Pull(NamedTuple):
    """Difference of the inputs of both sides on a straight course.

    Attributes
    ----------
    difference
        Input of the right side less that of the left side.
    matters
        Whether it is at least 3 % of their mean.
    text
        Both inputs with their names.
    """

    difference: float
    matters: bool
    text: str

    @property
    def side(self) -> str:
        """Side to which the boat turns with equal inputs."""
        return "starboard" if self.difference > 0.0 else "port"


def _pull(inputs: Mapping[str, float]) -> _Pull | None:
    """Return the difference of the inputs of both sides; None for a model without an input for each side."""
    sides = {name.rpartition("_")[2]: (name, value) for name, value in inputs.items()}
    if len(inputs) != 2 or set(sides) != {"left", "right"}:
        return None
    (left_name, left), (right_name, right) = sides["left"], sides["right"]
    unit = " N" if drive_word(inputs) == "thrust" else ""
    text = f"{left_name} {left:.3g}{unit} and {right_name} {right:.3g}{unit}"
    return _Pull(right - left, abs(right - left) >= LEAST_PULL * 0.5 * abs(right + left), text)


def _straight_by_heading(points: Sequence[HeadingPoint]) -> str:
    """Return the sentence on the inputs of a straight course of a boat on which the wind acts, or a similar force.

    It has the headings with the smallest and the largest difference of the right side from the left one. The text is
    empty without an input for each side, and if no difference is at least 3 % of the mean.
    """
    pulls = [(pull, p.heading) for p in points if (pull := _pull(p.inputs)) is not None]
    matter = [pull for pull, _ in pulls if pull.matters]
    if not matter:
        return ""
    sides = {pull.side for pull in matter}
    where = f"{sides.pop()}, more on some headings than on others"
    if sides:
        where = "starboard on some headings and to port on others"
    low, high = (f"{pull.text} (heading {math.degrees(psi):.0f} deg)" for pull, psi in (min(pulls), max(pulls)))
    return (
        f"With equal {drive_word(points[0].inputs)}s the boat turns to {where}: to go straight at "
        f"{points[0].speed:.3g} m/s, it needs from {low} to {high}."
    )


def candidate_sentence(found: ModelUncertainty | None) -> str:
    """Return the sentence on the strongest candidate for a missing effect by the score tests of a fit.

    The text is empty without score tests, and if no candidate passes them.
    """
    if found is None or not found.strongest:
        return ""
    effect, title = catalogue().get(found.strongest), candidate_title(found.strongest)
    name = f"{title} ({effect.name})" if effect else title
    return (
        f"The strongest candidate of the score tests is {name}: `seatrial ident diagnose` tests it against the others."
    )


def wind_sentence(made: Provenance, model: Model) -> str:
    """Return the sentence on a model with one wind for estimation logs that begin hours apart; often empty.

    Unlike the current, the wind of the catalogue (effect ``wind``) has one value for all logs. The text is empty for a
    model without it, and for logs whose starts differ by three hours or less or are unknown.

    Parameters
    ----------
    made
        Provenance of the result, with the start times of the logs.
    model
        Model with its effects.
    """
    if "wind" not in {e.name for e in model.effects} or model.parameter("F_wx").per_record:
        return ""
    starts = [datetime.fromisoformat(x.start) for x in made.logs if x.role == "estimation" and x.start]
    dated = [t for t in starts if t.year > NO_DATE]  # without a date, the order of the logs in time is unknown
    if len(dated) < 2 or (apart := max(dated) - min(dated)) <= SAME_WEATHER:
        return ""
    hours = apart / timedelta(hours=1)
    span = f"{hours:.0f} h" if hours < 48.0 else f"{hours / 24.0:.0f} days"
    return (
        f"The wind is one value for all logs, but they begin up to {span} apart (the current has one for each log). "
        "Test whether the logs agree: `seatrial ident vehicle LOGS --effect wind --test-homogeneity F_wx "
        "--test-homogeneity F_wy`. If not, give each log its own wind: --per-log F_wx --per-log F_wy."
    )


def course_sentence(course: CourseStability | None, model: Model | None = None, logs: int = 0) -> str:
    """Return the sentences on a boat that is directionally unstable, with the time constant and its 95 % interval.

    The sentence says how the speed is chosen: as a part of the highest speed ahead in the logs.

    If there is one estimation log (``logs``; 0: unknown), or if the pole is less than three standard errors from zero,
    a further sentence says so, and what to record.

    If the interval of the pole contains zero, the sentence says that the data do not show the stability, in the words
    of `seatrial.ident.numerics.stability_of`. If the estimated damping of sway is negative, there is no statement on
    the stability, but one on the hull form, with the lowest speed at which it is negative. If the hull lift of
    ``model`` is the reason, the sentence says how to fit the model without it. The text is empty for a stable estimate
    and for None.
    """
    if course is None:
        return ""
    lowest = course.sway_from
    if lowest is not None or (course.sway is not None and course.sway > 0.0):
        at = f"At {course.speed:.3g} m/s" if lowest is None else f"From {lowest:.2g} m/s on"
        speeds = "that speed" if lowest is None else "these speeds"
        lift = None if model is None else next((p for p in model.parameters if p.name == LIFT and p.free), None)
        held = ""
        if lift is not None and lift.value < 0.0:
            held = (
                f", or fit the model again with the hull lift held (`seatrial ident vehicle LOGS --model MODEL.toml "
                f"--fix {LIFT}=0 --no-score-tests`) and compare both on a log that neither has used"
            )
        return (
            f"{at} the estimated damping of sway is negative, which no hull has: the data do not determine the form of "
            f"the hull there (lift, cross-flow). Do not design a controller with this model at {speeds}; record turns "
            f"at {'it' if lowest is None else 'them'}{held}."
        )
    if not course.unstable:
        return ""
    heading = ""
    if course.heading is not None:
        heading = f" on heading {math.degrees(course.heading):.0f} deg (the least stable one)"
    chosen = ""
    if course.share is not None:
        chosen = f" ({100.0 * course.share:.0f} % of the highest speed ahead in the logs)"
    where = f"At {course.speed:.3g} m/s{chosen}{heading}"
    begin = f"{where} the boat is directionally unstable"
    grows = f"without a controller a small yaw rate grows by a factor of e in {1.0 / course.pole:.3g} s"
    if course.low is None or course.high is None:
        return f"{begin}: {grows} (the 95 % interval is unknown).{_course_doubt(math.nan, logs)}"
    fastest = f"{1.0 / course.high:.3g}"
    if course.stability == UNSTABLE:
        t = Z95 * course.pole / (course.pole - course.low) if course.pole > course.low else math.inf
        return f"{begin}: {grows} (95 % interval: {fastest} to {1.0 / course.low:.3g} s).{_course_doubt(t, logs)}"
    return (
        f"{where} the directional stability is {NOT_SHOWN}: without a "
        f"controller a small yaw rate may grow by a factor of e in {fastest} s or decay in "
        f"{-1.0 / min(course.low, -1e-9):.3g} s (95 % interval). To find out, record {TURNS_FOR_STABILITY}."
    )


def _course_doubt(t: float, logs: int) -> str:
    """Return a sentence on how sure an unstable pole is, and what to record; empty for several logs and a sure pole.

    ``t`` is the pole divided by its standard error; NaN if it is unknown. ``logs`` is the number of estimation logs; 0:
    unknown. The text begins with a space.
    """
    few = f"the pole is {t:.1f} standard errors above zero, and less than {SURE_POLE:g} are not clear"
    reasons = [few] if t < SURE_POLE else []
    reasons += ["it rests on one log, which does not show how much other runs differ"] if logs == 1 else []
    if not reasons:
        return ""
    doubt = ", and ".join(reasons)
    return f" This is not sure: {doubt}. To confirm it, fit a further log too, with {TURNS_FOR_STABILITY}."


def _groups(a: HomogeneityTest) -> str:
    """Return a sentence with the logs above and below the widest gap between the values; begins with a space.

    The gap is measured in standard errors of both values beside it. Logs without a standard error, or that contain no
    information about the parameter, are left out; the text is empty if fewer than two remain.
    """
    rows = zip(a.values, a.errors, a.records, strict=True)
    told = sorted((v, e, n) for v, e, n in rows if math.isfinite(e) and e > 0.0 and n not in a.left_out)
    if len(told) < 2:
        return ""
    gaps = [(high[0] - low[0]) / math.hypot(low[1], high[1]) for low, high in pairwise(told)]
    k = 1 + max(range(len(gaps)), key=gaps.__getitem__)
    below, above = (", ".join(sorted(n for _, _, n in part)) for part in (told[:k], told[k:]))
    return f" The widest gap ({gaps[k - 1]:.1f} standard errors) is between {above} with larger values and {below}."


def homogeneity_sentence(a: HomogeneityTest) -> str:
    """Return the sentence on a homogeneity test: one value of a parameter for all logs against one for each log.

    It has the common value, the value of each log, the verdict (the logs agree if p is above 0.01), and the mean with
    the scatter between the logs. Logs that do not inform the parameter are named. If fewer than two logs inform it, the
    sentence states only that, and these names.
    """
    each = ", ".join(f"{plus_minus(v, e)} ({n})" for n, v, e in zip(a.records, a.values, a.errors, strict=True))
    low, high = a.interval
    unit = f" {a.unit}" if a.unit else ""
    verdict = "agree" if a.agree else "do not agree"
    use = "the mean with this scatter is" if a.agree else "use the mean with this scatter,"
    one = len(a.left_out) == 1
    silent = f" {', '.join(a.left_out)} contain{'s' * one} no information about it." if a.left_out else ""
    if a.df == 0:
        return (
            f"{a.name}: the logs cannot be compared, because fewer than two contain information about it; give more "
            f"logs.{silent}"
        )
    return (
        f"{a.name}: {plus_minus(a.value, a.error)}{unit} from all logs together (robust error {a.robust_error:.2g}); "
        f"from each log alone {each}. The logs {verdict} in one value (likelihood ratio {a.lr:.1f}, chi-square with "
        f"{a.df} degree{'s' if a.df > 1 else ''} of freedom: p = {a.p:.2g}).{'' if a.agree else _groups(a)} The "
        "scatter between the logs is "
        f"{a.scatter:.2g}; {use} {plus_minus(a.mean, a.mean_error)}, "
        f"95 % interval {low:.3g} to {high:.3g}{unit}.{silent}"
    )
