"""State feedback for a boat about straight motion: the linear quadratic regulator of a linear model."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.errors import SeatrialError, closest_name, warn
from seatrial.daq.files import require_new, write_output
from seatrial.ident.export.conditions import conditions_text
from seatrial.ident.export.matlab import cell_array, check_mat_name, write_mat
from seatrial.ident.model import COMMAND, SHAFT_SPEED, is_of_thruster
from seatrial.ident.numerics import Array

LEAST_GROWTH = 0.05  # 1/s: poles below it grow by a factor of e in more than 20 s, which any feedback holds
TURN = 2.0 * np.pi  # rad
MOST_TURNS = 5.0  # of a heading that counts them; more are degrees
BEYOND = 1.05  # share of the end of the data from which a limit of the user is beyond them
ROOM = 0.9  # share of the limit above which a steady input leaves too little for the control
SHAFTS = ("T_n", "tau_n", "dead_zone")  # lag [s], delay [s] and dead zone of shafts that follow commands
SHAFT_DIFFERENCE = "dT_n"  # s, of the lags of both shafts; only with the effect lag-mismatch
MEASURED = ("u", "v", "r", "psi", "x", "y")  # states that sensors measure, beside shaft speeds
HEADING = "psi"  # further state of the feedback: the integral of the yaw rate


class UnstableSpeeds(NamedTuple):
    """Range of forward speeds at which a linear model has an unstable pole.

    Attributes
    ----------
    low, high
        Lowest and highest speed [m/s]. Both are the speed of one linear model if no other speed is known.
    growth
        Largest real part of the poles in this range [1/s].
    """

    low: float
    high: float
    growth: float

    def __str__(self) -> str:
        """Return the range as text with the pole, such as ``from 0.2 to 1 m/s (a pole at up to 0.3 1/s)``."""
        if self.low == self.high:
            return f"at {self.low:.3g} m/s (a pole at {self.growth:.2g} 1/s)"
        return f"from {self.low:.2g} to {self.high:.2g} m/s (a pole at up to {self.growth:.2g} 1/s)"


@dataclass(frozen=True, repr=False)
class StateFeedback:
    """State feedback ``u = u0 - gain (x - x0)`` of a boat. `lqr` of a linear model returns it.

    Attributes
    ----------
    states, inputs : tuple of str
        Names of the n states (with ``psi``, if the heading is controlled) and m inputs.
    gain : Array (m, n)
        Change of each input for a change of each state.
    x0 : Array (n,)
        States of the operating point. The heading is that of the linear model, and zero if this depends on none.
    u0 : Array (m,)
        Inputs of the operating point.
    poles : array of complex numbers (n,)
        Poles of the linear model with the feedback [1/s], without the dead time of the inputs.
    units : dict of str to str
        Unit of each state and input; empty for a number without a unit.
    u_min, u_max : Array (m,)
        Limits of the inputs: shaft speeds and commands as shares of full, infinite for a thrust.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    gain: Array
    x0: Array
    u0: Array
    poles: NDArray[np.complex128]
    units: Mapping[str, str]
    u_min: Array
    u_max: Array

    def __call__(self, x: Mapping[str, float], **wanted: float) -> Array:
        """Return the inputs (m,) at the states ``x``, in the order of `inputs`.

        Shaft speeds and commands are limited to `u_min` to `u_max`.

        Parameters
        ----------
        x : dict of str to float
            All states by name; others, such as a position, are ignored.
        **wanted : float
            Wanted values of states by name, such as ``psi`` [rad] or ``u`` [m/s]. The default is the operating point.
            The error of the heading is at most half a turn.

        Raises
        ------
        SeatrialError
            If ``x`` is no dict of numbers, if a state is missing, or if there is no state of a name.

        Warns
        -----
        SeatrialWarning
            If the heading is more than five turns, or the wanted one more than one turn although the heading is not:
            its unit is then probably the degree.
        """
        if not isinstance(x, Mapping):
            example = {n: round(float(v), 3) for n, v in zip(self.states, self.x0, strict=True)}
            raise SeatrialError(f"x: give a dict of the states by name, such as {example}, and not {_shown(x)}")
        if missing := [n for n in self.states if n not in x]:
            words = f"the state {missing[0]} is missing; the feedback needs {', '.join(self.states)}"
            if is_of_thruster(missing[0], SHAFT_SPEED):
                words += (
                    "; if no sensor measures the shaft speed, estimate it from the commands that were sent, with delay "
                    "and lag (documentation: Controllers from a fitted model, LQR without measured shaft speeds)"
                )
            raise SeatrialError(words)
        _check_names("state", wanted, self.states)
        _check_numbers({n: x[n] for n in self.states})
        _check_numbers(wanted)
        goal = {n: wanted.get(n, float(v)) for n, v in zip(self.states, self.x0, strict=True)}
        error = np.array([x[n] - goal[n] for n in self.states])
        turn = [n == HEADING for n in self.states]
        if any(turn):
            _warn_of_degrees(float(x[HEADING]), float(goal[HEADING]))
        error[turn] = np.remainder(error[turn] + np.pi, 2.0 * np.pi) - np.pi
        u = self.u0 - self.gain @ error
        found: Array = np.clip(u, self.u_min, self.u_max)
        return found

    def to_mat(self, path: str | os.PathLike[str], force: bool = False) -> Path:
        """Write the feedback to a MATLAB file, and return its path. Its law is ``u = u0 - K*(x - x0)``.

        The file has these variables:

        - K: the gain (m, n);
        - x0 and u0: states and inputs of the operating point, as columns;
        - u_min and u_max: limits of the inputs, as columns; infinite for a thrust;
        - poles: those of the linear model with the feedback [1/s];
        - states, inputs: cell arrays of the names;
        - state_units, input_units: cell arrays of the units, "1" for a number without a unit.

        Parameters
        ----------
        path : path
            The file, whose name ends in .mat.
        force : bool
            Whether an existing file is replaced.

        Raises
        ------
        SeatrialError
            If the name does not end in .mat, if the file exists and ``force`` is False, or if scipy is not installed.
        """
        file = Path(path)
        check_mat_name(file)
        require_new(file, force, "path", "force=True")
        found = self._variables()
        write_mat(file, {n: cell_array(v) if isinstance(v, list) else v for n, v in found.items()}, force)
        return file

    def to_json(
        self, path: str | os.PathLike[str], force: bool = False, shafts: Mapping[str, float] | None = None
    ) -> Path:
        """Write the feedback to a JSON file, and return its path. Names and numbers are those of `to_mat`.

        The gain is a list of a row for each input. The limit of a thrust is null. A pole is a list of its real and
        imaginary part. The node of ROS 2 of the documentation reads this file.

        Parameters
        ----------
        path : path
            The file, whose name ends in .json.
        force : bool
            Whether an existing file is replaced.
        shafts : dict of str to float, optional
            Parameters of the shafts: ``P`` of a model that was exported to Python. A controller estimates shaft speeds
            with them that nobody measures. ``T_n``, ``tau_n``, ``dead_zone`` and perhaps ``dT_n`` are written as
            ``shafts``; other names are ignored. None writes none.

        Raises
        ------
        SeatrialError
            If the name does not end in .json, if the file exists and ``force`` is False, or if ``shafts`` lacks a
            parameter.
        """
        file = Path(path)
        if file.suffix != ".json":
            raise SeatrialError(f"{file}: give a name that ends in .json; `to_mat` writes a file for MATLAB")
        require_new(file, force, "path", "force=True")
        found = self._variables()
        if shafts is not None:
            if missing := [n for n in SHAFTS if n not in shafts]:
                raise SeatrialError(
                    f"shafts: {missing[0]} is missing; give P of the exported model whose inputs are commands, or "
                    f"{{{', '.join(f'{n!r}: ...' for n in SHAFTS)}}} in s, s and as a share of full speed"
                )
            found["shafts"] = {n: float(shafts[n]) for n in (*SHAFTS, SHAFT_DIFFERENCE) if n in shafts}
        found["poles"] = np.column_stack([self.poles.real, self.poles.imag])
        lists = {n: v.tolist() if isinstance(v, np.ndarray) else v for n, v in found.items()}
        for name in ("u_min", "u_max"):
            lists[name] = [v if np.isfinite(v) else None for v in lists[name]]
        write_output(file, json.dumps(lists, indent=2) + "\n", force)
        return file

    def _variables(self) -> dict[str, Any]:
        """Return the variables of the files by name: arrays, and lists of texts."""
        return {
            "K": self.gain,
            "x0": self.x0,
            "u0": self.u0,
            "u_min": self.u_min,
            "u_max": self.u_max,
            "poles": self.poles,
            "states": list(self.states),
            "inputs": list(self.inputs),
            "state_units": [self.units[n] or "1" for n in self.states],
            "input_units": [self.units[n] or "1" for n in self.inputs],
        }

    def __repr__(self) -> str:
        """Return the gain as a table with a line for each input, the poles, and the limits of the inputs."""
        size = max(map(len, self.inputs), default=0)
        rows = [" " * size + "".join(f"{n:>12}" for n in self.states)]
        rows += [
            f"{n:<{size}}" + "".join(f"{v:12.4g}" for v in row) for n, row in zip(self.inputs, self.gain, strict=True)
        ]
        poles = ", ".join(f"{p.real:.3g}" + (f" {p.imag:+.3g}j" if p.imag else "") for p in self.poles)
        ends = zip(self.inputs, self.u_min, self.u_max, strict=True)
        limits = ", ".join(f"{n} {low:.3g} to {high:.3g}" for n, low, high in ends if np.isfinite(high))
        lines = [f"<StateFeedback: gain of {len(self.inputs)} inputs>", *rows, f"poles {poles} 1/s"]
        return "\n".join([*lines, *([f"limits {limits}"] if limits else [])])


