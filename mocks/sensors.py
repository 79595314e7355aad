"""Plant -> samples: what the sensors of the boat and of the bench say, with their noise.

Noise is white plus a random walk (thesis, section 4.1), sized like a VN-100, an RTK-float receiver and an HX711.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from seatrial.daq.samples import NAN, Ahrs, Esc, Gnss, LoadCell
from seatrial.mocks.plant import GRAVITY, HiddenEffect, RigidBodyState
from seatrial.mocks.random_streams import (
    AHRS,
    COLOUR,
    ESC,
    GNSS,
    LOADCELL,
    OUTLIERS,
    OrnsteinUhlenbeck,
    WhiteWalk,
    normals,
    random_stream,
)

DEG = math.pi / 180.0
STOPPED = 0.005  # normalised shaft speed below which a sensorless controller reports none
FIELD_NORTH, FIELD_DOWN = 26.4e-6, 35.6e-6  # T, near Lisbon
LATITUDE, LONGITUDE = 38.765852, -9.09281873  # of the plant's origin (mred_sim.yaml)
_A, _E2 = 6378137.0, 6.69437999014e-3  # WGS 84


def wrap(angle: float) -> float:
    """``angle`` (rad) in -pi..pi."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def geodetic(north: float, east: float) -> tuple[float, float]:
    """Latitude and longitude (deg) of a point on the tangent plane at the origin (WGS 84 radii of curvature)."""
    w2 = 1.0 - _E2 * math.sin(LATITUDE * DEG) ** 2
    meridian, prime = _A * (1.0 - _E2) / w2**1.5, _A / math.sqrt(w2)
    return LATITUDE + north / meridian / DEG, LONGITUDE + east / (prime * math.cos(LATITUDE * DEG)) / DEG


class AhrsSensor:
    """Attitude, rates and specific force; the boat is level but for the noise of roll and pitch."""

    def __init__(self, seed: int, run: int, rate: float, effects: Sequence[HiddenEffect] = (), index: int = 0) -> None:
        """``rate`` in Hz, ``index`` of several; ``effects``: those of the boat, of which some are the sensor's."""
        self._errors = AhrsErrors(effects)
        gain = _noise_gain(effects)
        draw = normals(random_stream(seed, AHRS, run, index))
        dt = 1.0 / rate
        self._yaw = WhiteWalk(draw, dt, gain * 0.5 * DEG, 0.01 * DEG)
        self._tilt = [WhiteWalk(draw, dt, gain * 0.05 * DEG) for _ in range(2)]
        self._rates = [WhiteWalk(draw, dt, gain * 0.01, 1e-5, bias=0.003) for _ in range(3)]
        self._accels = [WhiteWalk(draw, dt, gain * 0.1, 1e-4, bias=0.05) for _ in range(3)]
        self._field = WhiteWalk(draw, dt, 0.15e-6)

    def read(self, m: RigidBodyState) -> Ahrs:
        """The sample of the motion ``m``."""
        psi, rate, accel_x, accel_y = self._errors.apply(m)
        pitch, roll = self._tilt
        p, q, r = self._rates
        ax, ay, az = self._accels
        field = self._field
        return Ahrs(
            wrap(psi + self._yaw()),
            pitch(),
            roll(),
            p(),
            q(),
            rate + r(),
            accel_x + ax(),
            accel_y + ay(),
            -GRAVITY + az(),
            FIELD_NORTH * math.cos(psi) + field(),
            -FIELD_NORTH * math.sin(psi) + field(),
            FIELD_DOWN + field(),
        )


class AhrsErrors:
    """What the hidden effects do to heading, yaw rate and accelerations, before there is any noise."""

    def __init__(self, effects: Sequence[HiddenEffect]) -> None:
        self._compasses = [e.compass for e in effects if e.compass is not None]
        self._gyros = [e.gyro for e in effects if e.gyro is not None]
        self._accelerometers = [e.accelerometer for e in effects if e.accelerometer is not None]
        self._mount = sum(e.mount for e in effects)

    def apply(self, m: RigidBodyState) -> tuple[float, float, float, float]:
        """Heading (rad), yaw rate (rad/s) and accelerations (m/s2) that the sensor has of the motion ``m``."""
        u = math.cos(m.psi) * m.vel_n + math.sin(m.psi) * m.vel_e
        psi = m.psi + sum(deviation(m.psi) for deviation in self._compasses) + self._mount
        rate = m.r + sum(error(m.r) for error in self._gyros)
        ax, ay = m.ax, m.ay
        for accelerometer in self._accelerometers:
            ax, ay = accelerometer(ax, ay, m.thrust, u, m.r)
        if self._mount:
            c, s = math.cos(self._mount), math.sin(self._mount)
            ax, ay = c * ax + s * ay, c * ay - s * ax
        return psi, rate, ax, ay


def _noise_gain(effects: Sequence[HiddenEffect]) -> float:
    return math.prod(e.noise.gain for e in effects if e.noise is not None)


