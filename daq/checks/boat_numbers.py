"""Checks of the numbers of a boat that a user declares: its mass and its lever arms against its length."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from seatrial.daq.checks.findings import WARNING, Finding

# Mass over length cubed [kg/m3]. The displacement of a hull is C L B T times the density of water. Slender catamarans
# have about 2 (a WAM-V of 4.9 m: 250 kg), small survey boats 5 to 14, tugs 20, and a box as wide and a third as deep as
# it is long has 300. A compact vehicle under water, such as a ROV of 0.46 m and 11 kg, has 120. A mass in grams or in
# tonnes, or a length in centimetres, is outside.
LEAST_DENSITY, MOST_DENSITY = 0.5, 500.0
# Antenna and thrusters are on the boat, so that none is farther from the centre of gravity than one length, even on a
# mast or an outrigger. An arm in centimetres or millimetres is.
ARMS = {"antenna_x": "antenna", "antenna_y": "antenna", "antenna_z": "antenna", "y_left": "thruster left",
        "y_right": "thruster right", "x_thrusters": "thrusters"}  # fmt: skip


def mass_problem(vehicle: Mapping[str, float]) -> str:
    """Return a clause that says how the mass of a boat differs from usual boats of its length; "" if it is usual.

    Parameters
    ----------
    vehicle
        Numbers of the boat by name. Only ``length`` [m] and the weighed ``mass`` [kg] are used. The result is "" if one
        of them is missing.
    """
    length, mass = vehicle.get("length"), vehicle.get("mass")
    if length is None or mass is None:
        return ""
    least, most = LEAST_DENSITY * length**3, MOST_DENSITY * length**3
    if least <= mass <= most:
        return ""
    usual = " to ".join(f"{float(f'{limit:.2g}'):g}" for limit in (least, most))
    return f"mass = {mass:g} kg, but boats of length = {length:g} m weigh {usual} kg"


def arm_problem(vehicle: Mapping[str, float]) -> str:
    """Return a clause that names a lever arm that is longer than the boat; "" if there is none.

    Parameters
    ----------
    vehicle
        Numbers of the boat by name [m]: ``length``, and the positions of antenna and thrusters (`ARMS`). The result is
        "" without a length.
    """
    length = vehicle.get("length")
    if length is None:
        return ""
    far = [(name, vehicle[name]) for name in ARMS if abs(vehicle.get(name, 0.0)) > length]
    if not far:
        return ""
    name, arm = far[0]
    axis = {"x": "ahead", "y": "to starboard", "z": "down"}[name.removeprefix("antenna_")[0]]
    return f"{ARMS[name]}: {arm:g} m {axis} of the centre of gravity, but the length is {length:g} m"


def check_boat_numbers(vehicle: Mapping[str, float]) -> Iterator[Finding]:
    """Yield a warning if the mass of a boat is unusual for its length, and one if a lever arm is longer than it."""
    if text := mass_problem(vehicle):
        yield Finding(WARNING, "mass-of-length", "geometry", "mass", text, MASS_ADVICE)
    if text := arm_problem(vehicle):
        yield Finding(WARNING, "arm-of-length", "geometry", "lever arms", text, ARM_ADVICE)


MASS_ADVICE = "correct mass [kg] or length [m] in the import map ([geometry]) or in the rig file ([vehicle])"
ARM_ADVICE = "give all positions and the length in metres, in the import map ([geometry]) or in the rig file"
