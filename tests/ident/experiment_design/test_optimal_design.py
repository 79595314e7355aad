"""Tests of designed missions: known optima, limits, predicted errors against repeats, and discrimination of effects."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import signal, stats

from seatrial.api.messages import in_python
from seatrial.daq.errors import SeatrialError
from seatrial.ident.data.record import Channel, build_record
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.maximum_likelihood import SearchSettings, fit
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.estimation.stochastic_simulation import SampledInputs, simulate_stochastic
from seatrial.ident.experiment_design.discrimination import HypothesisPair, baselines_apart, discriminate, separation
from seatrial.ident.experiment_design.evaluator import DesignEvaluator
from seatrial.ident.experiment_design.excitation import StepInput, ThrusterResponse, prbs, rgs
from seatrial.ident.experiment_design.information import planned_record
from seatrial.ident.experiment_design.optimal_design import (
    Design,
    baseline_signals,
    design,
    monte_carlo,
    predicted_errors,
    predicted_track,
    rounded_up,
)
from seatrial.ident.experiment_design.prior import ParameterPrior
from seatrial.ident.experiment_design.problem import GRID, DesignLimits, DesignProblem
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Input, Model, Output, Sensor, State, plain_model
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.surge import surge_model
from seatrial.ident.models.yaw import yaw_model
from seatrial.ident.numerics.pattern_search import penalised_objective
from seatrial.ident.studies.cases import repeat_design
from seatrial.ident.workflows.design import beyond_validity
from tests.ident.toys import follower, values_of

pytestmark = pytest.mark.usefixtures("quick_compilation")


def boat_task(seconds: float = 100.0, n_steps: int = 20, **how) -> DesignProblem:
    return DesignProblem(horizontal_model(current=False), StepInput(n_steps, 2, seconds, 1.0, GRID), **how)


def gain_and_offset() -> Model:
    """Return the model y = a n + b. The best inputs are the extremes for half of the time each; the determinant is then
    N^2.
    """
    return plain_model(
        "line",
        f=lambda x, u, p: {"z": 0.0},
        h=lambda x, u, p: {"y": p.a * u.n_cmd + p.b},
        states=(State("z"),),
        inputs=(Input("n_cmd"),),
        sensors=(Sensor("meter", (Output("y", "", "e"),)),),
        parameters=(Parameter("a", 2.0, step=1.0), Parameter("b", 0.5, step=1.0), Parameter("e", 1.0, free=False)),
    )


def test_optimum_for_a_straight_line_is_half_at_each_extreme() -> None:
    problem = DesignProblem(gain_and_offset(), StepInput(6, 1, 40.0, 0.4, 0.4), rates={"meter": 2.5}, grid=0.4)
    fast = replace(problem)
    object.__setattr__(fast, "actuation", replace(problem.actuation, pole=np.inf))
    made = design(fast, evaluations=6000)
    levels = made.command[:, 0]
    n = levels.size
    assert made.value == pytest.approx(2 * np.log(n), abs=0.01)
    assert np.mean(np.abs(levels) > 0.99) > 0.99
    assert abs(levels.mean()) < 0.05
    assert made.errors["a"] == pytest.approx(1 / np.sqrt(n), rel=0.02)


def test_design_is_reproducible_and_better_than_random_inputs() -> None:
    first, second = (design(boat_task(seed=4), evaluations=600) for _ in range(2))
    np.testing.assert_array_equal(first.levels, second.levels)
    np.testing.assert_array_equal(first.durations, second.durations)
    problem = first.problem
    value, _ = DesignEvaluator(problem).evaluate(problem.commands(problem.steps.random(64, np.random.default_rng(9))))
    assert first.value > value.max() + 0.5
    assert set(first.predicted) == set(problem.observed_parameters)
    for (
        name
        # All sensors run at 10 Hz, and the noise is unknown. The prediction may differ slightly from the bound in the
        # search.
    ) in problem.observed_parameters:
        assert first.predicted[name] == pytest.approx(first.errors[name], rel=0.05)


LIMITS = DesignLimits(area=(40.0, 30.0), speed=1.1, energy=0.5)


def test_design_respects_all_limits() -> None:
    belief = ParameterPrior(("d_v", "d_r", "m_r"), 0.05)
    made = design(boat_task(50.0, 10, slew=2.0, limits=LIMITS, prior=belief, seed=2), evaluations=800)
    problem, command = made.problem, made.command
    assert made.durations.sum() == pytest.approx(50.0)
    assert made.durations.min() >= 1.0 - 1e-9
    assert np.abs(command).max() <= 1.0 + 1e-9
    assert np.abs(np.diff(command, axis=0)).max() <= 2.0 * GRID + 1e-9
    assert np.mean(np.abs(command) ** 3) <= 0.5 + 1e-9
    record = planned_record(problem.model, problem.t, problem.actuation.inputs(command[:, :, None])[:, :, 0])
    boats = np.array(
        [simulate(problem.model, record, v).x for v in (values_of(problem.model), *made.evaluator.samples(24, 2))]
    )
    assert (np.ptp(boats[:, :, :2], axis=(0, 1)) <= np.array([40.0, 30.0]) * 1.001).all()
    assert np.hypot(boats[:, :, 3], boats[:, :, 4]).max() <= 1.1 * 1.001
    track = predicted_track(made)
    assert track is not None
    assert track.corner is not None
    assert (boats[:, :, :2] >= track.corner - 0.05).all()
    assert (boats[:, :, :2] <= track.corner + np.array([40.0, 30.0]) + 0.05).all()
    assert track.inside is not None
    assert track.inside > 0.5
    assert track.radius[0] == 0.0 < track.radius[-1]
    free = design(boat_task(50.0, 10, seed=2), evaluations=800)
    assert free.value > made.value


def test_a_chosen_parameter_at_its_bound_names_the_reason() -> None:
    """A fitted dead zone of zero was said not to be observable from the sensors."""
    boat = horizontal_model("command").with_values({"dead_zone": 2.3e-17})
    task = DesignProblem(boat, StepInput(8, 2, 40.0, 1.0, GRID), chosen=("dead_zone",))
    with pytest.raises(SeatrialError, match=r"'dead_zone' has its lowest possible value, 0, .* in a copy of the model"):
        _ = DesignEvaluator(task).criterion
    wider = replace(task, model=boat.with_values({"dead_zone": 0.1}))
    assert "dead_zone" in wider.observed_parameters
    _ = DesignEvaluator(wider).criterion


def test_impossible_limits_give_a_one_line_error() -> None:
    with pytest.raises(SeatrialError, match=r"--max-speed 0.01 .*give more room"):
        design(boat_task(30.0, 6, limits=DesignLimits(speed=0.01)), evaluations=600)
    with pytest.raises(SeatrialError, match="do not fit"):
        StepInput(100, 2, 60.0, 1.0, GRID)
    with pytest.raises(SeatrialError, match="'q' cannot be estimated"):
        design(boat_task(chosen=("q",)), evaluations=600)
    with pytest.raises(SeatrialError, match="--area cannot be checked"):
        design(
            DesignProblem(yaw_model(), StepInput(8, 1, 40.0, 1.0, GRID), limits=DesignLimits(area=(9.0, 9.0))),
            evaluations=600,
        )


def test_proposed_area_is_large_enough() -> None:
    """The message said only that the area is too small, and the user had to try areas."""
    task = boat_task(30.0, 6, limits=DesignLimits(area=(1.0, 1.0)))
    with pytest.raises(SeatrialError, match=r"--area 1x1 .*a larger area, such as --area ") as problem:
        design(task, evaluations=600)
    found = re.search(
        r"such as --area ([\d.]+)x([\d.]+) \(the nearest sequence needs ([\d.]+) m north", str(problem.value)
    )
    assert found is not None
    north, east, needed = map(float, found.groups())
    assert needed < north < 1.3 * needed
    assert f"area=({north:g}, {east:g})" in in_python(str(problem.value))
    assert "prior_halfwidth" in in_python(str(problem.value))
    made = design(replace(task, limits=DesignLimits(area=(north, east))), evaluations=600)
    assert made.evaluator.violation(made.command[:, :, None])[0] <= 1e-3
    assert [rounded_up(x) for x in (100.0, 9.1, 43.0)] == [110.0, 9.6, 46.0]


def test_chosen_parameters_and_earlier_logs_change_the_design() -> None:
    sway = ("m_v", "d_v", "d_vv")
    for_sway = design(boat_task(criterion="Ds", chosen=sway), evaluations=1200)
    for_all = design(boat_task(), evaluations=1200)
    assert for_sway.value > for_sway.evaluator.criterion(for_all.information[None])[0]
    known = ParameterPrior(("m_v", "d_v"), covariance=np.diag([1e-4, 1e-4]), information=np.diag([1e4, 1e4]))
    later = replace(for_all.problem, prior=known)
    again = design(later, evaluations=600)
    assert again.before["d_v"] == pytest.approx(0.01)
    assert again.errors["d_v"] < 0.01
    assert again.predicted["d_v"] < 0.01
    assert np.isinf(again.before["m_u"])


def test_robust_design_is_better_on_average() -> None:
    problem = boat_task(
        40.0, 8, prior=ParameterPrior(("m_u", "m_v", "m_r", "d_v", "d_r", "d_rr", "d_uu"), 0.25), seed=3
    )
    nominal, averaged = design(problem, evaluations=500), replace(problem, robust=6)
    robust = design(averaged, evaluations=500, warm=nominal.found.z[None])
    value = DesignEvaluator(averaged).evaluate(np.stack([nominal.command, robust.command], axis=2))[0]
    assert value[1] > value[0] + 0.05


def test_design_is_better_than_baseline_signals() -> None:
    problem = boat_task(200.0, 40, process_noise=False, seed=1)
    made = design(problem, evaluations=2500)
    found = baseline_signals(problem, n=4)
    best = max(r.value for r in found.values())
    assert made.value > best + 3
    samples = monte_carlo(problem, {"design": made.command} | {k: r.command for k, r in found.items()}, n=100)
    assert samples.share_won() > 0.8
    assert {len(v) for v in samples.values.values()} == {100}
    assert all(len(r.values) == 4 and r.value == pytest.approx(r.values.max()) for r in found.values())


def test_steps_are_encoded_and_decoded_within_their_bounds() -> None:
    steps = StepInput(7, 2, 33.0, 1.4, 0.2, n_max=0.6)
    z = np.clip(steps.random(50, np.random.default_rng(1)), steps.low, steps.high)
    levels, durations = steps.unpack(z)
    np.testing.assert_allclose(durations.sum(axis=0), 33.0)
    assert durations.min() >= 1.4 - 1e-9
    np.testing.assert_allclose(durations / 0.2, np.round(durations / 0.2), atol=1e-6)
    assert np.abs(levels).max() <= 0.6
    np.testing.assert_array_equal(levels[:, 1, 3], z[3, 1:14:2])


@pytest.mark.parametrize(("n_steps", "seconds", "shortest"), [(100, 40.0, 0.35), (20, 12.0, 0.5), (2, 10.0, 5.0)])
def test_no_step_is_shorter_than_requested(n_steps: int, seconds: float, shortest: float) -> None:
    """This also holds if the shortest step is not a multiple of the grid and the steps just fit."""
    steps = StepInput(n_steps, 1, seconds, shortest, 0.2)
    _, durations = steps.unpack(steps.random(20, np.random.default_rng(1)))
    assert durations.min() >= shortest - 1e-9
    np.testing.assert_allclose(durations.sum(axis=0), seconds)
    with pytest.raises(SeatrialError, match="do not fit"):
        StepInput(n_steps + 1, 1, seconds, shortest, 0.2)


def test_shortest_step_between_two_rows_is_reported_as_rounded() -> None:
    with pytest.raises(SeatrialError, match=r"10 steps of at least 1\.2 s \(1\.1 s in steps of 0\.2 s\) do not fit"):
        StepInput(10, 2, 11.0, 1.1, 0.2)


def test_many_commands_are_evaluated_in_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    """The result does not depend on the batch size. Hundreds of starts on close rows needed gigabytes."""
    problem = DesignProblem(gain_and_offset(), StepInput(4, 1, 10.0, 1.0, GRID), robust=2)
    command = problem.commands(problem.steps.random(7, np.random.default_rng(2)))
    evaluator = DesignEvaluator(problem)
    at_once = evaluator.evaluate(command)
    monkeypatch.setattr("seatrial.ident.experiment_design.evaluator.MAX_INPUT_BYTES", 8 * problem.t.size * 2 * 3)
    np.testing.assert_allclose(evaluator.evaluate(command), at_once)


def test_search_evaluates_only_candidates_that_can_be_better(monkeypatch: pytest.MonkeyPatch) -> None:
    """The design equals that with all limits and criteria. A candidate that cannot win costs half or nothing."""
    problem = DesignProblem(
        horizontal_model(), StepInput(8, 2, 40.0, 1.0, GRID, n_max=0.6), limits=DesignLimits(area=(12.0, 12.0))
    )
    command = problem.commands(problem.steps.random(40, np.random.default_rng(2)))
    evaluator = DesignEvaluator(problem)
    value, violation = evaluator.evaluate(command)
    assert 0 < (violation == 0.0).sum() < 40
    merit = penalised_objective(value, violation)
    for least in (merit.min(), np.median(merit[merit < -1e11]), np.median(merit[violation == 0.0]), merit.max()):
        found = penalised_objective(*evaluator.evaluate_above(command, float(least)))
        np.testing.assert_allclose(found[merit > least], merit[merit > least])
        assert (found[merit <= least] <= least).all()


def test_levels_are_rounded_within_the_limit_of_the_mission() -> None:
    """A mission reader rejects a level of 0.667 if n_max is 0.6667."""
    problem = DesignProblem(gain_and_offset(), StepInput(4, 1, 10.0, 1.0, GRID, n_max=0.6667))
    made = design(problem, evaluations=500)
    assert np.abs(made.levels).max() == 0.6667
    within = replace(made, problem=replace(problem, validity={"n_cmd": (-0.6, 0.6), "other": (0.0, 1.0)}))
    beyond = replace(made, problem=replace(problem, validity={"n_cmd": (-0.1, 0.4)}))
    assert beyond_validity(within) == []
    (warning,) = beyond_validity(beyond)
    assert re.fullmatch(r"n_cmd from -0.6\d* to 0.6\d* \(data: -0.1 to 0.4\)", warning)


def test_robust_criterion_of_designs_and_baselines_is_a_mean_of_finite_values(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sample that diverges is a violation; it must not add -1e9 to the mean. Baselines are compared by the same
    mean.
    """
    problem = DesignProblem(follower(1.0), StepInput(4, 1, 10.0, 1.0, GRID), robust=2)
    command = problem.commands(problem.steps.random(3, np.random.default_rng(1)))
    evaluator, samples = DesignEvaluator(problem), np.array([[0.5, 0.1], [2.0, 0.1]])
    monkeypatch.setattr(DesignEvaluator, "_robust_samples", samples)
    u = problem.actuation.inputs(command)
    alone = [evaluator.criterion_values(u, np.tile(boat, (3, 1))) for boat in samples]
    value, violation = evaluator.evaluate(command)
    np.testing.assert_allclose(value, np.mean(alone, axis=0))
    assert not violation.any()
    for baseline in baseline_signals(problem, n=2).values():
        assert baseline.value == pytest.approx(float(evaluator.evaluate(baseline.command[:, :, None])[0][0]))
    samples = np.array([[0.5, 0.1], [0.01, 0.1]])  # The rows are twenty time constants apart.
    monkeypatch.setattr(DesignEvaluator, "_robust_samples", samples)
    value, violation = evaluator.evaluate(command)
    np.testing.assert_allclose(value, alone[0])
    np.testing.assert_allclose(violation, 0.5)
    with pytest.raises(SeatrialError, match=r"in all of the 2 parameter samples \(singular in 50 %\)"):
        design(problem, evaluations=500)


