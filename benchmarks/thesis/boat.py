"""Simulated boat of table 5, which rolls in turns, pitches with thrust and moves in waves.

A model with three degrees of freedom cannot describe these motions. Surge, sway and yaw rate are those of
``seatrial.ident.models.kinematic``. Heading, roll and pitch are states here. Roll and pitch are lightly damped
second-order motions, driven by white noise. Their equilibrium depends on the turn (roll) and on the thrust (pitch).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from seatrial.ident.data.record import Channel
from seatrial.ident.estimation.stochastic_simulation import SampledInputs, simulate_stochastic
from seatrial.ident.experiment_design.excitation import SHAFT_POLE
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Input, Model, Output, Sensor, Signals, State
from seatrial.ident.models.horizontal import ARMS, CURRENT, HULL, NOISE, SIDES, THRUST, shaft, thrust
from seatrial.ident.models.kinematic import output as kinematic_output
from seatrial.ident.models.kinematic import rate as kinematic_rate
from seatrial.ident.models.kinematic import turning
from seatrial.ident.models.rotations import set_orientation
from seatrial.ident.numerics import rotation_matrix
from seatrial.ident.numerics.linear_algebra import Array
from seatrial.ident.numerics.signal_processing import first_order_lag
from seatrial.ident.studies.cases import random_levels

AHRS_INTERVAL_S = 0.05  # s between AHRS samples
FIX = 4  # AHRS samples per GNSS fix
ROLL = (2 * np.pi * 0.55, 0.12, 0.06)  # natural frequency (rad/s), damping ratio, rad per m/s2 of sway acceleration
PITCH = (2 * np.pi * 0.70, 0.12, 0.0004)  # natural frequency (rad/s), damping ratio, rad per N of thrust
# Values of process noise, sensor noise and current
SIZES = {
    "s_u": 0.01,
    "s_v": 0.01,
    "s_r": 0.005,
    "s_p": 0.02,
    "s_q": 0.02,
    "e_psi": 0.005,
    "e_r": 0.005,
    "e_a": 0.05,
    "e_xy": 0.05,
    "e_vxy": 0.05,
    "e_tilt": 0.002,
    "V_x": 0.1,
    "V_y": -0.05,
}


@dataclass(frozen=True)
class Sailed:
    """Simulated mission of the boat.

    Attributes
    ----------
    channels : mapping of str to Channel
        Measured outputs and shaft speeds, by the names of ident ("x", "psi", "n_left" and others).
    truth : mapping of str to float
        True values of all parameters (SI).
    """

    channels: Mapping[str, Channel]
    truth: Mapping[str, float]


def rolling_boat(truth: Mapping[str, float]) -> Model:
    """Return the model of the boat, with the shaft speeds as inputs.

    The states are x, y, psi, phi, theta, u, v, r, p and q. ``truth`` has the values of parameters of hull, thrust and
    arms. Other parameters have the values of SIZES.
    """
    own = (*HULL, *THRUST, *ARMS, *CURRENT, *NOISE.values())
    more = tuple(Parameter(n, SIZES[n]) for n in ("s_u", "s_v", "s_r", "s_p", "s_q", "e_tilt"))
    noise = {n: f"s_{n}" for n in "uvrpq"}
    sensors = {
        "ahrs": (("psi", "e_psi"), ("phi", "e_tilt"), ("theta", "e_tilt"), ("p", "e_r"), ("q", "e_r"), ("r", "e_r")),
        "accelerometer": (("ax", "e_a"), ("ay", "e_a")),
        "position": (("x", "e_xy"), ("y", "e_xy")),
        "ground_velocity": (("vx", "e_vxy"), ("vy", "e_vxy")),
    }
    return Model(
        "rolling boat",
        tuple(State(n, noise=noise.get(n, 0.0)) for n in ("x", "y", "psi", "phi", "theta", "u", "v", "r", "p", "q")),
        tuple(Input(f"n_{side}", hold="linear") for side in SIDES),
        tuple(Sensor(name, tuple(Output(o, noise=e) for o, e in outputs)) for name, outputs in sensors.items()),
        (*own, *more),
        (
            ("shaft", shaft),
            ("thrust", thrust),
            ("force", _rotation_and_forces),
            ("rate", _state_derivatives),
            ("output", _outputs),
        ),
    ).with_values(SIZES | dict(truth))


def _rotation_and_forces(s: Signals) -> None:
    """Compute the rotation matrix of the body and the forces of the turning motion, and store them in ``s``."""
    x = s.x
    set_orientation(s, rotation_matrix(x.phi, x.theta, x.psi), (x.p, x.q, x.r))
    turning(s)


def _state_derivatives(s: Signals) -> None:
    """Compute the time derivatives of all states, and store them in ``s.rate``.

    Those of the Euler angles follow from the body rates. Roll and pitch are second-order motions about an equilibrium.
    """
    kinematic_rate(s)
    x, about = s.x, np.sin(s.x.phi) * s.x.q + np.cos(s.x.phi) * s.x.r
    s.rate["phi"] = x.p + np.tan(x.theta) * about
    s.rate["theta"] = np.cos(x.phi) * x.q - np.sin(x.phi) * x.r
    s.rate["psi"] = about / np.cos(x.theta)
    (w, damping, lean), (w_t, damping_t, lift) = ROLL, PITCH
    s.rate["p"] = -(w**2) * (x.phi - lean * x.u * x.r) - 2 * damping * w * x.p
    s.rate["q"] = -(w_t**2) * (x.theta - lift * s.X_thrust) - 2 * damping_t * w_t * x.q


def _outputs(s: Signals) -> None:
    """Compute the outputs, and store them in ``s.y``. Attitude and body rates are measured directly.

    The bias of the gyro is set to 0.
    """
    s.x.bias_r = 0.0
    kinematic_output(s)
    for name in ("psi", "phi", "theta", "p", "q", "r"):
        s.y[name] = getattr(s.x, name)


def sail(truth: Mapping[str, float], seconds: float, seed: int) -> Sailed:
    """Simulate a mission with random steps on both thrusters, an AHRS at 20 Hz and a GNSS receiver at 5 Hz.

    Parameters
    ----------
    truth : mapping of str to float
        True values of hull and thrust.
    seconds : float
        Duration of the mission [s].
    seed : int
        Seed of commands and noise.
    """
    t: Array = np.asarray(np.arange(round(seconds / AHRS_INTERVAL_S) + 1) * AHRS_INTERVAL_S)
    command = random_levels(t, lambda rng: rng.uniform(-0.4, 1.0, 2), (3.0, 9.0), seed)
    n = first_order_lag(command, 1.0 / SHAFT_POLE, AHRS_INTERVAL_S)
    model = rolling_boat(truth)
    values = np.array([list(model.values.values())])
    rng = np.random.default_rng([seed, 5])
    _, y = simulate_stochastic(model, SampledInputs.linear(t, n), values, [rng], x0=np.zeros((1, len(model.states))))
    channels = {f"n_{side}": Channel(t, n[:, k]) for k, side in enumerate(SIDES)}
    slow = {"x", "y", "vx", "vy"}
    for j, o in enumerate(model.outputs):
        step = FIX if o.name in slow else 1
        channels[o.name] = Channel(t[::step], y[0, ::step, j])
    return Sailed(channels, model.values)
