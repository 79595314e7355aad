"""Tests of the frequency of waves: a fit that ended at another maximum begins again at the peak of its innovations."""

from __future__ import annotations

from dataclasses import replace

import pytest

from seatrial.ident.data.record import LogSegment, make_record
from seatrial.ident.effects.environment.waves import WAVES
from seatrial.ident.estimation.fitted_model import fit_nominal_model, fit_with_rescaling, nominal_model
from seatrial.ident.estimation.wave_peak import other_wave_start, wave_sizes
from seatrial.ident.model.structure import Model
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
