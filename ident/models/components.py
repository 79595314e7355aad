"""Components that the rig, the logs or the user ask for, and no search adds: antenna lever arm, age of telemetry,
random-walk current, navigation errors of an estimator, calibration of a thrust curve."""

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
)
from seatrial.ident.models import rotations
from seatrial.ident.models.horizontal import BUILT_IN, SIDES, VELOCITIES, shift_in_time

ANTENNA, CURRENT_WALK, TELEMETRY_AGE = "antenna", "random-walk-current", "telemetry-age"
THRUST_CALIBRATION = "thrust-calibration"
ESTIMATOR_ERROR = "estimator-error"


class NavigationError(NamedTuple):
    """An error of an estimator's output that lasts. axes: a state of each; sensors: of one of which the model needs an
    output; sd, unit, tau: usual standard deviation of its own part and correlation time [s] on a small boat; whole:
    that of all of it, with what it integrates; shortest: correlation time [s] that rows 0.1 s apart can carry."""

    of: str
    name: str
    axes: tuple[str, ...]
    sensors: tuple[str, ...]
    sd: float
    unit: str
    tau: float
    whole: float
    shortest: float = 0.2


ERRORS = (  # each is part of the rate of another: yaw rate of heading, acceleration of velocity, velocity of position
    NavigationError("yaw rate", "r", ("r",), ("gyro",), 0.003, "rad/s", 0.1, 0.003, 0.08),
    NavigationError("heading", "psi", ("psi",), ("attitude",), 0.01, "rad", 3.0, 0.01),
    NavigationError("acceleration", "axy", ("ax", "ay"), VELOCITIES, 0.05, "m/s2", 50.0, 0.05),
    NavigationError("velocity", "vxy", ("vx", "vy"), VELOCITIES, 0.05, "m/s", 3.0, 0.15),
    NavigationError("position", "xy", ("x", "y"), ("position",), 0.1, "m", 3.0, 0.45),
)
LASTING = frozenset(sensor for e in ERRORS for sensor in e.sensors)
UNCERTAIN = 2.0  # times its usual standard deviation: how far off an error may begin
N_AHEAD = 5  # copies of a shaft speed that is known late, each a step earlier: ages up to half a second; and one later


def shift(s: Signals, l_x: Any, l_y: Any) -> None:
    """Position and velocity over ground of a point ahead and to starboard of the origin (Groves 2013, 2.5)."""
    cos, sin = np.cos(s.x.psi), np.sin(s.x.psi)
    s.y["x"] = s.y["x"] + cos * l_x - sin * l_y
    s.y["y"] = s.y["y"] + sin * l_x + cos * l_y
    s.y["vx"] = s.y["vx"] - s.x.r * (sin * l_x + cos * l_y)
    s.y["vy"] = s.y["vy"] + s.x.r * (cos * l_x - sin * l_y)


def antenna(x: float = 0.0, y: float = 0.0, z: float | None = None) -> Effect:
    """The GNSS antenna where the rig file says [m, ahead, to starboard, down]; an error in that is the effect
    lever-arm. ``z``: for a model with measured attitude; in a level one the height of the antenna does not count."""
    places = [("x", x, "antenna ahead of the origin"), ("y", y, "antenna to starboard")]
    places += [] if z is None else [("z", z, "antenna below the origin")]
    return Effect(
        ANTENNA,
        "the antenna where the rig file says",
        {"output": _level if z is None else _tilted},
        parameters=tuple(
            Parameter(f"antenna_{axis}", value, "m", f"{meaning}, by the rig file", free=False, step=0.01)
            for axis, value, meaning in places
        ),
        place="sensor",
        requires=("hull",) if z is None else ("attitude",),
    )


def antenna_component(model: Model, arm: Sequence[float] = (0.0, 0.0, 0.0)) -> Effect:
    """The same as this model can have it; arm (3,) m, ahead, to starboard and down."""
    return antenna(*arm) if "attitude" in model.provides else antenna(*arm[:2])


def _level(s: Signals) -> None:
    shift(s, s.p.antenna_x, s.p.antenna_y)


def _tilted(s: Signals) -> None:
    rotations.shift(s, (s.p.antenna_x, s.p.antenna_y, s.p.antenna_z))


def current_walk() -> Effect:
    """A current with a random walk in NED beside the constant one (Fossen 2011, section 8.3)."""

    def drift(s: Signals) -> None:
        s.rate["x"], s.rate["y"] = s.rate["x"] + s.x.drift_x, s.rate["y"] + s.x.drift_y
        s.rate["drift_x"] = s.rate["drift_y"] = 0.0

    return Effect(
        CURRENT_WALK,
        "a random-walk current",
        {"rate": drift},
        parameters=(
            Parameter(
                "q_V", 0.005, "m/s/sqrt(s)", "diffusion of the current", "log", prior=(0.005, 0.01), scales=False
            ),
        ),
        states=(
            State("drift_x", "m/s", "current to the north, beyond V_x", "q_V", sd0=0.0),
            State("drift_y", "m/s", "current to the east, beyond V_y", "q_V", sd0=0.0),
        ),
        place="environment",
        requires=("plane",),
    )


