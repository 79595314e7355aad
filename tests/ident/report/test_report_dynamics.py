"""Tests of a vehicle's report: its parameters by SNAME, its steady motion and poles, and reasons of wide intervals."""

from __future__ import annotations

import re
from typing import Any

import msgspec
import numpy as np
import pytest

from seatrial.api.tables import statistics
from seatrial.ident.report import page
from seatrial.ident.report.blocks import Budget, Canvas
from seatrial.ident.report.bode import phase_axis
from seatrial.ident.report.drawing import angle_step
from seatrial.ident.report.sections.dynamics import section
from seatrial.ident.report.sections.runs import _forward_speeds, _path_traces, _wide_bands, growth_over_speed, wide_band
from seatrial.ident.results import (
    CourseStability,
    DiagnosisResult,
    Dynamics,
    FitResult,
    FrequencyResponse,
    OperatingPoint,
    SteadyCurve,
    StepResponse,
    Trace,
    disturbance_reason,
)
from seatrial.ident.results.parts import RemainingCandidate
from tests.ident.pages import KINDS, Page, loaded, numbers


def dynamics() -> Dynamics:
    """Return the dynamics of a boat that is unstable on a straight course at its higher speed."""
    n = np.linspace(-0.5, 0.5, 81)
    t = np.linspace(0.0, 6.0, 100)
    both: dict[str, Any] = {"inputs": ("n_left", "n_right"), "command": n}
    steady = (
        SteadyCurve(motion="straight", quantity="u", unit="m/s", value=2 * n, sd=0.1 + 0 * n, **both),
        SteadyCurve(motion="turn", quantity="r", unit="rad/s", value=n, sd=np.nan * n, **both),
    )
    pair, rise = np.array([-0.5, -0.5]), np.array([0.1, -2.0])
    slow, fast = {"n_left": 0.25, "n_right": 0.25}, {"n_left": 0.5, "n_right": 0.51}
    points = (
        OperatingPoint(speed=0.5, inputs=slow, real=pair, imaginary=np.array([2.0, -2.0]), stable=True),
        OperatingPoint(speed=1.0, inputs=fast, real=rise, imaginary=np.zeros(2), stable=False),
    )
    step = StepResponse(speed=1.0, motion="turn", step=0.1, quantity="r", unit="rad/s", t=t, value=t, sd=0.1 + 0 * t)
    f = np.geomspace(0.01, 1.0, 100)
    response = FrequencyResponse(
        speed=1.0, motion="turn", quantity="r", unit="rad/s", stable=False, frequency=f, gain=0.1 / f, phase=-f,
        gain_sd=0.1 + 0 * f, phase_sd=np.nan * f, bandwidth=0.02, bandwidth_sd=0.0031,
        lag_90=0.4,
    )  # fmt: skip
    return Dynamics(
        steady=steady, points=points, steps=(step,), responses=(response,), delays={"n_left": 0.12},
        conditions={"t": 240.0}, speeds=(-2.0, 0.61), course=CourseStability(speed=1.0, pole=0.1, low=0.05, high=0.2),
    )  # fmt: skip


@pytest.fixture(scope="module")
def shown() -> Page:
    result = msgspec.structs.replace(loaded(KINDS["diagnosis"]()), dynamics=dynamics())
    return Page(page.render(result))


def test_steady_curves_have_their_units_and_bands(shown: Page) -> None:
    place = next(a for _, a in shown.tags if a.get("aria-label") == "Steady speed against shaft speed")
    band, speed, beyond = shown.figures()[str(place["id"])]["data"]
    y = np.linspace(-1.0, 1.0, 81)
    np.testing.assert_allclose(numbers(speed["y"]), np.where(y < 0.61, y, np.nan), atol=1e-3)
    np.testing.assert_allclose(numbers(beyond["y"]), np.where(y > 0.59, y, np.nan), atol=1e-3)
    assert beyond["line"]["dash"] == "dot"
    assert "dashed: the boat leaves the course" not in shown.words
    assert "dotted: beyond the speeds of 98 % of the data" in shown.words
    assert np.nanmax(numbers(band["y"])) == pytest.approx(1.0 + 0.196, abs=1e-3)
    place = next(a for _, a in shown.tags if str(a.get("aria-label")).startswith("Steady turn rate"))
    assert np.nanmax(numbers(shown.figures()[str(place["id"])]["data"][1]["y"])) == pytest.approx(
        np.degrees(0.5), abs=0.01
    )


