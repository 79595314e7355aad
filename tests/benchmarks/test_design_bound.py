"""Tests of the upper bound on D: tight at a known optimum, never below a search result, refused outside its scope."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.thesis.design_bound import as_point, upper_bound
from seatrial.ident.experiment_design.evaluator import DesignEvaluator
from seatrial.ident.experiment_design.excitation import StepInput
from seatrial.ident.experiment_design.optimal_design import design
from seatrial.ident.experiment_design.problem import DesignLimits, DesignProblem
from tests.ident.experiment_design.test_optimal_design import boat_task, gain_and_offset


def test_the_bound_is_tight_at_a_known_optimum() -> None:
    problem = DesignProblem(gain_and_offset(), StepInput(6, 1, 40.0, 0.4, 0.4), rates={"meter": 2.5}, grid=0.4)
    object.__setattr__(problem, "actuation", replace(problem.actuation, pole=np.inf))
    made = design(problem, evaluations=3000)
    bound = upper_bound(made, rounds=1, evaluations=1500)
    assert made.value <= bound.value + 1e-9
    assert bound.value == pytest.approx(2 * np.log(made.command.shape[0]), abs=0.15)


def test_no_sequence_exceeds_the_bound() -> None:
    made = design(boat_task(40.0, 8, seed=2), evaluations=600)
    bound = upper_bound(made, rounds=1, evaluations=1500)
    assert bound.value > made.value
    problem = replace(made.problem, steps=StepInput(16, 2, 40.0, 1.0, made.problem.grid))
    value, _ = DesignEvaluator(problem).evaluate(problem.commands(problem.steps.random(256, np.random.default_rng(3))))
    assert value.max() < bound.value
    better = design(replace(problem, seed=5), evaluations=1500)
    assert better.value < bound.value


def test_the_bound_is_refused_outside_its_scope() -> None:
    made = design(boat_task(20.0, 4, limits=DesignLimits(energy=0.9)), evaluations=500)
    with pytest.raises(ValueError, match="without limits"):
        upper_bound(made)


def test_a_command_is_represented_on_finer_steps() -> None:
    steps = StepInput(12, 2, 30.0, 0.4, 0.2)
    coarse = StepInput(5, 2, 30.0, 1.0, 0.2)
    problem = replace(boat_task(30.0, 5), steps=coarse)
    command = problem.commands(coarse.random(1, np.random.default_rng(1)))[:, :, 0]
    again = replace(problem, steps=steps).commands(as_point(steps, command, 0.2)[None])[:, :, 0]
    assert np.mean(np.abs(again - command).max(axis=1) > 1e-9) < 0.2  # the edges of a step may move by one or two rows
    assert set(np.unique(again)) <= set(np.unique(command))
