"""Tests that the order in which effects are added does not change the model."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, reduce
from itertools import combinations
from operator import add

import numpy as np
import pytest

from seatrial.ident.effects.nonparametric import input_response_effects, nonparametric_effect
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine.vectorised_model import VectorisedModel
from seatrial.ident.model.structure import Effect, ForceCurve, Model
from seatrial.ident.models.catalogue import make_model
from seatrial.ident.models.components import antenna, current_walk, estimator_error, telemetry_age, thrust_calibration
from seatrial.ident.models.disturbances import (
    disturbance_of,
    residuals_of,
    sensor_bias,
    sensor_errors_of,
    thrust_losses_of,
    with_disturbances,
)
from seatrial.ident.models.horizontal import SENSORS

ROWS = 6


def all_effects(base: Model) -> list[Effect]:
    """Return every effect that the model accepts: catalogue, components, disturbances and curves of every residual."""
    sensors = [s.name for s in base.sensors]
    found = [*catalogue().values(), current_walk(), telemetry_age(), estimator_error(sensors), disturbance_of(base)]
    found += [sensor_bias(sensors), antenna(0.7, -0.4), *input_response_effects(base)]
    if not {"n", "n_input"} & set(base.provides):  # Models with a given thrust.
        found.append(thrust_calibration(base))
    found += [nonparametric_effect(base, ForceCurve(r.name, "u"), (-1.0, 1.5)) for r in residuals_of(base)]
    whole = with_disturbances(base)  # The model with the sensor offsets that the curves of sensor errors need.
    found += [nonparametric_effect(whole, ForceCurve(r.name, "r"), (-1.0, 1.0)) for r in sensor_errors_of(whole)]
    found += [nonparametric_effect(base, ForceCurve(r.name, "r"), (-1.0, 1.0)) for r in thrust_losses_of(base)]
    return [e for e in found if base.accepts(e)]


@cache
def drawn(kind: str, name: str, low: float, high: float, n: int) -> np.ndarray:
    return np.random.default_rng(list(f"{kind} {name}".encode())).uniform(low, high, n)


def at_random(model: Model) -> dict[str, np.ndarray]:
    """Return rates and outputs by name, at states, inputs and parameters that depend only on their names."""

    def value(name: str) -> float:
        p = model.parameter(name)
        width = p.prior[1] if p.prior is not None else 0.3 * abs(p.value) + p.step
        away = p.value + width * (0.2 + 0.5 * drawn("p", name, 0.0, 1.0, 1)[0])
        return float(np.clip(away, *p.bounds))

    x = np.column_stack([drawn("x", s.name, -1.0, 1.0, ROWS) for s in model.states])
    u = np.column_stack([drawn("u", i.name, -1.0, 1.0, ROWS) for i in model.inputs])
    both = VectorisedModel(model)(x, u, np.array([value(n) for n in model.values]))
    return dict(zip([*(s.name for s in model.states), *(f"y {o.name}" for o in model.outputs)], both.T, strict=True))


def differences(base: Model, effects: Sequence[Effect]) -> list[str]:
    """Return the rates and outputs that differ if the effects are added in reverse order."""
    forward, reversed_order = (at_random(reduce(add, order, base)) for order in (effects, effects[::-1]))
    assert all(np.isfinite(v).all() for v in forward.values())
    return [n for n in forward if not np.allclose(forward[n], reversed_order[n], rtol=1e-12, atol=1e-12)]


@pytest.mark.parametrize(
    "source",
    [
        "horizontal:shaft",
        "horizontal:command",
        "horizontal:force",
        "horizontal:general",
        "nomoto",
        "nomoto:sampled",
        "kinematic:shaft:yaw",
        "kinematic:force",
    ],
)
def test_two_effects_give_the_same_model_in_any_order(source: str) -> None:
    base = make_model(source, tuple(SENSORS))
    effects = all_effects(base)
    assert len(effects) > 3
    found = {}
    for a, b in combinations(effects, 2):
        meet = set(a.hooks) & set(b.hooks) or {i.name for i in a.inputs} & {i.name for i in b.inputs}
        if meet and (base + a).accepts(b) and (differs := differences(base, [a, b])):
            found[a.name, b.name] = differs
    assert found == {}


@pytest.mark.parametrize("source", ["horizontal:shaft", "horizontal:command", "horizontal:force", "nomoto"])
def test_all_effects_together_give_the_same_model_in_any_order(source: str) -> None:
    base = make_model(source, tuple(SENSORS))
    together: list[Effect] = []
    for effect in all_effects(base):
        if reduce(add, together, base).accepts(effect):
            together.append(effect)
    assert differences(base, together) == []


@pytest.mark.parametrize("source", ["horizontal:shaft", "horizontal:command", "nomoto"])
def test_removed_effect_leaves_the_model_as_before(source: str) -> None:
    """An effect that was added later stays, with the inputs that both effects use."""
    base, latency = make_model(source, tuple(SENSORS)), catalogue()["gnss-latency"]
    for effect in all_effects(base):
        assert (base + effect).without(effect.name) == base
        if effect.name != latency.name and (base + effect).accepts(latency):
            assert set((base + effect + latency).without(effect.name).inputs) == set((base + latency).inputs)
    assert base.without("mooring") == base
