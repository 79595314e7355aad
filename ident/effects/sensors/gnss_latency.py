"""GNSS latency: position and velocity refer to a time before their time stamp.

Position and velocity of the antenna are extrapolated backwards by its velocity and acceleration. The acceleration is
that of half the latency earlier in what drives the thrusters, through whatever lies between them and the motion; else
steps of the thrust would look like another effect. Of given forces the past is not known, but for their lag.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from seatrial.ident.model import HISTORY_STEP, INF, Effect, Input, Parameter, Signals, tap_name
from seatrial.ident.models import LONGEST_DELAY, SHORTEST_LAG, SIDES, copies_of

N_PAST = 5


def _before(past: list[Any], tau: Any) -> Any:
    """Linear interpolation of the past at tau; past[k] is the value k steps ago."""
    at = tau / HISTORY_STEP
    near = [1 - abs(at - k) for k in range(len(past))]
    return sum(value * w * (w > 0) for value, w in zip(past, near, strict=True))


def _delay(s: Signals, then: Signals) -> None:
    """``then``: what the rates would be now with the thrust of half the latency earlier."""
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
    half, earlier = s.p.tau_gnss / 2, {}
    for side in SIDES:
        name = f"n_{side}"
        taps = copies_of(s, name)
        known = [getattr(s.u, tap_name(name, k)) for k in taps]
        known += N_PAST * known[-1:]  # further back than any copy: as in the oldest
        for i, k in enumerate(taps):
            earlier[tap_name(name, k)] = _before(known[i : i + N_PAST + 1], half)
    _delay(s, s.again(_lagging(s, earlier), earlier, {}))


def delay_driven_shaft(s: Signals) -> None:
    """Shafts that are states were, half the latency earlier, at what they are now less their rate."""
    half = s.p.tau_gnss / 2
    shafts = {f"n_{side}": getattr(s.x, f"n_{side}") - half * s.rate[f"n_{side}"] for side in SIDES}
    command = {"tau_n": np.minimum(s.p.tau_n + half, LONGEST_DELAY)}
    _delay(s, s.again(shafts, {}, command))


def delay_force(s: Signals) -> None:
    _delay(s, s.again(_lagging(s, {}), {}, {}))


def _lagging(s: Signals, inputs: Mapping[str, Any]) -> dict[str, Any]:
    """Where thrust lags, its states of half the latency earlier, when the inputs were others.

    By their rates as far back as their time constant, since an exponential has forgotten what was before that; further
    back they are by then their time constant behind what they follow. Either is exact on a straight line.
    """
    if not hasattr(s.x, f"late_{SIDES[0]}"):
        return {}
    half, lag = s.p.tau_gnss / 2, np.maximum(s.p.T_lag, SHORTEST_LAG)
    far = np.maximum(half / lag, 0.5)
    by_rate = np.minimum((2 / far - 1) / far, 1.0)
    led, found = s.again({}, inputs, {}), {}
    for name in (f"late_{side}" for side in SIDES):
        change = lag * (led.rate[name] - s.rate[name])  # of what it follows
        found[name] = getattr(s.x, name) - by_rate * half * s.rate[name] + (1 - by_rate) * change
    return found


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
# the thrust of half the latency earlier is known as far back as the inputs go
TAU_SHAFT = replace(TAU, bounds=(0.0, 2 * N_PAST * HISTORY_STEP))
COMMON: dict[str, Any] = {
    "place": "sensor",
    "formula": "p_measured(t) = p(t - tau), v_measured(t) = v(t - tau), by their derivatives",
    "source": "Groves 2013, section 10.5",
    "experiment": "fast straight runs with hard stops, and turns at speed",
    "one_sided": True,
    "alternatives": ("lever-arm", "delay"),
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
        "GNSS latency",
        {"late_fix": delay_driven_shaft},
        (TAU,),
        requires=("hull", "n_state"),
        **(COMMON | {"alternatives": ("lever-arm",)}),
    ),
    Effect(
        "gnss-latency-force",
        "GNSS latency",
        {"late_fix": delay_force},
        (TAU,),
        requires=("hull", "f_input"),
        **(COMMON | {"alternatives": ("lever-arm", "force-delay")}),
    ),
)
