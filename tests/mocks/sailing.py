"""Noise-free simulation of a plant with constant commands."""

from __future__ import annotations

from collections.abc import Callable

from seatrial.mocks.plant.boat import PLANT_STEP_S, Boat, BoatPlant
from seatrial.mocks.plant.effect import HiddenEffect
from seatrial.mocks.plant.hull import Hull, State
from seatrial.mocks.plant.thruster import ThrusterTruth

REST: State = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def run(
    effects: tuple[HiddenEffect, ...],
    n: tuple[float, float],
    seconds: float = 40.0,
    state: State = REST,
    each: Callable[[BoatPlant], object] | None = None,
) -> BoatPlant:
    plant = BoatPlant(Boat(Hull(), ThrusterTruth(), (0.0, 0.0), effects, 0), state=state, disturbed=False)
    plant.command(0, 0.0, n[0])
    plant.command(1, 0.0, n[1])
    for _ in range(round(seconds / PLANT_STEP_S)):
        plant.advance()
        if each is not None:
            each(plant)
    return plant
