"""Surge and steering without sideslip: first-order Nomoto model (Nomoto 1957; Fossen 2011, section 7.2).

For a vehicle that goes where it points, and whose yaw rate follows the difference of its sides at once or with one
time constant: tracked and wheeled vehicles, jets, rudders or vanes behind two thrusters, most simulators of autopilots.
Sway and moments are not in it, so no arm and no inertia in yaw.

    m_u (u' - v r) = X - d_u u - d_uu |u| u,    X = sum of c1 ((1 - lambda_n) n |n| + lambda_n n) + c2 n^2
    T r' + r = (K + K_u u) delta (1 - k_3 delta^2),    delta = (n_left - n_right) / 2
    [x', y'] = R(psi) [u, v] + (V_x, V_y),    psi' = r,    v' = -v / tau_v + noise

K steers at any speed, K_u in proportion to it; k_3 is what a large angle loses. What little it slides is a disturbance.
T is zero where nobody gives it a prior (``--prior T=0.5:0.5``): a short one beside tau_n and T_r has several optima.
From ``SHORTEST_LAG`` down to zero it is as in ``seatrial.ident.models.horizontal.first_order``.

Where nothing is slow, delays count: inputs act ``tau_n`` after their time stamp, by cubic convolution of their past.
The gyro is behind a low-pass filter of second order (Butterworth), as ArduPilot and PX4 have it, with its own states:

    T_r^2 r_gyro'' / 2 + T_r r_gyro' + r_gyro = r

Slow motion comes ``T_r`` late through it, quick motion later and smaller. Of heading and gyro a row has a sample, no
mean of several: the mean of what follows the inputs at once is not what it is in the middle.

Inputs that are known from slow samples (``nomoto:sampled``) are uncertain in time: each of a side acts ``sigma_n``
(standard deviation) later or earlier than ``tau_n`` says, by a first-order Gauss-Markov process of ``MEMORY``, which is
that of a sample. To first order that is nothing where they stand still, and much where they change quickly: corners and
stairs that are not in a straight line between samples, taken for known, make a light vehicle's masses and damping those
that explain them.

GNSS is ``tau_gnss`` old, and a mean over a time of standard deviation ``sigma_gnss``: what a receiver smooths is short
by ``r^2 sigma_gnss^2 / 2`` in a turn, 5 % at 3 rad/s and 0.1 s. A fix is the mean of the states that long before and
after ``tau_gnss`` ago (Gauss-Hermite quadrature of two points), to which the model is integrated back. Accelerometers,
which have a delay of their own and feel gravity as the vehicle pitches, are not used.

Few parameters and quick answers are soon estimated to 0.01 %, which no sensor is good for. The gyro's scale and the
time stamps are considered (``DATASHEET``): held, and as uncertain as their priors, which goes into all errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np

from seatrial.ident.model import (
    Hold,
    Model,
    Parameter,
    ParameterRole,
    Residual,
    Signals,
    State,
    Variable,
    resolve_initial_states,
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
from seatrial.ident.models.thruster import delay_weights

STEP, TAPS = 0.05, range(-2, 12)  # s between copies of the inputs, and which there are: 0.1 s ahead, 0.55 s back
MEMORY = 0.1  # s, of the inputs' errors in time
AHEAD, LONGEST = -STEP * TAPS[0], 0.3  # s: of tau_n; of a sensor's delay, behind an input that is half as late
WIDEST = 0.15  # s: of sigma_gnss
ROOT_2 = float(np.sqrt(2.0))
LINEARITY = Parameter(
    "lambda_n", 0.0, "", "share of the thrust that is linear", prior=(0.0, 0.5), bounds=(-1.0, 1.5), step=0.02
)
STEERING = (
    Parameter("K", 0.5, "rad/s", "steady yaw rate at full difference of the sides, at rest", step=0.05),
    Parameter("K_u", 0.1, "rad/m", "the same per speed", step=0.05),
    Parameter("k_3", 0.0, "", "share of it that is lost at full difference", prior=(0.0, 0.3), step=0.05),
    Parameter("T", 0.0, "s", "time constant of the yaw rate", bounds=(0.0, 10.0), free=False, step=0.02),
)
TIMING = (
    Parameter(
        "tau_n",
        0.0,
        "s",
        "delay of thrust and steering behind the inputs' time stamps",
        prior=(0.0, 0.1),
        bounds=(-AHEAD, LONGEST / 2),
        step=0.01,
    ),
    Parameter("T_r", 0.06, "s", "delay of the gyro's filter", prior=(0.0, 0.1), bounds=(0.0, LONGEST), step=0.01),
    Parameter(
        "tau_gnss",
        0.1,
        "s",
        "age of the GNSS fix at its time stamp",
        prior=(0.1, 0.2),
        bounds=(0.0, LONGEST),
        step=0.02,
    ),
    Parameter(
        "sigma_gnss",
        0.05,
        "s",
        "spread in time of what a fix is the mean of, standard deviation",
        prior=(0.0, 0.1),
        bounds=(0.0, WIDEST),
        step=0.01,
    ),
)
# What a fit cannot tell, since nothing else measures it as well: a calibrated AHRS has 0.1 % (a bare chip ten times
# that: --prior k_r=0:0.01), and stamps are in whole milliseconds.
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
    State("u", "m/s", "speed ahead", "s_u", sd0=0.3),
    State("v", "m/s", "sideslip that nothing explains", "q_v", sd0=0.05, nuisance=True),
    State("r", "rad/s", "yaw rate behind its lag", "s_r", sd0=0.1),
    State("r_gyro", "rad/s", "yaw rate behind the gyro's filter", from_output="r", sd0=0.1),
    State("r_gyro_rate", "rad/s2", "change of the yaw rate behind the gyro's filter", sd0=1.0),
)
STAMP_ERROR = "stamp_error_"  # and the side
LATENESS = tuple(
    State(f"{STAMP_ERROR}{side}", "", "error of the input's time stamps, scaled", float(np.sqrt(2 / MEMORY)), sd0=1.0,
          nuisance=True)
    for side in SIDES
)  # fmt: skip
LATE = Parameter("sigma_n", 0.01, "s", "error of the inputs' time stamps, standard deviation", "log",
                 prior=(0.01, 0.03), role=ParameterRole.DISTURBANCE)  # fmt: skip
RESIDUALS = (
    Residual("X", "N", "b_X", 10.0, "the force X", adder("X"), of=("u", "r", "psi", "t"), requires=("nomoto",)),
    Residual(
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
    """The model, driven by the shaft speeds, or an autopilot's outputs, ``n_left`` and ``n_right`` (normalised);
    ``sampled``: inputs are uncertain in time."""
    # its GNSS is not averaged, and sees the jumps of a light vehicle
    now = pair("n", "", hold, prefilter=False)
    past = tuple(replace(i.delayed(k, STEP), name=_past(i.name, k)) for i in now for k in TAPS if k)
    parameters = tuple(p for p in HULL if p.name in ("m_u", "d_u", "d_uu"))
    parameters += (*(CURRENT if current else ()), *THRUST, LINEARITY, *STEERING, *TIMING)
    parameters += tuple(replace(p, free=False, considered=True, origin=BUILT_IN) for p in DATASHEET)
    parameters += (*((LATE,) if sampled else ()), *DIFFUSION)
    chosen = tuple(replace(SENSORS[s], averaged=False) for s in sensors)
    return Model(
        "nomoto",
        resolve_initial_states((*STATES, *(LATENESS if sampled else ())), chosen),
        (*now, *past),
        chosen,
        (*parameters, *(NOISE[s.name] for s in chosen)),
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


def _past(name: str, k: int) -> str:
    return f"{name}~{k}x{STEP:g}s" if k else name


def _static_thrust(p: Any, n: Any) -> Any:
    return p.c1 * ((1 - p.lambda_n) * n * abs(n) + p.lambda_n * n) + p.c2 * n * n


def _steady_rate(s: Signals, u: Any, n: Sequence[Any]) -> Any:
    delta, p = (n[0] - n[1]) / 2, s.p
    return (p.K + p.K_u * u) * delta * (1 - p.k_3 * delta * delta)


def _damping(s: Signals, u: Any) -> Any:
    return s.p.d_u * u + s.p.d_uu * abs(u) * u


def _inputs(s: Signals, ago: Any) -> list[Any]:
    """Inputs that acted so long ago [s], by cubic convolution, with what is known now of their errors in time."""
    weights = delay_weights((s.p.tau_n + s.p.dt_n + ago) / STEP - TAPS[0], len(TAPS))
    found = []
    for side in SIDES:
        known = [getattr(s.u, _past(f"n_{side}", k)) for k in TAPS]
        then = sum(w * n for w, n in zip(weights, known, strict=True))
        if hasattr(s.x, STAMP_ERROR + side):
            beyond = [2 * known[0] - known[1], *known, 2 * known[-1] - known[-2]]
            change = [(late - early) / (2 * STEP) for early, late in zip(beyond[:-2], beyond[2:], strict=True)]
            late = s.p.sigma_n * getattr(s.x, STAMP_ERROR + side) * np.exp(-ago / MEMORY)
            then = then + late * sum(w * d for w, d in zip(weights, change, strict=True))
        found.append(then)
    return found


def delayed(s: Signals) -> None:
    """Inputs of ``tau_n`` ago."""
    s.n_now = _inputs(s, 0.0)  # and stays so: effects change s.n
    s.n = dict(zip(SIDES, s.n_now, strict=True))


def thrust(s: Signals) -> None:
    s.f = {side: _static_thrust(s.p, n) for side, n in s.n.items()}


def force(s: Signals) -> None:
    """Thrust less damping X [N], and the yaw rate r_ref [rad/s] that the difference of the sides ends at."""
    s.slip_time = 0.0  # s: sideslip per speed and yaw rate, of effects
    s.X = sum(s.f.values()) - _damping(s, s.x.u)
    s.r_ref = _steady_rate(s, s.x.u, list(s.n.values()))


def rate(s: Signals) -> None:
    x = s.x
    s.r = first_order(s, "r", s.r_ref, s.p.T)
    v = _sideslip(s, x.u, s.r)
    s.rate["x"], s.rate["y"] = _over_ground(s, x.psi, x.u, v)
    s.rate["psi"], s.rate["u"] = s.r, s.X / s.p.m_u + v * s.r
    corner = ROOT_2 / np.maximum(s.p.T_r + s.p.dt_r, SHORTEST_LAG)  # rad/s
    s.rate["r_gyro"] = x.r_gyro_rate
    s.rate["r_gyro_rate"] = corner * (corner * (s.r - x.r_gyro) - ROOT_2 * x.r_gyro_rate)
    if hasattr(x, "v"):
        s.rate["v"] = -x.v / s.p.tau_v
    for side in SIDES if hasattr(x, STAMP_ERROR + SIDES[0]) else ():
        s.rate[STAMP_ERROR + side] = -getattr(x, STAMP_ERROR + side) / MEMORY


def _sideslip(s: Signals, u: Any, r: Any) -> Any:
    """Sway [m/s]: the disturbance, where there is one, and what effects make of speed and yaw rate."""
    return getattr(s.x, "v", 0.0) - s.slip_time * u * r


def _over_ground(s: Signals, psi: Any, u: Any, v: Any) -> tuple[Any, Any]:
    """Velocity north and east [m/s]."""
    cos, sin = np.cos(psi), np.sin(psi)
    return cos * u - sin * v + getattr(s.p, "V_x", 0.0), sin * u + cos * v + getattr(s.p, "V_y", 0.0)


def _rates_at(s: Signals, ago: Any, u: Any, n: Sequence[Any]) -> tuple[Any, Any]:
    """Yaw rate [rad/s] and acceleration [m/s2] of so long ago [s], with the disturbances of now.

    What effects make of the inputs counts as one of these: only the inputs themselves were others then. So a change of
    the thrust is taken back without the effects on it (a lag, a dead band, losses), which is exact where it is steady.
    """
    x, p, now = s.x, s.p, s.n_now
    direct = 1 - np.minimum(p.T / SHORTEST_LAG, 1.0)  # part of the yaw rate that follows its inputs at once
    r = s.r - (1 - direct) * ago * s.rate["r"] + direct * (_steady_rate(s, u, n) - _steady_rate(s, x.u, now))
    gain = sum(_static_thrust(p, one) for one in n) - sum(_static_thrust(p, one) for one in now)
    gain = gain - _damping(s, u) + _damping(s, x.u)
    return r, (s.X + gain) / p.m_u + _sideslip(s, u, r) * r


def _back(s: Signals, since: tuple[Any, ...], ago: Any, span: Any, steps: int) -> tuple[Any, ...]:
    """Place, heading, speed and sideslip a span [s] before those ``since``, so long ago [s]: explicit midpoint rule."""
    north, east, psi, u, _ = since
    step = span / steps
    for k in range(steps):
        middle = ago + (k + 0.5) * step
        n = _inputs(s, middle)
        slower = u - step / 2 * _rates_at(s, middle, u, n)[1]
        r, gain = _rates_at(s, middle, slower, n)
        v_n, v_e = _over_ground(s, psi - step / 2 * r, slower, _sideslip(s, slower, r))
        north, east, psi, u = north - step * v_n, east - step * v_e, psi - step * r, u - step * gain
    r = _rates_at(s, ago + span, u, _inputs(s, ago + span))[0]
    return north, east, psi, u, _sideslip(s, u, r)


def output(s: Signals) -> None:
    x, y, p = s.x, s.y, s.p
    v = _sideslip(s, x.u, s.r)
    y["psi"] = x.psi
    # a shorter filter: as first_order
    y["r"] = (1 + p.k_r) * (s.r + np.minimum((p.T_r + p.dt_r) / SHORTEST_LAG, 1.0) * (x.r_gyro - s.r))
    first = p.tau_gnss + p.dt_gnss - p.sigma_gnss
    late = _back(s, (x.x, x.y, x.psi, x.u, v), 0.0, first, 2)
    early = _back(s, late, first, 2 * p.sigma_gnss, 4)
    y["x"], y["y"] = (late[0] + early[0]) / 2, (late[1] + early[1]) / 2
    (a_n, a_e), (b_n, b_e) = (_over_ground(s, *place[2:]) for place in (late, early))
    y["vx"], y["vy"] = (a_n + b_n) / 2, (a_e + b_e) / 2
    for axis, own in zip("xy", _over_ground(s, x.psi, x.u, v), strict=True):
        beyond = s.rate[axis] - own  # of effects, such as a current that wanders: steady over a fix's age
        age = p.tau_gnss + p.dt_gnss  # mean of the two points
        y[axis], y[f"v{axis}"] = y[axis] - age * beyond, y[f"v{axis}"] + beyond
