"""Tests of effects outside the catalogue, noise that differs from the assumption, and mixtures."""

from __future__ import annotations

import math

import numpy as np
import pytest

from seatrial.mocks.hidden_effects.catalogue import EFFECTS, NOISE, OUTSIDE, make_effect, mixture
from seatrial.mocks.plant.boat import PLANT_STEP_S, Boat, BoatPlant
from seatrial.mocks.plant.hull import Hull
from seatrial.mocks.plant.thruster import ThrusterTruth
from seatrial.mocks.sensors import GnssSensor
from tests.mocks.sailing import REST, run


@pytest.mark.parametrize("name", OUTSIDE)
def test_effects_outside_the_catalogue_report_their_curve(name: str) -> None:
    """The reported curve is the force that the plant applies."""
    effect = make_effect(name, 1)
    assert effect.answer is not None
    for z in (0.2, 0.5, 0.8):
        if effect.thrust is not None:
            rest = 40.05 * z * z + 1.11 * z * z
            left, right = effect.thrust(z, z, 0.0, 0.0, rest, rest, 0.0)
            got = left + right - 2.0 * rest
        elif effect.jet is not None:
            got = effect.jet(0.5 + z / 2.0, 0.5 - z / 2.0)[0]
        else:
            assert effect.force is not None
            forces = effect.force(math.cos(z), math.sin(z), z, 0.0, 0.0, 0.0, 0.0)
            got = forces["XYN".index(effect.answer.force)]
        assert got == pytest.approx(effect.answer.curve(z), abs=1e-9)


def test_noise_that_differs_from_the_assumption() -> None:
    m = run((), (0.0, 0.0), 0.1).motion()

    def fixes(name: str) -> np.ndarray:
        gnss = GnssSensor(1, 0, 5.0, (make_effect(name, 1),) if name else ())
        return np.array([(f.lat, f.vel_n) for f in (gnss.read(m, 0.0) for _ in range(4000))]) * (111e3, 1.0)

    plain = fixes("")
    wild = np.abs(fixes("noise-outliers") - plain)[:, 0]
    assert 0.005 < np.mean(wild > 0.5) < 0.02
    assert wild.max() > 3.0
    wander = (fixes("noise-gps") - plain)[:, 0]
    assert wander.std() == pytest.approx(0.3, rel=0.4)
    assert np.corrcoef(wander[:-5], wander[5:])[0, 1] > 0.9
    assert np.diff(fixes("noise-small-r")[:, 1]).var() == pytest.approx(2.0 * np.diff(plain[:, 1]).var(), rel=1e-6)
    assert set(NOISE) == {"noise-gps", "noise-gusts", "noise-outliers", "noise-small-r"}


def test_gusts_begin_and_end() -> None:
    effect = (make_effect("noise-gusts", 1),)
    plant = BoatPlant(Boat(Hull(), ThrusterTruth(), (0.0, 0.0), effect, 0), state=REST, disturbed=False)
    surge = []
    for _ in range(round(97.0 / PLANT_STEP_S)):
        plant.advance()
        surge.append(plant.motion().ax if plant.steps % 20 == 0 else math.nan)
    half = len(surge) // 2
    assert np.nanstd(surge[:half]) > 2.0 * np.nanstd(surge[half:]) > 0.0


def test_a_mixture_contains_small_amounts_of_all_other_effects() -> None:
    effects = mixture("wind", 3)
    assert effects[0].name == "wind"
    assert {e.name for e in effects} == set(EFFECTS)
    assert effects[0].parameters == make_effect("wind", 3).parameters
    small, full = (
        next(e for e in group if e.name == "cubic-drag").parameters["k"]
        for group in (effects, (make_effect("cubic-drag", 3),))
    )
    assert small == pytest.approx(0.05 * full)
