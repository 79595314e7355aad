"""Linear models of a fitted boat about straight motion: matrices, poles, step responses and frequency responses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from numbers import Real
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from seatrial.daq.errors import NamedValues, SeatrialError, UnknownName, closest_name
from seatrial.ident.effects import SHORTEST_OWN_LAG
from seatrial.ident.estimation import PARAMETER_STEP, ParameterCovariance, principal_directions
from seatrial.ident.export.codegen import without_nuisance
from seatrial.ident.export.conditions import (
    chosen_conditions,
    conditions_text,
    drift_text,
    heading_sentence,
    outside_text,
)
from seatrial.ident.export.rates import Rates
from seatrial.ident.export.state_feedback import HEADING, LEAST_GROWTH, StateFeedback, UnstableSpeeds, lqr
from seatrial.ident.model import COMMAND, SHAFT_SPEED, THRUSTER_FORCE, Model, is_of_thruster
from seatrial.ident.models import COARSE_STEP_S, SHORTEST_LAG, shortest_lag
from seatrial.ident.numerics import NOT_SHOWN, STABLE, UNSTABLE, Array, is_undetermined, stability_of

SOLVED = 1e-10  # the same, below which no other start of the search is tried
NOISE = 1e-10  # size below which a state or input is zero, if the rates are then as small
BALANCED = 1e-6  # largest rate at the operating point, in the unit of each state per second
DRIFTS = (0.1, -0.1, 0.3, -0.3)  # initial sway speeds, as parts of the forward speed
TRIALS = (0.1, 0.4, 0.8)  # initial values of the inputs: at zero the thrust has no slope
HEADING_STEP = 1e-5  # step of the central difference by the heading [rad]
CORRECTIONS = 6  # steps of the search for the operating point of moved estimates
CONSTANTS, LONGEST_S, TIMES = 4.0, 60.0, 200  # length of a response in time constants and in s, and its points
DECADE, FREQUENCIES = 10.0, 300  # reach of a frequency response beyond the poles, as a factor, and its points
LAGS = 3.0  # reach of a frequency response beyond a lag of 90 deg by a dead time, as a factor
MOTION_WORDS = {"yaw": "turn", "heading": "turn", "surge": "straight", "forward": "straight"}  # to one of the motions
HALF_POWER = np.sqrt(0.5)  # -3 dB
EQUAL_STEPS = 1e-13  # of the longest time, by which two steps of time may differ and still count as equal
FREE = "free"  # of a motion whose pole is zero
STATE_WORDS = {"u": "surge speed", "v": "sway speed", "r": "yaw rate"}
BOAT_STATES = ("u", "v", "r", "psi", "x", "y")
THRUSTER_STATES = ("n_", "f_", "late_", "slow_", "heat_")  # beginnings of the names of the states of thrusters
LARGE_PART = 0.2  # participation of a state in a motion, as a part of the largest one, from which it is named
MAIN_PART = 0.5  # the same, from which a pole is named after it
Z95 = 1.96  # half the width of a 95 % interval in standard errors
# shortest time constants of the states of lags [s], with usual steps and with the steps of a search
SHORTEST_LAGS = (SHORTEST_LAG, shortest_lag(COARSE_STEP_S), SHORTEST_OWN_LAG)
SAME_LAG = 1e-9  # relative difference of a time constant from one of these by rounding
SPEEDS, HALVINGS = 11, 4  # speeds that are searched for unstable poles, and halvings of the steps at both ends
STATIC = 1e-6  # poles below this part of the largest one are integrators, which have no corner frequency

Complex = NDArray[np.complex128]
Inputs = str | Mapping[str, float]


def _group_of(state: str) -> int:
    """Return the place of a state in the order of the poles: 0 for the boat, 1 for thrusters, 2 for others."""
    if state in BOAT_STATES:
        return 0
    return 1 if state == SHAFT_SPEED or state.startswith(THRUSTER_STATES) else 2


class Bode(NamedTuple):
    """Frequency response of one state in the form of a Bode plot.

    Attributes
    ----------
    frequency : Array (n,)
        Frequencies [Hz].
    gain : Array (n,)
        Amplitude of the state, in its unit, for an amplitude of one unit of the inputs.
    phase : Array (n,)
        Phase of the state to the inputs [rad]; negative if the state is later. It has no jumps of a full turn.
    gain_sd : Array (n,)
        Standard error of the gain relative to it, from the errors of the estimates; NaN if they are unknown.
    phase_sd : Array (n,)
        Standard error of the phase [rad]; NaN if unknown.
    start : float
        Phase [rad] from which a lag is counted: that of slow inputs, a whole number of half turns. If an unstable pole
        dominates the response to slow inputs, it is half a turn above, as that of the same boat without this pole.
    bandwidth_sd : float
        Standard error of `bandwidth` [Hz], from the errors of the estimates; NaN if it is unknown.
    lag_90_sd : float
        Standard error of `lag_90` [Hz]; NaN if it is unknown.
    """

    frequency: Array
    gain: Array
    phase: Array
    gain_sd: Array
    phase_sd: Array
    start: float = 0.0
    bandwidth_sd: float = float("nan")
    lag_90_sd: float = float("nan")

    def __repr__(self) -> str:
        """Return one line with the number and range of the frequencies, and the bandwidth with its standard error."""
        f = self.frequency
        error = f" ± {self.bandwidth_sd:.2g}" if np.isfinite(self.bandwidth_sd) else ""
        return f"Bode({f.size} frequencies, {f[0]:.3g} to {f[-1]:.3g} Hz, bandwidth {self.bandwidth:.3g}{error} Hz)"

    @property
    def bandwidth(self) -> float:
        """Lowest frequency [Hz] at which the gain is 3 dB below that at the lowest frequency; NaN if there is none."""
        return _first_crossing(self.frequency, np.log(self.gain / self.gain[0]), float(np.log(HALF_POWER)))

    @property
    def lag_90(self) -> float:
        """Lowest frequency [Hz] at which the phase falls to 90 deg below `start`; NaN if there is none.

        An unstable pole turns the slow response around. The phase then begins half a turn below `start`, and the
        frequency is the one at which it falls again after its rise. `no_lag_90` is the reason of NaN.
        """
        first = self._first_in_phase
        if first is None:
            return float("nan")
        return _first_crossing(self.frequency[first:], self.phase[first:] - self.start, -0.5 * np.pi)

    @property
    def no_lag_90(self) -> str:
        """Reason why `lag_90` is NaN, in sentences; empty if it is a number."""
        first, low, high = self._first_in_phase, self.frequency[0], self.frequency[-1]
        if np.isfinite(self.lag_90):
            return ""
        if first is None:
            return (
                f"The state lags by more than 90 deg at all frequencies from {low:.3g} to {high:.3g} Hz. If a pole is "
                "unstable, lag and dead time are too large for a heading controller without a yaw-rate term."
            )
        rises = f"An unstable pole makes the phase rise to -90 deg at {self.frequency[first]:.3g} Hz. " if first else ""
        return (
            f"{rises}The state {'then ' if first else ''}never lags by 90 deg up to {high:.3g} Hz. A model with shaft "
            "speeds or forces as inputs has neither the lag nor the dead time of the thrusters; one with commands has "
            "both (horizontal:command)."
        )

    @property
    def _first_in_phase(self) -> int | None:
        """Return the index of the lowest frequency at which the state lags by less than 90 deg.

        The result is None if the state lags by 90 deg or more at all frequencies.
        """
        found = np.flatnonzero(self.phase - self.start > -0.5 * np.pi)
        return int(found[0]) if found.size else None


def _first_crossing(frequency: Array, value: Array, level: float) -> float:
    """Return the frequency at which a value first falls to a level, linear in the logarithm of the frequency.

    NaN if the value begins below the level, or if it never falls to it.
    """
    below = np.flatnonzero(value <= level)
    if not below.size or below[0] == 0:
        return float("nan")
    k = below[0]
    part = (value[k - 1] - level) / (value[k - 1] - value[k])
    return float(frequency[k - 1] * (frequency[k] / frequency[k - 1]) ** part)


@dataclass(frozen=True, repr=False)
class LinearModel:
    """Linear model ``dx/dt = A (x - x0) + B (u - u0)`` about straight motion in still water.

    Attributes
    ----------
    speed : float
        Forward speed through the water [m/s].
    states, inputs : tuple of str
        Names of the n states and m inputs. The states are the velocities, and those on which these depend, such as
        those of shafts. States of sensors, such as the filter of a compass, are not among them.
    A : Array (n, n)
        Derivatives of the rates by the states [1/s, if both have the same unit].
    B : Array (n, m)
        Derivatives of the rates by the inputs.
    x0 : Array (n,)
        States of the operating point.
    u0 : Array (m,)
        Inputs that keep the operating point.
    delays : dict of str to float
        Dead time [s] of each input that the model delays. The matrices do not contain it.
    units : dict of str to str
        Unit of each state and input by name; empty for a number without unit.
    by_heading : Array (n,)
        Derivatives of the rates by the heading [unit of the state per s and rad], which A does not contain. They are
        zero unless the model depends on the heading, as by wind.
    moved : tuple of LinearModel
        Linear models with moved estimates: by 0.05 standard errors along each principal direction of their covariance.
        Standard errors are computed from them. Empty if the covariance is unknown.
    conditions : dict of str to float
        Conditions on which the model depends, and which the linear model takes as constant: time ``t`` [s] since the
        start of a run, ``work`` of the thrusters, place ``x`` and ``y`` [m], heading ``psi`` [rad]. Often empty.
    assumed : tuple of str
        Names of the conditions whose value is a default, because none was chosen.
    ranges : dict of str to tuple of float
        Smallest and largest value of the states and inputs in the fitted data by name. Empty if they are unknown.
    at_speed : callable or None
        Function that linearises the same fitted model at another speed [m/s], with the argument ``near`` of
        `linearise`. None: there is only this linear model.
    """

    speed: float
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    A: Array
    B: Array
    x0: Array
    u0: Array
    delays: Mapping[str, float]
    units: Mapping[str, str]
    by_heading: Array
    moved: tuple[LinearModel, ...] = ()
    conditions: Mapping[str, float] = field(default_factory=dict)
    assumed: tuple[str, ...] = ()
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    at_speed: Callable[..., LinearModel] | None = field(default=None, compare=False)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs of `C` and `D`, which are the states."""
        return self.states

    @property
    def C(self) -> Array:
        """Output matrix (n, n): the identity, because the outputs are the states."""
        return np.eye(len(self.states))

    @property
    def D(self) -> Array:
        """Feedthrough matrix (n, m): zero, because no state follows an input at once."""
        return np.zeros_like(self.B)

    @property
    def operating_point(self) -> dict[str, float]:
        """Values of states and inputs at the operating point by name, those of `x0` and `u0`."""
        values = [*self.x0.tolist(), *self.u0.tolist()]
        return NamedValues(dict(zip((*self.states, *self.inputs), values, strict=True)), "state or input")

    @property
    def outside(self) -> str:
        """List of the states and inputs of the operating point that leave their ranges in the fitted data.

        Each has its value and its range. The text is empty if all are inside. Otherwise the model extrapolates.
        """
        return outside_text(self.operating_point, self.ranges)

    @property
    def drift(self) -> str:
        """Sway speed and drift angle of the operating point in words; empty if the drift is below 1 deg."""
        values = dict(zip(self.states, self.x0, strict=True))
        return drift_text(self.speed, float(values.get("v", 0.0)))

    @property
    def poles(self) -> Complex:
        """Eigenvalues (n,) of A [1/s] in three groups: the boat, its thrusters, and other states.

        The other states belong to disturbances and sensors, such as waves. The slowest pole of a group comes first: the
        order is that of the size of the real parts. `mainly` names the states of each pole.
        """
        return self._modes[0]

    @property
    def time_constants(self) -> Array:
        """Time constants (n,) [s] of the poles in their order: ``-1 / Re``.

        A negative time constant belongs to an unstable pole. That of an integrator is infinite.
        """
        real = self.poles.real
        return np.where(real == 0.0, np.inf, -1.0 / np.where(real == 0.0, 1.0, real))

    @property
    def pole_errors(self) -> Array:
        """Standard errors (n,) [1/s] of the real parts of the poles, in their order, from the errors of the estimates.

        NaN if those are unknown, and if poles coincide, so that they have no derivative.
        """
        poles, right = self._modes
        if not self.moved or np.linalg.matrix_rank(right) < len(poles):
            return np.full(len(poles), np.nan)
        left = np.linalg.inv(right)
        moves = [np.einsum("ij,jk,ki->i", left, m.A - self.A, right).real for m in self.moved]
        return self.error_of(np.zeros(len(poles)), moves)

    @property
    def time_constant_errors(self) -> Array:
        """Standard errors (n,) [s] of the time constants, in their order, from the errors of the estimates.

        NaN if those are unknown, and if poles coincide, so that they have no derivative.
        """
        return self.pole_errors * np.square(self.time_constants)

    @property
    def participation(self) -> Array:
        """Participation factors (n, n) of the states in the poles, with a row for each pole in the order of `poles`.

        They are the products of the left and right eigenvectors of a pole by state, as absolute values (Perez-Arriaga,
        Verghese and Schweppe 1982). Those of poles that coincide are not unique.
        """
        _, right = self._modes
        return np.abs(np.linalg.pinv(right) * right.T)

    @property
    def mainly(self) -> tuple[str, ...]:
        """Names of the states that take most part in each pole (n,), such as ``u`` or ``r, v``, the largest part first.

        They are those whose participation is more than half of the largest one.
        """
        found = []
        for share in self.participation:
            order = np.argsort(-share, kind="stable")
            found.append(", ".join(self.states[k] for k in order if share[k] > MAIN_PART * share.max()))
        return tuple(found)

    @property
    def course_pole(self) -> int | None:
        """Index in `poles` of the least stable pole of sway and yaw. It is None if no pole belongs to them.

        A pole belongs to sway and yaw if these states have more than half of its participation factors.
        """
        poles, share = self.poles, self.participation
        of = [k for k, name in enumerate(self.states) if name in ("v", "r")]
        found = np.flatnonzero(share[:, of].sum(axis=1) > 0.5 * share.sum(axis=1))
        return int(found[np.argmax(poles.real[found])]) if found.size else None

    @property
    def stable(self) -> bool:
        """Whether all poles of the estimates have a negative real part. The data may not show this: see `stability`."""
        return bool((self.poles.real < 0.0).all())

    @property
    def stability(self) -> str:
        """What the data show: ``stable``, ``unstable``, ``not shown by the data`` or ``free``.

        The 95 % intervals of the poles decide, with their standard errors `pole_errors`; without these, the estimates
        decide. The model is ``unstable`` if a motion surely grows. Otherwise, its stability is
        ``not shown by the data`` if the interval of a pole contains zero. It is ``free`` if a pole is zero and none
        grows: nothing brings this motion back. `stability_text` has the motions.
        """
        found = self._stability_of_poles
        return next((word for word in (UNSTABLE, NOT_SHOWN, FREE) if word in found), STABLE)

    @property
    def _stability_of_poles(self) -> list[str]:
        """Stability of the motion of each pole, in the order of `poles`."""
        least = STATIC * np.abs(self.poles).max(initial=0.0)
        return [
            FREE if abs(pole) <= least else stability_of(pole, pole - Z95 * error, pole + Z95 * error)
            for pole, error in zip(self.poles.real.tolist(), self.pole_errors.tolist(), strict=True)
        ]

    @property
    def growth(self) -> float:
        """Growth rate [1/s] of the fastest unstable motion, 0 if none grows. A free motion (pole 0) does not grow."""
        largest = float(self.poles.real.max(initial=0.0))
        return largest if largest > STATIC * np.abs(self.poles).max(initial=0.0) else 0.0

    @property
    def stability_text(self) -> str:
        """Stability in words: the word of `stability`, and the states of each motion that may not decay.

        A motion with a pole of zero does not decay: a heading without a controller keeps its error.
        """
        value, share, found = self.stability, self.participation, []
        kinds = zip(self._stability_of_poles, self.poles, self.pole_errors, strict=True)
        for k, (kind, pole, error) in enumerate(kinds):
            if kind == STABLE or pole.imag < 0.0:  # of a pair, the pole with the positive imaginary part is described
                continue
            of = [s for s, part in zip(self.states, share[k], strict=True) if part > LARGE_PART * share[k].max()]
            names, one = " and ".join(STATE_WORDS.get(s, s) for s in of), len(of) == 1
            if kind == FREE:
                verb = "is" if one else "are"
                found.append(f"{names} {verb} free (pole 0): nothing brings back what a disturbance has changed")
            elif kind == UNSTABLE:
                verb = "grows" if one else "grow"
                found.append(f"{names} {verb} by a factor of e in {1.0 / pole.real:.3g} s without a controller")
            else:
                found.append(f"{names} may grow or decay (pole {pole.real:.2g} ± {error:.2g} 1/s)")
        value = f"stability {value}" if value == NOT_SHOWN else value
        return f"{value}: {'; '.join(found)}" if found else value

    @property
    def unstable_speeds(self) -> UnstableSpeeds | None:
        """Range of speeds in the fitted data, with that of this model, with a pole above 0.05 1/s; None if none is.

        The range is this speed alone if the speeds of the data are unknown, or if this one is outside them.
        """
        growth = self._growth_at(self.speed)
        if not growth > LEAST_GROWTH:
            return None
        here = UnstableSpeeds(self.speed, self.speed, growth)
        low, high = self.ranges.get("u", (0.0, 0.0))
        if self.at_speed is None or not low <= self.speed <= high:
            return here
        ends = (max(low, 0.0), high) if self.speed > 0.0 else (low, min(high, 0.0))
        speeds = np.linspace(*ends, SPEEDS)
        growths = np.array([self._growth_at(float(v)) for v in speeds])
        found = np.flatnonzero(growths > LEAST_GROWTH)
        if not found.size or len(found) <= np.ptp(found):  # none, or a gap of stable speeds
            return here
        edges = []
        for k, beyond in ((found[0], found[0] - 1), (found[-1], found[-1] + 1)):
            inside = float(speeds[k])
            outside = float(speeds[beyond]) if 0 <= beyond < SPEEDS else inside
            for _ in range(HALVINGS if outside != inside else 0):
                middle = 0.5 * (inside + outside)
                inside, outside = (middle, outside) if self._growth_at(middle) > LEAST_GROWTH else (inside, middle)
            edges.append(inside)
        step = float(speeds[1] - speeds[0])
        if not edges[0] - step <= self.speed <= edges[1] + step:
            return here
        return UnstableSpeeds(edges[0], edges[1], float(growths[found].max()))

    def _growth_at(self, speed: float) -> float:
        """Return the largest real part [1/s] of the poles at a speed [m/s]; NaN where there is no linear model."""
        if speed == self.speed:
            return float(self.poles.real.max(initial=0.0))
        if self.at_speed is None or speed == 0.0:
            return float("nan")
        try:
            return float(self.at_speed(speed, near=self).poles.real.max(initial=0.0))
        except (SeatrialError, ArithmeticError, np.linalg.LinAlgError):
            return float("nan")  # for example a speed that the boat does not reach

    @property
    def motions(self) -> dict[str, dict[str, float]]:
        """Inputs of the usual manoeuvres, each as a weight by input, for `step_response` and the other responses.

        With inputs of a left and a right side, these are ``straight`` (both sides up) and ``turn`` (left side up, right
        side down; its unit is half the difference of both sides). Inputs without a side do not change. Otherwise it is
        each input alone, by its name.
        """
        sides = side_inputs(self.inputs)
        if not sides:
            return {n: {n: 1.0} for n in self.inputs}
        turn = {n: 1.0 if n.endswith("_left") else -1.0 for n in sides}
        return {"straight": dict.fromkeys(sides, 1.0), "turn": turn}

    def step_response(self, inputs: Inputs, t: ArrayLike | None = None) -> dict[str, Array]:
        """Return the response of each state to a unit step of the inputs at t = 0, with their dead time.

        Parameters
        ----------
        inputs : str, or dict of str to float
            Name of an input or of one of the `motions`, or a weight for each of several of these names.
        t : Array (n_times,) or float, optional
            Times [s], at least 0. None: `times`. One number is the end of 200 equidistant times from 0 on.

        Returns
        -------
        dict of str to Array (n_times,)
            Change of each state from the operating point, for a step of one unit of the inputs, in SI units and
            radians. If the model is not stable (`stable`), the response grows without limit, which no boat does: it is
            valid only while the changes are small.

        Raises
        ------
        SeatrialError
            If the model has no such input (`UnknownName`, which is a KeyError too), if ``inputs`` is neither a name nor
            a dict of weights, or if a time is no number of at least 0.
        """
        at = self.response_times(t)
        columns: dict[float, Array] = {}  # inputs with the same dead time have one column of B
        for name, weight in self._weights(inputs).items():
            delay = self.delays.get(name, 0.0)
            columns[delay] = columns.get(delay, 0.0) + weight * self.B[:, self.inputs.index(name)]
        found = np.zeros((at.size, len(self.states)))
        for delay, b in columns.items():
            found += _response_to_a_step(self.A, b, np.maximum(at - delay, 0.0))
        return NamedValues({state: found[:, k] for k, state in enumerate(self.states)}, "state")

    def frequency_response(self, inputs: Inputs, frequency: ArrayLike | None = None) -> dict[str, Complex]:
        """Return the frequency response of each state to the inputs, with their dead time.

        Parameters
        ----------
        inputs : str, or dict of str to float
            Name of an input or of one of the `motions`, or a weight for each of several of these names.
        frequency : Array (n_frequencies,), optional
            Frequencies [Hz], above 0. None: `frequencies`.

        Returns
        -------
        dict of str to Array (n_frequencies,) of complex numbers
            ``(j w - A)^-1 B exp(-j w delay)`` with ``w = 2 pi frequency``: the amplitude of each state for an amplitude
            of one unit of the inputs, and its phase. If the model is not stable, a boat does not move in this way
            without a controller, but the response is valid for the design of one.

        Raises
        ------
        SeatrialError
            If the model has no such input (`UnknownName`, which is a KeyError too), if ``inputs`` is neither a name nor
            a dict of weights, or if a frequency is no number above 0.
        """
        f = self._frequencies(frequency)
        w, weights = 2.0 * np.pi * f, self._weights(inputs)
        driven = np.zeros((f.size, len(self.states)), dtype=np.complex128)
        for name, weight in weights.items():
            driven += weight * np.outer(
                np.exp(-1j * w * self.delays.get(name, 0.0)), self.B[:, self.inputs.index(name)]
            )
        whole = 1j * w[:, None, None] * np.eye(len(self.states)) - self.A
        found = np.linalg.solve(whole, driven[..., None])[..., 0].astype(np.complex128)
        return NamedValues({state: found[:, k] for k, state in enumerate(self.states)}, "state")

    def bode(self, inputs: Inputs, frequency: ArrayLike | None = None) -> dict[str, Bode]:
        """Return gain and phase of the frequency response of each state, with their standard errors.

        A state that does not respond to the inputs, such as the yaw rate to equal changes of both sides, is left out.

        Parameters
        ----------
        inputs : str, or dict of str to float
            Name of an input or of one of the `motions`, or a weight for each of several of these names.
        frequency : Array (n_frequencies,), optional
            Frequencies [Hz], increasing and above 0. None: `frequencies`.

        Raises
        ------
        SeatrialError
            If the model has no such input (`UnknownName`, which is a KeyError too), if ``inputs`` is neither a name nor
            a dict of weights, or if a frequency is no number above 0.
        """
        f = self._frequencies(frequency)
        found = self.frequency_response(inputs, f)
        moved = [m.frequency_response(inputs, f) for m in self.moved]
        size = self._sizes(inputs)
        bodes = {}
        for name, h in found.items():
            if np.abs(h).max() <= STATIC * size:
                continue
            # The logarithm of a response is that of the gain, plus j times the phase.
            change, none = [np.log(m[name] / h) for m in moved], np.zeros(f.size)
            sd_gain, sd_phase = (
                self.error_of(none, part) for part in ([c.real for c in change], [c.imag for c in change])
            )
            phase = np.unwrap(np.angle(h))
            start = self._lag_start(inputs, name, float(phase[0]))
            bode = Bode(f, np.abs(h), phase, sd_gain, sd_phase, start)
            # A phase of a moved model is counted from that of this model, so that it has no other full turns.
            beside = [
                Bode(f, np.abs(m[name]), phase + c.imag, none, none, start) for m, c in zip(moved, change, strict=True)
            ]
            bodes[name] = bode._replace(
                bandwidth_sd=self._error_of_number(bode.bandwidth, [b.bandwidth for b in beside]),
                lag_90_sd=self._error_of_number(bode.lag_90, [b.lag_90 for b in beside]),
            )
        return NamedValues(bodes, "state that responds")

    def _lag_start(self, inputs: Inputs, state: str, first: float) -> float:
        """Return the phase [rad] from which the lag of a state is counted, given that at the lowest frequency.

        It is a whole number of half turns, such that ``first`` is at most a quarter of a turn above it and less than
        three quarters below.
        """
        row = self.states.index(state)
        slow = self.frequency_response(inputs, self.frequencies[:1])[state][0]
        poles, right = self._modes
        b = sum((w * self.B[:, self.inputs.index(n)] for n, w in self._weights(inputs).items()), np.zeros(len(poles)))
        part = right[row] * (np.linalg.pinv(right) @ b)  # of each pole in the response
        turned = any(
            p.real > 0.0 and p.imag == 0.0 and abs(c / p) > 0.5 * abs(slow) for p, c in zip(poles, part, strict=True)
        )
        start = 0.0 if (slow.real >= 0.0) is not turned else np.pi
        return float(start + 2.0 * np.pi * np.ceil((first - start - 0.5 * np.pi) / (2.0 * np.pi)))

    def error_of(self, value: Array, moved: Sequence[Array]) -> Array:
        """Return the standard errors of a quantity of this model; NaN if the errors of the estimates are unknown.

        Parameters
        ----------
        value : Array
            The quantity of this model.
        moved : sequence of Array
            The same quantity of each of the models `moved`.
        """
        if not moved:
            return np.full(np.shape(value), np.nan)
        found: Array = np.sqrt(np.sum([((m - value) / PARAMETER_STEP) ** 2 for m in moved], axis=0))
        return found

    def _error_of_number(self, value: float, moved: Sequence[float]) -> float:
        """Return the standard error of a number of this model, given that number of each of the models `moved`."""
        return float(self.error_of(np.array(value), [np.array(v) for v in moved]))

    def lqr(
        self, Q: Mapping[str, float], R: Mapping[str, float] | None = None, limit: float | None = None
    ) -> StateFeedback:
        """Return the linear quadratic regulator (LQR) of the model, with the weights of its states by name.

        The feedback minimises the integral of ``sum of Q e^2 + sum of R (u - u0)^2`` over time, with the errors ``e``
        of the states. States that no input changes, such as those of waves, are no part of the feedback: nobody
        measures them, and the other gains do not depend on them. The dead time of the inputs is not part of the design:
        choose poles that are slow beside it. If the rates depend on the heading, as by wind, `by_heading` is part of
        the design. The inputs ``u0`` then hold the course at one heading alone. A `SeatrialWarning` says so if that
        heading was not chosen (``at``).

        Parameters
        ----------
        Q : dict of str to float
            Weights of the states by name, at least 0. A state without a weight, such as that of a shaft, has 0. The
            heading ``psi`` is a further state (the integral of ``r``) if it has a weight above 0.
        R : dict of str to float, optional
            Weights of the inputs by name, above 0. An input without a weight has 1.
        limit : float, optional
            Largest shaft speed or command that the feedback returns, above 0 and at most 1. None: each input stays in
            its range in the fitted data (`ranges`), with zero; without a range the limit is full speed. A
            `SeatrialWarning` is issued if a limit leaves this range, where the thrust is extrapolated, and if an input
            of the operating point is above 0.9 of its limit. No limit acts on inputs that are forces.

        Raises
        ------
        SeatrialError
            If the weights are not given by name, if there is no state or input of a name, if a weight or the limit is
            not allowed, or if no feedback with these weights makes the motion stable.
        """
        return lqr(self, Q, R, limit)

    def responding(self, inputs: Inputs) -> tuple[str, ...]:
        """Return the names of the states that respond to the inputs, in the order of `states`."""
        found, size = self.frequency_response(inputs), self._sizes(inputs)
        return tuple(n for n, h in found.items() if np.abs(h).max() > STATIC * size)

    @property
    def times(self) -> Array:
        """Times (200,) [s] of a step response: four time constants of the slowest pole, 4 s to a minute.

        The dead time is added. An unstable pole ends the response after one of its time constants.
        """
        constants = self.time_constants
        slowest = float(np.abs(constants[np.isfinite(constants)]).max(initial=1.0))
        length = min([LONGEST_S, CONSTANTS * slowest, *(-constants[constants < 0.0])])
        return np.linspace(0.0, length + max(self.delays.values(), default=0.0), TIMES)

    @property
    def frequencies(self) -> Array:
        """Frequencies (300,) [Hz] of a response, from a decade below the slowest pole to one above the fastest.

        Integrators do not count. A dead time counts as a pole with the same time constant for the lowest frequency. The
        highest one is at least three times that at which a dead time and the fastest pole together lag by 90 deg.
        """
        size, delays = np.abs(self.poles), np.array([d for d in self.delays.values() if d > 0.0])
        poles = size[size > STATIC * size.max(initial=0.0)]
        corners = np.concatenate([poles, 1.0 / delays]) if poles.size or delays.size else np.ones(1)
        fastest = poles.max() if poles.size else corners.max()
        # Beyond the pole p, its lag is 90 deg - p / w. A dead time d, whose lag is w d, makes it 90 deg at sqrt(p / d).
        high = max(DECADE * fastest, LAGS * np.sqrt(fastest / delays.min(initial=np.inf)))
        return np.geomspace(corners.min() / DECADE, high, FREQUENCIES) / (2.0 * np.pi)

    def response_times(self, given: ArrayLike | None) -> Array:
        """Return the times (n,) [s] of a step response that the user gives; `times` for None.

        One number is the end of 200 equidistant times from 0 on. SeatrialError is raised if they are not numbers of at
        least 0.
        """
        if given is None:
            return self.times
        found = _numbers("t", given, "times [s], at least 0")
        if (found < 0.0).any():
            raise SeatrialError(f"t {found.min():g} s: give times of at least 0, as the step is at t = 0")
        return np.linspace(0.0, float(found), TIMES) if found.ndim == 0 else found

    def _frequencies(self, given: ArrayLike | None) -> Array:
        """Return frequencies (n,) [Hz] of the user as an array; `frequencies` for None.

        SeatrialError is raised if they are not numbers above 0.
        """
        if given is None:
            return self.frequencies
        found = np.atleast_1d(_numbers("frequency", given, "frequencies [Hz], above 0"))
        if (found <= 0.0).any():
            raise SeatrialError(f"frequency {found.min():g} Hz: give frequencies above 0")
        return found

    @property
    def _modes(self) -> tuple[Complex, Complex]:
        """Eigenvalues (n,) of A in the order of `poles`, and their eigenvectors (n, n) as columns."""
        found, vectors = (a.astype(np.complex128) for a in np.linalg.eig(self.A))
        # The state of the largest participation; rounded, so that a pair of conjugate poles has one state.
        main = np.argmax(np.abs(np.linalg.pinv(vectors) * vectors.T).round(9), axis=1)
        group = np.array([_group_of(self.states[k]) for k in main], dtype=np.int64)
        order = np.lexsort((np.abs(found.real), group))
        return found[order], vectors[:, order]

    def _weights(self, inputs: Inputs) -> dict[str, float]:
        """Return the weight of each input that a name or a mapping of the user stands for.

        Raise `UnknownName` for a name that is no input or motion, and SeatrialError if ``inputs`` is neither a text nor
        a mapping of numbers.
        """
        if not isinstance(inputs, str | Mapping):
            example = f'"{self.inputs[0]}", or weights by name, such as {{"{self.inputs[0]}": 1.0}}'
            raise SeatrialError(f"inputs: give the name of an input, such as {example}, and not {inputs!r:.60}")
        known = {**{n: {n: 1.0} for n in self.inputs}, **self.motions}
        weights: dict[str, float] = {}
        for name, weight in ({inputs: 1.0} if isinstance(inputs, str) else inputs).items():
            if name not in known:
                if name in self.states:
                    text = f"{name!r} is a state, not an input; name an input, and take the item {name!r} of the result"
                    raise UnknownName(f"{text}; the inputs are {', '.join(known)}")
                near = closest_name(MOTION_WORDS.get(name, name), list(known))
                hint = f"did you mean {near!r}? " if near else ""
                raise UnknownName(f"the model has no input {name!r}; {hint}its inputs are {', '.join(known)}")
            if isinstance(weight, bool) or not isinstance(weight, Real):
                raise SeatrialError(f"inputs: the weight of {name} is {weight!r:.60}; give a number, such as 1.0")
            for part, share in known[name].items():
                weights[part] = weights.get(part, 0.0) + weight * share
        return weights

    def _sizes(self, inputs: Inputs) -> float:
        """Return the largest gain of all states to the inputs one by one, with which small responses are compared."""
        alone = [self.frequency_response(n) for n in self._weights(inputs)]
        return max((float(np.abs(h).max()) for found in alone for h in found.values()), default=0.0)

    def __repr__(self) -> str:
        """Return speed, stability, poles and time constants as a few lines of text."""
        lines = [f"<Linearisation at {self.speed:g} m/s, {self.stability_text}>", f"states {', '.join(self.states)}"]
        lines.append(f"inputs {', '.join(f'{n} = {self.operating_point[n]:.4g}' for n in self.inputs)}")
        if self.conditions:
            lines.append(f"taken as constant: {conditions_text(self.conditions)}")
        if words := heading_sentence(self.conditions):
            lines.append(words)
        if words := self.drift:
            lines.append(words)
        if words := self.outside:
            lines.append(f"outside the fitted data: {words}")
        constants, errors = self.time_constants, self.time_constant_errors
        for pole, constant, error, names in zip(self.poles, constants, errors, self.mainly, strict=True):
            lines.append(f"pole {pole_text(pole)} 1/s, {time_text(constant, error)}, mainly {names}")
        return "\n".join(lines)


