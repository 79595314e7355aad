"""Tests of the names of the parameters of environment effects, which a diagnosis prints."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from seatrial.ident.effects import catalogue
from seatrial.ident.models import horizontal_model
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.results.diagnosis import _environment_parameters


def test_waves_have_their_parameters_and_disturbances_none() -> None:
    scale: Any = SimpleNamespace(scale=SimpleNamespace(name=lambda name, unit: f"{name}/T" if unit == "N" else name))
    boat = with_disturbances(horizontal_model())
    assert _environment_parameters(boat, scale) == ()
    waves = catalogue()["waves"]
    assert _environment_parameters(boat + waves, scale) == ("A_X/T", "A_Y/T", "A_N", "f_wave", "zeta_wave")
    known = (boat + waves).parameter("zeta_wave")
    fixed = (boat + waves).replace_parameters(replace(known, free=False))
    assert "zeta_wave" not in _environment_parameters(fixed, scale)
