"""Sensor models of the boat and of the bench: samples with noise from the true motion of the plant.

The noise is white noise plus a random walk (thesis, section 4.1). Its sizes are those of a VN-100 (AHRS), a GNSS
receiver with an RTK float solution, and an HX711 (load cell).

Positions on the earth are computed here and not by `seatrial.daq.geometry`, so that an error in that module changes the
logs and not the truth.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from seatrial.daq.samples import NAN, Ahrs, Esc, Gnss, LoadCell
from seatrial.mocks.plant import GRAVITY, HeadingFilter, HiddenEffect, RigidBodyState, Telemetry
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
STOPPED = 0.005  # normalised shaft speed below which a sensorless controller reports zero
FIELD_NORTH, FIELD_DOWN = 26.4e-6, 35.6e-6  # T, near Lisbon
LATITUDE, LONGITUDE = 38.765852, -9.09281873  # deg, of the plant's origin (mred_sim.yaml)
_A, _E2 = 6378137.0, 6.69437999014e-3  # WGS 84: semi-major axis in m, squared eccentricity


def wrap(angle: float) -> float:
    """Return the angle in [-pi, pi) [rad] that differs from ``angle`` [rad] by whole turns."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def geodetic(north: float, east: float) -> tuple[float, float]:
    """Return latitude and longitude [deg] of a point that lies ``north`` and ``east`` [m] of the start of the boat.

    The start is a fixed place near Lisbon. The distances are divided by the WGS 84 radii of curvature at this place
    (tangent plane).
    """
    w2 = 1.0 - _E2 * math.sin(LATITUDE * DEG) ** 2
    meridian, prime = _A * (1.0 - _E2) / w2**1.5, _A / math.sqrt(w2)
    return LATITUDE + north / meridian / DEG, LONGITUDE + east / (prime * math.cos(LATITUDE * DEG)) / DEG


class AhrsSensor:
    """Model of an AHRS: it measures attitude, angular rates, specific force and magnetic field with noise and errors.

    The simulated boat is always level, so that roll and pitch are noise around zero.
    """

    def __init__(self, seed: int, run: int, rate: float, effects: Sequence[HiddenEffect] = (), index: int = 0) -> None:
        """Set up a simulated AHRS with its noise and its hidden effects.

        Parameters
        ----------
        seed : int
            Seed of the boat or bench.
        run : int
            Number of the run. It selects the noise.
        rate : float
            Rate of the samples [Hz].
        effects : sequence of HiddenEffect
            All hidden effects of the boat. The sensor applies those that concern an AHRS.
        index : int
            Number of the AHRS on the boat. It selects the stream of random numbers.
        """
        self._errors = AhrsErrors(effects, 1.0 / rate)
        gain = _noise_gain(effects)
        draw = normals(random_stream(seed, AHRS, run, index))
        dt = 1.0 / rate
        self._yaw = WhiteWalk(draw, dt, gain * 0.5 * DEG, 0.01 * DEG)
        self._tilt = [WhiteWalk(draw, dt, gain * 0.05 * DEG) for _ in range(2)]
        self._rates = [WhiteWalk(draw, dt, gain * 0.01, 1e-5, bias=0.003) for _ in range(3)]
        self._accels = [WhiteWalk(draw, dt, gain * 0.1, 1e-4, bias=0.05) for _ in range(3)]
        self._field = WhiteWalk(draw, dt, 0.15e-6)

    def read(self, m: RigidBodyState) -> Ahrs:
        """Return the next AHRS sample, for the true motion ``m``. Each call advances the noise by one sample.

        The hidden effects of the sensor and the noise are added to the motion. The heading is in [-pi, pi) [rad].
        """
        psi, psi_field, rate, accel_x, accel_y = self._errors.step(m)
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
            FIELD_NORTH * math.cos(psi_field) + field(),
            -FIELD_NORTH * math.sin(psi_field) + field(),
            FIELD_DOWN + field(),
        )


