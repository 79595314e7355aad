"""Tests of fits that begin again: at the peak of the innovations for waves, at initial values for other effects."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from seatrial.ident.data.record import LogSegment, make_record
from seatrial.ident.effects.environment.waves import WAVES
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation import fitted_model
from seatrial.ident.estimation.fitted_model import (
    _initial_values_of_surroundings,
    fit_nominal_model,
    fit_with_rescaling,
    fit_with_restarts,
    nominal_model,
)
from seatrial.ident.estimation.maximum_likelihood import ROUGH_SEARCH
from seatrial.ident.estimation.wave_peak import other_wave_start, wave_sizes
from seatrial.ident.model.structure import Model
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from tests.missions import boat_with, channels_of, sail


def from_frequency(frequency: float, free: bool = True) -> Model:
    """Return a model with waves, whose search begins at a frequency [Hz]."""
    start = tuple(
        replace(p, value=frequency, prior=None, free=free) if p.name == "f_wave" else p for p in WAVES.parameters
    )
    return nominal_model(horizontal_model()) + replace(WAVES, parameters=start)


def test_a_fit_that_missed_the_waves_begins_again_at_their_frequency() -> None:
    run = LogSegment("run", channels_of(sail(boat_with("waves", 4), 130.0, 3)[0]))
    model = from_frequency(2.2)
    missed = fit_with_rescaling(model, [make_record(model, run, 10.0)], [])
    assert not 0.35 < missed.fit.estimate("f_wave")[0] < 0.55
    runs = [view.run for view in missed.estimation]
    start = other_wave_start(missed.fit.model, runs)
    assert start["f_wave"] == pytest.approx(0.45, abs=0.1)
    assert start["A_X"] == wave_sizes(missed.fit.model)["A_X"] > 0.0
    found = fit_nominal_model(model, [run], [])
    assert found.fit.estimate("f_wave")[0] == pytest.approx(0.45, abs=0.1)
    assert found.fit.log_posterior > missed.fit.log_posterior + 50.0
    # Nothing is gained at the frequency of the fit. A fixed frequency is not searched.
    assert other_wave_start(missed.fit.model.with_values({"f_wave": start["f_wave"]}), runs) == {}
    held = missed.fit.model.with_free(n for n in missed.fit.model.free if n != "f_wave")
    assert other_wave_start(held, runs) == {}
    assert other_wave_start(horizontal_model(), runs) == {}


@pytest.mark.parametrize("higher", [True, False])
def test_a_fit_with_wind_begins_again_at_the_initial_values_of_the_wind(
    higher: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first maximum has lever arms far from their priors and little force. The second one may be higher."""
    model = with_disturbances(horizontal_model()) + catalogue()["wind"]
    found = {"m_u": 40.0, "F_wx": -0.3, "w_n": -0.6, "q_X": 2.0}
    begun: list[dict[str, float]] = []

    def stub(values: dict[str, float], height: float) -> Any:
        fit = SimpleNamespace(
            model=model.with_values(values), log_posterior=height, start_values=lambda _: dict(values)
        )
        return SimpleNamespace(fit=fit, estimation=())

    def rough(_model: Model, _records: Any, _runs: Any, _options: Any, settings: Any, begin: dict[str, float]) -> Any:
        assert settings is ROUGH_SEARCH
        begun.append(begin)
        return stub({**begin, "F_wx": 1.0}, 20.0 if higher else 10.2)

    def exact(*given: Any) -> Any:
        begin = given[5]
        return stub(found, 10.0) if begin is None else stub(dict(begin), 21.0)

    monkeypatch.setattr(fitted_model, "fit_and_evaluate", rough)
    monkeypatch.setattr(fitted_model, "fit_with_rescaling", exact)
    result = fit_with_restarts(model, [], [])
    (begin,) = begun
    assert begin["m_u"] == 40.0  # the estimates of all other parameters
    assert begin["q_X"] == 2.0
    assert (begin["F_wx"], begin["w_n"], begin["w_x"]) == (0.0, 0.1, 0.5)
    assert result.fit.log_posterior == (21.0 if higher else 10.0)
    assert result.fit.model.values["F_wx"] == (1.0 if higher else -0.3)


def test_effects_without_a_shape_do_not_begin_again() -> None:
    model = with_disturbances(horizontal_model()) + catalogue()["steady-pull"] + catalogue()["mismatch"]
    assert _initial_values_of_surroundings(model) == {}
