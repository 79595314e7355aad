"""Hidden effect of the mock boat: the hooks by which it acts on the plant and on the sensors.

A hook is a function or a number of the effect that the plant or a sensor model uses in its equations.
"""

from __future__ import annotations

import math
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
# jet(n_left, n_right) -> (Y, N): sway force (N) and yaw moment (N m) of the jets at these shaft speeds
Jet = Callable[[float, float], tuple[float, float]]
# current(t) -> (north, east): change of the boat's constant current (m/s) at t seconds after the start
Current = Callable[[float], tuple[float, float]]
# stream(x, y) -> (north, east): change of the boat's constant current (m/s) at a position (m from the start)
Stream = Callable[[float, float], tuple[float, float]]
# shore(x, y, cos psi, sin psi, u_w, v_w) -> (X, Y, N) in N, N, N m, in body axes
#   Arguments: position (m from the start), heading, velocity through the water in body axes (m/s).
Shore = Callable[[float, float, float, float, float, float], tuple[float, float, float]]
# tether(x, y, v_north, v_east) -> (north, east): force (N) at a position (m from the start) and velocity over ground
Tether = Callable[[float, float, float, float], tuple[float, float]]
# accelerometer(a_x, a_y, thrust, u, r) -> (a_x, a_y): measured acceleration (m/s2) from the true one
#   Further arguments: thrust of both thrusters (N), surge over ground (m/s), yaw rate (rad/s).
Accelerometer = Callable[[float, float, float, float, float], tuple[float, float]]

ENERGY_UNIT = 150.0  # s; integral of |n|^3 over a mission of ten minutes, summed over both thrusters


@dataclass(frozen=True)
class Wave:
    """Long-crested irregular waves with one peak in their spectrum.

    Attributes
    ----------
    frequency : float
        Frequency of the spectral peak [Hz].
    width : float
        Width of the peak, as a fraction of ``frequency``.
    toward : float
        Direction in which the waves travel [rad], from north to east.
    surge : float
        Standard deviation of the surge force [N] if the waves travel along the boat.
    sway : float
        Standard deviation of the sway force [N] if the waves travel across the boat.
    yaw : float
        Standard deviation of the yaw moment [N m] if the waves travel at 45 degrees to the boat.
    """

    frequency: float
    width: float
    toward: float
    surge: float
    sway: float
    yaw: float


@dataclass(frozen=True)
class Gust:
    """Gusts: first-order Gauss-Markov forces whose strength alternates between strong and weak.

    Attributes
    ----------
    sigma : tuple of three floats
        Standard deviations of the surge force, the sway force and the yaw moment [N, N, N m], as RMS over a period.
    tau : float
        Correlation time of the forces [s].
    period : float
        Time from the start of one strong phase to the start of the next [s]. The first half of it is strong, the second
        half a fifth as strong. The first strong phase begins at the start of a run.
    """

    sigma: tuple[float, float, float]
    tau: float
    period: float


@dataclass(frozen=True)
class Noise:
    """Noise of AHRS and GNSS that a hidden effect changes: size of white noise, correlated GNSS errors and outliers.

    Attributes
    ----------
    gain : float
        Factor on the standard deviations of the white noise of AHRS (except its magnetometer) and GNSS.
    colour : tuple of two floats
        Gauss-Markov error of each axis of the GNSS position: standard deviation [m] and correlation time [s]. A
        standard deviation of 0 switches it off.
    outliers : tuple of two floats
        Fraction of the GNSS fixes that are outliers, and standard deviation of their additional error per axis [m]. A
        fraction of 0 switches them off.
    """

    gain: float = 1.0
    colour: tuple[float, float] = (0.0, 1.0)
    outliers: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Answer:
    """Correct diagnosis of an effect that has no name in the catalogue of ident: a force as a function of one variable.

    Attributes
    ----------
    force : str
        Affected force: "X" (surge), "Y" (sway) or "N" (yaw moment).
    variable : str
        Variable on which the force depends: "u", "v", "r", "psi", "n_sum" (mean of both shaft speeds) or "n_diff" (left
        minus right shaft speed).
    curve : callable
        Function of the variable (SI, shaft speeds normalised) that returns the force [N] or moment [N m].
    """

    force: str
    variable: str
    curve: Callable[[float], float]