class GnssSensor:
    """Position and velocity of the antenna."""

    def __init__(
        self,
        seed: int,
        run: int,
        rate: float,
        effects: Sequence[HiddenEffect] = (),
        sigma: float = 0.15,
        index: int = 0,
    ) -> None:
        """``rate`` in Hz, ``sigma`` (m) the white part of each horizontal axis, ``index`` of several."""
        draw, gain = normals(random_stream(seed, GNSS, run, index)), _noise_gain(effects)
        dt = 1.0 / rate
        self._sigma = sigma
        self._position = [WhiteWalk(draw, dt, gain * sigma, 0.003) for _ in range(2)]
        self._velocity = [WhiteWalk(draw, dt, gain * 0.05) for _ in range(2)]
        self._height = WhiteWalk(draw, dt, 2.0 * gain * sigma)
        self._stray = GnssErrors(effects, seed, run, dt, index)

    def read(self, m: RigidBodyState, utc: float) -> Gnss:
        """The fix of the motion ``m``, stamped ``utc`` (s since 1970)."""
        north, east = self._position
        vel_n, vel_e = self._velocity
        stray_n, stray_e = self._stray.step()
        lat, lon = geodetic(m.fix_x + north() + stray_n, m.fix_y + east() + stray_e)
        return Gnss(
            utc,
            lat,
            lon,
            self._height(),
            m.fix_vel_n + vel_n(),
            m.fix_vel_e + vel_e(),
            NAN,
            6,
            17,
            0.8,
            self._sigma,
        )


class GnssErrors:
    """Errors of the fix beyond its white noise: a time-correlated one, and now and then an outlier."""

    def __init__(self, effects: Sequence[HiddenEffect], seed: int, run: int, dt: float, index: int) -> None:
        noises = [e.noise for e in effects if e.noise is not None]
        draw = normals(random_stream(seed, COLOUR, run, index))
        self._correlated = [
            (OrnsteinUhlenbeck(draw, dt, *n.colour), OrnsteinUhlenbeck(draw, dt, *n.colour))
            for n in noises
            if n.colour[0]
        ]
        self._wild = [n.outliers for n in noises if n.outliers[0]]
        self._rng = random_stream(seed, OUTLIERS, run, index)

    def step(self) -> tuple[float, float]:
        """Error to the north and to the east (m) of the next fix."""
        north = sum(pair[0].step() for pair in self._correlated)
        east = sum(pair[1].step() for pair in self._correlated)
        for share, far in self._wild:
            if self._rng.uniform() < share:
                wrong_n, wrong_e = self._rng.normal(0.0, far, 2)
                north, east = north + float(wrong_n), east + float(wrong_e)
        return north, east


class EscSensor:
    """Shaft speed with 5 rev/min of noise; current and temperature follow the thrust, voltage the battery."""

    def __init__(self, seed: int, run: int, node: int, rpm_max: float) -> None:
        self._draw = normals(random_stream(seed, ESC, run, node))
        self._node = node
        self._rpm_max = rpm_max
        self._heat = 0.0

    def read(self, n: float, force: float, duty: float, energy: float, dt: float) -> Esc:
        """State at shaft speed ``n`` and thrust ``force`` (N), ``dt`` (s) after the last one; signs as on the wire.

        ``energy`` (s) is the integral of abs(n)^3 over the thrusters, which empties the battery.
        """
        draw = self._draw
        n = n if abs(n) > STOPPED else 0.0
        current = 0.4 * (n != 0.0) + 0.55 * abs(force) * (0.3 + 0.7 * abs(n))
        self._heat += dt / 60.0 * (0.02 * current**2 - self._heat)
        return Esc(
            self._node,
            n * self._rpm_max + (5.0 * draw() if n else 0.0),
            current + 0.1 * draw(),  # of a motor that drives, whichever way
            duty,
            16.4 - 0.008 * energy - 0.02 * current + 0.02 * draw(),
            24.0 + self._heat + 0.1 * draw(),
        )


@dataclass(frozen=True)
class CellSpec:
    """A load cell and how its counts are calibrated."""

    name: str
    rate_hz: float
    newton_per_count: float = 0.001  # at the thruster
    zero_counts: float = 84210.0
    saturation: float = 8388607.0


class LoadCellSensor:
    """Counts of a cell with a slow drift and a true zero 0.3 N or so off the calibrated one."""

    def __init__(self, seed: int, run: int, spec: CellSpec, index: int = 0) -> None:
        """``index`` of several."""
        draw = normals(random_stream(seed, LOADCELL, run, index))
        self._noise = WhiteWalk(draw, 1.0 / spec.rate_hz, 0.1, 0.001, bias=0.3)
        self._spec = spec

    def read(self, force: float) -> LoadCell:
        """The reading of ``force`` (N)."""
        spec = self._spec
        counts = round(spec.zero_counts + (force + self._noise()) / spec.newton_per_count)
        return LoadCell(float(max(-spec.saturation - 1.0, min(spec.saturation, counts))))
