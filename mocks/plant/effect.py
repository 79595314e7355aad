"""Hidden effect of the mock boat: the hooks by which it acts on the plant and on the sensors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

# thrust(n_left, n_right, advance_left, advance_right, f_left, f_right, energy) -> (f_left, f_right)
#   Arguments: normalised shaft speeds; forward velocity of each thruster through the water (m/s); forces before this
#   effect (N); used energy (integral of |n|^3 over time and both thrusters, in units of ENERGY_UNIT).
Thrust = Callable[[float, float, float, float, float, float, float], tuple[float, float]]
# force(cos psi, sin psi, u_w, v_w, r, v_north, v_east) -> (X, Y, N) in N, N, N m
#   Arguments: velocity through the water in body axes (m/s), yaw rate (rad/s), velocity over ground in NED (m/s).
Force = Callable[[float, float, float, float, float, float, float], tuple[float, float, float]]
# jet(n_left, n_right) -> Y: sway force (N) of the jets at these shaft speeds
Jet = Callable[[float, float], float]
# current(t) -> (north, east): change of the boat's constant current (m/s) at t seconds after the start
Current = Callable[[float], tuple[float, float]]
# tether(x, y, v_north, v_east) -> (north, east): force (N) at a position (m from the start) and velocity over ground
Tether = Callable[[float, float, float, float], tuple[float, float]]
# accelerometer(a_x, a_y, thrust, u, r) -> (a_x, a_y): measured acceleration (m/s2) from the true one
#   Further arguments: thrust of both thrusters (N), surge over ground (m/s), yaw rate (rad/s).
Accelerometer = Callable[[float, float, float, float, float], tuple[float, float]]

ENERGY_UNIT = 150.0  # s; integral of |n|^3 over a mission of ten minutes, summed over both thrusters


@dataclass(frozen=True)
class Wave:
    """Long-crested irregular waves with one peak in their spectrum."""

    frequency: float  # Hz, of the peak
    width: float  # of the peak, as a share of the frequency
    toward: float  # rad, direction of travel in NED
    surge: float  # N, standard deviation of the force in head seas
    sway: float  # N, standard deviation of the force in beam seas
    yaw: float  # N m, standard deviation of the moment in quartering seas


@dataclass(frozen=True)
class Gust:
    """Gusts: first-order coloured forces whose strength alternates between strong and weak."""

    sigma: tuple[float, float, float]  # N, N, N m, standard deviations of X, Y and N
    tau: float  # s, correlation time
    period: float  # s, from one strong phase to the next


@dataclass(frozen=True)
class Noise:
    """Size of the noise of AHRS and GNSS, and GNSS errors that are not white: correlated errors and outliers."""

    gain: float = 1.0  # factor on all white noise of AHRS and GNSS
    # Gauss-Markov error of the GNSS position: standard deviation (m) and correlation time (s)
    colour: tuple[float, float] = (0.0, 1.0)
    # Share of the GNSS fixes that are outliers, and standard deviation of their error (m)
    outliers: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Answer:
    """Correct diagnosis of an effect that has no name: a force as a function of one variable."""

    force: str  # "X", "Y" or "N"
    variable: str  # "u", "v", "r", "psi", "n_sum" (mean of both shaft speeds) or "n_diff" (left less right)
    curve: Callable[[float], float]  # force in N, or moment in N m


@dataclass(frozen=True)
class HiddenEffect:
    """Hidden effect: its name, its true parameters and its hooks.

    Hooks that the effect does not use are None or zero.
    """

    name: str
    sentence: str  # description for the user
    parameters: dict[str, float] = field(default_factory=dict)  # true values, SI
    thrust: Thrust | None = None
    inflow: tuple[float, float] = (0.0, 0.0)  # s, delay and first-order lag from shaft speed to thrust
    force: Force | None = None
    jet: Jet | None = None
    tether: Tether | None = None
    current: Current | None = None
    wave: Wave | None = None
    gust: Gust | None = None
    x_g: float = 0.0  # m, centre of gravity forward of the origin
    pendulum: tuple[float, float, float] | None = None  # mass (kg), length (m) and damping (1/s) of a swinging payload
    compass: Callable[[float], float] | None = None  # deviation (rad) as a function of heading (rad)
    mount: float = 0.0  # rad, measured less true heading
    gyro: Callable[[float], float] | None = None  # error of the gyro (rad/s) as a function of the yaw rate (rad/s)
    accelerometer: Accelerometer | None = None
    lever_arm: tuple[float, float] | None = None  # m, GNSS antenna forward and to starboard of the origin
    latency: float = 0.0  # s, of the GNSS
    noise: Noise | None = None
    answer: Answer | None = None  # correct diagnosis, if the effect has no name


Maker = Callable[[np.random.Generator, float], HiddenEffect]


def effect_size(rng: np.random.Generator, full: float, *, signed: bool = False) -> float:
    """Return a random size within 15 % of ``full``; the sign is random too if ``signed`` is set."""
    sign = -1.0 if signed and rng.uniform() < 0.5 else 1.0
    return float(sign * full * rng.uniform(0.85, 1.15))
