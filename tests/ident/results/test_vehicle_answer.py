"""Tests of the sentences on prediction and residuals: they state only what was tested."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from seatrial.api.messages import in_python
from seatrial.ident.data.record import Record
from seatrial.ident.diagnosis import ModelUncertainty
from seatrial.ident.effects import catalogue
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import fit
from seatrial.ident.estimation.stochastic_simulation import simulate_stochastic
from seatrial.ident.model.outlier_density import with_outlier_model
from seatrial.ident.model.parameter import Parameter, ParameterOrigin
from seatrial.ident.model.structure import Effect, ModelKind
from seatrial.ident.models import horizontal_model
from seatrial.ident.models.nomoto import nomoto_model
from seatrial.ident.results.answers import (
    NAMES,
    antenna_warnings,
    candidate_sentence,
    change_sentence,
    check_warnings,
    course_sentence,
    estimation_warnings,
    faults_first,
    late_sensor_warnings,
    not_converged,
    outlier_lines,
    plus_minus,
    position_drift_notes,
    short_data_warnings,
    smallest_command,
    straight_sentence,
    stuck_sensors,
    thrust_ahead_warnings,
    thrust_astern_warnings,
    thruster_answer,
    unusual_estimates,
    vehicle_answer,
    warm_up_notes,
    wind_sentence,
)
from seatrial.ident.results.parts import (
    CourseStability,
    CrossCorrelationRow,
    Dynamics,
    ErrorComparison,
    Errors,
    ErrorTable,
    HeadingPoint,
    LargestErrorsRow,
    LogFinding,
    LogSummary,
    OperatingPoint,
    PredictionChangeRow,
    PredictionFit,
    Provenance,
    ResidualTests,
)
from seatrial.ident.results.tables import (
    cross_rows,
    format_number,
    model_uncertainty_notes,
    prediction_change,
    residual_row,
    sides_compare_mass,
    thrust_difference_warnings,
)
from seatrial.ident.studies.cases import make_case
from seatrial.ident.studies.monte_carlo import make_record
from seatrial.ident.validation.evaluation import residual_tests
from seatrial.ident.validation.prediction_errors import ChannelChange
from seatrial.ident.validation.prediction_errors import PredictionChange as Found
from seatrial.ident.validation.whiteness import Whiteness
from tests.ident.toys import turning, turning_record


def test_dead_zone_is_stated_down_to_the_smallest_tested_command() -> None:
    """Steps of 20 % and more, reached by ramps, give no information about smaller commands."""
    n = np.repeat([0.0, 0.1, 0.2, -0.2, 0.5, 0.0], [50, 1, 50, 50, 50, 50])[:, None]
    t = 0.02 * np.arange(len(n))
    tried = smallest_command([Record("bench", t, n, n, np.zeros((len(n), 0)), ("n_cmd_0",), ())])
    assert tried == 0.2
    for d, message in ((0.0, "and has no dead zone above the smallest command tried, 20 %;"),
                    (0.25, "and does not turn below 25.0 % of full command;")):  # fmt: skip
        known = {"a": 5.0, "tau": 0.1, "d": d}
        fitted: Any = SimpleNamespace(estimate=lambda name, known=known: (known[name], 0.0))
        assert message in thruster_answer(fitted, has_force=False, smallest=tried)


def test_finding_of_many_logs_is_reported_once() -> None:
    finding = LogFinding(level="warning", code="channel-smoothed", check="noise", where="psi", text="it is smooth")
    logs = [
        LogSummary(path=f"{k}.mcap", sha256="", role="estimation", name=str(k), duration=1.0, findings=(finding,))
        for k in range(11)
    ]
    made = Provenance(created="", seatrial="", command="", logs=tuple(logs))
    assert check_warnings(made, besides=("channel-smoothed",)) == []  # a diagnosis does not repeat it
    (warning,) = check_warnings(made)
    assert warning.code == "log-check"
    assert warning.text.startswith("0.mcap, 1.mcap, 2.mcap")
    assert "more: psi: it is smooth [channel-smoothed]" in warning.text


def test_finding_of_other_channels_in_another_log_is_reported_once() -> None:
    smooth = LogFinding(level="fault", code="smooth", check="noise", where="r", text="it is smooth", spoils=True)
    channels = {"1.mcap": ("psi", "r"), "2.mcap": ("r",), "3.mcap": ("psi", "r")}
    logs = [
        LogSummary(
            path=path, sha256="", role="estimation", name=path, duration=1.0,
            findings=tuple(msgspec.structs.replace(smooth, where=name) for name in names),
        )
        for path, names in channels.items()
    ]  # fmt: skip
    made = Provenance(created="", seatrial="", command="", logs=tuple(logs))
    (warning,) = check_warnings(made)
    assert warning.text == "1.mcap, 3.mcap: psi, r; 2.mcap: r: it is smooth [smooth]."
    # Neither does the answer of a fit to logs with faults repeat it.
    answer = faults_first(made)
    assert "(1.mcap: psi [smooth]; 1.mcap: r [smooth]; 2.mcap: r [smooth]; " in answer
    assert "it is smooth" not in answer


def test_the_answer_names_the_strongest_candidate_of_the_score_tests() -> None:
    none = ModelUncertainty((), (), np.zeros((0, 0)), np.zeros((0, 0)), 0.0, np.zeros(0))
    assert candidate_sentence(None) == candidate_sentence(none) == ""
    text = candidate_sentence(replace(none, strongest="wind"))
    assert text.startswith(
        "The strongest candidate of the score tests is steady wind (wind): `seatrial ident diagnose`"
    )
    assert "m_v differs between the runs:" in candidate_sentence(replace(none, strongest="between-runs:m_v"))
    assert "`st.diagnose`" in in_python(text)


def test_the_note_on_missing_effects_names_a_value_of_one_log_as_the_tables_do() -> None:
    """The note had V_y@1 and the table V_y@spring_1, which is the number 0."""
    found = ModelUncertainty(("m_u", "V_y@1"), ("wind",), np.zeros((1, 2)), np.diag([0.0, 3.0]), 0.1, np.zeros(2))
    rows = (SimpleNamespace(name="m_u", segment=None), SimpleNamespace(name="V_y", segment=1))
    fit: Any = SimpleNamespace(
        names=("m_u", "V_y@1"), errors=np.array([1.0, 2.0]), parameters=rows, records=("spring_1", "spring_2")
    )
    (note,) = model_uncertainty_notes(found, fit)
    assert note.endswith("it increases them most by these factors: V_y@spring_2 2.")


def made_of(*logs: tuple[str, str | None]) -> Provenance:
    """Return the provenance of a result of logs with a role and a start time each."""
    rows = [
        LogSummary(path=f"{k}.mcap", sha256="", role=role, name=str(k), duration=60.0, start=start)
        for k, (role, start) in enumerate(logs)
    ]
    return Provenance(created="", seatrial="", command="", logs=tuple(rows))


def test_one_wind_for_logs_of_different_days_is_named_with_the_way_to_separate_it() -> None:
    morning, afternoon, later = (f"2025-05-{t}:00:00+00:00" for t in ("06T08", "06T10", "09T08"))
    windy = horizontal_model() + catalogue()["wind"]
    days = made_of(("estimation", morning), ("estimation", later))
    text = wind_sentence(days, windy)
    assert "one value for all logs, but they begin up to 3 days apart" in text
    assert "`seatrial ident vehicle LOGS --effect wind --test-homogeneity F_wx --test-homogeneity F_wy`" in text
    assert text.endswith("give each log its own wind: --per-log F_wx --per-log F_wy.")
    own = windy.replace_parameters(*(replace(windy.parameter(n), per_record=True) for n in ("F_wx", "F_wy")))
    assert wind_sentence(days, own) == ""
    assert wind_sentence(days, horizontal_model()) == ""
    same_day = made_of(("estimation", morning), ("estimation", afternoon))
    assert wind_sentence(same_day, windy) == ""
    assert wind_sentence(made_of(("estimation", morning), ("validation", later)), windy) == ""
    undated = made_of(("estimation", "1970-01-01T00:00:00+00:00"), ("estimation", morning), ("estimation", None))
    assert wind_sentence(undated, windy) == ""


@pytest.mark.parametrize(
    ("level", "code", "n"),
    [
        ("fault", "sensor-late", 1),
        ("fault", "clock-step", 1),
        ("warning", "sensor-late", 0),
        ("fault", "two-sensors", 0),
    ],
)
def test_late_sensor_warning_names_the_biased_parameters(level: str, code: str, n: int) -> None:
    finding = LogFinding(level=level, code=code, check="late", where="vx", text="velocity comes 0.88 s after heading")
    log = LogSummary(path="a.mcap", sha256="", role="estimation", name="a", duration=1.0, findings=(finding,))
    made = Provenance(created="", seatrial="", command="", logs=(log,))
    model = horizontal_model("shaft")
    warnings = late_sensor_warnings(made, model.replace_parameters(model.parameter("d_u").fixed()))
    assert len(warnings) == n
    for warning in warnings:
        assert warning.code == "late-sensor-bias"
        assert "m_u, m_v, m_r" in warning.text
        assert "d_u," not in warning.text
        assert "c1" not in warning.text


WHITE = (
    "The residuals one step ahead are white and uncorrelated with the inputs, by Ljung-Box, periodogram and "
    "cross-correlation tests"
)


def residual_sentence(
    residuals: list[float],
    cross: list[tuple[str, float]],
    channels: str = "x",
    correlations: list[float] | None = None,
    searchable: bool = False,
) -> str:
    none = np.empty(0)
    rows = [
        ResidualTests(
            record="r",
            channel="x",
            unit="m",
            t=none,
            e=none,
            lags=none,
            acf=none,
            band=0.1,
            ljung_box_p=p,
            periodogram_p=0.5,
            frequency=none,
            cumulative=none,
            normal_p=0.5,
            white=p > 0.01,
            outliers=0,
            largest=3.0,
        )
        for p in residuals
    ]
    with_inputs = [
        CrossCorrelationRow(record="r", channel="x", input=name, lags=none, z=none, p=p, largest=largest)
        for (name, p), largest in zip(cross, correlations or [None] * len(cross), strict=True)
    ]
    one_step = dict.fromkeys(channels, ErrorComparison(after=1.0, unit="m"))
    errors = Errors(estimation=ErrorTable(one_step=one_step, horizon={}, simulation={}))
    return vehicle_answer(None, errors, 10.0, rows, with_inputs, searchable=searchable)


RATIOS = st.floats(0.01, 100.0) | st.floats(0.98, 1.02)
CHANNELS = st.dictionaries(st.sampled_from(sorted(NAMES)), st.tuples(RATIOS, RATIOS, RATIOS), min_size=1)


def correlated(channel: str, acf: float, *, white: bool = False, after: ResidualTests | None = None) -> ResidualTests:
    """Return the residual tests of a channel with a largest autocorrelation of ``acf``."""
    none = np.zeros(0)
    return ResidualTests(
        record="run", channel=channel, unit="m", t=none, lags=np.array([0.2, 0.4]), band=0.05, frequency=none,
        e=none, acf=np.array([0.01, -acf]), ljung_box_p=0.0, periodogram_p=0.5, cumulative=none, normal_p=0.5,
        white=white, outliers=0, largest=2.0, after=after,
    )  # fmt: skip


def test_a_drift_of_the_position_is_no_missing_effect() -> None:
    """A p value of 1e-164 of the positions stood in the report without a word on its cause."""
    still = (correlated("vx", 0.04, white=True), correlated("vy", 0.1))
    rows = (correlated("x", 0.38), correlated("y", 0.31), correlated("psi", 0.5), *still)
    (note,) = position_drift_notes(rows, coloured=True)
    assert "position one step ahead are autocorrelated (up to 0.38), those of the velocity less (up to 0.1)." in note
    assert note.endswith(
        "as white; the standard errors are the robust ones where these are larger, which allow for it."
    )
    assert "robust" not in position_drift_notes(rows, coloured=False)[0]
    assert "those of the velocity not." in position_drift_notes((rows[0], still[0]), coloured=True)[0]
    moving = correlated("vx", 0.25)
    for others in (
        (*rows, moving),
        rows[:3],
        (correlated("x", 0.15), *still),
        (correlated("x", 0.4, white=True), *still),
    ):
        assert position_drift_notes(others, coloured=True) == []
    # Of a diagnosis the tests with the effects count.
    assert position_drift_notes((*rows, correlated("vx", 0.25, after=still[0])), coloured=True) == [note]
    validation = msgspec.structs.replace(rows[0], role="validation")
    assert position_drift_notes((validation, *still), coloured=True) == []


def in_order(numbers: tuple[float, float, float], known: bool) -> tuple[float, float, float]:
    """Return ratio, low and high."""
    low, ratio, high = sorted(numbers)
    return (ratio, low, high) if known else (ratio, float("nan"), float("nan"))


@given(st.tuples(RATIOS, RATIOS, RATIOS), CHANNELS, st.booleans(), st.sampled_from([1.0, 2.5, 10.0]))
def test_sentence_reports_a_change_only_beyond_its_interval(
    numbers: tuple[float, float, float],
    channels: dict[str, tuple[float, float, float]],
    known: bool,
    horizon: float,
) -> None:
    each = {n: ChannelChange(*in_order(x, known), before=1.0, after=1.0) for n, x in channels.items()}
    found = Found(*in_order(numbers, known), horizon, each)
    change = prediction_change(found, "validation")
    assert change is not None
    sentence = change_sentence(change, horizon)
    head = sentence.split("; ")[0]
    if re.search(r"falls|fell|better|improve|less|smaller", head):
        assert found.high < 1.0
        assert not re.search(r"by 0 %", head)
    if re.search(r"rises|worse|times as large", head):
        assert found.low > 1.0
        assert not re.search(r"by 0 %", head)
    assert ("significant" in head) == (known and change.verdict == "unchanged")
    assert all(each[n].high < 1.0 for n in change.better)
    assert all(each[n].low > 1.0 for n in change.worse)
    assert ("better: " in sentence) == bool(change.better and known)
    assert ("worse: " in sentence) == bool(change.worse and known)
    assert "nan" not in sentence
    assert sentence.startswith(f"Prediction {horizon:g} s ahead on validation data, all channels: ")


def test_change_is_reported_with_its_interval_and_channels() -> None:
    change = PredictionChangeRow(
        role="validation", ratio=0.58, low=0.54, high=0.63, verdict="fell", better=("psi", "x"), worse=("ax",)
    )
    left_out = change_sentence(change, 10.0, cross_validated=True)
    assert left_out.startswith(
        "Prediction 10 s ahead on blocks of the logs that were left out of the fit, all channels: "
    )
    assert change_sentence(change, 10.0) == (
        "Prediction 10 s ahead on validation data, all channels: with the added effects the error falls by 42 % (95 % "
        "interval: 37 to 46 %); better: heading, position north; worse: surge specific force."
    )
    rose = msgspec.structs.replace(change, ratio=1.12, low=1.05, high=1.2, verdict="rose", better=(), worse=("ax",))
    assert "rises by 12 % (95 % interval: 5 to 20 %); worse: surge" in change_sentence(rose, 10.0)
    same = msgspec.structs.replace(change, ratio=0.97, low=0.9, high=1.05, verdict="unchanged", better=(), worse=())
    assert (
        "no significant change of the error with the added effects (-3 %; 95 % interval: -10 to +5 %)."
        in change_sentence(same, 10.0)
    )
    nearly = change_sentence(msgspec.structs.replace(same, ratio=0.57, low=0.32, high=1.01), 10.0)
    assert nearly.endswith(
        "(-43 %; 95 % interval: -68 to +1 %). The error is probably smaller with the effects: a shorter horizon "
        "(--horizon 5) or more logs can decide."
    )
    for ratio, high in ((0.57, 1.06), (0.97, 1.01)):  # an end far from no change, and a small change
        other = msgspec.structs.replace(same, ratio=ratio, low=0.3, high=high)
        assert "probably" not in change_sentence(other, 10.0)
    little = msgspec.structs.replace(same, ratio=0.996, low=0.991, high=0.9996, verdict="fell")
    assert "falls by 0.4 % (95 % interval: 0.0 to 0.9 %)." in change_sentence(little, 10.0)
    least = msgspec.structs.replace(same, ratio=0.9999, low=0.98, high=1.02)
    assert "(+0.0 %; 95 % interval: -2.0 to +2.0 %)" in change_sentence(least, 10.0)
    short = msgspec.structs.replace(change, low=None, high=None, verdict="unchanged", better=(), worse=())
    assert change_sentence(short, 1.0).endswith(
        "the data are too short to tell whether the added effects change the error; give longer validation logs."
    )
    lost = msgspec.structs.replace(change, ratio=50.0, low=20.0, high=90.0, verdict="rose")
    assert "is 50 times as large (95 % interval: 20 to 90)" in change_sentence(lost, 1.0)
    far = msgspec.structs.replace(lost, ratio=120.0, low=99.6, high=150.0)
    assert "is 120 times as large (95 % interval: 100 to 150)" in change_sentence(far, 1.0)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (99.4, "99"),
        (99.6, "100"),
        (-99.6, "-100"),
        (113.2, "113"),
        (9.96, "10"),
        (8.4, "8.4"),
        (0.0312, "0.031"),
    ],
)
def test_number_in_a_sentence_has_two_digits_and_no_exponent_below_a_hundred(value: float, text: str) -> None:
    assert format_number(value) == text


@pytest.mark.parametrize(("horizon", "words"), [(10.0, "10 s"), (1.0, "1 s"), (2.5, "2.5 s")])
def test_fit_of_all_channels_comes_first(horizon: float, words: str) -> None:
    far = {n: ErrorComparison(after=e, unit="", spread=1.0) for n, e in (("x", 0.01), ("ax", 0.9))}
    errors = Errors(estimation=ErrorTable(one_step={}, horizon=far, simulation={}))
    fitted = PredictionFit(role="estimation", fit=0.905, low=0.88, high=0.92)
    answer = vehicle_answer(fitted, errors, horizon, [], [], searchable=True)
    assert answer.startswith(
        f"Prediction {words} ahead on estimation data, all channels: fit 90 % (95 % interval: 88 to 92 %). It "
        "is 1 - geometric mean of error / standard deviation of 2 channels. Best channel: "
        "99 % (position north); worst: 10 % (surge specific force).\n"
    )
    worst = LargestErrorsRow(record="morning", begin=20.0, end=40.0, share=0.61)
    wide = PredictionFit(role="estimation", fit=0.78, low=-17.65, high=1.0, largest_errors=worst)
    assert (
        "fit 78 % (without a useful 95 % interval). 61 % of the squared errors are from 20 to 40 s of morning; look "
        in (vehicle_answer(wide, errors, horizon, [], [], searchable=True))
    )
    far["ax"] = ErrorComparison(after=None, unit="", spread=1.0)
    assert "all channels: it diverges (surge" in vehicle_answer(fitted, errors, horizon, [], [], searchable=True)


def test_a_simulation_that_is_much_worse_than_the_prediction_is_stated() -> None:
    """A fit of 89 % over 10 s was the whole headline of a model whose simulation was 10 m and 30 deg wrong."""
    units = {"psi": "rad", "x": "m", "r": "rad/s"}
    ahead = {n: ErrorComparison(after=0.1, unit=unit, spread=1.0) for n, unit in units.items()}
    fitted = PredictionFit(role="estimation", fit=0.89, low=0.85, high=0.92)

    def answer(**simulated: float | None) -> str:
        rows = {n: ErrorComparison(after=e, unit=units[n], spread=1.0) for n, e in simulated.items()}
        errors = Errors(estimation=ErrorTable(one_step={}, horizon=ahead, simulation=rows))
        return vehicle_answer(fitted, errors, 10.0, [], [], searchable=True)

    assert (
        " The simulation of the whole runs by the inputs alone is much worse: its errors are 4 times those 10 s ahead "
        "(geometric mean of all channels), most in position north, 1.6 m in place of 0.10 m (rms).\nThere are too few"
    ) in answer(psi=0.4, x=1.6, r=0.1)
    assert "most in heading, 92 deg in place of 5.7 deg (rms)" in answer(psi=1.6, x=0.4)
    assert "simulation" not in answer(psi=0.2, x=0.4, r=0.1)  # twice as large
    assert "by the inputs alone diverges (heading): do not use" in answer(psi=None, x=0.1)


def test_untested_residuals_are_not_called_white() -> None:
    assert residual_sentence([], []) == (
        "There are too few samples to test whether the residuals are white; record at least 60 samples of a channel."
    )
    assert residual_sentence([0.4], [], "xy") == f"{WHITE} (too few samples to test: y)."


def test_white_residuals_are_white_by_tests_that_an_effect_can_pass() -> None:
    hidden = "Disturbance forces can still hide an effect: `seatrial ident diagnose` tests for it."
    assert residual_sentence([0.4], [], searchable=True) == f"{WHITE}. {hidden}"


def test_many_tests_are_corrected_for_their_number() -> None:
    assert residual_sentence([0.004] + [0.5] * 7, [("n", 0.002)] + [("n", 0.5)] * 15) == f"{WHITE}."
    assert residual_sentence([0.004], []).startswith("The residuals are not white")
    assert residual_sentence([0.5], [("n", 0.002)]).startswith("The residuals are correlated with the inputs")
    assert residual_sentence([1e-5] + [0.5] * 7, []).startswith("The residuals are not white")


def test_correlation_with_an_input_is_quantified() -> None:
    """A long record shows correlations that do not matter. Autocorrelated noise of a filter does not prove a missing
    effect.
    """
    known = residual_sentence(
        [0.5], [("n", 1e-9), ("m", 1e-5), ("k", 0.5)], correlations=[0.04, 0.071, 0.3], searchable=True
    )
    assert known == (
        "The residuals are correlated with the inputs (correlation up to 0.071, position north): run `seatrial ident "
        "diagnose` to see whether an effect is missing."
    )
    assert residual_sentence([1e-9], [], searchable=True).endswith("to see whether an effect is missing.")
    assert residual_sentence([1e-9], []).endswith(
        ": an effect is missing, or the noise of a sensor is autocorrelated. Look at the residuals in the report, or "
        "try another --model."
    )


def test_correlation_with_a_measured_input_is_reported_separately() -> None:
    assert "correlated with phi and theta, which the model uses as measured inputs" in residual_sentence(
        [0.5], [("theta", 1e-9), ("phi", 1e-9)]
    )
    assert residual_sentence([0.5], [("theta", 1e-9), ("n_left", 1e-9)]).startswith(
        "The residuals are correlated with the inputs"
    )


@pytest.mark.study
def test_residuals_of_the_right_model_are_called_white() -> None:
    """The parameters are true, with eight channels and two inputs. Each sentence may be wrong in 1 %."""
    case, trials = make_case("horizontal"), 60
    values = np.tile(list(case.model.values.values()), (trials, 1))
    _, y = simulate_stochastic(case.model, case.inputs, values, [np.random.default_rng([9, k]) for k in range(trials)])
    likelihood, answers = Likelihood(case.model), []
    errors = Errors(estimation=ErrorTable(one_step={}, horizon={}, simulation={}))
    for k in range(trials):
        record = make_record(case, y[k], "r")
        found = residual_tests(case.model, record, likelihood.filter(record, values[k]).standardised)
        residuals = [residual_row(r) for r in found]
        cross = [row for r in found for row in cross_rows(r)]
        answers.append(vehicle_answer(None, errors, 10.0, residuals, cross, searchable=False))
    assert len(residuals) == 8
    # On average 1.2 are expected. More than four have a chance of one in 150.
    assert sum(not a.startswith(WHITE) for a in answers) <= 4


def constant() -> Record:
    record = turning_record(n_rows=200)
    y = record.y.copy()
    y[:, 0] = np.where(np.isfinite(y[:, 0]), 0.5, np.nan)
    return replace(record, y=y)


def test_stuck_sensor_is_reported() -> None:
    record = constant()
    (line,) = stuck_sensors([record])
    n = int(np.isfinite(record.y[:, 0]).sum())
    assert line.code == "stuck-sensor"
    text = f"run: {record.outputs[0]} reads 0.5 in all of its {n} samples: the sensor may be stuck. "
    assert line.text == f"{text}Check it, or leave this signal out of the rig file or import map."
    assert stuck_sensors([turning_record(n_rows=200)]) == []


def test_channels_without_information_are_left_out() -> None:
    model, record = turning(), turning_record(n_rows=200)
    eps = np.random.default_rng(0).normal(size=record.y.shape)
    eps[:, 0] = 0.0
    eps[40:, 1] = np.nan
    found = residual_tests(model, record, eps)
    kept = {o.name for o in model.outputs[2:]}
    assert {r.channel for r in found} == {c.channel for r in found for c in r.inputs} == kept


def test_outliers_are_reported() -> None:
    model, record = turning(), turning_record(n_rows=300)
    eps = np.random.default_rng(0).normal(size=record.y.shape)
    eps[[20, 60, 90], 1] = (16.0, -9.0, 6.5)
    found = residual_tests(model, record, eps)
    spikes = {r.channel: (r.tests.outliers, r.tests.largest) for r in found}
    assert spikes[model.outputs[1].name] == (3, 16.0)
    assert sum(n for n, _ in spikes.values()) == 3
    (line,) = outlier_lines(found, model)
    assert line.startswith("Some innovations are beyond 6 standard deviations")
    assert f" run: {model.outputs[1].name} 3 of 300 (the largest at" in line
    assert outlier_lines(found, with_outlier_model(model)) == []


@pytest.mark.parametrize(("p", "white"), [(0.007, True), (0.004, False)])
def test_both_whiteness_tests_together_have_a_level_of_one_percent(p: float, white: bool) -> None:
    none = np.empty(0)
    for tests in ((p, 0.5), (0.5, p)):
        assert Whiteness("x", 9, 0.0, 1.0, none, 0.1, *tests, none, none, 0.5, 0, 2.0).white == white


def test_fit_that_did_not_converge_has_no_other_answer() -> None:
    found = fit(turning().with_free(("m", "d")), [turning_record(n_rows=300)], start={"m": 15.0})
    assert not_converged(found) is None
    short = replace(
        found,
        converged=False,
        message="stopped after 60 iterations; its estimates can still move by 36 standard errors",
    )
    answer = not_converged(short)
    assert answer is not None
    assert answer.startswith(
        "The fit did not converge: it stopped after 60 iterations; its estimates can still move by 36 standard errors. "
    )


def test_advice_on_a_turn_rate_without_a_lag_names_its_time_constant() -> None:
    """T of Nomoto's model is zero without a prior, and no boat answers at once."""
    failed = SimpleNamespace(converged=False, message="stopped after 60 iterations", model=nomoto_model())
    answer = not_converged(failed)  # type: ignore[arg-type]
    assert answer is not None
    assert "T is fixed at zero: free it by --prior T=0.5:0.5" in answer
    freed = nomoto_model().replace_parameters(replace(nomoto_model().parameter("T"), free=True))
    answer = not_converged(SimpleNamespace(**vars(failed) | {"model": freed}))  # type: ignore[arg-type]
    assert answer is not None
    assert "--prior T" not in answer


