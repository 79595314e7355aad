"""Tests of the importance of found effects and of their order in the result."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from seatrial.ident.diagnosis import importance
from seatrial.ident.diagnosis.acceptance import is_worth_its_parameters
from seatrial.ident.diagnosis.findings import EffectImportance, Refit, Round
from seatrial.ident.diagnosis.importance import by_importance, effect_importance
from seatrial.ident.model.structure import Effect, ForceCurve
from tests.ident.unlisted import kind_of


def chosen(name: str, **more: Any) -> Refit:
    return Refit(Effect(name, name, {}, **kind_of(name), **more), cast(Any, None), 100.0, 1, 90.0, 50.0, 5.0)


HUMP = chosen("hump", parametric_form_of=ForceCurve("X", "u"))
MOMENT = chosen("heading-moment", nonparametric_of=ForceCurve("N", "psi"))


@pytest.mark.parametrize(
    ("found", "order"),
    [
        # The search added the delay first, but the prediction degrades more without the yaw bias.
        ([(chosen("delay"), 1.02), (chosen("yaw-bias"), 1.4)], ["yaw-bias", "delay"]),
        (
            [(chosen("yaw-bias"), 1.0), (chosen("delay"), 1.1), (chosen("unknown N(u)"), 1.9)],
            ["delay", "yaw-bias", "unknown N(u)"],
        ),
        # A nonparametric effect goes after an effect with a formula only if that effect is more important.
        ([(chosen("unknown N(psi)"), 1.6), (chosen("dead-band"), 1.3)], ["unknown N(psi)", "dead-band"]),
        ([(chosen("unknown N(psi)"), 1.2), (chosen("dead-band"), 1.3)], ["dead-band", "unknown N(psi)"]),
        ([(chosen("wind"), 1.2), (chosen("unknown N(u)"), 1.5), (chosen("lag"), 1.1)], ["wind", "unknown N(u)", "lag"]),
        ([(chosen("wind"), 1.0), (chosen("unknown N(u)"), 1.5), (chosen("lag"), 1.1)], ["unknown N(u)", "lag", "wind"]),
        ([(HUMP, 1.1), (chosen("unknown X(u)"), 1.2), (chosen("wind"), 3.0)], ["wind", "unknown X(u)", "hump"]),
        ([(HUMP, 1.1), (chosen("unknown N(u)"), 1.2)], ["hump", "unknown N(u)"]),
        ([(MOMENT, 1.1), (chosen("unknown N(psi)"), 1.2)], ["heading-moment", "unknown N(psi)"]),
        ([], []),
    ],
)
def test_effects_are_ordered_by_importance_with_nonparametric_effects_mostly_last(
    found: list[tuple[Refit, float]], order: list[str]
) -> None:
    weights = [EffectImportance(c.effect.name, 10.0, error) for c, error in found]
    assert [w.effect for w in by_importance(weights, [c for c, _ in found])] == order


def test_effect_has_no_importance_if_the_model_without_it_cannot_be_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """A comparison with the nominal model instead would credit this effect with the gain of all effects."""

    def fitted(log_posterior: float, *effects: Refit) -> Any:
        model = SimpleNamespace(effects=[c.effect for c in effects])
        return SimpleNamespace(fit=SimpleNamespace(model=model, log_posterior=log_posterior))

    def fails(*_: Any) -> Any:
        raise ValueError("x0")

    wind_refit, before = chosen("wind"), fitted(0.0)
    wind_refit = replace(wind_refit, fitted=fitted(900.0, wind_refit))
    lift_refit = replace(chosen("lift"), fitted=fitted(930.0, wind_refit, chosen("lift")), prediction=cast(Any, "fell"))
    monkeypatch.setattr(importance, "_fit_with_effects", fails)
    monkeypatch.setattr(importance, "comparison", lambda *_: SimpleNamespace(error_ratio=1.2))
    rounds = [Round((), (), (c,), c) for c in (wind_refit, lift_refit)]
    lift, wind = effect_importance(before, lift_refit.fitted, [wind_refit, lift_refit], rounds, [], [])
    assert (lift.effect, lift.gain, lift.untested) == ("lift", 60.0, None)
    assert (wind.effect, wind.untested, is_worth_its_parameters(wind)) == ("wind", "x0", False)
    assert np.isnan([wind.gain, wind.error_ratio, wind.t]).all()