def test_speeds_at_which_the_boat_leaves_its_course_are_dashed() -> None:
    found = dynamics()
    n = found.steady[0].command
    straight = msgspec.structs.replace(found.steady[0], difference=0.0 * n, growth=n - 0.2)
    found = msgspec.structs.replace(found, steady=(straight, found.steady[1]))
    own = Page(page.render(msgspec.structs.replace(loaded(KINDS["diagnosis"]()), dynamics=found)))
    place = next(a for _, a in own.tags if a.get("aria-label") == "Steady speed against shaft speed")
    _, speed, unstable, beyond = own.figures()[str(place["id"])]["data"]
    y = np.linspace(-1.0, 1.0, 81)
    np.testing.assert_array_equal(np.isfinite(numbers(speed["y"])), y < 0.41)
    np.testing.assert_array_equal(np.isfinite(numbers(unstable["y"])), (y > 0.39) & (y < 0.61))
    np.testing.assert_array_equal(np.isfinite(numbers(beyond["y"])), y > 0.59)
    assert [unstable["line"]["dash"], beyond["line"]["dash"]] == ["dash", "dot"]
    assert "dashed: the boat leaves the course without a controller" in own.words


def test_turn_rates_beyond_the_data_are_marked() -> None:
    for rates, marked in (((-0.3, 0.1), True), ((-0.3, 0.6), False), (None, False)):
        found = msgspec.structs.replace(dynamics(), ranges={"r": rates} if rates else {})
        shown = str(section(Canvas(Budget()), found))
        assert ("extrapolated beyond ± 17 deg/s, within which 98 % of the data are" in shown) == marked, rates


@pytest.mark.parametrize(("quantity", "word"), [("n", "shaft speed"), ("n_cmd", "command"), ("f", "thrust")])
def test_the_inputs_have_their_own_name(quantity: str, word: str) -> None:
    """A model with shaft speeds as inputs has no command."""
    own = [f"{quantity}_left", f"{quantity}_right"]
    found = dynamics()
    points = tuple(
        msgspec.structs.replace(p, inputs=dict(zip(own, p.inputs.values(), strict=True))) for p in found.points
    )
    steady = tuple(msgspec.structs.replace(c, inputs=tuple(own)) for c in found.steady)
    found = msgspec.structs.replace(found, points=points, steady=steady)
    canvas = Canvas(Budget())
    shown = f"{section(canvas, found)} {canvas.figures}"
    for text in (f"within the {word}s of the data", f"{word} of both sides", f"mean {word} 0", f"from the {word}"):
        assert text in shown, text
    assert ("command" in shown) == (word == "command")


def test_step_response_has_its_band(shown: Page) -> None:
    place = next(a for _, a in shown.tags if str(a.get("aria-label")).startswith("Step response"))
    band, line = shown.figures()[str(place["id"])]["data"]
    end = np.nanmax(numbers(line["y"]))
    assert np.nanmax(numbers(band["y"])) == pytest.approx(end + np.degrees(0.196), rel=1e-3)
    assert "with 95 % bands" in shown.words


def test_poles_are_in_words(shown: Page) -> None:
    words = " ".join(shown.words.split())
    assert "0.5 m/s, shaft speed 0.250 −0.500 ± 2.00 j 2.00 s" in words
    assert "1 m/s, shaft speed n_left 0.500, n_right 0.510 0.100 – unstable: grows by a factor of e in 10.0 s" in words
    assert "From 1 m/s on, the boat does not hold a straight course" in words
    assert "With the dead time: 120 ms of n_left" in words
    assert (
        "At 1 m/s the boat is directionally unstable: without a controller a small yaw rate grows by a factor" in words
    )
    assert "in 10 s (95 % interval: 5 to 20 s)" in words
    assert "Taken as constant: t = 240 s." in words