def test_answer_states_that_the_fit_stopped_close_to_its_maximum() -> None:
    records = [turning_record(n_rows=300)]
    found = fit(turning().with_free(("m", "d")), records, start={"m": 15.0})
    assert not [w for w in estimation_warnings(found, records) if w.code == "nearly-converged"]
    near = estimation_warnings(replace(found, gain_left=0.045), records)  # 0.3 standard errors
    assert not [w for w in near if w.code == "nearly-converged"]
    warning = estimation_warnings(replace(found, gain_left=0.18), records)[-1]
    assert warning.code == "nearly-converged"
    assert "can still move by 0.6 standard errors" in warning.text


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (40.7832, 0.029, "40.783 ± 0.029"),
        (40.7832, float("inf"), "40.8 ± inf"),
        (40.7832, float("nan"), "40.8 ± nan"),
        (float("inf"), 0.029, "inf ± 0.029"),
    ],
)
def test_value_with_an_error_that_is_not_finite_is_still_a_text(value: float, error: float, text: str) -> None:
    assert plus_minus(value, error) == text


GROWS = "without a controller a small yaw rate grows by a factor of e in"


@pytest.mark.parametrize(
    ("pole", "low", "high", "sentence"),
    [
        (-0.1, -0.3, 0.1, ""),
        (0.25, 0.2, 0.3125, f": {GROWS} 4 s (95 % interval: 3.2 to 5 s)."),
        (
            *(0.02, -0.1, 0.125),
            "At 0.9 m/s the directional stability is not shown by the data: without a controller a small yaw rate may "
            "grow by a factor of e in 8 s or decay in 10 s (95 % interval). To find out, record short turns to both "
            "sides at this speed, and equal inputs of both sides for some seconds after each.",
        ),
        (0.02, None, None, f": {GROWS} 50 s (the 95 % interval is unknown)."),
    ],
)
def test_sentence_on_a_directionally_unstable_boat(
    pole: float, low: float | None, high: float | None, sentence: str
) -> None:
    begin = "At 0.9 m/s the boat is directionally unstable" if sentence.startswith(":") else ""
    assert course_sentence(CourseStability(speed=0.9, pole=pole, low=low, high=high)) == begin + sentence
    assert course_sentence(None) == ""
    known = {
        -0.1: "not shown by the data",
        0.25: "unstable",
        0.02: "unstable" if low is None else "not shown by the data",
    }
    assert CourseStability(speed=0.9, pole=pole, low=low, high=high).stability == known[pole]
    negative = CourseStability(speed=0.9, pole=pole, low=low, high=high, sway=0.02)
    assert course_sentence(negative).startswith("At 0.9 m/s the estimated damping of sway is negative, which no hull")
    lowest = course_sentence(CourseStability(speed=0.9, pole=pole, low=low, high=high, sway=-0.02, sway_from=0.451))
    assert lowest.startswith("From 0.45 m/s on the estimated damping of sway is negative, which no hull")
    assert "with this model at these speeds; record turns at them." in lowest
    assert course_sentence(CourseStability(speed=0.9, pole=pole, low=low, high=high, sway=-0.02)) == begin + sentence


