"""Tests of the refits that a diagnosis writes to model.toml for the design of the next mission."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

from seatrial.ident.diagnosis.findings import Diagnosis
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.homogeneity import between_runs_effect
from seatrial.ident.estimation.model_file import SavedModel
from seatrial.ident.model.structure import Effect
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.workflows.design import hypotheses
from seatrial.ident.workflows.diagnose import refitted_effects

ERRORS = {"tau_delay": 0.02, "F_north": 0.5}  # any other parameter has no standard error


def refit(effect: Effect, values: dict[str, float], *beside: str) -> Any:
    """Return a stand-in for a refit of an effect, beside other effects of the catalogue."""
    model = with_disturbances(horizontal_model())
    for name in beside:
        model = model + catalogue()[name]
    model = (model + effect).with_values(values)
    fit = SimpleNamespace(
        model=model, estimate=lambda name: (model.values[name], ERRORS.get(name, float("nan"))), errors={}
    )
    return SimpleNamespace(effect=effect, fitted=SimpleNamespace(fit=fit))


def test_each_effect_that_was_tried_is_kept_with_its_estimates() -> None:
    delay, pull = catalogue()["delay"], catalogue()["steady-pull"]
    between = between_runs_effect(horizontal_model(), "m_u")
    first = SimpleNamespace(refits=[refit(delay, {"tau_delay": 0.3}), refit(between, {})])
    second = SimpleNamespace(refits=[refit(pull, {"F_north": 4.0, "F_east": -2.0}, "wind", "lag")])
    late, pulled = refitted_effects(cast(Diagnosis, SimpleNamespace(rounds=[first, second])))
    assert (late.name, late.beside, late.values, late.errors) == (
        "delay", (), {"tau_delay": 0.3}, {"tau_delay": 0.02},
    )  # fmt: skip
    assert (pulled.name, pulled.beside) == ("steady-pull", ("wind", "lag"))
    assert pulled.values == {"F_north": 4.0, "F_east": -2.0}
    assert pulled.errors == {"F_north": 0.5}


def test_two_candidates_of_a_diagnosis_are_discriminated_at_their_fitted_sizes() -> None:
    """Neither candidate was added to the model, and both had a refit: the design is for the two sizes of the boat."""
    delay, pull = catalogue()["delay"], catalogue()["steady-pull"]
    rounds = [SimpleNamespace(refits=[refit(delay, {"tau_delay": 0.3}), refit(pull, {"F_north": 4.0})])]
    found = cast(Diagnosis, SimpleNamespace(rounds=rounds))
    saved = SavedModel(horizontal_model(), {}, {}, refits=refitted_effects(found))
    late, pulled = hypotheses(saved, ("delay", "steady-pull"))
    assert (late.fitted, late.model.values["tau_delay"]) == (True, 0.3)
    assert (pulled.fitted, pulled.model.values["F_north"]) == (True, 4.0)
    assert "F_north" not in late.model.values
