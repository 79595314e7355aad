"""Models of a Kingfisher boat in straight-line motion, for `seatrial ident vehicle --model surge_model.py:NAME`.

    m_u u' = F - k sqrt|F| u - d_u u - d_uu |u| u - d_uuu |u|^2 u
    speed  = u + c

u [m/s] is the speed through the water, and ``speed`` [m/s] is the speed over ground along the track. c [m/s] is the
drift along the track by current or wind. Drift and noise of the speed have their own value in each run. F [N] is the
thrust X of the bench's thrust curve for the command ``tau`` seconds ago. The models differ in their terms:

    immediate   tau = 0
    delayed     delay tau of propulsion and GPS receiver together, which the data cannot separate
    lagged      delay, and a first-order lag T of the thrust
    loss        delay, and the loss of thrust by advance, k sqrt|F| u: Fossen's bilinear |n| u with |n| ~ sqrt|F|
    cubic       delay, and a drag that grows faster than the square, as wave resistance does below the hull speed
    both        delay, loss and cubic drag
    shifted     both, and a dead band that is wider by d on the water than on the bench: F = X - d dX/dn

Sources: Fossen 2011, section 9.1 (bilinear thrust), and thesis section 6 (straight-line motion).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from seatrial.ident.model import (
    INF,
    Input,
    Model,
    Output,
    Parameter,
    Sensor,
    State,
    delay_weights,
    plain_model,
    tap_name,
    weighted_sum,
)

TAP_STEP_S, N_DELAYS = 0.1, 16  # s, and number of delayed copies (taps) of an input; tap k is k steps old
SMALL = 1e-6  # N; it makes the root smooth at zero thrust

BODY = (
    Parameter("m_u", 45.0, "kg", "surge mass with added mass", "log"),
    Parameter("d_u", 3.0, "kg/s", "linear damping", bounds=(0, INF), step=0.3),
    Parameter("d_uu", 10.0, "kg/m", "quadratic damping", bounds=(0, INF), step=0.3),
)
RUN = (
    Parameter("c", 0.0, "m/s", "drift along the track", prior=(0.0, 0.1), per_record=True, step=0.01),
    Parameter("s_u", 0.02, "m/s/sqrt(s)", "process noise of surge speed", "log"),
    Parameter("e_u", 0.015, "m/s", "noise of the speed over ground", "log", per_record=True),
)
DELAY = Parameter(
    "tau", 0.7, "s", "delay from command to measured speed", bounds=(0, TAP_STEP_S * (N_DELAYS - 1)), step=0.02
)
LAG = Parameter("T", 0.2, "s", "lag of the thrust", "log", bounds=(0.02, 10.0))
LOSS = Parameter("k", 0.5, "sqrt(N) s/m", "thrust lost to advance", step=0.02)
CUBIC = Parameter("d_uuu", 1.0, "kg s/m2", "cubic damping", bounds=(0, INF), step=0.3)
SHIFT = Parameter("d", 0.0, "", "dead band on the water less that on the bench", prior=(0.0, 0.05), step=0.002)


def delayed_input(u: Any, name: str, tau: Any) -> Any:
    """Return an input ``tau`` seconds ago, by cubic convolution of its delayed taps."""
    taps = [getattr(u, tap_name(name, k)) for k in range(N_DELAYS)]
    return weighted_sum(delay_weights(tau / TAP_STEP_S, N_DELAYS), taps)


def make(*more: Parameter) -> Model:
    """Return the model with the terms of the parameters ``more``."""
    has = {p.name for p in more}
    names = ("X", "X_n") if "d" in has else ("X",)
    taps = range(N_DELAYS if "tau" in has else 1)
    states = [State("u", "m/s", "surge through the water", "s_u", from_output="speed", sd0=0.15)]
    if "T" in has:
        states.append(State("F", "N", "thrust", 1e-3, sd0=1e-3))

    def thrust(u: Any, p: Any) -> Any:
        terms = {n: delayed_input(u, n, p.tau) if "tau" in has else getattr(u, n) for n in names}
        return terms["X"] - (p.d * terms["X_n"] if "d" in has else 0.0)

    def f(x: Any, u: Any, p: Any) -> dict[str, Any]:
        F = x.F if "T" in has else thrust(u, p)
        speed = abs(x.u)
        force = F - p.d_u * x.u - p.d_uu * speed * x.u
        if "k" in has:
            force = force - p.k * np.sqrt(abs(F) + SMALL) * x.u
        if "d_uuu" in has:
            force = force - p.d_uuu * speed * speed * x.u
        rates = {"u": force / p.m_u}
        if "T" in has:
            rates["F"] = (thrust(u, p) - x.F) / p.T
        return rates

    return plain_model(
        "kingfisher",
        f=f,
        h=lambda x, u, p: {"speed": x.u + p.c},
        states=tuple(states),
        inputs=tuple(Input(n, "N").delayed(k) for n in names for k in taps),
        sensors=(Sensor("gps", (Output("speed", "m/s", "e_u"),)),),
        parameters=(*BODY, *more, *RUN),
    )


immediate = make()
delayed = make(DELAY)
lagged = make(DELAY, LAG)
loss = make(DELAY, LOSS)
cubic = make(DELAY, CUBIC)
both = make(DELAY, LOSS, CUBIC)
shifted = make(DELAY, LOSS, CUBIC, SHIFT)