@pytest.mark.parametrize(
    ("origin", "c2", "error", "warned"),
    [
        (ParameterOrigin.PRIOR, 0.93, 0.3, True),
        (ParameterOrigin.GIVEN, -0.93, 0.3, True),
        (ParameterOrigin.PRIOR, 0.93, 0.6, False),  # not significant
        (ParameterOrigin.PRIOR, 0.3, 0.01, False),  # less than 5 % of c1
        (ParameterOrigin.MEASURED, 0.93, 0.3, False),  # the bench test has both directions
    ],
)
def test_thrust_that_may_be_that_ahead_is_reported(
    origin: ParameterOrigin, c2: float, error: float, warned: bool
) -> None:
    estimates = {"c1": (6.84, 0.1), "c2": (c2, error)}
    parameters = (Parameter("c1", 6.84, "N", origin=origin), Parameter("c2", c2, "N", origin=ParameterOrigin.ESTIMATED))
    fit: Any = SimpleNamespace(model=SimpleNamespace(parameters=parameters), estimate=estimates.__getitem__)
    found = thrust_ahead_warnings(fit)
    assert [w.code for w in found] == ["thrust-ahead"] * warned
    if warned and c2 > 0.0:
        assert "is 7.77 N ahead and 5.91 N astern by this fit; c1, which was given as 6.84 N, is the" in found[0].text
        assert "give the half difference too (--prior c2=0.93:0.3)" in found[0].text
        assert "If 6.84 N was measured ahead only, the thrust astern is about 5.2 N by these data" in found[0].text
        assert "--prior c1=6.02:0.3 --prior c2=0.819:0.26" in found[0].text
        given = [
            replace(p, value=v, origin=ParameterOrigin.GIVEN) for p, v in zip(parameters, (6.02, 0.82), strict=True)
        ]
        again: Any = SimpleNamespace(model=SimpleNamespace(parameters=given), estimate=estimates.__getitem__)
        assert not thrust_ahead_warnings(again)  # a reader who follows the advice is not asked again
        assert not thrust_ahead_warnings(fit, 7.77)  # the thrust ahead was given, and the fit has it
        (doubt,) = thrust_ahead_warnings(fit, 10.0)
        assert doubt.code == "thrust-ahead"
        assert "The thrust ahead was given as 10 N, and this fit has 7.77 N (c1 + c2): masses" in doubt.text
        assert "`ahead = 10` and `astern = 7.61`" in doubt.text


