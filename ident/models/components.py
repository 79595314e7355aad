"""Effects that the rig file, the logs or the user request, and that the search for missing effects never adds.

They are the position of the GNSS antenna, the age of telemetry, a random-walk current, navigation errors of an
estimator, and the calibration of a thrust curve.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np

from seatrial.ident.model import (
    Effect,
    EffectKind,
    Input,
    Model,
    Parameter,
    ParameterOrigin,
    ParameterRole,
    Signals,
    State,
    directed_in_sentence,
)
from seatrial.ident.models import rotations
from seatrial.ident.models.horizontal import BUILT_IN, SIDES, VELOCITIES, shift_in_time
from seatrial.ident.numerics import body_to_ned, ned_to_body

ANTENNA, CURRENT_WALK, TELEMETRY_AGE = "antenna", "random-walk-current", "telemetry-age"
THRUST_CALIBRATION = "thrust-calibration"
ESTIMATOR_ERROR = "estimator-error"


class NavigationError(NamedTuple):
    """Time-correlated error of one output of a state estimator, for example of an autopilot's filter.

    Attributes
    ----------
    of, name : str
        Quantity that has the error (``heading``), and suffix of the error's parameters (``psi`` for ``A_psi``).
    axes : tuple[str, ...]
        Names of the outputs that have the error, with one error state each.
    sensors : tuple[str, ...]
        Sensors that measure this quantity. A model has the error if it has at least one of them.
    sd : float
        Typical standard deviation on a small boat, in ``unit``, without the integral of another error.
    unit : str
        Unit of the error.
    tau : float
        Typical correlation time [s], without the integral of another error.
    whole : float
        Typical standard deviation in ``unit``, including the integral of another error.
    shortest : float
        Lower bound of the correlation time [s]: the shortest that rows 0.1 s apart can represent.
    """

    of: str
    name: str
    axes: tuple[str, ...]
    sensors: tuple[str, ...]
    sd: float
    unit: str
    tau: float
    whole: float
    shortest: float = 0.2


# Some errors are integrated by others: heading integrates yaw rate, velocity acceleration, position velocity
ERRORS = (
    NavigationError("yaw rate", "r", ("r",), ("gyro",), 0.003, "rad/s", 0.1, 0.003, 0.08),
    NavigationError("heading", "psi", ("psi",), ("attitude",), 0.01, "rad", 3.0, 0.01),
    NavigationError("acceleration", "axy", ("ax", "ay"), VELOCITIES, 0.05, "m/s2", 50.0, 0.05),
    NavigationError("velocity", "vxy", ("vx", "vy"), VELOCITIES, 0.05, "m/s", 3.0, 0.15),
    NavigationError("position", "xy", ("x", "y"), ("position",), 0.1, "m", 3.0, 0.45),
)
SENSORS_WITH_CORRELATED_ERRORS = frozenset(sensor for e in ERRORS for sensor in e.sensors)
INITIAL_ERROR_RATIO = 2.0  # standard deviation of an initial error, relative to its typical standard deviation
N_LATER_SAMPLES = 5  # later samples of a shaft speed, one step each, for ages up to 0.5 s; one earlier sample is added


def shift(s: Signals, l_x: Any, l_y: Any) -> None:
    """Move the model's outputs of position and velocity over ground from the origin to another point of the hull.

    The equations are those of Groves 2013, section 2.5, for a boat without roll and pitch. The point is, for example,
    the GNSS antenna.

    Parameters
    ----------
    s : Signals
        Signals whose outputs ``x``, ``y`` [m] and ``vx``, ``vy`` [m/s] are changed in place. The heading is ``s.x.psi``
        and the yaw rate ``s.x.r``.
    l_x, l_y : float or symbol
        Position of the point relative to the origin, forward and to starboard [m].
    """
    cos, sin = np.cos(s.x.psi), np.sin(s.x.psi)
    s.y["x"] = s.y["x"] + cos * l_x - sin * l_y
    s.y["y"] = s.y["y"] + sin * l_x + cos * l_y
    s.y["vx"] = s.y["vx"] - s.x.r * (sin * l_x + cos * l_y)
    s.y["vy"] = s.y["vy"] + s.x.r * (cos * l_x - sin * l_y)


def antenna(x: float = 0.0, y: float = 0.0, z: float | None = None) -> Effect:
    """Return the effect that moves position and velocity to the GNSS antenna, whose position in the rig file is exact.

    An error of this position is a separate effect, ``lever-arm``.

    Parameters
    ----------
    x, y : float
        Position of the antenna relative to the origin, forward and to starboard [m].
    z : float, optional
        Position of the antenna below the origin [m], for a model with measured attitude. None: the effect is for a
        model without roll and pitch, in which the height has no influence.

    Returns
    -------
    Effect
        Effect with the fixed parameters ``antenna_x``, ``antenna_y`` and, unless ``z`` is None, ``antenna_z``.
    """
    places = [("x", x, "antenna forward of the origin"), ("y", y, "antenna to starboard of the origin")]
    places += [] if z is None else [("z", z, "antenna below the origin")]
    return Effect(
        ANTENNA,
        "the antenna position that was given",
        {"output": _shift_level if z is None else _shift_tilted},
        parameters=tuple(
            Parameter(f"antenna_{axis}", value, "m", f"{meaning}, as given", free=False, step=0.01)
            for axis, value, meaning in places
        ),
        place="sensor",
        requires=("hull",) if z is None else ("attitude",),
    )


def antenna_component(model: Model, arm: Sequence[float] = (0.0, 0.0, 0.0)) -> Effect:
    """Return the effect `antenna` that suits a model.

    Parameters
    ----------
    model : Model
        Model to extend. If it has measured attitude, the effect includes the height of the antenna.
    arm : Sequence[float] (3,)
        Position of the antenna relative to the origin: forward, to starboard and down [m].
    """
    return antenna(*arm) if "attitude" in model.provides else antenna(*arm[:2])


def _shift_level(s: Signals) -> None:
    """Move position and velocity over ground in the outputs ``s.y`` from the origin to the GNSS antenna, in place.

    The antenna is at the parameters ``antenna_x`` (forward) and ``antenna_y`` (to starboard) [m]. This is for a boat
    without roll and pitch.
    """
    shift(s, s.p.antenna_x, s.p.antenna_y)


def _shift_tilted(s: Signals) -> None:
    """Move position and velocity over ground in the outputs ``s.y`` from the origin to the GNSS antenna, in place.

    The antenna is at the parameters ``antenna_x``, ``antenna_y`` and ``antenna_z`` (forward, to starboard, down) [m].
    This is for a boat with measured attitude.
    """
    rotations.shift(s, (s.p.antenna_x, s.p.antenna_y, s.p.antenna_z))


def estimator_error_units(model: Model) -> dict[str, tuple[float, str]]:
    """Return the factors from the scaled states of the effect `estimator_error` to errors in the unit of their sensor.

    Parameters
    ----------
    model : Model
        Model with the estimates as values.

    Returns
    -------
    dict of str to (float, str)
        Factor and unit by the name of the state, such as ``error_x``. It is empty for a model without the effect.
    """
    if all(e.name != ESTIMATOR_ERROR for e in model.effects):
        return {}
    own, names = model.values, {x.name for x in model.states}
    return {
        f"error_{axis}": (_error_size(own[f"A_{e.name}"], own[f"tau_{e.name}"]), e.unit)
        for e in ERRORS
        for axis in e.axes
        if f"error_{axis}" in names
    }


def _error_size(amplitude: Any, tau: Any) -> Any:
    """Return the factor ``A sqrt(2 / tau)`` from a scaled state of `estimator_error` to the error in its unit.

    White noise of unit intensity drives the scaled states.
    """
    return amplitude * np.sqrt(2 / tau)


def current_walk() -> Effect:
    """Return the effect of a random-walk current in NED, which adds to the constant current (Fossen 2011, 8.3).

    Returns
    -------
    Effect
        Effect with the states ``drift_x`` (north) and ``drift_y`` (east) [m/s]. Both are zero at the start of a record
        and have the same diffusion ``q_V`` [m/s/sqrt(s)].
    """

    def drift(s: Signals) -> None:
        """Add the current ``drift_x`` (north), ``drift_y`` (east) to the time derivatives of position, in place.

        Set the derivatives of these states themselves to zero: only their process noise changes them.
        """
        s.rate["x"], s.rate["y"] = s.rate["x"] + s.x.drift_x, s.rate["y"] + s.x.drift_y
        s.rate["drift_x"] = s.rate["drift_y"] = 0.0

    return Effect(
        CURRENT_WALK,
        "a random-walk current",
        {"rate": drift},
        parameters=(
            Parameter(
                "q_V",
                0.005,
                "m/s/sqrt(s)",
                "diffusion of the current",
                "log",
                prior=(0.005, 0.01),
                scales=False,
                origin=BUILT_IN,
            ),
        ),
        states=(
            State("drift_x", "m/s", "current to the north, in addition to V_x", "q_V", sd0=0.0),
            State("drift_y", "m/s", "current to the east, in addition to V_y", "q_V", sd0=0.0),
        ),
        place="environment",
        requires=("plane",),
    )


def telemetry_age() -> Effect:
    """Return the effect for shaft speeds that are stamped later than they were measured, by the age ``tau_age``.

    Returns
    -------
    Effect
        Effect with the parameter ``tau_age`` [s], -0.03 to 0.4, initially 0.02, whose prior has the mean 0 and the
        standard deviation 0.1. It computes the thrust from the shaft speed that is stamped ``tau_age`` later. For this
        it adds copies of each shaft speed to the inputs, from 0.1 s earlier to 0.5 s later. A record of a finished run
        contains these later samples.
    """

    def earlier(s: Signals) -> None:
        """Replace the shaft speeds ``s.n`` by those that are stamped ``tau_age`` later, in place.

        A model with the parameter ``tau_delay`` (delay of the thrust) is shifted by it in the other direction too.
        """
        shift_in_time(s, "n")

    now = [Input(f"n_{side}", "", "linear") for side in SIDES]
    return Effect(
        TELEMETRY_AGE,
        "the age of the shaft-speed telemetry",
        {"shaft": earlier},
        parameters=(
            Parameter(
                "tau_age",
                0.02,
                "s",
                "age of the shaft speeds at their time stamp, relative to the sensors",
                prior=(0.0, 0.1),
                bounds=(-0.03, 0.4),
                step=0.01,
                scales=False,
                origin=BUILT_IN,
            ),
        ),
        inputs=tuple(i.delayed(-k) for i in now for k in range(-1, N_LATER_SAMPLES + 1) if k),
        place="sensor",
        requires=("n_stamp",),  # a Nomoto model already has a delay of its inputs
        kind=EffectKind.SENSOR_OFFSET,
        in_words=directed_in_sentence("tau_age", "s", "the shaft speeds are logged {}", "late", "early"),
    )


def thrust_calibration(model: Model, sd: float = 0.05) -> Effect:
    """Return the effect of a common factor ``k_thrust`` on all thrusts, for a thrust curve from a load cell.

    The data cannot distinguish this factor from masses and damping. The factor is therefore estimated with a prior of
    the mean 1, and all standard errors include the uncertainty of this prior.

    Parameters
    ----------
    model : Model
        Model to extend. If its inputs are the thrusts of the thrusters, the factor multiplies each thrust. Otherwise it
        multiplies the part ``X_thrust`` of the surge force only.
    sd : float
        Relative standard deviation of the calibration, which is that of the prior.
    """

    def scale_each(s: Signals) -> None:
        """Multiply the thrust ``s.f`` [N] of each thruster by ``k_thrust``. ``s.f`` becomes a new dict by side."""
        s.f = {side: s.p.k_thrust * f for side, f in s.f.items()}

    def scale_sum(s: Signals) -> None:
        """Multiply the part of the thrusters in the surge force ``s.X`` [N] by ``k_thrust``.

        This part is ``s.X_thrust``, which itself is not changed.
        """
        s.X = s.X + (s.p.k_thrust - 1.0) * s.X_thrust

    return Effect(
        THRUST_CALIBRATION,
        "the calibration of the thrust curve",
        {"thrust_loss": scale_each} if "f_input" in model.provides else {"force": scale_sum},
        parameters=(
            Parameter(
                "k_thrust",
                1.0,
                "",
                "true thrust over that of the curve",
                "log",
                prior=(1.0, sd),
                origin=ParameterOrigin.MEASURED,
            ),
        ),
        place="actuator",
    )


def navigation_errors(sensors: Collection[str]) -> list[NavigationError]:
    """Return the navigation errors that a state estimator with these outputs has, in the order of `ERRORS`.

    Parameters
    ----------
    sensors : Collection[str]
        Names of a model's sensors (``gyro``, ``position``, ...) whose data are outputs of the estimator. Sensors
        without a navigation error are ignored.

    Returns
    -------
    list of NavigationError
        Empty if no sensor has such an error.
    """
    return [e for e in ERRORS if not set(sensors).isdisjoint(e.sensors)]


def estimator_error(sensors: Sequence[str]) -> Effect:
    """Return the effect of time-correlated navigation errors in the outputs of a state estimator, as additional states.

    Parameters
    ----------
    sensors : Sequence[str]
        Names of the model's sensors. The yaw rate has an error if the model has a ``gyro``, the heading with
        ``attitude``, the position with ``position``, and acceleration and velocity with ``ground_velocity`` or
        ``body_velocity``. The error of the acceleration acts only through the velocity error that integrates it; the
        outputs ``ax`` and ``ay`` have no error.

    Returns
    -------
    Effect
        Effect with one state for each axis of each error, and two parameters for each error: ``A_...`` (standard
        deviation) and ``tau_...`` (correlation time [s]). It has none of these if no sensor has such an error. At the
        start of a record, the standard deviation of an error is twice its typical value.

    Notes
    -----
    The errors are those of inertial navigation (Groves 2013, chapter 14). They are states in addition to the white
    noise (Gelb 1974, section 4.5).

    An autopilot's filter combines a GNSS receiver, a gyro and accelerometers. Its output is smooth from sample to
    sample, but has errors that last for seconds in all channels. The heading error integrates the gyro error, the
    velocity error integrates the accelerometer error, and the position error integrates the velocity error. Position
    fixes and compass pull each error back with a correlation time. Each error e therefore integrates the error before
    it in this chain, and has white driving noise w:

        e' = -e / tau + (error before it) + A sqrt(2 / tau) w

    Errors of position and velocity are in north and east. Errors of the acceleration are in the axes of the boat, as
    are the accelerometers. Body velocities are the velocities over ground, rotated by the heading with its error. The
    product of heading error and acceleration, a part of the velocity error, is neglected.

    If these errors were modelled as white noise, they would look like motion, and masses and damping would be biased.
    """
    errors = {e.of: e for e in navigation_errors(sensors)}

    def size(s: Signals, e: NavigationError) -> Any:
        """Return the factor from the scaled states of an error to the error in its unit."""
        return _error_size(getattr(s.p, f"A_{e.name}"), getattr(s.p, f"tau_{e.name}"))

    def value(s: Signals, of: str) -> list[Any]:
        """Return the error of the quantity ``of``, in its unit, on each of its axes (one or two values).

        Return [0, 0] if the model lacks this error.
        """
        if of not in errors:
            return [0.0, 0.0]
        return [size(s, errors[of]) * getattr(s.x, f"error_{axis}") for axis in errors[of].axes]

    def grow(s: Signals) -> None:
        """Set the time derivatives ``s.rate`` of the scaled error states, in place.

        Each state decays with its correlation time ``tau_...``. The error that it integrates, divided by `size`, is
        added: yaw rate for the heading, acceleration (turned to NED) for the velocity, velocity for the position.
        """
        ahead, starboard = value(s, "acceleration")
        integrated = {
            "heading": value(s, "yaw rate"),
            "velocity": [*body_to_ned(s.x.psi, ahead, starboard)],
            "position": value(s, "velocity"),
        }
        for of, e in errors.items():
            for axis, rate in zip(e.axes, integrated.get(of, [0.0, 0.0]), strict=False):
                state = f"error_{axis}"
                s.rate[state] = rate / size(s, e) - getattr(s.x, state) / getattr(s.p, f"tau_{e.name}")

    def add(s: Signals) -> None:
        """Add the errors of yaw rate, heading, position and velocity over ground to the outputs ``s.y``, in place.

        The accelerations are not changed. The body velocity, if the model has its sensor, is rotated by the heading
        error, and gets the velocity error too.
        """
        turn, (north, east) = value(s, "heading")[0], value(s, "velocity")
        for of in ("yaw rate", "heading", "position"):
            if of in errors:
                for axis, off in zip(errors[of].axes, value(s, of), strict=True):
                    s.y[axis] = s.y[axis] + off
        s.y["vx"], s.y["vy"] = s.y["vx"] + north, s.y["vy"] + east
        if "body_velocity" in sensors:
            s.y["u"], s.y["v"] = ned_to_body(turn, s.y["u"], s.y["v"])
            cos, sin = np.cos(s.x.psi + turn), np.sin(s.x.psi + turn)
            s.y["u"], s.y["v"] = s.y["u"] + cos * north + sin * east, s.y["v"] + cos * east - sin * north

    return Effect(
        ESTIMATOR_ERROR,
        "time-correlated errors of the estimator",
        {"rate": grow, "reading": add},
        parameters=tuple(
            p
            for e in errors.values()
            for p in (
                Parameter(
                    f"A_{e.name}",
                    e.sd,
                    e.unit,
                    f"time-correlated error of the estimator's {e.of}, its own part",
                    "log",
                    prior=(e.sd, 3 * e.sd),
                    role=ParameterRole.DISTURBANCE,
                    origin=BUILT_IN,
                ),
                Parameter(
                    f"tau_{e.name}",
                    e.tau,
                    "s",
                    f"correlation time of the error of the estimator's {e.of}",
                    "log",
                    prior=(e.tau, 3 * e.tau),
                    bounds=(e.shortest, 200.0),
                    role=ParameterRole.DISTURBANCE,
                    origin=BUILT_IN,
                ),
            )
        ),
        states=tuple(
            State(
                f"error_{axis}",
                "",
                f"time-correlated error of the estimator's {e.of} ({axis}), scaled",
                1.0,
                sd0=INITIAL_ERROR_RATIO * e.whole / e.sd * float(np.sqrt(e.tau / 2)),
                nuisance=True,
            )
            for e in errors.values()
            for axis in e.axes
        ),
        place="sensor",
        requires=("heading",),
        kind=EffectKind.SENSOR_OFFSET,
    )
