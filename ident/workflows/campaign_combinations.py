"""Combinations of parameters that belong together, such as the drag at a speed, in the logs of two campaigns.

The linear and the quadratic damping of a fit are strongly correlated. Their sum at a speed of the logs is known much
better than either of them, so that a change of the drag may show in the sum alone. A combination is a row of each
log, as a parameter is: its estimate, its standard error with the correlations of the parameters, and the parts of this
error by priors. It is compared as the parameters are.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from seatrial.ident.effects import catalogue
from seatrial.ident.numerics import Array
from seatrial.ident.results import NotCompared, NotComparedCode
from seatrial.ident.workflows.campaign_logs import MOST_PRIOR, FittedLogs, Row

# Velocities at which a damping may be given: one of these times a power of ten, not above the typical one
PREFERRED = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0)
SLOWEST = 0.3  # of the typical velocity: a damping at a slower one says little of a passage
Reasons = Mapping[str, tuple[NotComparedCode, str] | None]
# Values (n_parameters,) of one log -> value of the combination and its gradient (n_parameters,)
Function = Callable[[Array], tuple[float, Array]]


@dataclass(frozen=True)
class Combination:
    """Combination of parameters, and its estimate from each log as rows of the table.

    Attributes
    ----------
    name
        Short name, such as ``drag ahead at 1 m/s``.
    meaning
        Words for a sentence, without an article.
    parameters
        Names of the parameters that it consists of.
    rows
        For each log, its row as that of a parameter. A log without an estimate has none (None).
    """

    name: str
    meaning: str
    parameters: tuple[str, ...]
    rows: tuple[Row | None, ...]


@dataclass(frozen=True)
class _Damping:
    """Damping of one motion: a polynomial in its velocity.

    Attributes
    ----------
    state
        Name of the velocity, ``u``, ``v`` or ``r``.
    words
        Name of the damping.
    powers
        Power of the velocity that each parameter is multiplied by, by name of the parameter.
    unit
        Unit of the damping.
    """

    state: str
    words: str
    powers: Mapping[str, int]
    unit: str

    def coefficients(self, fitted: FittedLogs) -> list[str]:
        """Return the names of its parameters in the logs, which may be ratios such as ``d_u/T``."""
        return [n for n in fitted.names if n.partition("/")[0] in self.powers]


DAMPING = (
    _Damping("u", "drag ahead", {"d_u": 1, "d_uu": 2, "d_uuu": 3}, "N"),
    _Damping("v", "sway damping", {"d_v": 1, "d_vv": 2}, "N"),
    _Damping("r", "yaw damping", {"d_r": 1, "d_rr": 2}, "N m"),
)


def combinations_of(fitted: FittedLogs, reasons: Reasons) -> tuple[list[Combination], list[NotCompared]]:
    """Return the combinations of the parameters of all logs, and those that cannot be compared with the reason.

    Parameters
    ----------
    fitted : FittedLogs
        Estimates of the logs of both campaigns.
    reasons : mapping
        For each parameter, why it cannot be compared as a code and words; None if it can.
    """
    dampings = (_damping(fitted, d, reasons) for d in DAMPING)
    thrusts, not_compared = _thrusts(fitted, reasons)
    not_compared += filter(None, (_only_one_coefficient(fitted, d, reasons) for d in DAMPING))
    found = [*filter(None, [_load(fitted, reasons), *dampings]), *thrusts]
    return [c for c in found if _is_determined(c, fitted)], not_compared


def _load(fitted: FittedLogs, reasons: Reasons) -> Combination | None:
    """Return the mean of the masses in surge and sway, which a load raises both by its mass; None without both.

    The masses of a scale that is unknown are ratios to the thrust, to which a load adds no common number.
    """
    names = ["m_u", "m_v"]
    if any(reasons.get(n, ("", "")) is not None for n in names):
        return None
    weights = np.array([0.5, 0.5])
    words = "mean of the masses in surge and sway"
    return _combination(fitted, ("mass, mean of m_u, m_v", words, "kg"), names, lambda x: (float(weights @ x), weights))


def _is_determined(combination: Combination, fitted: FittedLogs) -> bool:
    """Return whether logs of both campaigns determine a combination, and not mainly the priors of its parameters."""
    known = np.array([r is not None for r in combination.rows])
    if not all(known[part].any() for part in (fitted.after, ~fitted.after)):
        return False
    shares = []
    for row in filter(None, combination.rows):
        parts = json.loads(row["prior_parts"])
        shares.append(sum(parts.get(n, 0.0) ** 2 for n in combination.parameters) / row["se"] ** 2)
    return float(np.mean(shares)) <= MOST_PRIOR


def _damping(fitted: FittedLogs, damping: _Damping, reasons: Reasons) -> Combination | None:
    """Return the damping at a velocity that both campaigns reach; None with fewer than two estimated parameters.

    The velocity is the one with the smallest relative standard error of the damping, from `SLOWEST` of the typical one
    to that, and the fastest one of equal ones.

    A parameter at its bound in a log has no error there: its value is part of the sum, which the log determines anyway.
    """
    names = damping.coefficients(fitted)
    # All of them are ratios to the same quantity, or none is.
    divisors = {n.partition("/")[2] for n in names}
    usable = [n for n in names if (why := reasons[n]) is None or why[0] in ("fixed", "at-bound", "mainly-prior")]
    typical = _typical_velocity(fitted, damping.state)
    known = [n for n in names if fitted.known(n).any()]
    if typical is None or len(known) < 2 or len(usable) < len(names) or len(divisors) > 1:
        return None
    divisor = divisors.pop()

    def at(velocity: float) -> Combination:
        """Return the damping at a velocity."""
        weights = np.array([velocity ** damping.powers[n.partition("/")[0]] for n in names])
        shown = f"{math.degrees(velocity):.4g} deg/s" if damping.state == "r" else f"{velocity:.4g} m/s"
        words = f"{damping.words} at {shown}{f' / {divisor}' if divisor else ''}"
        unit = "" if divisor else damping.unit
        return _combination(fitted, (words, words, unit), names, lambda x: (float(weights @ x), weights))

    scale = math.degrees(1.0) if damping.state == "r" else 1.0
    velocities = [v / scale for v in rounded_below(scale * typical, SLOWEST)]
    return min((at(v) for v in velocities), key=_relative_error)


def _only_one_coefficient(fitted: FittedLogs, damping: _Damping, reasons: Reasons) -> NotCompared | None:
    """Return why a damping is not compared at a velocity: the other coefficients are at their bounds in all logs.

    None if more than one coefficient is estimated in some log, or if the others are missing for another reason.
    """
    names = damping.coefficients(fitted)
    known = [n for n in names if fitted.known(n).any()]
    others = [n for n in names if n not in known]
    if len(known) != 1 or not others or any((reasons[n] or ("", ""))[0] != "at-bound" for n in others):
        return None
    reason = f"{' and '.join(others)}: at the bound in all logs, so that it changes as {known[0]} does"
    return NotCompared(name=damping.words, meaning=f"{damping.words} at a speed", code="at-bound", reason=reason)


def _relative_error(combination: Combination) -> float:
    """Return the relative standard error of a combination, as the root mean square over the logs.

    It does not depend on the difference between the campaigns, so that a choice by it favours no verdict. It is
    infinite if a value is not positive, or if no log has one.
    """
    rows = [r for r in combination.rows if r is not None]
    if not rows or any(r["value"] <= 0.0 for r in rows):
        return math.inf
    return math.sqrt(sum((r["se"] / r["value"]) ** 2 for r in rows) / len(rows))


def _typical_velocity(fitted: FittedLogs, state: str) -> float | None:
    """Return a velocity that both campaigns reach [m/s, rad/s]; None if it is unknown or zero.

    It is the smaller one of the medians over the logs of each campaign.
    """
    values = [next(iter(rows.values())).get(f"{state}_typical") for rows in fitted.rows]
    if any(v is None for v in values):
        return None
    of_logs = np.array(values, dtype=float)
    typical = min(float(np.median(of_logs[part])) for part in (fitted.after, ~fitted.after))
    return typical if typical > 0.0 else None


def rounded_below(value: float, share: float) -> list[float]:
    """Return the numbers of `PREFERRED`, times powers of ten, between a share of a positive value and the value.

    The largest one comes first. There is at least one, which may be below the share.
    """
    power = 10.0 ** math.floor(math.log10(value))
    numbers = sorted((p * q for q in (power / 10.0, power) for p in PREFERRED), reverse=True)
    below = [n for n in numbers if n <= value * (1.0 + 1e-9)]
    return [n for n in below if n >= share * value] or below[:1]


def _thrusts(fitted: FittedLogs, reasons: Reasons) -> tuple[list[Combination], list[NotCompared]]:
    """Return the thrust ahead at full speed of each side, and the reason if the logs do not determine it.

    Without a parameter for the difference of the sides there is one thrust. A given thrust has no row: the motion shows
    only ratios to it.
    """
    if not {"c1", "c2"} <= set(fitted.names) or not any(r["c1"]["free"] for r in fitted.rows if "c1" in r):
        return [], []
    differences = [n for n in fitted.names if _is_difference_of_sides(n, fitted)]
    names = ["c1", "c2", *differences[:1]]
    bad = next(((n, why) for n in names if (why := reasons[n]) is not None and why[0] != "fixed"), None)
    if bad is not None:
        name, (code, reason) = bad
        both = "thrust ahead of each side"
        return [], [NotCompared(name=both, meaning=both, code=code, reason=f"{name}: {reason}")]

    def of_side(sign: float) -> Function:
        """Return the function for the left side (+1), the right one (-1), or both (0)."""

        def thrust(x: Array) -> tuple[float, Array]:
            """Return the thrust and its gradient."""
            full, share = x[0] + x[1], 1.0 + sign * (x[2] if x.size > 2 else 0.0)
            return float(full * share), np.array([share, share, sign * full])[: x.size]

        return thrust

    sides = {"left": 1.0, "right": -1.0} if differences else {"each": 0.0}
    found = []
    for side, sign in sides.items():
        meaning = f"thrust ahead of {side if side == 'each' else f'the {side}'} thruster"
        found.append(_combination(fitted, (f"thrust ahead, {side}", meaning, "N"), names, of_side(sign)))
    return found, []


def _is_difference_of_sides(name: str, fitted: FittedLogs) -> bool:
    """Return whether a parameter is half the relative difference of the thrusts, left minus right."""
    effects = {r[name]["effect"] for r in fitted.rows if name in r}
    return any(e in catalogue() and catalogue()[e].thrust_difference == name for e in effects)


def _combination(
    fitted: FittedLogs, words: tuple[str, str, str], names: Sequence[str], function: Function
) -> Combination:
    """Return a combination with its row for each log. ``words`` are its name, its meaning and its unit."""
    name, meaning, unit = words
    rows = tuple(_row(fitted.part(np.arange(len(fitted.logs)) == k), names, function) for k in range(len(fitted.logs)))
    own = {"meaning": meaning, "unit": unit, "effect": None, "nuisance": False, "free": True, "per_log": False}
    estimated = tuple(n for n in names if fitted.known(n).any())
    return Combination(name, meaning, estimated, tuple(None if r is None else own | dict(r) for r in rows))


def _row(log: FittedLogs, names: Sequence[str], function: Function) -> Row | None:
    """Return the row of a combination from one log.

    The result is None if no parameter of the combination has a standard error.
    """
    values = log.values(names)[0]
    value, gradient = function(values)
    known = [k for k, n in enumerate(names) if log.known(n).all()]
    if not known:
        return None
    slopes = gradient[known]
    variance = float(slopes @ log.covariances([names[k] for k in known])[0] @ slopes)
    parts: dict[str, float] = {}
    for k in known:
        for prior, part in json.loads(log.rows[0][names[k]]["prior_parts"] or "{}").items():
            parts[prior] = parts.get(prior, 0.0) + float(gradient[k]) * part
    if variance <= 0.0:
        return None
    return {"value": value, "se": variance**0.5, "prior_parts": json.dumps(parts), "flag": None}
