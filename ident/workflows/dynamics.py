"""Steady motion, poles and step responses of a fitted vehicle model, for its result and its report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.ident.estimation import Fit, FittedModel, SavedModel
from seatrial.ident.export import Linearisation, linearise, steady_motion
from seatrial.ident.model import COMMAND, SHAFT_SPEED, THRUSTER_FORCE, Model, ModelKind, is_of_thruster
from seatrial.ident.numerics import Array
from seatrial.ident.results import Dynamics, OperatingPoint, SteadyCurve, StepResponse
from seatrial.ident.workflows.output import validity

POINTS = 41  # of a steady curve
MEANS = (0.0, 0.5)  # means of both sides in turns, as parts of the largest command
SPEEDS = (0.25, 0.5, 0.75, 1.0)  # speeds of the linear models, as parts of the largest steady speed
COMMAND_STEP = 0.1  # size of the steps of the command, as a part of the largest command
CONSTANTS, LONGEST_S, TIMES = 4.0, 60.0, 200  # length of a response in time constants and in s, and its points
UNITS = {"u": "m/s", "v": "m/s", "r": "rad/s"}


def dynamics_of(fitted: FittedModel) -> Dynamics | None:
    """Return steady motion, poles and step responses of a fitted vehicle model.

    The curves are limited to the commands of the estimation data. A part that cannot be computed is left out.

    Parameters
    ----------
    fitted : FittedModel
        Fit with its estimation records.

    Returns
    -------
    Dynamics or None
        None for a bench model, a fit that did not converge, a model without speed, turn rate or commands, and if no
        part can be computed.
    """
    fit, model = fitted.fit, fitted.fit.model
    states = {s.name for s in model.states}
    if model.kind is not ModelKind.VEHICLE or not fit.converged or not states & {"u", "r"}:
        return None
    drives = _Drives(model, validity(fitted))
    if not drives.names:
        return None
    curves: list[SteadyCurve] = []
    try:
        if "u" in states:
            curves.append(_straight(fit, drives))
        if "r" in states and drives.two_sided:
            curves += [_turn(fit, drives, mean * drives.high) for mean in MEANS]
    except (ArithmeticError, np.linalg.LinAlgError, TypeError, ValueError):
        curves = []  # a user-defined model whose rates are not defined at these inputs
    curves = [c for c in curves if np.isfinite(c.value).sum() > 2]
    reached = [np.nanmax(c.value) for c in curves if c.motion == "straight"]
    linear = _linear_models(model, float(reached[0])) if reached else []
    steps = _steps(linear[(len(linear) - 1) // 2], drives) if linear else []
    if not curves and not linear:
        return None
    delays = dict(linear[0].delays) if linear else {}
    return Dynamics(steady=tuple(curves), points=tuple(_point(x) for x in linear), steps=tuple(steps), delays=delays)


class _Drives:
    """Inputs of a model that drive the boat, and their range in the data.

    Attributes
    ----------
    names : list of str
        Names of all inputs of the model without delayed copies. Empty if none of them drives the boat, or if the range
        of one that drives it is unknown.
    low, high : float
        Common range of the driving inputs in the data; of shaft speeds and commands only the part from -1 to 1.
    two_sided : bool
        Whether there are inputs of a left and of a right side.
    driving : tuple of str
        Names of the driving inputs.
    """

    def __init__(self, model: Model, ranges: Mapping[str, tuple[float, float]]) -> None:
        """Find the driving inputs: those of both sides, or the only input. Others stay in the middle of their range."""
        names = [i.name for i in model.inputs if not i.tap]
        of_thrusters = [n for n in names if is_of_thruster(n, COMMAND, SHAFT_SPEED, THRUSTER_FORCE)]
        sides = [n for n in of_thrusters if n.endswith(("_left", "_right"))]
        self.two_sided = any(n.endswith("_left") for n in sides) and any(n.endswith("_right") for n in sides)
        chosen = sides if self.two_sided else names if len(names) == 1 else []
        known = [ranges[n] for n in chosen if n in ranges]
        self.driving = tuple(chosen)
        self.names = names if chosen and len(known) == len(chosen) else []
        self.low = max((a for a, _ in known), default=0.0)
        self.high = min((b for _, b in known), default=0.0)
        if all(is_of_thruster(n, COMMAND, SHAFT_SPEED) for n in chosen):
            # A shaft can turn a little faster than full speed.
            self.low, self.high = max(self.low, -1.0), min(self.high, 1.0)
        self._constant = {n: float(np.mean(ranges.get(n, (0.0, 0.0)))) for n in names if n not in chosen}

    def inputs(self, left: Array, right: Array) -> Array:
        """Return the inputs (n_rows, m) of the model for the commands of both sides (n_rows,)."""
        columns = [
            np.full(left.shape, self._constant[n]) if n in self._constant else right if n.endswith("_right") else left
            for n in self.names
        ]
        return np.stack(columns, axis=1)


def _straight(fit: Fit, drives: _Drives) -> SteadyCurve:
    """Return the steady forward speed over the command of both sides, with sway and yaw rate held at zero."""
    command = np.union1d(np.linspace(drives.low, drives.high, POINTS), [0.0] if drives.low < 0.0 < drives.high else [])
    held = tuple(s.name for s in fit.model.states if s.name in ("v", "r"))
    found = steady_motion(fit.model, drives.inputs(command, command), tuple(fit.names), fit.covariance, held)
    value, sd = found.of("u")
    return SteadyCurve(
        motion="straight", quantity="u", unit="m/s", inputs=drives.driving, command=command, value=value, sd=sd
    )


def _turn(fit: Fit, drives: _Drives, mean: float) -> SteadyCurve:
    """Return the steady yaw rate over half the difference of both sides, whose mean is ``mean``."""
    reach = min(drives.high - mean, mean - drives.low)
    command = np.linspace(-reach, reach, POINTS)
    u = drives.inputs(mean + command, mean - command)
    value, sd = steady_motion(fit.model, u, tuple(fit.names), fit.covariance).of("r")
    return SteadyCurve(
        motion="turn", quantity="r", unit="rad/s", inputs=drives.driving, mean=mean, command=command, value=value, sd=sd
    )


def _linear_models(model: Model, fastest: float) -> list[Linearisation]:
    """Return the linear models at parts of the speed ``fastest`` [m/s]. A speed without one is left out."""
    found = []
    saved = SavedModel(model, {}, {})
    for part in SPEEDS:
        speed = float(f"{part * fastest:.2g}") if part < 1.0 else float(np.floor(fastest * 100.0) / 100.0)
        try:
            found.append(linearise(saved, speed))
        except (SeatrialError, ArithmeticError, np.linalg.LinAlgError, TypeError, ValueError):
            continue
    return found


def _point(linear: Linearisation) -> OperatingPoint:
    """Return the operating point of a linear model with its poles, for the result."""
    poles = linear.poles
    inputs = {name: float(value) for name, value in zip(linear.inputs, linear.u0, strict=True)}
    return OperatingPoint(
        speed=linear.speed, inputs=inputs, real=poles.real, imaginary=poles.imag, stable=linear.stable
    )


def _steps(linear: Linearisation, drives: _Drives) -> list[StepResponse]:
    """Return the responses of speed (to a step of both sides) and of yaw rate and sway (to one of their difference).

    They last four time constants of the slowest pole, at least 4 s and at most a minute. An unstable pole ends them
    after one of its time constants. A model without two sides has only the response of speed.
    """
    constants = np.abs(linear.time_constants[np.isfinite(linear.time_constants)])
    growing = linear.time_constants[linear.time_constants < 0.0]
    length = min([LONGEST_S, CONSTANTS * float(constants.max(initial=1.0)), *(-growing)])
    t, size = np.linspace(0.0, length, TIMES), COMMAND_STEP * drives.high
    wanted: list[tuple[Literal["straight", "turn"], Sequence[str]]] = [("straight", ("u",)), ("turn", ("r", "v"))]
    found = []
    for motion, quantities in wanted:
        if motion == "turn" and not drives.two_sided:
            continue
        signs = {n: -1.0 if motion == "turn" and n.endswith("_right") else 1.0 for n in drives.driving}
        responses = [(sign, linear.step_response(n, t)) for n, sign in signs.items() if n in linear.inputs]
        for quantity in (q for q in quantities if q in linear.states):
            value = size * np.sum([sign * r[quantity] for sign, r in responses], axis=0)
            found.append(
                StepResponse(
                    speed=linear.speed, motion=motion, step=size,
                    quantity=quantity, unit=UNITS[quantity], t=t, value=value,
                )
            )  # fmt: skip
    return found