def test_poles_have_the_states_that_take_part() -> None:
    """Results of an earlier version have no such column, and stable boats none of their stability."""
    found = dynamics()
    named = tuple(msgspec.structs.replace(p, mainly=("r, v", "n_left")) for p in found.points)

    def words(points: tuple[OperatingPoint, ...]) -> str:
        result = msgspec.structs.replace(loaded(KINDS["diagnosis"]()), dynamics=replaced(found, points=points))
        return " ".join(Page(page.render(result)).words.split())

    replaced = msgspec.structs.replace
    assert "time constant mainly stability 0.5 m/s, shaft speed 0.250 −0.500 ± 2.00 j 2.00 s r, v" in words(named)
    assert "r, v unstable: grows by a factor of e in 10.0 s −2.00 0.500 s n_left" in words(named)
    assert "time constant stability 0.5 m/s" in words(found.points)
    assert "time constant mainly 0.5 m/s" in words(named[:1])


def test_shortest_lag_of_the_model_is_marked() -> None:
    found = dynamics()
    quick = msgspec.structs.replace(found.points[1], real=np.array([0.1, -20.0]))
    result = loaded(KINDS["diagnosis"]())
    words = [
        " ".join(Page(page.render(msgspec.structs.replace(result, dynamics=d))).words.split())
        for d in (found, msgspec.structs.replace(found, points=(found.points[0], quick)))
    ]
    assert "the shortest lag of a state of the model" not in words[0]
    assert "−20.0 ≤ 0.0500 s" in words[1]
    assert "≤: the shortest lag of a state of the model. A lag with a shorter time constant" in words[1]


def test_operating_points_outside_the_data_are_named() -> None:
    found = dynamics()
    points = tuple(
        msgspec.structs.replace(p, states={"u": p.speed, "v": 0.3 * p.speed, "r": 0.0}) for p in found.points
    )
    ranges = {"u": (-2.0, 1.5), "v": (-0.6, 0.1), "n_left": (-1.0, 1.0)}
    outside = msgspec.structs.replace(found, points=points, ranges=ranges)
    words = " ".join(
        Page(page.render(msgspec.structs.replace(loaded(KINDS["diagnosis"]()), dynamics=outside))).words.split()
    )
    assert "may be wrong: at 1 m/s sway v = 0.3 m/s (98 % of the data: -0.6 to 0.1 m/s)." in words
    assert "at 0.5 m/s sway" not in words


def test_poles_and_time_constants_that_are_not_determined_are_marked() -> None:
    found = dynamics()
    errors = (np.array([0.3, 0.3]), np.array([0.06, 0.5]))
    points = tuple(msgspec.structs.replace(p, error=e) for p, e in zip(found.points, errors, strict=True))
    lost = msgspec.structs.replace(loaded(KINDS["diagnosis"]()), dynamics=msgspec.structs.replace(found, points=points))
    words = " ".join(Page(page.render(lost)).words.split())
    assert "0.250 −0.500 ± 2.00 j not determined" in words
    assert "0.100 not determined stability not shown by the data −2.00 0.500 s" in words
    assert "Not determined: the standard error of the pole is more than half of its size." in words


def test_bode_plot_has_its_units_its_band_and_its_words(shown: Page) -> None:
    gain, phase = (
        next(a for _, a in shown.tags if str(a.get("aria-label")).startswith(f"Bode plot, {x}"))
        for x in ("gain", "phase")
    )
    figure = shown.figures()[str(gain["id"])]
    band, line = figure["data"]
    decibel = 20 * np.log10(np.degrees(0.1 / np.geomspace(0.01, 1.0, 100)))
    np.testing.assert_allclose(numbers(line["y"]), decibel, atol=1e-3)
    assert np.nanmax(numbers(band["y"])) == pytest.approx(decibel[0] + 1.96 * 20 * np.log10(np.e) * 0.1, abs=0.01)
    assert figure["layout"]["xaxis"]["type"] == "log"
    assert figure["layout"]["yaxis"]["title"]["text"] == "gain [dB, 0 dB: 1 deg/s]"
    (line,) = shown.figures()[str(phase["id"])]["data"]  # no band without errors
    np.testing.assert_allclose(numbers(line["y"]), -np.degrees(np.geomspace(0.01, 1.0, 100)), atol=1e-3)
    words = " ".join(shown.words.split())
    band = "0.0200 ± 0.0031 Hz (a period of 50 s)"
    assert f"The turn rate falls by 3 dB at {band} and lags by 90° at 0.40 Hz, where" in words
    assert "The model is not stable at this speed" in words