def test_boats_are_sampled_from_the_prior_within_the_bounds() -> None:
    problem = DesignProblem(follower(1.0), StepInput(4, 1, 10.0, 1.0, GRID))
    command = {"design": problem.commands(problem.steps.random(1, np.random.default_rng(1)))[:, :, 0]}
    box, known = (
        np.ptp(monte_carlo(replace(problem, prior=belief), command, n=50).values["design"])
        for belief in (ParameterPrior(("T",)), ParameterPrior(("T",), covariance=np.array([[1e-8]])))
    )
    assert known < 0.01 * box
    wide = ParameterPrior(("d_uu",), covariance=np.array([[1e4]]))
    model = horizontal_model().with_values({"d_uu": 0.0})
    drawn = wide.sample(model, 50, np.random.default_rng(1))[:, list(model.values).index("d_uu")]
    assert drawn.min() == 0.0 < drawn.max()


def test_inflated_errors_of_earlier_logs_are_kept() -> None:
    """Repeating the mission reduces the inflated errors by the root of two, not to the bound of the information."""
    problem = DesignProblem(follower(1.0), StepInput(4, 1, 10.0, 1.0, GRID))
    levels, durations = problem.steps.unpack(problem.steps.random(1, np.random.default_rng(1)))
    command = problem.finer.actuation.limited(levels, durations)[:, :, 0]
    plain = predicted_errors(problem, command)["T"]
    variance = np.array([[(3.0 * plain) ** 2]])
    known = ParameterPrior(("T",), covariance=variance, information=1.0 / variance, inflation={"T": 3.0})
    again = replace(problem, prior=known)
    assert predicted_errors(again, command)["T"] == pytest.approx(3.0 * plain / np.sqrt(2.0))
    u = problem.actuation.inputs(problem.actuation.limited(levels, durations))
    np.testing.assert_allclose(DesignEvaluator(again).information(u), DesignEvaluator(problem).information(u) / 9.0)


