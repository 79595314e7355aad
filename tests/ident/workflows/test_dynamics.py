"""Test of a vehicle's dynamics in its result: they agree with each other and with the simulated boat's data."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs
from rich.console import Console

from seatrial.api.motion import Steady
from seatrial.ident.data.record import LogSegment
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.fitted_model import FittedModel, fit_nominal_model
from seatrial.ident.export.linearisation import linearise
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.report.blocks import Budget, Canvas
from seatrial.ident.report.sections.dynamics import section
from seatrial.ident.report.terminal import print_result
from seatrial.ident.results.answers import course_sentence
from seatrial.ident.results.commands import FitContext, vehicle_result
from seatrial.ident.results.parts import CourseStability, Dynamics, Provenance
from seatrial.ident.results.result_file import to_json
from seatrial.ident.validation.evaluation import evaluate
from seatrial.ident.workflows import dynamics
from seatrial.ident.workflows.dynamics import course_at_speeds, dynamics_of
from seatrial.ident.workflows.output import validity
from tests.missions import boat_with, channels_of, sail


@pytest.fixture(scope="module")
def fitted() -> FittedModel:
    run = LogSegment("a", channels_of(sail(boat_with(None, 2), 120.0, 1, run=1)[0]))
    return fit_nominal_model(horizontal_model(), [run], [])


def test_curves_poles_and_steps_agree(fitted: FittedModel) -> None:
    found = dynamics_of(fitted)
    assert found is not None
    straight, *turns = found.steady
    assert (straight.motion, straight.quantity) == ("straight", "u")
    assert np.all(np.diff(straight.value) > 0.0)
    assert np.all((straight.sd > 0.0) | (straight.command == 0.0))
    assert -1.0 <= straight.command[0] < straight.command[-1] <= 1.0
    assert [t.mean for t in turns[:2]] == pytest.approx([0.0, 0.5 * straight.command[-1]])
    (widest,) = turns[2:]
    drives = dynamics.Drives(fitted.fit.model, validity(fitted))
    difference = max(drives.left[1] - drives.right[0], drives.right[1] - drives.left[0])
    assert np.abs(widest.command).max() == pytest.approx(0.5 * difference)
    spin = turns[0]  # a larger left thrust turns to starboard
    assert np.nanmax(spin.value) > 0.1
    at = min(-spin.command[0], spin.command[-1])  # the range of each side is its own
    port, starboard = np.interp([-at, at], spin.command, spin.value)
    assert starboard == pytest.approx(-port, rel=1e-2)
    assert len(found.points) >= 3
    for point in found.points:
        at = np.interp(np.mean(list(point.inputs.values())), straight.command, straight.value)
        assert at == pytest.approx(point.speed, rel=0.02)
        assert point.stable == bool((point.real < 0.0).all())
    rise = next(s for s in found.steps if s.quantity == "u")
    slope = np.interp(rise.speed, straight.value[1:], np.diff(straight.value) / np.diff(straight.command))
    settled = rise.value[-1] / rise.step
    assert settled <= 1.05 * slope
    assert {s.quantity for s in found.steps} == {"u", "r", "v"}
    # The error of the last value is about that of the gain of slow commands.
    assert rise.sd is not None
    assert rise.sd[0] == 0.0
    assert rise.sd[-1] / rise.value[-1] == pytest.approx(found.responses[0].gain_sd[0], rel=0.5)
    speed, turn = found.responses
    assert (speed.quantity, turn.quantity) == ("u", "r")
    # Slow commands have the gain of the steady curve; its band is that of the parameters.
    assert speed.gain[0] == pytest.approx(slope, rel=0.1)
    assert np.all((speed.gain_sd > 0.0) & (speed.gain_sd < 0.2))
    assert np.all(speed.phase_sd > 0.0)
    assert speed.bandwidth is not None
    assert speed.bandwidth_sd is not None
    assert 0.0 < speed.bandwidth_sd < 0.5 * speed.bandwidth
    decibel = 20 * np.log10(speed.gain / speed.gain[0])
    assert np.interp(speed.bandwidth, speed.frequency, decibel) == pytest.approx(-3.01, abs=0.05)
    # The boat is nearly unstable on course, so that the gain of slow turns, and with it the bandwidth, is unknown.
    assert turn.gain_sd[0] > 0.35
    assert turn.bandwidth is turn.bandwidth_sd is None


def test_fit_that_did_not_converge_has_none(fitted: FittedModel) -> None:
    failed = replace(fitted, fit=replace(fitted.fit, message="stopped", converged=False))
    assert dynamics_of(failed) is None


def test_unstable_boat_is_named_with_its_time_constant() -> None:
    """The interval contains the pole of the true hull. The sentence is in the result and on the terminal."""
    boat = boat_with(None, 2)
    boat = replace(boat, hull=replace(boat.hull, d_r=1.0, d_rr=9.0))
    run = LogSegment("a", channels_of(sail(boat, 240.0, 1, run=1)[0]))
    fitted = fit_nominal_model(horizontal_model(), [run], [])
    found = dynamics_of(fitted)
    assert found is not None
    course = found.course
    assert course is not None
    low, high = validity(fitted)["u"]
    assert low <= course.speed <= high
    assert course.speed == float(f"{0.75 * high:.2g}")
    assert course.share == 0.75
    other = course_at_speeds(fitted.fit.model, validity(fitted))  # the same rule in a comparison
    assert other is not None
    assert (other.speed, other.pole) == (course.speed, pytest.approx(course.pole))
    true = boat.truth()
    u, (m_u, m_v, m_r) = course.speed, (true[n] for n in ("m_u", "m_v", "m_r"))
    block = [[-true["d_v"] / m_v, -m_u * u / m_v], [(m_u - m_v) * u / m_r, -true["d_r"] / m_r]]
    pole = float(np.linalg.eigvals(block).real.max())
    assert pole > 0.0
    assert course.low is not None
    assert course.high is not None
    assert course.low < pole < course.high
    assert course.unstable
    assert course.sway is not None
    assert course.sway < 0.0
    result = vehicle_result(
        fitted, evaluate(fitted), Provenance(created="2026-01-01", seatrial="0", command="seatrial"), [], [],
        FitContext(fitted.fit.model.values, dynamics=found),
    )  # fmt: skip
    sentence = course_sentence(course)
    assert f"in {1.0 / course.pole:.3g} s" in sentence
    assert sentence in result.answer
    text = io.StringIO()
    print_result(result, Console(file=text, width=4000))
    assert sentence in text.getvalue()
    assert json.loads(to_json(result))["dynamics"]["course"]["pole"] == pytest.approx(course.pole, rel=1e-6)


def test_the_speed_of_the_stability_is_that_of_the_data_and_not_of_the_model(fitted: FittedModel) -> None:
    """Fits with and without the first 20 s of a log once named 0.59 and 0.84 m/s, as if the boat had changed."""
    model, known = fitted.fit.model, validity(fitted)
    speeds, steady = set(), set()
    for scale in (0.9, 1.0, 1.2):  # another drag moves the steady speeds, and the speed of the least stable one
        own = [replace(p, value=scale * p.value) for p in model.parameters if p.name in ("d_u", "d_uu")]
        found = dynamics_of(replace(fitted, fit=replace(fitted.fit, model=model.replace_parameters(*own))))
        assert found is not None
        assert found.course is not None
        speeds.add(found.course.speed)
        steady.add(found.points[-1].speed)
    assert len(steady) == 3
    assert speeds == {float(f"{0.75 * known['u'][1]:.2g}")}
    backwards = course_at_speeds(model, {"u": (-0.5, 0.0)})
    assert backwards is None


@pytest.mark.parametrize(
    ("low", "logs", "doubts"),
    [
        (0.28, 2, []),
        (0.28, 0, []),
        (0.28, 1, ["it rests on one log"]),
        (0.05, 2, ["the pole is 2.4 standard errors above zero, and less than 3 are not clear"]),
        (0.13, 2, []),  # 3.5 standard errors
        (0.05, 1, ["standard errors above zero, and less than 3 are not clear, and it rests on one log"]),
        (None, 1, ["it rests on one log"]),
    ],
)
def test_an_unstable_boat_is_doubted_if_one_log_or_few_standard_errors_show_it(
    low: float | None, logs: int, doubts: list[str]
) -> None:
    """A fit to a single bag called its boat unstable without a word on how sure this was."""
    high = None if low is None else 0.6 - low
    sentence = course_sentence(CourseStability(speed=0.8, pole=0.3, low=low, high=high), logs=logs)
    assert "the boat is directionally unstable" in sentence
    assert all(doubt in sentence for doubt in doubts)
    assert ("This is not sure: " in sentence) == ("fit a further log too, with short turns" in sentence) == bool(doubts)


def test_a_stability_that_the_data_do_not_show_has_the_runs_that_would() -> None:
    sentence = course_sentence(CourseStability(speed=0.8, pole=0.1, low=-0.2, high=0.4))
    assert "not shown by the data" in sentence
    assert "To find out, record short turns to both sides at this speed" in sentence


def test_negative_damping_of_sway_has_its_lowest_speed(fitted: FittedModel) -> None:
    """With lift of the wrong sign the damping of sway, d_v + Y_uv u, is negative from -d_v / Y_uv on."""
    fit = fitted.fit
    assert dynamics_of(fitted).course.sway_from is None  # type: ignore[union-attr]
    _, fastest = validity(fitted)["u"]
    from_speed = 0.5 * fastest
    d_v = fit.model.values["d_v"]
    lifted = (fit.model + catalogue()["lift"]).with_values({"Y_uv": -d_v / from_speed})
    found = dynamics_of(replace(fitted, fit=replace(fit, model=lifted)))
    assert found is not None
    assert found.course is not None
    assert found.course.sway_from == pytest.approx(from_speed, abs=0.02 * fastest)
    assert f"From {found.course.sway_from:.2g} m/s on the estimated damping of sway" in course_sentence(found.course)
    held = "fit the model again with the hull lift held (`seatrial ident vehicle LOGS --model MODEL.toml --fix Y_uv=0"
    assert held in course_sentence(found.course, lifted)
    assert held not in course_sentence(found.course, lifted.with_values({"Y_uv": 1.0}))
    assert {"u", "v", "n_left"} <= set(found.ranges)
    assert all(p.states["u"] == p.speed for p in found.points)


def test_straight_course_and_stability_of_a_boat_in_wind_are_those_of_all_headings(fitted: FittedModel) -> None:
    fit = fitted.fit
    windy = (fit.model + catalogue()["wind"]).with_values({"F_wx": 3.0, "F_wy": 0.0, "w_n": 0.1})
    found, calm = dynamics_of(replace(fitted, fit=replace(fit, model=windy))), dynamics_of(fitted)
    assert calm is not None
    assert found is not None
    assert (calm.headings, calm.course and calm.course.heading) == ((), None)
    pull = {round(np.degrees(p.heading)): p.inputs["n_right"] - p.inputs["n_left"] for p in found.headings}
    assert list(pull) == [0, 45, 90, 135, 180, 225, 270, 315]
    # In wind to the north, the moment of the lateral force has opposite signs on the headings east and west.
    assert pull[90] * pull[270] < 0.0
    assert abs(pull[0]) < 0.2 * abs(pull[90])
    assert found.course is not None
    poles = {}
    for heading in pull:
        at = linearise(windy, found.course.speed, None, {"psi": float(np.radians(heading))})
        assert at.course_pole is not None
        poles[heading] = float(at.poles[at.course_pole].real)
    assert found.course.pole == pytest.approx(max(poles.values()), abs=1e-9)
    assert found.course.heading is not None
    assert poles[round(np.degrees(found.course.heading))] == pytest.approx(max(poles.values()), abs=1e-6)


def test_conditions_of_the_end_of_the_data_are_in_the_result(fitted: FittedModel) -> None:
    model = fitted.fit.model + catalogue()["payload-shift"]
    late = replace(fitted, fit=replace(fitted.fit, model=model))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dynamics, "validity", lambda f: {**validity(fitted), "t": (0.0, 118.0)})
        found = dynamics_of(late)
    assert found is not None
    assert found.conditions == {"t": 118.0}
    assert set(found.points[0].inputs) == {"n_left", "n_right"}
    assert [c.motion for c in found.steady] == ["straight", "turn", "turn", "turn"]
    without = dynamics_of(fitted)
    assert without is not None
    assert without.conditions == {}


def test_turns_use_the_range_of_each_side_ahead_and_astern(fitted: FittedModel) -> None:
    """The largest turn rate needs the largest difference of both sides in the data, also if one side was astern."""
    ranges = validity(fitted) | {"n_left": (-0.4, 0.9), "n_right": (0.0, 0.8)}
    known = dynamics.covariance_of(fitted.fit)
    drives = dynamics.Drives(fitted.fit.model, ranges)
    assert (drives.low, drives.high) == (0.0, 0.8)
    assert drives.reach(0.2) == pytest.approx((-0.6, 0.2))  # left astern and right ahead; right stopped and left ahead
    straight, *turns = dynamics.steady_curves(fitted.fit.model, ranges, known)
    assert straight.command[0] == 0.0
    assert [t.mean for t in turns] == pytest.approx([0.0, 0.4, 0.2])
    for t in turns:
        for side, n in (("n_left", t.mean + t.command), ("n_right", t.mean - t.command)):
            assert ranges[side][0] - 1e-9 <= n.min()
            assert n.max() <= ranges[side][1] + 1e-9
    steady = Steady((straight, *turns))
    largest = turns[2].value[0]
    assert -largest > max(np.nanmax(np.abs(t.value)) for t in turns[:2])
    assert f"The largest steady turn rate is {-np.degrees(largest):.3g} ± " in steady.answer
    assert "at a shaft speed of -0.4 left and 0.8 right" in steady.answer
    # Ranges that are equal ahead and astern, or that begin at zero, need no further curve.
    for low in (-0.8, 0.0):
        equal = validity(fitted) | {"n_left": (low, 0.8), "n_right": (low, 0.8)}
        assert dynamics.Drives(fitted.fit.model, equal).means() == pytest.approx([0.0, 0.4])
    # A curve with a mean of 0.01 would be nearly that of 0.
    nearly = validity(fitted) | {"n_left": (-0.8, 0.82), "n_right": (-0.8, 0.82)}
    assert dynamics.Drives(fitted.fit.model, nearly).means() == pytest.approx([0.0, 0.41])


def words_of(found: Dynamics) -> str:
    """Return the lead and the blocks of the section of a report as text."""
    shown = section(Canvas(Budget(200)), found)
    return " ".join(map(str, (shown.lead, *shown.blocks)))


def test_boat_in_wind_has_no_steady_turn(fitted: FittedModel) -> None:
    """A turning boat changes its heading, and with it the wind on the hull: no turn rate stays the same."""
    model = (fitted.fit.model + catalogue()["wind"]).with_values({"F_wx": -4.0, "F_wy": 2.0})
    found = dynamics_of(replace(fitted, fit=replace(fitted.fit, model=model)))
    still = dynamics_of(fitted)
    assert found is not None
    assert still is not None
    assert found.conditions == {"psi": 0.0}
    (straight,) = found.steady
    assert straight.motion == "straight"
    assert straight.value[-1] < still.steady[0].value[-1]  # against the wind from the north
    words = words_of(found)
    assert "Computed from the model at psi = 0 rad, with the effects that depend on it (such as wind)" in words
    assert "There is no steady turn: the model depends on the heading" in words
    assert "still water" not in words
    words = words_of(still)
    assert "Computed from the model for still water, without disturbances, and within" in words
    assert "no steady turn" not in words


def test_a_loss_of_one_side_astern_needs_unequal_sides_within_the_data(fitted: FittedModel) -> None:
    ranges = validity(fitted) | {"n_left": (-0.6, 0.6), "n_right": (-0.6, 0.6)}
    lossy = fitted.fit.model + catalogue()["reverse-mismatch"]
    lossy = lossy.with_values({"rho_left": 0.0, "rho_right": 0.45})
    known = dynamics.covariance_of(fitted.fit)
    straight = dynamics.steady_curves(lossy, ranges, known)[0]
    assert np.isfinite(straight.value).all()
    left, right = straight.sides
    # The weaker side reaches its limit, and the other one stays inside.
    assert right[0] == pytest.approx(-0.6, abs=2e-3)
    assert left[0] == pytest.approx(-0.6 * np.sqrt(0.55), rel=0.02)
    assert left[-1] == pytest.approx(right[-1]) == pytest.approx(0.6)
    assert straight.unequal == 0
    steady = Steady((straight,))
    assert "With equal shaft speeds the boat turns: unequal ones hold the course, for example −0.4" in steady.answer
    frame = steady.to_pandas()
    np.testing.assert_allclose(frame[["left", "right"]], np.stack([left, right], axis=1))
    assert {"left", "right"} <= set(steady._content().columns)
    found = dynamics_of(fitted)
    assert found is not None
    assert "unequal ones hold the course" in words_of(structs.replace(found, steady=(straight,)))
    assert "unequal ones hold the course" not in words_of(found)