class AhrsErrors:
    """Systematic errors of a simulated AHRS that hidden effects cause. They do not include noise.

    The errors are those of compass, mounting, gyro, accelerometers and heading filter. `step` returns the true motion
    with these errors.
    """

    def __init__(self, effects: Sequence[HiddenEffect], dt: float) -> None:
        """Take from the hidden ``effects`` those errors that concern an AHRS. Other effects are ignored.

        Errors of compass, gyro and mounting of several effects add up. Accelerometer errors are applied one after the
        other, before the rotation of the mounting. ``dt`` is the time between two samples [s].
        """
        self._compasses = [e.compass for e in effects if e.compass is not None]
        self._gyros = [e.gyro for e in effects if e.gyro is not None]
        self._accelerometers = [e.accelerometer for e in effects if e.accelerometer is not None]
        self._mount = sum(e.mount for e in effects)
        filters = [e.heading_filter for e in effects if e.heading_filter is not None]
        self._filter = FilteredHeading(filters, dt) if filters else None

    def step(self, m: RigidBodyState) -> tuple[float, float, float, float, float]:
        """Return the motion that the AHRS measures, without noise, for the true motion ``m``.

        Each call advances the filter of the heading by one sample.

        Returns
        -------
        tuple of five floats
            Reported heading [rad] and heading of the magnetic field [rad], both not limited to a turn, yaw rate
            [rad/s], and acceleration [m/s2] forward and to starboard. The two headings are equal if no effect filters
            or delays the heading.
        """
        u = math.cos(m.psi) * m.vel_n + math.sin(m.psi) * m.vel_e
        deviation = sum(compass(m.psi) for compass in self._compasses)
        psi_field = psi = m.psi + deviation + self._mount
        gyro_error = sum(error(m.r) for error in self._gyros)
        rate = m.r + gyro_error
        if self._filter is not None:
            psi = self._filter.step(m.psi, deviation, gyro_error) + self._mount
        ax, ay = m.ax, m.ay
        for accelerometer in self._accelerometers:
            ax, ay = accelerometer(ax, ay, m.thrust, u, m.r)
        if self._mount:
            c, s = math.cos(self._mount), math.sin(self._mount)
            ax, ay = c * ax + s * ay, c * ay - s * ax
        return psi, psi_field, rate, ax, ay


class FilteredHeading:
    """Heading that a simulated AHRS reports behind a complementary filter of gyro and compass, and a dead time.

    With the true heading ``psi``, the compass deviation ``d`` and the gyro error ``g``, the filter computes
    ``h' = psi' + g + (psi + d - h) / T``. Its error ``e = h - psi`` is therefore a first-order lag of ``d + T g``:
    ``T e' = d + T g - e``. The filter is computed in this form, which needs no integration of the yaw rate. The white
    noise and the bias of the gyro are not filtered: the filter of an AHRS estimates the bias.
    """

    def __init__(self, filters: Sequence[HeadingFilter], dt: float) -> None:
        """Set up the filter of the heading. ``dt`` is the time between two samples [s].

        Time constants and dead times of several ``filters`` add up.
        """
        self._time_constant = sum(f.time_constant for f in filters)
        self._keep = math.exp(-dt / self._time_constant) if self._time_constant else 0.0
        lag = sum(f.lag for f in filters) / dt
        self._whole, self._fraction = int(lag), lag - int(lag)
        self._error: float | None = None
        self._headings: deque[float] = deque(maxlen=self._whole + 2)  # from the oldest to the newest

    def step(self, psi: float, deviation: float, gyro_error: float) -> float:
        """Advance the filter by one sample, and return the reported heading [rad], not limited to a turn.

        Parameters
        ----------
        psi : float
            True heading [rad], not limited to a turn.
        deviation : float
            Compass deviation [rad] at this heading.
        gyro_error : float
            Error of the yaw rate [rad/s].

        Notes
        -----
        Between two samples the heading is interpolated linearly. Until the dead time has passed, the oldest heading is
        returned. The first call starts the filter without a transient.
        """
        settled = deviation + self._time_constant * gyro_error
        self._error = settled if self._error is None else settled + self._keep * (self._error - settled)
        self._headings.append(psi + self._error)
        n_headings = len(self._headings)
        late = self._headings[max(0, n_headings - 1 - self._whole)]
        later = self._headings[max(0, n_headings - 2 - self._whole)]
        return late + self._fraction * (later - late)


def _rounded(value: float, resolution: float) -> float:
    """Round ``value`` to the nearest whole multiple of ``resolution``; return it unchanged if ``resolution`` is 0."""
    return round(value / resolution) * resolution if resolution else value


