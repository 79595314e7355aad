"""GNSS latency: position and velocity refer to a time before their time stamp.

Position and velocity of the antenna are extrapolated backwards with its velocity and acceleration. The acceleration is
computed with the thruster inputs of half the latency earlier, including all dynamics between inputs and motion. With
the present acceleration, steps of the thrust would look like another effect. If thrusts are given as inputs, their past
values are unknown; only their lag is taken into account.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from seatrial.ident.model import (
    HISTORY_STEP,
    INF,
    Effect,
    Input,
    Parameter,
    Signals,
    in_sentence,
    tap_name,
    weighted_sum,
)
from seatrial.ident.models import LONGEST_DELAY, SIDES, available_taps, shortest_lag

N_PAST = 5  # number of earlier samples of each input


def _weights_ago(tau: Any) -> list[Any]:
    """Return the N_PAST + 1 weights with which delayed copies of an input give its value of ``tau`` [s] ago.

    Copy k (k = 0, 1, ... N_PAST) is the input k steps of 0.1 s ago. The interpolation is linear. For a ``tau`` beyond
    the last copy, the sum of the weights falls to zero within one step; the callers avoid that.
    """
    at = tau / HISTORY_STEP
    near = [1 - abs(at - k) for k in range(N_PAST + 1)]
    return [w * (w > 0) for w in near]


def _delay_fix(s: Signals, then: Signals) -> None:
    """Delay the outputs of the GNSS antenna's position and velocity by the latency ``tau_gnss``, in place in ``s.y``.

    Position and velocity are extrapolated backwards with the velocity and acceleration of the antenna. ``then``
    contains the rates of the present state, but computed with the thruster inputs of half the latency earlier; they
    give the acceleration.
    """
    tau, x, r = s.p.tau_gnss, s.x, s.x.r
    cos, sin = np.cos(x.psi), np.sin(x.psi)
    du, dv, dr = then.rate["u"] - x.v * r, then.rate["v"] + x.u * r, then.rate["r"]
    north, east = s.y["x"] - x.x, s.y["y"] - x.y  # from the origin to the antenna
    a_x = cos * du - sin * dv - dr * east - r * r * north
    a_y = sin * du + cos * dv + dr * north - r * r * east
    s.y["x"] = s.y["x"] - tau * s.y["vx"] + tau * tau / 2 * a_x
    s.y["y"] = s.y["y"] - tau * s.y["vy"] + tau * tau / 2 * a_y
    s.y["vx"], s.y["vy"] = s.y["vx"] - tau * a_x, s.y["vy"] - tau * a_y


def delay_shaft(s: Signals) -> None:
    """Delay the outputs of GNSS position and velocity by the latency, in place. For models with shaft-speed inputs.

    The acceleration is computed with the shaft speeds of half the latency earlier. They are interpolated between the
    delayed copies of the inputs (``NAME~k``: k steps of 0.1 s ago). Before the oldest copy, they are constant. A lag of
    the thrust in the model is traced back too.
    """
    earlier = s.once("shaft speeds half the GNSS latency ago", lambda: _earlier_shaft_speeds(s))
    _delay_fix(s, s.again(_earlier_lag_states(s, earlier), earlier, {}))


def _earlier_shaft_speeds(s: Signals) -> dict[str, Any]:
    """Return the shaft speeds and their delayed copies by name, as they were half the GNSS latency ago."""
    weights, earlier = _weights_ago(s.p.tau_gnss / 2), {}
    for side in SIDES:
        name = f"n_{side}"
        taps = available_taps(s, name)
        copies = [getattr(s.u, tap_name(name, k)) for k in taps]
        copies += N_PAST * copies[-1:]  # before the oldest copy, the input is assumed constant
        for i, k in enumerate(taps):
            earlier[tap_name(name, k)] = weighted_sum(weights, copies[i : i + N_PAST + 1])
    return earlier


def delay_driven_shaft(s: Signals) -> None:
    """Delay the outputs of GNSS position and velocity by the latency, in place. For models with shaft speeds as states.

    The acceleration is computed with the shaft speeds of half the latency earlier, extrapolated with their present
    rates. The delay of the command is increased by half the latency, up to the delay of the oldest copy of the command
    (0.8 s).
    """
    half = s.p.tau_gnss / 2
    shafts = {f"n_{side}": getattr(s.x, f"n_{side}") - half * s.rate[f"n_{side}"] for side in SIDES}
    command = {"tau_n": np.minimum(s.p.tau_n + half, LONGEST_DELAY)}
    _delay_fix(s, s.again(shafts, {}, command))


def delay_force(s: Signals) -> None:
    """Delay the model's outputs of GNSS position and velocity by the latency, in place. For models with thrust inputs.

    The outputs in ``s.y`` are extrapolated backwards in time by the latency, with the velocity and the acceleration of
    the antenna. The acceleration should belong to the thrusts in the middle of this interval, half the latency ago.
    Past values of the inputs are unknown, so the present ones are used. If the model has a first-order lag of the
    thrust, the states of the lag are set to their values half the latency ago (`_earlier_lag_states`).
    """
    _delay_fix(s, s.again(_earlier_lag_states(s, {}), {}, {}))


def _earlier_lag_states(s: Signals, inputs: Mapping[str, Any]) -> dict[str, Any]:
    """Return the states of the first-order thrust lag by name, as they were half the GNSS latency ago.

    ``inputs`` are the thruster inputs of that time by name; missing ones are the present ones. For a model without
    thrust lag, return {}.

    Up to one time constant back, the states are extrapolated with their rates. Beyond that, the states no longer depend
    on earlier values, and follow their inputs with a delay of one time constant. Both are exact for inputs that change
    linearly.
    """
    if not hasattr(s.x, f"late_{SIDES[0]}"):
        return {}
    half, lag = s.p.tau_gnss / 2, np.maximum(s.p.T_lag, shortest_lag(s.max_step))
    far = np.maximum(half / lag, 0.5)
    by_rate = np.minimum((2 / far - 1) / far, 1.0)
    led, states = s.again({}, inputs, {}), {}
    for name in (f"late_{side}" for side in SIDES):
        change = lag * (led.rate[name] - s.rate[name])  # change of the input that the state follows
        states[name] = getattr(s.x, name) - by_rate * half * s.rate[name] + (1 - by_rate) * change
    return states


TAU = Parameter(
    "tau_gnss",
    0.0,
    "s",
    "age of the GNSS fix at its time stamp",
    prior=(0.0, 0.8),
    bounds=(0.0, INF),
    step=0.05,
    scales=False,
)
# the thrust of half the latency earlier is known only as far back as the copies of the inputs
TAU_SHAFT = replace(TAU, bounds=(0.0, 2 * N_PAST * HISTORY_STEP))
COMMON: dict[str, Any] = {
    "place": "sensor",
    "formula": "p_measured(t) = p(t - tau), v_measured(t) = v(t - tau), expanded in their derivatives",
    "source": "Groves 2013, section 10.5",
    "causes": "a receiver or its filter, the rate of its messages",
    "experiment": "fast straight runs with hard stops, and turns at speed",
    "one_sided": True,
    "alternatives": ("lever-arm", "delay"),
    "in_words": in_sentence("tau_gnss", "s", "the fix is {} old at its time stamp"),
}
PAST = tuple(Input(f"n_{side}", "", "linear").delayed(k) for side in ("left", "right") for k in range(1, N_PAST + 1))
EFFECTS = (
    Effect(
        "gnss-latency",
        "GNSS latency",
        {"late_fix": delay_shaft},
        (TAU_SHAFT,),
        inputs=PAST,
        requires=("hull", "n_input"),
        **COMMON,
    ),
    Effect(
        "gnss-latency-command",
        "GNSS latency, in a model driven by commands",
        {"late_fix": delay_driven_shaft},
        (TAU,),
        requires=("hull", "n_state"),
        **(COMMON | {"alternatives": ("lever-arm",)}),
    ),
    Effect(
        "gnss-latency-force",
        "GNSS latency, in a model driven by forces",
        {"late_fix": delay_force},
        (TAU,),
        requires=("hull", "f_input"),
        **(COMMON | {"alternatives": ("lever-arm", "force-delay")}),
    ),
)
