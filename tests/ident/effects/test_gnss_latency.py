"""Tests of a late fix against an independent boat, integrated in steps of 2 ms and looked up at the earlier time.

The tests cover every component between shaft speed and motion, and the position of the antenna.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce
from operator import add

import numpy as np
import pytest

from seatrial.ident.effects.registry import catalogue
from seatrial.ident.model.structure import Effect, Model
from seatrial.ident.models.components import telemetry_age
from seatrial.ident.models.horizontal import horizontal_model

DT, LATE, ARM = 0.002, 0.2, 0.15  # Units: s, s, m
HULL = {
    "m_u": 37.0,
    "m_v": 47.0,
    "m_r": 9.69,
    "d_u": 2.0,
    "d_uu": 0.0,
    "d_v": 20.0,
    "d_vv": 0.0,
    "d_r": 4.0,
    "d_rr": 0.0,
    "V_x": 0.2,
    "V_y": -0.1,
}
TIMES = np.arange(1.0, 5.0, 0.17)
Values = Mapping[str, float]


def speeds(t: float) -> np.ndarray:
    """Return oscillating shaft speeds of left and right. The thrust changes quickly and the motion stays slow."""
    return np.array([0.6 * np.sin(2.5 * t), 0.6 * np.sin(2.5 * t + 0.3)])


def forces(n: np.ndarray, x: np.ndarray, p: Values) -> np.ndarray:
    """Return the force of each thruster."""
    share = p.get("lambda_n", 0.0)
    f = 40.05 * ((1 - share) * n * np.abs(n) + share * n) + 1.11 * n**2
    f = f - p.get("k_J", 0.0) * np.abs(n) * (x[3] - np.array([-ARM, ARM]) * x[5])
    f = f * (1 - p.get("kappa", 0.0) * np.abs(n[::-1])) / (1 + p.get("loss_r", 0.0) * abs(x[5]))
    return f * (1 + p.get("eps_LR", 0.0) * np.array([1.0, -1.0])) * np.where(n < 0, 1 - p.get("rho_rev", 0.0), 1.0)


def rates(t: float, x: np.ndarray, p: Values) -> np.ndarray:
    """Return the rates of north, east, psi, u, v, r and of the lagging shaft speeds."""
    n = speeds(t - p.get("tau_delay", 0.0) + p.get("tau_age", 0.0))
    n = np.sign(n) * np.maximum(np.abs(n) - p.get("n_dead", 0.0), 0.0) / (1.0 - p.get("n_dead", 0.0))
    slow = (n - x[6:]) / p["T_lag"] if "T_lag" in p else 0 * n
    f = forces(x[6:] if "T_lag" in p else n, x, p)
    psi, u, v, r = x[2:6]
    c, s, h = np.cos(psi), np.sin(psi), HULL
    return np.array(
        [
            c * u - s * v + h["V_x"],
            s * u + c * v + h["V_y"],
            r,
            (f.sum() - h["d_u"] * u + h["m_v"] * v * r) / h["m_u"],
            (-h["d_v"] * v - h["m_u"] * u * r) / h["m_v"],
            (ARM * (f[0] - f[1]) - h["d_r"] * r + (h["m_u"] - h["m_v"]) * u * v) / h["m_r"],
            *slow,
        ]
    )


def sailed(p: Values) -> np.ndarray:
    """Return the states in steps of DT, starting almost at rest (Runge-Kutta)."""
    x = np.array([3.0, -2.0, 0.4, 0.3, 0.0, p.get("r_0", 0.0), *speeds(0.0)])
    found = [x]
    for t in DT * np.arange(round(5.0 / DT)):
        k1 = rates(t, x, p)
        k2 = rates(t + DT / 2, x + DT / 2 * k1, p)
        k3 = rates(t + DT / 2, x + DT / 2 * k2, p)
        x = x + DT / 6 * (k1 + 2 * k2 + 2 * k3 + rates(t + DT, x + DT * k3, p))
        found.append(x)
    return np.array(found)


def fix(t: float, x: np.ndarray, p: Values) -> np.ndarray:
    """Return position and velocity of the antenna."""
    (l_x, l_y), psi, r = (p.get("l_x", 0.0), p.get("l_y", 0.0)), x[2], x[5]
    c, s = np.cos(psi), np.sin(psi)
    north, east = c * l_x - s * l_y, s * l_x + c * l_y
    v_n, v_e = rates(t, x, p)[:2]
    return np.array([x[0] + north, x[1] + east, v_n - r * east, v_e + r * north])


def predicted(model: Model, t: float, x: np.ndarray) -> np.ndarray:
    known = dict(zip(("x", "y", "psi", "u", "v", "r", "late_left", "late_right"), x, strict=True))
    u = [speeds(t - i.delay)[int(i.name.startswith("n_right"))] for i in model.inputs]
    s = model.signals([known[n.name] for n in model.states], u, list(model.values.values()))
    return np.array([s.y[name] for name in ("x", "y", "vx", "vy")], dtype=float)


def effects_of(names: Sequence[str]) -> list[Effect]:
    return [telemetry_age() if n == "telemetry-age" else catalogue()[n] for n in names]


def errors(names: Sequence[str], values: Values, late: float = LATE) -> np.ndarray:
    """Return the largest errors of north, east and their rates. The fix is ``late`` and predicted from the present
    state.
    """
    model = reduce(add, effects_of(names), horizontal_model())
    model = model.with_values({**HULL, **{k: v for k, v in values.items() if k != "r_0"}, "tau_gnss": late})
    path = sailed(values)
    back = round(late / DT)
    off = [
        predicted(model, t, path[k]) - fix(t - late, path[k - back], values)
        for t, k in zip(TIMES, np.round(TIMES / DT).astype(int), strict=True)
    ]
    return np.abs(off).max(axis=0)


CHAIN: dict[tuple[str, ...], dict[str, float]] = {
    (): {},
    ("delay",): {"tau_delay": 0.35},
    ("lag",): {"T_lag": 0.3},
    ("telemetry-age",): {"tau_age": 0.2},
    ("dead-band",): {"n_dead": 0.2},
    ("turn-loss",): {"loss_r": 3.0, "r_0": 0.5},
    ("mismatch",): {"eps_LR": 0.5},
    ("thrust-linearity",): {"lambda_n": 0.8},
    ("thruster-interaction",): {"kappa": 0.8},
    ("advance-ratio",): {"k_J": 9.0},
    ("delay", "lag", "dead-band", "thrust-linearity"): {
        "tau_delay": 0.25,
        "T_lag": 0.2,
        "n_dead": 0.1,
        "lambda_n": 0.5,
    },
}


# One case of each component, and the chain of four. `make study` also runs the others.
DEFAULT = {
    (),
    ("delay",),
    ("lag",),
    ("turn-loss",),
    ("advance-ratio",),
    ("delay", "lag", "dead-band", "thrust-linearity"),
}


@pytest.mark.parametrize(
    "names",
    [pytest.param(names, marks=[pytest.mark.study] * (names not in DEFAULT)) for names in CHAIN],
    ids=lambda names: "+".join(names) or "alone",
)
def test_late_fix_is_the_past_position_for_any_thrust_component(names: tuple[str, ...]) -> None:
    found = errors(("gnss-latency", *names), CHAIN[names])
    assert found[:2].max() < 2e-3
    assert found[2:].max() < (1e-2 if "lag" in names else 5e-3)


def test_late_fix_includes_the_lever_arm_of_the_antenna() -> None:
    """The boat is in a turn of 50 deg/s that slows down. With the velocity of the origin, the error was 15 cm."""
    found = errors(("lever-arm", "gnss-latency"), {"l_x": 1.2, "l_y": -0.5, "r_0": 0.9})
    assert found[:2].max() < 2e-3
    assert found[2:].max() < 0.03


@pytest.mark.parametrize("lag", [0.05, pytest.param(0.1, marks=pytest.mark.study), 0.3])
def test_lag_shorter_than_the_latency_is_not_extrapolated(lag: float) -> None:
    """The rate of a fast state, multiplied by several time constants, does not give its past value."""
    assert errors(("gnss-latency", "lag"), {"T_lag": lag}, 0.4)[2:].max() < 0.1


def test_late_fix_uses_past_commands_if_the_shafts_have_no_lag() -> None:
    """Without a lag, the thrust of half the latency earlier is that of the command at that time."""
    model = horizontal_model("command") + catalogue()["gnss-latency-command"]
    model = model.with_values({"tau_gnss": 0.2, "tau_n": 0.1, "T_n": 0.0, "dead_zone": 0.0, "c2": 0.0})
    u = [0.5 - (i.delay - 0.1) * 0.4 for i in model.inputs]  # The command 0.5 acts now and changes by 0.4 per second.
    s = model.signals([0.0] * len(model.states), u, list(model.values.values()))
    assert s.y["vx"] == pytest.approx(-0.2 * 2 * 40.05 * 0.46**2 / 37.0, rel=1e-9)
