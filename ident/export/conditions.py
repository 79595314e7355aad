"""Conditions that a linear model and a steady motion take as constant: time, work of the thrusters, place and heading.

Some effects depend on them: a payload shifts at a time, a battery sags with the work, a bank acts at a place, and wind
acts from a direction. They are no inputs of a controller. The rates of velocities and shafts are therefore evaluated at
constant values of them. States of sensors, such as a filter of a compass, are no part of the motion, and what they
depend on is no condition.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from math import atan2, degrees
from operator import is_
from typing import NamedTuple

from seatrial.daq.errors import SeatrialError, closest_name
from seatrial.ident.data import TIME_INPUT, WORK_INPUT
from seatrial.ident.estimation import leaves_validity
from seatrial.ident.model import Model

COMPUTED = (TIME_INPUT, WORK_INPUT)  # inputs that no user of a model provides
POSE = ("x", "y", "psi")  # integrals of the velocities
UNITS = {TIME_INPUT: "s", WORK_INPUT: "", "x": "m", "y": "m", "psi": "rad"}
VELOCITIES = {"u": ("speed", "m/s"), "v": ("sway", "m/s"), "r": ("yaw rate", "rad/s")}  # their words and units
LEAST_DRIFT_DEG = 1.0  # drift angle of an operating point from which it is described [deg]
AFTER_S = 10.0  # time after the last change of a model at which it is evaluated without a range of the time [s]


class Dependence(NamedTuple):
    """What the motion of a model depends on, from the symbols in its rates.

    Attributes
    ----------
    states : tuple of str
        Dynamic states on which the velocities depend, the velocities included, in the order of the model.
    conditions : tuple of str
        Conditions on which the rates of these states depend, in the order of `UNITS`.
    """

    states: tuple[str, ...]
    conditions: tuple[str, ...]


def moving_states(model: Model) -> tuple[str, ...]:
    """Return the names of the states of the motion: the velocities, and all states on which these depend.

    Such states are those of shafts, thrusts, lags and forces. The position and the heading are not among them, and
    neither are states that only act on outputs or on the position, such as the filter of a compass or a current. A
    model without the velocities ``u``, ``v`` and ``r`` keeps all its states. A coefficient of zero counts.
    """
    return _dependence(model).states


def conditions_of(model: Model) -> tuple[str, ...]:
    """Return the names of the conditions on which the rates of the states of the motion depend (`moving_states`).

    They are among the inputs ``t`` and ``work`` and the states ``x``, ``y`` and ``psi``, in this order. The names are
    those of the equations: a coefficient of zero counts, too.
    """
    return _dependence(model).conditions


def _dependence(model: Model) -> Dependence:
    """Return the states and conditions on which the motion of a model depends. The last results are stored."""
    parts = (model.states, model.inputs, model.parameters)
    equations = tuple(tuple(v.name for v in part) for part in parts)
    functions = (*model.stages, *model.effects)
    for names, used, found in tuple(_known):
        if names == equations and len(used) == len(functions) and all(map(is_, used, functions)):
            return found
    found = _found_dependence(model)
    _known.append((equations, functions, found))
    return found


# Dependences found last, by the names and the functions of the equations. The models of one fit, which differ in their
# values, have the same.
_known: deque[tuple[tuple[tuple[str, ...], ...], tuple[object, ...], Dependence]] = deque(maxlen=8)


def _found_dependence(model: Model) -> Dependence:
    """Find the states and conditions on which the motion of a model depends, by the symbols in its rates."""
    import casadi as ca  # imported here, because reports only need the texts

    parts = (("x", model.states), ("u", model.inputs), ("p", model.parameters))
    symbols = [[ca.SX.sym(f"{kind}{i}") for i in range(len(part))] for kind, part in parts]
    s = model.signals(*symbols)
    state = {x.name: v for x, v in zip(model.states, symbols[0], strict=True)}
    dynamic = [n for n in state if n not in POSE]
    moving = {n for n in dynamic if n in VELOCITIES} or set(dynamic)
    added = moving
    while added:  # the states on which the last ones depend
        rates = ca.vertcat(*(ca.SX(s.rate[n]) for n in dynamic if n in added))
        added = {n for n in dynamic if n not in moving and ca.depends_on(rates, state[n])}
        moving = moving | added
    rates = ca.vertcat(*(ca.SX(s.rate[n]) for n in dynamic if n in moving))
    known = {i.name: v for i, v in zip(model.inputs, symbols[1], strict=True) if i.name in COMPUTED}
    known |= {n: v for n, v in state.items() if n in POSE}
    found = tuple(n for n in UNITS if n in known and ca.depends_on(rates, known[n]))
    return Dependence(tuple(n for n in dynamic if n in moving), found)


def chosen_conditions(
    model: Model, ranges: Mapping[str, tuple[float, float]] | None = None, at: Mapping[str, float] | None = None
) -> dict[str, float]:
    """Return the values of the conditions on which the motion of a model depends (`conditions_of`).

    Parameters
    ----------
    model : Model
        The model.
    ranges : mapping, optional
        Range of each signal in the fitted data by name. The default of ``t`` and ``work`` is the end of their range, so
        that the model is that after all changes. Without a range of the time, it is 10 s after the last change of the
        model (``t_shift``), and without a change it is zero. Without a range of the work, that is zero.
    at : mapping, optional
        Values that replace the defaults, by name. The defaults of place and heading are zero: the origin, and north.

    Raises
    ------
    SeatrialError
        If ``at`` has another name, or a value that is not finite. A condition on which the model does not depend is
        accepted and has no effect.
    """
    given = dict(at or {})
    for name, value in given.items():
        if name not in UNITS:
            near = closest_name(name, UNITS)
            hint = f"did you mean {near!r}? " if near else ""
            raise SeatrialError(f"there is no condition {name!r}; {hint}the conditions are {', '.join(UNITS)}")
        if not abs(value) < float("inf"):
            raise SeatrialError(f"the condition {name} is {value}: give a finite number")
    late = late_values(model, ranges)
    return {n: float(given.get(n, late.get(n, 0.0))) for n in conditions_of(model)}


def late_values(model: Model, ranges: Mapping[str, tuple[float, float]] | None = None) -> dict[str, float]:
    """Return the default values of ``t`` [s] and ``work``: those of the end of the data, after all changes.

    ``ranges`` are the ranges of the signals in the fitted data. See `chosen_conditions` for a model without them.
    """
    changes = [p.value for p in model.parameters if p.name == "t_shift"]
    late = {TIME_INPUT: max(changes) + AFTER_S if changes else 0.0, WORK_INPUT: 0.0}
    return late | {n: known[1] for n, known in (ranges or {}).items() if n in COMPUTED}


def frame_words(conditions: Mapping[str, float]) -> str:
    """Return the conditions of a steady or linear motion as words for a sentence.

    ``conditions`` is a result of `chosen_conditions`. If it has neither place nor heading, the text is ``for still
    water, without disturbances``. Otherwise the text is, for example, ``at psi = 0 rad, with the effects that depend on
    it (such as wind), without current and disturbance forces``.
    """
    pose = {n: v for n, v in conditions.items() if n in POSE}
    if not pose:
        return "for still water, without disturbances"
    example = " (such as wind)" if "psi" in pose else ""
    what = f"with the effects that depend on it{example}, without current and disturbance forces"
    return f"at {conditions_text(pose)}, {what}"


def heading_sentence(conditions: Mapping[str, float]) -> str:
    """State that a linear model holds near one heading, if its rates depend on it; otherwise the text is empty."""
    if "psi" not in conditions:
        return ""
    at = conditions_text({"psi": conditions["psi"]})
    return (
        f"The model depends on the heading (as wind does, for example): matrices and inputs hold near {at}; "
        "at={'psi': ...} gives those of the heading that you steer."
    )


def outside_text(values: Mapping[str, float], ranges: Mapping[str, tuple[float, float]]) -> str:
    """List the states and inputs of an operating point that are outside their ranges in the fitted data.

    Parameters
    ----------
    values : mapping
        States and inputs by name.
    ranges : mapping
        Smallest and largest value of each signal in the fitted data by name. A signal without a range is left out.

    Returns
    -------
    str
        For example ``sway v = 0.265 m/s (98 % of the data: -0.606 to 0.0983 m/s)``; empty if all are inside.
        Signals may leave their range by a tenth of its width (`seatrial.ident.estimation.leaves_validity`).
    """
    found = []
    for name, value in values.items():
        low, high = ranges.get(name, (-float("inf"), float("inf")))
        if leaves_validity(value, value, (low, high)):
            word, unit = VELOCITIES.get(name, ("", ""))
            shown = f"{word} {name} = {value:.3g} {unit}".strip()
            # The range of a velocity is from its 1 % to its 99 % quantile, that of an input has all of its values.
            data = "98 % of the data" if name in VELOCITIES else "data"
            found.append(f"{shown} ({data}: {low:.3g} to {high:.3g} {unit}".rstrip() + ")")
    return ", ".join(found)


def drift_text(forward: float, sway: float) -> str:
    """Describe the drift of an operating point, from its forward speed and sway speed [m/s]; empty below 1 deg."""
    angle = degrees(atan2(sway, abs(forward)))
    if abs(angle) < LEAST_DRIFT_DEG:
        return ""
    return (
        f"sway v = {sway:.3g} m/s: the boat drifts to {'starboard' if sway > 0.0 else 'port'} by {abs(angle):.2g} deg"
    )


def turn_sentence(conditions: Mapping[str, float]) -> str:
    """State why a model has no steady turn: its rates depend on heading or place, which a turn changes.

    ``conditions`` are those of `chosen_conditions`. The text is empty if they have neither heading nor place.
    """
    words = {"psi": "the heading", "x": "the place", "y": "the place"}
    found = [words[n] for n in ("psi", "x", "y") if n in conditions]
    if not found:
        return ""
    names = " and ".join(dict.fromkeys(found))
    return (
        f"There is no steady turn: the model depends on {names} (as wind does, for example), which a turning boat "
        "changes, so that its turn rate never stays the same; simulate the model for its mean."
    )


def conditions_text(conditions: Mapping[str, float]) -> str:
    """Format conditions as text, for example ``t = 240 s, x = 0 m``. The text of no conditions is empty."""
    return ", ".join(f"{n} = {v:.4g} {UNITS[n]}".rstrip() for n, v in conditions.items())