@pytest.mark.parametrize(("c1", "c2", "warned"), [(239.0, 179.0, True), (209.0, 30.0, False), (40.0, -25.0, True)])
def test_thrust_astern_that_was_given_as_c2_is_reported(c1: float, c2: float, warned: bool) -> None:
    model = horizontal_model("shaft")
    own = [replace(p, value=v, origin=ParameterOrigin.GIVEN) for p in model.parameters
           for n, v in (("c1", c1), ("c2", c2)) if p.name == n]  # fmt: skip
    fit: Any = SimpleNamespace(model=model.replace_parameters(*own))
    found = thrust_astern_warnings(fit)
    assert [w.code for w in found] == ["thrust-astern"] * warned
    if c1 == 239.0:
        assert "c2 = 179 N are 418 N ahead (c1 + c2) and 60 N astern (c1 - c2)" in found[0].text
        assert found[0].text.endswith("239 N is the thrust ahead and 179 N that astern, give c1 = 209 and c2 = 30.")
    fit.model = model.replace_parameters(own[0])  # c2 is estimated
    assert thrust_astern_warnings(fit) == []


@pytest.mark.parametrize(("value", "warned"), [(4.1, True), (0.5, False), (0.02, True)])
def test_estimate_far_from_its_usual_size_is_reported(value: float, warned: bool) -> None:
    k_air = next(p for p in catalogue()["wind"].parameters if p.name == "k_air")
    fit: Any = SimpleNamespace(
        model=SimpleNamespace(effects=(catalogue()["wind"],)), parameters=(k_air,), values=np.array([value])
    )
    found = unusual_estimates(fit)
    assert [w.code for w in found] == ["unusual-estimate"] * warned
    if value == 4.1:
        assert "k_air = 4.1 N s2/m2" in found[0].text
    fit.parameters = (replace(k_air, origin=ParameterOrigin.PRIOR),)
    assert not unusual_estimates(fit)


