"""Swapped thrusters are found before any fit, and a boat that is wired well is never accused."""

from __future__ import annotations

import numpy as np
import pytest

from ident.checks.motion import check_sides, swap_sides
from ident.data.record import Channel
from ident.models.horizontal import horizontal_model
from tests.missions import boat_with, channels_of, sail


def swapped(channels: dict[str, Channel]) -> dict[str, Channel]:
    return channels | {"n_left": channels["n_right"], "n_right": channels["n_left"]}


def as_force(channels: dict[str, Channel]) -> dict[str, Channel]:
    """With thrusts in newtons in the place of shaft speeds."""
    forces = {
        f"f_{side}": Channel(c.t, 40.0 * c.value * np.abs(c.value))
        for side in ("left", "right")
        if (c := channels[f"n_{side}"])
    }
    return {n: c for n, c in channels.items() if not n.startswith("n_")} | forces


@pytest.fixture(scope="module")
def fleet() -> list[dict[str, Channel]]:
    """Fifty boats for two minutes, every other one with a hidden effect, on missions of all kinds."""
    effects = ("wind", "sway-yaw", "yaw-bias", "mismatch", "cg-offset")
    kinds = ("mixed", "zigzag", "steps", "mixed", "chirp")
    found = []
    for seed in range(50):
        effect = effects[seed // 2 % 5] if seed % 2 else None
        found.append(channels_of(sail(boat_with(effect, seed), 120.0, seed, kind=kinds[seed % 5])[0]))
    return found


def test_a_healthy_boat_is_never_accused(fleet: list[dict[str, Channel]]) -> None:
    for seed, channels in enumerate(fleet):
        for given in (channels, as_force(channels)):
            verdict = check_sides([(f"seed {seed}", given)])
            assert verdict is not None
            assert not verdict.swapped, (seed, verdict)


def test_a_swapped_pair_is_found(fleet: list[dict[str, Channel]]) -> None:
    verdicts = [check_sides([(f"seed {k}", swapped(channels))]) for k, channels in enumerate(fleet)]
    found = [v is not None and v.swapped for v in verdicts]
    assert all(found[::2])  # nothing else is wrong with these
    assert sum(found[1::2]) >= 24  # sway-yaw coupling may hide it within two minutes
    both = check_sides([("a", swapped(fleet[0])), ("b", swapped(fleet[1]))])
    assert both is not None
    assert both.runs == ("a", "b")
    assert "in 2 of 2 runs" in both.line
    forces = check_sides([("a", as_force(swapped(fleet[0])))])
    assert forces is not None
    assert forces.swapped


def test_one_run_that_speaks_for_the_boat_is_enough(fleet: list[dict[str, Channel]]) -> None:
    verdict = check_sides([("good", fleet[0]), ("swapped", swapped(fleet[1]))])
    assert verdict is not None
    assert not verdict.swapped


def test_where_nothing_can_be_said_nothing_is(fleet: list[dict[str, Channel]]) -> None:
    without = {n: c for n, c in fleet[0].items() if n != "r"}
    one = {n: c for n, c in fleet[0].items() if n != "n_left"}
    straight = fleet[0] | {"n_right": fleet[0]["n_left"]}
    for channels in (without, one, straight):
        assert check_sides([("run", channels)]) is None
    noise = fleet[0] | {"r": Channel(fleet[0]["r"].t, np.random.default_rng(1).normal(size=fleet[0]["r"].t.size))}
    verdict = check_sides([("noise", noise)])
    assert verdict is not None
    assert not verdict.significant[0]
    assert not verdict.swapped


def test_the_swapped_model_has_its_thrusters_on_the_other_side() -> None:
    model = swap_sides(horizontal_model().with_values({"y_left": -0.14, "y_right": 0.16}))
    assert (model.values["y_left"], model.values["y_right"]) == (0.16, -0.14)
    assert model.parameter("y_left").name == "y_left"