def _numbers(name: str, values: ArrayLike, what: str) -> Array:
    """Return the values of an argument as an array. Raise SeatrialError if a value is not a finite number.

    The message begins with the ``name`` of the argument, and asks the user for ``what``, such as ``times [s]``.
    """
    try:
        found = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise SeatrialError(f"{name}: give {what}, and not {values!r:.60}") from None
    if found.ndim > 1 or not np.isfinite(found).all():
        raise SeatrialError(f"{name}: give one number or a list of finite numbers: {what}")
    return found


def _response_to_a_step(A: Array, b: Array, since: Array) -> Array:
    """Return the states (n_times, n) of ``dx/dt = A x + b`` at the times ``since`` [s] (n_times,), from zero.

    The state is propagated from each time to the next one with the matrix exponential of their distance. Times at equal
    distances need one exponential. A may be singular.
    """
    from scipy.linalg import expm  # imported here, as it takes 0.3 s

    n = len(A)
    whole = np.zeros((n + 1, n + 1))  # the constant input is a further state
    whole[:n, :n], whole[:n, n] = A, b
    times, place = np.unique(since, return_inverse=True)
    unit = EQUAL_STEPS * max(float(times[-1]), 1e-9) if times.size else 1.0
    known: dict[int, Array] = {0: np.eye(n + 1)}
    states, z = np.zeros((times.size, n)), np.append(np.zeros(n), 1.0)
    for k, step in enumerate(np.diff(times, prepend=0.0)):
        size = round(step / unit)
        if size not in known:
            known[size] = expm(step * whole)
        z = known[size] @ z
        states[k] = z[:n]
    found: Array = states[place.reshape(-1)]
    return found


