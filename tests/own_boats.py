"""Simulated boats for the examples of user-defined models. The equations are written a second time, without seatrial.

A boat is a function of the inputs and of its own states. It returns X [N], Y [N], N [N m] and the rates of its states.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

HULL = {
    "m_u": 37.0,
    "m_v": 60.0,
    "m_r": 9.0,
    "d_u": 8.0,
    "d_v": 40.0,
    "d_r": 6.0,
    "d_uu": 15.0,
    "d_vv": 60.0,
    "d_rr": 5.0,
}
STEP, EVERY = 0.01, 10  # s, of the integration; steps between two rows of the table
NOISE = {"psi": 0.01, "r": 0.005, "x": 0.05, "y": 0.05, "vx": 0.05, "vy": 0.05, "ax": 0.05, "ay": 0.05}
UNITS = {"psi": "rad", "r": "rad/s", "x": "m", "y": "m"}
Forces = Callable[[Sequence[float], Sequence[float]], Sequence[float]]


class OwnBoat(NamedTuple):
    """Boat with propulsion of its own.

    Attributes
    ----------
    inputs : dict
        Range (lowest, highest) of each of the two inputs, by name. The first changes every 5 s, the second every 3 s.
    forces : Callable
        Function of the inputs and of the additional states.
    states : int
        Number of additional states, which are zero at the start.
    truth : dict
        True values of the parameters that are estimated.
    """

    inputs: dict[str, tuple[float, float]]
    forces: Forces
    states: int
    truth: dict[str, float]


def _outboard(u: Sequence[float], _: Sequence[float]) -> Sequence[float]:
    thrust, angle = 60.0 * u[0] * abs(u[0]), u[1] + 0.05
    return thrust * math.cos(angle), thrust * math.sin(angle), -0.6 * thrust * math.sin(angle)


def _lagging(u: Sequence[float], states: Sequence[float]) -> Sequence[float]:
    n, jet = states
    thrust = 60.0 * n * abs(n)
    return thrust, 0.0, 0.3 * jet * math.sin(u[1]), (u[0] - n) / 0.4, (thrust - jet) / 0.8


BOATS = {
    "outboard.py:outboard": OwnBoat({"n_main": (-0.5, 1.0), "delta": (-0.5, 0.5)}, _outboard, 0, {"delta_0": 0.05}),
    "lags.py:lagging_boat": OwnBoat(
        {"n_cmd": (-0.5, 1.0), "rudder": (-0.5, 0.5)}, _lagging, 2, {"l_r": 0.3, "T_n": 0.4, "T_jet": 0.8}
    ),
}


def simulated_run(boat: OwnBoat, seed: int, seconds: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the times and the columns of a run with random steps of the inputs: inputs, and measured signals."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, STEP)
    u = np.column_stack(
        [_steps(rng, t, *limits, every) for limits, every in zip(boat.inputs.values(), (5.0, 3.0), strict=True)]
    )
    motion = _motion(boat, u)[:, :6]
    change = np.diff(motion[:, 3:5], axis=0, append=motion[-1:, 3:5])[::EVERY] / STEP
    x, y, psi, surge, sway, r = motion[::EVERY].T
    vx, vy = surge * np.cos(psi) - sway * np.sin(psi), surge * np.sin(psi) + sway * np.cos(psi)
    ax, ay = change[:, 0] - sway * r, change[:, 1] + surge * r
    measured = {"psi": psi, "r": r, "x": x, "y": y, "vx": vx, "vy": vy, "ax": ax, "ay": ay}
    noisy = {name: v + NOISE[name] * rng.normal(size=v.size) for name, v in measured.items()}
    return t[::EVERY], dict(zip(boat.inputs, u[::EVERY].T, strict=True)) | noisy


def write_run(boat: OwnBoat, path: Path, seed: int, seconds: float = 200.0) -> None:
    """Write a CSV of a run with random steps of the inputs: time, inputs, measured heading, yaw rate and position."""
    t, columns = simulated_run(boat, seed, seconds)
    wanted = {name: columns[name] for name in (*boat.inputs, *UNITS)}
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["t", *wanted])
        writer.writerows(np.column_stack([t, *wanted.values()]).round(6).tolist())


def import_map(boat: OwnBoat) -> str:
    """Return the import map of the table."""
    main, angle = boat.inputs
    signals = [(main, "1", "input"), (angle, "rad", "input"), *((n, u, "output") for n, u in UNITS.items())]
    return 'format = "seatrial-import 1"\n[time]\ncolumn = "t"\n' + "".join(
        f'[[signal]]\nname = "{name}"\ncolumn = "{name}"\nunit = "{unit}"\nrole = "{role}"\n'
        for name, unit, role in signals
    )


def _steps(rng: np.random.Generator, t: np.ndarray, low: float, high: float, every: float) -> np.ndarray:
    """Return a random step signal with a step every so many seconds."""
    step = (t // every).astype(int)
    return np.asarray(rng.uniform(low, high, step[-1] + 1)[step])


def _motion(boat: OwnBoat, u: np.ndarray) -> np.ndarray:
    """Return x, y, psi, u, v, r and the additional states at each step, by Runge-Kutta 4 from rest.

    The numbers are floats, which take a fifth of the time of small arrays.
    """
    h = HULL

    def rates(z: list[float], held: list[float]) -> list[float]:
        psi, surge, sway, yaw = z[2:6]
        force_x, force_y, moment, *own = boat.forces(held, z[6:])
        cos, sin = math.cos(psi), math.sin(psi)
        return [
            surge * cos - sway * sin,
            surge * sin + sway * cos,
            yaw,
            (force_x - (h["d_u"] + h["d_uu"] * abs(surge)) * surge + h["m_v"] * sway * yaw) / h["m_u"],
            (force_y - (h["d_v"] + h["d_vv"] * abs(sway)) * sway - h["m_u"] * surge * yaw) / h["m_v"],
            (moment - (h["d_r"] + h["d_rr"] * abs(yaw)) * yaw + (h["m_u"] - h["m_v"]) * surge * sway) / h["m_r"],
            *own,
        ]

    def moved(z: list[float], step: float, k: list[float]) -> list[float]:
        return [a + step * b for a, b in zip(z, k, strict=True)]

    z, path = [0.0] * (6 + boat.states), []
    for held in u.tolist():
        path.append(z)
        k1 = rates(z, held)
        k2 = rates(moved(z, STEP / 2, k1), held)
        k3 = rates(moved(z, STEP / 2, k2), held)
        k4 = rates(moved(z, STEP, k3), held)
        z = [a + STEP / 6 * (p + 2 * q + 2 * r + s) for a, p, q, r, s in zip(z, k1, k2, k3, k4, strict=True)]
    return np.array(path)