def telemetry_age() -> Effect:
    """Shaft speeds that bear the time at which they arrived: the thrust is that of the telemetry ``tau_age`` later, as
    the record of a past run knows it."""

    def earlier(s: Signals) -> None:
        shift_in_time(s, "n")

    now = [Input(f"n_{side}", "", "linear") for side in SIDES]
    return Effect(
        TELEMETRY_AGE,
        "shaft speeds that arrive late",
        {"shaft": earlier},
        parameters=(
            Parameter(
                "tau_age",
                0.02,
                "s",
                "age of the shaft speeds at their time stamp, beyond that of the sensors",
                prior=(0.0, 0.1),
                bounds=(-0.03, 0.4),
                step=0.01,
                scales=False,
            ),
        ),
        inputs=tuple(i.delayed(-k) for i in now for k in range(-1, N_AHEAD + 1) if k),
        place="sensor",
        requires=("n_stamp",),  # a Nomoto model has a delay of its inputs of its own
        kind=EffectKind.SENSOR_OFFSET,
    )


def thrust_calibration(model: Model, sd: float = 0.05) -> Effect:
    """A factor of all given thrust, for a curve measured with a load cell that is calibrated to ``sd`` (relative
    standard uncertainty): the data do not tell it from masses and damping, so its prior is in their errors."""

    def scale_each(s: Signals) -> None:
        s.f = {side: s.p.k_thrust * f for side, f in s.f.items()}

    def scale_sum(s: Signals) -> None:
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
    """Those that a model with these sensors has, as far as it is an estimator's output that they read."""
    return [e for e in ERRORS if not set(sensors).isdisjoint(e.sensors)]


def estimator_error(sensors: Sequence[str]) -> Effect:
    """Errors of a state estimator's output: those of inertial navigation (Groves 2013, chapter 14), as augmented states
    beside the white noise (Gelb 1974, section 4.5).

    What an autopilot's filter makes of a receiver, a gyro and accelerometers is smooth from sample to sample, and off
    for seconds, in all channels together: its heading is off by the integral of what its gyro is, its velocity by that
    of its accelerometers, its position by that of its velocity, and fixes and compass draw each back in a correlation
    time. With white noise of its own beside what it integrates, each is

        e' = -e / tau + (the one before it) + A sqrt(2 / tau) w

    in north and east; accelerations are off in the axes of the boat, where accelerometers are, and velocities of the
    body are those over ground turned by the heading and its error. What the heading's error adds to the velocity's,
    itself times the acceleration, is left out. Taken for white, such errors look like motion: masses and damping become
    those that explain them.

    sensors: those of the model; yaw rate, heading, velocities and position get such errors, each where it is measured.
    """
    errors = {e.of: e for e in navigation_errors(sensors)}

    def size(s: Signals, e: NavigationError) -> Any:
        """Of the unit noise that drives its states."""
        return getattr(s.p, f"A_{e.name}") * np.sqrt(2 / getattr(s.p, f"tau_{e.name}"))

    def value(s: Signals, of: str) -> list[Any]:
        if of not in errors:
            return [0.0, 0.0]
        return [size(s, errors[of]) * getattr(s.x, f"error_{axis}") for axis in errors[of].axes]

    def grow(s: Signals) -> None:
        cos, sin = np.cos(s.x.psi), np.sin(s.x.psi)
        ahead, starboard = value(s, "acceleration")
        integrated = {
            "heading": value(s, "yaw rate"),
            "velocity": [cos * ahead - sin * starboard, sin * ahead + cos * starboard],
            "position": value(s, "velocity"),
        }
        for of, e in errors.items():
            for axis, rate in zip(e.axes, integrated.get(of, [0.0, 0.0]), strict=False):
                state = f"error_{axis}"
                s.rate[state] = rate / size(s, e) - getattr(s.x, state) / getattr(s.p, f"tau_{e.name}")

    def add(s: Signals) -> None:
        turn, (north, east) = value(s, "heading")[0], value(s, "velocity")
        for of in ("yaw rate", "heading", "position"):
            if of in errors:
                for axis, off in zip(errors[of].axes, value(s, of), strict=True):
                    s.y[axis] = s.y[axis] + off
        s.y["vx"], s.y["vy"] = s.y["vx"] + north, s.y["vy"] + east
        if "body_velocity" in sensors:
            cos, sin = np.cos(turn), np.sin(turn)
            s.y["u"], s.y["v"] = cos * s.y["u"] + sin * s.y["v"], cos * s.y["v"] - sin * s.y["u"]
            cos, sin = np.cos(s.x.psi + turn), np.sin(s.x.psi + turn)
            s.y["u"], s.y["v"] = s.y["u"] + cos * north + sin * east, s.y["v"] + cos * east - sin * north

    return Effect(
        ESTIMATOR_ERROR,
        "errors of the estimator that last",
        {"rate": grow, "reading": add},
        parameters=tuple(
            p
            for e in errors.values()
            for p in (
                Parameter(
                    f"A_{e.name}",
                    e.sd,
                    e.unit,
                    f"error of the estimator's {e.of} that lasts, its own part",
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
                f"error of the estimator's {e.of} ({axis}) that lasts, scaled",
                1.0,
                sd0=UNCERTAIN * e.whole / e.sd * float(np.sqrt(e.tau / 2)),
                nuisance=True,
            )
            for e in errors.values()
            for axis in e.axes
        ),
        place="sensor",
        requires=("heading",),
        kind=EffectKind.SENSOR_OFFSET,
    )