def _noise_gain(effects: Sequence[HiddenEffect]) -> float:
    """Return the factor by which ``effects`` together multiply the white noise of AHRS and GNSS; 1 without any.

    The noise of the magnetic field is not multiplied.
    """
    return math.prod(e.noise.gain for e in effects if e.noise is not None)


class GnssSensor:
    """Model of a GNSS receiver: it measures position and velocity of its antenna with noise and errors."""

    def __init__(
        self,
        seed: int,
        run: int,
        rate: float,
        effects: Sequence[HiddenEffect] = (),
        sigma: float = 0.15,
        index: int = 0,
    ) -> None:
        """Set up a simulated GNSS receiver with its noise and its hidden effects.

        Parameters
        ----------
        seed : int
            Seed of the boat or bench.
        run : int
            Number of the run. It selects the noise.
        rate : float
            Rate of the fixes [Hz].
        effects : sequence of HiddenEffect
            All hidden effects of the boat. The receiver applies those of the noise and of the resolution of velocity.
        sigma : float
            Standard deviation of the white noise of each horizontal axis [m], before the effects multiply it. It is
            also the accuracy that each sample reports.
        index : int
            Number of the receiver on the boat. It selects the stream of random numbers.
        """
        draw, gain = normals(random_stream(seed, GNSS, run, index)), _noise_gain(effects)
        dt = 1.0 / rate
        self._sigma = sigma
        self._position = [WhiteWalk(draw, dt, gain * sigma, 0.003) for _ in range(2)]
        self._velocity = [WhiteWalk(draw, dt, gain * 0.05) for _ in range(2)]
        self._height = WhiteWalk(draw, dt, 2.0 * gain * sigma)
        self._errors = GnssErrors(effects, seed, run, dt, index)
        self._resolution = max((e.velocity_resolution for e in effects), default=0.0)

    def read(self, m: RigidBodyState, utc: float) -> Gnss:
        """Return the next GNSS sample, for the true motion ``m``, with the time stamp ``utc`` [s since 1970].

        Each call advances the noise by one sample. Lever arm and latency are already in ``m`` (`RigidBodyState.fix_x`).
        The velocity is rounded to the coarsest resolution of the hidden effects. The height is noise around 0 m. The
        type of fix is 6, an RTK float solution.
        """
        north, east = self._position
        vel_n, vel_e = self._velocity
        error_n, error_e = self._errors.step()
        lat, lon = geodetic(m.fix_x + north() + error_n, m.fix_y + east() + error_e)
        return Gnss(
            utc,
            lat,
            lon,
            self._height(),
            _rounded(m.fix_vel_n + vel_n(), self._resolution),
            _rounded(m.fix_vel_e + vel_e(), self._resolution),
            NAN,
            6,
            17,
            0.8,
            self._sigma,
        )


class GnssErrors:
    """Errors of the position of a simulated GNSS receiver that hidden effects cause: correlated error and outliers."""

    def __init__(self, effects: Sequence[HiddenEffect], seed: int, run: int, dt: float, index: int) -> None:
        """Set up the position errors of one GNSS receiver in one run, from the noise of the hidden ``effects``.

        The errors of several effects add up.
        ``seed``, ``run`` and ``index`` (the number of the receiver on the boat) select the random numbers. ``dt`` is
        the time between two samples [s].
        """
        noises = [e.noise for e in effects if e.noise is not None]
        draw = normals(random_stream(seed, COLOUR, run, index))
        self._correlated = [
            (OrnsteinUhlenbeck(draw, dt, *n.colour), OrnsteinUhlenbeck(draw, dt, *n.colour))
            for n in noises
            if n.colour[0]
        ]
        self._outliers = [n.outliers for n in noises if n.outliers[0]]
        self._rng = random_stream(seed, OUTLIERS, run, index)

    def step(self) -> tuple[float, float]:
        """Return the error [m], north and east, that hidden effects add to the next GNSS position; zeros without any.

        Each call advances the random numbers by one sample.
        """
        north = sum(pair[0].step() for pair in self._correlated)
        east = sum(pair[1].step() for pair in self._correlated)
        for share, sigma in self._outliers:
            if self._rng.uniform() < share:
                outlier_n, outlier_e = self._rng.normal(0.0, sigma, 2)
                north, east = north + float(outlier_n), east + float(outlier_e)
        return north, east