def side_inputs(names: Sequence[str]) -> list[str]:
    """Return the names of the inputs of the left and the right side; an empty list if one of the sides has none.

    They are shaft speeds or commands (``n_...``) and thrusts (``f_...``).
    """
    sides = [
        n for n in names if n.endswith(("_left", "_right")) and is_of_thruster(n, SHAFT_SPEED, COMMAND, THRUSTER_FORCE)
    ]
    return sides if {n.rpartition("_")[2] for n in sides} == {"left", "right"} else []


def is_shortest_lag(constant: float) -> bool:
    """Return whether a time constant [s] is the shortest one that a lag of the models has.

    A parameter below it, such as T_n = 0, has this pole too: the output of the lag then follows its input more directly
    (`seatrial.ident.models.horizontal.first_order`), and at zero the state of the lag has no part in the motion.
    """
    return any(abs(constant - shortest) < SAME_LAG * shortest for shortest in SHORTEST_LAGS)


def pole_text(pole: complex) -> str:
    """Return a pole as text with four digits: the real part, and the imaginary part with its sign if it is not zero."""
    return f"{pole.real:.4g}" + (f" {pole.imag:+.4g}j" if pole.imag else "")


def time_text(constant: float, error: float) -> str:
    """Return a time constant [s] as text, such as ``time constant 2.1 s``.

    For an unstable pole, the text is the time in which the motion grows by a factor of e. The text says that the
    constant is not determined if its standard error ``error`` [s] is too large, and that the lag may be shorter if it
    is the shortest one of the model.
    """
    if is_undetermined(constant, error):
        return "time constant not determined"
    if is_shortest_lag(constant):
        return f"time constant at most {constant:.4g} s (the shortest lag of the model)"
    return f"grows by a factor of e in {-constant:.4g} s" if constant < 0.0 else f"time constant {constant:.4g} s"