def test_slew_limit_and_shaft_lag_equal_a_plain_loop() -> None:
    t = np.arange(0.0, 12.0, 0.1)
    actuation = ThrusterResponse(horizontal_model(current=False), t, slew=0.8)
    levels = np.array([[[1.0], [-1.0]], [[-0.5], [0.2]], [[0.1], [1.0]]])
    durations = np.array([[1.0], [5.0], [6.0]])
    command = actuation.limited(levels, durations)[:, :, 0]
    now, shaft, n = np.zeros(2), np.zeros(2), actuation.shaft(command[:, :, None])[:, :, 0]
    for k, at in enumerate(t):
        np.testing.assert_allclose(command[k], now, atol=1e-9)
        np.testing.assert_allclose(n[k], shaft, atol=1e-9)
        shaft = command[k] + (shaft - command[k]) * np.exp(-2.794 * 0.1)
        target = levels[int(np.searchsorted([1.0, 6.0], at + 1e-9, side="right")), :, 0]
        now = now + np.clip(target - now, -0.08, 0.08)


@pytest.mark.parametrize("rate", [1.0, 3.0, 4.0, 6.0, 7.0, 8.0, 10.0, 15.0])
def test_sensor_has_the_weight_of_its_requested_rate(rate: float) -> None:
    """This also holds for a rate that does not fit the rows. The weights of the other sensors do not change."""
    problem = boat_task(rates={"position": rate})
    for on in (problem, problem.finer):
        observed = on.observed(problem.model)
        for sensor in problem.model.sensors:
            for o in sensor.outputs:
                mean = observed.values[o.noise] ** 2 * on.every[sensor.name] * on.grid
                asked = rate if sensor.name == "position" else 10.0
                assert mean == pytest.approx(problem.model.values[o.noise] ** 2 / asked)


