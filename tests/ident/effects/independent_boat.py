"""Compact simulator that is independent of mocks: one rigid body, one added-mass matrix, Heun's method at 40 Hz.

Its effects are plain forces and use no code of ident.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from seatrial.ident.data.record import Channel, LogSegment

ODE_STEP_S = 0.025  # Unit: s
AHRS, GNSS = 2, 8  # Steps between samples.

# force(state of motion) -> X, Y [N], N [N m] in body axes.
Force = Callable[["Moment"], tuple[float, float, float]]
# thrust(side, state of motion) -> factor of the thrust of that side.
Loss = Callable[[str, "Moment"], float]


@dataclass
class Moment:
    """State of motion of the boat in m, rad, m/s and rad/s. ``vn, ve`` are over ground, ``u, v`` through the water,
    ``n`` as a share of full speed.
    """

    t: float
    north: float
    east: float
    psi: float
    u: float
    v: float
    r: float
    vn: float
    ve: float
    n: dict[str, float]

    def into_body(self, north: float, east: float) -> tuple[float, float]:
        """Turn a vector from NED into body axes."""
        c, s = math.cos(self.psi), math.sin(self.psi)
        return c * north + s * east, c * east - s * north


@dataclass(frozen=True)
class Slosh:
    """Mass on a spring and damper in the hull at the origin. It moves along one body axis."""

    mass: float  # Part [kg] of the boat's own mass.
    frequency: float  # Unit: Hz
    damping: float  # Damping ratio.
    axis: str  # Surge or sway.


@dataclass(frozen=True)
class IndependentBoat:
    """Twin-screw boat of about 40 kg, or of ``scale`` times its length (masses and forces by Froude's law)."""

    scale: float = 1.0
    force: Force | None = None
    loss: Loss | None = None
    slosh: Slosh | None = None
    receiver_error: tuple[float, float] = (
        1.0,
        0.0,
    )  # Factor of the velocity of the receiver, and offset of its course in rad.
    current: tuple[float, float] = (0.12, -0.08)

    @property
    def weight(self) -> float:
        return self.scale**3

    @property
    def full_thrust(self) -> float:
        return 34.0 * self.weight

    @property
    def arm(self) -> float:
        return 0.22 * self.scale


def mission(seconds: float, seed: int) -> list[tuple[float, float, float]]:
    """Return steps (time, left, right) of both thrusters, each held for 2 to 9 s, sometimes equal or opposite."""
    rng, t, steps = np.random.default_rng(seed), 3.0, [(0.0, 0.0, 0.0)]
    while t < seconds:
        mean, turn = rng.uniform(-0.4, 0.9), rng.uniform(-0.6, 0.6) * (rng.uniform() < 0.5)
        steps.append((t, float(np.clip(mean + turn, -0.9, 0.95)), float(np.clip(mean - turn, -0.9, 0.95))))
        t += rng.uniform(2.0, 10.0)
    return steps


def sail(boat: IndependentBoat, seconds: float = 300.0, seed: int = 1, gyro: bool = True) -> LogSegment:
    """Return a log: shaft speeds, heading, yaw rate and accelerations at 20 Hz, position and velocity over ground at 5
    Hz.

    Without ``gyro``, the log has no yaw rate and no accelerations.
    """
    rng, steps, at = np.random.default_rng(seed), mission(seconds, seed), 0
    slow, sd = math.exp(-ODE_STEP_S / 0.18), (0.25 * boat.weight, 0.25 * boat.weight, 0.03 * boat.weight * boat.scale)
    calm, state, n = [0.0, 0.0, 0.0], [0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0], {"left": 0.0, "right": 0.0}
    rows = []
    for k in range(round(seconds / ODE_STEP_S)):
        while at + 1 < len(steps) and steps[at + 1][0] <= k * ODE_STEP_S:
            at += 1
        calm = [
            f * (1 - ODE_STEP_S / 1.5) + q * math.sqrt(ODE_STEP_S) * rng.normal() for f, q in zip(calm, sd, strict=True)
        ]
        later = {side: n[side] * slow + (1 - slow) * to for side, to in zip(n, steps[at][1:], strict=True)}
        rate, sensed = _rate(boat, k * ODE_STEP_S, state, n, calm)
        if k % AHRS == 0:
            rows.append((k * ODE_STEP_S, *n.values(), *sensed))
        end = [x + ODE_STEP_S * dx for x, dx in zip(state, rate, strict=True)]
        again, _ = _rate(boat, (k + 1) * ODE_STEP_S, end, later, calm)
        state = [x + ODE_STEP_S * (d1 + d2) / 2 for x, d1, d2 in zip(state, rate, again, strict=True)]
        n = later
    found = np.array(rows)
    factor, offset = boat.receiver_error
    over_ground = (found[:, 9] + 1j * found[:, 10]) * factor * np.exp(1j * offset)
    found[:, 9], found[:, 10] = over_ground.real, over_ground.imag
    return _measured(found, rng, gyro, seed)


def _rate(
    boat: IndependentBoat, t: float, state: list[float], n: dict[str, float], calm: list[float]
) -> tuple[list[float], tuple[float, ...]]:
    """Return the rate of the state (north, east, psi, u, v, r and the slosh), and psi, r, ax, ay, x, y, vx, vy."""
    north, east, psi, u, v, r, z, z_rate = state
    w, length, slosh = boat.weight, boat.scale, boat.slosh
    c, s = math.cos(psi), math.sin(psi)
    vn, ve = c * u - s * v + boat.current[0], s * u + c * v + boat.current[1]
    now = Moment(t, north, east, psi, u, v, r, vn, ve, n)
    f = {side: boat.full_thrust * z * abs(z) * (boat.loss(side, now) if boat.loss else 1.0) for side, z in n.items()}
    X = f["left"] + f["right"] - (2.0 + 24.0 * abs(u)) * u * length**2 + calm[0]
    Y = -(45.0 + 60.0 * abs(v)) * v * length**2 + calm[1]
    N = boat.arm * (f["left"] - f["right"]) - (5.0 + 7.0 * abs(r)) * r * w * length + calm[2]
    if boat.force is not None:
        X, Y, N = (a + b for a, b in zip((X, Y, N), boat.force(now), strict=True))
    m_u, m_v, m_r, pull = 42.0 * w, 58.0 * w, 8.0 * w * length**2, 0.0
    along_u, along_v = m_u, m_v
    if slosh is not None:  # The mass acts on the hull only through its spring.
        omega = 2 * math.pi * slosh.frequency
        pull = slosh.mass * (omega * omega * z + 2 * slosh.damping * omega * z_rate)
        if slosh.axis == "surge":
            X, along_u = X + pull, m_u - slosh.mass
        else:
            Y, along_v = Y + pull, m_v - slosh.mass
    du = (X + m_v * v * r - (m_u - along_u) * v * r) / along_u
    dv = (Y - m_u * u * r + (m_v - along_v) * u * r) / along_v
    dr = (N + (m_u - m_v) * u * v) / m_r
    ax, ay = du - v * r, dv + u * r
    z_rate_rate = 0.0 if slosh is None else -pull / slosh.mass - (ax if slosh.axis == "surge" else ay)
    return [vn, ve, r, du, dv, dr, z_rate, z_rate_rate], (psi, r, ax, ay, north, east, vn, ve)


def _measured(rows: np.ndarray, rng: np.random.Generator, gyro: bool, seed: int) -> LogSegment:
    t = rows[:, 0]
    names = ("psi", "r", "ax", "ay")
    noise = dict(zip(names, (0.01, 0.004, 0.04, 0.04), strict=True))
    channels = {
        f"n_{side}": Channel(t, rows[:, 1 + i] + 0.001 * rng.normal(size=t.size))
        for i, side in enumerate(("left", "right"))
    }
    for i, name in enumerate(names):
        if gyro or name == "psi":
            channels[name] = Channel(t, rows[:, 3 + i] + noise[name] * rng.normal(size=t.size))
    for i, name in enumerate(("x", "y", "vx", "vy")):
        fixes = rows[:: GNSS // AHRS, 7 + i]
        channels[name] = Channel(t[:: GNSS // AHRS], fixes + (0.05 if i < 2 else 0.03) * rng.normal(size=fixes.size))
    return LogSegment(f"run{seed}", channels)