def linearise(
    model: Model,
    speed: float,
    known: ParameterCovariance | None = None,
    conditions: Mapping[str, float] | None = None,
    near: LinearModel | None = None,
) -> LinearModel:
    """Linearise a fitted model about straight motion at a forward speed in still water.

    The operating point is found first: the inputs, the sway speed and the shafts for which speed and yaw rate (zero)
    stay. If one thruster is weaker, the inputs differ. Disturbance forces, sensor errors and states of sensors are left
    out. Delayed copies of an input count as the input itself. Time, work of the thrusters, place and heading are no
    inputs: they are constant. The derivatives by the heading are in `LinearModel.by_heading`, not in A.

    Parameters
    ----------
    model : Model
        The fitted model, with its estimates as values.
    speed : float
        Forward speed through the water [m/s], not zero: at rest the quadratic terms have no slope.
    known : ParameterCovariance, optional
        Covariance of the estimates, for the standard errors of the responses. None: they are NaN.
    conditions : mapping, optional
        Values of ``t``, ``work``, ``x``, ``y`` and ``psi`` by name; a missing one has the default of
        `chosen_conditions`.
    near : LinearModel, optional
        Linear model of the same model at another speed or in other conditions. The search for the operating point
        begins at that one, which takes a fraction of the time.

    Raises
    ------
    SeatrialError
        If the model has no forward speed, if ``speed`` is no number, zero or not finite, if there is no condition of a
        name, or if no operating point is found with shaft speeds and commands (inputs ``n_...``) from -1 to 1. Forces
        have no limit.
    """
    reduced, _ = without_nuisance(model)
    constant = chosen_conditions(reduced, at=conditions)
    rates = Rates(reduced, conditions=constant)
    assumed = tuple(n for n in constant if n not in (conditions or {}))
    if "u" not in rates.names:
        raise SeatrialError(
            f"model {model.name} has no forward speed u among its states, so it has no such operating point; "
            "use a model with u, such as horizontal"
        )
    if not isinstance(speed, Real):
        raise SeatrialError(f"speed {speed!r}: give a number, in m/s, such as 0.5")
    if not np.isfinite(speed) or speed == 0.0:
        raise SeatrialError(f"speed {speed} m/s: give a number other than zero, where the model has a slope")
    x0, u0 = _operating_point(rates, speed, near)
    for name, value in zip(rates.inputs, u0, strict=True):
        if is_of_thruster(name, COMMAND, SHAFT_SPEED) and abs(value) > 1.0:
            raise SeatrialError(
                f"{speed:g} m/s needs {name} = {value:.2f}, more than full; choose a speed that the boat reaches"
            )
    units = {x.name: x.unit for x in reduced.states} | {i.name: i.unit for i in reduced.inputs}
    units = {n: units[n] for n in (*rates.names, *rates.inputs)}

    # the rates at a heading slightly to port and to starboard
    turned = {
        side: Rates(reduced, conditions={**constant, HEADING: constant[HEADING] + side * HEADING_STEP})
        for side in (-1.0, 1.0)
        if HEADING in constant
    }

    def about(x: Array, u: Array, values: Array, moved: tuple[LinearModel, ...] = ()) -> list[LinearModel]:
        """Return the linear models about the states x (n_rows, n) and inputs u (n_rows, m) of each row.

        ``values`` are those of the parameters: (n_parameters,), or (n_rows, n_parameters) with values for each row.
        """
        A, B = (f(x, u, values) for f in (rates.by_states, rates.by_inputs))
        by_heading = np.zeros_like(x)
        for side, beside in turned.items():
            by_heading += side * beside(x, u, values) / (2.0 * HEADING_STEP)
        found = []
        for k, of_row in enumerate(np.broadcast_to(values, (len(x), values.shape[-1]))):
            named = dict(zip(reduced.values, of_row, strict=True))
            delays = {i: float(named["tau_n"]) for i in rates.inputs if "tau_n" in named and i in rates.delayed}
            found.append(LinearModel(
                speed, rates.names, rates.inputs, A[k], B[k], x[k], u[k], delays, units, by_heading[k], moved, constant,
                assumed, at_speed=partial(linearise, model, conditions=constant),
            ))  # fmt: skip
        return found

    def about_the_estimates(moved: tuple[LinearModel, ...] = ()) -> LinearModel:
        """Return the linear model about the operating point, with the values of the parameters that were estimated."""
        (found,) = about(x0[None], u0[None], rates.values, moved)
        return found

    directions = principal_directions(reduced, rates.values, _of_parameters(known, rates.parameters))
    if not directions:
        return about_the_estimates()
    points = _moved_operating_points(rates, x0, u0, np.array(directions))
    if points is None:
        return about_the_estimates()  # the errors are too large for a linear theory
    return about_the_estimates(tuple(about(*points, np.array(directions))))