def test_table_has_interval_t_sname_and_origin() -> None:
    content = KINDS["diagnosis"]()
    row = {"name": "d_uu", "meaning": "quadratic surge damping", "unit": "kg/m", "value": 24.0, "se": 2.0, "free": True}
    fixed = {
        "name": "y_left",
        "meaning": "arm",
        "unit": "m",
        "value": -0.15,
        "se": None,
        "free": False,
        "origin": "given",
    }
    ratio = row | {"name": "m_u/T", "flag": "at its bound", "flag_codes": ["at bound"]}
    content["fit"]["parameters"] = [row, fixed, ratio]
    cells = re.findall(r"<td[^>]*>(.*?)</td>", page.render(loaded(content)).split('id="parameters"')[1], re.DOTALL)
    names = [" ".join(c.split()) for c in cells[:27]]
    assert names[:9] == [
        "d_uu",
        "24.0",
        "2.0",
        "20.1 to 27.9",
        "12",
        "kg/m",
        "−X_|u|u",
        "estimated",
        "quadratic surge damping",
    ]
    assert names[9:17] == ["y_left", "−0.15", "–", "–", "–", "m", "", "given"]
    assert names[24:] == ["m − X_u̇ / T", "estimated, at bound", "quadratic surge damping ⚠ at its bound"]


def test_interval_of_a_quantity_that_cannot_be_negative_ends_at_zero() -> None:
    """The interval of any other quantity stays as wide as it is."""
    content = KINDS["diagnosis"]()
    row = {"name": "T_n", "meaning": "lag", "unit": "s", "value": 0.5, "se": 0.4, "free": True}
    content["fit"]["parameters"] = [row | {"positive": True}, row | {"name": "Y_uv"}]
    found = loaded(content)
    cells = re.findall(r"<td[^>]*>(.*?)</td>", page.render(found).split('id="parameters"')[1], re.DOTALL)
    assert [c.strip() for c in cells if " to " in c][:2] == ["0 to 1.28", "−0.28 to 1.28"]
    lowest = loaded(content | {"fit": content["fit"] | {"parameters": [row | {"value": 3e-18, "positive": True}]}})
    cells = re.findall(r"<td[^>]*>(.*?)</td>", page.render(lowest).split('id="parameters"')[1], re.DOTALL)
    assert [c.strip() for c in cells[1:5]] == ["0.00", "0.40", "0 to 0.78", "0"]
    rows = [statistics(r) for r in found.fit.parameters]
    assert [r.low for r in rows] == pytest.approx([0.0, 0.5 - 1.959964 * 0.4])
    assert [r.high for r in rows] == pytest.approx(2 * [0.5 + 1.959964 * 0.4])
    assert statistics(msgspec.structs.replace(found.fit.parameters[0], se=None)).low != 0.0  # NaN


def test_heading_of_many_turns_has_at_most_six_ticks() -> None:
    """Ten labels of a simulated heading lay on each other in a panel of 132 px."""
    for span in (90.0, 400.0, 1620.0, 5000.0):
        step = angle_step([0.0, span])
        assert span / step <= 5.0
        assert step % 45.0 == 0.0


def test_phase_axis_has_few_ticks_at_round_angles() -> None:
    """A dead time makes phases of many turns, and bands of an uncertain one are higher than the line."""
    short = phase_axis([np.radians([0.0, -170.0])])
    assert (short["dtick"], short["tick0"]) == (45.0, 0)
    assert short["range"] == pytest.approx([-178.5, 8.5])
    for turns in (0.3, 0.9, 2.0, 6.0, 30.0):
        axis = phase_axis([np.linspace(0.1, -turns * 2.0 * np.pi, 50)])
        low, high = axis["range"]
        assert axis["dtick"] % 45.0 == 0.0
        assert 2 <= np.floor(high / axis["dtick"]) - np.ceil(low / axis["dtick"]) + 1 <= 8
        assert low < -360.0 * turns < 5.0 < high
    phase = np.linspace(0.0, -np.pi, 50)
    assert phase_axis([phase], [np.full(50, 0.1)])["range"][0] < np.degrees(-np.pi - 0.19)
    low, high = phase_axis([phase], [np.linspace(0.0, 20.0, 50)])["range"]
    assert -300.0 < low < -180.0
    assert 0.0 < high < 120.0
    assert phase_axis([phase], [np.full(50, np.nan)])["range"] == phase_axis([phase])["range"]


