"""A hidden effect: the places in the plant and in its sensors where one can act."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

# thrust(n_left, n_right, advance_left, advance_right, f_left, f_right, energy) -> (f_left, f_right)
#   normalised shaft speeds, speed of each thruster through the water, forward (m/s), forces so far (N), energy used:
#   the integral of |n|^3 over time and both thrusters, in units of ENERGY_UNIT
Thrust = Callable[[float, float, float, float, float, float, float], tuple[float, float]]
# force(cos psi, sin psi, u_w, v_w, r, v_north, v_east) -> (X, Y, N): velocity through the water in body axes, over
#   ground in NED; N, N, N m
Force = Callable[[float, float, float, float, float, float, float], tuple[float, float, float]]
# jet(n_left, n_right) -> Y: side force (N) of the jets at these shaft speeds
Jet = Callable[[float, float], float]
# current(t) -> (north, east): what is added to the boat's constant current, m/s at t s after the start
Current = Callable[[float], tuple[float, float]]
# tether(x, y, v_north, v_east) -> (north, east): force (N) at a place (m from the start) and velocity over ground
Tether = Callable[[float, float, float, float], tuple[float, float]]
# accelerometer(a_x, a_y, thrust, u, r) -> (a_x, a_y): m/s2; thrust (N), surge over ground (m/s) and yaw rate (rad/s)
Accelerometer = Callable[[float, float, float, float, float], tuple[float, float]]

ENERGY_UNIT = 150.0  # s, what a mission of ten minutes uses


@dataclass(frozen=True)
class Wave:
    """Long-crested irregular waves: a peak at ``frequency`` (Hz) of relative ``width``, travelling ``toward`` (rad).

    ``surge`` (N, in head seas), ``sway`` (N) and ``yaw`` (N m, in beam and quartering seas): standard deviations.
    """

    frequency: float
    width: float
    toward: float
    surge: float
    sway: float
    yaw: float


@dataclass(frozen=True)
class Gust:
    """A first-order coloured force: standard deviations (N, N, N m), correlation time (s), period of the lulls (s)."""

    sigma: tuple[float, float, float]
    tau: float
    period: float


@dataclass(frozen=True)
class Noise:
    """How the noise of the sensors differs from what their data sheets say."""

    gain: float = 1.0  # on all white noise of AHRS and GNSS
    colour: tuple[float, float] = (0.0, 1.0)  # m, s: time-correlated (Gauss-Markov) error of the GNSS position
    outliers: tuple[float, float] = (0.0, 0.0)  # share of the fixes that are wrong, and by how much (m)


@dataclass(frozen=True)
class Answer:
    """What is right to say of an effect that has no name: ``force`` (X, Y or N) depends on ``variable`` like this.

    ``variable``: u, v, r, psi, n_sum (mean of both shaft speeds) or n_diff (left less right); ``curve`` in N or N m.
    """

    force: str
    variable: str
    curve: Callable[[float], float]


@dataclass(frozen=True)
class HiddenEffect:
    """One effect: where it acts, its true parameters (SI) and a sentence for people."""

    name: str
    sentence: str
    parameters: dict[str, float] = field(default_factory=dict)
    thrust: Thrust | None = None
    inflow: tuple[float, float] = (0.0, 0.0)  # s, delay and lag of the thrust behind the shaft
    force: Force | None = None
    jet: Jet | None = None
    tether: Tether | None = None
    current: Current | None = None
    wave: Wave | None = None
    gust: Gust | None = None
    x_g: float = 0.0  # m, centre of gravity forward of the origin
    pendulum: tuple[float, float, float] | None = None  # kg, m, 1/s
    compass: Callable[[float], float] | None = None  # heading -> deviation, rad
    mount: float = 0.0  # rad, the AHRS turned clockwise seen from above
    gyro: Callable[[float], float] | None = None  # yaw rate -> error of the gyro, rad/s
    accelerometer: Accelerometer | None = None
    lever_arm: tuple[float, float] | None = None  # m, GNSS antenna forward and starboard
    latency: float = 0.0  # s, of the GNSS
    noise: Noise | None = None
    answer: Answer | None = None  # where no name fits


Maker = Callable[[np.random.Generator, float], HiddenEffect]


def effect_size(rng: np.random.Generator, full: float, *, signed: bool = False) -> float:
    """``full`` within 15 %, of either sign when ``signed``."""
    sign = -1.0 if signed and rng.uniform() < 0.5 else 1.0
    return float(sign * full * rng.uniform(0.85, 1.15))
