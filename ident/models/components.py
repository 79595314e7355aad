"""Components that the rig, the logs or the user ask for, and no search adds: antenna lever arm, age of telemetry,
random-walk current, time-correlated errors of an estimator, calibration of a thrust curve."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ident.model import Effect, EffectKind, Input, Model, Parameter, ParameterOrigin, ParameterRole, Signals, State
from ident.models import rotations
from ident.models.horizontal import BUILT_IN, SENSORS, SIDES, shift_in_time

ANTENNA, CURRENT_WALK, TELEMETRY_AGE = "antenna", "random-walk-current", "telemetry-age"
THRUST_CALIBRATION = "thrust-calibration"
ESTIMATOR_ERROR = "estimator-error"
# By sensor: name of the error, standard deviation, unit, correlation time [s]; usual ones of a small boat's estimator.
LASTING = {
    "position": ("xy", 0.1, "m", 3.0),
    "ground_velocity": ("vxy", 0.05, "m/s", 3.0),
    "body_velocity": ("uv", 0.05, "m/s", 3.0),
    "attitude": ("psi", 0.01, "rad", 3.0),
}
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
        parameters=(Parameter("q_V", 0.005, "m/s/sqrt(s)", "diffusion of the current", "log", prior=(0.005, 0.01),
                              scales=False),),
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
            Parameter("tau_age", 0.02, "s", "age of the shaft speeds at their time stamp, beyond that of the sensors",
                      prior=(0.0, 0.1), bounds=(-0.03, 0.4), step=0.01, scales=False),
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
            Parameter("k_thrust", 1.0, "", "true thrust over that of the curve", "log", prior=(1.0, sd),
                      origin=ParameterOrigin.MEASURED),
        ),
        place="actuator",
    )


def estimator_error(sensors: Sequence[str]) -> Effect:
    """Time-correlated measurement errors of a state estimator's output: first-order Gauss-Markov processes beside the
    white noise (Gelb 1974, section 4.5: coloured measurement noise by state augmentation).

    What an autopilot's filter makes of a receiver and a compass is smooth from sample to sample, and off for seconds.
    Taken for white, such errors look like motion: masses and damping become those that explain them.

    sensors: those of the model; position, velocities and heading get such an error.
    """
    errors = {o.name: LASTING[s] for s in sensors if s in LASTING for o in SENSORS[s].outputs}

    def add(s: Signals) -> None:
        for output, (name, *_) in errors.items():
            size = getattr(s.p, f"A_{name}") * np.sqrt(2 / getattr(s.p, f"tau_{name}"))  # unit noise drives the state
            s.y[output] = s.y[output] + size * getattr(s.x, f"error_{output}")

    def decay(s: Signals) -> None:
        for output, (name, *_) in errors.items():
            s.rate[f"error_{output}"] = -getattr(s.x, f"error_{output}") / getattr(s.p, f"tau_{name}")

    return Effect(
        ESTIMATOR_ERROR,
        "errors of the estimator that last",
        {"rate": decay, "reading": add},
        parameters=tuple(
            p
            for name, sd, unit, tau in dict.fromkeys(errors.values())
            for p in (
                Parameter(f"A_{name}", sd, unit, f"error of {name} that lasts, standard deviation", "log",
                          prior=(sd, 3 * sd), role=ParameterRole.DISTURBANCE, origin=BUILT_IN),
                Parameter(f"tau_{name}", tau, "s", f"correlation time of the error of {name}", "log",
                          prior=(tau, 3 * tau), bounds=(0.2, 200.0), role=ParameterRole.DISTURBANCE,
                          origin=BUILT_IN),
            )
        ),
        states=tuple(
            State(f"error_{output}", "", f"error of {output} that lasts, scaled", 1.0, sd0=1.0, nuisance=True)
            for output in errors
        ),
        place="sensor",
        requires=("plane",),
        kind=EffectKind.SENSOR_OFFSET,
    )