FORCES = "the disturbance forces of that time"


def trace(**more: Any) -> Trace:
    t = np.arange(0.0, 100.0, 0.5)
    common = {"record": "a", "role": "estimation", "channel": "x", "unit": "m", "angle": False, "t": t}
    common |= {"measured": np.sin(t / 10.0), "model": np.sin(t / 10.0), "sd": 0.01 * t}
    common |= {"t_horizon": t, "horizon": np.sin(t / 10.0), "sd_horizon": 0.1 + 0.0 * t}
    return Trace(**(common | more))


def test_wide_interval_has_a_place_and_a_reason() -> None:
    row = trace()
    where, why = wide_band(row, row.t, row.sd, None, FORCES) or ("", "")
    assert where == "position north x (widest at 100 s, ± 2.0 m)"
    assert "integral of the velocity" in why
    assert wide_band(row, row.t_horizon, row.sd_horizon, 10.0, FORCES) is None
    seen = np.where((row.t > 40.0) & (row.t < 60.0), np.nan, row.measured)
    sd = np.where(row.t == 62.0, 3.0, 0.1)
    gap = trace(measured=seen, sd_horizon=sd)
    _, why = wide_band(gap, gap.t_horizon, gap.sd_horizon, 10.0, FORCES) or ("", "")
    assert why == "the channel has no samples from 40 to 52 s"
    _, why = wide_band(trace(channel="u"), row.t, row.sd, None, FORCES) or ("", "")
    assert why == FORCES


def test_a_wide_interval_of_an_unstable_boat_says_that_its_motion_depends_on_chance() -> None:
    """It names the missing effect as well. Of a stable model, and of a boat that goes astern, it is the only reason."""
    t = np.arange(0.0, 100.0, 0.5)
    fast = {"channel": "u", "measured": np.where(t < 50.0, -0.9, 0.9) + 0.01 * np.sin(t)}
    sd = np.where((t == 30.0) | (t == 80.0), 9.0, 0.1)
    course = CourseStability(speed=0.8, pole=0.6, low=0.4, high=0.8)
    result = loaded(KINDS["diagnosis"]())

    def reasons(course: CourseStability, at: float) -> str:
        rows = [trace(**fast), trace(channel="r", unit="rad/s", sd_horizon=np.where(t == at, sd, 0.1))]
        made = msgspec.structs.replace(result, traces=tuple(rows), dynamics=Dynamics(course=course))
        (block,) = _wide_bands([(rows[1], t, rows[1].sd_horizon)], 10.0, made)
        return str(block)

    begin = "the model is directionally unstable at the speeds there, so that the motion depends on chance"
    assert begin in reasons(course, 80.0)
    assert "Besides, " in reasons(course, 80.0)
    assert begin not in reasons(course, 30.0)
    for other in ({"low": -0.1}, {"pole": 0.05, "low": 0.01, "high": 0.09}, {"pole": -0.6, "low": -0.8, "high": -0.4}):
        assert begin not in reasons(msgspec.structs.replace(course, **other), 80.0)


def test_growth_over_the_speed_is_that_of_the_unstable_linear_models() -> None:
    """It is zero at rest and where the model is stable, and unknown unless the data show that the boat is unstable."""
    course = CourseStability(speed=0.8, pole=0.6, low=0.4, high=0.8)
    point = {"inputs": {}, "imaginary": np.zeros(2), "stable": False}
    points = tuple(
        OperatingPoint(speed=speed, real=np.array([pole, -1.0]), **point)
        for speed, pole in ((0.2, -0.1), (0.4, 0.3), (1.2, 0.9))
    )
    speeds, rates = growth_over_speed(Dynamics(course=course, points=points)) or ([], [])
    np.testing.assert_allclose(speeds, [0.0, 0.2, 0.4, 0.8, 1.2])
    np.testing.assert_allclose(rates, [0.0, 0.0, 0.3, 0.6, 0.9])
    assert growth_over_speed(Dynamics(points=points)) is None
    assert growth_over_speed(None) is None
    unknown = msgspec.structs.replace(course, low=-0.1)
    assert growth_over_speed(Dynamics(course=unknown, points=points)) is None