def test_error_of_a_gain_falls_with_the_root_of_the_rate() -> None:
    steps = StepInput(6, 1, 40.0, 0.4, 0.4)
    levels, durations = steps.unpack(steps.random(1, np.random.default_rng(2)))
    error = {}
    for rate in (4.0, 7.0, 10.0, 15.0):
        problem = DesignProblem(gain_and_offset(), steps, rates={"meter": rate})
        error[rate] = predicted_errors(problem, problem.finer.actuation.limited(levels, durations)[:, :, 0])["a"]
    for rate, found in error.items():
        assert found == pytest.approx(error[10.0] * np.sqrt(10.0 / rate), rel=0.03)


def test_work_of_the_thrusters_equals_that_of_a_log() -> None:
    t = np.arange(0.0, 8.0, 0.1)
    n = np.stack([np.sin(t), np.where(t < 4.0, 0.6, -0.3)], axis=1)
    model = horizontal_model(current=False) + catalogue()["battery-sag"]
    actuation = replace(ThrusterResponse(model, t), pole=np.inf)
    shafts = {f"n_{side}": Channel(t, n[:, k]) for k, side in enumerate(("left", "right"))}
    record = build_record(model, shafts | {"psi": Channel(t, np.zeros(t.size))}, rate=10.0)
    designed = actuation.inputs(n[:, :, None])[:, [i.name for i in model.inputs].index("work"), 0]
    logged = record.u[:, record.inputs.index("work")]
    np.testing.assert_allclose(designed, np.interp(t, record.t, logged), atol=1e-6)
    assert designed[0] == 0.0 < designed[-1]