class EscSensor:
    """Model of the telemetry of a speed controller: shaft speed, current, duty, voltage and temperature.

    The noise of the shaft speed is 5 rev/min. The current depends on thrust and shaft speed, and without its noise it
    is not negative in either direction. The temperature follows the squared current with a time constant of 60 s. The
    voltage falls with the current and with the used energy.
    """

    def __init__(self, seed: int, run: int, node: int, rpm_max: float, telemetry: Telemetry | None = None) -> None:
        """Set up the simulated telemetry of the speed controller with the number ``node`` in one run.

        ``seed`` and ``run`` select the noise. ``rpm_max`` is the full shaft speed [rev/min]. The resolution and the
        limit of ``telemetry`` apply to the reported shaft speed. None: it is neither rounded nor limited.
        """
        telemetry = telemetry or Telemetry()
        self._draw = normals(random_stream(seed, ESC, run, node))
        self._node = node
        self._rpm_max = rpm_max
        self._resolution = telemetry.resolution * rpm_max  # rev/min
        self._ceiling = telemetry.ceiling * rpm_max  # rev/min
        self._heat = 0.0

    def read(self, n: float, force: float, duty: float, energy: float, dt: float) -> Esc:
        """Return the next telemetry sample of the speed controller, for the present state of its thruster.

        Each call advances noise and temperature. At normalised shaft speeds up to 0.005 the reported shaft speed is 0
        without noise.

        Parameters
        ----------
        n : float
            Shaft speed (normalised) with its sign on the bus.
        force : float
            Static thrust [N] with its sign on the bus.
        duty : float
            Effective command (-1 to 1) with its sign on the bus.
        energy : float
            Integral of ``|n|^3`` over time [s], summed over the thrusters. It measures the use of the battery.
        dt : float
            Time since the previous sample [s].
        """
        draw = self._draw
        n = n if abs(n) > STOPPED else 0.0
        current = 0.4 * (n != 0.0) + 0.55 * abs(force) * (0.3 + 0.7 * abs(n))
        self._heat += dt / 60.0 * (0.02 * current**2 - self._heat)
        rpm = n * self._rpm_max + (5.0 * draw() if n else 0.0)
        return Esc(
            self._node,
            _rounded(min(max(rpm, -self._ceiling), self._ceiling), self._resolution),
            current + 0.1 * draw(),  # positive in both directions of rotation, since the motor drives
            duty,
            16.4 - 0.008 * energy - 0.02 * current + 0.02 * draw(),
            24.0 + self._heat + 0.1 * draw(),
        )


@dataclass(frozen=True)
class CellSpec:
    """Specification of a simulated load cell.

    Attributes
    ----------
    name : str
        Name of the device.
    rate_hz : float
        Rate of the samples [Hz].
    newton_per_count : float
        Force at the thruster per count [N].
    zero_counts : float
        Counts of a sample without force.
    saturation : float
        Largest counts of a sample. The smallest ones are ``-saturation - 1``.
    """

    name: str
    rate_hz: float
    newton_per_count: float = 0.001
    zero_counts: float = 84210.0
    saturation: float = 8388607.0


class LoadCellSensor:
    """Model of a load cell with white noise (0.1 N), a random-walk drift (0.001 N/sqrt(s)) and an error of its zero.

    The error of the zero is drawn for each run with a standard deviation of 0.3 N.
    """

    def __init__(self, seed: int, run: int, spec: CellSpec, index: int = 0) -> None:
        """Set up a simulated load cell.

        Parameters
        ----------
        seed : int
            Seed of the boat or bench.
        run : int
            Number of the run. It selects the noise.
        spec : CellSpec
            Rate and calibration.
        index : int
            Number of the load cell on the rig. It selects the stream of random numbers.
        """
        draw = normals(random_stream(seed, LOADCELL, run, index))
        self._noise = WhiteWalk(draw, 1.0 / spec.rate_hz, 0.1, 0.001, bias=0.3)
        self._spec = spec

    def read(self, force: float) -> LoadCell:
        """Return the next sample of the load cell, in whole counts, for a true ``force`` [N].

        Noise is added. The counts are clipped to the range of the converter.
        """
        spec = self._spec
        counts = round(spec.zero_counts + (force + self._noise()) / spec.newton_per_count)
        return LoadCell(float(max(-spec.saturation - 1.0, min(spec.saturation, counts))))