@dataclass(frozen=True)
class HeadingFilter:
    """Filter and dead time of the heading that an AHRS reports. Yaw rate and acceleration are not affected.

    Attributes
    ----------
    time_constant : float
        Time constant of a complementary filter [s]. The filter integrates the yaw gyro, and the compass corrects the
        integral with this time constant. The heading then follows a turn at once, and the compass deviation at the new
        heading slowly. 0 means that the heading is that of the compass.
    lag : float
        Dead time from the filter to the reported heading [s].
    """

    time_constant: float
    lag: float


@dataclass(frozen=True)
class Telemetry:
    """Age, resolution and limit of the telemetry of the speed controllers, which a hidden effect changes.

    Attributes
    ----------
    age : float
        Age of all values of a sample at its time stamp [s], as a whole number of steps of the plant.
    resolution : float
        The reported shaft speed is a whole multiple of this value, which is a fraction of the full shaft speed. 0 means
        that the shaft speed is not rounded.
    ceiling : float
        Largest magnitude of the reported shaft speed, as a fraction of the full shaft speed. Larger speeds are reported
        with this magnitude.
    """

    age: float = 0.0
    resolution: float = 0.0
    ceiling: float = math.inf


@dataclass(frozen=True)
class Payload:
    """Payload that slides in the boat at one time. The mass of the boat does not change.

    Attributes
    ----------
    at : float
        Time of the change after the start [s].
    x_g : float
        Change of the position of the centre of gravity of the boat, forward [m].
    """

    at: float
    x_g: float


@dataclass(frozen=True)
class Fouling:
    """Weed that the propellers catch at one time.

    Attributes
    ----------
    at : float
        Time of the change after the start [s].
    left, right : float
        Share of its thrust that each thruster loses then.
    """

    at: float
    left: float
    right: float


@dataclass(frozen=True)
class Heating:
    """Thrusters that lose thrust while they are hot. Each thruster has its own temperature.

    Attributes
    ----------
    loss : float
        Share of its thrust that a thruster loses at the temperature of continuous full power.
    tau : float
        Time constant with which a thruster becomes hot [s]. It cools more slowly, with 1.25 times this time.
    """

    loss: float
    tau: float


@dataclass(frozen=True)
class Growth:
    """Steady growth of mass or drag from the start of the boat on, by a leak or by weed.

    Attributes
    ----------
    mass : float
        Growth of mass and moment of inertia, as a share of those at the start [1/s].
    drag : float
        Growth of the surge damping, as a share of that at the start [1/s].
    """

    mass: float = 0.0
    drag: float = 0.0


@dataclass(frozen=True)
class Line:
    """Line that the boat tows through the water.

    Attributes
    ----------
    length : float
        Length of the line [m].
    drag : float
        Drag of the line over its squared speed through the water [N s2/m2].
    x : float
        Position of the tow point forward of the origin of the body frame [m].
    """

    length: float
    drag: float
    x: float


