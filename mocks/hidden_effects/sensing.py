"""Hidden effects of the sensors: systematic errors of AHRS, GNSS and the telemetry of the shafts."""

from __future__ import annotations

import math

import numpy as np

from seatrial.mocks.plant import HiddenEffect, Maker, Telemetry, effect_size

GRAVITY = 9.81  # m/s2


def _compass(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "compass": a compass deviation as a function of heading.

    The heading error (measured minus true) is ``b sin(psi) + c cos(psi) + d sin(2 psi)`` [rad]. ``b``, ``c`` and ``d``
    are drawn within 15 % of ``0.045 scale``, ``0.03 scale`` and ``0.006 scale``, with random signs.
    """
    b, c = scale * effect_size(rng, 0.045, signed=True), scale * effect_size(rng, 0.03, signed=True)  # rad
    d = scale * effect_size(rng, 0.006, signed=True)

    def compass(psi: float) -> float:
        """Return the compass deviation [rad], measured minus true, at the true heading ``psi`` [rad]."""
        return b * math.sin(psi) + c * math.cos(psi) + d * math.sin(2.0 * psi)

    sentence = "iron on board deviates the compass, by an angle that depends on heading"
    return HiddenEffect("compass", sentence, {"b_sin": b, "c_cos": c, "d_sin2": d}, compass=compass)


def _lever_arm(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "lever-arm": a GNSS antenna that lies ``(l_x, l_y)`` [m] from its place in the rig file.

    Position and velocity at the antenna are ``p + R(psi) l`` and ``R(psi) (u - r l_y, v + r l_x)``. ``l_x`` and ``l_y``
    are drawn within 15 % of ``0.5 scale`` and ``0.15 scale``, with random signs.
    """
    forward, starboard = scale * effect_size(rng, 0.5, signed=True), scale * effect_size(rng, 0.15, signed=True)  # m
    sentence = "the GNSS antenna is not at the place in the rig file"
    return HiddenEffect("lever-arm", sentence, {"l_x": forward, "l_y": starboard}, lever_arm=(forward, starboard))


def _gnss_latency(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "gnss-latency": GNSS fixes that are ``latency`` [s] older than their time stamp.

    60 % of the latency is dead time. 40 % is the time constant of a first-order filter (``Antenna`` in
    seatrial.mocks.plant.boat). ``latency`` is drawn within 15 % of ``0.35 scale``.
    """
    latency = scale * effect_size(rng, 0.35)  # s
    sentence = "the GNSS receiver filters and delivers old fixes as if they were new"
    return HiddenEffect("gnss-latency", sentence, {"latency": latency}, latency=latency)


def _mount(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "mount": an AHRS that is mounted with a rotation of ``psi_0`` [rad] about the z axis.

    The heading is measured as ``psi + psi_0``, and the accelerations are measured in the rotated axes. ``psi_0`` is
    drawn within 15 % of ``0.06 scale`` with a random sign.
    """
    turn = scale * effect_size(rng, 0.06, signed=True)  # rad
    sentence = f"the AHRS is screwed on {abs(math.degrees(turn)):.1f} deg askew"
    return HiddenEffect("mount", sentence, {"psi_0": turn}, mount=turn)


def _gyro_scale(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "gyro-scale": a scale error of the yaw gyro.

    The error of the yaw rate is ``k (r + 0.15 r |r|)`` [rad/s]. ``k`` is drawn within 15 % of ``0.03 scale`` with a
    random sign.
    """
    k = scale * effect_size(rng, 0.03, signed=True)

    def gyro(r: float) -> float:
        """Return the error of the yaw rate [rad/s], measured minus true, at the true yaw rate ``r`` [rad/s]."""
        return k * (r + 0.15 * r * abs(r))

    return HiddenEffect("gyro-scale", "the yaw gyro's scale is off", {"k": k}, gyro=gyro)


def _accelerometer_tilt(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "accelerometer-tilt": accelerometers that measure a part of gravity.

    The boat pitches with thrust and heels in turns, although its simulated motion stays in the horizontal plane.

    With the thrust ``T`` [N] of both thrusters::

        a_x -> a_x + g 0.05 tanh(pitch T / 0.05)
        a_y -> a_y + g 0.12 tanh(roll u r / 0.12)

    ``pitch`` [rad/N] is drawn within 15 % of ``4e-4 scale``, and ``roll`` [rad s2/m] within 15 % of ``0.04 scale``.
    """
    pitch, roll = scale * effect_size(rng, 4e-4), scale * effect_size(rng, 0.04)  # rad/N, rad s2/m

    def accelerometer(a_x: float, a_y: float, thrust: float, u: float, r: float) -> tuple[float, float]:
        """Return the measured acceleration [m/s2], forward and to starboard: the true one plus a part of gravity.

        ``a_x`` and ``a_y`` [m/s2] are the true acceleration, ``thrust`` [N] is that of both thrusters, ``u`` [m/s] the
        surge velocity over ground, and ``r`` [rad/s] the yaw rate.
        """
        squat = 0.05 * math.tanh(pitch * thrust / 0.05)
        heel = 0.12 * math.tanh(roll * u * r / 0.12)
        return a_x + GRAVITY * squat, a_y + GRAVITY * heel

    sentence = "the boat pitches with thrust and heels in turns, and the accelerometers feel gravity"
    return HiddenEffect("accelerometer-tilt", sentence, {"pitch": pitch, "roll": roll}, accelerometer=accelerometer)


def _accelerometer_scale(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "accelerometer-scale": a scale error of the accelerometers.

    The acceleration ``a`` [m/s2] of each axis is multiplied by ``1 + k / (1 + 0.1 |a|)``. ``k`` is drawn within 15 % of
    ``0.15 scale`` with a random sign.
    """
    k = scale * effect_size(rng, 0.15, signed=True)

    def accelerometer(a_x: float, a_y: float, thrust: float, u: float, r: float) -> tuple[float, float]:
        """Return the measured acceleration [m/s2], forward and to starboard: the true one with its scale error.

        ``a_x`` and ``a_y`` [m/s2] are the true acceleration. The other arguments are not used.
        """
        return a_x * (1.0 + k / (1.0 + 0.1 * abs(a_x))), a_y * (1.0 + k / (1.0 + 0.1 * abs(a_y)))

    sentence = "the accelerometers are set to another range than the driver assumes"
    return HiddenEffect("accelerometer-scale", sentence, {"k": k}, accelerometer=accelerometer)


def _shaft_clip(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "shaft-clip": telemetry that cannot report large shaft speeds.

    Both controllers report at most ``ceiling = 1 - cut`` times the full shaft speed. ``cut`` is drawn within 15 % of
    ``0.35 scale``. With ``scale`` 0 there is no limit.
    """
    cut = scale * effect_size(rng, 0.35)
    ceiling = 1.0 - cut if cut else math.inf
    sentence = f"the telemetry reports at most {100.0 * (1.0 - cut):.0f} % of the full shaft speed"
    return HiddenEffect("shaft-clip", sentence, {"ceiling": ceiling}, telemetry=Telemetry(ceiling=ceiling))


MAKERS: dict[str, Maker] = {
    "compass": _compass,
    "lever-arm": _lever_arm,
    "gnss-latency": _gnss_latency,
    "mount": _mount,
    "gyro-scale": _gyro_scale,
    "accelerometer-tilt": _accelerometer_tilt,
    "accelerometer-scale": _accelerometer_scale,
    "shaft-clip": _shaft_clip,
}
