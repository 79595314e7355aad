"""GNSS latency: position and velocity refer to a time before their time stamp.

Position and velocity are extrapolated backwards by their derivatives. The acceleration is that of half the latency
earlier, with the thrust of that time; else steps of the thrust would look like another effect.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ident.model import HISTORY_STEP, INF, Effect, Input, Parameter, Signals, tap_name

N_PAST = 5


def _before(past: list[Any], tau: Any) -> Any:
    """Linear interpolation of the past at tau; past[k] is the value k steps ago."""
    at = tau / HISTORY_STEP
    near = [1 - abs(at - k) for k in range(len(past))]
    return sum(value * w * (w > 0) for value, w in zip(past, near, strict=True))


def _delay(s: Signals, thrust_change: Any) -> None:
    tau, x = s.p.tau_gnss, s.x
    cos, sin = np.cos(x.psi), np.sin(x.psi)
    du = s.rate["u"] - x.v * x.r + thrust_change / s.p.m_u
    dv = s.rate["v"] + x.u * x.r
    a_x, a_y = cos * du - sin * dv, sin * du + cos * dv
    s.y["x"] = s.y["x"] - tau * s.rate["x"] + tau * tau / 2 * a_x
    s.y["y"] = s.y["y"] - tau * s.rate["y"] + tau * tau / 2 * a_y
    s.y["vx"], s.y["vy"] = s.y["vx"] - tau * a_x, s.y["vy"] - tau * a_y


def delay_shaft(s: Signals) -> None:
    change: Any = 0.0
    for side in s.n:
        now = getattr(s.u, f"n_{side}")
        past = [now, *(getattr(s.u, tap_name(f"n_{side}", k)) for k in range(1, N_PAST + 1))]
        then = _before(past, s.p.tau_gnss / 2)
        change = change + _static(s, then) - _static(s, now)
    _delay(s, change)


def delay_driven_shaft(s: Signals) -> None:
    """Of shafts that are states the speed of half the latency earlier is that of now less its rate."""
    change: Any = 0.0
    for side in s.n:
        now = getattr(s.x, f"n_{side}")
        change = change + _static(s, now - s.p.tau_gnss / 2 * s.rate[f"n_{side}"]) - _static(s, now)
    _delay(s, change)


def delay_force(s: Signals) -> None:
    _delay(s, 0.0)


def _static(s: Signals, n: Any) -> Any:
    return s.p.c1 * n * abs(n) + s.p.c2 * n * n


TAU = Parameter(
    "tau_gnss", 0.0, "s", "age of the GNSS fix at its time stamp", prior=(0.0, 0.8), bounds=(0.0, INF), step=0.05,
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
PAST = tuple(
    Input(f"n_{side}", "", "linear").delayed(k) for side in ("left", "right") for k in range(1, N_PAST + 1)
)
EFFECTS = (
    Effect(
        "gnss-latency",
        "GNSS latency",
        {"output": delay_shaft},
        (TAU_SHAFT,),
        inputs=PAST,
        requires=("hull", "n_input"),
        **COMMON,
    ),
    Effect(
        "gnss-latency-command",
        "GNSS latency",
        {"output": delay_driven_shaft},
        (TAU,),
        requires=("hull", "n_state"),
        **(COMMON | {"alternatives": ("lever-arm",)}),
    ),
    Effect(
        "gnss-latency-force",
        "GNSS latency",
        {"output": delay_force},
        (TAU,),
        requires=("hull", "f_input"),
        **(COMMON | {"alternatives": ("lever-arm", "force-delay")}),
    ),
)
