"""Tests that every number of a fit states its origin, and that no number is held without a source.

A parameter of a built-in model or effect is built-in until data, a rig file or the user give it. The held ones, which
the data do not change, are listed here one by one: the thrust and the arms (masses are then reported as ratios to
them), the process noise beside disturbance forces, the time constant of an inner loop and the dead zone of a command.
"""

from __future__ import annotations

import pytest

from seatrial.ident.effects.nonparametric import input_response_effects, nonparametric_effect
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.homogeneity import between_runs_effect
from seatrial.ident.model.parameter import Parameter, ParameterOrigin
from seatrial.ident.model.structure import ForceCurve
from seatrial.ident.models.catalogue import make_model
from seatrial.ident.models.components import antenna_component, current_walk, telemetry_age
from seatrial.ident.models.disturbances import shaft_disturbance, with_disturbances
from seatrial.ident.models.horizontal import SENSORS, horizontal_model
from tests.ident.carriers import carrier

THRUST, ARMS = {"c1", "c2"}, {"y_left", "y_right"}
PROCESS_NOISE = {"s_u", "s_v", "s_r"}
HELD = {
    "horizontal:shaft": THRUST | ARMS | PROCESS_NOISE,
    "horizontal:command": THRUST | ARMS | PROCESS_NOISE,
    "horizontal:force": ARMS | PROCESS_NOISE,
    "horizontal:general": PROCESS_NOISE,
    "kinematic:shaft": THRUST | ARMS | {"s_u", "s_v"},
    "kinematic:force:yaw": ARMS | PROCESS_NOISE,
    "nomoto": THRUST | {"T", "s_u", "s_r"},
    "nomoto:sampled": THRUST | {"T", "s_u", "s_r"},
    "surge": set(),
    "yaw": set(),
    "thruster": {"d", "s_n"},
}


def origins(parameters: tuple[Parameter, ...]) -> set[ParameterOrigin]:
    return {p.origin for p in parameters}


@pytest.mark.parametrize("source", HELD)
def test_numbers_of_a_model_are_built_in_and_held_numbers_are_listed(source: str) -> None:
    model = make_model(source, tuple(SENSORS))
    if source not in ("surge", "yaw"):
        model = with_disturbances(model)
    assert origins(model.parameters) == {ParameterOrigin.BUILT_IN}
    assert {p.name for p in model.parameters if p.exact} == HELD[source]


@pytest.mark.parametrize("name", catalogue())
def test_numbers_of_an_effect_are_built_in_and_not_held(name: str) -> None:
    effect = catalogue()[name]
    added = (carrier(effect) + effect).parameters[len(carrier(effect).parameters) :]
    assert added
    assert origins(added) == {ParameterOrigin.BUILT_IN}
    assert not [p.name for p in added if p.exact]


def test_numbers_of_an_unknown_effect_are_built_in_and_not_held() -> None:
    model = horizontal_model("shaft")
    effects = [
        nonparametric_effect(model, ForceCurve("N", "u"), (0.0, 1.0)),
        nonparametric_effect(model, ForceCurve("N", "u", "r"), (0.0, 1.0)),
        *input_response_effects(model),
        *(between_runs_effect(model, name) for name in ("m_v", "thrust", "payload")),
        current_walk(),
        telemetry_age(),
        shaft_disturbance(),
    ]
    for effect in effects:
        assert origins(effect.parameters) == {ParameterOrigin.BUILT_IN}, effect.name
        assert not [p.name for p in effect.parameters if p.exact], effect.name


def test_position_from_the_rig_file_is_given() -> None:
    antenna = antenna_component(horizontal_model("shaft"), (0.4, 0.0, -0.8))
    assert origins(antenna.parameters) == {ParameterOrigin.GIVEN}