def test_the_forward_speed_is_that_along_the_heading() -> None:
    heading = np.linspace(3.0, 9.0, 200)
    rows = [
        trace(channel="vx", measured=-0.7 * np.cos(heading)),
        trace(channel="vy", measured=-0.7 * np.sin(heading)),
        trace(channel="psi", measured=np.where(np.arange(200) % 2, np.nan, np.angle(np.exp(1j * heading)))),
    ]
    made = msgspec.structs.replace(loaded(KINDS["diagnosis"]()), traces=tuple(rows))
    np.testing.assert_allclose(_forward_speeds(made)["a"][1], -0.7, rtol=1e-3)
    assert _forward_speeds(msgspec.structs.replace(made, traces=tuple(rows[:2]))) == {}


def test_a_wide_interval_names_a_missing_effect_that_is_known_before_the_disturbances() -> None:
    """The reason was disturbance forces even if the score tests said that an effect is missing."""
    fit = loaded(KINDS["thruster"]())
    assert isinstance(fit, FitResult)
    both = "the disturbance forces of that time cannot be known in advance, or an effect is missing from the model"
    first, search = "an effect is probably missing from the model (", "Run `seatrial ident diagnose` to search"
    quiet = msgspec.structs.replace(fit, notes=(), residuals=(), cross=())
    why = disturbance_reason(quiet)
    assert why.startswith(both)
    assert search in why
    passing = msgspec.structs.replace(quiet, notes=("By the score tests 3 effects may be missing.",))
    why = disturbance_reason(passing)
    assert why.startswith(f"{first}candidates pass the score tests)")
    assert "Real disturbance forces of that time cannot be known in advance either" in why
    assert search in why
    tested = loaded(KINDS["diagnosis"]())
    test = msgspec.structs.replace(tested.residuals[0], role="estimation", ljung_box_p=1e-9, after=None)
    coloured = msgspec.structs.replace(quiet, residuals=(test,))
    assert disturbance_reason(coloured).startswith(f"{first}the residuals are not white)")
    pair = msgspec.structs.replace(tested.cross[0], role="estimation", input="n_cmd", p=1e-9, after=None)
    correlated = msgspec.structs.replace(coloured, cross=(pair,))
    assert disturbance_reason(correlated).startswith(f"{first}the residuals are correlated with the inputs)")
    of_sensor = msgspec.structs.replace(coloured, cross=(msgspec.structs.replace(pair, input="psi"),))
    assert disturbance_reason(of_sensor).startswith(both)


def test_a_wide_interval_of_a_diagnosis_advises_the_next_experiment() -> None:
    found = loaded(KINDS["diagnosis"]())
    assert isinstance(found, DiagnosisResult)
    left = RemainingCandidate(name="lift", lm=90.0, df=1, p=1e-12)
    left_over = msgspec.structs.replace(found, remaining_candidates=(left,), recommended_experiment="Turn on the spot.")
    why = disturbance_reason(left_over)
    assert why.startswith("an effect is probably missing from the model (candidates pass the score tests)")
    assert why.endswith("Record the experiment that the diagnosis recommends, and diagnose again with its log")
    white = tuple(
        msgspec.structs.replace(r, after=msgspec.structs.replace(r.after, ljung_box_p=0.5, periodogram_p=0.5))
        for r in found.residuals
        if r.after is not None
    )
    nothing = msgspec.structs.replace(
        found, remaining_candidates=(), recommended_experiment=None, notes=(), residuals=white, cross=()
    )
    why = disturbance_reason(nothing)
    assert why.startswith("the disturbance forces of that time")  # the residuals before the effects do not count
    assert why.endswith("Record longer and more varied runs, and diagnose again with their logs")


def test_uncertainty_of_the_initial_state_is_no_wide_interval() -> None:
    row = trace()
    begin = np.where(row.t < 1.0, 5.0, 0.1)
    assert wide_band(row, row.t, begin, None, FORCES) is None
    where, _ = wide_band(row, row.t, np.where(row.t == 60.0, 1.0, begin), None, FORCES) or ("", "")
    assert where == "position north x (widest at 60 s, ± 2.0 m)"


