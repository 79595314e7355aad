"""Surge and steering without sideslip: first-order Nomoto model (Nomoto 1957; Fossen 2011, section 7.2).

The model suits vehicles that move in the direction of their heading, and whose yaw rate follows the difference of their
sides at once or with one time constant. Examples are tracked and wheeled vehicles, jets, rudders or vanes behind two
thrusters, and most autopilot simulators. The model has no sway force and no yaw moment, so it needs no arm and no
moment of inertia in yaw.

    m_u (u' - v r) = X - d_u u - d_uu |u| u,    X = sum of c1 ((1 - lambda_n) n |n| + lambda_n n) + c2 n^2
    T r' + r = (K + K_u u) delta (1 - k_3 delta^2),    delta = (n_left - n_right) / 2
    [x', y'] = R(psi) [u, v] + (V_x, V_y),    psi' = r,    v' = -v / tau_v + noise

K is the steering gain at any speed, and K_u its increase with speed. k_3 is the relative loss at a large difference.
The small remaining sideslip v is a disturbance. T is fixed at zero without a prior (``--prior T=0.5:0.5``), because the
likelihood has several maxima for a short T beside tau_n and T_r. Between zero and ``SHORTEST_LAG``, T is approximated
as in ``seatrial.ident.models.horizontal.first_order``.

Delays. Such vehicles respond quickly, so delays matter. Inputs act ``tau_n`` after their time stamp, by cubic
convolution of their past. The gyro signal passes a low-pass filter of second order (Butterworth) with its own states,
as in ArduPilot and PX4:

    T_r^2 r_gyro'' / 2 + T_r r_gyro' + r_gyro = r

The filter delays slow motion by ``T_r``, and delays and attenuates quick motion. Heading and gyro samples are not
averaged over a row. These outputs follow the inputs at once, so their mean differs from the value at the midpoint.

Sampled inputs. With the option ``nomoto:sampled``, inputs from slow samples are uncertain in time. Each input acts
``sigma_n`` (standard deviation) later or earlier than ``tau_n``. This time error is a first-order Gauss-Markov process
with the correlation time ``STAMP_ERROR_TIME_S``. To first order, the time error has no influence while the inputs are
constant, and much influence while they change quickly. If sampled inputs were taken as exact, their deviation from
straight lines between samples would bias masses and damping.

GNSS. A fix is ``tau_gnss`` old, and is a mean over a time with the standard deviation ``sigma_gnss``. The smoothing of
a receiver shortens the path in a turn by a share of ``r^2 sigma_gnss^2 / 2``, or 5 % at 3 rad/s and 0.1 s. The
modelled fix is the mean of the states ``sigma_gnss`` before and after the time ``tau_gnss`` ago (Gauss-Hermite
quadrature with two points). The model is integrated backwards to these times. Accelerometers are not used, because they
have a separate delay and measure gravity as the vehicle pitches.

Considered parameters. The model has few parameters and quick responses. Its estimates would soon have standard errors
of 0.01 %, which no sensor supports. The scale of the gyro and the time stamps (``DATASHEET``) are therefore considered
parameters: they are held, and all standard errors include the uncertainty of their priors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np

from seatrial.ident.model import (
    DisturbanceChannel,
    Hold,
    Model,
    Parameter,
    ParameterRole,
    Signals,
    State,
    Variable,
    built_in,
    delay_weights,
    resolve_initial_states,
    tap_name,
    weighted_sum,
)
from seatrial.ident.models.disturbances import TIME, adder, disturbance
from seatrial.ident.models.horizontal import (
    BUILT_IN,
    CURRENT,
    HULL,
    NOISE,
    SENSORS,
    SHORTEST_LAG,
    SIDES,
    THRUST,
    first_order,
    pair,
    unchanged,
)
from seatrial.ident.numerics import body_to_ned

TAP_STEP_S = 0.05  # s between the copies of the inputs
TAPS = range(-2, 12)  # shifts of the copies: 0.1 s earlier to 0.55 s later
STAMP_ERROR_TIME_S = 0.1  # s, correlation time of the time errors of the inputs
# s: upper bound of -tau_n; upper bound of the delay of a sensor. The upper bound of tau_n is half of the latter.
LARGEST_LEAD_S, LARGEST_DELAY_S = -TAP_STEP_S * TAPS[0], 0.3
LARGEST_SPREAD_S = 0.15  # s, upper bound of sigma_gnss
ROOT_2 = float(np.sqrt(2.0))
LINEARITY = Parameter(
    "lambda_n", 0.0, "", "share of the thrust that is linear", prior=(0.0, 0.5), bounds=(-1.0, 1.5), step=0.02
)
STEERING = (
    Parameter("K", 0.5, "rad/s", "steady yaw rate at full difference of the sides, at zero speed", step=0.05),
    Parameter("K_u", 0.1, "rad/m", "increase of K with speed", step=0.05),
    Parameter("k_3", 0.0, "", "relative loss of steady yaw rate at full difference", prior=(0.0, 0.3), step=0.05),
    Parameter("T", 0.0, "s", "time constant of the yaw rate", bounds=(0.0, 10.0), free=False, step=0.02),
)
TIMING = (
    Parameter(
        "tau_n",
        0.0,
        "s",
        "delay of thrust and steering behind the inputs' time stamps",
        prior=(0.0, 0.1),
        bounds=(-LARGEST_LEAD_S, LARGEST_DELAY_S / 2),
        step=0.01,
    ),
    Parameter(
        "T_r", 0.06, "s", "delay of the gyro's filter", prior=(0.0, 0.1), bounds=(0.0, LARGEST_DELAY_S), step=0.01
    ),
    Parameter(
        "tau_gnss",
        0.1,
        "s",
        "age of the GNSS fix at its time stamp",
        prior=(0.1, 0.2),
        bounds=(0.0, LARGEST_DELAY_S),
        step=0.02,
    ),
    Parameter(
        "sigma_gnss",
        0.05,
        "s",
        "time over which the receiver averages a fix, standard deviation",
        prior=(0.0, 0.1),
        bounds=(0.0, LARGEST_SPREAD_S),
        step=0.01,
    ),
)
# Considered parameters: the data cannot inform them, because no other sensor measures the same quantity as accurately.
# The scale error is 0.1 % for a calibrated AHRS (a bare gyro chip has 1 %: --prior k_r=0:0.01). Time stamps are
# rounded to milliseconds.
DATASHEET = (
    Parameter("k_r", 0.0, "", "error of the gyro's scale", prior=(0.0, 1e-3), step=1e-3),
    Parameter("dt_n", 0.0, "s", "error of the inputs' time stamps", prior=(0.0, 3e-4), step=1e-3),
    Parameter("dt_r", 0.0, "s", "error of the gyro's time stamps", prior=(0.0, 3e-4), step=1e-3),
    Parameter("dt_gnss", 0.0, "s", "error of the fixes' time stamps", prior=(0.0, 3e-4), step=1e-3),
)
DIFFUSION = (
    Parameter("s_u", 0.03, "m/s/sqrt(s)", "process noise of surge speed", "log"),
    Parameter("s_r", 0.03, "rad/s/sqrt(s)", "process noise of yaw rate", "log"),
    Parameter("s_psi", 0.01, "rad/sqrt(s)", "process noise of the heading", "log"),
    Parameter("q_v", 0.02, "m/s/sqrt(s)", "diffusion of the sideslip", "log", prior=(0.02, 0.06)),
    Parameter(
        "tau_v",
        5.0,
        "s",
        "correlation time of the sideslip",
        "log",
        prior=(5.0, 10.0),
        bounds=(0.5, 1000.0),
        role=ParameterRole.DISTURBANCE,
    ),
)
STATES = (
    State("x", "m", "north", from_output="x", sd0=1.0),
    State("y", "m", "east", from_output="y", sd0=1.0),
    State("psi", "rad", "heading", "s_psi", from_output="psi", sd0=0.1),
    State("u", "m/s", "surge", "s_u", sd0=0.3),
    State("v", "m/s", "unexplained sideslip", "q_v", sd0=0.05, nuisance=True),
    State("r", "rad/s", "yaw rate after its lag", "s_r", sd0=0.1),
    State("r_gyro", "rad/s", "yaw rate after the gyro's filter", from_output="r", sd0=0.1),
    State("r_gyro_rate", "rad/s2", "rate of change of the yaw rate after the gyro's filter", sd0=1.0),
)
STAMP_ERROR_PREFIX = "stamp_error_"  # prefix of the states, followed by the side
STAMP_ERROR_STATES = tuple(
    State(
        f"{STAMP_ERROR_PREFIX}{side}",
        "",
        "error of the input's time stamps, scaled",
        float(np.sqrt(2 / STAMP_ERROR_TIME_S)),
        sd0=1.0,
        nuisance=True,
    )
    for side in SIDES
)
STAMP_ERROR_SD = Parameter(
    "sigma_n",
    0.01,
    "s",
    "error of the inputs' time stamps, standard deviation",
    "log",
    prior=(0.01, 0.03),
    role=ParameterRole.DISTURBANCE,
)
RESIDUALS = (
    DisturbanceChannel(
        "X", "N", "b_X", 10.0, "the force X", adder("X"), of=("u", "r", "psi", "t"), requires=("nomoto",)
    ),
    DisturbanceChannel(
        "r_ref",
        "rad/s",
        "b_r_ref",
        0.3,
        "the steady yaw rate",
        adder("r_ref"),
        of=("u", "psi", "t"),
        requires=("nomoto",),
    ),
)

SEEN = ("attitude", "gyro", "position", "ground_velocity")
VARIABLES = (
    Variable("u", "m/s", attrgetter("x.u"), functions=7),
    Variable("r", "rad/s", attrgetter("x.r")),
    Variable("psi", "rad", attrgetter("x.psi"), angle=True),
    TIME,
)


def nomoto_model(
    sensors: Sequence[str] = SEEN, *, current: bool = True, sampled: bool = False, hold: Hold = "linear"
) -> Model:
    """Return the Nomoto model of surge and steering, with the inputs ``n_left`` and ``n_right`` (normalised, -1 to 1).

    The inputs are measured shaft speeds, or outputs of an autopilot.

    Parameters
    ----------
    sensors : Sequence[str]
        Names of the sensors whose outputs the model has, among ``attitude``, ``gyro``, ``position`` and
        ``ground_velocity``.
    current : bool
        Whether the model has a constant ocean current, estimated separately in each record.
    sampled : bool
        Whether the times of the inputs are uncertain. The model then has a state for the time error of each input.
    hold : "zero", "average" or "linear"
        Inputs between their samples: constant (``zero``), constant and approximated by a straight line in each row of
        the record (``average``), or interpolated linearly (``linear``).

    Raises
    ------
    KeyError
        If a sensor is unknown. Other sensors of the horizontal model (``accelerometer``, ``body_velocity``) are not
        refused, but the model cannot be evaluated with them.
    """
    # The inputs are not averaged: GNSS samples are not averaged either, and contain the quick motion of a light vehicle
    now = pair("n", "", hold, prefilter=False)
    past = tuple(
        replace(i.delayed(k, TAP_STEP_S), name=tap_name(i.name, k, TAP_STEP_S)) for i in now for k in TAPS if k
    )
    parameters = tuple(p for p in HULL if p.name in ("m_u", "d_u", "d_uu"))
    parameters += (*(CURRENT if current else ()), *THRUST, LINEARITY, *STEERING, *TIMING)
    parameters += tuple(replace(p, free=False, considered=True, origin=BUILT_IN) for p in DATASHEET)
    parameters += (*((STAMP_ERROR_SD,) if sampled else ()), *DIFFUSION)
    chosen = tuple(replace(SENSORS[s], averaged=False) for s in sensors)
    return Model(
        "nomoto",
        resolve_initial_states((*STATES, *(STAMP_ERROR_STATES if sampled else ())), chosen),
        (*now, *past),
        chosen,
        built_in((*parameters, *(NOISE[s.name] for s in chosen))),
        (
            ("shaft", delayed),
            ("dead_band", unchanged),
            ("thrust_lag", unchanged),
            ("thrust", thrust),
            ("force", force),
            ("rate", rate),
            ("output", output),
        ),
        provides=("n", "f", "n_input", "plane", "heading", "nomoto"),
        source="nomoto" + ":sampled" * sampled + ":no-current" * (not current),
        residuals=RESIDUALS,
        variables=VARIABLES,
        disturbance=disturbance(("X", "r_ref")),
        max_step=SHORTEST_LAG,
    )


def _static_thrust(p: Any, n: Any) -> Any:
    """Return the steady thrust [N] of one thruster at the normalised shaft speed ``n``.

    It is ``c1 ((1 - lambda_n) n|n| + lambda_n n) + c2 n^2`` with the parameters ``p``.
    """
    return p.c1 * ((1 - p.lambda_n) * n * abs(n) + p.lambda_n * n) + p.c2 * n * n


def _steady_yaw_rate(s: Signals, u: Any, n: Sequence[Any]) -> Any:
    """Return the steady yaw rate [rad/s] at the speed ``u`` [m/s] and the normalised inputs ``n`` (left, right).

    It is ``(K + K_u u) delta (1 - k_3 delta^2)``, with ``delta = (left - right) / 2``.
    """
    delta, p = (n[0] - n[1]) / 2, s.p
    return (p.K + p.K_u * u) * delta * (1 - p.k_3 * delta * delta)


def _damping_force(s: Signals, u: Any) -> Any:
    """Return the damping force ``d_u u + d_uu |u| u`` [N] at the speed ``u`` [m/s]. It has the sign of the speed."""
    return s.p.d_u * u + s.p.d_uu * abs(u) * u


def _inputs_at(s: Signals, ago: Any) -> list[Any]:
    """Return the inputs (left, right) that acted on the vehicle ``ago`` [s] before now.

    They are those of ``ago`` plus the delay ``tau_n`` (and its error ``dt_n``) before now.

    The inputs are interpolated between their shifted copies by cubic convolution. The copies cover the times from 0.1 s
    after to 0.55 s before now; beyond them the result is wrong, without an error. If the model has states for the
    errors of the time stamps, the inputs are corrected to first order by these errors, which decay with their
    correlation time.
    """
    weights = delay_weights((s.p.tau_n + s.p.dt_n + ago) / TAP_STEP_S - TAPS[0], len(TAPS))
    inputs = []
    for side in SIDES:
        copies = [getattr(s.u, tap_name(f"n_{side}", k, TAP_STEP_S)) for k in TAPS]
        value = weighted_sum(weights, copies)
        if hasattr(s.x, STAMP_ERROR_PREFIX + side):
            extended = [2 * copies[0] - copies[1], *copies, 2 * copies[-1] - copies[-2]]
            change = [
                (late - early) / (2 * TAP_STEP_S) for early, late in zip(extended[:-2], extended[2:], strict=True)
            ]
            delay = s.p.sigma_n * getattr(s.x, STAMP_ERROR_PREFIX + side) * np.exp(-ago / STAMP_ERROR_TIME_S)
            value = value + delay * weighted_sum(weights, change)
        inputs.append(value)
    return inputs


def delayed(s: Signals) -> None:
    """Set the normalised inputs that act on the vehicle now, which are those of ``tau_n`` plus its error ``dt_n`` ago.

    They are interpolated between the shifted copies of the inputs. ``s.n`` (dict by side) is changed by effects later.
    ``s.n_now`` (list: left, right) keeps the values without effects.
    """
    s.n_now = _inputs_at(s, 0.0)  # kept unchanged: effects change s.n
    s.n = dict(zip(SIDES, s.n_now, strict=True))


def thrust(s: Signals) -> None:
    """Set the thrust ``s.f`` [N] of each thruster (dict by side) from its normalised shaft speed ``s.n``.

    It is ``c1 ((1 - lambda_n) n|n| + lambda_n n) + c2 n^2``, with the parameters of the model.
    """
    s.f = {side: _static_thrust(s.p, n) for side, n in s.n.items()}


def force(s: Signals) -> None:
    """Set ``s.X`` [N] (thrust of both thrusters less damping) and the steady yaw rate ``s.r_ref`` [rad/s].

    ``s.slip_time`` [s] is set to zero. An effect may change it to the sideslip per speed and yaw rate.
    """
    s.slip_time = 0.0  # s, sideslip divided by speed and yaw rate: effects set it
    s.X = sum(s.f.values()) - _damping_force(s, s.x.u)
    s.r_ref = _steady_yaw_rate(s, s.x.u, list(s.n.values()))


def rate(s: Signals) -> None:
    """Set the time derivatives ``s.rate`` of all states, and the yaw rate ``s.r`` [rad/s] after its first-order lag.

    The states are position, heading, surge speed, sideslip, yaw rate, the gyro's low-pass filter, and time errors of
    the inputs. Sideslip and time errors are left out if the model lacks them. With a time constant ``T`` of zero,
    ``s.r`` is the steady yaw rate ``s.r_ref`` itself.
    """
    x = s.x
    s.r = first_order(s, "r", s.r_ref, s.p.T)
    v = _sideslip(s, x.u, s.r)
    s.rate["x"], s.rate["y"] = _velocity_over_ground(s, x.psi, x.u, v)
    s.rate["psi"], s.rate["u"] = s.r, s.X / s.p.m_u + v * s.r
    corner = ROOT_2 / np.maximum(s.p.T_r + s.p.dt_r, SHORTEST_LAG)  # rad/s
    s.rate["r_gyro"] = x.r_gyro_rate
    s.rate["r_gyro_rate"] = corner * (corner * (s.r - x.r_gyro) - ROOT_2 * x.r_gyro_rate)
    if hasattr(x, "v"):
        s.rate["v"] = -x.v / s.p.tau_v
    for side in SIDES if hasattr(x, STAMP_ERROR_PREFIX + SIDES[0]) else ():
        s.rate[STAMP_ERROR_PREFIX + side] = -getattr(x, STAMP_ERROR_PREFIX + side) / STAMP_ERROR_TIME_S


def _sideslip(s: Signals, u: Any, r: Any) -> Any:
    """Return the sway velocity [m/s], positive to starboard, at the speed ``u`` [m/s] and the yaw rate ``r`` [rad/s].

    It is the disturbance state ``v`` (zero if the model lacks it) plus the sideslip of effects, ``-s.slip_time u r``.
    """
    return getattr(s.x, "v", 0.0) - s.slip_time * u * r


def _velocity_over_ground(s: Signals, psi: Any, u: Any, v: Any) -> tuple[Any, Any]:
    """Return the velocity north and east [m/s], including the constant current.

    ``psi`` is the heading [rad], ``u`` the surge and ``v`` the sway velocity [m/s]. A model without current parameters
    has no current.
    """
    north, east = body_to_ned(psi, u, v)
    return north + getattr(s.p, "V_x", 0.0), east + getattr(s.p, "V_y", 0.0)


def _rates_at(s: Signals, ago: Any, u: Any, n: Sequence[Any]) -> tuple[Any, Any]:
    """Return the yaw rate [rad/s] and the surge acceleration [m/s2] of ``ago`` [s] before now.

    ``u`` [m/s] and ``n`` (left, right) are the speed and the inputs at that time. The present yaw rate and force are
    corrected by the differences of steady yaw rate, thrust and damping between then and now. With a time constant ``T``
    of at least 0.05 s, the yaw rate is extrapolated with its present derivative instead; a shorter ``T`` mixes both.
    The differences are computed from the inputs without effects such as a lag, a dead band or a thrust loss. What such
    an effect changes now is kept, like a disturbance. The result is exact in steady state.
    """
    x, p, now = s.x, s.p, s.n_now
    direct = 1 - np.minimum(p.T / SHORTEST_LAG, 1.0)  # part of the yaw rate that follows the inputs without a lag
    r = s.r - (1 - direct) * ago * s.rate["r"] + direct * (_steady_yaw_rate(s, u, n) - _steady_yaw_rate(s, x.u, now))
    gain = sum(_static_thrust(p, n_side) for n_side in n) - sum(_static_thrust(p, n_side) for n_side in now)
    gain = gain - _damping_force(s, u) + _damping_force(s, x.u)
    return r, (s.X + gain) / p.m_u + _sideslip(s, u, r) * r


def _integrate_backwards(s: Signals, since: tuple[Any, ...], ago: Any, span: Any, steps: int) -> tuple[Any, ...]:
    """Integrate the motion of the vehicle backwards in time by the explicit midpoint rule.

    Parameters
    ----------
    s : Signals
        Present signals of the model.
    since : tuple
        Motion at the time ``ago`` before now: north [m], east [m], heading [rad], speed [m/s] and sway velocity [m/s].
        The last value is not used.
    ago : float or symbol
        Time from ``since`` to now [s].
    span : float or symbol
        Time to go back from there [s].
    steps : int
        Number of integration steps.

    Returns
    -------
    tuple
        The same five values at the time ``ago + span`` before now.
    """
    north, east, psi, u, _ = since
    step = span / steps
    for k in range(steps):
        middle = ago + (k + 0.5) * step
        n = _inputs_at(s, middle)
        slower = u - step / 2 * _rates_at(s, middle, u, n)[1]
        r, gain = _rates_at(s, middle, slower, n)
        v_n, v_e = _velocity_over_ground(s, psi - step / 2 * r, slower, _sideslip(s, slower, r))
        north, east, psi, u = north - step * v_n, east - step * v_e, psi - step * r, u - step * gain
    r = _rates_at(s, ago + span, u, _inputs_at(s, ago + span))[0]
    return north, east, psi, u, _sideslip(s, u, r)


def output(s: Signals) -> None:
    """Set the outputs ``s.y``: heading, yaw rate after the gyro's filter, and position and velocity of the GNSS fix.

    The yaw rate includes the scale error ``k_r`` of the gyro. The fix is the mean of the motion at two times:
    ``tau_gnss`` (plus its error ``dt_gnss``) before now, less and plus ``sigma_gnss``. The motion at these times
    follows by backward integration. Further velocities over ground that effects add, such as a random-walk current, are
    treated as constant over the age of the fix.
    """
    x, y, p = s.x, s.y, s.p
    v = _sideslip(s, x.u, s.r)
    y["psi"] = x.psi
    # below SHORTEST_LAG, the filter is approximated as in `first_order`
    y["r"] = (1 + p.k_r) * (s.r + np.minimum((p.T_r + p.dt_r) / SHORTEST_LAG, 1.0) * (x.r_gyro - s.r))
    first = p.tau_gnss + p.dt_gnss - p.sigma_gnss
    late = _integrate_backwards(s, (x.x, x.y, x.psi, x.u, v), 0.0, first, 2)
    early = _integrate_backwards(s, late, first, 2 * p.sigma_gnss, 4)
    y["x"], y["y"] = (late[0] + early[0]) / 2, (late[1] + early[1]) / 2
    (a_n, a_e), (b_n, b_e) = (_velocity_over_ground(s, *place[2:]) for place in (late, early))
    y["vx"], y["vy"] = (a_n + b_n) / 2, (a_e + b_e) / 2
    for axis, own in zip("xy", _velocity_over_ground(s, x.psi, x.u, v), strict=True):
        added = s.rate[axis] - own  # velocity by effects, such as a random-walk current: constant over the age of a fix
        age = p.tau_gnss + p.dt_gnss  # mean of the two points
        y[axis], y[f"v{axis}"] = y[axis] - age * added, y[f"v{axis}"] + added