def record_of(name: str, seconds: float) -> Record:
    """Return a record without signals that lasts some seconds."""
    t = np.arange(0.0, seconds + 0.05, 0.1)
    none = np.zeros((t.size, 0))
    return Record(name, t, none, none, none, (), ())


@pytest.mark.parametrize(
    ("estimation", "validation", "messages"),
    [
        ((300.0,), (), []),
        ((40.0, 21.0), (15.0,), []),
        (
            (8.0,),
            (),
            [
                "The log has 8 s in all: this is too short for the slow motions of a boat",
                "Too short for the horizon of 10 s, and without predictions over it: e0 (estimation data, at most 8 s)",
            ],
        ),
        ((20.0, 21.0), (200.0,), ["The logs have 41 s in all: "]),
        (
            (300.0, 5.0),
            (9.0, 60.0, 7.0),
            ["and without predictions over it: v0, v2 (validation data, at most 9 s)."],
        ),
    ],
)
def test_short_logs_are_reported(
    estimation: tuple[float, ...], validation: tuple[float, ...], messages: list[str]
) -> None:
    fitted: Any = SimpleNamespace(
        records=[record_of(f"e{k}", s) for k, s in enumerate(estimation)],
        validation=[SimpleNamespace(record=record_of(f"v{k}", s)) for k, s in enumerate(validation)],
        cross_validated=False,
        model=SimpleNamespace(kind=ModelKind.VEHICLE),
    )
    found = short_data_warnings(fitted, 10.0)
    assert [w.code for w in found] == ["short-data"] * len(messages)
    for warning, message in zip(found, messages, strict=True):
        assert message in warning.text


