"""Tests of the check of a boat's mass against its length."""

from __future__ import annotations

from seatrial.daq.checks import arm_problem, mass_problem
from seatrial.daq.checks.boat_numbers import check_boat_numbers

# Lengths [m] and masses [kg] of boats: a small survey boat, catamarans of 1.4 and 4.9 m, a ferry, a tug and a ship
BOATS = ((1.2, 14.5), (1.4, 29.0), (1.5, 8.0), (1.5, 60.0), (4.9, 180.0), (5.0, 1800.0), (30.0, 6e5), (190.0, 5e7))


def test_masses_of_real_boats_are_usual_and_other_units_are_not() -> None:
    for length, mass in BOATS:
        assert mass_problem({"length": length, "mass": mass}) == "", (length, mass)
        assert mass_problem({"length": length, "mass": 1e3 * mass}), (length, mass)  # in grams
        assert mass_problem({"length": length, "mass": 1e-3 * mass}), (length, mass)  # in tonnes
    assert mass_problem({"length": 1.5}) == mass_problem({"mass": 17400.0}) == ""
    assert mass_problem({"length": 1.5, "mass": 17400.0}) == (
        "mass = 17400 kg, but boats of length = 1.5 m weigh 1.7 to 1700 kg"
    )


def test_an_arm_in_millimetres_is_longer_than_the_boat() -> None:
    assert arm_problem({"antenna_x": 200.0}) == arm_problem({"length": 1.6, "antenna_x": -0.9, "y_left": -0.4}) == ""
    boat = {"length": 1.6, "mass": 38.0, "antenna_x": 0.2, "antenna_y": -50.0}
    problem = "antenna: -50 m to starboard of the centre of gravity, but the length is 1.6 m"
    assert arm_problem(boat) == problem
    assert arm_problem({"length": 1.6, "y_right": 42.0}).startswith("thruster right: 42 m to starboard of")
    assert arm_problem({"length": 1.6, "x_thrusters": -50.0}).startswith("thrusters: -50 m ahead of the centre of")
    assert [(f.level, f.code, f.text) for f in check_boat_numbers(boat)] == [("warning", "arm-of-length", problem)]