def test_inputs_of_other_models() -> None:
    t = np.arange(0.0, 8.0, 0.1)
    n = np.where(t < 4.0, 0.5, -0.4)[:, None, None]
    for model, thrusters, sign in (
        (surge_model("force"), 2, 1.0),
        (yaw_model(), 2, -1.0),
        (surge_model("shaft"), 2, 1.0),
    ):
        actuation = replace(ThrusterResponse(model, t), pole=np.inf)
        assert len(actuation.thrusters) == thrusters
        np.testing.assert_array_equal(actuation.for_thrusters(np.array([[0.5]])), [[0.5, 0.5 * sign]])
    force = replace(ThrusterResponse(surge_model("force"), t), pole=np.inf).inputs(n)[0, 0, 0]
    assert force == pytest.approx(2 * (40.05 + 1.11) * 0.25)
    moment = replace(ThrusterResponse(yaw_model(), t), pole=np.inf).inputs(n)[0, 0, 0]
    assert moment == pytest.approx(0.15 * 2 * 40.05 * 0.25)
    both = np.concatenate([n, -n], axis=1)
    general = replace(ThrusterResponse(horizontal_model("general"), t), pole=np.inf)
    assert general.channels == ("left", "right")
    np.testing.assert_allclose(general.inputs(both)[0, :, 0], [2 * 1.11 * 0.25, moment])
    bow = replace(surge_model("force"), inputs=(Input("f_bow", "N"),))
    thrust = replace(ThrusterResponse(bow, t), pole=np.inf).inputs(n)[0, 0, 0]
    assert thrust == pytest.approx((40.05 + 1.11) * 0.25)
    past = ThrusterResponse(horizontal_model() + catalogue()["delay"], t)
    u = past.inputs(both)[:, :, 0]
    names = [i.name for i in past.model.inputs]
    np.testing.assert_allclose(u[20:, names.index("n_left~3")], u[17:-3, names.index("n_left")], atol=1e-12)


