"""Tests of the extent of tracks: the kernels against plain simulation, and process noise against another integrator."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from seatrial.daq.errors import SeatrialError
from seatrial.ident.estimation.output_error import simulate
from seatrial.ident.estimation.stochastic_simulation import SampledInputs, simulate_stochastic
from seatrial.ident.experiment_design.evaluator import N_TRACKS, DesignEvaluator
from seatrial.ident.experiment_design.excitation import StepInput
from seatrial.ident.experiment_design.information import Experiments, planned_record
from seatrial.ident.experiment_design.prior import ParameterPrior
from seatrial.ident.experiment_design.problem import COAST_S, GRID, REST_S, DesignLimits, DesignProblem
from seatrial.ident.experiment_design.track_extent import TrackExtent, in_current, with_noise_inputs
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.surge import surge_model
from tests.ident.toys import values_of

Array = NDArray[np.float64]
SECONDS, N = 60.0, 200


def circles() -> tuple[DesignProblem, Array]:
    """Return the inputs (n_rows, n_inputs, 1) of a boat that turns to one side and then to the other, with their
    problem.
    """
    problem = DesignProblem(
        horizontal_model(current=False), StepInput(4, 2, SECONDS, 1.0, GRID), prior=ParameterPrior((), 0.0)
    )
    levels = np.array([[[0.5], [0.3]], [[0.3], [0.5]], [[0.6], [0.3]], [[0.3], [0.6]]])
    return problem, problem.actuation.inputs(problem.actuation.limited(levels, np.full((4, 1), SECONDS / 4)))


def test_extent_without_noise_equals_a_plain_simulation() -> None:
    problem, u = circles()
    reach = TrackExtent(problem.model, problem.t, values_of(problem.model)[None], [1])
    low, high = reach(np.repeat(u, 3, axis=2))
    x = simulate(problem.model, planned_record(problem.model, problem.t, u[:, :, 0])).x
    for side, found in ((low, x.min(axis=0)), (high, x.max(axis=0))):
        assert side.shape == (3, 1, 7)
        np.testing.assert_allclose(side[:, 0, :6], np.tile(found, (3, 1)), atol=1e-8)


def test_inputs_of_a_command_model_are_not_copied_for_each_boat() -> None:
    """Copies of dozens of delayed inputs for 25 boats took ten times as long as the simulation, and gigabytes."""
    model = horizontal_model("command")
    t = np.arange(400) * 0.05
    problem = DesignProblem(model, StepInput(4, 2, 20.0, 1.0, GRID), grid=0.05)
    u = replace(problem.actuation, t=t).inputs(0.5 * np.sin(np.arange(400 * 2 * 3).reshape(400, 2, 3)))
    assert u.shape[1] > 20
    boats = np.tile(values_of(model), (26, 1)) * np.random.default_rng(1).uniform(0.9, 1.1, (26, 1))
    reach = TrackExtent(model, t, boats, [1])
    reach(u[:, :, :1])
    tracemalloc.start()
    low, high = reach(u)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < u.nbytes * len(boats) / 3
    every = np.concatenate([np.repeat(u, 26, axis=2), np.tile(reach.noise, (1, 1, 3))], axis=1)
    one_by_one = Experiments(with_noise_inputs(model)[0], (), t, process_noise=False)
    for side, expected in zip((low, high), one_by_one.extents(every, np.tile(boats, (3, 1))), strict=True):
        np.testing.assert_allclose(side.reshape(expected.shape), expected, rtol=1e-12, atol=1e-12)


def test_process_noise_spreads_the_boats_like_another_integrator() -> None:
    problem, u = circles()
    boats = np.tile(values_of(problem.model), (N + 1, 1))
    reach = TrackExtent(problem.model, problem.t, boats, [1])
    low, high = (side[0, 1:] for side in reach(u))
    rngs = [np.random.default_rng([5, k]) for k in range(N)]
    inputs = SampledInputs.linear(problem.t, u[:, :, 0])
    noisy = simulate_stochastic(problem.model, inputs, boats[1:], rngs, x0=np.zeros((N, 6)), substep=GRID / 2)[0]
    for column, name in enumerate(s.name for s in problem.model.states):
        for ours, theirs in ((low, noisy.min(axis=1)), (high, noisy.max(axis=1))):
            mean, sd = theirs[:, column].mean(), theirs[:, column].std()
            if sd < 2e-3:  # The start is an extreme of most boats, and the rest of the distribution has long tails.
                continue
            # Four standard errors of the difference of two means, and of the ratio of two standard deviations.
            assert abs(ours[:, column].mean() - mean) < 4 * sd * np.sqrt(2 / N) + 1e-9, name
            assert ours[:, column].std() == pytest.approx(sd, rel=4 / np.sqrt(N), abs=1e-9), name
    assert low[:, 0].std() > 0.5  # The spread [m] is relevant.


def test_seed_determines_the_noise_and_the_first_boat_has_none() -> None:
    problem, u = circles()
    boats = np.tile(values_of(problem.model), (4, 1))
    first, same_seed, another_seed = (TrackExtent(problem.model, problem.t, boats, [seed]) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.noise, same_seed.noise)
    assert not first.noise[:, :, 0].any()
    assert np.abs(first.noise - another_seed.noise)[:, :, 1:].min() > 0.0
    model, names = with_noise_inputs(problem.model)
    assert names == ["u", "v", "r"]
    assert [i.name for i in model.inputs] == ["n_left", "n_right", "w_u", "w_v", "w_r"]
    many = np.concatenate([u] * 40, axis=2)  # This is more than one batch of boats.
    low, _ = first(many)
    np.testing.assert_array_equal(low, np.repeat(low[:1], 40, axis=0))


def test_current_moves_the_boats() -> None:
    model = horizontal_model()
    boats = np.tile(values_of(model), (400, 1))
    found = in_current(model, boats, 0.2, np.random.default_rng(1))
    at = [[p.name for p in model.parameters].index(n) for n in ("V_x", "V_y")]
    speed = np.hypot(*found[:, at].T)
    assert 0.19 < speed.max() <= 0.2
    assert speed.mean() == pytest.approx(0.2 * 2 / 3, rel=0.1)  # This is the mean radius of a uniform disc.
    assert np.abs(found[:, at].mean(axis=0)).max() < 0.02
    np.testing.assert_array_equal(np.delete(found, at, axis=1), np.delete(boats, at, axis=1))
    assert in_current(model, boats, 0.0, np.random.default_rng(1)) is boats
    with pytest.raises(SeatrialError, match="--current cannot be simulated"):
        in_current(horizontal_model(current=False), boats, 0.1, np.random.default_rng(1))
    still = np.zeros((300, 2, 1))
    low, high = TrackExtent(model, np.arange(300) * GRID, found[:3], [1])(still)
    drifted = np.maximum(np.abs(low), np.abs(high))[0, 1:, :2]
    np.testing.assert_allclose(drifted, np.abs(found[1:3][:, at]) * 299 * GRID, atol=1.5)


def test_area_covers_the_rest_before_and_the_coasting_after() -> None:
    """A current moves the boat during the whole mission. Thrust ends with the steps, but the motion continues."""
    model = horizontal_model().with_values({"s_u": 1e-9, "s_v": 1e-9, "s_r": 1e-9})
    limits = DesignLimits(area=(9.0, 9.0), current=0.2)
    problem = DesignProblem(
        model, StepInput(2, 2, 20.0, 1.0, GRID), limits=limits, prior=ParameterPrior((), 0.0), seed=2
    )
    command = np.zeros((problem.t.size, 2, 2))
    command[:, :, 1] = 0.5
    evaluator = DesignEvaluator(problem)
    fastest = max(np.abs(evaluator.boats(N_TRACKS, 2)[:, list(model.values).index("V_x")]))
    low, high = evaluator.extents(command)
    north = evaluator.experiments.extremes.index("x")
    assert max(-low[0, north], high[0, north]) == pytest.approx(fastest * (REST_S + 20.0 + COAST_S), rel=0.1)
    u = problem.whole_inputs(command)[:, 0, 1]
    assert not u[: round(REST_S / GRID) + 1].any()
    assert u[round((REST_S + 19.0) / GRID)] == pytest.approx(0.5)
    assert abs(u[-1]) < 1e-9


def test_noise_and_current_increase_the_area_violation() -> None:
    """The violation grows with the uncertainty, so a design without violation stays inside the area."""
    belief, area = ParameterPrior(("d_v",), 0.02), (8.0, 8.0)
    steps = StepInput(8, 2, SECONDS, 1.0, GRID)
    calm = horizontal_model().with_values({"s_u": 1e-6, "s_v": 1e-6, "s_r": 1e-6})
    quiet, noisy, drifting = (
        DesignProblem(model, steps, prior=belief, limits=DesignLimits(area=area, current=current), seed=3)
        for model, current in ((calm, 0.0), (horizontal_model(), 0.0), (horizontal_model(), 0.2))
    )
    command = quiet.commands(steps.random(12, np.random.default_rng(4)))
    broken = [DesignEvaluator(problem).violation(command) for problem in (quiet, noisy, drifting)]
    assert (broken[1] >= broken[0] - 1e-6).all()
    assert broken[1].sum() > broken[0].sum() + 0.1
    assert broken[2].sum() > broken[1].sum() + 0.1


def test_model_without_process_noise_has_no_noise_inputs() -> None:
    model = surge_model("force", "position").with_values({})
    quiet, names = with_noise_inputs(
        type(model)(
            **{**model.__dict__, "states": tuple(type(s)(**{**s.__dict__, "noise": 0.0}) for s in model.states)}
        )
    )
    assert names == []
    assert [i.name for i in quiet.inputs] == [i.name for i in model.inputs]