@dataclass(frozen=True)
class HiddenEffect:
    """Hidden effect of the mock boat: its name, its true parameters and its hooks.

    Hooks that the effect does not use have their default: None, zero, or 1 for `braking`. The comments at the top of
    this file give the arguments of the callable hooks.

    Attributes
    ----------
    name : str
        Name of the effect, for example "wind".
    sentence : str
        Description for the user.
    parameters : dict of str to float
        True values of the parameters (SI), for the ground-truth file.
    thrust : callable, optional
        Function of the shaft speeds, inflow velocities and previous thrusts of both thrusters and the used energy. It
        returns the thrusts that replace the previous ones [N].
    inflow : tuple of two floats
        Delay and time constant of a first-order lag from shaft speed to thrust [s].
    slowness : tuple of two floats
        Addition to the time constant of this lag for the left and the right thruster [s].
    heating : Heating, optional
        Loss of thrust of hot thrusters.
    force : callable, optional
        Returns an additional force and moment (X, Y, N) [N, N, N m], given heading, velocity through the water, yaw
        rate and velocity over ground.
    jet : callable, optional
        Returns an additional sway force [N] and yaw moment [N m] as a function of both shaft speeds.
    tether : callable, optional
        Returns an additional force [N], north and east, as a function of position and velocity over ground.
    current : callable, optional
        Returns the difference of the ocean current from the boat's constant one [m/s], north and east, as a function of
        time.
    stream : callable, optional
        Returns the difference of the ocean current from the boat's constant one [m/s], north and east, as a function of
        the position.
    shore : callable, optional
        Returns an additional force and moment (X, Y, N) [N, N, N m], given position, heading and velocity through the
        water.
    line : Line, optional
        Line that the boat tows.
    payload : Payload, optional
        Payload that slides at one time.
    fouling : Fouling, optional
        Weed that the propellers catch at one time.
    growth : Growth, optional
        Growth of mass or drag with time.
    wave : Wave, optional
        Waves that act on the boat.
    gust : Gust, optional
        Gusts that act on the boat.
    x_g : float
        Position of the centre of gravity forward of the origin of the body frame [m].
    pendulum : tuple of three floats, optional
        Mass [kg], length [m] and damping [1/s] of a payload that swings fore and aft.
    compass : callable, optional
        Returns the compass deviation [rad] (measured minus true) as a function of heading [rad].
    mount : float
        Rotation of the AHRS about the vertical axis [rad]: measured minus true heading.
    gyro : callable, optional
        Returns the error of the yaw gyro [rad/s] as a function of the true yaw rate [rad/s].
    accelerometer : callable, optional
        Returns the measured acceleration [m/s2], forward and to starboard, given the true one, the thrust, the surge
        over ground and the yaw rate.
    lever_arm : tuple of two floats, optional
        True position of the GNSS antenna from the origin [m], forward and to starboard.
    latency : float
        Latency of the GNSS fixes [s].
    noise : Noise, optional
        Noise that differs from the declared noise.
    answer : Answer, optional
        Correct diagnosis of an effect that has no name in the catalogue of ident.
    heading_filter : HeadingFilter, optional
        Filter and lag of the reported heading.
    telemetry : Telemetry, optional
        Age, resolution and limit of the telemetry of both speed controllers.
    velocity_resolution : float
        Resolution of each component of the GNSS velocity [m/s]. 0 means that the velocity is not rounded.
    braking : float
        Factor on the time constant of both shafts while they slow down.
    minor : bool
        Whether the effect is one of the small imperfections of a realistic boat, and not the effect to be found.
    """

    name: str
    sentence: str
    parameters: dict[str, float] = field(default_factory=dict)
    thrust: Thrust | None = None
    inflow: tuple[float, float] = (0.0, 0.0)
    slowness: tuple[float, float] = (0.0, 0.0)
    heating: Heating | None = None
    force: Force | None = None
    jet: Jet | None = None
    tether: Tether | None = None
    current: Current | None = None
    stream: Stream | None = None
    shore: Shore | None = None
    payload: Payload | None = None
    fouling: Fouling | None = None
    growth: Growth | None = None
    line: Line | None = None
    wave: Wave | None = None
    gust: Gust | None = None
    x_g: float = 0.0
    pendulum: tuple[float, float, float] | None = None
    compass: Callable[[float], float] | None = None
    mount: float = 0.0
    gyro: Callable[[float], float] | None = None
    accelerometer: Accelerometer | None = None
    lever_arm: tuple[float, float] | None = None
    latency: float = 0.0
    noise: Noise | None = None
    answer: Answer | None = None
    heading_filter: HeadingFilter | None = None
    telemetry: Telemetry | None = None
    velocity_resolution: float = 0.0
    braking: float = 1.0
    minor: bool = False


# maker(rng, scale) -> HiddenEffect: draws the size of an effect and multiplies it by scale
Maker = Callable[[np.random.Generator, float], HiddenEffect]


def effect_size(rng: np.random.Generator, full: float, *, signed: bool = False) -> float:
    """Draw the random size of a hidden effect.

    Parameters
    ----------
    rng : np.random.Generator
        Generator of random numbers. One number is drawn, or two if ``signed`` is true.
    full : float
        Mean size, in any unit.
    signed : bool
        Whether the sign is random too, plus or minus with equal probability.

    Returns
    -------
    float
        ``full`` times a factor that is uniform between 0.85 and 1.15, with the random sign.
    """
    sign = -1.0 if signed and rng.uniform() < 0.5 else 1.0
    return float(sign * full * rng.uniform(0.85, 1.15))