def test_short_simulations_say_how_much_they_cover() -> None:
    """The errors leave out the filtering before a simulation, and thus most of a short record."""
    assert warm_up_notes([("long", 59.9)]) == []
    (text,) = warm_up_notes([("a", 27.0), ("b", 300.0), ("c", 40.0), ("c", 20.0), ("d", 9.0)])
    assert text == (
        "The errors of the simulation leave out the 15 s of filtering before it: they cover 12 of 27 s of a, 5 of 20 s "
        "of c, 0 of 9 s of d. What the boat does before is not in them."
    )
    (text,) = warm_up_notes([("a[0:27.1]", 27.0), ("b[0:30]", 30.0), ("a[27.1:54]", 26.0), ("a[54:80]", 26.0)])
    assert "they cover 11 of 26 s of each of 3 blocks of a, 15 of 30 s of b[0:30]." in text
    (text,) = warm_up_notes([("a", 27.0)], ModelKind.BENCH)
    assert text.endswith("12 of 27 s of a. What the thruster does before is not in them.")


@pytest.mark.parametrize(("seconds", "n"), [(12.0, 1), (30.0, 0)])
def test_short_bench_runs_are_reported(seconds: float, n: int) -> None:
    model = SimpleNamespace(kind=ModelKind.BENCH)
    fitted: Any = SimpleNamespace(records=[record_of("e", seconds)], validation=[], cross_validated=False, model=model)
    found = short_data_warnings(fitted, 1.0)
    assert ["this is too short for the steps of a bench run" in w.text for w in found] == [True] * n