def test_baseline_signals_have_their_bandwidth() -> None:
    t, rng = np.arange(0.0, 600.0, 0.2), np.random.default_rng(1)
    binary = prbs(t, 5.0, 2, 0.7, rng)
    assert set(np.unique(binary)) == {-0.7, 0.7}
    switches = t[1:][np.diff(binary[:, 0]) != 0]
    np.testing.assert_allclose(np.mod(switches + 1e-6, 5.0), 0.0, atol=1e-3)
    slow, fast = (rgs(t, f, 1, 0.4, 1.0, np.random.default_rng(2))[:, 0] for f in (0.01, 0.2))
    assert np.abs(slow).max() <= 1.0
    assert slow.std() == pytest.approx(0.4, abs=0.05)
    assert np.abs(np.diff(fast)).mean() > 5 * np.abs(np.diff(slow)).mean()


def test_the_filter_of_many_sequences_is_designed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    designed, design_filter = [], signal.butter

    def counted(*arguments: Any, **options: Any) -> Any:
        designed.append(arguments)
        return design_filter(*arguments, **options)

    monkeypatch.setattr(signal, "butter", counted)
    t, rng = np.arange(0.0, 60.0, 0.2), np.random.default_rng(1)
    first, second = (rgs(t, 0.0731, 1, 0.4, 1.0, rng) for _ in range(2))
    assert len(designed) == 1
    assert not np.array_equal(first, second)


