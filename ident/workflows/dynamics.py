"""Steady motion, poles, step and frequency responses of a fitted vehicle model, for its result and its report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

import msgspec
import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.ident.data import TIME_INPUT, WORK_INPUT
from seatrial.ident.estimation import Fit, FittedModel, ParameterCovariance
from seatrial.ident.export import (
    LinearModel,
    chosen_conditions,
    linearise,
    side_inputs,
    steady_motion,
    straight_motion,
    sway_slopes,
    turn_sentence,
)
from seatrial.ident.model import COMMAND, SHAFT_SPEED, Model, ModelKind, is_of_thruster
from seatrial.ident.numerics import Array
from seatrial.ident.results import (
    CourseStability,
    Dynamics,
    FrequencyResponse,
    HeadingPoint,
    OperatingPoint,
    SteadyCurve,
    StepResponse,
    finite,
)
from seatrial.ident.workflows.output import validity

POINTS = 41  # of a steady curve
MEANS = (0.0, 0.5)  # means of both sides in turns, as parts of the largest command
LEAST_GAIN = 0.01  # of the largest difference of both sides: a further mean with a smaller gain is not worth a curve
LEAST_DISTANCE = 0.02  # of the largest command, between the means of two curves: nearer curves are nearly the same
SPEEDS = (0.25, 0.5, 0.75, 1.0)  # speeds of the linear models, as parts of the largest steady speed
COURSE_SHARE = 0.75  # speed at which the stability on course is reported, as a part of the highest one in the data
SPEEDS_OF_DAMPING = 101  # speeds at which the damping of sway is computed
BEYOND = 1e-3  # of the range of the commands: a side that is less beyond the data counts as inside
RANGE_STEPS = 4  # largest number of searches for the range of the mean command in which both sides are in the data
COMMAND_STEP = 0.1  # size of the steps of the command, as a part of the largest command
Z95 = 1.96  # half the width of a 95 % interval in standard errors
UNKNOWN_GAIN = float(np.log(np.sqrt(2.0)))  # standard error of the logarithm of a gain that is unknown: 3 dB
HEADINGS = 8  # headings on which the straight course of a boat in wind is computed
UNITS = {"u": "m/s", "v": "m/s", "r": "rad/s"}


def dynamics_of(fitted: FittedModel) -> Dynamics | None:
    """Return steady motion, poles, step responses and frequency responses of a fitted vehicle model.

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
    if model.kind is not ModelKind.VEHICLE or not fit.converged or not {s.name for s in model.states} & {"u", "r"}:
        return None
    ranges, known = validity(fitted), covariance_of(fit)
    conditions = chosen_conditions(model, ranges)
    curves = steady_curves(model, ranges, known, conditions=conditions)
    reached = [np.nanmax(c.value) for c in curves if c.motion == "straight"]
    linear = _linear_models(model, _operating_speeds(float(reached[0])), known, conditions) if reached else []
    if not curves and not linear:
        return None
    drives, steps, responses = Drives(model, ranges), list[StepResponse](), list[FrequencyResponse]()
    course, headings = None, list[HeadingPoint]()
    if linear:
        middle = linear[(len(linear) - 1) // 2]
        steps, responses = _steps(middle, drives), _responses(middle, drives)
        course = _course_by_rule(model, ranges, known, conditions, linear)
        if "psi" in conditions:
            at, angles = [x.speed for x in linear], (2.0 * np.pi * k / HEADINGS for k in range(HEADINGS))
            by_heading, beside = dict[float, list[LinearModel]](), linear
            for psi in angles:
                beside = by_heading[psi] = _linear_models(model, at, None, {**conditions, "psi": psi}, beside)
            headings = [
                HeadingPoint(heading=psi, speed=x.speed, inputs=_inputs_of(x))
                for psi, found in by_heading.items()
                for x in found
                if x.speed == middle.speed
            ]
            if _differ_by_heading(headings):
                share = None if course is None else course.share
                if course is not None and share is not None:
                    by_heading = {
                        psi: _linear_models(model, [course.speed], None, {**conditions, "psi": psi}, found)
                        for psi, found in by_heading.items()
                    }
                worst = _worst_course(model, by_heading, known, conditions, ranges.get("u"))
                course = course if worst is None else msgspec.structs.replace(worst, share=share)
            else:  # for example a wind of nearly zero
                headings = []
        if course is not None:
            lowest = _negative_sway_damping_from(model, linear, ranges.get("u"), conditions)
            course = msgspec.structs.replace(course, sway_from=lowest)
    return Dynamics(
        steady=tuple(curves), points=tuple(_point(x) for x in linear), steps=tuple(steps), responses=tuple(responses),
        delays=dict(linear[0].delays) if linear else {}, conditions=conditions, speeds=ranges.get("u"), ranges=ranges,
        course=course, headings=tuple(headings),
    )  # fmt: skip


def course_at_speeds(model: Model, ranges: Mapping[str, tuple[float, float]]) -> CourseStability | None:
    """Return the pole of sway and yaw of a model, at the same speed as `dynamics_of`, without a 95 % interval.

    Parameters
    ----------
    model : Model
        The fitted model.
    ranges : mapping
        Range of each signal in the fitted data by name, that of the forward speed ``u`` [m/s] among them.

    Returns
    -------
    CourseStability or None
        None for a bench model, without a range of ``u`` above zero, or if no linear model has a pole of sway and yaw.
    """
    fastest = ranges.get("u", (0.0, 0.0))[1]
    if model.kind is not ModelKind.VEHICLE or fastest <= 0.0:
        return None
    conditions = chosen_conditions(model, ranges)
    linear = _linear_models(model, _operating_speeds(fastest), None, conditions)
    return _course_by_rule(model, ranges, None, conditions, linear) if linear else None


def _course_by_rule(
    model: Model,
    ranges: Mapping[str, tuple[float, float]],
    known: ParameterCovariance | None,
    conditions: Mapping[str, float],
    linear: Sequence[LinearModel],
) -> CourseStability | None:
    """Return the least stable pole of sway and yaw at three quarters of the highest speed ahead in the data.

    This speed is nearly the same for all fits to nearly the same data, which a speed is not that the model gives.
    Without a linear model there, or if the data have no speed ahead, the least stable pole of the models ``linear`` is
    returned, and its ``share`` is None.

    Parameters
    ----------
    model
        The fitted model.
    ranges
        Range of each signal in the data by name, that of the forward speed ``u`` [m/s] among them.
    known
        Covariance of the estimates; None: without a 95 % interval.
    conditions
        Conditions of the model.
    linear
        Linear models at other speeds, near which the operating point is searched.
    """
    speed = float(f"{COURSE_SHARE * max(ranges.get('u', (0.0, 0.0))[1], 0.0):.2g}")
    own = _linear_models(model, [speed], known, conditions, linear) if speed > 0.0 else []
    if (course := _course_stability(own, None)) is not None:
        return msgspec.structs.replace(course, share=COURSE_SHARE)
    return _course_stability(linear, ranges.get("u"))


def _differ_by_heading(headings: Sequence[HeadingPoint]) -> bool:
    """Return whether a straight course needs other inputs on another heading, by more than 1 % of the largest."""
    inputs = np.array([list(point.inputs.values()) for point in headings])
    return inputs.size > 0 and bool(np.any(np.ptp(inputs, axis=0) > 0.01 * np.abs(inputs).max()))


def _course_stability(linear: Sequence[LinearModel], speeds: tuple[float, float] | None) -> CourseStability | None:
    """Return the least stable pole of sway and yaw of a model at the speeds of its data, with its 95 % interval.

    Parameters
    ----------
    linear : sequence of LinearModel
        Linear models with standard errors at several speeds. Those outside ``speeds`` are left out, unless all are.
    speeds : tuple of float or None
        Smallest and largest forward speed in the data [m/s]; None: unknown, so that all linear models count.

    Returns
    -------
    CourseStability or None
        None if no linear model has a pole of sway and yaw.
    """
    low, high = speeds or (-np.inf, np.inf)
    inside = [x for x in linear if low <= x.speed <= high] or linear
    found = [(float(x.poles[k].real), x.speed, k, x) for x in inside if (k := x.course_pole) is not None]
    if not found:
        return None
    _, _, k, at = max(found, key=lambda row: row[:2])
    real, half = float(at.poles[k].real), Z95 * float(at.pole_errors[k])
    v = at.states.index("v") if "v" in at.states else None
    sway = None if v is None else float(at.A[v, v])
    return CourseStability(speed=at.speed, pole=real, low=finite(real - half), high=finite(real + half), sway=sway)


def _worst_course(
    model: Model,
    by_heading: Mapping[float, Sequence[LinearModel]],
    known: ParameterCovariance,
    conditions: Mapping[str, float],
    speeds: tuple[float, float] | None,
) -> CourseStability | None:
    """Return the least stable pole of sway and yaw over all headings, with the heading and its 95 % interval.

    Parameters
    ----------
    model
        The fitted model.
    by_heading
        Linear models by heading [rad]; standard errors are not needed.
    known
        Covariance of the estimates.
    conditions
        Conditions of the model.
    speeds
        Smallest and largest forward speed in the data [m/s].
    """
    courses = [(psi, _course_stability(linear, speeds)) for psi, linear in by_heading.items()]
    found = [(course.pole, psi, course.speed) for psi, course in courses if course is not None]
    if not found:
        return None
    _, psi, speed = max(found)
    worst = _linear_models(model, [speed], known, {**conditions, "psi": psi}, by_heading[psi])
    course = _course_stability(worst, None)
    return None if course is None else msgspec.structs.replace(course, heading=psi)


def _negative_sway_damping_from(
    model: Model,
    linear: Sequence[LinearModel],
    speeds: tuple[float, float] | None,
    conditions: Mapping[str, float],
) -> float | None:
    """Return the lowest forward speed [m/s] at which the damping of sway is negative without drift; None if at none.

    The speeds are those of the data, to the largest one of the linear models ``linear``. Each has the inputs of the
    linear model whose speed is nearest. With drift, as in wind, the quadratic damping of sway adds to the linear one,
    so that the poles may be stable all the same.
    """
    if speeds is None:
        return None
    own = np.array([x.speed for x in linear])
    forward = np.linspace(max(speeds[0], 0.0), min(speeds[1], own.max()), SPEEDS_OF_DAMPING)
    inputs = np.array([linear[int(np.argmin(np.abs(own - speed)))].u0 for speed in forward])
    negative = forward[sway_slopes(model, forward, inputs, conditions) > 0.0]
    return float(negative[0]) if negative.size else None


def covariance_of(fit: Fit) -> ParameterCovariance:
    """Return the covariance of the estimates of a fit, without those that have no standard error."""
    known = np.flatnonzero(np.isfinite(np.diag(fit.covariance)))
    return ParameterCovariance(tuple(fit.names[k] for k in known), np.asarray(fit.covariance)[np.ix_(known, known)])


def steady_curves(
    model: Model,
    ranges: Mapping[str, tuple[float, float]],
    known: ParameterCovariance,
    means: Sequence[float] | None = None,
    points: int = POINTS,
    conditions: Mapping[str, float] | None = None,
) -> list[SteadyCurve]:
    """Return the steady speed on a straight course, and the steady turn rate, of a vehicle model over its commands.

    Two sides hold the straight course: their difference is that at which the boat does not turn, and their mean is the
    command. A mean at which a side would be beyond the data is left out.

    Parameters
    ----------
    model : Model
        The model, with its estimates as values.
    ranges : mapping
        Smallest and largest value of each input in the data, by name. The curves are limited to them.
    known : ParameterCovariance
        Covariance of the estimates.
    means : sequence of float, optional
        Means of both sides in turns, as parts of the largest command. None: zero, half of the largest command, and the
        mean with the largest difference of both sides in the data, if it is clearly another one.
    points : int
        Number of commands of each curve, which are evenly spaced. The curve of the speed has zero in addition.
    conditions : mapping, optional
        Constant values of time, work, place and heading by name. None: those of the end of the data (``ranges``).

    Returns
    -------
    list of SteadyCurve
        The curve of the speed, then one of the turn rate for each mean. A curve with fewer than three steady motions is
        left out. A model that depends on heading or place has no curve of the turn rate, as a turning boat keeps
        neither of them. The list is empty without a range of the commands, and if the rates of a user-defined model are
        not defined at them.
    """
    states, drives = {s.name for s in model.states}, Drives(model, ranges)
    if not drives.names:
        return []
    curves: list[SteadyCurve] = []
    try:
        held = chosen_conditions(model, ranges) if conditions is None else conditions
        if "u" in states:
            curves.append(_straight(model, known, drives, points, held))
        if "r" in states and drives.two_sided and not turn_sentence(held):
            chosen = drives.means() if means is None else [part * drives.high for part in means]
            curves += [_turn(model, known, drives, mean, points, held) for mean in chosen]
    except (ArithmeticError, np.linalg.LinAlgError, TypeError, ValueError):
        return []
    return [c for c in curves if np.isfinite(c.value).sum() > 2]


class Drives:
    """Inputs of a model that drive the boat, and their range in the data.

    Attributes
    ----------
    names : list of str
        Names of all inputs of the model without delayed copies, time and work. Empty if none of them drives the boat,
        or if the range of one that drives it is unknown.
    low, high : float
        Common range of the driving inputs in the data; of shaft speeds and commands only the part from -1 to 1.
    left, right : tuple of float
        Range of the inputs of each side, likewise. Of a single input both are its range.
    two_sided : bool
        Whether there are inputs of a left and of a right side.
    driving : tuple of str
        Names of the driving inputs.
    """

    def __init__(self, model: Model, ranges: Mapping[str, tuple[float, float]]) -> None:
        """Find the driving inputs: those of both sides, or the only input. Others stay in the middle of their range."""
        names = [i.name for i in model.inputs if not i.tap and i.name not in (TIME_INPUT, WORK_INPUT)]
        sides = side_inputs(names)
        self.two_sided = bool(sides)
        chosen = sides or (names if len(names) == 1 else [])
        known = {n: ranges[n] for n in chosen if n in ranges}
        self.driving = tuple(chosen)
        self.names = names if chosen and len(known) == len(chosen) else []
        if all(is_of_thruster(n, COMMAND, SHAFT_SPEED) for n in chosen):
            # A shaft can turn a little faster than full speed.
            known = {n: (max(a, -1.0), min(b, 1.0)) for n, (a, b) in known.items()}
        self.low, self.high = _common(known.values())
        self.left = _common(of for n, of in known.items() if not n.endswith("_right"))
        self.right = _common(of for n, of in known.items() if not n.endswith("_left"))
        self._constant = {n: float(np.mean(ranges.get(n, (0.0, 0.0)))) for n in names if n not in chosen}

    def reach(self, mean: float) -> tuple[float, float]:
        """Return the smallest and the largest half difference, left less right, of both sides with this mean.

        The range of each side is its own: the data may have thrust astern on one side only.
        """
        ends = max(self.left[0] - mean, mean - self.right[1]), min(self.left[1] - mean, mean - self.right[0])
        return min(ends[0], 0.0), max(ends[1], 0.0)

    def means(self) -> list[float]:
        """Return the means of both sides for the curves of turns: zero, half of the largest command, and the widest.

        The widest is the mean of one side at its largest and the other side at its smallest value, where both differ
        most. It is left out if the other two means have as large a difference, or if it is so near one
        of them that both curves are nearly the same.
        """
        found = [part * self.high for part in MEANS]
        widest = max((0.5 * (self.left[1] + self.right[0]), 0.5 * (self.left[0] + self.right[1])), key=self._largest)
        gained = self._largest(widest) > (1.0 + LEAST_GAIN) * max(map(self._largest, found))
        apart = min(abs(mean - widest) for mean in found) > LEAST_DISTANCE * self.high
        return [*found, widest] if gained and apart else found

    def _largest(self, mean: float) -> float:
        """Return the largest half difference of both sides with this mean, in either direction."""
        low, high = self.reach(mean)
        return max(-low, high)

    def beyond(self, mean: Array, difference: Array) -> Array:
        """Return how far the inputs of a mean and a half difference (n,) are beyond the data; negative inside."""
        sides = (mean + difference, self.left), (mean - difference, self.right)
        beyond: Array = np.max([d for n, (low, high) in sides for d in (low - n, n - high)], axis=0)
        return beyond

    def inputs(self, left: Array, right: Array) -> Array:
        """Return the inputs (n_rows, m) of the model for the commands of both sides (n_rows,)."""
        columns = [
            np.full(left.shape, self._constant[n]) if n in self._constant else right if n.endswith("_right") else left
            for n in self.names
        ]
        return np.stack(columns, axis=1)


def _common(ranges: Iterable[tuple[float, float]]) -> tuple[float, float]:
    """Return the range that all ranges contain, as (low, high); zeros without any."""
    found = list(ranges)
    return max((a for a, _ in found), default=0.0), min((b for _, b in found), default=0.0)


def _straight(
    model: Model, known: ParameterCovariance, drives: Drives, points: int, conditions: Mapping[str, float]
) -> SteadyCurve:
    """Return the steady forward speed over the mean command of both sides, whose difference holds the course.

    A model without two sides, or without yaw rate, has sway and yaw rate held at zero.
    """
    zero = [0.0] if drives.low < 0.0 < drives.high else []
    command = np.union1d(np.linspace(drives.low, drives.high, points), zero)
    states = {s.name for s in model.states}
    if not (drives.two_sided and "r" in states):
        held = tuple(n for n in ("v", "r") if n in states)
        u = drives.inputs(command, command)
        value, sd = steady_motion(model, u, known.names, known.covariance, held, conditions).of("u")
        return SteadyCurve(
            motion="straight", quantity="u", unit="m/s", inputs=drives.driving, command=command, value=value, sd=sd
        )
    turning = drives.inputs(np.array([2.0]), np.array([0.0]))[0] - drives.inputs(np.array([1.0]), np.array([1.0]))[0]
    for _ in range(RANGE_STEPS):
        u = drives.inputs(command, command)
        found = straight_motion(model, u, turning, known.names, known.covariance, conditions)
        beyond = drives.beyond(command, found.difference)
        if not np.any(beyond > BEYOND * (drives.high - drives.low)):
            break
        low, high = _range_inside(command, beyond)
        command = np.union1d(np.linspace(low, high, points), zero if low < 0.0 < high else [])
    outside = drives.beyond(command, found.difference) > 10.0 * BEYOND * (drives.high - drives.low)
    values = (np.where(outside, np.nan, a) for a in (found.speed, found.sd, found.difference, found.growth))
    value, sd, difference, growth = values
    return SteadyCurve(
        motion="straight", quantity="u", unit="m/s", inputs=drives.driving, command=command, value=value, sd=sd,
        difference=difference, growth=growth,
    )  # fmt: skip


def _range_inside(command: Array, beyond: Array) -> tuple[float, float]:
    """Return the range of the mean commands at which both sides are within the data.

    ``beyond`` (n,): how far the sides are beyond the data (`Drives.beyond`), NaN where it is unknown. The ends are
    interpolated. Without a command inside, the range is that of all commands.
    """
    inside = np.flatnonzero(beyond <= 0.0)
    if not inside.size:
        return float(command[0]), float(command[-1])
    ends = []
    for k, after in ((inside[0], inside[0] - 1), (inside[-1], inside[-1] + 1)):
        end = float(command[k])
        if 0 <= after < command.size and beyond[after] > 0.0:
            end += float((command[after] - command[k]) * -beyond[k] / (beyond[after] - beyond[k]))
        ends.append(end)
    return ends[0], ends[1]


def _turn(
    model: Model, known: ParameterCovariance, drives: Drives, mean: float, points: int, conditions: Mapping[str, float]
) -> SteadyCurve:
    """Return the steady yaw rate over half the difference of both sides, whose mean is ``mean``."""
    low, high = drives.reach(mean)
    command = np.linspace(low, high, points)
    u = drives.inputs(mean + command, mean - command)
    value, sd = steady_motion(model, u, known.names, known.covariance, conditions=conditions).of("r")
    return SteadyCurve(
        motion="turn", quantity="r", unit="rad/s", inputs=drives.driving, mean=mean, command=command, value=value, sd=sd
    )


def _operating_speeds(fastest: float) -> list[float]:
    """Return the speeds [m/s] of the linear models: parts of the speed ``fastest``, to two digits."""
    return [
        float(f"{part * fastest:.2g}") if part < 1.0 else float(np.floor(fastest * 100.0) / 100.0) for part in SPEEDS
    ]


def _linear_models(
    model: Model,
    speeds: Sequence[float],
    known: ParameterCovariance | None,
    conditions: Mapping[str, float],
    beside: Sequence[LinearModel] = (),
) -> list[LinearModel]:
    """Return the linear models at these speeds [m/s]. A speed without one is left out.

    Their standard errors are from the covariance ``known`` of the estimates; None: they have no standard errors.
    ``beside`` are linear models in other conditions, near which the operating points are searched.
    """
    found: list[LinearModel] = []
    for speed in speeds:
        near = min((*beside, *found[-1:]), key=lambda x: abs(x.speed - speed), default=None)
        try:
            found.append(linearise(model, speed, known, conditions, near))
        except (SeatrialError, ArithmeticError, np.linalg.LinAlgError, TypeError, ValueError):
            continue
    return found


def _inputs_of(linear: LinearModel) -> dict[str, float]:
    """Return the inputs of the operating point of a linear model, by name."""
    return {name: float(value) for name, value in zip(linear.inputs, linear.u0, strict=True)}


def _point(linear: LinearModel) -> OperatingPoint:
    """Return the operating point of a linear model with its poles, for the result."""
    poles = linear.poles
    return OperatingPoint(
        speed=linear.speed,
        inputs=_inputs_of(linear),
        real=poles.real,
        imaginary=poles.imag,
        stable=linear.stable,
        error=linear.pole_errors,
        states={name: float(value) for name, value in zip(linear.states, linear.x0, strict=True)},
        mainly=linear.mainly,
    )


def _steps(linear: LinearModel, drives: Drives) -> list[StepResponse]:
    """Return the responses of speed (to a step of both sides) and of yaw rate and sway (to one of their difference).

    A model without two sides has only the response of speed.
    """
    t, size, found = linear.times, COMMAND_STEP * drives.high, []
    for motion, quantities, weights in _motions(linear, drives):
        response, moved = linear.step_response(weights, t), [m.step_response(weights, t) for m in linear.moved]
        for quantity in quantities:
            sd = size * linear.error_of(response[quantity], [m[quantity] for m in moved])
            found.append(
                StepResponse(
                    speed=linear.speed, motion=motion, step=size, quantity=quantity, unit=UNITS[quantity], t=t,
                    value=size * response[quantity], sd=sd if linear.moved else None,
                )
            )  # fmt: skip
    return found


def _responses(linear: LinearModel, drives: Drives) -> list[FrequencyResponse]:
    """Return the frequency responses of speed (to the command of both sides) and of yaw rate (to their difference).

    A model without two sides has only the response of speed. The bandwidth is left out if the gain of slow commands,
    with which it is compared, has a standard error above 3 dB: a boat that hardly holds its course turns so slowly to
    its steady rate that the data do not contain it. Of turns of an unstable boat, the bandwidth is left out.
    """
    found = []
    for motion, (quantity, *_), weights in _motions(linear, drives):
        bode = linear.bode(weights).get(quantity)
        if bode is None:
            continue
        unit, command = UNITS[quantity], linear.units[next(iter(weights))]
        settles = linear.stable or motion == "straight"
        slow_gain_is_known = not bode.gain_sd[0] > UNKNOWN_GAIN  # NaN, without standard errors, counts as known
        band = (bode.bandwidth, bode.bandwidth_sd) if settles and slow_gain_is_known else (None, None)
        found.append(
            FrequencyResponse(
                speed=linear.speed, motion=motion, quantity=quantity, unit=f"{unit}/{command}" if command else unit,
                stable=linear.stable, frequency=bode.frequency, gain=bode.gain, gain_sd=bode.gain_sd, phase=bode.phase,
                phase_sd=bode.phase_sd, bandwidth=finite(band[0]), bandwidth_sd=finite(band[1]),
                lag_90=finite(bode.lag_90), lag_90_sd=finite(bode.lag_90_sd),
            )
        )  # fmt: skip
    return found


def _motions(
    linear: LinearModel, drives: Drives
) -> list[tuple[Literal["straight", "turn"], tuple[str, ...], dict[str, float]]]:
    """Return name, quantities and weight of each input of the motions by the driving inputs: straight, and turn.

    A motion of which the model has no quantity is left out, and turn without two sides.
    """
    weights = linear.motions
    ahead = weights.get("straight") or {n: 1.0 for n in drives.driving if n in linear.inputs}
    turning = weights.get("turn", {})
    straight = tuple(q for q in ("u",) if q in linear.states and ahead)
    turn = tuple(q for q in ("r", "v") if q in linear.states and turning)
    return [x for x in (("straight", straight, ahead), ("turn", turn, turning)) if x[1]]