@pytest.mark.parametrize(
    ("inputs", "conditions", "sentence"),
    [
        (
            {"n_left": 0.4357, "n_right": 0.4941},
            {"psi": 0.5236},
            "With equal shaft speeds the boat turns to starboard: to go straight at 0.78 m/s, it needs n_left 0.436 "
            "and n_right 0.494.",
        ),
        (
            {"f_left": 12.34, "f_right": 10.0},
            {},
            "With equal thrusts the boat turns to port: to go straight at 0.78 m/s, it needs f_left 12.3 N and f_right "
            "10 N.",
        ),
        ({"n_cmd_left": 0.5, "n_cmd_right": 0.51}, {}, ""),
        ({"n": 0.5}, {}, ""),
    ],
)
def test_answer_has_the_inputs_of_a_straight_course(
    inputs: dict[str, float], conditions: dict[str, float], sentence: str
) -> None:
    none = np.zeros(0)
    point = OperatingPoint(speed=0.78, inputs=inputs, real=none, imaginary=none, stable=True, error=none)
    faster = msgspec.structs.replace(point, speed=1.5, inputs=dict.fromkeys(inputs, 1.0))
    assert straight_sentence(Dynamics(points=(point, faster), conditions=conditions)) == sentence
    assert straight_sentence(None) == straight_sentence(Dynamics()) == ""


@pytest.mark.parametrize(
    ("differences", "turns", "inputs"),
    [
        (
            (-0.2, 0.1, 0.0),
            "to starboard on some headings and to port on others",
            "from n_left 0.6 and n_right 0.4 (heading 0 deg) to n_left 0.45 and n_right 0.55 (heading 90 deg)",
        ),
        (
            (-0.2, -0.1, 0.0),
            "to port, more on some headings than on others",
            "from n_left 0.6 and n_right 0.4 (heading 0 deg) to n_left 0.5 and n_right 0.5 (heading 180 deg)",
        ),
        ((0.01, -0.01, 0.0), "", ""),
    ],
)
def test_answer_has_the_headings_on_which_a_boat_in_wind_needs_most(
    differences: tuple[float, ...], turns: str, inputs: str
) -> None:
    sentence = f"With equal shaft speeds the boat turns {turns}: to go straight at 0.8 m/s, it needs {inputs}."
    none = np.zeros(0)
    point = OperatingPoint(speed=0.8, inputs={"n_left": 0.5, "n_right": 0.5}, real=none, imaginary=none, stable=True)
    headings = tuple(
        HeadingPoint(heading=0.5 * np.pi * k, speed=0.8, inputs={"n_left": 0.5 - d / 2, "n_right": 0.5 + d / 2})
        for k, d in enumerate(differences)
    )
    found = straight_sentence(Dynamics(points=(point,), conditions={"psi": 0.0}, headings=headings))
    assert found == (sentence if turns else "")


@pytest.mark.parametrize(("error", "said"), [(0.6, False), (0.4, True), (np.nan, True)])
def test_inputs_of_a_straight_course_need_effects_of_known_size(error: float, said: bool) -> None:
    """The answer stated them as a fact although they rested on a wind moment of -0.036 with an error of 0.021."""
    inputs = {"n_left": 0.6, "n_right": 0.5}
    point = OperatingPoint(speed=0.8, inputs=inputs, real=np.zeros(0), imaginary=np.zeros(0), stable=True)
    wind = Effect("wind", "steady wind", {}, (Parameter("w_n", 0.0), Parameter("k_air", 0.3)))
    fitted: Any = SimpleNamespace(fit=SimpleNamespace(estimate=lambda name: (1.0, error)))
    assert bool(straight_sentence(Dynamics(points=(point,)), fitted, [wind])) is said


def test_the_sentence_on_the_stability_says_how_its_speed_is_chosen() -> None:
    said = "At 0.66 m/s (75 % of the highest speed ahead in the logs) the "
    for low, verdict in ((0.2, "boat is directionally unstable: "), (-0.2, "directional stability is not shown by")):
        course = CourseStability(speed=0.66, share=0.75, pole=0.3, low=low, high=0.8)
        assert course_sentence(course).startswith(said + verdict)


