"""Simulator in plain NumPy of a boat that rolls and pitches. It is independent of the models of ident.

The attitude is a rotation matrix. Accelerations, velocities of the antenna and body rates are finite differences of
positions and of this matrix, so lever arm, mounting and wandering current are right by construction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.data.record import Channel

Array = NDArray[np.float64]
ODE_STEP_S, OUT, FIX = 0.005, 10, 4  # Step [s]; steps between AHRS samples; AHRS samples per fix.
M_U, M_V, M_R, D_U, D_UU, D_V, D_R, D_RR, C1, ARM = 37.0, 47.0, 9.69, 4.0, 25.0, 50.0, 4.14, 6.23, 40.05, 0.15
TRUTH = {"m_u": M_U, "m_v": M_V, "m_r": M_R, "d_u": D_U, "d_uu": D_UU, "d_v": D_V, "d_r": D_R, "d_rr": D_RR}
NOISE = {
    "psi": 0.002,
    "phi": 0.002,
    "theta": 0.002,
    "p": 0.002,
    "q": 0.002,
    "r": 0.002,
    "ax": 0.03,
    "ay": 0.03,
    "x": 0.02,
    "y": 0.02,
    "vx": 0.02,
    "vy": 0.02,
}
# Amplitude [rad] and frequency [rad/s] of roll and pitch.
ROLL, PITCH = ((0.12, 2.1), (0.08, 3.3)), ((0.08, 1.7), (0.05, 2.9))


@dataclass(frozen=True)
class Fitted:
    """Equipment of the boat.

    ``arm`` is the position of the antenna [m, ahead, to starboard, down]. ``mount`` is roll, pitch and yaw of the AHRS
    [rad]. ``wander`` is the diffusion of the current [m/s/sqrt(s)].
    """

    arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wander: float = 0.0


def turn(axis: int, a: float | Array) -> Array:
    """Return the rotation about an axis, (..., 3, 3)."""
    a = np.asarray(a, dtype=float)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    R = np.zeros((*a.shape, 3, 3))
    R[..., axis, axis] = 1.0
    R[..., i, i] = R[..., j, j] = np.cos(a)
    R[..., i, j], R[..., j, i] = -np.sin(a), np.sin(a)
    return R


def rotation(phi: float | Array, theta: float | Array, psi: float | Array) -> Array:
    """Return the rotation from body to NED."""
    return np.asarray(turn(2, psi) @ turn(1, theta) @ turn(0, phi))


def waving(t: float | Array, parts: tuple[tuple[float, float], ...]) -> tuple[float | Array, float | Array]:
    """Return a sum of sines and its rate."""
    return (sum(a * np.sin(w * t) for a, w in parts), sum(a * w * np.cos(w * t) for a, w in parts))


def sail(boat: Fitted, seconds: float, seed: int) -> tuple[dict[str, Channel], Array]:
    """Simulate a mission with random levels of both shafts. Return its channels by the names of ident, and the current
    (n, 2) at the fixes.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds / ODE_STEP_S) + 1) * ODE_STEP_S
    levels = rng.uniform(-0.4, 1.0, (2, round(seconds / 5.0) + 2))
    n = np.array([np.interp(t, np.arange(len(row)) * 5.0, row) for row in levels])
    psi, u, v = _moved(t, n)
    (phi, _), (theta, _) = waving(t, ROLL), waving(t, PITCH)
    R = rotation(phi, theta, psi)
    w = -(R[:, 2, 0] * u + R[:, 2, 1] * v) / R[:, 2, 2]
    water = np.einsum("kij,kj->ki", R, np.column_stack([u, v, w]))
    current = np.array([0.15, -0.1]) + np.cumsum(
        boat.wander * np.sqrt(ODE_STEP_S) * rng.normal(size=(t.size, 2)), axis=0
    )
    place = np.zeros((t.size, 3))
    place[1:, :2] = np.cumsum(ODE_STEP_S * ((water[1:] + water[:-1])[:, :2] + current[1:] + current[:-1]) / 2, axis=0)
    antenna = place + R @ np.array(boat.arm)
    felt = np.gradient(water, ODE_STEP_S, axis=0) - [0.0, 0.0, 9.81]  # Specific force of a body in the current.
    M = rotation(*boat.mount)  # Rotation from the axes of the AHRS to those of the boat.
    S = R @ M
    spin = np.swapaxes(S, 1, 2) @ np.gradient(S, ODE_STEP_S, axis=0)
    seen = {
        "phi": np.arctan2(S[:, 2, 1], S[:, 2, 2]),
        "theta": -np.arcsin(S[:, 2, 0]),
        "psi": np.arctan2(S[:, 1, 0], S[:, 0, 0]),
        "p": spin[:, 2, 1],
        "q": spin[:, 0, 2],
        "r": spin[:, 1, 0],
    }
    force = np.einsum("kji,kj->ki", S, felt)
    speed = np.gradient(antenna, ODE_STEP_S, axis=0)
    seen |= {
        "ax": force[:, 0],
        "ay": force[:, 1],
        "x": antenna[:, 0],
        "y": antenna[:, 1],
        "vx": speed[:, 0],
        "vy": speed[:, 1],
    }
    channels = {f"n_{side}": Channel(t[::OUT], n[k, ::OUT]) for k, side in enumerate(("left", "right"))}
    for name, value in seen.items():
        every = OUT * (FIX if name in ("x", "y", "vx", "vy") else 1)
        noisy = value[::every] + NOISE[name] * rng.normal(size=value[::every].size)
        channels[name] = Channel(t[::every], noisy)
    return channels, current[:: OUT * FIX]


def _moved(t: Array, n: Array) -> tuple[Array, Array, Array]:
    """Return psi, u, v by Heun's method. Roll and pitch are given by ``waving``."""
    f = C1 * n * np.abs(n) + 1.11 * n * n
    X, N = f[0] + f[1], ARM * (f[0] - f[1])

    def rate(k: int, z: Array) -> Array:
        _, r, u, v = z
        (phi, phi_rate), (theta, theta_rate) = waving(t[k], ROLL), waving(t[k], PITCH)
        q = (theta_rate + r * np.sin(phi)) / np.cos(phi)
        about = q * np.sin(phi) + r * np.cos(phi)
        p = phi_rate - np.tan(theta) * about
        w = (np.tan(theta) * u - np.sin(phi) * v) / np.cos(phi)
        return np.array(
            [
                about / np.cos(theta),
                (N[k] + (M_U - M_V) * u * v - D_R * r - D_RR * abs(r) * r) / M_R,
                (X[k] + M_V * (v * r - w * q) - D_U * u - D_UU * abs(u) * u) / M_U,
                (-M_U * u * r + M_V * w * p - D_V * v) / M_V,
            ]
        )

    z = np.zeros((t.size, 4))
    for k in range(t.size - 1):
        a = rate(k, z[k])
        z[k + 1] = z[k] + ODE_STEP_S / 2 * (a + rate(k + 1, z[k] + ODE_STEP_S * a))
    return z[:, 0], z[:, 2], z[:, 3]