class LinearSystem(Protocol):
    """Interface of a linear system about an operating point, which `LinearModel` implements."""

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the n states."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the m inputs."""

    @property
    def A(self) -> Array:
        """Derivatives (n, n) of the rates by the states."""

    @property
    def B(self) -> Array:
        """Derivatives (n, m) of the rates by the inputs."""

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each state and input."""

    @property
    def by_heading(self) -> Array:
        """Derivatives (n,) of the rates by the heading."""

    @property
    def conditions(self) -> Mapping[str, float]:
        """Conditions that the system takes as constant, among them the heading ``psi`` if the rates depend on it."""

    @property
    def assumed(self) -> tuple[str, ...]:
        """Names of the conditions whose value is a default."""

    @property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        """Smallest and largest value of the states and inputs in the fitted data by name; empty if unknown."""

    @property
    def x0(self) -> Array:
        """States (n,) of the operating point."""

    @property
    def u0(self) -> Array:
        """Inputs (m,) of the operating point."""

    @property
    def unstable_speeds(self) -> UnstableSpeeds | None:
        """Range of speeds around the operating point at which the system is unstable. None if it is stable there."""


def lqr(
    linear: LinearSystem, Q: Mapping[str, float], R: Mapping[str, float] | None = None, limit: float | None = None
) -> StateFeedback:
    """Return the linear quadratic regulator of a linear system, with weights of states and inputs by name.

    States that no input changes, such as those of waves, are left out.

    A `SeatrialWarning` is issued if the heading is controlled, and the rates depend on it, and nobody chose its value.
    Another one is issued if an input of the operating point is near the limit, one if a limit that was given leaves the
    data of the fit, and one for states of effects that no sensor measures. The limit, weights that are missing, the
    heading and the errors are those of `seatrial.ident.export.linearisation.LinearModel.lqr`.
    """
    from scipy.linalg import solve_continuous_are  # imported here, as it takes 0.3 s

    low, high = _limits(linear, limit)
    R = {} if R is None else R
    for what, given in (("Q", Q), ("R", R)):
        if not isinstance(given, Mapping):
            example = {"u": 4.0, "r": 1.0} if what == "Q" else dict.fromkeys(linear.inputs[:1], 2.0)
            kind = "states" if what == "Q" else "inputs"
            shown = _shown(given)
            raise SeatrialError(f"{what}: give the weights of {kind} by name, such as {example}, and not {shown}")
        _check_numbers(given)
    known = (*linear.states, *((HEADING,) if "r" in linear.states else ()))
    _check_names("state", Q, known)
    _check_names("input", R, linear.inputs)
    for name, value in {**Q, **R}.items():
        if not (np.isfinite(value) and (value > 0.0 or (value == 0.0 and name in Q))):
            raise SeatrialError(
                f"the weight of {name} is {value:g}: give a number " + ("of at least 0" if name in Q else "above 0")
            )
    kept = _influenced(linear)
    used = tuple(name for name, k in zip(linear.states, kept, strict=True) if k)
    if idle := [name for name in linear.states if name not in used and Q.get(name, 0.0) > 0.0]:
        raise SeatrialError(f"the weight of {idle[0]}: no input changes this state; the states are {', '.join(used)}")
    (n, m), steered = linear.B[kept].shape, Q.get(HEADING, 0.0) > 0.0 and HEADING not in linear.states
    states = (*used, *((HEADING,) if steered else ()))
    A, B = np.zeros((len(states), len(states))), np.zeros((len(states), m))
    A[:n, :n], B[:n] = linear.A[np.ix_(kept, kept)], linear.B[kept]
    if steered:
        A[n, used.index("r")] = 1.0
        A[:n, n] = linear.by_heading[kept]
        if HEADING in linear.assumed:
            at = conditions_text({HEADING: linear.conditions[HEADING]})
            warn(
                f"the model depends on the heading (as wind does, for example) and is linearised at {at}: linearise "
                "with at={'psi': ...} [rad] for the heading that you steer, as the inputs u0 that hold the course "
                "change with it"
            )
    if (unstable := linear.unstable_speeds) is not None:
        # The text is the same at all speeds of the range, so that Python shows it once for a schedule of speeds
        warn(
            f"the model is unstable {unstable}, and the inputs are limited: the "
            "feedback holds the boat near this motion, and may not bring it there from rest; test it with the exported "
            "model, and let the wanted speed rise from that of the boat: control(x, psi=..., u=min(speed, 0.05 * t)). "
            "This can fail if the damping of sway is negative, or if the operating point is outside the fitted data"
        )
    if hidden := [n for n in used if n not in MEASURED and not is_of_thruster(n, SHAFT_SPEED)]:
        warn(
            f"no sensor measures the states {', '.join(hidden)}, which an effect of the model has: estimate them with "
            "the exported model, or take a model without this effect for the controller"
        )
    _warn_of_limit(linear, low, high, limit)
    weights, costs = np.diag([Q.get(s, 0.0) for s in states]), np.diag([R.get(i, 1.0) for i in linear.inputs])
    failure = "no feedback with these weights makes the motion stable: give weights to u, r and psi"
    try:
        gain = np.linalg.solve(costs, B.T @ solve_continuous_are(A, B, weights, costs))
    except np.linalg.LinAlgError:
        raise SeatrialError(failure) from None
    poles = np.linalg.eigvals(A - B @ gain).astype(np.complex128)
    if not (poles.real < 0.0).all():
        raise SeatrialError(failure)
    poles = poles[np.argsort(np.abs(poles.real), kind="stable")]
    x0 = np.append(linear.x0[kept], np.full(len(states) - n, linear.conditions.get(HEADING, 0.0)))
    units = {**linear.units, **({HEADING: "rad"} if steered else {})}
    units = {name: units[name] for name in (*states, *linear.inputs)}
    return StateFeedback(states, linear.inputs, gain, x0, linear.u0, poles, units, low, high)


def _influenced(linear: LinearSystem) -> NDArray[np.bool_]:
    """Return which states (n,) an input changes, directly or through other states.

    The others are those of disturbances, such as waves. Nobody measures them, and the gains of the other states do not
    depend on them.
    """
    found = (linear.B != 0.0).any(axis=1)
    for _ in linear.states:
        found = found | (linear.A[:, found] != 0.0).any(axis=1)
    return np.asarray(found)


def _is_share_of_full(name: str) -> bool:
    """Return whether an input is a shaft speed or a command, from -1 to 1."""
    return is_of_thruster(name, COMMAND, SHAFT_SPEED)


def _limits(linear: LinearSystem, limit: float | None) -> tuple[Array, Array]:
    """Return the lower and upper limits (m,) of the inputs; infinite for a thrust.

    For None they are the ends of the range of the fitted data, and full speed without a range. Zero is always allowed,
    so that the feedback can stop the boat.

    Parameters
    ----------
    linear : LinearSystem
        The linear system, with the ranges of the fitted data.
    limit : float or None
        Largest shaft speed or command of the user.

    Raises
    ------
    SeatrialError
        If the limit is no number above 0 and at most 1.

    Warns
    -----
    SeatrialWarning
        If the limit of the user leaves the range of an input in the data: the thrust there is extrapolated.
    """
    shares = [_is_share_of_full(n) for n in linear.inputs]
    if limit is None:
        ends = [linear.ranges.get(n, (-1.0, 1.0)) for n in linear.inputs]
        low = np.where(shares, np.clip([end[0] for end in ends], -1.0, 0.0), -np.inf)
        high = np.where(shares, np.clip([end[1] for end in ends], 0.0, 1.0), np.inf)
        return low, high
    _check_numbers({"limit": limit})
    if not 0.0 < limit <= 1.0:
        raise SeatrialError(f"limit {limit:g}: give the largest shaft speed or command, above 0 and at most 1")
    known = {n: linear.ranges[n] for n in linear.inputs if _is_share_of_full(n) and n in linear.ranges}
    if beyond := [f"{n} {a:.3g} to {b:.3g}" for n, (a, b) in known.items() if limit > BEYOND * min(-a, b)]:
        warn(
            f"limit {limit:g}: the data of the fit end before it ({', '.join(beyond)}): the thrust beyond them is "
            "extrapolated; without `limit` the feedback stays in the data"
        )
    high = np.where(shares, limit, np.inf)
    return -high, high


def _warn_of_limit(linear: LinearSystem, low: Array, high: Array, limit: float | None) -> None:
    """Warn of the input of the operating point that uses most of its limits, if this is near one of them.

    ``low`` and ``high`` (m,) are the limits of the inputs, and ``limit`` is that of the user.
    """
    # Share of the room from zero to the limit on the side of each input; without room on this side it is infinite.
    ends = np.where(linear.u0 < 0.0, low, high)
    with np.errstate(divide="ignore", invalid="ignore"):
        used = np.where(linear.u0 == 0.0, 0.0, linear.u0 / ends)
    k = int(np.argmax(used)) if used.size else 0
    if not used.size or used[k] <= ROOM:
        return
    data = " (the end of the fitted data)" if limit is None and linear.inputs[k] in linear.ranges else ""
    larger = ", or give a larger limit" if abs(ends[k]) < 1.0 else ""
    warn(
        f"the operating point needs {linear.inputs[k]} = {linear.u0[k]:.3g}, more than {ROOM:g} of the limit "
        f"{ends[k]:.3g}{data}: the feedback has too little room to steer; linearise at a lower speed{larger}"
    )


def _warn_of_degrees(psi: float, wanted: float) -> None:
    """Warn if the heading or the wanted heading [rad] are probably in degrees.

    A heading may count its turns, as that of a log and of a simulation does. Then the wanted heading may do so too.
    """
    if MOST_TURNS * TURN < abs(psi) < np.inf:
        warn(f"the state psi = {psi:g} rad; if these are degrees, give np.radians({psi:g})")
    elif abs(psi) <= TURN < abs(wanted) < np.inf:
        warn(f"psi = {wanted:g} rad is the wanted heading; if these are degrees, give np.radians({wanted:g})")


def _shown(value: object) -> str:
    """Return a value of the user for a message: as Python writes it, or what it is if it has several numbers."""
    kind = "a matrix" if isinstance(value, np.ndarray) else f"a {type(value).__name__}"
    return kind if isinstance(value, np.ndarray | list | tuple) else f"{value!r:.60}"


def _check_numbers(given: Mapping[str, float]) -> None:
    """Raise SeatrialError if one of the values by name is not a number."""
    for name, value in given.items():
        if isinstance(value, bool) or np.ndim(value) or not isinstance(value, Real | np.ndarray):
            raise SeatrialError(f"{name} is {_shown(value)}: give a number, in SI units and radians")


def _check_names(kind: str, given: Mapping[str, float], known: tuple[str, ...]) -> None:
    """Raise SeatrialError if a name is not among the known ones of this kind, ``state`` or ``input``."""
    for name in given:
        if name not in known:
            near = closest_name(name, known)
            hint = f"did you mean {near!r}? " if near else ""
            raise SeatrialError(f"the model has no {kind} {name!r}; {hint}its {kind}s are {', '.join(known)}")