def sway_slopes(model: Model, speeds: Array, inputs: Array, conditions: Mapping[str, float]) -> Array:
    """Return the derivatives (n_speeds,) [1/s] of the rate of sway by the sway speed, without drift and yaw rate.

    A positive one is a negative damping of sway. The result is empty for a model without speed or sway.

    Parameters
    ----------
    model : Model
        The fitted model, with its estimates as values.
    speeds : Array (n_speeds,)
        Forward speeds through the water [m/s].
    inputs : Array (n_speeds, m)
        Inputs at each speed, in the order of those of a `LinearModel`.
    conditions : mapping
        Constant values of time, work, place and heading by name.
    """
    rates = Rates(without_nuisance(model)[0], conditions=conditions)
    if not {"u", "v"} <= set(rates.names):
        return np.zeros(0)
    x, v = np.zeros((len(speeds), len(rates.names))), rates.names.index("v")
    x[:, rates.names.index("u")] = speeds
    found: Array = rates.by_states(x, inputs)[:, v, v]
    return found


def _of_parameters(known: ParameterCovariance | None, parameters: tuple[str, ...]) -> ParameterCovariance | None:
    """Return the part of a covariance that belongs to ``parameters`` and is finite; None if it is unknown."""
    if known is None or known.covariance is None:
        return None
    kept = [k for k, n in enumerate(known.names) if n in parameters and known.covariance[k, k] > 0.0]
    return ParameterCovariance(tuple(known.names[k] for k in kept), known.covariance[np.ix_(kept, kept)])