def test_the_least_stable_heading_is_named() -> None:
    course = CourseStability(speed=0.9, heading=np.pi / 4, pole=0.25, low=0.125, high=0.5)
    assert course_sentence(course).startswith(
        "At 0.9 m/s on heading 45 deg (the least stable one) the boat is directionally unstable: without"
    )


@pytest.mark.parametrize(
    ("away", "error", "warned"), [(-1.0, 0.05, True), (-0.2, 0.01, False), (-0.5, 0.2, False), (-0.5, np.nan, False)]
)
def test_antenna_far_from_its_given_position_has_a_warning(away: float, error: float, warned: bool) -> None:
    estimates = {"l_x": (away, error), "l_y": (0.01, 0.02)}
    fit: Any = SimpleNamespace(
        names=tuple(estimates),
        estimate=estimates.__getitem__,
        model=SimpleNamespace(values={"antenna_x": 0.5, "antenna_y": 0.0}),
    )
    found = antenna_warnings(fit)
    assert [w.code for w in found] == ["antenna-contradicted"] * warned
    if warned:
        assert (
            "-0.50 ± 0.05 m forward and 0.01 ± 0.02 m to starboard of the origin, but 0.50 m forward" in found[0].text
        )
    fit.model.values = {}
    assert antenna_warnings(fit) == []  # no position was given


@pytest.mark.parametrize(
    ("mass", "error", "weighed", "sentence"),
    [
        (
            290.0,
            8.0,
            228.0,
            "the stronger side has the given thrust and the weaker one has lost thrust: m_u is then 1.09",
        ),
        (
            230.0,
            8.0,
            228.0,
            "the weaker side has the given thrust and the stronger one gives more thrust: m_u is then 1.21",
        ),
        (290.0, 40.0, 228.0, ""),
        (258.0, 8.0, 228.0, ""),
        (400.0, 8.0, 228.0, ""),
        (290.0, 8.0, None, ""),
    ],
    ids=["stronger", "weaker", "wide", "both likely", "none likely", "not weighed"],
)
def test_weighed_mass_is_evidence_on_the_side_with_the_given_thrust(
    mass: float, error: float, weighed: float | None, sentence: str
) -> None:
    """The thrusts differ by 33 %: with the thrust of the stronger side, masses are 1 / 1.165 times the estimate."""
    of_scale = 0.165 * mass
    fit: Any = SimpleNamespace(names=("m_u",), estimate=lambda _: (mass, float(np.hypot(error, of_scale))))
    found = ModelUncertainty(("m_u",), (), np.zeros((0, 1)), np.zeros((1, 1)), 0.165, np.array([of_scale]))
    (warning,) = thrust_difference_warnings(found, fit, weighed)
    assert ("The weighed mass is evidence" in warning.text) == bool(sentence)
    assert sentence in warning.text
    assert sides_compare_mass(found, fit, weighed) == bool(sentence)  # a note then gives no other ratio
    assert not sides_compare_mass(replace(found, thrust_difference=0.04), fit, weighed)
    assert not sides_compare_mass(None, fit, weighed)
    assert warning.text.endswith(
        "If you know which side has the given thrust, name it with --thrust-of (left or right). Otherwise measure the "
        "thrust of both sides as they are now (seatrial bench)."
    )


@pytest.mark.parametrize(
    ("weaker", "begin", "evidence"),
    [
        (
            "left",
            "The left thruster gives less thrust than the right one: the thrusts of both sides differ by 33 % of",
            "that the right side has the given thrust and the left one has lost thrust",
        ),
        (
            "right",
            "The right thruster gives less thrust than the left one: the thrusts of both sides differ by 33 % of",
            "that the left side has the given thrust and the right one has lost thrust",
        ),
        (
            "",
            "The thrusts of both sides differ by 33 % of",
            "that the stronger side has the given thrust and the weaker",
        ),
    ],
)
def test_the_weaker_thruster_is_named(weaker: str, begin: str, evidence: str) -> None:
    of_scale = 0.165 * 290.0
    fit: Any = SimpleNamespace(names=("m_u",), estimate=lambda _: (290.0, float(np.hypot(8.0, of_scale))))
    none, scale = np.zeros((0, 1)), np.array([of_scale])
    found = ModelUncertainty(("m_u",), (), none, np.zeros((1, 1)), 0.165, scale, weaker_side=weaker)
    (warning,) = thrust_difference_warnings(found, fit, 228.0)
    assert warning.text.startswith(f"{begin} their mean. The motion does not show which side deviates")
    assert evidence in warning.text


@pytest.mark.parametrize(
    ("rivals", "others"),
    [
        (
            ("propeller-walk", "mismatch", "yaw-bias"),
            "explain similar data; the score tests prefer propeller-walk.",
        ),
        (("mismatch", "propeller-walk"), "propeller walk (propeller-walk) explains similar data."),
        (("mismatch",), "of their mean). `seatrial ident diagnose`"),
    ],
    ids=["another is first", "another is second", "alone"],
)
def test_a_difference_of_thrust_that_the_fit_lacks_is_no_fact(rivals: tuple[str, ...], others: str) -> None:
    """Effects that act like it are named with it, and the warning says which one the score tests prefer."""
    fit: Any = SimpleNamespace(names=("m_u",), estimate=lambda _: (29.0, 2.3))
    none = np.zeros((0, 1))
    found = ModelUncertainty(("m_u",), (), none, np.zeros((1, 1)), 0.075, np.array([2.0]), weaker_side="left")
    found = replace(found, thrust_rivals=rivals)
    (warning,) = thrust_difference_warnings(found, fit, None)
    assert warning.text.startswith(
        "The model lacks a force or moment that acts like a difference of the thrusts (the left thruster would give "
        "less than the right one, by 15 % of their mean)."
    )
    assert others in warning.text
    assert "tests the causes against each other. If the thrusts differ, the motion does not show" in warning.text
    (diagnosed,) = thrust_difference_warnings(found, fit, None, diagnosed=True)
    assert "seatrial ident diagnose" not in diagnosed.text