def test_interval_that_says_nothing_has_no_number() -> None:
    """A heading is unknown beyond half a turn, and a position beyond a few times the size of the track."""
    row = trace()
    sd = 0.1 * row.t
    where, why = wide_band(row, row.t, sd, None, FORCES) or ("", "")
    assert where == "position north x (no useful interval after 26 s)"  # 2 * 1.96 * 0.1 t > 5 * 2 m
    assert "integral of the velocity" in why
    where, _ = wide_band(row, row.t, sd, 10.0, FORCES) or ("", "")
    assert where == "position north x (no useful interval 10 s ahead, at 100 s)"
    turn = trace(channel="psi", unit="rad", angle=True)
    where, _ = wide_band(turn, row.t, 0.0201 * row.t, None, FORCES) or ("", "")
    assert where == "heading ψ (no useful interval after 80 s)"  # 1.96 * 0.0201 t > pi
    assert wide_band(turn, row.t, 0.016 * row.t, None, FORCES) is None


def test_equal_reasons_and_warnings_are_stated_once() -> None:
    content = KINDS["diagnosis"]()
    same = {"logs": ["a"], "code": "not-in-model", "reason": "the model does not use it"}
    content["unused_signals"] = [{"signal": n, **same} for n in ("p", "q", "voltage_left")]
    content["warnings"] = 2 * [{"code": "arm-unknown", "text": "The arm is unknown."}]
    words = Page(page.render(loaded(content))).words
    assert "p, q, voltage_left: the model does not use it" in words
    assert words.count("the model does not use it") == 1
    assert words.count("The arm is unknown.") == 1


def test_page_of_many_records_is_below_three_megabytes() -> None:
    """The curves of ten records of 20 minutes get fewer points."""
    whole = loaded(KINDS["diagnosis"]())
    tables = ("traces", "track", "inputs", "residuals", "cross", "residual_forces")
    many = {
        key: tuple(
            msgspec.structs.replace(row, record=f"{row.record}{k}") for k in range(5) for row in getattr(whole, key)
        )
        for key in tables
    }
    assert len(page.render(msgspec.structs.replace(whole, **many)).encode()) < 3_000_000


def test_poles_of_a_boat_in_wind_name_their_heading() -> None:
    found = dynamics()
    conditions = {**found.conditions, "psi": np.pi / 2}
    result = msgspec.structs.replace(
        loaded(KINDS["diagnosis"]()), dynamics=msgspec.structs.replace(found, conditions=conditions)
    )
    words = " ".join(Page(page.render(result)).words.split())
    assert "of the model linearised at each speed, on heading 90 deg" in words
    assert "From 1 m/s on (on heading 90 deg), the boat does not hold a straight course" in words
    assert "Another heading has other poles" in words


def test_predictions_that_are_far_apart_are_not_joined_in_the_track() -> None:
    """Neighbouring predictions of an unstable boat start from different states. Its measured track has no such gaps."""
    t = np.arange(0.0, 80.0, 0.4)
    north, east = 0.3 * t, np.where((t > 20.0) & (t < 24.0), 6.0, 0.0)
    seen = (t < 50.0) | (t > 60.0)
    model, _ = _path_traces("model", t[seen], north[seen], east[seen], 1000)
    y = np.array(numbers(model["y"]), float)
    before = [0.3 * t[np.flatnonzero(t > at)[0] - 1] for at in (20.0, 24.0 - 1e-9, 50.0 - 1e-9)]
    np.testing.assert_allclose(y[np.flatnonzero(np.isnan(y)) - 1], before, rtol=1e-5)
    assert np.array_equal(np.isnan(y), np.isnan(np.array(numbers(model["x"]), float)))
    measured, _ = _path_traces("measured", t[seen], north[seen], east[seen], 1000)
    assert np.isnan(np.array(numbers(measured["y"]), float)).sum() == 1
    simulated, _ = _path_traces("model", None, north, east, 1000)
    assert np.isfinite(np.array(numbers(simulated["y"]), float)).all()
