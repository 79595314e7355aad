"""Check of the numbers of a boat that a user declares: its mass against its length."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from seatrial.daq.checks.findings import WARNING, Finding

# Mass over length cubed [kg/m3]. The displacement of a hull is C L B T times the density of water. Slender catamarans
# have about 2 (a WAM-V of 4.9 m: 250 kg), small survey boats 5 to 14, tugs 20, and a box as wide and a third as deep as
# it is long has 300. A compact vehicle under water, such as a ROV of 0.46 m and 11 kg, has 120. A mass in grams or in
# tonnes, or a length in centimetres, is outside.
LEAST_DENSITY, MOST_DENSITY = 0.5, 500.0


def mass_problem(vehicle: Mapping[str, float]) -> str:
    """Return what is unusual about the mass of a boat for its length, as a clause; "" if nothing is.

    Parameters
    ----------
    vehicle
        Numbers of the boat by name, of which ``length`` [m] and the weighed ``mass`` [kg] are used. Without both of
        them there is no problem.
    """
    length, mass = vehicle.get("length"), vehicle.get("mass")
    if length is None or mass is None:
        return ""
    least, most = LEAST_DENSITY * length**3, MOST_DENSITY * length**3
    if least <= mass <= most:
        return ""
    usual = " to ".join(f"{float(f'{limit:.2g}'):g}" for limit in (least, most))
    return f"mass = {mass:g} kg, but boats of length = {length:g} m weigh {usual} kg"


def check_mass(vehicle: Mapping[str, float]) -> Iterator[Finding]:
    """Yield a warning if the mass of a boat is unusual for its length (`mass_problem`)."""
    if text := mass_problem(vehicle):
        yield Finding(WARNING, "mass-of-length", "geometry", "mass", text, MASS_ADVICE)


MASS_ADVICE = "correct mass [kg] or length [m] in the import map ([geometry]) or in the rig file ([vehicle])"
