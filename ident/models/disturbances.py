"""Augmented disturbance states: first-order Gauss-Markov forces and random-walk sensor biases.

The disturbance states keep prediction intervals calibrated while an effect is missing from the model. The smoother
turns them into residual forces. The diagnosis starts from the forces and measurement errors of a model, and from the
variables on which they may depend (`residuals_of`, `sensor_errors_of`, `variables_of`).
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
    """Return a function of (signals, value) that adds the value to the signal of this name (``X``)."""

    def add(s: Signals, extra: Any) -> None:
        """Add ``extra`` to the signal, in place."""
        setattr(s, name, getattr(s, name) + extra)

    return add


HULL = tuple(
    DisturbanceChannel(name, unit, f"b_{name}", scale, f"the force {name}", adder(name), requires=("hull",))
    for name, unit, scale in (("X", "N", 10.0), ("Y", "N", 10.0), ("N", "N m", 2.0))
)


def _measurement_adder(name: str) -> Callable[[Signals, Any], None]:
    """Return a function of (signals, value) that adds the value to the output of this name, for example to ``psi``."""

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
    """Return a function of (signals, value) that multiplies the thrust of these sides by one plus the value."""

    def add(s: Signals, extra: Any) -> None:
        """Multiply the thrusts by ``1 + extra``, in place."""
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
    """Return a function that reads the state of this name from the signals."""
    return lambda s: getattr(s.x, name)


MOTION = (
    Variable("u", "m/s", _state_reader("u"), functions=7),
    Variable("v", "m/s", _state_reader("v")),
    Variable("r", "rad/s", _state_reader("r")),
    Variable("psi", "rad", _state_reader("psi"), angle=True),
    TIME,
)


def _pair_variable(name: str, unit: str, pair: ThrusterPair) -> Variable:
    """Return the variable of a pair of thrusters with this name and unit.

    The variable is the mean, or the difference left minus right. It is read from the states of the thrusters if they
    are states, otherwise from the inputs.
    """

    def read(s: Signals) -> Any:
        """Return the mean, or the difference left minus right."""
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
    """Return first-order Gauss-Markov (Ornstein-Uhlenbeck) forces on surge, sway and yaw, as states of the filter.

    The forces represent the part of the motion that the model does not explain. The smoother turns them into residual
    forces with a covariance (Kristensen, Madsen and Jorgensen 2004).

    Parameters
    ----------
    forces : Sequence[str]
        Forces of the model (``X``, ``Y``, ``N``), or ``r_ref``, a steady yaw rate. Their stationary standard deviations
        start at ``SIZES``. The common correlation time starts at 1.5 s.
    """
    tau = 1.5
    names = tuple(forces)
    sd, units = zip(*(SIZES[n] for n in names), strict=True)

    def add(s: Signals) -> None:
        """Add the disturbance states to the forces."""
        for name in names:
            setattr(s, name, getattr(s, name) + getattr(s.x, f"b_{name}"))

    def decay(s: Signals) -> None:
        """Set the rates of the disturbance states: they decay with the correlation time."""
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
    """Return the parameter of the diffusion of a disturbance force, with the value and prior mean q [``unit``]."""
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
    """Return the forces of a model to which disturbance forces are added.

    They are ``X, Y, N`` for a model with a yaw moment, ``X, Y`` for one without, and () for a model without a hull.
    """
    if {"hull", "turn"} & set(model.provides):
        return ("X", "Y", "N")
    return ("X", "Y") if "plane" in model.provides else ()


def shaft_disturbance() -> Effect:
    """Return an Ornstein-Uhlenbeck acceleration ``b_n`` [1/s] of a shaft on the bench, as a state of the filter.

    The acceleration represents deviations from the first-order response to the command. The model has its own
    disturbance force ``b_f``.
    """
    tau, sd = 0.3, 0.03
    q = sd * float(np.sqrt(2 / tau))

    def add(s: Signals) -> None:
        """Add the state to the rate of the shaft speed, and set the rate of the state."""
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
    """Return the disturbance states that the model declares, otherwise those of a vehicle (`disturbance`)."""
    return model.disturbance or disturbance(forces_of(model))


def sensor_bias(sensors: Sequence[str]) -> Effect:
    """Return random-walk biases of gyro, heading and accelerometers, in addition to their white noise (thesis 4.1).

    ``sensors`` are names of sensors. Others than ``attitude``, ``gyro`` and ``accelerometer`` have no bias and are
    ignored.
    """
    table: dict[str, tuple[tuple[str, str, float, float], ...]] = {
        "attitude": (("psi", "rad", 0.005, 1.7e-4),),
        "gyro": (("r", "rad/s", 0.01, 1e-5),),
        "accelerometer": (("ax", "m/s2", 0.1, 1e-4), ("ay", "m/s2", 0.1, 1e-4)),
    }
    rows = [row for s in sensors for row in table.get(s, ())]

    def add(s: Signals) -> None:
        """Add the biases to the outputs."""
        for name, *_ in rows:
            s.y[name] = s.y[name] + getattr(s.x, f"bias_{name}")

    def hold_bias(s: Signals) -> None:
        """Set the rates of the biases to zero, because only noise changes them."""
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
    """Return the model with disturbance forces and sensor biases.

    The white process noise of the velocities (``s_u``, ``s_v``, ``s_r``, ``s_n``) is fixed at a negligible value of
    1e-4.

    Raises
    ------
    ValueError
        If the model has them already.
    """
    out: Model = model + disturbance_of(model)
    present = [s.name for s in model.sensors]
    if {"attitude", "gyro", "accelerometer"} & set(present):
        out = out + sensor_bias(present)
    quiet = [p.at(1e-4).fixed() for p in out.parameters if p.name in ("s_u", "s_v", "s_r", "s_n")]
    return out.replace_parameters(*quiet)


def residuals_of(model: Model) -> tuple[DisturbanceChannel, ...]:
    """Return the quantities of a model to which an unexplained part can be added.

    These are the quantities that the model declares, otherwise the forces of a hull. Return () for a model that cannot
    be diagnosed.
    """
    return model.residuals or (HULL if "hull" in model.provides else ())


def sensor_errors_of(model: Model) -> tuple[DisturbanceChannel, ...]:
    """Return the sensor channels that may have errors beyond their modelled biases.

    Return () for a model without a hull.
    """
    states = {s.name for s in model.states}
    return tuple(r for r in SENSOR_ERRORS if r.state in states) if "hull" in model.provides else ()


def thrust_losses_of(model: Model) -> tuple[DisturbanceChannel, ...]:
    """Return the thrusts of a vehicle that may decrease in turns.

    Return () for a model without a hull or without thrusters.
    """
    return THRUST_LOSSES if {"hull", "f"} <= set(model.provides) else ()


def variables_of(model: Model) -> tuple[Variable, ...]:
    """Return the variables on which residuals may depend.

    These are the variables that the model declares. For a hull without such a list, they are motion, time and
    thrusters. Return () for any other model.
    """
    if model.variables or "hull" not in model.provides:
        return model.variables
    signal_names = {i.name for i in model.inputs} | {s.name for s in model.states}
    shafts, thrusts = ({f"{letter}_left", f"{letter}_right"} <= signal_names for letter in ("n", "f"))
    return MOTION + (SHAFTS if shafts else THRUSTS if thrusts else ())


def products_of(model: Model) -> tuple[tuple[str, str], ...]:
    """Return the pairs of names of variables whose products are also tested; () if there are none.

    These are the pairs that the model declares, otherwise those of u, v and r for a hull.
    """
    return model.products or (PRODUCTS if "hull" in model.provides else ())
