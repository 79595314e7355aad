"""Disturbance states of a model: first-order Gauss-Markov forces and random-walk sensor biases.

The disturbance states keep prediction intervals calibrated while an effect is missing from the model. The smoother
estimates them as residual forces. The diagnosis starts from the forces and sensor outputs of a model in which an effect
may be missing, and from the variables on which this effect may depend (`residuals_of`, `sensor_errors_of`,
`variables_of`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from seatrial.ident.model import (
    DisturbanceChannel,
    Effect,
    EffectKind,
    Model,
    Parameter,
    ParameterOrigin,
    ParameterRole,
    Signals,
    State,
    ThrusterPair,
    Variable,
)

# Stationary standard deviations of the disturbances [N, N, N m, rad/s], and the units of their diffusions
SIZES = {"X": (1.0, "N/sqrt(s)"), "Y": (1.0, "N/sqrt(s)"), "N": (0.15, "N m/sqrt(s)"), "r_ref": (0.05, "rad/s/sqrt(s)")}
TIME = Variable("t", "s", lambda s: s.u.t)


def adder(name: str) -> Callable[[Signals, Any], None]:
    """Return a function of (signals, value) that adds the value to the signal ``name``, for example to ``X``.

    The function changes the signals in place and returns None.
    """

    def add(s: Signals, extra: Any) -> None:
        """Add ``extra`` to the signal, in place."""
        setattr(s, name, getattr(s, name) + extra)

    return add


HULL = tuple(
    DisturbanceChannel(name, unit, f"b_{name}", scale, f"the {quantity} {name}", adder(name), requires=("hull",))
    for name, quantity, unit, scale in (
        ("X", "surge force", "N", 10.0),
        ("Y", "sway force", "N", 10.0),
        ("N", "yaw moment", "N m", 2.0),
    )
)


def _measurement_adder(name: str) -> Callable[[Signals, Any], None]:
    """Return a function of (signals, value) that adds the value to the output ``s.y[name]``, for example ``psi``.

    The function changes the signals in place and returns None.
    """

    def add(s: Signals, extra: Any) -> None:
        """Add ``extra`` to the output, in place."""
        s.y[name] = s.y[name] + extra

    return add


# Sensor errors and their variables: a compass errs with heading and motor currents, inertial sensors err with motion
SENSOR_ERRORS = tuple(
    DisturbanceChannel(
        name,
        unit,
        f"bias_{name}",
        scale,
        f"the measured {quantity}",
        _measurement_adder(name),
        "reading",
        of,
        place="sensor",
        requires=("hull",),
    )
    for name, quantity, unit, scale, of in (
        ("psi", "heading", "rad", 0.1, ("psi", "n_sum", "n_diff")),
        ("r", "yaw rate", "rad/s", 0.05, ("r",)),
        ("ax", "surge acceleration", "m/s2", 0.3, ("u", "r")),
        ("ay", "sway acceleration", "m/s2", 0.3, ("v", "r")),
    )
)


def _thrust_scaler(*sides: str) -> Callable[[Signals, Any], None]:
    """Return a function of (signals, value) that multiplies the thrust of the thrusters ``sides`` by ``1 + value``."""

    def add(s: Signals, extra: Any) -> None:
        """Multiply the thrust in ``s.f`` of each side that was named by ``1 + extra``, in place."""
        for side in sides:
            s.f[side] = s.f[side] * (1 + extra)

    return add


# Thrust losses, for example of a stalled propeller. They act on surge and yaw together, unlike a curve of one force
THRUST_LOSSES = tuple(
    DisturbanceChannel(
        name,
        "",
        "",
        0.3,
        title,
        _thrust_scaler(*sides),
        "thrust_loss",
        ("v", "r"),
        place="actuator",
        requires=("hull", "f"),
        relative=True,
    )
    for name, title, sides in (
        ("T", "the thrust of both thrusters", ("left", "right")),
        ("T_left", "the thrust of the left thruster", ("left",)),
        ("T_right", "the thrust of the right thruster", ("right",)),
    )
)


def _state_reader(name: str) -> Callable[[Signals], Any]:
    """Return a function that returns the value of the state ``name``, given the signals of a model."""
    return lambda s: getattr(s.x, name)


MOTION = (
    Variable("u", "m/s", _state_reader("u"), functions=7),
    Variable("v", "m/s", _state_reader("v")),
    Variable("r", "rad/s", _state_reader("r")),
    Variable("psi", "rad", _state_reader("psi"), angle=True),
    TIME,
)


def _pair_variable(name: str, unit: str, pair: ThrusterPair) -> Variable:
    """Return the variable ``name``, in ``unit``: mean or difference of the shaft speeds or thrusts of two thrusters.

    The diagnosis tests whether missing forces depend on it. ``pair`` states the quantity, and whether the variable is
    the mean or left minus right. The values are states of the model if it has states of these names, otherwise inputs.
    """

    def read(s: Signals) -> Any:
        """Return the mean, or the difference left minus right (not halved), of the two thrusters."""
        left, right = (s.state_or_input(f"{pair.quantity}_{side}") for side in ("left", "right"))
        return left - right if pair.difference else (left + right) / 2

    return Variable(name, unit, read, pair=pair)


SHAFTS = (_pair_variable("n_sum", "", ThrusterPair("n", False)), _pair_variable("n_diff", "", ThrusterPair("n", True)))
THRUSTS = (
    _pair_variable("f_sum", "N", ThrusterPair("f", False)),
    _pair_variable("f_diff", "N", ThrusterPair("f", True)),
)
PRODUCTS = (("u", "r"), ("u", "v"), ("v", "r"))


def disturbance(forces: Sequence[str] = ("X", "Y", "N")) -> Effect:
    """Return the effect of first-order Gauss-Markov (Ornstein-Uhlenbeck) forces on surge, sway and yaw, as states.

    The forces represent the part of the motion that the model does not explain. The smoother estimates them as residual
    forces with a covariance (Kristensen, Madsen and Jorgensen 2004).

    Parameters
    ----------
    forces : Sequence[str]
        Signals of the model to which a disturbance is added, at least one: the forces ``X``, ``Y`` [N], the moment
        ``N`` [N m], or the steady yaw rate ``r_ref`` [rad/s] of a Nomoto model.

    Returns
    -------
    Effect
        Effect with a state ``b_NAME`` and a diffusion ``q_NAME`` for each signal, and a common correlation time
        ``tau_b`` of 1.5 s (0.2 to 10 s). The diffusion is such that the stationary standard deviation is that of
        `SIZES` (1 N, 0.15 N m, 0.05 rad/s). These values are the initial values and means of the priors, whose standard
        deviations are three times (``q_NAME``) and once (``tau_b``) the mean.

    Raises
    ------
    ValueError
        If ``forces`` is empty.
    KeyError
        If a name is not in `SIZES`.
    """
    tau = 1.5
    names = tuple(forces)
    sd, units = zip(*(SIZES[n] for n in names), strict=True)

    def add(s: Signals) -> None:
        """Add each disturbance state ``b_NAME`` to its signal ``s.NAME``, in place."""
        for name in names:
            setattr(s, name, getattr(s, name) + getattr(s.x, f"b_{name}"))

    def decay(s: Signals) -> None:
        """Set the time derivative of each disturbance state to ``-b_NAME / tau_b``, in place."""
        for name in names:
            s.rate[f"b_{name}"] = -getattr(s.x, f"b_{name}") / s.p.tau_b

    return Effect(
        "disturbance",
        "disturbance forces",
        {"force": add, "rate": decay},
        parameters=(
            *(
                _diffusion_parameter(n, s0 * float(np.sqrt(2 / tau)), unit)
                for n, s0, unit in zip(names, sd, units, strict=True)
            ),
            Parameter(
                "tau_b",
                tau,
                "s",
                "correlation time of the disturbance forces",
                "log",
                prior=(tau, tau),
                bounds=(0.2, 10.0),
                role=ParameterRole.DISTURBANCE,
                origin=ParameterOrigin.BUILT_IN,
            ),
        ),
        states=tuple(
            State(f"b_{n}", u.removesuffix("/sqrt(s)"), f"unexplained {n}", f"q_{n}", sd0=s0)
            for n, s0, u in zip(names, sd, units, strict=True)
        ),
        place="environment",
        kind=EffectKind.DISTURBANCE,
    )


def _diffusion_parameter(force: str, q: float, unit: str) -> Parameter:
    """Return the parameter ``q_FORCE`` for the diffusion of a disturbance force.

    Its value and prior mean are ``q``, in ``unit``, and the standard deviation of its prior is three times ``q``.
    """
    return Parameter(
        f"q_{force}",
        q,
        unit,
        f"diffusion of the unexplained {force}",
        "log",
        prior=(q, 3 * q),
        origin=ParameterOrigin.BUILT_IN,
    )


def forces_of(model: Model) -> tuple[str, ...]:
    """Return the names of the forces of a model to which disturbance forces can be added.

    The result is (X, Y, N) for the model `horizontal`, and for `kinematic` with its yaw equation. It is (X, Y) for any
    other model that provides ``plane`` (position and velocity), and () otherwise.
    """
    if {"hull", "turn"} & set(model.provides):
        return ("X", "Y", "N")
    return ("X", "Y") if "plane" in model.provides else ()


def shaft_disturbance() -> Effect:
    """Return the effect of a first-order Gauss-Markov (Ornstein-Uhlenbeck) acceleration of a shaft on the bench.

    The acceleration represents deviations from the first-order response of the shaft to its command. The disturbance of
    the force on the load cell is a separate state of the thruster model.

    Returns
    -------
    Effect
        Effect with the state ``b_n`` [1/s], its diffusion ``q_n`` and its correlation time ``tau_n``, initially 0.3 s.
    """
    tau, sd = 0.3, 0.03
    q = sd * float(np.sqrt(2 / tau))

    def add(s: Signals) -> None:
        """Add the state ``b_n`` to the time derivative of the shaft speed, and set its own one to ``-b_n / tau_n``."""
        s.rate["n"] = s.rate["n"] + s.x.b_n
        s.rate["b_n"] = -s.x.b_n / s.p.tau_n

    return Effect(
        "disturbance",
        "an unexplained acceleration of the shaft",
        {"rate": add},
        parameters=(
            Parameter(
                "q_n",
                q,
                "1/s/sqrt(s)",
                "diffusion of the unexplained acceleration",
                "log",
                prior=(q, 3 * q),
                origin=ParameterOrigin.BUILT_IN,
            ),
            Parameter(
                "tau_n",
                tau,
                "s",
                "correlation time of the unexplained acceleration",
                "log",
                prior=(tau, tau),
                bounds=(0.05, 5.0),
                role=ParameterRole.DISTURBANCE,
                origin=ParameterOrigin.BUILT_IN,
            ),
        ),
        states=(State("b_n", "1/s", "unexplained acceleration of the shaft", "q_n", sd0=sd),),
        place="bench",
        kind=EffectKind.DISTURBANCE,
    )


def disturbance_of(model: Model) -> Effect:
    """Return the effect with the disturbance states for a model.

    It is the effect that the model declares, otherwise disturbance forces on surge, sway and yaw (`disturbance`). Raise
    ValueError if the model declares none and has no such forces.
    """
    return model.disturbance or disturbance(forces_of(model))


def sensor_bias(sensors: Sequence[str]) -> Effect:
    """Return the effect of random-walk biases of gyro, heading and accelerometers, as states (thesis 4.1).

    Parameters
    ----------
    sensors : Sequence[str]
        Names of the model's sensors. ``attitude`` gives a bias of the heading psi [rad], ``gyro`` of the yaw rate r
        [rad/s], ``accelerometer`` of ax and ay [m/s2]. Other sensors have no bias and are ignored.

    Returns
    -------
    Effect
        Effect with a state ``bias_OUTPUT`` for each output; without states if no sensor has a bias. The initial
        standard deviation and the diffusion of a state are fixed numbers. The white noise of the outputs is not part of
        the effect.
    """
    table: dict[str, tuple[tuple[str, str, float, float], ...]] = {
        "attitude": (("psi", "rad", 0.005, 1.7e-4),),
        "gyro": (("r", "rad/s", 0.01, 1e-5),),
        "accelerometer": (("ax", "m/s2", 0.1, 1e-4), ("ay", "m/s2", 0.1, 1e-4)),
    }
    rows = [row for s in sensors for row in table.get(s, ())]

    def add(s: Signals) -> None:
        """Add the state ``bias_OUTPUT`` of each bias to its output in ``s.y``, in place."""
        for name, *_ in rows:
            s.y[name] = s.y[name] + getattr(s.x, f"bias_{name}")

    def hold_bias(s: Signals) -> None:
        """Set the time derivatives of the biases to zero, because only process noise changes them."""
        for name, *_ in rows:
            s.rate[f"bias_{name}"] = 0.0

    return Effect(
        "sensor-bias",
        "offsets of the sensors",
        {"rate": hold_bias, "reading": add},
        states=tuple(State(f"bias_{n}", unit, f"offset of {n}", walk, sd0=sd) for n, unit, sd, walk in rows),
        place="sensor",
        kind=EffectKind.SENSOR_OFFSET,
    )


def with_disturbances(model: Model) -> Model:
    """Return the model with disturbance states and with states for sensor biases.

    Biases are added to heading, yaw rate and acceleration, as far as the model has the sensors ``attitude``, ``gyro``
    and ``accelerometer``. The disturbance states take over the process noise: the diffusions ``s_u``, ``s_v``, ``s_r``
    and ``s_n`` of velocities and shaft speed, as far as the model has them, are set to 1e-4, which is negligible, and
    are no longer estimated.

    Raises
    ------
    ValueError
        If the model has these states already, or if nothing in it can have a disturbance (`disturbance_of`).
    """
    out: Model = model + disturbance_of(model)
    present = [s.name for s in model.sensors]
    if {"attitude", "gyro", "accelerometer"} & set(present):
        out = out + sensor_bias(present)
    quiet = [p.at(1e-4).fixed() for p in out.parameters if p.name in ("s_u", "s_v", "s_r", "s_n")]
    return out.replace_parameters(*quiet)


def residuals_of(model: Model) -> tuple[DisturbanceChannel, ...]:
    """Return the quantities of a model in which the diagnosis looks for missing effects, such as the surge force.

    These are the quantities that the model declares, otherwise the forces X, Y and N of a model of a hull
    (`horizontal`). Return () for any other model, which cannot be diagnosed.
    """
    return model.residuals or (HULL if "hull" in model.provides else ())


def sensor_errors_of(model: Model) -> tuple[DisturbanceChannel, ...]:
    """Return the sensor outputs of a model in which the diagnosis looks for errors beyond the modelled biases.

    These are the outputs psi, r, ax and ay, as far as the model has a bias state for them. Return () for a model
    without a hull, that is, other than `horizontal`.
    """
    states = {s.name for s in model.states}
    return tuple(r for r in SENSOR_ERRORS if r.state in states) if "hull" in model.provides else ()


def thrust_losses_of(model: Model) -> tuple[DisturbanceChannel, ...]:
    """Return the thrusts of a model in which the diagnosis looks for losses in turns.

    They are the thrusts of both thrusters together and of each one alone. Return () for a model without a hull (other
    than `horizontal`) or without thrusters.
    """
    return THRUST_LOSSES if {"hull", "f"} <= set(model.provides) else ()


def variables_of(model: Model) -> tuple[Variable, ...]:
    """Return the variables on which a missing effect may depend, for the diagnosis of a model.

    These are the variables that the model declares. A model of a hull (`horizontal`) that declares none has velocities,
    heading, time, and mean and difference of the shaft speeds (of the thrusts, if it has no shaft speeds; neither, if
    it has no thrusters). Return () for any other model.
    """
    if model.variables or "hull" not in model.provides:
        return model.variables
    signal_names = {i.name for i in model.inputs} | {s.name for s in model.states}
    shafts, thrusts = ({f"{letter}_left", f"{letter}_right"} <= signal_names for letter in ("n", "f"))
    return MOTION + (SHAFTS if shafts else THRUSTS if thrusts else ())


def products_of(model: Model) -> tuple[tuple[str, str], ...]:
    """Return the pairs of variables whose product a missing effect may depend on, for the diagnosis of a model.

    Each pair has the names of two variables. These are the pairs that the model declares, otherwise (u, r), (u, v) and
    (v, r) for a model of a hull (`horizontal`). Return () for any other model.
    """
    return model.products or (PRODUCTS if "hull" in model.provides else ())
