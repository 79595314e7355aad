"""Tests of rough fits that hold the parameters which an added effect hardly moves."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from seatrial.ident.diagnosis import rough_fits
from seatrial.ident.diagnosis.findings import CommonErrorsFit
from seatrial.ident.diagnosis.rough_fits import changed_estimates, with_held_parameters, with_held_priors
from seatrial.ident.diagnosis.search import _Search, score_equations
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.cross_validation import TimeBlocks
from seatrial.ident.estimation.fitted_model import fit_and_evaluate
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.reporter import QUIET
from tests.ident.sliders import PUSH, slide, slider

NOMINAL = with_disturbances(horizontal_model())
WIND = catalogue()["wind"]


def fit_of(parameters: tuple[Parameter, ...]) -> Any:
    """Return a stand-in for a fit of the boat in which each standard error is one unit of the parameter."""
    fake = type("FakeFit", (), {})()
    fake.model, fake.parameters, fake.errors = NOMINAL, parameters, np.ones(len(parameters))
    fake.start_values = lambda _: {p.full_name: p.value for p in parameters}
    fake.estimate = lambda name: (NOMINAL.values[name], 1.0)
    return cast(Any, fake)


def test_parameters_that_hardly_change_are_held_at_their_expected_values() -> None:
    free = [p for p in NOMINAL.parameters if p.free and not p.per_record]
    model, noises = NOMINAL + WIND, NOMINAL.noises
    damping = [p.name for p in free if p.name not in noises]
    expected = {n: 0.01 * k for k, n in enumerate(damping)}
    held = with_held_parameters(model, fit_of(tuple(free)), expected)
    gone = [n for n in model.free if n not in held.free]
    kept = len(model.free) - len(gone)
    assert kept % rough_fits.FREE_AT_ONCE == 0
    assert kept >= rough_fits.FREE
    assert gone == damping[: len(gone)]  # those with the smallest changes
    for name in gone:
        p = NOMINAL.parameter(name)
        change = expected[name]
        assert held.values[name] == pytest.approx(
            p.value * np.exp(change / p.value) if p.transform == "log" else p.value + change
        )
    assert {p.name for p in WIND.parameters if p.free} <= set(held.free)
    assert not set(gone) & noises
    # What changes by more than its standard error is estimated, and so is what is asked for.
    moved = with_held_parameters(model, fit_of(tuple(free)), dict.fromkeys(damping, 1.5))
    assert moved.free == model.free
    wanted = with_held_parameters(model, fit_of(tuple(free)), expected, estimated=gone[:1])
    assert gone[0] in wanted.free
    assert with_held_parameters(model, fit_of(tuple(free)), {}) is model


def test_expected_values_are_within_their_bounds() -> None:
    mass = replace(NOMINAL.parameter("m_u"), bounds=(30.0, 50.0), value=40.0, transform="none")
    assert changed_estimates(fit_of((mass,)), {"m_u": 25.0}) == {"m_u": 50.0}
    assert changed_estimates(fit_of((mass,)), {}) == {}
    assert changed_estimates(fit_of((replace(mass, transform="log"),)), {"m_u": 5.0}) == {"m_u": 40.0}


@pytest.mark.parametrize("sd", [None, 0.02])
def test_gain_of_a_fit_with_held_parameters_is_that_of_all(monkeypatch: pytest.MonkeyPatch, sd: float | None) -> None:
    """The prior of a held parameter counts: without it, a fit that holds would seem to gain more."""
    monkeypatch.setattr(rough_fits, "FREE", 2)
    monkeypatch.setattr(rough_fits, "FREE_AT_ONCE", 1)
    record, nominal = slide(7, 900, push=0.05), slider()
    if sd is not None:
        nominal = nominal.replace_parameters(replace(nominal.parameter("m"), prior=(1.1 * nominal.values["m"], sd)))
    before = fit_and_evaluate(nominal, [record], ())
    equations = score_equations(before, [record], {PUSH.name: PUSH})
    step = equations.one_step(np.array([*equations.columns_of("push", {}).values()]), np.zeros(1))
    changes = equations.shifts("push", {}, {"k_push": float(step[0])})
    larger = before.fit.model + PUSH
    model = with_held_parameters(larger, before.fit, changes)
    assert len(model.free) == len(larger.free) - 1
    whole = fit_and_evaluate(larger, [record], ()).fit.log_posterior - before.fit.log_posterior
    fitted = with_held_priors(fit_and_evaluate(model, [record], ()), model, larger)
    part = fitted.fit.log_posterior - before.fit.log_posterior
    assert whole > 5.0
    assert 0.97 * whole < part <= whole + 1e-3
    if sd is not None:
        assert fit_and_evaluate(model, [record], ()).fit.log_posterior - before.fit.log_posterior > 1.1 * whole


def test_parameters_are_held_only_beside_common_errors_and_without_blocks() -> None:
    free = tuple(p for p in NOMINAL.parameters if p.free)
    model, fit, changes = NOMINAL + WIND, fit_of(free), {"m_u": 0.01}
    mine = _Search([], [], {}, QUIET)
    assert mine._with_held_parameters(model, fit, changes) is model
    mine.common_errors = CommonErrorsFit((), cast(Any, None))
    assert len(mine._with_held_parameters(model, fit, changes).free) < len(model.free)
    mine.validation_data = TimeBlocks((), ())
    assert mine._with_held_parameters(model, fit, changes) is model