def small_design() -> Design:
    return design(boat_task(80.0, 16, rates={"position": 5.0, "ground_velocity": 5.0}), evaluations=600)


@pytest.mark.study
def test_repeats_have_the_predicted_errors() -> None:
    found = repeat_design(small_design(), 24, seed=3)
    assert [repeated.name for repeated in found] == ["m_u", "m_v", "m_r", "d_u", "d_v", "d_r", "d_uu", "d_vv", "d_rr"]
    for repeated in found:
        assert repeated.n >= 22
        assert repeated.outliers <= 2
        # Nine intervals are tested. Each misses once in a thousand.
        df = repeated.n - repeated.outliers - 1
        assert 0.0005 < stats.chi2.cdf(df * repeated.ratio**2, df) < 0.9995, repeated
    assert 0.88 < np.mean([repeated.coverage for repeated in found]) < 0.99
    assert np.mean([repeated.ratio for repeated in found]) == pytest.approx(1.0, abs=0.15)


def late(model: Model, name: str) -> Model:
    return (model + catalogue()[name]).with_values({"tau_delay": 0.2} if name == "delay" else {"T_lag": 0.2})


def test_discrimination_reports_each_phase_before_and_after_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiling both models and the random start points took most of a minute without a word."""
    problem = boat_task(20.0, 8)
    a, b = late(problem.model, "delay"), late(problem.model, "lag")
    lines = list[str]()

    def quick(self: HypothesisPair, command: np.ndarray, refits: int = 0) -> np.ndarray:
        return 40.0 + np.mean(command**2, axis=(0, 1))

    monkeypatch.setattr(HypothesisPair, "__call__", quick)
    discriminate(
        a,
        b,
        problem,
        evaluations=500,
        progress=lambda n, merit, number, of: lines.append("search"),
        phase=lines.append,
    )
    starts = ["compiling both models", *(f"random start points, {n} of 128" for n in (32, 64, 96))]
    assert lines[: len(starts)] == starts
    assert set(lines[len(starts) : -1]) == {"search"}
    assert lines[-1] == "comparison after refits"


@pytest.mark.study
def test_designed_mission_discriminates_delay_and_lag_better_than_random_missions() -> None:
    problem = boat_task(20.0, 8)
    a, b = late(problem.model, "delay"), late(problem.model, "lag")
    found = discriminate(a, b, problem, evaluations=500)
    random = [
        min(separation(a, b, problem, problem.commands(z[None])[:, :, 0]))
        for z in problem.steps.random(4, np.random.default_rng(8))
    ]
    assert found.clear
    assert min(found.separation) > 2 * max(random)
    with pytest.raises(SeatrialError, match="different sensors"):
        discriminate(a, late(horizontal_model(sensors=("gyro",), current=False), "lag"), problem)


def test_baseline_signals_of_a_discrimination_are_the_best_by_its_own_criterion() -> None:
    a, b = (late(horizontal_model(sensors=("gyro",), current=False), effect) for effect in ("delay", "lag"))
    problem = DesignProblem(a, StepInput(4, 2, 10.0, 1.0, GRID))
    by_information = baseline_signals(problem, n=3)
    found = baselines_apart(a, b, problem, by_information)
    assert list(found) == ["PRBS", "RGS"]
    for kind, baseline in found.items():
        T = [min(separation(a, b, problem, baseline.sequences[:, :, k])) for k in range(3)]
        np.testing.assert_allclose(baseline.values, T, rtol=1e-6)
        assert baseline.value == pytest.approx(max(T))
        np.testing.assert_array_equal(baseline.command, baseline.sequences[:, :, int(np.argmax(T))])
        same = [np.array_equal(by_information[kind].command, baseline.sequences[:, :, k]) for k in range(3)]
        assert any(same)  # the bandwidth and amplitude are those of the most informative sequence


def test_separation_equals_the_loss_of_a_fit_of_the_wrong_model() -> None:
    """T is twice the gain in log-likelihood of the right model over the refitted wrong model, on undisturbed data."""
    base = horizontal_model(sensors=("attitude", "gyro", "position"), current=False)
    problem = DesignProblem(base, StepInput(6, 2, 20.0, 1.0, 0.1), grid=0.1)
    a, b = late(base, "delay"), late(base, "lag")
    command = problem.commands(problem.steps.random(1, np.random.default_rng(5)))
    apart = separation(a, b, problem, command[:, :, 0])[0]
    u = ThrusterResponse(b, problem.t).inputs(command)[:, :, 0]
    record = planned_record(b, problem.t, u)
    wide = [replace(p, prior=None) for p in a.parameters]
    wrong = a.replace_parameters(*wide).with_free(HypothesisPair(a, b, problem).free)
    columns = [[i.name for i in b.inputs], [i.name for i in a.inputs]]
    seen = planned_record(a, problem.t, ThrusterResponse(a, problem.t).inputs(command)[:, :, 0])
    assert columns[0] != columns[1]
    fitted = fit(wrong, [replace(seen, y=record.y)])
    right = b.with_free(["m_u"])
    exact = fit(right, [record], settings=SearchSettings(max_iterations=0)).log_likelihood
    assert apart > 10.0
    assert 2 * (exact - fitted.log_likelihood) == pytest.approx(apart, rel=0.1)


def test_band_of_the_track_equals_that_of_sampled_boats() -> None:
    made = small_design()
    track = predicted_track(made)
    assert track is not None
    model = made.problem.model
    record = planned_record(model, made.problem.t_whole, made.problem.whole_inputs(made.command[:, :, None])[:, :, 0])
    x = simulate(model, record).x
    at = np.searchsorted(made.problem.t_whole, track.t)
    np.testing.assert_allclose(np.hypot(track.x - x[at, 0], track.y - x[at, 1]), 0.0, atol=1e-9)
    away = np.hypot(track.others[:, :, 0] - track.x, track.others[:, :, 1] - track.y)
    share = np.mean(away <= track.radius, axis=0)[1:]
    assert np.all((share > 0.9) & (share < 0.97))
    fresh, _ = simulate_stochastic(
        model,
        SampledInputs.linear(record.t, record.u),
        made.evaluator.samples(20, 9),
        [np.random.default_rng([5, k]) for k in range(20)],
        x0=np.zeros((20, 6)),
        substep=0.2,
    )
    far = np.hypot(fresh[:, at, 0] - track.x, fresh[:, at, 1] - track.y)
    assert np.mean(far <= track.radius) > 0.75