def _moved_operating_points(rates: Rates, x0: Array, u0: Array, values: Array) -> tuple[Array, Array] | None:
    """Return states (n_rows, n) and inputs (n_rows, m) that keep the speed of x0 (n,), u0 (m,) with other parameters.

    Each row of ``values`` (n_rows, n_parameters) has slightly other values of the parameters. It is Newton's method
    from x0 and u0, with the smallest change of inputs and free states if there are more of them than rates. None if a
    rate above 1e-6 (in the unit of its state per second) remains.
    """
    free = [k for k, name in enumerate(rates.names) if name not in ("u", "r")]
    x, u = np.tile(x0, (len(values), 1)), np.tile(u0, (len(values), 1))
    for _ in range(CORRECTIONS):
        slopes = np.concatenate([rates.by_states(x, u, values)[:, :, free], rates.by_inputs(x, u, values)], axis=2)
        left = -rates(x, u, values)
        for k, (slope, rest) in enumerate(zip(slopes, left, strict=True)):
            change = np.linalg.lstsq(slope, rest, rcond=None)[0]
            x[k, free] += change[: len(free)]
            u[k] += change[len(free) :]
    remaining = np.abs(rates(x, u, values))
    return (x, u) if remaining.max(initial=0.0) < BALANCED else None


def _operating_point(rates: Rates, speed: float, near: LinearModel | None = None) -> tuple[Array, Array]:
    """Return the states (n,) and inputs (m,) that keep straight motion at a forward speed [m/s] through the water.

    The surge speed has this value and the yaw rate is zero; the other states and the inputs are found by least squares
    of the rates. Values of numerical noise are zero. The limits of the inputs are not checked. If there are several
    such points, it is one of them: if possible the one to which the search from the operating point of the linear model
    ``near`` leads.

    Raises
    ------
    SeatrialError
        If a rate above 1e-6 (in the unit of its state per second) remains.
    """
    from scipy.optimize import least_squares  # imported here, as it takes half a second

    m = len(rates.inputs)
    held = {"u": speed, "r": 0.0}
    free = [k for k, name in enumerate(rates.names) if name not in held]

    def unpacked(z: Array) -> tuple[Array, Array]:
        """Return the states (n,) and the inputs (m,) that the unknowns ``z`` stand for.

        ``z`` has the states that are not held, then the inputs. Held are the surge speed, ``speed``, and the yaw rate,
        which is zero.
        """
        x = np.array([held.get(name, 0.0) for name in rates.names])
        x[free] = z[: len(free)]
        return x, z[len(free) :]

    def residuals(z: Array) -> Array:
        """Return the rates (n,) at the unknowns ``z``."""
        x, u = unpacked(z)
        found: Array = rates(x[None], u[None])[0]
        return found

    def slopes(z: Array) -> Array:
        """Return the derivatives (n, n_unknowns) of the rates by the unknowns ``z``."""
        x, u = unpacked(z)
        return np.hstack([rates.by_states(x[None], u[None])[0][:, free], rates.by_inputs(x[None], u[None])[0]])

    best: Array | None = None
    smallest = np.inf
    # The search starts with all free states at zero, then at their initial means: a towed line at zero is slack, and a
    # small change of it changes no rate. With wind, the boat may drift to a side.
    begins = [np.zeros(len(free)), *([rates.initial[free]] if rates.initial[free].any() else [])]
    drifting = np.array([rates.names[k] == "v" for k in free], dtype=float)
    begins += [part * abs(speed) * drifting for part in DRIFTS] if drifting.any() else []
    starts = []
    if near is not None:  # drift and inputs are nearly proportional to the speed
        starts = [np.concatenate([near.x0[free], near.u0]) * abs(speed / near.speed)]
    for begin, size in product(begins, TRIALS):
        start = np.concatenate([begin, np.full(m, np.copysign(size, speed))])
        start[: len(free)] += [start[-1] if is_of_thruster(rates.names[k], SHAFT_SPEED) else 0.0 for k in free]
        starts.append(start)
    for start in starts:
        found = least_squares(residuals, start, slopes, xtol=1e-14, ftol=1e-14, gtol=1e-14)
        if np.abs(found.fun).max(initial=0.0) < smallest:
            smallest, best = float(np.abs(found.fun).max(initial=0.0)), found.x
        if smallest < SOLVED:
            break
    if best is None or smallest > BALANCED:
        unbalanced = "a state" if best is None else rates.names[int(np.argmax(np.abs(residuals(best))))]
        raise SeatrialError(
            f"no inputs keep straight motion at {speed:g} m/s: the rate of {unbalanced} is still {smallest:.2g} per "
            "second; choose another speed, or another heading if the model depends on it (at={'psi': ...})"
        )
    # The search ends with numerical noise where the solution is zero, such as the sway speed without wind.
    cleaned = np.where(np.abs(best) < NOISE, 0.0, best)
    if np.abs(residuals(cleaned)).max(initial=0.0) <= max(smallest, SOLVED):
        best = cleaned
    return unpacked(best)
